"""Transfer tables of a lens with any pupil and wavefront, integrated over the pixel.

Ports: waves (bands, n, n) [waves], coefficients [i, j] of x^i y^j, and q (bands,) [1], wavelength
times working f-number over pixel pitch -> tables float32 [1]. They are the quarter (bands, rows //
2 + 1, cols // 2 + 1) if pupil and wavefront are the same at every angle and the apertures lie in
the middles of their pixels. Else they are the half (bands, rows, 2 (cols // 2 + 1)) of the
transform, real and imaginary parts side by side; row i >= rows / 2 belongs to the frequency i -
rows.

As in optics.airy, the transfer function O of the optics is folded,

    T(f) = sum over integers (a, b) of  O((f + (a, b)) q) K(fy + a) K(fx + b),
    K(f) = sinc(w f) cos(pi d f) exp(-2 (pi sigma f)^2) exp(2 pi i m f),

w the aperture's width, d the distance of the two images that a birefringent plate makes along that
axis, sigma the width of a Gaussian diffuser, m the displacement of the aperture's middle [pixel].
The host tabulates O in float64, radially or along rays, and the device interpolates it by cubics.
The nodes are even in sqrt(1 - s), s = 1 at the cut-off, because O ends as (1 - s)^(3/2). For a
polygon, s is counted along each ray up to its own cut-off, and no cubic reaches across a ray on
which O has an edge: the directions of the polygon's sides, and the corners of the cut-off.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from math import ceil, floor
from typing import Any

import numpy as np
import scipy

from gpusim.backends import Device
from gpusim.domain.pupil import Pupil, Wavefront, disc_power, symmetric
from gpusim.kernels.stage import Array, Case, is_opencl_cpu, stage
from gpusim.optics.rays import polar_table, radial_table

BLOCK = 32  # bands of a CPU's work-item
AT_ONCE = 8  # bands
LARGE = 2**20  # frequencies from which on a CPU interpolates O between even ones
NODES = 256  # of these to a cycle per pixel
EXACT = 8  # of these next to f = 0 are not interpolated


@stage
def pupil(
    device: Device,
    outline: Pupil,
    waves: Array,
    q: Array,
    aperture: float | tuple[float, float],
    rows: int,
    cols: int,
    spots: tuple[float, float] = (0.0, 0.0),
    diffuser: float = 0.0,
    displacement: tuple[float, float] = (0.0, 0.0),
) -> Array:
    """Return tables of the pixel-integrated transfer function: quarter (real) or half (complex).

    Args:
        outline: The pupil's outline.
        waves: Wavefront polynomials [waves], shape (bands, n, n).
        q: lambda N / pitch of each band [1], shape (bands,), each > 0.
        aperture: Height and width of the pixel's aperture over the pitch [1], or one number for a
            square.
        rows: Period of the transform along the columns [pixel].
        cols: Period of the transform along the rows [pixel].
        spots: Distance of the two images of a birefringent low-pass along (y, x) [pixel], 0 for one
            image.
        diffuser: Standard deviation of the diffuser [pixel].
        displacement: (y, x) from the middles of the scene's samples to the middles of the apertures
            [pixel].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Tables [1], shape (bands, rows // 2 + 1, cols // 2 + 1) or (bands, rows, 2 (cols // 2 + 1)),
        float32, see above.

    Source:
        Hopkins, Proc. R. Soc. A 231 (1955), for O; the folding is the sampling theorem.
    """
    waves = np.asarray(device.numpy(waves), np.float64)
    q = np.asarray(device.numpy(q), np.float32)
    cutoff = 1 / float(q.min())
    real = symmetric(outline, waves) and not any(displacement)
    fy = np.arange(rows // 2 + 1) / rows if real else np.fft.fftfreq(rows)
    fx = np.arange(cols // 2 + 1) / cols
    low, high = -floor(cutoff + 0.5), floor(cutoff + (0 if real else 0.5))
    replicas = np.arange(low, high + 1)[:, None]
    weights = []
    for f, width, spot, move in zip(
        (replicas + fy, replicas + fx),
        np.broadcast_to(aperture, 2),
        spots,
        displacement,
        strict=True,
    ):
        spread = np.exp(-2 * (np.pi * diffuser * f) ** 2 + 2j * np.pi * move * f)
        one = np.sinc(width * f) * np.cos(np.pi * spot * f) * spread
        weights.append(one.real if real else np.stack([one.real, one.imag], axis=-1))
    common = (device.array(q), *map(device.array, weights), device.array(fy), device.array(fx))
    # on a CPU a work-item makes one frequency of many bands: they share its direction and replicas
    block = min(len(q), BLOCK) if is_opencl_cpu(device) else 1
    grid = (-(-len(q) // block), fy.size, fx.size)
    launching: dict[str, Any] = {
        "defines": {"BANDS": block},
        "group": (1, 1, 1) if block > 1 else None,
    }
    if real:
        table = device.array(radial_table(outline, waves))
        tables = device.empty((len(q), fy.size, fx.size))
        arrays = [table, *common, tables]
        sizes = [low, high, table.shape[1], *tables.shape]
        device.launch("optics.pupil", "radial", grid, *arrays, *sizes, **launching)
        return tables
    table, angle, sectors = polar_table(outline, waves)
    sides, inner = outline.cutoff
    whole = np.stack([table.real, table.imag], axis=-1)
    table = device.array(whole)
    numbers = [angle, sides, inner, sectors, (table.shape[1] - 1) // sectors, table.shape[2]]

    def fold(weights, fy, fx, low, high, bands=slice(None)):
        """Tables of bands at the frequencies fy, fx from the replicas low .. high."""
        shape = len(q[bands]), fy.size, fx.size
        tables = device.empty((*shape[:2], 2 * shape[2]))
        lines = table if bands == slice(None) else device.array(whole[bands])
        arrays = [lines, *map(device.array, (q[bands], *weights, fy, fx)), tables]
        grid = -(-shape[0] // block), fy.size, fx.size
        sizes = [low, high, *numbers, *shape]
        device.launch("optics.pupil", "polar", grid, *arrays, *sizes, **launching)
        return tables

    reach = ceil(NODES * cutoff) + 3
    is_large = rows * cols >= max(LARGE, 2 * (2 * reach + 1) ** 2)
    if block > 1 and is_large and not sides:  # a polygon has edges along its rays
        return device.array(_fold_between(fold, device, len(q), weights, fy, fx, low, high, reach))
    return fold(weights, fy, fx, low, high)


def _fold_between(fold, device, bands, weights, fy, fx, low, high, reach):
    """Return tables from O at even frequencies: cubics between them, and the sum over replicas, are sparse matrices.

    Near f = 0, where O has a cusp, the tables are exact.
    """
    nodes = np.arange(-reach, reach + 1) / NODES
    plain = np.zeros((1, len(nodes), 2), np.float32)
    plain[..., 0] = 1
    replicas = np.arange(low, high + 1)[:, None]
    down, across = (
        _cubics(replicas + f, weight, reach) for f, weight in zip((fy, fx), weights, strict=True)
    )
    near = [np.flatnonzero(np.abs(f) < EXACT / NODES) for f in (fy, fx)]
    parts = [np.ascontiguousarray(weight[:, at]) for weight, at in zip(weights, near, strict=True)]
    tables = np.empty((bands, len(fy), 2 * len(fx)), np.float32)

    def make(table, values):
        along = np.ascontiguousarray((across @ values.view(np.complex64).T).T)
        table[:] = (down @ along).view(np.float32)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for first in range(0, bands, AT_ONCE):
            some = slice(first, first + AT_ONCE)
            values = device.numpy(fold([plain, plain], nodes, nodes, 0, 0, some))
            list(pool.map(make, tables[some], values))
    exact = device.numpy(fold(parts, fy[near[0]], fx[near[1]], low, high))
    tables[:, near[0], : exact.shape[2]] = exact
    return tables


def _cubics(f, weights, reach):
    """Sparse matrix from values at the nodes to sums over replicas f (replicas, n), complex64 (n, 2 reach + 1)."""
    place = f * NODES + reach
    first = np.floor(place).astype(int) - 1
    t = place - first - 1
    basis = np.stack(
        [
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        ],
        axis=-1,
    )
    entries = basis * (weights[..., 0] + 1j * weights[..., 1])[..., None]
    column = first[..., None] + np.arange(4)
    row = np.broadcast_to(np.arange(f.shape[1])[:, None], column.shape)
    there = (column >= 0) & (column <= 2 * reach)
    shape = f.shape[1], 2 * reach + 1
    return scipy.sparse.csr_array(
        (entries[there].astype(np.complex64), (row[there], column[there])), shape=shape
    )


def cases():
    """Yield cases.

    Every kind of pupil and wavefront, coarse and fine pixels, oblong and displaced ones, odd
    periods, low-pass.
    """
    why = (
        "cubics through nodes h apart err by (w h)^4 / 40 for a ripple of w radians; as many nodes as keep "
        "that below 4e-6 of O(0) = 1, and 3e-5 of a polygon at worst; the replicas' weights sum to at most 2; "
        "float32 adds 1e-6"
    )
    blur = np.pad(disc_power(1), (0, 2))
    defocus = np.array([0.8, 1.5])[:, None, None] * blur
    spherical = 0.5 * disc_power(2)[None] - 0.4 * blur
    corner = Wavefront(seidel=(0.2, 0.7, 0.5, 0.4, 0.0)).polynomial(1.0, 0.6)[None]
    flat, disc, six = np.zeros((1, 3, 3)), Pupil(), Pupil(6, 0.2, 0.3)
    for name, outline, waves, q, aperture, rows, cols, spots, diffuser, *displacement in (
        ("defocus", Pupil(), defocus, (0.6, 1.1), 0.866, 12, 9, (0, 0), 0),
        ("coarse pixel", Pupil(), flat, (0.25,), 1.0, 8, 5, (1.0, 0.5), 0.3),
        ("obscured, spherical", Pupil(0, 0.3), spherical, (1.0,), 1.0, 9, 8, (0, 0), 0),
        ("corner of a field", Pupil(), corner, (1.1,), 1.0, 16, 9, (0, 0), 0),
        ("six blades, defocus", six, defocus[:1], (0.9,), 1.0, 7, 10, (0, 1.0), 0),
        ("five blades", Pupil(5, 0, 0.1), flat, (0.7,), 1.0, 8, 9, (0, 0), 0),
        ("oblong, displaced", Pupil(), flat, (0.4,), (1.0, 0.5), 8, 9, (0, 0), 0, 0.5, -0.25),
        ("defocus, displaced", disc, defocus, (0.6, 1.1), (0.4, 0.8), 9, 10, (0, 0), 0.2, 0.1, 1.0),
        ("six blades, displaced", six, defocus[:1], (0.9,), 0.8, 7, 10, (0, 1.0), 0, -3.0, 0.3),
    ):
        inputs = {
            "outline": outline,
            "waves": waves,
            "q": np.array(q, np.float32),
            "aperture": aperture,
            "rows": rows,
            "cols": cols,
            "spots": spots,
            "diffuser": diffuser,
            "displacement": tuple(displacement) or (0, 0),
        }
        yield Case(name, inputs, 3e-5, why)


def bench(rows, cols):
    """Return inputs: 31 bands of a 1.4 um f/1.8 camera, a wave out of focus."""
    wavelengths = np.linspace(400, 700, 31, dtype=np.float32)
    return {
        "outline": Pupil(),
        "waves": (550 / wavelengths)[:, None, None] * disc_power(1),
        "q": wavelengths * 1e-9 * 1.8 / 1.4e-6,
        "aperture": 1.0,
        "rows": rows,
        "cols": cols,
    }

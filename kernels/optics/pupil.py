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

import numpy as np
import scipy

from gpusim.backends import Device
from gpusim.domain.pupil import Pupil, Wavefront, disc_power, symmetric
from gpusim.kernels.stage import Array, Case, is_opencl_cpu, stage
from gpusim.optics.creases import find_creases
from gpusim.optics.rays import polar_table, radial_table

BLOCK = 32  # bands of a CPU's work-item
LARGE = 2**18  # frequencies from which on a CPU interpolates tables of a shorter period
NODES = 256  # of it up to the cut-off along an axis
LEAST = 64  # of them
EXACT = 8  # nodes next to f = 0 are not interpolated
BETWEEN, BLADED = 1.5e-5, 2e-5  # error of the interpolation; behind blades, whose nodes err by more
FINER = 2 * 2**0.5  # at most of the error between every other node: O begins as x^(3/2) in places


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
    real = symmetric(outline, waves) and not any(displacement)
    fold = _Folding(device, outline, waves, q, real, aperture, spots, diffuser, displacement)
    nodes = 4 * ceil(max(NODES * float(q.max()), LEAST) / 4)
    error = BLADED if outline.sides.size else BETWEEN
    while not device.is_gpu and rows * cols >= max(LARGE, 2 * nodes**2):
        coarse = device.numpy(fold(nodes, nodes))
        pairs = coarse.reshape(len(q), -1, coarse.shape[2] // fold.width, fold.width)
        every_other = pairs[:, ::2, ::2].reshape(len(q), -(-coarse.shape[1] // 2), -1)
        missed = np.abs(_interpolate(fold, every_other, nodes, nodes) - coarse).max() / FINER
        if missed <= error:
            return device.array(_interpolate(fold, coarse, rows, cols))
        nodes = 4 * ceil(nodes * min(2.0, 1.05 * (missed / error) ** (2 / 3)) / 4)
    return fold(rows, cols)


class _Folding:
    """Makes tables of all bands, of the device, at any frequencies."""

    def __init__(self, device, outline, waves, q, real, aperture, spots, diffuser, displacement):
        self.device, self.real, self.width, self._q = device, real, 1 if real else 2, q
        cutoff = 1 / float(q.min())
        self._ends = -floor(cutoff + 0.5), floor(cutoff + (0 if real else 0.5))
        self._axes = list(zip(np.broadcast_to(aperture, 2), spots, displacement, strict=True))
        self._soft, self._creases = diffuser, None
        if real:
            table, self._numbers = radial_table(outline, waves), []
        else:
            table, angle, sectors = polar_table(outline, waves)
            sides, inner = outline.cutoff
            self._numbers = [angle, sides, inner, sectors, (table.shape[1] - 1) // sectors]
            table = np.stack([table.real, table.imag], axis=-1)
        self._numbers.append(table.shape[2 - real])
        self._lines = device.array(table), device.array(q)
        if outline.sides.size:
            self._creases = find_creases(outline, waves)

    def frequencies(self, rows, cols):
        """Return the frequencies of the tables of a period [cycle/pixel]."""
        down = np.arange(rows // 2 + 1) / rows if self.real else np.fft.fftfreq(rows)
        return down, np.arange(cols // 2 + 1) / cols

    def __call__(self, rows, cols):
        """Return tables of a period."""
        return self.at(*self.frequencies(rows, cols))

    def at(self, fy, fx):
        """Return tables at frequencies."""
        device, bands = self.device, len(self._q)
        # on a CPU a work-item makes one frequency of many bands: they share its direction and replicas
        block = min(bands, BLOCK) if is_opencl_cpu(device) else 1
        tables = device.empty((bands, fy.size, self.width * fx.size))
        arrays = [*self._lines, *self._weights(fy, fx), tables]
        sizes = [*self._ends, *self._numbers, bands, fy.size, fx.size]
        device.launch(
            "optics.pupil",
            "radial" if self.real else "polar",
            (-(-bands // block), fy.size, fx.size),
            *arrays,
            *sizes,
            defines={"BANDS": block},
            group=(1, 1, 1) if block > 1 else None,
        )
        return tables

    def _weights(self, fy, fx):
        """Weights of replicas along both axes, and the frequencies, of the device."""
        replicas, weights = np.arange(self._ends[0], self._ends[1] + 1)[:, None], []
        for f, (width, spot, move) in zip((replicas + fy, replicas + fx), self._axes, strict=True):
            spread = np.exp(-2 * (np.pi * self._soft * f) ** 2 + 2j * np.pi * move * f)
            one = np.sinc(width * f) * np.cos(np.pi * spot * f) * spread
            weights.append(one.real if self.real else np.stack([one.real, one.imag], axis=-1))
        return list(map(self.device.array, (*weights, fy, fx)))

    def sharpen(self, tables, nodes, rows, cols):
        """Add what cubics between the nodes of a shorter period miss next to creases."""
        if self._creases is None:
            return
        device, found = self.device, self._creases
        sizes = np.stack([found.sizes.real, found.sizes.imag], axis=-1)
        fy, fx = self.frequencies(rows, cols)
        device.launch(
            "optics.pupil",
            "crease",
            (len(self._q), len(fy)),
            *map(device.array, (found.lines, sizes, self._q)),
            *self._weights(fy, fx),
            tables,
            *(*self._ends, found.reach, nodes, cols),
            *(*sizes.shape[1:3], len(self._q), len(fy), len(fx)),
            defines={"BANDS": 1},
        )


def _interpolate(fold, coarse, rows, cols):
    """Return tables of a period by cubics between tables of a shorter one.

    Near f = 0, where O has a cusp, the tables are exact.
    """
    device, real = fold.device, fold.real
    fy, fx = fold.frequencies(rows, cols)
    nodes = 2 * (coarse.shape[1] - 1) if real else coarse.shape[1]
    down, across = _cubics(fy, nodes, real), _cubics(fx, nodes, True)
    out = device.empty((len(coarse), len(fy), fold.width * len(fx)))
    tables = device.numpy(out)

    def make(band):
        values = coarse[band]
        if not real:
            values = values.view(np.complex64)
            # columns before the first and after the last: opposite frequencies are conjugates
            ends = np.roll(values[::-1, [1, -2]], 1, axis=0).conj()
            values = np.hstack([ends[:, :1], values, ends[:, 1:]])
        else:
            values = np.hstack([values[:, 1:2], values, values[:, -2:-1]])
            values = np.vstack([values[1:2], values, values[-2:-1]])
        along = np.ascontiguousarray((across @ np.ascontiguousarray(values.T)).T)
        tables[band] = down @ along.view(np.float32)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(make, range(len(coarse))))
    fold.sharpen(out, nodes, rows, cols)
    near = [np.flatnonzero(np.abs(f) < EXACT / nodes) for f in (fy, fx)]
    exact = device.numpy(fold.at(fy[near[0]], fx[near[1]]))
    tables = device.numpy(out)
    tables[:, near[0], : exact.shape[2]] = exact
    return tables


def _cubics(f, nodes, is_open):
    """Sparse matrix from values at the nodes of a period, and one more at both ends if open, to values at f."""
    place = f * nodes
    below = np.floor(place).astype(int)
    t = place - below
    basis = np.stack(
        [
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        ],
        axis=-1,
    ).astype(np.float32)
    if is_open:  # 1/2 is the last node
        column, count = below[:, None] + np.arange(4), nodes // 2 + 3
        keep = column < count
    else:
        column, count = (below[:, None] + np.arange(-1, 3)) % nodes, nodes
        keep = np.ones(column.shape, bool)
    row = np.broadcast_to(np.arange(len(f))[:, None], column.shape)
    return scipy.sparse.csr_array((basis[keep], (row[keep], column[keep])), shape=(len(f), count))


def cases():
    """Yield cases.

    Every kind of pupil and wavefront, coarse and fine pixels, oblong and displaced ones, odd
    periods, low-pass.
    """
    why = (
        "cubics through nodes h apart err by (w h)^4 / 40 for a ripple of w radians; as many nodes as keep "
        "that below 4e-6 of O(0) = 1, and 3e-5 of these polygons; the replicas' weights sum to at most 2; "
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

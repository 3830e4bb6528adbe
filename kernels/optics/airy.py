"""Transfer tables of a diffraction-limited lens, integrated over the pixel, one per wavelength.

Ports: q (bands,) [1], wavelength times working f-number over pixel pitch -> tables (bands, rows //
2 + 1, cols // 2 + 1) float32 [1]. The transfer function is even along both axes, so a table holds
one quarter.

The point spread function, integrated over the pixel and sampled once per pixel, has the transform

    T(f) = sum over integers (a, b) of  O(|f + (a, b)| q) sinc(h (fy + a)) sinc(w (fx + b)),

f in cycles per pixel, h and w the aperture's height and width in pixels, O the transfer function of
a circular pupil. The sum is finite because O ends at 1/q. Cutting it at Nyquist instead (a = b = 0
only) rings by 2 % of a highlight's peak.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import Array, Case, is_opencl_cpu, stage


@stage
def airy(
    device: Device, q: Array, aperture: float | tuple[float, float], rows: int, cols: int
) -> Array:
    """Return quarter tables of the pixel-integrated transfer function of a circular pupil.

    Args:
        q: lambda N / pitch of each band [1], shape (bands,), each > 0.
        aperture: Height and width of the pixel's aperture over the pitch [1], or one number for a
            square.
        rows: Period of the transform along the columns [pixel].
        cols: Period of the transform along the rows [pixel].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Tables [1], shape (bands, rows // 2 + 1, cols // 2 + 1), float32. Entry (l, i, j) belongs to
        the frequency (i / rows, j / cols) cycles per pixel.

    Source:
        Hopkins, Proc. R. Soc. A 231 (1955), for O; the folding is the sampling theorem.
    """
    q = np.asarray(device.numpy(q), np.float32)
    shape = (len(q), rows // 2 + 1, cols // 2 + 1)
    tables = device.empty(shape)
    # Beyond |f| = 1/q nothing passes: few replicas reach [0, 1/2].
    low, high = -int(np.floor(1 / q.min() + 0.5)), int(np.floor(1 / q.min()))
    run = 64 if is_opencl_cpu(device) else 1
    runs = -(-shape[2] // run)
    replicas = np.arange(low, high + 1)[:, None]
    height, width = np.broadcast_to(aperture, 2)
    sinc_y = np.sinc(height * (replicas + np.arange(shape[1]) / rows))
    sinc_x = np.sinc(width * (replicas + np.arange(runs * run) / cols))
    arrays = [device.array(q), device.array(sinc_y), device.array(sinc_x), tables]
    sizes = [1 / rows, 1 / cols, low, high, *shape]
    group = None if device.is_gpu or device.kind == "warp" else (1, 1, 1)
    grid = (*shape[:2], runs)
    device.launch("optics.airy", "airy", grid, *arrays, *sizes, defines={"RUN": run}, group=group)
    return tables


def cases():
    """Yield cases.

    Pixels from 20x coarser to 9x finer than the diffraction limit, odd periods, small and oblong
    apertures.
    """
    why = (
        "a term errs by a few ulp of its value (at most 1) and by 2e-7 in its argument s, |dO/ds| <= 4/pi: 4e-7 in "
        "all; the replicas' weights sum to at most 2 from q = .25 on; at .05 to 7, over 1200 independent errors"
    )
    for q, aperture, rows, cols in (
        ((0.05,), 1.0, 6, 9),
        ((0.25, 0.4), 1.0, 65, 64),
        ((0.71, 0.99, 1.1), 0.866, 63, 81),
        ((9.0,), (0.9, 0.4), 5, 3),
        ((1.1,), 1.0, 1, 1),
        (tuple(np.linspace(0.5, 0.9, 31)), 1.0, 12, 400),
    ):
        yield Case(
            f"q {q[0]:.2f} .. {q[-1]:.2f}, {rows}x{cols}",
            {"q": np.array(q, np.float32), "aperture": aperture, "rows": rows, "cols": cols},
            1e-6,
            why,
        )


def bench(rows, cols):
    """Return inputs: 31 bands of a 1.4 um f/1.8 camera."""
    q = np.linspace(400, 700, 31, dtype=np.float32) * 1e-9 * 1.8 / 1.4e-6
    return {"q": q, "aperture": 1.0, "rows": rows, "cols": cols}

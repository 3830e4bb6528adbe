"""Refocused pictures by Fourier slices: many focus settings of one light field, without loss of fine detail."""

from collections.abc import Sequence

import numpy as np
import scipy

from gpusim.captures.refocus import checked_slopes, checked_views
from gpusim.domain.cores import count_cores
from gpusim.domain.errors import OutOfRange
from gpusim.domain.memory import require_memory
from gpusim.domain.progress import announce_each
from gpusim.domain.view_images import ViewImages

WIDTH = 6  # nodes of the interpolation kernel along an axis
FINER = 2  # nodes a view along an axis
BETA = 2.30 * WIDTH  # of the Kaiser-Bessel kernel: its best for FINER = 2


def refocus_by_slices(
    views: ViewImages,
    slopes: Sequence[float],
    aperture: float | np.ndarray | None = None,
) -> np.ndarray:
    """Return pictures focused at slopes, as slices of the light field's four-dimensional spectrum.

    The spectrum of the picture at the slope s is the light field's at the frequency f of the picture
    and -s f of the pupil: a plane. The transform over all four axes is made once, with FINER nodes a
    view, and the plane is interpolated by a Kaiser-Bessel kernel of WIDTH nodes, to 1e-5 of the
    brightest light. Pictures are interpolated by their own waves and lose no detail, other than
    `focus_stack`'s. Their edges continue, as there.

    Args:
        views: The views.
        slopes: Displacements of things in focus [pixel per radius], shape (K,).
        aperture: As for `refocus`.

    Returns:
        Linear pictures, float32, shape (K, rows, cols, C).

    Raises:
        BadData: As for `refocus`.
        OutOfRange: A displacement is larger than the picture.
        DoesNotFit: The spectrum does not fit into memory.

    Source:
        Ng 2005, "Fourier slice photography"; Jackson et al. 1991, "Selection of a convolution
        function for Fourier inversion using gridding", for the kernel.
    """
    checked_views(views)
    at = checked_slopes(slopes)
    weights = views.weigh(aperture)
    weights /= weights.sum()
    rows, cols, channels = views.values.shape[2:]
    reach = np.abs(at).max() * np.abs(views.places).max()
    if not reach < max(rows, cols):
        allowed = f"displacements below {max(rows, cols)} pixels"
        raise OutOfRange("slopes", f"{np.abs(at).max():.4g} pixels per radius", allowed)
    rim = int(np.ceil(reach)) + 1
    size = [scipy.fft.next_fast_len(n + 2 * rim, real=True) for n in (rows, cols)]
    nodes = [scipy.fft.next_fast_len(max(FINER * n, WIDTH)) for n in views.shape]
    spectrum = 8 * size[0] * (size[1] // 2 + 1)
    needed = (
        spectrum * (2 * nodes[0] * nodes[1] + weights.size) + 4 * len(at) * rows * cols * channels
    )
    require_memory(f"the spectrum of {views.name}", needed)
    out = np.empty((len(at), rows, cols, channels), np.float32)
    for channel in announce_each(range(channels), lambda done: f"slices, {done} channels done"):
        light = views.values[..., channel] * weights[..., None, None].astype(np.float32)
        fine = _transform(light, rim, size, nodes)
        for k, slope in enumerate(at):
            found = _slice(fine, slope, views, size)
            out[k, ..., channel] = found[rim : rim + rows, rim : rim + cols]
    return out


def _transform(light, rim, size, nodes):
    """Return the spectrum over picture and pupil, complex64 (nodes, nodes, rows, columns).

    It is divided by the transform of the kernel that will interpolate it. Views are numbered from
    their middle one.
    """
    more = [(0, 0), (0, 0)] + [
        (rim, n - rim - m) for n, m in zip(size, light.shape[2:], strict=True)
    ]
    # beyond the continued edge pictures repeat
    spectrum = scipy.fft.rfft2(np.pad(light, more, "edge"), workers=count_cores())
    for axis, (count, fine) in enumerate(zip(light.shape[:2], nodes, strict=True)):
        number = np.arange(count) - count // 2
        shape = [1, 1, 1, 1]
        shape[axis] = count
        spectrum /= _kernel_transform(number / fine).reshape(shape).astype(np.float32)
        moved = np.zeros((*spectrum.shape[:axis], fine, *spectrum.shape[axis + 1 :]), np.complex64)
        np.moveaxis(moved, axis, 0)[number % fine] = np.moveaxis(spectrum, axis, 0)
        spectrum = scipy.fft.ifft(
            moved, axis=axis, norm="forward", overwrite_x=True, workers=count_cores()
        )
    return spectrum


def _slice(fine, slope, views, size):
    """Return the picture at a slope, with its rim."""
    frequencies = np.fft.fftfreq(size[0]), np.fft.rfftfreq(size[1])
    indices, weights, phases = [], [], []
    for axis, (count, waves) in enumerate(zip(views.shape, frequencies, strict=True)):
        turns = waves * slope * 2 * views.extent / count  # from one view to the next
        place = turns * fine.shape[axis]
        first = np.floor(place).astype(int) - WIDTH // 2 + 1
        index = first + np.arange(WIDTH)[:, None]
        indices.append(index % fine.shape[axis])
        weights.append(_kernel(place - index).astype(np.float32))
        phases.append(np.exp(2j * np.pi * turns * (count // 2 - (count - 1) / 2)))
    y, x = (np.arange(len(waves)) for waves in frequencies)
    total = np.zeros((len(y), len(x)), np.complex64)
    for row, wy in zip(indices[0], weights[0], strict=True):
        for col, wx in zip(indices[1], weights[1], strict=True):
            total += wy[:, None] * wx * fine[row[:, None], col, y[:, None], x]
    total *= (phases[0][:, None] * phases[1]).astype(np.complex64)
    return scipy.fft.irfft2(total, size)


def _kernel(t):
    """Return the Kaiser-Bessel kernel at distances t from -WIDTH / 2 to WIDTH / 2."""
    return np.i0(BETA * np.sqrt(np.maximum(1 - (2 * t / WIDTH) ** 2, 0))) / np.i0(BETA)


def _kernel_transform(f):
    """Return its transform at frequencies f [1]."""
    root = np.sqrt(np.maximum(BETA**2 - (np.pi * WIDTH * f) ** 2, 1e-12))
    return WIDTH / np.i0(BETA) * np.sinh(root) / root

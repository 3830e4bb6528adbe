"""The complex amplitude of light around a point's image, of any pupil, also with a mask.

Lengths in the image are X = x / (2 lambda N), cycles of the pupil's phase per radius, as in `gpusim.optics.sampled`:

    A(X, Y) = integral over the pupil of  m(u, v) exp(2 pi i (W(u, v) + X u + Y v)) du dv

is a sum over rows, at Gauss nodes v between all bends of the mask's pieces, and over even samples u. Samples next to
the ends of a piece have the weights that integrate the polynomial through the nearest of them up to the true end.
"""

import numpy as np

from gpusim.domain.pupil import Pupil, masked_rows
from gpusim.optics.blas import one_core
from gpusim.optics.memo import remember
from gpusim.optics.opening import Opening
from gpusim.optics.psf import fastest_turn
from gpusim.optics.quadrature import FINE, ORDER, STEP, even_places, share_of_end


def image_amplitude(pupil: Pupil, wave: np.ndarray, half: int) -> np.ndarray:
    """Return the amplitude of (2 half + 1)^2 samples around a point's image, STEP = 1/4 apart in X.

    The sum of the squares of sizes over the whole image is 1. The irradiance has no frequencies beyond the cut-off:
    these samples, lambda N / 2 apart, determine it.

    Args:
        pupil: The pupil.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].
        half: Samples on each side of the middle.

    Returns:
        complex64 (2 half + 1, 2 half + 1), rows (Y) first.
    """
    cycles = fastest_turn(wave)
    return opening_amplitude(pupil, Opening(), np.asarray(wave, np.float64), cycles, (half, half))


def opening_amplitude(
    pupil: Pupil, opening: Opening, wave: np.ndarray, turn: float, halves: tuple[int, int]
) -> np.ndarray:
    """Return the amplitude around a point's image in the scale of an opening, samples STEP apart.

    Args:
        pupil: The pupil.
        opening: A rectangle that has all of its light.
        wave: The wavefront in the scale of the opening: see `Opening.scaled` [waves].
        turn: Its largest slope [waves per half side].
        halves: Samples on each side of the middle, (rows, cols).

    Returns:
        complex64 (2 halves[0] + 1, 2 halves[1] + 1), of energy 1 in the whole image.
    """
    known = wave.shape, np.round(wave, 12).tobytes()
    return _opening_amplitude(pupil, opening, *known, float(turn), tuple(map(int, halves)))


@remember(2**27)
def _opening_amplitude(pupil, opening, shape, values, turn, halves):
    wave = np.frombuffer(values).reshape(shape)
    (y0, x0), (by, bx) = opening.middle, opening.half
    down, across = (max(half * STEP + turn, 4.0) for half in halves)
    # along the rim phases turn by both axes' cycles
    v, mass, ends, amplitude = masked_rows(pupil, float(np.hypot(down / by, across / bx)))
    step, u = even_places(2 * int(np.ceil(FINE * across)) + ORDER)
    v = (v - y0) / by
    weights = _weigh((ends - x0) / bx, amplitude, u, step) * (mass * step / by)[:, None]
    powers = np.arange(len(wave))
    at_y, at_x = (2 * np.pi * STEP * np.arange(-half, half + 1) for half in halves)
    with one_core():
        path = v[:, None] ** powers @ (wave.T @ u ** powers[:, None])
        path -= np.rint(path)
        field = (weights * np.exp(2j * np.pi * path)).astype(np.complex64)
        from_v = np.exp(1j * np.outer(at_y, v)).astype(np.complex64)
        from_u = np.exp(1j * np.outer(u, at_x)).astype(np.complex64)
        found = from_v @ (field @ from_u)
    return found * np.float32(STEP * np.sqrt(by * bx / (np.pi * pupil.area)))


def amplitude_at(pupil: Pupil, wave: np.ndarray, rows: np.ndarray, cols: np.ndarray) -> np.ndarray:
    """Return the amplitude at places of the image; the integral of the square of its size over X and Y is 1.

    Args:
        pupil: The pupil.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].
        rows: Y of the rows.
        cols: X of the columns.

    Returns:
        complex64 (rows, columns).
    """
    wave, turn = np.asarray(wave, np.float64), fastest_turn(wave)
    down, across = (max(float(np.abs(at).max()) + turn, 4.0) for at in (rows, cols))
    v, mass, ends, amplitude = masked_rows(pupil, float(np.hypot(down, across)))
    step, u = even_places(2 * int(np.ceil(FINE * across)) + ORDER)
    weights = _weigh(ends, amplitude, u, step) * (mass * step)[:, None]
    powers = np.arange(len(wave))
    with one_core():
        path = v[:, None] ** powers @ (wave.T @ u ** powers[:, None])
        path -= np.rint(path)
        field = (weights * np.exp(2j * np.pi * path)).astype(np.complex64)
        from_v = np.exp(2j * np.pi * np.outer(rows, v)).astype(np.complex64)
        from_u = np.exp(2j * np.pi * np.outer(u, cols)).astype(np.complex64)
        found = from_v @ (field @ from_u)
    return found * np.float32(1 / np.sqrt(np.pi * pupil.area))


def _weigh(ends, amplitude, u, step):
    """Return the weights of even samples of rows (R, samples) whose pieces have these ends (R, n + 1), (R, n)."""
    jumps = np.diff(amplitude, axis=1, prepend=0, append=0)  # of the amplitude at each end
    place = (ends - u[0]) / step
    cell = np.floor(place).astype(int)
    own = np.arange(len(ends))[:, None]
    # samples far before an end have all of the integral up to it, those far behind none
    steps = np.zeros((len(ends), len(u) + 1), amplitude.dtype)
    np.add.at(steps, (own, cell - ORDER // 2 + 1), -jumps)  # the first may be before all samples
    weights = np.cumsum(steps[:, ::-1], axis=1)[:, -2::-1].copy()
    for offset in range(1 - ORDER // 2, ORDER // 2 + 1):
        np.add.at(weights, (own, cell + offset), -jumps * share_of_end(place - cell - offset))
    return weights

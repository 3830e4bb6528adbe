"""Series through the transfer function of wavefronts: in radius and angle, and in the wavefronts' scale, float64.

They make all values from the integrals at few places (`gpusim.optics.otf`).
"""

from dataclasses import dataclass
from itertools import pairwise, product

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.polynomial.polynomial import polyval2d
from scipy.special import jv

from gpusim.domain.pupil import Pupil, symmetric
from gpusim.optics.otf import (
    EXACT,
    FAST,
    LEAST,
    Budget,
    defocus_only,
    degree,
    hopkins,
    phases,
    separate,
    steepest,
    transfer,
)

ANGLES, RADII = 5, 7  # at which the lengths of series are sought before they are made
LAST = 3  # terms in radius that are below the error
CHUNK = 4096  # radii whose polynomials are in memory at a time
UNRESOLVED = 5e-7  # last coefficients of an interpolation: three of them, twice, are a fifth of the tables' 1e-5


@dataclass(frozen=True, eq=False)
class Expansion:
    """Transfer functions of wavefronts by a circular pupil, as series in radius and angle.

    Between the radii where O is not smooth (`edges`, see `_kinks`) it is a power series in u, s = (a + b - (b - a)
    cos(pi u)) / 2, as its (s - a)^(3/2) is then one in u^3; around the centre it is a Fourier series.
    around: (bands, orders, panels, coefficients), orders as numpy.fft has them.
    """

    edges: np.ndarray
    around: np.ndarray

    def __call__(self, s, angles, bands=slice(None)):
        """Values at radii `s` in 0 .. 1 (n,) along `angles` (rays,) [rad], complex (bands, rays, n)."""
        around = self.around[bands]
        _, orders, panels, count = around.shape
        panel = np.clip(np.searchsorted(self.edges, s, side="right") - 1, 0, panels - 1)
        a, b = self.edges[panel], self.edges[panel + 1]
        place = np.arccos(np.clip(1 - 2 * (s - a) / (b - a), -1, 1)) / np.pi
        turning = np.exp(1j * np.multiply.outer(angles, np.fft.fftfreq(orders, 1 / orders)))
        out = np.zeros((len(around), len(angles), len(s)), complex)
        for k, piece in product(range(panels), range(0, len(s), CHUNK)):
            here = piece + np.flatnonzero(panel[piece : piece + CHUNK] == k)
            radial = np.ascontiguousarray(chebvander(2 * place[here] - 1, count - 1).T)
            re, im = (
                part.reshape(-1, count) @ radial
                for part in (around[:, :, k].real, around[:, :, k].imag)
            )
            lines = (re + 1j * im).reshape(len(out), orders, -1)
            out[:, :, here] = [turning @ one for one in lines]
        return out


def expansion(pupil: Pupil, waves, error=UNRESOLVED) -> Expansion:
    """Series through the integral of wavefronts (bands, n, n) at few places; for a circular pupil.

    Terms are added until the last ones are below `error`: first at few angles and few radii, then everywhere, for all
    bands. Raises OutOfRange as `transfer` does.
    """
    edges = np.unique(np.clip([0, 1, *_kinks(pupil)], 0, 1))
    strongest = _strongest(waves)
    count, rays, repeats, nodes = _foresee(pupil, strongest, edges, error >= UNRESOLVED)
    if not defocus_only(pupil, waves):
        Budget(len(waves)).need(count * (len(edges) - 1) * rays / repeats * nodes)

    if rays > 1:  # first along few rays and around few circles
        while (found := _series(pupil, strongest, edges, count, ANGLES, error))[1] >= error:
            count += 1 + count // 4
        # no more terms than these need
        sizes = np.abs(found[0]).sum(axis=1).max(axis=(0, 1))
        count = min(count, LAST + _used(sizes, error / 2))
        while (found := _series(pupil, strongest, edges, RADII, rays, error))[2] >= error:
            rays += 1 + rays // 4
        sizes = np.abs(found[0]).sum(axis=3).max(axis=(0, 2))[: found[0].shape[1] // 2]
        rays = min(rays, _turns(strongest) + _used(sizes, error / 2))
    while True:
        around, radial_rest, angular_rest = _series(pupil, waves, edges, count, rays, error)
        if max(radial_rest, angular_rest) < error:
            return Expansion(edges, around)
        count += 1 + count // 4 if radial_rest >= error else 0
        rays += 1 + rays // 4 if angular_rest >= error else 0


def _used(sizes, error):
    """Number of terms up to the last one that is not below the error."""
    return 1 + int(np.flatnonzero(sizes >= error).max(initial=0))


def points_of_series(pupil: Pupil, waves) -> float:
    """Return the points that `expansion` is foreseen to take."""
    edges = np.unique(np.clip([0, 1, *_kinks(pupil)], 0, 1))
    count, rays, repeats, nodes = _foresee(pupil, _strongest(waves), edges, True)
    return len(waves) * count * (len(edges) - 1) * rays / repeats * nodes


def points_at(pupil: Pupil, waves, frequencies) -> float:
    """Return the points that fast integrals at so many frequencies, out to the cut-off, are foreseen to take."""
    return (
        len(waves)
        * frequencies
        * _foresee(pupil, _strongest(waves), np.array([0.0, 1.0]), True)[-1]
    )


def require_points(pupil: Pupil, waves, frequencies):
    """Raises OutOfRange where fast integrals at so many frequencies, out to the cut-off, take too many points."""
    nodes = _foresee(pupil, _strongest(waves), np.array([0.0, 1.0]), True)[-1]
    Budget(len(waves)).need(frequencies * nodes)


def _strongest(waves):
    return waves[np.argmax((waves**2).sum(axis=(1, 2)))][None]


def _foresee(pupil, wave, edges, fast):
    """Terms in radius and angle of one wavefront's series, repeats in half a turn, points per frequency.

    O is a mean of waves whose phases turn, as s goes outwards or around, in coordinates of the
    overlap that move with s. Its series ends with the series of the wave that turns fastest.
    """
    form, fold = separate(wave), _turns(wave)
    steps = 8 + form[0].shape[-1]
    around = 2 * steps
    theta = (np.arange(steps) + 0.5) * np.pi / steps
    u = (1 - np.cos(theta)) / 2
    s = np.array([(a + b - (b - a) * np.cos(np.pi * u)) / 2 for a, b in pairwise(edges)])
    round_ = symmetric(pupil, wave)
    turn = np.zeros(1) if round_ else np.arange(around + 1) * min(np.pi, 2 * np.pi / fold) / around
    phase = phases(s[..., None], turn, form, steps)
    outwards = steepest(phase, 2, np.pi / steps).max(initial=0)
    sideways = 0.0 if round_ else steepest(phase, 3, turn[1]).max(initial=0)
    count = 22 + int(degree(outwards, form, 4))
    rays = 1 if round_ else 4 + int(degree(sideways, form))
    along, across = (
        LEAST[fast] + degree(steepest(phase, axis, np.pi / steps).max(axis=(0, 3, 4, 5)), form) / 2
        for axis in (-1, -2)
    )
    return count, rays, max(1, fold / 2), (along * across).mean()


def peak_to_valley(waves) -> float:
    """Largest range of the wavefronts over the unit disc [waves], to a percent."""
    r, t = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 2 * np.pi, 65))
    values = [polyval2d(r * np.cos(t), r * np.sin(t), one) for one in waves]
    return float(np.ptp(values, axis=(1, 2)).max(initial=0)) if len(values) else 0.0


def _turns(waves) -> int:
    """How often the wavefronts repeat in a turn; 1 if they are the same at every angle."""
    r, t = np.meshgrid(np.linspace(0.3, 1, 9), np.arange(64) * np.pi / 32)
    values = np.fft.rfft([polyval2d(r * np.cos(t), r * np.sin(t), one) for one in waves], axis=1)
    size = np.abs(values).max(axis=(0, 2))
    return int(np.gcd.reduce(np.flatnonzero(size > 1e-12 * size.max(initial=0)))) or 1


def _series(pupil, waves, edges, count, rays, error):
    """Coefficients (bands, 2 rays, panels, count) of `Expansion`, and the largest of the last in radius and angle."""
    u = (1 - np.cos((np.arange(count) + 0.5) * np.pi / count)) / 2
    radius = np.concatenate([(a + b - (b - a) * np.cos(np.pi * u)) / 2 for a, b in pairwise(edges)])
    fold = _turns(waves)
    # what repeats `fold` times a turn does so in half a turn too, and is conjugate from one to the next if that is odd
    repeats = fold if fold % 2 else fold // 2
    own = -(-rays // repeats)
    rays = own * repeats
    turn = np.arange(own) * np.pi / rays
    x, y = (np.multiply.outer(part, radius).ravel() for part in (np.cos(turn), np.sin(turn)))
    found = _integrals(pupil, waves, x, y, error >= UNRESOLVED)
    found = found.reshape(len(waves), own, len(edges) - 1, count)
    other = found.conj() if fold % 2 else found
    found = np.concatenate([other if k % 2 else found for k in range(repeats)], axis=1)
    # opposite frequencies are conjugates: half a turn makes the whole
    around = np.fft.fft(np.concatenate([found, found.conj()], axis=1), axis=1) / (2 * rays)
    along = np.linalg.inv(chebvander(2 * u - 1, count - 1)).T
    last = slice(max(rays - fold, 0), rays + fold + 1)  # only every `fold`-th order is there
    angular_rest = np.abs(around[:, last]).max() if rays > 1 else 0.0
    return around @ along, np.abs(found @ along[:, -LAST:]).max(), angular_rest


def _integrals(pupil, waves, sx, sy, fast):
    if defocus_only(pupil, waves):
        defocus = waves[:, 2, :1] if waves.shape[-1] > 2 else 0.0 * waves[:, 0, :1]
        return hopkins(np.hypot(sx, sy), defocus)
    return transfer(pupil, waves, sx, sy, error=FAST if fast else EXACT, fast=fast)


def _kinks(pupil):
    """Radii at which rims of the two copies of a ring touch."""
    hole = pupil.obscuration
    return ((1 - hole) / 2, hole, (1 + hole) / 2) if hole else ()


def scales(waves, error=1e-7):
    """Range of the wavefronts [waves], the wavefronts to integrate, and their weights (bands, integrated) in the bands.

    Bands mostly have one wavefront in different units: W_l = k_l W. exp(2 pi i k D), |D| <= the range of W, has as a
    function of k over k0 +- h the Chebyshev coefficients 2 |J_n(2 pi h D)| (Jacobi and Anger); interpolation through m
    nodes errs by twice those from n = m on, and so does O, a mean of such functions.
    """
    range_ = peak_to_valley(waves)
    flat = np.asarray(waves, np.float64).reshape(len(waves), -1)
    largest = np.argmax((flat**2).sum(axis=1))
    k = flat @ flat[largest] / max((flat[largest] ** 2).sum(), np.finfo(float).tiny)
    if np.abs(flat - np.outer(k, flat[largest])).max() < 1e-12:
        middle, half = (k.max() + k.min()) / 2, (k.max() - k.min()) / 2
        rest = 4 * np.cumsum(np.abs(jv(np.arange(300), 2 * np.pi * half * range_))[::-1])[::-1]
        count = max(1, int(np.argmax(rest < error)))
        if count < len(waves):
            x = np.cos((np.arange(count) + 0.5) * np.pi / count)
            at = (k - middle) / half if half else 0 * k
            weights = chebvander(at, count - 1) @ np.linalg.inv(chebvander(x, count - 1))
            return range_, np.multiply.outer(middle + half * x, waves[largest]), weights
    return range_, waves, np.eye(len(waves))

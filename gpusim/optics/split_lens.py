"""A lens as the photodiodes of one side see it: kernels of the light that pixels divide by its angle.

The wave of the whole pupil reaches a pixel. With the field E(x) there, x in units of 2 lambda N as in
`gpusim.optics.amplitude`, the pixel's window and a part S(t) of the light at angles of the pupil's point t, a diode
collects

    integral over t of  S(t) |transform of E in the window|^2  =  sum over k, l of  A[k, l] E(x_k) conj E(x_l)

with Gauss nodes x_k of the window: E is a polynomial there. S is 1/2 + c/2 erf((t - t0) / (sqrt(2) w)), whose transform
is 1/2 delta(x) + c/2 exp(-2 pi i t0 x - 2 (pi w x)^2) / (i pi x), so that A is a double integral of polynomials.
Across the split A is the window's rule. The parts of all diodes add up to 1, and their kernels to the whole one.

Far from the point the light comes from the pupil's edge, and both halves have it alike: the diode's kernel less its
share of the whole one falls faster, as r^-4. Tables are the whole lens's plus the transform of this difference.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product
from math import ceil
from typing import Any

import numpy as np
import scipy.fft
from numpy.polynomial.legendre import leggauss, legvander
from numpy.polynomial.polynomial import polyder, polyval2d

from gpusim.domain.dual import DiodeOptics
from gpusim.domain.interpolation import spline_weights
from gpusim.domain.pupil import Pupil, masked_rows
from gpusim.domain.stored import stored
from gpusim.optics.amplitude import amplitude_at
from gpusim.optics.geometric import ray_kernel

NEAR = 12.0  # of kernels' differences beyond the rays, in units of 2 lambda N
SPARE = (
    8  # of the Gauss nodes of a window, beyond pi for every cycle of the pupil's phase at its edge
)
TABLE = 4097  # places of the pupil between which its share is linear
PIECE = 32  # Gauss nodes along a row of the pupil
LEAST_PASSED = 0.1  # of the window, where its transfer is divided out
NODES = 9  # wavelengths between which differences of tables are cubic, as kernels are


@dataclass(frozen=True)
class Share:
    """Part of the light that a diode collects, by the point of the pupil.

    Attributes:
        signs: Halves along rows and columns, see `gpusim.domain.dual.SIDES`.
        contrast: 1 - 2 crosstalk.
        middle: Border between the halves, (rows, cols) [radii of the pupil].
        width: Its standard deviation [radii].
        window: Height and width of the pixel's window [2 lambda N].
    """

    signs: tuple[int, int]
    contrast: float
    middle: tuple[float, float]
    width: float
    window: tuple[float, float]

    def of(self, y: Any, x: Any) -> np.ndarray:
        """Return the part at points of the pupil, the mean over places of the light in its pixel."""
        return self._along(0, y) * self._along(1, x)

    def _along(self, axis, at):
        sign = self.signs[axis]
        if not sign:
            return np.ones(np.shape(at))
        places, values = _border(self.middle[axis], self.width, self.window[axis])
        return (1 + sign * self.contrast * np.interp(at, places, values)) / 2

    def rule(self, axis: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the window's Gauss nodes and weights (K,), and the matrix A (K, K) along an axis."""
        window = round(self.window[axis], 9)
        nodes, weights = window_nodes(window)
        sign = self.signs[axis]
        if not sign:
            return nodes, weights, np.diag(weights)
        odd = border_matrix(window, self.middle[axis], self.width)
        return nodes, weights, (np.diag(weights) + sign * self.contrast * odd) / 2


@lru_cache(maxsize=256)
def window_nodes(window: float) -> tuple[np.ndarray, np.ndarray]:
    """Return Gauss nodes and weights of a window, as many as the field in it needs."""
    nodes, weights = leggauss(ceil(np.pi * window) + SPARE)
    return nodes * window / 2, weights * window / 2


@lru_cache(maxsize=256)
def border_matrix(window: float, middle: float, width: float) -> np.ndarray:
    """Return the matrix of erf((t - middle) / (sqrt(2) width)) between the fields at the window's nodes (K, K).

    With the distance x of two points, 0 < x < window, both orders of the points together are smooth at x = 0.
    """
    nodes, weights = window_nodes(window)
    count = len(nodes)
    apart, weight = _half_line(window, abs(middle), width, count)
    inner, share = leggauss(count)
    free = window - apart  # of the first of the two points
    first = (inner + 1) / 2 * free[:, None] - window / 2
    basis = legvander(nodes * 2 / window, count - 1)
    # polynomials that are 1 at one node and 0 at the others
    to_nodes = (basis * weights[:, None] * (2 * np.arange(count) + 1) / window).T
    low, high = (
        legvander(np.clip(at * 2 / window, -1, 1), count - 1) @ to_nodes
        for at in (first, first + apart[:, None])
    )
    turn = weight / (1j * np.pi * apart) * np.exp(-2j * np.pi * middle * apart)
    both = (turn * free / 2)[:, None] * share
    matrix = np.einsum("ai,aik,ail->kl", both, high, low, optimize=True)
    return matrix + matrix.conj().T


@lru_cache(maxsize=256)
def _border(middle, width, window):
    """Places of the pupil, and the mean over the window of its border there: erf, and diffraction at the window."""
    places = np.linspace(-1, 1, TABLE)
    apart, weight = _half_line(window, abs(middle) + 1, width, 16)
    weight = weight * 2 / np.pi / apart * (1 - apart / window)
    turns = np.outer(places - middle, 2 * np.pi * apart)
    return places, np.sin(turns, out=turns) @ weight


def _half_line(window, fastest, width, more):
    """Nodes of distances in a window, and weights with the transform of the border's Gaussian.

    fastest: cycles of the phase per distance. more: further nodes.
    """
    end = min(window, 6 / (2 * np.pi * width)) if width else window
    nodes, weights = leggauss(ceil(np.pi * fastest * end) + more + 24)
    apart = (nodes + 1) / 2 * end
    return apart, weights * end / 2 * np.exp(-2 * (np.pi * width * apart) ** 2)


def divided_energies(pupil: Pupil, wave, q: float, share: Share, down, across) -> np.ndarray:
    """Return the light of a diode and of the whole pixel, at pixels around a point's image.

    Args:
        pupil: The pupil.
        wave: Coefficients [i, j] of x^i y^j of the wavefront [waves].
        q: Wavelength times working f-number over the distance of the samples.
        share: The diode's.
        down: Rows of the pixels from the image [sample], shape (n,).
        across: Columns of the pixels from the image [sample], shape (m,).

    Returns:
        Energies (2, n, m), of 1 in all of the image if windows tile it.
    """
    (y, high, over_y), (x, wide, over_x) = share.rule(0), share.rule(1)
    rows, cols = (
        (np.asarray(at)[:, None] / (2 * q) + nodes).ravel()
        for at, nodes in ((down, y), (across, x))
    )
    field = amplitude_at(pupil, wave, rows, cols).reshape(len(down), len(y), len(across), len(x))
    turned = field @ over_x.astype(np.complex64)
    if share.signs[0]:
        turned = np.einsum("lk,alcx->akcx", over_y.astype(np.complex64), turned, optimize=True)
        part = np.einsum("akcx,akcx->ac", turned, field.conj(), optimize=True).real
    else:
        part = np.einsum("akcx,akcx,k->ac", turned, field.conj(), high, optimize=True).real
    whole = np.einsum("akcx,k,x->ac", np.square(np.abs(field)), high, wide, optimize=True)
    return np.array([part, whole])


@stored
def split_differences(
    pupil: Pupil, waves, q, shifts, shares, totals, at, spots, soft, by_rays, aperture
) -> np.ndarray:
    """Return kernels of a diode's light, made 1 in all, less the whole kernels, float64 (L, n, n).

    Args:
        pupil: The pupil.
        waves: Coefficients of the wavefronts [waves], (L, k, k).
        q: Wavelength times working f-number over the distance of samples, (L,).
        shifts: Displacements of the image, (L, 2) (rows, cols) [sample].
        shares: A `Share` of each wavelength.
        totals: Part of all light that the diode collects, (L,).
        at: Rows, and columns, of the pixels, whole numbers one apart (n,).
        spots: Halves of the distances of a low-pass filter's images, (rows, cols) [sample].
        soft: Standard deviation of a diffuser [sample].
        by_rays: Whether rays are counted.
        aperture: Height and width of the pixels [sample].
    """
    out = np.empty((len(waves), len(at), len(at)))
    size = 2 * int(np.abs(at).max()) + 1
    inner = slice(at[0] + size // 2, at[-1] + size // 2 + 1)

    def make(band):
        wave, one, shift = waves[band], float(q[band]), shifts[band]
        if by_rays:
            settings = pupil, wave, one, shift, size, aperture, spots, soft
            part, whole = (ray_kernel(*settings, share=each) for each in (shares[band], None))
            scale = max(whole.sum(), 1e-300)
            part, whole = part[inner, inner], whole[inner, inner]
        else:
            part, whole, scale = 0.0, 0.0, np.prod(aperture)
            for weight, move in _images(spots):
                places = (np.asarray(at) - shift[k] - move[k] for k in (0, 1))
                both = divided_energies(pupil, wave, one, shares[band], *places)
                part, whole = part + weight * both[0], whole + weight * both[1]
        out[band] = (part / totals[band] - whole) / scale
        if soft and not by_rays:
            out[band] = _diffuse(out[band], soft)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(make, range(len(waves))))
    return out


def _images(spots):
    """Yield weights and displacements (rows, cols) of a low-pass filter's images."""
    axes = [[(0.5, -spot), (0.5, spot)] if spot else [(1.0, 0.0)] for spot in spots]
    for (first, y), (second, x) in product(*axes):
        yield first * second, (y, x)


def _diffuse(kernel, soft):
    """Return a kernel behind a diffuser. Frequencies that the samples fold are taken for the lower ones."""
    f = np.fft.fftfreq(2 * len(kernel))
    passed = np.exp(-2 * (np.pi * soft) ** 2 * (f[:, None] ** 2 + f**2))
    wide = np.fft.ifft2(np.fft.fft2(kernel, passed.shape) * passed).real
    return wide[: len(kernel), : len(kernel)]


@lru_cache(maxsize=64)
def _pupil_light(pupil):
    """Points of the pupil y, x and their light, of 1 in all, for smooth integrands."""
    v, mass, ends, amplitude = masked_rows(pupil)
    nodes, weights = leggauss(PIECE)
    middle, half = (ends[:, 1:] + ends[:, :-1]) / 2, np.diff(ends, axis=1) / 2
    x = middle[..., None] + half[..., None] * nodes
    light = (mass[:, None] * half * np.abs(amplitude) ** 2)[..., None] * weights
    y = np.broadcast_to(v[:, None, None], x.shape)
    is_lit = light != 0
    light = light[is_lit]
    return y[is_lit], x[is_lit], light / light.sum()


@dataclass(frozen=True, eq=False)
class SplitLens:
    """A lens as the photodiodes of one side see it, see `gpusim.optics.lens.Lens`.

    Args:
        whole: The lens, a PupilLens in front of the diodes' windows.
        optics: Its settings, and the diode.
    """

    whole: Any
    optics: DiodeOptics

    is_pointlike = is_airy = False
    has_pixel_windows = True
    fixed_distance = distance_model = ""
    distances = None

    @property
    def pitch(self) -> float:
        """See `Lens`."""
        return self.whole.pitch

    @property
    def aperture(self) -> tuple[float, float]:
        """See `Lens`: the window under a microlens."""
        return self.whole.aperture

    @property
    def displacement(self) -> tuple[float, float]:
        """See `Lens`."""
        return self.whole.displacement

    @property
    def axis(self) -> tuple[float, float]:
        """See `Lens`."""
        return self.whole.axis

    @property
    def spots(self) -> tuple[float, float]:
        """See `Lens`."""
        return self.whole.spots

    @property
    def least_size(self) -> int:
        """See `Lens`."""
        return self.whole.least_size

    @property
    def wavelengths(self) -> tuple[float, float]:
        """See `Lens`."""
        return self.whole.wavelengths

    @property
    def is_uniform(self) -> bool:
        """See `Lens`."""
        return not self.optics.varies

    @property
    def is_adjustable(self) -> bool:
        """See `Lens`."""
        return self.whole.is_adjustable

    @property
    def has_point_kernels(self) -> bool:
        """See `Lens`."""
        return self.whole.has_point_kernels

    @property
    def symmetry(self):
        """See `Lens`."""
        return replace(self.whole.symmetry, is_round=False, is_mirrored=False, is_opposite=False)

    @property
    def words(self) -> str:
        """See `Lens`."""
        return self.optics.description

    def describe(self, by_depth) -> tuple[str, str]:
        """See `Lens`."""
        return "optics.pupil", self.words

    def share(self, wavelength: float, place=(0.0, 0.0)) -> Share:
        """Return the part of the light that the diode collects, by the point of the pupil, at a field point."""
        optics = self.optics
        assert optics.diode is not None
        q = float(self.q([wavelength])[0])
        height, width = (side / (2 * q) for side in self.aperture)
        y, x = (round(optics.split_height * float(one), 9) for one in place)
        contrast = float(optics.diode.contrast([wavelength])[0])
        return Share(optics.diode.signs, contrast, (y, x), optics.split_width, (height, width))

    def totals(self, wavelengths, place=(0.0, 0.0)) -> np.ndarray:
        """Return the part of a flat field's light that the diode collects at a field point, shape (L,)."""
        y, x, light = _pupil_light(self.optics.pupil)
        return np.array([light @ self.share(float(one), place).of(y, x) for one in wavelengths])

    def mean_point(self, wavelength: float, place=(0.0, 0.0)) -> tuple[float, float]:
        """Return the centroid of the diode's light in the pupil at a field point, (y, x) [radii]."""
        y, x, light = _pupil_light(self.optics.pupil)
        own = light * self.share(wavelength, place).of(y, x)
        return float(own @ y / own.sum()), float(own @ x / own.sum())

    def _differences(self, wavelengths, place, distance, at, moved=(0.0, 0.0)):
        """Kernels less the whole lens's at pixels `at` (n,), (L, n, n). moved: displacement of the image."""
        wavelengths = np.asarray(wavelengths, np.float64)
        whole, polar = self.whole, (float(np.hypot(*place)), float(np.arctan2(*place)))
        waves = self.waves(wavelengths, *polar, distance=distance)
        shifts = whole.image_shifts(wavelengths, place)
        shares = tuple(self.share(float(one), place) for one in wavelengths)
        soft = self.optics.diffuser / self.pitch
        return split_differences(
            *(self.optics.pupil, waves, self.q(wavelengths), shifts + np.array(moved)),
            *(shares, self.totals(wavelengths, place), np.asarray(at), tuple(self.spots)),
            *(soft, whole.counts_rays(waves), tuple(self.aperture)),
        )

    def _rays(self, wavelengths, waves, shares=None):
        """Mean landing places of rays from the ideal image, (L, 2) (rows, cols) [sample]."""
        y, x, light = _pupil_light(self.optics.pupil)
        found = np.empty((len(waves), 2))
        for number, (q, wave) in enumerate(zip(self.q(wavelengths), waves, strict=True)):
            own = light if shares is None else light * shares[number].of(y, x)
            slopes = [polyval2d(x, y, polyder(wave, axis=axis)) for axis in (1, 0)]
            found[number] = [-2 * q * (own @ slope) / own.sum() for slope in slopes]
        return found

    def kernels(self, wavelengths, place, size, distance=None) -> np.ndarray:
        """See `Lens`."""
        at = np.arange(size) - size // 2
        found = self.whole.kernels(wavelengths, place, size, distance)
        at = at[np.abs(at) <= _reach_of(self, wavelengths, distance, float(np.hypot(*place)))[-1]]
        inner = slice(at[0] + size // 2, at[-1] + size // 2 + 1)
        found[:, inner, inner] += self._differences(wavelengths, place, distance, at)
        return found

    def sketches(self, wavelengths, radius) -> np.ndarray:
        """See `Lens`."""
        at = np.arange(-radius, radius + 1)
        rest = self._differences(wavelengths, (0.0, 0.0), None, at)
        found = self.whole.sketches(wavelengths, radius) + rest
        return (found / found.sum(axis=(1, 2), keepdims=True)).astype(np.float32)

    def centroids(self, wavelengths, place, distance=None) -> np.ndarray:
        """See `Lens`. Rays count as much as the diode collects of them."""
        polar = float(np.hypot(*place)), float(np.arctan2(*place))
        waves = self.waves(wavelengths, *polar, distance=distance)
        shares = [self.share(float(one), place) for one in wavelengths]
        moved = self._rays(wavelengths, waves, shares) - self._rays(wavelengths, waves)
        return self.whole.centroids(wavelengths, place, distance) + moved

    def moments(self, wavelengths, place, distance=None, size=1) -> np.ndarray:
        """See `Lens`."""
        whole = self.whole.moments(wavelengths, place, distance, size)
        if self.q(wavelengths).min() >= 1:
            moved = self.centroids(wavelengths, place, distance)
            return whole + moved - self.whole.centroids(wavelengths, place, distance)
        at = _reach_of(self, wavelengths, distance, float(np.hypot(*place)))
        rest, inner = self._differences(wavelengths, place, distance, at), len(at) // 4
        near = rest[:, inner:-inner, inner:-inner]
        wide, half = (
            np.stack([one.sum(axis=2) @ each, one.sum(axis=1) @ each], axis=1)
            for one, each in ((rest, at), (near, at[inner:-inner]))
        )
        # what falls as r^-4 leaves a first moment of 1 / r
        return whole + (len(at) * wide - near.shape[-1] * half) / (len(at) - near.shape[-1])

    def transfer(self, wavelengths, fy, fx, place=(0.0, 0.0), distance=None) -> np.ndarray:
        """See `Lens`. Where the window passes nearly nothing, it is the whole lens's."""
        wavelengths, (fy, fx) = np.atleast_1d(wavelengths), np.broadcast_arrays(fy, fx)
        fy, fx = np.atleast_1d(fy).astype(float), np.atleast_1d(fx).astype(float)
        found = self.whole.transfer(wavelengths, fy, fx, place, distance)
        height, width = (side * self.pitch for side in self.aperture)
        window = np.sinc(height * fy) * np.sinc(width * fx)
        kept = np.where(np.abs(window) > LEAST_PASSED, 1 / np.where(window == 0, 1, window), 0)
        for own, wavelength in zip(found, wavelengths, strict=True):
            # samples so fine that no frequency is folded
            pitch = min(self.pitch, 0.45 / self.cutoff(float(wavelength)))
            lens = self.at_pitch(pitch)
            at = _reach_of(lens, [wavelength], distance, float(np.hypot(*place)))
            rest = lens._differences([wavelength], place, distance, at)[0]
            down, across = (np.exp(-2j * np.pi * pitch * np.outer(f, at)) for f in (fy, fx))
            own += kept * np.einsum("fy,yx,fx->f", down, rest, across, optimize=True)
        return found

    def at_pitch(self, pitch: float) -> "SplitLens":
        """Return the lens in front of samples of another pitch [m], undisplaced, without lateral colour."""
        optics = replace(self.optics, lateral_color=0.0)
        sides = self.aperture[0] * self.pitch / pitch, self.aperture[1] * self.pitch / pitch
        whole = replace(self.whole, optics=optics, pitch=pitch, aperture=sides)
        return SplitLens(replace(whole, displacement=(0.0, 0.0)), optics)

    def tables(self, q, rows, cols, stages, distance=None):
        """See `Lens`."""
        whole = self.whole.tables(q, rows, cols, stages, distance)
        return stages.add(whole, self._spectra(q, rows, cols, distance), False)

    def _spectra(self, q, rows, cols, distance):
        """Half spectra of the kernels less the whole lens's, complex64 (L, rows, cols // 2 + 1)."""
        kernels = self._table_kernels(q, distance)
        at = np.arange(kernels.shape[-1]) - kernels.shape[-1] // 2
        wide = np.zeros((len(q), rows, cols), np.float32)
        np.add.at(wide, (slice(None), at[:, None] % rows, at % cols), kernels)
        return scipy.fft.rfft2(wide, workers=-1)

    def _table_kernels(self, q, distance=None):
        """Kernels on the axis less the whole lens's, (L, n, n); between NODES wavelengths they are cubic."""
        wavelengths = self.whole.nanometres(np.asarray(q, np.float64))
        nodes, between = wavelengths, np.eye(len(wavelengths))
        if len(wavelengths) > NODES:
            nodes = np.linspace(wavelengths.min(), wavelengths.max(), NODES)
            between = spline_weights(nodes, wavelengths)
        at = _reach_of(self, wavelengths, distance)
        return np.tensordot(between, self._differences(nodes, (0.0, 0.0), distance, at), 1)

    def table_parts(self, q, rows, cols, stages) -> tuple | None:
        """See `Lens`."""
        if self.whole.table_parts(q, rows, cols, stages) is not None:
            return None
        whole = self.whole.tables(q, rows, cols, stages)
        return whole, self._table_kernels(q).astype(np.float32)

    def table_error(self, wavelengths, distance=None) -> float:
        """See `Lens`. What leaves the window of the differences falls as r^-4."""
        own = self.whole.table_error(wavelengths, distance)
        at = _reach_of(self, wavelengths, distance)
        middle = np.asarray(wavelengths)[[len(wavelengths) // 2]]
        rest = np.abs(self._differences(middle, (0.0, 0.0), distance, at)[0])
        rim = np.concatenate([rest[0], rest[-1], rest[1:-1, 0], rest[1:-1, -1]]).mean()
        # the integral of r^-4 beyond r is pi r^2 times its value there
        return float(np.hypot(own, np.pi * (len(at) / 2) ** 2 * rim))

    @cached_property
    def _rim(self) -> float:
        """Light far from a point, over the share of all light."""
        share = self.share(550.0)
        angle = np.linspace(0, 2 * np.pi, 256, endpoint=False)
        return float(share.of(np.sin(angle), np.cos(angle)).mean() / self.totals([550.0])[0])

    @cached_property
    def tail(self):
        """See `Lens`."""
        whole = self.whole.tail
        return replace(whole, strength=whole.strength * self._rim)

    def tails(self, wavelengths) -> np.ndarray:
        """See `Lens`."""
        return self.whole.tails(wavelengths) * self._rim

    def spread(self, wavelengths, height=0.0, distance=None) -> float:
        """See `Lens`."""
        return self.whole.spread(wavelengths, height, distance)

    def cutoff(self, wavelength) -> float:
        """See `Lens`."""
        return self.whole.cutoff(wavelength)

    def sampled_spread(self, wavelengths, place, reach, count) -> tuple[np.ndarray, float]:
        """See `Lens`. The picture is of pixels, whose windows divide the light, at places finer than theirs."""
        lens = self.at_pitch(2 * reach / count)
        return lens.kernels(wavelengths, place, count), lens.pitch

    def q(self, wavelengths) -> np.ndarray:
        """See `Lens`."""
        return self.whole.q(wavelengths)

    def nanometres(self, q) -> np.ndarray:
        """Return the wavelengths [nm] of q, shape (L,)."""
        return self.whole.nanometres(q)

    def waves(self, wavelengths, height=0.0, azimuth=0.0, distance=None) -> np.ndarray:
        """See `Lens`."""
        return self.whole.waves(wavelengths, height, azimuth, distance)

    def point_energies(self, wavelengths, spot, at) -> tuple[np.ndarray, np.ndarray]:
        """See `Lens`."""
        y, x, down, across, distance = np.asarray(spot).tolist()
        found, middle = self.whole.point_energies(wavelengths, spot, at)
        rest = self._differences(wavelengths, (y, x), distance or None, at, (down, across))
        return found + rest, middle


def _reach_of(lens, wavelengths, distance, height=0.0) -> np.ndarray:
    """Return the rows, and columns, at which kernels differ from the whole lens's [sample], shape (n,)."""
    rays = lens.spread(wavelengths, height, distance) + max(lens.aperture)
    most = ceil(rays + 2 * NEAR * float(np.max(lens.q(wavelengths)))) + 2
    return np.arange(-most, most + 1)

"""The endless world: the part of a blur that Gaussians over it replace, and the errors of that.

The blur by transforms ends `reach` samples from the frame; the rest of the lens is a sum of
Gaussians (`gpusim.optics.farfield`). There are two errors. Transforms join the world's two ends,
`reach` samples from the frame, and a step there spreads waves at the cut-off of the lens, which the
Gaussians do not hold. And a tail of three powers neglects higher ones of lenses that are far from
focus.

Waves: a lens with rims rho in its pupil, with a wavefront of W waves there, spreads at the distance
r, in addition to its tail,

    2 q / (pi^3 r^3 (1 - e^2)) | sum of a cos(pi rho r / q - 3 pi / 4) exp(2 pi i W) |^2,

a = 1 of the outer rim and -sqrt(e) of the inner one, e the obscuration (Airy's pattern and an
annulus's by the asymptotic form of J1).

Tiles: a transform repeats a tile, so light that is `overlap` samples or more from a pixel of its
result is seen at the repeated place. Waves reach that far, and so does the part of the tail that
the Gaussians do not hold. The result is computed in windows of the picture twice as wide as a tile,
blurred both ways (`ring_errors`).
"""

from dataclasses import dataclass
from functools import partial
from itertools import combinations
from math import pi, sqrt

import numpy as np
import scipy
from numpy.polynomial.polynomial import polyval2d

from gpusim.domain.optics import Optics
from gpusim.optics.farfield import POWERS, RATIO, SPACINGS, energies, gaussians, misses
from gpusim.optics.lengths import Tiling
from gpusim.optics.outside import FREQUENCIES, WINDOW, Outside, border_indices, rule_of
from gpusim.optics.points import rim_centre, rim_radius
from gpusim.optics.windows import average_boxes, quantile
from gpusim.planner.question import Question

# [sample] of a frame along an axis, and of its blurred surroundings
LEAST_SIDE = 8
LEAST_REACH = 16
# the least reach in q (twice that over the part between the rims), and in radii of the rays
RINGS = 4.0
RADII = 4.0
LEAST_OVERLAP = 2.0  # of tiles, in q: nearer a point its waves are not yet what they are said to be
# Relative RMS over a frame of SIDE samples a side from a step of 1 at the seam, of one wavelength, in q^2.5 / reach^2.
# This, and its dependences, were measured on edges, leaves and blocks of 60 to 130 samples, q .5 to 6, reach 16 to 96,
# fill .4 and 1, 1 to 3 samples a pixel, obscurations 0, .3 and .5: within a factor of 2 of most. Where the cut-off of a
# lens meets the grid's diagonal, at q = .71, pixels with gaps see up to five times as much
SEAM, SIDE = 3.1e-4, 112
TILES_RATIO = 1.8  # of neighbouring Gaussians for tiles, fewer than elsewhere
# of splines for tiles in a Gaussian, from the coarsest on
TILES_SPACINGS = (
    1.0,
    1.2,
    1.6,
    SPACINGS,
)
WIDE = 2.0  # q of a pixel from which on it grows faster, as q^3.5, of a clear pupil in focus
# of it in a dark world, whose step is the frame's edge, a reach away from the seam
DARK_SEAM = 0.15
HOLE = 60.0  # times the square of the obscuration is more of it: rims nearer to one another ring farther
IN_FOCUS = 2.0  # radius of the rays in q, up to which waves of all wavelengths come from one place
# q of a pixel of samples below which it averages waves away; the least part left
FINER = 3.0
LEAST = 0.3
DISTANCES = 64  # from the seam, at which waves are added up
POINTS, PLACES = 32, 128  # of light in a strip, and places at which they are seen
# reaches of waves that count; radii in a wave, and all of them at most
FARTHEST = 8
FINE = 12
MOST_RADII = 8192
# frequencies of light that changes slowly [1/sample]
SLOW = tuple(np.geomspace(1 / 4096, 1 / 128, 32))
SPLINES = 1e-7  # relative RMS of the far field's own sums
HOT = 3.0  # true over predicted error near few bright points was up to 3.1: their rings end in few tiles


@dataclass(frozen=True, eq=False)
class FarField:
    """Gaussians in place of the world beyond a blur's reach.

    Attributes:
        sigmas: Standard deviations, shape (G,) [sample], the last one infinite.
        tails: Of every wavelength, shape (L, 3), see `Lens.tails`.
        border: Rule that continues the world.
        spacings: Of splines in the first of the sigmas, see `optics.far`.
    """

    sigmas: np.ndarray
    tails: np.ndarray
    border: str
    spacings: float

    def energies(self, transfers, border: str | None = None) -> np.ndarray:
        """Return their part of a plan's transfer tables, shape (groups, planes, G).

        transfers: see `Fusion`; None: each plane is one wavelength. border: see `gpusim.optics.farfield.energies`.
        """
        each = energies(self.sigmas, self.tails, border)
        return each[None] if transfers is None else np.tensordot(transfers, each, 1)

    def weights(self, mix, transfers) -> np.ndarray:
        """Return their part of a plan's channels, by planes, shape (C, planes, G).

        mix: see `Blur`. transfers: see `energies`.
        """
        return np.asarray(mix)[..., None] * self.energies(transfers, self.border)


def has_far_field(question: Question, by_depth: bool) -> bool:
    """Return whether light from afar is smooth and the same all over the frame.

    Straight blades throw it along lines.
    """
    lens = question.lens
    return (
        lens.tail is not None
        and not lens.tail.lines
        and lens.is_uniform
        and not by_depth
        and not question.period
        and min(question.size) >= LEAST_SIDE
    )


def far_field(
    question: Question, tails, reach: float, side: int | None = None, spacings: float = SPACINGS
) -> FarField | None:
    """Return the Gaussians beyond a blur of so many samples around the frame; None if these are too few.

    Args:
        question: The question.
        tails: See `FarField`.
        reach: Samples around the frame.
        side: Of tiles with that overlap [sample]; None: the frame is one transform.
        spacings: See `FarField`, one of TILES_SPACINGS for tiles.
    """
    optics = question.optics
    rings = RINGS * question.mean_q
    if optics.pupil.obscuration:
        rings *= 2 / (1 - optics.pupil.obscuration)
    least = max(rings, LEAST_REACH) if side is None else LEAST_OVERLAP * float(question.q.max())
    if reach < max(RADII * question.spread, least):
        return None
    widest = max(*question.size, side or 0) + 2 * reach
    sigmas = gaussians(reach, widest, RATIO if side is None else TILES_RATIO)
    return FarField(sigmas, tails, rule_of(question.scene.border), spacings)


def seam_error(outside: Outside, question: Question, period: tuple[int, int]) -> float:
    """Return the relative RMS error of a frame whose world beyond transforms of this period is left to Gaussians."""
    if not outside.level > 0:
        return 0.0
    reach = min(length - n for length, n in zip(period, outside.image.shape, strict=True)) / 2
    q, away, cell = question.mean_q, reach + outside.margin, question.cell
    # what lies between its rims rings at frequencies lower by half that
    hole = question.optics.pupil.obscuration
    finer = 1 - (1 - min(max(q / question.ratio / FINER, LEAST), 1)) * min(question.ratio - 1, 1)
    left = finer * _coherence(question, away, 1)
    left += HOLE * hole**2 * _coherence(question, away, (1 - hole) / 2)
    seam = SEAM * q**2.5 / away**2 * _step(outside, period) * left / sqrt(cell[0] * cell[1])
    powers = 2 * pi * outside.tail * (question.spread / reach) ** 6 / reach
    images = _image_error(outside, question, reach)
    aside = _asymmetry(question, reach)
    if aside:  # the transforms have this part of the light, as if there were no Gaussians
        aside *= outside.error(period, reach)[0]
    errors = seam, powers, images, aside, SPLINES
    return sqrt(sum(error**2 for error in errors)) + outside.missing / outside.level


def _asymmetry(question, reach):
    """Part of the light from beyond a reach that is not the same at all angles, and is left to the transforms.

    The tail's middle is aside by c, where rays through the rim land in the mean, or where pixels are displaced: light
    changes by up to 3 c / r. Rays that land b about the middle, more along one axis than along the other, change it by
    up to 15 / 2 (b / r)^2.
    """
    lens, pupil, found = question.lens, question.optics.pupil, 0.0
    if lens.symmetry.is_round:
        return 3 * float(np.hypot(*lens.displacement)) / reach
    waves_ = question.optics.waves(question.scene.wavelengths, longest=np.inf)
    for q, wave in zip(question.q, waves_, strict=True):
        aside = np.hypot(*(rim_centre(pupil, wave, q) - np.array(lens.displacement)))
        found = max(found, 3 * aside / reach + 7.5 * (rim_radius(pupil, wave, q) / reach) ** 2)
    return float(found)


def _image_error(outside, question, reach):
    """Relative RMS error from waves of point lights that are seen at the transform's repeated place.

    A point near one side of the frame has an image beyond the opposite side, 2 reach farther.
    Computed for the brightest points in a strip along each side, at some places in a strip along
    the opposite one.
    """
    depth, image, total = max(int(2 * reach), 1), outside.image, 0.0
    random = np.random.default_rng(depth)  # the same places in every scene
    step = max(float(question.q.min()) / FINE, 6 * reach / MOST_RADII)
    r = np.arange(2 * reach, FARTHEST * reach, step)
    radial = question.cache("waves along a line", waves, Point.of(question), r, 0.0, 1.0)
    kernels = question.edges @ radial
    for lines in (image, image[::-1], image.T, image.T[::-1]):
        strip = lines[:depth]
        at = np.argpartition(strip, -min(POINTS, strip.size), axis=None)[-POINTS:]
        deep, along = np.unravel_index(at, strip.shape)
        light = np.maximum(strip.flat[at] - outside.level, 0)
        rows = random.uniform(0, len(strip), PLACES)
        cols = random.uniform(0, strip.shape[1], PLACES)
        far = np.hypot(2 * reach + np.add.outer(rows, deep), np.subtract.outer(cols, along))
        seen = np.array([np.interp(far, r, kernel, right=0.0) @ light for kernel in kernels])
        total += float(question.share @ np.mean(seen**2, axis=1)) * strip.size / image.size
    return sqrt(total) / outside.level


def spline_error(far: FarField, outside: Outside, question: Question) -> float:
    """Return the relative RMS error, the same everywhere, of a frame by tiles from the splines of far light."""
    if not outside.level > 0:
        return 0.0
    each = question.edges @ energies(far.sigmas, far.tails)
    power, slow = outside.spectrum
    missed = partial(misses, question.size, far.sigmas, each, far.spacings)
    wrong = (missed(FREQUENCIES, FREQUENCIES) * power).sum(axis=(1, 2))
    wrong += slow * missed(SLOW, (0.0,)).max(axis=(1, 2))
    rms = sqrt(float(question.share @ wrong) / outside.level**2 + SPLINES**2)
    return rms + outside.missing / outside.level


def _coherence(question, reach, part):
    """Part of one wavelength's waves that remains in the sum over all, in the mean over frame and channels.

    part: of the cut-off, at which they are: their period is q over it. With a spread of rays they
    come from all of its rim, and all of them remain.
    """
    if question.spread > IN_FOCUS * question.mean_q:
        return 1.0
    light = question.weights / np.maximum(question.weights.sum(axis=1, keepdims=True), 1e-300)
    away = np.linspace(reach, reach + max(question.size) / 2, DISTANCES)
    waves = np.exp(2j * pi * away * part / question.q[:, None])
    left = float(np.sqrt(np.mean(np.abs(light @ waves) ** 2)))
    if question.optics.pupil.obscuration:
        return left
    return left * max(question.mean_q / question.ratio / WIDE, 1)


def _step(outside, period):
    """Step of the world at the seam of the transforms, over the frame's root mean square, as of a frame of SIDE."""
    image, rule, found = outside.image, rule_of(outside.border), 0.0
    for lines, length in zip((image, image.T), period, strict=True):
        n, before = len(lines), (length - len(lines)) // 2
        if rule == "zero":
            ends = lines[[0, -1]].astype(np.float64) * DARK_SEAM
        else:
            beyond = border_indices(np.array((length - before - 1, -before)), n, rule)
            ends = np.diff(lines[beyond].astype(np.float64), axis=0)
        found += np.mean(ends**2) * len(ends) * SIDE / n
    return sqrt(found) / outside.level


@dataclass(frozen=True)
class Point:
    """A point of light behind a lens, as its pixels see it.

    Attributes:
        optics: The lens.
        wavelengths: Wavelengths [nm], shape (L,).
        q: Wavelength times working f-number over the distance of samples, shape (L,).
        cell: Height and width over which samples are integrated [sample].
        aperture: Height and width of the pixel's aperture.
        ratio: Samples per pixel.
        pitch: Distance of samples [m].
    """

    optics: Optics
    wavelengths: np.ndarray
    q: np.ndarray
    cell: tuple[float, float]
    aperture: tuple[float, float]
    ratio: float
    pitch: float

    @classmethod
    def of(cls, question: Question) -> "Point":
        """Return the point of light of a question's scene."""
        return cls(
            question.optics,
            question.scene.wavelengths,
            question.q,
            question.cell,
            question.aperture,
            question.ratio,
            question.pitch,
        )


def waves(point: Point, r, down, across) -> np.ndarray:
    """Return the energy per square sample of a point's waves, shape (L, *shape).

    Args:
        point: The point.
        r: Distances [sample], of any shape.
        down: The direction's row component, of that shape or one for all.
        across: The direction's column component.
    """
    optics = point.optics
    hole = optics.pupil.obscuration
    rims = [(1.0, 1.0), *([(hole, -sqrt(hole))] if hole else [])]
    found = np.zeros((len(point.q), *np.shape(r)))
    for own, q, wave in zip(
        found, point.q, optics.waves(point.wavelengths, longest=np.inf), strict=True
    ):
        for rho, a in rims:
            seen = _pixel_response(point, rho / q, down, across)
            own -= a * a / 2 * np.sin(2 * pi * rho * r / q) * seen
        for (one, a), (other, b) in combinations(rims, 2):
            path = polyval2d(one, 0.0, wave) - polyval2d(other, 0.0, wave)
            less, more = (one - other) / (2 * q), (one + other) / (2 * q)
            slow = np.cos(2 * pi * less * r) * _pixel_response(point, less, down, across)
            fast = np.sin(2 * pi * more * r) * _pixel_response(point, more, down, across)
            own += a * b * np.cos(2 * pi * path) * (slow - fast)
        own *= 2 * q / (pi**3 * (1 - hole**2)) / r**3
    return found


def _pixel_response(point, frequency, down, across):
    """Part of a wave of this frequency [1/sample] in this direction that pixels keep."""
    optics, left = point.optics, 1.0
    for along, cell, side, spots in zip(
        (down, across), point.cell, point.aperture, optics.birefringence, strict=True
    ):
        wave = frequency * along
        left = left * np.sinc(cell * wave) * np.cos(pi * spots / point.pitch * wave)
        if point.ratio > 1:  # samples, which show it as a slower one, are integrated over pixels
            left = left * np.sinc(side * point.ratio * (wave - np.rint(wave)))
    return left * np.exp(-2 * (pi * optics.diffuser / point.pitch * frequency) ** 2)


def ring_errors(
    outside: Outside, question: Question, tiling: Tiling, far: FarField
) -> tuple[float, float, float]:
    """Return the relative RMS error of a frame by such tiles; its 99.9 % quantile and maximum in noise.

    far: Gaussians for the light that tiles leave out. The last two figures are as in
    `Outside.error`.
    """
    if not outside.level > 0:
        return 0.0, 0.0, 0.0
    windows, error, local = question.facts.hold(
        f"rings of tiles of {tiling.side} that share {tiling.overlap}",
        (
            *(outside.held, question.optics, question.pitch, question.cell, question.aperture),
            *(part.tobytes() for part in (far.sigmas, far.tails, question.edges, question.share)),
        ),
        lambda: _rings(outside, question, tiling, far),
    )
    sigma = error / np.sqrt(np.maximum(local / outside.level, 0) + outside.noise)[:, None]
    weight = windows.weight[:, None] * question.share
    return (
        sqrt(float((weight * np.mean(error**2, axis=(2, 3))).sum())),
        quantile(sigma, weight, 0.999),
        float(sigma.max() * windows.steepest),
    )


def _rings(outside, question, tiling, far):
    """Return windows, their errors over the frame's level, and their light as a lens shows it."""
    side, valid = tiling.side, tiling.valid
    (windows, light), table = outside.windows(valid), _repeated_response(question, tiling, far)
    part, rim = slice(WINDOW // 2 - side, WINDOW // 2 + side), side - valid // 2
    light = light[:, part, part]
    within = slice(side // 2, side // 2 + side)
    tiled = _middle(light[:, within, within], table[:, ::2, ::2], valid)
    error = np.abs(_middle(light, table, valid) - tiled)
    # of a narrow frame all
    rows, cols = np.minimum(np.array(outside.image.shape) - 2 * outside.margin, valid)
    error = error[..., :rows, :cols] / outside.level * (HOT if outside.is_spiky else 1)
    around = outside.around
    local = light[:, rim - around : rim + rows + around, rim - around : rim + cols + around]
    local = average_boxes(local, 2 * around + 1)
    return windows, error, local[:, around : around + rows, around : around + cols]


def _middle(light, table, valid):
    """The middles, (n, C, valid, valid), of windows (n, side, side) blurred by tables (C, side, side // 2 + 1)."""
    side = light.shape[-1]
    inner = slice((side - valid) // 2, (side + valid) // 2)
    spectra = scipy.fft.rfft2(light, workers=-1)[:, None] * table
    # the others are not needed
    rows = scipy.fft.ifft(spectra, axis=2, workers=-1, overwrite_x=True)[:, :, inner]
    return scipy.fft.irfft(rows, side, workers=-1)[..., inner]


def _repeated_response(question, tiling, far):
    """Transforms of a tile's response to points outside its overlap, at a period twice its side, by channels."""
    side = tiling.side
    held = question.cache(
        f"response of tiles of {side} that share {tiling.overlap}",
        _tile_response,
        Point.of(question),
        side,
        tiling.overlap,
        far.sigmas,
        far.tails,
    )
    quarter = question.edges.astype(np.float32) @ held.reshape(len(held), -1)
    quarter = quarter.reshape(-1, side, side)
    at = np.abs(np.arange(-side, side))
    # up to the windows' end, a side away
    whole = np.pad(quarter, [(0, 0), (0, 1), (0, 1)])[:, at[:, None], at]
    # real, as it is the same on both sides of the middle
    return scipy.fft.rfft2(scipy.fft.ifftshift(whole, axes=(1, 2))).real


def _tile_response(point, side, overlap, sigmas, tails):
    """A tile's response to a point at places below and right of it, by wavelength: float32 (L, side, side)."""
    y, x = np.indices((side, side), float)
    r = np.maximum(np.hypot(y, x), 1)
    rings = waves(point, r, y / r, x / r)
    widths, outer = sigmas[:-1, None], np.maximum(*np.indices(r.shape)) >= overlap
    held = np.zeros(rings.shape, np.float32)
    smooth = np.exp(-((r[outer] / widths) ** 2) / 2) / (2 * pi * widths**2)
    held[:, outer] = (
        rings[:, outer]
        + tails @ r[outer] ** -np.array(POWERS)[:, None]
        - energies(sigmas, tails)[:, :-1] @ smooth
    )
    return held

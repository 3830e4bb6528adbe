"""Highlights: pixels so bright that a float32 transform would drown the dark around them; each is added exactly.

A float32 transform has an error of 2.5e-7 of the field's root mean square everywhere: next to one
pixel 1e9 times as bright as the rest this is up to 68 % of the rest. So a pixel above THRESHOLD
times the median stays in the planes at the median, and its excess becomes a point light with its
own spectrum, whose kernel is summed in the image itself, without transforms. It never wraps around.
The border's rule holds for it too: a mirrored border mirrors it. A pixel at the edge of a picture
whose edge continues would become a line of light, and is not split.

A clear circular pupil in focus has kernels of its own (`point_kernels`). Any other lens has cores
that are integrated exactly, at the point's place in the field, and beyond them the light that the
rim of its pupil spreads (`lens_kernels`, `gpusim.optics.points`). Measured spreads end.
"""

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from scipy.special import j1

from gpusim.domain.content import Content
from gpusim.domain.optics import Optics
from gpusim.optics import points
from gpusim.optics.depth import circle_of_confusion
from gpusim.optics.lens import Lens

THRESHOLD = 100.0  # times the median
MOST = 64  # points; others stay in the planes, and their error is reported
MOST_IMAGES = 1024  # of all points and their mirror images
TRANSFORM_ERROR = 2.5e-7  # of a float32 transform, over the field's root mean square
NEGLIGIBLE = 1e-6  # of the median: smaller contributions of a point are left out
CORE = 32  # [pixel] kernels are tabled pixel by pixel up to here, by radius beyond
PER_RING = 64  # samples of a radial table to a diffraction ring
# of any pupil: half sides of exact cores, the least in q and in radii of the rays through the rim, and waves summed for
# all of them: a second on a core of Zen 4
CORES = (8, 12, 16, 24, 32, 48, 64, 96, 128)
LEAST_RINGS, LEAST_RAYS, MOST_WAVES = 12.0, 1.5, 2e8
MOST_SPOTS = 32  # places in the field that have kernels of their own
FINER = 2.0  # parts of a pixel to a diffraction ring at least, 8 parts at most
SAME_PLACE = 0.1  # [pixel] of the blur's radius between distances that may hide each other
MOST_LEVELS = 64  # distances in front of a point
# true over predicted beyond cores was up to 1.6 behind 5 and 6 blades, more than the account's margin of 1.5
STREAK_DOUBT = 1.25
STREAKS = (1.0, 1.5)  # of a core's half side, at which streaks are
PROBED = 12  # rows and columns at which the light beyond a core is compared with exact light
ON_AXIS = np.zeros((1, 5))


@dataclass(frozen=True, eq=False)
class Highlights:
    """Point lights in the frame's pixels.

    places: rows and columns, int (N, 2), counted from the frame's first pixel; mirror images lie outside. light: which
    of the spectra, int (N,). strength: times that spectrum, (N,). spectra: (K, L). reach: farthest pixel each adds to
    [pixel], int (N,). residue: local error, over the median, from bright pixels beyond the MOST that stayed in the
    planes. missing: what mirror images beyond the reach would give to every pixel, in the unit of brightness. spot:
    which of the spots, int (N,). spots: field point (y, x), the image's displacement from the pixel (rows, cols)
    [pixel] and the distance (0: in focus) [m] for which there are kernels, (P, 5). core: half side of the kernels that
    are exact [pixel]. source: the scene's sample of each, counted as places, int (N, 2); None: its place. cover: which
    of the covers, int (N,), or -1; None: nothing is before them. covers: part of a core that is seen past what is
    before the point, (V, n, n), and beyond the core.
    """

    places: np.ndarray
    light: np.ndarray
    strength: np.ndarray
    spectra: np.ndarray
    reach: np.ndarray
    residue: float
    missing: float
    spot: np.ndarray
    spots: np.ndarray
    core: int = CORE
    source: np.ndarray | None = None
    cover: np.ndarray | None = None
    covers: tuple[np.ndarray, np.ndarray] | None = None

    @property
    def distances(self) -> list[float]:
        """Distances of the spots, each once; 0: in focus [m]."""
        return np.unique(self.spots[:, 4]).tolist()


def unsplit_error(brightness) -> float:
    """Return the local error, over the median, next to highlights that stay in the planes; 0 without highlights."""
    median = median_of(brightness)
    if not 0 < THRESHOLD * median < brightness.max():
        return 0.0
    return _transform_error(brightness, median)


def _transform_error(brightness, median):
    rms = float(np.sqrt(np.square(brightness, dtype=np.float64).mean()))
    return TRANSFORM_ERROR * rms / median


def median_of(brightness) -> float:
    """Return the median; if more than MOST pixels are lit and the rest is dark, the median of the lit ones."""
    step = max(1, int(np.sqrt(brightness.size / 2**16)))
    median = float(np.median(brightness[::step, ::step]))
    if median > 0 or np.count_nonzero(brightness > 0) <= MOST:
        return max(median, 0.0)
    return float(np.median(brightness[brightness > 0]))


def split_highlights(
    content: Content,
    brightness,
    q: float,
    margin: int,
    border: str,
    most: int = MOST,
    end: int = 0,
    moved: tuple[int, int] = (0, 0),
    rim: int = 0,
):
    """Return the content without its highlights, and the highlights (None if none can be split off).

    Args:
        content: The content.
        brightness: Of the content, see `Content.brightness`; written to: without the highlights
            on return.
        q: Largest wavelength times f-number over pitch; of another pupil, that of the clear circle
            with the same tail.
        margin: Of the scene around the frame [pixel].
        border: "zero", "edge" or "reflect".
        most: Points that are split off at most.
        end: Pixel at which kernels end; 0: they do not.
        moved: Rows and columns by which a view displaces the samples. Places are displaced, too: the border's rule
            holds for the picture that the view shows.
        rim: Samples around that picture that are seen as well.
    """
    median = median_of(brightness)
    bright = np.flatnonzero(brightness > THRESHOLD * median)
    rows, cols = np.unravel_index(bright, brightness.shape)
    single = np.ones(len(bright), bool)
    high, wide = brightness.shape
    if border == "edge":
        single = (0 < rows) & (rows < high - 1) & (0 < cols) & (cols < wide - 1)
    elif border == "reflect":
        longest = max(high, wide)
        images = MOST * (2 * (longest // high) + 1) * (2 * (longest // wide) + 1)
        single[:] = images <= MOST_IMAGES  # no narrow strip between two mirrors
    for at, move, n in zip((rows, cols), moved, (high, wide), strict=True):
        single &= _is_shown(at, move, n, border, rim)
    chosen = bright[single]
    chosen = chosen[np.argsort(brightness.flat[chosen])[::-1][:most]]
    if not len(chosen):
        return content, None
    rows, cols = np.unravel_index(chosen, brightness.shape)
    level = brightness[rows, cols].astype(np.float64)
    keep = (median / level).astype(np.float32)
    spectra, light, strength = content.points(rows, cols)
    # a copy; the rest is exact
    planes = content.planes.astype(np.promote_types(content.planes.dtype, np.float32))
    rest = content.with_planes(planes)
    stored = planes[..., rows, cols].astype(np.float64)
    planes[..., rows, cols] *= keep
    # exactly what was taken away, the rounding of the stored remainder included
    left = planes[..., rows, cols] / np.where(stored == 0, 1, stored)
    if left.ndim > 1:
        left = np.where(stored == 0, 0, left).max(axis=0)
    strength = strength * (1 - left)
    brightness[rows, cols] = median
    residue = 0.0
    if len(bright) > len(chosen):
        residue = _transform_error(brightness, max(median, 1e-38))
    # beyond r pixels an Airy pattern stays below 2 q / (pi^3 r^3) a pixel (the envelope of its rings)
    floor = max(NEGLIGIBLE * median, 1e-12 * level.max())
    reach = np.ceil(np.cbrt(2 * q * level / (np.pi**3 * floor)))
    reach = np.minimum(np.maximum(reach, CORE), max(high, wide)).astype(np.int32)
    if end:
        reach = np.full(len(rows), end, np.int32)
    places = np.stack([rows, cols], axis=1) + moved
    image = np.arange(len(rows))
    missing = 0.0
    if border == "reflect":
        # q / (pi^3 r^3) outside a square of half-width a has the integral 4 sqrt(2) a^-1 of it
        beyond = q / np.pi**3 * 4 * np.sqrt(2) * ((level - median) / reach).sum()
        missing = 0.0 if end else float(beyond / brightness.size)
        for axis, n in enumerate((high, wide)):
            places, image = _mirror(places, image, axis, n, reach)
    return rest, Highlights(
        places - margin,
        light[image].astype(np.int32),
        strength[image],
        spectra,
        reach[image],
        residue,
        missing,
        np.zeros(len(image), np.int32),
        ON_AXIS,
    )


def _is_shown(at, move, n, border, rim):
    """Return which of n samples along an axis a view shows once, and not at an edge that goes on."""
    if not move:
        return np.ones(len(at), bool)
    inside = range(-rim, n + rim)
    first, last = (inside[1], inside[-2]) if border == "edge" else (inside[0], inside[-1])
    shown = (at + move >= first) & (at + move <= last)
    if border == "reflect":
        for image in (-1 - at + move, 2 * n - 1 - at + move):
            shown &= (image < inside[0]) | (image > inside[-1])
    return shown & (abs(move) < n)


def _mirror(places, image, axis, n, reach):
    """Places with all mirror images along an axis of n pixels that reach into the frame, and which point each is of."""
    parts = []
    for turn in range(-(max(reach) // n) - 1, max(reach) // n + 2):  # a frame's width each
        at = turn * n + (places[:, axis] if turn % 2 == 0 else n - 1 - places[:, axis])
        near = np.maximum(-at, at - (n - 1)) <= reach[image]
        moved = places.copy()
        moved[:, axis] = at
        parts.append((moved[near], image[near]))
    found, images = zip(*parts, strict=True)
    return np.concatenate(found), np.concatenate(images)


def airy_density(radius, q):
    """Energy per square pixel at `radius` [pixel] of a point: (pi / 4 q^2) (2 J1(v) / v)^2, v = pi r / q (Airy)."""
    v = np.maximum(np.pi * radius / q, 1e-9)
    return np.pi / (4 * q * q) * (2 * j1(v) / v) ** 2


@dataclass(frozen=True, eq=False)
class PointKernels:
    """Pixel-integrated kernels of points, one per spot and wavelength.

    cores: at whole pixels (dy, dx), shape (P, L, n, n): from -n // 2 on, or of an Airy pattern from 0 on. profiles: at
    radii 0, step, 2 step ... [pixel], shape (L, m), averaged over a part of a pixel in the mean over all directions: a
    mean of the parts is a pixel to 1e-3 beyond the core. parts: of a pixel's height and width. spread: their sides
    [pixel]. centres: middles of the profiles, (P, 2) [pixel]. streaks: of each spot or one, by wavelength; or none.
    """

    cores: np.ndarray
    profiles: np.ndarray
    step: float
    parts: tuple[int, int]
    spread: tuple[float, float]
    centres: np.ndarray
    streaks: tuple[tuple[points.Streaks, ...], ...] = ()
    width: float = 1.0
    is_quarter: bool = False

    def beyond(self, y, x) -> np.ndarray:
        """Return the energy of pixels at (y, x) from a point, beyond the core, of every wavelength, (L, *shape)."""
        y, x = y - self.centres[0, 0], x - self.centres[0, 1]
        down, across = (
            side * (np.arange(count) - (count - 1) / 2)
            for side, count in zip(self.spread, self.parts, strict=True)
        )
        radius = np.hypot(y[..., None, None] + down[:, None], x[..., None, None] + across)
        radii = self.step * np.arange(self.profiles.shape[-1])
        light = np.stack(
            [np.interp(radius, radii, one).mean(axis=(-2, -1)) for one in self.profiles[0]]
        )
        for own, found in zip(light, self.streaks[0] if self.streaks else (), strict=False):
            own += points.streak_light(found, y, x, self.width)
        return light


def point_kernels(q, aperture: float, reach: int) -> PointKernels:
    """Return kernels up to `reach` pixels for wavelengths of `q` (lambda N / pitch).

    aperture: width of a pixel's aperture [pixel]. A ring pattern of period q averaged over a small
    square depends little on the square's direction: by +- 1 % for squares of half a ring. So a
    pixel is cut into `parts` per side, each replaced by its mean over directions.
    """
    q = np.asarray(q, np.float64)
    order = int(np.ceil(6 + 3 * aperture / q.min()))
    nodes, mass = (array / 2 for array in np.polynomial.legendre.leggauss(order))
    offsets = (np.arange(CORE + 1)[:, None] + aperture * nodes).ravel()
    radius = np.hypot(offsets[:, None], offsets)
    cores = np.empty((len(q), CORE + 1, CORE + 1))
    for core, one in zip(cores, q, strict=True):
        values = airy_density(radius, one).reshape(CORE + 1, order, CORE + 1, order)
        core[:] = np.einsum("iajb,a,b->ij", values, mass, mass)
    parts = int(np.ceil(2 * aperture / q.min()))
    spread, step = aperture / parts, q.min() / PER_RING
    count = int(np.ceil((np.sqrt(2) * (reach + 1)) / step)) + 2
    radii = step * np.arange(count)
    smooth = _mean_over_directions(spread, step)
    margin = len(smooth) // 2
    padded = np.abs(step * np.arange(-margin, count + margin))
    profiles = np.stack([np.convolve(airy_density(padded, one), smooth, "valid") for one in q])
    both = (parts, parts), (spread, spread)
    centre = np.zeros((1, 2))
    return PointKernels(
        cores[None], profiles[None, :, : len(radii)], step, *both, centre, is_quarter=True
    )


def has_airy_kernels(lens: Lens) -> bool:
    """Return whether kernels are Airy patterns, integrated over squares in the samples' middles."""
    height, width = lens.aperture
    return lens.is_airy and lens.is_uniform and height == width and not any(lens.displacement)


def core_of(lens: Lens, wavelengths, spots: int, longest: int, distances=(0.0,)) -> int:
    """Return the half side of exact kernels [pixel]; 0 if they would take too long.

    Args:
        lens: The lens.
        wavelengths: [nm], shape (L,).
        spots: Places that have kernels of their own.
        longest: Pixels along the frame.
        distances: Of the points; 0: in focus [m].
    """
    if lens.tail is None:
        return lens.least_size // 2 + 1
    q, height = lens.q(wavelengths), 0.0 if lens.is_uniform else 1.0
    slope = max(
        points.steepest(lens.waves(wavelengths[:1], height, distance=distance or None)[0])
        for distance in distances
    )
    away = 2 * q[0] * slope
    least = max(LEAST_RINGS * q.max(), LEAST_RAYS * away) + np.hypot(*lens.displacement)
    found = 0
    for half in CORES:
        waves = spots * sum(points.work_of(one, half, slope) for one in q)
        if half >= least and waves <= MOST_WAVES and (half <= longest or not found):
            found = half
            if lens.symmetry.is_round:
                break  # the light beyond is known as well
    return found


def lens_kernels(lens: Lens, wavelengths, spots, core: int, reach: int) -> PointKernels:
    """Return kernels of any lens.

    Args:
        lens: The lens, in front of the samples that are blurred.
        wavelengths: [nm], shape (L,).
        spots: See `Highlights`.
        core: See `Highlights`.
        reach: Farthest pixel of a kernel.
    """
    energies, middles = zip(
        *(lens.point_energies(wavelengths, spot, np.arange(-core, core + 1)) for spot in spots),
        strict=True,
    )
    cores, centres = np.stack(energies), np.stack(middles)
    if lens.tail is None:  # nothing is beyond
        nothing = np.zeros((1, len(wavelengths), 2))
        return PointKernels(cores, nothing, 1.0, (1, 1), (1.0, 1.0), centres)
    distances = np.asarray(spots)[:, 4]
    if len(set(distances.tolist())) == 1:
        distances = distances[:1]
    return _rim_kernels(lens, wavelengths, cores, centres, core, reach, distances)


def _rim_kernels(lens, wavelengths, cores, centres, core, reach, distances=(0.0,)):
    """Kernels of a pupil with these cores: the light beyond them is that on the axis, at each distance."""
    q, optics = lens.q(wavelengths), lens.optics
    parts = tuple(min(ceil(FINER * side / q.min()), 8) for side in lens.aperture)
    spread = tuple(side / count for side, count in zip(lens.aperture, parts, strict=True))
    step = max(q.min() / PER_RING, 1 / 256)
    away = float(np.abs(centres).max())
    radii = step * np.arange(ceil(np.sqrt(2) * (reach + away + 1) / step) + 2)
    profiles, streaks = np.zeros((len(distances), len(q), len(radii))), []
    for each, distance in zip(profiles, distances, strict=True):
        waves, lines = lens.waves(wavelengths, distance=float(distance) or None), []
        for own, one, wave in zip(each, q, waves, strict=True):
            middle = points.rim_centre(optics.pupil, wave, one)
            pupil = optics.pupil, wave, one, middle
            own[:] = points.round_profile(*pupil, radii, spread, lens.spots)
            if optics.pupil.sides.size:
                lines.append(points.streaks(*pupil, lens.aperture, lens.spots))
        if lines:
            streaks.append(tuple(lines))
    width = points.corner_width(lens.aperture)
    return PointKernels(cores, profiles, step, parts, spread, centres, tuple(streaks), width)


def beyond_errors(
    lens: Lens, wavelengths, weights, core: int, distance: float = 0.0
) -> tuple[float, float]:
    """Return the relative error of light beyond a core on the axis, in the mean and at most, of all channels.

    Compared are pixels along the core's rim, or on and between streaks. weights: of the wavelengths in the channels,
    (C, L). distance: of the point; 0: in focus [m].
    """
    if lens.tail is None:
        return 0.0, 0.0
    along = np.linspace(-core, core, PROBED)
    if lens.tail.lines:  # most of the light is on narrow streaks
        lines = np.outer(STREAKS, [*np.cos(lens.tail.lines), *np.sin(lens.tail.lines)]).ravel()
        along = core * np.concatenate([lines, -lines])
    at = np.unique(np.round(along).astype(int))
    exact, centre = lens.point_energies(wavelengths, np.array([0.0, 0, 0, 0, distance]), at)
    made = _rim_kernels(lens, wavelengths, exact[None], centre[None], core, 2 * core, (distance,))
    y, x = np.meshgrid(at, at, indexing="ij")
    outer = np.maximum(abs(y), abs(x)) >= 0.8 * core
    seen = made.beyond(y[outer], x[outer])
    light = np.maximum(weights, 0) @ exact[:, outer]
    wrong = np.abs(np.maximum(weights, 0) @ seen - light)
    light = np.maximum(light, 1e-300)
    there = weights.max(axis=1) > 0
    away = np.maximum(abs(y), abs(x))[outer] > core
    rms = [
        np.sqrt((wrong[:, some] ** 2).sum(axis=1) / (light[:, some] ** 2).sum(axis=1))[there]
        for some in (~away, away)
        if some.any()
    ]
    doubt = STREAK_DOUBT if lens.tail.lines else 1.0
    return doubt * float(np.max(rms, initial=0)), float((wrong / light)[there].max(initial=0))


def beyond_light(
    lens: Lens, wavelength: float, lights: Highlights, levels, rows, cols
) -> np.ndarray:
    """Return the light that the brightest points give to pixels beyond their cores, (len(rows), len(cols)).

    wavelength: that stands for all [nm]. levels: light of each point, (N,). rows, cols: as `Highlights.places`.
    """
    total = np.zeros((len(rows), len(cols)))
    if lens.tail is None:
        return total
    reach, nodes = int(lights.reach.max()), np.array([wavelength])
    core = np.zeros((1, 1, 1, 1))
    made = _rim_kernels(lens, nodes, core, np.zeros((1, 2)), lights.core, reach)
    for n in np.argsort(levels)[::-1][:MOST]:
        y, x = np.meshgrid(rows - lights.places[n, 0], cols - lights.places[n, 1], indexing="ij")
        away = np.maximum(abs(y), abs(x))
        seen = (away > lights.core) & (away <= lights.reach[n])
        total[seen] += levels[n] * made.beyond(y[seen], x[seen])[0]
    return total


def mixed_kernels(kernels: PointKernels, lights: Highlights, weights) -> tuple[np.ndarray, dict]:
    """Return which kernel each point has, int (N,), and the inputs of `optics.splat`: kernels in channels.

    weights: of the wavelengths in the channels, (C, L).
    """
    cover = np.full(len(lights.light), -1) if lights.cover is None else lights.cover
    each, index = np.unique(
        np.stack([lights.light, lights.spot, cover], axis=1), axis=0, return_inverse=True
    )
    mix = lights.spectra[each[:, 0]][:, None] * weights  # (kernels, channels, L)

    def mixed(tables):
        """Tables of each spot, or of one, (P or 1, L, ...), in the channels of each kernel."""
        if len(tables) == 1:
            return np.tensordot(mix, tables[0], 1)
        return np.einsum("kcl,kl...->kc...", mix, tables[each[:, 1]], optimize=True)

    cores = mixed(kernels.cores)
    if kernels.is_quarter:
        at = abs(np.arange(1 - cores.shape[-1], cores.shape[-1]))
        cores = cores[..., at[:, None], at]
    found = {
        "cores": cores,
        "profiles": mixed(kernels.profiles),
        "step": kernels.step,
        "parts": kernels.parts,
        "spread": kernels.spread,
        "centres": kernels.centres[each[:, 1]],
    }
    if kernels.streaks:
        angles = kernels.streaks[0][0].angles
        profiles, corners = (
            np.array([[getattr(one, name) for one in own] for own in kernels.streaks])
            for name in ("profiles", "corners")
        )
        found |= {
            "streaks": mixed(profiles),
            "lines": np.stack([np.sin(angles), np.cos(angles)], axis=1),
            "corners": mixed(corners),
            "fine": float(points.FINE),
            "width": kernels.width,
        }
    if lights.covers is not None:
        near, far = (np.concatenate([one, np.ones((1, *one.shape[1:]))]) for one in lights.covers)
        found["cores"] = cores * near[each[:, 2], None]
        for name in ("profiles", "streaks", "corners"):
            if name in found:
                shape = -1, *(1,) * (found[name].ndim - 1)
                found[name] = found[name] * far[each[:, 2]].reshape(shape)
    return index.ravel(), found


def hidden_parts(
    lights: Highlights, depth, optics: Optics, pitch: float, margin: int, rays, q: float
) -> Highlights:
    """Return highlights with the part of each core that is seen past nearer samples.

    A ray from the point through u of the pupil meets the image at the place -r u from the point's, r
    the signed radius of the blur, and crosses the distance with a radius r' at (r' - r) u. A pixel
    sees the mean over the rays that meet the image near it.

    Args:
        lights: The highlights, with sources.
        depth: Distance of every sample of the scene [m], (rows, cols).
        optics: Settings of the lens.
        pitch: Distance of the samples [m].
        margin: Of the scene around the frame [sample].
        rays: y, x and share of points of the pupil, (M, 3).
        q: Wavelength times f-number over pitch: rays farther than that count less.
    """
    assert lights.source is not None
    u, share = rays[:, :2], rays[:, 2]
    across = np.arange(-lights.core, lights.core + 1)
    near: list[np.ndarray] = []
    far: list[float] = []
    cover = np.full(len(lights.places), -1)
    radii = circle_of_confusion(optics, depth, pitch) / 2
    last = np.array(radii.shape) - 1
    for n, source in enumerate(lights.source):
        spot, at = lights.spots[lights.spot[n]], np.clip(source + margin, 0, last)
        radius = float(radii[tuple(at)])
        reach = int(np.ceil(radius - radii.min())) + 1
        around = tuple(slice(max(one - reach, 0), one + reach + 1) for one in at)
        nearer = radii[around][radii[around] < radius - SAME_PLACE]
        if not len(nearer):
            continue
        levels = np.unique(np.round(nearer / SAME_PLACE).astype(int))
        through = np.ones(len(u))
        for level in levels[:: max(len(levels) // MOST_LEVELS, 1)] * SAME_PLACE:
            y, x = np.clip(np.floor(at + (level - radius) * u + 0.5), 0, last).astype(int).T
            step = SAME_PLACE * max(len(levels) // MOST_LEVELS, 1)
            own = radii[y, x]
            through[(np.abs(own - level) <= step / 2 + 1e-9) & (own < radius - SAME_PLACE)] = 0
        if through.min() == 1:
            continue
        mean = float(share @ through)
        seen = np.full((len(across), len(across)), mean)
        if mean > 0:
            landed = spot[2:4] - radius * u
            square = (across[:, None] - landed[:, 0]) ** 2, (across[:, None] - landed[:, 1]) ** 2
            for row, own_row in zip(seen, square[0], strict=True):
                weight = share / (own_row + square[1] + max(q, 0.5) ** 2) ** 2
                row[:] = weight @ through / weight.sum(axis=1)
        cover[n] = len(near)
        near.append(seen)
        far.append(mean)
    if not near:
        return lights
    return replace(lights, cover=cover, covers=(np.stack(near), np.array(far)))


def _mean_over_directions(side, step):
    """Weights, `step` apart, of the distribution of a square's points along a line, over all directions of the line."""
    angles = (np.arange(16) + 0.5) / 16 * np.pi / 4
    half = int(np.ceil(side / np.sqrt(2) / step)) + 1
    edges = step * (np.arange(-half, half + 2) - 0.5)
    total = 0
    for angle in angles:
        a, b = side * np.cos(angle) / 2, side * np.sin(angle) / 2
        corners = ((1, a + b), (-1, a - b), (-1, b - a), (1, -a - b))
        # the distribution function: the sum of two uniform variables, as a second integral of its corners
        total = total + sum(s * np.maximum(edges + c, 0) ** 2 for s, c in corners) / (8 * a * b)
    weights = np.diff(total / len(angles))
    return weights / weights.sum()

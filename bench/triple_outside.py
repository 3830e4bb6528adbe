"""Mean electrons of any camera and scene by independent float64 sums.

Independent of planner, kernels and reference. Assumptions:

- A sample is a point of light at its place; a pixel is the mean of the irradiance over its aperture.
  Apertures with gaps between them are scaled to give the right value for a flat field.
- The lens spreads the light of every sample at its place and distance; flat fields are not forced
  to stay flat.
- Between samples the scene is band-limited; views and distortion use these values. The border rule
  continues it.
- Nearer things hide farther ones, at each point of the pupil (`triple_rays.py`). A picture with
  depth does not show the hidden parts, so there are three answers: all light spread without hiding,
  and compositions of layers with the picture continued behind them, with and without the covariance
  over the pupil.
- Spectra of the scene are cubic splines between its wavelengths; light, filters and efficiencies
  are as tabulated.

Each open question gives one more answer; the error of a frame is its distance from the interval
between the answers.
"""

from dataclasses import dataclass
from math import ceil

import numpy as np
import scipy.fft
import triple_brute as brute
from scipy.ndimage import distance_transform_edt, map_coordinates
from triple_geometry import AROUND, band_limited, channel_weights, distorted, falloff, few
from triple_lens import Lens, apertures, edges, kernels, measured_kernels, steepest, tail
from triple_rays import hidden_difference

from gpusim.domain.errors import OutOfRange

NEAREST, RINGS, FARTHEST = 40, 16, 110  # [sample] within which all light is summed; rings; the most
BRIGHT = 100.0  # times the median: a highlight
FARTHER = 4  # times the reach if a highlight at the picture's edge goes on without end
NODES = 7  # Chebyshev's places along an axis for a lens that varies, and distances of a slope
SAFE = 10  # [pixel] of the frame's rim that are not judged if the scene outside is an open question


@dataclass(frozen=True, eq=False)
class Answers:
    """Mean electrons, one array for each answer.

    rim: pixels around the frame that are not judged. sure: accuracy of the sums over a pixel's
    light.
    """

    means: list
    rim: int = 0
    sure: float = 3e-5

    def distance(self, mean):
        """Return a frame's distance from the interval of the answers, and the interval's middle."""
        low, high = np.min(self.means, axis=0), np.max(self.means, axis=0)
        off = np.maximum(np.maximum(low - mean, mean - high), 0)
        if self.rim:
            inside = np.zeros(off.shape[-2:], bool)
            inside[self.rim : -self.rim or None, self.rim : -self.rim or None] = True
            off = off * inside
        return off, np.clip(mean, low, high)


def answers(scene, camera, seconds: float, wide: float = 1.0) -> Answers:
    """Return the mean electrons that a camera sees. Raises OutOfRange if these sums do not apply.

    wide: factor on the reach within which all light is summed; 3 takes a few times as long and errs by 1e-5.
    """
    require(scene, camera)
    planes = planes_of(scene)
    if not scene.view.is_plain and scene.depth is None:
        planes = seen_by_view(scene, planes)
    found = rates_of_world(Lens(scene, camera, wide=wide), scene, camera, planes)
    means = [exposed(one, scene, camera, seconds) for one in found]
    optics, sensor = camera.optics, camera.sensor
    rim = 0 if optics.distortion is None else SAFE
    q = (
        scene.wavelengths.min()
        * 1e-9
        * optics.working_f_number
        / sensor.pixel_pitch
        * scene.samples_per_pixel
    )
    # rays of straight edges meet apertures with gaps unevenly: an effect of 2e-4
    is_uneven = sensor.fill_factor < 1 and q < 1 and optics.pupil.blades
    return Answers(means, min(rim, (min(scene.shape) - 1) // 3), 5e-4 if is_uneven else 3e-5)


def planes_of(scene) -> np.ndarray:
    """Return the light of every wavelength, float64 (L, rows, cols)."""
    return np.stack([spectra(scene.content, band) for band in range(len(scene.wavelengths))])


def rates_of_world(lens, scene, camera, planes) -> list:
    """Return electrons per second (C, rows, cols), one array for each answer.

    planes: light of the scene as the view shows it. A scene with depth is cut into sheets first;
    its view and the lens displace each sheet.
    """
    if scene.depth is None:
        worlds = [planes]
        if camera.optics.distortion is not None:
            worlds = [distorted(scene, camera, planes, beyond) for beyond in (0, AROUND)]
        found = []
        for world in worlds:
            more = (world.shape[1] - planes.shape[1]) // 2
            found.append(rates(lens, world, more, [(world, np.ones(world.shape[1:]), None)]))
        return found
    levels = len(np.unique(scene.depth))
    kinds = ["whole"] if scene.layers else ["spread"]
    kinds += ["cut"] * (2 <= levels <= 3)
    found = []
    for kind in kinds:
        sheets = [displaced(scene, camera, *one) for one in sheets_of(scene, planes, kind)]
        own = rates(lens, planes, 0, sheets)
        if len(sheets) == 1:
            found.append(own)
            continue
        if not scene.layers:  # one picture: hiding is an open question
            found.append(own)
        _, _, first = apertures(scene, camera)
        weights = channel_weights(scene, camera)
        found.append(own + hidden_difference(lens, sheets, weights, first, by_distance, slopes))
    return found


def displaced(scene, camera, light, cover, distances):
    """Return a sheet as the view and the lens displace it: light times coverage, coverage, distances."""
    light = light * cover
    if not scene.view.is_plain:
        light = seen_by_view(scene, light)
        cover = seen_by_view(scene, cover[None])[0]
        places = view_places(scene, distances.shape)
        places = [at + (n - 1) / 2 for at, n in zip(places, distances.shape, strict=True)]
        distances = map_coordinates(distances, places, order=_order(distances), mode="nearest")
    if camera.optics.distortion is not None:
        light = distorted(scene, camera, light, 0)
        cover = distorted(scene, camera, cover[None], 0, is_flux=False)[0]
        distances = distorted(scene, camera, distances[None], 0, order=_order(distances))[0]
    return light, cover, distances


def _order(distances):
    """Return the order of splines between distances: few jump, others slope."""
    return 0 if len(np.unique(distances)) <= 4 else 1


def spectra(content, band) -> np.ndarray:
    """Return a band of a content, float64 (rows, cols)."""
    if content.form != "illuminated":
        return brute.spectra(content, band)
    surfaces = np.tensordot(content.basis[:, band], content.coefficients.astype(np.float64), 1)
    return surfaces * np.tensordot(content.lights[:, band], content.maps.astype(np.float64), 1)


def require(scene, camera):
    """Raise OutOfRange for questions without a single answer."""
    ratio, sensor = scene.samples_per_pixel, camera.sensor
    if len(scene.wavelengths) < 2:
        raise OutOfRange("wavelengths", len(scene.wavelengths), "2 or more for a spline")
    if not float(ratio).is_integer():
        raise OutOfRange("samples per pixel", ratio, "a whole number")
    q = scene.wavelengths.min() * 1e-9 * camera.optics.working_f_number / sensor.pixel_pitch * ratio
    partial = ratio != 1 and (
        sensor.fill_factor != 1 or any((ratio * one) % 1 for one in sensor.displacement)
    )
    if partial and (q < 2 or camera.optics.model != "diffraction"):
        raise OutOfRange(
            "q of a sample", f"{q:.2g}", "2 or more with apertures that end between samples"
        )
    if camera.optics.model == "none" and (any(sensor.displacement) or partial):
        raise OutOfRange("displacement", sensor.displacement, "0 without blur")


def seen_by_view(scene, planes):
    """Return the samples that a view shows, continued beyond the scene by the border rule."""
    down, across = view_places(scene, planes.shape[1:])
    return band_limited(planes, down, across, scene.border)


def view_places(scene, shape):
    """Return the places that a view shows, from the middle of the samples: rows and columns."""
    view, ratio = scene.view, scene.samples_per_pixel
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    cos, sin = np.cos(view.rotation) / view.zoom, np.sin(view.rotation) / view.zoom
    y, x = np.meshgrid(y, x, indexing="ij")
    return cos * y + sin * x + ratio * view.shift[0], cos * x - sin * y + ratio * view.shift[1]


def reach_of(lens, planes) -> int:
    """Return the samples within which all light is summed. Raises OutOfRange."""
    scene, optics = lens.scene, lens.camera.optics
    if optics.model == "measured":
        return (
            ceil(optics.psf.radius * scene.samples_per_pixel / lens.camera.sensor.pixel_pitch) + 2
        )
    longest = scene.wavelengths.max()
    distances = (
        [None]
        if scene.depth is None
        else [
            extreme(np.asarray(one))
            for one in (scene.depth, *(layer.depth for layer in scene.layers))
            for extreme in (np.min, np.max)
        ]
    )
    radius = max(
        2
        * lens.q(longest)
        * steepest(lens.waves(wavelength, y, x, distance))
        * wavelength
        / longest
        for y, x in ((0, 0), (0.7, 0.7), (0, 1), (-0.7, 0.7))
        for distance in distances
        for wavelength in scene.wavelengths[[0, -1]]
    )
    reach, farthest = (
        lens.wide * max(NEAREST, RINGS * lens.q(longest), 3 * radius),
        lens.wide * FARTHEST,
    )
    # light from afar is a mean over rings: not of a highlight
    bright = BRIGHT * np.median(planes)
    if scene.border == "zero" or planes.max() > bright:
        reach = max(max(planes.shape[1:]), ceil(min(reach, farthest)))
        # most light then comes from afar, where rings cut off at 47 samples are 1e-3 of it
        ends = planes[:, [0, -1]].max(), planes[:, :, [0, -1]].max()
        goes_on = brute.GOES_ON.get(scene.border) == "nearest" and max(ends) > bright
        return FARTHER * reach if goes_on else reach
    if reach > 1.3 * farthest:
        raise OutOfRange("spread", f"{reach:.0f} samples", f"up to {1.3 * farthest:.0f}")
    return ceil(min(reach, farthest))


def shares_of(lens, more, reach):
    """Return field points, and the share of every sample in the spread of each: (points, weights).

    Chebyshev points over the samples; samples outside use the outermost point.
    """
    shape = lens.scene.content.shape
    if not lens.varies:
        return [(0.0, 0.0)], np.ones((1, 1, 1))
    unit = -np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    axes, places = [], []
    for n in shape:
        at = (
            np.clip(np.arange(-reach - more, n + reach + more), 0, n - 1) / max((n - 1) / 2, 0.5)
            - 1
        )
        basis = np.ones((NODES, len(at)))
        for i in range(NODES):
            for j in set(range(NODES)) - {i}:
                basis[i] *= (at - unit[j]) / (unit[i] - unit[j])
        axes.append(basis)
        places.append((unit + 1) * max((n - 1) / 2, 0.5))
    points = [lens.place(y, x) for y in places[0] for x in places[1]]
    return points, (axes[0][:, None, :, None] * axes[1][None, :, None, :]).reshape(
        NODES**2, *(len(axis[0]) for axis in axes)
    )


def sheets_of(scene, planes, kind):
    """Return layers, nearest first: light (L, rows, cols), coverage, distances, both (rows, cols).

    kind: "spread", the visible picture without hiding; "whole", the layers of the scene before its
    picture; "cut", these with the picture cut at its distances and continued behind the nearer ones.
    """
    shape, found = planes.shape[1:], []
    whole, depth = np.ones(shape), np.asarray(scene.depth, float)
    for layer in scene.layers:
        light = np.stack([spectra(layer.content, band) for band in range(len(planes))])
        found.append((light, np.asarray(layer.alpha, float), np.broadcast_to(layer.depth, shape)))
    if kind != "cut":
        return [*found, (planes, whole, depth)]
    for level in np.unique(depth):
        nearer = depth < level
        rows, cols = (
            distance_transform_edt(nearer, return_distances=False, return_indices=True)
            if nearer.any()
            else np.indices(shape)
        )
        cover = (depth[rows, cols] == level) * 1.0
        found.append((planes[:, rows, cols], cover, np.full(shape, level)))
    return found


def by_distance(distances):
    """Return distances, and the share of every sample in each.

    Few distances are used directly; for a slope, Chebyshev points in 1 / m.
    """
    levels = np.unique(distances)
    if len(levels) <= 4:
        return [(float(level), (distances == level) * 1.0) for level in levels]
    nearness = 1 / distances
    low, high = nearness.min(), nearness.max()
    unit = -np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    nodes, found = low + (unit + 1) / 2 * (high - low), []
    for i, node in enumerate(nodes):
        share = np.ones(distances.shape)
        for j in set(range(NODES)) - {i}:
            share = share * (nearness - nodes[j]) / (node - nodes[j])
        found.append((float(1 / node), share))
    return found


def slopes(lens, distances):
    """Return the change of the circle of confusion from sample to sample, along rows and columns.

    A point of a sheet with the circle c is seen through the point u of the pupil at s + c u. A slanted
    sheet turns its area to one side of the pupil: it shows 1 + u . grad c of it to u. Without that a
    uniform slanted sheet would be seen unevenly. Jumps of few distances do not slant.
    """
    if len(np.unique(distances)) <= 4 or lens.camera.optics.model == "measured":
        return np.zeros((2, 1, 1))
    optics = lens.camera.optics
    pitch = lens.camera.sensor.pixel_pitch / lens.scene.samples_per_pixel
    shift = (1 / optics.object_distance - 1 / distances) * optics.image_distance**2
    return np.array(np.gradient(-shift / (2 * optics.working_f_number * pitch)))


def rates(lens, planes, more, sheets) -> np.ndarray:
    """Return electrons per second of every channel at every pixel, before the fall-off.

    Shape (C, rows, cols). more: samples on each side of `planes` outside the scene. sheets: light
    times coverage, coverage and distances, nearest first.
    """
    scene, camera = lens.scene, lens.camera
    weights = channel_weights(scene, camera)
    total = np.zeros((len(weights), *scene.shape))
    ratio = int(scene.samples_per_pixel)
    width, _, first = apertures(scene, camera)
    room = (
        ceil(ratio * max(map(abs, camera.sensor.displacement))) + 1
    )  # pixels beyond the outermost samples
    if camera.optics.model == "none":
        light = np.tensordot(weights, planes, 1)
        places = np.ix_(
            *(
                more
                + scene.margin
                + (have - 2 * scene.margin - ratio * n) // 2
                + np.arange(ratio * n)
                for have, n in zip(scene.content.shape, scene.shape, strict=True)
            )
        )
        rows, cols = scene.shape
        return (
            light[:, places[0], places[1]].reshape(-1, rows, ratio, cols, ratio).mean(axis=(2, 4))
        )
    reach = reach_of(lens, planes)
    points, shares = shares_of(lens, more, reach + room)
    shown = sheets[-1][0]
    hidden = sheets_afar(lens, sheets, reach, room) if len(sheets) > 1 else []
    chosen = np.ix_(
        *(room + more + at + ratio * np.arange(n) for at, n in zip(first, scene.shape, strict=True))
    )
    afar = np.zeros((len(weights), *planes.shape[1:]))
    for band, wavelength in enumerate(scene.wavelengths):
        share = weights[:, band]
        if not np.abs(share).max() > 1e-7 * np.abs(weights).max():
            continue
        spread = Spread(
            lens, wavelength, points, shares, reach, room, bool(np.isclose(width, ratio).all())
        )
        light = composed(
            spread,
            [(one[band], alpha, its) for one, alpha, its in sheets],
            [(one[band], cover) for one, cover in hidden],
        )
        total += share[:, None, None] * light[chosen]
        afar += lens.q(wavelength) * spread.excess * share[:, None, None] * shown[band]
    return total if hidden else total + far(lens, afar, reach, scene, more, first)


@dataclass(eq=False)
class Spread:
    """Light of one wavelength, spread by the kernels of field points with shares of every sample.

    reach: of the kernels. room: margin of samples that also receive light. is_whole: whether
    apertures have no gaps. excess: light beyond the reach over a sharp image's; known after light
    was spread.
    """

    lens: Lens
    wavelength: float
    points: list
    shares: np.ndarray
    reach: int
    room: int
    is_whole: bool
    excess: float = 1.0

    @property
    def around(self):
        """Samples around the light that `gathered` needs."""
        return self.reach + self.room

    def gathered(self, world, distance, tilt=None):
        """Return the light of apertures at all samples and in the margin `room`.

        world: light, with `around` samples on each side. tilt: axis (0: rows) of the pupil along
        which it lets light through in proportion to the place; None: evenly.
        """
        reach, measured = self.reach, self.lens.camera.optics.model == "measured"
        if not world.any():
            return np.zeros([n - 2 * reach for n in world.shape])
        if measured and self.lens.varies:
            return gathered_one_by_one(self.lens, self.wavelength, world, reach)
        key = self.wavelength, distance, reach, tilt
        if key not in self.lens.known:
            places = [(*point, distance) for point in self.points]
            self.lens.known[key] = list(
                measured_kernels(self.lens, self.wavelength, self.points, reach)
                if measured
                else self._even(places)
                if tilt is None
                else kernels(self.lens, self.wavelength, places, reach, tilt=tilt)
            )
        made = self.lens.known[key]
        size = [scipy.fft.next_fast_len(n + 2 * reach, real=True) for n in world.shape]
        total, beyond, alone = 0.0, [], tail(self.lens, self.wavelength, reach)
        for kernel, share in zip(made, self.shares, strict=True):
            own = kernel / kernel.sum() if measured and not self.is_whole else kernel
            beyond.append(1 - own.sum())
            total = total + scipy.fft.rfft2(world * share, size) * scipy.fft.rfft2(own, size)
        if alone and tilt is None:  # all other light is distant
            self.excess = float(np.clip(np.mean(beyond) / alone, 0, 20))
        return scipy.fft.irfft2(total, size)[2 * reach : world.shape[0], 2 * reach : world.shape[1]]

    def _even(self, places):
        """Return kernels that keep a flat field.

        Pixels with gaps would otherwise receive uneven shares for q below 1.
        """
        made = list(kernels(self.lens, self.wavelength, places, self.reach))
        if self.is_whole or self.lens.q(self.wavelength) >= 1:
            return made
        ratio = float(
            self.lens.scene.samples_per_pixel
        )  # beyond the reach, gaps make no difference
        whole = kernels(self.lens, self.wavelength, places, self.reach, (ratio, ratio))
        return [own / (own.sum() + 1 - all_.sum()) for own, all_ in zip(made, whole, strict=True)]


def composed(spread, sheets, afar):
    """Return irradiance of one wavelength at the pixels' places, nearer sheets over farther ones.

    afar: distant light and coverage of each sheet, added before one hides another; None for one
    sheet.
    """
    border, out, through = spread.lens.scene.border, 0.0, 1.0
    q = spread.lens.q(spread.wavelength)
    for number, (light, alpha, distances) in enumerate(sheets):
        mine, cover = 0.0, 0.0
        more = spread.around
        world = np.pad(light, more, mode=brute.MODES[border])
        beyond = "symmetric" if border == "reflect" else "edge"
        covered = np.pad(alpha, more, mode=beyond)
        if distances is None:
            return spread.gathered(world, None)
        distances = np.pad(distances, more, mode=beyond)
        slope, even = slopes(spread.lens, distances), 0.0
        for distance, share in by_distance(distances):
            for tilt, weight in ((None, 1.0), *enumerate(slope)):
                if not np.any(weight):
                    continue
                mine = mine + spread.gathered(world * share * weight, distance, tilt)
                if slope.any():
                    even = even + spread.gathered(share * weight, distance, tilt)
                if afar:
                    cover = cover + spread.gathered(covered * share * weight, distance, tilt)
        if slope.any():  # even but for differences at folds: of light that ends at the reach, too
            mine, cover = (one * even.mean() / even for one in (mine, cover))
        if not afar:
            return mine
        mine, cover = (
            one + q * spread.excess * more
            for one, more in zip((mine, cover), afar[number], strict=True)
        )
        out, through = out + through * mine, through * (1 - np.clip(cover, 0, 1))
    return out


def sheets_afar(lens, sheets, reach, room):
    """Return distant light and coverage of sheets at all samples and `room` around, for a q of 1.

    Shapes (L, ...) and (...).
    """
    border, found = lens.scene.border, []
    if lens.camera.optics.model == "measured":
        return [(np.zeros(len(sheets[0][0])), 0.0)] * len(sheets)
    for light, alpha, _ in sheets:
        planes, mixes = few(light)
        places = [np.arange(-room, n + room, dtype=float) for n in alpha.shape]
        more, cover = (
            sum(
                part
                * brute.from_afar(
                    one, of, reach, border if border != "zero" or is_light else "edge", *places
                )
                for part, of in edges(lens)
            )
            for one, is_light in ((planes, True), (alpha[None], False))
        )
        found.append((np.tensordot(mixes, more, 1), cover[0]))
    return found


def gathered_one_by_one(lens, wavelength, world, reach):
    """Return the same if every sample has a separate spread, cheap for Gaussians."""
    out = np.zeros([n + 2 * reach for n in world.shape])
    rows, cols = np.nonzero(world)
    shape = lens.scene.content.shape
    more = [(n - have) // 2 for n, have in zip(world.shape, shape, strict=True)]
    places = {
        (y, x): lens.place(
            *(
                np.clip(at - beyond, 0, n - 1)
                for at, beyond, n in zip((y, x), more, shape, strict=True)
            )
        )
        for y, x in zip(rows.tolist(), cols.tolist(), strict=True)
    }
    for (y, x), kernel in zip(
        places, measured_kernels(lens, wavelength, places.values(), reach), strict=True
    ):
        out[y : y + 2 * reach + 1, x : x + 2 * reach + 1] += world[y, x] * kernel
    return out[2 * reach : world.shape[0], 2 * reach : world.shape[1]]


def far(lens, afar, reach, scene, more, first):
    """Return electrons per second from outside the reach, (C, rows, cols)."""
    ratio = int(scene.samples_per_pixel)
    if lens.camera.optics.model == "measured" or scene.border == "zero":
        return 0.0
    places = [
        more + at + ratio * np.arange(n, dtype=float)
        for at, n in zip(first, scene.shape, strict=True)
    ]
    return sum(
        part * brute.from_afar(afar, of, reach, scene.border, *places) for part, of in edges(lens)
    )


def exposed(channels, scene, camera, seconds: float) -> np.ndarray:
    """Return mean electrons of the mosaic, or of stacked pixels (C, rows, cols), at least 0."""
    channels = np.maximum(channels, 0) * falloff(scene, camera) * seconds
    if camera.sensor.stacked:
        return channels
    cfa, (rows, cols) = camera.sensor.cfa, scene.shape
    index = np.array(
        [
            [camera.sensor.channels.index(cfa[i % len(cfa)][j % len(cfa[0])]) for j in range(cols)]
            for i in range(rows)
        ]
    )
    return np.take_along_axis(channels, index[None], 0)[0]

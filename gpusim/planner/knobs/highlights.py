"""Highlights: split off the picture if their images can be added exactly."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gpusim.domain.account import UNKNOWN, Bound
from gpusim.domain.calibration import Framed
from gpusim.domain.errors import BadData
from gpusim.optics.highlights import (
    MOST,
    MOST_SPOTS,
    THRESHOLD,
    Highlights,
    beyond_errors,
    beyond_light,
    core_of,
    has_airy_kernels,
    hidden_parts,
    median_of,
    split_highlights,
    unsplit_error,
)
from gpusim.optics.occlusion import pupil_points
from gpusim.optics.outside import border_indices, rule_of, seen_light, spread_afar
from gpusim.planner.facts import Facts, Operation
from gpusim.planner.question import Notes, Question

RAYS = 512  # points of the pupil through which a highlight is seen
PROBES = 64  # along an axis, at which the error of highlights is predicted


@dataclass(frozen=True, eq=False)
class Picture:
    """The light that goes through the blur.

    Attributes:
        brightness: Sums over wavelength and channels, float32 (rows, cols).
        level: Root mean square of the frame as the lens shows it, highlights included.
        highest: Maximum, likewise.
        highlights: The highlights that were split off, or None.
        apart: Mean square of their mosaic over the mean square of their channels together; None
            without highlights.
    """

    brightness: np.ndarray
    level: float
    highest: float
    highlights: Highlights | None = None
    apart: float | None = None

    @cached_property
    def is_spiky(self) -> bool:
        """Whether it has highlights."""
        return bool(self.brightness.max(initial=0) > THRESHOLD * median_of(self.brightness))

    def from_afar(self, question: Question, distance: float) -> float:
        """Return the relative RMS error of neglecting light that the lens spreads farther than `distance` [sample]."""
        tail = question.lens.tail
        if tail is None or not self.level > 0:
            return 0.0
        light = spread_afar(
            self.brightness,
            rule_of(question.scene.border),
            question.scene.margin,
            tail.strength * question.mean_q,
            distance,
        )
        return float(np.sqrt(np.mean(light**2))) / self.level

    def operation(
        self, question: Question, exposure_time: float | None, brightness: float = 1.0
    ) -> Operation:
        """Return the camera's operation for it.

        exposure_time: [s]; None: the camera's own. brightness: factor on the scene's light.
        """
        sensor, facts = question.sensor, question.facts
        cfa = None if sensor.stacked else sensor.cfa_indices
        key = question.weights.tobytes(), None if cfa is None else (cfa.shape, cfa.tobytes())
        rates, looked, light, root = facts.hold(
            "looked", key, lambda: _look(facts.channels(question.weights), cfa)
        )
        size = root * (self.level / light if light > 0 else 1.0)
        seconds = sensor.exposure_time if exposure_time is None else exposure_time
        if seconds is None:
            dark = sensor.noise.operating_dark_current
            try:
                automatic, brightest = sensor.auto_exposure, brightness * float(looked.max())
                highest, rates = brightness * self.highest, brightness * rates
                if automatic.method == "highlights" and brightest > 0:
                    # the frame's brightest need not be among these samples
                    top = rates.max() * highest / brightest
                    rates = np.append(np.minimum(rates, top), top)
                seconds = automatic.choose(rates + dark, sensor.saturation)[0]
                if automatic.method == "full" and highest > 0:
                    seconds *= brightest / highest
            except BadData:  # a dark scene: whoever exposes it says so
                seconds = 1.0
        return Operation(float(seconds) * brightness, size, float(sensor.read_sigma**2))

    def describe(self, notes: Notes):
        """Note the highlights that were split off."""
        split = self.highlights
        if split is None:
            return
        notes.models["optics.splat"] = (
            f"{len(split.places)} highlights added exactly, each with its own spectrum"
        )
        if split.covers is not None:
            notes.leave_out(
                "diffraction at the edges of objects before highlights: rays are cut there",
                UNKNOWN,
                "highlights behind edges",
            )
        if split.residue:
            notes.beside["local error next to further highlights"] = split.residue

    def beyond(self, question: Question, level: float) -> dict[str, Bound]:
        """Return the named error of the highlights' light beyond their exact cores.

        level: electrons of the frame's root mean square.
        """
        split = self.highlights
        if split is None or not self.level > 0:
            return {}
        if has_airy_kernels(question.lens) and not split.spots.any():
            return {}
        own = question.lens, question.scene.wavelengths, question.weights, split.core
        mean, most = np.max(
            [
                beyond_errors(*own, one)
                for one in split.distances[:: max(len(split.distances) - 1, 1)]
            ],
            0,
        ).tolist()
        rows, cols = (
            np.unique(np.linspace(0, n - 1, min(n, PROBES)).astype(int))
            for n in question.scene.samples
        )
        levels = (split.spectra @ question.light)[split.light] * split.strength
        middle = float(np.average(question.scene.wavelengths, weights=question.light))
        light = beyond_light(question.lens, middle, split, levels, rows, cols) / self.level
        margin = question.scene.margin
        local = self.brightness[margin + rows[:, None], margin + cols] / self.level + light
        sigma = np.sqrt(local + max(question.sensor.read_sigma**2, 1) / level)
        part, root = light / sigma, np.sqrt(level)
        return {
            "highlights": Bound(
                mean * float(np.sqrt(np.mean(light**2))),
                mean * root * float(np.quantile(part, 0.999)),
                most * root * float(part.max()),
            )
        }

    def describe_unsplit(self, notes: Notes):
        """Note the transforms' error next to highlights that stay in the picture."""
        if self.highlights is None and self.is_spiky and (left := unsplit_error(self.brightness)):
            notes.beside["local error next to highlights"] = left


def _look(rates, cfa):
    """Return light of pairs of rows: of their pixels, of all channels together, and the roots of both mean squares.

    rates: channels, (C, rows, cols). cfa: mosaic, or None.
    """
    looked = rates.sum(axis=0)
    if cfa is not None:
        rows, cols = np.arange(rates.shape[1])[:, None], np.arange(rates.shape[2])
        channel = cfa[rows % cfa.shape[0], cols % cfa.shape[1]]  # the period's rows in turn
        rates = np.take_along_axis(rates, channel[None], 0)
    light, root = (float(np.sqrt(np.mean(part**2))) for part in (looked, rates))
    return rates, looked, light, root


def whole(question: Question) -> Picture:
    """Return the picture with its highlights."""
    brightness, scene = question.facts.brightness(question.light), question.scene
    shown = question.deviation, scene.margin, scene.border
    return question.facts.hold(
        "picture",
        (brightness, *shown),
        lambda: Picture(brightness, *seen_light(brightness, *shown)),
    )


def split(question: Question) -> tuple[Question, Picture]:
    """Return the question without highlights, and the picture."""
    picture = whole(question)
    if not can_be_split(question) or not picture.is_spiky:
        return question, picture
    brightness = picture.brightness.copy()
    content, highlights = _split_off(question, brightness)
    if highlights is None:
        return question, picture
    lights = (highlights.spectra @ question.weights.T)[highlights.light]
    lights *= highlights.strength[:, None]
    together = (lights.sum(axis=1) ** 2).sum()
    apart = float((lights**2 @ question.share).sum() / max(together, 1e-300))
    question = replace(question, facts=Facts(content, question.facts.depth))
    return question, replace(picture, brightness=brightness, highlights=highlights, apart=apart)


def _split_off(question, brightness):
    """Content and highlights as of `split_highlights`, with kernels at the points' places in the field."""
    lens, scene, content = question.lens, question.scene, question.facts.samples.whole().on_host()
    longest, rule = max(question.size), rule_of(scene.border)
    depth = question.facts.depth
    is_placed = question.distortion is not None or not scene.view.is_plain
    if has_airy_kernels(lens) and not is_placed and depth is None:
        return split_highlights(content, brightness, question.q.max(), scene.margin, rule)
    # one kernel serves all points
    is_single = lens.is_uniform and question.distortion is None and depth is None
    distances = [0.0]
    if depth is not None:
        bright = depth[brightness > THRESHOLD * median_of(brightness)]
        distances = [float(bright.min()), float(bright.max())]
    most, images = MOST, 9 if rule == "reflect" else 1
    if not is_single:
        bright = np.count_nonzero(brightness > THRESHOLD * median_of(brightness))
        most = min(MOST_SPOTS // images, bright)
        while most > 1 and not core_of(lens, scene.wavelengths, most * images, longest, distances):
            most //= 2
    count = 1 if is_single else most * images
    core = core_of(lens, scene.wavelengths, count, longest, distances)
    if not core:
        return content, None
    q, end = float(question.q.max()), core
    if lens.tail is not None:
        q, end = q * lens.tail.strength * np.pi**3 * (2 if lens.tail.lines else 1), 0
    moved = np.rint(scene.view.locate(*np.zeros(2), question.ratio)).astype(int)
    seen = moved, question.rim
    rest, made = split_highlights(content, brightness, q, scene.margin, rule, most, end, *seen)
    if made is None:
        return rest, None
    made = replace(made, core=core)
    if lens.tail is not None and lens.tail.lines:  # a streak falls slowly
        made = replace(made, reach=np.full_like(made.reach, longest))
    if is_single:
        return rest, made
    made = replace(made, places=made.places - moved)  # of the scene, which the lens displaces
    middle = (np.array(scene.samples) - 1) / 2
    at = _image_places(question, made.places - middle) + middle
    places = np.rint(at).astype(int)
    axis = middle + question.ratio * np.array(question.axis)
    fields = (np.clip(at, 0, 2 * middle) - axis) / question.corner
    if lens.is_uniform:
        fields = 0 * fields
    away = np.zeros((len(places), 1))
    if depth is not None:
        rows, cols = (
            border_indices(one + scene.margin, n, rule)
            for one, n in zip(made.places.T, depth.shape, strict=True)
        )
        away = np.asarray(depth, np.float64)[rows, cols][:, None]
    every = np.round(np.hstack([fields, at - places, away]), 9)
    spots, spot = np.unique(every, axis=0, return_inverse=True)
    if len(spots) > MOST_SPOTS:
        return content, None
    strength = made.strength * _flux_of_points(question, made.places - middle)
    spot = spot.ravel().astype(np.int32)
    source = made.places
    made = replace(made, places=places, strength=strength, spot=spot, spots=spots, source=source)
    if depth is not None:
        rays = pupil_points(question.optics.pupil, RAYS)
        seen = depth, question.optics, question.pitch, scene.margin, rays, question.mean_q
        made = hidden_parts(made, *seen)
    return rest, made


def _image_places(question, at):
    """Places of the lens's image of the scene's samples at (rows, cols) from its middle, both (N, 2) [sample]."""
    distortion = question.distortion
    at = np.stack(question.scene.view.locate(*at.T, question.ratio), axis=1)
    if distortion is None:
        return at
    y, x = at.T * (question.pitch / distortion.radius)
    x, y = distortion.distort(x, y)
    return np.stack([y, x], axis=1) * (distortion.radius / question.pitch)


def _flux_of_points(question, at) -> np.ndarray | float:
    """Factor of the light of samples at (rows, cols) from the frame's middle, both (N, 2) [sample].

    A point keeps its energy, at the view's magnification. If a relative illumination is given, flat
    fields stay flat instead, see `DistortionGrid`: a point is the brighter the larger the lens shows its surroundings.
    """
    model, zoom = question.distortion, question.scene.view.zoom**2
    if model is None or isinstance(question.optics.relative_illumination, str):
        return zoom
    at = np.stack(question.scene.view.locate(*at.T, question.ratio), axis=1)
    places = at[:, ::-1].T * (question.pitch / model.radius)
    axis = model.middle if isinstance(model, Framed) else (0.0, 0.0)
    areas = []
    for x, y in (places, np.array(axis)[:, None]):
        a, b, c, d = model.derivative(x, y)
        areas.append(a * d - b * c)
    return zoom * areas[0] / areas[1]


def can_be_split(question: Question) -> bool:
    """Return whether highlights can be split off: their kernels are known, and do not take too long."""
    lens = question.lens
    if (
        lens.is_pointlike
        or not lens.has_point_kernels
        or question.period
        or (question.facts.depth is not None and (lens.tail is None or question.scene.layers))
        or question.optics.diffuser
        or not question.scene.view.is_whole(question.ratio)
    ):
        # a diffuser acts between pixels, and the kernels are known at pixels; those of a view between samples take
        # seconds, for each view of a path
        return False
    is_known = question.distortion is None and question.facts.depth is None
    if not is_known and question.scene.border == "reflect":
        return False  # the mirrored world is distorted, where the formula may not go, or hidden
    if question.facts.depth is not None:
        return True  # `_split_off` knows what takes too long
    if has_airy_kernels(lens) and question.distortion is None:
        return True
    return core_of(lens, question.scene.wavelengths, 1, max(question.size)) > 0

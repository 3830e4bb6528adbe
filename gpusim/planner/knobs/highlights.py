"""Highlights: split off the picture if their images can be added exactly."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gpusim.domain.account import Bound
from gpusim.domain.errors import BadData
from gpusim.optics.highlights import (
    CORE,
    MOST,
    MOST_SPOTS,
    THRESHOLD,
    Highlights,
    beyond_errors,
    beyond_light,
    core_of,
    has_airy_kernels,
    median_of,
    split_highlights,
    unsplit_error,
)
from gpusim.optics.outside import rule_of, seen_light, spread_afar
from gpusim.planner.facts import Facts, Operation
from gpusim.planner.question import Notes, Question

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

    def operation(self, question: Question, exposure_time: float | None) -> Operation:
        """Return the camera's operation for it. exposure_time: [s]; None: the camera's own."""
        sensor, rates = question.sensor, question.facts.channels(question.weights)
        looked = rates.sum(axis=0)
        if not sensor.stacked:
            cfa = sensor.cfa_indices
            rows, cols = np.arange(rates.shape[1])[:, None], np.arange(rates.shape[2])
            channel = cfa[rows % cfa.shape[0], cols % cfa.shape[1]]  # the period's rows in turn
            rates = np.take_along_axis(rates, channel[None], 0)
        light = float(np.sqrt(np.mean(looked**2)))
        size = float(np.sqrt(np.mean(rates**2))) * (self.level / light if light > 0 else 1.0)
        seconds = sensor.exposure_time if exposure_time is None else exposure_time
        if seconds is None:
            dark = sensor.noise.operating_dark_current
            try:
                automatic, brightest = sensor.auto_exposure, float(looked.max())
                if automatic.method == "highlights" and brightest > 0:
                    # the frame's brightest need not be among these samples
                    top = rates.max() * self.highest / brightest
                    rates = np.append(np.minimum(rates, top), top)
                seconds = automatic.choose(rates + dark, sensor.saturation)[0]
                if automatic.method == "full" and self.highest > 0:
                    seconds *= brightest / self.highest
            except BadData:  # a dark scene: whoever exposes it says so
                seconds = 1.0
        return Operation(float(seconds), size, float(sensor.read_sigma**2))

    def describe(self, notes: Notes):
        """Note the highlights that were split off."""
        split = self.highlights
        if split is None:
            return
        notes.models["optics.splat"] = (
            f"{len(split.places)} highlights added exactly, each with its own spectrum"
        )
        if split.residue:
            notes.beside["local error next to further highlights"] = split.residue

    def beyond(self, question: Question, level: float) -> dict[str, Bound]:
        """Return the named error of the highlights' light beyond their exact cores.

        level: electrons of the frame's root mean square.
        """
        split = self.highlights
        if split is None or not self.level > 0 or has_airy_kernels(question.lens):
            return {}
        mean, most = beyond_errors(
            question.lens, question.scene.wavelengths, question.weights, split.core
        )
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


def whole(question: Question) -> Picture:
    """Return the picture with its highlights."""
    brightness, scene = question.facts.brightness(question.light), question.scene
    return Picture(
        brightness, *seen_light(brightness, question.deviation, scene.margin, scene.border)
    )


def split(question: Question) -> tuple[Question, Picture]:
    """Return the question without highlights, and the picture."""
    scene, picture = question.scene, whole(question)
    if not can_be_split(question) or not picture.is_spiky:
        return question, picture
    brightness = picture.brightness.copy()
    content, highlights = _split_off(question, brightness)
    apart = None
    if highlights is not None:
        question = replace(question, facts=Facts(content))
        lights = (highlights.spectra @ question.weights.T)[highlights.light]
        lights *= highlights.strength[:, None]
        together = (lights.sum(axis=1) ** 2).sum()
        apart = float((lights**2 @ question.share).sum() / max(together, 1e-300))
    return question, replace(picture, brightness=brightness, highlights=highlights, apart=apart)


def _split_off(question, brightness):
    """Content and highlights as of `split_highlights`, with kernels at the points' places in the field."""
    lens, scene = question.lens, question.scene
    longest, varies = max(question.size), not lens.is_uniform
    end, most = 0, MOST_SPOTS if varies else MOST
    strength = 1 / np.pi**3
    if lens.tail is not None:
        strength = lens.tail.strength * (2 if lens.tail.lines else 1)
    airy = has_airy_kernels(lens)
    core = CORE if airy else core_of(lens, scene.wavelengths, most if varies else 1, longest)
    if lens.tail is None:
        end = core
    content, highlights = split_highlights(
        question.facts.samples.whole().on_host(),
        brightness,
        float(question.q.max()) * (1.0 if airy else strength * np.pi**3),
        scene.margin,
        rule_of(scene.border),
        most,
        end,
    )
    if highlights is None or airy:
        return content, highlights
    if lens.tail is not None and lens.tail.lines:  # a streak falls slowly
        highlights = replace(highlights, reach=np.full_like(highlights.reach, longest))
    if varies:
        rows, cols = question.scene.samples
        places = np.clip(highlights.places, 0, (rows - 1, cols - 1))
        middle = (
            (rows - 1) / 2 + question.axis[0] * question.ratio,
            (cols - 1) / 2 + question.axis[1] * question.ratio,
        )
        spots, spot = np.unique((places - middle) / question.corner, axis=0, return_inverse=True)
        spots = np.column_stack([spots, np.zeros_like(spots)])
        highlights = replace(highlights, spot=spot.ravel().astype(np.int32), spots=spots)
    return content, replace(highlights, core=core)


def can_be_split(question: Question) -> bool:
    """Return whether highlights can be split off: their kernels are known, and do not take too long."""
    lens = question.lens
    if (
        lens.is_pointlike
        or question.period
        or question.optics.distortion is not None
        or question.facts.depth is not None
        or not question.scene.view.is_plain
    ):
        return False
    if has_airy_kernels(lens):
        return True
    spots = 1 if lens.is_uniform else MOST_SPOTS
    return core_of(lens, question.scene.wavelengths, spots, max(question.size)) > 0

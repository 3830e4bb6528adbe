"""Highlights: split off the picture if their images can be added exactly."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.optics.highlights import (
    THRESHOLD,
    Highlights,
    median_of,
    split_highlights,
    unsplit_error,
)
from gpusim.optics.outside import rule_of, seen_light, spread_afar
from gpusim.planner.facts import Facts, Operation
from gpusim.planner.question import Notes, Question


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
    content, highlights = split_highlights(
        question.facts.samples.whole().on_host(),
        brightness,
        question.q.max(),
        scene.margin,
        rule_of(scene.border),
    )
    apart = None
    if highlights is not None:
        question = replace(question, facts=Facts(content))
        lights = (highlights.spectra @ question.weights.T)[highlights.light]
        lights *= highlights.strength[:, None]
        together = (lights.sum(axis=1) ** 2).sum()
        apart = float((lights**2 @ question.share).sum() / max(together, 1e-300))
    return question, replace(picture, brightness=brightness, highlights=highlights, apart=apart)


def can_be_split(question: Question) -> bool:
    """Return whether highlights can be split off: their kernels are Airy patterns, integrated over squares."""
    lens, (height, width) = question.lens, question.cell
    return (
        lens.is_airy
        and lens.is_uniform
        and not question.period
        and question.optics.distortion is None
        and question.facts.depth is None
        and question.scene.view.is_plain
        and height == width
        and not any(lens.displacement)
        and (question.ratio > 1 or not question.sensor.stacked)
    )

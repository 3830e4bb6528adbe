"""Border: how much of the world around the frame takes part in the blur."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import ceil, sqrt

import numpy as np
from scipy.special import j0, j1

from gpusim.domain.account import Bound, total
from gpusim.domain.errors import OutOfRange
from gpusim.optics.depth import DepthPlan
from gpusim.optics.fusion import in_range
from gpusim.optics.highlights import TRANSFORM_ERROR
from gpusim.optics.lengths import LENGTHS, Tiling, tiling, transform_lengths
from gpusim.optics.outside import BORDER_REACH, Outside, most_reach
from gpusim.planner.knobs.farfield import (
    TILES_SPACINGS,
    FarField,
    far_field,
    has_far_field,
    ring_errors,
    seam_error,
    spline_error,
)
from gpusim.planner.knobs.highlights import Picture
from gpusim.planner.question import Notes, Question

# [pixel] beyond which the world is left to Gaussians, for a tolerance
FAR_REACHES = (
    16,
    32,
    64,
    128,
    256,
)
OVERLAPS = (8, 12, 16)  # [sample] of tiles, for a tolerance
# 99.9 % quantile and maximum of waves all over the frame, over their RMS in its darkest part
EVEN = (
    2.0,
    2.5,
)
SMALL = 0.25  # of a tolerance: errors predicted within a factor of 2.5 do not break it
BRIGHT = 1e9  # [e- s-1] of a frame from which on its light is scaled: squares of float32 sums end at 3e38
MOST_AROUND = 4  # samples on each side whose light approximates the mix of a lens


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Part of the world around the frame that takes part in the blur.

    Attributes:
        reach: Surroundings on each side [pixel].
        reaches: Surroundings along each axis [sample].
        period: Lengths of the transforms [sample].
        folds: Whether the mosaic folds into them.
        outside: Facts of the light around the frame.
        level: Electrons of the frame's root mean square.
        far: Model of the world beyond; None ignores it.
        tiling: Of tiles that overlap by so much; None: the frame is one transform.
        question: The question.
    """

    reach: int
    reaches: list[int]
    period: tuple[int, int]
    folds: bool
    outside: Outside
    level: float
    far: FarField | None
    tiling: Tiling | None
    question: Question

    @cached_property
    def bound(self) -> Bound:
        """Error of light that is not seen, or seen on the wrong side."""
        if self.far is None:
            figures = self.outside.error(self.period, min(self.reaches))
        elif self.tiling is None:
            return self._even(seam_error(self.outside, self.question, self.period))
        else:
            figures = ring_errors(self.outside, self.question, self.tiling, self.far)
        rms, p999, most = figures
        bound = Bound(rms, p999 * sqrt(self.level), most * sqrt(self.level))
        return bound if self.far is None else total([bound, self.splines])

    @cached_property
    def splines(self) -> Bound:
        """Error of the splines that carry far light to tiles."""
        assert self.far is not None
        return self._even(spline_error(self.far, self.outside, self.question))

    def _even(self, rms):
        """An error that is the same everywhere."""
        p999, most = self.outside.darkest
        root = sqrt(self.level)
        return Bound(rms, EVEN[0] * root * rms * p999, EVEN[1] * root * rms * most)

    @property
    def spare(self) -> int:
        """Samples around the scene's own that can be blurred, too."""
        if self.tiling is not None and self.far is not None:
            return int(self.far.sigmas[0] / self.far.spacings)
        (height, width), (rows, cols) = self.period, self.question.size
        return min((height - rows) // 2, (width - cols) // 2)

    @cached_property
    def brighter(self) -> float:
        """Root mean square of the transforms' input over the frame's, at least 1."""
        return 1.0 if self.tiling is not None else self.outside.brighter(self.period)

    def describe(self, question: Question, notes: Notes):
        """Note the light that is not seen."""
        notes.bounds["border"] = self.bound
        if self.far is not None:
            outside = f"more than {self.reach} pixels outside the frame"
            if self.tiling is not None:
                side, overlap = self.tiling.side, self.tiling.overlap
                outside = f"outside each {side} x {side} tile ({overlap} samples overlap)"
            count = len(self.far.sigmas)
            notes.models["optics.far"] = f"light from {outside}: {count} Gaussians"
            notes.models["optics.near"] = "transfer functions minus the Gaussians'"
            return
        reach = min(self.reaches)
        if question.tolerance is None and self.bound.rms > TRANSFORM_ERROR:
            notes.leave_out(
                f"light from more than {reach / question.ratio:.4g} pixels outside the frame: the periodic "
                "transforms take it from the repeated picture",
                self.bound,
                "border",
            )
        if question.lens.is_airy:  # J0(v)^2 + J1(v)^2, v = pi r / q (Rayleigh 1881)
            v = np.pi * reach / question.q.max()
            notes.beside["kernel energy beyond the surroundings"] = float(j0(v) ** 2 + j1(v) ** 2)


def surroundings(
    question: Question, picture: Picture, depth: DepthPlan | None, level: float
) -> Iterator[list[Surroundings]]:
    """Yield lists of surroundings: the prescribed one; or BORDER_REACH and, for a tolerance, other ways, increasing.

    If the lens allows it, the others are smaller or larger surroundings with an endless world
    beyond, modelled by Gaussians; else each has twice the surroundings of the one before. Measured
    spreads end: the frame then sees as far as they reach, if they fit into its transforms. Raises
    OutOfRange.

    level: electrons of the frame's root mean square.
    """
    outside, ratio = _outside(question, picture, depth, level), question.ratio
    # samples that take part in addition to the reach
    beside = (ceil(depth.reach) if depth else 0) + question.more
    (rows, cols), cfa, reach = question.size, np.shape(question.sensor.cfa_indices), question.reach

    def around(reach, far=None):
        more = ceil(reach * ratio) + beside
        reaches = [more, more]
        if outside.border == "zero" and far is None:
            reaches = [max(more, ceil(rows / 2)), max(more, ceil(cols / 2))]
        period, folds = question.period, False
        if not period:
            least = [rows + 2 * reaches[0], cols + 2 * reaches[1]]
            period, folds = transform_lengths(least, cfa)
        if None in period:
            raise OutOfRange(
                "scene size with surroundings",
                f"{cols + 2 * reaches[1]} x {rows + 2 * reaches[0]} samples",
                "what fits into the transforms: a smaller scene, reach or aperture",
            )
        return Surroundings(reach, reaches, period, folds, outside, level, far, None, question)

    def in_tiles(overlap, tails):
        tiles, folds = tiling(overlap, cfa)
        reach, side, made = tiles.overlap, tiles.side, None
        for spacings in TILES_SPACINGS:  # the fewest that are no matter
            field = far_field(question, tails, reach, side, spacings)
            if field is None:
                return None
            made = Surroundings(
                ceil(reach / ratio),
                [reach, reach],
                (side, side),
                folds,
                outside,
                level,
                field,
                tiles,
                question,
            )
            if made.splines.ratio(question.tolerance) <= SMALL:
                break
        return made

    if reach is not None:
        yield [around(reach)]
        return
    reach = BORDER_REACH
    room = min(question.size) + 2 * BORDER_REACH * ratio
    if question.lens.tail is None and 2 * outside.spread <= room:
        reach = max(BORDER_REACH, ceil(outside.spread / ratio))
    first = around(reach)
    if question.tolerance is None:
        yield [first]
        return
    most = int((most_reach(question.size, LENGTHS[-1]) - beside) / ratio)
    if not has_far_field(question, depth is not None):
        yield [first]
        while reach < most:
            reach = min(2 * reach, most)
            yield [around(reach)]
        return
    tails = question.lens.tails(question.scene.wavelengths)
    near = [first]
    wider: list[Surroundings] = []
    is_even = question.lens.symmetry.is_round and not any(question.lens.displacement)
    for overlap in OVERLAPS if is_even else ():
        tiles = in_tiles(overlap, tails)
        if tiles is not None:
            near.append(tiles)
    for reach in FAR_REACHES:
        field = far_field(question, tails, reach * ratio)
        if field is not None and reach <= max(most, BORDER_REACH):
            together = near if reach <= BORDER_REACH else wider
            together.append(around(reach, field))
    yield near
    for one in wider:
        yield [one]


def surroundings_of(
    question: Question,
    picture: Picture,
    level: float,
    period: tuple[int, int],
    far: FarField | None,
    made: Tiling | None,
) -> Surroundings:
    """Return the surroundings of a plan that was made for another scene.

    level: see `surroundings`. made: its tiling.
    """
    (height, width), (rows, cols) = period, question.size
    reaches = [(height - rows) // 2, (width - cols) // 2]
    if made is not None:
        reaches = [made.overlap, made.overlap]
    reach = ceil(min(reaches) / question.ratio)
    outside = _outside(question, picture, None, level)
    return Surroundings(reach, reaches, period, False, outside, level, far, made, question)


def _outside(question, picture, depth, level):
    scene, split, tail = question.scene, picture.highlights, question.lens.tail
    spread = 0
    if question.is_blurred:
        spread = depth.reach if depth else question.spread
    if question.period:
        tail = None
    missing = split.missing if split else 0.0
    fields = (
        scene.border,
        scene.margin,
        tail.strength * question.mean_q if tail else 0,
        spread,
        picture.level,
        missing,
        min(round(question.deviation), MOST_AROUND),
        *((tail.lines, tail.line_share) if tail else ((), 0.0)),
        question.deviation,
        not scene.view.is_plain,
    )
    key = picture.brightness, *fields
    found = question.facts.hold("outside", key, lambda: _look_outside(*key))
    return found.at(max(question.sensor.read_sigma**2, 1) / level)


def _look_outside(light, border, margin, tail, spread, level, missing, *others):
    """Return the facts of the world around the frame, without read noise."""
    unit = 1.0
    if level > BRIGHT:  # all results are over the level
        light, power = in_range(light)
        unit = 2.0**-power
    return Outside(light, border, margin, tail, spread, level * unit, 0.0, missing * unit, *others)

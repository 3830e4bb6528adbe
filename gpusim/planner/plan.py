"""From a scene and a camera to what is computed: host float64 mathematics, no device."""

import functools
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from gpusim.domain.account import Account, Bound, Tolerance, Verdict, total
from gpusim.domain.camera import Camera
from gpusim.domain.content import Content
from gpusim.domain.digest import digest
from gpusim.domain.scene import Scene
from gpusim.domain.short_repr import shorten_repr
from gpusim.optics.depth import DepthPlan
from gpusim.optics.field import FieldBlur
from gpusim.optics.fusion import Watch
from gpusim.optics.geometry import DistortionGrid
from gpusim.optics.highlights import THRESHOLD, TRANSFORM_ERROR, Highlights
from gpusim.optics.lengths import Tiling
from gpusim.optics.tables import Caching, call_always
from gpusim.planner.choices import Blur, Falloff, Fusion, Goal, Planes, Sampling
from gpusim.planner.facts import Facts
from gpusim.planner.knobs import blur, border, highlights, pixels, spectral
from gpusim.planner.knobs.blur import doubt_of
from gpusim.planner.knobs.farfield import FarField
from gpusim.planner.probes import Probes
from gpusim.planner.question import Notes, Question
from gpusim.planner.search import (
    HEADROOM,
    REMEDIES,
    Candidate,
    choose_option,
    front,
    options,
    remedy,
)

# relative RMS of electrons stored as float32: evenly up to half of the last bit
STORED = 2.0**-24 / 3**0.5
LETTERS = 12  # of a plan's name
Kind = TypeVar("Kind")
ROUNDING = 1.2e-7  # relative RMS of float32 sums over the wavelengths, without transforms


@dataclass(frozen=True, eq=False)
class Plan:
    """What a frame of `scene` by `camera` takes; every array is float64.

    scene, camera: what it is for. weights: electrons per second in each channel for content 1 at each of the scene's
    wavelengths, shape (C, L).
    flat: what a flat field of each wavelength gives where every sample is a point of light of 1, shape (L,).
    content: the scene's, without its highlights.
    q: wavelength times working f-number over the distance of samples at each wavelength, shape (L,).
    slope: tangent of the field angle per pixel; 0 if the cos^4 law is not used.
    choices: the parts that frames are made of, at most one of each kind: `Planes`, `Blur`, `Fusion`, `Sampling`,
        `Falloff` and `Goal` of gpusim.planner.choices; Highlights that were split off the content; FieldBlur, what the
        blur has more than that on the axis; DepthPlan, how the blur goes by distance; DistortionGrid; Tiling of the
        frame into tiles of the blur's period; FarField, what the world beyond the blur's reach is left to; Watch, which
        tells whether the fused planes still do for other contents. See `find`.
    account: named errors of the scene as sampled.
    models: stage -> what is modelled, and why; left_out: what is not. beside: named errors that are no part of the
        account. tell_front: gives `front`.
    bytes_needed: device memory of a frame, where it was planned for a device; else 0.
    single: whether the account is that of float32.
    planned_for: name of the scene of the same kind that it was made for, if that is another; most predicted errors are
        of that one then. probed: which scene's probes told the others, or why the plan was made anew.
    is_draft: whether it was made for another lens, see `gpusim.planner.draft`: the account is of that.
    given_of: name of the scene that it was made for, if it was given for another, whose account it has.
    """

    scene: Scene
    camera: Camera
    weights: np.ndarray
    flat: np.ndarray
    content: Content
    q: np.ndarray
    slope: float
    choices: tuple
    account: Account
    models: dict = field(default_factory=dict)
    left_out: list = field(default_factory=list)
    beside: dict = field(default_factory=dict)
    tell_front: Callable[[], tuple[Candidate, ...]] = tuple
    bytes_needed: int = 0
    single: bool = True
    planned_for: str = ""
    probed: str = ""
    is_draft: bool = False
    given_of: str = ""

    def __repr__(self):
        rows, cols = self.scene.shape
        planes, blur = self.find(Planes), self.find(Blur)
        return shorten_repr(
            f"Plan({self.scene.name} {cols}x{rows} by {self.camera.name}: "
            f"{len(self.weights if planes is None else planes.table)} planes"
            f"{'' if blur is None else f', transforms of {blur.period[1]}x{blur.period[0]}'}, "
            f"predicted rms {self.account.total.rms:.2g})"
        )

    def find(self, kind: type[Kind]) -> Kind | None:
        """Return the choice of a kind, or None if frames do without that part."""
        return self._by_kind.get(kind)

    @cached_property
    def _by_kind(self) -> dict:
        return {type(choice): choice for choice in self.choices}

    def exchange(self, *choices, without: tuple[type, ...] = (), **changes) -> "Plan":
        """Return the plan with other choices of their kinds, without some kinds, and with other fields."""
        kinds = (*without, *map(type, choices))
        rest = (choice for choice in self.choices if not isinstance(choice, kinds))
        return replace(self, choices=(*rest, *choices), **changes)

    @property
    def period(self) -> tuple[int, int]:
        """Lengths of the transforms [sample]; without blur, the samples."""
        blur = self.find(Blur)
        return self.content.shape if blur is None else blur.period

    @property
    def white_rate(self) -> np.ndarray | None:
        """Electrons per second that a perfect white diffuser gives in each channel, on axis, shape (C,).

        None if the scene's light is unknown.
        """
        return self.weights.sum(axis=1) if self.scene.light_is_known else None

    @property
    def tolerance(self) -> Tolerance | None:
        """The tolerance that the plan is judged by, or None."""
        goal = self.find(Goal)
        return None if goal is None else goal.tolerance

    @cached_property
    def verdict(self) -> Verdict | None:
        """Whether the tolerance is met; None without one, and for a draft."""
        goal = self.find(Goal)
        if goal is None or self.is_draft:
            return None
        return self.account.verdict(goal.tolerance, goal.remedy)

    @cached_property
    def front(self) -> tuple[Candidate, ...]:
        """The options that were cheaper, or more accurate, from the cheapest on; computed when it is asked for."""
        return self.tell_front()

    def __getstate__(self):
        """Its fields, with its front in place of what this is computed from."""
        return {**self.__dict__, "tell_front": functools.partial(tuple, self.front)}

    @cached_property
    def name(self) -> str:
        """Digest of its decisions: plans of one name make the same frame of a scene, bit for bit on one device.

        What it predicts and the samples of its scene have no part in it. Computed numbers count as float32, as devices
        take them.
        """
        optics = self.camera.optics
        sensor = self.camera.sensor
        scene = self.scene
        planes, blur, fusion = self.find(Planes), self.find(Blur), self.find(Fusion)
        varying, depth, grid = self.find(FieldBlur), self.find(DepthPlan), self.find(DistortionGrid)
        taps, gains, far = self.find(Sampling), self.find(Falloff), self.find(FarField)
        numbers = (
            self.weights,
            self.white_rate,
            self.flat,
            planes and planes.table,
            blur and blur.mix,
            fusion and fusion.transfers,
            gains and gains.gains,
            self.q,
            self.slope,
            taps and [(axis.start, axis.weights) for axis in (taps.rows, taps.cols)],
            far and (far.sigmas, far.tails, far.spacings),
            grid and grid.nodes,
            varying and (varying.kernels, varying.edges),
            depth and (depth.distances, depth.kernels, depth.confusion),
        )
        choices = (
            *((blur.folded, blur.spare, blur.period) if blur else (False, 0, self.content.shape)),
            self.find(Tiling),
            far and far.border,
            self.find(Highlights),
            grid and grid.method,
            varying and (varying.method, varying.index),
            depth and (depth.layers, depth.layer),
        )
        kind = scene.content.shape, scene.border, scene.margin, float(scene.samples_per_pixel)
        return digest(
            (
                kind,
                optics,
                sensor.pixel_pitch,
                sensor.aperture,
                sensor.displacement,
                sensor.cfa,
                sensor.channels,
                _as_float32(numbers),
                choices,
            )
        )[:LETTERS]

    @property
    def count(self) -> int:
        """Planes that are blurred."""
        blur = self.find(Blur)
        return 0 if blur is None else blur.mix.shape[-1]

    @property
    def is_placed(self) -> bool:
        """Whether samples are interpolated where the lens or the view puts them."""
        return not self.scene.view.is_plain or self.find(DistortionGrid) is not None

    @property
    def watched(self) -> str:
        """Name of the error that the watch predicts."""
        return "planes" if self.find(Blur) else "blur left out"

    def serves(self, scene: Scene) -> bool:
        """Whether it also says how to make a frame of another scene: of the same kind, and nothing here is of pixels.

        Its predicted errors are those of its own scene then.
        """
        return not self.misfit(scene)

    def misfit(self, scene: Scene) -> str:
        """Why it does not say how to make a frame of another scene, in words; "" if it does."""
        own = self.scene
        for part, why in (
            (self.find(Highlights), "it has split off the highlights of its own scene"),
            (self.find(FieldBlur), "its blur varies over the field, by its own scene's light"),
            (own.depth, "its blur goes by its own scene's depth"),
            (scene.depth, "that scene has depth"),
        ):
            if part is not None:
                return why
        if not own.content.is_like(scene.content):
            return "wanted content of the same kind, wavelengths and entries"
        light, its = own.illuminant, scene.illuminant
        if light is not its and not (
            np.array_equal(light.values, its.values)
            and np.array_equal(light.wavelengths, its.wavelengths)
        ):
            return "wanted the same light"
        ratio = own.samples_per_pixel
        if own.view.is_plain != scene.view.is_plain or own.view.is_whole(
            ratio
        ) != scene.view.is_whole(ratio):
            return "wanted a view of the same kind"
        pairs = [
            ("samples", own.content.shape, scene.content.shape),
            *(
                (name, getattr(own, name), getattr(scene, name))
                for name in ("border", "margin", "fov", "samples_per_pixel")
            ),
        ]
        return next(
            (f"its {name}: {its}, wanted {wanted}" for name, wanted, its in pairs if wanted != its),
            "",
        )

    def lasts(self, exposure_time: float | None) -> bool:
        """Whether a tolerance that it meets is met by it at another exposure time [s], too; None: that of its own."""
        if (
            exposure_time in (None, self.account.seconds)
            or self.tolerance is None
            or self.verdict is None
            or not self.verdict.is_met
        ):
            return True
        return self.account.at(exposure_time).verdict(self.tolerance).is_met

    def fits(self, light, drift: float | None) -> bool:
        """Whether it is as right for a scene that it serves as it was to be for its own.

        light: statistics of the scene's mean electrons, see `sensor.meter`. drift: what the watch says of it, or
        None. What is up to THRESHOLD times the mean is no highlight: the transforms' error beside it is below 10 of
        TRANSFORM_ERROR times the mean.
        """
        highest, mean = light[:2]
        if self.find(Blur) and highest > THRESHOLD * mean:
            return False
        watch = self.find(Watch)
        return drift is None or watch is None or drift <= watch.limit

    def of(self, scene: Scene, drift: float | None, account: Account | None = None) -> "Plan":
        """The same as that of another scene that it serves.

        drift: see `fits`. account: of that scene, where more is known than that.
        """
        if account is None:
            bounds, name = self.account.bounds, self.watched
            if drift is not None and bounds.get(name, Bound()).rms:
                bounds = bounds | {name: bounds[name].times(drift / bounds[name].rms)}
            account = replace(self.account, bounds=bounds)
        return replace(self, scene=scene, planned_for=self.scene.name, account=account)


def plan(
    scene: Scene,
    camera: Camera,
    *,
    tolerance: Tolerance | None = None,
    guaranteed: bool = False,
    reach: int | None = None,
    period: tuple[int, int] | None = None,
    cache: Caching = call_always,
    facts: Facts | None = None,
    exposure_time: float | None = None,
    single: bool = True,
    on_gpu: bool = False,
    least: int = 0,
) -> Plan:
    """Decide how `scene` is seen by `camera`.

    tolerance: of all ways that are predicted to meet it the cheapest; where none does, and none of these is dearer than
    the exact way, the most accurate. Without one every wavelength is exact.
    guaranteed: choose the planes for the worst spectrum there can be, not for likely ones.
    reach: pixels of surroundings on each side that take part in the blur, by default BORDER_REACH or what the tolerance
    needs, if that is not too much (`most_reach`). period: of the transforms [sample], for the reference: no mosaic is
    folded and no highlight split off then. cache: gives results of earlier plans, see `Caching`; by default nothing.
    facts: of the scene, where they were read before. exposure_time: that it will be exposed for, where it is not the
    camera's own [s].
    single: whether it is computed in float32, whose rounding is an error of its own; else in float64, of which the
    electrons alone are rounded. on_gpu: whether a GPU computes it.
    least: planes that the blur has at least, where scenes of this kind were found to need them; 0: it may be left out.
    A dark world (border "zero") gets at least half the frame, so that what comes back on the other side of the frame
    comes from a frame's width away or more. That is part of the predicted border error.
    Raises BadData when their wavelengths do not overlap, OutOfRange when the sensor's curves do not cover the light,
    when the pixels are far too coarse for the lens, and for a displaced grid that the blur asked for cannot honour.
    """
    question = Question.of(
        scene,
        camera,
        Facts.of(scene) if facts is None else facts,
        tolerance,
        guaranteed=guaranteed,
        reach=reach,
        period=period,
        cache=cache,
        on_gpu=on_gpu,
        least=least,
    )
    question, picture = highlights.split(question)
    notes, operation, probes = Notes(), picture.operation(question, exposure_time), None
    blurred = question
    if tolerance is not None:
        probes = spectral.probes_of(question, picture, operation)
        blurred = question = question.with_limit(probes)
        if question.is_blurred:
            question = blur.left_out(question, picture, probes, notes)
    told = functools.cache(lambda: probes or spectral.probes_of(question, picture, operation))
    if not scene.view.is_plain:
        pixels.note_view(question, told(), notes)
    placed = pixels.plan_distortion(question, told, notes)
    by_depth = blur.by_depth(question, told, notes)
    fixed = rounding_of(question, probes, single)
    seen = (
        _seen(question, picture, probes, operation, by_depth, fixed, notes)
        if question.is_blurred
        else _plain(question, blurred, fixed, notes)
    )
    taps, spare = pixels.taps_of(question, seen.around.spare if seen.around else 0)
    blur.describe_depth(by_depth, notes)
    picture.describe(notes)
    distortion = pixels.choose_distortion(question, placed, probes, notes)
    pixels.describe_calibration(question, notes)
    gains, slope = pixels.falloff_of(question, probes, notes)
    around = seen.around
    if around:
        around.describe(question, notes)
    spectral.describe_unseen(question, notes)
    pixels.describe(question, taps, notes)
    choices = (
        *seen.way.choices,
        around and Blur(seen.way.mix, around.period, seen.folded, spare),
        around and around.tiling,
        around and around.far,
        picture.highlights,
        by_depth,
        distortion,
        taps and Sampling(*taps),
        None if gains is None else Falloff(gains),
        tolerance and Goal(tolerance, seen.remedy),
    )
    return Plan(
        scene,
        camera,
        question.weights,
        seen.way.flat,
        question.content,
        question.q,
        slope,
        tuple(choice for choice in choices if choice is not None),
        Account(notes.bounds, operation.seconds, doubt_of(question)),
        notes.models,
        notes.left_out,
        notes.beside,
        seen.tell_front,
        single=single,
    )


def rounding_of(question: Question, probes: Probes | None, single: bool) -> dict[str, Bound]:
    """The named error of rounding. probes: of the scene, if there is a tolerance. single: see `plan`."""
    name, rounding = "rounding", ROUNDING if single else STORED
    if single and question.is_blurred:
        name, rounding = "transforms", TRANSFORM_ERROR
    return {name: Bound(rounding) if probes is None else probes.even_error(rounding)}


def _as_float32(value):
    """Arrays and numbers as devices take them: float32."""
    if isinstance(value, list | tuple):
        return tuple(map(_as_float32, value))
    return np.asarray(value, np.float32) if isinstance(value, float | np.ndarray) else value


@dataclass(frozen=True, eq=False)
class _Seen:
    """How a scene is seen: its planes, and what the blur is made of."""

    way: spectral.Fused
    around: border.Surroundings | None = None
    folded: bool = False
    tell_front: Callable[[], tuple[Candidate, ...]] = tuple
    remedy: str = ""


def _plain(question, blurred, fixed, notes):
    """Without blur. blurred: the question before one was left out, if it was."""
    notes.bounds |= fixed
    way = spectral.planes_without_blur(question, notes)
    if blurred.is_blurred:
        bound = notes.bounds.get("blur left out", Bound())  # of a dark scene it is none
        watch = spectral.watch_of_no_blur(blurred, bound)
        watch = replace(watch, limit=max(blurred.limit, HEADROOM * bound.rms))
        way = replace(way, choices=(*way.choices, watch))
    by = max(notes.bounds, key=lambda name: notes.bounds[name].rms)
    return _Seen(way, remedy=REMEDIES.get(by, "a larger tolerance would be met"))


def _seen(question, picture, probes, operation, by_depth, fixed, notes):
    """The best way to blur; fixed: errors of all ways."""
    tolerance = question.tolerance
    fixed |= notes.bounds | blur.bounds_of(by_depth, probes)
    arounds = border.surroundings(question, picture, by_depth, operation.level)
    found = options(
        question,
        spectral.ways(question, probes),
        arounds,
        fixed,
        lambda around: blur.form_of(question, around, by_depth)[1],
    )
    option, needed = choose_option(found, tolerance), remedy(question, found, arounds, fixed)
    form, folded = blur.form_of(question, option.around, by_depth)
    notes.bounds |= {name: bound for name, bound in option.bounds.items() if bound != Bound()}
    limit = np.inf
    if tolerance is not None:  # of the planes, for other scenes: what the other errors leave
        rest = total(bound for name, bound in option.bounds.items() if name != "planes").rms
        # what is missed already may be missed as much
        own = HEADROOM * total((Bound(rest), option.way.bound)).rms
        limit = (max(question.limit, own) ** 2 - rest**2) ** 0.5
    way = option.way.make(limit)
    picture.describe_unsplit(notes)
    way.describe(question, notes)
    blur.describe(question, form, option.way.words, by_depth is not None, notes)
    way.describe_tables(question, notes)
    return _Seen(
        way,
        option.around,
        folded,
        tuple if tolerance is None else lambda: front(found, tolerance),
        needed,
    )

"""Plans of frames: the steps that a scene and a camera need, decided on the host in float64."""

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
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
from gpusim.optics.blas import one_core
from gpusim.optics.depth import DepthPlan
from gpusim.optics.field import FieldBlur
from gpusim.optics.fusion import Watch
from gpusim.optics.geometry import DistortionGrid
from gpusim.optics.highlights import THRESHOLD, TRANSFORM_ERROR, Highlights
from gpusim.optics.kernel_space import KernelSpace
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
    """How frames of a scene by a camera are computed. Every array is float64.

    Attributes:
        scene: The scene.
        camera: The camera.
        weights: Electrons per second in each channel for content 1 at each wavelength of the scene,
            shape (C, L).
        flat: Response to a flat field of each wavelength if every sample is a unit point source,
            shape (L,).
        content: Content of the scene, without the highlights that are added separately.
        q: Wavelength times working f-number over the distance of samples, shape (L,).
        slope: Tangent of the field angle per pixel; 0 if the cos^4 law is not used.
        choices: Parts that frames are made of, at most one of each kind. `Planes`, `Blur`,
            `Fusion`, `Sampling`, `Falloff` and `Goal` are in gpusim.planner.choices. Highlights are
            split off the content. FieldBlur is the difference from the blur on the axis, DepthPlan
            the blur by distance, DistortionGrid the distortion of the lens. Tiling divides the
            frame into tiles of the blur's period. FarField models the world beyond the blur's
            reach. Watch compares other contents with this one, and predicts the error of fused planes for them.
        account: Named errors of the scene as sampled.
        models: Stage -> model in words, and the reason for it.
        left_out: Effects that are not modelled, in words.
        beside: Named errors that are no part of the account.
        tell_front: Function that returns `front`.
        bytes_needed: Device memory of a frame [byte]; 0 if the plan was made without a device.
        single: Whether the account is for float32.
        planned_for: Name of the scene of the same kind that the plan was made for, if it is another
            one. Without probes most predicted errors are for that scene.
        probed: Scene whose probes gave the other errors, or the reason for a new plan.
        is_draft: Whether the lens is another than the account's, see `gpusim.planner.draft`.
        given_of: Name of the scene that the plan was made for, if the caller gave the plan for
            another scene. The account is for the latter.
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
        """The options that are cheaper or more accurate, from the cheapest on; computed on first use."""
        return self.tell_front()

    def __getstate__(self):
        """Return the fields, with the computed front in place of its function."""
        return {**self.__dict__, "tell_front": functools.partial(tuple, self.front)}

    @cached_property
    def name(self) -> str:
        """Digest of the decisions: plans of one name make the same frame of a scene, bit for bit on one device.

        It includes neither predicted errors nor the samples of the scene. Computed numbers count as
        float32, like on devices.
        """
        optics = self.camera.optics
        sensor = self.camera.sensor
        scene = self.scene
        planes, blur, fusion = self.find(Planes), self.find(Blur), self.find(Fusion)
        varying, depth, grid = self.find(FieldBlur), self.find(DepthPlan), self.find(DistortionGrid)
        space = self.find(KernelSpace)
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
            space and (space.kernels, space.edges, space.values),
            depth and (depth.distances, depth.kernels, depth.confusion),
            depth
            and (rays := depth.occlusion)
            and (rays.radii, rays.points, rays.weights, rays.bends, rays.maps, rays.slopes),
        )
        choices = (
            *((blur.folded, blur.spare, blur.period) if blur else (False, 0, self.content.shape)),
            self.find(Tiling),
            far and far.border,
            self.find(Highlights),
            grid and (grid.method, grid.is_even),
            varying and (varying.method, varying.index),
            depth and (depth.layers, depth.layer),
            depth and depth.groups,
            depth and depth.occlusion and (depth.occlusion.places, depth.occlusion.is_diffracted),
            *(() if space is None or space.coarse is None else ("far part on a coarse grid",)),
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
        """Number of planes that are blurred."""
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
        """Return whether frames of another scene can be made with this plan.

        The scene must be of the same kind, and no part of the plan may depend on pixels. The predicted
        errors stay those of the plan's own scene.
        """
        return not self.misfit(scene)

    def misfit(self, scene: Scene) -> str:
        """Return the reason why frames of another scene cannot be made with this plan; "" if they can."""
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
                for name in (
                    "border",
                    "margin",
                    "fov",
                    "samples_per_pixel",
                    "projection",
                    "image_of",
                )
            ),
        ]
        return next(
            (f"its {name}: {its}, wanted {wanted}" for name, wanted, its in pairs if wanted != its),
            "",
        )

    def lasts(self, exposure_time: float | None) -> bool:
        """Return whether a tolerance that is met stays met at another exposure time [s].

        None stands for the exposure time of the account.
        """
        if exposure_time is None or self.verdict is None or not self.verdict.is_met:
            return True
        return self.meets(exposure_time)

    def meets(self, exposure_time: float) -> bool:
        """Return whether the tolerance is met at an exposure time [s], or there is none to meet."""
        if self.is_draft or self.tolerance is None:
            return True
        return self.account.at(exposure_time).verdict(self.tolerance).is_met

    def fits(self, light, drift: float | None) -> bool:
        """Return whether the plan is as accurate for another scene that it serves as for its own.

        Light up to THRESHOLD times the mean is no highlight: the error of the transforms next to it is
        below 10 times TRANSFORM_ERROR of the mean.

        Args:
            light: Statistics of the scene's mean electrons, see `sensor.meter`.
            drift: Relative RMS error that the watch predicts, or None.
        """
        highest, mean = light[:2]
        if self.find(Blur) and highest > THRESHOLD * mean:
            return False
        watch = self.find(Watch)
        return drift is None or watch is None or drift <= watch.limit

    def of(self, scene: Scene, drift: float | None, account: Account | None = None) -> "Plan":
        """Return the plan for another scene that it serves.

        Args:
            scene: The scene.
            drift: See `fits`.
            account: Errors for that scene, if more is known than the drift.
        """
        if account is None:
            bounds, name = self.account.bounds, self.watched
            if drift is not None and bounds.get(name, Bound()).rms:
                bounds = bounds | {name: bounds[name].times(drift / bounds[name].rms)}
            account = replace(self.account, bounds=bounds)
        return replace(self, scene=scene, planned_for=self.scene.name, account=account)


@one_core()
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
    brightness: float = 1.0,
) -> Plan:
    """Return the plan for frames of a scene by a camera.

    Of all ways that are predicted to meet the tolerance it takes the cheapest. If none does, and
    none of these costs more than the exact way, it takes the most accurate. A dark world (border
    "zero") gets at least half the frame on each side: light that the periodic transforms bring back
    comes from at least a frame's width away. This is part of the predicted border error.

    Args:
        scene: The scene.
        camera: The camera.
        tolerance: Limits on the errors; None computes every wavelength exactly.
        guaranteed: Whether to choose planes for the worst possible spectrum instead of likely ones.
        reach: Surroundings on each side that take part in the blur [pixel]; None: BORDER_REACH, or
            as far as the tolerance needs and `most_reach` allows.
        period: Lengths of the transforms [sample], for the reference. With it no mosaic is folded
            and no highlight split off.
        cache: Stores results for later plans, see `Caching`.
        facts: Facts of the scene, if they were read before.
        exposure_time: Exposure time [s]; None: the camera's own.
        single: Whether frames are computed in float32, whose rounding is an error of its own. In
            float64 only the electrons are rounded.
        on_gpu: Whether a GPU computes the frames.
        least: Least number of blurred planes, if scenes of this kind were found to need them; 0: the
            blur may be left out.
        brightness: Factor on the scene's light. The account is for as much light, at the exposure time
            times this factor.

    Raises:
        BadData: The wavelengths of scene and sensor do not overlap.
        OutOfRange: The sensor's curves do not cover the light, the pixels are far too coarse for the
            lens, or the blur cannot honour a displaced grid.
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
    operation = picture.operation(question, exposure_time, brightness)
    notes, probes = Notes(), None
    blurred = question
    if tolerance is not None:
        probes = spectral.probes_of(question, picture, operation)
        blurred = question = question.with_limit(probes)
        if question.is_blurred:
            question = blur.left_out(question, picture, probes, notes)
    notes.bounds |= picture.beyond(question, operation.level)
    spectral.describe_sampling(question, probes, notes)
    told = functools.cache(lambda: probes or spectral.probes_of(question, picture, operation))
    if not scene.view.is_plain:
        pixels.note_view(question, told(), notes)
    with ThreadPoolExecutor(1) as pool:  # NumPy lets other threads run
        placing = pool.submit(pixels.plan_distortion, question, told, notes)
        by_depth = blur.by_depth(question, told, placing.result, notes)
        placed = placing.result()
    fixed = rounding_of(question, probes, single)
    seen = (
        _seen(question, picture, probes, operation, by_depth, fixed, notes)
        if question.is_blurred
        else _plain(question, blurred, fixed, notes)
    )
    taps, spare = pixels.taps_of(question, seen.around.spare if seen.around else 0)
    varying = (choice for choice in seen.way.choices if isinstance(choice, KernelSpace))
    blur.describe_depth(by_depth, next(varying, None), notes)
    picture.describe(notes)
    distortion = pixels.choose_distortion(question, placed, probes, notes)
    pixels.describe_calibration(question, notes)
    falloff, slope = pixels.falloff_of(question, probes, notes)
    watched = any(isinstance(choice, Watch | FieldBlur) for choice in seen.way.choices)
    watch = (
        Watch.of_exact(question.weights, question.share, question.content, scene.samples)
        if tolerance is not None and not watched and by_depth is None
        else None
    )
    around, rim = seen.around, question.rim if distortion else 0
    if around:
        around.describe(question, notes)
    spectral.describe_unseen(question, notes)
    pixels.describe(question, taps, notes)
    choices = (
        *seen.way.choices,
        around and Blur(seen.way.mix, around.period, seen.folded, spare, rim),
        around and around.tiling,
        around and around.far,
        picture.highlights,
        by_depth,
        distortion,
        taps and Sampling(*taps),
        falloff,
        watch and watch.with_scale(question.facts.pairs),
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
    """Return the named errors of rounding and of tables.

    probes: of the scene, if there is a tolerance. single: see `plan`.
    """
    name, rounding = "rounding", ROUNDING if single else STORED
    if single and question.is_blurred:
        name, rounding = "transforms", TRANSFORM_ERROR
    found = {name: Bound(rounding) if probes is None else probes.even_error(rounding)}
    lens, nodes = question.lens, question.scene.wavelengths
    if error := question.cache("table error", type(lens).table_error, lens, nodes):
        found["transfer tables"] = Bound(error) if probes is None else probes.change_error(error)
    return found


def _as_float32(value):
    """Return arrays and numbers as float32, like on devices."""
    if isinstance(value, list | tuple):
        return tuple(map(_as_float32, value))
    return np.asarray(value, np.float32) if isinstance(value, float | np.ndarray) else value


@dataclass(frozen=True, eq=False)
class _Seen:
    """Planes of a scene, and the surroundings and form of their blur."""

    way: spectral.Fused
    around: border.Surroundings | None = None
    folded: bool = False
    tell_front: Callable[[], tuple[Candidate, ...]] = tuple
    remedy: str = ""


def _plain(question, blurred, fixed, notes):
    """Return the planes without blur. blurred: the question before a blur was left out, if one was."""
    notes.bounds |= fixed
    way = spectral.planes_without_blur(question, notes, not blurred.is_blurred)
    if blurred.is_blurred:
        bound = notes.bounds.get("blur left out", Bound())  # of a dark scene it is none
        watch = spectral.watch_of_no_blur(blurred, bound)
        watch = replace(watch, limit=max(blurred.limit, HEADROOM * bound.rms))
        way = replace(way, choices=(*way.choices, watch))
    by = max(notes.bounds, key=lambda name: notes.bounds[name].rms)
    return _Seen(way, remedy=REMEDIES.get(by, "a larger tolerance would be met"))


def _seen(question, picture, probes, operation, by_depth, fixed, notes):
    """Return the best way to blur. fixed: errors that all ways have."""
    tolerance = question.tolerance
    fixed |= notes.bounds | blur.bounds_of(by_depth, probes)
    arounds = border.surroundings(question, picture, by_depth, operation.level)
    found = options(
        question,
        spectral.ways(question, probes, by_depth),
        arounds,
        fixed,
        lambda around: blur.form_of(question, around, by_depth)[1],
    )
    option, needed = choose_option(found, tolerance), remedy(question, found, arounds, fixed)
    form, folded = blur.form_of(question, option.around, by_depth)
    notes.bounds |= {name: bound for name, bound in option.bounds.items() if bound != Bound()}
    limit = np.inf
    if (
        tolerance is not None
    ):  # the part of the tolerance that the other errors leave to the planes of later scenes
        rest = total(bound for name, bound in option.bounds.items() if name != "planes").rms
        # a tolerance that this scene misses may be missed as much by later ones
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

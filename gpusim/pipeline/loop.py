"""A scene in front of a camera. The result of each step is kept until something before it changes."""

import dataclasses
import time
from collections.abc import Callable
from functools import partial
from itertools import chain
from math import prod
from numbers import Real
from operator import is_
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from gpusim.backends import Device
from gpusim.color.rendering import Rendering
from gpusim.domain.account import Account
from gpusim.domain.camera import Camera
from gpusim.domain.content import Content, Picture
from gpusim.domain.ending import finish_before_end
from gpusim.domain.errors import BadData, OutOfRange, check_known, format_value
from gpusim.domain.exposure import checked_gain, checked_time
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.short_repr import shorten_repr
from gpusim.optics.fusion import Watch
from gpusim.optics.highlights import Highlights
from gpusim.optics.lenses import lens_of
from gpusim.pipeline.cache import Cache, same
from gpusim.pipeline.developer import rendering_name
from gpusim.pipeline.diodes import divided
from gpusim.pipeline.exposure import (
    Exposure,
    expose_values,
    exposure_steps,
    make_frame,
    operated_camera,
    output_of,
    picture_steps,
)
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.light import store_content
from gpusim.pipeline.metering import choose_exposure, metering_numbers
from gpusim.pipeline.planning import (
    check_given,
    draft_key,
    is_planned,
    plan_inputs,
    predict_errors,
    probe_plan,
    require_memory,
)
from gpusim.pipeline.probing import Probing
from gpusim.pipeline.reading import WHOLE, Reading, is_read_on_device
from gpusim.pipeline.repeat import MOST_PATIENCE, PATIENCE, NotRepeatable, Repeat
from gpusim.pipeline.step import Rate, Step, Values
from gpusim.planner.choices import Sketch
from gpusim.planner.draft import draft_plan, same_pixels, sketch_plan
from gpusim.planner.facts import Facts
from gpusim.planner.given import holds
from gpusim.planner.plan import Plan

if TYPE_CHECKING:
    from gpusim.pipeline.simulator import Simulator

# results by name, from the optical image to display codes
OUTPUTS = {
    "irradiance": "optical image at each wavelength of the scene, averaged over pixel apertures (L, rows, cols) "
    "[photon s-1 m-2 nm-1]",
    "electrons": "mean electrons of each pixel in each channel, as if it had all filters (C, rows, cols) [e-]",
    "mean": "mean electrons of each pixel (rows, cols), or of stacked pixels (C, rows, cols) [e-]",
    "chip_mean": "mean electrons with this chip's fixed pattern, after charge binning [e-]",
    "raw": "digital numbers (rows, cols), layers of stacked pixels below each other [DN]",
    "camera": "demosaicked camera values (C, rows, cols), white level 1",
    "linear": "linear display RGB before clipping and tone curve (3, rows, cols), display white 1",
    "xyz": "CIE XYZ of the linear display RGB (3, rows, cols), Y of display white 1",
    "codes": "display codes (rows, cols, 3)",
}
BEFORE_NOISE = ("irradiance", "electrons", "mean", "chip_mean")
SAME: Any = object()  # an argument of `Loop.update` that was not given


def checked_output(name: str) -> str:
    """Return the name of an output. Raises UnknownName."""
    check_known("output", name, OUTPUTS)
    return name


@runtime_checkable
class Capture(Protocol):
    """The frames that a camera takes of a scene, see `gpusim.captures.capture.Capture`."""

    @property
    def count(self) -> int:
        """Number of frames."""

    @property
    def has_frames(self) -> bool:
        """True if its outputs have an axis of frames."""

    def output(self, loop: "Loop", name: str, *, seed: int, first: int) -> tuple[Any, Plan]:
        """Return one of OUTPUTS of a capture of the loop's scene, and the plan that made it."""


def checked_capture(capture: Any) -> Capture | None:
    """Return a capture or None. Raises BadData."""
    if capture is not None and not isinstance(capture, Capture):
        raise BadData(f"capture: {type(capture).__name__}, wanted a Capture, e.g. gpusim.Burst(8)")
    return capture


@dataclasses.dataclass(frozen=True, eq=False)
class _Check:
    """Statistics of a scene, on their way from the device to the host.

    light, survey: functions that wait for the numbers of `sensor.meter` and `spectral.survey`, or None. pixels:
    number of metered pixels. seconds: exposure time [s]. is_metered: whether the light sets the next exposure.
    """

    scene: Scene
    plan: Plan
    light: Any
    survey: Any
    pixels: int
    seconds: float
    is_metered: bool


@dataclasses.dataclass(frozen=True, eq=False)
class _Begun:
    """An output of a scene whose commands were started before the plan is known to fit.

    check: of the scene, or None. numbers: of the frame; None: it is not drawn.
    """

    scene: Scene
    check: _Check | None
    numbers: dict[str, int] | None


@dataclasses.dataclass
class Planned:
    """A plan with its camera, or None, and its probes.

    facts: Facts of the plan's scene, once they were kept.
    """

    plan: tuple | None = None
    probing: Probing = dataclasses.field(default_factory=Probing)
    facts: Facts | None = None


class SharedOptics:
    """A plan and the optical results that several loops share.

    Args:
        device: Device of the loops.
        other: Shared by loops on another device of the same kind, which then have the same plan.
    """

    def __init__(self, device: Device, other: "SharedOptics | None" = None):
        self.cache = Cache(device)
        self.planned: Planned = Planned() if other is None else other.planned
        self.checked: tuple = ()  # the last check: a plan, and the versions of the arrays

    @property
    def plan(self) -> tuple | None:
        """A Plan and its camera."""
        return self.planned.plan

    @plan.setter
    def plan(self, plan: tuple | None):
        self.planned.plan = plan

    @property
    def probing(self) -> Probing:
        """Probes of the plan."""
        return self.planned.probing

    @probing.setter
    def probing(self, probing: Probing):
        self.planned.probing = probing


class Loop:
    """Frames of one scene by a Simulator, for previews and loops that change one thing at a time.

    A step runs again only if something before it has changed. Another tone curve encodes the frame again, another read
    noise draws and develops it again, another f-number blurs it again. A repeated step writes to the arrays of its
    last run. Results are device arrays: read them before the next call, and do not write to them. A scene is unchanged
    while it is the same object, so pass a new Scene after writing to its arrays. Use a loop in one thread at a time.

    The device measures each scene that the plan was not made for, and the host reads these numbers before the next
    frame. If the plan does not fit, a new one is made. NaN or infinite light raises BadData. Some scenes are also
    probed before their own frame, see `gpusim.pipeline.probing`.

    Args:
        simulator: The Simulator.
        scene: The scene.
        exposure_time: Exposure time [s]; None uses the camera's, see `Simulator.expose`.
        gain: Analog gain, next to the sensor's [1].
        meters_late: Expose each frame as metered in the frame before, like a video camera. Then nothing waits for the
            device. The first frame, and one after a frame with a given exposure time, is metered itself.
        before: Plan and optical results shared with other loops. Their simulators have the same tolerance, and
            their cameras need the same plan. Sharing loops may make outputs, but no frames.
        plan: Plan for every frame, instead of one for the scene. It is never replaced. Its errors are predicted for
            each scene when they are needed.
        capture: Capture that `output` takes, instead of one frame of the scene at rest. The frames of its outputs are
            on a first axis if it has several.

    Raises:
        BadData: The plan is for another kind of scene or camera.
        DoesNotFit: The plan needs more memory than the device has.
        OutOfRange: An exposure time or gain is not allowed.
    """

    def __init__(
        self,
        simulator: "Simulator",
        scene: Scene,
        exposure_time: float | None = None,
        gain: float = 1.0,
        meters_late: bool = False,
        before: SharedOptics | None = None,
        plan: Plan | None = None,
        capture: Capture | None = None,
    ):
        self.capture, self._plan_of_capture = checked_capture(capture), plan
        self.simulator, self.scene, self.meters_late = simulator, checked_scene(scene), meters_late
        self._exposure_time, self._gain = checked_time(exposure_time), checked_gain(gain)
        self._brightness = 1.0
        self.before = SharedOptics(simulator.device) if before is None else before
        self.cache = self.before.cache if before is None else Cache(simulator.device)
        self.values = Values(
            {
                Rate.CAMERA: simulator.tables,
                Rate.SCENE: self.before.cache,
                Rate.EXPOSURE: self.cache,
                Rate.FRAME: self.cache,
            }
        )
        self._steps: dict[str, list[Step]] = {}  # lists of steps by name
        self._made_of: dict[str, tuple] = {}  # the arguments from which they were made
        self._pending: _Check | None = None
        self._metered: Callable | None = None  # gives exposure time [s] and gain metered last
        # exposure time [s] and gain of this frame if metered late; kept until the next update
        self._frame_exposure: tuple[float, float] | None = None
        self._drift: float | None = None  # of the plan, in the last scene that was checked
        self._last: tuple | None = None  # an exposure, with its plan, scene and settings
        self._drafts = False
        self._repeat: Repeat | None = None  # commands of the last output
        self._repeat_of: tuple = ()  # settings that they are for
        self._repeated: Scene | None = None  # the scene whose light their arrays hold
        self._begun: _Begun | None = None  # the output that they have started
        self._drawn: dict[str, int] | None = None  # numbers of the frame in their last array
        self._checked: Content | None = None  # the content that was measured last
        self._outputs = 0  # outputs in a row with the same settings
        self._noted: tuple = (None,)  # these
        self._patience = PATIENCE
        self._served: tuple = (None,) * 6  # a plan that is usable, and for which settings
        self._drafted: tuple = (None,) * 5  # a plan, its camera, scene and camera, and their draft
        self._diodes: list[Loop] = []  # of each side's light, if it was asked for
        self._fixed_plan = plan
        if plan is not None:
            check_given(plan, simulator.camera, scene)
            require_memory(plan, simulator)

    def __repr__(self):
        return shorten_repr(
            f"Loop({self.scene.name} by {self.simulator.camera!r}, {self.simulator.device!r})"
        )

    def update(
        self,
        *,
        camera: Camera = SAME,
        scene: Scene = SAME,
        exposure_time: float | None = SAME,
        gain: float = SAME,
        brightness: float = SAME,
        drafts: bool = False,
    ) -> "Loop":
        """Change the camera, the scene or the exposure. Arguments that are left out stay as they are.

        After an error nothing has changed.

        Args:
            camera: The new camera.
            scene: The new scene.
            exposure_time: Exposure time [s]; None uses the camera's.
            gain: Analog gain, next to the sensor's [1].
            brightness: Factor on the scene's light [1]. Only what follows the blur runs again. The exposure's errors
                are predicted for the brighter light; `plan.scene` is the scene without the factor.
            drafts: While a lens slider, the pixel pitch or the fill factor moves, reuse the last plan: with new
                transfer tables, or if that is not possible as a sketch, with one kernel per channel, see
                `gpusim.planner.draft`. Then `plan.is_draft` is True and errors are not predicted. An update without
                drafts plans again.

        Returns:
            This loop.

        Raises:
            BadData: No camera or scene, or the given plan does not serve it.
            OutOfRange: An exposure time, gain or brightness is not allowed.
        """
        simulator = self.simulator if camera is SAME else self.simulator.update(camera)
        seconds = self._exposure_time if exposure_time is SAME else checked_time(exposure_time)
        scene = self.scene if scene is SAME else checked_scene(scene)
        if self._fixed_plan is not None:
            check_given(self._fixed_plan, simulator.camera, scene)
        factor = self._brightness if brightness is SAME else checked_brightness(brightness)
        self._gain = self._gain if gain is SAME else checked_gain(gain)
        if factor != self._brightness:
            self._brightness = factor
            if seconds is None and self._fixed_plan is None:
                self.before.plan = None  # it is for another operation of the camera
        self.scene, self._frame_exposure = scene, None
        self.simulator, self._exposure_time, self._drafts = simulator, seconds, drafts
        return self

    @property
    def plan(self) -> Plan:
        """The plan: the models of the frame, with their predicted errors.

        Another kind of scene, or a camera that needs another plan, gets a new one. Other scenes of the same kind use
        the existing plan, see `Plan.serves`.

        Raises:
            BadData: The scene and the camera do not go together.
            DoesNotFit: A frame needs more memory than the device has.
            OutOfRange: A number is outside its allowed range.
        """
        simulator, scene, before = self.simulator, self.scene, self.before
        camera, seconds, probing = simulator.camera, self._exposure_time, before.probing
        if self._fixed_plan is not None:
            if simulator.strict:
                self._predict_given()
            before.plan = self._fixed_plan, camera
            return self._fixed_plan
        if self._drafts and (draft := self._draft()) is not None:
            return draft
        plan = self._usable_plan()
        if plan is None:
            if self._needs_other_plan():
                probing.forget()
            facts = self._facts()
            least, words = probing.least(scene), probing.words
            asked = seconds, least, self._brightness, words
            plan = before.cache("plan", _plan, simulator, scene, facts, *asked)
            probing.set_plan(plan)
        before.plan = plan, camera
        return (self._drafts and self._draft()) or plan

    def _needs_other_plan(self):
        """Return True if the existing plan is for a camera whose plans differ."""
        _, by = self.before.plan or (None, None)
        camera, tolerance = self.simulator.camera, self.simulator.tolerance
        return by is not None and not (
            by is camera or same(plan_inputs(by, tolerance), plan_inputs(camera, tolerance))
        )

    def _usable_plan(self):
        """Return the existing plan if it serves this scene and camera, else None."""
        plan, by = self.before.plan or (None, None)
        if plan is None:
            return None
        scene, seconds, factor = self.scene, self._exposure_time, self._brightness
        settings = plan, by, self.simulator.camera, seconds, factor
        served, *known = self._served
        is_known = plan is known[0] and scene is served
        if not (is_known or plan.scene is scene or plan.serves(scene)):
            return None
        if not all(map(is_, settings, known)) and (
            self._needs_other_plan() or not plan.lasts(seconds and seconds * factor)
        ):
            return None
        self._served = scene, *settings
        return plan

    def keep_plan(self) -> Planned:
        """Return the plan and its probes, for a loop that comes later.

        Returns:
            The plan, its probes, and the facts that `reuse` compares.
        """
        kept, plan = self.before.planned, self.plan
        if plan.scene is self.scene:
            kept.facts = self._facts()
        kept.probing.end_scene()
        return kept

    def reuse(self, kept: Planned) -> None:
        """Use a plan that was kept, if it may serve this scene.

        The scene that it was made for must give the same facts again. Another scene is measured and probed like
        the scenes of a loop. Without a tolerance there are no probes, so it gets another plan.

        Args:
            kept: The plan, for a camera and a tolerance like this loop's.
        """
        simulator, scene = self.simulator, self.scene
        plan, _ = kept.plan or (None, None)
        if plan is None or kept.facts is None:
            return
        if (
            simulator.tolerance is not None
            if plan.scene is not scene
            else is_planned(simulator, plan, kept.facts, scene)
        ):
            self.before.planned = kept

    def _draft(self):
        """Return a draft made from the existing plan; None if it is unsuitable or saves no work."""
        camera, (plan, by) = self.simulator.camera, self.before.plan or (None, None)
        now = plan, by, self.scene, camera
        if all(map(is_, now, self._drafted)):
            return self._drafted[-1]
        if (
            plan is None
            or plan.scene is not self.scene
            or not same(draft_key(by), draft_key(camera))
            or (
                (plan.find(Sketch) is not None or lens_of(camera).symmetry.is_round)
                and same(by.optics, camera.optics)
                and same_pixels(by, camera)
            )
        ):
            draft = None
        else:
            draft = self.before.cache("draft", draft_plan, plan, camera)
            if draft is None and self.simulator.device.kind != "numpy":  # which has no spectra
                draft = self.before.cache("sketch", sketch_plan, plan, camera)
        self._drafted = *now, draft
        return draft

    def _plan_still_valid(self):
        """Return False and drop the plan if it does not fit.

        That is decided from the statistics of the last scene and, for some scenes, from exact values of this one.
        """
        self.judge()
        if self._fixed_plan is not None:
            return True
        simulator, scene, probing = self.simulator, self.scene, self.before.probing
        if self.before.plan is None or not probing.is_due(plan := self.plan, scene):
            return self.before.plan is not None
        seconds = (
            simulator.camera.sensor.exposure_time
            if self._exposure_time is None
            else self._exposure_time
        )
        if seconds is None and self.meters_late and self._metered:
            seconds, _ = self._metered()
        account = self._probe(plan, seconds)
        does = holds(plan, account)
        probing.found(scene, account, does)
        if not does:
            self.before.plan = None
        return does

    def _probe(self, plan, seconds):
        """Return the account of the plan in this scene, whose blur was launched.

        seconds: exposure time [s]; None: the camera's choice.
        """
        simulator, content, cache = self.simulator, self.scene.content, self.before.cache
        # the device has decoded them
        stored = self.values["entries"] if isinstance(content, Picture) else None
        # the same for all views of a scene
        facts = cache("facts of probes", facts_on_device, content, stored, simulator.device)
        asked = simulator, plan, self.scene, seconds, facts, self._brightness
        return cache("probes", probe_plan, *asked)

    def _facts(self):
        """Return facts of the scene. If the device computes them, the host reads only a few numbers."""
        device, scene = self.simulator.device, self.scene
        if not is_read_on_device(device, scene):
            return self.before.cache("facts", read_facts, scene, device)
        content = scene.content
        stored = self.before.cache("entries", store_content, content, window=WHOLE, device=device)
        return self.before.cache("facts", facts_on_device, content, stored, device)

    @property
    def exposure(self) -> Exposure:
        """The exposure: mean electrons of the scene, and the values that its frames need.

        Raises:
            BadData: The scene and the camera do not go together.
            DoesNotFit: A frame needs more memory than the device has.
            OutOfRange: A number is outside its allowed range.
        """
        start = time.perf_counter()
        with self.simulator.device.timed() as ms:
            exposure = self.expose()
        wall = 1e3 * (time.perf_counter() - start)
        return dataclasses.replace(exposure, ms=dict(ms), wall_ms=wall)

    @property
    def _sets_next(self) -> bool:
        """Whether the light of the scene sets the exposure of the next one."""
        seconds = self._exposure_time, self.simulator.camera.sensor.exposure_time
        return self.meters_late and seconds == (None, None)

    @property
    def _light(self) -> str:
        """Name of the value with the statistics of the scene's light."""
        return "metered light" if self._sets_next else "light"

    def _use(self, name, make, *args):
        """Replace the list of steps of this name by `make(*args)` if an argument is another object."""
        if name not in self._steps or not all(map(is_, self._made_of[name], args)):
            self._steps[name], self._made_of[name] = make(*args), args
            self.values.use(chain(*self._steps.values()))

    @finish_before_end
    def expose(self) -> Exposure:
        """Return the exposure without its computing times. It does not wait for the device.

        Returns:
            The exposure, see `exposure`.
        """
        settings = self.simulator, self._exposure_time, self._gain, self._brightness
        is_metered = not self._sets_next or self._frame_exposure is not None  # for this frame
        if self._last is not None and self._pending is None and is_metered and self.before.plan:
            exposure, *made_for = self._last
            now = self.before.plan[0], self.scene, *settings
            if all(map(is_, made_for, now)):
                return exposure
        self._last = None  # from here on its arrays are rewritten
        simulator, scene, values = self.simulator, self.scene, self.values
        if (again := self._expose_again()) is not None:
            self._last = again, again.plan, scene, *settings
            return again
        while True:
            plan = self.plan
            self._start(plan)
            # last, so the device has work while the host waits
            if self._plan_still_valid():
                break
        seconds, gain = self._choose_exposure()
        camera = self.cache("operated", operated_camera, simulator.camera, simulator.readout, gain)
        self._use("pictures", picture_steps, simulator, camera)
        operation = seconds, gain, True, self._brightness
        exposure = expose_values(values, simulator, plan, camera, *operation)
        if plan.scene is not scene or self._sets_next:
            self._start_check(plan, exposure.mean, seconds)
        self._last = exposure, plan, scene, *settings
        return exposure

    def _start(self, plan):
        """Launch the blur of the scene."""
        self._use("exposure", exposure_steps, self.simulator, plan)
        self.values.give(content=blurred_content(plan, self.scene), view=self.scene.view)
        self.values["rates"]

    @finish_before_end
    def begin(self, *, seed: int = 0, first: int = 0) -> None:
        """Start the next output before the plan is known to fit the scene, so that the device has work meanwhile.

        `output` returns it if the plan fits, and makes it again otherwise. If the commands of the last output serve
        the scene, all are started; else only the blur is, if there is a plan.

        Args:
            seed: Seed of the noise.
            first: Number of the frame.
        """
        plan = self._usable_plan() if self.capture is None else None
        if plan is None or (self._last and self._last[1:3] == (plan, self.scene)):
            return
        self._last = self._repeated = self._begun = None  # its arrays are rewritten
        repeat = self._usable_repeat()
        if repeat is not None and self._begin_again(repeat, plan):
            self._begun = self._continue(repeat, plan, {"seed": seed, "frame": first})
        else:
            self._start(plan)
        self.simulator.device.flush()

    def follow(self, other: "Loop") -> None:
        """Continue after a frame of another loop with the same plan, as if this loop had made that frame.

        Args:
            other: Loop on another device of the same kind.
        """
        self._pending, other._pending = other._pending, None
        self._metered, self._drift = other._metered, other._drift
        for loop in (self, other):  # scenes between those of a loop are measured by others
            loop.before.checked, loop._checked = (), None

    def _choose_exposure(self):
        """Return exposure time [s] and analog gain: given, the camera's, or metered from electrons per second."""
        simulator, seconds = self.simulator, self._exposure_time
        seconds = simulator.camera.sensor.exposure_time if seconds is None else seconds
        if seconds is not None:
            self._metered = None
            return float(seconds), float(self._gain)
        if self._frame_exposure is not None:
            # also for a repeated frame: its own light sets the next one
            return self._frame_exposure
        if self.meters_late and self._metered:
            found = self._metered()
        else:
            self.values.set_numbers(brightness=self._brightness)
            found = self.values["metered"]
            self._metered = partial(tuple, found)
        self._frame_exposure = found if self.meters_late else None
        return found

    def _start_check(self, plan, mean, seconds):
        """Start the statistics of a scene that the plan was not made for; they are read before the next frame."""
        values = self.values
        entries = self.before.cache.with_versions(values["entries"])
        checked = entries, self.before.cache.with_versions(mean) if self._sets_next else None
        if self.before.checked[:1] == (plan,) and same(self.before.checked[1], checked):
            return
        self.before.checked = plan, checked
        light = self._light
        names = [light, "survey"] if plan.find(Watch) else [light]
        self._pending = self._fetch_check(plan, {name: values[name] for name in names}, seconds)

    def _fetch_check(self, plan, measured, seconds) -> _Check:
        """Begin to fetch the statistics "light" and "survey" of the scene."""
        device, found = self.simulator.device, None
        light = device.fetch(measured[self._light])
        if plan.find(Watch) and plan.scene is not self.scene and self._fixed_plan is None:
            found = device.fetch(measured["survey"])
        sensor = self.simulator.camera.sensor
        pixels = prod(plan.scene.shape) * (len(sensor.channels) if sensor.stacked else 1)
        return _Check(self.scene, plan, light, found, pixels, seconds, self._sets_next)

    def judge(self) -> None:
        """Wait for the statistics of the last scene, and drop the plan if it does not fit.

        Every frame does this for the one before.

        Raises:
            BadData: The scene has light that is not finite.
        """
        check, self._pending = self._pending, None
        if check is None:
            return
        light = check.light()
        if light[4]:
            # so the next frame of this scene raises again
            self.before.checked, self._checked, self._last = (), None, None
            raise BadData(
                f"{check.scene.name}: {light[4]:.0f} of {check.pixels} pixels have NaN or infinite light"
            )
        if check.is_metered and light[0] > 0:
            sensor, readout = self.simulator.camera.sensor, self.simulator.readout
            asked = light, check.pixels, check.seconds
            # called if the next exposure is automatic
            self._metered = partial(choose_exposure, *asked, **metering_numbers(sensor, readout))
        if check.plan.scene is check.scene or self._fixed_plan is not None:
            return
        plan, scene, probing, self._drift = check.plan, check.scene, self.before.probing, None
        watch: Any = plan.find(Watch)  # not None if there is a survey
        if check.survey is not None:
            found = check.survey()
            surveyed = watch.errors(found)
            self._drift = surveyed.drift
            probing.add_survey(plan, scene, surveyed)
        if not plan.fits(light, self._drift):
            self.before.plan = None
            if plan.fits(light, None):
                probing.note_misfit(
                    plan,
                    scene,
                    watch.count_missing_planes(found),
                    scene is self.scene,
                )

    @finish_before_end
    def output(self, name: str, *, seed: int = 0, first: int = 0) -> Any:
        """Return one of OUTPUTS by its name. Only this output and the exposure are computed.

        Args:
            name: A key of `OUTPUTS`.
            seed: Seed of the noise, for "raw" and later outputs.
            first: Number of the frame, for "raw" and later outputs.

        Returns:
            A device array, shape and unit as in OUTPUTS.

        Raises:
            UnknownName: There is no such output.
            BadData: Irradiance of a blur that varies over the field.
        """
        checked_output(name)
        if self.capture is not None:
            found, self._plan_of_capture = self.capture.output(self, name, seed=seed, first=first)
            return found
        exposure, values, repeat = self.expose(), self.values, self._repeat
        drawn, self._drawn = self._drawn, None
        if (
            repeat is not None
            and repeat.output == name
            and self._repeated is self.scene
            and repeat.is_alone
        ):
            numbers = {"seed": seed, "frame": first}
            if drawn != numbers:
                repeat.draw(self.simulator.device, numbers)
            return repeat.result
        if name == "irradiance":
            self._use("irradiance", self.simulator.imaging.irradiance_steps, exposure.plan)
        found = values[name] if name in BEFORE_NOISE else output_of(values, name, seed, first)
        self._note_output(name, exposure)
        return found

    def _usable_repeat(self):
        """Return the commands of the last output if they serve the present settings, else None."""
        repeat = self._repeat
        is_usable = (
            repeat is not None
            and repeat.is_current
            and all(map(is_, self._repeat_of, self._settings_of_repeat()))
            and self._usable_plan() is not None
        )
        return repeat if is_usable else None

    def _settings_of_repeat(self):
        """Return the objects that an output depends on, except the scene and the numbers of the frame."""
        plan = self.before.plan
        settings = self._exposure_time, self._gain, self._brightness
        return self.simulator, *settings, plan and plan[0]

    def _expose_again(self):
        """Return the exposure, made by the commands of the last output; None if they do not serve the scene."""
        repeat, scene, begun = self._usable_repeat(), self.scene, self._begun
        is_done, self._repeated = scene is self._repeated, None
        self._begun = self._drawn = None
        if repeat is None:
            return None
        plan, _ = self.before.plan or (None, None)
        is_begun = begun is not None and begun.scene is scene
        if not (
            (is_done or is_begun or self._begin_again(repeat, plan))
            and self._plan_still_valid()
            and repeat.is_alone
        ):
            return None
        if not is_done:
            begun = begun if is_begun else self._continue(repeat, plan)
            self._drawn = begun.numbers
            if begun.check is not None:
                self.before.checked, self._checked = (), scene.content
                self._pending = begun.check
        self._repeated = scene
        return repeat.exposure

    def _continue(self, repeat, plan, numbers=None) -> _Begun:
        """Start what follows the blur of the scene: its exposure, and the frame with these numbers."""
        device, check = self.simulator.device, None
        repeat.expose(device)
        if self._needs_check(plan):
            check = self._fetch_check(plan, repeat.results, repeat.exposure.exposure_time)
        if numbers is not None:
            repeat.draw(device, numbers)
        return _Begun(self.scene, check, numbers)

    def _begin_again(self, repeat, plan) -> bool:
        """Start the blur of the scene with the commands of the last output; False if they cannot serve it."""
        scene, results = self.scene, repeat.results
        is_measured = self._light in results and ("survey" in results or not plan.find(Watch))
        if not (is_measured or not self._needs_check(plan)):
            return False
        if plan.find(Highlights) is not None or scene.layers:
            return False
        given = {"content": scene.content, "view": scene.view}
        self.values.give(**given)
        return repeat.begin(self.simulator.device, given)

    def _needs_check(self, plan):
        """Return True if the statistics of the scene are needed: views of one content have the same survey."""
        is_new = plan.scene is not self.scene and self.scene.content is not self._checked
        return is_new or self._sets_next

    def _note_output(self, name, exposure):
        """Collect the commands of an output after several in a row with the same settings."""
        seconds, values = self._exposure_time, self.values
        if seconds is None:
            seconds = self.simulator.camera.sensor.exposure_time
        if (
            seconds is None
            or name == "irradiance"
            or self._drafts
            or self.simulator.strict
            or self.simulator.device.kind == "numpy"
        ):
            return
        now = name, *self._settings_of_repeat()
        self._outputs = self._outputs + 1 if all(map(is_, now, self._noted)) else 1
        self._noted = now
        if self._outputs < self._patience:
            return
        self._outputs, self._patience = 0, min(2 * self._patience, MOST_PATIENCE)
        measured = [other for other in (self._light, "survey") if values.known(other) is not None]
        last = "codes at once" if name == "codes" and "codes at once" in values else name
        exposed = ["mean", "chip_mean", *measured]
        try:
            self._repeat = Repeat(values, "rates", exposed, last, name, exposure)
        except NotRepeatable:
            return
        self._repeat_of, self._repeated = now[1:], self.scene
        self._checked = self.scene.content

    def raw(self, *, seed: int = 0, first: int = 0) -> Any:
        """Return the raw values of one frame.

        Args:
            seed: Seed of the noise.
            first: Number of the frame.

        Returns:
            A device array (rows, cols) [DN].
        """
        return self.output("raw", seed=seed, first=first)

    @property
    def diodes(self) -> Any:
        """Mean electrons of photodiodes of dual or quad pixels, see `Exposure.diodes`; the next use rewrites them."""
        divided(self.simulator.camera)
        made, exposure = self.simulator.diodes_of(self.scene.shape), self.expose()
        operation = exposure.exposure_time, exposure.gain
        if len(self._diodes) != len(made.simulators):
            self._diodes = [one.loop(self.scene, *operation) for one in made.simulators]
        parts = []
        for loop, one in zip(self._diodes, made.simulators, strict=True):
            camera = one.camera if loop.simulator.camera is not one.camera else SAME
            loop.update(
                camera=camera,
                scene=self.scene,
                exposure_time=operation[0],
                gain=operation[1],
                brightness=self._brightness,
            )
            parts.append(loop.output("mean"))
        return made.divide(
            exposure.mean, parts, [loop.plan for loop in self._diodes], self.simulator.device
        )

    def raw_dual(self, *, seed: int = 0, first: int = 0) -> Any:
        """Return raw values of the photodiodes of dual or quad pixels, see `Exposure.raw_dual`.

        Args:
            seed: Seed of the noise.
            first: Number of the frame.

        Returns:
            A device array (n, rows, cols) [DN].
        """
        simulator, means, exposure = self.simulator, self.diodes, self.expose()
        made, operation = (
            simulator.diodes_of(self.scene.shape),
            (exposure.exposure_time, exposure.gain),
        )
        return made.draw(simulator, means, *operation, seed, first)

    def codes(self, *, seed: int = 0, first: int = 0) -> Any:
        """Return the display codes of one frame.

        Args:
            seed: Seed of the noise.
            first: Number of the frame.

        Returns:
            A device array (rows, cols, 3), uint8.
        """
        return self.output("codes", seed=seed, first=first)

    def linear(self, *, seed: int = 0, first: int = 0) -> tuple[Any, Rendering]:
        """Return linear light of one frame.

        Args:
            seed: Seed of the noise.
            first: Number of the frame.

        Returns:
            Linear display RGB before clipping and tone curve, a device array (3, rows, cols), and its rendering.
        """
        shown = self.output("linear", seed=seed, first=first)
        return shown, self.values[rendering_name(self.simulator.camera)]

    def restart(self, plan: Plan, camera: Camera) -> None:
        """Forget the light of earlier scenes, and begin with a plan for another scene.

        The plan is replaced as soon as a scene shows that it does not fit. Cached results are kept.

        Args:
            plan: The plan.
            camera: The camera that it was made for.
        """
        self._pending = self._last = self._metered = self._frame_exposure = self._drift = None
        self.before.checked, self._checked, self.before.probing = (), None, Probing()
        self.before.plan = plan, camera
        self.before.probing.set_plan(plan)

    def settle(self) -> None:
        """Wait until the plan is known to fit this scene, or drop it; the next output has one that fits."""
        self.expose()
        self._plan_still_valid()

    def frame(self, *, seed: int = 0, first: int = 0) -> Frame:
        """Return one picture with its report, made with a plan that fits the scene.

        Args:
            seed: Seed of the noise.
            first: Number of the frame.

        Returns:
            The picture.
        """
        self._outputs = 0  # its parts are values by name
        return make_frame(self.judged_exposure, self.values, seed, first)

    @property
    def judged_exposure(self) -> Exposure:
        """The exposure by a plan that is known to fit the scene, with the errors predicted for it. Waits."""
        start = time.perf_counter()
        exposure = self.exposure
        if not self._plan_still_valid():
            exposure = self.exposure
        plan, wall = self._annotate(exposure), 1e3 * (time.perf_counter() - start)
        return dataclasses.replace(exposure, plan=plan, wall_ms=wall)

    @property
    def settings(self) -> tuple[float | None, float, Plan | None]:
        """Exposure time [s] or None, gain, and the given plan or None."""
        return self._exposure_time, self._gain, self._fixed_plan

    @property
    def plan_of_output(self) -> Plan | None:
        """The plan of the last output; of a capture None before the first one."""
        return self.plan if self.capture is None else self._plan_of_capture

    @property
    def account(self) -> Account:
        """Predicted errors of the scene's exposure, from the measurements made so far."""
        exposure = self.expose()
        light_time = exposure.exposure_time * exposure.brightness
        return self._annotate(exposure).account.at(light_time)

    def _annotate(self, exposure):
        """Return an exposure's plan with the errors predicted for the scene."""
        plan = exposure.plan
        if self._fixed_plan is not None:
            return self._predict_given()
        if plan.scene is self.scene:
            return plan
        probing = self.before.probing
        found = probing.annotate(plan, self.scene, self._drift)
        light_time = exposure.exposure_time * exposure.brightness
        if found.meets(light_time) or not probing.is_doubted(plan, self.scene):
            return found
        # an earlier scene may have had larger errors
        account = self._probe(plan, self._exposure_time)
        own = dataclasses.replace(plan.of(self.scene, None, account), probed="from this scene")
        probing.confirm(own.meets(light_time))
        return own

    def _predict_given(self):
        """Return the given plan, with the errors predicted for the scene."""
        asked = self.scene, self._facts(), self._exposure_time, self._brightness
        return self.before.cache("given", predict_errors, self.simulator, self._fixed_plan, *asked)


def blurred_content(plan: Plan, scene: Scene) -> Content:
    """Return the content of a scene that a plan serves, without the highlights that the plan adds separately."""
    is_whole = plan.find(Highlights) is None and not scene.layers
    return scene.content if is_whole else plan.content


def _plan(simulator, scene, facts, seconds, least, brightness, words) -> Plan:
    """Return the plan of a scene. words: why it replaces another one."""
    plan = simulator.plan(scene, facts, seconds, least, brightness)
    return dataclasses.replace(plan, probed=words)


def checked_brightness(factor: float) -> float:
    """Return a factor on the light. Raises OutOfRange."""
    if not (isinstance(factor, Real) and 0 < factor < float("inf")):
        raise OutOfRange("brightness", format_value(factor), "0 < brightness < inf")
    return float(factor)


def read_facts(scene: Scene, device) -> Facts:
    """Return facts of a scene, computed on the host."""
    whole = Reading(device, scene.content).whole()
    if not scene.content.is_seen:
        return Facts.of(dataclasses.replace(scene, content=whole))  # this checks the values
    return Facts.of(scene.stored(**{name: getattr(whole, name) for name in whole.samples}))


def facts_on_device(content, stored, device) -> Facts:
    """Return facts of a content, computed on the device."""
    return Facts(content, None, Reading(device, content, stored))

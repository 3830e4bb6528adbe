"""A scene in front of a camera: what each step gives is kept until something before it changes."""

import dataclasses
import time
from functools import partial
from math import prod
from typing import Any

from gpusim.color.rendering import rendering, without_tone
from gpusim.color.shading import phase_gains, relative_response, shading_gains
from gpusim.domain.account import Account
from gpusim.domain.errors import BadData, UnknownName
from gpusim.domain.exposure import checked_gain, checked_time
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.short_repr import shortened
from gpusim.kernels.sensor.chip import retime as retime_chip
from gpusim.kernels.sensor.collect import retime as retime_collect
from gpusim.kernels.spectral.survey import survey
from gpusim.optics.lens import lens_of
from gpusim.pipeline.cache import Kept, One, same
from gpusim.pipeline.frame import Exposure, Frame
from gpusim.pipeline.metering import chosen, light_of, metered, metered_by
from gpusim.pipeline.outputs import OUTPUTS, output_of
from gpusim.pipeline.planning import (
    check_given,
    drafted_by,
    judged_by,
    planned_by,
    probed_by,
    require_memory,
)
from gpusim.pipeline.probing import Probing
from gpusim.pipeline.reading import WHOLE, Reading, looked_at_there
from gpusim.pipeline.shots import Shots
from gpusim.planner.after import holds
from gpusim.planner.draft import drafted
from gpusim.planner.facts import Facts
from gpusim.planner.plan import Plan

SAME = object()  # of `Program.update`: as it was


@dataclasses.dataclass(eq=False, slots=True)
class _Result:
    """An exposure, and what it was made of.

    settings: of the program. stored: the scene's samples on the device, samples: these as parts of keys. planes: before
    the blur. rates: electrons per second, with their mosaic.
    """

    settings: tuple
    plan: Plan
    scene: Scene
    stored: tuple
    samples: list
    planes: Any
    rates: tuple
    exposure: Exposure | None


@dataclasses.dataclass(frozen=True, eq=False)
class _Look:
    """What the device saw of a scene by a plan, on its way to the host.

    light, survey: functions that wait for the numbers of `sensor.meter` and `spectral.survey`, or None. shape: of the
    electrons that were metered, of an exposure of so many seconds [s].
    """

    scene: Scene
    plan: Plan
    light: Any
    survey: Any
    shape: tuple
    seconds: float


class Before:
    """What programs have in common before their exposures: a plan, and what its steps gave."""

    def __init__(self, device):
        self.kept = Kept(device)
        self.plan: tuple | None = None  # a Plan, and a camera that it is for
        self.probing = Probing()
        self.looked: tuple = ()  # what was last looked at


class Program:
    """Frames of one scene by a Simulator, for previews and loops in which one thing changes at a time.

    exposure_time, gain: as for `Simulator.expose`. A step runs where something before it has changed: another tone
    curve encodes anew, another read noise is drawn and processed, another f-number blurs. What runs again writes to the
    arrays of the run before. Arrays that the program gives are the device's: read them before the program goes on, do
    not write them. Scenes count as unchanged while they are the same object: give a new Scene where its arrays have
    been written to. A program is used by one thread at a time.
    A scene that the plan was not made for is looked at on the device. What is found there is read before the next
    frame: the plan is made anew where it does not fit, and NaN or infinite light raises BadData. Now and then it is
    probed before its own frame: see `gpusim.pipeline.probing`.
    meters_late: expose by what was metered in the frame before, as a camera's video does; then nothing waits for the
    device. before: of other programs of one simulator's tolerance that are used in turn with this one, for outputs and
    not for frames; their cameras are planned alike. kept: what its own steps gave.
    plan: makes every frame, in place of one for the scene; it is never made anew, and what it errs in each scene is
    predicted for that scene when it is asked for. Raises BadData for a plan of another kind of scene or camera.
    """

    def __init__(
        self,
        simulator,
        scene: Scene,
        exposure_time: float | None = None,
        gain: float = 1.0,
        meters_late: bool = False,
        before: Before | None = None,
        plan: Plan | None = None,
    ):
        self.simulator, self.scene, self.meters_late = simulator, checked_scene(scene), meters_late
        self._exposure_time, self._gain = checked_time(exposure_time), checked_gain(gain)
        self.before = Before(simulator.device) if before is None else before
        self.kept = self.before.kept if before is None else before.kept.beside()
        self._pending: _Look | None = None
        self._metered: tuple[float, float] | None = None
        self._operates: tuple[float, float] | None = (
            None  # what was metered for this frame, from update to update
        )
        self._drift: float | None = None  # of the plan, in the last scene that was judged
        self._last: _Result | None = None
        self._drafts = False
        self._given = plan
        if plan is not None:
            check_given(plan, simulator.camera, scene)
            require_memory(plan, simulator.device)

    def __repr__(self):
        return shortened(
            f"Program({self.scene.name} by {self.simulator.camera!r}, {self.simulator.device!r})"
        )

    def update(
        self, *, camera=SAME, scene=SAME, exposure_time=SAME, gain=SAME, drafts: bool = False
    ) -> "Program":
        """The same program with another camera, scene, exposure time [s] (None: the camera's own) or analog gain.

        drafts: while a lens is turned, use the plan for where it stood, see `gpusim.planner.draft`; `plan.is_draft`
        says so, and its errors are not predicted. An update without it plans again. Raises as Simulator does, and keeps
        what it was then.
        """
        simulator = self.simulator if camera is SAME else self.simulator.update(camera)
        seconds = self._exposure_time if exposure_time is SAME else checked_time(exposure_time)
        scene = self.scene if scene is SAME else checked_scene(scene)
        if self._given is not None:
            check_given(self._given, simulator.camera, scene)
        self._gain = self._gain if gain is SAME else checked_gain(gain)
        self.scene, self._operates = scene, None
        self.simulator, self._exposure_time, self._drafts = simulator, seconds, drafts
        return self

    @property
    def plan(self) -> Plan:
        """What is modelled, and its predicted errors. Raises BadData, DoesNotFit, OutOfRange.

        It is made anew for another kind of scene, and for a camera that asks for it. Other scenes of the same kind are
        framed by the plan that is there: see `Plan.serves`.
        """
        simulator, scene, before = self.simulator, self.scene, self.before
        camera, asked = simulator.camera, simulator.tolerance
        plan, by = before.plan or (None, None)
        seconds, probing = self._exposure_time, before.probing
        if self._given is not None:
            if simulator.strict:
                self._judged()
            before.plan = self._given, camera
            return self._given
        if (draft := self._draft()) is not None:
            return draft
        is_other = by is not None and not (
            by is camera or same(planned_by(by, asked), planned_by(camera, asked))
        )
        if (
            plan is None
            or is_other
            or not (plan.scene is scene or plan.serves(scene))
            or not plan.lasts(seconds)
        ):
            if is_other:
                probing.forget()
            facts = self._facts()
            least, words = probing.least(scene), probing.words
            plan = before.kept(
                "plan",
                (One(facts), One(simulator), seconds, least, words),
                lambda: dataclasses.replace(
                    simulator.plan(scene, facts, seconds, least), probed=words
                ),
            )
            probing.planned(plan)
        before.plan = plan, camera
        return self._draft() or plan

    def _draft(self):
        """A draft by the plan that is there; None where none is wanted, none will do, or it would save nothing."""
        camera, (plan, by) = self.simulator.camera, self.before.plan or (None, None)
        if (
            not self._drafts
            or plan is None
            or plan.scene is not self.scene
            or not same(drafted_by(by), drafted_by(camera))
        ):
            return None
        if lens_of(camera).symmetry.is_round and same(by.optics, camera.optics):
            return None
        return self.before.kept("draft", (One(plan), One(camera)), lambda: drafted(plan, camera))

    def _does(self):
        """Whether the plan does, by what the last scene told and, now and then, by exact values of this one.

        It is dropped where it does not.
        """
        self.judge()
        if self._given is not None:
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
            seconds = self._metered[0]
        account = self.before.kept(
            "probes",
            (One(scene), One(plan), seconds),
            lambda: probed_by(simulator, plan, scene, seconds),
        )
        does = holds(plan, account)
        probing.found(scene, account, does)
        if not does:
            self.before.plan = None
        return does

    def _facts(self):
        """Facts of the scene."""
        return self.before.kept("facts", One(self.scene), self._read_facts)

    def _read_facts(self):
        """The same anew: of what is looked at on the device the host reads a few numbers alone."""
        device, scene, content = self.simulator.device, self.scene, self.scene.content
        if not looked_at_there(device, scene):
            whole = Reading(device, content).whole()
            if not content.is_seen:
                return Facts.of(
                    dataclasses.replace(scene, content=whole)
                )  # which looks at the values
            return Facts.of(scene.stored(**{name: getattr(whole, name) for name in whole.samples}))
        stored = self.before.kept(
            "content", (One(content), WHOLE), lambda: self.simulator.imaging.stored(content)
        )
        return Facts(content, None, Reading(device, content, stored))

    def _content(self, plan):
        """What is in front of the camera, less what the plan has taken from it."""
        scene = self.scene
        return scene.content if plan.highlights is None and not scene.layers else plan.content

    @property
    def exposure(self) -> Exposure:
        """Mean electrons of the scene, with all that frames of it need. Raises BadData, DoesNotFit, OutOfRange."""
        start = time.perf_counter()
        with self.simulator.device.timed() as ms:
            exposure = self._exposed()
        wall = 1e3 * (time.perf_counter() - start)
        return dataclasses.replace(exposure, ms=dict(ms), wall_ms=wall, is_rewritten=True)

    def _exposed(self):
        """The exposure without its times."""
        last, settings = self._last, (self.simulator, self._exposure_time, self._gain)
        is_same = last is not None and all(
            own is its for own, its in zip(last.settings, settings, strict=True)
        )
        automatic = (
            self._exposure_time is None and self.simulator.camera.sensor.exposure_time is None
        )
        is_metered = (
            not (self.meters_late and automatic) or self._operates is not None
        )  # for this frame
        if (
            is_same
            and is_metered
            and last.scene is self.scene
            and self._pending is None
            and self.before.plan
            and (self.before.plan[0] is last.plan)
        ):
            return last.exposure
        self._last = None  # its arrays are written to from here on
        made = (
            self._again(last, is_same)
            if last and settings[0] is last.settings[0] and (self.plan is last.plan)
            else None
        )
        made = made or self._anew()
        made.settings, self._last = settings, made
        return made.exposure

    def _anew(self):
        """An exposure by a plan that fits as far as is known."""
        while True:
            plan = self.plan
            stored, samples, planes = self._planes(plan)
            rates = self._rates(plan, planes)
            if self._does():  # not sooner: the device has work while the host waits
                made = _Result((), plan, self.scene, stored, samples, planes, rates, None)
                made.exposure = self._exposed_by(made)
                return made

    def stored(self, plan) -> tuple[Any, list]:
        """The scene's samples on the device as a plan takes them, and these as parts of keys."""
        imaging, content = self.simulator.imaging, self._content(plan)
        window = imaging.window(plan)
        kept = self.before.kept
        stored = kept("content", (One(content), window), lambda: imaging.stored(content, window))
        return stored, [kept.one(part) for part in stored]

    def _planes(self, plan):
        """The same, and the planes before the blur."""
        stored, samples = self.stored(plan)
        planes = self.before.kept(
            "planes",
            (samples, plan.table),
            lambda: self.simulator.imaging.planes(plan.table, stored),
        )
        return stored, samples, self.placed(plan, planes)

    def placed(self, plan, planes, name: str = "placed") -> Any:
        """Planes where the lens and the scene's view put them. name: of what is kept."""
        if not plan.is_placed:
            return planes
        imaging, kept, view = self.simulator.imaging, self.before.kept, self.scene.view
        places = kept(
            "places",
            (view, plan.distortion, plan.scene.samples, plan.mix is None),
            lambda: imaging.places(plan, view),
        )
        lights = imaging.lights(plan)
        zoom = (
            view.zoom if plan.distortion is not None and plan.distortion.method == "area" else 1.0
        )
        return kept(
            name,
            (kept.one(planes), kept.one(places), plan.scene.border, lights, zoom),
            lambda: imaging.placed(plan, planes, places, lights, zoom),
        )

    def _rates(self, plan, planes):
        """Electrons per second, with their mosaic."""
        kept = self.before.kept
        return kept(
            "rates",
            (kept.one(planes), One(plan)),
            partial(self.simulator.imaging.rates, plan, planes),
        )

    def _again(self, last, is_same):
        """The last exposure, its arrays made anew by what ran for it; None where that is not all.

        Either the scene is as it was, and time or gain may be other; or the scene alone is other, and exposed for the
        same time. is_same: whether all but the scene is as it was.
        """
        plan = last.plan
        stored, samples, planes = self._planes(plan)
        if planes is not last.planes or self._rates(plan, planes) is not last.rates:
            return None
        is_metered = (
            self._exposure_time is None and self.simulator.camera.sensor.exposure_time is None
        )
        if last.scene is not self.scene and (not is_same or is_metered):
            return None
        if not self._does():
            return None
        if last.scene is self.scene:
            last.exposure = self._exposed_by(last)
            return last
        exposure = last.exposure
        mean = self._mean(last, exposure.exposure_time)
        if mean is not exposure.mean or (
            chip_mean(self.simulator, mean, exposure.exposure_time, self.kept)
            is not exposure.chip_mean
        ):
            return None
        last.scene, last.stored, last.samples = self.scene, stored, samples
        if plan.scene is not self.scene:
            self._look(last, mean, exposure.exposure_time)
        return last

    def _mean(self, made, seconds):
        """Mean electrons of every pixel of the scene [e-]."""
        plan, rates = made.plan, made.rates
        return self.kept(
            "mean",
            (self.kept.one(rates[0]), One(plan), seconds),
            lambda: self.simulator.imaging.exposed(plan, rates, seconds),
            lambda tape: retime_collect(tape, seconds),
        )

    def _exposed_by(self, made):
        """The exposure of electrons per second."""
        simulator, kept, plan, rates = self.simulator, self.kept, made.plan, made.rates
        of = kept.one(rates[0]), One(plan)
        seconds, gain = self._operated(
            of,
            lambda: self.before.kept(
                "per second", of, lambda: simulator.imaging.exposed(plan, rates, 1.0)
            ),
        )
        mean = self._mean(made, seconds)
        if plan.scene is not self.scene or self.meters_late:
            self._look(made, mean, seconds)
        return exposed(simulator, plan, mean, seconds, gain, kept)

    def _operated(self, of, per_second):
        """Exposure time [s] and analog gain: given, the camera's, or metered from electrons per second."""
        simulator, seconds = self.simulator, self._exposure_time
        seconds = simulator.camera.sensor.exposure_time if seconds is None else seconds
        if seconds is not None:
            return float(seconds), float(self._gain)
        if self._operates is not None:
            return (
                self._operates
            )  # however often the frame is asked for: its own light is for the next one
        if self.meters_late and self._metered:
            found = self._metered
        else:
            light, key = per_second(), (*of, metered_by(simulator))
            found = self._metered = self.kept("metered", key, lambda: metered(simulator, light))
        self._operates = found if self.meters_late else None
        return found

    def _look(self, made, mean, seconds):
        """Have the device look once at a scene that the plan was not made for; it is judged before the next."""
        simulator, kept, plan, found = self.simulator, self.kept, made.plan, None
        looked = (*made.samples, One(plan), kept.one(mean) if self.meters_late else None)
        if same(self.before.looked, looked):
            return
        self.before.looked = looked
        device, automatic = simulator.device, simulator.camera.sensor.auto_exposure
        light = kept("light", (kept.one(mean), automatic), lambda: light_of(simulator, mean))
        if plan.watch is not None and plan.scene is not self.scene and self._given is None:
            watch, (entries, ids) = plan.watch, made.stored
            found = device.fetch(
                self.before.kept(
                    "survey",
                    (made.samples, One(plan)),
                    lambda: survey(
                        entries, watch.table, watch.first, ids, watch.scale, device=device
                    ),
                )
            )
        self._pending = _Look(self.scene, plan, device.fetch(light), found, mean.shape, seconds)

    def judge(self) -> None:
        """Wait for what the device saw of the last scene; drop the plan where it does not fit.

        Every frame does it for the one before. Raises BadData for light that is not finite.
        """
        look, self._pending = self._pending, None
        if look is None:
            return
        light = look.light()
        if light[4]:
            self.before.looked, self._last = (
                (),
                None,
            )  # it is refused again where it is not taken away
            raise BadData(
                f"{look.scene.name}: {light[4]:.0f} of {prod(look.shape)} pixels have NaN or infinite light"
            )
        if self.meters_late and light[0] > 0:
            self._metered = chosen(self.simulator, light, look.shape, look.seconds)
        if look.plan.scene is not look.scene and self._given is None:
            self._seen(look, light)

    def _seen(self, look, light):
        """Drop the plan where it does not fit a scene by its light and its survey."""
        plan, scene, probing, self._drift = look.plan, look.scene, self.before.probing, None
        if look.survey is not None:
            found = look.survey()
            self._drift, steepest = plan.watch.errors(found)
            probing.surveyed(plan, scene, self._drift, steepest)
        if not plan.fits(light, self._drift):
            self.before.plan = None
            if plan.fits(light, None):
                probing.unfit(
                    plan,
                    scene,
                    plan.watch.count_missing_planes(found, plan.limit),
                    scene is self.scene,
                )

    @property
    def shots(self) -> Shots:
        """Frames of the exposure."""
        return Shots(self.simulator, self._exposed(), self.kept)

    def output(self, name: str, *, seed: int = 0, frame: int = 0) -> Any:
        """One of OUTPUTS by its name, on the device; nothing beyond it and the exposure is computed.

        seed, frame: of the noise, from "raw" on. Raises UnknownName, and BadData for the irradiance of a blur that
        varies over the field.
        """
        if name not in [*OUTPUTS]:
            raise UnknownName("output", str(name), OUTPUTS)
        return output_of(self, name, seed, frame)

    def raw(self, *, seed: int = 0, frame: int = 0) -> Any:
        """Digital numbers (rows, cols) of one frame, on the device."""
        return self.shots.raw(seed, frame)

    def codes(self, *, seed: int = 0, frame: int = 0) -> Any:
        """Display codes (rows, cols, 3) of one frame, on the device."""
        shots = self.shots
        return shots.codes(shots.raw(seed, frame))

    def frame(self, *, seed: int = 0, frame: int = 0) -> Frame:
        """One picture with its report, by a plan that fits its scene."""
        exposure = self.exposure
        if not self._does():
            exposure = self.exposure
        exposure = dataclasses.replace(exposure, plan=self._told(exposure.plan))
        return Shots(self.simulator, exposure, self.kept).frame(seed=seed, frame=frame)

    @property
    def account(self) -> Account:
        """Predicted errors of the scene's exposure, by what is known of it so far."""
        exposure = self._exposed()
        return self._told(exposure.plan).account.at(exposure.exposure_time)

    def _told(self, plan):
        """A plan with what it is predicted to err in the scene."""
        if self._given is not None:
            return self._judged()
        return (
            plan
            if plan.scene is self.scene
            else self.before.probing.told(plan, self.scene, self._drift)
        )

    @property
    def scene_plan(self) -> Plan:
        """The exposure's plan, with the errors that are predicted for its scene."""
        return self._told(self._exposed().plan)

    def _judged(self):
        """The plan that was given, with the errors that are predicted for the scene."""
        simulator, scene, seconds = self.simulator, self.scene, self._exposure_time
        return self.before.kept(
            "given",
            (One(scene), One(simulator), seconds),
            lambda: judged_by(simulator, self._given, scene, self._facts(), seconds),
        )


def chip_mean(simulator, mean, seconds, kept):
    """What this very chip makes of mean electrons: see `Readout.chip_mean`."""
    readout, of = simulator.readout, (kept.one(mean), simulator.readout.response_key, seconds)
    return kept(
        "chip_mean",
        of,
        lambda: readout.chip_mean(mean, seconds),
        lambda tape: retime_chip(tape, readout.dark_time(seconds)),
    )


def exposed(simulator, plan: Plan, mean, seconds: float, gain: float, kept: Kept) -> Exposure:
    """The exposure of mean electrons [e-], an array of the device, without the times that it took.

    seconds: of the exposure [s]. gain: analog, beside the sensor's [1]. kept: what was made before for exposures alike.
    """
    sensor, readout, processor = (
        simulator.camera.sensor,
        simulator.readout,
        simulator.camera.processor,
    )
    of_chip = chip_mean(simulator, mean, seconds, kept)
    camera = kept(
        "operated",
        (simulator.camera, gain),
        lambda: dataclasses.replace(simulator.camera, sensor=readout.operated(gain)),
    )
    shading = None
    if processor.shading:
        nodes = None if plan.distortion is None else plan.distortion.nodes
        falls = (
            plan.scene.shape,
            plan.slope,
            plan.falloff,
            nodes,
            sensor.cfa,
            sensor.stacked,
            sensor.binning,
            sensor.binning_mode,
        )
        shading = simulator.kept("shading", falls, lambda: _shading(simulator, plan))
    colors = (
        plan.white_rate,
        plan.scene.illuminant,
        plan.scene.light_is_known,
        camera.optics,
        One(camera.sensor),
        without_tone(processor),
        camera.display,
        seconds,
        readout.pixels,
    )
    colored = kept(
        "rendering",
        colors,
        lambda: rendering(plan, camera, seconds, readout.pixels, simulator.kept),
    )
    blur = simulator.imaging.tables.deviation(plan) if processor.demosaic == "best" else 0.0
    return Exposure(
        plan, camera, mean, of_chip, seconds, gain, colored, blur, shading, device=simulator.device
    )


def _shading(simulator, plan):
    """Gains of the shading correction for each pixel of the mosaic's period, see `Developer.demosaicked`."""
    readout = simulator.readout
    response, period = relative_response(plan), readout.output.cfa_indices.shape
    if simulator.camera.sensor.binning == (1, 1):
        return shading_gains(response, period[0] * period[1])
    return phase_gains(readout.mean(simulator.device.array(response)), period)[0]

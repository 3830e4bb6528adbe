"""A camera on a device: the way from a scene to frames. Brackets, bursts and the like are in `gpusim.captures`."""

from collections.abc import Iterable, Iterator
from copy import copy
from dataclasses import replace
from operator import is_
from typing import Any, overload

from gpusim.backends import Device, open_device
from gpusim.backends.tape import OwnTape
from gpusim.domain.camera import Camera, checked_camera
from gpusim.domain.errors import OutOfRange, checked_count
from gpusim.domain.foreign import is_array
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.short_repr import shortened
from gpusim.domain.tolerance import Tolerance
from gpusim.kernels.sensor.bin import binned_shape
from gpusim.kernels.sensor.noise import OUT
from gpusim.pipeline import truths
from gpusim.pipeline.batch import Batch
from gpusim.pipeline.cache import Cache
from gpusim.pipeline.developer import Developer
from gpusim.pipeline.frame import Exposure, Frame
from gpusim.pipeline.imaging import Imaging
from gpusim.pipeline.planning import checked_reach, make_plan
from gpusim.pipeline.program import Program
from gpusim.pipeline.readout import Readout
from gpusim.pipeline.report import Error
from gpusim.pipeline.shots import Shots, exposure_steps
from gpusim.pipeline.step import Step
from gpusim.pipeline.stream import Stream
from gpusim.planner.facts import Facts
from gpusim.planner.knobs.noise import without_negligible
from gpusim.planner.plan import Plan


class Simulator:
    """A camera on a device.

    camera: what takes the picture. device: a name for `open_device`, or a Device. tolerance: a preset's name, a
    relative RMS error or a Tolerance: of what is predicted to meet it the cheapest is done, and nothing that costs more
    than the exact frame in a world without end; the report says whether it is met. Without one every wavelength is
    exact. guaranteed: predict for the worst spectrum there can be, a monochromatic point, and not for the scene's own.
    reach: pixels of surroundings on each side that take part in the blur; by default BORDER_REACH, or what the
    tolerance needs, with a world without end beyond where the lens allows it.
    period: of the transforms [sample], for the reference: see `gpusim.planner.plan.plan`. strict: raise NotMet for a
    scene of which the tolerance is predicted not to be met; else the report says so.
    Raises BadData for what is no camera, DeviceError, UnknownName, OutOfRange (a tolerance below what float32 can
    hold).
    """

    def __init__(
        self,
        camera: Camera,
        *,
        device: Device | str = "auto",
        tolerance: Tolerance | str | None = None,
        guaranteed: bool = False,
        reach: int | None = None,
        period: tuple[int, int] | None = None,
        strict: bool = False,
    ):
        self.strict = strict
        self.guaranteed, self.reach, self.period = guaranteed, checked_reach(reach), period
        self.device = open_device(device) if isinstance(device, str) else device
        self.tolerance = None if tolerance is None else Tolerance.parse(tolerance)
        if (
            self.tolerance
            and self.tolerance.rms
            and self.tolerance.rms < 1e-6
            and self.device.kind != "numpy"
        ):
            raise OutOfRange(
                "tolerance rms",
                self.tolerance.rms,
                "rms >= 1e-6 in float32; below it use device numpy",
            )
        self.launched: list[str] = []  # names of stages in their order
        self._drawing = OwnTape()
        self._connect(camera, Cache(), Cache())

    def __repr__(self):
        asked = "exact" if self.tolerance is None else repr(self.tolerance)
        return shortened(f"Simulator({self.camera!r}, {self.device!r}, {asked})")

    def _connect(self, camera, cache, tables):
        """Use a camera. cache: of a camera's values. tables: of lens tables and patterns, for frames of one kind."""
        self.camera, self.cache, self.tables = checked_camera(camera), cache, tables
        sensor, self.left_out = without_negligible(camera.sensor, self.tolerance)
        self.readout = cache("readout", Readout, sensor, self.device, tables)
        self.imaging = Imaging(camera, self.device, tables)
        return self

    def update(self, camera: Camera) -> "Simulator":
        """The same with another camera, for which what does not change is kept. Raises as the class does."""
        return copy(self)._connect(camera, self.cache, self.tables)

    def apart(self, camera: Camera, tables: Cache) -> "Simulator":
        """The same with another camera, used in turn with this one: both keep what is theirs, and tables are shared."""
        return copy(self)._connect(camera, Cache(), tables)

    def steps(self, plan: Plan) -> list[Step]:
        """Return the steps of a frame by a plan, from the scene to display codes.

        Args:
            plan: Plan for this simulator's camera.
        """
        readout, shape = self.readout, plan.scene.shape
        layers = len(self.camera.sensor.channels) if self.camera.sensor.stacked else 1
        camera = replace(self.camera, sensor=readout.output)
        developer = Developer(camera, self.device, readout.averaged, self.cache)
        raw_shape = layers * shape[0], shape[1]
        if self.camera.sensor.binning != (1, 1):
            raw_shape = binned_shape(raw_shape, self.camera.sensor.binning, readout.stride)
        return [*exposure_steps(self, plan), *developer.steps(raw_shape)]

    def batch(
        self,
        count: int,
        output: str = "codes",
        planned_for: Scene | None = None,
        plan: Plan | None = None,
    ) -> Batch:
        """Frames of several scenes, or of several settings, in one array: see `gpusim.pipeline.batch.Batch`."""
        return Batch(self, count, output, planned_for, plan)

    def program(
        self,
        scene: Scene,
        exposure_time: float | None = None,
        gain: float = 1.0,
        meters_late: bool = False,
        plan: Plan | None = None,
    ) -> Program:
        """Frames of a scene, in which what a change does not touch is kept: see `Program`."""
        return Program(self, scene, exposure_time, gain, meters_late, plan=plan)

    def stream(
        self,
        scenes: Iterable[Scene],
        output: str = "codes",
        *,
        seed: int = 0,
        first: int = 0,
        exposure_time: float | None = None,
        gain: float = 1.0,
        meters_late: bool = True,
        plan: Plan | None = None,
    ) -> Stream:
        """One frame of every scene, an array of the device, which is written anew for the next one.

        output: a name of `gpusim.pipeline.outputs.OUTPUTS`, such as "codes" or "raw". seed: of the noise;
        frames are numbered from `first`. exposure_time, gain: as for `expose`. meters_late: where the exposure is
        automatic, expose by what was metered in the frame before, as a video camera does, the first frame by its own;
        else every frame by its own, which waits for the device. The next scene goes to the device while this one is
        computed: arrays of a scene may be written to again when the scene after the next is asked for. A plan is kept
        while scenes are of one kind and it fits them, which the device looks at in each, and probes now and then: see
        `Program`; `plan` makes all frames instead. The stream's `plan` is that of its last frame. Raises as `frames`
        does.
        """
        return Stream(
            self,
            scenes,
            output,
            seed=seed,
            first=first,
            exposure_time=exposure_time,
            gain=gain,
            meters_late=meters_late,
            plan=plan,
        )

    @overload
    def __call__(
        self,
        scene: Scene,
        *,
        seed: int = 0,
        frame: int = 0,
        verify: bool = False,
        plan: Plan | None = None,
    ) -> Frame: ...

    @overload
    def __call__(
        self,
        scene: Iterable[Scene],
        *,
        seed: int = 0,
        frame: int = 0,
        verify: bool = False,
        plan: Plan | None = None,
    ) -> Iterator[Frame]: ...

    def __call__(self, scene, *, seed=0, frame=0, verify=False, plan=None):
        """One frame of `scene`, of number `frame`; see `frames`.

        Of several scenes, a list or what gives them one by one, an iterator of one frame of each, numbered from `frame`
        on: each is made when it is asked for, and is what its scene and number give by themselves. `stream` is faster
        where their arrays are enough. Raises as `frames` does: at the call for what is no scene, also in a list.
        """
        if (
            isinstance(scene, Iterable)
            and not isinstance(scene, str | bytes)
            and not is_array(scene)
        ):
            for one in scene if isinstance(scene, list | tuple | set | dict) else ():
                checked_scene(one)
            return (
                self(one, seed=seed, frame=number, verify=verify, plan=plan)
                for number, one in enumerate(scene, frame)
            )
        return next(self.frames(scene, 1, seed=seed, first=frame, verify=verify, plan=plan))

    def frames(
        self,
        scene: Scene,
        count: int,
        *,
        seed: int = 0,
        first: int = 0,
        verify: bool = False,
        plan: Plan | None = None,
    ) -> Iterator[Frame]:
        """`count` noisy frames of one scene, numbered from `first`; the mean electrons are computed once.

        seed: names the noise; frame n of a seed is the same whatever else is drawn. verify: also run the float64
        reference and report the true error.
        Raises BadData, DoesNotFit (memory, before anything is allocated), OutOfRange.
        """
        checked_count("count of frames", count)
        return self._frames(checked_scene(scene), count, seed, first, verify, plan)

    def _frames(self, scene, count, seed, first, verify, plan):
        if verify:
            truths.load().require_truth(self.camera, scene)
        exposure = self.expose(scene, plan=plan)
        error = truths.load().true_error(self, scene, exposure) if verify else None
        yield from self.shoot(exposure, count, seed=seed, first=first, error=error)

    def shoot(
        self,
        exposure: Exposure,
        count: int = 1,
        *,
        seed: int = 0,
        first: int = 0,
        error: Error | None = None,
    ) -> Iterator[Frame]:
        """`count` noisy frames of an exposure, numbered from `first`; error: of its mean electrons, where known."""
        checked_count("count of frames", count)
        shots = Shots(self, exposure)
        for number in range(first, first + count):
            yield shots.frame(seed=seed, frame=number, error=error, first=number == first)

    def plan(
        self,
        scene: Scene,
        facts: Facts | None = None,
        exposure_time: float | None = None,
        least: int = 0,
    ) -> Plan:
        """What a frame of `scene` takes.

        facts: of it, where they are known. exposure_time: [s], in place of the camera's. least: planes of the blur.
        Raises BadData, DoesNotFit, NotMet where the simulator is strict.
        """
        return make_plan(self, scene, facts, exposure_time, least)

    def expose(
        self,
        scene: Scene,
        exposure_time: float | None = None,
        gain: float = 1.0,
        plan: Plan | None = None,
    ) -> Exposure:
        """Mean electrons of `scene`; the exposure time [s] is the camera's unless given, automatic if that is None.

        Automatic exposure is as the sensor's `auto_exposure` says, and chooses the analog gain too. gain: beside the
        sensor's, with a time that is given or the camera's: `expose(scene, last.exposure_time, last.gain)` keeps what
        was metered before. Raises BadData, DoesNotFit, OutOfRange.
        """
        program = self.program(scene, exposure_time, gain, plan=plan)
        exposure = program.exposure
        return replace(exposure, plan=program.scene_plan, is_rewritten=False)

    def draw(
        self, exposure: Exposure, *, seed: int = 0, frame: int = 0, frames: int | None = None
    ) -> Any:
        """Raw values around the exposure's `chip_mean`, an array of the device; equal on all for equal means.

        frames: how many from `frame` on, shape (frames, rows, cols); by default one alone, (rows, cols), the layers of
        stacked pixels one below the other.
        """
        drawing, of = (
            self._drawing,
            (exposure.chip_mean, exposure.exposure_time, exposure.gain, self.readout),
        )
        shape = tuple(exposure.chip_mean.shape)
        if frames is None and drawing.of and all(map(is_, drawing.of, of)):
            raw = self.readout.draw_again(drawing.tape, shape, drawing.raw, seed=seed, frame=frame)
            drawing.raw = raw
            return self.device.reshape(raw, shape)
        drawing.of = ()
        raw = self.readout.draw(*of[:-1], seed=seed, frame=frame, frames=frames, tape=drawing.tape)
        if frames is None and self.readout.draws_at_once:
            drawing.of, drawing.raw = of, drawing.tape.commands[-1].args[OUT]
        return raw

    def develop(self, raw, exposure: Exposure) -> tuple[Any, Any]:
        """Linear display RGB (3, rows, cols), before the tone curve, and display codes (rows, cols, 3), on the device.

        Raw values of a sensor without a converter are shown from 16 bits of them.
        """
        return Shots(self, exposure).develop(raw)[:2]

    def codes(self, raw, exposure: Exposure) -> Any:
        """The display codes of `develop` alone, for previews and videos: in one pass where the camera allows it."""
        return Shots(self, exposure).codes(raw)

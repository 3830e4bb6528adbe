"""A camera on a device, which makes frames of scenes. Brackets, bursts and other captures are in `gpusim.captures`."""

from collections.abc import Iterable, Iterator, Sequence
from copy import copy
from dataclasses import replace
from typing import overload

from gpusim import pipeline
from gpusim.backends import Device, open_devices
from gpusim.domain.account import Tolerance
from gpusim.domain.camera import Camera, checked_camera
from gpusim.domain.errors import OutOfRange, checked_count
from gpusim.domain.memory import is_array
from gpusim.domain.scene import Scene, checked_scene
from gpusim.domain.short_repr import shorten_repr
from gpusim.kernels.sensor.bin import binned_shape
from gpusim.pipeline.batch import Batch
from gpusim.pipeline.cache import Cache
from gpusim.pipeline.developer import Developer
from gpusim.pipeline.diodes import Diodes, flag_places, is_sparse, require_no_places
from gpusim.pipeline.exposure import Exposure, expose_phase_pixels, exposure_steps
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.imaging import Imaging
from gpusim.pipeline.loop import Capture, Loop, Planned
from gpusim.pipeline.planning import checked_reach, make_plan
from gpusim.pipeline.readout import Readout
from gpusim.pipeline.step import Step
from gpusim.pipeline.stream import Stream
from gpusim.planner.facts import Facts
from gpusim.planner.knobs.pixels import without_negligible
from gpusim.planner.plan import Plan


class Simulator:
    """A camera on a device.

    Args:
        camera: The camera that takes the pictures.
        device: A Device or a name for `open_device`; or several for `open_devices`, such as "gpus": streams and
            batches take them in turn, with the same bits. All else is computed on the first.
        tolerance: A preset's name, a relative RMS error or a Tolerance. The planner uses the cheapest method that is
            predicted to meet it, never one that costs more than the exact frame of an infinite scene. The report says
            whether it is met. None computes each wavelength exactly.
        guaranteed: Predict errors for the worst possible spectrum, a monochromatic point, instead of the scene's.
        reach: Width of the surroundings that contribute to the blur, on each side [pixel]. None chooses it from the
            tolerance and, if the lens allows it, adds the light from beyond; without a tolerance it is BORDER_REACH.
        period: Lengths of the transforms (rows, cols) [sample], for reference frames, see `gpusim.planner.plan.plan`.
        strict: Raise NotMet if the tolerance is predicted not to be met; otherwise the report says so.

    Raises:
        BadData: No camera.
        DeviceError: There is no such device, or several are not of one kind.
        UnknownName: There is no such tolerance preset.
        OutOfRange: The tolerance is below the precision of float32, or the reach is not allowed.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        device: Device | str | Sequence[Device | str] = "auto",
        tolerance: Tolerance | str | None = None,
        guaranteed: bool = False,
        reach: int | None = None,
        period: tuple[int, int] | None = None,
        strict: bool = False,
    ):
        self.strict = strict
        self.guaranteed, self.reach, self.period = guaranteed, checked_reach(reach), period
        self.devices = open_devices(device)
        self.device = self.devices[0]
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
        self.launched: list[str] = []  # names of stages, in their order
        self._connect(camera, Cache(), Cache())

    def __repr__(self):
        wanted = "exact" if self.tolerance is None else repr(self.tolerance)
        return shorten_repr(f"Simulator({self.camera!r}, {self.device!r}, {wanted})")

    def _connect(self, camera, cache, tables):
        """Set the camera and its caches.

        cache: of a camera's values. tables: of lens tables and chip patterns, for frames of one kind.
        """
        self.camera, self.cache, self.tables = flag_places(checked_camera(camera)), cache, tables
        self._diodes: dict[tuple[int, int], Diodes] = {}  # by the frame's shape
        camera = self.camera
        sensor, self.left_out = without_negligible(camera.sensor, self.tolerance)
        self.readout = cache("readout", Readout, sensor, self.device, tables)
        self.imaging = Imaging(camera, self.device, tables)
        # plan of the last exposure, and the exposure time that was asked for
        self._kept: tuple[Planned, float | None] | None = None
        return self

    def update(self, camera: Camera) -> "Simulator":
        """Return the simulator with another camera. Results that do not depend on the change are kept.

        Args:
            camera: The new camera.

        Returns:
            A simulator that shares the caches of this one.
        """
        return copy(self)._connect(camera, self.cache, self.tables)

    def apart(self, camera: Camera, tables: Cache) -> "Simulator":
        """Return a simulator with another camera that is used in turn with this one. Each has a cache.

        Args:
            camera: The camera of the new simulator.
            tables: Cache of its lens tables and chip patterns; it may be shared.

        Returns:
            The new simulator.
        """
        return copy(self)._connect(camera, Cache(), tables)

    def diodes_of(self, shape: tuple[int, int]) -> Diodes:
        """Return the photodiodes of frames of a shape, made once.

        Args:
            shape: Rows and columns of the frame.

        Returns:
            The diodes of a camera with divided or phase-detection pixels.
        """
        if shape not in self._diodes:
            self._diodes[shape] = Diodes(self, shape)
        return self._diodes[shape]

    def on_devices(self) -> "list[Simulator]":
        """Return a simulator for each device.

        Returns:
            This simulator for the first device, and others with caches of their own.
        """
        found = [self]
        for device in self.devices[1:]:
            other = copy(self)
            other.device, other.devices = device, [device]
            found.append(other._connect(self.camera, Cache(), Cache()))
        return found

    def steps(self, plan: Plan) -> list[Step]:
        """Return the steps of a frame made with a plan, from the scene to display codes.

        Args:
            plan: Plan for this simulator's camera.

        Returns:
            The steps, in the order in which they run.
        """
        readout, shape = self.readout, plan.scene.shape
        layers = len(self.camera.sensor.channels) if self.camera.sensor.stacked else 1
        camera = replace(self.camera, sensor=readout.output)
        binning = self.camera.sensor.binning
        developer = Developer(camera, self.device, readout.averaged, self.cache, binning)
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
        capture: Capture | None = None,
    ) -> Batch:
        """Return a Batch: frames of several scenes, or with several settings, in one array.

        Args:
            count: Number of frames in a call.
            output: A key of `gpusim.pipeline.loop.OUTPUTS`.
            planned_for: Scene whose plan is used for all scenes of its kind that it fits.
            plan: Plan for all frames.
            capture: Capture of each item, see `gpusim.captures`; None is one frame.

        Returns:
            A callable, see `gpusim.pipeline.batch.Batch`.
        """
        require_no_places(self.camera, "a batch")
        return Batch(self, count, output, planned_for, plan, capture)

    def loop(
        self,
        scene: Scene,
        exposure_time: float | None = None,
        gain: float = 1.0,
        meters_late: bool = False,
        plan: Plan | None = None,
        capture: Capture | None = None,
    ) -> Loop:
        """Return a Loop: frames of a scene that reuse results that a change does not affect.

        Args:
            scene: The scene.
            exposure_time: Exposure time [s]; None uses the camera's.
            gain: Analog gain, next to the sensor's [1].
            meters_late: Expose each frame as metered in the frame before.
            plan: Plan for every frame, instead of one for the scene.
            capture: Capture of each output, see `gpusim.captures`; None is one frame.

        Returns:
            The loop, see `gpusim.pipeline.loop.Loop`.
        """
        require_no_places(self.camera, "a loop")
        return Loop(self, scene, exposure_time, gain, meters_late, plan=plan, capture=capture)

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
        capture: Capture | None = None,
    ) -> Stream:
        """Return an iterator over one frame of each scene. The next frame overwrites the array.

        The next scene is uploaded while this one is computed. A scene's arrays may be rewritten when the iterator
        requests the scene after the next; with n devices, the scene n + 1 later. Devices take the scenes in turn, and
        each frame is an array of its device. One plan is used as long as it fits the scenes, see `Loop`.

        Args:
            scenes: The scenes.
            output: A key of `gpusim.pipeline.loop.OUTPUTS`, for example "codes" or "raw".
            seed: Seed of the noise.
            first: Number of the first frame.
            exposure_time: Exposure time [s]; None uses the camera's, see `expose`.
            gain: Analog gain, next to the sensor's [1].
            meters_late: If exposure is automatic, expose each frame but the first as metered in the frame before, like
                a video camera. False meters each frame itself, which waits for the device. A capture in motion meters
                its own first view.
            plan: Plan for all frames.
            capture: Capture of each scene, see `gpusim.captures`; None is one frame.

        Returns:
            The iterator; it yields device arrays, and its `plan` made the last frame.
        """
        require_no_places(self.camera, "a stream")
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
            capture=capture,
        )

    @overload
    def __call__(
        self,
        scene: Scene,
        *,
        seed: int = 0,
        first: int = 0,
        verify: bool = False,
        plan: Plan | None = None,
    ) -> Frame: ...

    @overload
    def __call__(
        self,
        scene: Iterable[Scene],
        *,
        seed: int = 0,
        first: int = 0,
        verify: bool = False,
        plan: Plan | None = None,
    ) -> Iterator[Frame]: ...

    def __call__(
        self,
        scene: Scene | Iterable[Scene],
        *,
        seed: int = 0,
        first: int = 0,
        verify: bool = False,
        plan: Plan | None = None,
    ) -> Frame | Iterator[Frame]:
        """Return one frame of a scene, or an iterator over one frame of each of several scenes.

        Frames of several scenes are computed lazily. Without a tolerance each depends only on its scene, seed and
        number; with one, also on the plan, see `expose`. `stream` is faster if device arrays are enough.

        Args:
            scene: A scene, or several.
            seed: Seed of the noise.
            first: Number of the frame, or of the first one.
            verify: Also compute the float64 reference and report the true error.
            plan: Plan for all frames.

        Returns:
            The frame, or the iterator.
        """
        if (
            isinstance(scene, Iterable)
            and not isinstance(scene, str | bytes)
            and not is_array(scene)
        ):
            for one in scene if isinstance(scene, list | tuple | set | dict) else ():
                checked_scene(one)
            return (
                self(one, seed=seed, first=number, verify=verify, plan=plan)
                for number, one in enumerate(scene, first)
            )
        return next(
            self.frames(checked_scene(scene), 1, seed=seed, first=first, verify=verify, plan=plan)
        )

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
        """Return an iterator over noisy frames of one scene. The mean electrons are computed once.

        The iterator raises BadData, DoesNotFit (before it allocates memory) or OutOfRange at its first frame.

        Args:
            scene: The scene.
            count: Number of frames.
            seed: Seed of the noise. Frame n of a seed is always the same.
            first: Number of the first frame.
            verify: Also compute the float64 reference and report the true error.
            plan: Plan for the frames.

        Returns:
            The iterator.
        """
        checked_count("count of frames", count)
        return self._frames(checked_scene(scene), count, seed, first, verify, plan)

    def _frames(self, scene, count, seed, first, verify, plan):
        if verify:
            pipeline.load_truth().require_truth(self.camera, scene)
        exposure = self.expose(scene, plan=plan)
        error = pipeline.load_truth().true_error(self, scene, exposure) if verify else None
        yield from exposure.frames(count, seed=seed, first=first, error=error)

    def plan(
        self,
        scene: Scene,
        facts: Facts | None = None,
        exposure_time: float | None = None,
        least: int = 0,
        brightness: float = 1.0,
    ) -> Plan:
        """Return the plan of a scene.

        It raises BadData, DoesNotFit, or NotMet if the simulator is strict.

        Args:
            scene: The scene.
            facts: Facts of the scene, if known.
            exposure_time: Exposure time [s]; None uses the camera's.
            least: Minimum number of planes of the blur.
            brightness: Factor on the scene's light, see `Loop.update`.

        Returns:
            The plan.
        """
        return make_plan(self, scene, facts, exposure_time, least, brightness)

    def expose(
        self,
        scene: Scene,
        exposure_time: float | None = None,
        gain: float = 1.0,
        plan: Plan | None = None,
    ) -> Exposure:
        """Return the exposure of a scene: its mean electrons, without noise.

        If neither the call nor the camera gives an exposure time, the sensor's `auto_exposure` chooses time and gain.
        `expose(scene, last.exposure_time, last.gain)` repeats an exposure that was metered before. It raises BadData,
        DoesNotFit or OutOfRange.

        The last scene again, with the same light in its arrays, is not planned again. With a tolerance, another scene
        of its kind uses the last plan as a `Loop` does, if its errors are predicted to meet the tolerance. Then the
        report names the scene of the plan. For the same bits after other scenes, give the plan.

        Args:
            scene: The scene.
            exposure_time: Exposure time [s]; None uses the camera's.
            gain: Analog gain, next to the sensor's [1]. Automatic exposure ignores it.
            plan: Plan for the exposure.

        Returns:
            The exposure.
        """
        loop = Loop(self, scene, exposure_time, gain, plan=plan)
        kept, self._kept = self._kept, None
        if plan is None and kept is not None and kept[1] == exposure_time:
            loop.reuse(kept[0])
        del kept
        exposure = loop.judged_exposure
        if exposure.plan.planned_for and not exposure.plan.meets(exposure.exposure_time):
            before = exposure.wall_ms
            loop = Loop(self, scene, exposure_time, gain)  # a plan made for the scene may meet it
            exposure = loop.judged_exposure
            exposure = replace(exposure, wall_ms=before + exposure.wall_ms)
        if plan is None:
            self._kept = loop.keep_plan(), exposure_time
        exposure = replace(exposure, is_rewritten=False)
        return expose_phase_pixels(exposure) if is_sparse(self.camera) else exposure

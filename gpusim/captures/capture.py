"""A capture: the frames that a camera takes of a scene, at rest or in motion.

`Capture` takes one frame; `gpusim.captures.burst.Burst`, `bracket.Bracket` and `reads.Reads` take several. All of
them are values: streams, batches, videos, pairs and previews accept them.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, prod
from numbers import Real
from time import perf_counter
from typing import Any

import numpy as np

from gpusim.captures.moving import expose_motion
from gpusim.domain.animation import Animation
from gpusim.domain.errors import BadData, Conflict, OutOfRange, checked_count, format_value
from gpusim.domain.exposure import checked_gain, checked_time
from gpusim.domain.flicker import Flicker
from gpusim.domain.motion import Motion
from gpusim.domain.scene import Scene, checked_scene
from gpusim.kernels.sensor.chip import chip
from gpusim.pipeline.exposure import Exposure, convert_to_xyz, expose_mean, make_frame, output_of
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.loop import BEFORE_NOISE, Loop, blurred_content, checked_output
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan

REST = Motion()
CHANNELS = ("electrons", "irradiance")  # outputs of all channels of each pixel
MERGED = ("mean", "raw", "linear", "xyz", "codes")  # outputs of a merged frame


@dataclass(frozen=True, kw_only=True)
class Capture:
    """One frame of a scene. Subclasses take several.

    Args:
        motion: Motion of the camera during the capture.
        flicker: Flicker of all the light, on the clock of the motion; None is steady light.
        period: Time between the starts of consecutive captures [s]: the capture whose first frame
            has the number n starts at n // count periods on the clock of the motion.
        instants: Number of views of the scene, see `expose_motion`.
        merged: Merge the frames into one. Only for captures of several frames.

    Raises:
        BadData: The motion or the flicker is of another type.
        Conflict: One frame cannot be merged.
        OutOfRange: The period is negative or infinite.
    """

    motion: Motion = REST
    flicker: Flicker | None = None
    period: float = 0.0
    instants: int | None = None
    merged: bool = False

    def __post_init__(self):
        for name, kind in (("motion", Motion), ("flicker", Flicker | None)):
            if not isinstance(getattr(self, name), kind):
                found = format_value(getattr(self, name))
                raise BadData(f"capture.{name} = {found}: wanted a {name.capitalize()}")
        if not (isinstance(self.period, Real) and 0 <= self.period < inf):
            raise OutOfRange("capture.period", format_value(self.period), "0 s or more")
        if self.merged and not self._merges:
            raise Conflict("merged", "a single frame has nothing to merge with", "leave it out")

    _merges = False  # whether it takes several frames

    @property
    def has_frames(self) -> bool:
        """True if its outputs have an axis of frames."""
        return self._merges and not self.merged

    @property
    def frame_count(self) -> int:
        """Number of frames that `take` returns."""
        return self.count if self.has_frames else 1

    @property
    def exposure_time(self) -> float | None:
        """Exposure time that the capture sets [s]; None is the camera's or a given one."""
        return None

    @property
    def count(self) -> int:
        """Number of frames, which is also the number of different noises."""
        return 1

    @property
    def keeps_size(self) -> bool:
        """True if its pictures have as many pixels as the camera."""
        return True

    def check_size(self, what: str) -> None:
        """Check that the pictures have as many pixels as the camera.

        Args:
            what: What needs that, as a part of a sentence.

        Raises:
            Conflict: They are enlarged.
        """
        if not self.keeps_size:
            reason = f"{what} have as many pixels as the camera"
            raise Conflict("enlarge", reason, "leave it out, or take single frames")

    def is_moving(self, scene: Scene | Animation) -> bool:
        """Return True if the light of a frame changes while it is exposed.

        Args:
            scene: The scene.

        Returns:
            False if one exposure of the scene at rest serves all frames.
        """
        return isinstance(scene, Animation) or self.motion != REST or self.flicker is not None

    def take(
        self,
        simulator: Simulator,
        scene: Scene | Animation,
        *,
        seed: int = 0,
        first: int = 0,
        exposure_time: float | None = None,
        gain: float = 1.0,
        plan: Plan | None = None,
    ) -> list[Frame]:
        """Return the frames of one capture, or a list with the merged one.

        Args:
            simulator: Simulator whose camera takes the frames.
            scene: The scene, or an Animation.
            seed: Seed of the noise.
            first: Number of the first frame.
            exposure_time: Exposure time [s]; None is the camera's or automatic.
            gain: Analog gain, see `Simulator.expose`.
            plan: Plan to use; None plans the scene. See `Simulator`.

        Returns:
            The frames.

        Raises:
            GpusimError: As `Simulator.expose` and `expose_motion` do.
        """
        light = Light(self, simulator, scene, first, exposure_time, gain, plan)
        return self.frames(simulator, self.shots(light, seed, first))

    def frames(self, simulator: Simulator, shots: "list[Shot]") -> list[Frame]:
        """Return the frames of shots, or a list with the merged one.

        Args:
            simulator: Simulator that made the shots.
            shots: Result of `shots`.

        Returns:
            The frames.
        """
        frames = [shot.frame() for shot in shots]
        return [self._merge(simulator, frames)] if self.merged else frames

    def shots(self, light: "Light", seed: int, first: int) -> "list[Shot]":
        """Return the exposures of one capture with the numbers of their frames.

        Args:
            light: Light of the scene.
            seed: Seed of the noise.
            first: Number of the first frame.

        Returns:
            One for each frame.
        """
        exposures = self._exposures(light)
        return [
            Shot(exposure, seed, first + k, is_timed=not k or exposure is not exposures[k - 1])
            for k, exposure in enumerate(exposures)
        ]

    def output(self, loop: Loop, name: str, *, seed: int = 0, first: int = 0) -> tuple[Any, Plan]:
        """Return one of `gpusim.pipeline.loop.OUTPUTS` of a capture of a loop's scene.

        Args:
            loop: The loop.
            name: Name of the output.
            seed: Seed of the noise.
            first: Number of the first frame.

        Returns:
            A device array, with an axis of frames in front if the capture has several, and the
            plan of the first frame.

        Raises:
            Conflict: The capture does not have this output.
        """
        self.check_size("outputs of loops and batches")
        light = Light.of(self, loop, first)
        shots = self.shots(light, seed, first)
        plan, device = shots[0].exposure.plan, loop.simulator.device
        if self.merged:
            if name not in MERGED:
                reason = f"the output {name} is of a single frame"
                raise Conflict("capture", reason, f"take {', '.join(MERGED)}, or leave merged out")
            (frame,) = self.frames(loop.simulator, shots)
            return _upload(frame, name, device), plan
        show = light.channels if name in CHANNELS else Shot.output
        found = [show(shot, name) for shot in shots]
        return device.stack(found) if self.has_frames else found[0], plan

    def _exposures(self, light):
        """Return the exposures of all frames."""
        return [light.expose()]

    def _merge(self, simulator, frames):
        """Return one frame made of all."""
        raise NotImplementedError


class Light:
    """Light of a scene on the sensor during one capture.

    Args:
        capture: The capture.
        simulator: The simulator.
        scene: The scene, or an Animation.
        first: Number of the first frame.
        exposure_time: Exposure time [s]; None is the camera's or automatic.
        gain: Analog gain.
        plan: Given plan.
        rest: Function that returns the exposure of the scene at rest; None: `Simulator.expose`.
    """

    def __init__(
        self,
        capture: Capture,
        simulator: Simulator,
        scene: Scene | Animation,
        first: int = 0,
        exposure_time: float | None = None,
        gain: float = 1.0,
        plan: Plan | None = None,
        rest: Callable[[], Exposure] | None = None,
    ):
        checked_count("first", first, 0)
        self.capture, self.simulator = capture, simulator
        self.scene = scene if isinstance(scene, Animation) else checked_scene(scene)
        seconds = exposure_time if capture.exposure_time is None else capture.exposure_time
        self._seconds, self._gain, self._plan = checked_time(seconds), checked_gain(gain), plan
        self._rest, self._start = rest, first // capture.count * capture.period
        self.is_moving = capture.is_moving(scene)

    @classmethod
    def of(cls, capture: Capture, loop: Loop, first: int) -> "Light":
        """Return the light of a loop's scene."""
        if capture.exposure_time is not None:
            loop.update(exposure_time=capture.exposure_time)
        return cls(capture, loop.simulator, loop.scene, first, *loop.settings, rest=loop.expose)

    @cached_property
    def rest(self) -> Exposure:
        """The exposure of the scene at rest."""
        if self._rest is not None:
            return self._rest()
        assert isinstance(self.scene, Scene)  # actors move
        return self.simulator.expose(self.scene, self._seconds, self._gain, self._plan)

    @property
    def readout_time(self) -> float:
        """Time between the ends of exposure of the first and the last row [s]."""
        scene = self.scene.scene if isinstance(self.scene, Animation) else self.scene
        return self.simulator.camera.sensor.row_time * (scene.shape[0] - 1)

    @cached_property
    def time_and_gain(self) -> tuple[float, float]:
        """Exposure time [s] and analog gain of a frame in motion."""
        found = self._seconds or self.simulator.camera.sensor.exposure_time
        if found is not None:
            return float(found), self._gain
        scene = self.scene.at(self._start) if isinstance(self.scene, Animation) else self.scene
        view = scene.viewed(self.capture.motion.through(scene.view).at(self._start))
        by = self.simulator.expose(view, None, self._gain, self._plan)
        return by.exposure_time, by.gain

    def expose(
        self, after: float = 0.0, factor: float | None = None, seconds: float | None = None
    ) -> Exposure:
        """Return the exposure of one frame.

        Args:
            after: Time from the start of the capture to the opening of the first row [s].
            factor: Exposure time over the metered one; None is 1.
            seconds: Exposure time [s] in place of the metered one.
        """
        if not self.is_moving:
            own = self.rest.exposure_time * (factor or 1.0) if seconds is None else seconds
            if factor is None and own == self.rest.exposure_time:
                return self.rest
            return change_exposure_time(self.simulator, self.rest, own)
        metered, gain = self.time_and_gain if seconds is None else (seconds, self._gain)
        return expose_motion(
            self.simulator,
            self.scene,
            self.capture.motion,
            metered * (factor or 1.0),
            self._start + after,
            gain,
            self.capture.instants,
            self.capture.flicker,
            self._plan,
        )

    def channels(self, shot: "Shot", name: str) -> Any:
        """Return light of all channels or wavelengths for a frame. Raises Conflict for a scene that moves."""
        if self.is_moving:
            reason = f"pixels collect only their own channel in motion, so there is no {name}"
            raise Conflict("capture", reason, "take mean, or a scene at rest")
        simulator, exposure = self.simulator, shot.exposure
        imaging, plan = simulator.imaging, exposure.plan
        assert isinstance(self.scene, Scene)  # actors move
        values = imaging.values(plan, blurred_content(plan, self.scene))
        values.give(view=self.scene.view)
        if name == "irradiance":
            values.use([*imaging.steps(plan), *imaging.irradiance_steps(plan)])
            return values[name]
        values.set_numbers(exposure_time=exposure.exposure_time)
        return values[name]


@dataclass(frozen=True, eq=False)
class Shot:
    """One frame of a capture.

    Attributes:
        exposure: Its exposure.
        seed: Seed of its noise.
        number: Its number.
        raw: Its raw values, a device array; None draws them.
        is_timed: Whether the exposure's times count in this frame.
        single: Raw values of single pixels before digital binning; None draws them if they are asked for.
    """

    exposure: Exposure
    seed: int
    number: int
    raw: Any = None
    is_timed: bool = True
    single: Any = None

    def draw_raw(self) -> Any:
        """Return the raw values, a device array, layers of stacked pixels below each other."""
        if self.raw is None:
            return self.exposure.raw(seed=self.seed, first=self.number)
        return self.raw

    def output(self, name: str) -> Any:
        """Return one of `gpusim.pipeline.loop.OUTPUTS`, a device array."""
        checked_output(name)
        if name in BEFORE_NOISE:
            return getattr(self.exposure, name)
        drawn = self.draw_raw()
        return drawn if name == "raw" else output_of(self.exposure.values(), name, raw=drawn)

    def frame(self) -> Frame:
        """Return the frame with its report."""
        values = self.exposure.values()
        drawn = {"raw": self.raw, "single": self.single}
        return make_frame(
            self.exposure, values, self.seed, self.number, is_timed=self.is_timed, **drawn
        )


def change_exposure_time(
    simulator: Simulator, exposure: Exposure, exposure_time: float
) -> Exposure:
    """Return an exposure of the same scene with another exposure time.

    Only the electrons of the chip are computed again; the light on the pixels is reused.

    Args:
        simulator: simulator that made the exposure.
        exposure: exposure to change.
        exposure_time: new exposure time [s].

    Returns:
        The new exposure, with the plan and gain of the old one.

    Raises:
        OutOfRange: if `exposure_time` is None or not a valid time.
    """
    if checked_time(exposure_time) is None:
        raise OutOfRange("exposure_time", "None", "a time [s]")
    device, shape, start = simulator.device, exposure.mean.shape, perf_counter()
    with device.timed() as ms:
        rows = device.reshape(exposure.mean, (prod(shape[:-1]), shape[-1]))
        mean = chip(rows, scale=exposure_time / exposure.exposure_time, device=device)
        mean = device.reshape(mean, shape)
        changed = expose_mean(simulator, exposure.plan, mean, exposure_time, exposure.gain)
    return replace(changed, ms=dict(ms), wall_ms=1e3 * (perf_counter() - start))


def _upload(frame, name, device):
    """Return an output of a merged frame as a device array."""
    if name in ("raw", "mean"):
        values = getattr(frame, name)
        flat = values.reshape(-1, values.shape[-1]) if name == "raw" else values
        return device.array(np.ascontiguousarray(flat), flat.dtype)
    if name == "codes":
        return device.array(frame.rgb, np.uint8)
    linear = device.array(np.ascontiguousarray(np.moveaxis(frame.linear, -1, 0)))
    if name == "linear":
        return linear
    return convert_to_xyz(linear, matrix=frame.camera.display.xyz_from_rgb, device=device)

"""Nondestructive readout: several reads of one growing charge."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from gpusim.captures.capture import Capture, Light, Shot
from gpusim.captures.merge import merge_reads
from gpusim.domain.account import Bound
from gpusim.domain.errors import BadData
from gpusim.domain.scene import Scene
from gpusim.pipeline.exposure import expose_mean
from gpusim.pipeline.report import Error
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


@dataclass(frozen=True)
class Reads(Capture):
    """Reads that leave the charge in the pixels, as frames of growing exposure time.

    All reads see the same growing charge, also in motion, and have one frame number. See
    `Readout.nondestructive`. `merged` fits the slope, see `merge_reads`.

    Args:
        times: Times of the reads since the reset [s], rising; the last one is the exposure time.

    Raises:
        BadData: The times are not a list of numbers.
    """

    times: tuple[float, ...] = (0.01, 0.02)

    _merges = True

    def __post_init__(self):
        super().__post_init__()
        try:
            times = np.asarray(self.times, np.float64)
            object.__setattr__(self, "times", tuple(np.atleast_1d(times).tolist()))
        except (TypeError, ValueError):
            raise BadData(f"times of reads = {self.times!r}: wanted a list of numbers") from None
        if not self.times:
            raise BadData("times of reads: none, wanted one or more")

    @property
    def frame_count(self) -> int:
        """Number of frames that `take` returns."""
        return len(self.times) if self.has_frames else 1

    @property
    def exposure_time(self) -> float:
        """Time of the last read [s]."""
        return self.times[-1]

    def raw(
        self, light: Light, seed: int, first: int, is_averaged: bool = True
    ) -> tuple[list, np.ndarray]:
        """Return the exposure of each read and the raw values.

        Args:
            light: Light of the scene.
            seed: Seed of the noise.
            first: Number of the frame.
            is_averaged: False returns pixels before digital binning.

        Returns:
            The exposures from the reset to each read, and raw values on the host (reads, rows,
            cols), layers of stacked pixels below each other [DN].
        """
        readout, device = light.simulator.readout, light.simulator.device
        times = readout.checked_reads(self.times)
        numbers = {"seed": seed, "first": first, "is_averaged": is_averaged}
        if not light.is_moving:
            exposures = [light.expose(seconds=float(time)) for time in times]
            last = exposures[-1]
            return exposures, readout.nondestructive(
                last.mean, last.exposure_time, times, gain=last.gain, **numbers
            )
        exposures, steps, before = [], [], 0.0
        for time in map(float, times):
            part = light.expose(before, seconds=time - before)
            steps.append(part.mean)
            if exposures:
                mean = device.numpy(exposures[-1].mean) + device.numpy(part.mean)
                plan = _with_dark_light(light, part.plan, steps, mean, time)
                total = expose_mean(light.simulator, plan, device.array(mean), time, part.gain)
                part = replace(total, ms=part.ms, wall_ms=part.wall_ms)
            exposures.append(part)
            before = time
        return exposures, readout.nondestructive(
            steps, float(times[-1]), times, gain=exposures[-1].gain, **numbers
        )

    def shots(self, light: Light, seed: int, first: int) -> list[Shot]:
        """Return the reads, see `Capture.shots`.

        Args:
            light: Light of the scene.
            seed: Seed of the noise.
            first: Number of the frame.

        Returns:
            One for each read.
        """
        readout, device, shots = light.simulator.readout, light.simulator.device, []
        exposures, raw = self.raw(light, seed, first, is_averaged=False)
        for exposure, one in zip(exposures, raw, strict=True):
            single = None
            own = device.array(np.ascontiguousarray(one), one.dtype)
            if readout.averaged > 1:
                single, own = one, readout.average_pixels(own)
            shots.append(Shot(exposure, seed, first, own, single=single))
        return shots

    def _merge(self, simulator, frames):
        return merge_reads(simulator, frames)


def _with_dark_light(light, plan, steps, mean, time):
    """Return the plan of a read with the error of light below 0, which is 0 between any two reads.

    Band-limited light of stars that move has ripples below 0. An exposure up to the read has their mean, too.
    """
    device = light.simulator.device
    if not any(((device.numpy(step) <= 0) & (mean > 0)).any() for step in steps):
        return plan
    whole = np.asarray(device.numpy(light.expose(seconds=time).mean), np.float64)
    read = light.simulator.camera.sensor.read_sigma
    found = Error.between(np.asarray(mean, np.float64), whole, read)
    error = Bound(found.rms, found.p999_sigma, found.max_sigma)
    bounds = plan.account.bounds | {"light below 0 between reads": error}
    return plan.exchange(account=replace(plan.account, bounds=bounds))


def read_nondestructively(
    simulator: Simulator,
    scene: Scene,
    times: ArrayLike,
    *,
    seed: int = 0,
    first: int = 0,
    plan: Plan | None = None,
) -> np.ndarray:
    """Return the raw values of reads that leave the charge in the pixels.

    See `Readout.nondestructive`. `Reads` returns frames, also in motion.

    Args:
        simulator: simulator whose camera takes the exposure.
        scene: scene to capture.
        times: times of the reads since the reset [s], rising; the last one is the exposure time.
        seed: seed of the noise.
        first: number of the frame.
        plan: plan to use; None plans the scene. See `Simulator`.

    Returns:
        Raw values on the host [DN]: one array per read, each with the shape of a frame's raw
        values.

    Raises:
        GpusimError: as raised by `Simulator.expose`.
    """
    checked: np.ndarray = simulator.readout.checked_reads(times)
    exposure = simulator.expose(scene, float(checked[-1]), plan=plan)
    return exposure.split_layers(
        simulator.readout.nondestructive(
            exposure.mean,
            exposure.exposure_time,
            checked,
            gain=exposure.gain,
            seed=seed,
            first=first,
        )
    )

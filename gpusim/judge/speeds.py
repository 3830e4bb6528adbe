"""Predicted time of a frame, from the measured speed of every stage on a device.

Speeds are measured once and stored in the user's cache folder.
"""

import json
import time
from math import prod
from pathlib import Path

import numpy as np

from gpusim.backends import Device
from gpusim.backends.probe import cache_file, write_cache
from gpusim.backends.tape import Tape, recording
from gpusim.kernels.common import fft
from gpusim.kernels.stage import make_resident, public_function, stage_module
from gpusim.optics.farfield import multiplications
from gpusim.pipeline.simulator import Simulator
from gpusim.pipeline.step import steps_needed

SIZES = ((96, 128), (480, 640))  # rows and columns of a stage's benchmarks
GPU_SIZES = ((96, 128), (720, 1280))  # the same for GPUs; smaller ones do not fill them
REFERENCE_SIZES = ((16, 24), (48, 64))  # the same for the slow NumPy reference
SECONDS = 0.08  # for repetitions of a stage at one size, after it is built
IN_A_ROW = 100  # repetitions at most on a GPU, whose clock slows down after a pause


class Speeds:
    """Time of a stage as a function of its work: a constant part, and a part per unit of `Step.work`.

    Args:
        device: The device.
        cache: File that stores the speeds; None for the default file in the user's cache folder.
    """

    def __init__(self, device: Device, cache: Path | None = None):
        self.device = device
        self.cache = cache or cache_file(f"speeds-{device.name.replace(':', '-')}")
        self.known: dict[str, list[float]] = self._read()

    def of(self, stage: str) -> tuple[float, float]:
        """Return the constant time of a stage and its time per unit of work [ms].

        They are measured if they are not known.

        Args:
            stage: Name of the stage.
        """
        if stage not in self.known:
            sizes = GPU_SIZES if self.device.is_gpu else SIZES
            if self.device.kind == "numpy":
                sizes = REFERENCE_SIZES
            (low, small), (high, large) = (self._time_stage(stage, *size) for size in sizes)
            unit = max(large - small, 0.1 * large) / (high - low)
            self.known[stage] = [max(small - unit * low, 0.0), unit]
            if self.cache is not None:
                write_cache(self.cache, self.known)
        always, unit = self.known[stage]
        return always, unit

    def ms(self, work: dict[str, float]) -> dict[str, float]:
        """Return the time of every stage of a frame [ms].

        Args:
            work: Units of work by stage.
        """
        found = {}
        for stage, amount in work.items():
            always, unit = self.of(stage)
            found[stage] = always + unit * amount
        return found

    def _time_stage(self, stage, rows, cols):
        """Return the work of the stage benchmark and its median time [ms], with resident arrays."""
        inputs = stage_module(stage).bench(rows, cols)
        resident = make_resident(self.device, inputs)
        function, times, in_a_row, tape = public_function(stage), [], 0, Tape()

        def run():
            function(**resident, device=self.device)

        with recording(tape if self.device.is_gpu else None):
            run()  # builds the kernels
        # as in the frames of a loop, which copy no small arrays again
        if self.device.is_gpu and tape.is_replayable:
            run = tape.replay
        warm = time.perf_counter() + SECONDS / 4
        while self.device.is_gpu and in_a_row < IN_A_ROW and time.perf_counter() < warm:
            run()
            self.device.sync()
            in_a_row += 1
        in_a_row = max(in_a_row, 1)
        stop = time.perf_counter() + SECONDS
        while len(times) < 3 or (time.perf_counter() < stop and len(times) < 50):
            with self.device.timed() as ms:
                for _ in range(in_a_row):
                    run()
            times.append(sum(ms.values()) / in_a_row)
        return work_of_bench(stage, inputs, rows, cols), float(np.median(times))

    def _read(self):
        try:
            known = json.loads(self.cache.read_text()) if self.cache else {}
            return {
                str(stage): [float(always), float(unit)] for stage, (always, unit) in known.items()
            }
        except (OSError, ValueError, TypeError, AttributeError, RecursionError):
            return {}


def frame_ms(simulator: Simulator, plan, speeds: Speeds | None = None) -> dict[str, float]:
    """Return the predicted time of every stage of a frame after the first [ms].

    Args:
        simulator: A `gpusim.pipeline.simulator.Simulator` with the camera of the plan.
        plan: The plan.
        speeds: Speeds of the simulator's device; None measures them.
    """
    speeds = Speeds(simulator.device) if speeds is None else speeds
    work: dict[str, float] = {}
    steps = steps_needed(simulator.steps(plan), ["codes", "light", "survey"])
    for step in steps:
        if step.work:
            work[step.stage] = work.get(step.stage, 0.0) + step.work
    return speeds.ms(work)


def work_of_bench(stage: str, inputs: dict, rows: int, cols: int) -> float:
    """Work of a stage's benchmark of this size; inputs: what its contract's `bench` gave."""
    pixels = float(rows * cols)
    if stage == "spectral.integrate":
        return inputs["content"].nbytes + 4 * len(inputs["weights"]) * pixels
    if stage == "spectral.materials":
        return inputs["ids"].nbytes + inputs["shading"].nbytes + 4 * len(inputs["table"]) * pixels
    if stage == "spectral.survey":
        entries, _, width = inputs["content"].shape
        return float(len(inputs["first"]) * width * entries)
    if stage in ("optics.mosaic", "optics.blur", "optics.tiles"):
        return float(stage_module(stage).operations(**inputs))
    if stage == "optics.far":
        channels, planes, _ = inputs["weights"].shape
        return multiplications((rows, cols), planes, channels, tuple(inputs["sigmas"]))
    if stage == "optics.splat":
        return len(inputs["places"]) * float(max(rows, cols)) ** 2
    if stage == "optics.field":
        (tiles, terms), size = inputs["index"].shape, inputs["kernels"].shape[-1]
        high, wide = (float(np.diff(edge).max()) + size - 1 for edge in inputs["edges"])
        return tiles * (terms + 1) * fft.operations((high, wide))
    planes = inputs.get("planes", inputs.get("lights"))
    return float(prod(planes.shape)) if planes is not None else pixels

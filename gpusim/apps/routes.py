"""Ways from a case of `gpusim.judge.combinations` to frames: by captures and by outputs."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import Any

import numpy as np

from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.state import State
from gpusim.apps.video.scenes import Moving, Still
from gpusim.apps.video.video import blurred_frames, frames
from gpusim.backends import Device
from gpusim.captures.burst import burst
from gpusim.captures.moving import expose_motion
from gpusim.captures.reads import read_nondestructively
from gpusim.domain.camera import Camera
from gpusim.domain.flicker import Flicker
from gpusim.domain.motion import Motion
from gpusim.domain.scene import View
from gpusim.judge.combinations import EXPOSURE, Case, Made, NoWay
from gpusim.pipeline.exposure import Exposure
from gpusim.pipeline.simulator import Simulator

PAN = (0.0, 300.0)  # [pixel/s]: three pixels in an exposure
RATE = Fraction(30)  # [1/s]
VIEWS = (View(), View((1.5, -2.25), zoom=1.1))
STOPS = (-1, 1)
TIMES = (0.4, 1.0)  # of reads, relative to the exposure time
FLICKER = Flicker(100.0, depth=0.8)
# an effect that is left out, and its error
LEFT_OUT = re.compile(r"(.*): (?:relative rms (\S+), predicted|its error is not known)")
TOGETHER = {"motion", "rolling"}  # captures that are one exposure


@dataclass(frozen=True)
class Held(State):
    """A preview's state of a camera that is no file."""

    held: Camera | None = None

    def build(self) -> Camera:
        """Return the camera."""
        assert self.held is not None
        return self.held


def make(case: Case, device: Device, tolerance: str | None = None) -> Made:
    """Return the frames of a case, by each of its outputs.

    Args:
        case: The case.
        device: The device.
        tolerance: Tolerance of the frames, see `Simulator`.

    Raises:
        NoWay: The API has no way from the captures of the case to one of its outputs.
        GpusimError: As the simulation does.
    """
    simulator = Simulator(case.camera, device=device, tolerance=tolerance)
    ways = {"video": _show_video, "preview": _show_preview, "batch": _make_batch}
    if not case.outputs:
        return _capture(simulator, case)
    found = [ways[name](simulator, case) for name in sorted(case.outputs)]
    return Made(
        [array for made in found for array in made.arrays],
        {words: rms for made in found for words, rms in made.left_out.items()},
    )


def _capture(simulator, case):
    """Return the frames of a case without a special output."""
    scenes = _views(case)
    names = case.captures
    if "reads" in names:
        return _read(simulator, case, scenes)
    if "burst" in names and not names & {*TOGETHER, "bracket"}:
        return _frames(burst(simulator, scenes, 2, seed=1))
    exposures = [
        exposure
        for number, scene in enumerate(scenes)
        for exposure in _bracketed(simulator, case, scene, number * float(1 / RATE))
    ]
    count = 2 if "burst" in names else 1
    return _frames(
        frame
        for number, exposure in enumerate(exposures)
        for frame in exposure.frames(count, seed=1, first=count * number)
    )


def _views(case):
    scene = case.scene
    return [scene.viewed(view) for view in VIEWS] if "views" in case.captures else [scene]


def _bracketed(simulator, case, scene, start) -> Iterator[Exposure]:
    """Yield the exposures of a scene: one, or one for each stop of a bracket."""
    for stop in STOPS if "bracket" in case.captures else (0,):
        seconds = EXPOSURE * 2.0**stop
        if case.captures & TOGETHER:
            motion = Motion(pan=PAN) if "motion" in case.captures else Motion()
            flicker = FLICKER if "rolling" in case.captures else None
            yield expose_motion(simulator, scene, motion, seconds, start, flicker=flicker)
        else:
            yield simulator.expose(scene, seconds)


def _read(simulator, case, scenes):
    """Return nondestructive reads, one ramp for each scene, frame and stop."""
    if case.captures & TOGETHER:
        raise NoWay("nondestructive reads of a moving scene or a rolling shutter")
    stops = STOPS if "bracket" in case.captures else (0,)
    count = 2 if "burst" in case.captures else 1
    arrays = [
        read_nondestructively(
            simulator, scene, EXPOSURE * 2.0**stop * np.array(TIMES), seed=1, first=number
        )
        for scene in scenes
        for stop in stops
        for number in range(count)
    ]
    return Made(arrays, _errors(simulator.plan(scenes[0]).left_out))


def _frames(found) -> Made:
    """Return arrays of frames, and the effects that their plans left out."""
    made = list(found)
    arrays = [array for frame in made for array in (frame.mean, frame.raw, frame.rgb)]
    return Made(arrays, _errors(words for frame in made for words in frame.report.left_out))


def _errors(lines) -> dict[str, float]:
    """Return the effects that a plan left out, with their relative rms errors."""
    found = {}
    for line in lines:
        match = LEFT_OUT.fullmatch(line)
        words, rms = (match[1], float(match[2] or inf)) if match else (line, 0.0)
        found[words] = max(rms, found.get(words, 0.0))
    return found


def _show_video(simulator, case):
    if names := case.captures & {"reads", "burst", "bracket"}:
        raise NoWay(f"video of {', '.join(sorted(names))}")
    still = Still(case.scene, 2)
    if not case.captures:
        scenes: Any = still
    else:
        pan = PAN if case.captures & {"motion", "views"} else (0.0, 0.0)
        flicker = FLICKER if "rolling" in case.captures else None
        scenes = Moving(still, Motion(pan=pan), RATE, flicker)
    show = blurred_frames if case.captures & TOGETHER else frames
    return _frames(one.values for one in show(simulator, scenes, [[0, 0, 1]], seed=1))


def _show_preview(simulator, case):
    if names := case.captures - {"views"}:
        raise NoWay(f"preview of {', '.join(sorted(names))}")
    scenes: Any = Still(case.scene, 2)
    if "views" in case.captures:
        scenes = Moving(scenes, Motion(pan=PAN), RATE)
    producer = Producer(scenes, simulator.device)
    state = Held("", tolerance="exact", seed=1, held=case.camera)
    pictures = [producer.picture(state, number) for number in range(2)]
    return Made([one.codes for one in pictures], _errors(pictures[0].facts["left out"]))


def _make_batch(simulator, case):
    if names := case.captures - {"views"}:
        raise NoWay(f"batches of {', '.join(sorted(names))}")
    scenes = _views(case)
    scenes = scenes if len(scenes) > 1 else [case.scene, case.scene.brighten(0.5)]
    batch = simulator.batch(len(scenes), "raw")
    raw = np.array(simulator.device.numpy(batch(scenes, seed=1)))
    return Made([raw], _errors(batch.plans[0].left_out))

"""Ways from a case of `gpusim.judge.combinations` to frames: by captures and by outputs."""

import re
from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import Any

import numpy as np

from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.state import State
from gpusim.apps.video.scenes import Moving, Still
from gpusim.apps.video.video import captured_frames, frames
from gpusim.backends import Device
from gpusim.captures.bracket import Bracket
from gpusim.captures.burst import Burst
from gpusim.captures.capture import Capture
from gpusim.captures.reads import Reads
from gpusim.domain.camera import Camera
from gpusim.domain.flicker import Flicker
from gpusim.domain.motion import Motion
from gpusim.domain.scene import View
from gpusim.judge.combinations import EXPOSURE, Case, Made
from gpusim.pipeline.simulator import Simulator

PAN = (0.0, 300.0)  # [pixel/s]: three pixels in an exposure
RATE = Fraction(30)  # [1/s]
VIEWS = (View(), View((1.5, -2.25), zoom=1.1))
STOPS = (-1, 1)
TIMES = (0.4, 1.0)  # of reads, relative to the exposure time
FLICKER = Flicker(130.0, depth=0.8)  # not a whole number of periods in an exposure
# an effect that is left out, and its error
LEFT_OUT = re.compile(r"(.*): (?:relative rms (\S+), predicted|its error is not known)")


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
        GpusimError: As the simulation does.
    """
    simulator = Simulator(case.camera, device=device, tolerance=tolerance)
    ways = {"video": _show_video, "preview": _show_preview, "batch": _make_batch}
    if not case.outputs:
        return _take(simulator, case)
    found = [ways[name](simulator, case) for name in sorted(case.outputs)]
    return Made(
        [array for made in found for array in made.arrays],
        {words: rms for made in found for words, rms in made.left_out.items()},
    )


def captures_of(case: Case, merged: bool = False) -> list[Capture]:
    """Return the captures of a case, taken one after the other.

    Args:
        case: The case.
        merged: Whether the frames of a capture are merged to one.
    """
    names = case.captures
    more: dict[str, Any] = {"period": float(1 / RATE)}
    if "motion" in names:
        more["motion"] = Motion(pan=PAN)
    if "rolling" in names:
        more["flicker"] = FLICKER
    merged = merged and bool(names & {"reads", "bracket", "burst"})
    more["merged"] = merged
    times = EXPOSURE * np.array(TIMES)
    if "reads" in names:
        stops = STOPS if "bracket" in names else (0,)
        found: list[Capture] = [Reads(times=tuple(times * 2.0**stop), **more) for stop in stops]
    elif "bracket" in names:
        found = [Bracket(stops=STOPS, **more)]
    elif "burst" in names:
        return [Burst(size=2, **more)]
    else:
        return [Capture(**more)]
    return 2 * found if "burst" in names else found


def _take(simulator, case):
    """Return the frames of a case without a special output."""
    made: list = []
    for scene in _views(case):
        for capture in captures_of(case):
            first = len(made) * capture.count
            made += capture.take(simulator, scene, seed=1, first=first)
    return _frames(made)


def _views(case):
    scene = case.scene
    return [scene.viewed(view) for view in VIEWS] if "views" in case.captures else [scene]


def _frames(made) -> Made:
    """Return arrays of frames, and the effects that their plans left out."""
    made = list(made)
    arrays = [array for frame in made for array in (frame.mean, frame.raw, frame.rgb)]
    return Made(arrays, _errors(words for frame in made for words in frame.report.left_out))


def _errors(lines) -> dict[str, float]:
    """Return the effects that a plan left out, with their relative rms errors."""
    found: dict[str, float] = {}
    for line in lines:
        match = LEFT_OUT.fullmatch(line)
        words, rms = (match[1], float(match[2] or inf)) if match else (line, 0.0)
        found[words] = max(rms, found.get(words, 0.0))
    return found


def _show_video(simulator, case):
    scenes: Any = Still(case.scene, 2)
    if case.captures & {"motion", "rolling", "views"}:
        pan = PAN if case.captures & {"motion", "views"} else (0.0, 0.0)
        flicker = FLICKER if "rolling" in case.captures else None
        scenes = Moving(scenes, Motion(pan=pan), RATE, flicker)
    if not case.captures - {"views"}:
        return _frames(one.values for one in frames(simulator, scenes, [[0, 0, 1]], seed=1))
    (capture,) = captures_of(case, merged=True)
    shown = captured_frames(simulator, scenes, [[0, 0, 1]], seed=1, capture=capture)
    return _frames(one.values for one in shown)


def _show_preview(simulator, case):
    scenes: Any = Still(case.scene, 2)
    if "views" in case.captures:
        scenes = Moving(scenes, Motion(pan=PAN), RATE)
    capture = None
    if case.captures - {"views"}:
        (capture,) = captures_of(case, merged=True)
    producer = Producer(scenes, simulator.device, capture=capture)
    state = Held("", tolerance="exact", seed=1, held=case.camera)
    pictures = [producer.picture(state, number) for number in range(2)]
    return Made([one.codes for one in pictures], _errors(pictures[0].facts["left out"]))


def _make_batch(simulator, case):
    scenes = _views(case)
    scenes = scenes if len(scenes) > 1 else [case.scene, case.scene.brighten(0.5)]
    capture = captures_of(case)[0] if case.captures - {"views"} else None
    batch = simulator.batch(len(scenes), "raw", capture=capture)
    raw = np.array(simulator.device.numpy(batch(scenes, seed=1)))
    return Made([raw], _errors(batch.plans[0].left_out))

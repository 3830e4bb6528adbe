"""Frames of a video, each averaged with the frames before it."""

from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from typing import Any

from gpusim.apps.video.scenes import Scenes
from gpusim.apps.video.video import Made, frames, take_output
from gpusim.captures.merge import merge_burst
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.simulator import Simulator


def averaged_frames(
    simulator: Simulator,
    scenes: Scenes,
    segments: Iterable[list[int]],
    *,
    count: int,
    output: str | None = None,
    parts: tuple[str, ...] = (),
    late: bool = False,
    **settings: Any,
) -> Iterator[Made]:
    """Yield frames with less noise: each is merged with up to `count` - 1 frames before it.

    Frames are aligned to the newest, and what differs from it by more than noise does is left out
    (`gpusim.merge_burst`): what moves has no ghosts. Frames of another exposure time or gain than the
    newest are left out as well.

    Args:
        simulator: Camera and device.
        scenes: Scenes of all frames.
        segments: For each segment its first frame, then the wanted ones.
        count: Most frames that are averaged, 2 to 16.
        output: Output of `Simulator.stream`. None: a Frame.
        parts: Not used: a Frame has all parts.
        late: As for `frames`.
        **settings: Further options of `gpusim.apps.video.video.frames`.
    """
    for first, *wanted in segments:
        begin = max(first - count + 1, 0)
        needed = range(begin, wanted[-1] + 1)
        recent: deque[Frame] = deque(maxlen=count)
        coming: Any = frames(simulator, scenes, [[begin, *needed]], **settings)
        with closing(coming) as arriving:
            for made in arriving:
                recent.append(made.values)
                if made.number not in wanted:
                    continue
                merged = average_recent(simulator, list(recent))
                yield replace(made, values=take_output(merged, output, late))


def average_recent(simulator: Simulator, recent: list[Frame]) -> Frame:
    """Return the last of several frames, merged with those before it that were exposed alike.

    Args:
        simulator: Simulator of the camera.
        recent: Frames of a camera, complete, in the order of their times.
    """
    newest = recent[-1]
    alike = [frame for frame in recent if _exposure_of(frame) == _exposure_of(newest)]
    if len(alike) < 2:
        return newest
    return merge_burst(simulator, alike, reference=len(alike) - 1)


def _exposure_of(frame):
    return frame.exposure_time, frame.camera.sensor.gain_dn_per_electron

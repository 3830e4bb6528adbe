"""Loops of a camera over the frames of a video: exposure, white balance and focus that follow the scene with a lag.

What they do is found before the frames, in a pass over all scenes that takes one picture of each, and is kept with the
video: its parts, and a run that goes on, read it.
"""

import argparse
import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, fields, replace
from math import exp, isfinite, log
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.apps.video.manifest import LARGEST
from gpusim.apps.video.pipeline import ahead
from gpusim.apps.video.ramps import Ramps
from gpusim.apps.video.scenes import Scenes
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, GpusimError, OutOfRange
from gpusim.domain.processor import WHITE_BALANCES
from gpusim.io.files import read_text
from gpusim.optics.lens import lens_of
from gpusim.pipeline.simulator import Simulator

SLOWEST = 1e4  # [s]
READ = 2  # scenes that are ready before they are needed


@dataclass(frozen=True)
class Lags:
    """Time constants of the loops that a camera has [s]; None: it has none.

    After one of them a loop has made up for 63 % of a step, as 1 - exp(-t / lag); with 0 it follows in the next frame.
    exposure: automatic exposure, in stops. white: the white that the processor estimates, in logarithms. focus: on the
    middle third of a scene with depth, as sensors of phase tell it without a search, in dioptres.
    """

    exposure: float | None = None
    white: float | None = None
    focus: float | None = None

    @classmethod
    def parse(cls, text: str) -> "Lags":
        """Of a command line: `exposure=0.3,white=1,focus=0.4`."""
        names, found = [part.name for part in fields(cls)], {}
        for part in text.split(","):
            name, _, value = part.partition("=")
            try:
                lag = float(value)
            except ValueError:
                lag = -1.0
            if name not in names or name in found or not (isfinite(lag) and 0 <= lag <= SLOWEST):
                raise argparse.ArgumentTypeError(
                    f"{part!r}: wanted NAME=SECONDS, 0 .. {SLOWEST:g}, each NAME once: "
                    f"{', '.join(names)}"
                )
            found[name] = lag
        return cls(**found)

    def check(self, camera: Camera, ramps: Ramps):
        """Raise OutOfRange where a loop has nothing to do: what it would set is given."""
        ramped = [name for name, _ in ramps.ranges]
        if self.exposure is not None and (
            camera.sensor.exposure_time is not None or "exposure" in ramped
        ):
            raise OutOfRange(
                "--lag exposure", self.exposure, "for a camera that meters: --exposure auto"
            )
        if self.focus is not None and "focus" in ramped:
            raise OutOfRange("--lag focus", self.focus, "without a ramp of the focus")
        if self.focus is not None and not lens_of(camera).is_adjustable:
            raise OutOfRange(
                "--lag focus",
                self.focus,
                "for a camera without measured point spreads, of one focus",
            )
        if self.white is not None and not camera.processor.estimates_white:
            estimates = [
                name for name in WHITE_BALANCES if name not in ("illuminant", "preset", "none")
            ]
            raise OutOfRange(
                "--lag white",
                self.white,
                "for a processor that estimates the white: white_balance = one "
                f"of {', '.join(estimates)} in the camera file",
            )


@dataclass(frozen=True)
class Loops:
    """What the loops have set for every frame.

    seconds: exposure time times analog gain [s], white: camera values of white, focus: distance of what is in focus
    [m]; each a list of all frames, or None.
    """

    seconds: list[float] | None = None
    white: list[list[float]] | None = None
    focus: list[float] | None = None

    @classmethod
    def kept_in(cls, manifest: Path, lags: Lags, count: int) -> "Loops | None":
        """Those of a manifest of a video of `count` frames; None if it has none, or others than `lags` has.

        What is wrong with it is found with the rest.
        """
        try:
            found = cls(
                **json.loads(read_text(manifest, "a manifest of a video", LARGEST))["loops"]
            )
            for lag, values, axes in (
                (lags.exposure, found.seconds, 1),
                (lags.white, found.white, 2),
                (lags.focus, found.focus, 1),
            ):
                array = (
                    np.ones((count, 1)[:axes])
                    if lag is values is None
                    else np.array(values, np.float64)
                )
                if (
                    (lag is None) != (values is None)
                    or array.ndim != axes
                    or len(array) != count
                    or not ((array > 0) & (array < np.inf)).all()
                ):
                    return None
        except (GpusimError, ValueError, LookupError, TypeError, OverflowError, RecursionError):
            return None
        return found

    def camera(self, camera: Camera, number: int) -> Camera:
        """The camera of a frame."""
        if self.focus is self.white is None:
            return camera
        optics, processor = camera.optics, camera.processor
        if self.focus is not None:
            optics = replace(optics, object_distance=self.focus[number])
        if self.white is not None:
            processor = replace(processor, white_balance="preset", white=tuple(self.white[number]))
        return replace(camera, optics=optics, processor=processor)

    def operation(self, camera: Camera, number: int) -> dict[str, Any]:
        """Exposure time [s] and analog gain of a frame, as `Program.update` takes them; nothing where it meters."""
        if self.seconds is None:
            return {}
        total, longest = self.seconds[number], camera.sensor.auto_exposure.longest
        time = total if longest is None else min(total, longest)
        return {"exposure_time": time, "gain": total / time}


NO_LOOPS = Loops()


def follow(targets, lag: float, period: float) -> np.ndarray:
    """What a loop sets for every frame, from where it should be in each one, shape (n, ...).

    It begins where it should be, and sees a frame before it sets the next. lag, period: of the loop and the frames [s].
    """
    targets = np.asarray(targets, np.float64)
    part = 1.0 if lag == 0 else 1 - exp(-period / lag)
    found = targets.copy()
    for before, number in enumerate(range(1, len(targets))):
        found[number] = found[before] + part * (targets[before] - found[before])
    return found


def metered(
    simulator: Simulator,
    scenes: Scenes,
    lags: Lags,
    ramps: Ramps,
    period: float,
    *,
    seed: int = 0,
    seen: Callable[[], Any] = int,
) -> Loops:
    """The loops' settings by the light, the colours and the distances of all scenes.

    period: of the frames [s]. seed: of the pictures' noise. seen: called after each of the scenes. Raises BadData for a
    loop of focus without depth, and what frames of the scenes raise.
    """
    program: Any = None
    last = max(scenes.count - 1, 1)
    seconds: list[float] = []
    white: list[Any] = []
    vergence: list[float] = []
    with closing(ahead(scenes.between(0, scenes.count), READ)) as arriving:
        for number, shown in enumerate(arriving):
            scene, camera = (
                ramps.scene(shown, number / last),
                ramps.camera(simulator.camera, number / last),
            )
            if lags.focus is not None:
                vergence.append(1 / _distance(scene))
                camera = replace(
                    camera, optics=replace(camera.optics, object_distance=1 / vergence[-1])
                )
            if lags.exposure is not None or lags.white is not None:
                program = (
                    simulator.update(camera).program(scene)
                    if program is None
                    else program.update(scene=scene, camera=camera)
                )
                exposure = program.exposure
                seconds.append(log(exposure.exposure_time * exposure.gain))
                if lags.white is not None:
                    values = program.shots.linear(program.raw(seed=seed, frame=number))[1].neutral
                    white.append(np.log(np.maximum(values, 1e-6)))
            seen()
    return Loops(
        None if lags.exposure is None else np.exp(follow(seconds, lags.exposure, period)).tolist(),
        None if lags.white is None else np.exp(follow(white, lags.white, period)).tolist(),
        None if lags.focus is None else (1 / follow(vergence, lags.focus, period)).tolist(),
    )


def _distance(scene):
    """Of what is in the middle third of a scene [m]."""
    if scene.depth is None:
        raise BadData(
            f"{scene.name}: no depth, so that a loop of focus has nothing to follow; wanted scene.depth [m]"
        )
    middle = tuple(slice(n // 3, n - n // 3) for n in scene.depth.shape)
    return float(np.median(scene.depth[middle]))

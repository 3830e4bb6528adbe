"""Control loops of a camera in a video: exposure, white balance and focus follow the scene.

Their settings are computed before the frames, in a pass over all scenes that takes one picture of
each. They are stored in the video's manifest, where shards and resumed runs read them.
"""

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, fields, replace
from math import exp, isfinite, log
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.apps.video.manifest import LARGEST
from gpusim.apps.video.named import read_named
from gpusim.apps.video.pipeline import ahead
from gpusim.apps.video.ramps import Ramps
from gpusim.apps.video.scenes import Scenes
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, Conflict, GpusimError
from gpusim.domain.processor import WHITE_BALANCES
from gpusim.io.files import read_text
from gpusim.optics.lenses import lens_of
from gpusim.pipeline.simulator import Simulator

SLOWEST = 1e4  # [s]
READ = 2  # scenes that are read ahead


@dataclass(frozen=True)
class Lags:
    """Time constants of a camera's control loops [s]; None: no such loop.

    After one time constant a loop has followed 63 % of a step, 1 - exp(-t / lag); with 0 it follows
    in the next frame.

    Attributes:
        exposure: Automatic exposure; the loop works in stops.
        white: White balance that the processor estimates; the loop works in logarithms.
        focus: Focus on the middle third of a scene with depth, as phase-detection sensors measure
            it without a search; the loop works in dioptres.
    """

    exposure: float | None = None
    white: float | None = None
    focus: float | None = None

    @classmethod
    def parse(cls, text: str) -> "Lags":
        """Return the lags of `exposure=0.3,white=1,focus=0.4`. Raises ArgumentTypeError."""
        names = [part.name for part in fields(cls)]

        def read(name, text):
            lag = float(text)
            if name not in names or not (isfinite(lag) and 0 <= lag <= SLOWEST):
                raise ValueError
            return lag

        wanted = f"NAME=SECONDS, 0 .. {SLOWEST:g}, each NAME once: {', '.join(names)}"
        return cls(**read_named(text, read, wanted))

    def check(self, camera: Camera, ramps: Ramps):
        """Raise Conflict if a loop has no effect, because its setting is given or fixed."""
        ramped = [name for name, _ in ramps.ranges]
        is_set = camera.sensor.exposure_time is not None or "exposure" in ramped
        if self.exposure is not None and is_set:
            remedy = "use --exposure auto and no ramp of it"
            raise Conflict("--lag exposure", "the exposure time is set", remedy)
        if self.focus is not None and "focus" in ramped:
            raise Conflict("--lag focus", "--ramp focus sets the focus", "give only one of them")
        if self.focus is not None and not lens_of(camera).is_adjustable:
            reason = "measured point spread functions have one focus"
            raise Conflict("--lag focus", reason, "use a camera without [optics] psf")
        if self.white is not None and not camera.processor.estimates_white:
            estimates = [
                name for name in WHITE_BALANCES if name not in ("illuminant", "preset", "none")
            ]
            remedy = f"set white_balance or --white-balance to one of {', '.join(estimates)}"
            raise Conflict("--lag white", "the processor does not estimate the white", remedy)


@dataclass(frozen=True)
class Loops:
    """Settings of the loops for every frame, each a list or None.

    Attributes:
        seconds: Exposure time times analog gain [s].
        white: Camera values of white.
        focus: Distance of the plane in focus [m].
    """

    seconds: list[float] | None = None
    white: list[list[float]] | None = None
    focus: list[float] | None = None

    @classmethod
    def read_manifest(cls, manifest: Path, lags: Lags, count: int) -> "Loops | None":
        """Return the loops of a manifest, or None if it has none for these lags and `count` frames.

        Other errors of the manifest are found when the run checks it.
        """
        try:
            text = read_text(manifest, "a manifest of a video", LARGEST)
            found = cls(**json.loads(text)["loops"])
            for lag, values, axes in (
                (lags.exposure, found.seconds, 1),
                (lags.white, found.white, 2),
                (lags.focus, found.focus, 1),
            ):
                if (lag is None) != (values is None):
                    return None
                array = np.ones((count, 1)[:axes]) if values is None else np.array(values, float)
                is_sound = array.ndim == axes and len(array) == count
                if not (is_sound and ((array > 0) & (array < np.inf)).all()):
                    return None
        except (GpusimError, ValueError, LookupError, TypeError, OverflowError, RecursionError):
            return None
        return found

    def camera(self, camera: Camera, number: int) -> Camera:
        """Return the camera of a frame."""
        if self.focus is self.white is None:
            return camera
        optics, processor = camera.optics, camera.processor
        if self.focus is not None:
            optics = replace(optics, object_distance=self.focus[number])
        if self.white is not None:
            processor = replace(processor, white_balance="preset", white=tuple(self.white[number]))
        return replace(camera, optics=optics, processor=processor)

    def operation(self, camera: Camera, number: int) -> dict[str, Any]:
        """Return exposure time [s] and analog gain for `Loop.update`; empty if a frame meters."""
        if self.seconds is None:
            return {}
        total, longest = self.seconds[number], camera.sensor.auto_exposure.longest
        time = total if longest is None else min(total, longest)
        return {"exposure_time": time, "gain": total / time}


NO_LOOPS = Loops()


def follow(targets, lag: float, period: float) -> np.ndarray:
    """Return the settings of a loop for every frame.

    The loop starts at its first target, and sees a frame before it sets the next one.

    Args:
        targets: Ideal setting of every frame, shape (n, ...).
        lag: Time constant of the loop [s].
        period: Time between frames [s].

    Returns:
        The settings, shape (n, ...), float64.
    """
    targets = np.asarray(targets, np.float64)
    part = 1.0 if lag == 0 else 1 - exp(-period / lag)
    found = targets.copy()
    for before, number in enumerate(range(1, len(targets))):
        found[number] = found[before] + part * (targets[before] - found[before])
    return found


def meter_scenes(
    simulator: Simulator,
    scenes: Scenes,
    lags: Lags,
    ramps: Ramps,
    period: float,
    *,
    seed: int = 0,
    seen: Callable[[], Any] = int,
) -> Loops:
    """Return the settings of the loops for the light, colours and distances of all scenes.

    Args:
        simulator: Camera and device.
        scenes: Scenes of all frames.
        lags: Time constants of the loops.
        ramps: Settings that change over the video.
        period: Time between frames [s].
        seed: Seed of the noise of the metered pictures.
        seen: Function that is called after each scene.

    Raises:
        BadData: If the focus follows a scene without depth.
        GpusimError: As frames of the scenes do.
    """
    loop: Any = None
    last = max(scenes.count - 1, 1)
    seconds: list[float] = []
    white: list[Any] = []
    vergence: list[float] = []
    with closing(ahead(scenes.between(0, scenes.count), READ)) as arriving:
        for number, shown in enumerate(arriving):
            scene = ramps.scene(shown, number / last)
            camera = ramps.camera(simulator.camera, number / last)
            if lags.focus is not None:
                vergence.append(1 / _distance(scene))
                optics = replace(camera.optics, object_distance=1 / vergence[-1])
                camera = replace(camera, optics=optics)
            if lags.exposure is not None or lags.white is not None:
                if loop is None:
                    loop = simulator.update(camera).loop(scene)
                else:
                    loop.update(scene=scene, camera=camera)
                exposure = loop.exposure
                seconds.append(log(exposure.exposure_time * exposure.gain))
                if lags.white is not None:
                    values = loop.linear(seed=seed, first=number)[1].neutral
                    white.append(np.log(np.maximum(values, 1e-6)))
            seen()
    return Loops(
        None if lags.exposure is None else np.exp(follow(seconds, lags.exposure, period)).tolist(),
        None if lags.white is None else np.exp(follow(white, lags.white, period)).tolist(),
        None if lags.focus is None else (1 / follow(vergence, lags.focus, period)).tolist(),
    )


def _distance(scene):
    """Return the median distance of the middle third of a scene [m]."""
    if scene.depth is None:
        why = f"{scene.name}: a loop of focus needs scene.depth [m], which this scene does not have"
        raise BadData(why)
    middle = tuple(slice(n // 3, n - n // 3) for n in scene.depth.shape)
    return float(np.median(scene.depth[middle]))

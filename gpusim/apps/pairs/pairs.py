"""Noisy frames of photographs, and the same frames without noise."""

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from copy import copy
from pathlib import Path

import numpy as np

from gpusim.apps.pairs.shards import npy
from gpusim.apps.pairs.variety import Variety
from gpusim.apps.video.pipeline import ahead
from gpusim.captures.capture import Capture, Light
from gpusim.color.speed import gain_for_speed
from gpusim.domain.camera import Camera
from gpusim.domain.scene import Scene
from gpusim.io.frame.frames import named_labels
from gpusim.io.frame.images import png_bytes
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan

READ = 2  # photographs that are opened ahead


class Pairs:
    """Noisy and clean frames of photographs.

    Each pair depends only on its photograph, its number and the seed, whichever others the run
    makes.

    Args:
        simulator: Camera and device.
        photographs: Files of the photographs.
        opened: Function from a path and the drawn values to a scene.
        variety: Settings that are drawn for each pair.
        each: Pairs per photograph.
        seed: Seed of the noise and of the variety.
        pictures: Whether pairs have display codes.
        plan: Plan of all pairs, see `Simulator`. None: each pair has its own.
        capture: Capture of each pair. The frames of a capture that is not merged are on a first
            axis.
    """

    def __init__(
        self,
        simulator: Simulator,
        photographs: list[Path],
        opened: Callable[[Path, dict], Scene],
        variety: Variety,
        each: int = 1,
        seed: int = 0,
        pictures: bool = False,
        plan: Plan | None = None,
        capture: Capture | None = None,
    ):
        self._capture = capture
        self._simulator, self._photographs, self._opened = simulator, photographs, opened
        self._variety, self._each, self._seed = variety, each, seed
        self._pictures, self._plan = pictures, plan

    def __len__(self):
        return self._each * len(self._photographs)

    def on(self, simulator: Simulator) -> "Pairs":
        """Return the same pairs, made by a simulator on another device."""
        other = copy(self)
        other._simulator = simulator
        return other

    def files(self, numbers: Iterable[int]) -> Iterator[tuple[str, dict[str, bytes]]]:
        """Yield key and files by suffix of each pair; see `gpusim pairs --help`.

        Raises as `Simulator.frames` does.
        """
        with closing(ahead(map(self._read, numbers), READ)) as arriving:
            for number, scene, values in arriving:
                yield f"{number:08d}", self._files(number, scene, values)

    def _read(self, number):
        values = self._variety.draw(self._seed, number)
        return number, self._opened(self._photographs[number // self._each], values), values

    def pair(self, number: int) -> dict:
        """Return raw values, clean values, codes (with pictures), a record of the settings, and labels."""
        return self._pair(*self._read(number))

    def _files(self, number, scene, values):
        pair = self._pair(number, scene, values)
        files = {"raw.npy": npy(pair["raw"]), "clean.npy": npy(pair["clean"])}
        if "rgb" in pair:
            shown = pair["rgb"]
            if shown.ndim == 4:  # the frames of a capture, one below the other
                shown = shown.reshape(-1, *shown.shape[2:])
            files["rgb.png"] = png_bytes(shown, self._simulator.camera.display)
        files |= {f"{name}.npy": npy(label) for name, label in named_labels(pair["labels"]).items()}
        return files | {"json": (json.dumps(pair["record"], sort_keys=True) + "\n").encode()}

    def _pair(self, number, scene, values):
        simulator = self._simulator
        gain = gain_of(simulator.camera, values.get("iso"))
        if self._capture is not None:
            return self._capture_pair(number, scene, values, gain)
        loop = simulator.loop(scene, values.get("exposure"), gain, plan=self._plan)
        exposure, account = loop.exposure, loop.account
        raw = np.array(simulator.device.numpy(loop.raw(seed=self._seed, first=number)))
        sensor = exposure.camera.sensor
        light = loop.values["mean of pixels"] * np.float32(sensor.gain_dn_per_electron)
        pair = {"raw": exposure.split_layers(raw), "clean": light + np.float32(sensor.dark_level)}
        if self._pictures:
            codes = loop.codes(seed=self._seed, first=number)
            pair["rgb"] = np.array(simulator.device.numpy(codes))
        record = self._record(number, values, exposure, sensor, account)
        return pair | {"record": record, "labels": exposure.labels}

    def _capture_pair(self, number, scene, values, gain):
        """Return the pair of a capture."""
        simulator, capture = self._simulator, self._capture
        first = number * capture.count
        seconds = values.get("exposure")
        light = Light(capture, simulator, scene, first, seconds, gain, self._plan)
        shots = capture.shots(light, self._seed, first)
        frames = capture.frames(simulator, shots)
        cleans = []
        for frame, shot in zip(frames, shots, strict=False):
            sensor, own = frame.camera.sensor, shot.exposure
            mean = own.values()["mean of pixels"] * np.float32(
                frame.exposure_time / own.exposure_time if capture.merged else 1.0
            )
            scale = np.float32(sensor.gain_dn_per_electron)
            cleans.append(mean * scale + np.float32(sensor.dark_level))
        parts = {"raw": [frame.raw for frame in frames], "clean": cleans}
        if self._pictures:
            parts["rgb"] = [frame.rgb for frame in frames]
        is_one = capture.merged or not capture.has_frames
        pair = {name: part[0] if is_one else np.stack(part) for name, part in parts.items()}
        plan, exposure = shots[0].exposure.plan, shots[0].exposure
        account = plan.account.at(exposure.exposure_time)
        record = self._record(number, values, exposure, frames[0].camera.sensor, account)
        times = [frame.exposure_time for frame in frames]
        return pair | {
            "labels": exposure.labels,
            "record": record
            | {
                "frame": first,
                "exposure_time_s": times[0] if is_one else times,
                "capture": str(capture),
            },
        }

    def _record(self, number, values, exposure, sensor, account):
        """Return the settings of a pair."""
        simulator = self._simulator
        record = {
            "photograph": self._photographs[number // self._each].name,
            "camera": simulator.camera.name,
            "seed": self._seed,
            "frame": number,
            **values,
            "exposure_time_s": exposure.exposure_time,
            "gain": exposure.gain,
            "black_level": float(sensor.dark_level),
            "white_level": float(sensor.white_level),
            "gain_dn_per_e": float(sensor.gain_dn_per_electron),
            "read_noise_e": float(sensor.read_sigma),
            "cfa": list(sensor.cfa),
            "plan": exposure.plan.name,
            "predicted_rms": account.total.rms,
        }
        if simulator.tolerance is not None:
            record["verdict"] = account.verdict(simulator.tolerance).as_dict()
        return record


def gain_of(camera: Camera, speed: float | None) -> float:
    """Return the analog gain, in addition to the sensor's, for an ISO speed; 1 for None.

    Raises OutOfRange.
    """
    sensor = camera.sensor
    return 1.0 if speed is None else gain_for_speed(sensor, speed) / sensor.analog_gain

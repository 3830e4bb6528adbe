"""Noisy frames of photographs, and the light that they are of."""

import json
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np

from gpusim.apps.pairs.shards import npy
from gpusim.apps.pairs.variety import Variety
from gpusim.apps.video.pipeline import ahead
from gpusim.color.speed import gain_for_speed
from gpusim.domain.camera import Camera
from gpusim.domain.scene import Scene
from gpusim.io.frame.images import png_bytes
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan

READ = 2  # photographs that are opened before they are needed


class Pairs:
    """Pairs of photographs before a camera, `each` of every photograph.

    opened: the scene of a path and of what was drawn for it ("light", "luminance"). Each pair is made of its own
    photograph, numbers and noise alone: which others are made by the same run does not matter. plan: of all pairs, see
    `Simulator`; without it each has its own, whose name is told.
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
    ):
        self._simulator, self._photographs, self._opened = simulator, photographs, opened
        self._variety, self._each, self._seed, self._pictures, self._plan = (
            variety,
            each,
            seed,
            pictures,
            plan,
        )

    def __len__(self):
        return self._each * len(self._photographs)

    def made(self, numbers: range) -> Iterator[tuple[str, dict[str, bytes]]]:
        """Key and files of pairs, by suffix: see `gpusim pairs --help`. Raises what `Simulator.frames` does."""
        with closing(ahead(map(self._read, numbers), READ)) as arriving:
            for number, scene, values in arriving:
                yield f"{number:08d}", self._files(number, scene, values)

    def _read(self, number):
        values = self._variety.drawn(self._seed, number)
        return number, self._opened(self._photographs[number // self._each], values), values

    def pair(self, number: int) -> dict:
        """Raw values, the light that they are of, codes if there are pictures, and what is told of them."""
        return self._pair(*self._read(number))

    def _files(self, number, scene, values):
        pair = self._pair(number, scene, values)
        files = {"raw.npy": npy(pair["raw"]), "clean.npy": npy(pair["clean"])}
        if "rgb" in pair:
            files["rgb.png"] = png_bytes(pair["rgb"], self._simulator.camera.display)
        return files | {"json": (json.dumps(pair["told"], sort_keys=True) + "\n").encode()}

    def _pair(self, number, scene, values):
        simulator = self._simulator
        gain = gain_of(simulator.camera, values.get("iso"))
        program = simulator.program(scene, values.get("exposure"), gain, plan=self._plan)
        exposure, account = program.exposure, program.account
        raw = np.array(simulator.device.numpy(program.raw(seed=self._seed, frame=number)))
        sensor = exposure.camera.sensor
        light = program.shots.mean_of_pixels() * np.float32(sensor.gain_dn_per_electron)
        pair = {"raw": exposure.layered(raw), "clean": light + np.float32(sensor.dark_level)}
        if self._pictures:
            pair["rgb"] = np.array(
                simulator.device.numpy(program.codes(seed=self._seed, frame=number))
            )
        told = {
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
            told["verdict"] = account.verdict(simulator.tolerance).as_dict()
        return pair | {"told": told}


def gain_of(camera: Camera, speed: float | None) -> float:
    """Analog gain beside the sensor's for a speed, 1 for None. Raises OutOfRange below the base speed."""
    return (
        1.0 if speed is None else gain_for_speed(camera.sensor, speed) / camera.sensor.analog_gain
    )

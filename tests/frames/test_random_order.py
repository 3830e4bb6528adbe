"""Whatever was computed before, in whatever order: every result is that of a new Simulator, bit for bit."""

import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from cameras import camera_with
from devices import ALL_KINDS, KINDS

import gpusim as gs
from gpusim.domain.errors import GpusimError

ROWS, COLS = 30, 44
FEW, TURNS, MORE = 4, 30, 200
OUTPUTS = ("electrons", "mean", "chip_mean", "raw", "camera", "linear", "xyz", "codes")
BATCHES = {"raw": 3, "codes": 2, "mean": 2}  # frames a call
PARTS = ("mean", "raw", "linear", "rgb")
TIMES, GAINS = (0.01, 0.02, None), (1.0, 2.0)


def cameras():
    """Several that differ in one thing each: all give frames of one size, as batches want them."""
    base = camera_with(
        gs.open_camera("phone"),
        noise={
            "prnu": 0.01,
            "dsnu": 1.0,
            "read": 2.0,
            "row": 0.5,
            "telegraph_pixels": 0.01,
            "telegraph": 9.0,
        },
    )
    changes = (
        {},
        {"processor": {"tone": ((0.0, 0.0), (0.3, 0.5), (1.0, 1.0))}},
        {"processor": {"demosaic": "malvar"}},
        {"processor": {"white_balance": "gray-world"}},
        {"processor": {"denoise": 1.0, "shading": True}},
        {"noise": {"seed": 5}},
        {"noise": {"read": 9.0}},
        {"sensor": {"exposure_time": 0.015}},
        {"sensor": {"analog_gain": 2.0}},
        {"optics": {"f_number": 4.0}},
        {"noise": {"hot_pixels": 0.01, "hot_current": 900.0}, "processor": {"defects": "known"}},
        {"sensor": {"bits": 12}},
        {"noise": {"photon": "none"}},
        {"noise": {"photon": "fast"}},
        {"sensor": {"cfa": ("BG", "GR"), "channels": ("B", "G", "R")}},
    )
    return [camera_with(base, **change) for change in changes]


def scenes():
    """Of all forms: cubes and pictures in pairs, which one plan serves."""
    chart, random = gs.chart("deadleaves", size=(COLS, ROWS)), np.random.default_rng(3)
    bands = chart.content.bands_at(slice(None)).astype(np.float32)
    codes = random.integers(0, 256, (ROWS, COLS, 3), np.uint8)
    depth = np.tile(np.linspace(0.3, 2.0, COLS), (ROWS, 1)).astype(np.float32)
    return [
        *(
            replace(
                chart,
                content=gs.Cube(chart.wavelengths, bands * np.float32(scale)),
                name=f"cube {scale}",
            )
            for scale in (1, 0.5)
        ),
        replace(
            chart, content=gs.Cube(chart.wavelengths, (bands / 2).astype(np.float16)), name="halves"
        ),
        chart,
        gs.chart("colorchecker", size=(COLS, ROWS)),
        replace(chart, depth=depth, name="deep"),
        gs.picture(codes),
        gs.picture(codes[::-1]),
        gs.picture(codes[..., 0], light="A"),
        gs.picture(codes.astype(np.uint16) * 200),
    ]


class Loop:
    """What one user does with one Simulator: each step is checked, and what it gives is kept for later ones."""

    def __init__(self, device, seed):
        self.random, self.device, self.fresh = np.random.default_rng(seed), device, {}
        self.cameras, self.scenes = self.some(cameras()), self.some(scenes())
        self.simulator = gs.Simulator(self.cameras[0], device=device)
        self.loop, self.setting = None, None
        self.batches = {
            output: self.simulator.batch(count, output) for output, count in BATCHES.items()
        }
        self.kept, self.exposures, self.done = [], [], []

    def one(self, values):
        return values[self.random.integers(len(values))]

    def some(self, values):
        """A few, so that they come back."""
        return [values[place] for place in self.random.choice(len(values), FEW, replace=False)]

    def any_setting(self):
        """Camera, scene, exposure time [s] and gain."""
        return self.one(self.cameras), self.one(self.scenes), self.one(TIMES), self.one(GAINS)

    def host(self, array):
        return np.array(self.simulator.device.numpy(array))

    def wanted(self, output, setting, seed=0, frame=0):
        """What a new Simulator and Loop give."""
        camera, scene, seconds, gain = setting
        key = output, id(camera), id(scene), seconds, gain, seed, frame
        if key not in self.fresh:
            simulator = gs.Simulator(camera, device=self.device)
            self.fresh[key] = self.host(
                simulator.loop(scene, seconds, gain).output(output, seed=seed, first=frame)
            )
        return self.fresh[key]

    def require(self, found, output, setting, seed=0, frame=0):
        wanted = self.wanted(output, setting, seed, frame).astype(
            found.dtype
        )  # frames' means are float32
        np.testing.assert_array_equal(
            found, wanted, f"{output} of {setting[1].name}, steps: {self.done}"
        )

    def update(self):
        setting, seed, frame = (
            self.any_setting(),
            int(self.random.integers(2)),
            int(self.random.integers(2)),
        )
        if self.loop is None:
            self.setting = setting
            self.loop = self.simulator.update(setting[0]).loop(*setting[1:])
        else:  # some of it
            names = ("camera", "scene", "exposure_time", "gain")
            changed = {
                name: value
                for name, value in zip(names, setting, strict=True)
                if self.random.random() < 0.4
            }
            self.loop.update(**changed)
            self.setting = tuple(
                changed.get(name, old) for name, old in zip(names, self.setting, strict=True)
            )
        if self.random.random() < 0.3:
            self.keep(self.loop.frame(seed=seed, first=frame), self.setting, seed, frame)
        else:
            output = self.one(OUTPUTS)
            self.require(
                self.host(self.loop.output(output, seed=seed, first=frame)),
                output,
                self.setting,
                seed,
                frame,
            )

    def batch(self):
        output = self.one([*BATCHES])
        count, first = BATCHES[output], int(self.random.integers(2))
        settings = [self.any_setting() for _ in range(count)]
        if self.random.random() < 0.5:  # one camera for all
            settings = [(settings[0][0], *rest) for _, *rest in settings]
        seeds = [int(seed) for seed in self.random.integers(0, 2, count)]
        lists = dict(
            zip(
                ("camera", "scenes", "exposure_time", "gain"),
                zip(*settings, strict=True),
                strict=True,
            )
        )
        found = self.host(self.batches[output](**lists, seed=seeds, first=first))
        for item, setting in enumerate(settings):
            self.require(found[item], output, setting, seeds[item], first + item)

    def expose(self):
        setting, seed = self.any_setting(), int(self.random.integers(2))
        simulator = self.simulator.update(setting[0])
        exposure = simulator.expose(*setting[1:])
        self.exposures = [*self.exposures[-2:], (exposure, setting)]
        self.keep(exposure.frame(seed=seed), setting, seed, 0)

    def draw(self):
        """Frames of exposures that were made before, in turns."""
        for _ in range(3 if self.exposures else 0):
            exposure, setting = self.one(self.exposures)
            seed, frame = int(self.random.integers(3)), int(self.random.integers(3))
            raw = exposure.raw(seed=seed, first=frame)
            self.require(self.host(raw), "raw", setting, seed, frame)
            self.require(self.host(exposure.codes(raw)), "codes", setting, seed, frame)

    def stream(self):
        camera, _, seconds, gain = self.any_setting()
        chosen = [self.one(self.scenes) for _ in range(3)]
        frames = self.simulator.update(camera).stream(
            chosen, "raw", exposure_time=seconds, gain=gain, meters_late=False
        )
        for number, (scene, found) in enumerate(zip(chosen, frames, strict=True)):
            self.require(self.host(found), "raw", (camera, scene, seconds, gain), 0, number)

    def mistake(self):
        """What is refused, somewhere in the middle."""
        wrong = self.one(
            [
                lambda: self.batches["raw"](self.scenes[:3], exposure_time=[0.01, -1.0, 0.01]),
                lambda: self.batches["raw"](self.scenes[:3], seed=[0, 0, -1]),
                lambda: self.batches["codes"]([self.scenes[0], 3]),
                lambda: (self.loop or self.simulator.loop(self.scenes[0])).update(gain=-1.0),
                lambda: (self.loop or self.simulator.loop(self.scenes[0])).codes(seed=-1),
                lambda: self.simulator.expose(self.scenes[0]).raw(first=-1),
            ]
        )
        with pytest.raises(GpusimError):
            wrong()

    def keep(self, frame, setting, seed, number):
        """Some are looked at now, the others later, some from their pickles."""
        if self.random.random() < 0.3:
            frame = pickle.loads(pickle.dumps(frame))
        self.kept.append(partial(self.look, frame, setting, seed, number))
        if self.random.random() < 0.5:
            self.kept.pop(self.random.integers(len(self.kept)))()

    def look(self, frame, setting, seed, number):
        for part in self.random.permutation(PARTS):
            found = getattr(frame, part)
            if part == "linear":
                found = np.moveaxis(found, -1, 0)  # as on the device
            self.require(found, {"rgb": "codes"}.get(part, part), setting, seed, number)

    def run(self, turns):
        for _ in range(turns):
            step = self.one(
                (
                    self.update,
                    self.update,
                    self.update,
                    self.batch,
                    self.batch,
                    self.expose,
                    self.draw,
                    self.stream,
                    self.mistake,
                )
            )
            self.done = [*self.done[-5:], step.__name__]
            step()
        for look in self.kept:
            look()


@pytest.mark.parametrize("device", [pytest.param("numpy", marks=pytest.mark.slow), *KINDS])
def test_every_result_is_that_of_a_new_simulator(device):
    Loop(device, 1).run(TURNS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3])
@pytest.mark.parametrize("device", ALL_KINDS)
def test_every_result_is_that_of_a_new_simulator_for_long(device, seed):
    Loop(device, seed).run(MORE)

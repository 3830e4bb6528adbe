"""Random numbers: cases 19 to 23."""

import os
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np

from gpusim.backends import open_device
from gpusim.domain.noise import Noise
from gpusim.io.camera.cameras import open_camera
from gpusim.judge.hard.acceptance import ALPHA, p_values, suite
from gpusim.judge.hard.case import Found, case
from gpusim.judge.hard.maps import MAPS, probabilities
from gpusim.kernels.sensor.noise import noise
from gpusim.pipeline.readout import Readout

f32 = np.float32
MEANS = [0, 1e-8, 1e-3, 0.5, 5, 19.9, 20.1, 87, 88, 104, 1e3, 1e5, 1e7, 2.0**24 + 1]
IDEAL = {"full_well": np.inf, "gain": 1.0, "white_level": 65535}
SENSOR = replace(
    open_camera("mono").sensor,
    bits=16,
    full_well=1e5,
    gain=0.5,
    analog_gain=4.0,
    analog_offset=50.0,
    black_level=400,
    noise=Noise(),
)
WITHOUT_CONVERTER = replace(
    SENSOR, bits=32, full_well=1e9, gain=1.0, analog_gain=1.0, analog_offset=0.0, black_level=0
)
CHIP = Noise(
    dark_current=3.0,
    read=2.0,
    row=0.3,
    column=0.2,
    prnu=0.02,
    row_prnu=0.01,
    dsnu=1.0,
    hot_pixels=0.01,
    hot_current=30.0,
    dead_pixels=0.01,
    telegraph_pixels=0.1,
    telegraph=10.0,
    telegraph_switching=0.3,
    seed=4,
)


def electrons(mean, device, **changed) -> np.ndarray:
    """Return the result of the stage `sensor.noise` without a converter."""
    return noise(np.asarray(mean, f32), **{**IDEAL, **changed}, electrons=True, device=device)


def everything(rows, cols, photon) -> dict:
    """Return inputs of the stage with all kinds of noise at once.

    The means go from rare photons to 1e8 e-, in random order.
    """
    random = np.random.default_rng(3)
    return {
        "expected": (10.0 ** random.uniform(-4, 8, (rows, cols))).astype(f32),
        "offset": random.normal(0, 1, (rows, cols)).astype(f32),
        "amplitude": np.maximum(random.normal(-5, 10, (rows, cols)), 0).astype(f32),
        "dark_electrons": 1e-3,
        "read_noise": 2.0,
        "row_noise": 0.3,
        "column_noise": 0.2,
        "telegraph_switching": 0.3,
        "full_well": 1e8,
        "gain": 0.5,
        "black_level": 64.0,
        "white_level": 65535,
        "photon": photon,
        "seed": 2**40 + 3,
        "frame": 9,
        "electrons": photon == "exact",
    }  # one of them with, one without a converter


def kinds(device) -> list[str]:
    """Return the photon samplers that the device supports."""
    return ["fast", "exact"] if device.has_fp64 else ["fast"]


def poisson(device, photon, mean, size, statistics=suite) -> Found:
    """Return ALPHA over the least p-value of size x size counts; correct is below 1."""
    plane = np.full((size, size), mean, f32)

    def draw(seed=1, frame=0):
        return electrons(plane, device, photon=photon, seed=seed, frame=frame)

    p = statistics(draw, float(f32(mean)))
    name = min(p, key=lambda one: p[one] if p[one] == p[one] else -1.0)
    words = f"1e-6 over the least p-value, {photon}, mean {mean:g}, {name}"
    return Found(ALPHA / max(p[name], 1e-300), 1.0, words)


def unlike_reference(device, photon, mean) -> Found:
    """Return the number of counts that differ from the reference; none may."""
    found, wanted = (
        electrons(mean, one, photon=photon, seed=5) for one in (device, open_device("numpy"))
    )
    count = int(np.count_nonzero(found != wanted))
    return Found(count, 0, "counts that are not the reference's")


@case(
    19,
    "Poisson numbers",
    "means 0 .. 2^24 + 1, n = 2^22: all p-values >= 1e-6; one photon at 1e-8 within 1 %",
)
def poisson_numbers(device):
    """The suite runs on 2^22 counts of the default sampler and on 2^18 of the exact one.

    P at 1e-8 is from the map of the reference, as the device has the same bits.
    """
    for photon in kinds(device):
        size = 2**11 if photon == "fast" else 2**9
        tried = [poisson(device, photon, mean, size) for mean in MEANS]
        yield max(tried, key=lambda one: one.got)
        rare = probabilities(1e-8, photon)[1][1:].sum() / -np.expm1(-float(f32(1e-8)))
        yield Found(abs(rare - 1), 1e-2, f"P(photon) at 1e-8, {photon}")
        means = np.geomspace(1e-8, 1e-2, 2**16).reshape(256, 256)
        yield unlike_reference(device, photon, means)


IMPOSSIBLE = [np.nan, np.inf, -np.inf, -1.0, -1e-6]


def with_impossible(mean):
    """Return the means with impossible ones in every second place of the second row.

    Also returns a mask of the other places.
    """
    mean, good = np.array(mean, f32), np.ones(np.shape(mean), bool)
    mean[1, 1:11:2], good[1, 1:11:2] = IMPOSSIBLE, False
    return mean, good


@case(
    20,
    "impossible means",
    "NaN, +-infinity, -1e-6, -1: as documented (NaN, full well, 0, 0, 0; DN 0, white), "
    "neighbours unchanged",
)
def impossible_means(device):
    wrong = 0
    for photon in kinds(device):
        inputs = everything(4, 12, photon) | {"electrons": False}
        plain, settings = np.full((4, 12), 20.0), {"full_well": 1e4, "photon": photon}
        mean, good = with_impossible(plain)
        e = electrons(mean, device, **settings)
        wrong += np.count_nonzero(
            ~np.isclose(e[~good], [np.nan, 1e4, 0, 0, 0], rtol=0, atol=0, equal_nan=True)
        )
        wrong += np.count_nonzero(e[good] != electrons(plain, device, **settings)[good])
        bad, good = with_impossible(inputs["expected"])
        dn = noise(**inputs | {"expected": bad}, device=device)
        wrong += (dn[~good][0] != 0) + (dn[~good][1] != 65535)
        wrong += np.count_nonzero(dn[good] != noise(**inputs, device=device)[good])
    yield Found(wrong, 0, "pixels that are not as documented")


@cache
def steps(photon):
    """Return the largest step of mean [sigma] and dispersion across the sampler's switch point.

    The ramp has 41 means.
    """
    switch, errors = MAPS[photon][2], []
    # the switch itself is one of them
    for mean in f32(switch + np.linspace(-0.5, 0.5, 41)).astype(np.float64):
        k, p = probabilities(mean, photon)
        found = (k * p).sum()
        errors.append((found / mean**0.5 - mean**0.5, ((k - found) ** 2 * p).sum() / mean - 1))
    return float(np.abs(np.diff(errors, axis=0)).max())


@case(21, "ramp across switch points", "no step > 3e-4 sigma in mean and dispersion")
def ramp(device):
    """The maps of the samplers are exact, not statistics, and the device has the same bits."""
    for photon in kinds(device):
        plane = np.tile(MAPS[photon][2] + np.linspace(-0.5, 0.5, 256), (128, 1))
        yield Found(steps(photon), 3e-4, f"largest step, {photon}")
        yield unlike_reference(device, photon, plane)


@case(
    22,
    "seeds",
    "the same bits for any tile, device, order and batch; frames and channels |rho| < 5 / sqrt(n)",
)
def seeds(device):
    wrong = 0
    for photon in kinds(device):
        inputs = everything(130, 301, photon)
        frame = noise(**inputs, device=open_device("numpy"))
        wrong += np.count_nonzero(noise(**inputs, device=device) != frame)
        for part in np.s_[:1, :], np.s_[1:, :7], np.s_[1:, 7:201], np.s_[1:, 201:]:
            top, left = part[0].start or 0, part[1].start or 0
            planes = {name: inputs[name][part] for name in ("expected", "offset", "amplitude")}
            tile = noise(**{**inputs, **planes}, first=(top, left), frame_cols=301, device=device)
            wrong += np.count_nonzero(tile != frame[part])
    mean, drawn = everything(61, 131, "fast")["expected"], []
    for one in (device, open_device("numpy")):
        readout = Readout(replace(SENSOR, noise=CHIP), one)
        expected = readout.chip_mean(one.array(mean), 0.5)
        drawn.append(np.array(one.numpy(readout.draw(expected, 0.5, seed=7, first=20, frames=3))))
        backwards = [
            np.array(one.numpy(readout.draw(expected, 0.5, seed=7, first=frame)))
            for frame in (22, 21, 20)
        ]
        wrong += np.count_nonzero(drawn[-1] != np.stack(backwards[::-1]))
    wrong += np.count_nonzero(drawn[0] != drawn[1])
    yield Found(wrong, 0, "pixels that differ")
    yield _correlation(device)


def _correlation(device):
    """Return the largest correlation between the pixels of two frames and four channels."""
    readout = Readout(replace(WITHOUT_CONVERTER, noise=Noise(read=2.0)), device)
    mean = device.array(np.full((1024, 1024), 30.0, f32))
    x = device.numpy(readout.draw(mean, 1.0, seed=3, frames=2)).astype(np.float64)
    planes = [frame[i::2, j::2].ravel() for frame in x for i in (0, 1) for j in (0, 1)]
    rho = max(abs(np.corrcoef(one, other)[0, 1]) for one, other in combinations(planes, 2))
    return Found(rho, 5 / np.sqrt(planes[0].size), "correlation of frames and channels")


RELAXED = "-cl-denorms-are-zero -cl-fast-relaxed-math"


@contextmanager
def open_relaxed(device):
    """Yield a second device that builds programs without denormals and with fast mathematics.

    It is None for NumPy, and for Warp, whose noise kernels set their compiler options.
    """
    if device.kind != "opencl":
        yield None
        return
    before = os.environ.get("PYOPENCL_BUILD_OPTIONS")
    os.environ["PYOPENCL_BUILD_OPTIONS"] = RELAXED  # pyopencl adds them to every build
    try:
        yield type(device)(device.cl_device, f"{device.name}, relaxed")
    finally:
        if before is None:
            del os.environ["PYOPENCL_BUILD_OPTIONS"]
        else:
            os.environ["PYOPENCL_BUILD_OPTIONS"] = before


@case(23, "fast mathematics", "flush to zero and fast math on and off: the suite passes on both")
def fast_mathematics(device):
    """exp(-m) is denormal from 88 on and 0 from 104.

    Means of 1e-40 and 1e-37 are, or are close to, denormal numbers.
    """

    def of(one, words):
        found = []
        for photon in kinds(one):
            for mean in (1e-3, 0.5, 9, 24, 87, 88, 104, 1e4):
                tried = poisson(one, photon, mean, 2**9, lambda draw, m: p_values(draw(), m))
                found.append(tried._replace(words=f"{tried.words}, {words}"))
            dark = sum(
                np.count_nonzero(electrons(np.full((64, 64), mean), one, photon=photon))
                for mean in (0, 1e-40, 1e-37)
            )
            found.append(Found(dark, 0, f"photons of denormal means, {photon}, {words}"))
        return found

    found = of(device, "as built")
    with open_relaxed(device) as other:
        words = "" if other else "; no other build, the kernels state their compiler's options"
        found += of(other, "fast math") if other else []
    most = max(
        found, key=lambda one: one.got / one.limit if one.limit else (np.inf if one.got else 0)
    )
    yield most._replace(words=most.words + words)

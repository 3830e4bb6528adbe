"""The variance of raw values by parts, against raw values that NumPy draws."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gpusim.backends import open_device
from gpusim.captures.focus import _contrast
from gpusim.domain.noise import Noise
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.io.camera.cameras import open_camera
from gpusim.measure import merge_inputs
from gpusim.pipeline.developer import Developer

Z = 5.0  # standard deviations: one in 2e6 tests fails by chance
BLACK = 256  # [DN]: no value drawn here reaches 0


def sensor_with(gain=0.5, bits=14, **noise):
    return replace(
        open_camera("mono").sensor,
        gain=gain,
        bits=bits,
        full_well=1e6 if bits == FLOAT_BITS else 3e4,
        black_level=BLACK,
        noise=Noise(**noise),
    )


def drawn(random, sensor, mean, shape, pattern=None, dark=0.0, shift=0.0):
    """Raw values (frames, rows, cols) around `mean` electrons; each frame of a chip of its own, unless there is one.

    dark: mean electrons of dark current [e-]. shift: of the black level [DN].
    """
    noise = sensor.noise
    frames, rows, cols = shape
    fixed = pattern if pattern is not None else pattern_of(random, noise, shape)
    electrons = np.broadcast_to(mean * fixed["response"] + dark, shape)
    electrons = random.poisson(electrons) if noise.photon != "none" else electrons
    electrons = (
        electrons + random.normal(0, noise.read, shape) + random.normal(0, noise.reset, shape)
    )
    electrons = electrons + random.normal(0, noise.row, (frames, rows, 1)) + fixed["offset"]
    electrons = electrons + random.normal(0, noise.column, (frames, 1, cols))
    level = (
        sensor.gain_dn_per_electron * electrons
        + random.normal(0, noise.adc, shape)
        + sensor.black_level
        + shift
    )
    return level if sensor.bits == FLOAT_BITS else np.rint(level)


def pattern_of(random, noise, shape):
    """Offsets [e-] and responses of chips."""
    frames, rows, cols = shape
    lines = (frames, rows, 1), (frames, 1, cols)
    return {
        "offset": random.normal(0, noise.dsnu, shape)
        + random.normal(0, noise.row_dsnu, lines[0])
        + random.normal(0, noise.column_dsnu, lines[1]),
        "response": 1
        + random.normal(0, noise.prnu, shape)
        + random.normal(0, noise.row_prnu, lines[0])
        + random.normal(0, noise.column_prnu, lines[1]),
    }


ALL = {
    "read": 4.0,
    "reset": 3.0,
    "adc": 1.5,
    "row": 5.0,
    "column": 3.5,
    "dsnu": 4.5,
    "row_dsnu": 2.5,
    "column_dsnu": 3.0,
}


@pytest.mark.parametrize("averaged", [1, 2, 3, 4])
@pytest.mark.parametrize(
    ("mean", "sensor"),
    [
        (0.0, {"photon": "none"} | ALL),
        (40.0, ALL),
        (40.0, {"photon": "none", "read": 4.0}),
        (0.0, {"photon": "none", "read": 4.0, "gain": 0.2}),
        (0.0, {"bits": FLOAT_BITS} | ALL),
        *[
            (0.0, {key: 4.0, "photon": "none"})
            for key in ("row", "column", "dsnu", "row_dsnu", "column_dsnu")
        ],
    ],
    ids=[
        "dark",
        "light",
        "uncounted",
        "coarse",
        "float",
        "row",
        "column",
        "dsnu",
        "row dsnu",
        "column dsnu",
    ],
)
def test_variance_is_that_of_drawn_values(mean, sensor, averaged):
    """Frames of one pixel each, so that rows' and columns' noise is every pixel's own.

    The black levels are spread evenly over two digital numbers, with which rounding halves to even repeats: all errors
    of rounding come equally often, as in a picture of many levels. The mean square of n values about their level
    scatters by sqrt((2 + k) / n), k being the excess kurtosis: 0 of normal noise, below 1 / 40 of the 40 electrons.
    """
    sensor, count, levels = sensor_with(**sensor), 40_000, 8
    shift = np.tile(np.repeat(np.arange(levels) / levels * 2, count), averaged)[:, None, None]
    raw = drawn(np.random.default_rng(31), sensor, mean, shift.shape, shift=shift)
    raw = raw.reshape(averaged, -1).mean(axis=0)
    if sensor.bits != FLOAT_BITS:
        raw = np.rint(raw)
    level = sensor.gain_dn_per_electron * mean + BLACK + shift[: raw.size, 0, 0]
    measured = pytest.approx(np.square(raw - level).mean(), rel=Z * np.sqrt(2.025 / raw.size))
    assert RawNoise.of(sensor, averaged).variance(mean) * sensor.gain_dn_per_electron**2 == measured
    gain, dark = Developer(
        replace(open_camera("mono"), sensor=sensor), open_device("numpy"), averaged
    ).noise
    assert (
        gain * sensor.gain_dn_per_electron * mean + dark**2 == measured
    )  # what the image processor is told


def test_temporal_variance_leaves_out_what_frames_share():
    """Of one chip, pixel by pixel: 64 frames of 64 x 64 pixels.

    There are 64 x 64 draws of rows' noise, whose variance scatters by sqrt(2 / 4096), and as many of columns'; of the
    other parts there are more.
    """
    sensor, shape = sensor_with(**ALL), (64, 64, 64)
    random = np.random.default_rng(32)
    pattern = pattern_of(random, sensor.noise, (1, *shape[1:]))
    raw = drawn(random, sensor, 30.0, shape, pattern)
    found = RawNoise.of(sensor).variance(30.0, temporal=True) * sensor.gain_dn_per_electron**2
    assert found == pytest.approx(raw.var(axis=0, ddof=1).mean(), rel=Z * np.sqrt(2 / 4096))
    assert RawNoise.of(sensor).variance(30.0) * sensor.gain_dn_per_electron**2 > 1.2 * found


LINES = {"row": 6.0, "column": 3.0, "row_dsnu": 4.0, "column_dsnu": 2.0}
NEIGHBOURS = [
    {"read": 5.0},
    {"read": 2.0} | LINES,
    {"prnu": 0.03, "row_prnu": 0.02, "column_prnu": 0.01},
    {"photon": "none", "read": 3.0, "dsnu": 5.0, "bits": FLOAT_BITS},
]


@pytest.mark.parametrize("noise", NEIGHBOURS, ids=["pixels", "lines", "response", "float"])
def test_difference_is_that_of_drawn_neighbours(noise):
    """Frames are independent, each of another chip: their mean scatters by their own deviation over sqrt(frames).

    As many pairs in rows as in columns, of squares of 24 x 24 pixels.
    """
    sensor, shape, mean = sensor_with(**noise), (1500, 24, 24), 400.0
    raw = drawn(np.random.default_rng(33), sensor, mean, shape)
    squares = sum(np.square(np.diff(raw, axis=axis)).mean(axis=(1, 2)) for axis in (1, 2)) / 2
    error = squares.std(ddof=1) / np.sqrt(len(squares))
    assert error < 0.01 * squares.mean()  # what is tested is finer than any of the parts
    found = RawNoise.of(sensor).difference(mean, mean) * sensor.gain_dn_per_electron**2
    assert abs(found - squares.mean()) < Z * error


@pytest.mark.parametrize(
    "noise",
    [*NEIGHBOURS, {"read": 5.0, "dark_current": 3000.0, "prnu": 0.03}],
    ids=["pixels", "lines", "response", "float", "dark current"],
)
def test_an_even_field_has_no_contrast(noise):
    """Autofocus takes away all that the noise adds: what is left scatters about 0, frame by frame.

    Dark current, 300 e- of 700, has photons' noise once, and no PRNU. The level that the contrast is relative to
    scatters by 0.6 % at most, in second order 1e-4 of what the noise adds; the frames' mean scatters by 2e-3 of that.
    """
    sensor = sensor_with(**noise)
    raw = drawn(
        np.random.default_rng(34),
        sensor,
        400.0,
        (1500, 24, 24),
        dark=0.1 * sensor.noise.dark_current,
    )
    contrasts = np.array([_contrast(one - BLACK, sensor, (1, 1), 0.1, 1)[0] for one in raw])
    assert abs(contrasts.mean()) < Z * contrasts.std(ddof=1) / np.sqrt(len(contrasts))


@pytest.mark.parametrize("averaged", [1, 4])
def test_merge_inputs_know_the_variance_of_means(averaged):
    """Means of 4 whole numbers, rounded once more; of 20 000 pixels, which scatter by sqrt(2 / 20 000) = 1 %.

    The light is taken from each pixel, without bias; 20 of the 50 electrons are dark current, which counts as light
    does. Means of 2.3 DN of noise: rounding is as good as uniform.
    """
    sensor = sensor_with(read=3.0, dark_current=200.0, gain=0.6)
    raw = (
        drawn(np.random.default_rng(35), sensor, 50.0, (averaged * 20_000, 1, 1))
        .reshape(averaged, -1)
        .mean(axis=0)
    )
    frame = SimpleNamespace(
        camera=SimpleNamespace(sensor=sensor), exposure_time=0.1, raw=np.rint(raw).reshape(100, -1)
    )
    inputs = merge_inputs([frame], averaged)
    assert inputs.variances.mean() == pytest.approx(
        inputs.rates.var(), rel=Z * np.sqrt(2.025 / 20_000)
    )

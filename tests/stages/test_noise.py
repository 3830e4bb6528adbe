"""Sensor noise: the same bits everywhere, and the distributions against probability theory.

The stage's cases are compared bit for bit, on every device, in test_stages.py; the samplers' own maps are in
test_poisson.py; fixed patterns in test_pattern.py.
"""

from dataclasses import replace
from itertools import pairwise, product

import numpy as np
import pytest
from devices import ALL, DEVICES
from scipy import stats

from gpusim.backends import launches, open_device
from gpusim.domain.errors import BadData, DeviceError, OutOfRange, UnknownName
from gpusim.domain.noise import Noise
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum
from gpusim.judge.hard.acceptance import ALPHA, SIGMAS, check, p_values
from gpusim.judge.hard.photons import everything
from gpusim.kernels.common.poisson_ref import EXACT_SEARCH_BELOW, SEARCH_BELOW
from gpusim.kernels.sensor.noise import noise
from gpusim.pipeline.readout import Readout

f32 = np.float32
# where each sampler goes from search to expansion, 0.1 to both sides
SWITCHES = [
    float(f32(mean + side))
    for mean in (SEARCH_BELOW, EXACT_SEARCH_BELOW)
    for side in (-0.1, 0, 0.1)
]
MEANS = [
    0,
    1e-8,
    1e-3,
    0.1,
    0.5,
    3,
    5,
    *SWITCHES,
    30,
    87,
    88,
    104,
    300,
    1e3,
    1e4,
    1e5,
    1e7,
    2.0**24 + 1,
]
FEWER = [1e-3, 0.5, 5, *SWITCHES[3:], 104, 1e5, 1e7]
IDEAL = {"full_well": np.inf, "gain": 1.0, "white_level": 65535}
QE = Spectrum(np.array([400.0, 700.0]), np.ones((1, 2)))


def electrons(mean, device="numpy", **changed):
    return noise(np.asarray(mean, f32), **{**IDEAL, **changed}, electrons=True, device=device)


# ---------------------------------------------------------------- the same bits everywhere


@pytest.fixture(scope="module", params=["fast", "exact"])
def whole(request):
    """Inputs of a large frame (2e5 pixels: the tails of the normal numbers too), and the frame of the reference."""
    inputs = everything(300, 701, request.param)
    return inputs, noise(**inputs, device="numpy")


def test_there_are_devices_to_compare():
    assert "warp:cpu" in DEVICES
    assert any(name.startswith("opencl") for name in DEVICES)


@pytest.mark.parametrize("name", DEVICES)
def test_a_large_frame_has_the_same_bits_on_every_device(name, whole):
    inputs, frame = whole
    np.testing.assert_array_equal(noise(**inputs, device=name), frame)


def test_tiles_of_several_devices_make_one_frame(whole):
    inputs, frame = whole
    tiles = np.empty_like(frame)
    rows, cols = pairwise([0, 1, 130, 300]), pairwise([0, 7, 8, 333, 701])
    for i, ((top, bottom), (left, right)) in enumerate(product(rows, cols)):
        part = np.s_[top:bottom, left:right]
        planes = {name: inputs[name][part] for name in ("expected", "offset", "amplitude")}
        tiles[part] = noise(
            **{**inputs, **planes}, first=(top, left), frame_cols=701, device=ALL[i % len(ALL)]
        )
    np.testing.assert_array_equal(tiles, frame)


def test_width_and_work_group_do_not_matter(monkeypatch, whole):
    inputs, frame = whole
    device = open_device("opencl")
    monkeypatch.setattr(launches, "CPU_GROUPS", (24, 1))
    np.testing.assert_array_equal(noise(**inputs, device=device), frame)
    monkeypatch.setattr(
        device, "is_gpu", not device.is_gpu
    )  # which decides the width, 1 or 8, and the work-groups
    np.testing.assert_array_equal(noise(**inputs, device=device), frame)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("photon", ["fast", "exact"])
def test_batches_and_the_order_of_frames_do_not_matter(name, photon):
    inputs = everything(9, 37, photon) | {"frame": 2**32 - 2}  # the third frame is number 0 again
    batch = noise(**inputs, frames=3, device=name)
    for number in (2, 0, 1):
        one = noise(**inputs | {"frame": (2**32 - 2 + number) % 2**32}, device=name)
        np.testing.assert_array_equal(batch[number], one)
    assert len({one.tobytes() for one in batch}) == 3


def test_device_arrays_stay_on_the_device():
    device = open_device("warp:cpu")
    result = noise(device.array(np.full((3, 4), 9.0)), **IDEAL, device=device)
    assert isinstance(result, device.array_type)
    np.testing.assert_array_equal(
        device.numpy(result), noise(np.full((3, 4), 9.0, f32), **IDEAL, device="numpy")
    )


# ---------------------------------------------------------------- photons


def sampler(mean, photon, size):
    """draw(seed, frame) of `acceptance.check`; by the fastest device, as all have the same bits."""
    plane = np.full((size, size), mean)
    return lambda seed=1, frame=0: electrons(plane, "opencl", photon=photon, seed=seed, frame=frame)


@pytest.mark.parametrize(
    ("photon", "mean"), [*product(["fast"], MEANS), *product(["exact"], FEWER)]
)
def test_photons_are_poisson(photon, mean):
    check(sampler(mean, photon, 2**9), float(f32(mean)))


@pytest.mark.slow
@pytest.mark.parametrize(("photon", "mean"), [*product(["fast", "exact"], MEANS)])
def test_photons_are_poisson_in_large_samples(photon, mean):
    check(sampler(mean, photon, 2**12), float(f32(mean)))


@pytest.mark.parametrize(
    "wrong",
    [
        "normal",
        "rounded down",
        "repeated rows",
        "repeated colours",
        "repeated tiles",
        "8 bits",
        "one pixel too bright",
    ],
)
def test_the_suite_sees_wrong_samplers(wrong):
    random = np.random.default_rng(1)
    mean = 0.1 if wrong == "one pixel too bright" else 30.0
    k = {
        "normal": lambda: np.rint(random.normal(mean, np.sqrt(mean), (512, 512))),
        "rounded down": lambda: (
            random.poisson(mean, (512, 512)) - (random.random((512, 512)) < 0.5)
        ),
        "repeated rows": lambda: np.repeat(random.poisson(mean, (256, 512)), 2, axis=0),
        "repeated colours": lambda: np.kron(random.poisson(mean, (256, 256)), np.ones((2, 2))),
        "repeated tiles": lambda: np.tile(random.poisson(mean, (512, 128)), (1, 4)),
        "8 bits": lambda: stats.poisson.ppf(
            (random.integers(0, 256, (512, 512)) + 0.5) / 256, mean
        ),
        "one pixel too bright": lambda: np.where(
            np.arange(2**18).reshape(512, 512) == 99, 100, random.poisson(mean, (512, 512))
        ),
    }[wrong]()
    assert min(p_values(k, mean).values()) < ALPHA


@pytest.mark.parametrize("repeated", ["frame", "seed"])
def test_the_suite_sees_repeated_numbers(repeated):
    def draw(seed=1, frame=0):
        return np.random.default_rng(seed if repeated == "frame" else frame).poisson(
            0.5, (512, 512)
        )

    with pytest.raises(AssertionError, match=repeated):
        check(draw, 0.5)


def test_frames_streams_reads_and_seeds_are_independent():
    mean, dark = np.full((512, 512), 100.0), np.zeros((512, 512))
    samples = np.array(
        [
            electrons(mean),
            electrons(mean, frame=1),
            electrons(mean, read=1),
            electrons(mean, seed=1),
            *(
                electrons(dark, read_noise=1.0, photon="none", **place)
                for place in ({}, {"frame": 1}, {"read": 1})
            ),
        ]
    )
    samples = samples.reshape(len(samples), -1)
    correlation = np.corrcoef(samples)[np.triu_indices(len(samples), 1)]
    assert np.abs(correlation).max() < SIGMAS / np.sqrt(mean.size)
    # photons below the switch come from other words than the read noise of the same pixel; above it, from the other
    # number of the same Box-Muller pair
    few = electrons(np.full((512, 512), 2.0), read_noise=1e-3)
    photons, read = np.rint(few).ravel(), (few - np.rint(few)).ravel()
    assert abs(np.corrcoef(photons, read)[0, 1]) < SIGMAS / np.sqrt(mean.size)
    np.testing.assert_array_less(
        np.abs(np.corrcoef(photons**2, read**2)[0, 1]), SIGMAS / np.sqrt(mean.size)
    )


def test_dark_electrons_are_counted_like_photons():
    assert min(p_values(electrons(np.ones((512, 512)), dark_electrons=4.0), 5.0).values()) > ALPHA


# ---------------------------------------------------------------- other temporal noise


def assert_standard_normal(z):
    z = z.ravel().astype(np.float64)
    assert abs(z.mean()) < SIGMAS / np.sqrt(z.size)
    assert (
        2 * min(stats.chi2(z.size).cdf((z**2).sum()), stats.chi2(z.size).sf((z**2).sum())) > ALPHA
    )
    assert stats.kstest(z, "norm").pvalue > ALPHA
    assert abs((z**3).mean()) < SIGMAS * np.sqrt(15 / z.size)  # E z^6 = 15
    assert abs((z**4).mean() - 3) < SIGMAS * np.sqrt(96 / z.size)  # E z^8 - 9 = 105 - 9
    assert abs((z[1:] * z[:-1]).mean()) < SIGMAS / np.sqrt(z.size)


def test_read_noise_is_normal():
    assert_standard_normal(electrons(np.zeros((512, 512)), photon="none", read_noise=3.0) / 3)


@pytest.mark.parametrize(("key", "axis"), [("row_noise", 1), ("column_noise", 0)])
def test_noise_of_lines_is_normal_and_common_to_each(key, axis):
    shape = (2**16, 3) if axis == 1 else (3, 2**16)
    one = {key: 2.0, "photon": "none"}
    frames = [
        electrons(np.zeros(shape), **one, **place)
        for place in ({}, {"frame": 1}, {"read": 1}, {"seed": 1}, {"frame": 2**31})
    ]
    assert max(np.ptp(frame, axis=axis).max() for frame in frames) == 0
    lines = np.array([frame.take(0, axis=axis) for frame in frames], np.float64) / 2
    assert_standard_normal(lines[0])
    correlation = np.corrcoef(lines)[np.triu_indices(len(lines), 1)]
    assert np.abs(correlation).max() < SIGMAS / np.sqrt(lines.shape[1])


def test_rows_columns_and_pixels_have_numbers_of_their_own():
    square = np.zeros((512, 512))
    of_rows, of_columns, of_pixels = (
        electrons(square, photon="none", **{f"{key}_noise": 1.0})
        for key in ("row", "column", "read")
    )
    assert abs((of_rows[:, 0] * of_columns[0]).mean()) < SIGMAS / np.sqrt(512)
    for lines in (of_rows, of_columns):
        assert abs((of_pixels.astype(np.float64) * lines).mean()) < SIGMAS / 512
    together = electrons(square, photon="none", row_noise=1.0, column_noise=1.0, read_noise=1.0)
    np.testing.assert_allclose(
        together, of_pixels + of_rows + of_columns, atol=8 * 2.0**-22
    )  # order of two sums


@pytest.mark.parametrize("switching", [1.0, 0.3, 0.01])
def test_telegraph_noise_jumps_between_two_values(switching):
    frames, first = 24, 700  # long after the start, and in the middle of it
    shape = 128, 128
    state = (
        electrons(
            np.zeros(shape),
            "opencl",
            amplitude=np.full(shape, 8.0, f32),
            photon="none",
            frame=first,
            frames=frames,
            telegraph_switching=switching,
        )
        / 8
    )
    assert set(np.unique(state)) == {0, 1}
    x = 2 * state.astype(np.float64) - 1
    of_pixels = x.mean(axis=0)  # pixels are independent, frames are not
    assert abs(of_pixels.mean()) < SIGMAS * of_pixels.std() / 128
    for lag in (1, 2, 5, 20):
        products = (x[lag:] * x[:-lag]).mean(axis=0)
        assert products.mean() == pytest.approx(
            (1 - switching) ** lag, abs=SIGMAS * products.std() / 128 + 1e-12
        )
    for down, right in ((0, 1), (1, 0)):
        assert abs((x[0, down:, right:] * x[0, : 128 - down, : 128 - right]).mean()) < SIGMAS / 127


def test_telegraph_noise_is_as_strong_as_its_amplitude_and_spares_other_pixels():
    amplitude = np.zeros((64, 64), f32)
    amplitude[::2, 1::2] = np.arange(32)[:, None] + 1
    low, high = (
        electrons(np.full((64, 64), 5.0), amplitude=amplitude, photon="none", frames=40)
        .astype(np.float64)
        .__getattribute__(name)(axis=0)
        for name in ("min", "max")
    )
    np.testing.assert_array_equal(low, 5)  # 2^-40 of 1024 pixels stay in one state
    np.testing.assert_array_equal(high - low, amplitude)


# ---------------------------------------------------------------- the complete chain


SENSOR = Sensor(
    1e-6,
    QE,
    1e5,
    16,
    ("Y",),
    ("Y",),
    gain=0.5,
    analog_gain=4.0,
    analog_offset=50.0,
    black_level=400,
)
GOOD = Noise(
    dark_current=20.0,
    temperature=33.0,
    read=2.0,
    reset=1.5,
    adc=4.0,
    row=0.5,
    column=0.4,
    prnu=0.05,
    row_prnu=0.01,
    column_prnu=0.02,
    dsnu=3.0,
    row_dsnu=0.6,
    column_dsnu=0.7,
)
BAD = replace(
    GOOD,
    hot_pixels=0.02,
    hot_current=100.0,
    dead_pixels=0.01,
    telegraph_pixels=0.1,
    telegraph=20.0,
    telegraph_switching=0.5,
)


def cumulants(chip, mean, seconds):
    """Mean, variance and third central moment of a raw value [DN], over pixels, chips and frames.

    Cumulants of independent parts are added. Poisson numbers of a varying mean L have the cumulants of L and, of the
    second and third, its lower ones beside: k1, k2 + k1, k3 + 3 k2 + k1.
    """

    def central(first, second, third):
        """Cumulants from moments about 0."""
        return np.array([first, second - first**2, third - 3 * first * second + 2 * first**3])

    def exponential(share, scale):
        return central(
            *(share * factor * scale**order for order, factor in ((1, 1), (2, 2), (3, 6)))
        )

    response = chip.prnu**2 + chip.row_prnu**2 + chip.column_prnu**2
    alive = 1 - chip.dead_pixels
    seen = central(
        *(alive * np.array([mean, mean**2 * (1 + response), mean**3 * (1 + 3 * response)]))
    )
    warm = 2 * seconds  # 8 K above the reference
    k1, k2, k3 = (
        seen
        + exponential(chip.hot_pixels, chip.hot_current * warm)
        + [chip.dark_current * warm, 0, 0]
    )
    gain = 2.0
    counted = np.array([k1, k2 + k1, k3 + 3 * k2 + k1])
    normal = (
        chip.read**2
        + chip.reset**2
        + (chip.adc / gain) ** 2
        + chip.row**2
        + chip.column**2
        + chip.dsnu**2
        + chip.row_dsnu**2
        + chip.column_dsnu**2
        + 1 / (12 * gain**2)
    )  # the last: rounding to whole DN
    # a trap's upper state half of the time
    jumps = exponential(chip.telegraph_pixels / 2, chip.telegraph)
    total = counted + jumps + [50.0, normal, 0]
    return total * [gain, gain**2, gain**3] + [400, 0, 0]


@pytest.mark.parametrize(
    ("chip", "photon", "mean", "errors"),
    [
        # least errors that the tests can see: the mean's [DN], the others' relative; a chip's lines limit them
        (BAD, "fast", 600.0, (0.5, 0.005, 0.01)),
        (GOOD, "exact", 20.0, (0.1, 0.005, 0.06)),
    ],
    ids=["bad", "good"],
)
def test_mean_variance_and_skewness_of_the_complete_chain(chip, photon, mean, errors):
    seconds, size, chips = 0.5, 256, 40
    device = open_device("opencl")
    truth = cumulants(chip, mean, seconds)
    moments = []
    for seed in range(chips):
        readout = Readout(replace(SENSOR, noise=replace(chip, photon=photon, seed=seed)), device)
        expected = readout.chip_mean(device.array(np.full((size, size), mean, f32)), seconds)
        raw = device.numpy(readout.draw(expected, seconds, seed=seed, first=100 + seed)).astype(
            np.float64
        )
        assert raw.min() > 0
        assert raw.max() < 65535
        # about the true mean: what rows and columns have in common biases moments about the sample's own
        x = raw - truth[0]
        moments.append([x.mean(), (x**2).mean(), (x**3).mean()])
    # chips are independent, so the spread of their moments is the error of the average
    for values, true, least in zip(
        np.transpose(moments), [0, *truth[1:]], errors * np.abs([1, *truth[1:]]), strict=True
    ):
        assert stats.ttest_1samp(values, true).pvalue > ALPHA
        assert values.std() / np.sqrt(chips) < least  # or it would not see that a part is missing


def test_all_parameters_are_recovered_from_two_frames():
    level, black, gain = 2000.0, 512, 2.0
    chip = Noise(dark_current=30.0, read=12.0, prnu=0.02, dsnu=25.0, seed=5)
    device = open_device("numpy")
    sensor = replace(
        SENSOR, gain=gain, analog_gain=1.0, analog_offset=0.0, black_level=black, noise=chip
    )
    readout = Readout(sensor, device)
    expected = readout.chip_mean(np.full((512, 512), level, f32), 1.0)
    first, second = (
        readout.draw(expected, 1.0, first=frame).astype(np.float64).ravel() for frame in (0, 1)
    )
    n, fixed = first.size, (chip.prnu * level) ** 2 + chip.dsnu**2
    # EMVA 1288: differences of frames hold the temporal variance, their covariance the fixed one; 1/12 is the rounding
    temporal = level + chip.dark_current + chip.read**2 + 1 / (12 * gain**2)
    error = SIGMAS * np.sqrt(2 / n)  # relative error of a variance
    assert ((first - second) ** 2).mean() / 2 / gain**2 == pytest.approx(temporal, rel=error)
    assert np.cov(first, second)[0, 1] / gain**2 == pytest.approx(
        fixed, abs=error * (fixed + temporal)
    )
    expected_mean = pytest.approx(
        level + chip.dark_current, abs=SIGMAS * np.sqrt((fixed + temporal) / n)
    )
    assert (first.mean() - black) / gain == expected_mean


def test_patterns_belong_to_the_chip_and_temporal_noise_to_the_frame():
    device = open_device("numpy")
    mean = np.full((8, 9), 50.0, f32)

    def draw(chip, **place):
        readout = Readout(replace(SENSOR, bits=32, noise=chip), device)
        return readout.draw(readout.chip_mean(mean, 1.0), 1.0, **place)

    fixed = Noise(photon="none", prnu=0.1, dsnu=1.0)
    np.testing.assert_array_equal(draw(fixed, first=1, seed=2), draw(fixed, first=7))
    assert not np.any(draw(fixed) == draw(replace(fixed, seed=2**32)))  # its high half
    temporal = Noise(read=1.0)
    np.testing.assert_array_equal(draw(temporal, first=3), draw(replace(temporal, seed=8), first=3))
    assert not np.any(
        draw(Noise(photon="none", read=1.0)) == draw(Noise(photon="none", read=1.0), seed=2**32)
    )


def test_what_is_off_costs_no_launch(monkeypatch):
    device = open_device("warp:cpu")
    launched = []
    launch = device.launch
    monkeypatch.setattr(
        device,
        "launch",
        lambda stage, kernel, *rest, **options: (
            launched.append(kernel),
            launch(stage, kernel, *rest, **options),
        ),
    )
    readout = Readout(replace(SENSOR, noise=Noise(photon="none")), device)
    mean = device.array(np.full((4, 5), 9.0, f32))
    readout.draw(readout.chip_mean(mean, 1.0), 1.0)
    assert launched == ["noise"]
    assert {step.stage for step in readout.steps((4, 6)) if step.words} == {"sensor.noise"}


# ---------------------------------------------------------------- converter and refusals


def test_halves_go_to_the_even_number_and_levels_are_clipped():
    mean = np.array([[0.5, 1.5, 2.5, 300.0, 1e9]])
    dn = noise(mean, **IDEAL | {"white_level": 255}, photon="none", device="numpy")
    np.testing.assert_array_equal(dn, [[0, 2, 2, 255, 255]])
    assert dn.dtype == np.uint16


def test_without_a_converter_levels_are_neither_rounded_nor_clipped():
    mean = np.array([[0.5, 1.25, 1e6]])
    dn = noise(
        mean,
        **IDEAL | {"white_level": None, "gain": 2.0},
        black_level=-3.0,
        photon="none",
        device="numpy",
    )
    np.testing.assert_array_equal(dn, [[-2.0, -0.5, 2e6 - 3]])
    assert dn.dtype == f32


@pytest.mark.parametrize(
    ("key", "value", "error"),
    [
        ("read_noise", -1.0, OutOfRange),
        ("row_noise", np.nan, OutOfRange),
        ("column_noise", np.inf, OutOfRange),
        ("dark_electrons", -1e-9, OutOfRange),
        ("full_well", 0.0, OutOfRange),
        ("full_well", np.nan, OutOfRange),
        ("gain", 0.0, OutOfRange),
        ("white_level", 65536, OutOfRange),
        ("black_level", np.nan, OutOfRange),
        ("telegraph_switching", 0.0, OutOfRange),
        ("seed", 2**64, OutOfRange),
        ("frame", -1, OutOfRange),
        ("read", 2**31, OutOfRange),
        ("frames", 0, OutOfRange),
        ("photon", "poisson", UnknownName),
        ("offset", np.zeros((2, 3), f32), BadData),
        ("amplitude", np.zeros((3, 2), f32), BadData),
    ],
)
def test_numbers_out_of_range_are_named(key, value, error):
    with pytest.raises(error, match=key):
        electrons(np.zeros((2, 2)), DEVICES[0], **{key: value})


@pytest.mark.parametrize("place", [{"first": (-1, 0)}, {"first": (0, 3), "frame_cols": 4}])
def test_a_tile_outside_its_frame_is_refused(place):
    with pytest.raises(OutOfRange, match="frame_cols"):
        electrons(np.zeros((2, 2)), DEVICES[0], **place)


def test_exact_photons_need_float64(monkeypatch):
    device = open_device("opencl")
    monkeypatch.setattr(device, "has_fp64", False)
    with pytest.raises(DeviceError, match="float64"):
        electrons(np.zeros((2, 2)), device, photon="exact")

"""Calibration both ways: a data sheet makes a sensor, and its frames give the figures of the data sheet.

Three judges of `photon_transfer` and of the simulated camera: frames drawn by NumPy, the reference implementation of
the standard, and exact sums over the Poisson distribution. Tolerances are SIGMAS standard deviations of the figure over
repeated measurements. For N pixels, two frames a level and a variance V:
    a temporal variance has the deviation V sqrt(2 / N);
    K, a line through the origin over n evenly spaced levels with V in proportion to the signal x, has the relative
    deviation sqrt(2 / N) sqrt(sum x^4) / sum x^2 = sqrt(2 / N) sqrt(9 / (5 n));
    a nonuniformity, s^2 = s^2_measured - V / L of the mean of L frames, has that of s^2_measured, s^2_measured
    sqrt(2 / N), so s has half of it, s^2_measured / s^2 sqrt(2 / N) / 2.
"""

import math

import numpy as np
import pytest
from scipy.stats import poisson

from gpusim.domain.errors import BadData, GpusimError, OutOfRange
from gpusim.domain.spectrum import Spectrum
from gpusim.io.camera.emva1288 import full_well, sensor_from_emva1288
from gpusim.kernels.sensor.chip import chip
from gpusim.kernels.sensor.noise import noise
from gpusim.kernels.sensor.pattern import pattern
from gpusim.measure import photon_transfer

SIGMAS = 4
DEVICE = "auto"  # any: they give the same digital numbers
WAVELENGTH = 525.0
SHEET = {
    "pixel_pitch": 3.45e-6,
    "quantum_efficiency": 0.6,
    "wavelength": WAVELENGTH,
    "gain": 0.4,
    "dark_noise": 5.0,
    "saturation_capacity": 8000.0,
    "bits": 12,
    "black_level": 64,
    "dsnu": 3.0,
    "prnu": 0.8,
    "dark_current": 20.0,
}
SHAPE = 256, 512
N = SHAPE[0] * SHAPE[1]
LEVELS, STACK = 50, 32
TIMES = np.linspace(0, 2.5, 6)  # [s] of the dark series
# two levels beyond the well: saturated levels differ by chance only, which would mislead the reference's search
STEP = 1.08 * SHEET["saturation_capacity"] / LEVELS  # [e-]
PHOTONS = STEP / SHEET["quantum_efficiency"] * np.arange(1, LEVELS + 1)
HALF = 0.5 * SHEET["saturation_capacity"] / SHEET["quantum_efficiency"]
EXPOSURE = 1e-3  # [s]; 0.02 e- of dark current, 0.04 % of the dark noise


def frames(sensor, mean, count, first=0, exposure_time=EXPOSURE):
    """`count` frames, numbered from `first`, of evenly lit pixels with `mean` photo-electrons: uint16, with SHAPE."""
    part = sensor.noise
    response = pattern(
        *SHAPE,
        "response",
        mean=1,
        pixel=part.prnu,
        row=part.row_prnu,
        column=part.column_prnu,
        seed=part.seed,
        device=DEVICE,
    )
    offset = pattern(
        *SHAPE,
        "offset",
        pixel=part.dsnu,
        row=part.row_dsnu,
        column=part.column_dsnu,
        seed=part.seed,
        device=DEVICE,
    )
    expected = chip(np.full(SHAPE, mean, np.float32), response, device=DEVICE)
    return noise(
        expected,
        offset,
        dark_electrons=part.operating_dark_current * exposure_time,
        read_noise=part.read,
        full_well=sensor.full_well,
        gain=sensor.gain_dn_per_electron,
        black_level=sensor.black_level,
        white_level=sensor.white_level,
        photon=part.photon,
        seed=1,
        frame=first,
        frames=count,
        device=DEVICE,
    )


@pytest.fixture(scope="module")
def laboratory():
    """Frames of the simulated camera, as arguments of `photon_transfer`; no two share a frame's number."""
    sensor = sensor_from_emva1288(**SHEET)
    efficiency = sensor.qe.at([WAVELENGTH])[0, 0]
    levels = enumerate(PHOTONS)
    return {
        "bright": [
            frames(sensor, efficiency * photons, 2, 10 + 2 * index) for index, photons in levels
        ],
        "dark": frames(sensor, 0, 2),
        "photons": PHOTONS,
        "dark_stack": frames(sensor, 0, STACK, 1000),
        "bright_stack": frames(sensor, efficiency * HALF, STACK, 2000),
        "dark_series": {
            float(time): frames(sensor, 0, 2, 3000 + 2 * index, time)
            for index, time in enumerate(TIMES)
        },
    }


def fitted_levels():
    return (
        int(0.7 * SHEET["saturation_capacity"] / STEP) - 1
    )  # one less if saturation is found a level early


def gain_deviation():
    """Relative standard deviation of K; that of the responsivity, 1 / sqrt(2 N mu_e) at most, is 50 times smaller."""
    return math.sqrt(2 / N) * math.sqrt(9 / (5 * fitted_levels()))


def dark_noise_deviation():
    """Relative standard deviation of sigma_d from one pair of frames."""
    variance = SHEET["dark_noise"] ** 2 + 1 / 12 / SHEET["gain"] ** 2
    return math.hypot(math.sqrt(2 / N) / 2 * variance / SHEET["dark_noise"] ** 2, gain_deviation())


def dsnu_deviation():
    left = (SHEET["dark_noise"] ** 2 + 1 / 12 / SHEET["gain"] ** 2) / STACK
    return math.hypot(math.sqrt(2 / N) / 2 * (1 + left / SHEET["dsnu"] ** 2), gain_deviation())


def prnu_deviation():
    mean = 0.5 * SHEET["saturation_capacity"]
    pattern = (SHEET["prnu"] / 100 * mean) ** 2
    left = (mean + SHEET["dark_noise"] ** 2 + 1 / 12 / SHEET["gain"] ** 2) / STACK
    # beside it the chance covariance of the two patterns, 2 r s_prnu s_dsnu with r of deviation 1 / sqrt(N)
    return math.hypot(
        math.sqrt(2 / N) / 2 * (pattern + SHEET["dsnu"] ** 2 + left) / pattern,
        SHEET["dsnu"] / math.sqrt(pattern * N),
    )


# ---------------------------------------------------------------- the simulated camera


def test_a_data_sheet_is_found_again(laboratory):
    found = photon_transfer(**laboratory)
    assert found.gain == pytest.approx(SHEET["gain"], rel=SIGMAS * gain_deviation())
    assert found.quantum_efficiency == pytest.approx(
        SHEET["quantum_efficiency"], rel=SIGMAS * gain_deviation()
    )
    # mean of N pixels of deviation sqrt(mu + (prnu mu)^2), best known where most light is; and the line is a mean
    response = math.sqrt(1 / SHEET["saturation_capacity"] + (SHEET["prnu"] / 100) ** 2) / math.sqrt(
        N
    )
    assert found.responsivity == pytest.approx(
        SHEET["gain"] * SHEET["quantum_efficiency"], rel=SIGMAS * response
    )
    assert found.dsnu == pytest.approx(SHEET["dsnu"], rel=SIGMAS * dsnu_deviation())
    assert found.prnu == pytest.approx(SHEET["prnu"], rel=SIGMAS * prnu_deviation())
    # saturation is found as a level; the variance grows 2 % from one level to the next, 4 times its deviation, and
    # falls faster beyond its peak
    assert found.saturation_capacity == pytest.approx(
        SHEET["saturation_capacity"],
        abs=STEP + SIGMAS * gain_deviation() * SHEET["saturation_capacity"],
    )
    assert found.snr_max_db == pytest.approx(
        10 * math.log10(found.saturation_capacity), abs=1e-9
    )  # definition
    # a perfectly linear camera: the mean magnitude of n normal deviations, the largest at 5 % of saturation
    assert found.linearity_error < 100 * SIGMAS / math.sqrt(
        2 * N * 0.05 * SHEET["saturation_capacity"]
    )
    assert not found.quantisation_limited


def test_dark_current_and_dark_noise_from_exposure_times(laboratory):
    found = photon_transfer(**laboratory)
    variance = (
        SHEET["dark_noise"] ** 2 + SHEET["dark_current"] * TIMES + 1 / 12 / SHEET["gain"] ** 2
    )
    offset = TIMES - TIMES.mean()
    slope = offset / (offset @ offset)  # slope = sum of these times the points
    means = np.hypot(*(slope * part for part in (np.sqrt(variance / (2 * N)), 0)))
    deviation = math.hypot(np.linalg.norm(means) / SHEET["dark_current"], gain_deviation())
    assert found.dark_current == pytest.approx(SHEET["dark_current"], rel=SIGMAS * deviation)
    variances = math.sqrt(2 / N) * np.linalg.norm(slope * variance)
    deviation = math.hypot(variances / SHEET["dark_current"], 2 * gain_deviation())
    assert found.dark_current_from_variance == pytest.approx(
        SHEET["dark_current"], rel=SIGMAS * deviation
    )
    at_zero = math.sqrt(2 / N) * np.linalg.norm((1 / len(TIMES) - TIMES.mean() * slope) * variance)
    deviation = math.hypot(at_zero / (2 * SHEET["dark_noise"] ** 2), gain_deviation())
    assert found.dark_noise == pytest.approx(SHEET["dark_noise"], rel=SIGMAS * deviation)
    in_numbers = math.sqrt((SHEET["gain"] * SHEET["dark_noise"]) ** 2 + 1 / 12)
    assert found.dark_noise_dn == pytest.approx(in_numbers, rel=SIGMAS * deviation)
    threshold = (in_numbers / SHEET["gain"] + 0.5) / SHEET["quantum_efficiency"]
    assert found.sensitivity_threshold == pytest.approx(threshold, rel=SIGMAS * deviation)


def test_rows_and_columns_are_told_apart(laboratory):
    """A part s of m lines, seen in averages of n pixels that each add the variance w, has the relative deviation
    (1 + w / (n s^2)) / sqrt(2 m); PRNU also the chance covariance of the two patterns, s_dsnu / (s_prnu sqrt(m)).
    """
    given = {"dsnu_row": 2.0, "dsnu_column": 1.0, "prnu_row": 0.4, "prnu_column": 0.2}
    sensor = sensor_from_emva1288(**SHEET | given)
    found = photon_transfer(
        **laboratory
        | {
            "dark_stack": frames(sensor, 0, STACK, 1000),
            "bright_stack": frames(sensor, SHEET["quantum_efficiency"] * HALF, STACK, 2000),
        }
    )
    half = 0.5 * SHEET["saturation_capacity"]
    temporal = SHEET["dark_noise"] ** 2 + 1 / 12 / SHEET["gain"] ** 2
    for part, n, m in (
        ("row", SHAPE[1], SHAPE[0]),
        ("column", SHAPE[0], SHAPE[1]),
        ("pixel", 1, N),
    ):
        dsnu, prnu = (
            math.sqrt(SHEET[kind] ** 2 - given[f"{kind}_row"] ** 2 - given[f"{kind}_column"] ** 2)
            if part == "pixel"
            else given[f"{kind}_{part}"]
            for kind in ("dsnu", "prnu")
        )
        signal = prnu / 100 * half  # [e-]
        pixels = (
            0 if part == "pixel" else SHEET["dsnu"] ** 2,
            0 if part == "pixel" else (0.008 * half) ** 2,
        )  # at most
        dark = (1 + (pixels[0] + temporal / STACK) / n / dsnu**2) / math.sqrt(2 * m)
        bright = (1 + (sum(pixels) + (half + temporal) / STACK) / n / signal**2) / math.sqrt(2 * m)
        assert getattr(found, f"dsnu_{part}") == pytest.approx(
            dsnu, rel=SIGMAS * math.hypot(dark, gain_deviation())
        )
        assert getattr(found, f"prnu_{part}") == pytest.approx(
            prnu, rel=SIGMAS * math.hypot(bright, dsnu / signal / math.sqrt(m))
        )


# ---------------------------------------------------------------- the reference implementation


@pytest.fixture
def reference(laboratory, monkeypatch):
    """Results of the standard's reference implementation from the same frames, with `asfarray` of before NumPy 2."""
    from emva1288 import process

    monkeypatch.setattr(
        np, "asfarray", lambda values: np.asarray(values, np.float64), raising=False
    )
    summed = process.routines.get_int_imgs

    def temporal(pair):
        images = summed(list(pair))
        return {"sum": images["sum"].sum(), "pvar": images["pvar"].sum(), "dmean": images["dmean"]}

    time = EXPOSURE * 1e9  # [ns]
    levels = {
        float(photons): temporal(pair)
        for photons, pair in zip(PHOTONS, laboratory["bright"], strict=True)
    }
    data = {
        "height": SHAPE[0],
        "width": SHAPE[1],
        "temporal": {time: {0.0: temporal(laboratory["dark"]), **levels}},
        "spatial": {
            time: {
                0.0: summed(list(laboratory["dark_stack"])),
                HALF: summed(list(laboratory["bright_stack"])),
            }
        },
    }
    with np.errstate(
        invalid="ignore"
    ):  # it takes roots of parts that came out negative: NaN, as here
        yield process.Results1288(process.Data1288(data).data)


def test_the_reference_implementation_finds_the_camera_within_1_percent(reference):
    assert (
        SHEET["gain"] * SHEET["dark_noise"] > 0.5
    )  # [DN], below which rounding hides the dark noise
    for name, found, wanted, deviation in (
        ("QE", reference.QE / 100, SHEET["quantum_efficiency"], gain_deviation()),
        ("K", reference.K, SHEET["gain"], gain_deviation()),
        ("dark noise", reference.sigma_d, SHEET["dark_noise"], dark_noise_deviation()),
        ("DSNU", reference.DSNU1288, SHEET["dsnu"], dsnu_deviation()),
        ("PRNU", reference.PRNU1288, SHEET["prnu"], prnu_deviation()),
    ):
        assert SIGMAS * deviation < 0.01, (
            name
        )  # enough pixels and frames that 1 % says something of the camera
        assert found == pytest.approx(wanted, rel=0.01), name


def test_photon_transfer_equals_the_reference_implementation(laboratory, reference):
    """The same frames, the same definitions: they differ by its iterative fits, which stop at 1.5e-8."""
    found = photon_transfer(**laboratory | {"dark_series": None})
    pairs = {
        "gain": reference.K,
        "responsivity": reference.R,
        "quantum_efficiency": reference.QE / 100,
        "dark_noise": reference.sigma_d,
        "dark_noise_dn": reference.sigma_y_dark,
        "snr_max": reference.SNR_max,
        "sensitivity_threshold": reference.u_p_min,
        "saturation_photons": reference.u_p_sat,
        "saturation_capacity": reference.u_e_sat,
        "dynamic_range": reference.DR,
        "dsnu": reference.DSNU1288,
        "dsnu_row": reference.DSNU1288_row,
        "dsnu_column": reference.DSNU1288_col,
        "dsnu_pixel": reference.DSNU1288_pixel,
        "prnu": reference.PRNU1288,
        "prnu_row": reference.PRNU1288_row,
        "prnu_column": reference.PRNU1288_col,
        "prnu_pixel": reference.PRNU1288_pixel,
        "snr_max_db": reference.SNR_max_dB(),
        "dynamic_range_db": reference.DR_dB(),
    }
    for name, wanted in pairs.items():
        assert getattr(found, name) == pytest.approx(wanted, rel=1e-6, nan_ok=True), name
    # deviations of 1e-2 % from a line, which its sums of 1 / y^2 give to about 1e-10
    assert found.linearity_min == pytest.approx(reference.LE_min, abs=1e-8)
    assert found.linearity_max == pytest.approx(reference.LE_max, abs=1e-8)


# ---------------------------------------------------------------- frames that NumPy draws


def standard(random, shape):
    """Normal numbers with the mean 0 and the variance 1 exactly, along every row and column too if there are both."""
    z = random.standard_normal(shape)
    for axis in range(z.ndim):
        z -= z.mean(axis=axis, keepdims=True)
    return z / z.std()


def test_photon_transfer_of_frames_drawn_by_numpy():
    """All figures with rows and columns of their own; nothing here comes from the simulator or the data sheet."""
    rows, cols, count = 200, 300, 30
    gain, efficiency, read, well = 0.5, 0.5, 6.0, 9000.0
    dsnu, prnu = (
        {"row": 4.0, "column": 3.0, "pixel": 5.0},
        {"row": 0.4, "column": 0.3, "pixel": 0.5},
    )  # [e-], [%]
    random = np.random.default_rng(1)

    def fixed(parts):
        return (
            parts["row"] * standard(random, rows)[:, None]
            + parts["column"] * standard(random, cols)
            + parts["pixel"] * standard(random, (rows, cols))
        )

    offset, response = fixed(dsnu), 1 + fixed(prnu) / 100

    def take(photons, n):
        charge = np.minimum(random.poisson(efficiency * photons * response, (n, rows, cols)), well)
        return np.rint(
            100 + gain * (charge + offset + random.normal(0, read, (n, rows, cols)))
        ).astype(np.uint16)

    photons = np.linspace(500, 20000, 40)
    found = photon_transfer(
        (take(level, 2) for level in photons),
        take(0, 2),
        photons,
        dark_stack=take(0, count),
        bright_stack=take(9000, count),
    )
    n, fitted = rows * cols, int(0.7 * well / efficiency / 500) - 1
    k = math.sqrt(2 / n) * math.sqrt(9 / (5 * fitted))
    assert found.gain == pytest.approx(gain, rel=SIGMAS * k)
    assert found.quantum_efficiency == pytest.approx(efficiency, rel=SIGMAS * k)
    temporal = read**2 + 1 / 12 / gain**2
    deviation = math.hypot(math.sqrt(2 / n) / 2 * temporal / read**2, k)
    assert found.dark_noise == pytest.approx(read, rel=SIGMAS * deviation)
    # the variance peaks where photon noise and PRNU begin to be cut off, at most 5 deviations below the well, and is
    # seen at one of the levels
    below = 5 * math.sqrt(well + (math.hypot(*prnu.values()) / 100 * well) ** 2) + efficiency * 500
    assert -below < found.saturation_capacity - well * (1 - SIGMAS * k) < 2 * SIGMAS * k * well

    def tolerance(part, wanted, left, scale):
        """Of a part `wanted` x `scale` [e-] seen through temporal noise of the variance `left` in the mean frame.

        In averages of n pixels left / n remains; over m of them its covariance with the part and its own variance move
        the part by the two terms of `deviation`. The patterns have no row and column means, but the estimator takes
        pixel^2 / n for granted there: the bias.
        """
        n, m = {"row": (cols, rows), "column": (rows, cols), "pixel": (1, rows * cols)}[part]
        bias = (
            (1 / rows + 1 / cols) / 2
            if part == "pixel"
            else wanted["pixel"] ** 2 / n / (2 * wanted[part] ** 2)
        )
        ratio = left / n / (wanted[part] * scale) ** 2
        return bias + SIGMAS * math.hypot(math.sqrt(ratio / m), ratio / math.sqrt(2 * m), k)

    for part in dsnu:
        assert getattr(found, f"dsnu_{part}") == pytest.approx(
            dsnu[part], rel=tolerance(part, dsnu, temporal / count, 1)
        ), part
        # the bright stack holds both patterns, whose chance covariance over m numbers is no part of either
        scale, m = (
            efficiency * 9000 / 100,
            {"row": rows, "column": cols, "pixel": rows * cols}[part],
        )
        chance = SIGMAS * dsnu[part] / (prnu[part] * scale * math.sqrt(m))
        assert getattr(found, f"prnu_{part}") == pytest.approx(
            prnu[part],
            rel=chance + tolerance(part, prnu, (efficiency * 9000 + temporal) / count, scale),
        ), part
    assert found.dsnu == pytest.approx(
        math.hypot(*dsnu.values()), rel=tolerance("pixel", dsnu, temporal / count, 1)
    )
    assert found.dsnu**2 == pytest.approx(
        found.dsnu_row**2 + found.dsnu_column**2 + found.dsnu_pixel**2, rel=1e-9
    )


def exact_frames(mean, variance, shape=(8, 8)):
    """Two frames of exactly this mean and temporal variance: half the pixels differ one way, half the other."""
    sign = np.where(np.indices(shape).sum(axis=0) % 2, 1.0, -1.0)
    return np.stack([mean + sign * math.sqrt(variance / 2), mean - sign * math.sqrt(variance / 2)])


def exact_measurement(**changed):
    """A camera without chance: K = 2, eta = 0.25, dark noise 3 DN, saturation at level 19 of 21."""
    photons = 100.0 * np.arange(1, 22)
    bright = [
        exact_frames(10 + min(0.5 * level, 1000), 9 + level if level <= 2000 else 1)
        for level in photons
    ]
    return {"bright": bright, "dark": exact_frames(10, 9), "photons": photons} | changed


def test_definitions_without_chance():
    found = photon_transfer(**exact_measurement())
    # float64 sums of 64 numbers near 1e3, squared: 1e-12
    assert found.gain == pytest.approx(2, rel=1e-10) and found.responsivity == pytest.approx(
        0.5, rel=1e-10
    )
    assert found.saturation_level == 19 and found.saturation_capacity == pytest.approx(
        500, rel=1e-10
    )
    assert found.dark_noise_dn == pytest.approx(3, rel=1e-10)
    assert found.dark_noise == pytest.approx(math.sqrt(9 - 1 / 12) / 2, rel=1e-10)
    assert found.sensitivity_threshold == pytest.approx((1.5 + 0.5) / 0.25, rel=1e-10)
    assert found.dynamic_range == pytest.approx(250, rel=1e-10)
    assert found.snr_max_db == pytest.approx(10 * math.log10(500), rel=1e-10)
    assert found.linearity_error == pytest.approx(0, abs=1e-9)
    assert found.dsnu is None and found.prnu is None and found.dark_current is None


def test_flickering_light_is_no_noise_of_the_camera():
    bright = [pair + np.array([5.0, -5.0])[:, None, None] for pair in exact_measurement()["bright"]]
    assert photon_transfer(**exact_measurement(bright=bright)).gain == pytest.approx(2, rel=1e-10)


def test_linearity_error_is_the_mean_deviation():
    """Levels alternately 1 % too bright and too dark, which the line follows a little.

    For small deviations d it takes their projection on (1, 1/x), x = 1 .. 20. The alternating sum of 1/x is about ln 2,
    its norm 1.26, so 1/x takes 0.55 of them at its largest element, 1 / 1.26, and the constant next to nothing: 0.43 at
    the first level and, the mean magnitude of 1/x over the norm being 0.14, 0.08 on the average.
    """
    bright = [
        pair + 0.005 * photons * (-1) ** index
        for index, (pair, photons) in enumerate(
            zip(exact_measurement()["bright"], exact_measurement()["photons"], strict=True)
        )
    ]
    found = photon_transfer(**exact_measurement(bright=bright))
    assert found.linearity_error == pytest.approx(1, rel=0.08)
    assert found.linearity_max == pytest.approx(
        1, rel=0.43
    ) and found.linearity_min == pytest.approx(-1, rel=0.43)


def test_dark_noise_below_rounding_is_an_upper_bound():
    found = photon_transfer(**exact_measurement(dark=exact_frames(10, 0.1)))
    assert found.quantisation_limited and found.dark_noise_dn == pytest.approx(
        math.sqrt(0.24)
    )  # the standard's


# ---------------------------------------------------------------- the sensor of a data sheet


def test_the_figures_become_the_sensor():
    sensor = sensor_from_emva1288(
        **SHEET | {"dsnu_row": 1.0, "dsnu_column": 2.0, "prnu_row": 0.3, "prnu_column": 0.4},
        dark_current_temperature=45,
        dark_current_doubling=7,
    )
    assert (sensor.gain, sensor.bits, sensor.black_level, sensor.pixel_pitch) == (
        0.4,
        12,
        64,
        3.45e-6,
    )
    assert sensor.channels == sensor.cfa == ("Y",)
    part = sensor.noise
    assert (part.read, part.dark_current, part.reference_temperature, part.doubling) == (
        5,
        20,
        45,
        7,
    )
    assert part.warmth == 1  # at the temperature of the data sheet
    assert (part.row_dsnu, part.column_dsnu) == (1, 2) and part.dsnu == pytest.approx(
        2, rel=1e-12
    )  # 9 - 1 - 4
    assert part.row_prnu == pytest.approx(0.003) and part.column_prnu == pytest.approx(0.004)
    assert part.prnu == pytest.approx(math.sqrt(0.008**2 - 0.003**2 - 0.004**2), rel=1e-12)


@pytest.mark.parametrize("capacity", [200, 2000, 8000, 100000])
def test_the_photon_transfer_curve_peaks_at_the_saturation_capacity(capacity):
    """Against exact sums over the Poisson distribution, cut off at the well."""
    well = round(full_well(capacity))
    k = np.arange(
        max(0, capacity - round(12 * math.sqrt(capacity))), well + 1
    )  # fewer have no share in float64

    def variance(mean):
        weights = poisson.pmf(k, mean)
        weights[-1] = poisson.sf(well - 1, mean)
        charge = k - mean
        return weights @ charge**2 - (weights @ charge) ** 2

    means = capacity + np.linspace(-1, 1, 201) * math.sqrt(capacity)
    peak = means[np.argmax([variance(mean) for mean in means])]
    # the skewness of Poisson, 1 / sqrt(mean), moves its tail at 2 to 3.5 deviations z by (z^2 - 1) / 6 e-, up to 2;
    # the well is rounded by 0.5 e-, means are 1 / 100 of a deviation apart
    assert abs(peak - capacity) < 2.5 + math.sqrt(capacity) / 100


def test_prnu_moves_the_well_further():
    """Pixels that are 1 % more sensitive than others saturate at less light: sqrt(2) times the spread at 1e4 e-."""
    plain, spread = full_well(1e4) - 1e4, full_well(1e4, 0.01) - 1e4
    assert 1.2 * plain < spread < math.sqrt(2) * plain


def test_dark_noise_in_digital_numbers_holds_the_rounding():
    numbers = math.sqrt((0.4 * 5) ** 2 + 1 / 12)
    sheet = SHEET | {"dark_noise": None, "dark_noise_dn": numbers}
    assert sensor_from_emva1288(**sheet).noise.read == pytest.approx(5, rel=1e-12)
    assert sensor_from_emva1288(**sheet | {"dark_noise": 5.0}).noise.read == 5


def test_quantum_efficiency_is_a_number_a_scaled_shape_or_a_curve():
    narrow = sensor_from_emva1288(**SHEET).qe
    assert narrow.at([500, 525, 550]).tolist() == [[0.6] * 3]
    assert (narrow.wavelengths[0], narrow.wavelengths[-1]) == (
        500,
        550,
    )  # elsewhere nothing is known
    shape = Spectrum([400, 500, 600, 700], [2, 8, 6, 1], "relative")
    scaled = sensor_from_emva1288(**SHEET, response=shape).qe
    assert scaled.at([525])[0, 0] == pytest.approx(0.6) and scaled.at([700])[0, 0] == pytest.approx(
        0.6 / 7.5
    )
    curve = Spectrum([400, 700], [[0.1, 0.5], [0.6, 0.2]], "two channels")
    sensor = sensor_from_emva1288(
        **SHEET | {"quantum_efficiency": curve, "channels": "YB", "cfa": ("YB",)}
    )
    assert np.array_equal(sensor.qe.values, curve.values)


def test_derived_figures_may_be_given_too():
    threshold = (math.sqrt(25 + 1 / 12 / 0.16) + 0.5) / 0.6
    derived = {
        "snr_max_db": 39.0,
        "dynamic_range_db": 63.2,
        "sensitivity_threshold": 9.3,
    }  # rounded as on a data sheet
    assert 20 * math.log10(math.sqrt(8000)) == pytest.approx(39.0, abs=0.05)
    assert 20 * math.log10(8000 / 0.6 / threshold) == pytest.approx(63.2, abs=0.05)
    assert threshold == pytest.approx(9.3, abs=0.06)
    sensor_from_emva1288(**SHEET, **derived)


# ---------------------------------------------------------------- mistakes


@pytest.mark.parametrize(
    ("changed", "wanted"),
    [
        ({"quantum_efficiency": 60}, "60 % of a data sheet as 0.6"),
        ({"quantum_efficiency": math.nan}, "nan"),
        ({"quantum_efficiency": "60 %"}, "wanted a number"),
        ({"wavelength": None}, "wavelength = ..."),
        ({"wavelength": 525e-9}, "35 < wavelength"),
        ({"response": Spectrum([600, 700], [1, 1])}, "above 0 at 525 nm"),
        ({"response": Spectrum([400, 500, 550], [4, 1, 1])}, "sensor.qe = 0.6 .. 2.4"),
        (
            {
                "quantum_efficiency": Spectrum([400, 700], [0.5, 0.5]),
                "response": Spectrum([400, 700], [1, 1]),
            },
            "one of",
        ),
        ({"quantum_efficiency": Spectrum([400, 500], [0.5, 0.5])}, "0 at 525 nm"),
        ({"gain": 0}, "gain = 0"),
        ({"gain": None}, "gain = None"),
        ({"gain": "0.4"}, "wanted a number"),
        ({"saturation_capacity": -1}, "saturation_capacity"),
        ({"dark_noise": -1}, "dark_noise = -1 e-"),
        ({"dark_noise": None}, "dark_noise [e-] or dark_noise_dn"),
        ({"dark_noise_dn": 5.0}, "contradicts"),
        ({"dark_noise": None, "dark_noise_dn": 0.2}, "without quantisation"),
        ({"prnu": math.inf}, "prnu = inf"),
        ({"prnu": 100.0}, "prnu = 100 %"),
        ({"dsnu_row": 3.5}, "more than dsnu = 3 e-"),
        ({"prnu_row": 0.7, "prnu_column": 0.7}, "more than prnu = 0.8 %"),
        ({"bits": 0}, "sensor.bits"),
        ({"bits": 12.5}, "sensor.bits"),
        ({"bits": 33}, "sensor.bits"),
        ({"bits": 10}, "10 bits"),
        ({"black_level": 4095}, "sensor.black_level"),
        ({"black_level": 1000}, "hold 3095 DN"),
        ({"gain": 4.0}, "12 bits"),
        ({"pixel_pitch": 3.45}, "sensor.pixel_pitch"),
        ({"dark_current": -1}, "dark_current"),
        ({"dark_current_doubling": 0}, "doubling"),
        ({"rounding": -1}, "rounding"),
        ({"snr_max_db": 42.0}, "snr_max_db = 42 contradicts"),
        ({"dynamic_range_db": 66.0}, "gives 63.1"),
        ({"sensitivity_threshold": 5.0}, "sensitivity_threshold = 5 contradicts"),
        (
            {
                "quantum_efficiency": Spectrum([400, 700], [0.5, 0.5]),
                "wavelength": None,
                "sensitivity_threshold": 9.3,
            },
            "wavelength = ...",
        ),
    ],
)
def test_contradictions_of_a_data_sheet_are_refused(changed, wanted):
    with pytest.raises(GpusimError) as error:
        sensor_from_emva1288(**SHEET | changed)
    assert wanted in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changed", "wanted"),
    [
        ({"photons": 100.0 * np.arange(22)}, "above 0"),
        ({"photons": 100.0 * np.arange(1, 21)}, "21 levels, photons 20"),
        ({"photons": -np.arange(21.0)}, "rising"),
        ({"photons": "many"}, "array of numbers"),
        ({"photons": []}, "shape"),
        ({"photons": np.full(21, np.nan)}, "NaN"),
        ({"dark": np.zeros((8, 8))}, "(frames, rows, cols)"),
        ({"dark": np.zeros((1, 8, 8))}, "2 frames or more"),
        ({"dark": exact_frames(10, 9, (8, 9))}, "8 x 9"),
        ({"dark": np.full((2, 8, 8), np.nan)}, "dark: NaN"),
        ({"dark": [[1], [2, 3]]}, "array of numbers"),
        ({"bright": [], "photons": [1.0]}, "0 levels"),
        ({"saturation_level": 30}, "an index of a level"),
        ({"saturation_level": 3}, "levels below 70 %"),
        (
            {"bright": exact_measurement()["bright"][:18], "photons": np.arange(100.0, 1801, 100)},
            "is not reached",
        ),
        ({"bright": exact_measurement()["bright"][::-1]}, "in the order of"),
        ({"dark": exact_frames(10, 5000)}, "`dark` is dark"),
        ({"dark": exact_frames(3000, 9)}, "`dark` is dark"),
        ({"bright_stack": exact_frames(500, 1000)}, "without dark_stack"),
        (
            {"dark_stack": exact_frames(10, 9), "bright_stack": exact_frames(1000, 9)},
            "99 % of saturation",
        ),
        ({"dark_stack": exact_frames(10, 9, (4, 4))}, "4 x 4"),
        ({"dark_series": {0.0: exact_frames(10, 9), 1.0: exact_frames(11, 9)}}, "three or more"),
        ({"dark_series": [exact_frames(10, 9)] * 3}, "{exposure time [s]: frames}"),
    ],
)
def test_bad_measurements_are_refused(changed, wanted):
    with pytest.raises((BadData, OutOfRange)) as error:
        photon_transfer(**exact_measurement(**changed))
    assert wanted in str(error.value) and "\n" not in str(error.value)

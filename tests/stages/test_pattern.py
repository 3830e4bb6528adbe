"""Fixed patterns of a chip and the electrons it is expected to collect: the same bits, and the statistics they promise.

`sensor.pattern` and `sensor.chip` have their cases compared bit for bit, on every device, in test_stages.py.
"""

from functools import partial
from itertools import combinations, pairwise, product

import numpy as np
import pytest
from devices import ALL, DEVICES
from scipy import stats

from gpusim.backends import open_device
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.judge.hard.acceptance import ALPHA, SIGMAS
from gpusim.kernels.sensor.chip import chip
from gpusim.kernels.sensor.pattern import PLANES, pattern
from gpusim.kernels.stage import stage_module

EVERYTHING = {
    "mean": 1.0,
    "pixel": 0.02,
    "row": 0.01,
    "column": 0.005,
    "dead": 0.01,
    "share": 0.02,
    "scale": 3.0,
    "seed": 2**63 + 1,
}
SIZE = 512
draw = partial(pattern, SIZE, SIZE, device="opencl")


@pytest.fixture(scope="module")
def whole():
    return pattern(300, 701, "dark", **EVERYTHING, device="numpy")


# ---------------------------------------------------------------- the same bits everywhere


@pytest.mark.parametrize("stage", ["sensor.pattern", "sensor.chip", "sensor.noise"])
def test_every_case_asks_for_the_same_bits(stage):
    assert {(case.metric, case.tolerance) for case in stage_module(stage).cases()} == {
        ("exact", 0.0)
    }


@pytest.mark.parametrize("name", DEVICES)
def test_a_large_plane_has_the_same_bits_on_every_device(name, whole):
    np.testing.assert_array_equal(pattern(300, 701, "dark", **EVERYTHING, device=name), whole)


def test_tiles_of_several_devices_make_one_plane(whole):
    tiles = np.empty_like(whole)
    rows, cols = [0, 1, 130, 300], [0, 7, 8, 333, 701]
    for i, ((top, bottom), (left, right)) in enumerate(product(pairwise(rows), pairwise(cols))):
        tiles[top:bottom, left:right] = pattern(
            bottom - top,
            right - left,
            "dark",
            **EVERYTHING,
            first=(top, left),
            frame_cols=701,
            device=ALL[i % len(ALL)],
        )
    np.testing.assert_array_equal(tiles, whole)


def test_width_and_work_group_do_not_matter(monkeypatch, whole):
    device = open_device("opencl")
    monkeypatch.setattr(device, "is_gpu", not device.is_gpu)  # which decides the width: 1 or 8
    np.testing.assert_array_equal(pattern(300, 701, "dark", **EVERYTHING, device=device), whole)
    launch = device.launch
    monkeypatch.setattr(
        device, "launch", lambda *args, **options: launch(*args, **{**options, "group": (2, 24)})
    )
    np.testing.assert_array_equal(pattern(300, 701, "dark", **EVERYTHING, device=device), whole)


# ---------------------------------------------------------------- statistics


def normal(z):
    """Fail unless z is a sample of standard normal numbers."""
    z = z.ravel().astype(np.float64)
    assert abs(z.mean()) < SIGMAS / np.sqrt(z.size)
    assert (
        2 * min(stats.chi2(z.size).cdf((z**2).sum()), stats.chi2(z.size).sf((z**2).sum())) > ALPHA
    )
    assert stats.kstest(z, "norm").pvalue > ALPHA
    assert abs((z[1:] * z[:-1]).mean()) < SIGMAS / np.sqrt(z.size)


@pytest.mark.parametrize("plane", PLANES)
def test_pixels_are_normal(plane):
    normal((draw(plane, mean=5.0, pixel=2.0) - 5) / 2)


def test_rows_and_columns_are_normal_and_have_one_value_each():
    in_rows = pattern(2**16, 3, "offset", row=2.0, device="opencl")
    assert np.ptp(in_rows, axis=1).max() == 0
    normal(in_rows[:, 0] / 2)
    in_columns = pattern(3, 2**16, "offset", column=2.0, device="opencl")
    assert np.ptp(in_columns, axis=0).max() == 0
    normal(in_columns[0] / 2)
    assert abs(np.mean(in_rows[:, 0] * in_columns[0]) / 4) < SIGMAS / 2**8


def test_pixel_row_and_column_parts_are_recovered():
    """Analysis of variance, two-way: EMVA 1288 release 4, section 8 on the spatial variances."""
    pixel, row, column = 0.02, 0.01, 0.005
    value = draw("response", mean=1.0, pixel=pixel, row=row, column=column, seed=4).astype(
        np.float64
    )
    rows, cols = value.mean(1, keepdims=True), value.mean(0, keepdims=True)
    rest = ((value - rows - cols + value.mean()) ** 2).sum() / (SIZE - 1) ** 2
    error = SIGMAS * np.sqrt(2 / (SIZE - 1))  # relative error of a variance of 512 numbers
    assert rest == pytest.approx(pixel**2, rel=error / np.sqrt(SIZE))
    # the mean over a row keeps pixel^2 / SIZE
    assert rows.var(ddof=1) == pytest.approx(row**2 + pixel**2 / SIZE, rel=error)
    assert cols.var(ddof=1) == pytest.approx(column**2 + pixel**2 / SIZE, rel=error)
    assert value.mean() == pytest.approx(
        1, abs=SIGMAS * np.sqrt((row**2 + column**2) / SIZE + pixel**2 / SIZE**2)
    )


def test_planes_seeds_rows_columns_and_pixels_are_independent():
    others = [draw(plane, pixel=1.0) for plane in PLANES]
    others += [draw("dark", pixel=1.0, seed=seed) for seed in (1, 2**32)]
    others += [draw("dark", share=1.0, scale=1.0) - 1]  # exponential numbers of mean 1
    for one, other in combinations(others, 2):
        assert abs((one * other.astype(np.float64)).mean()) < SIGMAS / SIZE
    assert not np.array_equal(draw("dark", row=1.0)[:, 0], draw("dark", row=1.0, seed=1)[:, 0])


@pytest.mark.parametrize("part", [1e-3, 0.3, 1.0])
def test_dead_pixels_are_that_part(part):
    value = draw("response", mean=1.0, pixel=1e-3, dead=part)
    assert stats.binomtest(int((value == 0).sum()), value.size, part).pvalue > ALPHA
    np.testing.assert_array_equal(
        value[value != 0], draw("response", mean=1.0, pixel=1e-3)[value != 0]
    )


@pytest.mark.parametrize("part", [3e-3, 0.3, 1.0])
def test_chosen_pixels_are_that_part_and_exponential(part):
    value = draw("telegraph", share=part, scale=7.0)
    chosen = value[value > 0].astype(np.float64)
    assert stats.binomtest(chosen.size, value.size, part).pvalue > ALPHA
    assert stats.kstest(chosen, "expon", args=(0, 7.0)).pvalue > ALPHA
    # 2 sum / scale is chi-square distributed with two degrees of freedom per number
    total = stats.chi2(2 * chosen.size)
    assert 2 * min(total.cdf(2 * chosen.sum() / 7), total.sf(2 * chosen.sum() / 7)) > ALPHA


def test_dead_and_chosen_pixels_are_independent():
    value = draw("dark", mean=1.0, dead=0.1, share=0.1, scale=1.0)
    chosen = (value != 0) & (value != 1)
    # chosen and below 1: dead (a tenth of them), and what was added is below 1
    assert (
        stats.binomtest(
            int((value[chosen] < 1).sum()), int(chosen.sum()), 0.1 * -np.expm1(-1)
        ).pvalue
        > ALPHA
    )


@pytest.mark.parametrize(
    ("key", "value", "error"),
    [
        ("dead", -0.1, OutOfRange),
        ("share", 1.1, OutOfRange),
        ("share", np.nan, OutOfRange),
        ("seed", 2**64, OutOfRange),
        ("plane", "hot", UnknownName),
    ],
)
def test_impossible_patterns_are_named(key, value, error):
    with pytest.raises(error, match=key):
        pattern(**{"rows": 2, "cols": 2, "plane": "dark", key: value}, device=DEVICES[0])


# ---------------------------------------------------------------- expected electrons


def test_expected_electrons_follow_the_formula():
    random = np.random.default_rng(2)
    mean, dark = random.exponential(100, (40, 50)), random.exponential(1, (40, 50))
    response = random.normal(1, 0.5, (40, 50))
    expected = chip(
        mean.astype(np.float32),
        response.astype(np.float32),
        dark.astype(np.float32),
        scale=0.3,
        dark_time=2.5,
        device="numpy",
    )
    # four roundings of 2^-24 each, beside those of the inputs and of both factors; the sum has no cancellation
    np.testing.assert_allclose(
        expected, 0.3 * mean * np.maximum(response, 0) + 2.5 * dark, rtol=8 * 2.0**-24
    )


@pytest.mark.parametrize(
    ("key", "value", "error"),
    [
        ("scale", -1.0, OutOfRange),
        ("dark_time", np.inf, OutOfRange),
        ("response", np.ones((2, 3), np.float32), BadData),
    ],
)
def test_impossible_expectations_are_named(key, value, error):
    with pytest.raises(error, match=key):
        chip(np.ones((2, 2), np.float32), **{key: value}, device=DEVICES[0])

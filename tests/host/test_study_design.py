"""Designs of studies: what is drawn, what is refused before any work, yields and sensitivities by outside formulas."""

import math

import numpy as np
import pytest
import scipy.stats

import gpusim as gs
from gpusim.apps.study.design import open_design
from gpusim.apps.study.requirements import (
    Requirement,
    clopper_pearson_interval,
    wilson_interval,
)
from gpusim.apps.study.sampling import Distribution, Sampling
from gpusim.apps.study.sensitivity import find_sensitivities, find_slopes

FILE = """camera = "figure8"
sampling = {method = "latin", count = 4, seed = 1}
[vary]
"optics.defocus_um" = {normal = [0, 5]}
[scenes]
edge = {scene = "slanted-edge", size = [96, 96]}
[measures]
mtf50 = true
[requirements]
sharp = "mtf50 >= 0.2"
"""
DEFOCUS = '"optics.defocus_um" = {normal = [0, 5]}'
WRONG = [  # text of the file, its replacement, and words of the error
    ("defocus_um", "defocus_mm", "did you mean 'optics.defocus_um'"),
    ("normal = [0, 5]", "nromal = [0, 5]", "did you mean 'normal'"),
    ("normal = [0, 5]", "normal = [0, -5]", "deviation 0 or more"),
    ("normal = [0, 5]", "uniform = [5, 1]", "low < high"),
    ("normal = [0, 5]", 'uniform = ["a", 1]', "wanted a number"),
    ("normal = [0, 5]", "normal = [0, 5], limits = [90, 99]", "hold some of its values"),
    (DEFOCUS, '"optics.f_number" = {uniform = [-1, 5]}', "allowed is 0.1 <= f_number"),
    (DEFOCUS, '"optics.model" = {choice = ["none", "magic"]}', "unknown optics.model 'magic'"),
    (DEFOCUS, f"{DEFOCUS}\ndefocus_um = {{uniform = [0, 1]}}", "set the same"),
    (DEFOCUS, '"optics.f_number[1]" = {uniform = [1, 2]}', "a place in a list"),
    (DEFOCUS, '"optics.nothing[1]" = {uniform = [1, 2]}', "unknown key of a camera"),
    ("mtf50 = true", "mtf51 = true", "did you mean 'mtf50'"),
    ("mtf50 = true", 'mtf50 = "edgy"', "did you mean 'edge'"),
    ("mtf50 = true", 'own = {function = "no_such_module:f"}', "cannot be imported"),
    ("mtf50 = true", 'own = {function = "math:no_such"}', "no function 'no_such'"),
    ("mtf50 = true", 'own = {function = "math"}', 'wanted "module:function"'),
    ("slanted-edge", "flat", "no scene of the study fits"),
    ("slanted-edge", "slantd-edge", "did you mean 'slanted-edge'"),
    ("size = [96, 96]", "sise = [96, 96]", "did you mean 'size'"),
    ("size = [96, 96]", 'size = "big"', "wanted [columns, rows]"),
    ("size = [96, 96]", "size = [96, 96], patch = [0, 0, 99, 5]", "inside the frame of 96 rows"),
    ("mtf50 >= 0.2", "mtf50 => 0.2", "wanted a text such as"),
    ("mtf50 >= 0.2", "snr >= 0.2", "unknown measure of the requirement sharp"),
    ("mtf50 >= 0.2", "mtf50@flat >= 0.2", "unknown scene of the requirement sharp"),
    ("sharp =", "scene =", "two columns"),
    ('"figure8"', '"figure9"', "did you mean 'figure8'"),
    ('"figure8"', '{base = "figure8", "optics.f_nmber" = 2}', "did you mean 'optics.f_number'"),
    ('"latin"', '"latn"', "did you mean 'latin'"),
    ("count = 4", "count = 0", "a whole number, 1 .."),
    ("count = 4, ", "", "latin needs count"),
    ('method = "latin", count = 4, seed = 1', 'method = "grid"', "listed values"),
    ("[vary]", "seeds = 0\n[vary]", "seeds = 0"),
    ("[vary]", 'tolerance = "vidio"\n[vary]', "did you mean 'video'"),
    ("[vary]", "[varry]", "did you mean 'vary'"),
    ("[vary]", "[vary", "not TOML"),
]


@pytest.mark.parametrize(("text", "other", "words"), WRONG, ids=[row[1] for row in WRONG])
def test_a_wrong_design_is_refused_in_one_line(text, other, words, tmp_path):
    assert FILE.count(text) == 1
    path = tmp_path / "design.toml"
    path.write_text(FILE.replace(text, other))
    with pytest.raises(gs.GpusimError) as error:
        open_design(path)
    message = str(error.value)
    assert words in message and "design.toml" in message and "\n" not in message


def test_rows_know_their_camera_scene_and_seed(tmp_path):
    path = tmp_path / "design.toml"
    path.write_text(
        FILE.replace("[vary]", "seeds = [5, 7]\n[vary]").replace(
            "[measures]", 'flat = {scene = "flat", size = [8, 8]}\n[measures]'
        )
    )
    design = open_design(path)
    assert len(design) == 4 * 2 * 2
    found = [design.place_of(row) for row in range(6)]
    assert found[:3] == [(0, "edge", 5), (0, "edge", 7), (0, "flat", 5)]
    assert found[4] == (1, "edge", 5)
    assert design.columns == (
        ["row", "camera", "scene", "seed", "optics.defocus_um", "mtf50", "sharp", "error"]
    )
    assert design.camera(2).optics.defocus == 1e-6 * design.sampling.draw(2)["optics.defocus_um"]


def test_one_number_of_a_list_varies():
    """Coma and astigmatism of one wavefront; the others keep their values."""
    table = {
        "camera": {"base": "figure8", "optics": {"zernike_waves": [0.0, 0.0, 0.0, 0.25]}},
        "sampling": {"method": "montecarlo", "count": 3},
        "vary": {
            "optics.zernike_waves[4]": {"grid": [0.1]},
            "optics.zernike_waves[6]": {"grid": [0.2]},
        },
        "scenes": {"flat": {"scene": "flat", "size": [8, 8]}},
        "measures": ["dynamic_range"],
    }
    found = open_design(table).camera(1).optics
    expected = gs.open_camera("figure8").with_(zernike_waves=[0, 0, 0, 0.25, 0.1, 0, 0.2]).optics
    assert repr(found.wavefront) == repr(expected.wavefront)


# -------------------------------------------------------------------------------------------------------- sampling


def sampled(method, kind, count=2000):
    one = Distribution.parse("a", kind)
    sampling = Sampling.parse({"method": method, "count": count, "seed": 3}, {"a": one, "b": one})
    drawn = [sampling.draw(k) for k in range(count)]
    return np.array([row["a"] for row in drawn]), np.array([row["b"] for row in drawn])


@pytest.mark.parametrize("method", ["latin", "montecarlo"])
@pytest.mark.parametrize(
    ("kind", "law"),
    [
        ({"uniform": [2, 5]}, scipy.stats.uniform(2, 3)),
        ({"loguniform": [0.1, 10]}, scipy.stats.loguniform(0.1, 10)),
        ({"normal": [1, 2]}, scipy.stats.norm(1, 2)),
        ({"normal": [1, 2], "limits": [0, 4]}, scipy.stats.truncnorm(-0.5, 1.5, 1, 2)),
        ({"lognormal": [2, 0.3]}, scipy.stats.lognorm(0.3, scale=2)),
    ],
)
def test_values_follow_their_law(method, kind, law):
    """Kolmogorov's test of 2000 values; the two keys are independent: |r| < 4 / sqrt(2000)."""
    first, second = sampled(method, kind)
    for values in (first, second):
        found = scipy.stats.kstest(values, law.cdf)
        assert found.pvalue > 1e-4
    assert abs(scipy.stats.spearmanr(first, second).statistic) < 4 / 2000**0.5
    if method == "latin":  # one value in each of 2000 equal shares
        assert sorted((law.cdf(first) * 2000 - 1e-9).astype(int)) == [*range(2000)]


def test_a_grid_has_all_combinations():
    keys = {"a": Distribution.parse("a", {"grid": [1, 2]})}
    keys["b"] = Distribution.parse("b", {"choice": ["x", "y", "z"]})
    grid = Sampling.parse({"method": "grid"}, keys)
    found = [tuple(grid.draw(k).values()) for k in range(len(grid))]
    assert found == [(1, "x"), (1, "y"), (1, "z"), (2, "x"), (2, "y"), (2, "z")]


def test_one_key_at_a_time():
    keys = {"a": Distribution.parse("a", {"uniform": [0, 10]})}
    keys["b"] = Distribution.parse("b", {"grid": [1, 2, 3]})
    alone = Sampling.parse({"method": "one-at-a-time", "count": 3}, keys)
    found = [tuple(np.round([*alone.draw(k).values()], 9)) for k in range(len(alone))]
    assert found == [(5, 2), (0.5, 2), (5, 2), (9.5, 2), (5, 1), (5, 2), (5, 3)]


# ------------------------------------------------------------------------------------------- yields, sensitivities


@pytest.mark.parametrize(("passed", "count"), [(0, 10), (1, 10), (7, 10), (950, 1000), (10, 10)])
def test_intervals_are_those_of_scipy(passed, count):
    test = scipy.stats.binomtest(passed, count)
    for name, found in (
        ("wilson", wilson_interval(passed, count)),
        ("exact", clopper_pearson_interval(passed, count)),
    ):
        expected = test.proportion_ci(0.95, method=name)
        assert found == pytest.approx((expected.low, expected.high), abs=1e-9)


def test_a_requirement_judges_its_own_rows():
    made = {"mtf50": ("edge",), "snr": ("edge", "flat")}
    one = Requirement.parse("a", "snr@flat > 30", made)
    assert one.judge("edge", {"snr": 50.0}) is None
    assert one.judge("flat", {"snr": 30.0}) is False
    assert one.judge("flat", {"snr": None}) is False
    every = Requirement.parse("a", "snr<=30", made)
    assert every.judge("edge", {"snr": 30.0}) is True and every.words == "snr <= 30"


def test_sensitivities_of_a_known_model():
    """y = 3 a - 4 b + noise of 1, all of unit variance, and a parabola; ranks by SciPy."""
    random = np.random.default_rng(2)
    a, b, c = random.normal(size=(3, 4000))
    y = 3 * a - 4 * b + random.normal(size=4000)
    found = find_sensitivities("y", "s", {"a": a.tolist(), "b": b.tolist(), "c": c.tolist()}, y)
    expected = np.array([3, -4, 0]) / math.sqrt(26)
    for one, coefficient, values in zip(found, expected, (a, b, c), strict=True):
        assert one.regression == pytest.approx(coefficient, abs=4 / 4000**0.5)
        assert one.rank == pytest.approx(scipy.stats.spearmanr(values, y).statistic, abs=1e-9)
        # bins of 1 / 20 of the values leave about 1 % of a normal key's variance inside them
        assert one.main == pytest.approx(coefficient**2, abs=0.05)
        assert one.explained == pytest.approx(25 / 26, abs=0.01)
    # of a parabola no line tells anything; the outer two bins of a hold 1 / 10 of all values, and spread most
    bent = find_sensitivities("y", "s", {"a": a.tolist()}, a**2)[0]
    assert abs(bent.regression) < 0.1 and bent.main > 0.8


def test_sensitivities_to_names_and_without_variation():
    names = ["x", "y"] * 20
    values = np.array([1.0, 2.0] * 20) + np.linspace(0, 0.01, 40)
    found = find_sensitivities("m", "s", {"k": names}, values)[0]
    assert math.isnan(found.rank) and found.main > 0.99
    assert math.isnan(find_sensitivities("m", "s", {"k": names}, np.ones(40))[0].main)


def test_slopes_of_one_key_at_a_time():
    points = {"a": [(0.0, 1.0), (1.0, 3.0), (2.0, 5.0)], "b": [(0.0, 1.0), (1.0, math.nan)]}
    first, second = find_slopes("m", "s", points)
    assert first.slope == pytest.approx(2) and math.isnan(second.slope)

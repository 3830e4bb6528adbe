"""Charts: where things are, how bright, and that pixels hold averages over their area."""

import warnings

import numpy as np
import pytest

from gpusim.data.charts import CHARTS, chart, colorchecker_patches, half_plane_coverage
from gpusim.data.colorimetry import xyz
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.domain.content import Materials
from gpusim.domain.errors import DoesNotFit, OutOfRange, UnknownName
from gpusim.domain.spectrum import Spectrum, energy_from_photons


def gray(scene):
    """Reflectance of every pixel of a chart of one neutral material."""
    assert (scene.content.ids == 0).all() and (scene.content.spectra == 1).all()
    return scene.content.shading


@pytest.mark.parametrize("name", CHARTS)
def test_every_chart_is_a_scene_in_the_light_asked_for(name):
    scene = chart(
        name, size=(60, 40), light="A", luminance=300.0, wavelengths=np.arange(380.0, 781.0, 20)
    )
    assert (
        scene.shape == (40, 60)
        and scene.name == name
        and scene.border == ("zero" if name == "points" else "edge")
    )
    assert isinstance(scene.content, Materials) and scene.light_is_known
    assert scene.content.spectra.shape[1] == len(scene.wavelengths) == 21
    assert scene.content.shading.dtype == np.float32 and scene.content.ids.dtype == np.uint8
    assert xyz(energy_from_photons(scene.illuminant))[1] == pytest.approx(
        300, rel=1e-13
    )  # rounding
    white = energy_from_photons(scene.illuminant)
    np.testing.assert_allclose(
        white.values / white.values.max(),
        illuminant("A").values / illuminant("A").values.max(),
        rtol=1e-14,
    )


@pytest.mark.parametrize("name", CHARTS)
def test_default_size_and_sameness(name):
    one, two = chart(name), chart(name)
    assert one.shape == (512, 768)
    np.testing.assert_array_equal(one.wavelengths, np.arange(400, 701, 10))
    np.testing.assert_array_equal(one.content.ids, two.content.ids)
    np.testing.assert_array_equal(one.content.shading, two.content.shading)


@pytest.mark.parametrize("name", [name for name in CHARTS if name != "colorchecker"])
@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1), (3, 5)])
def test_small_sizes(name, size):
    options = {"count": 1} if name == "points" else {}
    assert chart(name, size=size, **options).shape == size[::-1]


# ---- ColorChecker


@pytest.mark.parametrize(
    "size", [(24, 16), (25, 18), (31, 22), (40, 27), (97, 65), (768, 512), (1920, 1080), (64, 500)]
)
def test_colorchecker_patches_are_where_they_are_said_to_be(size):
    patches = colorchecker_patches(size)
    content = chart("colorchecker", size=size).content
    assert len(patches) == 24
    seen = np.zeros(size[::-1], int)
    sides = {part.stop - part.start for patch in patches for part in patch}
    assert len(sides) == 1 and sides.pop() >= 2
    for number, patch in enumerate(patches):
        assert (content.ids[patch] == number).all() and (content.shading[patch] == 1).all()
        seen[patch] += 1
        around = tuple(slice(part.start - 1, part.stop + 1) for part in patch)
        # Each patch is surrounded by the black frame on all sides, so it lies inside the picture with room to spare.
        assert (content.shading[around] == 0.5).sum() == 4 * (patch[0].stop - patch[0].start) + 4
    assert seen.max() == 1
    rows = [patch[0].start for patch in patches]
    cols = [patch[1].start for patch in patches]
    assert rows == sorted(rows) and cols[:6] == sorted(cols[:6]) and cols[:6] == cols[18:]
    if size != (25, 18):  # there the frame reaches the edge of the picture
        assert content.shading[0, 0] == 1 and content.ids[0, 0] == 21  # the surroundings


def test_colorchecker_colours_are_those_of_colour_science():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # optional packages, alignment of tables
        import colour

        sds = colour.SDS_COLOURCHECKERS["ISO 17321-1"]
        light = colour.SDS_ILLUMINANTS["D50"]
        theirs = np.array(
            [colour.sd_to_XYZ(sd, illuminant=light, method="Integration") for sd in sds.values()]
        )
    scene = chart("colorchecker", light="D50", luminance=100, wavelengths=np.arange(380.0, 781, 5))
    ours = xyz(
        Spectrum(scene.wavelengths, scene.content.spectra), energy_from_photons(scene.illuminant)
    )
    # theirs: 1 nm sums of tables interpolated by Sprague's polynomial, ours: exact integrals of linear ones. The tables
    # differ by 5^2 / 12 of second derivatives: measured 1e-4 of white (100) in the dark blue; anything else, such as
    # a wrong patch, is 1 or more.
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=0.05)


def test_colorchecker_refuses_what_is_too_small():
    with pytest.raises(OutOfRange, match="at least 24 x 16"):
        chart("colorchecker", size=(23, 16))


# ---- slanted edge


@pytest.mark.parametrize("angle", [0, 1e-7, 5, -5, 30, 45, 60, 85, 90, -90])
def test_half_plane_coverage_is_the_area(angle):
    across, along = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    distance = np.linspace(-1, 1, 41)
    n = 400
    sub = (np.arange(n) + 0.5) / n - 0.5
    inside = sub[None, None, :] * across + sub[None, :, None] * along + distance[:, None, None]
    counted = ((inside > 0) + 0.5 * (np.abs(inside) < 1e-12)).mean((1, 2))
    # A line crosses at most 2 n of the n^2 cells, and each counts wrongly by at most 1/2.
    np.testing.assert_allclose(
        half_plane_coverage(distance, across, along), counted, rtol=0, atol=1 / n
    )
    # Exact: a pixel and its mirror image make one whole.
    both = half_plane_coverage(distance, across, along) + half_plane_coverage(
        -distance, across, along
    )
    np.testing.assert_allclose(both, 1, rtol=0, atol=1e-12)


def test_slanted_edge_runs_where_the_angle_says():
    scene = chart("slanted-edge", size=(200, 100), angle_deg=5.0, contrast=4.0, bright=0.8)
    values = gray(scene)
    assert values.max() == np.float32(0.8) and values.min() == np.float32(0.2)
    bright = (values.astype(float) - 0.2) / 0.6
    y = np.arange(100) - 49.5
    # The bright area of a row of height 1 under a straight line is cols/2 + y tan(angle), whatever the pixels are;
    # float32 pixels err by 3e-8 each, 200 of them by at most 6e-6 / 0.6.
    np.testing.assert_allclose(bright.sum(1), 100 + y * np.tan(np.deg2rad(5)), rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    "options",
    [{"angle_deg": 91}, {"contrast": 0.9}, {"bright": 0}, {"bright": 1.1}, {"contrast": np.nan}],
)
def test_slanted_edge_options(options):
    with pytest.raises(OutOfRange, match=f"slanted-edge: {next(iter(options))} = "):
        chart("slanted-edge", **options)


# ---- ramp, flat, sweep


def test_ramp_is_linear_or_logarithmic():
    values = gray(chart("ramp", size=(1000, 2), low=0.0, high=1.0))
    # Averages of a linear ramp over its pixels are the values in their middles; float32 holds them to 6e-8.
    np.testing.assert_allclose(values[1], (np.arange(1000) + 0.5) / 1000, rtol=6e-8)
    values = gray(chart("ramp", size=(4, 1), high=100.0, decades=4.0))
    np.testing.assert_allclose(
        values[0], 100 * 10.0 ** np.array([-3.5, -2.5, -1.5, -0.5]), rtol=6e-8
    )


def test_flat_is_flat():
    assert (gray(chart("flat", reflectance=0.25)) == 0.25).all()


def test_sweep_is_the_average_over_each_pixel():
    from scipy.integrate import quad

    cols = 64
    values = gray(chart("sweep", size=(cols, 1), contrast=0.7))[0]
    for x in (0, 1, 31, 62, 63):
        wanted = quad(
            lambda t: 0.5 * (1 + 0.7 * np.cos(np.pi * t**2 / (2 * cols))), x, x + 1, epsabs=1e-12
        )[0]
        assert values[x] == pytest.approx(wanted, abs=6e-8)  # float32
    # The phase grows by pi / 2 (2 x + 1) / cols per pixel: half a period, Nyquist, at the right end.
    assert np.pi / 2 * (2 * cols - 1) / cols == pytest.approx(np.pi, rel=1 / cols)


# ---- points


def test_points_span_their_range_on_a_dim_background():
    scene = chart("points", size=(100, 80), count=24, background=1e-3, lowest=1e2, highest=1e6)
    shading = scene.content.shading
    found = np.sort(shading[shading > np.float32(1e-3)])
    assert scene.border == "zero" and len(found) == 24
    np.testing.assert_allclose(found, 1e-3 * np.geomspace(1e2, 1e6, 24), rtol=6e-8)  # float32
    assert (scene.content.ids[shading == np.float32(1e-3)] == 0).all()
    assert scene.content.spectra.max() == 1 and len(set(scene.content.ids[shading > 0.05])) == 7
    other = chart("points", size=(100, 80), seed=1).content.shading
    assert (shading != other).any()


@pytest.mark.parametrize(
    "options",
    [
        {"count": 0},
        {"count": 8001},
        {"count": 1.5},
        {"background": 0},
        {"lowest": 0},
        {"highest": 1.0},
    ],
)
def test_points_options(options):
    with pytest.raises(OutOfRange, match=f"points: {next(iter(options))} = "):
        chart("points", size=(100, 80), **options)


# ---- dead leaves


def test_deadleaves_show_measured_surfaces_alike_everywhere():
    scene = chart("deadleaves", size=(512, 512))
    np.testing.assert_array_equal(scene.content.spectra, reflectances("nature").values)
    ids = scene.content.ids
    share = np.bincount(ids.ravel(), minlength=79) / ids.size
    assert (share > 0).all() and share.max() < 0.2
    assert (chart("deadleaves", size=(512, 512), seed=2).content.ids != ids).mean() > 0.9


@pytest.mark.parametrize("lag", [1, 4, 16])
def test_deadleaves_correlate_as_theory_says(lag):
    from scipy.integrate import quad

    smallest, largest = 4.0, 64.0  # a third of 192 pixels

    def overlap(radius):
        """Area that a disc shares with itself moved by `lag`."""
        half = min(1.0, lag / (2 * radius))
        return 2 * radius**2 * (np.arccos(half) - half * np.sqrt(1 - half**2))

    shared = quad(lambda radius: radius**-3 * overlap(radius), smallest, largest)[0]
    alone = quad(lambda radius: radius**-3 * np.pi * radius**2, smallest, largest)[0]
    # Both points belong to the topmost leaf that covers either of them (Matheron; Lee, Mumford & Huang 2001, eq. 4);
    # otherwise two leaves are of one surface by chance, 1 in 79.
    one_leaf = shared / (2 * alone - shared)
    wanted = one_leaf + (1 - one_leaf) / 79
    found = []
    for seed in range(16):
        ids = chart("deadleaves", size=(192, 192), seed=seed).content.ids
        found.append((ids[:, lag:] == ids[:, :-lag]).mean())
    # 4.5 standard errors of the mean of 16 pictures, 1e-5 false alarms (few degrees of freedom: 5e-4), for fixed seeds.
    assert np.mean(found) == pytest.approx(wanted, abs=4.5 * np.std(found, ddof=1) / 4)
    assert 4.5 * np.std(found, ddof=1) / 4 < 0.07  # so that it can fail


@pytest.mark.parametrize(
    "options, error, message",
    [
        ({"smallest": 0.5}, OutOfRange, "deadleaves: smallest"),
        ({"surfaces": "munsel"}, UnknownName, "'munsell'"),
    ],
)
def test_deadleaves_options(options, error, message):
    with pytest.raises(error, match=message):
        chart("deadleaves", size=(20, 20), **options)


# ---- what is refused


def test_unknown_chart_names_the_nearest():
    with pytest.raises(
        UnknownName, match="unknown chart 'slanted_edge'; did you mean 'slanted-edge'"
    ):
        chart("slanted_edge")


def test_unknown_option_names_the_nearest():
    with pytest.raises(
        UnknownName,
        match="unknown option of chart 'flat' 'reflectanse'; did you mean 'reflectance'",
    ):
        chart("flat", reflectanse=0.5)
    with pytest.raises(UnknownName, match="unknown option of chart 'flat' 'rows'"):
        chart("flat", rows=5)


@pytest.mark.parametrize("size", [(0, 10), (10, 0), (-1, 5), (10.5, 10)])
def test_impossible_sizes(size):
    with pytest.raises(OutOfRange, match="at least 1 x 1"):
        chart("flat", size=size)


@pytest.mark.parametrize("name", CHARTS)
def test_absurd_sizes_are_refused_before_anything_is_allocated(name):
    with pytest.raises(DoesNotFit, match=r"1000000 x 1000000 pixels needs about \d+\.\d+ GiB"):
        chart(name, size=(1_000_000, 1_000_000))


def test_other_refusals():
    with pytest.raises(UnknownName, match="did you mean 'D65'"):
        chart("flat", light="D66")
    with pytest.raises(OutOfRange, match="luminance"):
        chart("flat", luminance=0)
    with pytest.raises(OutOfRange, match="flat: reflectance = -1"):
        chart("flat", reflectance=-1)
    with pytest.raises(OutOfRange, match="ramp: decades = 13"):
        chart("ramp", decades=13)
    with pytest.raises(OutOfRange, match="sweep: contrast = 2"):
        chart("sweep", contrast=2)

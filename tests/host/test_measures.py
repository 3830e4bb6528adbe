"""Measures of pictures, against closed forms, published numbers, colour-science and sums written out."""

from dataclasses import replace

import numpy as np
import pytest

from gpusim import Basis, Cube, Display, GpusimError, Layer, Materials, Scene, chart
from gpusim.data.charts import colorchecker_patches
from gpusim.data.lights import illuminant, white_radiance
from gpusim.data.reflectances import reflectances
from gpusim.domain.scene import unit_light
from gpusim.kernels.sensor.bin import binned_shape
from gpusim.measure import (
    ciede2000,
    cpsnr,
    ideal,
    samples_per_degree,
    scielab,
    snr,
    ssim,
    visible_snr,
)
from gpusim.measure.difference import blur_as_eye, cielab

WHITE = Display().xyz_from_rgb.sum(1)
NODES = np.arange(400.0, 701.0, 10.0)
# Zhang & Wandell 1997: table 1, pairs of weight and spread [degree] of luminance, red-green and blue-yellow; and XYZ
# to these by the authors' program, in thousandths, of which the paper has .279 .72 -.107, -.449 .29, .086 -.59 .501
GAUSSIANS = [
    [(0.921, 0.0283), (0.105, 0.133), (-0.108, 4.336)],
    [(0.531, 0.0392), (0.330, 0.494)],
    [(0.488, 0.0536), (0.371, 0.386)],
]
OPPONENT = (
    np.array(
        [
            [278.7336, 721.8031, -106.5520],
            [-448.7736, 289.8056, 77.1569],
            [85.9513, -589.9859, 501.1089],
        ]
    )
    / 1000
)
GREY = 0.2 * WHITE * np.ones((48, 48, 1))


def xyz_from_lab(lab, white):
    """CIE 1976 inverted, as CIE 15 writes it; lab (..., 3)."""
    y = (lab[..., 0] + 16) / 116
    f = np.stack([y + lab[..., 1] / 500, y, y - lab[..., 2] / 200], axis=-1)
    ratio = np.where(f > 6 / 29, f**3, 3 * (6 / 29) ** 2 * (f - 4 / 29))
    return ratio * white


# Sharma, Wu & Dalal 2005, "The CIEDE2000 color-difference formula", table 1: pairs 1, 2, 4, 7, 9, 17, 25, 31 and 34
SHARMA = [
    ((50, 2.6772, -79.7751), (50, 0, -82.7485), 2.0425),
    ((50, 3.1571, -77.2803), (50, 0, -82.7485), 2.8615),
    ((50, -1.3802, -84.2814), (50, 0, -82.7485), 1.0000),
    ((50, 0, 0), (50, -1, 2), 2.3669),
    ((50, 2.49, -0.001), (50, -2.49, 0.0009), 7.1792),
    ((50, 2.5, 0), (73, 25, -18), 27.1492),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((22.7233, 20.0904, -46.694), (23.0331, 14.973, -42.5619), 2.0373),
    ((2.0776, 0.0795, -1.135), (0.9033, -0.0636, -0.5514), 0.9082),
]


def test_ciede2000_of_published_pairs():
    """Given to 4 decimals; XYZ there and back leave 1e-9."""
    first, second, known = (np.array(column, np.float64) for column in zip(*SHARMA, strict=True))
    for white in (WHITE, np.array([96.42, 100, 82.49])):
        found = ciede2000(xyz_from_lab(first, white), xyz_from_lab(second, white), white)
        assert found == pytest.approx(known, abs=6e-5)
    assert ciede2000(xyz_from_lab(first, WHITE), xyz_from_lab(second, WHITE)) == pytest.approx(
        known, abs=6e-5
    )


def seen_by_colour(light, shown):
    """XYZ of the ColorChecker in a light, adapted (Bradford) to `format_value`: by colour-science, 1 nm, (24, 3)."""
    import colour

    table = reflectances("colorchecker")
    shape, power = colour.SpectralShape(400, 700, 1), illuminant(light)
    power = colour.SpectralDistribution(power.at(np.arange(400, 701)), np.arange(400, 701))
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(shape)
    white = np.array(
        colour.sd_to_XYZ(colour.sd_ones(shape), cmfs, power, method="Integration", shape=shape)
    )
    patches = []
    for values in table.at(NODES):
        patch = colour.SpectralDistribution(values, NODES).interpolate(shape)
        patches.append(colour.sd_to_XYZ(patch, cmfs, power, method="Integration", shape=shape))
    return colour.chromatic_adaptation(
        np.array(patches) / 100, white / white[1], shown, method="Von Kries", transform="Bradford"
    )


@pytest.mark.parametrize("light", ["D65", "A", "FL2"])
@pytest.mark.parametrize("white", [(0.3127, 0.3290), (0.3457, 0.3585)])
def test_ideal_colorchecker(light, white):
    """Against colour-science; samples of 10 nm are joined by a cubic spline here, by Sprague's quintics there.

    They part where a patch's edge lies between nodes: 1e-3 of the patch's own XYZ, no more than 5e-4 of white.
    """
    display = Display(white=white)
    shown = display.xyz_from_rgb.sum(1)
    xyz = ideal(chart("colorchecker", size=(96, 64), light=light), display)
    assert xyz.shape == (64, 96, 3) and xyz.dtype == np.float64
    found = np.array([xyz[patch].mean(axis=(0, 1)) for patch in colorchecker_patches((96, 64))])
    assert found == pytest.approx(seen_by_colour(light, shown), abs=5e-4)
    assert ideal(
        chart("flat", size=(3, 2), light=light, reflectance=0.18), display
    ) == pytest.approx(np.tile(0.18 * shown, (2, 3, 1)))
    in_daylight = ideal(chart("colorchecker", size=(96, 64), light=light), display, light="D65")
    assert in_daylight == pytest.approx(
        ideal(chart("colorchecker", size=(96, 64), light="D65"), display), abs=1e-12
    )


def test_ideal_of_every_kind_of_scene():
    """Cube, basis and materials of the same surfaces; a margin that is not shown; radiance whose light is not known."""
    random = np.random.default_rng(0)
    light, spectra = white_radiance(illuminant("D65"), 50.0), reflectances("colorchecker").at(NODES)
    ids, shading = random.integers(0, 24, (7, 9)), random.uniform(0.2, 1, (7, 9)).astype(np.float32)
    cube = (spectra[ids] * shading[..., None]).transpose(2, 0, 1)
    one = ideal(Scene(Materials(NODES, ids.astype(np.uint8), shading, spectra), light))
    share = np.moveaxis(np.eye(24, dtype=np.float32)[ids] * shading[..., None], -1, 0)
    # float32 of the samples: 6e-8 of each
    assert ideal(Scene(Cube(NODES, cube.astype(np.float32)), light)) == pytest.approx(one, abs=1e-7)
    assert ideal(Scene(Basis(NODES, share, spectra), light)) == pytest.approx(one, abs=1e-7)
    margin = Scene(Cube(NODES, cube.astype(np.float32)), light, "scene", margin=2)
    assert ideal(margin) == pytest.approx(one[2:-2, 2:-2], abs=1e-7)
    # the light's 50 cd/m2 are those of 360 .. 830 nm, the scene's end at 400 and 700: 1e-4 of D65's
    assert ideal(margin, luminance=100.0) == pytest.approx(one[2:-2, 2:-2] / 2, rel=1e-3, abs=1e-7)
    radiance = (cube * light.at(NODES)[:, None, None]).astype(np.float32)
    unknown = Scene(Cube(NODES, radiance), unit_light(NODES))
    # the spline through D65's own steps of 10 nm against its table, which is D65's at these nodes: 1 % of a sample
    assert ideal(unknown, luminance=50.0) == pytest.approx(one, rel=2e-2, abs=2e-3)
    with pytest.raises(GpusimError, match="wanted luminance of white"):
        ideal(unknown)
    with pytest.raises(GpusimError, match="another light"):
        ideal(unknown, light="A", luminance=50.0)


def test_ideal_averages_samples_and_hides_what_is_behind():
    scene = chart("slanted-edge", size=(9, 7), samples_per_pixel=3, angle_deg=20)
    fine = ideal(replace(scene, samples_per_pixel=1.0))
    blocks = fine.reshape(7, 3, 9, 3, 3).mean(axis=(1, 3))
    assert ideal(scene) == pytest.approx(blocks)
    # the exact area of the line in every pixel, whatever the samples: float32 of the chart
    assert ideal(scene) == pytest.approx(
        ideal(chart("slanted-edge", size=(9, 7), angle_deg=20)), abs=1e-6
    )
    assert ideal(scene, shape=(3, 4)) == pytest.approx(
        blocks[:6, :8].reshape(3, 2, 4, 2, 3).mean(axis=(1, 3))
    )
    for size, binning, stride in (
        ((150, 110), 2, 2),
        ((152, 112), 2, 2),
        ((151, 109), 3, 2),
        ((150, 110), 2, 6),
    ):
        # the frame's size by the stage that bins; the last rows and columns, less than a period of blocks, are cropped
        rows, cols = binned_shape(size[::-1], (binning, binning), (stride, stride))
        one = chart("slanted-edge", size=size, angle_deg=20)
        whole = ideal(one)[: rows * binning, : cols * binning]
        blocks = whole.reshape(rows, binning, cols, binning, 3).mean(axis=(1, 3))
        assert ideal(one, shape=(rows, cols)) == pytest.approx(blocks)
        assert ciede2000(blocks, one).max() < 1e-6
    uneven = chart("slanted-edge", size=(90, 70), samples_per_pixel=1.7, angle_deg=20)
    exact = ideal(chart("slanted-edge", size=(90, 70), angle_deg=20))
    # samples are flat: what one on the line holds is spread over it, at most a quarter of a sample's width of the step
    assert np.abs(ideal(uneven) - exact).max() < 0.6 * 0.25 / 1.7 * 1.2
    assert ideal(uneven).mean() == pytest.approx(exact.mean(), rel=1e-3)

    grey = chart("flat", size=(4, 4), reflectance=0.5)
    front = replace(grey.content, shading=np.full((4, 4), 0.1, np.float32))
    nearest = replace(grey.content, shading=np.full((4, 4), 0.9, np.float32))
    alpha = np.linspace(0, 1, 16).reshape(4, 4)
    layered = replace(
        grey,
        depth=np.full((4, 4), 3.0),
        layers=(Layer(nearest, np.full((4, 4), 0.25), 1.0), Layer(front, alpha, 2.0)),
    )
    y = 0.25 * 0.9 + 0.75 * (alpha * 0.1 + (1 - alpha) * 0.5)
    assert ideal(layered)[..., 1] == pytest.approx(y)


def test_scielab_of_even_patches_is_cielab():
    """Filters of unit sum: 1e-12 of the transforms there and back, times 500 in a*."""
    lab = np.array([[55.0, 20, -30], [52, 24, -20]])
    pair = [xyz_from_lab(one, WHITE) * np.ones((20, 30, 1)) for one in lab]
    known = np.linalg.norm(lab[0] - lab[1])
    for density in (5.0, 40.0, 300.0):
        assert scielab(*pair, density) == pytest.approx(known, abs=1e-8)
    assert scielab(*pair, 40.0, difference="ciede2000") == pytest.approx(ciede2000(*pair), abs=1e-8)


def test_scielab_is_lower_than_by_kernels_sampled_at_the_pixels():
    """At 20 samples per degree, by as much as its documentation says of sweeps; at 40 they nearly agree.

    The kernels are sampled at whole pixels, cut at half a degree and of unit sum each.
    """
    from scipy.ndimage import convolve1d

    waves = np.sin(np.pi * np.arange(96) ** 2 / 2 / 96)  # up to half a cycle per pixel
    picture = GREY[:1, :1] * (1 + 0.3 * waves[None, :, None]) * np.ones((24, 1, 1))
    ratios = []
    for density in (20, 40):
        places, pair = np.arange(1 - density // 2, density // 2), []
        for xyz in (picture, GREY[:1, :1] * np.ones(picture.shape)):
            planes = []
            for plane, gaussians in zip(
                np.moveaxis(xyz @ OPPONENT.T, -1, 0), GAUSSIANS, strict=True
            ):
                kernels = [np.exp(-((places / spread / density) ** 2)) for _, spread in gaussians]
                blurred = [
                    convolve1d(plane, kernel / kernel.sum(), 1, mode="mirror") for kernel in kernels
                ]
                planes.append(
                    np.tensordot([weight for weight, _ in gaussians], blurred, 1)
                    / sum(weight for weight, _ in gaussians)
                )
            pair.append(np.stack(planes, -1) @ np.linalg.inv(OPPONENT).T)
        white = GREY[0, 0] / 0.2
        sampled = np.linalg.norm(cielab(pair[0], white) - cielab(pair[1], white), axis=-1).mean()
        ratios.append(
            scielab(picture, GREY[:1, :1] * np.ones(picture.shape), density, white=white).mean()
            / sampled
        )
    assert 0.75 < ratios[0] < 0.9 and 0.93 < ratios[1] < 1.02


def test_scielab_of_dither():
    """What is finer than the eye sees vanishes with distance; from very near it is a difference pixel by pixel."""
    checker = np.indices((48, 48)).sum(0) % 2
    dither = GREY * (1 + 0.2 * (2 * checker[..., None] - 1))
    middle = np.s_[
        16:32, 16:32
    ]  # away from the border, where the mirrored pattern has two of a kind side by side
    found = [
        scielab(dither, GREY, density)[middle].mean() for density in (1e-3, 10.0, 20.0, 30.0, 60.0)
    ]
    plain = scielab(dither, GREY, 1e-9).mean()
    assert found[0] == pytest.approx(plain, rel=1e-3)
    assert plain == pytest.approx(
        116 * np.abs(np.cbrt([0.24, 0.16]) - np.cbrt(0.2)).mean(), rel=1e-9
    )
    assert np.all(np.diff(found) < 0)
    # at 60 samples per degree the pattern has 42 cycles per degree; of luminance exp(-(pi .0283 42)^2) = 8e-7 is left,
    # of red-green and blue-yellow less, so that it is no longer grey: 500 / 116 times as much of 5 Delta E, 2e-5
    assert found[-1] < 5e-5


def test_scielab_s_filters():
    """Against sums over the paper's Gaussians themselves, sampled, in space; what is beyond the border is mirrored.

    At 200 samples per degree the narrowest, 5.7 samples wide, has exp(-(pi 5.7 / 2)^2) = 1e-35 left at the frequency
    above which sampling folds.
    """
    random = np.random.default_rng(2)
    xyz = random.random((24, 31, 3))
    opponent = np.moveaxis(xyz @ OPPONENT.T, -1, 0)
    channels = []
    for plane, gaussians in zip(opponent, GAUSSIANS, strict=True):
        total = 0
        for weight, spread in gaussians:
            blurred = plane
            for axis in (0, 1):
                count = plane.shape[axis]
                reach = int(6 * spread * 200) + 1
                kernel = np.exp(-((np.arange(-reach, reach + 1) / (spread * 200)) ** 2))
                matrix = np.zeros((count, count))
                for i in range(count):
                    at = np.arange(i - reach, i + reach + 1) % (2 * count)
                    np.add.at(matrix[i], np.minimum(at, 2 * count - 1 - at), kernel / kernel.sum())
                blurred = np.moveaxis(np.tensordot(matrix, blurred, ([1], [axis])), 0, axis)
            total = total + weight * blurred
        channels.append(total / sum(weight for weight, _ in gaussians))
    truth = np.stack(channels, axis=-1) @ np.linalg.inv(OPPONENT).T
    assert blur_as_eye(xyz, 200.0) == pytest.approx(truth, abs=1e-9)


def test_samples_per_degree():
    """0.25 mm at 0.5 m: 57.3 mm / m and degree; a display so near that a pixel fills 90 degrees."""
    assert samples_per_degree(0.25e-3, 0.5) == pytest.approx(
        0.5 * np.radians(1) / 0.25e-3, rel=1e-6
    )
    assert samples_per_degree(2.0, 1.0) == pytest.approx(1 / 90)


def test_snr_by_hand():
    """Mean 3, variance of 1, 3, 5, 3 with n - 1: 8/3; two frames: differences -2, 2, 2, -2, variance 16/3, over 2."""
    patch = np.array([[1.0, 3], [5, 3]])
    assert snr(patch) == pytest.approx(20 * np.log10(3 / np.sqrt(8 / 3)))
    assert snr(patch, np.array([[3.0, 1], [3, 5]])) == pytest.approx(
        20 * np.log10(3 / np.sqrt(8 / 3))
    )
    assert snr(np.ones((3, 3))) == np.inf


def noisy(spread, seed=0, size=96):
    random = np.random.default_rng(seed)
    return GREY[:1, :1] * (1 + spread * random.standard_normal((size, size, 3)))


def test_visible_snr_goes_as_the_noise():
    """Half the noise, twice the vSNR: CIELAB is a cube root, of a noise of 1 % linear to 1e-4."""
    fine, coarse = (visible_snr(noisy(spread), 40.0) for spread in (0.005, 0.01))
    assert fine == pytest.approx(2 * coarse, rel=1e-3)
    assert visible_snr(GREY, 40.0) > 1e9
    seen = [visible_snr(noisy(0.01), density) for density in (1e-3, 10.0, 20.0, 40.0, 80.0)]
    print("vSNR", np.round(seen, 3))
    assert np.all(np.diff(seen) > 0)


def test_visible_snr_unblurred():
    """Neutral noise s: L* = 116 (Y (1 + s n))^(1/3) - 16, so its spread is 116 / 3 Y^(1/3) s, and a*, b* have none.

    77 x 77 pixels tell a spread to 1 / sqrt(2 n) = 0.9 %: 4 of these.
    """
    random = np.random.default_rng(3)
    patch = GREY[:1, :1] * (1 + 0.01 * random.standard_normal((96, 96, 1)))
    assert visible_snr(patch, 1e-9) == pytest.approx(1 / (116 / 3 * np.cbrt(0.2) * 0.01), rel=0.036)


def test_visible_snr_of_white_noise():
    """After the blur: the filters' power, integrated, of noise that L*, a*, b* mix linearly.

    Each of X, Y, Z has noise s of its own; opponent channels filter it; CIELAB's derivative at grey mixes it. Spread:
    s^2 mean over frequencies of |D inv(O) T(f) O diag(grey)|^2. The low frequencies of 77 x 77 pixels are few: at 10
    samples per degree the blur's area is 2 pi .03^2 10^2 = .6 pixel, so nearly all are their own: 3 %, and 20 patches.
    """
    f = np.fft.fftfreq(96) * 10
    squared = f[:, None] ** 2 + f**2
    transfer = np.stack(
        [
            sum(w * np.exp(-((np.pi * s) ** 2) * squared) for w, s in gaussians)
            / sum(w for w, _ in gaussians)
            for gaussians in GAUSSIANS
        ]
    )
    grey = 0.2 * WHITE
    slope = np.array([[0, 116, 0], [500, -500, 0], [0, 200, -200]]) * np.cbrt(0.2) / 3 / grey
    mixed = np.einsum("ij,jhw,jk->ikhw", slope @ np.linalg.inv(OPPONENT), transfer, OPPONENT * grey)
    known = 1 / (0.005 * np.sqrt((mixed**2).sum(axis=(0, 1)).mean()))
    found = np.mean([visible_snr(noisy(0.005, seed), 10.0) for seed in range(20)])
    assert found == pytest.approx(known, rel=0.03)


def test_cpsnr_by_hand():
    """One of 3 x 4 x 4 values inside the border off by 6, one outside by 100: mean square 36 / 48."""
    reference = np.random.default_rng(0).integers(0, 200, (8, 8, 3)).astype(np.uint8)
    image = reference.astype(np.float64)
    image[4, 4, 1] += 6
    image[1, 4, 0] += 100
    assert cpsnr(image, reference, border=2) == pytest.approx(10 * np.log10(255**2 / (36 / 48)))
    assert cpsnr(image, reference, border=0, peak=1.0) == pytest.approx(
        -10 * np.log10((36 + 1e4) / 192)
    )
    assert cpsnr(image[..., 1], reference[..., 1], border=2) == pytest.approx(
        10 * np.log10(255**2 / (36 / 16))
    )
    assert cpsnr(reference, reference, border=0) == np.inf
    unit = reference / 255.0
    assert cpsnr(unit + 0.01, unit, border=0) == pytest.approx(40)
    assert cpsnr(reference[::-1], reference, 0) == pytest.approx(
        cpsnr(reference, reference[::-1], 0)
    )


def test_ssim_by_hand():
    """The authors' formula, window by window: Gaussian of 1.5 pixels, 11 x 11, weighted moments, K = .01, .03."""
    random = np.random.default_rng(5)
    reference = random.random((17, 18, 3))
    image = reference + 0.1 * random.standard_normal(reference.shape)
    at = np.arange(-5, 6)
    window = np.exp(-(at[:, None] ** 2 + at**2) / (2 * 1.5**2))
    window /= window.sum()
    found = []
    for x, y in zip(
        *(np.moveaxis(one[2:-2, 2:-2], -1, 0) for one in (image, reference)), strict=True
    ):
        for i in range(x.shape[0] - 10):
            for j in range(x.shape[1] - 10):
                a, b = x[i : i + 11, j : j + 11], y[i : i + 11, j : j + 11]
                ma, mb = (window * a).sum(), (window * b).sum()
                va, vb, ab = (
                    (window * p * q).sum() - m
                    for p, q, m in ((a, a, ma**2), (b, b, mb**2), (a, b, ma * mb))
                )
                found.append(
                    (2 * ma * mb + 1e-4)
                    * (2 * ab + 9e-4)
                    / ((ma**2 + mb**2 + 1e-4) * (va + vb + 9e-4))
                )
    assert ssim(image, reference, border=2) == pytest.approx(np.mean(found), abs=1e-12)
    assert ssim(255 * image, 255 * reference, border=2, peak=255) == pytest.approx(
        np.mean(found), abs=1e-12
    )
    assert ssim(reference, reference, border=0) == pytest.approx(1)


BAD = np.full((8, 8, 3), np.nan)


@pytest.mark.parametrize(
    ("call", "what"),
    [
        (lambda: ciede2000(GREY[..., :2], GREY[..., :2]), "XYZ"),
        (lambda: ciede2000(BAD, BAD), "NaN"),
        (lambda: ciede2000(GREY, GREY[1:]), "different shapes"),
        (lambda: ciede2000(GREY, GREY, (1, 0, 1)), "white"),
        (lambda: ciede2000("frame", GREY), "wanted"),
        (lambda: scielab(GREY, GREY, 0.0), "samples_per_degree = 0"),
        (lambda: scielab(GREY, GREY, np.nan), "samples_per_degree"),
        (lambda: scielab(GREY[0], GREY[0], 9.0), "rows"),
        (lambda: scielab(GREY, GREY, 9.0, difference="ciede94"), "did you mean"),
        (lambda: ciede2000(GREY, chart("flat", size=(32, 24))), "binning"),
        (lambda: ideal(chart("flat", size=(32, 24)), shape=(0, 0)), "binning"),
        (lambda: ideal(chart("flat", size=(32, 24)), shape=(23, 32)), "binning"),
        (lambda: ideal(chart("flat", size=(320, 240)), shape=(112, 160)), "binning"),
        (lambda: ideal(chart("flat", size=(32, 24)), luminance=-1.0), "luminance"),
        (
            lambda: ideal(chart("flat", size=(32, 24)), light="A", luminance=100.0),
            "luminance together with light",
        ),
        (lambda: samples_per_degree(0.0, 1.0), "pitch"),
        (lambda: samples_per_degree(1.0, np.inf), "distance"),
        (lambda: snr(np.zeros((4, 4))), "black level"),
        (lambda: snr(BAD), "NaN"),
        (lambda: snr(np.ones(4)), "shape"),
        (lambda: snr(np.ones((4, 4)), np.ones((4, 5))), "different shapes"),
        (lambda: snr([["a", "b"]]), "wanted"),
        (lambda: visible_snr(GREY[:1, :1], 9.0), "2 or more"),
        (lambda: visible_snr(BAD, 9.0), "NaN"),
        (lambda: cpsnr(GREY, GREY[1:]), "shapes"),
        (lambda: cpsnr(GREY, GREY, border=-1), "border = -1"),
        (lambda: cpsnr(GREY, GREY, border=24), "inside the border"),
        (lambda: cpsnr(GREY, GREY, peak=0.0), "peak"),
        (lambda: cpsnr(BAD, BAD, border=0), "NaN"),
        (lambda: ssim(GREY, GREY, border=19), "11 or more"),
        (lambda: cpsnr(np.zeros((3, 40, 50)), np.zeros((3, 40, 50))), "channels come last"),
        (lambda: cpsnr(GREY.astype(complex), GREY), "complex"),
    ],
)
def test_refused(call, what):
    with pytest.raises(GpusimError, match=what):
        call()

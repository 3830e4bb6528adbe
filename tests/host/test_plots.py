"""What is drawn, read back from the axes, against formulas and other programs."""

import re
import sys
from dataclasses import replace

import colour
import matplotlib
import numpy as np
import pytest
from edges import gaussian_edge, gaussian_mtf
from PIL import Image

import gpusim as gs
from gpusim.data.charts import colorchecker_patches
from gpusim.data.reflectances import reflectances
from gpusim.domain.errors import BadData, Missing, OutOfRange, UnknownName
from gpusim.judge.plan_summary import Forecast
from gpusim.measure import sfr
from gpusim.measure.mosaic import color_mosaic

matplotlib.use("Agg")
from matplotlib import pyplot

pytestmark = pytest.mark.filterwarnings(
    "ignore:[^$]*Matplotlib", "ignore:[^$]*Aligning"
)  # colour's chatter

PHONE = gs.open_camera("phone")
PLANCK, LIGHT = 6.62607015e-34, 299792458.0  # SI 2019


@pytest.fixture
def ax():
    figure, axes = pyplot.subplots()
    yield axes
    pyplot.close(figure)


@pytest.fixture(autouse=True)
def closed():
    yield
    pyplot.close("all")


def lines(axes):
    """Label -> x and y of what is drawn."""
    return {line.get_label(): tuple(map(np.asarray, line.get_data())) for line in axes.get_lines()}


def diffraction(s):
    """Of a clear circle: Goodman, Introduction to Fourier Optics, 6.4."""
    s = np.minimum(np.abs(s), 1)
    return 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))


# ------------------------------------------------------------------------------------------------------------- lens


def test_mtf_of_wavelengths_is_that_of_diffraction(ax):
    camera = PHONE.with_(f_number=2.8)
    assert gs.plot.mtf(camera, (450, 650.0), ax) is ax
    drawn = lines(ax)
    for nanometres in (450, 650):
        f, response = drawn[f"{nanometres} nm"]
        np.testing.assert_allclose(
            response, diffraction(f * 1e3 * nanometres * 1e-9 * 2.8), atol=1e-9
        )
    f, own = drawn["pixel aperture only"]
    pitch = camera.sensor.pixel_pitch
    np.testing.assert_allclose(
        own, np.abs(np.sinc(1e3 * f * pitch * camera.sensor.fill_factor**0.5)), atol=1e-12
    )
    assert "cycle/mm" in ax.get_xlabel()


def test_mtf_of_a_channel_is_its_light_s_mean():
    """Against sums over every nanometre; the plot has a spline's weights every 20 nm."""
    drawn = lines(gs.plot.mtf(PHONE, ["G"], light="E", pixel=True))
    f, response = drawn["channel G"]
    nodes = np.arange(400.0, 701.0)
    sees = PHONE.sensor.qe.at(nodes)[1] * nodes  # photons of equal energy
    through = PHONE.optics.transmission_at(nodes)
    expected = (
        sum(
            w * diffraction(f * 1e-6 * one * PHONE.optics.f_number)
            for w, one in zip(sees * through, nodes, strict=True)
        )
        / (sees * through).sum()
    )
    np.testing.assert_allclose(
        response, np.abs(expected * np.sinc(1e3 * f * PHONE.sensor.aperture[1])), atol=2e-3
    )


def test_mtf_of_a_measured_gaussian(ax):
    """exp(-2 pi^2 sigma^2 f^2); samples of sigma / 2 tell all of it to e^(-2 pi^2) = 3e-9, cut off at 6 sigma 2e-9."""
    sigma = 1.4e-6
    y, x = (np.arange(-12, 13) / 2 for _ in range(2))
    spread = np.exp(-(y[:, None] ** 2 + x**2) / 2)
    psf = gs.PointSpread([400.0, 700.0], np.stack([spread] * 2), sigma / 2)
    camera = PHONE.with_(optics=replace(PHONE.optics, model="measured", psf=psf))
    f, response = lines(gs.plot.mtf(camera, 500, ax, direction="down"))["500 nm"]
    inside = f * 1e3 < 0.5 / (sigma / 2)
    np.testing.assert_allclose(
        response[inside], np.exp(-2 * (np.pi * sigma * 1e3 * f[inside]) ** 2), atol=1e-7
    )


def test_psf_has_its_first_dark_ring_at_the_airy_radius():
    axes = gs.plot.psf(PHONE.with_(f_number=4), 600)
    picture, (left, right, bottom, top) = axes.images[0].get_array(), axes.images[0].get_extent()
    step = (right - left) / picture.shape[1]
    assert (bottom, top) == (-left, left)  # y goes down, as rows do
    row = picture[picture.shape[0] // 2, picture.shape[1] // 2 :]
    dark = np.argmax(np.diff(row) > 0)
    assert abs(dark * step - 1.21967 * 0.6 * 4) < step
    assert row[0] == 1 and picture.min() >= 1e-4


def test_psf_draws_all_channels_at_one_scale():
    figure = gs.plot.psf(PHONE.with_(f_number=8))
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[:6] == ["450 nm", "550 nm", "650 nm", "channel R", "channel G", "channel B"]
    assert len({tuple(axes.images[0].get_extent()) for axes in figure.axes[:6]}) == 1


# ----------------------------------------------------------------------------------------------------------- sensor


def test_snr_of_photons_alone_is_their_root(ax):
    """sqrt(N) of N electrons = area qe exposure photons per lux; V(lambda) and its sum are colour-science's."""
    nodes = np.arange(360.0, 831.0)
    quiet = gs.Noise(read=0, prnu=0, dsnu=0, dark_current=0)
    sensor = gs.Sensor(
        pixel_pitch=2e-6,
        qe=gs.Spectrum(nodes, np.full((1, 471), 0.5)),
        full_well=1e4,
        bits=32,
        channels=("Y",),
        cfa=("Y",),
        noise=quiet,
    )
    f, snr = lines(gs.plot.snr(sensor, ax, light="E"))["channel Y, at most 40.0 dB"]
    eye = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].values[:, 1]
    photons = (nodes * 1e-9 / PLANCK / LIGHT).sum() / (683 * eye.sum())  # of 1 lx s on 1 m2
    np.testing.assert_allclose(
        snr, 10 * np.log10(4e-12 * 0.5 * photons * f), atol=0.02
    )  # sums for integrals
    assert snr.max() == pytest.approx(40, abs=1e-9)  # 10 lg 10^4, at saturation


def test_cameras_on_one_axes_can_be_told_apart(ax):
    for f_number in (8, 2):  # the first one's cut-off is the lower
        gs.plot.mtf(PHONE.with_(f_number=f_number), 550, ax, label=f"f/{f_number}")
    drawn = {line.get_label(): line for line in ax.get_lines()}
    first, second = drawn["f/8 550 nm"], drawn["f/2 550 nm"]
    assert (
        first.get_color() == second.get_color() and first.get_linestyle() != second.get_linestyle()
    )
    assert (
        ax.get_xlim()[1] >= second.get_xdata()[-1] and ax.get_title() == "MTF of the lens, across"
    )
    gs.plot.mtf(PHONE.with_(f_number=8), 550, ax)
    assert ax.get_xlim()[1] >= second.get_xdata()[-1]


def test_snr_has_the_noise_of_frames(ax):
    """Drawn frames of even light: SNR within 0.2 dB, of which 0.06 dB is the spread of 10^4 pixels (4 sigma: .25)."""
    sensor = PHONE.sensor
    found = lines(gs.plot.snr(sensor, ax, temporal=True))
    exposure, snr = next(data for label, data in found.items() if label.startswith("channel G"))
    readout, at = gs.Readout(sensor, "numpy"), np.searchsorted(snr, 20.0)
    per_exposure = (
        10 ** (lines(ax)["photon noise only, channel G"][1] / 10)
        / exposure[: len(exposure)][: len(lines(ax)["photon noise only, channel G"][1])]
    )
    electrons = per_exposure[0] * exposure[at]
    raws = readout.draw_electrons(
        np.full((120, 120), electrons, np.float32), 1e-9, frames=2, seed=3
    )
    noise = np.std(raws[1].astype(float) - raws[0]) / 2**0.5 / sensor.gain_dn_per_electron
    assert 20 * np.log10(electrons / noise) == pytest.approx(snr[at], abs=0.25)


def test_raw_is_in_its_filters_colours():
    frame = gs.Simulator(PHONE, device="numpy")(gs.chart("flat", size=(24, 16)))
    codes = np.asarray(gs.plot.raw(frame).images[0].get_array())
    red, green, blue = codes[::2, ::2], codes[::2, 1::2], codes[1::2, 1::2]  # RG / GB
    assert not red[..., 1:].any() and not blue[..., :2].any() and not green[..., [0, 2]].any()
    signal = (frame.raw[::2, 1::2] - PHONE.sensor.dark_level) / (
        PHONE.sensor.white_level - PHONE.sensor.dark_level
    )
    np.testing.assert_allclose(green[..., 1], 255 * signal ** (1 / 2.2), atol=0.51)


def test_mosaics_of_other_letters_are_seen():
    sensor = replace(PHONE.sensor, channels=("R", "W", "K"), cfa=("RW", "WK"))
    codes = color_mosaic(sensor, np.full((4, 4), 100, np.uint8))
    assert (
        codes[0, 0].tolist() == [100, 0, 0]
        and codes[0, 1].tolist() == [100] * 3 == codes[1, 1].tolist()
    )
    layers = np.arange(48, dtype=np.uint8).reshape(3, 4, 4)
    stacked = replace(PHONE.sensor, stacked=True)
    np.testing.assert_array_equal(color_mosaic(stacked, layers), np.moveaxis(layers, 0, -1))


# --------------------------------------------------------------------------------------------------- light, pictures


def test_scene_is_as_colour_science_renders_it():
    """Patches in D65 of 1 nm sums; theirs is an ASTM E308 integral of the 5 nm tables: 0.01 of the codes."""
    nodes = np.arange(380.0, 781.0, 5.0)
    scene = gs.chart("colorchecker", size=(96, 64), wavelengths=nodes)
    picture = gs.plot.scene(scene).images[0].get_array()
    cmfs = (
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
        .copy()
        .align(colour.SpectralShape(380, 780, 5))
    )
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(380, 780, 5))
    table = reflectances("colorchecker").at(nodes, outside=None)
    for (rows, cols), values in list(zip(colorchecker_patches((96, 64)), table, strict=True))[
        :17
    ]:  # cyan is outside
        xyz = colour.sd_to_XYZ(colour.SpectralDistribution(values, nodes), cmfs, light) / 100
        expected = np.clip(colour.XYZ_to_sRGB(xyz), 0, 1)
        np.testing.assert_allclose(picture[rows, cols][2, 2], expected, atol=0.01)


def test_sfr_of_a_gaussian_edge_is_marked_where_it_is_a_half(ax):
    angle, sigma, pitch = np.radians(5), 0.7, 2e-6
    image = 0.2 + 0.5 * gaussian_edge(160, 200, angle, sigma)
    gs.plot.sfr(sfr(image, pitch=pitch), ax)
    (f, response), *_ = [line.get_data() for line in ax.get_lines()]
    expected = gaussian_mtf(f * pitch * 1e3, angle, sigma)
    np.testing.assert_allclose(
        response, expected, atol=5e-3
    )  # tests/host/test_sfr.py derives 1e-3 up to half a cycle
    half = np.interp(0.5, expected[::-1], f[::-1])
    label = ax.get_legend().get_texts()[0].get_text()
    assert label.endswith(" cycle/mm") and float(label.split()[1]) == pytest.approx(half, rel=5e-3)


def test_sfr_of_a_camera_has_all_channels(monkeypatch):
    monkeypatch.setattr("gpusim.plot.pictures.EDGE", (120, 100))
    monkeypatch.setattr("gpusim.plot.pictures.FRAMES", 2)
    axes = gs.plot.sfr(gs.open_camera("mono"), device="numpy")
    assert axes.get_legend().get_texts()[0].get_text().startswith("W: MTF50")
    frame = gs.Simulator(PHONE, device="numpy")(gs.chart("slanted-edge", size=(120, 100)))
    assert [text.get_text()[:8] for text in gs.plot.sfr(frame).get_legend().get_texts()] == [
        "R: MTF50",
        "G: MTF50",
        "B: MTF50",
    ]
    assert gs.plot.sfr(frame).get_legend().get_texts()[0].get_text().endswith(" cycle/pixel")


def test_sfr_of_binned_pixels_is_by_their_own_pitch(monkeypatch):
    """Nyquist's frequency is half a cycle of theirs; oblongs have no one pitch."""
    monkeypatch.setattr("gpusim.plot.pictures.EDGE", (160, 120))
    monkeypatch.setattr("gpusim.plot.pictures.FRAMES", 1)
    camera = gs.open_camera("mono")
    for binning, nyquist, unit in (
        ((2, 2), 0.5 / (2e3 * camera.sensor.pixel_pitch), "cycle/mm"),
        ((1, 2), 0.5, "cycle/pixel"),
    ):
        axes = gs.plot.sfr(camera.with_(binning=binning), device="numpy")
        assert any(line.get_xdata()[0] == pytest.approx(nyquist) for line in axes.get_lines())
        assert axes.get_legend().get_texts()[0].get_text().endswith(unit)
        # `sfr` tells frequencies up to 1 cycle/pixel
        assert axes.get_lines()[0].get_xdata()[-1] == pytest.approx(2 * nyquist, rel=0.01)


def test_spectra_are_those_of_the_patch(ax):
    """Under FL11, whose lines a 10 nm scene would miss: reflectance times the lamp at its own 5 nm, in watts."""
    scene = gs.chart("colorchecker", size=(96, 64), light="FL11", samples_per_pixel=2)
    (rows, cols), number = colorchecker_patches((96, 64))[18], 18  # white
    gs.plot.spectra(scene, (cols.start + 2, rows.start + 2), ax)
    ((wavelengths, drawn),) = lines(ax).values()
    lamp = colour.SDS_ILLUMINANTS["FL11"]
    at = np.isin(wavelengths, lamp.wavelengths)
    power = lamp[wavelengths[at]] / lamp[560.0]
    table = reflectances("colorchecker").at(wavelengths[at], outside=None)[number]
    shape = drawn[at] / drawn[wavelengths == 560]
    np.testing.assert_allclose(
        shape, power * table / table[wavelengths[at] == 560], rtol=0.03
    )  # linear, not cubic
    assert len(set(wavelengths % 10)) == 2
    eye = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    luminance = 683 * 5 * (drawn[at] * np.array([eye[one][1] for one in wavelengths[at]])).sum()
    assert luminance == pytest.approx(
        100 * table.mean(), rel=0.05
    )  # white of 100 cd m-2 times the patch's


def test_spectra_of_regions_are_their_means():
    values = np.random.default_rng(4).random((3, 8, 12)).astype(np.float32)
    scene = gs.scene_from(values, [500.0, 550.0, 600.0], light="E")
    axes = gs.plot.spectra(scene, [(2, 1), (3, 2, 7, 6)], quantity="reflectance")
    (_, pixel), (_, region) = lines(axes).values()
    np.testing.assert_allclose(pixel, values[:, 1, 2], rtol=1e-6)
    np.testing.assert_allclose(region, values[:, 2:6, 3:7].mean(axis=(1, 2)), rtol=1e-6)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["(2, 1)", "(3, 2, 7, 6)"]


def test_spectra_beyond_what_is_seen_are_drawn_in_grey(ax):
    scene = gs.scene_from(np.full((2, 4, 4), 0.5), [900.0, 950.0], light="E")
    with pytest.raises(BadData, match="no overlap"):
        gs.plot.scene(scene)
    gs.plot.spectra(scene, (1, 1), ax, quantity="reflectance")
    (line,) = ax.get_lines()
    assert line.get_ydata() == pytest.approx(0.5) and len({*line.get_color()}) == 1


def test_a_click_draws_the_spectrum_of_the_pixel():
    from matplotlib.backend_bases import MouseEvent

    scene = gs.chart("colorchecker", size=(96, 64))
    figure = gs.plot.inspect(scene)
    left, right = figure.axes
    figure.canvas.draw()

    def click(col, row, button=1):
        x, y = left.transData.transform((col, row))
        event = MouseEvent("button_press_event", figure.canvas, x, y, button)
        figure.canvas.callbacks.process("button_press_event", event)

    assert list(lines(right)) == ["all of the frame"]
    click(20, 12)
    click(40.3, 30.2)
    assert list(lines(right)) == ["(20, 12)", "(40, 30)"] and len(left.lines) == 2
    click(0, 0, button=3)
    assert list(lines(right)) == ["all of the frame"] and not left.lines


def test_optical_image_is_the_camera_equation():
    """Even light: L pi / (1 + 4 N^2) T lux in the middle, cos^4 less in the corner; one colour, that of the surface."""
    camera = PHONE.with_(f_number=4, transmission=0.5)
    axes = gs.plot.optical_image(
        camera, gs.chart("flat", size=(48, 32), luminance=200.0, light="A"), device="numpy"
    )
    lux = 200 * 0.5 * np.pi / (1 + 4 * 16)
    assert f"white {lux:.3g} lx" in axes.get_title()
    codes = np.asarray(axes.images[0].get_array())
    linear = np.where(
        codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4
    )  # IEC 61966-2-1
    pitch, focal = camera.sensor.pixel_pitch, camera.optics.focal_length
    y, x = ((np.arange(n) - (n - 1) / 2) * pitch / focal for n in (32, 48))
    fall = (1 + y[:, None] ** 2 + x**2) ** -2
    np.testing.assert_allclose(
        linear, 0.18 * fall[..., None] * np.ones(3), rtol=2e-3
    )  # grey is white's colour


# ------------------------------------------------------------------------------------------------- noise and errors


@pytest.fixture(scope="module")
def checker():
    scene = gs.chart("colorchecker", size=(96, 64))
    return scene, gs.Simulator(PHONE, device="numpy")(scene, seed=2)


def test_noise_is_as_wide_as_is_expected(checker):
    """Of n pixels the sigma spreads by 1 / sqrt(2 n), the mean by 1 / sqrt(n): 5 of these; counts add up to 1."""
    axes = gs.plot.noise(checker[1])
    ((normal_x, normal),) = (data for label, data in lines(axes).items() if label == "normal")
    np.testing.assert_allclose(normal, np.exp(-(normal_x**2) / 2) / (2 * np.pi) ** 0.5)
    assert len(lines(axes)) == 4
    for label, (x, share) in lines(axes).items():
        if label != "normal":
            count, mean, sigma = map(float, re.findall(r"[+-]?\d+\.?\d*", label))
            assert (
                abs(mean) < 5 / count**0.5 and abs(sigma - 1) < 5 / (2 * count) ** 0.5 + 0.01
            )  # rounding's shape
            assert (share * (x[1] - x[0])).sum() == pytest.approx(1, abs=0.01)


def test_photon_transfer_finds_what_the_sensor_was_given():
    sensor = PHONE.sensor
    axes = gs.plot.photon_transfer(PHONE, device="numpy")
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    gain = float(next(one for one in labels if one.startswith("photons")).split()[3])
    dark = float(next(one for one in labels if one.startswith("dark")).split()[3])
    assert gain == pytest.approx(
        sensor.gain_dn_per_electron, rel=0.02
    )  # 96 x 96 pixels, 16 levels: 0.4 %
    assert dark == pytest.approx(
        sensor.read_sigma, rel=0.05
    )  # 96 x 96 pixels: 0.7 %, and dark offsets none
    x, y = lines(axes)["frames"]
    below = x < 0.6 * x.max()
    expected = np.sqrt(gain * x[below] + y[x.argmin()] ** 2)
    np.testing.assert_allclose(
        y[below], expected, rtol=0.06
    )  # 1 / sqrt(2 x 9216) is 0.7 % of each of the two


def test_colour_errors_are_colour_sciences(checker):
    scene, frame = checker
    axes = gs.plot.color_checker(frame, scene)
    heights = [bar.get_height() for bar in axes.patches]
    table = reflectances("colorchecker").at(np.arange(400.0, 701.0), outside=None)
    cmfs = (
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
        .copy()
        .align(colour.SpectralShape(400, 700, 1))
    )
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(400, 700, 1))
    white, ones = np.array([0.3127, 0.3290]), np.ones(301)
    lit = (
        colour.sd_to_XYZ(colour.SpectralDistribution(ones, np.arange(400.0, 701.0)), cmfs, light)
        / 100
    )
    for number, (rows, cols) in enumerate(colorchecker_patches((96, 64))):
        own = np.clip(
            frame.linear[rows, cols][1:-1, 1:-1].mean(axis=(0, 1)) / frame.rendering.diffuser, 0, 1
        )
        seen = colour.RGB_to_XYZ(own, "sRGB", white)
        true = (
            colour.sd_to_XYZ(
                colour.SpectralDistribution(table[number], np.arange(400.0, 701.0)), cmfs, light
            )
            / 100
        )
        true = colour.chromatic_adaptation(true, lit, colour.xy_to_XYZ(white), transform="Bradford")
        expected = colour.delta_E(
            *(colour.XYZ_to_Lab(one, white) for one in (seen, true)), method="CIE 2000"
        )
        assert heights[number] == pytest.approx(expected, abs=0.15)  # 10 nm: lines or splines
    drawn = gs.plot.delta_e(frame, scene).images[0].get_array()
    assert drawn.shape == scene.shape and drawn.min() >= 0


def test_error_map_is_electrons_against_the_reference():
    """The reference on the reference has none but float32's; a lens left out has all of it."""
    scene, camera = replace(gs.chart("colorchecker", size=(48, 32)), border="reflect"), PHONE
    axes = gs.plot.error(gs.Simulator(camera, device="numpy"), scene)
    assert np.abs(axes.images[0].get_array()).max() < 0.05
    simulator = gs.Simulator(camera, device="numpy", tolerance=0.3)
    frame = simulator(scene, verify=True)
    axes = gs.plot.error(simulator, scene)
    assert np.abs(axes.images[0].get_array()).max() == pytest.approx(
        frame.report.error.max_sigma, rel=1e-5
    )


def test_plan_bars_are_the_reports(checker):
    report = checker[1].report
    figure = gs.plot.plan(report)
    times, errors = figure.axes
    names = [text.get_text() for text in times.get_yticklabels()]
    assert dict(zip(names, (bar.get_width() for bar in times.patches), strict=True)) == {
        stage.stage: stage.ms for stage in report.stages if stage.ms
    }
    assert errors.patches[-1].get_width() == report.account.total.rms
    forecast = Forecast.of(gs.Simulator(PHONE, device="numpy", tolerance="preview"), checker[0])
    figure = gs.plot.plan(forecast)
    assert sum(bar.get_width() for bar in figure.axes[0].patches) == pytest.approx(
        sum(forecast.ms.values())
    )
    assert "tolerance met" in figure.get_suptitle() and "99.9 %" in figure.axes[1].get_xlabel()


def test_picture_and_efficiency_are_the_camera_s(checker):
    np.testing.assert_array_equal(gs.plot.picture(checker[1]).images[0].get_array(), checker[1].rgb)
    _, y = lines(gs.plot.efficiency(PHONE))["channel G"]
    np.testing.assert_array_equal(y, PHONE.sensor.qe.values[1])


# --------------------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    "call, error, words",
    [
        (lambda: gs.plot.mtf(3), BadData, "camera: int, wanted a Camera"),
        (lambda: gs.plot.mtf(PHONE, "X"), UnknownName, "unknown channel 'X'; known: B, G, R"),
        (lambda: gs.plot.mtf(PHONE, 5), OutOfRange, "of = 5: allowed is wavelengths within"),
        (lambda: gs.plot.mtf(PHONE, []), BadData, "nothing to draw"),
        (lambda: gs.plot.mtf(PHONE, direction="up"), UnknownName, "unknown direction 'up'"),
        (lambda: gs.plot.mtf(PHONE, light="D66"), UnknownName, "unknown light 'D66'"),
        (lambda: gs.plot.mtf(PHONE, light=3), BadData, "light of int: wanted a name"),
        (lambda: gs.plot.mtf(PHONE, place=3), BadData, r"place = 3: wanted a field point \(y, x\)"),
        (
            lambda: gs.plot.psf(PHONE, 550, place=(1, 1)),
            OutOfRange,
            r"place = \(1.0, 1.0\): allowed is up to 1",
        ),
        (
            lambda: gs.plot.snr(PHONE, light=PHONE.sensor.qe),
            BadData,
            "light of Spectrum: wanted a name",
        ),
        (
            lambda: gs.plot.snr(PHONE, seconds="1"),
            OutOfRange,
            "seconds = 1 s: allowed is 0 <= seconds",
        ),
        (lambda: gs.plot.mtf(PHONE, 550, 3), BadData, "ax: int, wanted axes of matplotlib"),
        (
            lambda: gs.plot.psf(PHONE.with_(optics=replace(PHONE.optics, model="none"))),
            BadData,
            "no point spread to draw",
        ),
        (lambda: gs.plot.psf(PHONE, figure=3), BadData, "figure: int, wanted a figure"),
        (
            lambda: gs.plot.snr(PHONE.with_(photon="none", read_e=0, prnu=0, dsnu_e=0, bits=32)),
            BadData,
            "has no noise",
        ),
        (lambda: gs.plot.snr("phone"), BadData, "snr: str, wanted a Camera or a Sensor"),
        (lambda: gs.plot.snr(PHONE, seconds=-1), OutOfRange, "seconds = -1 s"),
        (lambda: gs.plot.raw(PHONE), BadData, "raw: Camera, wanted a frame"),
        (lambda: gs.plot.scene("colorchecker"), BadData, "scene: str, wanted a Scene"),
        (
            lambda: gs.plot.spectra(gs.chart("flat", size=(9, 9)), (9, 0)),
            OutOfRange,
            r"at = \(9, 0\): allowed is columns",
        ),
        (
            lambda: gs.plot.spectra(gs.chart("flat", size=(9, 9)), 3),
            BadData,
            "at = 3: wanted a pixel",
        ),
        (
            lambda: gs.plot.spectra(gs.chart("flat", size=(9, 9)), (1.5, 2)),
            BadData,
            "wanted a pixel",
        ),
        (
            lambda: gs.plot.spectra(gs.chart("flat"), quantity="x"),
            UnknownName,
            "unknown quantity 'x'",
        ),
        (lambda: gs.plot.optical_image("phone", 3), BadData, "camera: str, wanted a Camera"),
        (lambda: gs.plot.noise(PHONE), BadData, "noise: Camera, wanted a frame"),
        (
            lambda: gs.plot.photon_transfer(3),
            BadData,
            "photon_transfer: int, wanted a PhotonTransfer",
        ),
        (lambda: gs.plot.delta_e(3, 3), BadData, "delta_e: int, wanted a frame"),
        (lambda: gs.plot.error(PHONE, 3), BadData, "error: Camera, wanted a Simulator"),
        (lambda: gs.plot.plan(PHONE), BadData, "plan: Camera, wanted a Forecast or"),
        (lambda: gs.plot.sfr(np.ones((9, 9))), BadData, "sfr: ndarray, wanted a Camera, a frame"),
    ],
)
def test_bad_input_is_refused_in_one_line(call, error, words):
    with pytest.raises(error, match=words) as refused:
        call()
    assert "\n" not in str(refused.value)


def test_without_matplotlib_it_is_said_how_to_get_it(monkeypatch):
    for name in ("matplotlib", "matplotlib.pyplot"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(
        Missing, match=r"matplotlib is not installed; wanted: pip install 'gpusim\[plot\]'"
    ):
        gs.plot.mtf(PHONE)


def test_open_figures_are_saved_and_closed(tmp_path, capsys):
    pyplot.close("all")
    for _ in range(2):
        pyplot.subplots()[1].plot([0, 1])
    stem = tmp_path / "new" / "night"
    saved = gs.plot.save_figures(stem)
    assert [path.name for path in saved] == ["night_1.png", "night_2.png"]
    assert all(Image.open(path).size[0] > 100 for path in saved) and pyplot.get_fignums() == []
    assert capsys.readouterr().out.count("saved ") == 2
    assert gs.plot.save_figures(stem) == []

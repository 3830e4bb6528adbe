"""What is drawn, read back from the axes, against formulas and other programs."""

import sys
from dataclasses import replace

import colour
import numpy as np
import pytest
from edges import gaussian_edge, gaussian_mtf

import gpusim as gs
from gpusim.data.charts import colorchecker_patches
from gpusim.data.reflectances import reflectances
from gpusim.domain.errors import BadData, Missing, OutOfRange, UnknownName
from gpusim.measure import sfr
from gpusim.measure.mosaic import colored

matplotlib = pytest.importorskip("matplotlib", reason="plots are of matplotlib")
matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:[^$]*Matplotlib", "ignore:[^$]*Aligning")  # colour's chatter

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
        np.testing.assert_allclose(response, diffraction(f * 1e3 * nanometres * 1e-9 * 2.8), atol=1e-9)
    f, own = drawn["pixel aperture alone"]
    pitch = camera.sensor.pixel_pitch
    np.testing.assert_allclose(own, np.abs(np.sinc(1e3 * f * pitch * camera.sensor.fill_factor**0.5)), atol=1e-12)
    assert "cycle/mm" in ax.get_xlabel()


def test_mtf_of_a_channel_is_its_light_s_mean():
    """Against sums over every nanometre; the plot has a spline's weights every 20 nm."""
    drawn = lines(gs.plot.mtf(PHONE, ["G"], light="E", pixel=True))
    f, response = drawn["channel G"]
    nodes = np.arange(400.0, 701.0)
    sees = PHONE.sensor.qe.at(nodes)[1] * nodes  # photons of equal energy
    through = PHONE.optics.transmission_at(nodes)
    expected = sum(w * diffraction(f * 1e-6 * one * PHONE.optics.f_number)
                   for w, one in zip(sees * through, nodes, strict=True)) / (sees * through).sum()
    np.testing.assert_allclose(response, np.abs(expected * np.sinc(1e3 * f * PHONE.sensor.aperture[1])), atol=2e-3)


def test_mtf_of_a_measured_gaussian(ax):
    """exp(-2 pi^2 sigma^2 f^2); samples of sigma / 2 tell all of it to e^(-2 pi^2) = 3e-9, cut off at 6 sigma 2e-9."""
    sigma = 1.4e-6
    y, x = (np.arange(-12, 13) / 2 for _ in range(2))
    spread = np.exp(-(y[:, None] ** 2 + x**2) / 2)
    psf = gs.PointSpread([400.0, 700.0], np.stack([spread] * 2), sigma / 2)
    camera = PHONE.with_(optics=replace(PHONE.optics, model="measured", psf=psf))
    f, response = lines(gs.plot.mtf(camera, 500, ax, direction="down"))["500 nm"]
    inside = f * 1e3 < 0.5 / (sigma / 2)
    np.testing.assert_allclose(response[inside], np.exp(-2 * (np.pi * sigma * 1e3 * f[inside]) ** 2), atol=1e-7)


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
    figure = gs.plot.psf(PHONE)
    titles = [axes.get_title() for axes in figure.axes]
    assert titles[:6] == ["450 nm", "550 nm", "650 nm", "channel R", "channel G", "channel B"]
    assert len({tuple(axes.images[0].get_extent()) for axes in figure.axes[:6]}) == 1


# ----------------------------------------------------------------------------------------------------------- sensor


def test_snr_of_photons_alone_is_their_root(ax):
    """sqrt(N) of N electrons = area qe exposure photons per lux; V(lambda) and its sum are colour-science's."""
    nodes = np.arange(360.0, 831.0)
    quiet = gs.Noise(read=0, prnu=0, dsnu=0, dark_current=0)
    sensor = gs.Sensor(pixel_pitch=2e-6, qe=gs.Spectrum(nodes, np.full((1, 471), 0.5)), full_well=1e4, bits=32,
                       channels=("Y",), cfa=("Y",), noise=quiet)
    f, snr = lines(gs.plot.snr(sensor, ax, light="E"))["channel Y, at most 40.0 dB"]
    eye = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].values[:, 1]
    photons = (nodes * 1e-9 / PLANCK / LIGHT).sum() / (683 * eye.sum())  # of 1 lx s on 1 m2
    np.testing.assert_allclose(snr, 10 * np.log10(4e-12 * 0.5 * photons * f), atol=0.02)  # sums for integrals
    assert snr.max() == pytest.approx(40, abs=1e-9)  # 10 lg 10^4, at saturation


def test_snr_has_the_noise_of_frames(ax):
    """Drawn frames of even light: SNR within 0.2 dB, of which 0.06 dB is the spread of 10^4 pixels (4 sigma: .25)."""
    sensor = PHONE.sensor
    found = lines(gs.plot.snr(sensor, ax, temporal=True))
    exposure, snr = next(data for label, data in found.items() if label.startswith("channel G"))
    readout, at = gs.Readout(sensor, "numpy"), np.searchsorted(snr, 20.0)
    per_exposure = 10 ** (lines(ax)["photons alone, channel G"][1] / 10) / exposure[: len(exposure)][
        : len(lines(ax)["photons alone, channel G"][1])]
    electrons = per_exposure[0] * exposure[at]
    raws = readout.draw_electrons(np.full((120, 120), electrons, np.float32), 1e-9, frames=2, seed=3)
    noise = np.std(raws[1].astype(float) - raws[0]) / 2**0.5 / sensor.gain_dn_per_electron
    assert 20 * np.log10(electrons / noise) == pytest.approx(snr[at], abs=0.25)


def test_raw_is_in_its_filters_colours():
    frame = gs.Simulator(PHONE, device="numpy")(gs.chart("flat", size=(24, 16)))
    codes = np.asarray(gs.plot.raw(frame).images[0].get_array())
    red, green, blue = codes[::2, ::2], codes[::2, 1::2], codes[1::2, 1::2]  # RG / GB
    assert not red[..., 1:].any() and not blue[..., :2].any() and not green[..., [0, 2]].any()
    signal = (frame.raw[::2, 1::2] - PHONE.sensor.dark_level) / (PHONE.sensor.white_level - PHONE.sensor.dark_level)
    np.testing.assert_allclose(green[..., 1], 255 * signal ** (1 / 2.2), atol=0.51)


def test_mosaics_of_other_letters_are_seen():
    sensor = replace(PHONE.sensor, channels=("R", "W", "K"), cfa=("RW", "WK"))
    codes = colored(sensor, np.full((4, 4), 100, np.uint8))
    assert codes[0, 0].tolist() == [100, 0, 0] and codes[0, 1].tolist() == [100] * 3 == codes[1, 1].tolist()
    layers = np.arange(48, dtype=np.uint8).reshape(3, 4, 4)
    stacked = replace(PHONE.sensor, stacked=True)
    np.testing.assert_array_equal(colored(stacked, layers), np.moveaxis(layers, 0, -1))


# --------------------------------------------------------------------------------------------------- light, pictures


def test_scene_is_as_colour_science_renders_it():
    """Patches in D65 of 1 nm sums; theirs is an ASTM E308 integral of the 5 nm tables: 0.01 of the codes."""
    nodes = np.arange(380.0, 781.0, 5.0)
    scene = gs.chart("colorchecker", size=(96, 64), wavelengths=nodes)
    picture = gs.plot.scene(scene).images[0].get_array()
    cmfs = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"].copy().align(colour.SpectralShape(380, 780, 5))
    light = colour.SDS_ILLUMINANTS["D65"].copy().align(colour.SpectralShape(380, 780, 5))
    table = reflectances("colorchecker").at(nodes, outside=None)
    for (rows, cols), values in list(zip(colorchecker_patches((96, 64)), table, strict=True))[:17]:  # cyan is outside
        xyz = colour.sd_to_XYZ(colour.SpectralDistribution(values, nodes), cmfs, light) / 100
        expected = np.clip(colour.XYZ_to_sRGB(xyz), 0, 1)
        np.testing.assert_allclose(picture[rows, cols][2, 2], expected, atol=0.01)


def test_sfr_of_a_gaussian_edge_is_marked_where_it_is_a_half(ax):
    angle, sigma, pitch = np.radians(5), 0.7, 2e-6
    image = 0.2 + 0.5 * gaussian_edge(160, 200, angle, sigma)
    gs.plot.sfr(sfr(image, pitch=pitch), ax)
    (f, response), *_ = [line.get_data() for line in ax.get_lines()]
    expected = gaussian_mtf(f * pitch * 1e3, angle, sigma)
    np.testing.assert_allclose(response, expected, atol=5e-3)  # tests/host/test_sfr.py derives 1e-3 up to half a cycle
    half = np.interp(0.5, expected[::-1], f[::-1])
    label = ax.get_legend().get_texts()[0].get_text()
    assert label.endswith(" cycle/mm") and float(label.split()[1]) == pytest.approx(half, rel=5e-3)


def test_sfr_of_a_camera_has_all_channels():
    axes = gs.plot.sfr(gs.open_camera("mono"), device="numpy")
    assert axes.get_legend().get_texts()[0].get_text().startswith("W: MTF50")
    frame = gs.Simulator(PHONE, device="numpy")(gs.chart("slanted-edge", size=(200, 160)))
    assert [text.get_text()[:8] for text in gs.plot.sfr(frame).get_legend().get_texts()] == [
        "R: MTF50", "G: MTF50", "B: MTF50"]


# --------------------------------------------------------------------------------------------------------- refusals


@pytest.mark.parametrize("call, error, words", [
    (lambda: gs.plot.mtf(3), BadData, "camera: int, wanted a Camera"),
    (lambda: gs.plot.mtf(PHONE, "X"), UnknownName, "unknown channel 'X'; known: B, G, R"),
    (lambda: gs.plot.mtf(PHONE, 5), OutOfRange, "of = 5: allowed is wavelengths within"),
    (lambda: gs.plot.mtf(PHONE, []), BadData, "nothing to draw"),
    (lambda: gs.plot.mtf(PHONE, direction="up"), UnknownName, "unknown direction 'up'"),
    (lambda: gs.plot.mtf(PHONE, light="D66"), UnknownName, "unknown light 'D66'"),
    (lambda: gs.plot.mtf(PHONE, 550, 3), BadData, "ax: int, wanted axes of matplotlib"),
    (lambda: gs.plot.psf(PHONE.with_(optics=replace(PHONE.optics, model="none"))), BadData, "no lens that blurs"),
    (lambda: gs.plot.psf(PHONE, figure=3), BadData, "figure: int, wanted a figure"),
    (lambda: gs.plot.snr("phone"), BadData, "snr: str, wanted a Camera or a Sensor"),
    (lambda: gs.plot.snr(PHONE, seconds=-1), OutOfRange, "seconds = -1 s"),
    (lambda: gs.plot.raw(PHONE), BadData, "raw: Camera, wanted a frame"),
    (lambda: gs.plot.scene("colorchecker"), BadData, "scene: str, wanted a Scene"),
    (lambda: gs.plot.sfr(np.ones((9, 9))), BadData, "sfr: ndarray, wanted a Camera, a frame"),
])
def test_bad_input_is_refused_in_one_line(call, error, words):
    with pytest.raises(error, match=words) as refused:
        call()
    assert "\n" not in str(refused.value)


def test_without_matplotlib_it_is_said_how_to_get_it(monkeypatch):
    for name in ("matplotlib", "matplotlib.pyplot"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(Missing, match=r"matplotlib is not installed; wanted: pip install 'gpusim\[plot\]'"):
        gs.plot.mtf(PHONE)

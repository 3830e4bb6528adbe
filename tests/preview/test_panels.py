"""Numbers in the preview's panels, against closed forms, other programs and frames counted pixel by pixel."""

from dataclasses import replace
from math import erf, pi, sqrt

import colour
import numpy as np
import pytest
from scipy.special import j1

import gpusim as gs
from gpusim.apps.preview.figures import Bars, Image, Note, Table
from gpusim.apps.preview.measures import NEAR, Where, find_clipping, mark_clipping
from gpusim.apps.preview.panels import PANELS
from gpusim.apps.preview.panels_kept import Kept
from gpusim.apps.preview.panels_lens import FREQUENCIES, system_mtf
from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.state import State
from gpusim.apps.video.scenes import Moving, Still
from gpusim.backends import open_device
from gpusim.captures.burst import Burst
from gpusim.domain.errors import BadData
from gpusim.domain.motion import Motion
from gpusim.measure.lens import field_place, lens_mtf, pixel_mtf, point_spread
from gpusim.measure.noise_budget import noise_budget
from gpusim.measure.spectra import patch_spectrum
from gpusim.pipeline.readout import Readout

STATE = State("phone", {"sensor.exposure_time_ms": 20.0}, tolerance="exact", is_live=False)
SIZE = (96, 64)
SLOW = ("quad-bayer", "x-trans", "rgbw-kodak")
NAMES = ("bayer-grbg", "mono", "stacked", "binned", *SLOW)
MOSAICS = [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in NAMES]


@pytest.fixture
def cameras(tmp_path):
    """A function from a mosaic to the file of a phone with it."""

    def camera(mosaic):
        keys = {"stacked": "stacked = true", "binned": "binning = [2, 2]"}.get(
            mosaic, f'cfa = "{mosaic}"'
        )
        path = tmp_path / f"{mosaic}.toml"
        path.write_text(f'base = "phone"\n[sensor]\n{keys}\n')
        return str(path)

    return camera


def produced(scene, state=STATE, number=3, **options):
    """A producer with a picture."""
    made = Producer(Still(scene, 1), open_device("opencl"), **options)
    made.picture(state, number)
    return made


def read(producer, name, where=None, **chosen):
    """What a panel shows of the producer's picture, and its inputs."""
    panel = PANELS[name]
    camera = producer._made.loop.simulator.camera
    chosen = {key: one[0] for key, one in panel.choices(camera.sensor.channels).items()} | chosen
    where = where or Where(producer._made.loop.scene.shape)
    needs = set(panel.needs(chosen, where))
    if "irradiance" in needs:
        producer.irradiance()
    found = producer.inputs(frozenset(needs - {"irradiance"}), "irradiance" in needs)
    return panel.read(found, where, chosen, Kept()), found


def own_channel(sensor, shape):
    """Letter of each pixel, by counting."""
    high, wide = len(sensor.cfa), len(sensor.cfa[0])
    return np.array(
        [[sensor.cfa[y % high][x % wide] for x in range(shape[1])] for y in range(shape[0])]
    )


@pytest.mark.parametrize("mosaic", MOSAICS)
def test_histogram_and_profiles_are_those_of_the_frame(cameras, mosaic):
    state = replace(STATE, camera=cameras(mosaic))
    scene = gs.chart("colorchecker", size=SIZE)
    frame = gs.Simulator(state.build(), device="opencl").frames(scene, 1, first=3)
    frame = next(frame)
    producer = produced(scene, state)
    sensor, raw = frame.camera.sensor, frame.raw.astype(int)
    [chart, _], _ = read(producer, "histogram", scale="linear")
    step = -(-(sensor.white_level + 1) // 128)
    for line in chart.lines:
        own = (
            raw[sensor.channels.index(line.label)]
            if sensor.stacked
            else raw[own_channel(sensor, raw.shape) == line.label]
        )
        counts = np.bincount(own.ravel() // step, minlength=len(line.y))
        assert np.allclose(line.y, 100 * counts / own.size, atol=1e-12)
    marks = {mark.label.split()[0]: mark.at for mark in chart.marks}
    assert marks["black"] == sensor.black_level
    # at digital number d there are (d - black level) / gain electrons, besides the analog offset
    _, factor, zero = chart.top
    gain = (marks["saturation"] - sensor.dark_level) / sensor.saturation
    assert (factor, zero) == pytest.approx((1 / gain, sensor.black_level))
    where, (rows, cols) = Where(scene.shape, (21, 40)), frame.raw.shape[-2:]
    row, col = 21 * rows // 64, 40 * cols // 96  # fewer if they are binned
    for quantity, values in (("electrons", frame.mean), ("DN", frame.raw)):
        for along, cut in (("row", np.s_[..., row, :]), ("column", np.s_[..., col])):
            [chart, _], _ = read(producer, "profile", where, quantity=quantity, along=along)
            for line in chart.lines:
                if sensor.stacked:
                    expected, at = values[cut][sensor.channels.index(line.label)], slice(None)
                else:
                    expected = values[cut]
                    at = own_channel(sensor, values.shape)[cut] == line.label
                assert np.array_equal(line.y, expected[at])
            assert sum(len(line.x) for line in chart.lines) == values[cut].size
    [chart, _], _ = read(producer, "profile", where, quantity="codes")
    assert np.array_equal([line.y for line in chart.lines], frame.rgb[row].T)


def test_statistics_of_a_region_are_those_of_its_pixels():
    scene = gs.chart("deadleaves", size=SIZE)
    producer = produced(scene)
    frame = next(gs.Simulator(STATE.build(), device="opencl").frames(scene, 1, first=3))
    sensor, part = frame.camera.sensor, np.s_[11:31, 5:40]
    letters, raw = own_channel(sensor, frame.raw.shape)[part], frame.raw[part].astype(float)
    [table, _], _ = read(producer, "region", Where(scene.shape, (0, 0), (11, 5, 31, 40)))
    assert isinstance(table, Table) and [line[0] for line in table.body] == ["R", "G", "B"]
    gain = (2**sensor.bits - 1 - sensor.black_level) / sensor.full_well
    for letter, count, mean, sd, electrons, sd_electrons, ratio in table.body:
        own = raw[letters == letter]
        above = own.mean() - sensor.black_level
        expected = (own.mean(), own.std(ddof=1), above / gain, own.std(ddof=1) / gain)
        assert (mean, sd, electrons, sd_electrons) == pytest.approx(expected) and count == str(
            own.size
        )
        assert ratio == pytest.approx(20 * np.log10(above / own.std(ddof=1)))
    rows, cols = Where(scene.shape, (2, 50)).region(scene.shape)
    assert (rows, cols) == (slice(0, 2 + NEAR), slice(50 - NEAR, 50 + NEAR))


def test_places_follow_a_binned_frame():
    where = Where((64, 96), (33, 95), (10, 20, 31, 41))
    assert where.pixel((64, 96)) == (33, 95) and where.pixel((32, 48)) == (16, 47)
    assert where.region((64, 96)) == (slice(10, 31), slice(20, 41))
    assert where.region((32, 48)) == (slice(5, 16), slice(10, 21))
    assert Where((64, 96)).pixel((32, 48)) == (16, 24)


def flat(reflectance=0.5, size=SIZE, luminance=200.0):
    return gs.chart("flat", size=size, reflectance=reflectance, luminance=luminance)


def test_a_spectrum_has_the_luminance_of_the_patch():
    """683 times its integral with the CIE's V is 0.5 x 200 cd/m2; steps of 1 nm: within 1e-3, as the
    scene's 10 nm are interpolated."""
    [chart, _], _ = read(produced(flat()), "spectrum", quantity="radiance")
    [line] = chart.lines
    eye = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    nodes = np.arange(400.0, 701.0)
    v = np.interp(nodes, eye.wavelengths, eye.values[:, 1])
    found = 683.002 * np.trapezoid(np.interp(nodes, line.x, line.y) * v, nodes)
    assert found == pytest.approx(100, rel=2e-3)  # V outside of 400 .. 700 nm has 0.1 %


def test_irradiance_and_electrons_of_an_even_scene():
    """E = pi L T / (1 + 4 N^2 (1 + m)^2), and the electrons are those of the frame's mean.

    The frame integrates products of tables; the sum of 31 values by trapezoids errs by some 1e-3."""
    scene = flat()
    producer = produced(scene)
    [chart, _], found = read(producer, "spectrum", quantity="irradiance")
    [line] = chart.lines
    nodes, radiance = patch_spectrum(scene, (48, 32))
    optics = found.camera.optics
    m = optics.focal_length / (optics.object_distance - optics.focal_length)
    assert m == 0 or np.isfinite(m)
    factor = pi / (1 + 4 * (optics.f_number * (1 + m)) ** 2)
    expected = factor * optics.transmission_at(line.x) * np.interp(line.x, nodes, radiance)
    middle = found.arrays["irradiance"][:, 32, 48]
    assert np.isfinite(middle).all()
    assert line.y == pytest.approx(expected, rel=2e-3)
    where = Where(scene.shape, None, (24, 40, 40, 56))
    [chart, _], found = read(producer, "spectrum", where, quantity="electrons")
    mean = producer.inputs(frozenset({"mean"})).arrays["mean"]
    letters = own_channel(found.sensor, mean.shape)
    for line in chart.lines:
        own = mean[24:40, 40:56][letters[24:40, 40:56] == line.label].mean()
        assert np.trapezoid(line.y, line.x) == pytest.approx(own, rel=5e-3)


def test_spectra_of_a_scene_in_motion_are_those_of_what_it_shows():
    """At a whole-sample shift those of the displaced pixel; at others those of a whole frame's spline."""
    from gpusim.domain.scene import View
    from gpusim.plot.light import _apply_view

    scene = gs.chart("deadleaves", size=SIZE)
    moved = replace(scene, view=View((3.0, -5.0)))
    assert patch_spectrum(moved, (40, 30))[1] == pytest.approx(
        patch_spectrum(scene, (35, 33))[1], rel=1e-6
    )
    turned = replace(scene, view=View((0.4, -0.3), 0.1, 1.2))
    whole = _apply_view(turned)
    for place in ((48, 32), (30, 20, 36, 29)):
        expected = patch_spectrum(whole, place)[1]
        assert patch_spectrum(turned, place)[1] == pytest.approx(expected, rel=1e-4)
    producer = Producer(
        Moving(Still(scene, 6), Motion((0.0, 40.0), 0.0, 1.4, 1.0, 1.0, 0), 1 / 30),
        open_device("opencl"),
        1 / 30,
    )
    for number in (2, 3):
        producer.picture(STATE, number)
        for name in PANELS:
            if name != "checker":
                read(producer, name)
    with pytest.raises(BadData, match="ColorChecker"):
        read(producer, "checker")


def diffraction(f, wavelength, number):
    """Transfer of a clear circular pupil, f in cycle/m."""
    s = np.clip(f * wavelength * number, 0, 1)
    return 2 / pi * (np.arccos(s) - s * np.sqrt(1 - s**2))


def test_the_system_transfer_is_diffraction_times_the_aperture():
    camera = STATE.build()
    pitch, number = camera.sensor.pixel_pitch, camera.optics.f_number
    f = FREQUENCIES / pitch
    expected = diffraction(f, 550e-9, number)
    assert lens_mtf(camera, 550.0, f) == pytest.approx(expected, abs=2e-3)
    side = pitch * sqrt(camera.sensor.fill_factor)
    assert pixel_mtf(camera, f) == pytest.approx(np.sinc(f * side), abs=1e-12)
    lines = system_mtf(camera, "across", (0.0, 0.0), "D65")
    green = next(line for line in lines if line.label.startswith("G"))
    low, high = (
        diffraction(f, one, number) * np.abs(np.sinc(f * side)) for one in (650e-9, 450e-9)
    )
    inner = slice(5, 60)
    assert (green.y[inner] > low[inner]).all() and (green.y[inner] < high[inner]).all()


def test_an_edge_and_the_system_agree():
    """The panel's measured edge of a noise-free mono camera against its own system curve.

    A window of 40 pixels lifts the response by up to 11 q / (pi^3 reach), see `sfr`: 0.03 here."""
    state = State(
        "mono", {"noise.photon": "none", "noise.read_e": 0.0, "noise.prnu": 0.0, "noise.dsnu_e": 0.0},
        tolerance="exact", is_live=False,
    )  # fmt: skip
    scene = gs.chart("slanted-edge", size=(200, 160), samples_per_pixel=2)
    where = Where(scene.shape, (80, 100), (20, 40, 140, 160))
    parts, _ = read(produced(scene, state), "mtf", where)
    lines = {line.label: line for line in parts[0].lines}
    system = parts[0].lines[0]
    edge = np.interp(system.x, lines["edge"].x, lines["edge"].y)
    assert edge[:50] == pytest.approx(system.y[:50], abs=0.04)
    assert any("MTF50" in part.text for part in parts[1:])
    nothing, _ = read(produced(scene, state), "mtf", Where(scene.shape, (5, 5), (2, 2, 20, 20)))
    assert any("sfr:" in part.text for part in nothing[1:])


def test_the_point_spread_is_airys():
    """(2 J1(x) / x)^2 with x = pi r / (lambda N), integrated over fine samples: 2 % at the middle ones."""
    camera = STATE.build()
    energy, step = point_spread(camera, 550.0)
    at = (np.arange(len(energy)) - len(energy) // 2) * step
    x = pi * np.hypot(at[:, None], at) / (550e-9 * camera.optics.f_number)
    with np.errstate(invalid="ignore"):
        airy = np.where(x > 0, (2 * j1(x) / x) ** 2, 1.0)
    near = x < 3
    assert energy[near] / energy.max() == pytest.approx(airy[near], abs=0.02)
    [image, note], _ = read(produced(flat()), "psf")
    assert isinstance(image, Image) and isinstance(note, Note)
    shape = (64, 96)
    corner = field_place(camera, shape, 0, 0)
    assert np.hypot(*corner) == pytest.approx(np.hypot(31.5, 47.5) / np.hypot(32, 48))
    assert corner[0] < 0 and corner[1] < 0 and field_place(camera, (65, 97), 32, 48) == (0.0, 0.0)
    none = replace(STATE, changes={})
    with pytest.raises(BadData, match="no point spread"):
        point_spread(none.build().with_(optics=replace(camera.optics, model="none")), "G")


NOISY = gs.open_camera("phone").sensor


@pytest.mark.parametrize(
    "binning, mode", [((1, 1), "charge"), ((2, 2), "charge"), ((2, 2), "digital")]
)
def test_the_noise_budget_is_the_variance_of_an_even_frame(binning, mode):
    """128 x 128 output pixels or more: the sample variance has a standard deviation of
    sqrt(2 / 16384) = 1.1 %; 4 of them."""
    noise = replace(
        NOISY.noise, read=3.0, reset=4.0, adc=1.0, dark_current=200.0, prnu=0.03, dsnu=2.0,
        row=0.0, column=0.0, hot_pixels=0.0, dead_pixels=0.0, photon="exact",
    )  # fmt: skip
    sensor = replace(NOISY, noise=noise, binning=binning, binning_mode=mode, cfa=("R",), channels=("R",),
                     qe=replace(NOISY.qe, values=NOISY.qe.values[:1]), filters=None)  # fmt: skip
    readout, electrons, seconds = Readout(sensor, "opencl"), 1500.0, 0.2
    size = 128 * binning[0], 128 * binning[1]
    pixels = readout.device.array(np.full(size, electrons, np.float32))
    raw = readout.device.numpy(readout.draw(readout.chip_mean(pixels, seconds), seconds))
    own = readout.sensor_at_gain(1.0)
    found = raw.astype(float).var() / own.gain_dn_per_electron**2
    light = electrons * readout.pixels
    budget = noise_budget(own, light, seconds, averaged=readout.averaged, added=readout.pixels)
    assert found == pytest.approx(sum(budget.values()), rel=4 * sqrt(2 / 128**2))
    if binning == (1, 1):
        assert budget["photons"] == 1500 and budget["dark current"] == pytest.approx(40, rel=1e-6)
        assert budget["PRNU"] == pytest.approx((0.03 * 1500) ** 2) and budget["reset"] == 16


def test_signal_to_noise_and_budget_of_a_pixel():
    scene = gs.chart("ramp", size=SIZE)
    producer = produced(scene)
    where = Where(scene.shape, (20, 60))
    [chart, note], found = read(producer, "snr", where)
    sensor, mean = found.sensor, float(found.arrays["mean"][20, 60])
    noise, gain = sensor.noise, 1023 / 6000  # 10 bits; the well reaches white from black on
    gain = (1023 - sensor.black_level) / sensor.full_well
    dark = noise.dark_current * 2 ** (
        (noise.temperature - noise.reference_temperature) / noise.doubling
    )
    variance = (
        mean + dark * 0.02 + noise.read**2 + noise.reset**2 + (noise.adc / gain) ** 2
        + noise.row**2 + noise.column**2 + (noise.prnu * mean) ** 2 + noise.dsnu**2 + 1 / 12 / gain**2
    )  # fmt: skip
    point = next(line for line in chart.lines if line.is_points)
    expected = 20 * np.log10(mean) - 10 * np.log10(variance)
    assert point.x == pytest.approx(mean) and point.y == pytest.approx(expected, abs=1e-6)
    assert f"{expected:.1f} dB" in note.text
    curve = chart.lines[0]
    assert np.interp(np.log(mean), np.log(curve.x), curve.y) == pytest.approx(expected, abs=0.01)
    [bars, note], _ = read(producer, "budget", where)
    assert isinstance(bars, Bars) and bars.values["all together"] == pytest.approx(sqrt(variance))
    assert next(iter(bars.values)) in note.text and bars.values["photons"] == pytest.approx(
        sqrt(mean)
    )


def test_the_color_checker_is_that_of_the_frame():
    from gpusim.measure.checker import Checker

    scene = gs.chart("colorchecker", size=SIZE)
    [bars, note], found = read(produced(scene), "checker")
    frame = next(gs.Simulator(STATE.build(), device="opencl").frames(scene, 1, first=3))
    expected = Checker(scene).differences(
        frame.linear, frame.rendering.diffuser, frame.camera.display
    )
    assert [*bars.values.values()] == pytest.approx(expected.tolist(), abs=1e-6)
    assert f"{expected.mean():.2f}" in note.text and len(bars.values) == 24
    red = bars.colors["patch 15"]
    assert int(red[1:3], 16) > 2 * int(red[3:5], 16)
    assert found.rendering.diffuser == pytest.approx(frame.rendering.diffuser)


def test_the_plans_errors_and_times():
    producer = produced(gs.chart("deadleaves", size=SIZE), replace(STATE, tolerance="1e-2"))
    parts, found = read(producer, "plan")
    errors = parts[0].values
    total = errors.pop("all together")
    assert total == pytest.approx(sqrt(sum(value**2 for value in errors.values())))
    assert total == pytest.approx(found.account.total.rms) and parts[0].limit.at == 0.01
    times = parts[-1].values
    assert times.keys() >= {"sensor.noise"} and any(name.startswith("optics.") for name in times)
    assert all(value > 0 for value in times.values())


def test_clipped_pixels():
    """Dark, at black level 0 and a read noise of 2 DN a value is 0 with Phi(0.25): below 0.5 DN."""
    sensor = replace(NOISY, black_level=0, gain=1.0, full_well=1e5, bits=10,
                     noise=replace(NOISY.noise, read=2.0, dsnu=0.0, dark_current=0.0))  # fmt: skip
    readout = Readout(sensor, "opencl")
    dark = readout.device.array(np.zeros((128, 128), np.float32))
    raw = readout.device.numpy(readout.draw(readout.chip_mean(dark, 1.0), 1.0))
    bright, low = find_clipping(sensor, raw)
    share = (1 + erf(0.25 / sqrt(2))) / 2
    assert low.mean() == pytest.approx(share, abs=4 * sqrt(share * (1 - share) / 128**2))
    assert not bright.any()
    values = np.array([[1022, 1023], [1, 0]])
    bright, low = find_clipping(sensor, values)
    assert bright.tolist() == [[False, True], [False, False]] and low[1, 1] and low.sum() == 1
    stacked = np.stack([values, np.full((2, 2), 500)])
    assert np.array_equal(find_clipping(sensor, stacked)[0], bright)
    codes = mark_clipping(
        np.full((16, 16, 3), 7, np.uint8), np.ones((16, 16), bool), np.zeros((16, 16), bool)
    )
    assert {tuple(one) for one in codes.reshape(-1, 3).tolist()} == {(7, 7, 7), (255, 40, 40)}
    assert (codes[..., 0] == 255).mean() == 0.5


@pytest.mark.parametrize("mosaic", ["bayer-rggb", "stacked"])
def test_a_marked_picture_says_the_share_of_clipped_pixels(cameras, mosaic):
    state = replace(
        STATE,
        camera=cameras(mosaic),
        changes={"sensor.exposure_time_ms": 200.0},
        marks_clipped=True,
    )
    scene = gs.chart("ramp", size=SIZE)
    producer = produced(scene, state)
    picture, plain = (
        producer.picture(one, 3) for one in (state, replace(state, marks_clipped=False))
    )
    frame = producer.frame(state, 3)
    # 5 standard deviations of photon and read noise decide whether a pixel is full
    full, wide = frame.camera.sensor.full_well, 5 * (sqrt(6000) + 10)
    least, most = (
        (mean.any(axis=0) if mean.ndim == 3 else mean).mean()
        for mean in (frame.mean > full + wide, frame.mean > full - wide)
    )
    share = float(picture.facts["clipped"].split()[1].rstrip("%")) / 100
    assert 0.1 < least <= share <= most < least + 0.1
    marked = (picture.codes != plain.codes).any(axis=-1)
    assert 0 < marked.mean() <= share + 1e-4 and "clipped" not in plain.facts
    assert np.array_equal(plain.codes, frame.rgb)


def test_views_of_the_light_before_the_sensor():
    from gpusim.plot.light import irradiance_codes, radiance_codes

    scene = gs.chart("colorchecker", size=SIZE)
    producer = produced(scene)
    seen = producer.picture(replace(STATE, view="scene"), 0).codes
    assert np.abs(seen - 255 * radiance_codes(scene)[0]).max() <= 0.5
    for state in (STATE, replace(STATE, changes={"optics.f_number": 8.0})):
        behind = producer.picture(replace(state, view="irradiance"), 0).codes
        expected = irradiance_codes(state.build(), scene, "opencl")[0]
        assert np.abs(behind - 255 * expected).max() <= 0.51


@pytest.mark.parametrize(
    "mosaic",
    [name if name == "stacked" else pytest.param(name, marks=pytest.mark.slow) for name in NAMES],
)
def test_every_panel_of_every_mosaic(cameras, mosaic):
    state = replace(STATE, camera=cameras(mosaic))
    producer = produced(gs.chart("colorchecker", size=SIZE), state)
    for name, panel in PANELS.items():
        if mosaic == "binned" and name == "checker":
            with pytest.raises(BadData, match="binned"):
                read(producer, name)
            continue
        for where in (None, Where((64, 96), (0, 95)), Where((64, 96), (63, 0), (10, 10, 40, 50))):
            parts, found = read(producer, name, where)
            assert parts and all(isinstance(part.html(), str) for part in parts)
            chosen = {
                key: one[0] for key, one in panel.choices(found.camera.sensor.channels).items()
            }
            assert isinstance(panel.inputs(found, where or Where((64, 96)), chosen), tuple)


def test_merged_frames_say_what_they_cannot_tell():
    scene = gs.chart("colorchecker", size=SIZE)
    producer = produced(scene, capture=Burst(4, merged=True))
    for name in PANELS:
        if name in ("snr", "budget"):
            with pytest.raises(BadData, match="merged"):
                read(producer, name)
        else:
            read(producer, name)
    _, found = read(producer, "histogram")
    raw = producer.frame(STATE, 3).raw
    assert found.averaged is None and np.array_equal(found.arrays["raw"], raw)
    assert producer.picture(replace(STATE, marks_clipped=True), 3).facts["clipped"]


def test_a_panel_is_read_again_only_if_its_inputs_change():
    from types import SimpleNamespace

    from gpusim.apps.preview.dock import Dock

    producer = produced(gs.chart("ramp", size=SIZE))
    dock = Dock(None, None)
    names = ("histogram", "qe", "spectrum", "plan")
    cards = [
        SimpleNamespace(panel=PANELS[name], inputs=None, chosen={k: v[0] for k, v in PANELS[name].options.items()})
        for name in names
    ]  # fmt: skip

    def changed(where):
        found = producer.inputs(frozenset({"raw", "times"}))
        return {
            name for name, one in zip(names, dock._read(cards, found, where)[1], strict=True) if one
        }

    where = Where((64, 96), (5, 5))
    assert changed(where) == {*names} and changed(where) == set()
    assert changed(replace(where, at=(6, 5))) == {"spectrum"}
    producer.picture(STATE, 4)
    assert "histogram" in changed(where) and "qe" not in changed(where)
    cards[2].chosen = {"quantity": "reflections"}
    [*_, result, _] = dock._read(cards, producer.inputs(frozenset({"raw"})), where)[1]
    assert "irradiance" in result[1]

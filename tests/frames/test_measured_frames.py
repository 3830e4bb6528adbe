"""The simulator's own frames by the measures: they find what was simulated."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from test_sfr import EVEN, FIVE, figure8, reach, unseen

from gpusim import Display, Noise, Simulator, chart, open_camera
from gpusim.color.color import color_matrix
from gpusim.data.charts import colorchecker_patches
from gpusim.data.displays import display_picture, open_display
from gpusim.data.lights import illuminant
from gpusim.data.reflectances import reflectances
from gpusim.domain.errors import BadData
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.domain.spectrum import photons_from_energy
from gpusim.kernels.processor.levels import CORRECTED_BLACK, CORRECTED_WHITE
from gpusim.measure import ciede2000, ideal, mtf50, scielab, sfr, snr, visible_snr

NODES = np.arange(400.0, 701.0, 10.0)


def test_ideal_frames():
    """The simulator's own picture of grey is the scene's; a ColorChecker's differs by what its matrix leaves.

    The camera is noise-free; grey differs by rounding to 16 bits, 1e-5 of white: 116 / 3 * 1e-5 / .18^(2/3) = 1e-3. A
    patch may differ by what the worst rounding of its three channels does, and 1e-4 for float32 (1e-7 of white: 500 / 3
    * 1e-7 / .03^(2/3)).
    """
    camera = open_camera("phone")
    camera = replace(
        camera,
        sensor=replace(camera.sensor, bits=FLOAT_BITS, noise=Noise(photon="none")),
        optics=replace(camera.optics, model="none", relative_illumination="none"),
    )
    simulate = Simulator(camera)
    flat = chart("flat", size=(32, 24))
    frame = simulate(flat)
    found = ciede2000(frame, flat)
    assert found.shape == (24, 32) and found.max() < 5e-3
    assert scielab(frame, flat, 30.0).max() < 5e-3
    assert ciede2000(frame, frame).max() == 0
    assert visible_snr(frame, 30.0) > 1e3
    # the exposure is divided out: four stops darker the rounding to 16 bits is 16 times as large, 1.6e-2
    dark = simulate.expose(flat, frame.exposure_time / 16).frame()
    assert dark.linear.max() < frame.linear.max() / 15 and ciede2000(dark, flat).max() < 0.05
    checker = chart("colorchecker", size=(192, 128))
    frame = simulate(checker)
    difference = ciede2000(frame, checker)
    patches = [
        difference[y.start + 6 : y.stop - 6, x.start + 6 : x.stop - 6].mean()
        for y, x in colorchecker_patches((192, 128))
    ]
    print(f"ColorChecker in D65: mean CIEDE2000 {np.mean(patches):.2f}, worst {max(patches):.2f}")
    # electrons of every patch, by the trapezoidal rule over .1 nm (1 nm errs by 1e-5), through the camera's matrix
    nm = np.linspace(400, 700, 3001)
    lit = photons_from_energy(illuminant("D65")).at(nm)
    surfaces = np.vstack(
        [CubicSpline(NODES, reflectances("colorchecker").at(NODES), axis=-1)(nm), np.ones(len(nm))]
    )
    electrons = np.trapezoid(camera.sensor.qe.at(nm)[:, None] * lit * surfaces, nm)
    matrix = color_matrix(
        camera.sensor.qe, "D65", camera.processor.training, method=camera.processor.color
    ).matrix
    shares = electrons[:, :24] / electrons[:, 24].max()
    rounding = (
        0.5
        / (CORRECTED_WHITE - CORRECTED_BLACK)
        / (frame.rendering.white * frame.rendering.diffuser)
    )
    wanted = ideal(checker)
    wanted = np.stack(
        [wanted[patch].mean(axis=(0, 1)) for patch in colorchecker_patches((192, 128))]
    )
    known, *others = (
        ciede2000(np.clip(matrix @ (shares + shift), 0, 1).T @ Display().xyz_from_rgb.T, wanted)
        for shift in np.array([(0, 0, 0), *product((-1, 1), repeat=3)])[:, :, None] * rounding
    )
    assert (np.abs(patches - known) <= np.abs(np.array(others) - known).max(0) + 1e-4).all()


@pytest.mark.parametrize("light", [20.0, 500.0])
def test_snr_of_photons(light):
    """SNR = sqrt(N) through the simulator: 128 x 128 pixels tell it to 1 / sqrt(2 n) = 0.55 %, 0.048 dB; 5 of these."""
    camera = open_camera("mono")
    sensor = replace(camera.sensor, bits=FLOAT_BITS, noise=Noise(prnu=0.05), full_well=10000.0)
    simulate = Simulator(replace(camera, sensor=sensor))
    first, second = (
        simulate.readout.draw_electrons(np.full((128, 128), light), 0.01, first=number).astype(
            np.float64
        )
        for number in (0, 1)
    )
    first, second = (
        (raw - sensor.dark_level) / sensor.gain_dn_per_electron for raw in (first, second)
    )
    known = 10 * np.log10(light)
    assert snr(first, second) == pytest.approx(known, abs=0.24)  # temporal alone
    both = 20 * np.log10(light / np.sqrt(light + (0.05 * light) ** 2))
    assert snr(first) == pytest.approx(both, abs=0.24)
    assert snr(np.stack([first, 2 * second], axis=-1)) == pytest.approx([snr(first), snr(second)])


@pytest.mark.parametrize("defocus", figure8.DEFOCUS)
def test_figure_8(defocus):
    """Luminance and camera colours through the whole simulator, bilinear demosaicking included.

    The reading lifts the response by what it does not see (q of 700 nm at most), and bins are uneven; over the slope of
    the response that is the tolerance of MTF50. 0.1 %: colours are 16-bit numbers, the simulator's sampling.
    """
    frame = figure8.picture(defocus)
    pitch, light = frame.camera.sensor.pixel_pitch, photons_from_energy(illuminant("D65"))
    truth = figure8.exact(defocus, figure8.shown_weights(frame), light, fine=figure8.FINE)
    exact = mtf50(truth)
    slope = -np.interp(exact, truth.per_mm, np.gradient(truth.response, truth.per_mm))
    shape = figure8.SIZE[::-1]
    lifted = unseen(700e-9 * frame.camera.optics.f_number / pitch, reach(shape, FIVE))
    found = mtf50(sfr(figure8.luminance(frame), pitch))
    print(
        f"{1e6 * defocus:g} um: {found:.2f} cycles/mm, formula {exact:.2f} ({100 * (found / exact - 1):+.2f} %)"
    )
    assert abs(found - exact) <= 0.5 * (lifted + EVEN) / slope + 1e-3 * exact


def test_figure_8_with_noise():
    """The camera as it is, with shot noise, read noise and 10 bits: the mean of 8 frames, 5 of its standard errors."""
    camera = figure8.camera_at(10e-6)
    camera = replace(camera, sensor=open_camera("figure8").sensor)
    scene = chart("slanted-edge", size=figure8.SIZE, samples_per_pixel=figure8.FINE)
    frames = Simulator(camera).frames(scene, 8)
    found = [mtf50(sfr(figure8.luminance(frame), camera.sensor.pixel_pitch)) for frame in frames]
    exact = mtf50(sfr(figure8.luminance(figure8.picture(10e-6)), camera.sensor.pixel_pitch))
    spread = np.std(found, ddof=1)
    print(np.round(found, 2), round(exact, 2))
    assert spread < 0.05 * exact
    assert abs(np.mean(found) - exact) < 5 * spread / np.sqrt(8)


def test_a_defocused_lens_in_a_small_crop_is_refused():
    """The figure's camera 40 um out of focus: a crop of 30 columns once gave an MTF50 a fifth too high."""
    light = figure8.luminance(figure8.picture(40e-6, "numpy"))
    with pytest.raises(BadData, match="does not fit"):
        sfr(light[30:130, 105:135])
    whole, part = (mtf50(sfr(picture)) for picture in (light, light[:, 50:190]))
    assert part == pytest.approx(whole, rel=0.02)


def test_a_picture_of_a_picture():
    """The camera takes its own picture off a screen: greys come out grey again, by the same curve."""
    codes = np.zeros((48, 64, 3), np.uint8)
    codes[:, :32], codes[:, 32:] = 255, 128
    camera = open_camera(
        "phone"
    )  # without blur: diffraction would add 0.5 % of the white half to the grey one
    camera = replace(camera, optics=replace(camera.optics, model="none"))
    frame = Simulator(camera, device="opencl")(display_picture(codes, open_display("lcd-apple")))
    bright, dark = (
        frame.linear[12:36, cols].mean(axis=(0, 1)) for cols in (np.s_[4:28], np.s_[36:60])
    )
    # 576 pixels of 1400 electrons and more, times at most 3 by the matrix: 0.35 % of noise; 3 of these
    np.testing.assert_allclose(dark / bright, (128 / 255) ** 2.01, rtol=0.0105)
    assert np.ptp(bright) < 0.0105 * bright.mean()

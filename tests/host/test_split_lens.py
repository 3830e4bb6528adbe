"""Kernels of dual pixels against transforms of the sampled wave, closed forms, and formulas of published simulators."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf, j1, struve

import gpusim as gs
from gpusim.domain.dual import SIDES, SPLITS, Diode, DiodeOptics
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.optics.lenses import open_lens
from gpusim.optics.split_lens import divided_energies

PITCH, SHAPE = 1.4e-6, (64, 96)
OPTICS = Optics(2.0, 4e-3, object_distance=1.0)
CORNER = 1e-3


def lens_of(dual, side, optics=OPTICS, pitch=PITCH, window=PITCH):
    diode = Diode(dual, side, (window, window), CORNER)
    return open_lens(DiodeOptics.of(optics, diode), pitch, 1.0, SHAPE)


def energies_by_transforms(lens, wavelength, place, count, distance):
    """Light of the diode's side along columns: pixels' windows of a field of 384 x 384 pupil points, transformed.

    The staircase of the pupil's rim, averaged over 16 points across each cell, and 24 points across a window leave
    5e-4 of the light.
    """
    optics, points, fine, long = lens.optics, 384, 24, 1024
    number = optics.working_f_number
    unit = 2 * wavelength * 1e-9 * number  # [m]
    u = (np.arange(points) + 0.5) / points * 2 - 1
    finer = (np.arange(points * 16) + 0.5) / (points * 16) * 2 - 1
    inside = [
        (np.hypot(rows[:, None], finer) < 1).reshape(16, points, 16).mean(axis=(0, 2))
        for rows in finer.reshape(points, 16)
    ]
    height, azimuth = np.hypot(*place), np.arctan2(*place)
    wave = optics.waves(np.array([wavelength]), height, azimuth, distance)[0]
    path = sum(wave[i, j] * u**i * u[:, None] ** j for i, j in np.argwhere(wave))
    window = lens.optics.diode.window[1] / unit
    at = (np.arange(fine) + 0.5) / fine * window - window / 2
    places = ((np.arange(count) - count // 2) * lens.pitch / unit)[:, None] + at
    wave_at = np.exp(2j * np.pi * np.outer(places.ravel(), u))
    field = wave_at @ (np.array(inside) * np.exp(2j * np.pi * path)) @ wave_at.T
    field *= (2 / points) ** 2 / np.sqrt(np.pi)
    step = window / fine
    spectra = np.fft.fft(field.reshape(count, fine, count, fine), long, axis=3) * step
    angle = np.fft.fftfreq(long, step)
    border, width = lens.optics.split_height * place[1], lens.optics.split_width
    contrast = lens.optics.diode.contrast([wavelength])[0]
    sign = lens.optics.diode.signs[1]
    share = (1 + sign * contrast * erf((angle - border) / (np.sqrt(2) * width))) / 2
    power = (np.abs(spectra) ** 2 * share).sum(axis=(1, 3))
    return power * step / (long * step)


ASKEW = gs.DualPixels(misalignment=0.03, crosstalk=0.05)


@pytest.mark.parametrize(
    ("dual", "side", "distance"),
    [
        (ASKEW, "left", 0.6),
        pytest.param(ASKEW, "right", None, marks=pytest.mark.slow),
        pytest.param(ASKEW, "right", 3.0, marks=pytest.mark.slow),
        pytest.param(gs.DualPixels(), "left", 3.0, marks=pytest.mark.slow),
        pytest.param(gs.DualPixels(), "right", 0.6, marks=pytest.mark.slow),
    ],
)
def test_kernels_are_transforms_of_the_windows(dual, side, distance):
    """The error of the transforms is what `energies_by_transforms` says; all of a point's light is 1."""
    place, size, lens = (0.0, 0.5), 7, lens_of(dual, side)
    own = lens.kernels([550.0], place, size, distance)[0] * lens.totals([550.0], place)[0]
    assert np.abs(own - energies_by_transforms(lens, 550.0, place, size, distance)).max() < 5e-4


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("pupil", [Pupil(), Pupil(5, 0.3, 0.2)], ids=["round", "polygon"])
def test_diodes_add_up_to_the_whole(split, pupil):
    """Rounding of complex64 amplitudes: 1e-7 of the light for each of the diodes."""
    optics = replace(OPTICS, pupil=pupil, wavefront=Wavefront(seidel=(0.2, 0.3, 0, 0, 0)))
    dual = gs.DualPixels(split, crosstalk=0.03, misalignment=0.05, follows_chief_ray=False)
    for place, distance in (((0.3, 0.4), 0.6), ((0.0, 0.0), None)):
        total = 0.0
        for side in SPLITS[split]:
            lens = lens_of(dual, side, optics)
            total = total + lens.kernels([500.0], place, 31, distance)[0] * lens.totals(
                [500.0], place
            )
        whole = lens.whole.kernels([500.0], place, 31, distance)[0]
        assert np.abs(total - whole).max() < 1e-6


def test_a_sharp_border_and_wide_pixels_give_half_discs():
    """Rays of a point out of focus, on pixels of 200 lambda N, four samples to a pixel.

    The centroids are 4 / (3 pi) of the circle's diameter apart. Diffraction at a window of a wavelengths x f-number
    widens the border: the share misses 1 / (pi^2 a |x|) of it at x, which takes 3 / (2 pi a) of the distance, 0.24 %.
    """
    window = 200 * 550e-9 * OPTICS.working_f_number
    sharp, moved = gs.DualPixels(transition=0.0), 1.9e-3
    circle = moved / OPTICS.working_f_number / (window / 4)
    optics = replace(OPTICS, defocus=moved)
    lens = [lens_of(sharp, side, optics, window / 4, window) for side in ("left", "right")]
    assert lens[0].whole.is_coarse
    at = np.arange(41) - 20
    kernels = [one.kernels([550.0], (0.0, 0.0), 41)[0] for one in lens]
    # the sensor is behind the image, where rays have crossed: the left of the pupil is seen on the right
    apart = kernels[0].sum(axis=0) @ at - kernels[1].sum(axis=0) @ at
    assert apart == pytest.approx(4 / (3 * np.pi) * circle, rel=0.01)
    assert kernels[0][:, :18].sum() < 0.02  # a pixel's half beyond the border
    centres = [one.centroids([550.0], (0.0, 0.0))[0, 1] for one in lens]
    missed = 1 - 3 / (2 * np.pi * 200)
    assert centres[0] - centres[1] == pytest.approx(missed * 4 / (3 * np.pi) * circle, rel=1e-3)


@pytest.mark.slow
def test_phases_are_a_half_discs():
    """Published simulators take half discs, sharp or weighted (Garg et al. 2019; Punnappurath et al. 2020; Abuolaim and
    Brown 2020). Their transform is the integral of the share over the pupil, here with the border that diffraction at
    the window leaves: the sign, averaged over sinc^2(window (t - x)).

    With W = 6 waves diffraction at the rim ripples the transfer by (8 pi W)^(-1/2) of its size at most, 8 %; at these
    low frequencies by a third of that.
    """
    waves, number, window = 6.0, OPTICS.working_f_number, 4
    light = 550e-9 * number
    optics = replace(OPTICS, defocus=waves * 8 * number * light)
    lens = lens_of(gs.DualPixels(transition=0.0), "right", optics, 0.45 * light, window * light)
    f = np.array([0.5, 1.0, 1.5, 2.0]) / np.pi / (waves * 8 * light)
    found = lens.transfer([550.0], 0 * f, f)[0]
    t = (np.arange(-20000, 20000) + 0.5) / 1000
    spread = np.sinc(window / 2 * t) ** 2
    x = (np.arange(1000) + 0.5) / 500 - 1
    share = np.interp(x, t, np.cumsum(spread) / spread.sum())
    chord = np.sqrt(1 - x**2)
    # a ray through x lands at -x times half of the circle
    ray = np.exp(2j * np.pi * np.outer(f, x) * waves * 4 * light)
    assert np.angle(found) == pytest.approx(np.angle(ray @ (share * chord)), rel=0.03)
    sharp = np.angle(ray @ ((x > 0) * chord))
    v = np.pi * f * waves * 8 * light
    assert sharp == pytest.approx(np.arctan2(struve(1, v), j1(v)), rel=1e-3)


def test_in_focus_both_halves_are_the_same():
    """The field of a lens in focus is real, so that each window's light is even in its angle."""
    left, right = (
        lens_of(gs.DualPixels(), side).kernels([550.0], (0, 0), 31) for side in ("left", "right")
    )
    assert np.abs(left - right).max() < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("pitch", [1.4e-6, 0.7e-6])
def test_moments_and_tables_are_the_kernels(pitch):
    """Moments against sums over kernels of 201 pixels, which leave 1 / 100 of the far light's first moment."""
    lens = lens_of(gs.DualPixels(), "left", pitch=pitch, window=1.4e-6)
    at = np.arange(201) - 100
    rest = lens._differences(np.array([550.0]), (0.0, 0.0), 0.6, at)[0].sum(axis=0) @ at
    found = (
        lens.moments([550.0], (0.0, 0.0), 0.6)[0, 1]
        - lens.whole.moments([550.0], (0.0, 0.0), 0.6)[0, 1]
    )
    assert found == pytest.approx(rest, rel=0.02)


def test_light_of_windows_is_the_pixels_light():
    """Windows that tile the image hold all light but what is beyond 61 pixels: 2 t / r, t the tail's strength."""
    lens = lens_of(gs.DualPixels(), "left")
    at = np.arange(61) - 30
    q = float(lens.q([550.0])[0])
    _, whole = divided_energies(Pupil(), np.zeros((1, 1)), q, lens.share(550.0), at, at)
    beyond = 2 * np.pi * lens.whole.tail.strength * q / 30.5
    assert 1 - whole.sum() == pytest.approx(beyond, rel=0.15)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"split": "diagonal"}, "sensor.dual.split"),
        ({"transition": -1}, "0 <= transition <= 1"),
        ({"crosstalk": 0.6}, "0 <= crosstalk <= 0.5"),
        ({"sparse": "masked"}, "wanted one or more"),
        (
            {"sparse": "masked", "cell": (4, 4), "places": ((5, 0, "left"),)},
            "within the cell of 4 x 4",
        ),
        (
            {"sparse": "masked", "split": "quad", "places": ((0, 0, "left"),)},
            "one half of the pupil",
        ),
        ({"sparse": "shared", "cell": (4, 4), "places": ((0, 0, "left"),)}, "wanted pairs"),
        ({"places": ((0, 0, "left"),)}, "all pixels are divided"),
        ({"follows_chief_ray": 1}, "true or false"),
    ],
)
def test_settings_are_refused_in_a_line(changes, words):
    with pytest.raises(gs.GpusimError, match=words) as refused:
        gs.DualPixels(**changes)
    assert "\n" not in str(refused.value)


def test_measured_spreads_hold_no_wave():
    spread = gs.PointSpread(np.array([400.0, 700.0]), np.ones((2, 5, 5)), 0.25e-6)
    camera = gs.open_camera("phone").with_(psf=spread)
    with pytest.raises(gs.GpusimError, match="hold no wave"):
        camera.with_(dual=gs.DualPixels())
    assert set(SIDES) == {side for sides in SPLITS.values() for side in sides}

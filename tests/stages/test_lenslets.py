"""Lenslets against rays and waves by brute force; light is kept; bad input."""

from dataclasses import replace

import numpy as np
import pytest
from devices import DEVICES
from lenslet_rays import trace

import gpusim as gs
from gpusim.captures.lenslets import apply_lenslets
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.lenslets import Lenslets
from gpusim.kernels.sensor.lenslets import lenslets, make_plane
from gpusim.optics.lenslets import effective_wavelengths, lenslet_grid, lenslet_samples

PIXEL, PITCH = 2e-6, 14e-6


def light_field_camera(base="phone", chip=(0.0, 0.0), f_number=4.0, **array):
    """A camera of 50 mm with pixels of 2 um and lenslets of 14 um, of the lens's f-number."""
    camera = gs.open_camera(base)
    array = {"pitch": PITCH, "focal_length": PITCH * 4.0} | array
    return replace(
        camera,
        optics=replace(camera.optics, f_number=f_number, focal_length=0.05, object_distance=np.inf),
        sensor=replace(
            camera.sensor,
            pixel_pitch=PIXEL,
            fill_factor=1.0,
            offset=chip,
            lenslets=Lenslets(**array),
        ),
    )


def smooth_light(shape, cells, channels=3):
    """Waves of two lenslets' length and more that move between cells, from 0.1 to 1."""
    y, x = np.indices(shape)
    out = np.empty((*cells, channels, *shape), np.float32)
    for j, i, c in np.ndindex(*cells, channels):
        wave = np.sin(0.3 * y + 0.8 * j + c) * np.cos(0.4 * x - 0.7 * i)
        out[j, i, c] = 0.55 + 0.45 * wave
    return out


def simulate(camera, shape, cells, device):
    samples = lenslet_samples(camera.sensor.lenslets, camera.sensor, camera.optics, shape)
    rates = smooth_light(samples.shape, cells, len(camera.sensor.channels))
    pixels = apply_lenslets(gs.open_device(device), rates, camera, samples)
    return np.asarray(pixels)[0], rates, samples


# Largest error over the largest value. Squares along the pixels: 2e-4 of the diffraction along each axis is folded
# back, and the frame is a corner cut out of 64 x 64 lenslets, so that all of it should be outside: 4e-4; cells far
# away have their mean weight, about 2e-4; the rays' grid of 1/24 pixel widens spots by 1.4e-4 of their second
# derivative. Other arrays: 2e-4 of the light may come back from the other side; the table of 32 samples a pixel errs by
# its second derivative over 8 x 32^2, which is at most 4 of its peak in each axis for edges of one pixel: 1e-3 of a
# cell, of which nine, with errors of both signs, make a pixel: 3e-4; rays at 31 places along a sample find a border to
# 1/62 of a quarter of a pitch, 0.4 % of a lenslet, and about 100 borders with errors of both signs make a pixel: 4e-4.
ARRAYS = {
    "square": {},
    "square, filled to 0.75": {"fill": 0.75, "offset": (1e-6, -2e-6)},
    "square, focused": {"gap": 1.3 * 4 * PITCH},
    "hexagonal": {"layout": "hexagonal"},
    "square, turned": {"rotation": 0.2},
    "hexagonal, turned": {"layout": "hexagonal", "rotation": -0.1},
}
TOLERANCE = 1e-3


@pytest.mark.parametrize(
    "name",
    [name if name == "square" else pytest.param(name, marks=pytest.mark.slow) for name in ARRAYS],
)
@pytest.mark.filterwarnings("ignore:sensor.lenslets:UserWarning")
def test_rays_and_waves(name):
    """The corner of 64 x 64 lenslets agrees with traced rays and the integral of the wave behind a lenslet."""
    numbers = ARRAYS[name]
    is_along = name.startswith("square") and "turned" not in name
    shape = (14, 21) if name == "square" else (28, 28) if is_along else (21, 21)
    base = "phone" if is_along and name != "square" else "mono"
    camera = light_field_camera(base, (203.0, -206.0), **numbers)
    pixels, rates, samples = simulate(camera, shape, (3, 3), "opencl")
    sensor = camera.sensor
    # all rays of a lenslet from one place of the pupil land together, unless it is focused on the picture or covered
    strata = 2 if name == "square" else 8 if samples.pitch == PITCH else 12 if is_along else 31
    colors = effective_wavelengths(sensor)
    traced = trace(rates, sensor.cfa_indices, camera, samples, colors, per_sample=strata)
    error = np.abs(pixels - traced).max() / traced.max()
    assert error < TOLERANCE, error


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    ("numbers", "spot", "tolerance"),
    [
        # diffraction within the tables' reach of 22 pixels: float32 rounds about a hundred terms
        ({}, 0.03, 2e-6),
        ({"fill": 0.6, "samples": 4, "power": 1.5}, 0.03, 2e-6),
        # a mean over lenslets ends after 12 of them and is for pixels between them, too: a thousandth
        ({"layout": "hexagonal", "rotation": 0.3, "samples": 4}, 0.3, 1e-3),
    ],
)
def test_light_is_kept(numbers, spot, tolerance, device):
    """Light in the middle of a large dark frame: pixels add up to the light that passes clear apertures."""
    count, size = numbers.get("samples", 1), 201
    shape = (31 * count, 31 * count)
    plane = make_plane(7.0, 3.5, spots=(spot,), shape=shape, **numbers)
    rates = np.zeros((3, 3, 1, *shape), np.float32)
    lit = slice(13 * count, 18 * count)
    rates[..., lit, lit] = np.random.default_rng(0).random((3, 3, 1, 5 * count, 5 * count))
    if (
        "fill" in numbers
    ):  # 4 samples of a pitch, covered by a fifth of a pitch on each side: 0.2, 1, 1, 0.2
        share = np.tile([0.2, 1, 1, 0.2], 31)
        passed = (rates * np.outer(share, share)).sum(dtype=float)
    else:
        passed = rates.sum(dtype=float)
    rates = rates.reshape(3, 3, *shape)
    pixels = lenslets(rates, np.zeros((1, 1), np.int32), plane, (size, size), device=device)
    assert pixels.sum(dtype=float) == pytest.approx(passed, rel=tolerance)


def test_sign_of_the_pupil():
    """Light through the right of the pupil lands left of the lenslet's centre: its image is inverted."""
    camera = light_field_camera("mono")
    samples = lenslet_samples(camera.sensor.lenslets, camera.sensor, camera.optics, (21, 21))
    rates = np.zeros((1, 2, 1, *samples.shape), np.float32)
    rates[:, 1] = 1
    pixels = np.asarray(apply_lenslets(gs.open_device("opencl"), rates, camera, samples))[0]
    middle = pixels[7:14, 7:14]
    assert middle[:, :3].sum() > 5 * middle[:, 4:].sum()


def test_centres():
    """Lenslets of 14 um over pixels of 2 um are 7 pixels apart; hexagonal rows 7 sqrt(3) / 2."""
    centres = lenslet_grid(Lenslets(PITCH, 56e-6, offset=(2e-6, 0.0)), (21, 21), PIXEL)
    assert centres.tolist() == [[y, x] for y in (4.0, 11.0, 18.0) for x in (3.0, 10.0, 17.0)]
    centres = lenslet_grid(Lenslets(PITCH, 56e-6, layout="hexagonal"), (21, 21), PIXEL)
    rows = np.unique(np.round(centres[:, 0], 9))
    np.testing.assert_allclose(np.diff(rows), 7 * np.sqrt(3) / 2, rtol=1e-9)


def test_samples_of_designs():
    """A sample per lenslet where only its light counts; more if it is turned or an image of the picture."""

    def count(**array):
        camera = light_field_camera(**array)
        own = lenslet_samples(camera.sensor.lenslets, camera.sensor, camera.optics, (70, 70))
        return round(PITCH / own.pitch), own

    per_pitch, samples = count()
    assert per_pitch == 1
    # 10 pitches, half a lenslet and a pitch of margin on both sides
    assert samples.shape == (13, 13)
    assert samples.offset == pytest.approx((0.0, 0.0), abs=1e-9)
    assert count(rotation=0.1)[0] == 4
    with pytest.warns(UserWarning, match="overlap by 30 %"):
        assert count(gap=1.3 * 56e-6)[0] == 5  # a sample of 0.3 x 7 / 5 pixels


def test_stacked_pixels_have_all_channels():
    camera = light_field_camera()
    camera = replace(camera, sensor=replace(camera.sensor, stacked=True))
    samples = lenslet_samples(camera.sensor.lenslets, camera.sensor, camera.optics, (14, 14))
    rates = smooth_light(samples.shape, (2, 2))
    device = gs.open_device("opencl")
    pixels = np.asarray(apply_lenslets(device, rates, camera, samples))
    assert pixels.shape == (3, 14, 14)
    mosaic = replace(camera, sensor=replace(camera.sensor, stacked=False))
    single = np.asarray(apply_lenslets(device, rates, mosaic, samples))[0]
    cfa = mosaic.sensor.cfa_indices
    y, x = np.indices(single.shape)
    own = np.take_along_axis(pixels, cfa[y % 2, x % 2][None], 0)[0]
    # windows of blocks of pixels differ: cells far away have their mean weight sooner or later, as above
    np.testing.assert_allclose(single, own, rtol=5e-4)


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"layout": "round"}, UnknownName, "round"),
        ({"gap": 0.0}, OutOfRange, "gap"),
        ({"pitch": 3e-6}, OutOfRange, "at least 2 pixels"),
        ({"fill": 1.5}, OutOfRange, "fill"),
        ({"offset": (1.0, 0.0)}, OutOfRange, "offset"),
    ],
)
def test_bad_lenslets(change, error, words):
    with pytest.raises(error, match=words) as found:
        light_field_camera(**change)
    assert "\n" not in str(found.value)


def test_lenslets_that_do_not_fit():
    camera = light_field_camera()
    with pytest.raises(OutOfRange, match="at most the sensor's shorter side"):
        lenslet_samples(camera.sensor.lenslets, camera.sensor, camera.optics, (5, 100))
    samples = lenslet_samples(camera.sensor.lenslets, camera.sensor, camera.optics, (14, 14))
    with pytest.raises(BadData, match="channels"):
        apply_lenslets(gs.open_device("numpy"), np.zeros((1, 1, 3, 2, 2)), camera, samples)
    with pytest.raises(BadData, match="has none"):
        apply_lenslets(
            gs.open_device("numpy"), np.zeros((1, 1, 3, 2, 2)), gs.open_camera("phone"), samples
        )


@pytest.mark.parametrize(
    ("f_number", "words"), [(2.0, "overlap by 100 %"), (8.0, "80.4 % of the pixels get no light")]
)
def test_f_numbers_that_do_not_fit(f_number, words):
    """At f/2 the image of the pupil is twice the pitch; at f/8 a disc of half of it: pi / 16 of the square."""
    camera = light_field_camera(f_number=f_number)
    with pytest.warns(UserWarning, match=words):
        lenslet_samples(camera.sensor.lenslets, camera.sensor, camera.optics, (14, 14))

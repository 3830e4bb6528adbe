"""The transport of light: a star keeps its energy, and a flat field is the sum of its points.

For distortion in every form, lateral colour and a blur that varies. A relative illumination that is given is the
flat field.
"""

from dataclasses import replace

import numpy as np
import pytest
from devices import ALL_KINDS, KINDS
from lights import as_photons
from scipy.interpolate import RegularGridInterpolator

import gpusim as gs
from gpusim.domain.content import Cube
from gpusim.domain.distortion import BrownConrady, RadialPolynomial, RadialTable
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Wavefront
from gpusim.domain.scene import Scene, View
from gpusim.io.camera.cameras import open_camera
from gpusim.optics.geometry import flat_of_lens
from gpusim.optics.lenses import open_lens
from gpusim.pipeline.simulator import Simulator

FRAME = (90, 120)
CORNER = np.hypot(*FRAME) / 2  # [pixel]
MIDDLE = (np.array(FRAME) - 1) / 2


def bent_lens(pitch):
    """Lenses whose images are at closed forms of the height h, 1 at the corner: name -> (lens, place, flat field)."""
    corner = CORNER * pitch
    heights = np.linspace(0, 1.6, 65)
    focal = 1.3  # of the fisheyes, over the corner's height
    return {
        "polynomial": (
            RadialPolynomial(0.0, -0.1, corner),
            lambda h: h * (1 - 0.1 * h**2),
            lambda h: 1 / ((1 - 0.1 * h**2) * (1 - 0.3 * h**2)),
        ),
        "Brown-Conrady": (
            BrownConrady(0.08, 0.0, 0.0, 0.0, 0.0, corner),
            lambda h: h * (1 + 0.08 * h**2),
            lambda h: 1 / ((1 + 0.08 * h**2) * (1 + 0.24 * h**2)),
        ),
        "table": (  # stereographic
            RadialTable(heights * corner, 2 * np.tan(np.arctan(heights) / 2) * corner),
            lambda h: 2 * np.tan(np.arctan(h) / 2),
            # dx/dr = h cos^2 / r^, dr^/dh = cos^2(theta) / cos^2(theta / 2)
            lambda h: (
                h
                / np.maximum(2 * np.tan(np.arctan(h) / 2), 1e-9)
                * np.cos(np.arctan(h) / 2) ** 2
                / np.cos(np.arctan(h)) ** 2
            ),
        ),
        "fisheye": (  # equidistant
            gs.Calibration(
                FRAME[1],
                FRAME[0],
                focal * CORNER,
                focal * CORNER,
                *MIDDLE[::-1],
                (0.0, 0.0, 0.0, 0.0),
                True,
            ),
            lambda h: focal * np.arctan(h / focal),
            lambda h: (h / focal) / np.maximum(np.arctan(h / focal), 1e-9) * (1 + (h / focal) ** 2),
        ),
    }


def frame_of(camera, values, border="edge"):
    """Mean electrons of a scene of three wavelengths, float64."""
    cube = Cube(np.array([540.0, 550.0, 560.0]), np.stack([values] * 3).astype(np.float32))
    simulator = Simulator(camera, device=KINDS[0])
    exposure = simulator.expose(Scene(cube, as_photons("D65"), border=border), 1e-2)
    return np.array(simulator.device.numpy(exposure.mean), np.float64)


def bent_camera(name, model="none", illumination="none"):
    """A monochrome camera with a lens of `bent_lens`, and what the lens does."""
    camera = open_camera("mono")
    lens, place, flat = bent_lens(camera.sensor.pixel_pitch)[name]
    optics = replace(
        camera.optics, model=model, relative_illumination=illumination, distortion=lens
    )
    return replace(camera, optics=optics), place, flat


def heights_of(place, h):
    """Ideal heights whose images are at heights h, by bisection of the closed form."""
    low, high = np.zeros_like(h), np.full_like(h, 4.0)
    for _ in range(60):
        middle = (low + high) / 2
        below = place(middle) < h
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return (low + high) / 2


def radii(shape=FRAME):
    """Height of every pixel, 1 at the frame's corner."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    return np.hypot(y[:, None], x) / (np.hypot(*shape) / 2)


BENT = ("polynomial", "Brown-Conrady", "table", "fisheye")


@pytest.mark.parametrize("model", ["none", "diffraction"])
@pytest.mark.parametrize("name", BENT)
def test_a_star_keeps_its_energy(name, model):
    """Stars of sigma 3 anywhere: all have the electrons of the star on the axis, and lie where the lens puts them.

    A Gaussian of sigma 3 has e^-44 at Nyquist; cubics whose pixels are up to 1.9 samples apart err by 1.2e-3 of
    its sum. Diffraction: light beyond the frame is lost, about q / (pi^2 r) = 1e-3 of it at r = 30 pixels, more or less
    by half of it elsewhere.
    """
    camera, place, _ = bent_camera(name, model)
    y, x = np.indices(FRAME) - MIDDLE[:, None, None]
    sums = []
    for at in ((0.0, 0.0), (10.3, -20.2), (-18.6, 25.0), (0.0, 30.7)):
        star = np.exp(-((y - at[0]) ** 2 + (x - at[1]) ** 2) / (2 * 3.0**2))
        light = frame_of(camera, star + 1e-3, "edge") - frame_of(camera, np.full(FRAME, 1e-3))
        sums.append(light.sum())
        near = star > 1e-6
        weights = star[near]
        own = np.hypot(y[near], x[near]) / CORNER
        bent = np.where(own > 0, place(own) / np.maximum(own, 1e-12), 1.0)
        wanted = (
            (weights * bent * y[near]).sum() / weights.sum(),
            (weights * bent * x[near]).sum() / weights.sum(),
        )
        if model == "none":
            found = (light * y).sum() / light.sum(), (light * x).sum() / light.sum()
            assert found == pytest.approx(wanted, abs=0.02)
    assert np.array(sums) == pytest.approx(sums[0], rel=2e-3 if model == "none" else 3e-3)


@pytest.mark.parametrize("name", BENT)
def test_a_flat_field_is_the_sum_of_its_points(name):
    """Without fall-off it is the ideal area of each pixel, by closed form.

    The frame's grid errs by AIM = 1e-4 at most; pixels that see more than 2 samples take their quadrilateral's area,
    the mean of the closed form over the pixel: its second derivative / 24, below 1e-3 here for the fisheye.
    """
    camera, place, flat = bent_camera(name)
    h = heights_of(place, radii())
    light = frame_of(camera, np.ones(FRAME))
    unit = frame_of(
        replace(camera, optics=replace(camera.optics, distortion=None)), np.ones(FRAME)
    ).mean()
    assert np.abs(light / unit / flat(h) - 1).max() < 1e-3
    assert np.ptp(flat(h)) > 0.1  # else nothing is tested


CURVES = {
    "table": (np.linspace(0, 1.2, 25), 1 - 0.45 * np.linspace(0, 1.2, 25) ** 2),
    "polynomial": (-0.1, -0.3),
}


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("model", ["none", "diffraction"])
@pytest.mark.parametrize("name", BENT)
def test_a_given_relative_illumination_is_the_flat_field(name, model, curve):
    """The Jacobian is not applied a second time: the flat field is the curve, up to float32 (1e-5)."""
    camera, _, _ = bent_camera(name, model, CURVES[curve])
    light = frame_of(camera, np.ones(FRAME))
    plain = replace(camera.optics, distortion=None, relative_illumination="none")
    unit = frame_of(replace(camera, optics=plain), np.ones(FRAME)).mean()
    h = radii()
    wanted = np.interp(h, *CURVES["table"]) if curve == "table" else 1 - 0.1 * h - 0.3 * h**2
    assert np.abs(light / unit - wanted).max() < 1e-5


def test_views_and_finer_samples_keep_a_given_curve():
    """Turned, magnified, two samples per pixel, displaced pixels: the curve belongs to the sensor's place."""
    camera, _, _ = bent_camera("fisheye", "diffraction", CURVES["table"])
    moved = replace(camera.sensor, offset=(0.25, -0.25))
    for sensor, ratio, view in (
        (camera.sensor, 1.0, View((3.2, -4.1), 0.2, 1.5)),
        (camera.sensor, 2.0, View()),
        (moved, 2.0, View()),
    ):
        shape = tuple(int(ratio * n) for n in FRAME)
        cube = Cube(np.array([540.0, 550.0, 560.0]), np.ones((3, *shape), np.float32))
        scene = Scene(cube, as_photons("D65"), view=view, samples_per_pixel=ratio)
        simulator = Simulator(replace(camera, sensor=sensor), device=KINDS[0])
        light = np.array(simulator.device.numpy(simulator.expose(scene, 1e-2).mean), np.float64)
        down, across = sensor.displacement
        y, x = (
            np.arange(n) - (n - 1) / 2 + move for n, move in zip(FRAME, (down, across), strict=True)
        )
        wanted = np.interp(np.hypot(y[:, None], x) / CORNER, *CURVES["table"])
        assert np.abs(light / light.max() - wanted / wanted.max()).max() < 2e-5


@pytest.mark.parametrize("device", ALL_KINDS)
def test_shading_correction_undoes_a_given_curve(device):
    """With distortion and a curve: a flat field is even after the correction, to 2e-4 of the gains between nodes."""
    camera, _, _ = bent_camera("table", "diffraction", CURVES["table"])
    camera = replace(camera, processor=replace(camera.processor, shading=True))
    simulator = Simulator(camera, device=device)
    cube = Cube(np.array([540.0, 550.0, 560.0]), np.ones((3, *FRAME), np.float32))
    exposure = simulator.expose(Scene(cube, as_photons("D65")), 1e-2)
    gains = np.asarray(exposure.shading)[0]
    across = [np.linspace(0, n, count) - 0.5 for n, count in zip(FRAME, gains.shape, strict=True)]
    spline = RegularGridInterpolator(across, gains)
    y, x = np.meshgrid(*map(np.arange, FRAME), indexing="ij")
    even = spline(np.stack([y, x], -1)) * np.array(
        simulator.device.numpy(exposure.mean), np.float64
    )
    assert np.ptp(even) / even.mean() < 1e-3


def test_a_blur_that_moves_light_has_its_divergence_as_flat_field():
    """Seidel distortion W311: displacement d h^3 along the radius gives 1 - 4 d h^2 / corner; coma an even field."""
    camera = open_camera("mono")
    y, x = (np.arange(n) - (n - 1) / 2 for n in FRAME)
    for seidel in ((0, 0, 0, 0, 3.0), (0, 1.2, 0, 0, 0), (0, 0.7, 0, 0, -2.0)):
        optics = replace(camera.optics, f_number=2.8, wavefront=Wavefront(seidel=seidel))
        lens = open_lens(optics, camera.sensor.pixel_pitch, 1.0, FRAME)
        flat = flat_of_lens(lens, np.array([450.0, 600.0]), np.ones((1, 2)) / 2, y, x, CORNER)[0]
        # a ray meets the image at -2 lambda N grad W; W311 h^3 rho cos: moved by -2 N W311 wavelengths of reference
        moved = -2 * 2.8 * seidel[4] * 550e-9 / camera.sensor.pixel_pitch
        # W131 h rho^3 cos: the mean slope over the disc is h: an even field, to which the rest is relative
        even = 1 + 2 * 2 * 2.8 * seidel[1] * 550e-9 / camera.sensor.pixel_pitch / CORNER
        assert np.abs(flat - (1 - 4 * moved * radii() ** 2 / CORNER / even)).max() < 2e-6


def test_spreads_that_widen_have_their_second_moments_as_flat_field():
    """Measured Gaussians on a grid whose variance is v + w h^2 along each axis: 1 + 2 w / corner^2, all over the field.

    The flat field is relative to the axis, where it is the same: 1. With w h^4 it is 1 + 8 w h^2 / corner^2.
    """
    camera = open_camera("mono")
    pitch = camera.sensor.pixel_pitch
    at = np.linspace(-1, 1, 41)
    spot = np.arange(-24, 25)
    for power, wanted in ((2, lambda h: 0 * h), (4, lambda h: 8 * h**2)):
        h = np.hypot(at[:, None], at)
        sigma = np.sqrt(4.0 + 6.0 * h**power)[..., None, None]
        values = np.exp(-(spot[:, None] ** 2 + spot**2) / (2 * sigma**2))
        spread = PointSpread(
            np.array([550.0]), values[:, :, None], pitch, integrated=True, grid=(at, at)
        )
        optics = replace(camera.optics, model="measured", psf=spread)
        lens = open_lens(optics, pitch, 1.0, FRAME)
        y, x = (np.arange(n) - (n - 1) / 2 for n in FRAME)
        flat = flat_of_lens(lens, np.array([550.0]), np.ones((1, 1)), y, x, CORNER)[0]
        # relative to the axis, where it is 1 + 0; linear spreads between 41 places ripple the second derivative
        found = (flat - 1) * CORNER**2 / 6.0
        inner = radii() < 0.7
        assert np.abs(found - wanted(radii()))[inner].max() < 1.0


@pytest.mark.parametrize("border", ["edge", "reflect", "zero"])
def test_a_distorted_border_is_the_scenes(border):
    """Each frame is the middle of a wider one whose scene goes on by the rule: truth by the wide frame that is cut.

    f/8, lambda N = 0.75 pixels. Without displaced light around the frame borders were off by up to 2 %. This lens's
    model goes on for 8 pixels around the frame, beyond which q / (pi^2 8) = 9.5e-3 of a border's light comes from; what
    the narrow frame lacks there differs by up to a third.
    """
    rows, cols, extra = 60, 80, 16
    calibration = gs.Calibration(
        cols, rows, 70.0, 72.0, 41.0, 28.0, (-0.15, 0.02, 1e-3, -1e-3, 0.0)
    )
    wide = replace(
        calibration,
        width=cols + 2 * extra,
        height=rows + 2 * extra,
        cx=41.0 + extra,
        cy=28.0 + extra,
    )
    waves = 1 + 0.5 * np.cos(np.indices((rows, cols)).sum(0) / 4.0)
    found = []
    for lens, more in ((calibration, 0), (wide, extra)):
        y, x = np.indices((rows + 2 * more, cols + 2 * more)) - more
        inside = (y >= 0) & (y < rows) & (x >= 0) & (x < cols)
        if border == "reflect":
            y, x = (
                np.minimum(at % (2 * n), (-1 - at) % (2 * n)) for at, n in ((y, rows), (x, cols))
            )
        values = waves[np.clip(y, 0, rows - 1), np.clip(x, 0, cols - 1)]
        if border == "zero":
            values = values * inside
        camera = open_camera("mono")
        optics = replace(camera.optics, f_number=8.0, distortion=lens, relative_illumination="none")
        light = frame_of(replace(camera, optics=optics), values, border)
        found.append(light[more : light.shape[0] - more, more : light.shape[1] - more])
    assert np.abs(found[0] - found[1]).max() < 3e-3 * found[1].mean()

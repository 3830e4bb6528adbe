"""The truth of scenes that a formula gives, of apertures anywhere among the samples, and of frames that are cut.

Formulas know no samples: cosines and a soft edge are evaluated where the view or the lens looks. Points of light are
Airy's formula, integrated over every pixel's aperture by Gauss's rule.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import erf

import gpusim as gs
from gpusim.domain.content import Cube
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.errors import OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Wavefront
from gpusim.domain.scene import Scene
from gpusim.domain.sensor import Microlens
from gpusim.domain.spectrum import Spectrum
from gpusim.judge.hard.truth import airy
from gpusim.judge.truth import require_truth, true_mean

BANDS = np.array([500.0, 550.0, 600.0])  # light is at the middle one alone
PITCH = 1.4e-6


def camera(fill=1.0, **optics):
    own = gs.open_camera("mono")
    sensor = replace(own.sensor, pixel_pitch=PITCH, fill_factor=fill)
    return replace(
        own,
        sensor=sensor,
        optics=Optics(
            **{"f_number": 2.8, "focal_length": 4e-3, "relative_illumination": "none"} | optics
        ),
    )


def scene_of(plane, border="edge", **more):
    values = np.zeros((3, *plane.shape))
    values[1] = plane
    return Scene(Cube(BANDS, values), Spectrum(BANDS, np.full(3, 1e15)), border, **more)


def truth(camera, scene):
    """Mean electrons of one second over those of an even scene of 1, and the exposure's own."""
    exposure = gs.Simulator(camera, device="numpy").expose(scene, 1.0)
    rate = exposure.plan.weights[0, 1]
    return true_mean(gs.Simulator, camera, scene, exposure.plan, 1.0) / rate, exposure.mean / rate


N = 96  # samples along a side


def light(y, x):
    """Waves of 0.11 to 0.17 cycles a sample, even about the rims, and an edge.

    Of the edge's Gauss's curve, of sigma 1.7 samples, exp(-(pi sigma)^2 / 2) = 6e-7 is left at half a cycle a sample.
    """
    down, across = (2 * np.pi * (at + N / 2) / (2 * N) for at in (y, x))
    return (
        1
        + 0.2 * np.cos(21 * across)
        + 0.2 * np.cos(33 * down)
        + 0.1 * np.cos(19 * across) * np.cos(18 * down)
        + 0.2 * erf(x / (2**0.5 * 1.7))
    )


def grid(n):
    at = np.arange(n) - (n - 1) / 2
    return at[:, None], at


@pytest.mark.parametrize("view", [gs.View((0.4, -0.3)), gs.View((1.7, 0.2), 0.2, 1.5)])
def test_a_view_of_a_formula_is_the_formula(view):
    """Cubics err by up to 1 % of the waves; the series by 1e-8, and by 6e-7 of the edge."""
    y, x = grid(N)
    own, frame = truth(camera(model="none"), scene_of(light(y, x), "reflect", view=view))
    wanted = light(*view.place(y, x))
    inside = np.s_[
        2:-2, 2:-2
    ]  # the view's own rim may look beyond the scene, where the edge is mirrored
    assert np.abs(own - wanted)[inside].max() < 1e-6
    assert np.abs(frame - wanted)[inside].max() > 1e-3  # else this tells nothing of the truth


def test_distortion_of_a_formula_is_the_formula():
    """r^ = r (1 + k r^2), turned round by bisection; light is thinned as the picture is spread."""
    k, unit = 0.05, 48.0
    y, x = grid(N)
    seen = np.hypot(y, x) / unit
    low, high = np.zeros_like(seen), seen.copy()
    for _ in range(60):
        middle = (low + high) / 2
        below = middle * (1 + k * middle**2) < seen
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    ratio = low / seen
    flux = ratio / (1 + 3 * k * low**2)  # (r dr) / (r^ dr^)
    wanted = flux * light(ratio * y, ratio * x)
    lens = camera(model="none", distortion=RadialPolynomial(0.0, k, unit * PITCH))
    own, frame = truth(lens, scene_of(light(y, x), "reflect"))
    assert np.abs(own - wanted).max() < 1e-6
    assert np.abs(frame - wanted).max() > 1e-3


@pytest.mark.parametrize(
    ("ratio", "fill", "moved"),
    [
        (2.0, 0.89, (0.0, 0.0)),
        (1.5, 1.0, (0.0, 0.0)),
        (1.0, 0.5, (0.3, -0.2)),
        (2.7, 0.6, (0.1, 0.0)),
    ],
)
def test_pixels_integrate_points_wherever_they_lie(ratio, fill, moved):
    """Airy's formula for every point and pixel; even points give even pixels, by their sum over a large even world.

    f/8: beyond two samples a ring, where an even world of points is even by itself.
    """
    samples = 18
    own = camera(fill, f_number=8.0)
    own = replace(own, sensor=replace(own.sensor, offset=moved))
    plane = np.random.default_rng(3).random((samples, samples)) ** 3
    found, _ = truth(own, scene_of(plane, "zero", samples_per_pixel=ratio))
    q, side = 550e-9 * 8.0 / PITCH, fill**0.5
    pixels = int(samples / ratio * (1 + 1e-12))
    start = (samples - pixels * ratio) / 2
    start = np.floor(start) if ratio.is_integer() else start
    nodes, mass = (part / 2 for part in np.polynomial.legendre.leggauss(8))
    # in pixels
    at = [
        ((start / ratio + np.arange(pixels) + 0.5 + move)[:, None] + side * nodes).ravel()
        for move in moved
    ]
    points = (np.arange(samples) + 0.5) / ratio
    wanted = np.zeros((pixels, pixels))
    for i, j in np.ndindex(samples, samples):
        irradiance = airy(np.hypot((at[0] - points[i])[:, None], at[1] - points[j]), q) / ratio**2
        wanted += plane[i, j] * np.einsum(
            "aibj,i,j->ab", irradiance.reshape(pixels, 8, pixels, 8), mass, mass
        )
    assert np.abs(found - wanted).max() < 1e-6 * wanted.max()


@pytest.mark.slow
def test_a_frame_off_its_axis_is_a_part_of_a_wider_one():
    """Coma of 0.3 waves, relative illumination and microlenses, whose axis is 12 pixels right of the middle."""
    rows, cols, more = 40, 44, 24
    random = np.random.default_rng(5).random((rows, cols + more)) + 0.1
    narrower = np.hypot(rows, cols) / np.hypot(rows, cols + more)

    def mean(width, right, scale):
        focal = 4e-3 / PITCH / 50  # a wide angle, so that angles count
        own = camera(
            wavefront=Wavefront(seidel=(0, 0.3 * scale, 0, 0, 0)),
            focal_length=4e-3 / 50,
            relative_illumination=(0.0, -0.3 * scale**2),
            distortion=gs.Calibration(
                width, rows, focal, focal, (width - 1) / 2 + right, (rows - 1) / 2
            ),
        )
        own = replace(
            own, sensor=replace(own.sensor, microlens=Microlens((0.0, 0.5, 1.5), (1.0, 0.8, 0.1)))
        )
        return truth(own, scene_of(random[:, :width]))[0]

    wide, off, centred = (
        mean(cols + more, 0, 1.0)[:, :cols],
        mean(cols, more / 2, narrower),
        mean(cols, 0, narrower),
    )
    inside = np.s_[:, : -more + 4]  # what is cut off goes on as an edge
    whole = np.sqrt(np.mean(wide[inside] ** 2))
    assert np.sqrt(np.mean((off - wide)[inside] ** 2)) < 2e-3 * whole
    assert np.sqrt(np.mean((centred - wide)[inside] ** 2)) > 2e-2 * whole


def test_what_has_no_truth_is_refused_in_one_line():
    y, x = grid(32)
    deep = scene_of(light(y, x), depth=np.full((32, 32), 2.0))
    for own, scene, words in (
        (
            camera(
                model="measured", psf=PointSpread(BANDS[[0, -1]], np.ones((2, 3, 3)), PITCH / 4)
            ),
            deep,
            "depth with measured point spreads",
        ),
        (
            camera(wavefront=Wavefront(seidel=(0, 0.3, 0, 0, 0))),
            scene_of(light(y, x), samples_per_pixel=1.5),
            "1.5 samples per pixel",
        ),
    ):
        with pytest.raises(OutOfRange, match=words) as found:
            require_truth(own, scene)
        assert "\n" not in str(found.value)

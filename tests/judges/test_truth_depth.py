"""The truth of a scene with depth, against integrals of the pupil and of areas that are written here."""

from dataclasses import replace

import numpy as np
import pytest
from test_truth_scenes import PITCH, camera, scene_of
from test_truth_stars import F_NUMBER, SIDE, Q, pupil_star

import gpusim as gs
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.scene import Layer
from gpusim.judge.truth import true_mean
from gpusim.judge.truth_depth import cuts, pupil_points

WAVE = 550e-9
FOCUS, N = 0.2, 61


def truth_of(camera, scene):
    """Mean electrons of one second over those of an even scene; no frame is made."""
    flat = replace(camera, optics=replace(camera.optics.on_axis(), distortion=None))
    even = true_mean(gs.Simulator, flat, scene_of(np.ones(scene.shape)), None, 1.0)
    return true_mean(gs.Simulator, camera, scene, None, 1.0) / even.mean()


def near_camera(**more):
    """A lens that is focused at FOCUS; its cone has the f-number of the integrals."""
    wider = F_NUMBER / (1 + 4e-3 / (FOCUS - 4e-3))
    return camera(**{"object_distance": FOCUS, "f_number": wider} | more)


def distance_at(optics, waves):
    """Distance [m] at which a lens is out of focus by `waves` at 550 nm: W = D a^2 / (2 lambda)."""
    radius = optics.focal_length / optics.f_number / 2
    return 1 / (1 / optics.object_distance - waves * 2 * WAVE / radius**2)


# The integral by 6 nodes a pixel errs by 1e-6, splines between distances by 2e-4 of the peak,
# transfer functions along the rays of a polygon by 1.5e-5, splines over the field by 1e-4 of it.
# The slope turns more of its area to one side of the pupil: 1 + x dr/ds for rays to s + r x, r = -4 q W.
@pytest.mark.parametrize("waves", [0.8, -1.3])
@pytest.mark.parametrize(
    ("more", "wave", "options"),
    [
        ({}, None, {}),
        ({"pupil": Pupil(0, 0.3)}, None, {"hole": 0.3}),
        pytest.param({"pupil": Pupil(6)}, None, {"blades": 6}, marks=pytest.mark.slow),
        pytest.param(
            {"wavefront": Wavefront(seidel=(0, 0.5, 0, 0, 0))},
            lambda x, y, place: 0.5 * (x * x + y * y) * (x * place[1] + y * place[0]),
            {},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_star_has_the_spread_of_its_own_distance(waves, more, wave, options):
    """The scene is a slope, or has two distances; the star stands at one of them."""
    own = near_camera(**more)
    at, plane = 22, np.zeros((N, N))
    plane[at, at] = 1e4
    tilt = -4 * Q / (N - 1)
    slope = (
        np.linspace(-0.5, 0.5, N)[None].repeat(N, axis=0) + waves - np.linspace(-0.5, 0.5, N)[at]
    )
    if more and "hole" not in options:  # few kernels of these take long
        slope, tilt = np.where(slope < slope[0, at] + 0.2, slope[0, at], waves + 0.5), 0.0
    scene = scene_of(plane, "zero", depth=distance_at(own.optics, slope))
    place = ((at - (N - 1) / 2) / np.hypot(N, N) * 2,) * 2

    def front(x, y):
        return waves * (x * x + y * y) + (wave(x, y, place) if wave else 0)

    wanted = pupil_star(front, tilt=tilt, **options)
    window = (slice(at - SIDE // 2, at + SIDE // 2 + 1),) * 2
    found = truth_of(own, scene)[window] / 1e4
    # the tilt's shortest waves alias on the samples: 0.13 of its largest change
    tilted = np.abs(wanted - pupil_star(front, **options)).max()
    assert np.abs(found - wanted).max() < 1e-3 * wanted.max() + 0.13 * tilted


def slope_of(optics, steep, shape, first=3.0):
    """Return circles of confusion that grow by `steep` samples a column, and their distances."""
    circles = steep * (np.arange(shape[1]) - shape[1] / 2 + first)
    waves = circles / 2 * PITCH / (4 * WAVE * optics.working_f_number)
    return circles, np.broadcast_to(distance_at(optics, waves), shape)


@pytest.mark.parametrize("border", ["edge", "reflect"])
@pytest.mark.parametrize("steep", [0.1, 0.4])
@pytest.mark.parametrize(
    "more",
    [
        pytest.param({}, id="round"),
        pytest.param({"pupil": Pupil(0, 0.4)}, id="obscured", marks=pytest.mark.slow),
    ],
)
def test_an_even_wall_has_an_even_picture_at_any_slope(border, steep, more):
    """Radiance is kept along rays: each ray of a pixel's cone meets the wall, and all see the same light."""
    own = near_camera(f_number=2.0, **more)
    shape = (12, 20)
    depth = slope_of(own.optics, steep, shape)[1]
    found = truth_of(own, scene_of(np.ones(shape), border, depth=depth))
    assert np.abs(found - 1).max() < 1e-9


@pytest.mark.parametrize("axis", [0, 1])
def test_the_picture_of_a_slope_is_seen_along_the_rays_of_each_pixel(axis):
    """A wave on a slope: the mean over the pupil of the light where each ray of a pixel meets it.

    With rays of s to s + r(s) u, r = r0 + r' s, the ray u of the pixel x comes from s = (x - r0 u) /
    (1 + r' u).
    """
    own = near_camera(f_number=2.0)
    steep, shape = 0.3, (12, 44)
    circles, depth = slope_of(own.optics, steep, shape)
    at, f = np.arange(shape[1]), 0.06
    plane = 1 + np.cos(2 * np.pi * f * at) * np.ones((shape[0], 1))
    if axis == 0:
        plane, depth = plane.T, depth.T
    found = truth_of(own, scene_of(plane, depth=depth))
    row = found[shape[0] // 2] if axis else found[:, shape[0] // 2]
    # rays of a pupil point are displaced by -4 q W u = -r u; a chord at u is sqrt(1 - u^2) long
    u = np.cos(np.pi * (np.arange(400) + 0.5) / 400)
    mass = 1 - u * u
    first, slope = -circles[0] / 2, -steep / 2
    source = (at[:, None] - first * u) / (1 + slope * u)
    inside = slice(14, -14)  # of the edges' influence
    wanted = (1 + np.cos(2 * np.pi * f * source)) @ mass / mass.sum()
    # diffraction at f passes 1 - 4 q f / pi of the wave, the pixel sinc(f)
    q = WAVE * own.optics.working_f_number / PITCH
    passed = (1 - 4 * q * f / np.pi) * np.sinc(f)
    even = 1 / (1 + slope * u)  # rays that are spread with the same light each
    spread = ((1 + np.cos(2 * np.pi * f * source)) * even) @ mass / mass.sum()
    # geometrical optics, of discs from 0 to 3 samples with diffraction in focus: 0.7 % of the wave
    assert np.abs((row - 1) / passed - (wanted - 1))[inside].max() < 0.012
    assert np.abs(spread - wanted)[inside].max() > 2 * 0.012


def test_the_star_matrix_has_this_lens():
    assert abs(near_camera().optics.working_f_number / F_NUMBER - 1) < 1e-12


def segment(x):
    """Return the part of a disc's area on the side of growing x beyond x [radius]."""
    x = np.clip(x, -1, 1)
    return (np.arccos(x) - x * np.sqrt(1 - x * x)) / np.pi


def test_two_sheets_out_of_focus_are_seen_through_the_same_points_of_the_pupil():
    """A black half plane before a bright one, both with their edges on the axis.

    A ray of the pupil point u meets the front edge at r1 u and the back edge at r2 u. It is bright
    at x if x is beyond both, so the picture is the smaller one of two segments for radii of one
    sign. Composed after their blur it is their product.
    """
    own = near_camera(f_number=2.0)
    rows, cols = 80, 96
    x = np.arange(cols) - (cols - 1) / 2
    optics = own.optics
    q = WAVE * optics.working_f_number / PITCH
    radii = 12.0, 6.0  # [sample] = 4 q W
    near = [distance_at(optics, -radius / (4 * q)) for radius in radii]
    back = np.broadcast_to((x > 0) * 1.0, (rows, cols)).copy()
    scene = scene_of(back, depth=np.full((rows, cols), near[1]))
    front = np.broadcast_to((x < 0).astype(np.float32), (rows, cols)).copy()
    dark = replace(scene.content, values=np.zeros_like(scene.content.values))
    scene = replace(scene, layers=(Layer(dark, front, near[0]),))
    found = truth_of(own, scene)[rows // 2]
    first, second = (segment(-x / radius) for radius in radii)
    # diffraction at half a pixel widens edges: q / (pi^2 r) of the light is beyond them
    tolerance = 2 * q / (np.pi**2 * radii[1]) + 0.01
    assert np.abs(found - np.minimum(first, second)).max() < tolerance
    assert np.abs(np.minimum(first, second) - first * second).max() > 3 * tolerance


def test_a_distorted_scene_keeps_the_distance_of_each_sample():
    """A star in one half of two distances, displaced by whole pixels: the spread of its half."""
    own = near_camera()
    corner = np.hypot(N, N) / 2 * PITCH
    at, middle = 15, (N - 1) // 2
    # r^ = r (1 + k r^2): the star at (15, 15), 15 down and left of the middle, moves out by 3
    height = np.hypot(at - middle, at - middle) * PITCH / corner
    strength = 3 / (middle - at) / height**2
    own = replace(
        own, optics=replace(own.optics, distortion=RadialPolynomial(0.0, strength, corner))
    )
    plane = np.zeros((N, N))
    plane[at, at] = 1e4
    far = np.full((N, N), distance_at(own.optics, 1.2))
    far[:, middle:] = FOCUS
    found = truth_of(own, scene_of(plane, "zero", depth=far)) / 1e4
    wanted = pupil_star(lambda x, y: 1.2 * (x * x + y * y))
    to = at - 3
    window = (slice(to - 12, to + 13),) * 2
    # a point's light is kept; between samples it is a band-limited point, magnified by the lens
    slope = 1 + 3 * strength * height**2
    assert abs(found[window].sum() / wanted.sum() - 1) < 0.05
    spread = [second_moment(one) for one in (found[window], wanted)]
    assert abs(spread[0] - spread[1]) < 0.1 * spread[1] + slope**2 / 12


def second_moment(light):
    """Return the mean square distance from the middle along rows, within 6 pixels."""
    part = light[6:-6, 6:-6]
    at = np.arange(len(part)) - len(part) // 2
    return (part.sum(axis=1) @ at**2) / part.sum()


def test_cuts_are_between_neighbours_that_jump():
    steps = np.repeat([[0.0, 0.1, 3.0, 3.2, 9.0]], 4, axis=0)
    found = cuts(steps)
    assert len(found) == 2
    assert 0.1 < found[0] < 3.0
    assert 3.2 < found[1] < 9.0
    assert cuts(np.linspace(0, 9, 40)[None].repeat(3, axis=0)) == []


@pytest.mark.parametrize("pupil", [Pupil(), Pupil(6), Pupil(5, 0.4, 0.3)])
def test_points_of_the_pupil_are_inside_and_even(pupil):
    """Their second moments are the pupil's: of a polygon (2 + cos(2 pi / n)) / 12 of each square radius."""
    x, y = pupil_points(Optics(2.8, 4e-3, pupil=pupil))
    radius = np.hypot(x, y)
    assert radius.min() >= pupil.obscuration
    assert radius.max() <= 1
    if pupil.blades:
        angles = pupil.rotation + np.pi * (2 * np.arange(pupil.blades) + 1) / pupil.blades
        outward = np.outer(np.cos(angles), x) + np.outer(np.sin(angles), y)
        assert outward.max() <= np.cos(np.pi / pupil.blades) + 1e-12
    n, hole = pupil.blades, pupil.obscuration
    area = n / 2 * np.sin(2 * np.pi / n) if n else np.pi
    second = area * (2 + np.cos(2 * np.pi / n)) / 12 if n else np.pi / 4
    wanted = (second - np.pi * hole**4 / 4) / (area - np.pi * hole**2)
    # 256 points: 3 standard errors of a mean of squares are 10 %, an even spiral has a tenth of it
    assert abs(np.mean(x**2) / wanted - 1) < 0.04
    assert abs(np.mean(y**2) / wanted - 1) < 0.04

"""Points of light at their own distance: against integrals over the pupil in float64, with what stands before them."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy
from devices import ALL_KINDS

import gpusim as gs
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil
from gpusim.domain.scene import unit_light

NM, PITCH, SHAPE = 550.0, 6e-6, (72, 80)
FOCUS, NEAR, CARD = 5.0, 2.0, 1.5  # [m]
BLADES = Pupil(6, 0, 0.2)
LENS = Optics(2.8, 25e-3, object_distance=FOCUS, relative_illumination="none", pupil=BLADES)
IMAGE = 1 / (1 / LENS.focal_length - 1 / FOCUS)
CONE = IMAGE / (LENS.focal_length / LENS.f_number)  # working f-number
Q = NM * 1e-9 * CONE / PITCH
POINT = 34, 41
LIGHT = 1e9  # over the shadows' 1
GAUSS = np.polynomial.legendre.leggauss


def waves(distance):
    """Defocus at the rim of a point at a distance, of a thin lens [wave]; its rays land opposite if it is positive."""
    aperture = LENS.focal_length / LENS.f_number / 2
    return (1 / distance - 1 / FOCUS) * aperture**2 / 2 / (NM * 1e-9)


def energies(distance, rows, cols, most=np.inf):
    """Energy of pixels at rows and columns from a point through six blades, open where x <= most [radius].

    Chords of the polygon between the heights of its corners, with Gauss-Legendre nodes along both
    axes, and in the pixels.
    """
    angles = BLADES.rotation + 2 * np.pi * np.arange(7) / 6
    corners = np.stack([np.sin(angles), np.cos(angles)], axis=1)
    levels = np.unique(np.round(corners[:6, 0], 12))
    nodes, mass = GAUSS(14)  # four to a fringe of q
    at_y, at_x = (
        ((np.asarray(one, float)[:, None] + nodes / 2) / (2 * Q)).ravel() for one in (rows, cols)
    )
    field, area = 0.0, 0.0
    defocus = waves(distance)
    turns = max(np.abs(at_y).max(), np.abs(at_x).max()) + 2 * abs(
        defocus
    )  # of the phase, per radius
    y_nodes, y_mass = GAUSS(int(2 * turns) + 40)
    x_nodes, x_mass = GAUSS(int(4 * turns) + 40)
    for low, high in pairwise(levels):
        for t, w in zip(y_nodes, y_mass, strict=True):
            y = (low + high) / 2 + t * (high - low) / 2
            ends = []
            for (y0, x0), (y1, x1) in pairwise(corners):
                if min(y0, y1) <= y < max(y0, y1):
                    ends.append(x0 + (x1 - x0) * (y - y0) / (y1 - y0))
            left, right = min(ends), max(ends)
            area += w * (high - low) / 2 * (right - left)
            right = min(right, most)
            if right <= left:
                continue
            x = (left + right) / 2 + x_nodes * (right - left) / 2
            weight = w * (high - low) / 2 * x_mass * (right - left) / 2
            own = weight * np.exp(2j * np.pi * defocus * (x * x + y * y))
            line = np.exp(2j * np.pi * np.outer(at_x, x)) @ own
            field = field + np.exp(2j * np.pi * at_y * y)[:, None] * line
    density = np.abs(field) ** 2 / (area * 4 * Q * Q)
    shape = len(rows), 14, len(cols), 14
    return np.einsum("iajb,a,b->ij", density.reshape(shape), mass / 2, mass / 2)


def scene_of(distance, card=None):
    """A point before even shadows in focus; card: first column of a dark card to the right of it."""
    picture, depth = np.ones(SHAPE), np.full(SHAPE, FOCUS)
    picture[POINT], depth[POINT] = LIGHT, distance
    if card is not None:
        picture[:, card:], depth[:, card:] = 0.5, CARD
    nm = np.array([NM])
    cube = gs.Cube(nm, (1e12 * picture[None]).astype(np.float32))
    return gs.Scene(cube, unit_light(nm), depth=depth)


def camera():
    own = gs.open_camera("mono")
    return replace(own, optics=LENS, sensor=replace(own.sensor, pixel_pitch=PITCH, fill_factor=1.0))


def exposed(scene, device="opencl:0", tolerance=None):
    simulator = gs.Simulator(camera(), device=device, tolerance=tolerance)
    found = simulator.expose(scene, 1.0)
    mean = np.asarray(simulator.device.numpy(found.mean), np.float64)
    return mean / (1e12 * found.plan.weights.sum()), found.plan


INNER = np.arange(-9, 10)
CORE = np.s_[POINT[0] - 9 : POINT[0] + 10, POINT[1] - 9 : POINT[1] + 10]


@pytest.fixture(scope="module")
def disc():
    """Energies of the pixels around the point."""
    return energies(NEAR, INNER, INNER)


@pytest.mark.slow
@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_point_before_shadows(device, disc):
    """1e9 at 2 m through six blades focused at 5 m: its own disc, and far from it its rim's and its streaks' light."""
    mean, plan = exposed(scene_of(NEAR), device)
    assert "1 highlights added exactly" in plan.models["optics.splat"]
    error = mean[CORE] / LIGHT - disc
    assert np.abs(error).max() < 1e-5 * disc.max()
    # beyond the exact core light is a mean over the rim's rings and streaks: by blocks of pixels
    rows, cols = np.arange(27, 33), np.arange(26, 36)
    block = mean[POINT[0] + rows[0] :, POINT[1] + cols[0] :][: len(rows), : len(cols)]
    assert (block - 1).sum() == pytest.approx(LIGHT * energies(NEAR, rows, cols).sum(), rel=0.1)


def test_points_of_other_distances_are_others(disc):
    """So that the test above can fail."""
    for other in (FOCUS, 2.2):
        assert np.abs(energies(other, INNER, INNER) - disc).max() > 0.05 * disc.max()


@pytest.mark.slow
def test_a_point_behind_a_card(disc):
    """A card hides a part of the pupil: the part of the disc whose rays it stops is missing."""
    first = POINT[1] + 2
    mean, plan = exposed(scene_of(NEAR, first), tolerance="video")
    # a ray from the point through x of the pupil meets the card's plane off the point's direction
    per_radius = (1 / CARD - 1 / NEAR) * LENS.focal_length / LENS.f_number / 2 * IMAGE / PITCH
    most = (first - 0.5 - POINT[1]) / per_radius
    assert -1 < most < 1
    truth = energies(NEAR, INNER, INNER, most)
    found = mean[CORE] / LIGHT
    assert truth.sum() < 0.9 * disc.sum()
    assert found.sum() == pytest.approx(truth.sum(), rel=0.03)

    def smooth(image):
        return scipy.ndimage.uniform_filter(image, 5, mode="constant")

    # rays in place of fringes: in means over 5 x 5 pixels
    assert np.abs(smooth(found - truth)).max() < 0.12 * smooth(disc).max()
    assert np.abs(smooth(disc - truth)).max() > 0.4 * smooth(disc).max()
    assert not plan.account.bounds["highlights behind edges"].is_known
    assert not plan.verdict.is_met


@pytest.mark.slow
def test_a_card_far_from_the_point_hides_nothing():
    """Its rays pass: the same light as without the card, but for the card's own shadow-like light."""
    without, _ = exposed(scene_of(NEAR))
    mean, _ = exposed(scene_of(NEAR, POINT[1] + 12))
    near = np.s_[POINT[0] - 8 : POINT[0] + 9, POINT[1] - 8 : POINT[1] + 9]
    assert np.abs(mean - without)[near].max() < 2


def airy(q, rows, cols):
    """Energy of pixels at rows and columns from a point: Airy's pattern, by Gauss-Legendre nodes in each pixel."""
    nodes, mass = GAUSS(24)
    y, x = ((np.asarray(one, float)[:, None] + nodes / 2).ravel() for one in (rows, cols))
    v = np.maximum(np.pi * np.hypot(y[:, None], x) / q, 1e-12)
    density = np.pi / (4 * q * q) * (2 * scipy.special.j1(v) / v) ** 2
    shape = len(rows), 24, len(cols), 24
    return np.einsum("iajb,a,b->ij", density.reshape(shape), mass / 2, mass / 2)


@pytest.mark.parametrize("pupil", [Pupil(), pytest.param(Pupil(0, 0.3), marks=pytest.mark.slow)])
def test_a_point_in_a_view(pupil):
    """Where the view puts it, by whole pixels."""
    view = gs.View(shift=(2.0, -3.0))
    scene = replace(scene_of(FOCUS), depth=None, view=view)
    own = camera()
    lens = replace(LENS, pupil=pupil, f_number=5.6)
    simulator = gs.Simulator(replace(own, optics=lens), device="opencl:0")
    found = simulator.expose(scene, 1.0)
    assert "1 highlights" in found.plan.models["optics.splat"]
    mean = np.asarray(found.mean, np.float64) / (1e12 * found.plan.weights.sum())
    rows, cols = (
        np.arange(n) - one + move for n, one, move in zip(SHAPE, POINT, view.shift, strict=True)
    )
    q = lens.working_f_number * NM * 1e-9 / PITCH
    truth = LIGHT * airy(q, rows, cols)
    if pupil.obscuration:  # another pattern: the same without the view
        plain = simulator.expose(replace(scene, view=gs.View()), 1.0)
        still = np.asarray(plain.mean, np.float64)[2:, :-3] / (1e12 * found.plan.weights.sum())
        assert np.abs(mean[:-2, 3:] - still).max() < 1e-6 * truth.max()
    else:
        assert np.abs(mean - truth).max() < 1e-4 * truth.max()

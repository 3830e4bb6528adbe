"""Point spreads that were measured at several distances: against sums of samples with kernels of our own."""

from dataclasses import replace

import numpy as np
import pytest
from devices import ALL_KINDS, DEVICES
from scipy.interpolate import barycentric_interpolate

import gpusim as gs
from gpusim.domain.content import Cube
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.psf import PointSpread
from gpusim.domain.scene import Scene, unit_light
from gpusim.io.camera.cameras import open_camera
from gpusim.optics.depth import DepthPlan
from gpusim.pipeline.simulator import Simulator

PITCH, NM, SIZE = 4e-6, np.array([550.0]), 15
DISTANCES = np.array([0.5, 0.6, 0.8, 1.2, 2.0, 4.0, np.inf])
AT = np.arange(SIZE) - SIZE // 2


def kernel(dioptres, more=0.0):
    """A Gaussian that becomes wider and moves to one side with 1 / distance: no disc of a thin lens does that."""
    sigma, aside = 0.8 + 0.7 * dioptres, 0.9 * dioptres + more
    found = np.exp(-(AT[:, None] ** 2 + (AT - aside) ** 2) / (2 * sigma**2))
    return found / found.sum()


def table(**more):
    values = np.array([[kernel(1 / d)] for d in DISTANCES])
    return PointSpread(NM, values, PITCH, integrated=True, distances=DISTANCES, **more)


def camera(spread, distance=2.0):
    own = open_camera("mono")
    optics = Optics(
        4.0,
        5e-3,
        object_distance=distance,
        relative_illumination="none",
        model="measured",
        psf=spread,
    )
    return replace(
        own, optics=optics, sensor=replace(own.sensor, pixel_pitch=PITCH, fill_factor=1.0)
    )


def picture(shape=(36, 40)):
    return np.random.default_rng(3).uniform(0.5, 1.5, shape)


def mean_of(light, depth, camera, device=DEVICES[0]):
    scene = Scene(
        Cube(NM, (1e15 * light[None]).astype(np.float32)),
        unit_light(NM),
        depth=depth,
        border="zero",
    )
    simulator = Simulator(camera, device=device)
    result = simulator.expose(scene, 1.0)
    found = np.asarray(simulator.device.numpy(result.mean), np.float64)
    return found / (1e15 * result.plan.weights[0, 0]), result.plan


def summed(light, kernels):
    """Light of every sample spread with the kernel of its row."""
    half = SIZE // 2
    out = np.zeros(tuple(n + 2 * half for n in light.shape))
    for (y, x), value in np.ndenumerate(light):
        out[y : y + SIZE, x : x + SIZE] += value * kernels[y]
    return out[half:-half, half:-half]


# the plan keeps a relative RMS error of 1e-4 without a tolerance; single samples have up to five times as much
ERROR = 5e-4
INNER = np.s_[8:-8, 8:-8]  # beyond it the step to the dark outside takes part


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("ends", [(0.05, 0.25), (0.9, 1.1), (1.7, 1.9)])
def test_each_distance_has_its_own_spread(device, ends):
    """Slopes: between distances cubics through the nearest four.

    Frames keep a slanted even wall even, sums over samples do not: that is (.7 x .2 / 36)^2 = 1.5e-5 here.
    """
    light, shape = picture(), (36, 40)
    dioptres = np.linspace(*ends, shape[0])
    depth = np.broadcast_to(1 / dioptres[:, None], shape)
    found, plan = mean_of(light, depth, camera(table()), device)
    known = 1 / DISTANCES
    kernels = []
    for own in dioptres:
        after = int(np.searchsorted(-known, -own))
        first = min(max(after - 2, 0), len(known) - 4)
        four = slice(first, first + 4)
        kernels.append(barycentric_interpolate(known[four], table().values[four, 0], own))
    wanted = summed(light, kernels)
    assert np.abs(found - wanted)[INNER].max() < ERROR
    assert not any("measured at one distance" in line for line in plan.left_out)
    # neither the spread in focus nor a thin lens's disc does it
    assert np.abs(summed(light, [kernel(0.5)] * 36) - wanted)[INNER].max() > 50 * ERROR


def test_few_distances_are_an_error_in_the_account():
    """Of three distances, against the spreads at all: the prediction holds, and is not idle."""
    light, some = picture(), DISTANCES[[0, 3, 6]]
    dioptres = np.linspace(1.05, 1.85, 36)
    values = np.array([[kernel(1 / d)] for d in some])
    spread = PointSpread(NM, values, PITCH, integrated=True, distances=some)
    depth = np.broadcast_to(1 / dioptres[:, None], light.shape)
    found, plan = mean_of(light, depth, camera(spread))
    wanted = summed(light, [kernel(one) for one in dioptres])
    error = np.sqrt(np.mean((found - wanted)[INNER] ** 2) / np.mean(wanted[INNER] ** 2))
    name = "depth, point spreads between the distances that were measured"
    predicted = plan.find(DepthPlan).predicted[name]
    assert error > 2e-3 and error < predicted < 10 * error
    _, plan = mean_of(light, depth, camera(table()))
    assert plan.find(DepthPlan).predicted[name] < predicted / 2


def test_one_distance():
    """A plane at a distance that was measured; and no depth: the distance in focus."""
    light = picture()
    found, _ = mean_of(light, np.full(light.shape, 4.0), camera(table()))
    assert np.abs(found - summed(light, [kernel(0.25)] * 36)).max() < ERROR
    for distance in (0.5, 1.2, np.inf):
        found, _ = mean_of(light, None, camera(table(), distance))
        assert np.abs(found - summed(light, [kernel(1 / distance)] * 36)).max() < ERROR


def test_distances_and_a_grid_of_field_points():
    light = picture()
    axis = np.array([-1.0, 1.0])
    values = np.array([[[[kernel(1 / d, 0.6 * y)] for _ in axis] for y in axis] for d in DISTANCES])
    spread = PointSpread(NM, values, PITCH, integrated=True, grid=(axis, axis), distances=DISTANCES)
    depth = np.full(light.shape, 1.2)
    found, _ = mean_of(light, depth, camera(spread))
    corner = np.hypot(*light.shape) / 2
    kernels = []
    for y in (np.arange(36) - 17.5) / corner:
        share = (y + 1) / 2
        kernels.append((1 - share) * kernel(1 / 1.2, -0.6) + share * kernel(1 / 1.2, 0.6))
    # the world ends at the frame, and the kernels of places in tiles are polynomials within the plan's error
    assert np.abs(found - summed(light, kernels))[INNER].max() < 10 * ERROR


def test_distances_that_were_not_measured_are_refused():
    spread = PointSpread(NM, table().values[1:4], PITCH, integrated=True, distances=DISTANCES[1:4])
    light = picture()
    with pytest.raises(OutOfRange, match=r"depth.*0\.6 \.\. 1\.2 m") as found:
        mean_of(light, np.full(light.shape, 3.0), camera(spread, 0.8))
    assert "\n" not in str(found.value)
    with pytest.raises(OutOfRange, match=r"distance.*2 m.*0\.6 \.\. 1\.2 m"):
        mean_of(light, None, camera(spread, 2.0))


def test_spreads_of_single_distances_are_combined():
    small = PointSpread(NM, kernel(0.5)[None, 2:-2, 2:-2], PITCH, integrated=True)
    wide = PointSpread(NM, kernel(2.0)[None], PITCH, integrated=True)
    both = PointSpread.by_distance({2.0: small, 0.5: wide})
    assert both.distances.tolist() == [0.5, 2.0] and both.values.shape == (2, 1, SIZE, SIZE)
    np.testing.assert_allclose(both.at(0, 0, 0.5), wide.values, rtol=1e-14)
    np.testing.assert_allclose(both.at(0, 0, 2.0)[:, 2:-2, 2:-2], small.values, rtol=1e-14)
    assert both.at(0, 0, 2.0)[:, :2].sum() == 0
    for other in (replace(wide, spacing=2 * PITCH), replace(wide, values=kernel(0.5)[None, :-1])):
        with pytest.raises(BadData, match="differ in"):
            PointSpread.by_distance({2.0: small, 0.5: other})
    with pytest.raises(BadData, match="two or more"):
        PointSpread.by_distance({2.0: small})


@pytest.mark.parametrize("distances", [[1.0, 1.0], [2.0, 1.0], [-1.0, 1.0], [np.nan, 1.0], [1.0]])
def test_bad_distances(distances):
    values = np.ones((len(distances), 1, 3, 3))
    with pytest.raises((BadData, OutOfRange), match="distance"):
        PointSpread(NM, values, PITCH, distances=np.array(distances))


def test_the_file(tmp_path):
    """As numpy reads it; and back."""
    gs.write_psf(tmp_path / "lens.npz", table())
    with np.load(tmp_path / "lens.npz") as file:
        np.testing.assert_array_equal(file["distances_m"], DISTANCES)
        assert file["psf"].shape == (7, 1, SIZE, SIZE)
    again = gs.read_psf(tmp_path / "lens.npz")
    assert again.notes == ()
    np.testing.assert_array_equal(again.distances, DISTANCES)
    np.testing.assert_allclose(again.values, table().values, rtol=1e-15)

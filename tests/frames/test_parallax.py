"""A camera that changes its place before surfaces at several distances: against the geometry of a pinhole."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.captures.moving import expose_motion
from gpusim.captures.parallax import see_from
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import Scene

SHAPE = 24, 240
FOCAL = 120.0  # [sample] from the pupil to the picture
NEAR, FAR = 1.0, 3.0  # [m]
WAVELENGTHS = np.array([520.0, 560.0, 600.0])
LIGHT = gs.chart("flat").illuminant
FOV = 2 * np.arctan(SHAPE[1] / 2 / FOCAL)
MONO = gs.open_camera("mono")
SHARP = replace(MONO, optics=replace(MONO.optics, model="none", relative_illumination="none"))


def coverage(left, right, count=SHAPE[1]):
    """Part of each sample that lies between two places from the middle [sample]: edges between samples."""
    ends = np.arange(count + 1) - count / 2
    return np.clip(np.minimum(ends[1:], right) - np.maximum(ends[:-1], left), 0, 1)


def cube(line):
    """A content whose rows are all this line."""
    return gs.Cube(WAVELENGTHS, np.tile(np.asarray(line, np.float32), (3, SHAPE[0], 1)))


def walls(layered):
    """A wall at 3 m with a dark stripe from -70 to -50 samples, and before it one at 1 m from 20 to 60."""
    stripe, front = coverage(-70, -50), coverage(20, 60)
    behind = 0.8 - 0.6 * stripe
    if layered:
        layer = gs.Layer(cube(np.full(SHAPE[1], 0.4)), np.tile(front, (SHAPE[0], 1)), NEAR)
        return Scene(
            cube(behind), LIGHT, layers=(layer,), depth=np.full(SHAPE, FAR), fov=FOV, name="walls"
        )
    line = behind * (1 - front) + 0.4 * front
    depth = np.tile(np.where(front > 0.5, NEAR, FAR), (SHAPE[0], 1))
    return Scene(cube(line), LIGHT, depth=depth, fov=FOV, name="walls")


def place_of(line, dark, bright):
    """Places of the falling and the rising edge of a dark stripe, from the middle: by its area and its centre."""
    part = (bright - line) / (bright - dark)
    x = np.arange(len(line)) - (len(line) - 1) / 2
    width, middle = part.sum(), (part * x).sum() / part.sum()
    return middle - width / 2, middle + width / 2


@pytest.mark.parametrize("layered", [True, False])
@pytest.mark.parametrize("right", [0.1, -0.1, 0.0437])
def test_edges_move_as_geometry_says(layered, right):
    """10 cm sideways: 12 samples of the wall at 1 m, 4 of the wall at 3 m."""
    moved = gs.move_camera(walls(layered), SHARP, (0.0, right, 0.0))
    mean = np.asarray(gs.Simulator(SHARP, device="opencl:0").expose(moved, 0.01).mean, np.float64)
    line = mean.mean(axis=0)
    line = 0.8 * line / line[2]  # the wall at 3 m has 0.8
    shift = {distance: FOCAL * right / distance for distance in (NEAR, FAR)}
    for part, dark, ends, distance in (
        (slice(20, 90), 0.2, (-70, -50), FAR),
        (slice(110, 240), 0.4, (20, 60), NEAR),
    ):
        offset = (part.start + part.stop) / 2 - SHAPE[1] / 2
        found = np.add(place_of(line[part], dark, 0.8), offset)
        assert found == pytest.approx(np.subtract(ends, shift[distance]), abs=0.02)


@pytest.mark.parametrize("right", [0.1, -0.1])
def test_hidden_surfaces_are_guessed_and_said(right):
    """A single picture knows nothing behind the wall at 1 m: the guess is where geometry uncovers it."""
    moved = see_from(walls(False), SHARP, (0.0, right, 0.0))
    near, far = FOCAL * right / NEAR, FOCAL * right / FAR
    # covered at first, from 20 to 60 moved as the wall at 3 m, and not by the moved wall at 1 m
    expected = coverage(20 - far, 60 - far) * (1 - coverage(20 - near, 60 - near))
    assert (
        np.abs(moved.guessed - expected).max() < 1e-3 + 0.5
    )  # samples of edges: half of one at most
    assert moved.guessed.sum() == pytest.approx(SHAPE[0] * expected.sum(), abs=0.02 * SHAPE[0])
    assert expected.sum() == pytest.approx(8.0)
    assert not see_from(walls(True), SHARP, (0.0, right, 0.0)).guessed.any()


def test_a_camera_that_goes_ahead_enlarges_near_things_more():
    moved = gs.move_camera(walls(True), SHARP, (0.0, 0.0, 0.2))
    layer = moved.layers[0]
    assert place_of(1 - layer.alpha[0], 0.0, 1.0) == pytest.approx((20 / 0.8, 60 / 0.8), abs=0.02)
    assert layer.depth == pytest.approx(0.8) and moved.depth == pytest.approx(2.8)


def test_a_slope_of_distances_moves_each_sample_by_its_own():
    """A floor: the picture of it is that of the moved points, found by their own geometry."""
    shape = (64, 40)
    y = np.arange(shape[0]) - (shape[0] - 1) / 2
    depth = np.tile((60.0 / (y + 60))[:, None] * 2, (1, shape[1]))  # 1 / Z is linear in the row
    light = 1 + 0.5 * np.sin(2 * np.pi * 0.04 * (np.arange(shape[1]) - 19.5)) * np.ones((64, 1))
    values = np.broadcast_to(light, (3, *shape)).astype(np.float32)
    scene = Scene(gs.Cube(WAVELENGTHS, values), LIGHT, depth=depth, fov=2 * np.arctan(20 / FOCAL))
    moved = see_from(scene, SHARP, (0.01, 0.05, 0.0))
    # p' = p + f t / Z(p'): with 1 / Z = (y' + 60) / 120 linear, solved in closed form
    k = FOCAL / 120
    inner = (y + 60 * k * 0.01) / (1 - k * 0.01)
    expected = 1 + 0.5 * np.sin(
        2 * np.pi * 0.04 * (np.arange(40) - 19.5 + k * 0.05 * (inner[:, None] + 60))
    )
    found = moved.scene.content.values[0][4:-4, 6:-8]
    # cubic splines of a wave of 25 samples err by 1e-4; the distance between rows is interpolated linearly
    assert found == pytest.approx(expected[4:-4, 6:-8], abs=2e-3)
    assert moved.error < 1e-3


def waves_and_wall():
    """Waves of 16 samples at 3 m, and before them an even wall at 1 m from 20 to 60 samples."""
    behind = 0.6 + 0.2 * np.cos(2 * np.pi / 16 * (np.arange(SHAPE[1]) - (SHAPE[1] - 1) / 2))
    layer = gs.Layer(cube(np.full(SHAPE[1], 0.3)), np.tile(coverage(20, 60), (SHAPE[0], 1)), NEAR)
    return Scene(
        cube(behind), LIGHT, layers=(layer,), depth=np.full(SHAPE, FAR), fov=FOV, name="waves"
    )


def seen_on_the_way(speed, opens, seconds, count):
    """Mean of the waves and the wall over so many instants of an exposure, closed form at each, (columns,)."""
    x, total = np.arange(SHAPE[1]) - (SHAPE[1] - 1) / 2, 0.0
    for part in (np.arange(count) + 0.5) / count:
        right = speed * (opens + seconds * part)
        near, far = FOCAL * right / NEAR, FOCAL * right / FAR
        wall = coverage(20 - near, 60 - near)
        total = total + (1 - wall) * (0.6 + 0.2 * np.cos(2 * np.pi / 16 * (x + far))) + 0.3 * wall
    return total / count


@pytest.mark.parametrize(
    ("speed", "row_time"),
    [(1.0, 0.0), (3.0, 0.0), (2.0, 4e-4), pytest.param(-3.0, 1e-3, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("tolerance", [pytest.param(None, marks=pytest.mark.slow), "video"])
def test_motion_blur_of_a_camera_on_its_way(speed, row_time, tolerance):
    """Against 64 times as many places, by geometry; each row of a rolling shutter at its own time."""
    motion, seconds, start = gs.Motion(travel=(0.0, speed, 0.0)), 0.02, 0.05
    camera = replace(SHARP, sensor=replace(SHARP.sensor, row_time=row_time))
    simulator = gs.Simulator(camera, device="opencl:0", tolerance=tolerance)
    exposure = expose_motion(simulator, waves_and_wall(), motion, seconds, start)
    mean = np.asarray(exposure.mean, np.float64)
    count = 64 * int(exposure.plan.models["sensor.shutter"].split()[0])
    truth = np.stack(
        [seen_on_the_way(speed, start + row * row_time, seconds, count) for row in range(SHAPE[0])]
    )
    inner = np.s_[:, 30:-30]  # beyond the picture its border goes on
    truth = truth[inner] * (mean[inner].mean() / truth[inner].mean())
    error = mean[inner] - truth
    bounds = exposure.plan.account.bounds
    rms = np.sqrt(np.mean(error**2) / np.mean(truth**2))
    assert rms < bounds["shutter"].rms + bounds["view"].rms
    assert bounds["view"].rms < 1e-3  # a cubic spline through 16 samples a wave errs by 1e-4 of it
    assert bounds["surfaces that were hidden"].rms == 0
    # and not of a camera at rest, or with all rows at once
    assert np.ptp(mean[inner], axis=0).max() > 0.02 * mean.max() or not row_time
    still = seen_on_the_way(0.0, 0.0, seconds, 1)[30:-30] * mean[inner].mean() / 0.6
    assert np.sqrt(np.mean((still - truth) ** 2)) > 0.01 * mean.max()


@pytest.mark.parametrize("right", [0.0037, 0.0042, 0.05, 0.1021])
def test_samples_between_others_err_no_more_than_said(right):
    """A wall whose edges divide samples, before waves of 8 samples: each sample, against the closed form.

    An eighth more: splines of degree 5, the truth in the bound, err by 1/10 of those of degree 3.
    """
    x = np.arange(SHAPE[1]) - (SHAPE[1] - 1) / 2
    behind = 0.6 + 0.2 * np.cos(2 * np.pi / 8 * x)
    cover = np.tile(coverage(20.4, 59.5), (SHAPE[0], 1))
    layer = gs.Layer(cube(np.full(SHAPE[1], 0.3)), cover, NEAR)
    scene = Scene(cube(behind), LIGHT, layers=(layer,), depth=np.full(SHAPE, FAR), fov=FOV)
    moved = see_from(scene, SHARP, (0.0, right, 0.0))
    near, far = FOCAL * right / NEAR, FOCAL * right / FAR
    wall = coverage(20.4 - near, 59.5 - near)
    truth = 0.3 * wall + (1 - wall) * (0.6 + 0.2 * np.cos(2 * np.pi / 8 * (x + far)))
    ((front,), alpha) = moved.scene.layers, moved.scene.layers[0].alpha[0].astype(float)
    light = alpha * front.content.values[0, 0] + (1 - alpha) * moved.scene.content.values[0, 0]
    inner = np.s_[30:-30]
    error, bound = np.abs(light - truth)[inner], (moved.between[0] * light)[inner]
    assert (error <= 1.125 * bound + 1e-5).all()  # 1e-5: middles of waves, where both splines agree
    assert error.max() > 0.2 * bound.max() - 1e-5


def test_what_geometry_forbids_is_refused():
    flat = Scene(cube(np.ones(SHAPE[1])), LIGHT)
    with pytest.raises(BadData, match="needs the scene's depth"):
        gs.move_camera(flat, SHARP, (0.0, 0.1, 0.0))
    with pytest.raises(OutOfRange, match="ahead"):
        gs.move_camera(walls(True), SHARP, (0.0, 0.0, 1.5))
    with pytest.raises(BadData, match="three for travel"):
        gs.Motion(travel=(0.0, 1.0))

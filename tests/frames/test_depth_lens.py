"""Depth through lenses that displace points, vary over the field or do both: against sums over samples in float64."""

from dataclasses import replace

import numpy as np
import pytest
from devices import ALL_KINDS, DEVICES
from pupil_sums import Sum, transfer

import gpusim as gs
from gpusim.domain.content import Cube
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Wavefront
from gpusim.domain.scene import Layer, Scene, View, unit_light
from gpusim.io.camera.cameras import open_camera
from gpusim.optics.depth import DepthPlan
from gpusim.optics.kernel_space import KernelSpace
from gpusim.pipeline.simulator import Simulator

FAST = DEVICES[0]
PITCH, NM = 2e-6, np.array([550.0])
LENS = Optics(4.0, 5e-3, object_distance=0.4, relative_illumination="none")
K, RADIUS = -0.06, 25  # of the distortion, and the height at which it applies [pixel]


def camera(**lens):
    own = open_camera("mono")
    sensor = replace(own.sensor, pixel_pitch=PITCH, fill_factor=1.0)
    return replace(own, optics=replace(LENS, **lens), sensor=sensor)


def scene_of(picture, depth, **more):
    content = Cube(NM, (1e15 * picture[None]).astype(np.float32))
    return Scene(content, unit_light(NM), depth=depth, border="zero", **more)


def waves(shape):
    """Two waves of .095 and .112 cycles a sample."""
    y, x = np.indices(shape)
    picture = 1 + 0.3 * np.cos(2 * np.pi * (0.09 * x + 0.03 * y))
    return picture + 0.3 * np.cos(1 + 2 * np.pi * (0.11 * y - 0.02 * x))


INNER = np.s_[6:-6, 6:-6]  # beyond it the step to the dark outside is interpolated


def distances(confusion):
    """Distance [m] at which a thin lens has this circle of confusion [pixel]: d = c N / s^2 dioptres from the focus."""
    image = 1 / (1 / LENS.focal_length - 1 / LENS.object_distance)
    working = LENS.f_number * image / LENS.focal_length
    return 1 / (1 / LENS.object_distance - confusion * PITCH * working / image**2)


def displaced(y, x, shape, k=K, middle=(0.0, 0.0)):
    """Places of samples after r -> r + k r^3 / RADIUS^2 about a point off the frame's middle."""
    down, across = y - (shape[0] - 1) / 2 - middle[0], x - (shape[1] - 1) / 2 - middle[1]
    factor = 1 + k * (down**2 + across**2) / RADIUS**2
    return y + (factor - 1) * down, x + (factor - 1) * across


def rows_summed(picture, depth, y, x, period=96):
    """Light of samples at (y, x), each row at one distance."""
    found = Sum(period, picture.shape)
    for row, own in enumerate(picture):
        table, f = transfer(LENS, NM[0], PITCH, period, distance=depth[row, 0])
        found.add(own, y[row], x[row], table, f)
    return found.frame


def mean_of(scene, camera, device=FAST):
    simulator = Simulator(camera, device=device)
    result = simulator.expose(scene, 1.0)
    found = np.asarray(simulator.device.numpy(result.mean), np.float64)
    return found / (1e15 * result.plan.weights[0, 0]), result.plan


# Half way between samples Keys's cubic passes (9 cos pi f - cos 3 pi f) / 8 of a wave: .9970 at .095 and .9945 at .112
# cycles, so two waves of .3 err by up to 2.6e-3; the slope, .06 pixel a row, brightens even surfaces by .06^2 / 16 in a
# sum over samples, which frames undo: 4e-4 of 1.6
CUBIC = 3.5e-3


@pytest.mark.slow
@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_slope_seen_through_distortion(device):
    shape = (32, 40)
    picture, (y, x) = waves(shape), np.indices(shape)
    depth = distances(np.linspace(-1.0, 1.0, shape[0])[:, None] + 2 + 0 * x)
    lens = {"distortion": RadialPolynomial(0.0, K, RADIUS * PITCH)}
    found, plan = mean_of(scene_of(picture, depth), camera(**lens), device)
    assert plan.find(DepthPlan) and not any("depth" in line for line in plan.left_out)
    wanted = rows_summed(picture, depth, *displaced(y, x, shape))
    assert np.abs(found - wanted)[INNER].max() < CUBIC
    # and not of one distance, or in another place
    for other in (
        rows_summed(picture, 0 * depth + LENS.object_distance, *displaced(y, x, shape)),
        rows_summed(picture, depth, y, x),
    ):
        assert np.abs(other - wanted)[INNER].max() > 10 * CUBIC


def test_a_slope_in_a_view():
    """Turned and displaced; and another view of a video."""
    shape, turn, zoom, shift = (32, 40), 0.1, 1.0, (0.7, -0.4)
    picture, (y, x) = waves(shape), np.indices(shape)
    depth = distances(np.linspace(-1.0, 1.0, shape[0])[:, None] + 2 + 0 * x)
    view = View(shift=shift, rotation=turn, zoom=zoom)
    scene = scene_of(picture, depth, view=view)
    found, _ = mean_of(scene, camera())
    middle = (np.array(shape) - 1) / 2
    down, across = y - middle[0] - shift[0], x - middle[1] - shift[1]
    cos, sin = zoom * np.cos(turn), zoom * np.sin(turn)
    seen = cos * down - sin * across + middle[0], sin * down + cos * across + middle[1]
    wanted = zoom**2 * rows_summed(picture, depth, *seen)
    assert np.abs(found - wanted)[INNER].max() < CUBIC
    # the next view of a video, and this one again
    simulator = Simulator(camera(), device=FAST)
    loop = simulator.loop(scene)
    before = np.array(simulator.device.numpy(loop.exposure.mean))
    plain = np.array(
        simulator.device.numpy(loop.update(scene=replace(scene, view=View())).exposure.mean)
    )
    again = np.array(simulator.device.numpy(loop.update(scene=scene).exposure.mean))
    np.testing.assert_array_equal(again, before)
    assert np.abs(plain - before).max() > 0.1 * before.max()


def test_a_layer_through_distortion_hides_what_is_behind():
    """A bright back out of focus, a dark disc in focus before it, and the other way round."""
    shape = (32, 40)
    y, x = np.indices(shape)
    disc = np.clip(7.5 - np.hypot(y - 17, x - 22), 0, 1)
    near, far = (float(distances(c)) for c in (0.0, 3.0))
    cam = camera(distortion=RadialPolynomial(0.0, K, RADIUS * PITCH))
    picture = waves(shape)
    dark = Layer(scene_of(0 * picture, None).content, disc.astype(np.float32), near)
    hidden, _ = mean_of(scene_of(picture, 0 * picture + far, layers=(dark,)), cam)
    open_, _ = mean_of(scene_of(picture, 0 * picture + far), cam)
    at = displaced(y, x, shape)
    area = np.linalg.det(np.stack([np.gradient(one) for one in at], axis=-1).transpose(1, 2, 0, 3))
    cover = rows_summed(disc * np.abs(area), 0 * disc + near, *at)
    # a product of blurred light and transmission: the layer in focus is exact. Next to so high a contrast samples
    # are taken by area, which adds a variance of up to 1/4 sample^2; an edge of deviation .8 has a second derivative of
    # up to .24 / .8^2, and half the product is .047
    assert np.abs(hidden - (1 - cover) * open_).max() < 0.047 * open_.max()
    # seven pixels within it the disc lets .2 q / r pass
    assert hidden[17, 22] < 0.045 * open_[17, 22]
    bright = Layer(scene_of(picture, None).content, disc.astype(np.float32), near)
    shown, _ = mean_of(scene_of(0 * picture, 0 * picture + far, layers=(bright,)), cam)
    wanted = rows_summed(disc * picture, 0 * disc + near, *at)
    assert np.abs(shown - wanted).max() < 0.047 * wanted.max()


SEIDEL = (0.0, 0.3, 0.15, 0.2, 0.0)


def points_summed(picture, depth, y, x, lens, axis=(0.0, 0.0), period=64):
    """Light of samples at (y, x), each by the wavefront of its own field point and distance."""
    found, shape = Sum(period, picture.shape), picture.shape
    corner = np.hypot(*shape) / 2
    for at in zip(*np.nonzero(picture), strict=True):
        place = [
            (p[at] - (n - 1) / 2 - a) / corner for p, n, a in zip((y, x), shape, axis, strict=True)
        ]
        table, f = transfer(lens, NM[0], PITCH, period, place, depth[at])
        found.add(picture[at], y[at], x[at], table, f)
    return found.frame


@pytest.mark.parametrize(
    "axis",
    [
        pytest.param(None, id="field", marks=pytest.mark.slow),
        pytest.param((0.0, 0.0), id="displaced", marks=pytest.mark.slow),
        pytest.param((2.0, -5.0), id="off the axis", marks=pytest.mark.slow),
    ],
)
def test_a_slope_through_a_lens_that_varies(axis):
    """Coma, astigmatism and field curvature at their places; with distortion about the principal point, too."""
    shape = (24, 28)
    picture, (y, x) = waves(shape), np.indices(shape)
    depth = distances(np.linspace(-0.6, 0.8, shape[0])[:, None] + 1 + 0 * x)
    lens, at = {"wavefront": Wavefront(seidel=SEIDEL)}, (y, x)
    if axis is not None:
        focal = 40.0  # [pixel]: of the calibration
        k = K * (focal / RADIUS) ** 2
        cx, cy = (shape[1] - 1) / 2 + axis[1], (shape[0] - 1) / 2 + axis[0]
        lens["distortion"] = gs.Calibration(shape[1], shape[0], focal, focal, cx, cy, (k, 0, 0, 0))
        at = displaced(y, x, shape, middle=axis)
    cam = camera(**lens)
    found, plan = mean_of(scene_of(picture, depth), cam)
    assert plan.find(DepthPlan) and plan.find(KernelSpace) and "optics.field" in plan.models
    wanted = points_summed(picture, depth, *at, cam.optics, axis or (0.0, 0.0))
    # predicted are up to 1.5e-3 rms of the field's kernels, of which maxima are four times; a frame of 24 rows varies
    # within a kernel
    error = (found - wanted)[INNER]
    assert np.sqrt(np.mean(error**2)) < 1.5e-3 and np.abs(error).max() < 6e-3 + CUBIC
    uniform = points_summed(picture, depth, *at, LENS)
    assert np.sqrt(np.mean((uniform - wanted)[INNER] ** 2)) > 5e-3


@pytest.mark.slow
def test_flat_fields_at_a_distance_are_the_sum_of_their_points():
    """A lens that displaces points shades flat fields, at a distance as in focus; coverage has no part in that."""
    shape, period = (20, 24), 48
    cam = camera(wavefront=Wavefront(seidel=(0.0, 0.3, 0.0, 0.0, 0.3)))
    depth = np.full(shape, LENS.object_distance)
    found, plan = mean_of(replace(scene_of(np.ones(shape), depth), border="edge"), cam)
    assert plan.find(DepthPlan)
    # a periodic world: light from beyond the frame is spread as at its edge
    pads = [(period - n) // 2 for n in shape]
    total, corner, tables = Sum(period, (period, period)), np.hypot(*shape) / 2, {}
    for y, x in np.ndindex(period, period):
        place = tuple(
            (min(max(p - pad, 0), n - 1) - (n - 1) / 2) / corner
            for p, n, pad in zip((y, x), shape, pads, strict=True)
        )
        if place not in tables:
            tables[place] = transfer(cam.optics, NM[0], PITCH, period, place, LENS.object_distance)
        total.add(1.0, y, x, *tables[place])
    wanted = total.frame[pads[0] : -pads[0], pads[1] : -pads[1]]
    assert wanted.std() > 2e-3
    # the plan keeps flat fields to 5e-4 rms; but its kernels end 11 samples away, half of this frame, and light beyond
    # counts: plans of less than 400 samples say that they cannot be judged. In 40 x 48 samples it is 8e-4
    error = found - wanted
    assert np.sqrt(np.mean(error**2)) < 5e-3
    assert np.sqrt(np.mean((wanted - 1) ** 2)) > 5e-2

"""Frames as renderers write them, with depth, through an OpenCV calibration: against rays through the pupil.

The world is a floor, boxes and a far wall. A renderer's file is its picture from the middle of the
pupil, with a distance at each sample. The truth shares nothing with it: rays from points of a pixel
go through points of the pupil and the plane in focus to the first surface that they meet. OpenCV
undistorts the pixels. Diffraction is of a circle in focus.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil

NM = np.array([540.0, 550.0, 560.0])
HEIGHT, WIDTH, MARGIN = 48, 64, 10  # [pixel]
PITCH, FOCUS = 5e-6, 2.0
LENS = Optics(2.8, 12e-3, object_distance=FOCUS, relative_illumination="none")
IMAGE = 1 / (1 / LENS.focal_length - 1 / FOCUS)  # [m] from the pupil to the sensor
FOCAL = IMAGE / PITCH  # [pixel]
AXIS = (WIDTH - 1) / 2 + 3.2, (HEIGHT - 1) / 2 - 2.4  # cx, cy
UNIT = (FOCAL / 32) ** 2  # of the coefficients: at 32 pixels from the axis
COEFFICIENTS = (
    -0.035 * UNIT,
    0.006 * UNIT**2,
    0.004 * UNIT**0.5,
    -0.003 * UNIT**0.5,
    -0.001 * UNIT**3,
)
MATRIX = np.array([[FOCAL, 0, AXIS[0]], [0, FOCAL, AXIS[1]], [0, 0, 1.0]])
WALL = 4.0  # [m]


@dataclass(frozen=True)
class Box:
    """Two corners [m]: x to the right, y down, z ahead; and the light of its surface."""

    low: tuple
    high: tuple
    light: float


def pixels(count, distance):
    """Length [m] of so many pixels at a distance."""
    return count * distance / FOCAL


BOXES = (
    Box((pixels(-22, 1.5), pixels(-4, 1.5), 1.5), (pixels(-9, 1.5), pixels(22, 1.5), 1.6), 0.35),
    Box((pixels(-6, 2.0), pixels(-9, 2.0), 2.0), (pixels(9, 2.0), pixels(16, 2.0), 2.2), 0.75),
    Box((pixels(14, 2.6), pixels(-14, 2.6), 2.6), (pixels(25, 2.6), pixels(14, 2.6), 2.8), 0.3),
)
HORIZON, HEIGHT_ABOVE = (
    4.0,
    0.04,
)  # row below the axis where the floor meets the wall [pixel]; height above it [m]
SLOPE = 1 / HEIGHT_ABOVE  # of 1 / Z over the slope of rays


def light_of(base, x, y, z, contrast):
    """A solid texture: waves of some 8 to 20 pixels."""
    u, v = x / z * FOCAL, y / z * FOCAL
    waves = np.sin(0.35 * u + 0.2 * v + 5 * z) + np.sin(0.45 * v - 0.25 * u + 3 * z)
    return base * (1 + contrast / 2 * waves)


def trace(start, slope, contrast):
    """Light and z of the first surface along rays start + z slope, (x, y) at z = 0 and per z, any shape."""
    x0, y0 = start
    sx, sy = slope
    nearest = np.full(np.broadcast(x0, sx).shape, WALL)
    base = np.full(nearest.shape, 0.85)
    # 1 = Z (1 / WALL - SLOPE HORIZON / FOCAL) + SLOPE Y
    below = 1 / WALL - SLOPE * HORIZON / FOCAL + SLOPE * sy
    z = (1 - SLOPE * y0) / np.where(below > 0, below, 1)
    floor = (below > 0) & (z > 0) & (z < nearest)
    nearest, base = np.where(floor, z, nearest), np.where(floor, 0.6, base)
    for box in BOXES:
        enter, leave = np.full(nearest.shape, box.low[2]), np.full(nearest.shape, box.high[2])
        for at, along, low, high in (
            (x0, sx, box.low[0], box.high[0]),
            (y0, sy, box.low[1], box.high[1]),
        ):
            along = np.where(along == 0, 1e-12, along)
            one, other = (low - at) / along, (high - at) / along
            enter = np.maximum(enter, np.minimum(one, other))
            leave = np.minimum(leave, np.maximum(one, other))
        hit = (enter < leave) & (enter > 0) & (enter < nearest)
        nearest, base = np.where(hit, enter, nearest), np.where(hit, box.light, base)
    x, y = x0 + nearest * sx, y0 + nearest * sy
    return light_of(base, x, y, nearest, contrast), nearest


def rendered(ratio, contrast, fine=32):
    """Picture and depth of a pinhole in the pupil's middle, with `ratio` samples a pixel and a margin.

    Light is the mean of fine x fine rays a sample, as of a box filter; distance is the distance of the middle.
    Edges along rows or columns are rounded to 1 / fine: with 32, 0.6 of a half well changes by 1/64 x 0.3 at most.
    """
    rows, cols = ratio * (HEIGHT + 2 * MARGIN), ratio * (WIDTH + 2 * MARGIN)

    def slopes(step):
        y = (np.arange(rows * step) + 0.5) / step / ratio - MARGIN - 0.5 - AXIS[1]
        x = (np.arange(cols * step) + 0.5) / step / ratio - MARGIN - 0.5 - AXIS[0]
        return x[None] / FOCAL, y[:, None] / FOCAL

    middle = (0.0, 0.0)
    x, y = slopes(fine)
    light = [  # by rows of samples: their arrays fit into a processor's cache
        trace(middle, np.broadcast_arrays(x, part), contrast)[0].reshape(fine, cols, fine)
        for part in np.split(y, rows)
    ]
    _, depth = trace(middle, np.broadcast_arrays(*slopes(1)), contrast)
    return np.array([part.mean(axis=(0, 2)) for part in light]), depth


def pupil_points(pupil, count):
    """Points of the pupil (y, x) by Hammersley's set, in radii, as the image has its axes."""
    number = np.arange(count)
    bits = sum(((number >> k) & 1) / 2 ** (k + 1) for k in range(20))
    y, x = 2 * (number + 0.5) / count - 1, 2 * bits - 1
    is_open = np.hypot(y, x) <= 1
    if pupil.blades:
        turns = pupil.rotation + 2 * np.pi * np.arange(pupil.blades + 1) / pupil.blades
        cy, cx = np.sin(turns), np.cos(turns)
        for n in range(pupil.blades):
            across = (cx[n + 1] - cx[n]) * (y - cy[n]) - (cy[n + 1] - cy[n]) * (x - cx[n])
            is_open &= across >= 0
    return np.stack([y[is_open], x[is_open]], axis=1)


def undistorted(places, coefficients):
    """Slopes (x, y) of the pinhole's rays that OpenCV puts at places (x, y) [pixel], (n, 2): found step by step."""
    wanted, here = (places - AXIS) / FOCAL, np.zeros(3)
    slopes = wanted
    for _ in range(60):
        rays = np.column_stack([slopes, np.ones(len(slopes))])[:, None]
        found = cv2.projectPoints(rays, here, here, np.eye(3), np.array(coefficients, float))[0]
        error = wanted - found.reshape(-1, 2)
        slopes = slopes + error
        if np.abs(error).max() * FOCAL < 1e-6:
            return slopes
    raise AssertionError("no place is found")


def seen_by_rays(optics, contrast, coefficients=COEFFICIENTS, fine=3, count=700, around=8):
    """Light of each pixel, (HEIGHT, WIDTH), float64."""
    y, x = (
        (np.arange(-around * fine, (n + around) * fine) + 0.5) / fine - 0.5 for n in (HEIGHT, WIDTH)
    )
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    sx, sy = undistorted(places, coefficients).T.reshape(2, len(y), len(x))
    along = [
        np.gradient(one, axis=axis) for axis in (1, 0) for one in (sx, sy)
    ]  # by column, by row
    # a flat field is the sum of its points: area of the pinhole's picture to a pixel's
    area = np.abs(along[0] * along[3] - along[1] * along[2]) * (FOCAL * fine) ** 2
    total, points = 0.0, pupil_points(optics.pupil, count)
    aperture = optics.focal_length / optics.f_number  # [m]
    # each ray starts elsewhere within its part of a pixel
    jitter = (np.outer(np.arange(len(points)), (0.8191725134, 0.6710436067)) + 0.5) % 1 - 0.5
    for (v, u), (down, across) in zip(points, jitter, strict=True):
        # a point farther than the focus is inverted in gpusim's axes of the pupil
        x0, y0 = -u * aperture / 2, -v * aperture / 2
        x = sx + across * along[0] + down * along[2] - x0 / FOCUS
        y = sy + across * along[1] + down * along[3] - y0 / FOCUS
        total = total + trace((x0, y0), (x, y), contrast)[0]
    seen = total / len(points) * area
    q = NM[1] * 1e-9 * optics.working_f_number / PITCH
    fy, fx = (np.fft.fftfreq(n, 1 / fine) for n in seen.shape)
    s = np.minimum(np.hypot(fy[:, None], fx) * q, 1)
    passed = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    # mean over pixels: of fine x fine points
    blurred = np.fft.ifft2(np.fft.fft2(seen) * passed).real
    means = blurred.reshape(HEIGHT + 2 * around, fine, WIDTH + 2 * around, fine).mean(axis=(1, 3))
    return means[around:-around, around:-around]


def camera(optics=LENS, coefficients=COEFFICIENTS):
    own = gs.open_camera("mono")
    calibration = gs.Calibration.of(MATRIX, list(coefficients), (WIDTH, HEIGHT))
    sensor = replace(own.sensor, pixel_pitch=PITCH, fill_factor=1.0)
    return replace(own, optics=replace(optics, distortion=calibration), sensor=sensor)


def scene_of(ratio, contrast):
    picture, depth = rendered(ratio, contrast)
    cube = gs.Cube(NM, (1e15 * picture * np.ones((3, 1, 1))).astype(np.float32))
    light = gs.Spectrum(NM, np.ones(3), "unit")
    return gs.Scene(
        cube, light, depth=depth, border="scene", margin=ratio * MARGIN, samples_per_pixel=ratio
    )


def well_errors(scene, contrast=0.2, optics=LENS, coefficients=COEFFICIENTS, device="opencl:0"):
    """Frame minus truth over the full well, if light 1 is half of it; and the error that the report predicts."""
    cam = camera(optics, coefficients)
    simulator = gs.Simulator(cam, device=device, tolerance="video")
    exposure = simulator.expose(scene, 1.0)
    unit = 1e15 * exposure.plan.weights.sum()
    mean = np.asarray(simulator.device.numpy(exposure.mean), np.float64) / unit
    error = (mean - seen_by_rays(optics, contrast, coefficients)) / 2
    account = exposure.plan.account.at(exposure.exposure_time)
    read = cam.sensor.read_sigma
    sigma = np.sqrt(np.maximum(mean * unit, 1) + read**2) / unit / 2
    assert not exposure.plan.verdict.is_met
    return error, account.total.max_sigma * float(sigma.max())


HEXAGON = replace(LENS, pupil=Pupil(6, 0, 0.2))
FAST = replace(LENS, f_number=2.0)
# With one sample a pixel edges within a sample are as wide as it: a variance of up to 1/4 sample^2 more changes an edge
# of 0.6 of a half well and 2 pixels wide by 0.3 / 8 / 4 of the well, and again where the lens displaces it
LIMITS = {1: 0.03, 2: 0.01, 3: 0.01}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ratio", "optics", "coefficients"),
    [
        pytest.param(2, LENS, COEFFICIENTS, id="calibrated"),
        # 1.1 %: below the nearest box, where the floor's light changes most within the samples that unmix it
        pytest.param(2, LENS, (0.0,) * 5, id="pinhole", marks=pytest.mark.slow),
        pytest.param(2, HEXAGON, COEFFICIENTS, id="six blades", marks=pytest.mark.slow),
        pytest.param(2, FAST, COEFFICIENTS, id="f/2", marks=pytest.mark.slow),
        pytest.param(1, LENS, COEFFICIENTS, id="one sample a pixel", marks=pytest.mark.slow),
        pytest.param(3, LENS, COEFFICIENTS, id="three", marks=pytest.mark.slow),
    ],
)
def test_rendered_frames_are_those_of_rays(ratio, optics, coefficients):
    """1 % of the full well everywhere, edges of depth between samples included; never more than predicted."""
    error, predicted = well_errors(scene_of(ratio, 0.2), 0.2, optics, coefficients)
    assert np.abs(error).max() < predicted
    assert np.abs(error).max() < LIMITS[ratio] + 0.001 * (not any(coefficients))
    assert np.sqrt(np.mean(error**2)) < LIMITS[ratio] / 5


@pytest.mark.slow  # a control: what the test before would find
def test_without_depth_or_calibration_frames_are_wrong():
    """So that the test above can fail: all in focus, and through a pinhole."""
    scene = scene_of(2, 0.2)
    truth = seen_by_rays(LENS, 0.2)
    for other in (replace(scene, depth=np.full(scene.depth.shape, FOCUS)), scene):
        cam = camera(coefficients=COEFFICIENTS if other is not scene else (0.0,) * 5)
        exposure = gs.Simulator(cam, device="opencl:0").expose(other, 1.0)
        mean = np.asarray(exposure.mean, np.float64) / (1e15 * exposure.plan.weights.sum())
        assert np.abs(mean - truth).max() / 2 > 0.025


@pytest.mark.parametrize("along", [pytest.param("axis", marks=pytest.mark.slow), "ray"])
def test_files_of_renderers(tmp_path, along):
    """An EXR with distances to the image plane (Isaac Sim, Blender) or to the camera (Mitsuba, Isaac Sim)."""
    import OpenEXR

    picture, depth = rendered(2, 0.2, fine=1)  # light is not looked at
    rows, cols = picture.shape
    fov = 2 * np.arctan(cols / 2 / (2 * FOCAL))
    y, x = (np.arange(n) + 0.5 - n / 2 for n in (rows, cols))
    rays = np.sqrt(1 + (x / 2 / FOCAL) ** 2 + (y[:, None] / 2 / FOCAL) ** 2)
    channels = {f"S0.{nm:.0f},000000nm": (1e15 * picture).astype(np.float32) for nm in NM}
    channels["Z"] = (depth * (rays if along == "ray" else 1)).astype(np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(tmp_path / "frame.exr"))
    scene = gs.open_scene(tmp_path / "frame.exr", depth=along, fov=fov)
    assert np.abs(scene.depth / depth - 1).max() < 1e-6
    assert scene.content.shape == picture.shape

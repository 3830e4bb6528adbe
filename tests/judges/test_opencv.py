"""Calibrated cameras against OpenCV: where points land, what undistorts, and files of it, ROS and Kalibr."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from cameras import PHONE, camera_with
from devices import ALL_KINDS, KINDS
from refusals import refused

import gpusim as gs
from gpusim.domain.distortion import ideal
from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.kernels.optics.distort_ref import _lagrange
from gpusim.optics.geometry import distortion_grid

PITCH = 1.4e-6
COUNTS = (0, 4, 5, 8, 12, 14)
HERE = np.zeros(3)  # the camera's place and turn
MOST = 0.01  # [pixel], what is asked for


def random_camera(random, fisheye=False, count=4):
    """Size, camera matrix and coefficients; principal point up to 5 % of the frame off its middle, fy up to 3 % fx."""
    width, height = (int(n) for n in random.integers(120, 700, 2))
    half = np.hypot(width, height) / 2
    # a fisheye to 35 .. 70 degrees at the corner, others to 20 .. 40
    fx = (
        half / np.radians(random.uniform(35, 70))
        if fisheye
        else half / np.tan(np.radians(random.uniform(20, 40)))
    )
    move = 0.02 if fisheye else 0.05
    matrix = np.array(
        [
            [fx, 0, (width - 1) / 2 + random.uniform(-move, move) * width],
            [
                0,
                fx * random.uniform(0.97, 1.03),
                (height - 1) / 2 + random.uniform(-move, move) * height,
            ],
            [0, 0, 1],
        ]
    )
    if fisheye:
        return (width, height), matrix, random.uniform(-1, 1, 4) * (0.05, 0.02, 0.005, 0.001)
    limits = [0.2, 0.05, 3e-3, 3e-3, 0.01, 0.05, 0.02, 0.01, 3e-3, 3e-3, 3e-3, 3e-3, 0.05, 0.05]
    return (width, height), matrix, (random.uniform(-1, 1, 14) * limits)[:count]


def projected(points, matrix, coefficients, fisheye):
    """Where OpenCV puts points of the pinhole's picture, (n, 2) -> (n, 2) [pixel]."""
    rays = np.column_stack(
        [(points - matrix[:2, 2]) / matrix[[0, 1], [0, 1]], np.ones(len(points))]
    )
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    coefficients = np.asarray(coefficients, float) if len(coefficients) else np.zeros(4)
    return project(rays[:, None], HERE, HERE, matrix, coefficients)[0].reshape(-1, 2)


@pytest.mark.parametrize("model", [*COUNTS, "fisheye"])
def test_every_pixel_looks_where_opencv_says(model):
    """Random cameras: each pixel's place in the pinhole's picture, taken from the grid, comes back to the pixel.

    The grid keeps 1e-3 of a sample (2.5 times at the worst, see test_geometry), and the mapping stretches by less than
    2 here: half of MOST.
    """
    random, fisheye, seen = np.random.default_rng(5), model == "fisheye", 0
    for _ in range(12):
        size, matrix, coefficients = random_camera(random, fisheye, 4 if fisheye else model)
        lens = gs.Calibration.of(matrix, coefficients, size, fisheye).fit_to_frame(
            size[::-1], PITCH
        )
        try:
            grid = distortion_grid(lens, size[::-1], PITCH)
        except OutOfRange as error:
            assert "turns back" in str(error) or "folds over" in str(error)  # see below
            continue
        rows, cols = np.indices(size[::-1])
        moved = _lagrange(grid.nodes, size[::-1], np.arange(size[1]), np.arange(size[0]))
        places = np.stack([cols + moved[1], rows + moved[0]], -1)[::7, ::5].reshape(-1, 2)
        wanted = np.stack([cols, rows], -1)[::7, ::5].reshape(-1, 2)
        assert np.abs(projected(places, matrix, coefficients, fisheye) - wanted).max() < MOST / 2
        seen += 1
    assert seen >= 9


def test_what_is_refused_cannot_be_undone():
    """A barrel that turns back before the corner: OpenCV's own picture of the diagonal has its end there."""
    matrix = np.array([[300.0, 0, 319.5], [0, 300, 239.5], [0, 0, 1]])
    line = np.linspace(0, 4, 40001)[:, None] * (320, 240) + matrix[:2, 2]
    for k1, folds in ((-0.05, False), (-0.3, True)):
        height = np.hypot(*(projected(line, matrix, [k1, 0, 0, 0], False) - matrix[:2, 2]).T)
        end = height[: int(np.argmax(np.diff(height) < 0)) + 1].max()
        assert (end < 400) == folds  # pixels from the middle to the corner
        lens = gs.Calibration.of(matrix, [k1, 0, 0, 0], (640, 480)).fit_to_frame((480, 640), PITCH)
        if folds:
            with refused(
                f"with the image at {end / 300:.4f}"[:-1], "corner, 1.33", error=OutOfRange
            ):
                distortion_grid(lens, (480, 640), PITCH)
        else:
            distortion_grid(lens, (480, 640), PITCH)


def test_the_derivative_is_that_of_opencv():
    """Central differences of cv2.projectPoints at h = 1e-4: h^2/6 of third derivatives (< 10), 1e-13 / h rounding."""
    random, h = np.random.default_rng(6), 1e-4
    for fisheye, count in ((False, 14), (True, 4)):
        _, _, coefficients = random_camera(random, fisheye, count)
        lens = gs.Calibration.of(np.eye(3), coefficients, (1, 1), fisheye).lens
        at = random.uniform(-0.5, 0.5, (300, 2))
        steps = [
            (
                projected(at + step, np.eye(3), coefficients, fisheye)
                - projected(at - step, np.eye(3), coefficients, fisheye)
            )
            / (2 * h)
            for step in ((h, 0), (0, h))
        ]
        wanted = steps[0][:, 0], steps[1][:, 0], steps[0][:, 1], steps[1][:, 1]
        assert np.abs(np.subtract(lens.derivative(*at.T), wanted)).max() < 1e-7


# ---- frames


SIZE = (240, 180)
MATRIX = np.array([[210.0, 0, 126.5], [0, 214.0, 84.25], [0, 0, 1]])
LENSES = {
    "Brown-Conrady": ((-0.25, 0.07, 2e-3, -1e-3, -0.01), False),
    "rational": ((0.3, 0.05, 1e-3, 1e-3, 0.01, 0.5, 0.1, 0.02), False),
    "thin prism and tilt": (
        (-0.2, 0.05, 0, 0, 0, 0, 0, 0, 3e-3, -1e-3, -2e-3, 1e-3, 0.03, -0.02),
        False,
    ),
    "fisheye": ((0.02, -0.01, 2e-3, -1e-4), True),
}


def exposed(device, planes, calibration, **optics):
    """Mean electrons of a monochrome camera without blur, float64."""
    camera = camera_with(
        gs.open_camera("mono"), optics={"model": "none", "distortion": calibration, **optics}
    )
    scene = gs.Scene(
        gs.Cube(np.linspace(420.0, 680.0, 4), np.repeat(planes[None].astype(np.float32), 4, 0)),
        gs.chart("flat").illuminant,
    )
    simulator = gs.Simulator(camera, device=device)
    return np.asarray(simulator.device.numpy(simulator.expose(scene, 0.01).mean), np.float64)


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("scale", [1, 2])
def test_points_land_where_opencv_puts_them(device, lens, scale):
    """Gaussian spots of the pinhole's picture: their centroids in the frame, at the calibration's resolution and twice.

    Sigma 2.5 pixels: the mapping bends a spot, which moves its centroid by half its second derivative times sigma^2:
    taken from OpenCV too, as the mean of the spot's points where they land, weighted by their light.
    """
    coefficients, fisheye = LENSES[lens]
    matrix = np.diag([scale, scale, 1.0]) @ MATRIX
    matrix[:2, 2] += (scale - 1) / 2  # the middle of the first pixel is half a pixel from the edge
    size, sigma = (scale * SIZE[0], scale * SIZE[1]), 2.5
    middles = [(60 * scale, 45 * scale), (150 * scale, 120 * scale), (200 * scale, 40 * scale)]
    y, x = np.indices(size[::-1])
    spots = [np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma**2)) for cx, cy in middles]
    frame = exposed(
        device,
        np.sum(spots, 0),
        gs.Calibration.of(MATRIX, coefficients, SIZE, fisheye),
        relative_illumination="none",
    )
    for spot in spots:
        near = spot > 1e-8
        lands = projected(
            np.stack([x[near], y[near]], -1).astype(float), matrix, coefficients, fisheye
        )
        wanted = spot[near] @ lands / spot[near].sum()
        rows, cols = np.rint(wanted).astype(int)[::-1]
        window = np.s_[rows - 15 : rows + 16, cols - 15 : cols + 16]
        light = frame[window]
        found = np.array([(light * x[window]).sum(), (light * y[window]).sum()]) / light.sum()
        assert np.abs(found - wanted).max() < MOST


@pytest.mark.parametrize("device", KINDS)
def test_undistort_gives_the_scene_back(device):
    """cv2.undistort, bilinear on 1/32 pixel, of waves of 40 pixels or more.

    Places rounded to 1/64 of a pixel times a slope of 2 pi / 40 x 0.4, and a bilinear's (2 pi / 40)^2 / 8 x 0.4: 2.5e-3
    and 1.2e-3 of the mean; the frame's own cubic adds 1e-4.
    """
    coefficients, _ = LENSES["Brown-Conrady"]
    y, x = np.indices(SIZE[::-1])
    scene = 1 + 0.4 * np.sin(2 * np.pi * x / 40) * np.cos(2 * np.pi * y / 60)
    frame = exposed(
        device, scene, gs.Calibration.of(MATRIX, coefficients, SIZE), relative_illumination="none"
    )
    flat = exposed(
        device,
        np.ones_like(scene),
        gs.Calibration.of(MATRIX, coefficients, SIZE),
        relative_illumination="none",
    )
    back = cv2.undistort(frame / flat, MATRIX, np.array(coefficients))
    inner = np.s_[12:-12, 12:-12]
    assert np.abs(back - scene)[inner].max() < 5e-3


@pytest.mark.parametrize("lens", ["Brown-Conrady", "fisheye"])
def test_flux_and_cos4_follow_the_calibration(lens):
    """An even scene: cos^4 of OpenCV's own field angle, and its area of the pinhole's picture per pixel.

    Differences over a pixel err by their third derivative, 1e-5 at most here, and float32 counts by 1e-6.
    """
    coefficients, fisheye = LENSES[lens]
    frame = exposed(
        "numpy", np.ones(SIZE[::-1]), gs.Calibration.of(MATRIX, coefficients, SIZE, fisheye)
    )
    lens = gs.Calibration.of(MATRIX, coefficients, SIZE, fisheye).fit_to_frame(SIZE[::-1], 1.0)

    def rays(x, y):
        """Tangents whose image OpenCV puts at (x, y): found here, judged by it."""
        offset = (x - (SIZE[0] - 1) / 2) / lens.radius, (y - (SIZE[1] - 1) / 2) / lens.radius
        found = np.stack(lens.normalise(*ideal(lens, *offset)), -1)
        pixels = (found * MATRIX[[0, 1], [0, 1]] + MATRIX[:2, 2]).reshape(-1, 2)
        wanted = np.stack([x, y], -1).reshape(-1, 2)
        assert np.abs(projected(pixels, MATRIX, coefficients, fisheye) - wanted).max() < 1e-9
        return found

    y, x = np.indices(SIZE[::-1]).astype(float)
    along, down = rays(x + 0.5, y) - rays(x - 0.5, y), rays(x, y + 0.5) - rays(x, y - 0.5)
    area = (
        np.abs(along[..., 0] * down[..., 1] - along[..., 1] * down[..., 0])
        * MATRIX[0, 0]
        * MATRIX[1, 1]
    )
    wanted = area * (1 + (rays(x, y) ** 2).sum(-1)) ** -2
    at = np.unravel_index(np.argmax(wanted), wanted.shape)
    assert np.abs(frame / frame[at] - wanted / wanted[at]).max() < 1e-4


def test_a_frame_of_another_shape_is_refused():
    calibration = gs.Calibration.of(MATRIX, None, SIZE)
    for size in ((480, 360), (160, 120), (81, 61)):
        assert calibration.fit_to_frame(size[::-1], PITCH).radius == pytest.approx(
            210 * size[0] / 240 * PITCH, rel=1e-12
        )
    with refused("320 x 180", "240 x 180", error=OutOfRange):
        exposed("numpy", np.ones((180, 320)), calibration)


def test_a_scene_of_another_field_of_view_is_said():
    camera = camera_with(
        PHONE, optics={"distortion": gs.Calibration.of(MATRIX, [-0.1, 0, 0, 0], SIZE)}
    )
    # of the pinhole: 2 atan(120 / 210) = 59.49 deg
    for degrees, said in ((59.49, False), (50.0, True)):
        scene = replace(gs.chart("flat", size=SIZE), fov=np.radians(degrees))
        left_out = " ".join(gs.Simulator(camera, device="numpy").plan(scene).left_out)
        assert ("59.49 deg" in left_out) == said


# ---- files


TRUTH = gs.Calibration(
    752, 480, 461.629, 460.152, 362.68, 246.049, (-0.277, 0.0671, 8.7e-4, 1.1e-4, 0.0)
)
ROS = """image_width: 752
image_height: 480
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: [461.629, 0.0, 362.68, 0.0, 460.152, 246.049, 0.0, 0.0, 1.0]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.277, 0.0671, 0.00087, 0.00011, 0.0]
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
projection_matrix:
  rows: 3
  cols: 4
  data: [400.0, 0.0, 360.0, 0.0, 0.0, 410.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
MESSAGE = """header:
  seq: 4
  frame_id: "camera"
height: 480
width: 752
distortion_model: "plumb_bob"
d: [-0.277, 0.0671, 0.00087, 0.00011, 0.0]
k: [461.629, 0.0, 362.68, 0.0, 460.152, 246.049, 0.0, 0.0, 1.0]
binning_x: 0
binning_y: 0
roi:
  x_offset: 0
  y_offset: 0
  height: 0
  width: 0
  do_rectify: False
---
"""
KALIBR = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.277, 0.0671, 0.00087, 0.00011]
  distortion_model: radtan
  intrinsics: [461.629, 460.152, 362.68, 246.049]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.01, 0.02, -0.03, 0.004]
  distortion_model: equidistant
  intrinsics: [190.978, 190.973, 254.932, 256.897]
  resolution: [512, 512]
"""


def written(tmp_path, text, name="a.yaml"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


@pytest.mark.parametrize(
    "text",
    [ROS, MESSAGE, MESSAGE.replace("d:", "D:").replace("k:", "K:")],
    ids=["camera_info", "ROS 2's message", "ROS 1's"],
)
def test_files_of_ros(tmp_path, text):
    assert gs.read_calibration(written(tmp_path, text)) == TRUTH
    fisheye = text.replace("plumb_bob", "equidistant").replace(", 0.00011, 0.0]", ", 0.00011]")
    assert gs.read_calibration(written(tmp_path, fisheye)) == replace(
        TRUTH, coefficients=TRUTH.coefficients[:4], fisheye=True
    )
    rational = text.replace("plumb_bob", "rational_polynomial").replace(
        ", 0.0]\n", ", 0.0, 0.1, 0.2, 0.3]\n", 1
    )
    if "camera_matrix" not in text:
        assert gs.read_calibration(written(tmp_path, rational)).coefficients[5:] == (0.1, 0.2, 0.3)


def test_files_of_kalibr(tmp_path):
    path = written(tmp_path, KALIBR)
    assert gs.read_calibration(path, "cam0") == replace(TRUTH, coefficients=TRUTH.coefficients[:4])
    assert gs.read_calibration(path, "cam1") == gs.Calibration(
        512, 512, 190.978, 190.973, 254.932, 256.897, (-0.01, 0.02, -0.03, 0.004), fisheye=True
    )
    with refused(path, "2 cameras", 'camera = "cam0"', error=BadFile):
        gs.read_calibration(path)
    with refused(path, "'cam9'", error=BadFile):
        gs.read_calibration(path, "cam9")
    omni = KALIBR.replace("camera_model: pinhole", "camera_model: omni").replace(
        "[461.629,", "[1.2, 461.629,"
    )
    with refused("omni", "pinhole-equi", error=BadFile):
        gs.read_calibration(written(tmp_path, omni), "cam0")


@pytest.mark.parametrize("suffix", ["yaml", "json", "xml"])
@pytest.mark.parametrize("count", [5, 14])
def test_files_that_opencv_writes(tmp_path, suffix, count):
    path = tmp_path / f"camera.{suffix}"
    size, matrix, coefficients = random_camera(np.random.default_rng(8), count=count)
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (
        ("calibration_time", "Tue 24 Nov 2026 12:00:00"),
        ("image_width", size[0]),
        ("image_height", size[1]),
        ("flags", 0),
        ("camera_matrix", matrix),
        ("distortion_coefficients", coefficients[:, None]),
    ):
        file.write(key, value)
    file.release()
    assert gs.read_calibration(path) == gs.Calibration.of(matrix, coefficients, size)
    if suffix == "yaml":  # as OpenCV 2 and 3 wrote it
        assert gs.read_calibration(
            written(tmp_path, path.read_text().replace("%YAML 1.2", "%YAML:1.0"))
        ) == gs.Calibration.of(matrix, coefficients, size)


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("image_width: 752\n", "", ["image_width and image_height"]),
        ("plumb_bob", "bowl", ["distortion_model", "'bowl'", "rational_polynomial"]),
        ("[461.629, 0.0,", "[461.629, 47.0,", ["skew", "0.1 fx"]),
        ("[461.629,", "[-461.629,", ["fx", "-461.629"]),
        ("362.68", "962.68", ["cx", "962.68"]),
        ("[461.629,", "[.nan,", ["camera_matrix", "numbers"]),
        ("-0.277, ", "", []),
        ("-0.277, 0.0671, ", "", ["3 coefficients", "4, 5, 8, 12 or 14"]),
        ("data: [-0.277", "data: [a", ["distortion_coefficients", "wanted numbers"]),
        ("camera_matrix", "matrix", ["camera_matrix", "intrinsics"]),
        ("image_width: 752", "image_width: [", ["not YAML"]),
        (ROS, "- 1\n", ["wanted keys"]),
        (ROS, "", ["wanted keys"]),
        (ROS, "[" * 50000, ["not YAML"]),
        ("rows", "!!python/object/apply:os.system [ls]: 1\n  rows", ["not YAML"]),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path, old, new, parts):
    path = written(tmp_path, ROS.replace(old, new, 1))
    if not parts:  # four of five coefficients are a calibration, too
        assert len(gs.read_calibration(path).coefficients) == 4
        return
    with refused(path, *parts, error=BadFile):
        gs.read_calibration(path)


@pytest.mark.parametrize(
    ("key", "value"), [("x_offset: 0", "x_offset: 8"), ("binning_x: 0", "binning_x: 2")]
)
def test_parts_of_frames_and_binned_ones_are_refused(tmp_path, key, value):
    with refused("wanted", error=BadFile):
        gs.read_calibration(written(tmp_path, MESSAGE.replace(key, value)))


def test_camera_files_take_calibrations(tmp_path):
    """As a file, as one camera of several, and as numbers; the focal length follows unless it is given."""
    written(tmp_path, ROS, "camera_info.yaml")
    written(tmp_path, KALIBR, "camchain.yaml")
    optics = (
        "base = 'none'\n[optics]\nf_number = 2\n{}\n"
        "[sensor]\npixel_pitch_um = 6\nqe = 'mt9v024'\nfull_well_e = 9000\nbits = 10"
    )

    def opened(lines):
        return gs.open_camera(written(tmp_path, optics.format(lines), "own.toml")).optics

    plain = opened("calibration = 'camera_info.yaml'")
    assert plain.distortion == TRUTH
    assert plain.focal_length == pytest.approx(461.629 * 6e-6, rel=1e-12)
    near = opened("calibration = 'camera_info.yaml'\nobject_distance_m = 0.1")
    assert near.image_distance == pytest.approx(461.629 * 6e-6, rel=1e-12)
    assert opened("calibration = 'camera_info.yaml'\nfocal_length_mm = 2.8").focal_length == 2.8e-3
    assert opened("calibration = {file = 'camchain.yaml', camera = 'cam1'}").distortion.fisheye
    numbers = "width = 752, height = 480, fx = 461.629, fy = 460.152, cx = 362.68, cy = 246.049, "
    assert (
        opened(
            f"calibration = {{{numbers}k1 = -0.277, k2 = 0.0671, p1 = 8.7e-4, p2 = 1.1e-4, k3 = 0.0}}"
        ).distortion
        == TRUTH
    )
    assert opened(f"calibration = {{{numbers}tau_y = 0.1}}").distortion.coefficients == (
        0.0,
    ) * 13 + (0.1,)
    assert opened(f"calibration = {{{numbers}fisheye = true, k4 = 0.1}}").distortion == replace(
        TRUTH, coefficients=(0.0, 0.0, 0.0, 0.1), fisheye=True
    )
    for lines, parts in (
        (f"calibration = {{{numbers}k9 = 1}}", ["calibration", "tau_y"]),
        ("calibration = {fx = 1}", ["calibration", "width, height"]),
        ("calibration = 3", ["camera_info.yaml"]),
        ("calibration = 'none.yaml'", ["no such file"]),
        ("calibration = 'camchain.yaml'", ["2 cameras"]),
        ("", ["focal_length_mm"]),
        (
            "calibration = 'camera_info.yaml'\ndistortion = {k1 = 0, k2 = 0, radius_mm = 1}",
            ["calibration and distortion"],
        ),
    ):
        with refused(*parts, error=BadFile):
            opened(lines)


@pytest.mark.parametrize(
    ("matrix", "coefficients", "size", "parts"),
    [
        (np.eye(2), None, (4, 4), ["3 x 3"]),
        (np.eye(3), "abc", (4, 4), ["numbers"]),
        (np.eye(3), None, 4, ["size"]),
        (np.eye(3), [1, 2], (4, 4), ["2 coefficients"]),
        (np.eye(3), [np.nan] * 4, (4, 4), ["k1", "finite"]),
        (np.eye(3), [0.0] * 12 + [2.0, 0], (4, 4), ["tau_x", "1.5"]),
        (np.eye(3), None, (0, 4), ["width"]),
    ],
)
def test_arrays_that_are_no_calibration(matrix, coefficients, size, parts):
    with refused(*parts, error=(BadData, OutOfRange)):
        gs.Calibration.of(matrix, coefficients, size)


def test_a_calibration_that_cv2_made(tmp_path):
    """cv2.calibrateCamera on views of a board: what it returns goes in as it is, and reprojects as it does there."""
    random, (size, matrix, coefficients) = (
        np.random.default_rng(9),
        random_camera(np.random.default_rng(3), count=5),
    )
    board = (
        np.stack([*np.mgrid[-4:5, -3:4] * 0.05, np.zeros((9, 7))], -1)
        .reshape(-1, 3)
        .astype(np.float32)
    )
    views = [
        cv2.projectPoints(
            board, random.uniform(-0.4, 0.4, 3), np.array([0, 0, 0.9]), matrix, coefficients
        )[0]
        for _ in range(8)
    ]
    _, found, distortion, _, _ = cv2.calibrateCamera(
        [board] * 8, [view.astype(np.float32) for view in views], size, None, None
    )
    lens = gs.Calibration.of(found, distortion, size).fit_to_frame(size[::-1], PITCH)
    pixels = random.uniform(0.3, 0.7, (50, 2)) * size
    x, y = ((pixels - (np.array(size) - 1) / 2) * PITCH / lens.radius).T
    rays = np.column_stack([*lens.normalise(*ideal(lens, x, y)), np.ones(50)])
    assert (
        np.abs(cv2.projectPoints(rays, HERE, HERE, found, distortion)[0][:, 0] - pixels).max()
        < 1e-9
    )
    path = tmp_path / "a.json"
    path.write_text(
        json.dumps(
            {
                "image_width": size[0],
                "image_height": size[1],
                "K": found.tolist(),
                "D": distortion.tolist(),
            }
        )
    )
    assert gs.read_calibration(path) == gs.Calibration.of(found, distortion, size)

"""Calibrations as other programs write them: where points land, by OpenCV or by the formula of the program.

A reader and the chain of positions are judged together: the picture of a pinhole at a pixel is distorted by the
product's model and compared with the pixel of the judge. Both compute in float64; 1e-3 pixel is asked for, and 1e-6
is far above rounding.
"""

import json

import cv2
import numpy as np
import pytest
from refusals import refused

import gpusim as gs
from gpusim.domain.errors import BadFile
from gpusim.kernels.optics.distort_ref import _lagrange
from gpusim.optics.geometry import distortion_grid

SIZE = (1640, 1232)
FX, FY, CX, CY = 804.0, 804.7, 871.2, 597.4
FISHEYE = (0.0175, -0.0317, 0.0036, -0.00072)
FIVE = (-0.21, 0.05, 1e-3, -7e-4, 0.004)
EIGHT = (*FIVE, 0.01, -0.004, 0.0005)
K = f"[{FX}, 0.0, {CX}, 0.0, {FY}, {CY}, 0.0, 0.0, 1.0]"
CLOSE = 1e-6  # [pixel]


def rays(count=300, reach=0.7):
    return np.random.default_rng(2).uniform(-reach, reach, (count, 2))


def pixels(calibration, points):
    """Where the product images rays, at the resolution of the calibration, as OpenCV counts pixels."""
    pitch, (width, height) = 1e-6, (calibration.width, calibration.height)
    framed = calibration.fit_to_frame((height, width), pitch)
    x, y = framed.distort(*framed.denormalise(*points.T))
    unit = framed.radius / pitch
    return np.stack([x * unit + width / 2 - 0.5, y * unit + height / 2 - 0.5], -1)


def matrix(skew=0.0):
    return np.array([[FX, skew, CX], [0, FY, CY], [0, 0, 1]])


def by_opencv(points, coefficients=(), fisheye=False, skew=0.0):
    whole, none = np.column_stack([points, np.ones(len(points))])[:, None], np.zeros(3)
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    given = np.array(coefficients or (0.0,) * 4, float)
    if fisheye:
        return project(whole, none, none, matrix(), given, alpha=skew / FX)[0].reshape(-1, 2)
    return project(whole, none, none, matrix(), given)[0].reshape(-1, 2)


def by_formula(points, coefficients, skew):
    """K times the distorted position of Brown and Conrady."""
    x, y = points.T
    k1, k2, p1, p2, k3 = coefficients
    q = x * x + y * y
    radial = 1 + k1 * q + k2 * q**2 + k3 * q**3
    u = x * radial + 2 * p1 * x * y + p2 * (q + 2 * x * x)
    v = y * radial + p1 * (q + 2 * y * y) + 2 * p2 * x * y
    return np.stack([FX * u + skew * v + CX, FY * v + CY], -1)


def read(tmp_path, text, name="a.yaml", camera=None):
    (tmp_path / name).write_text(text)
    return gs.read_calibration(tmp_path / name, camera)


def info(model, numbers, key="distortion_model", more="", skew=0.0):
    """camera_calibration's file of ROS."""
    data = ", ".join(map(str, numbers))
    return (
        f"image_width: {SIZE[0]}\nimage_height: {SIZE[1]}\ncamera_name: test\n"
        f"camera_matrix: {{rows: 3, cols: 3, data: {K.replace('0.0', str(skew), 1)}}}\n{key}: {model}\n"
        f"distortion_coefficients: {{rows: 1, cols: {len(numbers)}, data: [{data}]}}\n{more}"
    )


ROS = {  # text, fisheye, coefficients for OpenCV
    "plumb_bob": (info("plumb_bob", FIVE), False, FIVE),
    "four of plumb_bob": (info("plumb_bob", FIVE[:4]), False, FIVE[:4]),
    "eight of plumb_bob": (info("plumb_bob", EIGHT), False, EIGHT),
    "rational_polynomial": (info("rational_polynomial", EIGHT), False, EIGHT),
    "five of rational_polynomial": (info("rational_polynomial", FIVE), False, FIVE),
    "rational of Azure Kinect": (info("rational_polynomial", (*EIGHT, 0.0)), False, EIGHT),
    "thin_prism": (
        info("thin_prism", (*EIGHT, 1e-3, 2e-4, -1e-3, 3e-4)),
        False,
        (*EIGHT, 1e-3, 2e-4, -1e-3, 3e-4),
    ),
    "equidistant": (info("equidistant", FISHEYE), True, FISHEYE),
    "fisheye": (info("fisheye", FISHEYE), True, FISHEYE),
    "model under camera_model": (info("fisheye", FISHEYE, "camera_model"), True, FISHEYE),
    "pinhole equidistant": (
        info("equidistant", FISHEYE, more="camera_model: pinhole\n"),
        True,
        FISHEYE,
    ),
    "five of a T265": (info("equidistant", (*FISHEYE, 0.0)), True, FISHEYE),
    "eight of a fisheye": (info("equidistant", (*FISHEYE, 0, 0, 0, 0)), True, FISHEYE),
    "kannala_brandt4": (info("kannala_brandt4", FISHEYE, "camera_model"), True, FISHEYE),
    "Kannala Brandt4": (info("Kannala Brandt4", (*FISHEYE, 0.0)), True, FISHEYE),
    "none": (info("none", (0.0,) * 5), False, ()),
    "message of ROS 1": (
        f"header:\n  seq: 1\nheight: {SIZE[1]}\nwidth: {SIZE[0]}\ndistortion_model: 'plumb_bob'\n"
        f"D: {[*FIVE]}\nK: {K}\nR: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\nP: [1.0]\n---\n",
        False,
        FIVE,
    ),
    "message of ROS 2": (
        f"height: {SIZE[1]}\nwidth: {SIZE[0]}\ndistortion_model: equidistant\nd: {[*FISHEYE]}\nk: {K}\n"
        "r: [1.0]\np: [1.0]\nroi: {x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}\n",
        True,
        FISHEYE,
    ),
}


@pytest.mark.parametrize("name", ROS)
def test_files_of_ros_in_every_model(name, tmp_path):
    text, fisheye, coefficients = ROS[name]
    points = rays()
    found = pixels(read(tmp_path, text), points)
    assert np.abs(found - by_opencv(points, coefficients, fisheye)).max() < CLOSE


def test_an_ini_of_ros(tmp_path):
    text = (
        f"# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n{SIZE[0]}\n\nheight\n{SIZE[1]}\n\n[narrow_stereo]\n\n"
        f"camera matrix\n{FX} 0.000000 {CX}\n0.000000 {FY} {CY}\n0.000000 0.000000 1.000000\n\n"
        f"distortion\n{' '.join(map(str, FIVE))}\n\nrectification\n1 0 0\n0 1 0\n0 0 1\n\n"
        "projection\n700 0 800 0\n0 700 600 0\n0 0 1 0\n"
    )
    points, made = rays(), read(tmp_path, text, "a.ini")
    assert np.abs(pixels(made, points) - by_opencv(points, FIVE)).max() < CLOSE
    assert made.notes == ("not used: rectification_matrix, projection_matrix",)


@pytest.mark.parametrize("skew", [-0.97, 0.3, 12.0])
def test_skew_is_taken(skew, tmp_path):
    points = rays()
    fisheye = read(tmp_path, info("equidistant", FISHEYE, skew=skew))
    judge = by_opencv(points, FISHEYE, True, skew)
    assert np.abs(pixels(fisheye, points) - judge).max() < CLOSE
    assert np.abs(judge - by_opencv(points, FISHEYE, True)).max() > 0.1  # the test can fail
    pinhole = read(tmp_path, info("plumb_bob", FIVE, skew=skew))
    assert np.abs(pixels(pinhole, points) - by_formula(points, FIVE, skew)).max() < CLOSE
    made = gs.Calibration.of(matrix(skew), FISHEYE, SIZE, fisheye=True)
    assert made == fisheye
    # the derivative by central differences: their error is of the order of 1e-10, rounding 1e-16 / 1e-5
    framed, step = made.fit_to_frame(SIZE[::-1], 1e-6), 1e-5
    x, y = points.T * 0.9
    a, b, c, d = framed.derivative(x, y)
    for found, wanted in (
        (
            (a, c),
            (np.array(framed.distort(x + step, y)) - framed.distort(x - step, y)) / (2 * step),
        ),
        (
            (b, d),
            (np.array(framed.distort(x, y + step)) - framed.distort(x, y - step)) / (2 * step),
        ),
    ):
        assert np.abs(np.array(found) - wanted).max() < 1e-8


@pytest.mark.parametrize("fisheye", [True, False])
def test_every_pixel_of_a_frame_looks_where_the_formula_says_with_skew(fisheye):
    """As test_opencv's: the place from the frame's grid comes back to the pixel, within the grid's 2.5e-3 twice."""
    size, skew, numbers = (321, 241), 7.0, FISHEYE if fisheye else FIVE
    k = np.array([[300.0, skew, 165.0], [0, 303.0, 118.0], [0, 0, 1]])
    lens = gs.Calibration.of(k, numbers, size, fisheye).fit_to_frame(size[::-1], 1e-6)
    grid = distortion_grid(lens, size[::-1], 1e-6)
    rows, cols = np.indices(size[::-1])
    moved = _lagrange(grid.nodes, size[::-1], np.arange(size[1]), np.arange(size[0]))
    places = np.stack([cols + moved[1], rows + moved[0]], -1).reshape(-1, 2)
    y = (places[:, 1] - k[1, 2]) / k[1, 1]
    x = (places[:, 0] - k[0, 2] - skew * y) / k[0, 0]
    if fisheye:
        none, whole = np.zeros(3), np.stack([x, y, np.ones_like(x)], -1)[:, None]
        found = cv2.fisheye.projectPoints(
            whole, none, none, k, np.array(numbers), alpha=skew / k[0, 0]
        )[0].reshape(-1, 2)
    else:
        u, v = ((by_formula(np.stack([x, y], -1), FIVE, 0.0) - (CX, CY)) / (FX, FY)).T
        found = np.stack([k[0, 0] * u + skew * v + k[0, 2], k[1, 1] * v + k[1, 2]], -1)
    assert np.abs(found - np.stack([cols, rows], -1).reshape(-1, 2)).max() < 5e-3


def test_skew_in_frames_of_another_size_and_its_limit(tmp_path):
    made = read(tmp_path, info("equidistant", FISHEYE, skew=5.0))
    whole, half = (made.fit_to_frame((SIZE[1] // n, SIZE[0] // n), n * 1e-6) for n in (1, 2))
    points = rays()
    assert np.allclose(whole.distort(*points.T), half.distort(*points.T), atol=1e-12)
    with refused("skew", "0.1 fx", error=BadFile):
        read(tmp_path, info("equidistant", FISHEYE, skew=99.0))


def test_json_by_a_parser_of_json(tmp_path):
    small = (-0.1, 0.02, 1e-05, -3e-06, 0.0)
    table = {
        "image_width": SIZE[0],
        "image_height": SIZE[1],
        "camera_matrix": matrix().tolist(),
        "distortion_coefficients": [small],
    }
    text, points = json.dumps(table), rays()
    assert "1e-05" in text
    for name in ("a.json", "a.yaml"):
        assert (
            np.abs(pixels(read(tmp_path, text, name), points) - by_opencv(points, small)).max()
            < CLOSE
        )
    assert (
        read(tmp_path, info("plumb_bob", (0.1, 0, 1e-05, 0, 0))).coefficients[2] == 1e-5
    )  # YAML 1.2
    for names in (("mtx", "dist", "img_size"), ("cameraMatrix", "distCoeffs", "imageSize")):
        other = dict(zip(names, (matrix().tolist(), [[*FIVE]], [*SIZE]), strict=True))
        found = pixels(read(tmp_path, json.dumps(other), "b.json"), points)
        assert np.abs(found - by_opencv(points, FIVE)).max() < CLOSE


@pytest.mark.parametrize("suffix", ["yml", "xml", "json"])
def test_fisheyes_of_opencvs_file_storage(suffix, tmp_path):
    path = tmp_path / f"a.{suffix}"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (
        ("image_width", SIZE[0]),
        ("image_height", SIZE[1]),
        ("fisheye_model", 1),
        ("camera_matrix", matrix(-0.97)),
        ("distortion_coefficients", np.array(FISHEYE)[:, None]),
        ("avg_reprojection_error", 0.2),
        ("extrinsic_parameters", np.zeros((2, 6))),
    ):
        file.write(key, value)
    file.release()
    points, made = rays(), gs.read_calibration(path)
    assert np.abs(pixels(made, points) - by_opencv(points, FISHEYE, True, -0.97)).max() < CLOSE
    assert made.notes == ("not used: extrinsic_parameters",)


def camodocal(model, place, distortion=None):
    lines = [
        f"model_type: {model}",
        "camera_name: camera",
        f"image_width: {SIZE[0]}",
        f"image_height: {SIZE[1]}",
    ]
    for name, part in (("distortion_parameters", distortion), ("projection_parameters", place)):
        if part is not None:
            lines += [f"{name}:", *(f"   {key}: {value}" for key, value in part.items())]
    return "%YAML:1.0\n---\n" + "\n".join(lines) + "\n"


def test_files_of_camodocal(tmp_path):
    points, place = rays(), {"fx": FX, "fy": FY, "cx": CX, "cy": CY}
    four = dict(zip(("k1", "k2", "p1", "p2"), FIVE, strict=False))
    made = read(tmp_path, camodocal("PINHOLE", place, four))
    assert np.abs(pixels(made, points) - by_opencv(points, FIVE[:4])).max() < CLOSE
    kb = dict(zip(("k2", "k3", "k4", "k5"), FISHEYE, strict=True)) | {
        "mu": FX,
        "mv": FY,
        "u0": CX,
        "v0": CY,
    }
    made = read(tmp_path, camodocal("KANNALA_BRANDT", kb))
    # r(theta) = theta + k2 theta^3 + k3 theta^5 + k4 theta^7 + k5 theta^9; mu, mv, u0 and v0 in pixels
    theta, phi = np.arctan(np.hypot(*points.T)), np.arctan2(points[:, 1], points[:, 0])
    r = theta + sum(k * theta**n for k, n in zip(FISHEYE, (3, 5, 7, 9), strict=True))
    judge = np.stack([FX * r * np.cos(phi) + CX, FY * r * np.sin(phi) + CY], -1)
    assert np.abs(pixels(made, points) - judge).max() < CLOSE
    for text, parts in (
        (camodocal("MEI", place, four), ("MEI", "cannot be represented")),
        (camodocal("PINHOLE", place), ("distortion_parameters",)),
        (camodocal("PINHOLE", place, four | {"k7": 0.1}), ("'k7'", "unknown")),
        (
            camodocal("PINHOLE", place, four).replace(
                "distortion_parameters", "distortion_paramters"
            ),
            ("lacks distortion_parameters",),
        ),
        (camodocal("KANNALA_BRANDT", {**kb, "k6": 0.1}), ("'k6'",)),
        (camodocal("KANNALA_BRANDT", {key: kb[key] for key in kb if key != "k5"}), ("lacks k5",)),
    ):
        with refused(*parts, error=BadFile):
            read(tmp_path, text)


def chain(model, distortion, numbers, intrinsics=(FX, FY, CX, CY), more=""):
    return (
        f"cam0:\n  cam_overlaps: []\n  camera_model: {model}\n  distortion_coeffs: {[*numbers]}\n"
        f"  distortion_model: {distortion}\n  intrinsics: {[*intrinsics]}\n  resolution: {[*SIZE]}\n"
        f"  rostopic: /cam0/image_raw\n{more}"
    )


def test_camchains_and_kannala_brandt_of_other_programs(tmp_path):
    points = rays()
    for text, fisheye, numbers in (
        (chain("pinhole", "radtan", FIVE[:4]), False, FIVE[:4]),
        (chain("pinhole", "equidistant", FISHEYE), True, FISHEYE),
        (chain("pinhole", "equi", FISHEYE), True, FISHEYE),
        (chain("pinhole", "fisheye", FISHEYE), True, FISHEYE),
        (chain("pinhole", "none", ()), False, ()),
        (
            chain("kb4", "none", ())
            .replace("  distortion_model: none\n", "")
            .replace("  distortion_coeffs: []\n", "")
            .replace(f"{CY}]", f"{CY}, " + str([*FISHEYE])[1:]),
            True,
            FISHEYE,
        ),
    ):
        found = pixels(read(tmp_path, text), points)
        assert np.abs(found - by_opencv(points, numbers, fisheye)).max() < CLOSE
    made = read(
        tmp_path,
        chain("pinhole", "radtan", FIVE[:4], more="  T_cam_imu: [[1]]\n  timeshift_cam_imu: 0.1\n"),
    )
    assert made.notes == ("not used: T_cam_imu, timeshift_cam_imu",)
    basalt = {
        "value0": {
            "T_imu_cam": [{"px": 0.0}],
            "intrinsics": [
                {
                    "camera_type": "kb4",
                    "intrinsics": dict(fx=FX, fy=FY, cx=CX, cy=CY)
                    | dict(zip(("k1", "k2", "k3", "k4"), FISHEYE, strict=True)),
                },
                {
                    "camera_type": "ds",
                    "intrinsics": dict(fx=FX, fy=FY, cx=CX, cy=CY, xi=-0.2, alpha=0.5),
                },
            ],
            "resolution": [[*SIZE], [*SIZE]],
        }
    }
    text = json.dumps(basalt)
    found = pixels(read(tmp_path, text, "b.json", "cam0"), points)
    assert np.abs(found - by_opencv(points, FISHEYE, True)).max() < CLOSE
    with refused("'ds'", "cannot be represented", error=BadFile):
        read(tmp_path, text, "b.json", "cam1")
    for model in ("omni", "eucm", "ds", "mei"):
        with refused(model, "cannot be represented", error=BadFile):
            read(tmp_path, chain(model, "radtan", FIVE[:4], (1.2, FX, FY, CX, CY)))


def test_intrinsics_of_realsense(tmp_path):
    table = dict(width=SIZE[0], height=SIZE[1], ppx=CX, ppy=CY, fx=FX, fy=FY)
    points = rays()
    for model, numbers, fisheye in (
        ("distortion.kannala_brandt4", (*FISHEYE, 0.0), True),
        ("Kannala Brandt4", (*FISHEYE, 0.0), True),
        ("distortion.brown_conrady", FIVE, False),
        ("distortion.inverse_brown_conrady", (0.0,) * 5, False),
    ):
        made = read(tmp_path, json.dumps(table | {"model": model, "coeffs": numbers}), "a.json")
        judge = by_opencv(points, numbers[:4] if fisheye else numbers, fisheye)
        assert np.abs(pixels(made, points) - judge).max() < CLOSE
    with refused("inverse", error=BadFile):
        read(
            tmp_path,
            json.dumps(table | {"model": "distortion.inverse_brown_conrady", "coeffs": FIVE}),
            "a.json",
        )


def test_settings_of_orb_slam(tmp_path):
    points = rays()
    place = f"Camera1.fx: {FX}\nCamera1.fy: {FY}\nCamera1.cx: {CX}\nCamera1.cy: {CY}\n"
    size = f"Camera.width: {SIZE[0]}\nCamera.height: {SIZE[1]}\nCamera.fps: 20\nORBextractor.nFeatures: 1000\n"
    start = '%YAML:1.0\n\nFile.version: "1.0"\n\n'
    for name, order, numbers, fisheye in (
        ("PinHole", ("k1", "k2", "p1", "p2", "k3"), FIVE, False),
        ("KannalaBrandt8", ("k1", "k2", "k3", "k4"), FISHEYE, True),
    ):
        more = "".join(
            f"Camera1.{key}: {value}\n" for key, value in zip(order, numbers, strict=True)
        )
        text = f'{start}Camera.type: "{name}"\n\n{place}{more}{size}'
        for one in (text, text.replace("Camera1.", "Camera.")):
            judge = by_opencv(points, numbers, fisheye)
            assert np.abs(pixels(read(tmp_path, one), points) - judge).max() < CLOSE
    with refused("'k9'", "unknown", error=BadFile):
        read(tmp_path, text.replace("Camera1.k4", "Camera1.k9"))


COLMAP = {
    "SIMPLE_PINHOLE": ((FX, CX, CY), False, ()),
    "PINHOLE": ((FX, FY, CX, CY), False, ()),
    "SIMPLE_RADIAL": ((FX, CX, CY, -0.1), False, (-0.1, 0, 0, 0)),
    "RADIAL": ((FX, CX, CY, -0.1, 0.02), False, (-0.1, 0.02, 0, 0)),
    "OPENCV": ((FX, FY, CX, CY, *FIVE[:4]), False, FIVE[:4]),
    "FULL_OPENCV": ((FX, FY, CX, CY, *EIGHT), False, EIGHT),
    "OPENCV_FISHEYE": ((FX, FY, CX, CY, *FISHEYE), True, FISHEYE),
    "RADIAL_FISHEYE": ((FX, CX, CY, 0.02, -0.01), True, (0.02, -0.01, 0, 0)),
}


@pytest.mark.parametrize("model", COLMAP)
def test_cameras_of_colmap(model, tmp_path):
    """COLMAP counts pixels from their corners: its position less 0.5 is OpenCV's."""
    numbers, fisheye, coefficients = COLMAP[model]
    text = (
        "# Camera list with one line of data per camera:\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
        f"# Number of cameras: 1\n1 {model} {SIZE[0]} {SIZE[1]} {' '.join(map(repr, numbers))}\n"
    )
    made, points = read(tmp_path, text, "cameras.txt"), rays()
    judge = by_opencv(points, coefficients, fisheye)
    if len(numbers) - len([k for k in coefficients if k]) == 3:  # one focal length
        judge[:, 1] = (judge[:, 1] - CY) * FX / FY + CY
    assert np.abs(pixels(made, points) - (judge - 0.5)).max() < CLOSE
    assert "half a pixel" in made.notes[0]


def test_several_cameras_of_colmap_and_models_that_are_not_supported(tmp_path):
    two = "1 PINHOLE 640 480 500 500 320 240\n2 SIMPLE_RADIAL 1000 800 900 500 400 0.01\n"
    assert read(tmp_path, two, "cameras.txt", "2").coefficients[0] == 0.01
    with refused("2 cameras", 'camera = "1"', error=BadFile):
        read(tmp_path, two, "cameras.txt")
    for line, parts in (
        ("1 FOV 640 480 500 500 320 240 0.9\n", ("FOV", "cannot be represented")),
        ("1 THIN_PRISM_FISHEYE 640 480 500 500 320 240 0 0 0 0 0 0 0 0\n", ("THIN_PRISM_FISHEYE",)),
        ("1 OPENCV 640 480 500 500 320 240\n", ("4 parameters, wanted 8",)),
    ):
        with refused(*parts, error=BadFile):
            read(tmp_path, line, "cameras.txt")


def test_transforms_of_nerfstudio(tmp_path):
    place = dict(
        w=SIZE[0], h=SIZE[1], fl_x=FX, fl_y=FY, cx=CX, cy=CY, frames=[{"file_path": "a.png"}]
    )
    points = rays()
    four = dict(zip(("k1", "k2", "p1", "p2"), FIVE, strict=False))
    for more, fisheye, numbers in (
        (four | {"camera_model": "OPENCV"}, False, FIVE[:4]),
        (
            dict(zip(("k1", "k2", "k3", "k4"), FISHEYE, strict=True))
            | {"camera_model": "OPENCV_FISHEYE"},
            True,
            FISHEYE,
        ),
        (
            {"k1": 0.01, "k2": -0.02, "k3": 0.0, "k4": 0.0, "is_fisheye": True},
            True,
            (0.01, -0.02, 0, 0),
        ),
        ({}, False, ()),
    ):
        made = read(tmp_path, json.dumps(place | more), "transforms.json")
        assert (
            np.abs(pixels(made, points) - (by_opencv(points, numbers, fisheye) - 0.5)).max() < CLOSE
        )
    angle = {"camera_angle_x": 0.7, "w": 800, "h": 600, "frames": []}
    made = read(tmp_path, json.dumps(angle), "transforms.json")
    assert made.fx == pytest.approx(400 / np.tan(0.35)) and made.off_middle == (0, 0)
    for more, parts in (
        (four | {"k4": 0.1, "camera_model": "OPENCV"}, ("k4",)),
        ({"k_1": 0.1}, ("'k_1'", "unknown")),
        ({"camera_model": "EQUIRECTANGULAR"}, ("EQUIRECTANGULAR", "cannot be represented")),
    ):
        with refused(*parts, error=BadFile):
            read(tmp_path, json.dumps(place | more), "transforms.json")


PLUMB = info("plumb_bob", FIVE)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (
            PLUMB.replace("coefficients", "coefficents"),
            ("lacks distortion_coefficients", "'distortion_coefficents'"),
        ),
        (
            PLUMB.replace("distortion_coefficients", "distortion_coeficients"),
            ("'distortion_coeficients'",),
        ),
        (PLUMB.replace("camera_matrix", "camera_matirx"), ("'camera_matirx'",)),
        (PLUMB.replace("image_width", "image_widht"), ("image_width", "'image_widht'")),
        (
            PLUMB.replace("distortion_model", "distorsion_model"),
            ("'distorsion_model'", "'distortion_model'"),
        ),
        (info("fisheye", FISHEYE, "camera_modle"), ("'camera_modle'", "'camera_model'")),
        (info("equidistant", (*FISHEYE, 0.1)), ("5 coefficients", "4 of a fisheye")),
        (info("plumb_bob", FIVE, more="camera_model: fisheye\n"), ("contradict",)),
        (info("fisheye", ()).replace("data: []", "dat: []"), ("lacks data",)),
        (
            chain("pinhole", "radtan", FIVE[:4]).replace("distortion_coeffs", "distortion_coefs"),
            ("lacks", "'distortion_coefs'"),
        ),
        (
            chain("pinhole", "radtan", FIVE[:4]).replace("resolution", "resolutoin"),
            ("'resolutoin'",),
        ),
    ],
)
def test_misspelt_keys_are_refused_with_the_nearest_name(text, parts, tmp_path):
    with refused(*parts, error=BadFile):
        read(tmp_path, text)


def test_coefficients_without_a_model(tmp_path):
    """Four numbers may be of both models: Kalibr's are refused, OpenCV's are its pinhole's, with a note."""
    text = chain("pinhole", "radtan", FIVE[:4]).replace("  distortion_model: radtan\n", "")
    with refused("lacks distortion_model", error=BadFile):
        read(tmp_path, text)
    table = {"camera_matrix": matrix().tolist(), "dist_coeff": [[*FIVE]], "image_size": [*SIZE]}
    place = dict(fx=FX, fy=FY, cx=CX, cy=CY, width=SIZE[0], height=SIZE[1])
    flat = place | dict(zip(("k1", "k2", "p1", "p2", "k3"), FIVE, strict=True))
    points = rays()
    for one in (table, flat):
        made = read(tmp_path, json.dumps(one), "a.json")
        assert np.abs(pixels(made, points) - by_opencv(points, FIVE)).max() < CLOSE
        assert any("no model is named" in note for note in made.notes)
    with refused("'k7'", "unknown", error=BadFile):
        read(tmp_path, json.dumps(flat | {"k7": 0.1}), "a.json")


def test_notes_of_a_calibration_are_in_the_report(tmp_path):
    (tmp_path / "info.yaml").write_text(
        info("plumb_bob", FIVE, more="new_camera_matrix: 3\nexposure: 2\n")
    )
    (tmp_path / "own.toml").write_text(
        'base = "phone"\n[optics]\ncalibration = "info.yaml"\n[sensor]\npixel_pitch_um = 3\n'
    )
    camera = gs.open_camera(tmp_path / "own.toml")
    assert camera.notes == ("not used: new_camera_matrix, exposure",)
    frame = gs.Simulator(camera, device="numpy")(gs.chart("flat", size=(41, 31)))
    assert "new_camera_matrix" in str(frame.report)

"""Camera calibrations from files of other programs."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from difflib import SequenceMatcher
from math import tan
from os import PathLike
from typing import Any

from gpusim.domain.calibration import COUNTS, Calibration
from gpusim.domain.errors import BadData, UnknownName, format_value
from gpusim.io.account import Fields
from gpusim.io.camera.calibration_text import WHAT, parse_calibration
from gpusim.io.files import name_in_errors

PINHOLE, FISHEYE, NO_DISTORTION, ANY = "pinhole", "fisheye", "none", "any"
# Names of models in files; ANY is a projection whose distortion has another key
MODELS = dict.fromkeys(
    "plumb_bob rational_polynomial thin_prism radtan radial_tangential brown_conrady radtan8 "
    "pinhole_radtan pinhole_radtan8 modified_brown_conrady opencv full_opencv simple_radial radial "
    "pinhole_full".split(),
    PINHOLE,
)
MODELS |= dict.fromkeys(
    "equidistant equi fisheye kannala_brandt kannala_brandt4 kannalabrandt4 kannalabrandt8 kb4 "
    "opencv_fisheye simple_radial_fisheye radial_fisheye pinhole_equi".split(),
    FISHEYE,
)
MODELS |= dict.fromkeys(["none", "", "simple_pinhole", "inverse_brown_conrady"], NO_DISTORTION)
MODELS |= dict.fromkeys(["pinhole", "perspective"], ANY)
# Models whose projection or distortion is neither of the two
OTHERS = (
    "omni mei ucm eucm ds double_sphere fov atan scaramuzza ocam thin_prism_fisheye division "
    "equirectangular ftheta f_theta spherical orthographic".split()
)
MODEL_KEYS = ("distortion_model", "camera_model", "model_type", "camera_type", "model")
MATRIX = (
    *("camera_matrix", "K", "k", "cameraMatrix", "Camera_Matrix", "mtx", "intrinsic_matrix"),
    *("camera_mat", "intrinsic"),
)
COEFFICIENTS = (
    *("distortion_coefficients", "D", "d", "distCoeffs", "Distortion_Coefficients", "dist"),
    *("distortion_coeffs", "dist_coeffs", "dist_coefs", "dist_coeff", "distortion"),
    *("distortion_coefficient", "coeffs"),
)
SIZES = (
    ("image_width", "image_height"),
    ("width", "height"),
    ("image_Width", "image_Height"),
    ("img_width", "img_height"),
    ("w", "h"),
)
PAIRS = ("resolution", "image_size", "img_size", "imageSize", "size")
# Fields that say nothing about the geometry of pictures
IGNORED = (
    *(
        "header",
        "camera_name",
        "calibration_time",
        "rostopic",
        "cam_overlaps",
        "nframes",
        "nr_of_*",
    ),
    *(
        "n*_of_frames",
        "board_*",
        "square*",
        "flags",
        "*reprojection*",
        "*error*",
        "comment",
        "name",
    ),
    *("sensor_type", "rate_hz", "id", "rms", "date", "aabb_scale", "frames", "ply_file_path"),
    *(
        "fps",
        "RGB",
        "newWidth",
        "newHeight",
        "bf",
        "bFishEye",
        "aspectRatio",
        "fisheye_model",
        "camera_angle_*",
        "type_id",
        "is_fisheye",
        "calib_*",
    ),
)
# Parameters of COLMAP's models; f is both focal lengths
COLMAP = {
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
}
NO_MODEL = (
    "no model is named: the coefficients are taken as k1 k2 p1 p2 ... of OpenCV's pinhole model"
)
HALF_PIXEL = "the principal point is moved by half a pixel: its program has (0.5, 0.5) in the middle of the first pixel"
ORDER = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")  # OpenCV's
RADIAL = ("k1", "k2", "k3", "k4")
PLACE = ("fx", "fy", "cx", "cy")
COEFFICIENT = re.compile(r"(k|p|s|t|tau_?)_?\w?\d?$")
DEEPEST = 3  # lists in lists, as json.dump writes NumPy's arrays of shape (1, 1, n)
ALIKE, MOST_LETTERS = 0.8, 2  # of two names; letters that a misspelt name may have more or fewer


def read_calibration(path: str | PathLike, camera: str | None = None) -> Calibration:
    """Read a camera's calibration from a file of another program.

    ROS: the `camera_info` file of camera_calibration (.yaml, .ini) or a printed
    sensor_msgs/CameraInfo. OpenCV: files of cv2.FileStorage and its calibration samples, in YAML,
    JSON or XML. Kalibr: a camchain (pinhole-radtan, pinhole-equi). Basalt (pinhole, radtan8, kb4),
    camodocal (PINHOLE, KANNALA_BRANDT), ORB-SLAM's settings, RealSense's intrinsics, COLMAP's
    cameras.txt and nerfstudio's transforms.json.

    Args:
        path: file to read.
        camera: camera of a file with several, for example "cam0"; None if there is only one.

    Returns:
        The calibration; its `notes` name the fields that are not used.

    Raises:
        BadFile: if the file cannot be used, naming file and key, or PyYAML is missing.
    """
    table = parse_calibration(path)
    with name_in_errors(path):
        if type(table) is not dict:
            raise BadData(f"not {WHAT}: wanted keys and values")
        cameras = _cameras(table)
        return _read(cameras[_select_camera(cameras, camera)])


def _cameras(table) -> Mapping[Any, dict]:
    """Return the cameras of a file by name."""
    if "colmap" in table:
        return table["colmap"]
    if type(table.get("value0")) is dict:  # Basalt
        return _basalt(table["value0"])
    if _is_camera(table):
        return {"cam0": table}
    if table.keys() >= {*PLACE}:
        return {"cam0": _group(table)}
    slam = _orb_slam(table)
    if slam:
        return slam
    return {key: one for key, one in table.items() if _is_camera(one)} or {"cam0": table}


def _is_camera(table):
    """Return whether a table has the parameters of one camera."""
    known = {"intrinsics", "projection_parameters", "ppx", "fl_x", "camera_angle_x", *MATRIX}
    return type(table) is dict and not known.isdisjoint(table)


def _orb_slam(table):
    """Return the cameras of a settings file of ORB-SLAM: Camera.fx, or Camera1.fx and Camera2.fx."""
    parts: dict[str, dict] = {}
    for key, value in table.items():
        name, dot, rest = str(key).partition(".")
        if dot and name.rstrip("12") == "Camera":
            parts.setdefault(name, {})[rest] = value
    common = parts.get("Camera", {})
    found = {name: {**common, **part} for name, part in parts.items() if "fx" in part}
    return {name: _group(part) for name, part in found.items()}


def _group(table):
    """Return a table whose parameters by name are together, as Basalt has them."""
    names = [key for key in table if key in PLACE or COEFFICIENT.fullmatch(str(key))]
    others = {key: value for key, value in table.items() if key not in names}
    kind = {"camera_type": others.pop("type")} if "type" in others else {}
    return others | kind | {"intrinsics": {key: table[key] for key in names}}


def _basalt(table):
    parts, sizes = table.get("intrinsics"), table.get("resolution")
    is_read = type(parts) is list and type(sizes) is list and len(parts) == len(sizes) > 0
    if not is_read or not all(type(part) is dict for part in parts):
        raise BadData("value0: wanted lists intrinsics and resolution of the same length")
    others = {key: value for key, value in table.items() if key not in ("intrinsics", "resolution")}
    return {
        f"cam{number}": {**others, **part, "resolution": size}
        for number, (part, size) in enumerate(zip(parts, sizes, strict=True))
    }


def _select_camera(cameras, camera):
    """Return the name of one camera."""
    if camera is None and len(cameras) == 1:
        return next(iter(cameras))
    if camera is None:
        known = ", ".join(map(str, cameras))
        raise BadData(
            f'has {len(cameras)} cameras: wanted one of them, camera = "{next(iter(cameras))}"; known: '
            f"{known}"
        )
    if len(cameras) > 1 and camera not in cameras:
        raise UnknownName("camera", str(camera), [str(key) for key in cameras])
    return camera if camera in cameras else next(iter(cameras))


def _read(table):
    """Return the calibration of one camera."""
    fields = Fields(table)
    if "params" in fields:
        made = _colmap(fields)
    elif "projection_parameters" in fields:
        made = _camodocal(fields)
    elif "fl_x" in fields or "camera_angle_x" in fields:
        made = _nerfstudio(fields)
    elif "ppx" in fields:
        intrinsics = [_number(fields.take(key), key) for key in ("fx", "fy", "ppx", "ppy")]
        made = _make(fields, intrinsics, _coefficients(fields))
    elif "intrinsics" in fields:
        made = _kalibr(fields)
    else:
        made = _matrix_file(fields)
    fields.ignore(*IGNORED)
    _refuse_misspelt(fields.unused, table)
    return replace(made, notes=(*made.notes, *fields.notes()))


def _refuse_misspelt(unused, table):
    """Raise BadData for an unused field whose name is nearly the name of a field that is not there."""
    known = {*MODEL_KEYS, *MATRIX, *COEFFICIENTS, *PAIRS, "intrinsics", "skew"}
    known.update(key for pair in SIZES for key in pair)
    for name in map(str, unused):
        for other in sorted(known - table.keys()):
            if _is_alike(name, other):
                raise BadData(f"{format_value(name)}: unknown key; did you mean {other!r}?")


def _is_alike(name, other):
    return (
        len(other) > 3
        and name not in (*COEFFICIENTS, *MATRIX)
        and abs(len(name) - len(other)) <= MOST_LETTERS
        and SequenceMatcher(None, name.lower(), other.lower()).ratio() >= ALIKE
    )


def _missing(fields, *names):
    """Return the error for a field that is missing, with the nearest name that is there."""
    nearest = [
        str(one) for one in fields.unused if any(_is_alike(str(one), name) for name in names)
    ]
    hint = f"; there is {format_value(nearest[0])}" if nearest else ""
    return BadData(f"lacks {names[0]}{hint}")


def _kalibr(fields):
    """Return the calibration of one camera of Kalibr, Basalt or ORB-SLAM."""
    intrinsics = fields.take("intrinsics")
    if type(intrinsics) is dict:  # of Basalt or ORB-SLAM
        parts = Fields(intrinsics)
        found = [_number(_require(parts, key), key) for key in PLACE]
        order = RADIAL if _model(fields) == FISHEYE else ORDER
        coefficients = _named(parts, order)
        parts.ignore("rpmax")
        _refuse_unknown(parts, (*PLACE, *order))
        return _make(fields, found, coefficients)
    numbers = _flat(intrinsics, "intrinsics")
    model = _model(fields)  # refuses omni before its five numbers
    if len(numbers) == 8 and model == FISHEYE and not any(key in fields for key in COEFFICIENTS):
        return _make(fields, numbers[:4], numbers[4:])
    if len(numbers) != 4:
        raise BadData(f"intrinsics: {len(numbers)} numbers, wanted 4: fx, fy, cx, cy")
    coefficients = _coefficients(fields)
    if model == ANY and coefficients:
        raise _missing(fields, "distortion_model")
    return _make(fields, numbers, coefficients)


def _matrix_file(fields):
    """Return the calibration of a ROS or OpenCV file with a camera matrix."""
    key = next((key for key in MATRIX if key in fields), None)
    if key is None:
        nearest = _missing(fields, *MATRIX).details.partition("; ")[2]
        raise BadData(
            "no camera_matrix (or K) of ROS or OpenCV, and no intrinsics of Kalibr"
            + (f"; {nearest}" if nearest else "")
        )
    matrix = _flat(fields.take(key), key)
    if len(matrix) != 9:
        raise BadData(f"{key}: {len(matrix)} numbers, wanted 9")
    if matrix[3] or matrix[6:] != [0, 0, 1]:
        why = f"{key}: wanted fx skew cx, 0 fy cy, 0 0 1, got {format_value(matrix)}"
        raise BadData(why)
    _require_whole_frame(fields)
    intrinsics = [matrix[0], matrix[4], matrix[2], matrix[5]]
    return _make(fields, intrinsics, _coefficients(fields), matrix[1])


def _require_whole_frame(fields):
    """Raise BadData if a message has a region or binning: its matrix is of the whole frame."""
    roi = fields.take("roi")
    roi = roi if type(roi) is dict else {}
    if any(roi.get(key) for key in ("x_offset", "y_offset", "width", "height")):
        raise BadData("roi: wanted the whole frame, a region of 0 x 0")
    for key in ("binning_x", "binning_y"):
        value = fields.take(key)
        if value not in (None, 0, 1):
            why = f"{key}: {format_value(value)}: wanted pixels that are not binned, 0 or 1"
            raise BadData(why)


def _camodocal(fields):
    """Return the calibration of a file of camodocal."""
    model = _model(fields)
    place = _table(fields, "projection_parameters")
    if model == FISHEYE:
        keys, order = ("mu", "mv", "u0", "v0"), ("k2", "k3", "k4", "k5")
        # r = theta + k2 theta^3 + ... + k5 theta^9
        coefficients = _named(place, order, required=True)
    else:
        keys, coefficients = PLACE, []
    intrinsics = [_number(_require(place, key), key) for key in keys]
    _refuse_unknown(place, (*keys, "k2", "k3", "k4", "k5"))
    if model != FISHEYE and "distortion_parameters" in fields:
        parts = _table(fields, "distortion_parameters")
        coefficients = _named(parts, ORDER)
        _refuse_unknown(parts, ORDER)
    elif model != FISHEYE:
        raise _missing(fields, "distortion_parameters")
    return _make(fields, intrinsics, coefficients)


def _nerfstudio(fields):
    """Return the calibration of a transforms.json of nerfstudio or instant-ngp."""
    width, height = _size(fields)
    if "fl_x" in fields:
        fx = _number(fields.take("fl_x"), "fl_x")
        fy = _number(fields.take("fl_y", fx), "fl_y")
    else:
        angle = _number(fields.take("camera_angle_x"), "camera_angle_x")
        if not 0 < angle < 3.1:
            raise BadData(f"camera_angle_x: {angle:g}: wanted radians, 0 .. 3.1")
        fx = fy = width / 2 / tan(angle / 2)
    cx, cy = (
        _number(fields.take(key, size / 2), key) for key, size in (("cx", width), ("cy", height))
    )
    is_fisheye = _model(fields) == FISHEYE or fields.take("is_fisheye") is True
    given = _named(fields, RADIAL)
    moved = [_number(fields.take(key, 0.0), key) for key in ("p1", "p2")]
    _refuse_unknown(fields, ("k1", "k2", "k3", "k4", "p1", "p2", "w", "h"), short_only=True)
    if is_fisheye and any(moved):
        raise BadData("p1, p2: a fisheye with them cannot be represented; calibrate again without")
    if not is_fisheye and given[3]:
        raise BadData("k4: a pinhole with r^8 cannot be represented; calibrate again without")
    coefficients = given if is_fisheye else [*given[:2], *moved, given[2]]
    made = _calibration_of(
        (width, height),
        [fx, fy, cx - 0.5, cy - 0.5],
        coefficients,
        FISHEYE if is_fisheye else PINHOLE,
    )
    return replace(made, notes=(HALF_PIXEL,))


def _colmap(fields):
    """Return the calibration of a line in cameras.txt."""
    model = fields.take("model")
    if model not in COLMAP:
        raise BadData(f"model {model}: cannot be represented; wanted one of {', '.join(COLMAP)}")
    names, numbers = COLMAP[model].split(), fields.take("params")
    if len(numbers) != len(names):
        raise BadData(
            f"{model}: {len(numbers)} parameters, wanted {len(names)}: {', '.join(names)}"
        )
    values = dict(zip(names, numbers, strict=True))
    fx, fy = (values.get(key, values.get("f")) for key in ("fx", "fy"))
    is_fisheye = "FISHEYE" in model
    order = RADIAL if is_fisheye else ORDER
    made = _calibration_of(
        _size(fields),
        [fx, fy, values["cx"] - 0.5, values["cy"] - 0.5],
        _without_rational([values.get(key, 0.0) for key in order])
        if "PINHOLE" not in model
        else [],
        FISHEYE if is_fisheye else PINHOLE,
    )
    return replace(made, notes=(HALF_PIXEL,))


def _make(fields, intrinsics, coefficients, skew=0.0):
    """Return a calibration, with the size and the model of its fields.

    coefficients: None if the file has none.
    """
    model = _model(fields)
    if coefficients is None and model in (PINHOLE, FISHEYE):
        raise _missing(fields, *COEFFICIENTS)
    names = " ".join(str(fields.take(key, "")).lower() for key in MODEL_KEYS)
    if "modified" in names and any((coefficients or [])[2:4]):
        raise BadData("modified Brown-Conrady: its p1 and p2 cannot be represented; wanted 0")
    made = _calibration_of(_size(fields), intrinsics, coefficients or [], model, skew)
    if model == ANY and any(made.coefficients):
        return replace(made, notes=(NO_MODEL,))
    return made


def _calibration_of(size, intrinsics, coefficients, model, skew=0.0):
    if model == NO_DISTORTION:
        if any(coefficients):
            why = "distortion_model: none or inverse, with coefficients: wanted one or the other"
            raise BadData(why)
        coefficients = []
    coefficients, count = list(coefficients), len(coefficients)
    is_fisheye = model == FISHEYE
    allowed = (0, 4) if is_fisheye else COUNTS
    while len(coefficients) not in allowed and coefficients[-1] == 0:  # the rest is not used
        coefficients.pop()
    if len(coefficients) not in allowed:
        coefficients += [0.0] * (count - len(coefficients))  # for the message
    width, height = (int(item) if item == int(item) else item for item in size)
    return Calibration(width, height, *intrinsics, tuple(coefficients), is_fisheye, skew)


def _model(fields):
    """Return the kind of the model that the keys of a file name."""
    found = []
    for key in MODEL_KEYS:
        value = fields.take(key)
        if value is None:
            continue
        name = re.sub(r"\W+", "_", value.lower().rpartition(".")[2]) if type(value) is str else None
        if name in OTHERS:
            raise BadData(
                f"{key}: {format_value(value)}: cannot be represented; calibrate again as pinhole with "
                "radtan (Kalibr: --models pinhole-radtan) or equidistant (pinhole-equi)"
            )
        if name not in MODELS:
            known = "plumb_bob, rational_polynomial, thin_prism, radtan, equidistant, fisheye, none"
            raise BadData(f"{key}: {format_value(value)}: wanted one of {known}")
        found.append((key, value, MODELS[name]))
    if fields.take("fisheye_model"):
        found.append(("fisheye_model", 1, FISHEYE))
    kinds = {kind for _, _, kind in found} - {ANY}
    if len(kinds) > 1:
        words = ", ".join(f"{key}: {value}" for key, value, _ in found)
        raise BadData(f"{words}: contradict each other; wanted one model")
    return kinds.pop() if kinds else ANY


def _size(fields):
    """Return width and height, the resolution at which the camera was calibrated."""
    for pair in SIZES:
        if all(key in fields for key in pair):
            return tuple(_number(fields.take(key), key) for key in pair)
    for key in PAIRS:
        if key in fields:
            numbers = _flat(fields.take(key), key)
            if len(numbers) != 2:
                raise BadData(f"{key}: {len(numbers)} numbers, wanted 2")
            return tuple(numbers)
    nearest = _missing(fields, "image_width", "image_height", *PAIRS).details.partition("; ")[2]
    raise BadData(
        "lacks image_width and image_height, the resolution at which the camera was calibrated"
        + (f"; {nearest}" if nearest else "")
    )


def _coefficients(fields):
    """Return the coefficients in the order of the file, or None."""
    key = next((key for key in COEFFICIENTS if key in fields), None)
    return None if key is None else _flat(fields.take(key), key)


def _named(fields, order: Iterable[str], required=False):
    """Return coefficients from fields that have their names; missing ones are 0."""
    values = [
        _number(_require(fields, key) if required else fields.take(key, 0.0), key) for key in order
    ]
    return _without_rational(values)


def _without_rational(coefficients):
    """Return coefficients without k4, k5 and k6 of OpenCV's order if they are 0."""
    return coefficients if any(coefficients[5:]) else coefficients[:5]


def _refuse_unknown(fields, known, short_only=False):
    """Raise BadData for fields that the model does not have.

    short_only: only ones with the name of a coefficient.
    """
    for name in fields.unused:
        if not short_only or COEFFICIENT.fullmatch(str(name)):
            if any(name == one for one in known):
                continue
            raise BadData(f"{format_value(name)}: unknown coefficient; wanted {', '.join(known)}")


def _require(fields, key):
    if key not in fields:
        raise _missing(fields, key)
    return fields.take(key)


def _table(fields, key):
    value = _require(fields, key)
    if type(value) is not dict:
        raise BadData(f"{key}: {format_value(value)}: wanted keys and values")
    return Fields(value)


def _flat(value, key):
    """Return a list of numbers, or the data of a matrix, as a flat list."""
    if type(value) is dict:
        if "data" not in value:
            raise BadData(f"{key}: lacks data, its numbers")
        value = value["data"]
    value = [] if value is None else value
    for _ in range(DEEPEST):  # YAML has lists that contain themselves
        if type(value) is list and value and all(type(item) is list for item in value):
            value = [item for row in value for item in row]
    if type(value) is not list or not all(
        type(item) in (int, float) and abs(item) < 1e300 for item in value
    ):
        raise BadData(f"{key}: {format_value(value)}: wanted numbers")
    return [float(item) for item in value]


def _number(value, key):
    if type(value) not in (int, float) or not abs(value) < 1e300:
        raise BadData(f"{key}: {format_value(value)}: wanted a number")
    return float(value)

"""Camera calibrations from ROS (camera_info), Kalibr (camchain) and OpenCV (YAML, JSON, XML)."""

import re
from os import PathLike

from gpusim.domain.calibration import Calibration
from gpusim.domain.errors import BadData, BadFile, UnknownName, format_value
from gpusim.io.files import name_in_errors, read_text, reading

# [byte]; real files have two thousand, and Python's parser takes a second for this many
LONGEST = 2**16
WHAT = "YAML, JSON or XML of a calibration"
# names of the models in files, and whether they are fisheye models
MODELS = dict.fromkeys("plumb_bob rational_polynomial thin_prism radtan none".split(), False)
MODELS |= {"radial-tangential": False, "pinhole": False}
MODELS |= {"equidistant": True, "equi": True, "fisheye": True}
KALIBR_OTHERS = ("omni", "eucm", "ds")  # projections other than pinhole
MATRIX = ("camera_matrix", "K", "k", "cameraMatrix", "Camera_Matrix", "mtx")
COEFFICIENTS = (
    "distortion_coefficients",
    "D",
    "d",
    "distCoeffs",
    "Distortion_Coefficients",
    "dist",
)
SIZES = (("image_width", "image_height"), ("width", "height"))


def read_calibration(path: str | PathLike, camera: str | None = None) -> Calibration:
    """Read a camera's calibration from a file of ROS, Kalibr or OpenCV.

    ROS: the `camera_info` file of camera_calibration (.yaml) or a printed sensor_msgs/CameraInfo.
    Kalibr: a camchain (pinhole-radtan, pinhole-equi). OpenCV: files of cv2.FileStorage and its
    calibration samples, in YAML, JSON or XML.

    Args:
        path: file to read.
        camera: camera of a camchain, for example "cam0"; None if there is only one.

    Returns:
        The calibration.

    Raises:
        BadFile: if the file cannot be used, naming file and key, or PyYAML is missing.
    """
    table = _parse(path)
    with name_in_errors(path):
        if type(table) is not dict:
            raise BadData(f"not {WHAT}: wanted keys and values")
        chain = {
            key: value
            for key, value in table.items()
            if type(value) is dict and "intrinsics" in value
        }
        if "intrinsics" in table:  # one camera of a chain, or the sensor.yaml of a data set
            return _kalibr(table)
        if chain:
            return _kalibr(chain[_select_camera(chain, camera)])
        return _matrix_file(table)


def _parse(path):
    """Return the parsed file: dictionaries, lists, numbers and texts."""
    text = read_text(path, WHAT, LONGEST)
    if text.lstrip().startswith("<"):
        from xml.etree import ElementTree

        with reading(path, WHAT):
            return {item.tag: _element(item) for item in ElementTree.fromstring(text)}
    try:
        import yaml
    except ImportError:
        raise BadFile(path, "needs PyYAML: pip install 'gpusim[calibration]'") from None

    class Loader(yaml.SafeLoader):
        """YAML loader that reads OpenCV's matrices as dictionaries."""

    Loader.add_multi_constructor(
        "tag:yaml.org,2002:opencv-",
        lambda loader, _, node: loader.construct_mapping(node, deep=True),
    )
    text = re.sub(r"\A%YAML:.*\n", "", text)  # OpenCV's first line is not valid YAML
    with reading(path, WHAT):
        # A printed message ends in ---; its first document is the message.
        return next(yaml.load_all(text, Loader), None)


def _element(item):
    """Return a number, a text, or a matrix of OpenCV's XML."""
    if len(item):
        return {part.tag: _element(part) for part in item}
    words = (item.text or "").split()
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        return " ".join(words).strip('"')
    return numbers[0] if len(numbers) == 1 and item.tag != "data" else numbers


def _select_camera(chain, camera):
    """Return the name of one camera of a chain."""
    if camera is None and len(chain) == 1:
        return next(iter(chain))
    if camera is None:
        known = ", ".join(map(str, chain))
        raise BadData(
            f'has {len(chain)} cameras: wanted one of them, camera = "{next(iter(chain))}"; known: '
            f"{known}"
        )
    if camera not in chain:
        raise UnknownName("camera", str(camera), [str(key) for key in chain])
    return camera


def _kalibr(table):
    """Return the calibration of one Kalibr camera with intrinsics fx, fy, cx, cy."""
    model = table.get("camera_model", "pinhole")
    if model in KALIBR_OTHERS:
        raise BadData(
            f"camera_model: {model}: wanted pinhole, with distortion_model radtan or equidistant; "
            "calibrate again with --models pinhole-radtan or pinhole-equi"
        )
    if model != "pinhole":
        raise BadData(f"camera_model: {format_value(model)}: wanted pinhole")
    intrinsics = _numbers(table, "intrinsics", 4)
    size = _numbers(table, "resolution", 2)
    key = "distortion_coeffs" if "distortion_coeffs" in table else "distortion_coefficients"
    return _calibration_of([*size], intrinsics, _numbers(table, key), table.get("distortion_model"))


def _matrix_file(table):
    """Return the calibration of a ROS or OpenCV file with a camera matrix."""
    key = next((key for key in MATRIX if key in table), None)
    if key is None:
        raise BadData("no camera_matrix (or K) of ROS or OpenCV, and no intrinsics of Kalibr")
    matrix = _numbers(table, key, 9)
    if matrix[1] or matrix[3] or matrix[6:] != [0, 0, 1]:
        why = f"{key}: wanted fx 0 cx, 0 fy cy, 0 0 1 without skew, got {format_value(matrix)}"
        raise BadData(why)
    sizes = next((pair for pair in SIZES if set(pair) <= table.keys()), None)
    if sizes is None:
        raise BadData(
            "lacks image_width and image_height, the resolution at which the camera was calibrated"
        )
    _require_whole_frame(table)
    found = next((key for key in COEFFICIENTS if key in table), None)
    model = "fisheye" if table.get("fisheye_model") else "pinhole"
    model = table.get("distortion_model") or model
    return _calibration_of(
        [_number(table, key) for key in sizes],
        [matrix[0], matrix[4], matrix[2], matrix[5]],
        [] if found is None else _numbers(table, found),
        model,
    )


def _require_whole_frame(table):
    """Raise BadData if a message has a region or binning: its matrix is of the whole frame."""
    roi = table.get("roi") if type(table.get("roi")) is dict else {}
    if any(roi.get(key) for key in ("x_offset", "y_offset", "width", "height")):
        raise BadData("roi: wanted the whole frame, a region of 0 x 0")
    for key in ("binning_x", "binning_y"):
        if table.get(key) not in (None, 0, 1):
            why = f"{key}: {format_value(table[key])}: wanted pixels that are not binned, 0 or 1"
            raise BadData(why)


def _calibration_of(size, intrinsics, coefficients, model):
    """Return a calibration from numbers and the file's name of its model."""
    if type(model) is not str or model not in MODELS:
        raise BadData(f"distortion_model: {format_value(model)}: wanted one of {', '.join(MODELS)}")
    if model == "none" and any(coefficients):
        raise BadData("distortion_model: none, with coefficients: wanted one or the other")
    width, height = (int(item) if item == int(item) else item for item in size)
    return Calibration(
        width, height, *intrinsics, () if model == "none" else tuple(coefficients), MODELS[model]
    )


def _numbers(table, key, count=None):
    """Return a list of numbers, or the data of a matrix, as a flat list."""
    if key not in table:
        raise BadData(f"lacks {key}")
    value = table[key]
    value = value.get("data") if type(value) is dict else value
    value = [] if value is None else value
    if type(value) is list and value and all(type(item) is list for item in value):
        value = [item for row in value for item in row]
    if type(value) is not list or not all(
        type(item) in (int, float) and abs(item) < 1e300 for item in value
    ):
        raise BadData(f"{key}: {format_value(value)}: wanted numbers")
    if count is not None and len(value) != count:
        raise BadData(f"{key}: {len(value)} numbers, wanted {count}")
    return [float(item) for item in value]


def _number(table, key):
    value = table[key]
    if type(value) not in (int, float) or not abs(value) < 1e300:
        raise BadData(f"{key}: {format_value(value)}: wanted a number")
    return value

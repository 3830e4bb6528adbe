"""The text of a camera calibration as tables: YAML, JSON, XML, ROS's .ini and COLMAP's cameras.txt."""

import json
import re

from gpusim.domain.errors import BadData, BadFile
from gpusim.io.files import name_in_errors, read_text, reading

# [byte]; real files have two thousand, and Python's parser takes a second for this many
LONGEST = 2**16
LONGEST_JSON = 2**24  # transforms.json has the poses of all pictures
WHAT = "YAML, JSON or XML of a calibration"
FLOAT = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?$")
SECTION = re.compile(r"\[([^\]\n]*)\]\s*$")
# numbers of a line in cameras.txt: id, model, width, height, parameters
COLMAP = re.compile(r"(\d+)\s+([A-Z_]+)\s+(\d+)\s+(\d+)((?:\s+[-+.\deE]+)+)$")


def parse_calibration(path) -> dict:
    """Return the parsed file: dictionaries, lists, numbers and texts.

    Raises:
        BadFile: The file is none of these, or PyYAML is missing.
    """
    text = read_text(path, WHAT, LONGEST_JSON)
    start = text.lstrip()
    if start.startswith("{"):
        try:
            return json.loads(text)
        except (ValueError, RecursionError):
            pass  # OpenCV writes 500. for 500.0, which only YAML takes
    if len(text) > LONGEST:
        raise BadFile(path, f"more than {LONGEST / 2**10:g} KiB: too long for {WHAT}")
    if start.startswith("<"):
        from xml.etree import ElementTree

        with reading(path, WHAT):
            return {item.tag: _element(item) for item in ElementTree.fromstring(text)}
    lines = [line.strip() for line in text.split("\n")]
    lines = [line for line in lines if line and not line.startswith(("#", ";"))]
    with name_in_errors(path):
        if lines and all(COLMAP.match(line) for line in lines):
            return {"colmap": dict(map(_colmap_line, lines))}
        if "camera matrix" in lines:
            return _ini(lines)
    return _yaml(path, text)


def _yaml(path, text):
    try:
        import yaml
    except ImportError:
        raise BadFile(path, "needs PyYAML: pip install 'gpusim[calibration]'") from None

    class Loader(yaml.SafeLoader):
        """YAML loader that reads OpenCV's matrices as dictionaries, and 1e-05 as a number."""

    Loader.add_multi_constructor(
        "tag:yaml.org,2002:opencv-",
        lambda loader, _, node: loader.construct_mapping(node, deep=True),
    )
    # after the others, which take whole numbers, sexagesimals and 1.0e-5
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", FLOAT, list("-+.0123456789"))
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


def _colmap_line(line):
    number, model, width, height, values = COLMAP.match(line).groups()
    try:
        numbers = [float(value) for value in values.split()]
    except ValueError:
        raise BadData(f"camera {number}: {values}: wanted numbers") from None
    return number, {
        "model": model,
        "width": int(width[:9]),
        "height": int(height[:9]),
        "params": numbers,
    }


def _ini(lines):
    """Return the cameras of an .ini of ROS, by name, with the keys of its YAML."""
    titles = {
        "camera matrix": "camera_matrix",
        "distortion": "distortion_coefficients",
        "rectification": "rectification_matrix",
        "projection": "projection_matrix",
        "width": "image_width",
        "height": "image_height",
    }
    sections: dict[str, dict] = {}
    values: list = []
    for line in lines:
        name = SECTION.match(line)
        if name:
            sections[name[1]] = {}
        elif FLOAT.match(line.split()[0]):
            try:
                values += [float(word) for word in line.split()]
            except ValueError:
                raise BadData(f"{line}: wanted numbers") from None
        elif sections:
            values = []
            next(reversed(sections.values()))[titles.get(line, line)] = values
    image = {key: value[0] for key, value in sections.pop("image", {}).items() if value}
    image["distortion_model"] = "plumb_bob"  # or rational_polynomial, by the number of coefficients
    found = {name: image | part for name, part in sections.items() if "camera_matrix" in part}
    return found or image

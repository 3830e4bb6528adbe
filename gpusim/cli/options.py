"""Options that commands share: the scene, the camera as operated, and what is asked of the planner."""

import argparse
import math
from collections import Counter

from gpusim.domain.account import SHOWN
from gpusim.domain.errors import Conflict, OutOfRange

DEVICE_HELP = "auto, opencl, opencl:N, opencl:NAME, warp:cpu, warp:cuda:N or numpy (default: auto)"


# Options that change no frame, or that are in the camera or elsewhere in a manifest
APART = frozenset(
    "run command scene camera device out strict shard frames exposure iso f_number focus scaling".split()
)


def describe_options(arguments, apart=()) -> dict[str, str]:
    """Return every option that frames depend on, as text by name, for a manifest.

    apart: others that change no frame, or that are elsewhere in the manifest.
    """
    skipped = APART.union(apart)
    return {
        name: str(value) for name, value in sorted(vars(arguments).items()) if name not in skipped
    }


class Reading:
    """Options of a command line that remember which of them are read."""

    def __init__(self, arguments, parser):
        self.__dict__.update(_arguments=arguments, _parser=parser, _read=set())

    def __getattr__(self, name):
        self._read.add(name)
        return getattr(self._arguments, name)

    def __setattr__(self, name, value):
        setattr(self._arguments, name, value)

    def refuse_unread(self, command: str):
        """Raise Conflict for an option that was given and that nothing has read. command: in words."""
        for action in self._parser._actions:
            value = getattr(self._arguments, action.dest, action.default)
            if action.option_strings and action.dest not in self._read and value != action.default:
                option = action.option_strings[-1]
                raise Conflict(option, f"{command} does not use it", "leave it out")


def scene_of(arguments, name: str | None = None):
    """The scene that a command was given, or one of several. Raises BadFile, BadData, OutOfRange, UnknownName."""
    from gpusim.io.scene.scenes import open_scene

    bands = dict(_named(text) for text in arguments.band)
    return open_scene(
        arguments.scene if name is None else name,
        size=arguments.size,
        light=arguments.light,
        luminance=arguments.luminance,
        bands=bands,
        border=arguments.border,
        samples_per_pixel=arguments.samples_per_pixel,
        fov=arguments.fov,
        depth=arguments.depth,
        wavelengths=arguments.wavelengths,
        kind=arguments.kind,
        scale=arguments.scale,
    )


def operated(camera, arguments):
    """The camera with what the command line says of it: exposure, speed, lens and display scaling."""
    from gpusim.color.speed import operate_camera

    return operate_camera(
        camera,
        exposure=arguments.exposure,
        iso=arguments.iso,
        f_number=arguments.f_number,
        focus=arguments.focus,
        scaling=arguments.scaling,
    )


def _named(text):
    name, _, value = text.rpartition("=")
    try:
        return name, float(value)
    except ValueError:
        raise OutOfRange("--band", text, "NAME=wavelength in nm, such as --band red=630") from None


def size(text: str) -> tuple[int, int]:
    """Columns and rows of `COLSxROWS` on a command line."""
    try:
        cols, rows = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted COLSxROWS, such as 1920x1080") from None
    return cols, rows


def whole(low, high):
    """Reader of a whole number from `low` to `high` on a command line."""

    def read(text):
        try:
            value = int(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            raise argparse.ArgumentTypeError(f"{text!r}: wanted a whole number, {low} .. {high}")
        return value

    return read


def _time(text):
    return text if text == "auto" else seconds_of(text)


def seconds_of(text: str) -> float:
    """Seconds of a time on a command line, see `parse_seconds`."""
    from gpusim.domain.quantities import parse_seconds

    try:
        return parse_seconds(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _positive(wanted, most):
    def read(text):
        try:
            value = float(text)
        except ValueError:
            value = 0.0
        if not 0 < value <= most:
            raise argparse.ArgumentTypeError(f"{text!r}: wanted {wanted}")
        return value

    return read


def _add_operation(command):
    """Options by which a camera is operated."""
    command.add_argument(
        "--exposure",
        type=_time,
        metavar="TIME",
        help="1/60, 0.01 [s], 10ms, 500us, or auto: metered (default: the camera's)",
    )
    command.add_argument(
        "--iso",
        type=_positive("a number above 0", float("inf")),
        metavar="N",
        help="speed by "
        "saturation, by the analog gain; from the base speed on (default: the camera's gain)",
    )
    command.add_argument(
        "--f-number",
        type=_positive("0.1 .. 1000", 1e3),
        metavar="N",
        help="such as 2.8 (default: the camera's)",
    )
    command.add_argument(
        "--focus",
        type=_positive("metres above 0, or inf", float("inf")),
        metavar="METRES",
        help="distance of the plane in focus, or inf (default: the camera's)",
    )
    command.add_argument(
        "--scaling",
        choices=("exposure", "normalised"),
        help="of the picture: by exposure longer is "
        "brighter and clips, normalised a white surface is white (default: the camera's, exposure)",
    )


def add_asked(command, several: bool = False, camera: str | None = None, more: str = ""):
    """Add the options of a scene before a camera, or of several scenes.

    camera: which where none is named; None: one has to be. more: what is taken where no scene is named, for the help;
    "": one has to be.
    """
    count = {"nargs": "+"} if several else {"nargs": "?"} if more else {}
    more = "; several, or a folder of numbered ones: a frame of each" if several else more
    command.add_argument(
        "scene",
        metavar="SCENE",
        **count,
        help="a chart (colorchecker, "
        "slanted-edge, ramp, flat, points, deadleaves, sweep) or a file: spectral .exr, .npz, .mat, "
        f"ENVI .hdr, planes .tif or .npy, spectra .csv, photograph .png, .jpg or .tif{more}",
    )
    command.add_argument(
        "--camera",
        required=camera is None,
        default=camera,
        help="phone, machine-vision, figure8, "
        f"mono, or a .toml file{'' if camera is None else f' (default: {camera})'}",
    )
    command.add_argument("--device", default="auto", help=DEVICE_HELP)
    command.add_argument(
        "--tolerance",
        help="preview, video, metrology, or a relative RMS error; checked by --verify",
    )
    command.add_argument(
        "--guaranteed", action="store_true", help="the tolerance holds for every spectrum"
    )
    command.add_argument(
        "--strict", action="store_true", help="refuse a tolerance that is not predicted to be met"
    )
    command.add_argument(
        "--size",
        type=size,
        metavar="COLSxROWS",
        help="of a chart, or of the patches of a .csv (default: 768x512)",
    )
    command.add_argument(
        "--samples-per-pixel",
        type=float,
        metavar="S",
        help="scene samples along a pixel, at least "
        "1: a chart is drawn that much finer, a file gives a frame that much smaller (default: the "
        "scene's, 1)",
    )
    command.add_argument(
        "--light", help="any CIE illuminant, daylight-<T>K or blackbody-<T>K (default: the scene's)"
    )
    command.add_argument(
        "--luminance", type=float, metavar="CD_M2", help="of white in the scene's light"
    )
    command.add_argument(
        "--border", choices=("zero", "edge", "reflect"), help="the world outside the frame"
    )
    _add_operation(command)
    command.add_argument(
        "--band",
        action="append",
        default=[],
        metavar="NAME=NM",
        help="wavelength of an .exr channel that is not named by it; may be repeated",
    )
    command.add_argument(
        "--wavelengths",
        type=_wavelengths,
        metavar="NM",
        help="of the planes of a .tif or .npy, or "
        "of an ENVI file's bands: FIRST:LAST:STEP, such as 400:700:10, or all of them, such as "
        "450,550,650",
    )
    command.add_argument(
        "--kind",
        choices=("reflectance", "radiance"),
        help="what these planes, or the spectra of a "
        ".csv, hold (default: reflectance, or what an ENVI header says; radiance is in "
        "W m-2 sr-1 nm-1)",
    )
    command.add_argument(
        "--scale",
        type=_positive("a number above 0", 1e30),
        metavar="N",
        help="the number that "
        "stands for 1 in these files, such as 100 of per cents (default: 1, the largest of uint8 and "
        "uint16, or what an ENVI header says)",
    )
    command.add_argument(
        "--fov",
        type=_fov,
        metavar="DEGREES",
        help="horizontal field of view of the scene (default: the file's, or what the camera sees)",
    )
    command.add_argument(
        "--depth",
        choices=("axis", "ray", "none"),
        default="axis",
        help="distances of an .exr's "
        "depth channel [m] are along the optical axis (Blender), along each pixel's ray (Mitsuba; "
        "needs --fov), or left (default: axis)",
    )


def _fov(text):
    """Degrees on a command line as radians."""
    degrees = _positive("degrees above 0 and below 180", 179.99)(text)
    return math.radians(degrees)


def _wavelengths(text):
    """Wavelengths [nm] of FIRST:LAST:STEP or of a list on a command line."""
    try:
        if ":" not in text:
            return [float(part) for part in text.split(",")]
        first, last, step = (float(part) for part in text.split(":"))
        count = round((last - first) / step)
        if not (0 < count < 10_000 and abs(first + count * step - last) < 1e-6 * step):
            raise ValueError
        return [first + number * step for number in range(count + 1)]
    except (ValueError, ZeroDivisionError, OverflowError):
        raise argparse.ArgumentTypeError(
            f"{text!r}: wanted FIRST:LAST:STEP, such as 400:700:10, or a list such as 450,550,650"
        ) from None


def describe_verdicts(states: Counter) -> str:
    """States of verdicts, each with the number of its frames, as the end of a line; "" without a tolerance."""
    if not states:
        return ""
    worst, *rest = sorted(states, key=("not met", "not judged", "met").index)
    words = [
        f"in {states[worst]} of {states.total()} frames" if rest else "",
        *(f"{SHOWN[state]} in {states[state]}" for state in rest),
    ]
    return f"; tolerance {SHOWN[worst]} {', '.join(filter(None, words))}".rstrip()

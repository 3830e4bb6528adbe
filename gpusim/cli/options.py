"""Options of the command line: one dataclass per command makes parser, camera, scene, simulator.

A field made by `option` is one option. The dataclass records which options the user gave and which
of them the command has read, so that a command can refuse an option that has no effect.
"""

import argparse
import functools
import json
import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

from gpusim.domain.account import SHOWN
from gpusim.domain.errors import LONGEST_PATH, BadFile, Conflict, OutOfRange, one_line
from gpusim.io.scene.option_texts import WAVELENGTHS, parse_band, parse_size, parse_wavelengths

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.domain.camera import Camera
    from gpusim.domain.scene import Scene
    from gpusim.pipeline.simulator import Simulator

PANORAMIC = (".exr", ".npz")  # files that may say that they are panoramas
DEVICE_HELP = "auto, opencl, opencl:N, opencl:NAME, warp:cpu, warp:cuda:N or numpy (default: auto)"
DEVICES_HELP = (
    "as for simulate; or several of one kind, which share the work: gpus (all of the best make), or names separated by "
    "commas (default: auto)"
)
SCENE_HELP = (
    "a chart (colorchecker, slanted-edge, ramp, flat, points, deadleaves, sweep) or a file: "
    "spectral .exr, .npz, .mat, HDF5 .h5, ENVI .hdr, planes .tif or .npy, spectra .csv, photograph .png, "
    ".jpg or .tif"
)
SCENES_HELP = f"{SCENE_HELP}; several of them, or a folder of numbered files: a frame of each"
CAMERA_HELP = "built-in camera, such as phone, mono or x-trans, or a .toml file"
DEVELOPING = ("demosaic", "denoise", "white_balance", "look")  # controls of the development
CONTROLS = ("exposure", "iso", "f_number", "focus", "scaling", *DEVELOPING)  # of a camera
SCENE_OPTIONS = (
    "size light luminance border samples_per_pixel fov depth wavelengths kind scale projection part layer view key "
    "band"
).split()


def option(
    *flags: str, default: Any = None, in_key: bool = True, positional: bool = False, **settings: Any
) -> Any:
    """Return the dataclass field of an option.

    Args:
        flags: Names on the command line. None: "--" and the field's name.
        default: Value if the option is not given.
        in_key: False for an option that no frame depends on, or that a manifest records separately.
        positional: True for an argument without a flag.
        settings: Other arguments of `ArgumentParser.add_argument`.
    """
    metadata = {"flags": flags, "settings": settings, "in_key": in_key, "positional": positional}
    return field(default=default, metadata=metadata)


def flag(words: str, **settings: Any) -> Any:
    """Return the field of an option without a value. words: help; settings: as for `option`."""
    return option(default=False, action="store_true", help=words, **settings)


def scene_option(words: str, **settings: Any) -> Any:
    """Return the field of the argument SCENE. words, settings: as for `flag`."""
    return option(positional=True, in_key=False, metavar="SCENE", help=words, **settings)


@dataclass(frozen=True, kw_only=True)
class Options:
    """Base class of the options of one command.

    Attributes:
        REFUSED: Inherited options that the command has no use for, and the reason. They are not in
            its help.
    """

    REFUSED: ClassVar[dict[str, str]] = {}

    def __post_init__(self):
        given = {part.name for part in fields(self) if vars(self)[part.name] is not part.default}
        self.__dict__.update(_given=given, _read=set())

    def __getattribute__(self, name):
        state = object.__getattribute__(self, "__dict__")
        if name in state and "_read" in state:
            state["_read"].add(name)
        return object.__getattribute__(self, name)

    @classmethod
    def add_command(cls, commands: Any, name: str, run: Any, **texts: str) -> None:
        """Add a command with these options to the subparsers of `gpusim`.

        Args:
            commands: Result of `ArgumentParser.add_subparsers`.
            name: Name of the command.
            run: Function from the options to the exit status.
            texts: `help` and `description` of the command.
        """
        parser = commands.add_parser(name, **texts)
        for part in fields(cls):
            flags = part.metadata["flags"] or (_flag(part),)
            if part.metadata["positional"]:
                flags = (part.name,)
            hidden = {"help": argparse.SUPPRESS} if part.name in cls.REFUSED else {}
            settings = part.metadata["settings"] | hidden
            parser.add_argument(*flags, default=argparse.SUPPRESS, **settings)
        parser.set_defaults(run=lambda arguments: run(cls.from_arguments(arguments)))

    @classmethod
    def from_arguments(cls, arguments: argparse.Namespace) -> Self:
        """Return the options that a parser of `add_command` has read. Raises Conflict."""
        names = {part.name for part in fields(cls)}
        given = {name: value for name, value in vars(arguments).items() if name in names}
        options = cls(**given)
        options._given.update(given)
        for name, reason in cls.REFUSED.items():
            options.refuse(name, reason)
        return options

    def is_given(self, name: str) -> bool:
        """Return whether the user gave an option, if only its default."""
        return name in self._given

    def is_changed(self, name: str) -> bool:
        """Return whether an option has another value than its default."""
        return getattr(self, name) != type(self).__dataclass_fields__[name].default

    def refuse(self, name: str, reason: str, remedy: str = "leave it out") -> None:
        """Raise Conflict if an option was given.

        Args:
            name: Name of the field.
            reason: Why the option has no effect.
            remedy: What to change.
        """
        if self.is_given(name):
            part = next(part for part in fields(self) if part.name == name)
            raise Conflict(_flag(part), reason, remedy)

    def refuse_unread(self, command: str) -> None:
        """Raise Conflict for an option that was given but that nothing has read.

        Args:
            command: The command and what it does, such as "look --what mtf".
        """
        for part in fields(self):
            if part.name not in self._read:
                self.refuse(part.name, f"{command} does not use it")

    def for_manifest(self) -> dict[str, str]:
        """Return every option that frames depend on, as text by name, for a manifest."""
        return {
            part.name: str(vars(self)[part.name])
            for part in sorted(fields(self), key=lambda part: part.name)
            if part.metadata["in_key"]
        }


def _flag(part):
    """Return the name by which users know an option."""
    flags = part.metadata["flags"]
    if part.metadata["positional"]:
        return part.metadata["settings"]["metavar"]
    return flags[-1] if flags else f"--{part.name.replace('_', '-')}"


def _channel(text):
    """Return name and wavelength [nm] of NAME=NM. Raises OutOfRange."""
    try:
        return parse_band(text)
    except ValueError:
        raise OutOfRange("--band", text, "NAME=wavelength in nm, such as --band red=630") from None


def reads(wanted: str) -> Callable:
    """Return a decorator of a function from a text of the command line to its value.

    Args:
        wanted: Allowed texts in words: a ValueError, a division by 0 or an overflow becomes
            ArgumentTypeError with them.
    """

    def add(read):
        @functools.wraps(read)
        def checked(text):
            try:
                return read(text)
            except (ValueError, ZeroDivisionError, OverflowError):
                raise argparse.ArgumentTypeError(f"{text!r}: wanted {wanted}") from None

        return checked

    return add


def number(
    wanted: str, is_allowed: Callable[[Any], bool] = lambda value: True, kind: Callable = float
) -> Callable[[str], Any]:
    """Return a function that reads an allowed number. wanted: in words."""

    @reads(wanted)
    def read(text):
        value = kind(text)
        if not is_allowed(value):
            raise ValueError
        return value

    return read


def whole(low: int, high: int) -> Callable[[str], int]:
    """Return a function that reads a whole number from `low` to `high`."""
    return number(f"a whole number, {low} .. {high}", lambda value: low <= value <= high, int)


def seed_option(seeded: str) -> Any:
    """Return the field of an option --seed. seeded: the things that it seeds, in words."""
    return option(default=0, type=whole(0, 2**64 - 1), help=f"seed of {seeded} (default: 0)")


@reads("COLSxROWS, such as 1920x1080")
def size(text: str) -> tuple[int, int]:
    """Return the columns and rows of the text COLSxROWS. Raises ArgumentTypeError."""
    return parse_size(text)


def _time(text):
    """Return an exposure time [s], or "auto"."""
    from gpusim.domain.exposure import parse_seconds

    try:
        return text if text == "auto" else parse_seconds(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def _positive(wanted, most):
    """Return a function that reads a number above 0, up to `most`. wanted: in words."""
    return number(wanted, lambda value: 0 < value <= most)


def _fov(text):
    """Return an angle in radians from a text in degrees."""
    return math.radians(_positive("degrees above 0 and below 180", 179.99)(text))


_wavelengths = reads(WAVELENGTHS)(parse_wavelengths)


@dataclass(frozen=True, kw_only=True)
class Request(Options):
    """A scene, a camera with its controls, and the settings of the planner."""

    scene: Any = scene_option(SCENE_HELP)
    camera: str = option(in_key=False, required=True, help=CAMERA_HELP)
    device: str = option(default="auto", in_key=False, help=DEVICE_HELP)
    tolerance: str | None = option(
        help="error that the frame may have: preview, video, metrology, or a relative RMS error "
        "(default: exact, every wavelength is computed)"
    )
    guaranteed: bool = flag("meet --tolerance for every possible spectrum")
    strict: bool = flag("fail if --tolerance is not predicted to be met", in_key=False)
    size: tuple[int, int] | None = option(
        type=size,
        metavar="COLSxROWS",
        help="size of a chart, or of the patches of a .csv file, in pixels (default: 768x512)",
    )
    samples_per_pixel: float | None = option(
        type=float,
        metavar="S",
        help="scene samples per pixel along each axis, at least 1. A chart is drawn with that "
        "many; a file keeps its samples and gives a smaller frame (default: the scene's, 1)",
    )
    light: str | None = option(
        help="light on the scene: any CIE illuminant, daylight-<T>K or blackbody-<T>K (default: "
        "the scene's)"
    )
    luminance: float | None = option(
        type=float,
        metavar="CD_M2",
        help="luminance of a white diffuser in the scene's light [cd/m2] (default: the scene's, or "
        "100)",
    )
    border: str | None = option(
        choices=("zero", "edge", "reflect"),
        help="how the scene continues outside the frame: black, by its edge, or mirrored (default: "
        "the scene's)",
    )
    exposure: float | str | None = option(
        type=_time,
        in_key=False,
        metavar="TIME",
        help="exposure time: 1/60, 0.01 (seconds), 10ms, 500us, or auto for automatic exposure "
        "(default: the camera's)",
    )
    iso: float | None = option(
        type=_positive("a number above 0", float("inf")),
        in_key=False,
        metavar="N",
        help="ISO speed (saturation based), from the sensor's base speed up; sets the analog gain "
        "(default: the camera's gain)",
    )
    f_number: float | None = option(
        type=_positive("0.1 .. 1000", 1e3),
        in_key=False,
        metavar="N",
        help="f-number of the lens, such as 2.8 (default: the camera's)",
    )
    focus: float | None = option(
        type=_positive("metres above 0, or inf", float("inf")),
        in_key=False,
        metavar="METRES",
        help="distance of the plane in focus, or inf (default: the camera's)",
    )
    scaling: str | None = option(
        choices=("exposure", "normalised"),
        in_key=False,
        help="brightness of the picture. exposure: a longer exposure is brighter and may clip; "
        "normalised: a white surface is white (default: the camera's)",
    )
    demosaic: str | None = option(
        in_key=False,
        metavar="NAME",
        help="method of demosaicking, such as bilinear, adaptive or best (default: the camera's)",
    )
    denoise: float | None = option(
        type=number("a number, 0 .. 4", lambda value: 0 <= value <= 4),
        in_key=False,
        metavar="STRENGTH",
        help="strength of denoising, 0 (none) .. 4; 1 follows the noise model (default: the "
        "camera's)",
    )
    white_balance: str | None = option(
        in_key=False,
        metavar="NAME",
        help="white balance: illuminant (the light is known), none, or an estimate, such as "
        "gray-world (default: the camera's)",
    )
    look: str | None = option(
        in_key=False,
        metavar="NAME",
        help="finish of the picture: linear (light as it is, for training and measurements), "
        "camera or phone (denoised, with a tone curve, sharpened, lens corrected; settings of the camera file stay) "
        "(default: the camera's)",
    )
    band: list[str] | tuple = option(
        default=(),
        action="append",
        metavar="NAME=NM",
        help="wavelength of an .exr channel whose name does not contain it; may be repeated",
    )
    wavelengths: list[float] | None = option(
        type=_wavelengths,
        metavar="NM",
        help="wavelengths of the planes of a .tif or .npy file, or of the bands of a .mat, HDF5 or "
        "ENVI file, or of a folder of bands: "
        "FIRST:LAST:STEP, such as 400:700:10, or a list, such as 450,550,650",
    )
    kind: str | None = option(
        choices=("reflectance", "radiance"),
        help="quantity in planes (.tif, .npy, .mat, HDF5, ENVI) or spectra (.csv); radiance is in W m-2 sr-1 "
        "nm-1 (default: reflectance, or as an ENVI header says)",
    )
    scale: float | None = option(
        type=_positive("a number above 0", 1e30),
        metavar="N",
        help="value in planes or spectra that means 1.0, such as 100 for percent (default: 1, the "
        "largest value of uint8 and uint16, or as an ENVI header says)",
    )
    key: str | None = option(
        metavar="NAME",
        help="name of the cube in a .mat or HDF5 file with several, such as rad or /scene/cube",
    )
    fov: float | None = option(
        type=_fov,
        metavar="DEGREES",
        help="horizontal field of view of the scene (default: the file's, or the camera's)",
    )
    depth: str = option(
        default="axis",
        choices=("axis", "ray", "none"),
        help="how a file gives distances [m]. axis: along the optical axis (Blender); ray: along "
        "each pixel's ray (Mitsuba; needs --fov); none: ignore them (default: axis)",
    )

    projection: str | None = option(
        choices=("plane", "equirectangular"),
        help="meaning of the scene's samples: places in a pinhole's picture, or the directions of "
        "a panorama (all around, 2:1), which the camera sees in --size or its calibration's "
        "(default: the file's)",
    )
    part: str | None = option(
        metavar="NAME",
        help="name or number (from 0) of the only part of an .exr to read (default: all of one "
        "size), or of the page of a .tif",
    )
    layer: str | None = option(
        metavar="NAME", help="layer of an .exr with the picture, such as ViewLayer"
    )
    view: str | None = option(
        metavar="NAME", help="view of a stereo .exr, such as right (default: the file's first)"
    )

    def refuse_picture(
        self, reason: str, remedy: str = "leave it out", suffixes: Iterable[str] = ()
    ) -> None:
        """Raise Conflict if an option was given that only a picture depends on.

        Args:
            reason: As for `refuse`.
            remedy: As for `refuse`.
            suffixes: Formats of the outputs. A .dng holds the white balance.
        """
        for name in ("scaling", *DEVELOPING):
            if name != "white_balance" or ".dng" not in suffixes:
                self.refuse(name, reason, remedy)

    def open_scene(
        self, name: str | None = None, unused: tuple[str, ...] = (), **changes: Any
    ) -> "Scene":
        """Return the scene, or one of several scenes, as `gpusim.open_scene` does.

        Args:
            name: Chart or file. None: the only scene of the command line.
            unused: Options of a scene that the caller has no use for, and does not read.
            changes: Arguments of `open_scene` that replace the options of the command line.

        Raises:
            GpusimError: As `open_scene` does.
        """
        from gpusim.domain.scene import PANORAMA
        from gpusim.io.scene.scenes import open_scene
        from gpusim.optics.panorama import view_panorama

        names = [part for part in SCENE_OPTIONS if part not in unused]
        settings = {part: getattr(self, part) for part in names}
        settings["bands"] = dict(_channel(text) for text in settings.pop("band"))
        size = settings.get("size")
        name = self.scene if name is None else name
        may_be_panorama = Path(name).suffix.lower() in PANORAMIC
        if settings.get("projection") == PANORAMA or may_be_panorama:
            settings["size"] = None
        scene = open_scene(name, **(settings | changes))
        if scene.projection != PANORAMA:
            if may_be_panorama and size is not None:
                self.refuse("size", f"{one_line(name, LONGEST_PATH)} has its own size")
            return scene
        return view_panorama(scene, self.open_camera(), size=size)

    def open_camera(self, *controls: str) -> "Camera":
        """Return the camera with the controls that the command line sets.

        Args:
            controls: Names of the controls that the caller uses, of CONTROLS. None: all of them.

        Raises:
            GpusimError: As `gpusim.open_camera` does, or for settings that the camera cannot have.
        """
        from gpusim.color.speed import operate_camera
        from gpusim.io.camera.cameras import open_camera

        settings = {name: getattr(self, name) for name in controls or CONTROLS}
        return operate_camera(open_camera(self.camera), **settings)

    def open_simulator(
        self, camera: "Camera | None" = None, *, several: bool = False
    ) -> "Simulator":
        """Return the simulator of a camera, by default of `open_camera`, on the device.

        Args:
            camera: The camera.
            several: Whether the command works on several devices.

        Raises:
            GpusimError: As `Simulator` does.
            Conflict: For options about a tolerance without --tolerance.
        """
        from gpusim.backends import open_device
        from gpusim.pipeline.simulator import Simulator

        if self.tolerance is None:
            for name in ("guaranteed", "strict"):
                self.refuse(name, "there is no tolerance to meet", "add --tolerance")

        return Simulator(
            self.open_camera() if camera is None else camera,
            device=self.device if several else open_device(self.device),
            tolerance=self.tolerance,
            guaranteed=self.guaranteed,
            strict=self.strict,
        )


def describe_verdicts(states: Counter) -> str:
    """Return the end of a line that reports verdicts; "" without a tolerance.

    Args:
        states: Number of frames for each state of a verdict.
    """
    if not states:
        return ""
    worst, *rest = sorted(states, key=("not met", "not judged", "met").index)
    words = [
        f"in {states[worst]} of {states.total()} frames" if rest else "",
        *(f"{SHOWN[state]} in {states[state]}" for state in rest),
    ]
    return f"; tolerance {SHOWN[worst]} {', '.join(filter(None, words))}".rstrip()


def make_folder(path: Path) -> None:
    """Create a folder, and those around it, if it does not exist. Raises BadFile."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadFile(path, f"cannot be created: {error.strerror or error}") from error


def write_json(path: str | None, content: Any) -> None:
    """Write plain data to a JSON file. None is no file. Raises BadFile."""
    from gpusim.io.atomic import atomic_path

    if path is not None:
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n")

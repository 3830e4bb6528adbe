"""Pages that are made of the code and of stored results, so that they say what those do.

Camera keys from `gpusim.domain.camera_keys` and the domain's dataclasses, stages from kernels/ and bench/results, the
command line from its parsers, the public names from gpusim's own table.
"""

import argparse
import ast
import dataclasses
import importlib
import inspect
import numbers
import re
import textwrap
from pathlib import Path

import prose
import stage_pages

import gpusim
from gpusim.cli import main as cli
from gpusim.domain import camera_keys
from gpusim.domain.display import Display
from gpusim.domain.noise import Noise
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor
from gpusim.domain.pupil import Wavefront
from gpusim.domain.sensor import Sensor

CLASSES = {
    "optics": (Optics, Wavefront),
    "sensor": (Sensor,),
    "noise": (Noise,),
    "processor": (Processor,),
    "display": (Display,),
}
UNITS = {
    "mm": "mm",
    "um": "µm",
    "nm": "nm",
    "m": "m",
    "ms": "ms",
    "us": "µs",
    "e": "e⁻",
    "dn": "DN",
    "c": "°C",
    "k": "K",
    "deg": "degree",
    "waves": "wave",
    "diopters": "1/m",
    "v": "V",
    "dn_per_e": "DN/e⁻",
    "uv_per_e": "µV/e⁻",
    "e_per_s": "e⁻/s",
    "cd_per_m2": "cd/m²",
}
INSIDE = re.compile(
    r" \[(?:m|s|rad|V|V/e-|m at the sensor)\]"
)  # units of the classes; files have others
CURVE = "a curve"
CURVES = {
    "_curve": CURVE,
    "_number_or_curve": f"a number or {CURVE}",
    "_micrometres_or_curve": f"a number or {CURVE}",
}
# keys of a file that are not fields of their own, and what the dataclass says in units of its own
SAID = {
    "focal_length_mm": "Of the lens, as a thin one.",
    "pixel_pitch_um": "Distance of the pixels' middles, along rows and columns.",
    "defocus_diopters": "The same defocus in dioptres; one of the two.",
    "defocus_um": "How far behind the image the sensor is; a curve for axial colour.",
    "diffuser_um": "Standard deviation of a Gaussian diffuser, at the sensor.",
    "psf": "Measured point spreads, an .npz file beside the camera file: `lens.npz` in [Files](../files.md).",
    "photodetector": "A second factor of `qe`, such as the photodiode behind the colour filters.",
    "ir_cut": "A third factor of `qe`: the infrared filter in front of the sensor.",
    "calibration": 'A file of OpenCV, ROS or Kalibr, or `{file = ..., camera = "cam0"}`: principal point, focal '
    "lengths and distortion, see [Files](../files.md).",
    "noise_profile": "A raw photograph (DNG) whose NoiseProfile gives gain, offset and read noise.",
    "qe_ends": '"zero": light outside the table is not counted. Without it such light is refused.',
    "table": 'Filters of `demosaic = "learned"`: an .npz file of `gpusim train-l3`; without it the built-in ones.',
    "photodetector_size": "Height and width of the sensitive rectangle over the pitch, in place of `fill_factor`.",
    "auto_exposure": "How the time is chosen: see `AutoExposure`.",
    "conversion_gain_uv_per_e": "Of the pixel; with `adc_range_v`, in place of `gain_dn_per_e`.",
    "adc_range_v": "Voltage of all steps of the converter; with `conversion_gain_uv_per_e`.",
    "temperature_c": "Of the chip; the dark current follows it.",
    "reference_temperature_c": "Temperature at which `dark_current_e_per_s` and `hot_current_e_per_s` are given.",
    "doubling_k": "How much warmer the chip is when its dark current has doubled.",
    "telegraph_e": "Mean distance of the two values between which a pixel with a trap jumps.",
    "hot_current_e_per_s": "Mean of the dark current that hot pixels have more, at the reference temperature.",
    "seed": "Which chip: all fixed patterns follow from it.",
    "name": "`srgb`, `display-p3`, or a measured display; or a name of your own beside the keys below.",
}
GROUPS = {  # by the module that a public name comes from, in the order of the page
    "Simulate": (
        "simulator",
        "frame",
        "program",
        "report",
        "batches",
        "backends",
        "domain.tolerance",
        "domain.errors",
    ),
    "Cameras": (
        "data.cameras",
        "domain.camera",
        "domain.optics",
        "domain.sensor",
        "domain.noise",
        "domain.exposure",
        "domain.processor",
        "domain.display",
        "data.displays",
        "readout",
    ),
    "Calibration": (
        "domain.calibration",
        "data.calibration",
        "data.noise_profile",
        "data.emva1288",
        "domain.psf",
        "data.psf",
        "data.zemax",
        "data.optiland",
        "measure.photon_transfer",
    ),
    "Scenes": (
        "domain.scene",
        "domain.content",
        "domain.illuminated",
        "domain.spectrum",
        "data.charts",
        "data.lights",
        "data.illumination",
        "io",
    ),
    "Things that move": ("domain.view", "domain.motion", "domain.animation", "domain.flicker"),
    "Several exposures": ("captures",),
    "Preview and pictures": ("preview", "plot", "look"),
}


def write(folder):
    """Write all pages into a folder, which may hold those of a build before."""
    folder = Path(folder)
    folder.mkdir(exist_ok=True)
    for name, lines in (
        ("keys.rst", keys()),
        ("tasks.rst", tasks()),
        ("cli.rst", commands()),
        ("api.rst", names()),
    ):
        keep(folder / name, "\n".join(lines) + "\n")
    stage_pages.write(folder, keep)


def tasks():
    """Scripts of docs/tasks, as they are."""
    yield from title("Four tasks")
    yield from (
        "What many come for, in at most 15 lines each. They are tested as they stand here.",
        "",
    )
    for path in sorted(Path(__file__).parent.glob("tasks/*.py")):
        text = path.read_text()
        heading = (
            ast.get_docstring(ast.parse(text)) or path.stem.replace("_", " ").capitalize()
        ).split("\n")[0]
        yield from title(heading.rstrip("."), "-")
        yield from (".. code-block:: python", "", textwrap.indent(text, "   "), "")


def keep(path, text):
    """Write a text where it is another: Sphinx reads again what is newer than its last build."""
    if not path.is_file() or path.read_text() != text:
        path.write_text(text)


def title(text, line="="):
    """A heading."""
    return [text, line * len(text), ""]


def table(heads, rows, widths):
    """A list-table."""
    lines = [
        ".. list-table::",
        "   :header-rows: 1",
        f"   :widths: {' '.join(map(str, widths))}",
        "",
    ]
    for row in (heads, *rows):
        lines += [f"   {'*' if number == 0 else ' '} - {cell}" for number, cell in enumerate(row)]
    return [*lines, ""]


def keys():
    """Every key of a camera file."""
    yield from title("Camera keys")
    yield from textwrap.dedent("""\
        Every key of a camera file, as ``gpusim`` reads it; this page is generated from the reader and from the domain's
        classes. A key that has a unit ends in it. What a file leaves out is its base's, ``base = "phone"`` or another
        camera's file; an empty file is the phone. A file without a base gives all keys that are *wanted* here; the
        others then have the defaults.

        *A curve* is the name of a shipped curve, a ``.csv`` file beside the camera file whose first line is
        ``wavelength_nm,R,G,B`` or the like, or a table ``{wavelengths_nm = [...], R = [...], G = [...]}``.
        How the keys work together is told with examples in :doc:`../cameras`.
        """).split("\n")
    for section, known in camera_keys.SECTIONS.items():
        yield from title(f"[{section}]", "-")
        said, fields = {}, {}
        for cls in reversed(CLASSES[section]):
            fields |= {field.name: field for field in dataclasses.fields(cls)}
            said |= prose.what_is_said(
                cls.__doc__, [field.name for field in dataclasses.fields(cls)]
            )
        rows = [
            (
                f"``{key}``",
                wanted(read),
                unit(key),
                default(fields.get(field), read),
                meaning(key, field, said),
            )
            for key, (field, read) in known.items()
        ]
        yield from table(
            ("key", "value", "unit", "default", "what it is"), rows, (22, 18, 8, 10, 42)
        )


def unit(key):
    """The unit that a key ends in; the longest that is known."""
    parts = key.split("_")
    for first in range(1, len(parts)):
        if "_".join(parts[first:]) in UNITS:
            return UNITS["_".join(parts[first:])]
    return ""


def wanted(read):
    """What a reader takes, in its own words."""
    if read.__name__ in CURVES:
        return CURVES[read.__name__]
    try:
        read(object())
    except camera_keys._Wanted as error:
        return prose.escaped(str(error))
    raise ValueError(f"{read.__name__} takes anything: say what in CURVES")


def default(field, read):
    """A field's default in the file's unit."""
    if field is None:
        return ""
    value = field.default
    if value is dataclasses.MISSING:
        return "" if field.default_factory is not dataclasses.MISSING else "*wanted*"
    if value is None:
        return '``"auto"``' if '"auto"' in wanted(read) else "none"
    if isinstance(value, bool):
        return f"``{str(value).lower()}``"
    if isinstance(value, numbers.Real):
        try:
            one = read(1.0)
        except camera_keys._Wanted:
            one = 1.0
        return f"``{value / one:g}``" if isinstance(one, float) else f"``{value:g}``"
    if isinstance(value, str):
        return f'``"{value}"``'
    return (
        f"``{list(value)}``"
        if value and not isinstance(value[0], tuple)
        else "none"
        if not value
        else "sRGB's"
    )


def meaning(key, field, said):
    """What a key means, from its class's docstring. Raises KeyError for one that nothing is said of."""
    if key in SAID:
        return prose.escaped(SAID[key]).replace("[Files](../files.md)", ":doc:`../files`")
    text, together = said[field]
    text = INSIDE.sub("", text) if unit(key) else text
    others = ", ".join(f"``{name}``" for name in together if name != field)
    return prose.escaped(text[0].upper() + text[1:]) + (
        f" (told together with {others})" if others else ""
    )


def commands():
    """What every command takes, as `--help` says it."""
    yield from title("Command line")
    yield from (
        "Each command says this by ``--help``; this page is generated from the same parsers. Exit status: 0, 1 "
        "where a verification failed or a tolerance is not met, 2 for wrong input, which is said in one line "
        "with nothing half written.",
        "",
    )
    parser = cli._parser()
    found = next(
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    )
    told = {action.dest: action.help for action in found._choices_actions}
    for name, command in found.choices.items():
        command.formatter_class = lambda prog: argparse.HelpFormatter(prog, width=96)
        yield from title(f"gpusim {name}", "-")
        yield from (
            prose.escaped(told[name][0].upper() + told[name][1:]) + ".",
            "",
            ".. code-block:: none",
            "",
            textwrap.indent(command.format_help(), "   "),
            "",
        )


def names():
    """The public names, grouped by where they come from."""
    yield from title("Python names")
    yield from (
        "All of ``import gpusim as gs``. Arrays are band-major, lengths are in metres, times in seconds and "
        "wavelengths in nanometres, whatever the units of camera files.",
        "",
    )
    where = {name: place(getattr(gpusim, name)) for name in gpusim.__all__}
    left = dict(where)
    for group, modules in GROUPS.items():
        inside = [
            name
            for module in modules
            for name in left
            if f"{where[name]}.".startswith(f"{module}.")
        ]
        yield from title(group, "-")
        for name in inside:
            yield from directive(name)
            left.pop(name)
    if left:
        yield from title("More", "-")
        for name in left:
            yield from directive(name)
    yield from title("Measures", "-")
    yield from ("Of ``gpusim.measure``: what a laboratory would find.", "")
    measure = importlib.import_module("gpusim.measure")
    for name in measure.__all__:
        if name in gpusim.__all__:
            continue
        yield from directive(name, "gpusim.measure")


def place(value):
    """The module of a public name, or of one that is a module itself, below gpusim."""
    name = (
        value.__name__
        if inspect.ismodule(value)
        else getattr(value, "__module__", type(value).__module__)
    )
    return name.removeprefix("gpusim.")


def directive(name, module="gpusim"):
    """Autodoc's directive of a name; of a module, unless it can be called, those of all its names."""
    value = getattr(importlib.import_module(module), name)
    if inspect.ismodule(value) and not callable(value):
        within = [line for other in value.__all__ for line in directive(other, value.__name__)]
        return [f".. automodule:: {module}.{name}", "", *within]
    if isinstance(value, type):
        return [
            f".. autoclass:: {module}.{name}",
            "   :members:" if not issubclass(value, Exception) else "",
            "",
        ]
    return [
        f".. autofunction:: {module}.{name}"
        if callable(value)
        else f".. autodata:: {module}.{name}",
        "",
    ]


def readable(app, what, name, value, options, lines):
    """Sphinx's event: a docstring's lines, in place, as reStructuredText."""
    known = ()
    if inspect.isclass(value):
        known = (
            [field.name for field in dataclasses.fields(value)]
            if dataclasses.is_dataclass(value)
            else list(inspect.signature(value).parameters)
        )
    elif callable(value):
        known = list(inspect.signature(value).parameters)
    lines[:] = prose.rst("\n".join(lines), known)

"""Generates pages from the code and from stored results.

Camera keys come from `gpusim.domain.camera_keys` and the domain's dataclasses, stages from kernels/
and bench/results, the command line from its parsers, the public names from `gpusim.__all__`.
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
from gpusim.domain.key_words import CLASSES, default_of, describe_wanted, field_of, unit_of

INSIDE = re.compile(
    r" \[(?:m|s|rad|V|V/e-|m at the sensor)\]"
)  # units of the classes; files use other units
# keys of a file that are not fields, or whose field has another unit
SAID = {
    "focal_length_mm": "Focal length of the lens, taken as thin.",
    "pixel_pitch_um": "Distance between pixel centres, along rows and columns.",
    "defocus_diopters": "The defocus in dioptres; give only one of the two.",
    "defocus_um": "Distance of the sensor behind the image; a curve for axial colour.",
    "diffuser_um": "Standard deviation of a Gaussian diffuser, at the sensor.",
    "mask": "Mask in the pupil: a picture (its grey values are the shares of light that pass), an array of amplitudes "
    "(`.npy`, `.npz`), a name such as `mura-13` or `gaussian`, or rows of shares of light. See [Masks](../masks.md).",
    "psf": "Measured point spreads, an .npz file in the folder of the camera file: `lens.npz` in [Files](../files.md).",
    "photodetector": "A second factor of `qe`, for example for the photodiode behind the colour filters.",
    "ir_cut": 'A third factor of `qe`: the infrared filter in front of the sensor. "none": there is none.',
    "sensitivity": "Sensitivity of the whole camera, in place of `qe`, `photodetector` and `ir_cut`: a curve for "
    "each letter. Values above 1 are relative.",
    "sensitivity_peak": "Efficiency of the highest value of `sensitivity`. Without it, that of the table, at most 1.",
    "gain_e_per_dn": "The same the other way round, in place of `gain_dn_per_e`.",
    "calibration": 'A file of OpenCV, ROS or Kalibr, or `{file = ..., camera = "cam0"}`: principal point, focal '
    "lengths and distortion, see [Files](../files.md).",
    "noise_profile": "A raw photograph (DNG) whose NoiseProfile gives gain, offset and read noise.",
    "qe_ends": '"zero": light outside the table is not counted. Without it such light is refused.',
    "table": 'Filters of `demosaic = "learned"`: an .npz file of `gpusim train-l3`; without it the built-in ones.',
    "network": 'Weights of `demosaic = "network"`: an .npz file of `gpusim train-network`; else built in.',
    "photodetector_size": "Height and width of the sensitive rectangle over the pitch, instead of `fill_factor`.",
    "auto_exposure": "Method that sets the exposure time: see `AutoExposure`.",
    "conversion_gain_uv_per_e": "Conversion gain of the pixel; with `adc_range_v`, instead of `gain_dn_per_e`.",
    "adc_range_v": "Full voltage range of the converter; with `conversion_gain_uv_per_e`.",
    "temperature_c": "Temperature of the chip; it sets the dark current.",
    "reference_temperature_c": "Temperature at which `dark_current_e_per_s` and `hot_current_e_per_s` are given.",
    "doubling_k": "Temperature rise that doubles the dark current.",
    "telegraph_e": "Mean distance between the two values of a pixel with a trap.",
    "hot_current_e_per_s": "Mean additional dark current of hot pixels, at the reference temperature.",
    "seed": "Selects the chip: it determines all fixed patterns.",
    "name": "`srgb`, `display-p3`, or a measured display; or your own name together with the keys below.",
}
RESULTS = {  # pictures that the scripts in docs/tasks saved, see pictures.py
    "1_own_camera": "own_camera",
    "2_pairs": "astronaut",
    "3_mitsuba": "focus",
    "4_pixel_sizes": "pixel_sizes",
}
GROUPS = {  # by the module of a public name, in the order of the page
    "Simulate": (
        "pipeline.simulator",
        "pipeline.exposure",
        "pipeline.frame",
        "pipeline.loop",
        "pipeline.report",
        "apps.tensors.batches",
        "backends",
        "domain.account",
        "domain.errors",
    ),
    "Cameras": (
        "io.camera.cameras",
        "io.databases.catalogue",
        "apps.named.compose",
        "domain.camera",
        "domain.optics",
        "domain.mask",
        "domain.sensor",
        "domain.noise",
        "domain.exposure",
        "domain.processor",
        "domain.display",
        "data.displays",
        "pipeline.readout",
    ),
    "Calibration": (
        "domain.calibration",
        "io.camera",
        "domain.psf",
        "measure.photon_transfer",
    ),
    "Light fields": (
        "domain.light_field",
        "domain.view_images",
        "captures.pinholes",
        "captures.views",
        "captures.refocus",
        "captures.slices",
        "captures.view_depth",
        "io.scene.light_fields",
        "io.frame.view_images",
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
    "Things that move": ("domain.motion", "domain.animation", "domain.flicker"),
    "Several exposures": ("captures", "io.frame"),
    "Preview and pictures": ("apps.preview", "plot"),
}


def write(folder):
    """Write all pages into a folder, which may contain pages of an earlier build."""
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
    """Yield the page of the scripts in docs/tasks."""
    yield from title("Four tasks")
    yield from (
        "Common tasks in at most 15 lines each, with the pictures that they save. The scripts are tested exactly as "
        "printed.",
        "",
    )
    for path in sorted(Path(__file__).parent.glob("tasks/*.py")):
        text = path.read_text()
        heading = (
            ast.get_docstring(ast.parse(text)) or path.stem.replace("_", " ").capitalize()
        ).split("\n")[0]
        yield from title(heading.rstrip("."), "-")
        yield from (".. code-block:: python", "", textwrap.indent(text, "   "), "")
        yield from (f".. image:: ../pictures/tasks/{RESULTS[path.stem]}.png", "   :width: 100%", "")


def keep(path, text):
    """Write a text if it has changed, since Sphinx reads all newer files again."""
    if not path.is_file() or path.read_text() != text:
        path.write_text(text)


def title(text, line="="):
    """Return the lines of a heading."""
    return [text, line * len(text), ""]


def table(heads, rows, widths):
    """Return the lines of a list-table."""
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
    """Yield the page of the keys of camera files."""
    yield from title("Camera keys")
    yield from textwrap.dedent("""\
        Every key of a camera file. This page is generated from the reader and from the domain's classes. The name of a
        key ends in its unit, if it has one. Keys that a file leaves out come from its base, the name of a camera or
        another camera's file; without ``base`` from the phone. A file with ``base = "none"`` must give all keys that
        are *wanted* here; the others have the defaults.

        *A curve* is the name of a shipped curve, a ``.csv`` file in the folder of the camera file with a first line
        like ``wavelength_nm,R,G,B``, or a table ``{wavelengths_nm = [...], R = [...], G = [...]}``.
        :doc:`../cameras` has examples.
        """).split("\n")
    for section, known in camera_keys.SECTIONS.items():
        yield from title(f"[{section}]", "-")
        said = {}
        for cls in reversed(CLASSES[section]):
            names = [field.name for field in dataclasses.fields(cls)]
            said |= prose.parameter_texts(cls.__doc__, names)
        rows = [
            (
                f"``{key}``",
                prose.escaped(describe_wanted(read)),
                unit_of(key),
                default(section, key),
                meaning(key, field, said),
            )
            for key, (field, read) in known.items()
        ]
        yield from table(("key", "value", "unit", "default", "meaning"), rows, (22, 18, 8, 10, 42))


def default(section, key):
    """Return the default of a key as it stands on the page."""
    field = field_of(section, key)
    if field is None:
        return ""
    if field.default is dataclasses.MISSING:
        return "" if field.default_factory is not dataclasses.MISSING else "*wanted*"
    value = default_of(section, key)
    if value is None or value == []:
        return "none"
    if isinstance(value, bool):
        return f"``{str(value).lower()}``"
    if isinstance(value, numbers.Real):
        return f"``{value:g}``"
    if isinstance(value, str):
        return f'``"{value}"``'
    return "sRGB's" if isinstance(value[0], list) else f"``{value}``"


def meaning(key, field, said):
    """Return the meaning of a key, from its class's docstring. Raises KeyError for a key without one."""
    if key in SAID:
        return prose.escaped(SAID[key]).replace("[Files](../files.md)", ":doc:`../files`")
    text, together = said[field]
    text = INSIDE.sub("", text) if unit_of(key) else text
    others = ", ".join(f"``{name}``" for name in together if name != field)
    return prose.escaped(text[0].upper() + text[1:]) + (
        f" (together with {others})" if others else ""
    )


def commands():
    """Yield the page of the commands, with their help texts."""
    yield from title("Command line")
    yield from (
        "This page is generated from the parsers and equals the output of ``--help``. Exit status: 0; 1 if a "
        "verification failed or a tolerance is not met; 2 for wrong input, with a one-line message and no "
        "half-written files.",
        "",
    )
    yield from _commands_of("gpusim", cli._parser(), "-")


def _commands_of(name, parser, line):
    """Yield the help texts of a parser's commands, and of their subcommands."""
    found = [one for one in parser._actions if isinstance(one, argparse._SubParsersAction)]
    for action in found:
        texts = {choice.dest: choice.help for choice in action._choices_actions}
        for word, command in action.choices.items():
            command.formatter_class = lambda prog: argparse.HelpFormatter(prog, width=96)
            yield from title(f"{name} {word}", line)
            yield from (
                prose.escaped(texts[word][0].upper() + texts[word][1:]) + ".",
                "",
                ".. code-block:: none",
                "",
                textwrap.indent(command.format_help(), "   "),
                "",
            )
            yield from _commands_of(f"{name} {word}", command, "^")


def names():
    """Yield the page of the public names, grouped by module."""
    yield from title("Python names")
    yield from (
        "All of ``import gpusim as gs``. Arrays are band-major, lengths are in metres, times in seconds and "
        "wavelengths in nanometres, regardless of the units in camera files.",
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
    yield from ("Functions of ``gpusim.measure``, as a laboratory would measure.", "")
    measure = importlib.import_module("gpusim.measure")
    for name in measure.__all__:
        if name in gpusim.__all__:
            continue
        yield from directive(name, "gpusim.measure")


def place(value):
    """Return the module of a public name, or the name of a public module, without `gpusim.`."""
    name = (
        value.__name__
        if inspect.ismodule(value)
        else getattr(value, "__module__", type(value).__module__)
    )
    return name.removeprefix("gpusim.")


def directive(name, module="gpusim"):
    """Return the autodoc directive for a name; for a module that is not callable, for all its names."""
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
    """Handle Sphinx's event: convert a docstring's lines to reStructuredText in place."""
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

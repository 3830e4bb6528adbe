"""Measures of a study: numbers from the picture of one camera in one scene."""

import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from gpusim.apps.study.scenes import StudyScene, block_means, encode
from gpusim.apps.study.shot import Shot
from gpusim.domain.errors import (
    BadData,
    GpusimError,
    UnknownName,
    format_value,
    one_line,
)
from gpusim.domain.short_repr import short_repr
from gpusim.measure import ciede2000, cpsnr, mtf50, sfr
from gpusim.measure.snr import dynamic_range

MARGIN = 10  # [pixel] at each border that CPSNR leaves out
MOST_ROWS = 256  # of the picture from which its response is measured
AROUND = 60  # [pixel] on each side of a slanted edge that its response is measured from
TILT = math.tan(math.radians(5))  # of the edge of the chart


def measure_snr(shot: Shot) -> float:
    """Return the mean over the RMS difference from the noise-free picture, of the brightest channel [dB].

    Temporal noise and fixed patterns count. The noise-free picture is scaled to the same mean.
    """
    ratios = []
    for raw, mean in shot.channels_of_patch():
        signal = float(raw.mean())
        if signal > 0:
            rest = raw - mean * (signal / mean.mean())
            ratios.append((signal, float(np.sqrt(np.mean(rest**2)))))
    if not ratios:
        raise BadData("snr: no signal above the black level")
    signal, noise = max(ratios)
    return 20 * math.log10(signal / noise) if noise else math.inf


def measure_mtf50(shot: Shot) -> float:
    """Return the frequency at which the contrast of the edge's luminance is one half [cycle/pixel]."""
    if "mtf50" not in shot.kept:
        shot.kept["mtf50"] = _edge_frequency(shot)
    return shot.kept["mtf50"]


def _edge_frequency(shot):
    rows, cols = shot.planes.shape[1:]
    window = shot.place.patch
    if window is None:
        high = min(rows, MOST_ROWS)
        half, top = math.ceil(high / 2 * TILT) + AROUND, (rows - high) // 2
        window = top, max(cols // 2 - half, 0), top + high, min(cols // 2 + half, cols)
    top, left, bottom, right = window
    luminance = shot.planes[:, top:bottom, left:right]
    luminance = np.tensordot(shot.camera.display.xyz_from_rgb[1], luminance, 1)
    return float(mtf50(sfr(luminance)))


def measure_mtf50_per_mm(shot: Shot) -> float:
    """Return `measure_mtf50` on the sensor [cycle/mm]."""
    return measure_mtf50(shot) / (1e3 * shot.camera.sensor.pixel_pitch)


def measure_de(shot: Shot) -> float:
    """Return the mean CIEDE2000 against the scene on the display, without lens and noise.

    Mean colours are compared: of the patches of a ColorChecker, of squares of 8 pixels in other scenes. The
    exposure is divided out.
    """
    checker = shot.place.checker
    if checker is not None and checker.shape == shot.planes.shape[1:]:
        display = shot.camera.display
        return float(checker.differences(shot.linear, shot.rendering.diffuser, display).mean())
    matrix = shot.camera.display.xyz_from_rgb
    shown = block_means(shot.shown) @ matrix.T
    return float(ciede2000(shown, shot.ideal.blocks, matrix.sum(1)).mean())


def measure_cpsnr(shot: Shot) -> float:
    """Return the CPSNR of the display codes against those of the scene without lens and noise [dB].

    The exposure is divided out, and both have the display's curve and no other tone curve.
    """
    mine, true = encode(shot.camera.display, shot.shown), shot.ideal.codes
    cut = [
        slice(MARGIN, count - MARGIN) if count > 3 * MARGIN else slice(None)
        for count in mine.shape[1:]
    ]
    mine, true = (np.moveaxis(one[:, *cut], 0, -1) for one in (mine, true))
    return cpsnr(mine, true, border=0)


def measure_dynamic_range(shot: Shot) -> float:
    """Return the sensor's dynamic range at this exposure time and gain, as EMVA 1288 defines it [dB]."""
    return dynamic_range(shot.camera.sensor, seconds=shot.exposure_time)


@dataclass(frozen=True)
class BuiltIn:
    """A measure that studies know by name.

    Args:
        function: The function.
        unit: Unit of its value.
        fits: Whether it is made in a scene unless the design names scenes.
        is_low: Whether a lower value is better.
    """

    function: Callable[[Shot], float]
    unit: str
    fits: Callable[[StudyScene], bool]
    is_low: bool = False

    __repr__ = short_repr


def _has_colors(place):
    return place.scene.light_is_known and place.scene.view.is_plain


def _has_edge(place):
    return place.scene.name == "slanted-edge"


BUILT_IN = {
    "snr": BuiltIn(measure_snr, "dB", lambda place: True),
    "mtf50": BuiltIn(measure_mtf50, "cycle/pixel", _has_edge),
    "mtf50_per_mm": BuiltIn(measure_mtf50_per_mm, "cycle/mm", _has_edge),
    "de": BuiltIn(measure_de, "CIEDE2000", _has_colors, is_low=True),
    "cpsnr": BuiltIn(measure_cpsnr, "dB", _has_colors),
    "dynamic_range": BuiltIn(measure_dynamic_range, "dB", lambda place: True),
}


@dataclass(frozen=True)
class Measure:
    """A measure and the scenes in which it is made.

    Args:
        name: Its name.
        function: From a `Shot` to a number.
        scenes: Names of the scenes.
        unit: Unit of its value, "" if it is not known.
        is_own: Whether the function is the user's, whose errors may be of any class.
    """

    name: str
    function: Callable[[Shot], Any] = field(repr=False)
    scenes: tuple[str, ...]
    unit: str = ""
    is_own: bool = False

    __repr__ = short_repr

    @classmethod
    def parse(
        cls, name: str, given: Any, places: Mapping[str, StudyScene], folder: Path
    ) -> "Measure":
        """Return a measure of a study file.

        Args:
            name: Its name: a built-in one, or any for an own function.
            given: true (all scenes that it fits), a scene, a list of scenes, or a table of scenes, function, unit.
            places: The scenes of the study by name.
            folder: Folder of the study file, whose modules an own function may be in.

        Raises:
            BadData: The entry has another form, or the function cannot be used.
            UnknownName: There is no such measure, scene or key.
        """
        table = dict(given) if isinstance(given, Mapping) else {"scenes": given}
        for key in table:
            if key not in ("scenes", "function", "unit"):
                raise UnknownName(f"key of measure {name}", key, ("scenes", "function", "unit"))
        scenes = table.get("scenes", True)
        names = [scenes] if isinstance(scenes, str) else scenes
        if names is not True and not (isinstance(names, list | tuple) and names):
            raise BadData(
                f"measure {name} = {format_value(given)}: wanted true, a scene, a list of scenes, or a table"
            )
        for scene in names if names is not True else ():
            if scene not in places:
                raise UnknownName(f"scene of measure {name}", str(scene), places)
        if "function" in table:
            chosen = tuple(places if names is True else names)
            function = _own_function(name, table["function"], folder)
            return cls(name, function, chosen, str(table.get("unit", "")), is_own=True)
        if name not in BUILT_IN:
            raise UnknownName("measure", name, BUILT_IN)
        known = BUILT_IN[name]
        if names is True:
            names = [scene for scene, place in places.items() if known.fits(place)]
        if not names:
            raise BadData(f"measure {name}: no scene of the study fits it; name one as its scene")
        return cls(name, known.function, tuple(names), known.unit)

    def make(self, shot: Shot) -> float:
        """Return the number. Raises BadData, or an error of GpusimError for a picture that has none."""
        if not self.is_own:
            return float(self.function(shot))
        try:
            return float(self.function(shot))
        except GpusimError:
            raise
        except Exception as error:  # the user's own
            raise BadData(f"{type(error).__name__}: {one_line(error)}") from error


def _own_function(name, given, folder) -> Callable[[Shot], Any]:
    """Return the function of "module:function", whose module may be next to the study file. Raises BadData."""
    if callable(given):
        return given
    module, colon, function = given.partition(":") if isinstance(given, str) else ("", "", "")
    if not (module and colon and function):
        raise BadData(f'measure {name}: function = {format_value(given)}, wanted "module:function"')
    sys.path.insert(0, str(folder))
    try:
        found = getattr(import_module(module), function, None)
    except Exception as error:  # of the user's module
        raise BadData(
            f"measure {name}: {module} cannot be imported: {one_line(error, 200)}"
        ) from error
    finally:
        sys.path.remove(str(folder))
    if not callable(found):
        raise BadData(f"measure {name}: {module} has no function {format_value(function)}")
    return found

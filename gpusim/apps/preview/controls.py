"""Controls of the preview's page: keys of a camera file, with their ranges and groups."""

from dataclasses import dataclass
from math import inf, log
from typing import Any

from gpusim.domain.errors import BadData, OutOfRange, format_value
from gpusim.domain.processor import COLORS, DEFECTS, DEMOSAICS, SCALINGS, WHITE_BALANCES

PLACES = 1000  # of a slider
BEYOND, BEYOND_LOG = 2, 10  # a number that is typed may be as many times as large as a slider's end
OWN = "the scene's"  # light
LIGHTS = (
    "D65",
    "D50",
    "A",
    "FL2",
    "FL11",
    "LED-B1",
    "LED-B5",
    "LED-RGB1",
    "daylight-10000K",
    "blackbody-2000K",
)
TOLERANCES = ("exact", "preview", "video", "metrology", "1e-2", "1e-3", "1e-4", "1e-5")
FILES = "the camera's"  # tone curve
# of sRGB values: a little contrast, dark parts lifted, bright parts held back
TONES = {
    FILES: None,
    "none": [],
    "contrast": [[0, 0], [0.25, 0.2], [0.75, 0.82], [1, 1]],
    "shadows": [[0, 0], [0.1, 0.17], [0.3, 0.4], [1, 1]],
    "highlights": [[0, 0], [0.5, 0.5], [0.8, 0.72], [1, 0.9], [2, 1]],
}
VIEWS = ("rendered", "raw", "electrons", "noise")


@dataclass(frozen=True)
class Control:
    """One key of a camera file.

    Attributes:
        section: Section of the file.
        key: Key of the section.
        item: Index in the key's list, or None.
        label, unit: Texts of the page.
        low, high: Ends of the slider.
        is_log: Whether the slider is even in the logarithm.
        choices: Choices in place of a slider.
        off: Value for "none", which a switch next to the slider sets.
        default: Value if neither the file nor the class has one.
        named: Choice -> value in the file. None, of the first choice: the file's own value.
    """

    section: str
    key: str
    label: str
    low: float = 0.0
    high: float = 1.0
    unit: str = ""
    is_log: bool = False
    choices: tuple[Any, ...] = ()
    item: int | None = None
    off: Any = None
    default: Any = None
    named: dict[str, Any] | None = None

    @property
    def name(self) -> str:
        """Name of the control, for links and tests."""
        return f"{self.section}.{self.key}" + ("" if self.item is None else f".{self.item}")

    def to_place(self, value: float) -> int:
        """Return the place of the slider for a value, 0 .. PLACES."""
        low, high = self.low, self.high
        value = min(max(value, low), high)
        part = log(value / low) / log(high / low) if self.is_log else (value - low) / (high - low)
        return round(PLACES * part)

    def to_value(self, place: int) -> float:
        """Return the value at a place of the slider, to four digits."""
        low, high = self.low, self.high
        part = place / PLACES
        value = low * (high / low) ** part if self.is_log else low + (high - low) * part
        return float(f"{value:.4g}")

    def check(self, value):
        """Raise BadData or OutOfRange for a value that the control cannot set.

        A typed number may lie a little beyond the slider's ends. Far beyond, a picture would take
        minutes.
        """
        if self.choices:
            if not any(type(value) is type(one) and value == one for one in self.choices):
                known = ", ".join(map(str, self.choices))
                raise BadData(f"{self.label} = {format_value(value)}: wanted one of {known}")
            return
        if self.off is not None and type(value) is type(self.off) and value == self.off:
            return
        if type(value) not in (int, float):
            or_off = f", or {self.off}" if self.off is not None else ""
            raise BadData(f"{self.label} = {format_value(value)}: wanted a number{or_off}")
        low, high = min(self.low, 0) * BEYOND, self.high * BEYOND
        if self.is_log:
            low, high = self.low / BEYOND_LOG, self.high * BEYOND_LOG
        if not low <= value <= high:
            allowed = f"{low:g} .. {high:g}"
            raise OutOfRange(self.label, f"{format_value(value)} {self.unit}".rstrip(), allowed)


def _log(section, key, label, low, high, unit="", off=None, default=None):
    return Control(section, key, label, low, high, unit, is_log=True, off=off, default=default)


def _choice(section, key, label, choices, default, named=None):
    return Control(section, key, label, choices=choices, named=named, default=default)


def _noise(key, label, high, unit, low):
    return _log("noise", key, label, low, high, unit, off=0.0, default=0.0)


def _zernike(label, item):
    none = (0.0,) * 11
    return Control("optics", "zernike_waves", label, -0.5, 0.5, "waves", item=item, default=none)


# Places in Noll's order of aberrations that are the same all over the field; those that vary take
# seconds to plan
ZERNIKE = {"astigmatism": 5, "coma": 7, "spherical": 10}
WHITES = tuple(name for name in WHITE_BALANCES if name != "preset")
GROUPS: dict[str, tuple[Control, ...]] = {
    "Exposure": (
        _log(
            "sensor", "exposure_time_ms", "exposure", 0.01, 1000.0, "ms", off="auto", default="auto"
        ),
        _log("sensor", "analog_gain", "gain", 1.0, 32.0, default=1.0),
    ),
    "Lens": (
        _log("optics", "f_number", "f-number", 0.7, 32.0),
        _log("optics", "object_distance_m", "focus", 0.1, 1000.0, "m", off=inf, default=inf),
        Control("optics", "defocus_um", "defocus", -50.0, 50.0, "um", default=0.0),
        *(_zernike(label, item) for label, item in ZERNIKE.items()),
    ),
    "Sensor": (
        _log("sensor", "pixel_pitch_um", "pixel pitch", 0.5, 12.0, "um"),
        Control("sensor", "fill_factor", "fill factor", 0.05, 1.0, default=1.0),
        _log("sensor", "full_well_e", "full well", 100.0, 1e5, "e-", default=10000.0),
        _choice("sensor", "bits", "bits", (8, 10, 12, 14, 16), 10),
    ),
    "Noise": (
        _choice("noise", "photon", "photon noise", ("fast", "exact", "none"), "fast"),
        _noise("read_e", "read", 50.0, "e-", 0.1),
        _noise("dark_current_e_per_s", "dark current", 1e4, "e-/s", 0.01),
        _noise("dsnu_e", "DSNU", 50.0, "e-", 0.01),
        _noise("prnu", "PRNU", 0.2, "", 1e-4),
        _noise("row_e", "row", 20.0, "e-", 0.01),
        _noise("column_e", "column", 20.0, "e-", 0.01),
        _noise("row_prnu", "row PRNU", 0.1, "", 1e-4),
        _noise("column_prnu", "column PRNU", 0.1, "", 1e-4),
        _noise("adc_dn", "converter", 16.0, "DN", 0.01),
        _noise("hot_pixels", "hot pixels", 0.1, "", 1e-6),
        _noise("dead_pixels", "dead pixels", 0.1, "", 1e-6),
        Control("noise", "temperature_c", "temperature", -20.0, 100.0, "deg C", default=25.0),
    ),
    "Processor": (
        _choice("processor", "defects", "defects", DEFECTS, "none"),
        Control("processor", "denoise", "denoising", 0.0, 4.0, default=0.0),
        _choice("processor", "demosaic", "demosaicking", DEMOSAICS, "bilinear"),
        _choice("processor", "white_balance", "white balance", WHITES, "illuminant"),
        _choice("processor", "color", "colour", COLORS, "white-preserving"),
        _choice("processor", "tone", "tone curve", tuple(TONES), (), named=TONES),
        _choice("processor", "shading", "shading correction", (False, True), False),
        _choice("processor", "scaling", "scaling", SCALINGS, "exposure"),
    ),
}
LUMINANCE = _log("scene", "luminance", "white", 0.1, 1e5, "cd/m2")  # of the scene, not the camera
CONTROLS = {control.name: control for group in GROUPS.values() for control in group}

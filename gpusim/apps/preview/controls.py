"""Controls of the preview: one for each key of a camera file, with its range and its group."""

from collections.abc import Iterable
from math import inf

from gpusim.apps.preview.control import Control
from gpusim.data.curves import CHANNELS
from gpusim.data.displays import display_names
from gpusim.domain.camera_keys import SECTIONS
from gpusim.domain.exposure import METHODS
from gpusim.domain.key_words import AUTO, default_of, describe_wanted, unit_of
from gpusim.domain.mosaics import MOSAICS
from gpusim.domain.optics import MODELS
from gpusim.domain.processor import (
    COLORS,
    DEFECTS,
    DEMOSAICS,
    DENOISERS,
    GAMUTS,
    HIGHLIGHTS,
    LOOKS,
    SCALINGS,
    WHITE_BALANCES,
)
from gpusim.domain.tone import TONES as TONES_BY_NAME

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
    **{name: name for name in TONES_BY_NAME},
}
VIEWS = ("rendered", "raw", "electrons", "noise", "scene", "irradiance")


def _make(section, key, label, **options):
    unit = "" if options.get("is_text") else unit_of(key)
    options = {"unit": unit, "default": default_of(section, key)} | options
    if options["default"] == AUTO:
        options.setdefault("off", AUTO)
    return Control(section, key, label, **options)


def _log(section, key, label, low, high, **options):
    return _make(section, key, label, low=low, high=high, is_log=True, **options)


def _linear(section, key, label, low, high, **options):
    return _make(section, key, label, low=low, high=high, **options)


def _choice(section, key, label, choices, named=None, **options):
    if named:
        options["default"] = ()
    return _make(section, key, label, choices=choices, named=named, unit="", **options)


def _text(section, key, label, suggested: Iterable[str] = ()):
    words = describe_wanted(SECTIONS[section][key][1])
    return _make(section, key, label, is_text=True, suggested=tuple(suggested), words=words)


def _noise(key, label, low, high):
    return _log("noise", key, label, low, high, off=0.0, default=0.0)


def _items(key, labels, low, high, count):
    """Return a slider for each item of a list of optics; labels: index -> label."""
    none = (0.0,) * count
    return tuple(
        _linear("optics", key, label, low, high, item=item, default=none)
        for item, label in labels.items()
    )


# places in Noll's order, from 0
ZERNIKE = {
    3: "defocus (Z4)",
    4: "astigmatism 45 (Z5)",
    5: "astigmatism (Z6)",
    6: "coma along rows (Z7)",
    7: "coma (Z8)",
    8: "trefoil (Z9)",
    9: "trefoil 30 (Z10)",
    10: "spherical (Z11)",
}
SEIDEL = (
    "spherical W040",
    "coma W131",
    "astigmatism W222",
    "field curvature W220",
    "distortion W311",
)
WHITES = tuple(name for name in WHITE_BALANCES if name != "preset")
FACTORS = [name for name, letters in CHANNELS.items() if not letters]
GROUPS: dict[str, tuple[Control, ...]] = {
    "Exposure": (
        _log("sensor", "exposure_time_ms", "exposure", 0.01, 1000.0),
        _log("sensor", "analog_gain", "gain", 1.0, 32.0),
        _choice("sensor", "auto_exposure", "metering", METHODS, item="method", default=METHODS[0]),
        _linear(
            "sensor",
            "auto_exposure",
            "metering level",
            0.05,
            1.0,
            item="level",
            unit="",
            default=None,
        ),
        _linear(
            "sensor",
            "auto_exposure",
            "metering percentile",
            50.0,
            100.0,
            item="percentile",
            unit="%",
            default=99.0,
        ),
        _log(
            "sensor",
            "auto_exposure",
            "longest exposure",
            0.1,
            1e4,
            item="longest_ms",
            unit="ms",
            default=None,
        ),
        _log(
            "sensor",
            "auto_exposure",
            "most gain",
            1.0,
            64.0,
            item="most_gain",
            unit="",
            default=1.0,
        ),
        _linear("sensor", "row_time_us", "row time", 0.0, 100.0),
    ),
    "Lens": (
        _log("optics", "f_number", "f-number", 0.7, 32.0),
        _log("optics", "object_distance_m", "focus", 0.1, 1000.0, off=inf),
        _linear("optics", "defocus_um", "defocus", -50.0, 50.0),
        _linear("optics", "defocus_diopters", "defocus in dioptres", -10.0, 10.0),
        _log("optics", "focal_length_mm", "focal length", 1.0, 200.0),
        _linear(
            "optics", "pupil", "blades", 0, 16, item="blades", is_whole=True, unit="", default=0
        ),
        _linear(
            "optics", "pupil", "obscuration", 0.0, 0.7, item="obscuration", unit="", default=0.0
        ),
        _linear(
            "optics",
            "pupil",
            "pupil rotation",
            0.0,
            90.0,
            item="rotation_deg",
            unit="degree",
            default=0.0,
        ),
        _text("optics", "mask", "mask in the pupil", ("mura-7", "gaussian")),
        _choice("optics", "model", "model", MODELS),
        _text("optics", "psf", "measured PSF"),
    ),
    "Aberrations": (
        *_items("zernike_waves", ZERNIKE, -0.5, 0.5, 11),
        _text("optics", "zernike_waves", "Zernike, all"),
        _text("optics", "zernike_heights", "Zernike heights"),
        *_items("seidel_waves", dict(enumerate(SEIDEL)), -2.0, 2.0, 5),
        _linear("optics", "reference_nm", "reference wavelength", 400.0, 700.0),
    ),
    "Lens: light and geometry": (
        _linear("optics", "transmission", "transmission", 0.0, 1.0, unit=""),
        _text("optics", "relative_illumination", "relative illumination", ("cos4", "none")),
        _linear("optics", "diffuser_um", "diffuser", 0.0, 10.0),
        _text("optics", "birefringence_um", "low-pass plate"),
        _linear("optics", "lateral_color", "lateral colour", -0.01, 0.01, unit=""),
        _text("optics", "distortion", "distortion"),
        _text("optics", "calibration", "calibration"),
    ),
    "Sensor": (
        _text("sensor", "cfa", "mosaic", MOSAICS),
        _log("sensor", "pixel_pitch_um", "pixel pitch", 0.5, 12.0),
        _linear("sensor", "fill_factor", "fill factor", 0.05, 1.0),
        _text("sensor", "photodetector_size", "photodetector size"),
        _text("sensor", "photodetector_centre", "photodetector centre"),
        _text("sensor", "offset", "offset of the chip"),
        _text("sensor", "microlens", "microlens"),
        _text("sensor", "lenslets", "lenslet array"),
        _text("sensor", "dual", "dual pixels"),
        _text("sensor", "vignetting", "pixel vignetting"),
        _choice("sensor", "stacked", "stacked pixels", (False, True)),
        _text("sensor", "binning", "binning", ("[1, 1]", "[2, 2]", "[3, 3]", "[4, 4]")),
        _choice("sensor", "binning_mode", "binning of", ("charge", "digital")),
    ),
    "Filters": (
        _text(
            "sensor", "qe", "quantum efficiency", [name for name in CHANNELS if name not in FACTORS]
        ),
        _text("sensor", "qe_ends", "beyond the table", ("zero",)),
        _text("sensor", "ir_cut", "infrared filter", ("none", *FACTORS)),
        _text("sensor", "photodetector", "photodetector", FACTORS),
        _text("sensor", "sensitivity", "sensitivity"),
        _linear("sensor", "sensitivity_peak", "sensitivity peak", 0.01, 1.0),
    ),
    "Converter": (
        _log("sensor", "full_well_e", "full well", 100.0, 1e5),
        _choice("sensor", "bits", "bits", (8, 10, 12, 14, 16)),
        _linear("sensor", "black_level_dn", "black level", 0, 1024, is_whole=True),
        _log("sensor", "gain_dn_per_e", "conversion gain", 0.001, 100.0),
        _log("sensor", "gain_e_per_dn", "electrons per DN", 0.01, 100.0),
        _log("sensor", "conversion_gain_uv_per_e", "pixel's conversion gain", 1.0, 500.0),
        _log("sensor", "adc_range_v", "converter's range", 0.1, 5.0),
        _linear("sensor", "analog_offset_e", "analog offset", -100.0, 1000.0),
        _text("sensor", "noise_profile", "noise profile"),
    ),
    "Noise": (
        _choice("noise", "photon", "photon noise", ("fast", "exact", "none")),
        _noise("read_e", "read", 0.1, 50.0),
        _log("noise", "reset_e", "reset", 0.1, 100.0, off="kTC"),
        _noise("dark_current_e_per_s", "dark current", 0.01, 1e4),
        _linear("noise", "temperature_c", "temperature", -20.0, 100.0),
        _linear("noise", "reference_temperature_c", "at temperature", -20.0, 100.0),
        _log("noise", "doubling_k", "doubles in", 2.0, 20.0),
        _noise("adc_dn", "converter", 0.01, 16.0),
        _noise("telegraph_pixels", "telegraph pixels", 1e-6, 0.1),
        _noise("telegraph_e", "telegraph step", 0.1, 100.0),
        _log("noise", "telegraph_switching", "telegraph switching", 1e-3, 1.0),
    ),
    "Fixed patterns": (
        _noise("dsnu_e", "DSNU", 0.01, 50.0),
        _noise("prnu", "PRNU", 1e-4, 0.2),
        _noise("row_e", "row", 0.01, 20.0),
        _noise("column_e", "column", 0.01, 20.0),
        _noise("row_dsnu_e", "row DSNU", 0.01, 50.0),
        _noise("column_dsnu_e", "column DSNU", 0.01, 50.0),
        _noise("row_prnu", "row PRNU", 1e-4, 0.1),
        _noise("column_prnu", "column PRNU", 1e-4, 0.1),
        _noise("hot_pixels", "hot pixels", 1e-6, 0.1),
        _noise("hot_current_e_per_s", "hot current", 1.0, 1e5),
        _noise("dead_pixels", "dead pixels", 1e-6, 0.1),
        _linear("noise", "seed", "chip", 0, 1000, is_whole=True),
    ),
    "Processor": (
        _choice("processor", "look", "look", tuple(LOOKS)),
        _choice("processor", "defects", "defects", DEFECTS),
        _linear("processor", "denoise", "denoising", 0.0, 4.0),
        _choice("processor", "denoise_by", "denoised", DENOISERS),
        _choice("processor", "demosaic", "demosaicking", DEMOSAICS),
        _text("processor", "table", "learned filters"),
        _text("processor", "network", "network's weights"),
        _choice("processor", "white_balance", "white balance", (*WHITES, "preset")),
        _text("processor", "white", "preset white"),
        _choice("processor", "color", "colour", COLORS),
        _text(
            "processor",
            "training",
            "colours to fit",
            ("macbeth", "munsell", "dupont", "objects", "nature", "skin"),
        ),
        _text("processor", "target", "light to render for", ("D65", "D50", "A")),
        _choice("processor", "tone", "tone curve", tuple(TONES), named=TONES),
        _linear("processor", "sharpen", "sharpening", 0.0, 2.0),
        _linear("processor", "local_tone", "local tone", 0.0, 1.0),
        _choice("processor", "highlights", "highlights", (AUTO, *HIGHLIGHTS)),
        _choice("processor", "gamut", "gamut", (AUTO, *GAMUTS)),
        _choice("processor", "shading", "shading correction", (AUTO, False, True)),
        _choice("processor", "lens_corrections", "lens corrections", (AUTO, False, True)),
        _choice("processor", "scaling", "scaling", SCALINGS),
    ),
    "Display": (
        _text("display", "name", "display", display_names()),
        _text("display", "primaries", "primaries"),
        _text("display", "white", "white"),
        _text("display", "curve", "curve", ("srgb", "2.2")),
        _log("display", "luminance_cd_per_m2", "luminance", 10.0, 10000.0),
    ),
}
# of the scene, not the camera
LUMINANCE = Control("scene", "luminance", "luminance of white", 0.1, 1e5, "cd/m2", is_log=True)
CONTROLS = {control.name: control for group in GROUPS.values() for control in group}

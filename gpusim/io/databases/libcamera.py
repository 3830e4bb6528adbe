"""Tuning files of Raspberry Pi's cameras: libcamera's JSON."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gpusim.data.srgb import srgb_to_xyz
from gpusim.domain.errors import BadFile
from gpusim.io.databases.json_text import list_of, number_of, numbers_of, read_json

WHAT = "a tuning file of libcamera"
FULL = 65535.0  # levels count as 16 bits
SHADING = (12, 16), (32, 32)  # rows and columns of shading tables: Pi 1 to 4, Pi 5
# Columns, rows, pixel pitch [um] and bits of the sensors' data sheets, which tuning files do not have
SENSORS = {
    "imx219": (3280, 2464, 1.12, 10),
    "imx290": (1920, 1080, 2.9, 12),
    "imx296": (1456, 1088, 3.45, 10),
    "imx378": (4056, 3040, 1.55, 12),
    "imx477": (4056, 3040, 1.55, 12),
    "imx519": (4656, 3496, 1.22, 10),
    "imx708": (4608, 2592, 1.4, 10),
    "ov5647": (2592, 1944, 1.4, 10),
    "ov9281": (1280, 800, 3.0, 10),
}


@dataclass(frozen=True)
class Tuning:
    """A sensor with its lens, as the tuning tool measured it.

    Attributes:
        name: Of the file.
        black: Black level over white level [1].
        noise: Constant c and slope s of the standard deviation c + s sqrt(v) of values v of 16 bits
            above black, at gain 1; None if the file has none.
        matrices: (temperature [K], matrix) pairs from white-balanced channels to linear sRGB, (3, 3).
        whites: (temperature [K], red over green, blue over green) of white.
        shading: Light of the lens over the frame, green, 1 at the brightest place, or None.
        file: The file.
    """

    name: str
    black: float
    noise: tuple[float, float] | None
    matrices: tuple[tuple[float, np.ndarray], ...]
    whites: tuple[tuple[float, float, float], ...]
    shading: np.ndarray | None
    file: Path

    @property
    def is_mono(self) -> bool:
        """Whether the sensor has no colours."""
        return "mono" in self.name

    def slopes(self) -> tuple[float, float]:
        """Return a and b of the variance a x + b at gain 1, x from 0 at black to 1 at white.

        v is x (1 - black) 65535; its standard deviation is c + s sqrt(v). The mixed term 2 c s
        sqrt(v) has no place in a line and is left out; c is 0 in all files of Raspberry Pi.
        """
        if self.noise is None:
            raise BadFile(self.file, "has no rpi.noise with a slope above 0")
        constant, slope = self.noise
        full = FULL * (1 - self.black)
        return slope**2 / full, (constant / full) ** 2

    def nearest(self, temperature: float) -> tuple[np.ndarray, float] | None:
        """Return the matrix from XYZ of a surface in D65 to the channels, and its own temperature [K].

        The measured matrix makes linear sRGB from channels that white balance has made equal for
        white; so the channels are white times the inverse of it. None: the file has no matrix.

        Args:
            temperature: Of the light [K]; the nearest entry is taken.
        """
        if not self.matrices or not self.whites:
            return None
        own, matrix = min(self.matrices, key=lambda one: abs(one[0] - temperature))
        table = np.array(self.whites)
        red, blue = (np.interp(own, table[:, 0], table[:, at]) for at in (1, 2))
        found = np.diag([red, 1.0, blue]) @ np.linalg.inv(srgb_to_xyz() @ matrix)
        return found, own


def read_tuning(path: Path) -> Tuning:
    """Read a tuning file.

    Args:
        path: JSON with algorithms named rpi.*.

    Returns:
        The tuning.

    Raises:
        BadFile: The file is none, or damaged.

    Source:
        Raspberry Pi, "Raspberry Pi Camera Algorithm and Tuning Guide", 2023: sections on black
        level, noise, lens shading and colour.
    """
    table = read_json(path, WHAT)
    parts = {}
    for one in list_of(path, "algorithms", table.get("algorithms"), dict):
        parts.update({key: value for key, value in one.items() if isinstance(value, dict)})
    if "rpi.black_level" not in parts:
        raise BadFile(path, f"not {WHAT}: no rpi.black_level")
    black = parts["rpi.black_level"].get("black_level", 4096)
    level = number_of(path, "black_level", black, 0, FULL / 2)
    return Tuning(
        path.stem,
        level / FULL,
        _noise(path, parts.get("rpi.noise", {})),
        _matrices(path, parts.get("rpi.ccm", {})),
        _whites(path, parts.get("rpi.awb", {})),
        _shading(path, parts.get("rpi.alsc", {})),
        path,
    )


def _noise(path, part):
    if "reference_slope" not in part:
        return None
    constant = number_of(path, "reference_constant", part.get("reference_constant", 0), 0, 1e4)
    slope = number_of(path, "reference_slope", part["reference_slope"], 0, 250)
    return (constant, slope) if slope > 0 else None


def _matrices(path, part):
    found = []
    for one in list_of(path, "ccms", part.get("ccms", []), dict):
        temperature = number_of(path, "ccms: ct", one.get("ct"), 500, 50000)
        matrix = np.reshape(numbers_of(path, "ccms: ccm", one.get("ccm"), 9, 100), (3, 3))
        if abs(np.linalg.det(matrix)) < 1e-6:
            raise BadFile(path, f"the colour matrix at {temperature:g} K has no inverse")
        found.append((temperature, matrix))
    return tuple(found)


def _whites(path, part):
    if "ct_curve" not in part:
        return ()
    values = numbers_of(path, "ct_curve", part["ct_curve"], None, 1e5)
    if len(values) % 3:
        raise BadFile(
            path, f"ct_curve has {len(values)} numbers; wanted three for each temperature"
        )
    rows = sorted(zip(values[::3], values[1::3], values[2::3], strict=True))
    return tuple(rows)


def _shading(path, part):
    """Return the light over the frame, the inverse of the gains that correct it."""
    if "luminance_lut" not in part:
        return None
    gains = np.array(numbers_of(path, "luminance_lut", part["luminance_lut"], None, 1e3))
    shape = next((one for one in SHADING if one[0] * one[1] == len(gains)), None)
    if shape is None or gains.min() <= 0:
        wanted = " or ".join(f"{rows} x {columns}" for rows, columns in SHADING)
        raise BadFile(path, f"luminance_lut has {len(gains)} gains; wanted {wanted} above 0")
    light = 1 / gains.reshape(shape)
    return light / light.max()

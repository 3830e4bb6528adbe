"""Keys of [optics] from a lens of lensfun's data base."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gpusim.apps.named.keys import GUESS, Sheet
from gpusim.data.lights import illuminant
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.spectrum import photons_from_energy
from gpusim.io.databases.lens_models import (
    UNSCALED,
    Calibration,
    distortion_of,
    interpolate,
    interpolate_vignetting,
    lateral_of,
    vignetting_of,
)
from gpusim.io.databases.lensfun import Lens

ENTRIES = 96  # of a table of distortion: the spline errs by less than 0.002 pixel of 6000
BEND = 1.5  # power of the steps of the table, closer at the axis, where ptlens has a bend
BEYOND = 1.02  # image height of the table's end over the corner's
LONGEST_RATIO = 20.0  # ideal height over the corner's at which a search for the corner ends
FAR = 1000.0  # [m] lensfun's distance for infinity
KNOTS = (450.0, 540.0, 620.0)  # [nm] of the curve of lateral colour
MOST_TANGENT = 12.0  # ideal heights over the focal length, 85 degrees from the axis


@dataclass(frozen=True)
class FrameSize:
    """The sensor's pixels.

    Attributes:
        columns, rows: Number of pixels.
        pitch: [m].
        crop: Diagonal of 36 x 24 mm over the diagonal, as lensfun has it.
        own_pitch: Of the sensor's own pixels, which are fewer or more if the user says so [m].
    """

    columns: int
    rows: int
    pitch: float
    crop: float
    own_pitch: float

    @property
    def half_diagonal(self) -> float:
        """Half the distance of the middles of opposite corner pixels, lensfun's diagonal [pixel]."""
        return math.hypot(self.columns - 1, self.rows - 1) / 2

    @property
    def corner(self) -> float:
        """Distance of the frame's corner from its middle [pixel]."""
        return math.hypot(self.columns, self.rows) / 2


@dataclass(frozen=True)
class Use:
    """How a lens is used.

    Attributes:
        focal: Focal length [mm].
        f_number: Of the lens.
        distance: Of the plane in focus [m], or inf.
    """

    focal: float
    f_number: float
    distance: float


def add_lens(sheet: Sheet, lens: Lens, use: Use, frame: FrameSize, label: str, qe) -> None:
    """Add the keys of a lens.

    Args:
        sheet: Receives the keys.
        lens: The lens.
        use: Focal length, f-number, distance.
        frame: The sensor.
        label: Name of the data base.
        qe: Wavelengths [nm] and responses of R, G, B, for lateral colour; None: one channel.

    Raises:
        BadData: The projection is not supported.
        OutOfRange: The distortion is not one-to-one on the frame.
    """
    source = f"{label}, {lens.file}: {lens.name}"
    if lens.crop > 1.04 * frame.crop:
        sheet.notes.append(
            f"The lens was calibrated on a smaller frame (crop factor {lens.crop:g}); beyond its corner the models "
            "are continued."
        )
    _add_distortion(sheet, lens, use, frame, source)
    _add_lateral(sheet, lens, use, frame, source, qe)
    _add_vignetting(sheet, lens, use, frame, source)


def radius_unit(lens: Lens, frame: FrameSize) -> float:
    """Return the pixels of radius 1: half the short side of the frame of calibration."""
    return frame.half_diagonal * (frame.crop / lens.crop) / math.hypot(lens.aspect, 1)


def _where(found: Calibration, own) -> str:
    """Return at which focal length a calibration holds, in words."""
    at = f"{found.model} at {found.focal:g} mm"
    if any(one.focal == found.focal for one in own):
        return at
    near = sorted({one.focal for one in own})
    return f"{at}, interpolated between {near[0]:g} .. {near[-1]:g} mm"


def _add_distortion(sheet, lens, use, frame, source):
    found = interpolate(lens.distortion, use.focal)
    unit = radius_unit(lens, frame)
    if found is None and lens.projection == "rectilinear":
        sheet.notes.append("Distortion: the lens has no calibration; none is simulated.")
        return
    bend = distortion_of(found) if found else None
    project = _projection(lens.projection, use.focal * 1e-3 / frame.pitch)

    def real(ideal):
        """Return image heights of a pinhole's [pixel]."""
        heights = project(ideal)
        return bend(heights / unit) * unit if bend else heights

    wanted = BEYOND * frame.corner
    end = _end_of(real, wanted, frame, use, lens)
    ideal = end * np.linspace(0, 1, ENTRIES) ** BEND
    words = f"distortion {_where(found, lens.distortion)}" if found else "no distortion"
    if lens.projection != "rectilinear":
        words += f", {lens.projection} projection"
    millimetres = frame.pitch * 1e3
    table = {
        "ideal_mm": (ideal * millimetres).tolist(),
        "real_mm": (real(ideal) * millimetres).tolist(),
    }
    sheet.add("optics", f"{source}: {words}", distortion=table)


def _end_of(real, wanted, frame, use, lens) -> float:
    """Return the ideal height whose image is `wanted` [pixel]. Raises OutOfRange if there is none."""
    most = LONGEST_RATIO * wanted
    if lens.projection != "rectilinear":
        most = MOST_TANGENT * use.focal * 1e-3 / frame.pitch
    heights = np.linspace(0, most, 20001)
    images = real(heights)
    rising = np.flatnonzero(np.diff(images) <= 0)
    last = int(rising[0]) if len(rising) else len(heights) - 1
    if images[last] >= wanted:
        return float(np.interp(wanted, images[: last + 1], heights[: last + 1]))
    if images[last] >= frame.corner:  # the polynomial turns just beyond the corner
        return float(heights[last])
    place = "turns back" if len(rising) else "ends at 85 degrees from the axis"
    raise OutOfRange(
        f"distortion of {lens.name}",
        f"{place} at {images[last]:.0f} pixels from the middle",
        f"images as far as the corner, {frame.corner:.0f} pixels: a longer focal length, or a smaller sensor",
    )


def _projection(name, focal) -> Callable:
    """Return the function from a pinhole's image heights to a projection's. focal: [pixel]."""
    angles: dict[str, Callable] = {
        "equidistant": lambda angle: angle,
        "equisolid": lambda angle: 2 * np.sin(angle / 2),
        "stereographic": lambda angle: 2 * np.tan(angle / 2),
        "orthographic": np.sin,
    }
    if name == "rectilinear":
        return lambda ideal: ideal
    if name not in angles:
        raise BadData(f"projection {name}: wanted rectilinear, {', '.join(angles)}")
    return lambda ideal: focal * angles[name](np.arctan(ideal / focal))


def _add_vignetting(sheet, lens, use, frame, source):
    span = lens.focal[1] - lens.focal[0]
    distance = min(use.distance, FAR)
    found = interpolate_vignetting(lens.vignetting, use.focal, use.f_number, distance, span)
    if found is None:
        why = "no calibration near f/{:g}" if lens.vignetting else "no calibration"
        source = f"{GUESS}cos^4, as lensfun has {why.format(use.f_number)} of this lens' vignetting"
        sheet.add("optics", source, relative_illumination="cos4")
        return
    # the height is 1 at the frame's corner, lensfun's radius at the corner of the frame of calibration
    scale = frame.corner / frame.half_diagonal * lens.crop / frame.crop
    terms = [term * scale ** (2 * power) for power, term in enumerate(found.terms, 1)]
    if vignetting_of(found)(np.linspace(0, scale, 101)).min() < 0:
        raise OutOfRange(f"vignetting of {lens.name}", "negative light in the corner", "light >= 0")
    coefficients = [value for term in terms for value in (0.0, term)]
    words = (
        f"vignetting at {use.focal:g} mm, f/{use.f_number:g}, {distance:g} m, of the whole frame"
        f" (weights 1 / d^3.5 of {len(lens.vignetting)} calibrations)"
    )
    sheet.add("optics", f"{source}: {words}", relative_illumination=coefficients)


def _add_lateral(sheet, lens, use, frame, source, qe):
    if not lens.lateral or qe is None:
        if qe is not None:
            sheet.notes.append("Lateral colour: the lens has no calibration; none is simulated.")
        return
    found = interpolate(lens.lateral, use.focal, UNSCALED[lens.lateral[0].model])
    unit = radius_unit(lens, frame)
    radii = np.linspace(0, frame.corner / unit, 401)[1:]
    excess = np.array(lateral_of(found)(radii)) - 1  # (2, 400) of red and blue
    # least squares of displacements over the frame's area
    mean = (excess * radii**3).sum(axis=1) / (radii**3).sum()
    rest = float(np.abs((excess - mean[:, None]) * radii).max() * unit)
    values = channel_curve(qe, (mean[0], 0.0, mean[1]))
    words = f"lateral colour {_where(found, lens.lateral)}: red {mean[0]:+.3g}, blue {mean[1]:+.3g} of the height"
    if rest > 0.005:
        words += f"; a constant part, up to {rest:.2g} pixels from the model's curve over the field"
    table = {"wavelengths_nm": list(KNOTS), "excess": values.tolist()}
    sheet.add("optics", f"{source}: {words}", lateral_color=table)


def channel_curve(qe, means) -> np.ndarray:
    """Return the excesses at KNOTS for which channels see given means in daylight, (3,).

    Args:
        qe: Wavelengths [nm], (L,), and responses of three channels, (3, L).
        means: Mean excess of each channel.
    """
    wavelengths, responses = qe
    photons = photons_from_energy(illuminant("D65")).at(wavelengths)
    weights = responses * photons
    weights /= weights.sum(axis=1, keepdims=True)
    hats = np.array([np.interp(wavelengths, KNOTS, one) for one in np.eye(3)])
    return np.linalg.solve(weights @ hats.T, np.array(means))

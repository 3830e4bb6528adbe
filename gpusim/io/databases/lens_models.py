"""Lensfun's models of distortion, lateral colour and vignetting, and the interpolation between calibrations.

Radii of distortion and lateral colour are 1 at half the short side of the frame that the lens was calibrated
on, radii of vignetting 1 at its corner. Frames of lensfun go from the middle of the first pixel to the middle of
the last one.

Source: the manual of lensfun (Lens calibration; "lfLensCalibDistortion", "lfLensCalibTCA",
"lfLensCalibVignetting"); which of its words hold was measured with lensfunpy, see docs/camera_names.md.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

DISTORTIONS = {"poly3": ("k1",), "poly5": ("k1", "k2"), "ptlens": ("a", "b", "c")}
LATERAL = {"linear": ("kr", "kb"), "poly3": ("vr", "vb", "cr", "cb", "br", "bb")}
UNSCALED = {"linear": 2, "poly3": 2}  # first terms of lateral colour, which are ratios of sizes
VIGNETTINGS = {"pa": ("k1", "k2", "k3")}
POWER = 3.5  # of the distance in the weights of vignetting
FARTHEST = 1.0  # distance to the nearest calibration of vignetting from which none is used


@dataclass(frozen=True)
class Calibration:
    """One calibration of a lens.

    Attributes:
        model: Name of the model.
        terms: Its coefficients, in the order of DISTORTIONS, LATERAL or VIGNETTINGS.
        focal: Focal length [mm].
        aperture: f-number, of vignetting.
        distance: Of the subject [m], of vignetting.
    """

    model: str
    terms: tuple[float, ...]
    focal: float
    aperture: float = 0.0
    distance: float = 0.0


def interpolate(
    calibrations: Sequence[Calibration], focal: float, unscaled: int = 0
) -> Calibration | None:
    """Return the calibration at a focal length.

    Terms times the focal length follow a cubic Hermite curve over the focal lengths, whose slopes are
    half the difference of the neighbours, at the ends the difference itself. Beyond the ends the last
    calibration holds. The first `unscaled` terms are not multiplied. Calibrations of another model
    than the first one's are left out.

    Args:
        calibrations: Of one kind, in the order of the file.
        focal: [mm].
        unscaled: Number of terms that are ratios.
    """
    own = sorted(
        (one for one in calibrations if one.model == calibrations[0].model),
        key=lambda one: one.focal,
    )
    if not own:
        return None
    nodes = np.array([one.focal for one in own])
    last = int(np.searchsorted(nodes, focal, "left"))
    if last < len(own) and nodes[last] == focal:
        return own[last]
    if last in (0, len(own)):
        return own[max(last - 1, 0)]
    factors = np.where(np.arange(len(own[0].terms)) < unscaled, 0.0, 1.0)
    values = np.array([one.terms for one in own]) * nodes[:, None] ** factors
    terms = _hermite(values, last - 1, (focal - nodes[last - 1]) / (nodes[last] - nodes[last - 1]))
    return Calibration(own[0].model, tuple((terms / focal**factors).tolist()), focal)


def _hermite(values, at, t):
    """Return the cubic between entries `at` and `at` + 1, at t of 0 .. 1."""
    here, there = values[at], values[at + 1]
    leaves = (there - values[at - 1]) / 2 if at else there - here
    arrives = (values[at + 2] - here) / 2 if at + 2 < len(values) else there - here
    square, cube = t * t, t**3
    return (
        (2 * cube - 3 * square + 1) * here
        + (cube - 2 * square + t) * leaves
        + (3 * square - 2 * cube) * there
        + (cube - square) * arrives
    )


def interpolate_vignetting(
    calibrations: Sequence[Calibration],
    focal: float,
    f_number: float,
    distance: float,
    span: float,
) -> Calibration | None:
    """Return the vignetting at a focal length, an f-number and a distance; None if none is near.

    Terms are means of all calibrations with the weights 1 / d^3.5 of their distances d, in a space
    whose axes are focal length over `span`, 4 / f-number and 0.1 m / distance.

    Args:
        calibrations: Of vignetting.
        focal: [mm].
        f_number: Of the lens.
        distance: Of the subject [m].
        span: Longest minus shortest focal length of the lens [mm].
    """
    if not calibrations:
        return None

    def place(focal, f_number, distance):
        return focal / (span or 1.0), 4 / f_number, 0.1 / distance

    places = np.array([place(one.focal, one.aperture, one.distance) for one in calibrations])
    apart = np.sqrt(((places - place(focal, f_number, distance)) ** 2).sum(axis=1))
    nearest = int(np.argmin(apart))
    if apart[nearest] > FARTHEST:
        return None
    terms = np.array([one.terms for one in calibrations])
    if apart[nearest] < 1e-4:
        mean = terms[nearest]
    else:
        weights = apart**-POWER
        mean = weights @ terms / weights.sum()
    return Calibration(calibrations[nearest].model, tuple(mean.tolist()), focal, f_number, distance)


def distortion_of(calibration: Calibration) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function from the radius of a corrected picture to the radius in the distorted one."""
    terms = calibration.terms
    if calibration.model == "poly3":
        (k1,) = terms
        return lambda r: r * (1 - k1 + k1 * r**2)
    if calibration.model == "poly5":
        k1, k2 = terms
        return lambda r: r * (1 + k1 * r**2 + k2 * r**4)
    a, b, c = terms
    return lambda r: r * (a * r**3 + b * r**2 + c * r + 1 - a - b - c)


def lateral_of(calibration: Calibration) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return the function from green's radius to red's and blue's radius over it."""
    if calibration.model == "linear":
        red, blue = calibration.terms
        return lambda r: (red + 0 * r, blue + 0 * r)
    vr, vb, cr, cb, br, bb = calibration.terms
    return lambda r: (vr + cr * r + br * r**2, vb + cb * r + bb * r**2)


def vignetting_of(calibration: Calibration) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function from the radius, 1 at the corner, to the light relative to the axis."""
    k1, k2, k3 = calibration.terms
    return lambda r: 1 + k1 * r**2 + k2 * r**4 + k3 * r**6

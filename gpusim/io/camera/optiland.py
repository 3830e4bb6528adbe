"""Point spread functions of lenses in Optiland, an optical design program in Python."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, OutOfRange, checked_count
from gpusim.domain.psf import PointSpread
from gpusim.io.camera.traced import Traced, spread_of

HEIGHTS = (0.0, 0.25, 0.5, 0.75, 1.0)
MARGIN = 0.95  # of the Nyquist spacing of the irradiance, lambda N / 2
SAMPLES = 65
FIELDS = 41  # chief rays for the interpolation of the field from the image height
# steps of the secant search, which converges with the third power of the fields' distance
FIELD_STEPS = 4


def optiland_psf(
    optic: Any,
    wavelengths: ArrayLike,
    corner: float,
    heights: ArrayLike = HEIGHTS,
    *,
    spacing: float | None = None,
    samples: int = SAMPLES,
    rays: int = 128,
    reference: float | None = None,
) -> PointSpread:
    """Return Huygens point spread functions of a lens over wavelength and field.

    The lens is an `optiland.optic.Optic` with rotational symmetry. Write the result once and name
    it in the camera's file:

            gs.write_psf("lens.npz", gs.optiland_psf(CookeTriplet(), range(400, 701, 50), corner=3e-3))

    Args:
        optic: the lens.
        wavelengths: wavelengths [nm]; all light of the scenes must lie between them.
        corner: distance of the frame's corner from the axis [m].
        heights: image heights, 1 at the corner, rising from 0; (0,) is the same blur all over the
            frame.
        spacing: distance of the samples [m]; None is lambda N / 2 of the shortest wavelength less 5
            %.
        samples: samples along an edge, odd. Light beyond them is lost: include all rays and some
            diffraction rings.
        rays: rays across the pupil.
        reference: wavelength whose chief ray defines the ideal image point [nm]; None is the middle
            one. Lateral colour is relative to it.

    Returns:
        The point spread functions.

    Raises:
        BadData: if wavelengths, heights or corner are wrong, or a chief ray does not reach the
            image.
        OutOfRange: if a count, a height or the reference is out of range.
    """
    wavelengths = np.unique(np.asarray(wavelengths, np.float64).ravel())
    heights = np.unique(np.asarray(heights, np.float64).ravel())
    checked_count("samples", samples, 3)
    checked_count("rays", rays, 16)
    if not (len(wavelengths) and np.isfinite(wavelengths).all() and wavelengths[0] > 0):
        raise BadData("optiland_psf: wanted wavelengths [nm] above 0")
    are_heights = len(heights) and np.isfinite(heights).all() and heights[0] == 0
    if not (are_heights and 0 < corner < math.inf):
        raise BadData(
            "optiland_psf: wanted heights rising from 0, 1 at the frame's corner, and corner > 0 [m]"
        )
    if reference is None:
        reference = float(wavelengths[len(wavelengths) // 2])
    if spacing is None:
        spacing = MARGIN * wavelengths[0] * 1e-9 * abs(float(np.squeeze(optic.paraxial.FNO()))) / 2
    fields = [_find_field(optic, height * corner, reference) for height in heights]
    traced = [
        _trace_psf(optic, field, wavelength, spacing, samples | 1, rays)
        for field in fields
        for wavelength in wavelengths
    ]
    return spread_of(traced, corner if len(fields) > 1 else None, reference)


def _chief(optic, field, wavelength):
    """Return the image point (x, y) [m] of a field's chief ray; field: along y, 1 the largest."""
    rays = optic.trace_generic(0.0, field, 0.0, 0.0, wavelength / 1e3)
    found = (float(np.squeeze(rays.x)) / 1e3, float(np.squeeze(rays.y)) / 1e3)
    if not np.isfinite(found).all():
        raise BadData(
            f"optiland_psf: the chief ray of field {field:.4g} does not reach the image at "
            f"{wavelength:g} nm"
        )
    return found


def _find_field(optic, height, wavelength):
    """Return the field along y, 1 the largest, with the image height `height` [m]."""
    if height == 0:
        return 0.0
    fields = np.linspace(0, 1, FIELDS)
    found = np.abs([_chief(optic, field, wavelength)[1] for field in fields])
    if not (np.diff(found) > 0).all() or found[-1] < height * (1 - 1e-9):
        allowed = f"up to {found.max() * 1e3:.4g} mm, the image height of the lens's largest field"
        raise OutOfRange("optiland_psf: image height", f"{height * 1e3:.4g} mm", allowed)
    field = float(np.interp(height, found, fields))
    for _ in range(FIELD_STEPS):
        slope = np.interp(field, (fields[1:] + fields[:-1]) / 2, np.diff(found) * (FIELDS - 1))
        missing = height - abs(_chief(optic, field, wavelength)[1])
        field = float(np.clip(field + missing / slope, 0, 1))
    return field


def _trace_psf(optic, field, wavelength, spacing, samples, rays):
    """Return Optiland's point spread function.

    Its rows and columns go along y and x about the mean of the rays, from edge to edge.
    """
    from optiland.psf import HuygensPSF

    # HuygensPSF spreads n samples over n pitches, so they are n / (n - 1) pitches apart
    found = HuygensPSF(
        optic,
        (0, field),
        wavelength / 1e3,
        num_rays=rays,
        image_size=samples,
        pixel_pitch=spacing * 1e3 * (samples - 1) / samples,
    )
    x, y = (float(np.squeeze(place)) / 1e3 for place in (found.cx, found.cy))
    centre = _chief(optic, field, wavelength)
    half = (samples - 1) / 2
    middle = half + (centre[1] - y) / spacing, half + (centre[0] - x) / spacing
    values = np.asarray(found.psf, np.float64)
    return Traced(float(wavelength), values, spacing, middle, centre, field)

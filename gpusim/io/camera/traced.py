"""Point spread functions from lens design programs, combined into a camera's."""

from typing import NamedTuple

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.psf import PointSpread

ON_AXIS = 1e-6  # height relative to the corner that counts as on axis


class Traced(NamedTuple):
    """Point spread function of one wavelength and field point from a lens design program.

    wavelength: [nm]. values: irradiance (rows, cols); columns go along x, rows along y of the image
    plane, z along the light, right-handed. spacing: [m]. middle: (row, column) of the image point
    `centre`, (x, y) [m]. field: name of the field point.

    In the upright picture these rows go down and these columns to the right: with y up and z ahead,
    x points to the left, and a lens turns its image by half a turn.
    """

    wavelength: float
    values: np.ndarray
    spacing: float
    middle: tuple[float, float]
    centre: tuple[float, float]
    field: object = None


def spread_of(
    traced: list[Traced], corner: float | None = None, reference: float | None = None
) -> PointSpread:
    """Return the camera's point spread functions: of one field point, or several of a round lens.

    One field point holds for the whole frame. All are resampled as the finest is, with sinc
    interpolation, over the square that all cover.

    corner: distance of the frame's corner from the axis [m], required for several field points,
    which lie on one line from the axis along x or y. reference: wavelength whose image point is the
    ideal one [nm]; None is the middle one. Offsets of other wavelengths, lateral colour, stay in
    the point spread functions. Raises BadData, OutOfRange.
    """
    wavelengths = sorted({one.wavelength for one in traced})
    fields = list(dict.fromkeys(one.field for one in traced))
    table = {(one.field, one.wavelength): one for one in traced}
    if not traced or len(table) != len(traced) or len(traced) != len(wavelengths) * len(fields):
        raise BadData(
            f"{len(traced)} point spreads of {len(fields)} field points and {len(wavelengths)} "
            "wavelengths: wanted each wavelength once at every field point"
        )
    middle = wavelengths[len(wavelengths) // 2] if reference is None else reference
    if middle not in wavelengths:
        allowed = ", ".join(f"{one:g}" for one in wavelengths)
        raise OutOfRange("reference wavelength", f"{middle:g} nm", allowed)
    ideal = {field: table[field, middle].centre for field in fields}
    if len(fields) > 1:
        if corner is None or not 0 < corner < np.inf:
            raise BadData(
                f"{len(fields)} field points: wanted corner, the distance of the frame's corner from "
                "the axis [m]"
            )
        fields.sort(key=lambda field: np.hypot(*ideal[field]))
    turned = [
        _turn_outward(table[field, wavelength], ideal[field], corner)
        for field in fields
        for wavelength in wavelengths
    ]
    values, spacing = _resample_all(turned)
    values = values.reshape(len(fields), len(wavelengths), *values.shape[1:])
    if len(fields) == 1 or corner is None:
        return PointSpread(np.array(wavelengths), values[0], spacing)
    heights = np.array([np.hypot(*ideal[field]) for field in fields]) / corner
    for end in (0.0, 1.0):
        heights[np.abs(heights - end) <= ON_AXIS] = end
    if heights[-1] < 1:
        found = f"up to {heights[-1] * corner * 1e3:.4g} mm from the axis"
        allowed = f"up to the frame's corner, {corner * 1e3:.4g} mm"
        raise OutOfRange("field points", found, allowed)
    return PointSpread(np.array(wavelengths), values, spacing, heights=heights)


def _turn_outward(traced, ideal, corner):
    """Return values with the axis at smaller columns, spacing, and the index of the ideal point."""
    values, (row, col) = traced.values, traced.middle
    row -= (traced.centre[1] - ideal[1]) / traced.spacing
    col -= (traced.centre[0] - ideal[0]) / traced.spacing
    x, y = ideal
    least = ON_AXIS * (corner or np.inf)
    if corner is None or max(abs(x), abs(y)) <= least:
        return values, traced.spacing, (row, col)
    if min(abs(x), abs(y)) > least:
        raise BadData(
            f"a field point at x = {x * 1e3:.4g}, y = {y * 1e3:.4g} mm: wanted all along x or all "
            "along y"
        )
    for _ in range(0 if x > least else 1 if y > least else 2 if x < -least else 3):
        # values from below come to the right
        values, (row, col) = np.rot90(values), (values.shape[1] - 1 - col, row)
    return values, traced.spacing, (row, col)


def _resample_all(parts):
    """Return all on one square grid about their ideal points, (n, size, size), and its spacing.

    size is odd.
    """
    spacing = min(part[1] for part in parts)
    reach = min(
        min(middle, size - 1 - middle) * own / spacing
        for values, own, place in parts
        for middle, size in zip(place, values.shape, strict=True)
    )
    half = int(reach + 1e-6)
    if half < 1:
        raise BadData("the image point lies outside its point spread")
    return np.stack([_resample(*part, spacing, half) for part in parts]), spacing


def _resample(values, own, place, spacing, half):
    """Return values about `place` at 2 half + 1 band-limited steps of `spacing`, clipped at 0."""
    steps = np.arange(-half, half + 1) * (spacing / own)
    lines = [
        np.sinc(np.round(middle + steps, 9)[:, None] - np.arange(size))
        for middle, size in zip(place, values.shape, strict=True)
    ]
    return np.maximum(lines[0] @ values @ lines[1].T, 0)

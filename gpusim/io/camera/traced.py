"""Point spreads that lens design programs trace, put together to those of a camera."""

from typing import NamedTuple

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.psf import PointSpread

ON_AXIS = 1e-6  # of the frame's corner


class Traced(NamedTuple):
    """A point spread of one wavelength and field point, as a lens design program computes it.

    wavelength: [nm]. values: irradiance (rows, cols), of places that grow along x with the columns and along y with the
    rows; x and y of the image plane, z along the light, right-handed. spacing: [m]. middle: (row, column) of the image
    point `centre`, (x, y) [m]. field: names the field point.

    In the upright picture these rows go down and these columns to the right: with y up and z ahead, x points to the
    left, and a lens turns its image by half a turn.
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
    """Point spreads of one field point, the same all over the frame, or of several, of a lens that is round.

    corner: distance of the frame's corner from the axis [m], needed for several field points, which lie on one line
    from the axis along x or y. reference: wavelength whose image point is the ideal one [nm], the middle one by
    default; how far others lie from it, lateral color, stays in the point spreads.
    All are sampled as the finest is, by the sampling theorem, over the square that all cover.
    Raises BadData, OutOfRange.
    """
    wavelengths = sorted({one.wavelength for one in traced})
    fields = list(dict.fromkeys(one.field for one in traced))
    table = {(one.field, one.wavelength): one for one in traced}
    if not traced or len(table) != len(traced) or len(traced) != len(wavelengths) * len(fields):
        raise BadData(
            f"{len(traced)} point spreads of {len(fields)} field points and {len(wavelengths)} wavelengths: "
            "wanted each wavelength once at every field point"
        )
    middle = wavelengths[len(wavelengths) // 2] if reference is None else reference
    if middle not in wavelengths:
        raise OutOfRange(
            "reference wavelength", f"{middle:g} nm", ", ".join(f"{one:g}" for one in wavelengths)
        )
    ideal = {field: table[field, middle].centre for field in fields}
    if len(fields) > 1:
        if corner is None or not 0 < corner < np.inf:
            raise BadData(
                f"{len(fields)} field points: wanted corner, the distance of the frame's corner from the "
                "axis [m]"
            )
        fields.sort(key=lambda field: np.hypot(*ideal[field]))
    values, spacing = _sampled(
        [
            _outward(table[field, wavelength], ideal[field], corner)
            for field in fields
            for wavelength in wavelengths
        ]
    )
    values = values.reshape(len(fields), len(wavelengths), *values.shape[1:])
    if len(fields) == 1 or corner is None:
        return PointSpread(np.array(wavelengths), values[0], spacing)
    heights = np.array([np.hypot(*ideal[field]) for field in fields]) / corner
    for end in (0.0, 1.0):
        heights[np.abs(heights - end) <= ON_AXIS] = end
    if heights[-1] < 1:
        raise OutOfRange(
            "field points",
            f"up to {heights[-1] * corner * 1e3:.4g} mm from the axis",
            f"up to the frame's corner, {corner * 1e3:.4g} mm",
        )
    return PointSpread(np.array(wavelengths), values, spacing, heights=heights)


def _outward(traced, ideal, corner):
    """Values, turned so that the axis lies at smaller columns, spacing, and the index of the ideal image point."""
    values, (row, col) = traced.values, traced.middle
    row -= (traced.centre[1] - ideal[1]) / traced.spacing
    col -= (traced.centre[0] - ideal[0]) / traced.spacing
    x, y = ideal
    least = ON_AXIS * (corner or np.inf)
    if corner is None or max(abs(x), abs(y)) <= least:
        return values, traced.spacing, (row, col)
    if min(abs(x), abs(y)) > least:
        raise BadData(
            f"a field point at x = {x * 1e3:.4g}, y = {y * 1e3:.4g} mm: wanted all along x or all along y"
        )
    for _ in range(0 if x > least else 1 if y > least else 2 if x < -least else 3):
        # what is below comes to the right
        values, (row, col) = np.rot90(values), (values.shape[1] - 1 - col, row)
    return values, traced.spacing, (row, col)


def _sampled(parts):
    """All on one square grid about their ideal points, (n, size, size), size odd, and its spacing."""
    spacing = min(part[1] for part in parts)
    reach = min(
        min(middle, size - 1 - middle) * own / spacing
        for values, own, place in parts
        for middle, size in zip(place, values.shape, strict=True)
    )
    half = int(reach + 1e-6)
    if half < 1:
        raise BadData("the image point lies outside its point spread")
    return np.stack([_resampled(*part, spacing, half) for part in parts]), spacing


def _resampled(values, own, place, spacing, half):
    """Values about `place` at 2 half + 1 steps of `spacing`, band-limited; what rings below 0 is cut off."""
    steps = np.arange(-half, half + 1) * (spacing / own)
    lines = [
        np.sinc(np.round(middle + steps, 9)[:, None] - np.arange(size))
        for middle, size in zip(place, values.shape, strict=True)
    ]
    return np.maximum(lines[0] @ values @ lines[1].T, 0)

"""Spatial frequency response of a camera from a picture of a slanted edge (ISO 12233, e-SFR)."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.short_repr import short_repr

BINS = 4  # per pixel along the edge's normal
LEAST = 10  # rows and columns of a picture, and twice the pixels on each side of the edge
FREQUENCIES = np.linspace(0, 1, 201)  # [cycle/pixel]
PASSES = 4  # of the fit: each centres its windows on the line of the one before
SIGNIFICANT = 5.0  # least step in standard errors
MOST_ERROR = 0.1  # of the response; a larger one would change MTF50 by a tenth
INSIDE = 0.75  # least part of the step in the inner half of the window; a ramp has a half there


@dataclass(frozen=True, eq=False)
class EdgeResponse:
    """Result of `sfr`: F frequencies, C channels.

    Attributes:
        frequencies: along the edge's normal, shape (F,) [cycle/pixel].
        response: SFR, 1 at frequency 0, shape (F,) for one channel or (C, F) [1].
        angle: angle between edge and the pixel columns, or rows if these are nearer, shape () or
            (C,) [rad].
        per_mm: `frequencies` on the sensor, shape (F,) [cycle/mm]; None without the pitch.
        error: estimated error of the response up to 0.5 cycle/pixel because the picture ends, shape
            () or (C,).
    """

    frequencies: np.ndarray
    response: np.ndarray
    angle: np.ndarray
    per_mm: np.ndarray | None = None
    error: np.ndarray | None = None

    __repr__ = short_repr


def sfr(
    image: ArrayLike,
    pitch: float | None = None,
    *,
    limits: tuple[float, float] | None = None,
    order: int = 1,
) -> EdgeResponse:
    """Measure the spatial frequency response from a picture of one straight, slanted edge.

    The edge is a polynomial through the centroids of the rows' differences. Pixels of whole periods
    of its phase are sorted by distance along the normal into quarter-pixel bins; these are
    differenced, windowed (Hamming) and Fourier transformed. Two details differ from the standard:
    each bin is placed at the mean distance of its pixels, which are not spread evenly in it; and
    both boxes of a quarter pixel, difference and bin, are divided out, sinc(f / 4)^2. (The standard
    divides by the difference's only, which leaves 2.6 % at 0.5 cycle/pixel.)

    Up to 0.5 cycle/pixel the response of exact edges has an error of 1e-3 (5 degrees, 160 rows);
    from 100 rows on 4e-3 at angles whose phases nearly repeat. A diffraction-limited lens spreads
    light beyond the window: the response is too high by a part of 11 q / (pi^3 reach), q =
    wavelength times f-number over pitch, reach [pixel] on each side. `error` is the change from
    half the reach: this equals the remaining error of a tail that falls as 1 / reach, and three
    times the window's effect on a blur that fits (1 / reach^2); noise adds to it.

    Source: ISO 12233:2014, e-SFR; Burns, "Slanted-edge MTF for digital camera and scanner analysis"
    (PICS 2000).

    Args:
        image: linear values in any unit, shape (rows, cols), or (rows, cols, C) to measure each
            channel separately. The edge may be near vertical or horizontal, and light on either
            side.
        pitch: pixel pitch [m], for frequencies in cycle/mm.
        limits: lowest and highest possible value; a picture that reaches one is refused as clipped.
            None: the range of an integer type, no limits for floats.
        order: order of the polynomial fitted to the edge: 1, or 2 if the lens distorts.

    Returns:
        The response.

    Raises:
        BadData: if the picture is too small, clipped or not finite; if it has no edge, or the edge
            is parallel to the pixels, at 45 degrees or too near the border; or if the blur does not
            fit.
        OutOfRange: if `pitch` or `order` is out of range.
    """
    planes = _check_planes(image, limits)
    if pitch is not None and not 0 < pitch < np.inf:
        raise OutOfRange("pitch", f"{pitch} m", "0 < pitch < inf")
    if order not in (1, 2):
        raise OutOfRange("order", order, "1 or 2")
    found = [_response(plane, order) for plane in planes.reshape(-1, *planes.shape[-2:])]
    response, angle, error = (
        np.array(part).reshape((*planes.shape[:-2], *np.shape(part[0])))
        for part in zip(*found, strict=True)
    )
    per_mm = None if pitch is None else FREQUENCIES / (pitch * 1e3)
    return EdgeResponse(FREQUENCIES.copy(), response, angle, per_mm, error)


def mtf50(measured: EdgeResponse, level: float = 0.5) -> Any:
    """Return the frequency at which the response first falls to `level`.

    Linear between frequencies.

    Args:
        measured: result of `sfr`.
        level: response [1].

    Returns:
        Frequency in [cycle/mm] if the pitch was given, else [cycle/pixel]: a float or, for several
        channels, an array (C,).

    Raises:
        OutOfRange: if `level` is not between 0 and 1.
        BadData: if the response never falls to `level`.
    """
    if not 0 < level < 1:
        raise OutOfRange("level", level, "0 < level < 1")
    frequencies = measured.frequencies if measured.per_mm is None else measured.per_mm
    found = []
    for response in np.atleast_2d(measured.response):
        below = np.flatnonzero(response <= level)
        if not len(below):
            raise BadData(f"mtf50: the response stays above {level:g} up to {frequencies[-1]:g}")
        k = below[0]
        part = (response[k - 1] - level) / (response[k - 1] - response[k])
        found.append(frequencies[k - 1] + part * (frequencies[k] - frequencies[k - 1]))
    return float(found[0]) if measured.response.ndim == 1 else np.array(found)


def _check_planes(image, limits):
    """Return the channels as float64 planes, (C, rows, cols) or (rows, cols).

    Raise BadData if the picture is too small, clipped or not finite.
    """
    image = np.asarray(image)
    if image.ndim not in (2, 3) or image.dtype.kind not in "uif" or min(image.shape[:2]) < LEAST:
        raise BadData(
            f"sfr: picture of shape {image.shape} and type {image.dtype}; wanted numbers (rows, cols) or "
            f"(rows, cols, channels), {LEAST} x {LEAST} pixels or more"
        )
    if limits is None and image.dtype.kind in "ui":
        limits = np.iinfo(image.dtype).min, np.iinfo(image.dtype).max
    values = image.astype(np.float64)
    if not np.isfinite(values).all():
        raise BadData("sfr: NaN or infinite values")
    if limits is not None:
        low, high = limits
        clipped = np.count_nonzero((values <= low) | (values >= high))
        if clipped:
            raise BadData(
                f"sfr: {clipped} of {values.size} values are clipped, at or beyond {low:g} or {high:g}; "
                "expose both sides of the edge between them"
            )
    return values if values.ndim == 2 else np.moveaxis(values, -1, 0)


def _response(plane, order):
    """Return SFR, angle and error of one plane."""
    plane = _turn_upright(plane)
    fit, reach = _edge(plane, order)
    rows = np.arange(len(plane))
    turns = abs(fit(rows[-1]) - fit(0)) * len(plane) / (len(plane) - 1)
    if turns < 1:
        raise BadData(
            f"sfr: the edge shifts by {turns:.2g} pixels over the {len(plane)} rows or columns that it "
            "crosses, wanted 1 or more: turn it by about 5 degrees"
        )
    # pixels beyond whole periods; left out on both sides
    spare = len(plane) - round(len(plane) * np.floor(turns) / turns)
    rows = rows[spare // 2 : len(plane) - (spare - spare // 2)]
    slope = np.hypot(1, fit.deriv()(rows))[:, None]
    distance = (np.arange(plane.shape[1]) - fit(rows)[:, None]) / slope
    read = int(reach * BINS) - 1
    angle = np.arctan(abs(fit.deriv()(rows.mean())))
    number = np.floor(distance * BINS + 0.5).astype(int)
    used = np.abs(number) <= read
    number = number[used] + read
    count = np.bincount(number, minlength=2 * read + 1)
    if not count.all():
        raise BadData(
            f"sfr: the edge, {np.degrees(angle):.3g} degrees from the pixel axis over {len(plane)} pixels, "
            "has too few phases to fill quarter-pixel bins; turn it to about 5 degrees, or use a larger picture"
        )
    spread = np.bincount(number, plane[rows][used]) / count
    place = np.bincount(number, distance[used]) / count
    line, middle = np.diff(spread), (place[1:] + place[:-1]) / 2
    inner = np.interp([-reach / 2, reach / 2], place, spread)
    if np.diff(inner)[0] < INSIDE * (spread[-1] - spread[0]):
        raise BadData(
            "sfr: no edge, or one too blurred for the picture: values still change at the borders"
        )
    waves = _waves(middle)
    response = _transform(waves, line, middle, read / BINS)
    narrower = _transform(waves, line, middle, read / BINS / 2)
    error = float(np.abs(narrower - response)[FREQUENCIES <= 0.5].max())
    if error > MOST_ERROR:
        raise BadData(
            f"sfr: the blur does not fit: half of the {reach:.3g} pixels read on each side of the edge "
            f"change the response by {error:.2g}, wanted {MOST_ERROR:g} or less: use a larger picture"
        )
    return response, angle, error


def _waves(middle):
    """Return exp(-2 pi i f x) for FREQUENCIES and positions [pixel], (frequencies, positions), by powers."""
    first = np.exp(-2j * np.pi * FREQUENCIES[1] * middle)
    waves = np.broadcast_to(first, (len(FREQUENCIES), len(middle))).copy()
    waves[0] = 1
    return np.cumprod(waves, axis=0)


def _transform(waves, line, middle, reach):
    """Return the response of a line spread at positions `middle` [pixel], windowed to `reach`."""
    windowed = line * (0.54 + 0.46 * np.cos(np.pi * middle / reach))
    line = np.where(np.abs(middle) <= reach, windowed, 0)
    response = np.abs(waves @ line) / line.sum()
    return response / np.sinc(FREQUENCIES / BINS) ** 2


def _turn_upright(plane):
    """Return the picture turned and signed: the edge is vertical, its right side lighter."""
    halves = [np.array_split(plane, 2, axis=axis) for axis in (0, 1)]
    down, across = (second.mean() - first.mean() for first, second in halves)
    steps, plane = (across, plane) if abs(across) >= abs(down) else (down, plane.T)
    plane = plane if steps > 0 else -plane
    flank = max(1, plane.shape[1] // 8)
    left, right = plane[:, :flank], plane[:, -flank:]
    error = np.sqrt(left.var() / left.size + right.var() / right.size)
    if not right.mean() - left.mean() > SIGNIFICANT * error + 1e-9 * np.abs(plane).max():
        raise BadData("sfr: no edge found: the two sides do not differ by more than the noise")
    return plane


def _edge(plane, order):
    """Return the polynomial of the edge's column per row, and its least distance from the sides."""
    rows, slope = np.arange(len(plane)), np.diff(plane, axis=1)
    between, window = np.arange(slope.shape[1]) + 0.5, 1.0
    for _ in range(PASSES):
        weight = slope * window
        total = weight.sum(axis=1)
        if not (total > 0).all():
            raise BadData(
                "sfr: no edge found in some of the rows or columns; wanted one edge across all of them"
            )
        middle = (weight * between).sum(axis=1) / total
        fit = np.polynomial.Polynomial.fit(rows, middle, order).convert()
        reach = min(fit(rows).min(), slope.shape[1] - fit(rows).max())
        if reach < LEAST / 2:
            raise BadData(
                f"sfr: the edge comes within {max(reach, 0):.2g} pixels of the border, wanted {LEAST // 2} "
                "or more on both sides: use a larger picture, or turn the edge less"
            )
        away = (between - fit(rows)[:, None]) / reach
        window = np.where(np.abs(away) < 1, 0.54 + 0.46 * np.cos(np.pi * away), 0)
    tilt = np.abs(fit.deriv()(rows)).max()
    if tilt > 1:
        raise BadData(
            f"sfr: the edge is {np.degrees(np.arctan(tilt)):.3g} degrees from the pixel axis, wanted below 45"
        )
    return fit, reach / np.hypot(1, tilt)

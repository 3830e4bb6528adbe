"""Blur over the field from slanted edges, as point spreads for a camera file."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.fit.edge_axes import measure_astigmatism, mtf50_along_axes
from gpusim.fit.edge_corners import Corner, fit_lean, pool_leans, read_corner
from gpusim.fit.edge_finding import STEEPEST, FoundEdge, find_edges
from gpusim.fit.edge_fit import (
    EdgeSamples,
    LineSpread,
    Place,
    fit_line,
    read_edge,
)
from gpusim.fit.estimate import Estimate, Part, Plot
from gpusim.fit.field_spread import spread_over_field
from gpusim.fit.planes import (
    WAVELENGTHS,
    checked_frames,
    clipped_mask,
    even_plane,
    field_place,
    letter_masks,
    light_values,
    main_channel,
)
from gpusim.io.raw.raw_frame import RawFrame

SAME = 0.3  # of an edge's length by which two frames' targets may be apart and still be one
NOISIEST = 0.2  # noise of a pixel over the step
UNKNOWN_F_NUMBER = 4.0
NOTICED = 3.0  # times the expected residual
LEAST_MISFIT = 0.004  # residual over the step that is not worth a line


def measure_sharpness(
    frames: RawFrame | Sequence[RawFrame],
    *,
    black: ArrayLike | None = None,
    pitch: float | None = None,
    f_number: float | None = None,
    aperture: tuple[float, float] = (1.0, 1.0),
    falloff: np.ndarray | None = None,
) -> list[Place]:
    """Measure the blur at every target in frames of slanted edges.

    Args:
        frames: One frame or more; the same target in several frames gives one result.
        black: Black level [DN], see `gpusim.fit.planes.light_values`.
        pitch: Pixel pitch [m]; None: no diffraction in the model.
        f_number: F-number; None: the frames', else no diffraction in the model.
        aperture: Height and width of the pixel's aperture over the pitch.
        falloff: Response to even light over the frame [1], shape (rows, cols), which is divided out; or None.

    Returns:
        The blur of each channel and target.

    Raises:
        BadData: No edge can be used; the message says why and what to shoot instead.
    """
    every = checked_frames(frames, "edges")
    targets: list[_Target] = []
    faults: list[str] = []
    for frame in every:
        values = light_values(frame, black)
        clipped = clipped_mask(frame, values)
        if falloff is not None:
            values = values / falloff
        edges = find_edges(even_plane(frame, values), frame.name or "edges")
        used, fault = _usable(edges, frame, clipped)
        faults += fault
        _gather(targets, frame, values, used, faults)
    number = f_number or every[0].f_number
    scale = number / pitch if number and pitch else 0.0
    found = [place for target in targets for place in _places(target, scale, aperture)]
    if not found:
        raise BadData(faults[0] if faults else "edges: none can be used")
    return found


@dataclass(frozen=True, eq=False)
class _Target:
    """Pixels around the edges of one outline in all frames: samples by channel and direction."""

    row: float
    col: float
    size: float
    samples: dict[tuple[str, bool], list[EdgeSamples]]
    corners: dict[str, list[Corner]]
    sources: list[str]


def _gather(targets: list[_Target], frame, values, edges, faults):
    """Add the pixels of a frame's edges to the targets; outlines at one place are one target."""
    masks = letter_masks(frame)
    for number in dict.fromkeys(edge.target for edge in edges):
        own = [edge for edge in edges if edge.target == number]
        row, col = np.mean([(edge.row, edge.col) for edge in own], axis=0)
        size = max(edge.length for edge in own)
        same = [one for one in targets if np.hypot(one.row - row, one.col - col) < SAME * size]
        target = same[0] if same else _Target(float(row), float(col), size, {}, {}, [])
        for letter, mask in masks.items():
            seen = [
                (edge, sample)
                for edge in own
                if (sample := _sample(values, mask, edge, frame, faults)) is not None
            ]
            for edge, sample in seen:
                target.samples.setdefault((letter, edge.is_upright), []).append(sample)
            target.corners.setdefault(letter, []).extend(_corners(values, mask, seen))
        if target.samples and not same:
            targets.append(target)
        if target.samples and frame.name not in target.sources:
            target.sources.append(frame.name)


def _corners(values, mask, seen):
    """Return the corners between edges of an outline."""
    pairs = product(*([one for one in seen if one[0].is_upright is way] for way in (True, False)))
    found = (
        read_corner(values, mask, (one, two), (first.line, second.line))
        for (one, first), (two, second) in pairs
    )
    return [corner for corner in found if corner is not None]


def _sample(values, mask, edge, frame, faults):
    """Return the pixels of a channel around an edge, or None and a fault."""
    name = frame.name or "edges"
    try:
        sample = read_edge(values, mask, edge)
    except BadData as error:
        faults.append(f"{name}: {error}; use a larger target")
        return None
    if sample.noise > NOISIEST:
        faults.append(
            f"{name}: an edge is too noisy, {sample.noise:.2g} of its step; give more light, or a lower ISO"
        )
        return None
    return sample


def _places(target: _Target, scale, aperture):
    """Return the blur of each channel of a target."""
    every = list(dict.fromkeys(letter for letter, _ in target.samples))
    letters = sorted(every, key=lambda letter: letter != main_channel(every))
    found: dict[str, list[LineSpread | None]] = {}
    for letter in letters:
        cutoff = scale * WAVELENGTHS.get(letter, 550.0) * 1e-9
        leading = next(iter(found.values()), [None, None])
        found[letter] = [
            fit_line(samples, cutoff, aperture, main)
            if (samples := target.samples.get((letter, is_upright)))
            else None
            for is_upright, main in zip((True, False), leading, strict=True)
        ]
    lean = pool_leans(
        [
            fit_lean(target.corners[letter], across, down)
            for letter, (across, down) in found.items()
            if across and down
        ]
    )
    sources = tuple(target.sources)
    return [
        Place(target.row, target.col, letter, across, down, sources, lean)
        for letter, (across, down) in found.items()
    ]


def _usable(edges, frame, clipped):
    """Return the edges that can be measured, and why others cannot."""
    crossed = {is_upright: _widest_gap(frame, is_upright) for is_upright in (True, False)}
    used, faults, name = [], [], frame.name or "edges"
    for edge in edges:
        degrees = f"{np.degrees(edge.tilt):.2g} degrees from the pixels' axis"
        if edge.length * np.tan(edge.tilt) < crossed[edge.is_upright]:
            faults.append(
                f"{name}: an edge is too straight, {degrees}; turn the target by about 5 degrees"
            )
        elif edge.tilt > STEEPEST:
            faults.append(
                f"{name}: an edge is too steep, {degrees}; turn the target by about 5 degrees"
            )
        elif _clipped_share(edge, clipped) > 1e-3:
            faults.append(
                f"{name}: the light side of an edge is clipped; expose less, to half of the range"
            )
        else:
            used.append(edge)
    return used, faults


def _widest_gap(frame, is_upright):
    """Return the most pixels from a column (or row) with a channel's pixels to the next one.

    An edge that crosses as many has all distances to the channel's pixels.
    """
    period = np.array([list(row) for row in frame.cfa])
    period = period if is_upright else period.T
    gaps = []
    for letter in frame.channels:
        at = np.flatnonzero((period == letter).any(axis=0))
        gaps.append(np.diff(np.append(at, at[0] + period.shape[1])).max())
    return int(max(gaps))


def _clipped_share(edge: FoundEdge, clipped):
    reach = int(edge.width)
    row, col = (
        int(edge.row + reach / 2 * np.sin(edge.angle)),
        int(edge.col + reach / 2 * np.cos(edge.angle)),
    )
    part = clipped[
        max(row - reach // 2, 0) : row + reach // 2, max(col - reach // 2, 0) : col + reach // 2
    ]
    return float(part.mean()) if part.size else 0.0


def fit_sharpness(
    frames: RawFrame | Sequence[RawFrame],
    *,
    black: ArrayLike | None = None,
    pitch: float | None = None,
    f_number: float | None = None,
    aperture: tuple[float, float] = (1.0, 1.0),
    falloff: np.ndarray | None = None,
    lateral_color: dict[str, tuple[float, float]] | None = None,
) -> Part:
    """Fit point spreads over the field to frames of slanted edges.

    Args:
        frames: See `measure_sharpness`.
        black: See `measure_sharpness`.
        pitch: See `measure_sharpness`; needed for the settings of a camera file.
        f_number: See `measure_sharpness`.
        aperture: See `measure_sharpness`.
        falloff: See `measure_sharpness`.
        lateral_color: Image height over the main channel's, minus one, by channel: on the axis, and what a corner
            has more. It grows as the square of the height. Point spreads that hold lateral colour replace the key of
            that name.

    Returns:
        MTF50 by channel and place, and point spreads over the field under optics.psf.

    Raises:
        BadData: See `measure_sharpness`.
        OutOfRange: The pitch is not positive.
    """
    if pitch is not None and not 0 < pitch < 1e-3:
        raise OutOfRange("pitch", f"{pitch:g} m", "0 < pitch < 0.001")
    every = checked_frames(frames, "edges")
    places = measure_sharpness(
        every, black=black, pitch=pitch, f_number=f_number, aperture=aperture, falloff=falloff
    )
    shape = every[0].values.shape
    number = f_number or every[0].f_number
    unknown = _gaps(places, shape, pitch, number)
    settings = {}
    if pitch is not None:
        number = number or UNKNOWN_F_NUMBER
        spread = spread_over_field(places, shape, pitch, number, lateral_color or {})
        settings = {"optics": {"model": "measured", "psf": spread}}
    return Part(
        "sharpness",
        _estimates(places),
        settings,
        _plots(places, shape),
        _describe_misfit(places),
        unknown,
    )


def _estimates(places):
    found = {}
    for place in places:
        astigmatism = measure_astigmatism([one for one in places if one.letter == place.letter])
        both = mtf50_along_axes(place, astigmatism)
        for one, way in zip(both, ("along rows", "along columns"), strict=True):
            if one is not None:
                key = (
                    f"MTF50 {way} of {place.letter} at row {place.row:.0f}, column {place.col:.0f}"
                )
                found[key] = Estimate(*one, "cycle/pixel", place.sources)
    return found


def _gaps(places, shape, pitch, number):
    lines = [
        "blur between the directions of rows and columns, and its phase: the point spread is the roundest that fits "
        "the edges, and symmetric"
    ]
    if not number:
        lines.append(
            f"f-number: not in the files; f/{UNKNOWN_F_NUMBER:g} is assumed for the samples of the point spread; "
            "give it"
        )
    if pitch is None:
        lines.append("pixel pitch: not given, so no point spread; give it")
    for way in ("across", "down"):
        if all(getattr(place, way) is None for place in places):
            names = ("rows", "columns") if way == "across" else ("columns", "rows")
            lines.append(
                f"blur along {names[0]}: no edge shows it, that along {names[1]} is used; shoot squares"
            )
    if any(_hides_lean(place) for place in places):
        lines.append(
            "astigmatism between rows and columns: edges are turned one way only and neighbouring corners are not "
            "seen; shoot squares turned both ways, one way in half of the frames and the other way in the rest"
        )
    farthest = max(np.hypot(*field_place(place.row, place.col, shape)) for place in places)
    if farthest < 0.8:
        lines.append(
            f"blur beyond {farthest:.2f} of the way to the corner: no edge there, the nearest is used; shoot targets "
            "over the whole field"
        )
    return tuple(lines)


def _hides_lean(place: Place) -> bool:
    """Return True if neither corners nor edges turned both ways show the blur between rows and columns."""
    lines = place.across, place.down
    if place.lean is not None or None in lines:
        return False
    return any(abs(line.turn) > 0.5 * line.tilt for line in lines if line)


def _describe_misfit(places):
    worst = None
    for place in places:
        for line in (place.across, place.down):
            if line is None or line.misfit <= max(NOTICED * line.expected, LEAST_MISFIT):
                continue
            if worst is None or line.misfit > worst[0]:
                worst = line.misfit, line.expected, place
    if worst is None:
        return ()
    return (
        f"edges: residuals up to {100 * worst[0]:.2g} % of the step (noise explains {100 * worst[1]:.2g} %) in "
        f"{worst[2].letter} at row {worst[2].row:.0f}, column {worst[2].col:.0f}: an asymmetric blur, a "
        "sharpened raw or "
        "an edge that is not straight",
    )


def _plots(places, shape):
    def draw_curves(figure):
        axes = figure.subplots()
        f = np.linspace(0, 1, 201)
        letters = list(dict.fromkeys(place.letter for place in places))
        main = main_channel(letters)
        own = [place for place in places if place.letter == main]
        for place in own:
            height = np.hypot(*field_place(place.row, place.col, shape))
            for line, style in ((place.across, "-"), (place.down, "--")):
                if line is not None:
                    axes.plot(
                        f, np.abs(line.transfer(f)), style, color=(0.1, 0.3, 0.8, 1 - 0.7 * height)
                    )
        axes.axhline(0.5, color="0.7", linewidth=0.8)
        axes.axvline(0.5, color="0.7", linewidth=0.8)
        axes.set(
            xlabel="spatial frequency [cycle/pixel]", ylabel="MTF", ylim=(0, 1.02), xlim=(0, 1)
        )
        axes.set_title(f"channel {main}: along rows -, along columns --, paler to the corner")

    def draw_residuals(figure):
        axes = figure.subplots()
        for place in places:
            for line in (place.across, place.down):
                if line is not None:
                    axes.plot(line.residual[0], 100 * line.residual[1], ",", color="0.3")
        axes.set(xlabel="distance from the edge [pixel]", ylabel="residual [% of the step]")

    def draw_field(figure):
        axes = figure.subplots()
        main = main_channel(list(dict.fromkeys(place.letter for place in places)))
        own = [place for place in places if place.letter == main]
        astigmatism = measure_astigmatism(own)
        for place in own:
            words = [
                f"{one[0]:.3f}{sign}"
                for one, sign in zip(mtf50_along_axes(place, astigmatism), "↔↕", strict=True)
                if one is not None
            ]
            axes.text(place.col, place.row, "\n".join(words), ha="center", va="center", fontsize=8)
        axes.set(xlim=(0, shape[1]), ylim=(shape[0], 0), aspect="equal")
        axes.set(xlabel="column [pixel]", ylabel="row [pixel]")

    return (
        Plot("MTF over the field", "Lens and pixel together, from slanted edges.", draw_curves),
        Plot(
            "MTF50 at each target",
            "Cycles per pixel along rows (↔) and along columns (↕), at the target's place in the frame.",
            draw_field,
        ),
        Plot(
            "Edges: residuals",
            "Pixels around all edges less the fitted blur, in bins of 1/8 pixel. A pattern at the edge is an "
            "asymmetric blur or sharpening.",
            draw_residuals,
        ),
    )

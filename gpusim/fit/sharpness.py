"""Blur over the field from slanted edges, as point spreads for a camera file."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.psf import PointSpread
from gpusim.domain.short_repr import short_repr
from gpusim.fit.edge_finding import STEEPEST, FoundEdge, find_edges
from gpusim.fit.edge_fit import (
    DISCS,
    GAUSSIANS,
    EdgeSamples,
    LineSpread,
    diffraction,
    disc_transfer,
    falls_to_half,
    fit_line,
    read_edge,
)
from gpusim.fit.estimate import Estimate, Part, Plot
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

STRAIGHTEST = 1.0  # periods of the mosaic that an edge must cross along its length
SAME = 0.3  # of an edge's length by which two frames' targets may be apart and still be one
NOISIEST = 0.2  # noise of a pixel over the step
UNKNOWN_F_NUMBER = 4.0
SHORTEST_WAVE = 400e-9  # [m] that the samples of a point spread must determine
LOST = 3e-3  # of the energy outside a point spread's array
WINDOW = 32  # [pixel] on each side of a point spread at most
NODES = 5  # of the grid over the longer side of the frame
NOTICED = 3.0  # times the expected residual
LEAST_MISFIT = 0.004  # residual over the step that is not worth a line
FIELD_ENDS = 300.0, 1100.0  # [nm] within which the outermost channels' spreads continue
UNLIKE = 0.03  # relative difference of the channels' MTF50 from which each has its own spread


@dataclass(frozen=True, eq=False)
class Place:
    """Blur of one channel at one place in the frame.

    Args:
        row, col: The place [pixel].
        letter: The channel.
        across, down: Blur along rows and along columns; None: no edge shows it.
        sources: Names of the files.
    """

    row: float
    col: float
    letter: str
    across: LineSpread | None
    down: LineSpread | None
    sources: tuple[str, ...] = ()

    __repr__ = short_repr


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
    sources: list[str]


def _gather(targets: list[_Target], frame, values, edges, faults):
    """Add the pixels of a frame's edges to the targets; outlines at one place are one target."""
    masks = letter_masks(frame)
    for number in dict.fromkeys(edge.target for edge in edges):
        own = [edge for edge in edges if edge.target == number]
        row, col = np.mean([(edge.row, edge.col) for edge in own], axis=0)
        size = max(edge.length for edge in own)
        same = [one for one in targets if np.hypot(one.row - row, one.col - col) < SAME * size]
        target = same[0] if same else _Target(float(row), float(col), size, {}, [])
        for edge in own:
            for letter, mask in masks.items():
                sample = _sample(values, mask, edge, frame, faults)
                if sample is not None:
                    target.samples.setdefault((letter, edge.is_upright), []).append(sample)
        if target.samples and not same:
            targets.append(target)
        if target.samples and frame.name not in target.sources:
            target.sources.append(frame.name)


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
    found = []
    for letter in dict.fromkeys(letter for letter, _ in target.samples):
        cutoff = scale * WAVELENGTHS.get(letter, 550.0) * 1e-9
        lines = [
            fit_line(samples, cutoff, aperture)
            if (samples := target.samples.get((letter, is_upright)))
            else None
            for is_upright in (True, False)
        ]
        found.append(
            Place(target.row, target.col, letter, lines[0], lines[1], tuple(target.sources))
        )
    return found


def _usable(edges, frame, clipped):
    """Return the edges that can be measured, and why others cannot."""
    period = max(len(frame.cfa), len(frame.cfa[0]))
    used, faults, name = [], [], frame.name or "edges"
    for edge in edges:
        degrees = f"{np.degrees(edge.tilt):.2g} degrees from the pixels' axis"
        if edge.length * np.tan(edge.tilt) < STRAIGHTEST * period:
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
    lateral_color: dict[str, float] | None = None,
) -> Part:
    """Fit point spreads over the field to frames of slanted edges.

    Args:
        frames: See `measure_sharpness`.
        black: See `measure_sharpness`.
        pitch: See `measure_sharpness`; needed for the settings of a camera file.
        f_number: See `measure_sharpness`.
        aperture: See `measure_sharpness`.
        falloff: See `measure_sharpness`.
        lateral_color: Image height over the main channel's, minus one, by channel: point spreads that hold lateral
            colour replace the key of that name.

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
        for line, way in ((place.across, "along rows"), (place.down, "along columns")):
            if line is not None:
                value, low, high = line.mtf50
                key = (
                    f"MTF50 {way} of {place.letter} at row {place.row:.0f}, column {place.col:.0f}"
                )
                found[key] = Estimate(value, low, high, "cycle/pixel", place.sources)
    return found


def _gaps(places, shape, pitch, number):
    lines = [
        "blur between the directions of rows and columns, and its phase: edges of two directions do not show them; the "
        "point spread is the roundest that fits, and symmetric"
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
    farthest = max(np.hypot(*field_place(place.row, place.col, shape)) for place in places)
    if farthest < 0.8:
        lines.append(
            f"blur beyond {farthest:.2f} of the way to the corner: no edge there, the nearest is used; shoot targets "
            "over the whole field"
        )
    return tuple(lines)


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


def spread_over_field(
    places: Sequence[Place],
    shape: tuple[int, int],
    pitch: float,
    f_number: float,
    lateral_color: dict[str, float],
) -> PointSpread:
    """Return point spreads on a grid over the frame.

    Args:
        places: Blur at some places.
        shape: Rows and columns of the frame.
        pitch: Pixel pitch [m].
        f_number: F-number, for the distance of the samples and diffraction.
        lateral_color: See `fit_sharpness`.

    Returns:
        Point spreads; one if there is one place and no lateral colour.
    """
    letters = list(dict.fromkeys(place.letter for place in places))
    main = main_channel(letters)
    if not lateral_color and not _channels_differ(places, main):
        letters = [main]
    letters.sort(key=lambda letter: WAVELENGTHS.get(letter, 550.0))
    fine = int(np.ceil(2 * pitch / (SHORTEST_WAVE * f_number)))
    spots = list({(place.row, place.col) for place in places if place.letter == main})
    nodes = _nodes(shape) if len(spots) > 1 or lateral_color else None
    tables = []
    for letter in letters:
        own = [place for place in places if place.letter == letter]
        cutoff = WAVELENGTHS.get(letter, 550.0) * 1e-9 * f_number / pitch
        weights = [point_weights(place, cutoff) for place in own]
        excess = lateral_color.get(letter, 0.0)
        tables.append(_sample_spreads(own, weights, cutoff, fine, nodes, shape, excess))
    values = _trim(np.stack(tables, axis=-3), fine)
    waves = [WAVELENGTHS.get(letter, 550.0) for letter in letters]
    values = np.concatenate([values[..., :1, :, :], values, values[..., -1:, :, :]], axis=-3)
    grid = None
    if nodes is not None:
        corner = np.hypot(*shape) / 2
        grid = tuple(
            (np.array(axis) - (n - 1) / 2) / corner for axis, n in zip(nodes, shape, strict=True)
        )
    else:
        values = values[0, 0]
    wavelengths = np.array([FIELD_ENDS[0], *waves, FIELD_ENDS[1]])
    return PointSpread(wavelengths, values, pitch / fine, grid=grid)


def _channels_differ(places, main):
    """Return True if a channel's MTF50 is not the main one's somewhere, beyond its interval."""
    leading = {(place.row, place.col): place for place in places if place.letter == main}
    for place in places:
        other = leading.get((place.row, place.col))
        for way in ("across", "down"):
            one, two = getattr(place, way), getattr(other, way, None)
            if one is None or two is None:
                continue
            (value, low, high), wanted = one.mtf50, two.mtf50[0]
            if abs(value / wanted - 1) > UNLIKE and not low < wanted < high:
                return True
    return False


def _nodes(shape):
    """Return rows and columns of the grid's nodes, evenly from edge to edge of the frame."""
    step = max(shape) / (NODES - 1)
    return [np.linspace(-0.5, n - 0.5, max(3, round(n / step) + 1)) for n in shape]


def _pairs():
    """Return sizes along x and along y of Gaussians and of discs, as four arrays."""
    x, y = (axis.ravel() for axis in np.meshgrid(GAUSSIANS, GAUSSIANS))
    p, q = (axis.ravel() for axis in np.meshgrid(DISCS, DISCS))
    near = np.abs(np.log(p / q)) < 1.0
    return x, y, p[near], q[near]


def _point_transfers(fx, fy, cutoff):
    """Return the transfers of elliptical Gaussians and discs, with diffraction, (A, *fx.shape)."""
    x, y, p, q = (size.reshape(-1, *(1,) * np.ndim(fx)) for size in _pairs())
    plain = np.concatenate(
        [
            np.exp(-2 * np.pi**2 * ((x * fx) ** 2 + (y * fy) ** 2)),
            disc_transfer(np.hypot(p * fx, q * fy)),
        ]
    )
    return plain * diffraction(np.hypot(fx, fy), cutoff)


def point_weights(place: Place, cutoff: float) -> np.ndarray:
    """Return weights of elliptical Gaussians and discs whose transfers along rows and columns are a place's.

    Args:
        place: The place. A direction without an edge has the other's blur.
        cutoff: Wavelength times f-number over the pitch [1].

    Returns:
        Weights, sum 1.
    """
    across, down = place.across or place.down, place.down or place.across
    assert across is not None
    assert down is not None
    f = np.linspace(0, min(1.5, 2.5 * max(across.mtf50[0], down.mtf50[0])), 60)[1:]
    zero = np.zeros_like(f)
    matrix = np.concatenate(
        [_point_transfers(f, zero, cutoff), _point_transfers(zero, f, cutoff)], axis=1
    ).T
    wanted = np.concatenate([across.transfer(f, False), down.transfer(f, False)])
    # what counts is the transfer with the pixel, around the half most of all
    seen = np.concatenate([across.transfer(f), down.transfer(f)])
    trust = np.concatenate([np.abs(np.sinc(f * line.aperture)) for line in (across, down)])
    trust = trust * (1 + 4 * np.exp(-(((seen - 0.5) / 0.15) ** 2)))
    x, y, p, q = _pairs()
    shape = np.concatenate(
        [np.abs(np.log((x + 0.1) / (y + 0.1))), np.abs(np.log(p / q))]
    )  # of round ones 0
    penalty = np.diag(1e-3 * (1 + shape))
    total = np.full((1, matrix.shape[1]), 100.0)
    system = np.vstack([matrix * trust[:, None], penalty, total])
    aim = np.concatenate([wanted * trust, np.zeros(len(penalty)), [100.0]])
    triangle = np.asarray(np.linalg.qr(np.hstack([system, aim[:, None]]), mode="r"))
    weights = scipy.optimize.nnls(triangle[:, :-1], triangle[:, -1])[0]
    return weights / weights.sum()


def _sample_spreads(places, weights, cutoff, fine, nodes, shape, excess):
    """Return point spreads (Y, X, n, n) at the nodes, `fine` samples to a pixel; (1, 1, n, n) without nodes."""
    half = WINDOW * fine
    size = scipy.fft.next_fast_len(2 * half + 1)
    fx = np.fft.rfftfreq(size, 1 / fine)
    fy = np.fft.fftfreq(size, 1 / fine)
    used = np.flatnonzero(np.max(weights, axis=0) > 1e-6)
    atoms = _used_transfers(fx[None, :], fy[:, None], cutoff, used)
    rows, cols = nodes if nodes is not None else ([0.0], [0.0])
    table = np.empty((len(rows), len(cols), 2 * half + 1, 2 * half + 1))
    spots = np.array([(place.row, place.col) for place in places])
    for i, row in enumerate(rows):
        for j, col in enumerate(cols):
            mixed = _shares(spots, row, col) @ np.array(weights)[:, used]
            otf = np.tensordot(mixed, atoms, 1)
            down, across = (
                excess * (at - (n - 1) / 2) if nodes is not None else 0.0
                for at, n in zip((row, col), shape, strict=True)
            )
            otf = otf * np.exp(-2j * np.pi * (fy[:, None] * down + fx[None, :] * across))
            spread = np.fft.fftshift(np.fft.irfft2(otf, (size, size)))
            middle = size // 2
            part = slice(middle - half, middle + half + 1)
            table[i, j] = np.maximum(spread[part, part], 0)
    return table


def _used_transfers(fx, fy, cutoff, used):
    """Return `_point_transfers` of some atoms on a grid, without the others' memory."""
    x, y, p, q = _pairs()
    count, cut = len(x), diffraction(np.hypot(fx, fy), cutoff)
    found = []
    for own in used:
        if own < count:
            one = np.exp(-2 * np.pi**2 * ((x[own] * fx) ** 2 + (y[own] * fy) ** 2))
        else:
            one = disc_transfer(np.hypot(p[own - count] * fx, q[own - count] * fy))
        found.append(one * cut)
    return np.stack(found)


def _shares(spots, row, col):
    """Return the share of each measured place in a node: linear between places, the nearest beyond them."""
    from scipy.spatial import Delaunay, QhullError

    if len(spots) == 1:
        return np.ones(1)
    point = np.array([row, col])
    if len(spots) >= 3:
        try:
            mesh = Delaunay(spots)
        except QhullError:
            mesh = None
        if mesh is not None and (number := int(mesh.find_simplex(point))) >= 0:
            part = mesh.transform[number]
            inner = part[:2] @ (point - part[2])
            shares = np.zeros(len(spots))
            shares[mesh.simplices[number]] = np.append(inner, 1 - inner.sum())
            return np.maximum(shares, 0) / np.maximum(shares, 0).sum()
    distance = np.hypot(*(spots - point).T)
    near = 1 / np.maximum(distance, 1e-6) ** 4
    return near / near.sum()


def _trim(values, fine):
    """Return point spreads without the border that holds next to no energy."""
    middle = values.shape[-1] // 2
    worst = values.reshape(-1, *values.shape[-2:])
    worst = worst / worst.sum((1, 2), keepdims=True)
    for reach in range(2, WINDOW):
        part = slice(middle - reach * fine, middle + reach * fine + 1)
        if worst[:, part, part].sum((1, 2)).min() >= 1 - LOST:
            return values[..., part, part]
    return values


def spread_mtf50(spread: np.ndarray, fine: float, aperture: float, is_across: bool) -> float:
    """Return MTF50 [cycle/pixel] of a sampled point spread and a pixel.

    Args:
        spread: Samples, shape (n, n).
        fine: Samples to a pixel.
        aperture: Width of the pixel's aperture over the pitch.
        is_across: Along rows; else along columns.

    Returns:
        The frequency.
    """
    line = spread.sum(0 if is_across else 1)
    place = (np.arange(len(line)) - (len(line) - 1) / 2) / fine
    f = np.linspace(0, 2, 2001)
    response = np.abs(np.exp(-2j * np.pi * np.outer(f, place)) @ line) / line.sum()
    return falls_to_half(f, response * np.abs(np.sinc(f * aperture)))


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
        for place in places:
            if place.letter != main:
                continue
            words = [
                f"{line.mtf50[0]:.3f}{sign}"
                for line, sign in ((place.across, "↔"), (place.down, "↕"))
                if line is not None
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

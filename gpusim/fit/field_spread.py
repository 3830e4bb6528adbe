"""Point spreads over the field from the blur of measured edges."""

from collections.abc import Sequence

import numpy as np
import scipy

from gpusim.domain.psf import PointSpread
from gpusim.fit.edge_axes import measure_astigmatism, mtf50_along_axes
from gpusim.fit.edge_fit import (
    DISCS,
    GAUSSIANS,
    Place,
    diffraction,
    disc_transfer,
)
from gpusim.fit.planes import (
    WAVELENGTHS,
    main_channel,
)

SHORTEST_WAVE = 400e-9  # [m] that the samples of a point spread must determine
LOST = 3e-3  # of the energy outside a point spread's array
WINDOW = 32  # [pixel] on each side of a point spread at most
NODES = 5  # of the grid over the longer side of the frame
TOGETHER = 0.2  # of the nodes' distance within which targets stand in one row
FIELD_ENDS = 300.0, 1100.0  # [nm] within which the outermost channels' spreads continue
UNLIKE = 0.03  # relative difference of the channels' MTF50 from which each has its own spread


def spread_over_field(
    places: Sequence[Place],
    shape: tuple[int, int],
    pitch: float,
    f_number: float,
    lateral_color: dict[str, tuple[float, float]],
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
    nodes = _nodes(shape, spots) if len(spots) > 1 or lateral_color else None
    tables = []
    for letter in letters:
        own = [place for place in places if place.letter == letter]
        cutoff = WAVELENGTHS.get(letter, 550.0) * 1e-9 * f_number / pitch
        lean = measure_astigmatism(own)
        weights = [point_weights(place, cutoff, lean) for place in own]
        excess = lateral_color.get(letter, (0.0, 0.0))
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


def _nodes(shape, spots):
    """Return rows and columns of the grid's nodes, from edge to edge of the frame.

    If targets stand in rows and columns, their places are nodes; otherwise nodes are even.
    """
    step = max(shape) / (NODES - 1)
    found = []
    for n, at in zip(shape, np.transpose(spots), strict=True):
        order = np.sort(at)
        lines = np.split(order, np.flatnonzero(np.diff(order) > TOGETHER * step) + 1)
        is_aligned = all(np.ptp(line) < TOGETHER * step for line in lines)
        if is_aligned and 1 < len(lines) <= NODES:
            found.append(np.array([-0.5, *(line.mean() for line in lines), n - 0.5]))
        else:
            found.append(np.linspace(-0.5, n - 0.5, max(3, round(n / step) + 1)))
    return found


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


def point_weights(place: Place, cutoff: float, astigmatism: float = 0.0) -> np.ndarray:
    """Return weights of elliptical Gaussians and discs whose transfers along rows and columns are a place's.

    Args:
        place: The place. A direction without an edge has the other's blur.
        cutoff: Wavelength times f-number over the pitch [1].
        astigmatism: See `mtf50_along_axes`.

    Returns:
        Weights, sum 1.
    """
    lines = [line for line in (place.across or place.down, place.down or place.across) if line]
    halves = [one and one[0] for one in mtf50_along_axes(place, astigmatism)]
    ends = [line.mtf50[0] for line in lines]
    # an edge's transfer along its normal, stretched to the MTF50 along the axis
    stretches = [end / (half or end) for end, half in zip(ends, halves, strict=True)]
    f = np.linspace(0, min(1.5, 2.5 * max(ends)), 60)[1:]
    zero = np.zeros_like(f)
    matrix = np.concatenate(
        [_point_transfers(f, zero, cutoff), _point_transfers(zero, f, cutoff)], axis=1
    ).T
    # what counts is the transfer with the pixel, around the half most of all
    seen = np.concatenate(
        [line.transfer(f * one) for line, one in zip(lines, stretches, strict=True)]
    )
    pixel = np.concatenate([np.sinc(f * line.aperture) for line in lines])
    trust = 1 + 4 * np.exp(-(((seen - 0.5) / 0.15) ** 2))
    x, y, p, q = _pairs()
    shape = np.concatenate(
        [np.abs(np.log((x + 0.1) / (y + 0.1))), np.abs(np.log(p / q))]
    )  # of round ones 0
    penalty = np.diag(1e-3 * (1 + shape))
    total = np.full((1, matrix.shape[1]), 100.0)
    system = np.vstack([matrix * (pixel * trust)[:, None], penalty, total])
    aim = np.concatenate([seen * trust, np.zeros(len(penalty)), [100.0]])
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
            away = np.array([row, col]) - (np.array(shape) - 1) / 2
            away *= nodes is not None
            height = np.hypot(*away) / (np.hypot(*shape) / 2)
            down, across = (excess[0] + excess[1] * height**2) * away
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

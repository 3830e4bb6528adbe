"""Source places of pixels: the inverse of a distortion on a coarse grid, and the fall-off toward the corner."""

from dataclasses import dataclass, replace
from itertools import pairwise
from math import ceil

import numpy as np
import scipy

from gpusim.domain.distortion import Model, ideal
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import View
from gpusim.domain.sensor import Microlens
from gpusim.optics.lens import Lens

STEPS = (64, 32, 16, 8, 4, 2, 1)  # [pixel] between nodes, at most
FINER = (
    1 / 2,
    1 / 4,
    1 / 8,
)  # if the tolerance needs it, in frames of up to MOST_NODES along a side
MOST_NODES = 1024
# error of places and fluxes that is small enough; cells along an axis for it, at most
AIM = 1e-4
MOST_CELLS = 128
PHASES = 32  # of places between samples that stand for all
MOST_PLACES = 256  # along an axis of a frame that stand for its pixels
PARTS = 8  # of a frame along an axis; its largest errors are in the worst part
LEAST_LOBES = 4.5  # of brightest over darkest of 4 x 4 samples: cubics stay above 0 below it (81 / 18 at the middle)
RIMS = (
    32,
    16,
    8,
    4,
    2,
)  # [sample] around a frame that are displaced as well, where the lens's model goes so far
STEEPEST = 2.0  # largest flux factor with the rim over the frame's own
RIM_PLACES = 33  # along an axis, at which these are looked at
# places along rows and columns whose spreads give the flat field, as in `gpusim.optics.field`, and
# [sample] between them, at least
FIELD_NODES = (15, 25)
FIELD_SPACING = 8
# heights at which ripples of coarse pixels are found, and most [sample] that a spot moves from one to the next
RIPPLE_PLACES, RIPPLE_STEP = 65, 0.2
RATIO_TO_REPORT = 2.0  # source samples per pixel beyond which point sampling aliases


@dataclass(frozen=True, eq=False)
class DistortionGrid:
    """The inverse mapping of a frame, for the stage `optics.distort`.

    Attributes:
        nodes: Offsets to add to a pixel's (row, column) index for its place among the source
            samples, and the flux factor, ideal area over distorted area, shape (ny, nx, 3). The
            nodes divide the frame evenly, the outermost lie on its edges; the stage
            interpolates with cubic Lagrange polynomials.
        error: Largest distance [source sample] and relative error of the flux factor of that
            interpolation, measured between the nodes.
        typical: Root mean squares of the same.
        ratio: Smallest and largest source samples per pixel along any direction. Beyond
            `RATIO_TO_REPORT` only area weighting does not alias.
        reach: Source samples beyond the edge of the source frame that the frame sees; 0 if the
            source is large enough.
        is_even: Whether flat fields stay flat, because a relative illumination that is given
            says how bright they are. Else they are brighter at places at which points crowd.
    """

    nodes: np.ndarray
    error: tuple[float, float]
    typical: tuple[float, float]
    ratio: tuple[float, float]
    reach: float
    is_even: bool = False

    @property
    def method(self) -> str:
        """Method of `optics.distort`: "cubic", or "area" if a pixel has more than `RATIO_TO_REPORT` samples."""
        return "area" if self.ratio[1] > RATIO_TO_REPORT else "cubic"

    @property
    def report(self) -> str:
        """Line of the report."""
        line = (
            f"{self.ratio[0]:.3g} .. {self.ratio[1]:.3g} source samples per pixel, position to {self.error[0]:.1e} "
            f"of a sample, flux to {self.error[1]:.1e}"
        )
        if self.ratio[1] > RATIO_TO_REPORT:
            line += f"; more than {RATIO_TO_REPORT:g} samples per pixel: area weighting"
        return line + (
            f"; the frame sees {self.reach:.0f} samples beyond the source" if self.reach > 0 else ""
        )

    def even(self, level: float) -> "DistortionGrid":
        """Return a grid that keeps flat fields flat.

        Args:
            level: Light of a flat field of 1.
        """
        nodes = self.nodes.copy()
        nodes[..., 2] = level
        return replace(self, nodes=nodes, is_even=True)


def distortion_grid(
    distortion: Model,
    shape,
    pitch,
    source_shape=None,
    source_pitch=None,
    tolerance=1e-3,
    finest=FINER[-1],
) -> DistortionGrid:
    """Invert `distortion` for a frame of `shape` = (rows, cols) pixels of `pitch` [m], centred on the axis.

    source_shape, source_pitch: samples of the undistorted image, centred as well; the same as the frame by default.
    tolerance: largest error of the interpolated positions [source sample] that is allowed. The coarsest grid that errs
    by at most AIM is chosen, but none finer than MOST_CELLS, than a pixel or than the tolerance needs. finest: least
    distance of nodes [pixel]. Raises OutOfRange for a distortion that cannot be inverted over the frame, or not so
    well.
    """
    source_shape, source_pitch = source_shape or shape, source_pitch or pitch

    def places(rows, cols):
        """Index difference and flux factor for pixel indices (broadcast), and the derivative's singular values."""
        y = (rows[:, None] - (shape[0] - 1) / 2) * (pitch / distortion.radius)
        x = (cols - (shape[1] - 1) / 2) * (pitch / distortion.radius)
        u, v = ideal(distortion, x, y)
        a, b, c, d = distortion.derivative(u, v)
        flux = 1 / (a * d - b * c)
        back = distortion.radius / source_pitch
        down = v * back + (source_shape[0] - 1) / 2 - rows[:, None]
        across = u * back + (source_shape[1] - 1) / 2 - cols
        values = np.stack([down, across, flux], axis=-1)
        s1 = _stretch(a, b, c, d)
        ratio = pitch / source_pitch
        # 1/s1 the smallest, 1/s2 = flux s1 the largest
        return values, (ratio / s1.max(), ratio * (flux * s1).max())

    error = np.inf, np.inf
    for step in (*STEPS, *FINER):
        if step < 1 and (error[0] <= tolerance or step < finest or max(shape) / step > MOST_NODES):
            break
        cells = [max(3, ceil(n / step)) for n in shape]
        edges = _edges(shape, np.add(cells, 1))
        values, ratio = places(*edges)
        # about where cubics err most
        between, _ = places(*((edge[1:] + edge[:-1]) / 2 for edge in edges))
        middle = np.einsum("yi,xj,ijk->yxk", *map(_half_way, cells), values, optimize=True)
        moved = np.hypot(middle[..., 0] - between[..., 0], middle[..., 1] - between[..., 1])
        wrong = moved, np.abs(middle[..., 2] / between[..., 2] - 1)
        error = float(wrong[0].max()), float(wrong[1].max())
        if max(error) <= AIM or (error[0] <= tolerance and 2 * max(cells) > MOST_CELLS):
            break
    if error[0] > tolerance:
        raise OutOfRange(
            "distortion",
            f"varies too fast: {error[0]:.2e} of a sample between nodes "
            f"{max(shape) / max(cells):.3g} pixels apart",
            f"at most {tolerance:g}; or a panorama, see gs.view_panorama",
        )
    corners = values[..., :2] + np.stack(np.meshgrid(*edges, indexing="ij"), -1)
    reach = max(0.0, -(corners + 0.5).min(), (corners + 0.5 - source_shape).max())
    typical = float(np.sqrt(np.mean(wrong[0] ** 2))), float(np.sqrt(np.mean(wrong[1] ** 2)))
    return DistortionGrid(values, error, typical, ratio, float(reach))


def _stretch(a, b, c, d):
    """Larger singular value s1 of 2 x 2 matrices, from s1 s2 = det and s1^2 + s2^2 = sum of squares."""
    squares, twice = a * a + b * b + c * c + d * d, 2 * (a * d - b * c)
    return (np.sqrt(squares + twice) + np.sqrt(np.maximum(squares - twice, 0))) / 2


def rim_of(distortion: Model, shape: tuple[int, int], pitch: float) -> int:
    """Return how far around a frame of `shape` light is displaced as well [sample], RIMS or less.

    A blur brings it in. The border's rule then holds for the scene, not for its distorted picture. It ends before the
    lens's picture does, where the light of the corners rises without end, and where pixels would need area weighting
    that do not in the frame.
    """

    def look(rim):
        """Largest flux factor and most samples per pixel over the frame and the rim."""
        y, x = ((n / 2 + rim) * (pitch / distortion.radius) for n in shape)
        places = np.linspace(-1, 1, RIM_PLACES)
        down, across = np.meshgrid(y * places, x * places, indexing="ij")
        a, b, c, d = distortion.derivative(*ideal(distortion, across, down))
        flux = 1 / (a * d - b * c)
        return float(flux.max()), float((flux * _stretch(a, b, c, d)).max())

    if min(shape) < RIMS[0]:
        return 0  # most of what a blur brings in would lie beyond the lens's picture
    try:
        flux, ratio = look(0)
        if abs(flux - 1) < 1e-12 and abs(ratio - 1) < 1e-12:
            return 0  # nothing is displaced
    except OutOfRange:
        return 0
    for rim in RIMS:
        try:
            brighter, wider = look(rim)
            if brighter > STEEPEST * flux or wider > max(0.9 * RATIO_TO_REPORT, ratio):
                continue
            rows, cols = (n + 2 * rim for n in shape)
            distortion_grid(distortion, (rows, cols), pitch, shape, finest=STEPS[-1])
        except OutOfRange:
            continue
        return rim
    return 0


def _edges(shape, nodes):
    """Places of a grid's nodes along both axes, from edge to edge of a frame [pixel]."""
    (rows, cols), (down, across) = shape, nodes
    return np.linspace(0, rows, down) - 0.5, np.linspace(0, cols, across) - 0.5


def view_nodes(
    view: View, distortion: DistortionGrid | None, shape, source_shape, ratio: float
) -> np.ndarray:
    """Return nodes, as of a DistortionGrid, of a view of the lens's picture, (ny, nx, 3).

    An affine map of cubic interpolants is the interpolant of the mapped nodes, so it adds no error.

    Args:
        view: The view.
        distortion: The lens's; None: a pinhole.
        shape: Of the result [sample].
        source_shape: Of the source [sample].
        ratio: Samples per pixel.
    """
    if distortion is None:
        nodes = np.zeros((4, 4, 3))
        nodes[..., 2] = 1
    else:
        nodes = distortion.nodes.copy()
    edges = _edges(shape, nodes.shape[:2])
    own, its = (np.array(shape) - 1) / 2, (np.array(source_shape) - 1) / 2
    middle = its if distortion is not None else own  # from the nodes so far
    y, x = (nodes[..., axis] + place - middle[axis] for axis, place in enumerate(np.ix_(*edges)))
    y, x = view.place(y, x, ratio)
    nodes[..., 0], nodes[..., 1] = y + its[0] - edges[0][:, None], x + its[1] - edges[1]
    return nodes


def places_of(
    nodes: np.ndarray, shape: tuple[int, int], box: tuple[slice, slice] = np.s_[:, :]
) -> tuple[np.ndarray, ...]:
    """Return rows and columns of the source of the samples of a frame, and their flux factor.

    Args:
        nodes: As of a DistortionGrid, (ny, nx, 3).
        shape: Rows and columns of the frame [sample].
        box: The samples that are wanted, by default all.
    """
    (every_y, along_y), (every_x, along_x) = (
        (np.arange(n)[its], lagrange_weights(count, (np.arange(n)[its] + 0.5) / n))
        for count, n, its in zip(nodes.shape[:2], shape, box, strict=True)
    )
    down, across, flux = (along_y @ nodes[..., part] @ along_x.T for part in range(3))
    return down + every_y[:, None], across + every_x, flux


def lagrange_weights(count: int, places: np.ndarray) -> np.ndarray:
    """Return the weight of each of `count` nodes at places, shape (places, count).

    The polynomials equal those in `optics.distort`.

    Args:
        count: Number of nodes, spread evenly from edge to edge.
        places: 0 .. 1 from edge to edge, shape (places,).
    """
    place = places * (count - 1)
    first = np.clip(place.astype(int) - 1, 0, count - 4)
    weights = np.zeros((len(place), count))
    for a in range(4):
        weights[np.arange(len(place)), first + a] = np.prod(
            [(place - first - b) / (a - b) for b in range(4) if b != a], 0
        )
    return weights


def evening(nodes: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the gains that make flat fields flat after area weighting, (rows, cols).

    Area weighting gives each pixel the area that it looks at.

    Args:
        nodes: Of a grid that is even, see `DistortionGrid`, or of its view.
        shape: Rows and columns of the result.
    """
    along_y, along_x = (
        lagrange_weights(count, np.arange(n + 1) / n)
        for count, n in zip(nodes.shape[:2], shape, strict=True)
    )
    y, x = (along_y @ nodes[..., axis] @ along_x.T for axis in (0, 1))
    y, x = y + np.arange(shape[0] + 1)[:, None], x + np.arange(shape[1] + 1)
    # of a quadrilateral, by its diagonals
    (y0, x0), (y1, x1) = (
        (at[1:, 1:] - at[:-1, :-1] for at in (y, x)),
        (at[:-1, 1:] - at[1:, :-1] for at in (y, x)),
    )
    return nodes[0, 0, 2] * 2 / np.abs(y0 * x1 - x0 * y1)


def flat_of_lens(
    lens: Lens,
    wavelengths: np.ndarray,
    shares: np.ndarray,
    rows: np.ndarray,
    cols: np.ndarray,
    corner: float,
    counts: tuple[int, int] = FIELD_NODES,
) -> np.ndarray:
    """Return the light of a flat field through a lens whose blur varies, relative to the axis.

    A flat field is the sum of its points. Spreads with the centroids c and the second moments M give it 1 - div c +
    (d2 M_yy / dy2 + d2 M_xx / dx2) / 2 + d2 M_yx / dy dx. Second moments count for lenses whose kernels hold all
    light: for others see `widening`.

    Args:
        lens: The lens.
        wavelengths: [nm], shape (L,).
        shares: Share of each wavelength in the light of each channel, shape (C, L), sums 1.
        rows: Rows of places from the axis [sample].
        cols: Columns of places from the axis [sample].
        corner: Distance of the frame's corner from its middle [sample]: field height 1.
        counts: Places along rows and columns whose spreads are looked at.

    Returns:
        Flat fields, float64, shape (C, rows, cols).
    """
    # nodes on either side of the axis, at which they are relative to
    nodes = []
    for at, count in zip((rows, cols), counts, strict=True):
        low, high = min(at.min(), -1.0), max(at.max(), 1.0)
        nodes.append(np.linspace(low, high, min(count, max(int(high - low) // FIELD_SPACING, 5))))
    moments = np.empty((*map(len, nodes), len(shares), 5))
    for i, y in enumerate(nodes[0]):
        for j, x in enumerate(nodes[1]):
            place = (y / corner, x / corner)
            if lens.tail is not None:
                moments[i, j, :, :2] = shares @ lens.centroids(wavelengths, place)
                moments[i, j, :, 2:] = 0
            else:
                kernels = lens.kernels(wavelengths, place, lens.least_size | 1)
                moments[i, j] = np.tensordot(shares, kernel_moments(kernels), 1)
    orders = (1, 0, -1.0), (0, 1, -1.0), (2, 0, 0.5), (0, 2, 0.5), (1, 1, 1.0)
    flats = []
    for channel in range(len(shares)):
        flat, axis = np.ones((len(rows), len(cols))), 1.0
        for number, (down, across, sign) in enumerate(orders):
            if not moments[:, :, channel, number].any():
                continue
            spline = scipy.interpolate.RectBivariateSpline(*nodes, moments[:, :, channel, number])
            flat += sign * spline(rows, cols, dx=down, dy=across)
            axis += sign * spline(0, 0, dx=down, dy=across).item()
        flats.append(flat / axis)
    return np.array(flats)


def kernel_moments(kernels: np.ndarray) -> np.ndarray:
    """Return first and second moments (y, x, y y, x x, y x) of kernels (n, m, m) [sample], shape (n, 5)."""
    at = np.arange(kernels.shape[-1]) - kernels.shape[-1] // 2.0
    y, x = np.meshgrid(at, at, indexing="ij")
    return np.tensordot(kernels, np.stack([y, x, y**2, x**2, y * x]), ((1, 2), (1, 2)))


def widening(lens: Lens, wavelengths: np.ndarray, corner: float) -> float:
    """Return a bound on the part of a flat field that comes from spreads that widen with the field height.

    Spreads of half the radius R of the rays [root mean square, both axes together] that grow as R h^2 (field
    curvature and astigmatism) give R^2 h^2 / corner^2, see `flat_of_lens`.
    """
    if lens.tail is None:
        return 0.0  # the flat holds it
    grown = lens.spread(wavelengths, 1.0) ** 2 - lens.spread(wavelengths) ** 2
    return max(grown, 0.0) / corner**2


def pixel_ripple(
    lens: Lens, wavelengths: np.ndarray, shares: np.ndarray, corner: float, farthest: float
) -> float:
    """Return the largest relative ripple of flat fields, because coarse pixels do not follow spots within them.

    It is the divergence of `lens.moments` less `lens.centroids`, along a row and along a diagonal.

    Args:
        lens: The lens.
        wavelengths: [nm], shape (L,).
        shares: Share of each wavelength in the light of each channel, shape (C, L), sums 1.
        corner: Distance of the frame's corner from its middle [sample]: field height 1.
        farthest: Distance of the farthest place from the axis [sample].

    Returns:
        The ripple [1]; infinite if spots move too fast over the field to find it.
    """
    if lens.tail is None or lens.q(wavelengths).min() >= 1:
        return 0.0
    heights, most = np.linspace(0, farthest / corner, RIPPLE_PLACES), 0.0
    for direction in (np.array([0.0, 1.0]), np.full(2, np.sqrt(0.5))):
        places = [tuple((h * direction).tolist()) for h in heights]
        light = np.array([lens.centroids(wavelengths, one) for one in places]) @ direction
        if np.abs(np.diff(light, axis=0)).max() > RIPPLE_STEP:
            return np.inf
        seen = np.array([lens.moments(wavelengths, one) for one in places]) @ direction
        left = (seen - light) @ shares.T
        left -= left[0]
        spread = left[1:] / (heights[1:, None] * corner)
        most = max(
            most, float(np.abs(np.gradient(left, heights * corner, axis=0)[1:] + spread).max())
        )
    return most


def interpolation_error(
    fy: np.ndarray, fx: np.ndarray, phases: np.ndarray | None = None, width: float | None = None
) -> np.ndarray:
    """Return the mean square error of waves that `optics.distort` interpolates, relative to the waves.

    Args:
        fy: Frequencies along rows [cycle/sample].
        fx: Frequencies along columns [cycle/sample].
        phases: Share of the places at each offset between samples, see `place_phases`; None:
            equal shares.
        width: Side of the area that method "area" integrates [sample]; None: the method
            "cubic".

    Returns:
        Errors, shape (frequencies, frequencies).

    Source:
        Keys 1981, see `optics.distort`.
    """
    phases = np.full((PHASES, PHASES), PHASES**-2.0) if phases is None else phases
    along_y, along_x = _interpolated_waves(fy, width), _interpolated_waves(fx, width)
    power_y, power_x = np.abs(along_y) ** 2, np.abs(along_x) ** 2
    square = np.einsum("ab,af,bg->fg", phases, power_y, power_x, optimize=True)
    mean = np.einsum("ab,af,bg->fg", phases, along_y, along_x, optimize=True)
    return np.maximum(square - 2 * mean.real + 1, 0)


def interpolated_share(light: np.ndarray) -> np.ndarray:
    """Return the part of each sample that `optics.distort` interpolates by cubics, (rows, cols), from 0 to 1.

    light: of every channel, (C, rows, cols), not negative. The outermost three samples are 1. Near a bright sample the
    negative weights of a cubic may not outweigh the positive ones, so the rest of it goes by area.
    """
    places, room = np.array([0.3, 0.5, 0.7]), np.ones(np.array(light.shape[1:]) - 3, np.float32)
    weights = _cubic_weights(places[:, None] - np.arange(-1, 3))
    both = np.einsum("vi,uj->ijvu", weights, weights).reshape(16, -1)
    for plane in light:
        most, least = (_of_squares(plane, find) for find in (np.maximum, np.minimum))
        rough = np.nonzero(most > LEAST_LOBES * least)
        cells = np.lib.stride_tricks.sliding_window_view(plane, (4, 4))[rough].reshape(-1, 16)
        above = cells @ np.maximum(both, 0).astype(np.float32)
        below = cells @ np.maximum(-both, 0).astype(np.float32)
        ratio = np.divide(above, below, where=below > above, out=np.ones_like(above))
        ratio = ratio.min(axis=1, initial=1.0)
        room[rough] = np.minimum(room[rough], np.clip(2 * ratio - 1, 0, 1))
    share = np.ones(light.shape[1:], np.float32)
    inside = share[3:-3, 3:-3]
    # offsets of the cells in which a sample has a negative weight
    edges = [(0, 1), (0, 2), (3, 1), (3, 2)]
    for y, x in edges + [pair[::-1] for pair in edges]:
        np.minimum(inside, room[y : y + inside.shape[0], x : x + inside.shape[1]], out=inside)
    return share


def _of_squares(values, find):
    """Apply np.maximum or np.minimum to each square of 4 x 4 samples: (rows - 3, cols - 3)."""
    for _ in range(2):
        pairs = find(values[1:], values[:-1])
        values = find(pairs[2:], pairs[:-2]).T
    return values


def _cubic_weights(distance):
    """Weights of samples at these distances from a place, a = -1/2. Source: Keys 1981."""
    t = np.abs(distance)
    outer = np.where(t < 2, ((-0.5 * t + 2.5) * t - 4) * t + 2, 0.0)
    return np.where(t <= 1, (1.5 * t - 2.5) * t * t + 1, outer)


def _interpolated_waves(f, width):
    """Waves exp(2 pi i f x) as interpolated at the PHASES places x, over the waves themselves, complex (PHASES, F)."""
    places, k = np.arange(PHASES) / PHASES, np.arange(-3, 5)
    apart = places[:, None] - k
    if width is None:
        weights = _cubic_weights(apart)
    else:
        weights = np.clip((1 + width) / 2 - np.abs(apart), 0, min(1.0, width)) / width
    waves = np.exp(2j * np.pi * (k - places[:, None])[..., None] * np.asarray(f))
    return np.einsum("pk,pkf->pf", weights, waves)


def place_phases(distortion: DistortionGrid, shape) -> tuple[np.ndarray, np.ndarray]:
    """Share of the pixels of a frame of `shape` that look so far between samples, and of its worst part.

    Both (PHASES, PHASES), their sums 1. Entry [i, j]: i / PHASES between two rows of samples, j / PHASES between two
    columns; places in between count for both neighbours, linearly. The worst of PARTS x PARTS parts is the one whose
    waves of a fifth of a cycle per sample err the most.
    """
    pixels = [np.unique(np.linspace(0, n - 1, min(n, MOST_PLACES)).astype(int)) for n in shape]
    edges = _edges(shape, distortion.nodes.shape[:2])
    splines = [
        scipy.interpolate.RectBivariateSpline(*edges, distortion.nodes[..., axis])
        for axis in (0, 1)
    ]
    down, across = (spline(*pixels) % 1 * PHASES for spline in splines)
    parts = [
        _shares(down[rows, cols], across[rows, cols])
        for cols in _parts(len(pixels[1]))
        for rows in _parts(len(pixels[0]))
    ]
    wrong = np.abs(_interpolated_waves([0.2], None)[:, 0] - 1) ** 2
    errors = np.einsum("nab,ab->n", np.array(parts), wrong[:, None] + wrong)
    return _shares(down, across), parts[np.argmax(errors)]


def _parts(count):
    """Slices of `count` places, PARTS of them if there are as many."""
    edges = np.linspace(0, count, min(PARTS, count) + 1).astype(int)
    return [slice(*pair) for pair in pairwise(edges.tolist())]


def _shares(down, across):
    """Shares of places in a periodic histogram of PHASES x PHASES, linear between its entries."""
    total = np.zeros((PHASES, PHASES))
    (i, v), (j, u) = ((one.astype(int), one % 1) for one in (down, across))
    for more_i, weight_i in ((0, 1 - v), (1, v)):
        for more_j, weight_j in ((0, 1 - u), (1, u)):
            np.add.at(total, ((i + more_i) % PHASES, (j + more_j) % PHASES), weight_i * weight_j)
    return total / total.sum()


def _half_way(cells):
    """Weights of cells + 1 nodes for the values in the middle of each cell, shape (cells, cells + 1)."""
    weights = np.zeros((cells, cells + 1))
    for cell in range(cells):
        first = min(max(cell - 1, 0), cells - 3)
        for a in range(4):
            factors = [(cell + 0.5 - first - b) / (a - b) for b in range(4) if b != a]
            weights[cell, first + a] = np.prod(factors)
    return weights


def relative_illumination(
    model, shape, pitch, image_distance, radius=None, displacement=(0.0, 0.0)
) -> np.ndarray:
    """Relative illumination of every pixel centre, float64, shape (rows, cols), 1 on axis.

    model: "cos4"; a tuple of polynomial coefficients (a1, a2, ...) for 1 + a1 h + a2 h^2 + ... of the field height
    h = r / radius; or a pair of arrays (heights, values) interpolated linearly. pitch, image_distance, radius: [m];
    radius: by default half the frame's diagonal. displacement: of the grid of pixels, (rows, cols) [pixel].
    Multiply maps for lens and microlenses.
    Source: Farrell and Wandell, section 4.1. Raises BadData, OutOfRange.
    """
    r = _heights(shape, displacement) * pitch
    if isinstance(model, str):
        if model != "cos4":
            known = '"cos4", coefficients or a table'
            raise OutOfRange("relative_illumination", repr(model), known)
        return (1 + (r / image_distance) ** 2) ** -2
    h = r / (radius or pitch * np.hypot(*shape) / 2)
    if len(model) == 2 and np.ndim(model[0]) == 1:
        heights, values = (np.asarray(part, np.float64) for part in model)
        if heights.shape != values.shape or not (np.diff(heights) > 0).all() or heights[0] != 0:
            raise BadData("relative illumination: wanted heights rising from 0 and as many values")
        if h.max() > heights[-1] * (1 + 1e-9):
            raise OutOfRange(
                "relative illumination table",
                f"ends at field height {heights[-1]:.6g}",
                f"as far as the frame's corner, {h.max():.6g}",
            )
        if not values[0] > 0:
            raise OutOfRange("relative illumination table", f"{values[0]:.6g} on the axis", "> 0")
        gain = np.interp(h, heights, values) / values[0]
    else:
        gain = np.polynomial.polynomial.polyval(h, (1.0, *model))
    if not (np.isfinite(gain).all() and gain.min() >= 0):
        worst = np.unravel_index(np.argmin(gain), gain.shape)
        found = f"{gain[worst]:.6g} at pixel {tuple(map(int, worst))}"
        raise OutOfRange("relative illumination", found, "0 <= gain < inf")
    return gain


def microlens_gain(
    microlens: Microlens, shape, pitch, exit_pupil_distance, displacement=(0.0, 0.0)
) -> np.ndarray:
    """Gain of every pixel from the angle at which the chief ray meets it, float64, shape (rows, cols).

    exit_pupil_distance: from the exit pupil to the sensor [m]. displacement: of the grid of pixels, (rows, cols)
    [pixel].
    Source: Catrysse, Liu and El Gamal, Proc. SPIE 3965 (2000). Raises OutOfRange.
    """
    tangent = _heights(shape, displacement) * (pitch / exit_pupil_distance)
    angle = np.abs(np.arctan(tangent) - np.arctan(microlens.shift * tangent))
    if angle.max() > microlens.angles[-1]:
        raise OutOfRange(
            "sensor.microlens",
            f"measured up to {np.degrees(microlens.angles[-1]):.4g} deg",
            f"as far as the corner's chief ray, {np.degrees(angle.max()):.4g} deg",
        )
    return np.interp(angle, microlens.angles, microlens.response)


def vignetting_gain(responses, shape, displacement=(0.0, 0.0)) -> np.ndarray:
    """Gain of every pixel from a map of relative responses, float64, shape (rows, cols).

    responses: shape (ny, nx), at places even from edge to edge of the frame; bilinear between them, constant beyond.
    displacement: of the grid of pixels, (rows, cols) [pixel].
    """
    responses = np.asarray(responses, np.float64)
    (high, wide), (rows, cols), (down, across) = responses.shape, shape, displacement
    return _hats(high, rows, down) @ responses @ _hats(wide, cols, across).T


def _hats(count, pixels, displacement):
    """Weights of `count` nodes in the linear interpolation at each of `pixels`, shape (pixels, count)."""
    place = np.clip((np.arange(pixels) + 0.5 + displacement) / pixels, 0, 1) * (count - 1)
    return np.maximum(1 - np.abs(place[:, None] - np.arange(count)), 0)


def _heights(shape, displacement):
    """Distance of every pixel's middle from the axis [pixel]."""
    y, x = (np.arange(n) - (n - 1) / 2 + move for n, move in zip(shape, displacement, strict=True))
    return np.hypot(y[:, None], x)

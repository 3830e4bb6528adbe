"""Raw frames of a lenslet camera become views: calibration of the grid, and decoding.

Source of the method: Dansereau, Pizarro and Williams 2013, Decoding, calibration and rectification for lenselet-based
plenoptic cameras: the grid is fitted to the lenslets' images of a white surface, the raw frame is divided by the white
one, and hexagonal grids are resampled to squares.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve1d, map_coordinates
from scipy.optimize import minimize

from gpusim.domain.errors import BadData, checked_count
from gpusim.domain.lenslets import LAYOUTS
from gpusim.optics.lenslets import lenslet_vectors

CROP = 1024  # pixels in the middle that the first estimate of the grid uses
LEAST_LENSLETS = 3  # in each direction, for a calibration
LEAST_PEAK = 6.0  # of the spectrum over its median: less is no grid
WEAK = 0.02  # of the strongest wave: a longer one that strong is the lattice's
TURNS = {"square": np.pi / 2, "hexagonal": np.pi / 3}  # that map a lattice to itself


@dataclass(frozen=True)
class LensletGrid:
    """Centres of the lenslets' images in a raw frame.

    Attributes:
        pitch: Distance between neighbours [pixel].
        rotation: Direction of the rows of lenslets, from columns towards rows [rad]; a square grid's is within +-45
            degrees, a hexagonal one's within +-30.
        origin: Centre of the lenslet nearest to the frame's middle, as (row, column) of pixels, 0 at the first pixel's
            centre.
        layout: "square" or "hexagonal".
    """

    pitch: float
    rotation: float
    origin: tuple[float, float]
    layout: str = "square"

    @property
    def lattice(self) -> np.ndarray:
        """Steps between neighbours, two of (rows, cols) [pixel], shape (2, 2)."""
        return np.array(lenslet_vectors(self.pitch, self.rotation, self.layout)[0])

    def centres(self, shape: tuple[int, int]) -> np.ndarray:
        """Return the centres of all lenslets in a frame.

        Args:
            shape: Rows and columns of pixels.

        Returns:
            Centres as (row, column), shape (n, 2).
        """
        return self.origin + self.indices(shape) @ self.lattice

    def indices(self, shape: tuple[int, int]) -> np.ndarray:
        """Return the steps from the origin to all lenslets in a frame, whole numbers.

        Args:
            shape: Rows and columns of pixels.

        Returns:
            Steps along both directions of the lattice, shape (n, 2).
        """
        corners = np.array([(0, 0), (0, 1), (1, 0), (1, 1)]) * np.array(shape) - 0.5
        places = (corners - self.origin) @ np.linalg.inv(self.lattice)
        low, high = np.floor(places.min(0)).astype(int), np.ceil(places.max(0)).astype(int)
        grid = [np.arange(a, b + 1) for a, b in zip(low, high, strict=True)]
        found = np.stack(np.meshgrid(*grid, indexing="ij"), -1).reshape(-1, 2)
        at = self.origin + found @ self.lattice
        return found[((at >= -0.5) & (at < np.array(shape) - 0.5)).all(-1)]


def calibrate_lenslets(white: np.ndarray, period: tuple[int, int] = (1, 1)) -> LensletGrid:
    """Find the grid of lenslets in a raw frame of an evenly lit white surface.

    The strongest waves of the picture give layout, pitch and rotation. The centre of gravity of each lenslet's image
    then refines pitch, rotation and position by least squares, first in the middle, then in the whole frame.

    Args:
        white: Raw values without the black level, shape (rows, cols).
        period: Rows and columns of the colour filter array's period: (2, 2) for Bayer.

    Returns:
        The grid.

    Raises:
        BadData: The frame has no regular grid, or fewer than 3 lenslets in a direction.
    """
    try:
        white = np.asarray(white, np.float64)
    except (TypeError, ValueError):
        raise BadData("white: wanted rows of numbers") from None
    if white.ndim != 2 or not np.isfinite(white).all():
        raise BadData(f"white: shape {white.shape}; wanted (rows, cols) of finite numbers")
    white = _even_out(white, period)
    grid = _estimate_grid(white)
    extent = 6 * grid.pitch
    while True:
        for _ in range(2):
            grid = _refine_grid(white, grid, extent)
        if extent > max(white.shape):
            return grid
        extent *= 2


def _even_out(white, period):
    """Return a white frame whose phases of the mosaic have one mean."""
    out = white.copy()
    for y, x in np.ndindex(*period):
        mean = out[y :: period[0], x :: period[1]].mean()
        out[y :: period[0], x :: period[1]] /= mean if mean > 0 else 1.0
    return out


def _estimate_grid(white):
    """Return the grid by the strongest waves of the frame's middle."""
    top, left = (max(0, (size - CROP) // 2) for size in white.shape)
    part = white[top : top + CROP, left : left + CROP]
    window = np.outer(*(np.hanning(size + 2)[1:-1] for size in part.shape))
    part = (part - np.average(part, weights=window)) * window
    waves = np.abs(np.fft.fft2(part))
    fy, fx = np.meshgrid(*map(np.fft.fftfreq, part.shape), indexing="ij")
    size = np.hypot(fy, fx)
    usable = (size > LEAST_LENSLETS / min(part.shape)) & (size < 0.55)
    peak = np.where(usable, waves, 0).argmax()
    noise = np.median(waves)
    if not waves.flat[peak] > LEAST_PEAK * noise:
        raise BadData(
            "white: no grid of lenslets is found; wanted an evenly lit frame of a lenslet camera"
        )
    y, x = np.arange(part.shape[0]), np.arange(part.shape[1])

    def wave(k):
        return np.exp(-2j * np.pi * k[0] * y) @ part @ np.exp(-2j * np.pi * k[1] * x)

    def strengths(k, layout):
        return [
            abs(wave(_turn(k, n * TURNS[layout]))) for n in range(2 if layout == "square" else 3)
        ]

    first = np.array([fy.flat[peak], fx.flat[peak]])
    found = {}
    for layout in LAYOUTS:
        k = _climb(lambda k, layout=layout: sum(strengths(k, layout)), first, part.shape)
        found[layout] = min(strengths(k, layout)), k
    layout = max(found, key=lambda name: found[name][0])
    k = found[layout][1]
    # discs that touch each other may have hardly any of the lattice's longest waves, and more of the next
    longer = _turn(k, TURNS[layout] / 2) / (np.sqrt(2) if layout == "square" else np.sqrt(3))
    if min(strengths(longer, layout)) > max(WEAK * found[layout][0], LEAST_PEAK * noise):
        k = longer
    turned = (
        k if layout == "square" else _turn(k, np.pi / 6)
    )  # a hexagonal lattice's waves are 30 degrees away
    pitch = (1 if layout == "square" else 2 / np.sqrt(3)) / np.hypot(*k)
    rotation = np.arctan2(turned[0], turned[1])
    rotation -= TURNS[layout] * np.rint(rotation / TURNS[layout])
    # the phases of two waves give the place of a lenslet, or of a gap if their sign is negative
    normals = np.array([k, _turn(k, TURNS[layout])])
    phases = np.array([-np.angle(wave(n)) / (2 * np.pi) for n in normals])
    origin = np.linalg.solve(normals, phases) + np.array([top, left])
    grid = LensletGrid(float(pitch), float(rotation), (float(origin[0]), float(origin[1])), layout)
    parts = (0, 1 / 2) if layout == "square" else (0, 1 / 3, 2 / 3)
    places = [origin + part * grid.lattice.sum(0) for part in parts]
    brightest = max(places, key=lambda place: _brightness(white, grid, place))
    return _centre(grid.pitch, grid.rotation, brightest, layout, white.shape)


def _climb(strength, first, shape):
    """Return the wave vector near `first` at which `strength` is largest."""
    simplex = first + np.array([(0, 0), (0.4, 0), (0, 0.4)]) / max(shape)
    options = {"xatol": 1e-3 / max(shape), "fatol": np.inf, "initial_simplex": simplex}
    return minimize(lambda k: -strength(k), first, method="Nelder-Mead", options=options).x


def _turn(k, angle):
    """Return a vector (rows, cols) turned from columns towards rows."""
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([k[0] * cos + k[1] * sin, k[1] * cos - k[0] * sin])


def _brightness(white, grid, origin):
    """Return the mean of a white frame at the points of a lattice around its middle."""
    at = origin + grid.indices(white.shape) @ grid.lattice
    is_near = np.abs(at - (np.array(white.shape) - 1) / 2).max(1) < 6 * grid.pitch
    return map_coordinates(white, at[is_near].T, order=1, mode="nearest").mean()


def _centre(pitch, rotation, origin, layout, shape):
    """Return a grid whose origin is the lenslet nearest to the middle."""
    grid = LensletGrid(float(pitch), rotation, (float(origin[0]), float(origin[1])), layout)
    steps = ((np.array(shape) - 1) / 2 - origin) @ np.linalg.inv(grid.lattice)
    moved = origin + np.rint(steps) @ grid.lattice
    return LensletGrid(grid.pitch, rotation, (float(moved[0]), float(moved[1])), layout)


def _refine_grid(white, grid, extent):
    """Return the grid fitted to the centres of gravity of lenslets within `extent` of the middle [pixel]."""
    middle = (np.array(white.shape) - 1) / 2
    steps = grid.indices(white.shape)
    centres = grid.origin + steps @ grid.lattice
    reach = int(np.ceil(grid.pitch / 2))
    near = np.abs(centres - middle).max(1) <= extent
    near &= ((centres >= reach + 0.5) & (centres <= np.array(white.shape) - 1.5 - reach)).all(1)
    if near.sum() < LEAST_LENSLETS**2:
        raise BadData(
            f"white: {near.sum()} whole lenslets; wanted {LEAST_LENSLETS} or more in each direction"
        )
    steps, centres = steps[near], centres[near]
    offsets = np.arange(-reach, reach + 1)
    base = np.rint(centres).astype(int)
    rows, cols = (base[:, axis, None] + offsets for axis in (0, 1))
    values = white[rows[:, :, None], cols[:, None, :]]
    dy, dx = (base[:, axis, None] - centres[:, axis, None] + offsets for axis in (0, 1))
    # pixels at the rim of a disc count in part, so that a moving centre moves the sum evenly
    distance = np.hypot(dy[:, :, None], dx[:, None, :])
    values = values * np.clip(grid.pitch / 2 + 0.5 - distance, 0, 1)
    total = np.maximum(values.sum((1, 2)), 1e-30)
    shift = np.stack(
        [(values * dy[:, :, None]).sum((1, 2)), (values * dx[:, None, :]).sum((1, 2))], -1
    )
    found = centres + shift / total[:, None]
    # linear in pitch cos, pitch sin and the origin
    unit = steps @ np.array(lenslet_vectors(1.0, 0.0, grid.layout)[0])
    ones, zeros = np.ones(len(unit)), np.zeros(len(unit))
    matrix = np.concatenate(
        [
            np.stack([unit[:, 0], unit[:, 1], ones, zeros], -1),
            np.stack([unit[:, 1], -unit[:, 0], zeros, ones], -1),
        ]
    )
    cos, sin, *origin = np.linalg.lstsq(matrix, found.T.ravel(), rcond=None)[0]
    return _centre(
        np.hypot(cos, sin), float(np.arctan2(sin, cos)), np.array(origin), grid.layout, white.shape
    )


def decode_lenslets(
    raw: np.ndarray,
    grid: LensletGrid,
    white: np.ndarray | None = None,
    views: tuple[int, int] = (9, 9),
    cfa: np.ndarray | None = None,
    radius: float | None = None,
) -> np.ndarray:
    """Return the views of an unfocused lenslet camera.

    View (j, i) sees through the middle of cell (j, i) of the pupil; its pixel behind a lenslet is `radius` times the
    cell's place away from the centre, on the opposite side. Values between pixels are interpolated linearly. Colours
    come from a mean over pixels of the same filter nearer than the mosaic's period, with weights that fall linearly
    with the distance, and with the white frame, so that dark pixels between lenslets do not count.

    Square grids along the pixels give a sample per lenslet. Other grids are resampled to squares along the pixels:
    lenslets of turned square grids linearly between four neighbours, a pitch apart; lenslets of hexagonal grids between
    three, 0.866 pitches apart.

    Args:
        raw: Raw values without the black level, shape (rows, cols).
        grid: From `calibrate_lenslets`.
        white: Raw values of an evenly lit white surface, without the black level, of that shape; the views are relative
            to it, which removes the lenslets' shading. None: not divided.
        views: Rows and columns of views.
        cfa: Channels of one period of the mosaic, as `Sensor.cfa_indices`; None: monochrome.
        radius: Radius of the pupil's image behind a lenslet [pixel]; None: half the pitch.

    Returns:
        Views, shape (T, S, rows, cols, channels), float64. The sample of all views in the middle, [rows // 2, cols //
        2], is of the lenslet nearest to the frame's middle.

    Raises:
        BadData: Frames do not fit each other, or the frame is smaller than a lenslet.
        OutOfRange: There is no view.
    """
    views = (checked_count("views (rows)", views[0]), checked_count("views (columns)", views[1]))
    raw = np.asarray(raw, np.float64)
    white = None if white is None else np.asarray(white, np.float64)
    if raw.ndim != 2 or (white is not None and white.shape != raw.shape):
        raise BadData(
            f"raw and white: shapes {raw.shape}, {getattr(white, 'shape', None)}; wanted two frames of (rows, cols)"
        )
    planes = _fill_channels(raw, white, np.zeros((1, 1), int) if cfa is None else np.asarray(cfa))
    lattice, origin = grid.lattice, np.array(grid.origin)
    spacing = grid.pitch * (1 if grid.layout == "square" else np.sqrt(3) / 2)
    axes = []
    for size, middle in zip(raw.shape, origin, strict=True):
        before = int((middle + 0.5 - grid.pitch / 2) // spacing)
        after = int((size - 0.5 - middle - grid.pitch / 2) // spacing)
        count = min(before, after)
        axes.append(middle + spacing * np.arange(-count, count + 1 if count >= 0 else 0))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1)
    if not places.size:
        raise BadData(f"raw: {raw.shape[1]}x{raw.shape[0]} pixels; wanted at least a whole lenslet")
    steps = (places - origin) @ np.linalg.inv(lattice)
    near = np.rint(steps)
    steps = np.where(
        np.abs(steps - near) < 1e-3, near, steps
    )  # a thousandth of a pitch is the grid's own error
    radius = grid.pitch / 2 if radius is None else radius
    out = np.zeros((*views, *places.shape[:2], len(planes)))
    for node, weight in _weigh_lenslets(steps, grid.layout):
        used = weight > 0
        for j, i in np.ndindex(*views):
            pupil = np.array([(2 * j + 1) / views[0] - 1, (2 * i + 1) / views[1] - 1])
            at = (origin + node[used] @ lattice - radius * pupil).T
            for channel, plane in enumerate(planes):
                out[j, i, used, channel] += weight[used] * map_coordinates(
                    plane, at, order=1, mode="nearest"
                )
    return out


def _fill_channels(raw, white, cfa):
    """Return each channel at every pixel, relative to white, shape (channels, rows, cols)."""
    rows, cols = np.indices(raw.shape)
    channel = cfa[rows % cfa.shape[0], cols % cfa.shape[1]]
    tents = [1 - np.abs(np.arange(1 - n, n)) / n for n in cfa.shape]
    weights = np.ones(raw.shape) if white is None else np.maximum(white, 0)
    planes = []
    for own in range(int(cfa.max()) + 1):
        mask = channel == own
        # with a white frame the weight of a pixel is its white value, and raw / white times this is raw
        both = [np.where(mask, raw, 0.0), np.where(mask, weights, 0.0)]
        for axis, tent in enumerate(tents):
            both = [convolve1d(values, tent, axis, mode="mirror") for values in both]
        planes.append(both[0] / np.maximum(both[1], 1e-12 * max(both[1].max(), 1e-300)))
    return np.array(planes)


def _weigh_lenslets(steps, layout):
    """Yield the lenslets around places and their weights: (rows, cols, 2) steps of the lattice, (rows, cols)."""
    base = np.floor(steps)
    a, b = np.moveaxis(steps - base, -1, 0)
    if layout == "square":
        weights = {
            (0, 0): (1 - a) * (1 - b),
            (1, 0): a * (1 - b),
            (0, 1): (1 - a) * b,
            (1, 1): a * b,
        }
    else:  # the lattice's parallelograms are two triangles
        lower = a + b <= 1
        weights = {
            (0, 0): np.where(lower, 1 - a - b, 0),
            (1, 0): np.where(lower, a, 1 - b),
            (0, 1): np.where(lower, b, 1 - a),
            (1, 1): np.where(lower, 0, a + b - 1),
        }
    for corner, weight in weights.items():
        yield base + corner, weight

"""Filters that are chosen on a first picture: a table that turns a mosaic of R, G, B into planes.

Terms used here and in the modules that make and use tables:

- Code: input of the filters (see `gpusim.domain.learned.Code`), a whole number of steps.
- First picture: R, G and B at every pixel by one linear filter per position of the mosaic.
- Class: direction and strength of the contrast of the first picture around a pixel.
- Term: a code or a channel of the first picture near the pixel, input of the second filters.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gpusim.domain.errors import BadData, UnknownName
from gpusim.domain.learned import Code, find_shift
from gpusim.domain.mosaics import MOSAICS, symmetries
from gpusim.domain.short_repr import short_repr

COLORS = ("R", "G", "B")
FINEST_FIRST = 2048  # weights of the first picture are multiples of 1 / 2048
FINEST = 8192  # those of the second filters
LARGEST = 2**17 - 1  # of a code: 7 x 2048 times this stays below 2^31
BUILT_IN = ("x-trans", "quad-bayer")  # mosaics with a table of their own
RED_AND_BLUE: tuple[dict[str, str], ...] = (
    {},
    {"R": "B", "B": "R"},
)  # channels that may play each other's part


def built_in_name(mosaic) -> str | None:
    """Return the name of the mosaic with a built-in table that this one is a shift of, or None.

    mosaic: Rows of letters.
    """
    for name in BUILT_IN:
        try:
            find_shift(MOSAICS[name], mosaic)
        except UnknownName:
            continue
        return name
    return None


def diamond(radius: int) -> np.ndarray:
    """Return all (dy, dx) with |dy| + |dx| <= radius [pixel], shape (T, 2)."""
    dy, dx = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return np.stack([dy, dx], axis=-1)[abs(dy) + abs(dx) <= radius].astype(np.int32)


def tap_colors(mosaic, taps) -> np.ndarray:
    """Return whether a tap of a position has a colour, 0 or 1, shape (P, T, 3)."""
    rows, cols = len(mosaic), len(mosaic[0])
    out = np.zeros((rows * cols, len(taps), 3), int)
    for p in range(rows * cols):
        for at, (dy, dx) in enumerate(taps + divmod(p, cols)):
            out[p, at, COLORS.index(mosaic[dy % rows][dx % cols])] = 1
    return out


@dataclass(frozen=True)
class GuidedTable:
    """Linear filters of the first picture, and of every class of it; lengths in pixels.

    A class is a direction (2 D + 1), a diagonal (2 E + 1), a share of colour (F + 1) and a strength
    (S + 1), the last one counting fastest. Mirror images and transposes that map the mosaic to
    itself, and those that exchange red and blue, share filters: `second` has one set per orbit of
    (position, class).

    Args:
        mosaic: One period of the colour filter array, a string per row, of R, G and B.
        radii: Taps are diamonds of these radii: of the first filters, of the codes and of the
            first picture in the second filters.
        box: Contrast is a sum over (2 box + 1)^2 pixels.
        ratios: Bounds of direction [1/8], shape (D,), above 8, increasing.
        diagonals: Bounds of the diagonal direction [1/8], shape (E,).
        shares: Bounds of the contrast of colour over that of light [1/8], shape (F,).
        noise: Standard deviations of the code, relative to white, for which the table has filters,
            shape (N,), increasing.
        floor: Mean contrast that is added to both sides of these comparisons, relative to white,
            shape (N,).
        strengths: Bounds of the mean of the contrasts along rows and columns, relative to white,
            shape (N, S), increasing.
        first: Weights of the first filters [1/2048], shape (N, P, 3, T), whole numbers.
        second: Weights of the second filters [1/8192], shape (N, orbits, 3, terms), whole numbers.
            Terms are the codes, then the first picture's R, G and B.
        provenance: Source of the table.

    Raises:
        BadData: A shape is wrong, or a flat field would not stay flat.
    """

    mosaic: tuple[str, ...]
    radii: tuple[int, int, int]
    box: int
    ratios: np.ndarray
    diagonals: np.ndarray
    shares: np.ndarray
    noise: np.ndarray
    floor: np.ndarray
    strengths: np.ndarray
    first: np.ndarray
    second: np.ndarray
    provenance: str = ""

    __repr__ = short_repr

    def __post_init__(self):
        object.__setattr__(self, "mosaic", tuple(map(str, self.mosaic)))
        object.__setattr__(self, "radii", tuple(map(int, self.radii)))
        whole = ("ratios", "diagonals", "shares", "first", "second")
        for name in (*whole, "noise", "floor", "strengths"):
            values = np.array(getattr(self, name), np.int32 if name in whole else np.float64)
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        if set("".join(self.mosaic)) != set(COLORS):
            raise BadData(f"mosaic {self.mosaic}: wanted texts of R, G and B")
        levels = len(self.noise)
        taps = [len(diamond(radius)) for radius in self.radii]
        terms = taps[1] + 3 * taps[2]
        wanted = {
            "floor": (levels,),
            "strengths": (levels, self.strengths.shape[-1]),
            "first": (levels, self.positions, 3, taps[0]),
            "second": (levels, self.orbits.count, 3, terms),
        }
        for name, shape in wanted.items():
            found = getattr(self, name).shape
            if found != shape:
                raise BadData(f"{name}: shape {found}, wanted {shape}")
        flat = np.equal.outer(range(3), range(3)).astype(int)
        first = np.einsum("npot,ptc->npoc", self.first, self.colors(0))
        second = np.einsum("nrot,rtc->nroc", self.second, self.term_colors[self.orbits.positions])
        if (first != FINEST_FIRST * flat).any() or (second != FINEST * flat).any():
            raise BadData("first, second: weights of a channel do not add up to 1 or 0")
        if abs(self.first).sum(axis=-1).max() > 7 * FINEST_FIRST:
            raise BadData(
                "first: absolute weights add up to more than 7: train on more photographs"
            )

    @property
    def period(self) -> tuple[int, int]:
        """Rows and columns of the period of the mosaic."""
        return len(self.mosaic), len(self.mosaic[0])

    @property
    def positions(self) -> int:
        """Number P of pixels in a period, numbered row by row."""
        return self.period[0] * self.period[1]

    @property
    def kinds(self) -> tuple[int, int, int, int]:
        """Numbers of directions, diagonals, shares and strengths."""
        directions = (2 * len(bounds) + 1 for bounds in (self.ratios, self.diagonals))
        return *directions, len(self.shares) + 1, self.strengths.shape[-1] + 1

    @property
    def reach(self) -> tuple[int, int]:
        """Pixels around the frame that the first picture and the second filters need [pixel]."""
        return self.radii[0], max(self.radii[1], self.radii[2], self.box + 1)

    @property
    def device_bytes(self) -> int:
        """Memory of the filters on a device [byte]: four numbers for each term and for a share."""
        rows = self.positions * self.orbits.classes
        return 16 * rows * (self.second.shape[-1] + 1)

    @cached_property
    def orbits(self) -> "Orbits":
        """The orbits of positions and classes."""
        return Orbits(self.mosaic, self.kinds, self.radii[1:])

    def colors(self, which: int) -> np.ndarray:
        """Return the colours of the taps of one of the radii, see `tap_colors`."""
        return tap_colors(self.mosaic, diamond(self.radii[which]))

    @cached_property
    def term_colors(self) -> np.ndarray:
        """The terms of a flat field of 1 in one channel, int, shape (P, terms, 3)."""
        guides = np.repeat(np.eye(3, dtype=int), len(diamond(self.radii[2])), axis=0)
        guides = np.broadcast_to(guides, (self.positions, *guides.shape))
        return np.concatenate([self.colors(1), guides], axis=1)

    def shift(self, mosaic) -> tuple[int, int]:
        """Find the row and column of the table's period at which the mosaic of a sensor begins.

        Args:
            mosaic: Rows of letters.

        Returns:
            Row and column.

        Raises:
            UnknownName: The table is for another mosaic.
        """
        return find_shift(self.mosaic, mosaic)

    def at_noise(self, sigma):
        """Interpolate the table to the noise of a code.

        Linear between the nearest two of `noise`, constant beyond the ends.

        Args:
            sigma: Standard deviation of the code relative to white.

        Returns:
            First weights [1/2048], int32, shape (P, 3, T); second weights [1], float64, shape (P, K,
            3, terms); floor; strengths, shape (S,).
        """
        at = float(np.interp(sigma, self.noise, np.arange(len(self.noise))))
        lower, t = int(at), at % 1

        def between(values):
            low = np.asarray(values[lower], np.float64)
            return low if t == 0 else (1 - t) * low + t * values[lower + 1]

        first = round_filters(between(self.first), self.colors(0))
        second = self.orbits.expand(between(self.second) / FINEST)
        return first, second, float(between(self.floor)), between(self.strengths)

    def __hash__(self):
        return id(self)

    def __eq__(self, other):
        return self is other


def round_filters(weights, colors) -> np.ndarray:
    """Round weights to whole numbers; what a channel's sum loses goes to its largest weight.

    Args:
        weights: Weights whose sums over each channel are whole numbers, shape (.., P, 3, T).
        colors: Whether a tap has a colour, shape (P, T, 3).

    Returns:
        Whole numbers, int32.
    """
    whole = np.rint(weights)
    for c in range(3):
        mask = np.broadcast_to(colors[:, None, :, c], weights.shape)
        left = np.rint((weights * mask).sum(axis=-1)) - (whole * mask).sum(axis=-1)
        largest = np.argmax(np.abs(whole) * mask + mask, axis=-1)[..., None]
        moved = np.take_along_axis(whole, largest, -1) + left[..., None]
        np.put_along_axis(whole, largest, moved, -1)
    return whole.astype(np.int32)


class Orbits:
    """Sets of (position, class) that symmetries of the mosaic map to each other.

    Attributes: count: their number. of: orbit of each position and class, shape (P K,). terms,
    channels: index of the orbit's term, or channel, in place of each one, shape (P K, terms) and (P
    K, 3). positions: position of the orbit's filters, shape (count,).
    """

    def __init__(self, mosaic, kinds, radii):
        """Find the orbits. kinds: as `GuidedTable.kinds`; radii: of codes and of the first picture."""
        self.classes = int(np.prod(kinds))
        cells = len(mosaic) * len(mosaic[0]) * self.classes
        least = np.full(cells, cells)
        codes, guides = map(diamond, radii)
        self.terms = np.zeros((cells, len(codes) + 3 * len(guides)), np.int32)
        self.channels = np.zeros((cells, 3), np.int32)
        steps = np.stack(np.unravel_index(np.arange(self.classes), kinds))
        for places, transpose, signs, swap in symmetries(mosaic, RED_AND_BLUE):
            turned = steps.copy()
            if transpose:
                turned[0] = kinds[0] - 1 - turned[0]
            if signs[0] * signs[1] < 0:
                turned[1] = kinds[1] - 1 - turned[1]
            target = np.add.outer(
                places * self.classes, np.ravel_multi_index(tuple(turned), kinds)
            ).ravel()
            better = target < least
            least[better] = target[better]
            channels = np.array([COLORS.index(swap.get(c, c)) for c in COLORS])
            moved = _move(guides, transpose, signs)
            guided = [len(codes) + c * len(guides) + moved for c in channels]
            self.terms[better] = np.concatenate([_move(codes, transpose, signs), *guided])
            self.channels[better] = channels
        found, self.of = np.unique(least, return_inverse=True)
        self.count, self.positions = len(found), found // self.classes

    def expand(self, filters) -> np.ndarray:
        """Return the filters of all positions and classes, shape (P, K, 3, terms).

        filters: of the orbits, shape (count, 3, terms).
        """
        cells = np.arange(len(self.of))[:, None, None]
        own = filters[self.of]
        all_ = own[cells, self.channels[:, :, None], self.terms[:, None, :]]
        return all_.reshape(-1, self.classes, *filters.shape[1:])


def _move(taps, transpose, signs):
    """Return the number of the tap to which a symmetry moves each one."""
    turned = (taps[:, ::-1] if transpose else taps) * signs
    number = {tuple(tap): at for at, tap in enumerate(taps.tolist())}
    return np.array([number[tuple(tap)] for tap in turned.tolist()])


def steps_of(code: Code) -> float:
    """Return the whole numbers per unit of code, a power of 2; white is between 2^15 and 2^16."""
    return float(2.0 ** np.floor(np.log2(65535 / code.white)))

"""Filters that are chosen on a first picture: a table that turns a mosaic into its channels' planes.

Terms used here and in the modules that make and use tables:

- Code: input of the filters (see `gpusim.domain.learned.Code`), a whole number of steps.
- First picture: every channel at every pixel by one linear filter per position of the mosaic.
- Guide: the channel with most pixels. Contrasts of light count it twice.
- Class: direction and strength of the contrast of the first picture around a pixel.
- Term: a code or a channel of the first picture near the pixel, input of the second filters.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.learned import Code, find_shift
from gpusim.domain.mosaics import MOSAICS, symmetries
from gpusim.domain.short_repr import short_repr

ORDER = "RGBYCMEWN"  # of the channels of a table
GUIDES = "WYGCMERBN"  # of channels with equally many pixels the first is the guide
MOST_CHANNELS = 4
FINEST_FIRST = 2048  # weights of the first picture are multiples of 1 / 2048
FINEST = 8192  # those of the second filters
LARGEST = 2**17 - 1  # of a code: 7 x 2048 times this stays below 2^31
BUILT_IN = (
    "x-trans",
    "quad-bayer",
    "rgbw",
    "rgbw-kodak",
    "rgbn",
    "rgbn-4x4",
    "rccc",
    "cygm",
    "rgbe",
)  # mosaics with a table of their own


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


def channels_of(mosaic) -> tuple[str, ...]:
    """Return the letters of a mosaic in the order of a table."""
    return tuple(sorted(set("".join(mosaic)), key=ORDER.index))


def guide_of(mosaic) -> str:
    """Return the letter of the guide of a mosaic."""
    letters = "".join(mosaic)
    return max(set(letters), key=lambda letter: (letters.count(letter), -GUIDES.index(letter)))


def exchanges_of(mosaic) -> tuple[dict[str, str], ...]:
    """Return the channels that may play each other's part: red and blue beside green alone."""
    return ({}, {"R": "B", "B": "R"}) if set("".join(mosaic)) == {*"RGB"} else ({},)


def tap_colors(mosaic, taps) -> np.ndarray:
    """Return whether a tap of a position has a channel, 0 or 1, shape (P, T, C)."""
    rows, cols, channels = len(mosaic), len(mosaic[0]), channels_of(mosaic)
    out = np.zeros((rows * cols, len(taps), len(channels)), int)
    for p in range(rows * cols):
        for at, (dy, dx) in enumerate(taps + divmod(p, cols)):
            out[p, at, channels.index(mosaic[dy % rows][dx % cols])] = 1
    return out


@dataclass(frozen=True)
class MosaicCode(Code):
    """Code of a mosaic of any channels.

    Args:
        mosaic: One period of the colour filter array, a string per row.
        balances: (letter, factor) of channels: factors on signals that make white as strong in
            them as in the guide; the others have 1. For domain "root" only.

    Raises:
        OutOfRange: A factor other than 1 in domain "linear".
    """

    mosaic: tuple[str, ...] = ("RG", "GB")
    balances: tuple[tuple[str, float], ...] = ()

    def __post_init__(self):
        super().__post_init__()
        if self.domain == "linear" and set(self.signals.values()) != {1.0}:
            raise OutOfRange(
                "balance",
                self.signals,
                '1 for each channel in domain "linear": encoded data are balanced already',
            )

    @property
    def signals(self) -> dict[str, float]:
        """Factors on signals of the channels, by letter."""
        return dict.fromkeys(channels_of(self.mosaic), 1.0) | dict(self.balances)

    @property
    def _factor_of_white(self):
        return self.factors[guide_of(self.mosaic)]

    @property
    def _mean_signal(self):
        return float(np.mean([self.signals[letter] for letter in "".join(self.mosaic)]))


@dataclass(frozen=True)
class GuidedTable:
    """Linear filters of the first picture, and of every class of it; lengths in pixels.

    A class is a direction (2 D + 1), a diagonal (2 E + 1), a share of colour (F + 1) and a strength
    (S + 1), the last one counting fastest. Mirror images and transposes that map the mosaic to
    itself, and those that exchange red and blue, share filters: `second` has one set per orbit of
    (position, class).

    Args:
        mosaic: One period of the colour filter array, a string per row, of 2 to 4 letters.
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
        first: Weights of the first filters [1/2048], shape (N, P, C, T), whole numbers.
        second: Weights of the second filters [1/8192], shape (N, orbits, C, terms), whole numbers.
            Terms are the codes, then the channels of the first picture.
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
        letters = set("".join(self.mosaic))
        if not letters <= {*ORDER} or not 2 <= len(letters) <= MOST_CHANNELS:
            raise BadData(
                f"mosaic {self.mosaic}: wanted texts of 2 to {MOST_CHANNELS} of the letters {ORDER}"
            )
        levels = len(self.noise)
        taps = [len(diamond(radius)) for radius in self.radii]
        count = len(self.channels)
        terms = taps[1] + count * taps[2]
        wanted = {
            "floor": (levels,),
            "strengths": (levels, self.strengths.shape[-1]),
            "first": (levels, self.positions, count, taps[0]),
            "second": (levels, self.orbits.count, count, terms),
        }
        for name, shape in wanted.items():
            found = getattr(self, name).shape
            if found != shape:
                raise BadData(f"{name}: shape {found}, wanted {shape}")
        flat = np.eye(count, dtype=int)
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

    @cached_property
    def channels(self) -> tuple[str, ...]:
        """Letters of the mosaic in the order of the filters."""
        return channels_of(self.mosaic)

    @property
    def guide(self) -> int:
        """Index of the guide in `channels`."""
        return self.channels.index(guide_of(self.mosaic))

    @property
    def lights(self) -> int:
        """Sum of the weights of the channels in the light: the guide counts twice."""
        return len(self.channels) + 1

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
        """The terms of a flat field of 1 in one channel, int, shape (P, terms, C)."""
        each = np.eye(len(self.channels), dtype=int)
        guides = np.repeat(each, len(diamond(self.radii[2])), axis=0)
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
            First weights [1/2048], int32, shape (P, C, T); second weights [1], float64, shape (P, K,
            C, terms); floor; strengths, shape (S,).
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
        weights: Weights whose sums over each channel are whole numbers, shape (.., P, C, T).
        colors: Whether a tap has a channel, shape (P, T, C).

    Returns:
        Whole numbers, int32.
    """
    whole = np.rint(weights)
    for c in range(colors.shape[-1]):
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
    K, C). positions: position of the orbit's filters, shape (count,).
    """

    def __init__(self, mosaic, kinds, radii):
        """Find the orbits. kinds: as `GuidedTable.kinds`; radii: of codes and of the first picture."""
        self.classes = int(np.prod(kinds))
        cells = len(mosaic) * len(mosaic[0]) * self.classes
        least = np.full(cells, cells)
        codes, guides = map(diamond, radii)
        letters = channels_of(mosaic)
        self.terms = np.zeros((cells, len(codes) + len(letters) * len(guides)), np.int32)
        self.channels = np.zeros((cells, len(letters)), np.int32)
        steps = np.stack(np.unravel_index(np.arange(self.classes), kinds))
        for places, transpose, signs, swap in symmetries(mosaic, exchanges_of(mosaic)):
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
            channels = np.array([letters.index(swap.get(c, c)) for c in letters])
            moved = _move(guides, transpose, signs)
            guided = [len(codes) + c * len(guides) + moved for c in channels]
            self.terms[better] = np.concatenate([_move(codes, transpose, signs), *guided])
            self.channels[better] = channels
        found, self.of = np.unique(least, return_inverse=True)
        self.count, self.positions = len(found), found // self.classes

    def expand(self, filters) -> np.ndarray:
        """Return the filters of all positions and classes, shape (P, K, C, terms).

        filters: of the orbits, shape (count, C, terms).
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

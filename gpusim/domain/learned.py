"""Learned linear filters: a table that turns the mosaic of one kind of sensor into colour planes.

Terms used here and in the modules that make and use tables:

- Code: input of the filters, the signal above black or (domain "root") its square root.
- Position: place of a pixel in the period of its mosaic.
- Contrast: amount by which codes change along rows and along columns.
- Class: ratio of the contrasts along rows and columns, and their sum.
- Level: local mean of the codes.
"""

from dataclasses import dataclass, field

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.short_repr import short_repr

DOMAINS = ("root", "linear")
XYZ = ("X", "Y", "Z")
LONGEST_PERIOD = 8  # rows and columns of a mosaic
GRAIN = 4096  # roots are multiples of 1 / GRAIN: float32 sums of a few are exact in any order
# Largest sum of absolute contrast weights: contrasts of codes below 512 are exact in float32.
LARGEST_WEIGHT = 8
# Largest product of contrast weights and box pixels: sums of 18-bit codes stay below 2^26.
LARGEST_SUM = 256


@dataclass(frozen=True)
class Code:
    """Conversion of the digital numbers of one frame to codes, and back.

    Args:
        domain: "linear": code = DN - black_level. "root": sgn(y) sqrt|y| - sqrt(o) with y = DN -
            black_level + o and o = 3/8 gain + read^2 / gain, which makes the noise equal
            everywhere, sqrt(gain) / 2.
        black_level: Digital number of a dark pixel [DN].
        scale: 1 / (white - black_level) [1/DN].
        noise: Gain [DN/e-] and read noise [DN] of the variance gain (DN - black_level) + read^2
            [DN^2]; (0, 0) for no noise.
        balance: Factors on red and blue signals that make white as strong in them as in green. For
            "root" only: codes, noise included, grow by the square root (see `factors`).

    Raises:
        OutOfRange: A number is outside its range.
        UnknownName: The domain is not known.

    Source:
        Anscombe 1948, Biometrika 35, 246-254; with read noise Murtagh, Starck & Bijaoui 1995,
        Astron. Astrophys. Suppl. 112, 179.
    """

    domain: str
    black_level: float
    scale: float
    noise: tuple[float, float] = (0.0, 0.0)
    balance: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self):
        if self.domain == "linear" and self.balance != (1.0, 1.0):
            raise OutOfRange(
                "balance",
                self.balance,
                '(1, 1) in domain "linear": encoded data are balanced already',
            )
        if self.domain not in DOMAINS:
            raise UnknownName("domain", self.domain, DOMAINS)
        if not 0 < self.scale < np.inf:
            raise OutOfRange("scale", self.scale, "scale > 0")
        gain, read = self.noise
        if not (0 <= gain < np.inf and 0 <= read < np.inf and (gain > 0 or read == 0)):
            raise OutOfRange(
                "noise", self.noise, "gain >= 0 and read >= 0, and gain > 0 where read > 0"
            )
        if not abs(self.black_level) <= 65535:
            raise OutOfRange("black_level", self.black_level, "-65535 .. 65535 DN")
        if not self.offset <= 65535:
            raise OutOfRange("noise", self.noise, "3/8 gain + read^2 / gain <= 65535 DN")

    @property
    def offset(self) -> float:
        """Offset o that is added before the root is taken [DN]."""
        gain, read = self.noise
        return 0.375 * gain + read**2 / gain if self.domain == "root" and gain else 0.0

    @property
    def signals(self) -> dict[str, float]:
        """Factors on signals of the channels, by letter."""
        return {"R": self.balance[0], "G": 1.0, "B": self.balance[1]}

    @property
    def factors(self) -> dict[str, float]:
        """Factors on codes of the channels; the largest is 1: sums of codes stay exact."""
        roots = {letter: np.sqrt(factor) for letter, factor in self.signals.items()}
        most = max(roots.values())
        return {letter: float(np.float32(root / most)) for letter, root in roots.items()}

    @property
    def white(self) -> float:
        """Code of white in the channel whose signals have the factor 1."""
        return float(self.encode(1 / self.scale)) * self._factor_of_white

    @property
    def _factor_of_white(self):
        return self.factors["G"]

    @property
    def sigma(self) -> float:
        """Standard deviation of the code relative to white; for "linear" at a quarter of white.

        If channels differ, it is the root mean square over the pixels of the mosaic, which is
        Bayer's here.
        """
        gain, read = self.noise
        gain = gain * self._mean_signal * self._factor_of_white**2
        deviation = (
            np.sqrt(gain) / 2
            if self.domain == "root"
            else np.hypot(np.sqrt(gain / self.scale / 4), read)
        )
        return float(deviation / self.white)

    @property
    def _mean_signal(self):
        """Mean of `signals` over the pixels of the mosaic."""
        return (2 + sum(self.balance)) / 4

    def encode(self, signal):
        """Return the code of a signal above black [DN]."""
        signal = np.asarray(signal, np.float64)
        if self.domain == "linear":
            return signal
        return np.copysign(np.sqrt(np.abs(signal + self.offset)), signal + self.offset) - np.sqrt(
            self.offset
        )

    def encode_raw(self, raw, factors=1.0):
        """Return codes of digital numbers exactly as devices compute them.

        Roots are computed in float32 and rounded to multiples of 1 / GRAIN. factors: factor of each
        pixel, see `factors`.
        """
        if self.domain == "linear":
            return np.asarray(raw, np.float64) - self.black_level
        y = np.asarray(raw, np.float32) + np.float32(self.offset - self.black_level)
        code = np.copysign(np.sqrt(np.abs(y)), y) - np.float32(np.sqrt(self.offset))
        return np.floor(np.asarray(code * np.float32(factors), np.float64) * GRAIN + 0.5) / GRAIN

    def decode(self, code):
        """Return the signal above black [DN] of a code."""
        if self.domain == "linear":
            return code
        root = code + np.sqrt(self.offset)
        return root * np.abs(root) - self.offset


@dataclass(frozen=True)
class Layout:
    """Everything that selects the pixels of a filter and the filter of a pixel; lengths in pixels.

    There are K = (2 D + 1)(S + 1)(E + 1) classes: number ((direction + D)(S + 1) + strength)(E + 1)
    + share.

    Args:
        mosaic: One period of the colour filter array, a string per row, a letter per channel, at
            most 8 x 8.
        outputs: Names of the output planes, for example ("R", "G", "B") or ("X", "Y", "Z").
        domain: "root" or "linear", the domain that the table was made for.
        taps: Rows and columns from the pixel to each sample that a filter uses, shape (T, 2).
        groups: Index of the weight of each tap, shape (T,), using all of 0 .. G - 1. Taps of one
            group are summed first.
        contrast: Integer weights of 2 r + 1 pixels along columns (dy = -r .. r), and the same along
            rows. Each set sums to zero over the pixels of one colour: flat fields have no contrast.
        box: Contrast, detail and level are means over (2 box + 1)^2 pixels.
        ratios: Bounds of direction [1/8], shape (D,), above 8, increasing. A pixel has direction d
            > 0 if its contrast along rows exceeds d of the bounds ratios / 8 times the contrast
            along columns, and -d in the opposite case.
        noise: Standard deviations of the code, relative to white, for which the table has filters,
            shape (N,), increasing.
        floor: Mean contrast that is added to both sides of these comparisons, relative to white,
            shape (N,).
        strengths: Bounds of the mean of both contrasts, relative to white, shape (N, S),
            increasing.
        levels: Codes, relative to white, for which the table has filters, shape (L,), increasing.
        detail: Weights of a second kind, with the same sum of absolute weights. If contrast
            measures colour differences and detail measures samples, their ratio shows whether the
            colours change together.
        shares: Bounds of contrast / detail [1/8], shape (E,), increasing. Each of the two is the
            smaller one of rows and columns.

    Raises:
        BadData: Shapes or weights do not fit.
        OutOfRange: Ratios or shares are outside their range.
        UnknownName: The domain is not known.
    """

    mosaic: tuple[str, ...]
    outputs: tuple[str, ...]
    domain: str
    taps: np.ndarray
    groups: np.ndarray
    contrast: tuple[np.ndarray, np.ndarray]
    box: int
    ratios: np.ndarray
    noise: np.ndarray
    floor: np.ndarray
    strengths: np.ndarray
    levels: np.ndarray = field(default_factory=lambda: np.zeros(1))
    detail: tuple[np.ndarray, np.ndarray] | None = None
    shares: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))

    __repr__ = short_repr

    def __post_init__(self):
        if self.domain not in DOMAINS:
            raise UnknownName("domain", self.domain, DOMAINS)
        kept = (
            ("taps", np.int32, 2),
            ("groups", np.int32, 1),
            ("ratios", np.int32, 1),
            ("shares", np.int32, 1),
            ("noise", np.float64, 1),
            ("floor", np.float64, 1),
            ("strengths", np.float64, 2),
            ("levels", np.float64, 1),
        )
        for name, dtype, ndim in kept:
            values = np.array(getattr(self, name), dtype, ndmin=ndim)
            if values.ndim != ndim or not np.isfinite(values).all():
                raise BadData(f"{name}: shape {values.shape}, wanted {ndim} axes of finite numbers")
            values.flags.writeable = False
            object.__setattr__(self, name, values)
        for name in ("contrast", "detail"):
            axes = getattr(self, name)
            if axes is not None:
                object.__setattr__(self, name, tuple(np.array(axis, np.int32) for axis in axes))
        object.__setattr__(self, "mosaic", tuple(self.mosaic))
        object.__setattr__(self, "outputs", tuple(self.outputs))
        self._check()

    def _check(self):
        rows, cols = self.period
        if (
            not 0 < rows <= LONGEST_PERIOD
            or not 0 < cols <= LONGEST_PERIOD
            or {*map(len, self.mosaic)} != {cols}
        ):
            raise BadData(
                f"mosaic {self.mosaic}: wanted 1 to {LONGEST_PERIOD} texts of 1 to {LONGEST_PERIOD} letters"
            )
        if self.taps.shape[1:] != (2,) or len(self.groups) != len(self.taps) or not len(self.taps):
            raise BadData(
                f"taps and groups: shapes {self.taps.shape} and {self.groups.shape}, wanted (T, 2) and (T,)"
            )
        groups = set(self.groups.tolist())
        if groups != set(range(len(groups))):
            raise BadData("groups: wanted every number from 0 to the largest")
        if not 0 < len(self.outputs) <= 8 or len(set(self.outputs)) != len(self.outputs):
            raise BadData(f"outputs {self.outputs}: wanted 1 to 8 different names")
        if self.detail is None and len(self.shares):
            raise BadData("shares: they compare contrast with detail, which is None")
        for name, axes in (("contrast", self.contrast), ("detail", self.detail or ())):
            for axis, period in zip(axes, self.period, strict=bool(axes)):
                if (
                    axis.ndim != 1
                    or not len(axis) % 2
                    or any(axis[k::period].sum() for k in range(period))
                ):
                    raise BadData(
                        f"{name}: {axis}; wanted an odd number of weights, of sum 0 over every {period}th "
                        "pixel"
                    )
                if not (np.array_equal(axis, axis[::-1]) or np.array_equal(axis, -axis[::-1])):
                    raise BadData(
                        f"{name}: {axis}; wanted weights that mirrored are the same, or opposite"
                    )
                if abs(axis).sum() != self.weight:
                    raise BadData(
                        f"{name}: {axis}; wanted absolute weights of sum {self.weight} as the others"
                    )
        if self.weight > LARGEST_WEIGHT:
            raise BadData(
                f"contrast: absolute weights of sum {self.weight}; at most {LARGEST_WEIGHT} is wanted"
            )
        if self.box < 0 or (2 * self.box + 1) ** 2 * self.weight > LARGEST_SUM:
            raise BadData(
                f"contrast: weights of {self.weight} times a box of {2 * self.box + 1}x{2 * self.box + 1} "
                f"pixels; at most {LARGEST_SUM} is wanted"
            )
        if self.floor.shape != self.noise.shape or len(self.strengths) != len(self.noise):
            raise BadData(
                f"floor {self.floor.shape}, strengths {self.strengths.shape}: wanted one for each of "
                f"{len(self.noise)} noise levels"
            )
        for name in ("ratios", "shares", "noise", "strengths", "levels"):
            if (np.diff(getattr(self, name)) <= 0).any():
                raise BadData(f"{name}: {getattr(self, name)}, wanted increasing numbers")
        if len(self.ratios) and not 8 < self.ratios[0] <= self.ratios[-1] <= 32:
            raise OutOfRange("ratios", self.ratios, "8 < ratio <= 32 [eighths]")
        if len(self.shares) and not 0 < self.shares[0] <= self.shares[-1] <= 32:
            raise OutOfRange("shares", self.shares, "0 < share <= 32 [eighths]")

    @property
    def period(self) -> tuple[int, int]:
        """Rows and columns of the period of the mosaic."""
        return len(self.mosaic), len(self.mosaic[0]) if self.mosaic else 0

    @property
    def positions(self) -> int:
        """Number P of pixels in a period, numbered row by row."""
        return self.period[0] * self.period[1]

    @property
    def channels(self) -> tuple[str, ...]:
        """Letters of the mosaic in the order of their first pixels."""
        return tuple(dict.fromkeys("".join(self.mosaic)))

    @property
    def gives_xyz(self) -> bool:
        """True if filters return CIE XYZ of surfaces in the target light, not camera channels."""
        return self.outputs == XYZ

    @property
    def alike(self) -> bool:
        """True if rows and columns are treated equally."""
        return (
            self.period[0] == self.period[1]
            and np.array_equal(*self.contrast)
            and (self.detail is None or np.array_equal(*self.detail))
        )

    @property
    def weight(self) -> int:
        """Sum of the absolute weights of a contrast; half of it corresponds to a contrast of 1."""
        return int(abs(self.contrast[0]).sum())

    @property
    def classes(self) -> int:
        """Number K of classes: directions times strengths times shares."""
        return (2 * len(self.ratios) + 1) * self.kinds

    @property
    def kinds(self) -> int:
        """Number of classes of one direction."""
        return (self.strengths.shape[1] + 1) * (len(self.shares) + 1)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the filters: (N, L, P, K, outputs, G)."""
        return (
            len(self.noise),
            len(self.levels),
            self.positions,
            self.classes,
            len(self.outputs),
            int(self.groups.max()) + 1,
        )

    def shift(self, mosaic) -> tuple[int, int]:
        """Find the row and column of the table's period at which the mosaic of a sensor begins.

        Args:
            mosaic: Rows of letters, or four letters of a Bayer mosaic like "RGGB".

        Returns:
            Row and column.

        Raises:
            UnknownName: The table is for another mosaic.
        """
        return find_shift(self.mosaic, mosaic)


def find_shift(table, mosaic) -> tuple[int, int]:
    """Return the row and column of a table's period at which a mosaic begins.

    Args:
        table: One period of the table's mosaic, rows of letters.
        mosaic: Rows of letters, or four letters of a Bayer mosaic like "RGGB".

    Raises:
        UnknownName: The table is for another mosaic.
    """
    texts = (
        (mosaic[:2], mosaic[2:]) if isinstance(mosaic, str) and len(mosaic) == 4 else tuple(mosaic)
    )
    rows, cols = len(table), len(table[0])
    own = np.array([list(text) for text in table])
    is_even = {*map(len, texts)} == {len(texts[0])}
    given = np.array([list(text) for text in texts]) if is_even else own[:0]
    if given.size and not len(given) % rows and not given.shape[1] % cols:
        wide = np.tile(own, (len(given) // rows, given.shape[1] // cols))
        for row in range(rows):
            for col in range(cols):
                if np.array_equal(np.roll(wide, (-row, -col), (0, 1)), given):
                    return row, col
    raise UnknownName("mosaic", "/".join(texts), ["/".join(table)])


@dataclass(frozen=True)
class FilterTable:
    """Linear filters of every noise level, level, position, class and output.

    Args:
        layout: The layout.
        filters: Weights of the sums of groups, float32, shape `layout.shape` (N, L, P, K, outputs,
            G).
        offsets: Values to add, relative to white, shape (N, L, P, K, outputs), or None for zero.
        provenance: Source of the table.

    Raises:
        BadData: A shape is wrong, or a value is not finite.
    """

    layout: Layout
    filters: np.ndarray
    offsets: np.ndarray | None = None
    provenance: str = ""

    __repr__ = short_repr

    def __post_init__(self):
        shape = self.layout.shape
        for name, wanted in (("filters", shape), ("offsets", shape[:-1])):
            values = getattr(self, name)
            if values is None and name == "offsets":
                continue
            values = np.array(values, np.float32)
            if values.shape != wanted or not np.isfinite(values).all():
                raise BadData(f"{name}: shape {values.shape}, wanted {wanted} of finite numbers")
            values.flags.writeable = False
            object.__setattr__(self, name, values)

    def at_noise(self, sigma):
        """Interpolate the table to the noise of a code.

        Linear between the nearest two of `layout.noise`, constant beyond the ends.

        Args:
            sigma: Standard deviation of the code relative to white.

        Returns:
            Filters, shape (L, P, K, outputs, G); offsets, shape (L, P, K, outputs), or None; floor;
            strengths, shape (S,). All float64.
        """
        noise = self.layout.noise
        at = float(np.interp(sigma, noise, np.arange(len(noise))))
        lower, t = int(at), at % 1

        def between(values):
            low = np.asarray(values[lower], np.float64)
            return low if t == 0 else (1 - t) * low + t * values[lower + 1]

        return (
            between(self.filters),
            None if self.offsets is None else between(self.offsets),
            float(between(self.layout.floor)),
            between(self.layout.strengths),
        )

    def __hash__(self):
        return id(self)

    def __eq__(self, other):
        return self is other

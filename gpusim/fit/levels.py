"""Numbers of one stack of frames: means and variances by channel."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from gpusim.domain.progress import announced
from gpusim.fit.intervals import MeanSquare
from gpusim.fit.sorting import Summary
from gpusim.fit.stack import FrameStack

STRIDE = 5  # of the pixels of a median; few enough are left out that its error is small


@dataclass(frozen=True)
class Point:
    """Mean and temporal variance of one channel's pixels.

    Args:
        mean: Mean [DN].
        mean_variance: Its variance from noise of pixels [DN^2].
        variance: Temporal variance of pixels, without rows and columns [DN^2].
        variance_variance: Its variance [DN^4].
        brightest: Value below which nearly all pixels are [DN].
        middle: Median of the pixels' means [DN].
    """

    mean: float
    mean_variance: float
    variance: float
    variance_variance: float
    brightest: float
    middle: float


@dataclass(frozen=True, eq=False)
class Level:
    """Numbers of the frames of one setting.

    Args:
        points: By letter of the mosaic.
        iso, exposure_time, temperature, photons: The setting, None if it is unknown.
        count: Number of frames.
        names: Names of the frames.
        highest: Largest value [DN].
        at_highest: Share of pixels with that value.
        frame_means: Mean of each frame and each place of the period [DN].
        lags: Products of standardised neighbours and their numbers, for each residual.
        spectra: Mean power along rows and along columns, for each residual.
        rows, columns: Temporal means of rows and columns [DN].
        row_square, column_square: Their mean squares.
        shift: Displacement of the second frame [pixel] and its standard error.
        shape: Rows and columns.
    """

    points: dict[str, Point]
    iso: float | None
    exposure_time: float | None
    temperature: float | None
    photons: float | None
    count: int
    names: tuple[str, ...]
    highest: float
    at_highest: float
    frame_means: np.ndarray
    lags: list
    spectra: tuple[list, list]
    rows: np.ndarray
    columns: np.ndarray
    row_square: MeanSquare | None
    column_square: MeanSquare | None
    shift: tuple[np.ndarray, np.ndarray] | None
    shape: tuple[int, int]
    clipped: set = field(default_factory=set)

    @property
    def mean(self) -> float:
        """Mean over the channels [DN]."""
        return float(np.mean([point.mean for point in self.points.values()]))


def stack_group(group: Sequence[Summary], done: Iterator[int], total: int, **more) -> FrameStack:
    """Read the frames of a group into a stack.

    Args:
        group: The shots.
        done: Counter of frames of all groups.
        total: Number of frames of all groups.
        more: For `FrameStack`.
    """
    stack = FrameStack(group[0].frame.period, **more)
    for one in group:
        name = one.frame.name
        with announced(f"measuring {name}, {next(done)} of {total} frames measured"):
            stack.add(one.shot.read().values, name)
    return stack


def level_of(group: Sequence[Summary], stack: FrameStack, good: np.ndarray) -> Level:
    """Return the numbers of a stack of two or more frames; of one frame, variances are infinite."""
    frame = group[0].frame
    letters = "".join(frame.cfa)
    has_pairs = stack.count > 1
    moments = stack.variances() if has_pairs else np.full((len(letters), 2), np.inf)
    if has_pairs and stack.squares is not None:
        moments = _masked_moments(stack, moments, good)
    points = {}
    for letter in frame.channels:
        indices = [index for index, one in enumerate(letters) if one == letter]
        places = [place for index, place in enumerate(stack.places()) if index in indices]
        means = [float(stack.mean[place][good[place]].mean(dtype=np.float64)) for place in places]
        values, relative = moments[indices].T
        # places of a channel have equal noise: weights from their own kurtosis would be noise only
        variance = float(np.mean(values))
        spread = float(np.mean(values**2 * relative)) / len(values) if has_pairs else math.inf
        number = sum(np.count_nonzero(good[place]) for place in places) * stack.count
        sample = np.concatenate(
            [
                stack.mean[place][good[place]][:: 1 if stack.mean.size < 4_000_000 else STRIDE]
                for place in places
            ]
        )
        middle, brightest = np.quantile(sample, (0.5, 0.999)) if len(sample) else (0.0, 0.0)
        mean = float(np.mean(means))
        points[letter] = Point(
            mean, variance / number, variance, spread, float(brightest), float(middle)
        )
    return Level(
        points,
        frame.iso,
        frame.exposure_time,
        frame.temperature,
        frame.photons,
        stack.count,
        tuple(stack.names),
        stack.highest,
        stack.at_highest,
        np.array(stack.phase_means),
        stack.lag_sums,
        (stack.row_spectrum, stack.column_spectrum),
        np.array(stack.row_means),
        np.array(stack.column_means),
        stack.row_square() if has_pairs else None,
        stack.column_square() if has_pairs else None,
        stack.shifts[0] if stack.shifts else None,
        stack.shape,
    )


def _masked_moments(stack, moments, good):
    """Return variances of good pixels from their sums of squares, and their relative variances."""
    found = []
    for place, (_, relative) in zip(stack.places(), moments, strict=True):
        squares = stack.squares[place]
        height, width = squares.shape
        chosen = squares[good[place]]
        factor = (1 - 1 / height) * (1 - 1 / width) * stack.freedom
        found.append((float(chosen.mean(dtype=np.float64)) / factor, relative))
    return np.array(found)

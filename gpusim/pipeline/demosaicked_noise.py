"""The noise of a mosaic after demosaicking, at each scale and among the channels, and its removal."""

import functools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.processor.levels import MOST_BALANCE
from gpusim.kernels.processor.multiscale import multiscale, opponent_axes

SIZE = 192  # rows and columns of the field that is measured
ELECTRONS = 100.0  # mean of its samples
BLACK, STEP = 500, 16  # its digital numbers: black level, and gain [DN/e-]
MEASURED = (
    3  # levels; in coarser ones the noise is white, and its deviation halves from level to level
)
LEVELS = 5  # of the pyramid
# rows: Walsh's functions of four pixels, by their changes of sign
WALSH = np.array([[1, 1, 1, 1], [1, 1, -1, -1], [1, -1, -1, 1], [1, -1, 1, -1]]) / 2


@dataclass(frozen=True, eq=False)
class DemosaickedNoise:
    """Noise of roots of channels, for samples whose roots have the variance 1.

    Attributes:
        covariance: Of the channels in each Walsh coefficient of blocks of 4 x 4 pixels, in each level of a
            pyramid of means of 2 x 2, (LEVELS, 4, 4, C, C).
        share: Variance of a pixel, (C,).
    """

    covariance: np.ndarray
    share: np.ndarray

    @property
    def large_scale(self) -> np.ndarray:
        """Covariance per pixel of means over large areas, (C, C)."""
        return 4.0 ** (LEVELS - 1) * self.covariance[-1, -1, -1]

    def in_order(self, planes) -> "DemosaickedNoise":
        """Return the noise with the planes of these indices."""
        return DemosaickedNoise(self.covariance[..., planes, :][..., planes], self.share[planes])

    def spread(self, axes: np.ndarray) -> np.ndarray:
        """Return the standard deviation in each coefficient along axes (C, C), (LEVELS, C, 4, 4)."""
        variance = np.einsum("ac,lvucd,ad->lavu", axes, self.covariance, axes)
        return np.sqrt(np.maximum(variance, 0))


def white_noise(channels: int) -> DemosaickedNoise:
    """Return the noise of pixels that have all channels: as sampled.

    Args:
        channels: Number of channels.
    """
    one = np.eye(channels) * np.ones((4, 4, 1, 1))
    return DemosaickedNoise(
        np.stack([one / 4.0**level for level in range(LEVELS)]), np.ones(channels)
    )


def measure_noise(
    demosaic: Callable, constants: Mapping[str, Any], assumed: float = 0.0
) -> DemosaickedNoise:
    """Return the noise after demosaicking, measured on a grey field with the noise of its light.

    Args:
        demosaic: Function from digital numbers to planes (C, rows, cols), such as a stage.
        constants: Its arguments beside the noise and the scale of the digital numbers.
        assumed: Noise that it is told over that of the field [1]; 0: it is not told.

    Returns:
        The noise; cached for equal arguments.
    """
    return _measure(demosaic, _Arguments(dict(constants)), assumed)


def denoise_planes(
    planes, white, shading=None, *, measured, noise, strength, is_balanced=False, device
) -> Any:
    """Return camera values denoised in a luminance and chromas that grey does not have.

    white: camera values of white, shape (C,), or None. shading: gains that were applied, as for `Developer.demosaic`.
    measured: a `DemosaickedNoise`. is_balanced: whether white is equal in all planes.
    """
    if white is None or is_balanced:
        white = np.ones(planes.shape[0])
    white = np.maximum(np.asarray(white, np.float64), 0)
    balance = white.max() / np.maximum(white, white.max() / MOST_BALANCE)
    axes = opponent_axes(measured.large_scale, balance)
    return multiscale(
        planes,
        noise=noise,
        axes=axes,
        spread=measured.spread(axes),
        share=measured.share,
        gains=None if shading is None else np.asarray(shading).mean(0),
        strength=strength,
        device=device,
    )


class _Arguments:
    """Arguments as a key of a cache: arrays by their values, other objects without a hash by identity."""

    def __init__(self, values: dict):
        self.values = values
        self._key = tuple((name, _key_of(value)) for name, value in sorted(values.items()))

    def __hash__(self):
        return hash(self._key)

    def __eq__(self, other):
        return isinstance(other, _Arguments) and self._key == other._key


def _key_of(value):
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    try:
        hash(value)
    except TypeError:
        return id(value)  # `_Arguments.values` keeps it
    return value


@functools.lru_cache(maxsize=16)
def _measure(demosaic, arguments, assumed):
    random, scale = np.random.default_rng(40), 1 / (4 * STEP * ELECTRONS)
    raw = (BLACK + STEP * random.poisson(ELECTRONS, (SIZE, SIZE))).astype(np.uint16)
    told = {"noise": (assumed * STEP, 0.0)} if assumed else {}
    own = Device()  # NumPy's; a frame's clock does not run on it
    numbers = {"black_level": float(BLACK), "scale": scale, "device": own}
    planes = np.asarray(demosaic(raw, **arguments.values, **told, **numbers), np.float64)
    half = 2 * np.sqrt(np.maximum(planes / (STEP * scale) + 0.375, 0))  # roots of variance 1
    share, levels = half.var((1, 2)), []
    for _ in range(MEASURED):
        blocks = _transform(_transform(half, 2), 2).reshape(4, 4, len(half), -1)
        levels.append(blocks @ blocks.swapaxes(2, 3) / blocks.shape[3])
        half = (half[:, ::2] + half[:, 1::2]) / 2
        half = (half[:, :, ::2] + half[:, :, 1::2]) / 2
    rest = (levels[-1][0, 1] + levels[-1][1, 0] + levels[-1][1, 1]) / 3  # the longest waves
    while len(levels) < LEVELS:
        rest = rest / 4
        levels.append(np.broadcast_to(rest, levels[0].shape))
    return DemosaickedNoise(np.stack(levels), share)


def _transform(values, axis):
    """Return the Walsh coefficients of all runs of four values along an axis, on a new first axis."""
    count = values.shape[axis] - 3
    runs = [values.take(range(first, first + count), axis) for first in range(4)]
    return np.tensordot(WALSH, np.stack(runs), 1)

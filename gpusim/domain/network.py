"""The demosaicking network: its weights, and what it serves."""

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from gpusim.domain.errors import BadData, OutOfRange

VERSION = 2  # of inputs and layers; weights of another version mean something else
COLORS = "RGB"
BLOCK = 4  # pixels whose values are the channels of a layer
INPUTS = 2 * 3 * BLOCK + BLOCK  # first guess, masks, noise
OUTPUTS = 3 * BLOCK
REACH = 3  # of the first guess [pixel]
NEAR = 0.8  # standard deviation of its weights [pixel]
LARGEST = 150_000  # weights
GROUP = 12  # outputs that kernels make at once; divides the outputs of every layer
LONGEST_PERIOD = 8  # rows and columns of a mosaic
SQUARE = 4  # pixels along a side


def spread(distance: np.ndarray) -> np.ndarray:
    """Return the weights of samples at distances [pixel] along one axis, float32."""
    return np.exp(-0.5 * (np.asarray(distance) / NEAR) ** 2).astype(np.float32)


def check_served(cfa) -> None:
    """Raise OutOfRange if the network cannot serve a mosaic.

    It serves mosaics like the ones that it was trained on: every SQUARE x SQUARE pixels have all
    colours.

    Args:
        cfa: One period of the mosaic, a text per row.
    """
    at = np.array([list(row) for row in cfa])
    is_known = at.ndim == 2 and max(at.shape) <= LONGEST_PERIOD and {*at.flat} == {*COLORS}
    if is_known:
        repeated = np.pad(at, [(0, SQUARE - 1)] * 2, mode="wrap")
        windows = sliding_window_view(repeated, (SQUARE, SQUARE))
        is_known = all((windows == color).any((2, 3)).all() for color in COLORS)
    if not is_known:
        raise OutOfRange(
            "mosaic of the network",
            "/".join(cfa),
            f"a period of at most {LONGEST_PERIOD}x{LONGEST_PERIOD} pixels of R, G and B, all in every "
            f"{SQUARE}x{SQUARE} pixels",
        )


def is_served(cfa) -> bool:
    """Return whether the network can serve a mosaic, see `check_served`."""
    try:
        check_served(cfa)
    except OutOfRange:
        return False
    return True


@dataclass(frozen=True, eq=False)
class Network:
    """Layers of 3 x 3 convolutions on blocks of 2 x 2 pixels.

    Args:
        weights: One array for each layer, (outputs, inputs, 3, 3), float32.
        biases: One array for each layer, (outputs,), float32.
        provenance: How the weights were made.

    Raises:
        BadData: The shapes do not fit, or a number is not finite.
        OutOfRange: There are too many weights.
    """

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    provenance: str = field(default="", repr=False)

    def __post_init__(self):
        inputs = INPUTS
        if len(self.weights) != len(self.biases) or len(self.weights) < 2:
            raise BadData("network: wanted two or more layers, each with weights and biases")
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            is_last = number == len(self.weights) - 1
            outputs = OUTPUTS if is_last else len(self.biases[0])
            if weight.shape != (outputs, inputs, 3, 3) or bias.shape != (outputs,):
                raise BadData(
                    f"network, layer {number}: weights {weight.shape} and biases {bias.shape}, "
                    f"wanted ({outputs}, {inputs}, 3, 3) and ({outputs},)"
                )
            if outputs % GROUP:
                raise BadData(
                    f"network, layer {number}: {outputs} outputs; wanted a multiple of {GROUP}"
                )
            if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
                raise BadData(f"network, layer {number}: numbers that are not finite")
            inputs = outputs
        if self.count > LARGEST:
            raise OutOfRange("weights of the network", self.count, f"at most {LARGEST:,}")

    @property
    def count(self) -> int:
        """Number of weights and biases."""
        return sum(one.size for one in (*self.weights, *self.biases))

"""The network in PyTorch, for training: the same numbers as `processor.network`."""

import functools

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from gpusim.domain.network import INPUTS, OUTPUTS, REACH, Network, spread

WIDTH, LAYERS = 48, 6  # channels between the layers; layers that keep their number


class Model(nn.Module):
    """Layers of 3 x 3 convolutions on blocks of 2 x 2 pixels.

    Args:
        width: Channels between the layers.
        layers: Number of layers that add to their input.
    """

    def __init__(self, width: int = WIDTH, layers: int = LAYERS):
        super().__init__()
        self.first = nn.Conv2d(INPUTS, width, 3, padding=1)
        self.layers = nn.ModuleList(nn.Conv2d(width, width, 3, padding=1) for _ in range(layers))
        self.last = nn.Conv2d(width, OUTPUTS, 3, padding=1)
        for layer in (*self.layers, self.last):  # begins as the first guess
            nn.init.zeros_(layer.bias)
            layer.weight.data *= 0.3

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return what is added to the first guess, shape (N, OUTPUTS, rows, cols)."""
        values = torch.relu(self.first(inputs))
        for layer in self.layers:
            values = torch.relu(values + layer(values))
        return self.last(values)

    def export(self, provenance: str) -> Network:
        """Return the weights for `processor.network`."""
        convolutions = [self.first, *self.layers, self.last]
        return Network(
            tuple(one.weight.detach().float().cpu().numpy() for one in convolutions),
            tuple(one.bias.detach().float().cpu().numpy() for one in convolutions),
            provenance,
        )


@functools.cache
def _spreads(device):
    """Return the weights of the first guess for three planes, (3, 1, 7, 7)."""
    taps = spread(np.arange(-REACH, REACH + 1))
    return torch.from_numpy(np.outer(taps, taps)).to(device).expand(3, 1, -1, -1).contiguous()


def first_guess(codes: torch.Tensor, masks: torch.Tensor) -> torch.Tensor:
    """Return weighted means of each colour's samples, measured samples kept.

    Args:
        codes: Codes of a mosaic, shape (N, 1, rows, cols).
        masks: 1 at the samples of red, green and blue, shape (N, 3, rows, cols).

    Returns:
        The planes, shape (N, 3, rows, cols).
    """
    kernel = _spreads(codes.device)
    sums = functional.conv2d(masks * codes, kernel, padding=REACH, groups=3)
    weights = functional.conv2d(masks, kernel, padding=REACH, groups=3)
    return torch.where(masks > 0, codes, sums / weights.clamp_min(1e-9))


def pack(planes: torch.Tensor) -> torch.Tensor:
    """Return blocks of 2 x 2 pixels as channels: (N, C, rows, cols) -> (N, 4 C, rows / 2, cols / 2)."""
    return functional.pixel_unshuffle(planes, 2)


def unpack(blocks: torch.Tensor) -> torch.Tensor:
    """Return the pixels of blocks, the inverse of `pack`."""
    return functional.pixel_shuffle(blocks, 2)


def network_inputs(guess, masks, sigma) -> torch.Tensor:
    """Return the inputs of the first layer, shape (N, INPUTS, rows / 2, cols / 2).

    Args:
        guess: See `first_guess`.
        masks: 1 at the samples of each colour, shape (N, 3, rows, cols).
        sigma: Noise of each code, shape (N, 1, rows, cols).
    """
    return torch.cat([pack(guess), pack(masks), pack(sigma)], 1)

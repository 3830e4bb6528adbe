"""What the planner reads from a scene's pixels, each number once."""

from dataclasses import replace
from functools import cached_property
from typing import Protocol

import numpy as np

from gpusim.domain.content import Content
from gpusim.domain.scene import Scene
from gpusim.planner.depth import flattened
from gpusim.planner.fusion import Spectra, row_pairs
from gpusim.planner.sampling import Moments, moments


class Samples(Protocol):
    """What is read of a content, which may be on a device: see `gpusim.program.reading.Reading`."""

    def taken(self, rows, cols=None) -> Content:
        """Windows of the samples, one above the other, in host memory; rows (n, h) and cols (n, w), int, or all."""

    def brightness(self, total) -> np.ndarray:
        """Sums over wavelength by `total` (L,): float32 (rows, cols), a new array."""

    def whole(self) -> Content:
        """All samples, in host memory; of a picture they may be its codes."""


class OnHost:
    """Samples of a content in host memory."""

    def __init__(self, content: Content):
        self._content = content

    def taken(self, rows, cols=None) -> Content:
        """See `Samples`."""
        if cols is None:
            return self._content.take(rows.ravel())
        return self._content.take(rows.reshape(-1, 1), np.repeat(cols, rows.shape[1], axis=0))

    def brightness(self, total) -> np.ndarray:
        """See `Samples`."""
        return self._content.brightness(total)

    def whole(self) -> Content:
        """See `Samples`."""
        return self._content


class Facts:
    """Facts of a content and, where it is known, of the distance of its samples [m].

    samples: how the content's are read, by default in host memory.
    """

    def __init__(self, content: Content, depth: np.ndarray | None = None, samples: Samples | None = None):
        self.content, self.depth, self.samples = content, depth, samples or OnHost(content)
        self._brightness: tuple[bytes, np.ndarray] | None = None
        self._channels: tuple[bytes, np.ndarray] | None = None

    @classmethod
    def of(cls, scene: Scene) -> "Facts":
        """Those of the picture that a scene shows."""
        if not all(content.is_seen for content in (scene.content, *(layer.content for layer in scene.layers))):
            layers = tuple(replace(layer, content=layer.content.on_host()) for layer in scene.layers)
            scene = replace(scene, content=scene.content.on_host(), layers=layers)  # which looks at the values
        return cls(*flattened(scene))

    @cached_property
    def pairs(self) -> Content:
        """Evenly spaced pairs of neighbouring rows, one above the other, in host memory."""
        rows, cols = self.content.shape
        first = row_pairs(rows, cols)
        return self.samples.taken(np.stack([first, np.minimum(first + 1, rows - 1)], axis=1).reshape(1, -1))

    @cached_property
    def spectra(self) -> Spectra:
        """Second moments of the spectra and of their differences between neighbours."""
        return Spectra.of_pairs(self.pairs)

    def brightness(self, total) -> np.ndarray:
        """Sums over wavelength by `total` (L,): float32 (rows, cols), a copy."""
        key, found = total.tobytes(), self._brightness
        if found is None or found[0] != key:
            found = self._brightness = key, self.samples.brightness(total)
        return found[1].copy()

    def channels(self, weights) -> np.ndarray:
        """What the pairs give to channels of `weights` (C, L): float64 (C, rows, cols), good to float32."""
        key, found = weights.tobytes(), self._channels
        if found is None or found[0] != key:
            table = weights @ self.pairs.entry_spectra.T
            found = self._channels = key, self.pairs.mixed(table.astype(np.float32)).astype(np.float64)
        return found[1]

    def moments(self, weights) -> Moments:
        """Moments of the channels `weights` (C, L)."""
        return moments(self.pairs, self.channels(weights))

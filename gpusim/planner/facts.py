"""What the planner reads from a scene's pixels, each number once."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from gpusim.domain.content import Content
from gpusim.domain.scene import Scene
from gpusim.planner.depth import flattened
from gpusim.planner.fusion import Spectra
from gpusim.planner.sampling import Moments, moments


class Facts:
    """Facts of a content and, where it is known, of the distance of its samples [m]."""

    def __init__(self, content: Content, depth: np.ndarray | None = None):
        self.content, self.depth = content, depth
        self._brightness: tuple[bytes, np.ndarray] | None = None
        self._moments: tuple[bytes, Moments] | None = None

    @classmethod
    def of(cls, scene: Scene) -> "Facts":
        """Those of the picture that a scene shows."""
        content = scene.content.on_host()
        layers = tuple(replace(layer, content=layer.content.on_host()) for layer in scene.layers)
        if content is not scene.content or any(a.content is not b.content
                                               for a, b in zip(layers, scene.layers, strict=True)):
            scene = replace(scene, content=content, layers=layers)
        return cls(*flattened(scene))

    @cached_property
    def spectra(self) -> Spectra:
        """Second moments of the spectra and of their differences between neighbours."""
        return Spectra.of(self.content)

    def brightness(self, total) -> np.ndarray:
        """Sums over wavelength by `total` (L,): float32 (rows, cols), a copy."""
        key, found = total.tobytes(), self._brightness
        if found is None or found[0] != key:
            found = self._brightness = key, self.content.brightness(total)
        return found[1].copy()

    def moments(self, weights) -> Moments:
        """Moments of the channels `weights` (C, L)."""
        key, found = weights.tobytes(), self._moments
        if found is None or found[0] != key:
            found = self._moments = key, moments(self.content, weights)
        return found[1]

"""Colour errors of the patches of a ColorChecker in a picture."""

import numpy as np

from gpusim.data.charts import colorchecker_patches
from gpusim.domain.scene import Scene
from gpusim.measure.difference import ciede2000
from gpusim.measure.ideal import ideal

INSIDE = 8  # 1 / INSIDE of a patch's side is left out at each border because of the lens's blur
LEAST = 48  # least rows of a chart with separable patches


class Checker:
    """Patches of a scene of the chart "colorchecker", as an ideal camera shows them on sRGB.

    true: their mean XYZ, (24, 3), white Y = 1. shape: rows and columns of the scene.
    """

    def __init__(self, scene: Scene):
        parts = colorchecker_patches(scene.shape[::-1])
        side = parts[0][0].stop - parts[0][0].start
        rim = max(1, side // INSIDE) if side > 2 else 0
        self._parts = [
            tuple(slice(part.start + rim, part.stop - rim) for part in patch) for patch in parts
        ]
        self.shape = scene.shape
        self.true = self._patch_means(ideal(scene))

    def _patch_means(self, picture):
        return np.stack([picture[part].mean(axis=(0, 1)) for part in self._parts])

    def differences(self, linear, diffuser: float, display) -> np.ndarray:
        """Return the CIEDE2000 of each patch's mean colour, (24,), from dark skin to black.

        linear: display RGB (rows, cols, 3). diffuser: its value for a white diffuser.
        """
        shown = np.clip(self._patch_means(np.asarray(linear, np.float64)) / diffuser, 0, 1)
        return ciede2000(shown @ display.xyz_from_rgb.T, self.true)


def checker_of(scene: Scene) -> Checker | None:
    """Return the patches of a scene; None if it is no ColorChecker or its light is unknown."""
    plain = scene.name == "colorchecker" and scene.view.is_plain and scene.light_is_known
    return Checker(scene) if plain and scene.shape[0] >= LEAST else None

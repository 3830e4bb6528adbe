"""The largest part of the way from a neutral that is inside the gamut, hue of OKLab, by bisection in float64."""

import numpy as np

from gpusim.kernels.processor.gamut import BRIGHT, LIGHTNESS


def gamut(rgb, lms_from_rgb):
    """Return the stage's result, see `gamut.py`."""
    rgb = np.asarray(rgb, np.float64)
    matrix = np.asarray(lms_from_rgb, np.float64)
    with np.errstate(all="ignore"):
        roots = np.cbrt(np.einsum("pc,cyx->pyx", matrix, rgb))
        light = np.clip(np.einsum("c,cyx->yx", LIGHTNESS, roots), 0, BRIGHT)
        chroma = roots - light
        inside = np.zeros_like(light)
        outside = np.ones_like(light)
        for _ in range(50):
            middle = (inside + outside) / 2
            found = np.einsum("pc,cyx->pyx", np.linalg.inv(matrix), (light + middle * chroma) ** 3)
            is_inside = ((found >= 0) & (found <= 1)).all(0)
            inside = np.where(is_inside, middle, inside)
            outside = np.where(is_inside, outside, middle)
        mapped = np.einsum("pc,cyx->pyx", np.linalg.inv(matrix), (light + inside * chroma) ** 3)
        stays = ((rgb >= 0) & (rgb <= 1)).all(0) | ~np.isfinite(rgb.sum(0))
        return np.where(stays, rgb, np.clip(mapped, 0, 1))

"""Rings of a lens beyond the tiles that blur a frame: what these add on their wrong side, computed in some of them.

A transform repeats a tile: light that is `overlap` samples or more from a pixel of its result is seen where the tile
repeats itself, not where it is. A lens spreads so far, beside its tail, waves (`gpusim.planner.knobs.waves`). What the
tail has more than the Gaussians that stand for it is seen there, too. Windows of the picture twice as wide as a tile,
blurred by both, tell what that adds.
"""

from math import pi, sqrt

import numpy as np
import scipy

from gpusim.optics.ladder import POWERS, energies
from gpusim.optics.outside import WINDOW, Outside
from gpusim.optics.tiling import Tiling
from gpusim.optics.windows import quantile
from gpusim.planner.knobs.farfield import FarField
from gpusim.planner.knobs.waves import waves
from gpusim.planner.question import Question

HOT = 3.0  # true over predicted error beside few bright points was up to 3.1: their rings end in few tiles


def ring_errors(
    outside: Outside, question: Question, tiling: Tiling, far: FarField
) -> tuple[float, float, float]:
    """Relative root mean square error of a frame by such tiles; its 99.9 % quantile and maximum in noise.

    far: what tiles leave to Gaussians. The last two figures are as `Outside.error` gives them.
    """
    if not outside.level > 0:
        return 0.0, 0.0, 0.0
    side, valid = tiling.side, tiling.valid
    (windows, light), table = outside.windows(valid), _beyond(question, tiling, far)
    part, rim = slice(WINDOW // 2 - side, WINDOW // 2 + side), side - valid // 2
    light = light[:, part, part]
    within = slice(side // 2, side // 2 + side)
    error = np.abs(
        _middle(light, table, valid) - _middle(light[:, within, within], table[:, ::2, ::2], valid)
    )
    rows, cols = (
        min(n - 2 * outside.margin, valid) for n in outside.image.shape
    )  # of a narrow frame all
    error = error[..., :rows, :cols] / outside.level * (HOT if outside.is_spiky else 1)
    local = scipy.ndimage.uniform_filter(light, (0, 2 * outside.around + 1, 2 * outside.around + 1))
    local = local[:, rim : rim + rows, rim : rim + cols]
    sigma = error / np.sqrt(np.maximum(local / outside.level, 0) + outside.noise)[:, None]
    weight = windows.weight[:, None] * question.share
    return (
        sqrt(float((weight * np.mean(error**2, axis=(2, 3))).sum())),
        quantile(sigma, weight, 0.999),
        float(sigma.max() * windows.steepest),
    )


def _middle(light, table, valid):
    """The middles, (n, C, valid, valid), of windows (n, side, side) blurred by tables (C, side, side // 2 + 1)."""
    side = light.shape[-1]
    inner = slice((side - valid) // 2, (side + valid) // 2)
    spectra = scipy.fft.rfft2(light, workers=-1)[:, None] * table
    rows = scipy.fft.ifft(spectra, axis=2, workers=-1, overwrite_x=True)[
        :, :, inner
    ]  # the others are not asked for
    return scipy.fft.irfft(rows, side, workers=-1)[..., inner]


def _beyond(question, tiling, far):
    """Transforms of what a tile holds of points outside its overlap, at a period twice its side, by channels."""
    side, optics = tiling.side, question.optics
    of = (
        optics,
        question.scene.wavelengths,
        question.q,
        question.cell,
        question.aperture,
        question.ratio,
    )
    held = question.kept(
        f"held by tiles of {side} that share {tiling.overlap}",
        (*of, far.sigmas, far.tails),
        lambda: _held(question, tiling, far),
    )
    quarter = (question.edges.astype(np.float32) @ held.reshape(len(held), -1)).reshape(
        -1, side, side
    )
    at = np.abs(np.arange(-side, side))
    whole = np.pad(quarter, [(0, 0), (0, 1), (0, 1)])[
        :, at[:, None], at
    ]  # as far as the windows see, a side away
    return scipy.fft.rfft2(scipy.fft.ifftshift(whole, axes=(1, 2)))


def _held(question, tiling, far):
    """What a tile holds of a point at its places below and right of it, by wavelength: float32 (L, side, side)."""
    y, x = np.indices((tiling.side, tiling.side), float)
    r = np.maximum(np.hypot(y, x), 1)
    rings = waves(question, r, y / r, x / r)
    widths, outer = far.sigmas[:-1, None], np.maximum(*np.indices(r.shape)) >= tiling.overlap
    held = np.zeros(rings.shape, np.float32)
    held[:, outer] = (
        rings[:, outer]
        + far.tails @ r[outer] ** -np.array(POWERS)[:, None]
        - (
            energies(far.sigmas, far.tails)[:, :-1]
            @ (np.exp(-((r[outer] / widths) ** 2) / 2) / (2 * pi * widths**2))
        )
    )
    return held

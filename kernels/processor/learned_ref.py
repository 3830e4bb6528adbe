"""Local, linear, learned demosaicking, float64: a filter per position, class and level.

The decision (Lansel and Wandell 2011, "Local linear learned image processing pipeline", Imaging
Systems and Applications; Tian et al. 2014, Proc. SPIE 9023): A and B are sums over a box of
|contrast| along rows and columns,

    direction = number of ratios r with A + e > r (B + e)  less  number with B + e > r (A + e),
    strength = number of bounds below A + B,
    share = number of ratios r with min(A, B) + e > r (min(P, Q) + e), P and Q as A and B for the detail.

All of it is done on whole numbers: |contrasts|, rounded to DN or to 1/256 sqrt(DN). A pixel's class
is then the same on every device; roots are float32 roots for the same reason.

With `balance` the codes of red and blue are multiplied by its roots, and the results are divided by
them. The variance of a code is then v f^2 at a sample of factor f, and the variance of a filter's
output, over v, is S = sum w^2 f^2. The square of the output lacks (1 - S) of the loss of a mean of
many (see levels.py).
"""

import numpy as np

from gpusim.domain.guided import GuidedTable
from gpusim.domain.learned import Code, Layout
from gpusim.io.camera.learned import bayer_table
from gpusim.kernels.processor.bilinear_ref import bilinear
from gpusim.kernels.processor.levels import root_loss

STEPS = {"root": 256.0, "linear": 1.0}  # whole numbers per unit of code


def learned(
    raw, *, phase, black_level, scale, domain=None, noise=(0.0, 0.0), table=None, balance=(1.0, 1.0)
):
    """Return the stage's result, see `learned.py`."""
    layout = (table or bayer_table()).layout
    if 1 in raw.shape and layout.mosaic == ("RG", "GB") and layout.outputs == ("R", "G", "B"):
        return bilinear(raw, phase=phase, black_level=black_level, scale=scale)
    code = Code(domain or layout.domain, black_level, scale, noise, tuple(balance))
    shift = layout.shift(phase)
    filters, offsets, floor, strengths = (table or bayer_table()).at_noise(code.sigma)
    places = positions(layout, raw.shape, shift)
    factor = np.array([code.factors.get(letter, 1.0) for letter in "".join(layout.mosaic)])
    codes = code.encode_raw(raw, factor[places])
    classes, levels = classify(codes, code, layout, floor, strengths)
    sums = sum_groups(codes, layout)
    own = np.array([code.factors.get(name, 1.0) for name in layout.outputs])[:, None, None]
    unbiased = code.domain == "root" and noise[0] > 0 and offsets is None
    power = sum_groups(np.broadcast_to(factor[places] ** 2, raw.shape), layout)

    out, kept = np.zeros((2, len(layout.outputs), *raw.shape))
    for at, weight in hats(levels, layout.levels):
        # (rows, cols, outputs, G)
        chosen = filters.astype(np.float32).astype(np.float64)[at, places, classes]
        result = np.einsum("yxog,gyx->oyx", chosen, sums)
        if offsets is not None:
            result += np.moveaxis(
                offsets.astype(np.float32)[at, places, classes], 2, 0
            ) * np.float64(code.white)
        out += weight * result / own
        kept += weight * np.einsum("yxog,gyx->oyx", chosen**2, power) / own**2
    signal = code.decode(out)
    if unbiased:
        near, far, *terms = root_loss(*noise).astype(np.float64)
        signal += (1 - kept) * np.polyval(
            terms, np.minimum(1, far / (near + (out + np.sqrt(code.offset)) ** 2))
        )
    return signal * scale


def positions(layout: Layout | GuidedTable, shape, shift=(0, 0)):
    """Return the number of each pixel's position in the mosaic's period, shape (rows, cols)."""
    rows, cols = (
        (np.arange(n) + first) % period
        for n, first, period in zip(shape, shift, layout.period, strict=True)
    )
    return np.add.outer(rows * layout.period[1], cols)


def extend_plane(plane, layout: Layout | GuidedTable, reach):
    """Return the plane with `reach` more pixels on every side, in the colours of their places.

    It is mirrored for periods of 1 and 2, else a period is repeated.
    """
    for axis, period in enumerate(layout.period):
        n = plane.shape[axis]
        if period <= 2:
            plane = np.pad(
                plane, [(reach, reach) if a == axis else (0, 0) for a in range(2)], mode="reflect"
            )
        else:
            i = np.arange(-reach, n + reach)
            i = np.where(i < 0, i % period, np.where(i >= n, n - period + (i - n) % period, i))
            plane = plane.take(i, axis)
    return plane


def sum_groups(codes, layout: Layout):
    """Return sums of the codes of each group of taps, shape (G, rows, cols)."""
    reach = int(abs(layout.taps).max())
    wide = extend_plane(codes, layout, reach)
    rows, cols = codes.shape
    sums = np.zeros((layout.shape[-1], rows, cols))
    for (dy, dx), group in zip(layout.taps + reach, layout.groups, strict=True):
        sums[group] += wide[dy : dy + rows, dx : dx + cols]
    return sums


def classify(codes, code: Code, layout: Layout, floor, strengths):
    """Return each pixel's class, and the mean code around it over white, (rows, cols) each.

    floor, strengths: relative to white, for this frame's noise.
    """

    def sum_box(plane):
        return box_sums(np.floor(plane * STEPS[code.domain] + 0.5), layout)

    columns, rows = (
        sum_box(np.abs(directional(codes, layout, axis, layout.contrast))) for axis in range(2)
    )
    unit = STEPS[code.domain] * code.white * (2 * layout.box + 1) ** 2
    e = np.floor(min(floor * layout.weight / 2 * unit, 2.0**19))  # so all numbers stay below 2^31
    bounds = np.floor(np.minimum(strengths * layout.weight * unit, 2.0**27))
    ratios = layout.ratios[:, None, None]
    direction = (8 * rows > ratios * columns + (ratios - 8) * e).sum(axis=0) - (
        8 * columns > ratios * rows + (ratios - 8) * e
    ).sum(axis=0)
    classes = (direction + len(ratios)) * (len(bounds) + 1) + (
        rows + columns > bounds[:, None, None]
    ).sum(axis=0)
    if layout.detail is not None:
        least = np.minimum(
            *(sum_box(np.abs(directional(codes, layout, axis, layout.detail))) for axis in range(2))
        )
        ratios = layout.shares[:, None, None]
        share = (8 * np.minimum(rows, columns) > ratios * least + (ratios - 8) * e).sum(axis=0)
        classes = classes * (len(ratios) + 1) + share
    return classes, sum_box(extend_plane(codes, layout, layout.box)) / unit


def directional(codes, layout: Layout, axis, weights):
    """Return contrast or detail along `axis`, on the frame and the box's reach around it."""
    reach = len(weights[axis]) // 2
    wide = extend_plane(codes, layout, reach + layout.box)
    rows, cols = (n + 2 * layout.box for n in codes.shape)
    out = np.zeros((rows, cols))
    for k, weight in enumerate(weights[axis]):
        dy, dx = (k, reach) if axis == 0 else (reach, k)
        out += weight * wide[dy : dy + rows, dx : dx + cols]
    return out


def box_sums(wide, layout: Layout):
    """Return sums over (2 box + 1)^2 pixels; the plane is wider than the frame by `box`."""
    n = 2 * layout.box + 1
    down = np.lib.stride_tricks.sliding_window_view(wide, n, axis=0).sum(axis=-1)
    return np.lib.stride_tricks.sliding_window_view(down, n, axis=1).sum(axis=-1)


def hats(levels, knots):
    """Yield (number of a level, its weight at every pixel): linear between neighbouring levels."""
    if len(knots) == 1:
        yield 0, 1.0
        return
    for k in range(len(knots)):
        yield k, np.interp(levels, knots, np.eye(len(knots))[k])

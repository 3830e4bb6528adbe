"""Filters chosen on a first picture, float64; everything that decides is whole numbers.

The codes q are whole numbers of steps. The first picture is, at a pixel of position p,

    E_o = floor((sum over taps t of w[p, o, t] q[t] + 1024) / 2048)   of each channel o.

With g the guide (see `gpusim.domain.guided`), Y = E_g + sum over all o of E_o, and A, B, C, D the
sums over a box of |Y(+1) - Y(-1)| along rows, along columns and along the two diagonals,

    direction = number of ratios r with A + e > r (B + e)  less  number with B + e > r (A + e),

the same of C and D for the diagonal, and strength = number of bounds below A + B. With T the sum
over the box of |E_o - E_g| of the other channels o, differences between +1 and -1 as above along rows and columns,

    share = number of ratios s with 2 T + e > s (A + B + e).

The result is a
filter of the codes and the first picture near the pixel, by position and class. The classes are in
the manner of Romano, Isidoro and Milanfar 2017, "RAISR", IEEE Trans. Computational Imaging 3, 110,
with sums of absolute differences, which are exact, in place of a structure tensor.

Balance and the loss of the square are as in learned_ref.py.
"""

import numpy as np

from gpusim.domain.guided import (
    FINEST_FIRST,
    LARGEST,
    GuidedTable,
    MosaicCode,
    diamond,
    steps_of,
)
from gpusim.domain.learned import Code
from gpusim.kernels.processor.learned_ref import extend_plane, positions
from gpusim.kernels.processor.levels import root_loss

WAYS = ((0, 1), (1, 0), (1, 1), (1, -1))  # along rows, columns, falling and rising diagonals


def guided(
    raw,
    *,
    phase,
    black_level,
    scale,
    table,
    domain="root",
    noise=(0.0, 0.0),
    balance=None,
    channels=None,
):
    """Return the stage's result, see `guided.py`."""
    balances = tuple((balance or {}).items())
    code = MosaicCode(domain, black_level, scale, noise, mosaic=table.mosaic, balances=balances)
    shift = table.shift(phase)
    first, second, floor, strengths = table.at_noise(code.sigma)
    whole = codes_of(raw, code, table, shift)
    pictures = first_picture(whole, first, table, shift)
    places = positions(table, raw.shape, shift)
    classes = classify(pictures, code, table, floor, strengths)
    terms = terms_of(whole, pictures, table)
    weights = second.astype(np.float32).astype(np.float64)[places, classes]
    own = np.array([code.factors[letter] for letter in table.channels])[:, None, None]
    out = np.einsum("yxot,tyx->oyx", weights, np.stack(terms)) / steps_of(code) / own
    signal = code.decode(out)
    if code.domain == "root" and noise[0] > 0:
        near, far, *rest = root_loss(*noise).astype(np.float64)
        kept = left_noise(table, code, first, second)[places, classes]
        at = np.minimum(1, far / (near + (out + np.sqrt(code.offset)) ** 2))
        signal += (1 - np.moveaxis(kept, 2, 0)) * np.polyval(rest, at)
    order = [table.channels.index(letter) for letter in channels or table.channels]
    return signal[order] * scale


def codes_of(raw, code: Code, table: GuidedTable, shift):
    """Return whole numbers of the codes, wider than the frame by the table's reach, int64."""
    factors = np.array([code.factors[letter] for letter in "".join(table.mosaic)], np.float32)
    factor = factors[positions(table, raw.shape, shift)]
    value = np.asarray(raw, np.float32)
    if code.domain == "linear":
        value = value + np.float32(-code.black_level)
    else:
        value = value + np.float32(code.offset - code.black_level)
        value = np.copysign(np.sqrt(np.abs(value)), value) - np.float32(np.sqrt(code.offset))
    whole = np.floor(value * factor * np.float32(steps_of(code)) + np.float32(0.5))
    return extend_plane(np.clip(whole, -LARGEST, LARGEST).astype(np.int64), table, sum(table.reach))


def first_picture(whole, first, table: GuidedTable, shift):
    """Return the channels, wider than the frame by the second part of the table's reach, int64."""
    inner, outer = table.reach
    rows, cols = (n - 2 * inner for n in whole.shape)
    down, right = table.period
    places = positions(table, (down, right), [s - outer for s in shift])
    out = np.full((len(table.channels), rows, cols), FINEST_FIRST // 2, np.int64)
    for y, x in np.ndindex(down, right):
        weights = first[places[y, x]]
        for at, (dy, dx) in enumerate(diamond(table.radii[0]) + inner):
            codes = whole[y + dy : dy + rows : down, x + dx : dx + cols : right]
            out[:, y::down, x::right] += weights[:, at, None, None] * codes
    return out // FINEST_FIRST


def classify(pictures, code: Code, table: GuidedTable, floor, strengths):
    """Return each pixel's class, (rows, cols). floor, strengths: relative to white."""
    unit = table.lights * steps_of(code) * code.white * (2 * table.box + 1) ** 2
    e = np.floor(floor * unit)
    bounds = np.floor(2 * np.asarray(strengths) * unit)
    guide, light = pictures[table.guide], light_of(pictures, table)
    across, down, falling, rising = (contrast(light, table, *way) for way in WAYS)
    others = np.delete(pictures, table.guide, axis=0) - guide
    tint = sum(contrast(plane, table, *way) for plane in others for way in WAYS[:2])
    direction = _compare(across, down, table.ratios, e)
    diagonal = _compare(falling, rising, table.diagonals, e)
    strength = (across + down > bounds[:, None, None]).sum(axis=0)
    shares = table.shares[:, None, None]
    share = (16 * tint > shares * (across + down) + (shares - 8) * e).sum(axis=0)
    return np.ravel_multi_index((direction, diagonal, share, strength), table.kinds)


def light_of(pictures, table: GuidedTable):
    """Return the light of a first picture: all channels, the guide twice."""
    return pictures.sum(axis=0) + pictures[table.guide]


def contrast(plane, table: GuidedTable, dy, dx):
    """Return sums over the box of |differences| between (dy, dx) ahead and behind, int64."""
    reach, n = table.reach[1], 2 * table.box + 1
    rows, cols = (size - 2 * reach + n - 1 for size in plane.shape)
    start = reach - table.box
    ahead, behind = (
        plane[start + s * dy :][:rows, start + s * dx : start + s * dx + cols] for s in (1, -1)
    )
    parts = np.abs(ahead - behind)
    parts = np.lib.stride_tricks.sliding_window_view(parts, n, axis=0).sum(axis=-1)
    return np.lib.stride_tricks.sliding_window_view(parts, n, axis=1).sum(axis=-1)


def _compare(one, two, ratios, e):
    ratios = ratios[:, None, None]
    more = (ratios - 8) * e
    above = (8 * one > ratios * two + more).sum(axis=0)
    return len(ratios) + above - (8 * two > ratios * one + more).sum(axis=0)


def terms_of(whole, pictures, table: GuidedTable):
    """Return the inputs of the second filters, a list of planes (rows, cols)."""
    inner, outer = table.reach
    rows, cols = (n - 2 * (inner + outer) for n in whole.shape)
    out = [
        whole[dy : dy + rows, dx : dx + cols] for dy, dx in diamond(table.radii[1]) + inner + outer
    ]
    for plane in pictures:
        out += [plane[dy : dy + rows, dx : dx + cols] for dy, dx in diamond(table.radii[2]) + outer]
    return out


def left_noise(table: GuidedTable, code: Code, first, second):
    """Return the variance of the results over that of an unbalanced code, shape (P, K, C).

    Codes have independent noise of variance v f^2, and the first picture is made of codes.
    """
    rows, cols = table.period
    reach = max(table.radii[1], table.radii[0] + table.radii[2])
    n = 2 * reach + 1
    factor = np.array([[code.factors[letter] for letter in text] for text in table.mosaic])
    own = np.array([code.factors[letter] for letter in table.channels])
    taps = [diamond(radius) for radius in table.radii]
    out = []
    for p, weights in enumerate(second):
        y, x = divmod(p, cols)
        made = np.zeros((second.shape[-1], n, n))
        for at, (dy, dx) in enumerate(taps[1]):
            made[at, dy + reach, dx + reach] = 1
        for c in range(len(table.channels)):
            for at, (dy, dx) in enumerate(taps[2]):
                term = made[len(taps[1]) + c * len(taps[2]) + at]
                filters = first[(y + dy) % rows * cols + (x + dx) % cols, c] / FINEST_FIRST
                term[tuple((taps[0] + (dy + reach, dx + reach)).T)] = filters
        around = np.arange(-reach, reach + 1)
        factors = factor[np.ix_((y + around) % rows, (x + around) % cols)]
        total = np.tensordot(weights, made * factors, 1)
        out.append((total**2).sum(axis=(-2, -1)) / own**2)
    return np.array(out)

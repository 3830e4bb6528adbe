"""Samples of a filter and classes of pixels for any mosaic, chosen by measurements."""

import numpy as np

from gpusim.domain.learned import LARGEST_SUM, Layout

RATIOS = (10, 16, 32)  # eighths: 7 directions
# Mean contrast between the 5 strengths, relative to white: of clean pictures, and as multiples of
# the code's noise.
CLEAN = np.array((1.0, 2.8, 7.0, 17.0)) / 255
NOISY = np.array((0.8, 0.9, 1.05, 1.6))
HAMILTON_ADAMS = (1, -2, 1, 0, -1, 2, -1)
OWN_COLOR = (2, 0, -4, 0, 2)
SHARES = (5, 7, 10, 16)  # eighths of contrast / detail, with these two


def layout(
    mosaic, outputs, domain="root", noise=(0.0,), levels=(0.0,), radius=None, box=None
) -> Layout:
    """Return the layout for a mosaic.

    mosaic: one period, a text per row. outputs, domain, noise, levels: as in `Layout`. radius: taps
    are the samples with |dy| + |dx| <= radius [pixel], 4 by default and 5 for periods above 4. box:
    as in `Layout`, at least half a period by default. Periods of 1 and 2: taps that are mirror
    images of each other share their weight, since the mosaic is its own mirror image. Period 2 x 2:
    contrast is Hamilton & Adams' colour difference, between -1 and +1 pixel, and detail the second
    difference of samples of one colour. Others: contrast is the difference of samples a period
    apart, the nearest of the same colour everywhere. Raises BadData.
    """
    rows, cols = len(mosaic), len(mosaic[0])
    longest = max(rows, cols)
    radius = radius or (4 if longest <= 4 else 5)
    dy, dx = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    taps = np.stack([dy, dx], axis=-1)[abs(dy) + abs(dx) <= radius]
    groups = np.arange(len(taps))
    if longest <= 2:
        groups = np.unique(abs(taps), axis=0, return_inverse=True)[1]
    pairs = rows == cols == 2
    contrast = [np.array(HAMILTON_ADAMS if pairs else difference(n)) for n in (rows, cols)]
    largest = int(np.sqrt(LARGEST_SUM / np.abs(contrast[0]).sum()) - 1) // 2
    box = min(max(2, longest // 2), largest) if box is None else box
    sums = np.abs(contrast[0]).sum() / 2
    # of noise, in units of Hamilton & Adams'
    gain = np.sqrt(np.square(contrast[0]).sum()) / sums / (np.sqrt(12) / 4)
    sigma = np.asarray(noise, float)
    floor = np.hypot(0.5 / 255, gain * sigma)
    strengths = np.hypot(CLEAN, np.multiply.outer(gain * sigma, NOISY))
    detail = (np.array(OWN_COLOR), np.array(OWN_COLOR)) if pairs else None
    return Layout(
        tuple(mosaic),
        tuple(outputs),
        domain,
        taps,
        groups.ravel(),
        (contrast[0], contrast[1]),
        box,
        np.array(RATIOS),
        sigma,
        floor,
        strengths,
        np.array(levels),
        detail,
        np.array(SHARES if pairs else ()),
    )


def difference(period):
    """Weights 1 .. -1 of two samples an even number of pixels apart, a multiple of the period."""
    apart = period if period % 2 == 0 else 2 * period
    return (1, *(0,) * (apart - 1), -1)

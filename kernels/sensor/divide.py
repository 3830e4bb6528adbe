"""Dual pixels: each pixel's electrons are divided between the photodiodes under its microlens.

Ports: whole (rows, cols) float32 [e-], parts (n, rows, cols) float32 [e-], shares (n, sh, sw) float32 -> diodes
(n + 1, rows, cols) float32 [e-]:

    diodes[k] = min(max(0, shares[k, y mod sh, x mod sw] parts[k]), left[k]),   diodes[n] = left[n],
    left[0] = whole,   left[k + 1] = left[k] - diodes[k].

A part is what a lens that shows all light as diode k sees it would give. The diodes add up to the whole pixel, and none
is below 0.
"""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import Array, Case, stage


@stage
def divide(device: Device, whole: Array, parts: Array, shares: Array) -> Array:
    """Return the mean electrons of every photodiode.

    Args:
        whole: Mean electrons of the pixels [e-], shape (rows, cols).
        parts: Mean electrons of all light as each diode but the last sees it [e-], shape (n, rows, cols).
        shares: Share of each of these diodes in the light, shape (n, sh, sw), repeated over the frame.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Mean electrons [e-], shape (n + 1, rows, cols), float32.
    """
    count, rows, cols = parts.shape
    whole, parts, shares = (device.array(one) for one in (whole, parts, shares))
    _, high, wide = shares.shape
    diodes = device.empty((count + 1, rows, cols))
    device.launch(
        "sensor.divide",
        "divide",
        (rows, cols),
        whole,
        parts,
        shares,
        diodes,
        count,
        rows,
        cols,
        high,
        wide,
    )
    return diodes


def cases():
    """Yield cases: one and three parts, shares that repeat, parts above the whole and below 0."""
    random = np.random.default_rng(5)
    why = (
        "a product and up to three differences of numbers below the whole, each rounded to half an ulp of it: below "
        "3 ulp of the largest pixel"
    )
    for count, rows, cols, period in (
        (1, 1, 1, (1, 1)),
        (1, 33, 65, (2, 2)),
        (3, 17, 30, (17, 30)),
    ):
        whole = random.uniform(0, 1000, (rows, cols)).astype(np.float32)
        parts = (whole * random.uniform(-0.2, 2.5, (count, rows, cols))).astype(np.float32)
        shares = random.uniform(0.2, 0.6, (count, *period)).astype(np.float32)
        inputs = {"whole": whole, "parts": parts, "shares": shares}
        yield Case(f"{rows}x{cols}, {count} parts", inputs, 3 * 2.0**-23, why)


def bench(rows, cols):
    """Return inputs: two diodes."""
    whole = np.random.default_rng(5).uniform(0, 1000, (rows, cols)).astype(np.float32)
    return {"whole": whole, "parts": whole[None], "shares": np.full((1, 1, 1), 0.5, np.float32)}

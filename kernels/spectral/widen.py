"""float32 of float16 samples, exactly: what a cube of half the size is widened to where a stage takes float32 alone.

Ports: content (entries, rows, cols) float16, chosen rows (n,) int32 -> (entries, n, cols) float32. Every float16 is a
float32, denormals and infinities included; NaN stays NaN.
"""

import numpy as np

from gpusim.kernels.stage import Case, stage


@stage
def widen(device, content, chosen=None):
    """Float16 samples as float32.

    content: float16, shape (entries, rows, cols). chosen: int32, shape (n,), rows to widen, clipped to the frame; by
    default all in their order.
    Returns shape (entries, n, cols).
    """
    entries, rows, cols = content.shape
    content = device.array(content, np.float16)
    chosen = device.array(np.arange(rows) if chosen is None else chosen, np.int32)
    count = chosen.shape[0]
    out = device.empty((entries, count, cols))
    device.launch("spectral.widen", "widen", (entries * count, cols), content, chosen, out, entries * count, count,
                  rows, cols)
    return out


def cases():
    """Every float16 there is, odd sizes, rows beyond the frame and twice."""
    every = np.arange(2**16, dtype=np.uint16).view(np.float16)
    why = "every float16 is a float32"
    yield Case("every float16", {"content": every.reshape(4, 64, 256)}, 0.0, why, metric="exact")
    random = np.random.default_rng(5)
    for entries, rows, cols, chosen in ((1, 1, 1, None), (3, 5, 9, [-1, 0, 4, 5, 9, 2, 2]), (31, 33, 65, None),
                                        (2, 7, 129, [6]), (2, 3, 4, [])):
        content = random.normal(0, 1, (entries, rows, cols)).astype(np.float16)
        yield Case(f"{entries}x{rows}x{cols}, rows {chosen or 'all'}",
                   {"content": content, "chosen": None if chosen is None else np.array(chosen, np.int32)}, 0.0, why,
                   metric="exact")


def bench(rows, cols):
    """A 31-band cube."""
    return {"content": np.random.default_rng(5).random((31, rows, cols), np.float32).astype(np.float16)}

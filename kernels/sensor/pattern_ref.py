"""Fixed patterns in float32; the order of operations is the specification, as in `noise_ref`."""

import numpy as np

from gpusim.kernels.common.exact_ref import TWO_TO_MINUS_32, f32, log, normal_pair
from gpusim.kernels.common.philox_ref import chance_word, philox, seed_words

PIXEL, ROW, COLUMN = 1, 2, 3  # random streams
PLANES = ("response", "offset", "dark", "telegraph")


def pattern(
    rows,
    cols,
    plane,
    *,
    mean=0.0,
    pixel=0.0,
    row=0.0,
    column=0.0,
    dead=0.0,
    share=0.0,
    scale=0.0,
    seed=0,
    first=(0, 0),
    frame_cols=None,
):
    """Return the stage's result, see `pattern.py`."""
    y, x = (np.arange(n) + start for n, start in zip((rows, cols), first, strict=True))
    places = (y[:, None] * (frame_cols or first[1] + cols) + x).astype(np.uint32)
    key, draw = seed_words(seed), PLANES.index(plane)

    def normal(counter, stream):
        return normal_pair(*philox((counter.astype(np.uint32), draw, 0, stream), key)[:2])[0]

    words = philox((places, draw, 0, PIXEL), key)
    value = f32(mean) + f32(pixel) * normal_pair(*words[:2])[0]
    value = value + f32(row) * normal(y, ROW)[:, None]
    value = value + f32(column) * normal(x, COLUMN)
    if dead:
        value = np.where(words[2] <= chance_word(dead), f32(0), value)
    if share:
        more = f32(scale) * -log((words[3].astype(f32) + f32(0.5)) * TWO_TO_MINUS_32)
        chosen = philox((places, draw, 1, PIXEL), key)[0] <= chance_word(share)
        value = np.where(chosen, value + more, value)
    return value

"""Photon, dark, read, reset, line and telegraph noise, saturation, analog-digital converter.

This reference computes in float32, unlike the others. Digital numbers must agree bit for bit on all
devices, so the order of correctly rounded float32 operations written here *is* the specification.
It is tested against probability theory (tests/stages/test_noise.py), not against a more precise
computation.
"""

import numpy as np

from gpusim.kernels.common.exact64_ref import uniform as uniform64
from gpusim.kernels.common.exact_ref import f32, normal_pair, uniform
from gpusim.kernels.common.philox_ref import chance_word, philox, seed_words
from gpusim.kernels.common.poisson_ref import poisson, poisson_exact
from gpusim.kernels.sensor.noise import check, check_drawn, checked_tile

MOST_EXPECTED = f32(1e30)  # in place of infinity: avoids inf - inf
TEMPORAL, TELEGRAPH, ROW, COLUMN = 0, 4, 5, 6  # random streams; `pattern` has 1 to 3


def noise(
    expected,
    offset=None,
    amplitude=None,
    *,
    dark_electrons=0.0,
    read_noise=0.0,
    row_noise=0.0,
    column_noise=0.0,
    telegraph_switching=1.0,
    full_well,
    gain,
    black_level=0.0,
    white_level=None,
    photon="fast",
    seed=0,
    frame=0,
    frames=None,
    first=(0, 0),
    frame_cols=None,
    read=0,
    electrons=False,
):
    """Return the stage's result, see `noise.py`."""
    check(
        *(full_well, gain, white_level, photon, telegraph_switching, black_level),
        dark_electrons=dark_electrons,
        read_noise=read_noise,
        row_noise=row_noise,
        column_noise=column_noise,
    )
    check_drawn(seed, frame, frames, read)
    expected, key, frame = np.asarray(expected, f32), seed_words(int(seed)), int(frame)
    rows, cols = expected.shape
    frame_cols = checked_tile(cols, first, frame_cols)
    y, x = first[0] + np.arange(rows), first[1] + np.arange(cols)
    pixel = (y[:, None] * frame_cols + x).astype(np.uint32)
    expected = np.where(expected > MOST_EXPECTED, MOST_EXPECTED, expected)
    expected = np.where(expected < 0, f32(0), expected) + f32(dark_electrons)

    def draw(number):
        words = philox((pixel, read, number, TEMPORAL), key)
        z_photon, z_read = normal_pair(*words[:2])
        counted = expected
        if photon == "fast":
            counted = poisson(expected, z_photon, uniform(*words[2:]))
        elif photon == "exact":
            counted = poisson_exact(expected, uniform64(*words[2:]))
        result = np.where(counted > f32(full_well), f32(full_well), counted)
        if read_noise:
            result = result + f32(read_noise) * z_read
        if offset is not None:
            result = result + np.asarray(offset, f32)
        if amplitude is not None:
            size = np.asarray(amplitude, f32)
            result = np.where(
                size > 0,
                result + size * trap_state(pixel, number, telegraph_switching, key),
                result,
            )
        if row_noise or column_noise:
            result = result + line_noise(y, read, number, row_noise, ROW, key)[:, None]
            result = result + line_noise(x, read, number, column_noise, COLUMN, key)
        return result if electrons else convert(result, gain, black_level, white_level)

    results = np.stack([draw((frame + i) % 2**32) for i in range(frames or 1)])
    return results if frames else results[0]


def convert(electrons, gain, black_level, white_level):
    """Return digital numbers, rounded and limited to 0 .. white_level; not so if that is None."""
    level = f32(gain) * electrons + f32(black_level)
    if white_level is None:
        return level
    level = np.where(level > 0, level, f32(0))  # NaN too
    return np.rint(np.where(level < f32(white_level), level, f32(white_level))).astype(np.uint16)


def trap_state(pixel, frame, switching, key):
    """Return the state of each pixel's trap, 0 or 1, from the last frame in which it was drawn.

    The states are a Markov chain over the frames, and yet a frame can be drawn without the others.
    Each frame has one word: its last bit is the state, the other bits decide whether it is drawn.
    """
    state, open_ = np.zeros(pixel.shape, f32), np.ones(pixel.shape, bool)
    while open_.any():
        word = philox((pixel, 0, frame // 4, TELEGRAPH), key)[frame % 4]
        drawn = open_ & ((word >> np.uint32(1) <= chance_word(switching, 31)) | (frame == 0))
        state[drawn] = (word & np.uint32(1))[drawn]
        open_, frame = open_ & ~drawn, frame - 1
    return state


def line_noise(line, read, frame, sigma, stream, key):
    """Return the noise that all pixels of a row, or of a column, have in common."""
    words = philox((line.astype(np.uint32), read, frame, stream), key)
    return f32(sigma) * normal_pair(*words[:2])[0]

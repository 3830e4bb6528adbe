"""Merge of different exposures of one scene to electrons per second, with noise-optimal weights.

Ports: raw (frames, rows, cols) uint16 [DN], in decreasing order of the rate at which a frame is
full (exposures of one gain: from the shortest to the longest) -> rate (rows, cols) float32 [e-
s-1], still a mosaic, without dark level and dark current; noise can make it negative.

With n_i = (raw_i - dark_i) / gain_i the electrons from light in frame i and t_i its time, a pixel
becomes

    rate = sum_i used_i w_i n_i / sum_i used_i w_i t_i,   w_i = t_i / (R t_i + floor_i),

weights inverse to the variance of n_i / t_i: R t_i from photons and floor_i from everything else. R
and used_i, which decide about the weights, come from the pixel's neighbours of the same colour and
not from the pixel itself. With N_i the mean of n_i over the 8 pixels one `period` away,

    used_i = N_i + margin sqrt(N_i + floor_i) <= full_i  and  raw_i < ceiling_i,
    full_i = (ceiling_i - dark_i) / gain_i,
    R = sum_i used_i N_i / sum_i used_i t_i, at least 0 (with the neighbours' condition only).

Weights from the pixel's own values would favour values that happen to be low (0.06 e- too much in
the dark). A frame that is used if the pixel's own value is below full would be used for low values
more often than for high ones: up to 1.5 % of bias at the transition between frames. Weights that
are independent of the pixel's noise leave the mean unchanged. Only the second condition depends on
it; in a flat field it then fails at most once in 1 / Q(margin) times. The first frame, which holds
the largest rate, always counts as used: if it is full, so is the result.
"""

from collections.abc import Sequence

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.processor.merge_ref import merge as reference
from gpusim.kernels.stage import (
    Array,
    Case,
    dtype_name,
    exact_case,
    is_opencl_cpu,
    stage,
    warp_only,
)

MOST_FRAMES = 16
PER_FRAME = ("dark", "gain", "time", "floor", "ceiling")


@stage
def merge(
    device: Device,
    raw: Array,
    *,
    dark: Sequence[float] | np.ndarray,
    gain: Sequence[float] | np.ndarray,
    time: Sequence[float] | np.ndarray,
    floor: Sequence[float] | np.ndarray,
    ceiling: Sequence[float] | np.ndarray,
    photon: bool = True,
    margin: float = 3.2,
    period: tuple[int, int] = (1, 1),
) -> Array:
    """Return electrons per second of every pixel.

    (ceiling - dark) / gain / time, the rate at which a frame is full, must not rise from frame to
    frame. At borders the neighbour on the other side counts twice.

    Args:
        raw: Digital numbers [DN], shape (frames, rows, cols), uint16, 1 to 16 frames.
        dark: Digital number without light, dark current included [DN], shape (frames,).
        gain: Conversion gain [DN/e-], shape (frames,).
        time: Exposure time [s], shape (frames,).
        floor: Variance without light [e-2], > 0, shape (frames,).
        ceiling: Digital number from which on a pixel is full [DN], shape (frames,).
        photon: Whether electrons of light have shot noise.
        margin: A frame is left out if its neighbourhood is closer to full than this [standard
            deviations of a pixel].
        period: Rows and columns of the mosaic's period.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Rates [e- s-1], shape (rows, cols), float32.

    Raises:
        BadData: `raw` is no stack of uint16 frames, or a list does not have one finite number per
            frame.
        OutOfRange: A number is not allowed.

    Source:
        Debevec and Malik 1997, "Recovering high dynamic range radiance maps from photographs";
        Hasinoff, Durand and Freeman 2010, "Noise-optimal capture for high dynamic range
        photography", for the weights.
    """
    table = check_inputs(raw, dark, gain, time, floor, ceiling, margin, period)
    count, rows, cols = raw.shape
    longest = table[2].max()
    table[2] /= longest  # squares of short times would leave float32's range
    table[4] = np.ceil(table[4])
    full = (table[4] - table[0]) / table[1]
    table[1] = 1 / table[1]
    out = device.empty((rows, cols))
    # CPUs do a row per work-item, 8 pixels at once
    rows_alone = is_opencl_cpu(device)
    run, width = (cols, 8) if rows_alone else (1, 1)
    arrays = [device.array(raw, np.uint16), device.array(np.vstack([table, full])), out]
    defines = {"FRAMES": count, "WIDTH": width}
    numbers = [float(margin), float(1 / longest), int(bool(photon)), *map(int, period)]
    sizes = [*((run,) if device.kind == "opencl" else ()), rows, cols, *warp_only(device, count)]
    group = (1, 1) if rows_alone else None
    grid = (rows, -(-cols // run))
    device.launch(
        "processor.merge", "merge", grid, *arrays, *numbers, *sizes, defines=defines, group=group
    )
    return out


def check_inputs(raw, dark, gain, time, floor, ceiling, margin, period):
    """Return the numbers per frame as a float64 table (5, frames). Raise as `merge` does."""
    dtype = dtype_name(raw)
    if len(raw.shape) != 3 or dtype != "uint16" or 0 in raw.shape or raw.shape[0] > MOST_FRAMES:
        raise BadData(
            f"raw: shape {tuple(raw.shape)} of {dtype}, wanted (frames, rows, cols) of uint16, at most "
            f"{MOST_FRAMES} frames"
        )
    table = np.empty((len(PER_FRAME), raw.shape[0]))
    for row, key, values in zip(table, PER_FRAME, (dark, gain, time, floor, ceiling), strict=True):
        values = np.asarray(values, np.float64)
        if values.shape != row.shape or not np.isfinite(values).all():
            raise BadData(
                f"{key}: {values.tolist()}, wanted one finite number for each of {len(row)} frames"
            )
        if key in ("gain", "time", "floor") and not (values > 0).all():
            raise OutOfRange(key, values.tolist(), f"{key} > 0")
        row[:] = values
    largest = (table[4] - table[0]) / table[1] / table[2]
    if not (np.diff(largest) <= 0).all():
        raise OutOfRange(
            "(ceiling - dark) / gain / time",
            f"{largest.tolist()} e-/s",
            "falling from frame to frame",
        )
    if not 0 <= margin <= 100:
        raise OutOfRange("margin", margin, "0 <= margin <= 100")
    if len(period) != 2 or not all(n >= 1 and n == int(n) for n in period):
        raise OutOfRange("period", period, "whole numbers of rows and columns, >= 1")
    return table


def cases():
    """Yield cases.

    One to five frames, mosaics, frames smaller than a period, full and black pixels, edges of
    light.
    """
    random = np.random.default_rng(3)
    why = (
        "in 2^-24: raw and dark round once each (at most 65535 / gain / shortest time), n <= 5 weights, products "
        "and sums 2 n + 12 times the largest rate; no pixel of these is at a threshold"
    )
    for count, rows, cols, period in (
        (1, 1, 1, (1, 1)),
        (2, 3, 2, (2, 2)),
        (3, 33, 61, (2, 2)),
        (3, 9, 130, (6, 6)),
        (5, 16, 40, (1, 1)),
        (2, 7, 8, (4, 8)),
    ):
        time = 0.01 * 4.0 ** np.arange(count)
        # [e- s-1] x 100: the longest frames are full
        light = 2000 * 10 ** random.uniform(-3, 1, (rows, cols))
        light = np.where(np.arange(cols) % 7 < 3, light, 1e4)
        gain, dark = np.full(count, 0.3), 64 + 0.3 * time
        raw = 64 + 0.3 * random.normal(light * time[:, None, None] * 10, 4)
        raw = np.rint(np.clip(raw, 0, 4095)).astype(np.uint16)
        inputs = {
            "raw": raw,
            "dark": dark,
            "gain": gain,
            "time": time,
            "floor": np.full(count, 5.0) + time,
            "ceiling": np.full(count, 4080.0),
            "period": period,
        }
        electrons = np.abs(raw / 0.3).max(axis=(1, 2)) / time
        error = 2.0**-24 * (2 * 4095 / 0.3 / time[0] + (2 * count + 12) * electrons.max())
        peak = np.abs(reference(**inputs)).max()
        yield Case(f"{count} frames {rows}x{cols}, period {period}", inputs, error / peak, why)
        if count == 5:
            inputs = {**inputs, "margin": 0.0}
            yield Case("margin 0", inputs, error / np.abs(reference(**inputs)).max(), why)
    inputs = {
        "dark": np.full(3, 64.0),
        "gain": np.ones(3),
        "time": np.array([1.0, 2.0, 4.0]),
        "floor": np.full(3, 8.0),
        "ceiling": np.full(3, 1000.0),
    }
    yield Case(
        "all full: the shortest",
        {"raw": np.full((3, 5, 9), 1023, np.uint16), **inputs},
        2.0**-22,
        "959 e- in 1 s: one weight, its product, a quotient, the scale",
    )
    raw = np.full((3, 5, 9), 64, np.uint16)
    yield exact_case("black, no photon noise", "64 - 64 is exact", raw=raw, **inputs, photon=False)


def bench(rows, cols):
    """Return inputs: three 10-bit exposures of a Bayer mosaic, two stops apart."""
    random = np.random.default_rng(3)
    time = (1.0, 4.0, 16.0)
    raw = 64 + 2 * random.random((1, rows, cols)) * 50 * np.reshape(time, (3, 1, 1))
    raw += random.normal(0, 2, (3, rows, cols))
    return {
        "raw": np.clip(raw, 0, 1023).astype(np.uint16),
        "dark": [64.0] * 3,
        "gain": [0.16] * 3,
        "time": time,
        "floor": [25.0] * 3,
        "ceiling": [1020.0] * 3,
        "period": (2, 2),
    }

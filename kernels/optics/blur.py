"""Blur of every plane by its own transfer function, summed into channels: the exact form per band.

Ports: planes (planes, rows, cols) float32, tables (groups, planes, ...) float32 [1], mix (channels,
planes) float32 [, base (channels, rows, cols) float32] -> channels (channels, rows, cols) float32:

    e_c = base_c + sum over k of  mix[c, k] (planes_k * kernel_k).

kernel_k is given by its transfer function: tables[0, k] for all channels, or tables[c, k] for each.
A table is a quarter, (period_y // 2 + 1, period_x // 2 + 1), if the kernel is even along both axes
and its transfer function is therefore real. It is a half, (period_y, 2 (period_x // 2 + 1)), real
and imaginary parts side by side, for any other kernel.

The sum is taken in the frequency domain: one transform per plane, one inverse transform per
channel. The scene continues beyond the frame according to `border`, by up to half of the difference
between period and frame. Light from farther away wraps around; the planner reports it as the energy
of the kernel out there.
"""

from functools import lru_cache
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common import fft
from gpusim.kernels.common.cases import displaced_tables, gaussian_tables
from gpusim.kernels.stage import Array, Case, stage, warp_only
from gpusim.optics.lengths import fft_length

BATCH = 8  # planes transformed at once: the sums are read and written once per batch


@stage
def blur(
    device: Device,
    planes: Array,
    tables: Array,
    mix: Array,
    border: str,
    period: tuple[int, int],
    margin: int = 0,
    base: Array | None = None,
) -> Array:
    """Convolve each plane with its kernel and sum per channel.

    Args:
        planes: Light of each plane, shape (planes, rows, cols). A scene that has its own
            surroundings passes them here.
        tables: Transfer functions [1], shape (1 or channels, planes, period[0] // 2 + 1, period[1]
            // 2 + 1), or (1 or channels, planes, period[0], 2 (period[1] // 2 + 1)). Entry (i, j)
            belongs to the frequency (i / period[0], j / period[1]) cycles per pixel.
        mix: Weight of each plane in each channel, shape (channels, planes).
        border: "zero", "edge" or "reflect" (the outermost pixel is repeated).
        period: Transform lengths [pixel], at least (rows, cols).
        margin: Pixels on each side of the planes that are surroundings and not in the result.
        base: Light to add to, shape of the result; None for 0.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Channels, shape (channels, rows - 2 margin, cols - 2 margin), float32.
    """
    count, rows, cols = planes.shape
    planes, tables = device.array(planes), device.array(tables)
    mix = np.asarray(device.numpy(mix), np.float32)  # cut into batches on the host
    sums = None
    for first in range(0, count, BATCH):
        size = min(BATCH, count - first)
        spectra = fft.forward_extended(device, planes, first, size, border, period)
        sums = _add(device, spectra, tables, mix, period, first, sums)
    return _cut(device, sums, (rows, cols), period, margin, base)


def transform(planes: Array, border: str, period: tuple[int, int], device: Device) -> Array:
    """Return the spectra of up to BATCH planes, for `blur_spectra`; arguments as of `blur`."""
    return fft.forward_extended(device, device.array(planes), 0, planes.shape[0], border, period)


def blur_spectra(
    spectra: Array,
    tables: Array,
    mix: Array,
    shape: tuple[int, int],
    period: tuple[int, int],
    margin: int,
    device: Device,
) -> Array:
    """Return the result of `blur` for planes that are already transformed.

    Args:
        spectra: Spectra of the planes, see `transform`.
        tables: Transfer functions, quarters or halves, see `blur`.
        mix: Weight of each plane in each channel, shape (channels, planes).
        shape: Rows and columns of the planes.
        period: Transform lengths [pixel].
        margin: Pixels on each side of the planes that are not in the result.
        device: A `Device`.
    """
    mix = np.asarray(device.numpy(mix), np.float32)
    sums = _add(device, spectra, device.array(tables), mix, period, 0, None)
    return _cut(device, sums, shape, period, margin, None)


def blur_windows(planes: Array, tables: np.ndarray, mix: np.ndarray, device: Device) -> Array:
    """Convolve small pictures, each of which repeats itself, and sum per channel.

    The windows of a plane are below one another in its spectrum: transfer functions that are
    repeated as often serve all of them in one launch.

    Args:
        planes: Light of each plane, shape (planes, windows, rows, cols), float32.
        tables: Transfer functions [1], shape (planes, rows, cols // 2 + 1), real (the same at
            opposite rows) or complex.
        mix: Weight of each plane in each channel, shape (channels, planes).
        device: A `Device`.

    Returns:
        Channels, shape (channels, windows, rows, cols), float32.
    """
    count, windows, rows, cols = planes.shape
    planes, period = device.reshape(planes, (count * windows, rows, cols)), (windows * rows, cols)
    kind = np.complex64 if np.iscomplexobj(tables) else np.float32
    given = np.asarray(tables, kind).tobytes(), tables.shape, np.dtype(kind)
    tables, mix = _repeated(device, *given, windows, cols), np.asarray(mix, np.float32)
    sums: Any = None
    for first in range(0, count, BATCH):
        size, place = min(BATCH, count - first), first * windows
        spectra = fft.forward_extended(device, planes, place, size * windows, "zero", (rows, cols))
        spectra = device.reshape(spectra, (size, period[0], *spectra.shape[2:]))
        sums = _add(device, spectra, tables, mix, period, first, sums)
    sums = device.reshape(sums, (len(mix) * windows, rows, *sums.shape[2:]))
    return device.reshape(fft.inverse(device, sums, cols), (len(mix), windows, rows, cols))


@lru_cache(maxsize=8)
def _repeated(device, values, shape, kind, windows, cols):
    """Return tables for windows below one another, on the device: quarters or halves as `blur` takes them."""
    tables = np.frombuffer(values, kind).reshape(shape)
    count, rows, half = shape
    if kind == np.float32:
        at = np.arange(windows * rows // 2 + 1) % rows
        return device.array(tables[None, :, at])
    tables, back = tables.copy(), -np.arange(rows) % rows
    for own in (
        {0, cols // 2} if cols % 2 == 0 else {0}
    ):  # of real pictures these determine themselves
        tables[:, :, own] = (tables[:, :, own] + tables[:, back, own].conj()) / 2
    tables = np.tile(tables, (1, windows, 1)).view(np.float32)
    return device.array(tables.reshape(1, count, windows * rows, 2 * half))


def _add(device, spectra, tables, mix, period, first, sums):
    """Add spectra of planes from `first` on, times their tables, to the channels' sums; None: nothing yet."""
    (channels, count), size = mix.shape, spectra.shape[0]
    pitch, half = spectra.shape[2], period[1] // 2 + 1
    is_first = sums is None
    if is_first:
        sums = device.empty((channels, period[0], pitch, 2))
    some = device.array(mix[:, first : first + size])
    arrays, grid = [spectra, tables, some, sums], (period[0], half)
    numbers = [int(is_first), first, count, int(tables.shape[0] > 1)]
    sizes = [*warp_only(device, size, channels), period[0], half, pitch]
    defines = {"SIZE": size, "CHANNELS": channels}
    kernel = "accumulate" if tables.shape[3] == half else "accumulate_complex"
    device.launch("optics.blur", kernel, grid, *arrays, *numbers, *sizes, defines=defines)
    return sums


def _cut(device, sums, shape, period, margin, base):
    """Return the channels of their spectra, which are overwritten, without what is around the frame."""
    blurred, before = fft.inverse(device, sums, period[1]), fft.middle(shape, period)
    rows, cols = (n - 2 * margin for n in shape)
    out = device.empty((sums.shape[0], rows, cols))
    arrays = [blurred, out if base is None else device.array(base), out]
    numbers = [int(base is not None), *(n + margin for n in before)]
    device.launch("optics.blur", "crop", out.shape, *arrays, *numbers, *out.shape, *period)
    return out


def cases():
    """Yield cases.

    All borders, shared and own tables, one plane to more than a batch, odd periods, a highlight of
    1e6.
    """
    random = np.random.default_rng(3)
    why = (
        "a float32 transform errs by about 3e-7 of the field's root mean square (numerics: 2.5e-7), and the maximum "
        "over 1e4 pixels is about 4 such sigmas: 1.2e-6 of the peak at most, twice that for two transforms"
    )
    for rows, cols, count, channels, own, border, period, margin in (
        (1, 1, 1, 1, 0, "zero", (1, 1), 0),
        (3, 5, 3, 3, 1, "edge", (9, 15), 0),
        (63, 65, 31, 3, 0, "reflect", (81, 90), 0),
        (63, 65, 10, 4, 1, "zero", (128, 135), 0),
        (20, 30, 9, 1, 0, "edge", (64, 60), 7),
        (4, 4, 2, 3, 0, "reflect", (32, 30), 0),
        (33, 30, 9, 3, 1, "edge", (45, 40), 0),
        (33, 30, 2, 1, 0, "zero", (40, 45), 3),
    ):
        widths = random.uniform(0.5, 3, (channels if own else 1, count, 1, 1))
        tables = gaussian_tables(widths, period)
        if rows == 33:  # kernels that are off their centres: complex tables
            shifts = random.uniform(-2, 2, (2, *widths.shape))
            tables = displaced_tables(widths, shifts, period)
        planes = random.random((count, rows, cols))
        planes[0, rows // 2, cols // 2] = 1e6
        inputs = {
            "planes": planes.astype(np.float32),
            "tables": tables.astype(np.float32),
            "mix": random.random((channels, count)).astype(np.float32),
            "border": border,
            "period": period,
            "margin": margin,
        }
        if own:
            shape = channels, rows - 2 * margin, cols - 2 * margin
            inputs["base"] = random.random(shape, np.float32)
        yield Case(
            f"{rows}x{cols}, {count} planes, {channels} channels, {border}",
            inputs,
            2.4e-6,
            why,
        )


def bench(rows, cols):
    """Return inputs: four planes to three channels, 64 pixels of border."""
    random = np.random.default_rng(3)
    period = (fft_length(rows + 128), fft_length(cols + 128))
    return {
        "planes": random.random((4, rows, cols), np.float32),
        "tables": random.random((3, 4, period[0] // 2 + 1, period[1] // 2 + 1), np.float32),
        "mix": random.random((3, 4), np.float32),
        "border": "edge",
        "period": period,
    }


def operations(planes, tables, mix, border, period, base=None):
    """Count operations.

    Transforms there and back; per frequency each plane times its table, and that times the mix,
    added up.
    """
    frequencies = period[0] * (period[1] // 2 + 1)
    channels, count = mix.shape
    return (count + channels) * fft.operations(period) + frequencies * count * (
        2 * len(tables) + 4 * channels
    )

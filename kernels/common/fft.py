"""Two-dimensional transforms of real planes: scipy.fft for arrays in host memory, else kernels.

A spectrum is float32 of shape (planes, rows, pitch, 2): real and imaginary parts of the columns 0
.. cols // 2, which determine the rest. Values between cols // 2 + 1 and the pitch are scratch.

GPUs transform whole lines in local memory (fft.cl, whose text Warp's CUDA devices run too); a plane
is read and written twice in all. Source: Stockham's self-sorting form (Van Loan, Computational
Frameworks for the Fast Fourier Transform, 1.7).
"""

import functools
import os
from math import prod
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.common.border import BORDERS, extend
from gpusim.optics.lengths import LENGTHS

GROUP = 512  # work-items at most
# of a work-item at most: a group must be able to start; fewer spill (measured on an H200)
REGISTERS = 65536 // GROUP
RADICES = (16, 15, 12, 10, 8, 6, 5, 4, 3, 2)
SECTOR = 4  # complex values that memory moves at once, 32 bytes


def operations(period) -> float:
    """Return nominal operations of a plane's real transform, 2.5 N log2 N, as in FFTW."""
    return 2.5 * prod(period) * np.log2(prod(period))


def pitch_of(device, cols) -> int:
    """Return complex values from row to row of a spectrum: whole sectors on GPUs."""
    half = cols // 2 + 1
    return half if device.on_host else -(-half // SECTOR) * SECTOR


def forward(device: Device, planes: Any) -> Any:
    """Return the spectra of planes, which may be overwritten.

    Args:
        device: The device.
        planes: Planes, shape (planes, rows, cols), float32.

    Returns:
        Spectra, shape (planes, rows, pitch, 2), float32 of the device.
    """
    if device.on_host or room(max(planes.shape[1:])) > device.local_bytes:
        return _host_forward(device, planes)
    return _local_forward(device, planes, 0, planes.shape[0], "zero", planes.shape[1:])


def forward_extended(
    device: Device, planes: Any, first: int, size: int, border: str, period: tuple[int, int]
) -> Any:
    """Return the spectra of planes in the middle of a period, with surroundings; the planes stay.

    Args:
        device: The device.
        planes: Planes, shape (planes, rows, cols), float32.
        first: First of the planes.
        size: Number of planes.
        border: "zero", "edge" or "reflect", for the surroundings.
        period: Lengths of the transform [pixel].

    Returns:
        Spectra, shape (size, period[0], pitch, 2), float32 of the device.
    """
    if device.on_host or room(max(period)) > device.local_bytes:
        before = middle(planes.shape[1:], period)
        return _host_forward(device, extend(device, planes, border, before, period, first, size))
    return _local_forward(device, planes, first, size, border, period)


def middle(shape, period):
    """Return the place (row, column) of a frame's first pixel in the middle of a period."""
    return tuple((length - n) // 2 for length, n in zip(period, shape, strict=True))


def inverse(device: Device, spectra: Any, cols: int) -> Any:
    """Return the planes of spectra, normalised; the spectra are overwritten.

    Args:
        device: The device.
        spectra: Spectra, shape (planes, rows, pitch, 2), float32.
        cols: Columns of the planes.

    Returns:
        Planes, shape (planes, rows, cols), float32 of the device.
    """
    count, rows, pitch, _ = spectra.shape
    if device.on_host or room(max(rows, cols)) > device.local_bytes:
        return _host_inverse(device, spectra, cols)
    _columns(device, spectra, spectra, 0, 1)
    planes = device.empty((count, rows, cols))
    _rows(
        device,
        "rows_inverse",
        spectra,
        planes,
        parameters=(1 / (rows * cols),),
        rows=count * rows,
        sizes=(pitch,),
        length=cols,
        sign=1,
    )
    return planes


def room(length, lines=1) -> int:
    """Return the bytes of local memory of complex lines (ROOM in fft.clh)."""
    padded = length + (length // 16 if length % 128 == 0 else 0)
    return 8 * lines * (-(-padded // 16) * 16 + 4)


def passes(length, lines, sign, step=1) -> str:
    """Return the PASSes of a transform (fft.clh).

    sign: -1 forward, +1 inverse. Roots are those of length x step.
    """
    radices = _radices(length)
    return " ".join(
        f"PASS({radix}, {prod(radices[:n])}, {length}, {lines}, {step}, {sign}.0f)"
        for n, radix in enumerate(radices)
    )


def threads(device, length, lines) -> int:
    """Return the work-items of a group.

    Each makes one transform of the second largest radix; with more work-items, the passes leave
    many idle.
    """
    radix = _radices(length)[:2][-1]
    return min(GROUP, device.group_limit, -(-lines * length // (radix * 32)) * 32)


@functools.cache
def roots(device, length):
    """Return roots of unity exp(2 pi i n / length), float64 rounded once, shape (length, 2)."""
    values = np.exp(2j * np.pi * np.arange(length) / length)
    return device.array(np.stack([values.real, values.imag], axis=-1))


@functools.lru_cache(maxsize=64)
def constant(device, values, shape, dtype=np.float32):
    """Return a cached array of these bytes: a copy would wait for earlier launches."""
    return device.array(np.frombuffer(values, dtype).reshape(shape), dtype)


def roots_text(count) -> str:
    """Return roots of unity exp(2 pi i n / count), as PAIRs between commas."""
    values = np.exp(2j * np.pi * np.arange(count) / count).round(12) + 0.0
    return ", ".join(f"PAIR({value.real:.9f}f, {value.imag:.9f}f)" for value in values)


def _local_forward(device, planes, first, size, border, period):
    """Transform the frame's rows, then columns, which fill in the surroundings as they read."""
    _, rows, cols = planes.shape
    pitch = pitch_of(device, period[1])
    before_y, before_x = middle((rows, cols), period)
    halves = device.empty((size, rows, pitch, 2))
    spectra = device.empty((size, period[0], pitch, 2))
    _rows(
        device,
        "rows_forward",
        planes,
        halves,
        parameters=(first * rows, before_x),
        rows=size * rows,
        sizes=(cols, pitch),
        length=period[1],
        sign=-1,
        border=border,
    )
    _columns(device, halves, spectra, before_y, -1, border)
    return spectra


def _rows(device, kernel, source, target, parameters, rows, sizes, length, sign, border="zero"):
    group = threads(device, length, 1)
    device.launch(
        "common.fft",
        kernel,
        (-(-rows // 2) * group,),  # two rows to a line
        *(source, roots(device, length), target),
        *parameters,
        rows,
        *sizes,
        group=(group,),
        defines=_defines(length, 1, group, sign, border),
    )


def _columns(device, source, target, before, sign, border="zero"):
    (count, rows, pitch, _), length = source.shape, target.shape[1]
    lines = next(n for n in (SECTOR, 2, 1) if room(length, n) <= device.local_bytes)
    group, groups = threads(device, length, lines), pitch // lines
    device.launch(
        "common.fft",
        "columns",
        (count * groups * group,),
        *(source, roots(device, length), target),
        *(before, rows, pitch, groups),
        group=(group,),
        defines=_defines(length, lines, group, sign, border),
    )


def _defines(length, lines, group, sign, border):
    return {
        "BORDER": BORDERS[border],
        "LENGTH": length,
        "LINES": lines,
        "THREADS": group,
        "REGISTERS": REGISTERS,
        "LOCAL_BYTES": room(length, lines),
        "PASSES": passes(length, lines, sign),
    }


def _host_forward(device, planes):
    import scipy.fft

    count, rows, cols = planes.shape
    with device.host_work():
        spectra = scipy.fft.rfft2(device.numpy(planes), workers=os.cpu_count(), overwrite_x=True)
    return device.array(spectra.view(np.float32).reshape(count, rows, cols // 2 + 1, 2))


def _host_inverse(device, spectra, cols):
    import scipy.fft

    with device.host_work():
        values = device.numpy(spectra).view(np.complex64)[..., 0]
        # irfft2 would put the columns into fresh memory, which takes as long as the transforms
        workers = os.cpu_count()
        values = scipy.fft.ifft(values, axis=-2, workers=workers, overwrite_x=True)
        planes = scipy.fft.irfft(values, cols, workers=workers, overwrite_x=True)
    return device.array(planes)


@functools.cache
def _radices(length):
    """Return the fewest radices of this length, the largest as small as possible, falling."""
    if length == 1:
        return (1,)
    best = {1: ()}
    for n in LENGTHS[1:]:
        if length % n:
            continue
        choices = [
            (*best[n // radix], radix) for radix in RADICES if n % radix == 0 and n // radix in best
        ]
        best[n] = min(choices, key=lambda found: (len(found), max(found)))
        if n == length:
            break
    return tuple(sorted(best[length], reverse=True))

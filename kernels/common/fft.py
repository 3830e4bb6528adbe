"""Two-dimensional transforms of real planes: scipy.fft where arrays are in host memory, kernels elsewhere.

A spectrum is float32 of shape (planes, rows, pitch, 2): real and imaginary parts of the columns 0 .. cols // 2, which
determine the rest; what lies between cols // 2 + 1 and the pitch is scratch.

GPUs transform whole lines in local memory (fft.cl, whose text Warp's CUDA devices run too), so that a plane is read and
written twice in all. Source: Stockham's self-sorting form (Van Loan, Computational Frameworks for the Fast Fourier
Transform, 1.7).
"""

import functools
import os
from math import prod

import numpy as np

from gpusim.kernels.common.border import BORDERS, extend
from gpusim.optics.lengths import LENGTHS

GROUP = 512  # work-items at most
REGISTERS = (
    65536 // GROUP
)  # of a work-item at most, so that a group can start; fewer spill (measured on an H200)
RADICES = (16, 15, 12, 10, 8, 6, 5, 4, 3, 2)
SECTOR = 4  # complex values that memory moves at once, 32 bytes


def operations(period) -> float:
    """Nominal multiplications and additions of a plane's real transform, 2.5 N log2 N, as FFTW counts them."""
    return 2.5 * prod(period) * np.log2(prod(period))


def pitch_of(device, cols) -> int:
    """Complex values from one row of a spectrum of `cols` columns to the next: whole sectors on a GPU."""
    half = cols // 2 + 1
    return half if device.on_host else -(-half // SECTOR) * SECTOR


def forward(device, planes):
    """Spectra of `planes` (planes, rows, cols), shape (planes, rows, pitch, 2); `planes` may be overwritten."""
    if device.on_host or room(max(planes.shape[1:])) > device.local_bytes:
        return _host_forward(device, planes)
    return _local_forward(device, planes, 0, planes.shape[0], "zero", planes.shape[1:])


def forward_extended(device, planes, first, size, border, period):
    """The same of planes `first` .. `first + size` in the middle of a period, what is around them as `border` says.

    Returns shape (size, period[0], pitch, 2); `planes` stay.
    """
    if device.on_host or room(max(period)) > device.local_bytes:
        before = middle(planes.shape[1:], period)
        return _host_forward(device, extend(device, planes, border, before, period, first, size))
    return _local_forward(device, planes, first, size, border, period)


def middle(shape, period):
    """Place of a frame's first pixel in the middle of a period, (row, column)."""
    return tuple((length - n) // 2 for length, n in zip(period, shape, strict=True))


def inverse(device, spectra, cols):
    """Planes (planes, rows, cols) whose spectra these are, normalised; `spectra` is overwritten."""
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
        (1 / (rows * cols),),
        count * rows,
        (pitch,),
        cols,
        1,
    )
    return planes


def room(length, lines=1) -> int:
    """Bytes of local memory that complex lines take (ROOM in fft.clh)."""
    padded = length + (length // 16 if length % 128 == 0 else 0)
    return 8 * lines * (-(-padded // 16) * 16 + 4)


def passes(length, lines, sign, step=1) -> str:
    """The PASSes of a transform (fft.clh): sign -1 forward, +1 inverse; roots are those of length x step."""
    radices = _radices(length)
    return " ".join(
        f"PASS({radix}, {prod(radices[:n])}, {length}, {lines}, {step}, {sign}.0f)"
        for n, radix in enumerate(radices)
    )


def threads(device, length, lines) -> int:
    """Work-items of a group: one transform of the second largest radix each, or the passes leave many idle."""
    radix = _radices(length)[:2][-1]
    return min(GROUP, device.group_limit, -(-lines * length // (radix * 32)) * 32)


@functools.cache
def roots(device, length):
    """Roots of unity exp(2 pi i n / length), float64 mathematics rounded once, shape (length, 2)."""
    values = np.exp(2j * np.pi * np.arange(length) / length)
    return device.array(np.stack([values.real, values.imag], axis=-1))


@functools.lru_cache(maxsize=64)
def constant(device, values, shape):
    """Array of these bytes on the device: a copy would wait for all that was launched before."""
    return device.array(np.frombuffer(values, np.float32).reshape(shape))


def roots_text(count) -> str:
    """Roots of unity exp(2 pi i n / count), as PAIRs between commas."""
    values = np.exp(2j * np.pi * np.arange(count) / count).round(12) + 0.0
    return ", ".join(f"PAIR({value.real:.9f}f, {value.imag:.9f}f)" for value in values)


def _local_forward(device, planes, first, size, border, period):
    """Rows first, those of the frame alone: what is above and below is filled in as the columns read."""
    _, rows, cols = planes.shape
    pitch = pitch_of(device, period[1])
    before_y, before_x = middle((rows, cols), period)
    halves, spectra = (
        device.empty((size, rows, pitch, 2)),
        device.empty((size, period[0], pitch, 2)),
    )
    _rows(
        device,
        "rows_forward",
        planes,
        halves,
        (first * rows, before_x),
        size * rows,
        (cols, pitch),
        period[1],
        -1,
        border,
    )
    _columns(device, halves, spectra, before_y, -1, border)
    return spectra


def _rows(device, kernel, source, target, parameters, rows, sizes, length, sign, border="zero"):
    group = threads(device, length, 1)
    device.launch(
        "common.fft",
        kernel,
        (-(-rows // 2) * group,),
        source,
        roots(device, length),
        target,
        *parameters,
        rows,
        *sizes,
        group=(group,),
        defines=_defines(length, 1, group, sign, border),
    )  # two rows to a line


def _columns(device, source, target, before, sign, border="zero"):
    (count, rows, pitch, _), length = source.shape, target.shape[1]
    lines = next(n for n in (SECTOR, 2, 1) if room(length, n) <= device.local_bytes)
    group, groups = threads(device, length, lines), pitch // lines
    device.launch(
        "common.fft",
        "columns",
        (count * groups * group,),
        source,
        roots(device, length),
        target,
        before,
        rows,
        pitch,
        groups,
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
        planes = scipy.fft.irfft2(
            values, (spectra.shape[1], cols), workers=os.cpu_count(), overwrite_x=True
        )
    return device.array(planes)


@functools.cache
def _radices(length):
    """Fewest radices whose product is the length, the largest of them as small as can be, large ones first."""
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

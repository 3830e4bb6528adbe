"""Two-dimensional transforms of real planes: scipy.fft where arrays are in host memory, kernels elsewhere.

A spectrum is float32 of shape (planes, rows, pitch, 2): real and imaginary parts of the columns 0 .. cols // 2, which
determine the rest; what lies between cols // 2 + 1 and the pitch is scratch.

OpenCL GPUs transform a whole line in local memory, so that a plane is read and written twice in all (fft.cl). Warp has
no local memory outside its tiles, whose transform refuses lengths such as 1200: there each radix is a pass through
global memory (fft_warp.py), eight times slower.
"""

import functools
import os
from math import prod

import numpy as np

LOCAL_BYTES = 48 * 1024  # local memory that every GPU of the last ten years gives a group
THREADS = 256
LONGEST = LOCAL_BYTES // 8 * 15 // 16 - 1  # one complex line in local memory, see ROOM in fft.cl
LENGTHS = tuple(sorted(2**a * 3**b * 5**c for a in range(16) for b in range(10) for c in range(7)
                       if 2**a * 3**b * 5**c <= 2**15))


def fft_length(minimum: int) -> int:
    """Smallest length not below `minimum` that is a product of 2, 3 and 5 (up to 32768)."""
    return next(length for length in LENGTHS if length >= minimum)


def forward(device, planes):
    """Spectra of `planes` (planes, rows, cols); `planes` may be overwritten."""
    count, rows, cols = planes.shape
    half = cols // 2 + 1
    if device.kind == "warp" and not device.on_host:
        front = device.empty((count, rows, cols, 2))
        device.launch("common.fft", "complex_from_real", (count, rows, cols), planes, front, count, rows, cols)
        front, back = _passes(device, front, device.empty(front.shape), axis=1, lines=rows, sign=-1)
        return _passes(device, front, back, axis=0, lines=half, sign=-1)[0]
    if device.on_host or max(rows, cols) > LONGEST:
        return _host_forward(device, planes)
    spectra = device.empty((count, rows, half, 2))
    _rows(device, "rows_forward", planes, spectra, -1, (), count * rows, half, cols)
    _columns(device, spectra, -1)
    return spectra


def inverse(device, spectra, cols):
    """Planes (planes, rows, cols) whose spectra these are, normalised; `spectra` is overwritten."""
    count, rows, pitch, _ = spectra.shape
    if device.kind == "warp" and not device.on_host:
        front, back = _passes(device, spectra, device.empty(spectra.shape), axis=0, lines=cols // 2 + 1, sign=1)
        device.launch("common.fft", "mirror", (count, rows, pitch), front, count, rows, pitch)
        front, _ = _passes(device, front, back, axis=1, lines=rows, sign=1)
        planes = device.empty((count, rows, cols))
        device.launch("common.fft", "real_from_complex", (count, rows, cols), front, planes, 1 / (rows * cols),
                      count, rows, cols)
        return planes
    if device.on_host or max(rows, cols) > LONGEST:
        return _host_inverse(device, spectra, cols)
    _columns(device, spectra, 1)
    planes = device.empty((count, rows, cols))
    _rows(device, "rows_inverse", spectra, planes, 1, (1 / (rows * cols),), count * rows, pitch, cols)
    return planes


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
        planes = scipy.fft.irfft2(values, (spectra.shape[1], cols), workers=os.cpu_count(), overwrite_x=True)
    return device.array(planes)


def _rows(device, kernel, source, target, sign, parameters, rows, pitch, length):
    groups = (rows + 1) // 2  # two real rows make one complex line
    device.launch("common.fft", kernel, (groups * THREADS,), source, _roots(device, length, sign), target,
                  *parameters, rows, pitch, group=(THREADS,), defines=_defines(length, 1, sign))


def _columns(device, spectra, sign):
    count, length, pitch, _ = spectra.shape
    # four columns of 8 bytes fill a memory sector
    lines = max(1, min(4, LOCAL_BYTES // (8 * (length + length // 16 + 1))))
    device.launch("common.fft", "columns", (count, -(-pitch // lines) * THREADS), spectra,
                  _roots(device, length, sign), pitch, pitch, group=(1, THREADS), defines=_defines(length, lines, sign))


def _passes(device, front, back, axis, lines, sign):
    """Stockham passes through global memory along one axis; returns (result, scratch).

    A pass of radix R with p = product of the radices before it takes the R inputs n / R apart to p apart; the sums of
    the small transform and the twiddle factors share one table of n roots of unity.
    """
    count, rows, pitch, _ = front.shape
    length = rows if axis == 0 else pitch
    done = 1
    for radix in _radices(length):
        grid = (count, length // radix, lines) if axis == 0 else (count, lines, length // radix)
        device.launch("common.fft", "stockham", grid, front, _roots(device, length, sign), back, radix, done, length,
                      axis)
        front, back = back, front
        done *= radix
    return front, back


@functools.cache
def _roots(device, length, sign):
    """Roots of unity exp(sign 2 pi i n / length), float64 mathematics rounded once, as (length, 2)."""
    roots = np.exp(sign * 2j * np.pi * np.arange(length) / length)
    return device.array(np.stack([roots.real, roots.imag], axis=-1))


def _defines(length, lines, sign):
    passes = _radices(length)
    text = " ".join(f"PASS({radix}, {prod(passes[:n])})" for n, radix in enumerate(passes))
    return {"LENGTH": length, "LINES": lines, "THREADS": THREADS, "SIGN": f"{sign}.0f", "PASSES": text}


def _radices(length):
    radices = []
    for radix in (8, 4, 2, 3, 5):
        while length % radix == 0:
            radices.append(radix)
            length //= radix
    return radices

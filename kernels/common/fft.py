"""Two-dimensional transforms of real planes: scipy.fft where arrays are in host memory, kernels elsewhere.

A spectrum is float32 of shape (planes, rows, pitch, 2): real and imaginary parts of the columns 0 .. cols // 2, which
determine the rest; what lies between cols // 2 + 1 and the pitch is scratch.
"""

import os

import numpy as np

LENGTHS = tuple(sorted(2**a * 3**b * 5**c for a in range(16) for b in range(10) for c in range(7)
                       if 2**a * 3**b * 5**c <= 2**15))


def fft_length(minimum: int) -> int:
    """Smallest length not below `minimum` that is a product of 2, 3 and 5 (up to 32768)."""
    return next(length for length in LENGTHS if length >= minimum)


def forward(device, planes):
    """Spectra of `planes` (planes, rows, cols); `planes` may be overwritten."""
    count, rows, cols = planes.shape
    half = cols // 2 + 1
    if device.on_host:
        import scipy.fft

        with device.host_work():
            spectra = scipy.fft.rfft2(device.numpy(planes), workers=os.cpu_count(), overwrite_x=True)
        return device.array(spectra.view(np.float32).reshape(count, rows, half, 2))
    front, back = device.empty((count, rows, cols, 2)), device.empty((count, rows, cols, 2))
    device.launch("common.fft", "complex_from_real", (count, rows, cols), planes, front, count, rows, cols)
    front, back = _transform(device, front, back, axis=1, lines=rows, sign=-1.0)
    front, back = _transform(device, front, back, axis=0, lines=half, sign=-1.0)
    return front


def inverse(device, spectra, cols):
    """Planes (planes, rows, cols) whose spectra these are, normalised; `spectra` is overwritten."""
    count, rows, pitch, _ = spectra.shape
    half = cols // 2 + 1
    if device.on_host:
        import scipy.fft

        with device.host_work():
            values = device.numpy(spectra).view(np.complex64)[..., 0]
            planes = scipy.fft.irfft2(values, (rows, cols), workers=os.cpu_count(), overwrite_x=True)
        return device.array(planes)
    front, back = _transform(device, spectra, device.empty(spectra.shape), axis=0, lines=half, sign=1.0)
    device.launch("common.fft", "mirror", (count, rows, pitch), front, count, rows, pitch)
    front, back = _transform(device, front, back, axis=1, lines=rows, sign=1.0)
    planes = device.empty((count, rows, cols))
    device.launch("common.fft", "real_from_complex", (count, rows, cols), front, planes, 1 / (rows * cols),
                  count, rows, cols)
    return planes


def _transform(device, front, back, axis, lines, sign):
    """Stockham passes along one axis; returns (result, scratch).

    A pass of radix R with p = product of the radices before it takes the R inputs n / R apart to p apart; the sums of
    the small transform and the twiddle factors share one table of n roots of unity.
    """
    count, rows, pitch, _ = front.shape
    length = rows if axis == 0 else pitch
    roots = np.exp(sign * 2j * np.pi * np.arange(length) / length)
    table = device.array(np.stack([roots.real, roots.imag], axis=-1))
    step, line_step = (pitch, 1) if axis == 0 else (1, pitch)
    done = 1
    for radix in _radices(length):
        grid = (count, length // radix, lines) if axis == 0 else (count, lines, length // radix)
        device.launch("common.fft", "stockham", grid, front, table, back, radix, done, length, step, line_step, axis,
                      *grid, rows * pitch)
        front, back = back, front
        done *= radix
    return front, back


def _radices(length):
    radices = []
    for radix in (4, 2, 3, 5):
        while length % radix == 0:
            radices.append(radix)
            length //= radix
    return radices

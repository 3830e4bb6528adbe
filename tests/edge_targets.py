"""Slanted squares as a camera sees them, in plain NumPy: shares no code with gpusim's fit.

A square has Gaussian-blurred edges (error functions), ten samples to a pixel. Lens and pixel multiply its transform.
"""

import numpy as np
from scipy.special import erf

FINE = 10  # samples on a side of a pixel
SOFT = 0.15  # [pixel] standard deviation of the edges themselves, part of the truth
TILE = 128  # pixels on a side of a tile with a square


def square(angle, side, tile=TILE, centre=(0.0, 0.0)):
    """A dark square on light ground, tile x FINE samples on a side, 1 = dark. Not blurred by lens and pixel."""
    at = (np.arange(tile * FINE) + 0.5) / FINE - tile / 2
    x, y = at[None, :] - centre[1], at[:, None] - centre[0]
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    root = SOFT * np.sqrt(2)
    return np.prod(
        [0.5 * (erf((w + side / 2) / root) - erf((w - side / 2) / root)) for w in (u, v)], axis=0
    )


def aberrated_otf(cutoff, waves):
    """OTF of a circular pupil, as a function of (fx, fy) [cycle/pixel].

    cutoff: lambda N / pitch. waves: coefficients [waves] of rho^2, x^2 - y^2, x rho^2, y rho^2, rho^4, and 2 x y.
    """
    n, around = 64, 4
    size = n * around
    axis = (np.arange(size) - size / 2 + 0.5) / (n / 2)
    x, y = np.meshgrid(axis, axis)
    r2 = x * x + y * y
    defocus, astigmatism, coma_x, coma_y, sphere, lean = (*waves, 0)[:6]
    path = (
        defocus * r2
        + astigmatism * (x * x - y * y)
        + (coma_x * x + coma_y * y) * (r2 - 2 / 3)
        + sphere * r2 * r2
        + 2 * lean * x * y
    )
    pupil = np.where(r2 <= 1, np.exp(2j * np.pi * path), 0)
    power = np.abs(np.fft.fft2(pupil)) ** 2
    otf = np.fft.fftshift(np.fft.ifft2(power))
    otf /= otf[size // 2, size // 2]

    from scipy.interpolate import RegularGridInterpolator

    # a shift of one pupil sample is 2 / n of the radius, that is 1 / n of the cutoff frequency
    shift = (np.arange(size) - size // 2) / n / cutoff
    parts = [
        RegularGridInterpolator(
            (shift, shift),
            part,
            method="linear",
            bounds_error=False,
            fill_value=0,
        )
        for part in (otf.real, otf.imag)
    ]
    return lambda fx, fy: parts[0]((fy, fx)) + 1j * parts[1]((fy, fx))


def gaussian_otf(*parts):
    """OTF of a sum of Gaussians (share, sigma x, sigma y) [pixel]."""
    return lambda fx, fy: sum(
        share * np.exp(-2 * np.pi**2 * ((sx * fx) ** 2 + (sy * fy) ** 2)) for share, sx, sy in parts
    )


def camera_transfer(otf, fx, fy):
    """Transfer of edge, lens and a pixel without gaps."""
    return (
        otf(fx, fy) * np.exp(-2 * np.pi**2 * SOFT**2 * (fx**2 + fy**2)) * np.sinc(fx) * np.sinc(fy)
    )


def mtf50(otf, is_across):
    """Frequency [cycle/pixel] at which the camera's transfer falls to half."""
    f = np.linspace(0, 2, 4001)
    fx, fy = (f, 0 * f) if is_across else (0 * f, f)
    value = np.abs(camera_transfer(otf, fx, fy))
    k = np.flatnonzero(value <= 0.5)[0]
    return float(np.interp(0.5, [value[k], value[k - 1]], [f[k], f[k - 1]]))


def expose(shape, otf, tile=TILE):
    """Pixels of a dark square, (tile, tile), 0 dark to 1 light. shape: the square's transform, by `transform`."""
    f = np.fft.fftfreq(tile * FINE, 1 / FINE)
    g = np.fft.rfftfreq(tile * FINE, 1 / FINE)
    fx, fy = np.meshgrid(g, f)
    near = (np.abs(fx) <= 3) & (np.abs(fy) <= 3)
    gain = np.zeros(shape.shape, complex)
    gain[near] = otf(fx[near], fy[near]) * np.sinc(fx[near]) * np.sinc(fy[near])
    # from sample centres to pixel centres: half a sample of an even number of samples per pixel
    gain *= np.exp(-2j * np.pi * (fx + fy) * (-(FINE / 2 - 0.5) / FINE))
    seen = np.fft.irfft2(shape * gain, (tile * FINE, tile * FINE))[::FINE, ::FINE]
    return 1 - seen


def transform(pattern):
    """Transform of a square's samples."""
    return np.fft.rfft2(pattern)

"""Transfer function of a lens by itself at any frequencies, float64: what is drawn and measured, pixels apart."""

import numpy as np

from gpusim.domain.errors import OutOfRange
from gpusim.domain.optics import Optics
from gpusim.optics.otf import transfer


def lens_response(optics: Optics, wavelengths, fy, fx, place=(0.0, 0.0)) -> np.ndarray:
    """Optical transfer function around a point's image, complex (L, F): 1 at frequency 0.

    wavelengths: [nm], shape (L,). fy, fx: frequencies down and across [cycle/m], shape (F,). place: field point (y, x),
    1 the frame's corner. Lateral colour, which moves the image as a whole, is no part of it. Between its wavelengths a
    measured point spread is linear. Raises OutOfRange.
    """
    wavelengths = np.atleast_1d(np.asarray(wavelengths, np.float64))
    fy, fx = (np.asarray(f, np.float64) for f in np.broadcast_arrays(fy, fx))
    if optics.model == "none":
        return np.ones((len(wavelengths), fx.size), complex)
    if optics.psf is not None:
        return _of_spread(optics.psf, wavelengths, fy, fx, place)
    y, x = place
    waves = optics.waves(wavelengths, float(np.hypot(y, x)), float(np.arctan2(y, x)))
    cut = wavelengths * 1e-9 * optics.working_f_number  # [m/cycle]
    found = np.stack(
        [
            transfer(optics.pupil, wave[None], fx * one, fy * one)[0]
            for wave, one in zip(waves, cut, strict=True)
        ]
    )
    down, across = optics.birefringence
    return found * (
        np.cos(np.pi * down * fy)
        * np.cos(np.pi * across * fx)
        * np.exp(-2 * (np.pi * optics.diffuser) ** 2 * (fy**2 + fx**2))
    )


def spread_at(spread, wavelengths, place=(0.0, 0.0)) -> np.ndarray:
    """Measured point spreads at `wavelengths` [nm], shape (L, rows, cols). Raises OutOfRange beyond those given."""
    known, wavelengths = spread.wavelengths, np.asarray(wavelengths, np.float64)
    if wavelengths.min() < known[0] - 1e-9 or wavelengths.max() > known[-1] + 1e-9:
        raise OutOfRange(
            "wavelengths",
            f"{wavelengths.min():g} .. {wavelengths.max():g} nm",
            f"those of the point spread, {known[0]:g} .. {known[-1]:g} nm",
        )
    share = np.interp(wavelengths, known, np.arange(len(known)))
    low = np.minimum(share.astype(int), max(len(known) - 2, 0))
    high = np.minimum(low + 1, len(known) - 1)
    rest = (share - low)[:, None, None]
    values = spread.at(*place)
    return values[low] * (1 - rest) + values[high] * rest


def _of_spread(spread, wavelengths, fy, fx, place):
    values = spread_at(spread, wavelengths, place)
    left, right = (
        np.exp(-2j * np.pi * spread.spacing * np.outer(f, np.arange(n) - (n - 1) / 2))
        for f, n in zip((fy, fx), values.shape[1:], strict=True)
    )
    return np.einsum("fy,lyx,fx->lf", left, values, right, optimize=True)

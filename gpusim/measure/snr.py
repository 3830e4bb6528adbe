"""Signal to noise of an evenly lit patch, as numbers and as the eye sees it."""

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.measure.difference import cielab, eye_filtered, shown

MIDDLE = 0.8  # part of rows and columns that is judged: at the border a mirrored picture's noise is less blurred


def snr(patch, second=None):
    """Signal to noise ratio [dB], 20 log10(mean / standard deviation); infinite without noise.

    patch: values of even light, proportional to it (black level taken off), shape (rows, cols) or (rows, cols, C) for
    one ratio to each channel. second: another frame of the same, then the noise is that of their difference over
    sqrt(2): temporal alone, without the pattern that both share. Returns a float or shape (C,). Raises BadData.
    """
    patch = _numbers(patch, "patch")
    mean, noise = patch.mean(axis=(0, 1)), patch.std(axis=(0, 1), ddof=1)
    if second is not None:
        second = _numbers(second, "second")
        if second.shape != patch.shape:
            raise BadData(f"snr: frames of different shapes, {patch.shape} and {second.shape}")
        mean = (mean + second.mean(axis=(0, 1))) / 2
        noise = (patch - second).std(axis=(0, 1), ddof=1) / np.sqrt(2)
    if not np.all(mean > 0):
        raise BadData(f"snr: mean {np.min(mean):.4g}: wanted light, with the black level taken off")
    with np.errstate(divide="ignore"):
        found = 20 * np.log10(mean / noise)
    return float(found) if found.ndim == 0 else found


def visible_snr(patch, samples_per_degree: float, white=None) -> float:
    """Visible SNR [1 / Delta E]: one over the standard deviation of an even patch in S-CIELAB; infinite without noise.

    patch: a frame, its exposure divided out (see `gpusim.measure.ciede2000`), or XYZ (rows, cols, 3) with white Y about
    1, of one colour throughout. samples_per_degree: see `gpusim.measure.samples_per_degree`. white: XYZ that counts as
    white, shape (3,); None: the display's, sRGB's where there is no frame. Raises BadData, OutOfRange.
    Source: Farrell, Okincha, Parmar & Wandell 2010, "Using visible SNR (vSNR) to compare the image quality of pixel
    binning and digital resizing", Proc. SPIE 7537: 1 / sqrt(var L* + var a* + var b*).
    """
    xyz, white = shown(patch, white)
    lab = cielab(eye_filtered(xyz, samples_per_degree), white)
    rows, cols = (round((1 - MIDDLE) / 2 * count) for count in lab.shape[:2])
    middle = lab[rows : lab.shape[0] - rows, cols : lab.shape[1] - cols]
    if middle[..., 0].size < 2:
        raise BadData(f"visible_snr: patch of {lab.shape[0]} x {lab.shape[1]} pixels, wanted 2 or more")
    spread = np.sqrt(middle.var(axis=(0, 1), ddof=1).sum())
    return float(1 / spread) if spread > 0 else np.inf


def _numbers(values, name):
    values = np.asarray(values)
    if values.ndim not in (2, 3) or values.dtype.kind not in "uif" or values.shape[0] * values.shape[1] < 2:
        raise BadData(f"snr: {name} of shape {values.shape} and type {values.dtype}; wanted numbers (rows, cols) or "
                      "(rows, cols, channels), 2 pixels or more")
    values = values.astype(np.float64)
    if not np.isfinite(values).all():
        raise BadData(f"snr: {name}: NaN or infinite values")
    return values

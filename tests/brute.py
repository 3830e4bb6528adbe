"""The float64 truth: every wavelength by itself, no mosaic folded, nothing fused."""

import numpy as np

from gpusim.domain.content import Basis, Cube
from gpusim.judge.hard.truth import folded_otf, mosaic_of

BEYOND = 64  # [pixel] that the edge pixels go on


def spectra(content):
    """Content as a cube (L, rows, cols), float64."""
    if isinstance(content, Cube):
        return content.values.astype(float)
    if isinstance(content, Basis):
        return np.tensordot(content.basis.T, content.coefficients.astype(float), 1)
    return np.asarray(content.spectra, float).T[:, content.ids] * content.shading


class Brute:
    """Channels of a camera for scenes of one size: its transfer tables are computed once.

    period: of the transforms, or None: BEYOND pixels more on each side. What wraps around differs with it.
    """

    mosaic = staticmethod(mosaic_of)

    def __init__(self, q, shape, aperture=1.0, period=None):
        self.shape = shape
        self.period = period or tuple(n + 2 * BEYOND for n in shape)
        self.before = tuple((length - n) // 2 for length, n in zip(self.period, shape, strict=True))
        half = self.period[1] // 2 + 1
        tables = [folded_otf(float(one), self.period, aperture)[:, :half] for one in q]
        self.tables = np.stack(tables)

    def transform(self, planes, mode="edge"):
        pad = [
            (first, length - n - first)
            for first, length, n in zip(self.before, self.period, self.shape, strict=True)
        ]
        return np.fft.rfft2(np.pad(planes, ((0, 0), *pad), mode=mode))

    def crop(self, spectrum):
        (y, x), (rows, cols) = self.before, self.shape
        return np.fft.irfft2(spectrum, self.period)[..., y : y + rows, x : x + cols]

    def truth(self, transformed, weights, cfa):
        """The mosaic, band by band."""
        total = np.zeros((len(weights), *transformed.shape[1:]), complex)
        for plane, table, weight in zip(transformed, self.tables, weights.T, strict=True):
            total += weight[:, None, None] * (table * plane)
        return self.mosaic(self.crop(total), cfa)

    def fused(self, transformed, w_in, transfers, cfa):
        """The mosaic by planes w_in^T x of which each channel has its transfer functions; transfers: (C, planes, L)."""
        total = np.zeros((len(transfers), *transformed.shape[1:]), complex)
        for k, weights in enumerate(w_in.T):
            total += np.tensordot(transfers[:, k], self.tables, 1) * np.tensordot(
                weights, transformed, 1
            )
        return self.mosaic(self.crop(total), cfa)

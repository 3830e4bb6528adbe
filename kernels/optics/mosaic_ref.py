"""e(y, x) = sum_k mix[c, k] IFFT(H_ck FFT(extend(planes_k)))(y, x), c = cfa(y, x), float64."""

import numpy as np

MODES = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}


def mosaic(planes, tables, mix, cfa, border, period, margin=0):
    """Return the stage's result from whole channels, which are then sampled."""
    count, rows, cols = planes.shape
    pad = [
        ((length - n) // 2, length - n - (length - n) // 2)
        for length, n in zip(period, (rows, cols), strict=True)
    ]
    spectra = [
        np.fft.fft2(np.pad(np.asarray(plane, np.float64), pad, mode=MODES[border]))
        for plane in planes
    ]
    y, x = np.indices((rows - 2 * margin, cols - 2 * margin))
    channel = np.asarray(cfa)[y % len(cfa), x % len(cfa[0])]
    y, x = y + pad[0][0] + margin, x + pad[1][0] + margin
    out = np.zeros(channel.shape)
    for c, weights in enumerate(np.asarray(mix, np.float64)):
        total = np.zeros(period, complex)
        for k in range(count):
            table = np.asarray(tables[min(c, len(tables) - 1), k], np.float64)
            total += weights[k] * _unfold(table, period) * spectra[k]
        blurred = np.fft.ifft2(total).real
        out = np.where(channel == c, blurred[y, x], out)
    return out


def _unfold(table, period):
    """Return a table at all frequencies: a quarter at |frequency|, or a half and the conjugates of the opposites."""
    opposite_y, opposite_x = (-np.arange(n) % n for n in period)
    half = period[1] // 2 + 1
    if table.shape[1] == half:
        at = [np.minimum(np.arange(n), n - np.arange(n)) for n in period]
        return table[np.ix_(*at)]
    values = np.empty(period, complex)
    values[:, :half] = table[:, 0::2] + 1j * table[:, 1::2]
    values[:, half:] = values[opposite_y][:, opposite_x[half:]].conj()
    return values

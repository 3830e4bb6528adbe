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
    # the quarter table at |frequency|: index min(i, n - i)
    fold = np.ix_(*(np.minimum(np.arange(n), n - np.arange(n)) for n in period))
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
            total += weights[k] * table[fold] * spectra[k]
        blurred = np.fft.ifft2(total).real
        out = np.where(channel == c, blurred[y, x], out)
    return out

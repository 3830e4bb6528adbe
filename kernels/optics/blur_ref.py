"""e_c = sum_k gains[c, k] IFFT(H_ck FFT(extend(planes_k))), float64, one complex transform per plane."""

import numpy as np

MODES = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}


def blur(planes, tables, gains, border, period, margin=0):
    """See the contract; `H_ck` is the quarter table unfolded over all frequencies."""
    count, rows, cols = planes.shape
    tables = np.broadcast_to(np.asarray(tables, np.float64), (len(gains), *tables.shape[1:]))
    more = np.array(period) - (rows, cols)
    pad = [(m // 2, m - m // 2) for m in more]
    # the quarter table at |frequency|: index min(i, n - i)
    fold = np.ix_(*(np.minimum(np.arange(n), n - np.arange(n)) for n in period))
    sums = np.zeros((len(gains), *period), complex)
    for k in range(count):
        spectrum = np.fft.fft2(np.pad(np.asarray(planes[k], np.float64), pad, mode=MODES[border]))
        for c, gain in enumerate(np.asarray(gains, np.float64)):
            sums[c] += gain[k] * tables[c, k][fold] * spectrum
    blurred = np.fft.ifft2(sums).real
    y, x = pad[0][0] + margin, pad[1][0] + margin
    return blurred[:, y : y + rows - 2 * margin, x : x + cols - 2 * margin]

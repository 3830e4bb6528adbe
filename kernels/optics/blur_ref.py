"""e_c = sum_k gains[c, k] IFFT(H_ck FFT(extend(planes_k))), float64, one complex transform per plane."""

import numpy as np

MODES = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}


def blur(planes, tables, gains, border, period, margin=0):
    """See the contract; `H_ck` is the quarter or half table unfolded over all frequencies."""
    count, rows, cols = planes.shape
    tables = np.broadcast_to(np.asarray(tables, np.float64), (len(gains), *tables.shape[1:]))
    more = np.array(period) - (rows, cols)
    pad = [(m // 2, m - m // 2) for m in more]
    opposite = [(n - np.arange(n)) % n for n in period]
    half = period[1] // 2 + 1
    if tables.shape[3] == 2 * half:  # the half at the frequency, or the conjugate of its opposite's
        values = np.ascontiguousarray(tables).view(complex)
        right = values[:, :, opposite[0]][..., opposite[1][half:]].conj()
        tables = np.concatenate([values, right], axis=-1)
    else:  # the quarter table at |frequency|: index min(i, n - i)
        tables = tables[(..., *np.ix_(*(np.minimum(np.arange(n), other)
                                        for n, other in zip(period, opposite, strict=True))))]
    sums = np.zeros((len(gains), *period), complex)
    for k in range(count):
        spectrum = np.fft.fft2(np.pad(np.asarray(planes[k], np.float64), pad, mode=MODES[border]))
        for c, gain in enumerate(np.asarray(gains, np.float64)):
            sums[c] += gain[k] * tables[c, k] * spectrum
    blurred = np.fft.ifft2(sums).real
    y, x = pad[0][0] + margin, pad[1][0] + margin
    return blurred[:, y : y + rows - 2 * margin, x : x + cols - 2 * margin]

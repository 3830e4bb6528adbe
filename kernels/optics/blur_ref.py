"""e_c = base_c + sum_k mix[c, k] IFFT(H_ck FFT(extend(planes_k))), float64, complex transforms."""

import numpy as np

MODES = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}


def blur(planes, tables, mix, border, period, margin=0, base=None):
    """Return the stage's result; `H_ck` is the table unfolded over all frequencies."""
    count, rows, cols = planes.shape
    more = np.array(period) - (rows, cols)
    pad = [(m // 2, m - m // 2) for m in more]
    sums = np.zeros((len(mix), *period), complex)
    for k in range(count):
        spectrum = np.fft.fft2(np.pad(np.asarray(planes[k], np.float64), pad, mode=MODES[border]))
        for c, weights in enumerate(np.asarray(mix, np.float64)):
            if c < len(tables):
                whole = _unfold(np.asarray(tables[c, k], np.float64), period)
            sums[c] += weights[k] * whole * spectrum
    blurred = np.fft.ifft2(sums).real
    y, x = pad[0][0] + margin, pad[1][0] + margin
    inside = blurred[:, y : y + rows - 2 * margin, x : x + cols - 2 * margin]
    return inside if base is None else base + inside


def _unfold(table, period):
    opposite = [(n - np.arange(n)) % n for n in period]
    half = period[1] // 2 + 1
    if table.shape[1] == 2 * half:  # the half at the frequency, or the conjugate of its opposite's
        values = np.ascontiguousarray(table).view(complex)
        return np.concatenate([values, values[opposite[0]][:, opposite[1][half:]].conj()], axis=1)
    # the quarter table at |frequency|: index min(i, n - i)
    return table[
        np.ix_(
            *(np.minimum(np.arange(n), other) for n, other in zip(period, opposite, strict=True))
        )
    ]

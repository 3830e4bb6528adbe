"""Every source pixel spreads the kernel of its place, float64: direct sums over kernel entries."""

import numpy as np

MODES = {"zero": "constant", "edge": "edge", "reflect": "symmetric"}


def field(
    planes,
    coefficients,
    kernels,
    index,
    edges,
    mix,
    border,
    margin=0,
    base=None,
    threshold=None,
    tables=None,
    sources=None,
):
    """Return the stage's result; `threshold` and `tables` do not change it."""
    _, rows, cols = planes.shape
    kernels = np.asarray(kernels, np.float64)
    m, n = kernels.shape[2:]
    pad = (m // 2, m // 2), (n // 2, n // 2)
    weights = np.pad(np.asarray(coefficients, np.float64), ((0, 0), *pad), mode="edge")
    out = np.zeros((len(mix), rows - 2 * margin, cols - 2 * margin))
    for p, number in enumerate(range(len(planes)) if sources is None else sources):
        source = np.pad(np.asarray(planes[number], np.float64), pad, mode=MODES[border])
        own = kernels[:, min(p, kernels.shape[1] - 1)]
        spread = np.zeros((rows + 2 * (m - 1), cols + 2 * (n - 1)))
        for t, chosen in enumerate(np.asarray(index)):
            i, j = divmod(t, len(edges[1]) - 1)
            y = slice(edges[0][i] + m // 2, edges[0][i + 1] + m // 2)
            x = slice(edges[1][j] + n // 2, edges[1][j + 1] + n // 2)
            weighted = weights[:, y, x] * source[y, x]
            # a kernel for each term, or its weights of all kernels
            terms = own[chosen] if chosen.ndim == 1 else np.tensordot(chosen, own, 1)
            for a in range(m):
                for b in range(n):
                    spread[y.start + a : y.stop + a, x.start + b : x.stop + b] += np.tensordot(
                        terms[:, a, b], weighted, 1
                    )
        # the source began m // 2 before the frame, and a kernel's first entry m // 2 before its pixel
        place = np.s_[
            m - 1 + margin : m - 1 + rows - margin, n - 1 + margin : n - 1 + cols - margin
        ]
        out += np.asarray(mix, np.float64)[:, p, None, None] * spread[place]
    return out if base is None else out + base

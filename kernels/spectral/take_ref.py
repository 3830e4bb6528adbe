"""out_ke(i, j) = content_e(row_ki, col_kj), float64, or numbers as they are."""

import numpy as np


def take(content, rows=None, cols=None):
    """Return the stage's result, see `take.py`."""
    from gpusim.kernels.spectral.take import check_inputs

    check_inputs(content, rows, cols)
    content = np.asarray(content)
    content = content if content.dtype == np.uint16 else content.astype(np.float64)
    height, width = content.shape[-2:]
    given = rows if rows is not None else cols
    count = 1 if given is None else len(given)
    rows = np.tile(np.arange(height), (count, 1)) if rows is None else np.clip(rows, 0, height - 1)
    cols = np.tile(np.arange(width), (count, 1)) if cols is None else np.clip(cols, 0, width - 1)
    return np.moveaxis(content[..., rows[:, :, None], cols[:, None, :]], -3, 0)

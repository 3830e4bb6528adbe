"""Means of (T c)_p^2 and of |c|^2 over rows, for samples and differences of neighbours, float64."""

import numpy as np


def survey(content, table, first, ids=None, scale=(1.0, 1.0)):
    """Return the stage's result, see `survey.py`."""
    from gpusim.kernels.spectral.survey import check_inputs

    _, rows, cols = check_inputs(content, table, first, ids)
    table = np.asarray(table, np.float64)
    out = np.zeros((len(first), 3, len(table) + 1))
    for number, y in enumerate(np.clip(first, 0, rows - 1)):
        upper, lower = (
            _entries(content, ids, table.shape[1], row) for row in (y, min(y + 1, rows - 1))
        )
        with np.errstate(invalid="ignore"):  # infinity less infinity
            across, down = upper[:, 1:] - upper[:, :-1], lower - upper
        out[number, 0] = _mean_squares(table, upper)
        if cols > 1:
            out[number, 1] = _mean_squares(table, across)
        out[number, 2] = _mean_squares(table, down)
    out[..., :-1] *= scale[1] ** 2
    out[..., -1] *= scale[0] ** 2
    return out


def _entries(content, ids, count, row):
    """Return the entries of the samples of a row, shape (entries, cols)."""
    if ids is None:
        return np.asarray(content[:, row], np.float64)
    columns = np.arange(len(ids[row]))
    entries = np.zeros((count, len(columns)))
    entries[ids[row], columns] = content[row]
    return entries


def _mean_squares(table, entries):
    """Return means over the columns, shape (P + 1,)."""
    squares = np.vstack([(table @ entries) ** 2, (entries**2).sum(0)])
    return squares.mean(1)

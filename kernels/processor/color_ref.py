"""out_p(x) = sum_f M_pf term_f(min(camera(x), ceiling)), float64; the terms are channels or roots."""

import numpy as np


def color(camera, matrix, *, ceiling=None):
    """Return the stage's result, see `color.py`."""
    camera, matrix = np.asarray(camera, np.float64), np.asarray(matrix, np.float64)
    if ceiling is not None:
        camera = np.minimum(camera, np.reshape(ceiling, (-1, 1, 1)))
    terms = camera
    if matrix.shape[1] != len(camera):
        r, g, b = np.where(camera < 0, 0, camera)
        squares = np.sqrt([r * g, g * b, r * b])
        terms = np.concatenate([camera, squares])
        if matrix.shape[1] == 13:
            cubes = [r * g * g, g * b * b, r * b * b, r * r * g, g * g * b, r * r * b, r * g * b]
            terms = np.concatenate([terms, np.cbrt(cubes)])
    return np.einsum("pf,fyx->pyx", matrix, terms)

"""out(x) = base(x) + sum_k < b_k V_k > - < b_k > prod_{j < k} (1 - < a_j >), point by point of the pupil; float64.

The planner uses the sum too.
"""

import numpy as np

from gpusim.optics.occlusion import covariance


def occlude(
    base,
    lights,
    alphas,
    places,
    members,
    radii,
    points,
    border,
    margin=0,
    change=False,
    weights=None,
    bends=None,
    maps=None,
    slopes=None,
):
    """Return the stage's result, see `occlude.py`."""
    if weights is None:
        weights, bends = (), ()
    out = np.array(base, np.float64)
    y, x = np.asarray(places).T
    at = np.asarray(places) + margin
    more = covariance(
        lights, alphas, at, members, radii, points, border, weights, bends, maps, slopes
    )
    out[:, y, x] = np.maximum(out[:, y, x] + more, 0)
    return out - base if change else out

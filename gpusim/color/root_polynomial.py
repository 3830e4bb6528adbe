"""Root-polynomial terms of three channels: products of roots, proportional to brightness."""

import numpy as np

from gpusim.domain.processor import ROOT_POLYNOMIALS

# Exponents of the three channels in each term. The sum is 1: twice the light, twice the term.
_SECOND = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
_THIRD = np.array(
    [[1, 2, 0], [0, 1, 2], [1, 0, 2], [2, 1, 0], [0, 2, 1], [2, 0, 1], [1, 1, 1]]
) / np.array(3.0)
# The numbers below give the least mean colour difference of the choices that were tried, without more
# noise, on surfaces that were not trained on: munsell, dupont and macbeth after objects, three cameras.
ELECTRONS = 1e4  # of white in the strongest channel, for the balance of noise and colour error
FAR_SHARE, FAR_LIGHT = 0.03, 0.2  # weight of colours far from the surfaces', and their brightness
FAR_STEPS = 10  # along each side of the triangle of colours
EXPONENTS = dict(zip(ROOT_POLYNOMIALS, (_SECOND, np.concatenate([_SECOND, _THIRD])), strict=True))


def terms_of(channels, count: int) -> np.ndarray:
    """Return the terms that a colour matrix of `count` columns is multiplied by.

    Args:
        channels: Responses, shape (..., C); negative ones count as 0 in roots.
        count: Columns of the matrix: C (the responses themselves), 6 (terms up to square roots) or
            13 (up to cube roots), these for C = 3.

    Returns:
        The terms, shape (..., count).

    Source:
        Finlayson, Mackiewicz & Hurlbert 2015, IEEE Trans. Image Processing 24, 1460-1470.
    """
    channels = np.asarray(channels, np.float64)
    linear = channels.shape[-1]
    exponents = _exponents(count, linear)
    roots = (np.maximum(channels, 0)[..., None, :] ** exponents).prod(-1)
    return np.concatenate([channels, roots], -1)


def slopes_of(channels: np.ndarray, count: int) -> np.ndarray:
    """Return the derivatives of `terms_of` by the channels, shape (..., count, C).

    channels: Responses > 0, shape (..., C).
    """
    exponents = np.concatenate(
        [np.eye(channels.shape[-1]), _exponents(count, channels.shape[-1])], 0
    )
    return terms_of(channels, count)[..., None] * exponents / channels[..., None, :]


def linearise(matrix: np.ndarray, neutral: np.ndarray) -> np.ndarray:
    """Return the matrix of the channels themselves that is nearest to a matrix of terms at grey.

    Args:
        matrix: Matrix of the channels, shape (3, C), returned as it is; or of terms, (3, 6 or 13).
        neutral: Response to white in any scale, shape (C,).

    Returns:
        Matrix, shape (3, C). White becomes what it becomes by the terms.
    """
    count = matrix.shape[1]
    return matrix if count == len(neutral) else matrix @ slopes_of(neutral, count)


def weigh_terms(camera, xyz, bright, white, linear, count) -> tuple[np.ndarray, np.ndarray]:
    """Return the terms of a weighted least squares problem, and the XYZ wanted of them.

    Its errors are those of the surfaces, weighted by the slope of CIELAB's cube root (roots err in
    the dark, where CIELAB is steep); of a few colours over the whole triangle of the three channels,
    for which a linear matrix gives the XYZ; and of shot noise.

    Args:
        camera: Responses to the surfaces, white = 1 in its strongest channel, shape (3, N).
        xyz: Their XYZ, shape (3, N).
        bright: Their Y relative to white, shape (N,).
        white: Response to white, shape (3,).
        linear: Matrix from responses to XYZ, shape (3, 3).
        count: Number of terms.

    Returns:
        Terms, shape (count, M), and XYZ, shape (3, M); M: surfaces, colours and noise.
    """
    weights = np.maximum(bright, (6 / 29) ** 3) ** (-2 / 3)
    parts = np.array(
        [(i, j, FAR_STEPS - i - j) for i in range(FAR_STEPS + 1) for j in range(FAR_STEPS + 1 - i)]
    )
    far = parts / FAR_STEPS * 3 * FAR_LIGHT * white  # mean FAR_LIGHT, relative to white
    far_weight = FAR_SHARE * np.sqrt(camera.shape[1] / len(far)) * FAR_LIGHT ** (-2 / 3)
    # the terms' covariance from shot noise of the channels, summed over the surfaces
    slopes = slopes_of(np.maximum(camera.T, 1 / ELECTRONS), count) * weights[:, None, None]
    covariance = np.einsum("nfc,cn,ngc->fg", slopes, camera, slopes) / ELECTRONS
    values, axes = np.linalg.eigh(covariance)
    noise = axes * np.sqrt(np.maximum(values, 0))
    terms = [terms_of(camera.T, count).T * weights, terms_of(far, count).T * far_weight, noise]
    wanted = [xyz * weights, linear @ far.T * far_weight, np.zeros((3, count))]
    return np.hstack(terms), np.hstack(wanted)


def _exponents(count, linear):
    """Return the exponents of the terms after the linear ones, shape (count - linear, linear)."""
    if count == linear:
        return np.zeros((0, linear))
    return next(rows for rows in EXPONENTS.values() if len(rows) == count)[linear:]

"""The light of a picture by Bayes's rule: which lights are usual, and which fit the picture."""

import functools
from dataclasses import dataclass

import numpy as np

from gpusim.color.color import TransformSet, chromaticity
from gpusim.domain.errors import BadData

# Lengths are in units of the spread of the training surfaces' chromaticities around white, so that
# they serve cameras with narrow and with broad filters. The numbers were chosen with discs of
# measured surfaces and with eight photographs, not with the ones in the tables of the docs.
STEP = 0.1  # between possible lights
BREADTH = 0.15  # of the usual lights around the lines that link neighbours
UNUSUAL = 1e-3  # prior of a light far from all of them, over that of one among them
BRIGHT = 0.002  # share of the blocks that count as brightest
SHARED = 0.7  # weight of each cue: all see the same surfaces, so that they err together
NOISY = 0.01  # noise over the brightest block from which small blocks err by noise
CLOSE = 3.0  # [degree] error within which an estimate counts as right


@dataclass(frozen=True)
class _Cue:
    """What a statistic of the picture tells about white.

    Its difference from white has a Student distribution. Surfaces are redder than white on average,
    so that errors towards their mean colour are larger.

    Attributes:
        shift: Mean difference from white towards the surfaces' mean colour.
        towards: Spread towards the surfaces' mean colour.
        away: Spread away from it.
        across: Spread in all other directions.
        freedom: Degrees of freedom.
    """

    shift: float
    towards: float
    away: float
    across: float
    freedom: float


CUES = {
    "largest responses": _Cue(0.0, 0.6, 0.2, 0.3, 3.0),
    "brightest blocks": _Cue(0.0, 0.6, 0.2, 0.3, 3.0),
    "edges": _Cue(0.5, 1.0, 1.0, 0.3, 5.0),
}


@dataclass(frozen=True, eq=False)
class _Lights:
    """Possible whites of a camera.

    Attributes:
        whites: Responses to white, largest entry 1, shape (N, C).
        places: Chromaticities of these, shape (N, C).
        prior: Logarithm of their prior probabilities up to a constant, shape (N,).
        unit: Root mean square distance of the surfaces from white, over all directions.
        mean: Direction from white to the surfaces' mean colour, shape (C,), length 1.
    """

    whites: np.ndarray
    places: np.ndarray
    prior: np.ndarray
    unit: float
    mean: np.ndarray


def find_likely_light(
    thumbnail: np.ndarray, transforms: TransformSet, floor: float = 0.0
) -> tuple[np.ndarray, float, float]:
    """Return the mean of the possible whites, each with its probability.

    Args:
        thumbnail: Block means, shape (C, rows, cols), C > 1; NaN where a block is clipped.
        transforms: Colour transforms of usual lights.
        floor: Noise of a pixel without light. If it is above NOISY of the brightest block, four
            blocks are taken as one.

    Returns:
        White, largest entry 1, shape (C,); the probability that it errs by at most CLOSE; and its
        expected error [degree].

    Raises:
        BadData: All training surfaces are grey.

    Source:
        Brainard & Freeman 1997, J. Opt. Soc. Am. A 14, 1393-1411; here the mean of the posterior, of
        statistics in place of all surfaces.
    """
    if floor > NOISY * np.nanmax(thumbnail):
        thumbnail = _join_blocks(thumbnail)
    lights = _possible_lights(transforms)
    probability = lights.prior.copy()
    for cue, statistic in zip(CUES.values(), _statistics(thumbnail), strict=True):
        if statistic is None:
            continue
        offset = (chromaticity(statistic) - lights.places) / lights.unit - cue.shift * lights.mean
        along = offset @ lights.mean
        across = ((offset - along[:, None] * lights.mean) ** 2).sum(1)
        squares = (along / np.where(along > 0, cue.towards, cue.away)) ** 2
        squares += across / cue.across**2
        dimensions = len(lights.mean) - 1
        probability -= SHARED * (cue.freedom + dimensions) / 2 * np.log1p(squares / cue.freedom)
    probability = np.exp(probability - probability.max())
    probability /= probability.sum()
    white = np.exp(probability @ lights.places)
    cosines = lights.whites @ white / np.linalg.norm(lights.whites, axis=1) / np.linalg.norm(white)
    angles = np.rad2deg(np.arccos(np.minimum(cosines, 1)))
    return white / white.max(), float(probability @ (angles <= CLOSE)), float(probability @ angles)


def _join_blocks(thumbnail):
    """Return the means of 2 x 2 blocks, without those that are NaN; as it is if too small."""
    channels, rows, cols = thumbnail.shape
    if min(rows, cols) < 2:
        return thumbnail
    pairs = thumbnail[:, : rows // 2 * 2, : cols // 2 * 2]
    pairs = pairs.reshape(channels, rows // 2, 2, cols // 2, 2)
    known = np.isfinite(pairs)
    counts = known.sum((2, 4))
    sums = np.where(known, pairs, 0).sum((2, 4))
    return np.divide(sums, counts, out=np.full(sums.shape, np.nan), where=counts > 0)


def _statistics(thumbnail):
    """Return the statistics of CUES, responses > 0 of shape (C,) each; None: not defined."""
    blocks = thumbnail[:, np.isfinite(thumbnail).all(0)]
    least = 1e-4 * blocks.max()
    brightness = (blocks / blocks.max(1, keepdims=True)).min(0)  # of its darkest channel
    brightest = blocks[:, brightness >= np.quantile(brightness, 1 - BRIGHT)].mean(1)
    down = np.diff(thumbnail, axis=1)[:, :, 1:]
    across = np.diff(thumbnail, axis=2)[:, 1:, :]
    edges = np.hypot(down, across)
    edges = edges[:, np.isfinite(edges).all(0)]
    mean = edges.mean(1) if edges.size else np.zeros(len(blocks))
    return (
        np.maximum(blocks.max(1), least),
        np.maximum(brightest, least),
        mean if (mean > 0).all() else None,
    )


@functools.lru_cache(maxsize=8)
def _possible_lights(transforms: TransformSet) -> _Lights:
    """Return mixtures of the transforms' lights, with their prior.

    Usual are the lights, and mixtures of two neighbours: the shortest tree of lines that links all.
    """
    from scipy.sparse.csgraph import minimum_spanning_tree

    surfaces = np.maximum(transforms.responses, 1e-4) / transforms.whites[:, :, None]
    relative = chromaticity(surfaces.transpose(0, 2, 1)).reshape(-1, surfaces.shape[1])
    unit = float(np.sqrt(relative.var(0).sum() / (relative.shape[1] - 1)))
    if not unit > 1e-6:  # rounding
        raise BadData("white balance 'bayesian': all training surfaces are grey; use another set")
    mean = relative.mean(0) / np.linalg.norm(relative.mean(0))
    known = chromaticity(transforms.whites)
    distances = np.linalg.norm(known[:, None] - known, axis=2)
    longest = distances.max()
    steps = np.linspace(0, 1, 2 + int(longest / (STEP * unit)))[:, None]
    mixtures = np.concatenate(
        [known]
        + [
            known[i] + steps * (known[j] - known[i])
            for i in range(len(known))
            for j in range(i + 1, len(known))
        ]
    )
    cells = np.round(mixtures / (STEP * unit)).astype(int)
    places = mixtures[np.unique(cells, axis=0, return_index=True)[1]]
    first, second = minimum_spanning_tree(distances).nonzero()
    links = known[first, None] + steps * (known[second] - known[first])[:, None]
    nodes = np.concatenate([known, links.reshape(-1, known.shape[1])])
    squares = ((places[:, None] - nodes) ** 2).sum(2) / (BREADTH * unit) ** 2
    density = np.exp(-squares / 2).mean(1)
    whites = np.exp(places)
    return _Lights(
        whites / whites.max(1, keepdims=True),
        places,
        np.log(density / density.max() + UNUSUAL),
        unit,
        mean,
    )

"""Estimates of the light from the camera's picture: the camera's response to a perfect white."""

from dataclasses import dataclass

import numpy as np

from gpusim.color.color import TransformSet
from gpusim.color.likely_light import CLOSE, find_likely_light
from gpusim.domain.errors import BadData, OutOfRange, UnknownName

ESTIMATES = ("bayesian", "gray-world", "max-rgb", "shades-of-gray", "red-blue")
COMPARES_LIGHTS = ("bayesian", "red-blue")  # estimates that need the transforms of lights
MINKOWSKI = 6  # the best exponent according to Finlayson & Trezzi
BLOCKS, FINE_BLOCKS = (48, 64), (96, 128)  # rows and columns of thumbnails
PIXELS = 4  # along the side of a fine block, at least


@dataclass(frozen=True, eq=False)
class WhiteEstimate:
    """Estimated camera response to white.

    Attributes:
        white: The response, largest entry 1, shape (C,).
        model: Method and outcome in words.
        confidence: Probability that the white errs by at most 3 degrees; None if the method has no
            measure of it.
    """

    white: np.ndarray
    model: str
    confidence: float | None = None


def blocks_of(method: str, shape: tuple[int, int]) -> tuple[int, int]:
    """Return the rows and columns of the thumbnail that suits an estimate.

    "bayesian" relies on the brightest blocks. Small ones hold highlights and little else, but those
    of less than PIXELS x PIXELS would be noisy.

    Args:
        method: The estimate.
        shape: Rows and columns of the picture.
    """
    if method != "bayesian":
        return BLOCKS
    rows, cols = (
        max(coarse, min(fine, size // PIXELS))
        for coarse, fine, size in zip(BLOCKS, FINE_BLOCKS, shape, strict=True)
    )
    return rows, cols


def estimate_white(
    thumbnail, method: str, transforms: TransformSet | None = None, *, floor: float = 0.0
) -> WhiteEstimate:
    """Estimate the camera's response to white from block means of its picture.

    If no estimate is possible, the picture is treated as lit by the target light of `transforms`,
    or, without these, as balanced already; `model` then gives the reason.

    Args:
        thumbnail: Block means from `processor.thumbnail`, shape (C, rows, cols). Blocks that are
            not finite are left out.
        method: "bayesian": the mean of the possible lights, weighted by their probability. Mixtures
            of the lights of `transforms` are likely before the picture is seen. Each picture has
            three cues: the largest responses, the brightest blocks and the mean difference of
            neighbours, which differ from white by what is usual for surfaces such as the training
            ones. Its confidence is the probability that the angle to the true white is at most 3
            degrees. "gray-world": the mean of the scene is neutral. "max-rgb": the largest
            responses of all channels belong to white. "shades-of-gray": between the two, the Minkowski mean with
            exponent 6 is neutral. "red-blue": the light of `transforms` in which the red and blue
            responses of the training surfaces fill an area that correlates best with the picture's:
            overlap / sqrt(product). Areas are convex hulls of the responses and black. Both are
            scaled until their brightest colour, the root of the sum of squares over the channels,
            is 1. The channels must include R and B.
        transforms: Colour transforms of the candidate lights, necessary for "red-blue", and for
            "bayesian" with more than one channel.
        floor: Mean response that counts as dark, for example the read noise [camera value].
            "bayesian" takes larger blocks where it is large.

    Returns:
        The estimate.

    Raises:
        BadData: The shape is wrong, or transforms or channels are missing.
        OutOfRange: The floor is negative.
        UnknownName: The method is not known.

    Source:
        Brainard & Freeman 1997, J. Opt. Soc. Am. A 14, 1393-1411 (Bayes's rule for the light), with
        the cues of Land 1977, Joze et al. 2012, Color Imaging Conference 20, 41-46 (bright pixels),
        and van de Weijer et al. 2007, IEEE Trans. Image Processing 16, 2207-2214 (edges);
        Buchsbaum 1980, J. Franklin Institute 310, 1-26 (gray-world); Land 1977, Scientific American
        237, 108-128 (max-rgb); Finlayson & Trezzi 2004, Color Imaging Conference 12, 37-41
        (shades-of-gray); Tominaga & Wandell 2002, Proc. IEEE 90, 42-56 (red-blue).
    """
    if method not in ESTIMATES:
        raise UnknownName("white balance estimate", method, ESTIMATES)
    if not floor >= 0:
        raise OutOfRange("floor", floor, "floor >= 0")
    thumbnail = np.asarray(thumbnail, np.float64)
    if thumbnail.ndim != 3 or not thumbnail.size:
        raise BadData(f"thumbnail of shape {thumbnail.shape}: wanted (channels, rows, cols)")
    if transforms is not None and len(transforms.target_white) != len(thumbnail):
        raise BadData(
            f"transforms for {len(transforms.target_white)} channels, a thumbnail of {len(thumbnail)}"
        )
    pair = _find_red_and_blue(transforms) if method == "red-blue" else None
    if method == "bayesian" and len(thumbnail) == 1:
        return WhiteEstimate(np.ones(1), "bayesian: one channel has one white", 1.0)
    if method == "bayesian" and transforms is None:
        raise BadData(
            "white balance 'bayesian' compares the picture with lights: give it their transforms"
        )
    blocks = thumbnail[:, np.isfinite(thumbnail).all(0)]
    if not blocks.size:
        return _assume_white(transforms, len(thumbnail), "every block is clipped")
    if not (blocks.mean(1) > floor).all():
        return _assume_white(transforms, len(thumbnail), "a channel is dark")
    if pair:
        return _match_red_and_blue(blocks, transforms, pair)
    if method == "bayesian" and transforms is not None:
        white, confidence, error = find_likely_light(thumbnail, transforms, floor)
        words = (
            f"bayesian, {100 * confidence:.0f} % sure of it to {CLOSE:g} degrees, "
            f"expected error {error:.1f} degrees"
        )
        return WhiteEstimate(white, words, confidence)
    means = (
        blocks.mean(1)
        if method == "gray-world"
        else _minkowski(np.maximum(blocks, 0), np.inf if method == "max-rgb" else MINKOWSKI)
    )
    return WhiteEstimate(means / means.max(), f"{method} of {blocks.shape[1]} blocks")


def _assume_white(transforms, channels, reason):
    """Return the white of the target light, or of balanced data, with the reason in words."""
    if transforms is None:
        return WhiteEstimate(np.ones(channels), f"not estimated, {reason}: as if balanced already")
    return WhiteEstimate(
        transforms.target_white, f"not estimated, {reason}: as if in the target light"
    )


def _minkowski(blocks, exponent):
    """Return the generalised mean of each row of blocks (C, N) >= 0."""
    peak = blocks.max()  # powers neither overflow nor underflow
    return (
        peak * np.mean((blocks / peak) ** exponent, 1) ** (1 / exponent)
        if np.isfinite(exponent)
        else blocks.max(1)
    )


def _find_red_and_blue(transforms):
    """Return the indices of the channels R and B."""
    if transforms is None:
        raise BadData(
            "white balance 'red-blue' compares the picture with lights: give it their transforms"
        )
    letters = list(transforms.channels)
    if not {"R", "B"} <= {*letters}:
        raise BadData(
            f"white balance 'red-blue' needs channels R and B; the transforms name "
            f"{', '.join(letters) or 'none'}; use another method"
        )
    return [letters.index("R"), letters.index("B")]


def _match_red_and_blue(blocks, transforms, pair):
    """Return the light whose area in the (R, B) plane correlates best with the blocks (C, N)."""
    picture = _hull(blocks, pair)
    if picture is None:
        return _assume_white(transforms, len(blocks), "there is only one color")
    areas = [_hull(surfaces, pair) for surfaces in transforms.responses]
    correlations = [
        0.0
        if area is None
        else _area(_overlap(picture, area)) / np.sqrt(_area(picture) * _area(area))
        for area in areas
    ]
    best = int(np.argmax(correlations))
    return WhiteEstimate(
        transforms.transforms[best].white,
        f"red-blue correlation {correlations[best]:.2f} with {transforms.names[best]}",
    )


def _hull(colors, pair):
    """Return the convex hull, counterclockwise, of black and the pair's responses (C, N).

    Scaled to brightest = 1; None if it has no area.
    """
    from scipy.spatial import ConvexHull, QhullError

    points = np.vstack([np.zeros(2), (colors / np.linalg.norm(colors, axis=0).max())[pair].T])
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return None


def _overlap(polygon, clip):
    """Return the intersection of two convex polygons, both counterclockwise.

    Source: Sutherland & Hodgman 1974, Comm. ACM 17, 32-42.
    """
    for begin, end in zip(clip, np.roll(clip, -1, 0), strict=True):
        edge, kept = end - begin, []
        # >= 0: inside
        sides = edge[0] * (polygon[:, 1] - begin[1]) - edge[1] * (polygon[:, 0] - begin[0])
        for i in range(len(polygon)):
            if (sides[i] >= 0) != (sides[i - 1] >= 0):
                kept.append(
                    polygon[i - 1]
                    + (polygon[i] - polygon[i - 1]) * sides[i - 1] / (sides[i - 1] - sides[i])
                )
            if sides[i] >= 0:
                kept.append(polygon[i])
        if not kept:
            return np.zeros((0, 2))
        polygon = np.array(kept)
    return polygon


def _area(polygon):
    x, y = polygon.T
    return (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2

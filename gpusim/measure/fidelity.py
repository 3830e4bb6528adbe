"""Fidelity of a picture to a reference: CPSNR and SSIM."""

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, OutOfRange

WINDOW = 11  # side of the SSIM window: a Gaussian of 1.5 pixels, cut off at 5


def cpsnr(
    image: ArrayLike, reference: ArrayLike, border: int = 10, peak: float | None = None
) -> float:
    """Return the peak signal-to-noise ratio over all channels together.

    It is 10 log10(peak^2 / mean squared error).

    Args:
        image: picture, shape (rows, cols, channels) or (rows, cols).
        reference: picture of the same shape.
        border: pixels left out on each side.
        peak: value of white; None is 1, or the largest number of an integer type.

    Returns:
        The ratio [dB], infinite if both are equal.

    Raises:
        BadData: if shapes or types do not fit, or values are not finite.
        OutOfRange: if `border` or `peak` is out of range.
    """
    image, reference, peak = _crop(image, reference, border, peak, 1)
    error = np.mean((image - reference) ** 2)
    return float(10 * np.log10(peak**2 / error)) if error > 0 else np.inf


def ssim(
    image: ArrayLike, reference: ArrayLike, border: int = 10, peak: float | None = None
) -> float:
    """Return the mean structural similarity of all channels.

    Computed by scikit-image with the authors' Gaussian window.

    Source: Wang, Bovik, Sheikh & Simoncelli 2004, "Image quality assessment", IEEE Trans. Image
    Processing 13(4).

    Args:
        image: picture, shape (rows, cols, channels) or (rows, cols), 11 x 11 pixels or more inside
            the border.
        reference: picture of the same shape.
        border: pixels left out on each side.
        peak: value of white; None is 1, or the largest number of an integer type.

    Returns:
        The similarity [1].

    Raises:
        BadData: if shapes or types do not fit, or values are not finite.
        OutOfRange: if `border` or `peak` is out of range.
    """
    image, reference, peak = _crop(image, reference, border, peak, WINDOW)
    from skimage.metrics import structural_similarity

    similarity = structural_similarity(
        image,
        reference,
        data_range=peak,
        channel_axis=-1,
        gaussian_weights=True,
        sigma=1.5,
        use_sample_covariance=False,
    )
    return float(similarity)


def _crop(image, reference, border, peak, least) -> tuple[np.ndarray, np.ndarray, float]:
    """Return both pictures as float64 (rows, cols, channels) without the border, and the peak."""
    image, reference = np.asarray(image), np.asarray(reference)
    if image.shape != reference.shape or image.ndim not in (2, 3):
        raise BadData(
            f"pictures of shapes {image.shape} and {reference.shape}; wanted both (rows, cols, channels) "
            "or (rows, cols)"
        )
    if image.dtype.kind not in "uif" or reference.dtype.kind not in "uif":
        raise BadData(f"pictures of types {image.dtype} and {reference.dtype}; wanted numbers")
    if int(border) != border or border < 0:
        raise OutOfRange("border", border, "a whole number of pixels, border >= 0")
    if peak is None:
        peak = np.iinfo(reference.dtype).max if reference.dtype.kind in "ui" else 1.0
    if not 0 < peak < np.inf:
        raise OutOfRange("peak", peak, "0 < peak < inf")
    rows, cols = (count - 2 * int(border) for count in image.shape[:2])
    if min(rows, cols) < least:
        raise BadData(
            f"pictures of {image.shape[0]} x {image.shape[1]} pixels (channels come last): wanted {least} "
            f"or more rows and columns inside the border of {border}"
        )
    cut = np.s_[border : border + rows, border : border + cols]
    image, reference = (
        one[cut].astype(np.float64).reshape(rows, cols, -1) for one in (image, reference)
    )
    if not (np.isfinite(image).all() and np.isfinite(reference).all()):
        raise BadData("pictures: NaN or infinite values")
    return image, reference, float(peak)

"""Scene depth from the distances of renderers."""

import numpy as np

from gpusim.domain.errors import BadFile, OutOfRange, check_known

ALONG = ("axis", "ray", "none")
FAR = 1e6  # [m] depth of nothing: 0 (Mitsuba) or infinite; Blender's 1e10 m may stay


def check_depth(along: str, fov: float | None):
    """Raise UnknownName unless `along` is in ALONG, OutOfRange if "ray" has no field of view."""
    check_known("depth", along, ALONG)
    if along == "ray" and not (fov is not None and 0 < fov < np.pi):
        allowed = 'the horizontal field of view [rad], 0 < fov < pi, with depth = "ray"'
        raise OutOfRange("fov", fov, allowed)


def axial_depth(
    path, channel: str, distances: np.ndarray, along: str, fov: float | None
) -> np.ndarray:
    """Return the depth along the optical axis [m], shape (rows, cols), float32.

    distances: [m], of the same shape; 0 and infinity mean nothing there. along: direction of the
    distances, the "axis" or each pixel's "ray" from the pinhole. fov: horizontal field of view
    [rad], for rays: square pixels, the axis in the middle. Raises BadFile.
    """
    if not distances.min() >= 0:  # also true for NaN
        raise BadFile(
            path,
            f"channel {channel!r}: depth that is negative or NaN (lowest {distances.min():.3g}); "
            'wanted metres; or ignore it with depth = "none"',
        )
    depth = distances.astype(np.float32)
    if along == "ray":
        assert fov is not None  # checked before the file was read
        rows, cols = depth.shape
        step = 2 * np.tan(fov / 2) / cols
        y, x = (np.arange(rows) + 0.5 - rows / 2) * step, (np.arange(cols) + 0.5 - cols / 2) * step
        depth /= np.sqrt(1 + x**2 + y[:, None] ** 2)
    depth[(depth == 0) | np.isinf(depth)] = FAR
    return depth

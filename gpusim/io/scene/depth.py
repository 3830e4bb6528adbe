"""Distances as renderers write them, made into a scene's depth."""

import numpy as np

from gpusim.domain.errors import BadFile, OutOfRange, UnknownName

ALONG = ("axis", "ray", "none")
FAR = 1e6  # [m] of what renderers call nothing there: 0 (Mitsuba) or infinite; Blender's 1e10 m may stay


def check_depth(along: str, fov: float | None):
    """Raise UnknownName unless `along` is one of ALONG, OutOfRange where rays lack a field of view."""
    if along not in ALONG:
        raise UnknownName("depth", str(along), ALONG)
    if along == "ray" and not (fov is not None and 0 < fov < np.pi):
        raise OutOfRange(
            "fov", fov, 'the horizontal field of view [rad], 0 < fov < pi, with depth = "ray"'
        )


def axial(path, channel: str, distances: np.ndarray, along: str, fov: float | None) -> np.ndarray:
    """Depth along the optical axis [m], shape (rows, cols), float32.

    distances: [m], of the same shape, "along" the "axis", or from the pinhole along each pixel's "ray"; 0 and infinity:
    nothing is there. fov: horizontal [rad], for rays: square pixels, the axis in the middle. Raises BadFile.
    """
    if not distances.min() >= 0:  # NaN is refused as well
        raise BadFile(
            path,
            f"channel {channel!r}: depth that is negative or NaN (lowest {distances.min():.3g}); "
            'wanted metres, or leave it with depth = "none"',
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

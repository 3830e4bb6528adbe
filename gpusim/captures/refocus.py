"""Pictures from the views of a light field, focused elsewhere or by another aperture, by shift and add."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gpusim.backends import Device, open_device
from gpusim.domain.errors import BadData, Conflict, DoesNotFit, OutOfRange
from gpusim.domain.memory import require_memory
from gpusim.domain.progress import announce_each
from gpusim.domain.view_images import ViewImages
from gpusim.kernels.processor.refocus import refocus as shift_and_add

STEP = 0.5  # [pixel] displacement of the outermost views from one slope to the next
MOST_SLOPES = 1000
AT_ONCE = 2**26  # [byte] of pictures that one launch makes


def refocus(
    views: ViewImages,
    *,
    distance: float | None = None,
    slope: float | None = None,
    aperture: float | np.ndarray | None = None,
    device: Device | str = "auto",
) -> np.ndarray:
    """Return the picture of a lens that is focused at a distance.

    Views are displaced so that things at the distance coincide, and averaged. See `processor.refocus`
    for the interpolation and its loss of fine detail.

    Args:
        views: The views.
        distance: Distance in focus [m]; None: the views' own, or `slope`.
        slope: Displacement of things in focus [pixel per radius], in place of `distance`.
        aperture: Aperture of the lens, see `ViewImages.weigh`: the radius of a disc in radii of the
            pupil, or a weight for each view. None: all views.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear picture in the views' unit, float32, shape (rows, cols, C).

    Raises:
        BadData: `views` is no ViewImages, or the aperture has a wrong shape or no light.
        Conflict: Both a distance and a slope are given.
        OutOfRange: The distance or radius is not positive, or the slope not finite.
        DoesNotFit: The views do not fit into the device's memory.
    """
    checked_views(views)
    if distance is not None and slope is not None:
        raise Conflict("slope", "a distance is given too", "leave one of them out")
    if distance is not None:
        slope = float(views.slope_at(distance))
    return focus_stack(views, slopes=[slope or 0.0], aperture=aperture, device=device)[0]


def focus_stack(
    views: ViewImages,
    *,
    distances: Sequence[float] | None = None,
    slopes: Sequence[float] | None = None,
    aperture: float | np.ndarray | None = None,
    device: Device | str = "auto",
) -> np.ndarray:
    """Return pictures focused at several distances.

    Args:
        views: The views.
        distances: Distances in focus [m].
        slopes: Displacements of things in focus [pixel per radius], in place of `distances`.
        aperture: As for `refocus`.
        device: As for `refocus`.

    Returns:
        Linear pictures, float32, shape (K, rows, cols, C).

    Raises:
        BadData: As for `refocus`; or there is no distance.
        Conflict: Both or none of `distances` and `slopes` are given.
        OutOfRange: As for `refocus`.
        DoesNotFit: The views or the pictures do not fit into memory.
    """
    checked_views(views)
    if (distances is None) == (slopes is None):
        raise Conflict("slopes", "one of distances and slopes is wanted", "give one of them")
    at = checked_slopes(views.slope_at(distances) if slopes is None else slopes)
    shape = (len(at), *views.values.shape[2:])
    require_memory(f"{len(at)} pictures of {views.name}", 4 * int(np.prod(shape)))
    out = np.empty(shape, np.float32)
    planes = view_planes(views.values)
    for k, picture in enumerate(focus_each(views, planes, at, aperture, device)):
        out[k] = np.moveaxis(picture, 0, -1)
    return out


def focus_each(
    views: ViewImages,
    planes: np.ndarray,
    slopes: np.ndarray,
    aperture: float | np.ndarray | None = None,
    device: Device | str = "auto",
    has_variance: bool = False,
) -> Iterator[np.ndarray]:
    """Yield the pictures of slopes one by one, and their variance over the views.

    Args:
        views: The views.
        planes: Their pictures, shape (T S, C, rows, cols).
        slopes: The slopes [pixel per radius], shape (K,).
        aperture: As for `refocus`.
        device: As for `refocus`.
        has_variance: Whether the planes of the variance follow.

    Yields:
        Planes, shape (C, rows, cols) or (2 C, rows, cols).

    Raises:
        DoesNotFit: The views do not fit into the device's memory.
    """
    device = open_device(device) if isinstance(device, str) else device
    places = views.places.reshape(-1, 2).astype(np.float32)
    weights = views.weigh(aperture).ravel()
    weights = (weights / weights.max()).astype(np.float32)
    one = (1 + has_variance) * planes[0].nbytes
    count = max(1, min(len(slopes), AT_ONCE // one))
    copies = 4 if device.kind == "numpy" else 1  # float64, and views that are displaced
    needed = copies * planes.nbytes + (1 + copies) * count * one
    what = f"{views.name} ({len(planes)} views)"
    if needed > device.memory:
        raise DoesNotFit(what, needed, device.memory, device.name)
    if planes.nbytes > device.largest_array:
        raise DoesNotFit(f"one array of {what}", planes.nbytes, device.largest_array, device.name)
    arrays = planes, places, weights
    if device.kind != "numpy":
        arrays = tuple(device.array(array) for array in arrays)
    parts = [slopes[first : first + count] for first in range(0, len(slopes), count)]

    def done(number):
        return f"refocusing, {number * count} of {len(slopes)} pictures"

    for part in announce_each(parts, done):
        found = shift_and_add(
            *arrays, part.astype(np.float32), has_variance=has_variance, device=device
        )
        yield from device.numpy(found)


def view_planes(values: np.ndarray) -> np.ndarray:
    """Return views with planes first.

    Args:
        values: Shape (T, S, rows, cols, C).

    Returns:
        Shape (T S, C, rows, cols), float32, contiguous; the same memory if it has this order.

    Raises:
        DoesNotFit: The copy does not fit into memory.
    """
    require_memory("views", values.nbytes)
    planes = np.moveaxis(values, -1, 2)
    return np.ascontiguousarray(planes, np.float32).reshape(-1, *planes.shape[2:])


def slopes_between(views: ViewImages, distances: Sequence[float] | None = None) -> np.ndarray:
    """Return slopes that cover distances, STEP apart for the outermost view, with one more at each end.

    Args:
        views: The views.
        distances: Nearest and farthest distance [m]; None: from half the object distance to
            infinity.

    Returns:
        Slopes, ascending, shape (K,).

    Raises:
        BadData: `distances` is no pair.
        OutOfRange: The range is empty, needs too many slopes, or is not known.
    """
    if distances is None:
        if not np.isfinite(views.object_distance):
            allowed = "nearest and farthest distance [m], for views that are aligned at infinity"
            raise OutOfRange("distances", None, allowed)
        distances = views.object_distance / 2, np.inf
    try:
        near, far = (float(one) for one in distances)
    except (TypeError, ValueError):
        raise BadData(
            f"distances = {distances!r}: wanted the nearest and the farthest [m]"
        ) from None
    if not 0 < near <= far:
        raise OutOfRange("distances", (near, far), "0 < nearest <= farthest [m]")
    low, high = sorted(float(views.slope_at(one)) for one in (near, far))
    step = STEP / max(float(np.abs(views.places).max()), 1e-9)
    count = int(np.ceil((high - low) / step)) if (high - low) / step < MOST_SLOPES else MOST_SLOPES
    if count >= MOST_SLOPES:
        allowed = f"a range of fewer than {MOST_SLOPES} slopes {step:.3g} pixels apart"
        raise OutOfRange("distances", (near, far), allowed)
    middle = (low + high) / 2
    return middle + step * (np.arange(count + 3) - (count + 2) / 2)


def checked_views(views: Any) -> ViewImages:
    """Return `views`. Raise BadData if they are no ViewImages."""
    if not isinstance(views, ViewImages):
        raise BadData(
            f"views: {type(views).__name__}, wanted ViewImages, for example of open_views"
        )
    return views


def checked_slopes(slopes: Any) -> np.ndarray:
    """Return slopes, float64 (K,). Raise BadData or OutOfRange."""
    try:
        found = np.asarray(slopes, np.float64)
    except (TypeError, ValueError):
        raise BadData("slopes: wanted numbers") from None
    if found.ndim != 1 or not found.size:
        raise BadData(f"slopes: shape {found.shape}, wanted one or more numbers")
    if not np.isfinite(found).all():
        raise OutOfRange("slope", found[~np.isfinite(found)][0], "a finite number")
    return found

"""The world outside the frame: dark, the outermost pixel repeated, or mirrored."""

from collections.abc import Sequence
from typing import Any

from gpusim.backends import Device
from gpusim.kernels.stage import is_opencl_cpu

BORDERS = {"zero": 0, "edge": 1, "reflect": 2}


def extend(
    device: Device,
    planes: Any,
    border: str,
    before: Sequence[int],
    period: Sequence[int],
    first: int = 0,
    size: int | None = None,
) -> Any:
    """Return planes with their surroundings.

    Args:
        device: The device.
        planes: Planes, shape (planes, rows, cols).
        border: "zero", "edge" or "reflect".
        before: Row and column of the planes' first pixel in the result.
        period: Rows and columns of the result.
        first: First of the planes.
        size: Number of planes; None for all from `first` on.

    Returns:
        Extended planes, shape (size, *period), float32 of the device.
    """
    count, rows, cols = planes.shape
    extended = device.empty((count - first if size is None else size, *period))
    if is_opencl_cpu(device):
        grid, group = extended.shape[:2], (1, 1)
    else:
        grid, group = extended.shape, None
    arrays = [planes, extended]
    defines = {"GPU": 1} if device.is_gpu else None
    sizes = [BORDERS[border], first, *before, extended.shape[0], rows, cols, *period]
    device.launch("common.border", "extend", grid, *arrays, *sizes, group=group, defines=defines)
    return extended

"""The world outside the frame: dark, the outermost pixel going on, or mirrored."""

BORDERS = {"zero": 0, "edge": 1, "reflect": 2}


def extend(device, planes, border, before, period, first=0, size=None):
    """Planes `first` .. `first + size`, by default all, with what is around them filled in as `border` says.

    planes: (planes, rows, cols) of the device. before: place (row, column) of their first pixel in the result. period:
    (rows, cols) of the result. Returns shape (size, *period).
    """
    count, rows, cols = planes.shape
    extended = device.empty((count - first if size is None else size, *period))
    if device.kind == "opencl" and not device.is_gpu:
        grid, group = extended.shape[:2], (1, 1)
    else:
        grid, group = extended.shape, None
    device.launch(
        "common.border",
        "extend",
        grid,
        planes,
        extended,
        BORDERS[border],
        first,
        *before,
        extended.shape[0],
        rows,
        cols,
        *period,
        group=group,
        defines={"GPU": 1} if device.is_gpu else None,
    )
    return extended

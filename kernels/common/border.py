"""The world outside the frame: dark, the outermost pixel going on, or mirrored."""

BORDERS = {"zero": 0, "edge": 1, "reflect": 2}


def extend(device, planes, first, size, border, period):
    """Planes `first` .. `first + size` centred in a period, what is around them filled in as `border` says.

    planes: (planes, rows, cols) of the device. period: (rows, cols) of the result, at least those of the planes.
    Returns shape (size, *period); the first pixel of the planes is at (period - (rows, cols)) // 2.
    """
    _, rows, cols = planes.shape
    before = tuple((length - n) // 2 for length, n in zip(period, (rows, cols), strict=True))
    extended = device.empty((size, *period))
    device.launch("common.border", "extend", extended.shape, planes, extended, first, BORDERS[border], *before,
                  rows, cols, *extended.shape)
    return extended

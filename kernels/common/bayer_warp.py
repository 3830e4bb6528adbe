"""Walking a Bayer mosaic row by row, as in bayer.clh."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it


@wp.func
def mirror(i: int, n: int):
    """Return index `i` of an axis of `n` pixels, mirrored without repeating the end pixel."""
    if i >= 0 and i < n:
        return i
    if n == 1:
        return 0
    period = 2 * (n - 1)
    j = wp.abs(i) % period
    return wp.min(j, period - j)


@wp.func
def outside(i: int, n: int, period: int):
    """Return the pixel in place of pixel i: mirrored, or whole periods away."""
    j = i
    if i < 0 or i >= n:
        if period <= 2:
            j = mirror(i, n)
        elif i < 0:
            j = (i % period + period) % period
        else:
            j = n - period + (i - n) % period
    return j


@wp.func
def own_plane(y: int, red_row: int):
    """Return the plane of the colour that row `y` samples besides green: 0 (red) or 2 (blue)."""
    return 2 * ((y ^ red_row) & 1)


@wp.func
def first_own(y: int, red_row: int, red_col: int):
    """Return the first column (0 or 1) of that colour in row `y`."""
    return red_col ^ ((y ^ red_row) & 1)

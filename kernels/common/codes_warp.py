"""Display codes by table, as in codes.clh."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it


@wp.func
def code(linear: float, entries: wp.array1d[wp.uint32], bottom: float, top: float, shift: int):
    """Return the display code of a linear value."""
    value = bottom
    if linear > bottom:  # NaN is black
        value = wp.min(linear, top)
    place = wp.cast(value, wp.uint32) - wp.cast(bottom, wp.uint32)
    return wp.uint8((entries[int(place >> wp.uint32(shift))] + place) >> wp.uint32(shift))

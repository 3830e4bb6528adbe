"""The cubic interpolant of Keys."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it


@wp.func
def keys(s: float):
    """Return the weights of the samples at -1, 0, 1, 2 at 0 <= s < 1, after Keys."""
    r = 1.0 - s
    return wp.vec4(
        -0.5 * s * r * r,
        1.0 - s * s * (2.5 - 1.5 * s),
        1.0 - r * r * (2.5 - 1.5 * r),
        -0.5 * s * s * r,
    )

"""Part of the frame that the page shows, enlarged by a whole number, without loss."""

from dataclasses import dataclass, replace

ENLARGED = (1, 2, 4, 8, 16)  # pixels of the screen along one of the frame


@dataclass(frozen=True)
class Crop:
    """Part of a frame.

    top, left, rows, cols: [pixel]. times: screen pixels per pixel along each axis.
    """

    top: int
    left: int
    rows: int
    cols: int
    times: int

    @property
    def part(self) -> tuple[slice, slice]:
        """Slices of its rows and columns."""
        return slice(self.top, self.top + self.rows), slice(self.left, self.left + self.cols)

    def fits(self, shape: tuple[int, ...]) -> bool:
        """Return whether it lies inside a frame of this shape (rows, columns ...)."""
        return self.top + self.rows <= shape[0] and self.left + self.cols <= shape[1]

    def move(self, down: int, right: int, shape: tuple[int, int]) -> "Crop":
        """Return the crop moved by some pixels, inside a frame of this shape."""
        top = min(max(self.top + down, 0), shape[0] - self.rows)
        left = min(max(self.left + right, 0), shape[1] - self.cols)
        return replace(self, top=top, left=left)


def enlarge(
    crop: Crop | None, step: int, at: tuple[int, int], shape: tuple[int, int], width: int
) -> Crop | None:
    """Return the next larger (step 1) or smaller (-1) crop around a pixel; None: the whole frame.

    at: row and column that stay in place. shape: of the frame. width: of the picture on the screen
    [pixel].
    """
    rows, cols = shape
    known = [times for times in ENLARGED if times * cols > width]
    place = known.index(crop.times) if crop and crop.times in known else -1
    if (place := min(place + step, len(known) - 1)) < 0:
        return None
    times = known[place]
    wide = max(1, round(width / times))
    high = min(rows, max(1, round(wide * rows / cols)))
    own = crop or Crop(0, 0, rows, cols, 0)
    share = ((at[0] - own.top) / own.rows, (at[1] - own.left) / own.cols)
    corner = Crop(0, 0, high, wide, times)
    return corner.move(round(at[0] - share[0] * high), round(at[1] - share[1] * wide), shape)

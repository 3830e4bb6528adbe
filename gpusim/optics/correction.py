"""Lens corrections: where the developed picture finds its colours in the picture that the lens made."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.calibration import Framed
from gpusim.domain.distortion import fit_to_frame
from gpusim.domain.optics import Optics
from gpusim.domain.spectrum import values_of

STEP = 8  # [pixel] between nodes: bilinear offsets then err by 0.003 pixel at 5 % distortion of a 1080p frame
EDGE_PLACES = 257  # along each side of a frame, at which the corrected picture must find light
HALVINGS = 40  # of the magnification: to 1e-12


@dataclass(frozen=True, eq=False)
class LensCorrection:
    """Distortion and lateral colour of a lens, for the stage `processor.rectify`.

    The corrected picture is that of a pinhole with the nominal focal length. Where a lens spreads
    its picture beyond the frame, such as a pincushion, it is magnified until it fills the frame.

    Attributes:
        optics: The lens.
        pitch: Distance of the sensor's pixels [m].
        displacement: Of the pixel grid from the lens's axis, (rows, cols) [pixel].
        binning: Pixels that are binned, along columns and along rows.
        excess: Image height in each plane over the height at the nominal wavelength, minus one;
            one for all planes, or one for each.
    """

    optics: Optics
    pitch: float
    displacement: tuple[float, float]
    binning: tuple[int, int]
    excess: tuple[float, ...]

    @property
    def is_needed(self) -> bool:
        """False if the lens has neither distortion nor lateral colour: nothing is to correct."""
        return self.optics.distortion is not None or any(self.excess)

    @property
    def words(self) -> str:
        """Line of the report."""
        names = ["distortion"] * (self.optics.distortion is not None)
        names += ["lateral colour"] * any(self.excess)
        return f"{' and '.join(names)} of the lens undone, cubic interpolation"

    def nodes(self, shape: tuple[int, int]) -> np.ndarray:
        """Return nodes for `processor.rectify`, float32 (1 or planes, 2, ny, nx).

        Args:
            shape: Rows and columns of the picture [pixel, binned].

        Raises:
            OutOfRange: A calibration is of another aspect ratio.
        """
        whole = shape[0] * self.binning[0], shape[1] * self.binning[1]
        zoom = magnification(self.optics, whole, self.pitch, self.displacement)
        down, across = (shift * self.pitch for shift in self.displacement)
        edges = [np.linspace(0, n, max(2, -(-n // STEP) + 1)) - 0.5 for n in shape]
        rows, cols = np.meshgrid(*edges, indexing="ij")
        y, x = (
            (at + 0.5 - n / 2) * parts * self.pitch
            for at, n, parts in zip((rows, cols), shape, self.binning, strict=True)
        )
        maps = []
        for excess in self.excess:
            ideal = zoom * (y + down), zoom * (x + across)
            v, u = _image(self.optics, whole, self.pitch, *ideal, excess)
            places = v - down, u - across
            moved = [
                place / (parts * self.pitch) + n / 2 - 0.5 - at
                for place, n, parts, at in zip(
                    places, shape, self.binning, (rows, cols), strict=True
                )
            ]
            maps.append(moved)
        return np.array(maps, np.float32)


def magnification(
    optics: Optics,
    shape: tuple[int, int],
    pitch: float,
    displacement: tuple[float, float] = (0.0, 0.0),
) -> float:
    """Return the distance of a pinhole's points from the axis over the distance in the corrected picture.

    It is 1, or less if the corrected picture would else look beyond the frame.

    Args:
        optics: The lens.
        shape: Rows and columns of the frame [pixel].
        pitch: Pixel pitch [m].
        displacement: Of the pixel grid from the lens's axis, (rows, cols) [pixel].

    Raises:
        OutOfRange: A calibration is of another aspect ratio.
    """
    half_y, half_x = (n * pitch / 2 for n in shape)
    down, across = (shift * pitch for shift in displacement)
    along = np.linspace(-1, 1, EDGE_PLACES)
    y = down + half_y * np.concatenate([along, along, along * 0 - 1, along * 0 + 1])
    x = across + half_x * np.concatenate([along * 0 - 1, along * 0 + 1, along, along])
    excess = max(0.0, float(np.max(values_of(optics.lateral_color), initial=0.0)))

    def is_inside(zoom):
        found = _image(optics, shape, pitch, zoom * y, zoom * x, excess)
        return all(
            np.abs(place - shift).max() <= half * (1 + 1e-9)
            for place, shift, half in zip(found, (down, across), (half_y, half_x), strict=True)
        )

    if is_inside(1.0):
        return 1.0
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if is_inside(middle) else (low, middle)
    return low


def _image(optics, shape, pitch, y, x, excess):
    """Return where the lens images ideal places (y, x) [m], with an excess of the image height."""
    middle = 0.0, 0.0
    if optics.distortion is not None:
        model = fit_to_frame(optics.distortion, shape, pitch)
        x, y = (part * model.radius for part in model.distort(x / model.radius, y / model.radius))
        if isinstance(model, Framed):
            middle = tuple(at * model.radius for at in model.middle)  # (x, y)
    return y + excess * (y - middle[1]), x + excess * (x - middle[0])

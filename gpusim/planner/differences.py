"""Kernels of a lens over the field, less those on its axis: what a model of the field has to follow."""

import numpy as np

from gpusim.domain.errors import OutOfRange
from gpusim.optics.field import image_error
from gpusim.optics.lens import Lens, wavelength_nodes

WIDEST_SHIFT = 12  # [pixel] of a wavelength's image at the frame's corner
SIZES = (15, 23, 31, 41, 51, 63, 81, 101)  # of kernels [pixel]


class Differences:
    """Kernels of planes less those on the axis, as planner/field.py calls a lens; they sum to 0 at all places.

    So a point's energy is the same all over the field, and a flat field is the sum of its points: brighter where a lens
    moves them together.

    What a lens spreads farthest, the diffraction at its pupil's edge, is nearly the same all over the field: the
    differences end where the kernels go on, and a convolution of the whole frame with the kernels on the axis gives
    the rest.

    lens: see `open_lens`. wavelengths, mix: weight of each wavelength [nm] in each plane, shape (planes, L).
    shape: (rows, cols) of the planes. corner: distance of the frame's corner from the middle [pixel]. error: relative
    RMS of a natural image that the end of the kernels may cost. Raises OutOfRange where no size of SIZES is enough.
    """

    def __init__(self, lens: Lens, wavelengths, mix, shape, corner, error):
        self.lens, self.shape, self.corner = lens, shape, corner
        self.middle = (np.array(shape) - 1) / 2 + lens.axis
        self.nodes, between = wavelength_nodes(wavelengths)
        self.mix = mix @ between
        self.size = self._enough(error)
        self._axis = self.lens.kernels(self.nodes, (0.0, 0.0), self.size)
        self._known: dict = {}

    def __call__(self, places) -> np.ndarray:
        """Differences at `places`, (row, column) of the planes, shape (n, 2): float64 (n, planes, size, size)."""
        kernels = np.empty((len(places), len(self.mix), self.size, self.size))
        for kernel, (y, x) in zip(
            kernels, (np.asarray(places, np.float64) - self.middle) / self.corner, strict=True
        ):
            if self.lens.symmetry.is_mirrored:  # the other quadrants are mirror images
                kernel[:] = self._at(abs(y), abs(x))[
                    :, :: -1 if y < 0 else 1, :: -1 if x < 0 else 1
                ]
            else:
                kernel[:] = self._at(y, x)
        return kernels

    def _at(self, y, x):
        key = round(y, 9), round(x, 9)
        if key not in self._known:
            kernels = self.lens.kernels(self.nodes, (y, x), self.size)
            self._known[key] = np.tensordot(
                self.mix, self._whole(_even(kernels - self._axis), (y, x)), 1
            )
        return self._known[key]

    def _whole(self, differences, place):
        """Differences whose first moments are those of all the light: what moves beyond them is added as a slope."""
        if self.lens.tail is None:
            return differences  # the kernels hold all light
        wanted = self.lens.centroids(self.nodes, place) - self.lens.centroids(
            self.nodes, (0.0, 0.0)
        )
        at = np.arange(self.size) - self.size // 2
        left = wanted - np.stack(
            [differences.sum(axis=2) @ at, differences.sum(axis=1) @ at], axis=1
        )
        y, x = left.T[..., None, None] / (self.size * (at @ at))
        return differences + y * at[:, None] + x * at

    def _enough(self, error):
        """Size of kernels beyond which the differences at the corners cost less than `error`."""
        least = self.lens.least_size
        corner = farthest_corner(self.shape, self.middle) / self.corner
        shift = (
            np.abs(self.lens.optics.lateral_color_at(self.nodes)).max()
            * self.corner
            * np.hypot(*corner)
        )
        if shift > WIDEST_SHIFT:
            raise OutOfRange(
                "optics.lateral_color",
                f"{shift:.3g} pixels at the frame's corner",
                f"up to {WIDEST_SHIFT} pixels; or a coarser pixel",
            )
        middle = [self.nodes[len(self.nodes) // 2]]
        whole, axis = (
            self.lens.kernels(middle, place, max(SIZES[-1], least))
            for place in (corner, (0.0, 0.0))
        )
        for size in SIZES:
            if size >= least:
                cut = _even(whole - axis)[None]
                inner = slice(whole.shape[1] // 2 - size // 2, whole.shape[1] // 2 + size // 2 + 1)
                cut[..., inner, inner] = 0
                if image_error(cut, np.zeros_like(cut))[0] <= error:
                    return size
        raise OutOfRange(
            "field variation",
            f"kernels at the frame's corner wider than {SIZES[-1]} pixels",
            "narrower ones; or a coarser pixel",
        )


def farthest_corner(shape, axis) -> np.ndarray:
    """The corner of a frame of `shape` that lies farthest from `axis`, (row, column) [pixel], seen from there."""
    last = np.array(shape) - 1.0
    return np.where(axis <= last / 2, last - axis, -axis)


def _even(differences):
    """The same with sums of zero: what a lens spreads beyond the kernels on the axis, or elsewhere, is taken evenly."""
    return differences - differences.mean(axis=(1, 2), keepdims=True)

"""Choices of a plan: the parts that its frames are made of. A frame does without the parts that it does not list."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.account import Tolerance
from gpusim.optics.sampling import Taps


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes made of content entries (bands, basis coefficients or materials); without it, the entries are the planes.

    Attributes:
        table: Planes from entries, shape (planes, entries).
    """

    table: np.ndarray


@dataclass(frozen=True, eq=False)
class Blur:
    """Blur of planes by transforms; without it, the planes are the channels.

    Attributes:
        mix: Channels from blurred planes, shape (C, planes).
        period: Lengths of the transforms [sample].
        folded: Whether the blur gives the mosaic at once, in transforms of its phases.
        spare: Blurred samples around the scene's that are used.
        rim: Samples around the scene's and its margin that the lens has displaced, too.
    """

    mix: np.ndarray
    period: tuple[int, int]
    folded: bool = False
    spare: int = 0
    rim: int = 0


@dataclass(frozen=True, eq=False)
class Fusion:
    """Planes that stand for several wavelengths; without it, each plane is one wavelength.

    Attributes:
        transfers: Weight of each wavelength's transfer function in a plane's transfer function for
            a channel, shape (C, planes, L). A blur that varies over the field has planes of one
            channel each, shape (1, planes, L).
    """

    transfers: np.ndarray


@dataclass(frozen=True)
class Sketch:
    """Blur of a draft: planes are channels, and the lens is one kernel of each, cut off.

    Attributes:
        radius: Of the kernels [sample].
    """

    radius: int


@dataclass(frozen=True, eq=False)
class WorstKernels:
    """Error of the kernels of a blur that varies over the field, at the worst place.

    Attributes:
        table: Planes from spectra, shape (planes, L).
        kernels: Errors of the planes' kernels, shape (planes, m, m).
        mix: Channels from planes, shape (C, planes).
        ratio: Their error of a natural scene over its root mean square over the frame.
    """

    table: np.ndarray
    kernels: np.ndarray
    mix: np.ndarray
    ratio: float


@dataclass(frozen=True, eq=False)
class Sampling:
    """Pixels made of several samples; without it, each pixel is one sample.

    Attributes:
        rows: Weights of the samples in the rows of pixels.
        cols: The same for the columns.
    """

    rows: Taps
    cols: Taps


@dataclass(frozen=True, eq=False)
class Falloff:
    """Fall-off of every pixel beyond the cos^4 law of a grid of pixels in the middle.

    Attributes:
        gains: Relative response, shape (rows, cols). With a relative illumination that is given,
            gains times the flat field of the lens's points is that curve.
        field: Flat field of a blur that varies, the part of the lens's points that the gains have
            taken out, shape (rows, cols); None if they have not.
    """

    gains: np.ndarray
    field: np.ndarray | None = None


@dataclass(frozen=True)
class Goal:
    """Tolerance that a plan is judged by.

    Attributes:
        tolerance: The limits.
        remedy: Advice for meeting them, used if they are not met.
    """

    tolerance: Tolerance
    remedy: str = ""

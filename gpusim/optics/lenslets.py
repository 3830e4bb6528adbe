"""Geometry of a lenslet array: where the lenslets lie, which samples they need, and where rays land.

A ray from the place s R of the exit pupil (R its radius, s within -1 .. 1, Z its distance) through the
place x of the lenslets' plane has the slope (x - s R) / Z. The thin lenslet with its centre at c turns
it by -(x - c) / f. At the gap g behind, it lands at

    X = x + g ((x - s R) / Z - (x - c) / f) = x + tilt (x - axis) - radius s - power (x - c),

with tilt = g / Z, radius = g R / Z = g / (2 N), N the working f-number, and power = g / f. Source: the
matrices of paraxial rays, Hecht, Optics, 6.2.
"""

import warnings
from dataclasses import dataclass
from math import ceil, cos, pi, sin, sqrt

import numpy as np

from gpusim.domain.errors import OutOfRange, checked_count
from gpusim.domain.lenslets import Lenslets
from gpusim.domain.optics import Optics
from gpusim.domain.sensor import Sensor

SPREAD = 0.1  # pixels over which a lenslet may spread a ray of its rim: below, all of its light lands at one place
OVERLAP = (
    0.01  # of the lenslets' pitch; less overlap of the images of the pupil is not worth a warning
)


@dataclass(frozen=True)
class LensletPlane:
    """Lenslets, pixels and samples of light in one frame; all lengths in pixels from its middle.

    Attributes:
        lattice: Steps from a lenslet to its neighbours, two of (rows, cols) [pixel].
        origin: Centre of lenslet (0, 0), (rows, cols) [pixel].
        normals: Directions from a lenslet to the sides of its cell, unit vectors (rows, cols): two for squares, three
            for hexagons; each stands for the opposite side, too.
        pitch: Distance between neighbours [pixel].
        fill: Width of the clear aperture over the pitch [1].
        axis: Place of the optical axis, (rows, cols) [pixel].
        tilt: Gap over the distance of the exit pupil, g / Z [1].
        power: Gap over focal length, g / f [1].
        radius: Radius of the pupil's image behind a lenslet, g / (2 N) [pixel].
        spots: Distance of the first zero of a square lenslet's diffraction, wavelength times gap over the clear width,
            per channel [pixel].
        aperture: Height and width of the pixels' apertures [pixel].
        step: Distance between samples [pixel].
        start: Centre of the first sample, (rows, cols) [pixel].
    """

    lattice: tuple[tuple[float, float], tuple[float, float]]
    origin: tuple[float, float]
    normals: tuple[tuple[float, float], ...]
    pitch: float
    fill: float
    axis: tuple[float, float]
    tilt: float
    power: float
    radius: float
    spots: tuple[float, ...]
    aperture: tuple[float, float]
    step: float
    start: tuple[float, float]

    @property
    def is_separable(self) -> bool:
        """Whether rows and columns do not depend on each other: squares along the pixels."""
        return len(self.normals) == 2 and abs(self.lattice[0][0]) < 1e-9 * self.pitch

    @property
    def spread(self) -> float:
        """Distance at which two rays of one direction land, over their distance in a lenslet [1]."""
        return 1 + self.tilt - self.power

    @property
    def is_focused_on_pupil(self) -> bool:
        """Whether all rays from one place of the pupil land at one place behind a lenslet."""
        return abs(self.spread) * self.pitch <= SPREAD


@dataclass(frozen=True)
class LensletSamples:
    """Samples of the light in the lenslets' plane that a capture must simulate.

    A frame of `shape` pixels, with the pixel pitch `pitch`, a fill factor of 1 and the sensor's offset `offset`, has
    these samples, with the main lens in place.

    Attributes:
        shape: Rows and columns of samples.
        pitch: Distance between samples [m].
        offset: Displacement of the grid of samples from the middle of the picture, (rows, cols) [sample].
        pixels: Rows and columns of the sensor's pixels.
    """

    shape: tuple[int, int]
    pitch: float
    offset: tuple[float, float]
    pixels: tuple[int, int]


def lenslet_vectors(
    pitch: float, rotation: float, layout: str
) -> tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float], ...]]:
    """Return the steps between neighbours, and the directions of the sides of a lenslet's cell.

    Args:
        pitch: Distance between neighbours, any unit.
        rotation: Direction of the rows of lenslets, from columns towards rows [rad].
        layout: "square" or "hexagonal".

    Returns:
        Two steps (rows, cols) in the unit of `pitch`, and two or three unit vectors (rows, cols).
    """
    turns = (0.0, pi / 2) if layout == "square" else (0.0, pi / 3, 2 * pi / 3)
    directions = tuple(
        (_round(sin(rotation + turn)), _round(cos(rotation + turn))) for turn in turns
    )
    return tuple((pitch * y, pitch * x) for y, x in directions[:2]), directions


def _round(value):
    """Return 0 in place of the rounding error of a sine or cosine of a right angle."""
    return 0.0 if abs(value) < 1e-15 else value


def lenslet_grid(lenslets: Lenslets, shape: tuple[int, int], pixel_pitch: float) -> np.ndarray:
    """Return the centres of all lenslets over a sensor.

    Args:
        lenslets: The lenslets.
        shape: Rows and columns of pixels.
        pixel_pitch: [m].

    Returns:
        Centres as (row, column) of pixels, 0 at the first pixel's centre, shape (n, 2), row by row of the array.
    """
    lattice, _ = lenslet_vectors(lenslets.pitch / pixel_pitch, lenslets.rotation, lenslets.layout)
    middle = (np.array(shape) - 1) / 2
    origin = middle + np.array(lenslets.offset) / pixel_pitch
    across, down = index_range(lattice, origin - middle, shape, 0.0)
    b, a = np.meshgrid(np.arange(*down), np.arange(*across), indexing="ij")
    centres = origin + np.stack([a, b], -1).reshape(-1, 2) @ np.array(lattice)
    is_inside = ((centres >= -0.5) & (centres <= np.array(shape) - 0.5)).all(-1)
    return centres[is_inside]


def index_range(lattice, origin, shape, margin):
    """Return the first and the last index plus one, along both steps, of lenslets over a frame.

    Args:
        lattice: Steps between neighbours, two of (rows, cols) [pixel].
        origin: Centre of lenslet (0, 0) relative to the frame's middle [pixel].
        shape: Height and width of the frame [pixel].
        margin: Distance outside the frame that counts [pixel].
    """
    half = np.array(shape) / 2 + margin
    corners = np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * half - np.asarray(origin)
    places = corners @ np.linalg.inv(np.array(lattice))
    low = np.floor(places.min(0)).astype(int)
    high = np.ceil(places.max(0)).astype(int) + 1
    return (int(low[0]), int(high[0])), (int(low[1]), int(high[1]))


def lenslet_samples(
    lenslets: Lenslets, sensor: Sensor, optics: Optics, shape: tuple[int, int]
) -> LensletSamples:
    """Return the samples of light in the lenslets' plane that a frame needs.

    If all rays from one place of the pupil land at one place (the gap is the focal length), only the light of each
    lenslet counts: a square array along the pixels has one sample per lenslet, other arrays four samples per pitch, of
    which lenslets take their share by area. In a focused design a pixel is the image of a part of the lenslet: samples
    lie close enough to be at most half a pixel wide there, 4 to 16 per pitch.

    Args:
        lenslets: The lenslets.
        sensor: The sensor behind them.
        optics: The main lens.
        shape: Rows and columns of pixels.

    Returns:
        The samples; they cover all lenslets from which light reaches the pixels.

    Raises:
        OutOfRange: A lenslet is larger than the sensor.

    Warns:
        UserWarning: The images of the pupil overlap, or leave pixels unused.
    """
    rows, cols = (checked_count("rows and columns", size) for size in shape)
    pixel = sensor.pixel_pitch
    if lenslets.pitch > min(rows, cols) * pixel * (1 + 1e-9):
        raise OutOfRange(
            "sensor.lenslets.pitch",
            f"{lenslets.pitch * 1e6:.6g} um",
            f"at most the sensor's shorter side, {min(rows, cols) * pixel * 1e6:.6g} um; use smaller lenslets or more "
            "pixels",
        )
    for text in compare_f_numbers(lenslets, optics):
        warnings.warn(text, stacklevel=2)
    gap = lenslets.distance
    tilt = gap / optics.image_distance
    spread = abs(1 + tilt - gap / lenslets.focal_length)
    is_aligned = lenslets.layout == "square" and lenslets.rotation == 0
    if spread * lenslets.pitch <= SPREAD * pixel:
        count = 1 if is_aligned else 4
    else:
        count = min(max(4, ceil(2 * spread * lenslets.pitch / pixel)), 16)
    step = lenslets.pitch / count
    reach = gap / (2 * optics.working_f_number) + lenslets.pitch
    middle = np.add(sensor.offset, np.array(lenslets.offset) / pixel) * pixel  # from the axis [m]
    counts, offset = [], []
    for axis, size in enumerate((rows, cols)):
        lens, chip = middle[axis], sensor.offset[axis] * pixel
        edges = [(chip + sign * (size * pixel / 2 + reach)) / (1 + tilt) for sign in (-1, 1)]
        # boundaries of samples are boundaries of lenslets
        low, high = (round((edge - lens) / lenslets.pitch) for edge in edges)
        counts.append((high - low + 1) * count)
        offset.append(float(lens + (low + high) / 2 * lenslets.pitch) / step)
    return LensletSamples((counts[0], counts[1]), step, (offset[0], offset[1]), (rows, cols))


def compare_f_numbers(lenslets: Lenslets, optics: Optics) -> list[str]:
    """Return warnings if the f-numbers of main lens and lenslets do not fit, else none.

    Args:
        lenslets: The lenslets.
        optics: The main lens.

    Returns:
        Texts with the overlap, or with the share of pixels without light.
    """
    width = lenslets.distance / optics.working_f_number
    excess = width / lenslets.pitch - 1
    # discs in cells of a square or hexagonal array
    cell = 1.0 if lenslets.layout == "square" else sqrt(3) / 2
    numbers = (
        f"sensor.lenslets: the lens is f/{optics.working_f_number:.4g} at the image, the lenslets "
        f"f/{lenslets.f_number:.4g}"
    )
    if excess > OVERLAP:
        return [
            f"{numbers}: images of the pupil overlap by {100 * excess:.3g} % of the pitch; stop the lens down to "
            f"f/{lenslets.f_number:.4g}, or make the gap smaller"
        ]
    unused = 1 - pi / 4 * (1 + excess) ** 2 / cell
    if excess < -OVERLAP:
        return [
            f"{numbers}: {100 * unused:.3g} % of the pixels get no light; open the lens to f/{lenslets.f_number:.4g}, "
            "or make the gap larger"
        ]
    return []


def effective_wavelengths(sensor: Sensor) -> np.ndarray:
    """Return the mean wavelength of each channel's quantum efficiency [nm], shape (channels,)."""
    wavelengths, values = sensor.qe.wavelengths, sensor.qe.values
    total = np.trapezoid(values, wavelengths, axis=-1)
    mean = np.trapezoid(values * wavelengths, wavelengths, axis=-1)
    middle = (wavelengths[0] + wavelengths[-1]) / 2
    return np.divide(mean, total, out=np.full(len(values), middle), where=total > 0)


def lenslet_plane(sensor: Sensor, optics: Optics, samples: LensletSamples) -> LensletPlane:
    """Return the numbers of the stage `sensor.lenslets`.

    Args:
        sensor: A sensor with lenslets.
        optics: The main lens.
        samples: From `lenslet_samples`.

    Returns:
        The numbers.
    """
    lenslets, pixel = sensor.lenslets, sensor.pixel_pitch
    assert lenslets is not None
    gap = lenslets.distance
    lattice, normals = lenslet_vectors(lenslets.pitch / pixel, lenslets.rotation, lenslets.layout)
    # coordinates begin at the middle of the pixels' apertures
    axis = -np.array(sensor.displacement)
    step = samples.pitch / pixel
    start = axis + (np.array(samples.offset) - (np.array(samples.shape) - 1) / 2) * step
    origin = np.array(lenslets.offset) / pixel - np.array(sensor.centre)
    clear = lenslets.fill * lenslets.pitch
    height, width = sensor.aperture
    return LensletPlane(
        lattice=(lattice[0], lattice[1]),
        origin=(float(origin[0]), float(origin[1])),
        normals=normals,
        pitch=lenslets.pitch / pixel,
        fill=lenslets.fill,
        axis=(float(axis[0]), float(axis[1])),
        tilt=gap / optics.image_distance,
        power=gap / lenslets.focal_length,
        radius=gap / (2 * optics.working_f_number) / pixel,
        spots=tuple((effective_wavelengths(sensor) * 1e-9 * gap / clear / pixel).tolist()),
        aperture=(height / pixel, width / pixel),
        step=step,
        start=(float(start[0]), float(start[1])),
    )

"""Lenses of the truth: supported cases, transfer functions, kernels over the field, float64.

For a pupil, the differences of its kernels from the kernel on the axis are splines of degree 5 in
the place and in the wavelength. Their nodes are dense enough to err by at most ERROR half-way
between. Given point spreads are linear between their own field points and wavelengths, and turn
with the field by a Fourier series in the angle.
"""

from abc import ABC, abstractmethod
from math import ceil, prod

import numpy as np
import scipy

from gpusim.domain.errors import DoesNotFit, OutOfRange
from gpusim.domain.optics import Optics
from gpusim.judge.truth_light import axis_of, pixel_places
from gpusim.judge.truth_mask import transfer_of_mask
from gpusim.judge.truth_pupil import PupilKernels
from gpusim.optics import tables
from gpusim.optics.lens import MeasuredLens, PupilLens
from gpusim.optics.lenses import open_lens
from gpusim.optics.psf import spread_at

DEGREE = 5  # of the splines
AT_ONCE = 32  # kernels that are made together
LEAST_PLACES, LEAST_WAVELENGTHS = 13, 5  # along an axis, and of a scene, to begin with
ERROR = 1e-4  # of the largest energy of a pixel about a point: what splines may err half-way between places
ANGLES = (1, 9, 17, 33, 65, 129)  # of spreads that turn
MOST_BYTES = 2**30  # of the differences at all places
# [sample] of the differences, at least; rings of the diffraction; radii of rays
LEAST_REACH = 48
RINGS = 16
RADII = 2


def require_truth(camera, scene):
    """Check that the truth supports a camera and a scene.

    Raises:
        OutOfRange: It does not; the message says what is allowed.
    """
    optics = camera.optics
    has_psf = optics.psf is not None
    samples = f"{scene.samples_per_pixel:g} samples per pixel"
    if not float(scene.samples_per_pixel).is_integer() and optics.varies:
        what = f"{samples} with a blur that varies over the field"
        raise OutOfRange("verify", what, "a whole number of samples per pixel")
    if scene.samples_per_pixel != 1 and has_psf and optics.psf.integrated:
        allowed = "1 sample per pixel, or samples of the irradiance"
        raise OutOfRange("verify", f"{samples} with measured energies of pixels", allowed)
    if scene.depth is not None and has_psf:
        what = "depth with measured point spreads"
        raise OutOfRange("verify", what, "a scene without depth, or a lens with a pupil")
    if optics.varies and has_psf and any(axis := axis_of(camera, scene.shape)):
        off = f"{axis[0]:.3g}, {axis[1]:.3g} pixels off the frame's middle"
        what = f"point spreads of field points, with the axis {off}"
        raise OutOfRange("verify", what, "an axis in the middle")


def transfer_of(optics: Optics, wavelength, pitch):
    """Return the transfer function of a lens, and its cut-off frequency [cycle/sample].

    Args:
        optics: The lens, on its axis.
        wavelength: [nm].
        pitch: Distance of the samples [m].

    Returns:
        A function (fy, fx) [cycle/sample], and the cut-off; a cut-off of 0 means that the function
        includes the pixels.
    """
    if optics.psf is not None:
        return _measure(optics.psf, wavelength, pitch, optics.object_distance)
    q = wavelength * 1e-9 * optics.working_f_number / pitch
    waves = optics.waves(np.array([wavelength]))
    if optics.is_ideal:
        own = lambda sx, sy: tables.otf(np.hypot(sx, sy))  # noqa: E731
    elif optics.pupil.mask is not None:
        own = transfer_of_mask(optics.pupil, waves[0])
    else:
        own = tables.exact_otf(optics.pupil, waves)
    spots, diffuser = [length / pitch for length in optics.birefringence], optics.diffuser / pitch

    def transfer(fy, fx):
        sy, sx = np.broadcast_arrays(fy[:, None] * q, fx * q)
        inside = np.hypot(sx, sy) < 1
        values = own(sx[inside], sy[inside])
        out = np.zeros(inside.shape, values.dtype)
        out[inside] = values
        down, across = (
            np.cos(np.pi * spot * f) * np.exp(-2 * (np.pi * diffuser * f) ** 2)
            for spot, f in zip(spots, (fy, fx), strict=True)
        )
        return out * down[:, None] * across

    return transfer, 1 / q


def _measure(spread, wavelength, pitch, distance):
    """Return the same for a given point spread.

    Its samples are of a function without frequencies beyond half the sampling rate.
    """
    values = spread_at(spread, [wavelength], distance=distance)[0]
    step = spread.spacing / pitch
    along = [np.arange(n) - (n - 1) / 2 for n in values.shape]

    def transfer(fy, fx):
        def waves(f, at):
            found = np.exp(-2j * np.pi * step * np.outer(f, at))
            # a frequency of exactly half the rate counts half for either sign
            return found if spread.integrated else found * _share_at(np.abs(f) * step)[:, None]

        return waves(fy, along[0]) @ values @ waves(fx, along[1]).T

    return transfer, 0.0 if spread.integrated else np.sqrt(0.5) / step


def _share_at(rate):
    return np.where(rate < 0.5 - 1e-12, 1.0, np.where(rate < 0.5 + 1e-12, 0.5, 0.0))


class Field(ABC):
    """Kernels of a lens at samples of the scene, counted from the first one without the margin.

    Attributes:
        lens: The lens, see `gpusim.optics.lens`.
        middle: Place of the optical axis [sample].
        corner: Distance that is a field height of 1 [sample].
        limits: First and last place along each axis.
        half: Half size of the differences [sample].
    """

    def __init__(self, lens, middle, corner, limits, half):
        self.lens, self.middle, self.corner = lens, middle, corner
        self.limits, self.half = limits, half

    def kernel(self, wavelength, y, x) -> np.ndarray:
        """Return the energy of the pixels around a point at (y, x), (size, size)."""
        place = (y - self.middle[0]) / self.corner, (x - self.middle[1]) / self.corner
        return self.lens.kernels([wavelength], place, 2 * self.half + 1)[0]

    @abstractmethod
    def wavelengths(self, known):
        """Return wavelength nodes, and their shares at each wavelength of `known`, (N, L)."""

    @abstractmethod
    def differences(self, wavelength) -> "Splines | Turned":
        """Return the differences from the kernel on the axis, by place. Raises DoesNotFit."""


class _PupilField(Field):
    """Kernels of a pupil: splines in the place and the wavelength."""

    _known: PupilKernels | None = None

    def kernel(self, wavelength, y, x) -> np.ndarray:
        """See `Field`."""
        return self._kernels(wavelength, [(y, x)])[0]

    def _kernels(self, wavelength, places):
        """Return the kernels at places (y, x) of the frame, (P, size, size)."""
        lens, known = self.lens, self._known
        if known is None or known.wavelength != wavelength:
            pixels = lens.pitch, lens.aperture, lens.displacement
            known = PupilKernels(lens.optics, wavelength, *pixels, self.corner, self.half)
            self._known = known
        middle = np.array(self.middle)
        return known.at_places([(np.array(at) - middle) / self.corner for at in places])

    def wavelengths(self, known):
        """See `Field`."""
        known = np.asarray(known, np.float64)
        ends = [limit[1] for limit in self.limits]
        halfway = [(middle + end) / 2 for middle, end in zip(self.middle, ends, strict=True)]
        for count in (LEAST_WAVELENGTHS, 2 * LEAST_WAVELENGTHS - 1, 4 * LEAST_WAVELENGTHS - 3):
            if count >= len(known):
                break
            nodes = np.linspace(known[0], known[-1], count)
            degree = min(DEGREE, count - 1)
            share = scipy.interpolate.make_interp_spline(nodes, np.eye(count), degree)
            between = (nodes[1:] + nodes[:-1])[[0, count // 2, -1]] / 2
            tried = known[np.abs(known[:, None] - between).argmin(axis=0)]
            if self._are_near(nodes, share, tried, (ends, halfway)):
                return nodes, share(known).T
        return known, np.eye(len(known))

    def _are_near(self, nodes, share, tried, places):
        """Return whether kernels at places may be splines through those at the nodes."""
        kernels = [self._kernels(node, places) for node in nodes]
        for one in tried:
            own = self._kernels(one, places)
            wrong = np.abs(np.tensordot(share(one), kernels, 1) - own).max(axis=(1, 2))
            if (wrong > ERROR * own.max(axis=(1, 2))).any():
                return False
        return True

    def differences(self, wavelength):
        """See `Field`."""
        axis, known = self.kernel(wavelength, *self.middle), {}
        is_mirrored = self.lens.symmetry.is_mirrored

        def fold(y, x):
            """Return a place where the kernel is made: of a lens that has a mirror, in one quadrant."""
            row, col = self.middle
            if is_mirrored:
                y, x = row + abs(y - row), col + abs(x - col)
            return round(y, 6), round(x, 6)

        def make(places):
            """Make the kernels of new places, AT_ONCE at a time."""
            new = sorted({fold(*at) for at in places} - known.keys())
            for first in range(0, len(new), AT_ONCE):
                part = new[first : first + AT_ONCE]
                for at, kernel in zip(part, self._kernels(wavelength, part), strict=True):
                    own = kernel - axis
                    known[at] = (own - own.mean()).astype(np.float32)

        def difference(y, x):
            make([(y, x)])
            side = [
                -1 if is_mirrored and at < middle else 1
                for at, middle in zip((y, x), self.middle, strict=True)
            ]
            return known[fold(y, x)][:: side[0], :: side[1]]

        count = [min(ceil(high - low) + 1, LEAST_PLACES) for low, high in self.limits]
        while True:
            axes = [np.linspace(*limit, n) for limit, n in zip(self.limits, count, strict=True)]
            table = np.empty((*count, *axis.shape), np.float32)
            make([(y, x) for y in axes[0] for x in axes[1]])
            for i, j in np.ndindex(*count):
                table[i, j] = difference(axes[0][i], axes[1][j])
            splines = Splines(table, axes)
            most = [ceil(high - low) + 1 for low, high in self.limits]
            more = [min(2 * n - 1, one) for n, one in zip(count, most, strict=True)]
            if more == count or splines.between(difference) <= ERROR * axis.max():
                return splines
            count = more
            needed = 8 * prod(count) * axis.size
            if needed > MOST_BYTES:
                what = f"verify: kernels at {count[1]} x {count[0]} places of the field"
                raise DoesNotFit(what, needed, MOST_BYTES, "the reference")


class _MeasuredField(Field):
    """Kernels of given point spreads: linear between their field points and wavelengths."""

    def wavelengths(self, known):
        """See `Field`."""
        known = np.asarray(known, np.float64)
        own = self.lens.spread_data.wavelengths
        if len(known) <= len(own):
            return known, np.eye(len(known))
        return own, np.stack([np.interp(known, own, one) for one in np.eye(len(own))])

    def differences(self, wavelength):
        """See `Field`."""
        spread, axis = self.lens.spread_data, self.kernel(wavelength, *self.middle)

        def difference(y, x):
            own = self.kernel(wavelength, y, x) - axis
            return own - own.mean()

        if spread.grid is not None:
            axes = [
                middle + self.corner * np.asarray(at)
                for middle, at in zip(self.middle, spread.grid, strict=True)
            ]
            kernels = np.array([[difference(y, x) for x in axes[1]] for y in axes[0]])
            return Splines(kernels, axes, 1)
        heights = self.corner * np.asarray(spread.heights)

        def around(count, first=0.0):
            angles = first + 2 * np.pi * np.arange(count) / count
            at = [
                (self.middle[0] + height * np.sin(angle), self.middle[1] + height * np.cos(angle))
                for height in np.maximum(heights, 1e-9)
                for angle in angles
            ]
            found = np.array([difference(*one) for one in at])
            return found.reshape(len(heights), count, *axis.shape)

        for count in ANGLES:
            turned = Turned(around(count), heights, self.middle)
            if turned.between(around(4, np.pi / count), np.pi / count) <= ERROR * axis.max():
                break
        return turned


def field_of(camera, scene) -> Field:
    """Return the kernels of a camera's lens in front of a scene's frame, at the scene's samples."""
    optics, sensor, ratio = camera.optics, camera.sensor, float(scene.samples_per_pixel)
    pitch, corner = sensor.pixel_pitch / ratio, float(np.hypot(*scene.shape)) / 2 * ratio
    aperture = tuple(side / pitch for side in sensor.aperture)
    first, phase = first_places(camera, scene)
    limits = [(-scene.margin, n - 1 + scene.margin) for n in scene.samples]
    middle = [
        at + more + ratio * ((n - 1) / 2 - move + off)
        for at, more, n, move, off in zip(
            first,
            phase,
            scene.shape,
            sensor.displacement,
            axis_of(camera, scene.shape),
            strict=True,
        )
    ]
    farthest = np.hypot(
        *(max(at - low, high - at) for at, (low, high) in zip(middle, limits, strict=True))
    )
    q = scene.wavelengths.max() * 1e-9 * optics.working_f_number / pitch
    lateral = np.abs(optics.lateral_color_at(scene.wavelengths)).max() * farthest
    rays = open_lens(optics, pitch).spread(scene.wavelengths, float(farthest / corner))
    half = ceil(max(LEAST_REACH, RINGS * q, RADII * rays) + lateral)
    if optics.psf is None:
        lens = PupilLens(optics, pitch, aperture, corner, phase)
        return _PupilField(lens, middle, corner, limits, half)
    endless = (np.inf, np.inf)
    given = MeasuredLens(optics, optics.psf, pitch, aperture, endless, phase)
    limits = [(-0.5, n - 0.5) for n in scene.samples]
    return _MeasuredField(given, middle, corner, limits, max(half, given.least_size // 2))


def first_places(camera, scene) -> tuple[list[int], tuple[float, float]]:
    """Return the sample nearest to the first pixel's middle, and the rest of its place, by axis."""
    first = [float(place[0]) for place in pixel_places(camera, scene)]
    nearest = [round(one) for one in first]
    rows, cols = (one - at for one, at in zip(first, nearest, strict=True))
    return nearest, (rows, cols)


class Splines:
    """Kernels (P, Q, size, size) at places along two axes, as splines.

    The coefficients of the splines replace the kernels.
    """

    def __init__(self, table, axes, degree=DEGREE):
        self.axes, self.degree = axes, degree
        for number, places in enumerate(axes):
            spline = scipy.interpolate.make_interp_spline(
                places, np.moveaxis(table, number, 0), self._degree(places)
            )
            table = np.moveaxis(spline.c.astype(table.dtype), 0, number)
        self.table = table

    def between(self, kernel) -> float:
        """Return the largest difference from `kernel(y, x)` half-way between places."""
        worst = 0.0
        for share in (0.5, 0.77, 1.0):
            at, weights = [], []
            for places in self.axes:
                cell = min(int(share * (len(places) - 1)), len(places) - 2)
                middle = (places[cell] + places[cell + 1]) / 2
                at.append(middle)
                weights.append(self._basis(places, np.array([middle]))[0])
            found = np.einsum("i,j,ijab->ab", *weights, self.table, optimize=True)
            worst = max(worst, float(np.abs(found - kernel(*at)).max()))
        return worst

    def parts(self, y, x):
        """Yield rows, columns, shares of the sources there, and their kernel."""
        down, across = (
            self._basis(places, at) for places, at in zip(self.axes, (y, x), strict=True)
        )
        for i, j in np.ndindex(self.table.shape[:2]):
            rows, cols = np.flatnonzero(down[:, i]), np.flatnonzero(across[:, j])
            if len(rows) and len(cols):
                rows, cols = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
                yield rows, cols, down[rows, i, None] * across[cols, j], self.table[i, j]

    def _degree(self, places):
        return min(self.degree, len(places) - 1)

    def _basis(self, places, at):
        """Return the weights of the coefficients at places `at`, (len(at), len(places))."""
        knots = scipy.interpolate.make_interp_spline(
            places, np.zeros(len(places)), self._degree(places)
        ).t
        at = np.clip(at * 1.0, places[0], places[-1])
        return scipy.interpolate.BSpline.design_matrix(at, knots, self._degree(places)).toarray()


class Turned:
    """Kernels (H, M, size, size) at heights [pixel] and even angles about `middle`.

    They are linear in the height, and a series of sines and cosines in the angle.
    """

    def __init__(self, table, heights, middle):
        self.table, self.heights, self.middle = table, heights, middle

    def between(self, table, angle) -> float:
        """Return the largest difference from kernels (H, 4, size, size) from `angle` on."""
        share = self._series(angle + np.arange(4) * np.pi / 2)
        return float(
            np.abs(np.einsum("am,hmyx->hayx", share, self.table, optimize=True) - table).max()
        )

    def parts(self, y, x):
        """See `Splines`."""
        y, x = y[:, None] - self.middle[0], x - self.middle[1]
        height = np.clip(np.hypot(y, x), 0, self.heights[-1])
        series = self._series(np.arctan2(y, x))
        for one, kernels in zip(np.eye(len(self.heights)), self.table, strict=True):
            share = np.interp(height, self.heights, one)
            for number, kernel in enumerate(kernels):
                yield slice(None), slice(None), share * series[..., number], kernel

    def _series(self, angle):
        """Return the weights of the angles in their trigonometric polynomial, (..., M), M odd."""
        count = self.table.shape[1]
        apart = np.asarray(angle)[..., None] - 2 * np.pi * np.arange(count) / count
        return 1 / count + 2 / count * sum(
            (np.cos(k * apart) for k in range(1, count // 2 + 1)), np.zeros(apart.shape)
        )

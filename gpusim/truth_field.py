"""The truth about a blur that varies over the field: every sample's light is spread as at its own place, float64.

The lens as on its axis gives the whole frame (`gpusim.truth_blur`). To it comes every sample's light, spread by the
difference of its own kernel from that on the axis, which ends sooner and has no energy: a star keeps its energy, and a
flat field is the sum of its points. Places are told from where the axis meets the frame. The differences are splines of
degree 5 in the place, and in the wavelength, through those at so many places and wavelengths that they err by no more
than ERROR half-way between.
"""

from math import ceil, prod

import numpy as np
import scipy

from gpusim.domain.errors import DoesNotFit
from gpusim.optics.lens import MeasuredLens, PupilLens, spread_radius
from gpusim.planner.border import border_indices
from gpusim.planner.weights import electrons_per_content
from gpusim.truth_light import axis_of

DEGREE = 5  # of the splines
LEAST_PLACES, LEAST_WAVELENGTHS = 13, 5  # along an axis, and of a scene, to begin with
ERROR = 1e-4  # of the largest energy of a pixel about a point: what splines may err half-way between places
MOST_BYTES = 2**30  # of the differences at all places
LEAST_REACH, RINGS, RADII = 48, 16, 2  # [sample] of the differences, at least; rings of the diffraction; radii of rays
WHOLE = 2**17  # pixels of a frame up to which all are looked at
BLOCKS, SIDE = 16, 32  # of others


def blocks(shape) -> list[tuple[slice, slice]]:
    """Parts of a frame that are looked at: all of a small one, or BLOCKS of SIDE x SIDE pixels: a Halton sequence."""
    if prod(shape) <= WHOLE:
        return [(slice(0, shape[0]), slice(0, shape[1]))]
    fractions = scipy.stats.qmc.Halton(2, scramble=False).random(BLOCKS + 1)[1:]
    first = (fractions * np.maximum(np.array(shape) - SIDE, 0)).astype(int)
    return [(slice(y, min(y + SIDE, shape[0])), slice(x, min(x + SIDE, shape[1]))) for y, x in first.tolist()]


def varying_rates(light, camera, scene, parts) -> list[np.ndarray]:
    """Electrons per second that a lens gives more than as on its axis, in parts of the frame: a list of (C, h, w).

    light: of every wavelength where the lens puts it, (L, rows, cols), with the scene's margin, one sample per pixel.
    parts: see `blocks`. Raises DoesNotFit.
    """
    lens, weights = Field.of(camera, scene), electrons_per_content(scene, camera)
    total = [np.zeros((len(weights), *(at.stop - at.start for at in part))) for part in parts]
    for wavelength, share in zip(*lens.wavelengths(scene.wavelengths), strict=True):
        seen = np.tensordot(weights * share, light, 1)
        if not seen.any():
            continue
        table, axes = lens.differences(wavelength)
        for one, part in zip(total, parts, strict=True):
            one += _spread(_taken(seen, part, lens.half, scene.margin, scene.border), table, axes, part, lens.half)
    return total


class Field:
    """Kernels of a lens at places of the frame [pixel], from the first pixel's middle on.

    lens: of `gpusim.optics.lens`. middle: of the axis [pixel]. corner: distance that is a field height of 1 [pixel].
    limits: first and last place along each axis. half: how far differences go [pixel].
    """

    def __init__(self, lens, middle, corner, limits, half):
        self.lens, self.middle, self.corner, self.limits, self.half = lens, middle, corner, limits, half

    @classmethod
    def of(cls, camera, scene) -> "Field":
        """The lens before a scene's frame."""
        optics, sensor = camera.optics, camera.sensor
        pitch, corner = sensor.pixel_pitch, float(np.hypot(*scene.shape)) / 2
        aperture = tuple(side / pitch for side in sensor.aperture)
        axis = axis_of(camera, scene.shape)
        limits = [(-scene.margin, n - 1 + scene.margin) for n in scene.shape]
        middle = [(n - 1) / 2 + at for n, at in zip(scene.shape, axis, strict=True)]
        farthest = np.hypot(*(max(at - low, high - at) for at, (low, high) in zip(middle, limits, strict=True)))
        q = scene.wavelengths.max() * 1e-9 * optics.working_f_number / pitch
        lateral = np.abs(optics.lateral_color_at(scene.wavelengths)).max() * farthest
        rays = spread_radius(optics, scene.wavelengths, pitch, float(farthest / corner))
        half = ceil(max(LEAST_REACH, RINGS * q, RADII * rays) + lateral)
        if optics.psf is None:
            lens = PupilLens(optics, pitch, aperture, corner, sensor.displacement)
        else:
            lens = MeasuredLens(optics, optics.psf, pitch, aperture, tuple(n / 2 / corner for n in scene.shape),
                                sensor.displacement)
            half = max(half, lens.least_size // 2)
        return cls(lens, middle, corner, limits, half)

    def kernel(self, wavelength, y, x) -> np.ndarray:
        """Energy of the pixels around a point at the place (y, x), (size, size)."""
        place = [(at - middle) / self.corner for at, middle in zip((y, x), self.middle, strict=True)]
        return self.lens.kernels([wavelength], place, 2 * self.half + 1)[0]

    def wavelengths(self, known):
        """As many wavelengths as tell the kernels at all of `known`, and their shares in each of these, (N, L)."""
        known = np.asarray(known, np.float64)
        places = [[limit[1] for limit in self.limits], [(middle + limit[1]) / 2 for middle, limit in zip(
            self.middle, self.limits, strict=True)]]
        for count in (LEAST_WAVELENGTHS, 2 * LEAST_WAVELENGTHS - 1, 4 * LEAST_WAVELENGTHS - 3):
            if count >= len(known):
                break
            nodes = np.linspace(known[0], known[-1], count)
            share = scipy.interpolate.make_interp_spline(nodes, np.eye(count), _degree(nodes))
            tried = known[np.abs(known[:, None] - (nodes[1:] + nodes[:-1])[[0, count // 2, -1]] / 2).argmin(axis=0)]
            if all(np.abs(np.tensordot(share(one), [self.kernel(node, *place) for node in nodes], 1)
                          - (own := self.kernel(one, *place))).max() <= ERROR * own.max()
                   for place in places for one in tried):
                return nodes, share(known).T
        return known, np.eye(len(known))

    def differences(self, wavelength):
        """Coefficients of the splines of the differences from the kernel on the axis, (P, Q, size, size), and places.

        Raises DoesNotFit.
        """
        axis, known = self.kernel(wavelength, *self.middle), {}

        def difference(y, x):
            """At a place; of a lens that has a mirror, from the quadrant where both are on the positive side."""
            mirrored = isinstance(self.lens, PupilLens) and self.lens.optics.has_mirror and not any(
                self.lens.displacement)
            side = [1, 1]
            if mirrored:
                side = [1 if at >= middle else -1 for at, middle in zip((y, x), self.middle, strict=True)]
                y, x = (middle + abs(at - middle) for at, middle in zip((y, x), self.middle, strict=True))
            at = round(y, 6), round(x, 6)
            if at not in known:
                own = self.kernel(wavelength, y, x) - axis
                known[at] = (own - own.mean()).astype(np.float32)
            return known[at][:: side[0], :: side[1]]

        count = [min(ceil(high - low) + 1, LEAST_PLACES) for low, high in self.limits]
        while True:
            axes = [np.linspace(*limit, n) for limit, n in zip(self.limits, count, strict=True)]
            table = np.empty((*count, *axis.shape), np.float32)
            for i, j in np.ndindex(*count):
                table[i, j] = difference(axes[0][i], axes[1][j])
            for number, places in enumerate(axes):
                spline = scipy.interpolate.make_interp_spline(places, np.moveaxis(table, number, 0), _degree(places))
                table = np.moveaxis(spline.c.astype(np.float32), 0, number)
            more = [min(2 * n - 1, ceil(high - low) + 1) for n, (low, high) in zip(count, self.limits, strict=True)]
            if more == count or self._between(table, axes, difference) <= ERROR * axis.max():
                return table, axes
            count = more
            needed = 8 * prod(count) * axis.size
            if needed > MOST_BYTES:
                raise DoesNotFit(f"verify: kernels at {count[1]} x {count[0]} places of the field", needed, MOST_BYTES,
                                 "the reference")

    def _between(self, table, axes, difference):
        """Largest error of the splines between places, where they are farthest from the axis and half-way."""
        worst = 0.0
        for share in (0.5, 0.77, 1.0):
            cells = [min(int(share * (len(places) - 1)), len(places) - 2) for places in axes]
            y, x = ((places[k] + places[k + 1]) / 2 for places, k in zip(axes, cells, strict=True))
            down, across = (_basis(places, np.array([at])) for places, at in zip(axes, (y, x), strict=True))
            worst = max(worst, np.abs(np.einsum("i,j,ijab->ab", down[0], across[0], table, optimize=True)
                                      - difference(y, x)).max())
        return worst


def _degree(places):
    return min(DEGREE, len(places) - 1)


def _basis(places, at):
    """Weights of the splines' coefficients at places `at`, (len(at), len(places))."""
    knots = scipy.interpolate.make_interp_spline(places, np.zeros(len(places)), _degree(places)).t
    at = np.clip(at * 1.0, places[0], places[-1])
    return scipy.interpolate.BSpline.design_matrix(at, knots, _degree(places)).toarray()


def _taken(light, part, half, margin, border):
    """Light of a part and `half` samples around it, as the border says."""
    at = [np.arange(one.start - half, one.stop + half) + margin for one in part]
    y, x = (border_indices(places, n, border) for places, n in zip(at, light.shape[1:], strict=True))
    window = light[:, y[:, None], x]
    if border == "zero":
        window = window * ((y == at[0])[:, None] & (x == at[1]))
    return window


def _spread(light, table, axes, part, half):
    """Light (C, h + 2 half, w + 2 half) as the splines spread it, (C, h, w); from outside as at the frame's rim."""
    windows = [_basis(places, np.arange(at.start - half, at.stop + half)) for at, places in zip(part, axes, strict=True)]
    total = np.zeros((len(light), *(at.stop - at.start for at in part)))
    for i, j in np.ndindex(table.shape[:2]):
        along = [np.flatnonzero(window[:, k]) for window, k in zip(windows, (i, j), strict=True)]
        if not all(map(len, along)):
            continue
        (top, bottom), (left, right) = ((one[0], one[-1] + 1) for one in along)
        own = light[:, top:bottom, left:right] * (windows[0][top:bottom, i, None] * windows[1][left:right, j])
        if not own.any():
            continue
        wide = scipy.signal.fftconvolve(own, table[None, i, j].astype(np.float64), axes=(1, 2))
        # light at s gives the pixel x its kernel's entry x - s: the first of `wide` is `half` before its first source
        y, x = top - 2 * half, left - 2 * half
        inside = [slice(max(-first, 0), min(n - first, length))
                  for first, n, length in zip((y, x), total.shape[1:], wide.shape[1:], strict=True)]
        total[:, y + inside[0].start : y + inside[0].stop, x + inside[1].start : x + inside[1].stop] += wide[
            :, inside[0], inside[1]]
    return total

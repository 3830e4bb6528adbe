"""The truth about a blur that varies over the field: every sample's light is spread as at its own place, float64.

The lens as on its axis gives the whole frame (`gpusim.judge.truth_blur`). To it comes every sample's light, spread by
the difference of its own kernel from that on the axis, which ends sooner and has no energy: a star keeps its energy,
and a flat field is the sum of its points. Places are told from where the axis meets the frame. The differences of a
pupil are splines of degree 5 in the place, and in the wavelength, through those at so many places and wavelengths that
they err by no more than ERROR half-way between. Spreads that are given are linear between their own field points and
wavelengths, and turn with the field by a Fourier series in the angle.
"""

from math import ceil, prod

import numpy as np
import scipy

from gpusim.domain.errors import DoesNotFit
from gpusim.judge.truth_light import axis_of
from gpusim.optics.lens import MeasuredLens, PupilLens, spread_radius
from gpusim.optics.outside import border_indices
from gpusim.optics.weights import electrons_per_content

DEGREE = 5  # of the splines
LEAST_PLACES, LEAST_WAVELENGTHS = 13, 5  # along an axis, and of a scene, to begin with
ERROR = 1e-4  # of the largest energy of a pixel about a point: what splines may err half-way between places
ANGLES = (1, 9, 17, 33, 65, 129)  # of spreads that turn
MOST_BYTES = 2**30  # of the differences at all places
LEAST_REACH, RINGS, RADII = (
    48,
    16,
    2,
)  # [sample] of the differences, at least; rings of the diffraction; radii of rays
WHOLE = 2**17  # pixels of a frame up to which all are looked at
BLOCKS, SIDE = 16, 32  # of others


def blocks(shape) -> list[tuple[slice, slice]]:
    """Parts of a frame that are looked at: all of a small one, or BLOCKS of SIDE x SIDE pixels: a Halton sequence."""
    if prod(shape) <= WHOLE:
        return [(slice(0, shape[0]), slice(0, shape[1]))]
    fractions = scipy.stats.qmc.Halton(2, scramble=False).random(BLOCKS + 1)[1:]
    first = (fractions * np.maximum(np.array(shape) - SIDE, 0)).astype(int)
    return [
        (slice(y, min(y + SIDE, shape[0])), slice(x, min(x + SIDE, shape[1])))
        for y, x in first.tolist()
    ]


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
        kernels = lens.differences(wavelength)
        for one, part in zip(total, parts, strict=True):
            _spread(
                one,
                _taken(seen, part, lens.half, scene.margin, scene.border),
                kernels,
                lens.limits,
                part,
            )
    return total


class Field:
    """Kernels of a lens at places of the frame [pixel], from the first pixel's middle on.

    lens: of `gpusim.optics.lens`. middle: of the axis [pixel]. corner: distance that is a field height of 1 [pixel].
    limits: first and last place along each axis. half: how far differences go [pixel].
    """

    def __init__(self, lens, middle, corner, limits, half):
        self.lens, self.middle, self.corner, self.limits, self.half = (
            lens,
            middle,
            corner,
            limits,
            half,
        )

    @classmethod
    def of(cls, camera, scene) -> "Field":
        """The lens before a scene's frame."""
        optics, sensor = camera.optics, camera.sensor
        pitch, corner = sensor.pixel_pitch, float(np.hypot(*scene.shape)) / 2
        aperture = tuple(side / pitch for side in sensor.aperture)
        axis = axis_of(camera, scene.shape)
        limits = [(-scene.margin, n - 1 + scene.margin) for n in scene.shape]
        middle = [(n - 1) / 2 + at for n, at in zip(scene.shape, axis, strict=True)]
        farthest = np.hypot(
            *(max(at - low, high - at) for at, (low, high) in zip(middle, limits, strict=True))
        )
        q = scene.wavelengths.max() * 1e-9 * optics.working_f_number / pitch
        lateral = np.abs(optics.lateral_color_at(scene.wavelengths)).max() * farthest
        rays = spread_radius(optics, scene.wavelengths, pitch, float(farthest / corner))
        half = ceil(max(LEAST_REACH, RINGS * q, RADII * rays) + lateral)
        if optics.psf is None:
            lens: PupilLens | MeasuredLens = PupilLens(
                optics, pitch, aperture, corner, sensor.displacement
            )
        else:
            lens = MeasuredLens(
                optics, optics.psf, pitch, aperture, (np.inf, np.inf), sensor.displacement
            )
            half = max(half, lens.least_size // 2)
            limits = [(-0.5, n - 0.5) for n in scene.shape]
        return cls(lens, middle, corner, limits, half)

    def kernel(self, wavelength, y, x) -> np.ndarray:
        """Energy of the pixels around a point at the place (y, x), (size, size)."""
        place = [
            (at - middle) / self.corner for at, middle in zip((y, x), self.middle, strict=True)
        ]
        return self.lens.kernels([wavelength], place, 2 * self.half + 1)[0]

    def wavelengths(self, known):
        """As many wavelengths as tell the kernels at all of `known`, and their shares in each of these, (N, L)."""
        known = np.asarray(known, np.float64)
        if isinstance(self.lens, MeasuredLens):
            own = self.lens.spread.wavelengths
            return (
                (known, np.eye(len(known)))
                if len(known) <= len(own)
                else (own, np.stack([np.interp(known, own, one) for one in np.eye(len(own))]))
            )
        places = [
            [limit[1] for limit in self.limits],
            [
                (middle + limit[1]) / 2
                for middle, limit in zip(self.middle, self.limits, strict=True)
            ],
        ]
        for count in (LEAST_WAVELENGTHS, 2 * LEAST_WAVELENGTHS - 1, 4 * LEAST_WAVELENGTHS - 3):
            if count >= len(known):
                break
            nodes = np.linspace(known[0], known[-1], count)
            share = scipy.interpolate.make_interp_spline(
                nodes, np.eye(count), min(DEGREE, count - 1)
            )
            tried = known[
                np.abs(known[:, None] - (nodes[1:] + nodes[:-1])[[0, count // 2, -1]] / 2).argmin(
                    axis=0
                )
            ]
            if all(
                np.abs(
                    np.tensordot(share(one), [self.kernel(node, *place) for node in nodes], 1)
                    - (own := self.kernel(one, *place))
                ).max()
                <= ERROR * own.max()
                for place in places
                for one in tried
            ):
                return nodes, share(known).T
        return known, np.eye(len(known))

    def differences(self, wavelength) -> "Splines | Turned":
        """Differences from the kernel on the axis, by place. Raises DoesNotFit."""
        if not isinstance(self.lens, MeasuredLens):
            return self._of_pupil(wavelength)
        spread, axis = self.lens.spread, self.kernel(wavelength, *self.middle)

        def difference(y, x):
            own = self.kernel(wavelength, y, x) - axis
            return own - own.mean()

        if spread.grid is not None:
            axes = [
                middle + self.corner * np.asarray(at)
                for middle, at in zip(self.middle, spread.grid, strict=True)
            ]
            return Splines(
                np.array([[difference(y, x) for x in axes[1]] for y in axes[0]]), axes, 1
            )
        heights = self.corner * np.asarray(spread.heights)

        def around(count, first=0.0):
            angles = first + 2 * np.pi * np.arange(count) / count
            at = [
                (self.middle[0] + height * np.sin(angle), self.middle[1] + height * np.cos(angle))
                for height in np.maximum(heights, 1e-9)
                for angle in angles
            ]
            return np.array([difference(*one) for one in at]).reshape(
                len(heights), count, *axis.shape
            )

        for count in ANGLES:
            turned = Turned(around(count), heights, self.middle)
            if turned.between(around(4, np.pi / count), np.pi / count) <= ERROR * axis.max():
                break
        return turned

    def _of_pupil(self, wavelength):
        """The same of a pupil."""
        axis, known = self.kernel(wavelength, *self.middle), {}

        def difference(y, x):
            """At a place; of a lens that has a mirror, from the quadrant where both are on the positive side."""
            mirrored = (
                isinstance(self.lens, PupilLens)
                and self.lens.optics.has_mirror
                and not any(self.lens.displacement)
            )
            side = [1, 1]
            if mirrored:
                side = [
                    1 if at >= middle else -1
                    for at, middle in zip((y, x), self.middle, strict=True)
                ]
                y, x = (
                    middle + abs(at - middle)
                    for at, middle in zip((y, x), self.middle, strict=True)
                )
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
            splines = Splines(table, axes)
            more = [
                min(2 * n - 1, ceil(high - low) + 1)
                for n, (low, high) in zip(count, self.limits, strict=True)
            ]
            if more == count or splines.between(difference) <= ERROR * axis.max():
                return splines
            count = more
            needed = 8 * prod(count) * axis.size
            if needed > MOST_BYTES:
                raise DoesNotFit(
                    f"verify: kernels at {count[1]} x {count[0]} places of the field",
                    needed,
                    MOST_BYTES,
                    "the reference",
                )


class Splines:
    """Kernels (P, Q, size, size) at places along two axes as splines of a degree, whose coefficients replace them."""

    def __init__(self, table, axes, degree=DEGREE):
        self.axes, self.degree = axes, degree
        for number, places in enumerate(axes):
            spline = scipy.interpolate.make_interp_spline(
                places, np.moveaxis(table, number, 0), self._degree(places)
            )
            table = np.moveaxis(spline.c.astype(table.dtype), 0, number)
        self.table = table

    def between(self, kernel) -> float:
        """Largest difference from `kernel(y, x)`, far from the first place and half-way between places."""
        worst = 0.0
        for share in (0.5, 0.77, 1.0):
            cells = [min(int(share * (len(places) - 1)), len(places) - 2) for places in self.axes]
            y, x = (
                (places[k] + places[k + 1]) / 2 for places, k in zip(self.axes, cells, strict=True)
            )
            down, across = (
                self._basis(places, np.array([at]))
                for places, at in zip(self.axes, (y, x), strict=True)
            )
            found = np.einsum("i,j,ijab->ab", down[0], across[0], self.table, optimize=True)
            worst = max(worst, float(np.abs(found - kernel(y, x)).max()))
        return worst

    def parts(self, y, x):
        """Shares of sources at rows y and columns x, as (rows, columns, their shares, kernel)."""
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
        """Weights of the coefficients at places `at`, (len(at), len(places))."""
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
        """Largest difference from kernels (H, 4, size, size) at even angles from `angle` on."""
        share = self._series(angle + np.arange(4) * np.pi / 2)
        return float(
            np.abs(np.einsum("am,hmyx->hayx", share, self.table, optimize=True) - table).max()
        )

    def parts(self, y, x):
        """See `Splines`."""
        y, x = y[:, None] - self.middle[0], x - self.middle[1]
        height, series = (
            np.clip(np.hypot(y, x), 0, self.heights[-1]),
            self._series(np.arctan2(y, x)),
        )
        for one, kernels in zip(np.eye(len(self.heights)), self.table, strict=True):
            share = np.interp(height, self.heights, one)
            for number, kernel in enumerate(kernels):
                yield slice(None), slice(None), share * series[..., number], kernel

    def _series(self, angle):
        """Weights of the angles in the trigonometric polynomial through them, (..., M), M odd."""
        count = self.table.shape[1]
        apart = np.asarray(angle)[..., None] - 2 * np.pi * np.arange(count) / count
        return 1 / count + 2 / count * sum(
            (np.cos(k * apart) for k in range(1, count // 2 + 1)), np.zeros(apart.shape)
        )


def _taken(light, part, half, margin, border):
    """Light of a part and `half` samples around it, as the border says."""
    at = [np.arange(one.start - half, one.stop + half) + margin for one in part]
    y, x = (
        border_indices(places, n, border) for places, n in zip(at, light.shape[1:], strict=True)
    )
    window = light[:, y[:, None], x]
    if border == "zero":
        window = window * ((y == at[0])[:, None] & (x == at[1]))
    return window


def _spread(total, light, kernels, limits, part):
    """Add light (C, h + 2 half, w + 2 half) as it is spread to `total` (C, h, w), that from beyond limits as there."""
    half = (light.shape[1] - total.shape[1]) // 2
    places = [
        np.clip(np.arange(at.start - half, at.stop + half), *limit)
        for at, limit in zip(part, limits, strict=True)
    ]
    for rows, cols, share, kernel in kernels.parts(*places):
        own = light[:, rows, cols] * share
        lit = [np.flatnonzero(own.any(axis=axes)) for axes in ((0, 2), (0, 1))]
        if not len(lit[0]):
            continue
        top, left = (one[0] for one in lit)
        own = own[:, top : lit[0][-1] + 1, left : lit[1][-1] + 1]
        wide = scipy.signal.fftconvolve(own, kernel[None].astype(np.float64), axes=(1, 2))
        # light at s gives the pixel x its kernel's entry x - s: the first of `wide` is `half` before its first source
        top, left = top + (rows.start or 0) - 2 * half, left + (cols.start or 0) - 2 * half
        inside = [
            slice(max(-first, 0), min(n - first, length))
            for first, n, length in zip((top, left), total.shape[1:], wide.shape[1:], strict=True)
        ]
        if all(one.stop > one.start for one in inside):
            total[
                :,
                top + inside[0].start : top + inside[0].stop,
                left + inside[1].start : left + inside[1].stop,
            ] += wide[:, inside[0], inside[1]]

"""A camera by sums in real space: mean electrons independent of planner, reference and kernels.

Every wavelength has a separate point spread: from Hankel's integral for a round pupil, or from
Gauss's rule over the chords of any other pupil. It is sampled as finely as its band limit requires,
and integrated over the pixels' apertures by the transform of a box. Within a reach all light is
summed, with the scene continued by the border rule. Beyond it, the pattern is replaced by the mean
of its rings or, for straight blades, by the rays from their edges: light is summed along rays.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import ceil

import numpy as np
import scipy.fft
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.signal import fftconvolve
from scipy.special import j0

from gpusim.domain.errors import OutOfRange

NEAREST, FARTHEST = 96, 320  # [sample] within which all light is summed
RINGS = 48  # of the diffraction inside this reach
ROOM = 8.0  # minimum of the reach over the radius of the geometric spread
RAYS, STEP, ENDS = (
    240,
    1.03,
    300.0,
)  # directions; growth of the steps along them; end over start
ROOM_AROUND = 12  # [sample] that a Gaussian of 3 spreads
STEP_NM = 0.05  # of the spectral integrals
MODES = {
    "zero": "constant",
    "edge": "edge",
    "reflect": "symmetric",
    "scene": "edge",
}  # of numpy.pad
GOES_ON = {"edge": "nearest", "reflect": "reflect", "scene": "nearest"}  # of scipy.ndimage
CLEAR = 550.0  # [nm] reference of the generator's wavefronts


@dataclass(frozen=True)
class Spread:
    """Parameters of a point spread at one wavelength.

    q: wavelength times f-number over the samples' distance. w020, w040: of a round pupil [waves].
    hole: its obstruction. blades, turned: of a polygon. apart, diffused: of a low-pass [sample].
    """

    q: float
    w020: float = 0.0
    w040: float = 0.0
    hole: float = 0.0
    blades: int = 0
    turned: float = 0.0
    apart: tuple[float, float] = (0.0, 0.0)
    diffused: float = 0.0

    @property
    def radius(self) -> float:
        """Radius of the geometric spread [sample]: 2 q times the wavefront's slope at the rim."""
        slopes = np.linspace(0, 1, 65)
        return (
            2 * self.q * float(np.abs(2 * self.w020 * slopes + 4 * self.w040 * slopes**3).max())
            + 3 * self.diffused
        )

    @property
    def corners(self) -> np.ndarray:
        """Corners of the polygon, (y, x), shape (blades, 2)."""
        angles = self.turned + 2 * np.pi * np.arange(self.blades) / self.blades
        return np.stack([np.sin(angles), np.cos(angles)], axis=1)


def spread_of(optics, wavelength: float, pitch: float) -> Spread:
    """Return the spread of a uniform lens. wavelength: [nm]. pitch: distance of samples [m]."""
    metres, number = 1e-9 * wavelength, optics.f_number
    shift = (
        optics.defocus
        if isinstance(optics.defocus, float)
        else float(np.interp(wavelength, optics.defocus.wavelengths, optics.defocus.values))
    )
    return Spread(
        metres * number / pitch,
        shift / (8 * number**2 * metres),
        optics.wavefront.seidel[0] * CLEAR / wavelength,
        optics.pupil.obscuration,
        optics.pupil.blades,
        optics.pupil.rotation,
        tuple(one / pitch for one in optics.birefringence),
        optics.diffuser / pitch,
    )


def round_spread(of: Spread, reach: float):
    """Return energy per square sample at a distance: Born and Wolf, 8.5 and 8.8; tabulated."""
    r = np.arange(0, np.sqrt(2) * reach + of.q, of.q / 32)
    phase = 2 * np.pi * (abs(of.w020) + abs(of.w040))
    t, mass = np.polynomial.legendre.leggauss(int(np.pi * r[-1] / of.q / 2 + 2 * phase + 40))
    rho = (1 + of.hole) / 2 + (1 - of.hole) / 2 * t
    pupil = (
        (1 - of.hole) / 2 * mass * rho * np.exp(2j * np.pi * (of.w020 * rho**2 + of.w040 * rho**4))
    )
    field = np.concatenate(
        [j0(np.pi / of.q * np.outer(part, rho)) @ pupil for part in np.array_split(r, 64)]
    )
    return CubicSpline(r, np.pi / of.q**2 * np.abs(field) ** 2 / (1 - of.hole**2))


def polygon_spread(of: Spread, at) -> np.ndarray:
    """Return energy per square sample at `at` x `at` [sample].

    The integrals over chords are known; Gauss's rule adds them up.
    """
    corners = of.corners
    total = np.zeros((len(at), len(at)), complex)
    levels = np.unique(corners[:, 0].round(12))
    for low, high in pairwise(levels):
        t, mass = np.polynomial.legendre.leggauss(
            int(np.pi * np.abs(at).max() / of.q * (high - low) / 2) + 24
        )
        v = (low + high) / 2 + (high - low) / 2 * t
        ends = []
        for (y0, x0), (y1, x1) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            if min(y0, y1) < (low + high) / 2 < max(y0, y1):
                ends.append(x0 + (x1 - x0) * (v - y0) / (y1 - y0))
        left, right = np.minimum(*ends), np.maximum(*ends)
        s = at / (2 * of.q)
        chords = (
            (right - left)[:, None]
            * np.sinc(np.outer(right - left, s))
            * np.exp(1j * np.pi * np.outer(left + right, s))
        )
        total += np.exp(2j * np.pi * np.outer(s, v)) * (mass * (high - low) / 2) @ chords
    area = of.blades / 2 * np.sin(2 * np.pi / of.blades)
    return np.abs(total) ** 2 / (area * 4 * of.q**2)


def chord_spread(q: float, waves, y, x) -> np.ndarray:
    """Return energy per square sample at y x x [sample] of a clear circle, by sums over chords.

    waves: the wavefront, a function of (u, v) [waves]. With v = sin of an angle the integrand is
    smooth; x is along u.
    """
    # number of nodes: half of the phase at the end; pi / 2 times as many for the angle
    count = int(
        np.pi**2 / 4 * max(np.abs(y).max(), np.abs(x).max()) / q + 40 + 8 * np.abs(waves(0.7, 0.7))
    )
    t, mass = np.polynomial.legendre.leggauss(count)
    angles = np.pi / 2 * t
    v, half = np.sin(angles), np.cos(angles)
    chords = np.empty((count, len(x)), complex)
    for k in range(count):
        u = half[k] * t
        chords[k] = (mass * half[k] * np.exp(2j * np.pi * waves(u, v[k]))) @ np.exp(
            1j * np.pi / q * np.outer(u, x)
        )
    total = (np.exp(1j * np.pi / q * np.outer(y, v)) * (np.pi / 2 * mass * half)) @ chords
    return np.abs(total) ** 2 / (np.pi * 4 * q * q)


def fine_grid(q: float, reach: int) -> tuple[np.ndarray, int]:
    """Return places along an axis, more than `reach` around 0, and their number per sample.

    The band limit 1 / q sets this number.
    """
    fine = max(1, ceil(2.02 / q))
    half = scipy.fft.next_fast_len((reach + 3) * fine * 2, real=True) // 2
    return np.arange(-half, half) / fine, fine


def apertured(values, fine: int, reach: int, width, phase, of: Spread | None = None) -> np.ndarray:
    """Return means over apertures of a spread on a fine grid, shape (2 reach + 1, 2 reach + 1).

    The apertures are at whole samples plus `phase` from the point; distance 0 is in the middle.
    width: of the aperture, phase: (rows, cols) [sample].
    """
    spectrum = scipy.fft.fft2(scipy.fft.ifftshift(values))
    for axis in (0, 1):
        f = np.fft.fftfreq(values.shape[axis], 1 / fine)
        factor = np.sinc(width[axis] * f) * np.exp(2j * np.pi * f * phase[axis])
        if of is not None:
            factor = (
                factor
                * np.cos(np.pi * f * of.apart[axis])
                * np.exp(-2 * (np.pi * f * of.diffused) ** 2)
            )
        spectrum *= factor[:, None] if axis == 0 else factor
    whole = np.arange(-reach, reach + 1) * fine
    return scipy.fft.ifft2(spectrum).real[np.ix_(whole, whole)]


def kernel(of: Spread, reach: int, width, phase) -> np.ndarray:
    """Return the light that apertures receive from a point: see `apertured`."""
    at, fine = fine_grid(of.q, reach)
    if of.blades:
        values = polygon_spread(of, at)
    else:
        values = round_spread(of, reach + 4 + 2 / of.q)(np.hypot(at[:, None], at))
    return apertured(values, fine, reach, width, phase, of)


def rays(of: Spread) -> tuple[np.ndarray, np.ndarray]:
    """Return directions of distant light and the energy along each, times r^2 / q.

    Directions are angles from x towards y. A round rim has the same energy in all directions: 1 /
    (pi^3 (1 - hole)) per square sample times r^3 / q. An edge of length l of a polygon with area A
    throws l / (2 pi^2 A) to both sides along its normal.
    """
    if not of.blades:
        return (
            2 * np.pi * (np.arange(RAYS) + 0.5) / RAYS,
            np.full(RAYS, 2 * np.pi / RAYS / (np.pi**3 * (1 - of.hole))),
        )
    normals = of.turned + np.pi * (2 * np.arange(of.blades) + 1) / of.blades
    length, area = 2 * np.sin(np.pi / of.blades), of.blades / 2 * np.sin(2 * np.pi / of.blades)
    return np.concatenate([normals, normals + np.pi]), np.full(
        2 * of.blades, length / (2 * np.pi**2 * area)
    )


def energy_beyond(of: Spread, reach: int) -> float:
    """Return the light of a point outside a square of half-width `reach`."""
    angles, energies = rays(of)
    return float(of.q * energies @ np.maximum(np.abs(np.sin(angles)), np.abs(np.cos(angles)))) / (
        reach + 0.5
    )


def from_afar(planes, of: Spread, reach: int, border: str, rows, cols) -> np.ndarray:
    """Return light from outside a square of half-width `reach` at places rows x cols.

    Planes (C, ...) are multiplied by their q.
    """
    if border == "zero":
        return np.zeros((len(planes), len(rows), len(cols)))  # no light beyond: see `reach_of`
    mode, (y, x) = GOES_ON[border], (np.array(at, float) for at in (rows, cols))
    if not of.blades:  # smooth: from a coarse grid of places, and of light
        # room for the border rule "edge", which repeats single samples
        room = 0 if border == "reflect" else ROOM_AROUND
        planes = np.stack(
            [gaussian_filter(np.pad(plane, room, mode="edge"), 3, mode=mode) for plane in planes]
        )
        y, x = (np.linspace(at[0], at[-1], 13) + room for at in (y, x))
    grown = STEP ** np.arange(np.log(ENDS) / np.log(STEP) + 1)
    total = np.zeros((len(planes), len(y), len(x)))
    for angle, energy in zip(*rays(of), strict=True):
        along = np.sin(angle), np.cos(angle)
        edges = (reach + 0.5) / max(map(abs, along)) * grown
        r, shares = edges * np.sqrt(STEP), -np.diff(np.append(1 / edges, 0.0))
        places = np.broadcast_arrays(
            np.add.outer(r * along[0], y)[:, :, None], np.add.outer(r * along[1], x)[:, None]
        )
        for plane, out in zip(planes, total, strict=True):
            out += energy * np.tensordot(
                shares, map_coordinates(plane, places, order=1, mode=mode), 1
            )
    if of.blades:
        return total
    back = [
        (at + room - one[0]) / (one[-1] - one[0]) * 12
        for at, one in zip((rows, cols), (y, x), strict=True)
    ]
    grid = np.meshgrid(*back, indexing="ij")
    return np.stack([map_coordinates(plane, grid, order=3, mode="nearest") for plane in total])


def spectral_weights(scene, camera) -> np.ndarray:
    """Return electrons per second in each channel for content 1 at each wavelength, shape (C, L).

    The content is a cubic spline between its wavelengths; light, quantum efficiency and
    transmission are as tabulated.
    """
    nodes, optics, sensor = scene.wavelengths, camera.optics, camera.sensor
    grid = np.append(np.arange(nodes[0], nodes[-1], STEP_NM), nodes[-1])
    light = np.interp(grid, scene.illuminant.wavelengths, scene.illuminant.values, left=0, right=0)
    splines = CubicSpline(nodes, np.eye(len(nodes)))(grid)
    area = sensor.pixel_pitch**2 * sensor.fill_factor * pupil_area(optics.pupil)
    solid = np.pi / (1 + 4 * optics.f_number**2)
    return (
        area
        * solid
        * optics.transmission
        * np.stack(
            [
                np.trapezoid(
                    splines
                    * (light * np.interp(grid, sensor.qe.wavelengths, curve, left=0, right=0))[
                        :, None
                    ],
                    grid,
                    axis=0,
                )
                for curve in sensor.qe.values
            ]
        )
    )


def pupil_area(pupil) -> float:
    """Return the open area over the circle's area."""
    n = pupil.blades
    return (n * np.sin(2 * np.pi / n) / (2 * np.pi) if n else 1.0) - pupil.obscuration**2


def spectra(content, chosen) -> np.ndarray:
    """Return a band of a content, float64 (rows, cols)."""
    if content.form == "cube":
        return content.values[chosen].astype(np.float64)
    if content.form == "materials":
        return content.spectra[content.ids, chosen] * content.shading.astype(np.float64)
    content = content.on_host()
    return np.tensordot(content.basis[:, chosen], content.coefficients.astype(np.float64), 1)


def centres(scene) -> list[np.ndarray]:
    """Return the pixel centres along each axis; 0 is the first sample's.

    The frame is in the middle of the samples.
    """
    ratio, found = scene.samples_per_pixel, []
    for have, count in zip(scene.content.shape, scene.shape, strict=True):
        spare = (have - 2 * scene.margin - ratio * count) / 2
        found.append(scene.margin + spare + ratio * (np.arange(count) + 0.5) - 0.5)
    return found


def reach_of(spreads, shape, border) -> int:
    """Return the samples within which all light is summed. Raises OutOfRange."""
    reach = max(
        NEAREST, RINGS * max(of.q for of in spreads), ROOM * max(of.radius for of in spreads)
    )
    if reach > FARTHEST * 1.25:
        raise OutOfRange(
            "spread",
            f"{reach:.0f} samples",
            f"up to {FARTHEST * 1.25:.0f} within which light is summed",
        )
    if border == "zero":
        return max(shape)
    return ceil(min(reach, FARTHEST))


def rates(scene, camera) -> np.ndarray:
    """Return electrons per second of every channel and pixel before fall-off, (C, rows, cols).

    The lens is uniform over the field. Raises OutOfRange.
    """
    pitch, ratio = camera.sensor.pixel_pitch / scene.samples_per_pixel, scene.samples_per_pixel
    width = (ratio * np.sqrt(camera.sensor.fill_factor),) * 2
    spreads = [spread_of(camera.optics, wavelength, pitch) for wavelength in scene.wavelengths]
    weights, places = spectral_weights(scene, camera), centres(scene)
    reach = reach_of(spreads, scene.content.shape, scene.border)
    if ratio != 1 and not (ratio == int(ratio) and camera.sensor.fill_factor == 1):
        raise OutOfRange(
            "samples per pixel",
            ratio,
            "1, or 2 or 3 with a fill factor of 1: apertures on whole samples",
        )
    phase = tuple(float(at[0] % 1) for at in places)
    chosen = np.ix_(*(np.floor(at).astype(int) for at in places))
    total = np.zeros((len(weights), *scene.shape))
    afar = np.zeros((len(weights), *scene.content.shape))
    for band, (of, share) in enumerate(zip(spreads, weights.T, strict=True)):
        plane = spectra(scene.content, band)
        if not plane.any():
            continue
        world = np.pad(plane, reach, mode=MODES[scene.border])
        near = kernel(of, reach, width, phase)
        # apertures with gaps see points, not the light between them: a flat field is right by definition
        share = share / (1.0 if width[0] == ratio else near.sum() + energy_beyond(of, reach))
        afar += of.q * share[:, None, None] * plane
        total += share[:, None, None] * fftconvolve(world, near, "valid")[chosen]
    return total + from_afar(afar, spreads[0], reach, scene.border, *places)


def exposed(channels, scene, camera, seconds: float) -> np.ndarray:
    """Return mean electrons of the mosaic, or of stacked pixels (C, rows, cols), with fall-off."""
    rows, cols = scene.shape
    slope = camera.sensor.pixel_pitch / camera.optics.focal_length
    y, x = (slope * (np.arange(n) - (n - 1) / 2) for n in (rows, cols))
    if camera.optics.relative_illumination == "cos4":
        channels = channels / (1 + y[:, None] ** 2 + x**2) ** 2
    if not camera.sensor.stacked:
        names = camera.sensor.cfa
        index = np.array(
            [
                [
                    camera.sensor.channels.index(names[i % len(names)][j % len(names[0])])
                    for j in range(cols)
                ]
                for i in range(rows)
            ]
        )
        channels = np.take_along_axis(channels, index[None], 0)[0]
    return seconds * channels


def mean_electrons(scene, camera, seconds: float) -> np.ndarray:
    """Return mean electrons of every pixel. Raises OutOfRange if the sums would take too long."""
    return exposed(rates(scene, camera), scene, camera, seconds)

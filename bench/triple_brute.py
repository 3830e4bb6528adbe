"""Point spreads and far light for `triple_outside.py`; nothing is shared with the planner, its truth or its kernels.

A round pupil has its spread by Hankel's integral, a polygon by Gauss's rule over its chords. The spread is sampled as
finely as its band limit asks for and integrated over the pixels' apertures by the transform of a box. Beyond a reach
it is the mean of its rings, or for straight blades the rays that their edges throw: light is summed along rays.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import ceil

import numpy as np
import scipy.fft
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import j0, j1

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
    def corners(self) -> np.ndarray:
        """Corners of the polygon, (y, x), shape (blades, 2)."""
        angles = self.turned + 2 * np.pi * np.arange(self.blades) / self.blades
        return np.stack([np.sin(angles), np.cos(angles)], axis=1)


def round_spread(of: Spread, reach: float, is_tilted=False):
    """Return energy per square sample at a distance: Born and Wolf, 8.5 and 8.8; tabulated.

    is_tilted: times the place in the pupil, along the distance: see `spreads` of `triple_pupils.py`.
    """
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
    energy = np.abs(field) ** 2
    if is_tilted:  # the gradient of the field is i pi / q times its integral with the place
        slope = np.concatenate(
            [
                j1(np.pi / of.q * np.outer(part, rho)) @ (rho * pupil)
                for part in np.array_split(r, 64)
            ]
        )
        energy = -(field.conj() * slope).imag
    return CubicSpline(r, np.pi / of.q**2 * energy / (1 - of.hole**2))


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
        return np.zeros((len(planes), len(rows), len(cols)))  # all light is nearer
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


def spectra(content, chosen) -> np.ndarray:
    """Return a band of a content, float64 (rows, cols)."""
    if content.form == "cube":
        return content.values[chosen].astype(np.float64)
    if content.form == "materials":
        return content.spectra[content.ids, chosen] * content.shading.astype(np.float64)
    content = content.on_host()
    return np.tensordot(content.basis[:, chosen], content.coefficients.astype(np.float64), 1)

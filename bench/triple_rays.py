"""Visibility at depth edges by rays through the pupil, for `triple_outside.py`.

A point of the pupil sees sharp sheets, displaced by the slope of each sheet's wavefront there, and
nearer ones hide farther ones. The mean over the pupil is the image of geometrical optics. Sheets
that are composed after their blur miss the covariance of coverage and light: over the pupil, and
within the blur of diffraction, before which points are hidden. The difference of rays, blurred by
diffraction, and of the composition of each sheet's mean, blurred so, is added to sums that are
composed so. A measured lens has no rays of its own: its blur in focus is taken for diffraction.
"""

from dataclasses import replace

import numpy as np
import scipy
import triple_brute as brute
from scipy.ndimage import shift
from triple_lens import Lens, kernels, measured_kernels

from gpusim.domain.pupil import Wavefront

POINTS = 300  # of the pupil
NEAR = 20  # [sample] around the places of rays
FAR = 80  # [sample] of the kernel in focus
TINY = 1e-4  # of the radius of the pupil: for differences


def pupil_points(pupil) -> np.ndarray:
    """Return points (u, v) of a pupil, even in area: a spiral of golden angles, (2, POINTS)."""
    count = POINTS
    while True:
        k = np.arange(count) + 0.5
        r, angle = np.sqrt(k / count), k * np.pi * (3 - np.sqrt(5))
        u, v = r * np.cos(angle), r * np.sin(angle)
        inside = r >= pupil.obscuration
        if pupil.blades:
            half = np.pi / pupil.blades
            turn = (np.arctan2(v, u) - pupil.rotation) % (2 * half) - half
            inside &= r * np.cos(turn) <= np.cos(half)
        if inside.sum() >= POINTS:
            return np.stack([u[inside], v[inside]])
        count = int(count * 1.3)


def hidden_difference(lens, sheets, weights, chosen_from, by_distance, slopes) -> np.ndarray:
    """Return the covariance over the pupil at all pixels, electrons per second (C, rows, cols).

    sheets: light times coverage (L, rows, cols), coverage and distances, nearest first. weights: of
    the channels (C, L). chosen_from: first row and column of the pixels' samples. by_distance, slopes:
    functions of `triple_outside.py`.
    """
    scene, optics = lens.scene, lens.camera.optics
    middle = float(np.median(scene.wavelengths))
    u, v = pupil_points(optics.pupil)
    q = lens.q(middle)

    def rays(distance):
        waves = lens.waves(middle, 0.0, 0.0, distance)
        across = -2 * q * (waves(u + TINY, v) - waves(u - TINY, v)) / (2 * TINY)
        down = -2 * q * (waves(u, v + TINY) - waves(u, v - TINY)) / (2 * TINY)
        return np.stack([down, across], 1)

    ends = [rays(extreme(one)) for *_, one in sheets for extreme in (np.min, np.max)]
    pad = int(np.ceil(max(1.0, max(np.hypot(*one.T).max() for one in ends)))) + NEAR + 2
    parts = []
    for light, cover, distances in sheets:
        planes = np.tensordot(weights, light, 1)
        planes, cover, distances = _padded(scene.border, planes, cover, distances, pad)
        slope = slopes(lens, distances)
        parts.append(
            [
                (planes * share, cover * share, slope, rays(distance))
                for distance, share in by_distance(distances)
            ]
        )
    seen, means = 0.0, [[0.0, 0.0] for _ in parts]
    for point in range(len(u)):
        through = 1.0
        for own, mean in zip(parts, means, strict=True):
            shown = 1 + v[point] * own[0][2][0] + u[point] * own[0][2][1]
            light = sum(_moved(planes * shown, at[point]) for planes, _, _, at in own)
            cover = sum(_moved((cover * shown)[None], at[point])[0] for _, cover, _, at in own)
            seen = seen + through * light
            through = through * (1 - np.clip(cover, 0, 1))
            mean[0], mean[1] = mean[0] + light, mean[1] + cover
    place = (0.0, 0.0, optics.object_distance)
    if optics.model == "measured":
        (own,) = measured_kernels(lens, middle, [place[:2]], FAR)
    else:
        # rays have the aberrations
        flat = replace(optics, wavefront=Wavefront(), defocus=0.0, lateral_color=0.0)
        plain = Lens(scene, replace(lens.camera, optics=flat))
        (own,) = kernels(plain, middle, [place], FAR)

    def blurred(planes):
        wide = np.pad(planes, ((0, 0), (FAR, FAR), (FAR, FAR)), mode="edge")
        return scipy.signal.fftconvolve(wide, own[None] / own.sum(), "valid", axes=(1, 2))

    apart, through = 0.0, 1.0
    for light, cover in means:
        apart = apart + through * blurred(light / len(u))
        through = through * (1 - np.clip(blurred(cover[None] / len(u))[0], 0, 1))
    change = blurred(seen / len(u)) - apart
    ratio = int(scene.samples_per_pixel)
    places = [
        pad + at + ratio * np.arange(n) for at, n in zip(chosen_from, scene.shape, strict=True)
    ]
    return change[:, places[0][:, None], places[1]]


def _padded(border, planes, cover, distances, pad):
    wide = ((pad, pad), (pad, pad))
    outside = "symmetric" if border == "reflect" else "edge"
    return (
        np.pad(planes, ((0, 0), *wide), mode=brute.MODES[border]),
        np.pad(cover, wide, mode=outside),
        np.pad(distances, wide, mode=outside),
    )


def _moved(planes, at):
    return np.stack(
        [shift(plane, at, order=1, mode="nearest", prefilter=False) for plane in planes]
    )

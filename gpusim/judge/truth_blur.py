"""The truth of a blur that is the same all over the field, float64.

Every wavelength is computed separately, in a world that continues to infinity. Samples are points
of light, and a uniform scene gives uniform pixels. A mirrored world repeats every two frames, and
so does a transform of that length, exactly. Other worlds are transformed with REACH samples around
the frame; the smooth light from beyond comes from a coarse grid (`gpusim.optics.outside.unseen_light`). A
pupil with straight blades throws light along their normals, in beams too narrow for a coarse grid,
which takes the mean over directions: BLADES_REACH samples surround the frame. Beyond the margin of
a scene its outermost samples continue.

A pixel is the integral over its aperture at its place among the samples. All frequencies that the
lens passes are evaluated there; nothing is interpolated.
"""

from math import ceil

import numpy as np
import scipy

from gpusim.data.weights import electrons_per_content
from gpusim.domain.optics import Optics
from gpusim.judge.truth_lens import transfer_of
from gpusim.judge.truth_light import MODES, centre_pads, pixel_places
from gpusim.optics.lenses import open_lens
from gpusim.optics.outside import at_samples, rule_of, unseen_light

REACH, BLADES_REACH = 256, 1024  # [sample] around the frame
RINGS, RADII = 64, 6  # as many rings of the diffraction, and radii of the spread, at least
CELLS = 32  # of the coarse grid along the reach


def period_of(optics: Optics, scene, pitch: float, displaced: int = 0) -> tuple[int, int]:
    """Return rows and columns of the transforms that a scene needs.

    Args:
        optics: The lens.
        scene: The scene.
        pitch: Distance of the samples [m].
        displaced: Largest displacement of the apertures [sample].
    """
    shape = [n + 2 * scene.margin for n in scene.samples]
    lens = open_lens(optics, pitch)
    reach = ceil(lens.spread(scene.wavelengths)) + 2
    if scene.border == "reflect":
        more = 2 * displaced + (0 if lens.tail else 2 * reach)
        return tuple(2 * n * ceil((n + more) / (2 * n)) for n in shape)
    if lens.tail:
        q = scene.wavelengths.max() * 1e-9 * optics.working_f_number / pitch
        reach = max(RADII * reach, ceil(RINGS * q), BLADES_REACH if lens.tail.lines else REACH)
    return tuple(scipy.fft.next_fast_len(n + 2 * (reach + displaced), real=True) for n in shape)


def blurred_rates(light, camera, scene) -> np.ndarray:
    """Return electrons per second of every pixel in every channel before fall-off, (C, rows, cols).

    Args:
        light: Light of every wavelength at its place in the image, (L, rows, cols), with the margin
            of the scene.
        camera: The camera.
        scene: The scene.
    """
    weights = electrons_per_content(scene, camera)
    total, evens = np.zeros((len(weights), *scene.shape)), np.ones(len(light))
    wanted = weights.any(axis=0) & light.any(axis=(1, 2))
    optics, q, period, places = _period_and_places(camera, scene)
    for k, seen, even in _near_planes(light, camera, scene, scene.border, wanted):
        total += weights[:, k, None, None] * seen
        evens[k] = even
    return total + far_rates(weights * q / evens, light, optics, scene, period, places)


def blurred_planes(light, camera, scene, border: str) -> np.ndarray:
    """Return the mean irradiance over every pixel, at every wavelength, (L, rows, cols).

    A uniform scene has the value of its samples.

    Args:
        light: As for `blurred_rates`.
        camera: The camera.
        scene: The scene.
        border: Rule by which the light continues, instead of the scene's.
    """
    total, evens = np.zeros((len(light), *scene.shape)), np.ones(len(light))
    optics, q, period, places = _period_and_places(camera, scene)
    for k, seen, even in _near_planes(light, camera, scene, border, light.any(axis=(1, 2))):
        total[k], evens[k] = seen, even
    return total + far_rates(np.diag(q / evens), light, optics, scene, period, places, border)


def _period_and_places(camera, scene):
    """Return the lens, q of every wavelength, the period, and the pixels' places."""
    optics, sensor, ratio = camera.optics, camera.sensor, float(scene.samples_per_pixel)
    pitch = sensor.pixel_pitch / ratio
    displaced = ceil(ratio * max(map(abs, sensor.displacement))) + ceil(ratio)
    period = period_of(optics, scene, pitch, displaced=displaced)
    q = scene.wavelengths * 1e-9 * optics.working_f_number / pitch
    return optics, q, period, pixel_places(camera, scene)


def _near_planes(light, camera, scene, border, wanted):
    """Yield number, mean irradiance, and the irradiance of a uniform scene, of each wanted wavelength."""
    optics, _, period, places = _period_and_places(camera, scene)
    pitch = camera.sensor.pixel_pitch / float(scene.samples_per_pixel)
    wide = [side / pitch for side in camera.sensor.aperture]
    pads = centre_pads(period, light.shape[1:])
    at = [first + scene.margin + place for (first, _), place in zip(pads, places, strict=True)]
    for k in np.flatnonzero(wanted):
        spectrum = scipy.fft.rfft2(np.pad(light[k], pads, mode=MODES[border]), workers=-1)
        transfer, cut = transfer_of(optics, scene.wavelengths[k], pitch)
        yield k, *_at_pixels(spectrum, period, transfer, cut, wide, at)


def far_rates(
    weights, light, optics, scene, period, places, rule: str | None = None
) -> np.ndarray | float:
    """Return the light from beyond the transforms, (C, rows, cols), or 0.

    Args:
        weights: Electrons per content times q, shape (C, L).
        light: As for `blurred_rates`.
        optics: The lens.
        scene: The scene.
        period: Rows and columns of the transforms.
        places: Rows and columns of the pixels among the samples.
        rule: Rule by which the light continues; None: the scene's.
    """
    border, tail = rule_of(rule or scene.border), open_lens(optics, 1.0).tail
    if border == "reflect" or tail is None:
        return 0.0
    around = min(length - n for length, n in zip(period, light.shape[1:], strict=True)) / 2
    cell = max(around / CELLS, 1)
    rows, cols = (scene.margin + place for place in places)
    rates = []
    for seen in np.tensordot(weights, light, 1):
        far = unseen_light(seen, period, border, cell, tail.strength, times=(3, 5, 7), soft=2)
        rates.append(at_samples(far, seen.shape, period, rows, cols))
    return np.stack(rates)


def _at_pixels(spectrum, period, transfer, cut, wide, places):
    """Return the mean irradiance over the apertures relative to a uniform scene, and the latter.

    transfer: Transfer function of the lens at fy, fx [cycle/sample], 0 from `cut` on. If cut is 0,
    it includes the pixels. wide: Height and width of the apertures. places: Their rows and columns
    in the period [sample].
    """
    fy, fx = np.fft.fftfreq(period[0]), np.arange(period[1] // 2 + 1) / period[1]
    apart = [place - place[0] for place in places]
    whole = all(np.abs(place - np.rint(place)).max() < 1e-9 for place in apart)
    first = [place[0] if whole else 0.0 for place in places]
    rest = apart if whole else places
    # the other half of the columns is the conjugate at the opposite frequencies
    twice = np.where((np.arange(len(fx)) == 0) | (2 * np.arange(len(fx)) == period[1]), 1.0, 2.0)
    folded, seen, even = np.zeros(spectrum.shape, complex), 0.0, 0.0
    for a, b in _replicas(cut):
        y, x = fy + a, fx + b
        if cut and np.hypot(np.abs(y).min(), np.abs(x).min()) > cut:
            continue
        passed = np.s_[:, :]
        if cut and whole:  # beyond it the table is 0
            rows, cols = (np.flatnonzero(np.abs(f) <= cut) for f in (y, x))
            y, x, passed = y[rows], x[cols], np.ix_(rows, cols)
        down, across = (
            (np.sinc(side * f) if cut else 1.0) * np.exp(2j * np.pi * f * start)
            for side, f, start in zip(wide, (y, x), first, strict=True)
        )
        table = transfer(y, x) * down[:, None] * across
        if whole:
            folded[passed] += table
            continue
        to_y, to_x = (
            np.exp(2j * np.pi * np.outer(place, f)) for place, f in zip(rest, (y, x), strict=True)
        )
        seen = seen + (to_y @ ((table * spectrum * twice) @ to_x.T)).real / np.prod(period)
        even = even + (to_y[:, :1] * table[0, 0] * to_x[:, 0]).real
    if not whole:
        return seen / even, float(np.mean(even))
    picture = scipy.fft.irfft2(folded * spectrum, period, workers=-1)
    wrapped = [
        np.rint(place).astype(int) % length for place, length in zip(rest, period, strict=True)
    ]
    at = np.ix_(*wrapped)
    even = float(folded[0, 0].real)
    return picture[at] / even, even


def _replicas(cut):
    """Return the whole frequencies around which sampling repeats the spectrum of the lens."""
    reach = range(-ceil(cut + 0.5), ceil(cut + 0.5) + 1) if cut else (0,)
    return [(a, b) for a in reach for b in reach]

"""The truth about frames whose blur varies over the field: light of every sample is spread as at its own place.

The lens as on its axis gives the whole frame (`gpusim.truth`). Beside it every sample's light is spread by the
difference of its own kernel from that on the axis, which ends sooner. The differences are splines of degree 5 in the
place, through those at up to PLACES places along each axis of the frame, wavelength by wavelength.
"""

from math import ceil, prod

import numpy as np
import scipy

from gpusim.domain.optics import Optics
from gpusim.optics.lens import PupilLens, open_lens, spread_radius, wavelength_nodes
from gpusim.planner.border import border_indices

PLACES, DEGREE = 25, 5  # along an axis; of the splines between them
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


def varying_rates(camera, scene, plan, light, base, parts) -> list[np.ndarray]:
    """The mosaic of a lens whose blur varies over the field, before fall-off, in parts of the frame [e- s-1].

    light: the content's planes of wavelengths, float64, shape (L, rows, cols), with the scene's margin. base: the
    mosaic of the lens as on its axis, (rows, cols). parts: see `blocks`. The scene has one sample per pixel. Flat
    fields of every wavelength stay flat: pixels take the mean of what they gather from places of different kernels.
    """
    sensor, margin = camera.sensor, scene.margin
    lens = open_lens(camera.optics, sensor.pixel_pitch, np.array(sensor.aperture) / sensor.pixel_pitch, scene.shape,
                     sensor.displacement)
    size = max(2 * _reach(camera.optics, scene, sensor.pixel_pitch) + 1, lens.least_size // 2 * 2 + 1)
    chosen, between = wavelength_nodes(scene.wavelengths)
    axes = [np.linspace(-margin, n - 1 + margin, min(n + 2 * margin, PLACES)) for n in scene.shape]
    taken = [_taken(light, part, size // 2, margin, scene.border) for part in parts]
    # electrons of every channel as on the axis and as spread, and what a flat field of 1 gives, by wavelength
    spread = [np.zeros((len(chosen), len(plan.weights) + 1, *(at.stop - at.start for at in part))) for part in parts]
    alike = [np.zeros_like(one[:, :-1]) for one in spread]
    for node, wavelength in enumerate(chosen):
        axis = lens.kernels([wavelength], (0.0, 0.0), size)[0]
        terms = _terms(lens, wavelength, axis, axes, scene.shape)
        for part, window, own, more in zip(parts, taken, alike, spread, strict=True):
            seen = np.tensordot(plan.weights * between[:, node], window, 1)
            own[node] = scipy.signal.fftconvolve(seen, axis[None] / axis.sum(), "valid", axes=(1, 2))
            _spread(more[node], np.concatenate([seen, np.ones_like(seen[:1])]), terms, axes, part, size // 2)
    return [_evened(base[part], own, more, _channels(sensor, part)) for part, own, more in zip(
        parts, alike, spread, strict=True)]


def _evened(base, alike, spread, channel):
    """The mosaic where flat fields of every wavelength stay flat; channel: of each pixel."""
    flat = 1 + spread[:, -1:]
    whole = flat.mean(axis=0)
    more = spread[:, :-1].sum(axis=0) / whole + ((alike + spread[:, :-1]) * (1 / flat - 1 / whole)).sum(axis=0)
    return base / whole[0] + np.take_along_axis(more, channel[None], 0)[0]


def _channels(sensor, part):
    """Channel of each pixel of a part of the frame."""
    y, x = (np.arange(at.start, at.stop) % n for at, n in zip(part, sensor.cfa_indices.shape, strict=True))
    return sensor.cfa_indices[y[:, None], x]


def _reach(optics: Optics, scene, pitch) -> int:
    """How far differences go [sample]."""
    q = scene.wavelengths.max() * 1e-9 * optics.working_f_number / pitch
    corner = np.hypot(*scene.shape) / 2
    lateral = np.abs(optics.lateral_color_at(scene.wavelengths)).max() * corner
    return ceil(max(LEAST_REACH, RINGS * q, RADII * spread_radius(optics, scene.wavelengths, pitch, 1.0)) + lateral)


def _taken(light, part, half, margin, border):
    """Light of a part and `half` samples around it, as the border says."""
    at = [np.arange(one.start - half, one.stop + half) + margin for one in part]
    y, x = (border_indices(places, n, border) for places, n in zip(at, light.shape[1:], strict=True))
    window = light[:, y[:, None], x]
    if border == "zero":
        window = window * ((y == at[0])[:, None] & (x == at[1]))
    return window


def _terms(lens, wavelength, axis, axes, shape):
    """Coefficients of the splines of the differences from the kernel `axis`, (size, size): (P, Q, size, size)."""
    middle, corner, size, known = (np.array(shape) - 1) / 2, np.hypot(*shape) / 2, len(axis), {}
    mirrored = isinstance(lens, PupilLens) and lens.optics.has_mirror and not any(lens.displacement)
    table = np.empty((*map(len, axes), size, size))
    for i, j in np.ndindex(*map(len, axes)):
        y, x = (axes[0][i] - middle[0]) / corner, (axes[1][j] - middle[1]) / corner
        at = (round(abs(y), 9), round(abs(x), 9)) if mirrored else (y, x)
        if at not in known:
            own = lens.kernels([wavelength], at, size)[0] - axis
            known[at] = own - own.mean()
        turned = (slice(None, None, -1 if mirrored and side < 0 else 1) for side in (y, x))
        table[i, j] = known[at][tuple(turned)]
    for number, places in enumerate(axes):
        through = scipy.interpolate.make_interp_spline(places, np.moveaxis(table, number, 0), _degree(places))
        table = np.moveaxis(through.c, 0, number)
    return table


def _degree(places):
    return min(DEGREE, len(places) - 1)


def _spread(total, seen, terms, axes, part, half):
    """Add light (C, h + 2 half, w + 2 half) as the splines' terms spread it; that from outside as at the border."""
    windows = []
    for at, places in zip(part, axes, strict=True):
        knots = scipy.interpolate.make_interp_spline(places, np.zeros(len(places)), _degree(places)).t
        source = np.clip(np.arange(at.start - half, at.stop + half), places[0], places[-1])
        windows.append(scipy.interpolate.BSpline.design_matrix(source * 1.0, knots, _degree(places)).toarray())
    for i, j in np.ndindex(terms.shape[:2]):
        along = [np.flatnonzero(window[:, k]) for window, k in zip(windows, (i, j), strict=True)]
        if not all(map(len, along)):
            continue
        (top, bottom), (left, right) = ((one[0], one[-1] + 1) for one in along)
        weight = windows[0][top:bottom, i, None] * windows[1][left:right, j]
        wide = scipy.signal.fftconvolve(seen[:, top:bottom, left:right] * weight, terms[None, i, j], axes=(1, 2))
        # light at s gives the pixel x its kernel's entry x - s: the first of `wide` is `half` before its first source
        y, x = top - 2 * half, left - 2 * half
        inside = [slice(max(-first, 0), min(n - first, length))
                  for first, n, length in zip((y, x), total.shape[1:], wide.shape[1:], strict=True)]
        total[:, y + inside[0].start : y + inside[0].stop, x + inside[1].start : x + inside[1].stop] += wide[
            :, inside[0], inside[1]]

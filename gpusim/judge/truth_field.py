"""The truth of a blur that varies over the field, float64: each sample is spread by its own kernel.

`gpusim.judge.truth_blur` computes the whole frame with the kernel on the axis. This module adds the
light of every sample, spread by the difference of its own kernel from the kernel on the axis. The
difference ends sooner and has no energy: a star keeps its energy, and a flat field is the sum of
its points. Field points are relative to the optical axis.
"""

import dataclasses
from math import prod

import numpy as np
import scipy

from gpusim.data.weights import electrons_per_content
from gpusim.judge.truth_lens import field_of, first_places
from gpusim.judge.truth_light import axis_of
from gpusim.optics.lenses import lens_of
from gpusim.optics.outside import border_indices

WHOLE = 2**17  # pixels of a frame up to which all are looked at
BLOCKS, SIDE = 16, 32  # of others


def blocks(shape) -> list[tuple[slice, slice]]:
    """Return the parts of a frame that are judged.

    A small frame is one part. A large one has BLOCKS parts of SIDE x SIDE pixels, at the places of
    a Halton sequence.

    Args:
        shape: Rows and columns of the frame.
    """
    if prod(shape) <= WHOLE:
        return [(slice(0, shape[0]), slice(0, shape[1]))]
    fractions = scipy.stats.qmc.Halton(2, scramble=False).random(BLOCKS + 1)[1:]
    first = (fractions * np.maximum(np.array(shape) - SIDE, 0)).astype(int)
    rows, cols = shape
    ends = ((y, min(y + SIDE, rows), x, min(x + SIDE, cols)) for y, x in first.tolist())
    return [np.s_[top:bottom, left:right] for top, bottom, left, right in ends]


def varying_rates(light, camera, scene, parts) -> list[np.ndarray]:
    """Return the electrons per second beyond the blur on the axis, one array (C, h, w) per part.

    Args:
        light: Light of every wavelength at its place in the image, (L, rows, cols), with the margin
            of the scene, a whole number of samples per pixel.
        camera: The camera.
        scene: The scene.
        parts: Parts of the frame, see `blocks`.

    Raises:
        DoesNotFit: The kernels need more memory than MOST_BYTES.
    """
    lens, weights = field_of(camera, scene), electrons_per_content(scene, camera)
    ratio, (first, _) = int(scene.samples_per_pixel), first_places(camera, scene)
    places = [
        [
            slice(at + ratio * one.start, at + ratio * (one.stop - 1) + 1)
            for at, one in zip(first, part, strict=True)
        ]
        for part in parts
    ]
    total = [np.zeros((len(weights), *(at.stop - at.start for at in part))) for part in places]
    for wavelength, share in zip(*lens.wavelengths(scene.wavelengths), strict=True):
        seen = np.tensordot(weights * share, light, 1)
        if not seen.any():
            continue
        kernels = lens.differences(wavelength)
        for one, part in zip(total, places, strict=True):
            window = _take_windows(seen, part, lens.half, scene.margin, scene.border)
            _spread(one, window, kernels, lens.limits, part)
    return [one[:, ::ratio, ::ratio] for one in total]


def flat_fields(camera, scene, parts) -> list:
    """Return the flat field of a blur that varies, relative to the axis, one array (h, w) per part.

    A relative illumination that is given includes it already; 1 without one.
    """
    if isinstance(camera.optics.relative_illumination, str) or lens_of(camera).is_uniform:
        return [1.0] * len(parts)
    weights = electrons_per_content(scene, camera)
    axis = [
        int(np.clip(round((n - 1) / 2 + at), 0, n - 1))
        for n, at in zip(scene.shape, axis_of(camera, scene.shape), strict=True)
    ]
    own = tuple(slice(at, at + 1) for at in axis)
    even = dataclasses.replace(scene, border="edge" if scene.border == "zero" else scene.border)
    light = np.ones((weights.shape[1], *scene.content.shape))
    found = varying_rates(light, camera, even, [*parts, own])
    *flats, middle = (1 + one.sum(axis=0) / weights.sum() for one in found)
    return [flat / middle for flat in flats]


def _take_windows(light, part, half, margin, border):
    """Return the light of a part and `half` samples around it, continued by the border rule."""
    at = [np.arange(one.start - half, one.stop + half) + margin for one in part]
    y, x = (
        border_indices(places, n, border) for places, n in zip(at, light.shape[1:], strict=True)
    )
    window = light[:, y[:, None], x]
    if border == "zero":
        window = window * ((y == at[0])[:, None] & (x == at[1]))
    return window


def _spread(total, light, kernels, limits, part):
    """Add light (C, h + 2 half, w + 2 half) to `total` (C, h, w), after its spread.

    Light from beyond `limits` has the kernels of the limits.
    """
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
            y, x = inside
            there = np.s_[:, top + y.start : top + y.stop, left + x.start : left + x.stop]
            total[there] += wide[:, y, x]

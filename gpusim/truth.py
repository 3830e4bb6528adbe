"""The truth about frames: exact mean electrons in a world that goes on without end as its border says.

Every wavelength by itself, in float64, nothing split off and nothing folded. A mirrored world repeats itself every two
frames, and so does a transform of that length, exactly. Any other is transformed with REACH samples around the frame;
what lies beyond is smooth light from afar, and comes from a coarse grid (`gpusim.planner.border`). A pupil with
straight blades throws it along their normals instead, too narrow for a coarse grid, which takes the mean over
directions: with BLADES_REACH samples around the frame. Beyond a scene's own margin its outermost samples go on.

Where the blur varies over the field, this is done at single pixels.
"""

import dataclasses
from math import ceil
from typing import Any

import numpy as np
import scipy.fft

from gpusim.domain.errors import OutOfRange
from gpusim.optics.lens import open_lens, spread_radius, wavelength_nodes
from gpusim.planner.border import at_samples, rule_of, tail_of, unseen
from gpusim.report import Error

REACH, BLADES_REACH = 256, 1024  # [sample] around the frame
RINGS, RADII = 64, 6  # as many rings of the diffraction, and radii of the spread, at least
CELLS = 32  # of the coarse grid along the reach
PROBES = 16  # pixels
SIZE = 61  # of the kernels' differences from that on the axis [pixel]
PLACES = 5  # along each axis of a kernel's reach: kernels are polynomials of degree 4 in their place


def require_truth(camera, scene):
    """Raise OutOfRange for a camera and a scene of which the truth is not known."""
    if camera.optics.varies and scene.samples_per_pixel != 1:
        raise OutOfRange("verify", f"{scene.samples_per_pixel:g} samples per pixel with a blur that varies over the "
                         "field", "1 sample per pixel")
    if camera.optics.varies and camera.sensor.stacked:
        raise OutOfRange("verify", "stacked pixels with a blur that varies over the field", "a mosaic")


def true_error(simulator, scene, exposure) -> Error:
    """Error of an exposure's mean electrons; simulator: by which it was made. Raises DoesNotFit."""
    mean = np.array(simulator.device.numpy(exposure.mean), np.float32)
    of = type(simulator), simulator.camera, scene, exposure.plan, exposure.exposure_time
    if exposure.plan.varying is None:
        truth = true_mean(*of)
    else:
        pixels = probe_pixels(scene.shape)
        truth, mean = at_pixels(*of, pixels), mean[pixels[:, 0], pixels[:, 1]]
    return Error.between(mean, truth, simulator.camera.sensor.read_sigma)


def probe_pixels(shape) -> np.ndarray:
    """Rows and columns of PROBES pixels spread over the frame, int (PROBES, 2): a Halton sequence.

    Where the frame is large enough they are farther from its border than a kernel reaches.
    """
    def halton(base):
        values = np.zeros(PROBES)
        for k in range(PROBES):
            number, part = k + 1, 1.0
            while number:
                part /= base
                number, digit = divmod(number, base)
                values[k] += part * digit
        return values

    fractions, shape = np.stack([halton(2), halton(3)], axis=1), np.array(shape)
    margin = np.minimum(SIZE // 2, shape // 4)
    return (margin + fractions * (shape - 2 * margin)).astype(int)


def true_mean(simulator, camera, scene, plan, exposure_time) -> np.ndarray:
    """Mean electrons of every pixel, float64, shape (rows, cols) or, of stacked pixels, (C, rows, cols).

    simulator: the class `Simulator`, which imports this module. plan: of the frame. Raises DoesNotFit, before
    anything is allocated.
    """
    reference = _reference(simulator, camera, scene, plan)
    own = reference.plan(scene)
    rates, cfa = reference.imaging.rates(own)
    border, tail = rule_of(scene.border), tail_of(camera.optics)
    if own.mix is not None and border != "reflect" and tail:
        light = reference.imaging.light(own)
        light = np.tensordot(own.weights / own.flat * own.q, light, 1)  # of each channel, times q
        rows, cols = (np.arange(scene.margin - own.spare, n - scene.margin + own.spare) for n in light.shape[1:])
        around = min(length - n for length, n in zip(own.period, light.shape[1:], strict=True)) / 2
        cell = max(around / CELLS, 1)
        far = np.stack([at_samples(unseen(one, own.period, border, cell, tail, times=(3, 5, 7)), one.shape, own.period,
                                   rows, cols) for one in light])
        rates = rates + reference.imaging.pixels(own, far)
    return reference.imaging.exposed(own, (rates, cfa), exposure_time)


def _reference(simulator, camera, scene, plan):
    """Simulator in float64 whose transforms are as long as this scene needs."""
    if plan.mix is None:
        return simulator(camera, device="numpy")
    optics, shape = camera.optics, [n + 2 * scene.margin for n in scene.samples]
    spread = spread_radius(optics, scene.wavelengths, camera.sensor.pixel_pitch / scene.samples_per_pixel)
    reach = ceil(max(plan.depth.reach if plan.depth else 0, spread)) + 2
    displaced = ceil(scene.samples_per_pixel * max(map(abs, camera.sensor.displacement)))
    if scene.border == "reflect":
        period = [2 * n * ceil((n + 2 * displaced + (2 * reach if optics.psf else 0)) / (2 * n)) for n in shape]
    else:
        if tail_of(optics):
            reach = max(RADII * reach, ceil(RINGS * plan.q.max()), BLADES_REACH if optics.pupil.blades else REACH)
        period = [scipy.fft.next_fast_len(n + 2 * (reach + displaced), real=True) for n in shape]
    return simulator(camera, device="numpy", period=tuple(period))


def at_pixels(simulator, camera, scene, plan, exposure_time, pixels) -> np.ndarray:
    """Mean electrons at `pixels` (row, column), float64.

    simulator, plan: as for `true_mean`. Each wavelength by itself: the whole frame with the lens as on the axis, and at
    each pixel the light of all others around it, spread by the difference of their own kernels from that on the axis.
    The scene has one sample per pixel.
    """
    plain = dataclasses.replace(camera, optics=camera.optics.on_axis())
    reference = _reference(simulator, plain, scene, plan)
    base = true_mean(simulator, plain, scene, reference.plan(scene), exposure_time)
    rows, cols = scene.shape
    sensor = camera.sensor
    lens = open_lens(camera.optics, sensor.pixel_pitch, np.array(sensor.aperture) / sensor.pixel_pitch, (rows, cols),
                     sensor.displacement)
    size = max(SIZE, lens.least_size // 2 * 2 + 1)
    cfa, margin, half = camera.sensor.cfa_indices, scene.margin, size // 2
    planes = reference.imaging.light(reference.plan(scene))
    modes: dict[str, Any] = {"zero": "constant", "edge": "edge", "reflect": "symmetric", "scene": "edge"}
    planes = np.pad(planes, ((0, 0), (half, half), (half, half)), mode=modes[scene.border])
    corner = np.hypot(rows, cols) / 2
    nodes, between = wavelength_nodes(scene.wavelengths)
    axis = lens.kernels(nodes, (0.0, 0.0), size)
    steps = np.linspace(-half, half, PLACES)
    basis = np.linalg.solve(np.vander(steps).T, np.vander(np.arange(-half, half + 1), PLACES).T)  # Lagrange's
    out = np.empty(len(pixels))
    for k, (y, x) in enumerate(pixels):
        channel = cfa[y % cfa.shape[0], x % cfa.shape[1]]
        patch = planes[:, margin + y : margin + y + size, margin + x : margin + x + size]
        patch = np.einsum("l,ln,lij->nij", plan.weights[channel], between, patch, optimize=True)
        total = 0.0
        for dy, along_y in zip(steps, basis, strict=True):
            for dx, along_x in zip(steps, basis, strict=True):
                # light outside the frame is spread as that of the nearest pixel of the planes
                place = (np.clip(y + dy, -margin, rows - 1 + margin) - (rows - 1) / 2,
                         np.clip(x + dx, -margin, cols - 1 + margin) - (cols - 1) / 2)
                kernels = lens.kernels(nodes, np.array(place) / corner, size) - axis
                # light at s gives its kernel's entry x - s
                total += np.einsum("nij,nij,i,j->", patch, kernels[:, ::-1, ::-1], along_y, along_x, optimize=True)
        v, u = (y - (rows - 1) / 2) * plan.slope, (x - (cols - 1) / 2) * plan.slope
        falloff = (1 + u * u + v * v) ** -2 * (1.0 if plan.falloff is None else plan.falloff[y, x])
        out[k] = base[y, x] + exposure_time * falloff * total
    return out

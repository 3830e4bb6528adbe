"""The truth about frames whose blur varies over the field: exact mean electrons, at single pixels."""

import dataclasses
from typing import Any

import numpy as np

from gpusim.planner.lens import open_lens, wavelength_nodes

PROBES = 16  # pixels
SIZE = 61  # of the kernels' differences from that on the axis [pixel]
PLACES = 5  # along each axis of a kernel's reach: kernels are polynomials of degree 4 in their place


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


def at_pixels(reference, scene, made, exposure_time, pixels) -> np.ndarray:
    """Mean electrons at `pixels` (row, column), float64.

    reference: Simulator of the camera on the device "numpy". made: the plan of its frame. Each wavelength by itself:
    the whole frame with the lens as on the axis, and at each pixel the light of all others around it, spread by the
    difference of their own kernels from that on the axis. The scene has one sample per pixel.
    """
    camera = reference.camera
    plain = dataclasses.replace(camera, optics=camera.optics.on_axis())
    base = type(reference)(plain, device="numpy", reach=max(scene.shape)).expose(scene, exposure_time).mean
    rows, cols = scene.shape
    sensor = camera.sensor
    lens = open_lens(camera.optics, sensor.pixel_pitch, np.array(sensor.aperture) / sensor.pixel_pitch, (rows, cols),
                     sensor.displacement)
    size = max(SIZE, lens.least_size // 2 * 2 + 1)
    cfa, margin, half = camera.sensor.cfa_indices, scene.margin, size // 2
    planes = reference.light(made)
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
        patch = np.einsum("l,ln,lij->nij", made.weights[channel], between, patch, optimize=True)
        total = 0.0
        for dy, along_y in zip(steps, basis, strict=True):
            for dx, along_x in zip(steps, basis, strict=True):
                # light outside the frame is spread as that of the nearest pixel of the planes
                place = (np.clip(y + dy, -margin, rows - 1 + margin) - (rows - 1) / 2,
                         np.clip(x + dx, -margin, cols - 1 + margin) - (cols - 1) / 2)
                kernels = lens.kernels(nodes, np.array(place) / corner, size) - axis
                # light at s gives its kernel's entry x - s
                total += np.einsum("nij,nij,i,j->", patch, kernels[:, ::-1, ::-1], along_y, along_x, optimize=True)
        v, u = (y - (rows - 1) / 2) * made.slope, (x - (cols - 1) / 2) * made.slope
        falloff = (1 + u * u + v * v) ** -2 * (1.0 if made.gain is None else made.gain[y, x])
        out[k] = base[y, x] + exposure_time * falloff * total
    return out

"""The truth about frames: exact mean electrons in a world that goes on without end as its border says.

Every wavelength by itself, in float64, nothing split off and nothing folded. A mirrored world repeats itself every two
frames, and so does a transform of that length, exactly. Any other is transformed with REACH samples around the frame;
what lies beyond is smooth light from afar, and comes from a coarse grid (`gpusim.planner.border`). A pupil with
straight blades throws it along their normals instead, too narrow for a coarse grid, which takes the mean over
directions: with BLADES_REACH samples around the frame. Beyond a scene's own margin its outermost samples go on.
"""

import dataclasses
from math import ceil

import numpy as np
import scipy

from gpusim.domain.content import Basis
from gpusim.domain.errors import OutOfRange
from gpusim.domain.scene import Scene
from gpusim.domain.view import View
from gpusim.optics.lens import spread_radius, tail_of
from gpusim.planner.border import at_samples, rule_of, unseen
from gpusim.report import Error
from gpusim.truth_field import blocks, varying_rates

REACH, BLADES_REACH = 256, 1024  # [sample] around the frame
RINGS, RADII = 64, 6  # as many rings of the diffraction, and radii of the spread, at least
MODES = {"zero": "grid-constant", "edge": "nearest", "reflect": "reflect"}  # of borders, as SciPy names them
CELLS = 32  # of the coarse grid along the reach


def require_truth(camera, scene):
    """Raise OutOfRange for a camera and a scene of which the truth is not known."""
    if camera.optics.varies and scene.samples_per_pixel != 1:
        raise OutOfRange("verify", f"{scene.samples_per_pixel:g} samples per pixel with a blur that varies over the "
                         "field", "1 sample per pixel")
    if camera.optics.varies and camera.sensor.stacked:
        raise OutOfRange("verify", "stacked pixels with a blur that varies over the field", "a mosaic")


def true_error(simulator, scene, exposure) -> Error:
    """Error of an exposure's mean electrons; simulator: by which it was made. Raises DoesNotFit."""
    return Error.between(*seen(simulator, scene, exposure), simulator.camera.sensor.read_sigma)


def seen(simulator, scene, exposure) -> tuple[np.ndarray, np.ndarray]:
    """Mean electrons of an exposure and their truth; of a large frame whose blur varies in parts of it, one row."""
    mean = np.array(simulator.device.numpy(exposure.mean), np.float32)
    of = type(simulator), simulator.camera, scene, exposure.plan, exposure.exposure_time
    if exposure.plan.varying is None:
        return mean, true_mean(*of)
    parts = blocks(scene.shape)
    found = varying_mean(*of, parts)
    if len(parts) == 1:
        return mean, found[0]
    return np.concatenate([mean[part].ravel() for part in parts]), np.concatenate([one.ravel() for one in found])


def true_mean(simulator, camera, scene, plan, exposure_time) -> np.ndarray:
    """Mean electrons of every pixel, float64, shape (rows, cols) or, of stacked pixels, (C, rows, cols).

    simulator: the class `Simulator`, which imports this module. plan: of the frame. Raises DoesNotFit, before
    anything is allocated.
    """
    scene = viewed(scene)
    reference = _reference(simulator, camera, scene, plan)
    own = reference.plan(scene)
    return reference.imaging.exposed(own, _rates(reference, camera, scene, own), exposure_time)


def varying_mean(simulator, camera, scene, plan, exposure_time, parts) -> list[np.ndarray]:
    """Mean electrons in parts of a frame whose blur varies over the field: see `true_mean` and `varying_rates`."""
    scene = viewed(scene)
    plain = dataclasses.replace(camera, optics=camera.optics.on_axis())
    reference = _reference(simulator, plain, scene, plan)
    own = reference.plan(scene)
    planes, cfa = _rates(reference, plain, scene, own)
    y, x = np.indices(scene.shape)
    base = np.take_along_axis(planes, cfa[y % cfa.shape[0], x % cfa.shape[1]][None], 0)[0]
    found = varying_rates(camera, scene, plan, reference.imaging.light(own), base, parts)
    y, x = (plan.slope * (np.arange(n) - (n - 1) / 2) for n in scene.shape)
    gain = (1 + y[:, None] ** 2 + x**2) ** -2 * (1.0 if plan.falloff is None else plan.falloff)
    return [exposure_time * gain[part] * one for part, one in zip(parts, found, strict=True)]


def viewed(scene) -> Scene:
    """The scene that a view shows, between its samples a spline of the fifth order; itself where it is plain.

    Source: Thevenaz, Blu and Unser, Interpolation revisited, IEEE Trans. Med. Imaging 19 (2000).
    """
    if scene.view.is_plain:
        return scene
    content = scene.content.on_host()
    if type(content) is not Basis:  # splines overshoot, which a basis may
        content = Basis(content.wavelengths, content.bands_at(slice(None)), np.eye(len(content.wavelengths)))
    middle = [(n - 1) / 2 for n in content.shape]
    y, x = np.indices(content.shape)
    y, x = scene.view.place(y - middle[0], x - middle[1], scene.samples_per_pixel)
    planes = np.stack([scipy.ndimage.map_coordinates(
        plane.astype(np.float64), [y + middle[0], x + middle[1]], order=5, mode=MODES[rule_of(scene.border)])
        for plane in content.planes])
    return dataclasses.replace(scene, content=content.with_planes(planes), view=View())


def _rates(reference, camera, scene, own):
    """Electrons per second in a world without end, as `Imaging.rates` gives them; own: the reference's plan."""
    rates, cfa = reference.imaging.rates(own)
    border, tail = rule_of(scene.border), tail_of(camera.optics)
    if own.mix is not None and border != "reflect" and tail:
        light = reference.imaging.light(own)
        light = np.tensordot(own.weights / own.flat * own.q, light, 1)  # of each channel, times q
        rows, cols = (np.arange(scene.margin - own.spare, n - scene.margin + own.spare) for n in light.shape[1:])
        around = min(length - n for length, n in zip(own.period, light.shape[1:], strict=True)) / 2
        cell = max(around / CELLS, 1)
        far = np.stack([at_samples(unseen(one, own.period, border, cell, tail, times=(3, 5, 7), soft=2), one.shape,
                                   own.period, rows, cols) for one in light])
        rates = rates + reference.imaging.pixels(own, far)
    return rates, cfa


def _reference(simulator, camera, scene, plan):
    """Simulator in float64 whose transforms are as long as this scene needs."""
    if camera.optics.model == "none":  # a plan may leave out a blur that there is
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

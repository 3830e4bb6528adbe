"""The float64 truth of a frame: mean electrons from the scene's samples and the camera's numbers.

Every wavelength is computed separately, without highlights or folding, in a world that continues to
infinity by the border rule. Fourier series move the light to its place behind the lens and the view
(`gpusim.judge.truth_light`). It is blurred and integrated over each pixel
(`gpusim.judge.truth_blur`). If the blur varies over the field, each sample is spread by its own
kernel, with respect to the optical axis (`gpusim.judge.truth_field`). `gpusim.judge.truth_lens` has
the kinds of lenses.

The frame and the truth share these parts. Each has an independent test (in tests/judges unless
stated):
- electrons per content, cubic in the wavelength between the scene's wavelengths (`data.weights`):
  tests/host/test_weights.py;
- transfer function of the pupil on the axis (`optics.tables.exact_otf`), and kernels of point spreads
  that are given (`optics.lens.MeasuredLens`): test_truth_stars.py, by Hankel and Fourier integrals of
  the pupil; kernels of a pupil over the field are own sums over chords (`gpusim.judge.truth_pupil`);
- displaced samples are points of light that keep their energy for any fill factor, and a uniform
  scene gives uniform pixels: test_truth_stars.py, test_truth_scenes.py;
- light from afar, on a coarse grid (`optics.outside.unseen_light`): test_border.py;
- formulas of distortion and relative illumination (`domain.distortion`, `domain.calibration`,
  `optics.geometry`): test_opencv.py, tests/frames/test_geometry.py;
- samples that fill their cells if there is no blur: tests/frames/test_sampling.py.

A scene with depth has own sheets, own distances and visibility by rays (`gpusim.judge.truth_depth`):
test_truth_depth.py.
"""

import dataclasses

import numpy as np

from gpusim.data.weights import electrons_per_content
from gpusim.domain.progress import announced
from gpusim.judge.truth_blur import blurred_rates
from gpusim.judge.truth_depth import depth_rates
from gpusim.judge.truth_field import BLOCKS, SIDE, blocks, flat_fields, varying_rates
from gpusim.judge.truth_lens import require_truth as require_truth
from gpusim.judge.truth_light import falloff_gain, placed_light, plain_rates, with_rim
from gpusim.optics.lenses import lens_of
from gpusim.pipeline.report import Error
from gpusim.pipeline.simulator import Simulator


def true_error(simulator: Simulator, scene, exposure) -> Error:
    """Return the error of the mean electrons of an exposure.

    Args:
        simulator: The simulator that made the exposure.
        scene: The scene.
        exposure: The exposure.

    Raises:
        DoesNotFit: The truth needs more memory than there is.
    """
    camera = simulator.camera
    error = Error.between(*mean_and_truth(simulator, scene, exposure), camera.sensor.read_sigma)
    if not lens_of(camera).is_uniform and len(blocks(scene.shape)) > 1:
        words = f"{BLOCKS} blocks of {SIDE} x {SIDE} pixels: the blur varies over the field"
        return dataclasses.replace(error, places=words)
    return error


def mean_and_truth(simulator: Simulator, scene, exposure) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean electrons of an exposure, and their truth.

    For a large frame with a blur that varies over the field, both are one row of samples from
    `blocks`.
    """
    mean, camera = np.array(simulator.device.numpy(exposure.mean), np.float32), simulator.camera
    parts = [(slice(None), slice(None))] if lens_of(camera).is_uniform else blocks(scene.shape)
    with announced("computing the float64 reference"):
        found = _electrons(camera, scene, exposure.exposure_time, parts)
    if len(parts) == 1:
        return mean, found[0]
    rows = [
        np.concatenate([one.ravel() for one in every])
        for every in ([mean[..., *part] for part in parts], found)
    ]
    return rows[0], rows[1]


def true_mean(simulator: type[Simulator], camera, scene, plan, exposure_time) -> np.ndarray:
    """Return the mean electrons of every pixel, float64.

    Light between points that are sampled too coarsely may be negative, and is not clipped.

    Args:
        simulator: The class `Simulator`; the truth does not use it.
        camera: The camera.
        scene: The scene.
        plan: Plan of the frame; the truth does not use it.
        exposure_time: [s].

    Returns:
        Shape (rows, cols), or (C, rows, cols) for stacked pixels.

    Raises:
        DoesNotFit: The truth needs more memory than there is.
    """
    del simulator, plan
    return _electrons(camera, scene, exposure_time, [tuple(slice(0, n) for n in scene.shape)])[0]


def _electrons(camera, scene, exposure_time, parts):
    """Return the mean electrons of parts of a frame: see `true_mean`."""
    cfa, lens = camera.sensor.cfa_indices, lens_of(camera)
    scene = with_rim(camera, scene)
    within = _within(parts, scene.shape)
    if lens.is_pointlike:
        light, weights = placed_light(camera, scene), electrons_per_content(scene, camera)
        rates = plain_rates(np.tensordot(weights, light, 1), camera, scene)
        wanted = [rates[:, *part] for part in within]
    elif scene.depth is not None:
        wanted = depth_rates(camera, scene, within, lens.is_uniform)
    else:
        light = placed_light(camera, scene)
        axis = dataclasses.replace(camera, optics=camera.optics.on_axis())
        rates = blurred_rates(light, axis, scene)
        wanted = [rates[:, *part] for part in within]
        if not lens.is_uniform:
            more = varying_rates(light, camera, scene, within)
            wanted = [own + one for own, one in zip(wanted, more, strict=True)]
    gain = exposure_time * falloff_gain(camera, scene)
    y, x = np.indices(scene.shape)
    channel = cfa[y % cfa.shape[0], x % cfa.shape[1]]
    flats = flat_fields(camera, scene, within)
    found = []
    for part, own, flat in zip(parts, wanted, flats, strict=True):
        electrons = gain[part] / flat * own
        if not camera.sensor.stacked:
            electrons = np.take_along_axis(electrons, channel[part][None], 0)[0]
        found.append(electrons)
    return found


def _within(parts, shape):
    return [
        tuple(slice(*at.indices(n)[:2]) for at, n in zip(part, shape, strict=True))
        for part in parts
    ]

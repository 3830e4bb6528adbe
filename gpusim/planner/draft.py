"""Drafts: while a slider moves, the last plan is reused with another lens, nearly right or as a sketch."""

from dataclasses import replace
from math import ceil, prod
from typing import Any

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.scene import Scene
from gpusim.optics.depth import DepthPlan
from gpusim.optics.field import FieldBlur
from gpusim.optics.fusion import Watch
from gpusim.optics.highlights import Highlights
from gpusim.optics.lengths import Tiling, fft_length
from gpusim.optics.lenses import open_lens
from gpusim.planner.choices import Blur, Falloff, Fusion, Planes, Sketch
from gpusim.planner.knobs.farfield import FarField
from gpusim.planner.plan import Plan

# largest ratio of blur widths, and an additional width [sample], at which tiles and planes still do
WIDER = 1.5
ROOM = 0.25

TURNED: dict[str, Any] = {  # settings of the lens that may differ
    "f_number": 8.0,
    "object_distance": np.inf,
    "defocus": 0.0,
    "pupil": Pupil(),
    "wavefront": Wavefront(),
}
RESIZED = ("pixel_pitch", "fill_factor")  # settings of the sensor that may differ in a sketch

CHANNELS = 8  # of a sketch at most: their spectra are kept
RADII = (4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)  # of its kernels [sample]
# diffraction beyond the rays that a kernel holds, over q, and at most [sample]: the rest is about 1 % of the light
RINGS, MOST_RINGS = 16.0, 16.0


def draft_plan(plan: Plan, camera: Camera) -> Plan | None:
    """Return the plan with the camera's lens in place of its own; None if that is not possible.

    Planes, tiles and all choices stay; the light and the tables of the lens are the camera's. The
    account is of the plan's own lens. There is no such draft for a blur that is not round, or of
    another size, or that depends on depth or field.

    camera: equals the plan's except for TURNED of its lens.
    """
    own, lens = (_lens_of(one, plan.scene) for one in (plan.camera, camera))
    blur = plan.find(Blur)
    if (
        blur is None
        or plan.find(DepthPlan) is not None
        or plan.find(FieldBlur) is not None
        or plan.find(Sketch) is not None
        or not lens.is_uniform
        or not (lens.symmetry.is_round and own.symmetry.is_round)
        or (plan.find(Highlights) is not None and not lens.is_airy)
        or not same_pixels(plan.camera, camera)
    ):
        return None
    wavelengths = plan.scene.wavelengths
    q = wavelengths * 1e-9 * camera.optics.working_f_number / lens.pitch
    before, now = (_width(one, plan, each) for one, each in ((own, plan.q), (lens, q)))
    if now > WIDER * before + ROOM or before > WIDER * now + ROOM:
        return None
    light = camera.optics.irradiance_factor / plan.camera.optics.irradiance_factor
    changed: list[Any] = [replace(blur, mix=light * blur.mix)]
    if far := plan.find(FarField):
        changed.append(replace(far, tails=lens.tails(wavelengths)))
    return plan.exchange(*changed, camera=camera, q=q, weights=light * plan.weights, is_draft=True)


def sketch_plan(plan: Plan, camera: Camera, scene: Scene | None = None) -> Plan | None:
    """Return a rough plan for another lens, or for fewer samples; None if that is not possible.

    Each channel is blurred as a whole by one kernel. Light far from a point, and the change of the
    spread with the wavelength within a channel, are left out. The planes do not depend on the lens.

    Args:
        plan: The plan of another lens. Its account stays.
        camera: Equals the plan's except for TURNED of its lens and RESIZED of its sensor.
        scene: The plan's scene with half as many rows and columns, for a camera whose pixels are
            twice as large; None: the plan's.
    """
    scene = plan.scene if scene is None else scene
    lens, channels, blur = _lens_of(camera, scene), len(plan.weights), plan.find(Blur)
    if (
        plan.find(DepthPlan) is not None
        or plan.find(FieldBlur) is not None
        or lens.is_pointlike
        or not lens.is_uniform
        or channels > CHANNELS
    ):
        return None
    q, content = lens.q(scene.wavelengths), scene.content
    needed = ceil(lens.spread(scene.wavelengths) + min(RINGS * q.max(), MOST_RINGS))
    radius = next((one for one in RADII if one >= needed), RADII[-1])
    rim, spare = (blur.rim, blur.spare) if blur is not None else (0, 0)
    rows, cols = (fft_length(n + 2 * (rim + radius)) for n in content.shape)
    light = _light_of(camera) / _light_of(plan.camera)
    part = plan.weights / np.maximum(plan.weights.sum(axis=1, keepdims=True), 1e-300)
    table = plan.weights if content.is_spectral else plan.weights @ content.entry_spectra.T
    falloff, times = plan.find(Falloff), round(plan.scene.shape[1] / scene.shape[1])
    if falloff is not None and times > 1:
        part_of = np.s_[::times, ::times]
        field = None if falloff.field is None else _crop(falloff.field[part_of], scene.shape)
        falloff = Falloff(_crop(falloff.gains[part_of], scene.shape), field)
    pitches = camera.sensor.pixel_pitch / plan.camera.sensor.pixel_pitch
    return plan.exchange(
        Planes(table),
        Blur(light * np.eye(channels), (rows, cols), False, spare, rim),
        Fusion(part[None]),
        Sketch(radius),
        *(() if falloff is None else (falloff,)),
        without=(Tiling, FarField, Highlights, Watch),
        scene=scene,
        camera=camera,
        content=content,
        q=q,
        slope=plan.slope * (times if scene.fov else pitches),
        weights=light * plan.weights,
        is_draft=True,
    )


def same_pixels(one: Camera, other: Camera) -> bool:
    """Return whether RESIZED are equal in two cameras."""
    return all(getattr(one.sensor, name) == getattr(other.sensor, name) for name in RESIZED)


def _crop(array, shape):
    rows, cols = shape
    return array[:rows, :cols]


def _light_of(camera):
    """Light that a pixel collects, up to what is the same for all of RESIZED and TURNED."""
    return camera.optics.irradiance_factor * prod(camera.sensor.aperture)


def _lens_of(camera, scene):
    """A camera's lens in front of the samples that are blurred."""
    sensor, ratio = camera.sensor, scene.samples_per_pixel
    cell = [1.0, 1.0] if ratio != 1 else [side / sensor.pixel_pitch for side in sensor.aperture]
    return open_lens(camera.optics, sensor.pixel_pitch / ratio, cell)


def _width(lens, plan, q):
    """Standard deviation of a Gaussian about as wide as the blur [sample]: see `Question.deviation`."""
    mean = np.average(q, weights=plan.weights.sum(axis=0))
    return float(np.hypot(0.42 * mean, lens.spread(plan.scene.wavelengths) / 2))

"""Drafts: while a lens slider moves, the last plan is reused with new transfer tables."""

from dataclasses import replace
from typing import Any

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.optics.depth import DepthPlan
from gpusim.optics.field import FieldBlur
from gpusim.optics.highlights import Highlights
from gpusim.optics.lens import open_lens
from gpusim.planner.choices import Blur
from gpusim.planner.knobs.farfield import FarField
from gpusim.planner.plan import Plan

# largest ratio of blur widths, and an additional width [sample], at which tiles and planes still do
WIDER = 1.5
ROOM = 0.25

TURNED: dict[str, Any] = {  # settings that may differ
    "f_number": 8.0,
    "object_distance": np.inf,
    "defocus": 0.0,
    "pupil": Pupil(),
    "wavefront": Wavefront(),
}


def draft_plan(plan: Plan, camera: Camera) -> Plan | None:
    """Return the plan with the camera's lens in place of its own; None if that is not possible.

    Planes, tiles and all choices stay; the light and the tables of the lens are the camera's. The
    account is of the plan's own lens. There is no draft for a blur of another symmetry or size, or
    for one that depends on depth or field.

    camera: equals the plan's except for TURNED of its lens.
    """
    own, lens = (_lens_of(one, plan) for one in (plan.camera, camera))
    blur = plan.find(Blur)
    if (
        blur is None
        or plan.find(DepthPlan) is not None
        or plan.find(FieldBlur) is not None
        or not lens.is_uniform
        or lens.symmetry.is_round != own.symmetry.is_round
        or (plan.find(Highlights) is not None and not lens.is_airy)
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


def _lens_of(camera, plan):
    """A camera's lens in front of the samples that are blurred."""
    sensor, ratio = camera.sensor, plan.scene.samples_per_pixel
    cell = [1.0, 1.0] if ratio != 1 else [side / sensor.pixel_pitch for side in sensor.aperture]
    return open_lens(camera.optics, sensor.pixel_pitch / ratio, cell)


def _width(lens, plan, q):
    """Standard deviation of a Gaussian about as wide as the blur [sample]: see `Question.deviation`."""
    mean = np.average(q, weights=plan.weights.sum(axis=0))
    return float(np.hypot(0.42 * mean, lens.spread(plan.scene.wavelengths) / 2))

"""Drafts: while a lens is turned, a plan for where it stood is used with where it stands now."""

from dataclasses import replace
from typing import Any

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.pupil import Wavefront
from gpusim.optics.ladder import tail, variance
from gpusim.optics.lens import spread_radius
from gpusim.planner.plan import Plan

WIDER, ROOM = (
    1.5,
    0.25,
)  # times as wide a blur or as narrow, and that much beside [sample]: tiles and planes still do

TURNED: dict[str, Any] = {  # what may be other
    "f_number": 8.0,
    "object_distance": np.inf,
    "defocus": 0.0,
    "wavefront": Wavefront(),
}


def drafted(plan: Plan, camera: Camera) -> Plan | None:
    """The plan with the camera's lens in place of its own; None where that will not do.

    camera: like the plan's but for TURNED of its lens. Planes, tiles and all that is chosen stay; the light and the
    tables of the lens are the camera's. The account is that of the plan's own lens. A blur of another symmetry or size
    has no draft, nor has one that goes by depth or by the place in the field.
    """
    own, optics = plan.camera.optics, camera.optics
    if plan.mix is None or plan.depth is not None or plan.varying is not None or optics.varies:
        return None
    if optics.is_symmetric != own.is_symmetric or (
        plan.highlights is not None and not optics.is_ideal
    ):
        return None
    pitch = camera.sensor.pixel_pitch / plan.scene.samples_per_pixel
    q = plan.scene.wavelengths * 1e-9 * optics.working_f_number / pitch
    before, now = (_width(one, plan, each, pitch) for one, each in ((own, plan.q), (optics, q)))
    if now > WIDER * before + ROOM or before > WIDER * now + ROOM:
        return None
    far = plan.far
    if far is not None:
        cell = _cell(camera, plan)
        far = replace(
            far,
            tails=tail(
                optics, q, optics.waves(plan.scene.wavelengths), variance(optics, pitch, cell)
            ),
        )
    light = optics.irradiance_factor / own.irradiance_factor
    white = None if plan.white_rate is None else light * plan.white_rate
    return replace(
        plan,
        camera=camera,
        q=q,
        far=far,
        weights=light * plan.weights,
        white_rate=white,
        mix=light * plan.mix,
        verdict=None,
        is_draft=True,
    )


def _cell(camera, plan):
    """Height and width over which blurred samples are integrated [sample]."""
    if plan.scene.samples_per_pixel != 1:
        return 1.0, 1.0
    return tuple(side / camera.sensor.pixel_pitch for side in camera.sensor.aperture)


def _width(optics, plan, q, pitch):
    """Standard deviation of a Gaussian about as wide as the blur [sample]: see `Question.deviation`."""
    mean = np.average(q, weights=plan.weights.sum(axis=0))
    return float(np.hypot(0.42 * mean, spread_radius(optics, plan.scene.wavelengths, pitch) / 2))

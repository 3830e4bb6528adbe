"""Fall-off: light that lens and pixels lose toward the corner."""

import numpy as np

from gpusim.domain.account import SAFETY, total
from gpusim.domain.calibration import Framed
from gpusim.domain.distortion import ideal
from gpusim.optics.geometry import microlens_gain, relative_illumination, vignetting_gain
from gpusim.planner.probes import Probes
from gpusim.planner.question import DECLARED, Notes, Question

NEGLIGIBLE = 1e-5  # a fall-off below it may be left out


def falloff_of(
    question: Question, probes: Probes | None, notes: Notes
) -> tuple[np.ndarray | None, float]:
    """Return the fall-off of every pixel, and the tangent of the field angle per pixel for the cos^4 law.

    The first is None if the law is enough, the second 0 if the law is not used. probes: of the
    scene, with a tolerance. Raises BadData, OutOfRange.
    """
    sensor, shape, displacement = (
        question.sensor,
        question.scene.shape,
        question.sensor.displacement,
    )
    parts, slope = _lens(question, notes)
    if sensor.microlens is not None:
        parts["microlenses"] = microlens_gain(
            sensor.microlens,
            shape,
            sensor.pixel_pitch,
            question.optics.image_distance,
            question.from_axis,
        )
    if sensor.vignetting is not None:
        parts["pixel vignetting"] = vignetting_gain(sensor.vignetting, shape, displacement)
    gains = np.prod(list(parts.values()), axis=0) if parts else None
    if (
        gains is not None
        and probes is not None
        and (most := float(np.abs(gains - 1).max())) < NEGLIGIBLE
    ):
        assert question.tolerance is not None
        bound = probes.even_error(most)
        if SAFETY * total([*notes.bounds.values(), bound]).ratio(question.tolerance) <= 1:
            notes.leave_out(
                f"{' and '.join(parts)} of up to {most:.2g}", bound, "fall-off left out"
            )
            gains = None
    if gains is not None:
        notes.models["optics.falloff"] = " and ".join(parts)
    layout = (
        f"stacked {', '.join(sensor.channels)}"
        if sensor.stacked
        else f"mosaic of {'/'.join(sensor.cfa)}"
    )
    notes.models["sensor.collect"] = f"{'cos^4, ' if slope else ''}{layout}"
    return gains, float(slope)


def _lens(question, notes):
    """The lens's fall-off by name, unless the exposure's cos^4 law is enough, and that law's slope."""
    optics, sensor, scene = question.optics, question.sensor, question.scene
    displacement = sensor.displacement
    if optics.relative_illumination == "cos4":
        slope = (
            2 * np.tan(scene.fov / 2) * question.ratio / scene.samples[1]
            if scene.fov
            else sensor.pixel_pitch / optics.image_distance
        )
        # the law is for the angle at which light comes, not for the place
        if optics.distortion is not None:
            return {
                "cos^4 of the undistorted field": (1 + _tangent(question, slope) ** 2) ** -2
            }, 0.0
        if not any(displacement):  # without distortion the axis is in the middle
            return {}, slope
        # the law in the exposure is for a grid in the middle
        return {
            "cos^4": relative_illumination(
                "cos4", scene.shape, slope, 1.0, displacement=displacement
            )
        }, 0.0
    if optics.relative_illumination == "none":
        notes.leave_out('relative illumination: set to "none"', DECLARED)
        return {}, 0.0
    return {
        "relative illumination as given": relative_illumination(
            optics.relative_illumination,
            scene.shape,
            sensor.pixel_pitch,
            optics.image_distance,
            displacement=question.from_axis,
        )
    }, 0.0


def _tangent(question, slope):
    """Tangent of the angle from the axis at which every pixel's light comes, (rows, cols).

    slope: of a pinhole per pixel; a calibration has its own.
    """
    distortion, pitch = question.distortion, question.sensor.pixel_pitch
    y, x = (
        (np.arange(n) - (n - 1) / 2 + move) * pitch / distortion.radius
        for n, move in zip(question.scene.shape, question.sensor.displacement, strict=True)
    )
    x, y = ideal(distortion, x, y[:, None])
    if isinstance(distortion, Framed):
        return np.hypot(*distortion.normalise(x, y))
    return np.hypot(x, y) * distortion.radius / pitch * slope

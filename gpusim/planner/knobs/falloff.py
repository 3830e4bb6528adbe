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
    optics, sensor, scene = question.optics, question.sensor, question.scene
    shape, displacement = scene.shape, sensor.displacement
    (down, across), (y, x) = displacement, question.axis
    from_axis = down - y, across - x  # of the grid of pixels
    parts, slope = {}, 0.0
    if optics.relative_illumination == "none":
        notes.leave_out('relative illumination: set to "none"', DECLARED)
    elif optics.relative_illumination != "cos4":
        parts["relative illumination as given"] = relative_illumination(
            optics.relative_illumination,
            shape,
            sensor.pixel_pitch,
            optics.image_distance,
            displacement=from_axis,
        )
    else:
        if scene.fov:
            slope = 2 * np.tan(scene.fov / 2) * question.ratio / scene.samples[1]
        else:
            slope = sensor.pixel_pitch / optics.image_distance
        # the exposure applies the law by the places of a grid in the middle
        if optics.distortion is not None:
            tangent = _tangent(question, slope)
            parts["cos^4 of the undistorted field"], slope = (1 + tangent**2) ** -2, 0.0
        elif any(displacement):
            law = relative_illumination("cos4", shape, slope, 1.0, displacement=displacement)
            parts["cos^4"], slope = law, 0.0
    if sensor.microlens is not None:
        parts["microlenses"] = microlens_gain(
            sensor.microlens, shape, sensor.pixel_pitch, optics.image_distance, from_axis
        )
    if sensor.vignetting is not None:
        parts["pixel vignetting"] = vignetting_gain(sensor.vignetting, shape, displacement)
    gains = np.prod(list(parts.values()), axis=0) if parts else None
    most = 0.0 if gains is None else float(np.abs(gains - 1).max())
    if gains is not None and probes is not None and most < NEGLIGIBLE:
        assert question.tolerance is not None
        bound = probes.even_error(most)
        if SAFETY * total([*notes.bounds.values(), bound]).ratio(question.tolerance) <= 1:
            words = f"{' and '.join(parts)} of up to {most:.2g}"
            notes.leave_out(words, bound, "fall-off left out")
            gains = None
    if gains is not None:
        notes.models["optics.falloff"] = " and ".join(parts)
    layout = f"mosaic of {'/'.join(sensor.cfa)}"
    if sensor.stacked:
        layout = f"stacked {', '.join(sensor.channels)}"
    notes.models["sensor.collect"] = f"{'cos^4, ' if slope else ''}{layout}"
    return gains, float(slope)


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

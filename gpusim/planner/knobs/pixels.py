"""Pixels: the samples that make them, their places in the lens's picture, the light that they lose, their patterns."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial, reduce
from math import ceil, hypot, inf, sqrt
from typing import Any

import numpy as np

from gpusim.domain.account import SAFETY, UNKNOWN, Bound, Tolerance, total
from gpusim.domain.calibration import Calibration, Framed
from gpusim.domain.distortion import Model, ideal
from gpusim.domain.errors import OutOfRange
from gpusim.domain.scene import IMAGE
from gpusim.domain.sensor import Sensor
from gpusim.optics.geometry import (
    FIELD_NODES,
    RIMS,
    DistortionGrid,
    distortion_grid,
    flat_of_lens,
    lagrange_weights,
    microlens_gain,
    pixel_ripple,
    place_phases,
    relative_illumination,
    vignetting_gain,
    widening,
)
from gpusim.optics.lens import wavelength_nodes
from gpusim.optics.sampling import (
    AREA,
    NODES,
    SPARE,
    Taps,
    apply_border,
    frame_start,
    pixel_taps,
    point_taps,
    sampling_error,
)
from gpusim.planner.choices import Falloff
from gpusim.planner.probes import Probes
from gpusim.planner.question import DECLARED, Notes, Question, displacement_suffix

NEGLIGIBLE = 0.01  # of a sample: a distortion below it may be left out
FIELD_WAVELENGTHS = 5  # that stand for all in the flat field of a blur that varies
LAW_CELLS = 256  # along the longer side, between which cos^4 is interpolated in large frames
LEAST_LOSS = 1e-5  # a fall-off below it may be left out
FAR = 10.0  # times below the tolerance: patterns that are left out
# of a normal distribution: 99.9 % of the pixels, all of some megapixels [sigma]
QUANTILE = 3.3
MAXIMUM = 5.0
RESPONSES = {"prnu": "PRNU", "row_prnu": "PRNU of rows", "column_prnu": "PRNU of columns"}
OFFSETS = {"dsnu": "DSNU", "row_dsnu": "DSNU of rows", "column_dsnu": "DSNU of columns"}


def taps_of(question: Question, most: float = inf) -> tuple[tuple[Taps, Taps] | None, int]:
    """Return taps of the rows and the columns of pixels, and the spare samples they use.

    Taps are None if each pixel is one sample. The blur extends beyond the scene's samples; a
    picture without blur is constant over each of them. Raises OutOfRange.

    most: spare samples on each side that the blur can give.
    """
    scene, ratio, is_blurred = question.scene, question.ratio, question.is_blurred
    if ratio == 1 and (is_blurred or not question.more):
        return None, 0
    spare = int(min(SPARE + question.more, most)) if is_blurred else 0
    axes: list[Taps] = []
    for n, pixels, width, move in zip(
        scene.samples, scene.shape, question.aperture, question.sensor.displacement, strict=True
    ):
        more = spare if is_blurred else ceil(ratio * abs(move))
        start = more + frame_start(n, pixels, ratio)
        if question.lens.has_pixel_windows:
            moved = question.lens.displacement[len(axes)]
            axes.append(point_taps(n + 2 * more, pixels, ratio, start, move, moved))
            continue
        nodes = NODES if is_blurred else AREA
        taps = pixel_taps(n + 2 * more, pixels, ratio, width, start, nodes, move)
        first, last = taps.centres[0] - ratio * width / 2, taps.centres[-1] + ratio * width / 2
        is_inside = more - 1e-6 <= first and last <= n + more + 1e-6
        if not is_blurred and scene.border == "scene" and not is_inside:
            raise OutOfRange(
                "sensor.offset + sensor.centre",
                f"{move:.6g} pixels, beyond the frame",
                'within it, as optics model "none" sees no surroundings; or border = "edge"',
            )
        axes.append(taps if is_blurred or not more else apply_border(taps, n, more, scene.border))
    return (axes[0], axes[1]), spare


def describe(question: Question, taps, notes: Notes):
    """Note how pixels are made, and the structure that the samples miss."""
    ratio, weights = question.ratio, question.weights
    if taps is not None:
        notes.models["optics.sample"] = (
            f"{ratio:.4g} sample{'' if ratio == 1 else 's'} per pixel, integrated over "
            f"its aperture{displacement_suffix(question.sensor.displacement)}"
        )
    if question.lens.has_pixel_windows:  # the frame that the diodes divide reports it
        return
    finer = question.facts.hold(
        "scene sampling",
        (
            *(question.optics, taps, ratio, question.aperture, question.moved),
            *(part.tobytes() for part in (weights, question.q, question.share)),
        ),
        lambda: sampling_error(
            question.facts.moments(weights),
            weights,
            question.q,
            question.share,
            ratio,
            question.aperture,
            taps,
            question.tables if question.is_blurred else None,
            question.moved,
        ),
    )
    notes.leave_out(
        f"scene structure finer than {'a' if ratio == 1 else f'{1 / ratio:.3g}'} pixel: {ratio:.4g} "
        f"scene sample{'' if ratio == 1 else 's'} per pixel",
        Bound(finer),
        "scene sampling",
        of_scene=True,
    )


def note_view(question: Question, probes: Probes, notes: Notes):
    """Note that the frame is a view of the scene, with the error of its interpolation."""
    notes.bounds["view"] = _with_rim(
        question, probes, lambda seen: seen.resampling_error(question.scene.view, question.ratio)
    )
    notes.models["optics.distort"] = (
        "a view of the scene, interpolated by cubics: displaced, turned or magnified as "
        "each frame says"
    )


def plan_distortion(
    question: Question, told: Callable[[], Probes], notes: Notes
) -> DistortionGrid | None:
    """Return the lens's distortion of the samples, and note the error of its interpolation; None without distortion.

    The margin's samples are included if there is blur. told: gives the scene's probes. Raises
    OutOfRange.
    """
    distortion = question.distortion
    if distortion is None:
        return None
    seen = question.size if question.is_blurred else question.scene.samples
    given = distortion, seen, question.pitch, question.scene.content.shape
    made = question.cache("distortion grid", distortion_grid, *given)
    if question.is_blurred:
        notes.bounds["distorted border"] = _border_bound(question, made, told())
    (move, flux), (most, largest) = made.typical, made.error
    usual, worst = told().shift_error(move), told().shift_error(most)
    bright, brightest = told().brightness_error(flux), told().brightness_error(largest)
    notes.bounds["distortion grid"] = Bound(
        hypot(usual.rms, bright.rms),
        hypot(worst.p999_sigma, brightest.p999_sigma),
        hypot(worst.max_sigma, brightest.max_sigma),
    )
    # else it is an error of the view, whose places are anywhere
    if question.scene.view.is_whole(question.ratio):
        width = sum(made.ratio) / 2 if made.method == "area" else None
        everywhere, worst = (
            _with_rim(
                question, told(), partial(Probes.interpolation_bound, phases=phases, width=width)
            )
            for phases in question.cache("place phases", place_phases, made, seen)
        )
        notes.bounds["distortion"] = replace(worst, rms=everywhere.rms)
    return made


def _border_bound(question, made, probes):
    """Error of light from beyond the rim, where the border's rule holds for the distorted picture.

    The flat field goes on changing there. Diffraction gives the share of the light that comes from beyond r,
    q / (pi^2 r); if the blur is wider than the rim, half of the light comes from within its width.
    """
    flux, (rows, cols) = made.nodes[..., 2], made.nodes.shape[:2]
    down, across = (n / (count - 1) for n, count in zip(question.size, (rows, cols), strict=True))
    sides = (flux[:2], down), (flux[-2:], down), (flux.T[:2], across), (flux.T[-2:], across)
    slope = max(np.abs(np.diff(pair, axis=0) / pair.max()).max() / step for pair, step in sides)
    width = max(question.spread, 2 * question.deviation, 1.0)
    around = question.rim + question.scene.margin
    far = max(around, width)
    share = min(0.5, question.mean_q / (np.pi**2 * far))
    error = share * min(1.0, float(slope) * RIMS[0])
    if width > around:
        error += 0.5 * min(1.0, float(slope) * width)
    bound = probes.brightness_error(error)
    strip = min(1.0, 2 * far * sum(1 / n for n in question.scene.samples))
    return replace(bound, rms=bound.rms * sqrt(strip))


def _with_rim(question: Question, probes: Probes, error: Callable[[Probes], Bound]) -> Bound:
    """The error of interpolated samples, and of the outermost ones that the border repeats: no blur evens that out."""
    bound = error(probes)
    if question.scene.border == "zero" or not question.deviation:
        return bound
    share = min(1.0, 2 * question.deviation / min(question.scene.samples))
    return total([bound, error(probes.sharp).times(share)])


def choose_distortion(
    question: Question, made: DistortionGrid | None, probes: Probes | None, notes: Notes
):
    """Return the distortion that the frame gets: `made`, or None if it may be left out.

    probes: of the scene, if there is a tolerance.
    """
    if made is None:
        return None
    move = float(np.hypot(made.nodes[..., 0], made.nodes[..., 1]).max())
    if probes is not None and move < NEGLIGIBLE:
        assert question.tolerance is not None
        bound = probes.shift_error(move)
        others = {**notes.bounds}
        others.pop("distortion", None)
        others.pop("distortion grid")
        others.pop("distorted border", None)
        if SAFETY * total([*others.values(), bound]).ratio(question.tolerance) <= 1:
            notes.bounds = others
            words = f"distortion by up to {move:.2g} of a sample"
            notes.leave_out(words, bound, "distortion left out")
            return None
    seen_by = notes.models.get("optics.distort")
    notes.models["optics.distort"] = f"{f'{seen_by}; ' if seen_by else ''}distortion: {made.report}"
    if isinstance(question.optics.relative_illumination, str):
        return made
    notes.models["optics.distort"] += "; flat fields as the relative illumination says"
    assert question.distortion is not None  # it made the grid
    return made.even(flat_on_axis(question.distortion))


def flat_on_axis(distortion: Model) -> float:
    """Return the light of a flat field at the place at which the optical axis meets the image."""
    at = distortion.middle if isinstance(distortion, Framed) else (0.0, 0.0)
    a, b, c, d = distortion.derivative(*map(np.float64, at))
    return float(1 / (a * d - b * c))


def describe_calibration(question: Question, notes: Notes):
    """Note the parts of a calibration that replace the scene's own field of view."""
    calibration = question.optics.distortion
    if question.scene.projection == IMAGE:
        notes.models["optics.distort"] = (
            "a panorama, seen through the lens: radiance of each chief ray's direction, area weighting"
        )
        return
    if not isinstance(calibration, Calibration):
        return
    if "optics.distort" in notes.models:
        notes.models["optics.distort"] += f"; {calibration}"
    across = calibration.width / calibration.fx  # of the pinhole's picture, in focal lengths
    fov = question.scene.fov
    if fov and abs(2 * np.tan(fov / 2) / across - 1) > NEGLIGIBLE:
        notes.leave_out(
            f"the scene's field of view, {np.degrees(fov):.4g} deg: the calibration's, "
            f"{np.degrees(2 * np.arctan(across / 2)):.4g} deg, is used",
            UNKNOWN,
            "field of view",
        )


def falloff_of(
    question: Question, probes: Probes | None, notes: Notes
) -> tuple[Falloff | None, float]:
    """Return the fall-off of every pixel, and the tangent of the field angle per pixel for the cos^4 law.

    The first is None if the law is enough, the second 0 if the law is not used. A relative
    illumination that is given is the flat field: a blur that crowds or thins out points is taken out
    of it. probes: of the scene, with a tolerance. Raises BadData, OutOfRange.
    """
    optics, sensor, scene = question.optics, question.sensor, question.scene
    shape, displacement = scene.shape, sensor.displacement
    (down, across), (y, x) = displacement, question.axis
    from_axis = down - y, across - x  # of the grid of pixels
    parts: dict[str, np.ndarray] = {}
    slope, field = 0.0, None
    if optics.relative_illumination == "none":
        notes.leave_out('relative illumination: set to "none"', DECLARED)
    elif optics.relative_illumination != "cos4":
        curve = relative_illumination(
            optics.relative_illumination,
            shape,
            sensor.pixel_pitch,
            optics.image_distance,
            displacement=from_axis,
        )
        if not question.lens.is_uniform:
            field = _flat_of_blur(question, from_axis, probes, notes)
            curve = curve / field
        parts["relative illumination as given"] = curve
    elif scene.projection != IMAGE:  # else its light has it
        if scene.fov:
            slope = 2 * np.tan(scene.fov / 2) * question.ratio / scene.samples[1]
        else:
            slope = sensor.pixel_pitch / optics.image_distance
        # the exposure applies the law by the places of a grid in the middle
        if optics.distortion is not None:
            given = question.distortion, shape, sensor.pixel_pitch, displacement, slope
            law = question.cache("undistorted field", _undistorted_law, *given)
            parts["cos^4 of the undistorted field"], slope = law, 0.0
        elif any(displacement):
            law = relative_illumination("cos4", shape, slope, 1.0, displacement=displacement)
            parts["cos^4"], slope = law, 0.0
    if sensor.microlens is not None:
        parts["microlenses"] = microlens_gain(
            sensor.microlens, shape, sensor.pixel_pitch, optics.image_distance, from_axis
        )
    if sensor.vignetting is not None:
        parts["pixel vignetting"] = vignetting_gain(sensor.vignetting, shape, displacement)
    gains = reduce(np.multiply, parts.values()) if parts else None
    most = 0.0 if gains is None else float(max(gains.max() - 1, 1 - gains.min()))
    if gains is not None and probes is not None and most < LEAST_LOSS:
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
    return None if gains is None else Falloff(gains, field), float(slope)


def _flat_of_blur(question, from_axis, probes, notes):
    """Flat field of a blur that varies, at every pixel, relative to the axis, (rows, cols)."""
    ratio, wavelengths = question.ratio, question.content.wavelengths
    rows, cols = (
        ratio * (np.arange(n) - (n - 1) / 2 + move)
        for n, move in zip(question.scene.shape, from_axis, strict=True)
    )
    nodes, between = wavelength_nodes(wavelengths, FIELD_WAVELENGTHS)
    weights = np.vstack([question.light, question.weights])
    shares = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300) @ between
    given = question.lens, nodes, shares, rows, cols, question.corner
    every, *each = question.cache("flat field of the blur", flat_of_lens, *given)
    # by splines through fewer places, which err more
    fewer = (FIELD_NODES[0] // 2 + 1, FIELD_NODES[1] // 2 + 1)
    coarse = question.cache("coarse flat field", flat_of_lens, *given, fewer)[0]
    rough = float(np.sqrt(np.mean((coarse / every - 1) ** 2))) / 2
    apart = max(float(np.sqrt(np.mean((one / every - 1) ** 2))) for one in each)
    wider = question.cache("widening", widening, question.lens, nodes, question.corner)
    error = float(np.hypot(apart, wider) + rough)
    bound = Bound(error) if probes is None else probes.brightness_error(error)
    notes.bounds["flat field of the blur"] = bound
    farthest = float(np.hypot(np.abs(rows).max(), np.abs(cols).max()))
    ripple = question.cache(
        "ripple of coarse pixels",
        pixel_ripple,
        question.lens,
        nodes,
        shares,
        question.corner,
        farthest,
    )
    if ripple:
        own = Bound(ripple) if probes is None else probes.brightness_error(ripple)
        words = "ripples of flat fields that the given relative illumination does not have: pixels are coarse"
        notes.leave_out(words, own if np.isfinite(ripple) else UNKNOWN, "ripples of flat fields")
    return every


def _undistorted_law(distortion, shape, pitch, displacement, slope):
    """Return cos^4 of the angle from the axis at which every pixel's light comes, (rows, cols).

    In large frames it is interpolated by cubics, to 1e-7 of the axis.

    pitch: of the pixels [m]. slope: of a pinhole per pixel; a calibration has its own.
    """
    rows, cols = (np.arange(n, dtype=float) for n in shape)
    cells = [ceil(n * LAW_CELLS / max(shape)) for n in shape]
    is_large = max(shape) > 2 * LAW_CELLS and min(cells) >= 3
    if is_large:
        rows, cols = (
            np.linspace(0, n, count + 1) - 0.5 for n, count in zip(shape, cells, strict=True)
        )
    y, x = (
        (at - (n - 1) / 2 + move) * pitch / distortion.radius
        for at, n, move in zip((rows, cols), shape, displacement, strict=True)
    )
    x, y = ideal(distortion, x, y[:, None])
    if isinstance(distortion, Framed):
        tangent = np.hypot(*distortion.normalise(x, y))
    else:
        tangent = np.hypot(x, y) * distortion.radius / pitch * slope
    law = (1 + tangent**2) ** -2
    if not is_large:
        return law
    down, across = (
        lagrange_weights(count + 1, (np.arange(n) + 0.5) / n)
        for n, count in zip(shape, cells, strict=True)
    )
    return np.maximum(down @ law @ across.T, 0)


def without_negligible(sensor: Sensor, tolerance: Tolerance | None) -> tuple[Sensor, list[str]]:
    """Return the sensor without fixed patterns that are FAR below a tolerance, and their names.

    Without a tolerance it is the same sensor. The result depends only on sensor and tolerance, so
    digital numbers are the same on every device. Each is judged at its largest effect: a response
    at saturation, an offset in the dark. An offset is no relative error of a frame whose light is
    not known, so a tolerance with only a relative error keeps all offsets.
    """
    if tolerance is None:
        return sensor, []
    none: dict[str, Any] = {}
    left = []
    for name, words in (RESPONSES | OFFSETS).items():
        value = getattr(sensor.noise, name)
        if not value or (name in OFFSETS and tolerance.rms is not None):
            continue
        if name in RESPONSES:
            rms, sigma = value, value * sqrt(sensor.saturation)
        else:
            rms, sigma = 0.0, value / max(sensor.read_sigma, 1.0)
        bound = Bound(rms, sigma * QUANTILE, sigma * MAXIMUM)
        if FAR * bound.ratio(tolerance) <= 1:
            none[name] = 0.0
            _, _, size, _, unit, *_ = bound.nearest(tolerance)
            left.append(f"{words}: at most {size:.2g}{unit}")
    if none:
        sensor = replace(sensor, noise=replace(sensor.noise, **none))
    return sensor, left

"""Field: a blur that varies over the frame."""

from dataclasses import replace

import numpy as np

from gpusim.domain.account import Bound
from gpusim.optics.depth import DepthPlan
from gpusim.optics.expansion import expansion_error
from gpusim.optics.field import (
    Differences,
    FieldBlur,
    FlatField,
    choose,
    farthest_corner,
    natural_difference,
    with_more_probes,
)
from gpusim.optics.fusion import Response, channel_operator, joint_operator
from gpusim.optics.kernel_space import KernelSpace, make_space
from gpusim.planner.choices import WorstKernels
from gpusim.planner.probes import Probes
from gpusim.planner.question import Question

FIELD_TOLERANCE = 5e-4  # relative RMS error of a field-varying blur without a tolerance
MOST_PLANES = 6  # a channel, of a field-varying blur
WIDEST_ROOM = 8  # times the limit: largest error of a natural scene by the end of kernels, if this scene is flatter
ROOM = 2.3  # true over predicted error of a channel's planes, by moments, stays below it in 95 % of natural scenes


def varying_planes(
    question: Question, response: Response, prior, flat, depth: DepthPlan | None = None
):
    """Return the planes of a blur that varies over the field.

    Each channel has own planes, so each plane has one kernel at a place. Their number and the
    field's kernels share the limit. Raises OutOfRange.

    Args:
        question: The question.
        response: Channels over wavelength and frequency.
        prior: E[x^T x] of likely spectra, shape (L, L).
        flat: Response to a flat field of each wavelength, see `Plan`.
        depth: Plan of the blur by distance. The difference from the axis then has, for each of its
            kernels, the planes and the coverage in each channel.

    Returns:
        Planes from spectra, transfers on the axis, mix, the difference from the axis, error (see
        `field_bound`), its worst kernels and description.
    """
    limit = question.limit or FIELD_TOLERANCE
    count, table, each, error = _planes(question, response, prior, limit)
    # each plane is seen by only one channel
    mix, transfers = (each.any(axis=2) * 1.0, each.sum(axis=0))
    # differences of neighbours in a plane over the channel's: planes of equal strength have equal weights
    spectra, (rows, cols) = question.facts.spectra, question.size
    differences = spectra.differences
    if question.scene.border == "zero":  # the frame's outline is an edge, too
        differences = differences + 2 * (rows + cols) / (rows * cols) * spectra.values
    whole = _sizes(response.flat, differences)
    strength = own = _sizes(table, differences) / np.maximum(mix.T @ whole, 1e-300)
    if depth is not None:  # of likely spectra: then all scenes of a camera have the same kernels
        likely = mix.T @ _sizes(response.flat, prior)
        strength = _sizes(table, prior) / np.maximum(likely, 1e-300)
    strength = _round_down(np.maximum(strength, 1e-12))
    uneven = 1.0 if depth is None else max(float(np.sqrt(np.mean((own / strength) ** 2))), 0.5)
    table, transfers = table / strength[:, None], transfers * strength[:, None]
    power = np.einsum("cl,lm,cm->c", response.flat, spectra.values, response.flat).sum()
    contrast = max(np.sqrt((whole**2).sum() / power) if power > 0 else 0.0, 1e-9)
    contrast /= natural_difference()
    # of planes in a flat field of the frame's power
    levels = _sizes(table, spectra.values, max(power, 1e-300))
    kernels = transfers * flat
    if depth is not None:
        white = question.weights / np.maximum(question.weights.sum(axis=1, keepdims=True), 1e-300)
        kernels = np.concatenate([kernels, white])
        # frames divide by what a flat field's coverage becomes
        levels = _round_down(
            _sizes(table, prior, np.einsum("cl,lm,cm->", response.flat, prior, response.flat))
        )
        levels = np.append(levels, np.zeros(len(white)))
    made_of = (
        question.lens,
        question.content.wavelengths,
        kernels,
        question.size,
        question.corner,
    )
    varying: FieldBlur | KernelSpace
    if depth is None:
        varying = by_field = question.cache(
            "field plan",
            _rest,
            *made_of,
            _round_down(limit / contrast),
            count,
            _round_down(np.maximum(levels, 1e-12)),
            _round_down(limit),
        )
        wrong, shaded = by_field.error, by_field.flat
        worst_kernels = WorstKernels(table, by_field.wrong, mix, by_field.worst_ratio)
    else:
        wanted = limit / (contrast * uneven)
        varying = space = question.cache(
            "depth plan",
            _by_depth,
            *made_of,
            _round(wanted),
            count,
            levels,
            _round(limit),
            depth.distances,
            depth.kernels,
            len(question.weights),
        )
        own_error, bends = expansion_error(space, depth)
        usual, largest = (
            max(float(np.hypot(*both)), 1e-300) for both in zip(space.error, own_error, strict=True)
        )
        own = largest / max(space.error[1], 1e-300) * space.wrong[: len(table)]
        worst_kernels = WorstKernels(table, own, mix, max(largest / usual, 1.0))
        wrong = uneven * usual, uneven * largest
        bent, most = (float(np.linalg.norm(levels)) * one for one in bends)
        shaded = float(np.hypot(space.flat[0], bent)), space.flat[1] + most
    error = float(np.hypot(error, wrong[0] * np.sqrt(count) * contrast))
    error = float(np.hypot(error, shaded[0]))
    if not question.lens.is_uniform:
        error = float(np.hypot(error, _border_error(question, varying)))
    words = (
        f"the blur on the axis, {count} plane{'s' if count > 1 else ''} a channel in place of "
        f"{len(question.content.wavelengths)} wavelengths"
    )
    worst = max(wrong[1] / max(wrong[0], 1e-300), 1.0), shaded[1]
    return table, transfers[None], mix, varying, (error, *worst), worst_kernels, words


def field_bound(
    probes: Probes | None,
    rms: float,
    worst: float,
    shaded: float,
    kernels: WorstKernels | None = None,
) -> Bound:
    """Return the bound of planes whose kernels differ over the field.

    The 99.9 % and the largest are those of the worst places, at edges; and at least as large as if the kernels of the
    worst place were everywhere. The RMS is at least the RMS of these kernels, as they are over the field.

    Args:
        probes: Of the scene, if there is a tolerance.
        rms: Relative RMS error.
        worst: Error of a natural scene at the worst place, over its RMS.
        shaded: Largest relative error of flat fields.
        kernels: Error of the kernels of the worst place.
    """
    if probes is None:
        return Bound(rms)
    found, even = probes.local(rms).times(worst), probes.brightness_error(shaded)
    own = Bound()
    if kernels is not None:
        own = probes.kernel_error(kernels.table, kernels.kernels, kernels.mix)
        rms = max(rms, own.rms / kernels.ratio)
    return Bound(
        rms,
        max(found.p999_sigma, own.p999_sigma) + even.p999_sigma,
        max(found.max_sigma, own.max_sigma) + even.max_sigma,
    )


def _sizes(table, moments, power=1.0):
    """Root mean squares of planes (planes, L) of spectra of these second moments, over the root of a power."""
    squares = np.einsum("kl,lm,km->k", table, moments, table)
    return np.sqrt(np.maximum(squares, 0) / power)


def _planes(question, response, prior, limit):
    """Number of planes a channel, planes from spectra, transfers (C, planes, L) and error."""
    own, channels = question.facts.spectra, np.arange(len(response.weights))
    operators = []
    if not question.guaranteed:
        operators = [joint_operator(response.channel(c), prior) for c in channels]
    for count in range(1, MOST_PLANES + 1):
        if question.guaranteed:
            operator = channel_operator(response, count)
            table, each, error, room = operator.table, operator.transfers, operator.bound, 1.0
        else:
            parts = [one.transfers(count)[0] for one in operators]
            table = np.vstack([one.w_in[:, :count].T for one in operators])
            owner = np.repeat(channels, [len(part) for part in parts])
            each = np.zeros((len(parts), *table.shape))
            for c, part in enumerate(parts):
                each[c, owner == c] = part
            error, room = response.error(table, each, own), ROOM
        if room * error < limit / 2:
            break
    return count, table, each, error


def _rest(
    lens, wavelengths, transfers, shape, corner, limit, count, levels, flat_limit
) -> FieldBlur:
    """Difference of the blur from the blur on the axis, the cheapest one.

    transfers: of the planes, (planes, L), for lights of 1. limit: of the error of natural scenes.
    levels: strength of the planes in flat fields. flat_limit: limit of the error of flat fields.
    """
    room = min(limit, WIDEST_ROOM * flat_limit)
    differences = Differences(lens, wavelengths, transfers, shape, corner, room / 8)
    flat = FlatField(differences, shape, levels, flat_limit / 2)
    found = choose(differences, shape, limit / 2 / np.sqrt(count), flat)
    if found.error[0] <= limit:  # else the plan does not meet the tolerance
        found = with_more_probes(found, differences, shape)
    rms, worst = np.hypot(found.error, differences.end_error()).tolist()
    shaded, most = np.hypot(found.flat, flat.unseen(differences)).tolist()
    return replace(found, error=(rms, worst), flat=(shaded, most))


def _by_depth(
    lens,
    wavelengths,
    transfers,
    shape,
    corner,
    limit,
    count,
    levels,
    flat_limit,
    distances,
    nodes,
    covers,
) -> KernelSpace:
    """Return the kernels at all distances and places, see `_rest`. covers: number of planes of coverage."""
    room = min(limit, WIDEST_ROOM * flat_limit) / 4
    own = min(limit, WIDEST_ROOM * flat_limit) / 2 / np.sqrt(count)
    flat = levels, flat_limit / 2
    return make_space(
        lens, wavelengths, transfers, shape, corner, room, own, distances, nodes, covers, *flat
    )


def _round_down(values):
    """Values rounded down to a power of 2^(1/2): similar scenes then take the same plan of the field."""
    return np.exp2(np.floor(2 * np.log2(values)) / 2)


def _round(value):
    """A value rounded to a power of 2: nearly all scenes of a camera then have the same kernels."""
    return float(np.exp2(np.rint(np.log2(value))))


def _border_error(question, varying):
    """Relative RMS error of light from outside the frame, and of light that is lost in a dark world.

    Light from outside is spread as at the frame's border, although a lens would continue to vary.
    The corner's spread moves light by d pixels at R pixels from the axis: if light moves inward, a
    strip d wide, minus the margin, is too bright, or too dark, by d / R. In a dark world nothing
    comes from outside; the kernels' deficit against the kernels on the axis, which the differences
    share out evenly, is lost there. It grows with the square of the height h, whose root mean
    square over a frame, 1 at the corner, is 0.42 .. 0.45.
    """
    wavelengths, size = question.content.wavelengths, varying.kernels.shape[-1]
    lens, (rows, cols) = question.lens, question.size
    corner = farthest_corner(question.size, (np.array(question.size) - 1) / 2 + lens.axis)
    height = max(float(np.hypot(*corner)), 1.0)
    middle = [float(np.median(wavelengths))]
    outer = lens.kernels(middle, tuple(corner / question.corner), size)[0]
    axis = lens.kernels(middle, (0.0, 0.0), size)[0]
    if question.scene.border == "zero":
        return float(0.43 * abs(axis.sum() - outer.sum()))
    at = np.arange(size) - size // 2
    moved = outer.sum(axis=1) @ at * corner[0] + outer.sum(axis=0) @ at * corner[1]
    inward = float(-moved / height / outer.sum())
    lateral = question.optics.lateral_color_at(wavelengths).min() * height
    inward = max(inward, float(-lateral), 0.0)
    strip = max(inward - question.scene.margin, 0.0)
    return inward / height * float(np.sqrt(min(2 * strip * (rows + cols) / (rows * cols), 1.0)))

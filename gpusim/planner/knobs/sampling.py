"""Sampling: the scene's samples that make a pixel, and the structure that they miss."""

from math import ceil, inf

from gpusim.domain.account import Bound
from gpusim.domain.errors import OutOfRange
from gpusim.optics.sampling import (
    AREA,
    NODES,
    SPARE,
    Taps,
    apply_border,
    frame_start,
    pixel_taps,
    sampling_error,
)
from gpusim.planner.question import Notes, Question, displacement_suffix


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
    axes = []
    for n, pixels, width, move in zip(
        scene.samples, scene.shape, question.aperture, question.sensor.displacement, strict=True
    ):
        more = spare if is_blurred else ceil(ratio * abs(move))
        start, nodes = more + frame_start(n, pixels, ratio), NODES if is_blurred else AREA
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
    finer = sampling_error(
        question.facts.moments(weights),
        weights,
        question.q,
        question.share,
        ratio,
        question.aperture,
        taps,
        question.tables if question.is_blurred else None,
        question.moved,
    )
    notes.leave_out(
        f"scene structure finer than {'a' if ratio == 1 else f'{1 / ratio:.3g}'} pixel: {ratio:.4g} "
        f"scene sample{'' if ratio == 1 else 's'} per pixel",
        Bound(finer),
        "scene sampling",
        of_scene=True,
    )

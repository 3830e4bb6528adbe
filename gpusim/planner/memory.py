"""Device memory of a frame."""

from math import prod

from gpusim.planner.depth import DepthPlan
from gpusim.planner.models.spectral import Planes
from gpusim.planner.question import Question


def bytes_needed(rows, cols, period, stored, table, mix, transfers, bands, channels, parts):
    """Device memory of a frame [byte], the arrays that live at the same time added up.

    stored: of the scene's samples. parts: size of a transfer table over that of a real quarter.
    """
    frame, padded = rows * cols, prod(period)
    quarter = (period[0] // 2 + 1) * (period[1] // 2 + 1)
    total = stored + frame * (4 * channels + 4 + 2 + 12 + 3)
    if mix is not None:
        planes = mix.shape[1]
        total += 4 * frame * (planes if table is not None else 0)
        total += 4 * parts * quarter * (bands + (channels * planes if transfers is not None else 0))
        total += 8 * padded * (2 * min(planes, 8) + 2 * channels)  # spectra and scratch, sums and their inverse
    return total


def bytes_of(question: Question, period: tuple[int, int], planes: Planes, depth: DepthPlan | None) -> int:
    """The same of a plan's parts: a blur that goes by depth or varies over the field takes more.

    period: of the transforms [sample].
    """
    (rows, cols), (channels, bands) = question.size, question.weights.shape
    stored = max(question.content.nbytes, question.scene.content.nbytes)  # of a picture the codes, too
    total = bytes_needed(rows, cols, period, stored, planes.table, planes.mix, planes.transfers, bands, channels,
                         1 if question.optics.is_symmetric and not any(question.moved) else 4)
    if depth is not None:  # every kernel's and layer's light and coverage, and the copies that are laid together
        total += 16 * channels * rows * cols * len(depth.kernels) * depth.layers
    if planes.varying is not None:  # maps in float64 and float32, planes times maps, spectra
        total += 20 * rows * cols * planes.varying.convolutions + planes.varying.bytes_of_tiles(channels)
    return total

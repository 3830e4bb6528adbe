"""Displacements of several frames to hundredths of a pixel: one movement of the camera, and what departs from it."""

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.processor.align import TILE
from gpusim.kernels.processor.refine import refine

STEPS = 3  # of the movement; each step's error is about the square of the one before
TILE_STEPS = 2  # of a tile's own displacement
FIRST_STEPS = 10  # of the fit to the searched displacements
CLOSE = 1.0  # [pixel] deviation at which a searched displacement counts half
SURE = 25.0  # gain of a displacement in chi squared: 5 standard deviations
SURER = 100.0  # the same over the misfit that is left, which aliasing and not noise may have made
APART = 0.15  # [pixel] least deviation of a tile's own displacement from the movement
STIFF = 1.0  # [pixel] standard deviation of a turn or zoom at the edge of the frame, before it is measured


def align_frames(
    device: Device,
    raw,
    searched: np.ndarray,
    *,
    reference: int,
    period: tuple[int, int],
    table: np.ndarray,
    lines: float = 0.0,
) -> np.ndarray:
    """Return the displacement of every tile of every frame.

    A shaken camera moves, turns and zooms the whole picture: its movement is an affine map, six
    numbers per frame, fitted to all tiles at once (`processor.refine`). That is why noise hardly
    moves it: on 400 x 300 pixels at 250 e- by 0.01 to 0.02 pixel. Tiles of moving objects
    count little, because they fit badly. A tile whose content tells that it is more than APART from
    the movement takes its own displacement: objects and, in a scene with depth, parallax.

    Args:
        device: The device.
        raw: Digital numbers, an array of the device, uint16 (frames, rows, cols).
        searched: First displacements [period], (frames, tiles_y, tiles_x, 2), see `processor.align`.
        reference: Number of the frame with which the others are compared.
        period: Rows and columns of the mosaic's period.
        table: Numbers of each frame, see `processor.refine`.
        lines: Share of the variance in the dark that whole rows or columns have in common.

    Returns:
        Displacements [period], float32 (frames, tiles_y, tiles_x, 2).

    Source:
        Odobez and Bouthemy 1995, "Robust multiresolution estimation of parametric motion models",
        for weights that fall with the misfit.
    """
    searched = np.asarray(searched, np.float64) * period  # [pixel]
    basis = _affine_basis(searched.shape[1:3])

    def sums(displacement):
        moved = np.ascontiguousarray(displacement / period, np.float32)
        found = refine(raw, moved, reference=reference, period=period, table=table, device=device)
        return np.array(device.numpy(found), np.float64)

    first = sums(searched)
    model = _fit_search(searched, first[..., 0] + first[..., 2], basis)
    # a displacement in whole periods, as of a camera at rest, is kept if noise explains the step away from it
    whole = np.zeros_like(model)
    whole[:, 0] = np.rint(model[:, 0] / period) * period
    movement = _evaluate(basis, whole)
    _, gain = _model_step(sums(movement), basis)
    is_sure = gain > SURE * (1 + lines * max(raw.shape[1:]))
    for _ in range(STEPS if is_sure.any() else 0):
        step, _ = _model_step(sums(_evaluate(basis, model)), basis)
        model = model + step
    movement[is_sure] = _evaluate(basis, model)[is_sure]
    taken, least = movement.copy(), sums(movement)[..., 5:]
    sure = SURE * (1 + lines * TILE * max(period))
    starts = [movement]
    if np.abs(searched - movement).max() > APART:
        starts.append(searched)
    for own in starts:
        for _ in range(TILE_STEPS):
            own = own + _tile_steps(sums(own))
        trial = sums(own)[..., 5:]
        gain = _gain(least, trial)
        better = (gain > sure) & (gain * trial[..., 1] > SURER * trial[..., 0])
        better &= trial[..., 1] >= TILE * TILE / 4
        better &= np.abs(own - movement).max(axis=-1) > APART
        taken[better], least[better] = own[better], trial[better]
    taken[reference] = 0
    return np.ascontiguousarray(taken / period, np.float32)


def _gain(before, after):
    """Return by how much the misfit falls, in squares of the noise. before, after: misfit and number of pixels.

    Means are compared, because places outside the frame and full pixels count in none.
    """
    means = [sums[..., 0] / np.maximum(sums[..., 1], 1) for sums in (before, after)]
    return (means[0] - means[1]) * np.minimum(before[..., 1], after[..., 1])


def _affine_basis(tiles):
    """Return 1, down and right of the middles of tiles, -1 .. 1 from edge to edge, (tiles_y, tiles_x, 3)."""
    places = [(np.arange(n) + 0.5) / n * 2 - 1 for n in tiles]
    down, right = np.meshgrid(*places, indexing="ij")
    return np.stack([np.ones_like(down), down, right], axis=-1)


def _evaluate(basis, model):
    """Return displacements (frames, tiles_y, tiles_x, 2) of models (frames, 3, 2)."""
    return np.einsum("yxk,fkd->fyxd", basis, model)


def _fit_search(searched, weight, basis):
    """Return models (frames, 3, 2) [pixel] that most of the searched displacements fit.

    weight: (frames, tiles_y, tiles_x), large where the content tells a displacement.
    """
    flat = basis.reshape(-1, 3)
    models = np.zeros((len(searched), 3, 2))
    for model, moves, own in zip(models, searched, weight, strict=True):
        moves, own = moves.reshape(-1, 2), own.ravel()
        if not own.any():
            continue
        order = np.argsort(moves, axis=0)
        for k in (0, 1):  # the weighted median
            heap = np.cumsum(own[order[:, k]])
            model[0, k] = moves[order[np.searchsorted(heap, heap[-1] / 2), k], k]
        for _ in range(FIRST_STEPS):
            off = moves - flat @ model
            share = own / (1 + (off**2).sum(axis=1) / CLOSE**2) ** 2
            normal = flat.T @ (share[:, None] * flat) + 1e-3 * own.mean() * np.eye(3)
            model += np.linalg.solve(normal, flat.T @ (share[:, None] * off))
    return models


def _model_step(sums, basis):
    """Return the changes (frames, 3, 2) of models that the tiles' sums ask for, and what they gain (frames,).

    The gain is the fall of the misfit in squares of the noise: of noise alone, chi squared of six
    degrees of freedom, or less.
    """
    yy, yx, xx, right_y, right_x, misfit, pixels = np.moveaxis(sums, -1, 0)
    mean = misfit / np.maximum(pixels, 1)
    steps, gains = np.zeros((len(sums), 3, 2)), np.zeros(len(sums))
    for i, step in enumerate(steps):
        used = pixels[i] > 0
        if not used.any():
            continue
        usual = np.median(mean[i][used]) + 1e-9
        share = np.where(used, 1 / (1 + (mean[i] / usual) ** 2), 0)
        blocks = [
            np.einsum("yx,yxk,yxl->kl", share * term[i], basis, basis) for term in (yy, yx, xx)
        ]
        normal = np.block([[blocks[0], blocks[1]], [blocks[1], blocks[2]]])
        right = np.concatenate(
            [np.einsum("yx,yxk->k", share * term[i], basis) for term in (right_y, right_x)]
        )
        loose = 1e-6 * np.trace(normal) / 6 + 1e-12
        normal += np.diag(np.tile([0, STIFF**-2, STIFF**-2], 2)) + loose * np.eye(6)
        solved = np.linalg.solve(normal, right)
        gains[i] = right @ solved
        step[:] = np.clip(solved.reshape(2, 3).T, -1, 1)
    return steps, gains


def _tile_steps(sums):
    """Return the steps [pixel], at most 1, that the sums of each tile ask for, (..., 2)."""
    yy, yx, xx, right_y, right_x, *_ = np.moveaxis(sums, -1, 0)
    loose = 1e-3 * (yy + xx) + 1e-12
    determinant = (yy + loose) * (xx + loose) - yx**2
    step_y = ((xx + loose) * right_y - yx * right_x) / determinant
    step_x = ((yy + loose) * right_x - yx * right_y) / determinant
    return np.clip(np.stack([step_y, step_x], axis=-1), -1, 1)

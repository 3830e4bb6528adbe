"""A-posteriori error of a fused frame: what a frame of higher rank changes, as a map."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData

TILE = 8  # [pixel] of the map


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimated error of mean electrons.

    rms: root mean square over that of the frame [1]. p999_sigma, max_sigma: 99.9 % quantile and maximum of the error
    over the pixel's own noise sigma [1]. place: row and column of the largest error in electrons. tiles: largest
    error in each tile of TILE x TILE pixels [e-], shape (ceil(rows / TILE), ceil(cols / TILE)).
    """

    rms: float
    p999_sigma: float
    max_sigma: float
    place: tuple[int, int]
    tiles: np.ndarray


def check_rank(rank: int, channels: int) -> int:
    """Rank whose frame tells the error of one of `rank`.

    Two planes for each channel are nearly all there is to a spectrum's blur (the tail drops 30-fold there), so that
    the frame of that rank stands for the truth; the next rank alone sees down to 1 / 8 of an error outside the prior.
    Beyond it, two more.
    """
    return 2 * channels if rank < 2 * channels else rank + 2


def estimate(frame, finer, read_noise: float) -> Estimate:
    """Error of `frame` as `finer` sees it, both mean electrons (rows, cols) [e-] of one scene.

    Every pixel is compared, so that an error in one tile cannot hide from it, as it does from probes at a few places.
    Raises BadData when the frames differ in shape or are not finite.
    """
    frame, finer = np.asarray(frame, np.float64), np.asarray(finer, np.float64)
    if frame.shape != finer.shape or frame.ndim != 2 or not frame.size:
        raise BadData(f"error estimate: wanted two frames (rows, cols) of one shape, got {frame.shape}, {finer.shape}")
    if not (np.isfinite(frame).all() and np.isfinite(finer).all()):
        raise BadData("error estimate: the frames must be finite; they hold NaN or infinity")
    difference = np.abs(finer - frame)
    sigmas = difference / np.sqrt(np.maximum(finer + read_noise**2, 1.0))
    size = np.sqrt(np.mean(finer**2))
    rows, cols = frame.shape
    padded = np.pad(difference, ((0, -rows % TILE), (0, -cols % TILE)))
    tiles = padded.reshape(padded.shape[0] // TILE, TILE, -1, TILE).max(axis=(1, 3))
    row, col = np.unravel_index(np.argmax(difference), difference.shape)
    return Estimate(float(np.sqrt(np.mean(difference**2)) / size) if size else float(difference.max() > 0),
                    float(np.quantile(sigmas, 0.999)), float(sigmas.max()), (int(row), int(col)), tiles)

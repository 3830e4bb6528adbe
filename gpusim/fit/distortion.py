"""Distortion and lateral colour of a lens from views of a checkerboard."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.calibration import Calibration
from gpusim.domain.errors import BadData
from gpusim.fit.board import Board, find_board
from gpusim.fit.bundle import (
    COEFFICIENTS,
    ENOUGH_VIEWS,
    Geometry,
    calibrate,
    choose_views,
    displacement_error,
    drop_strays,
)
from gpusim.fit.estimate import Estimate, Part, Plot
from gpusim.fit.lateral_color import (
    describe_varying,
    lateral_estimates,
    measure_lateral_color,
)
from gpusim.fit.planes import WAVELENGTHS, checked_frames, main_channel
from gpusim.io.raw.raw_frame import RawFrame

ASSUMED_FOCAL = 1.2  # times the longer side, if neither views nor files tell it
COVERED = 0.85  # of the way to the corner that the board should reach
WORST = 1.0  # [pixel] RMS residual of a board that is no plane, or a lens beyond the model
SYSTEMATIC = 4.0  # standard errors of the mean residual of a cell that are no chance
PRECISE = 0.2  # [pixel] error of the model that is not worth a line
ERROR = "largest error of the distortion in the frame"
CELLS = 6  # along a side of the frame


def fit_distortion(
    frames: RawFrame | Sequence[RawFrame],
    *,
    black: ArrayLike | None = None,
    pitch: float | None = None,
    focal_length: float | None = None,
) -> Part:
    """Fit camera matrix, distortion and lateral colour to views of a checkerboard.

    The model is OpenCV's, k1, k2, p1, p2, k3, see `gpusim.fit.bundle.calibrate`.

    Args:
        frames: Views of one board.
        black: Black level [DN], see `gpusim.fit.planes.light_values`.
        pitch: Pixel pitch [m].
        focal_length: Focal length [m], used with fewer than three views; None: the frames'.

    Returns:
        Estimates and the settings optics.calibration and optics.lateral_color.

    Raises:
        BadData: No board is found in any view, or the model does not fit.
        Missing: OpenCV is not installed.

    Source:
        Zhang, "A flexible new technique for camera calibration", PAMI 22 (2000) 1330; Brown 1966.
    """
    every = checked_frames(frames, "grid")
    boards, faults = [], []
    for frame in every:
        try:
            boards.append(find_board(frame, black))
        except BadData as error:
            faults.append(str(error))
    if not boards:
        raise BadData(faults[0])
    rows, cols = every[0].values.shape
    focal_length = focal_length or every[0].focal_length
    nominal = focal_length / pitch if focal_length and pitch else ASSUMED_FOCAL * max(rows, cols)
    kept = choose_views(boards, (cols, rows), nominal)
    faults += [
        f"{one.name}: corners do not fit the other views, not used"
        for one in boards
        if one not in kept
    ]
    boards = kept
    found = calibrate(boards, (cols, rows), nominal)
    boards = drop_strays(kept, found)
    every_corner, used = (sum(len(one.places) for one in views) for views in (kept, boards))
    if used < every_corner:
        faults.append(
            f"grid: {every_corner - used} of {every_corner} corners are far from the model, not used"
        )
        found = calibrate(boards, (cols, rows), nominal)
    spread = float(np.sqrt(np.mean(np.concatenate(found.residuals) ** 2) * 2))
    if spread > WORST:
        raise BadData(
            f"grid: corners miss the model by {spread:.2g} pixels RMS, wanted {WORST:g} or less; use a flat "
            "board, hold "
            "it still, and for a fisheye calibrate with cv2.fisheye and give optics.calibration"
        )
    sources = tuple(one.name for one in boards)
    lateral = measure_lateral_color(boards, found.matrix[:2, 2], (cols, rows))
    largest = Estimate(
        *displacement_error(found, (cols, rows)),
        "pixel",
        sources,
        "beyond the boards the model is continued",
    )
    return Part(
        "distortion",
        _estimates(found, sources)
        | {ERROR: largest}
        | lateral_estimates(lateral, (cols, rows), main_channel(every[0].channels), sources),
        _settings(found, (cols, rows), lateral, main_channel(every[0].channels)),
        _plots(boards, found, (cols, rows)),
        _describe_misfit(boards, found, (rows, cols), spread),
        tuple(faults)
        + _unknown(boards, found, (rows, cols), focal_length, largest.high)
        + describe_varying(lateral, (cols, rows)),
    )


def _estimates(found: Geometry, sources):
    values = [found.matrix[0, 0], found.matrix[1, 1], found.matrix[0, 2], found.matrix[1, 2]]
    units = ["pixel"] * 4 + [""] * 5
    names = ["fx", "fy", "cx", "cy", *COEFFICIENTS]
    estimates = {}
    for name, value, error, unit in zip(
        names, [*values, *found.coefficients], found.errors, units, strict=True
    ):
        is_assumed = name not in COEFFICIENTS and not found.has_focal
        note = "assumed, too few views" if is_assumed else ""
        reach = np.nan if is_assumed else float(error)
        estimates[f"optics.calibration.{name}"] = Estimate(
            float(value), float(value - reach), float(value + reach), unit, sources, note
        )
    return estimates


def _settings(found: Geometry, size, lateral, main):
    calibration = {
        "width": size[0],
        "height": size[1],
        "fx": float(found.matrix[0, 0]),
        "fy": float(found.matrix[1, 1]),
        "cx": float(found.matrix[0, 2]),
        "cy": float(found.matrix[1, 2]),
    } | dict(zip(COEFFICIENTS, map(float, found.coefficients), strict=True))
    Calibration.of(found.matrix, found.coefficients, size)  # its own checks
    optics: dict = {"calibration": calibration}
    excess = {WAVELENGTHS.get(main, 550.0): 0.0}
    for letter, curve in lateral.items():
        excess[WAVELENGTHS.get(letter, 550.0)] = curve.mean(size)[0]
    if len(excess) > 1:
        optics["lateral_color"] = {
            "wavelengths_nm": sorted(excess),
            "excess": [excess[wave] for wave in sorted(excess)],
        }
    return {"optics": optics}


def _reach(boards: list[Board], shape):
    """Return how far corners come to the frame's corner, in parts of the way."""
    corners = np.concatenate([one.corners for one in boards])
    away = np.hypot(corners[:, 0] - (shape[1] - 1) / 2, corners[:, 1] - (shape[0] - 1) / 2)
    return float(away.max() / (np.hypot(*shape) / 2))


def _unknown(boards, found: Geometry, shape, focal_length, error):
    lines = []
    if not found.has_focal:
        source = "the files'" if focal_length else "a typical one"
        lines.append(
            f"focal length and principal point: {len(boards)} view(s), so {source} and the frame's middle are assumed; "
            f"shoot {ENOUGH_VIEWS} views or more, better ten, the board tilted by 20 to 40 degrees"
        )
    elif found.errors[0] > 0.02 * found.matrix[0, 0]:
        lines.append(
            f"focal length: known to {100 * found.errors[0] / found.matrix[0, 0]:.2g} % only; tilt the board by "
            "20 to 40 "
            "degrees in different directions"
        )
    if (reach := _reach(boards, shape)) < COVERED:
        lines.append(
            f"distortion beyond {reach:.2f} of the way to the corner: no board there, the model's error may be "
            f"{error:.2g} pixel; shoot views that reach the corners"
        )
    elif error > PRECISE:
        lines.append(
            f"distortion: the model's error may be {error:.2g} pixel somewhere in the frame; shoot more views, also in "
            "all corners"
        )
    if boards[0].offsets:
        lines.append(
            "lateral colour within a channel: wavelengths "
            + ", ".join(f"{WAVELENGTHS.get(c, 550.0):g} nm of {c}" for c in boards[0].offsets)
            + " are assumed for the channels"
        )
    return tuple(lines)


def _describe_misfit(boards: list[Board], found: Geometry, shape, spread):
    """Return a line if mean residuals of parts of the frame are no chance."""
    corners = np.concatenate([one.corners for one in boards])
    cell = np.clip((corners / np.array(shape[::-1]) * CELLS).astype(int), 0, CELLS - 1)
    number = cell[:, 1] * CELLS + cell[:, 0]
    worst, where = 0.0, 0
    residuals = np.concatenate(found.residuals)
    noise = np.std(residuals)
    for one in np.unique(number):
        own = residuals[number == one]
        if len(own) < 8:
            continue
        mean = float(np.hypot(*own.mean(0)))
        if mean > SYSTEMATIC * noise / np.sqrt(len(own)) and mean > max(worst, 0.05):
            worst, where = mean, one
    if not worst:
        return ()
    row, col = divmod(int(where), CELLS)
    return (
        f"grid: corners of one part of the frame (row {row + 1}, column {col + 1} of {CELLS}) miss the model by "
        f"{worst:.2g} pixels on average, all by {spread:.2g} RMS: a bent board or a lens beyond k1, k2, p1, p2, k3",
    )


def _plots(boards: list[Board], found: Geometry, size):
    def draw_residuals(figure):
        axes = figure.subplots()
        corners = np.concatenate([one.corners for one in boards])
        residuals = np.concatenate(found.residuals)
        arrows = axes.quiver(
            corners[:, 0],
            corners[:, 1],
            residuals[:, 0],
            -residuals[:, 1],
            width=2e-3,
        )
        unit = max(np.percentile(np.hypot(*residuals.T), 90), 1e-6)
        axes.quiverkey(arrows, 0.85, -0.12, unit, f"{unit:.2g} pixel", labelpos="E")
        axes.set(
            xlim=(0, size[0]), ylim=(size[1], 0), aspect="equal", xlabel="column", ylabel="row"
        )

    def draw_curve(figure):
        axes = figure.subplots()
        focal = found.matrix[0, 0]
        edge = np.hypot(*size) / 2 / focal
        r = np.linspace(0, edge, 100)
        k1, k2, _, _, k3 = found.coefficients
        factor = k1 * r**2 + k2 * r**4 + k3 * r**6
        axes.plot(r / edge, 100 * factor)
        axes.axhline(0, color="0.7", linewidth=0.8)
        axes.set(xlabel="ideal field height, 1 at the corner", ylabel="radial distortion [%]")
        twin = axes.secondary_yaxis(
            "right", functions=(lambda v: v / 100 * edge * focal, lambda v: v * 100 / edge / focal)
        )
        twin.set_ylabel("at the corner [pixel]")

    def draw_lateral(figure):
        axes = figure.subplots()
        corners = np.concatenate([one.corners for one in boards]) - found.matrix[:2, 2]
        radius = np.hypot(*corners.T)
        colours = {"R": "tab:red", "B": "tab:blue", "G": "tab:green"}
        for letter in boards[0].offsets:
            offsets = np.concatenate([one.offsets[letter] for one in boards])
            along = (offsets * corners).sum(1) / np.maximum(radius, 1e-9)
            axes.plot(radius, along, ".", markersize=3, label=letter, color=colours.get(letter))
        axes.legend()
        axes.set(
            xlabel="distance from the principal point [pixel]", ylabel="shift outwards [pixel]"
        )

    plots = [
        Plot("Radial distortion", "Image height over a pinhole's, minus one.", draw_curve),
        Plot("Checkerboards: residuals", "Corners less the fitted model.", draw_residuals),
    ]
    if boards[0].offsets:
        plots.append(
            Plot(
                "Lateral colour",
                f"Shift of corners against channel {main_channel(['G', *boards[0].offsets])}'s.",
                draw_lateral,
            )
        )
    return tuple(plots)

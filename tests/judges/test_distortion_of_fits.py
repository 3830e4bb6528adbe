"""Fits of distortion judged with random lenses in plain NumPy, which share no code with the fit.

No draw is left out: some boards end before the frame's corners. The seeds were run once, at the end.
"""

from concurrent.futures import ProcessPoolExecutor

import board_targets as boards
import flat_targets as flats
import numpy as np
import pytest
from scipy.optimize import least_squares

from gpusim.fit.board import Board
from gpusim.fit.bundle import calibrate, displacement_error
from gpusim.fit.distortion import ERROR, fit_distortion
from gpusim.io.raw.raw_frame import RawFrame

SEEDS = range(5100, 5125)
BLACK = np.array([[64.0]])
MAIN = "GYWCRBM"  # channels, the one of most light first
GOAL = 0.2  # [pixel]
SIZE = 640, 480
COEFFICIENTS = "k1", "k2", "p1", "p2", "k3"
CORNER_SEEDS = range(5400, 5500)
LATERAL_SEEDS = range(7001, 7007)

pytestmark = pytest.mark.slow


def random_lens(rng, has_k3=False):
    """Camera matrix (fx, fy, cx, cy) and Brown's coefficients."""
    cols, rows = SIZE
    focal = rng.uniform(0.8, 1.6) * cols
    matrix = (
        focal,
        focal * rng.uniform(0.998, 1.002),
        (cols - 1) / 2 + rng.normal(0, 8),
        (rows - 1) / 2 + rng.normal(0, 8),
    )
    edge = (np.hypot(cols, rows) / 2 / focal) ** 2
    radial = rng.uniform(-0.08, 0.06) / edge, rng.uniform(-0.015, 0.015) / edge**2
    tangential = rng.normal(0, 4e-4, 2)
    k3 = rng.uniform(-0.01, 0.01) / edge**3 if has_k3 else 0
    return matrix, np.array([*radial, *tangential, k3])


def displacement(matrix, truth, found, own):
    """Displacement over the frame [pixel] after the best turn; found: (fx, fy, cx, cy), own: its coefficients."""
    cols, rows = SIZE
    x, y = np.meshgrid(np.linspace(0, cols - 1, 33), np.linspace(0, rows - 1, 25))
    u, v = boards.undistort((x - matrix[2]) / matrix[0], (y - matrix[3]) / matrix[1], truth)
    rays = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])

    def miss(turn):
        a, b, c = boards.rotation(*turn) @ rays
        p, q = boards.distort(a / c, b / c, own)
        return np.concatenate(
            [found[0] * p + found[2] - x.ravel(), found[1] * q + found[3] - y.ravel()]
        )

    best = least_squares(miss, np.zeros(3), x_scale=1e-3)
    return np.hypot(*best.fun.reshape(2, -1))


def judge_distortion(seed, cfa=("RG", "GB")):
    """Displacement over the frame, hits, errors of lateral colour; the stated error, whether a line says it."""
    rng = np.random.default_rng(seed)
    matrix, truth = random_lens(rng)
    main, *others = [letter for letter in MAIN if letter in "".join(cfa)]
    excess = dict(zip(others, rng.normal(0, 8e-4, len(others)), strict=True)) | {main: 0.0}
    frames = [
        board_frame(rng, SIZE, matrix, truth, excess, cfa, f"grid_{k}.dng") for k in range(10)
    ]
    part = fit_distortion(frames)
    found = part.settings["optics"]["calibration"]
    inner, own = (
        [found[name] for name in names] for names in (("fx", "fy", "cx", "cy"), COEFFICIENTS)
    )
    apart = displacement(matrix, truth, inner, own)
    hits, lateral = [], []
    for name, value in zip(("fx", "fy", "cx", "cy"), matrix, strict=True):
        one = part.estimates[f"optics.calibration.{name}"]
        hits.append(one.low <= value <= one.high)
    for letter in others:
        one = part.estimates[f"optics.lateral_color of {letter}"]
        hits.append(one.low <= excess[letter] <= one.high)
        lateral.append(abs(one.value - excess[letter]) * np.hypot(*SIZE) / 2)
    is_said = any("error may be" in line for line in part.unknown)
    return apart, np.array(hits), np.array(lateral), part.estimates[ERROR], is_said


def board_frame(rng, size, matrix, truth, excess, cfa, name):
    """A frame of a board: each channel's own view, noise."""
    state, planes = rng.bit_generator.state, {}
    for letter in excess:
        rng.bit_generator.state = state
        planes[letter] = boards.random_view(
            rng, size, matrix, truth, (13, 9), excess=excess[letter], fine=2
        )
    raw = flats.through_mosaic(planes, cfa)
    seen = rng.poisson(raw * 6000) * 0.5 + rng.normal(0, 2, raw.shape) + 64
    return RawFrame(np.rint(seen), cfa, name, black_level=BLACK, white_level=4095)


def test_distortion_of_random_lenses():
    """Errors, and the error that the fit states of itself."""
    with ProcessPoolExecutor() as pool:  # each takes half a minute
        found = list(pool.map(judge_distortion, SEEDS))
    most = np.array([one[0].max() for one in found])
    hits = np.concatenate([one[1] for one in found])
    lateral = np.concatenate([one[2] for one in found])
    stated = [one[3] for one in found]
    is_inside = np.array(
        [one.low <= own <= one.high for one, own in zip(stated, most, strict=True)]
    )
    is_said = np.array([one[4] for one in found])
    for seed, own, one, said in zip(SEEDS, most, stated, is_said, strict=True):
        print(
            f"{seed}: {own:.3f} pixel, stated {one.value:.3f} ({one.low:.3f} .. {one.high:.3f}), said: {said}"
        )
    print(
        f"distortion: largest displacement in the frame {np.median(most):.3f} (median), {most.max():.3f} pixel (max), "
        f"{(most > GOAL).sum()} of {len(most)} beyond {GOAL}; lateral colour at the corner {lateral.max():.3f} pixel; "
        f"intervals of parameters hold {hits.mean():.3f}, of the largest error {is_inside.mean():.3f}; "
        f"{is_said.sum()} lenses with a line"
    )
    assert is_inside.mean() >= 0.9
    assert is_said[most > GOAL].all()
    assert most.max() < GOAL
    assert hits.mean() > 0.93
    assert lateral.max() < 0.2


def judge_lateral_color(seed):
    """Errors of the shifts of R and B against G over the frame [pixel], the shifts, and hits of intervals."""
    rng = np.random.default_rng(seed)
    cols, rows = 640, 480
    focal, corner = rng.uniform(0.8, 1.6) * cols, np.hypot(cols, rows) / 2
    matrix = focal, focal, (cols - 1) / 2 + rng.normal(0, 5), (rows - 1) / 2 + rng.normal(0, 5)
    edge = (corner / focal) ** 2
    truth = np.array([rng.uniform(-0.08, 0.06) / edge, 0, *rng.normal(0, 4e-4, 2), 0])
    curves = {letter: tuple(rng.normal(0, (1e-3, 2e-3))) for letter in "RB"} | {"G": (0.0, 0.0)}
    frames = [
        board_frame(rng, (cols, rows), matrix, truth, curves, ("RG", "GB"), f"grid_{k}.dng")
        for k in range(10)
    ]
    part = fit_distortion(frames)
    own = part.settings["optics"]["calibration"]
    x, y = np.meshgrid(np.linspace(0, cols - 1, 33), np.linspace(0, rows - 1, 25))

    def shifts(middle, curve):
        u, v = x - middle[0], y - middle[1]
        return (curve[0] + curve[1] * (u * u + v * v) / corner**2) * np.stack([u, v])

    errors, sizes, hits = [], [], []
    for letter in "RB":
        rows_ = [
            part.estimates[f"lateral colour {words} of {letter}"]
            for words in ("on the axis", "of a corner over the axis")
        ]
        wanted = shifts(matrix[2:], curves[letter])
        seen = shifts((own["cx"], own["cy"]), [one.value for one in rows_])
        errors.append(np.hypot(*(seen - wanted)).max())
        sizes.append(np.hypot(*wanted).max())
        hits += [
            one.low <= value <= one.high for one, value in zip(rows_, curves[letter], strict=True)
        ]
    return np.array(errors), np.array(sizes), np.array(hits)


def test_lateral_colour_that_varies_over_the_field():
    with ProcessPoolExecutor() as pool:
        found = list(pool.map(judge_lateral_color, LATERAL_SEEDS))
    errors, sizes, hits = (np.concatenate(one) for one in zip(*found, strict=True))
    print(
        f"lateral colour of {sizes.min():.2f} to {sizes.max():.2f} pixel: largest error in the frame "
        f"{np.median(errors):.3f} (median), {errors.max():.3f} pixel (max); intervals hold {hits.sum()} of {len(hits)}"
    )
    assert errors.max() < 0.2


def random_corners(rng, matrix, truth, name, noise=0.01):
    """Corners of a board in the frame, with noise [pixel]."""
    turn, shift = boards.random_pose(rng, SIZE, matrix, (13, 9))
    places = np.stack([axis.ravel() for axis in np.indices((12, 8)) + 1.0], axis=1)
    at = np.column_stack([places, np.zeros(len(places))]) @ turn.T + shift
    x, y = boards.distort(at[:, 0] / at[:, 2], at[:, 1] / at[:, 2], truth)
    seen = np.column_stack([matrix[0] * x + matrix[2], matrix[1] * y + matrix[3]])
    seen += rng.normal(0, noise, seen.shape)
    inside = ((seen > 12) & (seen < np.array(SIZE) - 13)).all(axis=1)
    return Board(name, places[inside], seen[inside], {})


@pytest.mark.parametrize("has_k3", [False, True])
def test_stated_error_of_many_lenses(has_k3):
    """The largest error that is stated, against the true one; corners without frames."""
    found = []
    for seed in CORNER_SEEDS:
        rng = np.random.default_rng(seed)
        matrix, truth = random_lens(rng, has_k3)
        views = [random_corners(rng, matrix, truth, f"{k}") for k in range(10)]
        own = calibrate(views, SIZE, 1.2 * SIZE[0])
        apart = displacement(matrix, truth, own.inner[:4], own.coefficients).max()
        found.append((apart, *displacement_error(own, SIZE)))
    apart, _, low, high = np.transpose(found)
    is_inside = (low <= apart) & (apart <= high)
    print(
        f"distortion, k3 {has_k3}: {np.median(apart):.3f} (median), {apart.max():.3f} pixel (max), "
        f"{(apart > GOAL).sum()} of {len(apart)} beyond {GOAL}; the stated interval holds {is_inside.mean():.3f} "
        f"(below {np.mean(apart < low):.2f}, above {np.mean(apart > high):.2f}), {(high > GOAL).sum()} are said, "
        "of those beyond "
        f"{(high[apart > GOAL] > GOAL).sum()}"
    )
    assert is_inside.mean() >= 0.9
    assert (
        np.mean(apart > high) <= 0.06
    )  # the upper end is one of 97.5 %: 7 of 100 have a chance of 1 %
    assert (
        high[apart > GOAL] > GOAL
    ).all()  # not met with k3: one lens misses by 0.226, 0.181 is said

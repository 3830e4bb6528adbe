"""Fits of optics and colour on small frames: what they find, and what they refuse in one line."""

from dataclasses import replace

import board_targets as boards
import chart_targets as charts
import edge_targets as edges
import flat_targets as flats
import numpy as np
import pytest

from gpusim.data.lights import light_of
from gpusim.data.reflectances import reflectances
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.spectrum import photons_from_energy
from gpusim.fit.board import Board, find_board
from gpusim.fit.bundle import calibrate, displacement_error
from gpusim.fit.color import fit_color
from gpusim.fit.curve_prior import NODES, curve_prior
from gpusim.fit.distortion import fit_distortion
from gpusim.fit.falloff import fit_falloff
from gpusim.fit.lateral_color import describe_varying, measure_lateral_color
from gpusim.fit.planes import block_places
from gpusim.fit.sensitivity import fit_sensitivity
from gpusim.fit.shading import fit_shading
from gpusim.fit.sharpness import fit_sharpness
from gpusim.fit.tone import fit_tone, ramp_light
from gpusim.io.raw.raw_frame import RawFrame

BLACK = np.array([[64.0]])


def grey(values, cfa=("Y",), name="a.dng", white=4095):
    return RawFrame(np.asarray(values), cfa, name, black_level=BLACK, white_level=white)


def edge_frame(level=2000, angle=6.0, noise=4.0):
    """A dark square behind a Gaussian of 0.7 pixel without diffraction, analytic but for the pixel's quadrature."""
    at = np.arange(120) - 59.5
    turn, soft = np.radians(angle), 0.7 * np.sqrt(2)
    seen = 0
    for dy in (-0.4, -0.2, 0, 0.2, 0.4):
        for dx in (-0.4, -0.2, 0, 0.2, 0.4):
            x, y = at[None, :] + dx, at[:, None] + dy
            u, v = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
            parts = [
                0.5 * (edges.erf((w + 34) / soft) - edges.erf((w - 34) / soft)) for w in (u, v)
            ]
            seen = seen + parts[0] * parts[1] / 25
    rng = np.random.default_rng(2)
    return grey(rng.normal((0.8 - 0.6 * seen) * level + 64, noise))


def test_edges_give_their_mtf50():
    part = fit_sharpness(edge_frame(), pitch=6e-6, f_number=1.4)  # next to no diffraction
    f = np.linspace(0, 1, 4001)
    response = np.exp(-2 * np.pi**2 * 0.49 * f**2) * np.sinc(f)
    truth = np.interp(-0.5, -response, f)
    for one in part.estimates.values():
        assert one.value == pytest.approx(truth, rel=0.02)
        assert one.low < truth < one.high
    assert part.settings["optics"]["model"] == "measured"


def test_edges_of_a_mosaic_with_a_long_period():
    """X-Trans has each colour in every column: an edge need not cross its period of 6 pixels."""
    cfa = ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG")
    part = fit_sharpness(replace(edge_frame(), cfa=cfa), pitch=3e-6, f_number=2.0)
    assert {key.split()[4] for key in part.estimates} == set("RGB")


def test_corners_of_squares_show_astigmatism_between_rows_and_columns():
    """A Gaussian whose axes are at 45 degrees: edges turned one way see it sharper, or less sharp, than rows do."""
    rng = np.random.default_rng(7)

    def otf(fx, fy):
        return np.exp(-2 * np.pi**2 * 0.6 * (fx**2 + fy**2 + 2 * 0.5 * fx * fy))

    seen = edges.expose(edges.transform(edges.square(np.radians(7), 72)), otf)
    part = fit_sharpness(grey(rng.normal((0.2 + 0.6 * seen) * 2000 + 64, 8)))
    for one in part.estimates.values():
        assert one.value == pytest.approx(edges.mtf50(otf, True), rel=0.02)  # 6 % without corners
    assert not any("both ways" in line for line in part.unknown)


def test_hidden_astigmatism_is_unknown():
    """Two edges and one corner, which may be as round as it is."""
    frame = edge_frame()
    part = fit_sharpness(replace(frame, values=frame.values[40:, 40:]))
    assert any("squares turned both ways" in line for line in part.unknown)


def test_point_spreads_hold_lateral_colour():
    """A channel's spread is displaced by its excess, which grows to the corner."""
    frame = replace(edge_frame(), cfa=("RG", "GB"))
    part = fit_sharpness(frame, pitch=2e-6, f_number=4.0, lateral_color={"R": (0.01, 0.02)})
    spread = part.settings["optics"]["psf"]
    height = np.array([spread.grid[0][0], spread.grid[1][0]])
    kernel = spread.at(*height)[np.argmin(np.abs(spread.wavelengths - 605))]
    at = (np.arange(len(kernel)) - len(kernel) // 2) * spread.spacing / 2e-6
    seen = np.array([at @ kernel.sum(axis) for axis in (1, 0)]) / kernel.sum()
    radius = np.hypot(*height)
    wanted = (0.01 + 0.02 * radius**2) * height * np.hypot(120, 120) / 2
    assert seen == pytest.approx(wanted, abs=0.02)


def test_lateral_colour_over_the_field():
    size, middle = (640, 480), np.array([321.0, 238.0])
    rng = np.random.default_rng(8)
    boards_ = []
    for k in range(4):
        corners = rng.uniform(0, size, (40, 2))
        away = corners - middle
        factor = 1e-3 - 2e-3 * np.sum(away**2, axis=1) / 400**2
        offsets = {"R": factor[:, None] * away + rng.normal(0, 0.01, away.shape)}
        boards_.append(Board(f"{k}", rng.uniform(0, 9, (40, 2)), corners, offsets))
    curve = measure_lateral_color(boards_, middle, size)["R"]
    assert curve.values == pytest.approx([1e-3, -2e-3], abs=1e-4)
    assert curve.largest_miss(size) > 0.2
    assert "misses up to" in describe_varying({"R": curve}, size)[0]


@pytest.mark.parametrize(
    ("frame", "words"),
    [
        (lambda: edge_frame(angle=0.2), "too straight.*turn"),
        (lambda: edge_frame(angle=44), "too steep.*turn"),
        (lambda: edge_frame(level=6000), "clipped.*expose less"),
        (lambda: grey(np.full((90, 90), 500.0)), "no straight edge"),
        (lambda: grey(np.zeros((9, 9, 3))), "save raw files, not JPEG"),
    ],
)
def test_edges_that_cannot_be_measured(frame, words):
    with pytest.raises(BadData, match=words):
        fit_sharpness(frame(), pitch=3e-6)


def test_pitch_is_checked():
    with pytest.raises(OutOfRange, match="pitch"):
        fit_sharpness(edge_frame(), pitch=3.0)


def test_flats_give_their_falloff():
    rng = np.random.default_rng(3)
    truth = flats.falloff(rng, (120, 160))
    frames = [grey(flats.expose_flat(rng, truth), name=f"{k}") for k in range(3)]
    curve = fit_shading(frames).settings["optics"]["relative_illumination"]
    assert curve["values"][-1] == pytest.approx(truth[0, 0], rel=0.01)


def test_corners_of_a_falloff_off_the_middle_are_used():
    """Far corners fall steepest; blocks there are no dust. A channel's pixels are off the middle of its blocks."""
    shape = 480, 640
    cfa = ("GRB", "BGR")
    frame = grey(np.zeros(shape), cfa)

    def truth(row, col):
        y, x = (row - 255) / 400, (col - 300) / 400
        return (1 + 0.5 * (x * x + y * y)) ** -2 * (1 + 1e-4 * (col - 320))

    rows, cols = block_places(frame, "G", np.array([8, 9]))
    assert rows[0] == 3.5  # rows 0 to 7
    assert cols[0] == 3.5  # columns 0 and 1, 3 and 4, 6 and 7 of 9
    found = fit_falloff(truth(rows[:, None], cols), rows, cols, shape)
    assert np.isfinite(found.left).all()
    row, col = np.array([[0], [479]]), np.array([0, 639])
    assert found.at(row, col, shape) == pytest.approx(
        truth(row, col) / truth(239.5, 319.5), rel=5e-4
    )


def test_dust_is_left_out():
    rng = np.random.default_rng(8)
    rows, cols = np.arange(0, 400, 10.0), np.arange(0, 600, 10.0)
    plane = 1 - 0.3 * (np.hypot(rows[:, None] - 200, cols - 300) / 360) ** 2
    dusty = plane * rng.normal(1, 1e-3, plane.shape)
    dusty[10:12, 20:23] *= 0.9
    found = fit_falloff(dusty, rows, cols, (400, 600))
    assert np.isnan(found.left[10:12, 20:23]).all()
    assert np.isnan(found.left).mean() < 0.01
    assert found.at(105.0, 215.0, (400, 600)) == pytest.approx(
        1 - 0.3 * (np.hypot(95, 85) / 360) ** 2, rel=1e-3
    )


def test_flats_that_are_none():
    rng = np.random.default_rng(4)
    with pytest.raises(BadData, match="clipped"):
        fit_shading(grey(np.full((80, 80), 4095)))
    with pytest.raises(BadData, match="no even light"):
        fit_shading(grey(rng.integers(0, 2, (8, 8)).repeat(10, 0).repeat(10, 1) * 1000 + 200))


@pytest.mark.parametrize("fit", [fit_color, fit_distortion])
def test_targets_that_are_not_there(fit):
    rng = np.random.default_rng(5)
    frame = grey(rng.normal(1000, 5, (96, 96)), ("RG", "GB"))
    with pytest.raises(BadData, match=r"found.*(shoot|let it fill)"):
        fit(frame)


@pytest.mark.parametrize("turn", [0.0, 0.13])
def test_boards_give_their_corners(turn):
    """All inner corners and no others, also of a board whose edges run along the pixels."""
    focal, size, squares = 200.0, (160, 120), (6, 4)
    matrix, shift = (focal, focal, 80.2, 59.6), np.array([0.02, -0.01, 9.0])
    tilt = boards.rotation(0.3 * turn, 0, turn)
    middle = tilt @ np.array([3, 2, 0])
    picture = boards.view(size, matrix, np.zeros(5), tilt, shift - middle, squares, fine=4)
    found = find_board(grey(np.rint(3000 * picture + 64)))
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(1, 6), np.arange(1, 4)))
    place = (tilt @ np.stack([x, y, 0 * x])).T + shift - middle
    truth = focal * place[:, :2] / place[:, 2:] + matrix[2:]
    assert len(found.corners) == len(truth)
    away = np.hypot(*(found.corners[:, None] - truth).T)
    assert away.min(axis=0).max() < 0.03


@pytest.mark.parametrize("k3", [0.0, 0.5])
def test_k3_is_used_if_it_is_there(k3):
    rng = np.random.default_rng(9)
    size, focal, places = (640, 480), 600.0, np.indices((12, 8)).reshape(2, -1).T.astype(float)
    truth = np.array([-0.1, 0.02, 1e-4, -2e-4, k3])
    views = []
    for k in range(6):
        turn = boards.rotation(*rng.uniform(-0.5, 0.5, 2), 0.2)
        shift = np.array([(-1) ** k * 2.5, (-1) ** (k // 2) * 1.5, 14]) - turn @ [5.5, 3.5, 0]
        at = np.column_stack([places, 0 * places[:, 0]]) @ turn.T + shift
        corners = np.column_stack(boards.distort(*(at[:, :2].T / at[:, 2]), truth)) * focal
        corners += np.array([322, 238]) + rng.normal(0, 0.01, corners.shape)
        views.append(Board(f"{k}", places, corners, {}))
    found = calibrate(views, size, 700.0)
    assert found.coefficients[4] == pytest.approx(k3, abs=0.1 * k3 + 1e-6)
    value, low, high = displacement_error(found, size)
    assert low < value < high


def test_frames_are_checked():
    with pytest.raises(BadData, match="wanted a RawFrame"):
        fit_color("a.dng")
    with pytest.raises(BadData, match="different size or mosaic"):
        fit_shading([grey(np.ones((8, 8))), grey(np.ones((8, 9)))])


def test_ramps_give_their_tone():
    rng = np.random.default_rng(6)
    curve, light = flats.tone(rng), ramp_light((8, 600))
    part = fit_tone(np.rint(255 * curve(flats.encode(light))), light)
    nodes, values = np.transpose(part.settings["processor"]["tone"])
    assert values == pytest.approx(curve(np.array(nodes)), abs=0.01)


def test_ramps_that_are_none():
    light = ramp_light((4, 300))
    with pytest.raises(BadData, match="codes fall"):
        fit_tone(255 * np.sin(4 * light) ** 2, light)
    with pytest.raises(BadData, match="one shape"):
        fit_tone(np.zeros(3), light)


def test_curves_of_a_chart():
    """Curves of a camera of red, yellow and blue, near the truth; the drawn ones spread around them."""
    rng = np.random.default_rng(7)
    truth = charts.random_camera(rng, "RYB")
    seen = 2000 * charts.responses(truth, "D65", charts.checker())
    surfaces = np.clip(reflectances("colorchecker").at(NODES, outside=None), 0, 1)
    used = np.arange(24) != 18
    light = photons_from_energy(light_of("D65"))
    fit = fit_sensitivity(
        "RYB", [seen], [0 * seen + 1], [light], surfaces, np.zeros((24, 2)), [used], draws=4
    )
    wanted = np.array([np.interp(NODES, charts.WAVES, one) for one in truth / truth.max()])
    assert fit.values == pytest.approx(wanted, abs=0.15)
    assert (fit.values >= 0).all() and (fit.draws >= 0).all()
    assert fit.predicted[0] == pytest.approx(seen, rel=0.01)
    assert 0.005 < (fit.draws - fit.values).std() < 0.1
    assert fit.error < 0.004


def test_priors_of_any_letters():
    mean, covariance = curve_prior(("W", "E"))
    assert mean.shape == (2 * len(NODES),)
    assert np.linalg.eigvalsh(covariance).min() > 0

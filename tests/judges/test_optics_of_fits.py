"""Fits of optics and colour judged with random cameras in plain NumPy, which share no code with the fit.

Seeds below HELD_OUT were seen while the fit was written; the rest were run once, at the end. Sharpness, colour and
shading have other seeds, as the first held-out ones showed faults that were mended. Distortion:
test_distortion_of_fits.py.
"""

import chart_targets as charts
import edge_targets as edges
import flat_targets as flats
import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

from gpusim.fit.color import fit_color
from gpusim.fit.shading import fit_shading
from gpusim.fit.sharpness import fit_sharpness
from gpusim.fit.tone import fit_tone
from gpusim.io.raw.raw_frame import RawFrame

HELD_OUT, CAMERAS = 1000, 20
SEEDS = range(HELD_OUT, HELD_OUT + CAMERAS)
SHARPNESS_SEEDS = range(8200, 8220)
TURNED_SEEDS = range(8220, 8226)
LEANING_SEEDS = range(8226, 8232)
COLOR_SEEDS = range(9200, 9220)
SHADING_SEEDS = range(7000, 7020)
BLACK = np.array([[64.0]])
MAIN = "GYWCRBM"  # channels, the one of most light first
WAVES = {"R": 605, "G": 535, "B": 460, "Y": 560, "C": 500, "M": 550, "W": 560}  # [nm] of channels
ACROSS = 3  # squares across and down a frame of edges

pytestmark = pytest.mark.slow


def share(flags):
    return np.mean(np.concatenate([np.atleast_1d(one) for one in flags]))


def edge_frames(seed, count=3, cfa=None, leans=False, is_turned=False):
    """Frames of 3 x 3 slanted squares, their OTFs by channel, pitch and f-number.

    Without a mosaic every third camera is a Bayer one, whose channels are alike; with one each has its own wavelength
    and share of the light.

    leans: The lens also has astigmatism of 45 degrees.
    is_turned: Every second frame has its squares turned the other way.
    """
    rng = np.random.default_rng(seed)
    number, pitch = rng.uniform(1.8, 5.6), rng.uniform(1.2e-6, 4e-6)
    is_plain = cfa is None
    cfa = cfa or (("RG", "GB") if seed % 3 == 0 else ("Y",))
    main = next(letter for letter in MAIN if letter in "".join(cfa))
    letters = [main] if is_plain else sorted(set("".join(cfa)))
    cutoff = WAVES[main] * 1e-9 * number / pitch
    if cutoff > 1.3:
        pitch *= cutoff / 1.3
        cutoff = 1.3
    angle, side = np.radians(rng.uniform(4, 9)), rng.uniform(70, 80)
    turns = [
        edges.transform(edges.square(sign * angle, side))
        for sign in ((1, -1) if is_turned else (1,))
    ]
    size = ACROSS * edges.TILE
    spreads = [0.25, 0.12, 0.08, 0.08, 0.12, 0.12][: 6 if leans else 5]
    pictures = [{letter: np.zeros((size, size)) for letter in letters} for _ in turns]
    otfs = {letter: [] for letter in letters}
    for row in range(ACROSS):
        for col in range(ACROSS):
            path = rng.normal(0, spreads)
            tile = np.s_[
                row * edges.TILE : (row + 1) * edges.TILE, col * edges.TILE : (col + 1) * edges.TILE
            ]
            for letter in letters:
                wave = WAVES[letter] / WAVES[main]
                otf = edges.aberrated_otf(cutoff * wave, path / wave)
                for planes, pattern in zip(pictures, turns, strict=True):
                    planes[letter][tile] = 0.2 + 0.6 * edges.expose(pattern, otf)
                otfs[letter].append(otf)
    lights = [
        planes[main] if is_plain else flats.through_mosaic(planes, cfa) for planes in pictures
    ]
    frames = [
        RawFrame(
            np.rint(
                rng.poisson(np.maximum(lights[k % len(turns)], 0) * 12000) * 0.25
                + rng.normal(0, 1, (size, size))
                + 64
            ),
            cfa,
            f"edges_{k}.dng",
            black_level=BLACK,
            white_level=4095,
        )
        for k in range(count)
    ]
    return frames, otfs, pitch, number


def simulated_mtf50(spread, pitch, row, col, shape, wave, is_across):
    """MTF50 [cycle/pixel] of point spreads at a place, with a pixel without gaps, by a plain Fourier sum."""
    corner = np.hypot(*shape) / 2
    place = (row - (shape[0] - 1) / 2) / corner, (col - (shape[1] - 1) / 2) / corner
    values = spread.at(*place)
    kernel = values[np.argmin(np.abs(spread.wavelengths - wave))]
    line = kernel.sum(0 if is_across else 1)
    at = (np.arange(len(line)) - (len(line) - 1) / 2) * spread.spacing / pitch
    f = np.linspace(0, 2, 4001)
    seen = np.abs(np.exp(-2j * np.pi * np.outer(f, at)) @ line) / line.sum() * np.abs(np.sinc(f))
    k = np.flatnonzero(seen <= 0.5)[0]
    return float(np.interp(0.5, [seen[k], seen[k - 1]], [f[k], f[k - 1]]))


def judge_sharpness(seed, **options):
    """Relative errors of MTF50 of the edges' fit and of the simulated point spreads, and hits of intervals."""
    frames, otfs, pitch, number = edge_frames(seed, **options)
    part = fit_sharpness(frames, pitch=pitch, f_number=number)
    spread = part.settings["optics"]["psf"]
    errors, hits, simulated = [], [], []
    for key, one in part.estimates.items():
        words = key.replace(",", "").split()
        letter, row, col = words[4], int(words[-3]), int(words[-1])
        if letter not in otfs:
            continue
        is_across, wave = words[2] == "rows", WAVES[letter]
        truth = edges.mtf50(otfs[letter][row // edges.TILE * ACROSS + col // edges.TILE], is_across)
        errors.append(one.value / truth - 1)
        hits.append(one.low <= truth <= one.high)
        middle = [(at // edges.TILE + 0.5) * edges.TILE - 0.5 for at in (row, col)]
        if row // edges.TILE == 1 and col // edges.TILE == 1:  # a node of the grid
            again = simulated_mtf50(spread, pitch, *middle, frames[0].values.shape, wave, is_across)
            simulated.append(again / truth - 1)
    return np.array(errors), np.array(hits), np.array(simulated)


def test_mtf50_of_random_lenses():
    found = [judge_sharpness(seed) for seed in SHARPNESS_SEEDS]
    errors, hits, simulated = (np.concatenate(one) for one in zip(*found, strict=True))
    print(
        f"MTF50: {len(errors)} edges' directions, |error| 95 % {100 * np.percentile(np.abs(errors), 95):.2f} %, max "
        f"{100 * np.abs(errors).max():.2f} %, intervals hold {hits.mean():.3f}; simulated: 95 % "
        f"{100 * np.percentile(np.abs(simulated), 95):.2f} %, max {100 * np.abs(simulated).max():.2f} %"
    )
    assert np.percentile(np.abs(errors), 95) < 0.02
    assert np.percentile(np.abs(simulated), 95) < 0.02
    assert hits.mean() >= 0.95
    assert np.abs(errors).max() < 0.02  # not met: 2.27 % in one of 360


def test_squares_turned_both_ways_cancel_leaning_astigmatism():
    found = [judge_sharpness(seed, leans=True, is_turned=True, count=4) for seed in TURNED_SEEDS]
    errors, hits, _ = (np.concatenate(one) for one in zip(*found, strict=True))
    print(
        f"MTF50, turned both ways: |error| 95 % {100 * np.percentile(np.abs(errors), 95):.2f} %, max "
        f"{100 * np.abs(errors).max():.2f} %, intervals hold {hits.mean():.3f} of {len(hits)}"
    )
    assert np.abs(errors).max() < 0.02
    assert hits.mean() >= 0.95


def test_corners_show_leaning_astigmatism_of_squares_turned_one_way():
    found = [judge_sharpness(seed, leans=True) for seed in LEANING_SEEDS]
    errors, hits, _ = (np.concatenate(one) for one in zip(*found, strict=True))
    print(
        f"MTF50, leaning, one turn: |error| 95 % {100 * np.percentile(np.abs(errors), 95):.2f} %, max "
        f"{100 * np.abs(errors).max():.2f} %, intervals hold {hits.mean():.3f} of {len(hits)}"
    )
    assert np.percentile(np.abs(errors), 95) < 0.03
    assert hits.mean() >= 0.9


def judge_shading(seed, cfa=None):
    """Largest relative error of the camera file's fall-off, and hits of the corners' intervals."""
    is_plain = cfa is None
    rng = np.random.default_rng(seed)
    shape = int(rng.integers(400, 700)), int(rng.integers(500, 900))
    truth = flats.falloff(rng, shape, seed % 2 == 0)
    cfa = cfa or (("RG", "GB"), ("Y",), ("GRB", "BGR"))[seed % 3]
    letters = set("".join(cfa))
    light = truth if is_plain else flats.through_mosaic(dict.fromkeys(letters, truth), cfa)
    frames = [
        RawFrame(flats.expose_flat(rng, light), cfa, f"shading_{k}.dng", black_level=BLACK)
        for k in range(4)
    ]
    part = fit_shading(frames)
    y, x = np.indices(shape)
    if "sensor" in part.settings:
        table = np.array(part.settings["sensor"]["vignetting"])
        nodes = [np.linspace(-0.5, n - 0.5, m) for n, m in zip(shape, table.shape, strict=True)]
        seen = RegularGridInterpolator(nodes, table)(np.stack([y, x], axis=-1))
    else:
        curve = part.settings["optics"]["relative_illumination"]
        height = np.hypot(y - (shape[0] - 1) / 2, x - (shape[1] - 1) / 2) / (np.hypot(*shape) / 2)
        seen = np.interp(height, curve["heights"], curve["values"])
    ratio = seen / truth
    ratio /= np.median(ratio)
    middle = truth[shape[0] // 2, shape[1] // 2]
    hits = []
    for key, one in part.estimates.items():
        row = 0 if "upper" in key else -1
        col = 0 if "left" in key else -1
        hits.append(one.low <= truth[row, col] / middle <= one.high)
    return float(np.abs(ratio - 1).max()), np.array(hits)


def test_shading_of_random_lenses():
    found = [judge_shading(seed) for seed in SHADING_SEEDS]
    most = np.array([one[0] for one in found])
    print(
        f"shading: largest error in the frame {100 * np.median(most):.2f} % (median), {100 * most.max():.2f} % (max); "
        f"intervals hold {share([one[1] for one in found]):.3f}"
    )
    assert most.max() < 0.005
    assert share([one[1] for one in found]) > 0.93


def other_surfaces():
    """Reflectances of surfaces that are not the chart's, (N, L): paint, objects, skin, leaves."""
    from gpusim.data.reflectances import reflectances

    sets = [reflectances(name) for name in ("munsell", "dupont", "objects", "skin")]
    return np.concatenate(
        [[np.interp(charts.WAVES, one.wavelengths, row) for row in one.values] for one in sets]
    )


def color_differences(camera, fitted, light):
    """CIEDE2000 between responses of the true and of the fitted camera to other surfaces, in CIELAB by one matrix.

    The matrix takes the true camera's white-balanced responses to XYZ, least squares. Exposure is matched in the
    strongest channel.
    """
    import colour

    surfaces = other_surfaces()
    eye = colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    curves = np.array(
        [np.interp(charts.WAVES, eye.wavelengths, eye.values[:, k]) for k in range(3)]
    )
    weights = curves * charts.photons(light) / charts.WAVES
    wanted, white = surfaces @ weights.T / weights[1].sum(), weights.sum(1) / weights[1].sum()
    seen, again = (charts.responses(one, light, surfaces) for one in (camera, fitted))
    balance = charts.responses(camera, light, np.ones((1, len(charts.WAVES))))
    main = seen.sum(0).argmax()
    again = again * (seen[:, main] @ again[:, main]) / (again[:, main] @ again[:, main])
    matrix = np.linalg.lstsq(seen / balance, wanted, rcond=None)[0]
    lab = [
        colour.XYZ_to_Lab(np.maximum(one / balance @ matrix, 0), colour.XYZ_to_xy(white))
        for one in (seen, again)
    ]
    return colour.delta_E(*lab, method="CIE 2000")


def judge_color(seed, cfa=None, count=1, draw=charts.random_camera):
    """Colour differences of other surfaces in D65, and the intervals of their 95 % and of the largest that are stated.

    The chart's patches differ from their tables by 0.5 %. The second light is a blackbody of 2856 K.
    """
    rng = np.random.default_rng(seed)
    letters = "".join(letter for letter in "RGBYCMW" if letter in "".join(cfa or "RGB"))
    camera = draw(rng, letters)
    frames = []
    for light in ("D65", "2856K")[:count]:
        patches = charts.responses(camera, light, charts.checker())
        patches = patches * (1 + rng.normal(0, 0.005, (24, 1)))
        cfa = cfa or (("RG", "GB"), ("GB", "RG"), ("GR", "BG"))[seed % 3]
        turn = rng.uniform(-0.2, 0.2) + np.pi * (seed % 5 == 0)
        values = charts.draw(patches, (360, 480), cfa, rng, turn=turn, order=letters)
        frames.append(RawFrame(values, cfa, f"{light}.dng", black_level=BLACK, white_level=4095))
    part = fit_color(frames, lights=["D65", "A"][:count])
    table = part.settings["sensor"]["sensitivity"]
    fitted = np.array(
        [
            np.interp(charts.WAVES, table["wavelengths_nm"], table[c], left=0, right=0)
            for c in letters
        ]
    )
    stated = [
        (one.low, one.high) for key, one in part.estimates.items() if "other surfaces in D65" in key
    ]
    return color_differences(camera, fitted, "D65"), stated


def report_color(words, found):
    """Print the colour differences; return their 95 %, and the share of stated upper ends that hold."""
    all_ = np.concatenate([one for one, _ in found])
    holds, inside = [], []
    for one, stated in found:
        for truth, (low, high) in zip((np.percentile(one, 95), one.max()), stated, strict=False):
            holds.append(truth <= high)
            inside.append(low <= truth <= high)
    most = np.array([one.max() for one, _ in found])
    print(
        f"colour, {words}: dE2000 of {all_.size} other surfaces: mean {all_.mean():.3f}, 95 % "
        f"{np.percentile(all_, 95):.3f}, max {all_.max():.3f}; {(most > 1).sum()} of {len(found)} cameras above 1; "
        f"stated ends hold {np.mean(holds or [1]):.3f}, intervals {np.mean(inside or [1]):.3f}"
    )
    return np.percentile(all_, 95), np.mean(holds or [1])


@pytest.mark.parametrize("draw", [charts.random_camera, charts.dichroic_camera])
@pytest.mark.parametrize("count", [1, 2])
def test_colour_of_random_cameras(count, draw):
    found = [judge_color(seed, count=count, draw=draw) for seed in COLOR_SEEDS]
    most, held = report_color(f"{draw.__name__}, {count} light(s)", found)
    assert most < 0.5
    assert held >= 0.9


def judge_tone(seed):
    """Largest error of the tone curve [code], and hits of the nodes' intervals."""
    rng = np.random.default_rng(seed)
    curve = flats.tone(rng)
    light = np.broadcast_to((np.arange(900) + 0.5) / 900, (40, 900))
    codes = np.rint(255 * curve(flats.encode(light)) + rng.normal(0, 0.7, light.shape)).clip(0, 255)
    part = fit_tone(codes, light)
    nodes, values = np.transpose(part.settings["processor"]["tone"])
    at = np.linspace(0.05, 1, 300)
    hits = [
        one.low <= curve(np.array(x)) <= one.high
        for x, one in zip(nodes, part.estimates.values(), strict=True)
    ]
    return 255 * np.abs(PchipInterpolator(nodes, values)(at) - curve(at)).max(), np.array(hits)


def test_tone_of_random_cameras():
    found = [judge_tone(seed) for seed in SEEDS]
    most = np.array([one[0] for one in found])
    print(
        f"tone: largest error {most.max():.2f} codes; intervals hold {share([one[1] for one in found]):.3f}"
    )
    assert most.max() < 1

"""Lights that are far brighter than their surroundings: cases 1, 2, 3 and 24."""

from dataclasses import replace

import numpy as np

from gpusim.data.weights import electrons_per_content
from gpusim.domain.account import Tolerance
from gpusim.domain.content import Cube
from gpusim.domain.errors import GpusimError
from gpusim.domain.scene import Scene, unit_light
from gpusim.judge.hard import truth
from gpusim.judge.hard.case import Found, case
from gpusim.judge.hard.scenes import CAMERA, CFA, LIGHT, WAVELENGTHS, electrons, mean_of, natural
from gpusim.pipeline.simulator import Simulator


def with_points(background, places, levels, lines) -> np.ndarray:
    """Return a float32 cube of a flat spectrum, with pixels of one wavelength each.

    An entry of None in `lines` stands for all wavelengths.
    """
    values = np.full((31, *background.shape), 1.0, np.float32) * background.astype(np.float32)
    for (y, x), level, line in zip(places, levels, lines, strict=True):
        values[:, y, x] = 0
        values[slice(None) if line is None else line, y, x] = level
    return values


def q_of(wavelengths) -> np.ndarray:
    """Return wavelength times f-number over pitch of CAMERA."""
    return np.asarray(wavelengths) * 1e-9 * 2.8 / 1.4e-6


def by_hand(values, scene) -> np.ndarray:
    """Return the electrons of a uniform world with single pixels of other light.

    The pattern of each one is integrated over the pixels. Cases 5 to 7 judge the weights of the
    wavelengths.
    """
    values = values.astype(float)
    base, weights = np.median(values, axis=(1, 2)), electrons_per_content(scene, CAMERA)
    return truth.even(base, weights, values.shape[1:], CFA) + truth.of_points(
        values, base, q_of(scene.wavelengths), weights, CFA
    )


@case(
    1,
    "highlight in the dark",
    "1e6 and 1e9 on 1e-3, f/2.8, float32: local error <= 1e-3 everywhere, none negative",
)
def in_the_dark(device):
    for level in (1e6, 1e9):
        values = with_points(np.full((60, 90), 1e-3), [(22, 31)], [level], [None])
        scene = Scene(Cube(WAVELENGTHS, values), LIGHT)
        exact = by_hand(values, scene)
        for tolerance in (None, Tolerance(rms=1e-4)):
            mean = electrons(scene, device, tolerance=tolerance)
            words = f"local error, {level:.0e}" + (", planes fused" if tolerance else "")
            yield Found(np.abs(mean / exact - 1).max(), 1e-3, words)
            yield Found(np.count_nonzero(mean < 0), 0, "negative pixels")


@case(
    2,
    "coloured highlights",
    "20 narrow-band points of 1e4 .. 1e6, natural background: <= 0.1 sigma at 2000 e-",
)
def coloured_highlights(device):
    scene = replace(natural((160, 112), surfaces="munsell"), border="zero")
    random = np.random.default_rng(3)
    places = np.stack([random.integers(0, 112, 20), random.integers(0, 160, 20)], axis=1)
    values = scene.content.values.astype(float)
    median = np.median(values)
    levels, lines = np.geomspace(1e4, 1e6, 20), random.integers(5, 26, 20)
    for (y, x), level, line in zip(places, levels, lines, strict=True):
        values[line, y, x] += level * median
    bright = replace(scene, content=replace(scene.content, values=values.astype(np.float32)))
    weights, q = electrons_per_content(scene, CAMERA), q_of(WAVELENGTHS)
    exact = truth.mosaic_of(truth.spread(bright.content.values.astype(float), q, weights), CFA)
    background = truth.mosaic_of(truth.spread(scene.content.values.astype(float), q, weights), CFA)
    scale = 2000 / np.median(background)
    for tolerance in (None, "metrology"):
        wrong = np.abs(electrons(bright, device, tolerance=tolerance) - exact)
        sigma = (wrong * scale / np.sqrt(exact * scale)).max()
        yield Found(sigma, 0.1, f"sigma, tolerance {tolerance}")


def far_sides(place, shape):
    """Return the windows opposite to a place at the corner or edge of a frame."""
    rows = slice(-24, None) if place[0] < shape[0] / 2 else slice(0, 24)
    cols = slice(-24, None) if place[1] < shape[1] / 2 else slice(0, 24)
    return (rows, slice(None)), (slice(None), cols)


@case(
    3,
    "highlight at the corner",
    "at the corner, 1 pixel outside: no wrap (opposite side <= 1e-6 of local truth), "
    "the declared border obeyed",
)
def at_the_corner(device):
    """Compare the light that a highlight adds with its pattern in space.

    On the opposite side, the pattern is 1e5 times fainter than the dark background. The border rule
    is kept if a highlight adds its own light and the light of its mirror images, within 1e-3, which
    the tables of far kernels keep. A dark world adds nothing. A mirrored world has images on the
    opposite side.
    """
    lines, shape = np.array([420.0, 500.0, 550.0, 600.0, 680.0]), (200, 260)
    q = q_of(lines)
    for border, margin, place in (
        ("zero", 0, (0, 0)),
        ("zero", 0, (199, 130)),
        ("reflect", 0, (0, 0)),
        ("scene", 8, (-1, -1)),
        ("scene", 8, (-1, 120)),
    ):
        whole = tuple(n + 2 * margin for n in shape)
        values = np.full((len(lines), *whole), 1e-3, np.float32)
        dark = Scene(Cube(lines, values.copy()), LIGHT, border, margin)
        values[:, place[0] + margin, place[1] + margin] = 100.0
        lit = Scene(Cube(lines, values), LIGHT, border, margin)
        simulator = Simulator(CAMERA, device=device)
        before, after = mean_of(simulator, dark), mean_of(simulator, lit)
        mirrored = border == "reflect"
        images = [place]
        if mirrored:
            images = [(y, x) for y in {place[0], -1 - place[0]} for x in {place[1], -1 - place[1]}]
        weights = electrons_per_content(lit, CAMERA)
        more = np.float64(np.float32(100.0)) - np.float32(1e-3)
        rows, cols = np.arange(shape[0]), np.arange(shape[1])
        adds = 0.0
        for band, one in enumerate(q):
            for y, x in images:
                pattern = truth.point(float(one), rows - y, cols - x)
                adds = adds + np.multiply.outer(weights[:, band] * more, pattern)
        adds = truth.mosaic_of(adds, CFA)
        level = truth.even(np.full(len(lines), 1e-3), weights, shape, CFA)
        wrong = np.abs(after - before - adds) / (level + adds)
        words = f"{border}, highlight at {place}"
        if mirrored:  # farther images count elsewhere
            yield Found(wrong[:60, :60].max(), 1e-3, f"60 pixels around, {words}")
        else:
            yield Found(wrong.max(), 1e-3, f"whole frame, {words}")
            opposite = max(wrong[side].max() for side in far_sides(place, shape))
            yield Found(opposite, 1e-6, f"opposite side, {words}")


@case(
    24,
    "thirteen decades",
    "planes of 1e-7 .. 1e6: no infinity, dark pixels <= 1e-3; float16 too, or refused",
)
def thirteen_decades(device):
    values = with_points(np.full((40, 60), 1e-7), [(11, 13), (30, 44)], [1e6, 1e6], [None, 20])
    scene = Scene(Cube(WAVELENGTHS, values), unit_light(WAVELENGTHS))
    yield _dark("float32, 1e-7 .. 1e6", values, scene, device)
    try:  # 1e6 is infinite in float16
        with np.errstate(over="ignore"):
            half = values.astype(np.float16)
        taken = replace(scene, content=Cube(WAVELENGTHS, half))
        yield _dark("float16, 1e-7 .. 1e6", values, taken, device)
        how = "taken"
    except GpusimError:
        how = "refused"
    # the nine decades of float16 below its largest number, rounded by 2^-11 = 4.9e-4
    held = with_points(np.full((40, 60), 1e-4), [(11, 13), (30, 44)], [6e4, 6e4], [None, 20])
    half = Scene(Cube(WAVELENGTHS, held.astype(np.float16)), unit_light(WAVELENGTHS))
    yield _dark(f"float16, 1e-4 .. 6e4 (1e6 in float16 is {how})", held, half, device)


def _dark(words, values, scene, device):
    mean, exact = electrons(scene, device), by_hand(values, scene)
    wrong = np.abs(mean / exact - 1).max() if np.isfinite(mean).all() else np.inf
    return Found(wrong, 1e-3, f"local error, {words}")

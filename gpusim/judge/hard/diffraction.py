"""Pixels and transfer functions: cases 4, 9, 10, 11, 17."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from gpusim.data.weights import electrons_per_content
from gpusim.domain.account import Tolerance
from gpusim.domain.content import Cube
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.scene import Scene, unit_light
from gpusim.io.camera.cameras import open_camera
from gpusim.judge.hard import truth
from gpusim.judge.hard.case import Found, case
from gpusim.judge.hard.scenes import CAMERA, CFA, LIGHT, WAVELENGTHS, electrons, mean_of, natural
from gpusim.judge.truth import true_error
from gpusim.judge.truth_light import centre_pads
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.mosaic import mosaic
from gpusim.kernels.optics.pupil import pupil
from gpusim.optics.lengths import transform_lengths
from gpusim.pipeline.simulator import Simulator

PLANS: dict[str, dict] = {
    "exact": {},
    "fused to 1e-2": {"tolerance": Tolerance(rms=1e-2)},
    "fused to 1e-4": {"tolerance": Tolerance(rms=1e-4)},
    "guaranteed": {"tolerance": Tolerance(rms=1e-2), "guaranteed": True},
}


@case(
    4,
    "flat fields",
    "any spectrum: electrons to 1e-6 in every plan, truncated kernels too; sums of energy to 1e-6; "
    "behind coma the sum of the points' own kernels, within the reported error",
)
def flat_fields(device):
    """Errors are relative to a pixel's light in all channels, as one channel may hardly see a line.

    Energy is summed over a whole period, which loses nothing. Coma moves points more at the corners, which crowds or
    thins them: a uniform scene is no uniform frame there.
    """
    random = np.random.default_rng(4)
    fields = {
        "white": np.ones(31),
        "blue line": np.eye(31)[4],
        "red line": np.eye(31)[24],
        "noise": random.random(31),
    }
    for plan, options in PLANS.items():
        simulator = Simulator(CAMERA, device=device, **options)
        yield Found(_flat(simulator, WAVELENGTHS, fields.values()), 1e-6, f"flat, {plan}")
    coma = replace(
        CAMERA, optics=replace(CAMERA.optics, wavefront=Wavefront(seidel=(0.0, 0.7, 0.5, 0.4, 0.0)))
    )
    yield Found(*_flat_behind(coma, device, random.random(4)), "flat, varying over the field")
    for plan, options in PLANS.items():
        yield Found(_energy(device, options), 1e-6, f"energy, {plan}")


def _flat(simulator, wavelengths, fields):
    """Return the largest error of uniform frames of these spectra, over all channels of a pixel."""
    wrong = 0.0
    for spectrum in fields:
        values = np.tile(spectrum[:, None, None], (1, 36, 48)).astype(np.float32)
        scene = Scene(Cube(wavelengths, values), LIGHT)
        base, weights = values[:, 0, 0].astype(float), electrons_per_content(scene, CAMERA)
        exact = truth.even(base, weights, (36, 48), CFA)
        wrong = max(wrong, np.abs(mean_of(simulator, scene) - exact).max() / (weights @ base).max())
    return wrong


def _flat_behind(camera, device, spectrum):
    """Return the RMS error of a uniform frame, and the one that the plan expects."""
    values = np.tile(spectrum[:, None, None], (1, 36, 48)).astype(np.float32)
    scene, simulator = (
        Scene(Cube(WAVELENGTHS[::10], values), LIGHT),
        Simulator(camera, device=device),
    )
    exposure = simulator.expose(scene, 1.0)
    return true_error(simulator, scene, exposure).rms, exposure.plan.account.total.rms


def _energy(device, options):
    """Return the largest relative error of the total electrons per channel, for stacked pixels."""
    values = np.zeros((31, 64, 64), np.float32)
    values[:, 16:48, 8:56] = natural((48, 32)).content.values
    scene = Scene(Cube(WAVELENGTHS, values), LIGHT, "zero")
    camera = replace(CAMERA, sensor=replace(CAMERA.sensor, stacked=True))
    weights = electrons_per_content(scene, CAMERA)
    found = electrons(scene, device, camera, period=(64, 64), **options).sum(axis=(1, 2))
    return np.abs(found / (weights @ values.astype(float).sum(axis=(1, 2))) - 1).max()


@case(
    9,
    "moved points, coarse pixels",
    "f/1.8, 4 um (Q = 0.25), 9 sub-pixel places: flux to 1e-4 at all, kernels <= 1e-3 of the peak",
)
def moved_points(device):
    """A wavefront with slope s moves the point by -2 Q s before the pixels integrate."""
    q, period, size = 550e-9 * 1.8 / 4e-6, (96, 96), 9
    light = np.zeros((1, size, size), np.float32)
    light[0, size // 2, size // 2] = 1
    moves = [(a / 3 + 0.05, b / 3 - 0.4) for a in range(3) for b in range(3)]
    waves = np.zeros((len(moves), 3, 3))
    waves[:, 0, 1], waves[:, 1, 0] = -np.array(moves).T / (2 * q)
    tables = pupil(Pupil(), waves, np.full(len(moves), q, np.float32), 1.0, *period, device=device)
    flux = np.abs(np.array(tables[:, 0, 0]) - 1).max()  # of all pixels together
    wrong, at = 0.0, np.arange(size) - size // 2
    for (dy, dx), table in zip(moves, tables, strict=True):
        image = blur(light, table[None, None], np.ones((1, 1)), "zero", period, device=device)[0]
        # 7 nodes to a ring
        exact = truth.in_pixels(lambda radius: truth.airy(radius, q), at - dy, at - dx, 24)
        wrong = max(wrong, np.abs(image - exact).max() / exact.max())
    yield Found(flux, 1e-4, "flux")
    yield Found(wrong, 1e-3, "kernel, of its peak")


@case(
    10,
    "blur wider than a tile",
    "f/16, 1.0 um (Q = 6 .. 11): tiles of 24 pixels equal the untiled frame to 1e-5",
)
def wider_than_a_tile(device):
    """Tiles are cut together with their surroundings, which hold all of the scene.

    They lie at another place of the period. Tables are folded from the transfer function of a
    circle in float64.
    """
    planes, lines = natural((72, 72)).content.values[[5, 15, 25]], WAVELENGTHS[[5, 15, 25]]
    margin, period, mix = 56, (216, 216), np.array([[0.2, 0.5, 0.3]])
    tables = np.stack(
        [truth.folded_otf(one * 1e-9 * 16 / 1e-6, period)[:109, :109] for one in lines]
    )
    tables = tables[None].astype(np.float32)

    def blurred(light, margin=0):
        light = np.ascontiguousarray(light)
        return blur(light, tables, mix, "zero", period, margin, device=device)

    whole = blurred(planes)
    around = np.pad(planes, ((0, 0), (margin, margin), (margin, margin)))
    side = 24 + 2 * margin
    tiled = np.zeros_like(whole)
    for y in range(0, 72, 24):
        for x in range(0, 72, 24):
            window = around[:, y : y + side, x : x + side]
            tiled[:, y : y + 24, x : x + 24] = blurred(window, margin)
    # light that a tile misses without its surroundings
    seen = np.abs(blurred(planes[:, :24, :24]) - whole[:, :24, :24]).max() / whole.max()
    wrong = np.abs(tiled - whole).max() / whole.max()
    yield Found(wrong, 1e-5, "largest difference over the brightest pixel")
    yield Found(0.05 / seen, 1.0, "0.05 over the loss of a tile without surroundings")


ANGLE = np.radians(5)
MARGIN = 80
LINES = np.array([540.0, 550.0, 560.0])
DARK, BRIGHT = 0.1, 1.0


def slanted_edge(rows: int, cols: int) -> np.ndarray:
    """Return the share of every sample that lies to the right of a slanted line through the middle.

    The line is ANGLE from the columns. The integral of the ramp that a line cuts off a unit square
    is a second difference of half the cube, x |x|^2 / 6.
    """
    a, b = np.cos(ANGLE), np.sin(ANGLE)
    y, x = np.mgrid[:rows, :cols] - np.array([rows - 1, cols - 1])[:, None, None] / 2
    distance = a * x + b * y
    # area of {a u + b v > -distance} in the unit square: squared positive parts at the corners, / 2 a b
    far, near = (a + b) / 2, (a - b) / 2
    corners = [(1, far), (-1, near), (-1, -near), (1, -far)]
    area = sum(sign * np.maximum(distance + at, 0) ** 2 for sign, at in corners)
    return area / (2 * a * b)


def _fitted_edge(image):
    """Return the column at which a straight line crosses the first row, and its columns per row.

    The line goes through the centroids of the rows. Each centroid is computed in a window about the
    last fit, to weight both tails equally.
    """
    rows, cols = image.shape
    slope = np.diff(image, axis=1)
    between, window = np.arange(cols - 1) + 0.5, 1.0
    for _ in range(4):
        centre = (slope * window * between).sum(axis=1) / (slope * window).sum(axis=1)
        tilt, start = np.polyfit(np.arange(rows), centre, 1)
        away = between - (start + tilt * np.arange(rows))[:, None]
        window = np.cos(np.pi * np.clip(away / 80, -0.5, 0.5)) ** 2
    return start, tilt


def mtf50(image) -> tuple[float, float]:
    """Return the MTF50 [cycle/pixel] and the tilt of the edge.

    MTF(f) = |int exp(-2 pi i f d) dE(d)|, with E the pixels in the order of their distances d from
    the edge. This is ISO 12233 without its quarter-pixel bins, which pixels fill unevenly (they
    cost 0.4 %, measured on the bare edge).
    """
    from scipy.optimize import brentq

    start, tilt = _fitted_edge(image)
    y, x = np.indices(image.shape)
    distance = ((x - start - tilt * y) / np.hypot(1, tilt)).ravel()
    reach = image.shape[1] / 2 - 1 - abs(tilt) * image.shape[0] / 2
    order = np.argsort(distance)
    order = order[np.abs(distance[order]) < reach]
    edge, place = image.ravel()[order], distance[order]
    line, middle = np.diff(edge) / (edge[-1] - edge[0]), (place[1:] + place[:-1]) / 2
    return brentq(
        lambda f: abs((line * np.exp(-2j * np.pi * f * middle)).sum()) - 0.5, 0.02, 0.7
    ), tilt


def system_mtf50(q: float, aperture: float, fine: float) -> float:
    """Return the frequency at which pupil x pixel x sample is 0.5 along the edge's normal.

    It is folded by `fine` scene samples per pixel.
    """
    from scipy.optimize import brentq

    a, b = np.cos(ANGLE), np.sin(ANGLE)

    def airy_otf(s):
        s = min(abs(s), 1.0)
        return 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))

    def mtf(f):
        x, y = f * a, f * b
        replicas = fine * np.arange(-3, 4) if fine < np.inf else (0,)  # 1 / q + 1 <= 3
        places = [(x + i, y + j) for i in replicas for j in replicas]
        folded = sum(
            airy_otf(q * np.hypot(u, v)) * np.sinc(aperture * u) * np.sinc(aperture * v)
            for u, v in places
        )
        return np.sinc(x / fine) * np.sinc(y / fine) * folded

    return brentq(lambda f: mtf(f) - 0.5, 0.01, 0.9)


def picture(q: float, fill: float, fine: int, device) -> tuple[np.ndarray, float]:
    """Return an image of the edge at 550 nm in units of the scene, and its q.

    The camera is monochrome, with `fine` scene samples per pixel.
    """
    camera = open_camera("mono")
    sensor = replace(camera.sensor, fill_factor=fill)
    f_number = q * sensor.pixel_pitch / 550e-9
    optics = replace(camera.optics, f_number=f_number, relative_illumination="none")
    camera = replace(camera, sensor=sensor, optics=optics)
    share = slanted_edge(fine * (160 + 2 * MARGIN), fine * (420 + 2 * MARGIN))
    values = np.zeros((3, *share.shape), np.float32)
    values[1] = DARK + (BRIGHT - DARK) * share
    scene = Scene(
        Cube(LINES, values),
        unit_light(LINES),
        "scene",
        margin=fine * MARGIN,
        samples_per_pixel=fine,
    )
    simulator = Simulator(camera, device=device)
    exposure = simulator.expose(scene, 1.0)
    image = simulator.device.numpy(exposure.mean).astype(np.float64) / exposure.plan.weights[0, 1]
    return image, 550e-9 * exposure.plan.camera.optics.working_f_number / sensor.pixel_pitch


def overshoot(image) -> float:
    """Return the largest excess over the two sides of the edge, relative to its step."""
    return max(image.max() - BRIGHT, DARK - image.min()) / (BRIGHT - DARK)


@case(11, "slanted edge", "5 degrees, Q = 1.1: MTF50 within 0.5 %, overshoot <= 1e-4 of the step")
def edge(device):
    """Scene samples are a comb behind a box, so the comb folds the expected transfer."""
    image, q = picture(1.1, 1.0, 1, device)
    yield Found(abs(mtf50(image)[0] / system_mtf50(q, 1.0, 1) - 1), 5e-3, "MTF50")
    yield Found(overshoot(image), 1e-4, "overshoot")


@lru_cache(maxsize=1)
def _folded_input():
    random = np.random.default_rng(8)
    return random.random((4, 53, 61)).astype(np.float32), np.linspace(0.8, 1.4, 12)


@case(
    17,
    "folded mosaic",
    "odd sizes, four Bayer phases: the folded frame equals the full one, sampled, to 1e-6",
)
def folded_mosaic(device):
    found = []
    light, q = _folded_input()
    for cfa in ([[0, 1], [1, 2]], [[1, 0], [2, 1]], [[1, 2], [0, 1]], [[2, 1], [1, 0]]):
        for rows, cols, margin in ((37, 53, 0), (39, 41, 3), (1, 7, 0)):
            wrong, is_folded = sampled_error(light[:, :rows, :cols], q, cfa, margin, device)
            found.append(Found(wrong if is_folded else np.inf, 1e-6, f"{rows} x {cols}, {cfa}"))
    yield max(found, key=lambda one: one.got)


def sampled_error(planes, q, cfa, margin, device) -> tuple[float, bool]:
    """Return the largest error of `optics.mosaic`, and whether it folds the mosaic.

    The reference computes all channels in full, in float64, and samples them. There are twelve
    kernels of one q each, for 4 planes in 3 channels.
    """
    rows, cols = planes.shape[1:]
    period, is_folded = transform_lengths((rows + 32, cols + 32), np.shape(cfa))
    tables = np.stack([truth.folded_otf(float(one), period) for one in q]).reshape(3, 4, *period)
    pads = centre_pads(period, (rows, cols))
    wide = np.pad(planes.astype(float), [(0, 0), *pads], mode="edge")
    quarter = tables[:, :, : period[0] // 2 + 1, : period[1] // 2 + 1].astype(np.float32)
    full = np.fft.ifft2((tables * np.fft.fft2(wide)).sum(axis=1)).real
    (top, _), (left, _) = pads
    full = full[:, top + margin : top + rows - margin, left + margin : left + cols - margin]
    result = mosaic(
        np.ascontiguousarray(planes),
        quarter,
        np.ones((3, 4)),
        np.array(cfa),
        "edge",
        period,
        margin,
        device=device,
    )
    wanted = truth.mosaic_of(full, cfa)
    return np.abs(result - wanted).max() / np.abs(wanted).max(), is_folded

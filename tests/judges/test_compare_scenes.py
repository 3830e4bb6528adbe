"""Judge of `gs.compare` on edges, charts and even light: plain NumPy targets, which share no code with gpusim.

Right cameras must agree. Edges of 5 % lower MTF50, a sharper infrared cut or other filters, and corners that are 3 %
darker must differ: agreement is 2 % of MTF50, a mean CIEDE2000 of 1, and 1 % of the light in the middle.
"""

import math
from dataclasses import replace

import chart_targets as charts
import edge_targets as edges
import flat_targets as flats
import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.fit.shading import fit_shading
from gpusim.io.raw.raw_frame import RawFrame

GAIN, BLACK = 0.25, 64
SHARES = {"Y": 1.0, "R": 0.55, "G": 1.0, "B": 0.5}
MOSAICS = {
    "mono": ("Y",),
    "bayer": ("RG", "GB"),
    "quad-bayer": ("RRGG", "RRGG", "GGBB", "GGBB"),
    "x-trans": ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG"),
}
TRIALS = 3  # of each mosaic
PLAIN = {
    "pupil": Pupil(),
    "wavefront": Wavefront(),
    "defocus": 0.0,
    "lateral_color": 0.0,
    "birefringence": (0.0, 0.0),
    "diffuser": 0.0,
}

pytestmark = pytest.mark.slow
each_mosaic = pytest.mark.parametrize("name", MOSAICS)
each_colour_mosaic = pytest.mark.parametrize("name", [name for name in MOSAICS if name != "mono"])


def camera(cfa, **changes):
    known = {
        "gain_dn_per_e": GAIN,
        "full_well_e": 16000,
        "black_level_dn": BLACK,
        "bits": 12,
        "read_e": 3.0,
        "dark_current_e_per_s": 0.0,
        "prnu": 0.0,
        "dsnu_e": 0.0,
        "relative_illumination": "none",
    }
    if len(cfa) > 1:
        known["cfa"] = list(cfa)
    return gs.open_camera("mono" if len(cfa) == 1 else "phone").with_(**(known | changes))


def tiled(period, shape):
    return np.tile(
        period, [-(-size // side) for size, side in zip(shape, period.shape, strict=True)]
    )[: shape[0], : shape[1]]


def shares(cfa, shape):
    return tiled(np.array([[SHARES[letter] for letter in row] for row in cfa]), shape)


def frames(values, cfa, name):
    return [
        RawFrame(
            one, cfa, f"{name} {k}", exposure_time=0.01, black_level=np.array([[float(BLACK)]])
        )
        for k, one in enumerate(values)
    ]


def expose(rng, electrons):
    noisy = rng.poisson(np.maximum(electrons, 0)) + rng.normal(0, 3, electrons.shape)
    return np.rint(noisy * GAIN + BLACK)


def gaussian_lens(camera, sigma):
    """The camera with a lens of a Gaussian point spread. sigma: [pixel]."""
    fine = 8
    at = np.arange(-math.ceil(5 * sigma * fine), math.ceil(5 * sigma * fine) + 1) / fine
    line = np.exp(-(at**2) / 2 / sigma**2)
    kernels = np.array([np.outer(line, line)] * 2)
    spread = PointSpread(np.array([400.0, 700.0]), kernels, camera.sensor.pixel_pitch / fine)
    return replace(camera, optics=replace(camera.optics, model="measured", psf=spread, **PLAIN))


def edge_mtf50(sigma):
    return edges.mtf50(edges.gaussian_otf((1.0, sigma, sigma)), True)


def sigma_of(limit):
    """The Gaussian whose edges have an MTF50, by bisection."""
    low, high = 0.05, 4.0
    for _ in range(50):
        middle = (low + high) / 2
        low, high = (middle, high) if edge_mtf50(middle) > limit else (low, middle)
    return low


def edge_frames(rng, sigma, cfa, count=24, tile=256, keep=224, electrons=9000):
    """The edge of a square that is much larger than the frame; the border, where the transform wraps, is cut."""
    angle, place = np.radians(rng.uniform(4, 9)), rng.uniform(-1, 1)
    pattern = edges.transform(edges.square(angle, 4000.0, tile, (0.0, 2000.0 + place)))
    seen = edges.expose(pattern, edges.gaussian_otf((1.0, sigma, sigma)), tile)
    rim = (tile - keep) // 2
    seen = (0.15 + 0.6 * seen)[rim:-rim, rim:-rim]
    seen = seen.T if rng.random() < 0.5 else seen
    light = electrons * seen * shares(cfa, seen.shape)
    return frames([expose(rng, light) for _ in range(count)], cfa, "edge")


@each_mosaic
def test_sharpness(name):
    cfa = MOSAICS[name]
    for seed in range(TRIALS):
        rng = np.random.default_rng([seed, 8])
        sigma = rng.uniform(0.45, 0.9)
        own = gaussian_lens(camera(cfa), math.hypot(sigma, edges.SOFT))
        soft = sigma_of(0.95 * edge_mtf50(sigma))
        for blur, state in ((sigma, "agrees"), (soft, "differs")):
            found = gs.compare(own, edges=edge_frames(rng, blur, cfa), seed=seed, device="opencl:0")
            print(name, seed, state, *found.lines())
            assert found.state == state, found.lines()


def chart_frames(rng, curves, light, cfa, size, count=4, electrons=6000):
    """A chart that fills the frame: patches of one unit, gaps of 0.15, a frame of 0.3 on neutral grey."""
    cols, rows = size
    unit = min(cols / 8.15, rows / 5.85)
    patch, gap, rim = int(unit), max(1, round(0.15 * unit)), max(1, round(0.3 * unit))
    width, height = 6 * patch + 5 * gap, 4 * patch + 3 * gap
    left, top = (cols - width) // 2, (rows - height) // 2
    number, scale = np.full((rows, cols), 21), np.ones((rows, cols))
    whole = np.s_[top - rim : top + height + rim, left - rim : left + width + rim]
    number[whole], scale[whole] = 23, 0.5
    for k in range(24):
        y, x = top + k // 6 * (patch + gap), left + k % 6 * (patch + gap)
        number[y : y + patch, x : x + patch], scale[y : y + patch, x : x + patch] = k, 1
    channel = tiled(
        np.array([["RGB".index(letter) for letter in row] for row in cfa]), (rows, cols)
    )
    seen = charts.responses(curves, light, charts.checker())[number, channel] * scale * electrons
    return frames([expose(rng, seen) for _ in range(count)], cfa, "chart")


@each_colour_mosaic
@pytest.mark.parametrize("light", ["D65", "A"])
def test_colours(name, light):
    cfa = MOSAICS[name]
    for seed in range(TRIALS):
        rng = np.random.default_rng([seed, 10])
        curves = charts.random_camera(rng)
        table = {
            letter: (one / curves.max()).tolist() for letter, one in zip("RGB", curves, strict=True)
        }
        table["wavelengths_nm"] = charts.WAVES.tolist()
        own = camera(cfa, sensitivity=table, sensitivity_peak=0.6)
        cut = curves / (1 + np.exp((charts.WAVES - 640) / 8))
        for seen, state in (
            (curves, "agrees"),
            (cut, "differs"),
            (charts.random_camera(rng), "differs"),
        ):
            shot = chart_frames(rng, seen, {"A": "2856K"}.get(light, light), cfa, (244, 176))
            found = gs.compare(own, charts=shot, light=light, seed=seed, device="opencl:0")
            print(name, light, seed, state, *found.lines())
            assert found.state == state, found.lines()


@each_mosaic
def test_shading(name):
    """The fall-off is fitted to other frames of the lens: round ones and maps."""
    cfa = MOSAICS[name]
    for seed in range(TRIALS):
        rng = np.random.default_rng([seed, 11])
        shape = int(rng.integers(380, 460)), int(rng.integers(500, 620))
        truth = flats.falloff(rng, shape, seed % 2 == 0)
        y, x = (np.linspace(-1, 1, size) for size in shape)
        aspect = shape[1] / shape[0]
        height2 = (y[:, None] ** 2 + (aspect * x) ** 2) / (1 + aspect**2)

        def shoot(response, part, rng=rng, shape=shape):
            seen = response * shares(cfa, shape)
            return frames([flats.expose_flat(rng, seen) for _ in range(4)], cfa, f"shading {part}")

        settings = fit_shading(shoot(truth, "fit")).settings
        own = camera(cfa, **{key: one for keys in settings.values() for key, one in keys.items()})
        for response, state in ((truth, "agrees"), (truth * (1 - 0.03 * height2), "differs")):
            found = gs.compare(own, shadings=shoot(response, state), seed=seed, device="opencl:0")
            print(name, seed, state, *found.lines())
            assert found.state == state, found.lines()

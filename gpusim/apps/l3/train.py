"""Training of learned filters on simulated frames of the very camera (`gpusim train-l3`)."""

import dataclasses
import datetime
import json
from collections.abc import Iterator
from math import ceil, log

import numpy as np

from gpusim import __version__
from gpusim.apps.l3.fit import NormalEquations
from gpusim.apps.l3.layout import layout
from gpusim.apps.l3.scenes import training_scenes
from gpusim.backends import open_device
from gpusim.color.color import color_matrix
from gpusim.color.rendering import efficiency
from gpusim.data.charts import chart
from gpusim.data.colorimetry import cmf
from gpusim.data.lights import illuminant
from gpusim.data.weights import product_weights
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.learned import XYZ, Code, FilterTable, Layout
from gpusim.domain.processor import ROOT_POLYNOMIALS
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.scene import Scene
from gpusim.measure.ideal import pixel_sums
from gpusim.pipeline.developer import Developer
from gpusim.pipeline.simulator import Simulator

OUTPUTS = ("channels", "xyz")
GENERATED = 30  # scenes
STEPS = 8  # strengths of light for every scene
WINDOW = 192  # [pixel] of larger scenes, at another place for each strength
SMALLEST = 32  # [pixel] scene along a side
TIME = 0.01  # [s] of cameras that expose automatically; it matters only for dark current
DARKEST = 10.0  # white over the noise of a dark pixel in the weakest light; and least electrons
# Code levels, relative to white, above which channels saturate one after the other; below them
# filters change slowly.
BRIGHT_LEVELS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0)
LEVEL_STEP = 3.2  # between dark levels
RIDGE = 3e-5
# Mean contrast between the strengths, relative to white: of clean pictures, and as multiples of the
# code's noise for Hamilton & Adams' colour differences, weights of norm sqrt(3/4). Flat fields have
# 0.7 of it: the first classes are narrow, to distinguish flat areas from faint texture.
CLEAN = np.array((0.3, 0.91, 2.33, 5.16, 10.8, 22.1)) / 255
NOISY = np.array((0.8, 0.95, 1.23, 1.6, 2.5, 4.5))


def train(
    camera: Camera,
    scenes=(),
    *,
    light: str = "D65",
    luminances=None,
    generated: int = GENERATED,
    outputs: str = "channels",
    seed: int = 0,
    device="auto",
    progress=iter,
) -> FilterTable:
    """Return filters for the camera's mosaic, noise and blur, learned from simulated frames.

    Args:
        camera: Camera that the filters are for.
        scenes: Scenes to train on in addition to the generated ones, each in its own light.
        light: Light on the generated scenes, for which colours are right.
        luminances: Luminance of white [cd m-2], a pair (lowest, highest) or a longer list, at the
            camera's exposure time. None: from white at `DARKEST` times the noise to saturation of
            every channel.
        generated: Number of scenes of `training_scenes`.
        outputs: "channels": red, green and blue of the camera (or its first three) without noise and
            blur, as if it were colorimetric: the colour matrix of `processor.color` takes them to true
            XYZ. "xyz": XYZ without a matrix. Filters work on square roots, whose mixtures are not the
            roots of mixtures: channels are more accurate if filters overlap much.
        seed: Seed of the generated scenes and of the noise.
        device: Name of the device, or a Device.
        progress: Function around the iteration over frames, for example tqdm.

    Raises:
        BadData: If the training set is singular, or a light is unknown.
        OutOfRange, UnknownName: If an argument is wrong.

    Source:
        Farrell & Wandell, section 7 and Figure 13; Tian, Lansel, Farrell & Wandell 2014, Proc. SPIE
        9023, 90230K.
    """
    if outputs not in OUTPUTS:
        raise UnknownName("outputs", outputs, OUTPUTS)
    sound = training_camera(camera)
    scenes = list(scenes)
    if generated:
        scenes = training_scenes(generated, light=light, seed=seed) + scenes
    _check_scenes(scenes)
    letters, matrix = (
        colorimetric_channels(sound, light) if outputs == "channels" else (XYZ, np.eye(3))
    )
    code = frame_code(sound)
    lowest, highest, strengths = _strengths(sound, light, luminances, len(scenes), seed)
    chosen = training_layout(sound.sensor.cfa, letters, code, lowest)
    equations = NormalEquations(chosen, constant=True)
    reach = int(abs(chosen.taps).max())
    pairs = simulate_pairs(sound, scenes, strengths, letters, matrix, seed=seed, device=device)
    for pair in progress(pairs):
        equations.add(pair.raw, pair.wanted, code, border=reach)
    optics, sensor = camera.optics, camera.sensor
    time = sensor.exposure_time
    made = [f"{generated} generated"] if generated else []
    made += [scene.name for scene in scenes[generated:]]
    provenance = {
        "program": f"gpusim {__version__}",
        "date": f"{datetime.date.today()}",
        "camera": camera.name,
        "f_number": optics.f_number,
        "pixel_pitch_um": round(sensor.pixel_pitch * 1e6, 6),
        "exposure_time_ms": None if time is None else round(time * 1e3, 6),
        "saturation_e": round(sensor.saturation, 1),
        "read_noise_e": round(sensor.read_sigma, 3),
        "light": light,
        "target": camera.processor.target,
        "outputs": "".join(letters),
        "white_over_saturation": [float(f"{strength:.3g}") for strength in (lowest, highest)],
        "scenes": made,
        "seed": seed,
        "frames": strengths.size,
    }
    return equations.solve(RIDGE, provenance=json.dumps(provenance))


@dataclasses.dataclass(frozen=True, eq=False)
class Pair:
    """A simulated frame and the ideal output of filters.

    raw: (rows, cols) [DN]. wanted: (3, rows, cols), 1 = white level. white: level of a perfect
    diffuser in the most sensitive output (XYZ: the Y of white is the level of the best channel), 1
    = white level.
    """

    raw: np.ndarray
    wanted: np.ndarray
    white: float


def simulate_pairs(
    camera: Camera, scenes, strengths, letters, matrix, *, seed: int = 0, device="auto"
) -> Iterator[Pair]:
    """Yield every scene at every strength of light, each with independent noise.

    camera: see `training_camera`. strengths: (scenes, steps), strength of the light: electrons of
    white in the most sensitive channel over the electrons of saturation. letters, matrix: outputs,
    and their matrix from XYZ.
    """
    sensor = camera.sensor
    simulator = Simulator(camera, device=device)
    time = sensor.exposure_time or TIME
    random = np.random.default_rng((seed, 1))
    steps = strengths.shape[1]
    for number, scene in enumerate(scenes):
        wanted = np.tensordot(matrix, ideal_colors(scene, camera.processor.target), 1)
        exposure = simulator.expose(scene, time)
        electrons = np.asarray(simulator.device.numpy(exposure.mean), np.float64)
        rates = exposure.plan.white_rate
        assert rates is not None  # the light is known
        shown = [sensor.channels.index(letter) for letter in letters if letter in sensor.channels]
        best = rates[shown].max() if len(shown) == 3 else rates.max()
        for step, strength in enumerate(strengths[number]):
            brighter = strength * sensor.saturation / (rates.max() * time)
            part = _window(scene.shape, sensor.cfa_indices.shape, random)
            raw = simulator.readout.draw_electrons(
                electrons[part] * brighter, time, seed=seed, first=number * steps + step
            )
            span = sensor.white_level - sensor.dark_level
            white = brighter * best * time * sensor.gain_dn_per_electron / span
            yield Pair(raw, wanted[:, *part] * white, white)


def ideal_colors(scene: Scene, target: str = "D65") -> np.ndarray:
    """Return CIE XYZ of every pixel of a scene lit by `target`, white Y = 1; shape (3, rows, cols).

    A pixel is the mean over its square of the scene as it is in front of the lens: filters sharpen
    as far as noise allows. Raises BadData if the scene's reflectances are not known separately from
    its light.
    """
    if not scene.light_is_known:
        raise BadData(
            f"{scene.name}: radiance in an unknown light, which cannot be replaced; wanted "
            "reflectances and their light, as charts and photographs have them"
        )
    weights = product_weights(scene.wavelengths, cmf(), illuminant(target))
    return pixel_sums(scene, weights / weights.sum(axis=1)[1])


def training_camera(camera: Camera) -> Camera:
    """Return the camera as filters see it: on the axis, without defects, the grid centred.

    Distortion and fall-off are not local, and other stages correct them and defects. Raises
    OutOfRange for a camera without a mosaic of three channels, and for binned sensors.
    """
    optics, sensor = camera.optics, camera.sensor
    if sensor.stacked or len(sensor.channels) < 3:
        kind = "stacked pixels" if sensor.stacked else f"{len(sensor.channels)} channel(s)"
        allowed = "a mosaic of 3 channels or more: others have nothing to demosaic"
        raise OutOfRange("camera to train filters for", f"{camera.name}, {kind}", allowed)
    if sensor.binning != (1, 1):
        allowed = "(1, 1): train for a camera of pixels as large as the binned ones"
        raise OutOfRange("sensor.binning", sensor.binning, allowed)
    optics = dataclasses.replace(optics, distortion=None, relative_illumination="none")
    noise = dataclasses.replace(sensor.noise, hot_pixels=0.0, dead_pixels=0.0)
    sensor = dataclasses.replace(
        sensor, offset=(0.0, 0.0), microlens=None, vignetting=None, noise=noise
    )
    processor = dataclasses.replace(camera.processor, demosaic="bilinear", table=None)
    return dataclasses.replace(camera, optics=optics, sensor=sensor, processor=processor)


def frame_code(camera: Camera) -> Code:
    """Return the code of the camera's digital numbers for its filters, as in use."""
    sensor = camera.sensor
    noise = Developer(camera, open_device("numpy")).noise
    scale = 1 / (sensor.white_level - sensor.dark_level)
    return Code("root", sensor.dark_level, scale, noise if noise[0] else (0, 0))


def colorimetric_channels(camera: Camera, light: str) -> tuple[tuple[str, ...], np.ndarray]:
    """Return letters of three channels, and the matrix (3, 3) from XYZ in the target light to them.

    Red, green and blue if there are, else the first three. The matrix is the inverse of the matrix
    from them to XYZ as `processor.color` says, so white is 1 in the most sensitive channel.
    """
    sensor, processor = camera.sensor, camera.processor
    letters = tuple("RGB") if {*"RGB"} <= {*sensor.channels} else sensor.channels[:3]
    if processor.color in ROOT_POLYNOMIALS:
        raise OutOfRange(
            "processor.color",
            f'"{processor.color}"',
            'a linear method such as "white-preserving", for training filters',
        )
    method = "white-preserving" if processor.color == "none" else processor.color
    transform = color_matrix(
        efficiency(camera, letters),
        light,
        processor.training,
        method=method,
        target_light=processor.target,
        channels=letters,
    )
    return letters, np.linalg.inv(transform.xyz)


def training_layout(mosaic, outputs, code: Code, lowest: float) -> Layout:
    """Return the layout of a mosaic's filters, with their levels of light.

    lowest: white over saturation in the weakest light. Larger periods have filters for more
    positions, and fewer samples for each: fewer taps and classes then.
    """
    positions = len(mosaic) * len(mosaic[0])
    dark = 0.03 * lowest
    steps = max(1, ceil(log(BRIGHT_LEVELS[0] / dark) / log(LEVEL_STEP)))
    levels = np.append(np.geomspace(dark, BRIGHT_LEVELS[0], steps + 1)[:-1], BRIGHT_LEVELS)
    codes = code.encode(levels / code.scale) / code.white
    radius = 6 if positions <= 4 else 4
    made = layout(mosaic, outputs, code.domain, (code.sigma,), codes, radius=radius)
    ratios = np.array((12, 24) if positions <= 16 else (16,))
    weights = made.contrast[0] / (abs(made.contrast[0]).sum() / 2)
    strengths = np.hypot(CLEAN, NOISY * np.linalg.norm(weights) / np.sqrt(0.75) * code.sigma)[None]
    return dataclasses.replace(
        made,
        ratios=ratios,
        detail=None,
        shares=np.zeros(0, np.int32),
        strengths=strengths,
        floor=np.array([0.5 / 255]),
    )


def _strengths(camera, light, luminances, scenes, seed):
    """Lowest, highest, and strengths of light (scenes, steps) as `simulate_pairs` wants them."""
    sensor, time = camera.sensor, camera.sensor.exposure_time
    # electrons per second of white at 1 cd m-2
    white = chart("flat", size=(8, 8), light=light, luminance=1.0, reflectance=1.0)
    rates = Simulator(camera, device="numpy").plan(white).white_rate
    assert rates is not None
    if luminances is None:
        lowest = DARKEST * max(RawNoise.of(sensor).variance() ** 0.5, 1.0) / sensor.saturation
        highest = max(rates.max() / rates.min(), 2 * lowest)
    else:
        values = np.atleast_1d(np.asarray(luminances, np.float64))
        if values.ndim != 1 or not (np.isfinite(values) & (values > 0)).all():
            raise OutOfRange("luminances", luminances, "positive numbers [cd m-2]")
        if time is None:
            raise OutOfRange(
                "luminances of a camera that exposes automatically",
                luminances,
                "none, or a camera file with exposure_time_ms",
            )
        each = rates.max() * time * values / sensor.saturation
        lowest, highest = each.min(), each.max()
        if len(each) != 2:
            return lowest, highest, np.tile(each, (scenes, 1))
    # Anywhere in each step: all scenes together meet every level.
    places = (np.arange(STEPS) + np.random.default_rng((seed, 2)).random((scenes, STEPS))) / STEPS
    return lowest, highest, lowest * (highest / lowest) ** places


def _window(shape, period, random):
    """A part of a frame that is no larger than WINDOW and begins as the mosaic does."""
    starts = [
        step * random.integers(max(n - WINDOW, 0) // step + 1)
        for n, step in zip(shape, period, strict=True)
    ]
    return tuple(slice(start, start + WINDOW) for start in starts)


def _check_scenes(scenes):
    if not scenes:
        raise BadData("training: no scenes; wanted some, or generated ones")
    for scene in scenes:
        if min(scene.shape) < SMALLEST:
            raise OutOfRange(
                f"size of training scene {scene.name}",
                f"{scene.shape[1]}x{scene.shape[0]} pixels",
                f"at least {SMALLEST}x{SMALLEST}",
            )
        if not scene.light_is_known:
            ideal_colors(scene)  # says why not

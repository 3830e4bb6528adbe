"""Random questions to the planner: scene, camera and tolerance for every seed.

They are equal on every machine. The seeds are two halves, fixed before any tuning: `DEVELOPMENT` is
used to find errors, `HELD_OUT` only for the verdict. Seeds 1000 .. 1159, and 160 each from 2000,
3000 and so on up to 9000, were held out until some of them had been used. Scenes are small enough
for the float64 reference.
"""

from dataclasses import dataclass, replace
from functools import cache
from math import ceil
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

import gpusim as gs
from gpusim.data.lights import white_radiance
from gpusim.domain.mosaics import mosaic
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.io.scene.photo import open_photo

DEVELOPMENT, HELD_OUT = range(160), range(500, 660)
KINDS = {
    "photo": 0.22,
    "cube": 0.14,
    "chart": 0.22,
    "spectra": 0.24,
    "hdr": 0.18,
}  # name -> how often
BORDERS = {"zero": 0.2, "edge": 0.35, "reflect": 0.2, "scene": 0.25}
LENSES = {
    "ideal": 0.3,
    "defocus": 0.14,
    "axial": 0.06,
    "spherical": 0.1,
    "blades": 0.12,
    "obscured": 0.1,
    "low-pass": 0.06,
    "field": 0.12,
}
SENSORS = {"phone": 0.35, "machine-vision": 0.25, "figure8": 0.2, "mono": 0.2}
TOLERANCES = ("1e-1", "1e-2", "1e-3", "3e-4", "1e-4", "1e-5", "preview", "video", "metrology")
LIGHTS = ("D65", "A", "FL11", "FL2", "LED-B1", "LED-RGB1", "daylight-5000K")
CHARTS = ("colorchecker", "slanted-edge", "ramp", "points", "deadleaves", "sweep", "flat")
MOSAICS = ("GRBG", "BGGR", "GBRG", "x-trans", "quad-bayer")
RATIOS = (1.0, 1.0, 1.0, 1.5, 2.0, 3.0, 1.25)  # samples per pixel
LOW_Q, HIGH_Q = 0.25, 6.0  # of a pixel at GREEN
LOW_FIELD_Q = (
    0.8  # if the blur varies over the field: smaller values take a quarter of an hour to judge
)
GREEN = 550e-9
SHORTEST, LONGEST, MOST_SAMPLES = 64, 256, 320  # sides of a frame [pixel] and of a scene [sample]
WAVELENGTHS = np.arange(400.0, 701.0, 10.0)


@dataclass(frozen=True, eq=False)
class Triple:
    """A question to the planner: `scene` by `camera`, to within `tolerance`.

    kind, border, lens: of KINDS, BORDERS and LENSES. words: the whole question in one line.
    features: its combination. is_near: whether to move the tolerance to the limit of the
    prediction.
    """

    seed: int
    scene: gs.Scene
    camera: gs.Camera
    tolerance: str
    kind: str
    border: str
    lens: str
    words: str
    features: tuple[str, ...] = ()
    is_near: bool = False


def triple(seed: int, data: Path | None = None) -> Triple | None:
    """Return the question of a seed; None if its measured data is missing.

    data: folder with `kodak` and `mcm` (photographs), `cubes` and `isetcam` (spectral scenes).
    """
    random = np.random.default_rng((seed, 20))
    kind, border, lens, base = (
        _one_of(random, names) for names in (KINDS, BORDERS, LENSES, SENSORS)
    )
    tolerance = TOLERANCES[random.integers(len(TOLERANCES))]
    ratio = 1.0 if lens == "field" else RATIOS[random.integers(len(RATIOS))]
    low = LOW_FIELD_Q if lens == "field" else LOW_Q
    q = low * (HIGH_Q / low) ** random.random()
    size = SHORTEST * (min(LONGEST, MOST_SAMPLES / ratio) / SHORTEST) ** random.random(2)
    shape = tuple(int(side) for side in size)  # of the frame, [pixel]
    margin = int(random.integers(3, 33)) if border == "scene" else 0
    camera, about = _camera(random, base, lens, q)
    light = replace(gs.illuminant(LIGHTS[random.integers(len(LIGHTS))]), quantity="")
    luminance = float(10 ** random.uniform(0, 3.5))
    samples = tuple(ceil(n * ratio) + 2 * margin for n in shape)
    made = DRAWN[kind](random, samples, ratio, data)
    if made is None:
        return None
    content, name = made
    scene = gs.Scene(
        content,
        white_radiance(light, luminance),
        border,
        margin,
        name=name,
        samples_per_pixel=ratio,
    )
    words = (
        f"{seed}: {name} as {content.form} {scene.shape[1]}x{scene.shape[0]} x{ratio:g} border {border}"
        f"{f' {margin}' if margin else ''}, {light.name} {luminance:.3g} cd/m2; {about}; tolerance {tolerance}"
    )
    return Triple(seed, scene, camera, tolerance, kind, border, lens, words)


def _one_of(random, names):
    """Return a name, drawn with its frequency."""
    return str(random.choice(list(names), p=np.array(list(names.values())) / sum(names.values())))


def _camera(random, base, lens, q):
    """Return a camera with this kind of lens and q at GREEN, and its description."""
    own = gs.open_camera(base)
    f_number = q * own.sensor.pixel_pitch / GREEN
    optics, said = _optics(random, lens, f_number, own)
    sensor, processor = own.sensor, own.processor
    if base != "mono" and random.random() < 0.3:
        name = MOSAICS[random.integers(len(MOSAICS))]
        cfa = mosaic(name) if name in MOSAICS[3:] else (name[:2], name[2:])
        sensor, processor = replace(sensor, cfa=cfa), replace(processor, demosaic="bilinear")
    fill = 1.0 if random.random() < 0.6 else float(random.uniform(0.25, 0.95))
    seconds = None if random.random() < 0.6 else float(10 ** random.uniform(-3, -1))
    stacked = base != "mono" and lens != "field" and random.random() < 0.08
    sensor = replace(sensor, fill_factor=fill, exposure_time=seconds, stacked=stacked)
    about = (
        f"{base} {'stacked' if stacked else '/'.join(sensor.cfa)} fill {fill:.2g} q {q:.3g} {lens} {said}, "
        f"{'auto' if seconds is None else f'{1e3 * seconds:.3g} ms'}"
    )
    return replace(own, optics=optics, sensor=sensor, processor=processor), about


def _optics(random, lens, f_number, own):
    """Return the lens, and its figures as text."""
    made = gs.Optics(
        f_number,
        own.optics.focal_length,
        relative_illumination="none" if random.random() < 0.3 else "cos4",
    )
    wave = 8 * f_number**2 * GREEN  # of defocus at the rim [m of the sensor]
    limit = 0.3 * own.optics.focal_length
    waves = float(random.choice((-1, 1)) * 0.1 * 30 ** random.random())
    if lens == "defocus":
        return replace(
            made, defocus=float(np.clip(waves * wave, -limit, limit))
        ), f"{waves:.2g} waves"
    if lens == "axial":
        low, high = np.clip(np.array([-abs(waves), waves / 2]) * wave, -limit, limit)
        return replace(
            made, defocus=gs.Spectrum(np.array([420.0, 680.0]), np.array([low, high]))
        ), f"{waves:.2g} waves"
    if lens == "spherical":
        seidel = (waves, 0.0, 0.0, 0.0, 0.0)
        return replace(made, wavefront=Wavefront(seidel=seidel)), f"{waves:.2g} waves"
    if lens == "blades":
        blades, turned = int(random.integers(5, 10)), float(random.uniform(0, np.pi))
        return replace(made, pupil=Pupil(blades, rotation=turned)), f"{blades} turned {turned:.2g}"
    if lens == "obscured":
        hole = float(random.uniform(0.1, 0.6))
        return replace(made, pupil=Pupil(0, hole)), f"{hole:.2g}"
    if lens == "low-pass":
        apart = float(random.uniform(0.3, 1.2) * own.sensor.pixel_pitch)
        diffuser = (
            float(random.uniform(0, 0.4) * own.sensor.pixel_pitch) if random.random() < 0.5 else 0.0
        )
        return replace(
            made, birefringence=(apart, apart), diffuser=diffuser
        ), f"{1e6 * apart:.2g} um"
    if lens == "field":
        seidel = (0.0, *(float(value) for value in random.uniform(-1.5, 1.5, 3)), 0.0)
        colour = gs.Spectrum(np.array([450.0, 650.0]), random.uniform(-2e-3, 2e-3, 2))
        lateral = colour if random.random() < 0.3 else 0.0
        said = " ".join(f"{value:.2g}" for value in seidel[1:4])
        return replace(made, wavefront=Wavefront(seidel=seidel), lateral_color=lateral), said
    return made, ""


def _window(random, content, samples):
    """Return a part of a content in the wanted size; a small one is mirrored."""
    at = [
        np.arange(n) + (random.integers(have - n + 1) if have >= n else 0)
        for n, have in zip(samples, content.shape, strict=True)
    ]
    at = [
        np.minimum(one % (2 * have), (-1 - one) % (2 * have))
        for one, have in zip(at, content.shape, strict=True)
    ]
    return content.take(*np.meshgrid(*at, indexing="ij"))


def _cube_of(content):
    """Return the same as samples of every band."""
    return gs.Cube(
        content.wavelengths, np.maximum(content.bands_at(slice(None)), 0).astype(np.float32)
    )


@cache
def _files(data: Path, pattern: str):
    return sorted(data.glob(pattern))


def _photo(random, samples, _ratio, data):
    """Return a part of a photograph: its codes, their basis, or a cube."""
    choice, form = random.random(), random.random()
    files = [] if data is None else _files(data, "kodak/*.png" if choice < 0.6 else "mcm/*.png")
    if not files:
        return None
    path = files[random.integers(len(files))]
    codes = open_photo(path).samples[..., :3]
    at = [
        random.integers(max(have - n, 0) + 1) for n, have in zip(samples, codes.shape, strict=False)
    ]
    codes = np.ascontiguousarray(codes[at[0] : at[0] + samples[0], at[1] : at[1] + samples[1]])
    content = gs.picture(codes).content
    if form >= 0.3:
        content = content.on_host() if form < 0.7 else _cube_of(content.on_host())
    return content, path.stem


def _cube(random, samples, _ratio, data):
    """Return a part of a spectral scene, as reflectances."""
    names = ("isetcam/scene_*.npz", "cubes/*.npz")
    files = [] if data is None else _files(data, names[int(random.random() < 0.4)])
    if not files:
        return None
    path = files[random.integers(len(files))]
    content = _window(random, _stored(path), samples)
    if content.form == "basis" and random.random() < 0.4:
        content = _cube_of(content)
    return content, path.stem


@cache
def _stored(path):
    content = gs.open_scene(path).content.on_host()
    return content.scale(1 / content.planes.max()) if content.is_spectral else content


def _chart(random, samples, ratio, _data):
    """Return a chart of known reflectances, with options."""
    name = CHARTS[random.integers(len(CHARTS))]
    options = {
        "slanted-edge": {
            "angle_deg": float(random.uniform(-45, 45)),
            "contrast": float(10 ** random.uniform(0.1, 3)),
        },
        "points": {
            "count": int(random.integers(1, 25)),
            "highest": float(10 ** random.uniform(2.1, 5)),
        },
        "ramp": {"low": float(random.uniform(0, 0.5))},
        "sweep": {"contrast": float(random.uniform(0.2, 1))},
        "deadleaves": {"smallest": float(random.uniform(2, 8)), "seed": int(random.integers(1000))},
    }
    return _charted(random, name, samples, ratio, options.get(name, {})), name


def _charted(random, name, samples, ratio, options):
    """Return the samples of a chart drawn in the necessary size."""
    rows, cols = (ceil(n / ratio) for n in samples)
    chart = gs.chart(name, size=(cols, rows), samples_per_pixel=ratio, **options)
    content = _window(random, chart.content, samples)
    return _cube_of(content) if random.random() < 0.3 else content


def _smooth(random, count):
    """Return reflectances (count, L) that vary over 20 to 150 nm, within 0.02 .. 0.98."""
    raw = gaussian_filter(
        random.normal(size=(count, len(WAVELENGTHS) + 40)), (0, random.uniform(2, 15))
    )[:, 20:-20]
    raw = raw / raw.std() * random.uniform(0.3, 2) + random.normal(0, 0.8, (count, 1))
    return 0.02 + 0.96 / (1 + np.exp(-raw))


def _texture(random, shape):
    """Return a plane of mean one, from fine to coarse structure."""
    width = random.uniform(0.3, 8)
    plane = gaussian_filter(random.normal(size=shape), width)
    return np.exp(plane / plane.std() * random.uniform(0.05, 0.8))


def _spectra(random, samples, _ratio, _data):
    """Return random spectra: of materials in regions, of a basis, or of every sample of a cube."""
    form, count = ("cube", "basis", "materials")[random.integers(3)], int(random.integers(2, 9))
    spectra = _smooth(random, count)
    if form == "materials":
        ids = np.stack([_texture(random, samples) for _ in range(count)]).argmax(axis=0)
        content = gs.Materials(
            WAVELENGTHS, ids.astype(np.uint8), _texture(random, samples).astype(np.float32), spectra
        )
    else:
        parts = np.stack([_texture(random, samples) for _ in range(count)])
        content = gs.Basis(WAVELENGTHS, (parts / count).astype(np.float32), spectra)
    return _cube_of(content) if form == "cube" else content, f"{count} spectra"


def _hdr(random, samples, ratio, _data):
    """Return ramps over decades, and points of 1e2 .. 1e5 times their surroundings."""
    if random.random() < 0.3:
        decades = float(random.uniform(2, 6))
        content = _charted(random, "ramp", samples, ratio, {"decades": decades, "high": 1.0})
        return content, f"ramp of {decades:.2g} decades"
    base, name = (
        _spectra(random, samples, ratio, None)
        if random.random() < 0.6
        else _chart(random, samples, ratio, None)
    )
    count, reach = int(random.integers(1, 30)), random.uniform(2, 5)
    places = tuple(random.integers(0, n, count) for n in samples)
    planes = base.planes.copy()
    planes[(..., *places)] *= 10 ** random.uniform(1.5, reach, count).astype(np.float32)
    return base.with_planes(planes), f"{name} with {count} points to 1e{reach:.2g}"


DRAWN = {"photo": _photo, "cube": _cube, "chart": _chart, "spectra": _spectra, "hdr": _hdr}

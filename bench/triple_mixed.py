"""Random questions that combine two or more features, for `bench/triples.py`.

Features are of scenes, lenses and sensors. The seeds MIXED and OLD were fixed before any of them
was asked. Frames are small, because independent sums judge them: `triple_outside.py`.
"""

from dataclasses import replace
from math import ceil

import numpy as np
import triple_scenes as old
from triple_scenes import Triple

import gpusim as gs
from gpusim.data.lights import white_radiance
from gpusim.domain.calibration import BrownConrady, Fisheye
from gpusim.domain.distortion import RadialPolynomial, RadialTable
from gpusim.domain.mosaics import mosaic
from gpusim.domain.pupil import Pupil, Wavefront

OLD, MIXED = range(33000, 33200), range(34000, 34200)
LENSES = {
    "ideal": 0.2,
    "defocus": 0.12,
    "axial": 0.06,
    "zernike": 0.08,
    "spherical": 0.06,
    "field": 0.07,
    "field zernike": 0.04,
    "lateral": 0.04,
    "measured": 0.08,
    "measured heights": 0.04,
    "measured grid": 0.03,
    "pupil": 0.14,
    "none": 0.04,
}
DISTORTIONS = {
    "": 0.6,
    "radial": 0.07,
    "table": 0.05,
    "brown": 0.06,
    "fisheye": 0.05,
    "calibration": 0.06,
    "calibration off": 0.07,
    "pinhole off": 0.04,
}
DEPTHS = {"": 0.72, "two": 0.1, "slope": 0.08, "layers": 0.1}
VIEWS = {"": 0.66, "whole": 0.08, "fraction": 0.1, "zoom": 0.08, "turn": 0.08}
MOSAICS = {
    "bayer": 0.34,
    "quad-bayer": 0.12,
    "nona-bayer": 0.1,
    "x-trans": 0.12,
    "rgbw": 0.12,
    "mono": 0.12,
    "stacked": 0.08,
}
BORDERS = {"zero": 0.25, "edge": 0.35, "reflect": 0.2, "scene": 0.2}
FORMS = {"cube": 0.3, "basis": 0.2, "materials": 0.2, "picture": 0.15, "illuminated": 0.15}
NODES = {"31": 0.3, "few": 0.35, "irregular": 0.2, "narrow": 0.12, "one": 0.03}
FRAMES = {"": 0.82, "tiny": 0.09, "strip": 0.09}
LIGHTS = ("D65", "A", "daylight-5000K", "FL2", "LED-B1")
FOCUS = 2.0  # [m]
WAVES = 550e-9


class Blobs(gs.PointSpread):
    """Point spreads that are mixtures of Gaussians, known independently of their samples.

    mixtures: at each height, or each place of the grid in order, tuples (weight, y, x, sigma) [m].
    """

    mixtures: tuple = ()

    @classmethod
    def of(cls, pitch, mixtures, heights=None, grid=None):
        """Return the mixtures, sampled four times a pixel or finer, over their whole extent."""
        least = min(sigma for blobs in mixtures for *_, sigma in blobs)
        spacing, far = (
            min(pitch / 4, least / 2.5),
            max(np.hypot(y, x) + 5 * sigma for blobs in mixtures for _, y, x, sigma in blobs),
        )
        half = ceil(far / spacing)
        at = spacing * np.arange(-half, half + 1)
        values = np.stack(
            [
                sum(
                    weight
                    / sigma**2
                    * np.exp(-((at[:, None] - y) ** 2 + (at - x) ** 2) / (2 * sigma**2))
                    for weight, y, x, sigma in blobs
                )
                for blobs in mixtures
            ]
        )
        values = np.repeat(values[:, None], 2, axis=1)  # at two wavelengths, the same
        if grid is not None:
            values = values.reshape(*map(len, grid), *values.shape[1:])
        made = cls(
            np.array([380.0, 780.0]),
            values if heights is not None or grid is not None else values[0],
            spacing,
            heights=heights,
            grid=grid,
        )
        object.__setattr__(made, "mixtures", tuple(mixtures))
        object.__setattr__(made, "radius", far)
        return made

    def blobs(self, _wavelength, y, x):
        """Return the Gaussians (weight, y, x, sigma) [m] at a field point."""
        if self.heights is None and self.grid is None:
            return list(self.mixtures[0])
        if self.grid is not None:
            shares = [
                np.interp(place, axis, np.eye(len(axis))[k])
                for place, axis in zip((y, x), self.grid, strict=True)
                for k in range(len(axis))
            ]
            down, across = shares[: len(self.grid[0])], shares[len(self.grid[0]) :]
            return [
                (a * b * weight, *more)
                for blobs, (a, b) in zip(
                    self.mixtures, [(a, b) for a in down for b in across], strict=True
                )
                for weight, *more in blobs
            ]
        height, angle = np.hypot(y, x), np.arctan2(y, x)
        cos, sin, found = np.cos(angle), np.sin(angle), []
        for k, blobs in enumerate(self.mixtures):
            share = float(np.interp(height, self.heights, np.eye(len(self.heights))[k]))
            found += [
                (share * weight, cos * v + sin * u, cos * u - sin * v, sigma)
                for weight, v, u, sigma in blobs
                if share
            ]
        return found


def triple(seed: int) -> Triple:
    """Return the question of a seed; drawn again until it combines two features."""
    for attempt in range(100):
        made = _drawn(seed, np.random.default_rng((seed, 21, attempt)))
        if len(made.features) >= 2:
            break
    return made


def _drawn(seed, random):
    kind = {
        name: old._one_of(random, table)
        for name, table in (
            ("lens", LENSES),
            ("distortion", DISTORTIONS),
            ("depth", DEPTHS),
            ("view", VIEWS),
            ("mosaic", MOSAICS),
            ("border", BORDERS),
            ("form", FORMS),
            ("nodes", NODES),
            ("frame", FRAMES),
        )
    }
    if kind["depth"]:
        kind["view"] = ""
    if kind["lens"].startswith(("field", "measured", "lateral")) and kind["nodes"] == "31":
        kind["nodes"] = "few"  # sums over wavelengths and places take long
    shape = _frame(random, kind["frame"])
    ratio = float(random.choice((1, 1, 1, 1, 2, 2, 4))) if max(shape) <= 64 else 1.0
    q = (
        0.5 if kind["lens"] in ("ideal", "defocus", "pupil", "zernike") else 1.0
    ) * 5 ** random.random()
    if ratio > 1 and q * ratio * 0.7 < 2 and random.random() < 0.8:
        q = 3 / ratio
    margin = int(random.integers(4, 13)) if kind["border"] == "scene" else 0
    samples = tuple(int(n * ratio) + 2 * margin for n in shape)
    content, said = _content(random, kind, samples)
    light, luminance = (
        replace(gs.illuminant(LIGHTS[random.integers(len(LIGHTS))]), quantity=""),
        float(10 ** random.uniform(0.5, 3.5)),
    )
    camera, features = _camera(random, kind, q, shape, ratio)
    depth, layers = _depth(random, kind["depth"], content, camera, ratio)
    view = _view(random, kind["view"])
    fov = float(random.uniform(0.2, 0.9)) if random.random() < 0.15 else None
    scene = gs.Scene(
        content,
        white_radiance(light, luminance),
        kind["border"],
        margin,
        fov=fov,
        depth=depth,
        name="mixed",
        samples_per_pixel=ratio,
        layers=layers,
        view=view,
    )
    features += [
        name
        for name in (
            f"depth {kind['depth']}" if kind["depth"] else "",
            said,
            f"view {kind['view']}" if kind["view"] else "",
            kind["frame"],
            f"border {kind['border']}" if kind["border"] != "edge" else "",
            "fov" if fov else "",
            f"{ratio:g} samples" if ratio > 1 else "",
            kind["form"] if kind["form"] != "cube" else "",
            f"nodes {kind['nodes']}" if kind["nodes"] != "31" else "",
        )
        if name
    ]
    tolerance, near = _tolerance(random)
    words = (
        f"{seed}: {scene.shape[1]}x{scene.shape[0]} q {q:.2g} f/{camera.optics.f_number:.3g} "
        f"{'; '.join(features)}; {light.name} {luminance:.3g} cd/m2; tolerance {tolerance}{' near' * near}"
    )
    return Triple(
        seed,
        scene,
        camera,
        tolerance,
        "mixed",
        kind["border"],
        kind["lens"],
        words,
        tuple(features),
        near,
    )


def _frame(random, kind):
    if kind == "tiny":
        return tuple(int(n) for n in random.integers(4, 13, 2))
    if kind == "strip":
        sides = int(random.integers(4, 14)), int(random.integers(64, 161))
        return sides if random.random() < 0.5 else sides[::-1]
    return tuple(int(n) for n in random.integers(40, 81, 2))


def _tolerance(random):
    """Return a tolerance, and whether to move it to the limit of the prediction."""
    choice = random.random()
    if choice < 0.3:
        return str(random.choice(("preview", "video", "metrology"))), False
    return f"{10 ** random.uniform(-4.7, -1):.2g}", choice > 0.8


def _wavelengths(random, kind):
    if kind == "31":
        return old.WAVELENGTHS
    if kind == "few":
        return np.linspace(400.0, 700.0, int(random.integers(4, 8)))
    if kind == "narrow":
        return np.linspace(
            *[(420.0, 560.0), (500.0, 660.0)][random.integers(2)], int(random.integers(4, 9))
        )
    if kind == "one":
        return np.array([float(random.integers(450, 650))])
    inner = np.sort(random.choice(np.arange(410.0, 691.0, 10.0), 5, replace=False))
    return np.array([400.0, *inner, 700.0])


def _content(random, kind, samples):
    """Return planes of random spectra, with edges, bright points or stars in the dark."""
    nodes = _wavelengths(random, kind["nodes"])
    count = int(random.integers(2, 6))
    spectra = np.array(
        [np.interp(nodes, old.WAVELENGTHS, one) for one in old._smooth(random, count)]
    )
    parts = np.nan_to_num(np.stack([old._texture(random, samples) for _ in range(count)]), nan=1.0)
    said = ""
    if random.random() < 0.35:  # edges
        y, x = np.indices(samples)
        slanted = np.cos(random.uniform(0, np.pi)) * (y - samples[0] / 2) + np.sin(
            random.uniform(0, 3)
        ) * (x - samples[1] / 2)
        parts[0] *= np.where(slanted > 0, 1.0, 10 ** random.uniform(-3, -0.3))
        said = "edge"
    choice = random.random()
    if choice < 0.25:
        number, reach = int(random.integers(1, 12)), random.uniform(1.5, 5)
        if choice < 0.08:
            parts *= 10.0 ** random.uniform(-7, -3)
            said, reach = "stars", 0.5
            parts[
                :,
                random.integers(samples[0], size=number),
                random.integers(samples[1], size=number),
            ] = 1.0
        places = random.integers(samples[0], size=number), random.integers(samples[1], size=number)
        parts[(slice(None), *places)] *= 10 ** random.uniform(0, reach)
        said = said or f"highlights 1e{reach:.2g}"
    parts /= count
    planes, form = parts.astype(np.float32), kind["form"]
    if form == "basis":
        return gs.Basis(nodes, planes, spectra), said
    if form == "materials":
        ids = parts.argmax(axis=0)
        return gs.Materials(nodes, ids.astype(np.uint8), planes.max(axis=0), spectra), said
    if form == "illuminated":
        maps = np.stack([old._texture(random, samples) for _ in range(2)]).astype(np.float32)
        return gs.Illuminated(
            nodes,
            maps,
            planes,
            spectra,
            0.2
            + 0.8
            * np.array([np.interp(nodes, old.WAVELENGTHS, one) for one in old._smooth(random, 2)]),
        ), said
    if form == "picture" and len(nodes) > 1:
        codes = np.clip(255 * np.moveaxis(parts[:3] * count / 2, 0, -1), 0, 255).astype(np.uint8)
        codes = codes if codes.shape[2] == 3 else codes[..., [0, 1, 1]]
        curve = (np.arange(256) / 255.0) ** 2.2
        basis = np.array([np.interp(nodes, old.WAVELENGTHS, one) for one in old._smooth(random, 3)])
        return gs.Picture(nodes, np.ascontiguousarray(codes), basis, curve.astype(np.float32)), said
    return gs.Cube(nodes, np.tensordot(spectra.T, parts, 1).astype(np.float32)), said


def _camera(random, kind, q, shape, ratio):
    """Return the camera, and its features as text."""
    own = gs.open_camera(
        "mono"
        if kind["mosaic"] == "mono"
        else ("phone", "machine-vision", "figure8")[random.integers(3)]
    )
    f_number = q * own.sensor.pixel_pitch / WAVES
    sensor, processor, features = own.sensor, own.processor, []
    if kind["mosaic"] not in ("bayer", "mono"):
        features.append(kind["mosaic"])
        processor = replace(processor, demosaic="bilinear")
        if kind["mosaic"] == "rgbw":
            table = sensor.qe.values
            clear = (
                np.minimum(table.sum(axis=0, keepdims=True), 1) ** 0.7
            )  # not a sum of the others: color needs four
            qe = replace(sensor.qe, values=np.concatenate([table, clear]))
            sensor = replace(sensor, qe=qe, channels=("R", "G", "B", "W"), cfa=mosaic("rgbw"))
        elif kind["mosaic"] == "stacked":
            sensor = replace(sensor, stacked=True)
        else:
            sensor = replace(sensor, cfa=mosaic(kind["mosaic"]))
    if random.random() < 0.35:
        sensor = replace(sensor, fill_factor=float(random.uniform(0.3, 0.95)))
        features.append(f"fill {sensor.fill_factor:.2g}")
    if random.random() < 0.2 and not kind["depth"]:
        room = (1 - np.sqrt(sensor.fill_factor)) / 2
        move = tuple(float(one) for one in random.uniform(0, 1, 2))
        sensor = (
            replace(sensor, offset=move)
            if random.random() < 0.5
            else replace(sensor, centre=tuple(one * room for one in move))
        )
        features.append("displaced")
    if not sensor.stacked and random.random() < 0.15:
        sensor = replace(
            sensor, binning=(2, 2), binning_mode=str(random.choice(("charge", "digital")))
        )
        features.append("binned")
    if random.random() < 0.12:
        sensor = replace(sensor, vignetting=((0.7, 0.9, 0.6), (0.95, 1.0, 0.9), (0.6, 0.8, 0.75)))
        features.append("vignetting")
    if random.random() < 0.3:
        sensor = replace(
            sensor,
            noise=replace(sensor.noise, photon="none") if random.random() < 0.5 else gs.Noise(),
        )
        features.append("noise set")
    if random.random() < 0.5:
        sensor = replace(sensor, exposure_time=float(10 ** random.uniform(-3, -1)))
    optics, said = _optics(random, kind, f_number, own, sensor, shape, ratio)
    return replace(own, optics=optics, sensor=sensor, processor=processor), features + said


def _optics(random, kind, f_number, own, sensor, shape, ratio):
    """Return the lens, and its features."""
    focal, lens, pitch = own.optics.focal_length, kind["lens"], sensor.pixel_pitch
    near = FOCUS if kind["depth"] else float(random.choice((np.inf, 3.0, 20 * focal)))
    features = [lens] * (lens != "ideal") + ["near focus"] * (near < 2)
    made = gs.Optics(float(np.clip(f_number, 0.5, 200)), focal, object_distance=near)
    if random.random() < 0.3:
        made = replace(
            made,
            transmission=gs.Spectrum(np.array([350.0, 500.0, 800.0]), np.array([0.5, 0.95, 0.7])),
        )
    choice = random.random()
    if choice < 0.5:
        given = (
            "none"
            if choice < 0.2
            else (-0.3, 0.1)
            if choice < 0.35
            else (np.array([0.0, 0.5, 1.3]), np.array([1.0, 0.8, 0.4]))
        )
        made = replace(made, relative_illumination=given)
        features.append("illumination given" if choice >= 0.2 else "illumination none")
    if kind["distortion"]:
        made = replace(made, distortion=_distortion(random, kind["distortion"], shape, pitch))
        features.append(kind["distortion"])
    if lens.startswith("measured"):
        return replace(made, model="measured", psf=_measured(random, lens, pitch, shape)), features
    if lens == "none":
        return replace(made, model="none"), features
    if random.random() < 0.3 or lens == "pupil":
        made = replace(made, pupil=_pupil(random))
        features.append(f"blades {made.pupil.blades} hole {made.pupil.obscuration:.2g}")
    if random.random() < 0.15:
        apart = float(random.uniform(0.3, 1.0) * pitch)
        made = replace(
            made, birefringence=(apart, apart), diffuser=float(random.uniform(0, 0.3) * pitch)
        )
        features.append("low-pass")
    wave = 8 * made.working_f_number**2 * WAVES
    waves = float(random.choice((-1, 1)) * 0.1 * 20 ** random.random())
    limit = 0.3 * focal
    if lens == "defocus" or (lens not in ("axial", "none") and random.random() < 0.15):
        made = replace(made, defocus=float(np.clip(waves * wave, -limit, limit)))
        features.append(f"defocus {waves:.2g} waves")
    if lens == "axial":
        ends = np.clip(np.array([-abs(waves), waves / 2]) * wave, -limit, limit)
        made = replace(made, defocus=gs.Spectrum(np.array([420.0, 680.0]), ends))
    return replace(made, **_aberrated(random, lens)), features


def _aberrated(random, lens):
    """Return wavefront and lateral colour."""
    if lens == "spherical":
        return {"wavefront": Wavefront(seidel=(float(random.uniform(-1.5, 1.5)), 0, 0, 0, 0))}
    if lens == "zernike":
        return {
            "wavefront": Wavefront(
                zernike=(0, 0, 0, *(float(one) for one in random.normal(0, 0.12, 8)))
            )
        }
    if lens == "field zernike":  # coma that grows with the height, and terms that do not change
        same = random.normal(0, 0.06, 1).tolist()
        return {
            "wavefront": Wavefront(
                zernike=(
                    (0, 0, 0, *same, 0, 0, 0, 0),
                    (0, 0, 0, *same, 0, 0, 0, float(random.uniform(-0.3, 0.3))),
                ),
                heights=(0.0, 1.2),
            )
        }
    colour = gs.Spectrum(np.array([450.0, 650.0]), random.uniform(-4e-3, 4e-3, 2))
    if lens == "lateral":
        return {"lateral_color": colour}
    if lens == "field":
        seidel = tuple(float(one) for one in random.uniform(-0.8, 0.8, 4))
        return {
            "wavefront": Wavefront(seidel=(0.0, *seidel[:3], 0.3 * seidel[3])),
            "lateral_color": colour if random.random() < 0.3 else 0.0,
        }
    return {}


def _pupil(random):
    hole = float(random.uniform(0.1, 0.5)) if random.random() < 0.5 else 0.0
    blades = int(random.integers(5, 10)) if random.random() < 0.7 or not hole else 0
    return Pupil(blades, hole, float(random.uniform(0, 1)))


def _measured(random, lens, pitch, shape):
    def blobs(height):
        wide, off = (
            pitch * random.uniform(0.5, 1.2) * (1 + 0.6 * height),
            pitch * height * random.uniform(-1, 1),
        )
        return ((0.7, 0.0, 0.0, wide), (0.3, 0.0, off, 1.4 * wide))

    if lens == "measured":
        return Blobs.of(
            pitch, [((0.7, 0.0, 0.0, 0.6 * pitch), (0.3, 0.5 * pitch, -0.3 * pitch, 0.9 * pitch))]
        )
    if lens == "measured heights":
        heights = (0.0, 0.6, 1.0)
        return Blobs.of(pitch, [blobs(one) for one in heights], heights=np.array(heights))
    axes = [np.array([-1.0, 0.0, 1.0])] * 2
    return Blobs.of(
        pitch, [blobs(np.hypot(y, x)) for y in axes[0] for x in axes[1]], grid=tuple(axes)
    )


def _distortion(random, kind, shape, pitch):
    """Return a distortion with displacements of up to a few pixels at the corner."""
    rows, cols = shape
    corner = np.hypot(rows, cols) / 2 * pitch
    strength = float(random.choice((-1, 1)) * 10 ** random.uniform(-3, -1.1))
    if kind == "radial":
        return RadialPolynomial(strength / 2, strength / 2, corner)
    if kind == "table":
        ideal = np.linspace(0, 1.4 * corner, 8)
        return RadialTable(ideal, ideal * (1 + strength * (ideal / corner) ** 2))
    focal = corner * float(random.uniform(1.2, 3))
    k1 = strength * (focal / corner) ** 2
    if kind == "brown":
        return BrownConrady(k1, 0.0, 0.0, 0.01 * k1, -0.02 * k1, focal)
    if kind == "fisheye":
        return Fisheye(0.1 * k1, 0.0, 0.0, 0.0, focal)
    off = (
        (0.0, 0.0) if kind == "calibration" else tuple(random.uniform(-0.2, 0.2, 2) * (cols, rows))
    )
    middle = cols / 2 - 0.5 + off[0], rows / 2 - 0.5 + off[1]
    coefficients = () if kind == "pinhole off" else (k1, 0.0, 0.0, 0.0)
    return gs.Calibration(
        cols, rows, focal / pitch, focal / pitch, *map(float, middle), coefficients
    )


def _depth(random, kind, content, camera, ratio):
    """Return distances, and layers."""
    shape = content.shape
    if not kind:
        return None, ()
    optics = camera.optics
    radius = random.uniform(0.5, 5) * ratio  # of the circle of confusion [sample]
    change = (
        2
        * radius
        * camera.sensor.pixel_pitch
        / ratio
        * optics.working_f_number
        / optics.image_distance**2
    )
    near, far = 1 / (1 / FOCUS + change), 1 / max(1 / FOCUS - change, 1e-4)
    rows, cols = np.indices(shape)
    half = cols * np.cos(0.2) + rows * np.sin(0.2) > shape[1] * random.uniform(0.3, 0.7)
    if kind == "slope":
        return 1 / (1 / far + (1 / near - 1 / far) * cols / max(shape[1] - 1, 1)), ()
    if kind == "two":
        return np.where(half, near, FOCUS if random.random() < 0.6 else far), ()
    front = (
        replace(content, codes=content.codes[::-1].copy())
        if content.form == "picture"
        else replace(content, maps=content.maps[:, ::-1].copy())
        if content.form == "illuminated"
        else content.with_planes(content.planes[..., ::-1, :].copy())
    )
    layer = gs.Layer(front, half.astype(np.float32), near if random.random() < 0.5 else FOCUS)
    return np.full(shape, far), (layer,)


def _view(random, kind):
    whole = tuple(float(one) for one in random.integers(-6, 7, 2))
    if kind == "whole":
        return gs.View(whole)
    if kind == "fraction":
        return gs.View(tuple(float(one) for one in random.uniform(-6, 6, 2)))
    if kind == "zoom":
        return gs.View(whole, zoom=float(random.uniform(1.05, 3)))
    if kind == "turn":
        return gs.View((0.0, 0.0), float(random.uniform(-0.5, 0.5)), float(random.uniform(1, 1.5)))
    return gs.View()

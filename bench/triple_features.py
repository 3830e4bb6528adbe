"""Random pairs and triples of features, for `bench/triples.py --kinds features`.

The features are as in the matrix of `gpusim verify --combinations`, with random parameters. A
pair that physics excludes is drawn again. The seeds DEVELOPMENT and HELD_OUT were fixed before any
of them was asked. Frames are small, because independent sums judge them: `triple_outside.py`.
"""

from dataclasses import dataclass, replace

import numpy as np
import triple_mixed as mixed
import triple_scenes as old

import gpusim as gs
from gpusim.data.lights import white_radiance
from gpusim.domain.calibration import Fisheye
from gpusim.domain.distortion import RadialPolynomial, RadialTable
from gpusim.domain.mosaics import mosaic
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.judge.combinations import FEATURES

DEVELOPMENT, HELD_OUT = range(36000, 36150), range(36150, 36300)
SMALLEST, LARGEST = 20, 44  # sides of a frame [pixel]
EXCLUDED = {frozenset((feature.name, other)) for feature in FEATURES for other in feature.excludes}
STILL, PLAIN = gs.Motion(), gs.View()
GEOMETRY = {"distortion", "optical axis", "calibration", "fisheye"}


@dataclass(frozen=True, eq=False)
class Question(old.Triple):
    """A question with captures.

    captures: names of captures and outputs. motion: of the camera during an exposure. flicker: of
    the light. views: of the scene. stops: of a bracket. start: time at which the first row opens.
    """

    captures: frozenset = frozenset()
    motion: gs.Motion = STILL
    flicker: gs.Flicker | None = None
    views: tuple = (PLAIN,)
    stops: tuple = (0.0,)


def triple(seed: int) -> Question:
    """Return the question of a seed."""
    random = np.random.default_rng((seed, 36))
    names = _names(random)
    shape = tuple(int(n) for n in random.integers(SMALLEST, LARGEST + 1, 2))
    if names & {"quad-Bayer", "binning"}:
        shape = tuple(n // 4 * 4 for n in shape)
    ratio = 2 if "supersampling" in names else 1
    if ratio > 1:
        shape = tuple(n // 8 * 4 for n in shape)
    own = gs.open_camera(("phone", "machine-vision", "figure8")[random.integers(3)])
    q = (0.7 if names & {"measured spread"} else 1.0) * 3 ** random.random()
    if ratio > 1:
        q = max(q, 1.0)
    border = old._one_of(random, mixed.BORDERS)
    margin = int(random.integers(4, 9)) if border == "scene" else 0
    samples = tuple(n * ratio + 2 * margin for n in shape)
    sensor, processor = _sensor(random, names, own)
    optics = _optics(random, names, q, own, sensor, shape)
    camera = replace(own, optics=optics, sensor=sensor, processor=processor)
    content = _content(random, names, samples)
    depth, layers = _depth(random, names, content, camera, ratio)
    light = replace(gs.illuminant(mixed.LIGHTS[random.integers(len(mixed.LIGHTS))]), quantity="")
    luminance = float(10 ** random.uniform(0.7, 3))
    scene = gs.Scene(
        content,
        white_radiance(light, luminance),
        border,
        margin,
        depth=depth,
        name="features",
        samples_per_pixel=float(ratio),
        layers=layers,
    )
    tolerance = str(random.choice(("preview", "video", "video", "metrology")))
    if random.random() < 0.6:
        tolerance = f"{10 ** random.uniform(-4.3, -1.3):.2g}"
    words = (
        f"{seed}: {scene.shape[1]}x{scene.shape[0]} q {q:.2g} {border} {' + '.join(sorted(names))}; "
        f"{light.name} {luminance:.3g} cd/m2; tolerance {tolerance}"
    )
    more = _captures(random, names, camera)
    return Question(
        seed,
        scene,
        camera,
        tolerance,
        "features",
        border,
        "",
        words,
        tuple(sorted(names)),
        captures=frozenset(names),
        **more,
    )


def _names(random):
    """Return two or three features that physics does not exclude."""
    known = [feature.name for feature in FEATURES]
    while True:
        count = 2 if random.random() < 0.55 else 3
        chosen = {str(one) for one in random.choice(known, count, replace=False)}
        pairs = {frozenset((a, b)) for a in chosen for b in chosen if a < b}
        if not pairs & EXCLUDED:
            return chosen


def _sensor(random, names, own):
    sensor, processor = own.sensor, replace(own.processor, demosaic="bilinear")
    sensor = replace(sensor, exposure_time=float(10 ** random.uniform(-2.6, -1.6)))
    if "stacked" in names:
        sensor = replace(sensor, stacked=True)
    if "quad-Bayer" in names:
        sensor = replace(sensor, cfa=mosaic("quad-bayer"))
    if "binning" in names:
        mode = str(random.choice(("charge", "digital")))
        sensor = replace(sensor, binning=(2, 2), binning_mode=mode)
    if "rolling shutter" in names:
        sensor = replace(sensor, row_time=float(10 ** random.uniform(-5, -3.7)))
    if random.random() < 0.25 and "supersampling" not in names:
        sensor = replace(sensor, fill_factor=float(random.uniform(0.4, 0.95)))
    return sensor, processor


def _optics(random, names, q, own, sensor, shape):
    pitch, focal = sensor.pixel_pitch, own.optics.focal_length
    f_number = float(np.clip(q * pitch / mixed.WAVES, 0.6, 100))
    made = gs.Optics(f_number, focal, object_distance=mixed.FOCUS)
    if random.random() < 0.4:
        made = replace(made, relative_illumination="none")
    if names & GEOMETRY:
        made = replace(made, distortion=_geometry(random, names, shape, pitch))
    if "measured spread" in names:
        kind = str(random.choice(("measured", "measured heights", "measured grid")))
        return replace(made, model="measured", psf=mixed._measured(random, kind, pitch, shape))
    blades = int(random.integers(5, 10)) if "blades" in names else 0
    hole = float(random.uniform(0.15, 0.5)) if "obscuration" in names else 0.0
    zernike, seidel = (), (0.0,) * 5
    if "Zernike" in names:
        zernike = (0, 0, 0, *(float(one) for one in random.normal(0, 0.12, 8)))
    if "Seidel" in names:
        seidel = (0.0, *(float(one) for one in random.uniform(-0.8, 0.8, 3)), 0.0)
    colour = 0.0
    if "lateral colour" in names:
        excess = random.uniform(-1, 1, 2) * 1.5 / (np.hypot(*shape) / 2)  # to 1.5 pixels
        colour = gs.Spectrum(np.array([450.0, 650.0]), excess)
    apart = float(random.uniform(0.3, 1.0) * pitch) if "low-pass" in names else 0.0
    return replace(
        made,
        pupil=Pupil(blades, hole, float(random.uniform(0, 1)) if blades else 0.0),
        wavefront=Wavefront(zernike=zernike, seidel=seidel),
        lateral_color=colour,
        birefringence=(apart, apart),
        diffuser=0.2 * apart,
    )


def _geometry(random, names, shape, pitch):
    """Return a distortion, a fisheye, or a calibration that holds them and the axis."""
    rows, cols = shape
    corner = np.hypot(rows, cols) / 2
    strength = float(random.choice((-1, 1)) * random.uniform(0.5, 3)) / corner  # at the corner
    strength = max(strength, -0.04)  # one to one, also around the frame
    focal = corner * float(random.uniform(1.0, 2.5))  # [pixel]
    k1 = strength * (focal / corner) ** 2
    is_bent = bool(names & {"distortion", "calibration"})
    if names & {"optical axis", "calibration"}:
        off = random.uniform(-0.2, 0.2, 2) * (cols, rows) if "optical axis" in names else (0.0, 0.0)
        coefficients = (k1, 0.0, 0.02 * k1, -0.01 * k1) if is_bent else ()
        if "fisheye" in names:
            coefficients = (0.1 * k1, 0.0, 0.0, 0.0) if is_bent else (0.0,) * 4
        middle = cols / 2 - 0.5 + float(off[0]), rows / 2 - 0.5 + float(off[1])
        return gs.Calibration(cols, rows, focal, focal, *middle, coefficients, "fisheye" in names)
    if "fisheye" in names:
        return Fisheye(0.1 * k1 if is_bent else 0.0, 0.0, 0.0, 0.0, focal * pitch)
    if random.random() < 0.5:
        return RadialPolynomial(0.0, strength, corner * pitch)
    ideal = np.linspace(0, 2.5 * corner * pitch, 14)
    return RadialTable(ideal, ideal * (1 + strength * (ideal / (corner * pitch)) ** 2))


def _content(random, names, samples):
    kind = {
        "form": "illuminated"
        if "several lights" in names
        else str(random.choice(("cube", "basis"))),
        "nodes": "few",
    }
    while True:
        content, said = mixed._content(random, kind, samples)
        if not said.startswith(("stars", "highlights")):
            break
    if "highlights" in names:
        count, most = int(random.integers(1, 5)), random.uniform(2, 5)
        at = random.integers(samples[0], size=count), random.integers(samples[1], size=count)
        name = "values" if content.form == "cube" else "coefficients"
        brighter = getattr(content, name).copy()
        brighter[(slice(None), *at)] *= 10**most
        content = replace(content, **{name: brighter})
    return content


def _depth(random, names, content, camera, ratio):
    """Return distances, and layers."""
    if not names & {"depth", "layers"}:
        return None, ()
    kind = str(random.choice(("two", "slope"))) if "depth" in names else "flat"
    if kind == "flat":
        depth = np.full(content.shape, mixed.FOCUS)
    else:
        depth = mixed._depth(random, kind, content, camera, ratio)[0]
    if "layers" not in names:
        return depth, ()
    nearer = mixed._depth(random, "two", content, camera, ratio)[0]
    near = 0.95 * min(float(depth.min()), float(nearer.min()))
    name = "values" if content.form == "cube" else "coefficients"
    sheet = replace(content, **{name: getattr(content, name)[:, ::-1].copy()})
    y, x = np.indices(content.shape)
    middle = random.uniform(0.3, 0.7, 2) * content.shape
    cover = np.hypot(y - middle[0], x - middle[1]) < random.uniform(0.2, 0.4) * min(content.shape)
    return depth, (gs.Layer(sheet, cover.astype(np.float32), near),)


def _captures(random, names, camera):
    """Return the fields of a question about captures."""
    made = {}
    pan = tuple(float(one) for one in random.uniform(-4, 4, 2) / camera.sensor.exposure_time)
    if names & {"motion", "video"} and "several views" not in names:
        if "video" in names:
            pan = tuple(float(one) * 30 for one in random.uniform(-4, 4, 2))
        made["motion"] = gs.Motion(pan=pan)
    if "rolling shutter" in names:
        made["flicker"] = gs.Flicker(100.0, float(random.uniform(0.3, 0.9)))
    if "several views" in names:
        shift = tuple(float(one) for one in random.uniform(-4, 4, 2))
        turned = gs.View(shift, float(random.uniform(-0.2, 0.2)), float(random.uniform(1, 1.3)))
        made["views"] = (gs.View((2.0, -3.0)), turned)
    if "bracket" in names:
        made["stops"] = (-1.0, 1.0)
    return made

"""Every pair of features of a camera, a scene and a capture: `gpusim verify --combinations`.

A feature changes a small `Case`. A pair of features changes it twice, and its frames are made on
the device. A pair may be impossible for a reason of physics; the feature that excludes another one
gives the reason. Everything else must run, and both features must change the frames.

`gpusim.apps.routes.make` makes the frames: the ways from a case to frames are in one place.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from time import perf_counter

import numpy as np

from gpusim.backends import Device
from gpusim.data.lights import illuminant, white_radiance
from gpusim.domain.calibration import Calibration, Fisheye
from gpusim.domain.camera import Camera
from gpusim.domain.content import Basis
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.errors import GpusimError, one_line
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.mask import Mask
from gpusim.domain.mosaics import mosaic
from gpusim.domain.optics import Optics
from gpusim.domain.psf import PointSpread
from gpusim.domain.scene import Layer, Scene
from gpusim.domain.spectrum import Spectrum
from gpusim.io.camera.cameras import open_camera

SAMPLES = (32, 40)  # rows and columns of a scene; bursts merge tiles of 32
NEAR, FOCUS = 0.8, 2.0  # [m]
EXPOSURE = 0.01  # [s]
FOCAL_PIXELS = 40.0  # focal length of calibrations and of the fisheye [pixel]
K1, K2 = 0.2, 0.2  # radial coefficients: they move a corner by 5 pixels
MASK = Mask(np.array([[1.0, 0.0, 1.0], [0.3, 1.0, 0.0]]))  # not even: kernels are mirrored by it
MOST_LEFT_OUT = 0.02  # relative rms error of an effect that is left out, at most
WHOLE_LENS = "measured spreads are of the whole lens, with its pupil, wavefront and filters"

RUNS, PHYSICS = "runs", "physics"
IGNORED, LEFT_OUT, NO_WAY = "ignored", "left out", "no way"
REFUSED, ERROR = "refused", "error"
GOOD = (RUNS, PHYSICS)
MARKS = {
    RUNS: "·",
    PHYSICS: "p",
    IGNORED: "i",
    LEFT_OUT: "l",
    NO_WAY: "-",
    REFUSED: "R",
    ERROR: "E",
}
MEANINGS = {
    RUNS: "runs",
    PHYSICS: "excluded by physics",
    IGNORED: "one of the two has no effect",
    LEFT_OUT: "runs, but an effect is left out",
    NO_WAY: "no way in the API",
    REFUSED: "refused",
    ERROR: "error",
}


class NoWay(Exception):
    """The API has no way to make the frames of a case."""


@dataclass(frozen=True, eq=False)
class Case:
    """A camera in front of a scene, and the frames that are wanted.

    Attributes:
        camera: The camera.
        scene: The scene.
        captures: Names of captures: "rolling", "motion", "reads", "burst", "bracket", "views".
        outputs: Names of outputs: "video", "preview", "batch". None: single frames.
        geometry: Parts of the lens's geometry: "distortion", "axis", "calibration", "fisheye".
    """

    camera: Camera
    scene: Scene
    captures: frozenset[str] = frozenset()
    outputs: frozenset[str] = frozenset()
    geometry: frozenset[str] = frozenset()

    def with_optics(self, **changes) -> "Case":
        """Return the case with other fields of the lens."""
        return replace(
            self, camera=replace(self.camera, optics=replace(self.camera.optics, **changes))
        )

    def with_sensor(self, **changes) -> "Case":
        """Return the case with other fields of the sensor, and any mosaic's demosaicking."""
        sensor = replace(self.camera.sensor, **changes)
        processor = replace(self.camera.processor, demosaic="bilinear")
        return replace(self, camera=replace(self.camera, sensor=sensor, processor=processor))

    def with_scene(self, **changes) -> "Case":
        """Return the case with other fields of the scene."""
        return replace(self, scene=replace(self.scene, **changes))


@dataclass(frozen=True)
class Feature:
    """Something that a camera, a scene or a capture may have.

    Attributes:
        name: Name in the matrix.
        change: Function from a case to the case with the feature.
        excludes: Name of another feature -> the reason of physics.
    """

    name: str
    change: Callable[[Case], Case]
    excludes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Cell:
    """The result of a pair of features.

    Attributes:
        first, second: Names of the features.
        state: A key of MARKS.
        why: The reason, or the error; "" if it runs.
        seconds: Time it took [s].
    """

    first: str
    second: str
    state: str
    why: str = ""
    seconds: float = 0.0

    @property
    def is_good(self) -> bool:
        """True if the pair runs, or is excluded by physics."""
        return self.state in GOOD


def plain_case() -> Case:
    """Return the case without any feature: a phone in front of random surfaces."""
    random = np.random.default_rng(35)
    nodes = np.linspace(400.0, 700.0, 5)
    spectra = np.array(
        [[0.9, 0.6, 0.2, 0.1, 0.1], [0.1, 0.5, 0.9, 0.4, 0.2], [0.1, 0.1, 0.3, 0.8, 1]]
    )
    amounts = random.uniform(0.05, 0.5, (3, *SAMPLES)).astype(np.float32)
    light = white_radiance(illuminant("D65"), 300.0)
    scene = Scene(Basis(nodes, amounts, spectra), light, name="random surfaces")
    camera = open_camera("phone")
    optics = Optics(4.0, camera.optics.focal_length, object_distance=FOCUS)
    sensor = replace(camera.sensor, exposure_time=EXPOSURE)
    return Case(replace(camera, optics=optics, sensor=sensor), scene)


def _measure_spread(case):
    """Spreads that are measured at two field heights: wider, and displaced, in the corner."""
    pitch = case.camera.sensor.pixel_pitch
    at = np.arange(-16, 17) / 4

    def blob(wide, off):
        return np.exp(-(at[:, None] ** 2 + (at - off) ** 2) / (2 * wide**2))

    values = np.stack([blob(0.6, 0.0), blob(0.9, 0.4)])[:, None].repeat(2, axis=1)
    heights = np.array([0.0, 2.0])
    spread = PointSpread(np.array([380.0, 780.0]), values, pitch / 4, heights=heights)
    return case.with_optics(model="measured", psf=spread)


def _aberrate(case, **terms):
    return case.with_optics(wavefront=replace(case.camera.optics.wavefront, **terms))


def _shape_pupil(case, **changes):
    return case.with_optics(pupil=replace(case.camera.optics.pupil, **changes))


def _filter_low_pass(case):
    return case.with_optics(birefringence=(0.5 * case.camera.sensor.pixel_pitch,) * 2)


def _add_geometry(case, name):
    """Return the case with a part of the lens's geometry; a calibration holds them all."""
    names = case.geometry | {name}
    rows, cols = SAMPLES
    radius = FOCAL_PIXELS * case.camera.sensor.pixel_pitch
    k1, k2 = K1 * ("calibration" in names), K2 * ("distortion" in names)
    if names & {"axis", "calibration"}:
        off = (5.0, -3.0) if "axis" in names else (0.0, 0.0)
        coefficients = (k1, k2, 0.0, 0.0) if k1 or k2 or "fisheye" in names else ()
        middle = cols / 2 - 0.5 + off[0], rows / 2 - 0.5 + off[1]
        focal = FOCAL_PIXELS, FOCAL_PIXELS
        model = Calibration(cols, rows, *focal, *middle, coefficients, "fisheye" in names)
    elif "fisheye" in names:
        model = Fisheye(0.0, k2, 0.0, 0.0, radius)
    else:
        model = RadialPolynomial(0.0, k2, radius)
    return replace(case.with_optics(distortion=model), geometry=names)


def _color_laterally(case):
    excess = Spectrum(np.array([450.0, 650.0]), np.array([-0.03, 0.03]))
    return case.with_optics(lateral_color=excess)


def _give_depth(case):
    """A near half in front of one in focus."""
    near = np.arange(SAMPLES[1]) < SAMPLES[1] // 2
    depth = np.broadcast_to(np.where(near, NEAR, FOCUS), SAMPLES).copy()
    return case.with_scene(depth=depth)


def _put_layer(case):
    """A near sheet in front of the scene, which is at the distance in focus or has its depth."""
    depth = np.full(SAMPLES, FOCUS) if case.scene.depth is None else case.scene.depth
    content = case.scene.content
    sheet = replace(content, coefficients=content.coefficients[:, ::-1].copy())
    cover = np.zeros(SAMPLES, np.float32)
    cover[6:18, 10:24] = 1.0
    return case.with_scene(depth=depth, layers=(Layer(sheet, cover, NEAR / 2),))


def _add_highlights(case):
    content = case.scene.content
    brighter = content.coefficients.copy()
    brighter[:, 9, 12] *= 1e4
    brighter[:, 17, 26] *= 1e3
    return case.with_scene(content=replace(content, coefficients=brighter))


def _add_lights(case):
    content = case.scene.content
    left = np.linspace(1, 0, SAMPLES[1], dtype=np.float32)
    maps = np.stack([np.broadcast_to(one, SAMPLES) for one in (left, 1 - left)]).copy()
    lights = np.array([[1.0, 0.9, 0.7, 0.5, 0.3], [0.2, 0.4, 0.7, 0.9, 1.0]])
    lit = Illuminated(content.wavelengths, maps, content.coefficients, content.basis, lights)
    return case.with_scene(content=lit)


def _capture(name):
    return lambda case: replace(case, captures=case.captures | {name})


def _output(name):
    return lambda case: replace(case, outputs=case.outputs | {name})


def _geometry(name):
    return lambda case: _add_geometry(case, name)


def _roll(case):
    """Rows open one after the other, in a light that flickers."""
    return _capture("rolling")(case.with_sensor(row_time=1e-4))


FEATURES = (
    Feature(
        "measured spread",
        _measure_spread,
        dict.fromkeys(
            (
                "Zernike",
                "blades",
                "obscuration",
                "Seidel",
                "lateral colour",
                "low-pass",
                "mask",
            ),
            WHOLE_LENS,
        ),
    ),
    Feature("Zernike", lambda case: _aberrate(case, zernike=(0, 0, 0, 0, 0.1, 0, 0.12, 0.05))),
    Feature("blades", lambda case: _shape_pupil(case, blades=6)),
    Feature("obscuration", lambda case: _shape_pupil(case, obscuration=0.4)),
    Feature("mask", lambda case: _shape_pupil(case, mask=MASK)),
    Feature("Seidel", lambda case: _aberrate(case, seidel=(0.0, 0.6, 0.4, 0.3, 0.0))),
    Feature("distortion", _geometry("distortion")),
    Feature("lateral colour", _color_laterally),
    Feature("low-pass", _filter_low_pass),
    Feature("optical axis", _geometry("axis")),
    Feature("calibration", _geometry("calibration")),
    Feature("fisheye", _geometry("fisheye")),
    Feature("depth", _give_depth),
    Feature("several lights", _add_lights),
    Feature("highlights", _add_highlights),
    Feature("layers", _put_layer),
    Feature("supersampling", lambda case: case.with_scene(samples_per_pixel=2.0)),
    Feature(
        "stacked",
        lambda case: case.with_sensor(stacked=True),
        {"quad-Bayer": "stacked pixels see all channels: there is no mosaic"},
    ),
    Feature("quad-Bayer", lambda case: case.with_sensor(cfa=mosaic("quad-bayer"))),
    Feature("binning", lambda case: case.with_sensor(binning=(2, 2), binning_mode="digital")),
    Feature("rolling shutter", _roll),
    Feature("motion", _capture("motion")),
    Feature("reads", _capture("reads")),
    Feature("burst", _capture("burst")),
    Feature("bracket", _capture("bracket")),
    Feature("several views", _capture("views")),
    Feature("video", _output("video")),
    Feature("preview", _output("preview")),
    Feature("batch", _output("batch")),
)
NAMES = [feature.name for feature in FEATURES]


@dataclass(frozen=True)
class Made:
    """Frames of a case.

    Attributes:
        arrays: Arrays of the frames, on the host.
        left_out: Effects that the plans left out, with the relative rms error of each: infinite if
            it is not known, 0 if camera or scene declare it.
    """

    arrays: list[np.ndarray]
    left_out: dict[str, float] = field(default_factory=dict)

    def is_same(self, other: "Made") -> bool:
        """Return whether all arrays are equal, bit for bit."""
        return len(self.arrays) == len(other.arrays) and all(
            map(np.array_equal, self.arrays, other.arrays)
        )


def combinations(
    device: Device, make: Callable[[Case, Device], Made], names: Iterable[str] | None = None
) -> Iterator[Cell]:
    """Yield the cell of each feature by itself, then of each pair of features.

    Args:
        device: The device.
        make: Function that makes the frames of a case.
        names: Names of features; None for all.

    Yields:
        Cells; a feature by itself has its name twice.
    """
    chosen = [feature for feature in FEATURES if names is None or feature.name in names]
    own: dict[str, Made] = {}
    plain = make(plain_case(), device)
    for feature in chosen:
        cell, made = _try_pair(device, make, feature, feature, [plain])
        if made is not None:
            own[feature.name] = made
        if cell.state == LEFT_OUT:  # the scene does not hold it, whatever the lens is
            cell = replace(cell, state=RUNS)
        yield cell
    for number, first in enumerate(chosen):
        for second in chosen[number + 1 :]:
            others = [own[one.name] for one in (first, second) if one.name in own]
            yield _try_pair(device, make, first, second, others)[0]


def _try_pair(device, make, first, second, others):
    """Return the cell of a pair, and its frames or None. others: frames that must differ."""
    reason = first.excludes.get(second.name) or second.excludes.get(first.name)
    begin, made = perf_counter(), None
    try:
        case = first.change(plain_case())
        made = make(case if first is second else second.change(case), device)
        state, why = _judge(made, others)
        if reason:  # it may run as one of the two does
            state, why = (PHYSICS, reason) if state == IGNORED else (ERROR, f"runs: {reason}")
    except NoWay as error:
        state, why = NO_WAY, str(error)
    except GpusimError as error:
        state, why = (PHYSICS, reason) if reason else (REFUSED, str(error))
    except Exception as error:  # a driver may raise anything; the next pairs are still judged
        state, why = ERROR, one_line(f"{type(error).__name__}: {error}")
    return Cell(first.name, second.name, state, why, perf_counter() - begin), made


def _judge(made, others):
    if not all(np.isfinite(one).all() for one in made.arrays):
        return ERROR, "frames that are not finite"
    if any(made.is_same(one) for one in others):
        return IGNORED, "the frames are the same without one of them"
    known = {words for one in others for words in one.left_out}
    left = [
        f"{words} ({rms:.2g})"
        for words, rms in made.left_out.items()
        if rms > MOST_LEFT_OUT and words not in known
    ]
    return (LEFT_OUT, one_line("; ".join(left))) if left else (RUNS, "")


def matrix(cells: Iterable[Cell], names: Iterable[str] | None = None) -> list[str]:
    """Return the matrix as lines of text: a row for each feature, and the meaning of the marks.

    Args:
        cells: Cells of `combinations`.
        names: Names of the features, in order; None for all.
    """
    cells = list(cells)
    known = {frozenset((cell.first, cell.second)): MARKS[cell.state] for cell in cells}
    chosen = NAMES if names is None else [name for name in NAMES if name in set(names)]
    wide = max(map(len, chosen))
    lines = [f"{'':{wide}}    " + " ".join(f"{n + 1:2d}" for n in range(len(chosen)))]
    for number, name in enumerate(chosen, 1):
        marks = (f" {known.get(frozenset((name, other)), ' ')}" for other in chosen)
        lines.append(f"{name:{wide}} {number:2d} " + " ".join(marks))
    counts = Counter(cell.state for cell in cells if cell.first != cell.second)
    found = [
        f"{MARKS[state]} {MEANINGS[state]}: {counts[state]}" for state in MARKS if counts[state]
    ]
    return [*lines, "", f"{sum(counts.values())} pairs; " + ", ".join(found)]


def reasons(cells: Iterable[Cell]) -> list[str]:
    """Return a line for each reason why pairs do not run, with the pairs.

    Args:
        cells: Cells of `combinations`.
    """
    found: dict[tuple[str, str], list[str]] = {}
    for cell in cells:
        if cell.state != RUNS:
            pair = cell.first if cell.first == cell.second else f"{cell.first} x {cell.second}"
            found.setdefault((cell.state, cell.why), []).append(pair)
    order = sorted(found, key=lambda key: list(MARKS).index(key[0]))
    return [f"{MEANINGS[state]}: {', '.join(found[state, why])}: {why}" for state, why in order]

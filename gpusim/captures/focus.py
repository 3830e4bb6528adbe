"""Contrast autofocus: the sharpest of several pictures at trial focus positions."""

from dataclasses import dataclass, replace

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import LONGEST_WAVEFRONT
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.scene import Scene
from gpusim.domain.short_repr import short_repr
from gpusim.pipeline.simulator import Simulator

FIRST_STEP = 4.0  # [pixel] circle of confusion between the first positions
WAVELENGTH = 550.0  # [nm] for the depth of focus
CERTAIN = 20.0  # standard errors by which contrast must rise; neighbouring differences share pixels
LEAST_RISE = 0.02  # rise relative to the least contrast: less is shading, not focus


@dataclass(frozen=True, eq=False)
class Focus:
    """Result of the autofocus.

    Attributes:
        optics: lens focused there; optics.image_distance is the distance to the sensor.
        depth_of_focus: half of the range that is equally sharp, in dioptres [1/m].
        distances: object distances of the trials, from far to near, shape (n,) [m].
        contrasts: contrasts of the trials, shape (n,) [1].
    """

    optics: Optics
    depth_of_focus: float
    distances: np.ndarray
    contrasts: np.ndarray

    __repr__ = short_repr

    @property
    def object_distance(self) -> float:
        """Distance of the plane in focus [m]."""
        return self.optics.object_distance


def autofocus(
    simulator: Simulator,
    scene: Scene,
    *,
    region: tuple[slice, slice] | None = None,
    nearest: float | None = None,
    farthest: float = np.inf,
    seed: int = 0,
) -> Focus:
    """Focus the camera of `simulator` on a region of the frame for contrast of raw pictures.

    Positions are evenly spaced in dioptres, to which the sensor's displacement and the circle of
    confusion are proportional. The first are FIRST_STEP pixels of circle of confusion apart, then
    three times closer around the best, down to half a depth of focus. The focus is the peak of a
    parabola through the last ones.

    Source: Farrell and Wandell, section 4.4; Krotkov, International Journal of Computer Vision 1,
    223 (1987) (the mean squared gradient).

    Args:
        simulator: simulator whose camera is focused.
        scene: scene with depth.
        region: rows and columns of the raw picture [pixel]; None is the middle third.
        nearest: nearest distance searched [m]; None is 20 focal lengths.
        farthest: farthest distance searched [m].
        seed: seed of the noise; each trial is another frame.

    Returns:
        The lens in focus, and all trials.

    Raises:
        BadData: if the scene has no depth or no detail.
        OutOfRange: if the region or range is invalid, or the contrast still rises at `nearest`.
    """
    optics = simulator.camera.optics
    if scene.depth is None:
        raise BadData(
            f"{scene.name}: no depth, so every focus is equally sharp; set scene.depth [m]"
        )
    nearest = 20 * optics.focal_length if nearest is None else nearest
    if not optics.focal_length < nearest < farthest:
        raise OutOfRange(
            "autofocus range",
            f"{nearest:.4g} .. {farthest:.4g} m",
            f"focal_length ({optics.focal_length:.4g} m) < nearest < farthest",
        )
    trials = _Trials(simulator, scene, region, seed)
    step, depth_of_focus = focus_steps(simulator.camera)
    far, near = _ends(optics, scene, nearest, farthest)

    around = np.linspace(far, near, max(5, int(np.ceil((near - far) / step)) + 1))
    step = around[1] - around[0]
    best = max(around, key=trials)
    trials.require_rise()
    while step > depth_of_focus / 2:
        step /= 3
        around = np.clip(best + step * np.arange(-3, 4), far, near)
        best = max(around, key=trials)
    if best == near:
        raise OutOfRange(
            "nearest", f"{nearest:.4g} m", "a nearer distance: the contrast still rises there"
        )
    around = np.unique(np.clip(best + step * np.arange(-3, 4), far, near))
    curve = np.polynomial.Polynomial.fit(around, [trials(vergence) for vergence in around], 2)
    bend = curve.convert().coef
    if len(around) > 2 and bend[2] < 0:
        best = float(np.clip(-bend[1] / (2 * bend[2]), around[0], around[-1]))
    order = sorted(trials.found)
    return Focus(
        replace(optics, object_distance=_distance(best)),
        depth_of_focus,
        np.array([_distance(vergence) for vergence in order]),
        np.array([trials(v) for v in order]),
    )


def focus_steps(camera):
    """Return the step of the first trials and the depth of focus, both in dioptres [1/m]."""
    infinity, pitch = replace(camera.optics, object_distance=np.inf), camera.sensor.pixel_pitch
    diopters = (infinity.working_f_number * pitch) / infinity.displacement(1.0)  # per pixel
    quarter_wave = 2 * infinity.working_f_number**2 * WAVELENGTH * 1e-9
    depth_of_focus = max(quarter_wave, infinity.working_f_number * pitch / 2)
    return FIRST_STEP * diopters, depth_of_focus / infinity.displacement(1.0)


def _ends(optics, scene, nearest, farthest):
    """Return both ends of the search [1/m], within the lens model's range around the surfaces.

    Raises OutOfRange if nothing remains.
    """
    per_diopter = replace(optics, object_distance=np.inf).displacement(1.0)
    longest = 0.8 * LONGEST_WAVEFRONT * 8 * optics.f_number**2  # [wavelength]
    reach = longest * scene.wavelengths[0] * 1e-9 / per_diopter
    far = max(1 / farthest, 1 / scene.depth.min() - reach)
    near = min(1 / nearest, 1 / scene.depth.max() + reach)
    if not far < near:
        raise OutOfRange(
            "depth",
            f"{scene.depth.min():.4g} .. {scene.depth.max():.4g} m",
            f"within {reach:.4g} dioptres of the focus: {LONGEST_WAVEFRONT:g} waves",
        )
    return far, near


class _Trials:
    """Contrast of a region at trial positions, each measured once.

    found: vergence [1/m] -> contrast and its standard error [1]. Raises OutOfRange if the region is
    too small.
    """

    def __init__(self, simulator: Simulator, scene, region, seed):
        sensor, readout = simulator.camera.sensor, simulator.readout
        self._loop, self._seed = simulator.loop(scene), seed
        self._period = (1, 1) if sensor.stacked else readout.output.cfa_indices.shape
        self._region = check_region(region, readout.output_shape(scene.shape), self._period)
        self.found: dict[float, tuple[float, float]] = {}

    def __call__(self, vergence):
        """Return the contrast at a vergence [1/m], with the exposure of the first trial."""
        if vergence not in self.found:
            simulator = self._loop.simulator
            focused = replace(simulator.camera.optics, object_distance=_distance(vergence))
            loop = self._loop.update(camera=replace(simulator.camera, optics=focused))
            exposure = loop.exposure
            raw = loop.raw(seed=self._seed, first=len(self.found))
            raw = exposure.split_layers(np.asarray(simulator.device.numpy(raw)))
            # for the next trials
            loop.update(exposure_time=exposure.exposure_time, gain=exposure.gain)
            # the middle channel
            raw = raw[len(raw) // 2] if simulator.camera.sensor.stacked else raw
            sensor = exposure.camera.sensor
            light = raw[self._region].astype(float) - sensor.dark_level
            self.found[vergence] = _contrast(
                light, sensor, self._period, exposure.exposure_time, simulator.readout.averaged
            )
        return self.found[vergence][0]

    def require_rise(self):
        """Raise BadData if the contrast differs between trials by no more than noise."""
        (least, error), (most, _) = min(self.found.values()), max(self.found.values())
        if not most - least > max(CERTAIN * error, LEAST_RISE * abs(least), 1e-12):
            raise BadData(
                f"{self._loop.scene.name}: no detail to focus on: contrast {least:.3g} .. {most:.3g}, "
                f"standard error {error:.2g}; choose a region with an edge or texture, or more light"
            )


def _distance(vergence):
    return 1 / vergence if vergence > 0 else np.inf


def check_region(region, shape, period):
    """Return the rows and columns in which contrast is measured; raise OutOfRange if too few."""
    region = region or tuple(slice(n // 3, n - n // 3) for n in shape)
    for part, size, least in zip(region, shape, period, strict=True):
        start, stop, _ = part.indices(size)
        if stop - start < 2 * least + 1:
            raise OutOfRange(
                "autofocus region",
                f"{stop - start} of {size} pixels",
                f"at least {2 * least + 1} each way",
            )
    return region


def _contrast(raw, sensor, period, exposure_time, averaged):
    """Return the contrast [1] and its standard error.

    Contrast is the mean squared difference of neighbours of the same colour over the squared mean.
    The known contribution of the sensor's noise is subtracted, because it grows as the trials get
    darker. raw: digital numbers above the dark level [DN]. averaged: pixels averaged into one
    digital number.
    """
    level, gain = raw.mean(), sensor.gain_dn_per_electron
    if not level > 0:
        return 0.0, 0.0
    dark = sensor.noise.operating_dark_current * exposure_time  # included in the level
    noise = gain**2 * RawNoise.of(sensor, averaged).difference(level / gain, level / gain - dark)
    down, across = period
    rows = (raw[down:] - raw[:-down]).ravel()
    cols = (raw[:, across:] - raw[:, :-across]).ravel()
    squares = np.concatenate([rows, cols]) ** 2
    error = squares.std() / np.sqrt(squares.size)
    return float((squares.mean() - noise) / level**2), float(error / level**2)

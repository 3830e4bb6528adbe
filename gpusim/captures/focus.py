"""Contrast autofocus: pictures at trial positions of the sensor, the sharpest of which is in focus."""

from dataclasses import dataclass, replace

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import LONGEST_WAVEFRONT
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.scene import Scene
from gpusim.domain.short_repr import brief
from gpusim.pipeline.simulator import Simulator

FIRST_STEP = 4.0  # [pixel] of circle of confusion between the first positions
WAVELENGTH = 550.0  # [nm] at which the depth of focus is counted
CERTAIN = 20.0  # times its standard error is what the contrast must rise by; neighbouring differences share pixels
LEAST_RISE = 0.02  # of the least contrast: less is shading, not focus


@dataclass(frozen=True, eq=False)
class Focus:
    """Where a picture is sharpest.

    optics: the lens focused there. object_distance: of the plane in focus [m]; optics.image_distance is where the
    sensor is. depth_of_focus: half of the range that is as sharp, in dioptres [1/m].
    distances [m], contrasts [1]: the trials, from far to near, shape (n,).
    """

    optics: Optics
    depth_of_focus: float
    distances: np.ndarray
    contrasts: np.ndarray

    __repr__ = brief

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
    """Focus the camera of `simulator` on what is in a region of the frame, by the contrast of its raw pictures.

    region: rows and columns of the raw picture [pixel]; by default the middle third. nearest, farthest: range of the
    search [m]; by default from 20 focal lengths to infinity. seed: of the noise, each trial is another frame.
    Positions are even in dioptres, to which the sensor's displacement and the circle of confusion are proportional:
    first FIRST_STEP pixels of it apart, then three times closer about the best, until half a depth of focus; the last
    ones' parabola has its top in focus. Source: Farrell and Wandell, section 4.4; Krotkov, International Journal of
    Computer Vision 1, 223 (1987) (the mean squared gradient).
    Raises BadData for a scene without depth or without detail, OutOfRange for a region or range that cannot be, or if
    the contrast still rises at `nearest`.
    """
    optics = simulator.camera.optics
    if scene.depth is None:
        raise BadData(
            f"{scene.name}: no depth, so it is equally sharp at every focus; give scene.depth [m]"
        )
    nearest = 20 * optics.focal_length if nearest is None else nearest
    if not optics.focal_length < nearest < farthest:
        raise OutOfRange(
            "autofocus range",
            f"{nearest:.4g} .. {farthest:.4g} m",
            f"focal_length ({optics.focal_length:.4g} m) < nearest < farthest",
        )
    trials = _Trials(simulator, scene, region, seed)
    step, depth_of_focus = _steps(simulator.camera)
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
        raise OutOfRange("nearest", f"{nearest:.4g} m", "less: the contrast still rises there")
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


def _steps(camera):
    """Between the first trials, and of half the range that is as sharp as the focus [1/m]."""
    infinity, pitch = replace(camera.optics, object_distance=np.inf), camera.sensor.pixel_pitch
    diopters = (infinity.working_f_number * pitch) / infinity.displacement(1.0)  # to a pixel
    depth_of_focus = max(
        2 * infinity.working_f_number**2 * WAVELENGTH * 1e-9,  # a quarter wave
        infinity.working_f_number * pitch / 2,
    ) / infinity.displacement(1.0)
    return FIRST_STEP * diopters, depth_of_focus


def _ends(optics, scene, nearest, farthest):
    """Where the search begins and ends [1/m], no trial so far from any surface that the lens's model ends.

    Raises OutOfRange.
    """
    per_diopter = replace(optics, object_distance=np.inf).displacement(1.0)
    reach = (
        0.8 * LONGEST_WAVEFRONT * 8 * optics.f_number**2 * scene.wavelengths[0] * 1e-9 / per_diopter
    )
    far, near = (
        max(1 / farthest, 1 / scene.depth.min() - reach),
        min(1 / nearest, 1 / scene.depth.max() + reach),
    )
    if not far < near:
        raise OutOfRange(
            "depth",
            f"{scene.depth.min():.4g} .. {scene.depth.max():.4g} m",
            f"within {reach:.4g} dioptres of the focus: {LONGEST_WAVEFRONT:g} waves",
        )
    return far, near


class _Trials:
    """The contrast of a region at trial positions, each of which is measured once.

    found: vergence [1/m] -> contrast and its standard error [1]. Raises OutOfRange for a region that is too small.
    """

    def __init__(self, simulator, scene, region, seed):
        sensor, readout = simulator.camera.sensor, simulator.readout
        self._program, self._seed = simulator.program(scene), seed
        self._period = (1, 1) if sensor.stacked else readout.output.cfa_indices.shape
        self._region = _checked_region(region, readout.output_shape(scene.shape), self._period)
        self.found: dict[float, tuple[float, float]] = {}

    def __call__(self, vergence):
        """The contrast at a vergence [1/m]; exposed as the first trial was."""
        if vergence not in self.found:
            simulator = self._program.simulator
            focused = replace(simulator.camera.optics, object_distance=_distance(vergence))
            program = self._program.update(camera=replace(simulator.camera, optics=focused))
            exposure = program.exposure
            raw = program.raw(seed=self._seed, frame=len(self.found))
            raw = exposure.layered(np.asarray(simulator.device.numpy(raw)))
            program.update(
                exposure_time=exposure.exposure_time, gain=exposure.gain
            )  # of the next trials
            raw = (
                raw[len(raw) // 2] if simulator.camera.sensor.stacked else raw
            )  # the middle channel
            operated = exposure.camera.sensor
            self.found[vergence] = _contrast(
                raw[self._region].astype(float) - operated.dark_level,
                operated,
                self._period,
                exposure.exposure_time,
                simulator.readout.averaged,
            )
        return self.found[vergence][0]

    def require_rise(self):
        """Refuse a scene whose contrast is the same at every focus, but for noise. Raises BadData."""
        (least, error), (most, _) = min(self.found.values()), max(self.found.values())
        if not most - least > max(CERTAIN * error, LEAST_RISE * abs(least), 1e-12):
            raise BadData(
                f"{self._program.scene.name}: no detail to focus on: contrast {least:.3g} .. {most:.3g}, "
                f"standard error {error:.2g}; choose a region with an edge or texture, or more light"
            )


def _distance(vergence):
    return 1 / vergence if vergence > 0 else np.inf


def _checked_region(region, shape, period):
    """Rows and columns in which contrast is measured. Raises OutOfRange."""
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
    """Mean squared difference of neighbours of one colour over the squared mean, and its standard error.

    What the sensor's noise is known to add is taken away: it grows as the trials get darker.
    raw: digital numbers above the dark level [DN]. averaged: pixels whose digital numbers are one's.
    """
    level, gain = raw.mean(), sensor.gain_dn_per_electron
    if not level > 0:
        return 0.0, 0.0
    dark = (
        sensor.noise.dark_current * sensor.noise.warmth * exposure_time
    )  # a part of the level's electrons
    noise = gain**2 * RawNoise.of(sensor, averaged).difference(level / gain, level / gain - dark)
    squares = np.concatenate(
        [
            ((raw[step:] - raw[:-step]) ** 2).ravel()
            if axis == 0
            else ((raw[:, step:] - raw[:, :-step]) ** 2).ravel()
            for axis, step in enumerate(period)
        ]
    )
    return float((squares.mean() - noise) / level**2), float(
        squares.std() / np.sqrt(squares.size) / level**2
    )

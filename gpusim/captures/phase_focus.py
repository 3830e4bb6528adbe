"""Phase-detection autofocus: one measurement out of focus, one move of the lens."""

from dataclasses import dataclass, replace

import numpy as np

from gpusim.captures.disparity import defocus_from_disparity, disparity
from gpusim.captures.focus import check_region, focus_steps
from gpusim.domain.dual import DualPixels
from gpusim.domain.errors import BadData, Conflict
from gpusim.domain.optics import Optics
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.scene import Scene
from gpusim.domain.sensor import Sensor
from gpusim.domain.short_repr import short_repr
from gpusim.pipeline.diodes import diode_sensor, is_sparse
from gpusim.pipeline.simulator import Simulator

LEAST_PAIRS = 8  # phase-detection pixels along the disparity


@dataclass(frozen=True, eq=False)
class PhaseFocus:
    """Result of the phase-detection autofocus.

    Attributes:
        optics: The lens, focused there.
        disparity: Displacement of the second picture from the first [pixel].
        defocus: Defocus that was measured, positive for objects beyond the plane in focus [1/m].
        uncertainty: Its standard deviation by the noise [1/m].
        depth_of_focus: Half of the range that is equally sharp, in dioptres [1/m].
    """

    optics: Optics
    disparity: float
    defocus: float
    uncertainty: float
    depth_of_focus: float

    __repr__ = short_repr

    @property
    def object_distance(self) -> float:
        """Distance of the plane in focus [m]."""
        return self.optics.object_distance

    @property
    def is_certain(self) -> bool:
        """Whether two standard deviations are within the depth of focus."""
        return 2 * self.uncertainty <= self.depth_of_focus


def phase_focus(
    simulator: Simulator,
    scene: Scene,
    *,
    region: tuple[slice, slice] | None = None,
    seed: int = 0,
    first: int = 0,
) -> PhaseFocus:
    """Focus the camera of `simulator` on a region by the disparity of one exposure.

    Args:
        simulator: Simulator whose camera has dual or quad pixels, or sparse phase-detection pixels.
        scene: The scene.
        region: Rows and columns of the raw picture [pixel]; None is the middle third.
        seed: Seed of the noise.
        first: Number of the frame.

    Returns:
        The lens after the move, and the measurement.

    Raises:
        BadData: The region has no texture along the split, or too few phase-detection pixels.
        Conflict: The camera has neither dual nor phase-detection pixels, or they are stacked or binned.
        OutOfRange: The region is too small.
    """
    camera, sensor = simulator.camera, simulator.camera.sensor
    dual = sensor.dual
    if dual is None or sensor.stacked or sensor.binning != (1, 1):
        raise Conflict(
            "phase_focus",
            "the camera has no dual pixels, or they are stacked or binned",
            'set sensor.dual = {split = "left-right"}, or call autofocus',
        )
    period = dual.cell if is_sparse(camera) else sensor.cfa_indices.shape
    part = check_region(region, scene.shape, period)
    exposure = simulator.expose(scene)
    if is_sparse(camera):
        raw = np.asarray(simulator.device.numpy(exposure.raw(seed=seed, first=first)), float)
        pair, step, apart = _phase_pictures(raw, dual, part)
        own, count = exposure.camera.sensor, 1
    else:
        raw = np.asarray(simulator.device.numpy(exposure.raw_dual(seed=seed, first=first)), float)
        pair = _divided_pictures(raw, dual, period, part)
        step, apart = period, 0.0
        count = int(np.prod(period)) * (2 if dual.split == "quad" else 1)
        own = diode_sensor(exposure.camera.sensor, len(dual.diodes))
    axis = 0 if dual.split == "up-down" else 1
    gain = own.gain_dn_per_electron
    pair = [(one - count * own.dark_level) / gain for one in pair]
    noise = [count * _variance(own, max(one.mean() / count, 0.0)) for one in pair]
    size = pair[0].shape
    if size[axis] < LEAST_PAIRS:
        raise BadData(
            f"phase_focus: {size[axis]} pairs of pixels along the split, wanted {LEAST_PAIRS} or more; choose a "
            "larger region"
        )
    split = "up-down" if axis == 0 else "left-right"
    block = size[0], size[1]
    found = disparity(*pair, noise=(noise[0], noise[1]), block=block, split=split)
    moved, error = (float(one[0, 0]) * step[axis] for one in (found.values, found.uncertainty))
    if not np.isfinite(error):
        raise BadData(
            f"{scene.name}: no detail to focus on; choose a region with an edge or texture, or more light"
        )
    moved += apart
    defocus = float(defocus_from_disparity(moved, camera, shape=scene.shape))
    per_pixel = abs(float(defocus_from_disparity(moved + 1, camera, shape=scene.shape)) - defocus)
    optics = camera.optics
    vergence = 1 / optics.object_distance - defocus
    nearest = 1 / (1.01 * optics.focal_length)
    distance = 1 / min(vergence, nearest) if vergence > 0 else np.inf
    return PhaseFocus(
        replace(optics, object_distance=distance),
        moved,
        defocus,
        error * per_pixel,
        focus_steps(camera)[1],
    )


def _variance(sensor: Sensor, electrons):
    """Variance of a pixel's noise at its mean electrons, those of the dark current included [e-^2]."""
    noise = RawNoise.of(sensor)
    return noise.variance(electrons) + noise.response * electrons**2


def _divided_pictures(raw, dual, period, region):
    """Pictures of both halves of the pupil, added over the mosaic's periods, of raw values (n, rows, cols) [DN]."""
    if dual.split == "quad":  # left and right, each at the top and at the bottom
        raw = np.stack([raw[0] + raw[2], raw[1] + raw[3]])
    rows, cols = (part.indices(n)[:2] for part, n in zip(region, raw.shape[1:], strict=True))
    first = [-(-low // n) * n for (low, _), n in zip((rows, cols), period, strict=True)]
    count = [
        (high - start) // n for (_, high), start, n in zip((rows, cols), first, period, strict=True)
    ]
    part = raw[
        :, first[0] : first[0] + count[0] * period[0], first[1] : first[1] + count[1] * period[1]
    ]
    return part.reshape(2, count[0], period[0], count[1], period[1]).sum(axis=(2, 4))


def _phase_pictures(raw, dual: DualPixels, region):
    """Pictures of phase-detection pixels, their distance (rows, cols), and how far the second are from the first."""
    axis = 0 if dual.split == "up-down" else 1
    pairs = [[place[:2] for place in dual.places if place[2] == side] for side in dual.diodes]
    if not all(pairs):
        raise BadData("phase_focus: sensor.dual.places see one half only, wanted both halves")
    first = pairs[0][0]
    second = min(
        pairs[1], key=lambda one: (one[1 - axis] != first[1 - axis], abs(one[axis] - first[axis]))
    )
    pictures = []
    for row, col in (first, second):
        lines = [
            slice(-(-(part.indices(n)[0] - at) // size) * size + at, part.indices(n)[1], size)
            for part, n, at, size in zip(region, raw.shape, (row, col), dual.cell, strict=True)
        ]
        pictures.append(raw[lines[0], lines[1]])
    size = [min(one.shape[k] for one in pictures) for k in (0, 1)]
    starts = [
        -(-(region[axis].indices(raw.shape[axis])[0] - one[axis]) // dual.cell[axis])
        * dual.cell[axis]
        + one[axis]
        for one in (first, second)
    ]
    pictures = [one[: size[0], : size[1]] for one in pictures]
    return pictures, dual.cell, float(starts[1] - starts[0])

"""Dual and quad pixels, and phase-detection pixels: what each photodiode of a frame collects, and its raw values.

A frame of a camera with divided pixels is the ordinary frame. The light of one side is a frame of the same camera whose
lens is `gpusim.optics.split_lens.SplitLens`, times the share of that side. The last diode has the rest.
"""

from dataclasses import replace
from math import hypot, prod
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from gpusim.domain.camera import Camera
from gpusim.domain.dual import SIDES, Diode, DiodeOptics, DualPixels, count_diodes
from gpusim.domain.errors import Conflict, OutOfRange
from gpusim.domain.sensor import Sensor
from gpusim.kernels.sensor.divide import divide
from gpusim.optics.lenses import open_lens
from gpusim.optics.split_lens import SplitLens
from gpusim.pipeline.cache import Cache
from gpusim.pipeline.readout import Readout
from gpusim.planner.plan import Plan
from gpusim.planner.question import find_axis

if TYPE_CHECKING:
    from gpusim.pipeline.simulator import Simulator

SHARE_NODES = 17  # of a frame, along each axis, between which shares are cubic
OWN_SEED = 2**63  # differs between the readings of pixels and of diodes, whose noise is independent


def divided(camera: Camera) -> DualPixels:
    """Return the camera's divided pixels. Raises Conflict if it has none."""
    dual = camera.sensor.dual
    if count_diodes(dual) == 1:
        raise Conflict(
            "sensor.dual",
            "the camera has no photodiodes that divide all pixels",
            'set sensor.dual = {split = "left-right"}',
        )
    assert dual is not None
    return dual


def is_sparse(camera: Camera) -> bool:
    """Return True if some pixels of the camera are phase-detection pixels."""
    return camera.sensor.dual is not None and bool(camera.sensor.dual.sparse)


def flag_places(camera: Camera) -> Camera:
    """Return the camera; one with phase-detection pixels replaces them in development as known defects."""
    if not is_sparse(camera) or camera.processor.defects == "known":
        return camera
    return replace(camera, processor=replace(camera.processor, defects="known"))


def require_no_places(camera: Camera, what: str) -> None:
    """Raise Conflict if some pixels are phase-detection pixels. what: the use that does not fill them in."""
    if is_sparse(camera):
        raise Conflict(
            f"{what} of sparse phase-detection pixels",
            "only frames and exposures hold them",
            "call the simulator, or its frames or expose; or set sensor.dual for all pixels",
        )


def diode_camera(camera: Camera, side: str, shape: tuple[int, int]) -> Camera:
    """Return a camera whose pixels all see the light of one side.

    Args:
        camera: A camera with divided or phase-detection pixels.
        side: A key of `gpusim.domain.dual.SIDES`.
        shape: Rows and columns of the frame.
    """
    sensor, dual = camera.sensor, camera.sensor.dual
    assert dual is not None
    window, offset = list(sensor.aperture), list(sensor.offset)
    if dual.sparse == "shared":  # both pixels, and the border between them, under one microlens
        axis = 0 if SIDES[side][0] else 1
        window[axis] += sensor.pixel_pitch
        offset[axis] -= SIDES[side][axis] / 2
    corner = hypot(*shape) / 2 * sensor.pixel_pitch
    diode = Diode(dual, side, (window[0], window[1]), corner)
    return replace(
        camera,
        optics=DiodeOptics.of(camera.optics, diode),
        sensor=replace(sensor, dual=None, offset=(offset[0], offset[1])),
    )


def diode_sensor(sensor: Sensor, count: int) -> Sensor:
    """Return a sensor of one photodiode a pixel: its part of the full well and the dark current, the pixel's gain."""
    noise = sensor.noise
    return replace(
        sensor,
        dual=None,
        full_well=sensor.full_well / count,
        gain=sensor.gain_dn_per_electron / sensor.analog_gain,
        conversion_gain=None,
        adc_range=None,
        noise=replace(
            noise,
            dark_current=noise.dark_current / count,
            hot_current=noise.hot_current / count,
        ),
    )


def find_shares(camera: Camera, plan: Plan) -> np.ndarray:
    """Return the share of a diode in the light of pixels, (1, 1) or as the mosaic or the frame repeats it.

    Args:
        camera: Made by `diode_camera`.
        plan: Its plan.

    Returns:
        Shares, float32 (rows, cols), layers of stacked pixels below each other.
    """
    sensor, (rows, cols), optics = camera.sensor, plan.scene.shape, camera.optics
    lens = open_lens(optics, sensor.pixel_pitch, 1.0, plan.scene.shape)
    assert isinstance(optics, DiodeOptics) and optics.diode is not None
    if not isinstance(lens, SplitLens):  # no wave, no direction
        return np.full((1, 1), 0.5 ** sum(map(abs, optics.diode.signs)), np.float32)
    bands, weights = plan.scene.wavelengths, plan.weights
    weights = weights / np.maximum(weights.sum(axis=1, keepdims=True), 1e-300)
    layers = sensor.cfa_indices
    if optics.split_height == 0:
        own = (weights @ lens.totals(bands))[layers]
        if np.ptp(own) < 1e-7:
            return np.full((1, 1), own.mean(), np.float32)
        return np.repeat(own.T, rows, axis=0) if sensor.stacked else own.astype(np.float32)
    axis, middle = find_axis(optics, plan.scene.shape, sensor.pixel_pitch)[1], hypot(rows, cols) / 2
    y, x = (np.linspace(-0.5, n - 0.5, SHARE_NODES) for n in (rows, cols))
    places = [
        [
            ((i - (rows - 1) / 2 - axis[0]) / middle, (j - (cols - 1) / 2 - axis[1]) / middle)
            for j in x
        ]
        for i in y
    ]
    found = np.array([[weights @ lens.totals(bands, place) for place in line] for line in places])
    every = np.array(
        [
            scipy.interpolate.RectBivariateSpline(y, x, found[..., channel])(
                np.arange(rows), np.arange(cols)
            )
            for channel in range(len(weights))
        ]
    )
    if sensor.stacked:
        return every.reshape(-1, cols).astype(np.float32)
    high, wide = -(-rows // len(layers)), -(-cols // len(layers[0]))
    channel = np.tile(layers, (high, wide))[:rows, :cols]
    return np.take_along_axis(every, channel[None], axis=0)[0].astype(np.float32)


class Diodes:
    """The photodiodes of a simulator's frames of one shape.

    Args:
        simulator: The simulator.
        shape: Rows and columns of the frames.

    Attributes:
        names: Names of the sides that are simulated.
        simulators: A simulator of the light of each of them.
    """

    def __init__(self, simulator: "Simulator", shape: tuple[int, int]):
        camera, dual = simulator.camera, simulator.camera.sensor.dual
        assert dual is not None
        self.count = count_diodes(dual)
        used = {place[2] for place in dual.places} if dual.sparse else dual.diodes[:-1]
        self.names = tuple(name for name in dual.diodes if name in used)
        self.simulators = [
            simulator.apart(diode_camera(camera, name, shape), Cache()) for name in self.names
        ]
        for one in self.simulators:
            one.strict = False  # the frame's own plan is judged
        self._shares: dict[int, tuple] = {}
        self._readout: tuple | None = None

    def shares(self, number: int, plan: Plan) -> np.ndarray:
        """Return the shares of a side in the light of a plan: see `find_shares`."""
        known = self._shares.get(number)
        if known is None or known[0] is not plan:
            camera = self.simulators[number].camera
            known = self._shares[number] = plan, find_shares(camera, plan)
        return known[1]

    def divide(self, whole: Any, parts: list, plans: list[Plan], device: Any) -> Any:
        """Return the mean electrons of all diodes, a device array (n, ...) [e-].

        Args:
            whole: Mean electrons of the pixels, (..., rows, cols) [e-].
            parts: Those of each simulated side's light, of the same shape [e-].
            plans: Plans of these.
            device: The device.
        """
        form = prod(whole.shape[:-1]), whole.shape[-1]
        planes = device.stack([device.reshape(part, form) for part in parts])
        shares = [self.shares(number, plan) for number, plan in enumerate(plans)]
        largest = max((one.shape for one in shares), key=prod)
        every = np.array([np.broadcast_to(one, largest) for one in shares])
        found = divide(device.reshape(whole, form), planes, every, device=device)
        return device.reshape(found, (len(parts) + 1, *whole.shape))

    def readout(self, simulator: "Simulator") -> Readout:
        """Return the readout of the diodes, one layer of pixels for each."""
        if self._readout is None or self._readout[0] is not simulator.readout:
            sensor = diode_sensor(simulator.readout.sensor, self.count)
            self._readout = simulator.readout, Readout(sensor, simulator.device, Cache())
        return self._readout[1]

    def draw(
        self,
        simulator: "Simulator",
        means: Any,
        exposure_time: float,
        gain: float,
        seed: int,
        first: int,
        frames: int | None = None,
    ) -> Any:
        """Return raw values of the diodes, a device array ([frames,] n, rows, cols) [DN], each read by itself.

        It raises OutOfRange if blocks of binned pixels do not fill the rows.
        """
        readout, device = self.readout(simulator), simulator.device
        block = readout.sensor.binning[0] * readout.stride[0]
        if readout.sensor.binning != (1, 1) and means.shape[-2] % block:
            raise OutOfRange(
                "frame size",
                f"{means.shape[-1]}x{means.shape[-2]}",
                f"rows in multiples of {block}: photodiodes are binned in whole blocks",
            )
        expected = readout.chip_mean(means, exposure_time)
        raw = readout.draw(expected, exposure_time, gain, seed ^ OWN_SEED, first, frames)
        lead = tuple(raw.shape[:-2])
        return device.reshape(raw, (*lead, self.count, raw.shape[-2] // self.count, raw.shape[-1]))


def phase_places(dual: DualPixels, shape: tuple[int, int]) -> np.ndarray:
    """Return which side's pixel is where: 0 none, 1 the first of `dual.diodes`, 2 the second, uint8 (rows, cols)."""
    cell = np.zeros(dual.cell, np.uint8)
    for row, col, side in dual.places:
        cell[row, col] = 1 + dual.diodes.index(side)
    return np.tile(cell, [-(-n // m) for n, m in zip(shape, dual.cell, strict=True)])[
        : shape[0], : shape[1]
    ]


def put_phase_pixels(mean: np.ndarray, parts: dict[str, tuple], dual: DualPixels) -> np.ndarray:
    """Return mean electrons of a frame with phase-detection pixels [e-].

    Args:
        mean: Mean electrons of ordinary pixels, (rows, cols) [e-].
        parts: Side -> mean electrons of all light as it sees it, and its shares.
        dual: The places.
    """
    found, places = mean.copy(), phase_places(dual, mean.shape)
    area = 2 if dual.sparse == "shared" else 1  # a microlens collects the light of two pixels
    for number, side in enumerate(dual.diodes, start=1):
        here = places == number
        if here.any():
            part, shares = parts[side]
            repeats = [-(-n // m) for n, m in zip(mean.shape, shares.shape, strict=True)]
            share = np.tile(shares, repeats)[: mean.shape[0], : mean.shape[1]]
            found[here] = area * (share * part)[here]
    return found

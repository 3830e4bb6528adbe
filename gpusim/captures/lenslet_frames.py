"""Raw frames of a camera with lenslets before its pixels."""

import warnings
from dataclasses import dataclass, replace
from math import prod
from typing import Any

import numpy as np

from gpusim.backends.tape import Tape, recording
from gpusim.captures.lenslets import apply_lenslets
from gpusim.captures.views import ViewCapture, Views
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.exposure import checked_gain, checked_time
from gpusim.domain.light_field import LightField
from gpusim.domain.scene import Scene
from gpusim.domain.short_repr import shorten_repr
from gpusim.kernels.sensor.collect import collect
from gpusim.optics.lenslets import LensletSamples, lenslet_samples
from gpusim.pipeline.exposure import operated_camera
from gpusim.pipeline.metering import choose_exposure, meter_light, metering_numbers
from gpusim.pipeline.simulator import Simulator

MOST_CELLS = 16  # along each axis of the pupil, by default


@dataclass(frozen=True, eq=False)
class LensletExposure:
    """The noise-free exposure of pixels behind lenslets. Noisy raw frames are drawn from it.

    `np.asarray` returns the mean electrons.

    Attributes:
        views: Light of the pupil's cells in the plane of the lenslets.
        camera: The camera as operated.
        mean: Mean electrons of each pixel, a device array (rows, cols), or (C, rows, cols) of stacked pixels [e-].
        chip_mean: The same with the chip's fixed pattern [e-].
        exposure_time: Exposure time [s].
        gain: Analog gain, next to the sensor's [1].
    """

    views: Views
    camera: Camera
    mean: Any
    chip_mean: Any
    exposure_time: float
    gain: float

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.views.simulator.device.numpy(self.mean), dtype, copy=copy)

    def __repr__(self):
        return shorten_repr(
            f"LensletExposure({self.views.scene.name} by {self.camera.name}, {1e3 * self.exposure_time:.4g} ms, "
            f"gain {self.gain:g}, mean {tuple(self.mean.shape)})"
        )

    def raw(self, *, seed: int = 0, first: int = 0, frames: int | None = None) -> Any:
        """Return raw values with all noise of the sensor.

        Args:
            seed: Seed of the noise.
            first: Number of the frame, or of the first one.
            frames: Number of frames; None draws one without the first axis.

        Returns:
            A device array (rows, cols) or (frames, rows, cols), layers of stacked pixels below each other [DN].

        Raises:
            DoesNotFit: The frames need more memory than the device has.
            OutOfRange: The seed or a number is not allowed.
        """
        draw = self.views.simulator.readout.draw
        return draw(self.chip_mean, self.exposure_time, self.gain, seed, first, frames)


class LensletCapture:
    """Exposes a camera with lenslets, frame after frame. Plans and tables are made once.

    Args:
        simulator: The simulator; its camera has lenslets.
        scene: A scene or a light field. Its `samples_per_pixel` counts samples per sample of the lenslets' plane, which
            are one or more per lenslet, see `gpusim.optics.lenslets.lenslet_samples`.
        views: Rows and columns of cells of the pupil; None: the light field's, or as many as a lenslet has pixels, at
            most 16.

    Raises:
        BadData: The camera has no lenslets, or a lens that cannot be cut.
        DoesNotFit: The views need more memory than the device has.
        OutOfRange: The lenslets do not fit the sensor.
    """

    def __init__(
        self,
        simulator: Simulator,
        scene: Scene | LightField,
        views: tuple[int, int] | None = None,
    ):
        camera = simulator.camera
        lenslets = camera.sensor.lenslets
        if lenslets is None:
            raise BadData(
                f"camera {camera.name}: no lenslets before its pixels; set [sensor] lenslets, or use expose_views"
            )
        if views is None and not isinstance(scene, LightField):
            views = (min(round(lenslets.pitch / camera.sensor.pixel_pitch), MOST_CELLS),) * 2
        self.simulator = simulator
        first = scene.view(0, 0) if isinstance(scene, LightField) else scene
        self.samples = fit_samples(camera, first.shape)
        self._views = ViewCapture(
            simulator.update(camera_at_lenslets(camera, self.samples)), scene, views
        )
        self._tape, self._of, self._made = Tape(), None, None

    def __repr__(self):
        rows, cols = self.samples.pixels
        return shorten_repr(f"LensletCapture({self.simulator.camera.name}, {cols}x{rows} pixels)")

    def __call__(
        self,
        scene: Scene | LightField | None = None,
        exposure_time: float | None = None,
        gain: float = 1.0,
    ) -> LensletExposure:
        """Return the exposure of the scene, or of another one of the same kind.

        Args:
            scene: Another scene; None: the one of the last call.
            exposure_time: Exposure time [s]; None: the camera's, or the one that automatic exposure chooses.
            gain: Analog gain, next to the sensor's [1]; automatic exposure chooses it.

        Returns:
            The exposure. The next call rewrites its arrays.

        Raises:
            BadData: The plans do not serve that scene, or automatic exposure finds no light.
            OutOfRange: An exposure time or gain is not allowed.
        """
        seconds, gain = checked_time(exposure_time), checked_gain(gain)
        simulator, device, readout = self.simulator, self.simulator.device, self.simulator.readout
        sensor, views = simulator.camera.sensor, self._views(scene)
        if seconds is None:
            seconds = sensor.exposure_time
        pixels = self._behind(views)
        if seconds is None:
            light = meter_light(pixels, automatic=sensor.auto_exposure, device=device)
            numbers = metering_numbers(sensor, readout)
            seconds, gain = choose_exposure(device.numpy(light), prod(pixels.shape), **numbers)
        mean = collect(pixels, None, seconds, 0.0, device=device)
        if mean.shape[0] == 1:
            mean = device.reshape(mean, tuple(mean.shape[1:]))
        camera = operated_camera(simulator.camera, readout, gain)
        return LensletExposure(
            replace(views, simulator=simulator),
            camera,
            mean,
            readout.chip_mean(mean, seconds),
            seconds,
            gain,
        )

    def _behind(self, views: Views) -> Any:
        """Return electrons per second of the pixels, (1 or C, rows, cols)."""
        tape, device = self._tape, self.simulator.device
        if self._of is views.rates and tape.is_replayable and tape.commands:
            tape.replay()
        else:
            with recording(tape):
                self._made = apply_lenslets(
                    device, views.rates, self.simulator.camera, self.samples
                )
            self._of = views.rates
        return self._made


def expose_lenslets(
    simulator: Simulator,
    scene: Scene | LightField,
    views: tuple[int, int] | None = None,
    exposure_time: float | None = None,
    gain: float = 1.0,
) -> LensletExposure:
    """Return the exposure of a scene by a camera with lenslets before its pixels.

    Args:
        simulator: The simulator; its camera has lenslets.
        scene: A scene, with its depth, or a light field, see `LensletCapture`.
        views: Rows and columns of cells of the pupil, see `LensletCapture`.
        exposure_time: Exposure time [s]; None: the camera's, or the one that automatic exposure chooses.
        gain: Analog gain, next to the sensor's [1]; automatic exposure chooses it.

    Returns:
        The exposure.

    Raises:
        BadData: The camera has no lenslets, or a lens that cannot be cut.
        DoesNotFit: The views need more memory than the device has.
        OutOfRange: The lenslets do not fit the sensor, or an exposure time or gain is not allowed.
    """
    return LensletCapture(simulator, scene, views)(None, exposure_time, gain)


def fit_samples(camera: Camera, shape: tuple[int, int]) -> LensletSamples:
    """Return the samples of the lenslets' plane of a frame, and the number of pixels that they cover.

    Args:
        camera: A camera with lenslets.
        shape: Rows and columns of samples.
    """
    sensor, optics = camera.sensor, camera.optics
    lenslets = sensor.lenslets
    assert lenslets is not None
    least = 2 * int(np.ceil(lenslets.pitch / sensor.pixel_pitch)) + 2
    with warnings.catch_warnings():  # the second call repeats them
        warnings.simplefilter("ignore")
        pitch = lenslet_samples(lenslets, sensor, optics, (least, least)).pitch
    rows, cols = (max(round(n * pitch / sensor.pixel_pitch), 1) for n in shape)
    wanted = lenslet_samples(lenslets, sensor, optics, (rows, cols))
    # samples lie on those wanted; both grids are symmetric about their middles
    down, across = (
        (own + (n - size) / 2 + 0.5) % 1 - 0.5
        for own, n, size in zip(wanted.offset, wanted.shape, shape, strict=True)
    )
    return replace(wanted, shape=(shape[0], shape[1]), offset=(down, across))


def camera_at_lenslets(camera: Camera, samples: LensletSamples) -> Camera:
    """Return the camera with the samples of the lenslets' plane in place of its pixels."""
    sensor = replace(
        camera.sensor,
        lenslets=None,
        pixel_pitch=samples.pitch,
        fill_factor=1.0,
        photodetector=None,
        centre=(0.0, 0.0),
        offset=samples.offset,
        microlens=None,
        vignetting=None,
        binning=(1, 1),
    )
    return camera.with_(sensor=sensor)

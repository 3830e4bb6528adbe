"""Arrays of the picture that is shown, and pictures of the light before the sensor."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from gpusim.apps.preview.measures import Inputs, on_host
from gpusim.apps.preview.state import State
from gpusim.backends import Device
from gpusim.captures.capture import Capture, Light, Shot
from gpusim.domain.account import Account, Tolerance
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.scene import Scene
from gpusim.pipeline.cache import same
from gpusim.pipeline.developer import rendering_name
from gpusim.pipeline.exposure import output_of, read_mean
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.loop import Loop
from gpusim.pipeline.simulator import Simulator
from gpusim.plot.light import observed_codes, observer_camera, radiance_codes

MOST_BYTES = 2**28  # of an irradiance on the host
DEVELOPED = {"linear", "codes", "times"}  # needs that the image processor fills


class Shown:
    """A frame of a loop, with the fields of a Frame that the preview shows.

    Args:
        loop: The loop. The fields are read before its next change.
        seed: Seed of the noise.
        number: Number of the frame.
    """

    def __init__(self, loop: Loop, seed: int, number: int):
        self.loop, self._numbers = loop, {"seed": seed, "first": number}

    @property
    def camera(self) -> Camera:
        """The camera as operated."""
        return self.loop.expose().camera

    @property
    def rgb(self) -> np.ndarray:
        """Display codes (rows, cols, 3)."""
        return self._on_host(self.loop.codes(**self._numbers))

    @property
    def raw(self) -> np.ndarray:
        """Digital numbers (..., rows, cols) [DN]."""
        raw = self._on_host(self.loop.raw(**self._numbers))
        return self.loop.expose().split_layers(raw)

    @property
    def mean(self) -> np.ndarray:
        """Mean electrons (..., rows, cols) of the frame's pixels [e-]."""
        return read_mean(self.loop.expose().mean, readout=self.loop.simulator.readout)

    def fill(self, needs: Iterable[str], found: dict[str, Any]) -> dict[str, Any]:
        """Add arrays for panels to `found` by name, and with "linear" also "rendering"; return times.

        The frame is drawn beside the loop's own outputs, whose recorded commands it leaves alone.
        """
        needs, exposure = set(needs), self.loop.expose()
        ms: dict[str, float] = {}
        if "mean" in needs:
            found["mean"] = self.mean
        if not needs & {"raw", *DEVELOPED}:
            return ms
        device = self.loop.simulator.device
        if "times" in needs:
            with device.timed() as ms:
                raw = self._develop(exposure, needs, found)
        else:
            raw = self._develop(exposure, needs, found)
        if "raw" in needs:
            found["raw"] = exposure.split_layers(self._on_host(raw))
        return ms

    def _develop(self, exposure, needs, found):
        """Draw a frame and add what the image processor makes of it; return the raw values."""
        raw = exposure.raw(**self._numbers)
        if needs & DEVELOPED:
            values = exposure.values()
            linear = output_of(values, "linear", raw=raw)
            if needs & {"codes", "times"}:
                codes = values["codes"]
            if "codes" in needs:
                found["codes"] = self._on_host(codes)
            if "linear" in needs:
                found["linear"] = np.moveaxis(self._on_host(linear), 0, -1)
                found["rendering"] = values[rendering_name(exposure.camera)]
        return raw

    def _on_host(self, array):
        return on_host(self.loop.simulator.device, array)


@dataclass(frozen=True, eq=False)
class Made:
    """The picture that was made last.

    Attributes:
        state: Its settings.
        loop: Its loop.
        frame: Its frame: Shown, or a Frame of a capture.
        account: Predicted errors; None of a draft.
        tolerance: Their limits, or None.
    """

    state: State
    loop: Loop
    frame: "Shown | Frame"
    account: Account | None
    tolerance: Tolerance | None

    def inputs(self, needs: frozenset[str], ms: dict[str, float], irradiance=None) -> Inputs:
        """Return what panels need.

        needs: names of arrays of Inputs, and "times". ms: times of the steps so far, which are
        brought up to date. irradiance: array of this name, or None.
        """
        frame, loop = self.frame, self.loop
        found: dict[str, Any] = {}
        simulator = loop.simulator
        if isinstance(frame, Shown):
            exposure = loop.expose()
            ms.update(frame.fill(needs, found))
            seconds, averaged = exposure.exposure_time, simulator.readout.averaged
            rendering = found.pop("rendering", None)
        else:
            names = {"codes": "rgb"}
            found = {name: getattr(frame, names.get(name, name)) for name in needs - {"times"}}
            seconds, averaged, rendering = frame.exposure_time, frame.averaged, frame.rendering
            if "times" in needs:
                ms.update({stage.stage: stage.ms for stage in frame.report.stages})
        if irradiance is not None:
            found["irradiance"] = irradiance
        return Inputs(
            self,
            simulator.camera,
            frame.camera,
            loop.scene,
            seconds,
            averaged,
            simulator.readout.pixels,
            rendering,
            self.account,
            self.tolerance,
            dict(ms),
            found,
        )


class Optics:
    """Light before the sensor, of one client: kept while it stays the same.

    Args:
        device: Device of the simulators.
    """

    def __init__(self, device: Device):
        self._device = device
        self._seen: tuple = (None, None)  # a scene and its picture
        self._loop: Loop | None = None  # of the observer
        self._observer: tuple = (None, None)  # a camera's light and the observer's camera
        self._tolerance: str | None = None
        self._imaged: tuple = ()  # what an irradiance picture depends on, and the picture
        self._spectral: tuple = (None, None)  # what an irradiance depends on, and the array

    def scene_codes(self, scene: Scene) -> np.ndarray:
        """Return the radiance of a scene as sRGB codes (rows, cols, 3), see `radiance_codes`."""
        if self._seen[0] is not scene:
            self._seen = scene, _bytes(radiance_codes(scene)[0])
        return self._seen[1]

    def irradiance_codes(
        self, camera: Camera, scene: Scene, tolerance: str | None, drafts: bool
    ) -> np.ndarray:
        """Return the irradiance behind the lens as sRGB codes, see `gpusim.plot.optical_image`."""
        key = _light_of(camera)
        if not same(self._observer[0], key):
            self._observer = key, observer_camera(camera)
        observer = self._observer[1]
        now = scene, observer, tolerance, drafts
        if self._imaged and same(self._imaged[0], now):
            return self._imaged[1]
        if self._loop is None or tolerance != self._tolerance:
            simulator = Simulator(observer, device=self._device, tolerance=tolerance)
            self._loop, self._tolerance = simulator.loop(scene), tolerance
        try:
            self._loop.update(camera=observer, scene=scene, drafts=drafts)
            electrons = on_host(self._device, self._loop.output("electrons"))
        except Exception:
            self._loop = None
            raise
        self._imaged = now, _bytes(observed_codes(observer, scene, electrons)[0])
        return self._imaged[1]

    def forget(self, view: str) -> None:
        """Free what only other views than this one need."""
        if view != "irradiance":
            self._loop, self._imaged = None, ()
        if view != "scene":
            self._seen = None, None

    def irradiance(self, made: Made, capture: Capture | None) -> np.ndarray:
        """Return the irradiance at each wavelength of the scene, (L, rows, cols), float32.

        Its unit is photon s-1 m-2 nm-1. Raises BadData for a large frame or a blur that varies over
        the field, and Conflict for a scene that moves.
        """
        key = _spectral_key(made)
        if not same(self._spectral[0], key):
            try:
                self._spectral = key, self._spectral_light(made.loop, capture)
            except Exception as error:  # not tried again for the same light
                self._spectral = key, error.with_traceback(None)
        if isinstance(self._spectral[1], Exception):
            raise self._spectral[1]
        return self._spectral[1]

    def _spectral_light(self, loop, capture):
        scene = loop.scene
        size = 4 * len(scene.wavelengths) * scene.shape[0] * scene.shape[1]
        if size > MOST_BYTES:
            raise BadData(
                f"irradiance of {scene.shape[1]}x{scene.shape[0]} pixels at {len(scene.wavelengths)} "
                f"wavelengths: {size / 2**20:.0f} MiB; wanted {MOST_BYTES / 2**20:.0f} MiB at most, "
                "a smaller frame"
            )
        light = Light.of(capture or Capture(), loop, 0)
        array = light.channels(Shot(loop.expose(), 0, 0), "irradiance")
        return on_host(self._device, array)

    def known_irradiance(self, made: Made) -> np.ndarray | None:
        """Return the result of `irradiance` if it is known, else None."""
        key, array = self._spectral
        is_known = isinstance(array, np.ndarray) and same(key, _spectral_key(made))
        return array if is_known else None

    def forget_irradiance(self) -> None:
        """Free the array of `irradiance`."""
        self._spectral = None, None


def _spectral_key(made):
    """Return what an irradiance depends on."""
    loop = made.loop
    return loop.scene, made.state.tolerance, _light_of(loop.simulator.camera)


def _light_of(camera):
    """Return what the light on the pixels depends on beside the scene."""
    sensor = camera.sensor
    return camera.optics, sensor.pixel_pitch, sensor.aperture, sensor.centre, sensor.offset


def _bytes(codes):
    return (255 * codes + 0.5).astype(np.uint8)

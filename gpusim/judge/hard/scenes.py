"""Camera and scenes that several hard cases use."""

from dataclasses import replace

import numpy as np

from gpusim.data.charts import chart
from gpusim.data.lights import illuminant, white_radiance
from gpusim.domain.camera import Camera
from gpusim.domain.content import Cube
from gpusim.domain.scene import Scene
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.simulator import Simulator

WAVELENGTHS = np.arange(400.0, 701.0, 10.0)
LIGHT = white_radiance(illuminant("D65"), 100.0)


def at_f_number(name: str, f_number: float) -> Camera:
    """Return a built-in camera at another f-number, without fall-off."""
    camera = open_camera(name)
    return replace(
        camera, optics=replace(camera.optics, f_number=f_number, relative_illumination="none")
    )


CAMERA = at_f_number("phone", 2.8)  # 1.4 um pixels: the camera of the accuracy figures
CFA = CAMERA.sensor.cfa_indices


def as_cube(scene: Scene) -> Scene:
    """Return the same scene with a spectrum at every sample."""
    content = scene.content
    values = np.ascontiguousarray(content.bands_at(slice(None)), np.float32)
    return replace(scene, content=Cube(content.wavelengths, values))


def natural(size, seed=1, surfaces="objects", light="D65"):
    """Return dead leaves of (cols, rows) samples under a slow shading, as a cube."""
    scene = chart("deadleaves", size=size, seed=seed, surfaces=surfaces, light=light)
    y, x = np.mgrid[: size[1], : size[0]] / max(size)
    shading = (0.6 + 0.4 * np.sin(5 * x + 3 * y)).astype(np.float32)
    return as_cube(replace(scene, content=replace(scene.content, shading=shading)))


def mean_of(simulator: Simulator, scene: Scene, exposure_time: float = 1.0) -> np.ndarray:
    """Return the mean electrons, float64, on the host."""
    return simulator.device.numpy(simulator.expose(scene, exposure_time).mean).astype(float)


def electrons(scene: Scene, device, camera: Camera = CAMERA, **options) -> np.ndarray:
    """Return the mean electrons of one second, float64. options: of the Simulator."""
    return mean_of(Simulator(camera, device=device, **options), scene)

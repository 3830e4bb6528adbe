"""Image systems simulation on CPU and GPU: scene, optics, sensor, image processor, display.

import gpusim as gs
simulate = gs.Simulator(gs.open_camera("phone"), device="auto")
frame = simulate(gs.open_scene("colorchecker"), seed=1)  # frame.mean, .raw, .rgb, .report
"""

from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

from gpusim import pipeline
from gpusim.domain import labels

__version__ = "0.1.0"

# name -> module; resolved on first use, which keeps `import gpusim` fast
_PUBLIC = {
    "Camera": "gpusim.domain.camera",
    "Display": "gpusim.domain.display",
    "Optics": "gpusim.domain.optics",
    "Processor": "gpusim.domain.processor",
    "Scene": "gpusim.domain.scene",
    "Sensor": "gpusim.domain.sensor",
    "Cube": "gpusim.domain.content",
    "Basis": "gpusim.domain.content",
    "Materials": "gpusim.domain.content",
    "Picture": "gpusim.domain.content",
    "Illuminated": "gpusim.domain.illuminated",
    "Spectrum": "gpusim.domain.spectrum",
    "Tolerance": "gpusim.domain.tolerance",
    "GpusimError": "gpusim.domain.errors",
    "Noise": "gpusim.domain.noise",
    "AutoExposure": "gpusim.domain.exposure",
    "exposure_value": "gpusim.domain.exposure",
    "Readout": "gpusim.pipeline.readout",
    "Layer": "gpusim.domain.scene",
    "View": "gpusim.domain.view",
    "PictureBatch": "gpusim.apps.tensors.batches",
    "EventSensor": "gpusim.captures.events",
    "events_of": "gpusim.captures.events",
    "write_events": "gpusim.io.frame.events",
    "Actor": "gpusim.domain.animation",
    "Animation": "gpusim.domain.animation",
    "Motion": "gpusim.domain.motion",
    "Flicker": "gpusim.domain.flicker",
    "bracket": "gpusim.captures.bracket",
    "change_exposure_time": "gpusim.captures.bracket",
    "burst": "gpusim.captures.burst",
    "average": "gpusim.captures.burst",
    "read_nondestructively": "gpusim.captures.reads",
    "expose_moving": "gpusim.captures.moving",
    "expose_motion": "gpusim.captures.moving",
    "autofocus": "gpusim.captures.focus",
    "merge_bracket": "gpusim.captures.merge",
    "merge_burst": "gpusim.captures.merge",
    "merge_flash": "gpusim.captures.merge",
    "Simulator": "gpusim.pipeline.simulator",
    "Exposure": "gpusim.pipeline.exposure",
    "Frame": "gpusim.pipeline.frame",
    "Loop": "gpusim.pipeline.loop",
    "open_device": "gpusim.backends",
    "open_camera": "gpusim.io.camera.cameras",
    "camera_names": "gpusim.io.camera.cameras",
    "sensor_from_emva1288": "gpusim.io.camera.emva1288",
    "Calibration": "gpusim.domain.calibration",
    "read_calibration": "gpusim.io.camera.calibration",
    "read_noise_profile": "gpusim.io.camera.noise_profile",
    "photon_transfer": "gpusim.measure",
    "read_psf": "gpusim.io.camera.psf",
    "write_psf": "gpusim.io.camera.psf",
    "PointSpread": "gpusim.domain.psf",
    "read_zemax_psf": "gpusim.io.camera.zemax",
    "optiland_psf": "gpusim.io.camera.optiland",
    "open_display": "gpusim.data.displays",
    "display_names": "gpusim.data.displays",
    "display_picture": "gpusim.data.displays",
    "chart": "gpusim.data.charts",
    "illuminant": "gpusim.data.lights",
    "illuminate": "gpusim.data.illumination",
    "open_scene": "gpusim.io.scene.scenes",
    "save_scene": "gpusim.io.scene.scenes",
    "picture": "gpusim.io.scene.scenes",
    "scene_from": "gpusim.io.scene.arrays",
    "preview": "gpusim.apps.preview",
    "plot": "gpusim",  # a package
}
__all__ = sorted(_PUBLIC)

# The same names for type checkers and editors, which do not run the code. A test compares the two.
if TYPE_CHECKING:
    from gpusim import plot as plot
    from gpusim.backends import open_device as open_device
    from gpusim.apps.tensors.batches import PictureBatch as PictureBatch
    from gpusim.captures.bracket import (
        bracket as bracket,
        change_exposure_time as change_exposure_time,
    )
    from gpusim.captures.burst import average as average, burst as burst
    from gpusim.captures.events import EventSensor as EventSensor, events_of as events_of
    from gpusim.captures.focus import autofocus as autofocus
    from gpusim.captures.merge import (
        merge_bracket as merge_bracket,
        merge_burst as merge_burst,
        merge_flash as merge_flash,
    )
    from gpusim.captures.moving import (
        expose_motion as expose_motion,
        expose_moving as expose_moving,
    )
    from gpusim.captures.reads import read_nondestructively as read_nondestructively
    from gpusim.io.camera.calibration import read_calibration as read_calibration
    from gpusim.io.camera.cameras import camera_names as camera_names, open_camera as open_camera
    from gpusim.data.charts import chart as chart
    from gpusim.data.displays import (
        display_names as display_names,
        display_picture as display_picture,
        open_display as open_display,
    )
    from gpusim.io.camera.emva1288 import sensor_from_emva1288 as sensor_from_emva1288
    from gpusim.data.illumination import illuminate as illuminate
    from gpusim.data.lights import illuminant as illuminant
    from gpusim.io.camera.noise_profile import read_noise_profile as read_noise_profile
    from gpusim.io.camera.optiland import optiland_psf as optiland_psf
    from gpusim.io.camera.psf import read_psf as read_psf, write_psf as write_psf
    from gpusim.io.camera.zemax import read_zemax_psf as read_zemax_psf
    from gpusim.domain.animation import Actor as Actor, Animation as Animation
    from gpusim.domain.calibration import Calibration as Calibration
    from gpusim.domain.camera import Camera as Camera
    from gpusim.domain.content import (
        Basis as Basis,
        Cube as Cube,
        Materials as Materials,
        Picture as Picture,
    )
    from gpusim.domain.display import Display as Display
    from gpusim.domain.errors import GpusimError as GpusimError
    from gpusim.domain.exposure import (
        AutoExposure as AutoExposure,
        exposure_value as exposure_value,
    )
    from gpusim.domain.flicker import Flicker as Flicker
    from gpusim.domain.illuminated import Illuminated as Illuminated
    from gpusim.domain.motion import Motion as Motion
    from gpusim.domain.noise import Noise as Noise
    from gpusim.domain.optics import Optics as Optics
    from gpusim.domain.processor import Processor as Processor
    from gpusim.domain.psf import PointSpread as PointSpread
    from gpusim.domain.scene import Layer as Layer, Scene as Scene
    from gpusim.domain.sensor import Sensor as Sensor
    from gpusim.domain.spectrum import Spectrum as Spectrum
    from gpusim.domain.tolerance import Tolerance as Tolerance
    from gpusim.domain.view import View as View
    from gpusim.pipeline.exposure import Exposure as Exposure
    from gpusim.pipeline.frame import Frame as Frame
    from gpusim.io.scene.arrays import scene_from as scene_from
    from gpusim.io.frame.events import write_events as write_events
    from gpusim.io.scene.scenes import (
        open_scene as open_scene,
        picture as picture,
        save_scene as save_scene,
    )
    from gpusim.measure import photon_transfer as photon_transfer
    from gpusim.apps.preview import preview as preview
    from gpusim.pipeline.loop import Loop as Loop
    from gpusim.pipeline.readout import Readout as Readout
    from gpusim.pipeline.simulator import Simulator as Simulator

# Lower packages get access to higher ones here. They are loaded when they are needed.
labels.load = partial(import_module, "gpusim.plot.notebook")
pipeline.load_truth = partial(import_module, "gpusim.judge.truth")


def __getattr__(name):
    if name not in _PUBLIC:
        raise AttributeError(f"module 'gpusim' has no attribute {name!r}")
    if _PUBLIC[name] == __name__:
        return import_module(f"{__name__}.{name}")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__():
    return sorted([*globals(), *__all__])

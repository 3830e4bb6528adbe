"""Image systems simulation on CPU and GPU: scene, optics, sensor, image processor, display.

import gpusim as gs
simulate = gs.Simulator(gs.open_camera("phone"), device="auto")
frame = simulate(gs.open_scene("colorchecker"), seed=1)  # frame.mean, .raw, .rgb, .report
"""

from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING

import gpusim.kernels  # noqa: F401  it finds its parts by a path of its own, which threads must not meet half set
from gpusim import pipeline
from gpusim.domain import labels

__version__ = "0.1.0"

# module -> names; resolved on first use, which keeps `import gpusim` fast
_NAMES = {
    "apps.named.compose": ("compose_camera",),
    "apps.preview": ("preview",),
    "apps.study": ("study",),
    "apps.tensors.batches": ("PictureBatch",),
    "backends": ("open_device",),
    "captures.bracket": ("Bracket", "bracket"),
    "captures.burst": ("Burst", "burst", "average"),
    "captures.capture": ("Capture", "change_exposure_time"),
    "captures.decoding": ("LensletGrid", "calibrate_lenslets", "decode_lenslets"),
    "captures.disparity": (
        "defocus_from_disparity",
        "disparity",
        "disparity_slope",
        "distance_from_disparity",
    ),
    "captures.coded_depth": ("CodedDepth", "coded_kernels", "find_coded_depth"),
    "captures.events": ("EventSensor", "events_of"),
    "captures.focus": ("autofocus",),
    "captures.lenslets": ("apply_lenslets",),
    "captures.merge": ("merge_bracket", "merge_burst", "merge_flash", "merge_reads"),
    "captures.moving": ("expose_moving", "expose_motion"),
    "captures.parallax": ("move_camera",),
    "captures.pinholes": ("light_field",),
    "captures.refocus": ("focus_stack", "refocus"),
    "captures.slices": ("refocus_by_slices",),
    "captures.lenslet_frames": ("LensletCapture", "LensletExposure", "expose_lenslets"),
    "captures.views": ("ViewCapture", "Views", "expose_views"),
    "captures.view_depth": ("ViewDepth", "all_in_focus", "depth_from_views"),
    "captures.phase_focus": ("phase_focus",),
    "captures.reads": ("Reads", "read_nondestructively"),
    "data.charts": ("chart",),
    "data.displays": ("open_display", "display_names", "display_picture"),
    "data.illumination": ("illuminate",),
    "data.lights": ("illuminant",),
    "domain.account": ("Tolerance",),
    "domain.animation": ("Actor", "Animation"),
    "domain.calibration": ("Calibration",),
    "domain.camera": ("Camera",),
    "domain.content": ("Cube", "Basis", "Materials", "Picture"),
    "domain.display": ("Display",),
    "domain.dual": ("DualPixels",),
    "domain.errors": ("GpusimError",),
    "domain.exposure": ("AutoExposure", "exposure_value"),
    "domain.flicker": ("Flicker",),
    "domain.illuminated": ("Illuminated",),
    "domain.light_field": ("LightField",),
    "domain.lenslets": ("Lenslets",),
    "domain.mask": ("Mask", "pupil_cells"),
    "domain.motion": ("Motion",),
    "domain.noise": ("Noise",),
    "domain.optics": ("Optics",),
    "domain.processor": ("Processor",),
    "domain.psf": ("PointSpread",),
    "domain.scene": ("Scene", "Layer", "View"),
    "domain.sensor": ("Sensor",),
    "domain.spectrum": ("Spectrum",),
    "domain.view_images": ("ViewImages",),
    "fit": ("fit",),
    "fit.compare": ("Comparison", "compare"),
    "fit.estimate": ("Estimate",),
    "fit.fitting": ("Fit",),
    "io.camera.calibration": ("read_calibration",),
    "io.camera.cameras": ("open_camera", "camera_names"),
    "io.camera.emva1288": ("sensor_from_emva1288",),
    "io.camera.noise_profile": ("read_noise_profile",),
    "io.camera.optiland": ("optiland_psf",),
    "io.camera.psf": ("read_psf", "write_psf"),
    "io.camera.zemax": ("read_zemax_psf",),
    "io.databases.catalogue": ("find_cameras", "find_lenses"),
    "io.frame.events": ("write_events",),
    "io.frame.view_images": ("open_views", "save_views"),
    "io.scene.arrays": ("scene_from",),
    "io.scene.light_fields": ("open_light_field", "save_light_field"),
    "io.scene.scenes": ("open_scene", "save_scene", "picture"),
    "measure": ("photon_transfer",),
    "optics.labels": ("carry_labels",),
    "optics.lenslets": ("LensletSamples", "lenslet_grid", "lenslet_samples"),
    "optics.panorama": ("view_panorama",),
    "pipeline.exposure": ("Exposure",),
    "pipeline.frame": ("Frame",),
    "pipeline.loop": ("Loop",),
    "pipeline.readout": ("Readout",),
    "pipeline.simulator": ("Simulator",),
}
_PUBLIC = {name: f"gpusim.{module}" for module, names in _NAMES.items() for name in names}
_PUBLIC["plot"] = "gpusim"  # a package
__all__ = sorted(_PUBLIC)

# The same names for type checkers and editors, which do not run the code. A test compares the two.
if TYPE_CHECKING:
    from gpusim import plot as plot
    from gpusim.backends import open_device as open_device
    from gpusim.apps.study import study as study
    from gpusim.apps.tensors.batches import PictureBatch as PictureBatch
    from gpusim.captures.bracket import Bracket as Bracket, bracket as bracket
    from gpusim.captures.burst import Burst as Burst, average as average, burst as burst
    from gpusim.captures.capture import Capture as Capture
    from gpusim.captures.capture import change_exposure_time as change_exposure_time
    from gpusim.captures.decoding import LensletGrid as LensletGrid
    from gpusim.captures.decoding import calibrate_lenslets as calibrate_lenslets
    from gpusim.captures.decoding import decode_lenslets as decode_lenslets
    from gpusim.captures.disparity import defocus_from_disparity as defocus_from_disparity
    from gpusim.captures.disparity import disparity as disparity
    from gpusim.captures.disparity import disparity_slope as disparity_slope
    from gpusim.captures.disparity import distance_from_disparity as distance_from_disparity
    from gpusim.captures.coded_depth import CodedDepth as CodedDepth
    from gpusim.captures.coded_depth import coded_kernels as coded_kernels
    from gpusim.captures.coded_depth import find_coded_depth as find_coded_depth
    from gpusim.captures.events import EventSensor as EventSensor, events_of as events_of
    from gpusim.captures.focus import autofocus as autofocus
    from gpusim.captures.lenslets import apply_lenslets as apply_lenslets
    from gpusim.captures.merge import merge_bracket as merge_bracket, merge_burst as merge_burst
    from gpusim.captures.merge import merge_flash as merge_flash, merge_reads as merge_reads
    from gpusim.captures.moving import expose_motion as expose_motion
    from gpusim.captures.moving import expose_moving as expose_moving
    from gpusim.captures.parallax import move_camera as move_camera
    from gpusim.captures.pinholes import light_field as light_field
    from gpusim.captures.refocus import focus_stack as focus_stack, refocus as refocus
    from gpusim.captures.slices import refocus_by_slices as refocus_by_slices
    from gpusim.captures.lenslet_frames import LensletCapture as LensletCapture
    from gpusim.captures.lenslet_frames import LensletExposure as LensletExposure
    from gpusim.captures.lenslet_frames import expose_lenslets as expose_lenslets
    from gpusim.captures.views import ViewCapture as ViewCapture, Views as Views
    from gpusim.captures.views import expose_views as expose_views
    from gpusim.captures.view_depth import ViewDepth as ViewDepth, all_in_focus as all_in_focus
    from gpusim.captures.view_depth import depth_from_views as depth_from_views
    from gpusim.captures.phase_focus import phase_focus as phase_focus
    from gpusim.captures.reads import Reads as Reads
    from gpusim.captures.reads import read_nondestructively as read_nondestructively
    from gpusim.fit import fit as fit
    from gpusim.fit.estimate import Estimate as Estimate
    from gpusim.fit.fitting import Fit as Fit
    from gpusim.io.camera.calibration import read_calibration as read_calibration
    from gpusim.io.camera.cameras import camera_names as camera_names, open_camera as open_camera
    from gpusim.data.charts import chart as chart
    from gpusim.data.displays import display_names as display_names
    from gpusim.data.displays import display_picture as display_picture
    from gpusim.data.displays import open_display as open_display
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
    from gpusim.domain.content import Basis as Basis, Cube as Cube, Materials as Materials
    from gpusim.domain.content import Picture as Picture
    from gpusim.domain.display import Display as Display
    from gpusim.domain.dual import DualPixels as DualPixels
    from gpusim.domain.errors import GpusimError as GpusimError
    from gpusim.domain.exposure import AutoExposure as AutoExposure
    from gpusim.domain.exposure import exposure_value as exposure_value
    from gpusim.domain.flicker import Flicker as Flicker
    from gpusim.domain.illuminated import Illuminated as Illuminated
    from gpusim.domain.light_field import LightField as LightField
    from gpusim.domain.lenslets import Lenslets as Lenslets
    from gpusim.domain.mask import Mask as Mask, pupil_cells as pupil_cells
    from gpusim.domain.motion import Motion as Motion
    from gpusim.domain.noise import Noise as Noise
    from gpusim.domain.optics import Optics as Optics
    from gpusim.domain.processor import Processor as Processor
    from gpusim.domain.psf import PointSpread as PointSpread
    from gpusim.domain.scene import Layer as Layer, Scene as Scene
    from gpusim.domain.sensor import Sensor as Sensor
    from gpusim.domain.spectrum import Spectrum as Spectrum
    from gpusim.domain.view_images import ViewImages as ViewImages
    from gpusim.domain.account import Tolerance as Tolerance
    from gpusim.domain.scene import View as View
    from gpusim.fit.compare import Comparison as Comparison, compare as compare
    from gpusim.optics.labels import carry_labels as carry_labels
    from gpusim.optics.lenslets import LensletSamples as LensletSamples
    from gpusim.optics.lenslets import lenslet_grid as lenslet_grid
    from gpusim.optics.lenslets import lenslet_samples as lenslet_samples
    from gpusim.optics.panorama import view_panorama as view_panorama
    from gpusim.pipeline.exposure import Exposure as Exposure
    from gpusim.pipeline.frame import Frame as Frame
    from gpusim.apps.named.compose import compose_camera as compose_camera
    from gpusim.io.databases.catalogue import find_cameras as find_cameras
    from gpusim.io.databases.catalogue import find_lenses as find_lenses
    from gpusim.io.scene.arrays import scene_from as scene_from
    from gpusim.io.frame.events import write_events as write_events
    from gpusim.io.frame.view_images import open_views as open_views, save_views as save_views
    from gpusim.io.scene.light_fields import open_light_field as open_light_field
    from gpusim.io.scene.light_fields import save_light_field as save_light_field
    from gpusim.io.scene.scenes import open_scene as open_scene, picture as picture
    from gpusim.io.scene.scenes import save_scene as save_scene
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
        found = import_module(f"{__name__}.{name}")
    else:
        found = getattr(import_module(_PUBLIC[name]), name)
    globals()[name] = found  # Python does not ask again
    return found


def __dir__():
    return sorted([*globals(), *__all__])

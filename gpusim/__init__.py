"""Image systems simulation on CPU and GPU: scene radiance, optics, sensor, image processor, display.

import gpusim as gs
simulate = gs.Simulator(gs.open_camera("phone"), device="auto")
frame = simulate(gs.open_scene("colorchecker"), seed=1)      # frame.mean, frame.raw, frame.rgb, frame.report
"""

from importlib import import_module

__version__ = "0.1.0"

# name -> module; resolved on first use, so that `import gpusim` stays fast
_PUBLIC = {
    "Camera": "gpusim.domain.camera", "Display": "gpusim.domain.display", "Optics": "gpusim.domain.optics",
    "Processor": "gpusim.domain.processor", "Scene": "gpusim.domain.scene", "Sensor": "gpusim.domain.sensor",
    "Cube": "gpusim.domain.content", "Basis": "gpusim.domain.content", "Materials": "gpusim.domain.content",
    "Picture": "gpusim.domain.content", "Illuminated": "gpusim.domain.illuminated",
    "Spectrum": "gpusim.domain.spectrum", "Tolerance": "gpusim.domain.tolerance",
    "GpusimError": "gpusim.domain.errors", "Noise": "gpusim.domain.noise", "AutoExposure": "gpusim.domain.exposure",
    "exposure_value": "gpusim.domain.exposure", "Readout": "gpusim.readout", "Layer": "gpusim.domain.scene",
    "View": "gpusim.domain.view", "Batch": "gpusim.batches",
    "EventSensor": "gpusim.captures.events", "events_of": "gpusim.captures.events",
    "write_events": "gpusim.io.events",
    "Actor": "gpusim.domain.animation", "Animation": "gpusim.domain.animation",
    "Motion": "gpusim.domain.motion", "Flicker": "gpusim.domain.flicker",
    "bracket": "gpusim.captures.bracket", "lengthened": "gpusim.captures.bracket", "burst": "gpusim.captures.burst",
    "average": "gpusim.captures.burst", "read_nondestructively": "gpusim.captures.reads",
    "expose_moving": "gpusim.captures.moving", "expose_motion": "gpusim.captures.moving",
    "autofocus": "gpusim.captures.focus",
    "merge_bracket": "gpusim.captures.merge", "merge_burst": "gpusim.captures.merge",
    "merge_flash": "gpusim.captures.merge",
    "Simulator": "gpusim.simulator", "Frame": "gpusim.frame",
    "Program": "gpusim.program.program", "open_device": "gpusim.backends",
    "open_camera": "gpusim.data.cameras", "camera_names": "gpusim.data.cameras",
    "sensor_from_emva1288": "gpusim.data.emva1288",
    "open_display": "gpusim.data.displays", "display_names": "gpusim.data.displays",
    "displayed": "gpusim.data.displays", "chart": "gpusim.data.charts", "illuminant": "gpusim.data.lights",
    "illuminated": "gpusim.data.illumination",
    "open_scene": "gpusim.io.scenes", "save_scene": "gpusim.io.scenes",
    "picture": "gpusim.io.scenes", "preview": "gpusim.preview",
}
__all__ = sorted(_PUBLIC)


def __getattr__(name):
    if name not in _PUBLIC:
        raise AttributeError(f"module 'gpusim' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__():
    return sorted([*globals(), *__all__])

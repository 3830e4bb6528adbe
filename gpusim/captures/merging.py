"""What merges of several frames have in common: checks, tables, defective and full pixels."""

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.kernels.processor.defects import defects
from gpusim.measure.merge import full_value
from gpusim.pipeline.developer import STANDS_OUT, Developer
from gpusim.pipeline.exposure import HOT
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.simulator import Simulator

# fields of a sensor that frames of one camera have in common
COMMON_FIELDS = (
    "channels",
    "cfa",
    "stacked",
    "bits",
    "black_level",
    "pixel_pitch",
    "full_well",
    "noise",
)


def find_full(function, frames):
    """Return which values are known to have a full pixel among those averaged, bool (frames, ...).

    Raises BadData if it is not known.
    """
    found = []
    for frame in frames:
        if frame.averaged > 1 and frame.full is None:
            raise BadData(
                f"{function}: digital binning hides full pixels, and the frames do not tell; merge frames of a "
                'simulator, or use sensor.binning_mode = "charge" or no binning'
            )
        found.append(np.zeros(frame.raw.shape, bool) if frame.full is None else frame.full)
    return np.stack(found)


def check_frames(function, frames, most) -> list[Frame]:
    """Return frames as a list; raise BadData or OutOfRange unless they are of one camera."""
    try:
        frames = list(frames)
    except TypeError:
        raise BadData(f"{function}: {frames!r}; wanted a list of gpusim frames") from None
    for number, frame in enumerate(frames):
        if not isinstance(frame, Frame):
            raise BadData(
                f"{function}: frame {number} is of type {type(frame).__name__}; wanted a gpusim frame, "
                "from Simulator.frames or gpusim.bracket"
            )
    if len(frames) < 2 or (most and len(frames) > most):
        raise BadData(
            f"{function}: {len(frames)} frame(s); wanted two{f' to {most}' if most else ' or more'}"
        )
    first = frames[0]
    for number, frame in enumerate(frames):
        sensor = frame.camera.sensor
        if sensor.bits == FLOAT_BITS:
            raise BadData(
                f"{function}: frame {number} has no converter (float raw values); wanted sensor.bits 1 .. 16"
            )
        if not 0 < frame.exposure_time < np.inf:
            raise OutOfRange(
                f"exposure_time of frame {number}",
                f"{frame.exposure_time} s",
                "0 < exposure_time < inf",
            )
        if np.shape(frame.raw) != np.shape(first.raw) or frame.raw.dtype != np.uint16:
            raise BadData(
                f"{function}: frame {number} has raw values {np.shape(frame.raw)} of {frame.raw.dtype}; "
                f"wanted uint16 of the shape of frame 0, {np.shape(first.raw)}"
            )
        for key in COMMON_FIELDS:
            if getattr(sensor, key) != getattr(first.camera.sensor, key):
                raise BadData(
                    f"{function}: frame {number} is of another camera than frame 0: sensor.{key} differs"
                )
    return frames


def merge_tables(frames, averaged):
    """Return the parameters of each frame that `processor.merge` takes.

    averaged: as for `Developer`. The weights of averaged pixels take the photons' noise of one.
    """
    rows = []
    for frame in frames:
        sensor, time = frame.camera.sensor, frame.exposure_time
        noise = RawNoise.of(sensor, averaged)
        gain = sensor.gain_dn_per_electron
        dark = sensor.noise.operating_dark_current * time
        ceiling = full_value(sensor)
        rows.append((sensor.dark_level + gain * dark, gain, time, noise.variance(dark), ceiling))
    return dict(zip(("dark", "gain", "time", "floor", "ceiling"), np.array(rows).T, strict=True))


def defect_method(simulator: Simulator, frames):
    """Return how defective pixels are found.

    The chip's map is used only if it is the simulator's and pixels are not binned.
    """
    method, sensor = frames[0].camera.processor.defects, simulator.camera.sensor
    mapped = sensor.binning == (1, 1) and sensor.noise == frames[0].camera.sensor.noise
    return "detect" if method == "known" and not mapped else method


def replace_defects(simulator: Simulator, frames):
    """Return the raw values of all frames, defects replaced if the camera does so.

    This happens before the merge: merged values have other noise than their electrons, and moved
    ones fit no map of the chip.
    """
    raw = np.stack([frame.raw for frame in frames])
    how, device, shape = defect_method(simulator, frames), simulator.device, raw.shape[1:]
    if how == "none":
        return raw
    for frame, layers in zip(frames, raw.reshape(len(frames), -1, *shape[-2:]), strict=True):
        sensor, known = frame.camera.sensor, None
        if how == "known":
            known = simulator.readout.defects(shape, frame.exposure_time, HOT * sensor.read_sigma)
        maps = [None] * len(layers) if known is None else known.reshape(layers.shape)
        for layer, map_ in zip(layers, maps, strict=True):
            replaced = defects(
                device.array(layer, np.uint16),
                map_,
                cfa=np.zeros((1, 1), np.int32) if sensor.stacked else sensor.cfa_indices,
                detect=STANDS_OUT if how == "detect" else None,
                black_level=sensor.dark_level,
                noise=Developer(frame.camera, device, simulator.readout.averaged).noise,
                device=device,
            )
            layer[:] = device.numpy(replaced)
    return raw

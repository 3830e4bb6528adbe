"""Several frames of one scene made into one picture: exposure brackets, bursts, pairs with and without flash."""

import dataclasses

import numpy as np

from gpusim.developer import Developer
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.kernels.processor.align import align
from gpusim.kernels.processor.average import average
from gpusim.kernels.processor.flash import flash as with_flash
from gpusim.kernels.processor.merge import MOST_FRAMES, merge
from gpusim.measure.merge import MARGIN, ROUNDING
from gpusim.scheduler import Exposure, Frame, Simulator

PEDESTAL, TOP = 1024, 65535  # digital numbers of black and of the largest value in merged raw values
FINER = 256  # how much finer dark parts are developed where 16 bits are too coarse for them
COARSE = 0.1  # of the dark noise's variance: more from rounding asks for the finer scale
REACH = 16  # [pixel] over which demosaicking may mix values
FULL = 0.95  # of saturation: a colour interpolated beside a clipped one lies just below it


def merge_bracket(simulator: Simulator, frames, *, full_scale: float | None = None,
                  exposure: Exposure | None = None) -> Frame:
    """One picture of high dynamic range from frames exposed differently long, such as `Simulator.bracket` takes.

    Each pixel becomes the mean of its rates, electrons per second, weighted by the inverse of their variances; frames
    in which it is full are left out, and where all are, it is the shortest frame's. See `processor.merge`. Values
    below digital number 0 were cut by the converter: a camera with a black level stays unbiased in the dark.

    frames: 2 to 16 of one camera and size, from digital numbers; order and analog gains are free. full_scale: the
    largest rate that the raw values hold [e- s-1]; by default that at which the shortest exposure saturates. exposure:
    of one of the frames, for the camera's shading correction and the blur that `best` wants to know.
    Returns a Frame as of the longest exposure and an unlimited well: `mean` the merged electrons, float32 (rows, cols)
    or (C, rows, cols) [e-], divided by `exposure_time` a rate, negative where noise made it so; `raw` the same in 16
    bits up to full_scale; `linear` developed from them, in the frames' own units: display white stays 1, what is
    brighter goes beyond. Dark parts are developed from a scale 256 times finer where 16 bits are too coarse.
    Raises BadData, OutOfRange.
    """
    frames = sorted(_checked("merge_bracket", frames, MOST_FRAMES), key=lambda frame: frame.exposure_time)
    times = np.array([frame.exposure_time for frame in frames])
    tables = _tables(frames, times)
    sensor, noise = frames[-1].camera.sensor, frames[-1].camera.sensor.noise
    raw = np.stack([frame.raw for frame in frames])
    if (raw[0] >= tables["ceiling"][0]).all():
        raise BadData(f"merge_bracket: every pixel is full in the shortest exposure, {times[0]:.4g} s; take a shorter "
                      "one")
    period = (1, 1) if sensor.stacked else sensor.cfa_indices.shape
    layers = raw.reshape(len(frames), -1, *raw.shape[-2:]).swapaxes(0, 1)
    rate = np.stack([merge(np.ascontiguousarray(layer), **tables, photon=noise.photon != "none", period=period,
                           device=simulator.device) for layer in layers]).reshape(raw.shape[1:])
    longest, limit = times[-1], frames[0].camera.sensor.saturation / times[0]
    full_scale = limit if full_scale is None else full_scale
    if not 0 < full_scale < np.inf:
        raise OutOfRange("full_scale", f"{full_scale} e-/s", "0 < full_scale < inf")
    dark_noise = float((np.square(times / longest) / tables["floor"]).sum() ** -0.5)  # [e- in the longest exposure]
    shown = frames[len(frames) // 2]
    return _developed(simulator, shown, rate * np.float32(longest), exposure_time=longest, full=full_scale * longest,
                      saturated=limit / full_scale, ratio=shown.exposure_time / longest, dark_noise=dark_noise,
                      exposure=exposure, note=f"merged from {len(frames)} exposures, {times[0]:.4g} .. {longest:.4g} s")


def merge_burst(simulator: Simulator, frames, *, reference: int = 0, exposure: Exposure | None = None) -> Frame:
    """One picture with less noise from frames exposed equally long while the camera shook or things moved.

    Tiles of 16 x 16 periods of the mosaic are found again in every frame (`processor.align`), moved onto the reference
    and averaged, each block of a period with weights that are 0 where the difference is more than the noise explains
    (`processor.average`): what moves by itself is shown as the reference has it, without ghosts and with its noise.

    frames: two or more of one camera, size, exposure time and gain, from digital numbers, at least 16 periods of the
    mosaic high and wide. reference: the frame that stays where it is. exposure: as for `merge_bracket`.
    Returns a Frame as of n times the exposure time, the sum of n frames without noise correlated among them: `mean`
    the electrons so collected, float32 (rows, cols) [e-]; `raw` in 16 bits.
    Raises BadData, OutOfRange.
    """
    frames = _checked("merge_burst", frames, None)
    times = np.array([frame.exposure_time for frame in frames])
    sensors = [frame.camera.sensor for frame in frames]
    if np.ptp(times) > 1e-9 * times[0] or len({sensor.gain_dn_per_electron for sensor in sensors}) > 1:
        raise BadData("merge_burst: the frames differ in exposure time or gain; wanted equal ones (merge_bracket takes "
                      "others)")
    sensor, count = sensors[0], len(frames)
    if sensor.stacked:
        raise BadData("merge_burst: stacked pixels; wanted a mosaic or a monochrome sensor")
    gain, chip = sensor.gain_dn_per_electron, sensor.noise
    fixed = sensor.read_sigma**2 + chip.row**2 + chip.column**2 + chip.dsnu**2  # moved, offsets differ as noise does
    device, period = simulator.device, sensor.cfa_indices.shape
    raw = device.array(np.stack([frame.raw for frame in frames]), np.uint16)
    displacement = align(raw, reference=reference, period=period, device=device)
    numbers = average(raw, displacement, reference=reference, period=period, black_level=sensor.dark_level,
                      noise=(gain if chip.photon != "none" else 0.0, float(np.sqrt(gain**2 * fixed + ROUNDING))),
                      device=device)
    dark = chip.dark_current * chip.warmth * times[0]
    electrons = (device.numpy(numbers) - np.float32(sensor.dark_level)) * np.float32(count / gain)
    full = (sensor.white_level - sensor.dark_level) / gain
    dark_noise = float(np.sqrt(count * (fixed + ROUNDING / gain**2)))
    electrons = electrons - np.float32(count * dark)
    return _developed(simulator, frames[reference], electrons, exposure_time=count * times[0], full=count * full,
                      saturated=sensor.saturation / full, ratio=1 / count, dark_noise=dark_noise, exposure=exposure,
                      note=f"averaged from {count} frames")


def merge_flash(simulator: Simulator, ambient: Frame, flash: Frame, *, radius: int = 8, reach: float = 6.0) -> Frame:
    """The ambient picture, in its own light, with the noise averaged among pixels that a flash picture shows as alike.

    ambient, flash: frames of one camera and view, without and with a flash beside the scene's light; exposure times
    and gains are free. radius: of the window [pixel], 1 to 12. reach: squared difference, over that of noise alone,
    from which on pixels are not alike. The noise that counts is that of the sensor through the camera's colour matrix.
    See `processor.flash`.
    Returns the ambient frame with new `linear` and `rgb`. Raises BadData, OutOfRange.
    """
    for name, frame in (("ambient", ambient), ("flash", flash)):
        if not np.isfinite(frame.linear).all():
            raise BadData(f"merge_flash: the {name} picture has NaN or infinite values")
    ambient, flash = _checked("merge_flash", [ambient, flash], None)
    full = FULL * float((flash.rendering.display_from_camera @ flash.rendering.ceiling).min())
    linear = with_flash(ambient.linear, flash.linear, ambient_noise=_display_noise(ambient),
                        flash_noise=_display_noise(flash), full=full if full > 0 else np.inf, radius=radius,
                        reach=reach, device=simulator.device)
    as_is = dataclasses.replace(ambient.rendering, display_from_camera=np.eye(3), ceiling=np.full(3, np.inf))
    shown = Developer(ambient.camera, simulator.device).shown(simulator.device.array(linear), as_is)
    linear, rgb = (np.array(simulator.device.numpy(array)) for array in shown)
    return dataclasses.replace(ambient, linear=linear, rgb=rgb, report=_noted(ambient, "denoised by a flash picture"))


def _checked(function, frames, most):
    """Frames of one camera. Raises BadData, OutOfRange."""
    frames = list(frames)
    if len(frames) < 2 or (most and len(frames) > most):
        raise BadData(f"{function}: {len(frames)} frame(s); wanted two{f' to {most}' if most else ' or more'}")
    first = frames[0]
    for number, frame in enumerate(frames):
        sensor = frame.camera.sensor
        if sensor.bits == FLOAT_BITS:
            raise BadData(f"{function}: frame {number} has raw values without a converter; wanted sensor.bits 1 .. 16")
        if not 0 < frame.exposure_time < np.inf:
            raise OutOfRange(f"exposure_time of frame {number}", f"{frame.exposure_time} s", "0 < exposure_time < inf")
        if np.shape(frame.raw) != np.shape(first.raw) or frame.raw.dtype != np.uint16:
            raise BadData(f"{function}: frame {number} has raw values {np.shape(frame.raw)} of {frame.raw.dtype}; "
                          f"wanted uint16, all like frame 0, {np.shape(first.raw)}")
        for key in ("channels", "cfa", "stacked", "bits", "black_level", "pixel_pitch", "full_well", "noise"):
            if getattr(sensor, key) != getattr(first.camera.sensor, key):
                raise BadData(f"{function}: frame {number} is of another camera than frame 0: sensor.{key} differs")
    return frames


def _tables(frames, times):
    """What `processor.merge` wants to know of each frame."""
    rows = []
    for frame, time in zip(frames, times, strict=True):
        sensor = frame.camera.sensor
        gain, chip = sensor.gain_dn_per_electron, sensor.noise
        dark = chip.dark_current * chip.warmth * time
        read = sensor.read_sigma**2 + chip.row**2 + chip.column**2 + chip.dsnu**2 + ROUNDING / gain**2
        full = sensor.dark_level + gain * (sensor.full_well - MARGIN * np.sqrt(read))
        rows.append((sensor.dark_level + gain * dark, gain, time, read + dark * (chip.photon != "none"),
                     min(full, sensor.white_level)))
    return dict(zip(("dark", "gain", "time", "floor", "ceiling"), np.array(rows).T, strict=True))


def _developed(simulator, frame, electrons, *, exposure_time, full, saturated, ratio, dark_noise, exposure, note):
    """A Frame of merged electrons.

    frame: whose rendering is kept. electrons: of `exposure_time` [s]. full: electrons of the largest raw value.
    saturated: where the frames saturate, in parts of it. ratio: the frame's exposure time over the merged one's.
    dark_noise: standard deviation without light [e-].
    """
    device, old = simulator.device, frame.camera.sensor
    chip = dataclasses.replace(old.noise, dark_current=0.0, read=dark_noise, reset=0.0, adc=0.0, row=0.0, column=0.0)
    asked = frame.camera.processor
    processor = dataclasses.replace(asked, defects="detect" if asked.defects == "known" else asked.defects,
                                    shading=exposure is not None and exposure.gains is not None)
    gains, blur = (None, 0.0) if exposure is None else (exposure.gains, exposure.blur)

    def scaled(full):
        """Camera, digital numbers and demosaicked planes, 1 being `full` electrons."""
        gain = (TOP - PEDESTAL) / full
        sensor = dataclasses.replace(old, bits=16, black_level=PEDESTAL, analog_offset=0.0, gain=gain, analog_gain=1.0,
                                     conversion_gain=None, adc_range=None, full_well=full, noise=chip)
        camera = dataclasses.replace(frame.camera, sensor=sensor, processor=processor)
        raw = np.rint(np.clip(electrons * np.float32(gain) + np.float32(PEDESTAL), 0, TOP)).astype(np.uint16)
        developer = Developer(camera, device)
        planes = developer.demosaicked(device.array(raw.reshape(-1, raw.shape[-1]), np.uint16), gains=gains, blur=blur)
        return camera, raw, developer, planes

    camera, raw, developer, planes = scaled(full)
    step = full / (TOP - PEDESTAL)
    if step**2 * ROUNDING > COARSE * dark_noise**2:
        fine = device.numpy(scaled(full / FINER)[-1]) / FINER
        planes = device.array(np.where(_bright(electrons, full / FINER), device.numpy(planes), fine))
    k = full * ratio * old.gain_dn_per_electron / (old.white_level - old.dark_level)  # old camera value over new
    once = frame.rendering
    shown_by = dataclasses.replace(once, display_from_camera=once.display_from_camera * k,
                                   ceiling=once.neutral * saturated, white=once.white / k, saturation=saturated)
    linear, rgb = (np.array(device.numpy(array)) for array in developer.shown(planes, shown_by))
    return Frame(camera, float(exposure_time), shown_by, electrons, raw, linear, rgb, _noted(frame, note))


def _bright(electrons, limit):
    """Where demosaicking may have mixed in a value beyond `limit` [e-], bool (rows, cols)."""
    from scipy.ndimage import maximum_filter

    return maximum_filter(electrons.reshape(-1, *electrons.shape[-2:]).max(axis=0), 2 * REACH + 1) >= 0.99 * limit


def _display_noise(frame):
    """Noise of linear display values as `processor.flash` takes it, (3, 4)."""
    sensor, matrix = frame.camera.sensor, frame.rendering.display_from_camera
    chip, scale = sensor.noise, sensor.gain_dn_per_electron / (sensor.white_level - sensor.dark_level)
    read = sensor.read_sigma**2 + chip.row**2 + chip.column**2 + ROUNDING / sensor.gain_dn_per_electron**2
    per_light = scale * matrix**2 @ np.linalg.pinv(matrix) * (chip.photon != "none")
    return np.column_stack([per_light, scale**2 * read * (matrix**2).sum(axis=1)])


def _noted(frame, note):
    return dataclasses.replace(frame.report, notes=[*frame.report.notes, note])

"""Merge several frames of one scene: exposure brackets, bursts, pairs with and without flash."""

import dataclasses
from collections.abc import Iterable

import numpy as np

from gpusim.captures.merged_frame import develop_merged, host_pictures
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.kernels.processor.align import TILE, align, checked_stack
from gpusim.kernels.processor.average import average
from gpusim.kernels.processor.defects import defects
from gpusim.kernels.processor.flash import flash as with_flash
from gpusim.kernels.processor.merge import MOST_FRAMES, merge
from gpusim.measure.merge import full_value
from gpusim.pipeline.developer import CLIPPED, STANDS_OUT, Developer
from gpusim.pipeline.exposure import HOT
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.report import StageReport
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


def merge_bracket(
    simulator: Simulator, frames: Iterable[Frame], *, full_scale: float | None = None
) -> Frame:
    """Merge frames with different exposure times into one high dynamic range picture.

    Each pixel becomes the mean of its rates, electrons per second, weighted by inverse variance.
    Frames in which it is full are left out; if all are, it takes the value of the frame that holds
    the largest rate: the shortest, if gains are equal. See `processor.merge`. The converter clips
    values below digital number 0: a camera with a black level stays unbiased in the dark. If the
    camera replaces defective pixels, this is done in every frame before the merge; known ones are
    detected instead if the map is not the simulator's or pixels are binned.

    Frames are not aligned: they must show the same scene from the same place. A shake of 5 and 7
    pixels lowers 39 dB to 25 dB.

    Args:
        simulator: simulator of the camera.
        frames: 2 to 16 frames of one camera and size, as digital numbers, in any order and with any analog gains.
        full_scale: largest rate that the merged raw values hold [e- s-1]; None is the largest that
            any frame holds.

    Returns:
        A frame as of the longest exposure with an unlimited well. `mean` is the merged electrons,
        float32 (rows, cols) or (C, rows, cols) [e-]; divided by `exposure_time` it is a rate,
        negative if noise makes it so. `raw` is the same in 16 bits up to full_scale. `linear` is
        developed from it, as bright as the frame of the middle exposure: its display white stays 1,
        brighter values exceed it. Dark parts are developed at a scale 256 times finer if 16 bits
        are too coarse for them.

    Raises:
        BadData: if the frames do not fit together, every pixel is full in all, or digital binning
            hides which are full.
        OutOfRange: if an exposure time or full_scale is out of range.
    """
    frames = _check_frames("merge_bracket", frames, MOST_FRAMES)
    tables = _merge_tables(frames, simulator.readout.averaged)
    order = np.argsort(
        -(tables["ceiling"] - tables["dark"]) / tables["gain"] / tables["time"], kind="stable"
    )
    frames = [frames[i] for i in order]
    tables = {key: values[order] for key, values in tables.items()}
    times, sensor = tables["time"], frames[0].camera.sensor
    longest, limit = float(times.max()), sensor.saturation / times[0]
    full_scale = limit if full_scale is None else full_scale
    if not isinstance(full_scale, (int, float, np.number)) or not 0 < full_scale < np.inf:
        raise OutOfRange("full_scale", f"{full_scale} e-/s", "0 < full_scale < inf")
    if (frames[0].raw >= tables["ceiling"][0]).all():
        raise BadData(
            "merge_bracket: every pixel is full in the frame that holds the largest rate, of "
            f"{times[0]:.4g} s; take a shorter exposure"
        )
    period = (1, 1) if sensor.stacked else sensor.cfa_indices.shape
    device = simulator.device
    has_photon_noise = sensor.noise.photon != "none"
    with device.timed() as ms:
        raw = _replace_defects(simulator, frames)
        each = (-1, *[1] * (raw.ndim - 1))
        ceiling = np.ceil(tables["ceiling"]).astype(raw.dtype).reshape(each)
        raw = np.where(_find_full("merge_bracket", frames), ceiling, raw)
        rates = []
        for layer in raw.reshape(len(frames), -1, *raw.shape[-2:]).swapaxes(0, 1):
            stack = device.array(np.ascontiguousarray(layer), np.uint16)
            rate = merge(stack, **tables, period=period, photon=has_photon_noise, device=device)
            rates.append(device.numpy(rate))
        rate = np.stack(rates).reshape(raw.shape[1:])
    # [e- in the longest exposure]
    dark_noise = float((np.square(times / longest) / tables["floor"]).sum() ** -0.5)
    shown = frames[len(frames) // 2]
    span = f"{times.min():.4g} .. {longest:.4g} s"
    model = f"{len(frames)} exposures, {span}, to rates, weighted by inverse variance"
    return develop_merged(
        simulator,
        shown,
        rate * np.float32(longest),
        exposure_time=longest,
        full=full_scale * longest,
        saturated=limit / full_scale,
        ratio=shown.exposure_time / longest,
        dark_noise=dark_noise,
        defects=_defect_method(simulator, frames),
        ms=ms,
        stages={"processor.merge": model},
    )


def merge_burst(simulator: Simulator, frames: Iterable[Frame], *, reference: int = 0) -> Frame:
    """Merge frames with equal exposure into one picture with less noise, aligned to a reference.

    Tiles of 16 x 16 periods of the mosaic are searched in every frame (`processor.align`), moved
    onto the reference and averaged. Blocks of one period get weight 0 if they differ by more than
    noise explains (`processor.average`): moving objects appear as in the reference, without ghosts
    and with its noise. A tile moves only if noise does not explain the difference: at rest the
    variance is 1 / n of one frame's, within 2 %, on flat fields and sharp edges, for 2 to 16
    frames, 20 to 2000 electrons and periods of 1 to 6 pixels. Defective pixels are handled as by
    `merge_bracket`.

    Args:
        simulator: simulator of the camera.
        frames: two or more frames of one camera, size, exposure time and gain, as digital numbers.
            Frames of less than 16 periods of the mosaic are aligned as one tile.
        reference: index of the frame that the others are aligned to.

    Returns:
        A frame as of n times the exposure time, the sum of n frames without noise correlated among
        them. `mean` is the collected electrons, float32 (rows, cols) [e-]; `raw` is in 16 bits;
        `linear` is as bright as the reference.

    Raises:
        BadData: if the frames do not fit together.
        OutOfRange: if an exposure time or the reference is out of range.
    """
    frames = _check_frames("merge_burst", frames, None)
    times = np.array([frame.exposure_time for frame in frames])
    sensors = [frame.camera.sensor for frame in frames]
    gains = {sensor.gain_dn_per_electron for sensor in sensors}
    if np.ptp(times) > 1e-9 * times[0] or len(gains) > 1:
        raise BadData(
            "merge_burst: the frames differ in exposure time or gain; wanted equal ones; use merge_bracket "
            "for different ones"
        )
    sensor, count = sensors[0], len(frames)
    device, gain = simulator.device, sensor.gain_dn_per_electron
    period = (1, 1) if sensor.stacked else sensor.cfa_indices.shape
    shape = frames[0].raw.shape
    one_layer = np.stack([frame.raw.reshape(-1, *shape[-2:])[0] for frame in frames])
    checked_stack(one_layer, reference, period)
    # fixed offsets count as noise, because frames move
    noise = Developer(frames[0].camera, device, simulator.readout.averaged).noise
    with device.timed() as ms:
        # of stacked pixels the brightest layer is aligned, and all move with it
        raw = _replace_defects(simulator, frames)
        layers = raw.reshape(count, -1, *shape[-2:]).swapaxes(0, 1)
        brightest = int(np.argmax([layer.mean() for layer in layers]))
        stacks = [device.array(np.ascontiguousarray(layer), np.uint16) for layer in layers]
        aligned = stacks[brightest]
        if TILE > min(shape[-2] // period[0], shape[-1] // period[1]) > 0:
            aligned = device.array(_fill_tile(layers[brightest], period), np.uint16)
        displacement = align(aligned, reference=reference, period=period, device=device)
        means = [
            average(
                stack,
                displacement,
                reference=reference,
                period=period,
                noise=noise,
                black_level=sensor.dark_level,
                device=device,
            )
            for stack in stacks
        ]
        numbers = np.stack([np.array(device.numpy(mean)) for mean in means]).reshape(shape)
    dark = sensor.noise.operating_dark_current * times[0]
    electrons = (numbers - np.float32(sensor.dark_level)) * np.float32(count / gain)
    electrons = electrons - np.float32(count * dark)
    full = (sensor.white_level - sensor.dark_level) / gain
    variance = RawNoise.of(sensor, simulator.readout.averaged).variance(dark)
    dark_noise = float(np.sqrt(count * variance))
    return develop_merged(
        simulator,
        frames[int(reference)],
        electrons,
        exposure_time=count * times[0],
        full=count * full,
        saturated=sensor.saturation / full,
        ratio=1 / count,
        dark_noise=dark_noise,
        defects=_defect_method(simulator, frames),
        ms=ms,
        stages={
            "processor.align": "tiles of 16 x 16 periods of the mosaic, by a pyramid",
            "processor.average": f"{count} frames, moved onto frame {int(reference)}",
        },
    )


def _fill_tile(layer, period):
    """Return frames (n, rows, cols) in which the outermost periods repeat, up to one tile at least."""
    places = []
    for size, length in zip(layer.shape[-2:], period, strict=True):
        whole = max(size // length, 1)
        at = np.arange(max(size, TILE * length))
        last = np.minimum(at // length, whole - 1) * length + at % length
        places.append(np.where(at < size, at, last))
    rows, cols = places
    return np.ascontiguousarray(layer[:, rows[:, None], cols])


def merge_reads(simulator: Simulator, frames: Iterable[Frame]) -> Frame:
    """Fit the slope of non-destructive reads of one growing charge, see `Reads`.

    The slope is the weighted mean of the differences between reads, with the weights of least
    variance for photon and read noise at the mean rate of the neighbours. The noise of the reset
    cancels. Reads of full pixels are left out; a pixel with only one read left takes its value.
    Defective pixels are handled as by `merge_bracket`.

    Args:
        simulator: simulator of the camera.
        frames: 2 to 16 reads of one exposure, in their order.

    Returns:
        A frame as of the last read with an unlimited well. `mean` is the slope times the exposure
        time, float32 [e-]; `raw` is the same in 16 bits.

    Raises:
        BadData: if the frames do not fit together, their times do not rise, or digital binning hides
            which pixels are full.
        OutOfRange: if an exposure time is out of range.
    """
    frames = _check_frames("merge_reads", frames, MOST_FRAMES)
    averaged = simulator.readout.averaged
    tables = _merge_tables(frames, averaged)
    times, sensor = tables["time"], frames[0].camera.sensor
    if (np.diff(times) <= 0).any():
        raise BadData(
            "merge_reads: the exposure times do not rise; wanted the reads in their order"
        )
    device, period = simulator.device, (1, 1) if sensor.stacked else sensor.cfa_indices.shape
    with device.timed() as ms:
        raw = _replace_defects(simulator, frames)
        gain, dark, full = (tables[name][:, None, None] for name in ("gain", "dark", "ceiling"))
        charges = raw.reshape(len(frames), -1, raw.shape[-1])
        usable = (charges < full) & ~_find_full("merge_reads", frames).reshape(charges.shape)
        usable = np.logical_and.accumulate(usable, axis=0).sum(axis=0)
        charges = (charges - dark) / gain
        # without the photons' part, which `_slope_weights` adds
        noise = RawNoise.of(sensor, averaged).variance()
        photons = float(sensor.noise.photon != "none") / averaged
        rate = np.zeros(charges.shape[1:])
        for count in range(len(frames) + 1):
            here = usable == count
            if count < 2:  # full before the second read: a single value
                rate[here] = charges[0][here] / times[0]
                continue
            if not here.any():
                continue
            guess = (charges[count - 1] - charges[0]) / (times[count - 1] - times[0])
            guess = photons * np.maximum(_mean_of_neighbours(guess, period), 0)
            levels = np.r_[0.0, np.geomspace(1e-3, 1e3, 25)] * noise / np.diff(times[:count]).min()
            nearest = np.abs(np.log((levels + levels[1]) / (guess[here][:, None] + levels[1])))
            weights = np.array([_slope_weights(times[:count], noise, level) for level in levels])
            steps = np.diff(charges[:count], axis=0)[:, here]
            rate[here] = (weights[nearest.argmin(axis=1)].T * steps).sum(axis=0)
        rate = rate.astype(np.float32).reshape(raw.shape[1:])
    last, limit = float(times[-1]), sensor.saturation / times[0]
    weights = _slope_weights(times, noise, 0.0)
    return develop_merged(
        simulator,
        frames[-1],
        rate * np.float32(last),
        exposure_time=last,
        full=limit * last,
        saturated=1.0,
        ratio=1.0,
        dark_noise=last
        * float(noise * np.square(np.diff(weights, prepend=0, append=0)).sum()) ** 0.5,
        defects=_defect_method(simulator, frames),
        ms=ms,
        stages={"processor.merge": f"slope of {len(frames)} reads, 0 .. {last:.4g} s"},
    )


def _find_full(function, frames):
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


def _slope_weights(times, noise, rate):
    """Return the weights of the differences between reads, (reads - 1,), for the least variance of the slope.

    noise: variance of a read [e-2]. rate: electrons per second, which scatter as photons do.
    """
    steps = np.diff(times)
    covariance = np.diag(rate * steps + 2 * noise) - noise * (
        np.eye(len(steps), k=1) + np.eye(len(steps), k=-1)
    )
    if not covariance.any():
        covariance = np.eye(len(steps))
    solved = np.linalg.solve(covariance, steps)
    return solved / (solved @ steps)


def _mean_of_neighbours(values, period):
    """Return the mean of the 24 nearest pixels of the same color, without the pixel itself."""
    from scipy.ndimage import uniform_filter

    found = np.empty_like(values)
    for y in range(period[0]):
        for x in range(period[1]):
            own = np.s_[y :: period[0], x :: period[1]]
            found[own] = (25 * uniform_filter(values[own], 5, mode="nearest") - values[own]) / 24
    return found


def merge_flash(
    simulator: Simulator, ambient: Frame, flash: Frame, *, radius: int = 8, reach: float = 6.0
) -> Frame:
    """Denoise an ambient picture by averaging pixels that look equal in a flash picture.

    The picture keeps its own light. The noise taken into account is the sensor's, through the
    camera's colour matrix. See `processor.flash`.

    Args:
        simulator: simulator of the camera.
        ambient: frame without flash.
        flash: frame of the same camera and view with flash in addition to the scene's light;
            exposure times and gains are free.
        radius: radius of the window, 1 to 12 [pixel].
        reach: squared difference relative to noise from which pixels count as different.

    Returns:
        The ambient frame with new `linear` and `rgb`.

    Raises:
        BadData: if the frames do not fit together or have NaN or infinite values.
        OutOfRange: if an exposure time, the radius or the reach is out of range.
    """
    ambient, flash = _check_frames("merge_flash", [ambient, flash], None)
    for name, frame in (("ambient", ambient), ("flash", flash)):
        if not np.isfinite(frame.linear).all():
            raise BadData(f"merge_flash: the {name} picture has NaN or infinite values")
    full = CLIPPED * float((flash.rendering.linear_matrix @ flash.rendering.ceiling).min())
    device, averaged = simulator.device, simulator.readout.averaged
    with device.timed() as ms:
        planes = with_flash(
            np.moveaxis(ambient.linear, -1, 0),
            np.moveaxis(flash.linear, -1, 0),
            ambient_noise=_display_noise(ambient, averaged),
            flash_noise=_display_noise(flash, averaged),
            full=full if full > 0 else np.inf,
            radius=radius,
            reach=reach,
            device=device,
        )
    as_is = dataclasses.replace(
        ambient.rendering, display_from_camera=np.eye(3), ceiling=np.full(3, np.inf)
    )
    developer = Developer(ambient.camera, device)
    shown = developer.apply_color(device.array(planes), as_is)
    linear, rgb = host_pictures(device, developer, shown)
    *stages, encoding = ambient.report.stages
    by_flash = StageReport(
        "processor.flash", "denoised by a flash picture", ms.get("processor.flash", 0.0)
    )
    report = dataclasses.replace(ambient.report, stages=[*stages, by_flash, encoding])
    return dataclasses.replace(ambient, linear=linear, rgb=rgb, report=report)


def _check_frames(function, frames, most) -> list[Frame]:
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


def _merge_tables(frames, averaged):
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


def _defect_method(simulator: Simulator, frames):
    """Return how defective pixels are found.

    The chip's map is used only if it is the simulator's and pixels are not binned.
    """
    method, sensor = frames[0].camera.processor.defects, simulator.camera.sensor
    mapped = sensor.binning == (1, 1) and sensor.noise == frames[0].camera.sensor.noise
    return "detect" if method == "known" and not mapped else method


def _replace_defects(simulator: Simulator, frames):
    """Return the raw values of all frames, defects replaced if the camera does so.

    This happens before the merge: merged values have other noise than their electrons, and moved
    ones fit no map of the chip.
    """
    raw = np.stack([frame.raw for frame in frames])
    how, device, shape = _defect_method(simulator, frames), simulator.device, raw.shape[1:]
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


def _display_noise(frame, averaged=1):
    """Return the noise of linear display values as `processor.flash` takes it, (3, 4).

    Only noise from frame to frame counts, because both pictures have the same fixed offsets.
    Root-polynomial colours have the noise of colours next to white. averaged: as for `Developer`.
    """
    sensor, matrix = frame.camera.sensor, frame.rendering.linear_matrix
    noise = RawNoise.of(sensor, averaged)
    scale = sensor.gain_dn_per_electron / (sensor.white_level - sensor.dark_level)
    per_light = scale * matrix**2 @ np.linalg.pinv(matrix) * noise.photons / averaged
    constant = scale**2 * noise.variance(temporal=True) * (matrix**2).sum(axis=1)
    return np.column_stack([per_light, constant])

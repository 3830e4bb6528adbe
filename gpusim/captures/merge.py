"""Merge several frames of one scene: exposure brackets, bursts, pairs with and without flash."""

import dataclasses
from collections.abc import Iterable

import numpy as np

from gpusim.captures.merged_frame import develop_merged, host_pictures, pick_mosaic
from gpusim.captures.merging import (
    check_frames,
    defect_method,
    find_full,
    merge_tables,
    replace_defects,
)
from gpusim.captures.regression import ALIGNED, Views, check_enlargement, is_demosaicked
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import RawNoise
from gpusim.kernels.processor.align import checked_stack
from gpusim.kernels.processor.flash import flash as with_flash
from gpusim.kernels.processor.merge import MOST_FRAMES, merge
from gpusim.kernels.processor.regress import MOST_FRAMES as MOST_FITTED
from gpusim.pipeline.developer import CLIPPED, Developer
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.report import StageReport
from gpusim.pipeline.simulator import Simulator

NEVER = 65536.0  # [DN] that no number reaches
MARGIN = 5.0  # [standard deviations of a pixel] to a full one


def merge_bracket(
    simulator: Simulator,
    frames: Iterable[Frame],
    *,
    full_scale: float | None = None,
    align: bool = True,
) -> Frame:
    """Merge frames with different exposure times into one high dynamic range picture.

    Each pixel becomes the mean of its rates, electrons per second, weighted by inverse variance.
    Frames in which it is full are left out; if all are, it takes the value of the frame that holds
    the largest rate: the shortest, if gains are equal. See `processor.merge`. The converter clips
    values below digital number 0: a camera with a black level stays unbiased in the dark. If the
    camera replaces defective pixels, this is done in every frame before the merge; known ones are
    detected instead if the map is not the simulator's or pixels are binned.

    Frames are aligned to the one of middle exposure, as rates, without full pixels. If the camera
    moved between them, the picture is made as by `merge_burst`, by kernel regression of all
    samples. Blocks of a frame that show something else than the reference by more than noise
    explains are left out: moving objects appear once. Any order of exposures is allowed, also
    repeated ones, such as short, long, short.

    Args:
        simulator: simulator of the camera.
        frames: 2 to 16 frames of one camera and size, as digital numbers, in any order and with any analog gains.
        full_scale: largest rate that the merged raw values hold [e- s-1]; None is the largest that
            any frame holds.
        align: False merges pixel by pixel, without alignment and with no look at what moves.

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
    frames = check_frames("merge_bracket", frames, MOST_FRAMES)
    tables = merge_tables(frames, simulator.readout.averaged)
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
    middle = len(frames) // 2
    shown = frames[middle]
    device, planes = simulator.device, None
    stages = {}
    with device.timed() as ms:
        raw = replace_defects(simulator, frames)
        each = (-1, *[1] * (raw.ndim - 1))
        ceiling = np.ceil(tables["ceiling"]).astype(raw.dtype).reshape(each)
        raw = np.where(find_full("merge_bracket", frames), ceiling, raw)
        if align:
            views = _views(simulator, frames, raw, middle)
            displacement = views.align()
            stages = dict(ALIGNED)
            if views.is_whole(displacement) or not is_demosaicked(shown):
                raw, missing = views.move(raw, displacement)
                raw = _fill_missing(raw, missing, middle, tables)
            else:
                develop = _demosaicker(simulator, shown)
                planes, fitted = views.merge(displacement, _white_rates(shown), develop)
                model = f"{fitted} of {len(frames)} exposures, weighted by inverse variance"
                stages["processor.regress"] = model
        if planes is None:
            rate = _merge_rates(device, raw, tables, sensor)
            span = f"{times.min():.4g} .. {longest:.4g} s"
            model = f"{len(frames)} exposures, {span}, to rates, weighted by inverse variance"
            stages["processor.merge"] = model
        else:
            rate = pick_mosaic(planes, sensor)
            planes = planes * np.float32(longest)
    # [e- in the longest exposure]
    dark_noise = float((np.square(times / longest) / tables["floor"]).sum() ** -0.5)
    return develop_merged(
        simulator,
        shown,
        rate * np.float32(longest),
        exposure_time=longest,
        full=full_scale * longest,
        saturated=limit / full_scale,
        ratio=shown.exposure_time / longest,
        dark_noise=dark_noise,
        defects=defect_method(simulator, frames),
        ms=ms,
        stages=stages,
        planes=planes,
    )


def _merge_rates(device, raw, tables, sensor):
    """Return rates [e- s-1] of frames (n, ...) pixel by pixel, see `processor.merge`."""
    period = (1, 1) if sensor.stacked else sensor.cfa_indices.shape
    has_photon_noise = sensor.noise.photon != "none"
    rates = []
    for layer in raw.reshape(len(raw), -1, *raw.shape[-2:]).swapaxes(0, 1):
        stack = device.array(np.ascontiguousarray(layer), np.uint16)
        rate = merge(stack, **tables, period=period, photon=has_photon_noise, device=device)
        rates.append(device.numpy(rate))
    return np.stack(rates).reshape(raw.shape[1:])


def merge_burst(
    simulator: Simulator, frames: Iterable[Frame], *, reference: int = 0, enlarge: float = 1.0
) -> Frame:
    """Merge frames with equal exposure into one picture with less noise, aligned to a reference.

    The displacement of every frame is found to hundredths of a pixel (`processor.align`,
    `processor.refine`). A shaken camera's samples fall between each other: the picture is then
    fitted to the raw samples of all frames, with kernels that follow edges and widen with the noise
    (`processor.regress`). This takes the place of the camera's demosaicking.

    If the displacements are whole periods of the mosaic, as of a camera at rest, or give few
    fractions of a pixel (two frames half a period apart), samples are averaged instead
    (`processor.average`) and demosaicked by the camera. Then the variance is 1 / n of one frame's,
    within 2 %, on flat fields and sharp edges, for 2 to 16 frames, 20 to 2000 electrons and periods
    of 1 to 6 pixels. So are more than 64 frames, and those of cameras with their own table of
    filters.

    Blocks of one period get weight 0 if they differ from the reference by more than noise explains
    (`processor.trust`): moving objects appear as in the reference, without ghosts and with its
    noise. Defective pixels are handled as by `merge_bracket`.

    Args:
        simulator: simulator of the camera.
        frames: two or more frames of one camera, size, exposure time and gain, as digital numbers.
            Frames of less than 16 periods of the mosaic are aligned as one tile.
        reference: index of the frame that the others are aligned to.
        enlarge: pixels of the picture per pixel of the camera, along rows and columns, 1 to 3.
            Above 1 the frames are always fitted, even at rest, where nothing is gained. 1.5 suits
            eight frames.

    Returns:
        A frame as of n times the exposure time, the sum of n frames. `mean` is the collected
        electrons, float32 (rows, cols) [e-]; `raw` is in 16 bits; `linear` is as bright as the
        reference. Of fitted frames, `mean` and `raw` are the mosaic's part of a picture of all
        channels, from which `linear` is developed; their noise is less than the camera's sensor
        says, and correlated among neighbours.

    Raises:
        BadData: if the frames do not fit together.
        OutOfRange: if an exposure time, the reference or `enlarge` is out of range, or a camera with
            its own table of filters is asked to enlarge.
    """
    frames = check_frames("merge_burst", frames, None)
    times = np.array([frame.exposure_time for frame in frames])
    sensors = [frame.camera.sensor for frame in frames]
    gains = {sensor.gain_dn_per_electron for sensor in sensors}
    if np.ptp(times) > 1e-9 * times[0] or len(gains) > 1:
        raise BadData(
            "merge_burst: the frames differ in exposure time or gain; wanted equal ones; use merge_bracket "
            "for different ones"
        )
    sensor, count, shape = sensors[0], len(frames), frames[0].raw.shape
    device, gain = simulator.device, sensor.gain_dn_per_electron
    period = (1, 1) if sensor.stacked else sensor.cfa_indices.shape
    one_layer = np.stack([frame.raw.reshape(-1, *shape[-2:])[0] for frame in frames])
    checked_stack(one_layer, reference, period)
    check_enlargement(enlarge)
    shown = frames[int(reference)]
    can_fit = is_demosaicked(shown) and count <= MOST_FITTED
    if enlarge > 1 and not can_fit:
        allowed = (
            f"1 with a table of filters (processor.table), or of more than {MOST_FITTED} frames"
        )
        raise OutOfRange("enlarge", enlarge, allowed)
    dark = sensor.noise.operating_dark_current * times[0]
    with device.timed() as ms:
        views = _views(simulator, frames, replace_defects(simulator, frames), int(reference))
        views.table[4] = (
            NEVER  # all frames are full at the same light: their mean is as clipped as each
        )
        displacement, planes = views.align(), None
        stages = dict(ALIGNED)
        if enlarge > 1 or (can_fit and not views.is_whole(displacement)):
            develop = _demosaicker(simulator, shown)
            planes, fitted = views.merge(displacement, _white_rates(shown), develop, enlarge)
            planes *= np.float32(count * times[0])
            electrons = pick_mosaic(planes, sensor)
            size = f", {enlarge:g} x the size" if enlarge > 1 else ""
            onto = f"{fitted} of {count} frames onto frame {int(reference)}{size}"
            stages["processor.regress"] = onto
        else:
            # fixed offsets count as noise, because frames move
            noise = Developer(frames[0].camera, device, simulator.readout.averaged).noise
            numbers = views.average(displacement, noise, sensor.dark_level).reshape(shape)
            electrons = (numbers - np.float32(sensor.dark_level)) * np.float32(count / gain)
            electrons = electrons - np.float32(count * dark)
            del stages["processor.trust"]
            stages["processor.average"] = f"{count} frames, moved onto frame {int(reference)}"
    full = (sensor.white_level - sensor.dark_level) / gain
    variance = RawNoise.of(sensor, simulator.readout.averaged).variance(dark)
    dark_noise = float(np.sqrt(count * variance))
    return develop_merged(
        simulator,
        shown,
        electrons,
        exposure_time=count * times[0],
        full=count * full,
        saturated=sensor.saturation / full,
        ratio=1 / count,
        dark_noise=dark_noise,
        defects=defect_method(simulator, frames),
        ms=ms,
        stages=stages,
        planes=planes,
        enlarge=enlarge,
    )


def _views(simulator, frames, raw, reference):
    """Return frames as `Views`. raw: their digital numbers, defects replaced."""
    sensor = frames[0].camera.sensor
    tables = merge_tables(frames, simulator.readout.averaged)
    noise = RawNoise.of(sensor, simulator.readout.averaged)
    time = tables["time"]
    table = [
        tables["dark"],
        1 / (tables["gain"] * time),
        noise.photons / noise.averaged / time,
        tables["floor"] / time**2,
        tables["ceiling"],
    ]
    layers = raw.reshape(len(raw), -1, *raw.shape[-2:]).swapaxes(0, 1)
    cfa = np.zeros((1, 1), np.int32) if sensor.stacked else sensor.cfa_indices
    lines = (noise.lines + noise.line_offsets) / noise.averaged / tables["floor"].min()
    return Views(simulator.device, layers, reference, cfa, np.array(table), lines)


def _demosaicker(simulator, frame):
    """Return the function that demosaicks digital numbers to digital numbers as a frame's camera does."""
    camera, device, sensor = frame.camera, simulator.device, frame.camera.sensor
    processor = dataclasses.replace(camera.processor, defects="none", denoise=0.0, shading=False)
    plain = dataclasses.replace(camera, processor=processor)
    developer = Developer(plain, device, simulator.readout.averaged)

    def develop(mosaic):
        mosaic = device.array(np.ascontiguousarray(mosaic), np.uint16)
        values = developer.demosaic(mosaic, white=frame.rendering.neutral, blur=frame.blur)
        values = np.array(device.numpy(values))
        return sensor.dark_level + (sensor.white_level - sensor.dark_level) * values

    return develop


def _white_rates(frame):
    """Return the rates [e- s-1] of display white in each channel of a frame's camera."""
    sensor, rendering = frame.camera.sensor, frame.rendering
    full = (sensor.white_level - sensor.dark_level) / sensor.gain_dn_per_electron
    return rendering.neutral * rendering.white * full / frame.exposure_time


def _fill_missing(raw, missing, reference, tables):
    """Return raw values of which the parts that a frame does not have count no more.

    They count as full. The frame that holds the largest rate, the first, is always used: it takes
    the reference's rate, unless that may be full too. missing: bool (frames, rows, cols).
    """
    dark, gain, time, ceiling = (tables[name] for name in ("dark", "gain", "time", "ceiling"))
    rate = (raw[reference] - dark[reference]) / gain[reference] / time[reference]
    same = np.clip(np.rint(rate * gain[0] * time[0] + dark[0]), 0, None)
    noise = np.sqrt(np.maximum(rate * time[reference], 0) + tables["floor"][reference])
    left = (ceiling[reference] - raw[reference]) / gain[reference]
    same = np.where(left > MARGIN * noise, same, raw[0])
    for i, values in enumerate(raw):
        if i != reference:
            filled = np.ceil(ceiling[i]) if i else same
            values[...] = np.where(missing[i], filled, values).astype(raw.dtype)
    return raw


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
    frames = check_frames("merge_reads", frames, MOST_FRAMES)
    averaged = simulator.readout.averaged
    tables = merge_tables(frames, averaged)
    times, sensor = tables["time"], frames[0].camera.sensor
    if (np.diff(times) <= 0).any():
        raise BadData(
            "merge_reads: the exposure times do not rise; wanted the reads in their order"
        )
    device, period = simulator.device, (1, 1) if sensor.stacked else sensor.cfa_indices.shape
    with device.timed() as ms:
        raw = replace_defects(simulator, frames)
        gain, dark, full = (tables[name][:, None, None] for name in ("gain", "dark", "ceiling"))
        charges = raw.reshape(len(frames), -1, raw.shape[-1])
        usable = (charges < full) & ~find_full("merge_reads", frames).reshape(charges.shape)
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
        defects=defect_method(simulator, frames),
        ms=ms,
        stages={"processor.merge": f"slope of {len(frames)} reads, 0 .. {last:.4g} s"},
    )


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
    ambient, flash = check_frames("merge_flash", [ambient, flash], None)
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

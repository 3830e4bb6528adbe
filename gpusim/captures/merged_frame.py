"""Frames of merged electrons: 16-bit raw values, developed like a captured frame."""

import dataclasses

import numpy as np

from gpusim.domain.raw_noise import ROUNDING
from gpusim.kernels.processor.sharpen import REACH
from gpusim.pipeline.developer import Developer
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.report import StageReport
from gpusim.pipeline.simulator import Simulator

COLOURS = (  # stages that make linear display RGB, and those behind
    "processor.color",
    "processor.sharpen",
    "processor.local_tone",
    "processor.gamut",
    "display.encode",
)
PEDESTAL, TOP = 1024, 65535  # black and largest value of merged raw values [DN]
FINER = 256  # finer scale of dark parts if 16 bits are too coarse for them
COARSE = 0.1  # rounding variance relative to dark noise above which the finer scale is used
SEEN = 16  # [pixel] reach of demosaicking
# noise of one frame: merged values have all that is left of it as read noise
MERGED_NOISE = "dark_current", "reset", "adc", "row", "column", "dsnu", "row_dsnu", "column_dsnu"


def develop_merged(
    simulator: Simulator,
    frame,
    electrons,
    *,
    exposure_time,
    full,
    saturated,
    ratio,
    dark_noise,
    defects,
    ms,
    stages,
    planes=None,
    enlarge=1.0,
):
    """Return a frame of merged electrons.

    frame: frame whose rendering is kept. electrons: of `exposure_time` [s]. full: electrons of the
    largest raw value. saturated: saturation of the frames relative to it. ratio: the frame's
    exposure time over the merged one's. dark_noise: standard deviation without light [e-]. defects:
    how they were found. ms: milliseconds per stage of the merge. stages: stages of the merge ->
    their report lines. planes: electrons of all channels (C, rows, cols) of a merge that has
    demosaicked; None: the camera does it. enlarge: pixels per pixel of the camera.
    """
    device, old, processor_before = simulator.device, frame.camera.sensor, frame.camera.processor
    averaged, shading = simulator.readout.averaged, frame.shading
    binning = simulator.readout.sensor.binning
    chip = dataclasses.replace(
        old.noise, read=dark_noise * averaged**0.5, **dict.fromkeys(MERGED_NOISE, 0.0)
    )
    processor = dataclasses.replace(processor_before, defects="none", shading=shading is not None)

    cells = old if planes is None else dataclasses.replace(old, stacked=True)
    gains = shading
    if planes is not None:  # developed, and their noise removed, as of stacked pixels
        plain = {"demosaic": "auto", "network": None, "denoise": processor_before.denoising}
        layered = dataclasses.replace(processor, **plain)
        if shading is not None and not old.stacked:
            gains = shading[np.unique(old.cfa_indices, return_index=True)[1]]
    kernel = _enlarge_kernel(frame.kernel, enlarge)

    def digitise(electrons, gain):
        """Return digital numbers of electrons, layers below each other."""
        numbers = electrons * np.float32(gain) + np.float32(PEDESTAL)
        return np.rint(np.clip(numbers, 0, TOP)).astype(np.uint16)

    def develop_at(full):
        """Return camera, digital numbers, developer and planes if 1 is `full` electrons."""
        gain = (TOP - PEDESTAL) / full
        operated = {
            "bits": 16,
            "black_level": PEDESTAL,
            "analog_offset": 0.0,
            "gain": gain,
            "analog_gain": 1.0,
            "conversion_gain": None,
            "adc_range": None,
            "full_well": full,
            "noise": chip,
            "pixel_pitch": old.pixel_pitch / enlarge,
            "offset": tuple(
                enlarge * shift - centre
                for shift, centre in zip(old.displacement, old.centre, strict=True)
            ),
        }
        camera = dataclasses.replace(
            frame.camera, sensor=dataclasses.replace(old, **operated), processor=processor
        )
        raw, shown, cameras = digitise(electrons, gain), electrons, camera
        if planes is not None:
            cell = dataclasses.replace(cells, **operated)
            cameras = dataclasses.replace(camera, sensor=cell, processor=layered)
            shown = planes
        developer = Developer(cameras, device, averaged, binning=binning)
        numbers = digitise(shown, gain)
        values = developer.demosaic(
            device.array(numbers.reshape(-1, numbers.shape[-1]), np.uint16),
            shading=gains,
            white=frame.rendering.neutral,
            blur=frame.blur * enlarge,
        )
        return camera, raw, developer, values

    with device.timed() as ms_developed:
        camera, raw, developer, values = develop_at(full)
        step = full / (TOP - PEDESTAL)
        if step**2 * ROUNDING > COARSE * dark_noise**2:
            fine = device.numpy(develop_at(full / FINER)[-1]) / FINER
            # gains of the shading correction clip earlier
            most = 1.0 if shading is None else max(1.0, float(shading.max()))
            light = electrons if planes is None else planes
            is_bright = _bright_mask(light, full / FINER / most)
            values = device.array(np.where(is_bright, device.numpy(values), fine))
        # camera value of the frame over the merged one
        k = full * ratio * old.gain_dn_per_electron / (old.white_level - old.dark_level)
        rendering = frame.rendering
        rescaled = dataclasses.replace(
            rendering,
            display_from_camera=rendering.display_from_camera * k,
            ceiling=rendering.neutral * saturated,
            white=rendering.white / k,
            saturation=saturated,
        )
        shown = developer.finish(values, rescaled, kernel)
        linear, rgb = host_pictures(device, developer, shown)
    first = {}
    if defects != "none":
        replacing = dataclasses.replace(processor, defects=defects)
        models = Developer(dataclasses.replace(camera, processor=replacing), device).models()
        first["processor.defects"] = models["processor.defects"] + ", frame by frame"
    taken = {
        name: ms.get(name, 0.0) + ms_developed.get(name, 0.0) for name in {**ms, **ms_developed}
    }
    models = developer.models()
    if planes is not None:  # the merge has demosaicked
        del models["processor.linear"]
    report = _replace_stages(frame.report, first | stages | models, taken)
    return Frame(
        camera,
        float(exposure_time),
        rescaled,
        electrons,
        raw,
        linear,
        rgb,
        report,
        _enlarge_labels(frame.labels, electrons.shape[-2:]),
        frame.blur * enlarge,
        shading,
        averaged=None,
        kernel=kernel,
    )


def pick_mosaic(planes, sensor):
    """Return the values (rows, cols) that a mosaic on the picture would have; of stacked pixels all."""
    if sensor.stacked:
        return planes
    cfa, (rows, cols) = sensor.cfa_indices, planes.shape[1:]
    channel = cfa[np.arange(rows)[:, None] % cfa.shape[0], np.arange(cols) % cfa.shape[1]]
    return np.take_along_axis(planes, channel[None], axis=0)[0]


def _enlarge_labels(labels, shape):
    """Return labels of the pixels of a picture of this shape, each the one of the nearest pixel."""
    found = {}
    for name, values in labels.items():
        rows, cols = values.shape[:2]
        if (rows, cols) != tuple(shape):
            at = [
                np.clip(((np.arange(n) + 0.5) * old / n).astype(int), 0, old - 1)
                for n, old in zip(shape, (rows, cols), strict=True)
            ]
            values = values[np.ix_(*at)]
        found[name] = values
    return found


def _enlarge_kernel(kernel, enlarge):
    """Return the camera's own blur in pixels of the enlarged picture; None without any."""
    if kernel is None or enlarge == 1:
        return kernel
    from scipy.ndimage import map_coordinates

    half = [min(int(np.ceil(n // 2 * enlarge)), REACH) for n in kernel.shape]
    y, x = np.mgrid[-half[0] : half[0] + 1, -half[1] : half[1] + 1] / enlarge
    middle = [n // 2 for n in kernel.shape]
    drawn = map_coordinates(kernel, [y + middle[0], x + middle[1]], order=1)
    return (drawn / drawn.sum()).astype(kernel.dtype)


def host_pictures(device, developer, shown):
    """Return `linear` and `rgb` of a frame from linear display RGB on the device."""
    planes = np.array(device.numpy(shown), np.float32)
    codes = np.array(device.numpy(developer.encode(shown)))
    return np.moveaxis(planes, 0, -1), codes


def _replace_stages(report, processing, ms):
    """Return a frame's report with other stages between its sensor and its colours."""
    before = [
        stage for stage in report.stages if not stage.stage.startswith(("processor.", "display."))
    ]
    after = [
        dataclasses.replace(stage, ms=ms.get(stage.stage, 0.0))
        for stage in report.stages
        if stage.stage in COLOURS
    ]
    stages = [
        StageReport(name, model, ms.get(name, 0.0))
        for name, model in processing.items()
        if name not in COLOURS
    ]
    return dataclasses.replace(report, stages=[*before, *stages, *after])


def _bright_mask(electrons, limit):
    """Return where demosaicking may have mixed in a value above `limit` [e-], bool (rows, cols)."""
    from scipy.ndimage import maximum_filter

    brightest = electrons.reshape(-1, *electrons.shape[-2:]).max(axis=0)
    return maximum_filter(brightest, 2 * SEEN + 1) >= 0.99 * limit

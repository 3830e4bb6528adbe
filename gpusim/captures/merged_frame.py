"""Frames of merged electrons: 16-bit raw values, developed like a captured frame."""

import dataclasses

import numpy as np

from gpusim.domain.raw_noise import ROUNDING
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
REACH = 16  # [pixel] reach of demosaicking
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
):
    """Return a frame of merged electrons.

    frame: frame whose rendering is kept. electrons: of `exposure_time` [s]. full: electrons of the
    largest raw value. saturated: saturation of the frames relative to it. ratio: the frame's
    exposure time over the merged one's. dark_noise: standard deviation without light [e-]. defects:
    how they were found. ms: milliseconds per stage of the merge. stages: stages of the merge ->
    their report lines.
    """
    device, old, processor_before = simulator.device, frame.camera.sensor, frame.camera.processor
    averaged, shading = simulator.readout.averaged, frame.shading
    binning = simulator.readout.sensor.binning
    chip = dataclasses.replace(
        old.noise, read=dark_noise * averaged**0.5, **dict.fromkeys(MERGED_NOISE, 0.0)
    )
    processor = dataclasses.replace(processor_before, defects="none", shading=shading is not None)

    def develop_at(full):
        """Return camera, digital numbers, developer and planes if 1 is `full` electrons."""
        gain = (TOP - PEDESTAL) / full
        sensor = dataclasses.replace(
            old,
            bits=16,
            black_level=PEDESTAL,
            analog_offset=0.0,
            gain=gain,
            analog_gain=1.0,
            conversion_gain=None,
            adc_range=None,
            full_well=full,
            noise=chip,
        )
        camera = dataclasses.replace(frame.camera, sensor=sensor, processor=processor)
        numbers = electrons * np.float32(gain) + np.float32(PEDESTAL)
        raw = np.rint(np.clip(numbers, 0, TOP)).astype(np.uint16)
        developer = Developer(camera, device, averaged, binning=binning)
        planes = developer.demosaic(
            device.array(raw.reshape(-1, raw.shape[-1]), np.uint16),
            shading=shading,
            white=frame.rendering.neutral,
            blur=frame.blur,
        )
        return camera, raw, developer, planes

    with device.timed() as ms_developed:
        camera, raw, developer, planes = develop_at(full)
        step = full / (TOP - PEDESTAL)
        if step**2 * ROUNDING > COARSE * dark_noise**2:
            fine = device.numpy(develop_at(full / FINER)[-1]) / FINER
            # gains of the shading correction clip earlier
            most = 1.0 if shading is None else max(1.0, float(shading.max()))
            is_bright = _bright_mask(electrons, full / FINER / most)
            planes = device.array(np.where(is_bright, device.numpy(planes), fine))
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
        shown = developer.finish(planes, rescaled, frame.kernel)
        linear, rgb = host_pictures(device, developer, shown)
    first = {}
    if defects != "none":
        replacing = dataclasses.replace(processor, defects=defects)
        models = Developer(dataclasses.replace(camera, processor=replacing), device).models()
        first["processor.defects"] = models["processor.defects"] + ", frame by frame"
    taken = {
        name: ms.get(name, 0.0) + ms_developed.get(name, 0.0) for name in {**ms, **ms_developed}
    }
    report = _replace_stages(frame.report, first | stages | developer.models(), taken)
    return Frame(
        camera,
        float(exposure_time),
        rescaled,
        electrons,
        raw,
        linear,
        rgb,
        report,
        frame.labels,
        frame.blur,
        shading,
        averaged=None,
        kernel=frame.kernel,
    )


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
    return maximum_filter(brightest, 2 * REACH + 1) >= 0.99 * limit

"""How much work the stages of a frame have, in a unit of each stage's own: the cost model, less a device's speeds.

A unit is a byte read or written where memory sets the time, an operation of a transform where arithmetic does, and
else a pixel. `of_bench` gives the work of a stage's benchmark, so that its time tells what a unit takes.
"""

from math import prod

import numpy as np

from gpusim.kernels.common import fft
from gpusim.kernels.stage import stage_module
from gpusim.optics.splines import multiplications
from gpusim.planner.plan import Plan

ONCE = ("optics.airy", "optics.pupil", "sensor.pattern")  # stages that run once for a camera


def of_plan(plan: Plan, models) -> dict[str, float]:
    """Work of every stage of a frame that follows others like it.

    models: names of the stages of the read-out, the processor and the display, which look at every pixel once.
    """
    content, channels = plan.content, len(plan.weights)
    samples, pixels = prod(content.shape), prod(plan.scene.shape)
    layers = channels if plan.camera.sensor.stacked else 1
    planes = len(content.entry_spectra) if plan.table is None else len(plan.table)
    work: dict[str, float] = {}
    if plan.table is not None:
        stage = "spectral.integrate" if content.labels is None else "spectral.materials"
        work[stage] = content.nbytes + 4 * planes * samples
    if plan.watch is not None:  # of every scene that it was not made for
        entries = 1 if content.labels is not None else len(content.entry_spectra)
        work["spectral.survey"] = len(plan.watch.first) * content.shape[1] * entries
    if plan.is_placed:
        work["optics.distort"] = (planes + channels) * samples
    if plan.mix is not None:
        work |= _blur(plan, planes, samples, channels)
    if plan.far is not None:
        work["optics.far"] = multiplications(
            content.shape, planes, channels, tuple(plan.far.sigmas), plan.far.spacings
        )
    if plan.highlights is not None:
        across = np.minimum(2 * plan.highlights.reach, max(content.shape))
        work["optics.splat"] = float(np.square(across, dtype=np.float64).sum()) * (
            1 if plan.folded else channels
        )
    if plan.taps is not None:
        work["optics.sample"] = samples * channels
    if plan.falloff is not None:
        work["optics.falloff"] = pixels * channels
    work["sensor.collect"] = pixels * layers
    return work | {stage: float(pixels * layers) for stage in models if stage not in ONCE}


def _blur(plan, planes, samples, channels):
    frequencies = plan.period[0] * (plan.period[1] // 2 + 1)
    if plan.tiling is not None:
        side, cfa = plan.tiling.side, plan.camera.sensor.cfa_indices.shape
        phases, size = (
            (prod(cfa), [side // n for n in cfa]) if plan.folded else (channels, (side, side))
        )
        one = planes * fft.operations((side, side)) + 4 * frequencies * planes * channels
        count = plan.tiling.samples(plan.scene.samples) / side**2
        return {"optics.tiles": count * (one + phases * fft.operations(size))}
    if plan.folded:
        cfa = plan.camera.sensor.cfa_indices.shape
        back = prod(cfa) * fft.operations(
            [length // n for length, n in zip(plan.period, cfa, strict=True)]
        )
        return {
            "optics.mosaic": planes * fft.operations(plan.period)
            + 4 * frequencies * planes * channels
            + back
        }
    tables = 1 if plan.transfers is None else len(plan.transfers)
    one = (planes + channels) * fft.operations(plan.period) + frequencies * planes * (
        2 * tables + 4 * channels
    )
    if plan.depth is not None:  # each kernel's light and coverage, in every layer
        times = len(plan.depth.kernels) * plan.depth.layers
        return {"optics.blur": 2 * times * one, "optics.composite": times * channels * samples}
    work = {"optics.blur": one}
    if plan.varying is not None:
        work["optics.field"] = planes * plan.varying.cost
    return work


def of_bench(stage: str, inputs: dict, rows: int, cols: int) -> float:
    """Work of a stage's benchmark of this size; inputs: what its contract's `bench` gave."""
    pixels = float(rows * cols)
    if stage == "spectral.integrate":
        return inputs["content"].nbytes + 4 * len(inputs["weights"]) * pixels
    if stage == "spectral.materials":
        return inputs["ids"].nbytes + inputs["shading"].nbytes + 4 * len(inputs["table"]) * pixels
    if stage == "spectral.survey":
        entries, _, width = inputs["content"].shape
        return float(len(inputs["first"]) * width * entries)
    if stage in ("optics.mosaic", "optics.blur", "optics.tiles"):
        return float(stage_module(stage).operations(**inputs))
    if stage == "optics.far":
        channels, planes, _ = inputs["weights"].shape
        return multiplications((rows, cols), planes, channels, tuple(inputs["sigmas"]))
    if stage == "optics.splat":
        return len(inputs["places"]) * float(max(rows, cols)) ** 2
    if stage == "optics.field":
        (tiles, terms), size = inputs["index"].shape, inputs["kernels"].shape[-1]
        high, wide = (float(np.diff(edge).max()) + size - 1 for edge in inputs["edges"])
        return tiles * (terms + 1) * fft.operations((high, wide))
    planes = inputs.get("planes", inputs.get("lights"))
    return float(prod(planes.shape)) if planes is not None else pixels

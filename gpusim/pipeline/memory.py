"""Device memory that a frame takes, from the light to display codes: the arrays that a program keeps, added up.

What the stages allocate is written down here once more, where nothing is allocated yet; tests/frames/test_memory.py
holds the two together.
"""

from math import prod

from gpusim.backends import Device
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.kernels.common.fft import pitch_of, room
from gpusim.kernels.optics.blur import BATCH
from gpusim.optics.fusion import row_pairs
from gpusim.optics.lens import lens_of
from gpusim.optics.splines import axes
from gpusim.pipeline.reading import looked_at_there
from gpusim.planner.plan import Plan
from gpusim.planner.probes import COUNT, SIDE


def bytes_needed(plan: Plan, device: Device) -> int:
    """Memory of a frame on a device [byte]; SciPy's transforms count where their memory is the device's.

    Constants of a few thousand bytes are left out. By depth, and where the blur varies over the field, more than is
    taken.
    """
    scene, content, samples = plan.scene, plan.content, prod(plan.content.shape)
    total = max(content.nbytes, scene.content.nbytes)  # of a picture the codes, too
    planes = len(content.entry_spectra) if plan.table is None else len(plan.table)
    if plan.table is not None:
        total += 4 * planes * samples
    if (
        plan.is_placed
    ):  # and the channels' light, itself and with what is around it, and two maps of it
        total += 4 * (planes + (1 if plan.mix is None else 2) * len(plan.weights) + 2) * samples
    if plan.mix is not None:
        total += _tables(plan) + _blur(plan, device, planes, content.shape)
    if plan.far is not None:
        total += _far(plan, device, planes, content.shape)
    if plan.falloff is not None:
        total += 4 * len(plan.weights) * prod(scene.shape)
    if (
        plan.depth is not None
    ):  # every kernel's and layer's light and coverage, and the copies that are laid together
        total += 16 * len(plan.weights) * samples * len(plan.depth.kernels) * plan.depth.layers
        if plan.transfers is not None:  # every kernel's tables are kept, of the planes and of white
            total += (
                _table(plan)
                * (prod(plan.transfers.shape[:2]) + len(plan.weights))
                * len(plan.depth.kernels)
            )
    if plan.varying is not None:
        total += (
            20 * samples * plan.varying.convolutions
        )  # maps in float64 and float32, planes times maps, spectra
        total += plan.varying.bytes_of_tiles(len(plan.weights)) + 4 * samples * len(plan.weights)
    total += _sensor(plan) + _processor(plan)
    if looked_at_there(device, scene):
        total += _looked_at(plan)
    return int(total)


def _looked_at(plan):
    """What the planner reads of a scene on a device, before the frame: its brightness, and windows and rows of it.

    Probes of later scenes look at other windows.
    """
    rows, cols = plan.content.shape
    windows = COUNT * SIDE**2 if plan.tolerance is not None else 0
    entries = sum(prod(getattr(plan.content, name).shape) for name in plan.content.samples) // (
        rows * cols
    )
    times = 1 if plan.watch is None else 2
    return 4 * (rows * cols + entries * (times * windows + 2 * cols * len(row_pairs(rows, cols))))


def bytes_of_item(plan: Plan, output: str) -> int:
    """What an output of `gpusim.pipeline.outputs.OUTPUTS` takes of its own in a batch, copied there [byte]."""
    pixels, channels = prod(plan.scene.shape), len(plan.weights)
    if output in ("irradiance", "electrons"):
        return 8 * pixels * (len(plan.scene.wavelengths) if output == "irradiance" else channels)
    raw = 14 * (
        channels if plan.camera.sensor.stacked else 1
    )  # both means, raw values, and the copy of one of them
    developed = {
        "camera": 8 * channels,
        "linear": 4 * channels + 24,
        "xyz": 4 * channels + 36,
        "codes": 4 * channels + 18,
    }
    return pixels * (raw + developed.get(output, 0))


def largest_array(plan: Plan) -> int:
    """Memory of the largest array of the content, the planes or the transfer tables [byte]."""
    content, samples = plan.content, prod(plan.content.shape)
    stored = [
        prod(getattr(content, name).shape) * content.stored_type(name).itemsize
        for name in content.samples
    ]
    planes = 0 if plan.table is None else 4 * len(plan.table) * samples
    return max(*stored, planes, _tables(plan) if plan.mix is not None else 0)


def _tables(plan):
    """Transfer tables of the wavelengths, and of the planes made of them: real quarters, or complex halves."""
    combined = 0 if plan.transfers is None else prod(plan.transfers.shape[:2])
    return _table(plan) * (len(plan.q) + combined)


def _table(plan):
    lens = lens_of(plan.camera)
    parts = 1 if lens.symmetry.is_round and not any(lens.displacement) else 4
    return 4 * parts * (plan.period[0] // 2 + 1) * (plan.period[1] // 2 + 1)


def _blur(plan, device, planes, shape):
    """Spectra, their sums, and what becomes of them."""
    (rows, cols), (high, wide), channels = shape, plan.period, len(plan.weights)
    if plan.tiling is not None:
        return _by_tiles(plan, device, planes)
    by_host = device.on_host or room(max(plan.period)) > device.local_bytes
    spectrum, batches = (
        8 * high * pitch_of(device, wide),
        [min(BATCH, planes - first) for first in range(0, planes, BATCH)],
    )
    if by_host:  # planes with their borders, and SciPy's spectra of one batch at a time
        forward = 4 * high * wide * sum(batches) + spectrum * batches[0]
    elif plan.folded:
        forward = 8 * batches[0] * (high // 2 + 1) * (cols + cols % 2)
    else:
        forward = sum(batches) * (8 * rows * pitch_of(device, wide) + spectrum)
    if plan.folded:
        cfa = plan.camera.sensor.cfa_indices
        phases = (
            8
            * cfa.size
            * (high // cfa.shape[0] // (1 if by_host else 2) + 1)
            * (wide // cfa.shape[1] // (2 if by_host else 1) + 1)
        )
        return forward + phases + (4 * high * wide if by_host else 0) + 4 * prod(plan.scene.samples)
    return forward + channels * (spectrum + 4 * high * wide + 4 * prod(plan.scene.samples))


def _by_tiles(plan, device, planes):
    """The mosaic or the channels; what tells a tile's frequencies; spectra of all tiles where SciPy transforms them."""
    side, samples, channels = plan.tiling.side, prod(plan.scene.samples), len(plan.weights)
    total = 4 * samples * (1 if plan.folded else channels)
    if device.on_host and device.kind == "opencl":
        total += 4 * side * (side // 2 + 1) * (planes + planes % 2) * channels
    elif device.on_host:
        tiles, half = plan.tiling.samples(plan.scene.samples), side // 2 + 1
        phases = plan.camera.sensor.cfa_indices.shape if plan.folded else (1, 1)
        high, wide = (side // n for n in phases)
        outputs = prod(phases) if plan.folded else channels
        of_tile = planes * (4 * side**2 + 8 * side * half) + outputs * high * (
            8 * (wide // 2 + 1) + 4 * wide
        )
        total += tiles // side**2 * of_tile
    return total


def _far(plan, device, planes, shape):
    """Splines of the far field, tables without it, and rates with it; on the host also what is between its axes."""
    down, across = axes(shape, plan.far.sigmas, plan.far.border, plan.far.spacings)
    channels, last = len(plan.weights), down.levels - 1
    values = 0
    for level in range(down.levels):  # what it has, and its light
        high, wide = (axis.splines(level) for axis in (down, across))
        values += (planes + channels) * high * wide
        if device.on_host:
            values += 2 * channels * high * wide * len(plan.far.sigmas[down.of_level(level)])
        if device.on_host and level < last:  # halves of the ways to the next level and back
            values += (planes + channels) * high * across.splines(level + 1)
    if device.on_host:
        values += planes * down.splines(0) * shape[1] + channels * plan.scene.samples[
            0
        ] * across.splines(0)
    quarter = (plan.period[0] // 2 + 1) * (plan.period[1] // 2 + 1)
    tables = len(plan.q) if plan.transfers is None else prod(plan.transfers.shape[:2])
    return 4 * (
        values + tables * quarter + (1 if plan.folded else channels) * prod(plan.scene.samples)
    )


def _sensor(plan):
    """The mosaic of the channels, mean electrons, this chip's patterns and its digital numbers."""
    sensor, chip = plan.camera.sensor, plan.camera.sensor.noise
    layers = len(sensor.channels) if sensor.stacked else 1
    pixels = layers * prod(plan.scene.shape)
    response = bool(chip.prnu or chip.row_prnu or chip.column_prnu or chip.dead_pixels)
    dark = bool(chip.hot_pixels and chip.hot_current)
    offset = bool(chip.dsnu or chip.row_dsnu or chip.column_dsnu)
    traps = bool(chip.telegraph_pixels and chip.telegraph)
    floats = 1 + response + dark + (response or dark) + offset + traps
    if plan.mix is None or not plan.folded:
        floats += 1  # rates
    return pixels * (4 * floats + (4 if sensor.bits == FLOAT_BITS else 2))


def _processor(plan):
    """Corrected mosaics, what the demosaicker needs beside them, camera values, linear and encoded colours."""
    sensor, processor = plan.camera.sensor, plan.camera.processor
    pixels = prod(plan.scene.shape) // prod(sensor.binning)
    corrections = (
        (sensor.bits == FLOAT_BITS) + (processor.defects != "none") + bool(processor.denoise)
    )
    scratch = {"adaptive": 2, "best": 28, "learned": 6}.get(
        processor.demosaic, 0
    )  # bytes a pixel, of their contracts
    channels = 3 if processor.table is not None else len(sensor.channels)
    return pixels * (
        2 * (corrections + processor.shading)
        + 4 * bool(processor.denoise)
        + scratch
        + 4 * channels
        + 15
    )

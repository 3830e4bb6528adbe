"""Real and simulated frames of an edge, a chart and even light through the lens."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.data.charts import chart, colorchecker_patches
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.fit.estimate import Plot
from gpusim.fit.held_out import check_levels, check_mosaic, letter_indices
from gpusim.fit.noise_statistics import Statistic
from gpusim.fit.sorting import check_same_camera, summarise
from gpusim.io.raw.raw_frame import RawFrame
from gpusim.measure.difference import ciede2000
from gpusim.measure.ideal import ideal
from gpusim.measure.sfr import mtf50, sfr
from gpusim.pipeline.simulator import Simulator

Result = tuple[list[tuple[str, list[Statistic]]], list[Plot]]
LARGEST = 480  # rows and columns of an edge's frame that are used
REPLICAS = 12  # simulated measurements of an edge, for its standard error
CELLS = 8  # rows and columns of the shading's map
MIDDLE = slice(CELLS // 2 - 1, CELLS // 2 + 1)
FIELD = 256  # pixels along the longer side of a simulated frame of even light
FINE = 2  # samples along a pixel of the simulated edge: one would fold frequencies above half a cycle back
CURVE_CHANCES = 10  # independent frequencies of a curve, about
DRAWS = 200  # of the noise of patches
MTF50_WITHIN, CURVE_WITHIN, SHADING_WITHIN, COLOR_WITHIN = 0.02, 0.03, 0.01, 1.0


def compare_edges(
    shots: Sequence[Any], camera: Camera, light: str, seed: int, device: Device
) -> Result:
    """Compare the MTF of a slanted edge with that of a simulated one at the same angle.

    The edge is neutral: each channel is scaled to the same levels, and all pixels are measured
    together. The simulated edge is on the axis, as bright as the real one.

    Args:
        shots: Frames of one edge.
        camera: The camera.
        light: Light on the edge.
        seed: Seed of the simulated noise.
        device: Device of the simulation.

    Raises:
        BadData: No edge that can be measured, or another camera.
    """
    frame, stack = _read(shots, camera)
    shape = tuple(min(LARGEST, size) for size in stack.shape[1:])
    top, left = (
        (size - used) // 2 // step * step
        for size, used, step in zip(stack.shape[1:], shape, frame.period, strict=True)
    )
    cut = stack[:, top : top + shape[0], left : left + shape[1]]
    letters, _ = letter_indices(frame.cfa)
    level = camera.sensor.dark_level
    even, dark, bright = _even_channels(cut.mean(axis=0, dtype=np.float64) - level, letters)
    real = sfr(even)
    down, right = (np.abs(part).sum() for part in np.gradient(cut.mean(axis=0)))
    angle = math.degrees(float(real.angle))
    steep = math.copysign(90 - abs(angle), angle) if down > right else angle
    scene = chart(
        "slanted-edge",
        size=shape[::-1],
        light=light,
        samples_per_pixel=FINE,
        angle_deg=steep,
        contrast=min(max(bright / max(dark, 1e-3 * bright), 1.01), 1e3),
    )
    simulator = Simulator(camera, device=device)
    exposure = simulator.expose(scene)
    _, _, shown = _even_channels(device.numpy(exposure.raw(seed=seed)) - level, letters)
    # as bright as the real one, so that its noise is the same
    exposure = simulator.expose(scene, exposure.exposure_time * bright / shown, exposure.gain)
    found = []
    for number in range(REPLICAS):
        raw = device.numpy(exposure.raw(seed=seed, first=number * len(cut), frames=len(cut)))
        even, *_ = _even_channels(raw.mean(axis=0, dtype=np.float64) - level, letters)
        found.append(sfr(even))
    transfer = _sample_transfer(real.frequencies, angle)
    noise = np.std([one.response for one in found], axis=0, ddof=1)
    found = [replace(one, response=one.response / transfer) for one in found]
    limits = np.array([mtf50(one) for one in found])
    low = real.frequencies <= 0.5
    simulated = np.mean([one.response for one in found], axis=0)
    # both frames have the noise of one measurement, the mean of replicas a part of it
    spread = math.sqrt(1 + 1 / REPLICAS)
    own = float(mtf50(real))
    difference = (real.response - simulated)[low]
    errors = noise * np.sqrt(1 + 1 / (REPLICAS * transfer**2))
    errors = np.maximum(errors[low], 1e-6)
    worst = int(np.argmax(np.abs(difference) / errors))
    freedom = REPLICAS - 1
    statistics = [
        Statistic(
            "MTF50",
            own / limits.mean() - 1,
            spread * limits.std(ddof=1) / limits.mean(),
            MTF50_WITHIN,
            "%",
            real=own,
            simulated=float(limits.mean()),
            freedom=freedom,
        ),
        Statistic(
            "MTF up to half a cycle a pixel",
            float(difference[worst]),
            float(errors[worst]),
            CURVE_WITHIN,
            chances=CURVE_CHANCES,
            freedom=freedom,
        ),
    ]
    words = f"edge at {angle:.3g} degrees ({frame.name})"
    plot = Plot(
        words,
        "Response to a slanted edge, real and simulated, of all channels together.",
        partial(_draw_curves, real=real, simulated=simulated),
    )
    return [(words, statistics)], [plot]


def _sample_transfer(frequencies: np.ndarray, angle: float) -> np.ndarray:
    """Return the transfer of the simulated chart's samples, which are means over squares.

    The lens and the pixels of the camera see an edge that is blurred by such a square; its transform along the edge's
    normal divides the simulated response. frequencies: [cycle/pixel]; angle: [deg].
    """
    turn, cycles = math.radians(angle), frequencies / FINE
    return np.sinc(cycles * math.cos(turn)) * np.sinc(cycles * math.sin(turn))


def compare_chart(
    shots: Sequence[Any], camera: Camera, light: str, seed: int, device: Device
) -> Result:
    """Compare the colours of a ColorChecker with those of a simulated one in the same light.

    The frames show the chart as gpusim's chart "colorchecker" does: crop them to it. Both sets of
    channel values go through one matrix, which fits the simulated ones to the true colours.

    Args:
        shots: Frames of the chart.
        camera: The camera.
        light: Light on the chart.
        seed: Seed of the drawn noise.
        device: Device of the simulation.

    Raises:
        BadData: Fewer than three channels, or another camera.
        OutOfRange: The frame is too small for the patches.
    """
    frame, stack = _read(shots, camera)
    letters, channels = letter_indices(frame.cfa)
    if len(channels) < 3:
        raise BadData(f"{frame.name}: colours need 3 channels, the camera has {len(channels)}")
    size = stack.shape[2], stack.shape[1]
    scene = chart("colorchecker", size=size, light=light)
    exposure = Simulator(camera, device=device).expose(scene)
    patches = _inner(colorchecker_patches(size))
    mean = np.asarray(exposure, np.float64)
    truth = np.stack([ideal(scene)[patch].mean(axis=(0, 1)) for patch in patches])
    own, _ = _patch_means(mean, patches, letters, len(channels))
    values, errors = _patch_means(
        stack.mean(axis=0, dtype=np.float64) - _black(frame, camera),
        patches,
        letters,
        len(channels),
    )
    if not (np.isfinite(values).all() and np.isfinite(own).all()):
        raise BadData(f"{frame.name}: patches of a few pixels; give larger frames of the chart")
    matrix = np.linalg.lstsq(own, truth, rcond=None)[0]
    random = np.random.default_rng(seed)

    def difference(measured):
        scale = np.sum(measured * own) / np.sum(measured**2)  # exposures differ
        return ciede2000((scale * measured @ matrix)[None], (own @ matrix)[None])[0]

    each = difference(values)
    drawn = [
        difference(values + errors * random.standard_normal(values.shape)).mean()
        for _ in range(DRAWS)
    ]
    words = f"ColorChecker in {light} ({frame.name})"
    statistics = [
        Statistic(
            "colours (CIEDE2000, mean of 24)",
            float(each.mean()),
            float(np.std(drawn)),
            COLOR_WITHIN,
            is_distance=True,
        )
    ]
    plot = Plot(
        words,
        "Difference of each patch, real and simulated, from dark skin to black.",
        partial(_draw_patches, each=each),
    )
    return [(words, statistics)], [plot]


def compare_shading(
    shots: Sequence[Any], camera: Camera, light: str, seed: int, device: Device
) -> Result:
    """Compare even light through the lens with a simulated frame of the same field.

    Maps of 8 x 8 cells, relative to the middle, of each channel. The simulated frames, one a channel,
    have larger pixels and fewer of them, so that they cover the same field.

    Args:
        shots: Frames of even light, whole frames of the sensor.
        camera: The camera.
        light: The light.
        seed: Not used: maps are simulated without noise.
        device: Device of the simulation.

    Raises:
        BadData: Another camera.
    """
    del seed
    frame, stack = _read(shots, camera)
    letters, channels = letter_indices(frame.cfa)
    channels = _letters_of(camera, channels)
    mean = stack.mean(axis=0, dtype=np.float64) - _black(frame, camera)
    real, errors = _shading_map(mean, letters, len(channels))
    simulated = np.stack([_even_map(camera, one, mean.shape, light, device) for one in channels])
    difference = real - simulated
    worst = np.unravel_index(np.argmax(np.abs(difference)), difference.shape)
    words = f"shading ({frame.name})"
    statistics = [
        Statistic(
            "shading, largest difference",
            float(difference[worst]),
            float(errors[worst]),
            SHADING_WITHIN,
            "%",
            difference.size,
            real=float(real[worst]),
            simulated=float(simulated[worst]),
        )
    ]
    plot = Plot(
        words,
        "Light relative to the middle along the frame's diagonal, mean of the channels.",
        partial(_draw_shading, real=real.mean(axis=0), simulated=simulated.mean(axis=0)),
    )
    return [(words, statistics)], [plot]


COMPARE: dict[str, Callable[..., Result]] = {
    "edges": compare_edges,
    "chart": compare_chart,
    "shading": compare_shading,
}


def _read(shots, camera) -> tuple[RawFrame, np.ndarray]:
    """Return the first frame, without values, and all values [DN], (n, rows, cols)."""
    summaries = summarise(shots)
    check_same_camera(summaries)
    check_mosaic(summaries[0].frame, camera)
    check_levels(summaries, camera)
    stack = np.stack([one.shot.read().values for one in summaries])
    return summaries[0].frame, stack


def _black(frame, camera):
    """Return the black level [DN]: the camera file's, which was fitted."""
    del frame
    return camera.sensor.dark_level


def _even_channels(values, letters):
    """Return a neutral edge with all channels at the same levels, and its dark and bright level.

    values: above black, (rows, cols) [DN]. The levels are those of the brightest channel.
    """
    period, even, levels = letters.shape, np.empty(values.shape), []
    for number in range(letters.max() + 1):
        places = [
            (slice(row, None, period[0]), slice(col, None, period[1]))
            for row, col in np.argwhere(letters == number)
        ]
        pixels = np.concatenate([values[place].ravel() for place in places])
        dark, bright = np.percentile(pixels, (5, 95))
        levels.append((dark, max(bright, 1.0)))
        for place in places:
            even[place] = (values[place] - dark) / max(bright - dark, 1e-9)
    return even, *max(levels, key=lambda pair: pair[1])


def _inner(patches):
    """Return the patches without a quarter of their side at each border."""
    found = []
    for patch in patches:
        rim = max(1, (patch[0].stop - patch[0].start) // 4)
        found.append(tuple(slice(part.start + rim, part.stop - rim) for part in patch))
    return found


def _patch_means(mean, patches, letters, count):
    """Return means and standard errors of each patch's channels, (24, C)."""
    rows, cols = mean.shape
    channel = np.tile(letters, (-(-rows // len(letters)), -(-cols // len(letters[0]))))[
        :rows, :cols
    ]
    values, errors = np.full((2, len(patches), count), np.nan)
    for number, patch in enumerate(patches):
        for letter in range(count):
            chosen = mean[patch][channel[patch] == letter]
            if len(chosen) > 1:
                values[number, letter] = chosen.mean()
                errors[number, letter] = chosen.std(ddof=1) / math.sqrt(len(chosen))
    return values, errors


def _shading_map(mean, letters, count):
    """Return light relative to the middle, and its standard errors, (C, CELLS, CELLS)."""
    rows, cols = mean.shape
    channel = np.tile(letters, (-(-rows // len(letters)), -(-cols // len(letters[0]))))[
        :rows, :cols
    ]
    y, x = (np.arange(size) * CELLS // size for size in (rows, cols))
    cell = y[:, None] * CELLS + x
    found, errors = np.zeros((2, count, CELLS * CELLS))
    step = len(letters[0])
    noise = mean[:, step:] - mean[:, :-step]  # of neighbours of one colour
    for letter in range(count):
        chosen = channel == letter
        number = np.maximum(np.bincount(cell[chosen], minlength=CELLS**2), 1)
        found[letter] = np.bincount(cell[chosen], mean[chosen], CELLS**2) / number
        inside = chosen[:, step:]
        where = cell[:, step:][inside]
        squares = np.bincount(where, noise[inside] ** 2 / 2, CELLS**2)
        errors[letter] = np.sqrt(squares / number / number)
    shape = count, CELLS, CELLS
    found, errors = found.reshape(shape), errors.reshape(shape)
    levels = found[:, MIDDLE, MIDDLE].mean(axis=(1, 2), keepdims=True)
    return found / levels, errors / levels


def _letters_of(camera, channels):
    """Return the camera's letters for the channels of frames: its own one if there is one channel."""
    return channels if len(channels) > 1 else tuple(camera.sensor.channels[:1])


def _even_map(camera, letter, shape, light, device):
    """Return one channel's simulated light relative to the middle, (CELLS, CELLS). shape: of the frame."""
    rows, cols = (max(CELLS, round(size * min(1, FIELD / max(shape)))) for size in shape)
    camera = camera.with_(cfa=[letter])
    pitch = min(camera.sensor.pixel_pitch * shape[1] / cols, 1e-3)
    coarse = replace(camera, sensor=replace(camera.sensor, pixel_pitch=pitch, binning=(1, 1)))
    exposure = Simulator(coarse, device=device).expose(
        chart("flat", size=(cols, rows), light=light)
    )
    down, across = _cell_parts(rows), _cell_parts(cols)
    found = down @ np.asarray(exposure, np.float64) @ across.T
    return found / found[MIDDLE, MIDDLE].mean()


def _cell_parts(size):
    """Return the part of each cell that each pixel covers, (CELLS, size)."""
    ends, pixels = np.linspace(0, size, CELLS + 1)[:, None], np.arange(size)
    covered = np.minimum(ends[1:], pixels + 1) - np.maximum(ends[:-1], pixels)
    return np.maximum(covered, 0) * CELLS / size


def _draw_curves(figure, real, simulated):
    axes = figure.subplots()
    axes.plot(real.frequencies, real.response, color="#c2410c", label="real")
    axes.plot(real.frequencies, simulated, "--", color="#1d4ed8", label="simulated")
    axes.set(xlabel="frequency [cycle/pixel]", ylabel="response", ylim=(0, 1.1))
    axes.legend(frameon=False)


def _draw_patches(figure, each):
    axes = figure.subplots()
    axes.bar(np.arange(1, len(each) + 1), each, color="#1d4ed8")
    axes.axhline(COLOR_WITHIN, color="0.6", linewidth=0.8)
    axes.set(xlabel="patch", ylabel="CIEDE2000")


def _draw_shading(figure, real, simulated):
    axes = figure.subplots()
    places = np.arange(CELLS)
    axes.plot(places, real[places, places], "o-", color="#c2410c", label="real")
    axes.plot(places, simulated[places, places], "s--", color="#1d4ed8", label="simulated")
    axes.set(xlabel="cell along the diagonal", ylabel="light / middle")
    axes.legend(frameon=False)

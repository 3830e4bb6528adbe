"""Lenslets: light of the pupil's cells in the lenslets' plane becomes the pixels' light behind them.

Ports: rates (cells_y, cells_x channels, rows, cols) float32 [e- s-1 per sample], cfa (period_y,
period_x) int32 -> pixels (1, pixel_rows, pixel_cols) float32 [e- s-1].

Rays obey the equation of `gpusim.optics.lenslets`: through the place x of lenslet c and the place s of the
pupil, they land at

    X = x + tilt (x - axis) - radius s - power (x - c).

A sample is a square of side `step`. Its part within the clear aperture of a lenslet has an area and a
centre of gravity x. The part's light of cell (j, i), whose middle is s, lands around X(x, s), evenly over
the image of the cell, 2 radius / cells wide, widened by the image of the part, |1 + tilt - power| times
as wide as the part, and by the lenslet's diffraction: the squared transform of its clear aperture at the
channel's mean wavelength. A pixel gets the light on its aperture in the channel of its filter. The sum
over all pixels, if they fill their cells, is the light within the clear apertures.

Squares along the pixels: rows and columns are independent, and each pass is a product with a banded
matrix. Samples further away than 1.25 pitches count with the mean of their cells, and 2e-4 of the light
along each axis, the end of the diffraction's tail, is folded back into the band. Other arrays: a smooth
window divides the light of a cell. Pixels gather the light within, by a table with 32 samples per pixel.
The rest, some hundredths, is smooth: cells lie on the pixels' grid with the weights of a cubic spline,
and a transform convolves them. A part that is not a rectangle counts with the width of a sample. The
tables are made in `gpusim.optics.lenslet_tables` and `lenslet_spots`.

Bytes and operations, 9 x 9 cells on 512 x 512 lenslets, 4608 x 4608 pixels, Bayer, a spot of 0.5 pixels:
0.25 GB of rates are read, 0.17 GB of lines written and read, 0.08 GB of pixels written. The first pass has
2 x 21e6 sums of about 130 products, the second 21e6: 8e9 products.
"""

import functools
from dataclasses import dataclass

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.kernels.common.cases import RGGB
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.stage import Array, Case, is_opencl_cpu, stage, warp_only
from gpusim.optics.lenslet_spots import (
    STEPS,
    cubic_table,
    far_period,
    far_transfer,
    lenslet_sources,
    spot_tables,
)
from gpusim.optics.lenslet_tables import BLOCK, axis_table, mosaic_pairs
from gpusim.optics.lenslets import LensletPlane, lenslet_vectors


@stage
def lenslets(
    device: Device, rates: Array, cfa: Array, plane: LensletPlane, shape: tuple[int, int]
) -> Array:
    """Return the light of every pixel behind an array of lenslets.

    Args:
        rates: Electrons per second through each cell of the pupil in each sample of the lenslets' plane [e- s-1], as if
            a pixel there saw every channel, shape (cells_y, cells_x * channels, rows, cols), the channels of a cell one
            after the other.
        cfa: Channel of each pixel in one period of the mosaic, shape (period_y, period_x).
        plane: Numbers of lenslets, lens, pixels and samples: `gpusim.optics.lenslets.lenslet_plane`.
        shape: Rows and columns of pixels.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Electrons per second [e- s-1], shape (1, rows, cols) of pixels, float32.

    Raises:
        BadData: The rates do not have four axes, or another number of channels than the numbers.

    Source:
        Ng et al. 2005, Light field photography with a hand-held plenoptic camera (unfocused); Lumsdaine and Georgiev
        2009, The focused plenoptic camera; Goodman, Introduction to Fourier Optics, 6.2 (diffraction of an aperture).
    """
    if len(rates.shape) != 4 or rates.shape[1] % len(plane.spots):
        raise BadData(
            f"rates: shape {tuple(rates.shape)}; wanted (cells_y, cells_x * {len(plane.spots)} channels, rows, cols)"
        )
    mosaic = np.asarray(device.numpy(cfa), np.int32)
    make = _pass_rows_and_columns if plane.is_separable else _gather_cells
    return make(device, device.array(rates), mosaic, plane, shape)


def _pass_rows_and_columns(device, rates, cfa, plane, shape):
    (cells_y, planes, rows, cols), channels = rates.shape, len(plane.spots)
    cells_x = planes // channels
    key = cfa.shape, cfa.tobytes(), plane
    down = _axis_arrays(device, 0, shape[0], rows, cells_y, *key)
    across = _axis_arrays(device, 1, shape[1], cols, cells_x, *key)
    pairs, positions = across.pairs.shape[0], across.positions
    width = 8 if is_opencl_cpu(device) else 1
    launch = functools.partial(
        device.launch, "sensor.lenslets", defines={"WIDTH": width, "CELLS": cells_x}
    )
    totals = _add_up(device, launch, rates, (cells_y, cells_x, channels * rows * cols))
    lines = device.empty((pairs, cells_y * rows, positions))
    launch(
        "across",
        (pairs * cells_y * -(-rows // BLOCK), positions // width),
        rates,
        device.reshape(totals, (cells_y, channels, rows, cols)),
        *(across.weights, across.far_weights, across.first, across.far_first, across.pairs, lines),
        *(pairs, cells_y, channels, rows, cols, positions, across.window, across.far_window),
        *warp_only(device, cells_x),
    )
    totals = _add_up(device, launch, lines, (pairs, cells_y, rows * positions))
    pixels = device.empty((1, *shape))
    launch(
        "down",
        (cfa.shape[0] * (down.positions // BLOCK), cfa.shape[1] * (positions // width)),
        *(lines, device.reshape(totals, (pairs, rows, positions))),
        *(down.weights, down.far_weights, down.first, down.far_first, across.places, down.places),
        *(
            pixels,
            rows,
            positions,
            down.positions,
            down.window,
            down.far_window,
            *shape,
            *cfa.shape,
        ),
        *warp_only(device, cells_y),
        defines={"WIDTH": width, "CELLS": cells_y},
    )
    return pixels


def _add_up(device, launch, values, shape):
    """Return sums over the middle one of three axes, shape (outer, inner)."""
    outer, count, inner = shape
    sums = device.empty((outer, inner))
    launch("add_up", (outer, inner), device.reshape(values, shape), sums, outer, count, inner)
    return sums


class _AxisArrays:
    """Weights of one axis on a device.

    Attributes:
        weights: Of samples and cells, shape (pairs, window, cells, positions).
        far_weights: Of distant samples, shape (pairs, far_window, positions).
        first: First sample of each block's window, shape (pairs, blocks).
        far_first: The same of distant samples.
        pairs: Phase and channel, shape (pairs, 2).
        places: Pair of each pixel of the mosaic, shape (period_y, period_x).
        window: Samples.
        far_window: Distant samples.
        positions: Of pixels of one phase.
    """

    def __init__(self, device, axis, size, samples, cells, period, mosaic, plane):
        cfa = np.frombuffer(mosaic, np.int32).reshape(period)
        pairs, places = mosaic_pairs(cfa, axis)
        table = axis_table(plane, axis, size, samples, cells, period[axis])
        phase, channel = pairs.T
        self.weights = device.array(table.weights[phase, channel])
        self.far_weights = device.array(table.far_weights[phase, channel])
        self.first = device.array(table.first[phase], np.int32)
        self.far_first = device.array(table.far_first[phase], np.int32)
        self.pairs, self.places = device.array(pairs, np.int32), device.array(places, np.int32)
        _, self.far_window, self.positions = self.far_weights.shape
        self.window = self.weights.shape[1]


_axis_arrays = functools.lru_cache(maxsize=16)(_AxisArrays)


def _gather_cells(device, rates, cfa, plane, shape):
    (cells_y, planes, rows, cols), channels = rates.shape, len(plane.spots)
    cells_x = planes // channels
    tables = _spot_arrays(device, plane, tuple(shape), (rows, cols), (cells_y, cells_x))
    launch = functools.partial(device.launch, "sensor.lenslets", defines={"STEPS": STEPS})
    light, sources = rates, tables.parts
    if plane.is_focused_on_pupil:
        planes, samples = cells_y * planes, rows * cols
        light = _bundle(device, launch, device.reshape(rates, (planes, samples)), tables)
        sources = tables.lenslets
    count, parts = light.size // (cells_y * cells_x * channels), sources[0].shape[1]
    light = device.reshape(light, (cells_y, cells_x, channels, count))

    def gather(table, far, layers, size):
        pixels = device.empty((layers, *size))
        launch(
            "gather",
            pixels.shape,
            *(light, *sources, table.near, table.near if far is None else far),
            *(device.array(cfa, np.int32), tables.inverse, pixels, int(far is not None)),
            *(*plane.origin, *plane.axis, plane.tilt, plane.radius, table.reach),
            *(cells_y, cells_x, channels, count, parts, *tables.low, *tables.shape, *table.around),
            *(table.near.shape[-1], *cfa.shape, *pixels.shape),
            *warp_only(device, STEPS),
        )
        return pixels

    size = [n + 2 * tables.margin for n in shape]
    grid = gather(tables.cubic, None, channels, size)
    mix, period = np.eye(channels, dtype=np.float32), tables.period
    far = blur(grid, tables.transfer, mix, "zero", period, tables.margin, device=device)
    return gather(tables.near, far, 1, shape)


def _bundle(device, launch, light, tables):
    """Return the light of each lenslet, shape (planes, lenslets), from their shares of samples."""
    sample, share, _ = tables.parts
    (planes, samples), (count, parts) = light.shape, sample.shape
    out = device.empty((planes, count))
    launch("bundle", (planes, count), light, sample, share, out, planes, samples, count, parts)
    return out


@dataclass(frozen=True, eq=False)
class _Table:
    """Light of a cell on a device, see `SpotTables`. around: lenslets along both steps whose light it reaches."""

    near: Array
    reach: float
    around: list[int]


class _SpotArrays:
    """Sources and tables of a frame on a device.

    Attributes:
        parts: Sample, share and place of the lenslets' parts.
        lenslets: The same of lenslets as a whole: each is its own sample.
        near: Light of a cell on near pixels.
        cubic: Light of a cell on the pixels' grid.
        margin: Pixels around the frame on which light falls.
        period: Lengths of the transform [pixel].
        transfer: Transfer functions from the light on the pixels' grid to light from afar.
        inverse: From places to steps of the lattice.
        low: First lenslet along both steps.
        shape: Lenslets along both steps.
    """

    def __init__(self, device, plane, size, samples, cells):
        sources, spots = lenslet_sources(plane, size, samples), spot_tables(plane, cells)
        share = device.array(sources.share)
        self.parts = device.array(sources.sample, np.int32), share, device.array(sources.place)
        count = len(sources.share)
        total = np.maximum(sources.share.sum(1), 1e-30)[:, None]
        middle = (sources.place * sources.share[..., None]).sum(1) / total
        own, ones = np.arange(count)[:, None], np.ones((count, 1))
        self.lenslets = (
            device.array(own, np.int32),
            device.array(ones),
            device.array(middle[:, None]),
        )
        inverse = np.linalg.inv(np.array(plane.lattice))
        self.inverse = device.array(inverse)
        self.low, self.shape = sources.low, sources.shape

        def on_device(table):
            box = plane.radius + table.reach + abs(plane.spread) * plane.pitch
            around = [int(n) for n in np.floor(box * np.abs(inverse).sum(0) + 0.5)]
            near = np.broadcast_to(table.near, (len(plane.spots), *table.near.shape[1:]))
            return _Table(device.array(near), table.reach, around)

        cubic = cubic_table()
        self.near, self.cubic = on_device(spots), on_device(cubic)
        farthest = np.abs(sources.place[sources.share > 0]).max(0) + plane.radius + cubic.reach
        self.margin = int(max(0.0, *np.ceil(farthest - (np.array(size) - 1) / 2)))
        self.period = far_period(plane, tuple(n + 2 * self.margin for n in size))
        self.transfer = device.array(far_transfer(plane, cells, spots, self.period)[None])


_spot_arrays = functools.lru_cache(maxsize=4)(_SpotArrays)


def make_plane(
    pitch: float,
    radius: float,
    *,
    layout: str = "square",
    rotation: float = 0.0,
    fill: float = 1.0,
    power: float = 1.0,
    tilt: float = 0.003,
    spots: tuple[float, ...] = (0.5,),
    aperture: tuple[float, float] = (1.0, 1.0),
    samples: int = 1,
    shape: tuple[int, int] = (27, 27),
) -> LensletPlane:
    """Return the numbers of an array, for cases and benchmarks; lenslet (0, 0) is off the middle.

    Args:
        pitch: Of lenslets [pixel].
        radius: Of the pupil's image [pixel].
        layout: "square" or "hexagonal".
        rotation: Of the array [rad].
        fill: Clear width over the pitch [1].
        power: Gap over focal length [1].
        tilt: Gap over the distance of the exit pupil [1].
        spots: Distance of the first zero of diffraction, per channel [pixel].
        aperture: Of pixels [pixel].
        samples: Per pitch.
        shape: Samples, rows and columns.

    Returns:
        The numbers.
    """
    lattice, normals = lenslet_vectors(pitch, rotation, layout)
    origin, step = (0.37 * pitch, -0.21 * pitch), pitch / samples
    # a boundary of samples is one of lenslets in a square array
    corner = [
        pitch * (round(-n / samples / 2) - 0.5) + at for n, at in zip(shape, origin, strict=True)
    ]
    return LensletPlane(
        lattice=(lattice[0], lattice[1]),
        origin=origin,
        normals=normals,
        pitch=pitch,
        fill=fill,
        axis=(1.3, -0.4),
        tilt=tilt,
        power=power,
        radius=radius,
        spots=spots,
        aperture=aperture,
        step=step,
        start=(corner[0] + step / 2, corner[1] + step / 2),
    )


def cases():
    """Yield cases: unfocused and focused, squares and hexagons, turned, small apertures, odd mosaics."""
    random = np.random.default_rng(58)
    separable = (
        "2e-4 of the light along each axis is folded back: 4e-4 next to dark surroundings; cells beyond 1.25 pitches, "
        "about 6e-3 of the light, count with their mean, a third off, of random light with a contrast of 0.2 over nine "
        "cells: 1e-4; the reference's waves repeat 64 pixels beyond the frame, whose tail is 5e-4"
    )
    gathered = (
        "the reference's waves repeat 64 pixels beyond the frame: 0.5 / pi^2 (1 / 64 - 1 / 99) of the light on each of "
        "four sides, 1.2e-3, of light with a mean of 0.7 of the brightest; 2e-4 come back in the device's; a table of "
        "32 samples per pixel is interpolated linearly, its second derivative over 8 x 32^2, 3e-4 of nine cells"
    )
    three = (0.55, 0.45, 0.4)
    stripes = np.array([[0, 1, 2]], np.int32)
    grey = np.zeros((1, 1), np.int32)
    turned = {"rotation": 0.1, "samples": 4}
    for name, cfa, cells, size, numbers in (
        ("unfocused", grey, (3, 3), (40, 33), {}),
        ("unfocused, Bayer", RGGB, (3, 2), (24, 23), {"spots": three}),
        ("stripes, small apertures", stripes, (2, 3), (21, 33), {"spots": three, "fill": 0.8}),
        ("one lenslet", grey, (2, 2), (7, 7), {}),
        ("focused", grey, (2, 2), (22, 21), {"power": 1.4, "samples": 4}),
        ("small pixels", grey, (3, 3), (21, 17), {"aperture": (0.6, 0.9)}),
        ("hexagons", grey, (3, 3), (15, 14), {"layout": "hexagonal", "samples": 4}),
        ("turned squares, Bayer", RGGB, (2, 3), (12, 15), turned | {"spots": three}),
        ("turned hexagons", grey, (3, 2), (13, 14), turned | {"layout": "hexagonal", "fill": 0.9}),
        ("turned, focused", grey, (2, 2), (17, 16), turned | {"power": 0.6}),
    ):
        count = numbers.get("samples", 1)
        shape = tuple(count * int(np.ceil(n / 7) + 3) for n in size)
        plane = make_plane(7.0, 3.4, shape=shape, **numbers)
        planes = cells[0], cells[1] * len(plane.spots)
        rates = random.uniform(0.2, 1, (*planes, *shape)).astype(np.float32)
        inputs = {"rates": rates, "cfa": cfa, "plane": plane, "shape": size}
        if plane.is_separable:
            yield Case(name, inputs, 1e-3, separable)
        else:
            yield Case(name, inputs, 2e-3, gathered)


def bench(rows, cols):
    """Return inputs: unfocused, 9 x 9 cells, a Bayer mosaic, 9 x 9 pixels behind each lenslet."""
    shape = tuple(max(1, size // 9) for size in (rows, cols))
    plane = make_plane(9.0, 4.5, spots=(0.55, 0.5, 0.42), shape=shape)
    rates = np.random.default_rng(58).random((9, 27, *shape), np.float32)
    return {"rates": rates, "cfa": RGGB, "plane": plane, "shape": (rows, cols)}

"""The far field of a blur: wide Gaussians over a world without end, added to a frame.

Ports: onto, a mosaic (rows, cols) or channels (channels, rows, cols) float32; planes (planes, rows,
cols) float32, weights (channels, planes, G), sigmas (G,), cfa (ph, pw) -> the shape of onto,
float32:

    out(y, x) = onto(y, x) + sum over k, g of  weights[c, k, g] (gaussian_g * planes_k)(y, x),

c = cfa[y mod ph, x mod pw] for a mosaic. Grids of cubic splines represent the wide Gaussians
(`gpusim.optics.farfield`): a chain of sparse matrices along one axis after the other.
"""

import functools
from dataclasses import dataclass
from math import prod

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import OutOfRange
from gpusim.kernels.common.cases import RGGB
from gpusim.kernels.common.fft import constant
from gpusim.kernels.stage import Array, Case, stage
from gpusim.optics.farfield import LEAST, SPACINGS, axes

LEAST_SIDE, LEAST_SIGMA = 8, LEAST  # of planes, and of Gaussians [sample]

BLOCK = 4  # rows of a matrix that a CPU makes at once: most of their entries have the same places
SPANS = 2  # vectors of lanes that it makes at once: with 4 rows, 8 sums in 16 registers
# its work-items at a time, whose results fill whole lines of the cache when they are turned
GROUP = (4, 16)
GROUPS_STAGE = "optics.far_groups"  # the kernels of GPUs
WIDE, LINES = 32, 8  # columns of a work-group's result on a GPU, and its lines of work-items
HIGH, LOW = 8, 2  # blocks of four rows of its result: of large grids and of small ones
MANY = 256  # work-groups that keep a whole GPU busy
STEP = 8192  # bytes of local memory: few sizes need few kernels


@stage
def far(
    device: Device,
    onto: Array,
    planes: Array,
    weights: Array,
    sigmas: Array,
    cfa: Array | None,
    border: str,
    margin: int = 0,
    spacings: float = SPACINGS,
) -> Array:
    """Add the far field of planes to their near blur.

    Args:
        onto: The near blur, a mosaic of shape (rows - 2 margin, cols - 2 margin), or every channel,
            (channels, ...).
        planes: Light of each plane, shape (planes, rows, cols).
        weights: Energy of each Gaussian of a plane in a channel, shape (channels, planes, G).
        sigmas: Standard deviations [sample], increasing, shape (G,). An infinite one gives the mean
            of the four corners for border "edge", the frame's mean for "reflect", 0 for "zero".
        cfa: Channel of each pixel in one period of the mosaic, shape (ph, pw); None for every
            channel.
        border: "zero", "edge" or "reflect".
        margin: Samples on each side of the planes that `onto` lacks; if negative, that it has in
            addition, up to LEAST_SIGMA / 3.
        spacings: Splines per standard deviation of the first Gaussian of a level. The error is 1e-7
            of a scene's root mean square at 2.8, 1e-6 at 1.6, 3e-5 at 1.
        device: A `Device`, or its name for `open_device`.

    Returns:
        The sum, in the shape of `onto`, float32.

    Raises:
        OutOfRange: Planes have a side below LEAST_SIDE samples, or Gaussians are below LEAST_SIGMA
            or do not increase.

    Source:
        The sum is the formula. For its grids see `gpusim.optics.farfield`.
    """
    shape = tuple(planes.shape[1:])
    weights, sigmas = (np.asarray(device.numpy(values), np.float64) for values in (weights, sigmas))
    if min(shape) < LEAST_SIDE:
        raise OutOfRange(
            "planes", f"{shape[1]} x {shape[0]} samples", f"at least {LEAST_SIDE} along each axis"
        )
    if not (sigmas[0] >= LEAST_SIGMA and np.all(sigmas[1:] > sigmas[:-1])):
        raise OutOfRange("sigmas", sigmas, f"growing ones from {LEAST_SIGMA:g} samples on")
    down, across = axes(shape, sigmas, border, spacings)
    grids = None if device.on_host else _Grids(device, down, across)
    chain = grids if grids is not None and grids.fit else _Chain(device, down, across)
    light = chain.coefficients(device.array(planes), weights.astype(np.float32))
    return chain.add_far(device.array(onto), light, cfa, margin)


def _pattern(device, cfa):
    """Return a mosaic's period on the host; without a mosaic, that of a single channel."""
    return np.zeros((1, 1), np.int32) if cfa is None else np.asarray(device.numpy(cfa), np.int32)


class _Chain:
    """Products on a device with arrays (batch, axis, lanes).

    A product is along the axis, and may exchange axis and lanes.
    """

    def __init__(self, device, down, across):
        self.device, self.down, self.across = device, down, across
        on_cpu = device.kind == "opencl" and device.on_host
        spans, self.width, self.block = (SPANS, 8, BLOCK) if on_cpu else (1, 1, 1)  # of a work-item
        self.lanes, self.group = spans * self.width, GROUP if on_cpu else None
        defines = {"SPANS": spans, "WIDTH": self.width, "BLOCK": self.block}
        self.defines = defines if device.kind == "opencl" else None

    def coefficients(self, planes, weights):
        """Return the far field as splines of the first level, (channels, rows, cols)."""
        own = self._product(planes, self._matrices(self.down, "analysis"), turned=True)
        # (planes, cols, rows) of splines
        own = self._product(own, self._matrices(self.across, "analysis"))
        return self._of_level(own, weights, 0)

    def _of_level(self, own, weights, level):
        """Return the same from this level on. own: its splines, (planes, cols, rows)."""
        some = weights[:, :, self.down.of_level(level)]
        light = self._apply_filters(own, some, level) if some.size else None
        if level == self.down.levels - 1:
            return light
        wide = self._product(own, self._matrices(self.across, "restriction", level), turned=True)
        wide = self._product(wide, self._matrices(self.down, "restriction", level), turned=True)
        wide = self._of_level(wide, weights, level + 1)
        wide = self._product(wide, self._matrices(self.down, "prolongation", level), turned=True)
        return self._product(
            wide, self._matrices(self.across, "prolongation", level), turned=True, onto=light
        )

    def _apply_filters(self, own, weights, level):
        """Return the coefficients of a level's Gaussians, (channels, rows, cols)."""
        device, (channels, count, sigmas) = self.device, weights.shape
        _, cols, rows = own.shape
        places, size = channels * sigmas, cols * rows
        mixed, each = device.empty((places, cols, rows)), places if self.width > 1 else 1
        arrays = [own, constant(device, weights.tobytes(), weights.shape), mixed]
        sizes = [each, places, size, count, sigmas]
        grid = (-(-places // each), -(-size // self.width))
        device.launch("optics.far", "combine", grid, *arrays, *sizes, defines=self.defines)
        found = self._product(mixed, self._matrices(self.across, "filters", level), turned=True)
        return self._product(found, self._matrices(self.down, "filters", level), sums=sigmas)

    def add_far(self, onto, light, cfa, margin):
        """Return the mosaic, or every channel, plus the values of the splines."""
        device, (rows, cols) = self.device, onto.shape[-2:]
        lines = self._product(light, self._matrices(self.down, "synthesis", margin))
        (channels, _, splines), planes = lines.shape, 1 if cfa is not None else light.shape[0]
        pattern = _pattern(device, cfa)
        values, start = _along_rows(
            device, self.across, margin, rows * splines, pattern.tobytes(), pattern.shape
        )
        out = device.empty((planes, rows, cols))
        onto_planes = device.reshape(onto, out.shape)
        lines = device.reshape(lines, (channels * rows * splines,))
        arrays = [onto_planes, lines, values, start, out]
        sizes = [rows, cols, splines, len(pattern)]
        device.launch("optics.far", "refine", out.shape, *arrays, *sizes, defines=self.defines)
        return device.reshape(out, onto.shape)

    def _product(self, given, bands, turned=False, sums=1, onto=None):
        """Multiply along the axis: (batch, rows, lanes), or (batch, lanes, rows) if turned.

        The product is added to `onto` if that is given. sums: number of successive matrices whose
        products are added; so many entries of the batch become one.
        """
        start, count, values, rows = bands
        (batch, size, lanes), (matrices, blocks, most, _) = given.shape, values.shape
        batch //= sums
        out = onto
        if out is None:
            out = self.device.empty((batch, lanes, rows) if turned else (batch, rows, lanes))
        arrays = [given, values, start, count, out]
        numbers = [int(onto is not None), int(turned)]
        sizes = [batch * blocks, lanes, size, rows, blocks, most, matrices, sums]
        self.device.launch(
            "optics.far",
            "product",
            (batch * blocks, -(-lanes // self.lanes)),
            *arrays,
            *numbers,
            *sizes,
            defines=self.defines,
            group=self.group,
        )
        return out

    def _matrices(self, axis, name, of=None):
        return _bands(self.device, axis, name, of, self.block)


class _Grids:
    """The same on a GPU, both axes at once, with the intermediate result in local memory."""

    def __init__(self, device, down, across):
        self.device, self.down, self.across = device, down, across

    @property
    def fit(self) -> bool:
        """Whether local memory holds it."""
        last = self.down.levels - 1
        made = [
            ("analysis", None),
            *((name, level) for level in range(last) for name in ("restriction", "prolongation")),
            *(("filters", n) for n in range(last + 1) if self.down.sigmas[self.down.of_level(n)]),
        ]
        return all(
            self._both_matrices(name, of, HIGH)[-1] <= self.device.local_bytes for name, of in made
        )

    def coefficients(self, planes, weights):
        """Return the far field as splines of the first level, (channels, 1, rows, cols)."""
        planes = self.device.reshape(planes, (planes.shape[0], 1, *planes.shape[1:]))
        return self._of_level(self._both(planes, "analysis"), weights, 0)

    def _of_level(self, own, weights, level):
        """Return parts (channels, parts, ...) whose sum is the field from this level on."""
        some = np.ascontiguousarray(weights[:, :, self.down.of_level(level)])
        is_last = level == self.down.levels - 1
        light = (
            self._both(own, "filters", level, weights=some, in_parts=is_last) if some.size else None
        )
        if is_last:
            return light
        wide = self._of_level(self._both(own, "restriction", level), weights, level + 1)
        return self._both(wide, "prolongation", level, onto=light)

    def _both_matrices(self, name, of, high):
        """Return the matrices of both axes, and their bytes in local memory."""
        down, across = (
            _tile_bands(self.device, axis, name, of, *by)
            for axis, by in ((self.down, (4, high)), (self.across, (1, WIDE)))
        )
        values = 4 * LINES * max(across.span, WIDE) + WIDE * down.span
        return down, across, -(-4 * values // STEP) * STEP

    def _both(self, given, name, of=None, weights=None, onto=None, in_parts=False):
        """Multiply (batch, parts, rows, cols) along both axes and sum the parts.

        The product is added to `onto` if that is given. weights: shape (channels, batch, matrices);
        for each matrix they mix the batch into channels, and the products are added. With
        `in_parts` these stay apart if there is too little work for a whole GPU.
        """
        device, (batch, planes, *size) = self.device, given.shape
        stride, sums = planes, 1
        if weights is not None:
            (batch, planes, sums), stride = weights.shape, 0
        high, parts, (down, across, room) = HIGH, 1, self._both_matrices(name, of, HIGH)
        if batch * down.tiles * across.tiles < MANY:
            high = LOW
            parts = sums if in_parts else 1
            down, across, room = self._both_matrices(name, of, LOW)
        out = onto if onto is not None else device.empty((batch, parts, down.rows, across.rows))
        groups = batch * parts * down.tiles * across.tiles
        mix = given if weights is None else constant(device, weights.tobytes(), weights.shape)
        device.launch(
            GROUPS_STAGE,
            "both",
            (groups * WIDE * LINES,),
            *(given, mix, *down.arrays, *across.arrays, out),
            *(int(onto is not None), int(weights is not None), max(across.span, WIDE), stride),
            *(parts, planes, *size, down.rows, across.rows),
            *(down.blocks, down.most, across.most, sums, down.tiles, across.tiles),
            group=(WIDE * LINES,),
            defines={"HIGH": high, "LOCAL_BYTES": room},
        )
        return out

    def add_far(self, onto, light, cfa, margin):
        """Return the mosaic, or every channel, plus the values of the splines."""
        device, (rows, cols), (_, _, high, wide) = self.device, onto.shape[-2:], light.shape
        pattern = _pattern(device, cfa)
        out, tiles = device.empty(onto.shape), (-(-rows // (4 * LINES)), -(-cols // WIDE))
        groups = prod(onto.shape) // (rows * cols) * prod(tiles)
        device.launch(
            GROUPS_STAGE,
            "evaluate",
            (groups * WIDE * LINES,),
            onto,
            light,
            *_at_samples(device, self.down, margin),
            *_at_samples(device, self.across, margin),
            constant(device, pattern.tobytes(), pattern.shape, np.int32),
            out,
            *(rows, cols, high, wide, *pattern.shape, *tiles),
            group=(WIDE * LINES,),
            defines={"HIGH": HIGH, "LOCAL_BYTES": STEP},
        )
        return out


@dataclass(frozen=True)
class _Tiled:
    """Matrices on the device; a work-group makes some rows of a product.

    Attributes:
        arrays: Values, start and count of their rows, and first column and number of columns of
            every work-group, in the kernel's order.
        rows: Rows of a matrix.
        blocks: Blocks of rows.
        most: Entries of a row.
        tiles: Work-groups along the axis.
        span: Most columns of a work-group.
    """

    arrays: tuple
    rows: int
    blocks: int
    most: int
    tiles: int
    span: int


@functools.lru_cache(maxsize=128)
def _tile_bands(device, axis, name, of, block, high):
    """Return an axis's matrices: `block` rows at a time, `high` blocks per work-group."""
    made = getattr(axis, name)
    made = (made if of is None else made(of)).in_blocks(block)
    number, blocks, most, _ = made.values.shape
    tiles = -(-blocks // high)
    more = [(0, 0), (0, tiles * high - blocks)]
    start, end = (
        np.pad(array, more, mode="edge").reshape(number, tiles, high)
        for array in (made.start, made.start + made.count)
    )
    first, wide = start.min(axis=2), end.max(axis=2) - start.min(axis=2)
    values = made.values if block > 1 else made.values[..., 0].swapaxes(1, 2)
    arrays = (
        device.array(np.ascontiguousarray(values)),
        device.array(made.start, np.int32),
        device.array(made.count, np.int32),
        device.array(np.stack([first, wide], axis=2), np.int32),
    )
    return _Tiled(arrays, made.rows, blocks, most, tiles, int(wide.max()))


@functools.lru_cache(maxsize=32)
def _at_samples(device, axis, margin):
    """Return the four splines' weights at an axis's samples, (samples, 4), and the first spline."""
    bands = axis.synthesis(margin)
    assert bands.values.shape[2] == 4
    return device.array(bands.values[0]), device.array(bands.start[0], np.int32)


@functools.lru_cache(maxsize=128)
def _bands(device, axis, name, of, block):
    """Return bands of an axis on the device: start, count, values and number of rows, in blocks.

    of: argument of the axis's method, for example a level; None if it has none.
    """
    made = getattr(axis, name)
    bands = (made if of is None else made(of)).in_blocks(block)
    return (
        device.array(bands.start, np.int32),
        device.array(bands.count, np.int32),
        device.array(bands.values),
        bands.rows,
    )


@functools.lru_cache(maxsize=32)
def _along_rows(device, axis, margin, plane, pattern, period):
    """Return the four splines' weights at a row's samples, (4, cols), and their first places.

    The places are those in each phase of a mosaic. plane: values per channel. pattern: bytes of the
    mosaic's channels, of shape `period`.
    """
    bands = axis.synthesis(margin)
    cfa = np.frombuffer(pattern, np.int32).reshape(period)
    start = plane * cfa[:, np.arange(bands.start.shape[1]) % period[1]] + bands.start[0]
    assert bands.values.shape[2] == 4
    return device.array(bands.values[0].T), device.array(start, np.int32)


def cases():
    """Yield cases.

    All borders, mosaics and channels, sizes below and above a Gaussian's, odd ones, a margin,
    highlights.
    """
    random = np.random.default_rng(11)
    why = (
        "a spline of spacing D = sigma / 2.8, sampled once a sample, is wrong by (pi D)^-4 of it along each axis, "
        "by its sinc^4's nearest alias; a step passes sinc^4 and a Gaussian of 2.8 D to 1.5e-5; float32 sums are "
        "below 1e-6"
    )
    for rows, cols, count, channels, cfa, border, margin, first in (
        (8, 9, 1, 1, np.zeros((1, 1), np.int32), "zero", 0, 5.8),
        (40, 97, 3, 3, RGGB, "edge", 0, 5.8),
        (97, 40, 2, 3, RGGB, "reflect", 0, 11.6),
        (150, 130, 2, 2, None, "edge", 9, 23.3),
        (64, 65, 31, 3, RGGB, "zero", 0, 8.0),
        (33, 47, 2, 4, np.arange(15).reshape(3, 5) % 4, "reflect", 3, 6.0),
        (300, 20, 1, 1, None, "edge", 0, 4.0),
        (70, 51, 2, 2, None, "edge", -3, 11.6),
        (51, 70, 1, 2, None, "reflect", -2, 8.0),
        (31, 31, 1, 1, None, "zero", -1, 5.0),
        (90, 131, 4, 3, RGGB, "edge", 0, 4.0),
        (120, 88, 2, 3, RGGB, "reflect", 5, 4.0),
        (101, 99, 3, 2, None, "zero", -1, 5.0),
    ):
        sigmas = np.append(first * 1.6 ** np.arange(9), np.inf)
        planes = np.cumsum(random.standard_normal((count, rows, cols)), axis=2)
        planes[0, rows // 2, cols // 3 :] += 30
        shape = (rows - 2 * margin, cols - 2 * margin)
        yield Case(
            f"{rows}x{cols}, {count} planes, {'channels' if cfa is None else np.shape(cfa)}, {border}",
            {
                "onto": np.zeros(shape if cfa is not None else (channels, *shape), np.float32),
                "planes": planes.astype(np.float32),
                "weights": random.random((channels, count, len(sigmas))),
                "sigmas": sigmas,
                "cfa": cfa,
                "border": border,
                "margin": margin,
            },
            1.5e-5 + 1e-6 + 2 * (np.pi * first / 2.8) ** -4,
            why,
        )


def bench(rows, cols):
    """Return inputs: four planes to a Bayer mosaic, 64 pixels of border."""
    random = np.random.default_rng(11)
    sigmas = np.append(23.3 * 1.6 ** np.arange(13), np.inf)
    return {
        "onto": random.random((rows, cols), np.float32),
        "planes": random.random((4, rows, cols), np.float32),
        "weights": random.random((3, 4, len(sigmas))),
        "sigmas": sigmas,
        "cfa": RGGB,
        "border": "edge",
    }

"""Denoising of camera values after demosaicking, at several scales, luminance and chroma apart.

Ports: planes (C, rows, cols) float32, linear, noise that is known -> the same, denoised.

Shot and read noise of gain g and deviation s become even by roots, u = root(x + 3/8 g + s^2 / g),
which have the deviation root(g) / 2. `axes` makes a luminance and chromas of them, in which noise is
not correlated. A pyramid of means of 2 x 2 pixels follows: l times halved, p_l. In each level all
blocks of 4 x 4 pixels, in every place, are transformed (Walsh: sums and differences). A coefficient
c whose noise has the deviation s_k keeps less of itself the less it stands out of it:

    c - c min(1, max(0, 3/2 - c^2 / (2 t^2))),   t = LIMITS strength s_k:

nothing up to t, all of it from sqrt(3) t on. The mean of a block stays. D_l is the mean over the 16
blocks of a pixel of what they removed. The noise of coarser levels is added, in place of that which
finer ones found at their resolution:

    R_l = D_l + up(R_{l+1} - down(D_l)),

with `up` the bilinear interpolation. p_0 - R_0 is turned back to linear light. As the mean of roots
is less than the root of the mean, `root_loss` is added for the noise that is gone. A correction of
shading, x = G x', has raised the noise as well: all this is done with x / G.
"""

import functools
import math

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.processor.best import root_gain
from gpusim.kernels.processor.levels import check_noise, root_loss
from gpusim.kernels.stage import Array, Case, exact_case, stage, warp_only

LIMITS = 2.2, 2.6  # of luminance and of chroma [s_k]
LEVELS = 2, 8  # least and most
MOST_CHANNELS = 64
MOST_NODES = 1024  # of gains each way: places between them are counted in 32-bit integers
# on CPUs
TOP, LEFT = 3, 8  # margin of a level; after the picture it has room for vectors
CHUNK, RIGHT = 128, 16  # columns of a work-item, and further columns that it reads
BAND = 64  # rows of a work-item
# on GPUs
GROUPS = "processor.multiscale_groups"
LARGE_TILES = 12  # most channels of large tiles, which must fit into local memory
COLUMNS, LEAD = 128, 4  # columns of a work-group, and how many of these on each side overlap others
GROUP_BAND = 37  # rows of a work-group
REGISTERS = 96  # of a work-item of `shrink`; compilers take more, and fewer groups run at a time


@stage
def multiscale(
    device: Device,
    planes: Array,
    *,
    noise: tuple[float, float],
    axes: Array,
    spread: Array,
    share: Array,
    gains: Array | None = None,
    strength: float = 1.0,
) -> Array:
    """Remove noise of known strength from every scale of a picture.

    Values are finite. Edges are mirrored. Nothing is clipped. Noise (0, 0), like strength 0, changes
    nothing.

    Args:
        planes: Linear values [1], shape (C, rows, cols), C at most MOST_CHANNELS.
        noise: (gain, read) of the samples that the planes were made of, in the unit of the planes:
            a sample's variance is gain value + read^2. With a read noise above 20 electrons the
            gain is read / 20, as in `processor.best`.
        axes: Luminance in the first row, and chromas, as sums of the channels' roots, shape (C, C),
            see `opponent_axes`.
        spread: Standard deviation of the noise of every Walsh coefficient (orthonormal, 0 .. 3 sign
            changes down and along) in every level and axis, shape (levels, C, 4, 4), for roots of
            samples whose deviation is 1; 2 to 8 levels. 0 keeps the coefficient.
        share: Variance of the roots of each channel over that of samples [1], shape (C,).
        gains: Gains G of a correction of shading that the samples had, above 0, at nodes that are even
            from edge to edge of the frame, bilinear between them, shape (ny, nx), 2 to 1024 nodes
            along each axis; None: none.
        strength: Assumed over true standard deviation of the noise [1], 0 to 100.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear values, shape (C, rows, cols), float32.

    Raises:
        BadData: An array has the wrong shape, or `axes` has no inverse.
        OutOfRange: `noise`, `spread`, `share` or `strength` is negative or not finite, or a gain is not
            above 0.

    Source:
        Thresholds in all places of a transform: Coifman and Donoho 1995, "Translation-invariant
        de-noising", Lecture Notes in Statistics 103. In blocks at several scales: Pierazzo, Morel
        and Facciolo 2017, "Multi-scale DCT denoising", Image Processing On Line 7, 288. Roots with
        an offset: Anscombe 1948, Biometrika 35. The curve, a parabola's, is new here.
    """
    axes, spread, share = (np.asarray(one, np.float64) for one in (axes, spread, share))
    shading = np.ones((2, 2)) if gains is None else np.asarray(gains, np.float64)
    _check(planes.shape, axes, spread, share, shading)
    gain, read = check_noise(noise)
    for name, value in (("spread", spread), ("share", share)):
        if not (np.isfinite(value) & (value >= 0)).all():
            raise OutOfRange(f"multiscale: {name}", float(value.min()), "0 or more, finite")
    if not 0 <= strength <= 100:
        raise OutOfRange("strength", strength, "0 <= strength <= 100")
    if not (np.isfinite(shading) & (shading > 0)).all():
        raise OutOfRange("multiscale: gains", float(shading.min()), "above 0, finite")
    planes = device.array(planes)
    gain = root_gain(gain, read)
    if strength == 0 or gain == 0:
        return planes
    offset = float(0.375 * gain + read * read / gain)
    scales = _scales(spread, strength, gain)
    back = np.linalg.inv(axes), share * min(1, strength), root_loss(gain, read)
    tables = [device.array(table) for table in (shading, axes, *back)]
    out = device.empty(planes.shape)
    denoise = _by_groups if device.is_gpu else _by_lines
    denoise(device, planes, tables, scales, offset, int(gains is not None), out)
    return out


def _by_lines(device, planes, tables, scales, offset, shaded, out):
    """Denoise on CPUs, level after level."""
    channels, rows, cols = planes.shape
    shading, axes, *back = tables
    nodes = *shading.shape, *warp_only(device, channels, shaded)
    sizes = _level_sizes(rows, cols, len(scales))
    defines = {"CHANNELS": channels, "CHUNK": CHUNK, "BAND": BAND, "SHADED": shaded}
    launch = functools.partial(device.launch, "processor.multiscale", defines=defines)
    values = [device.empty((channels, high + 2 * TOP, stride)) for high, _, stride in sizes]
    noise = [device.empty((channels, high, stride - RIGHT)) for high, _, stride in sizes]
    grid = values[0].shape[1:]
    launch("split", grid, planes, shading, axes, values[0], offset, *sizes[0], *nodes)
    for finer, coarser, size, half in zip(values, values[1:], sizes, sizes[1:], strict=False):
        launch("halve", coarser.shape, finer, coarser, *size, *half)
    for level, size in enumerate(sizes):
        wide = noise[level].shape[2]
        grid = channels, -(-size[0] // BAND), wide // CHUNK
        numbers = *size, wide, *warp_only(device, BAND)
        table = device.array(scales[level])
        launch("shrink", grid, values[level], table, noise[level], *numbers, group=(1, 1, 1))
    for level in range(len(sizes) - 2, -1, -1):
        (high, across, _), (below, beside, _) = sizes[level : level + 2]
        fine, coarse = noise[level : level + 2]
        numbers = high, across, fine.shape[2], below, beside, coarse.shape[2]
        launch("compare", (channels, below, beside), fine, coarse, *numbers)
        if level:
            launch("merge", (channels, high, across), coarse, fine, *numbers)
    launch(
        "join",
        (rows, cols),
        *(values[0], *noise[:2], shading, *back, out, offset, *sizes[0]),
        *(noise[0].shape[2], *sizes[1][:2], noise[1].shape[2], *nodes),
    )


def _by_groups(device, planes, tables, scales, offset, shaded, out):
    """Denoise on GPUs, all levels at once."""
    channels, rows, cols = planes.shape
    shading, axes, *back = tables
    nodes = shading.shape
    levels = len(scales)
    sizes = [(-(-rows // 2**level), -(-cols // 2**level)) for level in range(levels)]
    values, noise = (device.empty((channels * sum(map(math.prod, sizes)),)) for _ in range(2))
    tile, halvings = (32, 5) if channels <= LARGE_TILES else (8, 3)
    items = 8 * tile
    defines = {"CHANNELS": channels, "LEVELS": levels, "SHADED": shaded, "TILE": tile}
    defines |= {"COLUMNS": COLUMNS, "BAND": GROUP_BAND}

    def launch(kernel, groups, items, *arguments, **more):
        grid, group = (groups * items,), (items,)
        device.launch(GROUPS, kernel, grid, *arguments, defines=defines | more, group=group)

    tiles = -(-rows // tile) * -(-cols // tile)
    launch("split", tiles, items, planes, shading, axes, values, offset, rows, cols, *nodes)
    for level in range(halvings + 1, levels):
        groups = -(-channels * math.prod(sizes[level]) // items)
        launch("halve", groups, items, values, rows, cols, level)
    bands = sum(-(-high // GROUP_BAND) * -(-wide // (COLUMNS - 2 * LEAD)) for high, wide in sizes)
    arrays = values, device.array(scales), noise
    launch("shrink", channels * bands, COLUMNS, *arrays, rows, cols, REGISTERS=REGISTERS)
    numbers = offset, rows, cols, *nodes
    launch("join", tiles, items, values, noise, shading, *back, out, *numbers)


def _check(shape, axes, spread, share, shading):
    """Raise BadData."""
    channels = shape[0] if len(shape) == 3 else 0
    levels = len(spread) if spread.ndim else 0
    wanted = (channels, channels), (levels, channels, 4, 4), (channels,)
    if (
        not 1 <= channels <= MOST_CHANNELS
        or not LEVELS[0] <= levels <= LEVELS[1]
        or (axes.shape, spread.shape, share.shape) != wanted
    ):
        raise BadData(
            f"multiscale: planes {tuple(shape)}, axes {axes.shape}, spread {spread.shape}, share "
            f"{share.shape}; wanted (C, rows, cols) with C from 1 to {MOST_CHANNELS}, (C, C), (levels, C, 4, "
            f"4) with {LEVELS[0]} to {LEVELS[1]} levels, and (C,)"
        )
    if shading.ndim != 2 or not 2 <= min(shading.shape) <= max(shading.shape) <= MOST_NODES:
        raise BadData(
            f"multiscale: gains {shading.shape}; wanted (ny, nx) nodes, 2 to {MOST_NODES} each"
        )
    if not np.isfinite(axes).all() or not np.linalg.cond(axes) < 1e6:
        raise BadData("multiscale: axes: wanted a matrix of finite numbers that has an inverse")


def _scales(spread, strength, gain):
    """Return 1 / (2 t^2) of coefficients that are sums without a factor, so 4 times as large."""
    limits = np.array([LIMITS[0], *[LIMITS[1]] * (spread.shape[1] - 1)])
    t = 4 * spread * limits[:, None, None] * strength * np.sqrt(gain) / 2
    return (1 / np.maximum(2 * t**2, 1e-30)).astype(np.float32)


def _level_sizes(rows, cols, levels):
    """Return rows, columns, and the columns of a plane with its margin, of each level."""
    sizes = []
    for _ in range(levels):
        sizes.append((rows, cols, -(-cols // CHUNK) * CHUNK + RIGHT))
        rows, cols = (rows + 1) // 2, (cols + 1) // 2
    return sizes


def multiscale_memory(device: Device, channels: int, rows: int, cols: int, levels: int) -> int:
    """Return the memory that `multiscale` uses beside its result [byte].

    Args:
        device: The device.
        channels: Number of channels.
        rows: Rows of the picture.
        cols: Columns of the picture.
        levels: Levels of the pyramid.
    """
    floats = 0
    for high, across, stride in _level_sizes(rows, cols, levels):
        if device.is_gpu:
            floats += 2 * high * across
        else:
            floats += (high + 2 * TOP) * stride + high * (stride - RIGHT)
    return 4 * channels * floats


def opponent_axes(covariance: np.ndarray, balance: np.ndarray) -> np.ndarray:
    """Return axes of roots in which the noise of large areas is not correlated, and 1 per pixel.

    The luminance is the sum of the channels with the least noise among those to which grey is 1 in
    all balanced roots. Grey has no chroma.

    Args:
        covariance: Of the noise of roots per pixel, in means over large areas, shape (C, C).
        balance: Factors of the channels that make grey equal in them [1], shape (C,).

    Returns:
        The axes, luminance first, shape (C, C), float64.
    """
    factors = np.sqrt(np.asarray(balance, np.float64))
    count = len(factors)
    whole = np.linalg.cholesky(factors[:, None] * covariance * factors)
    inverse = np.linalg.inv(whole)
    # in units of the noise: grey, then differences of neighbouring channels
    differences = (np.diff(np.eye(count), axis=0) @ whole).T
    basis = np.linalg.qr(np.column_stack([inverse @ np.ones(count), differences]))[0]
    axes = basis.T @ inverse * factors
    return axes * np.where(axes.sum(1, keepdims=True) < 0, -1, 1)


def _inputs(random, channels, rows, cols, levels, noise=(0.01, 0.02), strength=1.0, gains=None):
    """Return inputs with edges, waves and noise, and spreads about those of a mosaic."""
    y, x = np.mgrid[:rows, :cols]
    base = 0.4 + 0.3 * np.sin(x / 5 + y / 9) + 0.3 * ((x + 2 * y) % 60 > 30)
    light = np.stack([base * (1 + c) / channels for c in range(channels)])
    gain, read = noise
    planes = light + np.sqrt(gain * light + read**2) * random.standard_normal(light.shape)
    axes = opponent_axes(channels * np.eye(channels), np.linspace(1, 2, channels))
    half = 0.5 ** np.arange(levels)
    spread = random.uniform(0.5, 1.0, (levels, channels, 4, 4)) * half[:, None, None, None]
    return {
        "planes": planes.astype(np.float32),
        "noise": noise,
        "axes": axes,
        "spread": spread,
        "share": np.linspace(0.4, 0.8, channels),
        "gains": gains,
        "strength": strength,
    }


def cases():
    """Yield cases: sizes below a block, one to 17 channels, all numbers of levels, noise models."""
    random = np.random.default_rng(40)
    for channels, rows, cols, levels, more in (
        (3, 1, 1, 5, {}),
        (3, 2, 7, 5, {}),
        (1, 33, 65, 5, {}),
        (3, 67, 129, 5, {}),
        (3, 70, 200, 5, {"noise": (0.02, 0.0), "gains": random.uniform(1, 3, (3, 5))}),
        (2, 66, 131, 2, {"noise": (0.0, 0.05), "strength": 4.0}),
        (4, 40, 31, 8, {"strength": 0.5}),
        (12, 9, 130, 3, {}),  # the most channels of large tiles on GPUs
        (17, 45, 21, 5, {}),
    ):
        inputs = _inputs(random, channels, rows, cols, levels, **more)
        name = f"{channels} channels, {rows}x{cols}, {levels} levels"
        yield Case(name, inputs, _tolerance(inputs), "see _tolerance", metric="exact")
    inputs = _inputs(random, 3, 20, 30, 5)
    why = "nothing changes"
    yield exact_case("noise-free", why, **inputs | {"noise": (0.0, 0.0)})
    yield exact_case("strength 0", why, **inputs | {"strength": 0.0})


def _tolerance(inputs):
    """Return the largest error, from independent roundings with a root mean square of r = 0.6 x 2^-24 of a value each.

    With P the largest value in the axes, a level errs by e = root(C + 4 + 3 levels) r P: C products, their sums, the
    roots, and the means of each level. Transforms keep the mean square of errors. Their 4 steps have sums of up to 4 P
    and add 2 r 4 P. The curve's slope is 3 at most, the mean of 16 blocks adds none: D errs by 3 (e + 8 r P). It acts
    twice, itself and by its means; levels add as squares. The inverse of the axes multiplies by its norm I. A linear
    value errs by 2 m times that and has 32 roundings of m^2, its own and those of the gain, which multiplies all. The
    largest of some 10^4 is below 8 times the root mean square.
    """
    planes, axes = np.asarray(inputs["planes"], np.float64), inputs["axes"]
    gain = root_gain(*inputs["noise"])
    roots = np.sqrt(np.abs(planes + 0.375 * gain + inputs["noise"][1] ** 2 / gain))
    rounding, levels = 0.6 * 2.0**-24, len(inputs["spread"])
    most, m = np.abs(np.tensordot(axes, roots, 1)).max(), roots.max()
    level = 3 * (np.sqrt(len(planes) + 4 + 3 * levels) + 8) * rounding * most
    inverse = np.linalg.norm(np.linalg.inv(axes), 2)
    gains = inputs["gains"]
    factor = 1.0 if gains is None else gains.max()
    return factor * 8 * (2 * m * inverse * 2 * np.sqrt(levels) * level + 6 * rounding * m**2)


def bench(rows, cols):
    """Return inputs: three channels with 100 e- at white."""
    return _inputs(np.random.default_rng(40), 3, rows, cols, 5)


def operations(planes, noise, axes, spread, share, gains=None, strength=1.0):
    """Count operations: per pixel and channel 16 coefficients of 10, four transforms of 8, and 60 for the rest."""
    return round(planes.size * 4 / 3 * (160 + 8 + 32 + 32 + 8 + 16 + 60))

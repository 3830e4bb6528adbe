"""Demosaicking and denoising by a small network, for any mosaic of red, green and blue.

Ports: raw (rows, cols) uint16 [DN] -> rgb (3, rows, cols) float32, 1 at the white level.
"""

import functools
import itertools
from collections.abc import Sequence

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.network import (
    BLOCK,
    COLORS,
    GROUP,
    INPUTS,
    REACH,
    Network,
    check_served,
    spread,
)
from gpusim.io.camera.network import built_in_network
from gpusim.kernels.common.cases import bench_mosaic
from gpusim.kernels.processor.adaptive import DOMAINS
from gpusim.kernels.processor.bayer import check_mosaic
from gpusim.kernels.processor.best import root_gain
from gpusim.kernels.processor.levels import check_balance, check_noise
from gpusim.kernels.stage import Array, Case, is_opencl_cpu, stage

RUN = 64  # blocks of a CPU's work-item: rows of planes are whole runs
TILES = "processor.network_tiles"  # the kernel of GPUs
HALF = "processor.network_half"  # the kernels of their matrix units
EDGE, DOWN, ITEMS = 16, 8, 128  # sides of a matrix; rows and work-items of a group there
FIRST = -(-INPUTS // EDGE) * EDGE  # channels of the first layer there
ALONG = 32  # columns of a work-group of GPUs
MOST_INPUTS = 16  # in its local memory at a time
GUARD = 8  # columns of blocks before a row; one would do, but vectors should begin at multiples


@stage
def network(
    device: Device,
    raw: Array,
    *,
    cfa: Sequence[str],
    black_level: float,
    scale: float,
    domain: str = "root",
    noise: tuple[float, float] = (0.0, 0.0),
    balance: tuple[float, float] = (1.0, 1.0),
    weights: Network | None = None,
    half: bool = False,
) -> Array:
    """Demosaick and denoise by layers of 3 x 3 convolutions on blocks of 2 x 2 pixels.

    The layers add to a first guess, weighted means of each colour's samples. They know the mosaic
    and the noise of each sample. Nothing is clipped. Bayer mosaics are mirrored at borders; others
    repeat their outermost period.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        cfa: One period of the mosaic, a text per row, at most 8 x 8, of R, G and B, which all
            occur in every 4 x 4 pixels.
        black_level: Black level [DN].
        scale: Factor of the result [1/DN].
        domain: "root" for linear data, "linear" for data that are already encoded and have no
            noise.
        noise: (gain [DN/e-], read [DN]): the variance of a digital number is gain (DN -
            black_level) + read^2 [DN^2]; (0, 0) for no noise. With a read noise above 20 electrons
            the gain is read / 20, as in `processor.best`.
        balance: Factors of (red, blue) with which white is as strong in them as in green [1]. The
            result is divided by them.
        weights: The network; None for the built-in one.
        half: Whether devices with matrix units may multiply in float16, with sums in float32, if
            the channels between the layers are a multiple of 16. Other devices multiply in float32.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear camera RGB [1], shape (3, rows, cols), float32.

    Raises:
        BadData: `raw` is no mosaic of uint16, or smaller than a period.
        OutOfRange: The mosaic, `scale`, `noise` or `balance` is not allowed.
        UnknownName: There is no such domain.

    Source:
        Gharbi, Chaurasia, Paris and Durand 2016, "Deep joint demosaicking and denoising", ACM
        Transactions on Graphics 35(6), 191. Here with fewer weights, a first guess, masks of the
        colours as inputs, and codes of constant noise (Anscombe 1948, Biometrika 35).
    """
    check_mosaic(raw, scale)
    check_served(cfa)
    least = tuple(max(2, period) for period in (len(cfa), len(cfa[0])))
    if raw.shape[0] < least[0] or raw.shape[1] < least[1]:
        raise BadData(
            f"raw: {raw.shape[0]}x{raw.shape[1]} pixels; with the mosaic {'/'.join(cfa)} at least "
            f"{least[0]}x{least[1]} are wanted"
        )
    if domain not in DOMAINS:
        raise UnknownName("domain", domain, DOMAINS)
    gain, read = (scale * value for value in check_noise(noise))
    if domain == "linear" and (gain or read):
        raise OutOfRange("noise", noise, '(0, 0) in domain "linear": encoded data')
    balance = check_balance(balance)
    gain = root_gain(gain, read)
    offset = 0.375 * gain + (read**2 / gain if gain else 0.0)
    trained = built_in_network() if weights is None else weights
    half = half and device.has_matrix_units and len(trained.biases[0]) % EDGE == 0
    prepared = _prepared(device, trained, half)
    colors = _color_table(device, tuple(cfa))
    rows, cols = raw.shape
    margin = 2 * prepared.layers
    high, wide, stride = _block_sizes(rows, cols, prepared.layers)
    height, width = 2 * high + 2 * REACH, 2 * wide + 2 * REACH  # [pixel]
    factors = tuple(map(float, np.sqrt((balance[0], 1.0, balance[1]))))
    is_root = int(domain == "root")
    sigma = is_root * float(gain) ** 0.5 / 2
    whole, sizes = (height, width), (high, wide, stride)
    taken = (*colors.shape, rows, cols, *whole)
    raw = device.array(raw, np.uint16)
    levels = float(black_level), float(scale), float(offset)
    guess = device.empty((3, 2 * high, 2 * wide))
    out = device.empty((3, rows, cols))
    decoding = (float(offset), *factors, is_root, margin, *sizes, rows, cols)
    if half:
        codes, hues = device.empty(whole), device.empty(whole, np.uint16)
        parameters = (*levels, *factors, is_root, margin + REACH, *taken)
        _launch_half(device, "encode_half", height * width, (raw, colors, codes, hues, *parameters))
        blocks = device.empty((high + 2, stride, FIRST), np.uint16)
        noises = tuple(sigma * factor for factor in factors)
        arrays = (codes, hues, prepared.taps, guess, blocks)
        _launch_half(device, "guess_half", high * wide, (*arrays, *noises, *sizes), out=FIRST)
        blocks = _convolve_half(device, prepared, blocks, sizes)
        _launch_half(device, "decode_half", rows * cols, (guess, blocks, out, *decoding))
        return out
    launch = functools.partial(device.launch, "processor.network")
    samples = device.empty((7, *whole))  # codes, masks, noise
    parameters = (*levels, sigma, *factors, is_root, margin + REACH, *taken)
    launch("encode", whole, *(raw, colors, samples), *parameters)
    launch("guess", (2 * high, 2 * wide), *(samples, prepared.taps, guess, *whole))
    most = max(INPUTS, *prepared.outputs)
    blocks, other = (device.empty((most, high + 2, stride)) for _ in range(2))
    launch("pack", (high, wide), *(samples, guess, blocks, *sizes))
    for number in range(prepared.layers):
        _convolve(device, prepared, number, (blocks, other), sizes)
        blocks, other = other, blocks
    launch("decode", (rows, cols), *(guess, blocks, out), *decoding)
    return out


def _convolve_half(device, prepared, blocks, sizes):
    """Start all layers with products of float16; return the last one's blocks (high + 2, stride, EDGE)."""
    high, wide, stride = sizes
    across = -(-wide // ALONG)
    for number in range(prepared.layers):
        into, of = blocks.shape[2], _pad_to_edge(prepared.outputs[number])
        other = device.empty((high + 2, stride, of), np.uint16)
        arrays = (blocks, prepared.weights[number], prepared.biases[number], other)
        numbers = (prepared.choose_kind(number), *sizes, across)
        items = -(-high // DOWN) * across * ITEMS
        _launch_half(device, "convolve_half", items, (*arrays, *numbers), into, of)
        blocks = other
    return blocks


def _launch_half(device, kernel, items, args, into=EDGE, out=EDGE):
    """Start a kernel of HALF in whole groups; into, out: channels of its blocks."""
    items = -(-items // ITEMS) * ITEMS
    defines = {"WIDTH": into, "OUT": out}
    device.launch(HALF, kernel, (items,), *args, defines=defines, group=(ITEMS,))


def _pad_to_edge(outputs):
    """Return the next multiple of EDGE."""
    return -(-outputs // EDGE) * EDGE


def _convolve(device, prepared, number, planes, sizes):
    """Start one layer. planes: of its inputs, and for its outputs; there may be more planes than it uses."""
    high, wide, stride = sizes
    kind = prepared.choose_kind(number)
    launch = functools.partial(device.launch, "processor.network", "convolve")
    arrays = (planes[0], prepared.weights[number], prepared.biases[number], planes[1])
    inputs = prepared.outputs[number - 1] if number else INPUTS
    outputs = prepared.outputs[number]
    numbers = (kind, inputs, outputs, high, stride)
    if device.is_gpu:
        shared = max(1, 4 * GROUP // outputs)  # groups of rows, so that a work-group has four parts
        rows, across = 4 * shared, -(-wide // ALONG)
        items = ALONG * shared * outputs // GROUP
        defines = {
            "INPUTS": inputs,
            "OUTPUTS": outputs,
            "CHUNK": next(n for n in range(MOST_INPUTS, 0, -1) if inputs % n == 0),
            "ROWS": rows,
            "ITEMS": items,
        }
        device.launch(
            TILES,
            "convolve_tiles",
            (-(-high // rows) * across * items,),
            *(*arrays, kind, high, wide, stride, across),
            defines=defines,
            group=(items,),
        )
    elif device.kind == "opencl":
        launch((high, stride // RUN), *arrays, *numbers, group=(1, 1))
    else:
        launch((outputs // GROUP, high, wide), *arrays, *numbers)


def network_memory(rows: int, cols: int, weights: Network | None = None) -> int:
    """Return the memory that `network` uses beside its result [byte].

    Args:
        rows: Rows of the mosaic.
        cols: Columns of the mosaic.
        weights: The network; None for the built-in one.
    """
    trained = built_in_network() if weights is None else weights
    high, wide, stride = _block_sizes(rows, cols, len(trained.weights))
    planes = max(INPUTS, *map(len, trained.biases))
    samples = 7 * (2 * high + 2 * REACH) * (2 * wide + 2 * REACH)
    return 4 * (samples + 12 * high * wide + 2 * planes * (high + 2) * stride)


def _block_sizes(rows, cols, layers):
    """Return rows and columns of blocks with their margin, and the columns of a plane."""
    high, wide = ((n + n % 2) // 2 + 2 * layers for n in (rows, cols))
    return high, wide, -(-(wide + GUARD + 1) // RUN) * RUN


class _Prepared:
    """A network on a device.

    weights: of each layer, outputs in groups, (groups, inputs, 9, MADE); of GPUs all of an input
    together, (inputs, 9, outputs / MADE, MADE). With `half` as float16, see `_arrange_weights`.
    """

    def __init__(self, device: Device, trained: Network, half: bool):
        self.layers = len(trained.weights)
        self.outputs = [len(bias) for bias in trained.biases]
        made = 6 if is_opencl_cpu(device) else GROUP
        self.taps = device.array(spread(np.arange(-REACH, REACH + 1)))
        self.weights, self.biases = [], []
        for weight, bias in zip(trained.weights, trained.biases, strict=True):
            if half:
                more = _pad_to_edge(len(bias)) - len(bias)
                self.weights.append(
                    device.array(_arrange_weights(weight).view(np.uint16), np.uint16)
                )
                self.biases.append(device.array(np.pad(bias, (0, more))))
                continue
            grouped = weight.reshape(-1, made, weight.shape[1], 9)
            grouped = grouped.transpose((2, 3, 0, 1) if device.is_gpu else (0, 2, 3, 1))
            self.weights.append(device.array(np.ascontiguousarray(grouped)))
            self.biases.append(device.array(bias))

    def choose_kind(self, number: int) -> int:
        """Return what a layer does with its sums, see network.cl."""
        return 2 if number == self.layers - 1 else int(number > 0)


def _arrange_weights(weight):
    """Return weights as network_half.cl reads them, float16, (9, inputs / 16, outputs / 8, 128).

    In step s, the work-item 4 g + t holds inputs t inputs / 4 + 4 s .. + 3, and column g of tile n,
    which is output (g // 2) outputs / 4 + 2 n + g % 2.
    """
    outputs, inputs = weight.shape[:2]
    padded = np.zeros((_pad_to_edge(outputs), _pad_to_edge(inputs), 9), np.float16)
    padded[:outputs, :inputs] = weight.reshape(outputs, inputs, 9)
    tiles, steps = len(padded) // 8, padded.shape[1] // EDGE
    parts = padded.reshape(4, tiles, 2, 4, steps, 4, 9)  # g // 2, n, g % 2, t, s, input of four, k
    return np.ascontiguousarray(parts.transpose(6, 4, 1, 0, 2, 3, 5)).reshape(9, steps, tiles, 128)


_prepared = functools.lru_cache(maxsize=16)(_Prepared)


@functools.lru_cache(maxsize=64)
def _color_table(device, cfa):
    """Return the index of each pixel's colour in a mosaic's period, (period_y, period_x)."""
    return device.array(np.array([[COLORS.index(one) for one in row] for row in cfa]), np.int32)


def cases():
    """Yield cases.

    The built-in network and a small random one, several mosaics and phases, both domains, noise,
    balance, odd and degenerate sizes, black and saturation; products of float16.
    """
    random = np.random.default_rng(40)
    noise, balance = (0.5, 3.0), (1.7, 2.4)
    small = _random_network(random)
    options: tuple[tuple, ...] = (
        ("RGGB", ("RG", "GB"), (9, 12), {}),
        ("GBRG noisy", ("GB", "RG"), (13, 7), {"noise": noise}),
        ("two rows", ("RG", "GB"), (2, 5), {}),
        ("quad-Bayer", ("RRGG", "RRGG", "GGBB", "GGBB"), (16, 11), {"balance": balance}),
        ("X-Trans", X_TRANS, (14, 18), {"noise": noise, "balance": balance}),
        ("encoded", ("BG", "GR"), (8, 8), {"domain": "linear"}),
    )
    for name, cfa, (rows, cols), knowledge in options:
        raw = random.integers(300, 2000, (rows, cols)).astype(np.uint16)
        raw.flat[0], raw.flat[-1] = 0, 65535
        yield _case(name, raw, cfa, small, **knowledge)
    y, x = np.ogrid[:20, :70]
    smooth = 1000 + 400 * np.sin(x / 5 + y / 7) + 300 * (x > 40)
    raw = np.rint(random.normal(smooth, 15)).astype(np.uint16)
    yield _case("built in", raw, ("RG", "GB"), None, noise=noise)
    yield _case("built in, X-Trans", raw, X_TRANS, None)
    yield _case("half", raw, ("RG", "GB"), None, noise=noise, half=True)
    raw = random.integers(300, 2000, (37, 41)).astype(np.uint16)
    wide = _random_network(random, 48)
    yield _case("half, random", raw, X_TRANS, wide, balance=balance, half=True)


X_TRANS = ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG")


def _random_network(random, width=12):
    """Return a network of three layers whose sums neither grow nor vanish."""
    sizes = (INPUTS, width, width, 3 * BLOCK)
    shapes = [(into, of, 3, 3) for of, into in itertools.pairwise(sizes)]
    weights = [random.normal(0, (9 * shape[1]) ** -0.5, shape) for shape in shapes]
    biases = [random.normal(0, 0.1, shape[0]) for shape in shapes]
    return Network(
        tuple(one.astype(np.float32) for one in weights),
        tuple(one.astype(np.float32) for one in biases),
    )


def _case(name, raw, cfa, weights, **knowledge):
    """Return a case; its tolerance is the effect of weights that change as sums of float32 round."""
    from gpusim.kernels.processor.network_ref import network as reference

    trained = built_in_network() if weights is None else weights
    inputs = {"raw": raw, "cfa": cfa, "black_level": 64.0, "scale": 1 / 2048, "weights": weights}
    inputs |= knowledge
    random, step, worst = np.random.default_rng(4), 1e-5, 0.0
    exact = reference(**inputs)
    for _ in range(3):
        changed = [
            one * (1 + step * random.choice([-1.0, 1.0], one.shape)) for one in trained.weights
        ]
        found = reference(**inputs | {"weights": Network(tuple(changed), trained.biases)})
        worst = max(worst, np.abs(found - exact).max())
    if inputs.get("half"):
        rounding, why = (
            2.0**-11,
            (
                "float16 rounds by at most 2^-11, and by 2^-11 / sqrt(3) in the root mean square: weights; the values "
                "that they multiply, which is as if the weights changed; and the values that layers add to, which "
                "matter as much as their sums: sqrt(3) times the effect of one"
            ),
        )
    else:
        terms = max(one[0].size for one in trained.weights) + 60
        rounding, why = (
            2.0**-24 * terms**0.5,
            (
                "a sum of n terms in float32 is the exact sum with weights changed by sqrt(n) 2^-24 (Higham and Mary "
                "2019, SIAM J. Sci. Comput. 41, A2815); 60 terms more for the codes, the guess and decoding"
            ),
        )
    effect = rounding * worst / step / np.abs(exact).max()
    return Case(
        name,
        inputs,
        2 * max(effect, 20 * 2.0**-24),
        f"{why}; the result is that of changed weights, whose effect the reference shows; 2 because three random "
        "changes need not hit the worst one; at least 20 roundings",
    )


def bench(rows, cols):
    """Return inputs: a 10-bit mosaic."""
    return {**bench_mosaic(5, rows, cols), "cfa": ("RG", "GB")}

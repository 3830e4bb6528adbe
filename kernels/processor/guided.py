"""Demosaicking by filters that are chosen on a first picture: any mosaic of 2 to 4 channels.

Ports: raw (rows, cols) uint16 [DN] -> planes (C, rows, cols) float32, 1 at the white level.
"""

import functools
from collections.abc import Mapping, Sequence

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData
from gpusim.domain.guided import BUILT_IN, GuidedTable, MosaicCode, diamond, steps_of
from gpusim.domain.mosaics import MOSAICS
from gpusim.io.camera.guided import guided_table
from gpusim.kernels.common.cases import bench_mosaic
from gpusim.kernels.processor.bayer import check_mosaic
from gpusim.kernels.processor.guided_ref import left_noise
from gpusim.kernels.processor.levels import check_balances, root_loss
from gpusim.kernels.stage import Array, Case, stage, warp_only


@stage
def guided(
    device: Device,
    raw: Array,
    *,
    phase: Sequence[str],
    black_level: float,
    scale: float,
    table: GuidedTable,
    domain: str = "root",
    noise: tuple[float, float] = (0.0, 0.0),
    balance: Mapping[str, float] | None = None,
    channels: Sequence[str] | None = None,
) -> Array:
    """Make a first picture, and filter every pixel by its position and the contrast of that picture.

    The square of a mean root is less than the mean, see `root_loss`; the difference is given back
    by the share of the noise's variance that each filter removes. Around the frame its outermost
    period is repeated, or the frame mirrored for periods of 1 and 2. Nothing is clipped.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        phase: One period of the sensor's mosaic, a text per row. The table must be for it, or for
            one that differs by a shift.
        black_level: Black level [DN].
        scale: 1 / (white_level - black_level) [1/DN].
        table: The filters.
        domain: "root" for linear data, "linear" for data that are already encoded.
        noise: (gain [DN/e-], read noise [DN]), (0, 0) for none; see `Code`.
        balance: Factors of channels before the filters by letter [1]; None: all are 1. With them,
            white is as strong in each channel as in the table's guide, as in the pictures from
            which the filters were learned. The result is divided by them.
        channels: Letters in the order of the result; None: `table.channels`.
        device: A `Device`, or its name for `open_device`.

    Returns:
        The channels [1], shape (C, rows, cols), float32.

    Raises:
        BadData: `raw` is no mosaic of uint16, or is smaller than a period; `channels` are not the
            table's.
        OutOfRange: `scale`, `noise` or `balance` is not allowed.
        UnknownName: The table does not know the mosaic.

    Source:
        Lansel and Wandell 2011, "Local linear learned image processing pipeline", Imaging Systems
        and Applications, with classes in the manner of Romano, Isidoro and Milanfar 2017, IEEE
        Trans. Computational Imaging 3, 110.
    """
    check_mosaic(raw, scale)
    shift = table.shift(phase)
    code = _code(table, domain, float(black_level), float(scale), noise, balance)
    order = tuple(channels or table.channels)
    if sorted(order) != sorted(table.channels):
        raise BadData(
            f"channels: {', '.join(order)}, wanted {', '.join(table.channels)} in any order"
        )
    (rows, cols), period = raw.shape, table.period
    if rows < period[0] or cols < period[1]:
        raise BadData(
            f"raw: {rows}x{cols} pixels; with a mosaic of {period[0]}x{period[1]} at least "
            f"{period[0]}x{period[1]} are wanted"
        )
    prepared = _prepared(device, table, code, order)
    root, steps = int(code.domain == "root"), steps_of(code)
    inner, outer = table.reach
    high, wide = rows + 2 * (inner + outer), cols + 2 * (inner + outer)
    deep, broad = rows + 2 * outer, cols + 2 * outer
    codes = device.empty((high, wide), np.int32)
    pictures = device.empty((deep, broad, 4), np.int32)
    contrasts = device.empty((rows + 2 * table.box, cols + 2 * table.box, 4), np.int32)
    tints = device.empty(contrasts.shape[:2], np.int32)
    units = device.empty((rows, cols), np.int32)
    out = device.empty((len(order), rows, cols))
    defines = {"CHANNELS": len(order), "GUIDE": table.guide}
    size = warp_only(device, len(order))
    launch = functools.partial(device.launch, "processor.guided", defines=defines)
    launch(
        "encode",
        codes.shape,
        *(device.array(raw, np.uint16), prepared.factors, codes),
        *(float((code.offset if root else 0.0) - code.black_level), float(np.sqrt(code.offset))),
        *(steps, root, inner + outer, *shift),
        *(*period, rows, cols, high, wide),
    )
    launch(
        "first",
        (deep, broad),
        *(codes, prepared.first_taps, prepared.first, pictures),
        *(inner, outer, *shift),
        *(*period, prepared.first_taps.shape[0], deep, broad, wide),
    )
    launch(
        "contrast",
        contrasts.shape[:2],
        *(pictures, contrasts, tints),
        outer - table.box,
        *(contrasts.shape[0], contrasts.shape[1], broad, *size, *warp_only(device, table.guide)),
    )
    launch(
        "classify",
        (rows, cols),
        *(contrasts, tints, prepared.limits, units),
        *(prepared.least, *shift),
        *period,
        *(len(bounds) for bounds in (table.ratios, table.diagonals, table.shares)),
        *(table.kinds[3] - 1, table.box),
        *(rows, cols),
    )
    launch(
        "apply",
        (rows, cols),
        *(codes, pictures, units, prepared.code_taps, prepared.guide_taps),
        *(prepared.weights, prepared.share, prepared.loss, out),
        *(1 / steps, float(np.sqrt(code.offset)), float(code.offset), float(scale)),
        *(root, inner + outer, outer),
        *(
            prepared.code_taps.shape[0],
            prepared.guide_taps.shape[0],
            rows,
            cols,
            wide,
            broad,
            *size,
        ),
    )
    return out


def _code(table, domain, black_level, scale, noise, balance):
    balances = check_balances(balance or {}, table.channels)
    return MosaicCode(domain, black_level, scale, noise, mosaic=table.mosaic, balances=balances)


class _Prepared:
    """A table on a device, for frames of one code and an order of the result.

    factors: of the codes of each position. first: [position][tap] weights of the channels and 0.
    limits: bounds of the strengths, ratios, diagonals, shares; least: the floor; as whole numbers. weights:
    [position and class][term] weights in the channels of the result and 0; terms are the codes
    and, for each tap, the channels of the first picture. share: of the loss of the square that is
    given back, see `root_loss`.
    """

    def __init__(self, device, table: GuidedTable, code: MosaicCode, channels: tuple[str, ...]):
        first, second, floor, strengths = table.at_noise(code.sigma)
        taps = [diamond(radius) for radius in table.radii]
        self.first_taps, self.code_taps, self.guide_taps = (
            device.array(np.ascontiguousarray(tap), np.int32) for tap in taps
        )
        letters = "".join(table.mosaic)
        factors = np.array([code.factors[letter] for letter in letters], np.float32)
        self.factors = device.array(factors)
        count, results = len(channels), [table.channels.index(letter) for letter in channels]
        wide = np.zeros((table.positions, len(taps[0]), 4), np.int32)
        wide[..., :count] = np.moveaxis(first, 1, 2)
        self.first = device.array(wide, np.int32)
        unit = table.lights * steps_of(code) * code.white * (2 * table.box + 1) ** 2
        self.least = int(np.floor(floor * unit))
        bounds = np.floor(2 * strengths * unit)
        limits = np.concatenate([bounds, table.ratios, table.diagonals, table.shares])
        self.limits = device.array(limits.astype(np.int32), np.int32)
        unbiased = code.domain == "root" and code.noise[0] > 0
        share = np.zeros((table.positions * second.shape[1], 4), np.float32)
        if unbiased:
            left = left_noise(table, code, first, second)
            share[:, :count] = 1 - left.reshape(-1, count)[:, results]
        self.share = device.array(share)
        self.loss = device.array(root_loss(*code.noise) if unbiased else np.zeros(7, np.float32))
        codes, guides = len(taps[1]), len(taps[2])
        by_tap = np.arange(count * guides).reshape(count, guides).T.ravel()
        order = np.concatenate([np.arange(codes), codes + by_tap])
        own = np.array([code.factors[letter] for letter in channels])
        filters = second.reshape(-1, *second.shape[2:])[:, results]
        weights = np.zeros((len(filters), len(order), 4), np.float32)
        weights[..., :count] = np.moveaxis(filters, 1, 2)[:, order] / own
        self.weights = device.array(weights)


_prepared = functools.lru_cache(maxsize=16)(_Prepared)


def cases():
    """Yield cases: all built-in tables, shifts, orders, with and without noise and balance; both domains for two."""
    random = np.random.default_rng(8)
    for name in BUILT_IN:
        table, mosaic = guided_table(name), MOSAICS[name]
        period = len(mosaic)
        moved = tuple(text[1:] + text[:1] for text in (*mosaic[2:], *mosaic[:2]))
        tiny, odd, large = (period, period), (period + 1, period + 5), (38, 71)
        every = (
            ("linear", (0.0, 0.0), (1.0, 1.0), tiny),
            ("linear", (0.0, 0.0), (1.0, 1.0), large),
            ("root", (0.0, 0.0), (1.9, 0.7), odd),
            ("root", (9.0, 14.0), (1.0, 3.7), large),
        )
        for domain, noise, balance, size in every if name in BUILT_IN[:2] else every[2:]:
            ends = table.channels[0], table.channels[-1]
            ramp = np.add.outer(29 * np.arange(size[0]), 11 * np.arange(size[1])) % 3000
            raw = (ramp + random.integers(0, 1000, size)).astype(np.uint16)
            raw.flat[0], raw.flat[-1] = 0, 65535
            options = {"domain": domain, "noise": noise}
            options["balance"] = dict(zip(ends, balance, strict=True))
            if size == large:
                options["channels"] = table.channels[::-1]
            title = f"{name} {domain} {noise} {size[0]}x{size[1]}"
            yield _case(title, raw, table, phase=moved if size == large else mosaic, **options)


def _case(name, raw, table, black_level=64.3, scale=1 / 4000, **options):
    """Return a case; its tolerance is all roundings of the largest sum of a filter of the table."""
    from gpusim.kernels.processor.guided_ref import guided as reference

    inputs = {"raw": raw, "black_level": black_level, "scale": scale, "table": table, **options}
    code = _code(table, options["domain"], black_level, scale, options["noise"], options["balance"])
    peak = np.abs(reference(**inputs)).max() / scale
    slope = 1.0 if code.domain == "linear" else 2 * np.sqrt(peak + code.offset)
    strongest = np.abs(code.encode_raw(raw)).max() / min(code.factors.values())
    terms = table.second.shape[-1]
    largest = np.abs(table.at_noise(code.sigma)[1]).sum(axis=-1).max() * strongest
    # of the first picture against the codes: sums of absolute weights
    largest *= np.abs(table.first).sum(axis=-1).max() / 2048
    return Case(
        name,
        inputs,
        (terms + 12) * 2.0**-24 * largest * slope / peak,
        "a product and a sum for each term, a weight in float32, the decoding, and four for the loss of the "
        "square, which is smaller than that: 2^-24 each of the largest sum of absolute products, times the "
        "slope of the square. Codes, first pictures and classes are whole numbers",
    )


def bench(rows, cols):
    """Return inputs: a 10-bit X-Trans mosaic, without noise."""
    made = bench_mosaic(2, rows, cols)
    return {**made, "phase": MOSAICS["x-trans"], "table": guided_table("x-trans")}


def operations(raw, table, **others):
    """Count operations: multiplications and additions of both filters, and of contrasts."""
    taps = table.first.shape[-1] + table.second.shape[-1]
    return raw.size * (2 * len(table.channels) * taps + 4 * (2 * table.box + 1) ** 2 + 30)

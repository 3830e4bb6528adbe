"""Demosaicking by learned linear filters, chosen pixel by pixel: any mosaic to any planes.

Ports: raw (rows, cols) uint16 [DN] -> planes (outputs, rows, cols) float32, 1 at the white level.
"""

import functools
from collections.abc import Sequence

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.learned import Code, FilterTable, Layout
from gpusim.io.camera.learned import bayer_table
from gpusim.kernels.processor.bayer import RED, check_mosaic
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.levels import check_balance, root_loss
from gpusim.kernels.stage import Array, Case, stage, warp_only

STEPS = {"root": 256.0, "linear": 1.0}  # whole numbers per unit of code
TILES = "processor.learned_tiles"  # the kernel of GPUs
LOCAL = 48 * 1024  # bytes of local memory on any GPU


@stage
def learned(
    device: Device,
    raw: Array,
    *,
    phase: str | Sequence[str],
    black_level: float,
    scale: float,
    domain: str | None = None,
    noise: tuple[float, float] = (0.0, 0.0),
    table: FilterTable | None = None,
    balance: tuple[float, float] = (1.0, 1.0),
) -> Array:
    """Filter every pixel by its position in the mosaic, its class and the level around it.

    The square of a mean root is less than the mean, see `root_loss`. Tables without a constant,
    which keep flat fields, get the difference back by the share of the noise's variance that each
    filter removes. Tables with a constant learned it.

    Bayer and other mosaics with a period of at most 2 are mirrored at borders without repeating the
    end pixel; others repeat their outermost period. A Bayer frame of one row or column is
    interpolated bilinearly. Nothing is clipped.

    Args:
        raw: Digital numbers [DN], shape (rows, cols), uint16.
        phase: The sensor's mosaic: "RGGB", "GRBG", "GBRG", "BGGR", or one period of any other as a
            text per row. The table must be for it, or for one that differs by a shift.
        black_level: Black level [DN].
        scale: 1 / (white_level - black_level) [1/DN].
        domain: "root" for linear data, "linear" for data that are already encoded; None for the
            table's domain.
        noise: (gain [DN/e-], read noise [DN]), (0, 0) for none; see `Code`.
        table: A FilterTable; None for the built-in one for Bayer mosaics.
        balance: Factors of (red, blue) before the filters [1], for tables from a Bayer mosaic to R,
            G and B. With them, white is as strong in red and blue as in green, as in the
            photographs from which the built-in filters were learned. The result is divided by them.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Outputs [1], shape (outputs, rows, cols), float32.

    Raises:
        BadData: `raw` is no mosaic of uint16, or is smaller than 2 pixels or a period.
        OutOfRange: `scale`, `noise` or `balance` is not allowed.
        UnknownName: The table does not know the mosaic.

    Source:
        Lansel and Wandell 2011, "Local linear learned image processing pipeline", Imaging Systems
        and Applications; Tian, Lansel, Farrell and Wandell 2014, Proc. SPIE 9023, 90230K.
    """
    check_mosaic(raw, scale)
    table = bayer_table() if table is None else table
    layout = table.layout
    shift = layout.shift(phase)
    code = _code(domain or layout.domain, black_level, scale, noise, balance, layout)
    if 1 in raw.shape and layout.mosaic == ("RG", "GB") and layout.outputs == ("R", "G", "B"):
        return bilinear(
            raw, phase="".join(phase), black_level=black_level, scale=scale, device=device
        )
    rows, cols = raw.shape
    least = tuple(max(2, period) for period in layout.period)
    if rows < least[0] or cols < least[1]:
        raise BadData(
            f"raw: {rows}x{cols} pixels; with a mosaic of {layout.period[0]}x{layout.period[1]} at least "
            f"{least[0]}x{least[1]} are wanted"
        )
    prepared = _prepared(device, table, code)
    zero, pixels = float(np.sqrt(code.offset)), (2 * layout.box + 1) ** 2
    unit = STEPS[code.domain] * code.white * pixels
    from_black = float(code.offset - code.black_level), zero, prepared.factors
    decoding = zero, float(code.offset), float(scale), code.black_level
    # where whole codes start
    black = 0.0 if code.domain == "root" else float(np.ceil(code.black_level - 0.5))
    measures = prepared.least, float(1 / unit), float(black * pixels / unit)
    raw = device.array(raw, np.uint16)
    out = device.empty((len(layout.outputs), rows, cols))
    (_tiles if device.is_gpu else _passes)(
        device, prepared, layout, raw, out, measures, from_black, decoding, shift
    )
    return out


def _code(domain, black_level, scale, noise, balance, layout):
    """Return the frame's code. Raise OutOfRange or UnknownName as `learned` does."""
    balance = check_balance(balance)
    if balance != (1, 1) and not (
        layout.mosaic == ("RG", "GB") and layout.outputs == ("R", "G", "B")
    ):
        raise OutOfRange(
            "balance", balance, "(1, 1) with a table that does not make R, G, B of RG/GB"
        )
    return Code(domain, float(black_level), float(scale), noise, balance)


def _tiles(device, prepared, layout, raw, out, measures, from_black, decoding, shift):
    """Make one pass over tiles, on GPUs."""
    rows, cols = raw.shape
    span, (period_y, period_x) = 2 * layout.box + 1, layout.period
    # low tiles: more groups run at a time, though they compute more of their rims twice
    high = span + 1
    run = 2 if high % 2 == 0 and prepared.terms == 16 else 1
    terms = max(5 * span, 21 + 4 * len(layout.outputs))
    wide = 2 * prepared.reach
    items = next(
        n
        for n in (128, 64, 32)
        if 4 * ((high + wide) * (n + wide) + n * (terms + 2 * high)) <= LOCAL
    )
    strip = (items - 2 * layout.box) // 8 * 8
    across, down = -(-cols // strip), -(-rows // high)
    defines = {
        "ITEMS": items,
        "STRIP": strip,
        "ROWS": high,
        "RUN": run,
        "PERIOD_Y": period_y,
        "PERIOD_X": period_x,
    }
    device.launch(
        TILES,
        "learned_tiles",
        (across * down * items,),
        *(raw, prepared.limits, prepared.knots, prepared.weights, prepared.planes),
        *(prepared.factors, prepared.loss, out),
        *(*measures, *from_black[:2], *decoding[1:], *shift),
        *(rows, cols, across),
        defines=prepared.defines | defines,
        group=(items,),
    )


def _passes(device, prepared, layout, raw, out, measures, from_black, decoding, shift):
    """Make three passes over the frame, on CPUs: `encode`, `classify`, `apply`."""
    rows, cols = raw.shape
    reach, opencl, root = prepared.reach, device.kind == "opencl", prepared.defines["ROOT"]
    stride = -(-(cols + 2 * reach + 8) // 16) * 16
    codes = device.empty((rows + 2 * reach, stride))
    units = device.empty((rows, cols), np.uint16)
    levels = device.empty((rows, cols) if len(layout.levels) > 1 else (1, 1))
    launch = functools.partial(
        device.launch,
        "processor.learned",
        defines=prepared.defines | {"STRIP": 128, "ROWS": 16},
        group=(1, 1) if opencl else None,
    )
    launch(
        "encode",
        (codes.shape[0], 1) if opencl else codes.shape,
        *(raw, prepared.factors, codes),
        *(*from_black[:2], *shift, *layout.period, rows, cols, stride),
        *warp_only(device, reach, root),
    )
    along, high = (128, 16) if opencl else (64, 1)
    launch(
        "classify",
        (-(-rows // high), -(-cols // along)),
        *(codes, prepared.limits, prepared.knots, units, levels),
        *(*measures, *shift, *layout.period, rows, cols, stride),
        *warp_only(device, prepared.filters, reach, layout.box, root),
        *warp_only(device, layout.strengths.shape[1], len(layout.ratios), len(layout.shares)),
        *warp_only(device, along),
    )
    launch(
        "apply",
        (rows, 1 if opencl else cols),
        *(raw, codes, units, levels, prepared.weights, prepared.planes, prepared.loss, out),
        *(*decoding, rows, cols, stride),
        *warp_only(device, prepared.taps, reach, root),
        *warp_only(device, prepared.defines["UNBIASED"], layout.classes, layout.shape[-1]),
    )


class _Prepared:
    """A table on a device, for frames of one code.

    limits: bounds of the strengths, ratios, shares; least: the floor; all as whole numbers.
    weights: shape (levels, positions K, computed, terms), a constant after the groups. planes:
    index of each output at each position. If all positions keep their sample (`defines["KEPT"]`),
    that one is last and has no weights. filters, taps: lists for Warp. factors: of the codes of
    each position. loss: see `root_loss`; if it is given back (`defines["UNBIASED"]`), the place of
    the constant has the missing share.
    """

    def __init__(self, device, table: FilterTable, code: Code):
        layout = table.layout
        filters, offsets, floor, strengths = table.at_noise(code.sigma)
        unit = STEPS[code.domain] * code.white * (2 * layout.box + 1) ** 2
        self.least = int(min(floor * layout.weight / 2 * unit, 2.0**19))
        bounds = np.floor(np.minimum(strengths * layout.weight * unit, 2.0**27))
        self.limits = device.array(
            np.concatenate([bounds, layout.ratios, layout.shares]).astype(np.int32), np.int32
        )
        self.knots = device.array(layout.levels.astype(np.float32))

        contrasts = [*layout.contrast, *(layout.detail or ())]
        self.reach = max(int(abs(layout.taps).max()), max(map(len, contrasts)) // 2 + layout.box)
        levels, positions, classes, outputs, groups = filters.shape
        whole = 16 if device.is_gpu else 8
        self.terms = terms = -(-(groups + 1) // whole) * whole
        weights = np.zeros((*filters.shape[:-1], terms), np.float32)
        weights[..., :groups] = filters
        constant = 0.0 if offsets is None else offsets * code.white
        if code.domain == "linear":  # weights take whole digital numbers there
            counts = np.bincount(layout.groups)
            constant = constant - code.black_level * (
                weights[..., :groups].astype(np.float64) @ counts
            )
        kept = _samples(layout, weights[..., :groups])
        weights[..., :groups], left = _balance(layout, code, weights[..., :groups])
        unbiased = code.domain == "root" and code.noise[0] > 0 and offsets is None
        weights[..., groups] = 1 - left if unbiased else constant
        self.loss = device.array(root_loss(*code.noise) if unbiased else np.zeros(7, np.float32))
        self.factors = device.array(_factors(layout, code).ravel().astype(np.float32))
        planes = np.array(
            [[o for o in range(outputs) if o != own] + [own] * (own is not None) for own in kept]
        )
        computed = outputs - (None not in kept)
        if computed < outputs:
            weights = np.stack(
                [weights[:, p].take(planes[p, :-1], axis=2) for p in range(positions)], axis=1
            )
        else:
            planes = np.tile(np.arange(outputs), (positions, 1))
        self.planes = device.array(planes.astype(np.int32), np.int32)
        self.weights = device.array(weights.reshape(levels, positions * classes, computed, terms))

        order = np.lexsort((layout.taps[:, 1], layout.taps[:, 0], layout.groups))
        taps = np.column_stack([layout.groups, layout.taps])[order]
        wide = np.zeros((len(contrasts), 2 * max(len(c) // 2 for c in contrasts) + 1), np.int32)
        for row, weight in zip(wide, contrasts, strict=True):
            start = (len(row) - len(weight)) // 2
            row[start : start + len(weight)] = weight
        self.taps, self.filters = (
            device.array(taps.astype(np.int32), np.int32),
            device.array(wide, np.int32),
        )
        names = ("DOWN", "ALONG", "DOWN_DETAIL", "ALONG_DETAIL")
        half = wide.shape[1] // 2
        self.defines: dict = {
            name: " ".join(f"F({k - half}, ({weight}))" for k, weight in enumerate(row) if weight)
            for name, row in zip(names, wide, strict=False)
        }
        self.defines |= {
            "TAPS": " ".join("F({}, {}, {})".format(*tap) for tap in taps),
            "ROOT": int(code.domain == "root"),
            "REACH": self.reach,
            "SPAN": 2 * layout.box + 1,
            "BOUNDS": len(bounds),
            "RATIOS": len(layout.ratios),
            "SHARES": len(layout.shares),
            "LEVELS": levels,
            "CLASSES": classes,
            "UNITS": positions * classes,
            "TERMS": terms,
            "CONSTANT": groups,
            "COMPUTED": computed,
            "KEPT": outputs - computed,
            "UNBIASED": int(unbiased),
            "BALANCED": int(code.balance != (1, 1)),
        }


_prepared = functools.lru_cache(maxsize=16)(_Prepared)


def _factors(layout: Layout, code: Code):
    """Return the codes' factors at each position of the mosaic's period, (rows, cols)."""
    return np.array(
        [
            [code.factors.get(letter, 1.0) if code.balance != (1, 1) else 1.0 for letter in text]
            for text in layout.mosaic
        ]
    )


def _balance(layout: Layout, code: Code, filters):
    """Return filters that undo the codes' factors, and the noise that is left.

    filters: shape (L, P, K, outputs, G). The noise is the variance of their results over the code's
    variance, shape (L, P, K, outputs).
    """
    factors = _factors(layout, code)
    rows, cols = layout.period
    weight = filters.astype(np.float64)
    if code.balance != (1, 1):
        weight = weight / np.array([code.factors[name] for name in layout.outputs])[:, None]
    power = np.zeros((layout.positions, filters.shape[-1]))  # of each group's sum
    for p in range(layout.positions):
        for (dy, dx), group in zip(layout.taps + divmod(p, cols), layout.groups, strict=True):
            power[p, group] += factors[dy % rows, dx % cols] ** 2
    return weight, np.einsum("lpkog,pg->lpko", weight**2, power)


def _samples(layout: Layout, filters):
    """Return each position's output that is its own sample in all classes, or None."""
    own = np.flatnonzero((layout.taps == 0).all(axis=1))
    if len(own) != 1 or (layout.groups == layout.groups[own[0]]).sum() != 1:
        return [None] * layout.positions
    unchanged = np.arange(layout.shape[-1]) == layout.groups[own[0]]
    found = []
    for p, letter in enumerate("".join(layout.mosaic)):
        o = layout.outputs.index(letter) if letter in layout.outputs else None
        found.append(None if o is None or (filters[:, p, :, o] != unchanged).any() else o)
    return found


X_TRANS = ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG")


def cases():
    """Yield cases.

    The built-in table, both domains, all phases, with and without noise; random ones: RGBW with
    levels, X-Trans.
    """
    random = np.random.default_rng(8)
    rgbw = _random_table(("RG", "WB"), "XYZ", (0.2, 0.5, 0.9), (1, -2, 1, 0, -1, 2, -1), 2)
    fuji = _random_table(X_TRANS, "RGB", (0.0,), (1, 0, 0, 0, 0, 0, -1), 3)
    for domain, noise in (("linear", (0.0, 0.0)), ("root", (0.0, 0.0)), ("root", (9.0, 14.0))):
        for size in ((2, 2), (3, 5), (38, 131)):
            ramp = np.add.outer(29 * np.arange(size[0]), 11 * np.arange(size[1])) % 3000
            raw = (ramp + random.integers(0, 1000, size)).astype(np.uint16)
            raw.flat[0], raw.flat[-1] = 0, 4095
            options = {"domain": domain, "noise": noise}
            for phase in RED:
                name = f"{domain} {noise} {phase} {size[0]}x{size[1]}"
                yield _case(name, raw, bayer_table(), phase=phase, **options)
            if size[0] > 2 and domain == "root":
                name = f"balanced {noise} {size[0]}x{size[1]}"
                options["balance"] = (1.9, 3.7)
                yield _case(name, raw, bayer_table(), phase=phase, **options)
    noisy = {"domain": "root", "noise": (9.0, 14.0)}
    plain = _random_table(("RG", "GB"), "RGB", (0.2, 0.9), (1, 0, -2, 0, 1), 1, False)
    yield _case("no constant, levels", raw, plain, phase="GBRG", **noisy, balance=(0.6, 2.5))
    yield _case("RGBW", raw, rgbw, phase=("WB", "RG"), **noisy)
    yield _case("X-Trans", raw, fuji, phase=X_TRANS, domain="linear", noise=(0.0, 0.0))


def _random_table(mosaic, outputs, levels, contrast, box, constant=True):
    """Filters without meaning, of all samples up to 3 pixels away."""
    random = np.random.default_rng(9)
    dy, dx = np.mgrid[-3:4, -3:4]
    taps = np.stack([dy, dx], axis=-1)[abs(dy) + abs(dx) <= 3]
    layout = Layout(
        *(mosaic, tuple(outputs), "root", taps, np.arange(len(taps)), (contrast, contrast)),
        *(box, (12, 24), [0.0], [0.01], [[0.05, 0.2]], levels),
    )
    filters = random.normal(0.04, 0.1, layout.shape)
    offsets = random.normal(0, 0.1, layout.shape[:-1]) if constant else None
    return FilterTable(layout, filters, offsets)


def _case(name, raw, table, black_level=64.3, scale=1 / 4000, **options):
    """Return a case; its tolerance is all roundings of the largest sum of a filter of the table."""
    from gpusim.kernels.processor.learned_ref import learned as reference

    balance = options.get("balance", (1.0, 1.0))
    code = Code(options["domain"], black_level, scale, options["noise"], balance)
    inputs = {"raw": raw, "black_level": black_level, "scale": scale, "table": table, **options}
    taps = np.bincount(table.layout.groups)
    strongest = np.abs(code.encode_raw(raw)).max() + code.black_level
    largest = (np.abs(table.filters) @ taps).max() * strongest / min(code.factors.values())
    roundings = len(taps) + 12 + 3 * (np.diff(table.layout.levels) ** -1.0).max(initial=0.0)
    peak = np.abs(reference(**inputs)).max() / scale
    slope = 1.0 if code.domain == "linear" else 2 * np.sqrt(peak + code.offset)
    return Case(
        name,
        inputs,
        roundings * 2.0**-24 * largest * slope / peak,
        "a product and a sum for each group, the constant, weights and black level in float32, the decoding, "
        "and four for the loss of the square, which is smaller than that: 2^-24 each of the largest sum of "
        "absolute products, times the slope of the square; the place between two levels has three roundings "
        "more, divided by their distance. Codes' sums and classes are exact",
    )


def bench(rows, cols):
    """Return inputs: a 10-bit Bayer mosaic of ramps, edges and noise."""
    random = np.random.default_rng(3)
    y, x = np.mgrid[:rows, :cols]
    raw = 300 + 200 * np.sin(x / 37) * np.cos(y / 23) + 150 * ((x + 2 * y) // 60 % 2)
    raw += random.normal(0, 8, (rows, cols))
    return {"raw": raw.astype(np.uint16), "phase": "RGGB", "black_level": 64.0, "scale": 1 / 959}

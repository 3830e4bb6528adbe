"""Filters chosen on a first picture: what they keep, their files, their training, and noise."""

import numpy as np
import pytest
from devices import ALL_KINDS

from gpusim.apps.l3.channels import channel_mix
from gpusim.apps.l3.guided import COARSE, Training, train
from gpusim.apps.l3.photographs import decode_srgb, encode_srgb, sample_mosaic
from gpusim.data.charts import chart
from gpusim.domain.errors import BadData, BadFile, OutOfRange, UnknownName
from gpusim.domain.guided import (
    BUILT_IN,
    FINEST,
    FINEST_FIRST,
    GuidedTable,
    built_in_name,
    channels_of,
    round_filters,
)
from gpusim.domain.mosaics import MOSAICS
from gpusim.io.camera.guided import guided_table, read_guided, write_guided
from gpusim.kernels.processor.guided import guided
from gpusim.kernels.processor.interpolate import interpolate

ROLLS = [(1, 0), (2, 3), (3, 3)]
# all tables on one device, three and four channels on all
ON_DEVICES = [
    pytest.param(name, *getattr(device, "values", (device,)), marks=getattr(device, "marks", ()))
    for name in BUILT_IN
    for device in (ALL_KINDS if name in ("x-trans", "rgbw") else ["opencl"])
]


def rolled(mosaic, down, right):
    """The mosaic that begins some pixels further down and right."""
    rows, cols = len(mosaic), len(mosaic[0])
    return tuple(
        "".join(mosaic[(y + down) % rows][(x + right) % cols] for x in range(cols))
        for y in range(rows)
    )


def picture(rows, cols, mosaic=("RG", "GB")):
    """Coloured discs in the channels of a mosaic, 0 .. 255 in sRGB's encoding: no chart that was trained on."""
    content = chart(
        "deadleaves", size=(cols, rows), wavelengths=[450.0, 540.0, 610.0], seed=100
    ).content
    planes = content.bands_at(slice(None))[::-1]
    return 255 * encode_srgb(np.tensordot(channel_mix(mosaic)[0], planes / planes.max(), 1))


def numbers(planes, mosaic):
    return np.rint(sample_mosaic(planes, mosaic, channels_of(mosaic))).astype(np.uint16)


def places(mosaic):
    """The channel of each pixel of a period, in the order of a table."""
    return np.array([[channels_of(mosaic).index(letter) for letter in text] for text in mosaic])


@pytest.mark.parametrize(("name", "device"), ON_DEVICES)
def test_flat_fields_stay_flat(name, device):
    """Of any colour, at any size from a period on, balanced or not.

    First pictures are exact. Then one product for each term of weights whose absolute sum the table has, rounded to
    2^-24 each on the way, of codes up to 2^16 steps of 1, and for roots a rounding by half a step of 2^-15 of white at
    most; squared.
    """
    table = guided_table(name)
    largest = abs(table.second).sum(axis=-1).max() / FINEST
    bound = 2 * ((table.second.shape[-1] + 3) * largest * 2.0**-24 + 2.0**-14)
    mosaic = MOSAICS[name]
    letters = channels_of(mosaic)
    levels = np.array((700, 1900, 400, 1200))[: len(letters)]
    balanced = {letters[0]: 2.7, letters[-1]: 4.75}
    for shape in ((len(mosaic), len(mosaic)), (7, 23), (33, 38)):
        planes = np.broadcast_to(levels[:, None, None], (len(levels), *shape))
        raw = numbers(planes, mosaic)
        options = {"phase": mosaic, "black_level": 64.0, "scale": 1 / 2000, "device": device}
        for domain, balance in (("linear", {}), ("root", None), ("root", balanced)):
            out = guided(raw, **options, table=table, domain=domain, balance=balance)
            wanted = np.broadcast_to((levels[:, None, None] - 64) / 2000, out.shape)
            np.testing.assert_allclose(out, wanted, rtol=bound)


@pytest.mark.parametrize(("name", "device"), ON_DEVICES)
def test_phases_are_shifts(name, device):
    """A frame that begins elsewhere has the same picture, as far as no filter reaches its border.

    On NumPy, sums may have another order.
    """
    table, mosaic = guided_table(name), MOSAICS[name]
    raw = numbers(10 * picture(40, 46, mosaic), mosaic)
    options = {"black_level": 0.0, "scale": 1 / 2550, "noise": (9.0, 14.0), "table": table}
    whole = guided(raw, phase=mosaic, **options, device=device)
    reach = sum(table.reach)
    for down, right in ROLLS:
        part = guided(
            raw[down:, right:].copy(), phase=rolled(mosaic, down, right), **options, device=device
        )
        inner = np.s_[:, reach:-reach, reach:-reach]
        np.testing.assert_allclose(
            part[inner],
            whole[:, down:, right:][inner],
            rtol=0,
            atol=1e-12 if device == "numpy" else 0,
        )


@pytest.mark.parametrize("name", BUILT_IN)
def test_samples_are_kept_without_noise(name):
    """A product by 1 and others by 0 are exact, scaling by a power of 2 too."""
    mosaic = MOSAICS[name]
    raw = np.random.default_rng(1).integers(0, 1024, (30, 30), np.uint16)
    out = guided(
        raw,
        phase=mosaic,
        black_level=0.0,
        scale=1 / 1024,
        domain="linear",
        table=guided_table(name),
        device="opencl",
    )
    kept = np.array(
        [out[places(mosaic)[y % len(mosaic), x % len(mosaic)], y, x] for y, x in np.ndindex(30, 30)]
    )
    np.testing.assert_array_equal(kept, raw.ravel() / 1024)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_chart_comes_out_better_than_by_weighted_means(name):
    """Dead leaves have no correlation of colours beyond each disc: by far the least that filters gain."""
    mosaic = MOSAICS[name]
    planes = picture(120, 140, mosaic)
    raw, cfa = numbers(planes, mosaic), places(mosaic)
    options = {"black_level": 0.0, "scale": 1 / 255, "device": "opencl"}
    ours = guided(raw, phase=mosaic, domain="linear", table=guided_table(name), **options)
    theirs = interpolate(raw, cfa=cfa, **options)
    errors = [
        np.mean((np.clip(out, 0, 1) - planes / 255)[:, 10:-10, 10:-10] ** 2)
        for out in (ours, theirs)
    ]
    assert errors[0] < errors[1]


@pytest.mark.parametrize(
    ("name", "electrons", "balance"),
    [(name, 4.0, (0.5, 2.0)) for name in BUILT_IN]
    + [(name, 4.0, (1.0, 1.0)) for name in ("x-trans", "rgbw-kodak")]
    + [(name, 40.0, pair) for name in ("x-trans", "rgbw") for pair in ((1.0, 1.0), (0.5, 2.0))],
)
def test_the_dark_is_not_darker(name, electrons, balance):
    """Means of flat fields with shot and read noise, within 2 % and three standard errors.

    The first channel has twice, the third half of the others' electrons. A mean over all pixels has the samples'
    scatter at least: the rarest channel has its share of the pixels.
    """
    size, gain, read, black, white = 240, 8.0, 2.0, 500.0, 400.0
    mosaic, random = MOSAICS[name], np.random.default_rng(3)
    letters = channels_of(mosaic)
    counts = electrons * np.array((2.0, 1.0, 0.5, 1.0))[: len(letters)]
    planes = np.broadcast_to(counts[:, None, None], (len(letters), size, size))
    mean = sample_mosaic(planes, mosaic, letters)
    field = random.poisson(mean) + random.normal(0, read, mean.shape)
    raw = np.clip(np.rint(black + gain * field), 0, 65535).astype(np.uint16)
    out = white * guided(
        raw,
        phase=mosaic,
        black_level=black,
        scale=1 / (gain * white),
        noise=(gain, gain * read),
        balance=dict(zip((letters[0], letters[-1]), balance, strict=True)),
        table=guided_table(name),
        device="opencl",
    )
    rarest = min(map("".join(mosaic).count, letters)) / len("".join(mosaic))
    sigma = np.sqrt((counts + read**2) / (size**2 * rarest))
    assert (abs(out.mean(axis=(1, 2)) - counts) < 0.02 * counts + 3 * sigma).all()


def test_symmetries_map_samples_to_samples():
    """A term of one channel becomes a term of the channel that takes its place, once each.

    Four channels at the pixels of 2 x 2 have mirror images only, which exchange the diagonals: of 3 classes of them
    2 are left.
    """
    for name in BUILT_IN:
        table = guided_table(name)
        orbits, colors = table.orbits, table.term_colors
        assert orbits.count <= table.positions * orbits.classes * 2 / 3
        for cell in range(0, len(orbits.of), 7):
            terms, channels = orbits.terms[cell], orbits.channels[cell]
            assert sorted(terms) == list(range(len(terms)))
            at = orbits.positions[orbits.of[cell]]
            own = colors[cell // orbits.classes]
            np.testing.assert_array_equal(colors[at][terms][:, channels], own)


def test_rounded_filters_keep_flat_fields():
    random = np.random.default_rng(5)
    table = guided_table("x-trans")
    colors = table.colors(0)
    weights = random.normal(size=(table.positions, 3, colors.shape[1])) * 100
    for c in range(3):
        mask = colors[:, None, :, c]
        left = FINEST_FIRST * (np.arange(3) == c)[:, None] - (weights * mask).sum(-1, keepdims=True)
        weights += mask * left / mask.sum(-1, keepdims=True)
    whole = round_filters(weights, colors)
    sums = np.einsum("pot,ptc->poc", whole, colors)
    np.testing.assert_array_equal(sums, np.broadcast_to(FINEST_FIRST * np.eye(3), sums.shape))
    # a half for each rounding, and at most half of all taps' for the one that takes the rest
    assert np.abs(whole - weights).max() <= colors.shape[1] / 2


def test_training_finds_filters_for_its_pictures():
    """On two charts: better than weighted means there, samples kept, and the sources named."""
    pictures = [np.moveaxis(np.rint(picture(90, 96)), 0, 2)] * 2
    table = train(MOSAICS["quad-bayer"], pictures, ["one", "two"], noise=(0.0,), blurs=(0.0,))
    assert "one" in table.provenance and table.second.shape[0] == 1
    planes = np.moveaxis(pictures[0], 2, 0)
    raw = numbers(planes, table.mosaic)
    options = {"black_level": 0.0, "scale": 1 / 255, "device": "opencl"}
    ours = guided(raw, phase=table.mosaic, domain="linear", table=table, **options)
    cfa = np.array([["RGB".index(letter) for letter in text] for text in table.mosaic])
    theirs = interpolate(raw, cfa=cfa, **options)
    inner = np.s_[:, 12:-12, 12:-12]
    errors = [np.mean((out - planes / 255)[inner] ** 2) for out in (ours, theirs)]
    assert errors[0] < errors[1] / 2  # 3 dB


def test_training_counts_noise_in_the_channels_shares():
    """A near-infrared pixel of the phone has less electrons than a green one, and in each picture another content."""
    planes = picture(80, 84)
    made = Training(MOSAICS["rgbn"], COARSE, noise=(0.0, 0.04), blurs=(0.0,))
    quiet, noisy = made.frames(np.moveaxis(planes, 0, 2), 0)
    raw, wanted, code, level, _ = noisy
    assert (level, made.table.channels, made.table.guide) == (1, tuple("RGBN"), 1)
    assert code.sigma == pytest.approx(0.04, rel=0.01)
    shares = dict(zip(made.table.channels, made.response, strict=True))
    np.testing.assert_allclose([code.signals[k] * shares[k] for k in "RGBN"], 1)
    # electrons of near-infrared pixels against what was drawn for them: shot noise of about 2,000 pixels
    light = decode_srgb(quiet[1][3])[1::2, ::2]
    electrons = light * shares["N"] / code.scale
    aimed = code.decode(wanted[3] * code.white / code.factors["N"])[1::2, ::2]
    np.testing.assert_allclose(aimed, electrons, rtol=1e-5)
    near = raw[1::2, ::2]
    assert abs(near.mean() / electrons.mean() - 1) < 4 / np.sqrt(near.sum())
    other = next(made.frames(np.moveaxis(planes, 0, 2), 3))
    assert abs(other[1][3] - quiet[1][3]).max() > 0.1
    np.testing.assert_array_equal(other[1][:3], quiet[1][:3])


def test_planes_come_in_the_order_that_is_asked_for():
    mosaic = MOSAICS["rgbw"]
    raw = numbers(10 * picture(20, 24, mosaic), mosaic)
    options = {"phase": mosaic, "black_level": 0.0, "scale": 1 / 2550, "noise": (9.0, 14.0)}
    options |= {"table": guided_table("rgbw"), "device": "opencl", "balance": {"R": 2.0}}
    planes = guided(raw, **options)
    np.testing.assert_array_equal(guided(raw, **options, channels="WBRG"), planes[[3, 2, 0, 1]])


@pytest.mark.parametrize("name", BUILT_IN)
def test_results_are_continuous_as_noise_goes_to_0(name):
    """A thousandth of the noise of the first level moves the filters a thousandth as far.

    Some pixels take the filter of another class as well, because bounds move too: ten times as much is allowed.
    """
    mosaic, table = MOSAICS[name], guided_table(name)
    raw = numbers(200 * picture(40, 48, mosaic), mosaic)
    options = {"phase": mosaic, "black_level": 0.0, "scale": 1 / 51000, "table": table}

    def moved(part):
        deviation = (
            part * table.noise[1]
        )  # of roots relative to white's: gain = 4 deviation^2 white
        noise = (4 * deviation**2 * 51000, 0.0)
        still = guided(raw, **options, device="opencl")
        return abs(guided(raw, **options, noise=noise, device="opencl") - still).mean()

    assert moved(1e-3) < moved(1.0) / 100


def test_files_come_back_as_they_were(tmp_path):
    table = guided_table("quad-bayer")
    write_guided(tmp_path / "t.npz", table)
    back = read_guided(tmp_path / "t.npz")
    for name in ("mosaic", "radii", "box", "provenance"):
        assert getattr(back, name) == getattr(table, name)
    for name in ("ratios", "diagonals", "noise", "floor", "strengths", "first", "second"):
        np.testing.assert_array_equal(getattr(back, name), getattr(table, name))


def test_built_in_tables_say_where_they_come_from():
    for name in BUILT_IN:
        assert "photographs" in guided_table(name).provenance
        assert guided_table(name).mosaic == MOSAICS[name]


def test_noise_levels_are_interpolated():
    table = guided_table("x-trans")
    low, high = table.noise[2:4]
    found = [table.at_noise(sigma)[1] for sigma in (low, (low + high) / 2, high)]
    np.testing.assert_allclose(found[1], (found[0] + found[2]) / 2, atol=1e-12)
    np.testing.assert_array_equal(table.at_noise(9.0)[1], table.at_noise(table.noise[-1])[1])


def test_names_are_found_for_any_shift():
    assert built_in_name(rolled(MOSAICS["x-trans"], 3, 1)) == "x-trans"
    assert built_in_name(rolled(MOSAICS["quad-bayer"], 1, 2)) == "quad-bayer"
    assert built_in_name(rolled(MOSAICS["rgbn-4x4"], 1, 2)) == "rgbn-4x4"
    for other in ("bayer-rggb", "rccb", "mono"):
        assert built_in_name(MOSAICS[other]) is None


def test_wrong_input_is_refused(tmp_path):
    table = guided_table("x-trans")
    raw = np.zeros((12, 12), np.uint16)
    options = {"phase": table.mosaic, "black_level": 0.0, "scale": 1.0, "device": "opencl"}
    with pytest.raises(UnknownName, match="GGRGGB"):
        guided(raw, **{**options, "phase": MOSAICS["quad-bayer"]}, table=table)
    with pytest.raises(BadData, match="at least 6x6"):
        guided(raw[:5], **options, table=table)
    with pytest.raises(OutOfRange, match="balance of R"):
        guided(raw, **options, table=table, balance={"R": 0.0})
    with pytest.raises(OutOfRange, match="encoded data are balanced"):
        guided(raw, **options, table=table, balance={"R": 2.0}, domain="linear")
    with pytest.raises(UnknownName, match="balance"):
        guided(raw, **options, table=table, balance={"W": 1.0})
    with pytest.raises(BadData, match="wanted R, G, B in any order"):
        guided(raw, **options, table=table, channels="RGW")
    with pytest.raises(UnknownName, match="x-trans"):
        guided_table("mono")
    fields = {name: getattr(table, name) for name in GuidedTable.__dataclass_fields__}
    darker, wild = (np.array(table.first) for _ in range(2))
    darker[0, 0, 0, 0] += 1
    own = np.flatnonzero(table.colors(0)[0].any(axis=1))[:1]
    wild[0, 0, 0, own] += 10**5
    for wrong in (
        {"mosaic": ("RG", "WB")},
        {"mosaic": ("RGBW", "YCME")},
        {"mosaic": ("RG", "GQ")},
        {"floor": table.floor[:1]},
        {"first": darker},
        {"first": wild},
        {"second": table.second[:, :5]},
    ):
        with pytest.raises(BadData):
            GuidedTable(**{**fields, **wrong})
    for content in (b"", b"no archive"):
        (tmp_path / "bad.npz").write_bytes(content)
        with pytest.raises(BadFile):
            read_guided(tmp_path / "bad.npz")
    np.savez(tmp_path / "other.npz", cube=np.ones(3))
    with pytest.raises(BadFile, match="lacks"):
        read_guided(tmp_path / "other.npz")

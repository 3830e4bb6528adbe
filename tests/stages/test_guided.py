"""Filters chosen on a first picture: what they keep, their files, their training, and noise."""

import numpy as np
import pytest
from devices import ALL_KINDS

from gpusim.apps.l3.guided import train
from gpusim.apps.l3.photographs import encode_srgb, sample_mosaic
from gpusim.data.charts import chart
from gpusim.domain.errors import BadData, BadFile, OutOfRange, UnknownName
from gpusim.domain.guided import (
    BUILT_IN,
    COLORS,
    FINEST_FIRST,
    GuidedTable,
    built_in_name,
    round_filters,
)
from gpusim.domain.mosaics import MOSAICS
from gpusim.io.camera.guided import guided_table, read_guided, write_guided
from gpusim.kernels.processor.guided import guided
from gpusim.kernels.processor.interpolate import interpolate

ROLLS = [(1, 0), (2, 3)]


def rolled(mosaic, down, right):
    """The mosaic that begins some pixels further down and right."""
    rows, cols = len(mosaic), len(mosaic[0])
    return tuple(
        "".join(mosaic[(y + down) % rows][(x + right) % cols] for x in range(cols))
        for y in range(rows)
    )


def picture(rows, cols):
    """Coloured discs, 0 .. 255 in sRGB, (3, rows, cols): no chart that was trained on."""
    content = chart(
        "deadleaves", size=(cols, rows), wavelengths=[450.0, 540.0, 610.0], seed=100
    ).content
    planes = content.bands_at(slice(None))[::-1]
    return 255 * encode_srgb(planes / planes.max())


def numbers(planes, mosaic):
    return np.rint(sample_mosaic(planes, mosaic)).astype(np.uint16)


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("device", ALL_KINDS)
def test_flat_fields_stay_flat(name, device):
    """Of any colour, at any size from a period on, balanced or not.

    First pictures are exact. Then 80 products of weights whose absolute sum is below 8, rounded to 2^-24 each on the
    way, of codes up to 2^16 steps of 1, and for roots a rounding by half a step of 2^-15 of white at most; squared.
    """
    mosaic = MOSAICS[name]
    levels = np.array((700, 1900, 400))
    for shape in ((len(mosaic), len(mosaic)), (7, 23), (33, 38)):
        planes = np.broadcast_to(levels[:, None, None], (3, *shape))
        raw = numbers(planes, mosaic)
        options = {"phase": mosaic, "black_level": 64.0, "scale": 1 / 2000, "device": device}
        for domain, balance in (("linear", (1, 1)), ("root", (1, 1)), ("root", (2.7, 4.75))):
            out = guided(raw, **options, table=guided_table(name), domain=domain, balance=balance)
            wanted = np.broadcast_to((levels[:, None, None] - 64) / 2000, out.shape)
            np.testing.assert_allclose(out, wanted, rtol=2 * (83 * 8 * 2.0**-24 + 2.0**-14))


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("device", ALL_KINDS)
def test_phases_are_shifts(name, device):
    """A frame that begins elsewhere has the same picture, as far as no filter reaches its border.

    On NumPy, sums may have another order.
    """
    table, mosaic = guided_table(name), MOSAICS[name]
    raw = numbers(10 * picture(40, 46), mosaic)
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
        [
            out["RGB".index(mosaic[y % len(mosaic)][x % len(mosaic)]), y, x]
            for y, x in np.ndindex(30, 30)
        ]
    )
    np.testing.assert_array_equal(kept, raw.ravel() / 1024)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_chart_comes_out_better_than_by_weighted_means(name):
    """Dead leaves have no correlation of colours beyond each disc: by far the least that filters gain."""
    planes, mosaic = picture(120, 140), MOSAICS[name]
    raw = numbers(planes, mosaic)
    cfa = np.array([["RGB".index(letter) for letter in text] for text in mosaic])
    options = {"black_level": 0.0, "scale": 1 / 255, "device": "opencl"}
    ours = guided(raw, phase=mosaic, domain="linear", table=guided_table(name), **options)
    theirs = interpolate(raw, cfa=cfa, **options)
    errors = [
        np.mean((np.clip(out, 0, 1) - planes / 255)[:, 10:-10, 10:-10] ** 2)
        for out in (ours, theirs)
    ]
    assert errors[0] < errors[1]


@pytest.mark.parametrize("name", BUILT_IN)
@pytest.mark.parametrize("electrons", [4.0, 40.0])
@pytest.mark.parametrize("balance", [(1.0, 1.0), (0.5, 2.0)])
def test_the_dark_is_not_darker(name, electrons, balance):
    """Means of flat fields with shot and read noise, within 2 % and three standard errors.

    Red has twice, blue half of green's electrons. A mean over all pixels has the samples' scatter at least: red has
    2 / 9 of the pixels of an X-Trans mosaic and 1 / 4 of a quad-Bayer's.
    """
    size, gain, read, black, white = 240, 8.0, 2.0, 500.0, 400.0
    counts = electrons * np.array((2.0, 1.0, 0.5))
    mosaic, random = MOSAICS[name], np.random.default_rng(3)
    mean = sample_mosaic(np.broadcast_to(counts[:, None, None], (3, size, size)), mosaic)
    field = random.poisson(mean) + random.normal(0, read, mean.shape)
    raw = np.clip(np.rint(black + gain * field), 0, 65535).astype(np.uint16)
    out = white * guided(
        raw,
        phase=mosaic,
        black_level=black,
        scale=1 / (gain * white),
        noise=(gain, gain * read),
        balance=balance,
        table=guided_table(name),
        device="opencl",
    )
    sigma = np.sqrt((counts + read**2) / (size**2 * 2 / 9))
    assert (abs(out.mean(axis=(1, 2)) - counts) < 0.02 * counts + 3 * sigma).all()


def test_symmetries_map_samples_to_samples():
    """A term of one colour becomes a term of the colour that takes its place, once each."""
    for name in BUILT_IN:
        table = guided_table(name)
        orbits, colors = table.orbits, table.term_colors
        assert orbits.count < table.positions * orbits.classes / 8
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
    for other in ("bayer-rggb", "nona-bayer", "rgbw", "mono"):
        assert built_in_name(MOSAICS[other]) is None


def test_wrong_input_is_refused(tmp_path):
    table = guided_table("x-trans")
    raw = np.zeros((12, 12), np.uint16)
    options = {"phase": table.mosaic, "black_level": 0.0, "scale": 1.0, "device": "opencl"}
    with pytest.raises(UnknownName, match="GGRGGB"):
        guided(raw, **{**options, "phase": MOSAICS["quad-bayer"]}, table=table)
    with pytest.raises(BadData, match="at least 6x6"):
        guided(raw[:5], **options, table=table)
    with pytest.raises(OutOfRange, match="balance"):
        guided(raw, **options, table=table, balance=(0.0, 1.0))
    with pytest.raises(UnknownName, match="x-trans"):
        guided_table("rgbw")
    fields = {name: getattr(table, name) for name in GuidedTable.__dataclass_fields__}
    darker, wild = (np.array(table.first) for _ in range(2))
    darker[0, 0, 0, 0] += 1
    own = np.flatnonzero(table.colors(0)[0].any(axis=1))[:1]
    wild[0, 0, 0, own] += 10**5
    for wrong in (
        {"mosaic": ("RG", "WB")},
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
    assert set("".join(table.mosaic)) == set(COLORS)

"""Binning: which pixels are added in which mosaic, what is conserved, and how numbers round."""

from fractions import Fraction

import numpy as np
import pytest
from devices import ALL, ALL_KINDS, DEVICES

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.mosaics import bin_mosaic, shortest_period
from gpusim.kernels.sensor.bin import bin, binned_shape


def mosaic(*rows):
    return np.array([["RGBWXY".index(letter) for letter in row] for row in rows], np.int32)


BAYER = mosaic("RG", "GB")
QUAD = mosaic("RRGG", "RRGG", "GGBB", "GGBB")
XTRANS = mosaic("GBGGRG", "RGRBGB", "GBGGRG", "GRGGBG", "BGBRGR", "GRGGBG")
RGBW = mosaic("RWGW", "WRWG", "GWBW", "WGWB")
MONO = mosaic("R")
STRIPES = mosaic("RGB")
MOSAICS = {
    "bayer": BAYER,
    "quad": QUAD,
    "xtrans": XTRANS,
    "rgbw": RGBW,
    "mono": MONO,
    "stripes": STRIPES,
}


def painted(cfa, rows, cols):
    """The mosaic repeated over a frame."""
    return np.tile(cfa, (rows // len(cfa) + 1, cols // len(cfa[0]) + 1))[:rows, :cols]


def test_cells_of_one_colour_become_pixels_of_the_coarse_mosaic():
    for cfa, binning, coarse in (
        (QUAD, (2, 2), BAYER),
        (np.repeat(np.repeat(XTRANS, 3, 0), 2, 1), (3, 2), XTRANS),
        (QUAD, (2, 1), mosaic("RRGG", "GGBB")),
        (MONO, (3, 5), MONO),
        (np.zeros((2, 2), int), (3, 3), MONO),
        (STRIPES, (4, 1), STRIPES),
    ):
        stride, new = bin_mosaic(cfa, binning)
        assert stride == (1, 1)
        assert new.tolist() == coarse.tolist()


def test_other_mosaics_stay_and_their_period_is_the_stride():
    for cfa, binning, stride in (
        (BAYER, (2, 2), (2, 2)),
        (BAYER, (3, 3), (2, 2)),
        (XTRANS, (2, 2), (6, 6)),
        (QUAD, (3, 3), (4, 4)),
        (RGBW, (2, 2), (4, 4)),
        (STRIPES, (2, 2), (1, 3)),
        (np.tile(BAYER, (2, 4)), (2, 2), (2, 2)),
    ):
        found, new = bin_mosaic(cfa, binning)
        assert found == stride
        assert new.tolist() == shortest_period(cfa).tolist()


@pytest.mark.parametrize("binning", [(1, 1), (2, 2), (3, 3), (2, 1), (1, 3), (4, 2)])
@pytest.mark.parametrize("name", MOSAICS)
def test_a_binned_pixel_holds_the_light_of_its_own_colour_alone(name, binning):
    """Every pixel has a number for its colour: any other colour in a sum would change it."""
    cfa = MOSAICS[name]
    stride, new = bin_mosaic(cfa, binning)
    rows, cols = (3 * factor * step - 1 for factor, step in zip(binning, stride, strict=True))
    colors = 7.0 ** painted(cfa, rows, cols)
    result = bin(colors.astype(np.float32), binning=binning, stride=stride, device="numpy")
    assert result.shape == (2 * stride[0], 2 * stride[1])
    np.testing.assert_array_equal(
        result, binning[0] * binning[1] * 7.0 ** painted(new, *result.shape)
    )


def brute(pixels, binning, stride):
    """Sums, output pixel after output pixel, from the issue's words; whole numbers."""
    (by, bx), (sy, sx) = binning, stride
    rows, cols = (n // (b * s) * s for n, b, s in zip(pixels.shape, binning, stride, strict=True))
    out = np.zeros((rows, cols), int)
    for y, x in np.ndindex(rows, cols):
        for j, i in np.ndindex(by, bx):
            out[y, x] += int(
                pixels[y // sy * sy * by + y % sy + sy * j, x // sx * sx * bx + x % sx + sx * i]
            )
    return out


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(("rows", "cols"), [(12, 24), (13, 25), (47, 35), (12, 31)])
def test_odd_sizes_leave_the_rest_out(rows, cols, device):
    """Against a plain loop; charges are whole numbers below 2^24, so their sums are exact in any order."""
    random = np.random.default_rng(rows)
    for binning, stride in (
        ((2, 2), (2, 2)),
        ((3, 3), (2, 2)),
        ((2, 2), (1, 1)),
        ((2, 2), (6, 6)),
        ((5, 2), (3, 2)),
    ):
        pixels = random.integers(0, 65536, (rows, cols), np.uint16)
        if rows < binning[0] * stride[0] or cols < binning[1] * stride[1]:
            continue  # less than a block: another test
        wanted = brute(pixels, binning, stride)
        inputs = {"binning": binning, "stride": stride, "device": device}
        charges = bin(pixels.astype(np.float32), **inputs)
        sums = bin(pixels, **inputs)
        assert (charges.dtype, sums.dtype) == (np.float32, np.uint16)
        np.testing.assert_array_equal(charges, wanted)
        np.testing.assert_array_equal(sums, np.minimum(wanted, 65535))


@pytest.mark.parametrize("device", ALL_KINDS)
def test_all_phases_by_mirror_images(device):
    """A mirrored frame has a mirrored mosaic and must give the mirrored result; whole numbers, so the order is free."""
    frame = np.random.default_rng(1).integers(0, 4096, (24, 36)).astype(np.float32)
    for binning, stride in (((2, 2), (2, 2)), ((3, 3), (2, 2)), ((3, 2), (2, 6)), ((2, 2), (1, 1))):
        result = bin(frame, binning=binning, stride=stride, device=device)
        for axes in ((0,), (1,), (0, 1)):
            mirrored = bin(np.flip(frame, axes), binning=binning, stride=stride, device=device)
            np.testing.assert_array_equal(np.flip(mirrored, axes), result)
    turned = bin(frame.T, binning=(2, 2), stride=(2, 2), device=device)
    np.testing.assert_array_equal(
        turned.T, bin(frame, binning=(2, 2), stride=(2, 2), device=device)
    )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_charge_is_conserved(device):
    charges = np.random.default_rng(2).uniform(0, 1e4, (96, 120)).astype(np.float32)
    for binning, stride in (
        ((2, 2), (2, 2)),
        ((3, 3), (2, 2)),
        ((8, 2), (1, 1)),
        ((2, 2), (6, 6)),
        ((4, 3), (4, 2)),
    ):
        result = bin(charges, binning=binning, stride=stride, device=device)
        assert result.size * binning[0] * binning[1] == charges.size
        # by - 1 and bx - 1 additions of positive numbers, each rounds by half an ulp
        bound = (sum(binning) - 2) * 2.0**-24
        assert np.float64(result).sum() == pytest.approx(np.float64(charges).sum(), rel=bound)


def test_charges_have_the_same_bits_everywhere_and_those_of_their_order():
    """Magnitudes so far apart that another order would round otherwise; the last one is worked out by hand."""
    random = np.random.default_rng(3)
    charges = (10.0 ** random.uniform(-6, 6, (96, 4096 + 96))).astype(np.float32)
    for binning, stride in (((2, 2), (2, 2)), ((3, 3), (2, 2)), ((4, 2), (1, 1)), ((2, 2), (6, 6))):
        wanted = bin(charges, binning=binning, stride=stride, device="numpy")
        assert wanted.dtype == np.float32
        for device in DEVICES:
            result = bin(charges, binning=binning, stride=stride, device=device)
            np.testing.assert_array_equal(result.view(np.uint32), wanted.view(np.uint32))
    # columns first: 2^24 + 1 = 2^24 twice (halves to even), so 2^25; along the rows first 2^25 + 2
    hand = np.array([[2**24, 2**24], [1, 1]], np.float32)
    for device in ALL:
        assert bin(hand, binning=(2, 2), device=device).tolist() == [[2.0**25]]


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("binning", [(1, 2), (2, 2), (3, 2), (5, 2), (7, 7), (7, 8), (8, 8)])
def test_means_round_to_nearest_halves_to_even(binning, device):
    """m of n pixels one higher than the others, m = 0 .. n, at both ends of 16 bits: exact fractions decide."""
    n = binning[0] * binning[1]
    for low in (0, 1, 32767, 65533, 65534):
        blocks = low + (np.arange(n)[None] < np.arange(n + 1)[:, None])  # (n + 1, n)
        frame = (
            blocks.reshape(n + 1, *binning)
            .transpose(1, 0, 2)
            .reshape(binning[0], -1)
            .astype(np.uint16)
        )
        wanted = [
            round(low + Fraction(m, n)) for m in range(n + 1)
        ]  # Python's round: halves to even
        assert bin(frame, binning=binning, average=True, device=device).tolist() == [wanted]


@pytest.mark.parametrize("device", ALL_KINDS)
def test_means_of_numbers_have_no_bias(device):
    numbers = np.random.default_rng(4).integers(0, 1024, (1024, 1024), np.uint16)
    error = (
        bin(numbers, binning=(2, 2), stride=(2, 2), average=True, device=device).mean()
        - numbers.mean()
    )
    # quarters round by 0, -1/4, +-1/2, 1/4: variance 3/32 each; five sigma. Halves upward would be off by 1/8.
    assert abs(error) < 5 * np.sqrt(3 / 32 / (numbers.size / 4))


@pytest.mark.parametrize("device", ALL_KINDS)
def test_sums_of_numbers_stop_at_the_largest(device):
    frame = np.array(
        [[16383, 16384, 16384, 16384, 65535, 65535], [16384, 16384, 16384, 16384, 65535, 65535]],
        np.uint16,
    )
    assert bin(frame, binning=(2, 2), device=device).tolist() == [[65535, 65535, 65535]]
    frame[0, 0] -= 1
    assert bin(frame, binning=(2, 2), device=device).tolist() == [[65534, 65535, 65535]]


@pytest.mark.parametrize("device", ALL_KINDS)
def test_what_cannot_be_binned_is_refused(device):
    frame = np.ones((3, 40), np.float32)
    with pytest.raises(OutOfRange, match="at least 4x4"):
        bin(frame, binning=(2, 2), stride=(2, 2), device=device)
    for binning in ((0, 2), (2, 9), (2, 1.5)):
        with pytest.raises(OutOfRange, match="1 <= binning <= 8"):
            bin(frame, binning=binning, device=device)
    with pytest.raises(OutOfRange, match="stride"):
        bin(frame, binning=(2, 2), stride=(1, 0), device=device)
    with pytest.raises(BadData, match="uint16"):
        bin(frame, binning=(2, 2), average=True, device=device)
    with pytest.raises(BadData, match="int32"):
        bin(frame.astype(np.int32), binning=(2, 2), device=device)
    with pytest.raises(BadData, match="shape"):
        bin(np.ones((2, 4, 4), np.float32), binning=(2, 2), device=device)
    assert binned_shape((4, 9), (2, 2), (2, 2)) == (2, 4)


def test_arrays_of_a_device_stay_there():
    from gpusim.backends.select import open_device

    for name in DEVICES:
        device = open_device(name)
        for dtype in (np.uint16, np.float32):
            frame = np.random.default_rng(5).integers(0, 1000, (8, 8)).astype(dtype)
            result = bin(device.array(frame, dtype), binning=(2, 2), stride=(2, 2), device=device)
            assert isinstance(result, device.array_type)
            np.testing.assert_array_equal(device.numpy(result), brute(frame, (2, 2), (2, 2)))

"""Interpolation of any mosaic: its definition, Bayer's bilinear one, constants and ramps; the named mosaics."""

import numpy as np
import pytest
from devices import ALL, ALL_KINDS
from hypothesis import given, settings
from hypothesis import strategies as st

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.mosaics import MOSAICS, mosaic
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.interpolate import interpolate, least_frame

PLAIN = {"black_level": 0.0, "scale": 1.0}
SOME = ["bayer-grbg", "quad-bayer", "x-trans", "rgbw-kodak", "rccc", "mono"]


def indices(rows):
    letters = sorted(set("".join(rows)))
    return np.array([[letters.index(letter) for letter in row] for row in rows], np.int32)


def tiled(cfa, shape):
    y, x = np.indices(shape)
    return cfa[y % len(cfa), x % len(cfa[0])]


def noise(shape, seed=1):
    return np.random.default_rng(seed).integers(0, 4096, shape, np.uint16)


@st.composite
def mosaics(draw, longest=5):
    """Whole numbers 0 .. C - 1 that all occur."""
    rows, cols = draw(st.integers(1, longest)), draw(st.integers(1, longest))
    channels = draw(st.integers(1, min(4, rows * cols)))
    places = draw(st.permutations(range(rows * cols)))
    return np.array([place % channels for place in places], np.int32).reshape(rows, cols)


def tap_weights(places, half):
    """Weights nearest to the tent's, sum (w - t)^2 / t, with sum 1 and centroid 0: by Lagrange's multipliers."""
    while len(places):
        tent = np.array([(1 - abs(dy) / half[0]) * (1 - abs(dx) / half[1]) for dy, dx in places])
        conditions = np.array([[1, dy, dx] for dy, dx in places], float).T
        system = np.block([[np.diag(1 / tent), conditions.T], [conditions, np.zeros((3, 3))]])
        found = np.linalg.lstsq(
            system, np.concatenate([np.zeros(len(places)), [1, 0, 0]]), rcond=1e-10
        )[0]
        weights = found[: len(places)]
        if not np.allclose(conditions @ weights, [1, 0, 0], atol=1e-7):
            return None
        if weights.min() > -1e-7:
            return [
                (place, weight)
                for place, weight in zip(places, weights, strict=True)
                if weight > 1e-7
            ]
        places = [place for place, weight in zip(places, weights, strict=True) if weight > -1e-7]
    return None


def brute(raw, cfa):
    """The contract, pixel by pixel."""
    channel = tiled(cfa, raw.shape)
    out = np.zeros((cfa.max() + 1, *raw.shape))
    period = [
        next(
            n
            for n in range(1, size + 1)
            if size % n == 0 and np.array_equal(np.roll(cfa, n, axis), cfa)
        )
        for axis, size in enumerate(cfa.shape)
    ]
    for c in range(cfa.max() + 1):
        for k in range(1, 9):
            half = [min(k, n) for n in period]
            taps = {}
            for y in range(period[0]):
                for x in range(period[1]):
                    places = [
                        (dy, dx)
                        for dy in range(1 - half[0], half[0])
                        for dx in range(1 - half[1], half[1])
                        if cfa[(y + dy) % period[0], (x + dx) % period[1]] == c
                    ]
                    taps[y, x] = [((0, 0), 1.0)] if cfa[y, x] == c else tap_weights(places, half)
            if all(
                found is not None
                and all(
                    any(
                        0 <= dy + top < half[0] and 0 <= dx + left < half[1]
                        for (dy, dx), _ in found
                    )
                    for top in range(half[0])
                    for left in range(half[1])
                )
                for found in taps.values()
            ):
                break
        for y in range(raw.shape[0]):
            for x in range(raw.shape[1]):
                inside = [
                    (y + dy, x + dx, weight)
                    for (dy, dx), weight in taps[y % period[0], x % period[1]]
                    if 0 <= y + dy < raw.shape[0] and 0 <= x + dx < raw.shape[1]
                ]
                assert all(channel[v, u] == c for v, u, _ in inside)
                out[c, y, x] = sum(w * float(raw[v, u]) for v, u, w in inside) / sum(
                    w for *_, w in inside
                )
    return out


@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("device", ALL_KINDS)
def test_it_is_its_definition(name, device):
    cfa = indices(mosaic(name))
    raw = noise((11, 43))
    got = interpolate(raw, cfa=cfa, black_level=100.0, scale=1 / 4095, device=device)
    # Values to 4095/4095: below 40 taps, so 2 * 40 + 5 roundings of 2^-24 (see the stage's cases).
    np.testing.assert_allclose(got, (brute(raw, cfa) - 100) / 4095, atol=85 * 2.0**-24)


@settings(max_examples=8, deadline=None)
@given(mosaics(), st.integers(0, 9), st.integers(0, 9))
def test_random_mosaics_are_their_definition(cfa, more_rows, more_cols):
    rows, cols = least_frame(cfa)
    raw = noise((rows + more_rows, cols + more_cols))
    got = interpolate(raw, cfa=cfa, **PLAIN, device="numpy")
    # float64; the multipliers' system and the normal equations are solved to better than 1e-10 of 4095
    np.testing.assert_allclose(got, brute(raw, cfa), atol=4e-7)


@pytest.mark.parametrize("phase", ["RGGB", "GRBG", "GBRG", "BGGR"])
@pytest.mark.parametrize("device", ALL_KINDS)
def test_bayer_is_bilinear(phase, device):
    cfa = np.array(["RGB".index(letter) for letter in phase], np.int32).reshape(2, 2)
    raw = noise((21, 70))
    got = interpolate(raw, cfa=cfa, black_level=64.0, scale=1 / 1024, device=device)
    expected = bilinear(raw, phase=phase, black_level=64.0, scale=1 / 1024, device=device)
    # Halves and quarters of 12-bit integers are exact in float32, and so is 2^-10: equal bit for bit. The reference has
    # its weights from a least-squares fit, right to a few 2^-52.
    np.testing.assert_allclose(
        got[:, 1:-1, 1:-1], expected[:, 1:-1, 1:-1], rtol=0, atol=1e-13 if device == "numpy" else 0
    )


def frame_of(values, cfa, shape):
    """Raw frame in which channel c has values[c] of each place."""
    y, x = np.indices(shape)
    return np.choose(tiled(cfa, shape), [value(y, x) for value in values]).astype(np.uint16)


@pytest.mark.parametrize("name", sorted(MOSAICS))
def test_constant_channels_stay_constant_to_the_corners(name):
    cfa = indices(mosaic(name))
    levels = 500 + 700 * np.arange(cfa.max() + 1)
    for shape in (least_frame(cfa), (17, 45)):
        raw = frame_of(
            [lambda y, x, level=level: np.full(y.shape, level) for level in levels], cfa, shape
        )
        for device in ALL:
            got = interpolate(raw, cfa=cfa, **PLAIN, device=device)
            # 85 roundings, as above, relative
            np.testing.assert_allclose(
                got, np.broadcast_to(levels[:, None, None], got.shape), rtol=85 * 2.0**-24
            )


@settings(max_examples=10, deadline=None)
@given(mosaics(longest=8))
def test_constants_and_ramps_of_random_mosaics(cfa):
    """Constants come out everywhere, ramps wherever the window, at most 7 pixels each way, is inside."""
    channels = cfa.max() + 1
    shape = (25, 28)
    y, x = np.indices(shape)
    raw = frame_of(
        [
            lambda y, x, c=c: 100 + 50 * c + (7 + c) * y + (11 - 3 * c) * x + 30 * c * (c > 2)
            for c in range(channels)
        ],
        cfa,
        shape,
    )
    got = interpolate(raw, cfa=cfa, **PLAIN, device="numpy")
    expected = np.array(
        [100 + 50 * c + (7 + c) * y + (11 - 3 * c) * x + 30 * c * (c > 2) for c in range(channels)]
    )
    inner = np.s_[:, 7:-7, 7:-7]
    np.testing.assert_allclose(
        got[inner], expected[inner], rtol=1e-9
    )  # normal equations of condition < 1e4
    # at borders a mean of samples with positive weights: never beyond their range
    flat = interpolate(np.full(shape, 777, np.uint16), cfa=cfa, **PLAIN, device="numpy")
    np.testing.assert_allclose(flat, 777, rtol=1e-12)


@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("device", ALL_KINDS)
def test_measured_samples_are_kept_and_nothing_overshoots(name, device):
    cfa = indices(mosaic(name))
    raw = noise((19, 50), seed=3)
    got = interpolate(raw, cfa=cfa, **PLAIN, device=device)
    np.testing.assert_array_equal(
        np.choose(tiled(cfa, raw.shape), got), raw
    )  # weight 1 and zeros: exact
    assert got.min() >= raw.min() * (1 - 85 * 2.0**-24)
    assert got.max() <= 4095 * (1 + 85 * 2.0**-24)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_period_written_twice_is_the_same_mosaic(device):
    cfa = indices(mosaic("x-trans"))[:3]  # 3 x 6
    raw = noise((20, 44))
    once = interpolate(raw, cfa=cfa, **PLAIN, device=device)
    np.testing.assert_array_equal(
        interpolate(raw, cfa=np.tile(cfa, (2, 1)), **PLAIN, device=device), once
    )


def test_ramp_is_exact_on_every_device():
    cfa, shape = indices(mosaic("quad-bayer")), (24, 60)
    y, x = np.indices(shape)
    ramp = 40 * y + 11 * x
    for device in ALL:
        got = interpolate(ramp.astype(np.uint16), cfa=cfa, **PLAIN, device=device)
        # half-width 3: windows reach 2 pixels; 85 roundings of the largest sample in reach
        np.testing.assert_allclose(
            got[:, 2:-2, 2:-2],
            np.broadcast_to(ramp, got.shape)[:, 2:-2, 2:-2],
            atol=ramp.max() * 85 * 2.0**-24,
        )


@pytest.mark.parametrize(
    "cfa", [[[-1, 0]], [[0, 2]], [[]], [0, 1], np.zeros((9, 1), int), [[0.0, 1.0]]], ids=str
)
def test_what_is_no_mosaic_is_refused(cfa):
    for device in ALL:
        if device == "numpy":
            continue  # the reference trusts its caller
        with pytest.raises(BadData, match=r"^cfa: [^\n]*wanted"):
            interpolate(noise((8, 8)), cfa=np.array(cfa), **PLAIN, device=device)


def test_what_is_no_frame_is_refused():
    bayer = indices(mosaic("bayer-rggb"))
    for device in ALL[1:]:
        for raw in (
            noise((1, 4)),
            noise((4, 1)),
            np.zeros((4, 4), np.float32),
            np.zeros((0, 4), np.uint16),
        ):
            with pytest.raises(BadData, match=r"^raw: [^\n]*wanted"):
                interpolate(raw, cfa=bayer, **PLAIN, device=device)
        with pytest.raises(OutOfRange):
            interpolate(noise((4, 4)), cfa=bayer, black_level=0.0, scale=0.0, device=device)


def test_named_mosaics():
    assert mosaic("quad-bayer") == ("RRGG", "RRGG", "GGBB", "GGBB")
    for name in sorted(MOSAICS):
        rows = mosaic(name)
        assert len({len(row) for row in rows}) == 1
        assert max(len(rows), len(rows[0])) <= 8
    with pytest.raises(UnknownName, match="did you mean 'x-trans'"):
        mosaic("xtrans")


def test_what_is_known_of_the_patterns():
    """Counts per period as their sources give them: X-Trans 20 : 8 : 8 with all colours in every line, and so on."""
    x_trans = np.array([list(row) for row in mosaic("x-trans")])
    assert [int((x_trans == letter).sum()) for letter in "RGB"] == [8, 20, 8]
    for line in (*x_trans, *x_trans.T):
        assert set(line) == set("RGB")
    kodak = np.array([list(row) for row in mosaic("rgbw-kodak")])
    assert (
        (kodak == "W") == (np.indices((4, 4)).sum(0) % 2 == 0)
    ).all()  # clear ones in a checkerboard
    assert [int((kodak == letter).sum()) for letter in "RGB"] == [2, 4, 2]
    near_infrared = "".join(mosaic("rgbn-4x4"))
    assert [near_infrared.count(letter) for letter in "RGBN"] == [2, 8, 2, 4]
    assert set(MOSAICS) >= {
        "bayer-rggb",
        "bayer-grbg",
        "bayer-gbrg",
        "bayer-bggr",
        "rgbw",
        "rgbn",
        "rccc",
        "mono",
    }

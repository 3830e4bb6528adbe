"""The demosaicking network: balance, mosaics, borders, PyTorch's numbers, and what is refused."""

import itertools

import numpy as np
import pytest
from devices import ALL_KINDS
from scipy.ndimage import gaussian_filter

from gpusim.data.charts import chart
from gpusim.domain.errors import BadData, GpusimError, OutOfRange
from gpusim.domain.mosaics import MOSAICS, mosaic
from gpusim.domain.network import INPUTS, OUTPUTS, VERSION, Network, is_served
from gpusim.io.camera.network import built_in_network, read_network, write_network
from gpusim.kernels.processor.best import best
from gpusim.kernels.processor.interpolate import interpolate
from gpusim.kernels.processor.network import network

RANDOM = np.random.default_rng(3)
SERVED = (
    "bayer-rggb",
    "bayer-grbg",
    "bayer-gbrg",
    "bayer-bggr",
    "quad-bayer",
    "nona-bayer",
    "x-trans",
)
OPTIONS = {"black_level": 64.0, "scale": 1 / 4096}


def test_mosaics_that_are_served():
    assert {name for name, rows in MOSAICS.items() if is_served(rows)} == {*SERVED}


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_fainter_channel_makes_no_difference(device):
    """Red and blue at a quarter and a sixteenth, balanced by 4 and 16: powers of two change no bit."""
    raw = 16 * RANDOM.integers(1, 200, (12, 14)).astype(np.uint16)
    faint = raw.copy()
    faint[::2, ::2] //= 4
    faint[1::2, 1::2] //= 16
    options = {"cfa": ("RG", "GB"), "black_level": 0.0, "scale": 1 / 4096, "device": device}
    plain = network(raw, **options)
    balanced = network(faint, **options, balance=(4.0, 16.0))
    difference = balanced * np.array([4, 1, 16])[:, None, None] - plain
    assert abs(difference).max() <= (1e-12 if device == "numpy" else 0)


@pytest.mark.parametrize("name", SERVED)
def test_a_flat_field_stays_flat(name):
    """Every mosaic and border gives a flat field back as encoded: within 1 number of 8 bits, 1.5 of nona-Bayer's.

    It is learned, not built in: the bound is what the built-in weights were measured to keep (.7 and 1.3), rounded up.
    """
    for level in (20, 128, 250):
        raw = np.full((31, 44), level, np.uint16)
        planes = network(
            raw, cfa=mosaic(name), black_level=0.0, scale=1 / 255, domain="linear", device="opencl"
        )
        assert np.abs(255 * planes - level).max() < (1.5 if name == "nona-bayer" else 1.0), level


def test_shifts_of_the_mosaic_are_shifts_of_the_picture():
    """In the middle, by two pixels: blocks begin there again."""
    raw = RANDOM.integers(500, 3000, (64, 64)).astype(np.uint16)
    whole = network(raw, cfa=mosaic("quad-bayer"), **OPTIONS, device="opencl")
    rows = mosaic("quad-bayer")
    shifted = tuple(row[2:] + row[:2] for row in rows[2:] + rows[:2])
    part = network(raw[2:, 2:], cfa=shifted, **OPTIONS, device="opencl")
    reach = 2 * len(built_in_network().weights) + 3
    inner = np.s_[:, reach : 62 - reach, reach : 62 - reach]
    # other pieces of vectors may contract other products, in 8 layers of sums of 432 terms
    np.testing.assert_allclose(whole[:, 2:, 2:][inner], part[inner], atol=1e-6)


@pytest.mark.parametrize(
    "options, error, message",
    [
        ({"cfa": ("RG", "WB")}, OutOfRange, "RG/WB: allowed is a period of at most 8x8 pixels of R, G and B"),
        ({"cfa": mosaic("hexadeca-bayer")}, OutOfRange, "all in every 4x4 pixels"),
        ({"raw": np.zeros((1, 9), np.uint16)}, BadData, "1x9 pixels; with the mosaic RG/GB at least 2x2"),
        ({"domain": "linear", "noise": (1.0, 0.0)}, OutOfRange, "encoded"),
        ({"balance": (0.0, 1.0)}, OutOfRange, "balance"),
        ({"noise": (-1.0, 0.0)}, OutOfRange, "noise"),
    ],
)  # fmt: skip
def test_what_is_refused(options, error, message):
    given = {"raw": np.zeros((8, 8), np.uint16), "cfa": ("RG", "GB"), **OPTIONS} | options
    with pytest.raises(error, match=message):
        network(**given, device="opencl")


def weights(*sizes):
    pairs = list(itertools.pairwise(sizes))
    made = tuple(RANDOM.normal(0, 0.05, (of, into, 3, 3)).astype(np.float32) for into, of in pairs)
    return made, tuple(RANDOM.normal(0, 0.05, of).astype(np.float32) for _, of in pairs)


@pytest.mark.parametrize(
    "sizes, error, message",
    [
        ((INPUTS, OUTPUTS), BadData, "two or more layers"),
        ((INPUTS + 1, 12, OUTPUTS), BadData, "layer 0"),
        ((INPUTS, 12, 24, OUTPUTS), BadData, "layer 1"),
        ((INPUTS, 12, OUTPUTS + 1), BadData, "layer 1"),
        ((INPUTS, 16, OUTPUTS), BadData, "layer 0: 16 outputs; wanted a multiple of 12"),
        ((INPUTS, 144, 144, OUTPUTS), OutOfRange, "at most 150,000"),
    ],
)
def test_networks_that_are_refused(sizes, error, message):
    with pytest.raises(error, match=message):
        Network(*weights(*sizes))


def test_pytorch_has_the_same_numbers():
    """The model that is trained, in float32: the sums of 432 terms in 8 layers round to 1e-5 of the largest."""
    torch = pytest.importorskip("torch", reason="torch is not installed")
    from gpusim.apps.network.model import Model, first_guess, network_inputs, unpack

    torch.manual_seed(1)
    model = Model()
    cfa = mosaic("x-trans")
    at = np.array([["RGB".index(letter) for letter in row] for row in cfa])
    raw = RANDOM.integers(0, 256, (60, 72)).astype(np.uint16)
    masks = np.stack([np.tile(at == color, (10, 12)) for color in range(3)]).astype(np.float32)
    planes = [
        torch.from_numpy(one)[None] for one in (raw[None] / np.float32(255), masks, 0 * masks[:1])
    ]
    guess = first_guess(*planes[:2])
    with torch.no_grad():
        wanted = guess + unpack(model(network_inputs(guess, *planes[1:])))
    found = network(
        raw,
        cfa=cfa,
        black_level=0.0,
        scale=1 / 255,
        domain="linear",
        weights=model.export(""),
        device="numpy",
    )
    inner = np.s_[:, 20:-20, 20:-20]  # PyTorch has zeros at the borders
    assert np.abs(found - wanted[0].numpy())[inner].max() < 1e-5 * np.abs(found).max()


def picture():
    """Dead leaves in three bands, blurred as by a lens, 8 bits (256, 320, 3)."""
    content = chart("deadleaves", size=(320, 256), wavelengths=[450.0, 540.0, 610.0]).content
    planes = np.moveaxis(content.bands_at(slice(None)), 0, 2)[..., ::-1]
    return np.rint(255 * np.sqrt(gaussian_filter(planes / planes.max(), (0.6, 0.6, 0))))


def quality(found, wanted):
    """CPSNR [dB] without a border of 10 pixels."""
    return -10 * np.log10(np.mean(((found - wanted)[10:-10, 10:-10] / 255) ** 2))


def seen(planes, cfa):
    at = np.array([["RGB".index(letter) for letter in row] for row in cfa])
    rows, cols = planes.shape[:2]
    whole = np.tile(at, (-(-rows // len(at)), -(-cols // len(at))))[:rows, :cols]
    return at, np.take_along_axis(planes, whole[..., None], 2)[..., 0]


@pytest.mark.parametrize("name", ["x-trans", "quad-bayer", "nona-bayer"])
def test_it_is_better_than_interpolation(name):
    """On a generated picture: 3.9 to 4.4 dB were measured; photographs gain 4 to 9 dB."""
    wanted = picture()
    at, raw = seen(wanted, mosaic(name))
    options = {"black_level": 0.0, "scale": 1.0, "device": "opencl"}
    plain = interpolate(raw.astype(np.uint16), cfa=at.astype(np.int32), **options)
    found = network(
        raw.astype(np.uint16), cfa=mosaic(name), **options | {"scale": 1 / 255}, domain="linear"
    )
    ours = quality(255 * np.moveaxis(found, 0, 2), wanted)
    assert ours > quality(np.moveaxis(plain, 0, 2), wanted) + 3


@pytest.mark.parametrize("electrons", [5, 20])
def test_it_is_better_than_best_in_low_light(electrons):
    wanted = picture()
    light = (wanted / 255) ** 2
    gain = electrons / light.mean()
    _, mean = seen(light, ("RG", "GB"))
    raw = np.rint(8 * (RANDOM.poisson(mean * gain) + RANDOM.normal(0, 2, mean.shape)) + 200)
    options = {
        "black_level": 200.0,
        "scale": 1 / (8 * gain),
        "noise": (8.0, 16.0),
        "device": "opencl",
    }
    raw = np.maximum(raw, 0).astype(np.uint16)
    ours, bests = (
        quality(255 * np.sqrt(np.clip(np.moveaxis(planes, 0, 2), 0, 1)), wanted)
        for planes in (
            network(raw, cfa=("RG", "GB"), **options),
            best(raw, phase="RGGB", **options),
        )
    )
    assert ours > bests + 2


def test_weights_in_files(tmp_path):
    """They come back as 16-bit numbers; other versions, and files that are none, are refused."""
    made = Network(*weights(INPUTS, 12, OUTPUTS), "a test")
    write_network(tmp_path / "a.npz", made)
    found = read_network(tmp_path / "a.npz")
    for one, two in zip(found.weights, made.weights, strict=True):
        np.testing.assert_array_equal(one, two.astype(np.float16))
    assert found.provenance == "a test"
    held = dict(np.load(tmp_path / "a.npz"))
    for name, changed, message in (
        (
            "old",
            {"version": np.array(99)},
            f"version 99; wanted version {VERSION}: train them again",
        ),
        ("short", {"weight_0": held["weight_0"][:, 1:]}, "layer 0"),
        ("text", {"weight_0": np.array("x")}, "weight_0"),
    ):
        np.savez(tmp_path / f"{name}.npz", **held | changed)
        with pytest.raises(GpusimError, match=message):
            read_network(tmp_path / f"{name}.npz")

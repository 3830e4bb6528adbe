"""DNG files as LibRaw, exiftool and tifffile read them: mosaics, levels, layers, floats, and what is refused."""

import numpy as np
import pytest
import rawpy
import tifffile
from exif import exiftool

from gpusim.domain.errors import OutOfRange
from gpusim.domain.mosaics import MOSAICS
from gpusim.domain.raw_noise import RawNoise
from gpusim.io.frame.dng import write_dng

RANDOM = np.random.default_rng(21)
RAW = RANDOM.integers(0, 4096, (48, 50)).astype(np.uint16)
BAYER = ("RG", "GB")
WRITABLE = [
    name
    for name, cfa in MOSAICS.items()
    if name not in ("mono", "rccc") and not {*"NE"} & {*"".join(cfa)}
]
BY_LIBRAW = [
    name for name in WRITABLE if name.startswith("bayer") or name in ("x-trans", "rgbw", "cygm")
]


def letters_of(cfa):
    return "".join(dict.fromkeys("".join(cfa)))


def matrices(count):
    made = np.eye(count, 3) + 0.1 * RANDOM.random((count, 3))
    return {"A": (made - 0.05, np.linalg.pinv(made)), "D65": (made, np.linalg.pinv(made - 0.01))}


def write(path, raw=RAW, cfa=BAYER, black=64, white=4095, channels=None, **options):
    channels = channels or letters_of(cfa) or "RGB"
    count = len(channels)
    write_dng(
        path,
        raw,
        cfa,
        black,
        white,
        matrices(count),
        np.linspace(0.5, 1, count),
        channels=channels,
        **options,
    )


@pytest.mark.parametrize("name", WRITABLE)
def test_every_mosaic_that_dng_can_tell(tmp_path, name):
    """Codes of TIFF/EP: red 0, green 1, blue 2, cyan 3, magenta 4, yellow 5, white 6."""
    cfa = MOSAICS[name]
    write(tmp_path / "a.dng", cfa=cfa)
    tags = exiftool(tmp_path / "a.dng")
    codes = {letter: code for code, letter in enumerate("RGBCMYW")}
    assert tags["CFARepeatPatternDim"] == [len(cfa), len(cfa[0])] and tags["CFALayout"] == 1
    assert tags["CFAPattern2"] == [codes[letter] for letter in "".join(cfa)]
    assert tags["CFAPlaneColor"] == [codes[letter] for letter in letters_of(cfa)]
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.dng"), RAW)
    with rawpy.imread(str(tmp_path / "a.dng")) as file:
        np.testing.assert_array_equal(file.raw_image_visible, RAW)
        assert file.num_colors == len(letters_of(cfa))
        np.testing.assert_allclose(
            file.camera_whitebalance[: file.num_colors],
            1 / np.linspace(0.5, 1, file.num_colors),
            rtol=1e-6,
        )  # LibRaw's float32
        if name in BY_LIBRAW:  # others it decodes as far as 8 rows of 2 columns say
            assert_same_places(file.raw_pattern, cfa)


def assert_same_places(pattern, cfa):
    """LibRaw's numbers of planes, among them a second green, stand where the letters do."""
    pairs = {
        (int(number), letter)
        for row, letters in zip(pattern, cfa, strict=True)
        for number, letter in zip(row, letters, strict=True)
    }
    assert len({number for number, _ in pairs}) == len(pairs)
    assert {letter for _, letter in pairs} == {*"".join(cfa)}


@pytest.mark.parametrize("channels", ["RGB", "RGBW"])
def test_stacked_pixels_are_layers(tmp_path, channels):
    raw = RANDOM.integers(0, 4096, (len(channels), 40, 30)).astype(np.uint16)
    write(tmp_path / "a.dng", raw, (), channels=channels)
    tags = exiftool(tmp_path / "a.dng")
    assert tags["PhotometricInterpretation"] == 34892 and tags["SamplesPerPixel"] == len(channels)
    assert tags["BlackLevel"] == [64] * len(channels) and tags["WhiteLevel"] == [4095] * len(
        channels
    )
    with rawpy.imread(str(tmp_path / "a.dng")) as file:
        np.testing.assert_array_equal(
            np.moveaxis(file.raw_image_visible, -1, 0)[: len(channels)], raw
        )


@pytest.mark.parametrize("cfa", [BAYER, ()], ids=["Bayer", "monochrome"])
def test_floats_stay_floats(tmp_path, cfa):
    """Values without a converter; LibRaw rounds them to whole numbers of a scale of its own, to half a step."""
    raw = RANDOM.uniform(0, 4095, (40, 30)).astype(np.float32)
    raw[0, 0] = 4095
    write(tmp_path / "a.dng", raw, cfa, channels=None if cfa else "Y")
    tags = exiftool(tmp_path / "a.dng")
    assert (tags["SampleFormat"], tags["BitsPerSample"]) == (3, 32) and tags[
        "DNGBackwardVersion"
    ] == [1, 4, 0, 0]
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "a.dng"), raw)
    with rawpy.imread(str(tmp_path / "a.dng")) as file:
        scale = file.white_level / 4095
        assert scale >= 1 and file.raw_image_visible.dtype == np.uint16
        # cut off or rounded: less than a step; float32 products below a hundredth of it
        np.testing.assert_allclose(file.raw_image_visible / scale, raw, rtol=0, atol=1.01 / scale)


def test_black_levels(tmp_path):
    """One for each place of the period, in rows; and a fraction as a ratio."""
    write(tmp_path / "a.dng", black=[[60, 61], [62, 63]])
    tags = exiftool(tmp_path / "a.dng")
    assert tags["BlackLevelRepeatDim"] == [2, 2] and tags["BlackLevel"] == [60, 61, 62, 63]
    with rawpy.imread(str(tmp_path / "a.dng")) as file:
        by_place = np.array(file.black_level_per_channel)[file.raw_pattern]
    np.testing.assert_array_equal(by_place, [[60, 61], [62, 63]])
    write(tmp_path / "a.dng", black=64 + 1 / 3)
    assert exiftool(tmp_path / "a.dng")["BlackLevel"] == pytest.approx(64 + 1 / 3, rel=1e-8)


def test_matrices_of_two_lights_and_white(tmp_path):
    count, given = 3, matrices(3)
    neutral = np.array([0.5432109876, 1.0, 1e-3])
    write_dng(tmp_path / "a.dng", RAW, BAYER, 64, 4095, given, neutral, noise=(1.25e-4, 3e-9))
    tags = exiftool(tmp_path / "a.dng")
    assert (tags["CalibrationIlluminant1"], tags["CalibrationIlluminant2"]) == (
        17,
        21,
    )  # EXIF: A, D65
    for place, (color, forward) in enumerate(given.values(), 1):
        # fractions of 31 bits, printed with 10 digits
        np.testing.assert_allclose(
            np.reshape(tags[f"ColorMatrix{place}"], (count, 3)), color, rtol=1e-9, atol=1e-9
        )
        np.testing.assert_allclose(
            np.reshape(tags[f"ForwardMatrix{place}"], (3, count)), forward, rtol=1e-9, atol=1e-9
        )
    np.testing.assert_allclose(tags["AsShotNeutral"], neutral, rtol=0, atol=1e-9)
    np.testing.assert_allclose(tags["NoiseProfile"], [1.25e-4, 3e-9], rtol=1e-14)


@pytest.mark.parametrize("cfa", [MOSAICS[name] for name in ("rgbn", "rgbe", "rccc")], ids="/".join)
def test_mosaics_that_dng_cannot_tell(tmp_path, cfa):
    with pytest.raises(OutOfRange, match=r"of a DNG = .*\.npz holds any") as error:
        write(tmp_path / "a.dng", cfa=cfa)
    assert "\n" not in str(error.value) and list(tmp_path.iterdir()) == []


def test_noise_profile_by_hand():
    """5000 e- at x = 1, 3 e- of reading, 1 e- of lines, no rounding: (e + 10) / 5000^2; four of them averaged: / 4."""
    noise = {
        "photons": 1.0,
        "read": 9.0,
        "lines": 1.0,
        "offsets": 7.0,
        "line_offsets": 5.0,
        "response": 1e-4,
        "line_response": 1e-4,
        "rounding": 0.0,
    }
    assert RawNoise(**noise).profile(5000.0) == pytest.approx((1 / 5000, 10 / 5000**2), rel=1e-12)
    assert RawNoise(**noise, averaged=4).profile(5000.0) == pytest.approx(
        (1 / 20000, 2.5 / 5000**2), rel=1e-12
    )

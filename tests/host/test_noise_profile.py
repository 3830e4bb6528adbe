"""Gain and noise from raw photographs: DNG's NoiseProfile, and frames of a camera measured by photon transfer."""

import shutil
import struct
import subprocess

import numpy as np
import pytest
from cameras import PHONE
from refusals import refused

import gpusim as gs
from gpusim.domain.errors import BadFile, OutOfRange
from gpusim.io.camera.noise_profile import NoiseProfile
from gpusim.io.frame.dng import write_dng

# TIFF's types: code, bytes, struct's letter
SHORT, LONG, DOUBLE, BYTE, RATIONAL = (
    (3, 2, "H"),
    (4, 4, "I"),
    (12, 8, "d"),
    (1, 1, "B"),
    (5, 8, "II"),
)


def directory(order, start, entries):
    """A TIFF directory that lies at `start`, with its long values behind it."""
    head, tail = b"", b""
    behind = start + 2 + 12 * len(entries) + 4
    for code, (kind, size, letters), values in sorted(entries, key=lambda entry: entry[0]):
        count = (
            len(values) * size // struct.calcsize(order + letters) // (2 if kind in (5, 10) else 1)
        )
        data = struct.pack(order + letters[0] * len(values), *values)
        if len(data) <= 4:
            value = data.ljust(4, b"\0")
        else:
            value, tail = struct.pack(order + "I", behind + len(tail)), tail + data
        head += (
            struct.pack(order + "HHI", code, kind, count if kind in (5, 10) else len(values))
            + value
        )
    return struct.pack(order + "H", len(entries)) + head + bytes(4) + tail


def dng(
    order="<",
    profile=(1e-4, 2e-7),
    black=((64, RATIONAL),),
    white=1023,
    below=False,
    photometric=32803,
    bits=10,
    size=(4, 4),
    tags=(),
    more=(),
):
    """Bytes of a DNG's directories, as the specification has them: raw data below a thumbnail, or alone."""
    raw = [
        (254, LONG, [0]),
        (256, LONG, [size[1]]),
        (257, LONG, [size[0]]),
        (258, SHORT, [bits]),
        (259, SHORT, [1]),
        (262, SHORT, [photometric]),
        (273, LONG, [8]),
        (277, SHORT, [1]),
        (279, LONG, [0]),
    ]
    for value, kind in black:
        raw.append((50714, kind, [value, 1] if kind is RATIONAL else [value]))
    raw += [(50717, LONG, [white])] if white else []
    raw += tags
    first = [
        (254, LONG, [1]),
        (256, LONG, [1]),
        (257, LONG, [1]),
        (258, SHORT, [8]),
        (259, SHORT, [1]),
        (262, SHORT, [1]),
        (273, LONG, [8]),
        (277, SHORT, [1]),
        (279, LONG, [0]),
    ]
    own = [(50706, BYTE, [1, 4, 0, 0]), *more] + (
        [(51041, DOUBLE, list(profile))] if profile else []
    )
    header = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)
    if not below:
        return header + directory(order, 8, raw + own)
    size = len(directory(order, 8, [*first, *own, (330, LONG, [0])]))
    return (
        header
        + directory(order, 8, [*first, *own, (330, LONG, [8 + size])])
        + directory(order, 8 + size, raw)
    )


def saved(tmp_path, data):
    (tmp_path / "a.dng").write_bytes(data)
    return tmp_path / "a.dng"


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("below", [False, True])
def test_profiles_are_read_where_they_may_be(tmp_path, order, below):
    """Byte by byte from the specification: of either order, raw data in the first directory or below it."""
    assert gs.read_noise_profile(saved(tmp_path, dng(order, below=below))) == NoiseProfile(
        1e-4, 2e-7, 64, 1023
    )
    planes = dng(
        order, (1e-4, 2e-7, 1.1e-4, 3e-7, 1.2e-4, 4e-7), black=((60, SHORT),), white=15520, bits=14
    )
    found = gs.read_noise_profile(saved(tmp_path, planes))
    assert found.scale == pytest.approx(1.1e-4, rel=1e-12) and found.offset == pytest.approx(
        3e-7, rel=1e-12
    )
    assert (found.black_level, found.white_level) == (60, 15520)
    plain = gs.read_noise_profile(
        saved(tmp_path, dng(order, black=(), white=None, bits=12))
    )  # the defaults
    assert (plain.black_level, plain.white_level) == (0, 4095)


def test_a_profile_that_exiftool_wrote(tmp_path):
    if shutil.which("exiftool") is None:
        pytest.skip("exiftool is not installed: apt install libimage-exiftool-perl")
    path = tmp_path / "a.dng"
    write_dng(
        path,
        np.zeros((32, 32), np.uint16),
        ("RG", "GB"),
        64,
        1023,
        {"D65": (np.eye(3), None)},
        (1, 1, 1),
    )
    with refused(path, "no NoiseProfile", error=BadFile):
        gs.read_noise_profile(path)
    command = [
        "exiftool",
        "-q",
        "-overwrite_original",
        "-n",
        "-IFD0:NoiseProfile=1.5e-4 2.5e-7",
        path,
    ]
    subprocess.run(command, check=True)
    assert gs.read_noise_profile(path) == NoiseProfile(1.5e-4, 2.5e-7, 64, 1023)


@pytest.mark.parametrize(
    "profile", [NoiseProfile(1 / 6000, 1e-5, 64, 1023), NoiseProfile(1 / 300, 1e-5, 256, 15520)]
)
def test_raw_values_have_the_variance_of_the_profile(profile):
    """Frames drawn at six levels: variance within 5 of its own standard errors, sqrt(2 / n), and the mean alike."""
    sensor = profile.apply_to(PHONE.sensor)
    readout, levels = gs.Readout(bare(sensor), "numpy"), np.array([0.0, 0.02, 0.1, 0.3, 0.6, 0.8])
    size = profile.white_level - profile.black_level
    for number, level in enumerate(levels):
        raw = readout.draw(
            np.full((300, 400), level / profile.scale, np.float32), 0.0, seed=3, first=number
        )
        x = (np.asarray(raw, np.float64) - profile.black_level) / size
        wanted = profile.scale * level + profile.offset
        if level == 0:  # black levels of 64 DN and more clip nothing at 5 sigma
            assert profile.black_level > 5 * np.sqrt(wanted) * size
        assert x.var() == pytest.approx(wanted, rel=5 * np.sqrt(2 / x.size))
        assert x.mean() == pytest.approx(level, abs=5 * np.sqrt(wanted / x.size))
    bright = readout.draw(np.full((20, 20), 2 / profile.scale, np.float32), 0.0, seed=3)
    # twice the full well: the read noise's median, which has 1.25 times the standard error of a mean
    assert np.median(bright) == pytest.approx(
        profile.white_level, abs=5 * 1.25 * np.sqrt(profile.offset / 400) * size
    )


def bare(sensor):
    """The sensor without fixed patterns and dark current, which a profile leaves as they are."""
    from dataclasses import replace

    return replace(sensor, noise=replace(gs.Noise(photon="exact"), read=sensor.noise.read))


def test_less_than_rounding_is_no_read_noise():
    assert NoiseProfile(1e-4, 1e-8, 0, 1023).read == 0  # rounding: 1 / 12 / 1023^2 = 8e-8
    assert NoiseProfile(1e-4, -1e-9, 0, 1023).read == 0
    # 2 e- and rounding: (2^2 K^2 + 1/12) / 1023^2, K = 0.1023
    assert NoiseProfile(1e-4, (4 * 0.1023**2 + 1 / 12) / 1023**2, 0, 1023).read == pytest.approx(
        2, rel=1e-12
    )


CAMERA = """base = "none"
[optics]
f_number = 2
focal_length_mm = 4
[sensor]
pixel_pitch_um = 2
qe = "mt9v024"
noise_profile = "a.dng"
{}
[noise]
prnu = 0.01
{}
"""


def test_camera_files_take_profiles(tmp_path):
    saved(tmp_path, dng(profile=(1e-3, 2e-5), white=15520, bits=16))
    (tmp_path / "own.toml").write_text(CAMERA.format("", ""))
    sensor = gs.open_camera(tmp_path / "own.toml").sensor
    assert (sensor.bits, sensor.black_level, sensor.full_well) == (14, 64, 1000)
    assert sensor.gain_dn_per_electron == pytest.approx(15.456, rel=1e-12)  # 15456 DN for 1000 e-
    assert sensor.noise.prnu == 0.01 and sensor.noise.read == pytest.approx(
        np.sqrt(2e-5) * 1e3, rel=1e-4
    )
    for lines in (
        ("bits = 10", ""),
        ("full_well_e = 100", ""),
        ("analog_gain = 2", ""),
        ("", "read_e = 1"),
    ):
        (tmp_path / "own.toml").write_text(CAMERA.format(*lines))
        with refused("own.toml", "noise_profile and", error=BadFile):
            gs.open_camera(tmp_path / "own.toml")


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        ({"profile": None}, ["no NoiseProfile"]),
        ({"profile": (1e-4,)}, ["1 numbers"]),
        ({"profile": (1e-4, np.nan)}, ["finite"]),
        ({"profile": (0.0, 1e-6)}, ["1e-9 <= S"]),
        ({"profile": (1e-4, 0, 2e-4, 0)}, ["0.0001 .. 0.0002", "one gain"]),
        ({"profile": (1e-4, 9.0)}, ["O = 9"]),
        ({"white": 20}, ["black < white"]),
        ({"black": ((2**31, LONG),)}, ["black < white"]),
    ],
)
def test_what_is_wrong_with_a_profile_is_said(tmp_path, change, parts):
    path = saved(tmp_path, dng(**change))
    with refused(path, *parts, error=BadFile):
        gs.read_noise_profile(path)


@pytest.mark.parametrize(
    "data",
    [b"", b"II*\0", b"II*\0\x08\0\0\0", b"MM\0*\0\0\0\x08\xff\xff", dng()[:60], b"\x89PNG\r\n"],
)
def test_what_is_no_dng(tmp_path, data, capfd):
    with refused("a.dng", error=BadFile):
        gs.read_noise_profile(saved(tmp_path, data))
    assert capfd.readouterr().err == ""  # of the library that reads it


SRATIONAL = (10, 8, "ii")


def fractions(values, denominator=10):
    return [part for value in values for part in (round(value * denominator), denominator)]


def profile_of(tmp_path, **change):
    return gs.read_noise_profile(saved(tmp_path, dng(**change)))


def test_deltas_of_the_black_level_by_row_and_column(tmp_path):
    """Black of a pixel is BlackLevel + DeltaH(column) + DeltaV(row); its mean is computed pixel by pixel."""
    rows, cols = (250.0, 262.0, 255.0, 257.0), (0.5, -0.5, 0.5, -0.5, 1.0, -1.0)
    found = profile_of(
        tmp_path,
        size=(4, 6),
        black=((10, SHORT),),
        white=4056,
        bits=12,
        tags=[(50716, SRATIONAL, fractions(rows)), (50715, SRATIONAL, fractions(cols))],
    )
    assert found.black_level == np.mean(10 + np.add.outer(rows, cols)) == 266
    assert found.gain == pytest.approx(1e-4 * (4056 - 266), rel=1e-12)
    assert any("varies by 14" in note for note in found.notes)
    flat = profile_of(
        tmp_path, black=(), white=4056, bits=12, tags=[(50716, SRATIONAL, fractions([256] * 4))]
    )
    assert flat.black_level == 256 and flat.gain == pytest.approx(0.38, rel=1e-12)
    assert flat.notes == ()
    with refused("BlackLevelDeltaV", "3 numbers, wanted 4", error=BadFile):
        profile_of(tmp_path, tags=[(50716, SRATIONAL, fractions([256] * 3))])


def test_black_levels_by_place_in_the_pattern_and_by_plane(tmp_path):
    levels = (62, 64, 66, 68)
    four = [(50713, SHORT, [2, 2]), (50714, SHORT, [*levels])]
    found = profile_of(tmp_path, black=(), tags=four)
    assert found.black_level == 65 and any("varies by 6" in note for note in found.notes)
    with refused("BlackLevel has 4 numbers: wanted 6", error=BadFile):
        profile_of(tmp_path, black=(), tags=[(50713, SHORT, [3, 2]), four[1]])


def test_geometry_and_other_tags_are_noted(tmp_path):
    found = profile_of(
        tmp_path,
        size=(8, 8),
        tags=[
            (50829, LONG, [2, 2, 8, 8]),
            (50830, LONG, [0, 0, 2, 8]),
            (50719, LONG, [1, 1]),
            (50720, LONG, [4, 4]),
            (50712, SHORT, [0, 100, 400, 1023]),
            (51009, BYTE, [0] * 8),
        ],
        more=[(50935, RATIONAL, [6, 10])],
    )
    notes = "; ".join(found.notes)
    for part in ("active area is 6 x 6 of 8 x 8", "MaskedAreas", "DefaultCropSize", "OpcodeList2"):
        assert part in notes
    assert "LinearizationTable" in notes and "NoiseReductionApplied" in notes
    rows = [(50829, LONG, [2, 2, 8, 8]), (50716, SRATIONAL, fractions([1.0] * 6))]
    assert profile_of(tmp_path, size=(8, 8), tags=rows).black_level == 65
    with refused("ActiveArea", error=BadFile):
        profile_of(tmp_path, tags=[(50829, LONG, [2, 2, 2, 8])])


def test_demosaicked_data_are_warned_of_and_floats_have_no_rounding(tmp_path):
    found = profile_of(tmp_path, photometric=34892, bits=16, white=65535)
    assert any("demosaicked" in note and "not of the sensor" in note for note in found.notes)
    (tmp_path / "own.toml").write_text(CAMERA.format("", ""))
    assert gs.open_camera(tmp_path / "own.toml").notes == found.notes
    values = dict(black=(), white=None, bits=32, profile=(1e-4, 1e-6), tags=[(339, SHORT, [3])])
    found = profile_of(tmp_path, **values)
    assert (found.black_level, found.white_level, found.read) == (0, 1, pytest.approx(10))
    sensor = gs.open_camera(tmp_path / "own.toml").sensor
    raw = gs.Readout(bare(sensor), "numpy").draw(np.full((200, 200), 2500, np.float32), 0.0, seed=1)
    # shot noise of 2500 electrons and 10 of reading, in units of 10,000; 5 standard errors
    assert np.var(raw) == pytest.approx(1e-4 * 0.25 + 1e-6, rel=5 * np.sqrt(2 / 40000))


def test_profiles_by_plane_and_files_without_a_raw_picture(tmp_path):
    pairs = profile_of(tmp_path, profile=(1e-4, 2e-7) * 4)
    assert any("4 pairs for 3 planes" in note for note in pairs.notes)
    four = profile_of(tmp_path, profile=(1e-4, 2e-7) * 4, tags=[(50710, BYTE, [0, 1, 2, 3])])
    assert four.notes == ()
    whites = profile_of(tmp_path, white=None, tags=[(50717, LONG, [1000, 1010, 1020])])
    assert whites.white_level == 1010 and any("1000 .. 1020" in note for note in whites.notes)
    with refused("no raw picture", error=BadFile):
        profile_of(tmp_path, photometric=1)


def test_a_file_of_tifffile_with_a_mask_and_a_second_raw_picture(tmp_path):
    import tifffile

    path = tmp_path / "a.dng"
    raw = np.zeros((16, 16), np.uint16)
    tags = [(50714, "I", 1, 64, False), (50717, "I", 1, 1023, False)]
    profile = [(51041, "d", 2, (1e-4, 2e-7), False)]
    with tifffile.TiffWriter(path) as file:
        common = {"metadata": None, "photometric": "cfa"}
        file.write(raw[:4, :4], subfiletype=1, subifds=2, extratags=profile, **common)
        file.write(raw, extratags=tags, **common)
        file.write(raw[:8], extratags=tags, **common)
    found = gs.read_noise_profile(path)
    assert (found.black_level, found.white_level) == (64, 1023)
    assert "the first of 2 raw pictures is used" in found.notes


def test_limits_of_profiles():
    with refused("S", error=OutOfRange):
        NoiseProfile(2.0, 0.0, 0, 1023)


def test_photon_transfer_makes_a_sensor():
    """Frames of a sensor, measured, make a sensor alike: gain and capacity to 2 %, read noise to 3 %.

    40 levels of pairs of 128 x 128 pixels: a variance's standard error is 1 %, the gain's of 25 of them and the mean
    0.3 %; the saturation is found in steps of a 40th of it: 2.5 %. 16 dark frames give the read noise to 0.2 %.
    """
    truth = gs.sensor_from_emva1288(
        pixel_pitch=3e-6,
        quantum_efficiency=0.5,
        wavelength=550,
        gain=0.4,
        dark_noise=5.0,
        saturation_capacity=8000.0,
        bits=12,
        black_level=64,
    )
    readout = gs.Readout(truth, "numpy")

    def frames(electrons, count, first):
        mean = np.full((128, 128), electrons, np.float32)
        return np.asarray(readout.draw(mean, 0.0, seed=5, first=first, frames=count))

    electrons = 8000 / 38 * np.arange(1, 41)
    found = gs.photon_transfer(
        [frames(level, 2, 100 + 2 * k) for k, level in enumerate(electrons)],
        frames(0, 16, 0),
        electrons / 0.5,
    )
    again = gs.sensor_from_emva1288(
        pixel_pitch=3e-6, wavelength=550, bits=12, black_level=64, **found.figures
    )
    assert again.gain == pytest.approx(0.4, rel=0.02)
    assert again.noise.read == pytest.approx(5, rel=0.03)
    assert again.full_well == pytest.approx(truth.full_well, rel=0.03)
    assert again.qe.at([550.0])[0, 0] == pytest.approx(0.5, rel=0.02)


@pytest.mark.parametrize("change", ["row", "column", "pattern", "all"])
def test_black_levels_are_those_of_libraw(change, tmp_path):
    """LibRaw's mean black level of the four places of the mosaic, in whole DN."""
    import tifffile

    rawpy = pytest.importorskip("rawpy", reason="rawpy is not installed")
    rows, cols, levels = (256,) * 32, (12,) * 32, (10, 12, 14, 16)
    tags = [
        (33421, "H", 2, (2, 2), False),
        (33422, "B", 4, bytes([0, 1, 1, 2]), False),
        (50706, "B", 4, bytes([1, 4, 0, 0]), False),
        (50708, "s", 0, "Test", False),
        (50717, "I", 1, 4056, False),
        (50721, "2i", 9, (1, 1, 0, 1, 0, 1, 0, 1, 1, 1, 0, 1, 0, 1, 0, 1, 1, 1), False),
        (51041, "d", 2, (1e-4, 1e-6), False),
    ]
    if change in ("pattern", "all"):
        tags += [(50713, "H", 2, (2, 2), False), (50714, "I", 4, levels, False)]
    if change in ("row", "all"):
        tags.append((50716, "2i", 32, tuple(fractions(rows, 1)), False))
    if change in ("column", "all"):
        tags.append((50715, "2i", 32, tuple(fractions(cols, 1)), False))
    path = tmp_path / "a.dng"
    values = np.full((32, 32), 300, np.uint16)
    tifffile.imwrite(path, values, photometric="cfa", metadata=None, extratags=tags)
    with rawpy.imread(str(path)) as raw:
        judge = np.mean(raw.black_level_per_channel)
    assert gs.read_noise_profile(path).black_level == judge > 0

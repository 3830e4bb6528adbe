"""ENVI files: those of Spectral Python and by hand; units, factors, bad bands, no data, and what is refused."""

import os

import numpy as np
import pytest
from refusals import refused, takes

import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.errors import BadFile, DoesNotFit, OutOfRange, UnknownName

RANDOM = np.random.default_rng(11)
WAVES = np.array([410.5, 500.0, 570.0, 655.25])
TYPES = {
    1: np.uint8,
    2: np.int16,
    3: np.int32,
    4: np.float32,
    5: np.float64,
    12: np.uint16,
    13: np.uint32,
    14: np.int64,
    15: np.uint64,
}
INTERLEAVES = {"bsq": (0, 1, 2), "bil": (1, 0, 2), "bip": (1, 2, 0)}  # of (bands, rows, cols)
PHOTON = 1.98644586e-25  # [J m] h c, CODATA 2018, nine digits
CUBE = RANDOM.integers(0, 100, (4, 5, 3)).astype(
    np.float32
)  # (bands, rows, cols), of which every type holds all


def write(path, cube, *, code=4, interleave="bsq", order=0, data=".raw", extra=0, **fields):
    """An ENVI file by hand: cube (bands, rows, cols), written as it is; fields by their names with _ for a space."""
    bands, rows, cols = cube.shape
    kind = np.dtype(TYPES[code]).newbyteorder("<>"[order])
    lines = {
        "samples": cols,
        "lines": rows,
        "bands": bands,
        "header_offset": 0,
        "file_type": "ENVI Standard",
        "data_type": code,
        "interleave": interleave,
        "byte_order": order,
        "wavelength_units": "Nanometers",
        "wavelength": "{" + ", ".join(map(str, WAVES)) + "}",
    } | fields
    path.write_text(
        "ENVI\n"
        + "".join(
            f"{key.replace('_', ' ')} = {value}\n"
            for key, value in lines.items()
            if value is not None
        )
    )
    raw = (
        bytes(int(lines["header_offset"]))
        + cube.transpose(INTERLEAVES[interleave]).astype(kind).tobytes()
    )
    path.with_name(path.stem + data).write_bytes(raw + bytes(extra))
    return path


def values(path, **options):
    return gs.open_scene(path, **options).content.values


# ---- Spectral Python's files


@pytest.mark.parametrize("interleave", INTERLEAVES)
@pytest.mark.parametrize("code", TYPES)
@pytest.mark.parametrize("order", [0, 1])
def test_spectral_pythons_files(tmp_path, interleave, code, order):
    """Every interleave, type and order of bytes; its own reader, with the factor, is the judge."""
    from spectral.io import envi

    cube = np.moveaxis(CUBE, 0, -1).astype(TYPES[code])
    metadata = {
        "wavelength": WAVES / 1000,
        "wavelength units": "Micrometers",
        "reflectance scale factor": 128.0,
    }
    envi.save_image(
        str(tmp_path / "a.hdr"),
        cube,
        dtype=TYPES[code],
        interleave=interleave,
        byteorder=order,
        ext="img",
        metadata=metadata,
    )
    scene = gs.open_scene(tmp_path / "a.hdr")
    np.testing.assert_allclose(scene.wavelengths, WAVES, rtol=1e-12)
    assert scene.light_is_known and scene.content.values.dtype == np.float32 and not scene.notes
    judged = np.asarray(envi.open(str(tmp_path / "a.hdr")).load())
    np.testing.assert_array_equal(scene.content.values, np.moveaxis(judged, -1, 0))
    np.testing.assert_array_equal(scene.content.values, CUBE / 128)  # a power of 2: exact


def test_spectral_pythons_library_is_a_scene_of_patches(tmp_path):
    import spectral
    from spectral.io import envi

    spectra = RANDOM.random((5, 4)).astype(np.float32)
    library = envi.SpectralLibrary(
        spectra, {"wavelength": WAVES[::-1], "spectra names": list("abcde")}
    )
    library.bands = spectral.BandInfo()
    library.bands.centers, library.bands.band_unit = list(WAVES[::-1]), "nm"
    library.metadata["file type"] = "ENVI Spectral Library"
    library.save(str(tmp_path / "a"))
    scene = gs.open_scene(tmp_path / "a.hdr", size=(30, 20))
    assert scene.shape == (20, 30) and "5 spectra as patches, 3 x 2" in scene.notes[0]
    np.testing.assert_array_equal(scene.content.spectra, np.vstack([spectra[:, ::-1], np.zeros(4)]))
    np.testing.assert_array_equal(scene.content.ids[5::10, 5::10], [[0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(scene.wavelengths, WAVES)


# ---- by hand


def test_piece_by_piece(tmp_path, monkeypatch):
    """Files of more than a piece, rows that no piece divides."""
    cube = RANDOM.random((4, 37, 11)).astype(np.float32)
    monkeypatch.setattr("gpusim.io.scene.stacks.PIECE", 5 * 4 * 4 * 11)
    for interleave in INTERLEAVES:
        path = write(tmp_path / f"{interleave}.hdr", cube, interleave=interleave)
        np.testing.assert_array_equal(values(path), cube)


@pytest.mark.parametrize(
    "name, data",
    [
        ("a.hdr", "a"),
        ("a.HDR", "a.DAT"),
        ("a.raw.hdr", "a.raw"),
        ("a.b.hdr", "a.b.bil"),
        ("a.hdr", "a.bin"),
    ],
)
def test_where_data_are(tmp_path, name, data):
    write(tmp_path / "x.hdr", CUBE)
    (tmp_path / "x.hdr").rename(tmp_path / name)
    (tmp_path / "x.raw").rename(tmp_path / data)
    np.testing.assert_array_equal(values(tmp_path / name, scale=1), CUBE)


def test_several_data_files(tmp_path):
    path = write(tmp_path / "a.hdr", CUBE, reflectance_scale_factor=100)
    (tmp_path / "a.dat").write_bytes(b"notes")  # not of this size
    np.testing.assert_array_equal(values(path), CUBE / np.float32(100))
    (tmp_path / "a.dat").write_bytes((tmp_path / "a.raw").read_bytes())
    with refused(path, "several data files", "a.raw, a.dat", "a.raw.hdr", error=BadFile):
        gs.open_scene(path)
    (tmp_path / "a.dat").unlink()
    (tmp_path / "a.img").symlink_to(tmp_path / "a.raw")  # the same by two names
    gs.open_scene(path)
    (tmp_path / "a.raw").unlink()
    with refused(path, "no data file", ".raw, .img", error=BadFile):
        gs.open_scene(path)


def test_data_that_are_no_file(tmp_path):
    path = write(tmp_path / "a.hdr", CUBE)
    (tmp_path / "a.raw").unlink()
    (tmp_path / "a.raw").mkdir()
    with refused(path, "no data file", error=BadFile):
        gs.open_scene(path)
    os.mkfifo(tmp_path / "a.img")
    with refused("a.img", "is a pipe", error=BadFile):
        gs.open_scene(path)


def test_the_header_of_data_is_said(tmp_path):
    write(tmp_path / "a.hdr", CUBE)
    (tmp_path / "b").write_bytes(b"")
    (tmp_path / "b.hdr").write_bytes(b"")
    for name in ("a.raw", "b"):
        with refused(name, f"open its header {name[0]}.hdr", error=BadFile):
            gs.open_scene(tmp_path / name)


def test_headers_as_people_write_them(tmp_path):
    """Letters of Windows, comments, lists over lines, names in capitals, fields of no interest, an offset."""
    path = write(
        tmp_path / "a.hdr", CUBE / 100, header_offset=7, wavelength=None, wavelength_units="\u00b5m"
    )
    text = path.read_text().replace("samples", "SAMPLES").replace("data type", "Data  Type") + (
        "; wavelength = {1, 2}\ndescription = {\n a = b, 3\n}\nwavelength = {\n 0.4105,\n;0.45,\n 0.5, 0.57\n"
        ",0.65525\n}\nno field\nmap info = {UTM, 1}\n"
    )
    path.write_bytes(text.replace("\n", "\r\n").encode("cp1252"))
    scene = gs.open_scene(path)
    np.testing.assert_array_equal(scene.content.values, CUBE / 100)
    np.testing.assert_allclose(scene.wavelengths, WAVES, rtol=1e-12)


@pytest.mark.parametrize(
    "unit, factor, note",
    [
        ("nm", 1, None),
        ("Micrometers", 1e-3, None),
        ("um", 1e-3, None),
        ("Angstroms", 10, None),
        (None, 1, "taken as nm"),
        ("Unknown", 1e-3, "taken as um"),
    ],
)
def test_units_of_wavelengths(tmp_path, unit, factor, note):
    path = write(
        tmp_path / "a.hdr",
        CUBE / 100,
        wavelength_units=unit,
        wavelength="{" + ",".join(str(nm * factor) for nm in WAVES) + "}",
    )
    scene = gs.open_scene(path)
    np.testing.assert_allclose(scene.wavelengths, WAVES, rtol=1e-12)
    assert [note in one for one in scene.notes] == ([True] if note else [])


@pytest.mark.parametrize("code", [2, 4, 12, 13])
def test_headers_without_a_byte_order(tmp_path, code):
    """The first byte is then the least significant one, as ENVI writes on a PC."""
    path = write(tmp_path / "a.hdr", CUBE, code=code, byte_order=None)
    scene = gs.open_scene(path, scale=100)
    np.testing.assert_allclose(scene.content.values, CUBE / 100, rtol=2.0**-23)
    assert scene.notes == ("byte order is missing: taken as 0, least significant byte first",)
    kind = write(tmp_path / "b.hdr", CUBE / 100, code=1, byte_order=None)
    assert gs.open_scene(kind, scale=100).notes == ()  # bytes have no order


def test_fields_that_are_not_used_are_named(tmp_path):
    fields = {
        "map_info": "{UTM, 1, 1, 5e5, 4e6, 30, 30, 13, North}",
        "coordinate_system_string": "{PROJCS[a]}",
        "fwhm": "{9.5, 9.6, 10, 12}",
        "acquisition_time": "2026-01-01T00:00:00Z",
        "description": "{a}",
        "band_names": "{a, b, c, d}",
        "default_bands": "{3, 2, 1}",
        "sensor_type": "x",
    }
    scene = gs.open_scene(write(tmp_path / "a.hdr", CUBE / 100, **fields))
    assert scene.notes == (
        "fwhm 9.5 .. 12 of the bands: their means are taken as samples",
        "fields of the header not used: map info, coordinate system string, acquisition time",
    )
    # a factor of another quantity
    path = write(tmp_path / "a.hdr", CUBE / 100, reflectance_scale_factor=100)
    scene = gs.open_scene(path, kind="radiance")
    assert scene.notes == ("fields of the header not used: reflectance scale factor",)


def test_bands_out_of_order_and_bad_ones(tmp_path):
    path = write(
        tmp_path / "a.hdr", CUBE / 100, wavelength="{700, 500, 600, 400}", bbl="{1, 1, 0, 1.0}"
    )
    scene = gs.open_scene(path)
    np.testing.assert_array_equal(scene.wavelengths, [400, 500, 700])
    np.testing.assert_array_equal(scene.content.values, CUBE[[3, 1, 0]] / 100)
    assert scene.notes == ("bands marked bad by bbl are left out: 1 of 4",)
    # bands that overlap are told apart only by leaving one out
    np.testing.assert_array_equal(
        values(write(path, CUBE, wavelength="{700, 500, 500, 400}", bbl="{1, 1, 0, 1}"), scale=1),
        CUBE[[3, 1, 0]],
    )


def test_wavelengths_that_a_user_gives_take_the_place_of_the_headers(tmp_path):
    path = write(tmp_path / "a.hdr", CUBE / 100, wavelength=None)
    np.testing.assert_array_equal(gs.open_scene(path, wavelengths=WAVES).wavelengths, WAVES)
    with refused("wavelengths", "4, one for each band", error=OutOfRange):
        gs.open_scene(path, wavelengths=[400, 500])
    with refused(path, "no wavelengths", "--wavelengths", error=BadFile):
        gs.open_scene(path)


# ---- what the numbers are


def test_radiance_is_in_watts(tmp_path):
    scene = gs.open_scene(write(tmp_path / "a.hdr", CUBE), kind="radiance")
    assert not scene.light_is_known
    photons = CUBE * (WAVES * 1e-9 / PHOTON)[:, None, None]
    np.testing.assert_allclose(
        scene.content.values, photons, rtol=3e-7
    )  # three roundings of float32
    # 1 uW cm-2 nm-1 sr-1 is 1e-6 W of 1e-4 m2: a hundredth
    np.testing.assert_allclose(
        values(tmp_path / "a.hdr", kind="radiance", scale=100), photons / 100, rtol=3e-7
    )


def test_gains_and_offsets(tmp_path):
    """Radiance of gains is in W m-2 sr-1 um-1, as ENVI has it; those of reflectance have no unit."""
    gains, offsets = np.array([0.5, 0.25, 2, 1]), np.array([1.0, 0, 3, 4])
    fields = {"data_gain_values": "{0.5, 0.25, 2, 1}", "data_offset_values": "{1, 0, 3, 4}"}
    path = write(tmp_path / "a.hdr", CUBE, code=2, **fields)
    scene = gs.open_scene(path)
    watts = (CUBE * gains[:, None, None] + offsets[:, None, None]) / 1000
    assert not scene.light_is_known
    np.testing.assert_allclose(
        scene.content.values, watts * (WAVES * 1e-9 / PHOTON)[:, None, None], rtol=4e-7
    )
    with refused(path, "reflectance in whole numbers", "scale", error=BadFile):
        gs.open_scene(path, kind="reflectance")
    fields = {key.replace("data_", "data_reflectance_"): value for key, value in fields.items()}
    scene = gs.open_scene(write(path, CUBE, code=2, **fields, bbl="{0, 1, 1, 1}"))
    assert scene.light_is_known
    np.testing.assert_allclose(scene.content.values, 1000 * watts[1:], rtol=3e-7)


def test_whole_numbers_need_a_factor_and_floats_are_looked_at(tmp_path):
    path = write(tmp_path / "a.hdr", CUBE, code=12)
    with refused(path, "whole numbers", "--scale 10000", error=BadFile):
        gs.open_scene(path)
    np.testing.assert_array_equal(values(path, scale=128), CUBE / 128)
    path = write(tmp_path / "b.hdr", CUBE)
    with refused("b.raw", "reflectances of mean", "scale", error=BadFile):
        gs.open_scene(path)
    np.testing.assert_array_equal(values(path, scale=1), CUBE)
    for scale in (0, -1, np.nan, "x", np.inf):
        with refused("scale", error=OutOfRange):
            gs.open_scene(path, scale=scale)


@pytest.mark.parametrize(
    "code, word",
    [
        (2, "-9999"),
        (4, "-9999"),
        (5, "-9999.0"),
        (4, "nan"),
        (4, "-3.4028235e38"),
        (12, "65535"),
        (15, "18446744073709551615"),
        (4, "-1e34"),
    ],
)
def test_samples_without_data_are_dark(tmp_path, code, word):
    cube = CUBE.astype(TYPES[code])
    cube[:, 1, 2] = cube[2, 0, 0] = int(word) if code == 15 else float(word)
    scene = gs.open_scene(
        write(
            tmp_path / "a.hdr",
            cube,
            code=code,
            data_ignore_value=word,
            reflectance_scale_factor=100,
        )
    )
    wanted = CUBE / np.float32(100)
    wanted[:, 1, 2] = wanted[2, 0, 0] = 0
    np.testing.assert_array_equal(scene.content.values, wanted)
    assert scene.notes == ("no data in 13 % of the samples: dark",)  # 2 of 15


@pytest.mark.parametrize(
    "code, word", [(1, "-9999"), (12, "70000"), (3, "1e300"), (2, "nan"), (2, "0.5"), (4, "5e5")]
)
def test_marks_of_no_data_that_nothing_has(tmp_path, code, word):
    path = write(
        tmp_path / "a.hdr", CUBE, code=code, data_ignore_value=word, reflectance_scale_factor=8
    )
    scene = gs.open_scene(path)
    np.testing.assert_array_equal(scene.content.values, CUBE / 8)
    assert not scene.notes


def test_noise_below_zero(tmp_path):
    cube = CUBE / 100
    cube[1, 1, 1], cube[2, 2, 2] = -0.01, -0.02
    scene = gs.open_scene(write(tmp_path / "a.hdr", cube))
    np.testing.assert_array_equal(scene.content.values, np.maximum(cube, 0))
    assert scene.notes == ("negative values, 3.3 % of them, lowest -0.02: taken as 0",)  # 2 of 60
    cube[1, 1, 1] = -9.999
    with refused("a.raw", "negative values (lowest -10", error=BadFile):
        gs.open_scene(write(tmp_path / "a.hdr", cube))


# ---- refusals


@pytest.mark.parametrize("there", [0, 10, 239])
def test_truncated_data_are_named_with_their_bytes(tmp_path, there):
    path = write(tmp_path / "a.hdr", CUBE, header_offset=16)
    (tmp_path / "a.raw").write_bytes(bytes(16 + there))
    with refused(
        "a.raw", "truncated", "240 bytes from byte 16", f"{there} are there", error=BadFile
    ):
        gs.open_scene(path)
    (tmp_path / "a.raw").write_bytes(b"")
    with refused("truncated", "0 are there", error=BadFile):
        gs.open_scene(path)


def test_more_data_than_the_header_says(tmp_path):
    assert "7 bytes more" in gs.open_scene(write(tmp_path / "a.hdr", CUBE / 100, extra=7)).notes[0]


@pytest.mark.parametrize(
    "fields, said",
    [
        ({"data_type": 6}, "complex"),
        ({"data_type": 9}, "complex"),
        ({"data_type": 7}, "wanted one of 1, 2"),
        ({"data_type": None}, "lacks 'data type'"),
        ({"samples": 0}, "samples = '0'"),
        ({"lines": -5}, "1 or more"),
        ({"bands": "9" * 5000}, "whole number"),
        ({"samples": 1.5}, "whole number"),
        ({"header_offset": -1}, "0 or more"),
        ({"byte_order": 2}, "byte order = 2"),
        ({"interleave": "bis"}, "wanted bsq, bil or bip"),
        ({"file_compression": 1}, "compressed"),
        ({"major_frame_offsets": "{0, 8}"}, "between lines"),
        ({"file_type": "ENVI Classification"}, "no spectra"),
        ({"wavelength": "{400, 500}"}, "2 numbers, wanted 4"),
        ({"wavelength": "{400, 500, nan, 700}"}, "finite"),
        ({"wavelength": "{a, b, c, d}"}, "numbers in braces"),
        ({"wavelength": "{400, 500, 500, 700}"}, "all different"),
        ({"wavelength": "{400, 500"}, "has no end"),
        ({"wavelength_units": "Wavenumber"}, "wavelength units"),
        ({"wavelength_units": "um"}, "not plausible"),
        ({"bbl": "{0, 0, 0, 0}"}, "0 bands"),
        ({"bbl": "{1}"}, "wanted 4"),
        ({"Lines": 7}, "two different values for 'lines'"),
        ({"reflectance_scale_factor": 0}, "stands for 1"),
        ({"reflectance_scale_factor": "x"}, "wanted a number"),
        ({"data_ignore_value": "x"}, "wanted a number"),
        ({"file_type": "ENVI Spectral Library"}, "library of 4 bands"),
        ({"lines": 10**14, "samples": 10**14}, "truncated"),
    ],
)
def test_refusals_of_headers(tmp_path, fields, said):
    path = write(tmp_path / "a.hdr", CUBE / 100)
    lines = path.read_text().splitlines()
    for key, value in fields.items():
        name = key.replace("_", " ")
        lines = [line for line in lines if not line.startswith(f"{name} =")]
        lines += [] if value is None else [f"{name} = {value}"]
    path.write_text("\n".join(lines))
    with refused("a.", said, error=BadFile):
        gs.open_scene(path)


@pytest.mark.parametrize(
    "data, said",
    [
        (
            b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n\xff\xfe\x00\x80",
            "a Radiance picture",
        ),
        (b"BYTEORDER I\nNROWS 3\n", "not ENVI"),
        (b"", "not ENVI"),
        (b"\x00" * 99, "not ENVI"),
        (b"ENVI\n" + b"x" * 2**20, "more than 1 MiB"),
    ],
)
def test_other_headers(tmp_path, data, said):
    (tmp_path / "a.hdr").write_bytes(data)
    with refused("a.hdr", said, error=BadFile):
        gs.open_scene(tmp_path / "a.hdr")


def test_options(tmp_path):
    path = write(tmp_path / "a.hdr", CUBE / 100)
    with refused("'light'", "radiance", error=UnknownName):
        gs.open_scene(path, kind="light")
    with refused("size", "its own size", error=OutOfRange):
        gs.open_scene(path, size=(4, 4))
    with refused("bands", ".exr only", error=OutOfRange):
        gs.open_scene(path, bands={"a": 500})


def test_it_asks_for_memory_before_it_takes_it(tmp_path, monkeypatch):
    path, asked = write(tmp_path / "a.hdr", np.ones((4, 300, 400), np.float32), code=5), []
    with monkeypatch.context() as patched:
        patched.setattr(
            "gpusim.io.scene.stacks.require_memory", lambda what, needed: asked.append(needed)
        )
        gs.open_scene(path)
        with takes(asked[0] + 2**20):  # 1 MiB: header, spectra, names
            gs.open_scene(path)
    monkeypatch.setattr("gpusim.domain.memory.host_memory", lambda: 2**20)
    with refused("4 planes of 400 x 300", error=DoesNotFit):
        gs.open_scene(path)


def test_command_line(tmp_path, capsys):
    path = write(tmp_path / "a.hdr", np.full((4, 24, 32), 30), code=12, wavelength=None)
    asked = ["plan", str(path), "--camera", "phone", "--device", "numpy"]
    assert main(asked) == 2 and "--wavelengths" in capsys.readouterr().err
    assert (
        main([*asked, "--wavelengths", "400:700:100"]) == 2 and "--scale" in capsys.readouterr().err
    )
    assert main([*asked, "--wavelengths", "400:700:100", "--scale", "100"]) == 0

"""Stacks of planes as NumPy arrays, and tables of spectra as scenes of patches."""

import csv
import io

import numpy as np
import pytest
from refusals import refused, takes

import gpusim as gs
from gpusim.cli.main import main
from gpusim.data.reflectances import reflectances
from gpusim.domain.errors import BadFile, GpusimError, OutOfRange, UnknownName
from gpusim.io.scene.readers import IN_FOLDERS, READERS

RANDOM = np.random.default_rng(12)
WAVES = [400.0, 500.0, 570.0, 655.25]
PHOTON = 1.98644586e-25  # [J m] h c, CODATA 2018, nine digits
CUBE = RANDOM.integers(0, 100, (4, 5, 3))  # (bands, rows, cols)


def stack(path, array, **options):
    np.save(path, array)
    return gs.open_scene(path, **({"wavelengths": WAVES} | options))


# ---- the table of readers


def test_options_are_refused_by_the_table(tmp_path):
    """Of every kind of file and every option that it does not take, before the file is opened."""
    given = {
        "bands": {"a": 500},
        "wavelengths": WAVES,
        "kind": "radiance",
        "scale": 2.0,
        "size": (8, 8),
        "ray": {"depth": "ray", "fov": 1.0},
    }
    for suffix, reader in READERS.items():
        for option, value in given.items():
            options = value if option == "ray" else {option: value}
            if suffix.startswith(".tif") and option in ("kind", "scale"):
                options["wavelengths"] = WAVES  # without them it is a photograph
            with refused(error=BadFile if option in reader.options else OutOfRange):
                gs.open_scene(tmp_path / f"none{suffix}", **options)
        with refused("no such file", error=BadFile):
            gs.open_scene(
                tmp_path / f"none{suffix}",
                depth="none",
                wavelengths=WAVES if suffix == ".npy" else None,
            )
    with refused(
        "kind = 'radiance'", ".tif, .tiff, .hdr, .npy, .csv only, not for flat", error=OutOfRange
    ):
        gs.open_scene("flat", kind="radiance")


def test_tables_of_numbers_beside_pictures_are_no_frames():
    assert ".csv" in READERS and set(READERS) - set(IN_FOLDERS) == {".csv"}


# ---- .npy


@pytest.mark.parametrize("kind", ["u1", "<u2", ">u2", "f2", "<f4", ">f4", "<f8"])
@pytest.mark.parametrize("pixels_first", [False, True])
@pytest.mark.parametrize("order", ["C", "F"])
def test_stacks_of_arrays(tmp_path, kind, pixels_first, order):
    cube = CUBE.astype(kind) if kind[-2] == "u" else (CUBE / 128).astype(kind)
    stored = np.asarray(np.moveaxis(cube, 0, -1) if pixels_first else cube, order=order)
    scene = stack(tmp_path / "a.npy", stored)
    white = np.float32({"u1": 255, "u2": 65535}.get(kind[-2:], 1))
    np.testing.assert_array_equal(scene.content.values, cube.astype(np.float32) / white)
    np.testing.assert_array_equal(scene.wavelengths, WAVES)
    assert scene.light_is_known and not scene.notes


def test_whole_numbers_kinds_and_scales(tmp_path):
    for kind in (np.int8, np.int16, np.uint32, np.int64):
        with refused("a.npy", f"whole numbers of type {np.dtype(kind)}", "scale", error=BadFile):
            stack(tmp_path / "a.npy", CUBE.astype(kind))
        np.testing.assert_array_equal(
            stack(tmp_path / "a.npy", CUBE.astype(kind), scale=100).content.values,
            CUBE.astype(np.float32) / np.float32(100),
        )
    scene = stack(tmp_path / "a.npy", CUBE / 8, kind="radiance")
    assert not scene.light_is_known
    np.testing.assert_allclose(
        scene.content.values, CUBE / 8 * (np.array(WAVES) * 1e-9 / PHOTON)[:, None, None], rtol=3e-7
    )  # three roundings of float32
    with refused("reflectances of mean", error=BadFile):
        stack(tmp_path / "a.npy", CUBE / 8)


@pytest.mark.parametrize(
    "array, said",
    [
        (np.zeros((4, 5, 4)), "(bands, rows, cols) or (rows, cols, bands)"),
        (np.zeros((5, 4, 3)), "wanted (4, rows, cols)"),
        (np.zeros((4, 5)), "shape (4, 5)"),
        (np.zeros((4, 0, 3)), "shape (4, 0, 3)"),
        (np.zeros((4, 5, 3), bool), "bool"),
        (np.zeros((4, 5, 3), complex), "complex"),
        (np.zeros((4, 5, 3), "U3"), "real numbers"),
        (np.full((4, 5, 3), np.nan), "NaN"),
        (np.full((4, 5, 3), 1e39), "float32"),
        (np.full((4, 5, 3), -1.0), "negative"),
        (np.zeros((4, 5, 3), [("a", "f4")]), "real numbers"),
        (np.array([{}] * 4), "real numbers"),
    ],
)
def test_refusals_of_arrays(tmp_path, array, said):
    with refused("a.npy", said, error=BadFile):
        stack(tmp_path / "a.npy", array)


def test_arrays_that_end_early_and_no_arrays(tmp_path):
    path = tmp_path / "a.npy"
    stack(path, CUBE / 128)
    data = path.read_bytes()
    for damaged, said in (
        (data[:-1], "480 bytes of numbers expected, 479"),
        (data + b"x", "481 present"),
        (data[:20], "truncated"),
        (b"", "truncated"),
        (b"PK" + data, "not a NumPy array"),
    ):
        path.write_bytes(damaged)
        with refused(path, said, error=BadFile):
            gs.open_scene(path, wavelengths=WAVES)
    with refused(path, "has no wavelengths", "--wavelengths", error=BadFile):
        gs.open_scene(path)


def test_it_takes_the_memory_that_it_asks_for(tmp_path, monkeypatch):
    asked = []
    stack(tmp_path / "a.npy", np.ones((300, 400, 4)))
    monkeypatch.setattr(
        "gpusim.io.scene.stacks.require_memory", lambda what, needed: asked.append(needed)
    )
    gs.open_scene(tmp_path / "a.npy", wavelengths=WAVES)
    with takes(asked[0] + 2**20):  # 1 MiB: header, spectra, names
        gs.open_scene(tmp_path / "a.npy", wavelengths=WAVES)


def test_what_is_read_of_damaged_arrays_is_what_numpy_reads(tmp_path):
    """Numbers of the file as float32, in float32 divided by white; noise below 0 is 0."""
    import fuzz

    inputs, path, read = fuzz.Inputs("array", tmp_path), tmp_path / "a.npy", 0
    for number in range(250):
        path.write_bytes(inputs.make(9, number))
        try:
            scene = gs.open_scene(path, wavelengths=fuzz.WAVES)
        except GpusimError:
            continue
        with np.errstate(over="ignore"):
            array = np.load(path).astype(np.float32) / np.float32(
                {"|u1": 255, "<u2": 65535, ">u2": 65535}.get(np.load(path).dtype.str, 1)
            )
        np.testing.assert_array_equal(
            scene.content.values,
            np.maximum(array if len(array) == 3 else np.moveaxis(array, -1, 0), 0),
        )
        read += 1
    assert read > 10


# ---- .csv


def table(
    path, nm, spectra, heading="wavelength_nm", names=None, divider=",", turned=False, decimal="."
):
    """Write spectra (spectra, L) as Python's csv does."""
    rows = [
        [f"{one:.17g}".replace(".", decimal) for one in line] for line in np.vstack([nm, spectra]).T
    ]
    if heading is not None:
        rows = [[heading, *(names or [f"patch {number}" for number in range(len(spectra))])], *rows]
    buffer = io.StringIO()
    csv.writer(buffer, delimiter=divider).writerows(zip(*rows, strict=True) if turned else rows)
    path.write_text(buffer.getvalue())
    return path


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("heading", ["wavelength_nm", "", "Wavelength [nm]", None])
@pytest.mark.parametrize("divider, decimal", [(",", "."), (";", ","), (";", "."), ("\t", ".")])
def test_tables_of_spectra(tmp_path, turned, heading, divider, decimal):
    checker = reflectances("colorchecker")
    scene = gs.open_scene(
        table(
            tmp_path / "a.csv",
            checker.wavelengths,
            checker.values,
            heading,
            None,
            divider,
            turned,
            decimal,
        )
    )
    np.testing.assert_array_equal(scene.wavelengths, checker.wavelengths)
    np.testing.assert_array_equal(scene.content.spectra, checker.values)
    assert scene.shape == (512, 768) and scene.notes == (
        "24 spectra as patches, 6 x 4, row by row",
    )
    np.testing.assert_array_equal(scene.content.ids[64::128, 64::128], np.arange(24).reshape(4, 6))


def test_tables_as_people_write_them(tmp_path):
    """Names that are numbers, micrometres, descending, comments, a byte-order mark, empty cells at the end."""
    path = tmp_path / "a.csv"
    path.write_bytes(
        "# measured\r\nWavelength (\u00b5m),1,2,,\r\n0.7,0.3,0.5,,\r\n0.55,0.2,0.6,,\r\n,,,,\r\n"
        "0.4,0.1,0.7,,\r\n".encode("utf-8-sig")
    )
    scene = gs.open_scene(path, size=(20, 10))
    np.testing.assert_allclose(scene.wavelengths, [400, 550, 700], rtol=1e-15)
    np.testing.assert_array_equal(scene.content.spectra, [[0.1, 0.2, 0.3], [0.7, 0.6, 0.5]])
    assert scene.shape == (10, 20)
    path.write_text("nr,name,400,500,600\n1,dark skin,0.1,0.1,0.9\n2,light skin,0.8,0.1,0.1\n")
    np.testing.assert_array_equal(
        gs.open_scene(path).content.spectra, [[0.1, 0.1, 0.9], [0.8, 0.1, 0.1]]
    )
    path.write_text("Reflectances,1,2\nname,a,b\nwavelength um,,\n0.4,0.1,0.8\n0.5,0.1,0.1\n")
    np.testing.assert_array_equal(gs.open_scene(path).content.spectra, [[0.1, 0.1], [0.8, 0.1]])
    path.write_text("name,400nm,500nm,600nm\nred,0.1,0.1,0.9\nblue,0.8,0.1,0.1\n")
    np.testing.assert_array_equal(
        gs.open_scene(path).content.spectra, [[0.1, 0.1, 0.9], [0.8, 0.1, 0.1]]
    )


@pytest.mark.parametrize(
    "count, size, cells",
    [
        (1, (8, 8), (1, 1)),
        (2, (8, 8), (1, 2)),
        (5, (30, 20), (3, 2)),
        (7, (9, 9), (3, 3)),
        (300, (90, 60), (21, 15)),
    ],
)
def test_patches_of_any_number(tmp_path, count, size, cells):
    spectra = RANDOM.random((count, 4))
    scene = gs.open_scene(table(tmp_path / "a.csv", WAVES, spectra), size=size)
    assert f"{count} spectra as patches, {cells[0]} x {cells[1]}," in scene.notes[0]
    np.testing.assert_array_equal(
        np.unique(scene.content.ids), np.arange(min(count + 1, cells[0] * cells[1]))
    )
    np.testing.assert_array_equal(scene.content.spectra[:count], spectra)
    assert not scene.content.spectra[count:].any()  # cells that are left over


def test_kinds_and_scales_of_tables(tmp_path):
    spectra = RANDOM.random((3, 4)) * 100
    path = table(tmp_path / "a.csv", WAVES, spectra)
    with refused(path, "reflectances of mean", "scale", error=BadFile):
        gs.open_scene(path)
    np.testing.assert_allclose(
        gs.open_scene(path, scale=100, size=(30, 10)).content.spectra, spectra / 100, rtol=1e-15
    )
    scene = gs.open_scene(path, kind="radiance", size=(30, 10))
    assert not scene.light_is_known
    np.testing.assert_allclose(
        scene.content.spectra, spectra * np.array(WAVES) * 1e-9 / PHOTON, rtol=1e-8
    )


@pytest.mark.parametrize(
    "text, said",
    [
        ("", "0 lines"),
        ("wavelength_nm,a\n", "1 lines"),
        ("a,b\n1,2\n3,4\n", "wavelengths [nm] in the first column"),
        ("nm,a\n400,1\n500,x\n", "spectrum 1 at 500 nm"),
        ("nm,a\n400,1\n500,\n", "spectrum 1 at 500 nm"),
        ("nm,a\n400,1\n500\n", "lines of 1 to 2 cells"),
        ("nm,a\n400,1\n400,2\n", "wavelengths"),
        ("nm,a\n400,1\n500,nan\n", "not a number"),
        ("nm,a\n400,1\n500,-1\n", "negative"),
        ("nm,a\n0.4,1\n0.5,1\n", "wavelengths"),
        ("nm,a\n4x0,1\n500,1\n600,1\n", "wavelengths"),
        ("name,4x0,500,600\na,1,2,3\n", "wavelengths"),
        ("nm,a\n400,1\nx,1\n500,1\n600,1\n", "wavelengths"),
        ("400,500\n500,600\n", "both"),
        ("nm,a\n400,1e39\n500,1\n", "scale"),
        ("\0\0,\0\n" * 9, ""),
    ],
)
def test_refusals_of_tables(tmp_path, text, said):
    (tmp_path / "a.csv").write_text(text)
    with refused("a.csv", said, error=BadFile):
        gs.open_scene(tmp_path / "a.csv")


def test_refusals_of_sizes(tmp_path):
    path = table(tmp_path / "a.csv", WAVES, RANDOM.random((24, 4)))
    with refused("size", "at least 5 x 5", error=OutOfRange):
        gs.open_scene(path, size=(5, 4))
    with refused("'light'", error=UnknownName):
        gs.open_scene(path, kind="light")


def test_command_line(tmp_path, capsys):
    path = str(table(tmp_path / "a.csv", WAVES, RANDOM.random((24, 4)) * 100))
    asked = ["plan", path, "--camera", "phone", "--device", "numpy", "--size", "48x32"]
    assert main(asked) == 2 and "--scale" in capsys.readouterr().err
    assert main([*asked, "--scale", "100"]) == 0

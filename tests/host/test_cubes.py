"""Hyperspectral cubes of MATLAB and HDF5 files, as data bases and other programs write them."""

import struct

import h5py
import hdf5storage
import numpy as np
import pytest
import scipy.io
from matlab import save73
from refusals import refused

import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.errors import BadFile, OutOfRange

NM = np.arange(400, 701, 10.0)
RANDOM = np.random.default_rng(3)
CUBE = RANDOM.uniform(0.05, 0.9, (8, 6, 31))  # rows, columns, bands
SINGLE = 2.0**-24  # numbers are rounded to float32 once


def read(path, **options):
    """Wavelengths, numbers (rows, cols, bands) and notes of a scene."""
    scene = gs.open_scene(path, **options)
    return scene.wavelengths, np.moveaxis(np.asarray(scene.content.values), 0, -1), scene.notes


def same(found, wanted=CUBE, nm=NM, scale=1.0, rounded=SINGLE):
    np.testing.assert_array_equal(found[0], nm)
    np.testing.assert_allclose(found[1], wanted / scale, rtol=rounded)


def hdf5(path, values, **attributes):
    """Write {path in the file: array or (array, attributes)} as h5py does."""
    with h5py.File(path, "w") as file:
        for name, value in values.items():
            array, own = value if isinstance(value, tuple) else (value, {})
            file[name] = array
            file[name].attrs.update(own)
        file.attrs.update(attributes)
    return path


# ---- data bases


def test_bands_next_to_a_cube_of_matlab_7_3(tmp_path):
    """ICVL: rad and bands, axes reversed; judged by hdf5storage."""
    save73(tmp_path / "a.mat", {"bands": NM[None], "rad": CUBE})
    theirs = hdf5storage.loadmat(str(tmp_path / "a.mat"))["rad"]
    found = read(tmp_path / "a.mat")
    same(found, theirs)
    assert "wavelengths from bands: 31 of 400 .. 700 nm" in found[2]
    assert any("taken as reflectances" in note for note in found[2])


def test_a_picture_next_to_a_cube_is_named(tmp_path):
    save73(tmp_path / "a.mat", {"bands": NM[None], "rad": CUBE, "rgb": CUBE[..., :3]})
    found = read(tmp_path / "a.mat")
    same(found)
    assert "not used: rgb" in found[2]


def test_cubes_that_hdf5storage_writes(tmp_path):
    """ARAD_1K (NTIRE): cube, bands, norm_factor."""
    variables = {"cube": CUBE.astype(np.float32), "bands": NM, "norm_factor": 3.5}
    hdf5storage.savemat(str(tmp_path / "a.mat"), variables, fmt="7.3")
    found = read(tmp_path / "a.mat")
    same(found)
    assert "not used: norm_factor" in found[2]


def test_a_mask_next_to_a_cube_of_version_5(tmp_path):
    """Harvard: ref, lbl, and the sensitivity of the camera; wavelengths are in its paper only."""
    variables = {"ref": CUBE, "lbl": np.ones((8, 6), np.uint8), "calib": np.linspace(2, 1, 31)}
    scipy.io.savemat(tmp_path / "a.mat", variables, do_compression=True)
    with refused("a.mat", "no wavelengths", "ref (8 x 6 x 31)", error=BadFile):
        gs.open_scene(tmp_path / "a.mat")
    found = read(tmp_path / "a.mat", wavelengths=NM + 20)
    same(found, nm=NM + 20)
    assert "not used: lbl, calib" in found[2]


@pytest.mark.parametrize("vector", [np.arange(1, 32.0), np.linspace(0.3, 1.4, 31)[::-1]])
def test_numbers_that_are_no_wavelengths(tmp_path, vector):
    scipy.io.savemat(tmp_path / "a.mat", {"ref": CUBE, "calib": vector})
    with refused("a.mat", "no wavelengths", error=BadFile):
        gs.open_scene(tmp_path / "a.mat")


def test_fifty_nine_bands_under_any_name(tmp_path):
    """TokyoTech: 420 .. 1000 nm."""
    nm, cube = np.arange(420, 1001, 10.0), RANDOM.uniform(0, 1, (5, 7, 59))
    scipy.io.savemat(tmp_path / "a.mat", {"Butterfly": cube})
    same(read(tmp_path / "a.mat", wavelengths=nm), cube, nm)
    scipy.io.savemat(tmp_path / "a.mat", {"Butterfly": cube, "x": nm})
    same(read(tmp_path / "a.mat"), cube, nm)


def test_a_name_with_a_backslash(tmp_path):
    """KAUST: the data set is named img\\, bands first."""
    cube = RANDOM.uniform(0, 1, (34, 9, 8)).astype(np.float32)
    nm = np.arange(400, 731, 10.0)
    path = hdf5(tmp_path / "a.h5", {"img\\": cube})
    found = read(path, wavelengths=nm, key="img\\")
    same(found, np.moveaxis(cube, 0, -1), nm)
    same(read(path, wavelengths=nm), np.moveaxis(cube, 0, -1), nm)


def test_whole_numbers_of_pushbrooms(tmp_path):
    """Pavia, Indian Pines, Chikusei: one array, no wavelengths; judged by SciPy."""
    cube, nm = RANDOM.integers(0, 8000, (7, 5, 103)).astype(np.uint16), np.linspace(430, 860, 103)
    scipy.io.savemat(tmp_path / "a.mat", {"paviaU": cube})
    theirs = scipy.io.loadmat(tmp_path / "a.mat")["paviaU"]
    same(read(tmp_path / "a.mat", wavelengths=nm, scale=8000), theirs, nm, 8000, 2 * SINGLE)
    found = read(tmp_path / "a.mat", wavelengths=nm)
    same(found, theirs, nm, 65535, 2 * SINGLE)
    assert "paviaU: whole numbers; 65535 is taken as 1" in found[2]
    scipy.io.savemat(tmp_path / "a.mat", {"chikusei": cube.astype(np.int16)})
    with refused("a.mat", "chikusei: whole numbers of type int16", "scale", error=BadFile):
        gs.open_scene(tmp_path / "a.mat", wavelengths=nm)
    same(read(tmp_path / "a.mat", wavelengths=nm, scale=1e4), theirs, nm, 1e4, 2 * SINGLE)


def test_radiance_in_watts(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"rad": CUBE, "bands": NM})
    scene = gs.open_scene(tmp_path / "a.mat", kind="radiance", scale=100)
    photons = CUBE / 100 * NM * 1e-9 / (6.62607015e-34 * 299792458.0)
    found = np.moveaxis(scene.content.values, 0, -1)
    # two more roundings: the scale, and the energy of a photon in float32
    np.testing.assert_allclose(found, photons, rtol=4 * SINGLE)


# ---- wavelengths


@pytest.mark.parametrize(
    "name, factor, unit",
    [
        ("bands", 1, None),
        ("wavelength_um", 1e-3, None),
        ("lambda", 1e-9, None),
        ("wl", 1e-3, "micrometers"),
        ("Wavelength", 10, "Angstroms"),
        ("centers", 1, "nm"),
    ],
)
def test_units_of_wavelengths(tmp_path, name, factor, unit):
    attributes = {} if unit is None else {"units": unit}
    path = hdf5(tmp_path / "a.hdf5", {"cube": CUBE, name: (NM * factor, attributes)})
    same(read(path))


def test_wavelengths_in_structs_attributes_and_other_groups(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"hs": {"data": CUBE, "wl": NM[:, None]}, "x": 1.0})
    found = read(tmp_path / "a.mat")
    same(found)
    assert "not used: x" in found[2]
    for attributes in ({"wavelengths": NM}, {"wavelength": NM / 1e3, "wavelength_units": "um"}):
        same(read(hdf5(tmp_path / "a.h5", {"/scene/cube": (CUBE, attributes)})))
    same(read(hdf5(tmp_path / "a.h5", {"/scene/cube": CUBE}, wavelengths=NM)))
    text = ", ".join(f"{nm:g}" for nm in NM)
    same(read(hdf5(tmp_path / "a.h5", {"/scene/cube": (CUBE, {"wavelengths": text})})))
    same(read(hdf5(tmp_path / "a.h5", {"/scene/cube": CUBE, "/meta/spectral/Wavelength": NM})))


def test_bands_out_of_order(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"cube": CUBE, "bands": NM[::-1]})
    same(read(tmp_path / "a.mat"), CUBE[..., ::-1])


def test_coordinates_and_numbers_of_bands_are_no_wavelengths(tmp_path):
    """As xarray writes them next to a cube."""
    values = {"cube": CUBE, "y": np.arange(500, 508.0), "x": np.arange(600, 606.0)}
    path = hdf5(tmp_path / "a.nc", values | {"band": np.arange(1, 32)})
    with refused("a.nc", "no wavelengths", error=BadFile):
        gs.open_scene(path)
    two = hdf5(tmp_path / "b.nc", {"cube": CUBE[..., :2], "band": np.arange(1, 3)})
    with refused("b.nc", "no wavelengths", error=BadFile):  # 1 and 2 um
        gs.open_scene(two)
    found = read(hdf5(path, values | {"nm": NM}))
    same(found)
    assert "not used: x, y" in found[2]


def test_two_vectors_of_different_wavelengths_are_refused(tmp_path):
    path = hdf5(tmp_path / "a.h5", {"cube": CUBE, "wave_a": NM, "wave_b": NM + 5})
    with refused("a.h5", "wave_a", "wave_b", "--wavelengths", error=BadFile):
        gs.open_scene(path)
    same(read(path, wavelengths=NM))
    same(read(hdf5(path, {"cube": CUBE, "wave_a": NM, "wave_um": NM / 1e3})))


# ---- choice and axes


@pytest.mark.parametrize("key", ["b", "/b", "group/b", "/group/b", "group.b"])
def test_one_of_several_cubes(tmp_path, key):
    other = CUBE[::-1].copy()
    values = {"a": CUBE, "wavelengths": NM, "group/b": other}
    path = hdf5(tmp_path / "a.h5", values)
    with refused("a.h5", "a (8 x 6 x 31), group/b (8 x 6 x 31)", "key=", error=BadFile):
        gs.open_scene(path)
    found = read(path, key=key)
    same(found, other)
    assert "not used: a" in found[2]


def test_names_that_are_not_there(tmp_path):
    path = hdf5(tmp_path / "a.h5", {"a": CUBE, "wavelengths": NM, "s": "text", "z": CUBE * 1j})
    for key, said in (("cube", "no value is named 'cube'"), ("z", "z: an array of complex128")):
        with refused("a.h5", said, error=BadFile):
            gs.open_scene(path, key=key)
    with refused("a.h5", "wavelengths: 31, wanted an array of three axes", error=BadFile):
        gs.open_scene(path, key="wavelengths")
    with refused("key", error=OutOfRange):
        gs.open_scene("ramp", key="a")
    with refused("a.h5", "31 wavelengths, but no axis", error=BadFile):
        gs.open_scene(hdf5(path, {"a": CUBE[..., :5]}), wavelengths=NM)


def test_axes_are_found_by_the_number_of_bands(tmp_path):
    for axis in (0, 1, 2):
        cube = np.ascontiguousarray(np.moveaxis(CUBE, -1, axis))
        same(read(hdf5(tmp_path / "a.h5", {"a": cube, "wavelengths": NM})))
        scipy.io.savemat(tmp_path / "a.mat", {"a": cube, "wavelengths": NM})
        same(read(tmp_path / "a.mat"))
    same(read(hdf5(tmp_path / "a.h5", {"a": CUBE[None], "wavelengths": NM})))


def test_axes_of_equal_lengths(tmp_path):
    cube = RANDOM.uniform(0, 1, (31, 6, 31))
    save73(tmp_path / "a.mat", {"a": cube, "bands": NM})
    found = read(tmp_path / "a.mat")
    same(found, cube)
    assert any("the last axis" in note for note in found[2])
    with refused("a.h5", "31 x 6 x 31 for 31 wavelengths", error=BadFile):
        gs.open_scene(hdf5(tmp_path / "a.h5", {"a": cube, "bands": NM}))


def test_one_band(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"a": CUBE[..., :1]})  # a last axis of 1 gets lost
    same(read(tmp_path / "a.mat", key="a", wavelengths=[550]), CUBE[..., :1], [550])


# ---- products


def test_scale_and_offset_of_netcdf(tmp_path):
    """As xarray writes integers: number * scale_factor + add_offset."""
    codes = RANDOM.integers(0, 9000, (31, 8, 6)).astype(np.int16)
    codes[:, 2, 3] = -9999
    own = {"scale_factor": 1e-4, "add_offset": 0.01, "_FillValue": np.int16(-9999), "units": "1"}
    path = hdf5(tmp_path / "a.nc", {"reflectance": (codes, own), "wavelength": NM})
    _, found, notes = read(path)
    wanted = np.moveaxis(codes * 1e-4 + 0.01, 0, -1)
    wanted[2, 3] = 0
    np.testing.assert_allclose(found, wanted, rtol=3 * SINGLE)  # code, factor, product
    assert any(note.startswith("no data in 2.1 %") for note in notes)


def test_products_of_neon(tmp_path):
    """int16 with Scale_Factor, the number that stands for 1."""
    codes = RANDOM.integers(0, 9000, (8, 6, 31)).astype(np.int16)
    codes[2, 3] = -9999
    own = {
        "Scale_Factor": 1e4,
        "Data_Ignore_Value": -9999.0,
        "Unit": "unitless",
        "Description": "x",
    }
    site = "SITE/Reflectance"
    values = {
        f"{site}/Reflectance_Data": (codes, own),
        f"{site}/Metadata/Spectral_Data/Wavelength": (NM, {"Units": "nanometers"}),
        f"{site}/Metadata/Spectral_Data/FWHM": NM / 100,
    }
    _, found, notes = read(hdf5(tmp_path / "a.h5", values))
    wanted = codes / 1e4
    wanted[2, 3] = 0
    np.testing.assert_allclose(found, wanted, rtol=3 * SINGLE)
    assert any(note.startswith("not used: SITE/") and "FWHM" in note for note in notes)
    assert "attributes of SITE/Reflectance/Reflectance_Data not used: Description" in notes


@pytest.mark.parametrize(
    "own, said",
    [
        ({"gain": 0.1}, "attribute gain"),
        ({"units": "mW/cm2"}, "in units 'mW/cm2'"),
        ({"scale_factor": "x"}, "attribute scale_factor"),
    ],
)
def test_units_that_are_not_known_are_refused(tmp_path, own, said):
    path = hdf5(tmp_path / "a.h5", {"a": (CUBE, own), "wavelengths": NM})
    with refused("a.h5", said, error=BadFile):
        gs.open_scene(path)
    if "scale_factor" not in own:
        same(read(path, kind="reflectance", scale=2), scale=2)


@pytest.mark.parametrize(
    "unit, factor", [("W m-2 sr-1 nm-1", 1), ("W/m^2/sr/um", 1e3), ("W/(m2 sr nm)", 1)]
)
def test_radiance_by_its_unit(tmp_path, unit, factor):
    path = hdf5(tmp_path / "a.h5", {"a": (CUBE, {"units": unit}), "wavelengths": NM})
    scene = gs.open_scene(path)
    photons = CUBE / factor * NM * 1e-9 / (6.62607015e-34 * 299792458.0)
    found = np.moveaxis(scene.content.values, 0, -1)
    np.testing.assert_allclose(found, photons, rtol=4 * SINGLE)


@pytest.mark.parametrize("packing", [{}, {"compression": "gzip"}, {"compression": "lzf"}])
@pytest.mark.parametrize("chunks", [None, (3, 2, 16)])
def test_pieces_and_packing(tmp_path, packing, chunks):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        shuffled = {"shuffle": True} if packing else {}
        file.create_dataset("a", data=CUBE, chunks=chunks, **packing, **shuffled)
        file["wavelengths"] = NM
    same(read(tmp_path / "a.h5"))


def test_other_packing_and_other_files_are_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset(
            "a", data=(CUBE * 99).astype(np.int16), scaleoffset=0, chunks=CUBE.shape
        )
        file["wavelengths"] = NM
    with refused("a.h5", "filter 6", error=BadFile):
        gs.open_scene(tmp_path / "a.h5", scale=99)
    for data in (b"", b"\x0e\x03\x13\x01" + bytes(99)):  # nothing, and HDF4
        (tmp_path / "b.hdf5").write_bytes(data)
        with refused("b.hdf5", error=BadFile):
            gs.open_scene(tmp_path / "b.hdf5")


def test_groups_that_hold_themselves(tmp_path):
    path = hdf5(tmp_path / "a.h5", {"group/a": CUBE, "wavelengths": NM})
    with h5py.File(path, "r+") as file:
        file["group/again"] = file["group"]
        file["group/root"] = file["/"]
    with refused("a.h5", "more than 4096", error=BadFile):
        gs.open_scene(path)


@pytest.mark.parametrize("size", [0, 2**64 - 16])
def test_texts_that_lead_back_to_themselves(tmp_path, size):
    """HDF5 2.0 reads a part of a global heap without a length for ever; units are a text there."""
    path = hdf5(tmp_path / "a.h5", {"a": CUBE, "wavelengths": (NM, {"units": "nm"})})
    data = bytearray(path.read_bytes())
    at = data.index(b"GCOL") + 16
    while struct.unpack_from("<H", data, at)[0]:  # to the part that is free
        at += 16 + -(-struct.unpack_from("<Q", data, at + 8)[0] // 8) * 8
    struct.pack_into("<Q", data, at + 8, size)
    path.write_bytes(data)
    with refused("a.h5", "leads back to itself", error=BadFile):
        gs.open_scene(path)


def test_attributes_of_other_kinds_are_named(tmp_path):
    """HDF5 2.0 crashes on damaged lists of any length, so that they are not read."""
    path = hdf5(tmp_path / "a.h5", {"a": CUBE, "wavelengths": NM})
    with h5py.File(path, "r+") as file:
        own = file["a"].attrs
        own.create("lists", [np.arange(3), np.arange(2)], dtype=h5py.vlen_dtype(np.int32))
        own["reference"], own["is_good"], own["words"] = file["wavelengths"].ref, True, ["x", "y"]
        own["long"] = np.zeros(7000)
    assert "attributes of a not used: is_good, lists, long, reference, words" in read(path)[2]


def test_isetcams_struct_by_key(tmp_path):
    photons = {"type": "scene", "data": {"photons": CUBE * 1e15}, "spectrum": {"wave": NM}}
    scipy.io.savemat(tmp_path / "a.mat", {"one": photons, "two": photons | {"name": "second"}})
    with refused("a.mat", "(one, two)", "key=", error=BadFile):
        gs.open_scene(tmp_path / "a.mat")
    assert gs.open_scene(tmp_path / "a.mat", key="two").name == "second"


def test_data_of_no_unit_are_not_photons(tmp_path):
    """ISETCam's names, data and wave, but reflectances."""
    scipy.io.savemat(tmp_path / "a.mat", {"data": CUBE, "wave": NM})
    found = read(tmp_path / "a.mat")
    same(found)
    assert any("taken as reflectances" in note for note in found[2])


def test_command_line(tmp_path, capsys):
    path = hdf5(tmp_path / "a.h5", {"a": CUBE, "b": CUBE, "wavelengths": NM})
    asked = ["plan", str(path), "--camera", "phone", "--device", "numpy"]
    assert main(asked) == 2 and "--key" in capsys.readouterr().err
    assert main([*asked, "--key", "/b"]) == 0

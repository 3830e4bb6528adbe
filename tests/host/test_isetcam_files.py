"""ISETCam's scenes and optical images in MATLAB's files, written by SciPy, hdf5storage, h5py and MATLAB itself."""

import math
import re
import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from matlab import save73
from refusals import refused

import gpusim as gs
from gpusim.domain.errors import BadFile, OutOfRange
from gpusim.io.scene.mat import open_mat

WAVES = np.arange(400, 701, 10.0)
RANDOM = np.random.default_rng(8)
SURFACES = RANDOM.uniform(0, 1, (6, 7, 31))  # (rows, cols, L), as MATLAB has it
LIGHT = RANDOM.uniform(1, 9, 31) * 1e15
HC = 6.62607015e-34 * 299792458.0
MATLABS = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
# numbers are kept as float32, and reflectances are divided in it: three roundings
SINGLE = 3 * 2.0**-24


def save_by_hdf5storage(path, variables):
    import hdf5storage as storage

    storage.savemat(str(path), variables, format="7.3")


WRITERS = {
    "5": scipy.io.savemat,
    "5 packed": lambda path, variables: scipy.io.savemat(path, variables, do_compression=True),
    "7.3": save73,
    "7.3 not packed": lambda path, variables: save73(path, variables, None),
    "7.3 by hdf5storage": save_by_hdf5storage,
}


@pytest.fixture(params=WRITERS)
def saved(request, tmp_path):
    """A function that writes variables to a file and opens it as a scene."""

    def save(options=None, **variables):
        (tmp_path / "a.mat").unlink(missing_ok=True)  # hdf5storage would add to it
        WRITERS[request.param](tmp_path / "a.mat", variables)
        return gs.open_scene(tmp_path / "a.mat", **(options or {}))

    return save


@pytest.fixture
def written(tmp_path):
    """A function that writes variables to a file of version 5 and returns its path."""

    def write(**variables):
        scipy.io.savemat(tmp_path / "a.mat", variables)
        return tmp_path / "a.mat"

    return write


def scene_of(**others):
    return {
        "type": "scene",
        "name": "wall",
        "metadata": {"a": [1.0, 2.0]},
        "data": {"photons": SURFACES * LIGHT},
        "spectrum": {"wave": WAVES[:, None]},
        "distance": 1.2,
        "wAngular": 12.5,
        "illuminant": {
            "type": "illuminant",
            "name": "some lamp",
            "data": {"photons": LIGHT.astype(np.float32)},
            "spectrum": {"wave": WAVES},
        },
    } | others


def without(scene, *names):
    return {name: value for name, value in scene.items() if name not in names}


def surfaces_of(scene):
    return np.moveaxis(scene.content.bands_at(slice(None)), 0, -1)


def radiance_of(scene):
    return surfaces_of(scene) * scene.illuminant.at(WAVES)


# ---- files that MATLAB wrote


def same(value, theirs):
    """Whether a value is what SciPy reads."""
    if value is None or not isinstance(theirs, np.ndarray):
        return value is None and (not isinstance(theirs, np.ndarray) or theirs.size == 0)
    if value.kind == "struct":
        return value.names == theirs.dtype.names and all(
            same(value.get(name), theirs[name].item()) for name in value.names
        )
    if value.kind == "text":
        return value.text() == (theirs.item() if theirs.size == 1 else None)
    if value.kind == "numbers":
        numbers = value.numbers()
        return (
            numbers.shape == theirs.shape
            and np.array_equal(numbers, theirs)
            and (theirs.dtype == bool or numbers.dtype == theirs.dtype.newbyteorder("="))
        )
    if value.kind == "a struct array":
        return theirs.dtype.names is not None and theirs.size != 1
    return (
        value.kind == "complex numbers"
        or theirs.dtype.kind == "O"
        or (value.kind in ("an object", "a function handle"))
    )


FILES = [
    path
    for pattern in ("test*_[67].*.mat", "*_endian.mat", "parabola.mat", "sqr.mat", "testbool*.mat")
    for path in sorted(MATLABS.glob(pattern))
    if "hdf5" not in path.name and "sparse" not in path.name
]


@pytest.mark.skipif(
    not FILES, reason="SciPy is installed without its tests, which have files of MATLAB"
)
@pytest.mark.filterwarnings(
    "ignore::numpy.exceptions.ComplexWarning"
)  # of SciPy, which drops imaginary parts
def test_matlabs_files_are_read_as_scipy_reads_them():
    """Versions 6.1 (Solaris: the other order of bytes), 6.5.1, 7.1 and 7.4."""
    assert len(FILES) > 40
    for path in FILES:
        theirs = scipy.io.loadmat(path, mat_dtype=True)
        with open_mat(path) as root:
            assert set(root.names) - {""} == {name for name in theirs if name[0] != "_"}, path.name
            for name in set(root.names) - {""}:
                assert same(root.get(name), theirs[name]), (path.name, name, root.get(name).kind)


@pytest.mark.skipif(
    not FILES, reason="SciPy is installed without its tests, which have files of MATLAB"
)
@pytest.mark.parametrize(
    "name", ["corrupted_zlib_checksum", "corrupted_zlib_data", "malformed1", "debigged_m4"]
)
def test_matlabs_damaged_files_are_refused(name):
    with refused(name, error=BadFile):
        gs.open_scene(MATLABS / f"{name}.mat")


@pytest.mark.skipif(
    not (MATLABS / "testhdf5_7.4_GLNX86.mat").exists(),
    reason="SciPy is installed without its tests",
)
def test_matlabs_file_of_version_7_3():
    with open_mat(MATLABS / "testhdf5_7.4_GLNX86.mat") as root:
        assert root.names == ("testdouble",)
        theirs = scipy.io.loadmat(MATLABS / "testdouble_7.4_GLNX86.mat")[
            "testdouble"
        ]  # the same in version 5
        np.testing.assert_array_equal(root.get("testdouble").numbers(), theirs)


def test_text_of_any_letters(tmp_path):
    for save in WRITERS.values():
        save(tmp_path / "a.mat", {"scene": scene_of(name="Tür 窓")})
        assert gs.open_scene(tmp_path / "a.mat").name == "Tür 窓"
        (tmp_path / "a.mat").unlink()


# ---- scenes


def test_surfaces_and_light_are_apart(saved):
    scene = saved(scene=scene_of())
    np.testing.assert_allclose(surfaces_of(scene), SURFACES, rtol=SINGLE)
    np.testing.assert_allclose(scene.illuminant.at(WAVES), LIGHT, rtol=SINGLE)
    assert (scene.name, scene.illuminant.name, scene.depth, scene.notes) == (
        "wall",
        "some lamp",
        None,
        ("not used: scene.distance",),
    )
    assert scene.fov == pytest.approx(math.radians(12.5), rel=1e-15)
    np.testing.assert_array_equal(scene.wavelengths, WAVES)


def test_radiance_without_an_illuminant(saved):
    scene = saved(scene=without(scene_of(), "illuminant", "wAngular", "name"))
    assert not scene.light_is_known and (scene.name, scene.fov) == ("a", None)
    np.testing.assert_allclose(radiance_of(scene), SURFACES * LIGHT, rtol=SINGLE)


def test_a_variable_of_any_name(saved):
    scene = saved(notes="mine", mine=scene_of(), other={"data": np.ones((3, 4))})
    np.testing.assert_allclose(surfaces_of(scene), SURFACES, rtol=SINGLE)


def test_numbers_are_single_as_isetcam_keeps_them(saved):
    photons = (SURFACES * LIGHT).astype(np.float32)
    scene = saved(
        scene=scene_of(data={"photons": photons, "luminance": np.zeros((0, 0))}, illuminant={})
    )
    np.testing.assert_array_equal(radiance_of(scene), photons)


@pytest.mark.parametrize("kind", [np.uint16, np.uint32])
def test_codes_of_old_files(saved, kind):
    """ieCompressData: code = round(largest (photons - dmin) / (dmax - dmin)); half a step is the error."""
    photons, largest = SURFACES * LIGHT, np.iinfo(kind).max
    low, high = photons.min(), photons.max()
    codes = np.rint(largest * (photons - low) / (high - low)).astype(kind)
    old = {
        "photons": np.rint(largest * (LIGHT - LIGHT.min()) / np.ptp(LIGHT)).astype(kind),
        "min": LIGHT.min(),
        "max": LIGHT.max(),
    }
    scene = saved(
        scene=scene_of(
            data={"photons": codes, "dmin": low, "dmax": high, "bitDepth": 8.0 * kind().itemsize},
            illuminant={"type": "illuminant", "data": old},
        )
    )
    np.testing.assert_allclose(
        scene.illuminant.at(WAVES), LIGHT, rtol=1e-12, atol=0.51 * np.ptp(LIGHT) / largest
    )
    np.testing.assert_allclose(
        radiance_of(scene), photons, rtol=SINGLE, atol=0.51 * (high - low) / largest
    )


def test_light_in_energy_of_older_files(saved):
    """LIGHT photons of h c / lambda each are the energy that the file holds."""
    scene = saved(
        scene=scene_of(
            illuminant={
                "data": LIGHT * HC / (WAVES * 1e-9),
                "wavelength": WAVES,
                "comment": "measured",
            }
        )
    )
    np.testing.assert_allclose(scene.illuminant.at(WAVES), LIGHT, rtol=1e-14)
    np.testing.assert_allclose(surfaces_of(scene), SURFACES, rtol=SINGLE)
    assert scene.illuminant.name == "measured"


def test_dark_wavelengths_of_the_light_keep_radiance(saved):
    light = LIGHT.copy()
    light[3] = 0
    scene = saved(scene=scene_of(illuminant={"data": {"photons": light}}))
    assert not scene.light_is_known and "dark at 1 of 31" in scene.notes[0]
    np.testing.assert_allclose(radiance_of(scene), SURFACES * LIGHT, rtol=SINGLE)


def test_light_that_is_not_to_scale_is_said(saved):
    scene = saved(scene=scene_of(illuminant={"data": {"photons": LIGHT / 1000}}))
    assert "mean reflectance up to" in scene.notes[0]
    np.testing.assert_allclose(radiance_of(scene), SURFACES * LIGHT, rtol=SINGLE)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_light_that_varies_is_a_mix_of_few_lights(saved, count):
    """The radiance is the file's; the surfaces are as exact as float32 arithmetic of a few terms, some 1e-6."""
    light = RANDOM.uniform(0, 2, (6, 7, count)) @ RANDOM.uniform(1e15, 1e16, (count, 31))
    scene = saved(
        scene=scene_of(data={"photons": SURFACES * light}, illuminant={"data": {"photons": light}})
    )
    assert (
        scene.content.form == "illuminated"
        and len(scene.content.maps) == count
        and scene.content.maps.min() >= 0
    )
    np.testing.assert_allclose(radiance_of(scene), SURFACES * light, rtol=1e-5)
    np.testing.assert_allclose(np.moveaxis(scene.content.coefficients, 0, -1), SURFACES, rtol=1e-5)
    np.testing.assert_allclose(scene.illuminant.at(WAVES), light.mean(axis=(0, 1)), rtol=1e-6)


def test_shadows_where_there_is_no_light(saved):
    light = RANDOM.uniform(1, 2, (6, 7, 1)) * LIGHT
    light[2:4, 1:3] = 0
    scene = saved(
        scene=scene_of(data={"photons": SURFACES * light}, illuminant={"data": {"photons": light}})
    )
    assert scene.content.form == "illuminated"
    np.testing.assert_allclose(radiance_of(scene), SURFACES * light, rtol=1e-5)


def test_light_of_too_many_lights_keeps_radiance(saved):
    light = RANDOM.uniform(1e15, 1e16, SURFACES.shape)
    scene = saved(
        scene=scene_of(data={"photons": SURFACES * light}, illuminant={"data": {"photons": light}})
    )
    assert not scene.light_is_known and "no mix of 4 lights" in scene.notes[0]
    np.testing.assert_allclose(radiance_of(scene), SURFACES * light, rtol=SINGLE)


def test_depth(saved):
    """Along the axis, or along rays: 12.5 degrees across 7 samples; 0 is far away."""
    far = RANDOM.uniform(1, 5, (6, 7))
    far[0, 0] = 0
    variables = {"scene": scene_of(depthMap=far)}
    depth = saved(**variables).depth
    np.testing.assert_allclose(depth.ravel()[1:], far.ravel()[1:], rtol=SINGLE)
    assert depth[0, 0] > 1e5
    assert saved({"depth": "none"}, **variables).depth is None
    ray = saved({"depth": "ray", "fov": math.radians(12.5)}, **variables).depth
    step = 2 * math.tan(math.radians(6.25)) / 7
    np.testing.assert_allclose(
        ray[5, 6], far[5, 6] / math.sqrt(1 + (3 * step) ** 2 + (2.5 * step) ** 2), rtol=1e-6
    )


# ---- optical images


def test_an_optical_image_is_what_a_lens_without_blur_makes_again(saved):
    """Irradiance that ISETCam computed (f/4): the camera that the note describes gives it back, through the device."""
    irradiance = np.load(Path(__file__).parents[1] / "data" / "iset_optics.npz")["photons"]
    theirs = {
        "type": "opticalimage",
        "data": {"photons": np.moveaxis(irradiance, 0, -1)},
        "wAngular": 8.0,
        "spectrum": {"wave": WAVES},
        "optics": {"fNumber": 4.0, "focalLength": 3.9e-3},
        "depthMap": np.ones(irradiance.shape[1:]),
    }
    scene = saved(oi=theirs)
    assert "f/4" in scene.notes[0] and not scene.light_is_known and scene.depth is None
    camera = gs.open_camera("machine-vision").with_(
        f_number=4.0, model="none", relative_illumination="none"
    )
    made = gs.Simulator(camera, device="numpy").loop(scene).output("irradiance")
    np.testing.assert_allclose(
        made, irradiance, rtol=2e-6
    )  # float32 on the device, some ten roundings


# ---- multispectral files


COEFFICIENTS, FUNCTIONS = RANDOM.uniform(0, 1e16, (6, 7, 3)), RANDOM.uniform(0, 1, (31, 3))


@pytest.mark.parametrize("form", ["struct", "matrix"])
def test_a_linear_model_stays_one(saved, form):
    basis = {"basis": FUNCTIONS, "wave": WAVES} if form == "struct" else FUNCTIONS
    others = {} if form == "struct" else {"wave": WAVES}
    scene = saved(
        mcCOEF=COEFFICIENTS,
        basis=basis,
        comment="hdrs",
        fov=10.0,
        dist=1.0,
        name="fruit",
        **others,
        illuminant={"data": LIGHT * HC / (WAVES * 1e-9), "wavelength": WAVES},
    )
    assert scene.content.form == "basis" and (scene.name, scene.fov) == ("fruit", math.radians(10))
    np.testing.assert_allclose(radiance_of(scene), COEFFICIENTS @ FUNCTIONS.T, rtol=1e-6)
    np.testing.assert_allclose(scene.illuminant.at(WAVES), LIGHT, rtol=1e-14)


def test_a_linear_model_with_its_mean_apart(saved):
    """HcBasis: radiance = imgMean + sum of coefficients and functions, which are small and of both signs."""
    mean, coefficients = RANDOM.uniform(1e15, 2e15, 31), COEFFICIENTS * 1e-2 - 2e13
    scene = saved(
        mcCOEF=coefficients, basis={"basis": FUNCTIONS, "wave": WAVES}, imgMean=mean[None]
    )
    assert scene.content.form == "basis" and scene.content.coefficients.shape == (4, 6, 7)
    np.testing.assert_allclose(radiance_of(scene), coefficients @ FUNCTIONS.T + mean, rtol=1e-6)


@pytest.mark.parametrize("names", [("photons", "wave"), ("data", "wavelength")])
def test_photons_as_they_are(saved, names):
    scene = saved(
        **{names[0]: SURFACES * LIGHT, names[1]: WAVES}, illuminant={"data": {"photons": LIGHT}}
    )
    np.testing.assert_allclose(surfaces_of(scene), SURFACES, rtol=SINGLE)


# ---- refusals


@pytest.mark.parametrize(
    "change, parts",
    [
        ({"type": "sensor"}, "of type 'sensor'"),
        ({"type": "opticalimage"}, "without optics.fNumber"),
        ({"type": "opticalimage", "optics": {"fNumber": -4.0}}, "optics.fNumber = -4"),
        ({"data": {}}, "no data.photons"),
        ({"data": {"photons": SURFACES[..., :5]}}, "shape (6, 7, 5), wanted (rows, cols, 31)"),
        ({"data": {"photons": SURFACES[..., 0]}}, "wanted (rows, cols, 31)"),
        ({"spectrum": {}}, "no wavelengths"),
        ({"spectrum": {"wave": WAVES[::-1]}}, "increase strictly"),
        ({"spectrum": {"wave": "blue"}}, "wanted real numbers"),
        ({"spectrum": {"wave": WAVES.reshape(31, 1) * np.ones(2)}}, "wanted a vector"),
        ({"wAngular": 200.0}, "fov"),
        ({"data": {"photons": -SURFACES}}, "negative"),
        ({"data": {"photons": SURFACES * np.nan}}, "NaN"),
        ({"data": {"photons": SURFACES * 1e300}}, "infinite"),
        ({"data": {"photons": SURFACES * 1j}}, "complex numbers"),
        ({"data": {"photons": (SURFACES * 99).astype(np.uint16)}}, "uint16 with dmin and dmax"),
        (
            {"data": {"photons": (SURFACES * 99).astype(np.uint16), "dmin": 2.0, "dmax": 1.0}},
            "dmin <= dmax",
        ),
        ({"illuminant": {"data": {"photons": LIGHT[:9]}}}, "9 numbers for 31"),
        ({"depthMap": -SURFACES[..., 0]}, "depth"),
        ({"illuminant": {"data": {"photons": SURFACES[:3]}}}, "(3, 7) samples of light"),
        ({"wAngular": "wide"}, "text"),
    ],
)
def test_what_cannot_be_a_scene_is_refused(written, change, parts):
    with refused("a.mat", parts, error=BadFile):
        gs.open_scene(written(scene=scene_of() | change))


@pytest.mark.parametrize(
    "variables, parts",
    [
        ({"x": 3.0}, "it holds x"),
        ({"a": scene_of(), "b": scene_of()}, "several structs with data.photons (a, b)"),
        ({"scene": 3.0}, "no cube, an array of three axes; it holds scene (1 x 1)"),
        ({"mcCOEF": COEFFICIENTS}, "mcCOEF without basis"),
        (
            {"mcCOEF": COEFFICIENTS, "basis": FUNCTIONS.T, "wave": WAVES},
            "shape (3, 31), wanted (31, functions)",
        ),
        (
            {"mcCOEF": COEFFICIENTS, "basis": FUNCTIONS, "wave": WAVES, "imgMean": WAVES[:4]},
            "imgMean",
        ),
        ({"photons": SURFACES}, "no wavelengths"),
        ({"photons": SURFACES, "wave": [500.0]}, "(rows, cols, 1)"),
        ({"scene": np.array([[scene_of(), scene_of()]], object)}, "a cell array"),
    ],
)
def test_files_without_a_scene_are_refused(written, variables, parts):
    with refused("a.mat", parts, error=BadFile):
        gs.open_scene(written(**variables))


def test_options_of_other_files_are_refused(written):
    path = written(scene=scene_of())
    with refused("wavelengths", error=OutOfRange):
        gs.open_scene(path, wavelengths=WAVES)
    with refused("no depthMap", error=BadFile):
        gs.open_scene(path, depth="ray", fov=0.3)


def test_version_4_is_refused(tmp_path):
    scipy.io.savemat(tmp_path / "a.mat", {"photons": np.ones((3, 4))}, format="4")
    with refused("a.mat", "-v7", error=BadFile):
        gs.open_scene(tmp_path / "a.mat")


def test_struct_arrays_of_one_element_are_structs(tmp_path):
    """MATLAB 7.3 keeps the fields of a struct array as references."""
    save73(tmp_path / "a.mat", {"scene": (scene_of(),)})
    np.testing.assert_allclose(
        surfaces_of(gs.open_scene(tmp_path / "a.mat")), SURFACES, rtol=SINGLE
    )
    for scene, what in ((scene_of(), scene_of()), "a struct array"), ([scene_of()], "a cell array"):
        save73(tmp_path / "a.mat", {"scene": scene})
        with refused("a.mat", what, error=BadFile):
            gs.open_scene(tmp_path / "a.mat")


def test_numbers_of_hdf5_without_axes(tmp_path):
    """As other programs than MATLAB write them."""
    save73(tmp_path / "a.mat", {"scene": without(scene_of(), "wAngular")})
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        file["scene/wAngular"] = 30.0
    assert gs.open_scene(tmp_path / "a.mat").fov == math.radians(30)
    with h5py.File(tmp_path / "a.mat", "r+") as file:
        del file["scene/spectrum/wave"]
        file["scene/spectrum/wave"] = 500.0
    with refused("a.mat", "(rows, cols, 1)", error=BadFile):
        gs.open_scene(tmp_path / "a.mat")


def test_numbers_outside_the_file_are_not_read(tmp_path):
    """Links and external storage lead to other files."""
    path, other = tmp_path / "a.mat", tmp_path / "b.mat"
    save73(other, {"scene": scene_of()})
    save73(path, {"comment": "x"})
    with h5py.File(path, "r+") as file:
        file["scene"] = h5py.ExternalLink(str(other), "/scene")
    with refused("a.mat", "link", error=BadFile):
        gs.open_scene(path)
    save73(path, {"scene": without(scene_of(), "data")})
    with h5py.File(path, "r+") as file:
        file.create_dataset(
            "scene/data/photons",
            SURFACES.T.shape,
            "f8",
            external=[(str(other), 512, SURFACES.nbytes)],
        )
    with refused("a.mat", "not in the file itself", error=BadFile):
        gs.open_scene(path)


@pytest.mark.parametrize("part", ["heap", "tree of names", "tree of pieces"])
def test_structures_of_hdf5_that_lead_back_to_themselves(tmp_path, part):
    """HDF5 2.0 takes all memory of the first, and crashes on the others."""
    path = tmp_path / "a.mat"
    save73(path, {"scene": scene_of()})
    data = bytearray(path.read_bytes())
    if part == "heap":
        for at in (match.start() for match in re.finditer(b"HEAP", data)):
            _, block, start = struct.unpack_from("<QQQ", data, at + 8)
            if block != 1:
                struct.pack_into("<Q", data, 512 + start + block, block)
    else:
        kind = 0 if part == "tree of names" else 1
        at = next(
            match.start() for match in re.finditer(b"TREE", data) if data[match.end()] == kind
        )
        data[at + 5] = 1
        struct.pack_into("<Q", data, at + 24 + (40 if kind else 8), at - 512)
    path.write_bytes(data)
    with refused("a.mat", "loop" if part == "heap" else "contains itself", error=BadFile):
        gs.open_scene(path)


@pytest.mark.parametrize("kind", [6, 9])
def test_a_size_that_the_file_cannot_hold_is_refused_before_it_is_taken(tmp_path, kind):
    """Declared by a data set of which nothing is stored, and by a packed variable of version 5."""
    path = tmp_path / "a.mat"
    if kind == 9:
        save73(path, {"scene": without(scene_of(), "data")})
        with h5py.File(path, "r+") as file:
            file.create_dataset(
                "scene/data/photons", (31, 10**5, 10**5), "f8", chunks=(1, 100, 100), compression=1
            )
    else:
        scipy.io.savemat(path, {"scene": 1.0})
        packed = zlib.compress(struct.pack("<II", 14, 2**31) + path.read_bytes()[136:] + bytes(999))
        path.write_bytes(path.read_bytes()[:128] + struct.pack("<II", 15, len(packed)) + packed)
    with refused("a.mat", "cannot", error=BadFile):
        gs.open_scene(path)

"""What a user's program and editor get: settings by name, cameras on others, scenes of arrays, names that they see."""

import ast
import dataclasses
import inspect
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, get_overloads

import numpy as np
import pytest
from test_public_api import members, public_names

import gpusim as gs
from gpusim import measure
from gpusim.domain.camera_keys import SECTIONS
from gpusim.domain.errors import BadData, BadFile, OutOfRange, UnknownName
from gpusim.domain.pupil import Pupil
from gpusim.pipeline.exposure import Exposure
from gpusim.pipeline.report import Report

ROOT = Path(gs.__file__).resolve().parents[1]
PHONE = gs.open_camera("phone")


# ------------------------------------------------------------------------------------------------ settings by name


def test_settings_are_those_of_a_camera_file(tmp_path):
    """The same keys and values in a file, by another way: TOML and its reader."""
    (tmp_path / "a.toml").write_text(
        'base = "phone"\n[optics]\nf_number = 2.0\nobject_distance_m = 1.5\nseidel_waves = [0.1, 0, 0, 0, 0]\n'
        'defocus_diopters = 0.25\n[sensor]\nexposure_time_ms = 10\nbits = 12\ncfa = ["GR", "BG"]\nfull_well_e = 9000\n'
        '[noise]\nread_e = 3\nseed = 7\n[processor]\nwhite = [2.0, 1.0, 1.5]\nwhite_balance = "preset"\n'
        "[display]\nluminance_cd_per_m2 = 80\n"
    )
    found = PHONE.with_(
        f_number=2.0,
        object_distance_m=1.5,
        seidel_waves=(0.1, 0, 0, 0, 0),
        defocus_diopters=0.25,
        exposure_time_ms=10,
        bits=np.int64(12),
        cfa=["GR", "BG"],
        full_well_e=9000,
        read_e=np.float32(3),
        **{"noise.seed": 7, "processor.white": np.array([2.0, 1.0, 1.5])},
        white_balance="preset",
        luminance_cd_per_m2=80,
    )
    wanted = gs.open_camera(tmp_path / "a.toml")
    assert found.optics == wanted.optics and found.processor == wanted.processor
    for one, other in ((found.sensor, wanted.sensor), (found.display, wanted.display)):
        for field in dataclasses.fields(one):
            if field.name not in ("qe", "filters", "name"):
                assert getattr(one, field.name) == getattr(other, field.name), field.name
    assert PHONE.optics.f_number == 1.8  # a new camera


def test_objects_stand_for_what_files_name():
    curve = gs.Spectrum([400, 700], np.ones((3, 2)))
    other, through = gs.Display("projector", luminance=200.0), gs.Spectrum([400, 700], [0.9, 0.8])
    found = PHONE.with_(qe=curve, pupil=Pupil(blades=6), display=other, transmission=through)
    assert found.sensor.qe is curve and found.optics.pupil.blades == 6 and found.display is other
    assert PHONE.with_(optics=gs.Optics(4.0, 0.01), f_number=5.6).optics == gs.Optics(5.6, 0.01)
    assert found.with_(distortion=None).optics.distortion is None


@pytest.mark.parametrize(
    "changes, error, words",
    [
        ({"f_numbr": 2}, UnknownName, "unknown key of a camera 'f_numbr'; did you mean 'f_number'"),
        ({"noise.f_number": 2}, UnknownName, "did you mean 'optics.f_number'"),
        (
            {"white": [1, 1, 1]},
            BadData,
            "white: a key of processor and display; wanted .*processor.white",
        ),
        ({"f_number": "fast"}, BadData, "f_number = 'fast': wanted a number"),
        ({"f_number": -1}, OutOfRange, "optics.f_number = -1"),
        ({"f_number": None}, BadData, "f_number = None: wanted a number"),
        ({"qe": "imx"}, BadData, "qe: unknown curve 'imx'"),
        ({"psf": "lens.npz"}, BadData, "psf: lens.npz: no such file"),
        ({"ir_cut": "x"}, BadData, "ir_cut: unknown curve 'x'"),
        ({"defocus_um": "x"}, BadData, "defocus_um: unknown curve 'x'"),
        ({"defocus_um": 1.0, "defocus_diopters": 1.0}, BadData, "wanted one of them"),
        ({"cfa": "nope"}, BadData, "cfa: unknown mosaic 'nope'"),
        ({"optics": 3}, BadData, "optics: int, wanted Optics"),
        ({"reset_e": "kTC"}, BadData, "needs conversion_gain_uv_per_e"),
    ],
)
def test_bad_settings_are_refused_in_one_line(changes, error, words):
    with pytest.raises(error, match=words) as refused:
        PHONE.with_(**changes)
    assert "\n" not in str(refused.value)


def test_keys_of_two_sections_are_known():
    """The docstring names the one way out: which they are may change with the keys, that there are few must not."""
    count: dict[str, int] = {}
    for keys in SECTIONS.values():
        for key in keys:
            count[key] = count.get(key, 0) + 1
    assert [key for key, times in count.items() if times > 1] == ["white"]


# ---------------------------------------------------------------------------------------------- cameras on cameras


def write(path, text):
    path.write_text(text)
    return path


def test_a_camera_on_another(tmp_path):
    (tmp_path / "lenses").mkdir()
    (tmp_path / "lenses" / "qe.csv").write_text("wavelength_nm,R,G,B\n400,.1,.2,.3\n700,.3,.2,.1\n")
    write(
        tmp_path / "lenses" / "base.toml",
        'base = "phone"\nname = "its"\n[sensor]\nqe = "qe.csv"\n[optics]\ndefocus_um = 3\n',
    )
    found = gs.open_camera(
        write(
            tmp_path / "own.toml",
            'base = "lenses/base.toml"\n[noise]\nread_e = 1\n[optics]\ndefocus_diopters = 0\n',
        )
    )
    assert (
        found.name == "own"
        and found.sensor.noise.read == 1
        and found.sensor.noise.prnu == PHONE.sensor.noise.prnu
    )
    assert found.optics.defocus == 0  # its base's, in another unit, is gone
    # the file beside the base; factors of the phone's own quantum efficiency stay, so it is the lower one everywhere
    assert found.sensor.qe.values.max() <= 0.3
    assert (
        gs.open_camera(write(tmp_path / "named.toml", 'base = "mono"\nname = "mine"\n')).name
        == "mine"
    )


def test_an_empty_file_is_the_phone(tmp_path):
    found = gs.open_camera(write(tmp_path / "mine.toml", "# nothing yet\n"))
    assert (
        found.name == "mine"
        and found.optics == PHONE.optics
        and found.sensor.noise == PHONE.sensor.noise
    )
    begun = gs.open_camera(write(tmp_path / "begun.toml", "[optics]\nf_number = 2\n"))
    assert begun.optics.f_number == 2 and begun.optics.focal_length == PHONE.optics.focal_length
    with pytest.raises(BadFile, match=r"\[optics\] lacks focal_length_mm"):
        gs.open_camera(write(tmp_path / "own.toml", 'base = "none"\n[optics]\nf_number = 2\n'))


@pytest.mark.parametrize(
    "text, words",
    [
        ("base = 3", "base = 3: wanted a camera's name or file"),
        ('base = "nope"', "base = 'nope': no such camera or file; cameras are action, "),
        ('base = "a.toml"', "base = 'a.toml': the bases form a loop"),
        ('base = "b.toml"', "base = 'a.toml': the bases form a loop"),
        ('base = "phone"\noptics = 3', "optics = 3: wanted a section"),
        ('base = "phone"\n[optics]\nf_numbr = 3', "unknown key 'f_numbr' in .optics."),
    ],
)
def test_bad_bases_are_refused_with_the_file_and_the_key(tmp_path, text, words):
    write(tmp_path / "b.toml", 'base = "a.toml"\n')
    with pytest.raises(BadFile, match=words) as refused:
        gs.open_camera(write(tmp_path / "a.toml", text))
    assert str(tmp_path) in str(refused.value) and "\n" not in str(refused.value)


TRIED = (
    "-1e30",
    "nan",
    "1e30",
    "-3",
    "99999",
    "true",
    "[]",
    "{a = 1}",
    '"zzz"',
    '"zzz.csv"',
    '"zzz.npz"',
    "[-1, -1]",
    "[[-1, 2], [3]]",
    "1979-05-27",
)


@pytest.mark.parametrize("section", SECTIONS)
def test_errors_of_camera_files_name_the_file_and_the_key(section, tmp_path):
    """Of every key, as it is written there, whatever is wrong with its value; a file that it names is said besides."""
    path, refused = tmp_path / "own.toml", 0
    for key in SECTIONS[section]:
        for value in TRIED:
            try:
                gs.open_camera(write(path, f'base = "phone"\n[{section}]\n{key} = {value}\n'))
            except gs.GpusimError as error:
                refused += 1
                assert isinstance(error, BadFile) and str(error).startswith(f"{path}: "), error
                assert re.search(rf"\b{key}\b", str(error)) and "\n" not in str(error), error
                if "no such file" in str(error):
                    assert str(tmp_path / value.strip('"')) in str(error)
    assert refused >= 9 * len(SECTIONS[section])


@pytest.mark.parametrize(
    "text, words",
    [
        (
            "[optics]\nfocal_length_mm = -3",
            r"\[optics\] focal_length_mm = -3: optics.focal_length = -0.003 m: allowed is ",
        ),
        ("[optics]\nfocal_length_mm = '4'", r"\[optics\] focal_length_mm = '4': wanted a number"),
        (
            "[optics]\nfocal_length = 4",
            r"unknown key 'focal_length' in \[optics\]; did you mean 'focal_length_mm'",
        ),
        (
            "[sensor]\nread_e = 4",
            r"unknown key 'read_e' in \[sensor\]; did you mean 'read_e' in \[noise\]",
        ),
        ("[sensro]\nbits = 4", r"unknown section \[sensro\]; did you mean 'sensor'"),
        (
            "[sensor]\nbits = 8\nbits = 9",
            r"not TOML: Cannot overwrite a value \(at line 4, column 9\)",
        ),
        ("[sensor]\nbits = ", r"not TOML: Invalid value \(at line 3, column "),
        (
            "[sensor]\nqe = 'mine.csv'",
            r"\[sensor\] qe: .*mine.csv: wanted 2 numbers on every line after the first",
        ),
        ("[optics]\npsf = 'mine.csv'", r"\[optics\] psf: .*mine.csv: not "),
        (
            "[optics]\ndefocus_diopters = 9e9",
            r"\[optics\] defocus_diopters = 9000000000.0: optics.defocus = ",
        ),
        (
            "[optics]\nzernike_waves = [[0.1], [0.1, 0.2]]",
            r"\[optics\] zernike_waves = .*: wanted a list of numbers",
        ),
        (
            "[display]\nname = 'a'\nluminance_cd_per_m2 = 0",
            r"\[display\] luminance_cd_per_m2 = 0: display.luminance = 0 ",
        ),
    ],
)
def test_each_kind_of_error_of_a_camera_file(text, words, tmp_path):
    """The key in the file's words and unit, what is wrong, and what is allowed or where the file is broken."""
    write(tmp_path / "mine.csv", "wavelength_nm,Y\n400,0.5\n700\n")
    path = write(tmp_path / "own.toml", f'base = "phone"\n{text}\n')
    with pytest.raises(BadFile, match=words) as refused:
        gs.open_camera(path)
    assert str(refused.value).startswith(f"{path}: ") and "\n" not in str(refused.value)


def test_a_key_of_the_base_is_said_to_be_there(tmp_path):
    base = write(tmp_path / "base.toml", 'base = "phone"\n[noise]\nread_e = -1\n')
    own = write(tmp_path / "own.toml", 'base = "base.toml"\n[optics]\nf_number = 2\n')
    with pytest.raises(
        BadFile, match=r"\[noise\] read_e = -1: .* \(the key is its base's, "
    ) as refused:
        gs.open_camera(own)
    assert str(refused.value).startswith(f"{own}: ") and str(base) in str(refused.value)
    with pytest.raises(
        BadFile, match=r"base.toml: \[noise\] read_e = -1: noise.read = -1 e-: allowed is [^(]*$"
    ):
        gs.open_camera(base)


# ------------------------------------------------------------------------------------------------ scenes of arrays

NODES = np.linspace(400, 700, 5)
VALUES = np.random.default_rng(5).random((5, 6, 7))


def test_cubes_by_bands_and_by_pixels_are_the_same():
    first = gs.scene_from(VALUES, NODES, light="A", luminance=50.0, border="reflect")
    last = gs.scene_from(np.moveaxis(VALUES, 0, -1), NODES, light="A", luminance=50.0)
    np.testing.assert_array_equal(first.content.values, VALUES.astype(np.float32))
    np.testing.assert_array_equal(last.content.values, first.content.values)
    flat = gs.chart("flat", light="A", luminance=50.0)
    np.testing.assert_array_equal(first.illuminant.values, flat.illuminant.values)
    assert first.border == "reflect" and first.light_is_known
    square = np.random.default_rng(5).random((5, 6, 5))
    assert gs.scene_from(square, NODES, axis=-1).content.shape == (5, 6)
    assert gs.scene_from(square.tolist(), NODES, axis=0).content.shape == (6, 5)


def test_energy_is_turned_into_photons():
    """E = h c / lambda: 1 W at 555 nm is 2.7939e18 photons a second (2019 SI constants, five digits)."""
    scene = gs.scene_from(np.ones((2, 1, 1)), [555.0, 1110.0], unit="energy")
    np.testing.assert_allclose(scene.content.values[:, 0, 0], [2.7939e18, 5.5878e18], rtol=2e-5)
    assert not scene.light_is_known
    assert gs.scene_from(np.ones((2, 1, 1)), [555.0, 1110.0]).content.values.max() == 1


def test_pictures_are_those_of_files(tmp_path):
    """Codes, encoded numbers and linear ones of one picture are the scene that its PNG is: 0.5 / 255 of rounding."""
    from PIL import Image

    codes = np.random.default_rng(6).integers(0, 256, (8, 9, 3), np.uint8)
    Image.fromarray(codes).save(tmp_path / "a.png")
    wanted = gs.open_scene(tmp_path / "a.png")
    encoded = codes / 255
    light = np.where(
        encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4
    )  # IEC 61966-2-1
    for found in (
        gs.scene_from(codes),
        gs.scene_from(encoded),
        gs.scene_from(light, linear=True),
        gs.scene_from(codes.astype(np.uint16) * 257),
    ):
        np.testing.assert_allclose(
            found.content.on_host().coefficients, wanted.content.coefficients, atol=1e-6
        )
        np.testing.assert_array_equal(found.illuminant.values, wanted.illuminant.values)
    grey = gs.scene_from(encoded[..., 0])
    assert np.ptp(grey.content.coefficients, axis=0).max() == 0
    half = (
        gs.scene_from(np.full((4, 4, 3), 128, np.uint8), linear=True).content.on_host().coefficients
    )
    np.testing.assert_allclose(half, 128 / 255, rtol=1e-6)


@pytest.mark.parametrize(
    "given, options, words",
    [
        ((VALUES, NODES[:-1]), {}, r"array of shape \(5, 6, 7\) for 4 wavelengths, wanted"),
        ((np.ones((5, 6, 5)), NODES), {}, "both ends have 5 samples; give axis = 0 or axis = -1"),
        ((VALUES, NODES), {"axis": 1}, "axis = 1 of shape"),
        ((VALUES, NODES), {"linear": True}, "linear = True is for pictures only"),
        ((VALUES, NODES), {"unit": "lumen"}, "unknown unit 'lumen'"),
        ((-VALUES, NODES), {}, "negative samples"),
        ((VALUES,), {}, r"wanted \(rows, cols, 3\)"),
        (
            (np.full((4, 4, 3), 2.0),),
            {},
            "encoded picture up to 2, wanted 0 .. 1; or linear = True",
        ),
        ((np.full((4, 4, 3), np.nan),), {}, "picture from nan"),
        ((np.ones((4, 4, 3), int),), {}, "a picture of int64, wanted uint8"),
        ((np.ones((4, 4, 3), "U1"),), {}, "wanted real numbers"),
    ],
)
def test_bad_arrays_are_refused_in_one_line(given, options, words):
    with pytest.raises((BadData, UnknownName), match=words) as refused:
        gs.scene_from(*given, **options)
    assert "\n" not in str(refused.value)


# --------------------------------------------------------------------------------------------- names that editors see


def test_type_checkers_see_every_public_name():
    tree = ast.parse(Path(gs.__file__).read_text())
    block = next(
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    )
    seen = {alias.name: node.module for node in block.body for alias in node.names}
    assert all(
        alias.asname == alias.name for node in block.body for alias in node.names
    )  # exported, to a strict one
    assert seen == gs._PUBLIC and sorted(seen) == gs.__all__
    assert (Path(gs.__file__).parent / "py.typed").exists()


SCRIPT = """
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import gpusim as gs
from gpusim.measure import cpsnr, mtf50, sfr, snr


def camera_of(folder: Path) -> gs.Camera:
    file = folder / "own.toml"
    file.write_text('base = "phone"\\n[sensor]\\nexposure_time_ms = 10\\n')
    camera = gs.open_camera(file).with_(f_number=2.0, read_e=3)
    print(camera, camera.optics.f_number, camera.sensor.noise.read, camera.sensor.channels)
    return camera


def scenes(count: int) -> Iterator[gs.Scene]:
    random = np.random.default_rng(1)
    yield gs.scene_from(random.random((31, 48, 64)), np.linspace(400, 700, 31), light="D65")
    yield gs.scene_from(random.integers(0, 256, (48, 64, 3), np.uint8))
    yield gs.illuminate(gs.chart("flat", size=(64, 48)), {"A": 30.0, "D65": 70.0})
    yield from (gs.open_scene("colorchecker", size=(64, 48)) for _ in range(count))


def sharpness(camera: gs.Camera) -> float:
    frame = gs.Simulator(camera, device="numpy")(gs.chart("slanted-edge", size=(96, 64)))
    return float(mtf50(sfr(frame.linear, pitch=camera.sensor.pixel_pitch)).mean())


def picture_of(frame: gs.Frame) -> NDArray[np.uint8]:
    report = frame.report
    print(frame, report, report.meets_tolerance, frame.linear.shape, frame.raw.max())
    return np.asarray(frame)


def night(simulate: gs.Simulator, scene: gs.Scene) -> gs.Frame:
    views = [scene.viewed(gs.Motion(shake=2.0).at(number / 30)) for number in range(2)]
    frames: list[gs.Frame] = gs.burst(simulate, views, seed=1)
    print("noise", snr(frames[0].linear[8:16, 8:16]))
    return gs.merge_burst(simulate, frames)


def run(folder: Path) -> None:
    camera = camera_of(folder)
    simulate = gs.Simulator(camera, device="numpy", tolerance="preview")
    for number, frame in enumerate(simulate(scenes(1), seed=1)):
        frame.save(folder / f"frame{number}.png", bits=16)
        print(picture_of(frame).mean(axis=(0, 1)), frame.exposure_time)
    checker = gs.chart("colorchecker", size=(64, 48))
    exposure = simulate.expose(checker)
    print(exposure, np.asarray(exposure).mean(), sharpness(camera))
    frames = gs.bracket(simulate, checker, (0, 2))
    hdr = gs.merge_bracket(simulate, frames)
    print("of a bracket", cpsnr(frames[0].linear, hdr.linear))
    hdr.save(folder / "hdr.exr")
    batch = gs.PictureBatch(camera, device="numpy")
    print(night(simulate, checker).exposure_time, batch(np.ones((1, 3, 16, 16))).shape)
    try:
        gs.open_scene("colorchekcer")
    except gs.GpusimError as error:
        print(error)


if __name__ == "__main__":
    run(Path("."))
"""
SHOWN = """import gpusim as gs
simulate = gs.Simulator(gs.open_camera('phone'))
reveal_type(gs.open_camera)
reveal_type(simulate(gs.chart("flat")))
reveal_type(simulate([gs.chart("flat")]))
reveal_type(gs.burst(simulate, gs.chart("flat"), 2))
simulate.camera.nothing
"""


def script_of_all_names():
    """Return a script that uses every public function, method and property, and the name on each line."""
    lines, names = ["from typing import Any", "import gpusim as gs"], {}
    for path, value in public_names():
        if path.startswith("stage "):  # modules that a type checker does not find
            continue
        if not inspect.isclass(value):
            uses = [(path, f"gs.{path}", value)]
        else:
            uses = [
                (f"{path}.{key}", "self" if key == "__call__" else f"self.{key}", member)
                for key, member in members(value)
                if key != "__init__"
            ]
        for name, use, member in uses:
            if inspect.isfunction(member):
                takes = {*inspect.signature(member).parameters} - {"self", "cls"}
                use += "(*args, **named)" if takes else "()"
            kind = f"gs.{path}" if inspect.isclass(value) else "object"
            lines += [
                f"def use{len(lines)}(self: {kind}, args: list[Any], named: dict[str, Any]) -> None:",
                f"    reveal_type({use})",
            ]
            names[len(lines)] = (name, member)
    return "\n".join(lines) + "\n", names


def gives_any(member):
    """Return True if a function or property is declared to return Any, or depends on its arguments."""
    function = getattr(member, "fget", None) or getattr(member, "func", None) or member
    result = inspect.signature(function).return_annotation
    return result in (Any, "Any") or bool(get_overloads(function))


def test_a_users_script_passes_a_strict_type_checker(tmp_path):
    """And `reveal_type` shows that public names are not Any. The inside of the package is not judged here."""
    assert len(SCRIPT.strip().splitlines()) >= 60
    every, names = script_of_all_names()
    write(tmp_path / "user.py", SCRIPT)
    write(tmp_path / "shown.py", SHOWN)
    write(tmp_path / "every.py", every)
    checked = subprocess.run(
        [
            sys.executable,
            "-m",
            "mypy",
            "--strict",
            "--follow-imports=silent",
            "--cache-dir",
            str(tmp_path / "cache"),
            "user.py",
            "shown.py",
            "every.py",
        ],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"MYPYPATH": str(ROOT), "PATH": ""},
        check=False,
    ).stdout
    found = dict(re.findall(r"^every.py:(\d+): note: Revealed type is (.*)$", checked, re.M))
    faults = re.findall(r"^every.py:.*error.*$", checked, re.M)
    for line, (name, member) in names.items():
        if found.get(str(line)) in (None, '"Any"') and not gives_any(member):
            faults.append(f"{name}: {found.get(str(line))}")
    assert not faults, f"{len(faults)} faults:\n" + "\n".join(faults)
    assert "user.py" not in checked and "Found 1 error in 1 file" in checked, checked
    for type_ in (
        "def (name_or_path: str | os.PathLike[Any]) -> gpusim.domain.camera.Camera",
        '"gpusim.pipeline.frame.Frame"',
        'Iterator[gpusim.pipeline.frame.Frame]"',
        'list[gpusim.pipeline.frame.Frame]"',
        '"Camera" has no attribute "nothing"',
    ):
        assert type_ in checked, (type_, checked)


@pytest.mark.slow  # ten frames by the reference
def test_the_same_script_runs(tmp_path, capsys):
    names = {"__name__": "user"}
    exec(compile(SCRIPT, "user.py", "exec"), names)
    names["run"](tmp_path)
    assert "did you mean 'colorchecker'" in capsys.readouterr().out
    assert {path.name for path in tmp_path.iterdir()} == {
        "own.toml",
        "hdr.exr",
        *(f"frame{n}.png" for n in range(4)),
    }


def test_what_public_functions_give_has_a_type():
    """Those without any are an error of a strict checker wherever they are called."""
    named = [
        (name, getattr(owner, name)) for owner in (gs, measure, gs.plot) for name in owner.__all__
    ]
    named += [
        (f"{kind.__name__}.{name}", method)
        for kind in (
            gs.Simulator,
            gs.Loop,
            gs.PictureBatch,
            gs.Readout,
            gs.Frame,
            gs.Camera,
            gs.Scene,
            gs.Spectrum,
            gs.Optics,
            gs.View,
            gs.Motion,
            gs.Actor,
            gs.Animation,
            gs.Calibration,
            gs.EventSensor,
            Exposure,
            Report,
        )
        for name, method in vars(kind).items()
        if not name.startswith("_") and inspect.isfunction(method)
    ]
    assert [
        name
        for name, made in named
        if inspect.isfunction(made)
        and inspect.signature(made).return_annotation is inspect.Signature.empty
    ] == []


def test_editors_complete_every_public_name():
    import jedi

    project = jedi.Project(ROOT)
    names = {
        found.name
        for found in jedi.Script("import gpusim as gs\ngs.", project=project).complete(2, 3)
    }
    assert set(gs.__all__) <= names
    code = "import gpusim as gs\ncamera = gs.open_camera('phone')\ncamera."
    assert {"optics", "sensor", "with_"} <= {
        found.name for found in jedi.Script(code, project=project).complete(3, 7)
    }

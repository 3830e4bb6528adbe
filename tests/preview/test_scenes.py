"""Scenes of a preview's client: what it may send, what a link names, and what makes a frame again."""

import hashlib
import json
import runpy
import shlex
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import gpusim as gs
from gpusim.apps.preview import shelf as shelves
from gpusim.apps.preview import uploads as module
from gpusim.apps.preview.body_limit import BodyLimit
from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.recipes import camera_text, command_line, notebook_cell
from gpusim.apps.preview.scene_choice import OPTIONS, SceneChoice
from gpusim.apps.preview.scene_chooser import choice_of_files
from gpusim.apps.preview.shelf import Shelf
from gpusim.apps.preview.state import History, State
from gpusim.apps.preview.uploads import Uploads, Wanted
from gpusim.apps.video.scenes import Still
from gpusim.backends import open_device
from gpusim.cli.main import main
from gpusim.domain.digest import digest
from gpusim.domain.errors import BadData, BadFile, GpusimError, TooLarge
from gpusim.domain.memory import limit_memory, require_memory

SIZE = (48, 32)
CHART = SceneChoice("colorchecker", size=SIZE)
STATE = State("phone", tolerance="exact", is_live=False, scene=CHART)
LAMP = "wavelength_nm,power\n400,1\n550,3\n700,2\n"
WAVES = "400:700:100"


def sent(uploads, name, data):
    """Keep a file that a client sends."""
    path = uploads.arriving()
    path.write_bytes(data)
    return uploads.keep(name, path)


def photo_bytes(tmp_path, size=SIZE):
    """The bytes of a small photograph of random colours."""
    codes = np.random.default_rng(3).integers(0, 255, (size[1], size[0], 3), np.uint8)
    Image.fromarray(codes).save(tmp_path / "made.png")
    return (tmp_path / "made.png").read_bytes()


def producer_of(shelf=None):
    """A producer whose own scene no state of these tests names."""
    return Producer(Still(gs.chart("flat", size=(16, 16)), 1), open_device("opencl"), shelf=shelf)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with a scene in every still format: suffix -> its files and options."""
    folder = tmp_path_factory.mktemp("scenes")
    scene = gs.chart("colorchecker", size=SIZE, wavelengths=[400, 500, 600, 700])
    found = {}
    for suffix in (".exr", ".npz", ".hdr", ".tif"):
        gs.save_scene(scene, folder / f"own{suffix}")
        found[suffix] = [folder / f"own{suffix}"], {}
    found[".hdr"][0].append(folder / "own.img")
    cube = np.random.default_rng(4).random((4, 32, 48)).astype(np.float32)
    np.save(folder / "cube.npy", cube)
    found[".npy"] = [folder / "cube.npy"], {"wavelengths": WAVES}
    (folder / "patches.csv").write_text("wavelength_nm,a,b\n400,0.1,0.5\n700,0.3,0.6\n")
    found[".csv"] = [folder / "patches.csv"], {}
    for suffix, options in ((".png", {}), (".jpg", {"quality": 90})):
        codes = (255 * cube[:3].transpose(1, 2, 0)).astype(np.uint8)
        Image.fromarray(codes).save(folder / f"photo{suffix}", **options)
        found[suffix] = [folder / f"photo{suffix}"], {}
    import h5py
    import scipy.io

    with h5py.File(folder / "cube.h5", "w") as file:
        file["cube"] = cube.transpose(1, 2, 0)
        file["bands"] = np.array([400.0, 500.0, 600.0, 700.0])
    found[".h5"] = [folder / "cube.h5"], {"wavelengths": WAVES}
    scipy.io.savemat(folder / "cube.mat", {"cube": cube.transpose(1, 2, 0)})
    found[".mat"] = [folder / "cube.mat"], {"wavelengths": WAVES}
    for number, plane in enumerate(cube):
        Image.fromarray((255 * plane).astype(np.uint8)).save(
            folder / f"plane_{400 + 100 * number}nm.png"
        )
    found["bands"] = [folder / f"plane_{nm}nm.png" for nm in (400, 500, 600, 700)], {}
    return found


KINDS = (".exr", ".npz", ".hdr", ".tif", ".npy", ".csv", ".png", ".jpg", ".h5", ".mat", "bands")


def test_a_pixel_has_the_distance_of_what_it_sees():
    """Left 1 m, right 4 m, a layer at half a metre in the middle; frames whose pixels are binned by two, too."""
    chart, depth = gs.chart("flat", size=SIZE), np.full(SIZE[::-1], 4.0)
    depth[:, : SIZE[0] // 2] = 1
    near = np.zeros(SIZE[::-1])
    near[:, SIZE[0] // 2 - 4 : SIZE[0] // 2 + 4] = 1
    made = Producer(Still(replace(chart, depth=depth), 1), open_device("opencl"))
    with pytest.raises(BadData, match="no depth"):
        made.distance((0, 0))
    own = replace(STATE, scene=SceneChoice())
    made.picture(own, 0)
    assert [made.distance((20, col)) for col in (2, SIZE[0] - 3)] == [1, 4]
    layered = replace(chart, depth=depth, layers=(gs.Layer(chart.content, near, 0.5),))
    made = Producer(Still(layered, 1), open_device("opencl"))
    binned = replace(own, changes={"sensor.binning": [2, 2]})
    rows, cols = made.picture(binned, 0).codes.shape[:2]
    assert (cols, rows) == (SIZE[0] // 2, SIZE[1] // 2)
    assert [made.distance((5, col)) for col in (1, cols // 2, cols - 2)] == [1, 0.5, 4]


@pytest.mark.parametrize("kind", KINDS)
def test_files_of_every_still_format_are_scenes(kind, files, tmp_path):
    """What is sent is what `open_scene` reads from the same files in a folder of their own."""
    paths, options = files[kind]
    shelf = Shelf()
    named = dict(sent(shelf.uploads, path.name, path.read_bytes()) for path in paths)
    choice = replace(choice_of_files(named, SceneChoice()), options=options)
    assert (
        choice.is_sound
        and State.of_link(replace(STATE, scene=choice).link(), "phone").scene == choice
    )
    found = shelf.open(choice)
    for path in paths:
        (tmp_path / path.name).write_bytes(path.read_bytes())
    own = gs.open_scene(
        tmp_path if kind == "bands" else tmp_path / paths[0].name, **choice.arguments()
    )
    assert digest(found.content) == digest(own.content) and found.shape == own.shape
    assert shelf.open(choice) is found
    # another client does not have it: it is asked for by its hash
    with pytest.raises(Wanted, match=next(iter(named.values()))) as error:
        Shelf().open(choice)
    assert error.value.files == named and "\n" not in str(error.value)


def test_a_file_is_bounded(tmp_path, monkeypatch):
    """In bytes, in pixels, by its name and kind: each refusal is one line that says what is allowed."""
    uploads = Uploads()
    for name, size, words in (
        ("photo.png", module.MOST_BYTES + 1, "allowed are 512 MiB"),
        ("notes.txt", 10, "allowed are .exr"),
        ("../photo.png", 10, "rename the file"),
        (".png", 10, "rename the file"),
        ("a" * 200 + ".png", 10, "rename the file"),
        ("a\nb.png", 10, "rename the file"),
    ):
        with pytest.raises(BadFile, match=words) as error:
            uploads.check(name, size)
        assert "\n" not in str(error.value)
    uploads.check("photo.png", module.MOST_BYTES)
    # a picture of 1 bit a pixel: 30 kB in the file, 2.6 GB to read
    Image.new("1", (8000, 8000)).save(tmp_path / "large.png")
    shelf = Shelf(uploads)
    choice = SceneChoice(
        "large.png", dict([sent(uploads, "large.png", (tmp_path / "large.png").read_bytes())])
    )
    monkeypatch.setattr("gpusim.io.scene.photo._png", None)  # nothing may be decoded
    with pytest.raises(
        GpusimError,
        match=r"^large.png: picture of 8000 x 8000 pixels needs .* allowed here is 2.00 GiB",
    ):
        shelf.open(choice)


def test_a_scene_of_too_many_pixels_is_refused(tmp_path, monkeypatch):
    shelf = Shelf()
    choice = SceneChoice("a.png", dict([sent(shelf.uploads, "a.png", photo_bytes(tmp_path))]))
    monkeypatch.setattr(shelves, "MOST_PIXELS", 48 * 32 - 1)
    with pytest.raises(GpusimError, match=r"^a\.png: 48 x 32 pixels; allowed are"):
        shelf.open(choice)


def test_a_limit_of_memory_ends_with_its_block():
    with limit_memory(1000):
        require_memory("a thing", 1000)
        with pytest.raises(TooLarge, match=r"^a thing needs about .*; allowed here is"):
            require_memory("a thing", 1001)
    require_memory("a thing", 1001)


def test_files_are_kept_while_there_is_room_and_go_with_their_client(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "MOST_KEPT", 250)
    uploads = Uploads()
    first, second = (dict([sent(uploads, f"{name}.csv", name.encode() * 100)]) for name in "ab")
    uploads.path(*next(iter(first.items())))  # used last
    third = dict([sent(uploads, "c.csv", b"c" * 100)])
    assert uploads.missing(first | second | third) == second
    with pytest.raises(Wanted, match=r"b\.csv"):
        uploads.together(first | second)
    folder = uploads.path(*next(iter(first.items()))).parents[1]
    assert folder.is_dir()
    del uploads
    assert not folder.exists()


def test_only_the_wanted_file_is_taken():
    """By its content, whatever its name."""
    uploads = Uploads()
    wanted = {"lamp.csv": hashlib.sha256(LAMP.encode()).hexdigest()}
    for data in (b"another", LAMP.encode()):
        path = uploads.arriving()
        path.write_bytes(data)
        if data == b"another":
            with pytest.raises(BadFile, match=f"wanted {wanted['lamp.csv']}: this is another file"):
                uploads.keep("lamp.csv", path, wanted)
            assert uploads.missing(wanted) == wanted and not path.exists()
        else:
            assert dict([uploads.keep("renamed.csv", path, wanted)]) == wanted
    assert uploads.path("lamp.csv", wanted["lamp.csv"]).read_text() == LAMP


@pytest.mark.parametrize(
    "found",
    [
        {"scene": {"name": "photo.png"}},  # of this machine
        {"scene": {"name": "/etc/passwd"}},
        {"scene": {"name": "x.png", "files": {"../x.png": "0" * 64}}},
        {"scene": {"name": "../x", "files": {"x.png": "0" * 64}}},
        {"scene": {"name": "x.png", "files": {"x.png": "0" * 63}}},
        {"scene": {"name": "x.png", "files": ["x.png"]}},
        {"scene": {"name": "flat", "size": [10**5, 10**5]}},
        {"scene": {"name": "flat", "size": [0, 3]}},
        {"scene": {"name": "flat", "size": "3x4"}},
        {"scene": {"name": "flat", "options": {"name_or_path": "x"}}},
        {"scene": {"name": "flat", "options": {"border": 3}}},
        {"scene": {"moon": 1}},
        {"scene": []},
        {"light": "lamp.csv"},
        {"light": "/tmp/lamp"},
        {"changes": {"processor.demosaic": "../../secret.npz"}},
        {"against": {"changes": {"processor.demosaic": "secret.npz"}}},
        {"files": {"lamp.csv": "x"}},
        {"files": {"a/b.csv": "0" * 64}},
    ],
)
def test_a_link_names_no_files_of_this_machine(found):
    with pytest.raises(BadData, match=r"^link: not one of this preview's"):
        State.of_link(json.dumps(found), "phone")


def test_a_link_opens_no_camera_file_of_this_machine():
    """Nor one without a suffix."""
    for name in ("/etc/passwd", "own.toml", "x"):
        kept = {"B": {"camera": name, "changes": {}}}
        state = State.of_link(json.dumps({"camera": name, "snapshots": kept}), "mono")
        assert state.camera == state.snapshots["B"]["camera"] == "mono"


def test_a_link_has_the_scene_and_the_files_that_are_used():
    files = {"lamp.csv": "1" * 64, "unused.csv": "2" * 64}
    own = SceneChoice("a.exr", {"a.exr": "3" * 64}, options={"fov": "30"})
    state = replace(STATE, scene=own, light="lamp.csv", files=files)
    read = State.of_link(state.link(), "phone")
    assert read == replace(state, files={"lamp.csv": "1" * 64})
    assert State.of_link(STATE.link(), "phone") == STATE


def test_the_scene_and_the_light_of_a_state_are_shown(tmp_path):
    """The picture is that of `open_scene` with the same arguments, bit for bit."""
    producer = producer_of()
    lamp = dict([sent(producer.shelf.uploads, "lamp.csv", LAMP.encode())])
    photo = dict([sent(producer.shelf.uploads, "a.png", photo_bytes(tmp_path))])
    (tmp_path / "lamp.csv").write_text(LAMP)
    for choice, name in (
        (CHART, "colorchecker"),
        (SceneChoice("a.png", photo), tmp_path / "made.png"),
    ):
        for light, luminance in ((None, None), ("A", None), (None, 30.0), ("lamp.csv", 40.0)):
            state = replace(STATE, scene=choice, light=light, luminance=luminance, files=lamp)
            own = tmp_path / "lamp.csv" if light == "lamp.csv" else light
            scene = gs.open_scene(
                name, light=own and str(own), luminance=luminance, **choice.arguments()
            )
            simulate = gs.Simulator(gs.open_camera("phone"), device="opencl")
            frame = producer.frame(state, 5)
            assert np.array_equal(frame.mean, simulate(scene, first=5).mean), (choice, light)
            assert np.array_equal(frame.rgb, producer.picture(state, 5).codes)


def test_undo_goes_through_scenes():
    producer, history = producer_of(), History(STATE)
    first = producer.picture(STATE, 0).codes
    history.set(replace(STATE, scene=SceneChoice("deadleaves", size=(64, 40))), "")
    assert producer.picture(history.state, 0).codes.shape == (40, 64, 3)
    assert history.undo() and np.array_equal(producer.picture(history.state, 0).codes, first)
    # the scenes of the command line are one of them
    assert producer.picture(replace(STATE, scene=SceneChoice()), 0).codes.shape == (16, 16, 3)


def test_a_scene_that_cannot_be_read_leaves_the_last_picture(tmp_path):
    producer = producer_of()
    first = producer.picture(STATE, 0).codes
    bad = dict([sent(producer.shelf.uploads, "bad.png", b"no picture")])
    with pytest.raises(GpusimError, match=r"^bad\.png: ") as error:
        producer.picture(replace(STATE, scene=SceneChoice("bad.png", bad)), 0)
    assert str(tmp_path) not in str(error.value) and "gpusim-preview" not in str(error.value)
    assert np.array_equal(producer.picture(STATE, 0).codes, first)


def test_a_panorama_is_seen_by_the_camera(tmp_path):
    """As `view_panorama` shows it; again when the lens changes, not when the noise does."""
    values = np.random.default_rng(5).random((3, 32, 64)).astype(np.float32)
    content = gs.Cube(np.array([450.0, 550.0, 650.0]), values)
    gs.save_scene(
        gs.Scene(content, gs.chart("flat", size=(8, 8)).illuminant, projection="equirectangular"),
        tmp_path / "all.npz",
    )
    producer = producer_of()
    named = dict([sent(producer.shelf.uploads, "all.npz", (tmp_path / "all.npz").read_bytes())])
    state = replace(STATE, scene=SceneChoice("all.npz", named, SIZE))
    phone, panorama = gs.open_camera("phone"), gs.open_scene(tmp_path / "all.npz")
    for camera in (phone, phone.with_(focal_length_mm=3.0)):
        own = producer._scene_in(state, 0, camera)
        assert digest(own.content) == digest(gs.view_panorama(panorama, camera, size=SIZE).content)
        assert producer._scene_in(state, 1, camera.with_(read_e=9.0)) is own


STATES = {
    "chart": replace(STATE, changes={"optics.f_number": 2.8, "optics.zernike_waves.7": 0.1}),
    "light": replace(
        STATE,
        tolerance="1e-3",
        light="A",
        luminance=31.4159,
        seed=2**31,
        scene=replace(CHART, options={"samples_per_pixel": "1.5", "border": "reflect"}),
    ),
    "file": replace(STATE, camera="mono", scene=SceneChoice("a.png"), light="lamp.csv"),
}


@pytest.mark.parametrize("kind", STATES)
def test_a_command_line_and_a_cell_make_the_same_frame(kind, tmp_path, monkeypatch):
    """Bit for bit: the arrays in the file that the page saves, and in those of the command and the cell."""
    state, number = STATES[kind], 11
    producer = Producer(Still(gs.chart("flat", size=(16, 16)), 1), open_device("opencl"))
    uploads = producer.shelf.uploads
    if kind == "file":
        data = photo_bytes(tmp_path)
        state = replace(
            state,
            scene=SceneChoice("a.png", dict([sent(uploads, "a.png", data)])),
            files=dict([sent(uploads, "lamp.csv", LAMP.encode())]),
        )
        (tmp_path / "a.png").write_bytes(data)
        (tmp_path / "lamp.csv").write_text(LAMP)
    monkeypatch.chdir(tmp_path)
    producer.frame(state, number).save("saved.npz")
    (tmp_path / "camera.toml").write_text(state.toml())
    program, *words = shlex.split(command_line(state, number))
    assert program == "gpusim" and main([*words, "--device", "opencl"]) in (0, 1)
    (tmp_path / "cell").mkdir()
    for name in ("a.png", "lamp.csv"):
        if (tmp_path / name).exists():
            (tmp_path / "cell" / name).write_bytes((tmp_path / name).read_bytes())
    monkeypatch.chdir(tmp_path / "cell")
    (tmp_path / "cell" / "cell.py").write_text(notebook_cell(state, number))
    runpy.run_path("cell.py")["frame"].save("made.npz")
    with np.load(tmp_path / "saved.npz") as saved:
        for path in (tmp_path / "frame.npz", tmp_path / "cell" / "made.npz"):
            with np.load(path) as made:
                assert {*made} == {*saved}
                for name in saved:
                    assert np.array_equal(made[name], saved[name]), (path.name, name)


def test_a_cell_refuses_another_file(tmp_path, monkeypatch):
    own = SceneChoice("a.png", {"a.png": hashlib.sha256(b"own").hexdigest()})
    (tmp_path / "a.png").write_bytes(b"another")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError, match=r"a\.png"):
        exec(notebook_cell(replace(STATE, scene=own), 0), {})


def test_a_short_camera_file_is_the_same_camera(tmp_path):
    changes = {"noise.read_e": 3.5, "optics.zernike_waves.5": 0.1, "processor.tone": "contrast"}
    for state in (STATE, replace(STATE, camera="mono", changes=changes)):
        (tmp_path / "camera.toml").write_text(camera_text(state))
        assert digest(gs.open_camera(tmp_path / "camera.toml")) == digest(state.build())
        assert "f_number" not in camera_text(state) and "f_number" in state.toml()


def test_the_options_of_scenes_are_those_of_open_scene():
    import inspect

    known = inspect.signature(gs.open_scene).parameters
    assert OPTIONS.keys() == known.keys() - {"name_or_path", "size", "light", "luminance"}
    for name, texts in {
        "wavelengths": ("400:700", "400:700:0", "a"),
        "scale": ("x",),
        "bands": ("red", "red=x"),
        "kind": ("energy",),
        "fov": ("wide",),
    }.items():
        for text in texts:
            with pytest.raises(
                BadData, match=f"^{OPTIONS[name].label.partition('[')[0].strip()}.*wanted"
            ):
                SceneChoice("flat", options={name: text}).arguments()


@pytest.mark.parametrize(
    ("heads", "status"),
    [
        ({}, None),
        ({"content-length": "100"}, None),
        ({"content-length": "101"}, 413),
        ({"content-length": "-5"}, 400),
        ({"transfer-encoding": "chunked"}, 411),
    ],
)
def test_long_bodies_are_refused_before_they_are_read(heads, status):
    import asyncio

    told, entered = [], []

    async def inner(*_):
        entered.append(1)

    async def send(message):
        told.append(message)

    scope = {
        "type": "http",
        "headers": [(name.encode(), value.encode()) for name, value in heads.items()],
    }
    asyncio.run(BodyLimit(inner, 100)(scope, None, send))
    assert bool(entered) == (status is None)
    assert [message.get("status") for message in told[:1]] == ([status] if status else [])

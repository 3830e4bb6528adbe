"""A client's session: what is sent when, what is kept, and who is let in."""

import asyncio
import io
import struct
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import gpusim as gs
from gpusim.apps.preview import session as module
from gpusim.apps.preview.control import parse
from gpusim.apps.preview.controls import CONTROLS, LIGHTS
from gpusim.apps.preview.guard import Guard
from gpusim.apps.preview.half import halve_scene
from gpusim.apps.preview.labels import describe_exposure
from gpusim.apps.preview.producer import Picture, Producer
from gpusim.apps.preview.session import IN_FLIGHT, Session
from gpusim.apps.preview.state import History, State
from gpusim.apps.video.scenes import Still
from gpusim.backends import open_device
from gpusim.cli.main import main
from gpusim.cli.preview import require_port
from gpusim.domain.digest import digest
from gpusim.domain.errors import BadData, GpusimError
from gpusim.io.camera.cameras import camera_of, camera_table, open_camera

SCENE = gs.chart("colorchecker", size=(48, 32))
STATE = State("phone", tolerance="exact", is_live=False)


class Fake:
    """Pictures of one grey that say their number; refuses f-number 13, and takes a while where it is told to."""

    frames, period = 2**32, 0.0

    def __init__(self):
        self.made = []

    def half_picture(self, state, number):
        return None

    def picture(self, state, number, drafts=False):
        if state.changes.get("optics.f_number") == 13:
            raise GpusimError("optics.f_number = 13: unlucky")
        if state.changes.get("optics.f_number") == 14:
            raise RuntimeError("the GPU has fallen off\nthe bus")
        self.made.append((state, number))
        is_draft = drafts and "optics.f_number" in state.changes
        return Picture(np.full((8, 8, 3), number % 256, np.uint8), number, 1.0, {"draft": is_draft})


class Slow(Fake):
    """Whole pictures of an f-number take half a second; a draft of half the size is there at once."""

    def picture(self, state, number, drafts=False):
        if "optics.f_number" in state.changes:
            time.sleep(0.5)
        return super().picture(state, number, drafts)

    def half_picture(self, state, number):
        return Picture(np.full((4, 4, 3), 7, np.uint8), number, 1.0, {"draft": True})


class Client:
    """Receives frames and acknowledges them where it is told to."""

    def __init__(self, reads=True):
        self.frames, self.reads, self.acks = [], reads, asyncio.Queue()

    async def send(self, data):
        self.frames.append((*struct.unpack("<III", data[:12]), data[12:]))
        if self.reads:
            self.acks.put_nowait(1)

    async def acknowledged(self):
        return await self.acks.get()


def run(scenario, producer=Fake):
    """A scenario of coroutines with a session and its client."""

    async def whole():
        session, client = Session(producer(), STATE), Client()
        serving = asyncio.ensure_future(session.serve(client.send, client.acknowledged))
        try:
            await asyncio.wait_for(scenario(session, client), 30)
        finally:
            serving.cancel()

    asyncio.run(whole())


async def until(what):
    while not what():
        await asyncio.sleep(0.01)


def test_a_picture_that_stands_still_comes_once_and_then_without_loss():
    async def scenario(session, client):
        await until(lambda: len(client.frames) == 2)
        assert [frame[2] for frame in client.frames] == [module.JPEG, module.PNG]
        image = np.asarray(Image.open(io.BytesIO(client.frames[1][3])))
        assert np.array_equal(image, session.shown.codes)
        await asyncio.sleep(0.5)
        assert (
            len(client.frames) == 2 and len(session.producer.made) == 1
        )  # nothing is made that nobody waits for

    run(scenario)


def test_what_stands_still_is_no_draft():
    async def scenario(session, client):
        await until(lambda: len(client.frames) == 2)
        session.set(replace(STATE, changes={"optics.f_number": 4.0}), "optics.f_number")
        await until(lambda: len(client.frames) == 3)
        assert session.shown.facts["draft"]
        await until(lambda: len(client.frames) == 4)
        assert not session.shown.facts["draft"] and client.frames[3][2] == module.PNG
        session.set(
            replace(STATE, changes={"optics.f_number": 5.0}, is_live=True), "optics.f_number"
        )
        await until(lambda: session.shown.facts["draft"])
        await until(lambda: not session.shown.facts["draft"])  # live noise has no end

    run(scenario)


def test_a_picture_that_takes_long_delays_no_draft():
    """A second move while the frame of the first is made whole: a draft at once, and then the frame of the second."""

    async def scenario(session, client):
        await until(lambda: len(client.frames) == 2)
        session.set(replace(STATE, changes={"optics.f_number": 4.0}), "optics.f_number")
        await until(lambda: len(session.producer.made) == 2)  # a draft of the whole size, slow
        await until(lambda: session._is_busy)  # the exact frame
        last = replace(STATE, changes={"optics.f_number": 5.0})
        session.set(last, "optics.f_number")
        begun = time.monotonic()
        await until(lambda: client.frames[-1][1] == session.version)
        assert time.monotonic() - begun < 0.25 and session.shown.codes.shape[0] == 4
        await until(lambda: client.frames[-1][2] == module.PNG)
        assert session.shown.codes.shape[0] == 8 and session.producer.made[-1][0] == last

    run(scenario, Slow)


def test_slow_drafts_become_smaller():
    async def scenario(session, client):
        await until(lambda: len(client.frames) == 2)
        for k in range(module.TIMES):
            changes = {"optics.f_number": 4.0 + k}
            session.set(replace(STATE, changes=changes), "optics.f_number")
            await until(lambda: client.frames[-1][1:3] == (session.version, module.PNG))
        assert session._slow == {"optics.f_number": module.TIMES}
        count = len(session.producer.made)
        session.set(replace(STATE, changes={"optics.f_number": 6.0}), "optics.f_number")
        await until(lambda: client.frames[-1][1] == session.version)
        assert session.shown.codes.shape[0] == 4 and len(session.producer.made) == count
        await until(lambda: client.frames[-1][2] == module.PNG)
        session.set(replace(STATE, changes={"sensor.analog_gain": 2.0}), "sensor.analog_gain")
        await until(lambda: client.frames[-1][1] == session.version)
        assert session.shown.codes.shape[0] == 8  # another slider's

    run(scenario, Slow)


def test_live_noise_has_a_new_number_each_time():
    async def scenario(session, client):
        session.set(replace(STATE, is_live=True))
        await until(lambda: len(client.frames) > 12)
        numbers = [frame[0] for frame in client.frames if frame[2] == module.JPEG]
        assert len({*numbers[1:]}) == len(numbers) - 1
        assert session.rate > 0 and session.latency > 0

    run(scenario)


def test_a_client_that_does_not_read_has_two_frames_in_flight():
    """One of live noise, and one of what was changed since."""

    async def scenario(session, client):
        session.set(replace(STATE, is_live=True))
        await asyncio.sleep(0.5)
        client.reads, first = False, len(client.frames)
        await asyncio.sleep(0.2)
        assert len(client.frames) == first + 1
        for k in range(5):
            session.set(replace(STATE, is_live=True, changes={"sensor.analog_gain": 1.0 + k}))
            await asyncio.sleep(0.1)
        assert IN_FLIGHT == 2 and len(client.frames) == first + 2
        client.acks.put_nowait(1)
        await until(lambda: len(client.frames) == first + 3)
        assert client.frames[-1][1] == session.version
        await asyncio.sleep(0.1)
        assert len(client.frames) == first + 3
        for _ in range(10_000):  # acknowledgements of frames that never were
            client.acks.put_nowait(1)
        client.acks.put_nowait(1)
        await asyncio.sleep(0.3)
        assert len(session._waits) <= module.COUNTED
        count = len(client.frames)
        await asyncio.sleep(0.3)
        assert len(client.frames) <= count + IN_FLIGHT

    run(scenario)


def test_the_newest_settings_win():
    """What is set while a picture is made is not made one after the other."""

    async def scenario(session, client):
        await until(lambda: client.frames)
        for k in range(200):
            session.set(
                replace(STATE, changes={"sensor.analog_gain": 1 + k / 100}), "sensor.analog_gain"
            )
        await until(lambda: client.frames[-1][1] == 200)
        assert len(session.producer.made) < 20
        assert session.producer.made[-1][0].changes["sensor.analog_gain"] == 1 + 199 / 100
        assert (
            session.history.undo() and session.state == STATE
        )  # one slider's movements are one step

    run(scenario)


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (13, "optics.f_number = 13: unlucky"),
        (14, "the device fails: the GPU has fallen off the bus"),
    ],
)
def test_the_last_good_picture_stays(number, words):
    async def scenario(session, client):
        await until(lambda: len(client.frames) == 2)
        good = session.shown
        session.set(replace(STATE, changes={"optics.f_number": number}))
        await until(lambda: session.error)
        assert session.error.replace("\\n", " ") == words and session.shown is good
        await asyncio.sleep(0.4)
        assert len(client.frames) == 2
        session.set(STATE)
        await until(lambda: len(client.frames) == 4)
        assert not session.error

    run(scenario)


class Broken:
    """Four scenes, of which the third cannot be read."""

    count, is_still = 4, False

    def between(self, first, end):
        for number in range(first, end):
            if number == 2:
                raise BadData("scene 2 is damaged")
            yield replace(SCENE, name=f"scene {number}")


def test_scenes_around_a_damaged_one_can_be_shown():
    producer = Producer(Broken(), open_device("numpy"), 1 / 30)
    assert producer._given_scene(1).name == "scene 1"
    for _ in range(2):
        with pytest.raises(BadData, match="scene 2 is damaged"):
            producer._given_scene(2)
    assert producer._given_scene(3).name == "scene 3"
    with pytest.raises(BadData, match="scene 2 is damaged"):
        producer._given_scene(2)
    assert producer._given_scene(0).name == "scene 0"
    assert producer._given_scene(1).name == "scene 1"


def test_a_producer_makes_what_a_simulator_does():
    """After any changes, one after the other: raw values and codes, bit for bit."""
    producer, random = Producer(Still(SCENE, 1), open_device("opencl")), np.random.default_rng(8)
    state = STATE
    for _ in range(12):
        control = list(CONTROLS.values())[random.integers(len(CONTROLS))]
        table = camera_table("phone")[1]
        value = (
            control.choices[random.integers(len(control.choices))]
            if control.choices
            else float(control.low + (control.high - control.low) * random.random() ** 3)
        )
        if control.key == "object_distance_m":
            value = max(value, 0.2)
        changed = replace(
            state,
            changes={**state.changes, control.name: value},
            light=LIGHTS[random.integers(4)],
            luminance=float(random.integers(10, 1000)),
        )
        try:
            made = producer.picture(changed, 3)
        except GpusimError:
            continue  # one that cannot be, which the page says
        state = changed
        frame = producer.frame(state, 3)
        assert np.array_equal(made.codes, frame.rgb), control.name
        assert state.value(control, table) == value
        own = producer.picture(state, 3)
        assert np.array_equal(own.codes, made.codes)
    assert len(state.changes) > 5


def test_drafts_are_near_the_picture_and_leave_no_trace():
    scene = gs.chart("deadleaves", size=(320, 256))
    producer, state = (
        Producer(Still(scene, 1), open_device("opencl")),
        replace(STATE, tolerance="1e-3"),
    )
    producer.picture(state, 0)
    for name, value in (
        ("optics.f_number", 2.2),
        ("optics.defocus_um", 3.0),
        ("optics.object_distance_m", 2.0),
        ("optics.zernike_waves.10", 0.02),
    ):
        changed = replace(state, changes={"sensor.exposure_time_ms": 20.0, name: value})
        draft = producer.picture(changed, 3, drafts=True)
        assert draft.facts["draft"] and draft.facts["verdict"] is None
        settled, frame = producer.picture(changed, 3), producer.frame(changed, 3)
        assert not settled.facts["draft"] and np.array_equal(settled.codes, frame.rgb)
        assert np.abs(draft.codes.astype(int) - settled.codes).mean() < 0.5


def half_of(codes):
    rows, cols, _ = codes.shape
    return codes.reshape(rows // 2, 2, cols // 2, 2, 3).mean(axis=(1, 3))


@pytest.mark.parametrize("kind", ["deadleaves", "colorchecker"])
def test_half_pictures_are_near_the_picture_and_leave_no_trace(kind):
    """Without noise: as the means of 2 x 2 pixels of the whole picture, but for a quarter of its contrast.

    The quarter is structure finer than two pixels: pixels twice as wide blur it, and each sees one colour of it. They
    are made while another thread plans: the same as in turn, and so is what that thread makes.
    """
    scene = gs.chart(kind, size=(320, 256))
    producer = Producer(Still(scene, 1), open_device("opencl"))
    quiet = {"noise.photon": "none", "noise.read_e": 0.0, "noise.prnu": 0.0, "noise.dsnu_e": 0.0}
    state = replace(STATE, tolerance="1e-3", changes={**quiet, "sensor.exposure_time_ms": 20.0})
    assert producer.half_picture(state, 0) is None  # nothing is planned
    producer.picture(state, 0)
    with ThreadPoolExecutor(1) as pool:
        for name, value in (
            ("optics.f_number", 4.0),
            ("optics.zernike_waves.7", 0.2),
            ("sensor.pixel_pitch_um", 1.8),
            ("processor.denoise", 1.0),
            ("noise.read_e", 0.1),
        ):
            changed = replace(state, changes={**state.changes, name: value})
            first = producer.half_picture(changed, 3)
            planned = pool.submit(producer.picture, changed, 3)
            beside = [producer.half_picture(changed, 3) for _ in range(3)]
            whole, frame = planned.result(), producer.frame(changed, 3)
            assert np.array_equal(whole.codes, frame.rgb)
            assert first.facts["draft"] and not whole.facts["draft"]
            assert "draft of half the resolution" in describe_exposure(first.facts)
            assert np.array_equal(beside[0].codes, first.codes)
            wanted = half_of(whole.codes)
            error, contrast = first.codes - wanted, np.abs(wanted - wanted.mean()).mean()
            assert abs(error.mean()) < 0.5 and np.abs(error).mean() < contrast / 4, name
            assert abs(first.facts["exposure"] / whole.facts["exposure"] - 1) < 0.01


def test_scenes_that_have_no_half():
    producer = Producer(Broken(), open_device("numpy"), 1 / 30)
    producer.picture(STATE, 0)
    assert producer.half_picture(STATE, 0) is None  # it moves
    for scene in (
        replace(SCENE, samples_per_pixel=2.0),
        replace(SCENE, view=gs.View((0.0, 1.0))),
        gs.chart("colorchecker", size=(60, 40)),
    ):
        assert halve_scene(scene) is None


def test_saved_files_make_the_same_camera(tmp_path):
    changes = {
        "optics.f_number": 2.8,
        "optics.zernike_waves.7": 0.2,
        "sensor.exposure_time_ms": "auto",
        "optics.object_distance_m": float("inf"),
        "processor.shading": True,
    }
    state = State("phone", changes)
    (tmp_path / "camera.toml").write_text(state.toml())
    saved, own = open_camera(tmp_path / "camera.toml"), state.build()
    assert digest(saved) == digest(own) and saved.optics.wavefront.zernike[7] == 0.2
    # files that a camera names are found from anywhere
    (tmp_path / "qe.csv").write_text("wavelength_nm,Y\n400,0.5\n700,0.6\n")
    (tmp_path / "own.toml").write_text(
        "[optics]\nf_number = 2\nfocal_length_mm = 4\n[sensor]\npixel_pitch_um = 2\n"
        "full_well_e = 5000\nbits = 10\n"
        'qe = "qe.csv"\ncfa = ["Y"]\n[processor]\ncolor = "none"\n'
    )
    other = State(str(tmp_path / "own.toml"), {"optics.f_number": 5.6})
    (tmp_path / "far").mkdir()
    (tmp_path / "far" / "camera.toml").write_text(other.toml())
    assert open_camera(tmp_path / "far" / "camera.toml").optics.f_number == 5.6


def test_a_link_has_all_settings():
    state = State("mono", {"noise.read_e": 3.5}, "A", 20.0, "1e-3", "noise", False, 7, 11)
    assert State.of_link(state.link(), "phone") == state
    assert State.of_link("{}", "phone") == State("phone")
    for text in (
        "",
        "3",
        '{"view":"x"}',
        '{"seed":-1}',
        '{"seed":true,"x":1}',
        '{"changes":[1]}',
        "{" * 9000,
    ):
        with pytest.raises(BadData, match=r"^link: not one of this preview's"):
            State.of_link(text, "phone")
    # nor does it read files
    assert State.of_link('{"camera":"/etc/passwd.toml"}', "phone").camera == "phone"


def test_undo_and_redo():
    history = History(STATE)
    states = [replace(STATE, seed=seed) for seed in range(1, 4)]
    for state in states:
        history.set(state, "")
    assert history.undo() and history.undo() and history.state == states[0]
    assert history.redo() and history.state == states[1]
    history.set(STATE, "")
    assert not history.redo() and history.undo() and history.state == states[1]
    assert history.undo() and history.undo() and not history.undo() and history.state == STATE


def test_every_control_is_of_a_camera_file():
    """Its key is known there, in its unit, at both ends of its range and as what it has by default."""
    for control in CONTROLS.values():
        path, table = camera_table("phone")
        texts = [parse(word) for word in control.suggested]
        ends = () if control.is_text else (control.low, control.high, control.off)
        for value in control.choices or texts or ends:
            state = State("phone", {control.name: value} if value is not None else {})
            try:
                camera_of(path, state.table())
            except GpusimError as error:
                assert "unknown" not in str(error) and control.key.split("_")[0] in str(error), (
                    error
                )
        given = table.get(control.section, {}).get(control.key)
        if given is not None and control.item is None and not control.named:
            assert State("phone").value(control, table) == given


@pytest.mark.parametrize(
    ("heads", "is_own"),
    [
        ({"host": "127.0.0.1:8080"}, True),
        ({"host": "localhost:9000"}, True),
        ({"host": "[::1]:80"}, True),
        ({"host": "127.0.0.1:8080", "origin": "http://127.0.0.1:8080"}, True),
        ({"host": "evil.example:8080"}, False),
        ({}, False),
        ({"host": "127.0.0.1@evil.example"}, False),
        ({"host": "127.0.0.1:8080", "origin": "http://evil.example"}, False),
        ({"host": "[::1"}, False),
        ({"host": "127.0.0.1:8080", "origin": "null"}, False),
        ({"host": "127.0.0.1:8080", "origin": "http://127.0.0.1:9"}, False),
    ],
)
@pytest.mark.parametrize("kind", ["http", "websocket"])
def test_only_pages_of_its_own_are_let_in(heads, is_own, kind):
    sent, entered = [], []

    async def inner(*_):
        entered.append(1)

    async def send(message):
        sent.append(message)

    scope = {
        "type": kind,
        "path": "/",
        "headers": [(name.encode(), value.encode()) for name, value in heads.items()],
    }
    asyncio.run(Guard(inner)(scope, None, send))
    assert bool(entered) == is_own
    if not is_own:
        assert sent[0].get("status", sent[0].get("code")) in (403, 1008)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (["none.png"], "none.png"),
        (["moon"], "unknown scene 'moon'"),
        (["flat", "--tolerance", "1e-7"], "unknown --tolerance of a preview '1e-7'"),
        (["flat", "--port", "0"], "--port"),
        (["flat", "--f-number", "2", "--camera", "none"], "unknown camera 'none'"),
        (["flat", "--host", "198.51.100.7"], "a free port of an address of this machine"),
        (["flat", "--iso", "800"], "--iso: the preview sets the gain with its slider"),
    ],
)
def test_what_cannot_be_shown_is_said_in_a_line(asked, words, capsys):
    asked = asked if "--camera" in asked else [*asked, "--camera", "phone"]
    try:
        status = main(["preview", *asked, "--device", "numpy"])
    except SystemExit as stopped:
        status = stopped.code
    said = capsys.readouterr().err
    assert status == 2 and words in said and "Traceback" not in said and len(said.splitlines()) == 1


def test_a_port_that_is_taken_is_named():
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(GpusimError, match=f"127.0.0.1:{port}: allowed is a free port"):
            require_port("127.0.0.1", port)

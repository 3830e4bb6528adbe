"""Damage that once ended in tracebacks, hangs or silence: data sheets, links, manifests, videos, scans of JPEGs."""

import io
import json
from contextlib import suppress
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from refusals import refused

import gpusim as gs
from gpusim.apps.preview.controls import CONTROLS
from gpusim.apps.preview.state import State
from gpusim.apps.video.loops import Lags, Loops
from gpusim.apps.video.manifest import Plans, keep_manifest
from gpusim.domain.errors import BadData, BadFile, GpusimError
from gpusim.domain.pupil import Pupil

SHEET = {
    "pixel_pitch": 3.45e-6,
    "quantum_efficiency": 0.6,
    "wavelength": 525.0,
    "gain": 0.4,
    "bits": 12,
    "saturation_capacity": 8000.0,
    "dark_noise": 5.0,
}


@pytest.mark.parametrize(
    "change",
    [
        {"gain": 10**400},
        {"wavelength": 10**5000},
        {"quantum_efficiency": 10**400},
        {"response": 3.0},
        {"cfa": 3},
        {"channels": (1,)},
        {"channels": None},
        {"cfa": (("R",),)},
        {"bits": 10**400},
        {"black_level": 10**400},
    ],
)
def test_data_sheets_of_other_kinds_are_refused(change):
    with refused(error=GpusimError):
        gs.sensor_from_emva1288(**SHEET | change)


HUGE = 10**5000  # more digits than Python writes


@pytest.mark.parametrize(
    "make",
    [
        lambda: gs.Noise(temperature=Decimal(25)),
        lambda: gs.Noise(reference_temperature=Decimal(25)),
        lambda: gs.Noise(photon=HUGE),
        lambda: gs.Noise(dark_current=HUGE),
        lambda: gs.Noise(seed=HUGE),
        lambda: gs.AutoExposure(HUGE),
        lambda: gs.Optics(4.0, HUGE),
        lambda: gs.Optics(4.0, False),
        lambda: Pupil(rotation=HUGE),
        lambda: gs.Processor(color=HUGE),
        lambda: gs.Display(curve=HUGE),
        lambda: replace(gs.open_camera("phone").sensor, binning=(HUGE, 1)),
        lambda: replace(gs.open_camera("phone").sensor, centre=("x", HUGE)),
        lambda: gs.illuminant(HUGE),
        lambda: gs.open_scene("ramp", depth=HUGE),
        lambda: replace(gs.chart("ramp"), name=HUGE, depth=np.ones((3, 3))),
    ],
)
def test_numbers_of_other_kinds_are_refused(make):
    with refused(error=GpusimError):
        make()


def test_a_scene_may_have_any_name():
    picture = gs.display_picture(np.zeros((4, 4, 3), np.uint8), gs.open_display("srgb"))
    assert replace(picture, name=HUGE).name == HUGE


@pytest.mark.parametrize(
    "text",
    [
        "[" * 4000,
        '{"against":{"camera":3}}',
        '{"against":{"view":"raw"}}',
        '{"luminance":"x"}',
        '{"luminance":1e400}',
        '{"changes":{"optics.f_number":[2]}}',
        '{"changes":{"processor.tone":{}}}',
        '{"light":3}',
        '{"is_live":3}',
    ],
)
def test_links_of_other_kinds_are_refused(text):
    with refused("link: not one of this preview's", error=BadData):
        State.of_link(text, "phone")


@pytest.mark.parametrize("control", CONTROLS.values(), ids=CONTROLS)
@pytest.mark.parametrize("value", [1e300, -1e300, 10**400, "x", [1, 2], {}, float("nan")])
def test_settings_far_beyond_a_slider_are_refused_at_once(control, value):
    """A text takes any value of a camera file: it is refused in a line, or makes a camera."""
    with suppress(GpusimError) if control.is_text else refused(error=GpusimError):
        State("phone", {control.name: value}).build()


@pytest.mark.parametrize(
    "text",
    [
        "[" * 10**5,
        "3",
        "{}",
        '{"loops": {"seconds": ["x", 1]}}',
        '{"loops": {"seconds": [1]}}',
        '{"loops": {}}',
        '{"loops": {"seconds": [1, -1]}}',
    ],
)
def test_damaged_manifests(text, tmp_path):
    path = tmp_path / "video.json"
    path.write_text(text)
    assert Loops.read_manifest(path, Lags(exposure=1.0), 2) is None
    with (
        refused(error=BadFile),
        keep_manifest(path, {"loops": {"seconds": [1.0, 2.0]}}, "the rest", lambda: False),
    ):
        pass
    path.write_text(json.dumps({"loops": {"seconds": [1.0, 2.0]}}))
    assert Loops.read_manifest(path, Lags(exposure=1.0), 2) == Loops(seconds=[1.0, 2.0])


@pytest.mark.parametrize(
    "plans", [3, [], None, *({"a": runs} for runs in (3, [3], [[1]], [["0", 1]], [[0, 1.5]]))]
)
def test_manifests_with_other_things_for_plans(plans, tmp_path):
    path = tmp_path / "video.json"
    path.write_text(json.dumps({"frames": 2, "plans": plans}))
    with (
        refused("not a manifest", error=BadFile),
        keep_manifest(path, {"frames": 2}, "the rest", lambda: False),
    ):
        pass
    Plans(path).write()  # of a run that had begun: what was damaged since is not its fault
    assert json.loads(path.read_text())["plans"] == plans


def test_truncated_and_damaged_videos(tmp_path):
    """What is cut, or what a decoder finds damaged, is refused every time: 24 reads once hung in 10 of 12."""
    import av

    from gpusim.apps.video.video_frames import Film

    frames = np.random.default_rng(3).integers(0, 256, (9, 64, 96, 3), np.uint8)
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264", rate=Fraction(25))
        stream.width, stream.height, stream.pix_fmt = 96, 64, "yuv420p"
        for number, values in enumerate(frames):
            frame = av.VideoFrame.from_ndarray(values, format="rgb24")
            frame.pts, frame.time_base = number, Fraction(1, 25)
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    data = path.read_bytes()

    def read():
        film = Film(path, "srgb")
        return sum(1 for _ in film.between(0, film.count))

    assert read() == 9
    path.write_bytes(data[:-200])  # the last frame, and the index, which may be missing
    with refused("truncated", error=BadFile):
        read()
    damaged = bytearray(data)
    damaged[len(data) // 3 : len(data) // 3 + 600] = bytes(600)
    path.write_bytes(damaged)
    for _ in range(24):
        with refused(error=BadFile):
            read()


def test_damaged_scans_of_jpegs_are_noted(tmp_path):
    from PIL import Image

    random, buffer, path = np.random.default_rng(1), io.BytesIO(), tmp_path / "a.jpg"
    Image.fromarray(random.integers(0, 256, (80, 112, 3), np.uint8)).save(buffer, "JPEG")
    path.write_bytes(buffer.getvalue())
    assert gs.open_scene(path).notes == ()
    data = bytearray(buffer.getvalue())
    middle = (data.index(b"\xff\xda") + len(data)) // 2
    data[middle : middle + 40] = bytes(40)
    path.write_bytes(data)
    assert "libjpeg" in gs.open_scene(path).notes[0]


@pytest.mark.parametrize("value", [np.zeros((3, 4, 5)), None, 3, [1, 2]])
def test_what_is_no_name_of_a_scene(value):
    with refused("wanted a chart's name or a file; use gpusim.scene_from", error=BadData):
        gs.open_scene(value)

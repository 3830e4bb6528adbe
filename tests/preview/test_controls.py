"""Controls of the preview: one for each key, what is typed, what excludes what, values that are not used."""

import asyncio
import math
from dataclasses import replace

import numpy as np
import pytest
from test_session import SCENE, STATE, Fake, run, until

import gpusim as gs
from gpusim.apps.preview.comparison import (
    AMPLIFIED,
    compare,
    describe_step,
    list_differences,
    name_pictures,
)
from gpusim.apps.preview.control import as_text, parse
from gpusim.apps.preview.controls import CONTROLS
from gpusim.apps.preview.overrides import Given
from gpusim.apps.preview.producer import Producer
from gpusim.apps.preview.scene_choice import SceneChoice
from gpusim.apps.preview.state import COMPARISONS, State
from gpusim.apps.video.scenes import Still
from gpusim.backends import open_device
from gpusim.domain.camera_keys import SECTIONS
from gpusim.domain.errors import BadData, GpusimError


def test_every_key_of_a_camera_file_has_a_control():
    keys = {(section, key) for section, known in SECTIONS.items() for key in known}
    assert {(one.section, one.key) for one in CONTROLS.values()} == keys
    labels = [one.label for one in CONTROLS.values()]
    assert len({*labels}) == len(labels)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2", 2),
        ("2.5", 2.5),
        ("true", True),
        ("inf", math.inf),
        ("x-trans", "x-trans"),
        ('"x-trans"', "x-trans"),
        ('["RG", "GB"]', ["RG", "GB"]),
        ("{k1 = -0.1, k2 = 0.02, radius_mm = 2.9}", {"k1": -0.1, "k2": 0.02, "radius_mm": 2.9}),
        ("[[0.8, 1], [1, 0.8]]", [[0.8, 1], [1, 0.8]]),
        ("", ""),
        ("1\nnoise = 2", "1\nnoise = 2"),  # one value, not two keys
        ("[" * 5000, "[" * 5000),
    ],
)
def test_what_is_typed_is_a_value_of_a_camera_file(text, value):
    assert parse(text) == value and type(parse(text)) is type(value)
    assert parse(as_text(value)) == value


def test_a_text_that_looks_like_a_number_stays_a_text():
    assert as_text("2") == '"2"' and parse(as_text("2")) == "2"


def test_a_key_removes_those_that_it_excludes():
    state = State("phone").change("optics.defocus_um", 3.0).change("optics.defocus_diopters", 0.1)
    assert state.changes == {"optics.defocus_diopters": 0.1}
    assert state.build().optics.defocus != 0
    # of a camera's file too, as a file with that base would
    state = State("phone").change("sensor.sensitivity", "iset-rgb")
    assert "qe" not in state.table()["sensor"]
    items = State("phone").change("optics.zernike_waves.7", 0.1)
    whole = items.change("optics.zernike_waves", [0.0, 0.0, 0.0, 0.2])
    assert whole.build().optics.wavefront.zernike == (0.0, 0.0, 0.0, 0.2)
    both = whole.change("optics.zernike_waves.7", 0.1).build().optics.wavefront.zernike
    assert both[3] == 0.2 and both[7] == 0.1


def test_a_mosaic_brings_a_processor_that_fits_it():
    for name in ("x-trans", "mono", "quad-bayer"):
        camera = State("phone").change("sensor.cfa", name).build()
        assert camera.sensor.cfa == gs.open_camera("phone").with_(cfa=name).sensor.cfa


def test_parts_of_a_table_are_set_one_by_one():
    state = (
        State("phone").change("optics.pupil.blades", 6).change("optics.pupil.rotation_deg", 15.0)
    )
    pupil = state.build().optics.pupil
    assert pupil.blades == 6 and math.isclose(pupil.rotation, math.radians(15))
    state = State("phone").change("sensor.auto_exposure.method", "mean")
    assert state.build().sensor.auto_exposure.method == "mean"


def test_items_of_a_list_of_lists_are_refused_in_a_line(tmp_path):
    (tmp_path / "own.toml").write_text(
        'base = "phone"\n[optics]\nzernike_waves = [[0, 0, 0, 0.1], [0, 0, 0, 0.2]]\n'
        "zernike_heights = [0, 1]\n"
    )
    state = State(str(tmp_path / "own.toml"))
    assert state.value(CONTROLS["optics.zernike_waves.7"], state.table()) is None
    with pytest.raises(BadData, match=r"coma \(Z8\): zernike_waves is no list of numbers"):
        state.change("optics.zernike_waves.7", 0.1).build()


def test_links_hold_lists_and_name_no_files():
    state = State("phone").change("sensor.cfa", ["RG", "GB"]).change("sensor.qe", "iset-rgb")
    state = state.keep("low").change("noise.read_e", 2.0)
    assert State.of_link(state.link(), "phone") == state
    for value in ("qe.csv", "/etc/passwd", {"file": "x.yaml"}, ["a.npz"]):
        bad = replace(state, changes={"sensor.qe": value})
        with pytest.raises(BadData, match="link: not one of this preview's"):
            State.of_link(bad.link(), "phone")


def test_a_camera_that_is_an_object_has_the_same_controls():
    camera = gs.open_camera("phone").with_(pupil={"blades": 5}, birefringence_um=[1.5, 1.0])
    state = Given("phone", given=camera)
    changed = state.change("optics.pupil.obscuration", 0.2).change("noise.read_e", 1.0)
    made = changed.build()
    assert made.optics.pupil.blades == 5 and made.optics.pupil.obscuration == 0.2
    assert (
        made.sensor.noise.read == 1.0 and made.optics.birefringence == camera.optics.birefringence
    )


class Partners(Fake):
    """Needs two keys together, as hot pixels and their current do."""

    def picture(self, state, number, drafts=False):
        if state.changes.get("noise.hot_pixels") and not state.changes.get(
            "noise.hot_current_e_per_s"
        ):
            raise GpusimError("noise.hot_pixels = 0.01 without noise.hot_current: wanted both")
        return super().picture(state, number, drafts)


def test_a_value_that_makes_no_picture_waits_and_freezes_nothing():
    async def scenario(session, client):
        session.producer = Partners()
        await until(lambda: len(client.frames) == 2)
        session.set(session.state.change("noise.hot_pixels", 0.01), "noise.hot_pixels")
        await until(lambda: session.held)
        assert "wanted both" in session.held["noise.hot_pixels"].reason and not session.error
        assert "noise.hot_pixels" not in session.state.changes
        session.set(session.state.change("sensor.analog_gain", 2.0), "sensor.analog_gain")
        version = session.version
        await until(lambda: client.frames[-1][1] == version)
        assert session.producer.made[-1][0].changes == {"sensor.analog_gain": 2.0}
        name = "noise.hot_current_e_per_s"
        session.set(session.state.change(name, 100.0), name)
        await until(lambda: not session.held)
        assert session.state.changes["noise.hot_pixels"] == 0.01
        assert session.producer.made[-1][0].changes["noise.hot_pixels"] == 0.01
        assert session.step(session.history.undo)
        assert session.state.changes == {"sensor.analog_gain": 2.0}

    run(scenario)


def test_an_error_without_a_control_is_no_held_value():
    async def scenario(session, client):
        await until(lambda: len(client.frames) == 2)
        session.set(replace(STATE, changes={"optics.f_number": 13}))
        await until(lambda: session.error)
        assert not session.held
        session.set(STATE)
        await until(lambda: not session.error)
        await asyncio.sleep(0)

    run(scenario)


def other_values(control, value):
    """Two values that differ from the present one."""
    if control.choices:
        return [one for one in control.choices if one != value][:2]
    if control.is_text:
        return [*map(parse, control.suggested[-2:]), *EXAMPLES.get(control.name, [])][-2:]
    ends = [control.to_value(300), control.to_value(650)]
    return [one for one in ends if one != value]


EXAMPLES = {
    "optics.psf": ["missing.npz"],
    "optics.mask": [[[1, 0], [1, 1]]],
    "optics.zernike_waves": [[0.0, 0.0, 0.0, 0.15]],
    "optics.zernike_heights": [[0.0, 1.0]],
    "optics.birefringence_um": [[1.4, 1.4]],
    "optics.distortion": [{"k1": -0.1, "k2": 0.02, "radius_mm": 2.9}],
    "optics.calibration": ["missing.yaml"],
    "sensor.photodetector_size": [[1, 0.5]],
    "sensor.photodetector_centre": [[0.2, 0.0]],
    "sensor.offset": [[3.5, 0.0]],
    "sensor.microlens": [{"angles_deg": [0, 15, 30], "response": [1, 0.8, 0.5], "shift": 0.5}],
    "sensor.lenslets": [{"pitch_um": 14, "focal_length_um": 40, "gap_um": "auto"}],
    "sensor.dual": [{"split": "up-down"}],
    "sensor.vignetting": [[[0.5, 0.7, 0.5], [0.7, 1, 0.7], [0.5, 0.7, 0.5]]],
    "sensor.sensitivity": ["iset-rgb"],
    "sensor.noise_profile": ["missing.dng"],
    "processor.table": ["missing.npz"],
    "processor.network": ["missing.npz"],
    "processor.white": [[0.6, 1.0, 0.7]],
    "display.primaries": [[[0.68, 0.32], [0.265, 0.69], [0.15, 0.06]]],
    "display.white": [[0.345, 0.358]],
}
# controls without an effect on this picture of this camera, with the reason
SILENT = {
    "sensor.row_time_us": "nothing moves",
    "sensor.lenslets": "a frame without views of the pupil has no light field",
    "sensor.dual": "the picture is of all light",
    "noise.doubling_k": "the sensor has the reference temperature",
    "sensor.binning_mode": "nothing is binned",
    "optics.reference_nm": "there are no aberrations",
    "noise.telegraph_e": "there are no telegraph pixels",
    "noise.telegraph_switching": "there are no telegraph pixels",
    "noise.hot_current_e_per_s": "there are no hot pixels",
    "optics.pupil.rotation_deg": "the pupil is round",
    "sensor.qe_ends": "the phone has it",
    "sensor.auto_exposure.percentile": "another method",
    "display.luminance_cd_per_m2": "codes do not depend on it",
    "processor.defects": "there are none",
}


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTROLS)
def test_every_control_changes_the_picture_or_says_why_not(name):
    control, producer = CONTROLS[name], Producer(Still(SCENE, 1), open_device("opencl"))
    state = replace(STATE, tolerance="1e-3")
    before = producer.picture(state, 1)
    value = state.value(control, state.table())
    seen = []
    for other in other_values(control, value):
        try:
            seen.append(producer.picture(state.change(name, other), 1).codes)
        except GpusimError as error:
            assert "\n" not in str(error) and len(str(error)) < 400
            seen.append(None)
    changed = [codes is None or not np.array_equal(codes, before.codes) for codes in seen]
    assert seen and any(changed) != (name in SILENT), (name, value)
    assert np.array_equal(producer.picture(state, 1).codes, before.codes)


def test_pictures_are_compared_as_their_names_say():
    random = np.random.default_rng(4)
    one, other = (random.integers(0, 256, (6, 8, 3), dtype=np.uint8) for _ in range(2))
    beside = compare(one, [other], "side by side", 0.5)
    assert np.array_equal(beside[:, :8], one) and np.array_equal(beside[:, 8:], other)
    apart = compare(one, [other], "difference", 0.5)
    expected = [
        min(max(128 + AMPLIFIED * (int(a) - int(b)), 0), 255)
        for a, b in zip(one.ravel(), other.ravel(), strict=True)
    ]
    assert apart.ravel().tolist() == expected
    assert (
        compare(one, [other], "blink", 0.0) is other and compare(one, [other], "blink", 1.0) is one
    )
    split = compare(one, [other], "split", 0.5)
    assert np.array_equal(split[:, :3], one[:, :3]) and np.array_equal(split[:, 5:], other[:, 5:])
    with pytest.raises(BadData, match="the other camera's frame has 4x6 pixels; wanted 8x6"):
        compare(one, [other[:, :4]], "split", 0.5)
    assert len(COMPARISONS) == 4


def test_differences_of_cameras_are_listed():
    state = State("phone").keep("B").change("optics.f_number", 4.0).change("noise.read_e", 2.0)
    rows = list_differences([state, state.snapshot("B")])
    assert rows == [("f-number", "4", "1.8"), ("read [e⁻]", "2", "5")]
    other = replace(state, camera="mono", changes={})
    assert ("camera", "phone", "mono") in list_differences([state, other])
    assert describe_step(State("phone"), State("phone").change("noise.read_e", 2.0)) == "read 2 e⁻"
    assert describe_step(state, replace(state, camera="mono", changes={})) == "camera mono"
    other = replace(state, scene=SceneChoice("flat", size=(64, 48)))
    assert describe_step(state, other) == "scene flat --size 64x48"
    assert describe_step(state, replace(state, marks_clipped=True)) == "clipping marked"


def test_compared_pictures_bear_names():
    state = State("phone").keep("A").keep("B")
    assert name_pictures(State("phone")) == ()
    for how, names in (
        ("split", ("this camera", "B")),
        ("side by side", ("this camera", "B", "A")),
        ("difference", (f"this camera minus B, times {AMPLIFIED}",)),
    ):
        assert name_pictures(replace(state, compare=how)) == names
    for split, name in ((0.0, "B"), (1.0, "this camera")):
        assert name_pictures(replace(state, compare="blink", split=split)) == (name,)


def test_three_cameras_stand_side_by_side():
    producer = Producer(Still(SCENE, 1), open_device("opencl"))
    first = replace(STATE, tolerance="1e-3")
    state = first.keep("B").change("optics.f_number", 4.0).keep("C").change("noise.read_e", 20.0)
    made = producer.picture(replace(state, compare="side by side"), 2)
    assert made.count == 3 and made.codes.shape == (32, 3 * 48, 3)
    alone = [
        producer.picture(one, 2).codes
        for one in (
            replace(state, against=None),
            state.snapshot("C"),
            state.snapshot("B"),
        )
    ]
    assert np.array_equal(made.codes, np.concatenate(alone, axis=1))

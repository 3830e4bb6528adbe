"""The looks of a processor: what they choose, what stays, and what they do to a picture."""

import json

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.processor import LOOKS, Processor
from gpusim.measure import mtf50, sfr

FINISHED = {"shading": True, "highlights": "rebuild", "lens_corrections": True, "gamut": "map"}
CHOSEN = {
    "linear": {
        **{"denoise": 0, "tone": [], "sharpen": 0, "shading": False, "highlights": "clip"},
        **{"lens_corrections": False, "local_tone": 0, "gamut": "clip"},
    },
    "camera": {"denoise": 1.0, "tone": "sigmoid", "sharpen": 0.5, "local_tone": 0, **FINISHED},
    "phone": {"denoise": 1.5, "tone": "reinhard", "sharpen": 1.0, "local_tone": 0.5, **FINISHED},
}  # of docs/cameras.md


def take(camera, scene=None, **settings):
    scene = scene or gs.chart("colorchecker", size=(72, 48))
    return gs.Simulator(camera, device="opencl")(scene, **settings)


@pytest.mark.parametrize("look", LOOKS)
def test_a_look_is_its_settings(look):
    """The frame is that of a camera with the settings of the documentation, bit for bit."""
    camera = gs.open_camera("phone")
    by_look, by_settings = take(camera.with_(look=look)), take(camera.with_(**CHOSEN[look]))
    np.testing.assert_array_equal(by_look.rgb, by_settings.rgb)
    np.testing.assert_array_equal(by_look.linear, by_settings.linear)
    np.testing.assert_array_equal(by_look.codes(16), by_settings.codes(16))
    assert (f"look {look}" in by_look.report.stages[-1].model) == (look != "linear")
    assert "look" not in by_settings.report.stages[-1].model


def test_no_look_is_linear():
    assert Processor() == Processor(look="linear") and CHOSEN.keys() == LOOKS.keys()
    camera = gs.open_camera("phone")
    stages = [stage.stage for stage in take(camera).report.stages]
    assert "processor.multiscale" not in stages and "processor.sharpen" not in stages


@pytest.mark.parametrize(
    "own",
    [
        {"tone": "none"},
        {"tone": []},
        {"denoise": 0},
        {"sharpen": 0.0, "denoise": 2, "local_tone": 0.0},
        {"shading": False, "highlights": "clip", "lens_corrections": False, "gamut": "clip"},
        dict.fromkeys(CHOSEN["phone"], "auto"),
    ],
)
def test_what_a_file_sets_itself_stays(tmp_path, own):
    path = tmp_path / "own.toml"
    kept = CHOSEN["phone"] | {key: value for key, value in own.items() if value != "auto"}
    lines = "\n".join(f"{key} = {json.dumps(value)}" for key, value in own.items())
    path.write_text(f'base = "phone"\n[processor]\nlook = "phone"\n{lines}\n')
    found = take(gs.open_camera(path)).rgb
    np.testing.assert_array_equal(found, take(gs.open_camera("phone").with_(**kept)).rgb)


def test_looks_are_sharper_in_good_light_and_quieter_in_the_dark():
    camera, edge = gs.open_camera("phone"), gs.chart("slanted-edge", size=(160, 160))
    dark = gs.chart("flat", size=(96, 96), luminance=1 / np.pi)
    sharpness, noise = [], []
    for look in LOOKS:
        own = camera.with_(look=look)
        sharpness.append(float(mtf50(sfr(take(own, edge).linear[..., 1]))))
        linear = take(own.with_(exposure_time_ms=66, analog_gain=16), dark).linear
        noise.append(linear[..., 1].std() / linear[..., 1].mean())
    assert sharpness == sorted(sharpness) and sharpness[1] > 1.03 * sharpness[0]
    assert noise[1] < 0.5 * noise[0] and noise[2] < 0.5 * noise[0]


def test_a_loop_changes_its_look():
    """Settings that a look chose do not stay when the look goes."""
    camera, scene = gs.open_camera("phone"), gs.chart("colorchecker", size=(72, 48))
    loop = gs.Simulator(camera, device="numpy").loop(scene)
    for look in ("phone", "linear", "camera"):
        own = camera.with_(look=look)
        loop.update(camera=own)
        found = np.array(loop.simulator.device.numpy(loop.codes(seed=1)))
        np.testing.assert_array_equal(found, gs.Simulator(own, device="numpy")(scene, seed=1).rgb)


def test_captures_have_the_look():
    """Each frame of a burst, and the merged one: brighter by the tone curve than the linear picture."""
    camera, scene = gs.open_camera("phone"), gs.chart("colorchecker", size=(72, 48))
    means = []
    for look in ("linear", "phone"):
        simulator = gs.Simulator(camera.with_(look=look), device="opencl")
        frames = gs.bracket(simulator, scene, (-1, 0))
        merged = gs.merge_bracket(simulator, frames)
        means.append([frame.rgb.mean() for frame in (*frames, merged)])
        assert ("look phone" in merged.report.stages[-1].model) == (look == "phone")
    assert (np.array(means[1]) > 1.1 * np.array(means[0])).all()


def test_a_look_leaves_the_mosaic_to_the_network():
    """Noise that is left after the network is removed; the mosaic before it stays as it is."""
    network = gs.open_camera("phone").with_(demosaic="network", look="phone")
    assert network.processor.denoising == 1.5
    network = network.with_(denoise_by="mosaic")
    assert network.processor.denoising == 0.0 < network.with_(demosaic="best").processor.denoising
    assert network.with_(denoise=1.0).processor.denoising == 1.0

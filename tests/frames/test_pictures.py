"""Encoded frames go to devices as bytes and are decoded there: their light is that of the decoded planes."""

from dataclasses import replace

import numpy as np
import pytest
from devices import ALL_KINDS, KINDS, apart
from foreign_arrays import METERED, ByDlpack, ByInterface, ByNumpy, Tensor, aligned, same_bits
from PIL import Image

import gpusim as gs
from gpusim.backends import open_device
from gpusim.backends.opencl import OpenCLDevice
from gpusim.domain.content import Picture
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.memory import type_of
from gpusim.kernels.spectral.decode import decode
from gpusim.measure.ideal import ideal
from gpusim.optics.fusion import Watch
from gpusim.optics.highlights import Highlights
from gpusim.pipeline import light as light_steps
from gpusim.planner.facts import Facts

SHAPE = (48, 64)
MOST = {np.uint8: 255, np.uint16: 65535}


def frame(seed=1, kind=np.uint8, shape=(*SHAPE, 3)):
    """Coloured patches that are a little noisy: a picture without highlights."""
    random = np.random.default_rng(seed)
    patches = random.integers(MOST[kind] // 4, MOST[kind] * 7 // 8, (6, 8, *shape[2:]))
    patches = patches.repeat(8, axis=0).repeat(8, axis=1)
    return (patches + random.integers(0, MOST[kind] // 16, shape)).astype(kind)


def decoded(scene):
    """The scene with linear planes in place of codes."""
    return replace(scene, content=scene.content.on_host())


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("tolerance", [None, "video"])
@pytest.mark.parametrize(
    ("kind", "options"),
    [
        (np.uint8, {}),
        (np.uint16, {}),
        (np.uint8, {"border": "scene", "margin": 4}),
        (np.uint8, {"light": "A", "samples_per_pixel": 2}),
    ],
    ids=["8 bits", "16 bits", "surroundings", "lamp, finer"],
)
def test_the_frame_is_that_of_the_decoded_planes(device, tolerance, kind, options):
    simulator = gs.Simulator(METERED, device=device, tolerance=tolerance)
    scene = gs.picture(frame(kind=kind), **options)
    found, wanted = (simulator(shown, seed=2) for shown in (scene, decoded(scene)))
    for name in ("mean", "raw", "linear", "rgb"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), name)
    assert (
        found.exposure_time == wanted.exposure_time
        and found.report.account == wanted.report.account
    )
    assert found.raw.std() > 10


@pytest.mark.parametrize("device", ALL_KINDS)
def test_grey_is_a_picture_of_one_channel(device):
    """As three equal channels, but for the primaries' sum, and the sum over them, both 1 to their rounding."""
    simulator, codes = gs.Simulator(METERED, device=device), frame(shape=SHAPE)
    grey = gs.picture(codes)
    same_bits(simulator.device, simulator.expose(grey).mean, simulator.expose(decoded(grey)).mean)
    coloured = simulator.expose(gs.picture(np.stack([codes] * 3, axis=-1)))
    # float32: three products, their sum and the transforms' 2.5e-7 of the field's root mean square
    np.testing.assert_allclose(
        np.asarray(simulator.expose(grey).mean), np.asarray(coloured.mean), rtol=4e-6
    )


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_frames_of_others(device, kind):
    """Where they are, and as they are: host memory, another device's, other layouts and orders of bytes."""
    simulator, codes = gs.Simulator(METERED, device=device), aligned(frame(kind=kind))
    device = simulator.device
    wanted = simulator.expose(gs.picture(codes)).mean
    for given in (
        ByDlpack(codes),
        Tensor(codes),
        ByNumpy(codes),
        device.array(codes, kind),
        open_device("opencl").array(codes, kind),
        open_device("warp:cpu").array(codes, kind),
        np.asfortranarray(codes),
        codes.astype(codes.dtype.newbyteorder(">")),
        np.concatenate([codes, codes], axis=1)[:, : SHAPE[1]],
        np.flip(codes[..., ::-1], 2),
        aligned(codes).view(gs.domain.memory.Pinned),
    ):
        scene = gs.picture(given)
        assert type_of(scene.content.codes).type is kind
        same_bits(device, simulator.expose(scene).mean, wanted)


def test_codes_of_device_memory_are_not_looked_at():
    assert gs.picture(ByInterface((*SHAPE, 3), "|u1")).shape == SHAPE
    with pytest.raises(BadData, match=r"cannot read an array of .*warp:cuda:0"):
        gs.Simulator(METERED, device="opencl").expose(gs.picture(ByInterface((*SHAPE, 3), "|u1")))


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_video_is_decoded_by_the_device_alone(device, kind, monkeypatch):
    """One plan and one reading of facts; each frame is that of its linear planes, which one plan serves likewise."""
    simulator = gs.Simulator(METERED, device=device, tolerance="video")
    frames = [(frame(1, kind) // 20 * (20 - number)).astype(kind) for number in range(5)]
    scenes = [gs.picture(codes) for codes in frames]
    planes = [decoded(scene) for scene in scenes]
    wanted = [np.array(simulator.device.numpy(codes)) for codes in simulator.stream(planes, seed=3)]
    calls, facts, inner = [], Facts.of, Picture.on_host
    monkeypatch.setattr(Picture, "on_host", lambda self: calls.append("decoded") or inner(self))
    monkeypatch.setattr(Facts, "of", lambda scene: calls.append("facts") or facts(scene))
    for number, codes in enumerate(simulator.stream(scenes, seed=3)):
        np.testing.assert_array_equal(np.array(simulator.device.numpy(codes)), wanted[number])
    # a stream puts codes into a GPU's memory, which then looks at them itself
    assert sorted(calls) == ([] if simulator.device.is_gpu else ["decoded", "facts"])
    assert len({codes.tobytes() for codes in wanted}) == 5


@pytest.mark.parametrize("device", ALL_KINDS)
def test_the_error_of_the_next_picture_is_measured_as_that_of_planes(device):
    """One plane for all wavelengths of a camera without colours: how wrong it is depends on the picture."""
    simulator = gs.Simulator(gs.open_camera("mono"), device=device, tolerance=1e-2)
    first, second = gs.picture(frame(1)), gs.picture(frame(2))
    errors = []
    for one, other in ((first, second), (decoded(first), decoded(second))):
        loop = simulator.loop(one, 0.01)
        own = loop.frame()
        plan, found = loop.plan, loop.update(scene=other).frame()
        assert loop.plan is plan and plan.find(Watch) is not None
        assert any("planned for picture" in note for note in found.report.notes)
        errors.append(
            (own.report.account.bounds["planes"].rms, found.report.account.bounds["planes"].rms)
        )
    assert errors[0][0] != errors[0][1]
    # The device sums codes and decoded samples over wavelength in float32. The error is a difference of such sums, and
    # about 1e-3 of them: it has a relative rounding of 1e3 times some 2^-24.
    np.testing.assert_allclose(*errors, rtol=8 * 1e3 * 2.0**-24)
    fresh = simulator.plan(second)  # of its own planes, which are other ones
    assert fresh.account.bounds["planes"].rms == pytest.approx(errors[0][1], rel=0.5)


def test_one_plan_serves_pictures_of_one_kind():
    plan = gs.Simulator(METERED, device="numpy").plan(gs.picture(frame(1)))
    assert plan.serves(gs.picture(frame(2))) and plan.serves(
        gs.picture(Tensor(frame(2)), name="other")
    )
    for other in (
        decoded(gs.picture(frame(2))),
        gs.picture(frame(2, np.uint16)),
        gs.picture(frame(2)[:-8]),
        gs.picture(frame(2, shape=SHAPE)),
        gs.picture(frame(2), light="A"),
        gs.picture(frame(2), luminance=50),
        gs.picture(frame(2), border="reflect"),
        gs.picture(frame(2), curve=np.linspace(0, 1, 256)),
    ):
        assert not plan.serves(other)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_a_highlight_is_found_in_a_later_picture(device):
    """One frame late at most: what is left of the picture has other light than its codes, it goes on as a basis."""
    simulator, codes = gs.Simulator(METERED, device=device), frame(2) // 16
    codes[20, 30] = 255
    scene = gs.picture(codes)
    loop = simulator.loop(gs.picture(frame(1)), 0.01)
    loop.raw()
    loop.update(scene=scene).raw()
    assert loop.plan.find(Highlights) is None
    loop.judge()
    assert len(loop.plan.find(Highlights).places) == 1
    same_bits(simulator.device, loop.raw(seed=4), simulator.loop(decoded(scene), 0.01).raw(seed=4))


@pytest.mark.parametrize("device", KINDS)
def test_pictures_are_decoded_to_one_place(device, monkeypatch):
    """From the second on, the steps behind are started again without their host code, as for all scenes of a loop."""
    calls, inner = [], light_steps.planes
    monkeypatch.setattr(light_steps, "planes", lambda *given: calls.append(number) or inner(*given))
    loop = gs.Simulator(METERED, device=device).loop(gs.picture(frame()), 0.01)
    for number in range(5):
        loop.update(scene=gs.picture(frame(number))).raw()
    assert calls == [0]


def test_a_stream_sends_bytes():
    """To memory apart from the host's, as a GPU's is: three bytes a pixel, six of 16 bits."""
    sent = []

    class Apart(OpenCLDevice):
        def send(self, values, *others):
            sent.append((values.nbytes, values.dtype.type))
            return super().send(values, *others)

    device = apart(Apart, is_gpu=False)
    simulator = gs.Simulator(METERED, device=device)
    kinds = [np.uint8, np.uint8, np.uint16, np.uint8, np.uint16]
    scenes = [
        gs.picture((Tensor if number % 2 else np.array)(frame(number, kind)))
        for number, kind in enumerate(kinds)
    ]
    for number, raw in enumerate(simulator.stream(scenes, "raw", seed=5, exposure_time=0.01)):
        wanted = simulator.loop(decoded(scenes[number]), 0.01)
        np.testing.assert_array_equal(np.asarray(raw), np.asarray(wanted.raw(seed=5, first=number)))
    assert sent == [(3 * np.dtype(kind).itemsize * SHAPE[0] * SHAPE[1], kind) for kind in kinds]


@pytest.mark.parametrize("device", KINDS)
def test_batches_of_pictures(device):
    simulator = gs.Simulator(METERED, device=device)
    scenes = [gs.picture(frame(number)) for number in range(3)]
    found = simulator.batch(3, "raw")(scenes, exposure_time=0.01, seed=7, first=0)
    wanted = simulator.batch(3, "raw")(
        [decoded(scene) for scene in scenes], exposure_time=0.01, seed=7, first=0
    )
    same_bits(simulator.device, found, wanted)
    assert len({np.array(part).tobytes() for part in np.array(simulator.device.numpy(found))}) == 3


def test_layers_and_depth_of_pictures():
    mono, shape = gs.open_camera("mono"), (16, 24)
    simulator = gs.Simulator(
        replace(mono, optics=replace(mono.optics, object_distance=0.4)),
        device="opencl",
        tolerance=1e-2,
    )
    alpha = np.zeros(shape)
    alpha[:, :9] = 1
    front, back = (gs.picture(frame(number)[:16, :24]) for number in (1, 2))
    scene = replace(back, depth=np.full(shape, 2.0), layers=(gs.Layer(front.content, alpha, 0.5),))
    plain = replace(
        decoded(back), depth=scene.depth, layers=(gs.Layer(decoded(front).content, alpha, 0.5),)
    )
    found, wanted = (simulator.loop(shown, 0.01) for shown in (scene, plain))
    same_bits(simulator.device, found.raw(), wanted.raw())
    np.testing.assert_array_equal(ideal(scene), ideal(plain))


@pytest.mark.parametrize("name", ["irradiance", "electrons", "xyz"])
def test_outputs_of_a_picture(name):
    simulator, scene = gs.Simulator(METERED, device="opencl"), gs.picture(frame()[:16, :24])
    found, wanted = (
        np.array(simulator.loop(shown, 0.01).output(name)) for shown in (scene, decoded(scene))
    )
    np.testing.assert_array_equal(found, wanted)


def test_what_reads_scenes_reads_pictures_of_devices():
    device = open_device("opencl")
    scene, there = (gs.picture(codes) for codes in (frame(), device.array(frame(), np.uint8)))
    np.testing.assert_array_equal(ideal(there), ideal(scene))


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_a_verified_picture(kind):
    shown = gs.Simulator(METERED, device="opencl", tolerance="video")(
        gs.picture(frame(kind=kind)), verify=True
    )
    assert shown.report.scene["form"] == "picture" and 0 < shown.report.error.rms < 1e-3


def test_a_picture_is_the_photograph_of_its_codes(tmp_path):
    """The file of the same pixels, in the same light: the same electrons."""
    codes = frame()
    Image.fromarray(codes).save(tmp_path / "a.png")
    simulator = gs.Simulator(METERED, device="opencl")
    for light, luminance in ((None, None), ("A", 30)):
        photo = gs.open_scene(tmp_path / "a.png", light=light, luminance=luminance)
        scene = gs.picture(codes, **({"light": light, "luminance": luminance} if light else {}))
        same_bits(simulator.device, simulator.expose(scene).mean, simulator.expose(photo).mean)


def test_a_camera_looks_at_its_own_pictures():
    """Display codes of a device, on a screen, seen by a camera: they stay on the device."""
    simulator, screen = gs.Simulator(METERED, device="warp:cpu"), gs.open_display("oled-sony")
    codes = simulator.loop(gs.picture(frame())).codes(seed=1)
    scene = gs.display_picture(codes, screen)
    assert scene.content.codes is codes
    same_bits(
        simulator.device,
        simulator.expose(scene).mean,
        simulator.expose(gs.display_picture(np.array(codes), screen)).mean,
    )


@pytest.mark.parametrize(
    ("make", "error", "words"),
    [
        (
            lambda: gs.picture(frame() / 255),
            BadData,
            "picture: codes of type float64, wanted uint8 or uint16; give linear",
        ),
        (
            lambda: gs.picture(np.dstack([frame(), frame()[..., :1]])),
            BadData,
            r"picture: codes of shape \(48, 64, 4\), wanted \(rows, cols, 3\), .* no alpha: codes\[..., :3\]",
        ),
        (
            lambda: gs.picture(frame().transpose(2, 0, 1)),
            BadData,
            r"codes of shape \(3, 48, 64\), .* channels last",
        ),
        (lambda: gs.picture(frame()[None]), BadData, r"codes of shape \(1, 48, 64, 3\)"),
        (lambda: gs.picture(frame()[0, 0]), BadData, r"codes of shape \(3,\)"),
        (
            lambda: gs.picture(frame().tolist()),
            BadData,
            "picture codes: builtins.list, wanted an array",
        ),
        (
            lambda: gs.picture(Tensor(frame(), dtype="torch.bfloat16")),
            BadData,
            "codes of type torch.bfloat16",
        ),
        (lambda: gs.picture(frame()[:0]), BadData, "zero-size"),
        (
            lambda: gs.picture(frame(kind=np.uint16), curve=np.ones(256)),
            BadData,
            r"wanted \(65536,\) for uint16",
        ),
        (lambda: gs.picture(frame(), curve="srgb"), BadData, "curve is no array of real numbers"),
        (
            lambda: gs.picture(frame(), curve=np.ones(256, complex)),
            BadData,
            "curve is no array of real numbers",
        ),
        (lambda: gs.picture(frame(), light="D66"), UnknownName, "D66"),
        (lambda: gs.picture(frame(), luminance=0), OutOfRange, "luminance"),
        (lambda: gs.picture(frame(), border="round"), UnknownName, "border"),
    ],
)
def test_what_is_no_frame_is_refused_in_one_line(make, error, words):
    with pytest.raises(error, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("device", ["numpy", "opencl"])
@pytest.mark.parametrize(
    ("codes", "curve", "words"),
    [
        (frame() / 255, np.ones(256), "codes of type float64; wanted uint8 or uint16"),
        (frame().astype(np.int16), np.ones(256), "codes of type int16"),
        (
            frame()[None],
            np.ones(256),
            r"codes of shape \(1, 48, 64, 3\); wanted \(rows, cols, channels\)",
        ),
        (frame()[0, 0], np.ones(256), r"codes of shape \(3,\)"),
        (frame(), np.ones(255), r"a curve of shape \(255,\); wanted \(256,\) for uint8"),
        (
            frame(kind=np.uint16),
            np.ones((256, 256)),
            r"a curve of shape \(256, 256\); wanted \(65536,\) for uint16",
        ),
    ],
)
def test_what_the_stage_refuses(device, codes, curve, words):
    with pytest.raises(BadData, match=f"^decode: {words}"):
        decode(codes, curve, device=device)

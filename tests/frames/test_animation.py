"""Things that move before a scene, on their own paths."""

from dataclasses import replace

import numpy as np
import pytest
from cameras import PHONE
from devices import KINDS
from PIL import Image
from scipy.special import erf

import gpusim as gs
from gpusim.cli.main import main
from gpusim.domain.errors import BadData, OutOfRange

WAVELENGTHS, RANDOM = np.linspace(400, 700, 7), np.random.default_rng(2)
BASIS = RANDOM.random((3, 7))
LIGHT = gs.chart("flat", wavelengths=WAVELENGTHS).illuminant


def basis(values):
    return gs.Basis(WAVELENGTHS, np.asarray(values, np.float32), BASIS)


BACK = gs.Scene(basis(RANDOM.random((3, 60, 80))), LIGHT)


def spot(size=41, sigma=4.0, value=1.0):
    """A disc whose rim is soft: as alpha and as light, a Gaussian's integral over the radius."""
    y, x = np.indices((size, size)) - (size - 1) / 2
    alpha = (1 - erf((np.hypot(y, x) - 10) / sigma)) / 2
    return basis(np.full((3, size, size), value)), np.clip(alpha, 0, 1)


def test_whole_samples_are_put_where_they_are():
    content, alpha = basis(RANDOM.random((3, 11, 15))), np.ones((11, 15), np.float32)
    actor = gs.Actor(content, alpha, (0.5, -7.5), gs.Motion(pan=(10, -20)))
    found = gs.Animation(BACK, [actor]).at(0.5).content.coefficients
    expected = BACK.content.coefficients.copy()  # middles of 60 and 11: half a sample between them
    expected[:, 30 + 5 - 5 : 30 + 5 + 6, 40 - 7 - 10 - 8 : 40 - 7 - 10 + 7] = content.coefficients
    np.testing.assert_allclose(found, expected, atol=2e-6)
    assert BACK.content.coefficients is not found


@pytest.mark.parametrize("time", [0.0, 0.37, 1.4])
def test_an_actor_is_where_its_path_says(time):
    """A round spot turns and grows: its centre of mass, its size and the light that it hides, by its own formula."""
    path, place = gs.Motion(pan=(3.3, -7.7), roll=2.0, zooming=1.3), (4.25, 3.5)
    dark = replace(BACK, content=basis(np.full((3, 60, 80), 0.5)))
    content, alpha = spot()
    found = (
        gs.Animation(dark, [gs.Actor(content, alpha, place, path)]).at(time).content.coefficients[0]
        - 0.5
    )
    y, x = np.indices(found.shape) - np.array([29.5, 39.5])[:, None, None]
    zoom = path.at(time).zoom
    radius = np.hypot(y - place[0] - 3.3 * time, x - place[1] + 7.7 * time) / zoom
    expected = 0.5 * (1 - erf((radius - 10) / 4)) / 2
    # cubic splines err by 1/30 of (pi f)^4 of a wave of f cycles a sample; a soft rim of 4 has less than .1 of them
    assert np.abs(found - expected).max() < 2e-3


def test_the_nearest_actor_hides_the_others():
    white, black = (
        gs.Actor(basis(np.full((3, 9, 9), value)), np.ones((9, 9)), (0.5, 0.5))
        for value in (1.0, 0.0)
    )
    for front, back, value in ((white, black, 1), (black, white, 0)):
        seen = gs.Animation(BACK, [front, back]).at(0).content.coefficients[:, 30, 40]
        np.testing.assert_allclose(seen, value, atol=1e-6)
    half = replace(white, alpha=np.full((9, 9), 0.25))
    np.testing.assert_allclose(
        gs.Animation(BACK, [half, black]).at(0).content.coefficients[:, 30, 40], 0.25, atol=1e-6
    )


def test_an_actor_outside_the_frame_is_not_there():
    away = gs.Actor(*spot(), (500, 0), gs.Motion(pan=(-100, 0)))
    assert np.array_equal(
        gs.Animation(BACK, [away]).at(0).content.coefficients, BACK.content.coefficients
    )
    assert not np.array_equal(
        gs.Animation(BACK, [away]).at(5).content.coefficients, BACK.content.coefficients
    )


@pytest.mark.parametrize("device", KINDS)
def test_motion_blur_is_that_of_many_instants(device):
    """Against a mean of 200 instants; the camera moves, too, and rows open one after the other."""
    seconds, start = 0.02, 0.3
    camera = replace(PHONE, sensor=replace(PHONE.sensor, row_time=1e-4))
    animation = gs.Animation(
        BACK, [gs.Actor(*spot(value=3.0), (0, -20), gs.Motion(pan=(-40, 300), roll=1.0))]
    )
    motion = gs.Motion(pan=(60, 0))
    simulator = gs.Simulator(camera, device=device, tolerance=0.02)
    exposure = gs.expose_motion(simulator, animation, motion, seconds, start)
    rows = np.arange(60)
    whole = seconds + 1e-4 * rows[-1]
    loop, total, opened = None, 0.0, np.zeros(60)
    for time in start + (np.arange(200) + 0.5) * whole / 200:
        view = animation.at(time).viewed(motion.at(time))
        loop = loop.update(scene=view) if loop else simulator.loop(view, exposure_time=seconds)
        is_open = (time >= start + rows * 1e-4) & (time < start + rows * 1e-4 + seconds)
        total = total + is_open[:, None] * np.array(
            simulator.device.numpy(loop.exposure.mean), np.float64
        )
        opened += is_open
    truth = total / opened[:, None]
    error = np.array(simulator.device.numpy(exposure.mean)) - truth
    stated = exposure.plan.account.bounds["shutter"].rms
    # of the truth: rows open half of an instant, of 154 in 20 ms, too early or late
    assert np.sqrt(np.mean(error**2) / np.mean(truth**2)) < stated + 1 / 154
    assert 1.5 * stated <= 0.5 * 0.02


@pytest.mark.parametrize(
    ("changes", "error", "words"),
    [
        ({"content": gs.chart("flat").content}, BadData, "wanted a Basis or a Cube"),
        ({"alpha": np.ones((3, 3))}, BadData, "does not match"),
        ({"alpha": np.full((41, 41), 1.5)}, OutOfRange, "0 .. 1"),
        ({"alpha": np.full((41, 41), np.nan)}, OutOfRange, "0 .. 1"),
        ({"place": (0, np.inf)}, BadData, "two finite"),
        ({"place": 3}, BadData, "two finite"),
        ({"path": gs.View()}, BadData, "wanted a Motion"),
    ],
)
def test_actors_that_cannot_be(changes, error, words):
    content, alpha = spot()
    with pytest.raises(error, match=words):
        gs.Actor(**({"content": content, "alpha": alpha} | changes))


DEEP = replace(BACK, depth=np.full((60, 80), 3.0))


def test_an_actor_at_a_distance_is_a_layer_in_their_order():
    """Two squares at whole samples: the layers written down by hand, of near and far ones."""
    content, alpha = basis(RANDOM.random((3, 12, 12))), np.ones((12, 12), np.float32)
    near = gs.Actor(content, alpha, (0, 0), gs.Motion(pan=(0, 10)), distance=1.0)
    far = gs.Actor(content, alpha, (0, 8), distance=2.0)
    for actors in ([near, far], [far, near]):  # distances decide, not the list
        scene = gs.Animation(DEEP, actors).at(0.2)  # the near one at column 2
        assert [layer.depth for layer in scene.layers] == [1.0, 2.0]
        for layer, column in zip(scene.layers, (2, 8), strict=True):
            expected = np.zeros((60, 80))
            expected[24:36, 34 + column : 46 + column] = 1
            np.testing.assert_allclose(layer.alpha, expected, atol=1e-6)
            shown = layer.content.coefficients[:, 24:36, 34 + column : 46 + column]
            np.testing.assert_allclose(shown, content.coefficients, atol=2e-6)


def test_an_actor_is_hidden_by_what_is_nearer():
    depth = np.where(np.arange(80) < 40, 0.5, 3.0) * np.ones((60, 1))
    actor = gs.Actor(basis(np.ones((3, 12, 12))), np.ones((12, 12)), distance=1.0)
    (layer,) = gs.Animation(replace(BACK, depth=depth), [actor]).at(0).layers
    assert not layer.alpha[:, :40].any() and layer.alpha[24:36, 40:46] == pytest.approx(1)
    gone = replace(BACK, depth=np.full((60, 80), 0.5))
    assert gs.Animation(gone, [actor]).at(0).layers == ()


def test_an_actor_is_blurred_for_its_distance():
    """Its edge is as soft as a lens with the same defocus makes it without any depth, far from other edges."""
    optics = replace(PHONE.optics, object_distance=0.5)
    camera = replace(PHONE, optics=optics)
    dark = replace(DEEP, content=basis(np.full((3, 60, 80), 0.1)))
    actor = gs.Actor(basis(np.full((3, 30, 30), 0.9)), np.ones((30, 30)), distance=0.2)
    simulator = gs.Simulator(camera, device="opencl:0")
    found = np.asarray(simulator.expose(gs.Animation(dark, [actor]).at(0), 0.01).mean, np.float64)
    flat = gs.Animation(replace(dark, depth=None), [replace(actor, distance=None)]).at(0)
    at_actor = replace(flat, depth=np.full((60, 80), 0.2))
    expected = np.asarray(simulator.expose(at_actor, 0.01).mean, np.float64)
    sharp = np.asarray(simulator.expose(replace(flat, depth=np.full((60, 80), 0.5)), 0.01).mean)
    # even light behind has no blur of its own: the two agree, up to the lobes of the tables
    rms = np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2))
    assert rms < 2e-3 < 0.02 < np.sqrt(np.mean((sharp - expected) ** 2) / np.mean(expected**2))


def test_animations_that_cannot_be():
    actor = gs.Actor(*spot())
    with pytest.raises(BadData, match="wanted actors with a distance"):
        gs.Animation(replace(BACK, depth=np.ones((60, 80))), [actor])
    with pytest.raises(BadData, match="wanted actors without a distance"):
        gs.Animation(BACK, [replace(actor, distance=2.0)])
    with pytest.raises(OutOfRange, match="above 0 m"):
        gs.Actor(*spot(), distance=-1.0)
    with pytest.raises(BadData, match="has no travel"):
        gs.Actor(*spot(), path=gs.Motion(travel=(0, 1, 0)))
    with pytest.raises(BadData, match="the same wavelengths and basis"):
        gs.Animation(gs.chart("flat"), [actor])
    with pytest.raises(BadData, match="actor 0: Scene, wanted an Actor"):
        gs.Animation(BACK, [BACK])


@pytest.fixture
def pictures(tmp_path):
    """A grey-blue photograph, and a red disc that is cut out."""
    back = np.full((48, 64, 3), (90, 100, 120), np.uint8)
    Image.fromarray(back).save(tmp_path / "back.png")
    y, x = np.indices((17, 17)) - 8
    disc = np.dstack(
        [
            np.full((17, 17), 230),
            np.full((17, 17), 20),
            np.full((17, 17), 20),
            255 * (np.hypot(y, x) < 7),
        ]
    ).astype(np.uint8)
    Image.fromarray(disc).save(tmp_path / "disc.png")
    return tmp_path


@pytest.mark.parametrize("more", [[], ["--blur"]])
def test_a_picture_moves_before_a_photograph(more, pictures):
    """A red disc goes to the right, 8 pixels a frame; parts of the video are those of one run."""
    asked = [
        "video",
        str(pictures / "back.png"),
        "--camera",
        "phone",
        "--frames",
        "4",
        "--fps",
        "10",
        "--segment",
        "2",
        "--actor",
        f"{pictures / 'disc.png'},at=-4:-16,pan=0:80",
        "--exposure",
        "1/100",
        "--luminance",
        "2000",
        "--tolerance",
        "video",
        *more,
        "-o",
    ]
    assert main([*asked, str(pictures / "a.png")]) == 0
    for number in range(4):
        seen = np.asarray(Image.open(pictures / f"a_{number:04d}.png")).astype(float)
        red = np.maximum(seen[..., 0] - seen[..., 2], 0) > 60
        middle = np.argwhere(red).mean(axis=0) - (23.5, 31.5)
        moved = 8 * number + (0.4 if more else 0)  # half of an exposure
        assert np.abs(middle - (-4, -16 + moved)).max() < 0.5, middle
    for shard in ("1/2", "0/2"):
        assert main([*asked, str(pictures / "b.png"), "--shard", shard]) == 0
    for number in range(4):
        assert (pictures / f"a_{number:04d}.png").read_bytes() == (
            pictures / f"b_{number:04d}.png"
        ).read_bytes()


@pytest.mark.parametrize(
    ("actor", "words"),
    [
        ("none.png", "none.png"),
        ("disc.png,at=1", "wanted at=ROW:COL"),
        ("disc.png,pan=0:1,pan=0:1", "each once"),
        ("disc.png,zoom=0.5", "zoom"),
        ("disc.png,at=0:nan", "wanted at=ROW:COL"),
    ],
)
def test_pictures_that_cannot_move_are_refused_in_a_line(actor, words, pictures, capsys):
    try:
        status = main(
            [
                "video",
                str(pictures / "back.png"),
                "--camera",
                "phone",
                "--actor",
                f"{pictures / actor}",
                "-o",
                str(pictures / "a.png"),
            ]
        )
    except SystemExit as stopped:
        status = stopped.code
    said = capsys.readouterr().err
    assert status == 2 and words in said and "Traceback" not in said
    assert not list(pictures.glob("a*"))

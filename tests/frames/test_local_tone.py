"""Local tone mapping: shadows are lifted, edges have no halos, noise and white stay."""

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.errors import OutOfRange
from gpusim.kernels.processor.local_tone import LIFT, LUMINANCE, SHADOW, local_tone

DARK, BRIGHT = 0.02, 0.8


def _grey(light):
    return np.repeat(np.asarray(light, np.float32)[None], 3, 0)


def _lifted(light, strength=1.0, noise=0.0):
    return local_tone(_grey(light), LUMINANCE, strength=strength, noise=noise, device="opencl")[1]


@pytest.mark.parametrize("light", [0.005, DARK, 0.2, 1.0])
@pytest.mark.parametrize("strength", [0.3, 1.0])
def test_even_light_gets_the_gain_of_its_formula(light, strength):
    """A flat field is its own base: float32's logarithm and power err by less than 1e-5."""
    wanted = light * (1 + strength * LIFT / (1 + (light / SHADOW) ** 2))
    np.testing.assert_allclose(_lifted(np.full((70, 90), light), strength), wanted, rtol=1e-5)


def test_an_edge_has_no_halo():
    """A step of 5.3 stops: on either side light stays between the two flat gains, within 15 % of its own.

    Blurred by the same windows without regard to edges, the base would be wrong by 2.7 stops next to the edge.
    """
    light = np.full((256, 256), DARK)
    light[:, 128:] = BRIGHT
    found = _lifted(light)
    flat = {one: _lifted(np.full((256, 256), one))[0, 0] for one in (DARK, BRIGHT)}
    for side, value in ((found[:, :128], DARK), (found[:, 128:], BRIGHT)):
        np.testing.assert_allclose(side, flat[value], rtol=0.15)
    assert found[:, 127].max() < 0.2 * found[:, 128].min()


def test_fine_detail_in_the_dark_keeps_its_contrast():
    """Stripes of +- 10 % in the shadow: the gain is that of their mean, so their ratio stays within 3 %.

    The filter's slope a = v / (v + EDGE) of v = 0.02 stop^2 is 0.04, so the base follows stripes by 4 % of their stops.
    """
    stripes = 1 + 0.1 * np.where(np.arange(256) % 16 < 8, 1, -1)
    found = _lifted(DARK * stripes * np.ones((256, 1)))
    middle = found[100:150, 100:148].mean(0)
    assert middle.max() / middle.min() == pytest.approx(1.1 / 0.9, rel=0.03)
    assert found.mean() > 2.5 * DARK


def test_dark_noise_is_not_lifted():
    """Light of a tenth of the noise gets at most a percent of the lift; light of 30 times the noise nearly all."""
    noise = 0.01
    assert _lifted(np.full((64, 64), 0.1 * noise), noise=noise).max() < 0.1 * noise * 1.03
    bright = np.full((64, 64), 30 * noise)
    np.testing.assert_allclose(_lifted(bright, noise=noise), _lifted(bright), rtol=0.01)


def test_colours_stay():
    random = np.random.default_rng(3)
    rgb = (0.1 * random.random((3, 50, 60))).astype(np.float32)
    found = local_tone(rgb, LUMINANCE, strength=1.0, device="opencl")
    ratio = found / rgb
    np.testing.assert_allclose(ratio[0], ratio[1], rtol=1e-6)
    assert ratio.min() > 1.4


def test_a_phone_lifts_the_dark_part_of_a_scene():
    """A room, 4 stops darker than its window: it becomes at least 1.4 times as bright, the window stays."""
    light = np.full((96, 128, 3), 0.04)
    light[16:64, 64:112] = 0.7
    scene = gs.scene_from(light, linear=True, luminance=300)
    camera = gs.open_camera("phone").with_(look="phone", exposure_time_ms=21.0)
    means = []
    for strength in (0.0, 0.5):
        linear = gs.Simulator(camera.with_(local_tone=strength), device="opencl")(scene).linear
        means.append([linear[70:90, 20:50, 1].mean(), linear[30:50, 80:100, 1].mean()])
    room, window = np.array(means[1]) / means[0]
    assert room > 1.4 and window == pytest.approx(1, abs=0.05)


def test_bad_strengths_are_refused():
    with pytest.raises(OutOfRange, match=r"processor\.local_tone"):
        gs.Processor(local_tone=1.5)
    planes = np.zeros((3, 4, 4), np.float32)
    with pytest.raises(OutOfRange, match="local_tone: strength"):
        local_tone(planes, LUMINANCE, strength=-1.0)
    with pytest.raises(OutOfRange, match="local_tone: noise"):
        local_tone(planes, LUMINANCE, strength=1.0, noise=np.nan)

"""Errors of splines that carry Gaussians: against dense sums, which know no grid."""

from functools import cache

import numpy as np
import pytest
from scipy.fft import dctn
from scipy.ndimage import gaussian_filter

from gpusim.kernels.optics.far import far
from gpusim.optics.farfield import energies, gaussians, misses
from gpusim.optics.outside import Outside
from gpusim.planner.knobs.farfield import FarField, spline_error

SHAPE = 240, 200
SIGMAS = gaussians(8, 400, 1.8)
ENERGIES = energies(SIGMAS, np.array([0.03, 0.01, 0.02]))  # of a tail
FLOAT = 3e-8  # of the light: the energies add up to a few hundredths
# Of the light, where splines' sums over samples differ by 5e-4 in turns, at spacings of 2.5: a wave of a fifth of a
# cycle a sample, half a cycle a spacing, is seen by it as a slow one
TURNS = 5.3e-4 / 2 * np.sinc(0.5) ** 4 * ENERGIES[0]


def error_of(light, spacings):
    """What splines give more than sums do in a mirrored world, (rows, cols)."""
    light = light.astype(np.float32)
    return far(*given(light), spacings=spacings, device="opencl:pocl") - sums(light.tobytes())


def given(light):
    """Inputs of the stage: the light beyond nothing of its own."""
    return (
        np.zeros(SHAPE, np.float32),
        light[None],
        ENERGIES[None, None],
        SIGMAS,
        np.zeros((1, 1), np.int32),
        "reflect",
    )


@cache
def sums(light):
    """What dense sums give of light's bytes: the same for splines of every spacing."""
    return far(*given(np.frombuffer(light, np.float32).reshape(SHAPE)), device="numpy")


@pytest.mark.parametrize("spacings", [1.0, 1.2, 1.6])
@pytest.mark.parametrize("halves", [(3, 0), (0, 9), (24, 0), (48, 20), (0, 60), (90, 30), (70, 70)])
def test_a_wave_errs_as_its_frequency_says(halves, spacings):
    """A mirrored world has cosines of whole half waves as its own; their aliases add up in the mean square but where
    some of them are of one frequency, which may leave up to twice that, or nothing of one of a few.
    """
    waves = [
        np.cos(np.pi * k * (np.arange(n) + 0.5) / n) for k, n in zip(halves, SHAPE, strict=True)
    ]
    light = np.multiply.outer(*waves)
    found = np.sqrt(np.mean(error_of(light, spacings) ** 2) / np.mean(light**2))
    at = [np.array([k / 2 / n]) for k, n in zip(halves, SHAPE, strict=True)]
    expected = float(np.sqrt(misses(SHAPE, SIGMAS, ENERGIES[None], spacings, *at)[0, 0, 0]))
    floor = FLOAT + (TURNS if spacings == 1.6 else 0)
    print(f"{halves}, {spacings}: {found:.2e}, predicted {expected:.2e}")
    assert expected / 1.5 - floor < found < 1.5 * expected + floor


@cache
def pictures():
    """Light of several kinds, at least 0: noise, that of natural scenes' spectrum, ramps and edges."""
    random, (rows, cols) = np.random.default_rng(3), SHAPE
    noise = random.random(SHAPE)
    natural = np.fft.irfft2(
        np.fft.rfft2(random.standard_normal(SHAPE))
        / np.maximum(np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(cols)), 1 / rows),
        SHAPE,
    )
    return {
        "noise": noise,
        "natural": natural - natural.min(),
        "soft": gaussian_filter(noise, 3),
        "ramp": np.tile(np.linspace(0.1, 1, cols), (rows, 1)),
        "edge": 1.0 * (np.indices(SHAPE).sum(axis=0) > 220),
    }


class Question:
    """As much of one as the error asks for: one channel of one wavelength."""

    size, share, edges = SHAPE, np.ones(1), np.ones((1, 1))


PICTURES = ["noise", "natural", "soft", "ramp", "edge"]


@pytest.mark.parametrize("spacings", [1.0, 1.2, 1.6])
@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_errs_as_its_cosines_do(name, spacings):
    """The mean squares of its half waves, each with its own error: a mirrored world's are at right angles."""
    light = pictures()[name]
    power = dctn(light, norm="ortho") ** 2 / light.size
    at = [np.arange(n) / 2 / n for n in SHAPE]
    expected = float(
        np.sqrt((power * misses(SHAPE, SIGMAS, ENERGIES[None], spacings, *at)[0]).sum())
    )
    found = float(np.sqrt(np.mean(error_of(light, spacings) ** 2)))
    print(f"{name}, {spacings}: {found:.2e}, predicted {expected:.2e}")
    assert expected / 1.5 - FLOAT < found < 1.5 * expected + FLOAT


@pytest.mark.parametrize("spacings", [1.0, 1.2, 1.6])
@pytest.mark.parametrize("name", PICTURES)
def test_the_error_of_pictures_is_predicted(name, spacings, monkeypatch):
    """Within 2.5, the factor that the account promises; a ramp is taken for the wave of the largest error."""
    monkeypatch.setattr("gpusim.planner.knobs.farfield.SPLINES", 0.0)
    light = pictures()[name].astype(np.float32)
    level = float(np.sqrt(np.mean(np.square(light, dtype=float))))
    found = np.sqrt(np.mean(error_of(light, spacings) ** 2)) / level
    outside = Outside(light, "reflect", 0, 0.0, 0.0, level, 0.0)
    field = FarField(SIGMAS, np.array([[0.03, 0.01, 0.02]]), "reflect", spacings)
    predicted = spline_error(field, outside, Question())
    print(f"{name}, {spacings}: {found:.2e}, predicted {predicted:.2e}")
    assert found < 2.5 * predicted + FLOAT
    assert predicted < 2.5 * found + FLOAT or name == "ramp"

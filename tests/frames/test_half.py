"""Cubes of float16 are those of their values, at half the memory."""

import numpy as np
import pytest
from devices import ALL_KINDS, DEVICES
from foreign_arrays import CAMERA, METERED, SHAPE, WAVELENGTHS, Tensor, cube, same_bits, scene

import gpusim as gs
from gpusim.domain.errors import BadData
from gpusim.domain.memory import type_of
from gpusim.kernels.spectral.survey import survey
from gpusim.optics.highlights import Highlights
from gpusim.pipeline.light import store_content
from gpusim.planner.choices import Planes


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("tolerance", [None, "video"])
@pytest.mark.parametrize("border", [{}, {"border": "scene", "margin": 4}])
def test_a_cube_of_float16_is_that_of_its_values(device, tolerance, border):
    """Every float16 is a float32, and sums are of the same terms in the same order."""
    simulator = gs.Simulator(METERED, device=device, tolerance=tolerance)
    half = scene(cube(dtype=np.float16), **border)
    single = scene(half.content.values.astype(np.float32), **border)
    found, wanted = (simulator(shown, seed=2) for shown in (half, single))
    for name in ("mean", "raw", "linear", "rgb"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name), name)
    assert found.exposure_time == wanted.exposure_time
    streamed = [
        np.array(simulator.device.numpy(raw))
        for raw in simulator.stream([half, single, half], "raw", seed=2)
    ]
    np.testing.assert_array_equal(streamed[0], found.raw)
    if tolerance is None:
        assert simulator.loop(half).plan.find(Planes) is None  # every wavelength by itself


@pytest.mark.parametrize("device", ALL_KINDS)
def test_float16_stays_float16_on_a_device(device):
    simulator = gs.Simulator(CAMERA, device=device)
    values = simulator.device.array(cube(dtype=np.float16), np.float16)
    for content in (
        gs.Cube(WAVELENGTHS, cube(dtype=np.float16)),
        gs.Cube(WAVELENGTHS, values),
        gs.Cube(WAVELENGTHS, Tensor(cube(dtype=np.float16))),
    ):
        stored, labels = store_content(content, device=simulator.device)
        assert type_of(stored) == np.float16 and labels is None
        assert content.nbytes == 2 * cube().size
    assert gs.Cube(WAVELENGTHS, cube()).nbytes == 4 * cube().size


@pytest.mark.parametrize("device", ALL_KINDS)
def test_highlights_of_float16_are_split_off_as_those_of_float32(device):
    values = np.full((7, *SHAPE), 0.01, np.float16)
    values[:, 20, 30] = 6e4
    simulator = gs.Simulator(CAMERA, device=device)
    assert simulator.plan(scene(values)).find(Highlights) is not None
    same_bits(
        simulator.device,
        simulator.expose(scene(values)).mean,
        simulator.expose(scene(values.astype(np.float32))).mean,
    )


@pytest.mark.parametrize("device", DEVICES)
def test_a_survey_of_float16_is_that_of_its_values(device):
    random = np.random.default_rng(3)
    values, table = cube(dtype=np.float16), random.normal(0, 1, (5, 7)).astype(np.float32)
    first = np.array([-3, 0, 7, 46, 47, 99], np.int32)
    one, other = (
        survey(array, table, first, device=device) for array in (values, values.astype(np.float32))
    )
    np.testing.assert_array_equal(one, other)


def test_what_float16_cannot_hold_is_refused():
    with np.errstate(over="ignore"):
        values = (cube() * 1e6).astype(np.float16)
    with pytest.raises(BadData, match="NaN or infinite samples; float16 ends at 65504"):
        scene(values)

"""Views through the cells of a pupil: their light adds up, and their pictures differ as predicted."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.captures.views import ViewCapture, divide_pupil, expose_views
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.optics.cells import transfer_of_parts
from gpusim.optics.lenses import lens_of
from gpusim.optics.otf import transfer

LENSES = {
    "circle": {},
    "blades": {"pupil": Pupil(6, rotation=0.3)},
    "obscured": {"pupil": Pupil(obscuration=0.4)},
    "aberrated": {"wavefront": Wavefront(zernike=(0, 0, 0, 0.1, 0.05, 0, 0.1, 0.05, 0, 0, 0.08))},
}


def camera_with(**changes):
    camera = gs.open_camera("phone").with_(f_number=4.0)
    return camera.with_(optics=replace(camera.optics, relative_illumination="none", **changes))


def rates_of(simulator, scene):
    values = simulator.imaging.values(simulator.plan(scene))
    values.set_numbers(exposure_time=1.0)
    return np.asarray(simulator.device.numpy(values["electrons"]), np.float64)


@pytest.mark.parametrize(
    "name, distances",
    [
        ("circle", (0.2,)),
        *(pytest.param(name, (None, 0.2, 1.0, 1e6), marks=pytest.mark.slow) for name in LENSES),
    ],
)
def test_cells_have_all_light_of_the_lens(name, distances):
    """A flat scene, at any distance, is as bright through all cells as through the lens.

    Rates are float32 sums: with 9 cells their mean errs by less than 3 roundings of 6e-8.
    """
    camera = camera_with(**LENSES[name])
    simulator = gs.Simulator(camera, device="opencl")
    flat = gs.chart("flat", size=(24, 16))
    for distance in distances:
        depth = None if distance is None else np.full((16, 24), distance)
        scene = replace(flat, depth=depth)
        views = expose_views(simulator, scene, (2, 2))
        whole = rates_of(simulator, scene)
        assert abs(views.total.sum() / whole.sum() - 1) <= 1e-6
        assert views.shares.sum() == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    "shape", [(1, 2), *(pytest.param(shape, marks=pytest.mark.slow) for shape in ((3, 3), (9, 9)))]
)
def test_difference_is_predicted(shape):
    """Pictures of cells differ from the lens's as predicted, within a factor of 1.3."""
    simulator = gs.Simulator(camera_with(), device="opencl")
    scene = gs.chart("deadleaves", size=(96, 64))
    views = expose_views(simulator, scene, shape)
    whole = rates_of(simulator, scene)
    found = np.sqrt(np.square(views.total - whole).mean() / np.square(whole).mean())
    assert 1 / 1.3 <= views.difference / found <= 1.3


@pytest.mark.parametrize("name", LENSES)
def test_geometric_limit(name):
    """Kernels of cells add up to the lens's if nothing diffracts: at a wavelength of 0.05 nm.

    The difference is in proportion to the wavelength: 1.5e-2 of the largest value at 550 nm, 1.5e-6 here.
    """
    camera = camera_with(**LENSES[name]).with_(pixel_pitch_um=60.0, f_number=1.4)
    shares, cells = divide_pupil(camera, (4, 4))
    for distance in (None, 0.1):
        asked = np.array([0.05]), (0.3, 0.2), 15, distance
        whole = lens_of(camera).kernels(*asked)[0]
        parts = sum(
            shares[at]
            * lens_of(camera.with_(optics=replace(camera.optics, pupil=pupil))).kernels(*asked)[0]
            for at, pupil in cells.items()
        )
        assert np.abs(parts - whole).max() <= 1e-5 * whole.max()


def test_transfer_of_parts():
    """One cell is the whole pupil, and a flat pupil's transfer function is Hopkins' integral.

    Coverage of cells is linear across the edge: with 192 samples along the pupil areas err by 1e-3.
    """
    optics = camera_with().optics
    wave = np.zeros((5, 5))
    wave[2, 0] = wave[0, 2] = 0.4
    whole, parts = transfer_of_parts(optics, (1, 1), wave)
    assert np.abs(whole - parts).max() < 1e-12
    n = len(whole) // 2
    at = np.arange(0, n, n // 8)
    wanted = transfer(optics.pupil, wave[None], at / n, np.zeros(len(at)))[0]
    assert np.abs(whole[0, at] - wanted).max() < 5e-3


def test_replays_and_other_scenes():
    """A capture makes the same views again, and those of another scene like a new capture."""
    simulator = gs.Simulator(camera_with(), device="opencl")
    cube = np.random.default_rng(1).random((32, 48, 4)).astype(np.float32)
    first, second = (
        gs.scene_from(factor * cube, (450, 500, 550, 600), light="D65", luminance=100)
        for factor in (1, 0.5)
    )
    capture = ViewCapture(simulator, first, (2, 2))
    once = np.array(capture())
    assert np.array_equal(once, np.array(capture()))
    assert np.array_equal(once, np.array(expose_views(simulator, first, (2, 2))))
    assert np.allclose(np.array(capture(second)), once / 2, rtol=1e-6)


def test_refusals():
    """Lenses that cannot be cut, and numbers of cells that make no sense."""
    scene = gs.chart("flat", size=(16, 16))
    camera = gs.open_camera("phone")
    with pytest.raises(BadData, match="has no pupil"):
        expose_views(gs.Simulator(camera.with_(model="none"), device="numpy"), scene, (2, 2))
    with pytest.raises(OutOfRange, match="pupil cells"):
        expose_views(gs.Simulator(camera, device="numpy"), scene, (0, 2))

"""Lenses of Optiland, an optical design program: its point spreads in the simulator, and which way they point.

`pip install 'gpusim[optiland]'`; it brings large libraries, so the other tests do without.
"""

from dataclasses import replace

import numpy as np
import pytest
from cameras import camera_with
from devices import KINDS
from refusals import refused
from scipy.special import j1

import gpusim as gs
from gpusim.domain.errors import OutOfRange

pytest.importorskip(
    "optiland", reason="Optiland, the judge of these tests, is not installed: pip install optiland"
)
pytestmark = pytest.mark.filterwarnings("ignore")  # Numba's about itself
WAVES = np.linspace(450.0, 650.0, 5)


def thin_lens(f_number, focal_length):
    """An ideal lens, f [mm]."""
    from optiland.optic import Optic

    optic = Optic()
    optic.surfaces.add(index=0, radius=np.inf, thickness=np.inf)
    optic.surfaces.add(
        index=1, surface_type="paraxial", f=focal_length, thickness=focal_length, is_stop=True
    )
    optic.surfaces.add(index=2)
    optic.set_aperture(aperture_type="EPD", value=focal_length / f_number)
    optic.fields.set_type("angle")
    for angle in (0, 5):
        optic.fields.add(y=angle)
    optic.wavelengths.add(0.55, is_primary=True)
    return optic


@pytest.fixture(scope="module")
def triplet():
    from optiland.samples.objectives import CookeTriplet

    return CookeTriplet()


@pytest.fixture(scope="module")
def traced(triplet):
    """Point spreads of the triplet, f = 50 mm, f/5, to 12 mm from the axis."""
    return gs.optiland_psf(triplet, (450, 550, 650), 12e-3, (0, 0.5, 1), rays=64)


def test_an_ideal_lens_makes_airy_patterns():
    """Units and sizes by Airy's formula, at f/16, where sines are tangents to 1e-3.

    The square rays of a pupil 128 across tell its edge to some hundredths of their distance: 1e-3 of its width.
    """
    spread = gs.optiland_psf(thin_lens(16, 10), (450, 550, 650), 1e-3, (0,))
    assert spread.spacing == pytest.approx(0.95 * 450e-9 * 16 / 2, rel=1e-9)
    n = spread.values.shape[-1]
    r = np.hypot(*(np.indices((n, n)) - (n - 1) / 2)) * spread.spacing
    for nm, values in zip(spread.wavelengths, spread.values, strict=True):
        v = np.pi * r / (nm * 1e-9 * 16) + 1e-9
        assert np.abs(values / values.max() - (2 * j1(v) / v) ** 2).max() < 2e-3


def point(size, at):
    """A point of even light before a monochrome camera."""
    planes = np.zeros((len(WAVES), *size), np.float32)
    planes[:, at[0], at[1]] = 1
    return gs.Scene(gs.Cube(WAVES, planes), gs.chart("flat").illuminant, border="zero")


def light_of(device, scene, **optics):
    mono = gs.open_camera("mono")
    camera = camera_with(
        replace(mono, sensor=replace(mono.sensor, pixel_pitch=3e-6)),
        optics={"relative_illumination": "none", **optics},
    )
    simulator = gs.Simulator(camera, device=device)
    return np.asarray(simulator.device.numpy(simulator.expose(scene, 1.0).mean), np.float64)


@pytest.mark.parametrize("device", KINDS)
def test_an_ideal_lens_is_the_diffraction_of_ours(device):
    """A point of light through both: the same, but for the light beyond the point spread's edge, taken for its own.

    Beyond a radius of R an Airy pattern has 2 lambda N / (pi^2 R) of its light; the square of half-width
    R = 32 x 0.475 x 450 nm N has its edge between R and 1.41 R, so 1.1 % to 1.9 % at 450 nm to 650 nm.
    """
    spread = gs.optiland_psf(thin_lens(8, 10), (450, 550, 650), 1e-3, (0,))
    scene = point((64, 64), (32, 32))
    lens = {"f_number": 8.0, "focal_length": 10e-3}
    ours = light_of(device, scene, **lens)
    its = light_of(device, scene, **lens, model="measured", psf=spread)
    ratio = its[29:36, 29:36].sum() / ours[29:36, 29:36].sum()
    assert 1.008 < ratio < 1.022
    # wavelengths are linear in between, 100 nm apart: a fifth of their second difference, 2 % at the flank of the peak
    assert np.abs(its / ratio - ours)[20:45, 20:45].max() < 0.015 * ours.max()


@pytest.mark.parametrize("number", [0, 1, 2])
def test_coma_points_where_rays_go(triplet, traced, number):
    """The point spreads' centre of light beside the chief ray of green: that of the rays through the lens.

    Both are equal by Ehrenfest's theorem but for the light beyond the square, which the diffraction puts out of it:
    half of the asymmetric light at the corner, whose rays reach 60 um of the square's 66.
    """
    from gpusim.io.camera.optiland import _chief, _find_field

    n = traced.values.shape[-1]
    steps = (np.arange(n) - (n - 1) / 2) * traced.spacing * 1e6
    for index, height in enumerate(traced.heights):
        field = _find_field(triplet, height * 12e-3, 550.0)
        chief = _chief(triplet, field, 550.0)
        assert abs(chief[1]) == pytest.approx(
            height * 12e-3, abs=1e-9
        )  # x = 0, y > 0: outward is up in Optiland
        rays = triplet.trace(
            Hx=0,
            Hy=field,
            wavelength=traced.wavelengths[number] / 1e3,
            num_rays=32,
            distribution="uniform",
        )
        outward = (np.mean(rays.y[rays.i > 0]) / 1e3 - chief[1]) * 1e6  # [um]
        values = traced.values[index, number]
        assert abs(values.sum(1) @ steps) < 0.01  # nothing sideways
        if height < 1:
            assert values.sum(0) @ steps == pytest.approx(outward, rel=0.1, abs=0.01)
        else:
            assert 0.4 * outward < values.sum(0) @ steps < 1.1 * outward
    assert outward > 1


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize(
    "toward", [(1, 1), (-1, 1), (1, -1)], ids=["down right", "up right", "down left"]
)
def test_pictures_show_coma_away_from_the_middle(device, traced, toward):
    """A point half-way to a corner of a picture: its light lies beyond it, by what the point spread there says.

    A frame of 64 pixels stands for the whole field. The field's blur is interpolated to some 1e-2.
    """
    at = tuple(32 + 16 * side for side in toward)
    light = light_of(
        device, point((65, 65), at), f_number=5.0, focal_length=50e-3, model="measured", psf=traced
    )
    offset = (
        np.array([light.sum(1) @ (np.arange(65) - at[0]), light.sum(0) @ (np.arange(65) - at[1])])
        / light.sum()
    )
    outward = offset @ toward / np.sqrt(2) * 3e-6
    n = traced.values.shape[-1]
    steps = (np.arange(n) - (n - 1) / 2) * traced.spacing
    expected = [values.sum(0) @ steps for values in traced.values[1]]
    assert 0.7 * min(expected) < outward < 1.3 * max(expected)
    assert abs(offset @ (toward[1], -toward[0])) < 0.1 * abs(offset @ toward)


def test_recipe(tmp_path, traced):
    gs.write_psf(tmp_path / "lens.npz", traced)
    assert gs.read_psf(tmp_path / "lens.npz").heights.tolist() == traced.heights.tolist()


def test_what_a_lens_cannot_show_is_said(triplet):
    with refused("image height", "22.5 mm", "18.14 mm", error=OutOfRange):
        gs.optiland_psf(triplet, (550,), 30e-3)
    for wrong in (
        {"heights": (0.5, 1)},
        {"wavelengths": ()},
        {"corner": -1},
        {"samples": 2},
        {"rays": 1.5},
    ):
        with refused():
            gs.optiland_psf(triplet, **{"wavelengths": (550,), "corner": 1e-3, **wrong})

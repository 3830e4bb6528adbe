"""ISO speed against the integrals written out, and what gains, wells and binning do to it."""

from dataclasses import replace

import colour
import numpy as np
import pytest
from scipy.constants import c, h

from gpusim.color.speed import electrons_per_exposure, gain_for_speed, iso_speed
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.spectrum import Spectrum
from gpusim.io.camera.cameras import camera_names, open_camera

# Light between the nodes of its table, 5 nm apart, is linear in photons here and in energy there: the energy per photon
# bends by (5 / 500)^2 / 8 = 1e-5 of itself, and steps of 0.01 nm add less than 1e-6.
RTOL = 2e-5


def brute_force(sensor):
    """Electrons of each channel per lux second of D55, from colour-science's tables and CODATA's constants."""
    nm = np.arange(300, 780.001, 0.01)
    light, eye = (
        colour.SDS_ILLUMINANTS["D55"],
        colour.MSDS_CMFS["CIE 1931 2 Degree Standard Observer"],
    )
    power = np.interp(nm, light.wavelengths, light.values)
    sight = np.interp(nm, eye.wavelengths, eye.values[:, 1], left=0, right=0)
    lux = 683 * np.trapezoid(power * sight, nm)
    photons = power * nm * 1e-9 / (h * c)
    qe = [np.interp(nm, sensor.qe.wavelengths, row, left=0, right=0) for row in sensor.qe.values]
    area = sensor.pixel_pitch**2 * sensor.fill_factor
    return np.array([area * np.trapezoid(photons * row, nm) for row in qe]) / lux


@pytest.mark.parametrize("name", camera_names())
def test_built_in_cameras_against_the_integrals(name):
    sensor = open_camera(name).sensor
    most = brute_force(sensor).max()
    assert electrons_per_exposure(sensor) == pytest.approx(most, rel=RTOL)
    # their gain is automatic: the full well, and no electron less, reaches the white level
    assert iso_speed(sensor) == pytest.approx(78 * most / sensor.full_well, rel=RTOL)


def test_gain_divides_the_exposure_that_saturates():
    sensor = open_camera("phone").sensor
    base = iso_speed(sensor)
    assert iso_speed(replace(sensor, analog_gain=8.0)) == pytest.approx(8 * base, rel=1e-12)
    assert iso_speed(replace(sensor, analog_gain=0.5)) == pytest.approx(
        base, rel=1e-12
    )  # the well is full
    assert iso_speed(replace(sensor, full_well=sensor.full_well / 2)) == pytest.approx(
        2 * base, rel=1e-12
    )


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"analog_offset": 300.0},
        {"gain": 0.5},
        {"gain": 0.05},
        {"analog_gain": 3.0},
        {"binning": (2, 2)},
        {"binning": (2, 2), "gain": 0.05},
        {"binning": (2, 1), "binning_mode": "digital"},
    ],
)
@pytest.mark.parametrize("times", [1, 1.7, 20])
def test_the_converter_is_full_at_the_exposure_that_the_speed_names(changes, times):
    """Light of 78 / S lx s, counted, amplified and with its offset, is the white level."""
    sensor = replace(open_camera("phone").sensor, **changes)
    speed = times * iso_speed(replace(sensor, analog_gain=1.0))
    made = replace(sensor, analog_gain=gain_for_speed(sensor, speed))
    assert iso_speed(made) == pytest.approx(speed, rel=1e-12)
    added = np.prod(made.binning) if made.binning_mode == "charge" else 1
    node = replace(made, full_well=made.full_well * added)  # a node has as many wells
    electrons = 78 / speed * brute_force(made).max() * added
    level = made.black_level + node.gain_dn_per_electron * (electrons + made.analog_offset)
    assert level == pytest.approx(made.white_level, rel=RTOL)
    assert electrons <= node.full_well * (1 + RTOL)


def test_what_has_no_such_speed_says_so():
    sensor = open_camera("phone").sensor
    base = iso_speed(sensor)
    with pytest.raises(
        OutOfRange, match=r"^iso = 25: allowed is 51\.95, this sensor's base speed, or more"
    ):
        gain_for_speed(sensor, 25)
    for given in (1.01e4 * base, np.inf):
        with pytest.raises(OutOfRange, match="up to an analog gain of 10000"):
            gain_for_speed(sensor, given)
    assert gain_for_speed(sensor, 51.95) >= 1  # what the message allows
    with pytest.raises(
        OutOfRange, match=r"iso = 400: allowed is none: without a converter it is 51\.9"
    ):
        gain_for_speed(replace(sensor, bits=32), 400)
    with pytest.raises(
        OutOfRange, match="base speed"
    ):  # 60 e- less the 100 of the offset are no light
        gain_for_speed(replace(sensor, analog_offset=-100.0), 100 * base)
    infrared = replace(sensor, qe=Spectrum([800.0, 900.0], np.full((3, 2), 0.5)))
    assert iso_speed(infrared) == 0
    with pytest.raises(BadData, match="no ISO speed"):
        gain_for_speed(infrared, 100)

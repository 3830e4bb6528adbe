"""Merged captures with digital binning: full pixels that their mean hides."""

from dataclasses import replace

import numpy as np
import pytest

import gpusim as gs
from gpusim.captures.bracket import Bracket
from gpusim.captures.capture import Light
from gpusim.captures.merge import merge_bracket, merge_reads
from gpusim.captures.reads import Reads
from gpusim.domain.errors import BadData
from gpusim.domain.noise import Noise

TIMES = (0.005, 0.01, 0.02)


def scene():
    """A grey field with bright samples that fill one of four pixels of a bin in the long exposures only."""
    flat = gs.chart("flat", size=(32, 24))
    light = np.ones((24, 32), np.float32)
    light[4::8, 4::8] = 6.0
    return replace(flat, content=replace(flat.content, shading=light * 0.05))


def camera(row_time=0.0):
    mono = gs.open_camera("mono")
    noise = Noise(photon="none", read=0.5)
    optics = replace(mono.optics, model="none", relative_illumination="none")
    sensor = replace(mono.sensor, binning=(2, 2), binning_mode="digital", noise=noise)
    return replace(mono, optics=optics, sensor=replace(sensor, row_time=row_time))


def well_of(own, seen, fill):
    """The camera with a well that the bright samples fill to `fill` in the last exposure."""
    plain = replace(own, sensor=replace(own.sensor, binning=(1, 1)))
    most = float(np.max(gs.Simulator(plain).expose(seen, TIMES[-1]).mean))
    bits = replace(own.sensor, full_well=most / fill, bits=16)
    return replace(own, sensor=bits), np.asarray(gs.Simulator(plain).expose(seen, 1.0).mean)


@pytest.mark.parametrize("kind", ["reads", "bracket"])
@pytest.mark.parametrize("device", ["opencl:0", "numpy"])
def test_pixels_that_are_full_in_one_exposure_are_taken_from_another(kind, device):
    """Rates of 2 x 2 pixels, of which one is full in the longest of three exposures, to 1 %: the mean would be short.

    One of four is clipped at 1 / 1.5 of its charge: the mean rate of the bin would be 22 % too low.
    """
    seen = scene()
    own, rate = well_of(camera(), seen, 1.5)
    simulator = gs.Simulator(own, device=device)
    capture = Reads(times=TIMES) if kind == "reads" else Bracket(stops=(-2, -1, 0))
    light = Light(capture, simulator, seen, 0, exposure_time=TIMES[-1])
    frames = [shot.frame() for shot in capture.shots(light, 1, 0)]
    longest = max(frames, key=lambda one: one.exposure_time)
    truth = rate.reshape(12, 2, 16, 2).mean(axis=(1, 3))
    bright = truth > 1.5 * np.median(truth)
    assert (longest.full == bright).all() and not min(
        frames, key=lambda one: one.exposure_time
    ).full.any()
    merged = (merge_reads if kind == "reads" else merge_bracket)(simulator, frames)
    found = merged.mean / merged.exposure_time
    assert found == pytest.approx(truth, rel=0.01)
    short = (longest.raw - own.sensor.dark_level) / longest.camera.sensor.gain_dn_per_electron
    assert (short[bright] / longest.exposure_time < 0.9 * truth[bright]).all()


def test_means_that_do_not_tell_are_refused():
    own, _ = well_of(camera(), scene(), 1.5)
    simulator = gs.Simulator(own)
    frames = [
        simulator.expose(scene(), time).frame(seed=1, first=k) for k, time in enumerate(TIMES)
    ]
    blind = [replace(frame, full=None) for frame in frames]
    with pytest.raises(BadData, match="hides full pixels"):
        merge_bracket(simulator, blind)
    assert merge_bracket(simulator, frames).mean.shape == (12, 16)

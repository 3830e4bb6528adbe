"""Probes: what a plan reads and transforms of a scene, and the figures of an error in its windows."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.fft
from cameras import PHONE

import gpusim as gs
from gpusim.domain.account import Tolerance
from gpusim.domain.content import Basis, Cube, Materials
from gpusim.optics.windows import Windows, _draw
from gpusim.planner import probes
from gpusim.planner.facts import Facts, OnHost
from gpusim.planner.plan import plan
from gpusim.planner.probes import INNER, RIM, SIDE, Probes
from gpusim.planner.window_light import Light

WAVELENGTHS = np.linspace(400, 700, 31)
RANDOM = np.random.default_rng(3)
SPECTRA = RANDOM.random((4, 31))
SHAPE = (150, 190)
LIGHT = gs.chart("flat").illuminant
FORMS = {
    "cube": (Cube(WAVELENGTHS, RANDOM.random((31, *SHAPE), np.float32)), 31),
    "basis": (Basis(WAVELENGTHS, RANDOM.random((4, *SHAPE), np.float32), SPECTRA), 4),
    "materials": (
        Materials(
            WAVELENGTHS,
            RANDOM.integers(0, 4, SHAPE).astype(np.uint8),
            RANDOM.random(SHAPE, np.float32),
            SPECTRA,
        ),
        31,
    ),
}


class Counted(OnHost):
    """Samples that note what is read of them: how many each time."""

    def __init__(self, content):
        super().__init__(content)
        self.read = []

    def rows(self, chosen):
        self.read.append(chosen.size * SHAPE[1])
        return super().rows(chosen)

    def windows(self, rows, cols):
        self.read.append(rows.size * cols.shape[1])
        return super().windows(rows, cols)

    def brightness(self, total):
        self.read.append("brightness")
        return super().brightness(total)

    def whole(self):
        raise AssertionError("nothing of this scene is so bright that all of it is needed")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("tolerance", [None, "1e-2", "3e-5", "metrology"])
def test_a_plan_reads_a_scene_once(form, tolerance, monkeypatch):
    """All of it for its brightness, some pairs of rows, and windows, of which as few planes are transformed as tell."""
    (content, planes), transformed, inner = FORMS[form], [], scipy.fft.rfft2
    monkeypatch.setattr(
        probes.scipy.fft,
        "rfft2",
        lambda values, **how: transformed.append(values.shape) or inner(values, **how),
    )
    samples = Counted(content)
    plan(
        gs.Scene(content, LIGHT),
        PHONE,
        tolerance=tolerance and Tolerance.parse(tolerance),
        facts=Facts(content, None, samples),
    )
    rows = 2 * (SHAPE[0] - 1) * SHAPE[1]
    windows = [shape for shape in transformed if len(shape) == 4]
    if tolerance is None:
        assert samples.read == ["brightness", rows] and not windows
    else:
        assert set(windows) == {(1, planes, SIDE, SIDE)}
        assert samples.read == ["brightness", rows, len(windows) * SIDE**2]


@pytest.mark.parametrize(
    "content",
    [FORMS["basis"][0], gs.picture(RANDOM.integers(0, 256, (*SHAPE, 3), np.uint8)).content],
    ids=["basis", "picture"],
)
def test_samples_that_a_scene_was_made_of_are_not_checked_again(content, monkeypatch):
    scene = gs.Scene(content, LIGHT)
    simulator = gs.Simulator(PHONE, device="numpy")
    for form in {type(content), Basis}:
        monkeypatch.setattr(form, "check", lambda *_: pytest.fail("checked again"))
    assert simulator.loop(scene).plan.models


def test_entries_are_probed_as_their_spectra_are():
    """A basis and the cube that it makes: means round to float32, all samples of a window alike."""
    basis = FORMS["basis"][0]
    cube = Cube(WAVELENGTHS, basis.bands_at(slice(None)).astype(np.float32))
    for border in ("edge", "zero"):
        windows = Windows.of(basis.brightness(np.ones(31)), 0, border, 6, SIDE, RIM)
        own, its = (
            Probes.of(
                Facts(content),
                windows,
                border,
                tables=None,
                weights=None,
                even=None,
                share=None,
                level=1.0,
                seconds=1.0,
                noise=1.0,
            )
            for content in (basis, cube)
        )
        np.testing.assert_allclose(own.light.means, its.light.means, rtol=1e-6)
        assert np.abs(own.light.spectra - its.light.spectra).max() < (
            4 * 2.0**-24 * SIDE**2 * its.light.means.max()
        )


def test_the_figures_of_an_error():
    """By hand, over every pixel of the windows' inner parts with its weight: errors that differ between windows."""
    count, channels = 5, 3
    weight, share = RANDOM.random(count), np.array([0.25, 0.5, 0.25])
    weight /= weight.sum()
    tables = np.ones((channels, SIDE, SIDE // 2 + 1))
    light = RANDOM.random((count, channels, SIDE, SIDE), np.float32)
    made = Probes(
        Windows(np.zeros((count, SIDE), int), np.zeros((count, SIDE), int), weight, 1.25),
        Light(scipy.fft.rfft2(light), np.ones((count, channels))),
        tables,
        np.eye(channels),
        np.eye(channels),
        share,
        level=3.0,
        seconds=7.0,
        noise=2.0,
    )
    wrong = RANDOM.normal(size=light.shape) * 10.0 ** -RANDOM.uniform(0, 3, (count, channels, 1, 1))
    wrong = wrong.astype(np.float32)
    found = made.bound(scipy.fft.rfft2(wrong))
    inner = np.s_[..., RIM:-RIM, RIM:-RIM]
    signal, error = light[inner].astype(np.float64) + 1, np.abs(wrong[inner].astype(np.float64))
    pixel = np.broadcast_to((weight[:, None] * share)[..., None, None], error.shape) / INNER**2
    together = (weight[:, None, None] * signal.sum(axis=1) ** 2).sum() / INNER**2
    size = 3.0 * np.sqrt((pixel * signal**2).sum() / together)
    assert found.rms == pytest.approx(np.sqrt((pixel * error**2).sum()) / size, rel=1e-5)
    sigma = error * 7 / np.sqrt(signal * 7 + 2)
    order = np.argsort(sigma, axis=None)[::-1]
    above = np.cumsum(pixel.ravel()[order])
    assert found.p999_sigma == pytest.approx(np.interp(1e-3, above, sigma.ravel()[order]), rel=1e-3)
    assert found.max_sigma == pytest.approx(1.25 * sigma.max(), rel=1e-5)
    none = replace(made, level=0.0).bound(scipy.fft.rfft2(wrong))
    assert (none.rms, none.p999_sigma, none.max_sigma) == (0, 0, 0)


def test_points_of_light_are_all_looked_at():
    """However much brighter some are: each of them is in a window that stands for itself alone."""
    light = np.ones((400, 600), np.float32)
    points = {(30, 50): 1e4, (110, 333): 3e3, (210, 90): 3e2, (290, 490): 1e2, (333, 210): 50.0}
    for place, own in points.items():
        light[place] = own
    found = Windows.of(light, 0, "edge", 12, SIDE, RIM)
    assert len(found.rows) == 12
    one = INNER**2 / light.size
    for y, x in points:
        seen = [
            weight
            for rows, cols, weight in zip(found.rows, found.cols, found.weight, strict=True)
            if y in rows[RIM:-RIM] and x in cols[RIM:-RIM]
        ]
        assert min(seen) == pytest.approx(one, rel=0.2)


def test_windows_stand_for_all_others():
    """Means over many orders are those of all windows, whatever the values (Horvitz and Thompson).

    To a draw of the twelve: the first place is half a draw from the start in every order, not anywhere.
    """
    random, n = np.random.default_rng(7), 40
    energy, value = random.random(n) ** 4, random.random(n)
    energy[:2] += 20  # certain
    sums = []
    for _ in range(2000):
        order = random.permutation(n)
        drawn, weight = _draw(energy[order], 12)
        assert len(set(drawn)) == 12
        sums.append(weight @ value[order][drawn])
    assert np.mean(sums) == pytest.approx(value.sum(), rel=1 / 12)

"""`gpusim bench peers`: errors that are right, and libraries that are not there."""

import json

import numpy as np
import pytest

from gpusim.__main__ import start
from gpusim.backends import open_device
from gpusim.bench import peer_noise, peer_spread
from gpusim.bench.peer_spread import BANDS, make_spread
from gpusim.bench.peer_task import Task
from gpusim.bench.peers import time_peers


def test_a_library_that_is_missing_or_broken_is_said(monkeypatch):
    task = Task("noise", "NumPy")

    def broken():
        raise ImportError("no module named 'pkg_resources'")

    monkeypatch.setattr("gpusim.bench.peer_task.find_spec", lambda name: None)
    task.add("GalSim", broken, "galsim")
    task.add("NumPy", broken)
    assert task.time(1) == [
        {"name": "noise: GalSim", "failed": "not installed: pip install galsim"},
        {"name": "noise: NumPy", "failed": "cannot be imported: no module named 'pkg_resources'"},
    ]


def test_counts_of_another_law_are_not_called_poissons():
    """A normal law of the same mean and variance has a third moment of 0 where Poisson's is its mean."""
    random = np.random.default_rng(1)
    right = peer_noise._compare_counts(random.poisson(peer_noise.LEVEL, (200, 300)))
    normal = random.normal(peer_noise.LEVEL, np.sqrt(peer_noise.LEVEL), (200, 300))
    wrong = peer_noise._compare_counts(np.maximum(normal, 0))
    assert float(right.split()[1]) < 2.5  # of 20 classes: chance 2e-4
    assert float(wrong.split()[1]) > 20


def test_the_true_spread_has_the_light_of_airys_rings():
    """A pixel's edge is small against q = 40, so the light within a radius r is 1 - J0(v)^2 - J1(v)^2.

    v = pi r / q (Rayleigh 1881). The ring of pixels that the circle cuts is up to a pixel wide: 2 pi r
    of them hold less than their density there, 0.002 each.
    """
    from scipy.special import j0, j1

    q = 40.0
    light = peer_spread._integrate(np.array([q]), peer_spread.NODES)[0]
    at = np.arange(-peer_spread.HALF, peer_spread.HALF + 1)
    radius = 30.0
    within = light[np.hypot(at[:, None], at) <= radius].sum()
    v = np.pi * radius / q
    assert abs(within - (1 - j0(v) ** 2 - j1(v) ** 2)) < 0.01


def test_gpusims_forms_are_within_their_words():
    """Of a small frame on the processor. The stage's tolerance is 1e-6 of a table: 1e-6 of a peak at most."""
    device = open_device("opencl")
    rows = {row["name"]: row for row in make_spread(device, BANDS[::15]).time(1)}
    assert float(rows["spread: gpusim"]["error"].split()[1]) < 1e-6
    rows = {row["name"]: row for row in time_peers(device, ["picture"], (64, 48), None, 1)}
    # codes are rounded exactly, but for float32 sums within 1e-6 of a code's limit: one in a thousand at most
    assert float(rows["picture: gpusim, bilinear"]["error"].split()[1]) < 0.001**0.5
    # numbers of 10 bit are rounded before the curve, whose steepest step is 3.2 codes a number: half of it at most
    assert 0 < float(rows["picture: NumPy"]["error"].split()[1]) < 1.6 + 0.5
    rows = {row["name"]: row for row in time_peers(device, ["noise"], (320, 240), None, 1)}
    for name in ("noise: NumPy", "noise: gpusim, fast", "noise: gpusim, exact"):
        assert float(rows[name]["error"].split()[3].rstrip(")")) > 0  # p to two places: above 0.005


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("peers --task nosie", "did you mean 'noise'"),
        ("peers --repeat 0", "--repeat"),
        ("scaling --device numpy --threads", "an OpenCL device of the processor"),
        ("scaling --device numpy --content cub", "did you mean 'cube'"),
        ("scaling --device numpy --size 64x48", "--size"),  # of --threads alone
    ],
)
def test_mistakes_are_said_in_one_line(words, told, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["gpusim", "bench", *words.split()])
    assert start() == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and told in said, said


@pytest.mark.slow
def test_cores_and_sizes_are_measured(monkeypatch, tmp_path, capsys):
    """On one core, at most one is busy: PoCL has one thread, and the others wait."""
    path = tmp_path / "threads.json"
    words = f"scaling --device opencl --threads --size 160x96 --repeat 5 --json {path}"
    monkeypatch.setattr("sys.argv", ["gpusim", "bench", *words.split()])
    assert start() == 0
    result = json.loads(path.read_text())
    assert result["bench"] == "threads" and result["rows"][0]["threads"] == 1
    assert result["rows"][0]["busy"] < 1.2
    assert capsys.readouterr().out.count("\n") == len(result["rows"])

"""The built-in cameras: sources, the figures of their data sheets, and frames.

Figures are measured on drawn raw values by plain means and variances. N pixels times frames give a variance within
sqrt(2 / N), 0.1 % here; the other errors are in TOLERANCE.
"""

import math
import re
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

import gpusim as gs
from gpusim.apps.preview.labels import describe_plan

FOLDER = Path(str(resources.files("gpusim.data")), "cameras")
ROOT = Path(__file__).parents[2]
# The ten of public data sheets, and the four that were there before
NEW = (
    *("action", "automotive", "drone", "full-frame", "phone-tele", "phone-ultra-wide"),
    *("quad-bayer", "raspberry-pi-hq", "scientific-cmos", "x-trans"),
)
LINE = "# simulated against published: "
NONE = "no figure of its noise is published"
FIGURE = re.compile(r"(.+) ([\d.]+) (dB|e-|DN/e-|DN) / ([\d.]+) \3")
SHAPE, FRAMES = (240, 240), 32
# The numbers of the line are rounded to three digits: 0.5 %, 0.05 dB
TOLERANCE = {"dB": 0.1}, 0.01
# Published figures are rounded to whole dB or two digits, and a well holds 2 % less if the converter ends before it.
# Three of the first cameras have the sheet's dark noise as read noise, to which rounding adds 2.3 e- (mono), 1.8 e-
# (phone) and 0.58 e- (machine-vision): 0.42 dB, 6.3 % and 0.17 dB
PUBLISHED = {"dB": 0.15}, 0.022
KNOWN = {
    ("mono", "dynamic range"): 0.5,
    ("phone", "dark noise"): 0.07,
    ("machine-vision", "dynamic range"): 0.25,
}


def text(name):
    return (FOLDER / f"{name}.toml").read_text()


def lines(name):
    (found,) = (line for line in text(name).splitlines() if line.startswith(LINE))
    return found.removeprefix(LINE)


def published(name):
    """Return figures of the line: name, simulated, unit, published."""
    if lines(name) == NONE:
        return []
    return [
        (found[1], float(found[2]), found[3], float(found[4]))
        for part in lines(name).split("; ")
        if (found := FIGURE.fullmatch(part))
    ]


def measure(sensor):
    """Return the figures of a sensor's raw values, by name and unit."""
    readout = gs.Readout(sensor)

    def draw(electrons, first):
        mean = np.full(SHAPE, electrons, np.float32)
        raw = readout.draw_electrons(mean, 1e-3, seed=3, first=first, frames=FRAMES)
        return raw.astype(np.float64)

    dark, bright = draw(0, 0), draw(0.5 * sensor.saturation, FRAMES)
    full, beyond = (
        draw(0.95 * sensor.saturation, 2 * FRAMES),
        draw(3 * sensor.saturation, 3 * FRAMES),
    )
    black = dark.mean()
    variance = [stack.var(axis=0, ddof=1).mean() for stack in (dark, bright, full)]
    gain = (variance[1] - variance[0]) / (bright.mean() - black)
    saturation = (beyond.mean() - black) / gain
    noise = math.sqrt(variance[0])
    # the ratio grows with the root of the signal up to saturation
    ratio = (full.mean() - black) / math.sqrt(variance[2]) / math.sqrt(0.95)
    return {
        ("gain", "DN/e-"): gain,
        ("saturation", "e-"): saturation,
        ("dark noise", "DN"): noise,
        ("dark noise", "e-"): noise / gain,
        ("SNR max", "dB"): 20 * math.log10(ratio),
        ("dynamic range", "dB"): 20 * math.log10(saturation / (noise / gain)),
        ("dynamic range (EMVA 1288)", "dB"): 20 * math.log10(saturation / (noise / gain + 0.5)),
    }


def close(value, wanted, unit, tolerance):
    absolute, relative = tolerance
    return abs(value - wanted) <= absolute.get(unit, relative * wanted)


def test_the_library_has_twelve_cameras_of_data_sheets():
    assert set(NEW) < set(gs.camera_names())
    assert set(gs.camera_names()) - set(NEW) == {"phone", "machine-vision", "mono", "figure8"}


@pytest.mark.parametrize("name", gs.camera_names())
def test_every_camera_states_its_sources_and_what_is_not_measured(name):
    head = text(name).partition("[optics]")[0]
    assert all(line.startswith("#") or not line for line in head.splitlines())
    assert re.search("not( |\\n# )measure|not documented|neither filters nor noise", head)
    assert lines(name) == NONE or len(published(name)) == len(lines(name).split("; "))


def test_the_docs_list_every_camera():
    page = (ROOT / "docs" / "cameras.md").read_text()
    rows = re.findall(r"^\| `([\w-]+)` \|", page.partition("## A finished look")[0], re.M)
    assert sorted(rows) == gs.camera_names()


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in gs.camera_names() if published(name)])
def test_simulated_figures_against_the_published_ones(name):
    found = measure(gs.open_camera(name).sensor)
    for figure, simulated, unit, sheet in published(name):
        value = found[figure, unit]
        assert close(value, simulated, unit, TOLERANCE), (figure, value, simulated)
        known = KNOWN.get((name, figure))
        limits = PUBLISHED if known is None else ({"dB": known}, known)
        assert close(value, sheet, unit, limits), (figure, value, sheet)


@pytest.mark.slow
@pytest.mark.parametrize("name", gs.camera_names())
def test_frames_plans_and_labels_of_every_camera(name):
    scene = gs.chart("deadleaves", size=(72, 54), luminance=300)
    camera = gs.open_camera(name)
    exact = gs.Simulator(camera, device="opencl:0")(scene, seed=1)
    assert exact.raw.shape == (54, 72) and np.isfinite(np.asarray(exact.rgb)).all()
    assert exact.raw.std() > 0 and exact.raw.max() <= camera.sensor.white_level
    planned = gs.Simulator(camera, device="opencl:0", tolerance="video")
    forecast = planned.plan(scene)
    frame = planned(scene, seed=1, verify=True)
    assert forecast.verdict.is_met
    for bound in ("rms", "p999_sigma", "max_sigma"):
        most = getattr(planned.tolerance, bound)
        assert most is None or getattr(frame.report.error, bound) <= most
    assert "tolerance met" in str(frame.report)
    assert name in repr(camera) and describe_plan({"left out": forecast.left_out})
    numpy = gs.Simulator(camera, device="numpy")(scene, seed=1)
    assert (numpy.raw == exact.raw).mean() > 0.99

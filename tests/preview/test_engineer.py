"""A camera engineer's task on the preview's page, by mouse and keyboard: two designs from the MTF to the hand-over.

What the page tells is judged by the formulas of design_formulas.py.
"""

import csv
import os
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from browsers import marked, newer, opened, photograph, version
from design_formulas import (
    DARK,
    DIGITAL,
    FREQUENCIES,
    READ,
    SAMPLES,
    A,
    B,
    edge_error,
    expected_mtf,
    half,
    variance,
)
from PIL import Image
from test_dock import open_panels, saved
from test_page import choose, keep, pointed, shown
from test_scene_page import choose as choose_scene
from test_scene_page import size

from gpusim.apps.preview.controls import CONTROLS
from gpusim.apps.preview.panels import DEFAULTS

LOSSLESS = "gpusimPainted.at(-1)[3] === 1 && gpusimPainted.at(-1)[2] > {}"


# what the engineer does


def settle(page, before):
    """Wait for the exact picture of settings newer than `before`, which the page sends without loss."""
    page.wait_for_function(LOSSLESS.format(before), timeout=60000)
    page.wait_for_timeout(300)


def set_number(page, words, name, value):
    """Search a control by words, type a number, and wait for the picture."""
    search = page.locator('input[data-mark="search"]')
    search.fill(words)
    box = page.locator(f'input[data-mark="{name} number"]')
    box.wait_for()
    before, start = version(page), time.monotonic()
    box.fill(str(value))
    box.press("Enter")
    newer(page, before)
    print(f"{name} = {value}: seen after {time.monotonic() - start:.2f} s")
    settle(page, before)
    search.fill("")


def drag(page, top, left, bottom, right):
    """Select a part of the picture; places are parts of its height and width."""
    page.mouse.move(*pointed(page, top, left))
    page.mouse.down()
    page.mouse.move(*pointed(page, bottom, right), steps=5)
    page.mouse.up()


def read(page, panel, pattern, other_than=""):
    """Return what a panel shows by a pattern, when it has rested for 2 s. other_than: what it showed before."""
    found, since = "", time.monotonic()
    for _ in range(300):
        page.wait_for_timeout(200)
        match = re.search(pattern, marked(page, f"panel {panel}").inner_text())
        now = match[0] if match else ""
        if now != found:
            found, since = now, time.monotonic()
        if found and found != other_than and time.monotonic() - since > 2:
            return re.search(pattern, found)
    raise AssertionError(f"{panel}: {marked(page, f'panel {panel}').inner_text()}")


def save(page, entry, path):
    """Choose an entry of the menu Save."""
    marked(page, "save").click()
    with page.expect_download(timeout=60000) as download:
        marked(page, entry).click()
    download.value.save_as(path)
    return path


def look(page, name, folder):
    """Keep a picture of the page."""
    page.wait_for_timeout(600)
    photograph(page, Path(folder) / f"{name}.png")


def series(path):
    """Return names and points of the lines in a panel's CSV."""
    lines: dict = {}
    for row in list(csv.reader(path.open()))[1:]:
        if len(row) == 3:
            try:
                lines.setdefault(row[0], []).append((float(row[1]), float(row[2])))
            except ValueError:
                continue  # the head of another table
    return {name: np.array(points).T for name, points in lines.items()}


# the task


def set_two_designs(page, folder):
    """Scene and camera, design A as a snapshot, then design B; both are compared."""
    choose_scene(page, "scene", "slanted-edge")
    choose_scene(page, "size", "640x480")
    assert marked(page, "scene").locator("input").input_value() == "slanted-edge"
    choose_scene(page, "camera", "mono")
    page.get_by_text("how the scene is read").click()
    field = page.locator('input[data-mark="option samples_per_pixel"]')
    field.wait_for()
    before = version(page)
    field.fill(str(SAMPLES))
    field.press("Enter")
    newer(page, before)
    before = version(page)
    marked(page, "live").click()  # the noise stands still
    settle(page, before)
    first = shown(page)
    assert first.shape == (480, 640, 3)
    keep(page, "A")
    set_number(page, "f-number", "optics.f_number", B["f_number"])
    set_number(page, "pixel pitch", "sensor.pixel_pitch_um", B["pitch"])
    set_number(page, "full well", "sensor.full_well_e", B["full_well"])
    choose(page, "compare", "side by side")
    page.wait_for_function("document.querySelector('canvas').width === 1280", timeout=20000)
    settle(page, version(page) - 1)
    both = shown(page)
    second = both[:, :640]
    assert np.array_equal(both[:, 640:], first) and not np.array_equal(second, first)
    assert marked(page, "captions").inner_text().split("\n") == ["this camera", "A"]
    look(page, "side-by-side", folder)
    before = version(page)
    choose(page, "compare", "split")
    settle(page, before)
    split = shown(page)
    assert np.array_equal(split[:, :318], second[:, :318])
    assert np.array_equal(split[:, 322:], first[:, 322:])
    before = version(page)
    choose(page, "compare", "difference")
    settle(page, before)
    apart = 128 + 4 * (second.astype(int) - first)
    assert np.array_equal(shown(page), np.clip(apart, 0, 255))
    choose(page, "compare", "blink")
    seen = set()
    for _ in range(40):
        page.wait_for_timeout(100)
        seen.add(marked(page, "captions").inner_text())
    assert seen == {"this camera", "A"}
    choose(page, "compare", "split")
    marked(page, "differences").click()
    table = marked(page, "difference table").inner_text().split("\n")
    assert [line.split("\t") for line in table] == [
        ["setting", "this camera", "A"],
        ["f-number", "8", "4"],
        ["pixel pitch [µm]", "3.45", "5.86"],
        ["full well [e⁻]", "10500", "32400"],
    ]
    look(page, "differences", folder)
    page.keyboard.press("Escape")
    keep(page, "B")


def measure_edges(page, folder):
    """MTF of both designs from the edge that is selected, against the formula; the curves as CSV."""
    for name in DEFAULTS:
        marked(page, f"close {name}").click()
    open_panels(page, "mtf", "qe")
    marked(page, "measure").click()
    take(page, "A")
    drag(page, 0.1, 0.42, 0.9, 0.58)
    read(page, "mtf", "choose the tolerance 'exact'")  # 1e-3 of the light allows no blur at all
    before = version(page)
    choose_scene(page, "tolerance", "exact")
    settle(page, before)
    marked(page, "panel qe").locator("polyline").first.wait_for(timeout=20000)
    curve = series(saved(page, "qe", "csv", folder))["channel W"]
    shapes = marked(page, "overlay").locator("svg rect").bounding_box()
    box = marked(page, "overlay").bounding_box()
    # the rectangle stands where it was dragged, within the pixels of the frame that it holds
    assert shapes["x"] - box["x"] == pytest.approx(0.42 * box["width"], abs=4)
    assert shapes["height"] == pytest.approx(0.8 * box["height"], abs=8)
    reported = ""
    for name, design in (("A", A), ("B", B)):
        if name == "B":
            take(page, "B")
        found = read(
            page, "mtf", r"MTF50 (\d\.\d+) cycle/pixel, edge at (\d\.\d) degrees", reported
        )
        reported = found[0]
        system, edge, cut = expected_mtf(design, curve)
        wrong = edge_error(design, 0.8 * 480, 0.16 * 640, edge, cut)
        at, slope = half(edge)
        allowed = float(np.interp(at, FREQUENCIES, wrong)) / slope + 0.0005  # three digits
        print(f"{name}: MTF50 {found[1]}, by the formula {at:.4f} +- {allowed:.4f}")
        assert float(found[1]) == pytest.approx(at, abs=allowed)
        assert float(found[2]) == pytest.approx(5, abs=0.1)
        lines = series(saved(page, "mtf", "csv", folder))
        # both sums over wavelengths, in steps of 10 and of 20 nm, have mean wavelengths within 1 nm: 0.2 %, and the
        # transfer falls by at most 4/pi x, x <= 0.4 where the pixel still transfers
        x, y = lines["W, lens and pixel"]
        assert y == pytest.approx(np.interp(x, FREQUENCIES, system), abs=1e-3)
        x, y = lines["pixel"]
        assert y == pytest.approx(np.abs(np.sinc(x)), abs=1e-12)
        x, y = lines["edge"]
        low = x <= 0.5
        differ = np.abs(y - np.interp(x, FREQUENCIES, edge))
        assert (differ <= np.interp(x, FREQUENCIES, wrong))[low].all()
    choose(page, "against", "A")
    choose(page, "compare", "side by side")
    page.set_viewport_size({"width": 1280, "height": 800})
    page.mouse.move(5, 5)  # no tooltip
    look(page, "preview-designs", os.environ.get("PREVIEW_PICTURES", folder))  # of docs/preview.md
    page.set_viewport_size({"width": 1600, "height": 1000})
    choose(page, "compare", "split")


def take(page, name):
    """Go on with the camera of a snapshot."""
    if marked(page, "against").locator("input").input_value() != name:
        choose(page, "against", name)
    before = version(page)
    marked(page, "take").click()
    settle(page, before)


def read_noise(page, folder):
    """SNR of design A on a grey card, against the formula and the statistics of the saved raw file."""
    take(page, "A")
    choose(page, "against", "nothing")
    before = version(page)
    choose_scene(page, "scene", "flat")
    settle(page, before)
    assert size(page) == [640, 480]
    for name in ("mtf", "qe"):
        marked(page, f"close {name}").click()
    open_panels(page, "region", "snr", "budget")
    set_number(page, "luminance of white", "luminance", 100)
    drag(page, 0.4, 0.4, 0.6, 0.6)
    where = read(page, "region", r"columns (\d+) .. (\d+), rows (\d+) .. (\d+), selected")
    left, right, top, bottom = map(int, where.groups())
    seconds = metered(page)
    electrons, decibels = map(
        float, read(page, "snr", r"selected part: W (\S+) e⁻, (\S+) dB").groups()
    )
    expected = 20 * np.log10(electrons) - 10 * np.log10(variance(electrons, A, seconds))
    assert decibels == pytest.approx(expected, abs=0.06)  # one decimal, and four digits
    budget = read(page, "budget", r"(\w+) dominates: (\d+)% of the variance")
    assert budget[1] == "photons"
    share = electrons / variance(electrons, A, seconds)
    assert float(budget[2]) == pytest.approx(100 * share, abs=0.6)
    with np.load(save(page, "save .npz", folder / "grey.npz")) as frame:
        part = frame["dn"][top : bottom + 1, left : right + 1].astype(float) - 64
        assert float(frame["exposure_time_s"]) == pytest.approx(seconds, rel=1e-3)
    part = part * A["full_well"] / DIGITAL
    # five standard errors of a mean and of a standard deviation, and four digits; dark current adds to the raw values
    error = 5 / part.size**0.5
    assert part.mean() - DARK * seconds == pytest.approx(
        electrons, abs=error * part.std() + 5e-4 * electrons
    )
    assert part.std() == pytest.approx(
        variance(electrons, A, seconds) ** 0.5, rel=error / 2**0.5 + 5e-4
    )
    look(page, "noise", folder)
    return seconds, electrons


def metered(page):
    """Return the exposure time that the camera has chosen [s]."""
    page.wait_for_timeout(600)
    box = page.locator('input[data-mark="sensor.exposure_time_ms number"]')
    return float(box.get_attribute("placeholder").removeprefix("auto: ")) / 1e3


def work_in_low_light(page, folder, seconds, electrons):
    """A tenth of the light, then a hundredth in an exposure that is not longer than 10 ms; denoising."""
    reported = read(page, "budget", r"noise at (\S+) e⁻")[0]
    set_number(page, "luminance of white", "luminance", 10)
    # the exposure is longer by as much as the light is less, but for dark current, which also fills the pixel; 4 digits
    dark = DARK * 10 * seconds / electrons
    assert metered(page) == pytest.approx(10 * seconds, rel=1e-3 + dark)
    set_number(page, "longest exposure", "sensor.auto_exposure.longest_ms", 10)
    set_number(page, "most gain", "sensor.auto_exposure.most_gain", 32)
    set_number(page, "luminance of white", "luminance", 1)
    assert metered(page) == pytest.approx(0.01)
    faint = float(read(page, "snr", r"selected part: W (\S+) e⁻", reported)[1])
    # as much light in as much time
    assert faint == pytest.approx(electrons / 100 * 0.01 / seconds, rel=2e-3)
    budget = read(page, "budget", r"(\w+) dominates: (\d+)% of the variance")
    total = variance(faint, A, 0.01, 32)
    assert faint < READ**2 and budget[1] == "read"  # shot noise is as large where S = read^2
    assert float(budget[2]) == pytest.approx(100 * READ**2 / total, abs=0.6)
    plain, raw = shown(page), save(page, "save .npz", folder / "plain.npz")
    set_number(page, "denoising", "processor.denoise", 2)
    smooth, same = shown(page), save(page, "save .npz", folder / "smooth.npz")
    assert smooth[192:288, 256:384].std() < 0.8 * plain[192:288, 256:384].std()
    with np.load(raw) as before, np.load(same) as after:
        assert np.array_equal(before["dn"], after["dn"])
    look(page, "low-light", folder)
    before = version(page)
    marked(page, "undo").click()
    settle(page, before)
    assert np.array_equal(shown(page), plain)


# of all controls, and of the comparison
VALUES = """() => [...document.querySelectorAll(
        '.gp-side :is(input[data-mark], [data-mark] input), :is([data-mark=against], [data-mark=compare]) input'
    )].map(one => [one.closest("[data-mark]").dataset.mark, one.value, one.placeholder])"""


def hand_over(page, chromium, folder):
    """A colleague opens the link in a fresh browser, and makes the frame from the camera's file."""
    choose(page, "against", "B")
    before = version(page)
    choose(page, "compare", "side by side")
    settle(page, before)
    own = shown(page)
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    marked(page, "save").click()
    marked(page, "show link").click()
    marked(page, "link").hover()
    marked(page, "link").locator("button").click()
    link = page.evaluate("navigator.clipboard.readText()")
    command = marked(page, "command").locator("code").inner_text()
    look(page, "link", folder)
    page.keyboard.press("Escape")
    other = opened(chromium, link, width=1600, height=1000)  # in a context of its own
    settle(other, -1)
    other.wait_for_timeout(1500)  # the boxes take what was metered
    assert np.array_equal(shown(other), own)
    values = page.evaluate(VALUES)
    assert other.evaluate(VALUES) == values and len(values) > len(CONTROLS)
    assert ("sensor.auto_exposure.most_gain number", "32") in {tuple(one[:2]) for one in values}
    tables = []
    for one in (page, other):
        marked(one, "differences").click()
        tables.append(marked(one, "difference table").inner_text())
        one.keyboard.press("Escape")
    assert tables[0] == tables[1] and "longest exposure" in tables[0]
    look(other, "colleague", folder)
    assert not other.errors
    other.close()
    for entry, name in (
        ("save camera", "camera.toml"), ("save .npz", "saved.npz"),
        ("save report", "report.txt"), ("save .png", "saved.png"),
    ):  # fmt: skip
        save(page, entry, folder / name)
    assert "flat 640x480" in (folder / "report.txt").read_text()
    assert np.array_equal(np.asarray(Image.open(folder / "saved.png")), own[:, :640])
    subprocess.run(
        [sys.executable, "-m", *shlex.split(command)], cwd=folder, check=True, capture_output=True
    )
    with np.load(folder / "frame.npz") as made, np.load(folder / "saved.npz") as kept:
        assert {*made} == {*kept}
        for part in made:
            assert np.array_equal(made[part], kept[part]), part


@pytest.mark.slow
def test_an_engineer_compares_two_designs_and_hands_them_over(chromium, address, tmp_path):
    page = opened(chromium, address, width=1600, height=1000)
    set_two_designs(page, tmp_path)
    measure_edges(page, tmp_path)
    seconds, electrons = read_noise(page, tmp_path)
    work_in_low_light(page, tmp_path, seconds, electrons)
    hand_over(page, chromium, tmp_path)
    assert not page.errors
    page.close()

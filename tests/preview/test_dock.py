"""The preview's panels, clipping warnings and error map in a browser."""

import csv

import numpy as np
import pytest
from browsers import marked, newer, opened, serving, version
from test_page import number, shown, still

from gpusim.apps.preview.panels import DEFAULTS, PANELS


def open_panels(page, *names):
    marked(page, "panels").click()
    for name in names:
        marked(page, f"open {name}").click()
    page.keyboard.press("Escape")


def saved(page, panel, suffix, folder):
    """A file that a panel saves."""
    marked(page, f"save {panel}").click()
    with page.expect_download(timeout=30000) as download:
        marked(page, f"save {panel}.{suffix}").click()
    path = folder / f"{panel}.{suffix}"
    download.value.save_as(path)
    assert download.value.suggested_filename == path.name
    return path


def test_panels_are_opened_changed_saved_and_closed(chromium, address, tmp_path):
    page = opened(chromium, address)
    for name in DEFAULTS:
        marked(page, f"panel {name}").locator("svg[role=img]").first.wait_for(timeout=15000)
    open_panels(page, *(name for name in PANELS if name not in DEFAULTS))
    for name in PANELS:
        shown_in = "table" if name == "region" else "svg[role=img]"
        marked(page, f"panel {name}").locator(shown_in).first.wait_for(timeout=20000)
    assert "fails" not in marked(page, "dock").inner_text()
    # names for readers of the screen
    assert page.locator('[data-mark="dock"] button:not([aria-label])').count() == 0
    assert page.locator('[data-mark="dock"] svg[role=img]:not([aria-label])').count() == 0
    # another quantity of the spectrum: it is computed when the settings rest
    marked(page, "spectrum quantity").click()
    page.locator(".q-menu").get_by_text("electrons", exact=True).click()
    spectrum = marked(page, "panel spectrum")
    spectrum.filter(has_text="e⁻/nm").wait_for(timeout=20000)
    rows = list(csv.reader(saved(page, "spectrum", "csv", tmp_path).open()))
    assert rows[0][1] == "wavelength [nm]" and {row[0] for row in rows[1:-2]} == {*"RGB"}
    assert saved(page, "histogram", "svg", tmp_path).read_text().startswith("<svg xmlns=")
    from PIL import Image

    with Image.open(saved(page, "histogram", "png", tmp_path)) as picture:
        codes = np.asarray(picture.convert("RGB"))
    assert codes.shape[1] == 840 and (codes == 255).mean() > 0.7 and codes.min() < 120
    for name in PANELS:
        marked(page, f"close {name}").click()
    page.wait_for_function("!document.querySelector('.panel')")
    assert marked(page, "open histogram").count() == 0 and not page.errors
    open_panels(page, "qe")
    marked(page, "panel qe").locator("svg[role=img]").first.wait_for(timeout=10000)
    assert page.locator(".panel").count() == 1 and not page.errors
    page.close()


@pytest.mark.slow
def test_a_panel_that_has_nothing_to_show_says_why(chromium, tmp_path):
    with serving(
        "ramp", "--camera", "phone", "--size", "160x120", "--device", "opencl", folder=tmp_path
    ) as (address, _):
        page = opened(chromium, address)
        open_panels(page, "checker", "qe")
        checker = marked(page, "panel checker")
        checker.filter(has_text="the scene is no ColorChecker").wait_for(timeout=15000)
        assert marked(page, "panel qe").locator("polyline").count() >= 3 and not page.errors
        page.close()


@pytest.mark.slow
def test_clipped_pixels_are_marked_and_counted(chromium, address):
    page = opened(chromium, address)
    page.wait_for_timeout(1500)  # the box shows the metered time first
    newer(page, number(page, "sensor.exposure_time_ms", 1000))
    before = version(page)
    marked(page, "live").click()
    newer(page, before)
    plain = still(page)
    before = version(page)
    marked(page, "clipping").click()
    newer(page, before)
    clipped = marked(page, "clipped")
    clipped.filter(has_text="saturated").wait_for(timeout=10000)
    share = float(clipped.inner_text().split()[1].rstrip("%"))
    page.wait_for_function("gpusimPainted.at(-1)[3] === 1")  # without loss
    page.wait_for_timeout(400)
    red = (shown(page) == (255, 40, 40)).all(axis=-1).mean()
    assert share > 20 and red == pytest.approx(share / 200, rel=0.1)  # half of them: stripes
    before = version(page)
    marked(page, "clipping").click()
    newer(page, before)
    page.wait_for_timeout(1000)
    assert np.array_equal(shown(page), plain)
    assert clipped.inner_text() == "" and not page.errors
    page.close()


@pytest.mark.slow
def test_an_error_map_is_cancelled(chromium, address):
    page = opened(chromium, address)
    marked(page, "error map").click()
    marked(page, "error progress").filter(has_text="since").wait_for(timeout=10000)
    marked(page, "error cancel").click()
    page.get_by_text("its result is dropped").wait_for(timeout=10000)
    marked(page, "error dialog").wait_for(state="hidden", timeout=10000)
    # when the computation has ended, another one can be begun, and it is shown
    dialog = marked(page, "error dialog").filter(has_text=" rms, ")
    for _ in range(60):
        marked(page, "error map").click()
        page.wait_for_timeout(1000)
        if marked(page, "error dialog").last.is_visible():
            break
    dialog.wait_for(timeout=60000)
    assert not page.errors
    page.close()


SECONDS = 6


def watch(page, panel):
    """Pictures a second, and contents of a panel a second."""
    page.evaluate(
        """panel => {
            window.changes = 0;
            if (window.watcher) watcher.disconnect();
            const target = document.querySelector(`[data-mark="panel ${panel}"]`);
            window.watcher = new MutationObserver(() => { window.changes += 1; });
            if (target) watcher.observe(target, { childList: true, subtree: true });
        }""",
        panel,
    )
    first = page.evaluate("[performance.now(), gpusimPainted.at(-1)[1]]")
    page.wait_for_timeout(1000 * SECONDS)
    last = page.evaluate("[performance.now(), gpusimPainted.at(-1)[1], window.changes]")
    seconds = (last[0] - first[0]) / 1e3
    return (last[1] - first[1]) / seconds, last[2] / seconds


@pytest.mark.slow
def test_panels_follow_without_slowing_the_picture(chromium, tmp_path):
    """Live noise at 1280x720: with the default panels, and with each further one, the picture keeps 80 % of its rate.

    Panels of the frame change 5 times a second."""
    with serving(
        "deadleaves", "--camera", "phone", "--size", "1280x720", "--exposure", "20ms",
        "--device", "opencl", folder=tmp_path,
    ) as (address, _):  # fmt: skip
        page = opened(chromium, address)
        page.wait_for_timeout(3000)
        for name in DEFAULTS:
            marked(page, f"close {name}").click()
        alone, _ = watch(page, "")
        open_panels(page, *DEFAULTS)
        page.wait_for_timeout(1000)
        usual, changes = watch(page, "histogram")
        print(f"pictures: {alone:.1f}/s alone, {usual:.1f}/s with {changes:.1f}/s of the histogram")
        slow = []
        for name in PANELS:
            if name in DEFAULTS:
                continue
            open_panels(page, name)
            page.wait_for_timeout(1000)
            rate, own = watch(page, name)
            print(f"{name}: {rate:.1f} pictures/s, {own:.1f} changes/s")
            if rate < 0.8 * usual or (name == "region" and own < 5):
                slow.append(name)
            marked(page, f"close {name}").click()
        assert usual >= 0.8 * alone and changes >= 5 and not slow and not page.errors

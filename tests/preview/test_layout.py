"""The page on screens of several sizes: picture and sliders in sight together, names, keys, themes."""

import os
from pathlib import Path

import numpy as np
import pytest
from browsers import marked, newer, opened, photograph, serving, version
from test_page import choose, keep, number

from gpusim.apps.preview.controls import CONTROLS, GROUPS

SIZES = {
    "1280x720": (1280, 720),
    "1600x1000": (1600, 1000),
    "2560x1440": (2560, 1440),
    "tablet": (1024, 1366),
    "phone": (390, 844),
}
# rectangles of the picture, and of each slider after it was brought into sight; both on the screen and apart
IN_SIGHT = """async () => {
    const wrong = [], page = [innerWidth, innerHeight];
    const sliders = [...document.querySelectorAll(".gp-row .q-slider")].filter(one => one.offsetParent);
    for (const slider of sliders) {
        slider.scrollIntoView({block: "nearest"});
        const one = slider.getBoundingClientRect();
        const picture = document.querySelector(".gp-picture").getBoundingClientRect();
        const inside = r => r.left >= -1 && r.top >= -1 && r.right <= page[0] + 1 && r.bottom <= page[1] + 1;
        const apart = one.top >= picture.bottom - 1 || one.left >= picture.right - 1;
        if (!inside(one) || !inside(picture) || !apart)
            wrong.push([slider.getAttribute("data-mark"), one.toJSON(), picture.toJSON()]);
    }
    return [sliders.length, wrong, document.documentElement.scrollWidth];
}"""


def open_groups(page, names=tuple(GROUPS)):
    for name in names:
        group = marked(page, f"group {name}")
        if not group.locator(".gp-row").first.is_visible():
            group.locator(".q-item").first.click()
    page.wait_for_timeout(1000)  # they open in a movement


@pytest.mark.parametrize("name", SIZES)
def test_picture_and_any_slider_are_in_sight_together(chromium, address, name):
    width, height = SIZES[name]
    page = opened(chromium, address, width=width, height=height)
    open_groups(page)
    count, wrong, wide = page.evaluate(IN_SIGHT)
    assert count > 60 and not wrong and wide <= width and not page.errors
    page.close()


def test_a_search_shows_what_it_finds(chromium, address):
    page = opened(chromium, address)
    page.locator('input[data-mark="search"]').fill("row prnu")
    page.wait_for_function(
        """[...document.querySelectorAll(".gp-row")].filter(one => one.offsetParent).length === 1"""
    )
    assert marked(page, "noise.row_prnu").is_visible()
    assert not marked(page, "group Scene").is_visible()
    page.locator('input[data-mark="search"]').fill(
        "luminance of white"
    )  # of the light, not of a camera's file
    page.locator('input[data-mark="luminance number"]').wait_for()
    page.locator('input[data-mark="search"]').fill("chart")
    marked(page, "group Scene").wait_for()
    page.locator('input[data-mark="search"]').fill("")
    marked(page, "optics.f_number").wait_for()
    page.close()


def test_automatic_settings_show_what_the_camera_chose(chromium, address):
    page = opened(chromium, address)
    box = page.locator('input[data-mark="sensor.exposure_time_ms number"]')
    page.wait_for_function(
        """document.querySelector('input[data-mark="sensor.exposure_time_ms number"]')
        .placeholder.startsWith("auto: ")"""
    )
    words = marked(page, "known").inner_text()
    chosen = float(box.get_attribute("placeholder").split()[1])
    assert f"exposure {chosen:.4g} ms" in words
    page.close()


def test_a_value_that_cannot_be_says_why_beside_its_control_and_freezes_nothing(chromium, address):
    page = opened(chromium, address)
    open_groups(page, ["Fixed patterns"])
    number(page, "noise.hot_pixels", 0.01)
    row = page.locator(".gp-row", has=page.locator('[data-mark="noise.hot_pixels"]'))
    row.get_by_text("wanted both").wait_for(timeout=10000)
    newer(page, number(page, "optics.f_number", 4))  # others work
    newer(page, number(page, "noise.hot_current_e_per_s", 1000))
    page.wait_for_function("""document.querySelector('[data-mark="error"]').innerText === ''""")
    assert page.locator('input[data-mark="noise.hot_pixels number"]').input_value() == "0.01"
    before = version(page)
    row.locator(".gp-name").dblclick()  # the file's value again
    newer(page, before)
    assert page.locator('input[data-mark="noise.hot_pixels number"]').input_value() == ""
    assert not page.errors
    page.close()


def test_a_text_is_typed_or_chosen(chromium, address):
    page = opened(chromium, address)
    open_groups(page, ["Sensor"])
    before = version(page)
    marked(page, "sensor.cfa choose").click()
    marked(page, "sensor.cfa = quad-bayer").click()
    newer(page, before)
    box = page.locator('input[data-mark="sensor.cfa text"]')
    assert box.input_value() == "quad-bayer"
    before = version(page)
    box.fill('["GB", "RG"]')
    box.press("Enter")
    newer(page, before)
    box.fill("moon")
    box.press("Enter")
    row = page.locator(".gp-row", has=box)
    row.get_by_text("moon").wait_for(timeout=10000)
    assert not page.errors
    page.close()


def test_cameras_are_kept_compared_and_listed(chromium, address):
    page = opened(chromium, address)
    keep(page, "bright")
    newer(page, number(page, "optics.f_number", 5.6))
    marked(page, "keep").click()
    page.locator('input[data-mark="keep name"]').fill("bright")
    marked(page, "keep it").click()
    page.get_by_text("'bright' is taken; choose another name").wait_for()
    page.keyboard.press("Escape")
    choose(page, "compare", "side by side")
    page.wait_for_function("document.querySelector('canvas').width === 640", timeout=20000)
    choose(page, "compare", "difference")
    page.wait_for_function("document.querySelector('canvas').width === 320", timeout=20000)
    choose(page, "compare", "blink")
    page.wait_for_timeout(2000)
    marked(page, "differences").click()
    table = marked(page, "difference table").inner_text()
    assert "f-number" in table and "5.6" in table and "bright" in table
    page.keyboard.press("Escape")
    marked(page, "history").click()
    steps = marked(page, "steps")
    assert "f-number 5.6" in steps.inner_text()
    marked(page, "step 0").click()
    page.wait_for_function(  # blinking makes newer pictures, too
        """document.querySelector('input[data-mark="optics.f_number number"]').value === '1.8'"""
    )
    assert not page.errors
    page.close()


def luminance(page):
    return page.evaluate(
        """getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)[0]"""
    )


def test_the_page_is_dark_or_light(chromium, address):
    page = opened(chromium, address)
    assert luminance(page) < 40
    marked(page, "contrast").click()
    page.wait_for_function("!document.body.classList.contains('body--dark')")
    assert luminance(page) > 230
    page.close()


@pytest.mark.parametrize("is_dark", [True, False])
def test_axe_finds_nothing_serious(chromium, address, is_dark):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="no axe")
    page = opened(chromium, address)
    if not is_dark:
        marked(page, "contrast").click()
    open_groups(page)
    found = axe.Axe().run(page).response["violations"]
    serious = [
        (one["id"], one["help"], [node["html"][:300] for node in one["nodes"][:3]])
        for one in found
        if one["impact"] in ("serious", "critical")
    ]
    assert not serious
    page.close()


def test_all_controls_have_names_and_are_reached_by_the_keyboard(chromium, address):
    page = opened(chromium, address)
    open_groups(page)
    reached = page.evaluate("""() => [...document.querySelectorAll(".gp-row, .gp-bar")].flatMap(
        row => [...row.querySelectorAll("input, button, [role=slider], [role=combobox], [role=switch]")]
    ).filter(one => one.offsetParent && !one.closest(".q-select") && (
        (one.tabIndex < 0 && !one.querySelector('[tabindex="0"]')) || !(
        one.ariaLabel || one.labels?.length || one.innerText || one.closest("[aria-label]"))))
    .map(one => one.outerHTML.slice(0, 200))""")
    assert not reached
    page.close()


@pytest.mark.slow
def test_every_control_is_moved(chromium, address):
    """Each control, one after the other: a newer picture or a reason beside it, and all others go on."""
    page = opened(chromium, address)
    open_groups(page)
    stuck = []
    for name, control in CONTROLS.items():
        before = version(page)
        if control.choices:
            marked(page, name).click()
            page.locator(".q-menu .q-item").last.click()
        elif control.is_text:
            box = page.locator(f'input[data-mark="{name} text"]')
            words = ["[1.0, 1.0]", *control.suggested]
            box.fill(next(word for word in reversed(words) if word != box.input_value()))
            box.press("Enter")
        else:
            slider = marked(page, name).locator("[tabindex]").first
            slider.focus()
            is_most = marked(page, name).get_attribute("aria-valuenow") == "1000"
            page.keyboard.press("ArrowLeft" if is_most else "ArrowRight")
            page.keyboard.press("PageDown" if is_most else "PageUp")
        try:
            newer(page, before)
        except Exception:
            stuck.append(name)
        error = marked(page, "error").inner_text()
        assert "fails" not in error and "Error" not in error, (name, error)
    newer(page, number(page, "sensor.exposure_time_ms", 3))
    assert not stuck and not page.errors
    page.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", [*SIZES, "light", "comparison"])
def test_pictures_of_the_page(chromium, tmp_path, name):
    """What docs/preview.md shows; PREVIEW_PICTURES=docs/pictures keeps them there."""
    with serving(
        "colorchecker",
        "--camera",
        "phone",
        "--size",
        "960x640",
        "--device",
        "opencl",
        folder=tmp_path,
    ) as (address, _):
        width, height = SIZES.get(name, (1600, 1000))
        page = opened(chromium, address, width=width, height=height)
        if name == "light":
            marked(page, "contrast").click()
        if name == "comparison":
            keep(page, "f/1.8")
            newer(page, number(page, "optics.f_number", 4))
            choose(page, "compare", "side by side")
        page.wait_for_timeout(3000)
        folder = Path(os.environ.get("PREVIEW_PICTURES", tmp_path))
        path = folder / f"preview-{name}.png"
        photograph(page, path)
        from PIL import Image

        with Image.open(path) as found:
            assert found.size == (width, height)
            assert np.asarray(found.convert("RGB")).std() > 10 and not page.errors

"""The preview in a browser: sliders, pictures, what is saved, clients that misbehave."""

import base64
import io
import json
import shlex
import subprocess
import sys
from urllib.parse import quote

import numpy as np
from browsers import SCENE, marked, newer, opened, serving, version
from PIL import Image


def number(page, name, value):
    """Type a number into a control's field."""
    before = version(page)
    field = page.locator(f'input[data-mark="{name} number"]')
    field.fill(str(value))
    field.press("Enter")
    return before


def open_group(page, name):
    page.get_by_text(name, exact=True).first.click()
    page.wait_for_timeout(400)


def keep(page, name=None):
    """Keep the camera as a snapshot, which is then compared with."""
    before = version(page)
    marked(page, "keep").click()
    if name:
        page.locator('input[data-mark="keep name"]').fill(name)
    marked(page, "keep it").click()
    newer(page, before)


def choose(page, name, word):
    """Choose from a menu."""
    before = version(page)
    marked(page, name).click()
    page.locator(".q-menu .q-item").get_by_text(word, exact=True).click()
    newer(page, before)


def text(page, name):
    return marked(page, name).inner_text()


def shown(page):
    """Pixels of the canvas, (rows, cols, 3)."""
    found = page.evaluate("""async () => {
        const canvas = document.querySelector("canvas"), copy = document.createElement("canvas");
        copy.width = canvas.width; copy.height = canvas.height;
        copy.getContext("2d").drawImage(canvas, 0, 0);
        return copy.toDataURL("image/png").split(",")[1];
    }""")
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(found))).convert("RGB"))


def test_a_slider_changes_the_picture_and_undo_takes_it_back(chromium, address):
    page = opened(chromium, address)
    before = number(page, "sensor.exposure_time_ms", 20)
    newer(page, before)
    bright = shown(page).mean()
    newer(page, number(page, "sensor.exposure_time_ms", 5))
    dark = shown(page).mean()
    assert dark < 0.8 * bright
    before = version(page)
    marked(page, "undo").click()
    newer(page, before)
    assert abs(shown(page).mean() - bright) < 0.05 * bright
    assert page.locator('input[data-mark="sensor.exposure_time_ms number"]').input_value() == "20"
    before = version(page)
    page.keyboard.press("Control+y")
    newer(page, before)
    assert abs(shown(page).mean() - dark) < 0.05 * dark
    slider = page.locator('[data-mark="optics.f_number"]')
    slider.locator("[tabindex]").first.focus()
    before = version(page)
    page.keyboard.press("ArrowRight")
    newer(page, before)
    assert not page.errors
    page.close()


def test_settings_that_cannot_be_keep_the_picture_and_say_why(chromium, address):
    page = opened(chromium, address)
    number(page, "optics.f_number", -3)
    marked(page, "error").filter(has_text="f-number").wait_for(timeout=10000)
    assert shown(page).std() > 10  # the last good picture
    assert (
        "f-number"
        in page.locator(".q-field__messages").filter(has_text="f-number").first.inner_text()
    )
    newer(page, number(page, "optics.f_number", 4))
    page.wait_for_function("""document.querySelector('[data-mark="error"]').innerText === ''""")
    page.close()


def test_what_is_shown_is_what_the_saved_camera_makes(chromium, address, tmp_path):
    """Bit for bit in raw: the frame that stands still, its camera and the command line beside it."""
    page = opened(chromium, address)
    open_group(page, "Aberrations")
    for name, value in (
        ("optics.f_number", 2.8),
        ("sensor.exposure_time_ms", 30),
        ("optics.zernike_waves.10", 0.1),
    ):
        newer(page, number(page, name, value))
    open_group(page, "Noise")
    newer(page, number(page, "noise.read_e", 7))
    before = version(page)
    marked(page, "live").click()
    newer(page, before)
    page.wait_for_function("gpusimPainted.at(-1)[3] === 1")  # without loss
    still = shown(page)
    for entry, name in (
        ("save camera", "camera.toml"),
        ("save .npz", "shown.npz"),
        ("save .png", "shown.png"),
    ):
        marked(page, "save").click()
        with page.expect_download(timeout=30000) as download:
            marked(page, entry).click()
        download.value.save_as(tmp_path / name)
    assert np.array_equal(np.asarray(Image.open(tmp_path / "shown.png")), still)
    marked(page, "save").click()
    marked(page, "show link").click()
    command = marked(page, "command").locator("code").inner_text()
    link = marked(page, "link").locator("code").inner_text().splitlines()[0]
    program, *arguments = shlex.split(command)
    assert program == "gpusim" and arguments[-2:] == ["-o", "frame.npz"]
    subprocess.run(
        [sys.executable, "-m", program, *arguments], cwd=tmp_path, check=True, capture_output=True
    )
    made = tmp_path / "frame.npz"
    with np.load(made) as own, np.load(tmp_path / "shown.npz") as saved:
        assert {*own} == {*saved}
        for part in own:
            assert np.array_equal(own[part], saved[part]), part
    other = opened(chromium, link)
    other.wait_for_function(
        "gpusimPainted.length > 0 && gpusimPainted.at(-1)[3] === 1", timeout=20000
    )
    assert np.array_equal(shown(other), still)
    for one in (page, other):
        assert not one.errors
        one.close()


def test_every_view_is_shown(chromium, address):
    page = opened(chromium, address)
    seen = []
    for key in "123456":
        before = version(page)
        page.locator("body").press(key)
        if key != "1":
            newer(page, before)
        page.wait_for_timeout(300)
        seen.append(shown(page).astype(float))
    assert abs(seen[3].mean() - 127) < 8 and seen[3].std() > 5  # noise about its mean
    assert all(one.std() > 5 for one in seen[1:])
    page.close()


def test_numbers_of_the_light_are_in_sight(chromium, address):
    page = opened(chromium, address)
    box = page.locator("canvas").bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    marked(page, "pixel").filter(has_text="SNR").wait_for(timeout=10000)
    assert (
        " e-" in text(page, "pixel")
        and "predicted error" in text(page, "known")
        and "fps" in text(page, "known")
    )
    assert "left out" in text(page, "left out")
    assert marked(page, "panel histogram").locator("polyline").count() == 3
    page.close()


def pointed(page, down, right):
    """A place of the page over a part of the picture."""
    box = marked(page, "overlay").bounding_box()
    return box["x"] + right * box["width"], box["y"] + down * box["height"]


def still(page):
    """The picture as it is without loss, of newer settings than at the last call, when it stands still."""
    seen = getattr(page, "seen", -1)
    page.wait_for_function(
        f"gpusimPainted.at(-1)[3] === 1 && gpusimPainted.at(-1)[2] > {seen}", timeout=20000
    )
    page.wait_for_timeout(400)
    page.seen = version(page)
    return shown(page)


def test_a_part_is_shown_without_loss_and_moved(chromium, address):
    page = opened(chromium, address)
    before = version(page)
    marked(page, "live").click()
    newer(page, before)
    whole = still(page)
    page.mouse.move(*pointed(page, 0.5, 0.5))
    page.keyboard.press("+")
    part = still(page)
    rows, cols = part.shape[:2]
    width = page.evaluate(
        "Math.round(document.querySelector('canvas').clientWidth * devicePixelRatio)"
    )
    times = next(times for times in (1, 2, 4, 8, 16) if times * 320 > width)
    assert cols == round(width / times)

    def places(cut):
        return [
            (y, x)
            for y in range(200 - rows + 1)
            for x in range(320 - cols + 1)
            if np.array_equal(whole[y : y + rows, x : x + cols], cut)
        ]

    [(top, left)] = places(part)
    assert (
        abs(top - (200 - rows) / 2) <= 2 and abs(left - (320 - cols) / 2) <= 2
    )  # around the pointer
    page.mouse.down()
    page.mouse.move(*pointed(page, 0.5 - 10.5 / rows, 0.5 - 6.5 / cols), steps=4)
    page.mouse.up()
    [(down, right)] = places(still(page))
    assert (down - top, right - left) in {(10, 6), (11, 7), (10, 7), (11, 6)}
    page.keyboard.press("-")
    assert np.array_equal(still(page), whole)
    assert not page.errors


def test_an_edge_is_measured_where_it_is_dragged_over(chromium, tmp_path):
    with serving(
        "slanted-edge",
        "--camera",
        "mono",
        "--size",
        "320x240",
        "--device",
        "opencl",
        folder=tmp_path,
    ) as (address, _):
        page = opened(chromium, address)
        marked(page, "panels").click()
        marked(page, "open mtf").click()
        page.keyboard.press("Escape")
        marked(page, "measure").click()
        for corner, words in ((0.02, "sfr:"), (0.3, "MTF50")):
            page.mouse.move(*pointed(page, corner, corner))
            page.mouse.down()
            page.mouse.move(
                *pointed(page, 0.15 if corner < 0.1 else 0.7, 0.15 if corner < 0.1 else 0.7),
                steps=4,
            )
            page.mouse.up()
            marked(page, "panel mtf").filter(has_text=words).wait_for(timeout=20000)
        assert marked(page, "overlay").locator("svg rect").count() == 1 and not page.errors


def test_two_cameras_stand_side_by_side(chromium, address):
    page = opened(chromium, address)
    newer(page, number(page, "sensor.exposure_time_ms", 20))
    before = version(page)
    marked(page, "live").click()
    newer(page, before)
    first = still(page)
    keep(page)
    newer(page, number(page, "optics.f_number", 5.6))
    both = still(page)
    assert np.array_equal(both[:, 165:], first[:, 165:]) and (both[:, 159:161] == 255).all()
    assert both[:, :155].mean() < 0.5 * first[:, :155].mean()  # at f/5.6 a tenth of the light
    marked(page, "swap").click()
    swapped = still(page)
    assert np.array_equal(swapped[:, :155], first[:, :155])
    marked(page, "drop").click()
    assert np.array_equal(still(page), first)
    assert not page.errors


def test_the_error_is_mapped(chromium, address):
    page = opened(chromium, address)
    marked(page, "error map").click()
    dialog = marked(page, "error dialog").filter(has_text=" rms, ")
    dialog.wait_for(timeout=60000)
    assert not page.errors
    page.wait_for_function(
        "document.querySelector('[data-mark=\"error dialog\"] img').naturalWidth === 320"
    )


def test_a_scene_that_moves_is_played_paused_and_stepped(chromium, tmp_path):
    with serving(*SCENE, "--frames", "8", "--pan", "0,60", "--zoom", "1.3", folder=tmp_path) as (
        address,
        _,
    ):
        page = opened(chromium, address)
        page.wait_for_function(
            "new Set(gpusimPainted.map(one => one[1])).size === 8"
        )  # all frames, again and again
        before = version(page)
        marked(page, "live").click()
        newer(page, before)
        still(page)
        at = page.evaluate("gpusimPainted.at(-1)[1]")
        marked(page, "skip_next").click()
        following = still(page)
        assert page.evaluate("gpusimPainted.at(-1)[1]") == (at + 1) % 8
        page.keyboard.press(",")
        other = still(page)
        assert page.evaluate("gpusimPainted.at(-1)[1]") == at and not np.array_equal(
            following, other
        )
        page.keyboard.press(".")
        assert np.array_equal(still(page), following)
        assert not page.errors


def test_clients_have_their_own_cameras(chromium, address):
    one, other = (opened(chromium, address) for _ in range(2))
    newer(one, number(one, "sensor.exposure_time_ms", 1))
    newer(other, number(other, "sensor.exposure_time_ms", 40))
    assert shown(one).mean() < 0.5 * shown(other).mean()
    again = opened(
        chromium, one.url
    )  # the same address is the same client, as after a connection was lost
    assert abs(shown(again).mean() - shown(one).mean()) < 3
    one.context.set_offline(True)
    one.wait_for_timeout(500)
    one.context.set_offline(False)
    before = one.evaluate("gpusimPainted.at(-1)[0]")
    one.wait_for_function(f"gpusimPainted.at(-1)[0] > {before} + 500", timeout=20000)
    for page in (one, other, again):
        page.close()


def test_links_of_strangers_are_refused_in_a_line(chromium, address):
    page = chromium.new_page()
    for link in (
        "{",
        json.dumps({"view": "moon"}),
        json.dumps({"changes": {"optics.secret": 1}}),
        "[" * 9000,
    ):
        page.goto(f"{address}/?state={quote(link)}")
        page.get_by_text("link: not one of this preview's").wait_for(timeout=10000)
    page.close()

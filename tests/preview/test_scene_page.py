"""Scenes in a browser: menus, files by drag and drop, the filmstrip, links that ask for files."""

import hashlib
import shlex
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from browsers import marked, newer, opened, version
from PIL import Image
from test_page import shown

import gpusim as gs

NUMBER = 'input[data-mark="optics.object_distance_m number"]'
LAMP = b"wavelength_nm,power\n400,1\n550,3\n700,2\n"


@pytest.fixture(scope="module")
def photo(tmp_path_factory):
    path = tmp_path_factory.mktemp("photo") / "photo.png"
    codes = np.random.default_rng(3).integers(0, 255, (90, 120, 3), np.uint8)
    Image.fromarray(codes).save(path)
    return path


def choose(page, name, item):
    """Choose an item of a menu, and wait for its picture."""
    before = version(page)
    marked(page, name).click()
    page.locator(".q-menu .q-item").filter(has_text=item).first.click()
    newer(page, before)


def size(page):
    """Columns and rows of the canvas."""
    return page.evaluate(
        "(([one]) => [one.width, one.height])(document.querySelectorAll('canvas'))"
    )


def send(page, name, *paths):
    """Choose files for a receiver."""
    page.locator(f'[data-mark="{name}"] input[type=file]').set_input_files(
        [str(path) for path in paths]
    )


def drop(page, path):
    """Drop a file on the picture."""
    data = page.evaluate_handle(
        """([name, bytes]) => {
            const data = new DataTransfer();
            data.items.add(new File([new Uint8Array(bytes)], name));
            return data;
        }""",
        [path.name, [*path.read_bytes()]],
    )
    marked(page, "overlay").dispatch_event("drop", {"dataTransfer": data})


def wait_for_size(page, cols, rows):
    page.wait_for_function(
        f"document.querySelector('canvas').width === {cols} && document.querySelector('canvas').height === {rows}",
        timeout=20000,
    )


def still(page):
    """Let the noise stand still, and return the picture without loss."""
    before = version(page)
    marked(page, "live").click()
    newer(page, before)
    page.wait_for_function("gpusimPainted.at(-1)[3] === 1", timeout=20000)
    page.wait_for_timeout(300)
    return shown(page)


def show_links(page):
    """Open the dialog with link, command and cell, and return the three."""
    marked(page, "save").click()
    marked(page, "show link").click()
    codes = [marked(page, name).locator("code") for name in ("link", "command", "cell")]
    codes[0].wait_for()
    return [code.inner_text() for code in codes]


def test_menus_and_the_filmstrip_change_the_scene(chromium, address):
    page = opened(chromium, address)
    choose(page, "scene", "deadleaves")
    assert size(page) == [320, 200]
    choose(page, "size", "640x480")
    wait_for_size(page, 640, 480)
    marked(page, "recent 2").wait_for()
    before = version(page)
    marked(page, "recent 0").click()
    newer(page, before)
    wait_for_size(page, 320, 200)
    assert marked(page, "scene").locator("input").input_value() == "colorchecker"
    marked(page, "undo").click()
    wait_for_size(page, 640, 480)
    assert marked(page, "scene").locator("input").input_value() == "deadleaves"
    # the pointer finds the pixels of the new frame
    page.wait_for_timeout(1000)  # the picture takes its shape
    box = marked(page, "overlay").bounding_box()
    page.mouse.move(box["x"] + 0.99 * box["width"], box["y"] + 0.99 * box["height"])
    marked(page, "pixel").filter(has_text="column 63").wait_for(timeout=10000)
    assert not page.errors
    page.close()


@pytest.mark.slow
def test_files_are_dropped_sent_and_refused(chromium, address, photo, tmp_path):
    page = opened(chromium, address)
    drop(page, photo)
    wait_for_size(page, 120, 90)
    assert "photo.png" in marked(page, "scene").locator("input").input_value()
    for name, data, words in (
        ("notes.txt", b"words", "notes.txt: allowed are .exr"),
        ("bad.png", b"no picture", "bad.png: cannot be read: not a PNG"),
        ("cube.npy", None, "cube.npy: an array has no wavelengths"),
    ):
        path = tmp_path / name
        if data is None:
            np.save(path, np.random.default_rng(4).random((4, 20, 30)))
        else:
            path.write_bytes(data)
        send(page, "scene file", path)
        page.get_by_text(words).first.wait_for(timeout=10000)
        assert size(page) == [120, 90]  # the last picture
    field = page.locator('input[data-mark="option wavelengths"]')  # its group opens by itself
    field.fill("400:700")
    field.press("Enter")
    page.get_by_text("wavelengths [nm] = '400:700': wanted FIRST:LAST:STEP").wait_for()
    field.fill("400:700:100")
    field.press("Enter")
    wait_for_size(page, 30, 20)
    assert not page.errors
    page.close()


@pytest.mark.slow
def test_a_click_focuses_on_what_is_there(chromium, address, tmp_path):
    """Left .5 m, right 4 m: a click sets the focus to the distance under it. Without depth it enlarges."""
    page = opened(chromium, address)
    switch = marked(page, "pick focus")
    assert not switch.is_visible()  # the scene has no depth
    depth = np.full((120, 160), 4.0)
    depth[:, :80] = 0.5
    chart = gs.chart("deadleaves", size=(160, 120), wavelengths=[450, 550, 650])
    gs.save_scene(replace(chart, depth=depth), tmp_path / "deep.npz")
    send(page, "scene file", tmp_path / "deep.npz")
    wait_for_size(page, 160, 120)
    switch.wait_for()
    switch.click()
    page.wait_for_timeout(1000)  # the picture takes its shape
    box = marked(page, "overlay").bounding_box()
    for part, distance in ((0.25, 0.5), (0.75, 4.0)):
        before = version(page)
        page.mouse.click(box["x"] + part * box["width"], box["y"] + 0.5 * box["height"])
        newer(page, before)
        page.wait_for_function(f"document.querySelector('{NUMBER}').value == {distance}")
        assert size(page) == [160, 120], "a click does not enlarge while it focuses"
    choose(page, "scene", "colorchecker")
    switch.wait_for(state="hidden")
    whole = size(page)
    page.mouse.click(box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
    page.wait_for_function(f"document.querySelector('canvas').width < {whole[0]}")
    assert not page.errors
    page.close()


@pytest.mark.slow
def test_the_light_is_a_name_a_temperature_or_a_file(chromium, address, tmp_path):
    page = opened(chromium, address)
    page.get_by_text("Light", exact=True).click()
    page.wait_for_timeout(400)
    (tmp_path / "lamp.csv").write_bytes(LAMP)
    before = version(page)
    kelvin = page.locator('input[data-mark="temperature"]')
    kelvin.fill("2500")
    kelvin.press("Enter")
    newer(page, before)
    name = page.locator('input[data-mark="light"]')
    assert name.input_value() == "blackbody-2500K"
    before = version(page)
    send(page, "lamp file", tmp_path / "lamp.csv")
    newer(page, before)
    assert name.input_value() == "lamp.csv"
    assert hashlib.sha256(LAMP).hexdigest() in show_links(page)[0]
    assert not page.errors
    page.close()


def test_a_link_asks_for_its_file_where_it_is_opened(chromium, address, photo, tmp_path):
    """Another hash is refused, also of a file with the same name; then the picture is the same."""
    page = opened(chromium, address)
    send(page, "scene file", photo)
    wait_for_size(page, 120, 90)
    own = still(page)
    link, command, cell = show_links(page)
    sha = hashlib.sha256(photo.read_bytes()).hexdigest()
    assert link.startswith(f"{address}/?state=") and sha in cell and "photo.png" in command
    other = chromium.new_page()
    other.goto(link)
    marked(other, "wanted").filter(has_text=sha).wait_for(timeout=10000)
    Image.new("RGB", (120, 90)).save(tmp_path / "photo.png")
    send(other, "scene file", tmp_path / "photo.png")
    other.get_by_text("this is another file").wait_for(timeout=10000)
    send(other, "scene file", photo)
    other.wait_for_function(
        "window.gpusimPainted && gpusimPainted.some(one => one[3] === 1)", timeout=20000
    )
    other.wait_for_timeout(300)
    assert np.array_equal(shown(other), own) and not marked(other, "wanted").is_visible()
    assert not page.errors
    for one in (page, other):
        one.close()


@pytest.mark.slow
def test_the_command_makes_the_frame_that_is_saved(chromium, address, tmp_path):
    """As it is written on the page, in a folder with the camera that the page saves, bit for bit."""
    page = opened(chromium, address)
    choose(page, "scene", "slanted-edge")
    still(page)
    for entry, name in (
        ("save camera", "camera.toml"),
        ("save .npz", "saved.npz"),
        ("save report", "report.txt"),
    ):
        marked(page, "save").click()
        with page.expect_download(timeout=30000) as download:
            marked(page, entry).click()
        download.value.save_as(tmp_path / name)
    assert "slanted-edge" in (tmp_path / "report.txt").read_text()
    words = shlex.split(show_links(page)[1])
    assert words[0] == "gpusim" and "320x200" in words
    subprocess.run([sys.executable, "-m", *words], cwd=tmp_path, check=True, capture_output=True)
    with np.load(tmp_path / "frame.npz") as made, np.load(tmp_path / "saved.npz") as saved:
        assert {*made} == {*saved}
        for part in made:
            assert np.array_equal(made[part], saved[part]), part
    page.close()

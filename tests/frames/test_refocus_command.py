"""`gpusim refocus` and its page: the pictures of the functions, one-line errors, and a slider in a browser."""

import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from textured_views import Waves, made_views, plane_views, thin_lens_slope

import gpusim as gs
from gpusim.apps.refocus_page import MOST_BYTES, codes_of, refocus_page
from gpusim.cli.main import main
from gpusim.domain.errors import BadFile

NEAR = 0.4  # [m]


@pytest.fixture(scope="module")
def views():
    values = plane_views(Waves(np.random.default_rng(3)), thin_lens_slope(NEAR), (4, 3), (40, 56))
    return made_views(100 * values, name="a <b>wall</b>")


@pytest.fixture
def stored(views, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    gs.save_views(views, "views.npz")
    return tmp_path


def test_views_come_back(views, stored):
    assert gs.open_views("views.npz").light is None
    views = replace(views, light=[[1.0, 0.5, 1]] * 4)
    gs.save_views(views, "views.npz")
    back = gs.open_views("views.npz")
    assert np.array_equal(back.values, views.values) and np.array_equal(back.light, views.light)
    for key in (
        "slope_per_diopter",
        "object_distance",
        "focal_length",
        "f_number",
        "extent",
        "name",
    ):
        assert getattr(back, key) == getattr(views, key)
    np.savez("short.npz", values=views.values)
    with pytest.raises(BadFile, match="lacks slope_px_per_radius_diopter"):
        gs.open_views("short.npz")


def test_files_have_the_pictures_of_the_functions(views, stored):
    command = "refocus views.npz --device numpy"
    assert main(f"{command} -o a.npy --distance {NEAR} --aperture 0.7".split()) == 0
    wanted = gs.refocus(views, distance=NEAR, aperture=0.7, device="numpy")
    assert np.array_equal(np.load("a.npy"), wanted)
    assert main(f"{command} -o a.png --slope 1 --white 150".split()) == 0
    codes = codes_of(gs.refocus(views, slope=1.0, device="numpy"), 150)
    assert np.array_equal(np.asarray(Image.open("a.png")), codes)
    # sRGB of the mean, 100 of 150, by its definition
    assert np.median(codes) == pytest.approx(255 * (1.055 * (2 / 3) ** (1 / 2.4) - 0.055), abs=12)
    assert main(f"{command} -o b.npy --all-in-focus --depth d.npz --range 0.3,0.8".split()) == 0
    depth = gs.depth_from_views(views, distances=(0.3, 0.8), device="numpy")
    assert np.array_equal(np.load("d.npz")["distance_m"], depth.distance)
    assert np.median(np.load("d.npz")["distance_m"]) == pytest.approx(NEAR, rel=0.02)
    picture = gs.all_in_focus(views, depth, distances=(0.3, 0.8), device="numpy")
    assert np.array_equal(np.load("b.npy"), picture)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("", "no output"),
        ("-o a.gif", "output format"),
        ("-o a.png --distance 1 --slope 2", "--slope: --distance is given too"),
        ("-o a.png --distance 1 --all-in-focus", "its own distance"),
        ("-o a.png --range 1,2", "--range"),
        ("--depth d.npz --slope 2", "--slope: it is of -o"),
        ("--depth d.npz --all-in-focus", "--all-in-focus: it is of -o"),
        ("--depth d.npz --aperture 0.5", "--aperture: it is of -o and --page"),
        ("-o a.npy --white 2", "--white"),
        ("--page p.png", "format of a page"),
        ("--page p.html --range 2,2.000001 --aperture 0.01", "one cell"),
        ("-o absent/../views.npz/a.png", "cannot be written"),
    ],
)
def test_mistakes_are_one_line(stored, capsys, options, words):
    assert main(f"refocus views.npz --device numpy {options}".split()) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and words in said
    assert main(["refocus", "absent.npz", "-o", "a.png"]) == 2
    assert "no such file" in capsys.readouterr().err


def test_the_page_is_one_small_file(views):
    page = refocus_page(views, white=200.0, device="numpy")
    assert len(page) < MOST_BYTES
    assert not re.search(r"(src|href)=\"(?!data:)", page) and "<b>wall" not in page
    noise = np.random.default_rng(1).random((1, 2, 700, 900, 3), np.float32)
    large = refocus_page(made_views(noise, name="noise"), white=1.0, device="opencl")
    assert len(large) < MOST_BYTES


def test_the_slider_changes_the_picture(stored):
    playwright = pytest.importorskip("playwright.sync_api")
    found = next(filter(None, map(shutil.which, ("chromium", "google-chrome"))), None)
    if found is None:
        pytest.skip("no Chromium")
    assert main("refocus views.npz --device numpy --page page.html --range 0.3,1".split()) == 0
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=found, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 390, "height": 700})
        errors: list = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto((stored / "page.html").as_uri())
        slider, picture = page.get_by_label("Distance in focus"), page.locator("img")
        seen = set()
        for key in ("Home", "ArrowRight", "End"):
            slider.focus()
            page.keyboard.press(key)
            text = slider.get_attribute("aria-valuetext")
            assert page.locator("output").inner_text() == text
            assert picture.get_attribute("alt") == f"a <b>wall</b>, focused at {text}"
            seen.add((text, picture.get_attribute("src")))
            assert page.evaluate("document.querySelector('img').naturalWidth") == 56
        assert len(seen) == 3 and not errors
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        browser.close()

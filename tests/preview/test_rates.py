"""How fast the preview is, seen from the browser: 1280x720 on two processor cores."""

import faulthandler

import numpy as np
import pytest
from browsers import browser, marked, opened, serving

pytestmark = pytest.mark.slow
SECONDS, MOVES, MINUTES = 6, 20, 10
# control -> least pictures a second while it is moved, most milliseconds from a move to its picture: median, 95 %
MOVED = {
    "noise.read_e": (30, 90, 160),
    "sensor.exposure_time_ms": (30, 90, 160),
    "optics.f_number": (12, 180, 280),
    "optics.defocus_um": (12, 180, 280),
    "optics.object_distance_m": (12, 180, 280),
    "processor.denoise": (30, 90, 160),
    "optics.zernike_waves.7": (12, 180, 280),
}
MISSED = {
    "processor.denoise": "non-local means take 20 ms of both cores: about 17 fps",
    "optics.zernike_waves.7": "tables of a lens that is not the same at every angle take 200 ms: about 4 fps",
}


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("preview")
    with (
        browser() as chromium,
        serving(
            "deadleaves",
            "--camera",
            "phone",
            "--size",
            "1280x720",
            "--exposure",
            "20ms",
            "--device",
            "opencl",
            folder=folder,
        ) as (address, _),
    ):
        made = opened(chromium, address)
        made.wait_for_timeout(3000)
        for group in ("Noise", "Processor"):
            made.get_by_text(group, exact=True).first.click()
        made.wait_for_timeout(1000)
        yield made
        made.close()


def painted(page):
    """Times [ms], numbers, versions and kinds of what was painted last, (n, 4)."""
    return np.array(page.evaluate("gpusimPainted"), float)


def test_live_noise(page):
    first = len(painted(page))
    page.wait_for_timeout(1000 * SECONDS)
    found = painted(page)[first:, 0]
    rate = 1e3 * (len(found) - 1) / np.ptp(found)
    print(
        f"live noise: {rate:.1f} fps, 95 % of the gaps below {np.percentile(np.diff(found), 95):.0f} ms"
    )
    assert rate >= 30


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.xfail(reason=MISSED[name], strict=True))
        if name in MISSED
        else name
        for name in MOVED
    ],
)
def test_a_moved_slider(page, name):
    """Keys that move it, one every 30 ms, and the pictures meanwhile; then single moves, each until it is seen."""
    least, median, most = MOVED[name]
    slider = marked(page, name)
    slider.scroll_into_view_if_needed()
    slider.locator("[tabindex]").first.focus()
    first, versions = len(painted(page)), painted(page)[-1, 2]
    for k in range(int(SECONDS / 0.03)):
        page.keyboard.press("ArrowRight" if k % 40 < 20 else "ArrowLeft")
        page.wait_for_timeout(25)
    found = painted(page)[first:]
    rate, changes = 1e3 * (len(found) - 1) / np.ptp(found[:, 0]), len({*found[:, 2]} - {versions})
    waits = []
    for k in range(MOVES):
        page.wait_for_timeout(400 + 13 * k)
        before, now = painted(page)[-1, 2], page.evaluate("performance.now()")
        page.keyboard.press("ArrowRight")
        page.wait_for_function(f"gpusimPainted.at(-1)[2] > {before}", timeout=10000, polling="raf")
        seen = painted(page)
        waits.append(seen[seen[:, 2] > before][0, 0] - now)
    print(
        f"{name}: {rate:.1f} fps of {changes} settings, a move is seen after {np.median(waits):.0f} ms, 95 % "
        f"{np.percentile(waits, 95):.0f} ms"
    )
    assert rate >= least and changes / SECONDS >= min(least, 12)
    assert np.median(waits) <= median and np.percentile(waits, 95) <= most


def test_memory_is_flat(tmp_path):
    """Ten minutes of sliding, in turn over exposure, lens and noise: after the first two the server stays as it is."""
    faulthandler.cancel_dump_traceback_later()  # it takes longer than a test that hangs may
    with (
        browser() as chromium,
        serving(
            "deadleaves",
            "--camera",
            "phone",
            "--size",
            "640x360",
            "--exposure",
            "20ms",
            "--device",
            "opencl",
            folder=tmp_path,
        ) as (address, process),
    ):
        made = opened(chromium, address)
        made.get_by_text("Noise", exact=True).first.click()
        used = []
        for _ in range(MINUTES):
            for name in (
                "sensor.exposure_time_ms",
                "optics.f_number",
                "optics.defocus_um",
                "noise.read_e",
            ):
                marked(made, name).scroll_into_view_if_needed()
                marked(made, name).locator("[tabindex]").first.focus()
                made.evaluate("""() => {
                    const slider = document.activeElement;
                    let k = 0;
                    window.sliding = setInterval(() => {
                        const keyCode = k++ % 80 < 40 ? 39 : 37;
                        for (const type of ["keydown", "keyup"])
                            slider.dispatchEvent(new KeyboardEvent(type, { keyCode, bubbles: true, cancelable: true }));
                    }, 50);
                }""")
                made.wait_for_timeout(15_000)
                made.evaluate("clearInterval(sliding)")
            with open(f"/proc/{process.pid}/statm") as file:
                used.append(int(file.read().split()[1]) * 4096 / 2**20)
        print("MiB after each minute:", np.round(used))
        assert len(painted(made)) > 100
        assert used[-1] - used[1] <= 0.03 * used[1]
        made.close()

"""A preview's server as a process of its own, and a browser to look at it."""

import os
import shutil
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from urllib.error import URLError
from urllib.request import urlopen

import pytest

SCENE = ["colorchecker", "--camera", "phone", "--size", "320x200", "--device", "opencl"]


def free_port() -> int:
    """A port that nobody listens at."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextmanager
def serving(*arguments, folder=None):
    """Address of a preview that runs."""
    port = free_port()
    own = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTEST", "NICEGUI"))
    }
    command = [sys.executable, "-m", "gpusim", "preview", *map(str, arguments), "--port", str(port)]
    with running(command, f"http://127.0.0.1:{port}", env=own, cwd=folder) as process:
        yield f"http://127.0.0.1:{port}", process


@contextmanager
def running(command, address, **options):
    """A process that serves an address. options: of Popen."""
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True} | options
    process = subprocess.Popen(command, **options)
    try:
        for _ in range(600):
            if process.poll() is not None:
                raise AssertionError(process.communicate()[0])
            try:
                urlopen(address, timeout=5).close()
                break
            except (URLError, ConnectionError, TimeoutError):
                time.sleep(0.1)
        yield process
    finally:
        process.terminate()
        process.wait(20)


@contextmanager
def browser():
    """A Chromium by Playwright: its own, or that of the system; a skip where there is neither."""
    playwright = pytest.importorskip("playwright.sync_api", reason="no Playwright")
    with playwright.sync_playwright() as started:
        found = started.chromium.executable_path
        path = (
            found
            if os.path.exists(found)
            else shutil.which("chromium") or shutil.which("google-chrome")
        )
        if path is None:
            pytest.skip("no Chromium: neither Playwright's own nor a system's")
        made = started.chromium.launch(executable_path=path, args=["--no-sandbox"])
        try:
            yield made
        finally:
            made.close()


def opened(chromium, address, **size):
    """A page on which a picture has been painted; its messages of errors are kept in `errors`."""
    page = chromium.new_page(viewport={"width": 1500, "height": 1000} | size)
    page.errors = []
    page.on("pageerror", lambda error: page.errors.append(str(error)))
    page.goto(address)
    page.wait_for_function("window.gpusimPainted && gpusimPainted.length > 0", timeout=60000)
    return page


def photograph(page, path):
    """Keep a picture of the page, with 128 colours: small enough for docs."""
    from PIL import Image

    page.screenshot(path=path)
    with Image.open(path) as found:
        small = found.convert("P", palette=Image.Palette.ADAPTIVE, colors=128)
        small.save(path, optimize=True)


def version(page) -> int:
    """Of the settings of the last picture that was painted."""
    return page.evaluate("gpusimPainted.at(-1)[2]")


def marked(page, name):
    """An element by the mark that the page gives it."""
    return page.locator(f'[data-mark="{name}"]')


def newer(page, than, timeout=20000):
    """Wait for a picture of other settings."""
    page.wait_for_function(f"gpusimPainted.at(-1)[2] > {than}", timeout=timeout)

"""Tests of the host's mathematics: no kernel runs and no device is opened here, so that they answer within a minute."""

from pathlib import Path

import pytest

from gpusim.backends import opencl, probe, warp


def pytest_collection_modifyitems(items):
    """All of them are part of the quick tier, first of all; those that are slow are not."""
    for item in items:
        if item.path.is_relative_to(Path(__file__).parent) and not item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.quick)


@pytest.fixture(scope="module", autouse=True)  # before any other fixture of the file
def no_device():
    """A device that is opened, used (others may have left one open) or probed fails the test."""

    def refuse(*_, **__):
        raise AssertionError(
            "tests/host works without devices: device='numpy', or this test belongs elsewhere"
        )

    with pytest.MonkeyPatch.context() as patch:
        for device in (opencl.OpenCLDevice, warp.WarpDevice):
            patch.setattr(device, "__init__", refuse)
            patch.setattr(device, "__getattribute__", refuse, raising=False)
        patch.setattr(probe, "_run", refuse)
        yield

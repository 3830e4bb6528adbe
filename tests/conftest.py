import os
from pathlib import Path

import pytest
from budget import budgeted
from measured import SHARED_DATA

DATA = Path(__file__).parent / "data"


# PoCL and OpenBLAS of every worker take all processors: here they share them. PoCL two, so that work-groups meet.
if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    share = (os.cpu_count() or 1) // int(os.environ["PYTEST_XDIST_WORKER_COUNT"])
    os.environ.setdefault("POCL_MAX_PTHREAD_COUNT", str(max(2, share)))
    os.environ.setdefault(
        "OPENBLAS_NUM_THREADS", str(max(1, share))
    )  # read when NumPy is loaded, which is later


@pytest.fixture(scope="session")
def data():
    """Reference numbers that belong to the tests; data/README.md names their sources."""
    return DATA


@pytest.fixture(scope="session")
def shared_data():
    """Pictures and spectral cubes that are too large, or not free, to be part of the project."""
    if not SHARED_DATA.is_dir():
        pytest.skip(f"no folder {SHARED_DATA} with measured scenes")
    return SHARED_DATA


pytest_runtest_setup = pytest.hookimpl(wrapper=True)(budgeted)
pytest_runtest_call = pytest.hookimpl(wrapper=True)(budgeted)

# Whole frames run on one CPU device by default. On the others they are slow tests, but for the files that compare
# devices: stages, updates and outputs are the same on all of them, and so are frames (tests/golden.py).
ON_ALL_DEVICES = (
    "test_batches",
    "test_outputs",
    "test_random_order",
    "test_simulate",
    "test_updates",
)
OTHERS = ("warp:cpu", "numpy")


def pytest_collection_modifyitems(items):
    """Mark whole frames on a second CPU device as slow, if the first one is tested too."""
    named = {}
    for item in items:
        params = getattr(item, "callspec", None)
        if params is not None and "frames" in item.path.parts:
            rest = tuple(part for part in params.id.split("-") if part not in (*OTHERS, "opencl:0"))
            named.setdefault((item.path, item.originalname, rest), []).append(item)
    for (path, *_), same in named.items():
        devices = {item: [str(one) for one in item.callspec.params.values()] for item in same}
        if path.stem in ON_ALL_DEVICES or not any("opencl:0" in one for one in devices.values()):
            continue
        for item, parts in devices.items():
            if any(other in parts for other in OTHERS):
                item.add_marker("slow")

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

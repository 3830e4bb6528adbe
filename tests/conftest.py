from pathlib import Path

import pytest

DATA = Path(__file__).parent / "data"
SHARED_DATA = Path(__file__).parents[1].parent / "shared" / "data"


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

"""A browser, and a preview that tests of one file share."""

import pytest
from browsers import SCENE, browser, serving


@pytest.fixture(scope="module")
def chromium():
    with browser() as made:
        yield made


@pytest.fixture(scope="module")
def address(tmp_path_factory, chromium):
    with serving(*SCENE, folder=tmp_path_factory.mktemp("preview")) as (found, _):
        yield found

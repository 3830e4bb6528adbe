"""Fits of optics and colour judged with other mosaics than Bayer's, see test_optics_of_fits.py."""

import numpy as np
import pytest
from test_optics_of_fits import judge_color, judge_distortion, judge_sharpness

X_TRANS = ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG")
QUAD = ("RRGG", "RRGG", "GGBB", "GGBB")
RCCB, RYYB, CYGM, MONO = ("RW", "WB"), ("RY", "YB"), ("CY", "GM"), ("Y",)

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("seed", "cfa"), [(5001, X_TRANS), (5002, CYGM), (5003, QUAD), (5004, RCCB), (5005, MONO)]
)
def test_distortion_of_mosaics(seed, cfa):
    apart, _, lateral = judge_distortion(seed, cfa)
    assert apart.max() < 0.2
    assert lateral.max(initial=0) < 0.2


@pytest.mark.parametrize("cfa", [X_TRANS, QUAD, RYYB, MONO])
@pytest.mark.parametrize("seed", [3, 4])
def test_colour_of_mosaics(seed, cfa):
    found, _ = judge_color(seed, cfa)
    assert np.percentile(found, 95) < 1


@pytest.mark.parametrize("cfa", [X_TRANS, QUAD, RCCB, CYGM, MONO])
@pytest.mark.parametrize("seed", [9401, 9402, 9403])
def test_sharpness_of_mosaics(seed, cfa):
    errors, hits, _ = judge_sharpness(seed, cfa=cfa)
    assert np.percentile(np.abs(errors), 95) < 0.02
    assert hits.mean() > 0.9

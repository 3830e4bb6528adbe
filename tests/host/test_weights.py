"""Product-integrated weights against fine quadrature of the same integrals."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from gpusim.data.weights import product_weights
from gpusim.domain.errors import BadData
from gpusim.domain.spectrum import Spectrum

FINE = np.arange(400.0, 700.01, 0.05)


def gaussian(center, width):
    return np.exp(-0.5 * ((FINE - center) / width) ** 2)


QE = Spectrum(FINE, np.stack([gaussian(600, 35), gaussian(540, 35), gaussian(460, 30)]))
# smooth reflectances, cubic splines through a few points, as measured tables are
REFLECTANCES = [
    CubicSpline([400, 480, 560, 640, 700], values)
    for values in np.random.default_rng(0).random((20, 5))
]
LIGHTS = {
    "daylight": 1 + 0.3 * np.sin(FINE / 40),
    # three-band lamp: lines 1 nm wide on a weak continuum
    "fluorescent": 0.05
    + sum(h * gaussian(c, 0.5) for c, h in ((435.8, 8), (487.3, 3), (546.1, 20), (611.2, 16))),
    "lasers": sum(gaussian(c, 0.9) for c in (447.3, 523.7, 638.1)),
}
# numerics notes section 1, cubic row: largest relative error over patches and channels, as measured there on other
# reflectances; this is the bound, the trapezoid on the same nodes errs by 0.66 and 1.0 under the two last lights
BOUNDS = {
    ("daylight", 10): 1.5e-3,
    ("fluorescent", 10): 5e-3,
    ("lasers", 10): 5e-3,
    ("fluorescent", 20): 2e-2,
}


@pytest.mark.parametrize(("light", "step"), BOUNDS)
def test_weights_integrate_spiky_lights(light, step):
    nodes = np.arange(400.0, 701.0, step)
    lamp = Spectrum(FINE, LIGHTS[light])
    weights = product_weights(nodes, lamp, QE)
    for reflectance in REFLECTANCES:
        truth = np.trapezoid(QE.values * LIGHTS[light] * reflectance(FINE), FINE, axis=1)
        scale = (
            np.trapezoid(QE.values * LIGHTS[light], FINE, axis=1) * 0.1
        )  # a 10 % grey: dark patches count in full
        error = np.abs(weights @ reflectance(nodes) - truth).max()
        assert error <= BOUNDS[light, step] * np.maximum(truth, scale).max()


def test_white_is_exact():
    """A spline through ones is one: the weights add up to the integral of the factors, whatever their spikes."""
    weights = product_weights(np.arange(400.0, 701.0, 10), Spectrum(FINE, LIGHTS["lasers"]), QE)
    truth = np.trapezoid(QE.values * LIGHTS["lasers"], FINE, axis=1)
    # both are trapezoid sums of the same integrand, on the 0.05 nm table and on its union with a 0.1 nm grid: the same
    np.testing.assert_allclose(weights.sum(axis=1), truth, rtol=1e-12)


def test_cubic_reflectance_is_exact():
    """Splines reproduce cubics, so the weights integrate R = cubic polynomial exactly."""
    nodes = np.arange(400.0, 701.0, 10)
    cubic = np.poly1d([1e-7, -2e-5, 3e-3, 0.2])
    truth = np.trapezoid(QE.values * cubic(FINE - 550), FINE, axis=1)
    np.testing.assert_allclose(product_weights(nodes, QE) @ cubic(nodes - 550), truth, rtol=1e-12)


def test_no_overlap_is_refused():
    with pytest.raises(BadData, match="no overlap"):
        product_weights(np.array([800.0, 900.0]), QE)

"""sRGB codes against the formula of the standard, evaluated in float64 by colour-science."""

import numpy as np
import pytest
from devices import ALL_KINDS

from gpusim.kernels.display.srgb import srgb, thresholds

pytestmark = pytest.mark.filterwarnings("ignore:[^$]*Matplotlib")  # colour's chatter


def codes(values, device):
    """Codes of a list of float32 values, padded to whole pixels."""
    values = np.asarray(values, np.float32)
    padded = np.zeros(-(-len(values) // 3) * 3, np.float32)
    padded[: len(values)] = values
    return srgb(padded.reshape(3, 1, -1), device=device)[0].T.ravel()[: len(values)]


def by_formula(values):
    import colour

    encoded = colour.models.eotf_inverse_sRGB(np.clip(np.asarray(values, np.float32).astype(float), 0, 1))
    return np.floor(255 * encoded + 0.5).astype(np.uint8)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_every_16_bit_value_has_the_code_of_the_formula(device):
    values = (np.arange(65536) / 65535).astype(np.float32)
    np.testing.assert_array_equal(codes(values, device), by_formula(values))


@pytest.mark.parametrize("device", ALL_KINDS)
def test_codes_change_at_exactly_the_right_float32(device):
    """All float32 within 64 steps of every rounding boundary.

    No boundary band is needed: float64 tells neighbouring float32 apart by 2^29 of its own steps, the power function
    errs by a few.
    """
    bits = thresholds().view(np.int32)[:, None] + np.arange(-64, 65, dtype=np.int32)
    values = bits.ravel().view(np.float32)
    found = codes(values, device)
    np.testing.assert_array_equal(found, by_formula(values))
    assert (np.diff(found.reshape(bits.shape), axis=1).sum(1) == 1).all()  # each boundary lies among its 129 values


@pytest.mark.parametrize("device", ALL_KINDS)
def test_every_code_survives_decoding_and_encoding(device):
    import colour

    every = np.arange(256)
    np.testing.assert_array_equal(codes(colour.models.eotf_sRGB(every / 255), device), every)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_what_no_display_can_show(device):
    values = [np.nan, -np.inf, np.inf, -1, 2, -0.0, 1e-45]
    assert codes(values, device).tolist() == [0, 0, 255, 0, 255, 0, 0]


@pytest.mark.parametrize("device", ALL_KINDS)
def test_planes_become_pixels(device):
    rgb = np.zeros((3, 5, 7), np.float32)
    rgb[0, 1, 2], rgb[1, 4, 6], rgb[2, 0, 0] = 1, 1, 1
    image = srgb(rgb, device=device)
    assert image.shape == (5, 7, 3) and image.dtype == np.uint8
    assert {tuple(place) for place in np.argwhere(image)} == {(1, 2, 0), (4, 6, 1), (0, 0, 2)}

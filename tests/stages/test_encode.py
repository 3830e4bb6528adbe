"""Display codes against the formulas of several curves, evaluated in float64."""

import numpy as np
import pytest
from devices import ALL_KINDS, DEVICES

from gpusim.backends import open_device
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData
from gpusim.kernels.display.encode import cases, code_table, encode, thresholds
from gpusim.kernels.display.encode_ref import encode as reference

pytestmark = pytest.mark.filterwarnings("ignore:[^$]*Matplotlib")  # colour's chatter


def srgb(linear):
    import colour

    return colour.models.eotf_inverse_sRGB(linear)


def from_srgb(code):
    import colour

    return colour.models.eotf_sRGB(code)


# Encoding and decoding. The S-curve of the encoded value is x^2 (3 - 2 x); its inverse by trigonometric functions.
CURVES = {
    "sRGB": (srgb, from_srgb),
    "gamma 2.2": (lambda linear: linear ** (1 / 2.2), lambda code: code**2.2),
    "gamma 1.8": (lambda linear: linear ** (1 / 1.8), lambda code: code**1.8),
    "S-curve": (
        lambda linear: srgb(linear) ** 2 * (3 - 2 * srgb(linear)),
        lambda code: from_srgb(0.5 - np.sin(np.arcsin(1 - 2 * code) / 3)),
    ),
    "steep": (lambda linear: np.clip((linear - 0.5) * 20, 0, 1), lambda code: 0.5 + code / 20),
}
SRGB = thresholds(DISPLAYS["srgb"].decode)


def codes(values, edges, device):
    """Codes of a list of float32 values, padded to whole pixels."""
    values = np.asarray(values, np.float32)
    padded = np.zeros(-(-len(values) // 3) * 3, np.float32)
    padded[: len(values)] = values
    return encode(padded.reshape(3, 1, -1), edges, device=device)[0].T.ravel()[: len(values)]


def by_formula(values, curve):
    encoded = CURVES[curve][0](np.clip(np.asarray(values, np.float32).astype(float), 0, 1))
    return np.floor(255 * encoded + 0.5).astype(np.uint8)


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("device", ALL_KINDS)
def test_every_16_bit_value_has_the_code_of_the_formula(device, curve):
    values = (np.arange(65536) / 65535).astype(np.float32)
    np.testing.assert_array_equal(
        codes(values, thresholds(CURVES[curve][1]), device), by_formula(values, curve)
    )


@pytest.mark.parametrize("curve", CURVES)
@pytest.mark.parametrize("device", ALL_KINDS)
def test_codes_change_at_exactly_the_right_float32(device, curve):
    """All float32 within 64 steps of every rounding boundary.

    No boundary band is needed: float64 tells neighbouring float32 apart by 2^29 of its own steps, the formulas err by
    a few, or by some hundreds where the S-curve is flat.
    """
    edges = thresholds(CURVES[curve][1])
    bits = edges.view(np.int32)[:, None] + np.arange(-64, 65, dtype=np.int32)
    values = bits.ravel().view(np.float32)
    found = codes(values, edges, device)
    np.testing.assert_array_equal(found, by_formula(values, curve))
    assert (
        np.diff(found.reshape(bits.shape).astype(int), axis=1).sum(1) == 1
    ).all()  # each lies among its 129 values


@pytest.mark.parametrize("device", ALL_KINDS)
def test_thresholds_on_the_first_float_of_a_bin_or_the_last(device):
    """Powers of two begin bins, and what lies a step below ends them."""
    begins = np.concatenate([2.0 ** np.arange(-90, 0), np.arange(1, 166)]).astype(np.float32)
    for edges in (begins, np.nextafter(begins, np.float32(0))):
        below = np.nextafter(edges, np.float32(0))
        np.testing.assert_array_equal(codes(edges, edges, device), np.arange(1, 256))
        np.testing.assert_array_equal(codes(below, edges, device), np.arange(255))


@pytest.mark.parametrize("device", ALL_KINDS)
def test_every_code_survives_decoding_and_encoding(device):
    every = np.arange(256)
    np.testing.assert_array_equal(codes(from_srgb(every / 255), SRGB, device), every)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_what_no_display_can_show(device):
    values = 15 * [
        np.nan,
        -np.inf,
        np.inf,
        -1,
        2,
        -0.0,
        1e-45,
        -np.nan,
    ]  # in vectors, and in what remains of them
    assert codes(values, SRGB, device).tolist() == 15 * [0, 0, 255, 0, 255, 0, 0, 0]
    whole = np.arange(1, 256, dtype=np.float32)  # the first threshold begins a bin
    assert codes(values, whole, device).tolist() == 15 * [0, 0, 255, 0, 2, 0, 0, 0]


@pytest.mark.parametrize("device", ALL_KINDS)
def test_planes_become_pixels(device):
    rgb = np.zeros((3, 5, 7), np.float32)
    rgb[0, 1, 2], rgb[1, 4, 6], rgb[2, 0, 0] = 1, 1, 1
    image = encode(rgb, SRGB, device=device)
    assert image.shape == (5, 7, 3) and image.dtype == np.uint8
    assert {tuple(place) for place in np.argwhere(image)} == {(1, 2, 0), (4, 6, 1), (0, 0, 2)}


@pytest.mark.parametrize("name", [name for name in DEVICES if name.startswith("opencl")])
def test_gpu_form_on_any_device(name, monkeypatch):
    """Four pixels per work-item, aligned where the frame allows it."""
    device = open_device(name)
    monkeypatch.setattr(device, "is_gpu", True)
    monkeypatch.setattr(device, "_programs", {})  # their text depends on it
    monkeypatch.setattr(device, "_kernels", {})
    for case in cases():
        np.testing.assert_array_equal(
            encode(**case.inputs, device=device), reference(**case.inputs), case.name
        )


def test_displays_have_small_tables():
    """A bin holds at most one threshold, and all bins fit into a core's first cache (32 KiB, 4 bytes each)."""
    device = open_device("opencl")
    for curve in ("sRGB", "gamma 2.2", "gamma 1.8", "S-curve"):
        assert np.prod(code_table(device, thresholds(CURVES[curve][1])).entries.shape) < 2**13


def test_what_is_no_curve_is_refused():
    rgb = np.zeros((3, 2, 2), np.float32)
    falling = SRGB.copy()
    falling[[7, 8]] = falling[[8, 7]]
    crowded = np.float32(0.5) + np.arange(255, dtype=np.float32) * np.float32(2.0**-24)
    crowded[0] = 1e-6
    for edges, words in (
        (SRGB[:-1], "shape"),
        (np.append(SRGB[:-1], np.nan), "finite"),
        (SRGB - SRGB[0], "finite"),
        (np.append(SRGB[:-1], np.inf), "finite"),
        (falling, "code 8"),
        (crowded, "too steep"),
    ):
        with pytest.raises(BadData, match=words):
            encode(rgb, edges, device="opencl")
    with pytest.raises(BadData, match="increases"):
        thresholds(np.ones_like)

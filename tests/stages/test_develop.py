"""The picture in one pass against the separate stages, against the float64 formula, and against its own symmetries."""

import numpy as np
import pytest
from devices import ALL_KINDS, DEVICES

from gpusim.backends import open_device
from gpusim.domain.display import DISPLAYS
from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.kernels.display.encode import encode, thresholds
from gpusim.kernels.processor import bilinear as bilinear_stage
from gpusim.kernels.processor import develop as develop_stage
from gpusim.kernels.processor.bayer import RED
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.color import color
from gpusim.kernels.processor.develop import develop
from gpusim.kernels.sensor.noise import noise
from gpusim.kernels.stage import public_function

SIZES = [(1, 1), (1, 6), (7, 1), (2, 2), (3, 5), (4, 4), (5, 8), (33, 38), (18, 40)]
SRGB = thresholds(DISPLAYS["srgb"].decode)
MATRIX = np.float32([[1.83, -0.61, -0.22], [-0.28, 1.57, -0.29], [0.03, -0.47, 1.44]])
CEILING = np.float32([0.55, 0.93, 0.71])
NUMBERS = {"black_level": 63.7, "scale": 1 / 959}
CONVERTER = 0.2371, 63.7, 1023.0  # gain [DN/e-], offset [DN], white level [DN]


def mosaic(rows, cols, seed=3):
    return np.random.default_rng(seed).integers(0, 1024, (rows, cols), np.uint16)


def electrons(rows, cols):
    """Below black, above the converter's range, and on its steps and halfway between them."""
    values = np.random.default_rng(4).uniform(-400, 5000, (rows, cols)).astype(np.float32)
    return np.where(
        values < 1000,
        (np.round(values) / 2 - np.float32(CONVERTER[1])) / np.float32(CONVERTER[0]),
        values,
    )


def one_by_one(raw, phase, device, edges=SRGB, ceiling=CEILING):
    shown = color(
        bilinear(raw, phase=phase, **NUMBERS, device=device), MATRIX, ceiling=ceiling, device=device
    )
    return encode(shown, edges, device=device)


@pytest.mark.parametrize("device", ALL_KINDS)
def test_codes_are_those_of_the_separate_stages(device):
    """Bit for bit: the same operations in the same order."""
    for rows, cols in SIZES:
        for phase in RED:
            for ceiling in (None, CEILING):
                raw = mosaic(rows, cols)
                at_once = develop(
                    raw, MATRIX, SRGB, phase=phase, **NUMBERS, ceiling=ceiling, device=device
                )
                np.testing.assert_array_equal(
                    at_once, one_by_one(raw, phase, device, ceiling=ceiling)
                )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_electrons_are_digitised_as_the_sensor_does_it(device):
    gain, offset, most = CONVERTER
    for rows, cols in SIZES:
        light = electrons(rows, cols)
        # 1e30: a well that never saturates. The noise stage takes negative charge as none.
        raw = noise(
            np.maximum(light, 0),
            full_well=1e30,
            gain=gain,
            black_level=offset,
            white_level=most,
            photon="none",
            device=device,
        )
        at_once = develop(
            np.maximum(light, 0),
            MATRIX,
            SRGB,
            phase="GBRG",
            **NUMBERS,
            converter=CONVERTER,
            device=device,
        )
        np.testing.assert_array_equal(
            at_once, develop(raw, MATRIX, SRGB, phase="GBRG", **NUMBERS, device=device)
        )


@pytest.mark.parametrize("device", ALL_KINDS)
def test_strange_electrons_stay_among_their_neighbours(device):
    """NaN and -inf are black, inf is white; nothing changes beyond the adjacent pixels."""
    light = np.full((9, 20), 1500, np.float32)
    options = {"phase": "RGGB", **NUMBERS, "converter": CONVERTER, "device": device}
    plain = develop(light, MATRIX, SRGB, **options)
    for strange, like in ((np.nan, -1e6), (-np.inf, -1e6), (np.inf, 1e6)):
        light[4, 9] = strange
        picture = develop(light, MATRIX, SRGB, **options)
        light[4, 9] = like
        np.testing.assert_array_equal(picture, develop(light, MATRIX, SRGB, **options))
        changed = np.argwhere((picture != plain).any(-1))
        assert np.abs(changed - (4, 9)).max() == 1


@pytest.mark.parametrize("device", ALL_KINDS)
def test_only_values_on_a_boundary_differ_from_float64(device):
    """Codes are float64's except where its value is within rounding of a threshold; there they are next to them.

    The band is 6 2^-24 of the sum of the terms' magnitudes, at most 3 x 2.7 x 1 (largest row of the matrix, camera
    values up to 1.001): 2.9e-6. Thresholds are 3e-4 apart and more, so 2 % of the values are within it at most.
    """
    raw = mosaic(120, 160)
    exact = color(
        bilinear(raw, phase="GRBG", **NUMBERS, device="numpy"),
        MATRIX,
        ceiling=CEILING,
        device="numpy",
    )
    band = 6 * 2.0**-24 * np.abs(MATRIX).sum(1).max() * 1.001
    assert band < 2.9e-6
    values = np.moveaxis(exact, 0, -1)
    near = np.searchsorted(SRGB, values - band) != np.searchsorted(SRGB, values + band)
    found = develop(
        raw, MATRIX, SRGB, phase="GRBG", **NUMBERS, ceiling=CEILING, device=device
    ).astype(int)
    wanted = encode(exact, SRGB, device="numpy").astype(int)
    np.testing.assert_array_equal(found[~near], wanted[~near])
    assert np.abs(found - wanted).max() <= 1 and near.mean() < 0.02


@pytest.mark.parametrize("device", ALL_KINDS)
def test_mirrored_mosaic_gives_the_mirrored_picture(device):
    raw = mosaic(34, 38)
    straight = develop(raw, MATRIX, SRGB, phase="RGGB", **NUMBERS, device=device)
    for turned, phase, back in (
        (raw[:, ::-1], "GRBG", np.s_[:, ::-1]),
        (raw[::-1], "GBRG", np.s_[::-1]),
        (raw[::-1, ::-1], "BGGR", np.s_[::-1, ::-1]),
    ):
        picture = develop(
            np.ascontiguousarray(turned), MATRIX, SRGB, phase=phase, **NUMBERS, device=device
        )
        np.testing.assert_array_equal(picture[back], straight)
    transposed = develop(
        np.ascontiguousarray(raw.T), MATRIX, SRGB, phase="RGGB", **NUMBERS, device=device
    )
    np.testing.assert_array_equal(transposed.transpose(1, 0, 2), straight)


@pytest.mark.parametrize("stage", [bilinear_stage, develop_stage], ids=["bilinear", "develop"])
@pytest.mark.parametrize("name", [name for name in DEVICES if name.startswith("opencl")])
def test_gpu_form_on_any_device(name, stage, monkeypatch):
    """One column of several rows per work-item; rows that begin at whole words or do not."""
    device = open_device(name)
    monkeypatch.setattr(device, "is_gpu", True)
    monkeypatch.setattr(device, "_programs", {})  # their text depends on it
    monkeypatch.setattr(device, "_kernels", {})
    function = public_function(stage.__name__.removeprefix("gpusim.kernels."))
    for case in stage.cases():
        error = case.error(
            function(**case.inputs, device=device), function(**case.inputs, device="numpy")
        )
        assert error <= case.tolerance, case.name


def test_wrong_input_is_refused():
    light = np.ones((4, 4), np.float32)
    options = {"phase": "RGGB", **NUMBERS, "device": "opencl"}
    with pytest.raises(UnknownName):
        develop(mosaic(4, 4), MATRIX, SRGB, **{**options, "phase": "RGBG"})
    for bad in (light, np.ones((3, 4, 4), np.uint16), np.ones((0, 4), np.uint16)):
        with pytest.raises(BadData):
            develop(bad, MATRIX, SRGB, **options)
    with pytest.raises(BadData):
        develop(mosaic(4, 4), MATRIX, SRGB, **options, converter=CONVERTER)
    with pytest.raises(BadData, match="matrix"):
        develop(mosaic(4, 4), MATRIX[:2], SRGB, **options)
    with pytest.raises(BadData, match="ceiling"):
        develop(mosaic(4, 4), MATRIX, SRGB, **options, ceiling=CEILING[:2])
    with pytest.raises(OutOfRange):
        develop(mosaic(4, 4), MATRIX, SRGB, **{**options, "scale": 0.0})
    for converter in ((0.0, 64.0, 1023.0), (1.0, np.nan, 1023.0), (1.0, 64.0, 65536.0)):
        with pytest.raises(OutOfRange):
            develop(light, MATRIX, SRGB, **options, converter=converter)

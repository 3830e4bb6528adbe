"""Malvar, He and Cutler's filters against colour-demosaicing's, and against their own symmetries."""

import numpy as np
import pytest
from devices import ALL_KINDS, DEVICES

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.kernels.processor.bayer import RED
from gpusim.kernels.processor.malvar import malvar

SIZES = [(1, 1), (1, 6), (7, 1), (2, 2), (2, 5), (3, 5), (4, 4), (5, 9), (33, 38)]
PLAIN = {"black_level": 0.0, "scale": 1.0}


def noise(rows, cols, seed=1):
    return np.random.default_rng(seed).integers(0, 65536, (rows, cols), np.uint16)


@pytest.mark.filterwarnings("ignore:.*scipy.ndimage.filters:DeprecationWarning")
@pytest.mark.parametrize("phase", RED)
@pytest.mark.parametrize("device", ["numpy", *DEVICES])
def test_it_is_that_of_colour_demosaicing(phase, device):
    from colour_demosaicing import demosaicing_CFA_Bayer_Malvar2004

    raw = noise(33, 38)
    ours = malvar(raw, phase=phase, black_level=100.0, scale=1 / 65435, device=device)
    theirs = np.moveaxis(
        (demosaicing_CFA_Bayer_Malvar2004(raw.astype(float), phase) - 100) / 65435, 2, 0
    )
    # Inside the border of 2 (theirs repeats the edge pixel). The weights' magnitudes sum to at most 3.5, so values are
    # below 3.5 and two float32 roundings below 4.2e-7.
    np.testing.assert_allclose(ours[:, 2:-2, 2:-2], theirs[:, 2:-2, 2:-2], rtol=0, atol=4.2e-7)


@pytest.mark.parametrize("phase", RED)
@pytest.mark.parametrize("device", ALL_KINDS)
def test_border_is_the_mirrored_mosaic(phase, device):
    """A frame demosaicked alone is the inside of its mirrored surroundings, whatever its size. All sums are exact."""
    for shape in SIZES:
        if 1 in shape:
            continue  # an axis of one pixel mirrors onto itself: there is no other colour
        raw = noise(*shape)
        alone = malvar(raw, phase=phase, **PLAIN, device=device)
        wide = malvar(
            np.pad(raw, 6, mode="reflect"), phase=phase, **PLAIN, device=device
        )  # 6 is even: same phase
        np.testing.assert_array_equal(alone, wide[:, 6:-6, 6:-6])


@pytest.mark.parametrize("device", ["numpy", *DEVICES])
def test_mirrored_mosaic_gives_the_mirrored_picture(device):
    """No direction and no phase is preferred: phases and transpose are mirror images of each other, bit for bit."""
    for shape in ((34, 38), (34, 40), (34, 8)):
        raw = noise(*shape)
        straight = malvar(raw, phase="RGGB", black_level=64.0, scale=1 / 959, device=device)

        def turned(raw, phase):
            return malvar(
                np.ascontiguousarray(raw),
                phase=phase,
                black_level=64.0,
                scale=1 / 959,
                device=device,
            )

        np.testing.assert_array_equal(turned(raw[:, ::-1], "GRBG")[:, :, ::-1], straight)
        np.testing.assert_array_equal(turned(raw[::-1], "GBRG")[:, ::-1], straight)
        np.testing.assert_array_equal(turned(raw[::-1, ::-1], "BGGR")[:, ::-1, ::-1], straight)
        np.testing.assert_array_equal(turned(raw.T, "RGGB").transpose(0, 2, 1), straight)
        np.testing.assert_array_equal(
            turned(raw, "BGGR")[::-1], straight
        )  # red and blue change places


@pytest.mark.parametrize("device", ALL_KINDS)
def test_flat_fields_stay_flat_and_samples_are_kept_at_any_size(device):
    for shape in SIZES:
        for phase in RED:
            flat = malvar(np.full(shape, 700, np.uint16), phase=phase, **PLAIN, device=device)
            np.testing.assert_array_equal(flat, 700)  # the weights' sums are exactly 1
            raw = noise(*shape)
            out = malvar(raw, phase=phase, **PLAIN, device=device)
            letters = np.array(list(phase)).reshape(2, 2)[
                np.arange(shape[0])[:, None] % 2, np.arange(shape[1]) % 2
            ]
            for plane, letter in zip(out, "RGB", strict=True):
                np.testing.assert_array_equal(plane[letters == letter], raw[letters == letter])


def test_planes_are_reproduced():
    """The filters' first moments vanish: a gray ramp comes out exactly, inside the border."""
    ramp = np.add.outer(40 * np.arange(12), 24 * np.arange(14)).astype(np.uint16)
    out = malvar(ramp, phase="GBRG", **PLAIN, device="opencl")
    np.testing.assert_array_equal(out[:, 2:-2, 2:-2], np.broadcast_to(ramp[2:-2, 2:-2], (3, 8, 10)))


def test_wrong_input_is_refused():
    options = {"phase": "RGGB", **PLAIN, "device": "opencl"}
    with pytest.raises(UnknownName, match="RGBG"):
        malvar(noise(4, 4), **{**options, "phase": "RGBG"})
    for bad in (
        np.ones((4, 4), np.float32),
        np.ones((3, 4, 4), np.uint16),
        np.ones((0, 4), np.uint16),
    ):
        with pytest.raises(BadData):
            malvar(bad, **options)
    with pytest.raises(OutOfRange):
        malvar(noise(4, 4), **{**options, "scale": 0.0})

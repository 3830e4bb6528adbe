"""Distances from pictures through coded apertures: of planes that are blurred by known kernels."""

import numpy as np
import pytest
from scipy.signal import fftconvolve

import gpusim as gs
from gpusim.captures.coded_depth import coded_kernels, find_coded_depth

DISTANCES = 1 / np.linspace(0.9, 0.3, 6)
PHONE = gs.open_camera("machine-vision").with_(object_distance_m=2.0)
SIDE, NOISE = 64, 0.005


def made(masks, number):
    """Pictures of a texture at one of the distances through masks, and their kernels."""
    cameras = [PHONE.with_(mask=mask) for mask in masks]
    bank = [coded_kernels(camera, DISTANCES, [550.0], [1.0]) for camera in cameras]
    random = np.random.default_rng(number)
    side = SIDE + bank[0].shape[-1] - 1
    f = np.maximum(np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side)), 0.01)
    waves = np.fft.fft2(random.standard_normal((side, side))) / f
    texture = np.fft.ifft2(waves).real
    texture = 1 + 0.3 * texture / texture.std()
    return [
        fftconvolve(texture, kernels[number], "valid") + NOISE * random.standard_normal((SIDE,) * 2)
        for kernels in bank
    ], bank


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("pair", [False, True], ids=["one", "pair"])
def test_the_distance_of_a_plane_is_found(pair, number):
    """The bank's steps are 0.12 dioptre, of which the best must be the true one in most windows: some ten are
    independent, and two may fail.

    These two are the ones whose blur differs from all others' by a pixel.
    """
    left, right = gs.pupil_cells((1, 2))[0]
    pictures, bank = made([left, right] if pair else ["mura-5"], number)
    found = find_coded_depth(
        pictures if pair else pictures[0], bank if pair else bank[0], DISTANCES, NOISE
    )
    assert np.mean(found.index == number) > 0.75
    assert np.median(np.abs(1 / found.distances - 1 / DISTANCES[number])) < 0.06


def test_kernels_hold_their_light_and_are_least_in_focus():
    bank = coded_kernels(PHONE.with_(mask="mura-5"), DISTANCES, [500.0, 600.0], [0.5, 0.5])
    np.testing.assert_allclose(bank.sum(axis=(1, 2)), 1)
    at = np.arange(bank.shape[-1]) - bank.shape[-1] // 2
    wide = np.einsum("dyx,x->d", bank, at**2.0)
    # 1 / 2 m is in focus: the bank comes to it from nearer and goes beyond
    assert wide.argmin() in (3, 4) and wide[0] > wide[2] and wide[5] > wide[4]
    with pytest.raises(gs.GpusimError, match="wanted one or two pictures"):
        find_coded_depth(np.ones((8, 8)), np.stack([bank, bank]), DISTANCES, NOISE)
    with pytest.raises(gs.GpusimError, match="noise"):
        find_coded_depth(np.ones((8, 8)), bank, DISTANCES, 0.0)
    with pytest.raises(gs.GpusimError, match="one of each kernel"):
        find_coded_depth(np.ones((8, 8)), bank, DISTANCES[1:], NOISE)

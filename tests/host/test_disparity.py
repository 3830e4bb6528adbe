"""Disparity of two pictures: displacements that are known, the Cramer-Rao bound, refusals."""

import numpy as np
import pytest

import gpusim as gs
from gpusim.domain.errors import GpusimError


def displaced(random, level, moved, shape=(32, 128)):
    """A texture with a power of f^-2 and no frequency near the pixels', and the same `moved` columns on."""
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])
    f = np.hypot(fy, fx)
    f[0, 0] = 1
    spectrum = np.fft.fft2(random.normal(size=shape)) / f * np.exp(-((f / 0.2) ** 2))
    texture = np.fft.ifft2(spectrum).real
    spectrum *= 0.3 / texture.std() * level
    spectrum[0, 0] = level * np.prod(shape)
    both = [np.fft.ifft2(spectrum * np.exp(-2j * np.pi * fx * d)).real for d in (0, moved)]
    return [np.maximum(one, 0.05 * level)[:, 32:-32] for one in both]


@pytest.mark.parametrize(("level", "most"), [(20, 1.6), (2000, 1.4)])
def test_errors_are_the_uncertainty(level, most):
    """30 pairs: the root mean square of errors over deviations is 1 within 3 / sqrt(60) = 0.4, more with little light,

    where the bound of least variance is not reached.
    """
    random = np.random.default_rng(2)
    ratios = []
    for _ in range(30):
        moved = random.uniform(-4, 4)
        pair = [random.poisson(one) for one in displaced(random, level, moved)]
        found = gs.disparity(*pair, noise=level, is_defocus=False)
        ratios.append((found.values[0, 0] - moved) / found.uncertainty[0, 0])
    size = np.sqrt(np.mean(np.square(ratios)))
    assert 0.6 < size < most


def test_blocks_have_places_and_directions():
    """Without noise, light that enters and leaves blocks with what is left of a pixel, and cubics, leave 1 to 3 %."""
    one, other = displaced(np.random.default_rng(3), 100, 2.5, (64, 256))
    found = gs.disparity(one, other, block=(32, 64), is_defocus=False)
    assert found.values.shape == (3, 5) and found.rows[1] == 31.5 and found.cols[1] == 63.5
    assert np.abs(found.values - 2.5).max() < 0.05
    turned = gs.disparity(one.T, other.T, block=(64, 32), split="up-down", is_defocus=False)
    np.testing.assert_allclose(turned.values, found.values.T, atol=1e-9)
    np.testing.assert_array_equal(turned.rows, found.cols)


def test_no_texture_is_not_certain():
    flat = np.full((32, 64), 7.0)
    assert np.isinf(gs.disparity(flat, flat, noise=1.0).uncertainty).all()


@pytest.mark.parametrize(
    ("pair", "options", "words"),
    [
        ((np.ones((8, 9)), np.ones((9, 8))), {}, "two of one shape"),
        ((np.ones((8, 9)), np.full((8, 9), np.nan)), {}, "finite pictures"),
        ((np.ones((8, 9)), np.ones((8, 9))), {"block": (8, 4)}, "pixels along the disparity"),
    ],
)
def test_pictures_are_refused_in_a_line(pair, options, words):
    with pytest.raises(GpusimError, match=words) as refused:
        gs.disparity(*pair, **options)
    assert "\n" not in str(refused.value)

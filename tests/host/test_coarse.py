"""A convolution by a near kernel and a coarse grid, against the whole convolution in float64."""

import numpy as np
import pytest
import scipy

from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.sample import sample
from gpusim.optics.coarse import SPACING, CoarseGrid, split_error, split_tables

SIZE, WIDE, SHAPE = 23, 93, (120, 150)
MODES = {"edge": "edge", "reflect": "symmetric", "zero": "constant"}


def kernel(shift=0.0):
    """A core and a tail that falls as 1 / r^3, as that of a lens."""
    at = np.arange(WIDE) - WIDE // 2
    square = (at[:, None] - shift) ** 2 + at**2
    found = np.exp(-square / 2) + 0.2 / (1 + square) ** 1.5
    return found / found.sum()


def clouds(shape):
    """Amplitudes that fall as 1 / f, contrast 0.3."""
    f = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1]))
    f[0, 0] = np.inf
    noise = np.random.default_rng(7).standard_normal(shape)
    found = np.fft.ifft2(np.fft.fft2(noise) / f).real
    return 1 + 0.3 * found / found.std()


@pytest.mark.parametrize("border", MODES)
@pytest.mark.parametrize("shift", [0.0, 0.4])
@pytest.mark.parametrize("margin", [0, 6, -3])
def test_parts_are_the_whole(border, shift, margin):
    """Quarters of tables of an even kernel, halves of another; results inside and around the frame.

    The error is that of natural scenes, within 1.5 for the one that this is, and float32: 1e-6.
    """
    whole, picture = kernel(shift), clouds(SHAPE)
    grid = CoarseGrid.of(SHAPE, tuple(n + WIDE for n in SHAPE))
    assert all(n % SPACING == 0 and n >= m + WIDE for n, m in zip(grid.period, SHAPE, strict=True))
    held = np.zeros(grid.period)
    held[:WIDE, :WIDE] = whole
    spectrum = np.fft.rfft2(np.roll(held, (-(WIDE // 2),) * 2, (0, 1)))
    table = spectrum[None, : grid.period[0] // 2 + 1].real
    if shift:
        table = np.ascontiguousarray(spectrum[None].astype(np.complex64)).view(np.float32)
    near, coarse = split_tables(table, grid.period, SIZE)
    light = sample(picture[None].astype(np.float32), *grid.gather(border), device="numpy")
    one = np.ones((1, 1), np.float32)
    far = blur(light, coarse[None], one, "zero", grid.lengths, device="numpy")
    far = sample(far, *grid.spread(margin), device="numpy")[0]
    more = WIDE // 2 + 3
    wide = np.pad(picture, more, mode=MODES[border])
    inner = tuple(slice(more + margin, more + n - margin) for n in SHAPE)
    wanted = scipy.signal.fftconvolve(wide, whole, mode="same")[inner]
    found = far + scipy.signal.fftconvolve(wide, near[0], mode="same")[inner]
    error = np.sqrt(np.mean((found - wanted) ** 2))
    assert error < 1.5 * split_error(whole[None], SIZE) + 1e-6
    # the far part has more of the light
    assert np.abs(far).mean() > 100 * error
    assert split_error(whole[None], 15) > 3 * split_error(whole[None], SIZE)

"""Thumbnails of linear pictures, from which the light is estimated."""

import numpy as np
import pytest
from devices import DEVICES

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.processor.thumbnail import thumbnail


@pytest.mark.parametrize("device", DEVICES)
def test_thumbnails_are_the_same_bits_everywhere(device):
    """Rows from the top, then columns from the left, each addition rounded; then one division."""
    random = np.random.default_rng(9)
    picture = random.random((3, 70, 1030), np.float32)
    found = thumbnail(picture, [0.95, 0.9, 0.99], rows=4, cols=3, device=device)
    below = (picture < np.float32([0.95, 0.9, 0.99])[:, None, None]).all(0)
    kept = np.where(below, np.concatenate([picture, np.ones_like(picture[:1])]), np.float32(0))
    for i in range(4):
        for j in range(3):
            block = kept[:, i * 70 // 4 : (i + 1) * 70 // 4, j * 1030 // 3 : (j + 1) * 1030 // 3]
            sums = np.add.accumulate(np.add.accumulate(block, 1)[:, -1], 1)[:, -1]
            np.testing.assert_array_equal(found[:, i, j], sums[:3] / sums[3])


def test_wrong_thumbnails_are_refused():
    picture = np.ones((3, 8, 8), np.float32)
    for error, arguments, options in (
        (BadData, (picture[0], 1.0), {}),
        (BadData, (picture, [1.0, 1.0]), {}),
        (OutOfRange, (picture, 1.0), {"rows": 0}),
        (OutOfRange, (picture, 1.0), {"cols": 2.5}),
    ):
        with pytest.raises(error):
            thumbnail(*arguments, **options)

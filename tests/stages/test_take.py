"""Windows of samples: what their numbers are on every device, bit for bit, and what is refused."""

import numpy as np
import pytest
from devices import ALL, DEVICES

from gpusim.backends import open_device
from gpusim.domain.errors import BadData
from gpusim.kernels.spectral.take import take

ROWS, COLS = np.array([[0, 3], [7, -1]], np.int32), np.array([[1, 1, 2], [0, 4, 9]], np.int32)


def bits(values):
    return values.view(np.uint32)


@pytest.mark.parametrize("name", DEVICES)
def test_samples_are_copied_bit_for_bit(name):
    """Signs of zeros, denormals and what NaN carries, which a case's error does not see."""
    random = np.random.default_rng(1)
    values = random.integers(0, 2**32, (3, 4, 5), np.uint32).view(np.float32)
    values[0, 0] = -0.0, 1e-45, np.nan, -np.inf, np.inf
    found = take(values, ROWS, COLS, device=name)
    assert found.dtype == np.float32 and found.shape == (2, 3, 2, 3)
    for window, ys, xs in zip(found, ([0, 3], [3, 0]), ([1, 1, 2], [0, 4, 4]), strict=True):
        np.testing.assert_array_equal(bits(window), bits(values)[:, ys][:, :, xs])


@pytest.mark.parametrize("name", DEVICES)
def test_a_devices_own_arrays_stay_there(name):
    device = open_device(name)
    ids = np.arange(20, dtype=np.uint16).reshape(4, 5) + 65500
    found = take(device.array(ids, np.uint16), device.array(ROWS, np.int32), COLS, device=device)
    assert isinstance(found, device.array_type)
    np.testing.assert_array_equal(
        device.numpy(found),
        [
            [[65501, 65501, 65502], [65516, 65516, 65517]],
            [[65515, 65519, 65519], [65500, 65504, 65504]],
        ],
    )
    assert device.numpy(found).dtype == np.uint16


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize(
    ("shape", "dtype", "rows", "cols", "words"),
    [
        ((4,), np.float32, ROWS, COLS, r"content of shape \(4,\); wanted"),
        ((3, 0, 5), np.float32, ROWS, COLS, r"content of shape \(3, 0, 5\); wanted"),
        (
            (3, 4, 5),
            np.uint8,
            ROWS,
            COLS,
            "content of type uint8; wanted float32, float16 or uint16",
        ),
        (
            (3, 4, 5),
            np.float32,
            ROWS[0],
            COLS,
            r"rows of shape \(2,\) and columns of shape \(2, 3\); wanted",
        ),
        (
            (3, 4, 5),
            np.float32,
            ROWS,
            COLS[0],
            r"rows of shape \(2, 2\) and columns of shape \(3,\); wanted",
        ),
        ((3, 4, 5), np.float32, ROWS[0], None, r"rows of shape \(2,\)"),
        ((3, 4, 5), np.float32, None, COLS[None], r"columns of shape \(1, 2, 3\)"),
        (
            (3, 4, 5),
            np.float32,
            ROWS[:1],
            COLS,
            r"rows of shape \(1, 2\) and columns of shape \(2, 3\); wanted",
        ),
        ((3, 4, 5), np.float32, np.zeros((0, 2), np.int32), COLS, r"rows of shape \(0, 2\)"),
    ],
)
def test_wrong_shapes_are_refused(name, shape, dtype, rows, cols, words):
    with pytest.raises(BadData, match=f"^take: .*{words}") as caught:
        take(np.zeros(shape, dtype), rows, cols, device=name)
    assert "\n" not in str(caught.value)

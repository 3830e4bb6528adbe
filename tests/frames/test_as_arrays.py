"""What objects are to NumPy: `np.asarray` of those that are one array."""

import numpy as np
import pytest
from devices import ALL_KINDS

import gpusim as gs
from gpusim.pipeline.exposure import Exposure

NODES = np.linspace(400, 700, 31)
PHONE = gs.open_camera("phone")
CHECKER = gs.chart("colorchecker", size=(48, 32))


def as_arrays(device):
    """Objects, and the arrays that they are."""
    simulate, codes = gs.Simulator(PHONE, device=device), np.zeros((6, 8, 3), np.uint8)
    frame, exposure = simulate(CHECKER, seed=1), simulate.expose(CHECKER)
    cube = gs.Cube(NODES, np.random.default_rng(1).random((31, 6, 8), np.float32))
    spread, light = gs.PointSpread(NODES, np.ones((31, 9, 9)), 1e-6), CHECKER.illuminant
    return [
        (frame, frame.rgb),
        (exposure, simulate.device.numpy(exposure.mean)),
        (light, light.values),
        (cube, cube.values),
        (spread, spread.values),
        (gs.picture(codes).content, codes),
    ]


@pytest.mark.parametrize("device", ALL_KINDS)
def test_what_is_one_array_is_one_to_numpy(device):
    """As NumPy 2 says: `dtype` casts, copy=True copies, copy=None where it must, and copy=False never or it raises."""
    for one, values in as_arrays(device):
        found = np.asarray(one)
        assert found.dtype == values.dtype and found.shape == values.shape
        np.testing.assert_array_equal(found, values)
        if isinstance(one, Exposure) and not one.device.on_host:  # electrons in a GPU's memory
            with pytest.raises(ValueError, match="without a copy"):
                np.array(one, copy=False)
        else:
            assert np.shares_memory(found, values) and np.shares_memory(
                np.array(one, copy=False), values
            )
        assert not np.shares_memory(np.array(one), values)
        other = np.asarray(one, np.float64 if values.dtype == np.float32 else np.float32)
        assert other.dtype != values.dtype
        np.testing.assert_array_equal(other, values.astype(other.dtype))
        with pytest.raises(ValueError, match="copy"):
            np.array(one, np.complex64, copy=False)


def test_a_frame_is_a_picture_and_a_cube_may_be_a_devices():
    device, values = (
        gs.open_device("opencl"),
        np.random.default_rng(2).random((31, 4, 5), np.float32),
    )
    np.testing.assert_array_equal(gs.Cube(NODES, device.array(values)), values)
    frame = gs.Simulator(PHONE, device="opencl")(CHECKER)
    np.testing.assert_array_equal(gs.picture(frame).content.codes, frame.rgb)
    np.testing.assert_array_equal(
        gs.scene_from(frame).content.planes, gs.scene_from(frame.rgb).content.planes
    )

"""Frames by Ray Data: as the serial run's, bit for bit, however rows are shared out among two workers."""

import importlib.util

import numpy as np
import pytest
from cameras import PHONE
from devices import KINDS

import gpusim as gs
from gpusim.apps.tensors.ray import Frames
from gpusim.domain.errors import BadData

RANDOM = np.random.default_rng(6)
PICTURES = RANDOM.random((10, 20, 24, 3)).astype(np.float32)
TIMES = RANDOM.uniform(0.002, 0.03, 10)


def serial(device):
    batch = gs.PictureBatch(PHONE, device=device)
    return [
        batch(np.moveaxis(picture, -1, 0)[None], first=item, seed=5, exposure_time=float(time))[0]
        for item, (picture, time) in enumerate(zip(PICTURES, TIMES, strict=True))
    ]


@pytest.mark.parametrize("device", KINDS)
def test_rows_in_any_order_are_those_of_the_serial_run(device):
    frames = Frames(PHONE, device=device, seed=5, exposure_time="time")
    expected = serial(device)
    for chosen in ([3, 9, 0], [1], [8, 7, 6, 5, 4, 2]):
        rows = frames(
            {"image": PICTURES[chosen], "number": np.array(chosen), "time": TIMES[chosen]}
        )
        assert [*rows] == ["image", "number", "time", "frame"]
        for own, item in zip(rows["frame"], chosen, strict=True):
            np.testing.assert_array_equal(own, expected[item])
    turned = Frames(
        PHONE, device=device, seed=5, exposure_time="time", channels_last=False, picture="light"
    )
    rows = turned({"light": PICTURES[[4]].transpose(0, 3, 1, 2), "number": [4], "time": TIMES[[4]]})
    np.testing.assert_array_equal(rows["frame"][0], expected[4])


def test_the_device_is_called_once_for_rows_of_one_shape():
    frames = Frames(PHONE, device=KINDS[0], seed=5, exposure_time="time", at_once=4)
    batch, called = frames._batch, []

    def counted(pictures, **settings):
        called.append(len(pictures))
        return batch(pictures, **settings)

    counted.output = batch.output
    frames._batch = counted
    rows = frames({"image": PICTURES, "number": np.arange(10), "time": TIMES})
    assert called == [4, 4, 2]
    for own, expected in zip(rows["frame"], serial(KINDS[0]), strict=True):
        np.testing.assert_array_equal(own, expected)


def test_pictures_have_their_channels_where_the_rows_have_them():
    rows = (
        {"image": PICTURES[:2], "number": [0, 1]},
        {"image": PICTURES[:2].transpose(0, 3, 1, 2), "number": [0, 1]},
    )
    last, first = (
        Frames(PHONE, device="numpy", output="linear", channels_last=is_last, exposure_time=0.01)(
            given
        )
        for given, is_last in zip(rows, (True, False), strict=True)
    )
    assert last["frame"].shape == (2, 20, 24, 3)
    np.testing.assert_array_equal(last["frame"].transpose(0, 3, 1, 2), first["frame"])


def test_columns_that_are_not_there():
    with pytest.raises(BadData, match="no column 'number'; there are image"):
        Frames(PHONE, device="numpy")({"image": PICTURES})
    with pytest.raises(BadData, match="no column 'time'"):
        Frames(PHONE, device="numpy", exposure_time="time")(
            {"image": PICTURES, "number": range(10)}
        )


@pytest.mark.slow  # a local Ray starts
@pytest.mark.skipif(importlib.util.find_spec("ray") is None, reason="ray is not installed")
def test_two_workers_of_ray():
    import ray

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        rows = [
            {"image": picture, "number": number, "time": time}
            for number, (picture, time) in enumerate(zip(PICTURES, TIMES, strict=True))
        ]
        settings = {"camera": PHONE, "device": "opencl:pocl", "seed": 5, "exposure_time": "time"}
        made = (
            ray.data.from_items(rows, override_num_blocks=5)
            .map_batches(Frames, fn_constructor_kwargs=settings, batch_size=2, concurrency=2)
            .take_all()
        )
    finally:
        ray.shutdown()
    assert len(made) == 10
    expected = serial("opencl:pocl")
    for row in made:
        np.testing.assert_array_equal(row["frame"], expected[row["number"]])

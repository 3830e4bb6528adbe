"""A renderer's frames through cameras: what a writer is handed becomes the frames of a batch."""

import importlib.util
from zlib import crc32

import numpy as np
import pytest
from cameras import PHONE, camera_with
from devices import KINDS

import gpusim as gs
from gpusim.apps.tensors.replicator import Views
from gpusim.domain.errors import BadData
from gpusim.domain.foreign import to_host

RANDOM = np.random.default_rng(4)
FRAME = RANDOM.random((24, 32, 4)).astype(np.float16)


class Writer:
    """As Replicator's: `write` is called with the annotators' data of each frame."""

    def __init__(self, views):
        self._views, self._number, self.written = views, 0, []

    def write(self, data):
        self.written.append(self._views(data, number=self._number, seed=3, exposure_time=0.01))
        self._number += 1


def given(library, values):
    if library == "numpy":
        return values
    if library == "torch":
        import torch

        return torch.from_numpy(values)
    import warp

    return warp.array(values, dtype=warp.float16, device="cpu")


@pytest.mark.parametrize(
    "library",
    [
        "numpy",
        "warp",
        pytest.param(
            "torch",
            marks=pytest.mark.skipif(
                importlib.util.find_spec("torch") is None, reason="torch is not installed"
            ),
        ),
    ],
)
@pytest.mark.parametrize("device", KINDS)
def test_a_writer_hands_on_frames_of_batches(device, library):
    cameras = {"left": PHONE, "right": camera_with(noise={"read": 20.0})}
    writer = Writer(Views(cameras, device=device))
    for number in range(2):
        writer.write(
            {f"HdrColor-{name}": given(library, FRAME * (1 + number)) for name in cameras}
            | {"rp_depth": 0}
        )
    for number, frames in enumerate(writer.written):
        assert list(frames) == ["left", "right"]
        for name, camera in cameras.items():
            pictures = (FRAME * (1 + number))[None, ..., :3].transpose(0, 3, 1, 2)
            expected = gs.PictureBatch(camera, device=device)(
                pictures, first=number, seed=3 + crc32(name.encode()), exposure_time=0.01
            )
            np.testing.assert_array_equal(to_host(frames[name], "test"), expected[0])
            alone = Views(cameras, device=device)(
                {f"HdrColor-{name}": given(library, FRAME * (1 + number))},
                number=number,
                seed=3,
                exposure_time=0.01,
            )
            np.testing.assert_array_equal(to_host(alone[name], "test"), expected[0])


def test_pictures_have_the_renderers_layout():
    for output, shape in (("codes", (24, 32, 3)), ("linear", (24, 32, 3)), ("camera", (3, 24, 32))):
        views = Views(PHONE, device="numpy", output=output)
        expected = gs.PictureBatch(PHONE, device="numpy", output=output)(
            FRAME[None, ..., :3].transpose(0, 3, 1, 2), seed=crc32(b""), exposure_time=0.01
        )[0]
        found = views({"HdrColor": FRAME}, number=0, exposure_time=0.01)[""]
        assert found.shape == shape
        np.testing.assert_array_equal(
            found, expected if output == "camera" else expected.transpose(1, 2, 0)
        )


def test_one_camera_for_all_views_and_what_is_not_there():
    views = Views(PHONE, device="numpy", output="mean")
    frames = views({"HdrColor": FRAME}, number=0, exposure_time=0.01)
    assert frames[""].shape == (24, 32)
    assert list(
        views({"HdrColor_a": FRAME, "HdrColor_b": FRAME}, number=0, exposure_time=0.01)
    ) == ["a", "b"]
    with pytest.raises(BadData, match="LdrColor; wanted HdrColor"):
        views({"LdrColor": FRAME}, number=0)
    with pytest.raises(BadData, match="no camera for the view 'b'; there are a"):
        Views({"a": PHONE}, device="numpy")({"HdrColor-b": FRAME}, number=0)
    with pytest.raises(BadData, match=r"\(32, 4\), wanted \(rows, cols, 4\)"):
        views({"HdrColor": FRAME[0]}, number=0)

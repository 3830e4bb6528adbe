"""Frames of rendered linear HDR pictures, as from Replicator's writers and Isaac Lab's cameras.

`Views` takes the argument of a writer's `write`: a dictionary in which "HdrColor", or "HdrColor-"
and the name of a view, is linear RGB with alpha, float16 (rows, cols, 4), in a Warp array on the
GPU, a NumPy array or another library's. Omniverse is not needed.
"""

from collections.abc import Mapping
from zlib import crc32

import numpy as np

from gpusim.apps.tensors.batches import PICTURES, PictureBatch, move_axis
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.memory import describe_array

COLOUR = "HdrColor"


class Views:
    """Cameras of a renderer's views.

    Args:
        cameras: One camera for all views, or cameras by the names of views.
        settings: Other arguments of `gpusim.PictureBatch`, for example device and output; luminance is the
            luminance of the value 1 [cd m-2].

    Raises:
        GpusimError: As `gpusim.PictureBatch` does.
    """

    def __init__(self, cameras: Camera | Mapping[str, Camera], **settings):
        named = cameras if isinstance(cameras, Mapping) else {"": cameras}
        self._batches = {name: PictureBatch(camera, **settings) for name, camera in named.items()}

    def __call__(
        self, data: Mapping, *, number: int, seed: int = 0, exposure_time: float | None = None
    ) -> dict:
        """Return a frame of every view, by the name of the view ("" for a single one).

        Args:
            data: Rendered data by name.
            number: Number of this call among all calls.
            seed: Seed of the noise, which differs between views according to their names.
            exposure_time: Exposure time [s], see `gpusim.PictureBatch`.

        Returns:
            Frames as of `gpusim.PictureBatch`; pictures (codes, linear light, XYZ) are (rows, cols, 3).

        Raises:
            BadData: If the data has no pictures, or a view has no camera.
        """
        found = {
            key[len(COLOUR) :].lstrip("-_"): values
            for key, values in data.items()
            if key.startswith(COLOUR)
        }
        if not found:
            names = ", ".join(map(str, data)) or "nothing"
            raise BadData(f"rendered data: {names}; wanted {COLOUR}: attach that annotator")
        frames = {}
        for name in sorted(found):
            batch = self._batches.get(name) or self._batches.get("")
            if batch is None:
                known = ", ".join(self._batches)
                raise BadData(f"rendered data: no camera for the view {name!r}; there are {known}")
            picture = channels_first(found[name])
            # depends only on the name: other views may come and go
            own = (seed + crc32(name.encode())) % 2**64
            made = batch(picture, first=number, seed=own, exposure_time=exposure_time)[0]
            frames[name] = move_axis(made, 0, -1) if batch.output in PICTURES else made
        return frames


def channels_first(frame):
    """Return linear RGB (1, 3, rows, cols) of a picture (rows, cols, 3 or 4), in the same library.

    Raises BadData.
    """
    values = describe_array(frame, COLOUR)
    if len(values.shape) != 3 or values.shape[2] not in (3, 4):
        raise BadData(f"{COLOUR}: {tuple(values.shape)}, wanted (rows, cols, 4) or (rows, cols, 3)")
    if hasattr(values, "permute"):  # torch's
        return values.permute(2, 0, 1)[None, :3].contiguous()
    turned = values.transpose((2, 0, 1))
    if hasattr(turned, "contiguous"):  # Warp's
        rows, cols = turned.shape[1:]
        return turned[:3].contiguous().reshape((1, 3, rows, cols))
    if isinstance(turned, np.ndarray):
        return np.ascontiguousarray(turned[:3])[None]
    return turned[:3][None].copy()

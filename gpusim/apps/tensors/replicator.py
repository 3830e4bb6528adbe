"""Frames of renderers through cameras: linear HDR pictures as Replicator's writers and Isaac Lab's cameras have them.

`Views` takes what a writer's `write` is given: a dictionary in which "HdrColor", or "HdrColor-" and the name of a view,
has linear RGB and an alpha, float16 (rows, cols, 4), in a Warp array on the GPU, NumPy's or another library's. Nothing
of Omniverse is needed here.
"""

from collections.abc import Mapping
from zlib import crc32

import numpy as np

from gpusim.apps.tensors.batches import PICTURES, Batch, moved
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.foreign import described

COLOUR = "HdrColor"


class Views:
    """Cameras behind a renderer's views.

    cameras: one for all views, or a camera for the name of each. settings: as for `gpusim.Batch`, such as device and
    output; luminance: what a value of 1 stands for [cd m-2]. Raises as Batch does.
    """

    def __init__(self, cameras: Camera | Mapping[str, Camera], **settings):
        named = cameras if isinstance(cameras, Mapping) else {"": cameras}
        self._batches = {name: Batch(camera, **settings) for name, camera in named.items()}

    def __call__(
        self, data: Mapping, *, number: int, seed: int = 0, exposure_time: float | None = None
    ) -> dict:
        """A frame of every view in `data`, by its name ("" of a single one), as `gpusim.Batch` gives it.

        Pictures (codes, linear light, XYZ) are (rows, cols, 3), as the renderer's are.
        number: of this call among all. Each view draws noise of its own, by its name. Raises BadData for data without
        such frames and views without a camera.
        """
        found = {
            key[len(COLOUR) :].lstrip("-_"): values
            for key, values in data.items()
            if key.startswith(COLOUR)
        }
        if not found:
            raise BadData(
                f"rendered data: {', '.join(map(str, data)) or 'nothing'}; wanted {COLOUR}: attach that "
                "annotator"
            )
        frames = {}
        for name in sorted(found):
            batch = self._batches.get(name) or self._batches.get("")
            if batch is None:
                raise BadData(
                    f"rendered data: no camera for the view {name!r}; there are {', '.join(self._batches)}"
                )
            picture = channels_first(found[name])
            own = (
                seed + crc32(name.encode())
            ) % 2**64  # by its name alone: other views may come and go
            made = batch(picture, first=number, seed=own, exposure_time=exposure_time)[0]
            frames[name] = moved(made, 0, -1) if batch.output in PICTURES else made
        return frames


def channels_first(frame):
    """Linear RGB (1, 3, rows, cols) of a frame (rows, cols, 3 or 4), of the same library. Raises BadData."""
    values = described(frame, COLOUR)
    if len(values.shape) != 3 or values.shape[2] not in (3, 4):
        raise BadData(f"{COLOUR}: {tuple(values.shape)}, wanted (rows, cols, 4) or (rows, cols, 3)")
    if hasattr(values, "permute"):  # torch's
        return values.permute(2, 0, 1)[None, :3].contiguous()
    turned = values.transpose((2, 0, 1))
    if hasattr(turned, "contiguous"):  # Warp's
        rows, cols = turned.shape[1:]
        return turned[:3].contiguous().reshape((1, 3, rows, cols))
    return (
        np.ascontiguousarray(turned[:3])[None]
        if isinstance(turned, np.ndarray)
        else turned[:3][None].copy()
    )

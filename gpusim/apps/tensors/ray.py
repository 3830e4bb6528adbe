"""For Ray Data: a callable class for `map_batches`, one device for each actor. Ray itself is not imported here.

    pictures.map_batches(gpusim.apps.tensors.ray.Frames, fn_constructor_kwargs={"camera": camera, "device":
                         "warp:cuda:0"}, batch_size=32, concurrency=4, num_gpus=1)

Each row needs its own number, by which its noise is drawn: the result does not depend on how Ray shares the rows out.
"""

import numpy as np

from gpusim.apps.tensors.batches import PICTURES, Batch
from gpusim.domain.errors import BadData


class Frames:
    """Rows with a picture and a number to rows with a frame, too.

    camera, settings: as for `gpusim.Batch`. picture, number: names of the columns: linear light (rows, cols, channels)
    or (channels, rows, cols), as `channels_last` says, and whole numbers. frame: name of the new column, whose pictures
    (codes, linear light, XYZ) have their channels there, too. seed: of the noise. exposure_time [s], gain: numbers, or
    names of columns that have them. Raises as Batch does, and BadData for columns that are not there.
    """

    def __init__(
        self,
        camera,
        *,
        picture: str = "image",
        number: str = "number",
        frame: str = "frame",
        seed: int = 0,
        channels_last: bool = True,
        exposure_time: float | str | None = None,
        gain: float | str = 1.0,
        **settings,
    ):
        self._batch, self._seed, self._channels_last = (
            Batch(camera, **settings),
            seed,
            channels_last,
        )
        self._picture, self._number, self._frame = picture, number, frame
        self._settings = {"exposure_time": exposure_time, "gain": gain}

    def __call__(self, rows: dict) -> dict:
        """The rows of a batch, columns by name, with their frames."""
        pictures, numbers = self._column(rows, self._picture), self._column(rows, self._number)
        settings = {
            name: self._column(rows, value) if isinstance(value, str) else [value] * len(numbers)
            for name, value in self._settings.items()
        }
        frames = []
        for item, number in enumerate(numbers):
            picture = np.asarray(pictures[item])
            picture = np.moveaxis(picture, -1, 0) if self._channels_last else picture
            own = {name: value[item] for name, value in settings.items()}
            made = self._batch(
                np.ascontiguousarray(picture[None]), first=int(number), seed=self._seed, **own
            )
            is_turned = self._channels_last and self._batch.output in PICTURES
            frames.append(np.moveaxis(made[0], 0, -1) if is_turned else made[0])
        return rows | {self._frame: np.stack(frames)}

    def _column(self, rows, name):
        if name not in rows:
            raise BadData(f"rows: no column {name!r}; there are {', '.join(map(str, rows))}")
        return rows[name]

"""For Ray Data: a callable class for `map_batches`, one device for each actor.

Ray itself is not imported here.

    pictures.map_batches(gpusim.apps.tensors.ray.Frames, fn_constructor_kwargs={"camera": camera,
                         "device": "warp:cuda:0"}, batch_size=32, concurrency=4, num_gpus=1)

Each row needs its own number, which selects its noise. The result does not depend on how Ray
distributes the rows.
"""

from itertools import groupby

import numpy as np

from gpusim.apps.tensors.batches import PICTURES, PictureBatch
from gpusim.domain.errors import BadData, checked_count


class Frames:
    """Adds a column of frames to rows with a picture and a number.

    Args:
        camera: Camera, see `gpusim.PictureBatch`.
        picture: Column of pictures: linear light (rows, cols, channels) or (channels, rows, cols).
        number: Column of whole numbers, different in each row.
        frame: New column. Its pictures (codes, linear light, XYZ) have the same order of axes.
        seed: Seed of the noise.
        channels_last: Whether the channels of pictures come last.
        at_once: Most rows in one call of the device, which has memory for them.
        exposure_time: Exposure time [s], or the column that has it.
        gain: Analog gain, or the column that has it.
        settings: Other arguments of `gpusim.PictureBatch`.

    Raises:
        BadData: When called with rows without these columns.
        GpusimError: As `gpusim.PictureBatch` does.
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
        at_once: int = 32,
        exposure_time: float | str | None = None,
        gain: float | str = 1.0,
        **settings,
    ):
        self._batch, self._seed = PictureBatch(camera, **settings), seed
        self._channels_last, self._at_once = channels_last, checked_count("at_once", at_once)
        self._picture, self._number, self._frame = picture, number, frame
        self._settings = {"exposure_time": exposure_time, "gain": gain}

    def __call__(self, rows: dict) -> dict:
        """Return the rows of a batch, columns by name, with their frames."""
        pictures, numbers = self._column(rows, self._picture), self._column(rows, self._number)
        settings = {
            name: self._column(rows, value) if isinstance(value, str) else [value] * len(numbers)
            for name, value in self._settings.items()
        }
        frames: list[np.ndarray] = []
        for items in self._groups(pictures, len(numbers)):
            turned = [self._turned(np.asarray(pictures[item]), -1, 0) for item in items]
            own = {name: [value[item] for item in items] for name, value in settings.items()}
            first = [int(numbers[item]) for item in items]
            made = self._batch(np.stack(turned), first=first, seed=self._seed, **own)
            is_turned = self._batch.output in PICTURES
            frames += [self._turned(one, -3, -1) if is_turned else one for one in made]
        return rows | {self._frame: np.stack(frames)}

    def _groups(self, pictures, count):
        """Yield the neighbouring rows with pictures of one shape and type that the device gets at once."""
        kinds = [(np.shape(one), np.asarray(one).dtype) for one in pictures]
        for _, items in groupby(range(count), kinds.__getitem__):
            rest = [*items]
            while rest:
                yield rest[: self._at_once]
                rest = rest[self._at_once :]

    def _turned(self, array, axis, to):
        """Return an array with its channels moved, if the pictures have them last."""
        return np.moveaxis(array, axis, to) if self._channels_last else array

    def _column(self, rows, name):
        """Return a column. Raises BadData."""
        if name not in rows:
            raise BadData(f"rows: no column {name!r}; there are {', '.join(map(str, rows))}")
        return rows[name]

"""Files of events from event cameras."""

from os import PathLike

import numpy as np

from gpusim.io.archive import write_archive


def write_events(path: str | PathLike, events: np.ndarray, shape: tuple[int, int]) -> None:
    """Write events as .npz: t [s], x, y, p, and rows and columns of the sensor as `shape`.

    Args:
        path: file to write.
        events: array of EVENT, see `EventSensor.events`.
        shape: rows and columns of the sensor.

    Raises:
        BadFile: if the file cannot be written.
    """
    write_archive(path, {"shape": np.array(shape), **{key: events[key] for key in "txyp"}})

"""Events of event cameras as files."""

import numpy as np

from gpusim.io.atomic import atomic_path


def write_events(path, events: np.ndarray, shape: tuple[int, int]) -> None:
    """Write events as .npz: t [s], x, y, p, and rows and columns of the sensor as `shape`. Raises BadFile."""
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(
            file, shape=np.array(shape), t=events["t"], x=events["x"], y=events["y"], p=events["p"]
        )

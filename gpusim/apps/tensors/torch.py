"""For PyTorch: a module that computes frames, and data sets of noisy and clean frames.

Not differentiable: no gradient goes through a frame. Needs torch, which gpusim does not install.
"""

import os
from argparse import ArgumentTypeError
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Dataset, IterableDataset, get_worker_info

from gpusim.apps.pairs.pairs import Pairs
from gpusim.apps.pairs.variety import Variety, scene_options
from gpusim.apps.tensors.batches import PictureBatch
from gpusim.captures.capture import Capture
from gpusim.domain.errors import BadData
from gpusim.io.scene.scenes import open_scene
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


class Frames(torch.nn.Module):
    """`gpusim.PictureBatch` as a module, without parameters and without gradients.

    Args:
        camera: Camera.
        settings: Other arguments of `gpusim.PictureBatch`.
    """

    def __init__(self, camera, **settings):
        super().__init__()
        self.batch = PictureBatch(camera, **settings)

    def forward(self, pictures: torch.Tensor, **settings) -> torch.Tensor:
        """Return frames of pictures (B, C, rows, cols).

        settings: as of a call of `gpusim.PictureBatch`.
        """
        return self.batch(pictures.detach(), **settings)


class PairSet(Dataset):
    """Noisy and clean raw values of photographs, as of `gpusim pairs`.

    An item has the tensors "raw" (rows, cols) [DN], "clean" (rows, cols) [DN] and, with pictures,
    "rgb" (3, rows, cols), and "record", a dictionary of its settings. It depends only on its number
    and the seed. Each process opens the device again. Forked processes cannot do so if their parent
    has opened it: use "spawn" then.

    Args:
        photographs: Files.
        camera: Camera.
        vary: Settings that are drawn for each pair, as for `gpusim pairs --vary`; "" for none.
        each: Pairs per photograph.
        seed: Seed of the noise and of the drawn settings.
        device: Name of the device, see `Simulator`.
        tolerance: Tolerance, see `Simulator`.
        pictures: Whether items have "rgb".
        plan: Plan of all pairs, see `Simulator`.
        capture: Capture of each pair, see `gpusim.captures`.
        options: Options of `open_scene`.

    Raises:
        BadData: If there are no photographs, or `vary` is malformed.
        GpusimError: As `Simulator` does.
    """

    def __init__(
        self,
        photographs: Sequence,
        camera,
        *,
        vary: str = "",
        each: int = 1,
        seed: int = 0,
        device="auto",
        tolerance="video",
        pictures: bool = False,
        plan: Plan | None = None,
        capture: Capture | None = None,
        **options,
    ):
        self._photographs = [Path(path) for path in photographs]
        if not self._photographs:
            raise BadData("photographs: none, wanted the names of some files")
        self._simulator = camera, device, tolerance
        try:
            variety = Variety.parse(vary) if vary else Variety()
        except ArgumentTypeError as error:  # as of a command line
            raise BadData(f"vary: {error}") from None
        self._settings = variety, each, seed, pictures, plan, capture
        self._options, self._pairs, self._process = options, None, 0
        # raises errors early, without opening a driver
        Simulator(camera, device="numpy", tolerance=tolerance)

    def __len__(self) -> int:
        return len(self._photographs) * self._settings[1]

    def __getitem__(self, number: int) -> dict:
        if not -len(self) <= number < len(self):
            raise IndexError(f"pair {number} of {len(self)}")
        pair = self._here().pair(number % len(self))
        made = {
            name: torch.from_numpy(np.array(part)) if isinstance(part, np.ndarray) else part
            for name, part in pair.items()
        }
        return made | ({"rgb": made["rgb"].movedim(-1, -3)} if "rgb" in made else {})

    def __getstate__(self):
        return self.__dict__ | {"_pairs": None}

    def _here(self):
        """Return the pairs of this process; a device's context does not work in another one."""
        if self._pairs is None or self._process != os.getpid():
            camera, device, tolerance = self._simulator
            simulator = Simulator(camera, device=device, tolerance=tolerance)
            self._pairs = Pairs(simulator, self._photographs, self._open, *self._settings)
            self._process = os.getpid()
        return self._pairs

    def _open(self, path, values):
        """Return the scene of a path and of drawn values."""
        return open_scene(path, **(self._options | scene_options(values)))


class PairStream(IterableDataset):
    """Items of a PairSet in order; each worker of a loader computes its share."""

    def __init__(self, pairs: PairSet):
        self.pairs = pairs

    def __iter__(self) -> Iterator[dict]:
        worker = get_worker_info()
        first, step = (0, 1) if worker is None else (worker.id, worker.num_workers)
        return (self.pairs[number] for number in range(first, len(self.pairs), step))

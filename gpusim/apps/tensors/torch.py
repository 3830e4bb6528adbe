"""For PyTorch: frames as a module, and pairs of photographs as data sets whose workers are processes.

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
from gpusim.apps.pairs.variety import Variety
from gpusim.apps.tensors.batches import Batch
from gpusim.domain.errors import BadData
from gpusim.io.scene.scenes import open_scene
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan


class Frames(torch.nn.Module):
    """Batches of pictures to frames: `gpusim.Batch` as a module, without parameters and without gradients.

    settings: as for Batch. `forward` takes what a call of it takes.
    """

    def __init__(self, camera, **settings):
        super().__init__()
        self.batch = Batch(camera, **settings)

    def forward(self, pictures: torch.Tensor, **settings) -> torch.Tensor:
        """Frames of pictures (B, C, rows, cols): see `gpusim.Batch`."""
        return self.batch(pictures.detach(), **settings)


class PairSet(Dataset):
    """Noisy raw values of photographs and the light that they are of, as `gpusim pairs` makes them.

    photographs: files. camera: a Camera. vary: as for `gpusim pairs --vary`, "" for nothing. each: pairs of every
    photograph. device, tolerance, plan: as for `Simulator`. pictures: codes beside them. options: of `open_scene`.
    An item has "raw" (rows, cols), "clean" (rows, cols) [DN], "rgb" (3, rows, cols) if asked for, as tensors, and
    "told". It depends on its number and the seed alone. Each process that asks for items opens the device for itself;
    forked ones cannot where their parent has done so before: start them by "spawn" then.
    Raises as Simulator does, and BadData for no photographs and for ranges that are none.
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
        **options,
    ):
        self._photographs = [Path(path) for path in photographs]
        if not self._photographs:
            raise BadData("photographs: none, wanted the names of some files")
        self._made_by = camera, device, tolerance
        try:
            variety = Variety.parse(vary) if vary else Variety()
        except ArgumentTypeError as error:  # of a command line's option
            raise BadData(f"vary: {error}") from None
        self._asked = variety, each, seed, pictures, plan
        self._options, self._pairs, self._process = options, None, 0
        Simulator(
            camera, device="numpy", tolerance=tolerance
        )  # says what is wrong, and opens no driver: see below

    def __len__(self) -> int:
        return len(self._photographs) * self._asked[1]

    def __getitem__(self, number: int) -> dict:
        if not -len(self) <= number < len(self):
            raise IndexError(f"pair {number} of {len(self)}")
        pair = self._here().pair(number % len(self))
        made = {
            name: torch.from_numpy(np.array(part)) if isinstance(part, np.ndarray) else part
            for name, part in pair.items()
        }
        return made | ({"rgb": made["rgb"].movedim(-1, 0)} if "rgb" in made else {})

    def __getstate__(self):
        return self.__dict__ | {"_pairs": None}

    def _here(self):
        """The pairs of this process: a device's context is no use in another one."""
        if self._pairs is None or self._process != os.getpid():
            camera, device, tolerance = self._made_by
            simulator = Simulator(camera, device=device, tolerance=tolerance)
            self._pairs = Pairs(simulator, self._photographs, self._opened, *self._asked)
            self._process = os.getpid()
        return self._pairs

    def _opened(self, path, values):
        drawn = {name: values[name] for name in ("light", "luminance") if name in values}
        return open_scene(path, **(self._options | drawn))


class PairStream(IterableDataset):
    """The items of a PairSet in order, of which each worker of a loader makes its share."""

    def __init__(self, pairs: PairSet):
        self.pairs = pairs

    def __iter__(self) -> Iterator[dict]:
        worker = get_worker_info()
        first, step = (0, 1) if worker is None else (worker.id, worker.num_workers)
        return (self.pairs[number] for number in range(first, len(self.pairs), step))

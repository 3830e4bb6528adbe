"""A cube to mean electrons: a transform for each band in other libraries, and gpusim's frame."""

from functools import partial
from importlib.util import find_spec
from itertools import cycle

import numpy as np

from gpusim.backends import Device
from gpusim.bench.baseline import Baseline
from gpusim.bench.peer_task import Task
from gpusim.bench.timing import find_rms
from gpusim.data.charts import chart
from gpusim.domain.content import Cube
from gpusim.domain.cores import count_cores
from gpusim.domain.scene import Scene
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.simulator import Simulator

SECONDS = 0.01  # exposure time


class WithDucc(Baseline):
    """The baseline with ducc0's transforms."""

    def forward(self, plane):
        """See Baseline."""
        import ducc0

        return ducc0.fft.r2c(plane, axes=(0, 1), nthreads=count_cores())

    def inverse(self, spectra):
        """See Baseline."""
        import ducc0

        return ducc0.fft.c2r(
            spectra,
            axes=(1, 2),
            lastsize=self.plan.period[1],
            forward=False,
            inorm=2,
            nthreads=count_cores(),
            allow_overwriting_input=True,
        )


class WithTorch(Baseline):
    """The baseline in PyTorch, with the cube and the tables on its device."""

    def __init__(self, simulator: Simulator, scene: Scene, place: str):
        import torch

        super().__init__(simulator, scene)
        torch.set_num_threads(count_cores())
        self.place = place
        self.there = {
            name: torch.from_numpy(np.ascontiguousarray(getattr(self, name))).to(place)
            for name in ("tables", "mix", "falloff")
        }

    def mean(self, cube, seconds):
        """Return the mean electrons of a cube; both are tensors."""
        import torch

        rows, cols = cube.shape[1:]
        (top, left), (high, wide) = self.before, self.plan.period
        pads = (left, wide - cols - left, top, high - rows - top)
        tables, mix = self.there["tables"], self.there["mix"]
        sums = torch.zeros(
            (len(mix), high, wide // 2 + 1), dtype=torch.complex64, device=self.place
        )
        for band, table, weights in zip(cube, tables, mix.T, strict=True):
            padded = torch.nn.functional.pad(band[None, None], pads, mode="replicate")[0, 0]
            sums += weights[:, None, None] * (torch.fft.rfft2(padded) * table)
        channels = torch.fft.irfft2(sums, (high, wide))[:, top : top + rows, left : left + cols]
        mosaic = torch.empty((rows, cols), device=self.place)
        for (dy, dx), channel in np.ndenumerate(self.cfa):
            step_y, step_x = self.cfa.shape
            mosaic[dy::step_y, dx::step_x] = channels[int(channel), dy::step_y, dx::step_x]
        result = mosaic.clamp_(min=0) * (self.there["falloff"] * seconds)
        if self.place != "cpu":
            torch.cuda.synchronize()
        return result


def make_frame(device: Device, size: tuple[int, int], tolerance: float | None) -> Task:
    """Return the task: a cube of 31 bands to the mean electrons of a phone's camera.

    The truth is the float64 reference. gpusim's cubes stay on its device, those of PyTorch on its
    own; the other libraries read and write host memory and use all cores.

    Args:
        device: The device of gpusim's forms.
        size: Columns and rows [pixel].
        tolerance: Relative RMS error of one of gpusim's forms; None: no such form.
    """
    picture, camera = chart("deadleaves", size=size), open_camera("phone")
    values = np.asarray(picture.content.bands_at(slice(None)), np.float32)
    cubes = [values, values * np.float32(1.01)]
    scenes = [
        Scene(Cube(picture.wavelengths, part), picture.illuminant, picture.border) for part in cubes
    ]
    truth = Simulator(camera, device="numpy").expose(scenes[0], SECONDS).mean
    exact, task = Simulator(camera, device=device), Task("frame", "SciPy")

    def ours(limit):
        there = [
            Scene(Cube(picture.wavelengths, device.array(part)), picture.illuminant, picture.border)
            for part in cubes
        ]
        loop = Simulator(camera, device=device, tolerance=limit).loop(there[0], SECONDS)
        given = cycle(there[::-1])
        error = f"rms {find_rms(device.numpy(loop.output('mean')), truth):.1e}"

        def run():
            loop.update(scene=next(given)).output("mean")
            device.sync()

        return run, error

    def peer(kind, *where):
        made, given = kind(exact, scenes[0], *where), cubes
        if where:
            import torch

            given = [torch.from_numpy(part).to(*where) for part in cubes]
        result = made.mean(given[0], SECONDS)
        error = f"rms {find_rms(result.cpu() if where else result, truth):.1e}"
        following = cycle(given[::-1])
        return lambda: made.mean(next(following), SECONDS), error

    task.add("SciPy", partial(peer, Baseline))
    task.add("ducc0", partial(peer, WithDucc), "ducc0")
    task.add("PyTorch", partial(peer, WithTorch, "cpu"), "torch")
    if device.is_gpu and find_spec("torch"):
        import torch

        if torch.cuda.is_available():
            task.add("PyTorch, CUDA", partial(peer, WithTorch, "cuda"), "torch")
    task.add("gpusim, every band", partial(ours, None))
    if tolerance:
        task.add(f"gpusim, tolerance {tolerance:g}", partial(ours, tolerance))
    return task

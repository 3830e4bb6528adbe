"""Photon noise and read noise of a frame, from gpusim and other generators."""

from functools import partial
from importlib.util import find_spec

import numpy as np

from gpusim.backends import Device
from gpusim.bench import baseline
from gpusim.bench.peer_task import Task
from gpusim.domain.cores import count_cores
from gpusim.kernels.stage import public_function

LEVEL = 7.3  # [e-] at which counts are compared with the law
READ = 2.0  # [e-] of read noise
RANGE = 0.1, 10_000.0  # [e-] of a frame's mean
LEAST = 20  # expected counts in a class of the test


def make_noise(device: Device, size: tuple[int, int]) -> Task:
    """Return the task: a frame of mean electrons to electrons with photon and read noise.

    The truth is Poisson's law: the error is chi squared over its degrees of freedom for the counts
    of a flat frame without read noise, 1 for a perfect generator, with its chance to be larger.

    Args:
        device: The device of gpusim's form.
        size: Columns and rows [pixel].
    """
    cols, rows = size
    ramp = np.geomspace(*RANGE, cols, dtype=np.float32)
    mean = np.broadcast_to(ramp, (rows, cols)).copy()
    flat = np.full((rows, cols), LEVEL, np.float32)
    task = Task("noise", "NumPy")

    def judge(make):
        """Return a form and its error. make(mean, read): gives the function of a frame."""
        return make(mean, READ), _compare_counts(make(flat, 0.0)())

    task.add("NumPy", partial(judge, _by_numpy))
    task.add("PyTorch", partial(judge, partial(_by_torch, "cpu")), "torch")
    if device.is_gpu and find_spec("torch"):
        import torch

        if torch.cuda.is_available():
            task.add("PyTorch, CUDA", partial(judge, partial(_by_torch, "cuda")), "torch")
    task.add("GalSim", partial(judge, _by_galsim), "galsim")
    task.add("scikit-image", partial(judge, _by_skimage), "skimage")
    for photon in ("fast", "exact") if device.has_fp64 else ("fast",):
        task.add(f"gpusim, {photon}", partial(judge, partial(_by_gpusim, device, photon)))
    return task


def _compare_counts(electrons):
    """Return chi squared of counts over its degrees of freedom, in words."""
    from scipy.stats import chisquare, poisson

    counts = np.bincount(np.rint(np.asarray(electrons, np.float64)).astype(int).ravel())
    total = counts.sum()
    law = total * poisson.pmf(np.arange(len(counts)), LEVEL)
    inner = np.flatnonzero(law >= LEAST)
    low, high = inner[0], inner[-1] + 1
    seen = [*counts[low:high], total - counts[low:high].sum()]
    wanted = [*law[low:high], total - law[low:high].sum()]
    found = chisquare(seen, wanted)
    return f"chi2/dof {found.statistic / (len(seen) - 1):.2f} (p {found.pvalue:.2f})"


def _by_numpy(mean, read):
    random = np.random.default_rng(1)
    return lambda: baseline.noise(random, mean, read)


def _by_torch(place, mean, read):
    import torch

    torch.set_num_threads(count_cores())
    random = torch.Generator(place).manual_seed(1)
    there = torch.from_numpy(mean).to(place)
    is_gpu = place != "cpu"

    def run():
        light = torch.poisson(there, random)
        if read:
            light += read * torch.randn(light.shape, generator=random, device=place)
        if is_gpu:
            torch.cuda.synchronize()
        return light.cpu() if mean.flat[0] == mean.flat[-1] else light

    return run


def _by_galsim(mean, read):
    import galsim

    random = galsim.BaseDeviate(1)

    def run():
        image = galsim.Image(mean, dtype=np.float32, copy=True)
        image.addNoise(galsim.PoissonNoise(random))
        if read:
            image.addNoise(galsim.GaussianNoise(random, sigma=read))
        return image.array

    return run


def _by_skimage(mean, read):
    from skimage.util import random_noise

    random = np.random.default_rng(1)
    # its unit is the power of 2 above the number of different values, of values up to 1
    unit = 2 ** np.ceil(np.log2(len(np.unique(mean))))

    def run():
        light = random_noise(mean / unit, "poisson", rng=random, clip=False) * unit
        return (
            random_noise(light, "gaussian", rng=random, clip=False, var=read**2) if read else light
        )

    return run


def _by_gpusim(device, photon, mean, read):
    there, made = device.array(mean), public_function("sensor.noise")
    count = iter(range(2**32))

    def run():
        options = {"full_well": 1e6, "gain": 1.0, "photon": photon, "electrons": True}
        electrons = made(there, **options, read_noise=read, frame=next(count), device=device)
        device.sync()
        return device.numpy(electrons) if mean.flat[0] == mean.flat[-1] else electrons

    return run

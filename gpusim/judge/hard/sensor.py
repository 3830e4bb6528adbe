"""Wells, darkness, rounding and many frames: cases 25 to 28."""

import warnings
from dataclasses import replace

import numpy as np

from gpusim.domain.noise import Noise
from gpusim.judge.hard.acceptance import ALPHA
from gpusim.judge.hard.case import Found, case
from gpusim.judge.hard.maps import probabilities
from gpusim.judge.hard.photons import (
    IDEAL,
    WITHOUT_CONVERTER,
    electrons,
    f32,
    kinds,
    unlike_reference,
)
from gpusim.kernels.sensor.noise import noise
from gpusim.pipeline.readout import Readout
from gpusim.pipeline.report import Error


def clipped_error(mean: float, photon: str) -> float:
    """Return the error of the mean of counts in a well as deep as their mean [e-].

    The distribution is from the map of the sampler. E max(k - m, 0) = m P(k = floor(m)): half the
    mean deviation of de Moivre.
    """
    from scipy import stats

    k, p = probabilities(mean, photon)
    return float(
        abs((np.minimum(k, mean) * p).sum() - (mean - mean * stats.poisson.pmf(mean, mean)))
    )


@case(
    25,
    "saturation",
    "the well clips before read noise, the converter after it; clipped means within 1e-3 e- of "
    "the analytic",
)
def saturation(device):
    from scipy import stats

    full = electrons(np.full((512, 512), 1e4), device, full_well=100.0, read_noise=5.0)
    # a clip after read noise would leave none above
    p = stats.kstest(((full.astype(np.float64) - 100) / 5).ravel(), "norm").pvalue
    yield Found(ALPHA / max(p, 1e-300), 1.0, "1e-6 over the p-value of read noise on a full well")
    for photon in kinds(device):
        wrong = max(clipped_error(mean, photon) for mean in (8.0, 20.0, 100.0, 1e4))
        yield Found(wrong, 1e-3, f"mean of clipped counts [e-], {photon}")
        yield unlike_reference(device, photon, np.full((256, 256), 20.0))
    # sigma 0.49, so 1.2e-4 of the mean
    few = electrons(np.full((4096, 4096), 0.5), device, full_well=1.0).mean(dtype=np.float64)
    yield Found(abs(few + np.expm1(-0.5)), 1e-3, "mean of 2^24 counts in a well of 1 e-")
    for end in ("black", "white"):
        yield Found(_converter(end, device), 1e-3, f"converter's {end} [e-]")


def _converter(end, device, gain=100.0, sigma=0.5, size=2048):
    """Return the error of the mean of numbers that are clipped in the middle of their noise [e-].

    Its standard deviation is 1.4e-4.
    """
    black = 300.0 if end == "black" else 65535 - 300.0
    level = (0 if end == "black" else 65535) - black  # [DN] above black
    mean = np.full((size, size), max(level, 0) / gain, f32)
    offset = np.full((size, size), min(level, 0) / gain, f32)  # a scene has no negative electrons
    settings = IDEAL | {"gain": gain, "black_level": black, "read_noise": sigma}
    dn = noise(mean, offset, **settings, photon="none", seed=2, device=device)
    half = sigma / np.sqrt(2 * np.pi)  # mean of the remaining half of a normal distribution
    exact = level / gain + (half if end == "black" else -half)
    return abs((dn.mean(dtype=np.float64) - black) / gain - exact)


@case(
    26,
    "darkness",
    "no scene, 1e-4 e- of dark current: mean and variance to 5 sigma at n = 2^24; no 0 / 0 in errors",
)
def darkness(device):
    for photon in kinds(device):
        sensor = replace(WITHOUT_CONVERTER, noise=Noise(photon=photon, dark_current=1e-4))
        black = device.array(np.zeros((4096, 4096), f32))
        k = device.numpy(Readout(sensor, device).draw(black, 1.0, seed=1)).astype(np.float64)
        n, rate = k.size, float(f32(1e-4))
        yield Found(abs(k.sum() - n * rate) / np.sqrt(n * rate), 5, f"mean [sigma], {photon}")
        # the squares have the variance n (m + 2 m^2)
        wrong = abs(((k - rate) ** 2).sum() - n * rate) / np.sqrt(n * (rate + 2 * rate**2))
        yield Found(wrong, 5, f"variance [sigma], {photon}")
    dark = np.zeros((4, 5))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        none, some = Error.between(dark, dark, 0.0), Error.between(dark + 1e-3, dark, 0.0)
    figures = some.rms, some.max_local, some.p999_sigma, some.max_sigma
    is_sane = some.rms > 0 and np.isfinite(figures).all() and none == Error(0.0, 0.0, 0.0, 0.0)
    yield Found(0 if is_sane else 1, 0, "the error without light")


@case(27, "rounding", "0.1 and 10 e-/DN: bias <= 1e-3 DN")
def rounding(device):
    steps = 100
    for electrons_per_dn in (0.1, 10.0):
        gain = 1 / electrons_per_dn
        # exactly 100 DN long
        ramp = (np.arange(2**18) + 0.5).reshape(512, 512) * steps / 2**18 / gain
        settings = IDEAL | {"gain": gain, "black_level": 64, "photon": "none"}
        error = noise(ramp.astype(f32), **settings, device=device) - (gain * ramp + 64)
        yield Found(abs(error.mean()), 1e-3, f"bias [DN] at {electrons_per_dn:g} e-/DN")
        # a float32 level near 164 is within 2^-17 of the exact one
        yield Found(np.abs(error).max(), 0.5 + 2.0**-16, "largest error [DN]")


@case(28, "many frames", "10 000 frames averaged: mean <= 1e-6 relative, nothing lost in the sum")
def many_frames(device):
    """4e7 numbers with a relative noise of 1e-3 leave 1.6e-7, and 1e7 of them leave 3e-7.

    The sum of 700 frames exceeds 2^24 and is exact.
    """
    from scipy import stats

    level, count = 1e6, 10_000
    for bits, size in ((16, 64), (32, 32)):
        readout = Readout(replace(WITHOUT_CONVERTER, bits=bits, gain=0.05, full_well=2e6), device)
        even = device.array(np.full((size, size), level, f32))
        mean = readout.average(even, 1.0, count, seed=6) / 0.05
        spread = np.sqrt((level + (20**2 / 12 if bits == 16 else 0)) / count)
        p = stats.kstest(((mean - level) / spread).ravel(), "norm").pvalue
        yield Found(abs(mean.mean() / level - 1), 1e-6, f"relative error of the mean, {bits} bits")
        yield Found(ALPHA / max(p, 1e-300), 1.0, f"1e-6 over the p-value of the means, {bits} bits")
        sensor = replace(WITHOUT_CONVERTER, bits=bits, gain=1.0, noise=Noise(read=1.0))
        readout = Readout(sensor, device)
        number = int if bits == 16 else float
        expected = device.array(np.array([[6e4, 59999.0, 1.0]], f32))
        drawn = [readout.draw(expected, 1.0, seed=2, first=5 + frame) for frame in range(700)]
        frames = np.array([device.numpy(one)[0] for one in drawn])
        exact = np.array([sum(map(number, one.tolist())) / 700 for one in frames.T])
        lost = np.abs(readout.average(expected, 1.0, 700, seed=2, first=5)[0] / exact - 1).max()
        yield Found(lost, 700 * 2.0**-53, f"lost in the sum, {bits} bits")

"""A tutorial's noise against a camera's noise, on the same linear frames.

    python bench/replacement.py --device opencl --out bench/replacement.png

NVIDIA's Replicator tutorial for augmentations adds normal noise with one standard deviation to
8-bit RGB. This script does the same to frames of a renderer (linear RGB and alpha, float16), and
sends the same frames through a camera.
"""

import argparse
from dataclasses import replace

import matplotlib
import numpy as np
from results import count, start

import gpusim as gs
from gpusim.cli.main import OneLineParser
from gpusim.domain.display import DISPLAYS
from gpusim.io.atomic import check_output

matplotlib.use("Agg")
from matplotlib import pyplot

SIGMA = 5.0  # of the tutorial's kernel [code]
ROWS, COLS = 64, 256
LEAST = 2e-3  # of a ramp of light up to 1
SECONDS = 0.06  # exposure that puts white at the largest code


def rendered() -> np.ndarray:
    """Return a grey ramp with alpha, like a renderer's linear frame: float16 (rows, cols, 4)."""
    frame = np.ones((ROWS, COLS, 4), np.float16)
    frame[..., :3] = np.geomspace(LEAST, 1, COLS)[None, :, None]
    return frame


def tutorial(frame, count, random) -> np.ndarray:
    """Return 8-bit codes with normal noise of one sigma, (count, rows, cols)."""
    codes = np.round(255 * DISPLAYS["srgb"].encode(np.clip(frame[..., 1].astype(float), 0, 1)))
    return np.clip(np.round(codes + SIGMA * random.standard_normal((count, *codes.shape))), 0, 255)


def moments(codes) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and variance over frames (count, rows, cols) in each column."""
    return codes.mean(axis=(0, 1)), codes.astype(float).var(axis=0, ddof=1).mean(axis=0)


def expected(raw_mean, sensor) -> np.ndarray:
    """Return the theoretical variance of raw values [DN^2]: photons, read noise and rounding."""
    gain = sensor.gain_dn_per_electron
    return gain * (raw_mean - sensor.dark_level) + (gain * sensor.read_sigma) ** 2 + 1 / 12


def several(text: str) -> int:
    """Parse a number of frames large enough for a variance."""
    value = count(text)
    if value < 2:
        raise argparse.ArgumentTypeError(f"{text!r}: wanted 2 frames or more")
    return value


def main():
    """Plot, and print the deviation of the camera's raw variance from theory."""
    made = OneLineParser(description=__doc__.splitlines()[0])
    made.add_argument("--device", default="auto", help="as for gpusim simulate (default: auto)")
    made.add_argument("--count", type=several, default=200, help="frames, 2 or more (default: 200)")
    made.add_argument("--out", default="replacement.png", metavar="FILE")
    arguments = made.parse_args()
    check_output(arguments.out)
    base, frame = gs.open_camera("machine-vision"), rendered()
    noise = replace(
        base.sensor.noise, prnu=0.0, dsnu=0.0
    )  # fixed patterns vary over pixels, not in time
    base = replace(
        base,
        sensor=replace(base.sensor, noise=noise),
        optics=replace(base.optics, relative_illumination="none"),
    )
    pictures = np.repeat(frame[None, ..., :3].transpose(0, 3, 1, 2), arguments.count, axis=0)
    codes, raw = (
        gs.PictureBatch(base, device=arguments.device, output=output)(
            pictures, exposure_time=SECONDS, seed=1
        )
        for output in ("codes", "raw")
    )
    sensor = gs.Simulator(base, device="numpy").camera.sensor
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(10, 4), layout="constrained")
    constant = tutorial(frame, arguments.count, np.random.default_rng(1))
    left.plot(*moments(constant), ".", ms=3, label="tutorial: constant sigma")
    left.plot(*moments(codes[:, 1]), ".", ms=3, label="gpusim, machine-vision")
    left.set(xlabel="mean [8-bit code]", ylabel="variance [code^2]", yscale="log")
    mean, variance = moments(raw[:, :, 1:-1])
    right.plot(mean, variance, ".", ms=3, label="gpusim raw")
    right.plot(
        np.sort(mean), expected(np.sort(mean), sensor), lw=1, label="photons + reading + rounding"
    )
    right.set(xlabel="mean [DN]", ylabel="variance [DN^2]", xscale="log", yscale="log")
    for axes in (left, right):
        axes.legend(frameon=False)
        axes.grid(alpha=0.3)
    figure.savefig(arguments.out, dpi=100)
    below = mean < 0.9 * sensor.white_level
    print(
        f"raw variance over theory: {np.median(variance[below] / expected(mean[below], sensor)):.3f} (median), "
        f"{arguments.count} frames; written {arguments.out}"
    )


if __name__ == "__main__":
    start(main)

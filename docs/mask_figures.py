"""Makes the picture and the numbers of docs/masks.md.

    python docs/mask_figures.py

Textures of the powers of natural scenes, 128 x 128 pixels, are blurred by the kernels of each distance, and get the
noise of ELECTRONS electrons a pixel: all apertures have equal light. A pair shares them.
"""

from pathlib import Path

import numpy as np
from scipy.signal import fftconvolve

import gpusim as gs
from gpusim.captures.coded_depth import coded_kernels, find_coded_depth
from gpusim.optics.lenses import lens_of

HERE = Path(__file__).parent / "pictures"
ELECTRONS = 10_000
WAVELENGTHS, WEIGHTS = np.array([530.0, 550.0, 570.0]), np.ones(3) / 3
FOCUS = 1.0  # [1/m]
# dioptres from the plane in focus: nearer, and on both sides
RANGES = {"nearer": np.linspace(0, 1, 9), "both sides": np.linspace(-0.5, 0.5, 9)}
SIDE, CONTRAST = 128, 0.3
CAMERA = gs.open_camera("machine-vision").with_(object_distance_m=1.0, f_number=2.0)
SHOWN = 0.6  # dioptres from focus of the transfer functions that are plotted
LEFT, RIGHT = gs.pupil_cells((1, 2))[0]


def apertures() -> dict:
    """Return cameras of each aperture by name: one, or two of a pair."""
    return {
        "open": [CAMERA],
        "MURA, 7 x 7": [CAMERA.with_(mask="mura-7")],
        "left half": [CAMERA.with_(mask=LEFT)],
        "Gaussian": [CAMERA.with_(mask="gaussian")],
        "pair: left and right half": [CAMERA.with_(mask=LEFT), CAMERA.with_(mask=RIGHT)],
    }


def texture(random, side):
    """Return a picture of mean 1 whose powers fall as f^-2."""
    f = np.maximum(np.hypot(np.fft.fftfreq(side)[:, None], np.fft.fftfreq(side)), 0.01)
    waves = np.fft.fft2(random.standard_normal((side, side))) / f
    waves[0, 0] = 0
    found = np.fft.ifft2(waves).real
    return 1 + CONTRAST * found / found.std()


def errors(cameras, diopters) -> np.ndarray:
    """Return the rms error of distances, in dioptres, at each distance, (D,)."""
    distances = 1 / (FOCUS + diopters)
    bank = [coded_kernels(camera, distances, WAVELENGTHS, WEIGHTS) for camera in cameras]
    size = max(one.shape[-1] for one in bank)
    bank = [np.pad(one, [(0, 0)] + [((size - one.shape[-1]) // 2,) * 2] * 2) for one in bank]
    noise, random = np.sqrt(len(cameras) / ELECTRONS), np.random.default_rng(1)
    found = []
    for number, place in enumerate(FOCUS + diopters):
        scene = texture(random, SIDE + size - 1)
        pictures = [
            fftconvolve(scene, kernels[number], "valid")
            + noise * random.standard_normal((SIDE, SIDE))
            for kernels in bank
        ]
        result = find_coded_depth(pictures, bank, distances, noise)
        found.append(np.sqrt(np.mean((1 / result.distances - place) ** 2)))
    return np.array(found)


def plot():
    """Plot transfer functions out of focus, along the rows."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axis = plt.subplots(figsize=(7, 3.2), layout="constrained")
    for name, cameras in apertures().items():
        if name.startswith("pair"):  # as one of them
            continue
        lens = lens_of(cameras[0])
        f = np.linspace(0, 0.5, 400)
        passed = lens.transfer([550.0], 0 * f, f / lens.pitch, distance=1 / (FOCUS + SHOWN))
        axis.semilogy(f, np.abs(passed[0]) + 1e-9, label=name)
    axis.set(xlabel="cycle / pixel", ylabel="modulation", ylim=(1e-3, 1.1), xlim=(0, 0.5))
    axis.legend(frameon=False, fontsize=8)
    figure.savefig(HERE / "masks.png", dpi=120)


def main():
    """Make the picture, and print the table."""
    plot()
    print("| aperture | light | " + " | ".join(RANGES) + " |")
    print("|---|---|" + "---|" * len(RANGES))
    for name, cameras in apertures().items():
        light = sum(one.optics.pupil.area for one in cameras)
        cells = (np.sqrt(np.mean(errors(cameras, one) ** 2)) for one in RANGES.values())
        print(
            f"| {name} | {light:.0%} | " + " | ".join(f"{one:.3f}" for one in cells) + " |",
            flush=True,
        )


if __name__ == "__main__":
    main()

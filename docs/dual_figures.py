"""Makes the picture of dual_pixels.md: python docs/dual_figures.py."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import gpusim as gs

MOVES = (-24.0, -16.0, -8.0, 0.0, 8.0, 16.0, 24.0)  # [um] of the sensor


def main():
    """Draw disparity against the sensor's displacement, and both pictures of a point."""
    camera = gs.open_camera("mono").with_(
        pixel_pitch_um=2.0,
        f_number=2.0,
        focal_length_mm=5.0,
        exposure_time_ms=5,
        **{"sensor.dual": {"split": "left-right"}},
    )
    light = np.zeros((96, 96, 2), np.float32)
    light[48, 48] = 1
    scene = gs.scene_from(
        light, [549.0, 551.0], light="D65", luminance=1e3, samples_per_pixel=2, border="zero"
    )
    at, found = np.arange(48) - 24, []
    for moved in MOVES:
        exposure = gs.Simulator(camera.with_(defocus_um=moved)).expose(scene)
        pictures = np.asarray(exposure.device.numpy(exposure.diodes), float)
        centres = [one.sum(axis=0) @ at / one.sum() for one in pictures]
        found.append(centres[1] - centres[0])
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
    slope = gs.disparity_slope(camera) * 1e-6
    left.plot(MOVES, slope * np.array(MOVES), label="distance of centroids of half pupils")
    left.plot(MOVES, found, "o", label="points in frames")
    left.set(xlabel="displacement of the sensor [um]", ylabel="disparity [pixel]")
    left.legend(fontsize=8)
    for one, name in zip(pictures, ("left", "right"), strict=True):
        right.plot(at, one.sum(axis=0) / pictures.sum(), label=name)
    right.set(
        xlim=(-12, 12), xlabel="column [pixel]", title=f"a point, {MOVES[-1]:g} um out of focus"
    )
    right.legend(fontsize=8)
    figure.savefig(Path(__file__).parent / "pictures" / "dual-disparity.png", dpi=100)


if __name__ == "__main__":
    main()

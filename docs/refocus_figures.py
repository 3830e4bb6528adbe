"""Makes the figure of docs/refocus.md, and prints its numbers.

python docs/refocus_figures.py
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from pictures import balls
from scipy.special import j1

import gpusim as gs

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from textured_views import (  # the textures of the tests
    HALF_DEPTH_OF_FOCUS,
    Waves,
    made_views,
    plane_views,
    thin_lens_slope,
)

HERE = Path(__file__).parent / "pictures"
FOCUS, F_NUMBER = 1.0, 1.2  # [m], [1]
RANGE = 0.5, 6.0  # [m]
PATCH, ACROSS = 32, 12  # [pixel], patches along an axis


def main():
    """Make the figure and print the tables."""
    matplotlib.use("Agg")
    draw(balls_views())
    patches()
    apertures()
    methods()


def balls_views():
    """Return 9 x 9 views of the balls, as sharp cameras in a large lens's pupil see them, with shot noise."""
    camera = gs.open_camera("machine-vision").with_(f_number=F_NUMBER)
    camera = replace(camera, optics=replace(camera.optics, object_distance=FOCUS))
    field = gs.light_field(balls(), camera, (9, 9))
    optics = replace(camera.optics.without_blur(), f_number=8.0, relative_illumination="none")
    sensor = replace(camera.sensor, noise=gs.Noise())
    simulate = gs.Simulator(replace(camera, optics=optics, sensor=sensor))
    scenes = [view for row in field.views for view in row]
    pictures = np.stack([simulate(view, seed=n).linear for n, view in enumerate(scenes)])
    pictures = pictures.reshape(9, 9, *pictures.shape[1:])
    return gs.ViewImages.of(pictures, camera, name="balls")


def draw(views):
    """Draw refocused pictures, one of a small aperture, one sharp everywhere, and the distances."""
    from matplotlib import pyplot as plt

    depth = gs.depth_from_views(views, distances=RANGE)
    sharp = gs.all_in_focus(views, depth, distances=RANGE)
    panels = {f"in focus at {one} m": gs.refocus(views, distance=one) for one in (0.65, 1.05, 2.2)}
    panels["a third of the aperture, 1.05 m"] = gs.refocus(views, distance=1.05, aperture=1 / 3)
    panels["in focus everywhere"] = sharp
    display, white = gs.open_display("srgb"), np.quantile(sharp, 0.999)
    figure, axes = plt.subplots(2, 3, figsize=(12, 5.6), layout="constrained")
    for axis, (title, picture) in zip(axes.flat, panels.items(), strict=False):
        axis.imshow(display.encode((picture / white).clip(0, 1)))
        axis.set_title(title, fontsize=10)
    known = np.isfinite(depth.uncertainty) & (depth.farthest / depth.nearest < 1.1)
    shown = np.where(known, depth.distance, np.nan)
    image = axes.flat[5].imshow(shown, vmin=0.6, vmax=4.5, cmap="viridis_r")
    axes.flat[5].set_title("distance [m]; white: not known to 10 %", fontsize=10)
    figure.colorbar(image, ax=axes.flat[5], fraction=0.035)
    for axis in axes.flat:
        axis.set_axis_off()
    figure.savefig(HERE / "refocus.png", dpi=80)
    plt.close(figure)
    print(f"slope of 1 diopter: {views.slope_per_diopter:.2f} pixels; known: {known.mean():.0%}")


def patches():
    """Print how many textured patches are found at their distance."""
    random = np.random.default_rng(12)
    distances = 1 / random.uniform(1, 1 / 0.35, (ACROSS, ACROSS))
    side = PATCH * ACROSS
    values = np.empty((9, 9, side, side, 1), np.float32)
    for a, b in np.ndindex(ACROSS, ACROSS):
        place = np.s_[:, :, a * PATCH : (a + 1) * PATCH, b * PATCH : (b + 1) * PATCH]
        slope = thin_lens_slope(distances[a, b])
        values[place] = plane_views(Waves(random), slope, (9, 9), (PATCH, PATCH))
    for electrons in (None, 100, 10):
        seen = values
        if electrons:
            seen = (random.poisson(electrons * values.clip(0)) / electrons).astype(np.float32)
        for method in ("correspondence", "contrast"):
            found = gs.depth_from_views(made_views(seen), distances=(0.3, 1.5), method=method)
            middle = found.slope[PATCH // 2 :: PATCH, PATCH // 2 :: PATCH]
            error = np.abs(middle - thin_lens_slope(distances))
            share = np.mean(error <= HALF_DEPTH_OF_FOCUS)
            print(f"{electrons} e-, {method}: {share:.1%}, median error {np.median(error):.4f}")


def apertures():
    """Print how far synthetic apertures of 9 x 9 cells are from a disc: rms radius, transfer function."""
    views = made_views(np.ones((9, 9, 1, 1, 1)))
    for radius in (1.0, 0.8, 0.6, 0.4):
        weights = views.weigh(radius)
        worst = 0.0
        for turns in np.linspace(0.02, 0.61 / radius, 40):  # to the first zero of the disc
            for angle in np.linspace(0, np.pi / 4, 5):
                k = 2 * np.pi * turns * np.array([np.cos(angle), np.sin(angle)])
                own = np.cos(views.places @ k)
                own = (weights * own).sum() / weights.sum() * np.prod(np.sinc(k / 9 / np.pi))
                u = 2 * np.pi * turns * radius
                worst = max(worst, abs(own - 2 * j1(u) / u))
        square = np.square(views.places).sum(-1) + 2 / 3 / 81
        rms = np.sqrt((weights * square).sum() / weights.sum() / (radius**2 / 2))
        print(f"aperture {radius}: rms radius {rms:.4f}, transfer function within {worst:.3f}")


def methods():
    """Print the difference and processor times of shift and add and of Fourier slices."""
    size, shape = (256, 256), (9, 9)
    for highest in (0.5, 1.2):
        waves = Waves(np.random.default_rng(2), highest)
        views = made_views(plane_views(waves, 1.5, shape, size))
        y = np.arange(size[0]) - (size[0] - 1) / 2
        sharp = waves(y[:, None], y[None])[24:-24, 24:-24]
        for name, make in (
            ("slices", lambda at, views=views: gs.refocus_by_slices(views, at)),
            ("shift and add", lambda at, views=views: gs.focus_stack(views, slopes=at)),
        ):
            make([0.0])
            times = []
            for count in (1, 9):
                start = time.process_time()
                found = make(np.linspace(1.5, 2.5, count))
                times.append(time.process_time() - start)
            error = np.sqrt(np.mean((found[0, 24:-24, 24:-24, 0] - sharp) ** 2)) / sharp.std()
            each = (times[1] - times[0]) / 8
            print(f"waves to {highest} rad, {name}: rms error {error:.1e} of the texture, ", end="")
            print(f"processor time {times[0]:.2f} s, each further slope {each:.3f} s")


if __name__ == "__main__":
    main()

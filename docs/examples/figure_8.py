"""
Figure 8 of the chapter: a sensor out of focus
==============================================

*Image Systems Simulation* asks how precisely a sensor must be mounted. The camera has a
diffraction-limited lens of f/2.4 and 3.9 mm, and 1.4 µm pixels with a fill factor of 75 %. The
sensor is in focus, 10 µm and 40 µm out of focus.
"""

import matplotlib.pyplot as plt
import numpy as np
from skimage import data

import gpusim as gs
from gpusim.measure import mtf50, sfr

# %%
# The figure
# ----------
# Top: a photograph. Bottom: the contrast of a slanted edge by ISO 12233, without noise, through the
# whole camera: lens, pixel, mosaic, bilinear demosaicking, colours. The dashed line is the formula
# for lens and pixel at 550 nm; the gap between the two is the loss by demosaicking.

camera = gs.open_camera("figure8").with_(scaling="normalised")
silent = camera.with_(photon="none", read_e=0, dark_current_e_per_s=0)
photograph = gs.scene_from(data.astronaut()[:240, 100:340])
edge = gs.chart("slanted-edge", size=(240, 160), samples_per_pixel=2)
luminance = camera.display.xyz_from_rgb[1]


def lens_and_pixel(per_mm, defocus_um, waves=0.55):
    """Return the MTF of a defocused circular pupil (Hopkins) times the pixel's sinc."""
    s = np.minimum(per_mm * 1e-3 * waves * 2.4, 1)[:, None]  # relative to the cut-off
    path = defocus_um / (8 * 2.4**2 * waves)  # [wave] at the pupil's edge
    u = (1 - s) * (np.arange(2000) + 0.5) / 2000
    overlap = np.sqrt(np.maximum(1 - (u + s) ** 2, 0)) * np.cos(8 * np.pi * path * s * u)
    return np.abs(4 / np.pi * (1 - s[:, 0]) * overlap.mean(axis=1)) * np.sinc(
        per_mm * 1.4e-3 * np.sqrt(0.75)
    )


figure, axes = plt.subplots(2, 3, figsize=(10, 6.4), height_ratios=(1.3, 1), layout="constrained")
for defocus, (above, below) in zip((0, 10, 40), axes.T, strict=True):
    above.imshow(gs.Simulator(camera.with_(defocus_um=defocus))(photograph, seed=1).rgb)
    above.set_title(f"{defocus} µm from focus")
    above.set_axis_off()
    linear = gs.Simulator(silent.with_(defocus_um=defocus))(edge).linear
    response = sfr(linear @ luminance, pitch=1.4e-6)
    within = response.frequencies <= 0.5
    below.plot(response.per_mm[within], response.response[within], "k")
    below.plot(
        response.per_mm[within],
        lens_and_pixel(response.per_mm[within], defocus),
        "k--",
        linewidth=0.8,
    )
    below.axhline(0.5, color="0.8", zorder=0)
    below.text(0.32, 0.88, f"50 % at {mtf50(response):.0f} cycles/mm", transform=below.transAxes)
    below.set(xlabel="cycles/mm on the sensor", ylim=(0, 1.05))
axes[1, 0].set_ylabel("contrast")

# %%
# Mounting tolerance
# ------------------
# MTF50 against the distance from focus. It shows the loss of sharpness for a mounting tolerance.

distances = np.array([0, 2.5, 5, 10, 15, 20, 30, 40])
found = []
for distance in distances:
    stacked = silent.with_(
        defocus_um=float(distance), stacked=True
    )  # all colours in each pixel: no demosaicking
    found.append(mtf50(sfr(gs.Simulator(stacked)(edge).mean[1], pitch=1.4e-6)))

figure, axis = plt.subplots(figsize=(6, 3.2), layout="constrained")
axis.plot(distances, found, "o-")
axis.set(xlabel="sensor from focus [µm]", ylabel="MTF50 of green [cycles/mm]", ylim=(0, None))

# %%
# A script saves its pictures:

gs.plot.save_figures("figure_8")

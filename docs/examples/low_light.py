"""
A photograph under low light
============================

A photograph becomes a scene: the light of a display that shows it, in a light and at a luminance of
your choice. A camera then photographs it in an office, in a dim room and in a street at night.
"""

# %%
# From an office to the street
# ----------------------------
# All three are exposed for 1/30 s. ``normalise`` shows a white surface as white, like a higher ISO
# speed, so noise is compared at the same brightness.

import matplotlib.pyplot as plt
from skimage import data
from skimage.metrics import peak_signal_noise_ratio

import gpusim as gs

camera = gs.open_camera("phone").with_(exposure_time_ms=1000 / 30, scaling="normalised")
photograph = data.astronaut()[:256, 90:346]
simulate = gs.Simulator(camera, tolerance="video")

figure, axes = plt.subplots(1, 3, figsize=(11, 4), layout="constrained")
for axis, luminance, where in zip(
    axes, (100, 10, 1), ("an office", "a dim room", "a street at night"), strict=True
):
    frame = simulate(gs.scene_from(photograph, luminance=luminance), seed=1)
    axis.imshow(frame.rgb)
    axis.set_title(
        f"{where}: white {luminance} cd/m²,\n{frame.mean.mean():.0f} e⁻ in a pixel on average"
    )
    axis.set_axis_off()

# %%
# Less noise
# ----------
# Two remedies: denoising of the mosaic, which uses the noise model of each pixel; and eight
# hand-held frames, aligned and averaged. Decibels are relative to a picture by the same camera
# without noise.

dim, motion = gs.scene_from(photograph, luminance=3), gs.Motion(shake=1.5, seed=4)
views = [dim.viewed(motion.at(number / 30)) for number in range(8)]
frames = gs.burst(simulate, views, seed=2)
shown = {
    "one frame": frames[0],
    "denoised": gs.Simulator(camera.with_(denoise=1.0), tolerance="video")(views[0], seed=2),
    "eight frames": gs.merge_burst(simulate, frames),
}

silent = camera.with_(photon="none", read_e=0, dark_current_e_per_s=0, prnu=0, dsnu_e=0)
truth = gs.Simulator(silent)(views[0])

figure, axes = plt.subplots(1, 3, figsize=(11, 4), layout="constrained")
for axis, (title, frame) in zip(axes, shown.items(), strict=True):
    axis.imshow(frame.rgb[20:180, 40:200])
    axis.set_title(f"{title}: {peak_signal_noise_ratio(truth.rgb, frame.rgb):.1f} dB")
    axis.set_axis_off()

# %%
# A script saves its pictures:

gs.plot.save_figures("low_light")

"""
Figure 14 of the chapter: mosaics in the dark
=============================================

A clear pixel collects at least twice the light of a green one. Does a mosaic with clear pixels make
better pictures? *Image Systems Simulation* compares three: RGB, RGBW with a clear pixel, and RGBN
with a neutral grey one. Each processor is learned (L3) from simulated frames of its camera, so each
mosaic has its best filters.
"""

import dataclasses
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from skimage import data

import gpusim as gs
from gpusim.apps.l3.train import train
from gpusim.data.curves import curve
from gpusim.io.scene.scenes import mean_luminance
from gpusim.measure import snr

# %%
# Three cameras
# -------------
# f/4, 3 mm, 2.2 µm pixels, 100 ms, as in the chapter. The chapter gives no noise figures, so this
# is a plausible pixel. N is the clear filter behind a density of 0.5.

sensitivity = curve("mt9v024")  # R, G, B and clear
cut = curve("ir-cut-phone").at(sensitivity.wavelengths)
columns = np.vstack(
    [sensitivity.wavelengths, sensitivity.values * cut, 0.3 * sensitivity.values[3] * cut]
)
folder = Path(tempfile.mkdtemp())
np.savetxt(
    folder / "filters.csv", columns.T, "%.5f", ",", header="wavelength_nm,R,G,B,W,N", comments=""
)

mosaics = {"RGB": ["RG", "GB"], "RGBW": ["RG", "WB"], "RGBN": ["RG", "NB"]}
cameras = {}
for name, cfa in mosaics.items():
    (folder / f"{name}.toml").write_text(f"""
optics = {{f_number = 4, focal_length_mm = 3}}
noise = {{read_e = 6.7, dsnu_e = 7}}
processor = {{scaling = "normalised"}}
[sensor]
pixel_pitch_um = 2.2
fill_factor = 0.45
cfa = {cfa}
qe = "filters.csv"
qe_ends = "zero"
full_well_e = 9000
bits = 12
black_level_dn = 64
exposure_time_ms = 100
""")
    cameras[name] = gs.open_camera(folder / f"{name}.toml")

# %%
# Learning
# --------
# Ten generated scenes, each at eight light levels. ``gpusim train-l3`` uses thirty and writes the
# table to a file. A learned table includes the mosaic, the noise and the blur of its camera.

learned = {
    name: camera.with_(demosaic="learned", table=train(camera, generated=10))
    for name, camera in cameras.items()
}

# %%
# The figure
# ----------
# A photograph that is not in the training set, at a mean of 1 and 40 cd/m². The decibels are the
# signal to noise ratio of a grey card that fills the frame in the same light.

scene = gs.scene_from(data.astronaut()[:160, 130:330], luminance=100)
own = mean_luminance(scene)
figure, axes = plt.subplots(2, 3, figsize=(11, 6.4), layout="constrained")
for row, mean in zip(axes, (1, 40), strict=True):
    light = dataclasses.replace(scene, illuminant=scene.illuminant.scale(mean / own))
    card = gs.chart("flat", size=(96, 64), luminance=100 * mean / own)
    for axis, (name, camera) in zip(row, learned.items(), strict=True):
        simulate = gs.Simulator(camera)
        axis.imshow(simulate(light, seed=1).rgb)
        grey = simulate(card, seed=2).linear @ camera.display.xyz_from_rgb[1]
        axis.set_title(f"{name} at {mean} cd/m²: {snr(grey[8:-8, 8:-8]):.1f} dB")
        axis.set_axis_off()

# %%
# A script saves its pictures:

gs.plot.save_figures("figure_14")

"""
Figure 12 of the chapter: the wrong light
=========================================

An image processor maps sensor values to colours by a transform for the light that it assumes.
*Image Systems Simulation* shows the effect of a wrong assumption. Here one raw frame in lamp light
is developed three times.
"""

import dataclasses

import matplotlib.pyplot as plt
import numpy as np

import gpusim as gs
from gpusim.measure import ciede2000

# %%
# One raw frame, three assumptions
# --------------------------------
# A frame's rendering is its white balance and its matrix, which depend on the known or assumed
# light. The raw values are drawn once, in illuminant A; the other two renderings are taken from
# frames in other lights.

camera = gs.open_camera("phone").with_(scaling="normalised")
simulate = gs.Simulator(camera)
lights = {
    "blackbody-1900K": "taken for a candle",
    "A": "known: a lamp of 2856 K",
    "D65": "taken for daylight",
}
scenes = {light: gs.chart("colorchecker", size=(240, 160), light=light) for light in lights}
exposure = simulate.expose(scenes["A"])
raw = exposure.raw(seed=1)

figure, axes = plt.subplots(1, 3, figsize=(11, 2.9), layout="constrained")
for axis, (light, title) in zip(axes, lights.items(), strict=True):
    believed = dataclasses.replace(exposure, rendering=simulate.expose(scenes[light]).rendering)
    codes = simulate.device.numpy(believed.develop(raw)[1])
    axis.imshow(codes.copy())
    axis.set_title(title)
    axis.set_axis_off()

# %%
# Colour errors
# -------------
# Even the right transform has errors, since three filters cannot separate all spectra as the eye
# does. A camera that estimates the light sees only the picture; on a chart of many colours the mean
# of all is nearly grey.

names = {
    "known": "illuminant",
    "gray world": "gray-world",
    "brightest": "max-rgb",
    "assumed daylight": "none",
}
figure, axis = plt.subplots(figsize=(8, 3.2), layout="constrained")
kinds = ("D65", "A", "FL11", "LED-B1")
for number, (label, method) in enumerate(names.items()):
    estimating = gs.Simulator(camera.with_(white_balance=method))
    errors = []
    for light in kinds:
        scene = gs.chart("colorchecker", size=(120, 80), light=light)
        errors.append(np.median(ciede2000(estimating(scene), scene)))
    axis.bar(np.arange(len(kinds)) + 0.2 * (number - 1.5), errors, 0.18, label=label)
axis.set_xticks(range(len(kinds)), kinds)
axis.set(ylabel="median CIEDE2000", xlabel="light of the scene")
axis.legend(frameon=False, title="white balance")

# %%
# A script saves its pictures:

gs.plot.save_figures("figure_12")

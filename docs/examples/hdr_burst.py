"""
A bracket of exposures, and a burst
===================================

A window next to a dark room has a larger range of light than a sensor. Several exposures together
capture it. Several short exposures also reduce the blur of a shaking hand.
"""

import matplotlib.pyplot as plt
import numpy as np
from skimage import data

import gpusim as gs

# %%
# A scene of high dynamic range
# -----------------------------
# Photographs clip at white; linear numbers do not. The right half of this picture is in sunlight,
# 50 times as bright.

photograph = data.coffee()[30:350:2, 60:540:2] / 255.0
linear = photograph**2.2
linear[:, 120:] *= 50
scene = gs.scene_from(linear, linear=True, luminance=20)
camera = gs.open_camera("phone")
simulate = gs.Simulator(camera)

# %%
# Bracket
# -------
# The camera meters the brightest pixel; two more exposures are 8 and 64 times as long.
# ``merge_bracket`` computes for each pixel the mean of its rates, weighted by their inverse
# variances. For a saturated pixel it uses the shorter frames.

frames = gs.bracket(simulate, scene, (0, 3, 6))
merged = gs.merge_bracket(simulate, frames)


def toned(rates):
    """Return values that a screen can show, by a global tone curve (Reinhard)."""
    rates = np.maximum(rates, 0)
    brightest = rates.max(axis=-1, keepdims=True)
    return (rates / (brightest + np.median(brightest))) ** (1 / 2.2)


figure, axes = plt.subplots(2, 2, figsize=(10, 6.9), layout="constrained")
for axis, frame in zip(axes.flat, frames, strict=False):
    full = (frame.raw >= 1023).mean()
    axis.imshow(frame.rgb)
    axis.set_title(f"{1e3 * frame.exposure_time:.3g} ms: {100 * full:.0f} % of the pixels are full")
axes[1, 1].imshow(toned(merged.linear))
axes[1, 1].set_title("merged, with a tone curve")
for axis in axes.flat:
    axis.set_axis_off()

# %%
# Accuracy of the merged rates
# ----------------------------
# A ramp over five decades: the merged rate divided by the true one, and the same for single
# exposures. The shortest is noisy in dark parts, the longest is saturated in bright ones.

ramp = gs.chart("ramp", size=(256, 64), decades=5, luminance=3e4)
silent = gs.Simulator(
    camera.with_(photon="none", read_e=0, dark_current_e_per_s=0, prnu=0, dsnu_e=0)
)
taken = gs.bracket(simulate, ramp, (0, 4, 8), seed=3)
true = silent.expose(ramp, taken[-1].exposure_time)
rates = np.asarray(silent.device.numpy(true.mean)) / true.exposure_time
sensor = camera.sensor

figure, axis = plt.subplots(figsize=(8, 3.4), layout="constrained")
together = gs.merge_bracket(simulate, taken)
curves = [
    (
        (frame.raw.astype(float) - sensor.black_level)
        / sensor.gain_dn_per_electron
        / frame.exposure_time,
        f"{1e3 * frame.exposure_time:.3g} ms",
    )
    for frame in (taken[0], taken[-1])
]
for found, label in (*curves, (together.mean / together.exposure_time, "three, merged")):
    axis.semilogx(rates[::2, ::2].mean(0), (found / rates)[::2, ::2].mean(0), label=label)
axis.set(
    xlabel="electrons per second", ylabel="found over true, mean of 32 pixels", ylim=(0.5, 1.5)
)
axis.legend(frameon=False)

# %%
# Burst
# -----
# Eight frames of 5 ms with a shaking hand, aligned and merged, compared with one frame of 40 ms
# with the same motion.

hand = gs.Motion(shake=4.0, seed=2)
dim = gs.picture(data.coffee()[60:260, 100:400], luminance=15)
steady = gs.Simulator(gs.open_camera("phone").with_(exposure_time_ms=5, scaling="normalised"))
burst = gs.burst(steady, [dim.viewed(hand.at(number * 0.005)) for number in range(8)], seed=4)
slow = gs.Simulator(gs.open_camera("phone").with_(exposure_time_ms=40, scaling="normalised"))
blurred = gs.expose_motion(slow, dim, hand).frame(seed=4)

figure, axes = plt.subplots(1, 3, figsize=(11, 2.8), layout="constrained")
for axis, (frame, title) in zip(
    axes,
    (
        (burst[0], "one of 5 ms"),
        (blurred, "one of 40 ms"),
        (gs.merge_burst(steady, burst), "eight of 5 ms, merged"),
    ),
    strict=True,
):
    axis.imshow(frame.rgb)
    axis.set_title(title)
    axis.set_axis_off()

# %%
# A script saves its pictures:

gs.plot.save_figures("hdr_burst")

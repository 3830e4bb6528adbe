"""
Start in three minutes
======================

A chart with measured reflectances, a camera, and one frame. The frame contains the results of each
step: electrons without noise, digital numbers, and the picture. Its report estimates their errors.
"""

# %%
# A camera and a scene
# --------------------
# Both have names; the name of your own file works as well. ``tolerance="video"`` keeps the error
# below a tenth of a pixel's noise. Effects that the scene does not need for this are not computed.

import matplotlib.pyplot as plt

import gpusim as gs

camera = gs.open_camera("phone")
scene = gs.open_scene("colorchecker", size=(384, 256), light="D65", luminance=100)
simulate = gs.Simulator(camera, tolerance="video")

# %%
# One frame
# ---------
# ``seed`` selects the noise: the same number gives the same digital numbers on every device.
# ``verify`` also computes the float64 reference and compares.

frame = simulate(scene, seed=1, verify=True)

figure, axes = plt.subplots(1, 3, figsize=(10, 2.7), layout="constrained")
shown = axes[0].imshow(frame.mean, cmap="viridis")
figure.colorbar(shown, ax=axes[0], label="e⁻", shrink=0.6)
axes[0].set_title("electrons, without noise")
gs.plot.raw(frame, axes[1])  # each pixel in its filter's colour
axes[1].set(title="digital numbers, a part", xlim=(60, 123), ylim=(226, 184))
axes[2].imshow(frame.rgb)
axes[2].set_title("the picture")
for axis in axes:
    axis.set_axis_off()

# %%
# Time and error
# --------------
# The report begins with the verdict. Then come the time, the errors predicted before the frame was
# made, each with its cause, and the true error. The page on the report explains each line.

print(frame.report)

# %%
# Another exposure
# ----------------
# ``with_`` changes any key of a camera. Here is the same chart under a dim lamp, exposed for a
# fifteenth of a second. ``normalise`` shows white as white, for any number of electrons:

dim = gs.open_scene("colorchecker", size=(384, 256), light="A", luminance=5)
patient = camera.with_(exposure_time_ms=1000 / 15, scaling="normalised")
night = gs.Simulator(patient, tolerance="video")(dim, seed=1)

figure, axes = plt.subplots(1, 2, figsize=(10, 3.5), layout="constrained")
for axis, each, title in (
    (axes[0], frame, "daylight, automatic exposure"),
    (axes[1], night, "5 cd/m², 1/15 s"),
):
    axis.imshow(each.rgb)
    axis.set_title(f"{title}: up to {each.mean.max():.0f} e⁻ in a pixel")
    axis.set_axis_off()

# %%
# A script saves its pictures:

gs.plot.save_figures("start")

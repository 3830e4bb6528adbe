"""
Compare two pixel sizes
=======================

Smaller pixels resolve finer detail, larger ones collect more light. Two sensors of the same area,
with the same lens and light: the first has pixels of 1.0 µm, the second has a quarter as many, of
2.0 µm.
"""

# %%
# Two cameras
# -----------
# The full well is proportional to the area. All other settings are the phone's.

import matplotlib.pyplot as plt
import numpy as np
from skimage import data

import gpusim as gs
from gpusim.measure import mtf50, sfr, snr

cameras = {
    pitch: gs.open_camera("phone").with_(pixel_pitch_um=pitch, full_well_e=3000 * pitch**2)
    for pitch in (1.0, 2.0)
}
colors = dict(zip(cameras, ("tab:blue", "tab:orange"), strict=True))

# %%
# The same photograph
# -------------------
# The scene has the same samples for both, so both receive the same light on the same area: two
# samples along each side of a small pixel, four along a large one. White has 20 cd/m², a dim room,
# and both expose for 1/30 s; ``normalise`` shows white as white for any exposure.

photograph = data.astronaut()[:440, 40:480]
frames = {}
for pitch, camera in cameras.items():
    scene = gs.scene_from(photograph, luminance=20, samples_per_pixel=2 * pitch)
    frames[pitch] = gs.Simulator(camera.with_(exposure_time_ms=1000 / 30, scaling="normalised"))(
        scene, seed=1
    )

figure, axes = plt.subplots(1, 2, figsize=(9, 4.7), layout="constrained")
for axis, (pitch, frame) in zip(axes, frames.items(), strict=True):
    axis.imshow(frame.rgb, interpolation="nearest")
    axis.set_title(
        f"{pitch:.1f} µm: {frame.raw.shape[1]} x {frame.raw.shape[0]} pixels, {frame.mean.mean():.0f} e⁻ on "
        "average",
        fontsize=10,
    )
    axis.set_axis_off()

# %%
# Sharpness
# ---------
# ISO 12233's response to a slanted edge in the mean electrons: only lens and pixel. ``stacked``
# gives every pixel all three channels, so there is no demosaicking. The plot shows the green
# channel.

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for pitch, camera in cameras.items():
    simulate = gs.Simulator(camera.with_(stacked=True))
    edge = simulate(gs.chart("slanted-edge", size=(160, 120), samples_per_pixel=3)).mean[1]
    response = sfr(edge, pitch=camera.sensor.pixel_pitch)
    within = response.frequencies <= 0.5  # up to the Nyquist limit
    left.plot(
        response.per_mm[within],
        response.response[within],
        color=colors[pitch],
        label=f"{pitch:.1f} µm, MTF50 {mtf50(response):.0f} /mm",
    )
left.axhline(0.5, color="gray", linewidth=0.5)
left.set(xlabel="cycles/mm on the sensor", ylabel="contrast", ylim=(0, 1.05))
left.legend()

# %%
# Noise
# -----
# The signal to noise ratio of a grey card in the green channel, from two frames, which removes the
# shared fixed pattern. At the same display size, four small pixels make one large one: twice the
# ratio of a single one, 6 dB. In the dark the four small pixels are worse, since each has its read
# noise.

luminances = np.geomspace(0.1, 100, 7)
for pitch, camera in cameras.items():
    simulate = gs.Simulator(camera.with_(stacked=True, exposure_time_ms=10))
    found = []
    for luminance in luminances:
        pair = [
            frame.raw[1].astype(float) - camera.sensor.black_level
            for frame in simulate.frames(gs.chart("flat", size=(64, 64), luminance=luminance), 2)
        ]
        found.append(snr(*pair))
    right.semilogx(luminances, found, "o-", color=colors[pitch], label=f"a pixel of {pitch:.1f} µm")
    if pitch == 1:
        right.semilogx(
            luminances,
            np.add(found, 20 * np.log10(2)),
            "--",
            color=colors[pitch],
            label="four of 1.0 µm",
        )
right.set(xlabel="luminance of white [cd/m²], 10 ms", ylabel="signal to noise [dB]")
right.legend()

# %%
# A script saves its pictures:

gs.plot.save_figures("pixel_sizes")

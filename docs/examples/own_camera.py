"""
My own camera: sharpness and noise
==================================

A camera is a TOML file. The names of its keys end in their units, and its base supplies the keys
that it leaves out. This camera is measured as in a laboratory: sharpness by a slanted edge (ISO
12233), noise by grey cards.
"""

# %%
# The file
# --------
# The colour filters are in a separate table, as in a data sheet. Each of these lines is optional.

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import gpusim as gs
from gpusim.measure import ciede2000, mtf50, sfr, snr

folder = Path(tempfile.mkdtemp())
waves = np.arange(400, 701, 10)
filters = [0.55 * np.exp(-(((waves - middle) / 45) ** 2)) for middle in (600, 540, 455)]
np.savetxt(
    folder / "filters.csv",
    np.column_stack([waves, *filters]),
    "%.4f",
    ",",
    header="wavelength_nm,R,G,B",
    comments="",
)
(folder / "mine.toml").write_text("""
base = "phone"

[optics]
f_number = 2.4
focal_length_mm = 6.0

[sensor]
pixel_pitch_um = 2.0
cfa = ["GR", "BG"]
qe = "filters.csv"
qe_ends = "zero"
full_well_e = 9000
bits = 12

[noise]
read_e = 2.5
dark_current_e_per_s = 3
prnu = 0.004
""")
camera = gs.open_camera(folder / "mine.toml")

# %%
# A picture
# ---------
# Delta E is relative to the chart's colours, as the display would show them at best.

chart = gs.chart("colorchecker", size=(300, 200))
frame = gs.Simulator(camera)(chart, seed=1)
error = ciede2000(frame, chart)

figure, axes = plt.subplots(1, 3, figsize=(11, 2.7), layout="constrained")
for curve, color in zip(filters, "rgb", strict=True):
    axes[0].plot(waves, curve, color)
axes[0].set(xlabel="nm", ylabel="electrons for a photon", title="quantum efficiency")
axes[1].imshow(frame.rgb)
axes[1].set_title("the picture")
shown = axes[2].imshow(error, vmax=10, cmap="magma")
axes[2].set_title(f"CIEDE2000, {error.mean():.1f} on average")
figure.colorbar(shown, ax=axes[2], shrink=0.8)
for axis in axes[1:]:
    axis.set_axis_off()

# %%
# Sharpness
# ---------
# The edge passes lens, pixel, mosaic and demosaicking. With two samples per pixel the scene is
# finer than the camera. Frequencies are on the sensor.

edge = gs.Simulator(camera.with_(read_e=0, prnu=0, photon="none"))(
    gs.chart("slanted-edge", size=(240, 160), samples_per_pixel=2)
)
response = sfr(edge.linear, pitch=camera.sensor.pixel_pitch)

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.4), layout="constrained")
within = response.frequencies <= 0.5  # cycles per pixel: up to the Nyquist limit
for contrast, at, color in zip(response.response, mtf50(response), "rgb", strict=True):
    left.plot(response.per_mm[within], contrast[within], color, label=f"MTF50 {at:.0f} cycles/mm")
left.axhline(0.5, color="0.8", zorder=0)
left.set(xlabel="cycles/mm on the sensor", ylabel="contrast", ylim=(0, 1.1))
left.legend(frameon=False)

# %%
# Noise
# -----
# Two frames of a grey card at each exposure. Their difference is noise only, without the fixed
# pattern that both share. The lines follow from the figures in the file: the root of all electrons,
# including read noise.

times = np.geomspace(1e-3, 0.3, 8)  # [s]
card = gs.chart("flat", size=(96, 64), luminance=50)
ratios, lines = [], []
for seconds in times:
    pair = list(gs.Simulator(camera.with_(exposure_time_ms=1e3 * seconds)).frames(card, 2, seed=2))
    green = np.s_[24:40:2, 36:60:2]  # one colour, in the centre, without fall-off
    raws = [frame.raw[green].astype(float) - camera.sensor.black_level for frame in pair]
    ratios.append(snr(*raws))
    electrons = pair[0].mean[green].mean()
    lines.append(20 * np.log10(electrons / np.sqrt(electrons + 2.5**2)))
right.semilogx(1e3 * times, lines, "0.6", label="electrons and read noise")
right.semilogx(1e3 * times, ratios, "o", color="g", label="measured in the frames")
right.set(
    xlabel="exposure time [ms], grey card in white of 50 cd/m²", ylabel="signal to noise [dB]"
)
right.legend(frameon=False)

# %%
# A script saves its pictures:

gs.plot.save_figures("own_camera")

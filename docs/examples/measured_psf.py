"""
A lens from a measured point spread
===================================

A laboratory photographs a point of light through a lens, on the axis and in the field. The pictures
become the lens of a camera: ``lens.npz``, named in the camera's file.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from skimage import data

import gpusim as gs
from gpusim.measure import sfr

# %%
# The measurement
# ---------------
# Here a formula replaces the measurement: a round spot in the centre, and a spot with an outward
# tail of coma toward the corner, wider in the red. Each is a table of irradiance with a spacing of
# 0.3 µm, fine enough for f/1.8 at 360 nm, and with an energy of one. gpusim interpolates between
# wavelengths and heights. Photographs have light from 360 to 780 nm, so the tables cover this
# range.

spacing, wavelengths, heights = (
    0.3,
    (360.0, 550.0, 780.0),
    (0.0, 0.5, 1.0),
)  # [µm], [nm], 1: the frame's corner
y, x = (np.mgrid[:61, :61] - 30) * spacing  # [µm]; the corner lies towards +x


def spot(wavelength, height):
    """Return a core of 1 µm with a tail of wider cores farther out."""
    width = 1.0 * (wavelength / 550) ** 0.5
    return sum(
        np.exp(-((x - 4 * height * part**2) ** 2 + y**2) / (2 * (width * (1 + height * part)) ** 2))
        / (1 + height * part) ** 3
        for part in np.linspace(0, 1, 12)
    )


values = np.array([[spot(wavelength, height) for wavelength in wavelengths] for height in heights])
folder = Path(tempfile.mkdtemp())
gs.write_psf(
    folder / "lens.npz",
    gs.PointSpread(np.array(wavelengths), values, spacing * 1e-6, heights=np.array(heights)),
)

# %%
# The camera
# ----------
# Two lines name the lens. f-number and focal length still set the amount of light and the field of
# view.

(folder / "measured.toml").write_text("""
base = "phone"
[optics]
psf = "lens.npz"
""")
camera = gs.open_camera(folder / "measured.toml")
diffraction = gs.open_camera("phone")

figure, axes = plt.subplots(1, 3, figsize=(11, 2.7), layout="constrained")
gs.plot.psf(diffraction, 550, axes[0])
gs.plot.psf(camera, 550, axes[1])
gs.plot.psf(camera, 550, axes[2], place=(0.0, 0.9))
for axis, title in zip(
    axes,
    ("diffraction at f/1.8", "measured, on the axis", "measured, near the corner"),
    strict=True,
):
    axis.set_title(title)

# %%
# Pictures
# --------
# The blur varies over the frame; the lower row shows the upper left corner.

scene = gs.scene_from(data.astronaut()[:400], luminance=200)
figure, axes = plt.subplots(2, 2, figsize=(8, 8.4), layout="constrained")
for (whole, corner), one, title in zip(
    axes.T, (diffraction, camera), ("diffraction", "measured"), strict=True
):
    picture = gs.Simulator(one)(scene, seed=1).rgb
    whole.imshow(picture)
    whole.set_title(title)
    corner.imshow(picture[:110, :110], interpolation="nearest")
    for axis in (whole, corner):
        axis.set_axis_off()

# %%
# Check of the lens
# -----------------
# The contrast of a slanted edge, compared with the Fourier transform of the input table times the
# pixel's. Only the on-axis table is used, for the whole frame, so the edge has the same blur
# everywhere. ``stacked`` pixels need no demosaicking. The table is for 550 nm; the camera's green
# is a band around it.

gs.write_psf(folder / "axis.npz", gs.PointSpread(np.array(wavelengths), values[0], spacing * 1e-6))
(folder / "axis.toml").write_text("""
base = "phone"
optics = {psf = "axis.npz"}
""")
silent = gs.open_camera(folder / "axis.toml").with_(
    photon="none", read_e=0, prnu=0, dsnu_e=0, stacked=True
)
edge = gs.chart("slanted-edge", size=(240, 160), samples_per_pixel=4)
pitch = camera.sensor.pixel_pitch
found = sfr(gs.Simulator(silent)(edge).mean[1], pitch=pitch)
line = values[0, 1].sum(0)
at = found.per_mm[found.frequencies <= 0.5]
transfer = np.abs(np.exp(-2j * np.pi * at[:, None] * x[0] * 1e-3) @ line) / line.sum()

figure, axis = plt.subplots(figsize=(7, 3.4), layout="constrained")
axis.plot(
    at, transfer * np.sinc(at * pitch * 1e3), "k--", label="the table's transform, and the pixel"
)
axis.plot(at, found.response[: len(at)], "g", label="slanted edge, green")
axis.set(xlabel="cycles/mm on the sensor", ylabel="contrast", ylim=(0, 1.05))
axis.legend(frameon=False)

# %%
# A script saves its pictures:

gs.plot.save_figures("measured_psf")

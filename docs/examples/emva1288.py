"""
EMVA 1288: from a data sheet to frames, and back
================================================

The standard EMVA 1288 defines how to measure a camera's noise. This example makes a sensor from the
figures of a data sheet, simulates frames, and measures the same figures from these frames.
"""

import matplotlib.pyplot as plt
import numpy as np

import gpusim as gs

# %%
# The data sheet
# --------------
# A monochrome sensor as in a manufacturer's data sheet.

sheet = {
    "quantum_efficiency": 0.65,
    "gain": 0.4,
    "dark_noise": 5.0,
    "saturation_capacity": 9000.0,
    "dsnu": 2.0,
    "prnu": 0.8,
    "dark_current": 30.0,
}
known = {"pixel_pitch": 3.45e-6, "wavelength": 535.0, "bits": 12, "black_level": 64}
sensor = gs.sensor_from_emva1288(**sheet, **known)

# %%
# The laboratory
# --------------
# Uniform light at 50 levels, two frames each; dark frames; stacks of frames to measure the fixed
# pattern; a series of dark exposures. ``Readout`` draws frames from mean electrons, without lens
# and scene.

readout = gs.Readout(sensor)
photons = np.linspace(0.02, 1.08, 50) * sheet["saturation_capacity"] / sheet["quantum_efficiency"]
numbers = iter(range(10**6))  # each frame has independent noise


def frames(count, photons, seconds=1e-3):
    """Return frames of 128 x 192 pixels. photons: mean number per pixel."""
    mean = np.full((128, 192), sheet["quantum_efficiency"] * photons, np.float32)
    return np.stack(
        [readout.draw_electrons(mean, seconds, seed=1, first=next(numbers)) for _ in range(count)]
    )


half = 0.5 * sheet["saturation_capacity"] / sheet["quantum_efficiency"]
found = gs.photon_transfer(
    [frames(2, level) for level in photons],
    frames(2, 0),
    photons,
    dark_stack=frames(16, 0),
    bright_stack=frames(16, half),
    dark_series={seconds: frames(2, 0, seconds) for seconds in (0.1, 0.7, 1.4, 2.0, 3.0)},
)

# %%
# Result
# ------
# The result varies as expected for this number of pixels: gain by 0.3 %, dark current by 2 %.

units = {
    "quantum_efficiency": "",
    "gain": "DN/e⁻",
    "dark_noise": "e⁻",
    "saturation_capacity": "e⁻",
    "dsnu": "e⁻",
    "prnu": "%",
    "dark_current": "e⁻/s",
}
for name, value in sheet.items():
    print(f"{name:20s} {value:8.4g} {found.figures[name]:8.4g} {units[name]}")

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.6), layout="constrained")
left.plot(found.signal, found.variance, ".", label="frames")
left.plot(found.signal, sheet["gain"] * found.signal, "k", linewidth=0.8, label="the sheet's gain")
left.set(xlabel="signal [DN]", ylabel="temporal variance [DN²]", title="photon transfer")
left.legend(frameon=False)
electrons = sheet["quantum_efficiency"] * photons
ratio = found.signal / np.sqrt(found.variance + found.dark_noise_dn**2)
below = slice(found.saturation_level)
right.semilogx(photons[below], 20 * np.log10(ratio[below]), ".", label="frames")
right.semilogx(
    photons,
    20 * np.log10(electrons / np.sqrt(electrons + sheet["dark_noise"] ** 2)),
    "k",
    linewidth=0.8,
    label="the sheet",
)
right.set(xlabel="photons on a pixel", ylabel="signal to noise [dB]", title="signal to noise")
right.legend(frameon=False)

# %%
# From measurement to simulation
# ------------------------------
# ``sensor_from_emva1288`` accepts ``figures`` directly, so you can simulate a camera that you have
# measured.

twin = gs.sensor_from_emva1288(**found.figures, **known)
print(f"full well {sensor.full_well:.0f} e⁻, of the twin {twin.full_well:.0f} e⁻")

# %%
# A script saves its pictures:

gs.plot.save_figures("emva1288")

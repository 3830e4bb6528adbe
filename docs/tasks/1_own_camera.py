"""Your own camera: its MTF50, and its signal-to-noise ratio against light."""

from pathlib import Path

import matplotlib.pyplot as plt

import gpusim as gs

Path("mine.toml").write_text("""
base = "phone"
optics = {f_number = 2.4}
sensor = {pixel_pitch_um = 2.2, full_well_e = 9000, bits = 12}
noise = {read_e = 2.5, prnu = 0}
""")
figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.5), layout="constrained")
camera = gs.open_camera("mine.toml")
gs.plot.sfr(camera, left)  # a slanted edge through lens, pixel, mosaic and processor
gs.plot.snr(camera, right)
figure.savefig("own_camera.png")

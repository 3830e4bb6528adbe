"""Fifty photographs to noisy pairs for training."""

from pathlib import Path

import numpy as np

import gpusim as gs

camera = gs.open_camera("phone").with_(exposure_time_ms=10, analog_gain=4)
simulate, sensor = gs.Simulator(camera, tolerance="video"), camera.sensor
for number, path in enumerate(sorted(Path("photos").glob("*.png"))):
    # another number of the frame: independent noise
    frame = simulate(gs.open_scene(path, luminance=50), seed=1, first=number)
    frame.save(f"pairs/{path.stem}.png")
    noisy = (frame.raw.astype(np.float32) - sensor.black_level) / sensor.gain_dn_per_electron
    np.savez(f"pairs/{path.stem}.npz", noisy=noisy, clean=frame.mean)  # both in electrons

"""Fifty photographs to noisy pairs for training."""

from pathlib import Path

import numpy as np

import gpusim as gs

Path("pairs").mkdir(exist_ok=True)
camera = gs.open_camera("phone").with_(exposure_time_ms=10, analog_gain=4)
simulate, sensor = gs.Simulator(camera, tolerance="video"), camera.sensor
for number, path in enumerate(sorted(Path("photos").glob("*.png"))):
    frame = simulate(
        gs.open_scene(path, luminance=50), seed=1, first=number
    )  # each frame has independent noise
    noisy = (
        frame.raw.astype(np.float32) - sensor.black_level
    ) / sensor.gain_dn_per_electron  # both in electrons
    np.savez(f"pairs/{path.stem}.npz", noisy=noisy, clean=frame.mean)

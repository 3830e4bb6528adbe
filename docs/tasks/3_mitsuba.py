"""A spectral OpenEXR of Mitsuba with depth: near and far focus through a phone's lens."""

import matplotlib.pyplot as plt
import numpy as np

import gpusim as gs

bands = {f"band{nm}": nm for nm in range(400, 701, 50)}  # the film's channels, wavelengths [nm]
# the field of view is the renderer's
scene = gs.open_scene("render.exr", bands=bands, depth="ray", fov=np.radians(40))
camera = gs.open_camera("phone")
figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
for axis, distance in zip(axes, (0.5, 3.0), strict=True):
    frame = gs.Simulator(camera.with_(object_distance_m=distance))(scene, seed=1)
    axis.imshow(frame.rgb)
    axis.set_title(f"in focus at {distance} m")
    frame.save(f"focus-{distance}m.dng")
figure.savefig("focus.png")

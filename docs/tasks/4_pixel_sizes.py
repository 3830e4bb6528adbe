"""Two pixel sizes behind one lens, on one area, in one light."""

import matplotlib.pyplot as plt

import gpusim as gs
from gpusim.measure import ciede2000

figure, axes = plt.subplots(1, 2, figsize=(9, 3.3), layout="constrained")
for axis, pitch in zip(axes, (1.0, 2.0), strict=True):  # [µm]
    camera = gs.open_camera("phone").with_(
        pixel_pitch_um=pitch, full_well_e=3000 * pitch**2, exposure_time_ms=30, scaling="normalised"
    )
    scene = gs.chart("colorchecker", size=(int(240 / pitch), int(160 / pitch)), luminance=5)
    frame = gs.Simulator(camera)(scene, seed=1)
    error = ciede2000(frame, scene).mean()
    axis.imshow(frame.rgb, interpolation="nearest")
    axis.set_title(f"{pitch} µm: mean CIEDE2000 {error:.1f}")
figure.savefig("pixel_sizes.png")

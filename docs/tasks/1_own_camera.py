"""Your own camera: its MTF50, and its signal-to-noise ratio against light."""
import matplotlib.pyplot as plt

import gpusim as gs
from gpusim.measure import mtf50, sfr, snr

camera = gs.open_camera("phone").with_(f_number=2.4, pixel_pitch_um=2.2, full_well_e=9000, read_e=2.5)  # or "mine.toml"
edge = gs.Simulator(camera)(gs.chart("slanted-edge", size=(240, 160), samples_per_pixel=2))
response = sfr(edge.linear, pitch=camera.sensor.pixel_pitch)  # of red, green and blue, after demosaicking
simulate, levels = gs.Simulator(camera.with_(exposure_time_ms=10)), [1, 3, 10, 30, 100, 300]  # cd/m² of white
pairs = [simulate.frames(gs.chart("flat", size=(96, 64), luminance=level), 2) for level in levels]
figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
left.plot(response.per_mm, response.response[1])
left.set(xlabel="cycles/mm", ylabel="contrast of green", title=f"MTF50 {mtf50(response)[1]:.0f} cycles/mm")
right.semilogx(levels, [snr(*(frame.linear for frame in pair))[1] for pair in pairs], "o-")
right.set(xlabel="white [cd/m²], grey card, 10 ms", ylabel="SNR of green [dB]")

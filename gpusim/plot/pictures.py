"""What a camera's pictures are worth: the response to an edge."""

from dataclasses import replace

import numpy as np

from gpusim.data.charts import chart
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.measure.sfr import EdgeResponse, mtf50
from gpusim.measure.sfr import sfr as measured
from gpusim.plot.canvas import QUIET, axes_of, channel_colors, finish

EDGE = (320, 240)  # pixels of the slanted edge that a camera is shown
FRAMES = 16  # of it whose mean is measured
FINE = 2  # samples of it along a pixel, so that the chart's own blur is small


def sfr(what, ax=None, *, seed: int = 0, device="auto"):
    """Spatial frequency response by a slanted edge (ISO 12233), MTF50 of each channel marked.

    what: a Camera, which is shown the chart "slanted-edge", exposed automatically, and of 16 frames of it the mean is
    measured; a frame of one such edge; or an EdgeResponse of `gpusim.measure.sfr`. seed, device: by which a camera
    takes them. Returns the axes. Raises BadData, Missing.
    """
    found, letters, name, pitch = _response(what, seed, device)
    ax, responses = axes_of(ax), np.atleast_2d(found.response)
    frequencies, unit = (found.frequencies, "cycle/pixel") if found.per_mm is None else (found.per_mm, "cycle/mm")
    colors = channel_colors(letters)
    for letter, response, half in zip(letters, responses, np.atleast_1d(mtf50(found)), strict=True):
        ax.plot(frequencies, response, color=colors[letter], label=f"{letter}: MTF50 {half:.4g} {unit}".lstrip(": "))
        ax.plot([half], [0.5], "o", color=colors[letter], markersize=4)
    ax.axhline(0.5, color=QUIET, linewidth=0.8, zorder=0.5)
    nyquist = 0.5 if pitch is None else 0.5e-3 / pitch
    ax.axvline(nyquist, color=QUIET, linewidth=0.8, zorder=0.5)
    ax.text(nyquist, 0.02, " Nyquist", color="0.4", fontsize="small")
    ax.set_xlim(0, frequencies[-1])
    ax.set_ylim(0, max(1.05, 1.05 * float(responses.max())))
    return finish(ax, f"{name}: SFR of a slanted edge", f"frequency along the edge's normal [{unit}]", "response")


def _response(what, seed, device):
    """Edge response, letters of its planes, a name and the pixels' pitch [m]."""
    if isinstance(what, EdgeResponse):
        letters = "RGB" if np.shape(what.response)[:-1] == (3,) else range(len(np.atleast_2d(what.response)))
        pitch = None if what.per_mm is None else float(what.frequencies[1] / what.per_mm[1] * 1e-3)
        return what, ["" if len(letters) == 1 else str(one) for one in letters], "edge", pitch
    if isinstance(what, Camera):
        from gpusim.simulator import Simulator

        camera = replace(what, sensor=replace(what.sensor, exposure_time=None))
        edge = chart("slanted-edge", size=EDGE, samples_per_pixel=FINE)
        frames = list(Simulator(camera, device=device).frames(edge, FRAMES, seed=seed))
    elif hasattr(what, "linear") and hasattr(what, "camera"):
        frames = [what]
    else:
        raise BadData(f"sfr: {type(what).__name__}, wanted a Camera, a frame of a slanted edge or an EdgeResponse")
    sensor = frames[0].camera.sensor
    linear = np.mean([frame.linear for frame in frames], axis=0)
    linear, letters = (linear[..., 0], sensor.channels) if sensor.is_monochrome else (linear, "RGB")
    return measured(linear, pitch=sensor.pixel_pitch), letters, frames[0].camera.name, sensor.pixel_pitch

"""What a camera's pictures are worth: the pictures, their response to an edge, and their colours."""

from dataclasses import replace
from typing import Any

import numpy as np

from gpusim.data.charts import chart
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.scene import Scene
from gpusim.measure.checker import checker_of
from gpusim.measure.difference import ciede2000
from gpusim.measure.sfr import EdgeResponse, mtf50
from gpusim.measure.sfr import sfr as measured
from gpusim.plot.canvas import (
    BAR,
    QUIET,
    axes_of,
    channel_colors,
    curve,
    error_map,
    finish,
    image,
    panels,
    picture_size,
    srgb,
    widened,
)

EDGE = (320, 240)  # pixels of the slanted edge that a camera is shown
FRAMES = 16  # of it whose mean is measured
HIGH = 99.5  # percentile of a map of errors that has its brightest colour
FINE = 2  # samples of it along a pixel, so that the chart's own blur is small


def sfr(what, ax=None, *, seed: int = 0, device="auto", label: str = "") -> Any:
    """Spatial frequency response by a slanted edge (ISO 12233), MTF50 of each channel marked.

    what: a Camera, which is shown the chart "slanted-edge", exposed automatically, and of 16 frames of it the mean is
    measured; a frame of one such edge; or an EdgeResponse of `gpusim.measure.sfr`. Frequencies of a camera are in
    cycle/mm, unless its pixels are binned to oblongs; a frame does not tell how it was binned: its own are in
    cycle/pixel. seed, device: by which a camera takes them. label: what the legend names it by, where several are
    drawn on one `ax`. Returns the axes. Raises BadData, Missing.
    """
    found, letters, camera, pitch = _response(what, seed, device)
    ax, responses = axes_of(ax), np.atleast_2d(found.response)
    frequencies, unit = (
        (found.frequencies, "cycle/pixel") if found.per_mm is None else (found.per_mm, "cycle/mm")
    )
    colors = channel_colors(letters)
    right, top = widened(ax, frequencies[-1]), ax.get_ylim()[1] if ax.get_lines() else 1.05
    for letter, response, half in zip(letters, responses, np.atleast_1d(mtf50(found)), strict=True):
        name = f"{label} {letter}".strip()
        curve(
            ax,
            frequencies,
            response,
            colors[letter],
            f"{name}: MTF50 {half:.4g} {unit}".lstrip(": "),
        )
        ax.plot([half], [0.5], "o", color=colors[letter], markersize=4)
    ax.axhline(0.5, color=QUIET, linewidth=0.8, zorder=0.5)
    nyquist = 0.5 if pitch is None else 0.5e-3 / pitch
    ax.axvline(nyquist, color=QUIET, linewidth=0.8, zorder=0.5)
    ax.text(nyquist, 0.02, " Nyquist", color="0.4", fontsize="small", clip_on=True)
    ax.set_xlim(0, right)
    ax.set_ylim(0, max(top, 1.05 * float(responses.max())))
    return finish(
        ax,
        camera,
        "SFR of a slanted edge",
        f"frequency along the edge's normal [{unit}]",
        "response",
    )


def picture(frame, ax=None) -> Any:
    """A frame's picture, its display codes. Returns the axes. Raises BadData, Missing."""
    _require_frame(frame, "picture")
    codes = frame.rgb
    rows, cols = codes.shape[:2]
    return image(
        axes_of(ax, picture_size((rows, cols))),
        codes,
        f"{frame.camera.name}: {cols} x {rows} pixels, exposed {1e3 * frame.exposure_time:.4g} ms",
    )


def delta_e(frame, reference, ax=None) -> Any:
    """CIEDE2000 of every pixel of a frame against a reference, most often the Scene it is of: see `measure.ciede2000`.

    Returns the axes. Raises BadData, Missing.
    """
    _require_frame(frame, "delta_e")
    found = ciede2000(frame, reference)
    title = (
        f"{frame.camera.name}: colour error, mean {found.mean():.2f}, 95 % below "
        f"{np.percentile(found, 95):.2f}"
    )
    return error_map(
        axes_of(ax, picture_size(found.shape, BAR)),
        found,
        title,
        "CIEDE2000",
        cmap="viridis",
        vmin=0,
        vmax=max(float(np.percentile(found, HIGH)), 1e-6),
    )


def color_checker(frame, scene, ax=None) -> Any:
    """CIEDE2000 of the 24 patches of the chart "colorchecker", a bar of the patch's own colour each.

    frame: of `scene`, the chart. Means of the patches are compared: noise is no part of it, but for its bias. Returns
    the axes. Raises BadData, Missing.
    """
    _require_frame(frame, "color_checker")
    checker = checker_of(scene) if isinstance(scene, Scene) else None
    if checker is None or frame.linear.shape[:2] != scene.shape:
        raise BadData(
            'color_checker: wanted a frame and its scene, the chart "colorchecker" of 48 rows or more in a '
            "known light, not binned"
        )
    found = checker.differences(frame.linear, frame.rendering.diffuser, frame.camera.display)
    ax = axes_of(ax, (7.6, 4.2))
    ax.bar(
        np.arange(1, 25),
        found,
        color=srgb(checker.true.T[..., None])[:, 0],
        edgecolor="0.3",
        linewidth=0.6,
    )
    ax.axhline(
        found.mean(),
        color="0.3",
        linestyle="--",
        label=f"mean {found.mean():.2f}, largest {found.max():.2f}",
    )
    ax.set_xticks(np.arange(1, 25))
    ax.set_xlim(0.3, 24.7)
    ax.set_ylim(0, 1.15 * float(found.max()) or 1.0)
    finish(
        ax,
        frame.camera.name,
        "colour error of a ColorChecker",
        "patch, from dark skin (1) to black (24)",
        "CIEDE2000",
    )
    ax.grid(False, axis="x")
    return ax


def colors(frame, scene, figure=None) -> Any:
    """A frame's colour errors: `delta_e` against its scene and, of a ColorChecker, `color_checker` beside it.

    Returns the figure of matplotlib. Raises BadData, Missing.
    """
    _require_frame(frame, "colors")
    has_patches = (
        isinstance(scene, Scene)
        and checker_of(scene) is not None
        and frame.linear.shape[:2] == scene.shape
    )
    figure, axes = panels(figure, 1, 1 + has_patches, (6.5 + 6.5 * has_patches, 4.4))
    delta_e(frame, scene, axes[0, 0])
    if has_patches:
        color_checker(frame, scene, axes[0, 1])
    return figure


def _response(what, seed, device):
    """Edge response, letters of its planes, a name and the pixels' pitch [m]."""
    if isinstance(what, EdgeResponse):
        letters = (
            "RGB"
            if np.shape(what.response)[:-1] == (3,)
            else range(len(np.atleast_2d(what.response)))
        )
        pitch = None if what.per_mm is None else float(what.frequencies[1] / what.per_mm[1] * 1e-3)
        return what, ["" if len(letters) == 1 else str(one) for one in letters], "", pitch
    pitch = None
    if isinstance(what, Camera):
        from gpusim.pipeline.simulator import Simulator

        height, width = what.sensor.binning
        pitch = what.sensor.pixel_pitch * height if height == width else None
        camera = replace(what, sensor=replace(what.sensor, exposure_time=None))
        edge = chart("slanted-edge", size=EDGE, samples_per_pixel=FINE)
        frames = list(Simulator(camera, device=device).frames(edge, FRAMES, seed=seed))
    elif _is_frame(what):
        frames = [what]
    else:
        raise BadData(
            f"sfr: {type(what).__name__}, wanted a Camera, a frame of a slanted edge or an EdgeResponse"
        )
    sensor = frames[0].camera.sensor
    linear = np.mean([frame.linear for frame in frames], axis=0)
    linear, letters = (linear[..., 0], sensor.channels) if sensor.is_monochrome else (linear, "RGB")
    return measured(linear, pitch=pitch), letters, frames[0].camera.name, pitch


def _is_frame(what):
    return hasattr(what, "linear") and hasattr(what, "camera")


def _require_frame(frame, name):
    if not _is_frame(frame):
        raise BadData(f"{name}: {type(frame).__name__}, wanted a frame")

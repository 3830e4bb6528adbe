"""Quality of a camera's pictures: the pictures, their edge response and their colours."""

from dataclasses import replace
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.data.charts import chart
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.scene import Scene
from gpusim.measure.checker import checker_of
from gpusim.measure.difference import ciede2000
from gpusim.measure.sfr import EdgeResponse, mtf50
from gpusim.measure.sfr import sfr as measure_sfr
from gpusim.plot.canvas import (
    BAR,
    QUIET,
    axes_of,
    channel_colors,
    curve,
    error_map,
    finish,
    image,
    is_frame,
    panels,
    picture_size,
    require_frame,
    srgb,
    widen_limit,
)

EDGE = (320, 240)  # pixels of the slanted edge for a camera
FRAMES = 16  # frames of it whose mean is measured
HIGH = 99.5  # percentile of the error at the brightest colour
FINE = 2  # samples of it along a pixel, which keeps the chart's own blur small


def sfr(
    what: Any,
    ax: Any = None,
    *,
    seed: int = 0,
    device: Device | str = "auto",
    label: str = "",
) -> Any:
    """Plot the spatial frequency response of a slanted edge (ISO 12233) with each channel's MTF50.

    Frequencies of a camera are in cycle/mm, unless its pixels are binned to rectangles. Frequencies
    of a frame are in cycle/pixel, because a frame does not report its binning.

    Args:
        what: a Camera, measured with the mean of 16 automatically exposed frames of the chart
            "slanted-edge"; a frame of one such edge; or an EdgeResponse of `gpusim.measure.sfr`.
        ax: matplotlib axes; None makes a new figure.
        seed: seed of a camera's frames.
        device: device for a camera's frames, see `gpusim.Simulator`.
        label: name in the legend, for several curves on one `ax`.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type, or the edge cannot be measured.
        Missing: if matplotlib is not installed.
    """
    found, letters, camera, pitch = _response(what, seed, device)
    ax, responses = axes_of(ax), np.atleast_2d(found.response)
    frequencies, unit = (
        (found.frequencies, "cycle/pixel") if found.per_mm is None else (found.per_mm, "cycle/mm")
    )
    colors = channel_colors(letters)
    right, top = widen_limit(ax, frequencies[-1]), ax.get_ylim()[1] if ax.get_lines() else 1.05
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


def picture(frame: Any, ax: Any = None) -> Any:
    """Plot a frame's picture, its display codes.

    Args:
        frame: frame to plot.
        ax: matplotlib axes; None makes a new figure.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type.
        Missing: if matplotlib is not installed.
    """
    require_frame(frame, "picture")
    codes = frame.rgb
    rows, cols = codes.shape[:2]
    return image(
        axes_of(ax, picture_size((rows, cols))),
        codes,
        f"{frame.camera.name}: {cols} x {rows} pixels, exposed {1e3 * frame.exposure_time:.4g} ms",
    )


def delta_e(frame: Any, reference: Any, ax: Any = None) -> Any:
    """Plot the CIEDE2000 of every pixel of a frame against a reference.

    See `measure.ciede2000`.

    Args:
        frame: frame to plot.
        reference: usually the frame's Scene; see `measure.ciede2000`.
        ax: matplotlib axes; None makes a new figure.

    Returns:
        The axes.

    Raises:
        BadData: if an argument has the wrong type or shape.
        Missing: if matplotlib is not installed.
    """
    require_frame(frame, "delta_e")
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


def color_checker(frame: Any, scene: Scene, ax: Any = None) -> Any:
    """Plot the CIEDE2000 of the 24 patches of the chart "colorchecker".

    Each bar has the colour of its patch. Means of the patches are compared: noise contributes only
    through its bias.

    Args:
        frame: frame of `scene`.
        scene: the chart.
        ax: matplotlib axes; None makes a new figure.

    Returns:
        The axes.

    Raises:
        BadData: if the frame and scene are not of the chart in a known light, or the frame is
            binned.
        Missing: if matplotlib is not installed.
    """
    require_frame(frame, "color_checker")
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


def colors(frame: Any, scene: Scene, figure: Any = None) -> Any:
    """Plot a frame's colour errors: `delta_e` and, for a ColorChecker, `color_checker`.

    Args:
        frame: frame of `scene`.
        scene: the frame's scene.
        figure: matplotlib figure; None makes a new one.

    Returns:
        The figure.

    Raises:
        BadData: if an argument has the wrong type or shape.
        Missing: if matplotlib is not installed.
    """
    require_frame(frame, "colors")
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
    """Return the edge response, letters of its planes, a name and the pixel pitch [m]."""
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
    elif is_frame(what):
        frames = [what]
    else:
        raise BadData(
            f"sfr: {type(what).__name__}, wanted a Camera, a frame of a slanted edge or an EdgeResponse"
        )
    sensor = frames[0].camera.sensor
    linear = np.mean([frame.linear for frame in frames], axis=0)
    linear, letters = (linear[..., 0], sensor.channels) if sensor.is_monochrome else (linear, "RGB")
    return measure_sfr(linear, pitch=pitch), letters, frames[0].camera.name, pitch

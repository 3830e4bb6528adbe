"""Displays of frames, scenes, cameras and reports in windows and notebooks: plots, PNG, HTML."""

import io
from html import escape

import numpy as np

from gpusim.domain.camera import Camera
from gpusim.domain.errors import GpusimError
from gpusim.domain.scene import Scene
from gpusim.pipeline.frame import Frame
from gpusim.pipeline.report import Report
from gpusim.plot.cameras import camera as camera_plot
from gpusim.plot.canvas import window
from gpusim.plot.errors import plan
from gpusim.plot.light import inspect, radiance_codes
from gpusim.plot.pictures import picture

PLOTS = {Frame: picture, Scene: inspect, Camera: camera_plot, Report: plan}
LEAST, MOST = 256, 1024  # [pixel] longer side of a notebook's picture


def show(what):
    """Show the plot of a frame, scene, camera or report in a window; return the figure.

    Raises BadData, Missing.
    """
    pyplot = window(f"{type(what).__name__}.show()", "gs.plot and savefig of its figures")
    drawn = next(plot for kind, plot in PLOTS.items() if isinstance(what, kind))(what)
    pyplot.show()
    return getattr(drawn, "figure", None) or drawn


def png(what) -> bytes | None:
    """Return a frame's picture or a scene's radiance as PNG, subsampled if it is large.

    Returns None, which notebooks accept, for a scene whose light is invisible.
    """
    from PIL import Image

    try:
        codes = (
            what.rgb
            if isinstance(what, Frame)
            else _radiance(what, max(1, max(what.shape) // MOST))
        )
    except GpusimError:
        return None
    shown = Image.fromarray(np.ascontiguousarray(codes))
    longer = max(shown.size)
    if longer > MOST:
        shown = shown.reduce(-(-longer // MOST))
    elif longer < LEAST:
        times = -(-LEAST // longer)
        shown = shown.resize((shown.width * times, shown.height * times), Image.Resampling.NEAREST)
    buffer = io.BytesIO()
    shown.save(buffer, "PNG")
    return buffer.getvalue()


def _radiance(scene, step):
    return (255 * radiance_codes(scene, step)[0] + 0.5).astype(np.uint8)


def html(what) -> str:
    """Return the table of a camera or report as HTML."""
    return _camera(what) if isinstance(what, Camera) else _report(what)


def _camera(camera):
    optics, sensor, noise, processor = (
        camera.optics,
        camera.sensor,
        camera.sensor.noise,
        camera.processor,
    )
    time = "automatic" if sensor.exposure_time is None else f"{1e3 * sensor.exposure_time:.4g} ms"
    mosaic = f"stacked {''.join(sensor.channels)}" if sensor.stacked else "/".join(sensor.cfa)
    rows = [
        (
            "lens",
            f"f/{optics.f_number:g}, {1e3 * optics.focal_length:.4g} mm, {optics.description}",
        ),
        ("pixels", f"{1e6 * sensor.pixel_pitch:.4g} µm, {mosaic}, {sensor.full_well:.6g} e⁻"),
        (
            "converter",
            f"{sensor.bits} bits, {sensor.gain_dn_per_electron:.4g} DN/e⁻, black {sensor.black_level}",
        ),
        (
            "noise",
            f"read {sensor.read_sigma:.3g} e⁻, dark current {noise.dark_current:.3g} e⁻/s, PRNU "
            f"{100 * noise.prnu:.3g} %, DSNU {noise.dsnu:.3g} e⁻",
        ),
        ("exposure", time),
        (
            "processor",
            f"{camera.demosaic_method}, colour {processor.color}, display {camera.display.name}",
        ),
    ]
    return _table(f"Camera {camera.name}", rows)


def _report(report):
    verdict, heading, *_ = str(report).split("\n")
    rows = [("verdict", "", verdict)]
    rows += [(stage.stage, f"{stage.ms:.3g} ms", stage.model) for stage in report.stages]
    rows.append(
        (
            "sum of stages",
            f"{report.ms:.3g} ms",
            f"of {report.wall_ms:.4g} ms with planning and copies",
        )
    )
    for name, bound in report.errors:
        sigmas = f"99.9 % below {bound.p999_sigma:.2g} sigma, largest {bound.max_sigma:.2g} sigma"
        rows.append(
            (
                f"predicted error: {name}",
                *((f"{bound.rms:.2g} rms", sigmas) if bound.is_known else ("not known", "")),
            )
        )
    if report.error:
        error = report.error
        rows.append(
            (
                "true error",
                f"{error.rms:.2g} rms",
                f"99.9 % below {error.p999_sigma:.2g} sigma, largest {error.max_sigma:.2g} sigma",
            )
        )
    rows += [
        ("not modelled", "", "; ".join(report.left_out)),
        *(("note", "", note) for note in report.notes),
    ]
    return _table(heading.strip(), rows)


def _table(title, rows):
    """Return an HTML table with its title; the first column has the names of the rows."""
    body = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th>"
        + "".join(f"<td style='text-align:left'>{escape(cell)}</td>" for cell in cells)
        + "</tr>"
        for name, *cells in rows
    )
    return f"<table><caption style='text-align:left'>{escape(title)}</caption><tbody>{body}</tbody></table>"

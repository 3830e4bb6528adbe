"""`gpusim look`: plots of a scene, a camera or a frame, in a file or a window."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from gpusim.cli.options import (
    CAMERA_HELP,
    DEVELOPING,
    SCENE_HELP,
    Request,
    option,
    reads,
    scene_option,
    seed_option,
)
from gpusim.domain.errors import BadFile

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.domain.scene import Scene
    from gpusim.pipeline.simulator import Simulator

FORMATS = (".png", ".pdf", ".svg", ".jpg")
CHARTS = {"sfr": "slanted-edge"}  # the scene if none is named; of other panels the ColorChecker
SIZE = 480, 320  # its columns and rows
LENS = "f_number", "focus"  # controls that change the optical image
SENSOR = "exposure", "iso"  # controls that change raw values, too
OF_CAMERA = "border", "fov", "depth", "projection"  # options of a scene that only a camera sees
TEXTS = {
    "help": "plots of a scene, a camera or a frame, in a file or a window",
    "description": "Needs matplotlib: pip install 'gpusim[plot]'.",
}


@reads("COL,ROW or LEFT,TOP,RIGHT,BOTTOM, such as 40,30")
def _place(text):
    """Return the numbers of a pixel or a region."""
    numbers = tuple(int(part) for part in text.split(","))
    if len(numbers) not in (2, 4):
        raise ValueError
    return numbers


def _kinds(text):
    """Return wavelengths [nm] and letters of channels."""
    found: list[str | float] = []
    for part in text.split(","):
        try:
            found.append(float(part))
        except ValueError:
            found.append(part)
    return found


def _scene(request, plot):
    draw = plot.inspect if request.out is None else plot.scene
    return partial(draw, request.open_shown(OF_CAMERA))


def _spectra(request, plot):
    return partial(plot.spectra, request.open_shown(OF_CAMERA), request.at)


def _optical_image(request, plot):
    camera, scene = request.open_camera(*LENS), request.open_shown()
    return partial(plot.optical_image, camera, scene, device=request.device)


def _sfr(request, plot):
    if request.scene is not None:
        return _of_frame("sfr")(request, plot)
    camera = request.open_camera(*LENS, "iso")
    return partial(plot.sfr, camera, seed=request.seed, device=request.device)


def _snr(request, plot):
    camera = request.open_camera(*SENSOR)
    seconds = camera.sensor.exposure_time or 0.0
    return partial(plot.snr, camera, light=request.light or "D65", seconds=seconds)


def _photon_transfer(request, plot):
    camera = request.open_camera("iso")
    return partial(plot.photon_transfer, camera, seed=request.seed, device=request.device)


def _camera(request, plot):
    return partial(plot.camera, request.open_camera(*LENS, "iso"))


def _picture(request, plot):
    simulator, scene, seed = request.open_simulator(), request.open_shown(), request.seed
    return lambda: plot.picture(simulator(scene, seed=seed))


def _colors(request, plot):
    request.refuse(
        "band", "channels named by it are radiance in an unknown light, without true colours"
    )
    camera = request.open_camera(*LENS, *SENSOR, *DEVELOPING)
    simulator, scene, seed = request.open_simulator(camera), request.open_shown(), request.seed
    return lambda: plot.colors(simulator(scene, seed=seed), scene)


def _error(request, plot):
    return partial(plot.error, request.open_unrendered(), request.open_shown())


def _plan(request, plot):
    from gpusim.judge.plan_summary import Forecast

    camera = request.open_camera(*LENS, *SENSOR, "demosaic", "denoise", "look")
    simulator, scene = request.open_simulator(camera), request.open_shown()
    return lambda: plot.plan(Forecast.of(simulator, scene))


def _of_lens(name):
    """Return the panel of a function of `plot` that takes a camera's lens."""
    return lambda request, plot: partial(
        getattr(plot, name), request.open_camera(*LENS), request.of
    )


def _of_frame(name):
    """Return the panel of a function of `plot` that takes a frame's raw values."""

    def panel(request, plot):
        simulator, scene, seed = request.open_unrendered(), request.open_shown(), request.seed
        return lambda: getattr(plot, name)(simulator(scene, seed=seed))

    return panel


# name -> function from the request and `gpusim.plot` to a function that draws, and words for the
# help
PANELS: dict[str, tuple[Callable, str]] = {
    "scene": (_scene, "radiance as sRGB; in a window, click a pixel for its spectrum"),
    "spectra": (_spectra, "spectra of pixels or regions of the scene, see --at"),
    "oi": (_optical_image, "optical image: irradiance as sRGB"),
    "psf": (_of_lens("psf"), "point spread functions by wavelength and channel"),
    "mtf": (_of_lens("mtf"), "modulation transfer functions of the lens by wavelength and channel"),
    "camera": (_camera, "quantum efficiency, point spread, MTF and SNR"),
    "raw": (_of_frame("raw"), "mosaic in the colours of its filters"),
    "picture": (_picture, "display codes"),
    "noise": (_of_frame("noise"), "histogram of a frame's noise over its expected sigma"),
    "ptc": (_photon_transfer, "photon transfer curve"),
    "snr": (_snr, "signal to noise ratio against exposure"),
    "sfr": (_sfr, "spatial frequency response of a slanted edge, with MTF50"),
    "colors": (_colors, "colour errors of a frame and of the patches of a ColorChecker"),
    "error": (_error, "mean electrons against the float64 reference"),
    "plan": (_plan, "cost of a frame by stage, and its predicted errors by cause"),
}


@dataclass(frozen=True, kw_only=True)
class LookRequest(Request):
    """Options of `gpusim look`."""

    scene: str | None = scene_option(
        f"{SCENE_HELP}; psf, mtf, camera, snr and ptc take none (default: colorchecker, for sfr "
        f"slanted-edge, {SIZE[0]}x{SIZE[1]})",
        nargs="?",
    )
    camera: str = option(default="phone", help=f"{CAMERA_HELP} (default: phone)")
    what: str = option(
        default="scene",
        choices=PANELS,
        metavar="PANEL",
        help="; ".join(f"{name}: {words}" for name, (_, words) in PANELS.items())
        + " (default: scene)",
    )
    at: list[tuple[int, ...]] | None = option(
        type=_place,
        action="append",
        metavar="PLACE",
        help="for spectra: a pixel COL,ROW or a region LEFT,TOP,RIGHT,BOTTOM; may be repeated "
        "(default: the whole frame)",
    )
    of: list[str | float] | None = option(
        type=_kinds,
        metavar="LIST",
        help="for psf and mtf: wavelengths in nm and letters of channels, such as 450,550,R "
        "(default: 450,550,650 and all channels)",
    )
    seed: int = seed_option("the temporal noise")
    out: str | None = option(
        "-o", "--out", metavar="OUT", help=f"file: {', '.join(FORMATS)} (default: a window)"
    )

    def open_shown(self, unused: tuple[str, ...] = ()) -> "Scene":
        """Return the scene of the command line, or the panel's own. unused: see `open_scene`."""
        if self.scene is not None:
            return self.open_scene(unused=unused)
        chart = CHARTS.get(self.what, "colorchecker")
        return self.open_scene(chart, unused, size=self.size or SIZE)

    def open_unrendered(self) -> "Simulator":
        """Return the simulator of a panel that shows no picture, so that `scaling` is not read."""
        return self.open_simulator(self.open_camera(*LENS, *SENSOR))


def look(request: LookRequest) -> int:
    """Run `gpusim look`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim import plot
    from gpusim.io.atomic import atomic_path, check_output
    from gpusim.plot.canvas import matplotlib, window

    out = request.out
    pyplot = window("look", "a file, such as -o look.png") if out is None else matplotlib()
    if out is not None and Path(out).suffix.lower() not in FORMATS:
        raise BadFile(out, f"a picture of a plot has the suffix {', '.join(FORMATS)}")
    check_output(out)
    if out is not None:
        pyplot.switch_backend("agg")
    draw = PANELS[request.what][0](request, plot)
    request.refuse_unread(f"look --what {request.what}")
    found = draw()
    if out is None:
        pyplot.show()
        return 0
    with atomic_path(out) as temporary:
        getattr(found, "figure", found).savefig(temporary, dpi=120)
    pyplot.close("all")
    return 0

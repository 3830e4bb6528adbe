"""`gpusim look`: plots of a scene, a camera or a frame, in a file or a window."""

import argparse
from collections.abc import Callable
from pathlib import Path

from gpusim.cli.options import Reading, add_asked, operated, scene_of, whole
from gpusim.domain.errors import BadFile

FORMATS = (".png", ".pdf", ".svg", ".jpg")
CHARTS = {"sfr": "slanted-edge"}  # shown where no scene is named; else the ColorChecker
SIZE = 480, 320  # columns and rows of these


def add_command(commands):
    """Add `look` to the subparsers of `gpusim`; its default `run` is `look`."""
    parser = commands.add_parser(
        "look",
        help="plots of a scene, a camera or a frame, in a file or a window",
        description="Needs matplotlib: pip install 'gpusim[plot]'.",
    )
    add_asked(
        parser,
        camera="phone",
        more="; psf, mtf, snr and ptc need none (default: colorchecker, of sfr "
        f"slanted-edge, {SIZE[0]}x{SIZE[1]})",
    )
    parser.add_argument(
        "--what",
        choices=PANELS,
        default="scene",
        metavar="PANEL",
        help="; ".join(f"{name}: {words}" for name, (_, words) in PANELS.items())
        + " (default: scene)",
    )
    parser.add_argument(
        "--at",
        type=_place,
        action="append",
        metavar="PLACE",
        help="of spectra: a pixel COL,ROW or a "
        "region LEFT,TOP,RIGHT,BOTTOM; may be repeated (default: all of the frame)",
    )
    parser.add_argument(
        "--of",
        type=_kinds,
        metavar="LIST",
        help="of psf and mtf: wavelengths in nm and letters of "
        "channels, such as 450,550,R (default: 450,550,650 and all channels)",
    )
    parser.add_argument(
        "--seed", type=whole(0, 2**64 - 1), default=0, help="of the temporal noise (default: 0)"
    )
    parser.add_argument(
        "-o", "--out", metavar="OUT", help=f"{', '.join(FORMATS)} (default: a window)"
    )
    parser.set_defaults(run=lambda arguments: look(Reading(arguments, parser)))


def look(arguments) -> int:
    """Run `gpusim look`; returns the exit status. Raises GpusimError."""
    from gpusim import plot
    from gpusim.io.atomic import atomic_path, check_output
    from gpusim.io.camera.cameras import open_camera
    from gpusim.plot.canvas import matplotlib, window

    out = arguments.out
    pyplot = window("look", "a file, such as -o look.png") if out is None else matplotlib()
    if out is not None and Path(out).suffix.lower() not in FORMATS:
        raise BadFile(out, f"a picture of a plot has the suffix {', '.join(FORMATS)}")
    check_output(out)
    if out is not None:
        pyplot.switch_backend("agg")
    camera = operated(open_camera(arguments.camera), arguments)
    found = PANELS[arguments.what][0](_Asked(arguments, camera), plot)
    arguments.refuse_unread(f"look --what {arguments.what}")
    if out is None:
        pyplot.show()
        return 0
    with atomic_path(out) as temporary:
        getattr(found, "figure", found).savefig(temporary, dpi=120)
    pyplot.close("all")
    return 0


class _Asked:
    """What the command line asks for; the scene and what is made of it only when a panel wants it."""

    def __init__(self, arguments, camera):
        self.arguments, self.camera = arguments, camera
        self.is_named = arguments.scene is not None

    @property
    def scene(self):
        arguments = self.arguments
        if self.is_named:
            return scene_of(arguments)
        arguments.size = arguments.size or SIZE
        return scene_of(arguments, CHARTS.get(arguments.what, "colorchecker"))

    @property
    def simulator(self):
        from gpusim.pipeline.simulator import Simulator

        asked = self.arguments
        return Simulator(
            self.camera,
            device=asked.device,
            tolerance=asked.tolerance,
            guaranteed=asked.guaranteed,
            strict=asked.strict,
        )

    def frame(self, scene):
        return self.simulator(scene, seed=self.arguments.seed)


def _shown_scene(asked, plot):
    return plot.scene(asked.scene) if asked.arguments.out is not None else plot.inspect(asked.scene)


def _sfr(asked, plot):
    if asked.is_named:
        return plot.sfr(asked.frame(asked.scene))
    return plot.sfr(asked.camera, seed=asked.arguments.seed, device=asked.arguments.device)


def _snr(asked, plot):
    seconds = asked.camera.sensor.exposure_time or 0.0
    return plot.snr(asked.camera, light=asked.arguments.light or "D65", seconds=seconds)


def _colors(asked, plot):
    scene = asked.scene
    return plot.colors(asked.frame(scene), scene)


def _plan(asked, plot):
    from gpusim.judge.plan_summary import Forecast

    return plot.plan(Forecast.of(asked.simulator, asked.scene))


PANELS: dict[str, tuple[Callable, str]] = {
    "scene": (
        _shown_scene,
        "the radiance as sRGB, in a window with the spectra of pixels that are clicked",
    ),
    "spectra": (
        lambda asked, plot: plot.spectra(asked.scene, asked.arguments.at),
        "of patches of the scene, --at",
    ),
    "oi": (
        lambda asked, plot: plot.optical_image(
            asked.camera, asked.scene, device=asked.arguments.device
        ),
        "the optical image, irradiance as sRGB",
    ),
    "psf": (
        lambda asked, plot: plot.psf(asked.camera, asked.arguments.of),
        "point spreads, by wavelength and channel",
    ),
    "mtf": (
        lambda asked, plot: plot.mtf(asked.camera, asked.arguments.of),
        "modulation transfer of the lens, by wavelength and channel",
    ),
    "camera": (
        lambda asked, plot: plot.camera(asked.camera),
        "quantum efficiency, point spread, MTF and SNR",
    ),
    "raw": (
        lambda asked, plot: plot.raw(asked.frame(asked.scene)),
        "the mosaic in its filters' colours",
    ),
    "picture": (lambda asked, plot: plot.picture(asked.frame(asked.scene)), "the display codes"),
    "noise": (
        lambda asked, plot: plot.noise(asked.frame(asked.scene)),
        "histogram of a frame's noise over what is expected",
    ),
    "ptc": (
        lambda asked, plot: plot.photon_transfer(
            asked.camera, seed=asked.arguments.seed, device=asked.arguments.device
        ),
        "photon transfer curve",
    ),
    "snr": (_snr, "signal to noise ratio against the exposure"),
    "sfr": (_sfr, "response to a slanted edge, with MTF50"),
    "colors": (_colors, "colour errors of the frame and of a ColorChecker's patches"),
    "error": (
        lambda asked, plot: plot.error(asked.simulator, asked.scene),
        "the mean electrons against the float64 reference",
    ),
    "plan": (_plan, "what a frame costs, stage by stage, and errs, cause by cause"),
}


def _place(text):
    try:
        numbers = tuple(int(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in (2, 4):
        raise argparse.ArgumentTypeError(
            f"{text!r}: wanted COL,ROW or LEFT,TOP,RIGHT,BOTTOM, such as 40,30"
        )
    return numbers


def _kinds(text):
    found: list[str | float] = []
    for part in text.split(","):
        try:
            found.append(float(part))
        except ValueError:
            found.append(part)
    return found

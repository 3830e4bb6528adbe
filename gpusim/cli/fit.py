"""`gpusim fit`: a camera file and a page from a camera's own raw files."""

from dataclasses import dataclass

from gpusim.cli.options import CAMERA_HELP, Options, flag, option

TEXTS = {
    "help": "fit a camera to its own raw files: noise, levels, colour, sharpness, with intervals",
    "description": (
        "The kind of shots comes from an option, from the name of their folder (darks, flats, pairs, chart, edges, "
        "grid, shading, ramp), or else from their content. Needs rawpy and matplotlib: pip install 'gpusim[fit]'."
    ),
}


@dataclass(frozen=True, kw_only=True)
class FitRequest(Options):
    """Options of `gpusim fit`."""

    files: list[str] | tuple = option(
        default=(),
        positional=True,
        nargs="*",
        metavar="FILES",
        help="raw files (.dng and others, .npz, .npy, .tif) or folders; give them before the options",
    )
    darks: list[str] | tuple = option(
        default=(),
        nargs="+",
        metavar="FILE",
        help="frames without light, of one or more exposure times",
    )
    flats: list[str] | tuple = option(
        default=(),
        nargs="+",
        metavar="FILE",
        help="pairs of evenly lit frames, from dark to beyond saturation",
    )
    pairs: list[str] | tuple = option(
        default=(),
        nargs="+",
        metavar="FILE",
        help="two frames or more of any static scene at each exposure, in place of flats or darks",
    )
    chart: list[str] | tuple = option(
        default=(), nargs="+", metavar="FILE", help="frames of a ColorChecker"
    )
    edges: list[str] | tuple = option(
        default=(), nargs="+", metavar="FILE", help="frames of slanted edges"
    )
    grid: list[str] | tuple = option(
        default=(), nargs="+", metavar="FILE", help="frames of a checkerboard"
    )
    shading: list[str] | tuple = option(
        default=(), nargs="+", metavar="FILE", help="evenly lit frames through the lens"
    )
    ramp: list[str] | tuple = option(
        default=(), nargs="+", metavar="FILE", help="frames of steps of light, also as JPEGs"
    )
    out: str = option("-o", "--out", metavar="MINE.toml", required=True, help="the camera file")
    page: str | None = option(
        metavar="FILE.html", help="the page (default: next to the camera file)"
    )
    maps: bool = flag("also write maps of DSNU and PRNU next to the camera file, .maps.npz")
    base: str | None = option(
        metavar="CAMERA",
        help=f"camera whose values stand for what is unknown: {CAMERA_HELP} (default: mono or phone)",
    )
    cfa: str | None = option(
        metavar="MOSAIC", help="mosaic of files that do not state it, such as bayer-rggb"
    )
    light: list[str] | tuple = option(
        default=(),
        nargs="+",
        metavar="LIGHT",
        help="light of each frame of the chart, such as D65 or lamp.csv (default: the likeliest of usual ones)",
    )


def fit(request: FitRequest) -> int:
    """Run `gpusim fit`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 0; 1 if the model does not explain the frames, or a part could not be fitted.

    Raises:
        GpusimError: An option or a file is wrong.
    """
    from gpusim.fit import fit as fit_camera
    from gpusim.fit.camera_text import words
    from gpusim.io.atomic import check_output

    for path in (request.out, request.page):
        check_output(path)
    found = fit_camera(
        request.files,
        darks=request.darks,
        flats=request.flats,
        pairs=request.pairs,
        chart=request.chart,
        edges=request.edges,
        grid=request.grid,
        shading=request.shading,
        ramp=request.ramp,
        base=request.base,
        cfa=request.cfa,
        options={"light": list(request.light)} if request.light else None,
    )
    written = found.write(request.out, request.page, request.maps)
    for line in found.lines:
        print(line)
    for key, one in found.estimates.items():
        print(f"{key:34s} {words(one)}")
    for title, lines in (
        ("not fitted", found.failed),
        ("not explained", found.unexplained),
        ("not known", found.unknown),
    ):
        for line in lines:
            print(f"{title}: {line}")
    print(f"wrote {', '.join(map(str, written))}")
    return 1 if found.unexplained or found.failed else 0

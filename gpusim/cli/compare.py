"""`gpusim compare`: a camera file against held-out raw files of the real camera."""

from dataclasses import dataclass

from gpusim.cli.options import (
    CAMERA_HELP,
    DEVICE_HELP,
    Options,
    number,
    option,
    seed_option,
    write_json,
)

TEXTS = {
    "help": "compare a camera file with held-out raw files of the real camera; status 1 if they differ",
    "description": (
        "Simulate the light of held-out frames and compare the noise, sharpness, colours and shading. Status 0: all "
        "statistics agree. 1: one differs. 3: one cannot be judged, there are too few frames. What frames show is told "
        "by an option, the name of their folder (darks, flats), or their content."
    ),
}


@dataclass(frozen=True, kw_only=True)
class CompareCameraRequest(Options):
    """Options of `gpusim compare`."""

    camera: str = option(default="", positional=True, metavar="CAMERA", help=CAMERA_HELP)
    files: list[str] | tuple = option(
        default=(),
        positional=True,
        nargs="*",
        metavar="HELD-OUT",
        help="raw files (.dng and others, .npz, .npy, .tif) or folders that were not fitted; give them before the "
        "options",
    )
    darks: list[str] | tuple = option(
        default=(),
        nargs="+",
        metavar="FILE",
        help="frames without light, two or more of each setting",
    )
    flats: list[str] | tuple = option(
        default=(), nargs="+", metavar="FILE", help="evenly lit frames, two or more of each level"
    )
    edges: list[str] | tuple = option(
        default=(), nargs="+", metavar="FILE", help="frames of one slanted edge"
    )
    chart: list[str] | tuple = option(
        default=(), nargs="+", metavar="FILE", help="frames that a ColorChecker fills"
    )
    shading: list[str] | tuple = option(
        default=(), nargs="+", metavar="FILE", help="whole frames of even light through the lens"
    )
    light: str = option(default="D65", help="light on chart and edge (default: D65)")
    base_iso: float | None = option(
        type=number("a number above 0", lambda value: 0 < value < 1e9),
        metavar="N",
        help="ISO speed at which the camera file's gain applies (default: that of the frames)",
    )
    cfa: str | None = option(
        metavar="MOSAIC", help="mosaic of files that do not state it, such as bayer-rggb"
    )
    device: str = option(default="auto", help=DEVICE_HELP)
    seed: int = seed_option("the simulated noise and the bootstrap")
    page: str | None = option(metavar="FILE.html", help="also write a page with figures")
    json: str | None = option(metavar="FILE", help="also write the statistics to a JSON file")


def compare(request: CompareCameraRequest) -> int:
    """Run `gpusim compare`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 0 all agree, 1 one differs, 3 one cannot be judged.

    Raises:
        GpusimError: An option or a file is wrong.
    """
    from dataclasses import asdict

    from gpusim.fit.compare import compare as compare_camera
    from gpusim.fit.verdicts import DIFFERS, UNKNOWN
    from gpusim.io.atomic import atomic_path, check_output

    if not (request.edges or request.chart or request.shading):
        request.refuse("light", "only edges, charts and shading are simulated in it")
    elif not (request.files or request.darks or request.flats):
        request.refuse("base_iso", "only the noise of darks and flats depends on it")
    for path in (request.page, request.json):
        check_output(path)
    settings = {} if request.cfa is None else {"cfa": request.cfa}
    found = compare_camera(
        request.camera,
        request.files,
        darks=request.darks,
        flats=request.flats,
        edges=request.edges,
        charts=request.chart,
        shadings=request.shading,
        light=request.light,
        base_iso=request.base_iso,
        seed=request.seed,
        device=request.device,
        **settings,
    )
    print(*found.lines(), sep="\n")
    if request.page:
        from gpusim.fit.compare_page import compare_page

        text = compare_page(found)
        with atomic_path(request.page) as temporary:
            temporary.write_text(text, "utf-8")
    write_json(
        request.json,
        {"verdict": found.state, "statistics": [asdict(one) for one in found.findings]},
    )
    return {DIFFERS: 1, UNKNOWN: 3}.get(found.state, 0)

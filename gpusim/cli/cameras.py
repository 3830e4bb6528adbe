"""`gpusim cameras`: real cameras by name, from the data bases that are installed."""

from dataclasses import dataclass
from math import inf

from gpusim.cli.options import Options, number, option
from gpusim.domain.errors import Conflict

TEXTS = {
    "help": "list real cameras of public data bases by name, and compose a camera file",
    "description": "Data bases that are installed are read in place: lensfun (lenses), darktable (noise by ISO), "
    "RawTherapee's camconst.json (levels), DNG camera profiles (colour) and libcamera's tuning files. Without a name: "
    "the data bases that are found. With a name: the cameras that have its words; with -o: a camera file, each value "
    "with its source.",
}
COMPOSING = (
    *("iso", "focal_length", "f_number", "distance", "columns", "channel", "full_well", "profile"),
    *("sensitivity",),
)


@dataclass(frozen=True, kw_only=True)
class CamerasRequest(Options):
    """Options of `gpusim cameras`."""

    name: str | None = option(
        positional=True,
        nargs="?",
        metavar="NAME",
        help='words of a camera\'s name, such as "Nikon D750"',
    )
    iso: float | None = option(
        type=number("a number above 0", lambda value: 0 < value < inf),
        metavar="N",
        help="ISO speed of the noise (default: the lowest of the data base)",
    )
    lens: str | None = option(
        metavar="NAME",
        help='words of a lens\'s name, such as "50mm f/1.8"; without -o: lists the lenses that fit',
    )
    focal_length: float | None = option(
        type=number("millimetres above 0", lambda value: 0 < value < inf),
        metavar="MM",
        help="focal length in mm (default: the lens's shortest)",
    )
    f_number: float | None = option(
        type=number("a number above 0", lambda value: 0 < value < inf),
        metavar="N",
        help="f-number (default: the lens's smallest)",
    )
    distance: float | None = option(
        type=number("metres above 0, or inf", lambda value: value > 0),
        metavar="METRES",
        help="distance of the plane in focus (default: inf)",
    )
    columns: int | None = option(
        type=int,
        metavar="PIXELS",
        help="pixels along the long side of the whole sensor (default: the data base's, or a "
        "guess); far fewer make a coarse frame",
    )
    channel: str = option(
        default="G",
        choices=("R", "G", "B"),
        help="channel of darktable's data base whose noise the pixels get (default: G)",
    )
    full_well: float | None = option(
        type=number("electrons above 0", lambda value: 0 < value < inf),
        metavar="ELECTRONS",
        help="electrons at white at the lowest ISO; scales the noise data (default: those of the data)",
    )
    profile: str | None = option(
        metavar="FILE", help="DNG camera profile of the colours, .dcp or .dng"
    )
    sensitivity: str | None = option(
        metavar="FILE.csv", help="measured sensitivities, first line wavelength_nm,R,G,B"
    )
    databases: list[str] | tuple = option(
        default=(),
        action="append",
        metavar="FOLDER",
        help="folder with data bases, searched before the usual places; may be repeated",
    )
    out: str | None = option("-o", "--out", metavar="FILE.toml", help="camera file to write")


def cameras(request: CamerasRequest) -> int:
    """Run `gpusim cameras`.

    Args:
        request: Options of the command.

    Returns:
        The exit status, 0.

    Raises:
        GpusimError: An option or a data base is wrong, or no camera or lens has the name.
    """
    from gpusim.apps.named.compose import compose
    from gpusim.apps.named.listing import camera_lines, composed_lines, database_lines, lens_lines
    from gpusim.apps.named.wish import Wish
    from gpusim.io.atomic import check_output
    from gpusim.io.databases.catalogue import open_catalogue

    _check(request)
    check_output(request.out)
    catalogue = open_catalogue(list(request.databases) or None)
    if request.name is None:
        print("\n".join(database_lines(catalogue)))
        return 0
    if not request.out and not any(map(request.is_given, COMPOSING)):
        found = catalogue.find(request.name) or [catalogue.camera(request.name)]
        if request.lens is None:
            print("\n".join(camera_lines(found)))
            return 0
        camera = catalogue.camera(request.name)
        catalogue.lens(request.lens, camera)
        print("\n".join(lens_lines(catalogue.find_lenses(request.lens, camera))))
        return 0
    composed = compose(
        catalogue,
        request.name,
        Wish(
            iso=request.iso,
            lens=request.lens,
            focal_length=request.focal_length and request.focal_length / 1e3,
            f_number=request.f_number,
            distance=inf if request.distance is None else request.distance,
            columns=request.columns,
            channel=request.channel,
            full_well=request.full_well,
            profile=request.profile,
            sensitivity=request.sensitivity,
        ),
    )
    if request.out:
        composed.save(request.out)
    print("\n".join(composed_lines(composed)))
    return 0


def _check(request):
    """Raise Conflict for options that do not fit one another."""
    if request.name is None:
        for key in (*COMPOSING, "lens", "out"):
            request.refuse(key, "it is of a camera, and no name is given", "give the camera's NAME")
    if request.out and not request.out.lower().endswith(".toml"):
        raise Conflict("-o", f"{request.out} is no .toml file", "give FILE.toml")

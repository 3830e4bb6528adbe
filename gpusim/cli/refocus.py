"""`gpusim refocus`: pictures, distances and a page from the views of a light field."""

from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpusim.cli.options import DEVICE_HELP, Options, flag, number, option, reads
from gpusim.domain.errors import Conflict, OutOfRange, UnknownName

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.domain.view_images import ViewImages

FORMATS = (".png", ".jpg", ".tif", ".exr", ".npy")
TEXTS = {
    "help": "refocus views of a light field: pictures, distances, a page with a slider",
    "description": "Views are linear pictures through the cells of a pupil, an .npz of gs.save_views.",
}


@reads("two lengths, NEAR,FAR, such as 0.3,inf [m]")
def _range(text):
    """Return the two distances of NEAR,FAR."""
    near, far = (float(part) for part in text.split(","))
    if not 0 < near <= far:
        raise ValueError
    return near, far


@dataclass(frozen=True, kw_only=True)
class RefocusRequest(Options):
    """Options of `gpusim refocus`."""

    views: str = option(positional=True, metavar="VIEWS", help="views, an .npz of gs.save_views")
    out: str | None = option(
        "-o",
        "--out",
        metavar="PICTURE",
        help=f"file of the picture, {', '.join(FORMATS)}; .exr and .npy hold the linear values",
    )
    distance: float | None = option(
        type=number("metres above 0, or inf", lambda value: value > 0),
        metavar="METRES",
        help="distance in focus (default: the distance at which the views coincide)",
    )
    slope: float | None = option(
        type=number("a finite number", lambda value: abs(value) < inf),
        metavar="PIXELS",
        help="displacement of things in focus per radius of the pupil, in place of --distance",
    )
    aperture: float | None = option(
        type=number("a radius above 0", lambda value: 0 < value < inf),
        metavar="RADIUS",
        help="radius of a round synthetic aperture in radii of the pupil (default: all views)",
    )
    all_in_focus: bool = flag("focus each pixel at its own distance")
    depth: str | None = option(
        metavar="FILE.npz",
        help="file of the distances: distance_m, nearest_m, farthest_m, slope and uncertainty",
    )
    page: str | None = option(
        metavar="FILE.html", help="file of a page with a slider of refocused pictures"
    )
    range: tuple[float, float] | None = option(
        type=_range,
        metavar="NEAR,FAR",
        help="distances of --all-in-focus, --depth and --page in metres (default: from half the distance at "
        "which the views coincide to infinity)",
    )
    white: float | None = option(
        type=number("a number above 0", lambda value: 0 < value < inf),
        metavar="VALUE",
        help="value of the views that is white in .png, .jpg, .tif and the page (default: the "
        "largest of the mean of all views)",
    )
    device: str = option(default="auto", help=DEVICE_HELP)


def refocus(request: RefocusRequest) -> int:
    """Run `gpusim refocus`.

    Args:
        request: Options of the command.

    Returns:
        The exit status, 0.

    Raises:
        GpusimError: An option or the file is wrong.
    """
    from gpusim.backends import open_device
    from gpusim.io.atomic import atomic_path, check_output
    from gpusim.io.frame.view_images import open_views

    check_request(request)
    for path in (request.out, request.depth, request.page):
        check_output(path)
    views, device = open_views(request.views), open_device(request.device)
    more: dict[str, Any] = {"aperture": request.aperture, "device": device}
    depth = None
    if request.depth or request.all_in_focus:
        from gpusim.captures.view_depth import depth_from_views
        from gpusim.io.archive import write_archive

        depth = depth_from_views(views, distances=request.range, device=device)
        if request.depth:
            write_archive(
                request.depth,
                {
                    "distance_m": depth.distance,
                    "nearest_m": depth.nearest,
                    "farthest_m": depth.farthest,
                    "slope_px_per_radius": depth.slope,
                    "uncertainty_px_per_radius": depth.uncertainty,
                },
            )
    if request.out:
        _write_picture(request, views, depth, more)
    if request.page:
        from gpusim.apps.refocus_page import refocus_page

        _check_channels(views, request.page)
        text = refocus_page(
            views, white=_white(request, views, device), distances=request.range, **more
        )
        with atomic_path(request.page) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return 0


def check_request(request: RefocusRequest) -> None:
    """Raise Conflict or UnknownName for options that do not fit one another."""
    if not (request.out or request.depth or request.page):
        raise Conflict(
            "refocus", "no output", "give -o PICTURE, --depth FILE.npz or --page FILE.html"
        )
    if request.distance is not None:
        request.refuse("slope", "--distance is given too")
    for name in ("distance", "slope"):
        if request.all_in_focus:
            request.refuse(name, "--all-in-focus focuses each pixel at its own distance")
        if not request.out:
            request.refuse(name, "it is of -o, which is missing", f"give -o, or leave {name} out")
    if not (request.out or request.page):
        request.refuse("aperture", "it is of -o and --page; distances are of all views")
    if not request.out:
        request.refuse("all_in_focus", "it is of -o, which is missing", "give -o")
    if not (request.all_in_focus or request.depth or request.page):
        request.refuse("range", "it is of --all-in-focus, --depth and --page")
    for path, known in ((request.out, FORMATS), (request.depth, (".npz",))):
        if path and Path(path).suffix.lower() not in known:
            raise UnknownName("output format", Path(path).suffix or path, known)
    if request.page and Path(request.page).suffix.lower() not in (".html", ".htm"):
        raise UnknownName("format of a page", Path(request.page).suffix or request.page, (".html",))
    is_coded = request.page or (
        request.out and Path(request.out).suffix.lower() not in (".exr", ".npy")
    )
    if not is_coded:
        request.refuse("white", "no output has display codes")


def _write_picture(request, views, depth, more):
    """Write the picture of -o."""
    import numpy as np

    from gpusim.apps.refocus_page import codes_of
    from gpusim.captures.refocus import refocus
    from gpusim.captures.view_depth import all_in_focus
    from gpusim.io.atomic import atomic_path
    from gpusim.io.exr import write_rgb_exr
    from gpusim.io.frame.images import write_jpeg, write_png, write_tiff

    suffix = Path(request.out).suffix.lower()
    if suffix != ".npy":
        _check_channels(views, request.out)
    if request.all_in_focus:
        picture = all_in_focus(views, depth, distances=request.range, **more)
    else:
        picture = refocus(views, distance=request.distance, slope=request.slope, **more)
    if suffix == ".npy":
        with atomic_path(request.out) as temporary, open(temporary, "wb") as file:
            np.save(file, picture)
    elif suffix == ".exr":
        write_rgb_exr(request.out, np.broadcast_to(picture, (*picture.shape[:2], 3)))
    else:
        white = _white(request, views, more["device"])
        codes = codes_of(picture, white, 16 if suffix == ".tif" else 8)
        write = {".png": write_png, ".jpg": write_jpeg, ".tif": write_tiff}[suffix]
        write(request.out, codes)


def _check_channels(views: "ViewImages", path):
    """Raise OutOfRange unless a picture of the views has one or three channels."""
    channels = views.values.shape[-1]
    if channels not in (1, 3):
        raise OutOfRange(f"channels of {path}", channels, "1 or 3; an .npy holds any number")


def _white(request, views, device):
    """Return the value of the views that is white."""
    from gpusim.captures.refocus import refocus

    if request.white is not None:
        return request.white
    largest = float(refocus(views, device=device).max())
    return largest if largest > 0 else 1.0

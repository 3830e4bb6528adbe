"""`gpusim preview`: one page of sliders and a live picture."""

import socket
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

from gpusim.apps.preview.guard import LOOPBACK
from gpusim.cli.captures import capture_option
from gpusim.cli.moving import MovingRequest
from gpusim.cli.options import DEVELOPING, option, whole
from gpusim.domain.errors import Missing, OutOfRange, UnknownName

if TYPE_CHECKING:  # the command line starts without them
    from gpusim.captures.capture import Capture

# relative to the light, so that one plan serves all exposures and noise settings
TOLERANCE = "1e-3"
GRACE = 1  # [s] that requests in progress may take at the end
# [s] without a sign of life after which a page is given up: a busy browser keeps its open panels
PATIENCE = 10.0
TEXTS = {"help": "a page on this machine: move a slider, see the picture change"}


@dataclass(frozen=True, kw_only=True)
class PreviewRequest(MovingRequest):
    """Options of `gpusim preview`."""

    REFUSED: ClassVar = {
        "iso": "the preview sets the gain with its slider",
        "guaranteed": "the preview plans only for the scene that it shows",
        "strict": "the page shows whether the tolerance is met",
    }

    capture: "Capture | None" = capture_option("; the page shows them merged")
    port: int = option(default=8080, type=whole(1, 65535), help="port of the page (default: 8080)")
    host: str = option(
        default="127.0.0.1",
        help="address of the page; any other than this machine's own lets its whole network move "
        "the sliders (default: 127.0.0.1)",
    )

    def changes(self) -> dict:
        """Return the settings of the camera by the names of the page's controls."""
        given = {
            "optics.f_number": self.f_number,
            "optics.object_distance_m": self.focus,
            "processor.scaling": self.scaling,
            **{f"processor.{name}": getattr(self, name) for name in DEVELOPING},
            "sensor.exposure_time_ms": self.exposure,
        }
        if isinstance(self.exposure, int | float):
            given["sensor.exposure_time_ms"] = 1e3 * self.exposure
        return {name: value for name, value in given.items() if value is not None}


def preview(request: PreviewRequest) -> int:
    """Run `gpusim preview`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    try:
        from nicegui import app, ui
    except ImportError:
        why = "preview: NiceGUI is not installed; wanted: pip install 'gpusim[preview]'"
        raise Missing(why) from None
    from gpusim.apps.preview.body_limit import BodyLimit
    from gpusim.apps.preview.controls import TOLERANCES
    from gpusim.apps.preview.guard import Guard, log_in_lines
    from gpusim.apps.preview.mount import mount
    from gpusim.apps.preview.producer import Producer
    from gpusim.apps.preview.shelf import Shelf
    from gpusim.apps.preview.state import State
    from gpusim.apps.preview.uploads import Uploads
    from gpusim.backends import open_device
    from gpusim.cli.preview_start import read_start
    from gpusim.domain.scene import PLANE

    changes, tolerance = request.changes(), request.tolerance or TOLERANCE
    if tolerance not in TOLERANCES:
        raise UnknownName("--tolerance of a preview", tolerance, TOLERANCES)
    scenes = request.open_scenes()
    if scenes.is_still:
        request.refuse("frames", "nothing moves", "leave it out, or add --pan or --roll")
    request.check_movement(scenes)
    period = 0.0 if scenes.is_still else float(1 / request.frame_rate(scenes))
    first, device = next(scenes.between(0, 1)), open_device(request.device)
    request.open_camera()  # refuses wrong settings before the page opens
    require_port(request.host, request.port)
    capture = request.capture
    if capture is not None:
        capture = replace(capture, merged=capture.merged or capture.has_frames)
    request.refuse_unread("preview")
    shown = read_start(request, scenes)
    is_unlit = request.light is None and request.luminance is None

    def make_producer():
        shelf = Shelf(Uploads(shown.known))
        if shown.scene.name and is_unlit and first.projection == PLANE:
            shelf.put(shown.scene, first)  # all pages share it
        return Producer(scenes, device, period, capture, shelf)

    mount(
        make_producer,
        State(request.camera, changes, tolerance=tolerance, scene=shown.scene, **shown.settings),
        first.name,
        first.shape,
        shown.start,
    )
    app.add_middleware(BodyLimit)
    hosts = LOOPBACK if request.host in LOOPBACK else (*LOOPBACK, request.host)
    app.add_middleware(Guard, hosts=hosts)
    log_in_lines()
    if request.host not in LOOPBACK:
        print(
            f"{request.host}: anyone who reaches this address may use this preview and its device"
        )
    print(f"http://{request.host}:{request.port}/  (Ctrl+C ends it)", flush=True)
    ui.run(
        host=request.host,
        port=request.port,
        reload=False,
        show=False,
        show_welcome_message=False,
        ws_per_message_deflate=False,
        ws_max_size=2**16,
        title="gpusim",
        uvicorn_logging_level="critical",
        timeout_graceful_shutdown=GRACE,
        reconnect_timeout=PATIENCE,
    )
    return 0


def require_port(host: str, port: int):
    """Raise OutOfRange if the port cannot be opened at this address."""
    try:
        addresses = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
        family, kind, protocol, _, address = addresses[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        reason = error.strerror or error
        raise OutOfRange(
            "--host, --port",
            f"{host}:{port}",
            f"a free port of an address of this machine ({reason}); try --port {port % 65535 + 1}",
        ) from None

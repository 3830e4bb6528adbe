"""`gpusim preview`: one page of sliders and a live picture."""

import socket

from gpusim.apps.preview.guard import LOOPBACK
from gpusim.cli.moving import add_moving, moving
from gpusim.cli.options import Reading, add_asked, operated, whole
from gpusim.domain.errors import Missing, OutOfRange, UnknownName


def add_command(commands):
    """Add `preview` to the subparsers of `gpusim`; its default `run` is `preview`."""
    parser = commands.add_parser(
        "preview", help="a page on this machine: move a slider, see the camera change"
    )
    add_asked(parser, several=True)
    add_moving(parser)
    parser.add_argument(
        "--port", type=whole(1, 65535), default=8080, help="of the page (default: 8080)"
    )
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address at which the page is served; another than this "
        "machine's own lets all of its network move the sliders (default: 127.0.0.1)",
    )
    parser.set_defaults(
        run=lambda arguments: preview(Reading(arguments, parser)),
        seed=0,
        flicker=None,
        pwm=None,
        blur=False,
    )


def preview(arguments) -> int:
    """Run `gpusim preview`; returns the exit status. Raises GpusimError."""
    try:
        from nicegui import app, ui
    except ImportError:
        raise Missing(
            "preview: NiceGUI is not installed; wanted: pip install 'gpusim[preview]'"
        ) from None
    from gpusim.apps.preview.controls import TOLERANCES
    from gpusim.apps.preview.guard import Guard
    from gpusim.apps.preview.page import mount
    from gpusim.apps.preview.producer import Producer
    from gpusim.apps.preview.state import State
    from gpusim.backends import open_device
    from gpusim.io.camera.cameras import open_camera

    tolerance = (
        arguments.tolerance or "1e-3"
    )  # in parts of the light: a plan stands where noise and exposure change
    if tolerance not in TOLERANCES:
        raise UnknownName("--tolerance of a preview", tolerance, TOLERANCES)
    scenes, device = moving(arguments), open_device(arguments.device)
    first = next(scenes.between(0, 1))
    operated(open_camera(arguments.camera), arguments)  # said before the page
    require_port(arguments.host, arguments.port)
    state = State(arguments.camera, _changes(arguments), tolerance=tolerance)
    period = 0.0 if scenes.is_still else float(1 / arguments.fps)
    mount(
        lambda: Producer(scenes, device, period),
        state,
        first.name,
        first.shape,
        " ".join(arguments.scene),
    )
    arguments.refuse_unread("preview")
    hosts = LOOPBACK if arguments.host in LOOPBACK else (*LOOPBACK, arguments.host)
    app.add_middleware(Guard, hosts=hosts)
    if arguments.host not in LOOPBACK:
        print(
            f"{arguments.host} is not this machine alone: whoever reaches it may use this preview and its device"
        )
    print(f"http://{arguments.host}:{arguments.port}/  (Ctrl+C ends it)", flush=True)
    ui.run(
        host=arguments.host,
        port=arguments.port,
        reload=False,
        show=False,
        show_welcome_message=False,
        ws_per_message_deflate=False,
        ws_max_size=2**16,
        title="gpusim",
        uvicorn_logging_level="error",
    )
    return 0


def _changes(arguments):
    """What the command line says of the camera, as the page's controls have it."""
    given = {
        "optics.f_number": arguments.f_number,
        "optics.object_distance_m": arguments.focus,
        "processor.scaling": arguments.scaling,
    }
    if arguments.exposure is not None:
        given["sensor.exposure_time_ms"] = (
            "auto" if arguments.exposure == "auto" else 1e3 * arguments.exposure
        )
    if arguments.iso is not None:
        raise OutOfRange("--iso", arguments.iso, "the gain of the page's slider")
    return {name: value for name, value in given.items() if value is not None}


def require_port(host: str, port: int):
    """Raise OutOfRange where a port cannot be listened at."""
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        raise OutOfRange(
            "--host, --port",
            f"{host}:{port}",
            f"a free port of an address of this machine "
            f"({error.strerror or error}); try --port {port % 65535 + 1}",
        ) from None

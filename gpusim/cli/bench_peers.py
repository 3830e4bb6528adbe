"""`gpusim bench peers`: whole tasks with gpusim and with other libraries."""

from dataclasses import dataclass

from gpusim.cli.options import DEVICE_HELP, Options, option, size, whole
from gpusim.domain.errors import UnknownName

TEXTS = {"help": "whole tasks with gpusim and with other libraries that are installed, and errors"}


@dataclass(frozen=True, kw_only=True)
class PeersRequest(Options):
    """Options of `gpusim bench peers`."""

    device: str = option(default="auto", help=DEVICE_HELP)
    task: list[str] | tuple = option(
        default=(),
        action="append",
        metavar="NAME",
        help="frame, demosaic, spread or noise; may be repeated (default: all)",
    )
    size: tuple[int, int] | None = option(
        type=size, metavar="COLSxROWS", help="size of the frame (default: 1920x1080)"
    )
    tolerance: float = option(
        default=4e-4, type=float, help="relative RMS error of a frame (default: 4e-4); 0: none"
    )
    repeat: int = option(default=9, type=whole(1, 9999), help="rounds of all forms (default: 9)")
    json: str | None = option(metavar="FILE", help="also write the rows to a JSON file")


def peers(request: PeersRequest) -> int:
    """Run `gpusim bench peers`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim.backends import open_device
    from gpusim.bench.machine import Watch
    from gpusim.bench.measured import write_rows
    from gpusim.bench.peers import TASKS, time_peers
    from gpusim.bench.timing import print_times
    from gpusim.data.charts import checked_size
    from gpusim.io.atomic import check_output

    check_output(request.json)
    size, tasks = checked_size(request.size or (1920, 1080)), request.task or TASKS
    for name in tasks:
        if name not in TASKS:
            raise UnknownName("task", name, TASKS)
    device, repeat = open_device(request.device), request.repeat
    tolerance = request.tolerance or None
    request.refuse_unread("bench peers")
    watch = Watch(device)
    rows = time_peers(device, tasks, size, tolerance, repeat)
    print_times(rows)
    for warning in watch.facts()["warnings"]:
        print(f"warning: {warning}")
    if request.json:
        settings = {"size": size, "tolerance": tolerance, "repeat": repeat}
        write_rows(request.json, "peers", watch, rows, **settings)
    return 0

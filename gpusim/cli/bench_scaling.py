"""`gpusim bench scaling`: a loop of frames from VGA to 8K, from 3 to 301 bands, or on 1 to all cores."""

from dataclasses import dataclass
from typing import Any

from gpusim.cli.options import DEVICE_HELP, Options, flag, option, size, whole
from gpusim.domain.errors import UnknownName

TEXTS = {"help": "a loop of new scenes from VGA to 8K, 3 to 301 bands, or on 1 to all cores"}
CONTENTS = "cube", "materials"


@dataclass(frozen=True, kw_only=True)
class ScalingRequest(Options):
    """Options of `gpusim bench scaling`."""

    device: str = option(default="auto", help=DEVICE_HELP)
    threads: bool = flag("one frame on 1, 2, 4 ... and all cores instead; an OpenCL processor")
    size: tuple[int, int] | None = option(
        type=size, metavar="COLSxROWS", help="frame of --threads (default: 1920x1080)"
    )
    only: str | None = option(metavar="TEXT", help='only rows with this text, such as "31 bands"')
    camera: str = option(default="phone", help="as for simulate (default: phone)")
    tolerance: str | None = option(
        default="4e-4", help="as for simulate, or none for every band (default: 4e-4)"
    )
    content: str = option(default="cube", help="cube or materials (default: cube)")
    repeat: int = option(
        default=200, type=whole(5, 9999), help="frames of a loop, which takes 2 s at most"
    )
    json: str | None = option(metavar="FILE", help="also write the rows to a JSON file")


def scaling(request: ScalingRequest) -> int:
    """Run `gpusim bench scaling`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 1 if no row was measured.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim.backends import open_device
    from gpusim.bench.machine import Watch
    from gpusim.bench.measured import write_rows
    from gpusim.bench.scaling import HD, describe_row, list_cases, list_threads, measure_scaling
    from gpusim.data.charts import checked_size
    from gpusim.io.atomic import check_output
    from gpusim.io.camera.cameras import open_camera
    from gpusim.pipeline.simulator import Simulator

    check_output(request.json)
    if request.content not in CONTENTS:
        raise UnknownName("content", request.content, CONTENTS)
    device = open_device(request.device)
    tolerance = None if request.tolerance == "none" else request.tolerance
    Simulator(open_camera(request.camera), device=device, tolerance=tolerance)  # checks them
    if request.threads:
        cases = list_threads(device.name, checked_size(request.size or HD))
    else:
        cases = list_cases()
    cases = {name: case for name, case in cases.items() if (request.only or "") in name}
    settings: dict[str, Any] = {
        "tolerance": tolerance,
        "camera": request.camera,
        "content": request.content,
    }
    settings |= {"repeat": request.repeat}
    request.refuse_unread("bench scaling")
    watch, rows = Watch(device), []
    for row in measure_scaling(cases, device=device.name, **settings):
        rows.append(row)
        print(describe_row(row), flush=True)
    if request.json:
        write_rows(
            request.json, "threads" if request.threads else "scaling", watch, rows, **settings
        )
    return 0 if any("failed" not in row for row in rows) else 1

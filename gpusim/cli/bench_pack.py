"""`gpusim bench pack`: kernels, inputs and right answers for drivers' tests, with a runner in C."""

from dataclasses import dataclass

from gpusim.cli.judges import check_stages
from gpusim.cli.options import Options, option, size, whole

TEXTS = {
    "help": "write kernels, inputs and right answers for a runner in C that needs no Python",
    "description": "Write a folder with the OpenCL kernels of stages, their inputs, the right "
    "answers with tolerances, and a runner in C that builds, verifies and times them.",
}


@dataclass(frozen=True, kw_only=True)
class PackRequest(Options):
    """Options of `gpusim bench pack`."""

    folder: str = option(positional=True, metavar="DIR", help="new folder of the pack")
    stage: list[str] | tuple = option(
        default=(),
        action="append",
        metavar="AREA.NAME",
        help="may be repeated (default: all stages)",
    )
    size: tuple[int, int] | None = option(
        type=size, metavar="COLSxROWS", help="size of the timed inputs (default: 96x72)"
    )
    cores: int | None = option(
        type=whole(1, 4096),
        metavar="N",
        help="cores of the processor that times are compared on: some stages cut a frame into as "
        "many strips (default: 8)",
    )
    archive: str | None = option(
        metavar="FILE", help="also write the folder as an archive, .tar.gz or .zip"
    )


def pack(request: PackRequest) -> int:
    """Run `gpusim bench pack`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option is wrong, or the pack cannot be written.
    """
    from gpusim.bench.pack import SIZE, write_pack
    from gpusim.bench.recorder import UNITS
    from gpusim.data.charts import checked_size
    from gpusim.io.atomic import check_output

    check_output(request.archive)
    folder, stages = request.folder, check_stages(request.stage)
    wanted, cores = checked_size(request.size or SIZE), request.cores or UNITS
    request.refuse_unread("bench pack")
    found = write_pack(folder, stages, wanted, request.archive, cores)
    for form, why in found["left"]:
        print(f"not in the pack: {form} form: {why}")
    counts = ", ".join(f"{found[key]} {key}" for key in ("stages", "cases", "programs"))
    print(f"{folder}: {counts}, {found['bytes'] / 1e6:.1f} MB; README.md says how to build")
    return 0

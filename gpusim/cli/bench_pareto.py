"""`gpusim bench pareto`: the plans of a scene, time against true error."""

from dataclasses import dataclass

from gpusim.cli.judges import write_rows
from gpusim.cli.options import DEVICE_HELP, Options, option, scene_option, size

TEXTS = {"help": "run a scene with all plans: time against true error"}


@dataclass(frozen=True, kw_only=True)
class ParetoRequest(Options):
    """Options of `gpusim bench pareto`."""

    scene: str = scene_option("a chart or a file, as for simulate")
    device: str = option(default="auto", help=DEVICE_HELP)
    camera: str = option(default="phone", help="as for simulate (default: phone)")
    size: tuple[int, int] | None = option(
        type=size, metavar="COLSxROWS", help="size of the chart (default: 480x320)"
    )
    json: str | None = option(metavar="FILE", help="also write the rows to a JSON file")
    out: str | None = option("-o", "--out", metavar="OUT.png", help="figure (needs matplotlib)")


def pareto(request: ParetoRequest) -> int:
    """Run `gpusim bench pareto`.

    Args:
        request: Options of the command.

    Returns:
        The exit status.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim.backends import open_device
    from gpusim.data.charts import CHARTS
    from gpusim.io.atomic import atomic_path, check_output
    from gpusim.io.camera.cameras import open_camera
    from gpusim.io.scene.scenes import open_scene
    from gpusim.judge.pareto import draw, pareto

    for path in (request.json, request.out):
        check_output(path)
    size = request.size or ((480, 320) if request.scene in CHARTS else None)
    camera, scene = open_camera(request.camera), open_scene(request.scene, size=size)
    device, rows = open_device(request.device), []
    request.refuse_unread("bench pareto")
    heads = ("ms", "frame ms", "true rms", "predicted", "99.9 %", "largest")
    print(f"{'point':22s} {' '.join(f'{head:>9s}' for head in heads)}")
    for row in pareto(camera, scene, device):
        rows.append(row)
        ms, error = (
            f"{row[key]:9.2g}" if row[key] else f"{'-':>9s}"
            for key in ("predicted_ms", "predicted")
        )
        start = f"{row['point']:22s} {row['ms']:9.2f} {ms} {row['rms']:9.2g} {error}"
        print(f"{start} {row['p999_sigma']:9.2g} {row['max_sigma']:9.2g}  {row['words']}")
    write_rows(request.json, rows)
    if request.out:
        shape = f"{scene.shape[1]}x{scene.shape[0]}"
        with atomic_path(request.out) as temporary:
            draw(rows, temporary, f"{scene.name} {shape} by {camera.name} on {device.name}")
    return 0

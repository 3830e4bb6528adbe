"""The command line: `gpusim simulate | plan | look | video | pairs | preview | train-l3 | verify | bench | devices`."""

import argparse
import dataclasses
import json
import sys
from pathlib import Path

from gpusim import __version__
from gpusim.cli import look, pairs, preview, train_l3, video
from gpusim.cli.options import DEVICE_HELP, add_asked, operated, scene_of, size, whole
from gpusim.domain.account import STATUS
from gpusim.domain.errors import BadFile, GpusimError, UnknownName, one_line


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status: 0, 1 (a verification failed), 2 (wrong input, said in one line).

    `gpusim.__main__.start` calls it as a program: with signals and a standard output that may be closed or full.
    """
    parser = _parser()
    arguments = parser.parse_args(argv)
    try:
        return arguments.run(arguments)
    except GpusimError as error:
        print(f"gpusim: {error}", file=sys.stderr)
        return 2
    except (MemoryError, KeyboardInterrupt) as error:
        print(
            f"gpusim: {'out of memory' if isinstance(error, MemoryError) else 'interrupted'}",
            file=sys.stderr,
        )
        return 2


def _simulate(arguments):
    from gpusim.io.atomic import atomic_path
    from gpusim.io.camera.cameras import open_camera
    from gpusim.io.frame.frames import check_format
    from gpusim.pipeline.simulator import Simulator

    outputs = [_numbered(path, arguments.frames) for path in arguments.out]
    _check_outputs(outputs, arguments)  # said before the work, not after it
    camera = operated(open_camera(arguments.camera), arguments)
    scene = scene_of(arguments)
    simulator = Simulator(
        camera,
        device=arguments.device,
        tolerance=arguments.tolerance,
        guaranteed=arguments.guaranteed,
        strict=arguments.strict,
    )
    for path in arguments.out:
        check_format(
            path, dataclasses.replace(camera, sensor=simulator.readout.output), arguments.bits
        )
    frames = simulator.frames(scene, arguments.frames, seed=arguments.seed, verify=arguments.verify)
    if arguments.frames > 1:
        from tqdm import tqdm

        frames = tqdm(frames, total=arguments.frames, unit="frame", disable=None)
    reports = []
    for number, frame in enumerate(frames):
        for output in outputs:
            frame.save(output(number), bits=arguments.bits)
        reports.append(frame.report)
        if arguments.frames == 1:
            print(frame.report)
    if arguments.frames > 1:
        print(reports[0])
        print(
            f"  {len(reports)} frames; median of those after the first "
            f"{sorted(report.ms for report in reports[1:])[(len(reports) - 1) // 2]:.2f} ms"
        )
    if arguments.report:
        with atomic_path(arguments.report) as temporary:
            plain = [report.as_dict() for report in reports]
            temporary.write_text(
                json.dumps(plain[0] if arguments.frames == 1 else plain, indent=2) + "\n"
            )
    return 1 if any(report.meets_tolerance is False for report in reports) else 0


def _plan(arguments):
    from gpusim.io.atomic import atomic_path, check_output
    from gpusim.io.camera.cameras import open_camera
    from gpusim.judge.plan_summary import Forecast
    from gpusim.pipeline.simulator import Simulator

    check_output(arguments.json)
    simulator = Simulator(
        operated(open_camera(arguments.camera), arguments),
        device=arguments.device,
        tolerance=arguments.tolerance,
        guaranteed=arguments.guaranteed,
        strict=arguments.strict,
    )
    forecast = Forecast.of(simulator, scene_of(arguments))
    print(forecast)
    if arguments.json:
        with atomic_path(arguments.json) as temporary:
            temporary.write_text(json.dumps(forecast.as_dict(), indent=2) + "\n")
    verdict = forecast.plan.verdict
    return 0 if verdict is None else STATUS[verdict.state]


def _numbered(path, count):
    """From a frame's number to its file: `a.png`, or `a_0000.png` and so on for several."""
    from gpusim.io.frame.frames import frame_format

    path = Path(path)
    frame_format(path)
    digits = max(4, len(str(count - 1)))
    return lambda number: (
        path if count == 1 else path.with_name(f"{path.stem}_{number:0{digits}d}{path.suffix}")
    )


def _check_outputs(outputs, arguments):
    """Refuse files that cannot be written, that would be written twice, or over the scene or the camera."""
    import functools
    import os

    from gpusim.io.atomic import check_output

    folder = functools.cache(os.path.realpath)

    def place(path):
        return os.path.normcase(Path(folder(path.parent), path.name))

    report = [Path(arguments.report)] if arguments.report is not None else []
    for path in (*(output(0) for output in outputs), *report):
        check_output(path)
    taken = {
        place(Path(name)): "is read"
        for name in (arguments.scene, arguments.camera)
        if Path(name).suffix
    }
    for path in (
        *report,
        *(output(number) for output in outputs for number in range(arguments.frames)),
    ):
        here = place(path)
        if here in taken:
            raise BadFile(
                path,
                f"{taken[here]}, and would be written over; give every -o and --report a name of its "
                "own",
            )
        taken[here] = "is given twice"


def _verify(arguments):
    from gpusim.io.atomic import check_output
    from gpusim.judge.verify import verify_devices

    check_output(arguments.json)
    if arguments.hard:
        return _verify_hard(arguments)
    rows = []
    for row in verify_devices(arguments.device, _stages(arguments.stage)):
        rows.append(row)
        print(
            f"{'ok  ' if row['ok'] else 'FAIL'} {row['device']:10s} {row['stage']:22s} {row['max_error']:9.2e} "
            f"(tolerance {row['tolerance']:8.2e})  {row['case']}"
            + ("" if row["ok"] else f": {row['why']}"),
            flush=True,
        )
    failed = sum(not row["ok"] for row in rows)
    print(f"{len(rows) - failed} passed, {failed} failed")
    _write_json(arguments.json, rows)
    return 1 if failed or not rows else 0


def _pareto(arguments):
    from gpusim.backends import open_device
    from gpusim.io.atomic import atomic_path, check_output
    from gpusim.io.camera.cameras import open_camera
    from gpusim.io.scene.scenes import open_scene
    from gpusim.judge.pareto import draw, pareto

    for path in (arguments.json, arguments.out):
        check_output(path)
    camera, scene = (
        open_camera(arguments.camera),
        open_scene(arguments.pareto, size=arguments.size or (480, 320)),
    )
    device, rows = open_device("auto" if arguments.device == "all" else arguments.device), []
    heads = ("ms", "frame ms", "true rms", "predicted", "99.9 %", "largest")
    print(f"{'point':22s} {' '.join(f'{head:>9s}' for head in heads)}")
    for row in pareto(camera, scene, device):
        rows.append(row)
        ms, error = (
            f"{row[key]:9.2g}" if row[key] else f"{'-':>9s}"
            for key in ("predicted_ms", "predicted")
        )
        print(
            f"{row['point']:22s} {row['ms']:9.2f} {ms} {row['rms']:9.2g} {error} {row['p999_sigma']:9.2g} "
            f"{row['max_sigma']:9.2g}  {row['words']}"
        )
    _write_json(arguments.json, rows)
    if arguments.out:
        with atomic_path(arguments.out) as temporary:
            draw(
                rows,
                temporary,
                f"{scene.name} {scene.shape[1]}x{scene.shape[0]} by {camera.name} on {device.name}",
            )
    return 0


def _verify_hard(arguments):
    """The hard cases, each printed when it is known."""
    from gpusim.judge.hard import hard

    devices, broken = _devices(arguments.device)
    rows: list[dict] = [
        {
            "number": 0,
            "name": "(open)",
            "device": row["device"],
            "asked": "the device opens",
            "got": float("inf"),
            "limit": 0.0,
            "ok": False,
            "why": row["why"],
        }
        for row in broken
    ]
    for row in rows:
        print(_hard_line(row))
    for device in devices:
        for row in hard(device):
            rows.append(row)
            print(_hard_line(row), flush=True)
    failed = sum(not row["ok"] for row in rows)
    print(f"{len(rows) - failed} passed, {failed} failed")
    _write_json(arguments.json, rows)
    return 1 if failed or not rows else 0


def _hard_line(row):
    return (
        f"{'ok  ' if row['ok'] else 'FAIL'} {row['device']:10s} {row['number']:2d} {row['name']}: {row['asked']} | "
        f"got {row['got']:.2g} of {row['limit']:.2g}: {row['why']}"
    )


def _bench(arguments):
    if arguments.pareto:
        return _pareto(arguments)
    from gpusim.data.charts import checked_size
    from gpusim.io.atomic import check_output
    from gpusim.judge.bench import bench

    check_output(arguments.json)
    size = checked_size(arguments.size or (1920, 1080))[::-1]
    rows: list[dict] = []
    devices, broken = _devices(arguments.device)
    stages = _stages(arguments.stage)
    print(
        f"{'device':10s} {'stage':22s} {'size':>10s} {'ms p25':>9s} {'p50':>9s} {'p75':>9s} {'GB/s':>7s} "
        f"{'GFLOP/s':>8s} {'x floor':>8s} {'build ms':>9s} {'rms error':>10s} {'max error':>10s}"
    )
    for device in devices:
        for row in bench(device, stages, size):
            rows.append(row)
            if "failed" in row:
                print(
                    f"{row['device']:10s} {row['stage']:22s} no speed: verification failed, {row['failed']}"
                )
                continue
            rate, ratio = (
                f"{'-':>8s}" if value is None else f"{value:8.1f}"
                for value in (row["gflops"], row["ratio_to_floor"])
            )
            print(
                f"{row['device']:10s} {row['stage']:22s} {row['size']:>10s} {row['ms_p25']:9.3f} "
                f"{row['ms_p50']:9.3f} {row['ms_p75']:9.3f} {row['gbps']:7.1f} {rate} {ratio} {row['build_ms']:9.1f} "
                f"{row['rel_rms_error']:10.1e} {row['max_error']:10.1e}"
            )
    for row in broken:
        rows.append({"stage": row["stage"], "device": row["device"], "failed": row["why"]})
        print(f"{row['device']:10s} no speed: {row['why']}")
    _write_json(arguments.json, rows)
    return 1 if any("failed" in row for row in rows) or not rows else 0


def _list_devices(arguments):
    from gpusim.backends.probe import devices

    entries = devices(refresh=True)
    if arguments.json:
        print(json.dumps(entries, indent=2))
        return 0
    for entry in entries:
        if entry["error"]:
            print(f"{entry['name']:12s} unusable: {entry['error']}")
            continue
        kinds = "fp64" if entry["fp64"] else "no fp64"
        kinds += ", fp16" if entry["fp16"] else ", no fp16"
        print(
            f"{entry['name']:12s} {entry['device']}; {entry['driver']} ({entry['version']}); {entry['units']} units, "
            f"{kinds}; {entry['memory'] / 2**30:.1f} GiB; copy {entry['copy_gbps']:.1f} GB/s"
        )
    return 0


def _devices(name):
    """Open the device named, or all of them for "all"; also a failed row for each one that is unusable."""
    from gpusim.backends import open_device
    from gpusim.backends.probe import devices

    if name != "all":
        return [open_device(name)], []
    entries = [entry for entry in devices() if entry["name"] != "numpy"]
    broken = [
        {
            "stage": "(open)",
            "device": entry["name"],
            "case": "(failed to open)",
            "max_error": float("inf"),
            "tolerance": 0.0,
            "ok": False,
            "why": entry["error"],
        }
        for entry in entries
        if entry["error"]
    ]
    return [open_device(entry["name"]) for entry in entries if not entry["error"]], broken


def _stages(names):
    from gpusim.kernels.stage import stage_names

    known = stage_names()
    for name in names or ():
        if name not in known:
            raise UnknownName("stage", name, known)
    return names or known


def _write_json(path, rows):
    if not path:
        return
    from gpusim.io.atomic import atomic_path

    # JSON has no infinity: a stage that failed to run has the error null
    rows = [
        {key: None if value == float("inf") else value for key, value in row.items()}
        for row in rows
    ]
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(rows, indent=2, allow_nan=False) + "\n")


class OneLineParser(argparse.ArgumentParser):
    """Wrong arguments are said in one line, as every other mistake is."""

    def error(self, message):  # noqa: D102  argparse's
        self.exit(2, f"{self.prog}: {one_line(message)} (see {self.prog} --help)\n")


def _parser():
    parser = OneLineParser(
        prog="gpusim",
        description="Simulate a camera: scene radiance, optics, sensor, image processor, display.",
    )
    parser.add_argument("--version", action="version", version=f"gpusim {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    simulate = commands.add_parser(
        "simulate", help="a scene through a camera: raw frame, picture and report"
    )
    add_asked(simulate)
    simulate.add_argument(
        "--seed", type=whole(0, 2**64 - 1), default=0, help="of the temporal noise (default: 0)"
    )
    simulate.add_argument(
        "--frames",
        type=whole(1, 10**6),
        default=1,
        metavar="N",
        help="draw N noisy frames into numbered files",
    )
    simulate.add_argument(
        "-o",
        "--out",
        action="append",
        default=[],
        metavar="OUT",
        help=".png or .tif display, .exr linear RGB, .dng raw, .npz electrons and DN; may be "
        "repeated",
    )
    simulate.add_argument(
        "--bits",
        type=int,
        choices=(8, 16, 32),
        help="of .png (8, 16), .tif (8, 16, 32: linear "
        "floats) and .exr (16, 32); default: 8, 16 and 32",
    )
    simulate.add_argument(
        "--report", metavar="FILE.json", help="what was modelled, times and errors"
    )
    simulate.add_argument(
        "--verify", action="store_true", help="also run the float64 reference: the true error"
    )
    simulate.set_defaults(run=_simulate)

    plan = commands.add_parser(
        "plan",
        help="what would be modelled, what left out, the errors and the time; status 1 "
        "if a tolerance is not met, 3 if that cannot be judged",
    )
    add_asked(plan)
    plan.add_argument("--json", metavar="FILE", help="write it")
    plan.set_defaults(run=_plan)

    look.add_command(commands)
    video.add_command(commands)
    pairs.add_command(commands)
    preview.add_command(commands)
    train_l3.add_command(commands, DEVICE_HELP)

    verify = commands.add_parser(
        "verify", help="every stage against the float64 reference; status 1 on any failure"
    )
    bench = commands.add_parser("bench", help="speed of every stage against its error")
    for command, run in ((verify, _verify), (bench, _bench)):
        command.add_argument(
            "--device", default="all", help="as for simulate, or all (default: all)"
        )
        which = command.add_mutually_exclusive_group()
        which.add_argument(
            "--stage", action="append", metavar="AREA.NAME", help="may be repeated (default: all)"
        )
        if command is verify:
            which.add_argument(
                "--hard",
                action="store_true",
                help="in place of stages the 30 hard cases: what was "
                "asked of each, and what was got",
            )
        command.add_argument("--json", metavar="FILE", help="write the rows")
        command.set_defaults(run=run)
    bench.add_argument(
        "--size", type=size, metavar="COLSxROWS", help="default: 1920x1080, of --pareto 480x320"
    )
    bench.add_argument(
        "--pareto", metavar="SCENE", help="a scene by all plans instead: time against true error"
    )
    bench.add_argument("--camera", default="phone", help="of --pareto (default: phone)")
    bench.add_argument(
        "-o", "--out", metavar="OUT.png", help="figure of --pareto, which needs matplotlib"
    )

    devices = commands.add_parser(
        "devices", help="what there is, how fast it copies, and why a device is unusable"
    )
    devices.add_argument("--json", action="store_true", help="as JSON")
    devices.set_defaults(run=_list_devices)
    return parser


if __name__ == "__main__":
    sys.exit(main())

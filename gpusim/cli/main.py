"""The command line: `gpusim COMMAND`, see COMMANDS."""

import argparse
import sys
from collections.abc import Callable

from gpusim import __version__
from gpusim.cli import judges, look, pairs, plan, preview, simulate, train_l3, video
from gpusim.cli.options import Options
from gpusim.cli.progress import showing_progress
from gpusim.domain.errors import GpusimError, one_line

# name -> options, function, texts of the help
COMMANDS: dict[str, tuple[type[Options], Callable, dict[str, str]]] = {
    "simulate": (simulate.SimulateRequest, simulate.simulate, simulate.TEXTS),
    "plan": (plan.PlanRequest, plan.plan, plan.TEXTS),
    "look": (look.LookRequest, look.look, look.TEXTS),
    "video": (video.VideoRequest, video.video, video.TEXTS),
    "pairs": (pairs.PairsRequest, pairs.pairs, pairs.TEXTS),
    "preview": (preview.PreviewRequest, preview.preview, preview.TEXTS),
    "train-l3": (train_l3.TrainRequest, train_l3.train_l3, train_l3.TEXTS),
    "verify": (judges.VerifyRequest, judges.verify, judges.VERIFY),
    "bench": (judges.BenchRequest, judges.bench, judges.BENCH),
    "devices": (judges.DevicesRequest, judges.list_devices, judges.DEVICES),
}


def main(argv: list[str] | None = None) -> int:
    """Run one command.

    `gpusim.__main__.start` calls it as a program: with signals, and a standard output that may be
    closed or full.

    Args:
        argv: Arguments of the command line. None: those of the process.

    Returns:
        The exit status: 0, 1 (a verification failed or a tolerance is not met), 2 (wrong input,
            reported in one
        line) or 3 (a tolerance that cannot be judged).
    """
    parser = _parser()
    arguments = parser.parse_args(argv)
    try:
        with showing_progress():
            return arguments.run(arguments)
    except GpusimError as error:
        print(f"gpusim: {error}", file=sys.stderr)
        return 2
    except (MemoryError, KeyboardInterrupt) as error:
        words = "out of memory" if isinstance(error, MemoryError) else "interrupted"
        print(f"gpusim: {words}", file=sys.stderr)
        return 2


class OneLineParser(argparse.ArgumentParser):
    """A parser that reports wrong arguments in one line."""

    def error(self, message):  # noqa: D102  argparse's
        self.exit(2, f"{self.prog}: {one_line(message)} (see {self.prog} --help)\n")


def _parser():
    """Return the parser of all commands."""
    parser = OneLineParser(
        prog="gpusim",
        description="Simulate a camera: scene radiance, optics, sensor, image processor, display.",
    )
    parser.add_argument("--version", action="version", version=f"gpusim {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, (options, run, texts) in COMMANDS.items():
        options.add_command(commands, name, run, **texts)
    return parser


if __name__ == "__main__":
    sys.exit(main())

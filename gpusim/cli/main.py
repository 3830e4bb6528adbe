"""The command line: `gpusim COMMAND`, see COMMANDS."""

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from importlib import import_module

from gpusim import __version__
from gpusim.cli.benching import DESCRIPTION, HELP, with_subcommand
from gpusim.cli.options import Options
from gpusim.cli.progress import showing_progress
from gpusim.domain.errors import GpusimError, one_line

# name -> module; names of its options, function and texts of the help
_PLACES = {
    "simulate": ("simulate", "SimulateRequest", "simulate", "TEXTS"),
    "plan": ("plan", "PlanRequest", "plan", "TEXTS"),
    "look": ("look", "LookRequest", "look", "TEXTS"),
    "video": ("video", "VideoRequest", "video", "TEXTS"),
    "pairs": ("pairs", "PairsRequest", "pairs", "TEXTS"),
    "study": ("study", "StudyRequest", "study", "TEXTS"),
    "preview": ("preview", "PreviewRequest", "preview", "TEXTS"),
    "fit": ("fit", "FitRequest", "fit", "TEXTS"),
    "cameras": ("cameras", "CamerasRequest", "cameras", "TEXTS"),
    "refocus": ("refocus", "RefocusRequest", "refocus", "TEXTS"),
    "train-l3": ("train_l3", "TrainRequest", "train_l3", "TEXTS"),
    "train-network": ("train_network", "TrainNetworkRequest", "train_network", "TEXTS"),
    "compare": ("compare", "CompareCameraRequest", "compare", "TEXTS"),
    "verify": ("judges", "VerifyRequest", "verify", "VERIFY"),
    "bench run": ("bench_run", "RunRequest", "run", "TEXTS"),
    "bench scaling": ("bench_scaling", "ScalingRequest", "scaling", "TEXTS"),
    "bench peers": ("bench_peers", "PeersRequest", "peers", "TEXTS"),
    "bench compare": ("bench_compare", "CompareRequest", "compare", "TEXTS"),
    "bench pack": ("bench_pack", "PackRequest", "pack", "TEXTS"),
    "bench pareto": ("bench_pareto", "ParetoRequest", "pareto", "TEXTS"),
    "warmup": ("warmup", "WarmupRequest", "warmup", "TEXTS"),
    "devices": ("judges", "DevicesRequest", "list_devices", "DEVICES"),
}


class _Commands(Mapping[str, tuple[type[Options], Callable, dict[str, str]]]):
    """Commands by name: options, function, texts of the help. Each is imported when it is read.

    A name of two words is a subcommand.
    """

    def __getitem__(self, name):
        module, *parts = _PLACES[name]
        loaded = import_module(f"gpusim.cli.{module}")
        return tuple(getattr(loaded, part) for part in parts)

    def __iter__(self) -> Iterator[str]:
        return iter(_PLACES)

    def __len__(self):
        return len(_PLACES)


COMMANDS = _Commands()


def main(argv: list[str] | None = None) -> int:
    """Run one command.

    `gpusim.__main__.start` calls it as a program: with signals, and a standard output that may be
    closed or full.

    Args:
        argv: Arguments of the command line. None: those of the process.

    Returns:
        The exit status: 0, 1 (a verification failed, a tolerance is not met, a row of a benchmark is
            slower, a fit does not explain its frames, or a camera differs from held-out frames), 2 (wrong
            input, reported in one line), 3 (a tolerance or a comparison with held-out frames that cannot
            be judged) or 125 (a comparison of benchmarks that cannot be judged).
    """
    argv = sys.argv[1:] if argv is None else argv
    if argv[:1] == ["bench"]:
        argv = ["bench", *with_subcommand(argv[1:], _subcommands("bench"))]
    names = {" ".join(argv[:count]) for count in (1, 2)}
    parser = _parser([name for name in names if name in COMMANDS] or COMMANDS)
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


def _parser(names: Iterable[str] = COMMANDS):
    """Return the parser of commands."""
    parser = OneLineParser(
        prog="gpusim",
        description="Simulate a camera: scene radiance, optics, sensor, image processor, display.",
    )
    parser.add_argument("--version", action="version", version=f"gpusim {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    subcommands = {}
    for name in names:
        options, run, texts = COMMANDS[name]
        command, _, subcommand = name.partition(" ")
        if subcommand and command not in subcommands:
            made = commands.add_parser(command, help=HELP, description=DESCRIPTION)
            subcommands[command] = made.add_subparsers(required=True, metavar="SUBCOMMAND")
        options.add_command(subcommands.get(command, commands), subcommand or command, run, **texts)
    return parser


def _subcommands(command):
    """Return the names of a command's subcommands."""
    return [name.partition(" ")[2] for name in COMMANDS if name.startswith(f"{command} ")]


if __name__ == "__main__":
    sys.exit(main())

"""The forms of `gpusim bench` that need no subcommand: one of them is put in."""

from collections.abc import Sequence

FORMS = ("compare", "pack", "pareto")  # `gpusim bench --NAME ...` is `gpusim bench NAME ...`
DEFAULT = "run"  # `gpusim bench` alone
HELP = "speed of every stage and of whole pipelines, verified, against the device's limits"
DESCRIPTION = f"Measure the {HELP}. Without a SUBCOMMAND: {DEFAULT}."


def with_subcommand(argv: Sequence[str], known: Sequence[str]) -> list[str]:
    """Return the arguments of `gpusim bench` with their subcommand first.

    Args:
        argv: The arguments after "bench".
        known: Names of the subcommands.

    Returns:
        The arguments, unchanged if they begin with a word or ask for help only. `--pareto SCENE`
        and the others of FORMS become the subcommand; without one it is "run".
    """
    argv = list(argv)
    if argv and (argv[0] in ("-h", "--help") or not argv[0].startswith("-")):
        return argv
    for name in [name for name in FORMS if name in known]:
        for place, word in enumerate(argv):
            flag, equals, value = word.partition("=")
            if flag == f"--{name}":
                return [name, *argv[:place], *([value] if equals else []), *argv[place + 1 :]]
    return [DEFAULT, *argv]

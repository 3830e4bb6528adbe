"""`gpusim bench compare`: verdicts on stored results, and their history."""

from dataclasses import dataclass

from gpusim.cli.options import Options, flag, option, reads

TEXTS = {
    "help": "compare results of gpusim bench run; status 1 if a row is slower or wrong",
    "description": "Compare results with the first one: same, faster or slower at 99 % for the "
    "whole table. Status 0: nothing is slower. 1: a row is slower, or wrong. 2: the files "
    "cannot be compared. 125: a row cannot be judged, which git bisect run skips.",
}


@reads("a slowdown in percent above 0, such as 5%")
def _percent(text):
    """Return the ratio less one of a text in percent."""
    value = float(text.removesuffix("%")) / 100
    if not 0 < value < 10:
        raise ValueError
    return value


@dataclass(frozen=True, kw_only=True)
class CompareRequest(Options):
    """Options of `gpusim bench compare`."""

    files: list[str] | tuple = option(
        default=(),
        positional=True,
        nargs="+",
        metavar="FILE",
        help="results; the first one is the base",
    )
    row: list[str] | tuple = option(
        default=(),
        action="append",
        metavar="NAME",
        help="judge only the rows whose names begin so; may be repeated",
    )
    worst: float | None = option(
        type=_percent,
        metavar="PERCENT",
        help="accept slowdowns below this; status 125 if one of this size could be hidden",
    )
    other_kernels: bool = flag("also judge rows whose kernels or inputs differ")
    history: bool = flag("show the results by date instead, each judged against the one before")
    html: str | None = option(metavar="FILE.html", help="also write a page")
    picture: str | None = option(
        metavar="FILE.png", help="also draw a picture (needs matplotlib): .png, .svg or .pdf"
    )


def compare(request: CompareRequest) -> int:
    """Run `gpusim bench compare`.

    Args:
        request: Options of the command.

    Returns:
        The exit status: 0, 1 or 125; 0 for a history.

    Raises:
        GpusimError: If an option or a file is wrong.
    """
    from gpusim.bench.compare import GOOD, compare_files
    from gpusim.bench.history import history_lines, read_history
    from gpusim.bench.page import write_page
    from gpusim.bench.picture import draw_comparison, draw_history
    from gpusim.bench.table import lines
    from gpusim.io.atomic import check_output

    for path in (request.html, request.picture):
        check_output(path)
    if request.history:
        for name in ("worst", "other_kernels"):
            request.refuse(name, "a history has no verdict and passes changes of kernels")
        history = read_history(request.files, request.row)
        print(*history_lines(history), sep="\n")
        if request.html:
            write_page(history, request.html)
        if request.picture:
            draw_history(history, request.picture)
        return GOOD
    found = compare_files(request.files, request.row, request.worst, request.other_kernels)
    print(*lines(found), sep="\n")
    if request.html:
        write_page(found, request.html)
    if request.picture:
        draw_comparison(found, request.picture)
    return found.status()

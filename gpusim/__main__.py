"""`gpusim`, the program: what the system does to it, a signal or a full disk, is said in one line.

Nothing is imported here but what Python itself has loaded, so that a signal during the imports is said as well.
"""

import os
import signal
import sys

INTERRUPTED, FAILED = 2, 2  # exit statuses; that of another signal is 128 + its number, as shells have it


def start() -> int:
    """Run the command of `sys.argv`; returns its exit status."""
    came: list[int] = []

    def stop(number, frame):
        came.append(number)
        raise KeyboardInterrupt  # unwinds, so that temporary files go

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    try:
        status = _run()
    except BaseException:  # libraries make other exceptions of it while they are loaded
        if not came:
            raise
        status = INTERRUPTED
        print("gpusim: interrupted", file=sys.stderr)
    return 128 + came[-1] if came and came[-1] != signal.SIGINT else status


def _run():
    """Run the command with a standard output that may be closed, full or without some letters."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # it was closed: what is written there goes nowhere
            # the lowest free number, which is the closed one's: no file that is opened later takes its place
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        try:
            from gpusim.cli import main

            status = main()
        except SystemExit as stop:  # argparse's, after --help
            status = stop.code
        sys.stdout.flush()
        return status
    except OSError as error:
        if _takes_more():
            raise
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # what is left goes nowhere as Python ends
        if isinstance(error, BrokenPipeError):  # the reader of our output has gone, as `head` does
            return 0
        print(f"gpusim: standard output cannot be written: {error.strerror}", file=sys.stderr)
        return FAILED


def _takes_more():
    """Whether standard output takes another line: then it was something else that failed."""
    try:
        print()
        sys.stdout.flush()
    except OSError:
        return False
    return True


if __name__ == "__main__":
    sys.exit(start())

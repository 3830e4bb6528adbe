"""`gpusim`, the program: what the system does to it, a signal or a full disk, is said in one line.

Nothing is imported here but what Python itself has loaded, so that a signal during the imports is said as well.
"""

import os
import signal
import sys

INTERRUPTED, FAILED = (
    2,
    2,
)  # exit statuses; that of another signal is 128 + its number, as shells have it
GONE = 128 + 13  # the reader of our output has gone, as `head` does: SIGPIPE's


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
    """Run the command with standard streams that may be closed, full, without a reader or without some letters."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # it was closed: what is written there goes nowhere
            # the lowest free number, which is the closed one's: no file that is opened later takes its place
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w"))
    sys.stdout, sys.stderr = out, _ = _Output(sys.stdout), _Messages(sys.stderr)  # type: ignore[assignment]
    for stream in (out, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        try:
            from gpusim.cli.main import main

            status = main()
        except SystemExit as stop:  # argparse's, after --help
            status = stop.code
        out.flush()
    except OSError:
        if out.failure is None:
            raise
    if out.failure is None:
        return status
    os.dup2(
        os.open(os.devnull, os.O_WRONLY), out.fileno()
    )  # what is left goes nowhere as Python ends
    if isinstance(out.failure, BrokenPipeError):
        return GONE
    print(f"gpusim: standard output cannot be written: {out.failure.strerror}", file=sys.stderr)
    return FAILED


class _Output:
    """Standard output, whose first failure is kept: argparse, for one, says nothing of it."""

    failure: OSError | None = None

    def __init__(self, stream):
        self._stream = stream

    def __getattr__(self, name):
        return getattr(self._stream, name)

    def write(self, text):
        return self._do(self._stream.write, text)

    def flush(self):
        self._do(self._stream.flush)

    def _do(self, work, *text):
        try:
            return work(*text)
        except OSError as error:
            self.failure = self.failure or error
            raise


class _Messages(_Output):
    """Standard error: a message that nobody can read stops no work."""

    def _do(self, work, *text):
        try:
            return work(*text)
        except OSError:
            return len(*text) if text else None


if __name__ == "__main__":
    sys.exit(start())

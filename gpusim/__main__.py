"""The program `gpusim`: signals and failures of the system end it with a message of one line.

Only modules that Python itself has loaded are imported here. A signal during later imports is
therefore handled too.
"""

import gc
import os
import signal
import sys

# Exit statuses. After another signal the status is 128 + its number, as in shells.
INTERRUPTED, FAILED = 2, 2
GONE = 128 + 13  # the reader of the output has ended, like `head`: SIGPIPE
# with large products of matrices. For others, threads of OpenBLAS only wait, and take 100 ms as they start.
LARGE = {"verify", "bench", "train-l3", "--verify"}


def start() -> int:
    """Run the command of `sys.argv` and return its exit status."""
    came: list[int] = []

    def stop(number, frame):
        came.append(number)
        raise KeyboardInterrupt  # unwinds the stack: temporary files are removed

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, stop)
    if not LARGE & {*sys.argv}:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read as NumPy is imported
    gc.set_threshold(20_000)  # imports make no cycles, and looking for them takes 40 ms
    try:
        status = _run()
    except BaseException:  # libraries turn it into other exceptions while they are loaded
        if not came:
            raise
        status = INTERRUPTED
        print("gpusim: interrupted", file=sys.stderr)
    gc.freeze()  # Python would look for unused cycles as it ends: 80 ms
    return 128 + came[-1] if came and came[-1] != signal.SIGINT else status


def _run():
    """Run the command with standard streams that may be closed, full or without a reader."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:  # it was closed: discard its output
            # This takes the closed stream's number, the lowest free one: no later file gets it.
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
    # discard the rest of the output when Python ends
    os.dup2(os.open(os.devnull, os.O_WRONLY), out.fileno())
    if isinstance(out.failure, BrokenPipeError):
        return GONE
    print(f"gpusim: standard output cannot be written: {out.failure.strerror}", file=sys.stderr)
    return FAILED


class _Output:
    """Standard output. It records its first failure, which argparse, for one, ignores."""

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
    """Standard error. A message that cannot be written does not stop the command."""

    def _do(self, work, *text):
        try:
            return work(*text)
        except OSError:
            return len(*text) if text else None


if __name__ == "__main__":
    sys.exit(start())

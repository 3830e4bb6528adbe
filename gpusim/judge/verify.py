"""Compare every stage on a device with its float64 reference: `gpusim verify`, and the tests.

`verify` works in this process. `verify_apart` and `verify_devices` work in child processes, because
a kernel or a driver may crash or hang: that stage gets a failed row, and a new child judges the
remaining stages.
"""

import json
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from gpusim.backends import Device
from gpusim.backends.probe import best, devices
from gpusim.domain.errors import DeviceError, one_line
from gpusim.kernels.stage import compare, stage_names

PATIENCE = 600.0  # [s] without a message; longer than any kernel takes to compile
NO_FLOAT64 = "needs float64, which this device lacks"
LAST_WORDS = 4096  # [byte] of a child's messages that are read after it died
CHILD = """
import runpy, sys
folder = sys.argv.pop(1)
if folder not in sys.path:  # a checkout that is not installed
    sys.path.insert(0, folder)
runpy.run_module("gpusim.judge.verify_child", run_name="__main__", alter_sys=True)
"""


def verify(device: Device, stages: list[str] | None = None) -> Iterator[dict]:
    """Yield one row per case of each stage, judged in this process.

    A stage that raises an exception on the device gives a failed row, and the next stage follows.

    Args:
        device: The open device.
        stages: Names, for example "sensor.noise"; None for all.

    Yields:
        Rows with stage, device, case, max_error, tolerance, ok, why (the derivation of the
        tolerance, or the reason of the failure), and skipped (why the device cannot run the case;
        "" if it did).
    """
    for name in stages or stage_names():
        try:
            for case, error in compare(name, device):
                row = _row(name, device.name, case.name, error or 0.0, case.tolerance, case.why)
                yield row | ({"skipped": NO_FLOAT64} if error is None else {})
        except Exception as error:  # a driver may raise anything; the next stages are still judged
            why = f"{type(error).__name__}: {error}"
            yield failed_row(name, device.name, "(failed to run)", why)


def _row(stage, device, case, error, tolerance, why):
    return {
        "stage": stage,
        "device": device,
        "case": case,
        "max_error": error,
        "tolerance": tolerance,
        "ok": bool(error <= tolerance),
        "why": why,
        "skipped": "",
    }


def failed_row(stage: str, device: str, case: str, why: str) -> dict:
    """Return the row of a stage without a result: its error is infinite.

    Args:
        stage: Name of the stage, or a step outside the stages, for example "(open)".
        device: Name of the device.
        case: The failure, in brackets.
        why: The reason; its first line is used.

    Returns:
        A row as `verify` yields it.
    """
    return _row(stage, device, case, float("inf"), 0.0, (why.splitlines() or [""])[0])


def verify_devices(
    name: str = "all", stages: list[str] | None = None, patience: float = PATIENCE
) -> Iterator[dict]:
    """Yield the rows of one device or of all devices, judged in child processes.

    Args:
        name: Name of a device, or "all" for every device but NumPy.
        stages: Names of stages; None for all.
        patience: Time without progress after which a child counts as hanging [s].

    Yields:
        Rows as `verify` yields them. With "all", a device that cannot be opened gives one failed
        row.

    Raises:
        DeviceError: The one device that is named cannot be opened.
    """
    if name != "all":
        # "auto" is resolved here: a warning about missing drivers is logged by this process
        backend = name in ("auto", "opencl", "warp")
        yield from verify_apart(best(name)["name"] if backend else name, stages, patience)
        return
    for entry in devices():
        if entry["name"] == "numpy":
            continue
        error = entry["error"]
        if not error:
            try:
                yield from verify_apart(entry["name"], stages, patience)
            except DeviceError as failure:
                error = str(failure)
        if error:
            yield failed_row("(open)", entry["name"], "(failed to open)", error)


def verify_apart(
    name: str, stages: list[str] | None = None, patience: float = PATIENCE
) -> Iterator[dict]:
    """Yield one row per case of each stage, judged in a child process.

    One child judges all stages. If it dies, or sends nothing for `patience` seconds, the stage that
    it was judging gets a failed row with the signal, and a new child judges the stages after it.

    Args:
        name: Name of the device.
        stages: Names of stages; None for all.
        patience: Time without progress after which the child counts as hanging [s].

    Yields:
        Rows as `verify` yields them.

    Raises:
        DeviceError: The device cannot be opened.
    """
    waiting, device = list(stages or stage_names()), name
    while waiting:
        count, stage = len(waiting), "(open)"
        with _Child(name, waiting) as child:
            for message in child.messages(patience):
                if "refused" in message:
                    raise DeviceError(message["refused"])
                if "row" in message:
                    yield message["row"]
                device = message.get("device", device)
                stage = message.get("begins", stage)
                if "ends" in message:
                    stage = f"(after {waiting.pop(0)})"
            death = child.death(finished=not waiting)
        if not death:
            continue
        yield failed_row(stage, device, "(crashed)", death)
        if waiting and waiting[0] == stage:
            waiting.pop(0)
        elif len(waiting) == count:  # it died before its first stage, and the next child would, too
            return


class _Child:
    """A process that judges stages and sends messages, one JSON object a line."""

    def __init__(self, device, stages):
        self._errors = tempfile.TemporaryFile()
        # -P: this package, and not another one in the current folder
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", CHILD, str(Path(__file__).parents[2]), device, *stages],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=self._errors,
        )
        self._lines: queue.SimpleQueue = queue.SimpleQueue()
        self._silent = 0.0
        threading.Thread(target=self._read, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._process.kill()
        with suppress(subprocess.TimeoutExpired):  # a driver may hold it for longer
            self._process.wait(10)
        self._errors.close()

    def _read(self):
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put(b"")

    def messages(self, patience):
        """Yield the messages until the child ends or sends nothing for `patience` seconds."""
        while True:
            try:
                line = self._lines.get(timeout=patience)
            except queue.Empty:
                self._silent = patience
                return
            if not line.endswith(b"\n"):  # the end, perhaps in the middle of a line
                return
            yield json.loads(line)

    def death(self, finished):
        """Return why the child died, in one line; "" if it ended after all stages were judged."""
        if self._silent:
            return f"hangs: nothing came from its process for {self._silent:g} s"
        try:
            status = self._process.wait(60)
        except subprocess.TimeoutExpired:
            return "its process closed its output and goes on"
        if status == 0 and finished:
            return ""
        how = f"its process ended with status {status}"
        if status < 0:
            with suppress(ValueError):  # a real-time signal has no name
                how = f"its process died of {signal.Signals(-status).name}"
        self._errors.seek(max(0, self._errors.seek(0, 2) - LAST_WORDS))
        last = self._errors.read().decode(errors="replace").strip().splitlines()
        return one_line(f"{how}: {last[-1]}" if last else how)

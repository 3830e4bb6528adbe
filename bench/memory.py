"""Runs every stage under oclgrind, which checks each access to memory, and stores its messages.

    python bench/memory.py --form GPU --json bench/results/drivers/oclgrind-GPU.json

oclgrind interprets OpenCL kernels on the processor. It reports reads and writes outside an array,
races between work-items, and values that were never written. Every stage runs in a separate
process, once with its kernels for processors and once with those for GPUs. A row has "cases", "ran"
(those that began within the limit), "passed", "messages" (the kind of a message -> its number),
"example" (the first message), "unchecked" (why it ran without the check of values that were never
written), and "failed" if the stage did not end. `python bench/drivers.py --page` makes a table of
these results, too.
"""

import collections
import re
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from results import count, finish, in_process, parser, ready, start, without_folders

from gpusim.backends import open_device
from gpusim.backends.opencl import OpenCLDevice
from gpusim.domain.errors import OutOfRange
from gpusim.kernels.stage import compare, stage_module, stage_names

FORMS = ("processor", "GPU")
LAST = "OCLGRIND_UNINITIALIZED"  # the check of values that were never written, which may crash
CHECKS = {"OCLGRIND_DATA_RACES": "1", LAST: "1", "PYOPENCL_NO_CACHE": "1"}
MOST = 10**6  # messages; oclgrind stops at 1000 if it is not told


def one(device: str, stage: str, form: str, limit: float) -> dict:
    """Return the numbers of a stage's cases, of those that began within the limit, and passed."""
    opened = open_device(device)
    if form == "GPU":
        opened = OpenCLDevice(opened.cl_device, opened.name)
        opened.is_gpu, opened.on_host = True, False
    last, passed = time.monotonic() + limit, []
    for case, error in compare(stage, opened):
        if error is not None:
            passed.append(error <= case.tolerance)
        if time.monotonic() > last:
            break
    count_all = sum(1 for _ in stage_module(stage).cases())
    return {"cases": count_all, "ran": len(passed), "passed": int(sum(passed))}


def messages(text: str) -> dict:
    """Return the messages of a log by kind, numbers and addresses left out, and the first one."""
    # a message: lines without indent, then the place, indented
    text = without_folders(text)
    found = re.findall(r"^(?=\S)((?:\S.*\n)+)((?:\t.*\n)*)", text, re.MULTILINE)
    kinds = collections.Counter(kind(head) for head, _ in found)
    made: dict = {"messages": dict(kinds)}
    if found:
        made["example"] = " ".join((found[0][0] + found[0][1]).split())[:400]
    return made


def kind(head: str) -> str:
    """Return the kind of a message: its first line without numbers and addresses."""
    return re.sub(r"\b(0x[0-9a-f]+|\d+)\b", "#", head.splitlines()[0])


def checked(device: str, stage: str, form: str, limit: float) -> dict:
    """Return the row of a stage in one form; without the last check if the stage ends only so."""
    row = _checked(device, stage, form, limit, CHECKS)
    if "failed" in row:
        without = _checked(device, stage, form, limit, CHECKS | {LAST: "0"})
        if "failed" not in without:
            return without | {"unchecked": row["failed"]}
    return row


def _checked(device, stage, form, limit, checks):
    with TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        variables = checks | {"OCLGRIND_LOG": str(log), "OCLGRIND_MAX_ERRORS": str(MOST)}
        begin = time.perf_counter()
        settings = {"device": device, "stage": stage, "form": form, "limit": limit}
        row = {"name": stage, "form": form, **in_process("memory", settings, variables, 5 * limit)}
        row["seconds"] = round(time.perf_counter() - begin, 1)
        text = log.read_text(errors="replace") if log.exists() else ""
        return row | messages(text)


def main():
    """Check the stages, print and store the rows."""
    made = parser(__doc__, "opencl:oclgrind")
    made.add_argument("--stage", action="append", choices=stage_names(), metavar="AREA.NAME")
    made.add_argument("--form", action="append", choices=FORMS, help="(default: both)")
    made.add_argument(
        "--limit",
        type=count,
        default=300,
        help="[s] in which the cases of a stage begin (default: 300)",
    )
    arguments = made.parse_args()
    device, old = ready(arguments, "memory")
    if "oclgrind" not in device.cl_device.platform.name.lower():
        raise OutOfRange("device", device.name, "a device of oclgrind, such as opencl:oclgrind")
    rows = []
    for form in arguments.form or FORMS:
        for stage in arguments.stage or stage_names():
            row = checked(device.name, stage, form, arguments.limit)
            rows.append(row)
            said = row.get("failed") or f"{row['passed']} of {row['ran']} of {row['cases']}"
            print(f"{form:9s} {stage:24s} {said} {row['messages'] or ''}", flush=True)
    finish(arguments, "memory", device, rows, old, limit=arguments.limit)


if __name__ == "__main__":
    start(main)

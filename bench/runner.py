"""Compares the C runner of a pack with Python, stage by stage: times and verdicts of one driver.

    python bench/runner.py --device opencl:0 --title "PoCL 7.1" \
        --json bench/results/runner-epyc2-pocl7.json

Both sides verify all cases of the stages once. Then both time the same inputs, in processes of
their own that alternate; the first of a round is the last of the round before. Both run the same
form of the kernels, hold arrays at the begin of pages, in huge ones where NumPy does, and take the
device's clock (events). Other programs only add time, so a round's time is the least of the
repetitions in `--seconds`. "times" is the least of all rounds in C over that in Python.

A row has "cases", of the pack, and "left", those that are not in it; "wrong", for "c" and "python" the
numbers of the cases that failed; "error", the largest error of each by its tolerance, in the case's
metric; and "ms", the times of each in all rounds.
"""

import json
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

from results import add_size, checked, count, finish, in_process, parser, start

from gpusim.backends import open_device
from gpusim.backends.buffers import allocate_pages
from gpusim.backends.opencl import OpenCLDevice
from gpusim.bench.pack import FORMS, write_pack
from gpusim.bench.stages import Stage
from gpusim.bench.suite import time_work
from gpusim.domain.errors import BadFile, DeviceError, OutOfRange
from gpusim.domain.progress import announced
from gpusim.judge.verify import verify
from gpusim.kernels.stage import stage_names

# of all areas, and of every kind: vectors, sums, random numbers, transforms on the processor
STAGES = (
    *("spectral.integrate", "optics.mosaic", "sensor.chip", "sensor.noise"),
    *("processor.quantise", "processor.malvar", "processor.color", "display.encode"),
)
SIDES = "c", "python"
WITHIN = 0.05  # times agree


class FormForGPUs(OpenCLDevice):
    """A processor that stages take for a GPU, with the limits of a pack's form for GPUs."""

    def __init__(self, name: str):
        super().__init__(open_device(name).cl_device, name)
        self.is_gpu, self.group_limit, self.local_bytes = FORMS["gpu"]
        self.on_host = False

    def _allocate(self, nbytes):
        host = allocate_pages(nbytes)  # as the runner
        return self.wrap(host), host


def open_form(name: str, form: str) -> OpenCLDevice:
    """Return the device on which stages take a form."""
    device = open_device(name)
    return FormForGPUs(name) if form == "gpu" and not device.is_gpu else device


def one(name: str, forms: dict, size: list, seconds: float) -> dict:
    """Return a round in Python: the least time of each stage [ms]."""
    devices = {form: open_form(name, form) for form in set(forms.values())}
    works = {}
    for stage, form in forms.items():
        works[stage] = Stage(stage).start(devices[form], tuple(size))
        works[stage].run()
    return {
        stage: min(time_work(devices[form], works[stage], seconds)) for stage, form in forms.items()
    }


class Runner:
    """The C runner of a pack, with the device that Python has opened.

    Args:
        folder: Of the pack.
        device: Python's device.
        program: The runner, if it is built; None builds it beside the pack.
        compiler: The C compiler.
    """

    def __init__(self, folder: Path, device: OpenCLDevice, program: Path | None, compiler: str):
        if program is None:
            build = folder.with_name("build")
            settings = [f"-DCMAKE_C_COMPILER={compiler}", "-DCMAKE_C_FLAGS=-Werror"]
            for command in (["-S", folder, "-B", build, *settings], ["--build", build]):
                self._run(["cmake", *map(str, command)])
            program = build / "runner"
        self._command = [str(program.absolute()), str(folder)]
        listed = self._run([*self._command, "--list"]).stdout
        wanted, version = device.cl_device.name, device.cl_device.driver_version
        for number, name, driver in re.findall(r"^device (\d+): (.*?); (.*)$", listed, re.M):
            if name == wanted and f" {version} (" in driver:
                self._command += ["--device", number]
                return
        raise DeviceError(
            f"{device.name} ({wanted}): the C runner does not find this driver; wanted a file "
            "*.icd with its library in the folder that OCL_ICD_VENDORS names"
        )

    def _run(self, command):
        try:
            ended = subprocess.run(command, capture_output=True, text=True)
        except OSError as error:
            raise BadFile(command[0], f"cannot be run: {error.strerror or error}") from error
        if ended.returncode not in (0, 1) or (command[0] == "cmake" and ended.returncode):
            last = (ended.stderr or ended.stdout).strip().splitlines()[-1:]
            raise DeviceError(
                f"{Path(command[0]).name}: status {ended.returncode}: {' '.join(last)}"
            )
        return ended

    def rows(self, *options: str) -> tuple[dict, str]:
        """Return the rows of a run by stage, and what the runner printed beside them."""
        ended = self._run([*self._command, *options, "--json", "-"])
        rows = json.loads(ended.stdout)["rows"]
        return {row["name"].split()[0]: row for row in rows}, ended.stderr


def judge_stage(stage: str, index: str, device: OpenCLDevice) -> dict:
    """Return the row of a stage with Python's verdicts on the cases of a pack.

    Args:
        stage: Its name.
        index: Text of the pack's index.
        device: Python's device.
    """
    part = index.partition(f"\nstage {stage}\n")[2].partition("\nstage ")[0]
    listed = re.findall(r"^case (\w+) (\d+) ", part, re.M)
    # as the runner chooses
    form = "cpu" if not device.is_gpu and any(form == "cpu" for form, _ in listed) else "gpu"
    packed = {int(number) for each, number in listed if each == form}
    with announced(f"verifying {stage}"):
        cases = list(verify(open_form(device.name, form), [stage]))
    own = {number: case for number, case in enumerate(cases) if number in packed}
    used = [case["max_error"] / (case["tolerance"] or 1.0) for case in own.values() if case["ok"]]
    wrong = [number for number, case in own.items() if not case["ok"]]
    return {
        "name": stage,
        "form": form,
        "cases": len(own),
        "left": len(cases) - len(own),
        "wrong": {"python": wrong},
        "error": {"python": max(used, default=0.0)},
    }


def add_verdicts(row: dict, found: dict, printed: str) -> None:
    """Add the verdicts of the C runner to the row of a stage.

    Args:
        row: Row of `judge_stage`.
        found: The stage's row of the runner.
        printed: What the runner printed: the cases that failed.

    Raises:
        DeviceError: The runner took another form of the kernels, or other cases.
    """
    name, form = row["name"], row["form"]
    wrong = sorted(map(int, re.findall(rf"wrong: {re.escape(name)}/(\d+), {form} form", printed)))
    # and the timed input
    if found["form"] != form or found["cases"] + len(wrong) not in (row["cases"], row["cases"] + 1):
        raise DeviceError(
            f"{name}: the C runner judged {found['cases']} cases of form {found['form']}, Python "
            f"{row['cases']} of form {form}"
        )
    row["wrong"]["c"] = wrong
    row["error"]["c"] = found.get("max_error", 0.0) / (found.get("tolerance") or 1.0)


def compare(arguments, device) -> list[dict]:
    """Return a row for each stage."""
    stages, size = list(dict.fromkeys(arguments.stage or STAGES)), arguments.size
    units = device.cl_device.max_compute_units
    with TemporaryDirectory() as place:
        folder = Path(place) / "pack"
        write_pack(folder, stages, size, cores=units)
        runner = Runner(folder, device, arguments.runner, arguments.compiler)
        index = (folder / "index.txt").read_text()
        with ThreadPoolExecutor() as pool:  # verdicts are not timed
            verified = pool.submit(runner.rows, "--repeat", "0")
            rows = [judge_stage(stage, index, device) for stage in stages]
            with announced("verifying in C"):
                found, printed = verified.result()
        for row in rows:
            add_verdicts(row, found[row["name"]], printed)
        forms = {row["name"]: row["form"] for row in rows}
        for row in rows:
            row["ms"] = {side: [] for side in SIDES}
        for number in range(arguments.rounds):
            for side in SIDES if number % 2 else SIDES[::-1]:
                with announced(f"round {number + 1} of {arguments.rounds}, {side}"):
                    times = time_side(side, runner, device, forms, size, arguments.seconds)
                for row in rows:
                    row["ms"][side].append(times[row["name"]])
    for row in rows:
        least = {side: min(row["ms"][side]) for side in SIDES}
        row["times"] = least["c"] / least["python"]
    return rows


def time_side(side, runner, device, forms, size, seconds) -> dict:
    """Return a round of one side: the least time of each stage [ms]."""
    if side == "python":
        settings = {"name": device.name, "forms": forms, "size": size, "seconds": seconds}
        times = in_process("runner", settings)
        if "failed" in times:
            raise DeviceError(f"{device.name}: {times['failed']}")
        return times
    found, _ = runner.rows("--only", "timed", "--rounds", "1", "--seconds", str(seconds))
    for row in found.values():
        if not row["verified"]:
            raise DeviceError(f"{row['name']}: cannot be timed in C: {row['failed']}")
    return {stage: row["ms_best"] for stage, row in found.items()}


def agrees(row: dict) -> bool:
    """Return whether both sides judge the same cases alike."""
    error = row["error"]
    is_same = abs(error["c"] - error["python"]) <= 1e-9 * error["python"]  # of float64 operations
    return row["wrong"]["c"] == row["wrong"]["python"] and is_same


def tables(result: dict):
    """Yield the figures of a result in Markdown, for bench/README.md."""
    rows = result["rows"]
    near = sum(abs(row["times"] - 1) <= WITHIN + 1e-9 for row in rows)
    yield (
        f"{result['title']}, least of {result['rounds']} rounds: times within {WITHIN:.0%} in {near} of "
        f"{len(rows)} stages, equal verdicts in {sum(map(agrees, rows))}."
    )
    columns = (
        "stage",
        "form",
        "cases",
        "passed in C",
        "passed in Python",
        "C ms",
        "Python ms",
        "C / Python",
    )
    lines = [columns, ["---"] * len(columns)]
    for row in rows:
        passed = (f"{row['cases'] - len(row['wrong'][side])}" for side in SIDES)
        least = (f"{min(row['ms'][side]):.4g}" for side in SIDES)
        lines.append(
            (row["name"], row["form"], row["cases"], *passed, *least, f"{row['times']:.3f}")
        )
    yield "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def main():
    """Compare, print and store the result."""
    made = parser(__doc__, "opencl:0")
    add_size(made, "1280x720")
    made.add_argument("--title", help="name of the driver (default: the device's)")
    made.add_argument("--stage", action="append", choices=stage_names(), metavar="AREA.NAME")
    made.add_argument("--rounds", type=count, default=5, help="of each side (default: 5)")
    made.add_argument("--seconds", type=float, default=0.1, help="of a stage in a round")
    made.add_argument("--compiler", default="gcc", help="C compiler (default: gcc)")
    made.add_argument("--runner", type=Path, help="a runner that is built (default: build it)")
    arguments = made.parse_args()
    old = checked(arguments, "runner")
    if not arguments.seconds > 0:
        raise OutOfRange("seconds", arguments.seconds, "above 0")
    device = open_device(arguments.device)
    if device.kind != "opencl":
        raise OutOfRange("device", device.name, "an OpenCL device, such as opencl:0")
    rows = compare(arguments, device)
    settings = {key: getattr(arguments, key) for key in ("size", "rounds", "seconds", "compiler")}
    settings["title"] = arguments.title or device.name
    result = finish(arguments, "runner", device, rows, old, **settings)
    print("\n\n".join(tables(result)))
    if not all(map(agrees, rows)):
        raise DeviceError(f"{device.name}: the verdicts of C and Python differ, see the table")


if __name__ == "__main__":
    start(main)

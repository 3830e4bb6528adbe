"""The program as the system treats it: full disks, names, signals, closed outputs. One line on standard error."""

import json
import os
import resource
import signal
import subprocess
import sys

import pytest

from gpusim.cli.main import COMMANDS, main
from gpusim.domain.errors import BadFile
from gpusim.io.atomic import atomic_path, check_output
from gpusim.io.exr import write_rgb_exr

FLAT = ("simulate", "flat", "--camera", "mono", "--size", "32x32", "--device", "numpy")
START = "import sys; from gpusim.__main__ import start; sys.argv[0] = 'gpusim'; sys.exit(start())"


def program(*arguments, code=START, **options):
    """Run the program as installed, in a process of its own."""
    options = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "text": True,
        "timeout": 300,
    } | options
    return subprocess.run([sys.executable, "-c", code, *map(str, arguments)], **options)


def one_line(done, status, *parts):
    assert done.returncode == status, done.stderr
    assert (
        done.stderr.count("\n") == 1 and len(done.stderr) < 520 and done.stderr.startswith("gpusim")
    ), done.stderr
    assert all(str(part) in done.stderr for part in parts), done.stderr


def refused(capsys, *arguments):
    """Message of the command in this process."""
    with pytest.MonkeyPatch.context() as patch:  # what is wrong is said before anything is read
        patch.setattr("gpusim.io.camera.cameras.open_camera", None)
        assert main([str(argument) for argument in arguments]) == 2
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1, err
    return err


# ---- where outputs go


@pytest.mark.parametrize("option", ["-o", "--report"])
@pytest.mark.parametrize(
    "name, words",
    [
        ("x" * 300 + ".png", "too long"),
        ("/proc/a.png", "cannot be written"),
        ("folder.png", "is a folder"),
        ("file/a.png", "cannot be written"),
        ("pipe.png", "is a device or a pipe"),
        ("null.png", "is a device or a pipe"),
        ("a\0.png", "no file can have this name"),
    ],
)
def test_outputs_that_cannot_be_are_noticed_before_the_work(
    tmp_path, monkeypatch, capsys, option, name, words
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").touch()
    os.mkfifo("pipe.png")
    (tmp_path / "null.png").symlink_to("/dev/null")
    there = set(os.listdir())
    assert words in refused(capsys, *FLAT, option, name)
    assert set(os.listdir()) == there


@pytest.mark.parametrize(
    "arguments",
    [
        ("-o", "o.png", "-o", "./o.png"),
        ("-o", "o.png", "--report", "o.png"),
        ("-o", "o.png", "-o", "link/o.png"),
        ("-o", "o.png", "--frames", "3", "--report", "../here/o_0002.png"),
        ("-o", "o.png", "-o", "o_0001.png", "-o", "./o.png", "--frames", "3"),
    ],
)
def test_a_file_is_written_once(tmp_path, monkeypatch, capsys, arguments):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    os.symlink(".", "link")
    assert "is given twice, and would be overwritten" in refused(capsys, *FLAT, *arguments)
    assert os.listdir() == ["link"]


@pytest.mark.parametrize(
    "arguments",
    [
        ("a.npz", "--camera", "mono", "-o", "./a.npz"),
        ("flat", "--camera", "own.toml", "--report", "own.toml"),
    ],
)
def test_an_input_is_not_written_over(tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    assert "is read, and would be overwritten" in refused(capsys, "simulate", *arguments)


def test_names_as_long_as_the_system_takes_are_written(tmp_path, capsys):
    path = tmp_path / ("x" * 251 + ".png")
    assert main([*FLAT, "-o", str(path)]) == 0
    assert os.listdir(tmp_path) == [path.name]


def limited():
    resource.setrlimit(
        resource.RLIMIT_FSIZE, (1000, 1000)
    )  # a disk with 1000 bytes left; Python ignores SIGXFSZ


@pytest.mark.parametrize("suffix", ["png", "exr", "dng", "npz", "json"])
def test_a_full_disk_is_said_in_one_line(tmp_path, suffix):
    """OpenEXR says it by RuntimeError, the others by OSError, some when they close the file."""
    out = (
        ("--report", tmp_path / "a.json", "--frames", 2)
        if suffix == "json"
        else ("-o", tmp_path / f"a.{suffix}")
    )
    done = program(*FLAT[:4], "--size", "64x64", *FLAT[6:], *out, preexec_fn=limited)
    one_line(done, 2, f"a.{suffix}: cannot be written")
    assert os.listdir(tmp_path) == []


def test_a_small_picture_on_a_full_disk(tmp_path):
    """A writer that keeps a small file to its end must not lose it in silence."""
    code = (
        "import numpy as np, resource\nresource.setrlimit(resource.RLIMIT_FSIZE, (10, 10))\n"
        "from gpusim.io.exr import write_rgb_exr\nwrite_rgb_exr('a.exr', np.ones((4, 5, 3)))"
    )
    done = program(code=code, cwd=tmp_path)
    assert "BadFile: a.exr: cannot be written" in done.stderr and os.listdir(tmp_path) == []


def test_atomic_path_leaves_devices_alone(tmp_path):
    (tmp_path / "null").symlink_to("/dev/null")
    for write in (check_output, lambda path: write_rgb_exr(path, [[[1.0] * 3]])):
        with pytest.raises(BadFile, match="is a device or a pipe"):
            write(tmp_path / "null")
    with pytest.raises(BadFile, match="is a device"), atomic_path("/dev/null"):
        raise AssertionError("nothing may be written")


# ---- numbers


@pytest.mark.parametrize(
    "arguments",
    [
        ("--samples-per-pixel", "1e308"),
        ("--samples-per-pixel", "nan"),
        ("--samples-per-pixel", "inf"),
        ("--samples-per-pixel", "1e7"),
        ("--samples-per-pixel", "0.5"),
        ("--size", "9" * 400 + "x1"),
        ("--size", "9" * 5000 + "x1"),
        ("--size", "x" * 5000),
        ("--luminance", "nan"),
        ("--luminance", "1e308"),
        ("--tolerance", "nan"),
        ("--tolerance", "1e999"),
        ("--tolerance", "x" * 5000),
        ("--seed", "9" * 5000),
        ("--frames", "9" * 5000),
        ("--light", "daylight-" + "9" * 500 + "K"),
        ("--light", "x" * 5000),
        ("--device", "x" * 5000),
        ("--device", "opencl:" + "9" * 5000),
        ("--border", "x" * 5000),
        ("--camera", "x" * 5000),
        ("--band", "x" * 5000),
        ("--band", "a=nan"),
        ("-o", "x" * 5000),
        ("--report", "x" * 5000),
    ],
)
def test_numbers_and_names_without_measure(tmp_path, monkeypatch, capsys, arguments):
    monkeypatch.chdir(tmp_path)
    try:
        status = main([*FLAT, *arguments])
    except SystemExit as stop:  # argparse's
        status = stop.code
    err = capsys.readouterr().err
    assert status == 2 and err.count("\n") == 1 and len(err) < 560, (
        err
    )  # argparse adds where help is
    assert os.listdir(tmp_path) == []


# ---- standard output


OUTPUTS = [
    (("--version",), ""),
    (("--help",), ""),
    (FLAT, ""),
    (FLAT, "1"),
]  # and whether Python does not buffer it


@pytest.mark.parametrize(("arguments", "unbuffered"), OUTPUTS)
def test_a_full_standard_output_is_said_in_one_line(arguments, unbuffered):
    with open("/dev/full", "w") as full:
        done = program(*arguments, stdout=full, env=os.environ | {"PYTHONUNBUFFERED": unbuffered})
    one_line(done, 2, "standard output cannot be written: No space left on device")


@pytest.mark.parametrize(("arguments", "unbuffered"), OUTPUTS)
def test_a_reader_that_has_gone_ends_the_work_in_silence(arguments, unbuffered):
    end, start = os.pipe()
    os.close(end)
    with os.fdopen(start, "w") as closed:
        done = program(*arguments, stdout=closed, env=os.environ | {"PYTHONUNBUFFERED": unbuffered})
    assert (done.returncode, done.stderr) == (128 + signal.SIGPIPE, "")


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_a_full_standard_error_stops_no_work(unbuffered, tmp_path):
    with open("/dev/full", "w") as full:
        wrong, right = (
            program(
                *FLAT[:1],
                scene,
                *FLAT[2:],
                "--frames",
                2,
                "-o",
                tmp_path / "a.npz",
                stderr=full,
                env=os.environ | {"PYTHONUNBUFFERED": unbuffered},
            )
            for scene in ("none", "flat")
        )
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert right.returncode == 0 and "flat 32x32" in right.stdout and len(os.listdir(tmp_path)) == 2


# In a fork for each command and each way that streams can be: all is imported once
EVERY_COMMAND = """
import io, json, os, sys
import gpusim.backends.probe, gpusim.bench.suite, gpusim.cli.bench_run, gpusim.cli.main, gpusim.judge.plan_summary
import gpusim.pipeline.simulator, gpusim.judge.verify
from gpusim.__main__ import start
gpusim.backends.probe.devices = lambda refresh: [{"name": "a", "error": "no driver"}] * 9
works = json.loads(sys.argv[1])
works += [[name, "--help"] for name in gpusim.cli.main._parser()._subparsers._group_actions[0].choices]
found = []
for arguments in works:
    for out, err in (("full", "file"), ("gone", "file"), ("file", "full"), ("file", "gone"), ("none", "file"),
                     ("file", "none"), ("none", "none"))[:7 if arguments == ["--help"] else 3]:
        pid = os.fork()
        if not pid:
            break
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        found.append([arguments, out, err, status, open("1").read(), open("2").read()])
    else:
        continue
    break
else:
    print(json.dumps(found))
    sys.exit()
gone = os.pipe()
os.close(gone[0])
for number, how in ((1, out), (2, err)):
    file = os.open(str(number), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2({"full": os.open("/dev/full", os.O_WRONLY), "gone": gone[1]}.get(how, file), number)
    stream = io.TextIOWrapper(open(number, "wb", buffering=len(arguments) % 2 - 1, closefd=False), write_through=True)
    if how == "none":
        os.close(number)
    setattr(sys, {1: "stdout", 2: "stderr"}[number], None if how == "none" else stream)
sys.argv = ["gpusim", *arguments]
sys.exit(start())
"""


def test_no_command_minds_what_its_streams_are(tmp_path):
    """Lost output is a status and at most one line; lost messages change nothing."""
    works = [
        FLAT,
        ("plan", *FLAT[1:], "--tolerance", "0.01"),
        ("devices",),
        ("--version",),
        ("--help",),
        *((name, "--device", "numpy", "--stage", "sensor.flag") for name in ("verify", "bench")),
    ]
    works[-1] += ("--size", "8x8", "--quick")
    done = program(json.dumps(works), code=EVERY_COMMAND, cwd=tmp_path)
    found = json.loads(done.stdout.splitlines()[-1])
    helped = {arguments[0] for arguments, *_ in found if arguments[1:] == ["--help"]}
    assert helped == {name.split()[0] for name in COMMANDS} and not done.stderr
    for arguments, out, err, status, output, message in found:
        case = f"{arguments} {out} {err}: {status} {message}"
        if out == "full":
            full = "gpusim: standard output cannot be written: No space left on device\n"
            assert (status, message) == (2, full), case
        elif out == "gone":
            assert (status, message) == (141, ""), case
        else:
            assert (status, message) == (0, "") and (out == "none" or output), case


def test_letters_that_the_terminal_has_not(tmp_path):
    path = os.fsencode(tmp_path) + b"/\xff.toml"
    with open(path, "w") as file:
        file.write(
            "[optics]\nf_number = 2\nfocal_length_mm = 4\n[sensor]\npixel_pitch_um = 2\nqe = 'mt9v024'\n"
            "full_well_e = 9000\nbits = 10\n"
        )
    done = program(
        *FLAT[:2],
        "--camera",
        os.fsdecode(path),
        *FLAT[4:],
        env=os.environ | {"PYTHONIOENCODING": "ascii"},
    )
    assert done.returncode == 0 and r"by \udcff on numpy" in done.stdout, done.stderr


# ---- signals

SIGNALLED = (
    """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.{name})
sys.meta_path.insert(0, Finder())
"""
    + START
)


@pytest.mark.parametrize(
    "module",
    [
        "gpusim.cli.main",
        "argparse",
        "json",
        "gpusim.domain.errors",
        "gpusim.io.camera.cameras",
        "numpy",
        "numpy._core._multiarray_umath",
        "gpusim.io.exr",
        "scipy.special",
        "gpusim.pipeline.simulator",
    ],
)
def test_an_interruption_is_one_line_from_the_first_import_on(module):
    done = program(*FLAT, code=SIGNALLED.format(module=module, name="SIGINT"))
    assert (done.returncode, done.stderr) == (2, "gpusim: interrupted\n")


WORKING = (
    """
import sys, time, types
cli = types.ModuleType("gpusim.cli.main")
def main():
    from gpusim.io.atomic import atomic_path
    with atomic_path("a.npz") as temporary:
        temporary.write_bytes(b"half")
        print("writing", flush=True)
        time.sleep(60)
cli.main = main
sys.modules["gpusim.cli.main"] = cli
"""
    + START
)


@pytest.mark.parametrize("number, status", [(signal.SIGTERM, 143), (signal.SIGINT, 2)])
def test_a_signal_leaves_no_temporary_file(tmp_path, number, status):
    with subprocess.Popen(
        [sys.executable, "-c", WORKING],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout.readline() == "writing\n"
        assert len(os.listdir(tmp_path)) == 1
        process.send_signal(number)
        _, err = process.communicate(timeout=50)
    assert (process.returncode, err, os.listdir(tmp_path)) == (status, "gpusim: interrupted\n", [])


def test_a_negative_seed_of_training_is_refused(tmp_path, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["train-l3", "--camera", "phone", "-o", str(tmp_path / "a.npz"), "--seed", "-1"])
    assert "--seed: '-1': wanted a whole number, 0 .." in capsys.readouterr().err

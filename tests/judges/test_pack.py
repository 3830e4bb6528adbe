"""A pack has what its runner in C needs, and the runner agrees with Python, for right and for planted wrong answers.

The runner's answers are Python's float64 references; its verdicts are compared with those of `gpusim verify`.
"""

import json
import os
import re
import shutil
import subprocess
import tarfile
import zipfile
from pathlib import Path

import numpy as np
import pytest

from gpusim.backends import open_device
from gpusim.backends.pocl import PROCESSORS, WITH_AVX, WITH_AVX512
from gpusim.bench.pack import write_pack
from gpusim.bench.recorder import NotRecordable, Recorder
from gpusim.bench.result import read_result
from gpusim.bench.stages import Stage
from gpusim.bench.subject import digest_values
from gpusim.cli.main import main
from gpusim.domain.errors import BadFile, Conflict
from gpusim.judge.verify import verify
from gpusim.kernels.processor.levels import CORRECTED_BLACK, CORRECTED_WHITE
from gpusim.kernels.processor.quantise import cases

ROOT = Path(__file__).parents[2]
STAGES = ["optics.mosaic", "sensor.noise", "processor.quantise"]
COMPILERS = ["gcc", "clang"]
HEADERS = ("/usr/include", "/usr/local/include", "/opt/homebrew/include")


def why_not(compiler):
    """Why no runner can be built here; "" if it can."""
    for program in (compiler, "cmake"):
        if shutil.which(program) is None:
            return f"{program} is missing: apt-get install {program}"
    if not any(Path(folder, "CL", "cl.h").exists() for folder in HEADERS):
        return "OpenCL's headers are missing: apt-get install opencl-headers ocl-icd-opencl-dev"
    return "" if pip_pocl() else "pip's PoCL is missing: pip install 'pyopencl[pocl]'"


def pip_pocl():
    """PoCL's library in pyopencl's folder, or None."""
    import pyopencl

    return next(Path(pyopencl.__file__).parent.glob(".libs/libpocl*.so*"), None)


@pytest.fixture(scope="module")
def pack(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pack") / "own"
    write_pack(folder, STAGES, (40, 30))
    return folder


@pytest.fixture(scope="module", params=COMPILERS)
def runner(request, pack, tmp_path_factory):
    """The runner of a compiler, built without a warning, with pip's PoCL as the only driver."""
    if reason := why_not(request.param):
        pytest.skip(reason)
    folder = tmp_path_factory.mktemp(request.param)
    (folder / "icd").mkdir()
    (folder / "icd" / "pocl.icd").write_text(f"{pip_pocl()}\n")
    settings = [f"-DCMAKE_C_COMPILER={request.param}", "-DCMAKE_C_FLAGS=-Werror"]
    for command in (["-S", pack, "-B", folder, *settings], ["--build", folder]):
        made = subprocess.run(["cmake", *command], capture_output=True, text=True)
        assert made.returncode == 0, made.stdout + made.stderr
    variables = {**os.environ, "OCL_ICD_VENDORS": str(folder / "icd")}
    variables["POCL_CACHE_DIR"] = str(folder)

    def run(*arguments):
        command = [folder / "runner", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, env=variables, timeout=300)

    return run


def copy_of(pack, tmp_path):
    return Path(shutil.copytree(pack, tmp_path / "copy"))


def line_of(index, case, word):
    """The words of a line of a case, for example "case cpu 0"."""
    return re.search(rf"^{word} (.*)$", body_of(index, case), re.M)[1].split()


def body_of(index, case):
    """The lines of a case."""
    return index.partition(f"{case} ")[2].partition("\nend\n")[0]


def test_the_texts_of_programs_are_complete(pack):
    found = list((pack / "programs").iterdir())
    assert found
    for path in found:
        assert "#include" not in path.read_text() and path.read_text().startswith("#define GUARD")


def test_inputs_and_answers_follow_the_formula_of_quantisation(pack):
    """The formula in float64. Four float32 roundings below 2^16 err by 0.02 at most: numbers differ by 1 at most."""
    index, data = (pack / "index.txt").read_text(), (pack / "data.bin").read_bytes()
    text = index.partition("stage processor.quantise\n")[2]
    for number, case in enumerate(cases()):
        _, source = re.findall(r"^buffer \d+ (-?\d+)$", body_of(text, f"case gpu {number}"), re.M)
        raw = np.frombuffer(data, np.float32, case.inputs["raw"].size, int(source)).astype(float)
        np.testing.assert_array_equal(raw, case.inputs["raw"].ravel())
        kind, count, stored, place, *judged = line_of(text, f"case gpu {number}", "judge")
        answer = np.frombuffer(data, stored, int(count), int(place)).astype(float)
        light = (raw - case.inputs["black_level"]) * case.inputs["scale"]
        numbers = light * (CORRECTED_WHITE - CORRECTED_BLACK) + CORRECTED_BLACK
        right = np.where(np.isnan(raw), 0, np.clip(numbers, 0, CORRECTED_WHITE).round())
        assert (kind, judged[0], *map(float.fromhex, judged[1:])) == ("u2", "exact", 0, 0)
        assert np.abs(answer - right).max() <= 1


def test_what_calls_a_library_on_the_host_is_listed_as_left_out(pack):
    index = (pack / "index.txt").read_text()
    assert re.search(r"^left cpu \d+ it works on the host between kernels", index, re.M)
    assert "\ncase cpu " not in index.partition("stage sensor.noise")[0]
    assert "\ncase gpu " in index.partition("stage sensor.noise")[0]


def test_packs_of_the_same_kernels_are_equal(pack, tmp_path):
    for end in ("tar.gz", "zip"):
        write_pack(tmp_path / end, ["processor.quantise"], archive=tmp_path / f"pack.{end}")
    with (
        tarfile.open(tmp_path / "pack.tar.gz") as first,
        zipfile.ZipFile(tmp_path / "pack.zip") as second,
    ):
        files = {name.partition("/")[2]: name for name in first.getnames()}
        assert {name.partition("/")[2] for name in second.namelist()} == {*files}
        for path, name in files.items():
            texts = first.extractfile(name).read(), second.read(f"zip/{path}")
            if path == "index.txt":
                texts = [re.sub(rb"date .*\n", b"", text) for text in texts]
            assert texts[0] == texts[1], path


def test_the_runner_is_small_and_its_licence_is_ours(pack):
    assert len((pack / "runner.c").read_text().splitlines()) <= 500
    assert (pack / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()


def test_mistakes_are_one_line(pack, tmp_path, capsys):
    with pytest.raises(BadFile, match="exists; a pack needs a new folder"):
        write_pack(pack)
    with pytest.raises(Conflict, match=r"wanted .tar.gz or .zip"):
        write_pack(tmp_path / "new", archive=tmp_path / "pack.rar")
    assert main(["bench", "--pack", str(tmp_path / "new"), "--stage", "optics.mosiac"]) == 2
    assert "did you mean 'optics.mosaic'?" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_processor_s_cores_are_the_strips_of_a_frame(tmp_path):
    """`processor.best` cuts a frame into 4 strips a core, of 64 rows or more: 4 of 160 of 640 rows, then 10 of 64."""
    sizes = {}
    for cores in (1, 8):
        write_pack(tmp_path / str(cores), ["processor.best"], (8, 640), cores=cores)
        index = (tmp_path / str(cores) / "index.txt").read_text()
        timed = re.search(r"^case cpu \d+ timed input$.*?^end$", index, re.M | re.S)[0]
        sizes[cores] = [int(each) for each in re.findall(r"^run \d+ strip 1 (\d+)", timed, re.M)]
    assert sum(sizes[1]) == 4 and sum(sizes[8]) == 10


def test_what_only_kernels_know_cannot_be_read():
    device = Recorder(False, 256, 48 << 10)
    source, target = device.array(np.ones(8)), device.empty((8,))
    device.launch("common.copy", "copy", (8,), source, target, 8)
    assert (device.numpy(source) == 1).all()  # a kernel's const argument stays as it is
    with pytest.raises(NotRecordable, match="reads what kernels computed"):
        device.numpy(target)
    device.copy(source, target)
    with pytest.raises(NotRecordable):
        device.numpy(source)


@pytest.mark.slow
@pytest.mark.parametrize(
    "stage, form", [("sensor.noise", "cpu"), ("sensor.noise", "gpu"), ("processor.quantise", "cpu")]
)
def test_the_runner_agrees_with_python(stage, form, runner, pack, tmp_path):
    """As many cases pass as Python's device passes, the numbers are a result, and the bits are the same."""
    path = tmp_path / "result.json"
    found = runner(pack, "--only", stage, "--form", form, "--json", path, "--repeat", 3)
    assert found.returncode == 0, found.stdout + found.stderr
    result = read_result(path)
    (row,), cases = result["rows"], list(verify(open_device("opencl:pocl"), [stage]))
    assert row["verified"] is all(case["ok"] for case in cases) is True
    assert row["cases"] == len(cases) + 1  # and the timed input
    assert row["max_error"] == 0 == row["rel_rms_error"]  # of exact stages
    assert row["name"] == f"{stage} 40x30" + " (gpu form)" * (form == "gpu")
    assert row["hash"] == digest_values(Stage(stage).digest(), "40x30")
    assert len(row["rounds"]) == 3 and len(row["rounds"][0]["ms"]) == 3
    assert 0 < row["ms_best"] <= row["ms_p20"] <= row["ms_p50"] <= row["ms_p80"]
    assert row["wall_ms_best"] > 0.9 * row["ms_best"]  # kernels run while the host waits
    least = row["bytes"] / result["limits"]["copy_gbps"] / 1e6
    assert row["floor_ms"] >= least * (1 - 1e-9)
    assert row["attained"] == pytest.approx(row["floor_ms"] / row["ms_p50"])


def test_the_runner_knows_the_processors_that_python_knows():
    """The tables of pocl.c are those of gpusim/backends/pocl.py, in the same order where it counts."""
    text = (ROOT / "gpusim/bench/runner/pocl.c").read_text()
    haswell = re.search(r'HASWELL "(.*)"', text)[1]
    text = re.sub(
        r'"\s*\n?\s*"', "", text.partition('HASWELL "')[2].replace('HASWELL "', f'"{haswell}')
    )
    found = re.findall(r'\{"([\w-]+)", (?:"(.*?)"|HASWELL)\}', text)
    assert [(name, set((words or haswell).split())) for name, words in found] == [
        *PROCESSORS.items()
    ]
    for table, names in (("with_avx512", WITH_AVX512), ("with_avx", WITH_AVX)):
        assert set(re.search(rf'{table} = "(.*?)"', text)[1].split()) == names


@pytest.mark.slow
def test_the_runner_corrects_the_processor_as_python_does(runner, pack):
    found = runner(pack, "--repeat", 0, "--only", "processor.quantise")
    named = re.search(r"corrected to (\S+)", found.stdout)
    assert found.returncode == 0
    assert (named[1] if named else "") == open_device("opencl:pocl").processor


@pytest.mark.slow
def test_repetitions_fill_a_time(runner, pack):
    """A row that takes longer than the round has one; of the timed inputs alone."""
    given = ("--only", "timed", "--form", "gpu", "--rounds", 2, "--json", "-")
    rows = {}
    for seconds in (1e-6, 0.2):
        found = runner(pack, *given, "--seconds", seconds)
        rows[seconds] = json.loads(found.stdout)["rows"]
        assert found.returncode == 0 and [row["cases"] for row in rows[seconds]] == [1] * 3
    for few, many in zip(*rows.values(), strict=True):
        assert [len(one["ms"]) for one in few["rounds"]] == [1, 1]  # longer than a microsecond
        assert all(3 < len(one["ms"]) <= 1000 for one in many["rounds"])
        assert len(many["rounds"]) == 2


@pytest.mark.slow
def test_a_processor_takes_the_form_of_gpus_if_there_is_no_other(runner, pack):
    found = runner(pack, "--repeat", 0, "--only", "optics.mosaic/1", "--json", "-")
    (row,) = json.loads(found.stdout)["rows"]
    assert found.returncode == 0 and (row["form"], row["cases"]) == ("gpu", 1)
    assert row["name"].endswith("(gpu form)")


@pytest.mark.slow
def test_planted_faults_are_found(runner, pack, tmp_path):
    """One bit of an answer, kernels that do not compile, and missing ones: all in one run."""
    copy = copy_of(pack, tmp_path)
    index = (copy / "index.txt").read_text()
    stage = index.partition("stage processor.quantise\n")[2]
    _, _, stored, place, *_ = line_of(stage, "case cpu 2", "judge")
    data = bytearray((copy / "data.bin").read_bytes())
    data[int(place) + np.dtype(stored).itemsize - 1] ^= 1 << 3
    (copy / "data.bin").write_bytes(data)
    found = runner(copy, "--repeat", 0, "--only", "processor.quantise")
    assert found.returncode == 1 and "0 passed, 1 failed" in found.stdout
    assert re.search(
        r"wrong: processor.quantise/2, cpu form: .*: error .*, tolerance", found.stdout
    )
    for path in (copy / "programs").glob("sensor.noise-*.cl"):
        path.write_text(path.read_text() + "\nfloat broken( { return nothing; }\n")
    for path in (copy / "programs").glob("optics.mosaic*.cl"):
        path.write_text("__kernel void other(void) {}\n")
    found = runner(copy, "--repeat", 0, "--json", "-")
    rows = [row.get("failed", "") for row in json.loads(found.stdout)["rows"]]
    assert found.returncode == 1 and "cannot be built (OpenCL error" in found.stderr  # and the log
    words = "columns_forward: OpenCL error", "cannot be built", "error"
    assert [word in row for word, row in zip(words, rows, strict=True)] == [True] * 3


@pytest.mark.slow
def test_the_runner_takes_one_kernel_and_refuses_wrong_options(runner, pack, tmp_path):
    one = runner(pack, "--repeat", 0, "--form", "gpu", "--only", "sensor.noise/3")
    assert one.returncode == 0 and re.search(r"sensor.noise +gpu +1 cases", one.stdout)
    lines = runner(pack, "--repeat", 0, "--form", "gpu", "--only", "lines")  # of the noise
    assert lines.returncode == 0 and "1 passed" in lines.stdout
    listed = runner(pack, "--list")
    assert listed.returncode == 0 and listed.stdout.splitlines()[1:] == STAGES
    for arguments, words in (
        ((pack, "--repeat", "many"), "--repeat many: wanted"),
        ((pack, "--form", "fpga"), "--form fpga: wanted"),
        ((pack, "--seconds", "0"), "--seconds 0: wanted"),
        ((pack, "--build-options=-x"), "--build-options=-x : wanted"),
        ((pack, "--device", 7), "no OpenCL device 7, there are 1"),
        ((pack, "--only", "optics.mosiac"), "optics.mosiac: nothing has this name"),
        ((tmp_path,), "index.txt: cannot be read"),
    ):
        found = runner(*arguments)
        assert found.returncode == 2 and words in found.stderr
    failed = runner(
        pack, "--repeat", 0, "--only", "processor.quantise", "--build-options", "-no-such"
    )
    assert failed.returncode == 1 and "cannot be built" in failed.stdout

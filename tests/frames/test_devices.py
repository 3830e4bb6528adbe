"""Finding devices: what is kept of them, what their drivers keep, and what is said where they do not work."""

import ctypes
import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from contextlib import contextmanager
from math import prod
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from devices import KINDS

from gpusim.backends import caches, pocl, probe
from gpusim.backends.driver import is_gpu, pyopencl
from gpusim.backends.launches import CPU_GROUPS, split_grid
from gpusim.backends.opencl import OpenCLDevice
from gpusim.backends.select import open_device
from gpusim.domain.errors import DeviceError
from gpusim.kernels.sensor.pattern import pattern

GOOD = probe.EMPTY | {"name": "numpy", "device": "a processor", "driver": "1"}
SLOW = {**GOOD, "name": "warp:cpu"}
COPY = """
import sys
import numpy as np
from gpusim.backends import open_device
device = open_device(sys.argv[1])
values = np.arange(300, dtype=np.float32)
target = device.empty((300,))
device.launch("common.copy", "copy", (300,), device.array(values), target, 300)
assert np.array_equal(device.numpy(target), values)
"""


FRAMES = """
import sys
import gpusim as gs
simulator = gs.Simulator(gs.open_camera("phone"), device=sys.argv[1], tolerance=1e-3)
for size in sys.argv[2:]:
    simulator(gs.chart("deadleaves", size=tuple(map(int, size.split("x"))))).rgb
"""


def run(code, *arguments, **environment):
    """Python in a process of its own, with variables set, or with those unset that are None."""
    variables = {
        name: text for name, text in (os.environ | environment).items() if text is not None
    }
    return subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code, *arguments],
        env=variables,
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.fixture
def probed(monkeypatch, tmp_path):
    """Names of the devices that were tried, not kept; `found` has what the attempts give."""
    tried = []
    found = {"numpy": GOOD, "warp:cpu": SLOW}
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(probe, "_names", lambda: (list(found), ""))
    monkeypatch.setattr(probe, "_try", lambda name: tried.append(name) or found[name])
    probed.found = found
    return tried


def test_what_was_found_is_kept(probed):
    assert probe.devices() == probe.devices() == [GOOD, SLOW]
    assert probed == ["numpy", "warp:cpu"]
    probe.devices(refresh=True)
    assert len(probed) == 4


@pytest.mark.parametrize(
    "content",
    [
        "",
        "{",
        "null",
        "1",
        "[]",
        "{}",
        "[1]",
        "[null]",
        "[{}]",
        '"text"',
        "\xff\xfe",
        "\0\0\0",
        "[" * 10**5,
        '{"name": "numpy"}',
        json.dumps([{**GOOD, "copy_gbps": "fast"}]),
        json.dumps([{**GOOD, "more": 1}]),
        json.dumps([GOOD])[:-9],
    ],
    ids=lambda content: ascii(content[:20]),
)
def test_a_corrupt_record_is_made_anew(content, probed):
    assert probe.devices() == [GOOD, SLOW]
    probe._cache_path().write_text(content, "latin-1")
    assert probe.devices() == probe.devices() == [GOOD, SLOW]
    assert len(probed) == 4  # once at first, once for the damage


def test_a_record_that_cannot_be_read_or_written_is_done_without(probed, monkeypatch, tmp_path):
    path = probe._cache_path()
    path.mkdir(parents=True)
    assert probe.devices() == [GOOD, SLOW]
    assert list(path.parent.iterdir()) == [path]  # nothing half-written is left
    path.rmdir()
    path.symlink_to(path)  # cannot be read, whoever asks
    assert probe.devices() == [GOOD, SLOW]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "a file"))
    (tmp_path / "a file").write_text("")
    assert probe.devices() == [GOOD, SLOW]

    def nobody():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", nobody)
    assert probe.devices() == [GOOD, SLOW]


def test_devices_of_one_make_and_driver_make_the_same_whatever_their_number():
    first = open_device("opencl:pocl")
    assert probe.hardware_id(first) == probe.hardware_id(OpenCLDevice(first.cl_device, "opencl:7"))
    assert (
        first.cl_device.name.strip() in probe.hardware_id(first)
        and "opencl:" not in probe.hardware_id(first)[7:]
    )
    assert (
        len({probe.hardware_id(open_device(name)) for name in ("opencl:pocl", "warp:cpu", "numpy")})
        == 3
    )


def test_a_broken_device_is_kept_for_a_while(probed, monkeypatch):
    """It costs one attempt an hour, not one every time; a driver that is changed is tried at once."""
    broken = {**GOOD, "name": "opencl:0", "error": "no good"}
    found = {"numpy": GOOD, "opencl:0": broken, "warp:cpu": SLOW}
    monkeypatch.setattr(probe, "_names", lambda: (list(found), ""))
    monkeypatch.setattr(probe, "_try", lambda name: probed.append(name) or found[name])
    assert probe.devices() == probe.devices() == [*found.values()]
    assert len(probed) == 3
    path = probe._cache_path()
    os.utime(path, (path.stat().st_mtime - 2 * probe.PATIENCE,) * 2)
    probe.devices()
    assert len(probed) == 6
    monkeypatch.setenv("OCL_ICD_VENDORS", "/elsewhere")
    probe.devices()
    assert len(probed) == 9


def test_that_no_device_works_is_not_kept(probed, monkeypatch):
    """Its cause may be gone the next time, a package that was not whole say."""
    broken = {**SLOW, "error": "no kernels"}
    found = {"numpy": GOOD, "opencl:0": {**broken, "name": "opencl:0"}, "warp:cpu": broken}
    monkeypatch.setattr(probe, "_names", lambda: (list(found), ""))
    monkeypatch.setattr(probe, "_try", lambda name: probed.append(name) or found[name])
    with pytest.raises(DeviceError, match=r"no usable device .*no kernels"):
        probe.best()
    found["warp:cpu"] = SLOW
    assert probe.best()["name"] == "warp:cpu" and len(probed) == 6


def test_an_installation_that_changes_is_tried_again(monkeypatch):
    before = probe._cache_path()
    monkeypatch.setattr(probe, "_installation", lambda: ["elsewhere 1"])
    assert probe._cache_path() != before


def test_a_device_that_has_gone_is_not_chosen(probed, monkeypatch):
    """The record names a GPU that is no longer there: what there is now is found anew."""
    gone = {**GOOD, "name": "opencl:99", "gpu": True}
    found = [gone, SLOW]
    monkeypatch.setattr(probe, "_names", lambda: ([entry["name"] for entry in found], ""))
    monkeypatch.setattr(
        probe, "_try", lambda name: next(entry for entry in found if entry["name"] == name)
    )
    assert probe.best()["name"] == "opencl:99"
    del found[0]
    open_device.__globals__["_open"].cache_clear()
    assert open_device("auto").name == "warp:cpu"
    open_device.__globals__["_open"].cache_clear()


@pytest.mark.parametrize(
    "better, worse",
    [
        ({"driver": "PoCL 6.0"}, {"driver": "PoCL 3.1", "copy_gbps": 99.0}),
        ({"driver": "PoCL 6.0"}, {"driver": "rusticl 26.2", "fp64": False}),  # 10 times as slow
        ({"driver": "a GPU 1.0", "gpu": True, "fp64": False}, {"driver": "PoCL 6.0"}),
    ],
    ids=["newer", "float64", "GPU"],
)
def test_the_better_driver_is_chosen_in_any_order(better, worse, monkeypatch):
    common = {**GOOD, "fp64": True}
    entries = [{**common, "name": f"opencl:{n}", **one} for n, one in enumerate((better, worse))]
    for found in (entries, entries[::-1]):
        monkeypatch.setattr(probe, "devices", lambda refresh=False, found=found: found)
        assert probe.best()["driver"] == better["driver"]


@pytest.mark.parametrize(
    "rates, expected",
    [((400, 410), "opencl:0"), ((410, 400), "opencl:0"), ((200, 400), "opencl:1")],
)
def test_the_first_of_devices_that_are_alike_is_chosen(rates, expected, monkeypatch):
    """Every process takes the same one of two GPUs, unless it is busy."""
    entries = [
        {**GOOD, "gpu": True, "name": f"opencl:{n}", "copy_gbps": rate}
        for n, rate in enumerate(rates)
    ]
    monkeypatch.setattr(probe, "devices", lambda refresh=False: entries)
    assert probe.best()["name"] == expected


@pytest.mark.parametrize("ms", [0.0, 1e-6])  # rusticl 22.3 states 1e-6
def test_a_driver_whose_times_are_impossible_is_unusable(ms, monkeypatch):
    device = open_device("opencl:pocl")

    @contextmanager
    def timed():
        yield {"common.copy": ms}

    monkeypatch.setattr(device, "timed", timed)
    with pytest.raises(DeviceError, match=r"impossible times, .* ms for a copy of 64 MiB"):
        probe.copy_gbps(device)


@pytest.mark.parametrize(
    "types, expected", [((), False), (("CPU",), False), (("CPU", "GPU"), False), (("GPU",), True)]
)
def test_a_device_of_every_type_is_no_gpu(types, expected):
    known = pyopencl().device_type
    kind = sum(getattr(known, name) for name in types)
    assert is_gpu(SimpleNamespace(type=kind)) is expected


def test_where_no_opencl_works_one_line_says_so(probed, monkeypatch, caplog):
    found = [{**GOOD, "name": "opencl:0", "error": "unknown target CPU\n'generic'"}, SLOW]
    monkeypatch.setattr(probe, "devices", lambda refresh=False: found)
    assert probe.best()["name"] == "warp:cpu"
    (line,) = (record.getMessage() for record in caplog.records)
    assert (
        "opencl:0: unknown target CPU" in line
        and "install" in line
        and "\n" not in line
        and len(line) < 500
    )
    caplog.clear()
    assert probe.best("warp")["name"] == "warp:cpu"  # asked for
    assert not caplog.records


@pytest.mark.parametrize(
    "package, device", [("pyopencl", "opencl:0"), ("pyopencl", "opencl"), ("warp", "warp:cpu")]
)
def test_a_package_that_is_missing_is_said_in_one_line(package, device, tmp_path):
    (tmp_path / package).mkdir()
    (tmp_path / package / "__init__.py").write_text(
        f"raise ModuleNotFoundError('No module named {package}')\n"
    )
    found = run(
        "from gpusim.cli.main import main; import sys; sys.exit(main(sys.argv[1:]))",
        "simulate",
        "flat",
        "--camera",
        "phone",
        "--size",
        "16x16",
        "--device",
        device,
        PYTHONPATH=str(tmp_path),
        XDG_CACHE_HOME=str(tmp_path),
    )
    assert found.returncode == 2
    (line,) = found.stderr.splitlines()
    assert package in line and "pip install" in line and len(line) < 500


WAYS = "empty", "half", "zeros", "flipped", "folder", "unreadable"


def damage(file, way):
    """A file cut off, overwritten, with a bit flipped in its middle, or with something else in its place."""
    content = file.read_bytes()
    middle = len(content) // 2
    flipped = (
        content[:middle] + bytes([content[middle] ^ 16]) + content[middle + 1 :] if content else b""
    )
    file.unlink()
    if way == "folder":
        file.mkdir()
    elif way == "unreadable":
        file.symlink_to("/no/such file")  # for root, too
    else:
        file.write_bytes(
            {"half": content[:middle], "zeros": bytes(len(content)), "flipped": flipped}.get(
                way, b""
            )
        )


def kept_in(folder):
    return {
        name: str(folder / name) for name in ("POCL_CACHE_DIR", "WARP_CACHE_PATH", "XDG_CACHE_HOME")
    }


def compiled(device, folder):
    """Folders in which a device's kernels were kept by a process, and their files."""
    folders = kept_in(folder)
    for kept in folders.values():
        Path(kept).mkdir(parents=True)
    assert run(COPY, device, **folders).returncode == 0
    return [file.relative_to(folder) for file in sorted(folder.rglob("*")) if file.is_file()]


def require_mended(folder, device, what):
    """The kernels of damaged caches are right, after one line at most, and nothing is said the next time."""
    first, second = (run(COPY, device, **kept_in(folder)) for _ in range(2))
    assert first.returncode == 0 and len(first.stderr.splitlines()) <= 1, (
        f"{what}: {first.returncode} {first.stderr}"
    )
    assert "Traceback" not in first.stderr
    assert (second.returncode, second.stderr) == (0, ""), what


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize(
    "way",
    [
        way if way in ("flipped", "unreadable") else pytest.param(way, marks=pytest.mark.slow)
        for way in WAYS
    ],
)
def test_corrupt_kernels_are_built_anew(device, way, tmp_path):
    """All files of all caches at once."""
    files = compiled(device, tmp_path)
    if not files:
        pytest.skip("its driver keeps what it compiled elsewhere")
    for file in files:
        damage(tmp_path / file, way)
    require_mended(tmp_path, device, way)


@pytest.mark.slow
@pytest.mark.parametrize("device", KINDS)
def test_every_file_of_a_cache_may_be_corrupt(device, tmp_path):
    """One at a time, in every way."""
    files = compiled(device, tmp_path / "whole")
    for file in files:
        for way in WAYS:
            shutil.copytree(tmp_path / "whole", tmp_path / "damaged", symlinks=True)
            damage(tmp_path / "damaged" / file, way)
            require_mended(tmp_path / "damaged", device, f"{file} {way}")
            shutil.rmtree(tmp_path / "damaged")
    print(f"{device}: {len(files) * len(WAYS)} corrupt files")


def test_what_was_compiled_is_known_by_its_checksum(tmp_path, caplog):
    program = tmp_path / "AB" / "CDE"
    (program / "copy").mkdir(parents=True)
    (program / "copy" / "copy.bin").write_bytes(b"some code")
    assert caches.is_sound(program)  # nothing is noted
    caches.note(program)
    copied = shutil.copytree(program, tmp_path / "AB" / "FGH")  # with other times
    os.utime(copied / "copy" / "copy.bin", (1, 1))
    assert caches.is_sound(program) and caches.is_sound(copied)
    (copied / "copy" / "copy.bin").write_bytes(b"SOME CODE")
    os.utime(copied / "copy" / "copy.bin", (1, 1))
    caches.note(copied)  # by a process that does not use it: what was noted stays
    assert not caches.is_sound(copied)
    assert caches.keep_sound([program, copied]) and not copied.exists()
    assert [record.getMessage() for record in caplog.records] == [
        f"gpusim: 1 compiled program in {tmp_path / 'AB'} was damaged, and built again"
    ]
    (program / caches.SUMS).write_text("[[")
    assert not caches.is_sound(program)


@pytest.mark.parametrize("device", KINDS)
def test_kernels_that_cannot_be_kept_are_built(device, tmp_path):
    """A file stands where the folders would be: nobody, root neither, can write there."""
    (tmp_path / "file").write_text("")
    found = run(COPY, device, **kept_in(tmp_path / "file"))
    assert found.returncode == 0, found.stderr


def test_a_full_disk_is_done_without_or_said_in_one_line(tmp_path, monkeypatch):
    """By a limit of 1 MiB a file, which is one of quotas, too: PoCL aborts at a file that it cannot write."""
    import resource

    hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
    monkeypatch.setattr(caches, "LARGEST", 2**21)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2**20, hard))
    try:
        assert not caches.has_room(tmp_path)
        with pytest.raises(
            DeviceError, match="no room for compiled kernels: wanted 32 MiB"
        ) as failure:
            caches.lent_folder()
        assert "\n" not in str(failure.value)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    assert caches.has_room(tmp_path)


@pytest.mark.parametrize("device", KINDS)
def test_a_cache_on_a_full_disk(device, tmp_path):
    """Kernels are kept elsewhere for the process."""
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=256k", "tmpfs", tmp_path], capture_output=True
    ).returncode:
        pytest.skip("a small disk can be mounted by root alone")
    try:
        folders = kept_in(tmp_path)
        for folder in folders.values():
            Path(folder).mkdir()
        (tmp_path / "filler").write_bytes(bytes(2**17))
        found = run(COPY, device, **folders)
        assert (found.returncode, found.stderr) == (0, "")
    finally:
        subprocess.run(["umount", tmp_path], check=True)


@pytest.mark.parametrize("grid", [(1,), (127,), (128,), (1000,), (3, 137), (5, 128), (2, 3, 263)])
def test_a_cpu_does_a_grid_once_in_groups_of_few_sizes(grid):
    done = np.zeros(grid, int)
    for size, group, offset in split_grid(grid, None, is_gpu=False):
        assert group[-1] in CPU_GROUPS and prod(group) == group[-1] and size[-1] % group[-1] == 0
        done[
            tuple(slice(first, first + count) for first, count in zip(offset, size, strict=True))
        ] += 1
    assert (done == 1).all()


@pytest.mark.slow
@pytest.mark.parametrize("device", KINDS)
def test_nothing_is_compiled_for_another_size(device, tmp_path):
    """Of frames by tiles, whose transforms have one length: the first two sizes take groups of all sizes.

    PoCL compiles anew for more than 2^16 work-items.
    """
    folders = kept_in(tmp_path)

    def kernels():
        return {
            path for kind in ("*.so", "*.o", "*.cubin", "*.ptx") for path in tmp_path.rglob(kind)
        }

    assert run(FRAMES, device, "203x131", "331x260", **folders).returncode == 0
    before = kernels()
    if not before:
        pytest.skip("its driver keeps what it compiled where nobody can count it")
    assert run(FRAMES, device, "211x143", "310x230", **folders).returncode == 0
    assert kernels() == before


def driver_that_sees(folder, **makers):
    """Environment in which pip's PoCL, the only driver, looks for other makers of processors than there are."""
    package = importlib.util.find_spec("pyopencl").submodule_search_locations[0]
    drivers = [*Path(package, ".libs").glob("libpocl*.so")]
    if platform.machine() != "x86_64" or not drivers:
        pytest.skip("pip's PoCL is not installed: its wheels are for Linux on x86-64")
    shutil.copytree(package, folder / "pyopencl")
    (folder / "pocl_binary_distribution").symlink_to(
        Path(package).with_name("pocl_binary_distribution")
    )
    driver = folder / "pyopencl" / ".libs" / drivers[0].name
    changed, places = re.subn(
        rb"(?<=\x81\xfe)(Genu|Auth)",  # compared with what the processor says of itself
        lambda found: makers[found[1].decode()].encode(),
        driver.read_bytes(),
    )
    driver.write_bytes(changed)
    assert places
    (folder / "vendors").mkdir()
    return kept_in(folder) | {"PYTHONPATH": str(folder), "OCL_ICD_VENDORS": str(folder / "vendors")}


@pytest.fixture(scope="module")
def unknown_processor(tmp_path_factory):
    """Environment in which pip's PoCL does not know the processor: its LLVM finds no known maker."""
    return driver_that_sees(tmp_path_factory.mktemp("unknown"), Genu="None", Auth="None")


@pytest.fixture(scope="module")
def mistaken_processor(tmp_path_factory):
    """The same where Intel's and AMD's are confused: Intel's are an Athlon XP of 2001, AMD's are not known."""
    return driver_that_sees(tmp_path_factory.mktemp("mistaken"), Genu="Auth", Auth="Genu")


def test_pocl_does_not_build_for_an_unknown_processor_by_itself(unknown_processor):
    """What the mend is for: it says "generic", and then refuses that."""
    found = run(
        "import pyopencl as cl; device, = cl.get_platforms()[0].get_devices(); print(device.version)\n"
        "cl.Program(cl.Context([device]), '__kernel void nothing() {}').build()",
        **unknown_processor,
    )
    assert (
        found.stdout.strip().endswith("-generic") and "unknown target CPU 'generic'" in found.stderr
    )


def test_pocl_builds_for_an_unknown_processor(unknown_processor):
    """The device that pip brings is usable, and the one that is chosen."""
    found = run(
        "from gpusim.backends import open_device; device = open_device('auto')\n"
        "print(device.name, device.cl_device.version, device.processor)",
        **unknown_processor,
    )
    name, *version, processor = found.stdout.split()
    assert (
        name == "opencl:0"
        and version[-1].endswith("-generic")
        and processor in ("skylake-avx512", "haswell", "sandybridge", "x86-64")
    )
    found = run(COPY, "opencl:0", **unknown_processor)
    assert found.returncode == 0, found.stderr


def test_a_processors_name_is_set_in_its_own_place_alone():
    """What lies behind PoCL's structure may name the processor, too: it is another's."""
    names = [
        ctypes.create_string_buffer(text)
        for text in (b"other", b"znver3", b"znver3", b"skylake-avx512")
    ]
    memory = (ctypes.c_void_p * 256)()
    for place, name in zip((3, 80, 140, 150), names, strict=True):
        memory[place] = ctypes.addressof(name)
    for _ in range(2):  # the second time it is there
        assert pocl._rename_processor(ctypes.addressof(memory), b"znver3", b"skylake-avx512")
        assert [ctypes.string_at(memory[place]) for place in (3, 80, 140, 150)] == [
            b"other",
            b"skylake-avx512",
            b"znver3",
            b"skylake-avx512",
        ]
    assert not pocl._rename_processor(
        ctypes.addressof((ctypes.c_void_p * 256)()), b"znver3", b"skylake-avx512"
    )


@pytest.mark.parametrize("environment", ["unknown_processor", "mistaken_processor", ""])
def test_kernels_of_wide_vectors_are_found_again(environment, request, tmp_path):
    """Where names and features of processors disagree, kernels were lost when they were loaded from the cache."""
    folders = kept_in(tmp_path)
    for folder in folders.values():
        Path(folder).mkdir()
    settings = (request.getfixturevalue(environment) if environment else {}) | folders
    found = [
        run(
            "from gpusim.backends import open_device; from gpusim.kernels.sensor.pattern import pattern\n"
            "device = open_device('opencl:0'); values = pattern(4, 17, 'dark', pixel=1.0, seed=3, device=device)\n"
            "print(device.numpy(values).tobytes().hex())",
            **settings,
        )
        for _ in range(2)
    ]
    expected = np.asarray(
        pattern(4, 17, "dark", pixel=1.0, seed=3, device=open_device("numpy")), np.float32
    )
    for once in found:
        assert once.stdout.strip() == expected.tobytes().hex(), once.stderr


@pytest.mark.slow
def test_every_stage_is_right_on_an_unknown_processor(unknown_processor):
    found = run(
        "from gpusim.cli.main import main; import sys; sys.exit(main(['verify', '--device', 'opencl:0']))",
        **unknown_processor,
    )
    assert found.returncode == 0 and " 0 failed" in found.stdout


def test_a_device_unknown_to_the_driver_is_refused_in_one_line():
    with pytest.raises(DeviceError) as failure:
        open_device("opencl:no such")
    assert "\n" not in str(failure.value)

"""Programs that PoCL loads by their place in its cache."""

import shutil
import struct
import subprocess
import sys

import numpy as np
import pytest

from gpusim.backends import pocl_programs
from gpusim.backends.opencl import OpenCLDevice
from gpusim.backends.pocl_programs import HEAD, Programs
from gpusim.backends.select import open_device

OPTIONS = ["-cl-std=CL1.2", "-cl-fp32-correctly-rounded-divide-sqrt"]
TEXT = """
__kernel void scale(__global const float *restrict a, __constant int *b, __global ushort *out,
                    const float factor, uint rows, char flag) {
    out[get_global_id(0)] = (ushort)(a[get_global_id(0)] * factor) + b[0] + rows + flag;
}
__kernel __attribute__((reqd_work_group_size(4, 1, 1))) void fill(__global float2 *out, int n) {
    out[get_global_id(0)] = (float2)(n, get_global_id(0));
}
"""
COPY = """
import numpy as np
from gpusim.backends import caches, open_device
from gpusim.domain.progress import listening
heard = []
device = open_device("opencl:pocl")
values, target = np.arange(300, dtype=np.float32), device.empty((300,))
with listening(heard.append):
    for _ in range(2):
        device.launch("common.copy", "copy", (300,), device.array(values), target, 300)
print(heard)
assert np.array_equal(device.numpy(target), values)
"""


@pytest.fixture
def programs():
    device = open_device("opencl:pocl")
    found = Programs(device._cl, device.context)
    if not found._is_recorded:
        pytest.skip("another version of PoCL, whose programs are built from text")
    return found


def own_binary(programs, text):
    """Return PoCL's own binary of a program: head, and descriptions of kernels without their code."""
    cl = programs._cl
    (binary,) = (
        cl.Program(programs._context, text).build(OPTIONS).get_info(cl.program_info.BINARIES)
    )
    at, parts = HEAD, []
    for _ in ("name of the bitcode's file", "bitcode"):
        at += 4 + struct.unpack_from("<I", binary, at)[0]
    while at < len(binary):
        whole, code, arguments = struct.unpack_from("<QQI", binary, at)
        described = binary[at + 20 : at + whole - code]
        parts.append(struct.pack("<QQI", whole - code, 0, arguments) + described)
        at += whole
    return binary[:HEAD], b"".join(parts)


def test_a_record_is_the_binary_of_pocl_without_code(programs, tmp_path):
    text = f"{TEXT}// {tmp_path}"
    programs.build(text, OPTIONS)
    record = pocl_programs._read(programs._record_path(text, OPTIONS))
    assert (record[:HEAD], record[HEAD:]) == own_binary(programs, text)


def test_a_program_with_local_arrays_is_built_from_its_text(programs, tmp_path):
    text = f"""// {tmp_path}
__kernel void f(__global int *a) {{
    __local int b[4];
    b[get_local_id(0)] = a[0];
    barrier(CLK_LOCAL_MEM_FENCE);
    a[0] = b[1];
}}"""
    programs.build(text, OPTIONS)
    assert len(pocl_programs._read(programs._record_path(text, OPTIONS))) == HEAD
    programs.build(text, OPTIONS)


def test_loaded_kernels_compute_what_built_ones_do(programs, tmp_path):
    """The second device loads the program; its kernels are compiled for the size of its groups."""
    first = open_device("opencl:pocl")
    second = OpenCLDevice(first.cl_device, "opencl:7")
    text = f"{TEXT}// {tmp_path}".replace("a[get_global_id(0)] *", "exp(a[get_global_id(0)]) *")
    values, found = np.linspace(0, 5, 256, dtype=np.float32), []
    for device, group in ((first, 32), (second, 64)):
        built, _ = device._built.build(text, OPTIONS)
        kernel = device._cl.Kernel(built, "scale")
        given, few = device.array(values), device.array([3], np.int32)
        out = device.empty((256,), np.uint16)
        arguments = (np.float32(7), np.uint32(2), np.int8(1))
        kernel(device.queue, (256,), (group,), given.buffer, few.buffer, out.buffer, *arguments)
        found.append(device.numpy(out).copy())
    assert np.array_equal(*found)
    # exp is good to 3 units in the last place: below 0.001 at 1039, of which the fraction is cut
    assert np.abs(found[0] - (np.exp(values.astype(float)) * 7 + 5.5)).max() <= 0.501


def test_the_text_of_include_files_counts(programs, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "one.clh").write_text("#define ONE 1")
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    paths = [programs._record_path("", ["-I", str(tmp_path / name)]) for name in "ab"]
    (tmp_path / "b" / "one.clh").write_text("#define ONE 2")
    pocl_programs._included.cache_clear()
    paths.append(programs._record_path("", ["-I", str(tmp_path / "b")]))
    assert paths[0] == paths[1] != paths[2]


def test_a_second_process_builds_nothing_from_text(programs, tmp_path, monkeypatch):
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path))

    def run(code):
        command = [sys.executable, "-W", "ignore", "-c", code]
        return subprocess.run(command, capture_output=True, text=True, timeout=300)

    # None cannot be called: a build from text would fail
    ends = [run(COPY), run(COPY.replace("device =", "caches.prepare_build = None\ndevice ="))]
    (record,) = (tmp_path / "gpusim").glob("*/record")
    record.write_bytes(record.read_bytes()[:-1])
    ends.append(run(COPY))
    assert [(end.returncode, end.stderr) for end in ends] == [(0, "")] * 3
    # the first process builds the program, and compiles its kernel for groups of 128, 8 and 1
    build = ["compiling common.copy", None]
    heard = [build * 2, build, build * 2]
    assert [end.stdout.strip() for end in ends] == [str(words) for words in heard]

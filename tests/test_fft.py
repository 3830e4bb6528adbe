"""The transforms that GPUs use, whole lines in local memory, run on the CPU by OpenCL; and the stages built on them."""

from importlib import import_module

import numpy as np
import pytest

from gpusim.backends import open_device
from gpusim.backends.native import native_kernel
from gpusim.backends.warp import started_warp
from gpusim.kernels.common import fft
from gpusim.kernels.common.border import BORDERS, extend
from gpusim.kernels.stage import public_function

mosaic = import_module("gpusim.kernels.optics.mosaic")


@pytest.fixture
def device(monkeypatch):
    """A CPU's OpenCL device that claims to be apart from the host: what is written for GPUs runs on it."""
    device = open_device("opencl:pocl")
    monkeypatch.setattr(device, "on_host", False)
    return device


def check(device, stage, number):
    """Run one of a stage's cases, with its own tolerance: whose derivation does not depend on who transforms."""
    module = import_module(f"gpusim.kernels.{stage}")
    case = list(module.cases())[number]
    function = public_function(stage)
    assert case.error(function(**case.inputs, device=device), function(**case.inputs, device="numpy")) <= case.tolerance


@pytest.mark.parametrize("stage, number", [
    ("optics.mosaic", 1), *(pytest.param("optics.mosaic", n, marks=pytest.mark.slow) for n in (0, 2, 3, 4, 5, 6, 7)),
    *(pytest.param("optics.blur", n, marks=pytest.mark.slow) for n in range(8))])
def test_stages_in_local_memory(stage, number, device):
    check(device, stage, number)


@pytest.mark.slow
@pytest.mark.parametrize("number", [1, 3])
def test_mosaic_whose_lines_do_not_fit(number, device, monkeypatch):
    """Transforms of whole planes with the fold between them, when local memory is too small for lines side by side."""
    monkeypatch.setattr(mosaic, "_lines", lambda *_: None)
    check(device, "optics.mosaic", number)


def test_how_many_lines_fit():
    """48 KiB: a full frame, one of 4K, and one of 8K, whose rows do not fit at all."""
    assert mosaic._lines((1200, 2048), (2, 2)) == (4, 2, 4, 4)
    assert mosaic._lines((2304, 4000), (2, 2)) == (2, 1, 2, 2)
    assert mosaic._lines((4500, 8000), (2, 2)) is None


def test_passes_multiply_to_the_length():
    """Every length that is offered is a product of radices that there are transforms of, in as few as can be."""
    for length in fft.LENGTHS:
        radices = fft._radices(length)
        assert np.prod(radices) == length
        assert set(radices) <= {*fft.RADICES, 1}
    assert [len(fft._radices(length)) for length in (16, 240, 256, 2048, 1200, 4096, 1250)] == [1, 2, 2, 3, 3, 3, 4]


@pytest.mark.parametrize("rows, cols", [
    (6, 80), (15, 192),  # radices 6, 10 8; 15, 16 12
    *(pytest.param(*size, marks=pytest.mark.slow) for size in (
        (1, 2), (2, 6), (16, 9), (48, 45), (250, 64), (36, 1200), (2048, 5), (5, 3), (4, 12)))])
def test_transforms_equal_the_library_ones(rows, cols, device):
    """Every radix, as the first and as a later pass; the forward transform, and the way back."""
    planes = np.random.default_rng(rows).standard_normal((3, rows, cols), np.float32)
    spectra = fft.forward(device, device.array(planes))
    values = device.numpy(spectra)[:, :, : cols // 2 + 1].astype(np.float64) @ (1, 1j)
    expected = np.fft.rfft2(planes.astype(np.float64))
    # Each of at most 4 + 4 passes errs by about 3 roundings (sum, root, product) of 6e-8 of the values' size: 5e-7 of
    # the root mean square, as these add up as squares, and the largest of 4e4 values is within 5 sigma.
    assert np.abs(values - expected).max() <= 2.5e-6 * np.sqrt(rows * cols)
    back = device.numpy(fft.inverse(device, spectra, cols))
    assert np.abs(back - planes).max() <= 2 * 2.5e-6  # two transforms


@pytest.mark.parametrize("border", ["reflect", *(pytest.param(b, marks=pytest.mark.slow) for b in ("zero", "edge"))])
def test_borders_are_filled_in_as_the_stage_extends(border, device):
    """The same spectra as of planes extended first, with borders wider than the frame."""
    assert set(BORDERS) == {"zero", "edge", "reflect"}
    planes = device.array(np.random.default_rng(1).random((3, 5, 7), np.float32))
    extended = device.numpy(extend(device, planes, border, (17, 14), (40, 36), 1, 2)).astype(np.float64)
    spectra = device.numpy(fft.forward_extended(device, planes, 1, 2, border, (40, 36)))[:, :, :19]
    expected = np.fft.rfft2(extended)
    # as above, of the largest value: at most 8 passes of 4 sums, 6e-8 each
    assert np.abs(spectra @ (1, 1j) - expected).max() <= 2e-6 * np.abs(expected).max()


def test_the_text_is_cuda_too(tmp_path):
    """Warp's compiler takes every kernel as it is launched on a CUDA device; no GPU is needed for that."""
    wp = started_warp()
    compiled = []

    class Compiler:
        """Stands for a Warp CUDA device: compiles what is launched."""

        kind, on_host, group_limit = "warp", False, 1024

        def array(self, values, dtype=np.float32):
            return np.asarray(values, dtype)

        def empty(self, shape):
            return np.empty(shape, np.float32)

        def launch(self, stage, kernel, grid, *args, defines, group):
            ranks = [arg.ndim if isinstance(arg, np.ndarray) else None for arg in args]
            made = native_kernel(wp, stage, kernel, defines, ranks)
            (path,) = wp.compile_aot_module(made.module, arch=90, module_dir=tmp_path / kernel, use_ptx=True)
            assert f".maxnreg {defines['REGISTERS']}" in path.read_bytes().decode(errors="replace")
            assert grid[0] % group[0] == 0  # whole groups: a barrier waits for all
            compiled.append(kernel)

    device, (rows, cols), period, cfa = Compiler(), (5, 9), (8, 12), np.array([[0, 1], [1, 2]])
    planes, out, tables = device.empty((2, rows, cols)), device.empty((rows, cols)), device.empty((1, 2, 5, 7))
    mosaic._by_lines(device, planes, tables, np.ones((3, 2), np.float32), cfa, "edge", period, (1, 1),
                     mosaic._lines(period, cfa.shape), out)
    fft.inverse(device, fft.forward_extended(device, planes, 0, 2, "edge", period), period[1])
    assert set(compiled) == {"columns_forward", "fold", "columns_inverse", "rows_forward", "columns", "rows_inverse"}

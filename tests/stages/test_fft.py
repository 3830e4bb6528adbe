"""The transforms that GPUs use, whole lines in local memory, run on the CPU by OpenCL; and the stages built on them."""

from dataclasses import replace
from importlib import import_module

import numpy as np
import pytest
from devices import GPUS

import gpusim as gs
from gpusim.backends import open_device
from gpusim.backends.native import native_kernel
from gpusim.backends.warp import start_warp
from gpusim.domain.mosaics import MOSAICS
from gpusim.kernels.common import fft
from gpusim.kernels.common.border import BORDERS, extend
from gpusim.kernels.stage import public_function
from gpusim.planner.choices import Blur

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
    assert (
        case.error(function(**case.inputs, device=device), function(**case.inputs, device="numpy"))
        <= case.tolerance
    )


@pytest.mark.parametrize(
    "stage, number",
    [
        ("optics.mosaic", 1),
        *(pytest.param("optics.mosaic", n, marks=pytest.mark.slow) for n in (0, 2, 3, 4, 5, 6, 7)),
        *(pytest.param("optics.blur", n, marks=pytest.mark.slow) for n in range(8)),
    ],
)
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
    assert mosaic._lines(49152, (1200, 2048), (2, 2)) == (4, 2, 4, 4)
    assert mosaic._lines(49152, (2304, 4000), (2, 2)) == (2, 1, 2, 2)
    assert mosaic._lines(49152, (4500, 8000), (2, 2)) is None


@pytest.mark.parametrize("local_bytes", [32 * 1024, 48 * 1024])
@pytest.mark.parametrize("cfa_shape", [(1, 1), (1, 3), (2, 2), (4, 4), (6, 6), (8, 8)])
def test_no_layout_takes_more_local_memory_than_there_is(local_bytes, cfa_shape):
    """Of all lengths that a mosaic can have; each kernel's lines are of one direction alone."""
    for length in fft.LENGTHS:
        if length % cfa_shape[0] or length % cfa_shape[1]:
            continue
        lines = mosaic._lines(local_bytes, (length, length), cfa_shape)
        if lines is None:
            continue
        small, phases = (
            (length // cfa_shape[0], length // cfa_shape[1]),
            cfa_shape[0] * cfa_shape[1],
        )
        for of, count in (
            (length, lines[0]),
            (length, lines[1]),
            (small[1], lines[2]),
            (small[0], lines[3] * phases // 2),
        ):
            # every 16th place is left out where the length has many factors of two: where its last element is, by rule
            last = of - 1 + ((of - 1) // 16 if of % 128 == 0 else 0)
            assert 8 * count * (last + 1) <= fft.room(of, count) <= local_bytes, (length, of, count)


def test_passes_multiply_to_the_length():
    """Every length that is offered is a product of radices that there are transforms of, in as few as can be."""
    for length in fft.LENGTHS:
        radices = fft._radices(length)
        assert np.prod(radices) == length
        assert set(radices) <= {*fft.RADICES, 1}
    assert [len(fft._radices(length)) for length in (16, 240, 256, 2048, 1200, 4096, 1250)] == [
        1,
        2,
        2,
        3,
        3,
        3,
        4,
    ]


@pytest.mark.parametrize(
    "rows, cols",
    [
        (6, 80),
        (15, 192),  # radices 6, 10 8; 15, 16 12
        *(
            pytest.param(*size, marks=pytest.mark.slow)
            for size in (
                (1, 2),
                (2, 6),
                (16, 9),
                (48, 45),
                (250, 64),
                (36, 1200),
                (2048, 5),
                (5, 3),
                (4, 12),
            )
        ),
    ],
)
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


@pytest.mark.parametrize(
    "border", ["reflect", *(pytest.param(b, marks=pytest.mark.slow) for b in ("zero", "edge"))]
)
def test_borders_are_filled_in_as_the_stage_extends(border, device):
    """The same spectra as of planes extended first, with borders wider than the frame."""
    assert set(BORDERS) == {"zero", "edge", "reflect"}
    planes = device.array(np.random.default_rng(1).random((3, 5, 7), np.float32))
    extended = device.numpy(extend(device, planes, border, (17, 14), (40, 36), 1, 2)).astype(
        np.float64
    )
    spectra = device.numpy(fft.forward_extended(device, planes, 1, 2, border, (40, 36)))[:, :, :19]
    expected = np.fft.rfft2(extended)
    # as above, of the largest value: at most 8 passes of 4 sums, 6e-8 each
    assert np.abs(spectra @ (1, 1j) - expected).max() <= 2e-6 * np.abs(expected).max()


class Compiler:
    """Stands for a Warp CUDA device: compiles what is launched, for which no GPU is needed.

    use_ptx: stop before machine code, which alone says whether the kernel's memory and registers suffice. arch: its
    compute capability, times ten. The same kernel is compiled once.
    """

    kind, on_host, group_limit, local_bytes = "warp", False, 1024, 48 * 1024

    def __init__(self, folder, use_ptx, arch=90):
        self.folder, self.use_ptx, self.arch, self.compiled = folder, use_ptx, arch, {}

    def array(self, values, dtype=np.float32):
        return np.asarray(values, dtype)

    def empty(self, shape, dtype=np.float32):
        return np.broadcast_to(np.zeros((), dtype), shape)  # of no memory

    def launch(self, stage, kernel, grid, *args, defines, group):
        assert grid[0] % group[0] == 0  # whole groups: a barrier waits for all
        assert defines["LOCAL_BYTES"] <= self.local_bytes
        ranks = tuple(arg.ndim if isinstance(arg, np.ndarray) else None for arg in args)
        key = kernel, ranks, *sorted(defines.items())
        if key in self.compiled:
            return
        module = native_kernel(start_warp(), stage, kernel, defines, ranks).module
        module.options["block_dim"] = group[0]
        folder = self.folder / f"{kernel}{len(self.compiled)}"
        (self.compiled[key],) = start_warp().compile_aot_module(
            module, arch=self.arch, module_dir=folder, use_ptx=self.use_ptx
        )


def launch_all(device, shape, period, cfa=None):
    """Everything that a frame of `shape` launches, by lines of whole transforms and by planes."""
    planes, pattern = device.empty((2, *shape)), np.array([[0, 1], [1, 2]] if cfa is None else cfa)
    tables = device.empty((1, 2, period[0] // 2 + 1, period[1] // 2 + 1))
    lines = mosaic._lines(device.local_bytes, period, pattern.shape)
    if lines:
        mosaic._by_lines(
            device,
            planes,
            tables,
            np.ones((3, 2), np.float32),
            pattern,
            "edge",
            period,
            (1, 1),
            lines,
            device.empty(shape),
        )
    if fft.room(max(period)) <= device.local_bytes:
        fft.inverse(device, fft.forward_extended(device, planes, 0, 2, "edge", period), period[1])


def test_the_text_is_cuda_too(tmp_path):
    """Warp's compiler takes every kernel as it is launched on a CUDA device."""
    device = Compiler(tmp_path, use_ptx=True)
    launch_all(device, (5, 9), (8, 12))
    for (_, _, *defines), path in device.compiled.items():
        assert f".maxnreg {dict(defines)['REGISTERS']}" in path.read_bytes().decode(
            errors="replace"
        )
    assert {kernel for kernel, *_ in device.compiled} == {
        "columns_forward",
        "fold",
        "columns_inverse",
        "rows_forward",
        "columns",
        "rows_inverse",
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "length, mosaic_period",
    [
        # lines that fill local memory to the last 3 KB, one, two or four of them: Warp's share is more than is declared
        *(
            (length, 1 + (length % 4 == 0))
            for length in fft.LENGTHS
            if any(46 * 1024 < fft.room(length, lines) <= 48 * 1024 for lines in (1, 2, 4))
        ),
        (1200, 4),
        (2048, 2),
        (2304, 6),
        (4000, 8),
        (4096, 1),
        (3375, 3),
    ],
)
def test_every_layout_is_cuda_machine_code(length, mosaic_period, tmp_path):
    """What no GPU is needed to find out: the assembler refuses kernels that declare too much memory."""
    launch_all(
        Compiler(tmp_path, use_ptx=False),
        (length // 2, length // 2),
        (length, length),
        np.arange(mosaic_period**2).reshape(mosaic_period, mosaic_period) % 3,
    )


SIZES = [(96, 96), (640, 480), (1920, 1080), (3840, 2160), (5000, 31)]
CAMERAS = [
    ("phone", None),
    ("phone", "x-trans"),
    ("phone", "quad-bayer"),
    ("machine-vision", None),
    ("figure8", None),
    ("mono", None),
]
TOLERANCES = [None, 1e-3, 1e-4, 1e-5]


def planned(device, camera, tolerance):
    name, cfa = camera
    camera = gs.open_camera(name)
    if cfa:
        camera = replace(
            camera,
            sensor=replace(camera.sensor, cfa=MOSAICS[cfa]),
            processor=replace(camera.processor, demosaic="bilinear"),
        )
    return gs.Simulator(camera, device=device, tolerance=tolerance)


@pytest.fixture(scope="module")
def cuda(tmp_path_factory):
    return Compiler(tmp_path_factory.mktemp("cuda"), use_ptx=False)


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("tolerance", TOLERANCES)
def test_every_plan_is_cuda_machine_code(tolerance, camera, size, cuda):
    simulator = planned("warp:cpu", camera, tolerance)
    plan, pattern = simulator.plan(gs.chart("ramp", size=size)), simulator.camera.sensor.cfa_indices
    found = plan.find(Blur)
    if found is None:
        pytest.skip("a plan of tiles has no transforms of the whole frame")
    launch_all(
        cuda,
        plan.scene.samples,
        plan.period,
        pattern if found.folded else np.zeros((1, 1), np.int32),
    )


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("device", GPUS)
def test_every_plan_runs_on_a_gpu(device, camera, size):
    for tolerance in TOLERANCES:
        simulator = planned(device, camera, tolerance)
        mean = simulator.device.numpy(simulator.expose(gs.chart("ramp", size=size)).mean)
        assert mean.shape == size[::-1] and np.isfinite(mean).all(), tolerance

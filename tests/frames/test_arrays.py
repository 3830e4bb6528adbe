"""Arrays of devices seen by others, and arrays of others taken by devices."""

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import devices
import numpy as np
import pytest
from devices import ALL, ALL_KINDS, DEVICES, GPUS
from foreign_arrays import (
    CAMERA,
    LIGHT,
    SHAPE,
    WAVELENGTHS,
    ByDlpack,
    ByInterface,
    ByNumpy,
    Older,
    Tensor,
    address,
    aligned,
    cube,
    same_bits,
    scene,
)

import gpusim as gs
from gpusim.backends import open_device
from gpusim.backends.buffers import OpenCLArray
from gpusim.domain.errors import BadData
from gpusim.domain.memory import dlpack_kind, to_host, type_of
from gpusim.planner.facts import Facts

# ---- out


@pytest.mark.parametrize("device", ALL)
def test_what_the_api_gives_is_an_array_to_others(device):
    simulator = gs.Simulator(CAMERA, device=device)
    shown, device = scene(cube()), simulator.device
    exposure, loop = simulator.expose(shown), simulator.loop(shown)
    draws = exposure.raw(frames=3)
    for found, shape in (
        (loop.raw(), SHAPE),
        (loop.codes(), (*SHAPE, 3)),
        (exposure.raw(), SHAPE),
        (draws, (3, *SHAPE)),
        (exposure.codes(exposure.raw()), (*SHAPE, 3)),
        (exposure.develop(exposure.raw())[0], (3, *SHAPE)),
        (exposure.mean, SHAPE),
        (exposure.chip_mean, SHAPE),
        (next(simulator.stream([shown])), (*SHAPE, 3)),
        (next(simulator.stream([shown], "raw")), SHAPE),
    ):
        values = np.asarray(found)
        assert tuple(found.shape) == values.shape == shape and len(found) == shape[0]
        assert type_of(found) == values.dtype and values.dtype.kind in "fu"
        np.testing.assert_array_equal(values, device.numpy(found))
        assert address(found) == address(found) or not device.on_host  # a view each time
        assert values.any()
        for key in (
            0,
            -1,
            np.int64(1),
            slice(1, None),
            slice(0, 2),
            slice(2, 2),
            slice(None, None, 2),
            slice(None, None, -1),
            slice(-2, 99),
        ):
            np.testing.assert_array_equal(np.asarray(found[key]), values[key])
        for wrong in (shape[0], -shape[0] - 1):
            with pytest.raises(IndexError):
                found[wrong]
        assert sum(1 for _ in found) == shape[0]
    one = exposure.raw(first=1)
    same_bits(device, draws[1], one)
    same_bits(device, exposure.codes(draws[1]), exposure.codes(one))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize(
    ("shape", "dtype"),
    [((5, 7, 64), np.float32), ((9, 3), np.uint8), ((6, 5), np.uint16), ((4, 1, 3), np.float32)],
)
def test_parts_are_of_the_same_memory_where_that_can_be(device, shape, dtype):
    """Kernels take parts at any place as they take whole arrays; views live longer than what they are of."""
    device = open_device(device)
    values = np.arange(np.prod(shape)).reshape(shape).astype(dtype)
    whole = device.array(aligned(values), dtype)
    parts = [whole[k] for k in range(shape[0])] + [whole[k:][1:] for k in range(shape[0] - 1)]
    wanted = [*values, *(values[k:][1:] for k in range(shape[0] - 1))]
    begins = [k * values[0].nbytes for k in range(shape[0])]
    if device.on_host:
        step = 16 if isinstance(whole, OpenCLArray) else 1
        for part, begin in zip(parts, begins, strict=False):
            assert (address(part) == address(whole) + begin) == (begin % step == 0)
    del whole
    for part, its in zip(parts, wanted, strict=True):
        np.testing.assert_array_equal(np.asarray(part), its)
        if dtype == np.float32 and its.size:
            flat, out = device.reshape(part, (its.size,)), device.empty((its.size,))
            device.launch("common.copy", "copy", (its.size,), flat, out, its.size)
            np.testing.assert_array_equal(np.asarray(out), its.ravel())


@pytest.mark.parametrize("device", DEVICES)
def test_asarray_waits_and_converts(device):
    device = open_device(device)
    values = np.arange(2**20, dtype=np.float32)
    source = device.array(values)
    for _ in range(5):  # what is not waited for is not there yet
        target = device.empty(values.shape)
        device.launch("common.copy", "copy", values.shape, source, target, values.size)
        np.testing.assert_array_equal(np.asarray(target), values)
    np.testing.assert_array_equal(np.asarray(source, np.float64), values.astype(np.float64))
    copy = np.array(source)
    copy[...] = 0
    np.testing.assert_array_equal(np.asarray(source), values)
    if device.on_host:
        assert address(source) == np.asarray(source, copy=False).ctypes.data
        assert address(np.from_dlpack(source)) == address(source)
    with pytest.raises(ValueError):
        np.asarray(source, np.float64, copy=False)


def test_what_an_opencl_array_refuses():
    array = open_device("opencl").array(np.zeros((2, 3), np.float32))
    with pytest.raises(TypeError, match="first axis"):
        array[0, 1]
    assert "(2, 3)" in repr(array) and array.ndim == 2 and array.size == 6
    elsewhere = OpenCLArray(
        array.device, array.buffer, (2, 3), np.float32
    )  # as on a GPU: no memory of the host
    for ask in (
        elsewhere.__dlpack__,
        elsewhere.__dlpack_device__,
        lambda: np.from_dlpack(elsewhere),
    ):
        with pytest.raises(
            BufferError, match=r"cannot be shared: use np.asarray\(x\), or device warp"
        ):
            ask()
    with pytest.raises(ValueError, match="without a copy"):
        np.asarray(elsewhere, copy=False)
    np.testing.assert_array_equal(np.asarray(elsewhere), np.zeros((2, 3)))
    np.testing.assert_array_equal(np.asarray(elsewhere[1:], np.float64), np.zeros((1, 3)))


def test_a_warp_array_converts_in_cuda_memory_too():
    """NumPy calls `__array__` where there is no array interface; Warp's own refuses then."""
    array = open_device("warp:cpu").array(np.arange(6, dtype=np.float32).reshape(2, 3))
    for part, wanted in (
        (array, [[0, 1, 2], [3, 4, 5]]),
        (array[1], [3, 4, 5]),
        (array[0:1], [[0, 1, 2]]),
    ):
        np.testing.assert_array_equal(part.__array__(np.float64), np.array(wanted, float))
    np.testing.assert_array_equal(
        open_device("warp:cpu").reshape(array, (3, 2)).__array__(), [[0, 1], [2, 3], [4, 5]]
    )


# ---- in


@pytest.mark.parametrize("device", ALL)
@pytest.mark.parametrize("of", [ByDlpack, Tensor, ByNumpy])
def test_memory_of_the_host_is_used_where_it_is(device, of):
    device = open_device(device)
    values = aligned(cube(shape=(64, 64)))
    found = device.array(of(values))
    np.testing.assert_array_equal(np.asarray(found), values)
    assert (address(found) == address(values)) == device.on_host
    for other in (
        values.astype(np.float64),
        np.asfortranarray(values),
        values[:, ::2],
        values[..., 1:].astype(">f4"),
    ):
        found = device.array(of(other) if of is ByNumpy or other.dtype.isnative else ByNumpy(other))
        assert type_of(found) == np.float32
        np.testing.assert_array_equal(np.asarray(found), other.astype(np.float32))


@pytest.mark.parametrize("device", ALL)
def test_memory_that_may_not_be_written(device):
    values = aligned(cube(shape=(64, 64)))
    values.flags.writeable = False
    np.testing.assert_array_equal(np.asarray(open_device(device).array(values)), values)


@pytest.mark.parametrize("device", ALL)
@pytest.mark.parametrize("other", ALL)
def test_arrays_of_one_device_are_taken_by_others(device, other):
    device, values = open_device(device), aligned(cube(shape=(64, 64)))
    source = open_device(other).array(values)
    found = device.array(source)
    np.testing.assert_array_equal(np.asarray(found), values)
    assert (found is source) == (device.name == other)
    if device.on_host and open_device(other).on_host:
        assert address(found) == address(source) == address(values)
    np.testing.assert_array_equal(device.numpy(source), values)


@pytest.mark.parametrize("device", ALL)
def test_cuda_memory_is_copied_by_its_owner(device):
    device, values = open_device(device), cube()
    np.testing.assert_array_equal(
        np.asarray(device.array(Tensor(values, kind=10))), values
    )  # ROCm's
    if not device.name.startswith("warp:cuda"):
        np.testing.assert_array_equal(np.asarray(device.array(Tensor(values, kind=2))), values)


@pytest.mark.parametrize("device", [name for name in ALL if not name.startswith("warp:cuda")])
@pytest.mark.parametrize("of", [ByInterface, lambda: Older(cube(), kind=2)])
def test_memory_that_cannot_be_read_is_refused(device, of):
    device, values = open_device(device), of()
    for use in (device.array, device.numpy):
        with pytest.raises(
            BadData, match=f"^{device.name}: cannot read an array of .*warp:cuda:0$"
        ) as caught:
            use(values)
        assert "\n" not in str(caught.value)
    with pytest.raises(BadData, match="cannot read"):
        gs.Simulator(CAMERA, device=device).expose(scene(values))


def test_a_library_says_why_it_refuses():
    class Gradient(Tensor):
        def __dlpack__(self, **_):
            raise BufferError(
                "Can't export tensors that require gradient, use tensor.detach()\nand more"
            )

    with pytest.raises(BadData, match=r"require gradient, use tensor.detach\(\)\): give"):
        open_device("numpy").array(Gradient(cube()))


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(
    "of",
    [
        ByDlpack,
        Tensor,
        ByNumpy,
        lambda values: open_device("warp:cpu").array(values),
        lambda values: open_device("opencl").array(values),
    ],
    ids=["dlpack", "tensor", "array", "warp", "opencl"],
)
def test_scenes_of_foreign_samples(device, of):
    """The frame is that of the same values in NumPy, bit for bit: loops, streams, scenes with a margin."""
    first, second = aligned(cube(1)), aligned(cube(2))
    simulator = gs.Simulator(CAMERA, device=device)
    device = simulator.device
    loop = simulator.loop(scene(of(first)))
    for values in (first, second):
        wanted = gs.Simulator(CAMERA, device=device)(scene(values), seed=3)
        shown = scene(of(values))
        same_bits(device, loop.update(scene=shown).codes(seed=3), wanted.rgb)
        same_bits(device, next(simulator.stream([shown], "raw", seed=3)), wanted.raw)
        np.testing.assert_array_equal(
            np.asarray(simulator.expose(shown).mean, np.float32), wanted.mean
        )
        assert 100 < wanted.mean.mean() < 3000 and len(np.unique(wanted.raw)) > 100
    around = {"border": "scene", "margin": 4}
    same_bits(
        device,
        simulator.expose(scene(of(first), **around)).mean,
        simulator.expose(scene(first, **around)).mean,
    )


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(
    "of",
    [Tensor, lambda values: open_device("opencl").array(values, values.dtype)],
    ids=["tensor", "opencl"],
)
def test_all_forms_take_foreign_samples(device, of):
    random = np.random.default_rng(4)
    ids, shading = random.integers(0, 5, SHAPE).astype(np.uint16), random.random(SHAPE, np.float32)
    spectra = random.random((5, 7))
    simulator = gs.Simulator(CAMERA, device=device)
    for one, other in (
        (
            gs.Materials(WAVELENGTHS, of(ids), of(shading), spectra),
            gs.Materials(WAVELENGTHS, ids, shading, spectra),
        ),
        (
            gs.Materials(
                WAVELENGTHS, of(ids.astype(np.int64)), of(shading.astype(np.float16)), spectra
            ),
            gs.Materials(WAVELENGTHS, ids, shading.astype(np.float16).astype(np.float32), spectra),
        ),
        (
            gs.Basis(WAVELENGTHS, of(cube()[:5]), spectra),
            gs.Basis(WAVELENGTHS, cube()[:5], spectra),
        ),
        (gs.Cube(WAVELENGTHS, of(cube(dtype=np.float64))), gs.Cube(WAVELENGTHS, cube())),
    ):
        found, wanted = (
            simulator.expose(gs.Scene(content, LIGHT)).mean for content in (one, other)
        )
        same_bits(simulator.device, found, wanted)


@pytest.mark.parametrize("device", DEVICES)
def test_own_arrays_of_another_type_or_layout(device):
    simulator = gs.Simulator(CAMERA, device=device)
    device, values = simulator.device, cube()
    wanted = simulator.expose(scene(values)).mean
    same_bits(
        device,
        simulator.expose(scene(device.array(values.astype(np.float64), np.float64))).mean,
        wanted,
    )
    if device.kind == "warp":
        wide = device.array(np.repeat(values, 2, axis=2))
        assert not wide[:, :, ::2].is_contiguous
        same_bits(device, simulator.expose(scene(wide[:, :, ::2])).mean, wanted)


@pytest.mark.parametrize("of", [Tensor, ByDlpack])
def test_the_values_of_a_scene_are_those_of_its_memory(of):
    """A scene is what it was while it is one object; a new one of the same memory has what is there now."""
    values = aligned(cube())
    loop = gs.Simulator(CAMERA, device="opencl").loop(scene(of(values)))
    before = np.array(loop.raw())
    values *= np.float32(0.5)
    np.testing.assert_array_equal(np.asarray(loop.raw()), before)
    again = loop.update(scene=scene(of(values))).raw()
    np.testing.assert_array_equal(
        np.asarray(again), gs.Simulator(CAMERA, device="opencl")(scene(values.copy())).raw
    )


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (
            lambda: gs.Cube(WAVELENGTHS, Tensor(cube(), dtype="torch.bfloat16")),
            "values of type torch.bfloat16, wanted",
        ),
        (
            lambda: gs.Cube(WAVELENGTHS, ByInterface(typestr="<c8")),
            "values of type complex64, wanted float32",
        ),
        (lambda: gs.Cube(WAVELENGTHS, cube().astype(complex)), "values of type complex128"),
        (
            lambda: gs.Cube(WAVELENGTHS, ByInterface((7, 4))),
            r"cube of shape \(7, 4\), wanted \(7, rows, cols\)",
        ),
        (lambda: gs.Cube(WAVELENGTHS, ByInterface((7, 0, 4))), r"zero-size scene \(7, 0, 4\)"),
        (
            lambda: gs.Cube(WAVELENGTHS, cube().tolist()),
            "cube values: builtins.list, wanted an array",
        ),
        (
            lambda: gs.Materials(WAVELENGTHS, Tensor(cube()[0]), cube()[0], np.ones((2, 7))),
            "ids of type float32, wanted uint16",
        ),
    ],
    ids=["bfloat16", "complex", "complex NumPy", "flat", "empty", "list", "ids"],
)
def test_wrong_samples_are_refused_in_one_line(content, words):
    with pytest.raises(BadData, match=words) as caught:
        gs.Scene(content(), LIGHT)
    assert "\n" not in str(caught.value)


def test_values_of_foreign_samples_are_not_looked_at():
    wild = cube()
    wild[0, 0, 0] = np.nan
    for values in (Tensor(wild), open_device("warp:cpu").array(wild), ByInterface()):
        assert scene(values).shape == SHAPE
    with pytest.raises(BadData, match="NaN or infinite"):
        scene(wild)


def test_warp_is_told_of_cuda_memory_rightly(monkeypatch):
    """Without a CUDA device: what Warp is asked for, not what it makes of it."""
    import warp as wp

    host, calls = open_device("warp:cpu"), []

    class Cuda(type(host)):
        def __init__(self):
            vars(self).update(vars(host), is_gpu=True, on_host=False, name="warp:cuda:0")

        def sync(self):
            calls.append("sync")

    device, real = Cuda(), wp.array(cube(), dtype=wp.float32, device="cpu")

    class Spy:
        """Warp, as far as it is asked."""

        array = wp.array
        from_dlpack = staticmethod(lambda values: calls.append(("dlpack", values)) or real)
        dtype_from_numpy, dtype_to_numpy = (
            staticmethod(wp.dtype_from_numpy),
            staticmethod(wp.dtype_to_numpy),
        )
        synchronize_device = staticmethod(lambda of: calls.append("waited"))
        ScopedDevice = staticmethod(lambda of: calls.append(("on", of)) or nullcontext())

    monkeypatch.setattr(device, "_wp", Spy)
    tensor = Tensor(cube(), kind=2)
    # PyTorch exports tensors of its current device only
    assert device.array(tensor) is real and calls == [("on", "cuda:0"), ("dlpack", tensor)]

    class Made(wp.array):
        def __new__(cls, values, **options):
            calls.append((values, options))
            return real

    calls.clear()
    monkeypatch.setattr(Spy, "array", Made)
    values = ByInterface()
    assert device.array(values) is real
    assert calls == [
        "waited",
        (values, {"dtype": wp.float32, "device": host.wp_device, "copy": False}),
    ]
    calls.clear()
    device.array(ByInterface(stream=None))
    assert len(calls) == 1


@pytest.fixture
def apart():
    """An OpenCL device that keeps its memory to itself, as a GPU does."""
    return devices.apart(is_gpu=False)


def test_parts_of_memory_apart_from_the_host(apart):
    step = apart.cl_device.mem_base_addr_align // 8  # [byte] where sub-buffers may begin
    values = cube(shape=(8, step // 32))
    whole = apart.array(values)
    assert whole.host is None
    for key in (1, slice(2, 5), slice(None, None, 3), slice(None, None, -1), slice(3, 3)):
        np.testing.assert_array_equal(np.asarray(whole[key]), values[key])
    assert whole[1].region == (whole.buffer, step)
    assert whole[1:][1:][0].region == (whole.buffer, 2 * step)
    odd = apart.array(np.arange(12, dtype=np.uint8).reshape(4, 3), np.uint8)
    assert odd[1].region[0] is not odd.buffer  # a copy
    np.testing.assert_array_equal(np.asarray(odd[1:]), np.arange(3, 12).reshape(3, 3))
    part = whole[3]
    del whole
    np.testing.assert_array_equal(np.asarray(part), values[3])
    with pytest.raises(BufferError, match="cannot be shared"):
        np.from_dlpack(part)


def test_streams_of_foreign_samples_to_memory_apart(apart):
    """What is in host memory is sent while the frame before is computed; what changes its type gets other memory."""
    simulator = gs.Simulator(CAMERA, device=apart)
    scenes = [
        scene(of(cube(number, dtype)))
        for number, (of, dtype) in enumerate(
            [
                (np.array, np.float32),
                (Tensor, np.float16),
                (open_device("warp:cpu").array, np.float32),
                (lambda values: apart.array(values, values.dtype), np.float16),
                (Tensor, np.float32),
                (np.array, np.float16),
                (ByNumpy, np.float64),
            ]
        )
    ]
    for number, raw in enumerate(simulator.stream(scenes, "raw", seed=5)):
        wanted = gs.Simulator(CAMERA, device="opencl")(scenes[number], seed=5, first=number)
        np.testing.assert_array_equal(np.asarray(raw), wanted.raw)
    assert number == len(scenes) - 1


def test_facts_are_read_from_arrays_of_all_kinds():
    """What plans scenes without a device reads them, too: layers included."""
    values = cube()
    depth, alpha = np.full(SHAPE, 2.0), np.zeros(SHAPE)
    alpha[:, :20] = 1

    def layered(of):
        front = gs.Layer(gs.Cube(WAVELENGTHS, of(cube(2))), alpha, 1.0)
        return scene(of(values), depth=depth, layers=(front,))

    wanted = Facts.of(layered(lambda array: array)).content.values
    np.testing.assert_array_equal(Facts.of(layered(Tensor)).content.values, wanted)


def test_the_example_of_the_documentation_runs():
    text = (Path(__file__).parents[2] / "docs" / "python.md").read_text()
    names = {"gs": gs}
    exec(
        text.partition("## Arrays of others")[2].partition("```python\n")[2].partition("```")[0],
        names,
    )
    assert names["picture"].shape == names["codes"].shape == (480, 640, 3)
    assert names["picture"].std() > 10 and names["half"].content.values.dtype == np.float16
    assert names["again"].content.codes is names["codes"]


def test_kinds_of_memory():
    assert dlpack_kind(Tensor(cube(), kind=2)) == 2 and dlpack_kind(ByInterface()) is None
    assert to_host([1, 2], "test").tolist() == [1, 2]


@pytest.mark.parametrize(
    "device", [name for name in ALL if name not in GPUS or not name.startswith("warp")]
)
def test_streams_are_cudas_alone(device):
    with pytest.raises(BadData, match="has no CUDA streams; wanted device warp:cuda:0"):
        open_device(device).on_stream(0).__enter__()


@pytest.mark.skipif("warp:cuda:0" not in GPUS, reason="no CUDA device")
def test_work_is_in_turn_with_a_callers_stream(device="warp:cuda:0"):
    """A tensor is written late on a stream that nobody waits for; the frame reads what was written."""
    torch = pytest.importorskip("torch", reason="PyTorch is not installed")
    picture = gs.chart("deadleaves", size=(640, 480))
    bands = picture.content.bands_at(slice(None)).astype(np.float32)
    simulator = gs.Simulator(gs.open_camera("phone"), device=device, tolerance=1e-3)
    cube, late = torch.zeros(bands.shape, device="cuda"), torch.from_numpy(bands).cuda()
    scene = replace(picture, content=gs.Cube(picture.wavelengths, cube))
    loop = simulator.loop(replace(picture, content=gs.Cube(picture.wavelengths, late)), 0.01)
    wanted = np.array(simulator.device.numpy(loop.raw(seed=1)))
    busy = torch.randn(4096, 4096, device="cuda")
    torch.cuda.synchronize()
    for stream in (torch.cuda.Stream(), torch.cuda.default_stream()):
        cube.zero_()
        torch.cuda.synchronize()
        with torch.cuda.stream(stream):
            for _ in range(20):
                busy = torch.tanh(busy @ busy)
            cube.copy_(late)
            with simulator.device.on_stream(stream):
                raw = loop.update(scene=replace(scene, name=str(stream))).raw(seed=1)
            found = torch.from_dlpack(raw).clone().view(torch.int16)
        stream.synchronize()
        np.testing.assert_array_equal(found.cpu().numpy().view(np.uint16), wanted)
    with pytest.raises(BadData, match="CUDA stream: "), simulator.device.on_stream("first"):
        pass


@pytest.mark.parametrize("name", DEVICES)
def test_a_launch_without_work_is_no_work(name):
    """Also in a timed block."""
    device = open_device(name)
    nothing, out = device.empty((0, 4)), device.array(np.ones((2, 4), np.float32))
    with device.timed() as ms:
        device.launch("common.copy", "copy", (0,), nothing, out, 0)
    assert not ms and np.array_equal(device.numpy(out), np.ones((2, 4)))

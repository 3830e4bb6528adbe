"""What a frame takes of a device's memory is predicted within a tenth, and refused before anything is allocated."""

from dataclasses import replace

import numpy as np
import pytest
from cameras import PHONE, camera_with
from devices import apart

import gpusim as gs
from gpusim.backends.opencl import OpenCLDevice
from gpusim.backends.warp import WarpDevice
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.errors import DoesNotFit, OutOfMemory
from gpusim.domain.sensor import FLOAT_BITS

SIZE = (330, 250)
CODES = [
    "MEM_OBJECT_ALLOCATION_FAILURE",
    "OUT_OF_RESOURCES",
    "OUT_OF_HOST_MEMORY",
]  # of OpenCL's drivers
WARPS = [
    "Failed to allocate 4294967296 bytes on device 'cuda:0'",
    "Error launching kernel: k on device cuda:0: Warp CUDA error 2: out of memory",
]
MESSAGE = (
    r"^(opencl:\S+|warp:cpu) refused memory for {}: [^\n]*; it has [0-9.]+ GiB, which other processes may be "
    "using: close them, or use a smaller scene, fewer frames in a batch or another device$"
)

CAMERAS = {
    "phone": PHONE,
    **{name: gs.open_camera(name) for name in ("machine-vision", "mono", "figure8")},
    "stacked": camera_with(sensor={"stacked": True}),
    "best": camera_with(processor={"demosaic": "best"}),
    "learned": camera_with(processor={"demosaic": "learned"}),
    "x-trans": PHONE.with_(cfa="x-trans"),
    "rccb": PHONE.with_(cfa="rccb"),
    "network": camera_with(processor={"demosaic": "network"}),
    "corrected": camera_with(
        processor={"denoise": 1.0, "sharpen": 1.0, "shading": True, "defects": "detect"}
    ),
    "mosaic denoised": camera_with(processor={"denoise": 1.0, "denoise_by": "mosaic"}),
    "finished": replace(
        camera_with(processor={"look": "phone"}),
        optics=replace(PHONE.optics, distortion=RadialPolynomial(0.0, -0.05, 3e-4)),
    ),
    "no converter": camera_with(sensor={"bits": FLOAT_BITS}),
    "noise of every kind": camera_with(
        noise={
            "hot_pixels": 0.01,
            "hot_current": 10.0,
            "dsnu": 1.0,
            "telegraph_pixels": 0.01,
            "telegraph": 5.0,
            "row": 1.0,
        }
    ),
    "binned": camera_with(sensor={"binning": (2, 2), "binning_mode": "charge"}),
}


def counting(device):
    """The device, and a list of what it allocates from now on [byte]."""
    taken, allocate = [], device._allocate
    device._allocate = lambda nbytes: taken.append(nbytes) or allocate(nbytes)
    return taken


def scene_of(form):
    picture = gs.chart("deadleaves", size=SIZE)
    if form == "materials":
        return picture
    if form == "illuminated":
        rows, cols = picture.content.shape
        ramp = np.linspace(1, 100, cols, dtype=np.float32) * np.ones((rows, 1), np.float32)
        return gs.illuminate(picture, {"A": ramp, "D65": ramp[:, ::-1]})
    if form == "picture":
        return gs.picture(np.random.default_rng(1).integers(0, 256, (*SIZE[::-1], 3), np.uint8))
    bands = np.ascontiguousarray(picture.content.bands_at(slice(None)), np.float32)
    return replace(picture, content=gs.Cube(picture.wavelengths, bands.astype(form)))


FORMS = ["materials", np.float32, "picture", "illuminated"]
# every camera in front of one form, and every form in front of one camera; the other pairs are slow
PAIRS = [
    pytest.param(
        camera, form, marks=[pytest.mark.slow] * (camera != "phone" and form != "materials")
    )
    for camera in CAMERAS
    for form in FORMS
]


@pytest.mark.parametrize("tolerance", [pytest.param(None, marks=pytest.mark.slow), 4e-4])
@pytest.mark.parametrize(("camera", "form"), PAIRS)
def test_a_loops_memory_is_predicted(camera, tolerance, form):
    """Three frames of two scenes, on a device whose driver is asked for all of it; a tenth, and 100 kB of constants."""
    device, scene = apart(), scene_of(form)
    simulator = gs.Simulator(CAMERAS[camera], device=device, tolerance=tolerance)
    loop = simulator.loop(scene, 0.01)
    needed, taken = loop.plan.bytes_needed, counting(device)
    for seed, name in enumerate(("first", "first", "second")):
        loop.update(scene=replace(scene, name=name)).frame(seed=seed)
    assert abs(needed - sum(taken)) < 0.1 * sum(taken) + 1e5


def test_nothing_is_allocated_of_what_does_not_fit(monkeypatch):
    device, scene = apart(), scene_of("materials")
    simulator = gs.Simulator(PHONE, device=device, tolerance=4e-4)
    needed, taken = simulator.plan(scene).bytes_needed, counting(device)
    monkeypatch.setattr(OpenCLDevice, "memory", needed - 1)
    with pytest.raises(DoesNotFit, match="330x250"):
        simulator(scene)
    monkeypatch.setattr(OpenCLDevice, "memory", needed)
    monkeypatch.setattr(OpenCLDevice, "largest_array", 1000)
    with pytest.raises(DoesNotFit, match="one array of"):
        simulator(scene)
    assert sum(taken) < 1e5  # constants


class Driver:
    """pyopencl, but that it refuses kernels and buffers while it is told to, with this code."""

    def __init__(self, own):
        self.own, self.code = own, ""

    def __getattr__(self, name):
        def called(*args, **kwargs):
            if self.code:
                raise self.own.MemoryError(f"{name} failed: {self.code}")
            return given(*args, **kwargs)

        given = getattr(self.own, name)
        return called if name in ("enqueue_nd_range_kernel", "Buffer") else given


def refusing(code):
    """A device, and a function that says whether its driver refuses from now on."""
    if code not in WARPS:
        device = apart()
        device._cl = driver = Driver(device._cl)
        return device, lambda is_on: setattr(driver, "code", code if is_on else "")
    device, told = WarpDevice("cpu", "warp:cpu"), [False]

    def refusable(given):
        def called(*args, **kwargs):
            if told[-1]:
                raise RuntimeError(code)
            return given(*args, **kwargs)

        return called

    device._timed, device._empty = refusable(device._timed), refusable(device._empty)
    return device, told.append


@pytest.mark.parametrize("code", [*CODES, *WARPS])
def test_memory_that_a_driver_refuses(code):
    """One line: for what, how much, what the device has, what to do; the program goes on when there is some.

    Of a new loop the scene's array is refused, or its first kernel; of one that goes on a kernel that was noted.
    """
    device, refuse = refusing(code)
    simulator = gs.Simulator(PHONE, device=device, tolerance=4e-4)
    loop = simulator.loop(scene_of(np.float32), 0.01)
    wanted = [np.array(device.numpy(loop.raw(seed=seed))) for seed in (1, 2)]
    new = simulator.loop(scene_of(np.float32), 0.01)
    first = r"(a kernel of [a-z.]+|a copy of an array|an array of \S+ float32)"
    for again, what in ((loop, "a kernel of sensor.noise"), (new, first)):
        refuse(True)
        with pytest.raises(
            OutOfMemory, match=MESSAGE.format(rf"{what} \([0-9.e-]+ GiB\)")
        ) as caught:
            again.raw(seed=1)
        refuse(False)
        assert code in str(caught.value)
        for seed in (1, 2):
            np.testing.assert_array_equal(device.numpy(again.raw(seed=seed)), wanted[seed - 1])
    refuse(True)
    with pytest.raises(
        OutOfMemory, match=MESSAGE.format(r"an array of 1024x1024x1024 float32 \(4 GiB\)")
    ):
        device.empty((1024, 1024, 1024))


def test_another_error_of_a_driver_stays_what_it_is():
    device, refuse = refusing("INVALID_VALUE")
    refuse(True)
    with pytest.raises(device._cl.Error, match="INVALID_VALUE"):
        device.empty((3, 4))

"""Arrays as other libraries give them, by one protocol each, and scenes of them."""

from dataclasses import replace

import numpy as np
from lights import as_photons

import gpusim as gs
from gpusim.domain.memory import READ_BY_HOST

WAVELENGTHS = np.linspace(420.0, 680.0, 7)
CAMERA = gs.open_camera("phone")
CAMERA = replace(CAMERA, sensor=replace(CAMERA.sensor, exposure_time=0.01))
METERED = replace(CAMERA, sensor=replace(CAMERA.sensor, exposure_time=None))
SHAPE = (48, 64)
LIGHT = as_photons("D65")
LIGHT = replace(LIGHT, values=3e14 * LIGHT.values)  # some hundred electrons


class ByDlpack:
    """What a library's array says by DLPack alone, of a kind of memory."""

    def __init__(self, values, kind=1):
        self.values, self.kind = values, kind

    def __dlpack_device__(self):
        return self.kind, 0

    def __dlpack__(self, *, stream=None, max_version=None, dl_device=None, copy=None):
        if self.kind not in READ_BY_HOST and dl_device != (1, 0):
            raise BufferError("not in host memory")
        return self.values.__dlpack__()


class Tensor(ByDlpack):
    """With a shape, and a type that is not NumPy's."""

    def __init__(self, values, kind=1, dtype=None):
        super().__init__(values, kind)
        self.shape, self.dtype = values.shape, dtype or f"torch.{values.dtype}"


class Older(Tensor):
    """Whose library copies nothing to the host by DLPack."""

    def __dlpack__(self, stream=None):
        return self.values.__dlpack__()  # a capsule of the wrong memory: nobody may get as far


class ByInterface:
    """An array in CUDA memory: nothing here may read it."""

    def __init__(self, shape=(7, *SHAPE), typestr="<f4", stream=1):
        self.__cuda_array_interface__ = {
            "shape": shape,
            "typestr": typestr,
            "data": (4096, False),
            "version": 3,
            "strides": None,
            "stream": stream,
        }


class ByNumpy:
    def __init__(self, values):
        self.values = values

    def __array__(self, dtype=None, copy=None):
        return np.array(self.values, dtype, copy=copy)


def cube(seed=1, dtype=np.float32, shape=SHAPE):
    random = np.random.default_rng(seed)
    return (random.random((7, *shape)) * 10.0 ** random.uniform(-2, 0, shape)).astype(dtype)


def scene(values, **options):
    return gs.Scene(gs.Cube(WAVELENGTHS, values), LIGHT, **options)


def address(array):
    """Where an array in host memory begins."""
    return np.asarray(array).ctypes.data


def aligned(values):
    """A copy that begins at a page."""
    store = np.empty(values.nbytes + 4096, np.uint8)
    start = -store.ctypes.data % 4096
    copy = store[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy


def same_bits(device, one, other):
    np.testing.assert_array_equal(np.array(device.numpy(one)), np.array(device.numpy(other)))

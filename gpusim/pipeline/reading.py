"""A content's samples on a device: how they come there, planes of them, and what of them the host reads."""

from dataclasses import replace
from math import prod

import numpy as np

from gpusim.backends import Device
from gpusim.domain.content import Basis, Content, Materials, Picture, is_seen
from gpusim.domain.foreign import type_of
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.scene import Scene
from gpusim.kernels.spectral.decode import decode
from gpusim.kernels.spectral.illuminate import illuminate
from gpusim.kernels.spectral.integrate import integrate
from gpusim.kernels.spectral.materials import materials
from gpusim.kernels.spectral.take import take
from gpusim.optics.fusion import row_pairs
from gpusim.planner.facts import OnHost
from gpusim.planner.plan import Plan
from gpusim.planner.probes import COUNT, SIDE

WHOLE = (slice(None), slice(None))
LARGE = 2**26  # [byte] of a scene in host memory that the device looks at sooner than the host


def is_read_on_device(device: Device, scene: Scene) -> bool:
    """Whether a device looks at a scene for the planner: one that is there, or large; else the host does.

    Of memory that a device shares with the host NumPy reads float32 in order as fast, and anything else slowly.
    """
    content = scene.content
    if scene.depth is not None or device.kind == "numpy":
        return False
    arrays = [getattr(content, name) for name in content.samples]
    if not all(isinstance(array, np.ndarray) for array in arrays):
        return True
    if device.on_host and all(
        is_seen(array) and array.dtype == np.float32 and array.flags.c_contiguous
        for array in arrays
    ):
        return False
    return LARGE <= content.nbytes <= device.largest_array


def bytes_read_on_device(plan: Plan, device: Device) -> int:
    """Return the memory of what the planner reads of a scene on a device before the frame [byte].

    That is its brightness, windows and rows of it. Probes of later scenes look at other windows.
    """
    if not is_read_on_device(device, plan.scene):
        return 0
    rows, cols = plan.content.shape
    windows = COUNT * SIDE**2 if plan.tolerance is not None else 0
    entries = sum(prod(getattr(plan.content, name).shape) for name in plan.content.samples) // (
        rows * cols
    )
    times = 1 if plan.watch is None else 2
    return 4 * (rows * cols + entries * (times * windows + 2 * cols * len(row_pairs(rows, cols))))


def store(device: Device, content: Content, window=WHOLE, curve=None):
    """A content's samples on a device, in a window if they come from the host: entries, and which each has, or None.

    curve: the device's array of a picture's curve, where there is one.
    """

    def cut(name):
        array, index = (
            getattr(content, name),
            window if isinstance(content, Picture) else (..., *window),
        )
        return device.samples(
            array[index] if isinstance(array, np.ndarray) else array, content.stored_type(name)
        )

    if isinstance(content, Picture):
        return decode(
            cut("codes"), device.array(content.curve) if curve is None else curve, device=device
        ), None
    if isinstance(content, Illuminated):
        return illuminate(cut("maps"), cut("coefficients"), device=device), None
    *labels, entries = [cut(name) for name in content.samples]
    return entries, labels[0] if labels else None


def planes(device: Device, table, stored):
    """Planes of stored samples by a table (planes, entries); the entries themselves, float32, if None."""
    entries, ids = stored
    if ids is not None:
        return materials(ids, entries, device.array(table), device=device)
    if table is None:
        is_half = type_of(entries) == np.float16
        return device.reshape(take(entries, device=device), entries.shape) if is_half else entries
    return integrate(entries, device.array(table), device=device)


class Reading:
    """What the host reads of a content. Of one on a device these are windows and sums alone, which are made there.

    content: its arrays of samples may be the device's or another library's. stored: what `store` gave of the whole of
    it, which is then read; by default that is done here, unless all samples are in host memory: NumPy reads those.
    """

    def __init__(self, device: Device, content: Content, stored=None):
        self.device, self.content = device, content
        if stored is None and not all(
            isinstance(getattr(content, name), np.ndarray) for name in content.samples
        ):
            stored = store(device, content)
        self._stored = stored

    def rows(self, chosen) -> Content:
        """Whole rows of the samples, int (n,), clipped to the frame, in host memory: see `windows`."""
        if self._stored is None:
            return OnHost(self.content).rows(np.clip(chosen, 0, self.content.shape[0] - 1))
        return self._read(
            lambda samples, dtype: self._take(samples, dtype, chosen[None])[..., 0, :, :]
        )

    def windows(self, rows, cols) -> Content:
        """Windows of the samples in host memory: content whose arrays have the shape (..., n, h, w).

        rows: int, shape (n, h). cols: int, shape (n, w). Both are clipped to the frame. Of a picture, and in light
        that varies, it is a Basis of what it was decoded to, or of the products; samples of float16 that come from a
        device are float32 of the same values.
        """
        if self._stored is None:
            height, width = self.content.shape
            return OnHost(self.content).windows(
                np.clip(rows, 0, height - 1), np.clip(cols, 0, width - 1)
            )
        return self._read(lambda samples, dtype: self._take(samples, dtype, rows, cols))

    def _read(self, taken):
        """Content of what a function takes of stored samples, as this type."""
        content, (entries, ids) = self.content, self._stored
        light = taken(entries, np.float32)
        if isinstance(content, Materials):
            return replace(content, ids=taken(ids, np.uint16), shading=light)
        if isinstance(content, Picture | Illuminated):
            return Basis(content.wavelengths, light, content.entry_spectra)
        return content.with_planes(light)

    def _take(self, samples, dtype, rows, cols=None):
        """Windows of stored samples as a new array of the host."""
        return np.moveaxis(
            np.array(self.device.numpy(take(samples, rows, cols, device=self.device)), dtype), 0, -3
        )

    def whole(self) -> Content:
        """All samples, in host memory; of a picture its codes. Raises BadData."""

        def read(array):
            values = np.asarray(self.device.numpy(array))
            return (
                values.astype(np.float32) if values.dtype == np.float16 else values
            )  # NumPy is slow with halves

        return self.content.with_samples(read)

    def brightness(self, total) -> np.ndarray:
        """Sums over wavelength by `total` (L,), such as the sum of all channels: float32 (rows, cols), a new array."""
        if self._stored is None:
            return self.content.brightness(total)
        table = np.asarray(total @ self.content.entry_spectra.T)[None]
        return np.array(self.device.numpy(planes(self.device, table, self._stored))[0], np.float32)

"""A content's samples on a device: how they are stored, made into planes, and read by the host."""

from dataclasses import replace
from math import prod

import numpy as np

from gpusim.backends import Device
from gpusim.backends.tape import recording
from gpusim.domain.content import Basis, Content, Materials, Picture, is_seen
from gpusim.domain.illuminated import Illuminated
from gpusim.domain.memory import type_of
from gpusim.domain.scene import Scene
from gpusim.kernels.optics.blur import blur_windows
from gpusim.kernels.spectral.decode import decode
from gpusim.kernels.spectral.illuminate import illuminate
from gpusim.kernels.spectral.integrate import integrate
from gpusim.kernels.spectral.materials import materials
from gpusim.kernels.spectral.survey import MOST, survey
from gpusim.kernels.spectral.take import take
from gpusim.optics.fusion import EXPONENT, Watch, row_pairs
from gpusim.planner.facts import OnHost
from gpusim.planner.plan import Plan
from gpusim.planner.probes import COUNT, SIDE

WHOLE = (slice(None), slice(None))
LARGE = 2**26  # size from which a device reads a scene faster than the host [byte]


def is_read_on_device(device: Device, scene: Scene) -> bool:
    """Return True if a device computes a scene's facts: the scene is there already, or large. Otherwise the host does.

    In memory that device and host share, NumPy reads contiguous float32 equally fast, and other types slowly.
    """
    content = scene.content
    if scene.depth is not None or device.kind == "numpy":
        return False
    is_fast = device.on_host  # for NumPy
    for name in content.samples:
        array = getattr(content, name)
        if not isinstance(array, np.ndarray):
            return True
        is_float = array.dtype == np.float32 and array.flags.c_contiguous
        is_fast = is_fast and is_float and is_seen(array)
    return not is_fast and LARGE <= content.nbytes <= device.largest_array


# planes of sums over wavelength that the planner reads
SUMS_OF_WINDOWS, SUMS_OF_ROWS = 40, 8


def bytes_read_on_device(plan: Plan, device: Device) -> int:
    """Return the device memory that the planner uses to read a scene before the frame [byte].

    It reads the scene's brightness, windows and rows. Probes of later scenes read theirs.
    """
    if not is_read_on_device(device, plan.scene):
        return 0
    rows, cols = plan.content.shape
    windows = COUNT * SIDE**2 if plan.tolerance is not None else 0
    entries = sum(prod(getattr(plan.content, name).shape) for name in plan.content.samples) // (
        rows * cols
    )
    times = 2 if plan.find(Watch) else 1
    bands = len(plan.content.wavelengths)
    # windows as they are taken, by wavelength, and with their surroundings for transforms
    planes_of_windows = 2 * bands + (0 if plan.content.is_spectral else entries)
    in_rows = 2 * cols * len(row_pairs(rows, cols)) * (entries + SUMS_OF_ROWS)
    floats = rows * cols + windows * planes_of_windows + in_rows
    # the rows of a probe are taken twice
    return 4 * (times * floats + windows * SUMS_OF_WINDOWS + in_rows)


def store(device: Device, content: Content, window=WHOLE, curve=None):
    """Return a content's samples on a device, those from the host cut to a window.

    curve: a picture's curve as a device array, if it is there already.

    Returns:
        Entries, and the label of each sample or None.
    """

    def cut(name):
        array = getattr(content, name)
        index = window if isinstance(content, Picture) else (..., *window)
        return device.samples(
            array[index] if isinstance(array, np.ndarray) else array, content.stored_type(name)
        )

    if isinstance(content, Picture):
        return decode(
            cut("codes"), device.array(content.curve) if curve is None else curve, device=device
        ), None
    if isinstance(content, Illuminated):
        return illuminate(cut("maps"), cut("coefficients"), device=device), None
    *labels, entries = map(cut, content.samples)
    return entries, labels[0] if labels else None


def planes(device: Device, table, stored):
    """Return planes of stored samples by a table (planes, entries); the entries, float32, if it is None."""
    entries, ids = stored
    if ids is not None:
        return materials(ids, entries, device.array(table), device=device)
    if table is None:
        is_half = type_of(entries) == np.float16
        return device.reshape(take(entries, device=device), entries.shape) if is_half else entries
    return integrate(entries, device.array(table), device=device)


class Reading:
    """Reads a content for the host. From a device it reads only windows and sums, which are computed there.

    Args:
        device: The device.
        content: The content. Its arrays may belong to the device or to another library.
        stored: Result of `store` for the whole content. None stores it, unless all samples are in host memory, where
            NumPy reads them.
    """

    def __init__(self, device: Device, content: Content, stored=None):
        self.device, self.content = device, content
        if stored is None and not all(
            isinstance(getattr(content, name), np.ndarray) for name in content.samples
        ):
            stored = store(device, content)
        self._stored = stored
        self._is_with_host = stored is None or device.kind == "numpy"

    def rows(self, chosen) -> Content:
        """Return whole rows of the samples in host memory. chosen: int (n,), clipped to the frame. See `windows`."""
        if self._stored is None:
            return OnHost(self.content).rows(np.clip(chosen, 0, self.content.shape[0] - 1))
        return self._read(
            lambda samples, dtype: self._take(samples, dtype, chosen[None])[..., 0, :, :]
        )

    def windows(self, rows, cols) -> Content:
        """Return windows of the samples in host memory: content with arrays of the shape (..., n, h, w).

        A picture, or a scene in light that varies, becomes a Basis. Samples of float16 from a device become float32.

        Args:
            rows: Rows of each window, int (n, h), clipped to the frame.
            cols: Columns of each window, int (n, w), clipped to the frame.
        """
        if self._stored is None:
            height, width = self.content.shape
            return OnHost(self.content).windows(
                np.clip(rows, 0, height - 1), np.clip(cols, 0, width - 1)
            )
        return self._read(lambda samples, dtype: self._take(samples, dtype, rows, cols))

    def mix(self, chosen, table) -> np.ndarray | None:
        """Return sums of entries by a table in whole rows, float32 (P, n, cols); None if the host has the samples.

        Args:
            chosen: The rows, int (n,), clipped to the frame.
            table: The weights, shape (P, entries).
        """
        if self._is_with_host:
            return None
        device, (entries, ids) = self.device, self._stored
        rows = take(entries, chosen[None], device=device)
        numbers = None if ids is None else take(ids, chosen[None], device=device)
        rows = device.reshape(rows, rows.shape[1:])
        numbers = None if numbers is None else device.reshape(numbers, numbers.shape[1:])
        return self._own(planes(device, table, (rows, numbers)), np.float32)

    def squares(self, upper, level: float) -> tuple[np.ndarray, np.ndarray] | None:
        """Return mean squares of each wavelength in rows, and of its differences to the neighbours below and right.

        Args:
            upper: The rows, int (n,).
            level: About the root of such a square: float32 holds squares of 1e-19 to 1e19 times that.

        Returns:
            Two arrays, float64 (n, L), or None if the samples are in host memory.
        """
        if self._is_with_host:
            return None
        entries, ids = self._stored
        unit = 2.0 ** -float(np.clip(np.frexp(level)[1], -EXPONENT, EXPONENT))
        table, found = self.content.entry_spectra.T, []
        for first in range(0, len(table), MOST):
            some = table[first : first + MOST]
            each = survey(entries, some, upper, ids, scale=(unit, unit), device=self.device)
            found.append(np.asarray(self.device.numpy(each), np.float64)[..., :-1])
        values, across, down = np.moveaxis(np.concatenate(found, axis=2) / unit**2, 1, 0)
        return values, across + down

    def taken(self, rows, cols) -> "TakenOnDevice | None":
        """Return windows of the samples on the device, or None if the samples are in host memory.

        Args:
            rows: Rows of each window, int (n, h), clipped to the frame.
            cols: Columns of each window, int (n, w), clipped to the frame.
        """
        if self._is_with_host:
            return None
        return TakenOnDevice(self.device, self.content, self._stored, rows, cols)

    def _read(self, taken):
        """Return a content of this type from the samples that a function takes."""
        content, (entries, ids) = self.content, self._stored
        light = taken(entries, np.float32)
        if isinstance(content, Materials):
            return replace(content, ids=taken(ids, np.uint16), shading=light)
        if isinstance(content, Picture | Illuminated):
            return Basis(content.wavelengths, light, content.entry_spectra)
        return content.with_planes(light)

    def _take(self, samples, dtype, rows, cols=None):
        """Return windows of stored samples as a new NumPy array."""
        taken = take(samples, rows, cols, device=self.device)
        return np.moveaxis(self._own(taken, dtype), 0, -3)

    def _own(self, array, dtype):
        """Return the values of a device array, which nothing else writes to."""
        return np.array(self.device.numpy(array), dtype, copy=self.device.on_host or None)

    def whole(self) -> Content:
        """Return the content in host memory; a picture keeps its codes. Raises BadData."""

        def read(array):
            values = np.asarray(self.device.numpy(array))
            # NumPy is slow with float16
            return values.astype(np.float32) if values.dtype == np.float16 else values

        return self.content.with_samples(read)

    def brightness(self, total) -> np.ndarray:
        """Return sums over wavelength with weights `total` (L,), a new float32 array (rows, cols)."""
        if self._stored is None:
            return self.content.brightness(total)
        table = np.asarray(total @ self.content.entry_spectra.T)[None]
        return self._own(planes(self.device, table, self._stored), np.float32)[0]


class TakenOnDevice:
    """Windows of a content on a device, below one another.

    Args:
        device: The device.
        content: The content.
        stored: Result of `store` for the whole content.
        rows: Rows of each window, int (n, h), clipped to the frame.
        cols: Columns of each window, int (n, w), clipped to the frame.
    """

    def __init__(self, device: Device, content: Content, stored, rows, cols):
        self._device, self._spectra = device, content.entry_spectra
        self._shape = len(rows), rows.shape[1], cols.shape[1]
        height, width = content.shape
        at = np.clip(rows, 0, height - 1)[:, :, None] * width + np.clip(cols, 0, width - 1)[:, None]
        places = np.zeros((1, 1), np.int32), at.astype(np.int32).reshape(1, -1)

        def gather(samples):  # of one long row: all windows at once
            line = device.reshape(samples, (*samples.shape[:-2], 1, height * width))
            return take(line, *places, device=device)

        entries, ids = stored
        self._is_spectral = content.is_spectral
        shape = len(rows) * rows.shape[1], cols.shape[1]
        number = entries.shape[:-2] if ids is None else ()
        with recording(
            None
        ):  # they are read later: a computation that is made again must not overwrite them
            self._stored = (
                device.reshape(gather(entries), (*number, *shape)),
                None if ids is None else device.reshape(gather(ids), shape),
            )

    def sum(self, weights) -> np.ndarray:
        """Return sums over wavelength by `weights` (P, L), float32 (n, P, h, w), which later sums may overwrite."""
        return self._numpy(planes(self._device, weights @ self._spectra.T, self._stored))

    def blur(self, tables, mix) -> np.ndarray:
        """Return sums by `mix` (C, L) of the wavelengths behind transfer functions, as `sum`.

        tables: (L, h, w // 2 + 1). A window repeats itself.
        """
        table = None if self._is_spectral else self._spectra.T
        light = planes(self._device, table, self._stored)
        light = self._device.reshape(light, (len(tables), *self._shape))
        return self._numpy(blur_windows(light, tables, mix, self._device))

    def _numpy(self, array):
        values = np.asarray(self._device.numpy(array))
        return values.reshape(len(values), *self._shape).swapaxes(0, 1)

"""Frames of batches of pictures, as tensors, for machine learning.

Not differentiable: noise is drawn and values are rounded, so no gradient passes through a frame.
"""

import sys
from collections import OrderedDict
from math import prod
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gpusim.backends import Device
from gpusim.data.lights import illuminant, white_radiance
from gpusim.data.srgb import srgb_primaries
from gpusim.domain.account import Tolerance
from gpusim.domain.camera import Camera
from gpusim.domain.content import Basis, Content, Cube
from gpusim.domain.errors import BadData, OutOfRange, checked_count
from gpusim.domain.memory import describe_array, to_host, type_of
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.short_repr import shorten_repr
from gpusim.io.scene.scenes import LIGHT, LUMINANCE
from gpusim.pipeline.batch import one_each
from gpusim.pipeline.loop import Capture
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan

SHAPES = 4  # of batches whose loops are cached
GREY = 0.18  # reflectance of the scene for which a plan is made
LIBRARIES = ("torch", "cupy")  # whose arrays are returned on the device of the input
PICTURES = ("linear", "xyz", "codes")  # outputs with channels: RGB or XYZ


class PictureBatch:
    """Computes frames of batches of pictures by a camera on a device. Not differentiable.

    Channels come first in input and output, (B, C, rows, cols). A frame depends only on its
    picture, its settings, its number, the seed and the plan, not on the rest of its batch, so any
    number of workers makes the same data.

    Args:
        camera: Camera.
        device: Name of the device, or a Device.
        output: Name of `gpusim.pipeline.loop.OUTPUTS`, for example "raw", "linear" or "codes".
        wavelengths: Wavelengths of the channels [nm], shape (L,). None: linear sRGB (3 channels) or
            grey (1).
        light: Light of `illuminant` in which the pictures are reflectances, white 1. None: spectral
            pictures are radiance [W sr-1 m-2 nm-1].
        luminance: Luminance of white in this light [cd m-2].
        tolerance: See `Simulator`. With one, each picture is planned, which takes time; without
            one, each shape.
        plan: Plan of all pictures, see `Simulator`.
        capture: Capture of each picture, see `gpusim.captures`. The frames of a capture that is not
            merged are on the axis after the pictures.
        options: Options of every Scene, for example border.

    Attributes:
        plans: Plan of each picture of the last call.

    Raises:
        BadData, OutOfRange: If the light or the wavelengths are wrong.
        GpusimError: As `Simulator` does.
    """

    def __init__(
        self,
        camera: Camera,
        *,
        device: Device | str = "auto",
        output: str = "raw",
        wavelengths: ArrayLike | None = None,
        light: str | None = LIGHT,
        luminance: float = LUMINANCE,
        tolerance: Tolerance | str | None = None,
        plan: Plan | None = None,
        capture: Capture | None = None,
        **options: Any,
    ):
        self.simulator = Simulator(camera, device=device, tolerance=tolerance)
        self.simulator.batch(1, output)  # refuses an unknown output
        self.output, self._options, self._plan = output, options, plan
        self._capture = capture
        self.plans: list[Plan] = []
        self.wavelengths = None if wavelengths is None else np.asarray(wavelengths, np.float64)
        if light is not None:
            self._light = white_radiance(illuminant(light), luminance)
        elif self.wavelengths is None:
            raise OutOfRange("light", None, "a name, for linear sRGB, which is of reflectances")
        else:
            self._light = unit_light(self.wavelengths)
        self._batches: OrderedDict = OrderedDict()

    def __repr__(self):
        return shorten_repr(f"PictureBatch({self.output}, {self.simulator!r})")

    def __call__(
        self,
        pictures: Any,
        *,
        first: Any = 0,
        seed: Any = 0,
        exposure_time: Any = None,
        gain: Any = 1.0,
        camera: Any = None,
    ) -> Any:
        """Return frames of pictures. Automatic exposure meters each picture.

        Args:
            pictures: Array (B, C, rows, cols) of NumPy, torch, cupy or Warp: floats, 0 or more.
            first: Number of the first picture among all, or one number for each picture. With the
                seed it selects the noise.
            seed: Seed of the noise, or one for each picture.
            exposure_time: Exposure time [s], see `Simulator.expose`, or one for each picture.
            gain: Analog gain, see `Simulator.expose`, or one for each picture.
            camera: Camera with other noise, white point, lens or other settings, or one for each
                picture.

        Returns:
            A new array (B, rows, cols) or (B, C, rows, cols): torch's or cupy's on the device of
            the pictures, or in the memory of a Warp device; else NumPy's. Codes are (B, 3, rows,
            cols) with the channels last in memory.

        Raises:
            BadData: If the pictures have another shape or type, or negative values.
            GpusimError: As `Simulator.frames` does.
        """
        values = describe_array(pictures, "pictures")
        shape = tuple(values.shape)
        channels = (1, 3) if self.wavelengths is None else (len(self.wavelengths),)
        if len(shape) != 4 or 0 in shape or shape[1] not in channels:
            raise BadData(
                f"pictures: {shape}, wanted (pictures, channels, rows, cols), "
                f"{' or '.join(map(str, channels))} channels"
            )
        if type_of(values) not in (np.float16, np.float32, np.float64):
            why = f"pictures: values of type {values.dtype}, wanted floats: linear light, not codes"
            raise BadData(why)
        # Warp arrays are not read on the host
        lowest = values.min().item() if hasattr(values, "min") else 0
        if not lowest >= 0:
            found = "negative light" if lowest < 0 else "NaN"
            raise BadData(f"pictures: {found} (lowest {lowest:.4g}), wanted 0 or more")
        scenes = [self._scene(values[item]) for item in range(shape[0])]
        settings = {
            "camera": camera,
            "exposure_time": _as_numbers(exposure_time),
            "gain": _as_numbers(gain),
        }
        if self.simulator.tolerance is None or self._plan is not None:
            batch = self._batch(shape)
            frames = batch(scenes, seed=_as_numbers(seed), first=self._firsts(first), **settings)
            self.plans = batch.plans
            return self._return_frames(pictures, frames)
        firsts = self._firsts(first)
        if isinstance(firsts, int):
            step = 1 if self._capture is None else self._capture.count
            firsts = [firsts + item * step for item in range(len(scenes))]
        settings |= {"first": firsts, "seed": _as_numbers(seed)}
        each = {name: one_each(name, value, len(scenes)) for name, value in settings.items()}
        capture, frames = self._capture, []
        batches = [self.simulator.batch(1, self.output, capture=capture) for _ in scenes]
        for item, (batch, scene) in enumerate(zip(batches, scenes, strict=True)):
            own = {name: given[item] for name, given in each.items()}
            one = batch(scene, **own)
            frames.append(np.array(self.simulator.device.numpy(one)))
        self.plans = [batch.plans[0] for batch in batches]
        return self._return_frames(pictures, np.concatenate(frames))

    def _firsts(self, first) -> int | list[int]:
        """Return the number of the first frame, or of each picture's first frame."""
        numbers = _as_numbers(first)
        if np.iterable(numbers):
            return [checked_count("first", one, 0) for one in numbers]
        return checked_count("first", numbers, 0)

    def _return_frames(self, pictures, frames):
        """Return frames as an array of the pictures' library."""
        made = _convert(pictures, self.simulator.device, frames)
        if self._capture is not None and self._capture.has_frames:
            made = made.reshape(len(self.plans), -1, *made.shape[1:])
        return move_axis(made, -1, -3) if self.output == "codes" else made

    def _scene(self, values) -> Scene:
        """Return the scene of a picture."""
        content: Content
        if self.wavelengths is not None:
            content = Cube(self.wavelengths, values)
        else:
            primaries = srgb_primaries()
            spectra = primaries.values
            if values.shape[0] != 3:  # grey
                spectra = np.ones((1, len(primaries.wavelengths)))
            content = Basis(primaries.wavelengths, values, spectra)
        return Scene(content, self._light, name="picture", **self._options)

    def _batch(self, shape):
        """Return the loops for batches of this shape; the last SHAPES of them are cached."""
        if shape not in self._batches:
            grey = self._scene(np.full(shape[1:], GREY, np.float32))
            self._batches[shape] = self.simulator.batch(
                shape[0], self.output, planned_for=grey, plan=self._plan, capture=self._capture
            )
            if len(self._batches) > SHAPES:
                self._batches.popitem(last=False)
        self._batches.move_to_end(shape)
        return self._batches[shape]


def _as_numbers(values):
    """Return the numbers of an array of any library as Python's, and other values unchanged."""
    return to_host(values, "settings").tolist() if hasattr(values, "shape") else values


def move_axis(array, axis: int, to: int):
    """Return a view of an array of NumPy or LIBRARIES with an axis moved."""
    return _library_of(array).moveaxis(array, axis, to)


def _library_of(array):
    """Return the module of an array of LIBRARIES, or NumPy."""
    name = type(array).__module__.partition(".")[0]
    return sys.modules[name] if name in LIBRARIES else np


def _convert(pictures, device, frames):
    """Return a copy of frames as an array of the pictures' library, on its device if possible."""
    library = _library_of(pictures)
    if library is np:
        return np.array(device.numpy(frames))
    is_torch = library.__name__ == "torch"
    if not isinstance(frames, np.ndarray) and device.kind == "warp":
        # this device copies, in order: a copy by the other library might be too late for the next
        # batch
        flat = device.reshape(frames, (prod(frames.shape),))
        return library.from_dlpack(device.reshape(device.stack([flat]), frames.shape))
    copied = np.array(device.numpy(frames))
    return library.from_numpy(copied).to(pictures.device) if is_torch else library.asarray(copied)

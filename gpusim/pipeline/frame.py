"""Results of a simulation: the noise-free exposure of a scene, and one picture."""

import dataclasses
from dataclasses import dataclass
from os import PathLike
from typing import Any, Generic, TypeVar

import numpy as np

from gpusim.backends import Device
from gpusim.color.camera_profile import color_profile
from gpusim.color.rendering import Rendering
from gpusim.domain.camera import Camera
from gpusim.domain.display import decoding
from gpusim.domain.errors import OutOfRange
from gpusim.domain.labels import Pictured
from gpusim.domain.short_repr import shorten_repr
from gpusim.io.frame.frames import write_frame
from gpusim.pipeline.report import Report
from gpusim.planner.plan import Plan

ON_DEVICE = ("mean", "chip_mean")  # device arrays of an exposure
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Exposure:
    """The noise-free exposure of a scene. It is computed once; noisy frames are drawn from it.

    A pickle holds the arrays' values and the device's name; the device is opened when it is loaded. `np.asarray`
    returns the mean electrons.

    Attributes:
        plan: Plan of the scene.
        camera: The camera as operated: its sensor is binned and has the chosen analog gain.
        mean: Mean electrons of each pixel before binning, a device array (rows, cols) or, for stacked pixels, (C, rows,
            cols) [e-].
        chip_mean: The same with the chip's fixed pattern; noise is added to it, see `Readout.chip_mean` [e-].
        exposure_time: Exposure time [s].
        gain: Analog gain chosen by automatic exposure [1].
        rendering: Conversion of camera values to colours, for the known or assumed light.
        blur: Standard deviation of the lens blur as a Gaussian, if the camera uses it [pixel].
        shading: Gains of the shading correction at its nodes, if the camera uses them.
        ms: Milliseconds per stage.
        wall_ms: Milliseconds in all, planning included.
        device: Device of the arrays.
        is_rewritten: True if a program will write to these arrays again.
    """

    plan: Plan
    camera: Camera
    mean: Any
    chip_mean: Any
    exposure_time: float
    gain: float
    rendering: Rendering
    blur: float = 0.0
    shading: np.ndarray | None = None
    ms: dict = dataclasses.field(default_factory=dict)
    wall_ms: float = 0.0
    device: Device = dataclasses.field(default_factory=Device)
    is_rewritten: bool = False

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.mean, dtype, copy=copy)

    def __repr__(self):
        return shorten_repr(
            f"Exposure({self.plan.scene.name} by {self.camera.name}, {1e3 * self.exposure_time:.4g} ms, "
            f"gain {self.gain:g}, mean {tuple(self.mean.shape)} on {self.device.name})"
        )

    def split_layers(self, raw: Any) -> Any:
        """Return raw values with the layers of stacked pixels on an axis.

        Args:
            raw: Raw values (..., rows, cols), layers below each other.

        Returns:
            Raw values (..., C, rows, cols); for other sensors unchanged.
        """
        return raw.reshape(*raw.shape[:-2], *self.mean.shape[:-2], -1, raw.shape[-1])

    def __getstate__(self):
        return self.__dict__ | {
            name: np.array(self.device.numpy(getattr(self, name))) for name in ON_DEVICE
        }

    def __setstate__(self, state):
        arrays = {name: state["device"].array(state[name], state[name].dtype) for name in ON_DEVICE}
        self.__dict__.update(state, **arrays, is_rewritten=False)


class Later:
    """A value that is computed at its first use."""

    def __init__(self, make):
        self.make = make


class _Made(Generic[T]):
    """A field that also accepts a Later as its value."""

    def __set_name__(self, owner, name):
        self.name = name

    def __get__(self, frame, owner=None) -> T:
        if frame is None:
            raise AttributeError(self.name)  # for `dataclass`: the field has no default
        value = vars(frame)[self.name]
        if isinstance(value, Later):
            value = vars(frame)[self.name] = value.make()
        return value

    def __set__(self, frame, value: T | Later) -> None:
        vars(frame)[self.name] = value


@dataclass(frozen=True, eq=False)
class Frame(Pictured):
    """One simulated picture. Its parts are computed and copied to the host at their first use.

    Device arrays are held until all parts are computed, see `complete`. `np.asarray` returns the display codes.

    Attributes:
        camera: The camera as operated: its sensor is binned and has the chosen analog gain.
        exposure_time: Exposure time [s].
        rendering: Conversion to colours; its white is estimated from the picture if the camera does that.
        mean: Mean electrons without noise, float32 (rows, cols) or, for stacked pixels, (C, rows, cols) [e-].
        raw: Digital numbers of the same shape, uint16, or float32 without a converter [DN].
        linear: Linear display RGB before clipping and tone curve, float32 (rows, cols, 3), stored plane by plane.
            Display white is 1, see `Processor.scaling`.
        rgb: Display codes, uint8 (rows, cols, 3).
        report: Times, models and errors of the frame.
        blur: Standard deviation of the lens blur as a Gaussian, if the camera uses it [pixel].
        shading: Gains of the shading correction at its nodes, if the camera uses them.
        averaged: Number of digital numbers that are averaged to one raw value; None for several merged exposures,
            whose noise does not follow from one gain.
    """

    camera: Camera
    exposure_time: float
    rendering: _Made[Rendering] = _Made()
    mean: _Made[np.ndarray] = _Made()
    raw: _Made[np.ndarray] = _Made()
    linear: _Made[np.ndarray] = _Made()
    rgb: _Made[np.ndarray] = _Made()
    report: _Made[Report] = _Made()
    blur: float = 0.0
    shading: np.ndarray | None = None
    averaged: int | None = 1

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.rgb, dtype, copy=copy)

    def __repr__(self):
        made = {name: vars(self)[name] for name in ("raw", "rgb", "linear", "mean")}
        parts = [
            f"{name} {part.dtype} {part.shape}"
            for name, part in made.items()
            if not isinstance(part, Later)
        ]
        return shorten_repr(
            f"Frame({self.camera.name}, {1e3 * self.exposure_time:.4g} ms, "
            f"{', '.join(parts) or 'nothing computed yet'})"
        )

    def complete(self) -> "Frame":
        """Compute all parts. The frame then holds no device arrays.

        Returns:
            This frame.
        """
        for part in dataclasses.fields(self):
            getattr(self, part.name)
        return self

    def __getstate__(self):
        return dict(vars(self.complete()))

    def codes(self, bits: int = 8) -> np.ndarray:
        """Return display codes after the tone curve.

        Args:
            bits: Bits of a code, 8 or 16.

        Returns:
            Codes (rows, cols, 3): `rgb` itself, uint8, or uint16.

        Raises:
            OutOfRange: Another number of bits.
        """
        if bits == 8:
            return self.rgb
        if bits != 16:
            raise OutOfRange("bits of display codes", bits, "8 or 16")
        most = 2**16 - 1
        decode = decoding(self.camera.display, self.camera.processor.tone)
        # least values of codes 1, 2, ..., as for 8 bits
        edges = decode((np.arange(1, most + 1) - 0.5) / most)
        linear = np.nan_to_num(self.linear, nan=-np.inf)
        return np.searchsorted(edges, linear, side="right").astype(np.uint16)

    @property
    def color_profile(self) -> dict:
        """Colour matrices of the camera for raw converters, see `gpusim.color.camera_profile.color_profile`."""
        return color_profile(self.camera)

    def save(self, path: str | PathLike, *, bits: int | None = None) -> None:
        """Write the frame to a file, see `gpusim.io.frame.frames.write_frame`.

        Args:
            path: Path that ends in .png, .tif, .exr, .dng or .npz.
            bits: Bits of a value; None uses the format's default.
        """
        write_frame(path, self, bits)

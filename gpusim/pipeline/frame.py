"""What a simulation gives: the noise-free capture of a scene, and one picture."""

import dataclasses
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from gpusim.backends import Device
from gpusim.color.camera_profile import color_profile
from gpusim.color.encoding import decoding
from gpusim.color.rendering import Rendering
from gpusim.domain.camera import Camera
from gpusim.domain.errors import OutOfRange
from gpusim.domain.labels import Pictured
from gpusim.domain.short_repr import shortened
from gpusim.io.frame.frames import write_frame
from gpusim.pipeline.report import Report
from gpusim.planner.plan import Plan

ON_DEVICE = ("mean", "chip_mean")  # of an exposure
T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Exposure:
    """The noise-free capture of a scene: computed once, drawn from many times.

    plan: of the scene. camera: as operated, its sensor binned and with the analog gain that was chosen.
    mean: mean electrons of every pixel, not binned, array of the device, (rows, cols) or, of stacked pixels, (C, rows,
        cols) [e-].
    chip_mean: the same of this very chip, as the noise is drawn around it: see `Readout.chip_mean`.
    exposure_time: [s]. gain: analog gain that automatic exposure chose [1]. rendering: how its values become colours,
        for the light that is known or assumed.
    blur: of the lens as a Gaussian [pixel], shading: the correction's gains at its nodes, where the camera uses them.
    ms: milliseconds per stage that it took; wall_ms: in all, planning included. device: where the electrons are.
    is_rewritten: whether a program will write to these arrays again.
    It is pickled with their values and the device's name, which is opened where it is loaded. `np.asarray` gives the
    mean electrons.
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
        return shortened(
            f"Exposure({self.plan.scene.name} by {self.camera.name}, {1e3 * self.exposure_time:.4g} ms, "
            f"gain {self.gain:g}, mean {tuple(self.mean.shape)} on {self.device.name})"
        )

    def layered(self, raw) -> Any:
        """Raw values (..., rows, cols) with the layers of stacked pixels apart, (..., C, rows, cols)."""
        return raw.reshape(*raw.shape[:-2], *self.mean.shape[:-2], -1, raw.shape[-1])

    def __getstate__(self):
        return self.__dict__ | {
            name: np.array(self.device.numpy(getattr(self, name))) for name in ON_DEVICE
        }

    def __setstate__(self, state):
        arrays = {name: state["device"].array(state[name], state[name].dtype) for name in ON_DEVICE}
        self.__dict__.update(state, **arrays, is_rewritten=False)


class Later:
    """A value that is made when it is first asked for."""

    def __init__(self, make):
        self.make = make


class _Made(Generic[T]):
    """A field whose value may be given as a Later."""

    def __set_name__(self, owner, name):
        self.name = name

    def __get__(self, frame, owner=None) -> T:
        if frame is None:
            raise AttributeError(self.name)  # a dataclass asks so for its default: there is none
        value = vars(frame)[self.name]
        if isinstance(value, Later):
            value = vars(frame)[self.name] = value.make()
        return value

    def __set__(self, frame, value: T | Later) -> None:
        vars(frame)[self.name] = value


@dataclass(frozen=True, eq=False)
class Frame(Pictured):
    """One simulated picture, whose parts are computed and copied to the host when they are first asked for.

    What they are made of stays on the device until all are: see `complete`.

    camera, exposure_time [s], rendering: what it was taken and developed with; the camera's sensor is as operated, the
        white that of the picture where the camera estimates it.
    mean: mean electrons without noise, float32 (rows, cols) or, of stacked pixels, (C, rows, cols) [e-].
    raw: digital numbers, uint16 of the same shape [DN], or float32 without a converter.
    blur, shading: as of the exposure. averaged: digital numbers whose mean a raw value is; None: it is of several
        exposures, whose noise is no matter of one gain.
    linear: linear display RGB, display white 1 (see `Processor.scaling`), before clipping and tone curve, float32
        (rows, cols, 3), in memory plane by plane. rgb: display codes, uint8 (rows, cols, 3), which
        `np.asarray` gives.
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
        return shortened(
            f"Frame({self.camera.name}, {1e3 * self.exposure_time:.4g} ms, "
            f"{', '.join(parts) or 'nothing computed yet'})"
        )

    def complete(self) -> "Frame":
        """The same, all of it made; nothing of it is on the device any more."""
        for part in dataclasses.fields(self):
            getattr(self, part.name)
        return self

    def __getstate__(self):
        return dict(vars(self.complete()))

    def codes(self, bits: int = 8) -> np.ndarray:
        """Display codes of 8 or 16 bits, behind the tone curve: uint8 (`rgb` itself) or uint16, (rows, cols, 3).

        Raises OutOfRange.
        """
        if bits == 8:
            return self.rgb
        if bits != 16:
            raise OutOfRange("bits of display codes", bits, "8 or 16")
        most = 2**16 - 1
        decode = decoding(self.camera.display, self.camera.processor.tone)
        edges = decode(
            (np.arange(1, most + 1) - 0.5) / most
        )  # the least values of codes 1, 2, ..., as with 8 bits
        linear = np.nan_to_num(self.linear, nan=-np.inf)
        return np.searchsorted(edges, linear, side="right").astype(np.uint16)

    @property
    def color_profile(self) -> dict:
        """Matrices of the camera's colours for raw converters: see `gpusim.color.camera_profile.color_profile`."""
        return color_profile(self.camera)

    def save(self, path, *, bits: int | None = None) -> None:
        """Write .png, .tif, .exr, .dng or .npz: see `gpusim.io.frame.frames.write_frame`."""
        write_frame(path, self, bits)

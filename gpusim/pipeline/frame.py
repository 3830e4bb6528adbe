"""One simulated picture."""

import dataclasses
from dataclasses import dataclass
from os import PathLike
from typing import Any, Generic, TypeVar

import numpy as np

from gpusim.color.camera_profile import color_profile
from gpusim.color.rendering import Rendering
from gpusim.domain.camera import Camera
from gpusim.domain.display import decoding
from gpusim.domain.errors import OutOfRange
from gpusim.domain.labels import Pictured
from gpusim.domain.short_repr import shorten_repr
from gpusim.pipeline.report import Report

T = TypeVar("T")


class Parts:
    """Computes parts of a frame at their first use."""

    def compute(self, name: str, frame: "Frame") -> Any:
        """Return a part by the name of its field."""
        raise NotImplementedError


class _Made(Generic[T]):
    """A field that also accepts Parts, which compute its value."""

    def __init__(self, *default):
        self.default = default

    def __set_name__(self, owner, name):
        self.name = name

    def __get__(self, frame, owner=None) -> T:
        if frame is None:  # for `dataclass`, which asks for the default
            if not self.default:
                raise AttributeError(self.name)
            return self.default[0]
        value = vars(frame)[self.name]
        if isinstance(value, Parts):
            value = vars(frame)[self.name] = value.compute(self.name, frame)
        return value

    def __set__(self, frame, value: T | Parts) -> None:
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
        linear: Linear display RGB before the tone curve, with all that the processor does before it, float32 (rows,
            cols, 3), stored plane by plane.
            Display white is 1, see `Processor.scaling`.
        rgb: Display codes, uint8 (rows, cols, 3).
        report: Times, models and errors of the frame.
        labels: Labels and depth of the scene at the pixels of the picture, see `gpusim.carry_labels`; {} without any.
        blur: Standard deviation of the lens blur as a Gaussian, if the camera uses it [pixel].
        shading: Gains of the shading correction at its nodes, if the camera uses them.
        averaged: Number of digital numbers that are averaged to one raw value; None for several merged exposures,
            whose noise does not follow from one gain.
        full: Raw values of which a pixel was full before it was averaged, bool, the shape of `raw`; None: none is
            averaged, or it is not known.
        kernel: The camera's own blur, if its processor sharpens, see `processor.sharpen`.
    """

    camera: Camera
    exposure_time: float
    rendering: _Made[Rendering] = _Made()
    mean: _Made[np.ndarray] = _Made()
    raw: _Made[np.ndarray] = _Made()
    linear: _Made[np.ndarray] = _Made()
    rgb: _Made[np.ndarray] = _Made()
    report: _Made[Report] = _Made()
    labels: _Made[dict[str, np.ndarray]] = _Made()
    blur: float = 0.0
    shading: np.ndarray | None = None
    averaged: int | None = 1
    full: _Made[np.ndarray | None] = _Made(None)
    kernel: np.ndarray | None = None

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(self.rgb, dtype, copy=copy)

    def __repr__(self):
        made = {name: vars(self)[name] for name in ("raw", "rgb", "linear", "mean")}
        parts = [
            f"{name} {part.dtype} {part.shape}"
            for name, part in made.items()
            if not isinstance(part, Parts)
        ]
        return shorten_repr(
            f"Frame({self.camera.name}, {1e3 * self.exposure_time:.4g} ms, "
            f"{', '.join(parts) or 'nothing computed yet'})"
        )

    def complete(self) -> "Frame":
        """Compute all parts but the labels. These then hold no device arrays.

        Returns:
            This frame.
        """
        for part in dataclasses.fields(self):
            if part.name != "labels":
                getattr(self, part.name)
        return self

    def __getstate__(self):
        self.labels  # noqa: B018  a pickle holds them, too
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
        decode = decoding(self.camera.display, self.camera.processor.tone_curve)
        # least values of codes 1, 2, ..., as for 8 bits
        edges = decode((np.arange(1, most + 1) - 0.5) / most)
        linear = np.nan_to_num(self.linear, nan=-np.inf)
        return np.searchsorted(edges, linear, side="right").astype(np.uint16)

    @property
    def color_profile(self) -> dict:
        """Colour matrices of the camera for raw converters, see `gpusim.color.camera_profile.color_profile`."""
        return color_profile(self.camera)

    def save(
        self, path: str | PathLike, *, bits: int | None = None, quality: int | None = None
    ) -> None:
        """Write the frame to a file, see `gpusim.io.frame.frames.write_frame`.

        Args:
            path: Path that ends in .png, .jpg, .webp, .tif, .exr, .npy, .dng, .npz or .raw.npy.
            bits: Bits of a value; None uses the format's default.
            quality: Quality of a .jpg or .webp, 1 .. 100; None is 95.
        """
        from gpusim.io.frame.frames import write_frame  # and all formats

        write_frame(path, self, bits, quality)

"""What panels measure: the picture that is shown, its arrays, and places of it."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.color.rendering import Rendering
from gpusim.domain.account import Account, Tolerance
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.domain.scene import Scene
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.measure.merge import full_value
from gpusim.measure.noise_budget import noise_budget

SPAN = 4.0  # root mean squares of the error from grey to full colour
NEAR = 8  # half of the side of the square around the pointer that stands for a region [pixel]
STRIPE = 4  # width of the stripes on clipped pixels [pixel]
FULL_COLOR, DARK_COLOR = (255, 40, 40), (60, 110, 255)


@dataclass(frozen=True)
class Where:
    """Places of the picture.

    Attributes:
        shape: Rows and columns of the canvas, in whose pixels the places are.
        at: Row and column under the pointer, or None.
        part: First row, first column, end of rows, end of columns of a selected part, or None.
    """

    shape: tuple[int, int]
    at: tuple[int, int] | None = None
    part: tuple[int, int, int, int] | None = None

    def pixel(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Return the pixel of a frame of this shape under the pointer, or in the middle."""
        at = self.at or (self.shape[0] // 2, self.shape[1] // 2)
        row, col = (
            min(max(place * own // n, 0), own - 1)
            for place, own, n in zip(at, shape, self.shape, strict=True)
        )
        return row, col

    def region(self, shape: tuple[int, int]) -> tuple[slice, slice]:
        """Return rows and columns of a frame of this shape: the part, or those near the pointer."""
        if self.part is None:
            row, col = self.pixel(shape)
            rows, cols = (
                slice(max(at - NEAR, 0), min(at + NEAR, n))
                for at, n in zip((row, col), shape, strict=True)
            )
            return rows, cols
        found = []
        for low, high, own, n in zip(self.part[:2], self.part[2:], shape, self.shape, strict=True):
            first = min(max(low * own // n, 0), own - 1)
            found.append(slice(first, min(max(-(-high * own // n), first + 1), own)))
        return found[0], found[1]


@dataclass(frozen=True, eq=False)
class Inputs:
    """The picture that is shown, as panels need it.

    Attributes:
        picture: An object that every picture has another of.
        camera: The camera as set.
        operated: The camera as operated: its sensor is binned and has the chosen gain.
        scene: The scene.
        seconds: Exposure time [s].
        averaged: Pixels whose digital numbers are averaged to a raw value; None: several merged
            exposures, whose noise does not follow from one gain.
        added: Pixels whose charge is added to a raw value.
        rendering: Conversion to colours, if "linear" was fetched, and of merged exposures.
        account, tolerance: Predicted errors and their limits; None while they are not predicted.
        ms: Milliseconds of each step when it ran last.
        arrays: Host arrays by name: "mean" (..., rows, cols) [e-], "raw" (..., rows, cols) [DN],
            "linear" and "codes" (rows, cols, 3), "irradiance" (L, rows, cols)
            [photon s-1 m-2 nm-1].
    """

    picture: object
    camera: Camera
    operated: Camera
    scene: Scene
    seconds: float
    averaged: int | None = 1
    added: int = 1
    rendering: Rendering | None = None
    account: Account | None = None
    tolerance: Tolerance | None = None
    ms: dict[str, float] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def sensor(self) -> Sensor:
        """The sensor as operated."""
        return self.operated.sensor

    @property
    def merged_rendering(self) -> Rendering | None:
        """The rendering of merged exposures, for `find_clipping`; None of one exposure."""
        return self.rendering if self.averaged is None else None

    def variance(self, electrons: Any) -> dict[str, Any]:
        """Return the variance of a raw value by cause [e-^2], see `noise_budget`.

        Raises BadData for merged exposures.
        """
        if self.averaged is None:
            raise BadData(
                "the picture is merged from several exposures: its noise does not follow from one "
                "gain; preview one exposure"
            )
        by = {"averaged": self.averaged, "added": self.added}
        return noise_budget(self.sensor, electrons, self.seconds, **by)


def find_clipping(
    sensor: Sensor, raw: np.ndarray, rendering: Rendering | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return which pixels are saturated, and which are at digital number 0, bool (rows, cols).

    Saturated: within 5 read noises of the full well or at the converter's end, see
    `gpusim.measure.merge.full_value`; of merged exposures, at the largest merged value. Of stacked
    pixels one layer is enough. raw: (..., rows, cols) [DN]. rendering: of merged exposures only.
    """
    if rendering is None:
        full = full_value(sensor)
    else:
        span = sensor.white_level - sensor.dark_level
        full = sensor.dark_level + rendering.saturation * span - 0.5
    bright = np.asarray(raw >= np.float32(full))
    dark = np.asarray(raw <= 0) if sensor.bits != FLOAT_BITS else np.zeros(raw.shape, bool)
    layers = tuple(range(raw.ndim - 2))
    return np.any(bright, axis=layers), np.any(dark, axis=layers)


def mark_clipping(codes: np.ndarray, bright: np.ndarray, dark: np.ndarray) -> np.ndarray:
    """Return a picture with stripes on clipped pixels: red on saturated, blue on dark ones."""
    y, x = (np.arange(n) for n in codes.shape[:2])
    stripes = (y[:, None] + x) // STRIPE % 2 == 0
    found = codes.copy()
    found[bright & stripes] = FULL_COLOR
    found[dark & stripes] = DARK_COLOR
    return found


def decibels(electrons: Any, variance: Any) -> Any:
    """Return the signal to noise ratio of electrons with a variance [e-^2], [dB]."""
    with np.errstate(divide="ignore"):
        return 20 * np.log10(electrons) - 10 * np.log10(variance)


def error_map(mean, truth) -> np.ndarray:
    """Return codes (rows, cols, 3) of an error: grey 0, red too many electrons, full colour at SPAN."""
    wrong = np.asarray(mean, np.float64) - truth
    wrong = wrong if wrong.ndim == 2 else wrong.mean(axis=0)
    part = np.clip(wrong / max(SPAN * np.sqrt(np.mean(wrong**2)), 1e-300), -1, 1)
    grey = 128 * (1 - np.abs(part))
    red = grey + 255 * np.maximum(part, 0)
    blue = grey + 255 * np.maximum(-part, 0)
    codes = np.stack([red, grey, blue], axis=-1)
    return (np.clip(codes, 0, 255) + 0.5).astype(np.uint8)


def on_host(device: Device, array) -> np.ndarray:
    """Return a host copy of an array of the device."""
    return np.array(device.numpy(array))

"""A sensor's electronics on a device: from mean electrons to digital numbers."""

import dataclasses
from collections.abc import Sequence
from itertools import compress
from math import prod
from operator import is_
from typing import Any

import numpy as np

from gpusim.backends import Device, open_device
from gpusim.backends.tape import OwnTape, recording
from gpusim.domain.errors import BadData, DoesNotFit, OutOfRange, checked_count
from gpusim.domain.exposure import checked_time
from gpusim.domain.mosaics import bin_mosaic
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.domain.short_repr import shorten_repr
from gpusim.kernels.processor.interpolate import least_frame
from gpusim.kernels.sensor.bin import bin as bin_pixels
from gpusim.kernels.sensor.bin import binned_shape
from gpusim.kernels.sensor.chip import chip
from gpusim.kernels.sensor.flag import flag
from gpusim.kernels.sensor.noise import MOST, OUT, noise
from gpusim.kernels.sensor.pattern import pattern
from gpusim.pipeline.cache import Cache
from gpusim.pipeline.step import Chain, Rate, Step, Values

RESET = 2**30  # number of the read whose random numbers the reset uses
GAINS = 16  # number of sensors with other gains that are kept
BATCH = 2**26  # pixels of frames that are drawn at once


class Readout:
    """One chip of a sensor on a device.

    Args:
        sensor: Properties of the sensor.
        device: A device or its name.
        tables: Cache of the chip's fixed patterns; by default its own.

    Attributes:
        output: The binned sensor, whose pixels are the raw values.
        pixels: Number of pixels whose charge is added to one output pixel.
        averaged: Number of pixels whose digital numbers are averaged to one output pixel.

    Raises:
        BadData: `sensor` is no Sensor.
        DeviceError: There is no such device.
    """

    def __init__(self, sensor: Sensor, device: Device | str = "auto", tables: Cache | None = None):
        if not isinstance(sensor, Sensor):
            raise BadData(f"readout: {type(sensor).__name__}, wanted a Sensor, e.g. camera.sensor")
        self.sensor, self.device = (
            sensor,
            open_device(device) if isinstance(device, str) else device,
        )
        # layers of stacked pixels have one colour each
        self.stride, mosaic = (1, 1), sensor.cfa_indices
        if not sensor.stacked:
            self.stride, mosaic = bin_mosaic(sensor.cfa_indices, sensor.binning)
        charge = sensor.binning_mode == "charge"
        self.pixels = prod(sensor.binning) if charge else 1
        self.output = dataclasses.replace(
            sensor,
            cfa=tuple(map("".join, np.array(sensor.channels)[mosaic])),
            binning=(1, 1),
            full_well=sensor.full_well * self.pixels,
            noise=dataclasses.replace(
                sensor.noise, dark_current=sensor.noise.dark_current * self.pixels
            ),
        )
        self._digital = not charge and sensor.binning != (1, 1)
        self.averaged = prod(sensor.binning) if self._digital else 1
        self._tables = Cache() if tables is None else tables
        self._sensors = {1.0: self.output}
        self._drawing = OwnTape()  # of the frame that was drawn last

    def __repr__(self):
        return shorten_repr(f"Readout({self.sensor!r}, {self.device!r})")

    def steps(self, shape: tuple[int, ...]) -> list[Step]:
        """Return the steps from the mean electrons "mean", by way of "chip_mean", to the digital numbers "raw".

        Args:
            shape: Shape of the mean electrons, (rows, cols) or (C, rows, cols).

        Returns:
            The steps in the order in which they run.
        """
        plane = prod(shape[:-1]), shape[-1]
        patterns = self._patterns(plane, "response", "dark")
        dark = "dark" if "dark" in patterns else ""
        pixels = prod(plane) if patterns else 0
        chain = Chain("mean", "chip_mean", Rate.EXPOSURE, self.device)
        chain.add(
            "sensor.chip",
            {},
            "response" if "response" in patterns else "",
            dark,
            run=expose_chip,
            numbers=("dark_time",) if dark else (),
            words="mean electrons through this chip's response" if patterns else "",
            nbytes=4 * pixels,
            work=float(pixels),
        )
        if self.sensor.binning != (1, 1) and not self._digital:
            self._add_binning(chain, plane, average=False)
            plane = binned_shape(plane, self.sensor.binning, self.stride)
        return [*patterns.values(), *chain.end(), *self.noise_steps(plane)]

    def noise_steps(self, plane: tuple[int, int]) -> list[Step]:
        """Return the steps from "chip_mean" to "raw".

        Args:
            plane: Shape of "chip_mean" (rows, cols).

        Returns:
            The steps in the order in which they run.
        """
        noise_, sensor, pixels = self.sensor.noise, self.output, prod(plane)
        patterns = self._patterns(plane, "offset", "amplitude")
        is_float = sensor.bits == FLOAT_BITS
        temporal = {
            f"photon ({noise_.photon})": noise_.photon != "none",
            "dark current": noise_.dark_current,
            "read": noise_.read,
            "reset": noise_.reset,
            "converter": noise_.adc,
            "rows": noise_.row,
            "columns": noise_.column,
            "telegraph": "amplitude" in patterns,
        }
        words = ", ".join(compress(temporal, temporal.values())) or "no noise"
        chain = Chain("chip_mean", "raw", Rate.FRAME, self.device)
        chain.add(
            "sensor.noise",
            {
                "row_noise": noise_.row,
                "column_noise": noise_.column,
                "telegraph_switching": noise_.telegraph_switching,
                "full_well": sensor.full_well,
                "white_level": None if is_float else sensor.white_level,
                "photon": noise_.photon,
            },
            "offset" if "offset" in patterns else "",
            "amplitude" if "amplitude" in patterns else "",
            numbers=("dark_electrons", "read_noise", "gain", "black_level", "seed", "frame"),
            words=f"{words}; full well, {'no converter' if is_float else f'{sensor.bits} bit'}",
            nbytes=pixels * (4 if is_float else 2),
            work=float(pixels),
        )
        if self._digital:
            self._add_binning(chain, plane, average=True)
        return [*patterns.values(), *chain.end()]

    def _add_binning(self, chain, plane, average):
        sensor = self.sensor
        binned_pixels = prod(binned_shape(plane, sensor.binning, self.stride))
        chain.add(
            "sensor.bin",
            {"binning": sensor.binning, "stride": self.stride, "average": average},
            words=f"{sensor.binning[0]}x{sensor.binning[1]} pixels by {sensor.binning_mode}",
            nbytes=(2 if average else 4) * binned_pixels,
            work=float(prod(plane)),
        )

    def _patterns(self, plane, *wanted) -> dict[str, Step]:
        """Return the steps of the fixed patterns that this chip has, of (rows, cols), by name."""
        noise_ = self.sensor.noise
        prnu = {"pixel": noise_.prnu, "row": noise_.row_prnu, "column": noise_.column_prnu}
        dsnu = {"pixel": noise_.dsnu, "row": noise_.row_dsnu, "column": noise_.column_dsnu}
        hot = {"share": noise_.hot_pixels, "scale": noise_.hot_current}
        traps = {"share": noise_.telegraph_pixels, "scale": noise_.telegraph}
        planes = {
            "response": prnu | {"dead": noise_.dead_pixels},
            "dark": hot,
            "offset": dsnu,
            "amplitude": traps,
        }
        # an exponential needs both numbers, a sum of normal numbers one
        has = {
            "response": any(planes["response"].values()),
            "dark": all(hot.values()),
            "offset": any(dsnu.values()),
            "amplitude": all(traps.values()),
        }
        parts = {
            "PRNU": any(prnu.values()),
            "DSNU": has["offset"],
            "dead pixels": noise_.dead_pixels,
            "hot pixels": has["dark"],
            "traps": has["amplitude"],
        }
        words = f"{', '.join(compress(parts, parts.values()))} of chip {noise_.seed}"
        described = next(filter(has.get, has), "")  # one line of the report for all patterns
        return {
            name: Step(
                name,
                "sensor.pattern",
                (),
                {
                    "rows": plane[0],
                    "cols": plane[1],
                    "plane": "telegraph" if name == "amplitude" else name,
                    "seed": noise_.seed,
                    "mean": float(name == "response"),
                    **planes[name],
                    "device": self.device,
                },
                words=words if name == described else "",
                nbytes=4 * prod(plane),
                rate=Rate.CAMERA,
                run=make_pattern,
            )
            for name in wanted
            if has[name]
        }

    def sensor_at_gain(self, gain: float) -> Sensor:
        """Return the output sensor with another analog gain. The last sensors are kept.

        Args:
            gain: Factor of the sensor's analog gain [1].

        Returns:
            The sensor.
        """
        sensor = self._sensors.get(gain)
        if sensor is None:
            sensor = dataclasses.replace(self.output, analog_gain=self.output.analog_gain * gain)
            if len(self._sensors) >= GAINS:
                self._sensors = {}  # a new dictionary: another thread may be reading the old one
            self._sensors[gain] = sensor
        return sensor

    def output_shape(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Return the shape of the raw values of a frame.

        Args:
            shape: Pixels of the frame (rows, cols).

        Returns:
            The shape (rows, cols).

        Raises:
            OutOfRange: The frame is too small for the mosaic.
        """
        sensor = self.output
        if self.sensor.binning != (1, 1):
            if sensor.stacked and shape[0] % self.sensor.binning[0]:
                raise OutOfRange(
                    "frame size",
                    f"{shape[1]}x{shape[0]}",
                    f"rows in multiples of {self.sensor.binning[0]}: the layers of stacked pixels are binned in "
                    "whole blocks",
                )
            shape = binned_shape(shape, self.sensor.binning, self.stride)
        if not (sensor.is_monochrome or sensor.stacked or sensor.bayer_phase):
            least = least_frame(sensor.cfa_indices)
            if shape[0] < least[0] or shape[1] < least[1]:
                raise OutOfRange(
                    "frame size",
                    f"{shape[1]}x{shape[0]}",
                    f"at least {least[1]}x{least[0]} pixels: "
                    f"every pixel of the mosaic {'/'.join(sensor.cfa)} needs all colours near it",
                )
        rows, cols = shape
        return rows, cols

    def chip_mean(self, mean: Any, exposure_time: float, scale: float = 1.0) -> Any:
        """Return the electrons that this chip is expected to collect, without the common dark current.

        Args:
            mean: Mean electrons of the scene, an array of the device, shape (rows, cols) or, for stacked pixels,
                (C, rows, cols) [e-].
            exposure_time: Exposure time [s].
            scale: Factor of the mean [1].

        Returns:
            An array of the device, shape (rows, cols), layers one below the other, binned if charge is binned [e-].
        """
        rows, cols = prod(mean.shape[:-1]), mean.shape[-1]
        if scale != 1:
            mean = expose_chip(mean, scale=scale, device=self.device)
        values = Values.of(self.steps((rows, cols)), self._tables)
        values.give(mean=mean)
        values.set_numbers(dark_time=self.dark_time(exposure_time))
        return values["chip_mean"]

    def defects(
        self, shape: tuple[int, ...], exposure_time: float = 0.0, least: float = 0.0
    ) -> np.ndarray | None:
        """Return the map of this chip's dead and hot pixels, as a calibration finds them for `processor.defects`.

        A binned pixel is defective if one of its pixels is.

        Args:
            shape: Shape of the mean electrons, see `chip_mean`.
            exposure_time: Exposure time [s].
            least: A pixel is hot if it collects more than this beyond the common dark current in the exposure time
                [e-]. At time 0 it is hot if it collects any.

        Returns:
            1 at defective pixels, else 0: uint8, shape of the raw values. None if there are none.
        """
        values = Values.of(self.steps(shape), self._tables)
        has_dead = "response" in values and self.sensor.noise.dead_pixels
        flags = flag_pixels(
            values["response"] if has_dead else None,
            values["dark"] if "dark" in values else None,
            hot_electrons=least,
            dark_time=self.dark_time(exposure_time),
            binning=self.sensor.binning,
            stride=self.stride,
            device=self.device,
        )
        if flags is None:
            return None
        found = (self.device.numpy(flags) != 0).astype(np.uint8)
        return found if found.any() else None

    def mean(self, mean: Any) -> np.ndarray:
        """Bin mean electrons: added for charge binning, averaged for digital binning.

        Args:
            mean: Mean electrons of the pixels, a device array (rows, cols) [e-].

        Returns:
            Mean electrons of the output pixels, float32 [e-].
        """
        if self.sensor.binning != (1, 1):
            mean = self._bin(mean)
        mean = np.array(self.device.numpy(mean), np.float32)
        return mean / np.float32(prod(self.sensor.binning)) if self._digital else mean

    def draw(
        self,
        chip_mean: Any,
        exposure_time: float,
        gain: float = 1.0,
        seed: int = 0,
        first: int = 0,
        frames: int | None = None,
        is_averaged: bool = True,
    ) -> Any:
        """Return raw values around the electrons that the chip is expected to collect.

        Args:
            chip_mean: Result of the method of this name, a device array (rows, cols) [e-].
            exposure_time: Exposure time [s].
            gain: Analog gain, next to the sensor's [1].
            seed: Names the noise.
            first: Number of the frame, or of the first one.
            frames: Number of frames; None draws one without the first axis.
            is_averaged: False returns pixels before digital binning.

        Returns:
            An array of the device, (rows, cols) or (frames, rows, cols): uint16, or float32 without a converter.

        Raises:
            DoesNotFit: The frames need more memory than the device has.
            OutOfRange: The seed or a number is not allowed.
        """
        device, drawing = self.device, self._drawing
        computation = chip_mean, exposure_time, gain
        numbers: dict[str, float] = {"seed": seed, "frame": first}
        if frames is None and drawing.of and all(map(is_, drawing.of, computation)):
            # only the kernel runs again, with other numbers and another array
            raw = device.empty(drawing.raw.shape, drawing.raw.dtype)
            tape = drawing.tape
            if not (tape.renumber(numbers) and tape.replace_arrays([(drawing.raw, raw)])):
                raise RuntimeError("the recorded frame cannot be drawn again")
            tape.replay()
            drawing.raw = raw
            return device.reshape(raw, tuple(chip_mean.shape))
        if frames is not None:
            bytes_each = 4 if self.sensor.bits == FLOAT_BITS else 2
            needed = int(frames) * prod(chip_mean.shape) * bytes_each
            if needed > device.memory:
                raise DoesNotFit(f"{frames} frames", needed, device.memory, device.name)
        steps = self.noise_steps(tuple(chip_mean.shape))
        values, read = Values.of(steps, self._tables), steps[-1 - self._digital]
        values.give(chip_mean=chip_mean)
        planes = [values[name] if name else None for name in read.inputs]
        numbers |= self.numbers(exposure_time, gain)
        drawing.of = ()
        with recording(drawing.tape):
            raw = noise(*planes, **read.constants, **numbers, frames=frames)
        if self._digital:
            if not is_averaged:
                return raw
            if frames is None:
                return self._bin(raw, average=True)
            each = [device.part(raw, number) for number in range(raw.shape[0])]
            return device.stack([self._bin(one, average=True) for one in each])
        if frames is None and device.kind != "numpy" and isinstance(chip_mean, device.array_type):
            drawing.of, drawing.raw = computation, drawing.tape.commands[-1].args[OUT]
        return raw

    def draw_electrons(
        self,
        mean: np.ndarray,
        exposure_time: float,
        *,
        gain: float = 1.0,
        seed: int = 0,
        first: int = 0,
        frames: int | None = None,
    ) -> np.ndarray:
        """Add noise to given mean electrons.

        It raises BadData for wrong shapes, and OutOfRange for electrons that are negative or not finite.

        Args:
            mean: Mean electrons before binning, (rows, cols) or, for stacked pixels, (C, rows, cols) [e-].
            exposure_time: Exposure time [s].
            gain: Analog gain, next to the sensor's [1].
            seed: Seed of the noise.
            first: Number of the first frame.
            frames: Number of frames; None draws one without the first axis.

        Returns:
            Raw values, uint16, or float32 without a converter: (rows, cols), with axes for frames and layers before
            these if there are any [DN].
        """
        checked_time(exposure_time)
        mean = checked_electrons(mean, len(self.sensor.channels) if self.sensor.stacked else None)
        self.output_shape(mean.shape[-2:])
        chip_mean = self.chip_mean(self.device.array(mean), exposure_time)
        raw = np.array(
            self.device.numpy(
                self.draw(
                    chip_mean, exposure_time, gain=gain, seed=seed, first=first, frames=frames
                )
            )
        )
        return raw.reshape(*raw.shape[:-2], *mean.shape[:-2], -1, raw.shape[-1])

    def numbers(self, exposure_time: float, gain: float) -> dict[str, float]:
        """Return the arguments of `sensor.noise` that depend on the exposure.

        Args:
            exposure_time: Exposure time [s].
            gain: Analog gain, next to the sensor's [1].

        Returns:
            The arguments by name.
        """
        sensor = self.sensor_at_gain(gain)
        return {
            "dark_electrons": self.dark_electrons(exposure_time),
            "read_noise": sensor.read_sigma,
            "gain": sensor.gain_dn_per_electron,
            "black_level": sensor.dark_level,
        }

    def average(
        self,
        chip_mean: Any,
        exposure_time: float,
        count: int,
        *,
        gain: float = 1.0,
        seed: int = 0,
        first: int = 0,
    ) -> Any:
        """Return the mean raw values of several frames. Digital numbers are added as integers, without rounding.

        Args:
            chip_mean: Result of the method of this name, a device array (rows, cols) [e-].
            exposure_time: Exposure time [s].
            count: Number of frames.
            gain: Analog gain, next to the sensor's [1].
            seed: Seed of the noise.
            first: Number of the first frame.

        Returns:
            Mean raw values, NumPy float64 (rows, cols) [DN].
        """
        count = checked_count("count of averaged frames", count)
        total, kind = 0, np.float64 if self.sensor.bits == FLOAT_BITS else np.uint64
        batch = max(1, min(BATCH // prod(chip_mean.shape), 2**15, count))
        for start in range(0, count, batch):
            raw = self.draw(
                chip_mean,
                exposure_time,
                gain=gain,
                seed=seed,
                first=first + start,
                frames=min(batch, count - start),
            )
            total = total + self.device.numpy(raw).sum(axis=0, dtype=kind)
        return total / count

    def nondestructive(
        self,
        mean: Any,
        exposure_time: float,
        times: Sequence[float] | np.ndarray,
        *,
        gain: float = 1.0,
        seed: int = 0,
        first: int = 0,
        is_averaged: bool = True,
    ) -> np.ndarray:
        """Return raw values of non-destructive reads, which leave the charge in the pixels.

        All reads see the same growing charge, photon by photon, and share the noise of the reset. Each has its read
        noise.

        Args:
            mean: Mean electrons of the exposure time, a device array, see `chip_mean` [e-]. A list has those from each
                read to the next, for light that changes.
            exposure_time: Exposure time [s].
            times: Times of the reads since the reset, rising [s].
            gain: Analog gain, next to the sensor's [1].
            seed: Seed of the noise.
            first: Number of the frame.
            is_averaged: False returns pixels before digital binning.

        Returns:
            Raw values (reads, rows, cols) [DN].
        """
        times = self.checked_reads(times)
        sensor, device, noise_ = self.sensor_at_gain(gain), self.device, self.sensor.noise
        steps_of_light = mean if isinstance(mean, list) else None
        whole = mean[0] if isinstance(mean, list) else mean
        shape = prod(whole.shape[:-1]), whole.shape[-1]
        shape = shape if self.pixels == 1 else binned_shape(shape, self.sensor.binning, self.stride)
        steps = self.noise_steps(shape)
        values = Values.of(steps, self._tables)
        read = next(step for step in steps if step.stage == "sensor.noise")
        offset, amplitude = (values[name] if name else None for name in read.inputs[1:])
        numbers = self.numbers(0.0, gain) | {"seed": seed, "frame": first}
        # the kernel takes no negative electrons, so the reset noise is part of the offset
        numbers["read_noise"] = float(
            np.hypot(noise_.read, noise_.adc / sensor.gain_dn_per_electron)
        )
        common = {
            "gain": 1.0,
            "full_well": MOST,
            "electrons": True,
            "seed": seed,
            "frame": first,
            "device": device,
        }
        reads, previous = [], 0.0
        charge: Any = np.float32(0)
        for number, time in enumerate(times):
            step = time - previous
            if steps_of_light is None:
                more = self.chip_mean(mean, step, step / exposure_time)
            else:
                more = self.chip_mean(steps_of_light[number], step)
            more = noise(
                more,
                dark_electrons=self.dark_electrons(step),
                photon=noise_.photon,
                read=number,
                **common,
            )
            charge = np.minimum(charge + device.numpy(more), np.float32(sensor.full_well))
            if number == 0:
                reset = np.zeros_like(charge)
                if noise_.reset:
                    reset = device.numpy(
                        noise(
                            device.array(reset),
                            read_noise=noise_.reset,
                            photon="none",
                            read=RESET,
                            **common,
                        )
                    )
                offset = device.array(reset if offset is None else reset + device.numpy(offset))
            raw = noise(
                device.array(charge),
                offset,
                amplitude,
                **{**read.constants, "photon": "none"},
                **numbers,
                read=number,
            )
            if self._digital and is_averaged:
                raw = self._bin(raw, average=True)
            reads.append(np.array(device.numpy(raw)))
            previous = time
        return np.stack(reads)

    def average_pixels(self, raw: Any) -> Any:
        """Return the means of raw values of digital binning, a device array.

        Args:
            raw: Raw values of single pixels, a device array.

        Returns:
            The means.
        """
        return self._bin(raw, average=True)

    def find_full(self, raw: Any, gain: float = 1.0) -> np.ndarray:
        """Return which means of digital binning have a full pixel.

        Args:
            raw: Raw values of single pixels, an array of the device or of the host.
            gain: Analog gain, next to the sensor's [1].

        Returns:
            True where one is full.
        """
        from gpusim.measure.merge import full_value  # and all measurements

        full = self.device.numpy(raw) >= full_value(self.sensor_at_gain(gain))
        return self.device.numpy(self._bin(self.device.array(full.astype(np.float32)))) > 0

    def checked_reads(self, times: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return the times of non-destructive reads, checked.

        Args:
            times: Times since the reset [s].

        Returns:
            The times, float64 (reads,) [s].

        Raises:
            BadData: No numbers.
            OutOfRange: Times that are not finite, positive and rising.
        """
        try:
            found = np.asarray(times, np.float64)
        except (TypeError, ValueError):
            raise BadData(f"times of the reads = {times!r}: wanted numbers [s]") from None
        if (
            found.ndim != 1
            or not found.size
            or not (np.isfinite(found) & (np.diff(found, prepend=0.0) > 0)).all()
        ):
            raise OutOfRange(
                "times of the reads",
                found.tolist(),
                "one or more finite times, rising from above 0 s",
            )
        return found

    def dark_time(self, exposure_time: float) -> float:
        """Return the time in which the dark current, at its reference temperature, collects an exposure's dark charge.

        Args:
            exposure_time: Exposure time [s].

        Returns:
            The time [s].
        """
        return min(exposure_time * self.sensor.noise.warmth, MOST)

    def dark_electrons(self, exposure_time: float) -> float:
        """Return the mean dark charge that all output pixels share.

        Args:
            exposure_time: Exposure time [s].

        Returns:
            The charge [e-].
        """
        noise_ = self.output.noise
        return min(noise_.operating_dark_current * exposure_time, MOST)

    def _bin(self, pixels, average=False):
        return bin_pixels(
            pixels,
            binning=self.sensor.binning,
            stride=self.stride,
            average=average,
            device=self.device,
        )


def make_pattern(*, device: Device, **numbers) -> Any:
    """Return a plane of a chip's fixed values as a device array, see `sensor.pattern`."""
    return device.array(pattern(**numbers, device=device))


def expose_chip(mean, response=None, dark=None, *, device, dark_time=0.0, scale=1.0) -> Any:
    """Return the electrons that a chip is expected to collect, (rows, cols), layers below each other.

    See `sensor.chip`.
    """
    mean = device.reshape(mean, (prod(mean.shape[:-1]), mean.shape[-1]))
    if response is None and dark is None and scale == 1:
        return mean
    return chip(mean, response, dark, scale=scale, dark_time=dark_time, device=device)


def flag_pixels(
    response, dark, *, hot_electrons, dark_time, binning, stride, device, places=None
) -> Any:
    """Return a map of dead, hot and phase-detection pixels, an array of the device; None if there can be none.

    hot_electrons: least charge of a hot pixel beyond the common dark current [e-]. dark_time: [s]. places: not 0 at
    phase-detection pixels, (rows, cols), or None. The rest as for `sensor.flag`.
    """
    flags = None
    if response is not None or dark is not None:
        least = hot_electrons / dark_time if dark_time else 0.0
        flags = flag(response, dark, least=least, binning=binning, stride=stride, device=device)
    if places is None:
        return flags
    known = places if flags is None else places | device.numpy(flags)
    return device.array((known != 0).astype(np.uint8), np.uint8)


def checked_electrons(mean: Any, layers: int | None) -> np.ndarray:
    """Return mean electrons, checked.

    Args:
        mean: Mean electrons [e-].
        layers: Number of layers of stacked pixels; None for a mosaic.

    Returns:
        Mean electrons, float32 [e-].

    Raises:
        BadData: No numbers, or another shape.
        OutOfRange: Electrons that are negative or not finite.
    """
    try:
        mean = np.asarray(mean, np.float32)
    except (TypeError, ValueError):
        raise BadData("mean electrons: wanted an array of numbers") from None
    if mean.shape[:-2] != (() if layers is None else (layers,)) or mean.ndim < 2 or not mean.size:
        wanted = "(rows, cols)" if layers is None else f"({layers}, rows, cols) for stacked pixels"
        raise BadData(f"mean electrons: shape {mean.shape}, wanted {wanted}")
    wrong = ~(np.isfinite(mean) & (mean >= 0))
    if wrong.any():
        place = tuple(map(int, np.argwhere(wrong)[0]))
        raise OutOfRange(
            f"mean electrons at {place}",
            f"{mean[place]:.6g} e-",
            f"0 <= electrons < inf ({int(wrong.sum())} of {mean.size} pixels are not)",
        )
    return mean

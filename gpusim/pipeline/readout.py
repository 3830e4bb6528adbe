"""A sensor's electronics on a device: from mean electrons to digital numbers."""

import dataclasses
from math import prod
from typing import Any

import numpy as np

from gpusim.backends import Device, open_device
from gpusim.domain.binning import binned
from gpusim.domain.errors import BadData, DoesNotFit, OutOfRange, checked_count
from gpusim.domain.exposure import checked_time
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.domain.short_repr import shortened
from gpusim.kernels.processor.interpolate import least_frame
from gpusim.kernels.sensor.bin import bin as bin_pixels
from gpusim.kernels.sensor.bin import binned_shape
from gpusim.kernels.sensor.chip import chip
from gpusim.kernels.sensor.flag import flag
from gpusim.kernels.sensor.noise import MOST, noise, redraw
from gpusim.kernels.sensor.pattern import pattern
from gpusim.pipeline.cache import Kept

RESET = 2**30  # number of the read whose random numbers the reset has
GAINS = 16  # operated sensors that are kept
BATCH = 2**26  # [pixel] of frames that are drawn at once


class Readout:
    """One chip of a sensor on a device (or the name of one).

    sensor: its properties. output: the sensor as which its raw values look, binned. pixels: whose charge becomes one
    output pixel's; averaged: whose digital numbers' mean it is. kept: where fixed patterns are kept.
    response_key: what the chip's mean electrons depend on beside the scene's.
    """

    def __init__(self, sensor: Sensor, device: Device | str = "auto", kept: Kept | None = None):
        if not isinstance(sensor, Sensor):
            raise BadData(f"readout: {type(sensor).__name__}, wanted a Sensor, such as a camera's")
        self.sensor, self.device = (
            sensor,
            open_device(device) if isinstance(device, str) else device,
        )
        self.stride, mosaic = binned(sensor.cfa_indices, sensor.binning)
        charge = sensor.binning_mode == "charge"
        self.pixels = prod(sensor.binning) if charge else 1
        self.output = dataclasses.replace(
            sensor,
            cfa=tuple("".join(sensor.channels[c] for c in row) for row in mosaic),
            binning=(1, 1),
            full_well=sensor.full_well * self.pixels,
            noise=dataclasses.replace(
                sensor.noise, dark_current=sensor.noise.dark_current * self.pixels
            ),
        )
        self._digital = not charge and sensor.binning != (1, 1)
        self.averaged = prod(sensor.binning) if self._digital else 1
        self._kept = Kept() if kept is None else kept
        self._operated = {1.0: self.output}
        chip = sensor.noise
        self.response_key = (
            sensor.binning,
            sensor.binning_mode,
            sensor.cfa,
            chip.prnu,
            chip.row_prnu,
            chip.column_prnu,
            chip.dead_pixels,
            chip.hot_pixels,
            chip.hot_current,
            chip.warmth,
            chip.seed,
        )

    def __repr__(self):
        return shortened(f"Readout({self.sensor!r}, {self.device!r})")

    def operated(self, gain: float) -> Sensor:
        """The output sensor with its analog gain multiplied by `gain`; the last ones are kept."""
        sensor = self._operated.get(gain)
        if sensor is None:
            sensor = dataclasses.replace(self.output, analog_gain=self.output.analog_gain * gain)
            if len(self._operated) >= GAINS:
                self._operated = {}  # a new one: another thread may be reading the last
            self._operated[gain] = sensor
        return sensor

    def output_shape(self, shape) -> tuple[int, int]:
        """Rows and columns of the raw values of a frame of `shape` pixels. Raises OutOfRange where they are too few."""
        sensor = self.output
        if self.sensor.binning != (1, 1):
            shape = binned_shape(shape, self.sensor.binning, self.stride)
        if not (sensor.is_monochrome or sensor.stacked or sensor.bayer_phase):
            least = least_frame(sensor.cfa_indices)
            if shape[0] < least[0] or shape[1] < least[1]:
                raise OutOfRange(
                    "frame size",
                    f"{shape[1]}x{shape[0]}",
                    f"at least {least[1]}x{least[0]} pixels, so "
                    f"that all colours of the mosaic {'/'.join(sensor.cfa)} are near every pixel",
                )
        return tuple(shape)

    def chip_mean(self, mean, exposure_time: float, scale: float = 1.0) -> Any:
        """Electrons that this chip is expected to collect, without the dark current all pixels have in common.

        mean: of the scene, array of the device, shape (rows, cols) or, of stacked pixels, (C, rows, cols) [e-].
        exposure_time: [s]. scale: multiplies the mean [1]. Returns shape (rows, cols), layers one below the other,
        binned where charge is.
        """
        sensor = self.sensor
        rows, cols = prod(mean.shape[:-1]), mean.shape[-1]
        mean = self.device.reshape(mean, (rows, cols))
        response, dark = self._response(rows, cols), self._dark(rows, cols)
        if response is not None or dark is not None or scale != 1:
            mean = chip(
                mean,
                response,
                dark,
                scale=scale,
                dark_time=self.dark_time(exposure_time),
                device=self.device,
            )
        return mean if sensor.binning == (1, 1) or self._digital else self._binned(mean)

    def defects(self, shape, exposure_time: float = 0.0, least: float = 0.0) -> np.ndarray | None:
        """Where this chip's pixels are dead or hot: 1 there, else 0, NumPy uint8 like the raw values; None: nowhere.

        What a calibration of the chip would find, for `processor.defects`. shape: of the mean electrons, see
        `chip_mean`. exposure_time: [s]. Hot are pixels that collect more than `least` [e-] in that time beyond the
        common dark current; at time 0, all that collect any. A binned pixel is defective if one of its pixels is.
        """
        flags = self.flags(shape, exposure_time, least)
        found = (
            np.zeros(1, np.uint8)
            if flags is None
            else (self.device.numpy(flags) != 0).astype(np.uint8)
        )
        return found if found.any() else None

    def flags(self, shape, exposure_time: float = 0.0, least: float = 0.0) -> Any:
        """The same map as an array of the device, not 0 at defects; None where the chip has no such pixels."""
        rows, cols = prod(shape[:-1]), shape[-1]
        noise_, dark = self.sensor.noise, self._dark(rows, cols)
        response = self._response(rows, cols) if noise_.dead_pixels else None
        if response is None and dark is None:
            return None
        dark_time = self.dark_time(exposure_time)
        return flag(
            response,
            dark,
            least=least / dark_time if dark_time else 0.0,
            binning=self.sensor.binning,
            stride=self.stride,
            device=self.device,
        )

    def mean(self, mean) -> np.ndarray:
        """Mean electrons of the output's pixels, NumPy float32: binned, added or averaged as the mode says."""
        if self.sensor.binning != (1, 1):
            mean = self._binned(mean)
        mean = np.array(self.device.numpy(mean), np.float32)
        return mean / np.float32(prod(self.sensor.binning)) if self._digital else mean

    def draw(
        self, chip_mean, exposure_time: float, gain: float = 1.0, seed=0, frame=0, frames=None
    ) -> Any:
        """Raw values (rows, cols), or (frames, rows, cols), around `chip_mean` electrons (see the method).

        gain: analog, beside the sensor's [1]. Returns an array of the device: uint16, or float32 without a converter.
        Raises DoesNotFit, OutOfRange.
        """
        if frames is not None:
            needed = (
                int(frames) * prod(chip_mean.shape) * (4 if self.sensor.bits == FLOAT_BITS else 2)
            )
            if needed > self.device.memory:
                raise DoesNotFit(f"{frames} frames", needed, self.device.memory, self.device.name)
        raw = self._read(
            chip_mean,
            exposure_time,
            self.operated(gain),
            sigma=self.operated(gain).read_sigma,
            photon=self.sensor.noise.photon,
            seed=seed,
            frame=frame,
            frames=frames,
        )
        if not self._digital:
            return raw
        if frames is None:
            return self._binned(raw, average=True)
        return self.device.stack(
            [
                self._binned(self.device.part(raw, number), average=True)
                for number in range(raw.shape[0])
            ]
        )

    @property
    def draws_at_once(self) -> bool:
        """Whether the stage `sensor.noise` is all that `draw` takes for one frame."""
        return not self._digital and self.device.kind != "numpy"

    def draw_again(self, tape, shape, *, seed=0, frame=0) -> Any:
        """Raw values (rows, cols) of another frame, by what `draw` noted on a tape for one: see `draws_at_once`."""
        kind = np.float32 if self.sensor.bits == FLOAT_BITS else np.uint16
        raw = self.device.empty((1, *shape), kind)
        redraw(tape, seed, frame, out=raw)
        tape.replay()
        return self.device.reshape(raw, shape)

    def draw_electrons(
        self,
        mean,
        exposure_time: float,
        *,
        gain: float = 1.0,
        seed: int = 0,
        frame: int = 0,
        frames: int | None = None,
    ) -> np.ndarray:
        """Raw values around your own mean electrons of `exposure_time` [s], NumPy; else as `draw`.

        mean: of every pixel, not binned, shape (rows, cols) or, of stacked pixels, (C, rows, cols) [e-]. Raises
        OutOfRange for electrons that are not finite or negative, BadData.
        """
        checked_time(exposure_time)
        mean = checked_electrons(mean, len(self.sensor.channels) if self.sensor.stacked else None)
        self.output_shape(mean.shape[-2:])
        chip_mean = self.chip_mean(self.device.array(mean), exposure_time)
        raw = np.array(
            self.device.numpy(
                self.draw(
                    chip_mean, exposure_time, gain=gain, seed=seed, frame=frame, frames=frames
                )
            )
        )
        return raw.reshape(*raw.shape[:-2], *mean.shape[:-2], -1, raw.shape[-1])

    def numbers(self, exposure_time: float, gain: float) -> dict[str, float]:
        """What `draw` tells the stage `sensor.noise` that depends on exposure time [s] and analog gain."""
        sensor = self.operated(gain)
        return {
            "dark_electrons": self.dark_electrons(exposure_time),
            "read_noise": sensor.read_sigma,
            "gain": sensor.gain_dn_per_electron,
            "black_level": sensor.dark_level,
        }

    def average(
        self, chip_mean, exposure_time: float, count: int, *, gain: float = 1.0, seed=0, first=0
    ) -> Any:
        """Mean raw values of `count` frames, float64: whole numbers are added as such, so that nothing is lost."""
        count = checked_count("count of averaged frames", count)
        total, kind = 0, np.float64 if self.sensor.bits == FLOAT_BITS else np.uint64
        batch = max(1, min(BATCH // prod(chip_mean.shape), 2**15, count))
        for start in range(0, count, batch):
            raw = self.draw(
                chip_mean,
                exposure_time,
                gain=gain,
                seed=seed,
                frame=first + start,
                frames=min(batch, count - start),
            )
            total = total + self.device.numpy(raw).sum(axis=0, dtype=kind)
        return total / count

    def nondestructive(
        self, mean, exposure_time: float, times, *, gain: float = 1.0, seed=0, frame=0
    ) -> np.ndarray:
        """Raw values of reads that leave the charge in the pixels, NumPy (reads, rows, cols).

        mean: electrons of `exposure_time` [s], see `chip_mean`. times: of the reads since the reset [s], rising. The
        reads see one growing charge, photon by photon, and share the reset's noise; each has its own read noise.
        """
        times = self.checked_reads(times)
        sensor, device, noise_ = self.operated(gain), self.device, self.sensor.noise
        common = {
            "gain": 1.0,
            "full_well": MOST,
            "electrons": True,
            "seed": seed,
            "frame": frame,
            "device": device,
        }
        reads, previous = [], 0.0
        charge: Any = np.float32(0)
        for number, time in enumerate(times):
            step = time - previous
            more = self.chip_mean(mean, step, step / exposure_time)
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
            # the kernel takes no negative electrons: what the reset leaves below 0 is part of the offset
            sigma = np.hypot(noise_.read, noise_.adc / sensor.gain_dn_per_electron)
            raw = self._read(
                device.array(charge),
                0.0,
                sensor,
                sigma=float(sigma),
                photon="none",
                seed=seed,
                frame=frame,
                read=number,
                offset=reset,
            )
            reads.append(np.array(device.numpy(raw)))
            previous = time
        return np.stack(reads)

    def checked_reads(self, times) -> np.ndarray:
        """Times of reads that leave the charge [s]. Raises BadData, OutOfRange."""
        try:
            times = np.asarray(times, np.float64)
        except (TypeError, ValueError):
            raise BadData(f"times of the reads = {times!r}: wanted numbers [s]") from None
        if (
            times.ndim != 1
            or not times.size
            or not (np.isfinite(times) & (np.diff(times, prepend=0.0) > 0)).all()
        ):
            raise OutOfRange(
                "times of the reads",
                times.tolist(),
                "one or more finite times, rising from above 0 s",
            )
        if self._digital:
            raise BadData(
                'non-destructive reads: the sensor bins digital numbers; wanted binning_mode = "charge"'
            )
        return times

    def models(self) -> dict[str, str]:
        """Stage -> what is modelled; a part that is off has no stage and no name."""
        sensor, noise_ = self.sensor, self.sensor.noise
        found = {}
        fixed = [
            name
            for name, on in (
                ("PRNU", noise_.prnu or noise_.row_prnu or noise_.column_prnu),
                ("DSNU", noise_.dsnu or noise_.row_dsnu or noise_.column_dsnu),
                ("dead pixels", noise_.dead_pixels),
                ("hot pixels", noise_.hot_pixels and noise_.hot_current),
                ("traps", noise_.telegraph_pixels and noise_.telegraph),
            )
            if on
        ]
        if fixed:
            found["sensor.pattern"] = f"{', '.join(fixed)} of chip {noise_.seed}"
        if {"PRNU", "dead pixels", "hot pixels"} & {*fixed}:
            found["sensor.chip"] = "mean electrons through this chip's response"
        if sensor.binning != (1, 1):
            found["sensor.bin"] = (
                f"{sensor.binning[0]}x{sensor.binning[1]} pixels by {sensor.binning_mode}"
            )
        temporal = [
            name
            for name, on in (
                (f"photon ({noise_.photon})", noise_.photon != "none"),
                ("dark current", noise_.dark_current),
                ("read", noise_.read),
                ("reset", noise_.reset),
                ("converter", noise_.adc),
                ("rows", noise_.row),
                ("columns", noise_.column),
                ("telegraph", "traps" in fixed),
            )
            if on
        ]
        converter = "no converter" if sensor.bits == FLOAT_BITS else f"{sensor.bits} bit"
        found["sensor.noise"] = f"{', '.join(temporal) or 'no noise'}; full well, {converter}"
        return found

    def _read(
        self,
        chip_mean,
        exposure_time,
        sensor,
        *,
        sigma,
        photon,
        seed,
        frame,
        frames=None,
        read=0,
        offset=None,
    ):
        """Raw values of the output sensor; offset: added to that of the chip [e-]."""
        noise_, device = sensor.noise, self.device
        rows, cols = chip_mean.shape
        fixed = amplitude = None
        if noise_.dsnu or noise_.row_dsnu or noise_.column_dsnu:
            fixed = self._pattern(
                "offset",
                rows,
                cols,
                pixel=noise_.dsnu,
                row=noise_.row_dsnu,
                column=noise_.column_dsnu,
            )
        if offset is not None:
            fixed = device.array(offset if fixed is None else offset + device.numpy(fixed))
        if noise_.telegraph_pixels and noise_.telegraph:
            amplitude = self._pattern(
                "telegraph", rows, cols, share=noise_.telegraph_pixels, scale=noise_.telegraph
            )
        return noise(
            chip_mean,
            fixed,
            amplitude,
            dark_electrons=self.dark_electrons(exposure_time),
            read_noise=sigma,
            row_noise=noise_.row,
            column_noise=noise_.column,
            telegraph_switching=noise_.telegraph_switching,
            full_well=sensor.full_well,
            gain=sensor.gain_dn_per_electron,
            black_level=sensor.dark_level,
            white_level=None if sensor.bits == FLOAT_BITS else sensor.white_level,
            photon=photon,
            seed=seed,
            frame=frame,
            frames=frames,
            read=read,
            device=device,
        )

    def dark_time(self, exposure_time: float) -> float:
        """The time [s] in which dark current at the table's temperature would collect what it does in an exposure."""
        return min(exposure_time * self.sensor.noise.warmth, MOST)

    def dark_electrons(self, exposure_time: float) -> float:
        """Mean dark charge that all of the output's pixels have in common [e-]."""
        noise_ = self.output.noise
        return min(noise_.dark_current * noise_.warmth * exposure_time, MOST)

    def _binned(self, pixels, average=False):
        return bin_pixels(
            pixels,
            binning=self.sensor.binning,
            stride=self.stride,
            average=average,
            device=self.device,
        )

    def _response(self, rows, cols):
        """Relative response of every pixel, None where all are alike."""
        noise_ = self.sensor.noise
        if not (noise_.prnu or noise_.row_prnu or noise_.column_prnu or noise_.dead_pixels):
            return None
        return self._pattern(
            "response",
            rows,
            cols,
            mean=1.0,
            pixel=noise_.prnu,
            row=noise_.row_prnu,
            column=noise_.column_prnu,
            dead=noise_.dead_pixels,
        )

    def _dark(self, rows, cols):
        """Dark current of hot pixels beyond the common one [e- s-1], None where there are none."""
        noise_ = self.sensor.noise
        if not (noise_.hot_pixels and noise_.hot_current):
            return None
        return self._pattern("dark", rows, cols, share=noise_.hot_pixels, scale=noise_.hot_current)

    def _pattern(self, plane, rows, cols, **parts):
        """A fixed pattern on the device, kept from its first use."""
        seed, device = self.sensor.noise.seed, self.device
        return self._kept(
            f"pattern of {plane}",
            (rows, cols, seed, *parts.values()),
            lambda: device.array(pattern(rows, cols, plane, seed=seed, device=device, **parts)),
        )


def checked_electrons(mean, layers: int | None) -> np.ndarray:
    """Mean electrons that can be drawn around, float32; layers: of stacked pixels, None of a mosaic.

    Raises BadData, OutOfRange for what is not finite or negative.
    """
    try:
        mean = np.asarray(mean, np.float32)
    except (TypeError, ValueError):
        raise BadData("mean electrons: wanted an array of numbers") from None
    if mean.shape[:-2] != (() if layers is None else (layers,)) or mean.ndim < 2 or not mean.size:
        wanted = (
            "(rows, cols)"
            if layers is None
            else f"({layers}, rows, cols), the sensor's pixels being stacked"
        )
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

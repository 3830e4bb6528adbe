"""A camera's image processor on a device: from digital numbers to a picture."""

from dataclasses import dataclass, replace

import numpy as np

from gpusim.backends import Device
from gpusim.color.encoding import decoding
from gpusim.color.rendering import Rendering, rebalanced, transforms_of
from gpusim.domain.camera import Camera
from gpusim.domain.raw_noise import RawNoise
from gpusim.domain.sensor import FLOAT_BITS
from gpusim.kernels.display.encode import encode, thresholds
from gpusim.kernels.processor.adaptive import adaptive
from gpusim.kernels.processor.best import best
from gpusim.kernels.processor.bilinear import bilinear
from gpusim.kernels.processor.color import color
from gpusim.kernels.processor.defects import defects
from gpusim.kernels.processor.denoise import denoise
from gpusim.kernels.processor.develop import develop
from gpusim.kernels.processor.interpolate import interpolate
from gpusim.kernels.processor.learned import learned
from gpusim.kernels.processor.levels import CORRECTED_BLACK, CORRECTED_WHITE, MOST_BALANCE
from gpusim.kernels.processor.linear import linear
from gpusim.kernels.processor.malvar import malvar
from gpusim.kernels.processor.quantise import quantise
from gpusim.kernels.processor.shade import shade
from gpusim.kernels.processor.thumbnail import thumbnail

STANDS_OUT = 6.0  # [sigma] of noise by which a defective pixel exceeds its neighbours
CLIPPED = 0.95  # of saturation: values interpolated beside a clipped pixel lie just below it


@dataclass(frozen=True)
class _Numbers:
    """What digital numbers mean: those of black and white [DN], and their noise (see `Developer.noise`)."""

    black: float
    white: float
    noise: tuple[float, float]

    @property
    def scale(self):
        return 1 / (self.white - self.black)

    def corrected(self):
        """The same on the scale of corrected mosaics."""
        span = (CORRECTED_WHITE - CORRECTED_BLACK) * self.scale
        return _Numbers(
            CORRECTED_BLACK, CORRECTED_WHITE, (self.noise[0] * span, self.noise[1] * span)
        )


def edges_of(camera: Camera) -> np.ndarray:
    """Linear display values at which the next display code begins, after the tone curve, shape (255,)."""
    return thresholds(decoding(camera.display, camera.processor.tone))


class Developer:
    """The image processor of a camera on a device.

    camera: as operated (see `gpusim.pipeline.simulator.Exposure`). averaged: raw values whose mean each of its values
    is (digital binning). transforms: function that gives colour transforms of a set of lights; by default, the
    camera's. edges: the thresholds of the display's codes, by default computed: see `edges_of`.
    """

    def __init__(
        self, camera: Camera, device: Device, averaged: int = 1, transforms=None, edges=None
    ):
        self.camera, self.device, self.averaged = camera, device, averaged
        self._transforms = transforms or (lambda: transforms_of(camera))
        self._thresholds = edges_of(camera) if edges is None else edges

    @property
    def noise(self) -> tuple[float, float]:
        """(gain [DN/e-], noise without light [DN]) of raw values: their variance is gain (DN - dark level) + noise^2.

        Without light: all that `RawNoise.variance` adds, fixed offsets too. PRNU is left out.
        """
        noise, gain = (
            RawNoise.of(self.camera.sensor, self.averaged),
            self.camera.sensor.gain_dn_per_electron,
        )
        return gain * noise.photons / noise.averaged, gain * noise.variance() ** 0.5

    def demosaicked(self, raw, *, white=None, known=None, shading=None, blur: float = 0.0):
        """Camera values of every pixel, (C, rows, cols), or what the table of learned filters gives; white level 1.

        raw: digital numbers (rows, cols), the layers of stacked pixels one below the other. white: camera values of
        white, any scale, shape (C,), by which colours are compared (None: as they come); what comes out keeps its own
        scale, so that clipped values are told from others as before. known: map of the chip's
        defective pixels, of the same shape, and shading, the correction's gains at its nodes, (positions, ny, nx) for
        the pixels of the mosaic's period, where these are asked for. blur: of the lens [pixel], see `best`.
        """
        sensor, processor, device = self.camera.sensor, self.camera.processor, self.device
        if sensor.stacked:
            count = len(sensor.channels)
            size = raw.shape[0] // count
            stack = device.reshape(raw, (count, size, raw.shape[1]))
            flags, planes = (
                None if known is None else device.reshape(self._flags(known), stack.shape),
                [],
            )
            for layer in range(count):
                one, numbers = self._corrected(
                    device.part(stack, layer),
                    np.zeros((1, 1), np.int32),
                    None if flags is None else device.part(flags, layer),
                    None if shading is None else shading[layer : layer + 1],
                )
                planes.append(
                    linear(one, black_level=numbers.black, scale=numbers.scale, device=device)
                )
            return device.reshape(device.stack(planes), (count, size, raw.shape[1]))
        raw, numbers = self._corrected(raw, sensor.cfa_indices, known, shading)
        options = {"black_level": numbers.black, "scale": numbers.scale, "device": device}
        if sensor.is_monochrome:
            return linear(raw, **options)
        if processor.demosaic == "learned":
            noise = (
                numbers.noise if numbers.noise[0] else (0.0, 0.0)
            )  # its roots know read noise beside shot noise
            # a camera's own filters were learned from channels as they come, in its light
            balance = (1.0, 1.0) if processor.table else self._balance(white)
            return learned(
                raw,
                phase=sensor.cfa,
                noise=noise,
                table=processor.table,
                balance=balance,
                **options,
            )
        if not sensor.bayer_phase:
            return interpolate(raw, cfa=sensor.cfa_indices, **options)
        phase = "".join(sensor.cfa)
        if processor.demosaic == "bilinear":  # every channel by itself
            return bilinear(raw, phase=phase, **options)
        options["balance"] = self._balance(white)
        if processor.demosaic == "best":
            return best(raw, phase=phase, noise=numbers.noise, blur=blur, **options)
        return {"malvar": malvar, "adaptive": adaptive}[processor.demosaic](
            raw, phase=phase, **options
        )

    def _flags(self, known):
        """A map of defects on the device."""
        device = self.device
        return (
            known
            if isinstance(known, device.array_type)
            else device.array(np.asarray(known) != 0, np.uint8)
        )

    def _balance(self, white) -> tuple[float, float]:
        """Factors of red and blue that make white as strong in them as in green."""
        if white is None:
            return 1.0, 1.0
        red, green, blue = (
            float(white[self.camera.sensor.channels.index(letter)]) for letter in "RGB"
        )
        most = MOST_BALANCE  # a channel that hardly sees white, or the only one that does, is not amplified beyond that
        if not green > 0:
            return 1.0, 1.0
        red, blue = (min(max(other, green / most), green * most) for other in (red, blue))
        return green / red, green / blue

    def _corrected(self, raw, mosaic, known, shading):
        """Raw values without defects, noise and shading as the camera asks, and what their numbers mean.

        Noise is that where the shading's gain is 1, and none after denoising.
        """
        sensor, processor, device = self.camera.sensor, self.camera.processor, self.device
        numbers = _Numbers(sensor.dark_level, sensor.white_level, self.noise)
        if sensor.bits == FLOAT_BITS:
            raw = quantise(raw, black_level=numbers.black, scale=numbers.scale, device=device)
            numbers = numbers.corrected()
        if processor.defects != "none":
            raw = defects(
                raw,
                known,
                cfa=mosaic,
                detect=STANDS_OUT if processor.defects == "detect" else None,
                noise=numbers.noise,
                black_level=numbers.black,
                device=device,
            )
        if processor.denoise:
            raw = denoise(
                raw,
                cfa=mosaic,
                black_level=numbers.black,
                scale=numbers.scale,
                noise=numbers.noise,
                strength=processor.denoise,
                device=device,
            )
            numbers = replace(numbers.corrected(), noise=(0.0, 0.0))
        if shading is not None:
            positions = np.arange(mosaic.size, dtype=np.int32).reshape(mosaic.shape)
            raw = shade(
                raw,
                shading,
                cfa=positions,
                black_level=numbers.black,
                scale=numbers.scale,
                device=device,
            )
            numbers = numbers.corrected()
        return raw, numbers

    def in_one_pass(self, raw, rendering: Rendering):
        """Display codes (rows, cols, 3) of raw values, as by `encoded`, of a camera that `is_developed_at_once`."""
        sensor = self.camera.sensor
        return develop(
            raw,
            self.device.array(rendering.display_from_camera),
            self._thresholds,
            phase="".join(sensor.cfa),
            black_level=sensor.dark_level,
            scale=1 / (sensor.white_level - sensor.dark_level),
            ceiling=rendering.ceiling,
            device=self.device,
        )

    def balanced(self, planes, once: Rendering) -> Rendering:
        """The rendering for the white that the picture suggests, where the camera estimates it; else `once`."""
        if not self.camera.processor.estimates_white:
            return once
        processor, scale = (
            self.camera.processor,
            1 / (self.camera.sensor.white_level - self.camera.sensor.dark_level),
        )
        wanted = processor.color != "none" or processor.white_balance == "red-blue"
        small = self.device.numpy(thumbnail(planes, CLIPPED * once.saturation, device=self.device))
        return rebalanced(
            once, self.camera, self._transforms() if wanted else None, small, self.noise[1] * scale
        )

    def colored(self, planes, rendering: Rendering):
        """Linear display RGB (3, rows, cols), before the tone curve."""
        return color(
            planes,
            self.device.array(rendering.display_from_camera),
            ceiling=rendering.ceiling,
            device=self.device,
        )

    def encoded(self, linear_rgb):
        """Display codes (rows, cols, 3) of linear display RGB."""
        return encode(linear_rgb, self._thresholds, device=self.device)

    def models(self) -> dict[str, str]:
        """Stage -> what it does, in the order of their use."""
        sensor, processor = self.camera.sensor, self.camera.processor
        made = {}
        if sensor.bits == FLOAT_BITS:
            made["processor.quantise"] = f"to {CORRECTED_WHITE + 1} numbers"
        if processor.defects != "none":
            made["processor.defects"] = {
                "known": "the chip's known defects replaced",
                "detect": f"pixels {STANDS_OUT:g} sigma beyond their neighbours replaced",
            }[processor.defects]
        if processor.denoise:
            made["processor.denoise"] = f"denoised, strength {processor.denoise:g}"
        if processor.shading:
            made["processor.shade"] = "lens shading divided out"
        if sensor.is_monochrome or sensor.stacked:
            made["processor.linear"] = (
                "monochrome" if sensor.is_monochrome else "stacked: all channels"
            )
        elif processor.demosaic == "learned":
            made["processor.learned"] = "learned local linear filters" + (
                "" if processor.table else ", built in"
            )
        elif sensor.bayer_phase:
            made[f"processor.{processor.demosaic}"] = f"{processor.demosaic} demosaicking"
        else:
            made["processor.interpolate"] = "weighted means of each channel's neighbours"
        if processor.estimates_white:
            made["processor.thumbnail"] = f"white by {processor.white_balance}"
        return made

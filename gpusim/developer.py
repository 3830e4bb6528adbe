"""A camera's image processor on a device: from digital numbers to a picture."""

import functools
from math import hypot

import numpy as np

from gpusim.backends import Device
from gpusim.domain.camera import Camera
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
from gpusim.kernels.processor.levels import CORRECTED_BLACK, CORRECTED_WHITE
from gpusim.kernels.processor.linear import linear
from gpusim.kernels.processor.malvar import malvar
from gpusim.kernels.processor.shade import shade
from gpusim.kernels.processor.thumbnail import thumbnail
from gpusim.planner.encoding import decoding
from gpusim.planner.rendering import Rendering, balanced, transforms_of

STANDS_OUT = 6.0  # [sigma] of noise by which a defective pixel exceeds its neighbours
CLIPPED = 0.95  # of saturation: values interpolated beside a clipped pixel lie just below it


class Developer:
    """The image processor of a camera on a device.

    camera: as operated (see `gpusim.scheduler.Exposure`).
    """

    def __init__(self, camera: Camera, device: Device):
        self.camera, self.device = camera, device
        self._thresholds = thresholds(decoding(camera.display, camera.processor.tone))

    @property
    def noise(self) -> tuple[float, float]:
        """(gain [DN/e-], read noise [DN]) of the raw values, as demosaicking and denoising want it."""
        sensor = self.camera.sensor
        if sensor.noise.photon == "none":
            return 0.0, 0.0
        gain, rounding = sensor.gain_dn_per_electron, 0.0 if sensor.bits == FLOAT_BITS else 1 / 12
        return gain, hypot(gain * sensor.read_sigma, rounding**0.5)

    def demosaicked(self, raw, *, known=None, gains=None, blur: float = 0.0):
        """Camera values of every pixel, (C, rows, cols), or what the table of learned filters gives; white level 1.

        raw: digital numbers (rows, cols), the layers of stacked pixels one below the other. known: map of the chip's
        defective pixels, of the same shape, and gains of the shading correction at its nodes, where these are asked
        for. blur: of the lens [pixel], see `best`.
        """
        sensor, processor, device = self.camera.sensor, self.camera.processor, self.device
        black, white, (gain, read) = sensor.dark_level, sensor.white_level, self.noise
        mosaic = np.zeros((1, 1), np.int32) if sensor.stacked else sensor.cfa_indices
        if sensor.bits == FLOAT_BITS:
            span = (CORRECTED_WHITE - CORRECTED_BLACK) / (white - black)
            values = (device.numpy(raw) - black) * span + CORRECTED_BLACK
            raw = device.array(np.rint(np.clip(values, 0, CORRECTED_WHITE)), np.uint16)
            black, white, gain, read = CORRECTED_BLACK, CORRECTED_WHITE, gain * span, read * span
        if processor.defects != "none":
            raw = defects(raw, known, cfa=mosaic, detect=STANDS_OUT if processor.defects == "detect" else None,
                          noise=(gain, read), black_level=black, device=device)
        if processor.denoise:
            raw = denoise(raw, cfa=mosaic, black_level=black, scale=1 / (white - black), noise=(gain, read),
                          strength=processor.denoise, device=device)
            black, white, gain, read = CORRECTED_BLACK, CORRECTED_WHITE, 0.0, 0.0
        if gains is not None:
            span = (CORRECTED_WHITE - CORRECTED_BLACK) / (white - black)
            raw = shade(raw, gains, cfa=mosaic, black_level=black, scale=1 / (white - black), device=device)
            black, white, gain, read = CORRECTED_BLACK, CORRECTED_WHITE, gain * span, read * span
        numbers = {"black_level": black, "scale": 1 / (white - black), "device": device}
        if sensor.is_monochrome or sensor.stacked:
            planes = linear(raw, **numbers)
            layers = len(sensor.channels) if sensor.stacked else 1
            return device.reshape(planes, (layers, planes.shape[-2] // layers, planes.shape[-1]))
        if processor.demosaic == "learned":
            return learned(raw, phase=sensor.cfa, noise=(gain, read), table=processor.table, **numbers)
        if not sensor.bayer_phase:
            return interpolate(raw, cfa=mosaic, **numbers)
        phase = "".join(sensor.cfa)
        if processor.demosaic == "best":
            return best(raw, phase=phase, noise=(gain, read), blur=blur, **numbers)
        return {"bilinear": bilinear, "malvar": malvar, "adaptive": adaptive}[processor.demosaic](
            raw, phase=phase, **numbers)

    def in_one_pass(self, raw, rendering: Rendering):
        """Display codes (rows, cols, 3) of raw values, the same as by `shown`; None where that takes several passes."""
        sensor, processor = self.camera.sensor, self.camera.processor
        if (processor.demosaic != "bilinear" or not sensor.bayer_phase or sensor.stacked or sensor.bits == FLOAT_BITS
                or processor.defects != "none" or processor.denoise or processor.shading or processor.estimates_white):
            return None
        return develop(raw, self.device.array(rendering.display_from_camera), self._thresholds,
                       phase="".join(sensor.cfa), black_level=sensor.dark_level, scale=self._scale,
                       ceiling=rendering.ceiling, device=self.device)

    def balanced(self, planes, once: Rendering) -> Rendering:
        """The rendering for the white that the picture suggests, where the camera estimates it; else `once`."""
        if not self.camera.processor.estimates_white:
            return once
        small = self.device.numpy(thumbnail(planes, CLIPPED * once.saturation, device=self.device))
        return balanced(once, self.camera, self._transforms, small, self.noise[1] * self._scale)

    @functools.cached_property
    def _transforms(self):
        return transforms_of(self.camera)

    @property
    def _scale(self):
        return 1 / (self.camera.sensor.white_level - self.camera.sensor.dark_level)

    def shown(self, planes, rendering: Rendering):
        """Linear display RGB (3, rows, cols), before the tone curve, and display codes (rows, cols, 3)."""
        linear_rgb = color(planes, self.device.array(rendering.display_from_camera), ceiling=rendering.ceiling,
                           device=self.device)
        return linear_rgb, encode(linear_rgb, self._thresholds, device=self.device)

    def models(self) -> dict[str, str]:
        """Stage -> what it does, in the order of their use."""
        sensor, processor = self.camera.sensor, self.camera.processor
        made = {}
        if processor.defects != "none":
            made["processor.defects"] = {"known": "the chip's known defects replaced",
                                         "detect": f"pixels {STANDS_OUT:g} sigma beyond their neighbours replaced"}[
                                             processor.defects]
        if processor.denoise:
            made["processor.denoise"] = f"denoised, strength {processor.denoise:g}"
        if processor.shading:
            made["processor.shade"] = "lens shading divided out"
        if sensor.is_monochrome or sensor.stacked:
            made["processor.linear"] = "monochrome" if sensor.is_monochrome else "stacked: all channels"
        elif processor.demosaic == "learned":
            made["processor.learned"] = "learned local linear filters" + ("" if processor.table else ", built in")
        elif sensor.bayer_phase:
            made[f"processor.{processor.demosaic}"] = f"{processor.demosaic} demosaicking"
        else:
            made["processor.interpolate"] = "weighted means of each channel's neighbours"
        if processor.estimates_white:
            made["processor.thumbnail"] = f"white by {processor.white_balance}"
        return made

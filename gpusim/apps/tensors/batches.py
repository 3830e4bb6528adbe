"""Batches of pictures, as tensors, to frames of a camera: what loops of machine learning call.

Not differentiable: no gradient goes through a frame, whose noise is drawn and whose values are rounded.
"""

import sys
from collections import OrderedDict
from typing import Any

import numpy as np

from gpusim.data.lights import illuminant, white_radiance
from gpusim.data.srgb import srgb_primaries
from gpusim.domain.content import Basis, Content, Cube
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.foreign import described, to_host, type_of
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.short_repr import shortened
from gpusim.io.scene.scenes import LIGHT, LUMINANCE
from gpusim.pipeline.batch import one_each
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.plan import Plan

SHAPES = 4  # of batches whose programs are kept
GREY = 0.18  # reflectance of the scene that plans are made for
LIBRARIES = ("torch", "cupy")  # whose arrays are given back where they were given
PICTURES = ("linear", "xyz", "codes")  # outputs that are RGB or XYZ of a display


class Batch:
    """Frames of batches of pictures by a camera on a device. Not differentiable.

    Channels come first in what is given and in what is made, (B, C, rows, cols), as networks take them.
    output: a name of `gpusim.pipeline.outputs.OUTPUTS`, such as "raw", "linear" or "codes". wavelengths: of the
    pictures' channels [nm], shape (L,); None: linear sRGB (3 channels) or grey (1). light: name for `illuminant` in
    which the pictures are reflectances, white 1; None: of spectral ones, whose values are radiance
    [W sr-1 m-2 nm-1]. luminance: of white in it [cd m-2]. tolerance: as for `Simulator`: a plan for each picture, which
    takes time; without one there is one for each shape. plan: for all pictures, see `Simulator`. options: of every
    Scene, such as border.
    A frame depends on its picture, its settings, its number, the seed and the plan, and on nothing else of its batch:
    any number of workers makes the same data. plans: by which the pictures of the last call were made, one for each; a
    plan's `scene` is one. Raises as `Simulator` does, BadData, OutOfRange for the light.
    """

    def __init__(
        self,
        camera,
        *,
        device="auto",
        output: str = "raw",
        wavelengths=None,
        light: str | None = LIGHT,
        luminance: float = LUMINANCE,
        tolerance=None,
        plan: Plan | None = None,
        **options,
    ):
        self.simulator = Simulator(camera, device=device, tolerance=tolerance)
        self.simulator.batch(1, output)  # which knows the outputs
        self.output, self._options, self._plan = output, options, plan
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
        return shortened(f"Batch({self.output}, {self.simulator!r})")

    def __call__(
        self, pictures, *, first: int = 0, seed: int = 0, exposure_time=None, gain=1.0, camera=None
    ) -> Any:
        """Frames of pictures (B, C, rows, cols), floats, not negative: (B, rows, cols) or (B, C, rows, cols).

        They are a new array, torch's or cupy's where the pictures are, on a Warp device in its memory; else NumPy's.
        Codes are (B, 3, rows, cols) with the channels last in memory. first: number of the first picture among all, by
        which, with the seed, its noise is drawn.
        exposure_time [s], gain: as for `Simulator.expose`. camera: whose noise, white point, lens and other settings
        are other ones. Each of the three may be one for every picture, too. Automatic exposure meters each picture.
        Raises as `Simulator.frames` does, and BadData for pictures of other shapes and types.
        """
        values = described(pictures, "pictures")
        shape, channels = (
            tuple(values.shape),
            (1, 3) if self.wavelengths is None else (len(self.wavelengths),),
        )
        if len(shape) != 4 or 0 in shape or shape[1] not in channels:
            raise BadData(
                f"pictures: {shape}, wanted (pictures, channels, rows, cols), "
                f"{' or '.join(map(str, channels))} channels"
            )
        if type_of(values) not in (np.float16, np.float32, np.float64):
            raise BadData(
                f"pictures: values of type {values.dtype}, wanted floats: linear light, not codes"
            )
        lowest = (
            values.min().item() if hasattr(values, "min") else 0
        )  # only the device knows those of Warp
        if not lowest >= 0:
            found = "negative light" if lowest < 0 else "NaN"
            raise BadData(f"pictures: {found} (lowest {lowest:.4g}), wanted 0 or more")
        scenes = [self._scene(values[item]) for item in range(shape[0])]
        settings = {
            "camera": camera,
            "exposure_time": _listed(exposure_time),
            "gain": _listed(gain),
        }
        if self.simulator.tolerance is None or self._plan is not None:
            batch = self._batch(shape)
            frames = batch(scenes, seed=seed, frame=first, **settings)
            self.plans = batch.plans
            return self._given_back(pictures, frames)
        each = {name: one_each(name, value, len(scenes)) for name, value in settings.items()}
        batches, frames = [self.simulator.batch(1, self.output) for _ in scenes], []
        for item, (batch, scene) in enumerate(zip(batches, scenes, strict=True)):
            one = batch(
                scene,
                seed=seed,
                frame=first + item,
                **{name: given[item] for name, given in each.items()},
            )
            frames.append(np.array(self.simulator.device.numpy(one)))
        self.plans = [batch.plans[0] for batch in batches]
        return self._given_back(pictures, np.concatenate(frames))

    def _given_back(self, pictures, frames):
        made = _as(pictures, self.simulator.device, frames)
        return moved(made, -1, 1) if self.output == "codes" else made

    def _scene(self, values) -> Scene:
        content: Content
        if self.wavelengths is not None:
            content = Cube(self.wavelengths, values)
        else:
            basis = srgb_primaries()
            content = Basis(
                basis.wavelengths,
                values,
                basis.values if values.shape[0] == 3 else np.ones((1, len(basis.wavelengths))),
            )
        return Scene(content, self._light, name="picture", **self._options)

    def _batch(self, shape):
        """Programs for batches of this shape; those of the last SHAPES are kept."""
        if shape not in self._batches:
            grey = self._scene(np.full(shape[1:], GREY, np.float32))
            self._batches[shape] = self.simulator.batch(
                shape[0], self.output, planned_for=grey, plan=self._plan
            )
            if len(self._batches) > SHAPES:
                self._batches.popitem(last=False)
        self._batches.move_to_end(shape)
        return self._batches[shape]


def _listed(values):
    """Numbers of another library's array as Python's, and anything else as it is."""
    return to_host(values, "settings").tolist() if hasattr(values, "shape") else values


def moved(array, axis: int, to: int):
    """An array of NumPy or of LIBRARIES with an axis in another place; a view."""
    return _library_of(array).moveaxis(array, axis, to)


def _library_of(array):
    """The module of an array of LIBRARIES, NumPy for others."""
    name = type(array).__module__.partition(".")[0]
    return sys.modules[name] if name in LIBRARIES else np


def _as(pictures, device, frames):
    """A copy of frames as an array of the pictures' library, on the device where it can be there."""
    library = _library_of(pictures)
    if library is np:
        return np.array(device.numpy(frames))
    is_torch = library.__name__ == "torch"
    if not isinstance(frames, np.ndarray) and device.kind == "warp":
        # a copy by this device, in its turn: what the other library copied might be late for the next batch
        return library.from_dlpack(device.reshape(device.stack([frames]), frames.shape))
    copied = np.array(device.numpy(frames))
    return library.from_numpy(copied).to(pictures.device) if is_torch else library.asarray(copied)

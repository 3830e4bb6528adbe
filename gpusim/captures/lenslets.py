"""Light behind an array of lenslets, from the light of the pupil's cells in the array's plane."""

from typing import Any

import numpy as np

from gpusim.backends import Device
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData
from gpusim.kernels.sensor.lenslets import lenslets
from gpusim.optics.lenslets import LensletSamples, lenslet_plane


def apply_lenslets(device: Device, rates: Any, camera: Camera, samples: LensletSamples) -> Any:
    """Return the light that every pixel behind the lenslets gets.

    The sum over pixels is the light of the samples within clear apertures, times the pixels' fill factor, without light
    that falls outside the sensor.

    Args:
        device: The device that computes.
        rates: Electrons per second through each cell of the pupil in each sample [e- s-1], a NumPy array (cells_y,
            cells_x, channels, rows, cols), or an array of the device, which has four axes at most, (cells_y, cells_x *
            channels, rows, cols). Cell (j, i) covers the pupil from -1 + 2 j / cells_y on along y, so too along x.
        camera: A camera whose sensor has lenslets.
        samples: The samples: `lenslet_samples`.

    Returns:
        Electrons per second of every pixel in its own channel, (1, rows, cols), float32, an array of the device; all
        channels, (channels, rows, cols), if the pixels are stacked.

    Raises:
        BadData: The sensor has no lenslets, or the rates do not fit.
    """
    sensor = camera.sensor
    if sensor.lenslets is None:
        raise BadData("sensor.lenslets: the camera has none; set [sensor] lenslets")
    count, shape = len(sensor.channels), tuple(rates.shape)
    if len(shape) == 5 and shape[2] == count:
        shape = (shape[0], shape[1] * count, *shape[3:])
        rates = np.reshape(rates, shape)
    if len(shape) != 4 or shape[1] % count or shape[2:] != tuple(samples.shape):
        raise BadData(
            f"rates: shape {tuple(rates.shape)}; wanted (cells_y, cells_x, {len(sensor.channels)} channels, "
            f"{samples.shape[0]}, {samples.shape[1]})"
        )
    plane = lenslet_plane(sensor, camera.optics, samples)
    rates = device.array(rates)
    if not sensor.stacked:
        return lenslets(rates, sensor.cfa_indices, plane, samples.pixels, device=device)
    channels = [
        lenslets(rates, np.array([[channel]], np.int32), plane, samples.pixels, device=device)
        for channel in range(len(sensor.channels))
    ]
    return device.reshape(device.stack(channels), (len(channels), *samples.pixels))

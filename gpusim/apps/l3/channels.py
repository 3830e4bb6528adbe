"""The channels of a mosaic as sums of a photograph's red, green and blue."""

from dataclasses import replace

import numpy as np

from gpusim.data.lights import illuminant
from gpusim.data.srgb import srgb_primaries
from gpusim.data.weights import product_weights
from gpusim.domain.guided import channels_of, guide_of
from gpusim.io.camera.cameras import open_camera


def channel_mix(mosaic) -> tuple[np.ndarray, np.ndarray]:
    """Return channels as sums of linear R, G, B with white 1, (C, 3), and their response to white.

    Channels are in the order of a table; the response is relative to the guide's, shape (C,). Those
    of red, green and blue alone are the photograph's own.
    """
    letters = channels_of(mosaic)
    if set(letters) <= {*"RGB"}:
        mix = np.array([np.eye(3)["RGB".index(letter)] for letter in letters])
        return mix, np.ones(len(letters))
    sensor = open_camera("phone").with_(cfa=tuple(mosaic)).sensor
    light, primaries = illuminant("D65"), srgb_primaries()
    photons = replace(light, values=light.values * light.wavelengths)
    found = product_weights(primaries.wavelengths, photons, sensor.qe) @ primaries.values.T
    found = found[[sensor.channels.index(letter) for letter in letters]]
    white = found.sum(axis=1)
    return found / white[:, None], white / white[letters.index(guide_of(mosaic))]

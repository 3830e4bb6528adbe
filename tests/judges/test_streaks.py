"""A point's light along the streaks of a polygonal pupil: predicted error against the polygon's Fourier integral."""

from dataclasses import replace

import numpy as np
import pytest
from devices import DEVICES

from gpusim.domain.content import Cube
from gpusim.domain.optics import Optics
from gpusim.domain.pupil import Pupil
from gpusim.domain.scene import Scene, unit_light
from gpusim.io.camera.cameras import open_camera
from gpusim.pipeline.simulator import Simulator

NM, PITCH, SIZE, AT, STAR = 550.0, 5.86e-6, (96, 112), (40, 61), 1e6
WITHIN = 12  # places along a pixel, over which its light is summed


def irradiance(corners, y, x, q):
    """Light per square sample of a point of light 1: the square of the sum over the polygon's edges.

    The transform of a polygon is a sum over its edges e from p: (k x e) / |k|^2 times the integral of exp(-i k p) along
    the edge (Lee and Mittra, IEEE Trans. Antennas Propag. 31, 1983). Energy by Parseval: (2 pi)^2 times the area.
    """
    ky, kx = np.pi / q * y, np.pi / q * x
    total = 0.0
    for p, after in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        e, middle = after - p, (p + after) / 2
        along = (kx * e[0] + ky * e[1]) / 2
        edge = np.sinc(along / np.pi) * np.exp(-1j * (kx * middle[0] + ky * middle[1]))
        total = total + (kx * e[1] - ky * e[0]) / (kx**2 + ky**2) * edge
    (x0, y0), (x1, y1) = corners.T, np.roll(corners, -1, axis=0).T
    area = abs(np.sum(x0 * y1 - x1 * y0)) / 2
    return np.abs(total) ** 2 * (np.pi / q) ** 2 / ((2 * np.pi) ** 2 * area)


@pytest.mark.slow
@pytest.mark.parametrize(("blades", "rotation"), [(6, 0.2), (5, 0.0)])
def test_streaks_of_a_star(blades, rotation):
    own = open_camera("mono")
    optics = Optics(4.0, 16e-3, relative_illumination="none", pupil=Pupil(blades, 0.0, rotation))
    camera = replace(
        own, optics=optics, sensor=replace(own.sensor, pixel_pitch=PITCH, fill_factor=1.0)
    )
    frames = []
    for light in (1.0, STAR):
        picture = np.ones(SIZE, np.float32)
        picture[AT] = light
        content = Cube(np.array([NM]), 1e15 * picture[None])
        scene = Scene(content, unit_light(np.array([NM])), border="zero")
        simulator = Simulator(camera, device=DEVICES[0], tolerance="video")
        result = simulator.expose(scene, 1.0)
        frame = np.asarray(simulator.device.numpy(result.mean), np.float64)
        frames.append(frame / (1e15 * result.plan.weights[0, 0]))
    found = (frames[1] - frames[0]) / (STAR - 1)
    angles = rotation + 2 * np.pi * np.arange(blades) / blades
    corners = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    q = NM * 1e-9 * optics.working_f_number / PITCH
    off = (np.arange(WITHIN) + 0.5) / WITHIN - 0.5
    wanted = np.zeros(SIZE)
    for down in off:
        for across in off:
            y = np.arange(SIZE[0])[:, None] - AT[0] + down
            wanted += irradiance(corners, y, np.arange(SIZE[1]) - AT[1] + across, q) / WITHIN**2
    # single places of a pixel do not sum the peak well; it holds nearly all the light, which is right in other tests
    down, across = np.ogrid[-AT[0] : SIZE[0] - AT[0], -AT[1] : SIZE[1] - AT[1]]
    far = np.maximum(abs(down), abs(across)) > 12
    error = np.sqrt(np.mean((found - wanted)[far] ** 2) * far.mean())
    rms = np.sqrt(np.mean(frames[1] ** 2)) / STAR
    predicted = result.plan.account.bounds["highlights"].rms
    # 1.5: the account's margin of predictions
    assert 0.2 * predicted < error / rms < 1.5 * predicted

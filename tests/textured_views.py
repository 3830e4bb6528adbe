"""Views of textured planes at known distances, from sums of waves: independent of the code under test."""

from dataclasses import replace

import numpy as np

import gpusim as gs
from gpusim.domain.view_images import ViewImages

FOCAL, F_NUMBER, PITCH, FOCUS = 4e-3, 2.0, 2e-6, 0.5  # [m], [1], [m], [m]


def thin_lens_slope(distance):
    """Displacement [pixel per radius] of a plane at a distance [m], by the thin lens.

    The ray through the pupil's edge, at f / 2 N from the axis, meets the sensor at v, behind or before the
    image at v_D, at (f / 2 N) (v_D - v) / v_D = (f / 2 N) v (1 / D - 1 / s) from the axis.
    """
    v = 1 / (1 / FOCAL - 1 / FOCUS)
    return FOCAL / (2 * F_NUMBER) * v * (1 / distance - 1 / FOCUS) / PITCH


# Slope [pixel per radius] at half the depth of focus 2 N_w c, with a circle of confusion c of a pixel: the sensor is
# off by N_w c, and the ray of the pupil's edge by N_w c / (2 N_w) = c / 2
HALF_DEPTH_OF_FOCUS = 0.5


def cells(count):
    """Centres of cells of -1 .. 1."""
    return -1 + (2 * np.arange(count) + 1) / count


class Waves:
    """A texture of waves up to `highest` [rad per pixel], of mean 1 and relative contrast `contrast`."""

    def __init__(self, random, highest=1.2, contrast=0.2, count=20):
        self.k = random.uniform(-highest, highest, (count, 2))
        self.phase = random.uniform(0, 2 * np.pi, count)
        self.amplitude = contrast * np.sqrt(2 / count)

    def __call__(self, y, x):
        y, x = np.broadcast_arrays(y, x)
        turns = np.multiply.outer(y, self.k[:, 0]) + np.multiply.outer(x, self.k[:, 1])
        return 1 + self.amplitude * np.sin(turns + self.phase).sum(axis=-1)


def plane_views(waves, slope, shape, size, extent=1.0):
    """Views (T, S, rows, cols, 1) of one plane, through points at the cells' centres."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in size)
    found = np.empty((*shape, *size, 1), np.float32)
    for j, down in enumerate(extent * cells(shape[0])):
        for i, right in enumerate(extent * cells(shape[1])):
            found[j, i, ..., 0] = waves((y - slope * down)[:, None], (x - slope * right)[None])
    return found


def made_views(values, **fields):
    """The values as views of the lens above."""
    v = 1 / (1 / FOCAL - 1 / FOCUS)
    slope = -FOCAL / (2 * F_NUMBER) * v / PITCH
    return ViewImages(values, slope, FOCUS, FOCAL, F_NUMBER, **fields)


def lens_camera():
    """A camera with the lens and the pixels above."""
    camera = gs.open_camera("phone")
    optics = gs.Optics(F_NUMBER, FOCAL, object_distance=FOCUS)
    return replace(camera, optics=optics, sensor=replace(camera.sensor, pixel_pitch=PITCH))

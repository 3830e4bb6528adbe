"""Views of a checkerboard as a distorting lens sees them, in plain NumPy: shares no code with gpusim's fit."""

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter


def undistort(x, y, coefficients):
    """Ideal normalised positions whose images are at (x, y): Newton-like fixed point of Brown's model."""
    u, v = x.copy(), y.copy()
    for _ in range(40):
        du, dv = distort(u, v, coefficients)
        u, v = u + (x - du), v + (y - dv)
    return u, v


def distort(x, y, coefficients):
    """Brown's model, OpenCV's order k1 k2 p1 p2 k3."""
    k1, k2, p1, p2, k3 = coefficients
    r = x * x + y * y
    radial = 1 + r * (k1 + r * (k2 + r * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x),
        y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y,
    )


def rotation(rx, ry, rz):
    """Rotation about x, then y, then z [rad]."""
    cx, sx, cy, sy, cz, sz = np.cos(rx), np.sin(rx), np.cos(ry), np.sin(ry), np.cos(rz), np.sin(rz)
    return (
        np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        @ np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    )


def without_lateral_color(x, y, excess, corner):
    """Undo x (1 + k0 + k1 (r / corner)^2) by a fixed point. excess: k0, or k0 and k1."""
    first, growth = np.append(excess, 0.0)[:2]
    u, v = x, y
    for _ in range(8):
        factor = 1 + first + growth * (u * u + v * v) / corner**2
        u, v = x / factor, y / factor
    return u, v


def view(size, matrix, coefficients, turn, shift, squares, excess=0.0, fine=3, blur=0.6):
    """One view, (rows, cols), 0 dark to 1 light.

    size: (cols, rows). squares: across and down the board, squares of side 1. excess: of the image height; a pair: on
    the axis, and what the corner has more, as the square of the height. blur: [pixel] standard deviation of a Gaussian.
    """
    cols, rows = size
    fx, fy, cx, cy = matrix
    # undone at every 16th pixel, a smooth function in between
    px, py = np.arange(-16.0, cols + 17, 16), np.arange(-16.0, rows + 17, 16)
    x, y = np.meshgrid(px - cx, py - cy)
    x, y = without_lateral_color(x, y, excess, np.hypot(cols, rows) / 2)
    x, y = x / fx, y / fy
    at_x = (np.arange(cols * fine) + 0.5) / fine - 0.5
    at_y = (np.arange(rows * fine) + 0.5) / fine - 0.5
    u, v = (RectBivariateSpline(py, px, one)(at_y, at_x) for one in undistort(x, y, coefficients))
    # the ray (u, v, 1) meets the plane: shift + turn (X, Y, 0)
    plane = np.linalg.inv(np.column_stack([turn[:, 0], turn[:, 1], shift]))
    a, b, c = np.tensordot(plane, np.stack([u, v, np.ones_like(u)]), 1)
    x, y = a / c, b / c
    across, down = squares
    # each line's distance over the size of a sample: edges are not moved to whole samples
    covers = []
    for at, count in ((x, across), (y, down)):
        size = np.hypot(*np.gradient(at))
        near = np.rint(at)
        sign = np.where(near % 2 == 0, 1, -1) * np.clip(2 * (at - near) / size, -1, 1)
        inside = np.clip(0.5 + at / size, 0, 1) * np.clip(0.5 + (count - at) / size, 0, 1)
        covers.append((sign, inside))
    (one, in_x), (two, in_y) = covers
    picture = 0.85 - 0.8 * in_x * in_y * (1 + one * two) / 2
    picture = gaussian_filter(picture, blur * fine)
    return picture.reshape(rows, fine, cols, fine).mean((1, 3))


def random_pose(rng, size, matrix, squares):
    """Turn (3, 3) and shift (3,) of a tilted board somewhere in the frame."""
    across, down = squares
    turn = rotation(*rng.uniform(-0.5, 0.5, 2), rng.uniform(-0.3, 0.3))
    fill = rng.uniform(0.45, 0.75)
    distance = matrix[0] * across / (fill * size[0])
    middle = turn @ np.array([across / 2, down / 2, 0])
    free = (1 - fill) / 2
    at = rng.choice([-1, 1], 2) * rng.uniform(0.6, 1.1, 2) * free
    shift = np.array(
        [at[0] * size[0] / matrix[0] * distance, at[1] * size[1] / matrix[1] * distance, distance]
    )
    return turn, shift - middle


def random_view(rng, size, matrix, coefficients, squares, **options):
    """A view of a tilted board somewhere in the frame; returns the picture."""
    turn, shift = random_pose(rng, size, matrix, squares)
    return view(size, matrix, coefficients, turn, shift, squares, **options)

"""The sum over parts of lenslets and cells of the pupil, each a sum of plane waves, float64.

pixels(X) = sum over frequencies of spectrum(nu) exp(2 pi i nu X). A part of a lenslet at the place x
adds to the spectrum its light times exp(-2 pi i nu X(x, s)), the transforms of the images of cell and
part, and the transfer function of the lenslet's diffraction, which is the autocorrelation of its clear
aperture and ends at a finite frequency.
"""

import numpy as np


def lenslets(rates, cfa, plane, shape):
    """Return the stage's result, see `lenslets.py`."""
    rates = np.asarray(rates, np.float64)
    cells_y, channels, (rows, cols) = len(rates), len(plane.spots), rates.shape[2:]
    rates = rates.reshape(cells_y, -1, channels, rows, cols)
    cells_x = rates.shape[1]
    # waves repeat after the period: so far outside there is next to no light
    period = 2 * max(shape) + 64
    parts = list(_parts(plane, shape, rows, cols))
    index = np.array([part[0] for part in parts])
    share, middle, center = (
        np.array(values) for values in zip(*(p[1:] for p in parts), strict=True)
    )
    land = middle + plane.tilt * (middle - plane.axis) - plane.power * (middle - center)
    out = np.zeros((1, *shape))
    pixel_y, pixel_x = (np.arange(size) - (size - 1) / 2 for size in shape)
    channel_of = np.asarray(cfa)[
        np.arange(shape[0])[:, None] % len(cfa), np.arange(shape[1]) % len(cfa[0])
    ]
    spread = abs(1 + plane.tilt - plane.power) * plane.step
    for channel in range(channels):
        most = int(np.ceil(1.16 * period / plane.spots[channel]))
        nu = np.arange(-most, most + 1) / period
        wave_y = np.exp(-2j * np.pi * np.outer(nu, land[:, 0]))
        wave_x = np.exp(-2j * np.pi * np.outer(land[:, 1], nu))
        spectrum = np.zeros((len(nu), len(nu)), complex)
        for j, i in np.ndindex(cells_y, cells_x):
            s = (2 * j + 1) / cells_y - 1, (2 * i + 1) / cells_x - 1
            light = share * rates[j, i, channel].ravel()[index]
            shift_y, shift_x = (np.exp(2j * np.pi * nu * plane.radius * at) for at in s)
            spectrum += np.outer(shift_y, shift_x) * ((wave_y * light) @ wave_x)
        spectrum *= _overlap(nu * plane.spots[channel], plane.normals)
        for axis, cells in enumerate((cells_y, cells_x)):
            box = np.sinc(2 * plane.radius / cells * nu) * np.sinc(spread * nu)
            box = box * np.sinc(plane.aperture[axis] * nu) * plane.aperture[axis] / period
            spectrum *= box[:, None] if axis == 0 else box
        left = np.exp(2j * np.pi * np.outer(pixel_y, nu))
        right = np.exp(2j * np.pi * np.outer(nu, pixel_x))
        out[0] = np.where(channel_of == channel, (left @ spectrum @ right).real, out[0])
    return out


def _overlap(nu, normals, lines=200):
    """Return the overlap of a polygon of width 1 with its copy at each shift (nu, nu), over its own area."""
    y, x = np.meshgrid(nu, nu, indexing="ij")
    half = [np.maximum(0, 1 - np.abs(a * y + b * x)) / 2 for a, b in normals]
    if len(normals) == 2:
        return 4 * half[0] * half[1]
    total = np.zeros(y.shape)  # of lengths of lines of equal v
    for v in (np.arange(lines) + 0.5) / lines * 1.2 - 0.6:
        low, high = np.full(y.shape, -1.0), np.full(y.shape, 1.0)
        for (a, b), side in zip(normals, half, strict=True):
            if abs(b) < 1e-12:
                high = np.where(abs(a * v) <= side, high, low)
            else:
                low = np.maximum(low, (-side - np.sign(b) * a * v) / abs(b))
                high = np.minimum(high, (side - np.sign(b) * a * v) / abs(b))
        total += np.maximum(0, high - low) * 1.2 / lines
    return total / (np.sqrt(3) / 2)


def _parts(plane, shape, rows, cols):
    """Yield parts of samples in clear apertures: index, share, centre of gravity, the lenslet's centre."""
    lattice, clear = np.array(plane.lattice), plane.fill * plane.pitch / 2
    most = int((np.hypot(*shape) + 4 * plane.pitch) / plane.pitch) + 2
    samples = np.stack(np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), -1)
    samples = (plane.start + plane.step * samples).reshape(-1, 2)
    half = plane.step / 2
    for a, b in np.ndindex(2 * most + 1, 2 * most + 1):
        center = plane.origin + (np.array([a, b]) - most) @ lattice
        sides = [
            (n, clear + n @ center) for k in plane.normals for n in (np.array(k), np.negative(k))
        ]
        near = np.abs(samples - center).max(1) < plane.pitch * 0.75 + half
        for index in np.flatnonzero(near):
            y, x = samples[index]
            square = [
                ((1, 0), y + half),
                ((-1, 0), half - y),
                ((0, 1), x + half),
                ((0, -1), half - x),
            ]
            area, gravity = _area_and_gravity(_clip(sides + square))
            if area > 0:
                yield index, area / plane.step**2, gravity, center


def _clip(sides, size=1e4):
    """Return the corners of the polygon of all points p with n @ p <= d for each side (n, d)."""
    corners = np.array([(-size, -size), (-size, size), (size, size), (size, -size)], float)
    for normal, limit in sides:
        inside = limit - corners @ np.asarray(normal, float)
        kept = []
        for k in range(len(corners)):
            here, last = inside[k], inside[k - 1]
            if (here < 0) != (last < 0):
                t = last / (last - here)
                kept.append(corners[k - 1] + t * (corners[k] - corners[k - 1]))
            if here >= 0:
                kept.append(corners[k])
        if len(kept) < 3:
            return np.zeros((0, 2))
        corners = np.array(kept)
    return corners


def _area_and_gravity(corners):
    """Return the area and the centre of gravity of a polygon."""
    if len(corners) < 3:
        return 0.0, np.zeros(2)
    base = corners.mean(0)  # products of small numbers round less
    here, after = corners - base, np.roll(corners, -1, 0) - base
    cross = here[:, 0] * after[:, 1] - here[:, 1] * after[:, 0]
    area = cross.sum() / 2
    if abs(area) < 1e-12:
        return 0.0, base
    return abs(area), base + ((here + after) * cross[:, None]).sum(0) / (6 * area)

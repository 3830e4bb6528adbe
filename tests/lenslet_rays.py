"""A camera with lenslets by brute force: rays traced one by one, and the integral of the wave behind a lenslet.

Nothing is shared with gpusim: lenslets are imaging lenses here, not matrices, and pixels are sums of a fine grid.
"""

import numpy as np
from scipy.signal import fftconvolve
from scipy.spatial import cKDTree

FINE = 24  # places of a pixel, along each axis, that rays land at


def trace(rates, cfa, camera, samples, wavelengths, per_cell=6, per_sample=2):
    """Pixels of rays from places of each cell (Gauss-Legendre) and evenly spaced ones of each sample, in metres.

    rates: (cells_y, cells_x, channels, rows, cols); wavelengths: of channels [nm]; samples: with `shape`,
    `pitch`, `offset` and `pixels`; per_cell, per_sample: places along each axis.
    """
    sensor, optics, array = camera.sensor, camera.optics, camera.sensor.lenslets
    pixel, gap = sensor.pixel_pitch, array.gap or array.focal_length
    magnification = optics.focal_length / (optics.object_distance - optics.focal_length)
    distance = optics.focal_length * (1 + magnification)  # of the pupil
    pupil = optics.focal_length / optics.f_number / 2
    image = 1 / (1 / array.focal_length - 1 / distance)  # of the pupil behind a lenslet
    chip = np.multiply(sensor.offset, pixel)
    centres = _lenslets(array, chip, max(samples.pixels) * pixel + 8 * array.pitch)
    tree = cKDTree(centres)
    cells = rates.shape[:2]
    rows, cols = samples.shape
    out = np.zeros(samples.pixels)
    margin = 16  # light that lands outside the frame comes back by diffraction
    size = [(n + 2 * margin) * FINE for n in samples.pixels]
    light = np.zeros((rates.shape[2], *size))
    grid = np.stack(np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"), -1)
    first = (np.array(samples.offset) - (np.array(samples.shape) - 1) / 2) * samples.pitch
    strata = np.stack(np.meshgrid(*[np.arange(per_sample)] * 2, indexing="ij"), -1).reshape(-1, 2)
    nodes, weights = np.polynomial.legendre.leggauss(per_cell)
    place = np.stack(np.meshgrid(nodes, nodes, indexing="ij"), -1).reshape(-1, 2) / 2 + 0.5
    power = np.outer(weights, weights).ravel() / 4
    for stratum in strata:
        inside = (stratum + 0.5) / per_sample - 0.5
        x = first + samples.pitch * (grid + inside)
        center = centres[tree.query(x)[1]]
        is_clear = _is_clear(x - center, array)
        flats, values = [], []
        for j, i in np.ndindex(cells):
            s = pupil * (2 * (np.array([j, i]) + place) / cells - 1)
            target = center[:, :, None] + (center[:, :, None] - s) * image / distance
            landed = x[:, :, None] + (target - x[:, :, None]) * gap / image
            index = (landed - chip) / pixel + (np.array(samples.pixels) / 2 + margin)
            index = index * FINE - 0.5
            base = np.floor(index).astype(int)
            is_in = is_clear[:, :, None] & ((base >= 0) & (base < np.subtract(size, 1))).all(-1)
            base, part = base[is_in], (index - base)[is_in]
            own = (rates[j, i][:, :, :, None] * power)[:, is_in]
            for dy, dx in np.ndindex(2, 2):  # linear between four places
                flats.append((base[:, 0] + dy) * size[1] + base[:, 1] + dx)
                weight = np.abs(1 - dy - part[:, 0]) * np.abs(1 - dx - part[:, 1])
                values.append(weight * own)
        flat, values = np.concatenate(flats), np.concatenate(values, 1)
        for channel, own in enumerate(values):
            light[channel] += np.bincount(flat, own, light[channel].size).reshape(size)
    light /= per_sample**2
    for channel, wavelength in enumerate(wavelengths):
        spot = spot_by_integral(array, gap, wavelength, pixel, 2 * max(size))
        spread = fftconvolve(light[channel], spot, "same")
        shape = (samples.pixels[0] + 2 * margin, FINE, samples.pixels[1] + 2 * margin, FINE)
        pixels = spread.reshape(shape).sum((1, 3))[margin:-margin, margin:-margin]
        y, x = np.indices(pixels.shape)
        own = np.asarray(cfa)[y % len(cfa), x % len(cfa[0])] == channel
        out[own] = pixels[own]
    return out


def spot_by_integral(array, gap, wavelength, pixel, size, points=512):
    """Intensity behind a lenslet: the square of the integral of the wave over its clear aperture, of sum 1."""
    u = ((np.arange(points) + 0.5) / points - 0.5) * 1.2 * array.pitch * np.sqrt(2)
    places = np.stack(np.meshgrid(u, u, indexing="ij"), -1)
    fine = np.stack(np.meshgrid(*[(np.arange(8) + 0.5) / 8 - 0.5] * 2), -1).reshape(-1, 2) * (
        u[1] - u[0]
    )
    share = np.mean(
        [_is_clear(places + one, array) for one in fine], axis=0
    )  # of each point's cell
    x = (np.arange(-(size // 2), size // 2 + 1)) / FINE * pixel
    wave = np.exp(-2j * np.pi * np.outer(x, u) / (wavelength * 1e-9 * gap))
    # a point has the mean of its cell, which is its neighbours' in part
    wave /= np.sinc(x * (u[1] - u[0]) / (wavelength * 1e-9 * gap))[:, None]
    intensity = np.abs(wave @ share @ wave.T) ** 2
    # Parseval: the whole plane has the light that passed, beyond the grid, too
    area = share.sum() * (u[1] - u[0]) ** 2
    scale = (u[1] - u[0]) ** 4 / (area * (wavelength * 1e-9 * gap) ** 2)
    return intensity * scale * (pixel / FINE) ** 2


def _lenslets(array, chip, extent):
    turn = np.pi / 2 if array.layout == "square" else np.pi / 3
    angle = array.rotation
    steps = array.pitch * np.array(
        [(np.sin(angle), np.cos(angle)), (np.sin(angle + turn), np.cos(angle + turn))]
    )
    count = int(2 * extent / array.pitch)
    a = np.arange(-count, count + 1)
    indices = np.stack(np.meshgrid(a, a), -1).reshape(-1, 2)
    centres = indices @ steps + array.offset
    return chip + centres[(np.abs(centres) < extent).all(1)]


def _is_clear(u, array):
    """Whether places relative to a lenslet's centre are in its clear aperture."""
    count = 4 if array.layout == "square" else 6
    angles = array.rotation + 2 * np.pi * np.arange(count) / count
    sides = np.stack([np.sin(angles), np.cos(angles)])
    return ((u @ sides) <= array.fill * array.pitch / 2).all(-1)

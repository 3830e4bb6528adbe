"""Seidel lenses with kernels from their pupils: the truth for a varying blur, float64."""

import functools

import numpy as np

from gpusim.judge.truth_light import MODES

Q = 550e-9 * 2.8 / 1.4e-6  # f/2.8, 1.4 um, 550 nm
# coma, astigmatism, field curvature at the corner [wave]
MILD, STRONG = ((0.7, 0.5, 0.4), (2.5, 2.0, 1.2))
PIXELS = 64  # side of the window around a point


def spectrum(height, angle, waves, oversampling):
    """Return the transform of the point spread without pixels, in natural order.

    It is sampled `oversampling` (>= 2 > 2 / Q) times per pixel, and the edge of the pupil is one
    sample wide. The coma is balanced by tilt, as in Zernike's: distortion displaces light, blur
    spreads it.

    Args:
        height: Relative field height.
        angle: Direction of the field point [rad].
        waves: Coma, astigmatism and field curvature [wave].
        oversampling: Samples per pixel.
    """
    samples = PIXELS * oversampling
    # pupil radius: half of 1/Q cycles per pixel
    f = np.fft.fftshift(np.fft.fftfreq(samples)) * 2 * Q * oversampling
    y, x = f[:, None], f
    rho2 = x * x + y * y
    inside = np.clip((1 - np.sqrt(rho2)) / (f[1] - f[0]) + 0.5, 0, 1)
    along = x * np.cos(angle) + y * np.sin(angle)
    coma, astigmatism, curvature = waves
    path = coma * height * (rho2 - 2 / 3) * along + astigmatism * height**2 * along**2
    path += curvature * height**2 * rho2
    intensity = np.abs(np.fft.ifft2(np.fft.ifftshift(inside * np.exp(2j * np.pi * path)))) ** 2
    return np.fft.fft2(intensity / intensity.sum())


def spread(height, angle, waves, size, oversampling=4):
    """Return the point spread without pixels, shape (size, size).

    size: odd number of samples. oversampling: samples per pixel.
    """
    values = np.fft.fftshift(np.fft.ifft2(spectrum(height, angle, waves, oversampling)).real)
    middle, half = PIXELS * oversampling // 2, size // 2
    return values[middle - half : middle + half + 1, middle - half : middle + half + 1]


def kernel(height, angle, waves, size):
    """Return the pixel-integrated kernel (size, size), with sum 1. size: odd.

    The transfer function of the pixel is applied before sampling.
    """
    f = np.fft.fftfreq(PIXELS * 2) * 2
    values = np.fft.ifft2(spectrum(height, angle, waves, 2) * np.sinc(f)[:, None] * np.sinc(f)).real
    values = np.fft.fftshift(values)[::2, ::2]
    middle, half = PIXELS // 2, size // 2
    values = values[middle - half : middle + half + 1, middle - half : middle + half + 1]
    return values / values.sum()


def seidel_lens(shape, waves, size):
    """Return a lens as the planner calls it: a function from places to kernels.

    Args:
        shape: Rows and columns of the frame.
        waves: Coma, astigmatism and field curvature in the corner [wave].
        size: Side of the kernels [pixel], odd.
    """
    middle, corner = (np.array(shape) - 1) / 2, np.hypot(*shape) / 2

    @functools.cache
    def quadrant(y, x):
        return kernel(np.hypot(y, x) / corner, np.arctan2(y, x), waves, size)

    def lens(places):
        away = np.asarray(places, np.float64) - middle  # the other quadrants are mirror images
        kernels = [
            quadrant(abs(y), abs(x))[:: -1 if y < 0 else 1, :: -1 if x < 0 else 1] for y, x in away
        ]
        return np.stack(kernels)[:, None]

    return lens


def make_texture(shape, seed):
    """Return a positive scene of amplitude spectrum 1/f, with mean 1 and RMS contrast 0.3."""
    random = np.random.default_rng(seed)
    f = np.hypot(np.fft.fftfreq(2 * shape[0])[:, None], np.fft.fftfreq(2 * shape[1]))
    f[0, 0] = np.inf
    noise = np.fft.ifft2(np.fft.fft2(random.standard_normal((2 * shape[0], 2 * shape[1]))) / f).real
    scene = noise[: shape[0], : shape[1]]
    scene = 1 + 0.3 * (scene - scene.mean()) / scene.std()
    return np.maximum(scene, 0.02)


def scatter(plane, lens, border):
    """Return a plane after a brute-force blur.

    Every source pixel, also of the surroundings, spreads the kernel of its own place.
    """
    rows, cols = plane.shape
    size = lens(np.zeros((1, 2))).shape[-1]
    half = size // 2
    source = np.pad(plane, half, mode=MODES[border])
    out = np.zeros((rows + 4 * half, cols + 4 * half))
    kernels = lens(np.moveaxis(np.indices((rows, cols)), 0, -1).reshape(-1, 2))[:, 0]
    for y in range(rows + 2 * half):
        for x in range(cols + 2 * half):
            if source[y, x]:
                inside = min(max(y - half, 0), rows - 1) * cols + min(max(x - half, 0), cols - 1)
                out[y : y + size, x : x + size] += source[y, x] * kernels[inside]
    return out[2 * half : 2 * half + rows, 2 * half : 2 * half + cols]


def scatter_at(plane, lens, points):
    """Return single pixels of a large frame after the same blur, shape (points,).

    The points must be half a kernel or more away from the border. Kernels of the source pixels in
    reach are bilinear between nine places half a reach apart. Over 16 of the 1100 pixels to the
    corner, their curvature is (16 / 150)^2 times the curvature over a 13 x 9 grid. That grid leaves
    8e-4, so the error is 1e-5.
    """
    half = lens(np.zeros((1, 2))).shape[-1] // 2
    offsets = np.arange(-half, half + 1)
    hats = np.maximum(0, 1 - np.abs(offsets - np.array([[-half], [0], [half]])) / half)
    out = np.empty(len(points))
    for k, (y, x) in enumerate(points):
        patch = plane[y - half : y + half + 1, x - half : x + half + 1]
        own = lens([(y + a, x + b) for a in (-half, 0, half) for b in (-half, 0, half)])[:, 0]
        # the source at s gives its entry x - s
        own = own.reshape(3, 3, *own.shape[1:])[:, :, ::-1, ::-1]
        out[k] = np.einsum("ai,bj,abij,ij->", hats, hats, own, patch)
    return out

"""Sharpening of luminance by the blur of the camera itself, where the noise allows it.

Ports: rgb (3, rows, cols) float32, linear, kernel (2 reach + 1, 2 reach + 1), luminance (3,),
noise (2,) -> (3, rows, cols) float32, linear.
"""

from functools import partial

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.kernels.stage import Array, Case, exact_case, stage, warp_only

LEAST, REACH = 4, 7  # reach of a kernel [pixel]
CUT = 0.03  # of the light of a kernel: what its window may leave out


@stage
def sharpen(
    device: Device,
    rgb: Array,
    kernel: Array,
    luminance: Array,
    noise: Array,
    *,
    strength: float,
) -> Array:
    """Add to all channels what the camera's blur takes from the luminance, if it stands out of the noise.

    With the luminance Y = sum_p w_p rgb_p, its blur B by the camera's kernel h and the detail
    d = Y - B, the result is

        rgb_p + strength d^3 / (d^2 + noise[0] max(B, 0) + noise[1]).

    Strength 1 is the first step of Van Cittert's deconvolution: contrast H at a frequency becomes
    H (2 - H). Channels get the same light, so chroma and its noise stay as they are. Detail far
    below the noise is left. Edges are repeated. The result is not clipped. If the kernel reaches a
    value that is not finite, the pixel stays as it is.

    Args:
        rgb: Linear RGB, shape (3, rows, cols).
        kernel: The kernel h, B(x) = sum_k h(k) Y(x + k), shape (2 reach + 1, 2 reach + 1); its sum
            is 1. See `system_kernel`.
        luminance: Weights w of the channels, shape (3,); their sum is 1.
        noise: Squared detail that is halved: per light, and without light, shape (2,), at least 0.
        strength: Strength, at least 0 [1].
        device: A `Device`, or its name for `open_device`.

    Returns:
        Linear RGB, shape (3, rows, cols), float32.

    Raises:
        BadData: An array has the wrong shape.
        OutOfRange: `noise` or `strength` is negative or not finite.

    Source:
        Van Cittert 1931, "Zum Einfluss der Spaltbreite auf die Intensitaetsverteilung in
        Spektrallinien II", Z. Phys. 69, 298.
    """
    kernel, luminance, noise = (np.asarray(one, np.float32) for one in (kernel, luminance, noise))
    reach = len(kernel) // 2
    shapes = kernel.shape, luminance.shape, noise.shape
    if shapes != ((2 * reach + 1,) * 2, (3,), (2,)) or len(rgb.shape) != 3 or rgb.shape[0] != 3:
        raise BadData(
            f"sharpen: rgb {tuple(rgb.shape)}, kernel {kernel.shape}, luminance {luminance.shape}, noise "
            f"{noise.shape}; wanted (3, rows, cols), a square of an odd size, (3,) and (2,)"
        )
    for name, value in (("noise", noise), ("strength", np.float64(strength))):
        if not (np.isfinite(value) & (value >= 0)).all():
            raise OutOfRange(f"sharpen: {name}", value.tolist(), "0 or more, finite")
    _, rows, cols = rgb.shape
    light, out = device.empty((rows + 2 * reach, cols + 2 * reach)), device.empty((3, rows, cols))
    launch = partial(device.launch, "processor.sharpen", defines={"REACH": reach})
    picture, sizes = device.array(rgb), (rows, cols, *warp_only(device, reach))
    launch("measure_light", light.shape, picture, device.array(luminance), light, *sizes)
    arrays = picture, light, device.array(kernel), device.array(noise), out
    launch("sharpen", (rows, cols), *arrays, float(strength), *sizes)
    return out


def system_kernel(transfer: np.ndarray) -> np.ndarray:
    """Return the kernel of a camera at its pixels, the inverse transform of its response.

    A response that is not 0 at half a cycle per pixel has a kernel that falls slowly, with
    alternating signs. A window ends it: 1 in its inner half, a cosine squared outside. The result is
    divided by its sum.

    Args:
        transfer: Transfer function below half a cycle per pixel, in the order of `numpy.fft`, shape
            (n, n), n at least 2 REACH + 2 and even.

    Returns:
        The kernel, float32, shape (2 reach + 1, 2 reach + 1), with the least reach from LEAST to
        REACH whose window leaves out at most CUT of the light.
    """
    whole = np.fft.fftshift(np.fft.ifft2(transfer).real)
    middle = len(whole) // 2
    for reach in range(LEAST, REACH + 1):
        inside = slice(middle - reach, middle + reach + 1)
        along = np.abs(np.arange(-reach, reach + 1)) / (reach + 1)
        window = np.cos(np.pi * np.maximum(along - 0.5, 0)) ** 2
        kernel = whole[inside, inside] * np.outer(window, window)
        if kernel.sum() >= (1 - CUT) * whole.sum():
            break
    kernel = kernel[::-1, ::-1]  # B is a correlation
    return (kernel / kernel.sum()).astype(np.float32)


def detail_gain(kernel: np.ndarray) -> float:
    """Return the variance of the detail over that of a luminance of white noise, for a kernel."""
    rest = -np.asarray(kernel, np.float64)
    rest[len(rest) // 2, len(rest) // 2] += 1
    return float((rest**2).sum())


LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # of sRGB


def cases():
    """Yield cases: sizes below the reach, every reach, noise and none, values that are not finite."""
    random = np.random.default_rng(5)
    for rows, cols, blur, noise, strength in (
        (1, 1, 0.5, (0.01, 0.002), 1.0),
        (3, 5, 0.3, (0.01, 0.002), 2.0),
        (63, 65, 0.0, (0.1, 0.001), 0.5),
        (40, 70, 1.1, (0, 0.01), 2.0),
        (17, 129, 3.0, (0, 0), 1.0),
    ):
        rgb = random.normal(0.4, 0.4, (3, rows, cols)).astype(np.float32)
        inputs = {
            "rgb": rgb,
            "kernel": system_kernel(_transfer(blur)),
            "luminance": LUMINANCE,
            "noise": np.array(noise, np.float32),
            "strength": strength,
        }
        yield Case(
            f"{rows}x{cols}, blur {blur:g}",
            inputs,
            _tolerance(inputs),
            "see _tolerance: roundings of the sums, times the steepest slopes of the detail's curve",
            metric="exact",
        )
    flat = {"kernel": system_kernel(_transfer(0.4)), "luminance": LUMINANCE, "strength": 1.0}
    rgb = np.zeros((3, 9, 30), np.float32)
    rgb[0, 4, 3], rgb[1, 4, 14], rgb[2, 4, 26] = np.nan, np.inf, -np.inf
    yield exact_case(
        "NaN and infinities on black",
        "pixels that a value which is not finite reaches stay, and black has no detail",
        rgb=rgb,
        noise=np.zeros(2, np.float32),
        **flat,
    )


def _transfer(blur):
    """Return the response of a lens with a Gaussian blur [pixel], and of whole pixels."""
    f = np.fft.fftfreq(16)
    line = np.exp(-2 * (np.pi * blur * f) ** 2) * np.sinc(f)
    return np.outer(line, line)


def _tolerance(inputs):
    """Return the largest error, from roundings of u = 2^-24.

    The luminance has 3 products, the blur n: d and B err by (n + 3) u P, with P the largest sum of absolute terms. The
    curve f = d^3 / (d^2 + t) has slopes df/dd <= 9/8 and |df/dt| <= 0.33 / sqrt(t), both at d^2 = 3 t; t errs by its
    own roundings, 3 u t, and by noise[0] times the error of B. Evaluating f takes 6 roundings, adding it one.
    """
    rgb, kernel = inputs["rgb"], np.abs(np.asarray(inputs["kernel"], np.float64))
    u = 2.0**-24
    most = np.einsum("p,pyx->yx", LUMINANCE, np.abs(rgb).astype(float)).max()
    largest = most * kernel.sum()  # of B
    summed = (kernel.size + 3) * u * (most + largest)
    per_light, dark = map(float, inputs["noise"])
    by_noise = 0.0
    if dark > 0:
        by_noise = 0.33 * (
            per_light * summed / dark**0.5 + 3 * u * (per_light * largest + dark) ** 0.5
        )
    detail = most + largest
    strength = inputs["strength"]
    added = strength * (9 / 8 * summed + by_noise + 6 * u * detail)
    return added + u * (np.abs(rgb).max() + strength * detail)


def bench(rows, cols):
    """Return inputs: a picture of a phone's blur."""
    random = np.random.default_rng(5)
    return {
        "rgb": random.random((3, rows, cols), np.float32),
        "kernel": system_kernel(_transfer(0.4)),
        "luminance": LUMINANCE,
        "noise": np.array([1e-4, 1e-6], np.float32),
        "strength": 0.5,
    }


def operations(rgb, kernel, luminance, noise, strength):
    """Count operations: two for each value of the kernel; five of the luminance, eight of the curve, three sums."""
    return rgb[0].size * (2 * kernel.size + 16)

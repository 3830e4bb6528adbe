"""The near field of a blur: transfer tables minus the Gaussians that `optics.far` spreads.

Ports: tables (groups, planes, ny, nx), energies (groups, planes, G), sigmas (G,) -> float32
(groups, planes, ny, nx):

    out(f) = tables(f) - sum over g of  energies_g exp(-2 pi^2 sigma_g^2 |f|^2),

f = i / P along each axis, P the period. An infinite sigma gives 1 at f = 0 and 0 elsewhere. Halves of
complex tables (groups, planes, P, 2 (P // 2 + 1)), real and imaginary parts in turn, lose it from
their real parts.
"""

from collections.abc import Sequence

import numpy as np

from gpusim.backends import Device
from gpusim.kernels.stage import Array, Case, stage


@stage
def near(
    device: Device,
    tables: Array,
    energies: Array,
    sigmas: Sequence[float] | np.ndarray,
    period: tuple[int, int],
) -> Array:
    """Subtract the transfer functions of Gaussians from tables.

    Args:
        tables: Quarters of transfer functions [1], shape (groups, planes, period[0] // 2 + 1,
            period[1] // 2 + 1), or halves as `optics.blur` takes them.
        energies: Energy of each Gaussian [1], shape (groups, planes, G).
        sigmas: Standard deviations [sample], shape (G,).
        period: Lengths of the transforms [sample].
        device: A `Device`, or its name for `open_device`.

    Returns:
        The differences, in the shape of `tables`, float32.

    Source:
        The transform of a Gaussian.
    """
    groups, planes, rows, cols = tables.shape
    energies = np.asarray(device.numpy(energies), np.float32)
    half = period[1] // 2 + 1
    down, across = _gaussians(rows, period[0], sigmas), _gaussians(half, period[1], sigmas)
    if cols != half:
        across = np.stack([across, 0 * across], axis=2).reshape(len(across), cols)
    out = device.empty(tables.shape)
    mixed = device.array(energies.reshape(groups * planes, -1))
    arrays = [device.array(tables), mixed, device.array(down), device.array(across), out]
    sizes = [rows, cols, energies.shape[-1]]
    device.launch("optics.near", "near", (groups * planes, rows, cols), *arrays, *sizes)
    return out


def _gaussians(count, length, sigmas):
    """Return the transfer of each Gaussian at the frequencies of an axis, shape (G, count)."""
    at = np.arange(count)
    f = np.minimum(at, length - at) / length  # a half has the negative frequencies, too
    sigmas = np.asarray(sigmas, np.float64)[:, None]
    transfer = np.exp(-2 * (np.pi * np.minimum(sigmas, 1e9) * f) ** 2)
    return np.where(np.isinf(sigmas), f == 0, transfer)


def cases():
    """Yield cases.

    One and several groups, odd and even periods, one Gaussian and many, an infinite one.
    """
    random = np.random.default_rng(12)
    why = "a float32 sum of up to 15 terms, each below the largest value, and the rounding of each of its factors"
    sizes = (
        (1, 1, (1, 2), 1, False),
        (3, 4, (45, 64), 9, False),
        (1, 31, (160, 81), 15, False),
        (2, 3, (45, 64), 9, True),
        (1, 2, (30, 33), 5, True),
    )
    for groups, planes, period, count, is_half in sizes:
        half = period[1] // 2 + 1
        shape = groups, planes, period[0] // 2 + 1, half
        if is_half:
            shape = groups, planes, period[0], 2 * half
        tables = random.random(shape, np.float32)
        inputs = {
            "tables": tables,
            "energies": random.random((groups, planes, count)),
            "sigmas": np.append(5.8 * 1.6 ** np.arange(count - 1), np.inf),
            "period": period,
        }
        name = f"{groups} groups of {planes}, period {period[1]}x{period[0]}, {count} Gaussians"
        name += ", halves" * is_half
        yield Case(name, inputs, 3e-6, why)


def bench(rows, cols):
    """Return inputs: tables of twelve, 64 pixels of border."""
    random = np.random.default_rng(12)
    period = rows + 128, cols + 128
    return {
        "tables": random.random((3, 4, period[0] // 2 + 1, period[1] // 2 + 1), np.float32),
        "energies": random.random((3, 4, 14)),
        "sigmas": np.append(23.3 * 1.6 ** np.arange(13), np.inf),
        "period": period,
    }

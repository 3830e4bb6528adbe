"""From mean electrons to digital numbers, one pixel per thread. `noise_ref` has the formulas."""

# mypy: ignore-errors
import warp as wp  # noqa: TID253  this module is imported only when a Warp device launches it

from gpusim.kernels.common.exact_warp import exact_exp_negative, exact_normal_pair, exact_uniform
from gpusim.kernels.common.philox_warp import philox

wp.set_module_options({"enable_backward": False, "fuse_fp": False})

SEARCH_BELOW = wp.constant(12.0)  # mean [e-]
MOST_BY_SEARCH = wp.constant(40)
MOST_EXPECTED = wp.constant(1e30)
TEMPORAL = wp.constant(wp.uint32(0))
FIXED = wp.constant(wp.uint32(1))


@wp.func
def poisson_by_search(mean: float, u: float):
    """Count photons by walking up the distribution until the tail is below u."""
    p, above = exact_exp_negative(mean)
    count = float(0.0)
    for j in range(1, MOST_BY_SEARCH + 1):
        n = float(j)
        p = p * (mean * (1.0 / n))
        if not (u < above and u * ((n + 1.0) - mean) < p * (n + 1.0)):
            break
        count += 1.0
        above -= p
    return count


@wp.func
def poisson_by_expansion(mean: float, z: float):
    """Count photons from a normal number, third-order Cornish-Fisher."""
    root = wp.sqrt(mean)
    whole = wp.floor(mean)
    square = z * z
    second = square * (1.0 / 6.0) + (1.0 / 3.0)
    third = z * (square * (-1.0 / 72.0) + (-1.0 / 36.0))
    fourth = square * (square * (1.0 / 270.0) + (7.0 / 810.0)) + (-8.0 / 405.0)
    shift = root * z + (second + (third + fourth / root) / root)
    count = whole + wp.floor((mean - whole) + shift)
    return wp.where(count < 0.0, 0.0, count)


@wp.func
def noisy_electrons(
    pixel: int, mean: float, photon_noise: int, dark_electrons: float, read_noise: float, prnu: float, dsnu: float,
    full_well: float, seed_low: int, seed_high: int, sensor_low: int, sensor_high: int, frame: int,
):
    """Electrons at the ADC; the conditions are the same for all threads."""
    fixed = wp.vec2(0.0, 0.0)
    if prnu > 0.0 or dsnu > 0.0:
        pattern = philox(wp.uint32(pixel), wp.uint32(0), wp.uint32(0), FIXED,
                         wp.uint32(sensor_low), wp.uint32(sensor_high))
        fixed = exact_normal_pair(pattern[0], pattern[1])
    words = philox(wp.uint32(pixel), wp.uint32(0), wp.uint32(frame), TEMPORAL,
                   wp.uint32(seed_low), wp.uint32(seed_high))
    z = exact_normal_pair(words[0], words[1])
    expected = wp.where(mean > MOST_EXPECTED, MOST_EXPECTED, mean)
    if prnu > 0.0:
        expected = expected * (1.0 + prnu * fixed[0])
    expected = wp.where(expected < 0.0, 0.0, expected) + dark_electrons
    electrons = expected
    if photon_noise != 0:
        if expected < SEARCH_BELOW:
            electrons = poisson_by_search(expected, exact_uniform(words[2], words[3]))
        else:
            electrons = poisson_by_expansion(expected, z[0])
    electrons = wp.where(electrons > full_well, full_well, electrons)
    if read_noise > 0.0:
        electrons = electrons + read_noise * z[1]
    if dsnu > 0.0:
        electrons = electrons + dsnu * fixed[1]
    return electrons


@wp.kernel
def electrons(
    # in:
    mean: wp.array[float],
    # out:
    out: wp.array[float],
    # sizes and numbers:
    pixels: int, photon_noise: int, dark_electrons: float, read_noise: float, prnu: float, dsnu: float,
    full_well: float, seed_low: int, seed_high: int, sensor_low: int, sensor_high: int, frame: int,
):
    """Noisy electrons."""
    i = wp.tid()
    if i >= pixels:
        return
    out[i] = noisy_electrons(i, mean[i], photon_noise, dark_electrons, read_noise, prnu, dsnu, full_well,
                             seed_low, seed_high, sensor_low, sensor_high, frame)


@wp.kernel
def digital_numbers(
    # in:
    mean: wp.array[float],
    # out:
    out: wp.array[wp.uint16],
    # sizes and numbers:
    pixels: int, photon_noise: int, dark_electrons: float, read_noise: float, prnu: float, dsnu: float,
    full_well: float, seed_low: int, seed_high: int, sensor_low: int, sensor_high: int, frame: int,
    gain: float, black_level: float, white_level: float,
):
    """Noisy electrons through the analog-digital converter."""
    i = wp.tid()
    if i >= pixels:
        return
    result = noisy_electrons(i, mean[i], photon_noise, dark_electrons, read_noise, prnu, dsnu, full_well,
                             seed_low, seed_high, sensor_low, sensor_high, frame)
    level = gain * result + black_level
    level = wp.where(level > 0.0, level, 0.0)  # NaN too
    level = wp.where(level < white_level, level, white_level)
    out[i] = wp.uint16(wp.rint(level))

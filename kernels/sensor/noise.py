"""Sensor noise and digitisation: from mean electrons to digital numbers, the same bits on every device.

Ports: mean (rows, cols) float32 [e-] -> digital numbers (rows, cols) uint16 [DN], or electrons float32 [e-].

In this order, z standard normal numbers:
    expected = max(mean (1 + prnu z1), 0) + dark_electrons    PRNU does not touch the dark current
    k        ~ Poisson(expected)                              or `expected` itself without photon noise
    e        = min(k, full_well) + read_noise z + dsnu z2     the well saturates before the noise of reading it
    DN       = rint(min(max(gain e + black_level, 0), white_level))
z1 and z2 depend on (sensor_seed, pixel) alone, k and z on (seed, frame, pixel). A magnitude of 0 costs nothing.

k is within 1e-4 of Poisson in total variation at every mean up to 1.6e7 e-.

Hard cases: mean 0 -> no photons; mean < 0 -> as 0; +inf -> full well; NaN -> NaN electrons, DN 0, neighbours unchanged.
Counts above 2^24 are rounded to float32, whose spacing is then 2 e- or more (the standard deviation is 4096 e-).
"""

import numpy as np

from gpusim.domain.errors import OutOfRange
from gpusim.kernels.common.philox_ref import seed_words
from gpusim.kernels.stage import Case, stage


@stage
def noise(device, mean, *, dark_electrons=0.0, read_noise=0.0, prnu=0.0, dsnu=0.0, full_well, gain, black_level=0.0,
          white_level, photon_noise=True, seed=0, sensor_seed=0, frame=0, electrons=False):
    """One frame's digital numbers.

    mean: photo-electrons, shape (rows, cols) [e-]. dark_electrons: mean dark charge of the exposure [e-].
    read_noise, dsnu: standard deviations, per frame and fixed [e-]. prnu: relative standard deviation of the gain.
    full_well [e-]. gain [DN/e-]. black_level, white_level [DN], the latter at most 65535.
    seed, sensor_seed: 0 to 2^64 - 1. frame: 0 to 2^32 - 1. electrons: return the electrons before the converter.
    Returns shape (rows, cols): uint16 [DN], or float32 [e-] with `electrons`.
    Raises OutOfRange. Source: Farrell & Wandell, section 5.3; EMVA 1288 for the terms.
    """
    rows, cols = mean.shape
    _check(full_well, gain, white_level, seed, sensor_seed, frame, dark_electrons=dark_electrons,
           read_noise=read_noise, prnu=prnu, dsnu=dsnu, black_level=black_level)
    mean = device.reshape(device.array(mean), (rows * cols,))
    out = device.empty((rows * cols,), np.float32 if electrons else np.uint16)
    numbers = [float(number) for number in (dark_electrons, read_noise, prnu, dsnu, full_well)]
    words = [_signed(word) for word in (*seed_words(seed), *seed_words(sensor_seed), frame)]
    converter = () if electrons else (float(gain), float(black_level), float(white_level))
    # CPUs need their vectors spelled out (see lanes.clh)
    width = 8 if device.kind == "opencl" and not device.is_gpu else 1
    defines = {"WIDTH": width, "PHOTON_NOISE": int(photon_noise), "READ_NOISE": int(read_noise > 0),
               "PRNU": int(prnu > 0), "DSNU": int(dsnu > 0)}
    device.launch("sensor.noise", "electrons" if electrons else "digital_numbers", (-(-rows * cols // width),),
                  mean, out, rows * cols, *(() if device.kind == "opencl" else (int(photon_noise),)),
                  *numbers, *words, *converter, defines=defines)
    return device.reshape(out, (rows, cols))


def _check(full_well, gain, white_level, seed, sensor_seed, frame, **magnitudes):
    for name, value in magnitudes.items():
        if not 0 <= value < np.inf:
            raise OutOfRange(name, value, f"0 <= {name} < inf")
    if not full_well > 0:
        raise OutOfRange("full_well", full_well, "full_well > 0 [e-]")
    if not 0 < gain < np.inf:
        raise OutOfRange("gain", gain, "0 < gain < inf [DN/e-]")
    if not 0 < white_level <= 65535:
        raise OutOfRange("white_level", white_level, "0 < white_level <= 65535 [DN]")
    for name, value, bits in (("seed", seed, 64), ("sensor_seed", sensor_seed, 64), ("frame", frame, 32)):
        if not 0 <= value < 2**bits:
            raise OutOfRange(name, value, f"0 <= {name} < 2^{bits}")


def _signed(word):
    """Return the same 32 bits as a signed number, which is how kernels take integers."""
    return word - 2**32 if word >= 2**31 else word


def cases():
    """Odd sizes, every switch on and off, extreme means, both outputs, large seeds: all bit for bit."""
    random = np.random.default_rng(1)
    sensor = {"dark_electrons": 0.1, "read_noise": 2.0, "prnu": 0.01, "dsnu": 0.5, "full_well": 2e4, "gain": 0.5,
              "black_level": 64, "white_level": 4095, "seed": 2**64 - 2, "sensor_seed": 2**63 + 5, "frame": 2**32 - 3}
    why = "both sides do the same correctly rounded float32 operations in the same order"

    def case(name, mean, **changed):
        return Case(name, {"mean": np.asarray(mean, np.float32), **sensor, **changed}, 0.0, why, metric="exact")

    for rows, cols in ((1, 1), (3, 5), (63, 65)):
        mean = 10.0 ** random.uniform(-3, 5, (rows, cols))
        yield case(f"{rows}x{cols}", mean)
        yield case(f"{rows}x{cols}, electrons", mean, electrons=True)
    mean = 10.0 ** random.uniform(-1, 4, (17, 61))
    for name, off in (("photon noise", {"photon_noise": False}), ("read noise", {"read_noise": 0.0}),
                      ("PRNU", {"prnu": 0.0}), ("DSNU", {"dsnu": 0.0}), ("fixed patterns", {"prnu": 0.0, "dsnu": 0.0}),
                      ("all but photon noise", {"read_noise": 0.0, "prnu": 0.0, "dsnu": 0.0, "dark_electrons": 0.0}),
                      ("all noise", {"photon_noise": False, "read_noise": 0.0, "prnu": 0.0, "dsnu": 0.0})):
        yield case(f"without {name}", mean, **off, electrons=True)
    extreme = [0, 1e-40, 1e-8, 1e-3, 0.1, 5, 11.9, 12, 12.1, 29.9, 30.1, 87, 88, 104, 300, 1e4, 1e7, 2.0**24 + 2, 1e12,
               1e38, np.nan, np.inf, -np.inf, -1e-6, -1, 5]
    for level in extreme:
        quiet = {"dark_electrons": 0.0, "full_well": 3e38}
        yield case(f"mean {level:g}", np.full((13, 37), level), **quiet, electrons=True)
    yield case("extreme means side by side", np.resize(extreme, (33, 31)))
    yield case("darkness", np.zeros((9, 9)), dark_electrons=0.0, photon_noise=True, black_level=0)


def bench(rows, cols):
    """Four decades of mean electrons and every kind of noise."""
    mean = np.geomspace(1, 1e4, rows * cols, dtype=np.float32).reshape(rows, cols)
    return {"mean": mean, "dark_electrons": 0.1, "read_noise": 2.0, "prnu": 0.01, "dsnu": 0.5, "full_well": 1e4,
            "gain": 0.4, "black_level": 64, "white_level": 4095}

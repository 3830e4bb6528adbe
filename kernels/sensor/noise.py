"""Temporal noise and digitisation: from a chip's expected electrons to digital numbers.

Ports: expected (rows, cols) float32 [e-]; offset, amplitude of the same shape or None (see
`sensor.pattern`) -> digital numbers (rows, cols) or (frames, rows, cols) uint16 [DN]; without a
converter float32 [DN], or float32 [e-].

In this order, with z standard normal numbers and s the state of a pixel's trap, 0 or 1:

    m  = max(expected, 0) + dark_electrons
    k  ~ Poisson(m)                          or m itself without photon noise
    e  = min(k, full_well)                   the well saturates before read noise is added
    e' = e + read_noise z + offset + amplitude s + row_noise z(row) + column_noise z(column)
    DN = rint(min(max(gain e' + black_level, 0), white_level))

A value depends only on seed, frame and place in the whole frame, not on the tile, the batch of
frames, the work-group or the device: the bits are the same everywhere. Terms that are 0 or None
cost nothing.

k is within 1e-4 of Poisson in total variation at every mean up to 1.6e7 e- (photon "fast"), or
within 1e-6 ("exact", in float64).

Hard cases: mean 0 gives no photons; a negative mean counts as 0; +inf fills the well; NaN gives NaN
electrons and DN 0, and does not change neighbours. Counts above 2^24 are rounded to float32, whose
spacing is then 2 e- or more (the standard deviation is 4096 e-).
"""

import functools
from dataclasses import replace
from numbers import Integral

import numpy as np

from gpusim.backends import Device
from gpusim.domain.errors import BadData, DeviceError, OutOfRange, UnknownName
from gpusim.domain.noise import SLOWEST_SWITCHING
from gpusim.kernels.common.philox_ref import chance_word, seed_words, signed
from gpusim.kernels.stage import Array, exact_case, is_opencl_cpu, stage

PHOTONS = ("none", "fast", "exact")  # as the kernels number them
OUT = 4  # place of its output among the arguments of the kernel `noise`
MOST = 1e30  # [e-], [s] stands for infinity: more than any well holds


@stage
def noise(
    device: Device,
    expected: Array,
    offset: Array | None = None,
    amplitude: Array | None = None,
    *,
    dark_electrons: float = 0.0,
    read_noise: float = 0.0,
    row_noise: float = 0.0,
    column_noise: float = 0.0,
    telegraph_switching: float = 1.0,
    full_well: float,
    gain: float,
    black_level: float = 0.0,
    white_level: float | None = None,
    photon: str = "fast",
    seed: int = 0,
    frame: int = 0,
    frames: int | None = None,
    first: tuple[int, int] = (0, 0),
    frame_cols: int | None = None,
    read: int = 0,
    electrons: bool = False,
) -> Array:
    """Return digital numbers of one frame, or of several.

    Args:
        expected: Mean electrons of this chip [e-], shape (rows, cols).
        offset: Offset of every pixel [e-], shape (rows, cols), or None.
        amplitude: Amplitude of telegraph noise [e-], shape (rows, cols), 0 for pixels without; or
            None.
        dark_electrons: Mean dark charge of the exposure [e-].
        read_noise: Standard deviation of read noise [e-].
        row_noise: Standard deviation from row to row [e-].
        column_noise: Standard deviation from column to column [e-].
        telegraph_switching: Chance that a trap's state is drawn again from one frame to the next
            [1].
        full_well: Full-well capacity [e-].
        gain: Conversion gain [DN/e-].
        black_level: Black level [DN].
        white_level: Largest digital number [DN], at most 65535; None for no converter.
        photon: "none", "fast" or "exact".
        seed: Number of the random sequence, 0 to 2^64 - 1.
        frame: Number of the (first) frame, 0 to 2^32 - 1.
        frames: Number of frames from there on, 1 to 65535; None for one frame without its own axis.
        first: Row and column in the frame at which the tile begins [pixel].
        frame_cols: Columns of the frame; None if the tile ends at its right edge.
        read: Number of the read within a frame, 0 to 2^31 - 1. Each read has its own random
            numbers; the traps' states belong to the frame.
        electrons: Return electrons before the converter.
        device: A `Device`, or its name for `open_device`.

    Returns:
        Digital numbers [DN], uint16, or float32 without a converter; or electrons [e-], float32;
        shape (rows, cols), or (frames, rows, cols).

    Raises:
        BadData: A plane has another shape than `expected`.
        OutOfRange: A number is outside its range.
        UnknownName: There is no such `photon`.
        DeviceError: `photon` is "exact" on a device without float64.

    Source:
        Farrell and Wandell, section 5.3; EMVA 1288 for the terms.
    """
    rows, cols = expected.shape
    check(
        *(full_well, gain, white_level, photon, telegraph_switching, black_level),
        dark_electrons=dark_electrons,
        read_noise=read_noise,
        row_noise=row_noise,
        column_noise=column_noise,
    )
    check_drawn(seed, frame, frames, read)
    for name, plane in (("offset", offset), ("amplitude", amplitude)):
        if plane is not None and tuple(plane.shape) != (rows, cols):
            raise BadData(
                f"{name}: shape {tuple(plane.shape)}, wanted the electrons' shape, {(rows, cols)}"
            )
    frame_cols = checked_tile(cols, first, frame_cols)
    if photon == "exact" and not device.has_fp64:
        raise DeviceError(
            f'{device.name}: photon = "exact" needs float64, which this device lacks; use "fast"'
        )
    expected = device.array(expected)
    offset, amplitude = (
        None if plane is None else device.array(plane) for plane in (offset, amplitude)
    )
    count = 1 if frames is None else frames
    converter = not electrons and white_level is not None
    out = device.empty((count, rows, cols), np.uint16 if converter else np.float32)
    # CPUs need their vectors spelled out (see lanes.clh)
    width = 8 if is_opencl_cpu(device) else 1
    drawn = {"seed": seed, "frame": frame}
    common = {
        "WIDTH": width,
        "PHOTON": PHOTONS.index(photon),
        "READ_NOISE": int(read_noise > 0),
        "OFFSET": int(offset is not None),
        "TELEGRAPH": int(amplitude is not None),
        "LINES": int(row_noise > 0 or column_noise > 0),
        "CONVERTER": int(converter),
    }
    lines = None
    if common["LINES"]:
        lines = device.empty((count, rows + cols))
        device.launch(
            "sensor.noise",
            "lines",
            (count, -(-rows // width) + -(-cols // width)),
            lines,
            *(count, rows, cols, *first),
            *(float(row_noise), float(column_noise), int(read)),
            numbers=drawn,
            words=_line_words,
            defines=common,
        )
    planes = [
        expected if plane is None else plane for plane in (expected, offset, amplitude, lines)
    ]
    scale = (1.0, 0.0) if electrons else (gain, black_level)
    first_pixel = signed((first[0] * frame_cols + first[1]) % 2**32)
    numbers = {
        "dark_electrons": dark_electrons,
        # a kernel without read noise takes none later: another is built then
        **({"read_noise": read_noise} if common["READ_NOISE"] else {}),
        "gain": scale[0],
        "black_level": scale[1],
        **drawn,
    }
    device.launch(
        "sensor.noise",
        "noise",
        (count, rows, -(-cols // width)),
        *planes,
        out,
        *(rows, cols, first_pixel, frame_cols, chance_word(telegraph_switching, 31)),
        *(float(full_well), float(white_level or 0.0), int(read)),
        numbers=numbers,
        words=_noise_words,
        defines=common,
    )
    return device.reshape(out, (rows, cols)) if frames is None else out


def _line_words(seed, frame):
    """Return the last arguments of `lines`: the seed's two words and the frame. Raises OutOfRange."""
    check_drawn(seed, frame, None, 0)
    return *_key(int(seed)), signed(int(frame))


def _noise_words(*, dark_electrons, gain, black_level, seed, frame, read_noise=0.0):
    """Return the last arguments of `noise`. Raises OutOfRange."""
    numbers = dark_electrons, read_noise, gain, black_level
    return *map(float, numbers), *_line_words(seed, frame)


@functools.lru_cache(maxsize=64)
def _key(seed):
    return tuple(signed(word) for word in seed_words(seed))


def checked_tile(cols, first, frame_cols) -> int:
    """Return the columns of the frame. Raise OutOfRange if the tile does not fit into it."""
    frame_cols = first[1] + cols if frame_cols is None else frame_cols
    if not (min(first) >= 0 and first[1] + cols <= frame_cols):
        raise OutOfRange(
            "first, frame_cols",
            f"{first}, {frame_cols}",
            f"a tile of {cols} columns inside its frame",
        )
    return frame_cols


@functools.lru_cache(maxsize=64)  # a video's are the same in every frame
def check(full_well, gain, white_level, photon, switching, black_level, **magnitudes):
    """Raise OutOfRange or UnknownName for numbers that `noise` does not take."""
    for name, value in magnitudes.items():
        if not 0 <= value <= MOST:
            raise OutOfRange(name, value, f"0 <= {name} <= {MOST:g} [e-]")
    if not np.isfinite(black_level):
        raise OutOfRange("black_level", black_level, "a finite number [DN]")
    if not full_well > 0:
        raise OutOfRange("full_well", full_well, "full_well > 0 [e-]")
    if not 0 < gain < np.inf:
        raise OutOfRange("gain", gain, "0 < gain < inf [DN/e-]")
    if white_level is not None and not 0 < white_level <= 65535:
        raise OutOfRange("white_level", white_level, "0 < white_level <= 65535 [DN], or None")
    if photon not in PHOTONS:
        raise UnknownName("photon", photon, PHOTONS)
    # a state is traced back through about the inverse of it
    if not SLOWEST_SWITCHING <= switching <= 1:
        raise OutOfRange(
            "telegraph_switching", switching, f"{SLOWEST_SWITCHING:g} <= telegraph_switching <= 1"
        )


def check_drawn(seed, frame, frames, read):
    """Raise OutOfRange if seed, frame, frames or read is outside its range."""
    if frames is not None and not (isinstance(frames, Integral) and 0 < frames < 2**16):
        raise OutOfRange("frames", frames, "a whole number, 1 .. 65535, or None")
    for name, value, bits in (("seed", seed, 64), ("frame", frame, 32), ("read", read, 31)):
        # of most values the type is known at once; an abstract class takes microseconds
        if not ((type(value) is int or isinstance(value, Integral)) and 0 <= value < 2**bits):
            raise OutOfRange(name, value, f"a whole number, 0 <= {name} < 2^{bits}")


NOISES = {"dark_electrons": 0.1, "read_noise": 2.0, "row_noise": 0.3, "column_noise": 0.2}
LEVELS = {"black_level": 64, "white_level": 4095}  # of cases


def cases():
    """Yield cases.

    Odd sizes, every switch on and off, extreme means, all outputs, tiles and batches, large seeds:
    bit for bit.
    """
    random = np.random.default_rng(1)
    sensor = {
        **NOISES,
        "full_well": 2e4,
        "gain": 0.5,
        **LEVELS,
        "seed": 2**64 - 2,
        "frame": 2**32 - 3,
        "telegraph_switching": 0.3,
    }
    why = "both sides do the same correctly rounded operations in the same order"

    def case(name, mean, planes=True, **changed):
        mean = np.asarray(mean, np.float32)
        inputs = {"expected": mean, **sensor, **changed}
        if planes:
            inputs["offset"] = random.normal(0, 1, mean.shape).astype(np.float32)
            amplitude = np.maximum(random.normal(-5, 10, mean.shape), 0)
            inputs["amplitude"] = amplitude.astype(np.float32)
        needs_float64 = inputs.get("photon") == "exact"
        return replace(exact_case(name, why, **inputs), needs_float64=needs_float64)

    for rows, cols in ((1, 1), (3, 5), (63, 65)):
        mean = 10.0 ** random.uniform(-3, 5, (rows, cols))
        yield case(f"{rows}x{cols}", mean)
        yield case(f"{rows}x{cols}, electrons", mean, electrons=True)
        yield case(f"{rows}x{cols}, exact", mean, photon="exact", electrons=True)
    mean = 10.0 ** random.uniform(-1, 4, (17, 61))
    quiet = {"read_noise": 0.0, "row_noise": 0.0, "column_noise": 0.0}
    for name, planes, off in (
        ("photon noise", True, {"photon": "none"}),
        ("read noise", True, {"read_noise": 0.0}),
        ("row noise", True, {"row_noise": 0.0}),
        ("column noise", True, {"column_noise": 0.0}),
        ("planes", False, {}),
        ("all but photon noise", False, {**quiet, "dark_electrons": 0.0}),
        ("all noise", False, {"photon": "none", **quiet}),
    ):
        yield case(f"without {name}", mean, planes, **off, electrons=True)
    yield case("without a converter", mean, white_level=None)
    yield case("five frames", mean, frames=5)
    yield case("a later read", mean, read=3)
    yield case("a tile", mean, first=(40, 1000), frame_cols=70_000)
    yield case("a first frame", mean, frame=0, telegraph_switching=0.01, electrons=True)
    extreme = [
        *(0, 1e-40, 1e-8, 1e-3, 0.1, 5, 11.9, 12, 12.1, 23.9, 24, 24.1, 87, 88, 104, 300, 1e4),
        *(1e7, 2.0**24 + 2, 1e12, 1e38, np.nan, np.inf, -np.inf, -1e-6, -1, 5),
    ]
    alone = {**quiet, "dark_electrons": 0.0, "full_well": 3e38, "electrons": True}
    for level in extreme:
        for photon in ("fast", "exact"):
            mean = np.full((13, 37), level)
            yield case(f"mean {level:g}, {photon}", mean, False, **alone, photon=photon)
    mean = np.resize(extreme, (33, 31))
    for photon in ("fast", "exact"):
        yield case(f"extreme means side by side, {photon}", mean, photon=photon)
    yield case("darkness", np.zeros((9, 9)), False, dark_electrons=0.0, black_level=0)


def bench(rows, cols):
    """Return inputs: four decades of mean electrons and every kind of noise."""
    random = np.random.default_rng(1)
    mean = np.geomspace(1, 1e4, rows * cols, dtype=np.float32).reshape(rows, cols)
    amplitude = np.where(random.random((rows, cols)) < 1e-3, 10.0, 0.0).astype(np.float32)
    return {
        "expected": mean,
        "offset": random.normal(0, 1, (rows, cols)).astype(np.float32),
        "amplitude": amplitude,
        **NOISES,
        "full_well": 1e4,
        "gain": 0.4,
        **LEVELS,
        "telegraph_switching": 0.1,
        "frame": 100,
    }

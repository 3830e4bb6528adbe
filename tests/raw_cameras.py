"""Raw frames of random cameras, from probability theory in NumPy; shares no code with gpusim.

A raw value is clip(round(gain (min(Poisson(light response + dark), well) + noise of read, row and column +
offsets) + black + noise of the converter), 0, white).
"""

import math
from dataclasses import dataclass, field

import numpy as np

MOSAICS = (
    ("Y",),
    ("RG", "GB"),
    ("GB", "RG"),
    ("BG", "GR"),
    ("RG", "WB"),
    ("RRGG", "RRGG", "GGBB", "GGBB"),
    ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG"),
)
DARK_TIMES = (0.001, 1.0, 4.0)  # [s]
DARK_COUNTS = (12, 4, 4)
LEVELS = (
    0.04,
    0.08,
    0.14,
    0.2,
    0.3,
    0.4,
    0.5,
    0.6,
    0.7,
    0.8,
)  # of saturation, of the brightest channel
BEYOND = 4.0


@dataclass
class RawCamera:
    """A camera's truth in electrons; gains by ISO speed."""

    shape: tuple
    cfa: tuple
    bits: int
    black: int
    gains: dict
    full_well: float
    read: float
    adc: float
    row: float
    column: float
    dsnu: float
    row_dsnu: float
    column_dsnu: float
    prnu: float
    row_prnu: float
    column_prnu: float
    dark_current: float
    hot_pixels: float
    hot_current: float
    dead_pixels: float
    efficiency: dict
    shading: float
    seed: int
    bend: float = 0.0  # the response loses this part of a full well at a full well
    banding: float = 0.0  # amplitude of a sine over the rows [e-], of random phase in each frame
    blur: float = 0.0  # part of its neighbour's read noise that a pixel has
    drift: float = 0.0  # black level's change per frame [DN]
    maps: dict = field(default_factory=dict)

    @property
    def white(self):
        return 2**self.bits - 1

    def saturation(self, iso):
        """Electrons at which values stop to rise, and whether it is the well."""
        at_white = (self.white - self.black) / self.gains[iso]
        return min(at_white, self.full_well), self.full_well < at_white


def draw_camera(seed):
    """A random camera with all keys drawn."""
    rng = np.random.default_rng([seed, 42])

    def log(low, high):
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    bits = int(rng.integers(10, 17))
    white = 2**bits - 1
    black = int(white * log(0.015, 0.08)) + 8
    full_well = log(2_000, 120_000)
    gain = (white - black) / full_well * rng.uniform(0.75, 1.3)
    # in digital numbers, so that rounding does not hide it altogether; no dark pixel below 0
    read = min(log(0.5, 8), black / 25) / gain
    speeds = (100, 200, 400)[: int(rng.integers(1, 4))]
    mosaic = MOSAICS[int(rng.integers(len(MOSAICS)))]
    return RawCamera(
        shape=(int(rng.integers(90, 150)), int(rng.integers(90, 170))),
        cfa=mosaic,
        bits=bits,
        black=black,
        gains={iso: gain * iso / 100 for iso in speeds},
        full_well=full_well,
        read=read,
        adc=min(log(0.1, 1.0), black / 60),
        row=read * log(0.1, 0.8),
        column=read * log(0.1, 0.8),
        dsnu=read * log(0.2, 1.5),
        row_dsnu=read * log(0.1, 0.8),
        column_dsnu=read * log(0.1, 0.8),
        prnu=log(0.003, 0.02),
        row_prnu=log(0.001, 0.006),
        column_prnu=log(0.001, 0.006),
        dark_current=log(0.5, 50) * read / 4,
        hot_pixels=log(1e-4, 3e-3),
        hot_current=log(20, 200) * read,
        dead_pixels=log(1e-5, 1e-3),
        efficiency={letter: float(rng.uniform(0.35, 1)) for letter in "".join(mosaic)},
        shading=float(rng.uniform(0, 0.1)),
        seed=seed,
    )


def draw_maps(camera, chip=0):
    """The fixed patterns of one of the camera's chips."""
    rng = np.random.default_rng([camera.seed, 43, chip])
    rows, cols = camera.shape

    def parts(pixel, row, column):
        return (
            pixel * rng.standard_normal((rows, cols))
            + row * rng.standard_normal((rows, 1))
            + column * rng.standard_normal(cols)
        )

    response = 1 + parts(camera.prnu, camera.row_prnu, camera.column_prnu)
    response[rng.random((rows, cols)) < camera.dead_pixels] = 0
    offset = parts(camera.dsnu, camera.row_dsnu, camera.column_dsnu)
    hot = rng.random((rows, cols)) < camera.hot_pixels
    dark = camera.dark_current + hot * rng.exponential(camera.hot_current, (rows, cols))
    period = np.array([[camera.efficiency[letter] for letter in line] for line in camera.cfa])
    tiles = -(-rows // len(period)), -(-cols // len(period[0]))
    efficiency = np.tile(period, tiles)[:rows, :cols] / max(camera.efficiency.values())
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    light = 1 - camera.shading * ((x - 0.2) ** 2 + (y + 0.1) ** 2) + camera.shading / 2 * x
    return {"response": response, "offset": offset, "dark": dark, "light": efficiency * light}


def expose(camera, maps, iso, seconds, electrons, rng, number=0):
    """One frame [DN]. electrons: mean in the brightest channel."""
    rows, cols = camera.shape
    gain = camera.gains[iso]
    mean = electrons * maps["light"]
    if camera.bend:
        mean = mean * (1 - camera.bend * mean / camera.saturation(iso)[0])
    count = rng.poisson(np.maximum(mean * maps["response"], 0) + seconds * maps["dark"])
    signal = np.minimum(count, camera.full_well).astype(float)
    read = rng.standard_normal((rows, cols))
    if camera.blur:
        read = (read + camera.blur * np.roll(read, 1, axis=1)) / math.hypot(1, camera.blur)
    signal += camera.read * read + maps["offset"]
    signal += camera.row * rng.standard_normal((rows, 1)) + camera.column * rng.standard_normal(
        cols
    )
    if camera.banding:
        phase = rng.uniform(0, 2 * np.pi)
        signal += camera.banding * np.sin(2 * np.pi * np.arange(rows) / 9.7 + phase)[:, None]
    level = gain * signal + camera.black + camera.drift * number
    level += camera.adc * rng.standard_normal((rows, cols))
    return np.clip(np.rint(level), 0, camera.white).astype(np.uint16)


def shoot(camera, folder, chip=0):
    """Write a series of frames as .npz: darks of three exposure times, pairs of flats, saturated ones."""
    rng = np.random.default_rng([camera.seed, 44, chip])
    maps = draw_maps(camera, chip)
    for name in ("darks", "flats"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    spread = max(camera.efficiency.values()) / min(camera.efficiency.values())
    for iso in camera.gains:
        number = 0
        for seconds, count in zip(DARK_TIMES, DARK_COUNTS, strict=True):
            for _ in range(count):
                frame = expose(camera, maps, iso, seconds, 0.0, rng, number)
                _write(
                    camera, folder / "darks" / f"dark_{iso}_{number:02d}.npz", frame, iso, seconds
                )
                number += 1
        full, _ = camera.saturation(iso)
        rate = full / 0.1  # [e-/s]; saturation after a tenth of a second
        for level in (*LEVELS, BEYOND * spread):
            seconds = round(level * 0.1, 6)
            for _ in range(2):
                frame = expose(camera, maps, iso, seconds, rate * seconds, rng)
                _write(
                    camera, folder / "flats" / f"flat_{iso}_{number:02d}.npz", frame, iso, seconds
                )
                number += 1


def _write(camera, path, frame, iso, seconds, **more):
    settings = {"iso": float(iso), "exposure_time_s": seconds, **more}
    np.savez(path, dn=frame, cfa=np.array(camera.cfa), **settings)

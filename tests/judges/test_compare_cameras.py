"""Judge of `gs.compare`: raws of a generator in NumPy against camera files, right ones and wrong ones.

The generator shares no code with gpusim: a raw value is clip(round(gain (min(Poisson(light response), well) + offset +
read noise + row noise) + black), 0, white). A right file agrees in at least 95 % of the trials, a wrong one differs in
at least 95 %. With 100 trials and a true rate of 99 %, fewer than 95 successes have a probability of 0.04 %.
"""

import math

import numpy as np
import pytest

import gpusim as gs
from gpusim.io.raw.raw_frame import RawFrame

TRIALS = 100
FRAMES, SHAPE = 16, (176, 184)
SMALL = (88, 92)  # enough for cameras that differ
MOSAICS = {
    "rccb": ("RC", "CB"),
    "bayer": ("RG", "GB"),
    "x-trans": ("GGRGGB", "GGBGGR", "BRGRBG", "GGBGGR", "GGRGGB", "RBGBRG"),
    "quad-bayer": ("RRGG", "RRGG", "GGBB", "GGBB"),
}
# A mono camera of 12 bit; the light is even within 5 %
GAIN, WELL, BLACK, READ, ROW, PRNU, DSNU = 0.4, 9000.0, 64, 4.0, 0.8, 0.006, 1.5
LIGHT = 0.0, 2500.0  # [e-] of darks and flats


def camera(base="mono", **changes):
    """The camera as a file has it."""
    known = {
        "gain_dn_per_e": GAIN,
        "full_well_e": WELL,
        "black_level_dn": BLACK,
        "bits": 12,
        "read_e": READ,
        "row_e": ROW,
        "prnu": PRNU,
        "dsnu_e": DSNU,
        "dark_current_e_per_s": 0.0,
    }
    return gs.open_camera(base).with_(**(known | changes))


def read_noise(rng, shape, tails, correlation):
    noise = rng.standard_normal(shape)
    if tails:
        noise = rng.standard_t(tails, shape) / math.sqrt(tails / (tails - 2))
    if correlation:
        noise = (noise + correlation * np.roll(noise, 1, axis=1)) / math.hypot(1, correlation)
    return noise


def draw(seed, *, read=READ, row=ROW, gain=GAIN, tails=0, correlation=0.0, shape=SHAPE, cfa=("Y",)):
    """Darks and flats of one chip."""
    rng = np.random.default_rng([seed, 4217])
    rows, cols = shape
    response = 1 + PRNU * rng.standard_normal(shape)
    offset = DSNU * rng.standard_normal(shape)
    y, x = np.meshgrid(np.linspace(-1, 1, rows), np.linspace(-1, 1, cols), indexing="ij")
    letters = np.array([list(line) for line in cfa])
    tiled = np.tile(letters, (-(-rows // len(cfa)), -(-cols // len(cfa[0]))))[:rows, :cols]
    share = np.vectorize({"Y": 1.0, "R": 0.7, "G": 1.0, "B": 0.6, "C": 1.0}.get)(tiled)
    shading = share * (1 - 0.03 * (x - 0.1) ** 2 - 0.02 * y)
    found = []
    for level in LIGHT:
        for number in range(FRAMES):
            electrons = np.minimum(rng.poisson(level * shading * response), WELL) + offset
            electrons = electrons + read * read_noise(rng, shape, tails, correlation)
            electrons = electrons + row * rng.standard_normal((rows, 1))
            values = np.clip(np.rint(gain * electrons + BLACK), 0, 4095).astype(np.uint16)
            found.append(
                RawFrame(
                    values,
                    cfa,
                    f"{level:g}-{number}",
                    exposure_time=1e-3,
                    black_level=np.full((1, 1), float(BLACK)),
                )
            )
    return found


def states(trials, file=None, **hidden):
    """Verdicts of a camera file on frames of the generator."""
    file = file or camera()
    return [
        gs.compare(file, draw(k, **hidden), seed=k, device="opencl:0").state for k in range(trials)
    ]


def mosaic_camera(cfa):
    return camera("phone", cfa=list(cfa))


@pytest.mark.slow
def test_a_right_camera_agrees():
    found = states(TRIALS)
    assert found.count("agrees") >= 0.95 * TRIALS, found
    assert "differs" not in found


WRONG = [
    {"read": 1.1 * READ},
    {"gain": 1.03 * GAIN},
    {"row": 0.0},
    {"tails": 5},
    {"correlation": 0.1},
]


@pytest.mark.slow
@pytest.mark.parametrize("wrong", WRONG, ids=lambda wrong: next(iter(wrong)))
def test_a_wrong_camera_differs(wrong):
    found = states(TRIALS, **wrong, shape=SMALL)
    assert found.count("differs") >= 0.95 * TRIALS, found


@pytest.mark.slow
def test_a_variance_at_the_agreed_difference_seldom_agrees():
    """2 % more variance of dark pixels, rounding included, is the limit: 5 % agree at most, in the mean.

    With 100 trials of 5 %, more than 11 have a probability of 0.4 %.
    """
    limit = math.sqrt(1.02 * (READ**2 + 1 / 12 / GAIN**2) - 1 / 12 / GAIN**2)
    found = states(TRIALS, read=limit)
    assert found.count("agrees") <= 11, found


@pytest.mark.slow
def test_a_file_without_row_noise_differs():
    found = states(TRIALS, camera(row_e=0.0), shape=SMALL)
    assert found.count("differs") >= 0.95 * TRIALS, found


@pytest.mark.slow
@pytest.mark.parametrize("name", MOSAICS)
def test_a_right_colour_camera_agrees(name):
    """R and B are a quarter of the pixels or fewer: larger frames have as many of each."""
    cfa = MOSAICS[name]
    found = states(TRIALS, mosaic_camera(cfa), shape=(361, 373), cfa=cfa)
    assert found.count("agrees") >= 0.95 * TRIALS, found
    assert "differs" not in found


@pytest.mark.slow
@pytest.mark.parametrize("name", MOSAICS)
def test_a_wrong_colour_camera_differs(name):
    cfa = MOSAICS[name]
    for wrong in WRONG:
        found = states(TRIALS, mosaic_camera(cfa), **wrong, shape=SMALL, cfa=cfa)
        assert found.count("differs") >= 0.95 * TRIALS, (wrong, found)


def test_too_few_frames_cannot_be_judged():
    frames = [one for one in draw(0, shape=(40, 44)) if one.name.endswith(("-0", "-1"))]
    assert gs.compare(camera(), frames, device="opencl:0").state == "cannot be judged"

"""From frames to a verdict: a hidden camera is fitted to a few frames, and its file compared with held-out ones.

The frames come from `raw_cameras`, which shares no code with gpusim: seven mosaics, 10 to 16 bits, odd sizes, defects.
The fit has 4 darks and 5 pairs of flats, so that its numbers have errors. The file must agree with 16 darks and 16
flats of the same camera in at least 95 % of the trials: chance makes fewer than 57 of 60 of a true rate of 99 % in
0.3 %. It differs from the same camera after a change. Verdicts were developed on the seeds 0 .. 99.

Darks of one exposure time give no hot pixels: in flats, some of one camera stand out, which is a difference.

Lines have 3 to 15 % of the noise: the variance of 340 lines has an error of 8 %, and a comparison of stronger patterns
of lines cannot be judged.
"""

import faulthandler
from dataclasses import replace

import numpy as np
import pytest
from raw_cameras import draw_camera, draw_maps, expose

import gpusim as gs

ISO, DARK, BRIGHTEST = 100, 1e-3, 0.1  # [s] of darks, and of flats at saturation
FIT_DARKS, FIT_LEVELS = 4, (0.1, 0.25, 0.45, 0.65, 0.8)
LEVEL = 0.3  # of saturation, of held-out flats
SEEDS = range(1000, 1060)
LINES = ("row", "column", "row_dsnu", "column_dsnu")


def hidden_camera(seed):
    """A random camera of one ISO speed."""
    camera, rng = draw_camera(seed), np.random.default_rng([seed, 91])
    shot = 1 / np.sqrt(LEVEL * camera.saturation(ISO)[0])  # relative noise of the flats' light
    return replace(
        camera,
        shape=(int(rng.integers(340, 380)), int(rng.integers(340, 400))),
        gains={ISO: camera.gains[ISO]},
        # darks of one exposure time do not give the dark current: 0.2 % of the read noise's variance or less
        dark_current=min(camera.dark_current, 0.002 * camera.read**2 / DARK),
        hot_current=min(camera.hot_current, 0.2 * camera.read**2 / DARK),
        **{key: camera.read * rng.uniform(0.03, 0.15) for key in LINES},
        **{key: shot * rng.uniform(0.03, 0.15) for key in ("row_prnu", "column_prnu")},
    )


def shoot(folder, camera, rng, kind, level, count):
    """Write frames of a level, a part of saturation."""
    (folder / kind).mkdir(parents=True, exist_ok=True)
    seconds, maps = round(level * BRIGHTEST, 6) or DARK, draw_maps(camera)
    light = level * camera.saturation(ISO)[0]
    for number in range(count):
        frame = expose(camera, maps, ISO, seconds, light, rng)
        np.savez(
            folder / kind / f"{level:g}_{number:02d}.npz",
            dn=frame, cfa=np.array(camera.cfa), iso=float(ISO), exposure_time_s=seconds,
        )  # fmt: skip


def fit_file(folder, camera, rng):
    """The camera's file, fitted to a few frames."""
    shoot(folder / "fit", camera, rng, "darks", 0.0, FIT_DARKS)
    for level in FIT_LEVELS:
        shoot(folder / "fit", camera, rng, "flats", level, 2)
    gs.fit(folder / "fit").write(folder / "mine.toml")
    return folder / "mine.toml"


def compare_held_out(folder, file, camera, rng, count):
    for kind, level in (("darks", 0.0), ("flats", LEVEL)):
        shoot(folder, camera, rng, kind, level, count)
    return gs.compare(file, folder, seed=camera.seed, device="opencl:0")


CHANGES = {
    "read": lambda camera: replace(camera, read=1.15 * camera.read, adc=1.15 * camera.adc),
    "gain": lambda camera: replace(camera, gains={ISO: 1.05 * camera.gains[ISO]}),
    "prnu": lambda camera: replace(camera, prnu=1.3 * camera.prnu, dsnu=1.3 * camera.dsnu),
    "row": lambda camera: replace(camera, row=0.5 * camera.read),
}


def judge(folder, seed):
    """Verdicts on held-out frames of the same camera, and of a changed one."""
    camera, rng = hidden_camera(seed), np.random.default_rng([seed, 92])
    file = fit_file(folder, camera, rng)
    right = compare_held_out(folder / "same", file, camera, rng, 16)
    change = list(CHANGES.values())[seed // 2 % len(CHANGES)]
    return right, compare_held_out(folder / "changed", file, change(camera), rng, 8)


@pytest.mark.slow
def test_a_fitted_camera_agrees_with_held_out_frames_and_differs_after_a_change(tmp_path):
    faulthandler.cancel_dump_traceback_later()  # it may take longer than a test that hangs
    right, changed = [], []
    for seed in SEEDS:
        same, other = judge(tmp_path / str(seed), seed)
        right.append(same.state)
        changed.append(other.state)
    assert right.count("agrees") >= 0.95 * len(right), right
    assert changed.count("differs") >= 0.95 * len(changed), changed
    # not met: 1 of 60, whose hot pixels show in its flats only: darks of one exposure time cannot give them
    assert "differs" not in right

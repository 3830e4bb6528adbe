"""Grids of lenslets are found in white raw frames, and views decode to known points.

`GPUSIM_PLENOPTICAM` may name a Python with PlenoptiCam (`pip install plenopticam` with the NumPy and SciPy
of its time), which then finds the same grid; else it is tried in this one.
"""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import gpusim as gs
from gpusim.domain.errors import BadData, OutOfRange

PIXEL, PITCH = 1.4e-6, 14e-6
ARRAYS = {
    "square": {},
    "square, turned by 2 degrees": {"rotation": np.radians(2), "offset": (1e-6, 3e-6)},
    "square, turned by 40 degrees": {"rotation": np.radians(40)},
    "hexagonal": {"layout": "hexagonal", "offset": (2e-6, -4e-6)},
    "hexagonal, turned by -17 degrees": {"layout": "hexagonal", "rotation": np.radians(-17)},
}


QUICK = [
    name if name == "square" else pytest.param(name, marks=pytest.mark.slow) for name in ARRAYS
]


def camera_of(array, base="phone"):
    camera = gs.open_camera(base)
    lenslets = gs.Lenslets(pitch=PITCH, focal_length=4 * PITCH, **array)
    optics = replace(camera.optics, f_number=4.0, focal_length=0.05, object_distance=np.inf)
    sensor = replace(camera.sensor, pixel_pitch=PIXEL, fill_factor=1.0, lenslets=lenslets)
    return replace(camera, optics=optics, sensor=sensor)


def expose(camera, shape, light, cells):
    """Pixels of light(y, x, v, u): y, x in pixels from the frame's middle; v, u the middle of a cell of the disc."""
    samples = gs.lenslet_samples(camera.sensor.lenslets, camera.sensor, camera.optics, shape)
    first = np.array(samples.offset) - (np.array(samples.shape) - 1) / 2
    y, x = (
        (start + np.arange(count)) * samples.pitch / PIXEL
        for start, count in zip(first, samples.shape, strict=True)
    )
    rates = np.zeros((*cells, len(camera.sensor.channels), *samples.shape), np.float32)
    for j, i in np.ndindex(*cells):
        s = (2 * j + 1) / cells[0] - 1, (2 * i + 1) / cells[1] - 1
        if np.hypot(*s) <= 1:
            rates[j, i] = light(y[:, None], x[None], *s)
    pixels = gs.apply_lenslets(gs.open_device("opencl"), rates, camera, samples)
    return np.asarray(pixels)[0].astype(float)


def white_of(camera, shape, cells=(7, 7)):
    return expose(camera, shape, lambda *place: 1.0, cells)


def true_centres(camera, shape):
    """Images of the pupil's middle: lenslets seen from the pupil, a little further from the axis."""
    middle = (np.array(shape) - 1) / 2
    centres = gs.lenslet_grid(camera.sensor.lenslets, shape, PIXEL)
    return middle + (centres - middle) * (1 + camera.sensor.lenslets.distance / 0.05)


def inner_errors(found, wanted, shape):
    """Distances of found centres, not at the border, from the nearest wanted ones."""
    is_inner = ((found > 10) & (found < np.array(shape) - 11)).all(1)
    return cKDTree(wanted).query(found[is_inner])[0]


@pytest.mark.parametrize("name", QUICK)
def test_calibration(name):
    """Within 0.1 pixel everywhere, in a Bayer frame with the photon noise of 200 electrons."""
    camera, shape = camera_of(ARRAYS[name]), (221, 240)
    white = white_of(camera, shape)
    noisy = np.random.default_rng(1).poisson(200 * white / white.max())
    grid = gs.calibrate_lenslets(noisy, (2, 2))
    assert grid.layout == camera.sensor.lenslets.layout
    errors = inner_errors(grid.centres(shape), true_centres(camera, shape), shape)
    assert len(errors) > 300 and errors.max() < 0.1, errors.max()
    turn = (grid.rotation - camera.sensor.lenslets.rotation) / (
        np.pi / 2 if "square" in name else np.pi / 3
    )
    assert abs(turn - round(turn)) < 1e-3


@pytest.mark.parametrize("layout", ["square", "hexagonal"])
@pytest.mark.parametrize("width", [0.8, 1.0])
def test_calibration_of_drawn_discs(layout, width):
    """Discs at known places, 9.37 pixels apart and as wide or less, with noise of a tenth, within 0.1 pixel."""
    shape, pitch, angle = (150, 170), 9.37, 0.11
    turn = np.pi / 2 if layout == "square" else np.pi / 3
    steps = np.stack(np.meshgrid(*[np.arange(-40, 41)] * 2), -1).reshape(-1, 2)
    lattice = [(np.sin(a), np.cos(a)) for a in (angle, angle + turn)]
    centres = (71.3, 88.8) + pitch * steps @ np.array(lattice)
    fine = np.stack(
        np.meshgrid(*[(np.arange(4 * n) + 0.5) / 4 - 0.5 for n in shape], indexing="ij"), -1
    )
    disc = cKDTree(centres).query(fine)[0] < width * pitch / 2
    white = disc.reshape(shape[0], 4, shape[1], 4).mean((1, 3))
    white += np.random.default_rng(2).normal(0, 0.1, shape)
    grid = gs.calibrate_lenslets(white)
    assert grid.layout == layout
    errors = inner_errors(grid.centres(shape), centres, shape)
    assert len(errors) > 150 and errors.max() < 0.1, errors.max()


@pytest.mark.parametrize(
    ("name", "base"),
    [
        ("square", "phone"),
        *(
            pytest.param(name, base, marks=pytest.mark.slow)
            for name, base in (
                ("square", "mono"),
                ("hexagonal, turned by -17 degrees", "phone"),
                ("square, turned by 2 degrees", "mono"),
                ("hexagonal, turned by -17 degrees", "mono"),
            )
        ),
    ],
)
def test_views_show_known_points(name, base):
    """Points of light, 4 pixels of parallax from the pupil's middle to its rim, are found within 0.1 pixel.

    Spots are Gaussians of 10 pixels' width. Means over neighbours are symmetric, so that centres of gravity
    stay. Cells at the rim, which are left out, also get light of the next lenslet by diffraction, which moves
    points by a few tenths of a pixel.
    """
    camera, shape, slope = camera_of(ARRAYS[name], base), (241, 221), 4.0
    points = np.array([(-41.3, 22.4), (37.7, -48.9)])

    def light(y, x, v, u):
        spots = [
            np.exp(-((y - py - slope * v) ** 2 + (x - px - slope * u) ** 2) / 2 / 10**2)
            for py, px in points
        ]
        return sum(spots)

    cells = (5, 5)
    raw, white = expose(camera, shape, light, cells), white_of(camera, shape, cells)
    cfa = camera.sensor.cfa_indices
    grid = gs.calibrate_lenslets(white, cfa.shape)
    views = gs.decode_lenslets(raw, grid, white, cells, cfa)
    assert views.shape[-1] == len(camera.sensor.channels)
    rows, cols = views.shape[2:4]
    spacing = grid.pitch * (1 if grid.layout == "square" else np.sqrt(3) / 2)
    # places of samples in the plane of the lenslets, which is seen from the pupil
    tilt = camera.sensor.lenslets.distance / 0.05
    middle = (np.array(shape) - 1) / 2
    y, x = (
        (at + spacing * (np.arange(n) - n // 2) - half) / (1 + tilt)
        for at, n, half in zip(grid.origin, (rows, cols), middle, strict=True)
    )
    for j, i, channel in ((2, 2, 0), (2, 3, 0), (1, 3, -1), (3, 2, 0)):
        place = slope * ((2 * j + 1) / 5 - 1), slope * ((2 * i + 1) / 5 - 1)
        picture = views[j, i, :, :, channel]
        for point in points + place:
            near = (np.hypot(y[:, None] - point[0], x - point[1]) < 45) * picture
            near = np.clip(near - 1e-3, 0, None)
            found = np.array([(near.sum(1) * y).sum(), (near.sum(0) * x).sum()]) / near.sum()
            assert np.abs(found - point).max() < 0.1, (name, j, i, channel, found - point)


def test_white_views_are_even():
    """The white frame's own views are 1 wherever light falls, in every colour."""
    camera = camera_of({})
    white = white_of(camera, (121, 121))
    views = gs.decode_lenslets(
        white, gs.calibrate_lenslets(white, (2, 2)), white, (3, 3), camera.sensor.cfa_indices
    )
    np.testing.assert_allclose(views, 1, rtol=1e-9)
    assert views.shape == (3, 3, 11, 11, 3)


def test_bad_frames():
    with pytest.raises(BadData, match="no grid"):
        gs.calibrate_lenslets(np.random.default_rng(0).normal(100, 3, (200, 200)))
    with pytest.raises(BadData, match="finite"):
        gs.calibrate_lenslets(np.full((50, 50), np.nan))
    grid = gs.LensletGrid(10.0, 0.0, (20.0, 20.0))
    with pytest.raises(BadData, match="two frames"):
        gs.decode_lenslets(np.ones((50, 50)), grid, np.ones((50, 51)))
    with pytest.raises(OutOfRange, match="views"):
        gs.decode_lenslets(np.ones((50, 50)), grid, views=(0, 3))
    with pytest.raises(BadData, match="at least a whole lenslet"):
        gs.decode_lenslets(np.ones((5, 5)), replace(grid, origin=(2.0, 2.0)))


PLENOPTICAM = """
import sys
import numpy as np
from plenopticam.cfg import PlenopticamConfig
from plenopticam.lfp_calibrator import LfpCalibrator
from plenopticam.misc.status import PlenopticamStatus

cfg = PlenopticamConfig()
cfg.default_values()
cfg.params[cfg.opt_dbug] = cfg.params[cfg.opt_prnt] = False
cfg.params[cfg.lfp_path] = cfg.params[cfg.cal_path] = cfg.params[cfg.cal_meta] = sys.argv[2] + ".json"
cfg.params[cfg.cal_meth] = "grid-fit"
cfg.lfpimg = {}
LfpCalibrator(np.load(sys.argv[1]), cfg=cfg, sta=PlenopticamStatus()).main()
np.save(sys.argv[2], np.array(cfg.calibs[cfg.mic_list], float))
"""


@pytest.mark.parametrize("name", ["square", "hexagonal"])
@pytest.mark.filterwarnings("ignore:sensor.lenslets:UserWarning")
def test_plenopticam_finds_the_same_grid(name, tmp_path):
    """PlenoptiCam (Hahne and Aggoun 2021) finds lenslets of a monochrome white frame at our centres.

    It fits lines through weighted means in windows of whole pixels, of 10 x 10 here: two tenths of a pixel in the
    mean, three at most. The lens is f/5.2 before lenslets of f/4: if discs touch, PlenoptiCam takes gaps for
    lenslets, too.
    """
    python = os.environ.get("GPUSIM_PLENOPTICAM", sys.executable)
    check = subprocess.run([python, "-c", "import plenopticam"], capture_output=True, text=True)
    if check.returncode:
        reason = (check.stderr.strip().splitlines() or ["?"])[-1]
        pytest.skip(f"no PlenoptiCam in {python} (GPUSIM_PLENOPTICAM): {reason}")
    camera, shape = camera_of(ARRAYS[name], "mono"), (221, 240)
    camera = replace(camera, optics=replace(camera.optics, f_number=5.2))
    white = white_of(camera, shape, (9, 9))
    np.save(tmp_path / "white.npy", white / white.max())
    # without our path: its NumPy is another one
    environment = {key: value for key, value in os.environ.items() if key != "PYTHONPATH"}
    done = subprocess.run(
        [python, "-c", PLENOPTICAM, tmp_path / "white.npy", tmp_path / "found.npy"],
        capture_output=True,
        text=True,
        env=environment,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    found = np.load(tmp_path / "found.npy")[:, :2]
    grid = gs.calibrate_lenslets(white)
    errors = inner_errors(found, grid.centres(shape), shape)
    assert len(errors) > 200
    assert errors.mean() < 0.2 and errors.max() < 0.3, (errors.mean(), errors.max())

"""Choices and statements of the planner: cases 12, 18 and 29."""

from dataclasses import replace
from functools import cache

import numpy as np

from gpusim.data.charts import chart
from gpusim.data.reflectances import reflectances
from gpusim.data.weights import electrons_per_content
from gpusim.domain.account import Tolerance
from gpusim.domain.content import Cube
from gpusim.domain.scene import Scene
from gpusim.judge.hard import truth
from gpusim.judge.hard.case import Found, case
from gpusim.judge.hard.scenes import CAMERA, CFA, LIGHT, WAVELENGTHS, as_cube
from gpusim.kernels.optics.airy import airy
from gpusim.kernels.optics.mosaic import mosaic
from gpusim.optics.fusion import SAMPLED_PERIOD, Response, Spectra, joint_operator
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.knobs.spectral import PRIOR
from gpusim.planner.plan import plan


def response_of(made) -> Response:
    """Return the response of a plan's camera, with square pixel apertures."""
    sensor = made.camera.sensor
    tables = airy(
        made.q, np.sqrt(sensor.fill_factor), SAMPLED_PERIOD, SAMPLED_PERIOD, device="numpy"
    )
    return Response.of(made.weights, tables, sensor.cfa_indices)


def library(wavelengths=WAVELENGTHS) -> np.ndarray:
    """Return E[x^T x] of measured reflectances, shape (L, L)."""
    likely = np.vstack([reflectances(name).at(wavelengths, outside=None) for name in PRIOR])
    return likely.T @ likely / len(likely)


def of_rank(operator, rank, values, made, device) -> np.ndarray:
    """Return the mosaic from the first planes of an operator; its planes and tables are float32."""
    tables = airy(made.q, 1.0, *made.period, device="numpy")
    planes = np.tensordot(operator.w_in[:, :rank].T, values, 1).astype(np.float32)
    kernels = np.tensordot(operator.transfers(rank), tables, 1).astype(np.float32)
    return mosaic(planes, kernels, np.ones((3, rank)), CFA, "edge", made.period, device=device)


@cache
def red_and_blue():
    """Return a plan, spectra (L, rows, cols) and the true mosaic of red next to blue.

    Both sides have 2000 e- in green.
    """
    red, blue = (
        1 / (1 + np.exp(-sign * (WAVELENGTHS - at) / 12)) + 0.02
        for sign, at in ((1, 590), (-1, 490))
    )
    values = np.empty((31, 64, 96), np.float32)
    white = Scene(Cube(WAVELENGTHS, np.ones((31, 4, 4), np.float32)), LIGHT)
    weights = electrons_per_content(white, CAMERA)
    values[:, :, :48] = (2000 * red / (weights[1] @ red))[:, None, None]
    values[:, :, 48:] = (2000 * blue / (weights[1] @ blue))[:, None, None]
    made = plan(Scene(Cube(WAVELENGTHS, values), LIGHT), CAMERA)
    exact = truth.blur_periodic(values.astype(float), made.q, weights, made.period)
    return made, values, truth.mosaic_of(exact, CFA)


@case(12, "red and blue edge", "equal electrons in green: <= 0.05 sigma at rank 6")
def red_beside_blue(device):
    made, values, exact = red_and_blue()
    result = of_rank(joint_operator(response_of(made), library()), 6, values, made, device)
    yield Found((np.abs(result - exact) / np.sqrt(exact)).max(), 0.05, "sigma, 2000 e- in green")


@cache
def grey_edge():
    """Return a scene of one reflectance, its plan, spectra and true mosaic."""
    scene = as_cube(chart("slanted-edge", size=(72, 48)))
    made, values = plan(scene, CAMERA), scene.content.bands_at(slice(None))
    exact = truth.blur_periodic(values, made.q, made.weights, made.period)
    return scene, made, values, truth.mosaic_of(exact, CFA)


@case(
    18,
    "rank above the numerical rank",
    "a grey edge, ranks to the last: the error never rises (beyond float32's "
    "1e-6), planes of condition < 1e10",
)
def numerical_rank(device):
    """The priors are of rank 1, from the scene, and of rank 31, with moments down to 1e-8."""
    scene, made, values, exact = grey_edge()
    for name, prior in (("scene", Spectra.of(scene.content).values), ("library", library())):
        operator = joint_operator(response_of(made), prior)
        errors = [
            truth.relative(of_rank(operator, rank, values, made, device), exact)
            for rank in operator.ranks
        ]
        rise = max(np.array(errors) - np.minimum.accumulate(errors))
        yield Found(rise, 1e-6, f"rise up to rank {operator.ranks[-1]}, prior of the {name}")
        yield Found(np.linalg.cond(operator.w_in), 1e10, "condition of the planes")


@case(
    29,
    "error in one 8 x 8 tile",
    "lines of other wavelengths in one tile of an even frame: the prediction is >= 50 % "
    "of the largest error",
)
def one_tile(device):
    """The check is the predicted largest error in sigma; planes are fused to 1e-3 of the frame."""
    random = np.random.default_rng(29)
    values = np.full((31, 96, 128), 0.5, np.float32)
    values[:, 40:48, 64:72] = 0
    np.put_along_axis(values[:, 40:48, 64:72], random.integers(3, 28, (1, 8, 8)), 15.0, axis=0)
    scene = Scene(Cube(WAVELENGTHS, values), LIGHT)
    camera = replace(CAMERA, sensor=replace(CAMERA.sensor, exposure_time=0.01))
    frame = Simulator(camera, device=device, tolerance=Tolerance(rms=1e-3))(scene)
    weights = 0.01 * electrons_per_content(scene, camera)
    base, q = np.full(31, 0.5), WAVELENGTHS * 1e-9 * 2.8 / 1.4e-6
    exact = truth.even(base, weights, (96, 128), CFA) + truth.mosaic_of(
        truth.spread(values.astype(float) - 0.5, q, weights), CFA
    )
    sigma = np.abs(frame.mean - exact) / np.sqrt(np.maximum(exact + camera.sensor.read_sigma**2, 1))
    predicted = frame.report.account.total.max_sigma
    words = f"true maximum, {sigma.max():.2g} sigma, over the predicted {predicted:.2g}"
    yield Found(sigma.max() / predicted, 2.0, words)

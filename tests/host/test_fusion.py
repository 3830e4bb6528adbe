"""The joint spectral-optical operator against float64 brute force per band, and what it predicts of its own error."""

import numpy as np
import pytest
from brute import Brute, spectra

from gpusim.data.charts import chart
from gpusim.data.lights import illuminant, white_radiance
from gpusim.domain.account import Tolerance
from gpusim.domain.content import Cube
from gpusim.domain.scene import Scene, unit_light
from gpusim.judge.hard.planner import library, response_of
from gpusim.judge.hard.scenes import CAMERA, WAVELENGTHS, at_f_number, natural
from gpusim.judge.hard.truth import relative
from gpusim.optics.fusion import Spectra, channel_operator, joint_operator
from gpusim.planner.plan import plan


def made_for(scene, camera=CAMERA, **options):
    return plan(scene, camera, **options)


def prediction_scenes():
    """Cameras, lights, surfaces and seeds; every camera meets every light."""
    cameras = [
        CAMERA,
        at_f_number("phone", 1.8),
        at_f_number("phone", 8.0),
        at_f_number("machine-vision", 4.0),
    ]
    lights = ["D65", "A", "FL11", "blackbody-4000k"]
    kinds = ["nature", "objects", "munsell", "skin", "colorchecker"]
    number = 0
    for camera in cameras:
        for light in lights:
            for _ in range(3):
                kind = kinds[number % len(kinds)]
                if kind == "colorchecker":
                    scene = chart(kind, size=(144, 96), light=light)
                else:
                    scene = chart(
                        "deadleaves", size=(144, 96), light=light, surfaces=kind, seed=number
                    )
                yield camera, scene
                number += 1


def measured_scenes(shared_data):
    """Spectral pictures: a chart of 170 surfaces in known light, and radiance in unknown light."""
    stored = np.load(shared_data / "isetcam" / "scene_reflectance_chart_full31.npz")
    photons = np.moveaxis(stored["photons"], -1, 0)[:, :120, :160]
    yield Scene(
        Cube(stored["wave"], np.ascontiguousarray(photons)),
        unit_light(stored["wave"]),
        name="chart",
    )
    for name in ("lego_duke_24", "jasper_aviris_vis"):
        stored = np.load(shared_data / "cubes" / f"{name}.npz")
        values = np.maximum(stored["cube"], 0).astype(np.float32)[:, :100, :100]
        yield Scene(
            Cube(stored["wavelengths_nm"].astype(float), values),
            unit_light(stored["wavelengths_nm"]),
            name=name,
        )


def ratios(camera, scene, tables):
    """Predicted over true error for ranks 3, 4 and 6, prior as the planner takes it."""
    plan = made_for(scene, camera)
    key = (plan.q.tobytes(), scene.shape)
    brute = tables.setdefault(key, Brute(plan.q, scene.shape, np.sqrt(camera.sensor.fill_factor)))
    transformed = brute.transform(spectra(scene.content))
    cfa = camera.sensor.cfa_indices
    truth = brute.truth(transformed, plan.weights, cfa)
    own = Spectra.of(scene.content)
    for prior in (own.values, library(scene.wavelengths)):
        operator = joint_operator(response_of(plan), prior)
        for rank in (3, 4, 6):
            result = brute.fused(
                transformed, operator.w_in[:, :rank], operator.transfers(rank), cfa
            )
            yield operator.predict_error(rank, own) / relative(result, truth)


@pytest.mark.slow
def test_prediction_of_48_scenes():
    """Predicted over true within [1/2.5, 2.5] on at least 95 % of scenes, ranks and priors."""
    tables = {}
    found = np.array(
        [ratio for camera, scene in prediction_scenes() for ratio in ratios(camera, scene, tables)]
    )
    low, high = np.quantile(found, (0.025, 0.975))
    print(
        f"{len(found)} predictions: median {np.median(found):.2f}, 95 % within {low:.2f} .. {high:.2f}, "
        f"all within {found.min():.2f} .. {found.max():.2f}"
    )
    assert np.mean((found >= 1 / 2.5) & (found <= 2.5)) >= 0.95


def test_prediction_of_measured_scenes(shared_data):
    found = np.array(
        [ratio for scene in measured_scenes(shared_data) for ratio in ratios(CAMERA, scene, {})]
    )
    print(f"measured scenes: predicted over true {found.min():.2f} .. {found.max():.2f}")
    assert ((found >= 1 / 2.5) & (found <= 2.5)).all()


def test_the_tail_of_the_eigenvalues_falls_and_bounds_the_rank():
    operator = joint_operator(response_of(made_for(natural((64, 48)))), library())
    assert operator.ranks[0] == 3 and operator.ranks[-1] <= 31
    tail = operator.tail[3:]
    assert (np.diff(tail) <= 0).all() and tail[-2] >= 1e-6  # no rank beyond the limit of float32
    # the columns of a larger operator begin with those of a smaller one, so W_out W_in^T is a projection at each rank
    for rank in operator.ranks:
        projection = operator.w_out[:, :rank] @ operator.w_in[:, :rank].T
        # float64, cond of the half moments below 1e3 by the ridge of 2 %: 1e-16 * 1e6 at most
        np.testing.assert_allclose(projection @ projection, projection, atol=1e-9)


@pytest.mark.parametrize("guaranteed", [False, True])
def test_flat_fields_of_any_spectrum_are_exact(guaranteed):
    """Spectra with no resemblance to the prior: single wavelengths, noise, the lines of a lamp. To 1e-6."""
    plan = made_for(natural((32, 24)))
    response = response_of(plan)
    if guaranteed:
        operator = channel_operator(response, 2)
        table, transfers = operator.table, operator.transfers
    else:
        operator = joint_operator(response, library())
        table, transfers = operator.w_in[:, :4].T, operator.transfers(4)
    random = np.random.default_rng(0)
    fields = np.vstack(
        [np.eye(31), random.random((20, 31)), illuminant("FL11", WAVELENGTHS).values]
    )
    flat = np.real(response.tables[:, 0])
    exact = fields @ (plan.weights * flat).T
    fused = np.einsum("ckl,l,fk->fc", transfers, flat, fields @ table.T)
    # of the whole of a pixel's light, since a channel may be all but blind to a line
    assert (np.abs(fused - exact) <= 1e-9 * np.abs(exact).max(axis=1, keepdims=True)).all()


def test_looser_tolerances_take_fewer_planes():
    scene = natural((192, 128))
    planes = [
        made_for(scene, tolerance=Tolerance(rms=rms)).count for rms in (1e-2, 1e-3, 1e-4, 1e-5)
    ]
    assert planes == sorted(planes) and planes[0] == 3 and planes[-1] < 12
    assert made_for(scene).count == 31  # without a tolerance every wavelength is exact


def test_spectra_outside_the_prior_raise_the_rank():
    """Narrow lines in noise have the predicted error of what they are, and get what they need."""
    random = np.random.default_rng(5)
    values = np.zeros((31, 64, 96), np.float32)
    np.put_along_axis(values, random.integers(0, 31, (1, 64, 96)), 1.0, axis=0)
    scene = Scene(Cube(WAVELENGTHS, values), white_radiance(illuminant("D65"), 100.0))
    tame = made_for(natural((96, 64)), tolerance=Tolerance(rms=1e-3))
    wild = made_for(scene, tolerance=Tolerance(rms=1e-3))
    assert wild.count > tame.count
    brute = Brute(wild.q, scene.shape)
    transformed = brute.transform(values.astype(float))
    cfa = CAMERA.sensor.cfa_indices
    truth = brute.truth(transformed, wild.weights, cfa)
    operator = joint_operator(response_of(wild), library())
    own = Spectra.of(scene.content)
    for rank in (3, 4, 6):
        error = relative(
            brute.fused(transformed, operator.w_in[:, :rank], operator.transfers(rank), cfa), truth
        )
        assert 1 / 2.5 <= operator.predict_error(rank, own) / error <= 2.5
        assert (
            error > 5 * operator.tail[rank]
        )  # the prior's own figure would have been silently wrong


def test_guaranteed_planes_keep_their_bound():
    """Random spectra of points stay below the bound of all monochromatic ones, times what interference allows."""
    response = response_of(made_for(natural((32, 24))))
    bounds = [channel_operator(response, planes).bound for planes in (1, 2, 3, 4)]
    print(
        "guaranteed: bounds of 1, 2, 3, 4 planes a channel", *(f"{bound:.1e}" for bound in bounds)
    )
    assert bounds == sorted(bounds, reverse=True) and bounds[3] < 1e-3
    operator = channel_operator(response, 2)
    random = np.random.default_rng(1)
    for _ in range(50):
        point = random.random(31) ** 8  # a few lines above the rest
        exact = (response.weights * point) @ response.tables
        fused = np.einsum(
            "ckl,k,lf->cf", operator.transfers, operator.table @ point, response.tables
        )
        error, signal = (
            response.share @ (np.abs(values) ** 2 @ response.count)
            for values in (fused - exact, exact)
        )
        # light adds up: transfer functions are positive, errors of several lines at worst all in phase
        assert np.sqrt(error / signal) <= operator.bound

"""Hard cases of the optics, each with what it must keep; truth is NumPy float64, without planes, folds or splits."""

from dataclasses import replace

import numpy as np
import pytest
from brute import Brute, relative, spectra
from devices import KINDS
from scipy.integrate import dblquad
from test_fusion import CAMERA, WAVELENGTHS, as_cube, library, made_for, natural, response_of

from gpusim.data.charts import chart
from gpusim.data.lights import illuminant, white_radiance
from gpusim.domain.content import Cube
from gpusim.domain.pupil import Pupil
from gpusim.domain.scene import Scene, unit_light
from gpusim.domain.tolerance import Tolerance
from gpusim.kernels.optics.airy import airy
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.mosaic import mosaic
from gpusim.kernels.optics.pupil import pupil
from gpusim.optics.lengths import transform_lengths
from gpusim.planner.fusion import Spectra, channel_operator, joint_operator
from gpusim.planner.highlights import CORE, airy_density, point_kernels
from gpusim.simulator import Simulator

CFA = CAMERA.sensor.cfa_indices
LIGHT = white_radiance(illuminant("D65"), 100.0)


def electrons(scene, device, **options):
    simulator = Simulator(CAMERA, device=device, **options)
    return simulator.device.numpy(simulator.expose(scene, 1.0).mean).astype(float)


def with_points(background, places, levels, lines):
    """A cube of a flat spectrum with pixels of one wavelength each, or of all where `lines` has None."""
    values = np.full((31, *background.shape), 1.0, np.float32) * background
    for (y, x), level, line in zip(places, levels, lines, strict=True):
        values[:, y, x] = 0
        values[slice(None) if line is None else line, y, x] = level
    return values


def by_hand(values, plan):
    """Every pixel's light spread by pixel-integrated Airy patterns in space; the background by transforms in float64.

    Nothing wraps around: the points' kernels are integrals over the pixel, Gauss-Legendre of an order that resolves
    the rings (6 points to a ring and more).
    """
    rows, cols = values.shape[1:]
    base = np.median(values, axis=(1, 2))
    brute = Brute(plan.q, (rows, cols))
    out = brute.truth(brute.transform(np.broadcast_to(base[:, None, None], values.shape)), plan.weights, CFA)
    y, x = np.indices((rows, cols))
    channel = CFA[y % 2, x % 2]
    nodes, mass = (array / 2 for array in np.polynomial.legendre.leggauss(10))
    for py, px in np.argwhere(np.any(values != base[:, None, None], axis=0)):
        more = values[:, py, px] - base
        dy, dx = ((axis - at)[..., None] + nodes for axis, at in ((np.arange(rows), py), (np.arange(cols), px)))
        radius = np.hypot(dy.ravel()[:, None], dx.ravel())
        for band in np.flatnonzero(more):
            density = airy_density(radius, plan.q[band]).reshape(rows, 10, cols, 10)
            out += plan.weights[channel, band] * more[band] * np.einsum("iajb,a,b->ij", density, mass, mass)
    return out


def test_the_kernels_of_points_are_integrals_over_the_pixel():
    """Against adaptive quadrature; beyond the core 1e-3 of the local value, which averages over directions cost."""
    for q, aperture in ((1.1, 1.0), (0.5, 0.9)):
        kernels = point_kernels([q], aperture, 120)
        half = aperture / 2
        for dy, dx in ((0, 0), (1, 2), (7, 3), (CORE, 5)):
            exact = dblquad(lambda x, y, q=q: float(airy_density(np.hypot(x, y), q)), dy - half, dy + half, dx - half,
                            dx + half, epsabs=1e-13)[0] / aperture**2
            # 10 points to a ring integrate it to 1e-9; the airy pattern is 1 at most
            assert abs(kernels.cores[0, dy, dx] - exact) < 1e-9
        points = kernels.spread * (np.arange(kernels.parts) - (kernels.parts - 1) / 2)
        for dy, dx in ((CORE + 1, 0), (60, 31), (118, 117)):
            exact = dblquad(lambda x, y, q=q: float(airy_density(np.hypot(x, y), q)), dy - half, dy + half, dx - half,
                            dx + half, epsabs=1e-14)[0] / aperture**2
            radii = np.hypot((dy + points)[:, None], dx + points)
            far = np.interp(radii, kernels.step * np.arange(kernels.profiles.shape[1]), kernels.profiles[0]).mean()
            assert abs(far - exact) < 1e-3 * exact


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("tolerance", [None, Tolerance(rms=1e-4)])
@pytest.mark.parametrize("level", [1e6, 1e9])
def test_hard_01_highlight_in_the_dark(device, tolerance, level):
    """One white pixel over 1e-3: local error <= 1e-3 everywhere, none negative."""
    values = with_points(np.full((60, 90), 1e-3), [(22, 31)], [level], [None])
    scene = Scene(Cube(WAVELENGTHS, values), LIGHT)
    truth = by_hand(values.astype(float), made_for(scene))
    mean = electrons(scene, device, tolerance=tolerance)
    assert (mean > 0).all()
    assert (np.abs(mean - truth) / truth).max() <= 1e-3


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("tolerance", [None, "metrology"])
def test_hard_02_coloured_highlights_on_a_natural_background(device, tolerance):
    """20 narrow-band points of 1e4 .. 1e6 of the median: <= 0.1 sigma where the background has 2000 e-."""
    scene = natural((160, 112), surfaces="munsell")
    random = np.random.default_rng(3)
    places = np.stack([random.integers(0, 112, 20), random.integers(0, 160, 20)], axis=1)
    points = np.zeros((31, 112, 160))
    for (y, x), level, line in zip(places, np.geomspace(1e4, 1e6, 20), random.integers(5, 26, 20), strict=True):
        points[line, y, x] = level * np.median(scene.content.values)
    bright = replace(scene, content=replace(scene.content, values=(scene.content.values + points).astype(np.float32)))
    plan = made_for(scene)
    brute = Brute(plan.q, scene.shape)
    background = brute.truth(brute.transform(spectra(scene.content)), plan.weights, CFA)
    added = (bright.content.values.astype(float) - scene.content.values)
    # a background of 0 makes the points alone
    truth = background + by_hand(added, plan)
    mean = electrons(bright, device, tolerance=tolerance)
    scale = 2000 / np.median(background)
    sigmas = np.abs(mean - truth) * scale / np.sqrt(truth * scale)
    print(f"{device}, {tolerance}: largest error {sigmas.max():.2g} sigma")
    assert sigmas.max() <= 0.1


@pytest.mark.parametrize("device", KINDS)
def test_hard_03_highlight_in_the_corner_does_not_wrap(device, border="zero"):
    """The far sides stay as if there were no far side; highlights that go on outside are in test_border.py."""
    values = with_points(np.full((70, 100), 1e-3), [(0, 0), (69, 40)], [1e6, 1e6], [None, 12])
    plain = with_points(np.full((70, 100), 1e-3), [], [], [])
    scene = Scene(Cube(WAVELENGTHS, values), LIGHT, border)
    dark = electrons(Scene(Cube(WAVELENGTHS, plain), LIGHT, border), "numpy")
    plan = made_for(scene)
    points = by_hand(values.astype(float) - np.float32(1e-3), plan)
    mean = electrons(scene, device)
    # the kernels' tables beyond the core are good to 5e-4 of what a point adds there (measured above: 1e-3 at most)
    assert (np.abs(mean - dark - points) <= 1e-6 * dark + 1e-3 * points).all()
    far = (np.s_[-20:, -20:], np.s_[:10, -20:])
    for side in far:  # a wrapped corner would be 1e6 / 1e3 times as bright there
        np.testing.assert_allclose(mean[side], (dark + points)[side], rtol=1e-3)


@pytest.mark.parametrize("device", KINDS)
def test_hard_03_highlight_one_pixel_outside(device):
    """In the surroundings of a scene: its kernel reaches in, it is in no pixel, and nothing wraps."""
    values = with_points(np.full((60, 80), 1e-3), [(9, 30)], [1e6], [None])
    scene = Scene(Cube(WAVELENGTHS, values), LIGHT, "scene", margin=10)
    plan = made_for(scene)
    truth = by_hand(values.astype(float), plan)[10:-10, 10:-10]  # an even margin keeps the phase of a Bayer mosaic
    mean = electrons(scene, device)
    assert (np.abs(mean - truth) / truth).max() <= 1e-3


@pytest.mark.parametrize("device", KINDS)
def test_hard_04_energy_of_a_frame_is_kept(device):
    """A dark-bordered scene far from the edges: all electrons arrive, to 1e-6, whatever the rank."""
    values = np.zeros((31, 256, 256), np.float32)
    inner = natural((64, 48)).content.values
    values[:, 104:152, 96:160] = inner
    scene = Scene(Cube(WAVELENGTHS, values), LIGHT, "zero")
    exact = Simulator(CAMERA, device="numpy").expose(scene, 1.0).mean
    plan = made_for(scene)
    for tolerance in (1e-2, 1e-4):
        operator = joint_operator(response_of(plan), library())
        brute = Brute(plan.q, scene.shape)
        transformed = brute.transform(values.astype(float), "constant")
        rank = 3 if tolerance == 1e-2 else 4
        total = np.tensordot(operator.transfers(rank), brute.tables[:, 0, 0], 1)
        planes = operator.w_in[:, :rank].T @ transformed[:, 0, 0]
        whole = np.einsum("cl,l,l->c", plan.weights, brute.tables[:, 0, 0], transformed[:, 0, 0])
        np.testing.assert_allclose(np.real(total @ planes), np.real(whole), rtol=1e-9)
        mean = electrons(scene, device, tolerance=Tolerance(rms=tolerance))
        # per phase of the mosaic the sum is that of a quarter of the pixels, not of its channel: kept to the error
        # that tolerance allows, and to 1e-6 of all where the channels' sums are exact
        assert abs(mean.sum() / np.sum(exact) - 1) < 1e-2 * tolerance


def test_hard_08_monochromatic_sweep_of_a_point():
    """400 .. 700 nm by 1 nm: the guaranteed planes keep 1e-3 at every line; the prior's say that they do not."""
    fine = np.arange(400.0, 701.0)
    values = np.zeros((301, 8, 8), np.float32)
    values[:, 4, 4] = 1
    plan = made_for(Scene(Cube(fine, values), LIGHT))
    response = response_of(plan)
    optical = np.abs(response.tables) ** 2 @ response.count

    def errors(table, transfers):
        fused = np.einsum("ckl,lf->ckf", transfers, response.tables)
        total = 0
        for c, share in enumerate(response.share):
            lost = plan.weights[c][:, None] * response.tables - table.T @ fused[c]
            total = total + share * (np.abs(lost) ** 2 @ response.count)
        signal = response.share @ plan.weights**2 * optical
        seen = signal > 1e-6 * signal.max()
        return np.sqrt(total[seen] / signal[seen])

    guaranteed = channel_operator(response, 4)
    worst = errors(guaranteed.table, guaranteed.transfers).max()
    print(f"point source, 4 planes a channel: {worst:.1e}, bound {guaranteed.bound:.1e}")
    assert worst <= 1e-3 and worst <= guaranteed.bound * (1 + 1e-6)
    prior = joint_operator(response, library(fine))
    line = np.zeros((301, 8, 8), np.float32)
    line[150, 4, 4] = 1
    own = Spectra.of(Cube(fine, line))
    for rank in (3, 4):
        assert errors(prior.w_in[:, :rank].T, prior.transfers(rank)).max() > 1e-3
        assert prior.predicted(rank, own) > 5 * prior.tail[rank]  # says that it is outside


@pytest.mark.parametrize("device", KINDS)
def test_hard_12_red_and_blue_edge(device):
    """Red and blue of equal electrons in green, side by side: <= 0.05 sigma at rank 6, 2000 e- in green."""
    red, blue = (1 / (1 + np.exp(-sign * (WAVELENGTHS - at) / 12)) + 0.02 for sign, at in ((1, 590), (-1, 490)))
    values = np.empty((31, 64, 96), np.float32)
    plan = made_for(Scene(Cube(WAVELENGTHS, np.ones((31, 4, 4), np.float32)), LIGHT))
    values[:, :, :48] = (red / (plan.weights[1] @ red))[:, None, None]
    values[:, :, 48:] = (blue / (plan.weights[1] @ blue))[:, None, None]
    values *= 2000.0
    scene = Scene(Cube(WAVELENGTHS, values), LIGHT)
    operator = joint_operator(response_of(plan), library())
    brute = Brute(plan.q, scene.shape)
    truth = brute.truth(brute.transform(values.astype(float)), plan.weights, CFA)
    plan = made_for(scene)
    tables = airy(plan.q, 1.0, *plan.period, device="numpy")
    kernels = np.tensordot(operator.transfers(6), tables, 1)
    planes = np.tensordot(operator.w_in[:, :6].T, values, 1).astype(np.float32)
    result = mosaic(planes, kernels.astype(np.float32), np.ones((3, 6)), CFA, "edge", plan.period, device=device)
    assert (np.abs(result - truth) / np.sqrt(truth)).max() <= 0.05


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("cfa", [[[0, 1], [1, 2]], [[1, 0], [2, 1]], [[1, 2], [0, 1]], [[2, 1], [1, 0]],
                                 [[0, 1, 2]], pytest.param([[0, 0, 1, 1], [0, 0, 1, 1], [1, 1, 2, 2], [1, 1, 2, 2]],
                                                           marks=pytest.mark.slow),
                                 pytest.param((np.arange(30).reshape(5, 6) % 3).tolist(), marks=pytest.mark.slow)])
def test_hard_17_folded_mosaic_is_the_sampled_frame(device, cfa):
    """Odd sizes, all Bayer phases, other periods: equal to the full channels of optics.blur, sampled, to 1e-6."""
    random = np.random.default_rng(8)
    cfa = np.array(cfa)
    for rows, cols, margin in ((37, 53, 0), (40, 41, 3), (1, 7, 0)):
        period, folded = transform_lengths((rows + 32, cols + 32), np.shape(cfa))
        assert folded
        planes = random.random((4, rows, cols), np.float32)
        tables = airy(np.linspace(0.8, 1.4, 12), 1.0, *period, device="numpy").reshape(3, 4, period[0] // 2 + 1, -1)
        tables = tables.astype(np.float32)
        full = blur(planes, tables, np.ones((3, 4)), "edge", period, margin, device="numpy")
        y, x = np.indices(full.shape[1:])
        wanted = np.take_along_axis(full, cfa[y % len(cfa), x % len(cfa[0])][None], 0)[0]
        result = mosaic(planes, tables, np.ones((3, 4)), cfa, "edge", period, margin, device=device)
        assert np.abs(result - wanted).max() <= 1e-6 * np.abs(wanted).max()


def test_hard_17_a_period_of_seven_is_not_folded():
    assert transform_lengths((100, 100), (7, 1)) == ((100, 100), False)


def test_hard_18_rank_above_the_numerical_rank():
    """Content of three spectra, ranks to the last: the error never rises above that of lower ranks, in float32."""
    scene = as_cube(chart("slanted-edge", size=(96, 64)))
    plan = made_for(scene)
    brute = Brute(plan.q, scene.shape)
    values = spectra(scene.content)
    transformed = brute.transform(values)
    truth = brute.truth(transformed, plan.weights, CFA)
    for prior in (Spectra.of(scene.content).values, library()):  # of rank 1; of rank 31, its last moments 1e-8
        operator = joint_operator(response_of(plan), prior)
        assert np.linalg.cond(operator.w_in) < 1e6
        tables = airy(plan.q, 1.0, *plan.period, device="numpy")
        lowest = np.inf
        for rank in operator.ranks:
            planes = np.tensordot(operator.w_in[:, :rank].T, values, 1).astype(np.float32)
            kernels = np.tensordot(operator.transfers(rank), tables, 1).astype(np.float32)
            error = relative(mosaic(planes, kernels, np.ones((3, rank)), CFA, "edge", plan.period, device="opencl"),
                             truth)
            # float32: half a ulp of each of up to 31 planes, 6e-8 sqrt(31); the transform's 2.5e-7 beside it
            assert error <= max(1.5 * lowest, 1e-6)
            lowest = min(lowest, error)


@pytest.mark.parametrize("device", KINDS)
def test_hard_24_range_of_thirteen_decades(device):
    """Planes of 1e-7 .. 1e6 stay finite, and the dark is right to 1e-3."""
    values = with_points(np.full((40, 60), 1e-7), [(11, 13), (30, 44)], [1e6, 1e6], [None, 20])
    scene = Scene(Cube(WAVELENGTHS, values), unit_light(WAVELENGTHS))
    truth = by_hand(values.astype(float), made_for(scene))
    mean = electrons(scene, device)
    assert np.isfinite(mean).all()
    assert (np.abs(mean - truth) / truth).max() <= 1e-3


@pytest.mark.parametrize("device", KINDS)
def test_hard_09_moved_points_on_coarse_pixels(device):
    """f/1.8, 4 um (Q = .25): flux to 1e-4 at all phases, kernels to 1e-3 of the peak, at nine phases and all pixels.

    The point is moved by a wavefront's slope, -2 Q of it, before the pixels integrate. The truth is the integral of
    Airy's pattern, Gauss-Legendre with 24 nodes to a pixel of 4 / 1.22 rings: 7 to a ring.
    """
    q, period, size = 550e-9 * 1.8 / 4e-6, (96, 96), 9
    nodes, mass = (array / 2 for array in np.polynomial.legendre.leggauss(24))
    point = np.zeros((1, size, size), np.float32)
    point[0, size // 2, size // 2] = 1
    moves = [(a / 3 + 0.05, b / 3 - 0.4) for a in range(3) for b in range(3)]
    waves = np.zeros((len(moves), 3, 3))
    waves[:, 0, 1], waves[:, 1, 0] = -np.array(moves).T / (2 * q)
    tables = pupil(Pupil(), waves, np.full(len(moves), q, np.float32), 1.0, *period, device=device)
    flux = tables[:, 0, 0]  # of all pixels together
    assert np.abs(flux - 1).max() < 1e-4
    for (dy, dx), table in zip(moves, tables, strict=True):
        image = blur(point, table[None, None], np.ones((1, 1)), "zero", period, device=device)[0]
        y, x = ((np.arange(size)[:, None] - size // 2 - d + nodes).ravel() for d in (dy, dx))
        density = airy_density(np.hypot(y[:, None], x), q).reshape(size, 24, size, 24)
        truth = np.einsum("iajb,a,b->ij", density, mass, mass)
        assert np.abs(image - truth).max() < 1e-3 * truth.max()


@pytest.mark.parametrize("device", KINDS)
def test_hard_10_blur_wider_than_a_tile(device):
    """f/16, 1.0 um (Q = 6 .. 11): tiles of 24 pixels, cut with the surroundings that they see, make the frame to 1e-5.

    Beyond r pixels lies 2 Q / (pi^2 r) of a point's light (Rayleigh), so that no surroundings hold all of an Airy
    pattern: these hold all of the scene, at another place of the same period for every tile. What is left is the
    rounding of transforms.
    """
    planes = natural((72, 72)).content.values[[5, 15, 25]]
    q = WAVELENGTHS[[5, 15, 25]] * 1e-9 * 16 / 1e-6
    margin, period, mix = 56, (216, 216), np.array([[0.2, 0.5, 0.3]])
    tables = airy(q, 1.0, *period, device="numpy")[None].astype(np.float32)
    whole = blur(planes, tables, mix, "zero", period, device=device)
    around = np.pad(planes, ((0, 0), (margin, margin), (margin, margin)))
    tiled = np.zeros_like(whole)
    for y in range(0, 72, 24):
        for x in range(0, 72, 24):
            window = np.ascontiguousarray(around[:, y : y + 24 + 2 * margin, x : x + 24 + 2 * margin])
            tiled[:, y : y + 24, x : x + 24] = blur(window, tables, mix, "zero", period, margin, device=device)
    print(f"{device}: tiles differ by {np.abs(tiled - whole).max() / whole.max():.1e}")
    assert np.abs(tiled - whole).max() <= 1e-5 * whole.max()
    alone = blur(np.ascontiguousarray(planes[:, :24, :24]), tables, mix, "zero", period, device=device)
    assert np.abs(alone - whole[:, :24, :24]).max() > 0.05 * whole.max()  # the blur is wider than a tile

"""Distortion, lateral colour and falloff: inverses, conservation of flux, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from devices import ALL_KINDS, KINDS
from lights import as_photons

from gpusim.backends import open_device
from gpusim.domain.calibration import Fisheye
from gpusim.domain.content import Cube
from gpusim.domain.distortion import BrownConrady, RadialPolynomial, RadialTable, ideal
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import Scene
from gpusim.domain.sensor import Microlens
from gpusim.io.camera.cameras import open_camera
from gpusim.kernels.optics.distort import distort
from gpusim.kernels.optics.falloff import falloff
from gpusim.optics.geometry import (
    DistortionGrid,
    distortion_grid,
    microlens_gain,
    places_of,
    relative_illumination,
)
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.knobs.pixels import _undistorted_law

PITCH = 1.4e-6
HEIGHTS = np.linspace(0, 1.5, 31) * 1e-3
LENSES = {
    "barrel": RadialPolynomial(-0.12, 0.02, 1e-3),
    "pincushion": RadialPolynomial(0.05, 0.08, 1e-3, scale=1.003),
    "decentred": BrownConrady(-0.2, 0.05, -0.004, 2e-3, -1e-3, 1e-3),
    # tan(theta) imaged at 2 tan(theta / 2): stereographic
    "table": RadialTable(HEIGHTS, 2e-3 * np.tan(np.arctan(HEIGHTS / 1e-3) / 2)),
}


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_the_inverse_undoes_the_distortion(lens):
    """Newton stops at 1e-13 of the radius; the forward evaluation rounds by a few 1e-16."""
    random = np.random.default_rng(0)
    x, y = random.uniform(-0.5, 0.5, (2, 500))
    at = lens.distort(*ideal(lens, x, y))
    assert np.abs(np.array(at) - (x, y)).max() < 1e-12


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_the_derivative_is_that_of_the_mapping(lens):
    """Central differences at h = 1e-5: h^2/6 times the third derivative (<= 10, but at knots of the
    spline, where it jumps) and 1e-16 / h of rounding."""
    random = np.random.default_rng(1)
    x, y = random.uniform(-0.5, 0.5, (2, 500))
    h = 1e-5
    along_x, along_y = (
        np.subtract(lens.distort(x + dx, y + dy), lens.distort(x - dx, y - dy)) / (2 * h)
        for dx, dy in ((h, 0), (0, h))
    )
    wanted = np.array([along_x[0], along_y[0], along_x[1], along_y[1]])
    assert np.abs(np.array(lens.derivative(x, y)) - wanted).max() < 1e-5


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_the_grid_keeps_the_error_that_it_states(lens):
    """At every pixel, not only at those that the planner looked at; the reference's interpolation in float64."""
    from gpusim.kernels.optics.distort_ref import _lagrange

    shape = (301, 403)
    grid = distortion_grid(lens, shape, 4e-6)
    y, x = (np.indices(shape) - (np.array(shape)[:, None, None] - 1) / 2) * (4e-6 / lens.radius)
    u, v = ideal(lens, x, y)
    wanted = (
        np.array([v, u]) * (lens.radius / 4e-6)
        + (np.array(shape)[:, None, None] - 1) / 2
        - np.indices(shape)
    )
    found = _lagrange(grid.nodes, shape, np.arange(shape[0]), np.arange(shape[1]))[:2]
    assert grid.error[0] <= 1e-3
    # the product polynomial errs most half-way between the nodes, up to slopes of the fourth derivative: a tenth more,
    # except at the kink that k1 r makes at the axis, where the largest error may lie a quarter-cell away: 2.5 x
    assert np.abs(found - wanted).max() <= 2.5 * grid.error[0] + 1e-12


@pytest.mark.parametrize("device", KINDS)
def test_case_30_energy_per_solid_angle_at_100_degrees(device):
    """cos^4 illumination, then a barrel down to an equal-area image: energy in rings of field angle to 1e-3, no holes.

    The pinhole image of a uniform sphere has irradiance cos^4(theta), that is energy pi sin^2(theta) f^2 within theta.
    After the distortion that energy is within the distorted radius of theta. Checked for the disc inside each radius
    (pixels cut by the circle count by the area inside, to 8 x 8 subpixels).
    """
    half = np.radians(50)
    angles = np.linspace(0, np.radians(52), 53)
    lens = RadialTable(np.tan(angles) * 1e-3, 2e-3 * np.sin(angles / 2))  # f = 1 mm, equisolid
    n = 240
    pitch = 2 * 2e-3 * np.sin(half / 2) / (np.sqrt(2) * n)  # 100 degrees from corner to corner
    size = 2 * int(np.ceil(np.tan(half) * 1e-3 / np.sqrt(2) / pitch)) + 2 * 10
    r = np.hypot(*((np.indices((size, size)) - (size - 1) / 2) * pitch))
    plane = relative_illumination("cos4", (size, size), pitch, 1e-3)
    assert np.allclose(plane, np.cos(np.arctan(r / 1e-3)) ** 4, rtol=1e-12)
    grid = distortion_grid(lens, (n, n), pitch, (size, size))
    assert grid.ratio[1] > 1.5 and "samples per pixel" in grid.report
    sub_r = np.hypot(*((np.indices((8 * n, 8 * n)) - (8 * n - 1) / 2) * (pitch / 8)))
    for method in ("cubic", "area"):
        image = distort(
            plane[None].astype(np.float32),
            grid.nodes[None].astype(np.float32),
            (n, n),
            "zero",
            method,
            device=open_device(device),
        )[0].astype(np.float64)
        assert image.min() > 0  # no holes
        previous = 0.0, 0.0
        for degrees in (10, 20, 30, 34):
            theta = np.radians(degrees)
            share = (sub_r < 2e-3 * np.sin(theta / 2)).reshape(n, 8, n, 8).mean(axis=(1, 3))
            energy = (image * share).sum() * pitch**2, np.pi * np.sin(theta) ** 2 * 1e-6
            # ring by ring: a wrong flux factor anywhere would show; a circle of R = 280 subpixels is off by 2e-4
            ring = np.subtract(energy, previous)
            assert ring[0] == pytest.approx(ring[1], rel=1e-3)
            previous = energy


@pytest.mark.parametrize("device", KINDS)
def test_area_weighting_conserves_every_point(device):
    """White noise and points of 1e6 well inside the frame: the energy that arrives is what was sent.

    Float32 places of up to 14 samples' difference err by 1e-6 of a sample, shared by neighbours; weights, products and
    16 sums round by 6e-8 each: 1e-6 in all.
    """
    random = np.random.default_rng(2)
    shape = (120, 160)
    lens = RadialPolynomial(-0.1, -0.05, PITCH * 100)
    grid = distortion_grid(lens, shape, PITCH)
    plane = np.zeros(shape, np.float32)
    plane[30:-30, 40:-40] = random.random((60, 80))
    plane[40, 50] = plane[77, 90] = 1e6
    image = distort(
        plane[None],
        grid.nodes[None].astype(np.float32),
        shape,
        "zero",
        "area",
        device=open_device(device),
    )
    assert image.min() >= 0
    assert image.sum(dtype=np.float64) == pytest.approx(plane.sum(dtype=np.float64), rel=1e-6)


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("method", ["cubic", "area"])
def test_lateral_colour_moves_planes_apart(device, method):
    """Two planes at scales 1 and 1.02: a spot's centroid moves by 2 % of its field height, its energy stays."""
    shape, spot = (101, 141), (20.0, 30.0)  # from the axis
    middle = (np.array(shape) - 1) / 2
    y, x = np.indices(shape) - middle[:, None, None]
    plane = np.exp(-((y - spot[0]) ** 2 + (x - spot[1]) ** 2) / (2 * 2.5**2))
    planes = np.stack([plane, plane]).astype(np.float32)
    grids = [
        distortion_grid(RadialPolynomial(0, 0, 1e-4, scale=scale), shape, PITCH)
        for scale in (1.0, 1.02)
    ]
    image = distort(
        planes,
        np.stack([grid.nodes for grid in grids]).astype(np.float32),
        shape,
        "zero",
        method,
        device=open_device(device),
    ).astype(np.float64)
    for moved, scale in zip(image, (1.0, 1.02), strict=True):
        # a Gaussian of sigma 2.5 is band-limited to e^-31 at Nyquist: Keys' cubic errs by (pi^4 / ...) < 1e-3
        assert moved.sum() == pytest.approx(plane.sum(), rel=1e-4)
        centroid = (moved * y).sum() / moved.sum(), (moved * x).sum() / moved.sum()
        assert centroid == pytest.approx((scale * spot[0], scale * spot[1]), abs=0.02)
    # scale 1 is the identity up to float32's rounding of weights
    assert np.abs(image[0] - plane).max() < 1e-6


def test_a_finer_source_is_integrated_over_the_pixel():
    """Source samples of half a pixel, no distortion: each pixel is the mean of its 2 x 2 samples."""
    random = np.random.default_rng(3)
    fine = random.random((1, 60, 80))
    grid = distortion_grid(RadialPolynomial(0, 0, 1e-4), (30, 40), 2 * PITCH, (60, 80), PITCH)
    assert grid.ratio == pytest.approx((2, 2), abs=1e-9)
    image = distort(fine, grid.nodes[None], (30, 40), "zero", "area", density=0.25, device="numpy")
    # float64 throughout: 1e-13 of position against differences of 80
    assert np.abs(image[0] - fine[0].reshape(30, 2, 40, 2).mean(axis=(1, 3))).max() < 1e-11


def test_a_grid_ratio_above_two_is_reported():
    shape = (64, 64)
    grid = distortion_grid(RadialPolynomial(0, 0, 1e-4, scale=0.4), shape, PITCH)
    assert grid.ratio == pytest.approx((2.5, 2.5))
    assert "area weighting" in grid.report
    # the frame sees 0.75 of its own width beyond the source on each side
    assert grid.reach == pytest.approx(0.75 * 64, abs=1e-9)


@pytest.mark.parametrize(
    ("lens", "message"),
    [
        (RadialPolynomial(-0.5, -0.2, PITCH * 40), "turns back at ideal field height"),
        (RadialTable([0, 1e-5, 2e-5, 3e-5], [0, 1e-5, 2e-5, 3e-5]), "as far as the frame's corner"),
    ],
)
def test_a_mapping_that_does_not_cover_the_frame_is_refused(lens, message):
    with pytest.raises(OutOfRange, match=message):
        distortion_grid(lens, (64, 64), PITCH)


def test_a_fisheye_in_a_tiny_frame_is_a_fine_grid():
    """20 x 24 pixels to 80 degrees: places by Newton's method at each pixel, against nodes less than a pixel apart."""
    shape, pitch = (20, 24), 2e-6
    focal = np.hypot(*shape) / 2 * pitch / np.deg2rad(80)
    lens = Fisheye(0.0, 0.0, 0.0, 0.0, focal)
    made = distortion_grid(lens, shape, pitch)
    assert min(made.nodes.shape[:2]) > max(shape)
    y, x = np.meshgrid(*((np.arange(n) - (n - 1) / 2) * pitch for n in shape), indexing="ij")
    angle = np.hypot(y, x) / focal
    stretch = np.tan(angle) / angle
    rows, cols, flux = places_of(made.nodes, shape)
    wanted = [at / pitch * stretch + (n - 1) / 2 for at, n in zip((y, x), shape, strict=True)]
    assert np.hypot(rows - wanted[0], cols - wanted[1]).max() < 1e-3
    # energy by area: d(tan t)^2 / d(t^2) = tan t / (t cos^2 t)
    np.testing.assert_allclose(flux, stretch / np.cos(angle) ** 2, rtol=2e-3)


def test_bad_tables_are_refused():
    with pytest.raises(BadData, match="real heights must rise"):
        RadialTable([0, 1, 2, 3], [0, 1, 0.9, 2])
    with pytest.raises(BadData, match="two lists"):
        RadialTable([0, 1], [0, 1])
    with pytest.raises(OutOfRange, match="radius"):
        RadialPolynomial(0, 0, 0.0)
    with pytest.raises(OutOfRange, match="k1"):
        RadialPolynomial(np.nan, 0, 1.0)
    with pytest.raises(OutOfRange, match="gain"):
        relative_illumination((-2.0,), (8, 8), PITCH, 1e-3)
    with pytest.raises(OutOfRange, match="corner"):
        relative_illumination(([0.0, 0.5], [1.0, 0.9]), (8, 8), PITCH, 1e-3)


@pytest.mark.parametrize("device", KINDS)
def test_falloff_of_lens_and_microlenses(device):
    """A quadratic lens and microlenses of cosine response, matched half-way: the product, pixel by pixel."""
    shape, pupil = (31, 41), 60e-6
    lens = relative_illumination((0.0, -0.4), shape, PITCH, 1e-3)
    angles = np.radians(np.linspace(0, 60, 241))
    micro = microlens_gain(Microlens(angles, np.cos(angles), 0.5), shape, PITCH, pupil)
    r = np.hypot(*((np.indices(shape) - (np.array(shape)[:, None, None] - 1) / 2) * PITCH))
    wanted = (1 - 0.4 * (r / (PITCH * np.hypot(*shape) / 2)) ** 2) * np.cos(
        np.arctan(r / pupil) - np.arctan(0.5 * r / pupil)
    )
    # linear interpolation of a cosine every quarter degree: (0.25 deg)^2 / 8 = 2.4e-6
    image = falloff(
        np.ones((2, *shape), np.float32),
        (lens * micro)[None].astype(np.float32),
        device=open_device(device),
    )
    assert np.abs(image - wanted).max() < 3e-6


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize("model", ["diffraction", "none"])
def test_light_beside_an_edge_is_not_negative(device, model):
    """Cubics overshoot by 7 % next to a step, before any blur; bright squares on black have many. Float32: 1e-6."""
    camera = open_camera("phone")
    optics = replace(
        camera.optics, model=model, f_number=1.2, distortion=RadialPolynomial(-0.12, 0.02, 1e-3)
    )
    y, x = np.indices((64, 64)) // 8
    values = np.where((y + x) % 2, 0, 1e15).astype(np.float32)
    scene = Scene(
        Cube(np.array([400.0, 500, 600, 700]), np.stack([values] * 4)),
        as_photons("D65"),
        border="zero",
    )
    simulate = Simulator(replace(camera, optics=optics), device=device)
    mean = np.array(simulate.device.numpy(simulate.expose(scene, 0.01).mean))
    plan = simulate.plan(scene)
    assert plan.find(DistortionGrid).method == "cubic"
    before = np.array(simulate.device.numpy(simulate.imaging.light(plan)))
    assert before.min() >= -1e-6 * before.max()
    assert mean.min() >= 0
    assert mean.max() > 0


def looked_at(shape, move):
    """Where pixels look, from the middle, and ideal area over distorted area; r^ = r + move (r / corner)^3 [pixel]."""
    corner = np.hypot(*shape) / 2
    y, x = np.ix_(*((np.arange(n) - (n - 1) / 2) / corner for n in shape))
    r = np.hypot(y, x)
    u, k = r.copy(), move / corner
    for _ in range(20):  # Newton's method
        u -= (u * (1 + k * u * u) - r) / (1 + 3 * k * u * u)
    factor = np.divide(u, r, out=np.ones_like(r), where=r > 0)
    return factor * y * corner, factor * x * corner, factor / (1 + 3 * k * u * u)


@pytest.mark.parametrize(
    ("waves", "move"),
    [
        ((0.11, 0.13, 0.17), 3.0),
        ((0.11, 0.13, 0.17), -3.0),
        ((0.11, 0.13, 0.17), 0.4),
        ((0.11, 0.13, 0.17), 0.1),
        ((0.05,), 3.0),
        ((0.3,), 3.0),
        ((0.4, 0.1), 3.0),
    ],
)
def test_what_a_distortion_interpolates_is_predicted(waves, move):
    """Cosines by formula, of so many cycles per sample, which a lens moves by up to `move` samples.

    Nothing is shared with the frame: the inverse of the distortion, the light at a place and the flux are formulas.
    Every figure is to be within 2.5, and the root mean square not below the truth / 1.5.
    """
    shape, margin = (150, 200), 12
    random = np.random.default_rng(0)
    angles, starts = random.uniform(0, np.pi, len(waves)), random.uniform(0, 2 * np.pi, len(waves))

    def light(y, x):
        return 1 + 0.9 / len(waves) * sum(
            np.cos(2 * np.pi * f * (np.cos(angle) * y + np.sin(angle) * x) + start)
            for f, angle, start in zip(waves, angles, starts, strict=True)
        )

    def scene(values, **options):
        return Scene(
            Cube(np.array([540.0, 550.0, 560.0]), np.stack([values] * 3).astype(np.float32)),
            as_photons("D65"),
            **options,
        )

    camera = open_camera("mono")
    corner = np.hypot(*shape) / 2 * camera.sensor.pixel_pitch
    plain = replace(
        camera, optics=replace(camera.optics, model="none", relative_illumination="none")
    )
    camera = replace(
        plain,
        optics=replace(
            plain.optics, distortion=RadialPolynomial(0.0, move / (np.hypot(*shape) / 2), corner)
        ),
    )
    simulator = Simulator(camera, device=KINDS[0], tolerance=3e-5)
    drawn = light(*np.ix_(*(np.arange(n + 2 * margin) - (n + 2 * margin - 1) / 2 for n in shape)))
    exposure = simulator.expose(scene(drawn, border="scene", margin=margin), 1e-3)
    unit = Simulator(plain, device="numpy").expose(scene(np.ones(shape)), 1e-3).mean.mean()
    y, x, flux = looked_at(shape, move)
    truth = unit * flux * light(y, x)
    error = np.array(simulator.device.numpy(exposure.mean), np.float64) - truth
    sigmas = np.abs(error) / np.sqrt(np.maximum(truth + camera.sensor.read_sigma**2, 1))
    rms = np.sqrt(np.mean(error**2) / np.mean(truth**2))
    bound = exposure.plan.account.bounds["distortion"]
    assert rms / 1.5 < bound.rms < 2.5 * rms
    if waves != (
        0.05,
    ):  # windows of 64 samples end waves of 20: they leak into shorter ones, which err more
        assert sigmas.max() / 2.5 < bound.max_sigma < 2.5 * sigmas.max()
        assert (
            np.quantile(sigmas, 0.999) / 2.5 < bound.p999_sigma < 2.5 * np.quantile(sigmas, 0.999)
        )
    verdict = exposure.plan.verdict
    assert not verdict.is_met and verdict.by == "distortion" and "drawn finer" in str(verdict)


@pytest.mark.parametrize("shape", [(300, 400), (700, 1100)])
def test_cos4_behind_an_equidistant_fisheye_is_that_of_the_radius(shape):
    """The angle is the radius over the focal length; cubics between 256 cells of 120 degrees err by less than 1e-7."""
    pitch, focal, moved = 2e-6, 1.05 * shape[1] / 2 * 2e-6, (0.3, -0.2)
    law = _undistorted_law(Fisheye(0, 0, 0, 0, focal), shape, pitch, moved, pitch / focal)
    y, x = (
        (np.arange(n) - (n - 1) / 2 + move) * pitch for n, move in zip(shape, moved, strict=True)
    )
    wanted = np.cos(np.hypot(y[:, None], x) / focal) ** 4
    np.testing.assert_allclose(law, wanted, atol=1e-7, rtol=0)

"""The pixel's geometry in the optics: oblong apertures, displaced grids, pixel vignetting, and what is refused."""

import dataclasses

import numpy as np
import pytest
from devices import ALL_KINDS, KINDS
from scipy.interpolate import RegularGridInterpolator
from scipy.special import erf, j1

from gpusim.data.charts import chart
from gpusim.domain.content import Cube, Materials
from gpusim.domain.distortion import RadialPolynomial
from gpusim.domain.errors import OutOfRange
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import Spectrum
from gpusim.io.camera.cameras import open_camera
from gpusim.kernels.optics.airy import airy
from gpusim.kernels.optics.blur import blur
from gpusim.kernels.optics.pupil import pupil
from gpusim.optics.geometry import vignetting_gain
from gpusim.optics.highlights import Highlights
from gpusim.optics.lens import PupilLens
from gpusim.optics.psf import psf_tables
from gpusim.optics.sampling import sampling_error
from gpusim.pipeline.simulator import Simulator
from gpusim.planner.facts import Facts

BANDS = np.array([500.0, 550.0, 600.0])  # [nm]
OBLONG, ASIDE = (1.0, 0.5), (0.5, -0.25)  # height and width, (rows, cols) [pixel]
MOVED = (2.0, -2.0)  # a whole period of the mosaic


def camera(q=1.0, pitch=None, sensor=(), name="machine-vision", **optics):
    """A camera without fall-off whose wavelength x f-number / pitch is q at 550 nm."""
    made = open_camera(name)
    pitch = pitch or made.sensor.pixel_pitch
    return dataclasses.replace(
        made,
        sensor=dataclasses.replace(
            made.sensor, pixel_pitch=pitch, exposure_time=0.01, **dict(sensor)
        ),
        optics=dataclasses.replace(
            made.optics,
            **{
                "f_number": q * pitch / 550e-9,
                "relative_illumination": "none",
                "object_distance": np.inf,
            }
            | optics,
        ),
    )


def noise(shape, **scene):
    """Radiance of independent samples in three bands, as hard as a scene can be."""
    values = np.random.default_rng(5).random((3, *shape), np.float32)
    return Scene(Cube(BANDS, values), Spectrum(BANDS[[0, -1]], np.full(2, 1e17)), **scene)


def mean(scene, camera, device="numpy", **options):
    simulator = Simulator(camera, device=device, **options)
    return np.array(simulator.device.numpy(simulator.expose(scene, 0.01).mean), np.float64)


def airy_energy(q, height, width, y, x):
    """Energy of a point that falls into a rectangle about (y, x) [pixel], over its area: Gauss-Legendre, float64.

    The pattern has ripples of length q: 60 nodes over one pixel leave nothing at q >= 0.3.
    """
    nodes, weights = (array / 2 for array in np.polynomial.legendre.leggauss(60))
    v = np.maximum(np.pi / q * np.hypot(y + height * nodes[:, None], x + width * nodes), 1e-9)
    return weights @ (np.pi / (4 * q * q) * (2 * j1(v) / v) ** 2) @ weights


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(
    ("q", "aperture", "aside"),
    [
        (1.1, OBLONG, (0, 0)),
        (0.71, OBLONG, ASIDE),
        (0.3, (0.4, 0.6), (-0.3, 0.2)),
        (2.5, (1.0, 1.0), (0.5, 0.5)),
        (0.9, (0.8, 0.8), (-2.0, 1.25)),
    ],
)
def test_image_of_a_point_is_the_airy_pattern_integrated_over_its_rectangles(
    q, aperture, aside, device
):
    """Nine pixels, by quadrature over the displaced rectangles, within 1e-5 of the peak.

    In theory they differ by what folds back of the pattern beyond the period, four times 2 q / (pi^3 r^3): 2e-7 at
    q = 2.5, where the peak is 0.12. float32 adds 3e-7 of the point's energy. Together 4.2e-6 of the peak.
    """
    size, period = 15, (135, 144)
    flat = np.zeros((1, 3, 3))
    q = float(np.float32(q))
    if any(aside):
        tables = pupil(
            Pupil(), flat, np.array([q]), aperture, *period, displacement=aside, device=device
        )
    else:
        tables = airy(np.array([q]), aperture, *period, device=device)
    point = np.zeros((1, size, size), np.float32)
    point[0, 7, 7] = 1
    image = blur(point, tables[None], np.ones((1, 1)), "zero", period, device=device)[0]
    places = [(y, x) for y in (-1, 0, 3) for x in (-2, 0, 1)]
    truth = np.array([airy_energy(q, *aperture, y + aside[0], x + aside[1]) for y, x in places])
    found = np.array([image[7 + y, 7 + x] for y, x in places])
    assert np.abs(found - truth).max() <= 1e-5 * truth.max()


@pytest.mark.parametrize("device", ALL_KINDS)
def test_the_pixel_alone_passes_a_sinc_along_each_axis(device):
    """At q = 2 and more nothing folds: the table is O times sinc(fy) along y and sinc(fx / 2) along x, |f| < 1/2.

    Tolerance: that of the stage, 1e-6; O is at least 0.2 up to f = 0.3, which divides it: 5e-6.
    """
    n, q = 40, 2.0
    table = airy(np.array([q], np.float32), OBLONG, n, n, device=device)[0].astype(float)
    f = np.arange(13) / n
    s = q * f
    lens = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    np.testing.assert_allclose(table[:13, 0] / lens, np.sinc(f), atol=5e-6)
    np.testing.assert_allclose(table[0, :13] / lens, np.sinc(f / 2), atol=5e-6)


def test_measured_spreads_are_integrated_over_displaced_rectangles():
    """A Gaussian of 0.6 pixels, sampled at a fifth of a pixel: energies of rectangles by the error function.

    The samples tell it to exp(-2 (pi 0.6 x 2.5)^2) = 5e-20; they end at 5 sigma, where 1e-6 is left outside.
    """
    sigma, pitch, n = 0.6, 2e-6, 32
    at = (np.arange(31) - 15) / 5
    line = np.exp(-(at**2) / (2 * sigma**2))
    spread = PointSpread([550.0], np.outer(line, line)[None], pitch / 5)
    tables = psf_tables(spread, [550.0], pitch, OBLONG, n, n, displacement=ASIDE).view(complex)[0]
    image = np.fft.irfft2(tables, (n, n))
    axes = []
    for width, move in zip(OBLONG, ASIDE, strict=True):
        middle = np.fft.fftfreq(n, 1 / n) + move
        edges = (middle[:, None] + width * np.array([-0.5, 0.5])) / (np.sqrt(2) * sigma)
        axes.append(np.diff(erf(edges), axis=1)[:, 0] / 2 / width)
    assert np.abs(image - np.outer(*axes)).max() <= 2e-6 * image.max()


def test_field_kernels_are_integrated_over_displaced_rectangles():
    """Kernels on the axis against the Airy pattern's quadrature, both over the sum within the kernel: 1e-3 of the peak.

    That is ten times the error that the lens's own kernels are laid out for (gpusim/optics/sampled.py).
    """
    optics = camera().optics
    q, size = 0.8, 15
    lens = PupilLens(optics, 550e-9 * optics.f_number / q, OBLONG, 100.0, ASIDE)
    kernel = lens.kernels([550.0], (0.0, 0.0), size)[0]
    middle = np.arange(size) - size // 2
    truth = np.array(
        [[airy_energy(q, *OBLONG, y + ASIDE[0], x + ASIDE[1]) for x in middle] for y in middle]
    )
    assert np.abs(kernel / kernel.sum() - truth / truth.sum()).max() <= 1e-3 * kernel.max()


MEASURED = PointSpread(
    BANDS,
    np.stack(
        [
            np.outer(g, g * (1 + 0.4 * np.linspace(-1, 1, 25)))
            for g in (np.exp(-(np.linspace(-3, 3, 25) ** 2) / (2 * s * s)) for s in (0.7, 0.8, 0.9))
        ]
    ),
    1e-7,
)
PATHS = {  # optics, scene, options; tolerance
    "ideal, folded": ({}, {}, {}, 1e-12),
    "small pixels with fall-off": (
        {"relative_illumination": "cos4", "sensor": {"fill_factor": 0.4}},
        {},
        {},
        2e-7,
    ),
    "fused": ({}, {}, {"tolerance": 1e-3}, 1e-9),
    "defocus, low-pass": (
        {"defocus": 2e-5, "birefringence": (2e-6, 1e-6), "diffuser": 1e-6},
        {},
        {},
        1e-12,
    ),
    "coma": ({"wavefront": Wavefront(zernike=(0, 0, 0, 0, 0, 0, 0, 0.2))}, {}, {}, 1e-12),
    "measured": ({"model": "measured", "psf": MEASURED}, {}, {}, 2e-7),
    "measured, small pixels": (
        {"model": "measured", "psf": MEASURED, "sensor": {"fill_factor": 0.4}},
        {},
        {},
        2e-7,
    ),
    "distortion": ({"distortion": RadialPolynomial(0, 0, 0.02)}, {}, {}, 1e-12),
    "vignetting": (
        {"sensor": {"vignetting": np.array([[0.5, 0.9], [1.0, 0.7], [0.2, 0.6]])}},
        {},
        {},
        2e-7,
    ),
    "two samples": ({}, {"samples_per_pixel": 2}, {}, 1e-12),
    "fine": ({"sensor": {"photodetector": (0.3, 0.7)}}, {"samples_per_pixel": 1.25}, {}, 1e-12),
    "no blur": ({"model": "none"}, {}, {}, 1e-12),
    "no blur, fine": ({"model": "none"}, {"samples_per_pixel": 1.25}, {}, 1e-12),
    # layers, and sums between them over the pupil; kernels by distance end in a window that the displacement moves, and
    # the plan permits 1 % of the tolerance for the light beyond
    "depth": (
        {"object_distance": 1.0, "f_number": 4.0},
        {"depth": True},
        {"tolerance": 0.03},
        3e-4,
    ),
    # What diffraction makes of products is found within the frame, whose edges go on: the tenth of a kernel that is
    # beyond them (q = 0.64) has other light. The covariance is of light that a disc of 4 pixels averages, of deviation
    # 0.08, and of a coverage that falls over 3 pixels, 0.15 within a kernel, or over one, 0.3. The ends of kernels
    # add 1.5e-4.
    "depth, diffraction": ({"object_distance": 1.0, "f_number": 4.0}, {"depth": True}, {}, 1.7e-3),
    "depth, in focus": ({"object_distance": 0.8, "f_number": 4.0}, {"depth": True}, {}, 2.5e-3),
    # the sums of the kernels' ends differ; twice the tolerance of a field without one asked for
    "field": ({"wavefront": Wavefront(seidel=(0.0, 0.4, 0.3, 0.2, 0.0))}, {}, {}, 1e-3),
}


@pytest.mark.parametrize(
    ("path", "border"),
    [
        *(
            pytest.param(path, "edge", marks=[pytest.mark.slow] if path == "field" else [])
            for path in PATHS
        ),
        ("ideal, folded", "zero"),
        ("ideal, folded", "scene"),
        ("fine", "reflect"),
        ("fine", "scene"),
        ("two samples", "zero"),
        ("no blur", "zero"),
        ("no blur, fine", "reflect"),
    ],
)
def test_a_grid_displaced_by_whole_pixels_takes_the_same_picture_elsewhere(path, border):
    """Pixels of the displaced grid are those of a grid in the middle, MOVED rows and columns on: float64 rounding.

    Gains and the tables of measured spreads reach the stages as float32: half an ulp, 6e-8, of each, over up to 0.4.

    With MOVED as the mosaic's period colours agree. The transforms of both have the same period, so that what wraps is
    the same: the displaced plan adds its largest displacement, 2 pixels, to the reach.
    """
    optics, scene, options, tolerance = PATHS[path]
    optics, scene = dict(optics), dict(scene)
    sensor, ratio = optics.pop("sensor", {}), scene.get("samples_per_pixel", 1)
    shape = [int(n * ratio) for n in (24, 30)]
    if border == "scene":
        scene |= {"margin": 8}
        shape = [n + 16 for n in shape]
    if "depth" in scene:
        scene["depth"] = np.where(np.arange(shape[1]) < 18, 0.8, 1.5) * np.ones((shape[0], 1))
    scene = noise(shape, border=border, **scene)
    middle = mean(scene, camera(sensor=sensor, **optics), reach=30, **options)
    displaced = mean(
        scene, camera(sensor=sensor | {"offset": MOVED}, **optics), reach=28, **options
    )
    expected, found = middle[2:, :-2], displaced[:-2, 2:]
    error = (
        np.sqrt(np.mean((found - expected) ** 2))
        if path == "field"
        else np.abs(found - expected).max()
    )
    assert error <= tolerance * middle.max(), f"{error / middle.max():.2e}"
    opposite = middle[:-2, 2:] - displaced[2:, :-2]  # the test sees a wrong sign
    assert np.sqrt(np.mean(opposite**2)) > 0.05 * middle.max()


@pytest.mark.parametrize("device", ALL_KINDS[:2])
def test_captures_interleave_to_the_picture_of_a_finer_sensor(device):
    """Photodetectors of half the pitch at +- 1/4: four captures are the pixels of a sensor of half the pitch.

    Two of them, a quarter up and left and a quarter down and right, are the quincunx of a Super CCD. The same samples
    are blurred by the same tables: the blur's 2.4e-6 of the peak on a device, float64 rounding in NumPy.
    """
    pitch, shape = 3e-6, (24, 20)
    fine = mean(noise(shape), camera(1.4, pitch / 2, name="mono"), device, reach=32)
    coarse = np.zeros(shape)
    for y in (0, 1):
        for x in (0, 1):
            captured = camera(
                0.7,
                pitch,
                {"photodetector": (0.5, 0.5), "centre": (y / 2 - 0.25, x / 2 - 0.25)},
                "mono",
            )
            coarse[y::2, x::2] = mean(noise(shape, samples_per_pixel=2), captured, device, reach=16)
    assert np.abs(coarse - fine).max() <= (1e-12 if device == "numpy" else 4e-6) * fine.max()


@pytest.mark.parametrize("device", ALL_KINDS[:2])
def test_displaced_pixels_see_points_as_finer_pixels_do(device):
    """Points in the middle of pixels, by photodetectors of a third of the pitch in four of nine places.

    A sensor of a third of the pitch sees them, nine times as bright, in every third of its pixels, by the path without
    displacement. Tables are those of one lens; periods differ and fold back what is beyond 120 of the coarse pixels:
    up to 2 q / (pi^3 r^3) = 2e-8 from each of four sides of 120 points of 0.5, 5e-6 where the brightest pixel has 0.5.
    float32 adds 3e-7 of the fine frame's root mean square, and as much for the coarse one's.
    """
    shape, pitch, q = (10, 12), 3e-6, 0.6
    values = np.zeros((3, *shape), np.float32)
    values[1] = np.random.default_rng(3).random(shape)
    points = np.zeros((3, 30, 36), np.float32)
    points[:, 1::3, 1::3] = 9 * values
    light = Spectrum(BANDS[[0, -1]], np.full(2, 1e17))
    fine = mean(
        Scene(Cube(BANDS, points), light, border="zero"),
        camera(3 * q, pitch / 3, name="mono"),
        device,
        reach=165,
    )
    for y, x in ((0, 0), (2, 1), (0, 2), (1, 2)):
        own = camera(
            q,
            pitch,
            {"photodetector": (1 / 3, 1 / 3), "centre": ((y - 1) / 3, (x - 1) / 3)},
            "mono",
        )
        simulator = Simulator(own, device=device, reach=55)
        exposure = simulator.expose(Scene(Cube(BANDS, values), light, border="zero"), 0.01)
        coarse = exposure.plan.flat[1] * simulator.device.numpy(exposure.mean)
        assert np.abs(coarse - fine[y::3, x::3]).max() <= 1.5e-5 * fine.max()


@pytest.mark.parametrize("device", ALL_KINDS)
@pytest.mark.parametrize(
    ("ratio", "aperture", "aside"),
    [(1, (1.0, 1.0), (2.0, -3.0)), (2, (1.0, 0.5), (0.25, -0.5)), (2, (0.5, 1.0), (-1.75, 2.5))],
)
@pytest.mark.parametrize("border", ["edge", "reflect", "zero"])
def test_without_blur_rectangles_are_filled_by_area(ratio, aperture, aside, border, device):
    """Every sample as 8 x 8 points, the mean over those in each rectangle; float32: 4 ulp of the largest value."""
    shape, parts, more = (10 * ratio, 12 * ratio), 8, 6
    values = np.random.default_rng(1).random(shape).astype(np.float32)
    scene = Scene(
        Materials(BANDS, np.zeros(shape, np.uint8), values, np.ones((1, 3))),
        Spectrum(np.array([400.0, 700.0]), np.full(2, 1e17)),
        samples_per_pixel=ratio,
        border=border,
    )
    made = camera(1.0, 3e-6, {"photodetector": aperture, "offset": aside}, "mono", model="none")
    weights = Simulator(made, device="numpy").plan(scene).weights.sum()
    mode = {"edge": "edge", "reflect": "symmetric", "zero": "constant"}[border]
    points = np.kron(np.pad(values, more, mode=mode), np.ones((parts, parts)))

    def inside(n, width, move):
        at = (
            (np.arange(n * ratio * parts + 2 * more * parts) + 0.5) / (parts * ratio)
            - more / ratio
            - 0.5
        )
        chosen = (np.abs(at - move - np.arange(n)[:, None]) < width / 2).astype(float)
        return chosen / chosen.sum(axis=1, keepdims=True)

    rows, cols = (inside(n, *of) for n, *of in zip((10, 12), aperture, aside, strict=True))
    expected = 0.01 * weights * rows @ points @ cols.T
    assert np.abs(mean(scene, made, device) - expected).max() <= 5e-7 * expected.max()


def test_flat_scenes_are_flat_behind_any_rectangle():
    """Electrons are weights times the reflectance wherever the rectangle is; float32 weights of tables: 6e-8."""
    for sensor in (
        {"photodetector": (0.9, 0.4)},
        {"photodetector": (0.3, 0.4), "centre": (0.3, -0.25)},
        {"offset": (0.5, 0.5)},
    ):
        made = camera(0.5, sensor=sensor, name="mono")
        scene = chart("flat", size=(9, 8), reflectance=0.3, wavelengths=BANDS)
        weights = Simulator(made, device="numpy").plan(scene).weights.sum()
        area = made.sensor.aperture[0] * made.sensor.aperture[1]
        whole = Simulator(camera(0.5, name="mono"), device="numpy")
        assert weights == pytest.approx(
            whole.plan(scene).weights.sum() * area / made.sensor.pixel_pitch**2, rel=1e-12
        )
        np.testing.assert_allclose(
            mean(scene, made, reach=16), 0.01 * float(np.float32(0.3)) * weights, rtol=6e-8
        )


@pytest.mark.parametrize("device", KINDS)
def test_vignetting_is_bilinear_from_edge_to_edge(device):
    """A flat field is the map, by SciPy's interpolation at the pixels' places; float32: 2 ulp."""
    map_ = np.random.default_rng(2).random((3, 4)) + 0.1
    rows, cols, (dy, dx) = 9, 8, (0.25, 0.5)
    y, x = (np.arange(rows) + 0.5 + dy) / rows, (np.arange(cols) + 0.5 + dx) / cols
    truth = RegularGridInterpolator([np.linspace(0, 1, n) for n in map_.shape], map_)(
        np.stack(np.meshgrid(np.minimum(y, 1), np.minimum(x, 1), indexing="ij"), axis=-1)
    )
    np.testing.assert_allclose(vignetting_gain(map_, (rows, cols), (dy, dx)), truth, rtol=1e-13)
    scene = chart("flat", size=(cols, rows), reflectance=0.3, samples_per_pixel=2)
    even, dark = (
        mean(scene, camera(1.0, sensor=more, name="mono", model="none"), device)
        for more in ({}, {"vignetting": map_, "offset": (dy, dx)})
    )
    np.testing.assert_allclose(dark, even * truth, rtol=4e-7)


def test_highlights_are_split_off_whatever_the_pixels():
    """Nothing is left in the planes; tests/judges/test_points.py has their light."""
    oblong, aside = {"photodetector": OBLONG}, {"offset": ASIDE}
    for sensor, ratio in (({}, 1), (oblong, 1), (aside, 1), (oblong | aside, 2)):
        scene = chart(
            "points",
            size=(24, 20),
            samples_per_pixel=ratio,
            wavelengths=BANDS,
            count=3,
            highest=1e5,
        )
        plan = Simulator(camera(sensor=sensor), device="numpy").plan(scene)
        assert plan.find(Highlights) is not None
        assert "local error next to highlights" not in plan.beside


def test_the_sampling_error_knows_rectangles_and_places():
    """Scenes whose edges have all directions: rows and columns may be exchanged, and whole pixels change nothing."""
    scene = chart("flat", size=(24, 24), wavelengths=BANDS)
    values = np.random.default_rng(8).random((24, 24)).astype(np.float32)
    content = dataclasses.replace(scene.content, shading=values + values.T)
    q, weights, share = BANDS / 550 * 0.8, np.ones((1, 3)), np.ones(1)

    class Ideal:
        def of(self, q, aperture, rows, cols, finer):
            return airy(q, aperture, rows, cols, device="numpy")

    def error(aperture, displacement):
        return sampling_error(
            Facts(content).moments(weights),
            weights,
            q,
            share,
            1.0,
            aperture,
            None,
            Ideal(),
            displacement,
        )

    assert error((0.9, 0.4), (0.0, 0.0)) == pytest.approx(error((0.4, 0.9), (0.0, 0.0)), rel=1e-9)
    assert error((0.9, 0.4), (0.3, 0.0)) == pytest.approx(error((0.4, 0.9), (0.0, 0.3)), rel=1e-9)
    assert error((0.9, 0.4), (2.0, -1.0)) == pytest.approx(error((0.9, 0.4), (0.0, 0.0)), rel=1e-9)
    # between the points that stand for the scene, small apertures see less of what is there
    assert error((0.4, 0.4), (0.5, 0.5)) > 1.2 * error((0.4, 0.4), (0.0, 0.0))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"sensor": {"offset": (0.5, 0.0)}, "model": "none"}, "raise samples_per_pixel"),
        ({"sensor": {"offset": (7.0, 0.0)}}, "quarter of the frame"),
        (
            {"sensor": {"offset": (1.0, 0.0)}, "model": "none", "border": "scene", "margin": 2},
            "beyond the frame",
        ),
        ({"sensor": {"offset": (0.5, 0.0)}, "model": "measured"}, "samples of the irradiance"),
    ],
)
def test_displacements_that_nothing_honours_are_refused(change, says):
    change = dict(change)
    sensor = change.pop("sensor")
    scene = noise(
        (24, 24), **{key: change.pop(key) for key in ("border", "margin") if key in change}
    )
    made = camera(
        sensor=sensor, **{key: value for key, value in change.items() if value != "measured"}
    )
    if "model" in change and change["model"] == "measured":
        pixels = PointSpread(BANDS, np.ones((3, 3, 3)), made.sensor.pixel_pitch, integrated=True)
        made = dataclasses.replace(
            made, optics=dataclasses.replace(made.optics, model="measured", psf=pixels)
        )
    with pytest.raises(OutOfRange, match=says):
        mean(scene, made)


def test_curves_must_cover_the_light():
    """Refused with both ranges; light that is 0 there, or does not reach the sensor, needs no curve."""
    whole = camera(name="mono")

    def sensing(first):
        return dataclasses.replace(
            whole,
            sensor=dataclasses.replace(
                whole.sensor, qe=Spectrum(np.array([first, 700.0]), np.full((1, 2), 0.5))
            ),
        )

    short = sensing(510.0)
    scene = noise((8, 8))
    with pytest.raises(OutOfRange, match=r"510 .. 700 nm.*500 .. 600 nm.*qe_ends"):
        Simulator(short, device="numpy").plan(scene)
    dark = scene.content.values.copy()
    dark[0] = 0
    # between 500 and 550 nm a scene that is 0 at 500 still has light, and at 510 its curve begins
    with pytest.raises(OutOfRange, match=r"500 .. 600 nm"):
        Simulator(short, device="numpy").plan(dataclasses.replace(scene, content=Cube(BANDS, dark)))
    content = Cube(np.array([450.0, 505.0, 550.0, 600.0]), np.concatenate([dark[:1], dark]))
    known = dataclasses.replace(scene, content=content)
    assert Simulator(sensing(505.0), device="numpy").plan(known).weights.sum() > 0
    cut = Spectrum(np.array([500.0, 510.0, 520.0, 600.0]), np.array([0.0, 0.0, 1.0, 1.0]))
    filtered = dataclasses.replace(
        short, optics=dataclasses.replace(short.optics, transmission=cut)
    )
    assert Simulator(filtered, device="numpy").plan(scene).weights.sum() > 0

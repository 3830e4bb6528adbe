"""The outside of `bench/triples.py --kinds`: its sums against closed forms, and its questions."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.special

import gpusim as gs
from gpusim.domain.pupil import Pupil, Wavefront

sys.path.append(str(Path(__file__).parents[2] / "bench"))

import triple_brute as brute
import triple_captures as captures
import triple_geometry as geometry
import triple_judge as judge
import triple_mixed as mixed
import triple_outside as outside
import triple_pupils as pupils

NODES = np.linspace(400.0, 700.0, 4)


def scene(planes, **options):
    """A scene of a cube of these planes in even light."""
    light = gs.Spectrum(NODES[[0, -1]], np.full(2, 1e16))
    return gs.Scene(gs.Cube(NODES, np.asarray(planes, np.float32)), light, **options)


def camera(q=1.5, **optics):
    """A monochrome camera of this q at 550 nm."""
    own = gs.open_camera("mono")
    return replace(
        own,
        optics=gs.Optics(q * own.sensor.pixel_pitch / 550e-9, own.optics.focal_length, **optics),
    )


@pytest.mark.parametrize(
    "pupil, w020", [(Pupil(), 0.7), (Pupil(0, 0.4), 0.7), (Pupil(6, 0.0, 0.3), 0.0)]
)
def test_chords_are_hankels_integral_and_the_polygons_own(pupil, w020):
    """Against the table over radii, which leaves 1e-5 of the local light, and chords whose integrals are known."""
    at, _ = brute.fine_grid(1.0, 12)
    (own,) = pupils.spreads(pupils.chords(pupil, 8), 1.0, [lambda u, v: w020 * (u * u + v * v)], at)
    of = brute.Spread(1.0, w020, hole=pupil.obscuration, blades=pupil.blades, turned=pupil.rotation)
    other = (
        brute.polygon_spread(of, at)
        if pupil.blades
        else brute.round_spread(of, 30)(np.hypot(at[:, None], at))
    )
    assert np.abs(own - other).max() < 5e-5 * other.max()


def test_zernike_polynomials_are_orthonormal():
    """Gauss's rule in r^2 and the even one in the angle are exact for these orders."""
    t, mass = np.polynomial.legendre.leggauss(12)
    r, angle = np.sqrt((t + 1) / 2)[:, None], 2 * np.pi * np.arange(32) / 32
    table = np.stack(
        [pupils.zernike(j, r * np.cos(angle), r * np.sin(angle)) for j in range(1, 22)]
    )
    products = np.einsum("ira,jra,r->ij", table, table, mass / 2) / 32
    np.testing.assert_allclose(products, np.eye(21), atol=1e-12)


def test_between_samples_are_waves():
    """A cosine of 0.31 cycles a sample, mirrored at the edges, at places that are no samples: to the splines' 1e-6."""
    n = 40
    f = 25 / (2 * n)
    plane = np.broadcast_to(np.cos(2 * np.pi * f * (np.arange(n) + 0.5)), (n, n))[None]
    x = np.linspace(-15.3, 14.9, 37)
    found = geometry.band_limited(plane, np.zeros(37), x, "reflect")[0]
    np.testing.assert_allclose(found, np.cos(2 * np.pi * f * (x + n / 2)), atol=3e-6)


@pytest.mark.parametrize(
    "distortion",
    [
        mixed.RadialPolynomial(0.01, -0.03, 30.0),
        mixed.BrownConrady(0.05, 0.0, 0.0, 0.001, -0.002, 60.0),
        mixed.Fisheye(0.01, 0.0, 0.0, 0.0, 60.0),
        gs.Calibration(48, 40, 60.0, 60.0, 28.0, 17.0, (0.03, 0, 0, 0)),
    ],
    ids=lambda one: type(one).__name__,
)
def test_undisplaced_points_are_displaced_back(distortion):
    """The inverse is one; the ideal area over the seen one is that of small triangles, to their size squared."""
    model = (
        distortion.fit_to_frame((40, 48), 1.0)
        if hasattr(distortion, "fit_to_frame")
        else distortion
    )
    x, y = np.random.default_rng(0).uniform(-20, 20, (2, 50))
    u, v, area = geometry.undisplace(model, x, y, 1e-3)
    for got, wanted in zip(geometry.displace(model, u, v), (x, y), strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-8)
    right, down = (
        geometry.undisplace(model, x + a, y + b, 1e-3)[:2] for a, b in ((1e-3, 0), (0, 1e-3))
    )
    triangle = (right[0] - u) * (down[1] - v) - (right[1] - v) * (down[0] - u)
    np.testing.assert_allclose(area, 1e6 * triangle, rtol=1e-4)


def test_a_flat_field_is_the_camera_equation():
    """1e16 photons a second, metre, steradian and nm over 300 nm by a sensor of even response, on the axis."""
    base = camera(object_distance=1.0, transmission=0.5)
    even = gs.Spectrum(np.array([300.0, 800.0]), np.full((1, 2), 0.4))
    seen = replace(
        base,
        sensor=replace(base.sensor, qe=even),
        optics=replace(base.optics, relative_illumination="none"),
    )
    (mean,) = outside.answers(scene(np.ones((4, 20, 24))), seen, 0.01).means
    working = seen.optics.f_number * (
        1 + seen.optics.focal_length / (1.0 - seen.optics.focal_length)
    )
    wanted = 0.01 * 0.4 * 0.5 * 300e16 * np.pi / (1 + 4 * working**2) * seen.sensor.pixel_pitch**2
    np.testing.assert_allclose(mean, wanted, rtol=2e-5)


def test_a_star_off_the_axis_keeps_its_light():
    """Coma of a wave, a star half way to the corner: all its light but 0.2 q / r beyond the frame's edge is there."""
    planes = np.zeros((4, 61, 61))
    planes[:, 42, 45] = 1.0
    lens = Wavefront(seidel=(0.0, 1.0, 0.0, 0.0, 0.0))
    sums = []
    for optics in (camera(wavefront=lens), camera()):
        optics = replace(optics, optics=replace(optics.optics, relative_illumination="none"))
        sums.append(outside.answers(scene(planes, border="zero"), optics, 0.01).means[0].sum())
    assert (
        abs(sums[0] / sums[1] - 1) < 2e-3
    )  # coma moves some of it toward an edge, of 4 % beyond them


def test_measured_spreads_are_their_gaussians():
    """A point's light in a pixel is a product of differences of the error function."""
    pitch = camera().sensor.pixel_pitch
    psf = mixed.Blobs.of(pitch, [((1.0, 0.3 * pitch, 0.0, 0.8 * pitch),)])
    planes = np.zeros((4, 21, 21))
    planes[:, 10, 10] = 1.0
    seen = camera(model="measured", psf=psf, relative_illumination="none")
    (mean,) = outside.answers(scene(planes, border="zero"), seen, 0.01).means
    edge = (np.arange(22) - 10.5) / 0.8 / np.sqrt(2)
    down, across = (
        np.diff(scipy.special.erf(edge - shift / 0.8 / np.sqrt(2))) / 2 for shift in (0.3, 0.0)
    )
    np.testing.assert_allclose(mean / mean.sum(), np.outer(down, across), atol=1e-6)


def test_seeds_are_fixed_and_combine_features():
    assert (mixed.OLD, mixed.MIXED) == (range(33000, 33200), range(34000, 34200))
    first, again = mixed.triple(3), mixed.triple(3)
    assert first.words == again.words and len(first.features) >= 2
    np.testing.assert_array_equal(first.scene.content.planes, again.scene.content.planes)


def test_a_false_met_is_counted():
    """Four rows: true, false, not judged and refused; and what the outside does not say is no part of it."""
    base = {
        "status": "ok",
        "words": "question",
        "planning_s": 1.0,
        "nearest": "2e-3 of 1e-3 rms",
        "over": 2.0,
        "predicted": {"rms": 1e-4},
        "gain": 1.0,
        "why": "spread",
    }
    rows = [
        base | {"state": state, "within": within}
        for state, within in (("met", True), ("met", False), ("met", None), ("not judged", False))
    ]
    text = judge.summary([*rows, {"status": "refused", "words": "other", "text": "BadData: no"}])
    assert (
        "5 asked: 4 answered, 1 refused" in text
        and "met: 3, judged 2: true 1, false 1 (50.0 % true)" in text
    )
    assert (
        "cannot be judged by the planner: 1, judged by the sums 1, beyond 1" in text
        and "refused 1 times" in text
    )


def test_a_question_is_judged():
    """An ideal lens by the command's way; lines of JSON hold what was found."""
    (row,) = judge.asked(34013, kinds="combined", device="numpy", limit=100)
    assert row["status"] == "ok" and row["within"] is not None
    json.dumps(row["features"])


def test_surfaces_in_several_lights_are_products():
    maps, parts, basis, lights = (
        np.random.default_rng(0).random(shape).astype(np.float32)
        for shape in ((2, 3, 5), (3, 3, 5), (3, 4), (2, 4))
    )
    content = gs.Illuminated(NODES, maps, parts, basis, lights)
    wanted = np.einsum("kyx,kl,jyx,jl->lyx", maps, lights, parts, basis)
    np.testing.assert_allclose(
        [outside.spectra(content, band) for band in range(4)], wanted, rtol=1e-6
    )


def test_scenes_are_displaced_as_band_limited_light():
    """A mirrored world repeats itself, so cosines of it stay cosines; even light stays even at an edge that goes on."""
    y, x = np.arange(9), np.arange(14)
    for cycles in (0, 3, 8):

        def wave(at, n, k=cycles):
            return np.cos(np.pi * k * (at + 0.5) / n)

        planes = np.outer(wave(y, 9), wave(x, 14))[None]
        found = captures.shifted(planes, (0.3, -2.7), "reflect")[0]
        assert np.abs(found - np.outer(wave(y + 0.3, 9), wave(x - 2.7, 14))).max() < 1e-12
    # the end of what goes on is smooth over 2000 samples
    assert np.abs(captures.shifted(np.ones((1, 9, 14)), (0.4, 1.3), "edge") - 1).max() < 1e-6


def test_a_bright_edge_that_goes_on_is_seen_from_afar():
    """A corner 1000 times as bright goes on without end; against transforms of 4096 samples, whose seam is 2048 away.

    Light of a quadrant joined to its copies there differs by less than 2e-4 of the light in the dark corner: the
    difference of transforms of 2048 and 4096 samples is 6e-4, and falls with the square of the length.
    """
    n, own = 31, camera(2.8, relative_illumination="none")
    planes = np.ones((4, n, n))
    planes[:, -1, -1] = 1000.0
    seen = scene(planes, border="edge")
    (mean,) = outside.answers(seen, own, 1.0).means
    (shares,) = outside.channel_weights(seen, own)
    long, pitch = 4096, own.sensor.pixel_pitch
    world = np.pad(planes[0], ((2032, 2033), (2032, 2033)), mode="edge")
    f, across = np.fft.fftfreq(long), np.fft.rfftfreq(long)
    transfer = 0.0
    for share, wavelength in zip(shares, NODES, strict=True):
        s = wavelength * 1e-9 * own.optics.working_f_number / pitch * np.hypot(f[:, None], across)
        s = np.minimum(s, 1)
        transfer += share * 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))
    transfer = transfer * np.sinc(f)[:, None] * np.sinc(across)  # pixels without gaps
    wanted = scipy.fft.irfft2(scipy.fft.rfft2(world) * transfer)
    wanted = wanted[2032 : 2032 + n, 2032 : 2032 + n]
    np.testing.assert_allclose(mean, wanted, rtol=4e-4)

"""Lenses in the simulator: blur that varies over the field, measured point spreads, distortion and fall-off."""

import dataclasses

import numpy as np
import pytest
from devices import DEVICES, KINDS

import gpusim as gs
from gpusim.domain.content import Cube
from gpusim.domain.distortion import RadialPolynomial, ideal
from gpusim.domain.errors import BadData, BadFile, OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import Pupil, Wavefront
from gpusim.domain.scene import Scene
from gpusim.domain.sensor import Microlens
from gpusim.domain.spectrum import Spectrum
from gpusim.kernels.optics.pupil import pupil
from gpusim.optics.field import Differences, FieldBlur, _Window, image_error, interpolate
from gpusim.optics.highlights import Highlights
from gpusim.optics.lens import MeasuredLens, PupilLens, Symmetry
from gpusim.optics.lenses import open_lens

MACHINE = gs.open_camera("machine-vision")
PITCH = MACHINE.sensor.pixel_pitch
BANDS = np.linspace(450.0, 650.0, 5)
# the planning of a varying lens takes seconds and is the same for all: the stage itself is tested on every device
SOME = [DEVICES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in DEVICES[1:])]
MILD = Wavefront(seidel=(0.0, 0.7, 0.5, 0.4, 0.0))


def camera(**optics):
    """A camera with a Bayer mosaic, f/5.6, no fall-off, and the optics given."""
    sensor = dataclasses.replace(MACHINE.sensor, exposure_time=0.01)
    return dataclasses.replace(
        MACHINE,
        sensor=sensor,
        optics=dataclasses.replace(
            MACHINE.optics, **{"f_number": 5.6, "relative_illumination": "none"} | optics
        ),
    )


def cube(values):
    """Radiance of all bands alike."""
    values = np.asarray(values, np.float32)
    return Scene(
        Cube(BANDS, np.broadcast_to(values, (len(BANDS), *values.shape)).copy()),
        Spectrum(BANDS[[0, -1]], np.full(2, 1e17)),
    )


def mono(**optics):
    """The same without a mosaic."""
    own = camera(**optics)
    return dataclasses.replace(
        gs.open_camera("mono"),
        optics=own.optics,
        sensor=dataclasses.replace(
            gs.open_camera("mono").sensor, pixel_pitch=PITCH, exposure_time=0.01, fill_factor=1.0
        ),
    )


def few(values):
    """Radiance of two bands alike."""
    own = cube(values)
    return dataclasses.replace(own, content=Cube(BANDS[2:4], own.content.values[2:4]))


def natural(shape, seed=2):
    """Amplitude 1/f, mean 1, contrast 0.3."""
    random = np.random.default_rng(seed)
    f = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1]))
    f[0, 0] = np.inf
    noise = np.fft.ifft2(np.fft.fft2(random.standard_normal(shape)) / f).real
    return np.maximum(1 + 0.3 * noise / noise.std(), 0.02)


@pytest.mark.parametrize(
    "name",
    ["ideal", "field", pytest.param("polygon", marks=pytest.mark.slow), "low-pass"],
)
def test_kernels_of_a_pupil_are_those_of_its_exact_transfer_function(name):
    """The pupil's grid against the tables of `optics.pupil`, made from Hopkins's integral by quadrature.

    A cell of a grid of N takes a ray for the mean of its own: at x pixels from the peak the image loses a share
    (pi x / q N)^2 / 3 of its light. The pupil's edge sends `edge` 2 q / (pi x)^2 dx there, `edge` its length over
    its area, 1 for a circle: within a square of reach R, whose border is 1.12 R away in the mean, `edge` 0.75 R / q N^2
    in all. The sum is made that of all light within, so that this is missing in the middle, or too much.
    N is 6 to a cycle of the pupil's phase at the kernel's end, 3 size / q, and 32 more. Of the exact kernel the light
    beyond its period comes back over it, evenly.
    """
    optics = {
        "ideal": Optics(2.8, 4e-3),
        "field": Optics(2.8, 4e-3, wavefront=MILD),
        "polygon": Optics(2.8, 4e-3, pupil=Pupil(6, 0.2, 0.3), defocus=20e-6),
        "low-pass": Optics(2.8, 4e-3, birefringence=(1e-6, 0.5e-6)),
    }[name]
    place, size, period = (0.5, 0.8), 31, 127
    wavelengths = np.array([450.0, 650.0])
    lens = PupilLens(optics, 1.4e-6, (0.9, 0.9), 100.0)
    waves = optics.waves(wavelengths, np.hypot(*place), np.arctan2(*place))
    tables = pupil(
        optics.pupil,
        waves,
        wavelengths * 1e-9 * 2.8 / 1.4e-6,
        0.9,
        period,
        period,
        device=DEVICES[0],
        spots=tuple(np.array(optics.birefringence) / 1.4e-6),
    ).astype(np.float64)
    if tables.shape[1] == period:
        exact = np.fft.irfft2(np.ascontiguousarray(tables).view(complex), (period, period))
    else:
        fold = np.minimum(np.arange(period), period - np.arange(period))
        exact = np.fft.ifft2(tables[:, fold[:, None], fold]).real
    exact = exact / exact.sum(axis=(1, 2), keepdims=True)  # of gaps between apertures it knows
    exact = np.fft.fftshift(exact, axes=(1, 2))[:, 48:79, 48:79]
    kernels = lens.kernels(wavelengths, place, size)
    edge = {"polygon": 1.47}.get(
        name, 1.0
    )  # (6 + 2 pi 0.2) / (3 sqrt(3) / 2 - pi 0.2^2), half of it
    for q, kernel, wanted in zip(wavelengths * 1e-9 * 2.8 / 1.4e-6, kernels, exact, strict=True):
        lost = edge * 0.75 * (size / 2) / (q * (3 * size / q + 32) ** 2)
        wrapped = edge * 2 * q / (np.pi**2 * 1.12 * period / 2) * (size / period) ** 2
        print(f"{np.abs(kernel - wanted).max() / wanted.max():.2e} of {lost + wrapped:.2e}")
        assert np.abs(kernel - wanted).max() < (lost + wrapped) * wanted.max()


def test_differences_sum_to_zero_and_mirror():
    lens = open_lens(camera(wavefront=MILD).optics, PITCH, 1.0, (64, 96))
    rest = Differences(lens, BANDS, np.ones((1, 5)), (64, 96), 60.0, 1e-3)
    kernels = rest(np.array([[3.0, 10.0], [60.0, 10.0], [3.0, 85.0], [31.5, 47.5]]))
    assert np.abs(kernels.sum(axis=(2, 3))).max() < 1e-12
    assert np.array_equal(kernels[0], kernels[1][:, ::-1]) and np.array_equal(
        kernels[0], kernels[2][:, :, ::-1]
    )
    assert np.abs(kernels[3]).max() < 1e-12  # on the axis there is none


HEIGHTS = Wavefront(((0, 0, 0, 0.1, 0, 0, 0, 0), (0, 0, 0, 0.1, 0.1, 0.1, 0.2, 0.1)), (0.0, 1.0))
COMA = Wavefront(
    (0, 0, 0, 0, 0, 0.1, 0.05, 0.1)
)  # turns with the place: none on the axis is right for all


@pytest.mark.parametrize("pupil", [Pupil(), Pupil(6, 0.2, 0.3), Pupil(5)])
@pytest.mark.parametrize("wavefront", [MILD, HEIGHTS, COMA])
def test_symmetries_of_the_field_save_kernels_only_where_they_hold(wavefront, pupil):
    """Kernels on the other side of the axis are as computed there: sums of float32 differ by 1e-6 of the peak."""
    optics = camera(wavefront=wavefront, pupil=pupil, lateral_color=1e-3).optics
    places = np.array(
        [[3.0, 10.0], [60.0, 10.0], [3.0, 85.0], [31.5, 10.0], [31.5, 85.0], [60, 85]]
    )
    found, wanted = (
        Differences(lens, BANDS, np.ones((1, 5)), (64, 96), 60.0, 1e-3)
        for lens in (open_lens(optics, PITCH, 1.0, (64, 96)) for _ in range(2))
    )
    wanted._symmetry = Symmetry(False, False)
    peak = np.abs(wanted.lens.kernels(BANDS, (0.0, 0.0), 15)).max()
    assert np.abs(found(places) - wanted(places)).max() < 5 * 2e-6 * peak
    assert len(found._known) <= len(wanted._known)


@pytest.mark.parametrize("device", SOME)
def test_a_flat_field_is_the_sum_of_its_points(device):
    """Coma and lateral colour in the middle of the frame, where the light that points send through each part of the
    pupil is moved by a linear map A of the place: the flat field is the mean of 1 / det (1 + A).

    W = w r^2 (p s) / R moves light by -2 q w / R (r^2 s + 2 p (p s)), p in the pupil and s in the field (Welford,
    chapter 7): det (1 + A) = (1 + c + a r^2) (1 + c + 3 a r^2), a = -2 q w / R. What flat fields may err by is half of
    5e-4 where there is no tolerance.
    """
    waves, excess, shape = 0.7, 0.004, (96, 128)
    lens = {"wavefront": Wavefront(seidel=(0.0, waves, 0.0, 0.0, 0.0)), "lateral_color": excess}
    mean, plain = (
        np.array(one.device.numpy(one.expose(few(np.ones(shape))).mean), np.float64)
        for one in (gs.Simulator(mono(**optics), device=device) for optics in (lens, {}))
    )
    a = -2 * 550e-9 * 5.6 / PITCH * waves / (np.hypot(*shape) / 2)
    squares = (np.arange(1000) + 0.5) / 1000  # of the radius, even over the pupil
    wanted = np.mean(1 / ((1 + excess + a * squares) * (1 + excess + 3 * a * squares)))
    assert abs(wanted - 1) > 4e-3
    middle = np.s_[47:49, 63:65]
    np.testing.assert_allclose(mean[middle] / plain[middle], wanted, atol=5e-4)


def test_a_star_keeps_its_energy_through_measured_spreads():
    """That widen and move toward the corner, which loses 3 % on the axis if flat fields are made flat.

    The spreads end within the frame: all the light of a star arrives, to float32 transforms (2.5e-7 of the root mean
    square, five of them, over 65 x 65 pixels).
    """
    size, heights = 41, np.array([0.0, 0.5, 1.0])
    y, x = np.mgrid[:size, :size] - size // 2
    spreads = [np.exp(-(y**2 + (x - 4 * h) ** 2) / (2 * (2.4 + 2.4 * h) ** 2)) for h in heights]
    psf = PointSpread(
        BANDS[[0, -1]],
        np.stack([[one / one.sum()] * 2 for one in spreads]),
        PITCH / 6,
        heights=heights,
    )
    simulator, sums = gs.Simulator(mono(model="measured", psf=psf), device=DEVICES[0]), []
    for place in ((32, 32), (54, 54)):
        values = np.zeros((65, 65), np.float32)
        values[place] = 1e4
        exposure = simulator.expose(dataclasses.replace(few(values), border="zero"))
        sums.append(
            np.array(simulator.device.numpy(exposure.mean), np.float64).sum()
            / (exposure.plan.weights.sum() * 1e4 * exposure.exposure_time)
        )
    assert np.abs(np.array(sums) - 1).max() < 1e-4


@pytest.mark.slow  # case 13 below goes the same way with lateral colour
@pytest.mark.parametrize("device", DEVICES)
def test_a_varying_lens_keeps_its_tolerance(device):
    """Coma, astigmatism and curvature against the truth of all pixels; asked for 2e-3."""
    report = gs.Simulator(camera(wavefront=MILD), device=device, tolerance="2e-3")(
        cube(natural((120, 160))), verify=True
    ).report
    assert report.error.rms < 2e-3, str(report)
    assert "optics.field" in report.table()


@pytest.mark.slow
def test_diffusers_spread_the_field_as_well():
    """A point far off the axis, behind a diffuser: less than half the peak, and no dark ring around it.

    The kernel of the pupil's grid is right to 1e-3 of its peak (above): nothing is negative beyond that. Differences
    of kernels without the diffuser on a base with it would make a ring of -0.7 of the peak, as tried here.
    """
    diffused = camera(wavefront=MILD, diffuser=4e-6)
    plane = np.full((64, 96), 1e-6)
    plane[10, 14] = 1.0
    simulator = gs.Simulator(diffused, device=DEVICES[0])
    mean = simulator.device.numpy(simulator.expose(cube(plane)).mean).astype(float)
    plain = gs.Simulator(camera(wavefront=MILD), device=DEVICES[0])
    sharp = plain.device.numpy(plain.expose(cube(plane)).mean).astype(float)
    assert mean.min() > -1e-3 * mean.max() and mean.max() < 0.5 * sharp.max()


def test_an_area_on_black_is_no_highlight():
    """Left black, right white: the corner of the white goes on outside; as bright as with the dark at 1e-2."""
    means = []
    for dark in (0.0, 1e-2):
        plane = np.full((48, 64), dark)
        plane[:, 40:] = 1.0
        simulator = gs.Simulator(camera(), device=DEVICES[0])
        exposure = simulator.expose(cube(plane))
        assert exposure.plan.find(Highlights) is None
        means.append(simulator.device.numpy(exposure.mean).astype(float))
    # the dark part, 24 pixels away, gives the corner less than 1e-2 of 1e-2
    np.testing.assert_allclose(means[0][-1, -1], means[1][-1, -1], rtol=1e-3)


@pytest.mark.parametrize("fill", [0.5, 1.0])
def test_highlights_join_at_the_threshold(fill):
    """A pixel just below the threshold and just above it: the same image, 1 % brighter, at any fill factor."""
    pixel = camera()
    pixel = dataclasses.replace(pixel, sensor=dataclasses.replace(pixel.sensor, fill_factor=fill))
    peaks = []
    for level in (0.995, 1.005):
        plane = np.full((48, 64), 0.01)
        plane[20, 31] = level
        simulator = gs.Simulator(pixel, device=DEVICES[0])
        exposure = simulator.expose(cube(plane))
        assert (exposure.plan.find(Highlights) is not None) == (level > 1)
        peaks.append(float(simulator.device.numpy(exposure.mean)[20, 31]) / level)
    assert peaks[1] == pytest.approx(peaks[0], rel=1e-3)  # the point kernels' own bound


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"reach": 0}, "reach = 0"),
        ({"reach": -5}, "reach = -5"),
        ({"reach": 10**6}, "whole number of pixels"),
    ],
)
def test_reaches_that_cannot_be_are_refused(more, says):
    with pytest.raises(OutOfRange, match=says):
        gs.Simulator(camera(), device=DEVICES[0], **more)


@pytest.mark.slow
def test_a_varying_lens_for_every_spectrum():
    """The guaranteed mode in the field: a monochromatic scene; asked for 5e-3."""
    values = np.zeros((5, 120, 160), np.float32)
    values[3] = natural((120, 160))
    scene = Scene(Cube(BANDS, values), Spectrum(BANDS[[0, -1]], np.full(2, 1e17)))
    report = gs.Simulator(
        camera(wavefront=MILD), device=DEVICES[0], tolerance="5e-3", guaranteed=True
    )(scene, verify=True).report
    assert report.error.rms < 5e-3, str(report)


@pytest.mark.slow
def test_case_13_lateral_colour():
    """3 pixels of lateral colour at the corner, and axial colour: the planes are raised, or it is refused.

    The bound is the hard case's 1e-3; without the field the error is a hundred times that.
    """
    shape = (180, 240)
    corner = np.hypot(*shape) / 2
    lateral = Spectrum(np.array([450.0, 650.0]), np.array([-3.0, 3.0]) / corner)
    axial = Spectrum(np.array([450.0, 650.0]), np.array([-30e-6, 30e-6]))
    coloured = camera(lateral_color=lateral, defocus=axial)
    scene = cube(natural(shape))
    frame = gs.Simulator(coloured, device=DEVICES[0], tolerance="1e-3")(scene, verify=True)
    assert frame.report.error.rms < 1e-3, str(frame.report)
    without = gs.Simulator(camera(defocus=axial), device=DEVICES[0])(scene).mean
    assert np.sqrt(np.mean((without / frame.mean - 1) ** 2)) > 1e-2
    with pytest.raises(OutOfRange, match="pixels at the frame's corner"):
        gs.Simulator(camera(lateral_color=0.4), device=DEVICES[0]).plan(cube(natural((300, 400))))


def gaussian(sigma, size=41, shift=0.0):
    y, x = np.mgrid[:size, :size] - size // 2
    return np.exp(-((x - shift) ** 2 + y**2) / (2 * sigma**2))


@pytest.mark.parametrize("device", KINDS)
def test_measured_point_spreads_over_the_field(device):
    """Gaussians that widen toward the corner: a point's image has the variance of its place, plus the pixel's 1/12.

    Between the heights the spread is linear, so that the variance is too.
    The variances are those of the samples themselves.
    """
    spacing, ratio = gs.open_camera("mono").sensor.pixel_pitch / 8, 8
    sigma = np.array([1.0, 1.5]) * ratio
    values = np.stack([np.stack([gaussian(s, 81)] * 5) for s in sigma])
    spread = PointSpread(BANDS, values, spacing, heights=np.array([0.0, 1.0]))
    mono = gs.open_camera("mono")
    optics = dataclasses.replace(
        mono.optics, model="measured", psf=spread, relative_illumination="none"
    )
    simulator = gs.Simulator(dataclasses.replace(mono, optics=optics), device=device)
    plane = np.full((64, 96), 1e-9)
    places = [(50, 80), (12, 20)]
    for y, x in places:
        plane[y, x] = 1.0
    exposure = simulator.expose(cube(plane))
    mean = simulator.device.numpy(exposure.mean).astype(float)
    assert exposure.plan.find(FieldBlur) is not None
    for y, x in places:
        height = np.hypot(y - 31.5, x - 47.5) / (np.hypot(64, 96) / 2)
        around, offsets = mean[y - 11 : y + 12, x - 11 : x + 12], np.arange(-11, 12)
        variance = (around.sum(axis=0) * offsets**2).sum() / around.sum()
        own = [
            (gaussian(s, 81).sum(axis=0) * np.arange(-40, 41) ** 2).sum()
            / gaussian(s, 81).sum()
            / ratio**2
            for s in sigma
        ]
        wanted = own[0] * (1 - height) + own[1] * height + mono.sensor.fill_factor / 12
        assert variance == pytest.approx(wanted, rel=1e-2)  # the field is interpolated


def test_measured_grids_take_the_place():
    """Spreads shifted by their column: halfway between two the mean of both, and the kernel's centroid there."""
    values = np.stack([[np.stack([gaussian(1.5, shift=s)] * 5) for s in (-2.0, 0.0, 2.0)]] * 2)
    spread = PointSpread(
        BANDS, values, 1e-6, grid=(np.array([-1.0, 1.0]), np.array([-1.0, 0.0, 1.0]))
    )
    lens = MeasuredLens(camera().optics, spread, 1e-6, (1.0, 1.0), (1.0, 1.5))
    for x in (-1.0, -0.5, 0.3):
        kernel = lens.kernels(BANDS, (0.2, x), lens.least_size)[0]
        offsets = np.arange(len(kernel)) - len(kernel) // 2
        # the 41 samples cut a Gaussian at 12 sigma: its centroid is exact
        assert (kernel.sum(axis=0) * offsets).sum() == pytest.approx(2 * x, abs=1e-6)
    with pytest.raises(OutOfRange, match="1 is the frame's corner"):
        lens.kernels(BANDS, (0.0, 1.5), 51)


@pytest.mark.parametrize("device", KINDS)
@pytest.mark.parametrize("model", ["diffraction", "none"])
def test_distortion_moves_points_and_keeps_flux(device, model):
    """A smooth blob off the axis arrives where the polynomial says, with its energy times the local area.

    Its centre of gravity: 4 pixels wide, where the mapping is curved by k / R = 1e-3, 3 / 2 x 16 x 1e-3 = 0.02 pixel.
    Diffraction spreads 1 % beyond 20 pixels, half of it out of the frame on the side that is 25 pixels away: 0.1.
    """
    shape, pitch = (96, 128), PITCH
    lens = RadialPolynomial(-0.08, 0.0, pitch * 80)
    y, x = np.mgrid[: shape[0], : shape[1]]
    at = 70.0, 100.0
    plane = np.exp(-((y - at[0]) ** 2 + (x - at[1]) ** 2) / (2 * 4.0**2)) + 1e-9
    mono = camera(model=model, distortion=lens)
    simulator = gs.Simulator(mono, device=device)
    exposure = simulator.expose(cube(plane))
    mean = simulator.device.numpy(exposure.mean).astype(float)
    straight = simulator.device.numpy(
        gs.Simulator(camera(model=model), device=device).expose(cube(plane)).mean
    )
    green = mean[0::2, 1::2]
    rows, cols = np.mgrid[0 : shape[0] : 2, 1 : shape[1] : 2]
    middle = np.array([47.5, 63.5])
    wanted = (
        middle
        + 80 * np.array(lens.distort((at[1] - middle[1]) / 80, (at[0] - middle[0]) / 80))[::-1]
    )
    bound = 0.03 if model == "none" else 0.1
    assert (green * rows).sum() / green.sum() == pytest.approx(wanted[0], abs=bound)
    assert (green * cols).sum() / green.sum() == pytest.approx(wanted[1], abs=bound)
    assert green.sum() == pytest.approx(
        straight[0::2, 1::2].sum(), rel=5e-3
    )  # every ray arrives once
    assert "optics.distort" in exposure.plan.models


def test_distortion_inverts():
    """The scene point seen by a pixel is imaged onto it: Newton's method ends at 1e-13."""
    lens = RadialPolynomial(-0.1, 0.02, 1.0)
    random = np.random.default_rng(0)
    x, y = random.uniform(-0.7, 0.7, (2, 50))
    np.testing.assert_allclose(lens.distort(*ideal(lens, x, y)), (x, y), atol=1e-12)


@pytest.mark.parametrize("device", KINDS)
def test_relative_illumination_and_microlenses(device):
    """A polynomial of the field height and a linear microlens response multiply; float32 rounds by 2e-7 a factor."""
    shape, pitch = (48, 64), PITCH
    angles, response = np.array([0.0, 0.5]), np.array([1.0, 0.5])
    flat = camera(model="none")
    lossy = dataclasses.replace(
        camera(model="none", relative_illumination=(0.0, -0.3)),
        sensor=dataclasses.replace(flat.sensor, microlens=Microlens(angles, response)),
    )
    first, second = (gs.Simulator(one, device=device) for one in (flat, lossy))
    scene = cube(np.ones(shape))
    ratio = second.device.numpy(second.expose(scene).mean) / first.device.numpy(
        first.expose(scene).mean
    )
    y, x = np.mgrid[:48, :64] - np.array([23.5, 31.5])[:, None, None]
    r = np.hypot(y, x)
    wanted = (1 - 0.3 * (r / (np.hypot(*shape) / 2)) ** 2) * (
        1 - np.arctan(r * pitch / lossy.optics.image_distance)
    )
    np.testing.assert_allclose(ratio, wanted, rtol=1e-6)


def test_camera_files_have_all_of_it(tmp_path):
    bands = np.linspace(380.0, 780.0, 5)
    np.savez(
        tmp_path / "psf.npz",
        wavelengths_nm=bands,
        heights=[0.0, 1.0],
        spacing_um=0.7,
        psf=np.stack([np.stack([gaussian(s, 15)] * 5) for s in (1.5, 2.0)]),
    )
    text = """
[optics]
f_number = 4
focal_length_mm = 8
psf = "psf.npz"
distortion = {k1 = -0.1, k2 = 0.02, radius_mm = 2.0}
relative_illumination = {heights = [0, 0.5, 1], values = [1, 0.9, 0.7]}

[sensor]
pixel_pitch_um = 3.45
qe = "mt9v024"
full_well_e = 10000
bits = 12
microlens = {angles_deg = [0, 30], response = [1, 0.8], shift = 0.5}
"""
    path = tmp_path / "camera.toml"
    path.write_text(text)
    read = gs.open_camera(path)
    assert read.optics.varies and read.optics.psf.heights.tolist() == [0, 1]
    assert read.optics.distortion == RadialPolynomial(-0.1, 0.02, 2e-3)
    assert read.sensor.microlens.angles[1] == pytest.approx(np.radians(30))
    frame = gs.Simulator(read, device=DEVICES[0])(gs.open_scene("deadleaves", size=(96, 64)))
    stages = [stage.stage for stage in frame.report.stages]
    assert {"optics.distort", "optics.field", "optics.falloff"} <= set(stages)
    for wrong, says in (
        ("k2 = 0.02", "k1, k2, radius_mm"),
        ('"psf.npz"', "psf2.npz"),
        ("[0, 30]", "angles"),
    ):
        bad = {"k2 = 0.02": "k3 = 0.02", '"psf.npz"': '"psf2.npz"', "[0, 30]": "[0, -30]"}[wrong]
        path.write_text(text.replace(wrong, bad))
        with pytest.raises(BadFile, match=says):
            gs.open_camera(path)


@pytest.mark.parametrize(
    ("optics", "error", "says"),
    [
        ({"model": "measured"}, BadData, "wants point spreads"),
        ({"psf": PointSpread(BANDS, np.ones((5, 3, 3)), 1e-6)}, BadData, 'set model = "measured"'),
        ({"lateral_color": np.nan}, OutOfRange, "lateral_color"),
        ({"birefringence": 1e-6}, OutOfRange, "birefringence"),
        (
            {
                "model": "measured",
                "psf": PointSpread(BANDS, np.ones((5, 3, 3)), 1e-7),
                "lateral_color": 0.01,
            },
            BadData,
            "hold it",
        ),
        (
            {"model": "measured", "psf": PointSpread(BANDS, np.ones((5, 9, 9)), 2e-6)},
            OutOfRange,
            "half of lambda N",
        ),
        ({"relative_illumination": (0.0, -3.0)}, OutOfRange, "relative illumination"),
        (
            {
                "model": "measured",
                "psf": PointSpread(BANDS[1:], np.ones((4, 3, 3)), PITCH, integrated=True),
            },
            OutOfRange,
            "wavelengths",
        ),
        (
            {
                "model": "measured",
                "psf": PointSpread(BANDS, np.ones((5, 3, 3)), 1e-6, integrated=True),
            },
            OutOfRange,
            "pixel pitch",
        ),
        (
            {
                "model": "measured",
                "psf": PointSpread(BANDS, np.ones((5, 999, 3)), PITCH, integrated=True),
            },
            OutOfRange,
            "999 samples",
        ),
        ({"distortion": RadialPolynomial(-0.9, 0.0, 1e-4)}, OutOfRange, "turns back"),
    ],
)
def test_lenses_that_cannot_be_are_refused(optics, error, says):
    with pytest.raises(error, match=says):
        gs.Simulator(camera(**optics), device=DEVICES[0]).expose(cube(np.ones((48, 64))))


@pytest.mark.parametrize(
    "fields",
    [
        {"defocus": 1e-5},
        pytest.param(
            {"wavefront": Wavefront(zernike=(0, 0, 0, 0, 0, 0, 0, 0.1))}, marks=pytest.mark.slow
        ),
        {"birefringence": (1.4e-6, 1.4e-6)},
    ],
)
@pytest.mark.parametrize("tolerance", [None, 1e-3])
def test_a_camera_with_that_lens(fields, tolerance):
    """End to end against float64: exact, 1e-5 and 2.5 times the predicted border; fused, the tolerance."""
    made = gs.open_camera("figure8")
    made = dataclasses.replace(made, optics=dataclasses.replace(made.optics, **fields))
    frame = gs.Simulator(made, device="auto", tolerance=tolerance)(
        gs.chart("colorchecker", size=(48, 32)), verify=True
    )
    assert frame.report.error.rms < (
        tolerance or 1e-5 + 2.5 * frame.report.account.bounds["border"].rms
    )


@pytest.mark.parametrize("error", [5e-5, 1e-4, 5e-4])
def test_kernels_of_few_wavelengths_err_as_little_as_they_say(error):
    """Against kernels of all 31 wavelengths, as seen by a photograph through a channel as wide as a filter's.

    Their part that both leave to the axis is the same; twice the bound, for places where nothing was measured.
    """
    nm = np.linspace(400.0, 700.0, 31)
    lens = open_lens(camera(wavefront=MILD).optics, PITCH, 1.0, (64, 96))
    mix = np.exp(-(((nm - np.array([[450.0], [600.0]])) / 40) ** 2))
    mix /= mix.sum(axis=1, keepdims=True)
    rest = Differences(lens, nm, mix, (64, 96), 57.7, error)
    places = np.array([[0.0, 0.0], [63.0, 20.0], [20.0, 70.0]])
    fields = (places - [31.5, 47.5]) / 57.7
    axis = lens.kernels(nm, (0.0, 0.0), rest.size)
    wanted = np.stack(
        [np.tensordot(mix, lens.kernels(nm, tuple(one), rest.size) - axis, 1) for one in fields]
    )
    wanted -= wanted.mean(axis=(2, 3), keepdims=True)
    assert len(rest.nodes) < 9
    assert image_error(rest(places), wanted)[1] < 2 * max(rest.end_error(), 1e-6)


def test_splines_of_the_field_are_scipys():
    """Bicubic splines without knots at the second nodes, and B-splines of the windows: as the library has them."""
    from scipy.interpolate import BSpline, RectBivariateSpline

    random = np.random.default_rng(1)
    for rows, cols in ((5, 5), (3, 4), (2, 7), (15, 25)):
        nodes = np.linspace(0, 40, rows), np.linspace(0, 60, cols)
        values = random.normal(size=(rows * cols, 3))
        own = interpolate(nodes, values, np.arange(41), np.arange(61))
        for found, one in zip(own, values.T, strict=True):
            degrees = {"kx": min(3, rows - 1), "ky": min(3, cols - 1)}
            spline = RectBivariateSpline(*nodes, one.reshape(rows, cols), **degrees)
            np.testing.assert_allclose(found, spline(np.arange(41), np.arange(61)), atol=1e-13)
    for size, count, window in ((48, 3, "quadratic"), (97, 8, "cubic"), (33, 2, "bilinear")):
        one = _Window(size, count, window)
        knots, at = np.pad(one.knots, one.degree, mode="edge"), np.arange(float(size))
        wanted = BSpline.design_matrix(at, knots, one.degree).toarray()
        np.testing.assert_allclose(one.dense(at), wanted, atol=1e-15)

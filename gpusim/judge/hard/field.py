"""Blur that varies over the field or with distance, and wide angles: cases 13 to 16 and 30."""

from dataclasses import replace
from functools import cache

import numpy as np

from gpusim.domain.content import Cube
from gpusim.domain.distortion import RadialPolynomial, RadialTable
from gpusim.domain.errors import OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.psf import PointSpread
from gpusim.domain.scene import Layer, Scene, unit_light
from gpusim.domain.spectrum import Spectrum
from gpusim.io.camera.cameras import open_camera
from gpusim.judge.hard import truth
from gpusim.judge.hard.case import Found, case
from gpusim.judge.hard.lenses import MILD, Q, make_texture, seidel_lens, spread
from gpusim.judge.hard.scenes import mean_of
from gpusim.kernels.optics.field import field
from gpusim.optics.field import eigen_kernels, overlap_add
from gpusim.optics.geometry import distortion_grid
from gpusim.optics.lenses import open_lens
from gpusim.pipeline.simulator import Simulator

SIZE = 33
ONE = np.ones((1, 1), np.float32)
BANDS = np.array([450.0, 550.0, 650.0])
# of the pixels that case 13 looks at, relative to rows and columns of the frame
COLOUR_PLACES = np.array(
    [[0.29, 0.25], [0.33, 0.753], [0.504, 0.52], [0.7, 0.206], [0.733, 0.775], [0.458, 0.406]]
)


def blur_plane(plane, blur, device, border="reflect", **more):
    """Return one plane after the stage `optics.field`."""
    inputs = {
        "planes": plane[None].astype(np.float32),
        "mix": ONE,
        "border": border,
        **blur.stage_inputs,
        **more,
    }
    return field(**inputs, device=device)[0]


@case(
    13,
    "lateral and axial colour",
    "3 pixels at the corner, and axial: <= 1e-3, or refused, or the report says NOT "
    "met; never silent",
)
def colour(device):
    """Frames of 320 x 240 and of half that size, for which a kernel shears twice as fast."""
    yield _colour_of((240, 320), 8.0, device)
    yield _colour_of((120, 160), 8.0, device)
    yield _colour_of((120, 160), 4.0, device)


def _colour_of(shape, f_number, device):
    """Compare some pixels with the truth.

    Light from s falls on s (1 + e), spread by the defocused pattern of its wavelength.
    """
    camera = open_camera("mono")
    lateral = Spectrum(np.array([450.0, 650.0]), np.array([-3.0, 3.0]) / (np.hypot(*shape) / 2))
    shift = 80e-6 if f_number > 5 else 30e-6
    axial = Spectrum(np.array([450.0, 650.0]), np.array([-shift, shift]))
    sensor = replace(camera.sensor, fill_factor=1.0)
    optics = replace(
        camera.optics,
        f_number=f_number,
        lateral_color=lateral,
        defocus=axial,
        relative_illumination="none",
    )
    camera = replace(camera, sensor=sensor, optics=optics)
    values = np.stack([make_texture(shape, seed) for seed in range(len(BANDS))]).astype(np.float32)
    scene = Scene(Cube(BANDS, values), unit_light(BANDS))
    simulator = Simulator(camera, device=device, tolerance="1e-3")
    words = f"{shape[1]} x {shape[0]}, f/{f_number:g}"
    try:
        loop = simulator.loop(scene, 1.0)
        frame = loop.frame()
    except OutOfRange as refusal:
        return Found(0.0, 1e-3, f"{words} refused: {refusal}")
    places = [(int(shape[0] * v), int(shape[1] * u)) for v, u in COLOUR_PLACES]
    weights = loop.plan.weights[0]
    report = frame.report
    exact = np.array([_pixel_electrons(values, camera, weights, place) for place in places])
    error = truth.relative(np.array([frame.mean[place] for place in places], float), exact)
    if not report.verdict.is_met:
        return Found(0.0, 1e-3, f"{words}: the report says {report.verdict}; error {error:.1e}")
    predicted = f"predicted {report.account.total.rms:.1e}"
    return Found(error, 1e-3, f"relative rms of six pixels, {words}; {predicted}")


def _pixel_electrons(values, camera, weights, place, reach=60):
    """Return the electrons of one pixel; beyond `reach` the light is assumed to be uniform."""
    optics, total = camera.optics, 0.0
    rows, cols = values.shape[1:]
    y, x = (np.arange(at - reach, at + reach + 1) for at in place)
    for plane, line, weight in zip(values.astype(float), BANDS, weights, strict=True):
        q = line * 1e-9 * optics.f_number / camera.sensor.pixel_pitch
        excess = optics.lateral_color.at(np.array([line]))[0]
        shift = optics.defocus.at(np.array([line]))[0]
        waves = shift / (8 * optics.f_number**2) / (line * 1e-9)
        # from the image of the light at each place to the pixel: the middle of the frame is the axis
        dy, dx = (
            at - middle - (away - middle) * (1 + excess)
            for at, away, middle in ((place[0], y, (rows - 1) / 2), (place[1], x, (cols - 1) / 2))
        )
        pattern = truth.in_pixels(
            _defocused(q, round(waves, 9), 1.5 * reach + 4), dy, dx, int(np.ceil(6 + 3 / q))
        )
        patch = plane[np.clip(y, 0, rows - 1)[:, None], np.clip(x, 0, cols - 1)]
        # a point keeps its light, and the light of a flat field lies on (1 + excess)^2 of the area
        total += weight * (pattern * patch).sum() / (pattern.sum() * (1 + excess) ** 2)
    return total


_defocused = cache(truth.defocused_airy)


@cache
def measured_lens(shape, waves, count, size):
    """Return `seidel_lens` as point spreads at `count` field heights.

    They have four samples per pixel and 199 along a side.
    """
    heights, pitch = np.linspace(0, 1, count), 550e-9 * 2.8 / Q
    values = np.stack([spread(h, 0.0, waves, 199) for h in heights])[:, None]
    # rounding leaves some at -1e-20
    psf = PointSpread([550.0], np.maximum(values, 0), pitch / 4, heights=heights)
    lens = open_lens(Optics(2.8, 4e-3, model="measured", psf=psf), pitch, 1.0, shape)
    middle = (np.array(shape) - 1) / 2
    corner = np.hypot(*shape) / 2
    cut = (lens.least_size - size + 1) // 2

    def kernels(places):
        made = np.stack(
            [lens.kernels([550.0], place, size + 2 * cut) for place in (places - middle) / corner]
        )
        made = made[..., cut:-cut, cut:-cut]
        return made / made.sum(axis=(2, 3), keepdims=True)

    return kernels


@cache
def coma_by_field_height(shape, size):
    """Return its overlap-add blur, with nodes 20 pixels apart."""
    return overlap_add(measured_lens(shape, MILD, 17, size), shape, (7, 9))


@case(
    14,
    "coma in four quadrants",
    "corner points: centroids within 0.02 pixel, mirror images to 1e-5 (float32)",
)
def quadrants(device):
    """Point spreads by field height are turned; errors are relative to the peak of the image."""
    shape, size = (121, 161), 25
    blur, exact = coma_by_field_height(shape, size), seidel_lens(shape, MILD, size)
    images, off, offsets = [], 0.0, np.arange(-12, 13)
    for y, x in ((20, 20), (20, 140), (100, 20), (100, 140)):
        plane = np.zeros(shape, np.float32)
        plane[y, x] = 1
        image = blur_plane(plane, blur, device)[y - 12 : y + 13, x - 12 : x + 13].astype(np.float64)
        wanted = exact(np.array([[y, x]]))[0, 0]
        for axis in (0, 1):
            centroid, true = (
                (one.sum(axis=1 - axis) * offsets).sum() / one.sum() for one in (image, wanted)
            )
            off = max(off, abs(centroid - true))
        images.append(image[:: -1 if y > 60 else 1, :: -1 if x > 80 else 1])
    mirror = max(np.abs(image - images[0]).max() for image in images[1:]) / images[0].max()
    yield Found(off, 0.02, "centroid [pixel]")
    yield Found(mirror, 1e-5, "mirror images")


def seam(shape, blur, device) -> float:
    """Return the largest second difference relative to the local value.

    The scenes are a flat field and a ramp of 1 % per pixel.
    """
    largest = 0.0
    for plane in (np.ones(shape), 1 + 0.01 * np.arange(shape[1]) * np.ones(shape)):
        # the mirrored ramp has a kink at the border
        image = blur_plane(plane, blur, device).astype(np.float64)[SIZE:-SIZE, SIZE:-SIZE]
        for axis in (0, 1):
            middle = image.take(range(1, image.shape[axis] - 1), axis=axis)
            largest = max(largest, np.abs(np.diff(image, 2, axis=axis) / middle).max())
    return largest


@cache
def of_mild_lens(method, shape=(180, 320)):
    """Return the blur of the mild lens by eigen-kernels or by overlap-add.

    method: "eigen", or the name of a window for overlap-add. Over such a small frame the lens
    varies fast.
    """
    lens = seidel_lens(shape, MILD, SIZE)
    if method == "eigen":
        return eigen_kernels(lens, shape, terms=12)
    return overlap_add(lens, shape, (9, 13), window=method)


@case(
    15,
    "patch seams",
    "flat field and 1 % ramp: second differences <= 1e-4, for every way that the planner takes",
)
def seams(device):
    for method in ("quadratic", "eigen"):
        yield Found(seam((180, 320), of_mild_lens(method), device), 1e-4, method)


DEPTH_PITCH = 2e-6
DEPTH_LENS = Optics(
    f_number=2.0, focal_length=5e-3, object_distance=0.4, relative_illumination="none"
)
DEPTH_LINES = np.array([540.0, 550.0, 560.0])


def _distance(confusion):
    """Return the distance [m] for a signed circle of confusion [pixel], by the thin-lens equation.

    The circle is positive beyond the plane in focus.
    """
    f, d0 = DEPTH_LENS.focal_length, DEPTH_LENS.object_distance
    sensor = 1 / (1 / f - 1 / d0)
    # c = (f / N) (sensor - image) / image, image = 1 / (1 / f - 1 / d)
    image = sensor / (1 + confusion * DEPTH_PITCH * DEPTH_LENS.f_number / f)
    return 1 / (1 / f - 1 / image)


@case(
    16,
    "depth edge",
    "circle of confusion 8 pixels, both orders: with layers <= 1e-3, without them reported as >= "
    "1e-2",
)
def depth_edge(device):
    """A scene with one spectral line. One side is in focus, so no sum over the pupil is needed.

    Exact is the sum of blurred layers, but that diffraction blurs the light that has passed the
    near side, not light and coverage each. The patterns are computed in space for a defocused
    pupil. Of a circle of 8 pixels, 1e-4 of the light falls beyond 60 pixels; it is assumed to be
    uniform.
    """
    camera = open_camera("mono")
    sensor = replace(camera.sensor, pixel_pitch=DEPTH_PITCH)
    camera = replace(camera, optics=DEPTH_LENS, sensor=sensor)
    size = 96
    y, x = np.indices((size, size))
    disc = (np.hypot(y - size / 2 + 0.3, x - size / 2) < 26).astype(float)
    front, back = 0.5 * make_texture((size, size), 1), make_texture((size, size), 2)
    for order, (near, far) in {"near sharp": (0.0, 8.0), "far sharp": (-8.0, 0.0)}.items():
        distances = _distance(near), _distance(far)
        behind = Scene(
            _one_line(back),
            unit_light(DEPTH_LINES),
            depth=np.full(back.shape, distances[1]),
            layers=(Layer(_one_line(front), disc.astype(np.float32), distances[0]),),
        )
        simulator = Simulator(camera, device=device)
        exposure = simulator.expose(behind, 1.0)
        mean = simulator.device.numpy(exposure.mean).astype(float) / exposure.plan.weights[0, 1]
        share = _out_of_focus(disc, near)
        hidden = (1 - share) * _out_of_focus(back.astype(np.float32), far)
        hidden -= _covariance(back.astype(np.float32), far, disc, near)
        exact = _out_of_focus(disc * front.astype(np.float32), near) + hidden
        yield Found(truth.relative(mean, exact), 1e-3, f"with layers, {order}")
        content = _one_line(np.where(disc > 0, front, back))
        depth = np.where(disc > 0, *distances)
        report = simulator(Scene(content, unit_light(DEPTH_LINES), depth=depth)).report
        figures = report.beside | {name: bound.rms for name, bound in report.account.bounds.items()}
        names = ("depth, if without layers", "depth, occlusion left out")
        reported = max(figures.get(name, 0.0) for name in names)
        words = f"1e-2 over {reported:.2g}, reported without layers, {order}"
        yield Found(1e-2 / max(reported, 1e-300), 1.0, words)


def _one_line(plane):
    values = np.zeros((3, *plane.shape), np.float32)
    values[1] = plane
    return Cube(DEPTH_LINES, values)


def _covariance(back, far, front, near, fine=5, reach=60):
    """Return by how much diffraction in focus of a product exceeds the product of what it blurs alone.

    The product is of light and the coverage that it meets. One of the two is in focus. Rays put
    the other there, on `fine` times finer samples. Samples are even over their cells.
    """
    from scipy.signal import fftconvolve

    cells = np.ones((fine, fine))
    light, cover = (np.kron(np.pad(one, reach, mode="edge"), cells) for one in (back, front))
    light, cover = _by_rays(light, far * fine), _by_rays(cover, near * fine)
    q = 550e-9 * DEPTH_LENS.working_f_number / DEPTH_PITCH * fine
    kernel = _pattern(q, 0.0, reach * fine - fine // 2 - 1)
    middle = slice(reach * fine + fine // 2, -reach * fine, fine)

    def diffract(plane):
        return fftconvolve(plane, kernel / kernel.sum(), "same")[middle, middle]

    return diffract(light * cover) - diffract(light) * diffract(cover)


def _by_rays(plane, confusion, fine=16):
    """Return a plane after the blur by an even disc of diameter `confusion` [sample], without diffraction."""
    from scipy.signal import fftconvolve

    if not confusion:
        return plane
    half = int(np.ceil(abs(confusion) / 2 + 0.5))
    at = (np.arange((2 * half + 1) * fine) + 0.5) / fine - half - 0.5
    inside = np.hypot(at[:, None], at) <= abs(confusion) / 2
    kernel = inside.reshape(2 * half + 1, fine, 2 * half + 1, fine).mean(axis=(1, 3))
    return fftconvolve(np.pad(plane, half, mode="edge"), kernel / kernel.sum(), "valid")


def _out_of_focus(plane, confusion, reach=60):
    """Return a plane after the blur by a circle of confusion [pixel]; W020 = c / (8 q).

    The edge pixels continue beyond the frame.
    """
    from scipy.signal import fftconvolve

    q = 550e-9 * DEPTH_LENS.working_f_number / DEPTH_PITCH
    kernel = _pattern(q, abs(confusion) / (8 * q), reach)
    wide = np.pad(plane.astype(float), reach, mode="edge")
    return fftconvolve(wide, kernel / kernel.sum(), "valid")


@cache
def _pattern(q, waves, reach):
    at = np.arange(reach + 1)
    light = truth.defocused_airy(q, waves, 1.5 * reach + 2)
    return truth.whole(truth.in_pixels(light, at, at, int(np.ceil(6 + 3 / q))))


@case(
    30,
    "cos^4 and distortion",
    "100 degrees: energy per solid angle to 1e-3, no holes, more than 2 samples a pixel reported",
)
def wide_angle(device):
    """A uniform sphere through an equal-area lens: energy pi f^2 sin^2(theta) within theta.

    A pinhole has the irradiance cos^4. The distortion moves it to the radius 2 f sin(theta / 2) and
    conserves energy.
    """
    half, n, focal = np.radians(50), 240, open_camera("mono").optics.focal_length
    angles = np.linspace(0, np.radians(52), 53)
    lens = RadialTable(np.tan(angles) * focal, 2 * focal * np.sin(angles / 2))
    pitch = 2 * 2 * focal * np.sin(half / 2) / (np.sqrt(2) * n)  # 100 degrees from corner to corner
    camera = open_camera("mono")
    sensor = replace(camera.sensor, pixel_pitch=pitch, fill_factor=1.0)
    optics = replace(camera.optics, model="none", distortion=lens, relative_illumination="cos4")
    camera = replace(camera, sensor=sensor, optics=optics)
    scene = Scene(Cube(BANDS, np.ones((3, n, n), np.float32)), unit_light(BANDS))
    simulator = Simulator(camera, device=device)
    mean = mean_of(simulator, scene) / simulator.plan(scene).weights.sum()
    radius = np.hypot(*((np.indices((8 * n, 8 * n)) - (8 * n - 1) / 2) * (pitch / 8)))
    wrong, before = 0.0, np.zeros(2)
    for degrees in (10, 20, 30, 34):
        theta = np.radians(degrees)
        share = (radius < 2 * focal * np.sin(theta / 2)).reshape(n, 8, n, 8).mean(axis=(1, 3))
        now = np.array([(mean * share).sum() * pitch**2, np.pi * (focal * np.sin(theta)) ** 2])
        ring, before = now - before, now
        wrong = max(wrong, abs(ring[0] / ring[1] - 1))
    squeezed = distortion_grid(RadialPolynomial(0, 0, 1e-4, scale=0.4), (64, 64), 1.4e-6)
    is_reported = squeezed.ratio[1] > 2 and "more than 2 samples per pixel" in squeezed.report
    yield Found(wrong, 1e-3, "energy of a ring of angles")
    yield Found(np.count_nonzero(mean <= 0), 0, "holes")
    yield Found(0.0 if is_reported else 1.0, 0, "2.5 samples a pixel not reported")

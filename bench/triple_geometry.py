"""Places of samples behind a lens and a view, for `triple_outside.py`.

The distortion formulas are written again from their sources; Newton's method with finite
differences inverts them. Between samples the scene is band-limited: transforms of six times the
length, and splines of degree 5 between their values.
"""

from math import ceil

import numpy as np
import scipy.fft
import triple_brute as brute
from scipy.interpolate import CubicSpline
from scipy.ndimage import map_coordinates, spline_filter

from gpusim.domain.errors import OutOfRange

FINER, AROUND, FADE = (
    6,
    48,
    40,
)  # of the band-limited scene: oversampling; margin that fades to the mean


def band_limited(planes, down, across, border):
    """Return values at places from the samples' middle, by band-limited interpolation."""
    around = [
        ceil(max(AROUND / 2, np.abs(at).max() - (n - 1) / 2) + 1.2 * FADE)
        for at, n in zip((down, across), planes.shape[1:], strict=True)
    ]
    wide = np.pad(planes, ((0, 0), *((n, n) for n in around)), mode=brute.MODES[border])
    wide = np.pad(wide, ((0, 0), *((0, n % 2) for n in wide.shape[1:])), mode="edge")
    rows, cols = wide.shape[1:]
    for axis, n in ((1, rows), (2, cols)):  # no step where it repeats
        left = np.minimum(np.arange(n), np.arange(n)[::-1]) / FADE
        fade = np.where(
            left < 1, left**4 * (35 - 84 * left + 70 * left**2 - 20 * left**3), 1
        ).reshape(-1, *[1] * (2 - axis))
        mean = wide.mean(axis=axis, keepdims=True)
        wide = mean + (wide - mean) * fade
    fine, half = (
        np.zeros((FINER * rows, FINER * cols // 2 + 1), complex),
        cols // 2,
    )  # both lengths are even
    places = [
        FINER * (at + (n - 1) / 2 + more)
        for at, n, more in zip((down, across), planes.shape[1:], around, strict=True)
    ]
    found, (wide, back) = [], few(wide)
    for plane in wide:
        spectrum = scipy.fft.rfft2(plane)
        spectrum[rows // 2] /= (
            2  # the shortest waves are half up and half down: samples keep their values
        )
        spectrum[:, half] /= 2
        fine[: rows // 2 + 1, : half + 1], fine[-(rows // 2) :, : half + 1] = (
            spectrum[: rows // 2 + 1],
            spectrum[rows // 2 :],
        )
        values = scipy.fft.irfft2(fine, (FINER * rows, FINER * cols)) * FINER**2
        found.append(
            map_coordinates(
                spline_filter(values, 5, mode="grid-wrap"),
                places,
                order=5,
                mode="grid-wrap",
                prefilter=False,
            )
        )
    return np.tensordot(back, np.stack(found), 1)


def few(planes):
    """Return the fewest planes that span these, and the matrix (L, n) that restores them."""
    left, sizes, right = np.linalg.svd(planes.reshape(len(planes), -1), full_matrices=False)
    rank = max(1, int((sizes > 1e-8 * sizes[0]).sum()))
    return right[:rank].reshape(rank, *planes.shape[1:]), left[:, :rank] * sizes[:rank]


def displace(distortion, x, y):
    """Return the places of points behind the lens.

    x, y: places behind a pinhole. All in metres from the frame's middle.
    """
    kind = type(distortion).__name__
    if kind == "Framed":
        lens, focal, (cx, cy) = distortion.lens, distortion.radius, distortion.middle
        u, v = _in_units(lens, x / focal - cx, (y / focal - cy) / distortion.aspect)
        return focal * (u + cx), focal * (v * distortion.aspect + cy)
    u, v = _in_units(distortion, x / distortion.radius, y / distortion.radius)
    return u * distortion.radius, v * distortion.radius


def _in_units(lens, x, y):
    """Return the places in units of the model's radius.

    Formulas of Farrell and Wandell, of OpenCV's documentation, or a table.
    """
    kind, r = type(lens).__name__, np.hypot(x, y)
    if kind == "RadialPolynomial":
        factor = 1 + lens.k1 * r + lens.k2 * r**2
    elif kind == "Fisheye":
        angle = np.arctan(r)
        bent = angle * (
            1 + lens.k1 * angle**2 + lens.k2 * angle**4 + lens.k3 * angle**6 + lens.k4 * angle**8
        )
        factor = np.where(r > 1e-12, bent / np.maximum(r, 1e-12), 1.0)
    elif kind == "RadialTable":
        ideal, real = np.asarray(lens.ideal), np.asarray(lens.real)
        curve = CubicSpline(
            np.concatenate([-ideal[:0:-1], ideal]), np.concatenate([-real[:0:-1], real])
        )
        heights = r * ideal[-1]
        bent = (
            np.where(
                heights <= ideal[-1],
                curve(heights),
                curve(ideal[-1]) + (heights - ideal[-1]) * curve(ideal[-1], 1),
            )
            / ideal[-1]
        )
        factor = np.where(r > 1e-12, bent / np.maximum(r, 1e-12), curve(0.0, 1))
    else:
        q = r**2
        factor = (1 + lens.k1 * q + lens.k2 * q**2 + lens.k3 * q**3) / (
            1 + lens.k4 * q + lens.k5 * q**2 + lens.k6 * q**3
        )
        more = (
            2 * lens.p1 * x * y + lens.p2 * (q + 2 * x * x) + lens.s1 * q + lens.s2 * q**2,
            lens.p1 * (q + 2 * y * y) + 2 * lens.p2 * x * y + lens.s3 * q + lens.s4 * q**2,
        )
        if lens.tau_x or lens.tau_y:
            raise OutOfRange("tilt", (lens.tau_x, lens.tau_y), "0")
        return lens.scale * (x * factor + more[0]), lens.scale * (y * factor + more[1])
    return lens.scale * x * factor, lens.scale * y * factor


def undisplace(distortion, x, y, step):
    """Return pinhole places of the points that the lens puts at (x, y) [m], and the area ratio.

    The ratio is the ideal over the seen area. Newton's method; step: for differences [m].
    """
    u, v = np.array(x, float), np.array(y, float)
    with np.errstate(all="ignore"):
        return _newton(distortion, x, y, u, v, step)


def _newton(distortion, x, y, u, v, step):
    """Return the same, from a start (u, v)."""
    for _ in range(60):
        at = displace(distortion, u, v)
        right = [
            (a - b) / (2 * step)
            for a, b in zip(
                displace(distortion, u + step, v), displace(distortion, u - step, v), strict=True
            )
        ]
        down = [
            (a - b) / (2 * step)
            for a, b in zip(
                displace(distortion, u, v + step), displace(distortion, u, v - step), strict=True
            )
        ]
        area = right[0] * down[1] - right[1] * down[0]
        off = at[0] - x, at[1] - y
        u, v = (
            u - (down[1] * off[0] - down[0] * off[1]) / area,
            v - (right[0] * off[1] - right[1] * off[0]) / area,
        )
        if max(np.abs(off[0]).max(), np.abs(off[1]).max()) < 1e-9 * step:
            return u, v, 1 / area
    raise OutOfRange("distortion", "not inverted", "one to one")


def model_of(scene, camera):
    """Return the distortion for this frame, None without one."""
    distortion = camera.optics.distortion
    if hasattr(distortion, "fit_to_frame"):
        return distortion.fit_to_frame(scene.shape, camera.sensor.pixel_pitch)
    return distortion


def axis_of(scene, camera) -> tuple[float, float]:
    """Return the principal point from the frame's middle, (rows, cols) [pixel]."""
    calibration = camera.optics.distortion
    if not hasattr(calibration, "fit_to_frame"):
        return 0.0, 0.0
    rows, cols = scene.shape
    return (
        (calibration.cy + 0.5) / calibration.height * rows - rows / 2,
        (calibration.cx + 0.5) / calibration.width * cols - cols / 2,
    )


def distorted(scene, camera, planes, beyond, order=None, is_flux=True):
    """Return samples displaced by the lens, with `beyond` more on each side.

    order: of splines between samples, without scaling their light; None: band-limited. is_flux:
    whether places at which the lens crowds points are brighter.
    """
    pitch = camera.sensor.pixel_pitch / scene.samples_per_pixel
    y, x = np.meshgrid(
        *(pitch * (np.arange(-beyond, n + beyond) - (n - 1) / 2) for n in planes.shape[1:]),
        indexing="ij",
    )
    try:
        u, v, area = undisplace(model_of(scene, camera), x, y, pitch / 8)
    except OutOfRange:
        if not beyond:
            raise
        return distorted(scene, camera, planes, 0, order, is_flux)
    if order is not None:
        places = [at / pitch + (n - 1) / 2 for at, n in zip((v, u), planes.shape[1:], strict=True)]
        return np.stack(
            [map_coordinates(plane, places, order=order, mode="nearest") for plane in planes]
        )
    if not isinstance(camera.optics.relative_illumination, str):  # it is the flat field
        axis = axis_of(scene, camera)
        at = [np.array([[camera.sensor.pixel_pitch * one]]) for one in axis]
        area = undisplace(model_of(scene, camera), at[1], at[0], pitch / 8)[2]
    return band_limited(planes, v / pitch, u / pitch, scene.border) * (area if is_flux else 1)


def falloff(scene, camera) -> np.ndarray:
    """Return the relative response of lens and pixels at every pixel, (rows, cols)."""
    optics, sensor, shape = camera.optics, camera.sensor, scene.shape
    pitch, distortion = sensor.pixel_pitch, model_of(scene, camera)
    y, x = np.meshgrid(
        *(
            (np.arange(n) - (n - 1) / 2 + move)
            for n, move in zip(shape, sensor.displacement, strict=True)
        ),
        indexing="ij",
    )
    axis = axis_of(scene, camera)
    gain = np.ones(shape)
    if isinstance(optics.relative_illumination, str):
        if optics.relative_illumination == "cos4":
            slope = 1 / optics.image_distance  # of the field angle's tangent, per metre
            if scene.fov:
                slope = (
                    2 * np.tan(scene.fov / 2) * scene.samples_per_pixel / scene.samples[1] / pitch
                )
            u, v = pitch * x, pitch * y
            if distortion is not None:
                u, v, _ = undisplace(distortion, u, v, pitch / 8)
            tangent = np.hypot(u, v) * slope
            if hasattr(distortion, "lens"):
                tangent = np.hypot(
                    u / distortion.radius - distortion.middle[0],
                    (v / distortion.radius - distortion.middle[1]) / distortion.aspect,
                )
            gain = (1 + tangent**2) ** -2
    else:
        height = np.hypot(y - axis[0], x - axis[1]) / (np.hypot(*shape) / 2)
        given = optics.relative_illumination
        if np.ndim(given[0]) == 1:
            gain = np.interp(height, *given) / given[1][0]
        else:
            gain = 1 + sum(factor * height**power for power, factor in enumerate(given, 1))
    if sensor.vignetting is not None:
        table = np.array(sensor.vignetting)
        places = [
            np.clip((at + (n - 1) / 2 + 0.5) / n, 0, 1) * (count - 1)
            for at, n, count in zip((y, x), shape, table.shape, strict=True)
        ]
        gain = gain * map_coordinates(table, places, order=1, mode="nearest")
    return gain


def channel_weights(scene, camera) -> np.ndarray:
    """Return electrons per second per channel for content 1 at each wavelength, (C, L)."""
    nodes, optics, sensor = scene.wavelengths, camera.optics, camera.sensor
    grid = np.unique(
        np.concatenate(
            [
                np.arange(nodes[0], nodes[-1], brute.STEP_NM),
                nodes,
                *(
                    table[(table > nodes[0]) & (table < nodes[-1])]
                    for table in (scene.illuminant.wavelengths, sensor.qe.wavelengths)
                ),
            ]
        )
    )
    light = np.interp(grid, scene.illuminant.wavelengths, scene.illuminant.values, left=0, right=0)
    if isinstance(optics.transmission, float | int):
        light = light * optics.transmission
    else:
        light = light * np.interp(grid, optics.transmission.wavelengths, optics.transmission.values)
    splines = CubicSpline(
        nodes, np.eye(len(nodes)), bc_type="not-a-knot" if len(nodes) > 3 else "natural"
    )(grid)
    n, hole = optics.pupil.blades, optics.pupil.obscuration
    open_area = (n / (2 * np.pi) * np.sin(2 * np.pi / n) if n else 1.0) - hole**2
    scale = np.prod(sensor.aperture) * open_area * np.pi / (1 + 4 * optics.working_f_number**2)
    return scale * np.stack(
        [
            np.trapezoid(
                splines
                * (light * np.interp(grid, sensor.qe.wavelengths, curve, left=0, right=0))[:, None],
                grid,
                axis=0,
            )
            for curve in sensor.qe.values
        ]
    )

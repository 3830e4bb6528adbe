"""The geometry of the truth: displaced light and fall-off, float64.

Between its samples a scene is band-limited: the Fourier series through the samples and their mirror
image, after an extension by the rule of the border. Newton's method finds the source of every place
in the image, from the model of the camera.
"""

from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np
import scipy

from gpusim.domain.calibration import Framed
from gpusim.domain.distortion import fit_to_frame, ideal
from gpusim.domain.scene import IMAGE
from gpusim.optics.geometry import microlens_gain, relative_illumination, rim_of, vignetting_gain
from gpusim.optics.lenses import lens_of
from gpusim.optics.outside import border_indices

# Gridding from a transform twice as long, by a kernel of TAPS samples: errs by 1e-9.
# Source: Jackson et al., IEEE Trans. Med. Imaging 10 (1991) 473.
TAPS = 10
# Beatty, Nishimura and Pauly, same journal 24 (2005) 799
SHAPE = np.pi * np.sqrt((TAPS / 2) ** 2 * 2.25 - 0.8)
MODES: dict[str, Any] = {
    "zero": "constant",
    "edge": "edge",
    "scene": "edge",
    "reflect": "symmetric",
}
# [sample] around the scene in the series: beyond the displaced places, and at most
RIM = 32
FARTHEST = 512
# if one place spans more samples, it is the mean over PARTS x PARTS Gauss nodes of its cell
FINER = 2.0
PARTS = 4


def centre_pads(period, shape) -> list[tuple[int, int]]:
    """Return the samples before and after an array that centre it in a period, by axis."""
    gaps = [length - n for length, n in zip(period, shape, strict=True)]
    return [(gap // 2, gap - gap // 2) for gap in gaps]


def axis_of(camera, shape) -> tuple[float, float]:
    """Return the place of the optical axis, from the middle of a frame, (rows, cols) [pixel]."""
    model, pitch = _distortion_of(camera, shape), camera.sensor.pixel_pitch
    if not isinstance(model, Framed):
        return 0.0, 0.0
    x, y = (middle * model.radius / pitch for middle in model.middle)
    return y, x


def _distortion_of(camera, shape):
    """Return the distortion of the lens in a frame of `shape`, or None."""
    distortion = camera.optics.distortion
    if distortion is None:
        return None
    return fit_to_frame(distortion, shape, camera.sensor.pixel_pitch)


def _displacement_of(camera, scene):
    """Return the distortion that displaces the samples of a scene, or None: an image is displaced already."""
    return None if scene.projection == IMAGE else _distortion_of(camera, scene.shape)


def with_rim(camera, scene):
    """Return a scene with what lies around it by the rule of its border, if a lens displaces and blurs that.

    The border belongs to the scene, not to its distorted picture. It goes on by as much as the
    planner may take, if the model of the lens goes so far.
    """
    model, pitch = _displacement_of(camera, scene), camera.sensor.pixel_pitch
    if model is None or scene.depth is not None:
        return scene
    rim = rim_of(model, scene.content.shape, pitch / scene.samples_per_pixel)
    lens = lens_of(camera)
    if not rim or lens.is_pointlike or not lens.is_uniform:
        return scene
    content = scene.content.on_host()
    rows, cols = (border_indices(np.arange(-rim, n + rim), n, scene.border) for n in content.shape)
    content = content.with_samples(lambda array: array[..., rows[:, None], cols])
    if scene.border == "zero":
        inside = np.zeros(content.shape, content.planes.dtype)
        inside[rim:-rim, rim:-rim] = 1
        content = content.with_planes(content.planes * inside)
    return replace(scene, content=content, border="scene", margin=scene.margin + rim, labels={})


def placed_light(camera, scene, light=None, is_flux: bool = True) -> np.ndarray:
    """Return the light of every wavelength at its place in the image, (L, rows, cols).

    The distortion of the lens and the view of the scene displace it. A star keeps its energy, and
    a flat field is the sum of its points; with a relative illumination that is given, a flat field
    stays flat.

    Args:
        camera: The camera.
        scene: The scene.
        light: Planes of samples instead of the scene's, (L, rows, cols).
        is_flux: Whether places at which the lens crowds points are brighter.
    """
    if light is None:
        light = scene.content.on_host().bands_at(slice(None))
    model = _displacement_of(camera, scene)
    if model is None and scene.view.is_plain:
        return light
    rows, cols = light.shape[1:]
    y, x = np.arange(rows) - (rows - 1) / 2, np.arange(cols) - (cols - 1) / 2
    source = _source_of(camera, scene, light.shape[1:])
    nodes, mass = np.zeros(1), np.ones(1)
    if model is not None and _most_samples(source, y, x) > FINER:
        nodes, mass = (part / 2 for part in np.polynomial.legendre.leggauss(PARTS))
    total, flat = np.zeros(light.shape), np.zeros((rows, cols))
    for down, high in zip(nodes, mass, strict=True):
        for across, wide in zip(nodes, mass, strict=True):
            at_y, at_x, flux = source(y[:, None] + down, x + across)
            seen = band_limited(light, at_y, at_x, scene.border)
            total += high * wide * (flux if is_flux else 1) * seen
            flat += high * wide * flux
    if is_flux and model is not None and not isinstance(camera.optics.relative_illumination, str):
        at = model.middle if isinstance(model, Framed) else (0.0, 0.0)
        a, b, c, d = model.derivative(*map(np.float64, at))
        total /= flat * (a * d - b * c)
    return total


def placed_nearest(camera, scene, values) -> np.ndarray:
    """Return values (rows, cols) where the lens and the view put them, each of the nearest sample."""
    if _displacement_of(camera, scene) is None and scene.view.is_plain:
        return values
    y, x = (np.arange(n) - (n - 1) / 2 for n in values.shape)
    places = _source_of(camera, scene, values.shape)(y[:, None], x)[:2]
    at = [
        border_indices(
            np.rint(one).astype(int), n, "reflect" if scene.border == "reflect" else "edge"
        )
        for one, n in zip(places, values.shape, strict=True)
    ]
    return values[tuple(at)]


def _source_of(camera, scene, shape):
    """Return a function from places in the image, from its middle, to rows and columns of the source.

    It also returns the area of the source relative to the image.
    """
    rows, cols = shape
    model = _displacement_of(camera, scene)
    pitch = camera.sensor.pixel_pitch / scene.samples_per_pixel

    def source(y, x):
        y, x = np.broadcast_arrays(y, x)
        flux = np.ones(y.shape)
        if model is not None:
            step = pitch / model.radius
            u, v = ideal(model, x * step, y * step)
            a, b, c, d = model.derivative(u, v)
            y, x, flux = v / step, u / step, 1 / (a * d - b * c)
        y, x = scene.view.place(y, x, scene.samples_per_pixel)
        return y + (rows - 1) / 2, x + (cols - 1) / 2, flux

    return source


def _most_samples(source, y, x):
    """Return the most scene samples from one place of the image to the next."""
    at = np.stack(source(y[:, None], x)[:2])
    return max(np.hypot(*np.diff(at, axis=axis)).max(initial=0) for axis in (1, 2))


def band_limited(planes, y, x, border: str) -> np.ndarray:
    """Return values of planes between and beyond their samples.

    Args:
        planes: Shape (L, rows, cols).
        y: Rows of the places [sample].
        x: Columns of the places [sample], with the shape of y.
        border: Rule of the border.

    Returns:
        Shape (L, *y.shape).
    """
    rim = [
        0 if border == "reflect" else int(min(max(-at.min(), at.max() - n + 1, 0), FARTHEST)) + RIM
        for at, n in zip((y, x), planes.shape[1:], strict=True)
    ]
    lengths = [2 * (n + 2 * more) for n, more in zip(planes.shape[1:], rim, strict=True)]
    taps, inside = [], np.ones(np.shape(y), bool)
    for at, n, more, length in zip((y, x), planes.shape[1:], rim, lengths, strict=True):
        if border == "zero":
            inside &= (at > -more) & (at < n - 1 + more)
        if border != "reflect":  # the series is mirrored already
            at = np.clip(at, -more, n - 1 + more)
        at = 2 * (at + more)
        first = np.ceil(at - TAPS / 2).astype(int)
        taps.append([((first + k) % (2 * length), _kernel(at - first - k)) for k in range(TAPS)])
    series = [
        _kernel_transform(np.fft.fftfreq(length, 1 / length) / (2 * length)) for length in lengths
    ]
    out = np.empty((len(planes), *np.shape(y)))
    for total, plane in zip(out, planes, strict=True):
        wide = np.pad(plane, [(more, more) for more in rim], mode=MODES[border])
        wide = np.pad(wide, [(0, n) for n in wide.shape], mode="symmetric")
        spectrum = scipy.fft.fft2(wide) / series[0][:, None] / series[1]
        longer = np.zeros((2 * lengths[0], 2 * lengths[1]), complex)
        at = [np.fft.fftfreq(length, 1 / length).astype(int) for length in lengths]
        longer[np.ix_(*at)] = spectrum
        fine = 4 * scipy.fft.ifft2(longer, workers=-1).real
        total[:] = sum(
            down * sum(across * fine[row, col] for col, across in taps[1]) for row, down in taps[0]
        )
        total *= inside
    return out


def _kernel(t):
    return np.i0(SHAPE * np.sqrt(np.maximum(1 - (2 * t / TAPS) ** 2, 0))) * (np.abs(t) <= TAPS / 2)


def _kernel_transform(f):
    """Return the transform of `_kernel` at f [cycle/fine sample], |f| < 1/4."""
    root = np.sqrt(SHAPE**2 - (np.pi * TAPS * f) ** 2)
    return TAPS * np.sinh(root) / root


def falloff_gain(camera, scene) -> np.ndarray:
    """Return the light of every pixel relative to the axis, (rows, cols).

    It includes the lens, the microlenses and the vignetting of the pixels.

    Raises:
        OutOfRange: A table of the relative illumination ends before the corner of the frame.
    """
    optics, sensor, shape = camera.optics, camera.sensor, scene.shape
    pitch, distance = sensor.pixel_pitch, optics.image_distance
    from_axis = tuple(
        move - at for move, at in zip(sensor.displacement, axis_of(camera, shape), strict=True)
    )
    gain = np.ones(shape)
    if optics.relative_illumination == "cos4" and scene.projection != IMAGE:
        gain = (1 + _tangent(camera, scene) ** 2) ** -2
    elif not isinstance(optics.relative_illumination, str):
        table = optics.relative_illumination
        gain = relative_illumination(table, shape, pitch, distance, displacement=from_axis)
    if sensor.microlens is not None:
        gain = gain * microlens_gain(sensor.microlens, shape, pitch, distance, from_axis)
    if sensor.vignetting is not None:
        gain = gain * vignetting_gain(sensor.vignetting, shape, sensor.displacement)
    return gain


def _tangent(camera, scene):
    """Return the tangent of the angle of incidence in object space, (rows, cols)."""
    optics, sensor = camera.optics, camera.sensor
    slope = sensor.pixel_pitch / optics.image_distance
    if scene.fov:
        slope = 2 * np.tan(scene.fov / 2) * scene.samples_per_pixel / scene.samples[1]
    y, x = (
        np.arange(n) - (n - 1) / 2 + move
        for n, move in zip(scene.shape, sensor.displacement, strict=True)
    )
    if optics.distortion is None:
        return np.hypot(y[:, None], x) * slope
    model = fit_to_frame(optics.distortion, scene.shape, sensor.pixel_pitch)
    step = sensor.pixel_pitch / model.radius
    u, v = ideal(model, x * step, y[:, None] * step)
    if isinstance(model, Framed):
        return np.hypot(*model.normalise(u, v))
    return np.hypot(u, v) / step * slope


def pixel_places(camera, scene) -> list[np.ndarray]:
    """Return the centres of the light-sensitive areas among the scene's samples [sample].

    The frame is in the middle of the samples. If a pixel is a whole number of samples, it begins
    with a sample.
    """
    ratio, places = float(scene.samples_per_pixel), []
    for n, pixels, move in zip(scene.samples, scene.shape, camera.sensor.displacement, strict=True):
        start = (n - pixels * ratio) / 2
        start = np.floor(start) if ratio.is_integer() else max(start, 0.0)
        places.append(start + ratio * (np.arange(pixels) + 0.5 + move) - 0.5)
    return places


def plain_rates(channels, camera, scene) -> np.ndarray:
    """Return channels (C, rows, cols) at the pixels without blur; samples fill their cells."""
    out = channels
    widths = [
        side / camera.sensor.pixel_pitch * scene.samples_per_pixel
        for side in camera.sensor.aperture
    ]
    for axis, (places, width) in enumerate(
        zip(pixel_places(camera, scene), widths, strict=True), 1
    ):
        n, margin = scene.samples[axis - 1], scene.margin
        low, high = places - width / 2, places + width / 2
        more = max(0, ceil(-low.min()), ceil(high.max() - n)) + 1
        cells = np.arange(-more, n + more)
        overlap = np.minimum(high[:, None], cells + 0.5) - np.maximum(low[:, None], cells - 0.5)
        share = np.maximum(overlap, 0) / width
        short = max(0, more - margin)
        pads = [(0, 0)] * 3
        pads[axis] = (short, short)
        kept = np.pad(out, pads, mode=MODES[scene.border])
        kept = np.take(kept, cells + margin + short, axis)
        out = np.moveaxis(np.tensordot(share, kept, (1, axis)), 0, axis)
    return out

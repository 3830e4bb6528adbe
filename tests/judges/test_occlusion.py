"""Edges of depth against rays: layers out of focus, through the pupil's own shape, with own geometry in float64."""

from dataclasses import dataclass, replace

import numpy as np

from gpusim.domain.content import Cube
from gpusim.domain.optics import Optics
from gpusim.domain.scene import Layer, Scene, unit_light
from gpusim.io.camera.cameras import open_camera
from gpusim.optics.depth import distance_of
from gpusim.pipeline.simulator import Simulator

SIZE = 64
READ = 2.0  # [e-]
BANDS = np.array([540.0, 550.0, 560.0])
# points along a sample, odd so that one is in its middle, and rays in the square around the pupil: light that is smooth
# needs no finer points, and the more rays the smoother it is
SHARP, SMOOTH = (3, 4000), (1, 30000)
PHONE = Optics(2.0, 5e-3, object_distance=0.4, relative_illumination="none")
PITCH = 4e-6


@dataclass(frozen=True)
class Flat:
    """A layer of the truth: light, coverage, circle of confusion [sample], a number or a map."""

    light: np.ndarray
    alpha: np.ndarray
    confusion: float | np.ndarray


def texture(seed, level=1.0, contrast=0.25, size=SIZE):
    """Clouds of 1/f amplitudes."""
    random = np.random.default_rng(seed)
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size))
    f[0, 0] = 1
    waves = np.fft.ifft2(np.fft.fft2(random.standard_normal((size, size))) / f).real
    return level * np.exp(contrast * waves / waves.std())


def disc(radius=17.0, size=SIZE):
    y, x = np.indices((size, size))
    return (np.hypot(y - size / 2 + 0.3, x - size / 2) < radius).astype(float)


def rays_of(pupil, count):
    """Points of the pupil by Hammersley's set, those that its opening lets through: image axes, radius 1."""
    number = np.arange(count)
    bits = sum(((number >> k) & 1) / 2 ** (k + 1) for k in range(20))
    y, x = 2 * (number + 0.5) / len(number) - 1, 2 * bits - 1
    is_open = (np.hypot(y, x) <= 1) & (np.hypot(y, x) >= pupil.obscuration)
    if pupil.blades:
        # inside a regular polygon whose first corner stands at the rotation: by its corners
        turns = pupil.rotation + 2 * np.pi * np.arange(pupil.blades + 1) / pupil.blades
        cy, cx = np.sin(turns), np.cos(turns)
        for n in range(pupil.blades):
            across = (cx[n + 1] - cx[n]) * (y - cy[n]) - (cy[n + 1] - cy[n]) * (x - cx[n])
            is_open &= across >= 0
    return np.stack([y[is_open], x[is_open]], axis=1)


def rays_and_product(layers, pupil, q, fine, count):
    """What a pixel sees by rays, and what the product of the layers' own means gives; diffraction in focus for both.

    The middle of a pixel, and `fine` x `fine` points a sample for the diffraction, look through
    each point u of the pupil at layer k at x + c_k u / 2. Samples are even over their cells.
    """
    size = layers[0].light.shape[0]
    at = (np.arange(-fine * 8, fine * (size + 8)) + 0.5) / fine - 0.5  # eight samples around
    y, x = np.meshgrid(at, at, indexing="ij")
    near = [np.clip(np.rint(one).astype(int), 0, size - 1) for one in (y, x)]
    seen, lights, alphas = (np.zeros((n, *y.shape)) for n in (1, len(layers), len(layers)))
    radii = [
        np.broadcast_to(layer.confusion, layer.light.shape)[near[0], near[1]] / 2
        for layer in layers
    ]
    rays = rays_of(pupil, count)
    for v, u in rays:
        through = np.ones(y.shape)
        for k, (layer, radius) in enumerate(zip(layers, radii, strict=True)):
            i = np.clip(np.floor(y + radius * v + 0.5).astype(int), 0, size - 1)
            j = np.clip(np.floor(x + radius * u + 0.5).astype(int), 0, size - 1)
            own = layer.alpha[i, j]
            lights[k] += own * layer.light[i, j]
            alphas[k] += own
            seen[0] += through * own * layer.light[i, j]
            through = through * (1 - own)
    f = np.fft.fftfreq(len(at), 1 / fine)
    s = np.minimum(np.hypot(f[:, None], f) * q, 1)
    passed = 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))  # of a circle; near it for others
    middle = np.s_[8 * fine + fine // 2 :: fine, 8 * fine + fine // 2 :: fine]

    def image(pictures):
        blurred = np.fft.ifft2(np.fft.fft2(pictures / len(rays)) * passed).real
        return np.array([one[middle][:size, :size] for one in blurred])

    return image(seen)[0], compose(image(lights), image(alphas))


def compose(lights, alphas):
    """Products of the layers' light and of what the nearer ones let through."""
    through = np.cumprod(np.concatenate([np.ones((1, *alphas.shape[1:])), 1 - alphas[:-1]]), axis=0)
    return (through * lights).sum(axis=0)


def camera(optics=PHONE, pitch=PITCH):
    made = open_camera("mono")
    return replace(
        made, optics=optics, sensor=replace(made.sensor, pixel_pitch=pitch, fill_factor=1.0)
    )


def scene_of(layers, optics=PHONE, pitch=PITCH):
    """The layers as a scene of radiance."""

    def content(layer):
        return Cube(BANDS, (1e15 * np.ones((3, 1, 1)) * layer.light).astype(np.float32))

    def depth(layer):
        return distance_of(optics, layer.confusion + np.zeros(layer.light.shape), pitch)

    *front, back = layers
    return Scene(
        content(back),
        unit_light(BANDS),
        depth=depth(back),
        layers=tuple(
            Layer(content(one), one.alpha.astype(np.float32), depth(one)) for one in front
        ),
    )


def error_in_sigma(
    layers, optics=PHONE, pitch=PITCH, points=SHARP, device="opencl:0", well=10000.0
):
    """|frame - truth| / sigma, where light 1 gives `well` electrons, inside a rim of 6 samples; and the plan.

    The blur of one layer is by waves and not in question: frames of single layers, each all at one
    distance, give it. What layers hide of each other is by rays.
    """
    cam = camera(optics, pitch)
    scene = scene_of(layers, optics, pitch)
    seconds = well / one_layer(Flat(np.ones((SIZE, SIZE)), 1, 0.0), cam).mean()
    simulator = Simulator(cam, device=device, tolerance="video")
    frame = simulator.expose(scene, seconds)
    mean = np.array(simulator.device.numpy(frame.mean), np.float64)
    each = [one_layer(one, cam) * seconds / well for one in layers]
    covers = [one_layer(replace(one, light=1.0), cam) * seconds / well for one in layers]
    q = 550e-9 * optics.working_f_number / pitch
    rays, product = rays_and_product(layers, optics.pupil, q, *points)
    truth = well * (compose(np.array(each), np.array(covers)) + rays - product)
    noise = np.sqrt(np.maximum(truth, 1) + READ**2)
    return ((mean - truth) / noise)[6:-6, 6:-6], frame.plan


def one_layer(layer, cam):
    """Electrons of one second of a layer in front of nothing."""
    light = layer.light * np.ones((SIZE, SIZE)) * layer.alpha
    alone = Flat(light, np.ones((SIZE, SIZE)), layer.confusion)
    scene = scene_of([alone], cam.optics, cam.sensor.pixel_pitch)
    simulator = Simulator(cam, device="numpy")
    return np.array(simulator.expose(scene, 1.0).mean, np.float64)

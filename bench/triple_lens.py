"""Spreads of light by a camera's lens at any field point and distance, for `triple_outside.py`.

For a pupil by sums over its chords, for measured lenses from the Gaussians of their mixtures.
"""

from dataclasses import dataclass, field, replace

import numpy as np
import triple_brute as brute
from scipy.special import erf
from triple_geometry import axis_of
from triple_pupils import chords, spreads, zernike


@dataclass(frozen=True, eq=False)
class Lens:
    """Spreads of light by a camera's lens, in samples.

    known: kernels that were made. wide: factor on the reach within which all light is summed.
    """

    scene: object
    camera: object
    known: dict = field(default_factory=dict)
    wide: float = 1.0

    @property
    def varies(self):
        """Whether the spread depends on the place."""
        optics = self.camera.optics
        return optics.varies

    def place(self, rows, cols):
        """Return the field point (y, x) of samples, relative to the optical axis.

        1 is the corner's distance from the frame's middle.
        """
        scene, ratio = self.scene, self.scene.samples_per_pixel
        axis, corner = axis_of(scene, self.camera), np.hypot(*scene.shape) / 2
        middle = [(n - 1) / 2 for n in scene.content.shape]
        return ((rows - middle[0]) / ratio - axis[0]) / corner, (
            (cols - middle[1]) / ratio - axis[1]
        ) / corner

    def q(self, wavelength):
        """Return wavelength times f-number over the distance of samples."""
        pitch = self.camera.sensor.pixel_pitch / self.scene.samples_per_pixel
        return wavelength * 1e-9 * self.camera.optics.working_f_number / pitch

    def waves(self, wavelength, y, x, distance):
        """Return the wavefront at a field point and distance, and its steepest slope."""
        optics, scene = self.camera.optics, self.scene
        own, height, angle = optics.wavefront, np.hypot(y, x), np.arctan2(y, x)
        zernikes = np.array(own.zernike)
        if own.heights:
            zernikes = np.array([np.interp(height, own.heights, column) for column in zernikes.T])
        shift = (
            optics.defocus
            if isinstance(optics.defocus, float)
            else float(np.interp(wavelength, optics.defocus.wavelengths, optics.defocus.values))
        )
        if distance is not None:
            shift += (1 / optics.object_distance - 1 / distance) * optics.image_distance**2
        focus = shift / (8 * optics.working_f_number**2 * wavelength * 1e-9)
        colour = optics.lateral_color
        colour = (
            colour
            if isinstance(colour, float)
            else float(np.interp(wavelength, colour.wavelengths, colour.values))
        )
        # a tilt that moves the image by colour times the place: rays meet it at -2 q grad W
        corner = np.hypot(*scene.shape) / 2 * scene.samples_per_pixel
        tilt = [-colour * corner * at / (2 * self.q(wavelength)) for at in (y, x)]
        w040, w131, w222, w220, w311 = own.seidel
        scale, cos, sin = own.reference / wavelength, np.cos(angle), np.sin(angle)

        def waves(u, v):
            along, across, square = u * cos + v * sin, v * cos - u * sin, u * u + v * v
            total = (
                w040 * square**2
                + w131 * height * square * along
                + w222 * height**2 * along**2
                + w220 * height**2 * square
                + w311 * height**3 * along
            )
            for number, weight in enumerate(zernikes, 1):
                if weight and number > 1:
                    total = total + weight * zernike(number, along, across)
            return scale * total + focus * square + tilt[0] * v + tilt[1] * u

        return waves


def steepest(waves) -> float:
    """Return the largest slope of a wavefront over the disc [waves per radius]."""
    u, v = np.meshgrid(*[np.linspace(-1, 1, 33)] * 2)
    slopes = np.gradient(waves(u, v), u[0, 1] - u[0, 0])
    return float(np.hypot(*slopes)[np.hypot(u, v) <= 1.05].max())


def apertures(scene, camera):
    """Return width and phase of the pixels' apertures [sample], and the first pixel's place."""
    ratio, sensor = scene.samples_per_pixel, camera.sensor
    width = tuple(ratio * one / sensor.pixel_pitch for one in sensor.aperture)
    first = [
        scene.margin + (have - 2 * scene.margin - ratio * n) / 2 // 1 + ratio * (0.5 + move) - 0.5
        for have, n, move in zip(scene.content.shape, scene.shape, sensor.displacement, strict=True)
    ]
    return width, tuple(float(one % 1) for one in first), [int(np.floor(one)) for one in first]


def kernels(lens, wavelength, points, reach, width=None, tilt=None):
    """Yield the light that apertures receive from a point at each of (y, x, distance).

    width: of the apertures [sample], None: the camera's. tilt: see `spreads`. Each has shape
    (2 reach + 1, 2 reach + 1).
    """
    scene, camera = lens.scene, lens.camera
    optics = camera.optics
    own, phase, _ = apertures(scene, camera)
    width = width or own
    pitch = camera.sensor.pixel_pitch / scene.samples_per_pixel
    q = lens.q(wavelength)
    at, fine = brute.fine_grid(q, reach)
    extra = brute.Spread(
        q,
        apart=tuple(one / pitch for one in optics.birefringence),
        diffused=optics.diffuser / pitch,
    )
    waves = [lens.waves(wavelength, *point) for point in points]
    front = optics.wavefront
    if not (optics.pupil.blades or optics.varies or front.zernike):  # round
        u, of = np.array([0.0, 0.5, 1.0]), waves[0]
        w040 = front.seidel[0] * front.reference / wavelength
        round_ = brute.Spread(q, float(of(u, 0 * u)[2] - w040), w040, optics.pupil.obscuration)
        r = np.hypot(at[:, None], at)
        values = brute.round_spread(round_, reach + 4 + 2 / q, tilt is not None)(r)
        if tilt is not None:
            values = values * (at if tilt else at[:, None]) / np.maximum(r, 1e-9)
        yield brute.apertured(values, fine, reach, width, phase, extra)
        return
    rule = chords(optics.pupil, np.abs(at).max() / (2 * q) + max(map(steepest, waves)))
    for values in spreads(rule, q, waves, at, tilt):
        yield brute.apertured(values, fine, reach, width, phase, extra)


def measured_kernels(lens, wavelength, places, reach):
    """Yield the same for point spreads that are mixtures of Gaussians. blobs: gives these."""
    scene, camera = lens.scene, lens.camera
    width, phase, _ = apertures(scene, camera)
    pitch = camera.sensor.pixel_pitch / scene.samples_per_pixel
    whole = np.arange(-reach, reach + 1)
    for y, x in places:
        total = 0.0
        for weight, down, across, sigma in camera.optics.psf.blobs(wavelength, y, x):
            sides = []
            for d, w, at in zip((down, across), width, phase, strict=True):
                edge = (whole + at - d / pitch)[:, None] + np.array([-w, w]) / 2
                sides.append(
                    np.diff(erf(edge / (np.sqrt(2) * sigma / pitch)), axis=1)[:, 0] / (2 * w)
                )
            total = total + weight * np.outer(*sides)
        yield total


def tail(lens, wavelength, reach) -> float:
    """Return the light of a point outside a square of half-width `reach`."""
    if lens.camera.optics.model == "measured":
        return 0.0
    return sum(
        part * brute.energy_beyond(replace(of, q=lens.q(wavelength)), reach)
        for part, of in edges(lens)
    )


def edges(lens):
    """Return edges that throw light far: outline and obstruction, each a Spread and a share."""
    pupil = lens.camera.optics.pupil
    if not pupil.blades:
        return [(1.0, brute.Spread(1.0, hole=pupil.obscuration))]
    n, hole = pupil.blades, pupil.obscuration
    polygon = n / 2 * np.sin(2 * np.pi / n)
    area = polygon - np.pi * hole**2
    return [
        (polygon / area, brute.Spread(1.0, blades=n, turned=pupil.rotation)),
        (np.pi * hole / area, brute.Spread(1.0)),
    ][: 2 if hole else 1]

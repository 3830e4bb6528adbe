"""From a scene and a camera to what is computed: host float64 mathematics, no device."""

from dataclasses import dataclass, field
from math import prod

import numpy as np
from scipy.special import j0, j1

from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import Basis, Cube, Materials, Scene
from gpusim.domain.spectrum import Spectrum
from gpusim.planner.weights import product_weights

BORDER_REACH = 64  # [pixel] of surroundings on each side that take part in the blur, unless a tolerance asks for more
SMALLEST_Q = 0.05  # below it the transfer tables are sums over thousands of replicas


@dataclass(frozen=True, eq=False)
class Plan:
    """What a frame of `scene` by `camera` takes; every array is float64.

    weights: electrons per second in each channel for content 1 at each of the scene's wavelengths, shape (C, L).
    white_rate: electrons per second that a perfect white diffuser gives in each channel, on axis, shape (C,); None
        when the scene's light is unknown.
    table: planes from content entries (bands, basis coefficients or materials), shape (planes, entries), or None where
        the content's own planes are used.
    gains: channels from blurred planes, shape (C, planes); without blur the planes are the channels and it is None.
    table_spectra: spectrum behind each plane, shape (planes, L), where the transfer functions of a plane are those
        of a whole spectrum, None where each plane is one wavelength.
    q: wavelength times working f-number over pixel pitch at each wavelength, shape (L,).
    period: lengths of the transforms [pixel]. slope: tangent of the field angle per pixel.
    models: stage -> what is modelled, and why; left_out: what is not. predicted: named error bounds.
    """

    scene: Scene
    camera: Camera
    weights: np.ndarray
    white_rate: np.ndarray | None
    table: np.ndarray | None
    gains: np.ndarray | None
    table_spectra: np.ndarray | None
    q: np.ndarray
    period: tuple[int, int]
    slope: float
    bytes_needed: int
    models: dict = field(default_factory=dict)
    left_out: list = field(default_factory=list)
    predicted: dict = field(default_factory=dict)


def plan(scene: Scene, camera: Camera, fft_length, reach: int = BORDER_REACH) -> Plan:
    """Decide how `scene` is seen by `camera`.

    fft_length: function that gives the next transform length of the kernels. reach: pixels of surroundings on each side
    that take part in the blur. A dark world (border "zero") gets at least half the frame, so that no light of the frame
    comes back on its other side.
    Raises BadData when their wavelengths do not overlap, OutOfRange when the pixels are far too coarse for the lens.
    """
    optics, sensor = camera.optics, camera.sensor
    nodes, content = scene.wavelengths, scene.content
    area = sensor.pixel_pitch**2 * sensor.fill_factor
    factors = [scene.illuminant, sensor.qe]
    constant = area * optics.irradiance_factor
    if isinstance(optics.transmission, Spectrum):
        factors.append(optics.transmission)
    else:
        constant *= optics.transmission
    try:
        weights = constant * product_weights(nodes, *factors)
    except BadData as error:
        raise BadData(f"{scene.name} by {camera.name}: {error}") from None
    if not (weights > 0).any():
        raise BadData(f"{scene.name}: camera {camera.name} sees none of its light "
                      f"({nodes[0]:g} .. {nodes[-1]:g} nm)")

    spectra = _entry_spectra(content)
    rows, cols = (n + 2 * scene.margin for n in scene.shape)
    reaches = [max(reach, -(-n // 2) if scene.border == "zero" else 0) for n in (rows, cols)]
    period = tuple(fft_length(n + 2 * more) for n, more in zip((rows, cols), reaches, strict=True))
    models, left_out = {}, []
    stage = "spectral.materials" if isinstance(content, Materials) else "spectral.integrate"
    form = type(content).__name__.lower()
    if optics.model == "none":
        table, gains, table_spectra = weights @ spectra.T, None, None
        models[stage] = f"{form} of {len(spectra)} entries straight to {len(weights)} channels (no blur to apply)"
        left_out.append('diffraction: optics.model is "none"')
    elif not isinstance(content, Cube) and 2 * len(spectra) <= len(nodes):
        # Few entries: transform those; each channel's transfer function of an entry sums over the wavelengths.
        table = np.eye(len(spectra)) if isinstance(content, Materials) else None
        gains, table_spectra = np.ones((len(weights), len(spectra))), spectra
        models["optics.blur"] = f"exact per band, {len(spectra)} {form} planes transformed in place of {len(nodes)}"
    else:
        table = None if isinstance(content, Cube) else spectra.T
        gains, table_spectra = weights, None
        models["optics.blur"] = f"exact per band, {len(nodes)} wavelengths"
    if gains is not None:
        if table is not None:
            models[stage] = f"{form} of {len(spectra)} entries to {len(table)} planes"
        models["optics.airy"] = "diffraction-limited circular pupil, integrated over the pixel"
    working = optics.working_f_number
    q = nodes * 1e-9 * working / sensor.pixel_pitch
    slope = 0.0
    if optics.relative_illumination == "cos4":
        slope = (2 * np.tan(scene.fov / 2) / scene.shape[1] if scene.fov
                 else sensor.pixel_pitch / optics.image_distance)
    else:
        left_out.append('relative illumination: set to "none"')
    models["sensor.expose"] = f"{'cos^4, ' if slope else ''}mosaic of {'/'.join(sensor.cfa)}"
    predicted = {}
    if gains is not None:
        predicted["kernel energy beyond the surroundings"] = _energy_beyond(min(reaches), q.max())
        if q.min() < SMALLEST_Q:
            raise OutOfRange(f"{camera.name}: wavelength x f-number / pixel pitch", f"{q.min():.2g}",
                             f'>= {SMALLEST_Q}; such a blur is a fraction of a pixel: use optics model = "none"')
    unseen = sensor.qe.wavelengths[(sensor.qe.values > 0.01).any(axis=0)]
    if unseen[0] < nodes[0] - 1 or unseen[-1] > nodes[-1] + 1:
        left_out.append(f"light outside the scene's {nodes[0]:g} .. {nodes[-1]:g} nm, which the sensor would see")
    left_out += ["scene structure finer than a pixel: one scene sample per pixel", "distortion", "field-varying blur",
                 *(["depth: blur is the same at all distances"] if scene.depth is not None else [])]
    needed = _bytes(rows, cols, period, content, table, gains, table_spectra, len(nodes), len(weights))
    white_rate = weights.sum(axis=1) if scene.light_is_known else None
    return Plan(scene, camera, weights, white_rate, table, gains, table_spectra, q, period, float(slope), needed,
                models, left_out, predicted)


def _entry_spectra(content):
    """Spectrum of one unit of each entry of the content, shape (entries, L)."""
    if isinstance(content, Cube):
        return np.eye(len(content.wavelengths))
    return np.asarray(content.basis if isinstance(content, Basis) else content.spectra, np.float64)


def _energy_beyond(radius, q):
    """Share of an Airy pattern's energy beyond `radius` [pixel]: J0(v)^2 + J1(v)^2, v = pi r / q (Rayleigh 1881)."""
    v = np.pi * radius / q
    return float(j0(v) ** 2 + j1(v) ** 2)


def _bytes(rows, cols, period, content, table, gains, table_spectra, bands, channels):
    """Device memory of a frame [byte], the arrays that live at the same time added up."""
    frame, padded = rows * cols, prod(period)
    quarter = (period[0] // 2 + 1) * (period[1] // 2 + 1)
    if isinstance(content, Materials):
        stored = 6 * frame
    else:
        stored = 4 * (content.values if isinstance(content, Cube) else content.coefficients).size
    total = stored + frame * (4 * channels + 4 + 2 + 12 + 3)
    if gains is not None:
        planes = gains.shape[1]
        total += 4 * frame * (planes if table is not None else 0)
        total += 4 * quarter * (bands + (channels * planes if table_spectra is not None else 0))
        total += 8 * padded * (2 * min(planes, 8) + 2 * channels)  # spectra and scratch, sums and their inverse
    return total

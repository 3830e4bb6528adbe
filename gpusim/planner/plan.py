"""From a scene and a camera to what is computed: host float64 mathematics, no device."""

from dataclasses import dataclass, field
from math import prod

import numpy as np
from scipy.special import j0, j1

from gpusim.data.reflectances import reflectances
from gpusim.domain.camera import Camera
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import Basis, Cube, Materials, Scene
from gpusim.domain.spectrum import Spectrum
from gpusim.domain.tolerance import Tolerance
from gpusim.planner.fusion import PREDICTION_FACTOR, SAMPLED_PERIOD, Response, Spectra, channel_operator, joint_operator
from gpusim.planner.highlights import TRANSFORM_ERROR, Highlights, split_highlights
from gpusim.planner.weights import product_weights

BORDER_REACH = 64  # [pixel] of surroundings on each side that take part in the blur, unless more are asked for
SMALLEST_Q = 0.05  # below it the transfer tables are sums over thousands of replicas
PRIOR = ("munsell", "dupont", "objects", "skin", "colorchecker-sg")  # reflectances held likely before a cube is seen
# Local over relative RMS error where the noise is that of the RMS level: the 99.9 % quantile was at most 27 and the
# maximum at most 48 over dead leaves, charts and edges of ranks 3 to 7; both with room for larger frames.
QUANTILE_SIGMAS, MAXIMUM_SIGMAS = 40.0, 100.0


@dataclass(frozen=True, eq=False)
class Plan:
    """What a frame of `scene` by `camera` takes; every array is float64.

    weights: electrons per second in each channel for content 1 at each of the scene's wavelengths, shape (C, L).
    white_rate: electrons per second that a perfect white diffuser gives in each channel, on axis, shape (C,); None
        when the scene's light is unknown.
    table: planes from content entries (bands, basis coefficients or materials), shape (planes, entries), or None where
        the content's own planes are used.
    gains: channels from blurred planes, shape (C, planes); without blur the planes are the channels and it is None.
    transfers: weight of each wavelength's transfer function in that of a plane in a channel, shape (C, planes, L), or
        None where each plane is one wavelength.
    content: the scene's, without its highlights. highlights: these, or None.
    folded: whether the blur gives the mosaic at once, in transforms of its phases.
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
    transfers: np.ndarray | None
    content: Cube | Basis | Materials
    highlights: Highlights | None
    folded: bool
    q: np.ndarray
    period: tuple[int, int]
    slope: float
    bytes_needed: int
    models: dict = field(default_factory=dict)
    left_out: list = field(default_factory=list)
    predicted: dict = field(default_factory=dict)


def plan(scene: Scene, camera: Camera, transform_lengths, transfer_tables, tolerance: Tolerance | None = None,
         guaranteed: bool = False, reach: int = BORDER_REACH) -> Plan:
    """Decide how `scene` is seen by `camera`.

    transform_lengths: function of the least (rows, cols) and the mosaic's period that gives the kernels' transform
    lengths, and whether the mosaic folds into them. transfer_tables: function of q (L,), the aperture's width, rows and
    cols that gives the quarter tables of all wavelengths in float64, (L, rows // 2 + 1, cols // 2 + 1).
    tolerance: wavelengths are fused into the fewest planes whose predicted error meets it; without one each is exact.
    guaranteed: choose the planes for the worst spectrum there can be, not for likely ones.
    reach: pixels of surroundings on each side that take part in the blur. A dark world (border "zero") gets at least
    half the frame, so that no light of the frame comes back on its other side.
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
    period, folded = transform_lengths([n + 2 * more for n, more in zip((rows, cols), reaches, strict=True)],
                                       np.shape(sensor.cfa_indices))
    folded &= not sensor.is_monochrome and optics.is_symmetric  # the folding stage takes real tables
    working = optics.working_f_number
    q = nodes * 1e-9 * working / sensor.pixel_pitch
    if optics.model != "none" and q.min() < SMALLEST_Q:
        raise OutOfRange(f"{camera.name}: wavelength x f-number / pixel pitch", f"{q.min():.2g}",
                         f'>= {SMALLEST_Q}; such a blur is a fraction of a pixel: use optics model = "none"')
    models, left_out, predicted, highlights = {}, [], {}, None
    blur = "optics.mosaic" if folded else "optics.blur"
    stage = "spectral.materials" if isinstance(content, Materials) else "spectral.integrate"
    form = type(content).__name__.lower()
    if optics.model == "none":
        table, gains, transfers = weights @ spectra.T, None, None
        models[stage] = f"{form} of {len(spectra)} entries straight to {len(weights)} channels (no blur to apply)"
        left_out.append('diffraction: optics.model is "none"')
    else:
        if optics.is_ideal:  # the points' kernels are Airy's
            content, highlights = split_highlights(content, weights, q.max(), scene.margin)
        table, gains, transfers, models[blur] = _exact(content, weights, spectra)
        error = 0.0
        if tolerance is not None and optics.is_symmetric:  # the operator is made of real tables
            tables = transfer_tables(q, np.sqrt(sensor.fill_factor), SAMPLED_PERIOD, SAMPLED_PERIOD)
            response = Response.of(weights, tables, sensor.cfa_indices)
            fused = (_guaranteed if guaranteed else _fused)(scene, content, response, gains.shape[1],
                                                            _limit(tolerance, sensor, response, content))
            if fused:
                inputs, transfers, error, models[blur] = fused
                table, gains = inputs @ spectra.T, np.ones(transfers.shape[:2])
        predicted["relative rms"] = float(np.hypot(error, TRANSFORM_ERROR))
    if gains is not None:
        if table is not None:
            models[stage] = f"{form} of {len(spectra)} entries to {len(table)} planes"
        if optics.is_ideal:
            models["optics.airy"] = "diffraction-limited circular pupil, integrated over the pixel"
        else:
            models["optics.pupil"] = f"{optics.description}, integrated over the pixel"
        models[blur] += ", folded into the mosaic" if folded else ""
    if highlights is not None:
        models["optics.splat"] = f"{len(highlights.places)} highlights added exactly, each with its own spectrum"
        if highlights.residue:
            predicted["local error beside further highlights"] = highlights.residue
    slope = 0.0
    if optics.relative_illumination == "cos4":
        slope = (2 * np.tan(scene.fov / 2) / scene.shape[1] if scene.fov
                 else sensor.pixel_pitch / optics.image_distance)
    else:
        left_out.append('relative illumination: set to "none"')
    models["sensor.expose"] = f"{'cos^4, ' if slope else ''}mosaic of {'/'.join(sensor.cfa)}"
    if gains is not None:
        if optics.is_ideal:
            predicted["kernel energy beyond the surroundings"] = _energy_beyond(min(reaches), q.max())
    unseen = sensor.qe.wavelengths[(sensor.qe.values > 0.01).any(axis=0)]
    if unseen[0] < nodes[0] - 1 or unseen[-1] > nodes[-1] + 1:
        left_out.append(f"light outside the scene's {nodes[0]:g} .. {nodes[-1]:g} nm, which the sensor would see")
    left_out += ["scene structure finer than a pixel: one scene sample per pixel", "distortion", "field-varying blur",
                 *(["depth: blur is the same at all distances"] if scene.depth is not None else [])]
    needed = _bytes(rows, cols, period, content, table, gains, transfers, len(nodes), len(weights),
                    1 if optics.is_symmetric else 4)
    white_rate = weights.sum(axis=1) if scene.light_is_known else None
    return Plan(scene, camera, weights, white_rate, table, gains, transfers, content, highlights, folded, q, period,
                float(slope), needed, models, left_out, predicted)


def _exact(content, weights, spectra):
    """Table, gains, transfers and description of the plan that treats every band, or every entry, by itself."""
    if not isinstance(content, Cube) and 2 * len(spectra) <= len(content.wavelengths):
        # Few entries: transform those; each channel's transfer function of an entry sums over the wavelengths.
        table = np.eye(len(spectra)) if isinstance(content, Materials) else None
        form = type(content).__name__.lower()
        return (table, np.ones((len(weights), len(spectra))), weights[:, None] * spectra,
                f"exact per band, {len(spectra)} {form} planes transformed in place of {len(weights[0])}")
    table = None if isinstance(content, Cube) else spectra.T
    return table, weights, None, f"exact per band, {len(weights[0])} wavelengths"


def _limit(tolerance, sensor, response, content):
    """Relative RMS error that keeps every bound of the tolerance.

    The noise's sigma at the RMS level is at most the root of that level, which is below saturation; an exposure
    time that is given tells it better.
    """
    level = sensor.saturation
    if sensor.exposure_time is not None:
        values = Spectra.of(content).values
        signal = np.einsum("cl,lm,cm->c", response.flat, values, response.flat)
        level = sensor.exposure_time * np.sqrt(response.share @ signal)
    sigmas = np.sqrt(max(level, 1.0))
    bounds = [(tolerance.rms, 1.0), (tolerance.p999_sigma, QUANTILE_SIGMAS * sigmas),
              (tolerance.max_sigma, MAXIMUM_SIGMAS * sigmas)]
    return min(bound / factor for bound, factor in bounds if bound is not None)


def _fused(scene, content, response, planes, limit):
    """The joint operator of the lowest rank predicted to keep `limit`; None where `planes` exact ones do as well.

    Prior: the reflectances of PRIOR where a cube's light is known, so that all frames of a film share the operator;
    otherwise the scene's own spectra. The error is predicted for the scene's own spectra whatever the prior: what lies
    outside the prior is seen, and raises the rank.
    """
    own = Spectra.of(content)
    if isinstance(content, Cube) and scene.light_is_known:
        likely = np.vstack([reflectances(name).at(content.wavelengths, outside=None) for name in PRIOR])
        prior = likely.T @ likely / len(likely)
    else:
        prior = own.values
    if not np.trace(prior) > 0:
        return None
    operator = joint_operator(response, prior)
    for rank in operator.ranks:
        error = operator.predicted(rank, own)
        if rank >= planes:
            break
        if PREDICTION_FACTOR * error < limit:
            return (operator.w_in[:, :rank].T, operator.transfers(rank), error,
                    f"joint spectral operator of rank {rank} in place of {len(content.wavelengths)} wavelengths")
    return None


def _guaranteed(scene, content, response, planes, limit):
    """The operator of fewest planes a channel whose bound over all spectra keeps `limit`; None: exact is as cheap."""
    channels = len(response.weights)
    for count in range(1, (planes - 1) // channels + 1):
        operator = channel_operator(response, count)
        if operator.bound < limit:
            return (operator.table, operator.transfers, operator.bound,
                    f"{count} planes a channel, right for every spectrum, in place of {len(content.wavelengths)}")
    return None


def _entry_spectra(content):
    """Spectrum of one unit of each entry of the content, shape (entries, L)."""
    if isinstance(content, Cube):
        return np.eye(len(content.wavelengths))
    return np.asarray(content.basis if isinstance(content, Basis) else content.spectra, np.float64)


def _energy_beyond(radius, q):
    """Share of an Airy pattern's energy beyond `radius` [pixel]: J0(v)^2 + J1(v)^2, v = pi r / q (Rayleigh 1881)."""
    v = np.pi * radius / q
    return float(j0(v) ** 2 + j1(v) ** 2)


def _bytes(rows, cols, period, content, table, gains, transfers, bands, channels, parts):
    """Device memory of a frame [byte], the arrays that live at the same time added up.

    parts: size of a transfer table over that of a real quarter.
    """
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
        total += 4 * parts * quarter * (bands + (channels * planes if transfers is not None else 0))
        total += 8 * padded * (2 * min(planes, 8) + 2 * channels)  # spectra and scratch, sums and their inverse
    return total

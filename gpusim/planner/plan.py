"""From a scene and a camera to what is computed: host float64 mathematics, no device."""

from dataclasses import dataclass, field, replace
from functools import cache, lru_cache, partial
from math import ceil, prod

import numpy as np
from scipy.special import j0, j1

from gpusim.data.reflectances import reflectances
from gpusim.domain.camera import Camera
from gpusim.domain.content import Content
from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.scene import Scene
from gpusim.domain.spectrum import Spectrum
from gpusim.domain.tolerance import Tolerance
from gpusim.optics.lens import open_lens, spread_radius, wavelength_nodes
from gpusim.planner.border import Outside, blurred_level, broken, enough_reach, most_reach, rule_of, tail_of
from gpusim.planner.depth import DepthPlan, plan_depth
from gpusim.planner.differences import Differences
from gpusim.planner.drift import Watch
from gpusim.planner.facts import Facts
from gpusim.planner.field import FieldBlur, choose
from gpusim.planner.fusion import PREDICTION_FACTOR, SAMPLED_PERIOD, Response, channel_operator, joint_operator
from gpusim.planner.geometry import (
    DistortionGrid,
    distortion_grid,
    microlens_gain,
    relative_illumination,
    vignetting_gain,
)
from gpusim.planner.highlights import THRESHOLD, TRANSFORM_ERROR, Highlights, split_highlights, unsplit_error
from gpusim.planner.sampling import (
    AREA,
    NODES,
    SPARE,
    Taps,
    bordered,
    frame_start,
    pixel_response,
    pixel_taps,
    sampling_error,
)
from gpusim.planner.weights import product_weights

BORDER_REACH = 64  # [pixel] of surroundings on each side that take part in the blur, unless a tolerance needs more
LONGEST = 2**15  # samples of a transform along an axis
FIELD_TOLERANCE = 5e-4  # relative RMS error of a field-varying blur where no tolerance is asked for
# Rows and columns of field points, 1 the frame's border, whose responses stand for the field's
FIELD_POINTS = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.5), (0.0, 0.9), (0.9, 0.9))
FFT_FREE_ERROR = 2e-4  # relative RMS of the pyramid's kernels: 1.2e-4 .. 2.0e-4 at f/2.8 and 1.4 um on natural scenes
MOST_PLANES = 6  # a channel, of a field-varying blur
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
    flat: what a flat field of each wavelength gives where every sample is a point of light of 1, shape (L,).
    table: planes from content entries (bands, basis coefficients or materials), shape (planes, entries), or None where
        the content's own planes are used.
    mix: channels from blurred planes, shape (C, planes); without blur the planes are the channels and it is None.
    transfers: weight of each wavelength's transfer function in that of a plane in a channel, shape (C, planes, L), or
        None where each plane is one wavelength.
    content: the scene's, without its highlights. highlights: these, or None.
    varying: what the blur has more than that on the axis, where it varies over the field; else None. The planes are
        then each one channel's, and transfers has the shape (1, planes, L).
    depth: how the blur goes by the distance of things, where the scene tells it; else None.
    distortion: where the lens puts the samples, None: where a pinhole would.
    falloff: of every pixel, shape (rows, cols), where it is more than the cos^4 law of a grid of pixels in the middle.
    folded: whether the blur gives the mosaic at once, in transforms of its phases. fft_free: whether it has none.
    taps: weights of the scene's samples in the rows and columns of pixels, None where each pixel is one sample.
    spare: blurred samples around the scene's that they use.
    q: wavelength times working f-number over the distance of samples at each wavelength, shape (L,).
    period: lengths of the transforms [sample]. slope: tangent of the field angle per pixel.
    watch: tells whether the planes that wavelengths are fused into still do for other contents, None where any content
        does. limit: relative RMS error that they keep, None without a tolerance.
    models: stage -> what is modelled, and why; left_out: what is not. predicted: named error bounds.
    not_met: the bound of the tolerance that a predicted error breaks, with both figures; "" for none.
    planned_for: name of the scene of the same kind that it was made for, if that is another; most predicted errors are
        of that one then.
    """

    scene: Scene
    camera: Camera
    weights: np.ndarray
    white_rate: np.ndarray | None
    flat: np.ndarray
    table: np.ndarray | None
    mix: np.ndarray | None
    transfers: np.ndarray | None
    content: Content
    highlights: Highlights | None
    varying: FieldBlur | None
    depth: DepthPlan | None
    distortion: DistortionGrid | None
    falloff: np.ndarray | None
    folded: bool
    fft_free: bool
    taps: tuple[Taps, Taps] | None
    spare: int
    q: np.ndarray
    period: tuple[int, int]
    slope: float
    bytes_needed: int
    watch: Watch | None = None
    limit: float | None = None
    models: dict = field(default_factory=dict)
    left_out: list = field(default_factory=list)
    predicted: dict = field(default_factory=dict)
    not_met: str = ""
    planned_for: str = ""


    def serves(self, scene: Scene) -> bool:
        """Whether it also says how to make a frame of another scene: of the same kind, and nothing here is of pixels.

        Its predicted errors are those of its own scene then.
        """
        own = self.scene
        if any(part is not None for part in (self.highlights, self.varying, own.depth, scene.depth)):
            return False
        light, its = own.illuminant, scene.illuminant
        return (own.content.is_like(scene.content) and own.content.shape == scene.content.shape
                and (light is its or (np.array_equal(light.values, its.values)
                     and np.array_equal(light.wavelengths, its.wavelengths)))
                and all(getattr(own, name) == getattr(scene, name)
                        for name in ("border", "margin", "fov", "samples_per_pixel")))

    def drift(self, survey) -> float | None:
        """Relative RMS error of the fused planes for a scene that this serves, by `spectral.survey`; None if exact."""
        return None if self.watch is None or survey is None else self.watch.error(survey)

    def fits(self, light, drift: float | None) -> bool:
        """Whether it is as right for a scene that it serves as it was to be for its own.

        light: statistics of the scene's mean electrons, see `sensor.meter`. drift: what `drift` says of it. What is up
        to THRESHOLD times the mean is no highlight: the transforms' error beside it is below 10 of TRANSFORM_ERROR
        times the mean.
        """
        highest, mean = light[:2]
        if self.mix is not None and highest > THRESHOLD * mean:
            return False
        return drift is None or PREDICTION_FACTOR * drift < (self.limit or np.inf)

    def of(self, scene: Scene, drift: float | None) -> "Plan":
        """The same as that of another scene that it serves; drift: see `drift`."""
        known = {} if drift is None else {"relative rms": float(np.hypot(drift, TRANSFORM_ERROR))}
        return replace(self, scene=scene, planned_for=self.scene.name, predicted=self.predicted | known)


def plan(scene: Scene, camera: Camera, transform_lengths, fft_length, transfer_tables,
         tolerance: Tolerance | None = None, guaranteed: bool = False, reach: int | None = None,
         fft_free: bool = False, period: tuple[int, int] | None = None,
         keep=lambda _, __, make: make(), facts: Facts | None = None) -> Plan:
    """Decide how `scene` is seen by `camera`.

    transform_lengths: function of the least (rows, cols) and the mosaic's period that gives the kernels' transform
    lengths, and whether the mosaic folds into them. fft_length: function of a least length that gives the next one
    that the kernels transform. transfer_tables: function of q (L,), the aperture's height and width (or one number for
    a square), rows, cols, how many samples there are to a pixel and, where it is not 0, how far the apertures are
    displaced from them, that gives the tables of all wavelengths in float64: quarters, (L, rows // 2 + 1, cols // 2 +
    1), or halves as `optics.blur` takes them.
    tolerance: wavelengths are fused into the fewest planes whose predicted error meets it; without one each is exact.
    guaranteed: choose the planes for the worst spectrum there can be, not for likely ones.
    reach: pixels of surroundings on each side that take part in the blur, by default BORDER_REACH or what the tolerance
    needs, if that is not too much (`most_reach`). fft_free: blur by pyramids of separable kernels in place of
    transforms. period: of the transforms [sample], for the reference: no mosaic is folded and no highlight split off
    then. keep: function (what, key, make) that may give what make() gave before for the same key. facts: of the scene,
    where they were read before.
    A dark world (border "zero") gets at least half the frame, so that what comes back on the other side of the frame
    comes from a frame's width away or more. That is part of the predicted border error.
    Raises BadData when their wavelengths do not overlap, OutOfRange when the sensor's curves do not cover the light,
    when the pixels are far too coarse for the lens, and for a displaced grid that the blur asked for cannot honour.
    """
    optics, sensor = camera.optics, camera.sensor
    facts = Facts.of(scene) if facts is None else facts
    nodes, content, depth = scene.wavelengths, facts.content, facts.depth
    area = prod(sensor.aperture)
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

    _check_light(scene, content, camera)
    spectra = content.entry_spectra
    ratio, blurred = float(scene.samples_per_pixel), optics.model != "none"
    aperture = tuple(side / sensor.pixel_pitch for side in sensor.aperture)
    cell = aperture if ratio == 1 else (1.0, 1.0)  # height and width over which blurred samples are integrated
    displacement = _checked_displacement(scene, sensor, blurred, fft_free)
    moved = displacement if ratio == 1 and blurred else (0.0, 0.0)  # by the blur; else by the taps
    more = ceil(ratio * max(map(abs, displacement)))  # samples beyond the frame that it sees
    rows, cols = (n + 2 * scene.margin for n in scene.samples)
    working = optics.working_f_number
    q = nodes * 1e-9 * working / (sensor.pixel_pitch / ratio)
    if blurred and q.min() < SMALLEST_Q:
        step = "pixel pitch" if ratio == 1 else "distance of scene samples"
        raise OutOfRange(f"{camera.name}: wavelength x f-number / {step}", f"{q.min():.2g}",
                         f'>= {SMALLEST_Q}; such a blur is a fraction of a pixel: use optics model = "none"')
    limit, level = (None, sensor.saturation) if tolerance is None else _limit(tolerance, sensor, weights, facts)
    brightness = facts.brightness(weights.sum(axis=0))
    mean_q = float(np.average(q, weights=weights.sum(axis=0)))
    size = blurred_level(brightness, mean_q, scene.margin) if blurred else 0.0
    highlights, ideal = None, optics.is_ideal and not optics.varies and optics.distortion is None and depth is None
    # the points' kernels are Airy patterns integrated over a square that the point is in the middle of
    if (blurred and not period and ideal and cell[0] == cell[1] and not any(moved)
            and (ratio > 1 or not sensor.stacked)):
        content, highlights = split_highlights(content, brightness, q.max(), scene.margin, rule_of(scene.border))
        facts = facts if highlights is None else Facts(content)
    by_depth, without = _by_depth(scene, facts, optics, sensor.pixel_pitch / ratio, weights, limit)
    spread = by_depth.reach if by_depth else spread_radius(optics, nodes, sensor.pixel_pitch / ratio) if blurred else 0

    def lengths(least):
        return (period, False) if period else transform_lengths(least, np.shape(sensor.cfa_indices))

    outside = Outside(brightness, scene.border, scene.margin, tail_of(optics) * mean_q if blurred and not period else 0,
                      spread, size, max(sensor.read_sigma**2, 1) / level, highlights.missing if highlights else 0.0)
    beside = (ceil(by_depth.reach) if by_depth else 0) + more
    least = 0  # spreads that are given end: the frame sees as far as they go, if they fit into its transforms at all
    if optics.psf and 2 * spread <= min(rows, cols) + 2 * BORDER_REACH * ratio:
        least = ceil(spread / ratio)
    reaches, own_period, folded, border, not_met = _surroundings(
        outside, lengths, ratio, beside, reach, least, tolerance, level)
    if limit is not None:  # what the border takes is not left for the planes
        limit = np.sqrt(max(limit**2 - border**2, limit**2 / 2))
    folded &= ratio == 1 and not sensor.is_monochrome and not sensor.stacked
    folded &= optics.is_symmetric and not optics.varies and not any(moved)
    if None in own_period:
        raise OutOfRange("scene size with surroundings", f"{cols + 2 * reaches[1]} x {rows + 2 * reaches[0]} samples",
                         "what the transforms take: a smaller scene, reach or aperture")
    folded &= by_depth is None  # layers are laid over one another channel by channel
    flat = np.ones(len(nodes))
    slow = optics.psf is None and not optics.is_symmetric
    tables_of = partial(_quick_tables, optics, sensor.pixel_pitch) if slow else transfer_tables
    models, left_out, predicted, varying = {}, [], {}, None
    taps, spare, watch = None, 0, None
    if ratio > 1 or (more and not blurred):
        # the blur knows what is beyond the scene's samples; a picture without blur is constant over each of them
        if blurred and not fft_free:
            spare = min(SPARE + more, *((n - m) // 2 for n, m in zip(own_period, (rows, cols), strict=True)))
        taps = (_blurred_axes if blurred else _plain_axes)(scene, ratio, aperture, displacement, spare)
        models["optics.sample"] = (f"{ratio:.4g} sample{'' if ratio == 1 else 's'} per pixel, integrated over its "
                                   f"aperture{_displaced(displacement)}")
    if fft_free and blurred:
        if optics.varies or by_depth is not None or not optics.is_symmetric:
            raise OutOfRange("fft_free", f"{optics.description}{', by depth' if by_depth is not None else ''}",
                             "a blur that is the same all over the frame and at every angle")
        folded = False
    blur = "optics.nearfar" if fft_free else "optics.mosaic" if folded else "optics.blur"
    stage = "spectral.materials" if content.labels is not None else "spectral.integrate"
    form = content.form
    if not blurred:
        table, mix, transfers = weights @ spectra.T, None, None
        models[stage] = f"{form} of {len(spectra)} entries straight to {len(weights)} channels (no blur to apply)"
        left_out.append('diffraction, lateral colour: optics.model is "none"' if np.any(optics.lateral_color_at(nodes))
                        else 'diffraction: optics.model is "none"')
    else:
        if highlights is None and (left := unsplit_error(brightness)):
            predicted["local error beside highlights"] = left
        if min(cell) < 1:  # points in the middle of the apertures would count too much of a flat scene
            flat = _tables(transfer_tables, q, cell, 1, ratio, moved)[:, 0, 0].real
        even = weights / flat
        table, mix, transfers, models[blur] = _exact(content, even, spectra)
        wrong = 0.0
        if optics.varies or limit is not None:
            corner = float(np.hypot(*scene.samples)) / 2
            lens = open_lens(optics, sensor.pixel_pitch / ratio, cell, scene.samples, moved)
            if optics.is_symmetric and not optics.varies:
                tables = _tables(transfer_tables, q, cell, SAMPLED_PERIOD, ratio, moved)
            else:
                half = np.array(scene.samples) / 2 / corner
                tables = _sampled(lens, nodes, half * FIELD_POINTS if optics.varies else FIELD_POINTS[:1])
                tables *= flat.reshape(-1, *[1] * (tables.ndim - 1))
            if taps is not None:  # what the pixels average out is no error
                fx = np.arange(SAMPLED_PERIOD // 2 + 1) / SAMPLED_PERIOD
                fy = np.fft.fftfreq(SAMPLED_PERIOD) if tables.shape[-2] > len(fx) else fx
                tables = tables * pixel_response(taps, fy, fx)
            response = keep("response", (even, tables, sensor.cfa_indices),
                            lambda: Response.of(even, tables, sensor.cfa_indices))
        if optics.varies:
            inputs, transfers, mix, varying, wrong, models[blur] = _varying(
                scene, facts, response, guaranteed, lens, flat, (rows, cols), corner, limit or FIELD_TOLERANCE,
                fft_length, keep)
            table = inputs @ spectra.T
            models["optics.field"] = varying.report
            predicted["field at the worst place"] = varying.error[1]
        elif limit is not None:
            fused = (_guaranteed if guaranteed else _fused)(scene, facts, response, mix.shape[1], limit, keep)
            if fused:
                inputs, transfers, wrong, models[blur] = fused
                watch = None if guaranteed else Watch.of(response, inputs, transfers, content)
                table, mix = inputs @ spectra.T, np.ones(transfers.shape[:2])
        predicted["relative rms"] = float(np.hypot(wrong, FFT_FREE_ERROR if fft_free else TRANSFORM_ERROR))
    over = f"the pixel{_displaced(moved)}" if ratio == 1 else "each scene sample"
    if mix is not None:
        if table is not None:
            models[stage] = f"{form} of {len(spectra)} entries to {len(table)} planes"
        if optics.is_ideal and by_depth is None and not any(moved):
            models["optics.airy"] = f"diffraction-limited circular pupil, integrated over {over}"
        else:
            models["optics.pupil"] = f"{optics.description}, integrated over {over}"
        if transfers is not None:
            models.setdefault("spectral.integrate", f"tables of {len(nodes)} wavelengths to those of the planes")
        models[blur] += ", folded into the mosaic" if folded else ", without transforms" if fft_free else ""
    if by_depth is not None:
        models["optics.composite"] = by_depth.model
        predicted |= by_depth.predicted
        if by_depth.layers > 1 and not by_depth.sheets:
            left_out.append("what nearer things hide: one picture does not tell it, so what is beside it goes on there")
    if highlights is not None:
        models["optics.splat"] = f"{len(highlights.places)} highlights added exactly, each with its own spectrum"
        if highlights.residue:
            predicted["local error beside further highlights"] = highlights.residue
    distortion = None
    if optics.distortion is not None:
        seen = scene.samples if mix is None else (rows, cols)
        distortion = distortion_grid(optics.distortion, seen, sensor.pixel_pitch / ratio, (rows, cols))
        models["optics.distort"] = f"distortion: {distortion.report}"
    slope, falloffs = 0.0, {}
    if optics.relative_illumination == "cos4":
        slope = (2 * np.tan(scene.fov / 2) * ratio / scene.samples[1] if scene.fov
                 else sensor.pixel_pitch / optics.image_distance)
        if any(displacement):  # the law that goes with the exposure is that of a grid in the middle
            falloffs["cos^4"] = relative_illumination("cos4", scene.shape, slope, 1.0, displacement=displacement)
            slope = 0.0
    elif optics.relative_illumination == "none":
        left_out.append('relative illumination: set to "none"')
    else:
        falloffs["relative illumination as given"] = relative_illumination(
            optics.relative_illumination, scene.shape, sensor.pixel_pitch, optics.image_distance,
            displacement=displacement)
    if sensor.microlens is not None:
        falloffs["microlenses"] = microlens_gain(sensor.microlens, scene.shape, sensor.pixel_pitch,
                                                 optics.image_distance, displacement)
    if sensor.vignetting is not None:
        falloffs["pixel vignetting"] = vignetting_gain(sensor.vignetting, scene.shape, displacement)
    falloff = np.prod(list(falloffs.values()), axis=0) if falloffs else None
    if falloffs:
        models["optics.falloff"] = " and ".join(falloffs)
    layout = f"stacked {', '.join(sensor.channels)}" if sensor.stacked else f"mosaic of {'/'.join(sensor.cfa)}"
    models["sensor.collect"] = f"{'cos^4, ' if slope else ''}{layout}"
    if mix is not None:
        predicted["border"] = border
        if tolerance is None and border > TRANSFORM_ERROR:
            left_out.append(f"the world more than {min(reaches) / ratio:.4g} pixels outside the frame, seen as the "
                            f"transforms repeat it: relative rms {border:.2g}, predicted")
        if optics.is_ideal:
            predicted["kernel energy beyond the surroundings"] = _energy_beyond(min(reaches), q.max())
    unseen = sensor.qe.wavelengths[(sensor.qe.values > 0.01).any(axis=0)]
    if unseen[0] < nodes[0] - 1 or unseen[-1] > nodes[-1] + 1:
        left_out.append(f"light outside the scene's {nodes[0]:g} .. {nodes[-1]:g} nm, which the sensor would see")
    share = np.bincount(np.ravel(sensor.cfa_indices), minlength=len(weights)) / sensor.cfa_indices.size
    predicted["scene sampling"] = sampling_error(facts.moments(weights), weights, q, share, ratio, aperture, taps,
                                                 None if mix is None else tables_of, moved)
    left_out += [f"scene structure finer than {'a' if ratio == 1 else f'{1 / ratio:.3g}'} pixel: {ratio:.4g} scene "
                 f"sample{'' if ratio == 1 else 's'} per pixel",
                 *([f"depth: {without}, so the blur is the same at all distances"] if without else [])]
    stored = max(content.nbytes, scene.content.nbytes)  # of a picture the codes, too
    needed = _bytes(rows, cols, own_period, stored, table, mix, transfers, len(nodes), len(weights),
                    1 if optics.is_symmetric and not any(moved) else 4)
    if by_depth is not None:  # every kernel's and layer's light and coverage, and the copies that are laid together
        needed += 16 * len(weights) * rows * cols * len(by_depth.kernels) * by_depth.layers
    if varying is not None:
        needed += 20 * rows * cols * varying.convolutions  # maps in float64 and float32, planes times maps, spectra
        needed += varying.bytes_of_tiles(fft_length, len(weights))
    white_rate = weights.sum(axis=1) if scene.light_is_known else None
    return Plan(scene, camera, weights, white_rate, flat, table, mix, transfers, content, highlights, varying,
                by_depth, distortion, falloff, folded, fft_free, taps, spare, q, own_period, float(slope), needed,
                watch, limit, models, left_out, predicted, not_met)


def _surroundings(outside, lengths, ratio, beside, reach, least, tolerance, level):
    """How much of the world takes part in the blur.

    outside: `Outside` of the scene. lengths: function of the least (rows, cols), see `plan`. ratio: samples per pixel.
    beside: samples that take part beside the reach. reach: [pixel] asked for, or None: BORDER_REACH or `least`, and
    what the tolerance needs. Returns surroundings along each axis [sample], the transforms' lengths, whether the mosaic
    folds into these, the border's relative RMS error, and the bound that it breaks.
    """
    shape = outside.image.shape

    def transform(reach):
        around = ceil(reach * ratio) + beside
        reaches = [max(around, -(-n // 2) if outside.border == "zero" else 0) for n in shape]
        return reaches, *lengths([n + 2 * more for n, more in zip(shape, reaches, strict=True)])

    @cache
    def predicted(reach):
        reaches, period, _ = transform(reach)
        return (0.0, 0.0, 0.0) if None in period else outside.error(period, min(reaches))

    if reach is None:
        reach = max(BORDER_REACH, least)
        if tolerance is not None:
            most = int((most_reach(shape, LONGEST) - beside) / ratio)
            reach = enough_reach(reach, most, predicted, tolerance, level)
    border = predicted(reach)
    return *transform(reach), border[0], "" if tolerance is None else broken(border, tolerance, level)


def _by_depth(scene, facts, optics, pitch, weights, limit):
    """How the blur goes by distance, None where it does not; and why it does not although the scene tells distances."""
    if facts.depth is None:
        return None, ""
    for why, is_so in (("there is no blur", optics.model == "none"), ("the lens was measured at one", optics.psf),
                       ("the blur varies over the field", optics.varies), ("there is distortion", optics.distortion)):
        if is_so:
            return None, why
    made = plan_depth(optics, pitch, facts.depth, facts.brightness(weights.sum(axis=0)), limit, scene=scene)
    for distance in made.distances[[0, -1]]:
        try:
            optics.waves(scene.wavelengths[:1], distance=distance)
        except OutOfRange as error:
            raise OutOfRange("depth", f"{distance:.4g} m with the focus at {optics.object_distance:.4g} m",
                             f"nearer to the focus, or a smaller aperture: {error}") from None
    return made, ""


def _check_light(scene, content, camera):
    """Refuse light on the sensor at wavelengths where its curves are not known."""
    nodes, qe, light, through = content.wavelengths, camera.sensor.qe, scene.illuminant, camera.optics.transmission
    known = qe.wavelengths[0] - 1e-6, qe.wavelengths[-1] + 1e-6  # [nm]
    if nodes[0] >= known[0] and nodes[-1] <= known[1]:
        return
    factors = [light, *([through] if isinstance(through, Spectrum) else [])]
    grid = np.unique(np.concatenate([nodes, *(factor.wavelengths for factor in factors)]))
    grid = grid[(grid >= max(nodes[0], *(factor.wavelengths[0] for factor in factors)))
                & (grid <= min(nodes[-1], *(factor.wavelengths[-1] for factor in factors)))]
    lit = np.prod([np.interp(grid, nodes, content.lit), *(factor.at(grid) for factor in factors)], axis=0) > 0
    lit = lit[1:] | lit[:-1]  # of the intervals: a ramp is light
    if not lit.any():
        return
    first, last = grid[:-1][lit][0], grid[1:][lit][-1]
    if first < known[0] or last > known[1]:
        raise OutOfRange(f"sensor.qe of {camera.name}", f"{qe.wavelengths[0]:g} .. {qe.wavelengths[-1]:g} nm",
                         f"as far as the light of {scene.name}, {first:g} .. {last:g} nm; a curve that is 0 beyond its "
                         'ends can be extended with zeros: qe_ends = "zero" in the camera file')


def _checked_displacement(scene, sensor, blurred, fft_free):
    """Displacement of the apertures from a centred grid [pixel], refused where nothing honours it."""
    displacement = sensor.displacement
    shown = f"{displacement[0]:.6g}, {displacement[1]:.6g} pixels"
    if any(abs(move) > max(1, n / 4) for move, n in zip(displacement, scene.shape, strict=True)):
        raise OutOfRange("sensor.offset + sensor.centre", shown, "up to a quarter of the frame; or move the scene")
    if not blurred and scene.samples_per_pixel == 1 and any(abs(move - round(move)) > 1e-9 for move in displacement):
        raise OutOfRange("sensor.offset + sensor.centre", f"{shown}, with one scene sample per pixel and no blur",
                         "whole pixels; or raise samples_per_pixel, or blur")
    if fft_free and blurred and any(displacement):
        raise OutOfRange("fft_free", f"a grid displaced by {shown}", "sensor.offset + sensor.centre = 0")
    return displacement


def _displaced(displacement):
    return f", displaced by {displacement[0]:.4g}, {displacement[1]:.4g} pixels" if any(displacement) else ""


def _tables(transfer_tables, q, aperture, period, ratio, moved):
    """Transfer tables of a period: real quarters, or complex halves of displaced apertures."""
    if not any(moved):
        return transfer_tables(q, aperture, period, period, ratio)
    return np.ascontiguousarray(transfer_tables(q, aperture, period, period, ratio, moved)).view(complex)


def _blurred_axes(scene, ratio, aperture, displacement, spare):
    """Taps of the rows and the columns of pixels among the scene's samples and `spare` more on each side."""
    rows, cols = (pixel_taps(n + 2 * spare, pixels, ratio, width, spare + frame_start(n, pixels, ratio), NODES, move)
                  for n, pixels, width, move in zip(scene.samples, scene.shape, aperture, displacement, strict=True))
    return rows, cols


def _plain_axes(scene, ratio, aperture, displacement, _):
    """Taps among the scene's samples without blur, each constant over its cell; beyond them the border's rule."""
    axes = []
    for n, pixels, width, move in zip(scene.samples, scene.shape, aperture, displacement, strict=True):
        more = ceil(ratio * abs(move))
        taps = pixel_taps(n + 2 * more, pixels, ratio, width, more + frame_start(n, pixels, ratio), AREA, move)
        first, last = taps.centres[0] - ratio * width / 2, taps.centres[-1] + ratio * width / 2
        if scene.border == "scene" and not (more - 1e-6 <= first and last <= n + more + 1e-6):
            raise OutOfRange("sensor.offset + sensor.centre", f"{move:.6g} pixels, beyond the frame",
                             'within it, as optics model "none" sees no surroundings; or border = "edge"')
        axes.append(bordered(taps, n, more, scene.border) if more else taps)
    return tuple(axes)


def _exact(content, weights, spectra):
    """Table, mix, transfers and description of the plan that treats every band, or every entry, by itself."""
    if not content.is_spectral and 2 * len(spectra) <= len(content.wavelengths):
        # Few entries: transform those; each channel's transfer function of an entry sums over the wavelengths.
        table = np.eye(len(spectra)) if content.labels is not None else None
        return (table, np.ones((len(weights), len(spectra))), weights[:, None] * spectra,
                f"exact per band, {len(spectra)} {content.form} planes transformed in place of {len(weights[0])}")
    table = None if content.is_spectral else spectra.T
    return table, weights, None, f"exact per band, {len(weights[0])} wavelengths"


def _limit(tolerance, sensor, weights, facts):
    """Relative RMS error that keeps every bound of the tolerance, and the electrons of the frame's RMS level.

    The noise's sigma at the RMS level is at most the root of that level, which is below saturation; an exposure
    time that is given tells it better.
    """
    level = sensor.saturation
    if sensor.exposure_time is not None:
        values = facts.spectra.values
        signal = np.einsum("cl,lm,cm->c", weights, values, weights)
        level = sensor.exposure_time * np.sqrt(signal.mean())
    sigmas = np.sqrt(max(level, 1.0))
    bounds = [(tolerance.rms, 1.0), (tolerance.p999_sigma, QUANTILE_SIGMAS * sigmas),
              (tolerance.max_sigma, MAXIMUM_SIGMAS * sigmas)]
    return min(bound / factor for bound, factor in bounds if bound is not None), max(level, 1.0)


def _sampled(lens, wavelengths, places):
    """Transfer tables of a lens at places of the field, as `Response.of` takes them."""
    chosen, between = wavelength_nodes(wavelengths)
    size = max(SAMPLED_PERIOD - 1, lens.least_size)
    kernels = np.stack([np.tensordot(between, lens.kernels(chosen, place, size), 1) for place in places], axis=1)
    return _transforms(kernels, SAMPLED_PERIOD, SAMPLED_PERIOD)


def _transforms(kernels, rows, cols):
    """Half spectra of centred kernels (..., m, m) wrapped into a period."""
    whole = np.zeros((*kernels.shape[:-2], rows, cols))
    y, x = ((np.arange(n) - n // 2) % period for n, period in zip(kernels.shape[-2:], (rows, cols), strict=True))
    np.add.at(whole, (..., y[:, None], x), kernels)
    return np.fft.rfft2(whole)


def _quick_tables(optics, pitch, q, aperture, rows, cols, finer):
    """As `transfer_tables` gives them, for lenses whose exact tables take long: from kernels as large as the period."""
    lens = open_lens(optics, pitch / finer, aperture, (1, 1))
    wavelengths = q * 1e9 * pitch / finer / optics.working_f_number
    tables = _transforms(lens.kernels(wavelengths, (0.0, 0.0), (min(rows, cols) - 1) // 2 * 2 + 1), rows, cols)
    return np.ascontiguousarray(tables).view(np.float64)


def _varying(scene, facts, response, guaranteed, lens, flat, shape, corner, limit, fft_length, keep):
    """Planes, transfers on the axis, mix, field-varying rest, error and description of a blur that varies.

    Each channel has planes of its own, so that each plane has one kernel at a place. Their number and the field's
    kernels share the limit.
    """
    own, channels = facts.spectra, len(response.weights)
    prior = _prior(scene, facts)
    operators = [] if guaranteed else [joint_operator(response.channel(c), prior) for c in range(channels)]
    for count in range(1, MOST_PLANES + 1):
        if guaranteed:
            operator = channel_operator(response, count)
            table, each, error, room = operator.table, operator.transfers, operator.bound, 1.0
        else:
            parts = [one.transfers(count)[0] for one in operators]
            table, each = np.vstack([one.w_in[:, :count].T for one in operators]), _blocks(parts)
            error, room = response.error(table, each, own), PREDICTION_FACTOR
        if room * error < limit / 2:
            break
    mix, transfers = each.any(axis=2) * 1.0, each.sum(axis=0)  # a plane is seen by one channel alone
    # differences of neighbours in a plane, over those in the channel: planes of equal strength count alike
    strength = np.sqrt(np.einsum("kl,lm,km->k", table, own.differences, table))
    whole = np.sqrt(np.einsum("cl,lm,cm->c", response.flat, own.differences, response.flat))
    strength = np.maximum(strength / np.maximum(mix.T @ whole, 1e-300), 1e-12)
    table, transfers = table / strength[:, None], transfers * strength[:, None]
    varying = keep("field plan", (shape, corner, limit, transfers.tobytes(), lens.pitch), lambda: choose(
        Differences(lens, facts.content.wavelengths, transfers * flat, shape, corner, limit / 8), shape,
        limit / 2 / np.sqrt(count), fft_length))
    error = float(np.hypot(error, varying.error[0] * np.sqrt(count)))
    return table, transfers[None], mix, varying, error, (
        f"the blur on the axis, {count} plane{'s' if count > 1 else ''} a channel in place of "
        f"{len(facts.content.wavelengths)} wavelengths")


def _blocks(parts):
    """Rows of each part (n, L) in a place of their own: shape (parts, sum of n, L), 0 elsewhere."""
    ends = np.cumsum([len(part) for part in parts])
    out = np.zeros((len(parts), ends[-1], parts[0].shape[1]))
    for own, part, end in zip(out, parts, ends, strict=True):
        own[end - len(part) : end] = part
    return out


def _fused(scene, facts, response, planes, limit, keep):
    """The joint operator of the lowest rank predicted to keep `limit`; None where `planes` exact ones do as well.

    The error is predicted for the scene's own spectra whatever the prior: what lies outside the prior is seen, and
    raises the rank.
    """
    own = facts.spectra
    prior = _prior(scene, facts)
    if not np.trace(prior) > 0:
        return None
    operator = keep("operator", (response, prior), lambda: joint_operator(response, prior))
    for rank in operator.ranks:
        error = operator.predicted(rank, own)
        if rank >= planes:
            break
        if PREDICTION_FACTOR * error < limit:
            return (operator.w_in[:, :rank].T, operator.transfers(rank), error,
                    f"joint spectral operator of rank {rank} in place of {len(facts.content.wavelengths)} wavelengths")
    return None


def _prior(scene, facts):
    """E[x^T x] of likely spectra, shape (L, L).

    The reflectances of PRIOR where a cube's light is known, so that all frames of a film share the operator; otherwise
    the scene's own.
    """
    if not (facts.content.is_spectral and scene.light_is_known):
        return facts.spectra.values
    return _library(tuple(facts.content.wavelengths))


@lru_cache(maxsize=4)
def _library(wavelengths):
    likely = np.vstack([reflectances(name).at(np.array(wavelengths), outside=None) for name in PRIOR])
    return likely.T @ likely / len(likely)


def _guaranteed(scene, facts, response, planes, limit, _):
    """The operator of fewest planes a channel whose bound over all spectra keeps `limit`; None: exact is as cheap."""
    channels = len(response.weights)
    for count in range(1, (planes - 1) // channels + 1):
        operator = channel_operator(response, count)
        if operator.bound < limit:
            return (operator.table, operator.transfers, operator.bound,
                    f"{count} planes a channel, right for every spectrum, in place of {len(facts.content.wavelengths)}")
    return None


def _energy_beyond(radius, q):
    """Share of an Airy pattern's energy beyond `radius` [pixel]: J0(v)^2 + J1(v)^2, v = pi r / q (Rayleigh 1881)."""
    v = np.pi * radius / q
    return float(j0(v) ** 2 + j1(v) ** 2)


def _bytes(rows, cols, period, stored, table, mix, transfers, bands, channels, parts):
    """Device memory of a frame [byte], the arrays that live at the same time added up.

    stored: of the scene's samples. parts: size of a transfer table over that of a real quarter.
    """
    frame, padded = rows * cols, prod(period)
    quarter = (period[0] // 2 + 1) * (period[1] // 2 + 1)
    total = stored + frame * (4 * channels + 4 + 2 + 12 + 3)
    if mix is not None:
        planes = mix.shape[1]
        total += 4 * frame * (planes if table is not None else 0)
        total += 4 * parts * quarter * (bands + (channels * planes if transfers is not None else 0))
        total += 8 * padded * (2 * min(planes, 8) + 2 * channels)  # spectra and scratch, sums and their inverse
    return total

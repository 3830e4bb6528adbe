"""Spectral fusion: the planes that are blurred in place of all wavelengths, and the channels made of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from gpusim.data.reflectances import reflectances
from gpusim.data.weights import sampling_difference
from gpusim.domain.account import SAFETY, SAMPLING, Bound
from gpusim.domain.interpolation import is_regular
from gpusim.domain.spectrum import LINE, Spectrum
from gpusim.optics.depth import DepthPlan
from gpusim.optics.fusion import (
    SAMPLED_PERIOD,
    Response,
    Watch,
    channel_operator,
    joint_operator,
    wrong_moments,
)
from gpusim.optics.sampling import pixel_response
from gpusim.optics.tables import field_tables
from gpusim.optics.windows import Windows
from gpusim.planner.choices import Fusion, Planes
from gpusim.planner.facts import Operation
from gpusim.planner.knobs.field import field_bound, varying_planes
from gpusim.planner.knobs.highlights import Picture
from gpusim.planner.knobs.pixels import taps_of
from gpusim.planner.probes import COUNT, INNER, LEAST_WINDOWS, RIM, SIDE, Probes
from gpusim.planner.question import DECLARED, Notes, Question

# reflectances held likely before a cube is seen
PRIOR = (
    "munsell",
    "dupont",
    "objects",
    "skin",
    "colorchecker-sg",
)
# Relative rms from which two models of what lies between samples say that there are too few. Smooth
# reflectances differ by 4e-5 on steps of 10 nm, 5e-4 of 20 nm; a line of 13 nm by 9e-3 of 20 nm.
UNDERSAMPLED = 2e-3
FEW = 8  # wavelengths: scenes of fewer are drafts, and a spline is what they are
ROUGH = 0.01  # such a difference of a spline from straight lines is reported
ENOUGH = 0.25  # of a tolerance: where fused planes err less, more of them would not help the sum
# Rows and columns of field points, 1 the frame's border, whose responses stand for the field's
FIELD_POINTS = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.5), (0.0, 0.9), (0.9, 0.9))


@dataclass(frozen=True, eq=False)
class Fused:
    """The planes that are blurred.

    Attributes:
        flat: Response to a flat field of each wavelength, shape (L,): see `Plan`.
        mix: Channels from blurred planes, shape (C, planes); the identity without blur.
        choices: How they are made: Planes, Fusion, FieldBlur and Watch, as far as they are needed.
    """

    flat: np.ndarray
    mix: np.ndarray
    choices: tuple = ()

    def describe(self, question: Question, notes: Notes):
        """Note the sums over wavelength."""
        content = question.content
        for choice in self.choices:
            if isinstance(choice, Planes):
                notes.models[_stage(content)] = (
                    f"{content.form} of {len(content.entry_spectra)} entries to "
                    f"{len(choice.table)} planes"
                )

    def describe_tables(self, question: Question, notes: Notes):
        """Note the tables that are summed over wavelength."""
        if any(isinstance(choice, Fusion) for choice in self.choices):
            notes.models.setdefault(
                "spectral.integrate",
                f"tables of {len(question.scene.wavelengths)} wavelengths combined into the planes'",
            )


def planes_without_blur(question: Question, notes: Notes, is_declared: bool) -> Fused:
    """Return the planes of a frame without blur: channels straight from the content.

    is_declared: Whether the camera has no blur; else a tolerance left it out, which is noted already.
    """
    content, weights = question.content, question.weights
    spectra, nodes = content.entry_spectra, question.scene.wavelengths
    notes.models[_stage(content)] = (
        f"{content.form} of {len(spectra)} entries straight to {len(weights)} channels "
        "(no blur to apply)"
    )
    if is_declared:
        notes.leave_out(question.lens.words, DECLARED)
    return Fused(np.ones(len(nodes)), np.eye(len(weights)), (Planes(weights @ spectra.T),))


@dataclass(frozen=True, eq=False)
class Way:
    """One way to treat the wavelengths.

    Attributes:
        count: Planes that are transformed.
        bound: Its error.
        words: The way in words.
        make: Makes its planes; its argument is the relative RMS error up to which they serve other scenes.
    """

    count: int
    bound: Bound
    words: str
    make: Callable[[float], Fused]


def ways(question: Question, probes: Probes | None, depth: DepthPlan | None = None) -> list[Way]:
    """Return all ways, from the fewest planes on; the last is exact. A blur that varies over the field has one.

    probes: of the scene, with a tolerance. depth: plan of the blur by distance. Raises OutOfRange.
    """
    flat = _flat(question)
    even = question.weights / flat
    if not question.lens.is_uniform or depth is not None:
        response = response_of(question, even, flat)
        inputs, transfers, mix, varying, wrong, worst, words = varying_planes(
            question, response, prior_of(question), flat, depth
        )
        table = inputs @ question.content.entry_spectra.T
        made = Fused(flat, mix, (Planes(table), Fusion(transfers), varying, worst))
        rms, most, shaded = wrong
        bound = field_bound(probes, rms, most, shaded, worst)
        return [Way(len(inputs), bound, words, lambda _: made)]
    exact = _exact(question.content, even, flat)
    if probes is None:
        return [exact]
    response = response_of(question, even, flat)
    fewer = _guaranteed_ways if question.guaranteed else _fused_ways
    return [*fewer(question, response, flat, exact.count, probes), exact]


def describe_unseen(question: Question, notes: Notes):
    """Note light that the scene does not hold, with its electrons if it continues as at the scene's ends."""
    nodes, qe = question.scene.wavelengths, question.sensor.qe
    if len(nodes) == 1:
        notes.leave_out(
            f"light outside {LINE:g} nm around the scene's only wavelength, {nodes[0]:g} nm",
            DECLARED,
        )
        return
    seen = min(0.01, 0.1 * qe.values.max())  # of a sensor that sees little: a part of that
    unseen = qe.wavelengths[(qe.values > seen).any(axis=0)]
    if unseen[0] < nodes[0] - 1 or unseen[-1] > nodes[-1] + 1:
        notes.leave_out(
            f"light outside the scene's {nodes[0]:g} .. {nodes[-1]:g} nm, which the sensor would see, if "
            "it continues as at the ends",
            Bound(_light_outside(question)),
            "light outside the wavelengths",
            of_scene=True,
        )


def describe_sampling(question: Question, probes: Probes | None, notes: Notes):
    """Note the error of the spectra between the scene's wavelengths.

    It counts if the samples are too few or too uneven for their spectra. Smooth spectra on regular
    wavelengths are the scene as it is given.
    """
    scene, nodes = question.scene, question.scene.wavelengths
    if len(nodes) < 3:
        return
    through = question.optics.transmission
    factors = [scene.illuminant, question.sensor.qe]
    factors += [through] if isinstance(through, Spectrum) else []
    wrong, rough = question.cache(
        "spectral sampling",
        sampling_difference,
        nodes,
        question.facts.pairs.mean_spectrum(),
        question.facts.spectra.values,
        question.share,
        *factors,
    )
    lines = "" if is_regular(nodes) else "uneven "
    if not lines and (len(nodes) < FEW or wrong < UNDERSAMPLED):
        if rough > ROUGH:
            notes.beside["spectral sampling (spline against lines)"] = rough
        return
    wrong = max(wrong, rough)
    notes.leave_out(
        f"light between the scene's {len(nodes)} {lines}wavelengths that they do not show"
        + (", taken as straight lines" if lines else ""),
        Bound(wrong) if probes is None else probes.brightness_error(wrong),
        SAMPLING,
    )


def _light_outside(question):
    """Electrons from outside the scene's wavelengths over those from inside [1].

    Content and light go on as at their ends; all channels count.
    """
    nodes, qe, optics = question.scene.wavelengths, question.sensor.qe, question.optics
    content = np.sqrt(np.maximum(np.diag(question.facts.spectra.values), 0))
    grid = np.arange(qe.wavelengths[0], qe.wavelengths[-1] + 1)
    light = (
        np.interp(grid, nodes, content)
        * optics.transmission_at(grid)
        * question.scene.illuminant.at(grid, outside=None)
        * qe.at(grid).sum(axis=0)
    )
    inside = (grid >= nodes[0]) & (grid <= nodes[-1])
    seen = light[inside].sum()
    return float(light[~inside].sum() / seen) if seen > 0 else 0.0


def _stage(content):
    return "spectral.materials" if content.labels is not None else "spectral.integrate"


def _flat(question):
    """Response to a uniform scene of each wavelength, if each sample is a unit point source."""
    # points in the middle of the apertures would count too much of a flat scene
    if min(question.cell) < 1:
        tables = question.tables.even(question.q, question.cell, 1, question.ratio, question.moved)
        return tables[:, 0, 0].real
    return np.ones(len(question.q))


def _exact(content, weights, flat):
    """The planes that treat every band, or every entry, separately."""
    spectra = content.entry_spectra
    if not content.is_spectral and 2 * len(spectra) <= len(content.wavelengths):
        # Few entries: transform those; each channel's transfer function of an entry sums over the wavelengths.
        planes = () if content.labels is None else (Planes(np.eye(len(spectra))),)
        fusion = Fusion(weights[:, None] * spectra)
        return Way(
            len(spectra),
            Bound(),
            f"exact per band, {len(spectra)} {content.form} planes transformed in place "
            f"of {len(weights[0])}",
            lambda _: Fused(flat, np.ones((len(weights), len(spectra))), (*planes, fusion)),
        )
    return Way(
        len(weights[0]),
        Bound(),
        f"exact per band, {len(weights[0])} wavelengths",
        lambda _: Fused(flat, weights, () if content.is_spectral else (Planes(spectra.T),)),
    )


def transfers_at(question: Question, flat, period: int) -> np.ndarray:
    """Return transfer functions of the wavelengths at the frequencies of a square period, pixels included.

    They are real quarters (L, n // 2 + 1, n // 2 + 1) or complex halves (L, n, n // 2 + 1); for a
    blur that varies over the field they are at FIELD_POINTS, (L, P, n, n // 2 + 1).
    """
    scene = question.scene
    if question.lens.is_uniform:
        tables = question.tables.even(
            question.q, question.cell, period, question.ratio, question.moved
        )
    else:
        half = np.array(scene.samples) / 2 + question.ratio * np.abs(question.axis)
        places = half / question.corner * FIELD_POINTS
        tables = question.cache(
            "field transfers", field_tables, question.lens, scene.wavelengths, places, period
        )
        tables = tables * flat.reshape(-1, *[1] * (tables.ndim - 1))
    taps, _ = taps_of(question)
    if taps is not None:  # structure that the pixels average out is no error
        fx = np.arange(period // 2 + 1) / period
        fy = np.fft.fftfreq(period) if tables.shape[-2] > len(fx) else fx
        tables = tables * pixel_response(taps, fy, fx)
    return tables


def probes_of(question: Question, picture: Picture, operation: Operation) -> Probes:
    """Return windows of the scene in which errors are computed."""
    scene = question.scene
    flat = np.ones(len(question.q))
    tables = np.ones((1, SIDE, SIDE // 2 + 1))
    if question.is_blurred:
        flat = _flat(question)
        tables = transfers_at(question, flat, SIDE)
        tables = tables[:, 0] if tables.ndim == 4 else tables  # on the axis
    cfa = None if question.sensor.stacked else question.sensor.cfa_indices
    key = (
        *(picture.brightness, picture.level, picture.apart, scene.border, scene.margin),
        *(part.tobytes() for part in (question.weights, flat, tables, question.share)),
        *(question.ratio, cfa if cfa is None else (cfa.shape, cfa.tobytes())),
    )
    found = question.facts.hold("probes", key, lambda: _probe(question, picture, flat, tables))
    return found.at(operation.seconds, operation.noise)


def _probe(question, picture, flat, tables):
    """Return the windows for an exposure of a second without read noise."""
    scene = question.scene
    if tables.shape[1] < SIDE:
        tables = tables[:, np.minimum(np.arange(SIDE), SIDE - np.arange(SIDE))]
    count = max(LEAST_WINDOWS, COUNT * 31 // max(len(flat), 31))
    windows = Windows.of(picture.brightness, scene.margin, scene.border, count, SIDE, RIM)
    inner = min(scene.samples[0], INNER), min(scene.samples[1], INNER)
    channels = None
    if not question.sensor.stacked and question.ratio == 1:
        cfa = question.sensor.cfa_indices
        y = windows.rows[:, RIM : RIM + inner[0]] - scene.margin
        x = windows.cols[:, RIM : RIM + inner[1]] - scene.margin
        channels = cfa[y[:, :, None] % len(cfa), x[:, None] % cfa.shape[1]]
    return Probes.of(
        question.facts,
        windows,
        scene.border,
        tables=np.broadcast_to(tables, (len(flat), *tables.shape[1:])),
        weights=question.weights,
        even=question.weights / flat,
        share=question.share,
        level=picture.level,
        seconds=1.0,
        noise=0.0,
        apart=picture.apart,
        inner=inner,
        channels=channels,
        brightness=picture.brightness,
    )


def response_of(question: Question, even, flat) -> Response:
    """Return the channels over wavelength and frequency.

    even: weights over the response to flat fields.
    """
    cfa, tables = question.sensor.cfa_indices, transfers_at(question, flat, SAMPLED_PERIOD)
    return question.cache("response", Response.of, even, tables, cfa)


def _fused_ways(question, response, flat, planes, probes):
    """The joint operators of fewer than `planes` planes.

    Their errors are computed for the scene's own spectra, so they include light outside the prior.
    """
    prior, content = prior_of(question), question.content
    if not np.trace(prior) > 0:
        return
    operator = question.cache("operator", joint_operator, response, prior)
    if not operator.ranks:
        return  # fewer wavelengths than channels
    most = min(operator.ranks[-1], planes - 1)
    for rank, bound in probes.fused_bounds(operator.w_in[:, :most].T, operator.transfers(most)):
        if rank < question.least:
            continue

        def make(limit, rank=rank, bound=bound):
            inputs, transfers = operator.w_in[:, :rank].T, operator.transfers(rank)
            watch = Watch.of(response, inputs, transfers, content).with_scale(question.facts.pairs)
            expected = operator.predict_error(rank, question.facts.spectra)
            falls = watch.forecast_falls(
                wrong_moments(response, operator.w_in[:, :more].T, operator.transfers(more))
                for more in range(rank + 1, most + 1)
            )
            factor = bound.rms / expected if expected else 1.0
            return Fused(
                flat,
                np.ones(transfers.shape[:2]),
                (
                    Planes(inputs @ content.entry_spectra.T),
                    Fusion(transfers),
                    replace(watch, factor=factor, falls=falls, limit=limit),
                ),
            )

        words = f"joint spectral operator of rank {rank} in place of {len(response.weights[0])} wavelengths"
        yield Way(rank, bound, words, make)
        if SAFETY * bound.ratio(question.tolerance) < ENOUGH:
            return


def watch_of_no_blur(question: Question, bound: Bound) -> Watch:
    """Return a watch that predicts the error of leaving the blur out of later scenes.

    bound: that error for the question's scene.
    """
    flat = _flat(question)
    watch, expected = Watch.of_no_blur(
        response_of(question, question.weights / flat, flat),
        question.content,
        question.scene.samples,
        question.facts.spectra,
    )
    factor = max(1.0, bound.rms / expected if expected else 1.0)
    return replace(watch.with_scale(question.facts.pairs), factor=factor)


def _guaranteed_ways(question, response, flat, planes, probes):
    """Operators with a bound for every spectrum, of fewer than `planes` planes."""
    channels, bands = response.weights.shape
    for count in range(1, (planes - 1) // channels + 1):
        operator = question.cache(f"{count} planes a channel", channel_operator, response, count)

        def make(_, operator=operator):
            table = operator.table @ question.content.entry_spectra.T
            return Fused(
                flat,
                np.ones(operator.transfers.shape[:2]),
                (Planes(table), Fusion(operator.transfers)),
            )

        bound = probes.local(operator.bound)
        yield Way(
            count * channels,
            bound,
            f"{count} planes a channel, right for every spectrum, in place of {bands}",
            make,
        )
        if SAFETY * bound.ratio(question.tolerance) < ENOUGH:
            return


def prior_of(question: Question) -> np.ndarray:
    """Return E[x^T x] of likely spectra, shape (L, L).

    If the light of a cube is known they are the reflectances of PRIOR, and all frames of a film
    share the operator; otherwise the scene's own.
    """
    if not (question.content.is_spectral and question.scene.light_is_known):
        return question.facts.spectra.values
    return _library(tuple(question.content.wavelengths))


@lru_cache(maxsize=4)
def _library(wavelengths):
    likely = np.vstack(
        [reflectances(name).at(np.array(wavelengths), outside=None) for name in PRIOR]
    )
    return likely.T @ likely / len(likely)

"""Spectral fusion: which planes go through the blur in place of all wavelengths, and how channels are made of them."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gpusim.data.reflectances import reflectances
from gpusim.planner.drift import Watch
from gpusim.planner.field import FieldBlur
from gpusim.planner.fusion import PREDICTION_FACTOR, SAMPLED_PERIOD, Response, channel_operator, joint_operator
from gpusim.planner.highlights import TRANSFORM_ERROR
from gpusim.planner.models.field import varying_planes
from gpusim.planner.notes import Notes
from gpusim.planner.question import Question
from gpusim.planner.sampling import pixel_response
from gpusim.planner.tables import field_tables

PRIOR = ("munsell", "dupont", "objects", "skin", "colorchecker-sg")  # reflectances held likely before a cube is seen
FFT_FREE_ERROR = 2e-4  # relative RMS of the pyramid's kernels: 1.2e-4 .. 2.0e-4 at f/2.8 and 1.4 um on natural scenes
# Rows and columns of field points, 1 the frame's border, whose responses stand for the field's
FIELD_POINTS = ((0.0, 0.0), (0.0, 0.5), (0.5, 0.5), (0.0, 0.9), (0.9, 0.9))


@dataclass(frozen=True, eq=False)
class Planes:
    """What goes through the blur: see `gpusim.planner.plan.Plan` for each."""

    flat: np.ndarray
    table: np.ndarray | None
    mix: np.ndarray | None
    transfers: np.ndarray | None
    watch: Watch | None = None
    varying: FieldBlur | None = None

    def describe(self, question: Question, notes: Notes):
        """Say what is summed over wavelength."""
        content = question.content
        if self.table is not None:
            notes.models[_stage(content)] = (f"{content.form} of {len(content.entry_spectra)} entries to "
                                             f"{len(self.table)} planes")

    def describe_tables(self, question: Question, notes: Notes):
        """Say what tables are summed over wavelength."""
        if self.transfers is not None:
            notes.models.setdefault("spectral.integrate", f"tables of {len(question.scene.wavelengths)} wavelengths to "
                                    "those of the planes")


def unblurred(question: Question, notes: Notes) -> Planes:
    """Channels straight from the content."""
    content, optics, weights = question.content, question.optics, question.weights
    spectra, nodes = content.entry_spectra, question.scene.wavelengths
    notes.models[_stage(content)] = (f"{content.form} of {len(spectra)} entries straight to {len(weights)} channels "
                                     "(no blur to apply)")
    colour = ", lateral colour" if np.any(optics.lateral_color_at(nodes)) else ""
    notes.left_out.append(f'diffraction{colour}: optics.model is "none"')
    return Planes(np.ones(len(nodes)), weights @ spectra.T, None, None)


def blurred(question: Question, form: str, taps, notes: Notes) -> Planes:
    """The fewest planes that keep the limit, those of a blur that varies over the field, or exact ones.

    form: the stage that blurs. taps: see `Plan`. Raises OutOfRange.
    """
    content, limit, flat = question.content, question.limit, _flat(question)
    even = question.weights / flat
    made, wrong = _exact(content, even, flat, form, notes), 0.0
    if question.optics.varies:
        inputs, transfers, mix, varying, wrong, words = varying_planes(
            question, _response(question, even, flat, taps), prior_of(question), flat)
        made = Planes(flat, inputs @ content.entry_spectra.T, mix, transfers, None, varying)
        notes.models[form], notes.models["optics.field"] = words, varying.report
        notes.predicted["field at the worst place"] = varying.error[1]
    elif limit is not None:
        response = _response(question, even, flat, taps)
        fused = (_guaranteed if question.guaranteed else _fused)(question, response, made.mix.shape[1])
        if fused:
            inputs, transfers, wrong, notes.models[form] = fused
            watch = None if question.guaranteed else Watch.of(response, inputs, transfers, content)
            made = Planes(flat, inputs @ content.entry_spectra.T, np.ones(transfers.shape[:2]), transfers, watch)
    notes.predicted["relative rms"] = float(np.hypot(wrong, FFT_FREE_ERROR if question.fft_free else TRANSFORM_ERROR))
    return made


def describe_unseen(question: Question, notes: Notes):
    """Say what light the scene does not tell."""
    nodes, qe = question.scene.wavelengths, question.sensor.qe
    unseen = qe.wavelengths[(qe.values > 0.01).any(axis=0)]
    if unseen[0] < nodes[0] - 1 or unseen[-1] > nodes[-1] + 1:
        notes.left_out.append(f"light outside the scene's {nodes[0]:g} .. {nodes[-1]:g} nm, which the sensor would see")


def _stage(content):
    return "spectral.materials" if content.labels is not None else "spectral.integrate"


def _flat(question):
    """What a flat field of each wavelength gives where every sample is a point of light of 1."""
    if min(question.cell) < 1:  # points in the middle of the apertures would count too much of a flat scene
        tables = question.tables.even(question.q, question.cell, 1, question.ratio, question.moved)
        return tables[:, 0, 0].real
    return np.ones(len(question.q))


def _exact(content, weights, flat, form, notes):
    """The planes that treat every band, or every entry, by itself."""
    spectra = content.entry_spectra
    if not content.is_spectral and 2 * len(spectra) <= len(content.wavelengths):
        # Few entries: transform those; each channel's transfer function of an entry sums over the wavelengths.
        table = np.eye(len(spectra)) if content.labels is not None else None
        notes.models[form] = (f"exact per band, {len(spectra)} {content.form} planes transformed in place of "
                              f"{len(weights[0])}")
        return Planes(flat, table, np.ones((len(weights), len(spectra))), weights[:, None] * spectra)
    notes.models[form] = f"exact per band, {len(weights[0])} wavelengths"
    return Planes(flat, None if content.is_spectral else spectra.T, weights, None)


def _response(question, even, flat, taps):
    """The channels over wavelength and frequency; even: weights of what is flat."""
    optics, scene = question.optics, question.scene
    if optics.is_symmetric and not optics.varies:
        tables = question.tables.even(question.q, question.cell, SAMPLED_PERIOD, question.ratio, question.moved)
    else:
        half = np.array(scene.samples) / 2 / question.corner
        tables = field_tables(question.lens, scene.wavelengths,
                              half * FIELD_POINTS if optics.varies else FIELD_POINTS[:1])
        tables *= flat.reshape(-1, *[1] * (tables.ndim - 1))
    if taps is not None:  # what the pixels average out is no error
        fx = np.arange(SAMPLED_PERIOD // 2 + 1) / SAMPLED_PERIOD
        fy = np.fft.fftfreq(SAMPLED_PERIOD) if tables.shape[-2] > len(fx) else fx
        tables = tables * pixel_response(taps, fy, fx)
    cfa = question.sensor.cfa_indices
    return question.kept("response", (even, tables, cfa), lambda: Response.of(even, tables, cfa))


def _fused(question, response, planes):
    """The joint operator of the lowest rank predicted to keep the limit; None where `planes` exact ones do as well.

    The error is predicted for the scene's own spectra whatever the prior: what lies outside the prior is seen, and
    raises the rank.
    """
    own, prior = question.facts.spectra, prior_of(question)
    if not np.trace(prior) > 0:
        return None
    operator = question.kept("operator", (response, prior), lambda: joint_operator(response, prior))
    for rank in operator.ranks:
        error = operator.predicted(rank, own)
        if rank >= planes:
            break
        if PREDICTION_FACTOR * error < question.limit:
            return (operator.w_in[:, :rank].T, operator.transfers(rank), error,
                    f"joint spectral operator of rank {rank} in place of {len(response.weights[0])} wavelengths")
    return None


def _guaranteed(question, response, planes):
    """The operator of fewest planes a channel whose bound over all spectra keeps the limit; None: exact is as cheap."""
    channels, bands = response.weights.shape
    for count in range(1, (planes - 1) // channels + 1):
        operator = channel_operator(response, count)
        if operator.bound < question.limit:
            return (operator.table, operator.transfers, operator.bound,
                    f"{count} planes a channel, right for every spectrum, in place of {bands}")
    return None


def prior_of(question: Question) -> np.ndarray:
    """E[x^T x] of likely spectra, shape (L, L).

    The reflectances of PRIOR where a cube's light is known, so that all frames of a film share the operator; otherwise
    the scene's own.
    """
    if not (question.content.is_spectral and question.scene.light_is_known):
        return question.facts.spectra.values
    return _library(tuple(question.content.wavelengths))


@lru_cache(maxsize=4)
def _library(wavelengths):
    likely = np.vstack([reflectances(name).at(np.array(wavelengths), outside=None) for name in PRIOR])
    return likely.T @ likely / len(likely)

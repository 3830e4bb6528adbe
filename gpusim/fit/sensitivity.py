"""Spectral sensitivities of channels from a few responses: smooth curves near measured ones, not negative."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from gpusim.data.curves import curve
from gpusim.data.weights import product_weights
from gpusim.domain.short_repr import short_repr
from gpusim.domain.spectrum import Spectrum

NODES = np.arange(390.0, 721.0, 10.0)  # [nm]
POPULATION = 400  # curves of a channel that are drawn
SHIFT, STRETCH, TILT, LEVEL, CROSSTALK = 12.0, 0.12, 0.25, 0.2, 0.06
CUT_SHIFT = 12.0  # [nm] of the infrared cut
OWN, LENGTH = (
    0.04,
    22.0,
)  # smooth deviations from all curves: size over the peak, and correlation length [nm]
LEAST_ERROR = 1e-3  # of a patch's response: reflectances of charts differ from their tables
MOST_ERROR = 0.05
SLOPE = 0.05  # expected change of the light over the chart
ROUNDS = 8
ALL = "RGB"


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sensitivities with their uncertainty.

    Args:
        letters: Channels.
        values: Electrons per photon in any unit, largest value 1, at NODES, shape (C, L).
        covariance: Of the values of each channel, shape (C, L, L).
        scales: Responses over the model's for each light, shape (lights,).
        slopes: Change of the light over half of the chart along x and y, shape (lights, 2).
        predicted: Responses of the model to the patches, shape (lights, 24, C), in units of the measured ones.
        error: Relative error of a response that the residuals suggest.
        evidence: Logarithm of the likelihood of the responses in these lights.
    """

    letters: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    scales: np.ndarray
    slopes: np.ndarray
    predicted: np.ndarray
    error: float
    evidence: float

    __repr__ = short_repr

    @property
    def spectrum(self) -> Spectrum:
        """The curves as a table."""
        return Spectrum(NODES, self.values, "fitted sensitivity")


@lru_cache(maxsize=16)
def curve_prior(letter: str) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (L,) and covariance (L, L) of a channel's curve, peak about 1.

    The population are the measured curves of the package, shifted, stretched, tilted and mixed with their neighbours,
    behind infrared cuts of different edges.

    Args:
        letter: R, G, B, or another one: any of them.

    Returns:
        Mean and covariance.
    """
    random = np.random.default_rng(list(map(ord, "curves" + letter)))
    sets = [
        np.array(curve("mt9v024").at(NODES, outside=None))[:3],
        np.array(curve("iset-rgb").at(NODES, outside=None)),
    ]
    cuts = [curve("ir-cut-phone"), curve("ir-cut-schott")]
    found = []
    for _ in range(POPULATION):
        rows = sets[random.integers(len(sets))]
        rows = rows / rows.max()
        own = ALL.index(letter) if letter in ALL else random.integers(3)
        mixed = rows[own] + CROSSTALK * random.exponential(size=3) @ rows
        if letter in "WYC":
            mixed = mixed + rows.sum(0) * random.random()
        centre = NODES[np.argmax(mixed)]
        at = centre + (NODES - centre - SHIFT * random.normal()) / np.exp(STRETCH * random.normal())
        one = np.interp(at, NODES, mixed)
        cut = cuts[random.integers(len(cuts))]
        edge = cut.at(NODES - CUT_SHIFT * random.normal(), outside=None)
        one = one * np.clip(edge, 0, 1) * np.exp(TILT * random.normal() * (NODES - 550) / 150)
        found.append(one * np.exp(LEVEL * random.normal()))
    table = np.array(found) / np.max(np.mean(found, axis=0))
    smooth = np.exp(-((NODES[:, None] - NODES) ** 2) / (2 * LENGTH**2))
    return table.mean(0), np.cov(table.T) + OWN**2 * smooth + 1e-7 * np.eye(len(NODES))


def fit_sensitivity(
    letters: Sequence[str],
    responses: Sequence[np.ndarray],
    errors: Sequence[np.ndarray],
    lights: Sequence[Spectrum],
    surfaces: np.ndarray,
    places: np.ndarray,
    used: Sequence[np.ndarray],
) -> Sensitivity:
    """Fit the sensitivities to responses to known surfaces.

    Bayes's rule with a Gaussian prior of the curves, the mean of the posterior, limited to values that are not
    negative. Exposure, a slope of the light over the chart, and the relative error of the reflectances are fitted
    along with it.

    Args:
        letters: Channels.
        responses: For each light, shape (24, C).
        errors: Their standard errors, for each light, shape (24, C).
        lights: Photons of each light, any unit.
        surfaces: Reflectances at NODES, shape (24, L).
        places: x and y of the patches on the chart, -1 to 1, shape (24, 2).
        used: Patches that are used, for each light, shape (24,).

    Returns:
        The sensitivities.

    Source:
        Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), chapter 2.
    """
    priors = [curve_prior(letter) for letter in letters]
    models = [surfaces * product_weights(NODES, light) for light in lights]
    scales, slopes = np.ones(len(lights)), np.zeros((len(lights), 2))
    main = max(range(len(letters)), key=lambda k: float(responses[0][:, k].sum()))
    for number, (model, seen, chosen) in enumerate(zip(models, responses, used, strict=True)):
        expected = (model @ priors[main][0])[chosen]
        scales[number] = seen[chosen, main].sum() / expected.sum()
    scales = scales / scales[0]
    unit = responses[0][used[0], main].sum() / (models[0] @ priors[main][0])[used[0]].sum()
    relative = 0.01
    for _ in range(ROUNDS):
        curves, covariances, predicted, evidence = _posterior(
            priors, models, responses, errors, scales * unit, slopes, places, used, relative
        )
        scales, slopes = _align(
            predicted, responses, errors, scales, slopes, places, used, relative
        )
        relative = _relative_error(predicted, responses, errors, used, len(letters))
    curves, covariances, predicted, evidence = _posterior(
        priors, models, responses, errors, scales * unit, slopes, places, used, relative
    )
    top = curves.max()
    return Sensitivity(
        tuple(letters),
        curves / top,
        covariances / top**2,
        scales * unit * top,
        slopes,
        predicted,
        relative,
        evidence,
    )


def _posterior(priors, models, responses, errors, scales, slopes, places, used, relative):
    """Return curves (C, L), covariances, predicted responses and the logarithm of the evidence."""
    curves, covariances, evidence = [], [], 0.0
    fields = [1 + places @ slope for slope in slopes]
    for k, (mean, covariance) in enumerate(priors):
        matrix = np.concatenate(
            [
                (scale * field[:, None] * model)[chosen]
                for scale, field, model, chosen in zip(scales, fields, models, used, strict=True)
            ]
        )
        seen = np.concatenate([one[chosen, k] for one, chosen in zip(responses, used, strict=True)])
        spread = np.concatenate([one[chosen, k] for one, chosen in zip(errors, used, strict=True)])
        sigma = np.hypot(spread, relative * np.maximum(seen, 0.02 * seen.max()))
        own = matrix @ covariance
        whole = own @ matrix.T + np.diag(sigma**2)
        factor = scipy.linalg.cho_factor(whole)
        miss = seen - matrix @ mean
        gain = scipy.linalg.cho_solve(factor, own)
        covariances.append(covariance - own.T @ gain)
        evidence -= 0.5 * miss @ scipy.linalg.cho_solve(factor, miss)
        evidence -= np.log(np.diag(factor[0])).sum()
        evidence += np.log(
            np.maximum(seen, 1e-9)
        ).sum()  # of relative responses, alike in all lights
        root = np.linalg.inv(np.linalg.cholesky(covariance))
        system = np.vstack([matrix / sigma[:, None], root])
        curves.append(scipy.optimize.nnls(system, np.append(seen / sigma, root @ mean))[0])
    table = np.array(curves)
    predicted = np.stack(
        [
            scale * field[:, None] * (model @ table.T)
            for scale, field, model in zip(scales, fields, models, strict=True)
        ]
    )
    return table, np.array(covariances), predicted, float(evidence)


def _align(predicted, responses, errors, scales, slopes, places, used, relative):
    """Return scales and slopes of the lights that the residuals ask for; the first scale stays 1."""
    scales, slopes = scales.copy(), slopes.copy()
    for number, (model, seen, spread, chosen) in enumerate(
        zip(predicted, responses, errors, used, strict=True)
    ):
        base = model / (1 + places @ slopes[number])[:, None]
        channels = seen.shape[1]
        ratio = (seen / base)[chosen].ravel() - 1
        sigma = np.hypot(spread / base, relative)[chosen].ravel()
        x = np.repeat(places[chosen], channels, axis=0)
        matrix = np.column_stack([np.ones(len(x)), x]) / sigma[:, None]
        prior = np.diag([0.0, 1 / SLOPE, 1 / SLOPE])
        found = np.linalg.lstsq(
            np.vstack([matrix, prior]), np.append(ratio / sigma, np.zeros(3)), rcond=None
        )[0]
        slopes[number] = found[1:]
        if number:
            scales[number] *= 1 + found[0]
    return scales, slopes


def _relative_error(predicted, responses, errors, used, channels):
    """Return the relative error of responses whose residuals are as large as the model's are."""
    squares, freedom = 0.0, 0.0
    for model, seen, spread, chosen in zip(predicted, responses, errors, used, strict=True):
        miss = ((seen - model) / np.maximum(model, 1e-9))[chosen]
        noise = (spread / np.maximum(model, 1e-9))[chosen]
        squares += np.maximum(miss**2 - noise**2, 0).sum()
        freedom += miss.size
    freedom = max(
        freedom - 8 * channels, freedom / 3
    )  # a chart tells some eight numbers of a curve
    return float(np.clip(np.sqrt(squares / freedom), LEAST_ERROR, MOST_ERROR))


def guess_light(candidates: Mapping[str, Spectrum], fit) -> tuple[str, Sensitivity]:
    """Return the light of the greatest evidence, and its fit.

    Args:
        candidates: Photons by name.
        fit: Function of a light's photons that returns a Sensitivity.

    Returns:
        Name and sensitivities.
    """
    fits = {name: fit(light) for name, light in candidates.items()}
    best = max(fits, key=lambda name: fits[name].evidence)
    return best, fits[best]

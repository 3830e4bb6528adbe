"""Spectral sensitivities of channels from a few responses: smooth curves near measured ones, not negative."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import scipy

from gpusim.data.weights import product_weights
from gpusim.domain.short_repr import short_repr
from gpusim.domain.spectrum import Spectrum
from gpusim.fit.curve_prior import LEAST, NODES, curve_prior

# Sizes that are tried. Of the prior's covariance: some cameras are far from usual. Relative errors of responses, as
# reflectances of charts differ from their tables: of a patch in all channels, and of each channel.
BREADTH = (1.0, 2.0, 4.0, 8.0)
COMMON = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05)
SINGLE = (0.0005, 0.001, 0.002, 0.005, 0.01, 0.03)
SCALE = 0.5  # expected logarithm of another light's scale
SLOPE = 0.05  # expected change of the light over the chart
ROUNDS, NOISE_ROUNDS = 16, (4, 7)
DONE = 1e-4  # largest change of a logarithm that ends the rounds
DRAWS, DRAW_ROUNDS = 40, 4  # of curves, for intervals


@dataclass(frozen=True, eq=False)
class Sensitivity:
    """Sensitivities with their uncertainty.

    Args:
        letters: Channels.
        values: Electrons per photon in any unit, largest value 1, at NODES, shape (C, L).
        draws: Curves that the responses allow as well, in the same unit, shape (D, C, L).
        scales: Responses over the model's for each light, shape (lights,).
        slopes: Change of the light over half of the chart along x and y, shape (lights, 2).
        predicted: Responses of the model to the patches, shape (lights, 24, C), in units of the measured ones.
        error: Relative error of a response that the residuals suggest.
        evidence: Logarithm of the likelihood of the responses in these lights.
    """

    letters: tuple[str, ...]
    values: np.ndarray
    draws: np.ndarray
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


@dataclass(frozen=True)
class _Chart:
    """Used patches of a chart in one light: weights (N, L), places (N, 2), responses and their errors (C, N)."""

    weights: np.ndarray
    places: np.ndarray
    seen: np.ndarray
    noise: np.ndarray


def fit_sensitivity(
    letters: Sequence[str],
    responses: Sequence[np.ndarray],
    errors: Sequence[np.ndarray],
    lights: Sequence[Spectrum],
    surfaces: np.ndarray,
    places: np.ndarray,
    used: Sequence[np.ndarray],
    draws: int = DRAWS,
) -> Sensitivity:
    """Fit the sensitivities to responses to known surfaces.

    Bayes's rule with a Gaussian prior of the curves' logarithms, see `gpusim.fit.curve_prior`: the likeliest curves, by
    Gauss and Newton's method. Exposure, a slope of the light over the chart, and the relative errors of the
    reflectances are fitted along with it.

    Args:
        letters: Channels.
        responses: For each light, shape (24, C).
        errors: Their standard errors, for each light, shape (24, C).
        lights: Photons of each light, any unit.
        surfaces: Reflectances at NODES, shape (24, L).
        places: x and y of the patches on the chart, -1 to 1, shape (24, 2).
        used: Patches that are used, for each light, shape (24,).
        draws: Number of curves that the responses allow as well.

    Returns:
        The sensitivities.

    Source:
        Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), chapters 2, 3.4 and 5.
    """
    mean, covariance = curve_prior(tuple(letters))
    curves = _curves(mean, len(letters))
    charts, units = [], []
    for seen, noise, light, chosen in zip(responses, errors, lights, used, strict=True):
        weights = surfaces * product_weights(NODES, light)
        units.append(seen[chosen].sum() / (weights @ curves.T)[chosen].sum())
        weights = weights[chosen] * units[-1]
        charts.append(_Chart(weights, places[chosen], seen[chosen].T, noise[chosen].T))
    # the first exposure is the unit of the curves
    extra = np.tile([SCALE**2, SLOPE**2, SLOPE**2], len(charts))
    extra[0] = 1e-9
    mean = np.append(mean, np.zeros(len(extra)))
    covariance = scipy.linalg.block_diag(covariance, np.diag(extra))
    posterior = _Posterior(charts, mean, covariance)
    state = posterior.find()
    drawn = posterior.draw(state, draws)
    values = _curves(state, len(letters))
    top = values.max()
    exposures = state[len(mean) - len(extra) :].reshape(-1, 3)
    scales = np.array(units) * np.exp(exposures[:, 0])
    predicted = np.stack([
        scale * (1 + places @ slope)[:, None] * (surfaces * product_weights(NODES, light) @ values.T)
        for scale, slope, light in zip(scales, exposures[:, 1:], lights, strict=True)
    ])  # fmt: skip
    return Sensitivity(
        tuple(letters),
        values / top,
        np.array([_curves(one, len(letters)) / top for one in drawn]),
        scales * top,
        exposures[:, 1:],
        predicted,
        float(np.hypot(*posterior.sizes[1:])),
        posterior.evidence(state),
    )


def _curves(state, count):
    """Return curves (C, L) of a state: logarithms of curves, and then scales and slopes."""
    logs = state[: count * len(NODES)].reshape(count, -1)
    return np.maximum(np.exp(logs) - LEAST, 0)


class _Posterior:
    """Search of the likeliest states of charts, with a Gaussian prior (S,), (S, S)."""

    def __init__(self, charts, mean, covariance):
        self.charts, self.mean, self.covariance = charts, mean, covariance
        self.prior = scipy.linalg.cho_factor(covariance)
        self.seen = np.concatenate([one.seen.ravel() for one in charts])
        self.noise = np.concatenate([one.noise.ravel() for one in charts])
        blocks = [
            np.kron(np.ones((len(one.seen),) * 2), np.eye(one.seen.shape[1])) for one in charts
        ]
        self.alike = scipy.linalg.block_diag(*blocks) * np.outer(self.seen, self.seen)
        self.sizes = BREADTH[0], COMMON[2], SINGLE[1]

    def errors(self, common, single):
        """Return the covariance of the responses' errors, (M, M)."""
        return common**2 * self.alike + np.diag(self.noise**2 + (single * self.seen) ** 2)

    def find(self):
        """Return the likeliest state, and set the sizes of errors that are likeliest."""
        state = self.mean
        for number in range(ROUNDS):
            if number in NOISE_ROUNDS:
                miss, slopes = self._straighten(state, self.seen, self.mean)
                spread = slopes @ self.covariance @ slopes.T
                self.sizes = max(
                    product(BREADTH, COMMON, SINGLE),
                    key=lambda sizes: self._weigh(miss, spread, sizes),
                )
            state, size = self._step(state, self.seen, self.mean)
            if number > max(NOISE_ROUNDS) and size < DONE:
                break
        return state

    def evidence(self, state):
        """Return the logarithm of the likelihood of all curves together, around a state."""
        miss, slopes = self._straighten(state, self.seen, self.mean)
        return float(self._weigh(miss, slopes @ self.covariance @ slopes.T, self.sizes))

    def draw(self, state, count):
        """Return random states, (count, S): the likeliest ones of responses and priors with random errors.

        Source: Bardsley et al., Randomize-then-optimize, SIAM J. Sci. Comput. 36 (2014), A1895.
        """
        random = np.random.default_rng(1)
        roots = [
            np.linalg.cholesky(one)
            for one in (self.errors(*self.sizes[1:]), self.sizes[0] * self.covariance)
        ]
        found = []
        for _ in range(count):
            seen = self.seen + roots[0] @ random.normal(size=len(self.seen))
            mean = self.mean + roots[1] @ random.normal(size=len(self.mean))
            one = state
            for _ in range(DRAW_ROUNDS):
                one, _ = self._step(one, seen, mean)
            found.append(one)
        return np.array(found)

    def _straighten(self, state, seen, mean):
        """Return misses of the prior's mean, (M,), and derivatives, (M, S), of the model made linear around a state."""
        model, slopes = _expose(self.charts, state)
        return seen - model + slopes @ (state - mean), slopes

    def _weigh(self, miss, spread, sizes):
        factor = scipy.linalg.cho_factor(sizes[0] * spread + self.errors(*sizes[1:]))
        return -0.5 * miss @ scipy.linalg.cho_solve(factor, miss) - np.log(np.diag(factor[0])).sum()

    def _step(self, state, seen, mean):
        """Return the state after a step of Gauss and Newton's, shortened until it pays, and its largest change."""
        error = self.errors(*self.sizes[1:])
        factor = scipy.linalg.cho_factor(error)

        def cost(one):
            miss, away = seen - _expose(self.charts, one)[0], one - mean
            return (
                miss @ scipy.linalg.cho_solve(factor, miss)
                + away @ scipy.linalg.cho_solve(self.prior, away) / self.sizes[0]
            )

        miss, slopes = self._straighten(state, seen, mean)
        own = self.sizes[0] * self.covariance @ slopes.T
        step = mean + own @ np.linalg.solve(slopes @ own + error, miss) - state
        before = cost(state)
        while np.abs(step).max() > DONE and not cost(state + step) <= before:
            step = step / 2
        return state + step, np.abs(step).max()


def _expose(charts, state):
    """Return the responses of all charts (M,), and their derivatives along the state (M, S)."""
    count = len(charts[0].seen)
    size = len(NODES)
    growth = np.exp(state[: count * size].reshape(count, size))
    models, slopes = [], []
    for number, chart in enumerate(charts):
        at = count * size + 3 * number
        light = 1 + chart.places @ state[at + 1 : at + 3]
        weights = np.exp(state[at]) * light[:, None] * chart.weights
        model = (growth - LEAST) @ weights.T
        own = np.zeros((*model.shape, len(state)))
        for k in range(count):
            own[k, :, k * size : (k + 1) * size] = weights * growth[k]
        own[:, :, at] = model
        own[:, :, at + 1 : at + 3] = model[:, :, None] * (chart.places / light[:, None])
        models.append(model.ravel())
        slopes.append(own.reshape(-1, len(state)))
    return np.concatenate(models), np.concatenate(slopes)


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

"""Tests for noise outside the model, each with a known rate of false alarms."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gpusim.fit.intervals import chance_of, chance_of_normal
from gpusim.fit.levels import Level
from gpusim.fit.stack import LAGS

ALARM = 3e-4  # rate of false alarms of each test
LINE_LAGS = 8
TAIL_PIXELS = 200_000


@dataclass(frozen=True)
class Finding:
    """Result of a test.

    Args:
        words: The finding, with its size.
        chance: Probability of as much or more if the model is right.
    """

    words: str
    chance: float


def neighbour_findings(level: Level, where: str) -> list[Finding]:
    """Test whether neighbours are correlated, over the residuals of one level."""
    found = []
    for index, (down, right) in enumerate(LAGS):
        sums = [lags[index] for lags in level.lags]
        number = sum(count for _, count in sums)
        mean = sum(product * count for product, count in sums) / number
        # removed rows and columns leave a correlation of -1 / n
        rows, cols = level.shape
        expected = -1 / cols * (down == 0) - 1 / rows * (right == 0)
        chance = chance_of_normal((mean - expected) * math.sqrt(number)) * len(LAGS)
        words = (
            f"pixels {down} rows and {right} columns apart are correlated in {where}: {mean:+.4f}"
        )
        found.append(Finding(words, min(chance, 1.0)))
    return found


def spectrum_findings(level: Level, where: str) -> list[Finding]:
    """Test the spectra along rows and along columns for lines and for colour."""
    found = []
    for name, spectra, lines in (
        ("rows", level.spectra[0], level.shape[0]),
        ("columns", level.spectra[1], level.shape[1]),
    ):
        power = np.mean(spectra, axis=0)[:-1]  # the last has half as many degrees of freedom
        if len(power) < 4:
            continue
        freedom = 2 * lines * len(spectra)
        relative = power / power.mean()
        error = math.sqrt(2 / freedom)
        worst = int(np.argmax(relative))
        chance = chance_of(float(relative[worst]) * freedom, freedom) * len(power)
        period = 2 * (len(power) + 1) / (worst + 1)
        found.append(
            Finding(
                f"a period of {period:.3g} pixels along {name} in {where}: "
                f"{relative[worst] - 1:+.1%} power",
                min(chance, 1.0),
            )
        )
        squares = float(np.sum(((relative - 1) / error) ** 2))
        found.append(
            Finding(
                f"the spectrum along {name} of {where} is not flat: {np.std(relative):.2%} rms, "
                f"noise explains {error:.2%}",
                chance_of(squares, len(power) - 1),
            )
        )
    return found


def banding_findings(level: Level, where: str) -> list[Finding]:
    """Test whether rows', and columns', temporal means are independent of each other."""
    found = []
    for name, series in (("rows", level.rows), ("columns", level.columns)):
        count, length = series.shape
        if length < 16:
            continue
        white = series / max(float(np.std(series)), 1e-12)
        power = np.abs(np.fft.rfft(white, axis=1))[:, 1:-1] ** 2 / length
        total = power.sum(axis=0) / power.mean()
        worst = int(np.argmax(total))
        # the sum of count exponential numbers is half a chi-square of 2 count degrees
        chance = chance_of(2 * float(total[worst]), 2 * count) * len(total)
        period = length / (worst + 1)
        found.append(
            Finding(
                f"banding of {name} with a period of {period:.3g} pixels in {where}: "
                f"{total[worst] / count:.2f} times the mean power",
                min(chance, 1.0),
            )
        )
        lags = range(1, min(LINE_LAGS, length // 4) + 1)
        correlations = np.array(
            [np.mean(white[:, lag:] * white[:, :-lag]) + 1 / length for lag in lags]
        )
        counts = np.array([count * (length - lag) for lag in lags])
        squares = float(np.sum(counts * correlations**2))
        found.append(
            Finding(
                f"{name} next to each other have noise in common in {where}: "
                f"correlation {correlations[0]:+.3f} at 1, {correlations[-1]:+.3f} at {lags[-1]}",
                chance_of(squares, len(counts)),
            )
        )
    return found


@dataclass(frozen=True)
class Tails:
    """The distribution of read noise that fits best.

    Args:
        name: "Gaussian", "Student" or "Tukey lambda".
        shape: Degrees of freedom of Student's, or lambda of Tukey's; None for a Gaussian.
        gain: Akaike's criterion of the Gaussian less this one's.
        values: Sample of standardised residuals.
        kurtosis: Excess kurtosis.
    """

    name: str
    shape: float | None
    gain: float
    values: np.ndarray
    kurtosis: float


def find_tails(residual: np.ndarray, deviation: float, step: float) -> Tails:
    """Choose a distribution of residuals by likelihood, with Akaike's criterion.

    Rounding adds an even distribution of one step: the density of a rounded value is a difference
    of the distribution function.

    Args:
        residual: Residuals of good pixels [DN], shape (n,).
        deviation: Their standard deviation [DN].
        step: Step of rounding [DN], 0 for none.

    Source:
        Tukey's lambda: Wei et al., "A physics-based noise formation model for extreme low-light raw
        denoising", CVPR 2020; Akaike, IEEE Trans. Autom. Control 19 (1974), 716.
    """
    import scipy.optimize

    stride = max(1, len(residual) // TAIL_PIXELS)
    values = residual[::stride].astype(np.float64) / deviation
    values = values - values.mean()
    half = max(step / deviation / 2, 1e-3)
    reach = max(8.0, float(np.abs(values).max())) + 0.1
    counts, edges = np.histogram(values, np.linspace(-reach, reach, 2001))
    places, counts = (edges[1:] + edges[:-1])[counts > 0] / 2, counts[counts > 0]

    def cost(parameters, cumulative):
        scale = math.exp(parameters[0])
        shape = parameters[1:]
        upper = cumulative((places + half) / scale, *shape)
        lower = cumulative((places - half) / scale, *shape)
        return -float(counts @ np.log(np.maximum(upper - lower, 1e-15)))

    best = {}
    for name, cumulative, starts in (
        ("Gaussian", _normal, [()]),
        ("Student", _student, [(math.log(8.0),)]),
        ("Tukey lambda", _tukey, [(0.1,)]),
    ):
        found = [
            scipy.optimize.minimize(
                cost,
                (-0.01 - (name == "Tukey lambda") * 0.4, *start),
                (cumulative,),
                method="Nelder-Mead",
                options={"maxiter": 60, "xatol": 1e-3, "fatol": 0.3},
            )
            for start in starts
        ]
        least = min(found, key=lambda one: one.fun)
        best[name] = 2 * least.fun + 2 * len(least.x), least.x
    gaussian = best["Gaussian"][0]
    name = min(best, key=lambda one: best[one][0])
    # a margin: twice the logarithm of the rate of false alarms
    if gaussian - best[name][0] < -2 * math.log(ALARM):
        name = "Gaussian"
    shape = None if name == "Gaussian" else float(best[name][1][1])
    if name == "Student" and shape is not None:
        shape = math.exp(shape)
    kurtosis = float(np.mean(values**4) / np.mean(values**2) ** 2 - 3)
    return Tails(name, shape, gaussian - best[name][0], values, kurtosis)


def _normal(x):
    import scipy.special

    return scipy.special.ndtr(x)


def _student(x, log_freedom):
    import scipy.special

    return scipy.special.stdtr(math.exp(min(log_freedom, 12.0)), x)


def _tukey(x, shape):
    import scipy.special

    return scipy.special.tklmbda(x, shape)


def alarms(findings: Sequence[Finding]) -> list[Finding]:
    """Return the findings that noise hardly explains, the least probable first."""
    found = [one for one in findings if one.chance < ALARM]
    return sorted(found, key=lambda one: one.chance)

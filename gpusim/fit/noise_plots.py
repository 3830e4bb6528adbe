"""Figures of the noise: fits, residuals, spectra, distributions."""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from gpusim.fit.estimate import Plot
from gpusim.fit.noise import IsoFit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {"R": "#d1495b", "G": "#2e8b57", "B": "#3d6fb6", "": "#888888"}


def noise_plots(fits: Sequence[IsoFit]) -> tuple[Plot, ...]:
    """Return the figures of all ISO speeds."""
    found = []
    for fit in fits:
        end = f", ISO {fit.iso:g}" if fit.iso is not None else ""
        transfer = fit.transfer
        found.append(
            Plot(
                f"Photon transfer{end}",
                f"Temporal variance over signal, and residuals in standard errors. Gain "
                f"{transfer.gain.value:.4g} DN/e-, chi-square {transfer.line.chi_square:.0f} for "
                f"{transfer.line.freedom} degrees of freedom.",
                partial(_transfer, fit),
            )
        )
        if fit.linearity is not None:
            found.append(
                Plot(
                    f"Linearity{end}",
                    "Deviation of the signal from the line over exposure, relative to the largest signal.",
                    partial(_linearity, fit),
                )
            )
        if len(set(fit.dark_line.times)) > 1:
            found.append(
                Plot(
                    f"Dark signal{end}",
                    "Mean of dark frames over exposure time, with the line of dark current.",
                    partial(_dark, fit),
                )
            )
        if fit.darks:
            found.append(
                Plot(
                    f"Spectra of dark frames{end}",
                    "Power of temporal noise along rows and along columns relative to white noise. A peak is "
                    "a periodic pattern, a slope is coloured noise.",
                    partial(_spectra, fit),
                )
            )
        if fit.tails is not None:
            found.append(
                Plot(
                    f"Distribution of read noise{end}",
                    f"Residuals of dark pixels over their standard deviation, and a Gaussian. Best by "
                    f"likelihood: {fit.tails.name}.",
                    partial(_tails, fit),
                )
            )
        if fit.offsets is not None:
            found.append(
                Plot(
                    f"Fixed patterns{end}",
                    "Means of rows and columns of dark frames, and of the response of flats.",
                    partial(_patterns, fit),
                )
            )
    return tuple(found)


def _colour(letter):
    return COLOURS.get(letter, "#a56cc1")


def _transfer(fit: IsoFit, figure: "Figure") -> None:
    top, bottom = figure.subplots(2, sharex=True, height_ratios=(2, 1))
    transfer = fit.transfer
    letters = np.array(transfer.letters)
    residuals = (transfer.variance - transfer.line.at(transfer.signal)) / transfer.errors
    for letter in dict.fromkeys(transfer.letters):
        chosen = letters == letter
        name = letter or "dark"
        top.plot(
            transfer.signal[chosen],
            transfer.variance[chosen],
            "o",
            ms=4,
            color=_colour(letter),
            label=name,
        )
        bottom.plot(transfer.signal[chosen], residuals[chosen], "o", ms=4, color=_colour(letter))
    x = np.array([0, transfer.signal.max()])
    top.plot(x, transfer.line.at(x), "-", color="#888888", lw=1)
    top.set_ylabel("variance [DN²]")
    top.legend()
    bottom.axhline(0, color="#888888", lw=1)
    bottom.set(xlabel="signal above black [DN]", ylabel="residual [s.e.]")


def _linearity(fit: IsoFit, figure: "Figure") -> None:
    axes = figure.subplots()
    linear = fit.linearity
    assert linear is not None
    letters = np.array(linear.letters)
    for letter in dict.fromkeys(linear.letters):
        chosen = letters == letter
        top = linear.signal[chosen].max() / 100
        deviations = (linear.signal - linear.fitted)[chosen] / top
        axes.errorbar(
            linear.signal[chosen],
            deviations,
            1.96 * linear.errors[chosen] / top,
            fmt="o-",
            ms=4,
            lw=1,
            color=_colour(letter),
            label=letter,
        )
    axes.axhline(0, color="#888888", lw=1)
    axes.set(xlabel="signal above black [DN]", ylabel="deviation [%]")
    axes.legend()


def _dark(fit: IsoFit, figure: "Figure") -> None:
    axes = figure.subplots()
    line = fit.dark_line
    for degree in dict.fromkeys(line.degrees):
        chosen = np.array([one == degree for one in line.degrees])
        name = "dark frames" if degree is None else f"{degree:g} °C"
        axes.errorbar(
            line.times[chosen],
            line.means[chosen],
            1.96 * line.errors[chosen],
            fmt="o",
            ms=4,
            label=name,
        )
        if degree in line.rates:
            x = np.array([0, line.times[chosen].max()])
            axes.plot(x, line.black + line.rates[degree][0] * x, "-", color="#888888", lw=1)
    axes.set(xlabel="exposure time [s]", ylabel="mean [DN]")
    axes.legend()


def _spectra(fit: IsoFit, figure: "Figure") -> None:
    axes = figure.subplots()
    dark = max(fit.darks, key=lambda level: level.count)
    for name, spectra in zip(("along rows", "along columns"), dark.spectra, strict=True):
        power = np.mean(spectra, axis=0)[:-1]
        axes.plot(
            (np.arange(len(power)) + 1) / (2 * len(power) + 2),
            power / power.mean(),
            lw=1,
            label=name,
        )
    axes.set(xlabel="frequency [cycles/pixel]", ylabel="power, relative")
    axes.legend()


def _tails(fit: IsoFit, figure: "Figure") -> None:
    axes = figure.subplots()
    assert fit.tails is not None
    values = fit.tails.values
    reach = min(max(4.5, float(np.abs(values).max())), 12.0)
    counts, edges = np.histogram(values, np.linspace(-reach, reach, 81))
    middle, width = (edges[1:] + edges[:-1]) / 2, edges[1] - edges[0]
    axes.semilogy(middle, counts / counts.sum() / width, "o", ms=3, label="dark pixels")
    axes.semilogy(
        middle,
        np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi),
        color="#888888",
        lw=1,
        label="Gaussian",
    )
    axes.set(
        ylim=(max(0.3 / counts.sum() / width, 1e-9), 1),
        xlabel="residual [standard deviations]",
        ylabel="density",
    )
    axes.legend()


def _patterns(fit: IsoFit, figure: "Figure") -> None:
    rows = figure.subplots(2 if fit.response is not None else 1, squeeze=False)[:, 0]
    for axes, pattern, unit, factor in (
        (rows[0], fit.offsets, "offset [DN]", 1.0),
        (rows[-1], fit.response, "response [%]", 100.0),
    ):
        if pattern is None:
            continue
        step = max(1, max(pattern.values.shape) // 2000)
        axes.plot(
            np.arange(len(pattern.row_means))[::step],
            factor * pattern.row_means[::step],
            lw=0.8,
            label="rows",
        )
        axes.plot(
            np.arange(len(pattern.column_means))[::step],
            factor * pattern.column_means[::step],
            lw=0.8,
            label="columns",
        )
        axes.set(ylabel=unit)
        axes.legend(loc="upper right")
    rows[-1].set_xlabel("row or column")

"""Figures of a comparison: noise of real and simulated frames side by side."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from gpusim.fit.estimate import Plot
from gpusim.fit.noise_sums import BANDS, EDGES, NoiseSums

REAL, SIMULATED = "#c2410c", "#1d4ed8"


def noise_plots(groups: Sequence[tuple], channels: tuple[str, ...]) -> list[Plot]:
    """Return the figures of groups of darks and flats.

    Args:
        groups: Each group with its real and its simulated sums.
        channels: Letters of the channels.
    """
    plots = []
    if groups:
        plots.append(
            Plot(
                "Variance by group",
                "Temporal variance of each channel at equal mean levels, real over simulated.",
                partial(_draw_variances, groups=groups, channels=channels),
            )
        )
    for group, real, simulated in groups:
        plots.append(
            Plot(
                group.words,
                "Residuals, in standard deviations of the simulated noise, and power of the noise along rows and "
                "columns, 1 for white noise.",
                partial(_draw_group, real=real, simulated=simulated),
            )
        )
    return plots


def _draw_variances(figure, groups, channels):
    axes = figure.subplots()
    places = np.arange(len(groups))
    for number, letter in enumerate(channels):
        ratios = []
        for _, real, simulated in groups:
            sums = [
                one.squares[:, number].sum() / one.numbers[:, number].sum()
                for one in (real, simulated)
            ]
            ratios.append(sums[0] / max(sums[1], 1e-12))
        axes.plot(places, ratios, "o-", label=letter)
    axes.axhline(1, color="0.6", linewidth=0.8)
    axes.set_xticks(
        places, [group.words for group, *_ in groups], rotation=20, ha="right", fontsize=7
    )
    axes.set_ylabel("variance, real / simulated")
    axes.legend(frameon=False)


def _draw_group(figure, real: NoiseSums, simulated: NoiseSums):
    left, right = figure.subplots(1, 2)
    centres = (EDGES[:-1] + EDGES[1:]) / 2
    frequencies = (np.arange(BANDS) + 0.5) / (2 * BANDS)
    for sums, color, word in ((real, REAL, "real"), (simulated, SIMULATED, "simulated")):
        counts = sums.bins.sum(axis=(0, 1))
        density = counts[:-1] / np.diff(EDGES) / counts.sum() / 2
        shown = density > 0
        left.semilogy(centres[shown], density[shown], "o-", color=color, label=word, markersize=3)
        right.plot(
            frequencies, sums.along_rows.mean(axis=0), "-", color=color, label=f"{word}, rows"
        )
        right.plot(
            frequencies,
            sums.along_columns.mean(axis=0),
            "--",
            color=color,
            label=f"{word}, columns",
        )
    left.set(xlabel="|residual| [standard deviations]", ylabel="density")
    right.set(xlabel="frequency [cycle/pixel]", ylabel="power")
    for axes in (left, right):
        axes.legend(frameon=False, fontsize=8)

"""The part of a camera that dark frames and flats give: estimates, settings, findings."""

import math
from collections.abc import Sequence
from itertools import chain

import numpy as np

from gpusim.fit.darks import fit_doubling
from gpusim.fit.estimate import Estimate, Part
from gpusim.fit.findings import (
    Finding,
    alarms,
    banding_findings,
    neighbour_findings,
    spectrum_findings,
)
from gpusim.fit.intervals import Range, normal_range, root_of, widened
from gpusim.fit.noise import IsoFit, line_of_reads
from gpusim.fit.noise_plots import noise_plots
from gpusim.fit.rounding import FINE
from gpusim.fit.sorting import Summary
from gpusim.fit.steps import curve_lines
from gpusim.fit.transfer import chance_of_channels, chance_of_curvature, read_of
from gpusim.fit.unknown import known_white, unknown_lines

PATTERNS = ("pixel", ""), ("row", "row_"), ("column", "column_")
FEW = 0.03  # excess kurtosis that is no tail
BLACK_NOTES = {
    "darks": "",
    "clipped": "of a normal distribution whose values below 0 are clipped",
    "hidden": "bounds: nearly all dark values are 0",
    "stated": "stated by the files, not measured",
    "bounds": "bounds: below the darkest pixels, and not so low that their noise would be below 0",
}
USUAL_BITS = (8, 10, 12, 14, 16)
PROFILE = 0.1  # relative difference from a file's noise profile that is worth a line


def noise_part(fits: Sequence[IsoFit], summaries: Sequence[Summary]) -> Part:
    """Return the noise's part of a camera.

    Args:
        fits: Fits of all ISO speeds, the lowest first.
        summaries: The shots behind them.

    Returns:
        Estimates of every speed; the lowest speed's become settings.
    """
    estimates: dict[str, Estimate] = {}
    for fit in fits:
        end = f" at ISO {fit.iso:g}" if fit.iso is not None and len(fits) > 1 else ""
        estimates |= {f"{key}{end}": one for key, one in _estimates(fit).items()}
    estimates |= _common_estimates(fits)
    unexplained = list(chain.from_iterable(_unexplained(fit, len(fits) > 1) for fit in fits))
    unexplained += _profile_lines(fits[0], summaries) + curve_lines(summaries)
    return Part(
        "noise",
        estimates,
        _settings(fits, estimates, summaries),
        noise_plots(fits),
        tuple(unexplained),
        tuple(unknown_lines(fits, estimates, summaries)),
    )


def _estimates(fit):
    """Return the estimates of one ISO speed by camera key."""
    darks, flats = (
        tuple(dict.fromkeys(chain.from_iterable(level.names for level in levels)))
        for levels in (fit.darks, fit.flats)
    )
    both = darks + flats

    def estimate(range_, unit, sources, note=""):
        return Estimate(*map(float, range_), unit, sources, note)

    read_note = "all noise of one read of a pixel"
    if fit.bounded_read is not None:
        read_note = "bounds: the black level is not known"
    elif fit.black_source == "clipped":
        read_note += ", from dark frames that are clipped at 0"
    elif fit.dark_deviation < FINE or (fit.darks and fit.read.low == 0):
        read_note = "rounding hides most of it"
    found = {
        "sensor.gain_dn_per_e": estimate(fit.transfer.gain, "DN/e-", both),
        "sensor.black_level_dn": estimate(
            fit.black, "DN", darks or flats, BLACK_NOTES[fit.black_source]
        ),
        "noise.read_e": estimate(fit.read, "e-", both, read_note),
        "noise.row_e": estimate(fit.in_electrons(fit.row), "e-", both),
        "noise.column_e": estimate(fit.in_electrons(fit.column), "e-", both),
    }
    for letter, line in fit.transfer.by_channel.items():
        error = math.sqrt(line.covariance[1, 1])
        key = f"sensor.gain_dn_per_e of {letter}"
        found[key] = estimate(normal_range(line.slope, error), "DN/e-", both)
        if not fit.darks and fit.bounded_read is None:
            found[f"noise.read_e of {letter}"] = estimate(read_of(line), "e-", both)
    full_well = full_well_of(fit)
    if full_well is not None:
        found["sensor.full_well_e"] = estimate(full_well, "e-", flats)
    if fit.transfer.white is not None:
        white = fit.transfer.white
        found["sensor.white_level_dn"] = estimate((white, white, white), "DN", flats)
    for name, start in PATTERNS:
        if fit.offsets is not None:
            variance = getattr(fit.offsets, name)
            found[f"noise.{start}dsnu_e"] = estimate(fit.in_electrons(variance), "e-", darks)
        if fit.response is not None:
            variance = getattr(fit.response, name)
            found[f"noise.{start}prnu"] = estimate(root_of(variance), "", flats)
    for degree, (rate, error) in fit.dark_line.rates.items():
        key = "noise.dark_current_e_per_s" + ("" if degree is None else f" at {degree:g} deg C")
        range_ = widened(normal_range(rate, error).scaled(1 / fit.gain), fit.gain_spread)
        found[key] = estimate(range_, "e-/s", darks)
    if fit.hot is not None:
        found["noise.hot_pixels"] = estimate(
            fit.hot.share, "", darks, f"{fit.hot.count} pixels lie far above the others"
        )
        found["noise.hot_current_e_per_s"] = estimate(
            fit.hot.scale.scaled(1 / fit.gain), "e-/s", darks
        )
    if fit.response is not None:
        found["noise.dead_pixels"] = estimate(fit.dead, "", flats)
    if fit.restless.value * fit.good.size >= 3:
        found["noise.telegraph_pixels"] = estimate(
            fit.restless, "", darks, "whose variance over the frames is far above the others'"
        )
    if fit.linearity is not None:
        found["nonlinearity"] = estimate(
            fit.linearity.nonlinearity,
            "%",
            flats,
            "largest deviation from a line, of the largest signal",
        )
    if fit.drift is not None:
        found["drift"] = estimate(fit.drift.slope, "DN/frame", darks, "of the black level")
    if fit.tails is not None:
        found |= _tail_estimates(fit, darks, estimate)
    return found


def _tail_estimates(fit, darks, estimate):
    tails = fit.tails
    error = math.sqrt(24 / max(len(tails.values), 1))
    note = tails.name if tails.shape is None else f"{tails.name}, shape {tails.shape:.3g}"
    range_ = normal_range(tails.kurtosis, error)
    return {
        "tails": estimate(range_, "", darks, f"excess kurtosis of the read noise; best: {note}")
    }


def full_well_of(fit: IsoFit) -> Range | None:
    """Return the full well [e-], or None: it was not reached, or the converter was full first."""
    levels = fit.transfer.saturation
    if not levels or fit.transfer.is_converter:
        return None
    values = np.array(list(levels.values()))
    # the pattern of offsets and the noise of a median
    error = (fit.dark_deviation * 1.25 / math.sqrt(fit.good.size / len(values))) / fit.gain
    value = float(values.mean() - fit.black.value) / fit.gain
    black = (fit.black.high - fit.black.low) / 3.92 / fit.gain
    return widened(normal_range(value, math.hypot(error, black)), fit.gain_spread)


def _common_estimates(fits):
    """Return estimates from all ISO speeds together."""
    found = {}
    sources = tuple(
        dict.fromkeys(name for fit in fits for level in fit.darks for name in level.names)
    )
    reads = line_of_reads(fits)
    if reads is not None:
        read, adc, _ = reads
        words = "read noise at every ISO speed is read^2 + (adc / gain)^2"
        found["noise.read_e"] = Estimate(*read, "e-", sources, f"before the gain; {words}")
        found["noise.adc_dn"] = Estimate(*adc, "DN", sources, words)
    doubling = fit_doubling(fits[0].dark_line.rates)
    if doubling is not None:
        found["noise.doubling_k"] = Estimate(*doubling[0], "K", sources)
    return found


def _settings(fits, estimates, summaries):
    """Return values of the camera file by section and key."""
    fit = fits[0]
    black = max(math.floor(fit.black.value + 0.5), 0)
    top = max(one.highest for one in summaries)
    white = known_white(fit, summaries)
    if white is None and fit.is_whole:
        white = next((2.0**bits - 1 for bits in USUAL_BITS if 2.0**bits > top), top)
    white = max(white or top, top)
    sensor = {
        "cfa": list(summaries[0].frame.cfa),
        "bits": min(max(math.ceil(math.log2(white + 1)), 1), 16) if fit.is_whole else 32,
        "black_level_dn": black,
        "gain_dn_per_e": fit.gain,
        "analog_offset_e": (fit.black.value - black) / fit.gain,
    }
    well = next((full_well_of(one) for one in fits if full_well_of(one)), None)
    sensor["full_well_e"] = well.value if well else (white - fit.black.value) / fit.gain
    noise = dict.fromkeys(
        (
            *(
                "read_e",
                "reset_e",
                "adc_dn",
                "row_e",
                "column_e",
                "dsnu_e",
                "row_dsnu_e",
                "column_dsnu_e",
            ),
            *(
                "prnu",
                "row_prnu",
                "column_prnu",
                "dark_current_e_per_s",
                "hot_pixels",
                "dead_pixels",
            ),
            "telegraph_pixels",
        ),
        0.0,
    )
    speed = f" at ISO {fit.iso:g}" if fit.iso is not None and len(fits) > 1 else ""
    for key in noise:
        found = estimates.get(f"noise.{key}") or estimates.get(f"noise.{key}{speed}")
        if found is not None and (found.low > 0 or key == "read_e"):
            noise[key] = max(found.value, 0.0)
    if noise["hot_pixels"]:
        noise["hot_current_e_per_s"] = fit.hot.scale.value / fit.gain
    if noise["telegraph_pixels"]:
        noise["telegraph_e"] = fit.jump / fit.gain
    return {"sensor": sensor, "noise": noise | _temperatures(fit, estimates)}


def _temperatures(fit, estimates):
    """Return dark current, its temperature and its doubling, if the temperature is known."""
    rates = {degree: pair for degree, pair in fit.dark_line.rates.items() if degree is not None}
    if not rates:
        return {}
    doubling = fit_doubling(fit.dark_line.rates)
    if doubling is None:
        degree = min(rates, key=lambda one: rates[one][1])  # the best known
        rate = rates[degree][0]
        found = {}
    else:
        range_, degree, rate = doubling
        found = {"doubling_k": min(max(range_.value, 0.1), 1000.0)}
    return found | {
        "dark_current_e_per_s": max(rate, 0.0) / fit.gain,
        "temperature_c": float(degree),
        "reference_temperature_c": float(degree),
    }


def findings_of(fit: IsoFit) -> list[Finding]:
    """Return the results of all tests of one ISO speed."""
    found: list[Finding] = []
    if fit.darks:
        dark = max(fit.darks, key=lambda level: level.count)
        if fit.black_source == "darks":  # clipping mixes noise of rows with the fixed pattern
            found += neighbour_findings(dark, "dark frames")
            found += spectrum_findings(dark, "dark frames")
        found += banding_findings(dark, "dark frames")
    bright = [level for level in fit.flats if not level.clipped and level.lags]
    if bright:
        found += neighbour_findings(bright[-1], f"flats ({bright[-1].names[0]})")
    transfer = fit.transfer
    low, high = transfer.gains
    bend = transfer.curvature[0] * transfer.signal.max() / max(transfer.line.slope, 1e-12)
    found.append(
        Finding(
            f"the variance is no line over the signal: {bend:+.1%} of its slope at the largest signal",
            chance_of_curvature(transfer),
        )
    )
    found.append(
        Finding(
            "variances scatter about their line more than their errors: chi-square "
            f"{transfer.line.chi_square:.0f} for {transfer.line.freedom}; gains from {low:.4g} to {high:.4g} DN/e-",
            transfer.line.chance,
        )
    )
    slopes = {letter: line.slope for letter, line in transfer.by_channel.items()}
    found.append(
        Finding(
            f"channels have different gains: {', '.join(f'{k} {v:.4g}' for k, v in slopes.items())} DN/e-",
            chance_of_channels(transfer),
        )
    )
    if fit.linearity is not None:
        found.append(
            Finding(
                f"the response is not linear: {fit.linearity.nonlinearity.value:+.2f} % of the largest "
                "signal from a line",
                fit.linearity.chance,
            )
        )
    if fit.drift is not None:
        found.append(
            Finding(
                f"the black level drifts: frames' means scatter by {fit.drift.scatter:.3g} DN, noise "
                f"explains {fit.drift.expected:.3g} DN",
                fit.drift.chance,
            )
        )
    found.append(Finding("the dark signal is no line over exposure time", fit.dark_line.chance))
    return found


def has_tails(fit: IsoFit) -> bool:
    """Return whether read noise is not Gaussian, and single electrons of dark current do not explain it."""
    tails = fit.tails
    if tails is None or tails.name == "Gaussian":
        return False
    dark = max(fit.darks, key=lambda level: level.count)
    rates = [rate for rate, _ in fit.dark_line.rates.values()]
    signal = max(rates, default=0.0) * (dark.exposure_time or 0.0)
    variance = np.mean([point.variance for point in dark.points.values()])
    # the fourth cumulant of d electrons is gain^4 d
    expected = fit.gain**3 * max(signal, 0.0) / variance**2
    return bool(abs(tails.kurtosis) > 2 * expected + FEW)


def _unexplained(fit, has_several):
    """Return lines about findings outside the model at one ISO speed."""
    end = f" (ISO {fit.iso:g})" if has_several and fit.iso is not None else ""
    for one in alarms(findings_of(fit)):
        yield f"{one.words}{end}"
    if has_tails(fit):
        yield (
            f"read noise has the tails of a {fit.tails.name} distribution (shape {fit.tails.shape:.3g}, "
            f"excess kurtosis {fit.tails.kurtosis:+.2f}), the camera's is Gaussian{end}"
        )
    if fit.black_source == "clipped":
        yield (
            f"dark pixels reach 0 DN: the black level, {fit.black.value:.3g} DN, is too low for noise of "
            f"{fit.dark_deviation:.3g} DN; both are estimated as of a normal distribution, hot pixels are rough{end}"
        )
    if fit.black_source == "hidden":
        yield f"nearly all values of dark frames are 0 DN: their noise cannot be measured{end}"


def _profile_lines(fit, summaries):
    """Compare the noise with the profile that a DNG states."""
    for one in summaries:
        frame = one.frame
        if frame.noise_profile is None or frame.white_level is None or frame.iso != fit.iso:
            continue
        black = float(np.mean(frame.black_level)) if frame.black_level is not None else 0.0
        stated = float(frame.noise_profile[:, 0].mean()) * (frame.white_level - black)
        if (
            abs(stated / fit.gain - 1) > PROFILE
            and not fit.transfer.gain.low < stated < fit.transfer.gain.high
        ):
            return [
                f"the NoiseProfile in {frame.name} states a gain of {stated:.4g} DN/e-, measured are "
                f"{fit.gain:.4g}: the profile is a model's, or the raw values were processed"
            ]
        return []
    return []

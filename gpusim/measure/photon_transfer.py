"""Photon transfer (EMVA 1288): gain, noise, saturation and nonuniformity of a linear camera."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.raw_noise import ROUNDING
from gpusim.domain.short_repr import short_repr

# [DN^2]; rounding hides smaller dark noise, and the standard uses this value
LEAST_DARK_VARIANCE = 0.24
FIT = 0.7  # part of saturation up to which lines are fitted
LINEAR = 0.05, 0.95  # parts of saturation between which linearity is judged
MIDDLE = 0.3, FIT  # part of saturation at which PRNU may be measured; the standard aims at 0.5
# fields of the result that `sensor_from_emva1288` takes
FIGURES = "gain", "quantum_efficiency", "saturation_capacity", "dark_noise", "dark_current"
NONUNIFORMITIES = "dsnu", "dsnu_row", "dsnu_column", "prnu", "prnu_row", "prnu_column"


@dataclass(frozen=True, eq=False)
class PhotonTransfer:
    """Results of `photon_transfer` in the standard's terms.

    None: not measured; NaN: below the resolution of the frames.

    Attributes:
        gain: K [DN/e-].
        responsivity: R [DN/photon].
        quantum_efficiency: eta = R / K [e-/photon].
        dark_noise: sigma_d [e-], without quantisation.
        dark_noise_dn: sigma_y.dark [DN], with quantisation.
        quantisation_limited: whether dark_noise_dn was below sqrt(0.24) DN and replaced by it; both
            dark noises are then upper bounds.
        sensitivity_threshold: mu_p.min [photon], the light with a signal-to-noise ratio of 1.
        saturation_photons: mu_p.sat [photon].
        saturation_capacity: mu_e.sat [e-].
        snr_max: square root of saturation_capacity [1].
        dynamic_range: mu_p.sat / mu_p.min [1].
        linearity_error: mean absolute relative deviation from a line [%].
        linearity_min: least relative deviation [%].
        linearity_max: greatest relative deviation [%].
        photons: mu_p of the photon transfer curve, shape (E,) [photon].
        signal: mu_y - mu_y.dark of the curve, shape (E,) [DN].
        variance: sigma^2_y - sigma^2_y.dark of the curve, shape (E,) [DN^2].
        saturation_level: index of the saturated level.
        dsnu: dark-signal nonuniformity [e-]; dsnu_row, dsnu_column and dsnu_pixel are its parts.
        prnu: photo-response nonuniformity [%]; prnu_row, prnu_column and prnu_pixel are its parts.
        dark_current: mu_I from the mean [e-/s].
        dark_current_from_variance: mu_I from the variance [e-/s]: needs no stable offset but is
            noisier.
    """

    gain: float
    responsivity: float
    quantum_efficiency: float
    dark_noise: float
    dark_noise_dn: float
    quantisation_limited: bool
    sensitivity_threshold: float
    saturation_photons: float
    saturation_capacity: float
    snr_max: float
    dynamic_range: float
    linearity_error: float
    linearity_min: float
    linearity_max: float
    photons: np.ndarray
    signal: np.ndarray
    variance: np.ndarray
    saturation_level: int
    dsnu: float | None = None
    dsnu_row: float | None = None
    dsnu_column: float | None = None
    dsnu_pixel: float | None = None
    prnu: float | None = None
    prnu_row: float | None = None
    prnu_column: float | None = None
    prnu_pixel: float | None = None
    dark_current: float | None = None
    dark_current_from_variance: float | None = None

    __repr__ = short_repr

    @property
    def figures(self) -> dict[str, float]:
        """Figures for `sensor_from_emva1288`.

        It also needs pixel_pitch, bits, black_level and wavelength. Nonuniformities that the frames
        do not resolve are left out.
        """
        found = {name: getattr(self, name) for name in FIGURES + NONUNIFORMITIES}
        return {
            name: value
            for name, value in found.items()
            if value is not None and not math.isnan(value)
        }

    @property
    def snr_max_db(self) -> float:
        """SNR_max [dB]."""
        return 20 * math.log10(self.snr_max)

    @property
    def dynamic_range_db(self) -> float:
        """DR [dB]."""
        return 20 * math.log10(self.dynamic_range)


def photon_transfer(
    bright: Iterable[ArrayLike],
    dark: ArrayLike,
    photons: ArrayLike,
    *,
    dark_stack: ArrayLike | None = None,
    bright_stack: ArrayLike | None = None,
    dark_series: Mapping[float, ArrayLike] | None = None,
    saturation_level: int | None = None,
) -> PhotonTransfer:
    """Measure a linear camera with the photon transfer method.

    Source: EMVA Standard 1288, Release 4.0 Linear (2021) and 3.1 (2016). With y the digital
    number, mu its mean, sigma^2 its temporal variance and s^2 the spatial variance of a mean of L
    frames,

        mu_y - mu_y.dark = R mu_p,  sigma^2_y - sigma^2_y.dark = K (mu_y - mu_y.dark),
        eta = R / K,

    both lines through the origin by least squares up to 70 % of saturation, the level with the
    greatest sigma^2_y;

        sigma_d^2 = (sigma^2_y.dark - 1/12) / K^2,  mu_p.min = (sigma_y.dark / K + 1/2) / eta,
        s^2 = s^2_measured - sigma^2_y / L = s^2_row + s^2_column + s^2_pixel,
        DSNU = s_dark / K,  PRNU = sqrt(s^2_bright - s^2_dark) / (mu_bright - mu_dark).

    Args:
        bright: frames of evenly lit pixels at E levels of light, from dark to beyond saturation
            [DN]: any iterable of E arrays (n, rows, cols), n >= 2. The standard requires n = 2 and
            at least 50 evenly spaced levels.
        dark: frames (n, rows, cols) without light at the same exposure time, n >= 2 [DN].
        photons: mean photons on a pixel at each level, shape (E,), above 0 and rising [photon].
        dark_stack: L >= 2 frames (L, rows, cols) without light, for DSNU [DN].
        bright_stack: L >= 2 frames (L, rows, cols) at half of saturation, for PRNU; needs
            dark_stack [DN].
        dark_series: {exposure time [s]: frames (n, rows, cols) without light}, three times or more,
            for the dark current; the dark noise is then taken at time 0.
        saturation_level: index of the saturated level; None is the level with the greatest
            variance.

    Returns:
        The figures of the camera.

    Raises:
        BadData: if frames have wrong shapes or values, or the levels do not allow the fits.
        OutOfRange: if `saturation_level` is no index of a level.
    """
    photons = _check_array(photons, "photons", 1)
    if not (photons[0] > 0 and (np.diff(photons) > 0).all()):
        raise BadData(
            "photons: wanted rising numbers above 0; frames without light belong in `dark`"
        )
    dark_mean, dark_variance = _temporal_statistics(dark, "dark")
    shape = np.shape(dark)[1:]
    levels = [
        _temporal_statistics(frames, f"bright[{index}]", shape)
        for index, frames in enumerate(bright)
    ]
    if len(levels) != len(photons):
        raise BadData(
            f"bright has {len(levels)} levels, photons {len(photons)}: wanted equal numbers"
        )
    signal, variance = (np.array(levels) - (dark_mean, dark_variance)).T
    last = _saturation(variance, saturation_level)

    fit = signal <= FIT * signal[last]
    fit[last:] = False
    if fit.sum() < 3:
        raise BadData(
            f"bright: {fit.sum()} levels below 70 % of saturation, bright[{last}] with the greatest "
            "variance; wanted 3 or more, in the order of `photons`"
        )
    gain = _through_origin(signal[fit], variance[fit])
    responsivity = _through_origin(photons[fit], signal[fit])
    if not (gain > 0 and responsivity > 0):
        raise BadData(
            "bright: mean or variance falls as the light rises; check that `dark` is dark and that the "
            "levels are in the order of `photons`"
        )

    currents = {}
    if dark_series is not None:
        dark_variance, mean_slope, variance_slope = _dark_lines(dark_series, shape)
        currents["dark_current"] = mean_slope / gain
        currents["dark_current_from_variance"] = variance_slope / gain**2
    limited = bool(dark_variance < LEAST_DARK_VARIANCE)
    noise_dn = math.sqrt(max(dark_variance, LEAST_DARK_VARIANCE))
    efficiency = responsivity / gain
    saturation = float(photons[last])
    threshold, capacity = (noise_dn / gain + 0.5) / efficiency, efficiency * saturation
    return PhotonTransfer(
        gain=gain,
        responsivity=responsivity,
        quantum_efficiency=efficiency,
        dark_noise=math.sqrt(noise_dn**2 - ROUNDING) / gain,
        dark_noise_dn=noise_dn,
        quantisation_limited=limited,
        sensitivity_threshold=threshold,
        saturation_photons=saturation,
        saturation_capacity=capacity,
        snr_max=math.sqrt(capacity),
        dynamic_range=saturation / threshold,
        **_linearity(photons, signal, last),
        photons=photons,
        signal=signal,
        variance=variance,
        saturation_level=last,
        **_nonuniformity(dark_stack, bright_stack, gain, signal[last], shape),
        **currents,
    )


def _check_array(values, name, dimensions, shape=None) -> np.ndarray:
    """Return `values` as an array of finite numbers with these dimensions; shape: (rows, cols)."""
    try:
        values = np.asarray(values)
        values = values if values.dtype.kind in "iu" else values.astype(np.float64)
    except (TypeError, ValueError):
        raise BadData(f"{name}: wanted an array of numbers") from None
    if values.ndim != dimensions or (dimensions == 1 and len(values) == 0):
        wanted = "(levels,)" if dimensions == 1 else "(frames, rows, cols)"
        raise BadData(f"{name} has the shape {values.shape}, wanted {wanted}")
    if dimensions == 3 and (len(values) < 2 or min(values.shape[1:]) < 3):
        raise BadData(
            f"{name} has the shape {values.shape}: wanted 2 frames or more of 3 x 3 pixels or more"
        )
    if shape is not None and values.shape[1:] != tuple(shape):
        raise BadData(
            f"{name} has frames of {values.shape[1]} x {values.shape[2]} pixels, the dark frames have "
            f"{shape[0]} x {shape[1]}"
        )
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise BadData(f"{name}: NaN or infinite values")
    return values


def _temporal_statistics(frames, name, shape=None):
    """Return the mean [DN] and temporal variance [DN^2] of frames that differ by noise only.

    The variance of each pixel, averaged over the pixels, less the variance of the frames' means,
    because flicker of the light is not noise of the camera. For two frames this is the standard's
    half mean square of their difference.
    """
    frames = _check_array(frames, name, 3, shape)
    return frames.mean(), frames.var(axis=0, ddof=1).mean() - frames.mean(axis=(1, 2)).var(ddof=1)


def _saturation(variance, level):
    """Return the index of the saturated level: the one with the greatest variance, unless given."""
    if level is not None:
        if level not in range(len(variance)):
            raise OutOfRange(
                "saturation_level", level, f"an index of a level, 0 to {len(variance) - 1}"
            )
        return int(level)
    level = int(variance.argmax())
    if level == len(variance) - 1:
        raise BadData(
            "bright: the variance still grows at the last level: saturation is not reached; wanted "
            "brighter levels, or saturation_level = index"
        )
    return level


def _through_origin(x, y):
    """Return the slope of the least-squares line through the origin."""
    return float(x @ y / (x @ x))


def _dark_lines(series, shape):
    """Return variance at time 0 [DN^2], slope of the mean [DN/s] and of the variance [DN^2/s]."""
    if not isinstance(series, Mapping) or not all(isinstance(time, Real) for time in series):
        raise BadData("dark_series: wanted {exposure time [s]: frames}")
    times = np.array(sorted(series), np.float64)
    if len(times) < 3 or not (np.isfinite(times).all() and times[0] >= 0):
        raise BadData(
            f"dark_series has the exposure times {times.tolist()} s: wanted three or more, 0 or above"
        )
    points = [
        _temporal_statistics(series[time], f"dark_series[{time:g}]", shape)
        for time in sorted(series)
    ]
    means, variances = np.transpose(points)
    mean_slope, _ = np.polyfit(times, means, 1)
    variance_slope, variance = np.polyfit(times, variances, 1)
    return variance, float(mean_slope), float(variance_slope)


def _linearity(photons, signal, last):
    """Return the deviations from the line of least relative squares, 5 to 95 % saturation [%]."""
    low, high = (part * signal[last] for part in LINEAR)
    inside = (signal >= low) & (signal <= high)
    inside[last + 1 :] = False
    x, y = photons[inside], signal[inside]
    if len(x) < 3:
        raise BadData(f"bright: {len(x)} levels between 5 and 95 % of saturation, wanted 3 or more")
    slope, offset = np.polyfit(x, y, 1, w=1 / y)
    deviations = 100 * (y / (slope * x + offset) - 1)
    return {
        "linearity_error": float(np.abs(deviations).mean()),
        "linearity_min": float(deviations.min()),
        "linearity_max": float(deviations.max()),
    }


def _nonuniformity(dark_stack, bright_stack, gain, saturation, shape):
    """Return DSNU [e-] and PRNU [%], totals and parts, as fields of the result."""
    names = "", "_row", "_column", "_pixel"
    if dark_stack is None:
        if bright_stack is not None:
            raise BadData("bright_stack without dark_stack: PRNU needs both")
        return {}
    mean, dark = _spatial_statistics(dark_stack, "dark_stack", shape)
    found = {f"dsnu{name}": _root(part) / gain for name, part in zip(names, dark, strict=True)}
    if bright_stack is None:
        return found
    bright_mean, bright = _spatial_statistics(bright_stack, "bright_stack", shape)
    low, high = MIDDLE
    signal = bright_mean - mean
    if not low <= signal / saturation <= high:
        raise BadData(
            f"bright_stack is at {100 * signal / saturation:.3g} % of saturation, wanted about 50 % "
            f"({100 * low:g} .. {100 * high:g})"
        )
    return found | {
        f"prnu{name}": 100 * _root(part) / signal
        for name, part in zip(names, bright - dark, strict=True)
    }


def _spatial_statistics(stack, name, shape):
    """Return mean [DN] and spatial variances [DN^2] of L frames: total, rows, columns, pixels.

    They come from the mean frame, less its temporal noise. Averages over a row of N pixels contain
    1/N of the pixels' variance, over a column of M pixels 1/M; the total is the sum of the three
    parts.
    """
    stack = _check_array(stack, name, 3, shape)
    count, rows, cols = stack.shape
    average = stack.mean(axis=0)
    temporal = stack.var(axis=0, ddof=1).mean() / count
    total = average.var(ddof=1) - temporal
    row = average.mean(axis=1).var() - temporal / cols
    column = average.mean(axis=0).var() - temporal / rows
    pixel = (total - row - column) / (1 - 1 / rows - 1 / cols)
    return average.mean(), np.array([total, row - pixel / cols, column - pixel / rows, pixel])


def _root(variance):
    """Return the standard deviation; NaN if measurement noise made the variance negative."""
    return math.sqrt(variance) if variance >= 0 else math.nan

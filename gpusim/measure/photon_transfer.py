"""Photon transfer: gain, noise, saturation and nonuniformity of a linear camera from its frames (EMVA 1288)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.short_repr import brief

QUANTISATION = 1 / 12  # variance of rounding to whole digital numbers [DN^2]
# [DN^2]; below, rounding hides the dark noise and the standard puts this instead
LEAST_DARK_VARIANCE = 0.24
FIT = 0.7  # part of saturation up to which lines are fitted
LINEAR = 0.05, 0.95  # parts of saturation between which linearity is judged
MIDDLE = 0.3, FIT  # part of saturation at which PRNU may be measured; the standard aims at 0.5


@dataclass(frozen=True, eq=False)
class PhotonTransfer:
    """What `photon_transfer` found, in the standard's terms; None: not asked for, NaN: below what the frames resolve.

    gain: K [DN/e-]. responsivity: R [DN/photon]. quantum_efficiency: eta = R / K [e-/photon].
    dark_noise: sigma_d [e-], without quantisation. dark_noise_dn: sigma_y.dark [DN], with it. quantisation_limited:
        whether the latter was below sqrt(0.24) DN and replaced by it, so that both are upper bounds.
    sensitivity_threshold: mu_p.min [photon], where the signal-to-noise ratio is 1.
    saturation_photons: mu_p.sat [photon]. saturation_capacity: mu_e.sat [e-]. snr_max: its square root [1].
    dynamic_range: mu_p.sat / mu_p.min [1].
    linearity_error: mean magnitude of the relative deviations from a line [%]; linearity_min, linearity_max: the least
        and the greatest of them [%].
    dsnu, dsnu_row, dsnu_column, dsnu_pixel [e-]; prnu, prnu_row, prnu_column, prnu_pixel [%]: total and parts.
    dark_current: mu_I [e-/s] from the mean, dark_current_from_variance: from the variance, which needs no stable offset
        but is noisier.
    photons, signal, variance: the photon transfer curve, shape (E,) each: mu_p [photon], mu_y - mu_y.dark [DN] and
        sigma^2_y - sigma^2_y.dark [DN^2]. saturation_level: index of the saturated level.
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

    __repr__ = brief

    @property
    def figures(self) -> dict[str, float]:
        """What `sensor_from_emva1288` takes of it; it wants pixel_pitch, bits, black_level and wavelength beside.

        Nonuniformities that the frames do not resolve are left out.
        """
        names = (
            "gain",
            "quantum_efficiency",
            "saturation_capacity",
            "dark_noise",
            "dark_current",
            "dsnu",
            "dsnu_row",
            "dsnu_column",
            "prnu",
            "prnu_row",
            "prnu_column",
        )
        found = {name: getattr(self, name) for name in names}
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
    bright,
    dark,
    photons,
    *,
    dark_stack=None,
    bright_stack=None,
    dark_series=None,
    saturation_level=None,
) -> PhotonTransfer:
    """Measure a linear camera by the photon transfer method.

    bright: frames of evenly lit pixels at E levels of light, from darkness to beyond saturation; any iterable of E
        arrays (n, rows, cols), n >= 2, [DN]. The standard asks for n = 2 and at least 50 levels evenly spaced.
    dark: frames (n, rows, cols) without light at the same exposure time, n >= 2 [DN].
    photons: mean photons on a pixel at each level, shape (E,), rising from above 0 [photon].
    dark_stack, bright_stack: L >= 2 frames (L, rows, cols) without light and at half of saturation, for DSNU and PRNU
        (bright needs dark) [DN].
    dark_series: {exposure time [s]: frames (n, rows, cols) without light}, three times or more, for the dark current;
        the dark noise is then that at time 0.
    saturation_level: index of the saturated level, if the greatest variance does not show it.
    Returns PhotonTransfer. Raises BadData, OutOfRange.

    Source: EMVA Standard 1288, Release 4.0 Linear (2021) and 3.1 (2016): with y the digital number, mu its mean and
    sigma^2 its temporal variance, s^2 the spatial variance of a mean of L frames,
        mu_y - mu_y.dark = R mu_p,  sigma^2_y - sigma^2_y.dark = K (mu_y - mu_y.dark),  eta = R / K,
    both lines through the origin by least squares up to 70 % of saturation, which is where sigma^2_y is greatest;
        sigma_d^2 = (sigma^2_y.dark - 1/12) / K^2,  mu_p.min = (sigma_y.dark / K + 1/2) / eta,
        s^2 = s^2_measured - sigma^2_y / L = s^2_row + s^2_column + s^2_pixel,
        DSNU = s_dark / K,  PRNU = sqrt(s^2_bright - s^2_dark) / (mu_bright - mu_dark).
    """
    photons = _checked(photons, "photons", 1)
    if not (photons[0] > 0 and (np.diff(photons) > 0).all()):
        raise BadData("photons: wanted numbers above 0, rising; darkness belongs into `dark`")
    dark_mean, dark_variance = _temporal(dark, "dark")
    shape = np.shape(dark)[1:]
    levels = np.array(
        [_temporal(frames, f"bright[{index}]", shape) for index, frames in enumerate(bright)]
    )
    if len(levels) != len(photons):
        raise BadData(f"bright has {len(levels)} levels, photons {len(photons)}: wanted as many")
    signal, variance = (levels - (dark_mean, dark_variance)).T
    last = _saturation(variance, saturation_level)

    fit = signal <= FIT * signal[last]
    fit[last:] = False
    if fit.sum() < 3:
        raise BadData(
            f"bright: {fit.sum()} levels below 70 % of saturation, bright[{last}], where the variance is "
            "greatest; wanted 3 or more, in the order of `photons`"
        )
    gain, responsivity = (
        _through_origin(signal[fit], variance[fit]),
        _through_origin(photons[fit], signal[fit]),
    )
    if not (gain > 0 and responsivity > 0):
        raise BadData(
            "bright: neither mean nor variance may fall as the light rises; is `dark` dark, and are the "
            "levels in the order of `photons`?"
        )

    currents = {}
    if dark_series is not None:
        dark_variance, *slopes = _dark_lines(dark_series, shape)
        currents = {
            "dark_current": slopes[0] / gain,
            "dark_current_from_variance": slopes[1] / gain**2,
        }
    limited = bool(dark_variance < LEAST_DARK_VARIANCE)
    noise_dn = math.sqrt(max(dark_variance, LEAST_DARK_VARIANCE))
    efficiency = responsivity / gain
    saturation = float(photons[last])
    threshold, capacity = (noise_dn / gain + 0.5) / efficiency, efficiency * saturation
    return PhotonTransfer(
        gain=gain,
        responsivity=responsivity,
        quantum_efficiency=efficiency,
        dark_noise=math.sqrt(noise_dn**2 - QUANTISATION) / gain,
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


def _checked(values, name, dimensions, shape=None):
    """Return `values` as an array of finite numbers with so many dimensions, the last of them of that shape."""
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


def _temporal(frames, name, shape=None):
    """Mean [DN] and temporal variance [DN^2] of frames that differ in nothing but noise.

    The variance of each pixel, averaged over the pixels, less that of the frames' means: light that flickers is not
    noise of the camera. For two frames this is the standard's half mean square of their difference.
    """
    frames = _checked(frames, name, 3, shape)
    return frames.mean(), frames.var(axis=0, ddof=1).mean() - frames.mean(axis=(1, 2)).var(ddof=1)


def _saturation(variance, level):
    """Index of the saturated level: that of the greatest temporal variance, unless given."""
    if level is not None:
        if level not in range(len(variance)):
            raise OutOfRange(
                "saturation_level", level, f"an index of a level, 0 to {len(variance) - 1}"
            )
        return int(level)
    level = int(variance.argmax())
    if level == len(variance) - 1:
        raise BadData(
            "bright: the variance still grows at the last level, so saturation is not reached; wanted "
            "brighter levels, or saturation_level = index"
        )
    return level


def _through_origin(x, y):
    return float(x @ y / (x @ x))


def _dark_lines(series, shape):
    """Variance at time 0 [DN^2], slope of the mean [DN/s] and of the variance [DN^2/s] over the exposure time."""
    if not isinstance(series, Mapping) or not all(isinstance(time, Real) for time in series):
        raise BadData("dark_series: wanted {exposure time [s]: frames}")
    times = np.array(sorted(series), np.float64)
    if len(times) < 3 or not (np.isfinite(times).all() and times[0] >= 0):
        raise BadData(
            f"dark_series has the exposure times {times.tolist()} s: wanted three or more, 0 or above"
        )
    points = np.array(
        [_temporal(series[time], f"dark_series[{time:g}]", shape) for time in sorted(series)]
    )
    (mean_slope, _), (variance_slope, variance) = (
        np.polyfit(times, column, 1) for column in points.T
    )
    return variance, float(mean_slope), float(variance_slope)


def _linearity(photons, signal, last):
    """Relative deviations from the line that makes the sum of their squares least, 5 to 95 % of saturation [%]."""
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
    """DSNU [e-] and PRNU [%], total and by parts, as fields of the result."""
    names = "", "_row", "_column", "_pixel"
    if dark_stack is None:
        if bright_stack is not None:
            raise BadData(
                "bright_stack without dark_stack: PRNU is what the light adds to the dark pattern"
            )
        return {}
    mean, dark = _spatial(dark_stack, "dark_stack", shape)
    found = {f"dsnu{name}": _root(part) / gain for name, part in zip(names, dark, strict=True)}
    if bright_stack is None:
        return found
    bright_mean, bright = _spatial(bright_stack, "bright_stack", shape)
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


def _spatial(stack, name, shape):
    """Mean [DN] and spatial variances [DN^2] of L frames: total, of rows, of columns, of single pixels.

    From the mean frame, less what temporal noise leaves in it. Averages over a row of N pixels keep 1/N of the pixels'
    variance, over a column of M pixels 1/M; the total is the sum of the three parts.
    """
    stack = _checked(stack, name, 3, shape)
    count, rows, cols = stack.shape
    average = stack.mean(axis=0)
    temporal = stack.var(axis=0, ddof=1).mean() / count
    total = average.var(ddof=1) - temporal
    row = average.mean(axis=1).var() - temporal / cols
    column = average.mean(axis=0).var() - temporal / rows
    pixel = (total - row - column) / (1 - 1 / rows - 1 / cols)
    return average.mean(), np.array([total, row - pixel / cols, column - pixel / rows, pixel])


def _root(variance):
    """Standard deviation; NaN where the noise of the measurement made the variance negative."""
    return math.sqrt(variance) if variance >= 0 else math.nan

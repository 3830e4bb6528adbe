"""Sensors from the figures of an EMVA 1288 data sheet (releases 3.1 and 4.0, linear model)."""

import math
from numbers import Real

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from gpusim.domain.errors import BadData, OutOfRange, shown
from gpusim.domain.noise import Noise
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum

QUANTISATION = 1 / 12  # variance of rounding to whole digital numbers [DN^2]
_OPTIONAL = {
    "dark_noise",
    "dark_noise_dn",
    "snr_max_db",
    "dynamic_range_db",
    "sensitivity_threshold",
}
_LIMITS = {  # unit, least, most; `Sensor` and `Noise` check what is theirs
    "gain": ("DN/e-", 1e-12, 1e12),
    "saturation_capacity": ("e-", 1, 1e9),
    "dark_noise": ("e-", 0, 1e12),
    "dark_noise_dn": ("DN", 0, 1e12),
    "sensitivity_threshold": ("photon", 1e-12, 1e12),
    "snr_max_db": ("dB", -300, 300),
    "dynamic_range_db": ("dB", -300, 300),
    "rounding": ("", 0, 0.5),
    **{f"dsnu{part}": ("e-", 0, 1e12) for part in ("", "_row", "_column")},
    **{f"prnu{part}": ("%", 0, 30) for part in ("", "_row", "_column")},
}
LARGEST = 1e300  # of figures that `Sensor` and `Noise` check: what a float holds
HALF_BAND = 25.0  # [nm]; the standard's light has a full width at half maximum below 50 nm


def sensor_from_emva1288(
    *,
    pixel_pitch: float,
    quantum_efficiency: float | Spectrum,
    wavelength: float | None = None,
    response: Spectrum | None = None,
    gain: float,
    saturation_capacity: float,
    bits: int,
    dark_noise: float | None = None,
    dark_noise_dn: float | None = None,
    black_level: int = 0,
    dsnu: float = 0.0,
    dsnu_row: float = 0.0,
    dsnu_column: float = 0.0,
    prnu: float = 0.0,
    prnu_row: float = 0.0,
    prnu_column: float = 0.0,
    dark_current: float = 0.0,
    dark_current_temperature: float = 25.0,
    dark_current_doubling: float = 8.0,
    snr_max_db: float | None = None,
    dynamic_range_db: float | None = None,
    sensitivity_threshold: float | None = None,
    rounding: float = 0.03,
    channels=("Y",),
    cfa=("Y",),
    seed: int = 0,
) -> Sensor:
    """Build the sensor that an EMVA 1288 data sheet describes.

    pixel_pitch: [m].
    quantum_efficiency: eta [e-/photon], a part of 1, counting all photons on the pixel; a number at `wavelength` [nm],
        or curves over wavelength, shape (L,) or (len(channels), L). A number alone says nothing of other wavelengths:
        the sensor then knows `wavelength` +- 25 nm only, the widest band that the standard measures with, unless
        `response` gives the shape of the curve, shape (L,) in any unit, which is scaled to the number.
    gain: K [DN/e-]. bits, black_level [DN], channels, cfa: as in `Sensor`; monochrome unless given.
    saturation_capacity: mu_e.sat [e-], the mean charge at which the temporal variance is greatest. Photon noise is cut
        off already below the full well, so the well is a little above: by three standard deviations at 1e4 e-.
    dark_noise: sigma_d [e-], referred to the input, without quantisation; or dark_noise_dn: sigma_y.dark [DN], with it.
    dsnu: DSNU1288 [e-], prnu: PRNU1288 [%], both in total; *_row, *_column: the parts of release 4 in them.
    dark_current: mu_I [e-/s] at dark_current_temperature [deg C], doubling every dark_current_doubling [K].
    snr_max_db: SNR_max [dB], dynamic_range_db: DR [dB], sensitivity_threshold: mu_p.min [photon]: follow from the
        others and are only compared with them. rounding: by which part of itself a figure may be off [1].
    seed: names the one chip whose fixed patterns are drawn.
    The light, exposure time and temperature of a frame are the user's: `dataclasses.replace` sets them.
    Raises BadData for figures that are missing or contradict each other, OutOfRange.
    Source: EMVA Standard 1288, Release 4.0 Linear (2021) and 3.1 (2016), the linear camera model.
    """
    figures = {
        "gain": gain,
        "saturation_capacity": saturation_capacity,
        "dark_noise": dark_noise,
        "dsnu": dsnu,
        "dark_noise_dn": dark_noise_dn,
        "dsnu_row": dsnu_row,
        "dsnu_column": dsnu_column,
        "prnu": prnu,
        "prnu_row": prnu_row,
        "prnu_column": prnu_column,
        "snr_max_db": snr_max_db,
        "rounding": rounding,
        "dynamic_range_db": dynamic_range_db,
        "sensitivity_threshold": sensitivity_threshold,
        "pixel_pitch": pixel_pitch,
        "bits": bits,
        "black_level": black_level,
        "dark_current": dark_current,
        "dark_current_temperature": dark_current_temperature,
        "dark_current_doubling": dark_current_doubling,
    }
    _check_figures(figures)
    spectrum, efficiency = _efficiency(quantum_efficiency, wavelength, response)
    noise_squared = _dark_noise_squared(dark_noise, dark_noise_dn, gain, rounding)
    sensor = Sensor(
        pixel_pitch=pixel_pitch,
        qe=spectrum,
        channels=channels,
        cfa=cfa,
        bits=bits,
        black_level=black_level,
        gain=gain,
        full_well=full_well(saturation_capacity, prnu / 100),
        noise=Noise(
            read=math.sqrt(noise_squared),
            dark_current=dark_current,
            temperature=dark_current_temperature,
            reference_temperature=dark_current_temperature,
            doubling=dark_current_doubling,
            seed=seed,
            dsnu=_pixel_part("dsnu", figures, rounding, "e-"),
            row_dsnu=dsnu_row,
            column_dsnu=dsnu_column,
            prnu=_pixel_part("prnu", figures, rounding, "%") / 100,
            row_prnu=prnu_row / 100,
            column_prnu=prnu_column / 100,
        ),
    )
    highest = sensor.white_level - black_level
    if gain * saturation_capacity > highest * (1 + rounding):
        raise BadData(
            f"gain x saturation_capacity = {gain * saturation_capacity:.6g} DN: {bits} bits above a black "
            f"level of {black_level} hold {highest} DN; check bits, black_level and the unit of gain, DN/e-"
        )
    threshold = math.sqrt(noise_squared + QUANTISATION / gain**2) + 0.5  # [e-]
    _compare(
        "snr_max_db",
        snr_max_db,
        math.sqrt(saturation_capacity),
        rounding,
        "sqrt(saturation_capacity)",
        decibels=True,
    )
    _compare(
        "dynamic_range_db",
        dynamic_range_db,
        saturation_capacity / threshold,
        rounding,
        "saturation_capacity / (dark noise with quantisation + 0.5 e-)",
        decibels=True,
    )
    if sensitivity_threshold is not None and efficiency is None:
        raise BadData(
            "sensitivity_threshold: wanted the wavelength at which it was measured, wavelength = ... [nm]"
        )
    _compare(
        "sensitivity_threshold",
        sensitivity_threshold,
        threshold / efficiency if efficiency else None,
        rounding,
        "(dark noise with quantisation + 0.5 e-) / quantum_efficiency",
    )
    return sensor


def full_well(saturation_capacity: float, prnu: float = 0.0) -> float:
    """Charge at which a pixel must saturate [e-] so that the photon transfer curve peaks at saturation_capacity [e-].

    Photons at a mean m, normally distributed and cut off at the well W, have the variance m v(a), a = (W - m) / sqrt(m)
    and v(a) the variance of min(z, a), z standard normal. W is where its average over the pixels, whose means are
    spread by prnu [1], has its maximum. (The normal distribution is good to about 1 e- here.)
    """
    # pixels lie closer together than half a deviation of the photon noise
    z = np.linspace(-6, 6, 601 + round(24 * prnu * math.sqrt(saturation_capacity)))
    share = np.exp(-(z**2) / 2) * (1 + prnu * z > 0)
    factor = np.maximum(1 + prnu * z, 1e-9)
    mean = saturation_capacity * factor
    root = np.sqrt(mean)

    def slope(well):
        """Derivative of the mean variance by saturation_capacity, up to a factor."""
        a = (well - mean) / root
        beyond, density = ndtr(-a), np.exp(-(a**2) / 2) / math.sqrt(2 * math.pi)
        first = a * beyond - density  # E min(z, a)
        variance = 1 - beyond - a * density + a**2 * beyond - first**2
        return share @ (factor * (variance - 2 * beyond * (a - first) * (root + a / 2)))

    # beyond 8 deviations of either kind no pixel is cut off
    return brentq(
        slope,
        saturation_capacity,
        saturation_capacity * (1 + 8 * prnu) + 12 * math.sqrt(saturation_capacity) + 12,
    )


def _check_figures(figures):
    for name, value in figures.items():
        if value is None and name in _OPTIONAL:
            continue
        if not isinstance(value, Real) or isinstance(value, bool):
            raise BadData(f"{name} = {shown(value)}: wanted a number")
        unit, low, high = _LIMITS.get(name, ("", -LARGEST, LARGEST))
        if not low <= value <= high:
            raise OutOfRange(
                name, f"{_short(value)} {unit}".rstrip(), f"{low:.3g} <= {name} <= {high:.3g}"
            )


def _short(value):
    """A number as a message shows it: whole ones may be larger than a float."""
    return shown(value) if isinstance(value, int) else f"{float(value):.6g}"


def _efficiency(quantum_efficiency, wavelength, response):
    """Return curves (C, L) and the efficiency at the wavelength, that of the best channel; None without wavelength."""
    if wavelength is not None and not (
        isinstance(wavelength, Real) and 10 + HALF_BAND < wavelength < 1e5 - HALF_BAND
    ):
        raise OutOfRange(
            "wavelength",
            f"{shown(wavelength)} nm",
            f"a number, {10 + HALF_BAND:g} < wavelength < 99975",
        )
    if response is not None and not isinstance(response, Spectrum):
        raise BadData(f"response = {shown(response)}: wanted a gpusim.Spectrum")
    if not isinstance(quantum_efficiency, Spectrum):
        if not isinstance(quantum_efficiency, Real) or isinstance(quantum_efficiency, bool):
            raise BadData(
                f"quantum_efficiency = {shown(quantum_efficiency)}: wanted a number or a Spectrum"
            )
        if not 0 < quantum_efficiency <= 1:
            raise OutOfRange(
                "quantum_efficiency",
                _short(quantum_efficiency),
                "0 < quantum_efficiency <= 1; a data sheet's 60 % are 0.6",
            )
        if wavelength is None:
            raise BadData(
                "quantum_efficiency is one number: wanted the wavelength it belongs to, wavelength = ... "
                "[nm], or a curve"
            )
        if response is None:
            band = np.array([wavelength - HALF_BAND, wavelength + HALF_BAND])
            response = Spectrum(band, np.ones(2), "quantum efficiency at one wavelength")
        if response.values.ndim != 1 or not response.at([wavelength])[0] > 0:
            raise BadData(f"response: wanted one curve, above 0 at {wavelength:g} nm")
        quantum_efficiency = response.scaled(quantum_efficiency / response.at([wavelength])[0])
    elif response is not None:
        raise BadData("response and quantum_efficiency as a curve: wanted one of them")
    curves = Spectrum(
        quantum_efficiency.wavelengths,
        np.atleast_2d(quantum_efficiency.values),
        quantum_efficiency.name,
    )
    efficiency = None if wavelength is None else float(curves.at([wavelength]).max())
    if efficiency == 0:
        raise BadData(f"quantum_efficiency is 0 at {wavelength:g} nm, or its curve ends before")
    return curves, efficiency


def _dark_noise_squared(electrons, numbers, gain, rounding):
    """sigma_d^2 [e-^2] of the one or the other figure."""
    if electrons is None and numbers is None:
        raise BadData("wanted dark_noise [e-] or dark_noise_dn [DN]")
    if numbers is None:
        return electrons**2
    squared = (numbers**2 - QUANTISATION) / gain**2
    if squared < 0:
        raise OutOfRange(
            "dark_noise_dn",
            f"{numbers:.6g} DN",
            f"{math.sqrt(QUANTISATION):.3f} or more, which rounding "
            "alone gives; dark noise without quantisation is dark_noise, in e-",
        )
    if electrons is None:
        return squared
    _compare(
        "dark_noise_dn",
        numbers,
        math.sqrt(gain**2 * electrons**2 + QUANTISATION),
        rounding,
        "sqrt(gain^2 dark_noise^2 + 1/12 DN^2)",
    )
    return electrons**2


def _pixel_part(name, figures, rounding, unit):
    """What a total nonuniformity leaves to pixels beside the parts of rows and columns: their squares add."""
    total, row, column = (figures[key] for key in (name, f"{name}_row", f"{name}_column"))
    both = math.hypot(row, column)
    if both > total * (1 + rounding):
        raise BadData(
            f"{name}_row = {row:g} {unit} and {name}_column = {column:g} {unit} are {both:.4g} {unit} "
            f"together: more than {name} = {total:g} {unit}, which includes them"
        )
    return math.sqrt(max(total**2 - both**2, 0.0))


def _compare(name, stated, derived, rounding, formula, decibels=False):
    """Refuse a stated figure that differs from what the others give by more than `rounding`."""
    if stated is None:
        return
    ratio = (10 ** (stated / 20) if decibels else stated) / derived
    if not 1 / (1 + rounding) <= ratio <= 1 + rounding:
        shown = 20 * math.log10(derived) if decibels else derived
        raise BadData(
            f"{name} = {stated:.6g} contradicts the other figures: {formula} gives {shown:.4g}, and "
            f"rounding = {rounding:g} allows {100 * rounding:g} % between them; check units and figures"
        )

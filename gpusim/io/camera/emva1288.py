"""Sensors from the figures of an EMVA 1288 data sheet (releases 3.1 and 4.0, linear model)."""

import math
from numbers import Real

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from gpusim.domain.errors import BadData, OutOfRange, format_value
from gpusim.domain.noise import Noise
from gpusim.domain.raw_noise import ROUNDING
from gpusim.domain.sensor import Sensor
from gpusim.domain.spectrum import Spectrum

# arguments that are no plain figures
_OTHERS = ("quantum_efficiency", "wavelength", "response", "channels", "cfa", "seed")
_STATED = {"snr_max_db", "dynamic_range_db", "sensitivity_threshold"}
_OPTIONAL = _STATED | {"dark_noise", "dark_noise_dn"}
_LIMITS = {  # unit, least, most; `Sensor` and `Noise` check the others
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
LARGEST = 1e300  # limit of floats, for figures that `Sensor` and `Noise` check
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
    channels: tuple[str, ...] = ("Y",),
    cfa: tuple[str, ...] = ("Y",),
    seed: int = 0,
) -> Sensor:
    """Return the sensor of an EMVA 1288 data sheet.

    Light, exposure time and temperature of a frame are set by the user with `dataclasses.replace`.

    Source: EMVA Standard 1288, Release 4.0 Linear (2021) and 3.1 (2016), the linear camera model.

    Args:
        pixel_pitch: pixel pitch [m].
        quantum_efficiency: eta [e-/photon], 0 .. 1, for all photons on the pixel: a number at
            `wavelength`, or curves over wavelength, shape (L,) or (len(channels), L). A number is
            used for `wavelength` +- 25 nm only, the widest band of the standard's measurement,
            unless `response` has the shape of the curve.
        wavelength: wavelength of the measurement [nm].
        response: spectral response in any unit, shape (L,), scaled to a `quantum_efficiency` that
            is a number.
        gain: K [DN/e-].
        saturation_capacity: mu_e.sat [e-], the mean charge with the greatest temporal variance.
            Photon noise is clipped below the full well already, so the well is a little larger: by
            three standard deviations at 1e4 e-.
        bits: bits of the converter, see `Sensor`.
        dark_noise: sigma_d referred to the input, without quantisation [e-]; or give dark_noise_dn.
        dark_noise_dn: sigma_y.dark, with quantisation [DN].
        black_level: black level, see `Sensor` [DN].
        dsnu: total DSNU1288 [e-].
        dsnu_row: row part of it in release 4 [e-].
        dsnu_column: column part of it in release 4 [e-].
        prnu: total PRNU1288 [%].
        prnu_row: row part of it in release 4 [%].
        prnu_column: column part of it in release 4 [%].
        dark_current: mu_I at dark_current_temperature [e-/s].
        dark_current_temperature: temperature of the dark current [deg C].
        dark_current_doubling: temperature difference that doubles the dark current [K].
        snr_max_db: SNR_max [dB]; compared with the other figures only.
        dynamic_range_db: DR [dB]; compared with the other figures only.
        sensitivity_threshold: mu_p.min [photon]; compared with the other figures only.
        rounding: relative rounding error allowed in that comparison [1].
        channels: letters of the channels, see `Sensor`; monochrome by default.
        cfa: period of the mosaic, see `Sensor`; monochrome by default.
        seed: seed of the chip's fixed patterns.

    Returns:
        The sensor.

    Raises:
        BadData: if figures are missing or contradict each other.
        OutOfRange: if a figure is out of range.
    """
    figures = {name: value for name, value in locals().items() if name not in _OTHERS}
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
    threshold = math.sqrt(noise_squared + ROUNDING / gain**2) + 0.5  # [e-]
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
            "sensitivity_threshold: wanted the wavelength at which it was measured, wavelength = ... "
            "[nm]"
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
    """Return the full well [e-] whose photon transfer curve peaks at saturation_capacity [e-].

    Photons with mean m, normally distributed and clipped at the well W, have the variance m v(a), a
    = (W - m) / sqrt(m), where v(a) is the variance of min(z, a) for standard normal z. W is the
    value whose average of this over the pixels, with means spread by prnu [1], has its maximum.
    (The normal distribution is accurate to about 1 e- here.)
    """
    # steps of less than half a standard deviation of the photon noise
    z = np.linspace(-6, 6, 601 + round(24 * prnu * math.sqrt(saturation_capacity)))
    share = np.exp(-(z**2) / 2) * (1 + prnu * z > 0)
    factor = np.maximum(1 + prnu * z, 1e-9)
    mean = saturation_capacity * factor
    root = np.sqrt(mean)

    def slope(well):
        """Return the derivative of the mean variance by saturation_capacity, up to a factor."""
        a = (well - mean) / root
        beyond, density = ndtr(-a), np.exp(-(a**2) / 2) / math.sqrt(2 * math.pi)
        first = a * beyond - density  # E min(z, a)
        variance = 1 - beyond - a * density + a**2 * beyond - first**2
        return share @ (factor * (variance - 2 * beyond * (a - first) * (root + a / 2)))

    # beyond 8 deviations of either kind no pixel is clipped
    most = saturation_capacity * (1 + 8 * prnu) + 12 * math.sqrt(saturation_capacity) + 12
    return brentq(slope, saturation_capacity, most)


def _check_figures(figures):
    for name, value in figures.items():
        if value is None and name in _OPTIONAL:
            continue
        if not isinstance(value, Real) or isinstance(value, bool):
            raise BadData(f"{name} = {format_value(value)}: wanted a number")
        unit, low, high = _LIMITS.get(name, ("", -LARGEST, LARGEST))
        if not low <= value <= high:
            allowed = f"{low:.3g} <= {name} <= {high:.3g}"
            raise OutOfRange(name, f"{_number_text(value)} {unit}".rstrip(), allowed)


def _number_text(value):
    """Return a number for a message; integers may exceed the range of floats."""
    return format_value(value) if isinstance(value, int) else f"{float(value):.6g}"


def _efficiency(quantum_efficiency, wavelength, response):
    """Return curves (C, L), and the best channel's efficiency at the wavelength or None."""
    if wavelength is not None and not (
        isinstance(wavelength, Real) and 10 + HALF_BAND < wavelength < 1e5 - HALF_BAND
    ):
        allowed = f"a number, {10 + HALF_BAND:g} < wavelength < 99975"
        raise OutOfRange("wavelength", f"{format_value(wavelength)} nm", allowed)
    if response is not None and not isinstance(response, Spectrum):
        raise BadData(f"response = {format_value(response)}: wanted a gpusim.Spectrum")
    if not isinstance(quantum_efficiency, Spectrum):
        if not isinstance(quantum_efficiency, Real) or isinstance(quantum_efficiency, bool):
            number = format_value(quantum_efficiency)
            raise BadData(f"quantum_efficiency = {number}: wanted a number or a Spectrum")
        if not 0 < quantum_efficiency <= 1:
            allowed = "0 < quantum_efficiency <= 1; write 60 % of a data sheet as 0.6"
            raise OutOfRange("quantum_efficiency", _number_text(quantum_efficiency), allowed)
        if wavelength is None:
            raise BadData(
                "quantum_efficiency is one number: wanted its wavelength, wavelength = ... [nm], or a "
                "curve"
            )
        if response is None:
            band = np.array([wavelength - HALF_BAND, wavelength + HALF_BAND])
            response = Spectrum(band, np.ones(2), "quantum efficiency at one wavelength")
        if response.values.ndim != 1 or not response.at([wavelength])[0] > 0:
            raise BadData(f"response: wanted one curve, above 0 at {wavelength:g} nm")
        quantum_efficiency = response.scale(quantum_efficiency / response.at([wavelength])[0])
    elif response is not None:
        raise BadData("response and quantum_efficiency as a curve: wanted one of them")
    values = np.atleast_2d(quantum_efficiency.values)
    curves = Spectrum(quantum_efficiency.wavelengths, values, quantum_efficiency.name)
    efficiency = None if wavelength is None else float(curves.at([wavelength]).max())
    if efficiency == 0:
        raise BadData(f"quantum_efficiency is 0 at {wavelength:g} nm, or its curve ends before")
    return curves, efficiency


def _dark_noise_squared(electrons, numbers, gain, rounding):
    """Return sigma_d^2 [e-^2] from either figure."""
    if electrons is None and numbers is None:
        raise BadData("wanted dark_noise [e-] or dark_noise_dn [DN]")
    if numbers is None:
        return electrons**2
    squared = (numbers**2 - ROUNDING) / gain**2
    if squared < 0:
        raise OutOfRange(
            "dark_noise_dn",
            f"{numbers:.6g} DN",
            f"{math.sqrt(ROUNDING):.3f} or more, the noise of rounding; "
            "give dark noise without quantisation as dark_noise [e-]",
        )
    if electrons is None:
        return squared
    _compare(
        "dark_noise_dn",
        numbers,
        math.sqrt(gain**2 * electrons**2 + ROUNDING),
        rounding,
        "sqrt(gain^2 dark_noise^2 + 1/12 DN^2)",
    )
    return electrons**2


def _pixel_part(name, figures, rounding, unit):
    """Return a total nonuniformity less its row and column parts, in squares."""
    total, row, column = (figures[key] for key in (name, f"{name}_row", f"{name}_column"))
    both = math.hypot(row, column)
    if both > total * (1 + rounding):
        raise BadData(
            f"{name}_row = {row:g} {unit} and {name}_column = {column:g} {unit} are {both:.4g} {unit} "
            f"together: more than {name} = {total:g} {unit}, their total"
        )
    return math.sqrt(max(total**2 - both**2, 0.0))


def _compare(name, stated, derived, rounding, formula, decibels=False):
    """Raise BadData if a stated figure differs from the derived one by more than `rounding`."""
    if stated is None:
        return
    ratio = (10 ** (stated / 20) if decibels else stated) / derived
    if not 1 / (1 + rounding) <= ratio <= 1 + rounding:
        shown = 20 * math.log10(derived) if decibels else derived
        raise BadData(
            f"{name} = {stated:.6g} contradicts the other figures: {formula} gives {shown:.4g}, and "
            f"rounding = {rounding:g} allows {100 * rounding:g} % between them; check units and figures"
        )

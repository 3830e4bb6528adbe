"""Units in the headings of tables: wavelengths in any unit become nanometres, percent become shares."""

import re

import numpy as np

from gpusim.domain.errors import BadData, format_value, one_line
from gpusim.domain.spectrum import LIGHT_SPEED, LONGEST, PLANCK

NAMED = "nm, um, A, mm, m, cm-1, eV, THz"
ELEMENTARY_CHARGE = 1.602176634e-19  # [C], exact (SI 2019)
# [nm] in one unit of length
_LENGTHS = {
    **dict.fromkeys(("nm", "nanometer", "nanometers", "nanometre", "nanometres"), 1.0),
    **dict.fromkeys(("um", "µm", "μm", "mum", "micro", "micron", "microns"), 1e3),
    **dict.fromkeys(("micrometer", "micrometers", "micrometre", "micrometres"), 1e3),
    **dict.fromkeys(("a", "å", "ang", "angstrom", "angstroms", "ångström", "ångstrom"), 0.1),
    **dict.fromkeys(("mm", "millimeter", "millimetre"), 1e6),
    **dict.fromkeys(("m", "meter", "metre", "meters", "metres"), 1e9),
}
# wavelength [nm] times the quantity in this unit
_INVERSE = {
    **dict.fromkeys(("cm-1", "kayser", "kaysers"), 1e7),
    **dict.fromkeys(
        ("ev", "electronvolt", "electronvolts"), 1e9 * PLANCK * LIGHT_SPEED / ELEMENTARY_CHARGE
    ),
    "thz": 1e-3 * LIGHT_SPEED,
    "ghz": LIGHT_SPEED,
    "hz": 1e9 * LIGHT_SPEED,
}
_INVERSE_CM = re.compile(r"1\s*/\s*cm\b|cm\s*(?:\^|\*\*)?\s*\{?\s*(?:[-\u2212\u2013]\s*1|⁻¹)\s*\}?")
# Words of headings that are no units
_PLAIN = re.compile(
    r"(wave[ -]?(length|number|band)?s?|wavenumbers?|wvl?s?|wls?|wav|waves|lam(bda)?s?|λs?|x|photon|"
    r"freq(uency|uencies)?|"
    r"energy|energies|bands?|cent(er|re|ral)s?|vacuum|air|in|of|the|spectr(um|al|a)|samples?|"
    r"patch(es)?|names?|id|no|index|number|data|values?)",
    re.I,
)
AXIS = re.compile(
    r"wave|lambda|λ|\bwvl?\b|\bwl\b|freq|energ|\b[nuµμm]m\b|[_µμ]m\b|angstr|Å|"
    r"\bcm\s*[\^*⁻\u2212\u2013-]|1/cm|(\b|_)ev\b|hz\b",
    re.I,
)  # of a heading above wavelengths
_PERCENT = re.compile(
    r"[\s_]*[\[(]?\s*(?:%|\bpercent\b|\bper cent\b|\bpct\b|_percent$|_pct$)\s*[\])]?", re.I
)
LETTERS = {
    **{"red": "R", "green": "G", "blue": "B", "cyan": "C", "magenta": "M", "yellow": "Y"},
    **{"clear": "W", "white": "W", "emerald": "E", "nir": "N", "ir": "N"},
}
LEAST_PERCENT = 1.5  # shares above it are none, and may be percent
PLAUSIBLE = 100.0, 20000.0  # [nm] of wavelengths without a unit


def unit_of(heading: str) -> str:
    """Return the unit of wavelengths that a heading names, "" if it names none.

    Raises BadData if there is a unit that is not known.
    """
    text = _INVERSE_CM.sub("cm-1", heading.strip().lower())
    bracket = re.search(r"[\[({]([^\])}]*)[\])}]", text)
    words = re.split(r"[\s_,:;/\\|]+", bracket[1] if bracket else text)
    words = [word for word in words if word and not _PLAIN.fullmatch(word)]
    known = [word for word in words if word in _LENGTHS or word in _INVERSE]
    if len(known) == 1 and (len(words) == 1 or len(known[0]) > 1):
        return known[0]
    if len(words) == 1 or len(known) > 1:
        raise BadData(
            f"heading {format_value(one_line(heading, 60))}: unit of wavelengths {words[0]!r} is not known, "
            f"wanted one of {NAMED}"
        )
    if "wavenumber" in text or "wave number" in text:
        return "cm-1"
    if re.search("freq|energ", text) and not words:
        raise BadData(
            f"heading {format_value(one_line(heading, 60))}: no unit; wanted one of {NAMED}, for "
            "example wavelength_nm"
        )
    return ""


def is_inverse(heading: str) -> bool:
    """Return True if a heading's unit counts waves or energy, not length."""
    return unit_of(heading) in _INVERSE


def convert_to_nm(numbers, heading: str) -> np.ndarray:
    """Return wavelengths [nm] of the numbers below a heading, in their order.

    Without a unit they are nm, if they can be. Raises BadData.
    """
    numbers, unit = np.asarray(numbers, np.float64), unit_of(heading)
    if unit in _INVERSE:
        if not (numbers > 0).all():
            raise BadData(f"heading {heading!r}: numbers not above 0; wanted a positive {unit}")
        return _INVERSE[unit] / numbers
    if not unit and numbers.size and not PLAUSIBLE[0] <= numbers.min() <= numbers.max() <= LONGEST:
        raise BadData(
            f"heading {format_value(one_line(heading, 60))}: {numbers.min():g} .. {numbers.max():g} are no "
            f"wavelengths in nm; name their unit, one of {NAMED}, for example wavelength_um"
        )
    return numbers * _LENGTHS.get(unit, 1.0)


def read_share_heading(heading: str) -> tuple[str, float]:
    """Return the name in the heading of shares, and the factor on the numbers: 0.01 for percent."""
    name = _PERCENT.sub("", heading).strip(" _")
    return name or heading.strip(), 0.01 if _PERCENT.search(heading) else 1.0


def letter_of(name: str) -> str:
    """Return the letter of a channel: "R" for "red"; other names stay."""
    return LETTERS.get(name.lower(), name)


def check_shares(values: np.ndarray, label: str, name: str):
    """Raise BadData if numbers that should be shares look like percent."""
    highest = float(np.max(values, initial=0.0))
    if highest > LEAST_PERCENT:
        raise BadData(
            f"{label}: numbers up to {highest:g}, wanted shares 0 .. 1; if they are percent, say so "
            f'in the heading: "{name}_%"'
        )

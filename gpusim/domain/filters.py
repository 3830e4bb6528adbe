"""The curves of a sensor's parts by letter, and the quantum efficiency of a mosaic that takes some of them."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData
from gpusim.domain.mosaics import mosaic
from gpusim.domain.spectrum import SHARE, Spectrum

# Letters whose curves follow from others, and how, in words
DERIVED = {
    "W": "no filter: at each wavelength the highest of the other filters",
    "Y": "red and green together, at most the clear pixel's",
    "C": "green and blue together, at most the clear pixel's",
    "M": "red and blue together, at most the clear pixel's",
    "E": "emerald, the geometric mean of green and blue",
    "N": "near infrared: the clear pixel's from 700 nm on (half there), falling to 0 at 1100 nm",
}
SUMS = {"Y": "RG", "C": "GB", "M": "RB"}
NEAR_INFRARED = (
    650.0,
    750.0,
    1100.0,
)  # [nm] from 0 to all of the clear pixel's; the end of silicon's
RELATIVE_PEAK = 0.995, 1.005  # a highest sensitivity in between is relative


@dataclass(frozen=True, eq=False)
class Filters:
    """Curves of a sensor's parts, from which a mosaic takes its channels.

    Attributes:
        table: Curves of colour filters, or of whole pixels, one per letter, shape (C, L).
        letters: The letters.
        photodetector: Efficiency behind the filters, or None.
        ir_cut: Transmission of the infrared cut, or None.
        ends: "zero": no light outside the tables; or None.
        is_whole: The table is a measured sensitivity of the whole camera, without photodetector and
            infrared cut.
        peak: Efficiency of the highest sensitivity [e-/photon]; None: the table's own.
    """

    table: Spectrum
    letters: tuple[str, ...]
    photodetector: Spectrum | None = None
    ir_cut: Spectrum | None = None
    ends: str | None = None
    is_whole: bool = False
    peak: float | None = None

    def __repr__(self):
        return f"Filters({', '.join(self.letters)})"

    def missing(self, letters) -> set[str]:
        """Return the letters that have no curve, and whose curve does not follow from others."""
        known = set(self.letters)
        if {*"RGB"} <= known:
            known |= DERIVED.keys()
        elif "W" in known:
            known.add("N")
        return set(letters) - known

    def of(self, cfa) -> tuple[Spectrum, tuple[str, ...]]:
        """Return the quantum efficiency of a mosaic (C, L), and its letters.

        The letters are red, green and blue first, then in the order of the table. Raises BadData if
        a letter has no curve, or the parts have no wavelengths in common.
        """
        used = set("".join(mosaic(cfa) if isinstance(cfa, str) else cfa))
        letters = self.letters
        if len(letters) == len(used) == 1 and letters != tuple(used) and len(letters[0]) > 1:
            letters = tuple(used)  # one curve, named in words, of the only channel
        missing = used - set(letters) if letters is not self.letters else self.missing(used)
        if missing:
            known = ", ".join(letters) or "one without a letter"
            name = "sensitivity" if self.is_whole else "qe"
            raise BadData(
                f"[sensor] {name} has no curve for {', '.join(sorted(missing))}; it has {known}"
            )
        order = "RGB" + "".join(letter for letter in letters if len(letter) == 1)
        channels = tuple(sorted(used, key=(order + "".join(DERIVED)).index))
        derived = [letter for letter in channels if letter not in letters]
        table = self._extend() if "N" in derived else self.table
        own = dict(zip(letters, table.values, strict=True))
        for letter in derived:
            kind = (
                "W" if channels == ("Y",) else letter
            )  # Y, the only channel: luminance, no filter
            own[letter] = _derive(kind, own, table.wavelengths)
        scale = self._scale
        values = np.stack([own[letter] for letter in channels])
        product = Spectrum(
            table.wavelengths, values if scale == 1 else scale * values, table.name, SHARE
        )
        parts = [self.photodetector] + [self.ir_cut] * ("N" not in derived)
        for part in parts:
            if part is not None and not self.is_whole:
                product = multiply(product, part)
        if self.ends == "zero":
            low, high = product.wavelengths[0], product.wavelengths[-1]
            nodes = np.concatenate(
                [[0.1 * low, low - 1], product.wavelengths, [high + 1, 10 * high]]
            )
            product = Spectrum(nodes, np.pad(product.values, ((0, 0), (2, 2))), product.name, SHARE)
        return product, channels

    def notes(self, channels) -> tuple[str, ...]:
        """Return notes on curves of `channels` that were not measured as they are used."""
        derived = [letter for letter in channels if letter not in self.letters]
        if len(self.letters) == 1 and len(self.letters[0]) > 1:
            derived = []
        words = DERIVED | ({"Y": DERIVED["W"]} if channels == ("Y",) else {})
        notes = [f"curve of {letter}: {words[letter]}" for letter in derived]
        if "N" in derived and self.ir_cut is not None and not self.is_whole:
            notes.append("the infrared cut is left out, for the near-infrared pixels")
        if self.is_whole and self.peak is None and self._is_relative:
            notes.append(
                "relative sensitivities: the highest is taken as 1 e-/photon; sensitivity_peak says another"
            )
        return tuple(notes)

    @property
    def _is_relative(self):
        return float(self.table.values.max()) >= RELATIVE_PEAK[0]

    @property
    def _scale(self):
        """Factor on the table."""
        highest = float(self.table.values.max())
        if not self.is_whole or not highest > 0:
            return 1.0
        if self.peak is not None:
            return self.peak / highest
        return 1 / highest if highest > 1 else 1.0

    def _extend(self):
        """Return the table as far as the near infrared: 0 beyond its ends."""
        nodes, first = self.table.wavelengths, self.table.wavelengths[-1]
        low, full, last = NEAR_INFRARED
        if first >= last:
            return self.table
        more = np.append(np.arange(low, full + 1, 10), last)
        nodes = np.union1d(nodes, [first + 1, *more[more > nodes[0]]])
        return Spectrum(nodes, self.table.at(nodes), self.table.name)


def _derive(letter, own, nodes):
    """Return the curve of a letter from the known ones."""
    colours = [own[other] for other in "RGB" if other in own]
    clear = own["W"] if "W" in own else np.max(colours, axis=0)
    if letter == "W":
        return clear
    if letter in SUMS:
        one, other = SUMS[letter]
        return np.minimum(own[one] + own[other], clear)
    if letter == "E":
        return np.sqrt(own["G"] * own["B"])
    low, full, last = NEAR_INFRARED
    passes = np.clip((nodes - low) / (full - low), 0, 1)
    seen = np.flatnonzero(clear > 0)
    end = nodes[seen[-1]] if len(seen) else last
    # silicon's response beyond the measured end
    beyond = (clear[seen[-1]] if len(seen) else 0) * np.clip((last - nodes) / (last - end), 0, 1)
    return passes * np.where(nodes <= end, clear, beyond)


def multiply(first: Spectrum, second: Spectrum) -> Spectrum:
    """Return the product of two tables at the nodes of both in their common range.

    `first` may hold several functions. Raises BadData if there is none.
    """
    nodes = np.union1d(first.wavelengths, second.wavelengths)
    low = max(first.wavelengths[0], second.wavelengths[0])
    high = min(first.wavelengths[-1], second.wavelengths[-1])
    nodes = nodes[(nodes >= low) & (nodes <= high)]
    if len(nodes) < 2:
        raise BadData(f"[sensor] {first.name} and {second.name} have no wavelengths in common")
    return Spectrum(
        nodes, first.at(nodes) * second.at(nodes), f"{first.name} x {second.name}", SHARE
    )

"""What differs from one pair to the next: exposure time, speed, light and luminance, drawn for each pair by itself."""

import argparse
from dataclasses import dataclass
from math import isfinite

import numpy as np

from gpusim.domain.quantities import parse_seconds

NUMBERS = ("exposure", "iso", "luminance")
NAMES = (*NUMBERS, "light")


@dataclass(frozen=True)
class Variety:
    """Ranges and choices: name of NAMES -> (low, high), drawn evenly in the logarithm, or a tuple of names."""

    ranges: tuple[tuple[str, tuple], ...] = ()

    @classmethod
    def parse(cls, text: str) -> "Variety":
        """Of a command line: `exposure=1/200..1/20,iso=100..1600,luminance=10..1000,light=D65|A`."""
        found = {}
        for part in text.split(","):
            name, equals, value = part.partition("=")
            if not equals or name not in NAMES or name in found:
                raise argparse.ArgumentTypeError(
                    f"{part!r}: wanted NAME=LOW..HIGH, each once, NAME one of "
                    f"{', '.join(NUMBERS)}, or light=D65|A"
                )
            found[name] = _numbers(name, value) if name in NUMBERS else tuple(value.split("|"))
            if not all(found[name]):
                raise argparse.ArgumentTypeError(f"{part!r}: wanted names such as light=D65|A")
        return cls(tuple(found.items()))

    def drawn(self, seed: int, number: int) -> dict:
        """Values of a pair, by its number alone."""
        random = np.random.Generator(np.random.Philox(key=[seed, number]))
        values = {}
        for name, given in self.ranges:
            part = random.random()
            if name in NUMBERS:
                low, high = given
                values[name] = float(low * (high / low) ** part)
            else:
                values[name] = given[int(part * len(given))]
        return values


def _numbers(name, text):
    """The ends of a range, equal ones of a single number."""
    low, dots, high = text.partition("..")
    try:
        read = parse_seconds if name == "exposure" else float
        ends = read(low), read(high if dots else low)
    except (ValueError, argparse.ArgumentTypeError):
        ends = (0.0, 0.0)
    if not (all(isfinite(end) for end in ends) and 0 < ends[0] <= ends[1]):
        raise argparse.ArgumentTypeError(f"{name}={text}: wanted LOW..HIGH, or a number, above 0")
    return ends

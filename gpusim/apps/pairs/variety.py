"""Settings that are drawn for each pair: exposure time, ISO speed, light and luminance."""

import argparse
from dataclasses import dataclass
from math import isfinite

import numpy as np

from gpusim.domain.quantities import parse_seconds

NUMBERS = ("exposure", "iso", "luminance")
NAMES = (*NUMBERS, "light")


@dataclass(frozen=True)
class Variety:
    """Ranges and choices.

    Attributes:
        ranges: Name of NAMES, and (low, high), drawn evenly in the logarithm, or a tuple of names.
    """

    ranges: tuple[tuple[str, tuple], ...] = ()

    @classmethod
    def parse(cls, text: str) -> "Variety":
        """Return the variety of `exposure=1/200..1/20,iso=100..1600,light=D65|A`. Raises ArgumentTypeError."""
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
                raise argparse.ArgumentTypeError(f"{part!r}: wanted names, for example light=D65|A")
        return cls(tuple(found.items()))

    def draw(self, seed: int, number: int) -> dict:
        """Return the values of a pair. They depend only on the seed and its number."""
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


def scene_options(values: dict) -> dict:
    """Return the drawn values that are arguments of `open_scene`."""
    return {name: values[name] for name in ("light", "luminance") if name in values}


def _numbers(name, text):
    """Return the ends of a range; a single number is both."""
    low, dots, high = text.partition("..")
    try:
        read = parse_seconds if name == "exposure" else float
        ends = read(low), read(high if dots else low)
    except (ValueError, argparse.ArgumentTypeError):
        ends = (0.0, 0.0)
    if not (all(isfinite(end) for end in ends) and 0 < ends[0] <= ends[1]):
        raise argparse.ArgumentTypeError(f"{name}={text}: wanted LOW..HIGH, or a number, above 0")
    return ends

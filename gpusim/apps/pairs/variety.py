"""Settings that are drawn for each pair: exposure time, ISO speed, light and luminance."""

from dataclasses import dataclass

import numpy as np

from gpusim.apps.video.named import read_named, read_positive

NUMBERS = ("exposure", "iso", "luminance")


@dataclass(frozen=True)
class Variety:
    """Ranges and choices.

    Attributes:
        ranges: Name and (low, high), drawn evenly in the logarithm, or a tuple of names.
    """

    ranges: tuple[tuple[str, tuple], ...] = ()

    @classmethod
    def parse(cls, text: str) -> "Variety":
        """Return the variety of `exposure=1/200..1/20,iso=100..1600,light=D65|A`.

        Raises ArgumentTypeError.
        """
        names = ", ".join(NUMBERS)
        wanted = f"NAME=LOW..HIGH or a number, above 0, each NAME once: {names}, or light=D65|A"
        return cls(tuple(read_named(text, _values, wanted).items()))

    @property
    def most(self) -> dict:
        """The largest values of numbers that may be drawn."""
        return {name: given[1] for name, given in self.ranges if name in NUMBERS}

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


def _values(name, text):
    """Return the ends of a range (a single number is both), or names of lights."""
    if name == "light":
        values = tuple(text.split("|"))
        if not all(values):
            raise ValueError
        return values
    if name not in NUMBERS:
        raise ValueError
    low, dots, high = text.partition("..")
    ends = read_positive(name, low), read_positive(name, high if dots else low)
    if ends[0] > ends[1]:
        raise ValueError
    return ends

"""A hard case: a criterion with its figure, and a function that measures the figure on a device."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from gpusim.backends import Device


class Found(NamedTuple):
    """The result of one measurement.

    Attributes:
        got: The measured figure.
        limit: The largest allowed figure.
        words: The meaning of the figure, and secondary results.
    """

    got: float
    limit: float
    words: str


@dataclass(frozen=True)
class Case:
    """One hard case.

    Attributes:
        number: Its number.
        name: Its name.
        asked: Its criterion, with figures.
        run: Function that measures the figure on a device.
    """

    number: int
    name: str
    asked: str
    run: Callable[[Device], Found]


CASES: dict[int, Case] = {}


def case(number: int, name: str, asked: str):
    """Return a decorator that registers the case of this number.

    The function yields a Found for each measurement on a device; the result is the worst of them.
    """

    def add(measure: Callable[[Device], Iterator[Found]]):
        CASES[number] = Case(number, name, asked, lambda device: worst(*measure(device)))
        return measure

    return add


def worst(*found: Found) -> Found:
    """Return the result that is closest to its limit or farthest beyond, with the words of all.

    A limit of 0 allows nothing: any larger figure is infinitely far beyond it.
    """

    def ratio(one):
        share = one.got / one.limit if one.limit else (0.0 if one.got <= 0 else float("inf"))
        return share if share == share else float("inf")

    most = max(found, key=ratio)
    others = "; ".join(
        f"{one.words}: {one.got:.2g} of {one.limit:.2g}" for one in found if one is not most
    )
    return Found(most.got, most.limit, most.words + (f"; {others}" if others else ""))

"""What a hard case is: a criterion with its figure, and a function that finds what a device makes of it."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from gpusim.backends import Device


class Found(NamedTuple):
    """got: the figure found. limit: the largest allowed. words: what the figure is, and what was found beside."""

    got: float
    limit: float
    words: str


@dataclass(frozen=True)
class Case:
    """One hard case. asked: its criterion, with figures. run: what a device makes of it."""

    number: int
    name: str
    asked: str
    run: Callable[[Device], Found]


CASES: dict[int, Case] = {}


def case(number: int, name: str, asked: str):
    """Make a function (device) -> Found the case of this number."""

    def add(run):
        CASES[number] = Case(number, name, asked, run)
        return run

    return add


def worst(*found: Found) -> Found:
    """The one that is nearest to its limit or farthest beyond, with the words of all; every one is asked for.

    A limit of 0 allows nothing: any more is infinitely far beyond.
    """

    def ratio(one):
        share = one.got / one.limit if one.limit else (0.0 if one.got <= 0 else float("inf"))
        return share if share == share else float("inf")

    most = max(found, key=ratio)
    others = "; ".join(
        f"{one.words}: {one.got:.2g} of {one.limit:.2g}" for one in found if one is not most
    )
    return Found(most.got, most.limit, most.words + (f"; {others}" if others else ""))

"""Estimates with intervals, and the part of a camera that one kind of frames gives."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from gpusim.domain.short_repr import short_repr

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Estimate:
    """A number with its interval of 95 % confidence.

    Args:
        value: The estimate.
        low, high: Ends of the interval.
        unit: Unit, "" for none.
        sources: Names of the files behind it.
        note: A condition or an assumption, "" for none.
    """

    value: float
    low: float
    high: float
    unit: str = ""
    sources: tuple[str, ...] = ()
    note: str = ""

    __repr__ = short_repr


@dataclass(frozen=True)
class Plot:
    """A figure of the page.

    Args:
        title: Its heading.
        caption: Its content, in a sentence or two.
        draw: Draws it on an empty figure of Matplotlib.
    """

    title: str
    caption: str
    draw: "Callable[[Figure], None]"


@dataclass(frozen=True)
class Part:
    """The part of a camera that one kind of frames gives.

    Args:
        name: "noise", "colour", "sharpness", "distortion", "shading", "tone" and the like.
        estimates: By camera key, such as "noise.read_e", with " at ISO 800" or " of R" after it if there
            are several.
        settings: Values for the camera file by section and key; arrays go to files next to it.
        plots: Figures of fits and residuals.
        unexplained: Lines: findings outside the model, with their size.
        unknown: Lines: numbers that these frames do not give, and shots that would.
    """

    name: str
    estimates: Mapping[str, Estimate] = field(default_factory=dict)
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    plots: tuple[Plot, ...] = ()
    unexplained: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()

    __repr__ = short_repr

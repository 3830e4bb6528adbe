"""Panels of measurements beside the picture: what each needs, follows and shows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from gpusim.apps.preview import panels_lens, panels_light, panels_picture, panels_sensor
from gpusim.apps.preview.figures import Note, Part
from gpusim.apps.preview.measures import Inputs, Where
from gpusim.apps.preview.panels_kept import Kept
from gpusim.domain.errors import GpusimError, one_line

CHANNELS = ("channel",)  # choices that are the letters of the camera's channels

Chosen = dict[str, str]
Read = Callable[[Inputs, Where, Chosen, Kept], Sequence[Part]]
PLACES = {"at", "part"}  # attributes of Where
IRRADIANCE = {"irradiance", "electrons"}  # quantities of spectra that need it


def _needs_nothing(chosen, where):
    return ()


@dataclass(frozen=True)
class Panel:
    """A panel.

    Attributes:
        name: Name for links and tests.
        title: Title on the page.
        read: Returns the panel's content. It may raise any error, which is shown in its place.
        follows: What its content depends on beside its options: "picture", "camera", "scene",
            "seconds" (attributes of Inputs), "at", "part" (of Where).
        needs: Returns the names of the arrays that it needs, see Inputs.
        options: Choices by name; the first is chosen at first.
        is_slow: Whether it is computed by itself, so that it does not hold up the others.
    """

    name: str
    title: str
    read: Read
    follows: tuple[str, ...]
    needs: Callable[[Chosen, Where], Sequence[str]] = _needs_nothing
    options: dict[str, tuple[str, ...]] = field(default_factory=dict)
    is_slow: bool = False

    def inputs(self, found: Inputs, where: Where, chosen: Chosen) -> tuple:
        """Return what the content depends on, for `gpusim.pipeline.cache.same`."""
        there = tuple(name in found.arrays for name in self.needs(chosen, where))
        own = (getattr(where if name in PLACES else found, name) for name in self.follows)
        return *own, there, *chosen.items()

    def content(
        self, found: Inputs, where: Where, chosen: Chosen, kept: Kept
    ) -> tuple[list[Part], str]:
        """Return its parts and their HTML; if it fails, no parts and the reason."""
        try:
            parts = list(self.read(found, where, chosen, kept))
            return parts, "".join(part.html() for part in parts)
        except Exception as error:  # a panel that fails is a line of text
            return [], self.explain(error)

    def explain(self, error: Exception) -> str:
        """Return the HTML of an error in one line."""
        words = str(error) or type(error).__name__
        if not isinstance(error, GpusimError):
            words = f"{self.title} fails: {words}"
        return Note(one_line(words)).html()

    def choices(self, channels: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
        """Return the choices by name, of a camera with these channels."""
        found = {}
        for name, choices in self.options.items():
            if choices == CHANNELS:
                middle = channels[min(1, len(channels) - 1)]
                choices = (middle, *(letter for letter in channels if letter != middle))
            found[name] = choices
        return found


def _array(*names: str) -> Callable[[Any, Any], Sequence[str]]:
    return lambda chosen, where: names


def _spectrum_needs(chosen, where):
    return ("irradiance",) if chosen["quantity"] in IRRADIANCE else ()


def _profile_needs(chosen, where):
    return (panels_light.PROFILES[chosen["quantity"]][0],)


def _edge_needs(chosen, where):
    return ("linear",) if where.part is not None else ()


PANELS = {
    panel.name: panel
    for panel in (
        Panel(
            "histogram",
            "Histogram",
            panels_light.histogram,
            ("picture",),
            _array("raw"),
            {"scale": ("log", "linear")},
        ),
        Panel(
            "spectrum",
            "Spectrum",
            panels_light.spectrum,
            ("scene", "camera", "seconds", "at", "part"),
            _spectrum_needs,
            {"quantity": ("radiance", "irradiance", "electrons")},
        ),
        Panel("plan", "Plan", panels_picture.plan, ("account", "ms"), _array("times")),
        Panel(
            "profile",
            "Line profile",
            panels_light.profile,
            ("picture", "at"),
            _profile_needs,
            {"quantity": tuple(panels_light.PROFILES), "along": ("row", "column")},
        ),
        Panel(
            "region",
            "Region",
            panels_light.region,
            ("picture", "at", "part"),
            _array("raw"),
        ),
        Panel(
            "mtf",
            "MTF",
            panels_lens.mtf,
            ("picture", "camera", "scene", "at", "part"),
            _edge_needs,
            {"direction": ("across", "down")},
            is_slow=True,
        ),
        Panel(
            "psf",
            "Point spread",
            panels_lens.psf,
            ("camera", "scene", "at"),
            options={"channel": CHANNELS},
            is_slow=True,
        ),
        Panel("qe", "Quantum efficiency", panels_sensor.efficiency, ("camera",)),
        Panel(
            "snr",
            "Signal to noise",
            panels_sensor.snr,
            ("picture", "at", "part"),
            _array("mean"),
        ),
        Panel(
            "budget",
            "Noise budget",
            panels_sensor.budget,
            ("picture", "at", "part"),
            _array("mean"),
        ),
        Panel(
            "checker",
            "ColorChecker",
            panels_picture.checker,
            ("picture", "scene"),
            _array("linear"),
            is_slow=True,
        ),
    )
}
DEFAULTS = ("histogram", "spectrum", "plan")  # open at first

"""Parts of a fit by the kind of their shots."""

from collections.abc import Callable, Sequence
from importlib import import_module

from gpusim.fit.estimate import Part
from gpusim.fit.shots import Known, Shot

PartFunction = Callable[[Sequence[Shot], Known], Part]

# kind of shots -> modules and functions (shots, known) -> Part
PART_FUNCTIONS: dict[str, tuple[tuple[str, str], ...]] = {
    "chart": (("optics_parts", "chart_part"),),
    "edges": (("optics_parts", "edges_part"),),
    "grid": (("optics_parts", "grid_part"),),
    "shading": (("optics_parts", "shading_part"),),
    "ramp": (("optics_parts", "ramp_part"),),
}


def part_functions(kind: str) -> list[PartFunction]:
    """Return the functions that make parts from shots of a kind."""
    return [
        getattr(import_module(f"gpusim.fit.{module}"), name)
        for module, name in PART_FUNCTIONS.get(kind, ())
    ]

"""How the pipeline gets at the truth, which is in a package above it: `gpusim` hands it in."""

from collections.abc import Callable
from types import ModuleType

load: Callable[[], ModuleType]  # gives `gpusim.judge.truth`

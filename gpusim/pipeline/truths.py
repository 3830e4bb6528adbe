"""Gives the pipeline access to `gpusim.judge.truth`, a package above it. `gpusim` sets `load`."""

from collections.abc import Callable
from types import ModuleType

load: Callable[[], ModuleType]  # returns `gpusim.judge.truth`

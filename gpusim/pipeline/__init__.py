"""Runs plans on a device: the steps of a frame, their order, and the cache between frames."""

from collections.abc import Callable
from types import ModuleType

load_truth: Callable[
    [], ModuleType
]  # returns `gpusim.judge.truth`, a package above; `gpusim` sets it

"""Runs plans on a device: the steps of a frame, their order, and the cache between frames."""

from collections.abc import Callable
from types import ModuleType

# returns `gpusim.judge.truth`, a package above this one; `gpusim` sets it
load_truth: Callable[[], ModuleType]

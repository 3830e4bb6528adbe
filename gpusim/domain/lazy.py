"""Modules that are loaded at their first use, although a library imports them at its start."""

import sys
from importlib.util import LazyLoader, find_spec, module_from_spec


def load_at_use(name: str):
    """Load a submodule when one of its attributes is read, not when it is imported.

    Args:
        name: Full name, such as "numpy.f2py". A module that is loaded already stays as it is.
    """
    if name in sys.modules or (spec := find_spec(name)) is None or spec.loader is None:
        return
    spec.loader = LazyLoader(spec.loader)
    module = sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(module)
    parent, _, own = name.rpartition(".")
    setattr(sys.modules[parent], own, module)

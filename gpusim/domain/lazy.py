"""Modules that are loaded at their first use, although a library imports them at its start."""

import sys
from importlib import import_module
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


def load_whole(name: str):
    """Load a package before its parts are imported inside a function, which threads may do at once.

    Python lets a thread import a part of a package that another thread is still loading. If the
    parts import each other, as those of colour-science do, one thread then meets half of a module.
    The import of the package itself waits for the other thread.

    Args:
        name: Name of the package, such as "colour".
    """
    import_module(name)

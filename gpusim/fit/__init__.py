"""Cameras from their own raw files: `gpusim.fit(...)`, and the parts of a fit."""

import sys
from types import ModuleType


class _Package(ModuleType):
    """The package, which is also the function `gpusim.fit` when a part of it is imported first."""

    def __call__(self, *args, **settings):
        from gpusim.fit.fitting import fit

        return fit(*args, **settings)


sys.modules[__name__].__class__ = _Package

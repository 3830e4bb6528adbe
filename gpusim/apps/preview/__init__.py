"""Live preview: move a slider, see the camera change; `gpusim preview`, and `gs.preview(scene, camera)` in Jupyter.

The package is itself the function: whoever imports one of its modules has the package at `gpusim.apps.preview`.
"""

import sys
from types import ModuleType
from typing import cast


class _Function(ModuleType):
    """A package that can be called."""

    def __call__(self, scene, camera, *, device="auto", tolerance: str | None = "1e-3"):
        """A widget for Jupyter: sliders, and a picture of the scene that follows them.

        scene: a Scene, or what `open_scene` takes. camera: a built-in one's name, a camera file, or a Camera. device: a
        name for `open_device`, or a Device. tolerance: of `gpusim.apps.preview.controls.TOLERANCES`; None is "exact".
        Returns a `gpusim.apps.preview.notebook.Preview`. Raises GpusimError: without ipywidgets and simplejpeg,
        for a scene, a camera, a device or a tolerance that there is not.
        """
        from gpusim.domain.errors import Missing

        try:
            import ipywidgets  # noqa: F401
            import simplejpeg  # noqa: F401
        except ImportError as error:
            raise Missing(
                f"preview: {error.name} is not installed; wanted: pip install 'gpusim[notebook]'"
            ) from None
        from gpusim.apps.preview.notebook import opened

        return opened(scene, camera, device, tolerance)


sys.modules[__name__].__class__ = _Function
preview = cast(_Function, sys.modules[__name__])

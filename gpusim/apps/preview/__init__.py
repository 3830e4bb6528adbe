"""Live preview with sliders: `gpusim preview`, and `gs.preview(scene, camera)` in Jupyter.

The package is callable, because an import of one of its modules sets `gpusim.apps.preview` to the
package.
"""

import sys
from types import ModuleType
from typing import TYPE_CHECKING, cast

if TYPE_CHECKING:
    from gpusim.apps.preview.notebook import Preview
    from gpusim.backends import Device
    from gpusim.captures.capture import Capture
    from gpusim.domain.camera import Camera
    from gpusim.domain.scene import Scene


class _Function(ModuleType):
    """A package that can be called."""

    def __call__(
        self,
        scene: "Scene | str",
        camera: "Camera | str",
        *,
        device: "Device | str" = "auto",
        tolerance: str | None = "1e-3",
        capture: "Capture | None" = None,
    ) -> "Preview":
        """Return a widget for Jupyter: sliders, and a picture of the scene that follows them.

        Args:
            scene: A Scene, or the name of a chart or file.
            camera: A Camera, the name of a built-in camera, or a camera file.
            device: Name of the device, or a Device.
            tolerance: One of `gpusim.apps.preview.controls.TOLERANCES`. None: "exact".
            capture: Capture of each picture, of one frame or merged. None: one frame at rest.

        Returns:
            A `gpusim.apps.preview.notebook.Preview`.

        Raises:
            GpusimError: If ipywidgets or simplejpeg is not installed, or an argument is unknown.
        """
        from gpusim.domain.errors import Missing

        try:
            import ipywidgets  # noqa: F401
            import simplejpeg  # noqa: F401
        except ImportError as error:
            why = f"preview: {error.name} is not installed; wanted: pip install 'gpusim[notebook]'"
            raise Missing(why) from None
        from gpusim.apps.preview.notebook import open_widget

        return open_widget(scene, camera, device, tolerance, capture)


sys.modules[__name__].__class__ = _Function
preview = cast(_Function, sys.modules[__name__])

"""Settings of a camera that is an object, not a file."""

from dataclasses import dataclass, replace

from gpusim.apps.preview.controls import CONTROLS
from gpusim.apps.preview.state import State
from gpusim.domain.camera import Camera
from gpusim.domain.camera_keys import SECTIONS, section_fields
from gpusim.domain.errors import BadData


@dataclass(frozen=True)
class Given(State):
    """A State that overrides some fields of the camera `adopt_plan` and leaves the rest unchanged."""

    given: Camera | None = None

    def table(self) -> dict:
        """Raise BadData: there is no file."""
        raise BadData(
            f"camera {self.camera!r} is an object without a file; wanted a camera's name or a camera "
            "file"
        )

    def build(self) -> Camera:
        """Return the camera. Raises GpusimError."""
        camera = self.given
        assert camera is not None
        zernike = _lists(camera.optics.wavefront.zernike)
        table = self.apply_changes({"optics": {"zernike_waves": zernike}})
        optics, sensor, noise, processor = (
            section_fields(camera.name, table, section)
            for section in ("optics", "sensor", "noise", "processor")
        )
        optics["wavefront"] = replace(camera.optics.wavefront, zernike=optics.pop("zernike"))
        sensor["noise"] = replace(camera.sensor.noise, **noise)
        return replace(
            camera,
            optics=replace(camera.optics, **optics),
            sensor=replace(camera.sensor, **sensor),
            processor=replace(camera.processor, **processor),
        )


def table_of(camera: Camera) -> dict:
    """Return the values of the controls as in a camera file, to 12 digits, for display only."""
    parts = {
        "optics": camera.optics,
        "sensor": camera.sensor,
        "noise": camera.sensor.noise,
        "processor": camera.processor,
    }
    table: dict = {section: {} for section in parts}
    for control in CONTROLS.values():
        field, read = SECTIONS[control.section][control.key]
        owner = camera.optics.wavefront if field == "zernike" else parts[control.section]
        value = getattr(owner, field)
        if value is None:
            value = control.off
        elif isinstance(value, float):
            value = float(f"{value / read(1.0):.12g}")  # in the file's unit
        table[control.section][control.key] = value
    return table


def _lists(value):
    return [*map(_lists, value)] if isinstance(value, tuple) else value

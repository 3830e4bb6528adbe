"""Settings of a camera that is an object, not a file."""

from dataclasses import asdict, dataclass

import numpy as np

from gpusim.apps.preview.state import State
from gpusim.domain.camera import Camera
from gpusim.domain.camera_keys import SECTIONS
from gpusim.domain.errors import BadData
from gpusim.domain.exposure import AutoExposure
from gpusim.domain.pupil import Pupil


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
        own = self.own_keys(table_of(camera))
        return camera.with_(
            **{
                f"{section}.{key}": value
                for section, keys in own.items()
                for key, value in keys.items()
            }
        )


def table_of(camera: Camera) -> dict:
    """Return a camera's values as in a camera file, to 12 digits, for display only.

    Curves, maps and files are left out.
    """
    optics, sensor = camera.optics, camera.sensor
    owners = {
        "optics": (optics.wavefront, optics),
        "sensor": (sensor,),
        "noise": (sensor.noise,),
        "processor": (camera.processor,),
        "display": (camera.display,),
    }
    table: dict = {section: {} for section in owners}
    for section, keys in SECTIONS.items():
        for key, (field, read) in keys.items():
            owner = next((one for one in owners[section] if hasattr(one, field)), None)
            value = _as_in_file(getattr(owner, field, None), read)
            if value is not None:
                table[section][key] = value
    return table


def _as_in_file(value, read):
    """Return a field's value in the file's unit and form; None if it has none."""
    if isinstance(value, float):
        one = read(1.0)
        return float(f"{value / one:.12g}") if isinstance(one, float) else value
    if isinstance(value, Pupil):
        found = asdict(value)
        found.pop("mask")
        turned = float(np.degrees(found.pop("rotation")))
        return found | {"rotation_deg": float(f"{turned:.12g}")}
    if isinstance(value, AutoExposure):
        if value == AutoExposure():
            return None
        found = {"method": value.method, "level": value.level, "percentile": value.percentile}
        longest = {} if value.longest is None else {"longest_ms": 1e3 * value.longest}
        return found | longest | {"most_gain": value.most_gain}
    if isinstance(value, tuple) and value and all(isinstance(one, float) for one in value):
        units = read([1.0] * len(value))
        return [float(f"{one / unit:.12g}") for one, unit in zip(value, units, strict=True)]
    if isinstance(value, tuple):
        return _lists(value)
    return value if isinstance(value, bool | int | str) else None


def _lists(value):
    return [*map(_lists, value)] if isinstance(value, tuple) else value

"""A camera: lens, sensor, processor and the display its pictures are made for."""

from dataclasses import dataclass, field

from gpusim.domain.display import Display
from gpusim.domain.errors import OutOfRange
from gpusim.domain.optics import Optics
from gpusim.domain.processor import Processor
from gpusim.domain.sensor import Sensor


@dataclass(frozen=True)
class Camera:
    """Everything between a scene's radiance and a picture of it.

    Raises OutOfRange when the parts do not go together.
    """

    name: str
    optics: Optics
    sensor: Sensor
    processor: Processor = field(default_factory=Processor)
    display: Display = field(default_factory=Display)

    def __post_init__(self):
        if self.processor.color != "none" and len(self.sensor.channels) < 3:
            raise OutOfRange("processor.color", f'"{self.processor.color}"',
                             f'"none" for a sensor of {len(self.sensor.channels)} channel(s): '
                             "colour needs at least 3")

"""A camera: lens, sensor, image processor, and the display its pictures are made for."""

from dataclasses import dataclass, field
from typing import Any

from gpusim.domain.display import Display
from gpusim.domain.errors import BadData, Conflict, OutOfRange
from gpusim.domain.guided import BUILT_IN, built_in_name
from gpusim.domain.labels import Tabled
from gpusim.domain.mosaics import bayer_roles
from gpusim.domain.network import check_served, is_served
from gpusim.domain.optics import Optics
from gpusim.domain.processor import ROOT_POLYNOMIALS, Processor
from gpusim.domain.sensor import FLOAT_BITS, Sensor
from gpusim.domain.short_repr import shorten_repr


def checked_camera(camera) -> "Camera":
    """Return `camera`. Raise BadData if it is not a Camera."""
    if not isinstance(camera, Camera):
        raise BadData(
            f"camera: {type(camera).__name__}, wanted a Camera, for example from open_camera"
        )
    return camera


@dataclass(frozen=True)
class Camera(Tabled):
    """Everything between the radiance of a scene and a picture of it.

    Args:
        name: Name in reports and files.
        optics: The lens.
        sensor: The image sensor.
        processor: The image processor.
        display: The display that pictures are encoded for.
        notes: What of its files is not used; reports repeat them.

    Raises:
        Conflict: The point spreads of dual pixels are measured.
        OutOfRange: The settings of two parts exclude each other.
        UnknownName: A learned filter table is for another mosaic.
    """

    name: str
    optics: Optics
    sensor: Sensor
    processor: Processor = field(default_factory=Processor)
    display: Display = field(default_factory=Display)
    notes: tuple[str, ...] = field(
        default=(), compare=False, repr=False, metadata={"digest": False}
    )

    def __post_init__(self):
        self._check_mosaic()
        if self.sensor.dual is not None and not self.optics.has_wave:
            raise Conflict(
                "sensor.dual",
                "measured point spreads hold no wave, which pixels divide by its direction",
                'set optics.model = "diffraction", or leave dual out',
            )
        if self.processor.white_balance == "red-blue" and not {*"RB"} <= {*self.sensor.channels}:
            raise OutOfRange(
                "processor.white_balance",
                f'"red-blue" of the channels {", ".join(self.sensor.channels)}',
                "another way: it needs channels R and B",
            )
        white = self.processor.white
        if white and len(white) != len(self.sensor.channels):
            raise OutOfRange(
                "processor.white",
                list(white),
                f"{len(self.sensor.channels)} numbers, of the channels "
                f"{', '.join(self.sensor.channels)}",
            )
        if self.processor.color != "none" and len(self.sensor.channels) < 3:
            raise OutOfRange(
                "processor.color",
                f'"{self.processor.color}"',
                f'"none" for a sensor of {len(self.sensor.channels)} channel(s): '
                "colour needs at least 3",
            )
        self._check_roots()

    def __repr__(self):
        optics, sensor = self.optics, self.sensor
        mosaic = "stacked " + "".join(sensor.channels) if sensor.stacked else "/".join(sensor.cfa)
        time = (
            "automatic exposure"
            if sensor.exposure_time is None
            else f"{1e3 * sensor.exposure_time:.4g} ms"
        )
        bits = "no converter" if sensor.bits == FLOAT_BITS else f"{sensor.bits} bits"
        return shorten_repr(
            f"Camera({self.name!r}, f/{optics.f_number:g}, {1e3 * optics.focal_length:.4g} mm, pixels of "
            f"{1e6 * sensor.pixel_pitch:.4g} um, {mosaic}, {bits}, {time})"
        )

    def with_(self, **changes: Any) -> "Camera":
        """Return a camera with some settings changed: `camera.with_(f_number=2.0, read_e=3)`.

        Args:
            changes: New values, with keys and units of camera files. If a key occurs in two
                sections, write the section too: `with_(**{"processor.white": [2, 1, 1.5]})`. Values
                have the form of a camera file. A value that a file names or tabulates is passed as
                the object, in the unit of the field: Spectrum, Pupil, PointSpread, FilterTable,
                Microlens, DualPixels. Whole parts are accepted too (optics, sensor, processor, display), and
                are replaced before other changes.

        Returns:
            The new camera.

        Raises:
            UnknownName: A key is not known.
            BadData: A value has the wrong type.
            OutOfRange: A value is outside its range.
        """
        from gpusim.domain.changes import apply_changes

        return apply_changes(self, changes)

    @property
    def demosaic_method(self) -> str:
        """The processor's demosaicking method, with "auto" replaced by what suits the mosaic.

        That is "best" for mosaics like Bayer's with other channels (see `bayer_roles`), "learned"
        for others that have built-in filters, else "bilinear".
        """
        name, sensor = self.processor.demosaic, self.sensor
        if name != "auto":
            return name
        if sensor.stacked or sensor.bayer_phase:
            return "bilinear"
        if bayer_roles(sensor.cfa):
            return "best"
        return "learned" if self.built_in_filters else "bilinear"

    @property
    def built_in_filters(self) -> str | None:
        """Name of the mosaic whose built-in filters serve the sensor, None for Bayer and others."""
        return built_in_name(self.sensor.cfa)

    @property
    def is_developed_at_once(self) -> bool:
        """True if one pass turns raw values into display codes.

        This holds for bilinear demosaicking of a Bayer mosaic without other processing of raw
        values.
        """
        sensor, processor = self.sensor, self.processor
        return (
            self.demosaic_method == "bilinear"
            and sensor.bayer_phase is not None
            and not sensor.stacked
            and sensor.bits != FLOAT_BITS
            and processor.defects == "none"
            and not processor.denoising
            and not processor.corrects_shading
            and not processor.rebuilds_highlights
            and not processor.corrects_lens
            and not processor.sharpening
            and not processor.local_toning
            and not processor.maps_gamut
            and not processor.estimates_white
            and processor.color not in ROOT_POLYNOMIALS
        )

    def _check_roots(self):
        table = self.processor.table
        planes = self.sensor.channels if table is None else table.layout.outputs
        if self.processor.color in ROOT_POLYNOMIALS and len(planes) != 3:
            raise OutOfRange(
                "processor.color",
                f'"{self.processor.color}" of the channels {", ".join(planes)}',
                'three channels; use "white-preserving"',
            )

    @property
    def _demosaics(self):
        """The methods for a mosaic that is not Bayer's, without a table."""
        if bayer_roles(self.sensor.cfa):
            return ("bilinear", "malvar", "adaptive", "best")
        return ("bilinear", "learned") if self.built_in_filters else ("bilinear",)

    def _check_mosaic(self):
        sensor, processor = self.sensor, self.processor
        if sensor.is_monochrome or sensor.stacked:
            return
        mosaic = "/".join(sensor.cfa)
        if processor.demosaic == "learned" and processor.table is not None:
            processor.table.layout.shift(sensor.cfa)  # UnknownName if it is for another mosaic
            if processor.table.layout.gives_xyz and (processor.estimates_white or processor.white):
                raise OutOfRange(
                    "processor.white_balance",
                    f'"{processor.white_balance}" with filters that give XYZ',
                    '"illuminant" or "none": they balance white already',
                )
        elif processor.demosaic == "network":
            check_served(sensor.cfa)
        elif not sensor.bayer_phase and self.demosaic_method not in self._demosaics:
            names = [name for name in self._demosaics if name != "learned"]
            allowed = ", ".join(f'"{name}"' for name in ("auto", *names))
            allowed += ', "learned" with a table made by `gpusim train-l3`'
            if is_served(sensor.cfa):
                allowed += ', or "network"'
            if processor.demosaic == "learned":
                allowed += f"; without a table, Bayer and {', '.join(BUILT_IN)} mosaics"
            raise OutOfRange(
                "processor.demosaic", f'"{processor.demosaic}" of the mosaic {mosaic}', allowed
            )

"""The lens: from scene radiance to the irradiance at the sensor."""

from dataclasses import dataclass

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange, UnknownName
from gpusim.domain.spectrum import Spectrum

MODELS = ("diffraction", "none")
RELATIVE_ILLUMINATIONS = ("cos4", "none")
AIRY_FIRST_ZERO = 1.2196698912665045  # first zero of J1, divided by pi: the "1.22" of textbooks


@dataclass(frozen=True)
class Optics:
    """A thin lens with a circular aperture, focused at `object_distance`.

    f_number: N = focal length / aperture diameter [1].
    focal_length: [m].
    model: what blurs the image: "diffraction" (the ideal lens: nothing but its aperture) or "none".
    transmission: T(lambda) in 0 .. 1, one number or a Spectrum of one function.
    relative_illumination: fall-off with the field angle, "cos4" or "none".
    object_distance: distance of the plane in focus [m]; infinity by default.
    Raises BadData, OutOfRange, UnknownName.
    """

    f_number: float
    focal_length: float
    model: str = "diffraction"
    transmission: Spectrum | float = 1.0
    relative_illumination: str = "cos4"
    object_distance: float = np.inf

    def __post_init__(self):
        if not 0.1 <= self.f_number <= 1000:
            raise OutOfRange("optics.f_number", self.f_number, "0.1 <= f_number <= 1000")
        if not 0 < self.focal_length < np.inf:
            raise OutOfRange("optics.focal_length", f"{self.focal_length:.6g} m", "0 < focal_length < inf")
        if not self.object_distance > self.focal_length:
            # At the focal length and nearer a lens forms no real image.
            raise OutOfRange("optics.object_distance", f"{self.object_distance:.6g} m",
                             f"object_distance > focal_length ({self.focal_length:.6g} m)")
        if self.model not in MODELS:
            raise UnknownName("optics.model", self.model, MODELS)
        if self.relative_illumination not in RELATIVE_ILLUMINATIONS:
            raise UnknownName("optics.relative_illumination", self.relative_illumination, RELATIVE_ILLUMINATIONS)
        values = self.transmission
        if isinstance(values, Spectrum):
            values = values.values
            if values.ndim != 1:
                raise BadData(f"optics.transmission: wanted one function of wavelength, got {len(values)}")
        low, high = np.min(values), np.max(values)
        if not (low >= 0 and high <= 1):
            raise OutOfRange("optics.transmission", f"{low:.6g} .. {high:.6g}", "0 <= transmission <= 1")

    @property
    def magnification(self) -> float:
        """Image size over object size, m = -f / (d - f): negative (upside down), 0 for a scene at infinity."""
        return -self.focal_length / (self.object_distance - self.focal_length)

    @property
    def image_distance(self) -> float:
        """Distance from the lens to the focused image [m], f (1 + |m|)."""
        return self.focal_length * (1 + abs(self.magnification))

    @property
    def working_f_number(self) -> float:
        """N (1 + |m|) [1]: what the image sees when the lens is focused nearer than infinity."""
        return self.f_number * (1 + abs(self.magnification))

    @property
    def irradiance_factor(self) -> float:
        """On-axis irradiance over radiance [sr] of a lossless lens: pi / (1 + 4 N^2 (1 + |m|)^2).

        This is pi sin^2(theta) of the cone of half-angle tan(theta) = 1 / (2 N (1 + |m|)) that the aperture fills as
        seen from the image. The often quoted pi / (4 N^2) is its limit for large N and m = 0; at f/4 it is 1.6 % more.
        """
        return np.pi / (1 + 4 * self.working_f_number**2)

    def transmission_at(self, wavelengths) -> np.ndarray:
        """T at `wavelengths` [nm], shape (L,); beyond the ends of a table the end values go on."""
        if isinstance(self.transmission, Spectrum):
            return self.transmission.at(wavelengths, outside=None)
        return np.full(np.shape(wavelengths), float(self.transmission))

    def airy_radius(self, wavelength):
        """Radius of the first dark ring [m] at `wavelength` [nm]: 1.21967 lambda N (1 + |m|).

        Source: Born and Wolf, Principles of Optics, 8.5.2; N (1 + |m|) is N for a scene at infinity.
        """
        return AIRY_FIRST_ZERO * np.asarray(wavelength) * 1e-9 * self.working_f_number

"""The lens: from scene radiance to the irradiance at the sensor."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from gpusim.domain.distortion import Distortion
from gpusim.domain.errors import BadData, OutOfRange, UnknownName, check_fields, within
from gpusim.domain.mask import Mask, combine_masks
from gpusim.domain.psf import PointSpread
from gpusim.domain.pupil import LONGEST_WAVEFRONT, Pupil, Wavefront, disc_power, symmetric
from gpusim.domain.short_repr import short_repr
from gpusim.domain.spectrum import Spectrum, check_quantity, tabulate, values_of

MODELS = ("diffraction", "measured", "none")
RELATIVE_ILLUMINATIONS = ("cos4", "none")
FOCAL_LENGTH = {"focal_length": within("0 < focal_length < inf", "m")}
AIRY_FIRST_ZERO = 1.2196698912665045  # first zero of J1, divided by pi: the "1.22" of textbooks


@dataclass(frozen=True)
class Optics:
    """A thin lens, focused at `object_distance`, with a pupil and aberrations.

    Attributes:
        f_number: N = focal length / aperture diameter [1].
        focal_length: [m].
        model: Cause of the blur: "diffraction" (at the pupil, with its wavefront), "measured"
            (`psf`) or "none".
        transmission: T(lambda) in 0 .. 1, one number or a Spectrum of one function.
        relative_illumination: Fall-off toward the corner: "cos4", "none", the coefficients (a1,
            a2, ...) of 1 + a1 h + a2 h^2 + ... of the field height h, 1 at the corner, or two
            arrays (heights, values).
        object_distance: Distance of the plane in focus [m]; infinity by default.
        pupil: Shape of the aperture. The f-number refers to its circumscribed circle.
        wavefront: Aberrations.
        defocus: Distance of the sensor behind the image [m], one number or a Spectrum (axial
            colour).
        birefringence: Distance of the two images that a low-pass plate makes along (y, x) [m],
            0 for one image.
        diffuser: Standard deviation of a Gaussian diffuser [m at the sensor].
        psf: Point spreads of model "measured", in place of pupil, wavefront, defocus and
            low-pass.
        distortion: Displacement of points from a pinhole's image; None: none.
        lateral_color: Image height over the height at the nominal wavelength, minus one [1],
            one number or a Spectrum.

    Raises:
        BadData: Settings contradict one another.
        OutOfRange: A number is out of its range.
        UnknownName: A name is not one of those allowed.
    """

    f_number: float
    focal_length: float
    model: str = "diffraction"
    transmission: Spectrum | float = 1.0
    relative_illumination: str | tuple = "cos4"
    object_distance: float = np.inf
    pupil: Pupil = field(default_factory=Pupil)
    wavefront: Wavefront = field(default_factory=Wavefront)
    defocus: Spectrum | float = 0.0
    birefringence: tuple[float, float] = (0.0, 0.0)
    diffuser: float = 0.0
    psf: PointSpread | None = None
    distortion: Distortion | None = None
    lateral_color: Spectrum | float = 0.0

    __repr__ = short_repr

    def __post_init__(self):
        if not 0.1 <= self.f_number <= 1000:
            raise OutOfRange("optics.f_number", self.f_number, "0.1 <= f_number <= 1000")
        check_fields("optics", self, FOCAL_LENGTH)
        if not self.object_distance > self.focal_length:
            # At the focal length and nearer a lens forms no real image.
            raise OutOfRange(
                "optics.object_distance",
                f"{self.object_distance:.6g} m",
                f"object_distance > focal_length ({self.focal_length:.6g} m)",
            )
        if self.model not in MODELS:
            raise UnknownName("optics.model", self.model, MODELS)
        if (self.model == "measured") != (self.psf is not None):
            raise BadData(
                f'optics.psf: model "{self.model}" '
                + (
                    "wants point spreads"
                    if self.psf is None
                    else 'leaves it unused; set model = "measured"'
                )
            )
        if (
            isinstance(self.relative_illumination, str)
            and self.relative_illumination not in RELATIVE_ILLUMINATIONS
        ):
            raise UnknownName(
                "optics.relative_illumination", self.relative_illumination, RELATIVE_ILLUMINATIONS
            )
        check_quantity("optics.transmission", self.transmission)
        for key in ("transmission", "defocus", "lateral_color"):
            value = getattr(self, key)
            if isinstance(value, Spectrum) and value.values.ndim != 1:
                raise BadData(
                    f"optics.{key}: wanted one function of wavelength, got {len(value.values)}"
                )
        values = self.transmission
        if isinstance(values, Spectrum):
            values = values.values
        low, high = np.min(values), np.max(values)
        if not (low >= 0 and high <= 1):
            raise OutOfRange(
                "optics.transmission", f"{low:.6g} .. {high:.6g}", "0 <= transmission <= 1"
            )
        defocus = self.defocus
        if isinstance(defocus, Spectrum):
            defocus = np.abs(defocus.values).max()
        # the formulas are first order in defocus / image distance
        if not abs(defocus) < self.image_distance / 2:
            raise OutOfRange(
                "optics.defocus",
                f"{defocus:.6g} m",
                f"less than half of {self.image_distance:.6g} m",
            )
        lateral = self.lateral_color
        if isinstance(lateral, Spectrum):
            lateral = lateral.values
        if not (np.abs(lateral) < 0.5).all():  # also refuses NaN
            raise OutOfRange(
                "optics.lateral_color", self.lateral_color, "-0.5 < lateral_color < 0.5"
            )
        apart = np.asarray(self.birefringence)
        if apart.shape != (2,) or not ((apart >= 0) & (apart < 1e-3)).all():
            raise OutOfRange(
                "optics.birefringence", self.birefringence, "two lengths, 0 <= length < 1 mm"
            )
        if not 0 <= self.diffuser < 1e-3:
            raise OutOfRange("optics.diffuser", f"{self.diffuser:.6g} m", "0 <= diffuser < 1 mm")
        self._check_measured()

    def _check_measured(self):
        """Raise BadData for settings that measured point spreads already include."""
        if self.model != "measured":
            return
        given = self._blur_settings() | {
            "optics.mask": self.pupil.mask is not None,
            "optics.pupil: blades, obscuration": self.pupil != Pupil(),
        }
        for name, is_set in given.items():
            if is_set:
                more = (
                    ", and put the pupil's area into optics.transmission" if "pupil" in name else ""
                )
                raise BadData(
                    f'{name}: with model = "measured" the point spreads hold it, and it would be ignored; '
                    f"leave it out{more}"
                )

    def _blur_settings(self):
        """Settings, apart from the pupil, that add to the blur of model "diffraction": name -> bool."""
        own = self.wavefront
        return {
            "optics.lateral_color": bool(np.any(values_of(self.lateral_color))),
            "optics.defocus": bool(np.any(values_of(self.defocus))),
            "optics.zernike": bool(np.any(own.zernike)),
            "optics.seidel": any(own.seidel),
            "optics.birefringence": any(self.birefringence),
            "optics.diffuser": bool(self.diffuser),
        }

    @property
    def ignored_settings(self) -> str:
        """Settings that have no effect on the blur with model "none", in words."""
        names = ["diffraction", *(name for name, is_set in self._blur_settings().items() if is_set)]
        return ", ".join(names).replace("optics.", "").replace("lateral_color", "lateral colour")

    @property
    def magnification(self) -> float:
        """Image size over object size, m = -f / (d - f): inverted, 0 for a scene at infinity."""
        return -self.focal_length / (self.object_distance - self.focal_length)

    @property
    def image_distance(self) -> float:
        """Distance from the lens to the focused image [m], f (1 + |m|)."""
        return self.focal_length * (1 + abs(self.magnification))

    @property
    def working_f_number(self) -> float:
        """N (1 + |m|) [1]: f-number seen from the image of a lens focused nearer than infinity."""
        return self.f_number * (1 + abs(self.magnification))

    @property
    def irradiance_factor(self) -> float:
        """On-axis irradiance over radiance [sr] of a lossless lens.

        A pi / (1 + 4 N^2 (1 + |m|)^2) with A = pupil.area. This is pi sin^2(theta) of the cone that
        the aperture fills as seen from the image, with half-angle tan(theta) = 1 / (2 N (1 + |m|)).
        The often quoted pi / (4 N^2) is its limit for large N and m = 0; at f/4 it is 1.6 % larger.
        """
        return self.pupil.area * np.pi / (1 + 4 * self.working_f_number**2)

    def transmission_at(self, wavelengths: np.ndarray) -> np.ndarray:
        """Return T; beyond the ends of a table the end values continue.

        Args:
            wavelengths: [nm], shape (L,).

        Returns:
            T in 0 .. 1, shape (L,).
        """
        return tabulate(self.transmission, wavelengths)

    @property
    def has_lateral_color(self) -> bool:
        """Whether wavelengths are imaged at different heights; without blur they are not."""
        return self.model != "none" and bool(np.any(values_of(self.lateral_color)))

    def lateral_color_at(self, wavelengths: np.ndarray) -> np.ndarray:
        """Return the relative excess of the image height.

        Args:
            wavelengths: [nm], shape (L,).

        Returns:
            Excess [1], shape (L,).
        """
        return tabulate(self.lateral_color, wavelengths)

    @cached_property
    def is_ideal(self) -> bool:
        """Whether on the axis nothing blurs the image but diffraction at a clear circle."""
        return (
            self.model != "measured"
            and self.pupil == Pupil()
            and not any(self.birefringence)
            and self.diffuser == 0
            and not self.waves(np.array([550.0]), longest=np.inf).any()
            and not np.any(values_of(self.defocus))
        )

    @cached_property
    def is_symmetric(self) -> bool:
        """True if the blur on the axis is rotationally symmetric (even along rows and columns)."""
        return self.model != "measured" and symmetric(
            self.pupil, self.waves(np.array([550.0]), longest=np.inf)
        )

    @cached_property
    def has_mirror(self) -> bool:
        """True if the blurs at opposite field points are mirror images of each other."""
        odd = [
            self.wavefront.polynomial(height)[:, 1::2]
            for height in (0.5, 1.0, *self.wavefront.heights)
        ]
        return not self.pupil.sides.size and not np.any(odd)

    @property
    def has_wave(self) -> bool:
        """Whether the field of the light at the sensor is known: measured point spreads are energies."""
        return self.psf is None

    @property
    def varies(self) -> bool:
        """Whether the blur varies over the field."""
        if self.model == "none":
            return False
        if np.any(values_of(self.lateral_color)):
            return True
        if self.psf is not None:
            return self.psf.heights is not None or self.psf.grid is not None
        return bool(self.wavefront.heights) or any(self.wavefront.seidel[1:])

    def with_mask(self, mask: Mask) -> "Optics":
        """Return the lens with another mask in its pupil, behind the one that it has.

        Args:
            mask: The mask.

        Returns:
            The lens.

        Raises:
            BadData: It has no pupil with a wave, or the masks have no common grid of 256 cells or fewer on a side.
            OutOfRange: No light passes.
        """
        if self.model != "diffraction":
            why = (
                "measured point spreads hold no wave"
                if self.psf
                else "a lens without blur has no pupil"
            )
            raise BadData(f'optics.model "{self.model}": {why}; use model "diffraction"')
        own = self.pupil.mask
        if own is not None:
            mask = combine_masks(own, mask)
        return replace(self, pupil=replace(self.pupil, mask=mask))

    def without_blur(self) -> "Optics":
        """Return the same lens without blur.

        Returns:
            A lens of model "none".
        """
        return replace(self, model="none", psf=None)

    def on_axis(self) -> "Optics":
        """Return a lens whose blur everywhere is this one's blur on the axis.

        Returns:
            The lens.
        """
        own = self.wavefront
        zernike = own.zernike[0] if own.heights else own.zernike
        wavefront = Wavefront(zernike, (), (own.seidel[0], 0.0, 0.0, 0.0, 0.0), own.reference)
        psf = self.psf and replace(self.psf, values=self.psf.at(0.0, 0.0), heights=None, grid=None)
        return replace(self, wavefront=wavefront, psf=psf, lateral_color=0.0)

    @property
    def description(self) -> str:
        """The pupil and its effects, in words."""
        if self.psf is not None:
            near = (
                ""
                if np.isinf(self.object_distance)
                else f" of the lens focused at {self.object_distance:.4g} m"
            )
            return f"measured point spreads at {len(self.psf.wavelengths)} wavelengths{near}"
        words = [
            f"polygon of {self.pupil.blades} blades" if self.pupil.blades else "circular pupil"
        ]
        words += [f"{self.pupil.obscuration:g} obscured"] if self.pupil.obscuration else []
        if (mask := self.pupil.mask) is not None:
            rows, cols = mask.values.shape
            words += [f"mask of {rows} x {cols} cells, {self.pupil.openness:.3g} of the light"]
        words += ["out of focus"] if isinstance(self.defocus, Spectrum) or self.defocus else []
        words += (
            ["aberrated"] if any(self.wavefront.seidel) or np.any(self.wavefront.zernike) else []
        )
        words += ["low-pass"] if any(self.birefringence) or self.diffuser else []
        return ", ".join(words)

    def waves(
        self,
        wavelengths: np.ndarray,
        height: float = 0.0,
        azimuth: float = 0.0,
        distance: float | None = None,
        longest: float = LONGEST_WAVEFRONT,
    ) -> np.ndarray:
        """Return the wavefront's coefficients [l, i, j] of x^i y^j. The constant term is left out.

        Defocus is W020 = d / (8 N^2 (1 + |m|)^2) for the displacement d, Goodman (Introduction to
        Fourier Optics, 6.4) to first order in d.

        Args:
            wavelengths: [nm], shape (L,).
            height: Of the field point, see `Wavefront.polynomial`.
            azimuth: Of the field point, see `Wavefront.polynomial`.
            distance: Of the object [m]; None: the plane in focus.
            longest: Most defocus [waves].

        Returns:
            Coefficients [waves of each wavelength], shape (L, n, n), n >= 5.

        Raises:
            OutOfRange: The defocus is more than `longest`.
        """
        wavelengths = np.asarray(wavelengths, np.float64)
        table = (
            self.wavefront.polynomial(height, azimuth)
            * (self.wavefront.reference / wavelengths)[:, None, None]
        )
        shift = tabulate(self.defocus, wavelengths)
        if distance is not None:
            shift = shift + self.displacement(self.diopters(distance))
        w020 = shift / (8 * self.working_f_number**2) / (wavelengths * 1e-9)
        table[:, :3, :3] += w020[:, None, None] * disc_power(1)
        table[:, 0, 0] = 0
        if np.abs(w020).max(initial=0) > longest:
            raise OutOfRange(
                "optics.defocus",
                f"{np.abs(w020).max():.4g} waves",
                f"up to {longest:g} waves",
            )
        return table

    def diopters(self, distance: float) -> float:
        """Return the defocus of an object in dioptres: 1 / object_distance - 1 / distance.

        Args:
            distance: Of the object [m].

        Returns:
            [1/m], > 0 beyond the plane in focus.
        """
        return 1 / self.object_distance - 1 / distance

    def displacement(self, diopters: float) -> float:
        """Return the sensor displacement with the same defocus: D times the image distance squared.

        Both have the same W020: D a^2 / 2, with the pupil's radius a, equals d / (8 N^2 (1 +
        |m|)^2) for this d.

        Args:
            diopters: Defocus D [1/m].

        Returns:
            Displacement d [m].
        """
        return diopters * self.image_distance**2

    def airy_radius(self, wavelength: float | np.ndarray) -> np.ndarray:
        """Return the radius of the first dark ring: 1.21967 lambda N (1 + |m|).

        Args:
            wavelength: [nm], any shape.

        Returns:
            Radius [m], of that shape.

        Source:
            Born and Wolf, Principles of Optics, 8.5.2; N (1 + |m|) is N for a scene at
            infinity.
        """
        return AIRY_FIRST_ZERO * np.asarray(wavelength) * 1e-9 * self.working_f_number

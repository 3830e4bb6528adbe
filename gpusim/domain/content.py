"""Samples of a scene and their spectra: a cube, a basis, materials or an encoded picture.

Everything that depends on the form of the samples is here.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import prod
from typing import Any, ClassVar, Self

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.memory import Pinned, describe_array, to_host, type_of
from gpusim.domain.short_repr import span
from gpusim.domain.spectrum import check_wavelengths

NUMBERS, WHOLE = "fiub", "iub"  # kinds of types that samples, and numbers of materials, may have
NEGATIVE = 0.25  # accepted undershoot of a truncated basis, relative to the brightest sample


def is_seen(array) -> bool:
    """Return True if the host checks the values of an array of samples."""
    return isinstance(array, np.ndarray) and not isinstance(array, Pinned)


def check_not_negative(label: str, values: np.ndarray, kind: str):
    """Raise BadData if a value, of light for example, is negative or not finite."""
    if not (np.isfinite(values).all() and values.min() >= 0):
        raise BadData(
            f"{label} from {values.min():.3g} to {values.max():.3g}, wanted finite {kind}, not negative"
        )


@dataclass(frozen=True, eq=False)
class Content:
    """Samples on a grid (rows, cols), each a mixture of a few spectra (entries).

    Arrays of samples may belong to a device or to another library (`__dlpack__`,
    `__cuda_array_interface__`, `__array__`), or be Pinned. The host does not check their values. A
    device converts samples of types that it does not store.

    Attributes:
        wavelengths: Wavelengths of the spectra [nm], shape (L,).
        form: Name of the form.
        samples: Names of the arrays with one value per sample; their last two axes are rows and
            columns.
        shared: Names of the arrays that all samples share.
    """

    wavelengths: np.ndarray
    form: ClassVar[str]
    samples: ClassVar[tuple[str, ...]]
    shared: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self):
        for name in self.samples:
            object.__setattr__(
                self, name, describe_array(getattr(self, name), f"{self.form} {name}")
            )

    def __repr__(self):
        tables = "".join(f", {name} {np.shape(getattr(self, name))}" for name in self.shared)
        return f"{type(self).__name__}({self.shape[1]}x{self.shape[0]}, {span(self.wavelengths)}{tables})"

    @property
    def planes(self) -> np.ndarray:
        """The array that is proportional to the light, shape (..., rows, cols)."""
        return getattr(self, self.samples[-1])

    @property
    def labels(self) -> np.ndarray | None:
        """Index of the only entry of each sample, shape (rows, cols); None if samples mix."""
        return None

    @property
    def surfaces(self) -> "Content":
        """The content without the light if the two are stored separately, otherwise itself."""
        return self

    @property
    def entry_spectra(self) -> np.ndarray:
        """Spectrum of one unit of each entry, float64, shape (entries, L)."""
        return np.asarray(getattr(self, self.shared[0]), np.float64)

    @property
    def is_spectral(self) -> bool:
        """True if the entries are the wavelengths themselves."""
        return not self.shared

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of samples."""
        rows, cols = self.planes.shape[-2:]
        return rows, cols

    @property
    def nbytes(self) -> int:
        """Memory of the samples on a device [byte]."""
        return sum(
            self.stored_type(name).itemsize * prod(getattr(self, name).shape)
            for name in self.samples
        )

    @property
    def is_seen(self) -> bool:
        """True if the host checks the values of all samples."""
        return all(is_seen(getattr(self, name)) for name in self.samples)

    @property
    def lit(self) -> np.ndarray:
        """True for each wavelength at which there may be light, bool, shape (L,)."""
        return np.asarray(self.entry_spectra.any(axis=0))

    def stored_type(self, name: str) -> np.dtype:
        """Return the type of an array of samples on a device.

        Args:
            name: Name of the array, one of `samples`.

        Returns:
            The NumPy type, for light float16 if the array has that type, otherwise float32.
        """
        return np.dtype(np.float16 if type_of(getattr(self, name)) == np.float16 else np.float32)

    def on_host(self) -> "Content":
        """Return the content with all samples in host memory, copied if necessary.

        Returns:
            The content itself if its samples are NumPy arrays, otherwise a copy on the host. A
            Picture becomes a Basis.

        Raises:
            BadData: An array cannot be read.
        """
        if all(isinstance(getattr(self, name), np.ndarray) for name in self.samples):
            return self
        return self.with_samples(lambda array: to_host(array, self.form))

    def with_planes(self, planes: Any) -> "Content":
        """Return the content with another array in place of `planes`.

        Args:
            planes: The new array.

        Returns:
            New content with the same spectra.
        """
        return replace(self, **{self.samples[-1]: planes})

    def with_samples(self, change: Callable[[Any], Any]) -> Self:
        """Return the content with `change(array)` in place of each array of samples.

        Args:
            change: Function of an array.

        Returns:
            New content of the same form.
        """
        return replace(self, **{name: change(getattr(self, name)) for name in self.samples})

    def take(self, rows: Any, cols: Any = None) -> "Content":
        """Return content made of selected samples.

        Args:
            rows: Row indices, shape (n,) for whole rows, or any shape that broadcasts with `cols`.
            cols: Column indices, or None for whole rows.

        Returns:
            Content whose samples are those at (rows, cols).
        """
        return self.with_samples(
            lambda array: np.take(array, rows, -2) if cols is None else array[..., rows, cols]
        )

    def behind(self, front: "Content", mask: np.ndarray) -> "Content":
        """Return the content with some samples taken from other content.

        Args:
            front: Content of the same form, wavelengths and entries.
            mask: True for samples to take from `front`, shape (rows, cols).

        Returns:
            The combined content.
        """
        return replace(
            self,
            **{
                name: np.where(mask, getattr(front, name), getattr(self, name))
                for name in self.samples
            },
        )

    def scale(self, factor: float) -> Self:
        """Return content that is `factor` times as bright.

        Args:
            factor: Factor on all samples [1].

        Returns:
            New content of the same form.
        """
        return replace(self, **{self.shared[0]: getattr(self, self.shared[0]) * factor})

    def divide_by(self, light: np.ndarray) -> Self:
        """Return reflectances from radiances.

        Args:
            light: Spectrum of the light, shape (L,).

        Returns:
            New content whose spectra are divided by the light.
        """
        return replace(self, **{self.shared[0]: getattr(self, self.shared[0]) / light})

    def is_like(self, other: "Content") -> bool:
        """Compare the form, wavelengths and entries with other content.

        Args:
            other: The other content.

        Returns:
            True if all are equal.
        """
        if type(self) is not type(other):
            return False
        pairs = [
            (getattr(self, name), getattr(other, name)) for name in ("wavelengths", *self.shared)
        ]
        return all(own is its or np.array_equal(own, its) for own, its in pairs)

    def mix(self, rates: np.ndarray, rows: slice = slice(None)) -> np.ndarray:
        """Return channel values of samples in whole rows.

        Args:
            rates: Response of each channel to one unit of each entry, shape (C, entries).
            rows: The rows.

        Returns:
            Channel values in the type of `rates`, shape (C, rows, cols).
        """
        return np.tensordot(rates, self.planes[:, rows].astype(rates.dtype, copy=False), 1)

    def bands_at(self, rows: Any) -> np.ndarray:
        """Return the spectra of whole rows.

        Args:
            rows: The rows, a slice or indices.

        Returns:
            Spectra, float64, shape (L, rows, cols).
        """
        return self.mix(self.entry_spectra.T, rows)

    def used(self, rows: slice = slice(None)) -> np.ndarray:
        """Return the amount of each entry in whole rows, summed over all samples.

        Args:
            rows: The rows.

        Returns:
            Amounts, shape (entries,).
        """
        return self.planes[:, rows].sum(axis=(1, 2), dtype=np.float64)

    def mean_spectrum(self) -> np.ndarray:
        """Return the mean spectrum of all samples.

        Returns:
            Spectrum, shape (L,).
        """
        return self.used() @ self.entry_spectra / prod(self.shape)

    def weigh(
        self, weights: np.ndarray, window: tuple[slice, slice] = (slice(None), slice(None))
    ) -> np.ndarray:
        """Return weighted sums over wavelength of the samples in a window.

        Args:
            weights: Weight of each wavelength in each channel, shape (C, L).
            window: Rows and columns.

        Returns:
            Sums, float64, shape (C, rows, cols).
        """
        table = weights @ self.entry_spectra.T
        total = np.zeros((len(weights), *self.planes[0][window].shape))
        # one plane at a time: a cube in float64 is large
        for plane, column in zip(self.planes, table.T, strict=True):
            total += column[:, None, None] * plane[window]
        return total

    def brightness(self, total: np.ndarray) -> np.ndarray:
        """Return one weighted sum over wavelength of all samples.

        Args:
            total: Weight of each wavelength, for example the sum of all channels, shape (L,).

        Returns:
            Sums, float32, shape (rows, cols).
        """
        return np.tensordot((self.entry_spectra @ total).astype(np.float32), self.planes, 1)

    def points(
        self, rows: np.ndarray, cols: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return single samples as spectra and strengths.

        Args:
            rows: Row indices of the samples, shape (N,).
            cols: Column indices, shape (N,).

        Returns:
            Spectra, shape (K, L); index of the spectrum of each sample, shape (N,); strength of the
            sample in units of its spectrum, shape (N,).
        """
        spectra = self.take(rows, cols).planes.T.astype(np.float64) @ self.entry_spectra
        return spectra, np.arange(len(rows)), np.ones(len(rows))

    def check(self, name: str) -> None:
        """Refuse content that no camera could see.

        Args:
            name: Name of the content in messages.

        Raises:
            BadData: Wrong shapes or types, NaN, negative light, or unsorted wavelengths.
            OutOfRange: An index of a material is too large.
        """
        self._check_types(name)
        self._check_shapes(name)
        samples = getattr(self, self.samples[-1])
        if 0 in samples.shape:
            raise BadData(f"{name}: zero-size scene {tuple(samples.shape)}")
        check_wavelengths(self.wavelengths, name)
        for label, array in (
            ("samples", samples),
            *(("spectra", getattr(self, key)) for key in self.shared),
        ):
            if not is_seen(array) or array.dtype.kind == "u":
                continue
            low, high = float(array.min()), float(array.max())
            if not np.isfinite([low, high]).all():  # min and max carry NaN and infinities
                why = (
                    "; float16 ends at 65504, beyond it is infinity"
                    if array.dtype == np.float16
                    else ""
                )
                raise BadData(f"{name}: NaN or infinite {label}{why}")
            if low < 0:
                self._check_negative(name, label, low)

    def _check_types(self, name):
        for key in self.samples:
            array = getattr(self, key)
            kind, is_light = type_of(array), key != "ids"
            if kind is None or kind.kind not in (NUMBERS if is_light else WHOLE):
                wanted = (
                    "float32, float16 or another type of real numbers"
                    if is_light
                    else "uint16 or uint8"
                )
                raise BadData(f"{name}: {key} of type {kind or array.dtype}, wanted {wanted}")

    def _check_shapes(self, name):
        raise NotImplementedError

    def _check_negative(self, name, label, low):
        raise BadData(f"{name}: negative {label} (lowest {low:.3g}); radiance cannot be negative")


@dataclass(frozen=True, eq=False, repr=False)
class Cube(Content):
    """Spectra of all samples at common wavelengths.

    `np.asarray` returns the values. Values of float16 stay float16 on a device, which halves memory
    and transfer time. float16 is exact to 2^-11 from 6.1e-5 on, and to 3e-8 below; values above
    65504 become infinite. Scale a radiance into that range, and its light by the inverse factor.

    Args:
        wavelengths: Wavelengths [nm], shape (L,).
        values: Samples, float32 or float16, shape (L, rows, cols).
    """

    values: np.ndarray
    form: ClassVar[str] = "cube"
    samples: ClassVar[tuple[str, ...]] = ("values",)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(to_host(self.values, self.form), dtype, copy=copy)

    @property
    def entry_spectra(self) -> np.ndarray:
        """The identity matrix: each wavelength is an entry."""
        return np.eye(len(self.wavelengths))

    @property
    def lit(self) -> np.ndarray:
        """True for each wavelength at which a sample is not zero, bool, shape (L,)."""
        return np.asarray(self.values.any(axis=(1, 2)))

    def scale(self, factor: float) -> Self:
        return replace(self, values=self.values * np.float32(factor))

    def divide_by(self, light: np.ndarray) -> Self:
        return replace(self, values=self.values / np.asarray(light, np.float32)[:, None, None])

    def bands_at(self, rows: Any) -> np.ndarray:
        return self.values[:, rows].astype(np.float64)

    def points(
        self, rows: np.ndarray, cols: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return (
            self.values[:, rows, cols].T.astype(np.float64),
            np.arange(len(rows)),
            np.ones(len(rows)),
        )

    def brightness(self, total: np.ndarray) -> np.ndarray:
        return np.tensordot(np.asarray(total, np.float32), self.values, 1)

    def _check_shapes(self, name):
        if len(self.values.shape) != 3 or self.values.shape[0] != len(self.wavelengths):
            raise BadData(
                f"{name}: cube of shape {tuple(self.values.shape)}, wanted ({len(self.wavelengths)}, rows, "
                "cols)"
            )


@dataclass(frozen=True, eq=False, repr=False)
class Basis(Content):
    """A linear model of spectra: spectrum of a pixel = sum_k coefficients[k] basis[k].

    Args:
        wavelengths: Wavelengths [nm], shape (L,).
        coefficients: Weights of the basis, float32 or float16 (see Cube), shape (K, rows, cols).
        basis: Basis spectra, shape (K, L).
    """

    coefficients: np.ndarray
    basis: np.ndarray
    form: ClassVar[str] = "basis"
    samples: ClassVar[tuple[str, ...]] = ("coefficients",)
    shared: ClassVar[tuple[str, ...]] = ("basis",)

    def check(self, name: str) -> None:
        super().check(name)
        if not is_seen(self.coefficients):
            return
        if np.min(self.basis) >= 0 and self.coefficients.min() >= 0:
            return  # nor are their mixtures
        # coefficients may be negative, the spectra that they make may not
        lowest, highest = 0.0, 0.0
        for row in np.moveaxis(self.coefficients, 1, 0):  # row by row: the whole would be a cube
            spectra = self.basis.T @ row
            lowest, highest = min(lowest, float(spectra.min())), max(highest, float(spectra.max()))
        if lowest < -NEGATIVE * highest or highest == 0 > lowest:
            raise BadData(
                f"{name}: negative spectra (lowest {lowest:.3g}, highest {highest:.3g}); radiance cannot be "
                "negative"
            )

    def _check_shapes(self, name):
        count = len(self.wavelengths)
        if len(self.coefficients.shape) != 3 or self.basis.shape != (
            self.coefficients.shape[0],
            count,
        ):
            raise BadData(
                f"{name}: basis {self.basis.shape} does not match coefficients "
                f"{tuple(self.coefficients.shape)} and "
                f"{len(self.wavelengths)} wavelengths"
            )

    def _check_negative(self, name, label, low):
        pass


@dataclass(frozen=True, eq=False, repr=False)
class Materials(Content):
    """One material per pixel: spectrum of a pixel = shading * spectra[ids].

    Args:
        wavelengths: Wavelengths [nm], shape (L,).
        ids: Index of the material, uint8 or uint16, shape (rows, cols).
        shading: Factor on the spectrum, float32, shape (rows, cols).
        spectra: Spectra of the materials, shape (M, L).
    """

    ids: np.ndarray
    shading: np.ndarray
    spectra: np.ndarray
    form: ClassVar[str] = "materials"
    samples: ClassVar[tuple[str, ...]] = ("ids", "shading")
    shared: ClassVar[tuple[str, ...]] = ("spectra",)

    @property
    def labels(self) -> np.ndarray:
        """Index of the material of each sample, shape (rows, cols)."""
        return self.ids

    def stored_type(self, name: str) -> np.dtype:
        return np.dtype(np.uint16 if name == "ids" else np.float32)

    def mix(self, rates: np.ndarray, rows: slice = slice(None)) -> np.ndarray:
        light = np.take(rates, self.ids[rows], axis=1)
        light *= self.shading[rows]
        return light

    def used(self, rows: slice = slice(None)) -> np.ndarray:
        return np.bincount(self.ids[rows].ravel(), self.shading[rows].ravel(), len(self.spectra))

    def weigh(
        self, weights: np.ndarray, window: tuple[slice, slice] = (slice(None), slice(None))
    ) -> np.ndarray:
        return (weights @ self.entry_spectra.T)[:, self.ids[window]] * self.shading[window]

    def brightness(self, total: np.ndarray) -> np.ndarray:
        return np.take((self.spectra @ total).astype(np.float32), self.ids) * self.shading

    def points(
        self, rows: np.ndarray, cols: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        used, light = np.unique(self.ids[rows, cols], return_inverse=True)
        return self.entry_spectra[used], light, self.shading[rows, cols].astype(np.float64)

    def _check_shapes(self, name):
        if len(self.ids.shape) != 2 or tuple(self.shading.shape) != tuple(self.ids.shape):
            raise BadData(
                f"{name}: ids {tuple(self.ids.shape)} and shading {tuple(self.shading.shape)} must be one "
                "(rows, cols)"
            )
        if self.spectra.ndim != 2 or self.spectra.shape[1] != len(self.wavelengths):
            raise BadData(
                f"{name}: spectra {self.spectra.shape} do not match {len(self.wavelengths)} wavelengths"
            )
        if (
            is_seen(self.ids)
            and self.ids.size
            and (self.ids.min() < 0 or self.ids.max() >= len(self.spectra))
        ):
            raise OutOfRange(
                f"{name}: material id", int(self.ids.max()), f"0 .. {len(self.spectra) - 1}"
            )


@dataclass(frozen=True, eq=False, repr=False)
class Picture(Content):
    """Encoded values of a camera or decoder: spectrum of a pixel = sum_k curve[codes[k]] basis[k].

    A device takes the codes as they are and decodes them. The host uses the equivalent Basis
    (`on_host`); operations on the samples return a Basis. `np.asarray` returns the codes.

    Args:
        wavelengths: Wavelengths [nm], shape (L,).
        codes: uint8 or uint16, shape (rows, cols, K), or (rows, cols) for K = 1.
        basis: Spectra of the channels, not negative, shape (K, L).
        curve: Light of each code, not negative, float32, shape (256,) or (65536,).
    """

    codes: np.ndarray
    basis: np.ndarray
    curve: np.ndarray
    form: ClassVar[str] = "picture"
    samples: ClassVar[tuple[str, ...]] = ("codes",)
    shared: ClassVar[tuple[str, ...]] = ("basis", "curve")

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(to_host(self.codes, self.form), dtype, copy=copy)

    def __post_init__(self):
        super().__post_init__()
        try:
            with np.errstate(over="ignore"):  # infinite light is refused by `check`
                curve = np.ascontiguousarray(
                    np.asarray(self.curve).astype(np.float32, casting="same_kind", copy=False)
                )
        except (TypeError, ValueError):
            raise BadData(
                "picture: curve is no array of real numbers; wanted the light of every code"
            ) from None
        object.__setattr__(self, "curve", curve)

    @property
    def planes(self) -> np.ndarray:
        """The decoded light, shape (K, rows, cols)."""
        return self.on_host().planes

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of samples."""
        rows, cols = self.codes.shape[:2]
        return rows, cols

    @property
    def nbytes(self) -> int:
        """Memory of the codes and the decoded planes on a device [byte]."""
        return super().nbytes + 4 * len(self.basis) * prod(self.shape)

    def stored_type(self, name: str) -> np.dtype:
        kind = type_of(self.codes)
        return np.dtype(np.uint8 if kind is None else kind.type)  # in the host's order of bytes

    def on_host(self) -> Basis:
        codes = to_host(self.codes, self.form).reshape(*self.shape, -1)
        return Basis(self.wavelengths, np.take(self.curve, np.moveaxis(codes, -1, 0)), self.basis)

    def with_planes(self, planes: Any) -> Content:
        return self.on_host().with_planes(planes)

    def take(self, rows: Any, cols: Any = None) -> Content:
        return self.on_host().take(rows, cols)

    def behind(self, front: Content, mask: np.ndarray) -> Content:
        return self.on_host().behind(front.on_host(), mask)

    def _check_types(self, name):
        kind = type_of(self.codes)
        if kind is None or kind.type not in (np.uint8, np.uint16):
            raise BadData(
                f"{name}: codes of type {kind or self.codes.dtype}, wanted uint8 or uint16; give linear "
                "light as the planes (K, rows, cols) of a Basis"
            )

    def _check_shapes(self, name):
        shape, count = tuple(self.codes.shape), len(self.basis)
        if shape[2:] != (count,) and (len(shape) != 2 or count != 1):
            raise BadData(
                f"{name}: codes of shape {shape}, wanted (rows, cols, {count}), channels last and no alpha: "
                f"codes[..., :{count}]"
            )
        if self.basis.shape != (count, len(self.wavelengths)):
            raise BadData(
                f"{name}: basis {self.basis.shape} does not match {len(self.wavelengths)} wavelengths"
            )
        kind = self.stored_type("codes")
        if self.curve.shape != (256**kind.itemsize,):
            raise BadData(
                f"{name}: curve of shape {self.curve.shape}, wanted ({256**kind.itemsize},) for {kind}"
            )
        check_not_negative(f"{name}: curve", self.curve, "light")

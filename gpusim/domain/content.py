"""Samples of a scene and their spectra: a cube, a basis, materials or an encoded picture. What differs is here."""

from dataclasses import dataclass, replace
from math import prod
from typing import Any, ClassVar

import numpy as np

from gpusim.domain.errors import BadData, OutOfRange
from gpusim.domain.foreign import described, to_host, type_of
from gpusim.domain.memory import Pinned
from gpusim.domain.short_repr import span
from gpusim.domain.spectrum import check_wavelengths

NUMBERS, WHOLE = "fiub", "iub"  # kinds of types that samples, and numbers of materials, may have
NEGATIVE = (
    0.25  # undershoot of a truncated basis that is let pass, relative to the brightest sample
)


def is_seen(array) -> bool:
    """Whether the values of an array of samples are looked at on the host."""
    return isinstance(array, np.ndarray) and not isinstance(array, Pinned)


@dataclass(frozen=True, eq=False)
class Content:
    """Spectra at wavelengths (L,) [nm] of samples on a grid (rows, cols): each is a mix of a few entries' spectra.

    Arrays of samples may be a device's, another library's (`__dlpack__`, `__cuda_array_interface__`, `__array__`) or
    Pinned: their values are not looked at here. Samples of another type than devices store are converted by them.
    form: its name. samples: names of the arrays with a value for each sample, their last two axes rows and columns.
    shared: names of those that all samples share.
    """

    wavelengths: np.ndarray
    form: ClassVar[str]
    samples: ClassVar[tuple[str, ...]]
    shared: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self):
        for name in self.samples:
            object.__setattr__(self, name, described(getattr(self, name), f"{self.form} {name}"))

    def __repr__(self):
        tables = "".join(f", {name} {np.shape(getattr(self, name))}" for name in self.shared)
        return f"{type(self).__name__}({self.shape[1]}x{self.shape[0]}, {span(self.wavelengths)}{tables})"

    @property
    def planes(self) -> np.ndarray:
        """The array that is proportional to the light, shape (..., rows, cols)."""
        return getattr(self, self.samples[-1])

    @property
    def labels(self) -> np.ndarray | None:
        """The one entry that each sample has, shape (rows, cols); None where it may mix them."""
        return None

    @property
    def surfaces(self) -> "Content":
        """What it shows without the light, where it knows that apart; else itself."""
        return self

    @property
    def entry_spectra(self) -> np.ndarray:
        """Spectrum of one unit of each entry, float64 (entries, L)."""
        return np.asarray(getattr(self, self.shared[0]), np.float64)

    @property
    def is_spectral(self) -> bool:
        """Whether the entries are the wavelengths themselves."""
        return not self.shared

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of samples."""
        rows, cols = self.planes.shape[-2:]
        return rows, cols

    @property
    def nbytes(self) -> int:
        """What its samples take on a device [byte]."""
        return sum(
            self.stored_type(name).itemsize * prod(getattr(self, name).shape)
            for name in self.samples
        )

    @property
    def is_seen(self) -> bool:
        """Whether the values of all its samples are looked at on the host."""
        return all(is_seen(getattr(self, name)) for name in self.samples)

    @property
    def lit(self) -> np.ndarray:
        """Whether there may be light at each wavelength, bool (L,)."""
        return np.asarray(self.entry_spectra.any(axis=0))

    def stored_type(self, name: str) -> np.dtype:
        """Type of an array of samples on a device: float16 where it has that, else float32."""
        return np.dtype(np.float16 if type_of(getattr(self, name)) == np.float16 else np.float32)

    def on_host(self):
        """The same with all samples in host memory, waited for, as the host reads it; itself where it is so.

        Raises BadData.
        """
        if all(isinstance(getattr(self, name), np.ndarray) for name in self.samples):
            return self
        return self.with_samples(lambda array: to_host(array, self.form))

    def with_planes(self, planes):
        """The same with other `planes`."""
        return replace(self, **{self.samples[-1]: planes})

    def with_samples(self, change):
        """The same with `change(array)` in place of each array of samples."""
        return replace(self, **{name: change(getattr(self, name)) for name in self.samples})

    def take(self, rows, cols=None):
        """Content of which each sample is that at (rows, cols), two arrays that broadcast; or of whole rows (n,)."""
        return self.with_samples(
            lambda array: np.take(array, rows, -2) if cols is None else array[..., rows, cols]
        )

    def behind(self, front, mask):
        """Content with the samples of `front`, of the same kind, where the mask (rows, cols) is true."""
        return replace(
            self,
            **{
                name: np.where(mask, getattr(front, name), getattr(self, name))
                for name in self.samples
            },
        )

    def scaled(self, factor: float):
        """Content that is `factor` times as bright."""
        return replace(self, **{self.shared[0]: getattr(self, self.shared[0]) * factor})

    def divided(self, light):
        """Reflectances from radiances in a light of this spectrum, shape (L,)."""
        return replace(self, **{self.shared[0]: getattr(self, self.shared[0]) / light})

    def is_like(self, other) -> bool:
        """Whether the other is of the same form, wavelengths and entries."""
        if type(self) is not type(other):
            return False
        pairs = [
            (getattr(self, name), getattr(other, name)) for name in ("wavelengths", *self.shared)
        ]
        return all(own is its or np.array_equal(own, its) for own, its in pairs)

    def mixed(self, rates, rows=slice(None)):
        """What samples of whole rows give where one unit of each entry gives `rates` (C, entries): (C, rows, cols).

        In the type of the rates.
        """
        return np.tensordot(rates, self.planes[:, rows].astype(rates.dtype, copy=False), 1)

    def bands_at(self, rows) -> np.ndarray:
        """Spectra of whole rows, float64 (L, rows, cols)."""
        return self.mixed(self.entry_spectra.T, rows)

    def used(self, rows=slice(None)):
        """How much of each entry is in whole rows, all samples added up, shape (entries,)."""
        return self.planes[:, rows].sum(axis=(1, 2), dtype=np.float64)

    def mean_spectrum(self) -> np.ndarray:
        """Mean of all samples' spectra, shape (L,)."""
        return self.used() @ self.entry_spectra / prod(self.shape)

    def weighted(self, weights, window=(slice(None), slice(None))):
        """Sums over wavelength by `weights` (C, L), of the samples in a window: float64 (C, rows, cols)."""
        table = weights @ self.entry_spectra.T
        total = np.zeros((len(weights), *self.planes[0][window].shape))
        for plane, column in zip(
            self.planes, table.T, strict=True
        ):  # one by one: a cube in float64 is large
            total += column[:, None, None] * plane[window]
        return total

    def brightness(self, total) -> np.ndarray:
        """Sums over wavelength by `total` (L,), such as the sum of all channels: float32 (rows, cols)."""
        return np.tensordot((self.entry_spectra @ total).astype(np.float32), self.planes, 1)

    def points(self, rows, cols):
        """Single samples at `rows`, `cols` (N,): spectra (K, L), the one that each has, and how strong it is in it."""
        spectra = self.planes[:, rows, cols].T.astype(np.float64) @ self.entry_spectra
        return spectra, np.arange(len(rows)), np.ones(len(rows))

    def check(self, name: str):
        """Refuse what no camera could see: wrong shapes, NaN, negative light, unsorted wavelengths.

        Raises BadData, OutOfRange.
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
    """Spectral samples of every pixel: values (L, rows, cols) float32 at wavelengths (L,) [nm].

    `np.asarray` gives them. Values of float16 stay float16 on a device, half the memory and bus: exact to 2^-11 from
    6.1e-5 on, to 3e-8 below; scale a radiance into that range, and its light by as much. What is beyond 65504 would be
    infinite.
    """

    values: np.ndarray
    form: ClassVar[str] = "cube"
    samples: ClassVar[tuple[str, ...]] = ("values",)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return np.array(to_host(self.values, self.form), dtype, copy=copy)

    @property
    def entry_spectra(self):
        return np.eye(len(self.wavelengths))

    @property
    def lit(self):
        return self.values.any(axis=(1, 2))

    def scaled(self, factor):
        return replace(self, values=self.values * np.float32(factor))

    def divided(self, light):
        return replace(self, values=self.values / np.asarray(light, np.float32)[:, None, None])

    def bands_at(self, rows):
        return self.values[:, rows].astype(np.float64)

    def points(self, rows, cols):
        return (
            self.values[:, rows, cols].T.astype(np.float64),
            np.arange(len(rows)),
            np.ones(len(rows)),
        )

    def brightness(self, total):
        return np.tensordot(np.asarray(total, np.float32), self.values, 1)

    def _check_shapes(self, name):
        if len(self.values.shape) != 3 or self.values.shape[0] != len(self.wavelengths):
            raise BadData(
                f"{name}: cube of shape {tuple(self.values.shape)}, wanted ({len(self.wavelengths)}, rows, "
                "cols)"
            )


@dataclass(frozen=True, eq=False, repr=False)
class Basis(Content):
    """A linear model: pixel spectrum = sum_k coefficients[k] basis[k].

    coefficients (K, rows, cols) float32 or float16, as of a cube; basis (K, L) at wavelengths (L,) [nm].
    """

    coefficients: np.ndarray
    basis: np.ndarray
    form: ClassVar[str] = "basis"
    samples: ClassVar[tuple[str, ...]] = ("coefficients",)
    shared: ClassVar[tuple[str, ...]] = ("basis",)

    def check(self, name):
        super().check(name)
        if not is_seen(self.coefficients):
            return
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
    """One material per pixel: pixel spectrum = shading * spectra[ids].

    ids (rows, cols) uint8 or uint16; shading (rows, cols) float32; spectra (M, L) at wavelengths (L,) [nm].
    """

    ids: np.ndarray
    shading: np.ndarray
    spectra: np.ndarray
    form: ClassVar[str] = "materials"
    samples: ClassVar[tuple[str, ...]] = ("ids", "shading")
    shared: ClassVar[tuple[str, ...]] = ("spectra",)

    @property
    def labels(self):
        return self.ids

    def stored_type(self, name):
        return np.dtype(np.uint16 if name == "ids" else np.float32)

    def mixed(self, rates, rows=slice(None)):
        light = np.take(rates, self.ids[rows], axis=1)
        light *= self.shading[rows]
        return light

    def used(self, rows=slice(None)):
        return np.bincount(self.ids[rows].ravel(), self.shading[rows].ravel(), len(self.spectra))

    def weighted(self, weights, window=(slice(None), slice(None))):
        return (weights @ self.entry_spectra.T)[:, self.ids[window]] * self.shading[window]

    def brightness(self, total):
        return np.take((self.spectra @ total).astype(np.float32), self.ids) * self.shading

    def points(self, rows, cols):
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
    """Encoded numbers as cameras and decoders give them: pixel spectrum = sum_k curve[codes[k]] basis[k].

    codes (rows, cols, K) uint8 or uint16, or (rows, cols) where K = 1: a device takes them as they are, and decodes
    them. basis (K, L), not negative, at wavelengths (L,) [nm]. curve: light of every code, not negative, float32 (256,)
    or (65536,). The host reads it as the Basis that it stands for (`on_host`), and what is made of its samples is one.
    `np.asarray` gives the codes.
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
    def planes(self):
        return self.on_host().planes

    @property
    def shape(self):
        rows, cols = self.codes.shape[:2]
        return rows, cols

    @property
    def nbytes(self):
        return super().nbytes + 4 * len(self.basis) * prod(
            self.shape
        )  # and what they are decoded to

    def stored_type(self, name):
        kind = type_of(self.codes)
        return np.dtype(np.uint8 if kind is None else kind.type)  # in the host's order of bytes

    def on_host(self):
        codes = to_host(self.codes, self.form).reshape(*self.shape, -1)
        return Basis(self.wavelengths, np.take(self.curve, np.moveaxis(codes, -1, 0)), self.basis)

    def with_planes(self, planes):
        return self.on_host().with_planes(planes)

    def take(self, rows, cols=None):
        return self.on_host().take(rows, cols)

    def behind(self, front, mask):
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
        if not (np.isfinite(self.curve).all() and self.curve.min() >= 0):
            raise BadData(
                f"{name}: curve from {self.curve.min():.3g} to {self.curve.max():.3g}, wanted finite light, "
                "not negative"
            )

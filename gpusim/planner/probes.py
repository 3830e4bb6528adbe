"""Probes: small windows of a scene in which the error of a plan is computed exactly, pixel by pixel, before any frame.

A plan leaves out part of the lens's effect on the spectra. In a window that error is known:
transfer functions times the window's own spectra. A transform repeats a window; its rim, which
shows that, does not count.
"""

from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np
import scipy

from gpusim.domain.account import Bound
from gpusim.domain.scene import View
from gpusim.optics.fusion import in_range
from gpusim.optics.geometry import interpolated_share, interpolation_error
from gpusim.optics.highlights import median_of
from gpusim.optics.outside import border_indices, rule_of
from gpusim.optics.ripples import places_among, world_ripples
from gpusim.optics.windows import Windows, level_above, quantile
from gpusim.planner.facts import Facts
from gpusim.planner.window_light import INNER, RIM, SIDE, Light, LightOnDevice, mix

UNEVEN = 1.5  # mean square of an error at the mosaic's pixels over all channels', from which it counts as the error
LONE = 8.0  # times the median of samples, from which on few of them have ripples that windows do not hold
# windows of 31 wavelengths; of more there are fewer, but not below these
COUNT = 12
LEAST_WINDOWS = 4


class _Light(NamedTuple):
    """Light of the mosaic.

    Attributes:
        size: Its root mean square, from the frame's sum of the channels [e- s-1].
        by_share: Mean square in the windows, each channel by its share.
        by_pixel: Mean square in the windows, of the channel that each pixel has; None if these
            are not known.
    """

    size: float
    by_share: float
    by_pixel: float | None


class _Sigma(NamedTuple):
    """Noise in the windows' inner parts [e-].

    Attributes:
        pixels: Of each pixel, shape (n, C, *inner).
        low: Its hundredth.
        least: Its least.
    """

    pixels: np.ndarray
    low: float
    least: float


@lru_cache(maxsize=16)
def _interpolation_loss(shares, width):
    """Return the root of `interpolation_error` at the frequencies of a window; shares: bytes and shape of phases."""
    phases = None if shares is None else np.frombuffer(shares[0]).reshape(shares[1])
    found = interpolation_error(np.fft.fftfreq(SIDE), np.fft.rfftfreq(SIDE), phases, width)
    return np.sqrt(found).astype(np.float32)


@dataclass(frozen=True, eq=False)
class Probes:
    """Windows of a scene as channels see them through a lens, in electrons per second.

    Attributes:
        windows: The windows.
        light: Transforms of the wavelengths in each window.
        tables: Transfer functions of the wavelengths at these frequencies, (L, SIDE, SIDE // 2
            + 1).
        weights: Electrons per content, (C, L).
        even: The same over the tables' response to a flat field.
        share: Part of the pixels that has each channel, (C,).
        level: Root mean square of the frame's channels together.
        seconds: Exposure time [s].
        noise: Variance of the read noise [e-2].
        apart: Mean square of the mosaic over the mean square of the channels together, of
            highlights that the windows do not hold; None without them.
        inner: Rows and columns of the windows' inner parts that are in the frame.
        channels: Channel of each pixel of the inner parts, int (n, *inner); None: several, or
            samples are no pixels.
        brightness: Light of all samples in all channels [e- s-1], shape (rows, cols); None: not known.
        border: How samples go on beyond it: "zero", "edge" or "reflect".
        path: Part of each wave that motion leaves, (SIDE, SIDE // 2 + 1); None: all.
    """

    windows: Windows
    light: Light
    tables: np.ndarray
    weights: np.ndarray
    even: np.ndarray
    share: np.ndarray
    level: float
    seconds: float
    noise: float
    apart: float | None = None
    inner: tuple[int, int] = (INNER, INNER)
    channels: np.ndarray | None = None
    brightness: np.ndarray | None = None
    border: str = "edge"
    path: np.ndarray | None = None
    # computed once: of the windows' light, through any lens; and behind this lens, in any operation of the camera
    _parts: dict = field(init=False, repr=False, default_factory=dict)
    _seen: dict = field(init=False, repr=False, default_factory=dict)

    def at(self, seconds: float, noise: float) -> "Probes":
        """Return the same windows at another exposure time [s] and variance of the read noise [e-2]."""
        self._light, self.signal  # noqa: B018  computed once for all
        made = copy(self)
        for name, value in (("seconds", seconds), ("noise", noise)):
            object.__setattr__(made, name, value)
        for name in ("_sigma", "without_blur", "sharp"):
            made.__dict__.pop(name, None)
        return made

    def _through(self, tables) -> "Probes":
        """The same windows through another lens."""
        made = replace(self, tables=tables)
        object.__setattr__(made, "_parts", self._parts)
        return made

    @classmethod
    def of(cls, facts: Facts, windows: Windows, border: str, **known) -> "Probes":
        """Return the probes of a scene. known: the other attributes."""
        y = border_indices(windows.rows, facts.content.shape[0], border)
        x = border_indices(windows.cols, facts.content.shape[1], border)
        lit = None
        if border == "zero":
            lit = (y == windows.rows)[:, :, None] & (x == windows.cols)[:, None, :]
        taken = facts.samples.taken(y, x) if lit is None or lit.all() else None
        read = partial(_read_light, facts, y, x, lit)
        light = read() if taken is None else LightOnDevice(taken, read)
        return cls(windows, light, border=rule_of(border), **known)

    @cached_property
    def exact(self) -> np.ndarray:
        """Transforms of the channels less their means, complex (n, C, SIDE, SIDE // 2 + 1)."""
        return self.light.blur(self.tables, self.even)

    @cached_property
    def _means(self) -> np.ndarray:
        """Means of the channels in the windows' inner parts, (n, C)."""
        return self.light.average(self.weights)

    @cached_property
    def _unblurred(self) -> np.ndarray:
        """Transforms of the channels, less their means, if the lens blurred nothing, as `exact`."""
        return self.light.sum(self.even * np.real(self.tables[:, 0, 0]))[0]

    @cached_property
    def signal(self) -> np.ndarray:
        """Electrons per second of the channels in the windows' inner parts, (n, C, *inner)."""
        return np.maximum(self._inside(self.exact) + self._means[..., None, None], 0)

    def _inside(self, spectra):
        rows, cols = self.inner
        return scipy.fft.irfft2(spectra, (SIDE, SIDE))[..., RIM : RIM + rows, RIM : RIM + cols]

    def _of_mosaic(self, values):
        """Mean square of the windows' inner parts (n, C, rows, cols), of the channel that each pixel has."""
        own = np.take_along_axis(values, self.channels[:, None], 1)
        return float(self.windows.weight @ _mean_squares(own)[:, 0])

    @cached_property
    def _light(self) -> _Light:
        """Light of the mosaic."""
        weight = self.windows.weight
        together = weight @ _mean_squares(self.signal.sum(axis=1))
        mosaic = weight @ _mean_squares(self.signal) @ self.share
        if self.apart is not None and self.level**2 > together:
            size = float(np.sqrt(mosaic + self.apart * (self.level**2 - together)))
        else:
            size = self.level * np.sqrt(mosaic / together) if together > 0 else 0.0
        by_pixel = None if self.channels is None else self._of_mosaic(self.signal)
        return _Light(size, mosaic, by_pixel)

    def bound(self, wrong) -> Bound:
        """The error of channels whose transforms are wrong by so much, complex (n, C, SIDE, SIDE // 2 + 1)."""
        return self._bound_of(self._error_of(wrong)) if self._light.size > 0 else Bound()

    def _error_of(self, wrong):
        """Return the relative root mean square of such an error, and the error of each pixel [e- s-1]."""
        light = self._light
        error = np.abs(self._inside(wrong))
        weight = self.windows.weight[:, None] * self.share
        squares = (weight * _mean_squares(error)).sum()
        rms = np.sqrt(squares) / light.size
        # few pixels hold the error, which then depends on their channels
        if light.by_pixel is not None:
            by_pixel = self._of_mosaic(error)
            if light.by_pixel > 0 and by_pixel * light.by_share > UNEVEN * squares * light.by_pixel:
                uneven = light.by_share / light.by_pixel if self.apart is None else 1.0
                rms *= np.sqrt(by_pixel / squares * uneven)
        return rms, error

    def _bound_of(self, found) -> Bound:
        """Return an error of `_error_of` with its figures in noise."""
        rms, error = found
        weight = self.windows.weight[:, None] * self.share
        sigma = error * (self.seconds / self._sigma.pixels)
        return Bound(
            float(rms), quantile(sigma, weight, 0.999), float(sigma.max() * self.windows.steepest)
        )

    @cached_property
    def _sigma(self) -> _Sigma:
        """Noise of the pixels."""
        sigma = np.sqrt(np.maximum(self.signal * self.seconds + self.noise, 1))
        return _Sigma(sigma, float(np.quantile(sigma, 0.01)), float(sigma.min()))

    @cached_property
    def sharp(self) -> "Probes":
        """The same windows through a lens without blur."""
        if "sharp" not in self._seen:
            tables = np.broadcast_to(self.tables[:, :1, :1], self.tables.shape)
            self._seen["sharp"] = self._through(tables)
        return self._seen["sharp"].at(self.seconds, self.noise)

    @cached_property
    def without_blur(self) -> Bound:
        """The error of leaving the blur out."""
        if not self._light.size > 0:
            return Bound()
        if "without blur" not in self._seen:
            self._seen["without blur"] = self._error_of(self._unblurred - self.exact)
        return self._bound_of(self._seen["without blur"])

    def change_error(self, share: float) -> Bound:
        """Return a bound of the error of transfer functions wrong by up to `share`; 1 is the error without blur."""
        return self.bound(self._unblurred * np.float32(share))

    def shift_error(self, move: float) -> Bound:
        """The error of a picture that is displaced by so many samples, at worst in both directions."""
        f = np.fft.fftfreq(SIDE)[:, None] + np.fft.rfftfreq(SIDE)
        return self.bound(
            self.exact * (np.exp(2j * np.pi * move / np.sqrt(2) * f) - 1).astype(np.complex64)
        )

    def resampling_error(self, view: View, ratio: float) -> Bound:
        """Return the error of a picture that is interpolated at a view's places, or of one like it.

        It is the mean over all places between samples: a view displaced by half a sample has 1.4
        times the error. ratio: samples per pixel.
        """
        if view.is_whole(ratio):
            return Bound()
        return (self if view.zoom == 1 else self._magnify(view.zoom)).interpolation_bound()

    @cached_property
    def _ripples(self) -> list[np.ndarray]:
        """Ripples from afar that interpolated light does not have, along both axes, halfway between samples.

        Windows are too small for those of few bright samples, and stand for all others.
        """
        light = self.brightness
        if light is None or not light.max(initial=0) > LONE * median_of(light):
            return []
        found, half = [], SIDE // 2 + 1
        path = np.ones((SIDE, half)) if self.path is None else self.path
        for axis, n in enumerate(light.shape):
            weights = world_ripples(places_among(n), n, self.border, INNER / 4)
            part = (
                np.maximum(path[:half, -1], path[-np.arange(half), -1]) if axis else path[half - 1]
            )
            found.append(self.see_ripples(axis, weights, part))
        return found

    def _magnify(self, zoom: float) -> "Probes":
        """The same windows if the lens blurs a magnified picture: waves of f cycles per sample become f / zoom."""
        if not any(self.tables.strides[1:]):  # the same for all waves
            return self
        tables = self.tables  # interpolated along both axes; a zoom of 1 or more never leaves them
        for axis, at in ((1, np.fft.fftfreq(SIDE, 1 / SIDE)), (2, np.arange(SIDE // 2 + 1))):
            first, part = np.divmod(at / zoom, 1)
            part = part[:, None] if axis == 1 else part
            lower, upper = (
                np.take(tables, (first + k).astype(int), axis, mode="wrap") for k in (0, 1)
            )
            tables = lower + part * (upper - lower)
        return self._through(tables)

    def interpolation_bound(self, phases=None, width: float | None = None) -> Bound:
        """The error of a picture that `optics.distort` interpolates: see `interpolation_error`.

        Between samples the truth is the wave of each frequency that runs through them.
        """
        shares = None if phases is None else (phases.tobytes(), phases.shape)
        wrong = [
            _interpolation_loss(shares, one) for one in ((None, 1.0) if width is None else (width,))
        ]
        if width is not None or not np.any(self.area_light):
            bound = self.bound(self.exact * wrong[0])
        else:
            bound = self.bound(
                (self.exact - self.area_light) * wrong[0] + self.area_light * wrong[1]
            )
        if not self._ripples or not self.level > 0:
            return bound
        parts = np.ones(2)
        if phases is not None:
            size = np.abs(np.sin(np.pi * np.arange(len(phases)) / len(phases)))
            parts = np.minimum(1, np.pi / 2 * np.array([phases.sum(1), phases.sum(0)]) @ size)
        afar = self.everywhere([part * one for part, one in zip(parts, self._ripples, strict=True)])
        return replace(bound, p999_sigma=max(bound.p999_sigma, afar.p999_sigma))

    @cached_property
    def area_light(self) -> np.ndarray:
        """Transforms of the light that `optics.distort` takes by area, as `exact`.

        Cubics would fall below 0 next to it.
        """
        if "area" in self._seen:
            return self._seen["area"]
        if "area" not in self._parts:
            self._parts["area"] = self._spectra_by_area()
        found = np.zeros_like(self.exact)
        for n, part in self._parts["area"].items():
            found[n] = mix(self.even, (part * self.tables)[None].astype(np.complex64))[0]
        self._seen["area"] = found
        return found

    def _spectra_by_area(self) -> dict[int, np.ndarray]:
        """Transforms of the wavelengths' light that is taken by area, by windows that have such light."""
        sums, means = self.light.sum(self.weights)
        light = np.maximum(scipy.fft.irfft2(sums, (SIDE, SIDE)) + means[..., None, None], 0)
        found = {}
        for n, share in enumerate(1 - interpolated_share(one) for one in light):
            if share.any():
                spectra, means = self.light.spectra[n], self.light.means[n]
                planes = scipy.fft.irfft2(spectra, (SIDE, SIDE)) + means[:, None, None]
                found[n] = scipy.fft.rfft2((planes * share).astype(np.float32))
        return found

    def between(self, step: float, path: float) -> Bound:
        """Return the error of moving light that is taken as linear between instants: see `gpusim.captures.moving`.

        A wave of f cycles per sample is reduced to sinc^2(f step) between two instants, in the
        mean, and an exposure leaves at most 1 / (pi f path) of it.

        Args:
            step: Displacement from one instant to the next, at most [sample].
            path: Displacement during the whole exposure [sample].
        """
        f = np.hypot(np.fft.fftfreq(SIDE)[:, None], np.fft.rfftfreq(SIDE))
        left = np.minimum(1, 1 / np.maximum(np.pi * f * path, 1e-9))
        return self.bound(self.exact * ((1 - np.sinc(f * step) ** 2) * left).astype(np.float32))

    def local(self, rms: float) -> Bound:
        """Return an error of this relative RMS that is located where blur is visible, at edges."""
        shape = self.without_blur
        if shape.rms > 0:
            return shape.times(rms / shape.rms)
        size = self._light.size * self.seconds
        # noise sigmas in the root mean square of the frame
        sigmas = float(size / np.sqrt(max(size + self.noise, 1)))
        return Bound(rms, rms * sigmas, rms * sigmas)

    def kernel_error(self, table, kernels, weights) -> Bound:
        """Return the error of kernels that are wrong by so much all over the frame.

        Args:
            table: Planes from spectra, (planes, L).
            kernels: Errors of the planes' kernels, (planes, m, m), m odd.
            weights: Weight of each plane in each channel, (C, planes).
        """
        at = (np.arange(kernels.shape[-1]) - kernels.shape[-1] // 2) % SIDE
        repeated = np.zeros((len(kernels), SIDE, SIDE))
        for own, kernel in zip(repeated, kernels, strict=True):
            np.add.at(own, (at[:, None], at), kernel)
        wrong = scipy.fft.rfft2(repeated).astype(np.complex64)
        return self.bound(mix(weights, self.light.sum(table)[0] * wrong))

    def even_error(self, rms: float) -> Bound:
        """Return an error of this relative RMS that is the same everywhere, such as rounding in transforms."""
        size, sigma = self._light.size * self.seconds * rms, self._sigma
        # the quantile and the maximum of a normal distribution, over a million pixels
        return Bound(rms, float(3.3 * size / sigma.low), float(5 * size / sigma.least))

    def see_ripples(self, axis: int, weights: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Return ripples along an axis as all channels together see them [e- s-1], without signs.

        Args:
            axis: The axis.
            weights: Ripples of unit samples at places along the axis, see `world_ripples`.
            part: Part of waves along the other axis, (SIDE // 2 + 1,), that the light there has.

        Returns:
            Of each place and sample of the other axis.
        """
        lens = np.abs(self.tables).max(axis=0)
        seen = np.maximum(lens[:, -1], lens[-np.arange(SIDE), -1]) if axis else lens[SIDE // 2]
        kernel = np.roll(np.fft.irfft(part * seen[: SIDE // 2 + 1], SIDE), SIDE // 2)
        assert self.brightness is not None  # whoever asks knows
        light = np.moveaxis(self.brightness, axis, 0)
        ripples = np.asarray(weights, light.dtype) @ light
        middle = np.s_[SIDE // 2 : SIDE // 2 + ripples.shape[1]]
        return np.abs([np.convolve(one, kernel)[middle] for one in ripples])

    def everywhere(self, errors: list[np.ndarray]) -> Bound:
        """Return the bound of errors [e- s-1] of all channels together at places all over the frame, without signs."""
        sigma, light = self._sigma, self._means
        share = (light.max(axis=1) / np.maximum(light.sum(axis=1), 1e-300)).max()  # of a channel
        weight = np.concatenate([np.full(one.size, 1 / one.size) for one in errors])
        values = np.concatenate([one.ravel() for one in errors])
        most = level_above(values, weight, 1e-3 / 2) / sigma.low, values.max() / sigma.least
        rms = np.sqrt(weight @ np.square(values, dtype=np.float64)) / self.level
        return Bound(float(rms), *(float(self.seconds * share * one) for one in most))

    def brightness_error(self, share: float) -> Bound:
        """The error of a picture that is brighter by this share everywhere."""
        sigma = share * self.signal * self.seconds / self._sigma.pixels
        weight = self.windows.weight[:, None] * self.share
        return Bound(share, quantile(sigma, weight, 0.999), float(sigma.max()))

    def fused_bounds(self, table, transfers):
        """Yield bounds of the first n planes for each n from the number of channels on.

        Args:
            table: Planes from spectra, (planes, L).
            transfers: Weight of each wavelength's transfer function in a plane's, by channel,
                (C, planes, L).
        """
        planes, left = self.light.sum(table)[0], self.exact.copy()
        responses = np.tensordot(transfers, self.tables, 1)  # (C, planes, SIDE, ...)
        responses = responses.astype(np.complex64 if np.iscomplexobj(responses) else np.float32)
        for k in range(len(table)):
            left -= responses[:, k] * planes[:, k, None]
            if k + 1 >= len(self.weights):
                yield k + 1, self.bound(left)


def _read_light(facts, rows, cols, lit):
    """The light of windows by wavelength. lit: samples that are not black, bool (n, SIDE, SIDE), or None for all."""
    taken = facts.samples.windows(rows, cols)
    entries = None
    # as few planes as there are: of all wavelengths, or of entries that samples are mixed of
    if taken.labels is None and len(taken.planes) < len(taken.wavelengths):
        planes, entries = taken.planes, taken.entry_spectra
    elif taken.is_spectral:
        planes = taken.planes
    else:
        planes = taken.mix(taken.entry_spectra.T.astype(np.float32))
    planes = np.ascontiguousarray(planes.swapaxes(0, 1), np.float32)
    if lit is not None:
        planes *= lit[:, None]
    return Light.of(planes, entries)


def _mean_squares(values):
    """Over the last two axes, float64 of sums in the type of the values."""
    values, power = in_range(values)
    rows, cols = values.shape[-2:]
    return np.ldexp(
        np.asarray(np.einsum("...yx,...yx->...", values, values) / (rows * cols), np.float64),
        2 * power,
    )

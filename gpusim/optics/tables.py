"""Transfer tables of a lens, integrated over the pixel, float64: reference of the kernels, input of the planner.

The integral is taken at every frequency that folds. For any pupil and whole frames this would take
hours. Beyond FEW frequencies, splines replace the integral: through integrals at own nodes if pupil
and wavefront are the same at every angle, else through a table of the rays with an error of at most
TABLE. Nodes are added to the integral until it no longer changes. For the planner the splines go
through the nodes along the rays that devices use, for all wavelengths at once.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import numpy as np
import scipy

from gpusim.domain.optics import Optics
from gpusim.domain.pupil import symmetric
from gpusim.optics.lens import Lens, wavelength_nodes
from gpusim.optics.lenses import open_lens
from gpusim.optics.otf import EXACT, defocus_only, hopkins, transfer
from gpusim.optics.rays import AFFORDABLE, polar_table, radial_table
from gpusim.optics.series import expansion

FEW = 2000  # frequencies
SPLINE = 1e-8  # error of the spline through half the nodes: with all it is a sixteenth
# error of cubics through the table; splines, which are smooth, err by a tenth of that
TABLE = 1e-6
POLYGON = 1.5e-5
LOOKED_AT = 3e6  # points of integrals for tables that predict errors: a tenth of a second


def transfer_tables(
    optics: Optics, pitch, q, aperture, rows, cols, displacement=(0.0, 0.0)
) -> np.ndarray:
    """Return transfer tables of a lens, one per wavelength, to be looked at, also for periods too short to blur by.

    Args:
        optics: Settings of the lens.
        pitch: Distance of the samples [m].
        q: Wavelength times working f-number over the pitch, shape (L,); the devices' float32.
        aperture: Height and width over which each sample is integrated [sample], or one number
            for a square.
        rows: Rows of the transform's period.
        cols: Columns of the transform's period.
        displacement: Of the apertures' middles from the samples, (rows, cols) [sample].

    Returns:
        See `gpusim.optics.lens.Lens.tables`.
    """
    lens = open_lens(optics, pitch, aperture, displacement=displacement)
    return lens.tables(q, rows, cols, _OnHost())


class _OnHost:
    """Makes transfer tables in float64, good to be looked at: see `gpusim.optics.lens.Stages`."""

    whole = False
    affordable = LOOKED_AT

    def airy(self, q, aperture, rows, cols):
        """See `Stages`."""
        return airy(np.asarray(q, np.float32), aperture, rows, cols)

    def pupil(self, outline, waves, q, aperture, rows, cols, spots, diffuser, displacement):
        """See `Stages`."""
        even, q = symmetric(outline, waves), np.asarray(q, np.float32)
        otfs = _along_rays(outline, waves, even)
        return _fold(otfs, even, q, aperture, rows, cols, spots, diffuser, displacement)

    def given(self, tables):
        """See `Stages`."""
        return tables

    def add(self, tables, spectra, is_round):
        """See `Stages`."""
        return add_spectra(tables, spectra, is_round)


def add_spectra(tables, spectra, is_round: bool) -> np.ndarray:
    """Return the sum of tables, quarters or halves, and of half spectra, complex (bands, rows, cols // 2 + 1).

    is_round: The sum is real quarters; else it is halves, as pairs of real and imaginary parts.
    """
    if tables.shape[2] != spectra.shape[2]:  # pairs
        return tables + np.ascontiguousarray(spectra).view(np.float32)
    if is_round:
        return tables + spectra[:, : tables.shape[1]].real
    rows = np.arange(spectra.shape[1])
    whole = tables[:, np.minimum(rows, len(rows) - rows)] + spectra
    return np.ascontiguousarray(whole, np.complex64).view(np.float32)


class Caching(Protocol):
    """Stores results of functions for the next plan, such as `gpusim.pipeline.cache.Cache`."""

    def __call__(self, name: str, function: Callable, *args: Any) -> Any:
        """Return `function(*args)`, computed only if an argument has changed since the last call of this name."""


def call_always(name: str, function: Callable, *args: Any) -> Any:
    """Return `function(*args)`: a `Caching` that stores nothing."""
    return function(*args)


def sample_lens(optics, pitch, q, aperture, rows, cols, displacement) -> np.ndarray:
    """Return tables of a lens: see `Tables.of`. pitch: distance of the samples [m]."""
    lens = open_lens(optics, pitch, aperture, displacement=displacement)
    if lens.symmetry.is_round:
        return lens.tables(q, rows, cols, _OnHost())
    nodes, between = wavelength_nodes(q)  # q is proportional to the wavelength
    return np.tensordot(between, lens.tables(nodes, rows, cols, _OnHost()), 1)


class Tables:
    """Transfer tables of a lens in front of pixels of `pitch` [m]."""

    def __init__(self, optics: Optics, pitch: float, cache: Caching):
        self._optics, self._pitch, self._cache = optics, pitch, cache

    def of(self, q, aperture, rows, cols, finer, displacement=(0.0, 0.0)) -> np.ndarray:
        """Return tables at all frequencies of a period, see `transfer_tables`.

        If the blur is not round, tables of a few wavelengths are interpolated.

        Args:
            q: Wavelength times working f-number over the distance of samples, shape (L,).
            aperture: Height and width [sample], or one number for a square.
            rows: Rows of the period.
            cols: Columns of the period.
            finer: Samples per pixel.
            displacement: Displacement of the apertures from the samples [sample].
        """
        return self._cache(
            f"sampled {rows}x{cols} {finer:g}",
            sample_lens,
            self._optics,
            self._pitch / finer,
            q,
            aperture,
            rows,
            cols,
            displacement,
        )

    def even(self, q, aperture, period, finer, displacement) -> np.ndarray:
        """Return tables of a square period: real quarters, or complex halves (L, period, period // 2 + 1)."""
        tables = self.of(q, aperture, period, period, finer, displacement)
        if tables.shape[-1] == period // 2 + 1:
            return tables
        return np.ascontiguousarray(tables).view(complex)


def field_tables(lens, wavelengths, places, period: int) -> np.ndarray:
    """Return transfer tables of a lens at places of the field, of a square period, as `Response.of` takes them."""
    chosen, between = wavelength_nodes(wavelengths)
    size = max(period - 1, lens.least_size)
    kernels = np.stack(
        [np.tensordot(between, lens.kernels(chosen, place, size), 1) for place in places], axis=1
    )
    kernels /= kernels.sum(axis=(2, 3), keepdims=True)
    whole = np.zeros((*kernels.shape[:-2], period, period))  # kernels are wrapped into the period
    at = (np.arange(kernels.shape[-1]) - kernels.shape[-1] // 2) % period
    np.add.at(whole, (slice(None),) * (kernels.ndim - 2) + (at[:, None], at), kernels)
    return np.fft.rfft2(whole)


def otf(s):
    """Transfer function of a circular pupil at s = (frequency) lambda N, 1 at s = 0 and 0 from s = 1 on.

    Source: Hopkins, Proc. R. Soc. A 231 (1955), in-focus case.
    """
    s = np.minimum(np.abs(s), 1.0)
    return 2 / np.pi * (np.arccos(s) - s * np.sqrt(1 - s * s))


def airy(q, aperture, rows, cols):
    """See the stage `optics.airy`: a sum over the replicas that the sampling folds onto each frequency."""
    height, width = np.broadcast_to(aperture, 2)
    fy, fx = (np.arange(n // 2 + 1) / n for n in (rows, cols))
    tables = np.zeros((len(q), len(fy), len(fx)))
    for table, one_q in zip(tables, np.asarray(q, np.float64), strict=True):
        parts_y, parts_x = (list(_replicas(f, one_q)) for f in (fy, fx))
        for rows_in, y in parts_y:
            for cols_in, x in parts_x:
                table[rows_in, cols_in] += (
                    otf(np.hypot(y[:, None], x) * one_q)
                    * np.sinc(height * y)[:, None]
                    * np.sinc(width * x)
                )
    return tables


def _replicas(frequencies, q):
    """Yield the slice of ascending frequencies that is within the cut-off, and its values, for each replica."""
    reach = int(np.ceil(1 / q + 0.5))
    for whole in range(-reach, reach + 1):
        inside = np.flatnonzero(np.abs(frequencies + whole) * q < 1)
        if inside.size:
            part = slice(inside[0], inside[-1] + 1)
            yield part, frequencies[part] + whole


def exact_otf(outline, waves):
    """Return the transfer function of a pupil with one wavefront (1, n, n), of (sx, sy) within the cut-off."""
    return (_spline_radial if symmetric(outline, waves) else _spline_polar)(outline, waves)


def pupil(
    outline, waves, q, aperture, rows, cols, spots=(0.0, 0.0), diffuser=0.0, displacement=(0.0, 0.0)
):
    """See the stage `optics.pupil`: a sum over the replicas (a, b) within the cut-off."""
    waves = np.asarray(waves, np.float64)
    even = symmetric(outline, waves)
    high = rows // 2 + 1 if even and not any(displacement) else rows
    few = len(q) * high * (cols // 2 + 1) < FEW
    value = _integral if few else _spline_radial if even else _spline_polar
    otfs = (value(outline, wave[None]) for wave in waves)
    return _fold(otfs, even, q, aperture, rows, cols, spots, diffuser, displacement)


class _Exact(_OnHost):
    """Makes transfer tables with the kernels' reference."""

    affordable = AFFORDABLE

    def pupil(self, outline, waves, q, aperture, rows, cols, spots, diffuser, displacement):
        """See `Stages`."""
        return pupil(outline, waves, q, aperture, rows, cols, spots, diffuser, displacement)


def exact_tables(lens: Lens, q, rows: int, cols: int, distance: float | None = None) -> np.ndarray:
    """Return transfer tables of a lens, made with the kernels' reference: see `Lens.tables`."""
    return lens.tables(q, rows, cols, _Exact(), distance)


def _fold(otfs, even, q, aperture, rows, cols, spots, diffuser, displacement):
    """Tables of transfer functions `otfs` of (sx, sy), one per wavelength; even: they are the same at every angle."""
    real = even and not any(displacement)
    fy = np.arange(rows // 2 + 1) / rows if real else np.fft.fftfreq(rows)
    fx = np.arange(cols // 2 + 1) / cols
    tables = np.zeros((len(q), fy.size, fx.size), float if real else complex)
    for table, one_q, otf in zip(tables, np.asarray(q, np.float64), otfs, strict=True):
        reach = int(np.ceil(1 / one_q + 0.5))
        y, x = ((np.arange(-reach, reach + 1)[:, None] + f).ravel() for f in (fy, fx))
        axes = zip((y, x), np.broadcast_to(aperture, 2), spots, displacement, strict=True)
        down, across = (
            np.sinc(width * f)
            * np.cos(np.pi * spot * f)
            * np.exp(-2 * (np.pi * diffuser * f) ** 2 + (0 if real else 2j * np.pi * move * f))
            for f, width, spot, move in axes
        )
        inside = np.nonzero(np.hypot(y[:, None], x) * one_q < 1)
        values = np.zeros((y.size, x.size), tables.dtype)
        found = otf(x[inside[1]] * one_q, y[inside[0]] * one_q)
        values[inside] = found.real if real else found
        values *= down[:, None]
        values *= across
        table[:] = values.reshape(-1, fy.size, 2 * reach + 1, fx.size).sum(axis=(0, 2))
    return tables if real else tables.view(np.float64)


def _along_rays(outline, waves, even):
    """Transfer functions of all wavelengths, by splines through the nodes that devices use: good to 4e-6."""
    if not even:
        tables, *rays = polar_table(outline, waves)
        return (_through_rays(outline, table, *rays) for table in tables)
    tables = radial_table(outline, waves)
    nodes = np.linspace(0, 1, tables.shape[1])

    def otf(spline, sx, sy):
        return spline(1 - np.sqrt(1 - np.hypot(sx, sy)))

    # one fit of all wavelengths, whose cost is that of a few
    pieces = scipy.interpolate.CubicSpline(nodes, tables, axis=1).c
    each = (np.ascontiguousarray(pieces[..., band]) for band in range(len(tables)))
    return (partial(otf, scipy.interpolate.PPoly.construct_fast(one, nodes)) for one in each)


def _integral(outline, wave):
    if defocus_only(outline, wave):
        defocus = wave[0, 2, 0] if wave.shape[-1] > 2 else 0.0
        return lambda sx, sy: hopkins(np.hypot(sx, sy), defocus)
    return lambda sx, sy: transfer(outline, wave, sx, sy)[0]


def _spline_radial(outline, wave):
    """Nodes even in t, s = 3 t^2 - 2 t^3, which is flat at both ends and at 1 takes the root's power to the third.

    They are doubled until the spline through every other one meets the rest.
    """
    if defocus_only(outline, wave):
        found = _integral(outline, wave)
    else:
        series = expansion(outline, wave, EXACT)
        found = lambda s, _: series(s, np.zeros(1))[0, 0]  # noqa: E731
    count, rest = 1000, 1.0
    while rest > SPLINE:
        count *= 2
        t = np.linspace(0, 1, count + 1)
        s = t * t * (3 - 2 * t)
        values = np.real(found(s, np.zeros_like(s)))
        rest = np.abs(scipy.interpolate.CubicSpline(t[::2], values[::2])(t) - values).max()
    spline = scipy.interpolate.CubicSpline(t, values)
    # the cubic's inverse
    return lambda sx, sy: spline(0.5 - np.sin(np.arcsin(1 - 2 * np.hypot(sx, sy)) / 3))


def _spline_polar(outline, wave):
    table, *rays = polar_table(outline, wave, POLYGON if outline.sides.size else TABLE)
    return _through_rays(outline, table[0], *rays)


def _through_rays(outline, table, first, sectors):
    """Splines through a table (rays, n), see `polar_table`."""
    sides, inner = outline.cutoff
    size = (table.shape[0] - 1) // sectors
    rays, nodes = np.linspace(0, sectors, sectors * size + 1), np.linspace(0, 1, table.shape[1])
    splines = []
    for k in range(sectors):
        sector = slice(k * size, (k + 1) * size + 1)
        real, imaginary = (
            scipy.interpolate.RectBivariateSpline(rays[sector], nodes, part[sector])
            for part in (table.real, table.imag)
        )
        splines.append((real, imaginary))

    def otf(sx, sy):
        s, half_turns = np.hypot(sx, sy), (np.arctan2(sy, sx) - first) / np.pi
        whole = np.floor(half_turns)
        turn = half_turns - whole
        if sides:
            side = turn * sides / 2
            s = s * np.cos(2 * np.pi / sides * (side - np.rint(side))) / inner
        out, place = np.zeros(s.shape, complex), 1 - np.sqrt(np.maximum(1 - s, 0))
        for k, (re, im) in enumerate(splines):
            here = (s < 1) & (np.minimum((turn * sectors).astype(int), sectors - 1) == k)
            at = turn[here] * sectors, place[here]
            out[here] = re.ev(*at) + 1j * im.ev(*at) * np.where(whole[here] % 2, -1, 1)
        return out

    return otf

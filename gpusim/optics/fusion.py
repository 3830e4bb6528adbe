"""The joint spectral-optical operator: a few weighted planes in place of all wavelengths, and its error.

A camera's channel is e_c(f) = sum over l of  a_cl(f) x_l(f),  a_cl = weights[c, l] O_l(f), with x
the content's samples and O_l the transfer function of wavelength l. A rank-r operator transforms r
planes z = W_in^T x instead and takes a_c(f) W_out z. Its error is a_c(f) (1 - W_out W_in^T) x(f).
Columns of W are ordered: the first r of a larger operator are the operator of rank r.

There are two ways to choose them. `joint_operator` is best for the likely spectra of a prior.
`channel_operator` bounds the error of every spectrum, however narrow, with more planes per channel.
Both give flat fields of any spectrum exactly.

`Watch` predicts the error for other content, from a few projections of that content.
`Response.error` takes the moments V of a content's spectra and D of their differences between
neighbours, over all pairs of wavelengths. W_c is the error matrix of channel c: W_c[l, m] is the
excess weight of O_l for wavelength m. G is the response's `optical`. The mean square error of the
mosaic is

    sum over c of  share_c sum over l, m, n, o of  W_c[l, m] G[l, n] W_c[n, o] D[m, o]  =  trace(M D),
    M = sum over c of  share_c W_c^T G W_c,

and the signal is trace(S V), S = sum over c of  share_c flat_c^T flat_c. A row b projects spectra x
to b x, with mean square b V b^T, and differences to b d, with mean square b D b^T. With S = F^T F
and M = B^T B + R,

    signal = sum over rows f of F of  E[(f x)^2],     error = sum over rows b of B of  E[(b d)^2]  +  trace(R D),

and the few largest eigenvalues are nearly all of M. P projects on the rows of F, which hold most of
natural spectra, and Q = 1 - P. The root of trace(R D) is at most |R^1/2 P| times the root of E[|P
d|^2], which follows from F, plus |R^1/2 Q| times the root of E[|Q d|^2] = E[|d|^2] - E[|P d|^2].
The stage `spectral.survey` measures all of them on a device, in one pass over a few rows and
without moments.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, isfinite, nan, sqrt
from typing import Any, NamedTuple

import numpy as np

from gpusim.domain.content import Content, Cube

# of the mean variance of a wavelength, white: spectra outside the prior are not amplified
RIDGE = 0.02
# predicted relative error below which float32 transforms are the limit: no rank beyond it
SMALLEST_TAIL = 1e-6
SAMPLES = 1 << 15  # pixels whose spectra stand for the scene's
MOST_ENTRIES = 512  # materials in these, between which moments are looked for
SAMPLED_PERIOD = 64  # [pixel] of the grid of frequencies at which operators are made and predicted
DARKEST = 1e-30  # light below which there is none: no pixel of any camera gets one electron of it in a year
ROUNDS = 10  # of the search for the operator of least maximum error: within 5 % of the result of 40

# of `Watch`
# of B: of 31 wavelengths the next eigenvalue is below 3e-5 of the largest up to so many planes
WRONG_ROWS = 8
FEW = 5
ALL_ROWS = 16  # of both, that `spectral.survey` takes: operators of more planes have all of them
SHORTEST = 1e-6  # of the longest row of F, below which one is none
ROUNDING = 1e-6  # of squares that are summed in float32
EXPONENT = 120  # of factors, which are powers of two that float32 holds
FLAT_ROWS = 8  # of F: all of them, for sensors of up to so many channels


@dataclass(frozen=True, eq=False)
class Response:
    """A camera's channels over wavelength and frequency, as second moments.

    weights: shape (C, L). flat: response to a flat field, a_c(0), shape (C, L). share: part of the pixels that has each
    channel, shape (C,). tables: O_l at F frequencies, at one place of the field after the other, shape (L, F), the
    first of them 0. power: see `of`, shape (F,). count: how many frequencies of the whole plane each stands for,
    shape (F,).
    """

    weights: np.ndarray
    flat: np.ndarray
    share: np.ndarray
    tables: np.ndarray
    power: np.ndarray
    count: np.ndarray

    @classmethod
    def of(cls, weights, tables, cfa) -> "Response":
        """Return the response of channels with `weights` (C, L) behind the tables of a period n, n even.

        The power of content at f is taken as the power of white differences between neighbours, 1 /
        (4 sin^2(pi fx) + 4 sin^2(pi fy)): edges at random places, whose amplitude falls as 1/f like
        natural images (Field, JOSA A 4, 1987).

        Args:
            weights: Electrons per content, shape (C, L).
            tables: Real quarters (L, n // 2 + 1, n // 2 + 1), complex halves (L, n, n // 2 +
                1), or either for P places of the field with equal weights, (L, P, ...).
            cfa: Channel of each pixel of one period of the mosaic.
        """
        places = tables.shape[1] if tables.ndim == 4 else 1
        rows, cols = tables.shape[-2:]
        period = 2 * (cols - 1)
        fx = np.arange(cols) / period
        fy = fx if rows == cols else np.fft.fftfreq(rows)
        # where only one half is stored, each also stands for its negative
        twice_x = np.where((fx == 0) | (fx == 0.5), 1, 2)
        twice_y = twice_x if rows == cols else np.ones(rows)
        power = 4 * np.sin(np.pi * fy[:, None]) ** 2 + 4 * np.sin(np.pi * fx) ** 2
        power[0, 0] = np.inf  # flat fields are exact, whatever their power
        count = np.multiply.outer(twice_y, twice_x) / places
        power = count / power / period**2
        share = np.bincount(np.ravel(cfa), minlength=len(weights)) / np.size(cfa)
        tables = tables.reshape(len(tables), -1)
        return cls(
            weights,
            weights * np.real(tables[:, :1].T),
            share,
            tables,
            np.tile(power.ravel(), places),
            np.tile(count.ravel(), places),
        )

    def channel(self, c) -> "Response":
        """Return the response of channel c only."""
        return replace(self, weights=self.weights[[c]], flat=self.flat[[c]], share=np.ones(1))

    @cached_property
    def optical(self) -> np.ndarray:
        """Re sum over f of  power(f) O_l(f)^* O_m(f), shape (L, L).

        The mean square of a channel for content whose neighbouring pixels differ by a vector d is
        (d weights[c]) optical (weights[c] d)^T.
        """
        return np.real((self.tables * self.power) @ self.tables.conj().T)

    def excess(self, table, transfers) -> np.ndarray:
        """Return the excess weight of each O_l for each wavelength, (C, L, L); see `error`."""
        exact = self.weights[:, :, None] * np.eye(table.shape[1])
        return np.einsum("ckl,km->clm", transfers, table) - exact

    def error(self, table, transfers, spectra: "Spectra") -> float:
        """Relative root mean square error of the mosaic's electrons for content with these moments.

        table: planes from spectra, shape (planes, L). transfers: weight of O_l in the transfer function of each plane
        in each channel, shape (C, planes, L).
        """
        wrong, differences = self.excess(table, transfers), spectra.differences
        error = np.einsum(
            "clm,ln,cno,mo->c", wrong, self.optical, wrong, differences, optimize=True
        )
        signal = np.einsum("cl,lm,cm->c", self.flat, spectra.values, self.flat)
        total = self.share @ signal
        return float(np.sqrt(max(self.share @ error, 0.0) / total)) if total > 0 else 0.0


@dataclass(frozen=True, eq=False)
class Spectra:
    """Second moments of a scene's content over its pixels.

    Attributes:
        values: E[x^T x] of the spectra, shape (L, L).
        differences: E[d^T d] summed over the differences d to the neighbour below and to the
            right.
    """

    values: np.ndarray
    differences: np.ndarray

    @classmethod
    def of(cls, content: Content) -> "Spectra":
        """Moments of a content in host memory, from evenly spaced pairs of rows, about SAMPLES pixels in all."""
        first = row_pairs(*content.shape)
        both = np.stack([first, np.minimum(first + 1, content.shape[0] - 1)], axis=1)
        return cls.of_pairs(content.take(both.ravel()))

    @classmethod
    def of_pairs(cls, pairs: Content, weight: np.ndarray | None = None) -> "Spectra":
        """Return moments of pairs of neighbouring rows, one above the other.

        They are computed from moments of the entries. weight: of each pair, 1 in the mean, (n,);
        None: equal weights.
        """
        entries = pairs.entry_spectra
        weight = np.ones(pairs.shape[0] // 2) if weight is None else weight
        if pairs.labels is not None:  # of the materials that are there
            there = np.bincount(pairs.labels.ravel().astype(int)) > 0
            used, ids = np.flatnonzero(there), np.take(np.cumsum(there) - 1, pairs.labels)
            if len(used) <= MOST_ENTRIES:
                return cls(*_labelled_moments(ids, pairs.planes, entries[used], weight))
            pairs = Cube(pairs.wavelengths, pairs.bands_at(slice(None)))
            entries = np.eye(len(pairs.wavelengths))
        # float32 sums of a cube's rows, a tenth of a plan's time in float64; differences of neighbours are exact
        kind = np.float32 if pairs.is_spectral else np.float64
        lines, power = in_range(pairs.planes.swapaxes(0, 1).astype(kind, copy=False))
        cols, (values, differences) = pairs.shape[1], np.zeros((2, len(entries), len(entries)))
        for upper, lower, part in zip(lines[::2], lines[1::2], weight, strict=True):
            across, down = np.diff(upper), lower - upper
            values += part * (upper @ upper.T / cols)
            differences += part * (across @ across.T / max(cols - 1, 1) + down @ down.T / cols)
        values = np.ldexp(2 / len(lines) * values, 2 * power)
        differences = np.ldexp(2 / len(lines) * differences, 2 * power)
        if pairs.is_spectral:
            return cls(values, differences)
        return cls(entries.T @ values @ entries, entries.T @ differences @ entries)


def _labelled_moments(ids, shading, entries, weight):
    """The moments of samples of one entry each; ids, shading: of pairs of rows, one above the other.

    weight: of each pair, 1 in the mean.
    """
    shading, count = np.asarray(shading, np.float64), len(entries)

    def products(a, b):
        """Sums of products of two entries at two places: slices of rows and columns."""
        both = ids[a] * count + ids[b]
        values = weight[:, None] * (shading[a] * shading[b])
        sums = np.bincount(both.ravel(), values.ravel(), count**2)
        return sums.reshape(count, count) / both.size

    upper, total = np.s_[::2], np.zeros((count, count))
    neighbours: list[Any] = [(upper, np.s_[1::2])]
    if ids.shape[1] > 1:
        neighbours.append((np.s_[::2, :-1], np.s_[::2, 1:]))
    for a, b in neighbours:
        both = products(a, b)
        total = total + (products(a, a) + products(b, b) - both - both.T)
    return entries.T @ products(upper, upper) @ entries, entries.T @ total @ entries


def in_range(values) -> tuple[np.ndarray, int]:
    """Return values over a power of two that scales the largest to at most 1, and the exponent.

    No bit is lost, and no square or sum of squares overflows: sums in float32 end at 3e38, so
    squares limit light to 2e19. If all values are below DARKEST they count as dark: 0.
    """
    most = max(float(np.max(values, initial=0)), -float(np.min(values, initial=0)))
    if most < DARKEST:
        return np.zeros_like(values), 0
    power = int(np.frexp(most)[1])
    return values * values.dtype.type(2.0**-power), power


def row_pairs(rows: int, cols: int) -> np.ndarray:
    """Upper rows of the evenly spaced pairs that stand for a content of this shape, about SAMPLES pixels in all.

    Shape (n,), increasing. Of a content with one row that is its own lower one.
    """
    count = min(max(rows - 1, 1), max(8, SAMPLES // cols))
    return np.unique(np.linspace(0, max(rows - 2, 0), count).astype(int))


@dataclass(frozen=True, eq=False)
class Operator:
    """Planes from spectra and channels from planes, for every rank up to the number of columns.

    w_in, w_out: shape (L, R). tail: relative error over the prior for rank 0 .. R, from the eigenvalues left out.
    """

    response: Response
    w_in: np.ndarray
    w_out: np.ndarray
    tail: np.ndarray

    @property
    def ranks(self) -> range:
        """Possible ranks: from one plane per channel up to the rank from which more planes bring nothing."""
        return range(len(self.response.weights), self.w_in.shape[1] + 1)

    def transfers(self, rank: int) -> np.ndarray:
        """Weight of O_l in the transfer function of plane k in channel c, shape (C, rank, L)."""
        return self.response.weights[:, None] * self.w_out[:, :rank].T

    def predict_error(self, rank: int, spectra: Spectra) -> float:
        """Relative root mean square error of the mosaic's electrons for content with these moments."""
        return self.response.error(self.w_in[:, :rank].T, self.transfers(rank), spectra)


def joint_operator(response: Response, prior) -> Operator:
    """Return the operator of least expected error over a prior.

    prior: E[x^T x] of likely spectra, shape (L, L). Flat fields of any spectrum stay exact because
    the channels' own responses span the first planes. The rest are eigenvectors of the remainder.
    """
    bands = len(prior)
    if not np.trace(prior) > 0:  # of the dark
        prior = np.eye(bands)
    ridged = prior + RIDGE * np.trace(prior) / bands * np.eye(bands)
    variance, directions = np.linalg.eigh(ridged)
    half = directions * np.sqrt(variance)  # ridged = half half^T
    scale = np.sqrt(np.einsum("cl,lm,cm->c", response.flat, ridged, response.flat))
    scale = np.where(scale > 0, scale, 1)[:, None]  # channels have equal weights
    exact, _ = np.linalg.qr(half.T @ (response.flat / scale).T)
    scaled = response.weights / scale
    power = half.T @ (response.optical * (scaled.T @ scaled)) @ half
    others = np.eye(bands) - exact @ exact.T
    eigenvalues, vectors = np.linalg.eigh(others @ power @ others)
    eigenvalues, vectors = np.maximum(eigenvalues[::-1], 0), vectors[:, ::-1]
    left = np.cumsum(eigenvalues[::-1])[::-1]  # left[k]: the eigenvalues from k on
    tail = np.sqrt(np.append(left, 0) / max(np.trace(power), 1e-300))
    more = min(int(np.argmax(tail < SMALLEST_TAIL)), bands - exact.shape[1])
    # once more orthogonal: where eigenvalues are near 0, eigenvectors mix with the exact directions, which are at 0
    planes = np.linalg.qr(np.hstack([exact, vectors[:, :more]]))[0]
    tail = np.concatenate([np.ones(exact.shape[1]), tail[: more + 1]])
    return Operator(response, np.linalg.solve(half.T, planes), half @ planes, tail)


@dataclass(frozen=True, eq=False)
class ChannelOperator:
    """K planes for each channel that are right for every spectrum, to a bound.

    table: planes from spectra, shape (C K, L), channel by channel. transfers: weight of O_l in the transfer function of
    each plane in each channel, shape (C, C K, L), 0 in the other channels. bound: largest relative root mean square
    error of the mosaic over all monochromatic point sources that the camera sees.
    """

    table: np.ndarray
    transfers: np.ndarray
    bound: float


def channel_operator(response: Response, planes: int) -> ChannelOperator:
    """Return the operator of `planes` planes a channel.

    Channel c has the share rho_cl = weights[c, l] / |weights[:, l]| of wavelength l. With emphases
    v_l, the singular vectors U of rho_cl v_l O_l(f), the first of them the response to a flat
    field, make

        O_l = sum_k (U_lk / rho_cl v_l) sum_m U_mk rho_cm v_m O_m:

    if a channel sees little of a wavelength, its error counts little. The emphases grow with the
    error, which turns the least mean error into nearly the least maximum (Lawson's algorithm).
    """
    weights, share = response.weights, response.share
    channels, bands = weights.shape
    norm = np.sqrt(share @ weights**2)
    rho = np.divide(weights, norm, out=np.zeros_like(weights), where=norm > 0)
    optical = np.real((response.tables * response.count) @ response.tables.conj().T)
    seen = norm > 1e-3 * norm.max()  # darker wavelengths are below any noise
    emphasis, best = np.ones(bands), ChannelOperator(np.empty(0), np.empty(0), np.inf)
    for _ in range(ROUNDS):
        table = np.empty((channels * planes, bands))
        transfers = np.zeros((channels, channels * planes, bands))
        errors = np.zeros(bands)
        for c in range(channels):
            row = rho[c] * emphasis
            first = row * np.real(response.tables[:, 0])
            first = first[:, None] / max(np.linalg.norm(first), 1e-300)  # a channel may see nothing
            others = np.eye(bands) - first @ first.T
            gram = row[:, None] * optical * row
            vectors = np.linalg.eigh(others @ gram @ others)[1][:, ::-1]
            basis = np.linalg.qr(np.hstack([first, vectors[:, : planes - 1]]))[0]
            lost = np.eye(bands) - basis @ basis.T
            errors += share[c] * np.einsum("lm,ml->l", lost @ gram, lost) / emphasis**2
            own = slice(c * planes, (c + 1) * planes)
            table[own] = norm / emphasis * basis.T
            transfers[c, own] = row * basis.T
        relative = np.sqrt(np.maximum(errors, 0) / np.diag(optical))
        bound = float(relative[seen].max())
        if bound < best.bound:
            best = ChannelOperator(table, transfers, bound)
        emphasis *= np.sqrt(relative / max(bound, 1e-300) + 1e-3)
        emphasis /= emphasis.max()
    return best


class Surveyed(NamedTuple):
    """What a survey says of a content.

    Attributes:
        drift: Relative RMS error of the planes, predicted.
        steepest: The same of the pair of rows with the largest one, over the signal of all rows.
        roughness: RMS of the signal's differences between neighbours over the RMS of the signal.
        roughest: The same of the pair of rows with the largest one.
        level: RMS of the signal, in units of the watch.
    """

    drift: float = 0.0
    steepest: float = 0.0
    roughness: float = 0.0
    roughest: float = 0.0
    level: float = 0.0

    @property
    def measures(self) -> tuple[float, ...]:
        """Numbers that grow with a plan's errors: relative ones, and these over the shot noise of the signal."""
        return (*self[:4], *(sqrt(self.level) * value for value in self[:4]))


@dataclass(frozen=True, eq=False)
class Watch:
    """Projections to measure of a content that a plan's input table takes, and the error that follows.

    Attributes:
        flat: F, shape (up to 8, L).
        wrong: B, shape (up to 15, L).
        left: Largest eigenvalue of R, the part of M that B does not hold, over coefficients of
            content entries.
        table: Projections from entries, `flat` first, float32 (P, entries), for
            `spectral.survey`.
        seen: Weights of the squares of the projections by `flat` in |P d|^2, shape (up to 8,).
        beside: |R^1/2 P| and |R^1/2 Q|, over coefficients.
        first: Upper rows of the pairs to survey, int32 (n,).
        inputs: Planes from spectra, shape (planes, L). The plan's `Planes` give the
            same from entries.
        factor: Correction of the error, measured by probes of the plan's scene.
        falls: Part of the square of each row of B that remains with one plane more, two more
            and so on, shape (up to 15,) each.
        scale: Scales of the content and of its projections, for `spectral.survey`.
        limit: Relative RMS error up to which the plan serves other contents.
    """

    flat: np.ndarray
    wrong: np.ndarray
    left: float
    table: np.ndarray
    seen: np.ndarray
    beside: tuple[float, float]
    first: np.ndarray
    inputs: np.ndarray
    factor: float = 1.0
    falls: tuple = ()
    scale: tuple[float, float] = (1.0, 1.0)
    limit: float = inf

    @classmethod
    def of(cls, response: Response, table, transfers, content: Content, shape=None) -> "Watch":
        """Return the watch of an operator.

        Other contents may differ from `content` only in their samples.

        Args:
            response: Channels over wavelength and frequency.
            table: Planes from spectra, shape (planes, L).
            transfers: Weights of the transfer functions, shape (C, planes, L).
            content: The content.
            shape: Rows and columns of the samples that are surveyed; by default all.
        """
        entries = content.entry_spectra
        signal = (response.flat.T * response.share) @ response.flat
        flat, _, _ = _rows(signal, content, min(FLAT_ROWS, len(response.flat)))
        count = WRONG_ROWS if len(table) <= FEW else ALL_ROWS - len(flat)
        wrong, left, rest = _rows(wrong_moments(response, table, transfers), content, count)
        projections = np.vstack([flat, wrong]) @ entries.T
        lengths = np.linalg.norm(projections[: len(flat)], axis=1)
        seen = np.where(lengths > SHORTEST * lengths.max(), 1 / np.maximum(lengths, 1e-300), 0)
        there = seen[:, None] * projections[: len(flat)]  # at right angles to one another
        along = rest @ there.T
        beside = float(np.linalg.norm(along, 2)), float(np.linalg.norm(rest - along @ there, 2))
        first = row_pairs(*(content.shape if shape is None else shape)).astype(np.int32)
        projections = projections.astype(np.float32)
        table = np.asarray(table)
        return cls(flat, wrong, left, projections, seen**2, beside, first, table)

    @classmethod
    def of_no_blur(
        cls, response: Response, content: Content, shape, spectra: Spectra
    ) -> tuple["Watch", float]:
        """Return the watch for a blur that is left out, and the error of a content with moments `spectra`.

        A channel's error at a wavelength is then its transfer function minus the one of a flat
        field. shape: rows and columns of the samples that are surveyed.
        """
        wrong = replace(response, tables=response.tables - response.tables[:, :1])
        channels, bands = response.weights.shape
        nothing = np.zeros((0, bands)), np.zeros((channels, 0, bands))
        return cls.of(wrong, *nothing, content, shape), wrong.error(*nothing, spectra)

    @classmethod
    def of_exact(cls, weights, share, content: Content, shape) -> "Watch":
        """Return the watch for planes without an error. It sees how rough and how bright other contents are.

        Args:
            weights: Electrons per content, shape (C, L).
            share: Part of the pixels that has each channel, shape (C,).
            content: The content.
            shape: Rows and columns of the samples that are surveyed.
        """
        flat, _, _ = _rows((weights.T * share) @ weights, content, min(FLAT_ROWS, len(weights)))
        nothing = np.zeros((0, weights.shape[1]))
        return cls(
            flat,
            nothing,
            0.0,
            (flat @ content.entry_spectra.T).astype(np.float32),
            np.zeros(len(flat)),
            (0.0, 0.0),
            row_pairs(*shape).astype(np.int32),
            nothing,
        )

    def with_scale(self, content: Content) -> "Watch":
        """Return the same with scales for a content in host memory.

        With them float32 holds the squares of contents up to 1e15 times as bright.
        """
        largest = np.abs(content.planes).max(initial=0), np.abs(self.table).max(initial=0)
        exponents = np.clip(np.frexp(largest)[1], -EXPONENT, EXPONENT)
        unit, of_table = np.ldexp(1.0, -exponents).tolist()
        return replace(self, scale=(unit, unit * of_table))

    @cached_property
    def _units(self) -> np.ndarray:
        """What one is in a survey, in the content's own units: of the squares of each projection and of the content."""
        units = np.full(len(self.table) + 1, self.scale[1] ** -2.0)
        units[-1] = self.scale[0] ** -2.0
        return units

    @cached_property
    def _sums(self) -> np.ndarray:
        """Weights of surveyed squares in four sums, (P + 1, 4): error, |P d|^2, |d|^2 and differences of the signal."""
        signals, sums = len(self.flat), np.zeros((len(self._units), 4))
        sums[signals:-1, 0] = 1
        sums[:signals, 1] = self.seen
        sums[-1, 2] = 1
        sums[:signals, 3] = 1
        return self._units[:, None] * sums

    def errors(self, survey) -> Surveyed:
        """Return the relative RMS error of the mosaic's electrons, predicted from a survey, and its roughness.

        The error is the one of `Response.error` for the moments over the same rows, or larger: R
        counts with its upper bound. All is 0 without a signal, and NaN if the content has NaN or
        squares beyond float32, so comparisons must fail for NaN.

        Args:
            survey: Result of `spectral.survey`, shape (n, 3, P + 1).
        """
        found = np.asarray(survey, np.float64)
        if not isfinite(np.add.reduce(found, None)):  # all are squares: no two of them cancel
            return Surveyed(*[nan] * 5)
        count, signals = len(found), len(self.flat)
        means = np.add.reduce(found[:, 0, :signals], 0)
        signal = float(means @ self._units[:signals]) / count
        if signal == 0:
            return Surveyed()
        each, along, whole, rough = ((found[:, 1] + found[:, 2]) @ self._sums).T
        each = each + self._rest(along, whole)
        return Surveyed(
            self.factor * sqrt(np.add.reduce(each) / count / signal),
            self.factor * sqrt(np.maximum.reduce(each) / signal),
            sqrt(np.add.reduce(rough) / count / signal),
            sqrt(np.maximum.reduce(rough) / signal),
            sqrt(signal),
        )

    def _rest(self, along, whole):
        """Upper bound of the part of R, of pairs of rows with |P d|^2 and |d|^2, shape (n,) each."""
        across = np.maximum(whole - along, ROUNDING * whole)
        root = self.beside[0] * np.sqrt(along) + self.beside[1] * np.sqrt(across)
        return np.fmin(self.left * whole, root * root)

    def forecast_falls(self, moments) -> tuple:
        """Return `falls` for operators of one plane more, two more and so on, with error moments M'.

        For a row b of B it is b M' b^T / |b|^4: the error of M' in the direction of b, over the
        error |b|^2 of M.
        """
        size = np.maximum(np.sum(self.wrong**2, axis=1), 1e-150)  # its square is no 0
        return tuple(
            np.einsum("pl,lm,pm->p", self.wrong, more, self.wrong) / size**2 for more in moments
        )

    def count_missing_planes(self, survey) -> int:
        """Return the number of additional planes with which the error of a content is within the limit.

        It is one more than `falls` covers if none of those is enough. This is a guess, which the
        next survey checks: differences are taken as independent along the rows of B, and the rest
        is neglected.
        """
        values, across, down = self._units * np.asarray(survey, np.float64).mean(0)
        signals, differences = len(self.flat), across + down
        allowed = (self.limit / self.factor) ** 2 * values[:signals].sum()
        for more, fall in enumerate(self.falls, 1):
            if fall @ differences[signals:-1] <= allowed:
                return more
        return len(self.falls) + 1


def wrong_moments(response: Response, table, transfers) -> np.ndarray:
    """Return M, shape (L, L): d M d^T is the mosaic's mean square error for neighbours that differ by d (L,)."""
    wrong = response.excess(table, transfers)
    shared = response.share[:, None, None] * (response.optical @ wrong)
    return np.tensordot(wrong, shared, ((0, 1), (0, 1)))


def _rows(moments, content, count):
    """Rows B (count, L) that hold most of positive moments M = H^T H, the largest eigenvalue left, and the rest.

    The rest has the shape (L, entries), of coefficients. The rows hold most of the columns of H
    E^T, E the spectra of the entries. The remainder, H E^T - Q Q^T H E^T with Q the largest
    eigenvectors of their products, has a largest eigenvalue over all mixes of entries. A sample of
    one entry with spectrum e differs from its neighbour by a e - b e', so twice the largest square
    of a column is a bound, too.
    """
    variance, directions = np.linalg.eigh(moments)
    half = np.sqrt(np.maximum(variance, 0))[:, None] * directions.T
    given = half @ content.entry_spectra.T
    eigenvalues, vectors = np.linalg.eigh(given @ given.T)
    largest = vectors[:, ::-1][:, :count]
    left = max(float(eigenvalues[::-1][count]), 0.0) if count < len(eigenvalues) else 0.0
    rest = given - largest @ (largest.T @ given)
    if content.labels is not None:
        left = min(left, 2 * float((rest**2).sum(0).max()))
    return largest.T @ half, left, rest

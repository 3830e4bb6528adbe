"""Error of a plan's joint operator for other content, from a few projections of that content.

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
from math import inf, sqrt

import numpy as np

from gpusim.domain.content import Content
from gpusim.optics.fusion import Response, Spectra, row_pairs

# of B: of 31 wavelengths the next eigenvalue is below 3e-5 of the largest up to so many planes
WRONG_ROWS = 8
FEW = 5
ALL_ROWS = 16  # of both, that `spectral.survey` takes: operators of more planes have all of them
SHORTEST = 1e-6  # of the longest row of F, below which one is none
ROUNDING = 1e-6  # of squares that are summed in float32
EXPONENT = 120  # of factors, which are powers of two that float32 holds
FLAT_ROWS = 8  # of F: all of them, for sensors of up to so many channels


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
        inputs: Planes from spectra, shape (planes, L). The plan's table gives the same planes
            from entries.
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
        entries, signal = content.entry_spectra, (response.flat.T * response.share) @ response.flat
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
        return cls(
            flat,
            wrong,
            left,
            projections.astype(np.float32),
            seen**2,
            beside,
            first,
            np.asarray(table),
        )

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

    def with_scale(self, content: Content) -> "Watch":
        """Return the same with scales for a content in host memory.

        With them float32 holds the squares of contents up to 1e15 times as bright.
        """
        unit, of_table = (
            2.0 ** -float(np.clip(np.frexp(largest)[1], -EXPONENT, EXPONENT))
            for largest in (
                np.abs(content.planes).max(initial=0),
                np.abs(self.table).max(initial=0),
            )
        )
        return replace(self, scale=(unit, unit * of_table))

    def _in_content_units(self, survey):
        """Result of `spectral.survey` in the content's own units, float64."""
        units = np.full(np.shape(survey)[-1], self.scale[1])
        units[-1] = self.scale[0]
        return np.asarray(survey, np.float64) / units**2

    def errors(self, survey) -> tuple[float, float]:
        """Return the relative RMS error of the mosaic's electrons, predicted from a survey, overall and at its largest.

        The error is the one of `Response.error` for the moments over the same rows, or larger: R
        counts with its upper bound. It is 0 without a signal, and NaN if the content has NaN or
        squares beyond float32, so comparisons must fail for NaN. The second figure is of the pair
        of rows with the largest error, over the signal of all rows.

        Args:
            survey: Result of `spectral.survey`, shape (n, 3, P + 1).
        """
        found, signals = self._in_content_units(survey), len(self.flat)
        if not np.isfinite(found).all():
            return np.nan, np.nan
        signal = found[:, 0, :signals].sum() / len(found)
        if signal == 0:
            return 0.0, 0.0
        squares = found[:, 1:].sum(axis=1)
        each = squares[:, signals:-1].sum(axis=1) + self._rest(squares)
        return self.factor * sqrt(each.mean() / signal), self.factor * sqrt(each.max() / signal)

    def _rest(self, squares):
        """Upper bound of the part of R, of pairs of rows (n, P + 1)."""
        whole, along = squares[:, -1], squares[:, : len(self.flat)] @ self.seen
        across = np.maximum(whole - along, ROUNDING * whole)
        return np.fmin(
            self.left * whole,
            (self.beside[0] * np.sqrt(along) + self.beside[1] * np.sqrt(across)) ** 2,
        )

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
        values, across, down = self._in_content_units(survey).mean(0)
        signals, differences = len(self.flat), across + down
        allowed = (self.limit / self.factor) ** 2 * values[:signals].sum()
        return 1 + next(
            (
                more
                for more, fall in enumerate(self.falls)
                if fall @ differences[signals:-1] <= allowed
            ),
            len(self.falls),
        )


def wrong_moments(response: Response, table, transfers) -> np.ndarray:
    """Return M, shape (L, L): d M d^T is the mosaic's mean square error for neighbours that differ by d (L,)."""
    wrong = np.einsum("ckl,km->clm", transfers, table) - response.weights[:, :, None] * np.eye(
        table.shape[1]
    )
    return np.tensordot(
        wrong, response.share[:, None, None] * (response.optical @ wrong), ((0, 1), (0, 1))
    )


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

"""Whether a plan still fits: the error of its joint operator for another content, from a few projections of it.

`Response.error` takes the moments V of a content's spectra and D of their differences between neighbours, over all
pairs of wavelengths. With W_c the matrix of what channel c gets wrong, W_c[l, m] being the weight of O_l that
wavelength m gets too much, and G the response's `optical`, the error of the mosaic is

    sum over c of  share_c sum over l, m, n, o of  W_c[l, m] G[l, n] W_c[n, o] D[m, o]  =  trace(M D),
    M = sum over c of  share_c W_c^T G W_c,

and the signal trace(S V), S = sum over c of  share_c flat_c^T flat_c. A row b projects spectra x to b x, whose mean
square is b V b^T, and differences to b d, whose mean square is b D b^T. So S = F^T F and M = B^T B + R give

    signal = sum over rows f of F of  E[(f x)^2],     error = sum over rows b of B of  E[(b d)^2]  +  trace(R D),

where the few largest eigenvalues are nearly all of M. With P on the rows of F, which see most of natural spectra, and
Q = 1 - P, the root of trace(R D) is at most |R^1/2 P| that of E[|P d|^2], which F tells, and |R^1/2 Q| that of
E[|Q d|^2] = E[|d|^2] - E[|P d|^2]. The stage `spectral.survey` measures all of them on a device, without moments and in
one pass over a few rows.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from gpusim.domain.content import Content
from gpusim.optics.fusion import Response, Spectra, row_pairs

WRONG_ROWS, FEW = (
    8,
    5,
)  # of B: of 31 wavelengths the next eigenvalue is below 3e-5 of the largest up to so many planes
ALL_ROWS = 16  # of both, that `spectral.survey` takes: operators of more planes have all of them
SHORTEST = 1e-6  # of the longest row of F, below which one is none
ROUNDING = 1e-6  # of squares that are summed in float32
EXPONENT = 120  # of factors, which are powers of two that float32 holds
FLAT_ROWS = 8  # of F: all of them, for sensors of up to so many channels


@dataclass(frozen=True, eq=False)
class Watch:
    """What to measure of a content that takes a plan's input table, and what its error is by that.

    flat: F, shape (up to 8, L). wrong: B, shape (up to 15, L). left: largest eigenvalue of what B leaves of M, over the
    coefficients of content entries. table: projections from entries, those of `flat` first, float32 (P, entries), as
    `spectral.survey` takes it. seen: what the squares of the projections by `flat` give to |P d|^2, shape (up to 8,).
    beside: |R^1/2 P| and |R^1/2 Q|, over the coefficients, too. first: upper rows of the pairs to survey, int32 (n,).
    inputs: planes from spectra, which the plan's table gives from entries, shape (planes, L). factor: of the error, as
    probes of the plan's scene told it. falls: what of the square of each row of B one plane more leaves, two more ...,
    shape (up to 15,) each. scale: of the content and of its projections, as `spectral.survey` takes it.
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

    @classmethod
    def of(cls, response: Response, table, transfers, content: Content, shape=None) -> "Watch":
        """Of an operator, as `Response.error` takes it, and contents that differ from this one in their samples alone.

        table: planes from spectra, shape (planes, L). transfers: shape (C, planes, L). shape: rows and columns of the
        samples that are surveyed, by default all.
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
        """The same where the blur is left out, and the error of a content with these moments.

        What a channel gets wrong of a wavelength is then its transfer function less that of a flat field. shape: of the
        samples that are surveyed.
        """
        wrong = replace(response, tables=response.tables - response.tables[:, :1])
        channels, bands = response.weights.shape
        nothing = np.zeros((0, bands)), np.zeros((channels, 0, bands))
        return cls.of(wrong, *nothing, content, shape), wrong.error(*nothing, spectra)

    def scaled(self, content: Content) -> "Watch":
        """The same for a content in host memory and others up to 1e15 times as bright, whose squares float32 holds."""
        unit, of_table = (
            2.0 ** -float(np.clip(np.frexp(largest)[1], -EXPONENT, EXPONENT))
            for largest in (
                np.abs(content.planes).max(initial=0),
                np.abs(self.table).max(initial=0),
            )
        )
        return replace(self, scale=(unit, unit * of_table))

    def _unscaled(self, survey):
        """What `spectral.survey` gave, in the content's own units, float64."""
        units = np.full(np.shape(survey)[-1], self.scale[1])
        units[-1] = self.scale[0]
        return np.asarray(survey, np.float64) / units**2

    def errors(self, survey) -> tuple[float, float]:
        """Relative root mean square error of the mosaic's electrons, predicted from what `spectral.survey` gave.

        survey: shape (n, 3, P + 1). As `Response.error` gives it for the moments over the same rows, or larger: with
        the most that R can give; 0 without a signal. NaN where the content has NaN, or squares beyond float32: compare
        so that it fails. Then the same of the pair of rows where it is largest, over the signal of all.
        """
        found, signals = self._unscaled(survey), len(self.flat)
        if not np.isfinite(found).all():
            return np.nan, np.nan
        signal = found[:, 0, :signals].sum() / len(found)
        if signal == 0:
            return 0.0, 0.0
        squares = found[:, 1:].sum(axis=1)
        each = squares[:, signals:-1].sum(axis=1) + self._rest(squares)
        return self.factor * sqrt(each.mean() / signal), self.factor * sqrt(each.max() / signal)

    def _rest(self, squares):
        """What R gives at most, of pairs of rows (n, P + 1)."""
        whole, along = squares[:, -1], squares[:, : len(self.flat)] @ self.seen
        across = np.maximum(whole - along, ROUNDING * whole)
        return np.fmin(
            self.left * whole,
            (self.beside[0] * np.sqrt(along) + self.beside[1] * np.sqrt(across)) ** 2,
        )

    def falling(self, moments) -> tuple:
        """`falls` where operators of one plane more, two more ... have such moments M'.

        Of a row b of B it is b M' b^T / |b|^4: what M' makes of the direction of b, over what M does, |b|^2.
        """
        size = np.maximum(np.sum(self.wrong**2, axis=1), 1e-150)  # its square is no 0
        return tuple(
            np.einsum("pl,lm,pm->p", self.wrong, more, self.wrong) / size**2 for more in moments
        )

    def wanting(self, survey, limit: float) -> int:
        """How many planes more would err up to `limit` for a content; one more than `falls` tells where none of those.

        A guess, which the next survey checks: differences are taken as independent along the rows of B, and what these
        leave out is none.
        """
        values, across, down = self._unscaled(survey).mean(0)
        signals, differences = len(self.flat), across + down
        allowed = (limit / self.factor) ** 2 * values[:signals].sum()
        return 1 + next(
            (
                more
                for more, fall in enumerate(self.falls)
                if fall @ differences[signals:-1] <= allowed
            ),
            len(self.falls),
        )


def wrong_moments(response: Response, table, transfers) -> np.ndarray:
    """M, shape (L, L): d M d^T is the mosaic's mean square error where neighbouring pixels differ by d (L,)."""
    wrong = np.einsum("ckl,km->clm", transfers, table) - response.weights[:, :, None] * np.eye(
        table.shape[1]
    )
    return np.tensordot(
        wrong, response.share[:, None, None] * (response.optical @ wrong), ((0, 1), (0, 1))
    )


def _rows(moments, content, count):
    """Rows B (count, L) of most of positive moments M = H^T H, the largest eigenvalue that is left out, and the rest.

    The rest is of shape (L, entries), of coefficients.

    The rows are those of most of what entries give, the columns of H E^T, E their spectra. What is left out of them,
    H E^T - Q Q^T H E^T with Q the largest eigenvectors of their products, has a largest eigenvalue over all mixes of
    entries. A sample of one entry, its spectrum e, differs by a e - b e' from its neighbour, so that twice the largest
    square of a column bounds it, too.
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

"""A plan's error for another content by projections of it, against the error by all moments."""

from dataclasses import replace

import numpy as np
import pytest
from test_fusion import made_for

from gpusim.data.reflectances import reflectances
from gpusim.domain.content import Basis, Cube, Materials
from gpusim.judge.hard.planner import library, response_of
from gpusim.judge.hard.scenes import CAMERA, WAVELENGTHS, natural
from gpusim.kernels.spectral.survey_ref import survey
from gpusim.optics.fusion import (
    Spectra,
    Watch,
    channel_operator,
    joint_operator,
    row_pairs,
    wrong_moments,
)
from gpusim.planner.knobs.spectral import PRIOR

LIKELY = np.vstack([reflectances(name).at(WAVELENGTHS, outside=None) for name in PRIOR])
BASIS = np.linalg.svd(LIKELY, full_matrices=False)[2]


@pytest.fixture(scope="module")
def response():
    return response_of(made_for(natural((32, 24)), CAMERA))


def operators(response):
    """Input tables and transfers: of ranks 3 to 6, and of two planes a channel."""
    operator = joint_operator(response, library())
    for rank in (3, 4, 5, 6):
        yield operator.w_in[:, :rank].T, operator.transfers(rank)
    guaranteed = channel_operator(response, 2)
    yield guaranteed.table, guaranteed.transfers


def monochromatic(shape, random):
    values = np.zeros((31, *shape), np.float32)
    np.put_along_axis(values, random.integers(0, 31, (1, *shape)), 1.0, axis=0)
    return Cube(WAVELENGTHS, values)


def contents():
    """All forms: likely spectra and unlikely ones, one row or column or pixel, more rows than are looked at."""
    random = np.random.default_rng(4)
    yield natural((96, 64)).content
    yield monochromatic((64, 96), random)
    for shape in ((1, 1), (1, 50), (50, 1), (2, 2)):
        yield Cube(WAVELENGTHS, random.random((31, *shape), np.float32))
    for count in (3, 12):
        coefficients = (
            random.normal(0, 1, (count, 600, 100)) * np.exp(-np.arange(count))[:, None, None]
        )
        coefficients[0] += 5  # the others are of either sign
        yield Basis(WAVELENGTHS, coefficients.astype(np.float32), BASIS[:count])
    for spectra in (LIKELY[:200], random.random((4, 31)), np.eye(31)):
        shading = (10.0 ** random.uniform(-2, 1, (40, 70))).astype(np.float32)
        yield Materials(
            WAVELENGTHS,
            random.integers(0, len(spectra), (40, 70)).astype(np.uint16),
            shading,
            spectra,
        )


def surveyed(watch, content):
    """By the rows in float64, which the table has rounded."""
    exact = np.vstack([watch.flat, watch.wrong]) @ content.entry_spectra.T
    np.testing.assert_allclose(watch.table, exact, rtol=2.0**-24)  # half an ulp
    return survey(content.planes, exact, watch.first, content.labels)


def spectra_by_hand(content):
    """`Spectra.of`, in float64 and of the spectra themselves."""
    rows, cols = content.shape
    first = row_pairs(rows, cols)
    upper, lower = content.bands_at(first), content.bands_at(np.minimum(first + 1, rows - 1))
    values, down, across = (
        np.einsum("lyx,myx->lm", part, part) / max(part[0].size, 1)
        for part in (upper, lower - upper, np.diff(upper, axis=2))
    )
    return Spectra(values, down + across)


def test_moments_are_those_of_the_spectra():
    """To float64's rounding; of cubes to that of float32 sums of a row, relative to the magnitudes of its terms."""
    for content in contents():
        own, exact = Spectra.of(content), spectra_by_hand(content)
        allowed = content.shape[1] * 2.0**-24 if content.is_spectral else 1e-12
        for name in ("values", "differences"):
            wanted = getattr(exact, name)
            terms = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
            assert (np.abs(getattr(own, name) - wanted) <= allowed * terms).all()


def moments_by_hand(response, table, transfers):
    """M, channel by channel: W_c = sum over k of transfers_ck table_k^T - diag(weights_c), M = sum share W^T G W."""
    total = 0
    for weights, share, own in zip(response.weights, response.share, transfers, strict=True):
        wrong = sum(
            np.outer(transfer, row) for transfer, row in zip(own, table, strict=True)
        ) - np.diag(weights)
        total = total + share * wrong.T @ response.optical @ wrong
    return total


def rounding_of(response, table, transfers, moments):
    """How far float64 may take any element of M and what is made of it, relative to differences of length 1.

    W is a difference of terms of the magnitudes A. Sums of 31 round it by less than 31 x 2^-52 A, and W^T G W, by
    Cauchy's inequality, by twice the root of trace(W^T G W) trace(A^T |G| A) times that; its eigenvectors as much.
    """
    magnitude = 0.0
    for weights, share, own in zip(response.weights, response.share, transfers, strict=True):
        terms = np.abs(own).T @ np.abs(table) + np.diag(np.abs(weights))
        magnitude += share * np.sum(terms * (np.abs(response.optical) @ terms))
    return 4 * 31 * 2.0**-52 * np.sqrt(np.trace(moments) * magnitude)


def test_the_moments_give_the_error(response):
    own = Spectra.of(natural((96, 64)).content)
    signal = response.share @ np.einsum("cl,lm,cm->c", response.flat, own.values, response.flat)
    for table, transfers in operators(response):
        moments = wrong_moments(response, table, transfers)
        by_hand = moments_by_hand(response, table, transfers)
        rounding = rounding_of(response, table, transfers, by_hand)
        np.testing.assert_allclose(moments, by_hand, atol=rounding, rtol=0)
        error = response.error(table, transfers, own) ** 2
        assert np.sum(moments * own.differences) / signal == pytest.approx(
            error, abs=rounding * np.trace(own.differences) / signal
        )


def test_projections_give_the_error_of_all_moments(response):
    """Their squares are equal but for what the rows leave out, which is found by itself and kept within its bound."""
    for table, transfers in operators(response):
        moments = moments_by_hand(response, table, transfers)
        for content in contents():
            watch, own = Watch.of(response, table, transfers, content), spectra_by_hand(content)
            numbers = surveyed(watch, content)
            signal = response.share @ np.einsum(
                "cl,lm,cm->c", response.flat, own.values, response.flat
            )
            exact = response.error(table, transfers, own) ** 2
            rest = np.sum((moments - watch.wrong.T @ watch.wrong) * own.differences) / signal
            allowed = watch.left * numbers.mean(0)[1:, -1].sum() / signal
            rounding = (
                rounding_of(response, table, transfers, moments)
                * np.trace(own.differences)
                / signal
            )
            without = replace(watch, left=0.0).errors(numbers)[0]
            assert without**2 + rest == pytest.approx(exact, rel=1e-9, abs=rounding)
            assert -rounding <= rest <= allowed + rounding
            told = watch.errors(numbers)[0] ** 2
            assert (
                exact * (1 - 1e-9) - rounding
                <= told
                <= (exact - rest + allowed) * (1 + 1e-9) + rounding
            )


def test_the_rows_are_of_the_largest_eigenvalues(response):
    content = natural((32, 24)).content
    for table, transfers in operators(response):
        watch = Watch.of(response, table, transfers, content)
        eigenvalues = np.linalg.eigvalsh(moments_by_hand(response, table, transfers))[::-1]
        count = 8 if len(table) <= 5 else 13
        assert watch.wrong.shape == (count, 31) and watch.flat.shape == (3, 31)
        np.testing.assert_allclose((watch.wrong**2).sum(1), eigenvalues[:count], rtol=1e-6)
        assert watch.left == pytest.approx(eigenvalues[count], rel=1e-6)


def test_a_basis_of_few_coefficients_leaves_nothing_out(response):
    content = Basis(WAVELENGTHS, np.ones((8, 2, 2), np.float32), BASIS[:8])
    for table, transfers in operators(response):
        largest = np.linalg.eigvalsh(
            BASIS[:8] @ wrong_moments(response, table, transfers) @ BASIS[:8].T
        )[-1]
        assert Watch.of(response, table, transfers, content).left <= 1e-12 * largest


def test_what_is_left_out_costs_little(response):
    """Below 1 % of the error of likely spectra at ranks 3 to 5, so that a watched plan stays as long as it could.

    At higher ones it is the bound of the rest that costs.
    """
    content, operator = natural((96, 64)).content, joint_operator(response, library())
    for rank, most in ((3, 1.01), (4, 1.01), (5, 1.01), (6, 1.05), (7, 1.2)):
        table, transfers = operator.w_in[:, :rank].T, operator.transfers(rank)
        watch = Watch.of(response, table, transfers, content)
        exact, told = (
            response.error(table, transfers, Spectra.of(content)),
            watch.errors(surveyed(watch, content))[0],
        )
        print(f"rank {rank}: {exact:.2e}, told {told / exact:.3f} times that")
        assert exact <= told <= most * exact


def test_unlikely_spectra_are_seen(response):
    """The plan of a natural scene, then single wavelengths: the error is that of those, many times larger."""
    content, wild = natural((96, 64)).content, monochromatic((64, 96), np.random.default_rng(5))
    for table, transfers in list(operators(response))[:4]:
        watch = Watch.of(response, table, transfers, content)
        before, after = (watch.errors(surveyed(watch, seen))[0] for seen in (content, wild))
        assert after > 20 * before
        assert after == pytest.approx(response.error(table, transfers, Spectra.of(wild)), rel=0.1)


def test_many_channels_are_never_seen_too_bright(response):
    """Of ten channels the signal is that of eight rows: at most the whole one, and nearly it where they resemble."""
    random = np.random.default_rng(6)
    weights = np.vstack([response.weights] * 4)[:10] * random.uniform(0.5, 1.5, (10, 31))
    flat = weights * np.real(response.tables[:, 0])
    many = replace(response, weights=weights, flat=flat, share=np.full(10, 0.1))
    operator = joint_operator(many, library())
    table, transfers = operator.w_in[:, :10].T, operator.transfers(10)
    content = natural((96, 64)).content
    watch = Watch.of(many, table, transfers, content)
    assert watch.table.shape == (16, 31)
    kept = replace(watch, left=0.0).errors(surveyed(watch, content))[0]
    exact = many.error(table, transfers, Spectra.of(content))
    rest = np.sum(
        (wrong_moments(many, table, transfers) - watch.wrong.T @ watch.wrong)
        * Spectra.of(content).differences
    )
    signal = many.share @ np.einsum("cl,lm,cm->c", flat, Spectra.of(content).values, flat)
    assert np.sqrt(exact**2 - rest / signal) * (1 - 1e-6) <= kept <= 1.01 * exact


def test_the_steepest_rows_are_those_of_the_largest_error(response):
    """Pair by pair of rows: each one's own relative error times its own signal, over that of all."""
    for table, transfers in operators(response):
        for content in contents():
            watch = replace(Watch.of(response, table, transfers, content), factor=1.3)
            numbers = surveyed(watch, content)
            signals = numbers[:, 0, : len(watch.flat)].sum(1)
            squares = [
                watch.errors(numbers[[k]])[0] ** 2 * signal for k, signal in enumerate(signals)
            ]
            assert watch.errors(numbers)[1] == pytest.approx(
                np.sqrt(max(squares) / signals.mean()), rel=1e-9
            )
            assert watch.errors(numbers)[0] == pytest.approx(
                np.sqrt(np.mean(squares) / signals.mean()), rel=1e-9
            )


def test_a_blur_that_is_left_out_is_watched(response):
    """Every channel then errs sum over l of weights_cl (O_l(f) - O_l(0)) x_l(f): summed frequency by frequency."""
    for content in list(contents())[:6]:
        own = Spectra.of(content)
        watch, expected = Watch.of_no_blur(response, content, content.shape, own)
        total = 0.0
        for weights, share in zip(response.weights, response.share, strict=True):
            for power, column in zip(response.power, response.tables.T, strict=True):
                row = weights * (column - response.tables[:, 0])
                total += share * power * np.real(row.conj() @ own.differences @ row)
        signal = response.share @ np.einsum("cl,lm,cm->c", response.flat, own.values, response.flat)
        assert expected == pytest.approx(np.sqrt(total / signal), rel=1e-9)
        assert expected * (1 - 1e-9) <= watch.errors(surveyed(watch, content))[0] <= 1.01 * expected
        assert len(watch.inputs) == 0


def test_how_many_more_planes_a_content_takes_is_told_to_a_plane(response):
    """By a survey with three planes, against the error of every rank by all moments.

    Down to a twentieth of it; below that most of the error may be what the rows leave out.
    """
    operator, contents = (
        joint_operator(response, library()),
        (
            natural((96, 64)).content,
            monochromatic((64, 96), np.random.default_rng(5)),
            Cube(
                WAVELENGTHS,
                np.where(np.arange(31)[:, None, None] == 24, natural((96, 64)).content.values, 0),
            ),
        ),
    )
    table, transfers = operator.w_in[:, :3].T, operator.transfers(3)
    more = range(4, 12)
    for content in contents:
        watch, own = Watch.of(response, table, transfers, content), Spectra.of(content)
        falls = watch.forecast_falls(
            wrong_moments(response, operator.w_in[:, :k].T, operator.transfers(k)) for k in more
        )
        watch, numbers = replace(watch, falls=falls), surveyed(watch, content)
        errors = [response.error(operator.w_in[:, :k].T, operator.transfers(k), own) for k in more]
        for limit in np.geomspace(max(errors) / 20, max(errors), 7):
            wanted = 1 + sum(error > limit for error in errors)
            found = replace(watch, limit=limit).count_missing_planes(numbers)
            assert abs(found - wanted) <= 1
    assert replace(watch, falls=(), limit=1e-3).count_missing_planes(numbers) == 1


def test_darkness_and_nan(response):
    table, transfers = next(operators(response))
    dark = Cube(WAVELENGTHS, np.zeros((31, 4, 5), np.float32))
    watch = Watch.of(response, table, transfers, dark)
    assert watch.errors(surveyed(watch, dark))[0] == 0.0
    values = np.ones((31, 4, 5), np.float32)
    values[7, 2, 2] = np.nan
    assert np.isnan(watch.errors(surveyed(watch, Cube(WAVELENGTHS, values)))[0])


@pytest.mark.parametrize(
    ("shape", "wanted"),
    [
        ((1, 1), [0]),
        ((2, 7), [0]),
        ((5, 9), [0, 1, 2, 3]),
        ((1080, 1920), np.arange(17) * 1078 // 16),
        ((2, 10**6), [0]),
        ((100, 10**6), np.arange(8) * 98 // 7),
    ],
)
def test_row_pairs_are_spread_over_the_frame(shape, wanted):
    """All pairs of a small frame; else 2^15 pixels of upper rows, at least 8 pairs, the last two rows among them."""
    assert row_pairs(*shape).tolist() == list(wanted)


def test_what_is_not_wrong_does_not_fall(response):
    """A row of no error: more planes make nothing of nothing."""
    table, transfers = next(operators(response))
    watch = Watch.of(response, table, transfers, natural((96, 64)).content, (96, 64))
    exact = replace(watch, wrong=np.zeros_like(watch.wrong))
    with np.errstate(all="raise"):
        assert not np.any(exact.forecast_falls([np.eye(watch.wrong.shape[1])]))

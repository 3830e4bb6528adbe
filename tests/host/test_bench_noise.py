"""Statistics of compared benchmarks under known noise: false alarms, planted slowdowns, margins.

Slowdowns are planted, so the truth is known. Rates are binomial: each test states how likely it would
fail if the rate were the promised one.
"""

import numpy as np
import pytest

from gpusim.bench.noise import PERCENTILES, judge, moderate

LEVELS = len(PERCENTILES)
TABLES = 40  # of a simulation; a rate of 1 % gives more than 3 alarms with a probability of 0.1 %


def quiet(rng, rows, rounds):
    """Rounds of rows whose spreads differ, 0.3 to 2 %, and 1 % that all rows of a round share."""
    spread = 0.006 * np.exp(0.6 * rng.standard_normal(rows))
    return spread[:, None] * rng.standard_normal(
        (LEVELS, rows, rounds)
    ) + 0.01 * rng.standard_normal(rounds)


def bursts(rng, rows, rounds):
    """Quiet rounds, and other programs that slow 10 % of the time, eight rows in a sequence, by up to 2.2."""
    starts = np.flatnonzero(rng.random(rounds * rows) < 0.1 / 8)
    slow = np.zeros(rounds * rows)
    for start in starts:
        slow[start : start + rng.geometric(1 / 8)] = np.log(rng.uniform(1.1, 2.2))
    hit = (
        rng.random((rows, rounds)) < np.array([0.15, 0.4, 0.7])[:, None, None]
    )  # least, percentile, median
    return quiet(rng, rows, rounds) + hit * slow.reshape(rounds, rows).T


def flips(rng, rows, rounds):
    """Quiet rounds, and 10 % of rounds in which a second core is free: 1.8 times faster."""
    share = np.minimum(0.1 * rng.gamma(1, 1, rows), 0.6)[:, None]
    fast = -0.6 * (rng.random((rows, rounds)) < share)
    return quiet(rng, rows, rounds) + fast * (rng.random((rows, rounds)) < 0.8)


def heavy(rng, rows, rounds):
    """Noise with Student's t of 3 degrees of freedom."""
    return quiet(rng, rows, rounds) + 0.01 * rng.standard_t(3, (rows, rounds))


def loaded(rng, rows, rounds):
    """A load in 40 % of rounds, that slows all rows, each by another factor."""
    load = 0.3 * rng.random(rounds) * (rng.random(rounds) < 0.4)
    return quiet(rng, rows, rounds) + rng.uniform(0.3, 1.7, rows)[:, None] * load


def sides(noise, rng, rows, rounds):
    """Two sides in turns, with nothing changed."""
    logs = noise(rng, rows, 2 * rounds)
    return logs[:, :, ::2], logs[:, :, 1::2]


@pytest.mark.parametrize("rounds", (3, 8))
@pytest.mark.parametrize("noise", (quiet, bursts, flips, heavy, loaded))
def test_false_alarms_are_rarer_than_one_table_in_twenty(noise, rounds):
    """At the promised rate of 1 %, more than 3 of 40 tables have a probability of 0.1 %."""
    rng = np.random.default_rng(rounds)
    found = [judge(*sides(noise, rng, 60, rounds)) for _ in range(TABLES)]
    assert sum(any(row.sign for row in each.rows) for each in found) <= 3
    assert sum(each.common.sign != 0 for each in found) <= 3


@pytest.mark.slow
@pytest.mark.parametrize("rounds", (3, 5, 8, 10))
@pytest.mark.parametrize("noise", (quiet, bursts, flips, heavy, loaded))
def test_false_alarms_of_many_tables(noise, rounds):
    """1 in 20 is the limit: more than 15 of 300 would be beyond it."""
    rng = np.random.default_rng(100 + rounds)
    found = [judge(*sides(noise, rng, 100, rounds)) for _ in range(300)]
    alarms = sum(each.common.sign != 0 or any(row.sign for row in each.rows) for each in found)
    assert alarms <= 15


@pytest.mark.parametrize("rounds", (3, 5))
@pytest.mark.parametrize("noise", (quiet, bursts, flips))
@pytest.mark.parametrize("slowdown", (0.05, 0.1))
def test_a_slowdown_is_found_or_declared_invisible(noise, rounds, slowdown):
    """The promise is 90 %; fewer than 31 of 40 have a probability of 0.5 %."""
    rng = np.random.default_rng(1)
    kept = 0
    for _ in range(TABLES):
        base, other = sides(noise, rng, 60, rounds)
        other[:, 7] += np.log1p(slowdown)
        row = judge(base, other).rows[7]
        kept += row.sign == 1 or row.visible > np.log1p(slowdown)
    assert kept >= 31


@pytest.mark.parametrize("rounds", (3, 5))
@pytest.mark.parametrize("noise", (quiet, bursts, heavy))
def test_the_least_visible_slowdown_is_found(noise, rounds):
    """With a probability of 90 %: fewer than 46 of 60 have one of 0.1 %."""
    rng = np.random.default_rng(40 + rounds)
    found = 0
    for _ in range(12):
        base, other = sides(noise, rng, 60, rounds)
        rows = judge(base, other).rows
        for place in range(0, 60, 12):
            slower = other.copy()
            slower[:, place] += rows[place].visible
            found += judge(base, slower).rows[place].sign == 1
    assert found >= 46


def test_ten_percent_is_found_on_a_quiet_machine():
    """Rows of 0.5 % spread and five rounds: 50 of 50, and nothing else."""
    for seed in range(50):
        base, other = (
            0.005 * np.random.default_rng((seed, side)).standard_normal((LEVELS, 60, 5))
            for side in range(2)
        )
        other[:, 3] += np.log(1.1)
        found = judge(base, other)
        assert [row.sign for row in found.rows] == [0, 0, 0, 1] + [0] * 56, seed
        assert found.common.sign == 0


def test_margins_are_those_of_the_t_distribution_for_a_single_row():
    """One row has nothing to share: Student's t, by its formula, from the differences of pairs."""
    from scipy.stats import t

    base = np.zeros((LEVELS, 1, 5))
    other = np.array([0.1, 0.12, 0.09, 0.11, 0.13]) + np.zeros((LEVELS, 1, 1))
    found = judge(base, other).rows[0]
    error = np.std([0.1, 0.12, 0.09, 0.11, 0.13], ddof=1) / np.sqrt(5)
    assert found.change == pytest.approx(0.11)
    assert found.margin == pytest.approx(error * t.isf(0.0025, 4))
    assert found.sign == 1


def test_variances_of_one_distribution_are_pooled_and_others_are_not():
    """True variances: all 4, and log-normal. The prior's scale is theirs, and its weight differs."""
    rng = np.random.default_rng(3)
    chi = rng.chisquare(2, (2, 4000)) / 2
    pooled, freedom = moderate(4 * chi[0], 2)
    assert freedom > 40 and np.all(abs(np.log(pooled[chi[0] < 5] / 4)) < 0.3)
    true = np.exp(2 * rng.standard_normal(4000))
    shared, freedom = moderate(true * chi[1], 2)
    assert 2 < freedom < 4  # d0 of 1: the variance of the logs is 4, trigamma(0.5) is 4.9
    error = [np.std(np.log(each / true)) for each in (shared, true * chi[1])]
    assert error[0] < error[1]


def test_drift_of_the_machine_is_no_change_of_a_row():
    """The second side ran under a load of 8 % that changes by as much, and one row is slower."""
    rng = np.random.default_rng(6)
    base, other = sides(quiet, rng, 60, 5)
    other += 0.08 + 0.08 * rng.standard_normal(5)
    other[:, 2] += 0.2
    found = judge(base, other)
    assert found.common.sign == 0 and 0.03 < found.common.change < 0.2
    assert [row.sign for row in found.rows] == [0, 0, 1] + [0] * 57


def test_all_rows_slower_is_a_line_of_its_own():
    base, other = sides(quiet, np.random.default_rng(6), 60, 8)
    found = judge(base, other + np.log(1.2))
    assert found.common.sign == 1 and found.common.change == pytest.approx(np.log(1.2), abs=0.02)
    assert all(row.sign == 1 for row in found.rows)


def test_rows_that_stay_are_not_faster_when_most_get_slower():
    base, other = sides(quiet, np.random.default_rng(7), 60, 5)
    other[:, 20:] += 0.15
    assert all(row.sign == 0 for row in judge(base, other).rows[:20])


def test_blocks_hide_what_differs_between_processes():
    """Each process has a level for each row, twice the spread of its rounds; nothing changed."""
    alarms = 0
    for seed in range(TABLES):
        rng = np.random.default_rng((8, seed))
        level = 0.01 * rng.standard_normal((2, 60, 1))
        base, other = (each + 0.005 * rng.standard_normal((LEVELS, 60, 3)) for each in level)
        rows = judge(base, other, alternate=False).rows
        alarms += any(row.sign for row in rows)
        assert rows[0].visible > 0.05
    assert alarms <= 3

"""Statistics of scores, against SciPy and against samples whose truth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import trim_mean

from uwoc_gym.agents.reports import statistics

SCORES = st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=40)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=10))
def test_interquartile_mean_is_scipys_where_quarters_are_whole(values):
    scores = np.repeat(values, 4)
    assert statistics.interquartile_mean(scores) == pytest.approx(trim_mean(scores, 0.25), abs=1e-9)


@given(SCORES)
def test_interquartile_mean_lies_between_the_extremes_and_ignores_outliers(values):
    found = statistics.interquartile_mean(values)
    assert min(values) - 1e-9 <= found <= max(values) + 1e-9
    four = statistics.interquartile_mean([0.0, 1.0, 2.0, 1e9])
    assert four == pytest.approx(1.5)


def test_worst_share_and_improvement():
    assert statistics.worst_share(np.arange(100.0)) == 2.0
    assert statistics.worst_share([3.0, 1.0]) == 1.0
    assert statistics.improvement([1.0, -1.0, 0.0, 2.0]) == 0.625


def test_interval_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    hits = 0
    for _ in range(100):
        rows, columns = rng.normal(0, 1, (12, 1)), rng.normal(0, 1, (1, 60))
        found = statistics.estimate(5.0 + rows + columns, statistics.mean, rng)
        hits += found.low <= 5.0 <= found.high
    assert 82 <= hits <= 99


def test_interval_grows_with_unlike_trainings():
    rng = np.random.default_rng(1)
    noise = rng.normal(0, 1, (8, 100))
    alike = statistics.estimate(noise, statistics.mean, rng)
    unlike = statistics.estimate(noise + 3.0 * np.arange(8)[:, None], statistics.mean, rng)
    assert unlike.high - unlike.low > 5.0 * (alike.high - alike.low)


def test_one_row_one_score_and_equal_scores():
    rng = np.random.default_rng(2)
    row = statistics.estimate([1.0, 2.0, 4.0], statistics.mean, rng)
    assert row.low < row.value < row.high
    assert np.isnan(statistics.estimate([[7.0]], statistics.mean, rng).low)
    assert statistics.estimate(np.full((3, 4), 2.0), statistics.mean, rng) == (2.0, 2.0, 2.0)


def test_interval_is_that_of_percentiles():
    # Ten times the mean of a resample is binomial, of ten trials of one in ten: its 2.5 and 97.5 % quantiles are 0, 3.
    found = statistics.estimate([0.0] * 9 + [10.0], statistics.mean, np.random.default_rng(4))
    assert found == (1.0, 0.0, 3.0)


def test_same_generator_gives_the_same_interval():
    scores = np.random.default_rng(3).normal(size=(4, 20))
    twice = [statistics.estimate(scores, statistics.interquartile_mean, np.random.default_rng(5)) for _ in range(2)]
    assert twice[0] == twice[1]


NEVER = np.array([[1.0, 3.0, np.inf, np.nan], [2.0, 6.0, np.nan, np.inf]])


def test_never_is_counted_beside_the_mean_and_what_does_not_apply_is_not():
    rng = np.random.default_rng(0)
    restoring = statistics.summarise(NEVER, rng)
    assert restoring.mean == 3.0
    assert (restoring.values, restoring.never, restoring.episodes) == (4, 2, 8)
    assert restoring.low < 3.0 < restoring.high
    arrival = statistics.summarise([4.0, np.nan, np.nan, 2.0], rng, nan_is_never=True)
    assert arrival.mean == 3.0
    assert (arrival.values, arrival.never, arrival.episodes) == (2, 2, 4)


@pytest.mark.parametrize(
    ("values", "nan_is_never", "expected"),
    [
        ([0.5, 0.5], False, "0.50"),
        ([0.5, np.inf, 0.5, 0.5], False, "0.50 (1 of 4 never)"),
        ([0.5, np.nan, 0.5], True, "0.50 (1 of 3 never)"),
        ([0.5, np.nan, 0.5], False, "0.50 (2 of 3)"),
        ([0.5, np.nan, np.inf, 0.5], False, "0.50 (3 of 4, 1 of them never)"),
        ([np.inf, np.inf], False, "never"),
        ([np.inf, np.nan, np.nan], False, "never (1 of 3)"),
        ([np.nan], True, "never"),
        ([np.nan, np.nan], False, "–"),
        ([[0.5, np.inf], [0.5, 0.5]], False, "0.50 (1 of 4 never)"),
    ],
)
def test_a_table_tells_never_from_not_applying(values, nan_is_never, expected):
    found = statistics.summarise(values, np.random.default_rng(0), nan_is_never)
    assert statistics.text(found._asdict(), 2) == expected


def test_a_table_shows_the_interval():
    assert statistics.text({"value": 1.234, "low": 1.0, "high": 2.0}, 1) == "1.2 [1.0, 2.0]"
    assert statistics.text({"value": None, "low": None, "high": None}, 1) == "–"
    found = statistics.text(statistics.summarise([1.0, 3.0, np.inf], np.random.default_rng(0))._asdict(), 0)
    assert found == "2 [1, 3] (1 of 3 never)"


@pytest.mark.parametrize(
    "values", [[3.0], [np.nan, 3.0, np.inf], []], ids=["one episode", "one value among others", "no episode"]
)
def test_a_single_value_has_no_interval(values):
    found = statistics.summarise(values, np.random.default_rng(0))
    assert np.isnan([found.low, found.high]).all()
    assert found.mean == 3.0 or not values


def test_intervals_hold_the_mean_of_the_values():
    values = np.random.default_rng(0).normal(5.0, 1.0, 30)
    found = statistics.summarise([*values, np.nan, np.inf], np.random.default_rng(1))
    assert found.low < found.mean < found.high
    assert found.mean == pytest.approx(values.mean())


def test_profile_falls_from_one_to_nothing():
    assert statistics.profile([1.0, 2.0, 3.0], [0.0, 1.5, 3.0]).tolist() == [1.0, pytest.approx(2 / 3), 0.0]


def test_the_median_is_the_middle_one() -> None:
    assert statistics.median([5.0, 1.0, 2.0]) == 2.0
    assert statistics.median([[5.0, 1.0], [0.0, 8.0]]).tolist() == [3.0, 4.0]


def test_the_share_of_the_way_is_that_of_the_means() -> None:
    rng = np.random.default_rng(1)
    start = rng.normal(100.0, 20.0, 400)
    end = start + rng.normal(50.0, 5.0, 400)
    scores = start + rng.normal(20.0, 10.0, 400)
    found = statistics.share_of_the_way(scores, start, end, np.random.default_rng(0))
    assert found.value == pytest.approx((scores.mean() - start.mean()) / (end.mean() - start.mean()))
    # The same episodes are drawn for all three, whose own spread is far greater than that of their differences.
    ratios = []
    for _ in range(2000):
        places = rng.integers(0, 400, 400)
        base = start[places].mean()
        ratios.append((scores[places].mean() - base) / (end[places].mean() - base))
    assert [found.low, found.high] == pytest.approx(np.percentile(ratios, [2.5, 97.5]), abs=0.003)
    for same, share in ((start, 0.0), (end, 1.0)):
        own = statistics.share_of_the_way(same, start, end, np.random.default_rng(0))
        assert list(own) == pytest.approx([share] * 3, abs=1e-12)


def test_the_share_of_the_way_over_trainings_takes_the_episodes_of_each() -> None:
    start, end = np.array([0.0, 10.0, 20.0]), np.array([10.0, 30.0, 50.0])
    scores = np.array([[0.0, 10.0, 20.0], [10.0, 30.0, 50.0]])
    found = statistics.share_of_the_way(scores, start, end, np.random.default_rng(0))
    assert found.value == pytest.approx(0.5)
    assert (found.low, found.high) == pytest.approx((0.0, 1.0))


def test_there_is_no_way_to_what_is_not_ahead() -> None:
    found = statistics.share_of_the_way([1.0, 2.0], [3.0, 4.0], [3.0, 2.0], np.random.default_rng(0))
    assert all(map(math.isnan, found))
    one = statistics.share_of_the_way([1.5], [1.0], [2.0], np.random.default_rng(0))
    assert one.value == 0.5
    assert math.isnan(one.low)

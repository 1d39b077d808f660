"""Measures of hand-made series whose answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from uwoc_gym import metrics

TIME = np.arange(9) * 0.5


def _lanes(*texts: str) -> np.ndarray:
    """Lanes written as strings, 1 for inside the cone."""
    return np.array([[char == "1" for char in text] for text in texts]).T


def test_arrival_is_the_first_sample_inside() -> None:
    inside = _lanes("000110111", "111111111", "000000000")
    assert metrics.arrival_time_s(TIME, inside) == pytest.approx([1.5, 0.0, np.nan], nan_ok=True)


def test_establishment_is_the_start_of_the_last_stay() -> None:
    inside = _lanes("000110111", "111111111", "011111110")
    assert metrics.establishment_time_s(TIME, inside) == pytest.approx([3.0, 0.0, np.nan], nan_ok=True)


def test_samples_after_an_early_end_do_not_count() -> None:
    inside, valid = _lanes("001100000", "000000111"), _lanes("111100000", "111110000")
    assert metrics.arrival_time_s(TIME, inside, valid) == pytest.approx([1.0, np.nan], nan_ok=True)
    assert metrics.establishment_time_s(TIME, inside, valid) == pytest.approx([1.0, np.nan], nan_ok=True)


@pytest.mark.parametrize(
    ("lane", "disturbance", "expected"),
    [
        ("011111111", 1.0, 0.0),  # no outage
        ("011100111", 1.0, 1.0),
        ("011101011", 1.0, 1.5),  # back, out again, back for good
        ("011111000", 1.0, np.inf),
        ("000111111", 1.0, np.nan),  # nothing to lose when it began
        ("011100111", np.nan, np.nan),
        ("011100111", 9.0, np.nan),
    ],
)
def test_restoring_time(lane: str, disturbance: float, expected: float) -> None:
    assert metrics.restoring_time_s(TIME, _lanes(lane), disturbance) == pytest.approx([expected], nan_ok=True)


def test_restoring_time_takes_a_disturbance_for_each_lane() -> None:
    result = metrics.restoring_time_s(TIME, _lanes("011100111", "011100111"), np.array([1.0, 3.0]))
    assert result == pytest.approx([1.0, 0.0])


def test_tracking_error_wraps_yaw() -> None:
    error = metrics.tracking_error([1.0, 2.0, 3.0], [4.0, 4.0, -3.0])
    assert error == pytest.approx([3.0, 2.0, 2.0 * np.pi - 6.0])


def test_rmse_counts_from_arrival_on() -> None:
    error = np.zeros((4, 1, 3))
    error[:, 0, 0] = [100.0, 3.0, 4.0, 0.0]
    counted = metrics.since_arrival(_lanes("0100"))
    assert metrics.rmse(error, counted)[0] == pytest.approx([np.sqrt(25.0 / 3.0), 0.0, 0.0])
    assert np.isnan(metrics.rmse(error, metrics.since_arrival(_lanes("0000")))).all()


def test_availability_counts_what_was_not_flown_as_outside() -> None:
    assert metrics.availability(_lanes("1111", "0110"), _lanes("1110", "1111")) == pytest.approx([2 / 3, 2 / 3])


def test_bit_rate_and_data() -> None:
    rate = np.array([[1e9], [1e7], [0.0], [1e9]])
    assert metrics.mean_log10_bit_rate(rate) == pytest.approx([25 / 3])
    assert np.isnan(metrics.mean_log10_bit_rate(np.zeros((4, 1)))).all()
    inside = _lanes("1001")
    assert metrics.delivered_gbit(TIME[:4], rate, inside) == pytest.approx([0.5])


def test_effort_is_one_at_the_limits() -> None:
    limits = np.array([2000.0, 2000.0, 500.0])
    force = np.stack([[limits, limits], [-limits, 0.0 * limits]], axis=0)
    assert metrics.effort(force, limits) == pytest.approx([1.0, np.sqrt(0.5)])
    assert metrics.effort(force, limits, _lanes("111", "110")) == pytest.approx([1.0, 1.0])
    without_sway = limits * [1.0, 0.0, 1.0]
    assert metrics.effort(force * [1.0, 0.0, 1.0], without_sway) == pytest.approx([1.0, np.sqrt(0.5)])
    assert metrics.effort(0.0 * force, 0.0 * limits) == pytest.approx([0.0, 0.0])


def test_establishment_ignores_what_a_disturbance_does() -> None:
    inside = _lanes("011100111", "011100111")
    samples, lanes = inside.shape
    record = metrics.EpisodeRecord(
        time_s=TIME,
        in_cone=inside,
        pose=np.zeros((samples, lanes, 3)),
        ship_pose=np.zeros((samples, lanes, 3)),
        bit_rate_bps=np.ones((samples, lanes)),
        force=np.zeros((samples - 1, lanes, 3)),
        reward=np.zeros((samples - 1, lanes)),
        valid=np.ones((samples, lanes), dtype=bool),
        lost=np.zeros(lanes, dtype=bool),
        disturbance_s=np.array([1.5, np.nan]),
        force_limits=np.ones(3),
    )
    assert metrics.episode_metrics(record).establishment_time_s == pytest.approx([0.5, 3.0])


def _parts(lane: str, pulses: list[tuple[float, float]], valid: str | None = None) -> str:
    """The part of each period by its first letter."""
    belongs = None if valid is None else _lanes(valid)
    found = metrics.phases(np.arange(len(lane)) * 2.0, _lanes(lane), pulses, belongs)
    assert list(found) == list(metrics.PARTS)
    assert (np.sum(list(found.values()), axis=0) == 1).all()
    return "".join(next(name[0] for name, mask in found.items() if mask[i, 0]) for i in range(len(lane) - 1))


@pytest.mark.parametrize(
    ("lane", "pulses", "expected"),
    [
        # Samples 2 s apart; a pulse counts for 3 s after its end.
        ("001111111111", [], "arrrrrrrrrr"),
        ("111111111111", [], "rrrrrrrrrrr"),
        ("000000000000", [(4.0, 5.0)], "aaaaaaaaaaa"),
        ("111111111111", [(4.0, 5.0)], "rrddrrrrrrr"),
        ("111111111111", [(5.0, 5.1)], "rrdddrrrrrr"),
        ("111111111111", [(0.0, 0.0), (18.0, 90.0)], "ddrrrrrrrdd"),
        # The outage that it leaves behind counts until it is over, but not one that begins by itself later.
        ("111110000111", [(4.0, 5.0)], "rrddrrrrrrr"),
        ("111100000111", [(4.0, 5.0)], "rrdddddddrr"),
        ("111100110011", [(4.0, 5.0)], "rrddddrrrrr"),
        # On the way there a pulse is part of it.
        ("000000111111", [(4.0, 5.0)], "aaaaarrrrrr"),
        ("000011111111", [(4.0, 5.0)], "aaadrrrrrrr"),
    ],
)
def test_parts_of_an_episode(lane: str, pulses: list[tuple[float, float]], expected: str) -> None:
    assert _parts(lane, pulses) == expected


def test_what_was_not_flown_belongs_to_the_part_in_which_it_was_lost() -> None:
    assert _parts("000000000", [], "111100000") == "a" * 8
    assert _parts("110000011", [(2.0, 3.0)], "111100000") == "rddddddd"
    assert _parts("110000011", [], "111100000") == "r" * 8
    # A pulse that never came isn't to blame.
    assert _parts("111100000", [(12.0, 13.0)], "111100000") == "r" * 8


def test_each_episode_has_its_own_pulses() -> None:
    pulses = [(np.array([0.0, 4.0]), np.array([1.0, 4.5]))]
    found = metrics.phases(TIME, _lanes("111111111", "111111111"), pulses)["disturbances"]
    np.testing.assert_array_equal(found[:, 0], TIME[:-1] < 4.0)
    np.testing.assert_array_equal(found[:, 1], np.zeros(8, dtype=bool))


def test_losses_add_up_to_what_is_missing() -> None:
    rng = np.random.default_rng(0)
    highest = {"near": 2.0, "effort": 0.0}
    terms = {"near": rng.uniform(0.0, 2.0, (8, 3)), "effort": rng.uniform(-1.0, 0.0, (8, 3))}
    valid = _lanes("111111111", "111110000", "111111111")
    parts = metrics.phases(TIME, _lanes("000111111", "000000000", "111111111"), [(2.0, 2.5)], valid)
    found = metrics.losses(terms, highest, parts, valid)
    assert list(found) == ["loss", "loss_arrival", "loss_disturbances", "loss_rest", "loss_near", "loss_effort"]
    for lane, flown in enumerate((8, 4, 8)):
        own = {name: values[:flown, lane] for name, values in terms.items()}
        lacking = 16.0 - sum(float(values.sum()) for values in own.values())
        assert found["loss"][lane] == pytest.approx(lacking)
        assert found["loss_near"][lane] == pytest.approx(16.0 - own["near"].sum())
        assert found["loss_effort"][lane] == pytest.approx(-own["effort"].sum())
        assert sum(found[f"loss_{part}"][lane] for part in metrics.PARTS) == pytest.approx(lacking)
    # The first arrives at sample 3, after two whole periods outside.
    assert found["loss_arrival"][0] == pytest.approx(4.0 - terms["near"][:2, 0].sum() - terms["effort"][:2, 0].sum())
    assert found["loss_arrival"][1] == found["loss"][1]
    assert found["loss_arrival"][2] == 0.0

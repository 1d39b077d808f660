"""What figures show of flights."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.flight import Series, fly
from uwoc_gym.agents.policies.looks import LOOKS
from uwoc_gym.agents.policies.registry import load

pytest.importorskip("matplotlib")
figures = importlib.import_module("uwoc_gym.agents.reports.figures")


@pytest.fixture(scope="module")
def two_pulses() -> Scenario:
    strong = {"force_x_n": 1500.0, "force_y_n": 1500.0, "moment_nm": 500.0, "duration_s": 1.0}
    pulses = [{"start_s": 4.0, **strong, "force_x_n": 100.0, "force_y_n": 0.0}, {"start_s": 9.0, **strong}]
    return Scenario.named("StrongPulse").merged({"sea": {"pulses": pulses}, "episode": {"duration_s": 14.0}})


@pytest.fixture(scope="module")
def flown(two_pulses: Scenario) -> dict[str, tuple[int, Series]]:
    return {name: (0, fly(load(name), two_pulses, [0]).series) for name in ("pd", "nlpd-tuned")}


@pytest.fixture
def drawn(
    two_pulses: Scenario, flown: dict[str, tuple[int, Series]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Any:
    """The figure that is written."""
    kept: list[Any] = []
    monkeypatch.setattr(figures, "save", lambda chart, path: kept.append(chart))
    figures.figure(tmp_path / "a.png", "two pulses", two_pulses, flown)
    return kept[0]


def test_every_pulse_is_marked(drawn: Any) -> None:
    for axis in drawn.axes[:6]:
        spans = {tuple(np.round(patch.get_x() + np.array([0.0, patch.get_width()]), 6)) for patch in axis.patches}
        assert {(4.0, 5.0), (9.0, 10.0)} <= spans


def test_the_close_up_is_where_policies_differ_most(drawn: Any) -> None:
    for axis in drawn.axes[3:6]:
        assert axis.get_xlim() == pytest.approx((8.7, 11.7))


def test_a_close_up_without_pulses_is_of_the_start(flown: dict[str, tuple[int, Series]]) -> None:
    series = [each for _, each in flown.values()]
    assert figures.close_up(series, []) == (0.0, 3.0)
    assert figures.close_up(series[:1], [50.0]) == (0.0, 3.0)


def test_nobody_is_cut_off(drawn: Any, flown: dict[str, tuple[int, Series]]) -> None:
    assert min(series.bit_rate_bps.min() for _, series in flown.values()) == 0.0
    for axis in drawn.axes:
        for line in axis.get_lines():
            if line.get_label() not in flown:
                continue
            x, y = (np.asarray(values, dtype=float) for values in line.get_data())
            (left, right), (low, high) = axis.get_xlim(), axis.get_ylim()
            inside = (x >= left) & (x <= right)
            assert np.isfinite(y).all()
            assert low <= y[inside].min()
            assert y[inside].max() <= high


def test_a_policy_has_its_colour_in_every_panel(drawn: Any, flown: dict[str, tuple[int, Series]]) -> None:
    for axis in drawn.axes:
        colours = {line.get_label(): line.get_color() for line in axis.get_lines() if line.get_label() in flown}
        assert colours == {name: LOOKS[name].colour for name in flown}


def test_the_ranges_bounds_are_explained(drawn: Any) -> None:
    words = [text.get_text() for text in drawn.axes[0].get_legend().get_texts()]
    assert words == [figures.D_C, figures.D_B]


WRAPPERS = [{"name": "gymnasium.wrappers:DelayObservation", "options": {"delay": 2}},
            {"name": "mine:paid", "options": {"unit": "$x_{$"}}]  # fmt: skip


def test_titles_say_what_was_flown_in(
    two_pulses: Scenario, flown: dict[str, tuple[int, Series]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In letters as they are, whatever Matplotlib would make of them."""
    kept: list[Any] = []
    monkeypatch.setattr(figures, "save", lambda chart, path: kept.append(chart))
    returns = {"pd": np.array([1.0, 2.0])}
    for wrappers, words in ((), ""), (WRAPPERS, r', wrapped in DelayObservation(delay=2), in paid(unit="\$x_{\$")'):
        figures.figure(tmp_path / "a.png", "two pulses", two_pulses, flown, wrappers)
        figures.profiles(tmp_path / "b.png", "two pulses", returns, two_pulses, wrappers)
        whole, profile = kept[-2:]
        profile.canvas.draw()
        assert whole.get_suptitle() == f"two pulses, seed 0{words}"
        assert " ".join(profile.axes[0].get_title().split()) == f"two pulses{words}"


def test_legends_show_a_whole_dash_of_every_line(drawn: Any) -> None:
    """Two of the longest dashes with the gap between them, in points."""
    (legend,) = drawn.legends
    width = figures.style(LOOKS["pd"])["linewidth"]
    longest = max(2.0 * dash[0] + dash[1] for dash in figures.DASHES.values() if dash)
    assert legend.handlelength * legend.get_texts()[0].get_fontsize() >= longest * width


def test_a_profile_shows_the_worst_episode(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    kept: list[Any] = []
    monkeypatch.setattr(figures, "save", lambda chart, path: kept.append(chart))
    returns = {"pd": np.array([300.0, *np.full(400, 1100.0)]), "ppo": np.full(200, 1170.0)}
    figures.profiles(tmp_path / "a.png", "Random", returns, Scenario.named("Random"))
    (axis,) = kept[0].axes
    assert axis.get_xlim()[0] <= 300.0 / 1200.0

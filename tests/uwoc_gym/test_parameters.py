"""Paths into settings, and factors."""

from __future__ import annotations

import copy
import json
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from uwoc_gym import Pulse, RecordedPath, Scenario, SettingError, StraightPath, TrackingVectorEnv

RANDOM, NOMINAL = Scenario.named("Random"), Scenario.named("Nominal")

NUMBERS = st.floats(-900.0, 900.0) | st.lists(st.floats(-900.0, 900.0), min_size=2, max_size=2).map(sorted)
LENGTHS = st.floats(2.0, 9.0) | st.lists(st.floats(2.0, 9.0), min_size=2, max_size=2).map(sorted)
FIELDS = {
    "sea.pulses": {"force_x_n": NUMBERS, "force_y_n": NUMBERS, "duration_s": LENGTHS},
    "ship": {"radius_m": LENGTHS, "speed_mps": st.floats(0.1, 0.9)},
    "vehicle": {"mass_scale": st.floats(0.9, 1.1)},
    "": {"depth_m": st.floats(1.0, 3.0)},
}


@st.composite
def entries(draw: st.DrawFn) -> tuple[str, str, str, bool, Any]:
    """A place (a list or a component), which of the list, a setting of it, whether it is scaled, and the value."""
    place = draw(st.sampled_from(list(FIELDS)))
    name = draw(st.sampled_from(list(FIELDS[place])))
    index = draw(st.sampled_from(["*", "0", "1"])) if place in ("sea.pulses", "ship") else ""
    scales = draw(st.booleans())
    return place, index, name, scales, draw(st.floats(0.9, 1.05) if scales else FIELDS[place][name])


def written_out(data: dict[str, Any], place: str, index: str, name: str, scales: bool, value: Any) -> None:
    """Change plain data as the entry says, by hand."""
    at: Any = data
    for part in filter(None, place.split(".")):
        at = at[part]
    for own in at if index == "*" else [at[int(index)]] if index else [at]:
        old = own[name]
        if not scales:
            own[name] = value
        else:
            own[name] = [end * value for end in old] if isinstance(old, list) else old * value


@settings(derandomize=True, deadline=None, max_examples=150)
@given(st.lists(entries(), min_size=1, max_size=4))
def test_a_path_equals_the_whole_written_out(given_entries: list[tuple[str, str, str, bool, Any]]) -> None:
    base = RANDOM.merged({"depth_m": 2.0, "ship": RANDOM.to_dict()["ship"][2:4]})
    data = base.to_dict()
    overrides: dict[str, Any] = {}
    for place, index, name, scales, value in given_entries:
        where = f"{place}[{index}]" if index else place
        key = f"{where}.{name}{' *=' if scales else ''}" if where else f"{name}{' *=' if scales else ''}"
        if key in overrides:
            reject()
        overrides[key] = value
        written_out(data, place, index, name, scales, value)
    try:
        wanted = Scenario.from_dict(data)
    except SettingError:
        with pytest.raises(SettingError):
            base.merged(overrides)
    else:
        before = copy.deepcopy(overrides)
        assert base.merged(overrides) == wanted
        assert overrides == before


def test_a_partial_element_keeps_what_it_changes_from() -> None:
    changed = RANDOM.merged({"sea.pulses[1].force_x_n": 500.0}).sea.pulses
    first, second = RANDOM.sea.pulses
    assert changed == (first, Pulse(**{**second.to_dict(), "force_x_n": 500.0}))
    assert RANDOM.merged({"sea": {"pulses[1]": {"force_x_n": 500.0}}}).sea.pulses == changed
    # A list that is given is the whole new list.
    assert RANDOM.merged({"sea": {"pulses": [{"force_x_n": 500.0}]}}).sea.pulses == (Pulse(force_x_n=500.0),)


def test_all_means_all_that_have_the_setting() -> None:
    ships = RANDOM.merged({"ship[*].speed_mps": 0.5}).ship
    assert isinstance(ships, tuple)
    assert [getattr(each, "speed_mps", None) for each in ships] == [0.5, None, 0.5, 0.5, 0.5, 0.5]
    # Alternatives of which there is one.
    assert NOMINAL.merged({"ship[*].radius_m *=": 0.5}).ship == NOMINAL.merged({"ship.radius_m *=": 0.5}).ship
    assert RANDOM.merged({"ship[1]": {"kind": "straight", "speed_mps": 0.3}}).ship[1] == StraightPath(speed_mps=0.3)


def test_factors_act_on_ranges_samples_and_what_was_set_before() -> None:
    force = {"sea.pulses[0].force_x_n": [-100.0, 400.0], "sea.pulses[*].force_x_n *=": -0.5}
    pulses = RANDOM.merged(force).sea.pulses
    assert pulses[0].force_x_n == (-200.0, 50.0)
    assert pulses[1].force_x_n == (-500.0, 500.0)
    assert RANDOM.merged(dict(reversed(force.items()))).sea.pulses[0].force_x_n == (-100.0, 400.0)
    track = RecordedPath(time_s=[0.0, 10.0, 50.0, 200.0], x_m=[0.0, 1.0, 2.0, 3.0], y_m=[0.0, 0.0, 1.0, 1.0])
    doubled = Scenario(ship=track).merged({"ship.x_m *=": 2.0}).ship
    assert isinstance(doubled, RecordedPath)
    assert doubled.x_m == (0.0, 2.0, 4.0, 6.0)


def test_what_only_holds_together_is_checked_together() -> None:
    start = {"start.x_m": 50.0, "episode.lost_distance_m": 100.0}
    assert NOMINAL.merged(start).start.x_m == 50.0
    assert NOMINAL.merged(dict(reversed(start.items()))) == NOMINAL.merged(start)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"sea.pulses[2].force_x_n": 1.0}, ["Sea.pulses[2] is not there", "[0] to [1], or [*]"]),
        ({"sea.pulses.force_x_n": 1.0}, ["Sea.pulses.force_x_n", "a list of 2", "Sea.pulses[*]"]),
        ({"sea.pulses *=": 2.0}, ["Sea.pulses *=", "Sea.pulses[0]"]),
        ({"sea.pulses[*].force_x": 1.0}, ["Pulse has no setting 'force_x'", "did you mean 'force_x_n'?"]),
        ({"sea.puls[*].force_x_n": 1.0}, ["Sea has no setting 'puls'", "did you mean 'pulses'?"]),
        ({"ship[*].speed": 1.0}, ["has no setting 'speed'", "did you mean 'speed_mps'?"]),
        ({"ship[1].speed_mps": 1.0}, ["PaperPath has no setting 'speed_mps'"]),
        ({"vehicle[*].mass_scale": 1.0}, ["Scenario.vehicle[*] is not there", "is no list"]),
        ({"depth_m[0]": 1.0}, ["Scenario.depth_m[0] is not there", "a single setting"]),
        ({"depth_m.x": 1.0}, ["Scenario.depth_m.x is not there", "a single setting"]),
        ({"depth_m *=": 2.0}, ["Scenario.depth_m = None can't be scaled"]),
        ({"sea.pulses[0].frame *=": 2.0}, ["Pulse.frame = 'body' can't be scaled"]),
        ({"start.relative_to_ship *=": 2.0}, ["Start.relative_to_ship = True can't be scaled"]),
        ({"sea.pulses[0] *=": 2.0}, ["Sea.pulses[0] can't be scaled; it is a Pulse", "force_x_n"]),
        ({"vehicle.mass_scale *=": "twice"}, ["Vehicle.mass_scale *= 'twice'", "a finite number"]),
        ({"vehicle.mass_scale *=": float("nan")}, ["Vehicle.mass_scale *= nan", "a finite number"]),
        ({"vehicle.mass_scale *=": [1.0, 2.0]}, ["Vehicle.mass_scale *= [1.0, 2.0]", "a finite number"]),
        ({"vehicle.mass_scale *=": 1e6}, ["Vehicle.mass_scale = ", "is not allowed; it must be a number in"]),
        ({"sea.pulses[1]": 3.0}, ["Sea.pulses[1] = 3.0", "a Pulse or a mapping"]),
        ({"sea.pulses[0].force_x_n": 1.0, "sea": {"pulses": []}}, ["Sea.pulses = []", "put the whole first"]),
        ({"ship[0].speed_mps": 0.1, "ship": {"kind": "paper"}}, ["Scenario.ship = {'kind': 'paper'}", "whole first"]),
        ({"sea..pulses": 1.0}, ["Sea has no setting '.pulses'", "'sea.pulses[1].force_x_n'"]),
        ({"sea.pulses[-1].force_x_n": 1.0}, ["no setting 'pulses[-1].force_x_n'", "a path must be written like"]),
        ({"sea.pulses[1": 1.0}, ["no setting 'pulses[1'", "a path must be written like"]),
        ({"": 1.0}, ["no setting ''"]),
        ({7: 1.0}, ["no setting 7"]),
    ],
)  # fmt: skip
def test_what_leads_nowhere_is_refused(overrides: dict[Any, Any], words: list[str]) -> None:
    with pytest.raises(SettingError) as caught:
        RANDOM.merged(overrides)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize("index", ["*", "0"])
def test_a_list_without_elements_has_none(index: str) -> None:
    with pytest.raises(SettingError, match=r"Sea.pulses\[.\] is not there; the list is empty"):
        NOMINAL.merged({f"sea.pulses[{index}].force_x_n": 1.0})


def test_environments_take_paths() -> None:
    paths = {"sea.pulses[*].force_x_n *=": 0.0, "ship[*].speed_mps": 0.5}
    wanted = RANDOM.merged(paths)
    env: Any = gym.make("uwoc/Random-v0", scenario=paths)
    assert env.unwrapped.scenario == TrackingVectorEnv(2, RANDOM.merged(paths)).scenario == wanted
    # What was made can be made again from its spec's JSON.
    spec = gym.envs.registration.EnvSpec.from_json(env.spec.to_json())
    assert gym.make(spec).unwrapped.scenario == wanted  # type: ignore[attr-defined]
    whole, part = gym.make("uwoc/Random-v0", scenario=wanted), gym.make("uwoc/Random-v0")
    np.testing.assert_array_equal(whole.reset(seed=1)[0], part.reset(seed=1, options={"scenario": paths})[0])
    assert json.loads(json.dumps(paths)) == paths

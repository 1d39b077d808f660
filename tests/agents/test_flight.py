"""Flying a policy through seeded episodes."""

from __future__ import annotations

import sys
import time
import types
from typing import Any

import numpy as np
import pytest
from gymnasium.wrappers import TransformReward

from uwoc_gym import Scenario, TrackingEnv
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import decision_time, flown, fly, possible
from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.agents.wrapping import wrapping
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.metrics import PARTS
from uwoc_gym.sim.layout import varying

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 5.0}})


def test_a_lost_episode_ends_alone(still: Any) -> None:
    far = Scenario().merged({"start": {"x_m": -9.0, "y_m": (-4.0, 9.0)}, "episode": {"duration_s": 30.0}})
    policy = Policy("still", "", lambda scenario: still)
    flight = fly(policy, far, range(8))
    lost, steps = flight.metrics.lost, flight.metrics.steps
    assert 0 < lost.sum() < 8
    assert ((steps < 600) == (lost > 0)).all()
    for i in range(8):
        alone = fly(policy, far, [i]).metrics.rows()[0]
        assert list(alone.values()) == pytest.approx(list(flight.metrics.rows()[i].values()), nan_ok=True, abs=0.0)


def test_actions_of_another_shape_are_refused() -> None:
    class Wrong:
        def predict(self, observation: Any, *args: Any, **kwargs: Any) -> tuple[Any, Any]:
            return np.zeros(3, dtype=np.float32), None

    with pytest.raises(CommandError, match=r"shape \(3,\)"):
        fly(Policy("wrong", "", lambda scenario: Wrong()), SHORT, [0, 1])


def test_a_policy_is_made_from_what_is_known_and_not_from_the_truth(still: Any) -> None:
    told = []

    def make(scenario: Scenario) -> Any:
        told.append(scenario)
        return still

    truth = SHORT.merged({"vehicle": {"mass_scale": 1.2}})
    fly(Policy("curious", "", make), truth, [0, 1])
    assert told == [truth.known()]
    assert told[0].vehicle.mass_scale == 1.0
    assert not told[0].sea.pulses


def test_losses_are_those_of_the_single_environment_flown_alone() -> None:
    """By the rewards in `info`, with the parts told step by step from what a pulse and the cone say."""
    scenario = Scenario.named("Random").merged({"episode": {"duration_s": 20.0}})
    policy = POLICIES["pd"]
    seeds = [3, 5, 8]
    rows = fly(policy, scenario, seeds).rows()
    for seed, row in zip(seeds, rows, strict=True):
        env = TrackingEnv(scenario)
        observation, info = env.reset(seed=seed)
        drawn = env.parameters()
        pulses = [(drawn[f"sea.pulses[{i}].start_s"], drawn[f"sea.pulses[{i}].duration_s"]) for i in range(2)]
        law, memory, begun = policy.pilot(scenario), None, np.ones(1, dtype=bool)
        missing: dict[str, float] = {}
        arrived, struck, inside, steps = bool(info["in_cone"]), False, bool(info["in_cone"]), 0
        ended = False
        while not ended:
            action, memory = law.predict(observation[None], memory, begun, deterministic=True)
            begin, was_inside = steps * 0.05, inside
            observation, reward, terminated, truncated, info = env.step(action[0])
            begun, ended, steps = np.zeros(1, dtype=bool), terminated or truncated, steps + 1
            inside = bool(info["in_cone"])
            arrived = arrived or inside
            acts = any(begin + 0.05 > start and begin < start + length + 3.0 for start, length in pulses)
            struck = arrived and (acts or (struck and not was_inside))
            part = "disturbances" if struck else "rest" if arrived else "arrival"
            for name in ("loss", f"loss_{part}"):
                missing[name] = missing.get(name, 0.0) + 1.0 - float(reward)
            for term, most in (("bit_rate", 0.4), ("in_cone", 0.3), ("position", 0.2), ("heading", 0.1), ("effort", 0)):
                missing[f"loss_{term}"] = missing.get(f"loss_{term}", 0.0) + most - info[f"reward_{term}"]
        assert steps == 400
        losses = {name: value for name, value in row.items() if name.startswith("loss")}
        assert losses == pytest.approx({name: missing.get(name, 0.0) for name in losses}, abs=1e-9)
        assert row["return"] == pytest.approx(possible(scenario) - row["loss"])
    assert all(max(row[f"loss_{part}"] for row in rows) > 1.0 for part in PARTS)


def test_terms_are_true_behind_wrappers_that_pay_otherwise() -> None:
    plain = fly(POLICIES["nlpd"], SHORT, [4, 5])
    paid = fly(POLICIES["nlpd"], SHORT, [4, 5], wrapping=wrapping([f"{__name__}:double"]))
    assert paid.metrics.return_ == pytest.approx(2.0 * plain.metrics.return_)
    for name, values in plain.losses.items():
        assert paid.losses[name] == pytest.approx(values, abs=1e-9)


def double(env: Any) -> Any:
    return TransformReward(env, lambda reward: 2.0 * reward)


def test_what_is_told_of_flights_elsewhere_is_what_was_flown_here() -> None:
    found = flown("pd", False, (), SHORT, [4, 5])
    flight = fly(POLICIES["pd"], SHORT, [4, 5])
    assert repr(found.rows) == repr(flight.rows())
    for lane, seed in enumerate([4, 5]):
        env = TrackingEnv(SHORT)
        env.reset(seed=seed)
        drawn = env.parameters()
        own = found.drawn[lane]
        assert {path: drawn[path] for path in own} == own
        # What no episode draws, and numbers of paths that this one doesn't follow, aren't told.
        assert "vehicle.mass_scale" in own
        assert "depth_m" not in own
        left_out = [path for path in varying(SHORT) if path not in own]
        assert left_out
        assert all(path.startswith("ship[") and not path.startswith(f"ship[{own['ship']:.0f}]") for path in left_out)


def test_a_decision_takes_as_long_as_the_policy_thinks_on_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a policy that thinks at every fourth step alone, a quarter."""
    calls = []

    class NowAndThen:
        def predict(self, observation: Any, state: Any = None, **others: Any) -> tuple[Any, Any]:
            assert observation.shape == (1, 20)
            calls.append(0)
            if len(calls) % 4 == 0:
                time.sleep(0.02)
            return np.zeros((1, 3), dtype=np.float32), state

    module = types.ModuleType("uwoc_thinkers_of_a_test")
    module.make = lambda scenario: NowAndThen()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, module.__name__, module)
    taken = decision_time(f"{module.__name__}:make", False, (), SHORT, [0])
    assert 5000.0 < taken < 12000.0
    assert len(calls) > 80

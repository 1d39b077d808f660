"""The environments to train in."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from uwoc_gym import Scenario, TrackingEnv
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import environments
from uwoc_gym.agents.learning.plans import Wish, planned
from uwoc_gym.agents.learning.seeds import VALIDATION
from uwoc_gym.agents.policies.registry import load
from uwoc_gym.sb3 import TrackingVecEnv


def test_ids_of_others_over_our_fleet_use_it() -> None:
    name = "OthersTracking-v0"
    gym.register(
        name,
        "uwoc_gym.env:TrackingEnv",
        vector_entry_point="uwoc_gym.vector_env:TrackingVectorEnv",
        kwargs={"scenario_name": "Random", "control_period_s": 0.1},
    )
    try:
        scenario, fleet = environments.base_of(name)
        assert fleet
        assert scenario is not None
        assert scenario.episode.control_period_s == 0.1
        assert isinstance(environments.make_base(name, 2, scenario, {}), TrackingVecEnv)
    finally:
        del gym.registry[name]


def late(scenario: Any = "Random", delay: int = 1, **options: Any) -> gym.Env[Any, Any]:
    """A user's environment: ours in a wrapper."""
    return gym.wrappers.DelayObservation(TrackingEnv(scenario=scenario, **options), delay)


def stubborn(**_: Any) -> gym.Env[Any, Any]:
    """One that takes no scenario."""
    return gym.wrappers.NormalizeReward(TrackingEnv(scenario="Nominal"))


def stacked(**options: Any) -> gym.Env[Any, Any]:
    """One whose observations aren't ours."""
    return gym.wrappers.FlattenObservation(gym.wrappers.FrameStackObservation(TrackingEnv(**options), 2))


@pytest.fixture
def ids() -> Iterator[None]:
    made = {"Late-v0": late, "Stubborn-v0": stubborn, "Stacked-v0": stacked}
    for name, entry in made.items():
        gym.register(name, entry)
    yield
    for name in made:
        del gym.registry[name]


SMALL = ["--steps", "64", "--envs", "4", "--set", "n_steps=16", "--set", "batch_size=32", "--eval-episodes", "2"]


@pytest.mark.usefixtures("ids")
def test_wrapped_ids_of_others_keep_override_and_residual(tmp_path: Path) -> None:
    out = tmp_path / "run"
    brief = ["--override", "episode.duration_s=1", "vehicle.mass_scale *=1.5"]
    more = ["--residual", "nlpd", "--set", "env_kwargs.delay=2", "--out", str(out)]
    assert main(["train", "--env", "Late-v0", *SMALL, *brief, *more]) == 0
    results = json.loads((out / "results.json").read_text())
    scenario = Scenario.named("Random").merged({"episode.duration_s": 1.0, "vehicle.mass_scale *=": 1.5})
    assert results["scenario"] == scenario.to_dict()
    assert results["scenarios"] == {"evaluation": scenario.digest(), "training": scenario.digest()}
    # It is scored as it was trained, with the ID's delay; and so are the controllers beside it.
    plan = planned(Wish(), json.loads((out / "run.json").read_text()))
    for policy, scored in ((load(str(out)), results["best"]), (load("pd"), results["baselines"]["pd"])):
        flown = fly(policy, scenario, VALIDATION[:2], wrapping=plan.wrapping).metrics.return_.mean()
        assert flown == pytest.approx(scored["return"]["mean"], abs=1e-6)
    plain = fly(load("pd"), scenario, VALIDATION[:2]).metrics.return_.mean()
    assert plain != pytest.approx(results["baselines"]["pd"]["return"]["mean"], abs=1e-3)
    assert main(["train", "--resume", "--out", str(out)]) == 0


@pytest.mark.usefixtures("ids")
@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--env", "Stubborn-v0", "--override", "episode.duration_s=1"], "it must hand scenario= on to TrackingEnv"),
        (["--env", "Stacked-v0", "--override", "episode.duration_s=1"], "so that there is no scenario"),
        (["--env", "Stacked-v0", "--residual", "pd"], "no policy knows what it sees"),
        (["--env", "CartPole-v1", "--residual", "pd"], "no policy knows what it sees"),
        (["--env", "Late-v0", "--wrapper", "gymnasium.wrappers.vector:ClipAction"], "goes around vector environments"),
    ],
)
def test_what_means_nothing_to_an_id_is_refused_with_the_reason(
    words: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", *words, "--out", str(tmp_path / "run")]) == 1
    error = capsys.readouterr().err
    assert reason in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "run").exists()


STEPS = 40
STAGGERED = Scenario.named("Random").merged({"episode": {"duration_s": STEPS * 0.05}})


def test_first_episodes_are_cut_at_other_steps_and_later_ones_whole() -> None:
    env = environments.StaggeredVecEnv(TrackingVecEnv("uwoc/Random-v0", 8, seed=0, scenario=STAGGERED))
    env.reset()
    ends: list[list[int]] = [[] for _ in range(8)]
    actions = np.zeros((8, 3), dtype=np.float32)
    for step in range(1, 3 * STEPS + 1):
        observations, _, dones, infos = env.step(actions)
        for i in np.flatnonzero(dones).tolist():
            ends[i].append(step)
            assert infos[i]["TimeLimit.truncated"] is True
            assert infos[i]["terminal_observation"].shape == observations[i].shape
            assert not np.array_equal(infos[i]["terminal_observation"], observations[i])
    first = [each[0] for each in ends]
    assert len(set(first)) == 8
    # Spread over the whole length, and none longer.
    assert max(np.diff(sorted([0, *first, STEPS]))) <= STEPS / 4
    assert all(np.diff(each).tolist() == [STEPS] * (len(each) - 1) for each in ends)


def test_what_is_cut_goes_on_as_the_environment_would() -> None:
    cut, whole = (TrackingVecEnv("uwoc/Random-v0", 8, seed=0, scenario=STAGGERED) for _ in range(2))
    env = environments.StaggeredVecEnv(cut)
    np.testing.assert_array_equal(env.reset(), whole.reset())
    actions = np.zeros((8, 3), dtype=np.float32)
    seen, wanted = [], []
    for _ in range(2 * STEPS + 1):
        seen.append(env.step(actions))
        wanted.append(whole.step(actions))
    for i in range(8):
        begun = next(step for step, each in enumerate(seen) if each[2][i])
        ended = next(step for step, each in enumerate(wanted) if each[2][i])
        # The second episode is the same, whenever it begins.
        for offset in range(STEPS):
            np.testing.assert_array_equal(seen[begun + offset][0][i], wanted[ended + offset][0][i])
        np.testing.assert_array_equal(seen[begun][3][i]["terminal_observation"], wanted[begun][0][i])


def test_what_has_no_fleet_isnt_staggered(tmp_path: Path, ids: None, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--env", "Late-v0", "--set", "staggered=true", "--out", str(tmp_path / "run")]) == 1
    assert "staggered is not allowed for 'Late-v0', of which there is no fleet" in capsys.readouterr().err

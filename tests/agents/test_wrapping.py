"""Wrappers around what commands fly."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from uwoc_gym import Scenario, TrackingEnv
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import flown_seeds, fly
from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.agents.wrapping import wrapping

RANDOM = Scenario.named("Random").merged({"episode.duration_s": 3.0})
LATE = "gymnasium.wrappers:DelayObservation,delay=2"

MODULE = '''
import gymnasium as gym
import numpy as np

class Late(gym.vector.VectorWrapper):
    """Gymnasium's DelayObservation for a fleet that isn't reset in part."""

    def __init__(self, env, delay):
        super().__init__(env)
        self.delay = delay

    def reset(self, **options):
        seen, infos = self.env.reset(**options)
        self.queue = [np.zeros_like(seen)] * self.delay + [seen]
        return self.queue[0], infos

    def step(self, actions):
        seen, *rest = self.env.step(actions)
        self.queue = [*self.queue[1:], seen]
        return self.queue[0], *rest

def double_pay(env):
    return gym.wrappers.TransformReward(env, lambda reward: 2.0 * reward)

class Skip(gym.Wrapper):
    def step(self, action):
        self.env.step(action)
        return self.env.step(action)

class Stumble(gym.Wrapper):
    """Skips what comes after the second step."""

    steps = 0

    def step(self, action):
        self.steps += 1
        if self.steps == 3:
            self.env.step(action)
        return self.env.step(action)

class Broken(gym.Wrapper):
    def step(self, action):
        raise KeyError("broken")

def other(env):
    return gym.make("CartPole-v1")

def push(env):
    return env

def stacked(env):
    return gym.wrappers.FlattenObservation(gym.wrappers.FrameStackObservation(env, 2))

push.vector = True
number = 3
'''


@pytest.fixture(autouse=True)
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module of a user, in the working folder; its name is its own, since Python remembers modules."""
    name = f"mine_{abs(hash(tmp_path))}"
    (tmp_path / f"{name}.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    return name


def test_words_and_what_results_tell_say_the_same() -> None:
    word = 'gymnasium.wrappers:TransformAction,func=a,action_space=[1, {"b": 2}],flag=true'
    plain = [{"name": "gymnasium.wrappers:TransformAction", "options": {
        "func": "a", "action_space": [1, {"b": 2}], "flag": True,
    }}]  # fmt: skip
    assert wrapping([word]).plain() == wrapping(plain).plain() == plain
    assert not wrapping([])
    assert wrapping([]).plain() == []


def test_a_delay_is_what_gymnasium_delays_by(module: str) -> None:
    """By hand in a single environment, by a wrapper of single ones, and by one of the fleet."""
    late = gym.wrappers.DelayObservation(TrackingEnv(scenario=RANDOM), 2)
    pilot = POLICIES["nlpd"].pilot(RANDOM)
    returns = []
    for seed in (4, 5):
        seen, _ = late.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            seen, reward, terminated, truncated, _ = late.step(pilot.predict(seen[None])[0][0])
            total, over = total + float(reward), terminated or truncated
        returns.append(total)
    for words in ([LATE], [f"{module}:Late,delay=2"]):
        flown = fly(POLICIES["nlpd"], RANDOM, [4, 5], wrapping=wrapping(words))
        np.testing.assert_allclose(flown.metrics.return_, returns, rtol=1e-12)
    assert fly(POLICIES["nlpd"], RANDOM, [4, 5]).metrics.return_ != pytest.approx(returns, rel=1e-3)


def test_a_wrapper_that_does_nothing_changes_nothing(module: str) -> None:
    plain = fly(POLICIES["ppo"], RANDOM, [1, 2, 3])
    for words in (["gymnasium.wrappers:DelayObservation,delay=0"], [f"{module}:push"]):
        same = fly(POLICIES["ppo"], RANDOM, [1, 2, 3], wrapping=wrapping(words))
        for name in ("pose", "bit_rate_bps", "force", "reward", "valid", "disturbance_s"):
            np.testing.assert_array_equal(getattr(same.record, name), getattr(plain.record, name))


def test_what_is_random_in_a_wrapper_is_flown_on_every_seed() -> None:
    nominal = Scenario.named("Nominal")
    assert len(flown_seeds(POLICIES["pd"], nominal, range(5))) == 1
    assert len(flown_seeds(POLICIES["pd"], nominal, range(5), wrapping([LATE]))) == 5


def _returns(out: Path) -> list[float]:
    return [each["return"] for each in json.loads((out / "results.json").read_text())["episodes"]]


def test_results_tell_the_wrappers(module: str, tmp_path: Path) -> None:
    brief = ["--scenario", "Random", "--override", "episode.duration_s=1", "--wrapper", LATE, f"{module}:double_pay"]
    told = [{"name": "gymnasium.wrappers:DelayObservation", "options": {"delay": 2}},
            {"name": f"{module}:double_pay", "options": {}}]  # fmt: skip
    for words in (["evaluate", "pd", "--seeds", "2"], ["benchmark", "--policy", "pd", "--seeds", "2"]):
        out = tmp_path / words[0]
        assert main([*words, *brief, "--out", str(out)]) == 0
        results = json.loads((out / "results.json").read_text())
        assert results["settings"]["wrappers"] == told
    paid = _returns(tmp_path / "evaluate")
    assert main(["evaluate", "pd", "--seeds", "2", *brief[:-1], "--out", str(tmp_path / "single")]) == 0
    assert paid == pytest.approx([2.0 * each for each in _returns(tmp_path / "single")])
    out = tmp_path / "tuned"
    tune = ["tune", "pd", "--trials", "2", "--batch", "2", "--episodes", "2", "--eval-episodes", "3", "--out", str(out)]
    assert main([*tune, *brief]) == 0
    results = json.loads((out / "results.json").read_text())
    assert results["wrappers"] == told
    assert results["validation_episodes"] == 3


def test_agents_train_and_fly_in_wrappers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    small = ["--steps", "128", "--envs", "4", "--set", "n_steps=16", "--set", "batch_size=32", "--eval-episodes", "2"]
    brief = ["--override", "episode.duration_s=1"]
    assert main(["train", *small, *brief, "--wrapper", LATE, "--out", str(out)]) == 0
    results = json.loads((out / "results.json").read_text())
    assert results["wrappers"] == [{"name": "gymnasium.wrappers:DelayObservation", "options": {"delay": 2}}]
    words = ["evaluate", str(out), "--scenario", "Random", "--seed", "100000", "--seeds", "2", *brief]
    assert main([*words, "--wrapper", LATE, "--out", str(tmp_path / "late")]) == 0
    assert np.mean(_returns(tmp_path / "late")) == pytest.approx(results["best"]["return"]["mean"], abs=1e-6)
    capsys.readouterr()
    assert main(["train", "--resume", "--out", str(out), "--wrapper", "gymnasium.wrappers:ClipAction"]) == 1
    assert "other wrappers; leave out --wrapper" in capsys.readouterr().err
    assert main(["train", "--resume", "--out", str(out)]) == 1
    assert "wrapper 'gymnasium.wrappers:DelayObservation' is code" in capsys.readouterr().err
    assert main(["train", "--resume", "--out", str(out), "--wrapper", LATE]) == 0
    assert main(["train", "--resume", "--out", str(out), "--trust"]) == 0
    assert main(["list"]) == 0


@pytest.mark.parametrize(
    ("command", "wrapper", "words"),
    [
        ("evaluate pd", ["nothing"], ["--wrapper: 'nothing' is not allowed", "module:callable"]),
        ("evaluate pd", ["no_such_module:Thing"], ["'no_such_module:Thing' can't be imported"]),
        ("evaluate pd", ["gymnasium.wrappers:Nothing"], ["can't be imported", "Nothing"]),
        ("evaluate pd", ["{mine}:number"], ["is not callable"]),
        ("evaluate pd", ["gymnasium.wrappers:DelayObservation"], ["failed: TypeError", "delay"]),
        ("evaluate pd", ["gymnasium.wrappers:DelayObservation,delay=-1"], ["failed: ValueError"]),
        ("evaluate pd", ["{mine}:other"], ["failed: TypeError", "must return the Env that it is given, wrapped"]),
        ("evaluate pd", ["{mine}:push", LATE], ["DelayObservation goes around single environments, and must stand"]),
        ("evaluate pd", ["{mine}:Skip"], ["a step of it takes the AUV to 0.1 s instead of 0.05 s"]),
        ("evaluate pd", ["{mine}:Broken"], ["{mine}:Broken failed: KeyError"]),
        ("benchmark --policy pd", ["gymnasium.wrappers:DelayObservation"], ["failed: TypeError"]),
        ("tune pd", ["gymnasium.wrappers:DelayObservation"], ["failed: TypeError"]),
        ("train", ["{mine}:stacked"], ["shapes (40,) and (3,)", "--frame-stack"]),
        ("train", ["no_such_module:Thing"], ["can't be imported"]),
        ("train", ["{mine}:Broken"], ["{mine}:Broken failed: KeyError"]),
        ("train", ["{mine}:Skip"], ["a step of it takes the AUV to 0.1 s instead of 0.05 s"]),
        ("train", ["gymnasium.wrappers:RepeatAction,num_repeats=2"], ["instead of 0.05 s"]),
        ("train", ["gymnasium.wrappers.vector:DictInfoToList"], ["it makes infos a list; they must be a dict"]),
        ("train", ["gymnasium.wrappers.vector:NormalizeObservation"], ["NormalizeObservation failed: "]),
        ("train --env CartPole-v1", ["{mine}:Broken"], ["{mine}:Broken failed: KeyError"]),
        ("record --force", ["{mine}:Skip"], ["instead of 0.05 s"]),
        ("train --env CartPole-v1", ["{mine}:push"], ["goes around vector environments"]),
        ("protocol --runs runs", ["no_such_module:Thing"], ["can't be imported"]),
        ("replay", ["no_such_module:Thing"], ["can't be imported"]),
        ("record --force", ["{mine}:push"], ["goes around vector environments"]),
    ],
)  # fmt: skip
def test_what_cannot_be_flown_is_refused_in_one_line(
    command: str, wrapper: list[str], words: list[str], module: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, *rest = command.split()
    files = {"record": "a.gif", "replay": "a.html"}
    scenario = [] if "--env" in rest or name == "train" else ["--scenario", "Random"]
    said = [each.replace("{mine}", module) for each in wrapper]
    before = sorted(tmp_path.glob("*"))
    assert main([name, *rest, *scenario, "--wrapper", *said, "--out", files.get(name, "out")]) == 1
    error = capsys.readouterr().err
    for word in words:
        assert word.replace("{mine}", module) in error.splitlines()[-1]
    assert "Traceback" not in error
    assert sorted(path for path in tmp_path.glob("*") if path.name != "__pycache__") == before


def test_pilots_that_are_watched_fly_in_wrappers() -> None:
    pytest.importorskip("pygame")
    from uwoc_gym.agents.viewing.stage import Pilot

    pilot = Pilot(POLICIES["pd"], RANDOM, (320, 180), (0, 0, 0), wrapping([LATE]))
    pilot.reset(1, "")
    for _ in range(20):
        pilot.step()
    flown = fly(POLICIES["pd"], RANDOM, [1], wrapping=wrapping([LATE]))
    np.testing.assert_array_equal(pilot.env.state()["pose"], flown.record.pose[20, 0])
    pilot.push((0.0, 100.0, 0.0), "")


def test_pilots_refuse_steps_that_are_longer_now_and_then(module: str) -> None:
    pytest.importorskip("pygame")
    from uwoc_gym.agents.viewing.stage import Pilot

    pilot = Pilot(POLICIES["pd"], RANDOM, (320, 180), (0, 0, 0), wrapping([f"{module}:Stumble"]))
    pilot.reset(1, "")
    pilot.step()
    pilot.step()
    with pytest.raises(CommandError, match=r"takes the AUV to 0\.2 s instead of 0\.15 s"):
        pilot.step()


def test_wrappers_learn_how_long_an_episode_is() -> None:
    aware = wrapping(["gymnasium.wrappers:TimeAwareObservation,normalize_time=true"])
    aware.check(RANDOM)
    env = aware.fleet(RANDOM, 2)
    seen, _ = env.reset(seed=[0, 1])
    for _ in range(3):
        seen, *_ = env.step(np.zeros((2, 3), dtype=np.float32))
    assert seen[:, -1] == pytest.approx(3 / RANDOM.episode.steps)


def test_errors_of_the_environment_itself_stay_what_they_are() -> None:
    with pytest.raises(CommandError, match="DelayObservation,delay=2 failed: ValueError"), wrapping([LATE]).blamed():
        raise ValueError("no")
    around: Any = wrapping([])
    with pytest.raises(ValueError, match=r"^no$"), around.blamed():
        raise ValueError("no")

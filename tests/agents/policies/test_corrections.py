"""Agents that correct any policy, with its memory, and files that tell of it."""

from __future__ import annotations

import json
import shutil
import sys
import zipfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from uwoc_gym import Scenario, agents
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning.environments import ResidualVecEnv
from uwoc_gym.agents.learning.seeds import VALIDATION
from uwoc_gym.agents.policies.corrections import correction
from uwoc_gym.agents.policies.registry import GAINS_FILE, load
from uwoc_gym.agents.policies.residual import ResidualAction, ResidualVectorAction
from uwoc_gym.baselines import gains
from uwoc_gym.baselines.guidance import Guidance, GuidanceGains
from uwoc_gym.sb3 import TrackingVecEnv

ID, STEPS = "uwoc/Random-v0", 7
BRIEF = ["--override", "episode.duration_s=1"]
SCENARIO = Scenario.named("Random").merged({"episode.duration_s": 1.0})
SMALL = ["--steps", "128", "--envs", "4", "--set", "n_steps=16", "--set", "batch_size=32", "--eval-episodes", "2"]


class Counting:
    """Commands what it remembers: in x how many observations of the episode it has seen, a tenth each."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        seen = (np.zeros(len(observation)) if state is None else np.where(episode_start, 0.0, state)) + 1.0
        return np.stack([0.1 * seen, *np.zeros((2, len(seen)))], axis=1).astype(np.float32), seen


def make_counting(scenario: Scenario) -> Counting:
    """As `module:callable` names it."""
    return Counting()


class Told(gym.Wrapper[Any, Any, Any, Any]):
    """Keeps the actions that arrive."""

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        super().__init__(env)
        self.arrived: list[Any] = []

    def step(self, action: Any) -> Any:
        self.arrived.append(float(action[0]))
        return self.env.step(action)


class ToldAll(gym.vector.VectorWrapper):
    """The same for a fleet."""

    arrived: Any

    def reset(self, **options: Any) -> Any:
        self.arrived = getattr(self, "arrived", [])
        return self.env.reset(**options)

    def step(self, actions: Any) -> Any:
        self.arrived.append(np.round(np.asarray(actions, dtype=float)[:, 0], 6).tolist())
        return self.env.step(actions)


COUNTED = [round(0.1 * k, 6) for k in range(1, STEPS + 1)]


def test_memory_begins_anew_with_each_episode_of_a_single_environment() -> None:
    told = Told(gym.make(ID, max_episode_steps=STEPS))
    env = ResidualAction(told, Counting(), 0.5)
    for _ in range(2):
        env.reset(seed=1)
        for _ in range(STEPS):
            env.step(np.zeros(3, dtype=np.float32))
    assert np.round(told.arrived, 6).tolist() == COUNTED * 2


@pytest.mark.parametrize("mode", AutoresetMode)
def test_memory_begins_anew_in_every_autoreset_mode(mode: AutoresetMode) -> None:
    told = ToldAll(gym.make_vec(ID, num_envs=2, max_episode_steps=STEPS, autoreset_mode=mode))
    env = ResidualVectorAction(told, Counting(), 0.5)
    env.reset(seed=1)
    arrived: list[list[float]] = []
    for step in range(1, 3 * STEPS):
        env.step(np.zeros((2, 3), dtype=np.float32))
        arrived.append(told.arrived[-1])
        if mode is AutoresetMode.DISABLED and step == 3:
            # One begins anew in the middle of the other's episode, which remembers nothing twice.
            env.reset(options={"reset_mask": np.array([True, False])})
        elif mode is AutoresetMode.DISABLED and step in (STEPS, 3 + STEPS, 2 * STEPS, 3 + 2 * STEPS):
            env.reset(options={"reset_mask": np.array([step in (3 + STEPS, 3 + 2 * STEPS), step % STEPS == 0])})
    first, second = np.array(arrived).T.tolist()
    # At the step after an episode's end the action doesn't count.
    pause = [first[STEPS]] if mode is AutoresetMode.NEXT_STEP else []
    assert second == ((COUNTED + pause) * 3)[: len(second)]
    if mode is AutoresetMode.DISABLED:
        assert first == (COUNTED[:3] + COUNTED * 3)[: len(first)]
    else:
        assert first == second


def test_memory_begins_anew_in_stable_baselines3s_environments() -> None:
    venv = TrackingVecEnv(ID, 2, 1, wrapper=ToldAll, max_episode_steps=STEPS)
    env = ResidualVecEnv(venv, Counting(), 0.5)
    env.reset()
    for _ in range(2 * STEPS):
        env.step(np.zeros((2, 3), dtype=np.float32))
    assert np.array(venv.vector_env.arrived).T.tolist() == [COUNTED * 2] * 2  # type: ignore[attr-defined]


def _returns(out: Path, trust: bool = False) -> float:
    policy = load(str(out), trust)
    return float(fly(policy, SCENARIO, VALIDATION[:2]).metrics.return_.mean())


def _best(out: Path) -> float:
    return float(json.loads((out / "results.json").read_text())["best"]["return"]["mean"])


@pytest.fixture(scope="module")
def recurrent(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An agent with a memory and a stack of observations."""
    out = tmp_path_factory.mktemp("corrections") / "recurrent"
    more = ["--algorithm", "recurrent_ppo", "--frame-stack", "2", "--set", "policy_kwargs.lstm_hidden_size=4"]
    assert main(["train", *more, *SMALL, *BRIEF, "--out", str(out)]) == 0
    return out


def test_an_agent_takes_in_the_agent_that_it_corrects(recurrent: Path, tmp_path: Path) -> None:
    base = tmp_path / "base"
    shutil.copytree(recurrent, base)
    out = tmp_path / "run"
    assert main(["train", "--residual", str(base), "--scale", "0.3", *SMALL, *BRIEF, "--out", str(out)]) == 0
    before = _returns(out)
    assert before == pytest.approx(_best(out), abs=1e-6)
    # And one that corrects it in turn.
    above = tmp_path / "above"
    assert main(["train", "--residual", str(out / "model.zip"), *SMALL, *BRIEF, "--out", str(above)]) == 0
    shutil.rmtree(base)
    assert _returns(out) == before
    shutil.rmtree(out)
    assert _returns(above) == pytest.approx(_best(above), abs=1e-6)
    with zipfile.ZipFile(above / "model.zip") as archive:
        assert "corrected.zip" in archive.namelist()


def test_a_run_goes_on_only_with_the_agent_that_it_corrected(
    recurrent: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base, out = tmp_path / "base.zip", tmp_path / "run"
    shutil.copyfile(recurrent / "model.zip", base)
    assert main(["train", "--residual", str(base), *SMALL, *BRIEF, "--out", str(out)]) == 0
    assert main(["train", "--resume", "--out", str(out)]) == 0
    shutil.copyfile(out / "model.zip", base)
    capsys.readouterr()
    assert main(["train", "--resume", "--out", str(out)]) == 1
    assert "corrects another agent than" in capsys.readouterr().err


def test_a_correction_of_nothing_is_the_policy(recurrent: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uwoc_gym.agents.policies.agent import Agent

    class Nothing:
        observation_space = gym.spaces.Box(-1.0, 1.0, (20,))

        def predict(self, observation: Any, *_: Any) -> tuple[Any, Any]:
            return np.zeros((len(observation), 3), dtype=np.float32), None

    base, own = (load(str(recurrent)).pilot(SCENARIO) for _ in range(2))
    agent = Agent(Nothing(), controller=base, scale=0.5)
    rng, memory, mine = np.random.default_rng(0), None, None
    for step in range(12):
        seen, begun = rng.normal(size=(3, 20)).astype(np.float32), np.array([step == 0, step in (0, 5), step % 3 == 0])
        found, memory = agent.predict(seen, memory, begun, deterministic=True)
        wanted, mine = own.predict(seen, mine, begun, deterministic=True)
        np.testing.assert_array_equal(found, np.clip(wanted, -1.0, 1.0))


def test_gains_files_and_folders_of_searches_are_corrected_and_fly(tmp_path: Path) -> None:
    law = {"a_p": [300.0, 200.0, 100.0], "a_v": 250.0}
    folder = tmp_path / "tuning"
    folder.mkdir()
    (folder / GAINS_FILE).write_text(json.dumps(law))
    for k, given in enumerate((folder, folder / GAINS_FILE)):
        assert main(["evaluate", str(given), "--seeds", "2", *BRIEF]) == 0
        assert main(["benchmark", "--policy", str(given), "--scenario", "Random", "--seeds", "2", *BRIEF]) == 0
        out = tmp_path / f"run-{k}"
        assert main(["train", "--residual", str(given), *SMALL, *BRIEF, "--out", str(out)]) == 0
        assert json.loads((out / "results.json").read_text())["settings"]["residual"] == law
        agent = agents.load(str(out), SCENARIO)
        assert agent.controller.gain_sets[0].a_p == (300.0, 200.0, 100.0)  # type: ignore[attr-defined]
    one = fly(load(str(folder)), SCENARIO, [3]).metrics.return_
    assert one == fly(correction(law).policy, SCENARIO, [3]).metrics.return_  # type: ignore[union-attr]
    pd = correction("paper-pd")
    assert pd is not None
    assert pd.told["gains"]["a_p"] == gains("pd").a_p


def test_guidance_is_corrected_and_loads_with_its_gains(tmp_path: Path) -> None:
    (tmp_path / "los.json").write_text(json.dumps({"crab": 0.25}))
    out = tmp_path / "run"
    assert main(["train", "--residual", str(tmp_path / "los.json"), *SMALL, *BRIEF, "--out", str(out)]) == 0
    agent: Any = agents.load(str(out), SCENARIO)
    seen = np.random.default_rng(0).uniform(-1.0, 1.0, (4, 20)).astype(np.float32)
    wanted = Guidance(GuidanceGains(crab=0.25), SCENARIO).predict(seen)[0]
    np.testing.assert_array_equal(agent.controller.predict(seen)[0], wanted)


def test_code_that_is_corrected_is_run_by_those_who_trust_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "law_of_mine.py").write_text(
        "import numpy as np\n"
        "class Law:\n"
        "    def predict(self, observation, state=None, episode_start=None, deterministic=False):\n"
        "        return np.full((len(observation), 3), 0.1, dtype=np.float32), state\n"
        "def make(scenario):\n"
        "    return Law()\n"
    )
    out = tmp_path / "run"
    assert main(["train", "--residual", "law_of_mine:make", *SMALL, *BRIEF, "--out", str(out)]) == 0
    with pytest.raises(CommandError, match="corrects 'law_of_mine:make', which is code"):
        load(str(out)).make(SCENARIO)
    assert _returns(out, trust=True) == pytest.approx(_best(out), abs=1e-6)
    capsys.readouterr()
    assert main(["evaluate", str(out), "--seeds", "2", *BRIEF]) == 1
    assert "give --trust" in capsys.readouterr().err
    assert main(["evaluate", str(out), "--seeds", "2", "--trust", *BRIEF]) == 0
    # Going on with a run runs nothing that only its file names.
    monkeypatch.delitem(sys.modules, "law_of_mine")
    assert main(["train", "--resume", "--out", str(out)]) == 1
    assert "law_of_mine" not in sys.modules
    assert "residual = 'law_of_mine:make' is code" in capsys.readouterr().err
    for more in (["--trust"], ["--residual", "law_of_mine:make"], ["--set", "residual=law_of_mine:make"]):
        assert main(["train", "--resume", "--out", str(out), *more]) == 0
    above = tmp_path / "above"
    assert main(["train", "--residual", str(out), *SMALL, *BRIEF, "--out", str(above)]) == 1
    assert "give --trust" in capsys.readouterr().err
    assert not above.exists()
    assert main(["train", "--residual", str(out), "--trust", *SMALL, *BRIEF, "--out", str(above)]) == 0
    assert not load(str(out), trust=True).deterministic
    assert not load(str(above), trust=True).deterministic
    # Shipped agents are named.
    assert correction("ppo").told == {"policy": "ppo"}  # type: ignore[union-attr]


class Fails:
    """A policy that fails."""

    def __init__(self, scenario: Scenario) -> None: ...

    def predict(self, observation: Any, **_: Any) -> Any:
        raise KeyError("no")


class FailsLate(Fails):
    """A policy that fails in the middle of an episode."""

    def predict(self, observation: Any, state: Any = None, **_: Any) -> Any:
        if state == 2:
            raise KeyError("no")
        return np.zeros((len(observation), 3), dtype=np.float32), (state or 0) + 1


class FailsInFours(Fails):
    """A policy that fails in four environments, as many as it is trained in."""

    def predict(self, observation: Any, state: Any = None, **_: Any) -> Any:
        if len(observation) == 4:
            raise KeyError("no")
        return np.zeros((len(observation), 3), dtype=np.float32), None


@pytest.mark.parametrize("kind", [FailsLate, FailsInFours])
def test_a_corrected_policy_that_fails_is_named(kind: type, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    given = f"{__name__}:{kind.__name__}"
    assert main(["train", "--residual", given, *SMALL, *BRIEF, "--out", str(tmp_path / "run")]) == 1
    error = capsys.readouterr().err
    assert f"error: policy '{given}', which is corrected, failed: KeyError: 'no'" in error


class Narrow(Fails):
    """A policy of another number of actions."""

    def predict(self, observation: Any, **_: Any) -> Any:
        return np.zeros((len(observation), 2)), None


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("nlpdd", ["residual = 'nlpdd' is not allowed", "did you mean 'nlpd'?", "a .json file of gains"]),
        ("missing.zip", ["residual = 'missing.zip'", "there is no such file"]),
        ("missing.json", ["missing.json", "can't be read"]),
        ("no_such_module:thing", ["can't be imported"]),
        (f"{__name__}:Fails", ["policy '", "Fails' failed: KeyError: 'no'"]),
        (f"{__name__}:Narrow", ["gave actions of shape (1, 2)"]),
    ],
)
def test_what_cannot_be_corrected_is_refused(
    given: str, words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(["train", "--residual", given, "--out", str(out)]) == 1
    error = capsys.readouterr().err
    for word in words:
        assert word in error
    assert not out.exists()

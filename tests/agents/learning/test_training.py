"""Training from end to end, with networks and episodes small enough for seconds."""

from __future__ import annotations

import errno
import json
import os
import shlex
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.utils import LinearSchedule

from uwoc_gym import Scenario, TrackingVectorEnv, agents
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import checkpoints, plans, seeds, settings, standing, training
from uwoc_gym.agents.learning.plans import Wish
from uwoc_gym.agents.policies.agent import Agent
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.policies.registry import POLICIES, load, shipped

SHORT = '{"episode": {"duration_s": 2.0}}'
SCENARIO = Scenario.named("Random").merged(json.loads(SHORT))
SMALL = {
    "ppo": ["n_steps=16", "batch_size=32", "n_epochs=1", "policy_kwargs.net_arch=[8]"],
    "recurrent_ppo": [
        "n_steps=16", "batch_size=32", "n_epochs=1", "policy_kwargs.net_arch=[8]", "policy_kwargs.lstm_hidden_size=4",
    ],
    **{
        name: ["buffer_size=1000", "batch_size=16", "learning_starts=50", "gradient_steps=1", "train_freq=8",
               "policy_kwargs.net_arch=[8]"]
        for name in ("sac", "td3", "tqc")
    },
}  # fmt: skip


def _command(algorithm: str, out: Path, *more: str, steps: int = 256) -> list[str]:
    settings = [word for setting in SMALL[algorithm] for word in ("--set", setting)]
    return [
        "train", "--algorithm", algorithm, "--steps", str(steps), "--envs", "4", "--override", SHORT,
        "--eval-episodes", "2", *settings, "--out", str(out), *more,
    ]  # fmt: skip


def _results(out: Path) -> dict[str, Any]:
    found = json.loads((out / "results.json").read_text())
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize("algorithm", settings.TRAINABLE)
def test_every_algorithm_trains_and_flies(algorithm: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(_command(algorithm, out, "--eval-every", "128")) == 0
    assert "best model, at step" in capsys.readouterr().out
    results = _results(out)
    assert results["finished"] is True
    assert [each["steps"] for each in results["evaluations"]] == [0, 128, 256]
    assert results["command"].startswith("uwoc-gym train --algorithm")
    assert results["baselines"]["nlpd"]["return"]["mean"] > 0.0
    assert results["scenarios"]["evaluation"] == SCENARIO.digest()
    settings = results["settings"]["env_kwargs"].get("scenario", {})
    assert results["scenarios"]["training"] == SCENARIO.merged(settings).merged(json.loads(SHORT)).digest()
    for name in ("settings.yaml", "run.json", "model.zip", "last.zip", "train.log"):
        assert (out / name).is_file()
    assert list((out / "tensorboard").iterdir())
    assert (out / "curve.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    # Plain Stable-Baselines3 loads the file too.
    assert ALGORITHMS[algorithm].load().load(out / "model.zip", device="cpu") is not None
    seen = [seeds.VALIDATION[i] for i in range(2)]
    for path in (out, out / "model.zip"):
        flight = fly(load(str(path)), SCENARIO, seen)
        assert flight.metrics.return_.mean() == pytest.approx(results["best"]["return"]["mean"], abs=1e-6)


def test_what_will_be_done_is_said_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    assert main(_command("ppo", out, "--eval-every", "100", steps=200)) == 0
    error = capsys.readouterr().err
    assert "| 256/256 [" in error
    said = error.splitlines()
    assert said[0] == (
        "uwoc-gym train: PPO on uwoc/Random-v0: 256 steps (200 asked for; they come in lots of 64), in 4 environments; "
        "3 validations of 2 episodes"
    )
    assert "trained -> scored" in said[1]
    assert said[2:4] == [
        "  sea.pulses[0].start_s: [2.0, 11.0] -> [5.0, 30.0]", "  sea.pulses[1].start_s: [2.0, 11.0] -> [30.0, 55.0]",
    ]  # fmt: skip
    assert [each["steps"] for each in _results(out)["evaluations"]] == [0, 128, 256]
    # Without a practice of the settings' own there is nothing to tell apart.
    assert main(_command("ppo", tmp_path / "same", "--set", "env_kwargs.scenario={}", steps=64)) == 0
    assert "trained -> scored" not in capsys.readouterr().err


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
@pytest.mark.parametrize(("every", "steps"), [(10, 256), (64, 256), (100, 300), (1000, 130)])
def test_the_validations_that_are_foretold_are_made(algorithm: str, every: int, steps: int, tmp_path: Path) -> None:
    made = training.Run(_planned(algorithm, every, steps), tmp_path, "")
    lot = training.rollout(made.model, made.kind.off_policy)
    assert lot == (64 if algorithm == "ppo" else 32)
    ahead = training.forecast(steps, 0, lot, every, None)
    flown: list[int] = []
    made.evaluate = lambda: flown.append(made.model.num_timesteps) or _scored(made)  # type: ignore[method-assign, func-returns-value]
    made.checkpoint = lambda: None  # type: ignore[method-assign]
    made.train(bar=False)
    assert (made.model.num_timesteps, len(flown)) == ahead


def _planned(algorithm: str, every: int, steps: int) -> plans.Plan:
    wish = Wish(
        algorithm=algorithm, override=(SHORT,), steps=steps, envs=4, set=tuple(SMALL[algorithm]), eval_every=every,
        eval_episodes=2,
    )  # fmt: skip
    return plans.planned(wish)


def _scored(made: training.Run) -> dict[str, Any]:
    found = {"steps": made.model.num_timesteps, "return": {"mean": 0.0}}
    made.progress.evaluations.append(found)
    return found


def test_more_validations_than_usual_can_be_asked_for(tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert main([*_command("ppo", out, steps=64), "--eval-episodes", "210", "--eval-every", "64"]) == 0
    results = _results(out)
    assert results["validation_seeds"] == [100_000, 100_209]
    own = load(str(out))
    flown = fly(own, SCENARIO, seeds.ALL_VALIDATION[:210]).metrics.return_
    assert flown.mean() == pytest.approx(results["best"]["return"]["mean"], abs=1e-6)


def test_a_settings_file_that_a_run_has_written_trains_again(tmp_path: Path) -> None:
    assert main(_command("ppo", tmp_path / "a")) == 0
    out = tmp_path / "b"
    file = str(tmp_path / "a" / "settings.yaml")
    options = ["--settings", file, "--override", SHORT, "--eval-episodes", "2", "--out", str(out)]
    assert main(["train", "--algorithm", "ppo", *options]) == 0
    a, b = _results(tmp_path / "a"), _results(out)
    assert a["settings"] == b["settings"]
    # The same seed gives the same training.
    assert [each["return"] for each in a["evaluations"]] == [each["return"] for each in b["evaluations"]]


def test_ppo_learns(tmp_path: Path) -> None:
    options = [
        "--steps", "80000", "--envs", "128", "--set", "n_steps=32", "--set", "batch_size=1024",
        "--set", "policy_kwargs.net_arch=[64,64]", "--set", "learning_rate=1e-3", "--set", "gamma=0.95",
        "--override", '{"episode": {"duration_s": 10.0}}', "--eval-every", "80000", "--eval-episodes", "16",
    ]  # fmt: skip
    assert main(["train", "--out", str(tmp_path / "run"), *options]) == 0
    first, last = _results(tmp_path / "run")["evaluations"]
    assert last["return"]["mean"] > first["return"]["mean"] + 40.0
    assert last["availability"]["mean"] > 0.5


def _interrupt_at(monkeypatch: pytest.MonkeyPatch, call: int, number: int = signal.SIGINT) -> None:
    """Send the signal in the evaluation of that number."""
    real, calls = training.Run.evaluate, []

    def interrupted(self: training.Run) -> Any:
        calls.append(1)
        if len(calls) == call:
            os.kill(os.getpid(), number)
        return real(self)

    monkeypatch.setattr(training.Run, "evaluate", interrupted)


def _plan_of(out: Path) -> plans.Plan:
    return plans.planned(Wish(), plans.recorded_plan(out / "run.json"))


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_an_interrupted_run_goes_on_where_it_stood(
    algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, total = tmp_path / "run", 512
    more = ["--set", "normalize=true", "--set", "learning_rate=lin_1e-3", "--eval-every", "128"]
    remaining: list[float] = []
    kind = ALGORITHMS[algorithm].load()
    real = LinearSchedule.__call__

    def scheduled(self: LinearSchedule, progress_remaining: float) -> float:
        remaining.append(progress_remaining)
        return real(self, progress_remaining)

    monkeypatch.setattr(LinearSchedule, "__call__", scheduled)
    with monkeypatch.context() as patch:
        _interrupt_at(patch, 3)
        assert main(_command(algorithm, out, *more, steps=total)) == 130
    assert "interrupted at step 256;" in capsys.readouterr().err.splitlines()[-1]
    last = checkpoints.newest(out)
    assert last is not None
    progress = json.loads((last / "progress.json").read_text())
    stood = progress["steps"]
    assert stood == 256
    assert [each["steps"] for each in progress["evaluations"]] == [0, 128, 256]

    made = training.Run(_plan_of(out), out, "", last)
    stored = kind.load(last / "last.zip", device="cpu")
    assert made.model.num_timesteps == stored.num_timesteps == stood
    for counter in ("_n_updates", "_episode_num"):
        assert vars(made.model)[counter] == vars(stored)[counter]
    assert vars(made.model)["_n_updates"] > 0
    optimizer = made.model.policy.optimizer if algorithm == "ppo" else made.model.critic.optimizer
    state = (stored.policy.optimizer if algorithm == "ppo" else stored.critic.optimizer).state_dict()["state"]
    assert state
    for key, moments in optimizer.state_dict()["state"].items():
        assert moments["step"] == state[key]["step"] > 0
        assert torch.equal(moments["exp_avg_sq"], state[key]["exp_avg_sq"])
    if algorithm == "sac":
        assert torch.equal(made.model.log_ent_coef, stored.log_ent_coef)
        assert made.model.log_ent_coef.item() != 0.0
    assert made.statistics is not None
    assert made.statistics.obs_rms.count > 200
    assert made.statistics.ret_rms.count > 200
    if algorithm == "sac":
        assert made.model.replay_buffer.pos == stood // 4
        assert made.model.replay_buffer.rewards[: stood // 4].any()
        assert not made.model.replay_buffer.rewards[stood // 4 :].any()
    made.env.close()

    half = len(remaining)
    assert main(["train", "--resume", "--out", str(out)]) == 0
    results = _results(out)
    assert results["finished"] is True
    assert [each["steps"] for each in results["evaluations"]][:4] == [0, 128, 256, 384]
    # What is made or loaded asks for the rate at the beginning, 1.
    asked = [share for share in remaining[half:] if share < 1.0]
    assert 1.0 - (stood + 64) / total <= max(asked) < 1.0 - stood / total
    assert remaining[-1] == pytest.approx(0.0)
    assert kind.load(out / "last.zip", device="cpu").num_timesteps == total
    assert main(["train", "--resume", "--out", str(out)]) == 0
    assert "is finished" in capsys.readouterr().err


class Killed(BaseException):
    """What ends a run without a word."""


LAYERS = ["--frame-stack", "2", "--set", "staggered=true", "--set", "normalize={norm_obs: false, norm_reward: true}"]


@pytest.mark.parametrize(
    ("algorithm", "more"),
    [
        ("ppo", []),
        ("ppo", [*LAYERS, "--set", "normalize=true"]),
        ("ppo", ["--residual", "ekf-nlpd", "--scale", "0.3", "--set", "filtered=true"]),
        ("ppo", ["--set", "teacher=nlpd", "--set", "teacher_steps=48", "--set", "critic_steps=64", *LAYERS]),
        ("recurrent_ppo", ["--set", "normalize=true"]),
        ("sac", ["--set", "train_freq=1"]),
        (
            "td3",
            [
                "--set",
                "frame_stack=1",
                "--set",
                "normalize=true",
                "--set",
                "noise_type=normal",
                "--set",
                "noise_std=0.1",
            ],
        ),
    ],
    ids=["ppo", "layers", "corrected", "taught", "recurrent", "sac", "td3"],
)
@pytest.mark.parametrize("killed", [True, False], ids=["killed", "interrupted"])
def test_a_run_that_was_stopped_ends_as_one_that_was_not(
    algorithm: str, more: list[str], killed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def words(out: Path) -> list[str]:
        often = ["--eval-every", "128", "--checkpoint-every", "64", "--seed", "3"]
        return _command(algorithm, out, *often, *more, steps=384)

    assert main(words(tmp_path / "whole")) == 0
    out = tmp_path / "stopped"
    real, steps = training.Run.checkpoint, []

    def checkpoint(self: training.Run) -> None:
        real(self)
        steps.append(self.progress.steps)
        if killed and (len(steps) in (3, 16) or self.progress.steps == 192):
            raise Killed

    with monkeypatch.context() as patch:
        if killed:
            patch.setattr(training.Run, "checkpoint", checkpoint)
            again = words(out)
            while True:
                try:
                    assert main(again) == 0
                    break
                except Killed:
                    again = ["train", "--resume", "--out", str(out)]
        else:
            _interrupt_at(patch, 2)
            assert main(words(out)) == 130
            assert main(["train", "--resume", "--out", str(out)]) == 0
    assert not killed or len(steps) > 4
    ends = []
    for folder in (tmp_path / "whole", out):
        last = checkpoints.newest(folder)
        assert last is not None
        progress = json.loads((last / "progress.json").read_text())
        ends.append((progress["evaluations"], progress["counters"], progress["seeds_used"]))
    assert ends[0] == ends[1]
    kind = ALGORITHMS[algorithm].load()
    models = [kind.load(folder / "last.zip", device="cpu") for folder in (tmp_path / "whole", out)]
    weights = [model.policy.state_dict() for model in models]
    assert all(torch.equal(value, weights[1][name]) for name, value in weights[0].items())


def test_a_run_that_cannot_say_where_it_stood_goes_on_with_new_episodes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "run"
    used: list[list[int | None]] = []
    real = TrackingVectorEnv.reset

    def reset(self: TrackingVectorEnv, **options: Any) -> Any:
        if isinstance(options.get("seed"), list):
            used.append(options["seed"])
        return real(self, **options)

    monkeypatch.setattr(TrackingVectorEnv, "reset", reset)
    monkeypatch.setattr(standing, "taken", lambda model: None)
    with monkeypatch.context() as patch:
        _interrupt_at(patch, 2, signal.SIGTERM)
        assert main(_command("ppo", out, "--seed", "3")) == 128 + signal.SIGTERM
    assert main(["train", "--resume", "--out", str(out)]) == 0
    trained = [each for each in used if each[0] is not None and each[0] >= seeds.SPAN]
    assert trained == [[4_000_000 + i for i in range(4)], [4_000_004 + i for i in range(4)]]
    others = {seed for each in used if each not in trained for seed in each}
    assert others == set(seeds.VALIDATION[:2])


def test_a_checkpoint_that_fails_in_the_middle_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    real, calls = checkpoints.save_buffer, []

    def save(buffer: Any, path: Path) -> None:
        calls.append(path)
        if len(calls) == 3:
            path.write_bytes(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")
        real(buffer, path)

    with monkeypatch.context() as patch:
        patch.setattr(checkpoints, "save_buffer", save)
        assert main(_command("sac", out, "--checkpoint-every", "64")) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("uwoc-gym train: error: checkpoint ")
    assert "No space left on device" in error
    assert "checkpoint-000002 is whole" in error
    assert [path.name for path in out.glob("checkpoint-*")] == ["checkpoint-000002"]
    assert main(["train", "--resume", "--out", str(out)]) == 0
    assert _results(out)["finished"] is True


def test_a_residual_run_flies_by_the_controller_that_it_was_trained_with(tmp_path: Path) -> None:
    out = tmp_path / "run"
    more = ["--residual", "nlpd", "--scale", "0.3", "--frame-stack", "2", "--set", "normalize=true"]
    assert main(_command("ppo", out, *more, steps=64)) == 0
    assert not list(out.rglob("*.pkl"))
    agent = agents.load(str(out), SCENARIO)
    assert isinstance(agent, Agent)
    assert agent.controller is not None
    assert agent.controller.gain_sets[0].a_p == (300.0, 300.0, 300.0)
    action, _ = agent.predict(np.zeros(20, dtype=np.float32), deterministic=True)
    assert action.shape == (3,)
    results = _results(out)
    for path, steps in ((out / "model.zip", results["best"]["steps"]), (out / "last.zip", 64)):
        flight = fly(load(str(path)), SCENARIO, seeds.VALIDATION[:2])
        wanted = next(each for each in results["evaluations"] if each["steps"] == steps)
        assert flight.metrics.return_.mean() == pytest.approx(wanted["return"]["mean"], abs=1e-6)


def test_a_recurrent_agent_forgets_at_an_episodes_start(tmp_path: Path) -> None:
    assert main(_command("recurrent_ppo", tmp_path / "run", steps=64)) == 0
    agent = agents.load(str(tmp_path / "run"), "Random")
    observations = np.random.default_rng(0).normal(size=(4, 2, 20)).astype(np.float32)
    memory, first = None, None
    for k, seen in enumerate(observations):
        action, memory = agent.predict(seen, memory, np.full(2, k == 0), deterministic=True)
        first = action if k == 0 else first
    again, _ = agent.predict(observations[0], memory, np.array([True, False]), deterministic=True)
    assert first is not None
    assert again[0] == pytest.approx(first[0], abs=1e-6)
    assert (again[1] != first[1]).any()


def test_shipped_agents_are_named_by_their_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "trained"
    assert main(_command("ppo", folder / "tiny", steps=64)) == 0
    (folder / "not-an-agent").mkdir()
    found = shipped(folder)
    assert list(found) == ["tiny"]
    assert found["tiny"].description == "PPO trained on uwoc/Random-v0"
    assert found["tiny"].installed()
    monkeypatch.setitem(POLICIES, "tiny", found["tiny"])
    assert fly(load("tiny"), SCENARIO, [0]).metrics.steps[0] == 40.0
    assert shipped(tmp_path / "missing") == {}


def test_an_agent_of_another_layout_is_refused(
    tmp_path: Path, describe_again: Callable[[Path, str, Any], None]
) -> None:
    out = tmp_path / "run"
    assert main(_command("ppo", out, steps=64)) == 0
    scaled = SCENARIO.merged({"observation": {"position_scale_m": 2.0}})
    with pytest.raises(CommandError, match="another observation layout"):
        agents.load(str(out), scaled)
    entries = [entry.name for entry in SCENARIO.observation.entries]
    describe_again(out / "model.zip", "observation.entries", [*entries[:-1], "depth"])
    with pytest.raises(
        CommandError, match="20 entries where the scenario has 20, without 'inside the cone', with 'depth'"
    ):
        agents.load(str(out))


def test_environments_of_others_train_too(tmp_path: Path) -> None:
    settings = [word for setting in SMALL["ppo"] for word in ("--set", setting)]
    options = ["--steps", "128", "--envs", "4", "--eval-episodes", "2", *settings, "--out", str(tmp_path / "run")]
    options += ["--env", "gymnasium:CartPole-v1", "--set", "env_kwargs={}", "--set", "normalize=true"]
    assert main(["train", *options, "--frame-stack", "2"]) == 0
    results = _results(tmp_path / "run")
    assert results["baselines"] == results["scenarios"] == {}
    assert results["best"]["return"]["mean"] > 0.0
    with pytest.raises(CommandError, match="observations are not this package's"):
        load(str(tmp_path / "run"))


def test_a_folder_of_another_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(_command("ppo", out, steps=64)) == 0
    for options, words in (
        ([], ["holds a run already", "--resume"]),
        (["--resume", "--env", "uwoc/Nominal-v0"], ["env = 'uwoc/Random-v0', not 'uwoc/Nominal-v0'"]),
        (["--resume", "--algorithm", "sac"], ["algorithm = 'ppo', not 'sac'"]),
        (["--resume", "--seed", "1"], ["seed = 0, not 1"]),
        (["--resume", "--set", "gamma=0.5"], ["gamma = 0.96, not 0.5"]),
        (["--resume", "--override", "{}"], ["another scenario"]),
    ):
        capsys.readouterr()
        assert main(["train", "--out", str(out), *options]) == 1
        error = capsys.readouterr().err
        assert len(error.splitlines()) == 1
        for word in words:
            assert word in error


@pytest.mark.parametrize("algorithm", ["ppo", "td3"])
def test_a_wish_is_planned_as_it_is_recorded_and_says_its_command(algorithm: str, tmp_path: Path) -> None:
    wish = Wish(
        algorithm=algorithm, override=(SHORT,), steps=64, envs=2, set=tuple(SMALL[algorithm]), seed=3, eval_episodes=2
    )
    job = plans.Job(wish, str(tmp_path / "run"))
    assert main(["train", *wish.words(), "--out", job.folder]) == 0
    recorded = plans.recorded_plan(tmp_path / "run" / "run.json")
    assert shlex.split(recorded["command"]) == shlex.split(job.command)
    for key, value in plans.planned(wish).to_dict().items():
        assert recorded[key] == value


def test_what_tells_of_a_finished_run_is_written_again_where_a_kill_or_damage_took_it(tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert main(_command("ppo", out, steps=64)) == 0
    before, last = _results(out), (out / "last.zip").read_bytes()
    # Killed right after the last checkpoint, and damaged later.
    for left in (json.dumps({**before, "finished": False, "best": None}), '{"finished": tr'):
        (out / "results.json").write_text(left)
        (out / "last.zip").unlink()
        assert main(["train", "--resume", "--out", str(out)]) == 0
        assert {**_results(out), "command": before["command"]} == before
        assert (out / "last.zip").read_bytes() == last


def test_a_damaged_replay_buffer_is_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(_command("sac", out, steps=128)) == 0
    checkpoint = checkpoints.newest(out)
    assert checkpoint is not None
    path = checkpoint / "replay.npz"
    with np.load(path) as saved:
        held = dict(saved)
    capsys.readouterr()
    for changes in ({"pos": -1}, {"pos": 10**6}, {"full": True}, {"actions": held["actions"][:, :, :2]},
                    {"rewards": held["rewards"].astype(complex)}, {"pos": np.array([None])}):  # fmt: skip
        np.savez(path, **{**held, **changes})
        assert main(["train", "--resume", "--out", str(out)]) == 1
        assert f"{path} can't be read: it is damaged" in capsys.readouterr().err
    path.write_bytes(b"PK and nothing more")
    assert main(["train", "--resume", "--out", str(out)]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1

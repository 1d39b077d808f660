"""Training from end to end, with networks and episodes small enough for seconds."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
import yaml
from stable_baselines3 import PPO

from uwoc_gym import Scenario, TrackingVectorEnv, agents
from uwoc_gym.agents import flight as evaluate
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.commands import train
from uwoc_gym.agents.learning import checkpoints as checkpoint
from uwoc_gym.agents.learning import environments as vec_env
from uwoc_gym.agents.learning import seeds, training
from uwoc_gym.agents.learning import settings as hyperparameters
from uwoc_gym.agents.options import CommandError
from uwoc_gym.agents.policies import saved as inference
from uwoc_gym.baselines import NLPDController
from uwoc_gym.sb3 import TrackingVecEnv

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


@pytest.fixture(autouse=True)
def _one_thread() -> None:
    torch.set_num_threads(1)


def _command(algorithm: str, out: Path, *more: str, steps: int = 256) -> list[str]:
    settings = [word for setting in SMALL[algorithm] for word in ("--set", setting)]
    return [
        "train", "--algorithm", algorithm, "--steps", str(steps), "--envs", "4", "--scenario", SHORT,
        "--eval-episodes", "2", *settings, "--out", str(out), *more,
    ]  # fmt: skip


def _results(out: Path) -> dict[str, Any]:
    found = json.loads((out / "results.json").read_text())
    assert isinstance(found, dict)
    return found


@pytest.mark.parametrize("algorithm", hyperparameters.TRAINABLE)
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
    for name in ("settings.yaml", "run.json", "agent.json", "model.zip", "last.zip", "train.log"):
        assert (out / name).is_file()
    assert list((out / "tensorboard").iterdir())
    assert (out / "curve.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    # Plain Stable-Baselines3 loads the file too.
    assert hyperparameters.ALGORITHMS[algorithm].load().load(out / "model.zip", device="cpu") is not None
    seen = [seeds.VALIDATION[i] for i in range(2)]
    for path in (out, out / "model.zip"):
        flight = evaluate.fly(evaluate.load(str(path)), SCENARIO, seen)
        assert flight.metrics.return_.mean() == pytest.approx(results["best"]["return"]["mean"], abs=1e-6)


def test_a_settings_file_that_a_run_has_written_trains_again(tmp_path: Path) -> None:
    assert main(_command("ppo", tmp_path / "a")) == 0
    out = tmp_path / "b"
    file = str(tmp_path / "a" / "settings.yaml")
    options = ["--settings", file, "--scenario", SHORT, "--eval-episodes", "2", "--out", str(out)]
    assert main(["train", "--algorithm", "ppo", *options]) == 0
    a, b = _results(tmp_path / "a"), _results(out)
    assert a["settings"] == b["settings"]
    # The same seed gives the same training.
    assert [each["return"] for each in a["evaluations"]] == [each["return"] for each in b["evaluations"]]


def test_ppo_learns(tmp_path: Path) -> None:
    options = [
        "--steps", "80000", "--envs", "128", "--set", "n_steps=32", "--set", "batch_size=1024",
        "--set", "policy_kwargs.net_arch=[64,64]", "--set", "learning_rate=1e-3", "--set", "gamma=0.95",
        "--scenario", '{"episode": {"duration_s": 10.0}}', "--eval-every", "80000", "--eval-episodes", "16",
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


def _plan_of(out: Path) -> training.Plan:
    from uwoc_gym.agents.commands import train

    class Args:
        algorithm = env = seed = steps = envs = settings = scenario = residual = scale = frame_stack = None
        eval_every = eval_episodes = checkpoint_every = None
        set = None

    plan = train._plan(Args(), json.loads((out / "run.json").read_text()))  # type: ignore[arg-type]
    assert isinstance(plan, training.Plan)
    return plan


@pytest.mark.parametrize("algorithm", ["ppo", "sac"])
def test_an_interrupted_run_goes_on_where_it_stood(
    algorithm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, total = tmp_path / "run", 512
    more = ["--set", "normalize=true", "--set", "learning_rate=lin_1e-3", "--eval-every", "128"]
    remaining: list[float] = []
    kind = hyperparameters.ALGORITHMS[algorithm].load()
    real = kind._update_current_progress_remaining

    def update(self: Any, steps: int, all_steps: int) -> None:
        real(self, steps, all_steps)
        assert self._current_progress_remaining == pytest.approx(1.0 - steps / total)
        remaining.append(self._current_progress_remaining)

    monkeypatch.setattr(kind, "_update_current_progress_remaining", update)
    with monkeypatch.context() as patch:
        _interrupt_at(patch, 3)
        assert main(_command(algorithm, out, *more, steps=total)) == 130
    assert "interrupted at step 256;" in capsys.readouterr().err.splitlines()[-1]
    last = checkpoint.newest(out)
    assert last is not None
    progress = json.loads((last / "progress.json").read_text())
    stood = progress["steps"]
    assert stood == 256
    assert [each["steps"] for each in progress["evaluations"]] == [0, 128, 256]
    half = len(remaining)

    made = training.Run(_plan_of(out), out, "", last)
    saved = kind.load(last / "last.zip", device="cpu")
    assert made.model.num_timesteps == saved.num_timesteps == stood
    assert made.model._n_updates == saved._n_updates > 0
    optimizer = made.model.policy.optimizer if algorithm == "ppo" else made.model.critic.optimizer
    state = (saved.policy.optimizer if algorithm == "ppo" else saved.critic.optimizer).state_dict()["state"]
    assert state
    for key, moments in optimizer.state_dict()["state"].items():
        assert moments["step"] == state[key]["step"] > 0
        assert torch.equal(moments["exp_avg_sq"], state[key]["exp_avg_sq"])
    assert made.statistics is not None
    assert made.statistics.obs_rms.count > 200
    if algorithm == "sac":
        assert made.model.replay_buffer.pos == stood // 4
        assert made.model.replay_buffer.rewards[: stood // 4].any()
        assert not made.model.replay_buffer.rewards[stood // 4 :].any()
    made.env.close()

    assert main(["train", "--resume", "--out", str(out)]) == 0
    results = _results(out)
    assert results["finished"] is True
    assert [each["steps"] for each in results["evaluations"]][:4] == [0, 128, 256, 384]
    assert remaining[half] < remaining[half - 1]
    assert remaining[-1] == pytest.approx(0.0)
    assert kind.load(out / "last.zip", device="cpu").num_timesteps == total
    assert main(["train", "--resume", "--out", str(out)]) == 0
    assert "is finished" in capsys.readouterr().err


def test_a_resumed_run_sees_new_episodes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "run"
    used: list[list[int | None]] = []
    real = TrackingVectorEnv.reset

    def reset(self: TrackingVectorEnv, **options: Any) -> Any:
        if isinstance(options.get("seed"), list):
            used.append(options["seed"])
        return real(self, **options)

    monkeypatch.setattr(TrackingVectorEnv, "reset", reset)
    with monkeypatch.context() as patch:
        _interrupt_at(patch, 2, signal.SIGTERM)
        assert main(_command("ppo", out, "--seed", "3")) == 128 + signal.SIGTERM
    assert main(["train", "--resume", "--out", str(out)]) == 0
    trained = [each for each in used if each[0] is not None and each[0] >= seeds.SPAN]
    assert trained == [[4_000_000 + i for i in range(4)], [4_000_004 + i for i in range(4)]]
    others = {seed for each in used if each not in trained for seed in each}
    assert others == set(seeds.VALIDATION[:2])


def test_seed_ranges_never_meet() -> None:
    trained = range(seeds.training_seed(0), seeds.training_seed(seeds.RUNS - 1) + seeds.SPAN)
    assert not set(seeds.HELD_OUT) & set(seeds.VALIDATION)
    assert max(*seeds.HELD_OUT, *seeds.VALIDATION) < trained.start
    assert trained.stop < 2**32
    assert seeds.training_seed(1) - seeds.training_seed(0) == seeds.SPAN
    with pytest.raises(CommandError, match="used up"):
        seeds.training_seed(0, seeds.SPAN)


def test_a_checkpoint_that_fails_in_the_middle_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "run"
    real, calls = training._save_buffer, []

    def save(buffer: Any, path: Path) -> None:
        calls.append(path)
        if len(calls) == 3:
            path.write_bytes(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")
        real(buffer, path)

    with monkeypatch.context() as patch:
        patch.setattr(training, "_save_buffer", save)
        assert main(_command("sac", out, "--checkpoint-every", "64")) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert error.startswith("uwoc-gym train: error: checkpoint ")
    assert "No space left on device" in error
    assert "checkpoint-000002 is whole" in error
    assert [path.name for path in out.glob("checkpoint-*")] == ["checkpoint-000002"]
    assert main(["train", "--resume", "--out", str(out)]) == 0
    assert _results(out)["finished"] is True


def test_what_a_kill_leaves_behind_is_not_taken_for_a_checkpoint(tmp_path: Path) -> None:
    def fill(folder: Path) -> None:
        (folder / "file").write_text("whole")

    assert checkpoint.newest(tmp_path) is None
    first = checkpoint.write(tmp_path, fill)
    left = tmp_path / "checkpoint-000002.part"
    left.mkdir()
    (left / "file").write_text("ha")
    assert checkpoint.newest(tmp_path) == first
    second = checkpoint.write(tmp_path, fill)
    assert (second.name, (second / "file").read_text()) == ("checkpoint-000002", "whole")
    # Killed between the new name and the removal of the old one.
    (tmp_path / "checkpoint-000001").mkdir()
    assert checkpoint.newest(tmp_path) == second
    assert [path.name for path in tmp_path.iterdir() if path.suffix] == []


def test_inference_stacks_normalises_and_corrects_as_training_does() -> None:
    scenario = SCENARIO.merged({"episode": {"duration_s": 0.5}})
    controller = NLPDController(scenario=scenario)
    values = hyperparameters.OWN | {"normalize": True, "frame_stack": 3, "residual_scale": 0.3}
    base = vec_env.make_base("uwoc/Random-v0", 3, scenario, {})
    base.seed(seeds.training_seed(0))
    env, _, statistics = vec_env.wrapped(base, values, controller, True)
    assert statistics is not None
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=24, n_epochs=1, seed=0, device="cpu")
    model.learn(240)
    statistics.training = False
    env.seed(seeds.training_seed(1))
    plain = TrackingVecEnv("uwoc/Random-v0", 3, seeds.training_seed(1), scenario=scenario)
    agent = inference.Agent(model, statistics.normalize_obs, 3, controller, 0.3)
    stacked, raw = env.reset(), plain.reset()
    memory, begun = None, np.ones(3, dtype=bool)
    for _ in range(35):
        actions, memory = agent.predict(raw, memory, begun, deterministic=True)
        np.testing.assert_array_equal(memory[0], stacked)
        stacked, *_ = env.step(model.predict(stacked, deterministic=True)[0])
        raw, unscaled, begun, _ = plain.step(actions)
        np.testing.assert_allclose(statistics.get_original_obs(), raw, atol=1e-6)
        np.testing.assert_allclose(statistics.get_original_reward(), unscaled, atol=1e-6)
    single, _ = agent.predict(raw[1], deterministic=True)
    batch, _ = agent.predict(raw, deterministic=True)
    assert single == pytest.approx(batch[1], abs=1e-6)


def test_a_residual_run_flies_by_the_controller_that_it_was_trained_with(tmp_path: Path) -> None:
    out = tmp_path / "run"
    more = ["--residual", "nlpd", "--scale", "0.3", "--frame-stack", "2", "--set", "normalize=true"]
    assert main(_command("ppo", out, *more, steps=64)) == 0
    assert (out / "vecnormalize.pkl").is_file()
    agent = agents.load(str(out), SCENARIO)
    assert isinstance(agent, inference.Agent)
    assert agent.controller is not None
    assert agent.controller.gain_sets[0].a_p == (300.0, 300.0, 300.0)
    action, _ = agent.predict(np.zeros(20, dtype=np.float32), deterministic=True)
    assert action.shape == (3,)
    results = _results(out)
    for path, steps in ((out / "model.zip", results["best"]["steps"]), (out / "last.zip", 64)):
        flight = evaluate.fly(evaluate.load(str(path)), SCENARIO, seeds.VALIDATION[:2])
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
    found = evaluate.shipped(folder)
    assert list(found) == ["tiny"]
    assert found["tiny"].description == "PPO trained on uwoc/Random-v0"
    assert found["tiny"].installed()
    monkeypatch.setitem(evaluate.POLICIES, "tiny", found["tiny"])
    assert evaluate.fly(evaluate.load("tiny"), SCENARIO, [0]).metrics.steps[0] == 40.0
    assert evaluate.shipped(tmp_path / "missing") == {}


def test_an_agent_of_another_layout_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "run"
    assert main(_command("ppo", out, steps=64)) == 0
    scaled = SCENARIO.merged({"observation": {"position_scale_m": 2.0}})
    with pytest.raises(CommandError, match="another observation layout"):
        agents.load(str(out), scaled)
    described = json.loads((out / "agent.json").read_text())
    described["observation"]["entries"] = described["observation"]["entries"][:-1]
    (out / "agent.json").write_text(json.dumps(described))
    with pytest.raises(CommandError, match="another observation layout: 19 entries where this version has 20"):
        agents.load(str(out))
    (out / "agent.json").write_text("{}")
    with pytest.raises(CommandError, match="doesn't describe an agent"):
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
        evaluate.load(str(tmp_path / "run"))


def test_ids_of_others_over_our_fleet_use_it() -> None:
    name = "OthersTracking-v0"
    gym.register(
        name,
        "uwoc_gym.env:TrackingEnv",
        vector_entry_point="uwoc_gym.vector_env:TrackingVectorEnv",
        kwargs={"scenario_name": "Random", "control_period_s": 0.1},
    )
    try:
        scenario = vec_env.base_scenario(name)
        assert scenario is not None
        assert scenario.episode.control_period_s == 0.1
        assert isinstance(vec_env.make_base(name, 2, scenario, {}), TrackingVecEnv)
    finally:
        del gym.registry[name]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--algorithm", "pppo"], ["--algorithm 'pppo'", "did you mean 'ppo'?"]),
        (["--env", "uwoc/Randm-v0"], ["--env", "Randm"]),
        (["--env", "no_such_module:Thing-v0"], ["--env", "no_such_module"]),
        (["--set", "n_stepz=3"], ["--set", "'n_stepz'", "did you mean 'n_steps'?"]),
        (["--set", "n_steps"], ["--set 'n_steps'", "key=value"]),
        (["--set", "n_steps=many"], ["n_steps = 'many'", "whole number of at least 1"]),
        (["--set", "n_steps=1.5"], ["n_steps = 1.5", "whole number"]),
        (["--set", "gamma=2"], ["gamma = 2", "[0, 1]"]),
        (["--set", "learning_rate=log_3"], ["learning_rate = 'log_3'", "lin_3e-4"]),
        (["--set", "policy=MlpPolicyy"], ["policy = 'MlpPolicyy'", "did you mean 'MlpPolicy'?"]),
        (["--set", "policy_kwargs.net_arc=[3]"], ["'net_arc'", "did you mean 'net_arch'?"]),
        (["--set", "policy_kwargs.activation_fn=nn.Nothing"], ["nn.Nothing", "nn.ReLU"]),
        (["--set", "policy_kwargs=dict(net_arch=open('x'))"], ["only dict(...)"]),
        (["--set", "noise_type=normal"], ["noise_type", "own randomness"]),
        (["--set", "normalize=maybe"], ["normalize = 'maybe'", "norm_obs"]),
        (["--set", "env_kwargs.scenario.episode.duration=3"], ["env_kwargs.scenario", "did you mean 'duration_s'?"]),
        (["--set", "env_kwargs.control_period=3"], ["'control_period'", "did you mean 'control_period_s'?"]),
        (["--settings", "missing.yaml"], ["missing.yaml", "can't be read"]),
        (["--settings", __file__], ["aren't valid YAML"]),
        (["--scenario", "missing.json"], ["--scenario", "missing.json"]),
        (["--scenario", '{"episod": {}}'], ["--scenario", "did you mean 'episode'?"]),
        (["--residual", "nlpdd"], ["residual = 'nlpdd'", "did you mean 'nlpd'?"]),
        (["--residual", "nlpd", "--scale", "3"], ["residual_scale = 3.0", "(0, 2]"]),
        (["--eval-episodes", "65"], ["--eval-episodes 65", "64 validation seeds"]),
        (["--seed", "4000"], ["--seed 4000", "3999"]),
        (["--resume"], ["--resume", "no run in"]),
        (["--out", f"{__file__}/out"], ["--out", "folder"]),
    ],
)
def test_errors_are_one_line(
    options: list[str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", "--out", str(tmp_path), *options]) not in (0, 130)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    for word in words:
        assert word in captured.err


def test_an_unknown_key_in_a_file_names_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text("default:\n  gama: 0.9\n")
    assert main(["train", "--settings", str(path), "--out", str(tmp_path / "run")]) == 1
    error = capsys.readouterr().err
    assert str(path) in error
    assert "'gama'; did you mean 'gamma'?" in error


def test_a_folder_of_another_run_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "run"
    assert main(_command("ppo", out, steps=64)) == 0
    for options, words in (
        ([], ["holds a run already", "--resume"]),
        (["--resume", "--env", "uwoc/Nominal-v0"], ["env = 'uwoc/Random-v0', not 'uwoc/Nominal-v0'"]),
        (["--resume", "--algorithm", "sac"], ["algorithm = 'ppo', not 'sac'"]),
        (["--resume", "--seed", "1"], ["seed = 0, not 1"]),
        (["--resume", "--set", "gamma=0.5"], ["gamma = 0.98, not 0.5"]),
        (["--resume", "--scenario", "{}"], ["another scenario"]),
    ):
        capsys.readouterr()
        assert main(["train", "--out", str(out), *options]) == 1
        error = capsys.readouterr().err
        assert len(error.splitlines()) == 1
        for word in words:
            assert word in error


@pytest.mark.parametrize("missing", ["stable_baselines3", "tensorboard", "yaml", "sb3_contrib"])
def test_a_missing_extra_is_named(
    missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import importlib.util

    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else real(name))
    assert main(["train", "--algorithm", "tqc", "--out", str(tmp_path)]) == 1
    assert 'pip install "uwoc-gym[agents]"' in capsys.readouterr().err


def test_every_settings_file_is_in_the_zoos_format() -> None:
    for algorithm in hyperparameters.TRAINABLE:
        entries = yaml.safe_load((hyperparameters.FOLDER / f"{algorithm}.yaml").read_text())
        assert "default" in entries
        for env_id, given in entries.items():
            values, _ = hyperparameters.resolve(algorithm, env_id)
            # Texts that YAML took a number for would be an error there.
            assert {key: values[key] for key in given} == given
            assert not {"residual", "residual_scale"} & set(given)


def test_policy_arguments_in_the_style_of_the_zoo() -> None:
    text = "policy_kwargs='dict(net_arch=[64, 32], activation_fn=nn.ReLU, log_std_init=-2)'"
    values, _ = hyperparameters.resolve("ppo", "uwoc/Random-v0", [text, "policy_kwargs.net_arch=[8]", "gamma=9e-1"])
    assert values["policy_kwargs"] == {"net_arch": [8], "activation_fn": "nn.ReLU", "log_std_init": -2}
    assert values["gamma"] == 0.9
    assert hyperparameters.constructor_arguments("ppo", values, 3)["policy_kwargs"]["activation_fn"] is torch.nn.ReLU


def test_the_package_stays_light() -> None:
    code = (
        "import sys, uwoc_gym, uwoc_gym.agents.cli; "
        "print([name for name in ('torch', 'stable_baselines3', 'matplotlib') if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.parametrize(
    ("algorithm", "setting", "message"),
    [
        ("td3", "normalize=true", "normalize = True is not allowed with frame_stack = 4"),
        ("sac", "train_freq=[1, episode]", "train_freq = [1, 'episode'] is not allowed with n_envs = 16"),
        ("ppo", "policy_kwargs.net_arch=[64, -1]", "policy_kwargs.net_arch = [64, -1] is not allowed"),
        ("ppo", "target_kl=abc", "target_kl = 'abc' is not allowed; it must be a number"),
        ("ppo", "normalize={clip_obs: abc}", "clip_obs is a number of at least 0"),
        ("ppo", "normalize={norm_obs: 1}", "norm_obs is true or false"),
        ("ppo", "residual_scale=3", "it must be a number in (0, 2]"),
    ],
)
def test_settings_that_would_fail_later_are_refused(algorithm: str, setting: str, message: str) -> None:
    with pytest.raises(CommandError, match=re.escape(message)):
        hyperparameters.resolve(algorithm, "uwoc/Random-v0", [setting])


@pytest.mark.parametrize("algorithm", ["ppo", "td3"])
def test_a_protocols_training_is_planned_as_it_is_recorded(algorithm: str, tmp_path: Path) -> None:
    settings = [word for setting in SMALL[algorithm] for word in ("--set", setting)]
    words = ["--algorithm", algorithm, "--steps", "64", "--envs", "2", "--eval-episodes", "2", *settings]
    words += ["--out", str(tmp_path / "run")]
    assert main(["train", *words]) == 0
    recorded = json.loads((tmp_path / "run" / "run.json").read_text())
    for key, value in train.planned(words).items():
        assert recorded[key] == value

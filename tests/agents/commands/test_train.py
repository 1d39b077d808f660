"""What `uwoc-gym train` refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from uwoc_gym.agents.cli import main


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--algorithm", "pppo"], ["--algorithm 'pppo'", "did you mean 'ppo'?"]),
        (["--env", "uwoc/Randm-v0"], ["--env", "Randm"]),
        (["--env", "no_such_module:Thing-v0"], ["--env", "no_such_module"]),
        (["--set", "n_stepz=3"], ["--set", "'n_stepz'", "did you mean 'n_steps'?"]),
        (["--set", "n_steps"], ["--set 'n_steps'", "key=value"]),
        (["--set", "n_steps=many"], ["n_steps = 'many'", "whole number from 1 to"]),
        (["--set", "n_steps=1.5"], ["n_steps = 1.5", "whole number"]),
        (["--set", "gamma=2"], ["gamma = 2", "[0, 1]"]),
        (["--set", "learning_rate=log_3"], ["learning_rate = 'log_3'", "lin_3e-4"]),
        (["--set", "policy=MlpPolicyy"], ["policy = 'MlpPolicyy'", "did you mean 'MlpPolicy'?"]),
        (["--set", "policy_kwargs.net_arc=[3]"], ["'net_arc'", "did you mean 'net_arch'?"]),
        (["--set", "policy_kwargs.activation_fn=nn.Nothing"], ["nn.Nothing", "nn.ReLU"]),
        (["--set", "policy_kwargs=dict(net_arch=open('x'))"], ["must be dict(...)"]),
        (["--set", "noise_type=normal"], ["noise_type", "own randomness"]),
        (["--set", "normalize=maybe"], ["normalize = 'maybe'", "norm_obs"]),
        (["--set", "env_kwargs.scenario.episode.duration=3"], ["env_kwargs.scenario", "did you mean 'duration_s'?"]),
        (["--set", "env_kwargs.control_period=3"], ["'control_period'", "did you mean 'control_period_s'?"]),
        (["--settings", "missing.yaml"], ["missing.yaml", "can't be read"]),
        (["--settings", __file__], ["test_train.py isn't valid YAML"]),
        (["--scenario", "missing.json"], ["--scenario", "missing.json"]),
        (["--override", "missing.json"], ["--override", "missing.json"]),
        (["--override", '{"episod": {}}'], ["--override", "did you mean 'episode'?"]),
        (["--scenario", "Random", "--env", "uwoc/Random-v0"], ["--scenario", "beside --env"]),
        (["--env", "CartPole-v1", "--override", "{}"], ["--override", "'CartPole-v1'"]),
        (["--residual", "nlpdd"], ["residual = 'nlpdd'", "did you mean 'nlpd'?"]),
        (["--residual", "nlpd", "--scale", "3"], ["--scale: '3'", "to 2.0"]),
        (["--eval-episodes", "100001"], ["--eval-episodes: '100001'", "from 2 to 100_000"]),
        (["--seed", "4000"], ["--seed: '4000'", "3_999"]),
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


@pytest.mark.parametrize("missing", ["stable_baselines3", "tensorboard", "yaml", "sb3_contrib"])
def test_a_missing_extra_is_named(
    missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import importlib.util

    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else real(name))
    assert main(["train", "--algorithm", "tqc", "--out", str(tmp_path)]) == 1
    assert 'pip install "uwoc-gym[agents]"' in capsys.readouterr().err

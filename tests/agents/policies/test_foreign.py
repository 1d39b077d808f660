"""Files that hold pickled objects: what is only to be read runs nothing, and what is trusted flies."""

from __future__ import annotations

import base64
import json
import pickle
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.vec_env import VecNormalize

from uwoc_gym import Scenario, agents
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.policies.registry import load
from uwoc_gym.sb3 import TrackingVecEnv

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 5.0}})
BRIEF = ["--scenario", "Random", "--override", '{"episode": {"duration_s": 0.5}}']

Rewrite = Callable[[Path, Mapping[str, bytes | None]], None]


class Malice:
    """An object that, where it is unpickled, leaves a file."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def _planted(data: bytes, mark: Path) -> bytes:
    """What Stable-Baselines3 keeps beside the weights, with an object in it that does harm."""
    settings = json.loads(data)
    harm = base64.b64encode(pickle.dumps(Malice(mark))).decode()
    for value in settings.values():
        if isinstance(value, dict) and ":serialized:" in value:
            value[":serialized:"] = harm
    return json.dumps(settings).encode()


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short run that has a checkpoint to go on from."""
    out = tmp_path_factory.mktemp("foreign") / "run"
    words = ["--steps", "64", "--envs", "4", "--eval-episodes", "2", "--set", "normalize=true", "--frame-stack", "1"]
    words += [
        "--set",
        "n_steps=16",
        "--set",
        "batch_size=32",
        "--set",
        "n_epochs=1",
        "--set",
        "policy_kwargs.net_arch=[8]",
    ]
    assert main(["train", *words, "--override", '{"episode": {"duration_s": 2.0}}', "--out", str(out)]) == 0
    return out


@pytest.fixture
def infected(trained: Path, tmp_path: Path, rewrite: Rewrite) -> tuple[Path, Path]:
    """A run whose every file is as a villain would have it, and the mark that is left where one of them is run."""
    import shutil

    run, mark = tmp_path / "run", tmp_path / "mark"
    shutil.copytree(trained, run)
    harm = pickle.dumps(Malice(mark))
    for path in run.rglob("*.zip"):
        with zipfile.ZipFile(path) as archive:
            data = archive.read("data")
        rewrite(path, {"data": _planted(data, mark), "vecnormalize.pkl": harm})
    for folder in (run, *run.glob("checkpoint-*")):
        for name in ("vecnormalize.pkl", "model.vecnormalize.pkl", "last.vecnormalize.pkl", "best.vecnormalize.pkl"):
            (folder / name).write_bytes(harm)
    return run, mark


def _readers(model: str, tmp_path: Path) -> dict[str, list[str]]:
    """A command line of each command that reads policies."""
    return {
        "evaluate": ["evaluate", model, "--seeds", "1", *BRIEF],
        "benchmark": ["benchmark", "--policy", model, "--seeds", "1", *BRIEF, "--out", str(tmp_path / "out")],
        "replay": ["replay", "--policy", model, *BRIEF, "--out", str(tmp_path / "a.html")],
        "record": [
            "record",
            "--policy",
            model,
            *BRIEF,
            "--size",
            "320x180",
            "--fps",
            "5",
            "--out",
            str(tmp_path / "a.gif"),
        ],
        "watch": ["watch", "--policy", model, *BRIEF, "--size", "320x180"],
    }


@pytest.fixture
def glance(monkeypatch: pytest.MonkeyPatch) -> None:
    """Closes the window of `watch` after the first picture."""
    from uwoc_gym.agents.viewing.player import Player

    real = Player.frame
    monkeypatch.setattr(Player, "frame", lambda self: real(self) and False)


COMMANDS = ("evaluate", "benchmark", "replay", "record", "watch")


@pytest.mark.usefixtures("glance")
@pytest.mark.parametrize("command", COMMANDS)
def test_reading_our_agents_runs_nothing(command: str, infected: tuple[Path, Path], tmp_path: Path) -> None:
    run, mark = infected
    for path in (run, run / "last.zip"):
        for trust in ([], ["--trust"]):
            (tmp_path / "a.html").unlink(missing_ok=True)
            (tmp_path / "a.gif").unlink(missing_ok=True)
            assert main([*_readers(str(path), tmp_path)[command], *trust]) == 0
    agents.load(str(run), "Random", trust=True)
    assert not mark.exists()


def test_going_on_with_a_run_runs_nothing(infected: tuple[Path, Path]) -> None:
    run, mark = infected
    results = json.loads((run / "results.json").read_text())
    progress = next(run.glob("checkpoint-*")) / "progress.json"
    progress.write_text(json.dumps({**json.loads(progress.read_text()), "finished": False}))
    assert results["finished"]
    assert main(["train", "--resume", "--out", str(run)]) == 0
    assert not mark.exists()


@pytest.mark.usefixtures("glance")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_of_others_is_run_by_none_but_who_trusts_it(
    command: str, infected: tuple[Path, Path], tmp_path: Path, rewrite: Rewrite, capsys: pytest.CaptureFixture[str]
) -> None:
    run, mark = infected
    path = run / "model.zip"
    rewrite(path, {"agent.json": None})
    words = _readers(str(path), tmp_path)[command]
    assert main(words) == 1
    error = capsys.readouterr().err
    assert not mark.exists()
    assert len(error.splitlines()) == 1
    assert str(path) in error
    assert "saved by Stable-Baselines3 alone" in error
    assert "give --trust, or trust=True in Python" in error
    with pytest.raises(CommandError, match="give --trust"):
        agents.load(str(path))
    assert not mark.exists()
    # The harm done, it is no model; that is all that is known of it.
    assert main([*words, "--trust"]) == 1
    assert mark.exists()


def test_weights_that_hold_more_than_tensors_are_not_run(
    infected: tuple[Path, Path], tmp_path: Path, rewrite: Rewrite, describe_again: Callable[[Path, str, Any], None]
) -> None:
    import hashlib

    run, mark = infected
    with (tmp_path / "weights").open("w+b") as file:
        torch.save(Malice(mark), file)
    for harm in ((tmp_path / "weights").read_bytes(), pickle.dumps(Malice(mark))):
        rewrite(run / "model.zip", {"policy.pth": harm})
        describe_again(run / "model.zip", "policy_sha256", hashlib.sha256(harm).hexdigest())
        with pytest.raises(CommandError, match=r"model.zip' can't be read: its policy.pth is not tensors alone"):
            agents.load(str(run), trust=True)
        assert not mark.exists()


def test_nothing_else_reads_pickles() -> None:
    root = Path(agents.__file__).parent
    words = ("import pickle", "pickle.load", "cloudpickle", "VecNormalize.load", "allow_pickle=True", ".load().load(")
    found = {path.name for path in root.rglob("*.py") if any(word in path.read_text("utf-8") for word in words)}
    # What a cluster sends itself, as processes of one machine do.
    assert found == {"foreign.py", "cluster.py"}
    loads = [
        line for path in root.rglob("*.py") for line in path.read_text("utf-8").splitlines() if "torch.load(" in line
    ]
    assert len(loads) == 1
    assert "weights_only=True" in loads[0]


def test_policy_from_a_saved_model(tmp_path: Path) -> None:
    env = VecNormalize(TrackingVecEnv("uwoc/Random-v0", 2, seed=0))
    for kind, model in (
        ("PPO", PPO("MlpPolicy", env, n_steps=8, batch_size=16, policy_kwargs={"net_arch": [4]}, device="cpu", seed=0)),
        ("SAC", SAC("MlpPolicy", env, buffer_size=10, policy_kwargs={"net_arch": [4]}, device="cpu", seed=0)),
    ):
        path = tmp_path / f"{kind}.zip"
        model.save(path)
        policy = load(str(path), trust=True)
        assert kind in policy.description
        observations = np.random.default_rng(0).normal(size=(3, 20)).astype(np.float32)
        plain = policy.make(SHORT).predict(observations, deterministic=True)[0]
        assert plain == pytest.approx(model.predict(observations, deterministic=True)[0], abs=1e-6)
        env.obs_rms.mean += 0.5
        env.save(str(tmp_path / "vecnormalize.pkl"))
        normalised = load(str(path), trust=True).make(SHORT).predict(observations, deterministic=True)[0]
        wanted = model.predict(env.normalize_obs(observations), deterministic=True)[0]
        assert normalised == pytest.approx(wanted, abs=1e-6)
        assert fly(policy, SHORT, [0, 1]).metrics.steps.tolist() == [100.0, 100.0]
        (tmp_path / "vecnormalize.pkl").unlink()


def _agent_of_version_0_1(path: Path, residual: Any = None) -> tuple[PPO, VecNormalize]:
    """Write an agent as version 0.1 did."""
    env = VecNormalize(TrackingVecEnv("uwoc/Random-v0", 2, seed=0))
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=16, policy_kwargs={"net_arch": [4]}, device="cpu", seed=0)
    model.learn(64)
    model.save(path / "model.zip")
    env.save(str(path / "vecnormalize.pkl"))
    seen = SHORT.observation
    described = {
        "format": 1, "description": "PPO trained on uwoc/Random-v0", "algorithm": "ppo", "env": "uwoc/Random-v0",
        "observation": {"entries": [entry.name for entry in seen.entries], "scales": seen.scales},
        "control_period_s": 0.05, "normalize": True, "frame_stack": 1, "residual": residual,
    }  # fmt: skip
    (path / "agent.json").write_text(json.dumps(described))
    return model, env


def test_an_agent_of_version_0_1_flies_where_it_is_trusted(tmp_path: Path) -> None:
    model, env = _agent_of_version_0_1(tmp_path)
    with pytest.raises(CommandError, match=r"an agent of version 0\.1: it holds pickled objects.* give --trust"):
        load(str(tmp_path))
    observations = np.random.default_rng(0).normal(size=(3, 20)).astype(np.float32)
    agent = load(str(tmp_path), trust=True).make(SHORT)
    wanted = model.predict(env.normalize_obs(observations), deterministic=True)[0]
    np.testing.assert_array_equal(agent.predict(observations, deterministic=True)[0], wanted)
    described = json.loads((tmp_path / "agent.json").read_text())
    (tmp_path / "agent.json").write_text(json.dumps({**described, "observation": None}))
    with pytest.raises(CommandError, match=r"agent.json' doesn't describe an agent"):
        load(str(tmp_path), trust=True)


def test_a_run_of_version_0_1_is_not_gone_on_with(
    trained: Path, tmp_path: Path, rewrite: Rewrite, capsys: pytest.CaptureFixture[str]
) -> None:
    import shutil

    run = tmp_path / "run"
    shutil.copytree(trained, run)
    rewrite(next(run.glob("checkpoint-*")) / "last.zip", {"agent.json": None})
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    assert main(["train", "--resume", "--out", str(run)]) == 1
    assert "is of version 0.1, whose checkpoints hold pickled objects" in capsys.readouterr().err.splitlines()[-1]
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before

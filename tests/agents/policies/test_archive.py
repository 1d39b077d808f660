"""The file of an agent: it flies as the model did, bit for bit, and what is wrong with it is said in one line."""

from __future__ import annotations

import hashlib
import io
import json
import time
import tracemalloc
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import VecNormalize

from uwoc_gym import Scenario
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning import environments, settings
from uwoc_gym.agents.policies import archive, registry, saved
from uwoc_gym.agents.policies.algorithms import ALGORITHMS, policy_arguments
from uwoc_gym.sb3 import TrackingVecEnv

SCENARIO = Scenario.named("Random").merged({"episode": {"duration_s": 2.0}})
ON = {"n_steps": 16, "batch_size": 32, "n_epochs": 1}
OFF = {"buffer_size": 1000, "batch_size": 16, "learning_starts": 50}

KINDS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "ppo": ("ppo", ON, {"net_arch": [8], "activation_fn": "nn.ReLU", "log_std_init": -1.0}),
    "ppo, two networks": ("ppo", ON, {"net_arch": {"pi": [8, 4], "vf": [6]}, "ortho_init": False}),
    "ppo, gSDE": ("ppo", {**ON, "use_sde": True}, {"net_arch": [8]}),
    "recurrent_ppo": ("recurrent_ppo", ON, {"net_arch": [8], "lstm_hidden_size": 4, "n_lstm_layers": 2}),
    "sac": ("sac", OFF, {"net_arch": [8], "n_critics": 1, "optimizer_class": "SGD"}),
    "sac, gSDE": ("sac", {**OFF, "use_sde": True}, {"net_arch": [8]}),
    "td3": ("td3", OFF, {"net_arch": [8]}),
    "tqc": ("tqc", OFF, {"net_arch": [8], "n_quantiles": 5}),
}


def _saved(path: Path, kind: str, normalised: bool = True) -> tuple[Any, VecNormalize | None]:
    """Train some hundred steps, and save the agent."""
    algorithm, arguments, policy = KINDS[kind]
    env: Any = TrackingVecEnv("uwoc/Random-v0", 4, seed=0, scenario=SCENARIO)
    if normalised:
        env = VecNormalize(env, clip_obs=3.0, epsilon=1e-6)
    made = {**arguments, "policy_kwargs": policy_arguments(policy)}
    network = "MlpLstmPolicy" if algorithm == "recurrent_ppo" else "MlpPolicy"
    model = ALGORITHMS[algorithm].load()(network, env, seed=0, device="cpu", **made)
    model.learn(400)
    statistics = env if normalised else None
    values = {**settings.OWN, **arguments, "policy": network, "policy_kwargs": policy}
    normalisation = environments.normalisation_of(statistics)
    said = saved.describe("uwoc/Random-v0", "Random", algorithm, values, SCENARIO, None, normalisation)
    with path.open("w+b") as file:
        archive.write(model, said, file)
    return model, statistics


def test_every_algorithm_that_trains_is_tried() -> None:
    assert {algorithm for algorithm, _, _ in KINDS.values()} == set(settings.TRAINABLE)


@pytest.mark.parametrize("kind", KINDS)
def test_the_agent_acts_as_the_model_does_bit_for_bit(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "model.zip"
    model, statistics = _saved(path, kind)
    assert statistics is not None
    agent = registry.load(str(path)).make(SCENARIO)
    rng = np.random.default_rng(0)
    memory, own = None, None
    for step in range(20):
        observations = rng.normal(0.0, 2.0, (5, 20)).astype(np.float32)
        begun = np.full(5, step == 0) | (rng.random(5) < 0.1)
        sure = step % 2 == 0
        if not sure and model.use_sde:
            for policy in (model.policy, agent.model):  # type: ignore[attr-defined]
                torch.manual_seed(step)
                policy.reset_noise()
        torch.manual_seed(step)
        wanted, own = model.predict(statistics.normalize_obs(observations), own, begun, deterministic=sure)
        torch.manual_seed(step)
        found, memory = agent.predict(observations, memory, begun, deterministic=sure)
        np.testing.assert_array_equal(found, wanted)
    # Who uses Stable-Baselines3 by itself can read the file too.
    plain = ALGORITHMS[KINDS[kind][0]].load().load(path, device="cpu")
    given = statistics.normalize_obs(observations)
    np.testing.assert_array_equal(
        plain.predict(given, deterministic=True)[0], model.predict(given, deterministic=True)[0]
    )


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("archive") / "model.zip"
    _saved(path, "ppo")
    return path


@pytest.fixture
def agent_file(whole: Path, tmp_path: Path) -> Path:
    path = tmp_path / "model.zip"
    path.write_bytes(whole.read_bytes())
    return path


def _refusal(path: Path) -> str:
    """What is said about a file; in bounded time and memory."""
    tracemalloc.start()
    begun = time.perf_counter()
    try:
        with pytest.raises(CommandError) as caught:
            registry.load(str(path)).make(SCENARIO)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert time.perf_counter() - begun < 10.0
    assert peak < 2**27
    text = str(caught.value)
    assert len(text.splitlines()) == 1
    assert len(text) < 1000 + len(str(path))
    assert path.name in text
    return text


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("format", 1, ["format = 1", "reads 2"]),
        ("format", ..., ["format = None"]),
        ("algorithm", "pppo", ["algorithm = 'pppo'", "one of ppo, sac"]),
        ("algorithm", ["ppo"], ["algorithm = ['ppo']"]),
        ("env", None, ["env = None"]),
        ("observation", {}, ["observation = {}", "entries and actions"]),
        ("observation.entries", "all", ["observation", "entries"]),
        ("observation.actions", ["surge force"], ["don't fit"]),
        ("observation.scales.position_scale_m", "4", ["observation"]),
        ("control_period_s", -1.0, ["control_period_s = -1.0", "above 0"]),
        ("policy", "MlpPolicyy", ["policy = 'MlpPolicyy'", "MlpPolicy"]),
        ("policy", 3, ["policy = 3"]),
        ("policy_kwargs", None, ["policy_kwargs = None"]),
        ("policy_kwargs.net_arch", [9], ["don't fit"]),
        ("policy_kwargs.net_arch", [10**9], ["policy_kwargs", "nothing of that size"]),
        ("policy_kwargs.net_arch", [8] * 10**5, ["policy_kwargs", "nothing of that size"]),
        ("policy_kwargs.net_arch", {"pi": [10**9]}, ["nothing of that size"]),
        ("policy_kwargs.net_arch", ["8"], ["don't fit"]),
        ("policy_kwargs.nonsense", 3, ["don't fit", "nonsense"]),
        ("policy_kwargs.activation_fn", "nn.Nothing", ["nn.Nothing", "nn.ReLU"]),
        ("policy_kwargs.activation_fn", "nn.Parameter", ["nn.Parameter"]),
        ("policy_kwargs.optimizer_class", "lr_scheduler", ["lr_scheduler"]),
        ("use_sde", 1, ["use_sde = 1", "true or false"]),
        ("use_sde", True, ["don't fit"]),
        ("frame_stack", 0, ["frame_stack = 0", "at least 1"]),
        ("frame_stack", 10**12, ["frame_stack = 1000000000000", "nothing of that size"]),
        ("frame_stack", 2.0, ["frame_stack = 2.0"]),
        ("normalisation", {}, ["normalisation = {}"]),
        ("normalisation.observations.mean", [0.0], ["normalisation"]),
        ("normalisation.observations", {"mean": [0.0], "variance": [1.0], "count": 1.0}, ["shape (1,)", "20 entries"]),
        ("normalisation.observations.variance", [-1.0] * 20, ["normalisation"]),
        ("normalisation.observations.variance", [10**400] * 20, ["normalisation"]),
        ("normalisation.observations.count", 0, ["normalisation"]),
        ("normalisation.clip", "10", ["normalisation"]),
        ("residual", {"gains": {}, "scale": 0.5}, ["residual that is not allowed"]),
        ("residual", {"gains": {"a_p": 3}, "scale": 0.5}, ["residual that is not allowed"]),
        ("residual", {"gains": 3, "scale": 0.5}, ["residual =", "with gains, the name of a policy"]),
        ("residual", {"policy": 3, "scale": 0.5}, ["residual =", "with gains, the name of a policy"]),
        ("residual", {"agent": "../corrected.zip", "scale": 0.5}, ["residual ="]),
        ("residual", {"agent": "corrected.zip", "scale": 0.5}, ["corrected.zip"]),
        ("residual", {"policy": "os:abort", "scale": 0.5}, ["which is code", "--trust"]),
        ("residual", {"policy": "nobody", "scale": 0.5}, ["no policy 'nobody'"]),
        ("beliefs", [], ["beliefs = []", "null or a list of the entries that filters add"]),
        ("beliefs", ["a", 3], ["beliefs = ['a', 3]"]),
        ("beliefs", ["one"], ["shape (20,)", "21 entries"]),
        ("policy_sha256", "0" * 64, ["not of one agent"]),
        ("policy_sha256", 3, ["policy_sha256 = 3"]),
    ],
)
def test_a_damaged_description_is_one_line(
    field: str, value: Any, words: list[str], agent_file: Path, describe_again: Callable[[Path, str, Any], None]
) -> None:
    describe_again(agent_file, field, value)
    text = _refusal(agent_file)
    for word in words:
        assert word in text


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", ["is no JSON"]),
        (b"[" * 100_000, ["is no JSON"]),
        (b"[]", ["not an object"]),
        (b"\xff\xfe", ["is no JSON"]),
        (b'{"format": 2, "description": ' + b"[" * 900 + b"]" * 900 + b"}", ["nested more than 32 levels"]),
        (b'{"format": NaN}', ["NaN is not a number"]),
        (b" " * (2**24 + 1), ["16777217 bytes", "16777216 at most"]),
    ],
)
def test_a_description_that_is_none_is_one_line(
    text: bytes, words: list[str], agent_file: Path, rewrite: Callable[[Path, Mapping[str, bytes | None]], None]
) -> None:
    rewrite(agent_file, {"agent.json": text})
    found = _refusal(agent_file)
    for word in words:
        assert word in found


def test_weights_of_another_agent_are_refused(
    agent_file: Path, tmp_path: Path, rewrite: Callable[[Path, Mapping[str, bytes | None]], None]
) -> None:
    _saved(tmp_path / "other.zip", "ppo", normalised=False)
    with zipfile.ZipFile(tmp_path / "other.zip") as other:
        rewrite(agent_file, {"policy.pth": other.read("policy.pth")})
    assert "not of one agent" in _refusal(agent_file)
    rewrite(agent_file, {"policy.pth": None})
    assert "policy.pth" in _refusal(agent_file)


def test_a_file_damaged_anywhere_is_one_line_or_flies_the_same(agent_file: Path) -> None:
    data = agent_file.read_bytes()
    observations = np.random.default_rng(0).normal(size=(5, 20)).astype(np.float32)
    wanted = registry.load(str(agent_file)).make(SCENARIO).predict(observations, deterministic=True)[0]
    rng = np.random.default_rng(1)
    refused = []
    for k in range(150):
        cut = bytearray(data)
        if k % 3 == 0:
            del cut[int(rng.integers(len(cut))) :]
        else:
            for place in rng.integers(len(cut), size=1 if k % 3 == 1 else 40):
                cut[place] ^= int(rng.integers(1, 256))
        agent_file.write_bytes(cut)
        try:
            agent = registry.load(str(agent_file)).make(SCENARIO)
        except CommandError as error:
            refused.append(str(error))
        else:
            np.testing.assert_array_equal(agent.predict(observations, deterministic=True)[0], wanted)
    assert len(refused) > 60
    assert {len(text.splitlines()) for text in refused} == {1}


def test_what_only_training_needs_is_left_out_for_acting(agent_file: Path, tmp_path: Path) -> None:
    target = tmp_path / "shipped.zip"
    with target.open("w+b") as file:
        archive.write_for_acting(agent_file, file, "an agent")
    assert target.stat().st_size < agent_file.stat().st_size
    assert archive.read(target).description == "an agent"
    with zipfile.ZipFile(agent_file) as before, zipfile.ZipFile(target) as after:
        assert sorted(before.namelist()) == sorted(after.namelist())
        said, kept = (json.loads(each.read("agent.json")) for each in (before, after))
        assert {**said, "description": "an agent"} == kept
        assert before.read("policy.pth") == after.read("policy.pth")


def test_what_is_not_finite_is_not_saved(tmp_path: Path, whole: Path) -> None:
    said = archive.read(whole)
    assert said.normalisation is not None
    said.normalisation.returns.mean[...] = np.nan
    with (tmp_path / "a.zip").open("w+b") as file, pytest.raises(CommandError, match="the training has diverged"):
        archive.write(_Bare(whole), said, file)


class _Bare:
    """What saves as a model does, by copying a file."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def save(self, file: Any) -> None:
        with zipfile.ZipFile(self._path) as archive, zipfile.ZipFile(file, "w") as copy:
            copy.writestr("policy.pth", archive.read("policy.pth"))


def test_weights_that_are_not_finite_are_refused(
    agent_file: Path,
    rewrite: Callable[[Path, Mapping[str, bytes | None]], None],
    describe_again: Callable[[Path, str, Any], None],
) -> None:
    with zipfile.ZipFile(agent_file) as held:
        weights = torch.load(io.BytesIO(held.read("policy.pth")), weights_only=True)
    weights["log_std"][1] = np.nan
    broken = io.BytesIO()
    torch.save(weights, broken)
    rewrite(agent_file, {"policy.pth": broken.getvalue()})
    describe_again(agent_file, "policy_sha256", hashlib.sha256(broken.getvalue()).hexdigest())
    assert "its weights are not all finite" in _refusal(agent_file)

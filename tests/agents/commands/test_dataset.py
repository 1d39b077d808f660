"""`uwoc-gym dataset`: what Minari loads flies again bit for bit, and what can't be written leaves nothing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("minari")
pytest.importorskip("h5py")

import minari

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.learning import demonstrations
from uwoc_gym.agents.learning.demonstrations import flown, replayed
from uwoc_gym.agents.policies.registry import load

SHORT = '{"episode": {"duration_s": 1.0}}'


def loaded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> minari.MinariDataset:
    """The dataset as its users load it."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(folder.parent))
    return minari.load_dataset(folder.name)


def told(dataset: minari.MinariDataset) -> list[dict[str, Any]]:
    return list(dataset.storage.get_episode_metadata(range(dataset.total_episodes)))


def test_the_recovered_environment_flies_each_episode_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "mixed-v0"
    words = ["dataset", "--policy", "nlpd-tuned", "pd", "--episodes", "3", "--seed", "7", "--noise", "0.2"]
    assert main([*words, "--override", SHORT, "--out", str(folder)]) == 0
    assert "nlpd-tuned: 3 episodes, return " in capsys.readouterr().out
    dataset = loaded(folder, monkeypatch)
    env = dataset.recover_environment()
    assert [(each["policy"], each["seed"]) for each in told(dataset)] == [
        (policy, seed) for policy in ("nlpd-tuned", "pd") for seed in (7, 8, 9)
    ]
    for episode, data in zip(dataset.iterate_episodes(), told(dataset), strict=True):
        observation, info = env.reset(seed=int(data["seed"]))
        seen, rewards, ranges = [observation], [], [info["range_m"]]
        for action in episode.actions:
            observation, reward, terminated, truncated, info = env.step(action)
            seen.append(observation)
            rewards.append(reward)
            ranges.append(info["range_m"])
        np.testing.assert_array_equal(seen, episode.observations)
        np.testing.assert_array_equal(rewards, episode.rewards)
        np.testing.assert_array_equal(ranges, episode.infos["range_m"])
        assert (terminated, truncated) == (episode.terminations[-1], episode.truncations[-1]) == (False, True)
        assert data["return"] == pytest.approx(sum(rewards))


def test_says_what_it_is_made_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "expert-v3"
    assert main(["dataset", "--policy", "nlpd", "--episodes", "2", "--override", SHORT, "--out", str(folder)]) == 0
    said = loaded(folder, monkeypatch).storage.metadata
    scenario = Scenario.named("Random").merged(json.loads(SHORT))
    assert said["scenario_digest"] == scenario.digest()
    assert Scenario.from_dict(said["scenario"]) == scenario
    assert said["flown"] == {"policies": ["nlpd"], "seeds": {"nlpd": [1000, 1001]}, "noise": 0.0}
    assert said["returns"]["nlpd"]["episodes"] == 2
    results = json.loads((folder / "results.json").read_text())
    assert results["scenarios"] == {"Random": scenario.digest()}
    assert results["results"] == said["returns"]
    assert results["finished"]


def test_flies_what_the_benchmark_flies() -> None:
    scenario = Scenario.named("Random").merged({"episode": {"duration_s": 2.0}})
    policy = load("nlpd-tuned")
    flight = fly(policy, scenario, [4, 5])
    own = flown(policy, scenario, [4, 5])
    np.testing.assert_array_equal([each.rewards for each in own], flight.record.reward.T)


def test_noise_hangs_on_the_seed_alone() -> None:
    scenario = Scenario.named("Random").merged({"episode": {"duration_s": 1.0}})
    together = flown(load("pd"), scenario, [4, 5, 6], 0.3)
    alone = flown(load("pd"), scenario, [5], 0.3)
    np.testing.assert_array_equal(together[1].actions, alone[0].actions)
    assert np.abs(alone[0].actions).max() <= 1.0
    assert not np.array_equal(alone[0].actions, flown(load("pd"), scenario, [5])[0].actions)


class Away:
    """A policy that leaves the ship."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        return np.tile(np.float32([1.0, 0.0, 0.0]), (len(observation), 1)), state


def make_away(known: Scenario) -> Away:
    """What a policy of module:callable is made by."""
    return Away()


def test_lost_episodes_end_where_the_link_is_lost() -> None:
    from uwoc_gym.baselines.policy import Policy

    scenario = Scenario.named("Random").merged({"episode": {"lost_distance_m": 12.0}})
    for each in flown(Policy("away", "", make_away), scenario, [0, 1, 2, 3]):
        assert len(each.actions) == len(each.rewards) == len(each.observations) - 1 < scenario.episode.steps
        assert each.terminations.tolist() == [False] * (len(each.actions) - 1) + [True]
        assert each.infos["range_m"].shape == (len(each.observations),)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--policy", "nlpdd"], ["--policy", "did you mean 'nlpd'?"]),
        (["--policy", "pd", "--noise", "3"], ["--noise", "'3'", "from 0.0 to 2.0"]),
        (["--policy", "pd", "--scenario", "Randm"], ["--scenario", "did you mean 'Random'?"]),
        (["--policy", "pd", "--episodes", "0"], ["--episodes", "'0'"]),
        (["--replay", "nowhere"], ["--replay", "'nowhere' is not the folder of a training run"]),
        (["--replay", "nowhere", "--noise", "0.1"], ["--noise is not allowed beside --replay"]),
        (["--replay", "nowhere", "--override", SHORT], ["--override is not allowed beside --replay"]),
        (["--replay", "nowhere", "--scenario", "Random"], ["--scenario is not allowed beside --replay"]),
        (["--replay", "nowhere", "--seed", "1000"], ["--seed is not allowed beside --replay"]),
        (["--replay", "nowhere", "--policy", "pd"], ["not allowed with argument"]),
        ([], ["--policy", "--replay"]),
    ],
)
def test_refusals_are_one_line_and_leave_nothing(
    options: list[str], words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["dataset", *options, "--out", str(tmp_path / "deep/some-v0")]) not in (0, 130)
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert all(word in said for word in words), said
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_a_new_one_with_minaris_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["dataset", "--policy", "pd", "--override", SHORT, "--out"]
    assert main([*words, str(tmp_path / "expert")]) == 1
    assert "end in its version, such as random-expert-v0" in capsys.readouterr().err
    held = tmp_path / "expert-v0"
    held.mkdir()
    (held / "mine.txt").write_text("kept")
    assert main([*words, str(held)]) == 1
    assert "is not empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.rglob("*")] == ["expert-v0", "mine.txt"]


def test_what_fails_midway_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["dataset", "--policy", "pd", "--override", SHORT]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("uwoc_gym.agents.commands.dataset.flown", _broken)
        assert main([*words, "--out", str(tmp_path / "a/some-v0")]) == 1
    assert "broken" in capsys.readouterr().err
    assert list(tmp_path.rglob("*")) == []


def _broken(*_: Any) -> Any:
    from uwoc_gym.agents.errors import CommandError

    raise CommandError("broken")


def test_what_is_interrupted_keeps_what_was_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def one_batch(policy: Any, scenario: Any, seeds: Any, noise: float) -> Any:
        if seeds[0] > 1000:
            raise KeyboardInterrupt
        return demonstrations.flown(policy, scenario, seeds, noise)

    monkeypatch.setattr("uwoc_gym.agents.commands.dataset.flown", one_batch)
    monkeypatch.setattr("uwoc_gym.agents.commands.dataset.BATCH", 2)
    folder = tmp_path / "some-v0"
    assert main(["dataset", "--policy", "pd", "--episodes", "5", "--override", SHORT, "--out", str(folder)]) == 130
    assert "interrupted after 2 finished episodes" in capsys.readouterr().err
    assert loaded(folder, monkeypatch).total_episodes == 2
    assert not json.loads((folder / "results.json").read_text())["finished"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short training of TD3, whose settings stack frames, and whose buffer has gone round."""
    pytest.importorskip("stable_baselines3")
    folder = tmp_path_factory.mktemp("runs") / "td3"
    words = ["train", "--algorithm", "td3", "--steps", "3200", "--envs", "4", "--eval-every", "3200"]
    words += ["--eval-episodes", "2"]
    words += ["--set", "learning_starts=4000", "--set", "buffer_size=2400"]
    assert main([*words, "--out", str(folder)]) == 0
    return folder


def test_a_replay_is_what_was_flown(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    replay = replayed(trained)
    scenario = replay.scenario
    assert scenario.episode.duration_s == 12.0
    folder = tmp_path / "replay-v0"
    assert main(["dataset", "--replay", str(trained), "--out", str(folder)]) == 0
    dataset = loaded(folder, monkeypatch)
    assert dataset.total_episodes == len(replay.episodes) > 0
    assert dataset.recover_environment().unwrapped.scenario == scenario
    for episode in dataset.iterate_episodes():
        assert episode.observations.shape == (len(episode) + 1, 20)
        assert dataset.observation_space.contains(episode.observations[0])
        assert episode.terminations[-1] or episode.truncations[-1]
        assert not (episode.terminations[:-1] | episode.truncations[:-1]).any()
        # Entries 15 to 17 of an observation are the last action.
        np.testing.assert_array_equal(episode.observations[0, 15:18], np.zeros(3))
        np.testing.assert_allclose(episode.observations[1:, 15:18], np.clip(episode.actions, -1, 1), atol=1e-6)


def test_only_runs_with_a_buffer_are_replayed(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = json.loads((trained / "run.json").read_text())
    other = tmp_path / "other"
    other.mkdir()
    (other / "run.json").write_text(json.dumps(run))
    assert main(["dataset", "--replay", str(other), "--out", str(tmp_path / "a-v0")]) == 1
    assert "holds no checkpoint yet" in capsys.readouterr().err
    buffer = next(trained.glob("checkpoint-*/replay.npz"))
    for more, words in (
        ({"wrappers": [{"name": "no_such_module:Thing", "options": {}}]}, "was trained in wrappers"),
        ({"settings": {**run["settings"], "residual": "no_such_module:thing"}}, "corrects a policy"),
    ):
        (other / "run.json").write_text(json.dumps(run | more))
        assert main(["dataset", "--replay", str(other), "--out", str(tmp_path / "a-v0")]) == 1
        assert words in capsys.readouterr().err
    (other / "run.json").write_text(json.dumps(run | {"env": "no_such_module:Thing-v0"}))
    assert main(["dataset", "--replay", str(other), "--out", str(tmp_path / "a-v0")]) == 1
    assert "'no_such_module:Thing-v0' is code" in capsys.readouterr().err
    assert main(["dataset", "--replay", str(other), "--trust", "--out", str(tmp_path / "a-v0")]) == 1
    assert "No module named 'no_such_module'" in capsys.readouterr().err
    (other / "run.json").write_text(json.dumps(run))
    damaged = other / "checkpoint-000001"
    damaged.mkdir()
    (damaged / "replay.npz").write_bytes(buffer.read_bytes()[:1000])
    assert main(["dataset", "--replay", str(other), "--out", str(tmp_path / "a-v0")]) == 1
    assert "can't be read: it is damaged" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other"]

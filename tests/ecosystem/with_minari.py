"""Minari: recording, loading and recovering, by its own collector and by `uwoc-gym dataset`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

os.environ["MINARI_DATASETS_PATH"] = str(Path.cwd() / "datasets")

import gymnasium as gym
import minari
import numpy as np
from checks import check, run

import uwoc_gym

ID = "uwoc/Random-v0"


def same_again(dataset: minari.MinariDataset) -> None:
    """The recovered environment flies each episode bit for bit."""
    env = dataset.recover_environment()
    told = list(dataset.storage.get_episode_metadata(range(dataset.total_episodes)))
    for episode, data in zip(dataset.iterate_episodes(), told, strict=True):
        seen = [env.reset(seed=int(data["seed"]))[0]]
        rewards = []
        for action in episode.actions:
            observation, reward, terminated, truncated, _ = env.step(action)
            seen.append(observation)
            rewards.append(reward)
        np.testing.assert_array_equal(seen, episode.observations)
        np.testing.assert_array_equal(rewards, episode.rewards)
        assert [terminated, truncated] == [episode.terminations[-1], episode.truncations[-1]]


@check
def collector() -> None:
    """DataCollector, create_dataset, load_dataset and recover_environment: the same episodes bit for bit, with info."""
    env = minari.DataCollector(gym.make(ID, max_episode_steps=40), record_infos=True)
    for seed in range(3):
        env.reset(seed=seed)
        over = False
        while not over:
            _, _, terminated, truncated, _ = env.step(env.action_space.sample())
            over = terminated or truncated
    env.create_dataset("uwoc/collected-v0")
    dataset = minari.load_dataset("uwoc/collected-v0")
    assert dataset.total_episodes == 3
    assert next(iter(dataset.iterate_episodes())).infos["range_m"].shape == (41,)
    same_again(dataset)


@check
def objects() -> None:
    """The same of an environment made with a Scenario object and a ship's path."""
    scenario = uwoc_gym.Scenario(ship=uwoc_gym.LawnMowerPath(), episode=uwoc_gym.EpisodeSettings(duration_s=2.0))
    env = minari.DataCollector(gym.make("uwoc/Nominal-v0", scenario=scenario))
    env.reset(seed=1)
    over = False
    while not over:
        over = env.step(env.action_space.sample())[3]
    env.create_dataset("uwoc/sailed-v0")
    dataset = minari.load_dataset("uwoc/sailed-v0")
    assert dataset.recover_environment().unwrapped.scenario == scenario
    same_again(dataset)


@check
def command() -> None:
    """uwoc-gym dataset, load_dataset and recover_environment: the same episodes bit for bit."""
    words = ["dataset", "--policy", "nlpd-tuned", "pd", "--noise", "0.2", "--episodes", "3"]
    words += ["--override", '{"episode": {"duration_s": 3}}', "--out", "datasets/mixed-v0"]
    subprocess.run([sys.executable, "-m", "uwoc_gym_command", *words], check=True)
    dataset = minari.load_dataset("mixed-v0")
    assert dataset.total_episodes == 6
    same_again(dataset)


if __name__ == "__main__":
    run()

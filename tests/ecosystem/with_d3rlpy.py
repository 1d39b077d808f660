"""d3rlpy, on a dataset of `uwoc-gym dataset` and on the environment itself."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

os.environ["MINARI_DATASETS_PATH"] = str(Path.cwd() / "datasets")

import d3rlpy
import gymnasium as gym
from checks import check, run

import uwoc_gym  # noqa: F401 - registers the IDs

ID = "uwoc/Random-v0"


@check
def offline() -> None:
    """datasets.get_minari of a dataset of uwoc-gym dataset; TD3+BC learns 50 steps and is evaluated."""
    words = ["dataset", "--policy", "nlpd-tuned", "--episodes", "3", "--override", '{"episode": {"duration_s": 3}}']
    subprocess.run([sys.executable, "-m", "uwoc_gym_command", *words, "--out", "datasets/expert-v0"], check=True)
    dataset, env = d3rlpy.datasets.get_minari("expert-v0")
    assert dataset.size() == 3
    learner = d3rlpy.algos.TD3PlusBCConfig(batch_size=32).create(device=False)
    evaluators = {"return": d3rlpy.metrics.EnvironmentEvaluator(env, n_trials=1)}
    learner.fit(dataset, n_steps=50, n_steps_per_epoch=50, evaluators=evaluators, show_progress=False)


@check
def online() -> None:
    """SAC learns 100 steps online."""
    env = gym.make(ID, max_episode_steps=20)
    learner = d3rlpy.algos.SACConfig(batch_size=32).create(device=False)
    buffer = d3rlpy.dataset.create_fifo_replay_buffer(limit=1000, env=env)
    learner.fit_online(env, buffer, n_steps=100, n_steps_per_epoch=50, update_start_step=50, show_progress=False)


if __name__ == "__main__":
    run()

"""rl-baselines3-zoo: train and enjoy, with this package's own settings."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import yaml
from checks import check, run

ROOT = Path(__file__).parents[2]
ID = "uwoc/Random-v0"


def zoo(command: str, *options: str) -> str:
    """Run one of its commands; returns what it says."""
    words = [sys.executable, "-m", f"rl_zoo3.{command}", "--env", ID, "--gym-packages", "uwoc_gym", *options]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=900)
    if done.returncode:
        raise RuntimeError(" ".join((done.stderr or done.stdout).splitlines()[-3:]))
    return done.stdout


def short(algorithm: str) -> str:
    """This package's settings of an algorithm, with fewer environments and steps; returns the file's name."""
    lines = (ROOT / f"agents/settings/{algorithm}.yaml").read_text(encoding="utf-8").splitlines()
    settings = yaml.safe_load("\n".join(line for line in lines if "staggered" not in line))
    own = settings[ID] | {"n_envs": 2, "n_timesteps": 300}
    own |= {"n_steps": 64, "batch_size": 64} if "n_steps" in own else {"learning_starts": 100}
    Path(f"{algorithm}.yaml").write_text(yaml.safe_dump({ID: own}), encoding="utf-8")
    return f"{algorithm}.yaml"


def trained_and_enjoyed(algorithm: str) -> None:
    """Train, then fly what came of it."""
    zoo("train", "--algo", algorithm, "--conf-file", short(algorithm), "-f", "logs", "--eval-freq", "-1")
    flown = ["--algo", algorithm, "-f", "logs", "-n", "1300", "--no-render", "--env-kwargs", "control_period_s:0.05"]
    assert "Mean reward" in zoo("enjoy", *flown)


@check
def on_policy() -> None:
    """rl_zoo3.train and rl_zoo3.enjoy, PPO with agents/settings/ppo.yaml cut to 300 steps."""
    trained_and_enjoyed("ppo")


@check
def off_policy() -> None:
    """rl_zoo3.train and rl_zoo3.enjoy, SAC with agents/settings/sac.yaml cut to 300 steps."""
    trained_and_enjoyed("sac")


if __name__ == "__main__":
    run()

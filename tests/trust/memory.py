"""Resident memory of a vector environment over many steps of random actions, with episodes that end and begin."""

from __future__ import annotations

import gc
import sys
import time
from pathlib import Path

import numpy as np

from tests.trust.figures import Wrong
from uwoc_gym import TrackingVectorEnv

ENVS = 4096
STEPS, LONG_STEPS = 2_000_000, 1_000_000_000
MOST_MIB = 2.0
"""Growth above which something is kept that shouldn't be."""


def resident_mib() -> float:
    """Memory of this process that is in use [MiB], as Linux counts it."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return int(next(line for line in lines if line.startswith("VmRSS")).split()[1]) / 1024.0


def grown(steps: int) -> tuple[float, float]:
    """Growth after the first tenth [MiB], and steps per second."""
    # Short episodes, so that each lane is reset several times in a short form too.
    env = TrackingVectorEnv(ENVS, scenario="Random", max_episode_steps=100)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (64, ENVS, 3)).astype(np.float32)
    env.reset(seed=0)
    env.step(actions[0])
    calls = steps // ENVS
    base, begun = 0.0, time.perf_counter()
    for i in range(calls):
        if i == calls // 10:
            gc.collect()
            base = resident_mib()
        if calls > 10_000 and i % (calls // 10) == 0:
            print(f"  {i * ENVS:,} steps: {resident_mib():.1f} MiB", file=sys.stderr, flush=True)
        env.step(actions[i % len(actions)])
    taken = time.perf_counter() - begun
    gc.collect()
    found = resident_mib() - base
    env.close()
    return found, steps / taken


def measure(long: bool) -> list[tuple[str, str]]:
    """Two million steps, or a billion."""
    steps = LONG_STEPS if long else STEPS
    growth, speed = grown(steps)
    figure = f"{growth:+.2f} MiB"
    words = f"resident memory after {steps:,} steps of {ENVS:,} environments, against the first tenth"
    return [
        (words, figure if growth < MOST_MIB else Wrong(figure)),
        ("steps per second meanwhile", f"{speed:,.0f}"),
    ]

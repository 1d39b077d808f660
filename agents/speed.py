"""`uwoc-gym speed`: steps per second beside Gymnasium's CartPole, in alternating rounds of one run."""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from uwoc_gym.agents.benchmark import versions, writable

from uwoc_gym import TrackingEnv
from uwoc_gym.fleet import Fleet
from uwoc_gym.scenario import Scenario

PEER = "CartPole-v1"
IDS = ("uwoc/Nominal-v0", "uwoc/Random-v0")
TARGETS = {"uwoc/Nominal-v0": {1: 3.0, 64: 5.0, 1024: 1.0}, "uwoc/Random-v0": {1: 1.5, 64: 2.5, 1024: 0.5}}
"""Ratios to the peer that the project aims at, by ID and number of environments."""


def _single(env_id: str, steps: int) -> float:
    env = gym.make(env_id)
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(997)]
    begin = time.perf_counter()
    for i in range(steps):
        _, _, terminated, truncated, _ = env.step(actions[i % 997])
        if terminated or truncated:
            env.reset()
    return steps / (time.perf_counter() - begin)


def _vector(env_id: str, size: int, steps: int) -> float:
    env = gym.make_vec(env_id, num_envs=size, vectorization_mode="vector_entry_point")
    env.reset(seed=0)
    env.action_space.seed(0)
    actions = [env.action_space.sample() for _ in range(97)]
    env.step(actions[0])
    begin = time.perf_counter()
    for i in range(steps):
        env.step(actions[i % 97])
    return size * steps / (time.perf_counter() - begin)


def _python_share(steps: int) -> float:
    """Share of a step of `TrackingEnv` that isn't spent in compiled code or the call to it."""
    env = TrackingEnv(scenario={"episode": {"duration_s": 1e6, "lost_distance_m": 1e9}})
    observation, _ = env.reset(seed=0)
    action = np.zeros(3, dtype=np.float32)
    inner = env.raw_step()

    def rate(call: Callable[[], Any]) -> float:
        begin = time.perf_counter()
        for _ in range(steps):
            call()
        return (time.perf_counter() - begin) / steps

    rate(lambda: env.step(action))
    empty = rate(lambda: None)
    return 1.0 - (rate(lambda: inner(action, observation)) - empty) / (rate(lambda: env.step(action)) - empty)


def run(rounds: int, scale: float, out: Path | None, command: str) -> dict[str, Any]:
    """Measure, print a table, and write `results.json` if a folder is given.

    Args:
        rounds: Rounds, in each of which every environment is timed once.
        scale: Length of the measurements, 1 for about a second each.
        out: Folder to write to.
        command: The command line, for the record.
    """
    if out is not None:
        writable(out)
    sizes = (1, 64, 1024)
    budget = {1: 60_000, 64: 6_000, 1024: 1_000}
    rates: dict[str, dict[int, list[float]]] = {i: {n: [] for n in sizes} for i in (PEER, *IDS)}
    for env_id in IDS:
        # Compile, or load from the cache, before the first round.
        _single(env_id, 5)
        _vector(env_id, 64, 5)
    for _ in range(rounds):
        for n in sizes:
            for env_id in (PEER, *IDS):
                steps = max(5, int(budget[n] * scale))
                rates[env_id][n].append(_single(env_id, steps) if n == 1 else _vector(env_id, n, steps))
    medians = {i: {n: statistics.median(values) for n, values in by_size.items()} for i, by_size in rates.items()}
    ratios = {i: {n: medians[i][n] / medians[PEER][n] for n in sizes} for i in IDS}
    memory = Fleet(Scenario(), 65536).nbytes / 1e6
    substeps = Scenario().episode.substeps
    share = _python_share(max(5, int(30_000 * scale)))

    print(f"{'':18} {'envs':>5} {'steps/s':>13} {'substeps/s':>13} {'ratio':>7} {'aim':>5}")
    for env_id in (PEER, *IDS):
        for n in sizes:
            row = f"{env_id:18} {n:5d} {medians[env_id][n]:13,.0f}"
            if env_id != PEER:
                row += f" {medians[env_id][n] * substeps:13,.0f} {ratios[env_id][n]:7.2f} {TARGETS[env_id][n]:5.1f}"
            print(row)
    print(f"Medians of {rounds} alternating rounds, one thread; single environments through gym.make.")
    print(f"Python's share of a single step: {share:.0%}. A fleet of 65,536 holds {memory:.0f} MB.")
    result = {
        "command": command,
        "versions": versions(),
        "steps_per_second": rates,
        "medians": medians,
        "ratios": ratios,
        "targets": TARGETS,
        "substeps": substeps,
        "python_share": share,
        "fleet_65536_mb": memory,
    }
    if out is not None:
        (out / "results.json").write_text(json.dumps(result, indent=2))
    return result

"""The same seeds give the same bits: whatever the batch, the threads, the autoreset and how the process began."""

from __future__ import annotations

import hashlib
import itertools
import multiprocessing
import pickle
from typing import Any

import numpy as np

from tests.trust.figures import none_of
from uwoc_gym import Scenario
from uwoc_gym.sim.fleet import Autoreset, Fleet
from uwoc_gym.sim.layout import FLAGS, MEASURE_NAMES

STARTS = ("here", "pickled", *multiprocessing.get_all_start_methods())
LENGTH = 40
"""Steps of an episode, so that every simulation ends several times."""


def digests(batch: int, threads: int, autoreset: int, steps: int, pickled: bool = False) -> list[str]:
    """A hash of each simulation's flight; that of lane i hangs on i alone."""
    scenario = Scenario.named("Random")
    fleet = Fleet(scenario, batch, Autoreset(autoreset), max_episode_steps=LENGTH, threads=threads)
    observations = np.zeros((batch, scenario.observation.size), np.float32)
    finals = np.zeros_like(observations)
    out, flags = np.zeros((len(MEASURE_NAMES), batch)), np.zeros((len(FLAGS), batch), np.bool_)
    lanes = np.arange(batch)
    fleet.seed(lanes, lanes.tolist())
    fleet.reset(observations)
    found = [hashlib.sha256(row.tobytes()) for row in observations]
    for step in range(steps):
        if pickled and step == steps // 2:
            fleet = pickle.loads(pickle.dumps(fleet))
        actions = np.stack([np.random.default_rng((lane, step)).uniform(-1.0, 1.0, 3) for lane in range(batch)])
        finals[:] = 0.0
        fleet.step(actions.astype(np.float32), observations, out, flags, finals)
        for lane in range(batch):
            for each in (observations[lane], finals[lane], out[:, lane], flags[:, lane]):
                found[lane].update(each.tobytes())
        if autoreset == Autoreset.DISABLED and (ended := np.flatnonzero(fleet.ended)).size:
            fleet.reset(observations, ended)
    fleet.close()
    return [each.hexdigest() for each in found]


def _started(method: str, arguments: tuple[Any, ...]) -> list[str]:
    if method in ("here", "pickled"):
        return digests(*arguments, method == "pickled")
    with multiprocessing.get_context(method).Pool(1) as pool:
        return pool.apply(digests, arguments)


def compare(long: bool) -> tuple[int, list[str]]:
    """How many flights were compared with those of a single simulation at a time, and which differ."""
    batches = (1, 5, 33, 100, 1024) if long else (5, 33)
    threads = (1, 2, 3) if long else (1, 2)
    starts = STARTS if long else ("here", "pickled")
    steps = 3 * LENGTH if long else LENGTH + 10
    compared, different = 0, []
    for autoreset in Autoreset:
        expected = digests(max(batches), 1, autoreset, steps)
        for batch, count, start in itertools.product(batches, threads, starts):
            compared += batch
            if _started(start, (batch, count, int(autoreset), steps)) != expected[:batch]:
                different.append(f"{batch} simulations, {count} threads, {autoreset.name}, {start}")
    return compared, different


def measure(long: bool) -> list[tuple[str, str]]:
    """The figures of the table."""
    compared, different = compare(long)
    return [
        ("flights compared over batch, threads, autoreset and start of the process", f"{compared:,}"),
        ("combinations in which one differs in a bit", none_of(different)),
    ]

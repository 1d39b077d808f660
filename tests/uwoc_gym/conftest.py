"""A fleet that is seeded, reset and stepped in one line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from uwoc_gym import EpisodeSettings, Scenario, StraightPath
from uwoc_gym.sim.fleet import Autoreset, Fleet
from uwoc_gym.sim.layout import FLAGS, MEASURE_NAMES


@dataclass
class Flight:
    """A fleet with the arrays that its steps write to."""

    fleet: Fleet
    observations: np.ndarray
    out: np.ndarray
    flags: np.ndarray
    finals: np.ndarray

    def step(self, action: Any = 0.0, count: int = 1) -> dict[str, np.ndarray]:
        shape = (self.fleet.size, len(self.fleet.scenario.actions))
        actions = np.ascontiguousarray(np.broadcast_to(np.asarray(action, dtype=np.float32), shape))
        for _ in range(count):
            self.fleet.step(actions, self.observations, self.out, self.flags, self.finals)
        return self.fleet.state()

    def measures(self) -> dict[str, np.ndarray]:
        return dict(zip(MEASURE_NAMES, self.fleet.measures(), strict=True))


@pytest.fixture(scope="session")
def fly():
    """Make a `Flight` that has been reset; lane i has seed ``seed + i`` unless ``seeds`` says otherwise."""

    def make(
        scenario: Scenario,
        size: int = 1,
        seed: int = 0,
        *,
        seeds: list[int] | None = None,
        pose: Any = None,
        velocity: Any = None,
        autoreset: Autoreset = Autoreset.DISABLED,
        **options: Any,
    ) -> Flight:
        fleet = Fleet(scenario, size, autoreset, **options)
        fleet.seed(np.arange(size), seeds or list(range(seed, seed + size)))
        flight = Flight(
            fleet,
            observations=np.zeros((size, scenario.observation.size), np.float32),
            out=np.zeros((len(MEASURE_NAMES), size)),
            flags=np.zeros((len(FLAGS), size), bool),
            finals=np.zeros((size, scenario.observation.size), np.float32),
        )
        fleet.reset(flight.observations, pose=pose, velocity=velocity)
        return flight

    return make


@pytest.fixture(scope="session")
def below_a_still_ship():
    """Make a scenario in which nothing ends an episode and the ship stays where it is."""
    episode = EpisodeSettings(duration_s=500.0, control_period_s=0.5, integration_step_s=0.025, lost_distance_m=1e6)

    def make(**settings: Any) -> Scenario:
        return Scenario(ship=StraightPath(speed_mps=0.0), episode=episode, **settings)

    return make

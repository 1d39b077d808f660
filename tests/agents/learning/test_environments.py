"""The environments to train in."""

from __future__ import annotations

import gymnasium as gym

from uwoc_gym.agents.learning import environments
from uwoc_gym.sb3 import TrackingVecEnv


def test_ids_of_others_over_our_fleet_use_it() -> None:
    name = "OthersTracking-v0"
    gym.register(
        name,
        "uwoc_gym.env:TrackingEnv",
        vector_entry_point="uwoc_gym.vector_env:TrackingVectorEnv",
        kwargs={"scenario_name": "Random", "control_period_s": 0.1},
    )
    try:
        scenario, fleet = environments.base_of(name)
        assert fleet
        assert scenario is not None
        assert scenario.episode.control_period_s == 0.1
        assert isinstance(environments.make_base(name, 2, scenario, {}), TrackingVecEnv)
    finally:
        del gym.registry[name]

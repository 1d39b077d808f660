"""The environment IDs: each is a named scenario, whose duration is the episode's length."""

from __future__ import annotations

import gymnasium as gym

from uwoc_gym.scenarios import SCENARIOS

ENV_IDS: dict[str, str] = {}
"""Scenario name by environment ID, of all that is registered."""


def register_envs() -> None:
    """Register an ID for every named scenario with Gymnasium; call it again for those that `name_scenario` adds."""
    for name in SCENARIOS:
        env_id = f"uwoc/{name}-v0"
        ENV_IDS[env_id] = name
        if env_id not in gym.registry:
            # No max_episode_steps: an ID can be made with another duration or control period, and the
            # environments truncate by themselves.
            gym.register(
                id=env_id,
                entry_point="uwoc_gym.env:TrackingEnv",
                vector_entry_point="uwoc_gym.vector_env:TrackingVectorEnv",
                kwargs={"scenario_name": name},
            )

"""The environment IDs: each is a named scenario, whose duration is the episode's length."""

from __future__ import annotations

import gymnasium as gym

from uwoc_gym.scenarios import SCENARIOS

ENV_IDS: dict[str, str] = {f"uwoc/{name}-v0": name for name in SCENARIOS}
"""Scenario name by environment ID."""


def register_envs() -> None:
    """Register every ID with Gymnasium; safe to call again."""
    for env_id, name in ENV_IDS.items():
        if env_id not in gym.registry:
            # No max_episode_steps: an ID can be made with another duration or control period, and the
            # environments truncate by themselves.
            gym.register(
                id=env_id,
                entry_point="uwoc_gym.env:TrackingEnv",
                vector_entry_point="uwoc_gym.vector_env:TrackingVectorEnv",
                kwargs={"scenario_name": name},
            )

"""Policies in use: the command line, training, the benchmark, and loading of agents."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uwoc_gym.baselines.policy import Predictor
    from uwoc_gym.scenario import Scenario

__all__ = ["load"]


def load(name_or_path: str, scenario: str | Scenario = "Nominal") -> Predictor:
    """A policy to act with: ``predict(observation, state, episode_start, deterministic)`` as in Stable-Baselines3.

    Args:
        name_or_path: The name of a controller or a shipped agent, the folder of a training run, a saved .zip file or
            "module:callable". All but names run code, so load only what you trust.
        scenario: What is flown, or its name; controllers know of it what their designer would.

    Returns:
        The policy, for the scenario's observations, one or N of them. Pass its memory on from call to call, and where
        episodes begin.

    Raises:
        CommandError: There is no such policy, or it can't be loaded.
        SettingError: There is no scenario of that name.
    """
    # Imported here so that what runs without the policies stays light.
    from uwoc_gym.agents.policies import registry
    from uwoc_gym.scenario import as_scenario

    return registry.load(str(name_or_path)).pilot(as_scenario(scenario))

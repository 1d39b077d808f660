"""Policies in use: the command line, training, the benchmark, and loading of agents."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from uwoc_gym.baselines.policy import Predictor
    from uwoc_gym.scenario import Scenario

__all__ = ["load"]


def load(name_or_path: str, scenario: str | Scenario = "Nominal", trust: bool = False) -> Predictor:
    """A policy to act with: ``predict(observation, state, episode_start, deterministic)`` as in Stable-Baselines3.

    Args:
        name_or_path: A name that uwoc-gym list shows, the folder of a training run or of a search for gains, a saved
            .zip file, a .json file of gains, or module:callable, which is imported and called.
        scenario: What is flown, or its name; controllers know of it what their designer would.
        trust: Whether to load files that hold pickled objects or name code too, and so to run whatever is in them:
            those that Stable-Baselines3 alone has saved, agents of version 0.1 of this package, and those that correct
            a module:callable.

    Returns:
        The policy, for the scenario's observations, one or N of them. Pass its memory on from call to call, and where
        episodes begin.

    Raises:
        CommandError: There is no such policy, it can't be loaded, or it would have to be trusted.
        SettingError: There is no scenario of that name.
    """
    # Imported here so that what runs without the policies stays light.
    from uwoc_gym.agents.policies import registry
    from uwoc_gym.scenario import as_scenario

    return registry.load(str(name_or_path), trust).pilot(as_scenario(scenario))

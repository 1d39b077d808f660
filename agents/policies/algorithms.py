"""The algorithms whose saved models can fly."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Mapping
from typing import Any, NamedTuple

from uwoc_gym.agents.errors import CommandError


class Algorithm(NamedTuple):
    """An algorithm and where it comes from."""

    name: str
    module: str
    off_policy: bool

    def load(self) -> Any:
        """The algorithm's class; imports PyTorch."""
        return getattr(importlib.import_module(self.module), self.name)


ALGORITHMS: dict[str, Algorithm] = {
    "ppo": Algorithm("PPO", "stable_baselines3", False),
    "sac": Algorithm("SAC", "stable_baselines3", True),
    "td3": Algorithm("TD3", "stable_baselines3", True),
    "tqc": Algorithm("TQC", "sb3_contrib", True),
    "recurrent_ppo": Algorithm("RecurrentPPO", "sb3_contrib", False),
    "a2c": Algorithm("A2C", "stable_baselines3", False),
}
"""The algorithms whose models can fly, by name."""


def policy_arguments(settings: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of a network's constructor, in which names of PyTorch's classes have become the classes.

    Args:
        settings: ``policy_kwargs`` as a settings file says them, such as {"activation_fn": "nn.ReLU"}.

    Raises:
        CommandError: There is no such class.
    """
    return {key: _class(key, value) for key, value in settings.items()}


def _class(key: str, value: Any) -> Any:
    if not isinstance(value, str) or not key.endswith(("_fn", "_class")):
        return value
    from torch import nn, optim

    name = value.removeprefix("nn.").removeprefix("optim.")
    module, base = (nn, nn.Module) if key == "activation_fn" else (optim, optim.Optimizer)
    found = getattr(module, name, None)
    if not inspect.isclass(found) or not issubclass(found, base):
        raise CommandError(f"policy_kwargs.{key} = {value!r} is not allowed; it must be a class such as nn.ReLU.")
    return found

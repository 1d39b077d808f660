"""The algorithms whose saved models can fly."""

from __future__ import annotations

import importlib
from typing import Any, NamedTuple


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

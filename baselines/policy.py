"""What a policy is: anything that decides on observations as a Stable-Baselines3 model does."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from uwoc_gym.scenario import Scenario


class Predictor(Protocol):
    """Anything that decides as a Stable-Baselines3 model does."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions for N observations, (N, actions) for (N, size), and the policy's memory."""
        ...


@dataclass(frozen=True)
class Policy:
    """A policy that can be flown through any scenario."""

    name: str
    description: str
    make: Callable[[Scenario], Predictor]
    """Builds the policy from what its maker knows of a scenario (`Scenario.known`)."""
    deterministic: bool = True
    """Whether the same observations always give the same actions."""
    needs: tuple[str, ...] = ()
    """Optional modules without which it can't fly."""

    def pilot(self, scenario: Scenario) -> Predictor:
        """The policy for a scenario, made without knowing what the scenario draws or does to it."""
        return self.make(scenario.known())

    def installed(self) -> bool:
        """Whether all that it needs is installed."""
        return all(importlib.util.find_spec(module) is not None for module in self.needs)

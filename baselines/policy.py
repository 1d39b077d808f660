"""What a policy is: anything that decides on observations as a Stable-Baselines3 model does."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

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


@runtime_checkable
class Onlooker(Protocol):
    """A predictor that decides on true states: a yardstick, which isn't flown on observations."""

    def watch(self, env: Any) -> None:
        """Be given the environment, single or vector, whose observations are decided on from now on."""
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
    slow: bool = False
    """Whether it thinks so long that it flies only where it is named."""

    def pilot(self, scenario: Scenario, env: Any = None) -> Predictor:
        """The policy for a scenario, made without knowing what the scenario draws or does to it.

        Args:
            scenario: The scenario.
            env: What is flown, which only an `Onlooker` is given.
        """
        made = self.make(scenario.known())
        if env is not None and isinstance(made, Onlooker):
            made.watch(env.unwrapped)
        return made

    def installed(self) -> bool:
        """Whether all that it needs is installed."""
        return all(importlib.util.find_spec(module) is not None for module in self.needs)

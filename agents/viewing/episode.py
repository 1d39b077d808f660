"""One episode and who flies it."""

from __future__ import annotations

import os
from typing import NamedTuple

from uwoc_gym.agents.wrapping import PLAIN, Wrapping
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.scenario import Scenario

# Before anything imports pygame, which greets on the standard output otherwise.
os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")


class Episode(NamedTuple):
    """One episode and who flies it."""

    policies: list[Policy]
    scenario_name: str
    scenario: Scenario
    seed: int
    wrapping: Wrapping = PLAIN
    """What stands around the environments."""

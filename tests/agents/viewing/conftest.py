"""Episodes to look at."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from uwoc_gym.agents.policies.registry import load
from uwoc_gym.agents.scenarios import said
from uwoc_gym.agents.viewing.episode import Episode


@pytest.fixture
def an_episode() -> Callable[..., Episode]:
    """Makes an episode of Random from policies' names, a seed and changes to the scenario."""

    def make(*policies: str, seed: int = 0, override: str | None = None) -> Episode:
        found = said("Random", override)
        return Episode([load(policy) for policy in policies], found.name, found.scenario, seed)

    return make

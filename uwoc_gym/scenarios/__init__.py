"""The named scenarios: each module names its own when it is imported."""

from uwoc_gym.scenario import SCENARIOS
from uwoc_gym.scenarios import paper, random, trials

__all__ = ["SCENARIOS", "paper", "random", "trials"]

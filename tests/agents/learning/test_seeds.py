"""Which seeds are for what."""

from __future__ import annotations

import pytest

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.learning import seeds


def test_seed_ranges_never_meet() -> None:
    trained = range(seeds.training_seed(0), seeds.training_seed(seeds.RUNS - 1) + seeds.SPAN)
    assert not set(seeds.HELD_OUT) & set(seeds.VALIDATION)
    assert max(*seeds.HELD_OUT, *seeds.VALIDATION) < trained.start
    assert trained.stop < 2**32
    assert seeds.training_seed(1) - seeds.training_seed(0) == seeds.SPAN
    with pytest.raises(CommandError, match="used up"):
        seeds.training_seed(0, seeds.SPAN)

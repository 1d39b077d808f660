"""Which seeds are for what: three ranges that never meet, so that no score is of episodes that were trained on."""

from __future__ import annotations

from uwoc_gym.agents.errors import CommandError

HELD_OUT = range(0, 200)
"""Seeds of the benchmark's episodes. Nothing in training, tuning or the choice of a model flies them."""

ALL_VALIDATION = range(100_000, 200_000)
"""Seeds of the episodes that choose between models, in training and in tuning: the first so many that are asked for."""

VALIDATION = ALL_VALIDATION[:64]
"""Those that are flown unless other numbers are asked for."""

BATCH = 200
"""Episodes that are flown at a time."""

SPAN = 1_000_000
"""How many seeds each training run has to itself."""

RUNS = 4000
"""How many training runs there are seeds for; the largest stays below 2³², the limit of NumPy's legacy seeding."""


def training_seed(run_seed: int, first: int = 0) -> int:
    """The seed of a run's first environment; environment i has that plus i, and its episodes follow from its stream.

    Args:
        run_seed: The run's own seed, in [0, 3999].
        first: How many seeds of the run are already in use, by the environments before it was resumed.

    Raises:
        CommandError: The seed isn't allowed, or the run has used up its seeds.
    """
    if not 0 <= run_seed < RUNS:
        raise CommandError(f"--seed {run_seed} is not allowed; it must be a whole number in [0, {RUNS - 1}].")
    if not 0 <= first < SPAN:
        raise CommandError(f"run {run_seed} has used up its {SPAN} seeds; begin a new one with another --seed.")
    return SPAN * (run_seed + 1) + first

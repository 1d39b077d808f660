"""Policies by name, file or callable."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import Any

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.modules import import_here
from uwoc_gym.agents.policies import archive, saved
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.baselines.controllers import CONTROLLERS
from uwoc_gym.baselines.policy import Policy, Predictor
from uwoc_gym.given import closest, shown
from uwoc_gym.scenario import Scenario

TRAINED = Path(__file__).parents[1] / "trained"
"""The agents that come with the package: a folder each, with ``model.zip``."""


def shipped(folder: Path = TRAINED) -> dict[str, Policy]:
    """The agents in a folder, by name; their models are only loaded when they are to fly."""
    found = {}
    for path in sorted(folder.glob(f"*/{saved.MODEL}")):
        description = archive.read(path)
        needs = (ALGORITHMS[description.algorithm].module,)
        name = path.parent.name
        found[name] = Policy(name, description.description, partial(saved.build, path), needs=needs)
    return found


POLICIES: dict[str, Policy] = CONTROLLERS | shipped()
"""The named policies: scripted controllers and shipped agents."""


def load(name: str, trust: bool = False) -> Policy:
    """The policy of that name, file or callable.

    Args:
        name: A name in `POLICIES`, the folder of a training run (its best model flies), the path of a zip file saved
            by Stable-Baselines3 or sb3-contrib, or "module:callable", which is called with what is known of the
            scenario (`Scenario.known`) and returns an object with Stable-Baselines3's ``predict``. What the file of an
            agent says is rebuilt: frozen normalisation, stacked frames, a controller that is corrected.
        trust: Whether to load files that hold pickled objects too, and so to run whatever is in them: those that
            Stable-Baselines3 alone has saved, and agents of version 0.1. This package's own agents need none of that;
            "module:callable" is code, and is run in any case.

    Raises:
        CommandError: There is no such policy, it can't be loaded, or it would have to be trusted.
    """
    if name in POLICIES:
        return POLICIES[name]
    path = Path(name)
    if path.suffix == ".zip" or os.path.exists(name):
        return saved.load(path, trust)
    if ":" in name:
        return _callable(name)
    raise CommandError(
        f"there is no policy {shown(name)}; {closest(name, POLICIES)} A policy may also be the path of a saved "
        ".zip file or module:callable."
    )


def _callable(name: str) -> Policy:
    module_name, _, attribute = name.partition(":")
    try:
        found: Any = import_here(module_name)
        for part in attribute.split("."):
            found = getattr(found, part)
    except Exception as error:
        raise CommandError(f"policy {name!r} can't be imported: {type(error).__name__}: {error}") from None
    if not callable(found):
        raise CommandError(f"policy {name!r} is not callable; it must take a scenario and return a policy.")

    def make(scenario: Scenario) -> Predictor:
        try:
            made: Any = found(scenario)
        except Exception as error:
            raise CommandError(f"policy {name!r} failed to be made: {type(error).__name__}: {error}") from error
        if not callable(getattr(made, "predict", None)):
            raise CommandError(
                f"policy {name!r} returned a {type(made).__name__} without predict(); it must return an object with "
                "the predict() of Stable-Baselines3."
            )
        return made  # type: ignore[no-any-return]

    return Policy(name, "callable", make, deterministic=False)

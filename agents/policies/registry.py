"""Policies by name, folder, file or callable."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from uwoc_gym.agents import places
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.modules import named_object
from uwoc_gym.agents.policies import archive, saved
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.scenarios import json_object
from uwoc_gym.baselines.controllers import CONTROLLERS, Tuned
from uwoc_gym.baselines.policy import Policy, Predictor
from uwoc_gym.given import SettingError, closest, shown
from uwoc_gym.scenario import Scenario

MAY_BE = (
    "a name that uwoc-gym list shows, the folder of a training run or of a search for gains (or its address, such as "
    "s3://bucket/runs/ppo), a saved .zip file, a .json file of gains, or module:callable"
)
"""All that a policy may be given as, in words."""

GAINS_FILE = "gains.json"
"""What a search for gains has found, in its folder."""

TRAINED = Path(__file__).parents[1] / "trained"
"""The agents that come with the package: a folder each, with ``model.zip``."""


def load(name: str, trust: bool = False) -> Policy:
    """The policy of that name, folder, file or callable.

    Args:
        name: A name in `POLICIES`, the folder of a training run (its best model flies) or of a search for gains, the
            path of a zip file saved by Stable-Baselines3 or sb3-contrib, the path of a .json file of gains, in place of
            a path an address that fsspec knows, or "module:callable", which is called with what is known of the
            scenario (`Scenario.known`) and returns an object with Stable-Baselines3's ``predict``. What the file of an
            agent says is rebuilt: frozen normalisation, stacked frames, a policy that is corrected.
        trust: Whether to load files that hold pickled objects or name code too, and so to run whatever is in them:
            those that Stable-Baselines3 alone has saved, agents of version 0.1, and agents that correct a
            "module:callable". All other agents of this package need none of that; "module:callable" itself is code, and
            is run in any case.

    Raises:
        CommandError: There is no such policy, it can't be loaded, or it would have to be trusted.
    """
    if name in POLICIES:
        return POLICIES[name]
    path = places.local(name)
    gains = gains_path(path)
    if gains is not None:
        return gains_of_file(gains).policy(name)
    if path.suffix == ".zip" or os.path.exists(path):
        if not saved.model_of(path).is_file():
            lack = f"the folder has no {saved.MODEL}" if path.is_dir() else "there is no such file"
            raise CommandError(f"policy {shown(name)}: {lack}. A policy may be {MAY_BE}.")
        found = saved.load(path, by_name, trust)
        return replace(found, name=name) if places.elsewhere(name) else found
    return by_name(name)


def by_name(name: str) -> Policy:
    """The policy of that name, or callable, whatever files there are.

    Raises:
        CommandError: There is no such policy.
    """
    if name in POLICIES:
        return POLICIES[name]
    if ":" in name:
        return _callable(name)
    raise CommandError(f"there is no policy {shown(name)}; {closest(name, POLICIES)} A policy may be {MAY_BE}.")


def shipped(folder: Path = TRAINED) -> dict[str, Policy]:
    """The agents in a folder, by name; their models are only loaded when they are to fly."""
    found = {}
    for path in sorted(folder.glob(f"*/{saved.MODEL}")):
        description = archive.read(path)
        needs = (ALGORITHMS[description.algorithm].module,)
        name = path.parent.name
        found[name] = Policy(name, description.description, partial(saved.build, path, by_name), needs=needs)
    return found


POLICIES: dict[str, Policy] = CONTROLLERS | shipped()
"""The named policies: scripted controllers and shipped agents."""


def gains_path(path: Path) -> Path | None:
    """The file of gains that a path means: itself, or that in the folder of a search; None if it means none."""
    # A name that is too long for a file is none.
    if os.path.isdir(path):
        return path / GAINS_FILE if (path / GAINS_FILE).is_file() and not (path / saved.MODEL).is_file() else None
    return path if path.suffix == ".json" else None


def gains_of_file(path: Path) -> Tuned:
    """The law with the gains in a .json file, such as a search has found.

    Raises:
        CommandError: It can't be read, or doesn't hold gains.
    """
    return gains_of(json_object(str(path), file=True), f"gains {shown(str(path))}")


def gains_of(given: Mapping[str, Any], name: str) -> Tuned:
    """The law with the gains that a mapping says; errors call it by the name.

    Raises:
        CommandError: A gain is unknown, missing or not allowed.
    """
    try:
        return Tuned.from_dict(given)
    except SettingError as error:
        raise CommandError(f"{name} is not allowed; {error}") from None


def _callable(name: str) -> Policy:
    try:
        found = named_object(name)
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

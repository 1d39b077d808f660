"""Trained agents as policies: a saved model with the wrappers that it was trained in, rebuilt for observations alone.

Around the network stand frozen normalisation, then stacked frames, and a controller that it corrects.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.policies import archive, foreign
from uwoc_gym.agents.policies.agent import Agent
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.policies.archive import Description, Normalisation
from uwoc_gym.baselines import Controller, Gains
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.parameters import SettingError
from uwoc_gym.scenario import Scenario

MODEL = "model.zip"
"""The best agent in the folder of a training run."""


def describe(
    env_id: str,
    name: str,
    algorithm: str,
    values: Mapping[str, Any],
    scenario: Scenario | None,
    gains: Gains | None,
    normalisation: Normalisation | None,
) -> Description:
    """What an agent's file says: all that acting needs besides the weights.

    Args:
        env_id: The environment's ID.
        name: What it was trained on, in a word.
        algorithm: A name in `ALGORITHMS`.
        values: Checked settings.
        scenario: The scenario trained for; None for environments of others.
        gains: The controller that the agent corrects, if any.
        normalisation: Its normalisation as it stands, if any.
    """
    residual = None
    if gains is not None:
        residual = {"gains": dataclasses.asdict(gains), "scale": values["residual_scale"]}
    return Description(
        description=f"{ALGORITHMS[algorithm].name} trained on {name}",
        algorithm=algorithm,
        env=env_id,
        observation=_interface(scenario) if scenario is not None else None,
        control_period_s=scenario.episode.control_period_s if scenario is not None else None,
        policy=values["policy"],
        policy_kwargs=values.get("policy_kwargs") or {},
        use_sde=values.get("use_sde", False),
        frame_stack=values["frame_stack"],
        normalisation=normalisation,
        residual=residual,
    )


def _check_layout(name: str, layout: Mapping[str, Any], scenario: Scenario) -> None:
    """Refuse an agent whose observations or actions aren't those of a scenario.

    Raises:
        CommandError: It was trained for others.
    """
    flown = _interface(scenario)
    if layout["entries"] != flown["entries"]:
        lacks = [f"{new!r}" for new in flown["entries"] if new not in layout["entries"]]
        more = [f"{old!r}" for old in layout["entries"] if old not in flown["entries"]]
        raise CommandError(
            f"policy {name!r} was trained for another observation layout: {len(layout['entries'])} entries where the "
            f"scenario has {len(flown['entries'])}{', without ' + ', '.join(lacks) if lacks else ''}"
            f"{', with ' + ', '.join(more) if more else ''}; train it for this one."
        )
    if layout["scales"] != flown["scales"]:
        raise CommandError(
            f"policy {name!r} was trained for another observation layout: its scales are {layout['scales']}, the "
            f"scenario's {flown['scales']}."
        )
    if layout["actions"] != flown["actions"]:
        raise CommandError(
            f"policy {name!r} was trained for other actions: {', '.join(layout['actions'])}; the scenario's are "
            f"{', '.join(flown['actions'])}."
        )


def _interface(scenario: Scenario) -> dict[str, Any]:
    """What an agent in the scenario sees and does."""
    seen = scenario.observation
    return {
        "entries": [entry.name for entry in seen.entries],
        "scales": seen.scales,
        "actions": list(scenario.actions),
    }


@cache
def _parts(path: Path, old: bool) -> tuple[Any, Callable[[Any], Any] | None, Description]:
    """Network, normalisation and description of an agent's file."""
    if old:
        return foreign.read_old_agent(path)
    policy, description = archive.read_policy(path)
    return policy, description.normalisation, description


def build(path: Path, scenario: Scenario, old: bool = False) -> Agent:
    """The agent of a file.

    Args:
        path: The file.
        scenario: What is flown, of which a corrected controller knows what its designer would.
        old: Whether it is of version 0.1, and is trusted.

    Raises:
        CommandError: It can't be loaded or was trained for another observation layout.
    """
    policy, normalise, description = _parts(path, old)
    assert description.observation is not None
    _check_layout(str(path), description.observation, scenario)
    residual = description.residual
    if residual is None:
        return Agent(policy, normalise, description.frame_stack)
    try:
        controller = Controller(Gains(**residual["gains"]), scenario)
        return Agent(policy, normalise, description.frame_stack, controller, residual["scale"])
    except (SettingError, TypeError, KeyError) as error:
        raise CommandError(f"policy {str(path)!r} has a residual that is not allowed: {error}") from None


def load(path: Path, trust: bool = False) -> Policy:
    """The policy of a training run's folder, or of a zip file.

    Args:
        path: The folder or the file.
        trust: Whether to load what holds pickled objects too, and so to run what it says: a zip file that
            Stable-Baselines3 or sb3-contrib alone has saved, or an agent of version 0.1 of this package.

    Raises:
        CommandError: There is none, it can't be loaded, or it holds pickled objects and isn't trusted.
    """
    given = str(path)
    if path.is_dir():
        path = path / MODEL
    if not path.is_file():
        raise CommandError(f"policy {str(path)!r}: there is no such file.")
    if archive.is_agent(path):
        old = False
    else:
        old = foreign.is_old_agent(path)
        if not trust:
            what = "an agent of version 0.1" if old else "saved by Stable-Baselines3 alone"
            raise CommandError(
                f"policy {str(path)!r} is {what}: it holds pickled objects, and loading them runs whatever code is in "
                "them; if you trust whoever made it, give --trust, or trust=True in Python."
            )
        if not old:
            return foreign.load(path, given)
    # Built once to meet errors now rather than in the middle of a benchmark.
    _parts.cache_clear()
    _, _, description = _parts(path, old)
    return Policy(given, description.description, partial(build, path, old=old))

"""Trained agents as policies: a saved model with the wrappers that it was trained in, rebuilt for observations alone.

Around the network stand frozen normalisation, then stacked frames, and a policy that it corrects.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.agents.policies import archive, foreign
from uwoc_gym.agents.policies.agent import Agent
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.policies.archive import Description, Normalisation, Source
from uwoc_gym.baselines.beliefs import LEARNED, Beliefs
from uwoc_gym.baselines.controllers import Tuned
from uwoc_gym.baselines.policy import Policy, Predictor
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
    corrected: Mapping[str, Any] | None,
    normalisation: Normalisation | None,
    around: str = "",
) -> Description:
    """What an agent's file says: all that acting needs besides the weights.

    Args:
        env_id: The environment's ID.
        name: What it was trained on, in a word.
        algorithm: A name in `ALGORITHMS`.
        values: Checked settings.
        scenario: The scenario trained for; None for environments of others.
        corrected: What the agent corrects, as `Correction.told` says it, if anything.
        normalisation: Its normalisation as it stands, if any.
        around: The wrappers that it was trained in, if any.
    """
    beliefs = beliefs_of(values, scenario)
    residual = None if corrected is None else {**corrected, "scale": values["residual_scale"]}
    return Description(
        description=f"{ALGORITHMS[algorithm].name} trained on {name}{f' in {around}' if around else ''}",
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
        beliefs=None if beliefs is None else list(beliefs.names),
    )


def beliefs_of(values: Mapping[str, Any], scenario: Scenario | None) -> Beliefs | None:
    """What filters add to observations by checked settings, if anything.

    Args:
        values: Checked settings.
        scenario: What is scored, which filters know in practice too; None for environments of others.

    Raises:
        SettingError: There is nothing to filter in it.
    """
    if not values["filtered"] or scenario is None:
        return None
    return Beliefs(scenario.known(), learned=values["filtered"] == LEARNED)


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


class _Parts(NamedTuple):
    """What an agent's file holds."""

    policy: Any
    normalise: Callable[[Any], Any] | None
    description: Description
    corrected: _Parts | None
    """The same of the agent that it corrects, if it corrects one."""


def _read(path: Source, old: bool = False) -> _Parts:
    if old:
        return _Parts(*foreign.read_old_agent(path), None)  # type: ignore[arg-type]
    policy, description = archive.read_policy(path)
    residual = description.residual
    within = residual is not None and "agent" in residual
    corrected = _read(archive.read_corrected(path)) if within else None
    return _Parts(policy, description.normalisation, description, corrected)


_parts = cache(_read)


def model_of(path: Path) -> Path:
    """The file of the agent that a path means: itself, or the best model in the folder of a training run."""
    return path / MODEL if path.is_dir() else path


Find = Callable[[str], Policy]
"""What finds a policy by its name."""


def build(path: Path, find: Find, scenario: Scenario, old: bool = False, trust: bool = False) -> Agent:
    """The agent of a file.

    Args:
        path: The file.
        find: Finds what it corrects, where the file names that.
        scenario: What is flown, of which a corrected policy knows what its designer would.
        old: Whether it is of version 0.1, and is trusted.
        trust: Whether code that it names may be run.

    Raises:
        CommandError: It can't be loaded, was trained for another observation layout, or corrects what isn't trusted.
    """
    return _built(str(path), _parts(path, old), find, scenario, trust)


def _built(name: str, parts: _Parts, find: Find, scenario: Scenario, trust: bool) -> Agent:
    description = parts.description
    assert description.observation is not None
    _check_layout(name, description.observation, scenario)
    with naming(f"policy {name!r} was trained behind filters"):
        beliefs = None if description.beliefs is None else Beliefs.named(description.beliefs, scenario)
    residual = description.residual
    if residual is None:
        return Agent(parts.policy, parts.normalise, description.frame_stack, beliefs=beliefs)
    try:
        controller = _corrected(name, residual, parts.corrected, find, scenario, trust)
        return Agent(parts.policy, parts.normalise, description.frame_stack, controller, residual["scale"], beliefs)
    except (SettingError, TypeError, KeyError) as error:
        raise CommandError(f"policy {name!r} has a residual that is not allowed: {error}") from None


def _corrected(
    name: str, residual: Mapping[str, Any], agent: _Parts | None, find: Find, scenario: Scenario, trust: bool
) -> Predictor:
    if "gains" in residual:
        return Tuned.from_dict(residual["gains"]).policy(name).make(scenario)
    if agent is not None:
        return _built(f"{name}, {archive.CORRECTED}", agent, find, scenario, trust)
    told = residual["policy"]
    if ":" in told and not trust:
        raise CommandError(
            f"policy {name!r} corrects {told!r}, which is code, and loading it runs that code; if you trust whoever "
            "made it, give --trust, or trust=True in Python."
        )
    with naming(f"policy {name!r} corrects {told!r}"):
        return find(told).make(scenario)


def load(path: Path, find: Find, trust: bool = False) -> Policy:
    """The policy of a training run's folder, or of a zip file.

    Args:
        path: The folder or the file, which exists.
        find: Finds what an agent corrects, where its file names that.
        trust: Whether to load what holds pickled objects or names code too, and so to run what it says: a zip file that
            Stable-Baselines3 or sb3-contrib alone has saved, an agent of version 0.1 of this package, or one that
            corrects a "module:callable".

    Raises:
        CommandError: It can't be loaded, or it would have to be trusted.
    """
    given = str(path)
    path = model_of(path)
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
    parts = _parts(path, old)
    # Whether code that it corrects gives the same again isn't known.
    make, sure = partial(build, path, find, old=old, trust=trust), not _corrects_code(parts)
    return Policy(given, parts.description.description, make, sure)


def _corrects_code(parts: _Parts) -> bool:
    """Whether an agent corrects a module:callable, or an agent that does."""
    if parts.corrected is not None:
        return _corrects_code(parts.corrected)
    return ":" in (parts.description.residual or {}).get("policy", "")

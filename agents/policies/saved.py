"""Trained agents as policies: a saved model with the wrappers that it was trained in, rebuilt for observations alone.

A folder with a model holds ``agent.json``, which says which algorithm it is and what stands around it: frozen
normalisation, then stacked frames, and a controller that it corrects.
"""

from __future__ import annotations

import dataclasses
import json
import pickle
import zipfile
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.policies.agent import Agent
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.baselines import Controller, Gains
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.parameters import SettingError
from uwoc_gym.scenario import Scenario

DESCRIPTION = "agent.json"
FORMAT = 1


def describe(
    env_id: str, name: str, algorithm: str, values: Mapping[str, Any], scenario: Scenario | None, gains: Gains | None
) -> dict[str, Any]:
    """What ``agent.json`` says: all that acting needs besides the model and its normalisation statistics.

    Args:
        env_id: The environment's ID.
        name: What it was trained on, in a word.
        algorithm: A name in `ALGORITHMS`.
        values: Checked settings.
        scenario: The scenario trained for; None for environments of others.
        gains: The controller that the agent corrects, if any.
    """
    layout = None
    if scenario is not None:
        layout = _interface(scenario)
    residual = None
    if gains is not None:
        residual = {"gains": dataclasses.asdict(gains), "scale": values["residual_scale"]}
    return {
        "format": FORMAT,
        "description": f"{ALGORITHMS[algorithm].name} trained on {name}",
        "algorithm": algorithm,
        "env": env_id,
        "observation": layout,
        "control_period_s": scenario.episode.control_period_s if scenario is not None else None,
        "normalize": bool(values["normalize"]),
        "frame_stack": values["frame_stack"],
        "residual": residual,
    }


def read_description(path: Path) -> dict[str, Any]:
    """The ``agent.json`` of a folder.

    Raises:
        CommandError: It can't be read or is of another format.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["format"] != FORMAT:
            raise CommandError(f"{path} is of format {found['format']!r}; this version reads {FORMAT}.")
        if found["algorithm"] not in ALGORITHMS:
            raise CommandError(f"{path}: algorithm = {found['algorithm']!r} is not one of {', '.join(ALGORITHMS)}.")
        for key in ("description", "observation", "normalize", "frame_stack", "residual"):
            found[key]
    except OSError as error:
        raise CommandError(f"{path} can't be read: {error.strerror}.") from None
    except (ValueError, KeyError, TypeError) as error:
        raise CommandError(f"{path} doesn't describe an agent: {type(error).__name__}: {error}") from None
    return dict(found)


def check_layout(name: str, description: Mapping[str, Any], scenario: Scenario | None = None) -> None:
    """Refuse an agent that reads observations of another layout.

    Args:
        name: The agent, for the error.
        description: What its ``agent.json`` says.
        scenario: A scenario to fly; its observations' scales must be those trained with.

    Raises:
        CommandError: It was trained for another layout.
    """
    layout = description["observation"]
    if layout is None:
        raise CommandError(
            f"policy {name!r} was trained in {description.get('env')!r}, whose observations are not this package's."
        )
    if scenario is None:
        return
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
    if _actions_of(layout) != flown["actions"]:
        raise CommandError(
            f"policy {name!r} was trained for other actions: {', '.join(_actions_of(layout))}; the scenario's are "
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


def _actions_of(layout: Mapping[str, Any]) -> list[str]:
    """The actions that an agent was trained for; before they could be chosen there was one kind."""
    return list(layout.get("actions", Scenario().actions))


def load_model(path: Path, algorithm: str) -> Any:
    """A saved model, for acting only.

    Raises:
        CommandError: It can't be loaded, or what it needs isn't installed.
    """
    kind = ALGORITHMS[algorithm]
    require(kind.module)
    try:
        # Schedules aren't needed to act, and pickled closures may not load in another version of Python.
        unused = {"learning_rate": 0.0, "lr_schedule": _zero, "clip_range": _zero, "clip_range_vf": None}
        return kind.load().load(path, device="cpu", custom_objects=unused)
    except Exception as error:
        text = str(error).splitlines()[0] if str(error) else ""
        raise CommandError(f"policy {str(path)!r} can't be loaded: {type(error).__name__}: {text}") from None


def _zero(progress_remaining: float) -> float:
    return 0.0


def load_normaliser(path: Path) -> Callable[[Any], Any]:
    """The frozen observation statistics of a saved VecNormalize.

    Raises:
        CommandError: The file isn't one.
    """
    try:
        with path.open("rb") as file:
            normalise: Callable[[Any], Any] = pickle.load(file).normalize_obs
    except Exception as error:
        raise CommandError(f"{str(path)!r} is not a saved VecNormalize: {type(error).__name__}: {error}") from None
    return normalise


def normaliser_path(model: Path) -> Path:
    """Where a model's statistics stand: in last.vecnormalize.pkl for last.zip, else in vecnormalize.pkl beside it."""
    own = model.with_name(f"{model.stem}.vecnormalize.pkl")
    return own if own.is_file() else model.with_name("vecnormalize.pkl")


def check_shapes(name: str, model: Any, entries: int, actions: int, frames: int = 1) -> None:
    """Refuse a model whose observations or actions have other shapes than those of a layout.

    Args:
        name: The policy, for the error.
        model: What was loaded.
        entries: Length of an observation.
        actions: Length of an action.
        frames: How many observations in a row it sees.

    Raises:
        CommandError: They have other shapes.
    """
    shapes = (model.observation_space.shape, model.action_space.shape)
    if shapes != ((entries * frames,), (actions,)):
        raise CommandError(
            f"policy {name!r} has observations and actions of shapes {shapes[0]} and {shapes[1]}; they must be "
            f"({entries * frames},) and ({actions},)."
        )


def check_model(path: Path) -> None:
    """Load a model beside an ``agent.json``, to find now what is wrong with it.

    Raises:
        CommandError: It can't be loaded or was trained for another observation layout.
    """
    _parts.cache_clear()
    _parts(path)


@cache
def _parts(path: Path) -> tuple[Any, Callable[[Any], Any] | None, dict[str, Any]]:
    description = read_description(path.with_name(DESCRIPTION))
    check_layout(str(path), description)
    model = load_model(path, description["algorithm"])
    layout = description["observation"]
    check_shapes(str(path), model, len(layout["entries"]), len(_actions_of(layout)), description["frame_stack"])
    normalise = load_normaliser(normaliser_path(path)) if description["normalize"] else None
    return model, normalise, description


def build(path: Path, scenario: Scenario) -> Agent:
    """The agent of a model beside an ``agent.json``.

    Args:
        path: The model's file.
        scenario: What is flown, of which a corrected controller knows what its designer would.

    Raises:
        CommandError: It can't be loaded or was trained for another observation layout.
    """
    model, normalise, description = _parts(path)
    check_layout(str(path), description, scenario)
    residual = description["residual"]
    if residual is None:
        return Agent(model, normalise, description["frame_stack"])
    try:
        controller = Controller(Gains(**residual["gains"]), scenario)
        return Agent(model, normalise, description["frame_stack"], controller, residual["scale"])
    except (SettingError, TypeError, KeyError) as error:
        raise CommandError(f"policy {str(path)!r} has a residual that is not allowed: {error}") from None


# A setting that only models of the class have; the file doesn't name the class itself. The first match counts.
_TELL_TALE = (
    ("tqc", "top_quantiles_to_drop_per_net"),
    ("sac", "target_entropy"),
    ("td3", "policy_delay"),
    ("recurrent_ppo", "_last_lstm_states"),
    ("ppo", "clip_range"),
    ("a2c", "normalize_advantage"),
)


def load(path: Path) -> Policy:
    """The policy of a training run's folder, or of a zip file saved by Stable-Baselines3 or sb3-contrib.

    Raises:
        CommandError: There is none, or it can't be loaded.
    """
    given = str(path)
    if path.is_dir():
        path = path / "model.zip"
    if not path.is_file():
        raise CommandError(f"policy {str(path)!r}: there is no such file.")
    try:
        with zipfile.ZipFile(path) as archive:
            settings = json.loads(archive.read("data"))
    except (zipfile.BadZipFile, KeyError, ValueError, OSError):
        raise CommandError(f"policy {str(path)!r} is not a zip file saved by Stable-Baselines3.") from None
    if path.with_name(DESCRIPTION).is_file():
        # Built once to meet errors now rather than in the middle of a benchmark.
        description = read_description(path.with_name(DESCRIPTION))
        check_model(path)
        return Policy(given, description["description"], partial(build, path))
    algorithm = next((name for name, setting in _TELL_TALE if setting in settings), None)
    if algorithm is None:
        known = ", ".join(each.name for each in ALGORITHMS.values())
        raise CommandError(f"policy {str(path)!r} was saved by another algorithm than {known}.")
    model = load_model(path, algorithm)
    statistics = normaliser_path(path)
    normalise = load_normaliser(statistics) if statistics.is_file() else None
    agent = Agent(model, normalise)

    def make(scenario: Scenario) -> Agent:
        check_shapes(given, model, scenario.observation.size, len(scenario.actions))
        return agent

    return Policy(given, f"saved {ALGORITHMS[algorithm].name} model", make)

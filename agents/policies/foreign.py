"""Models that Stable-Baselines3 alone has saved, and agents of version 0.1: their files hold pickled Python objects.

Loading one runs whatever its file says, so that nothing here is called without the user's word that it is trusted.
"""

from __future__ import annotations

import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.policies.agent import Agent
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.policies.archive import MEMBER, Description
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.scenario import Scenario

# A setting that only models of the class have; the file doesn't name the class itself. The first match counts.
_TELL_TALE = (
    ("tqc", "top_quantiles_to_drop_per_net"),
    ("sac", "target_entropy"),
    ("td3", "policy_delay"),
    ("recurrent_ppo", "_last_lstm_states"),
    ("ppo", "clip_range"),
    ("a2c", "normalize_advantage"),
)


def load(path: Path, name: str) -> Policy:
    """The policy of a zip file saved by Stable-Baselines3 or sb3-contrib; runs the code in it.

    Statistics in ``vecnormalize.pkl`` beside it, or in last.vecnormalize.pkl for last.zip, are applied.

    Args:
        path: The zip file.
        name: What the policy is called.

    Raises:
        CommandError: It can't be loaded.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            settings = json.loads(archive.read("data"))
    except (zipfile.BadZipFile, KeyError, ValueError, OSError):
        raise CommandError(f"policy {str(path)!r} is not a zip file saved by Stable-Baselines3.") from None
    algorithm = next((name for name, setting in _TELL_TALE if setting in settings), None)
    if algorithm is None:
        known = ", ".join(each.name for each in ALGORITHMS.values())
        raise CommandError(f"policy {str(path)!r} was saved by another algorithm than {known}.")
    model = _load_model(path, algorithm)
    statistics = _statistics_path(path)
    agent = Agent(model, _load_normaliser(statistics) if statistics.is_file() else None)

    def make(scenario: Scenario) -> Agent:
        shapes = (model.observation_space.shape, model.action_space.shape)
        entries, actions = scenario.observation.size, len(scenario.actions)
        if shapes != ((entries,), (actions,)):
            raise CommandError(
                f"policy {name!r} has observations and actions of shapes {shapes[0]} and {shapes[1]}; they must be "
                f"({entries},) and ({actions},)."
            )
        return agent

    return Policy(name, f"saved {ALGORITHMS[algorithm].name} model", make)


def is_old_agent(path: Path) -> bool:
    """Whether a zip file is an agent of version 0.1, which has its description beside it."""
    return path.with_name(MEMBER).is_file()


def read_old_agent(path: Path) -> tuple[Any, Callable[[Any], Any] | None, Description]:
    """Model, normalisation and description of an agent of version 0.1; runs the code in its files.

    Raises:
        CommandError: It can't be loaded.
    """
    beside = path.with_name(MEMBER)
    try:
        said = json.loads(beside.read_text(encoding="utf-8"))
        # There was one kind of actions before they could be chosen.
        layout = {"actions": list(Scenario().actions), **said["observation"]}
        fields = ("description", "algorithm", "env", "control_period_s", "frame_stack", "residual")
        kept = {field: said[field] for field in fields}
        normalize, _ = said["normalize"], ALGORITHMS[said["algorithm"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CommandError(f"{str(beside)!r} doesn't describe an agent: {type(error).__name__}: {error}") from None
    description = Description(
        **kept, observation=layout, policy="", policy_kwargs={}, use_sde=False, normalisation=None
    )
    normalise = _load_normaliser(_statistics_path(path)) if normalize else None
    return _load_model(path, description.algorithm), normalise, description


def _statistics_path(model: Path) -> Path:
    own = model.with_name(f"{model.stem}.vecnormalize.pkl")
    return own if own.is_file() else model.with_name("vecnormalize.pkl")


def _load_model(path: Path, algorithm: str) -> Any:
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


def _load_normaliser(path: Path) -> Callable[[Any], Any]:
    try:
        with path.open("rb") as file:
            normalise: Callable[[Any], Any] = pickle.load(file).normalize_obs
    except Exception as error:
        raise CommandError(f"{str(path)!r} is not a saved VecNormalize: {type(error).__name__}: {error}") from None
    return normalise

"""What a training is asked to be, as data, and what it comes to once everything has been checked."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from uwoc_gym.agents.errors import CommandError, naming, require
from uwoc_gym.agents.learning import settings
from uwoc_gym.agents.learning.seeds import VALIDATION, training_seed
from uwoc_gym.agents.learning.settings import TRAINABLE
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.reports.files import read_json
from uwoc_gym.agents.scenarios import Said, json_object, said
from uwoc_gym.baselines import GAINS, Gains, gains
from uwoc_gym.given import LIMITS, SettingError, closest, shown
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import Scenario

DEFAULT_ENV = "uwoc/Random-v0"

PERIODS = ("control_period_s", "integration_step_s")
"""The arguments of our environments, besides ``scenario``, that settings may hold."""


@dataclass(frozen=True, kw_only=True)
class Wish:
    """What a training is asked to be: the options of `uwoc-gym train`, None where nothing was said."""

    algorithm: str | None = None
    env: str | None = None
    scenario: str | None = None
    override: str | None = None
    residual: str | None = None
    scale: float | None = None
    frame_stack: int | None = None
    steps: int | None = None
    envs: int | None = None
    settings: str | None = None
    set: tuple[str, ...] = ()
    seed: int | None = None
    eval_every: int | None = None
    eval_episodes: int | None = None
    checkpoint_every: int | None = None

    def words(self) -> list[str]:
        """The options that say the same on the command line."""
        words: list[str] = []
        for field in fields(self):
            value = getattr(self, field.name)
            option = "--" + field.name.replace("_", "-")
            for each in value if isinstance(value, tuple) else () if value is None else (value,):
                words += [option, str(each)]
        return words


@dataclass(frozen=True)
class Job:
    """A training and where it keeps everything."""

    wish: Wish
    folder: Path

    @property
    def command(self) -> str:
        """The command that would do the same."""
        return shlex.join(["uwoc-gym", "train", *self.wish.words(), "--out", str(self.folder)])


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run is to do, once everything given has been checked."""

    algorithm: str
    env_id: str
    name: str
    """What it is trained on, in a word: the environment's ID, or the name of a scenario file."""
    seed: int
    values: dict[str, Any]
    """Checked settings."""
    task: Scenario | None
    """What is evaluated, and trained on but for the settings' own overrides; None for environments of others."""
    overrides: tuple[dict[str, Any], ...]
    """What was asked to be changed in the environment's scenario; goes before the settings' own overrides."""
    gains: Gains | None
    """The controller that the agent corrects, if any."""
    eval_every: int
    eval_episodes: int
    checkpoint_every: int

    @property
    def practice(self) -> Scenario | None:
        """What is trained on."""
        if self.task is None:
            return None
        practice = self.task
        own = self.values["env_kwargs"].get("scenario")
        for changes in ({} if own is None else own, *self.overrides):
            practice = practice.merged(changes)
        return practice

    def to_dict(self) -> dict[str, Any]:
        """The plan as plain data, as it is recorded and by which a resumed run is compared with the one before."""
        plain: dict[str, Any] = json.loads(
            json.dumps(
                {
                    "algorithm": self.algorithm,
                    "env": self.env_id,
                    "name": self.name,
                    "seed": self.seed,
                    "settings": self.values,
                    "overrides": self.overrides,
                    "scenario": self.task.to_dict() if self.task is not None else None,
                    "eval_every": self.eval_every,
                    "eval_episodes": self.eval_episodes,
                    "checkpoint_every": self.checkpoint_every,
                }
            )
        )
        return plain


def recorded_plan(path: Path) -> dict[str, Any]:
    """What a run's ``run.json`` says it is.

    Raises:
        CommandError: The file doesn't describe a run.
    """
    data = read_json(path)
    found: dict[str, Any] = dict(data) if isinstance(data, dict) else {}
    # Runs of earlier versions hold one mapping, and no name.
    if isinstance(found.get("overrides"), dict):
        found["overrides"] = [found["overrides"]] if found["overrides"] else []
    found.setdefault("name", found.get("env"))
    for key, allowed, fits in _RECORDED:
        if not fits(found.get(key)) and (key in found or key not in _MAY_LACK):
            raise CommandError(
                f"{path} doesn't describe a run: {key} = {shown(found.get(key))} is not allowed; it must be {allowed}."
            )
    return found


def _is_count(limit: str) -> Callable[[Any], bool]:
    bounds = LIMITS[limit]
    return lambda value: type(value) is int and bounds.low <= value <= bounds.high


_RECORDED: tuple[tuple[str, str, Callable[[Any], bool]], ...] = (
    ("algorithm", f"one of {', '.join(TRAINABLE)}", lambda value: isinstance(value, str) and value in TRAINABLE),
    ("env", "the ID of an environment", lambda value: isinstance(value, str)),
    ("name", "a text", lambda value: isinstance(value, str)),
    ("settings", "a mapping of settings", lambda value: isinstance(value, dict)),
    (
        "overrides",
        "a list of mappings of settings",
        lambda value: isinstance(value, list) and all(isinstance(each, dict) for each in value),
    ),
    ("scenario", "null or a mapping of settings", lambda value: value is None or isinstance(value, dict)),
    ("seed", "a whole number", _is_count("seed")),
    ("eval_every", LIMITS["steps"].allowed, _is_count("steps")),
    ("eval_episodes", LIMITS["seeds"].allowed, _is_count("seeds")),
    ("checkpoint_every", LIMITS["steps"].allowed, _is_count("steps")),
)
"""What a ``run.json`` holds, in words and as a check."""

_MAY_LACK = ("seed", "eval_every", "eval_episodes", "checkpoint_every")


def planned(wish: Wish, recorded: Mapping[str, Any] | None = None) -> Plan:
    """The plan of a wish; what it leaves open is as recorded, or the default.

    Args:
        wish: What was asked for.
        recorded: What the run that is to go on says it is, as `recorded_plan` gives it.

    Raises:
        CommandError: Something isn't allowed, or what it needs isn't installed.
    """
    known = recorded or {}
    algorithm = known.get("algorithm", "ppo") if wish.algorithm is None else wish.algorithm
    if algorithm not in TRAINABLE:
        raise CommandError(f"--algorithm {shown(algorithm)} is not allowed; {closest(algorithm, TRAINABLE)}")
    require(ALGORITHMS[algorithm].module)
    seed = wish.seed if wish.seed is not None else known.get("seed", 0)
    training_seed(seed)
    env_id, name, base, overrides = _environment(wish, known)
    own_file = None if wish.settings is None else Path(wish.settings)
    if recorded is not None and own_file is None and recorded["algorithm"] == algorithm and recorded["env"] == env_id:
        values = settings.checked(algorithm, recorded["settings"], "run.json")
    else:
        values, _ = settings.resolve(algorithm, env_id, path=own_file)
    values = _overridden(wish, algorithm, values)
    source = "run.json" if recorded is not None and own_file is None else own_file
    with nullcontext() if source is None else naming(f"settings of {source}"):
        found, task = _gains(values["residual"]), _task(base, values)
    if base is None and values["residual"]:
        raise CommandError(f"residual is not allowed for {env_id!r}, which isn't one of this package's.")
    episodes = wish.eval_episodes or known.get("eval_episodes", 32)
    if episodes > len(VALIDATION):
        raise CommandError(f"--eval-episodes {episodes} is not allowed; there are {len(VALIDATION)} validation seeds.")
    every = wish.eval_every or known.get("eval_every", max(values["n_timesteps"] // 20, 1))
    plan = Plan(
        algorithm=algorithm,
        env_id=env_id,
        name=name,
        seed=seed,
        values=values,
        task=task,
        overrides=overrides,
        gains=found,
        eval_every=every,
        eval_episodes=episodes,
        checkpoint_every=wish.checkpoint_every or known.get("checkpoint_every", every),
    )
    of_source = nullcontext() if source is None else naming(f"settings of {source}")
    with of_source, naming("env_kwargs.scenario is not allowed"):
        _ = plan.practice
    return plan


def check_same(plan: Plan, recorded: Mapping[str, Any], folder: Path) -> None:
    """Refuse to go on with a run under other settings than those it was begun with.

    Raises:
        CommandError: Something is unlike.
    """
    wanted = plan.to_dict()
    for key in ("algorithm", "env", "seed"):
        if wanted[key] != recorded.get(key):
            raise CommandError(f"--resume: the run in {folder} has {key} = {recorded.get(key)!r}, not {wanted[key]!r}.")
    for key in wanted["settings"] | recorded["settings"]:
        old, new = recorded["settings"].get(key), wanted["settings"].get(key)
        if old != new:
            raise CommandError(f"--resume: the run in {folder} has {key} = {old!r}, not {new!r}; begin another run.")
    if plan.task != _recorded_task(recorded) or wanted["overrides"] != recorded["overrides"]:
        raise CommandError(f"--resume: the run in {folder} has another scenario; leave out --scenario and --override.")
    if wanted["eval_episodes"] != recorded.get("eval_episodes"):
        raise CommandError(f"--resume: the run in {folder} has --eval-episodes {recorded.get('eval_episodes')}.")


def _environment(wish: Wish, known: Mapping[str, Any]) -> tuple[str, str, Scenario | None, tuple[dict[str, Any], ...]]:
    """The environment's ID, what is trained on in a word, its scenario, and what was changed in it."""
    from uwoc_gym.agents.learning.environments import base_scenario

    if wish.env is not None and wish.scenario is not None:
        raise CommandError("--scenario is not allowed beside --env, which says the scenario already; leave out one.")
    if wish.scenario is None and wish.override is None and wish.env in (None, known.get("env")) and known:
        # Refuses an environment that isn't there any more.
        with naming("run.json"):
            base_scenario(known["env"])
        return known["env"], known["name"], _recorded_task(known), tuple(known["overrides"])
    if wish.scenario is not None:
        found = said(wish.scenario, wish.override)
        # A file that says everything is no named scenario's: the settings' default entry holds for it.
        env_id = next(each for each, name in ENV_IDS.items() if name == (found.base or "Nominal"))
        return env_id, _called(found, env_id), found.scenario, found.changes
    env_id = known.get("env", DEFAULT_ENV) if wish.env is None else wish.env
    base = base_scenario(env_id)
    if wish.override is None:
        return env_id, env_id, base, ()
    if base is None:
        raise CommandError(f"--override is not allowed for {env_id!r}, which isn't one of this package's.")
    with naming("--override"):
        changes = json_object(wish.override)
        return env_id, env_id, base.merged(changes), (changes,) if changes else ()


def _recorded_task(recorded: Mapping[str, Any]) -> Scenario | None:
    with naming("run.json"):
        return None if recorded.get("scenario") is None else Scenario.from_dict(recorded["scenario"])


def _called(found: Said, env_id: str) -> str:
    return env_id if found.name == found.base else found.name


def _overridden(wish: Wish, algorithm: str, values: dict[str, Any]) -> dict[str, Any]:
    values = settings.assigned(algorithm, values, wish.set)
    residual: Any = wish.residual
    if residual is not None and residual.endswith(".json"):
        with naming("--residual"):
            residual = json_object(residual, file=True)
        with naming(f"--residual {shown(wish.residual)}"):
            _gains(residual)
    given = {
        "n_timesteps": wish.steps,
        "n_envs": wish.envs,
        "residual": residual,
        "residual_scale": wish.scale,
        "frame_stack": wish.frame_stack,
    }
    return settings.checked(
        algorithm, values | {key: value for key, value in given.items() if value is not None}, "option"
    )


def _gains(given: Any) -> Gains | None:
    """The gains of the controller that is corrected."""
    if given is None:
        return None
    try:
        return Gains.from_dict(given) if isinstance(given, dict) else gains(given)
    except SettingError as error:
        hint = closest(given, GAINS) if isinstance(given, str) else str(error)
        raise CommandError(f"residual = {shown(given)} is not allowed; {hint}") from None


def _task(base: Scenario | None, values: Mapping[str, Any]) -> Scenario | None:
    """The scenario to evaluate in: that which was asked for, with the periods that the settings say."""
    if base is None:
        return None
    given = {key: value for key, value in values["env_kwargs"].items() if key != "scenario"}
    for key in given:
        if key not in PERIODS:
            raise CommandError(
                f"env_kwargs has {shown(key)}, which is not known; {closest(key, ['scenario', *PERIODS])}"
            )
    with naming("env_kwargs"):
        return base.merged({"episode": given})

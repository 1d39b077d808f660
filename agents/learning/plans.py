"""What a training is asked to be, as data, and what it comes to once everything has been checked."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping
from contextlib import closing, nullcontext
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uwoc_gym.agents import places
from uwoc_gym.agents.errors import CommandError, naming, require
from uwoc_gym.agents.flight import decide
from uwoc_gym.agents.learning import settings
from uwoc_gym.agents.learning.seeds import training_seed
from uwoc_gym.agents.learning.settings import TRAINABLE
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.policies.corrections import Correction, correction
from uwoc_gym.agents.policies.registry import gains_of_file, gains_path
from uwoc_gym.agents.policies.residual import check_actions
from uwoc_gym.agents.policies.saved import beliefs_of
from uwoc_gym.agents.reports.files import read_json
from uwoc_gym.agents.scenarios import Said, changes_of, json_object, merged, said
from uwoc_gym.agents.wrapping import Wrapping, wrapping
from uwoc_gym.baselines.policy import Onlooker
from uwoc_gym.given import LIMITS, closest, shown
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import Scenario

DEFAULT_ENV = "uwoc/Random-v0"

_POLICIES = ("residual", "teacher")
"""The settings that name a policy."""

PERIODS = ("control_period_s", "integration_step_s")
"""The arguments of our environments, besides ``scenario``, that settings may hold."""


@dataclass(frozen=True, kw_only=True)
class Wish:
    """What a training is asked to be: the options of `uwoc-gym train`, None where nothing was said."""

    algorithm: str | None = None
    env: str | None = None
    scenario: str | None = None
    override: tuple[str, ...] = ()
    wrapper: tuple[str, ...] = ()
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
    trust: bool = False
    """Whether code may be run that a file names: a run's, its settings' or an agent's. What is named here always is."""

    @property
    def names_code(self) -> bool:
        """Whether the run will name code, so that going on with it needs trust."""
        assigned = [value for each in self.set for key, _, value in [each.partition("=")] if key.strip() in _POLICIES]
        return self.trust or bool(self.wrapper) or any(map(_is_code, (self.residual or "", self.env or "", *assigned)))

    def words(self) -> list[str]:
        """The options that say the same on the command line."""
        words: list[str] = []
        for field in fields(self):
            value = getattr(self, field.name)
            option = "--" + field.name.replace("_", "-")
            if isinstance(value, bool):
                words += [option] if value else []
                continue
            for each in value if isinstance(value, tuple) else () if value is None else (value,):
                words += [option, str(each)]
        return words


@dataclass(frozen=True)
class Job:
    """A training and where it keeps everything."""

    wish: Wish
    folder: str
    """Its path, or its address, which is the same wherever it is trained."""

    @property
    def name(self) -> str:
        """What to call it."""
        return Path(self.folder).name

    @property
    def command(self) -> str:
        """The command that would do the same."""
        return shlex.join(["uwoc-gym", "train", *self.wish.words(), "--out", self.folder])


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
    base: Scenario | None
    """The scenario before that."""
    wrapping: Wrapping
    """What stands around the environments."""
    corrected: Correction | None
    """What the agent corrects, if anything."""
    teacher: Correction | None
    """Whom the agent is still to copy before it learns from rewards, if anyone."""
    teacher_sha256: str | None
    """Of the teacher's file, where that is an agent's."""
    eval_every: int
    eval_episodes: int
    checkpoint_every: int

    @property
    def practice(self) -> Scenario | None:
        """What is trained on: the scenario with the settings' own overrides, then with what was asked for.

        Raises:
            CommandError: The one or the other isn't allowed.
        """
        if self.base is None:
            return None
        own = self.values["env_kwargs"].get("scenario")
        with naming("env_kwargs.scenario is not allowed"):
            practice = self.base.merged({} if own is None else own)
        with naming("--override, in what the settings train on (env_kwargs.scenario)" if own else "--override"):
            return merged(practice, self.overrides)

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
                    "base": self.base.to_dict() if self.base is not None else None,
                    "wrappers": self.wrapping.plain(),
                    "corrected_sha256": None if self.corrected is None else self.corrected.digest,
                    "teacher_sha256": self.teacher_sha256,
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
    # Theirs say what is to be, and not by how much more, so that it can be said again.
    found.setdefault("base", found.get("scenario"))
    found.setdefault("wrappers", [])
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
    ("base", "null or a mapping of settings", lambda value: value is None or isinstance(value, dict)),
    (
        "wrappers",
        "a list of names and options of wrappers",
        lambda value: (
            isinstance(value, list)
            and all(
                isinstance(each, dict)
                and each.keys() == {"name", "options"}
                and isinstance(each["name"], str)
                and isinstance(each["options"], dict)
                for each in value
            )
        ),
    ),
    ("seed", "a whole number", _is_count("seed")),
    ("eval_every", LIMITS["steps"].allowed, _is_count("steps")),
    ("eval_episodes", LIMITS["seeds"].allowed, _is_count("seeds")),
    ("checkpoint_every", LIMITS["steps"].allowed, _is_count("steps")),
)
"""What a ``run.json`` holds, in words and as a check."""

_MAY_LACK = ("seed", "eval_every", "eval_episodes", "checkpoint_every")


def planned(wish: Wish, recorded: Mapping[str, Any] | None = None, taught: bool = False) -> Plan:
    """The plan of a wish; what it leaves open is as recorded, or the default.

    Args:
        wish: What was asked for.
        recorded: What the run that is to go on says it is, as `recorded_plan` gives it.
        taught: Whether it has copied its teacher, who need not be there any more.

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
    where = _environment(wish, known)
    env_id = where.env_id
    own_file = None if wish.settings is None else Path(wish.settings)
    if recorded is not None and own_file is None and recorded["algorithm"] == algorithm and recorded["env"] == env_id:
        values = settings.checked(algorithm, recorded["settings"], "run.json")
    else:
        values, _ = settings.resolve(algorithm, env_id, path=own_file)
    values = _overridden(wish, algorithm, values)
    source = "run.json" if recorded is not None and own_file is None else own_file
    of_source = nullcontext() if source is None else naming(f"settings of {source}")
    with of_source:
        _check_arguments(where, values)
        _check_filters(where, values)
        if values["staggered"] and not where.fleet:
            raise CommandError(f"staggered is not allowed for {env_id!r}, of which there is no fleet.")
        base, task = (_with_periods(each, values) for each in (where.base, where.task))
    found: dict[str, Correction | None] = dict.fromkeys(_POLICIES)
    for key in _POLICIES[:1] if taught else _POLICIES:
        given = values[key]
        with nullcontext() if _is_typed(wish, key) else naming(f"settings of {source or algorithm}"):
            if not wish.trust and isinstance(given, str) and not _is_typed(wish, key):
                _check_trusted(f"{key} = {shown(given)}", given)
            found[key] = _other(where, key, given, wish.trust)
    corrected, teacher = found["residual"], found["teacher"]
    if not wish.wrapper and not wish.trust:
        for each in known.get("wrappers", ()):
            _check_trusted(f"run.json: wrapper {shown(each['name'])}", each["name"])
    around = wrapping(wish.wrapper or known.get("wrappers", ()))
    episodes = wish.eval_episodes or known.get("eval_episodes", 32)
    every = wish.eval_every or known.get("eval_every", max(values["n_timesteps"] // 20, 1))
    plan = Plan(
        algorithm=algorithm,
        env_id=env_id,
        name=where.name,
        seed=seed,
        values=values,
        task=task,
        base=base,
        overrides=where.changes,
        wrapping=around if where.fleet or base is None else _of_singles(where, around, values),
        corrected=corrected,
        teacher=teacher,
        teacher_sha256=known.get("teacher_sha256") if teacher is None else teacher.digest,
        eval_every=every,
        eval_episodes=episodes,
        checkpoint_every=wish.checkpoint_every or known.get("checkpoint_every", every),
    )
    with nullcontext() if source is None else naming(f"settings of {source}"):
        _ = plan.practice
    _check_flown(plan)
    return plan


def _is_typed(wish: Wish, setting: str) -> bool:
    """Whether a setting is of the command line, rather than of a file."""
    return getattr(wish, setting, None) is not None or any(
        each.partition("=")[0].strip().split(".")[0] == setting for each in wish.set
    )


def _is_code(name: str) -> bool:
    """Whether a name has a module to import that isn't this package."""
    module, colon, _ = name.partition(":")
    return bool(colon) and module != "uwoc_gym" and not places.elsewhere(name)


def _check_trusted(what: str, name: str) -> None:
    """Refuse to import what a file names, unless it is this package's own.

    Raises:
        CommandError: It is code.
    """
    if _is_code(name):
        raise CommandError(
            f"{what} is code, which a file names, and going on would run it; if you trust whoever made the file, give "
            "--trust, or name the code on the command line again."
        )


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
    if wanted["wrappers"] != recorded["wrappers"]:
        raise CommandError(f"--resume: the run in {folder} has other wrappers; leave out --wrapper.")
    if wanted["corrected_sha256"] != recorded.get("corrected_sha256"):
        raise CommandError(
            f"--resume: the run in {folder} corrects another agent than {wanted['settings']['residual']!r} is now; put "
            "that one back."
        )
    if wanted["teacher_sha256"] != recorded.get("teacher_sha256"):
        raise CommandError(
            f"--resume: the run in {folder} copies another agent than {wanted['settings']['teacher']!r} is now; put "
            "that one back."
        )
    if wanted["eval_episodes"] != recorded.get("eval_episodes"):
        raise CommandError(f"--resume: the run in {folder} has --eval-episodes {recorded.get('eval_episodes')}.")


class _Where(NamedTuple):
    """Where is trained."""

    env_id: str
    name: str
    """The same in a word."""
    base: Scenario | None
    """Before anything was asked to be changed; None for environments of others."""
    task: Scenario | None
    """With what was asked to be changed."""
    changes: tuple[dict[str, Any], ...]
    fleet: bool
    """Whether there is a fleet of it."""


def _environment(wish: Wish, known: Mapping[str, Any]) -> _Where:
    from uwoc_gym.agents.learning.environments import base_of

    if wish.env is not None and wish.scenario is not None:
        raise CommandError("--scenario is not allowed beside --env, which says the scenario already; leave out one.")
    if wish.scenario is None and not wish.override and wish.env in (None, known.get("env")) and known:
        # Refuses an environment that isn't there any more.
        with naming("run.json"):
            if wish.env is None and not wish.trust:
                _check_trusted(f"env = {shown(known['env'])}", known["env"])
            fleet = base_of(known["env"]).fleet
            base = None if known["base"] is None else Scenario.from_dict(known["base"])
        changes = tuple(known["overrides"])
        return _Where(known["env"], known["name"], base, _recorded_task(known), changes, fleet)
    if wish.scenario is not None:
        found = said(wish.scenario, wish.override)
        # A file that says everything is no named scenario's: the settings' default entry holds for it.
        env_id = next(each for each, name in ENV_IDS.items() if name == (found.base or "Nominal"))
        own = Scenario.named(found.base) if found.base is not None else said(wish.scenario).scenario
        return _Where(env_id, _called(found, env_id), own, found.scenario, found.changes, fleet=True)
    env_id = known.get("env", DEFAULT_ENV) if wish.env is None else wish.env
    if wish.env is None and not wish.trust:
        with naming("run.json"):
            _check_trusted(f"env = {shown(env_id)}", env_id)
    base, fleet = base_of(env_id)
    changes = changes_of(wish.override)
    if base is None and wish.override:
        raise CommandError(f"--override is not allowed for {env_id!r}, {_OTHERS}, so that there is no scenario.")
    with naming("--override"):
        return _Where(env_id, env_id, base, None if base is None else merged(base, changes), changes, fleet)


_OTHERS = "which isn't a TrackingEnv of this package, by itself or in wrappers that keep its observations and actions"


def _recorded_task(recorded: Mapping[str, Any]) -> Scenario | None:
    with naming("run.json"):
        return None if recorded.get("scenario") is None else Scenario.from_dict(recorded["scenario"])


def _called(found: Said, env_id: str) -> str:
    return env_id if found.name == found.base else found.name


def _overridden(wish: Wish, algorithm: str, values: dict[str, Any]) -> dict[str, Any]:
    values = settings.assigned(algorithm, values, wish.set)
    residual: Any = wish.residual
    gains = None if residual is None else gains_path(places.local(residual))
    if gains is not None:
        # The run holds the gains themselves, whatever becomes of the file.
        with naming("--residual"):
            gains_of_file(gains)
            residual = json_object(str(gains), file=True)
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


def _other(where: _Where, key: str, given: Any, trust: bool) -> Correction | None:
    """The policy that is corrected (``residual``) or copied (``teacher``).

    Raises:
        CommandError: There is no such policy, it can't fly the scenario, or the environment isn't ours.
    """
    if given is None:
        return None
    if where.task is None:
        raise CommandError(f"{key} is not allowed for {where.env_id!r}, {_OTHERS}: no policy knows what it sees.")
    found = correction(given, trust, key)
    assert found is not None
    with naming(f"{key} = {shown(given)} is not allowed"):
        if key == "residual":
            check_actions((len(where.task.actions),))
        if isinstance(found.policy.pilot(where.task), Onlooker):
            raise CommandError("it decides on what no observation tells.")
    return found


def _check_filters(where: _Where, values: Mapping[str, Any]) -> None:
    """Refuse filters that have nothing to filter.

    Raises:
        CommandError: The environment isn't ours, or its observations leave out what filters need.
    """
    if not values["filtered"]:
        return
    if where.task is None:
        raise CommandError(f"filtered is not allowed for {where.env_id!r}, {_OTHERS}: no filter knows what it sees.")
    with naming(f"filtered = {shown(values['filtered'])} is not allowed"):
        beliefs_of(values, where.task)


def _check_arguments(where: _Where, values: Mapping[str, Any]) -> None:
    """Refuse arguments of the environment that ours don't have; single environments may have any."""
    given = {key: value for key, value in values["env_kwargs"].items() if key != "scenario"}
    for key in given if where.fleet and where.base is not None else ():
        if key not in PERIODS:
            raise CommandError(
                f"env_kwargs has {shown(key)}, which is not known; {closest(key, ['scenario', *PERIODS])}"
            )


def _with_periods(scenario: Scenario | None, values: Mapping[str, Any]) -> Scenario | None:
    """The scenario with the periods that the settings say."""
    if scenario is None:
        return None
    with naming("env_kwargs"):
        given = {key: value for key, value in values["env_kwargs"].items() if key in PERIODS}
        return scenario.merged({"episode": given})


def _of_singles(where: _Where, around: Wrapping, values: Mapping[str, Any]) -> Wrapping:
    """The wrappers around the single environments of an ID that has no fleet."""
    from uwoc_gym.agents.learning.environments import singles

    assert where.base is not None
    rest = {key: value for key, value in values["env_kwargs"].items() if key not in ("scenario", *PERIODS)}
    return replace(around, single=singles(where.env_id, where.base, rest))


def _check_flown(plan: Plan) -> None:
    """Refuse wrappers in which nothing can be trained that flies again, and policies that can't be corrected.

    Raises:
        CommandError: Wrappers can't go around the environments, change the shapes of observations or actions, or fail
            at the first step, or a corrected policy does.
    """
    from uwoc_gym.agents.learning.environments import make_base

    around = plan.wrapping
    for scenario in (plan.practice, plan.task):
        if scenario is None or not (around or plan.corrected or plan.teacher):
            continue
        around.check(scenario)
        with closing(around.fleet(scenario, 1)) as env:
            shapes = (env.single_observation_space.shape, env.single_action_space.shape)
            wanted = ((scenario.observation.size,), (len(scenario.actions),))
            if shapes != wanted:
                raise CommandError(
                    f"{around.name} is not allowed: it makes observations and actions of shapes {shapes[0]} and "
                    f"{shapes[1]}; an agent flies on those of the scenario, {wanted[0]} and {wanted[1]}. --frame-stack "
                    "and the observation groups of --override change what it sees."
                )
            for key, other in zip(_POLICIES, (plan.corrected, plan.teacher), strict=True):
                if other is None:
                    continue
                policy, seen = other.policy, env.reset(seed=0)[0]
                with naming(f"{key} = {shown(plan.values[key])} is not allowed"):
                    decide(policy, policy.pilot(scenario), seen, None, np.ones(1, dtype=bool), wanted[1][0])
    if around:
        # In training episodes begin anew in another way.
        base = make_base(plan.env_id, 1, plan.practice, plan.values["env_kwargs"], around)
        with closing(base), around.blamed():
            base.reset()
            base.step(np.array([base.action_space.sample()]))

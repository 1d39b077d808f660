"""Training settings: read from YAML files like those of rl-baselines3-zoo, overridden, checked, and handed on.

A file belongs to one algorithm and maps environment IDs, or ``default``, to settings. Keys are those of the algorithm's
constructor and those of `OWN`; "lin_3e-4" is a rate that falls to 0 over the run.
"""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Mapping, Sequence
from copy import deepcopy
from functools import cache
from pathlib import Path
from typing import Any

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.policies.algorithms import ALGORITHMS, policy_arguments
from uwoc_gym.agents.policies.registry import MAY_BE
from uwoc_gym.baselines.beliefs import LEARNED
from uwoc_gym.given import (
    DEEPEST,
    LIMITS,
    Limit,
    SettingError,
    as_number,
    as_whole,
    check_plain,
    closest,
    read_text,
    scalar,
    shown,
)

FOLDER = Path(__file__).parents[1] / "settings"
FALLBACK = "default"


TRAINABLE = tuple(name for name in ALGORITHMS if name != "a2c")
"""Those with a settings file."""

NORMALIZE = ("norm_obs", "norm_reward", "clip_obs", "clip_reward", "epsilon")
"""What ``normalize`` may hold: arguments of VecNormalize."""

OWN: dict[str, Any] = {
    "n_envs": 1,
    "n_timesteps": 1_000_000,
    "policy": "MlpPolicy",
    "normalize": False,
    "frame_stack": 1,
    "filtered": False,
    "staggered": False,
    "teacher": None,
    "teacher_steps": 600_000,
    "critic_steps": 0,
    "noise_type": None,
    "noise_std": 0.1,
    "residual": None,
    "residual_scale": 0.5,
    "env_kwargs": {},
}
"""Settings that aren't the algorithm's own, with their defaults.

``env_kwargs`` are arguments of the environment; ``env_kwargs.scenario`` overrides the scenario in training alone, the
others hold in evaluation too. What rl-baselines3-zoo doesn't know: ``filtered`` adds what `Beliefs` adds to the
observations ("learned" where a network tracks the ship); ``residual`` names the policy that the agent corrects by
``residual_scale``; ``staggered`` cuts first episodes short, so that rollouts hold all parts of episodes; ``teacher``
names a policy whose actions the agent copies for ``teacher_steps``, which come before ``n_timesteps``; and in the first
``critic_steps`` of those only its critic learns.
"""

_NOT_SETTINGS = {
    "self", "policy", "env", "seed", "device", "verbose", "tensorboard_log", "action_noise", "replay_buffer_class",
    "rollout_buffer_class", "_init_setup_model",
}  # fmt: skip
_SCHEDULES = ("learning_rate", "clip_range", "clip_range_vf")
_SHARES = ("gamma", "gae_lambda", "tau")
_COUNTS = {
    "n_envs": "environments", "n_timesteps": "steps", "frame_stack": "frames in a row", "n_steps": "transitions",
    "batch_size": "transitions", "n_epochs": "rounds", "buffer_size": "transitions", "stats_window_size": "transitions",
    "policy_delay": "steps", "train_freq": "transitions", "teacher_steps": "transitions",
}  # fmt: skip
"""What counts something, and the name of its bounds in `LIMITS`."""
_LONGEST_YAML = 2**20
"""Bytes of a settings file."""
_LONGEST_TEXT = 10_000
"""Characters of a text such as dict(net_arch=[64, 64])."""
_MOST_ALIASES, _MOST_MERGED = 200, 2000
"""How often YAML may say something again, and how many entries a mapping may take over from others."""
_NOISES = ("normal", "ornstein-uhlenbeck")


def resolve(
    algorithm: str, env_id: str, assignments: Sequence[str] = (), path: Path | None = None
) -> tuple[dict[str, Any], Path]:
    """The settings of an algorithm for an environment, and the file that they come from.

    Args:
        algorithm: A name in `ALGORITHMS`.
        env_id: The environment's ID; where the file has no such entry, ``default`` holds.
        assignments: Overrides such as "n_steps=64" or "policy_kwargs.net_arch=[64,64]", the value in YAML.
        path: A settings file, by default the shipped one.

    Raises:
        CommandError: The file can't be read, or a setting is unknown or not allowed.
    """
    source = path or FOLDER / f"{algorithm}.yaml"
    entries = _read(source)
    bare = env_id.rpartition(":")[2]
    key = next((key for key in (env_id, bare, FALLBACK) if key in entries), None)
    if key is None:
        raise CommandError(f"{source} has no entry for {shown(bare)}; {closest(bare, map(str, entries))}")
    given = entries[key]
    if not isinstance(given, Mapping):
        raise CommandError(f"{source}: {key} = {shown(given)} is not allowed; it must be a mapping of settings.")
    values = checked(algorithm, given, str(source))
    return (assigned(algorithm, values, assignments) if assignments else values), source


def _read(path: Path) -> dict[Any, Any]:
    try:
        found = _from_yaml(read_text(path, _LONGEST_YAML), str(path))
    except SettingError as error:
        raise CommandError(f"settings {error}") from None
    if not isinstance(found, dict):
        raise CommandError(
            f"settings {path} = {shown(found)} is not allowed; it must be a mapping from environment IDs to settings."
        )
    return found


def _from_yaml(text: str, name: str | None = None) -> Any:
    """What a YAML text says; an error calls it by the name, or shows it.

    Raises:
        SettingError: It isn't valid, or nested or grown beyond bounds.
    """
    import yaml

    try:
        found = yaml.load(text, _loader())
        check_plain(found)
    except RecursionError:
        raise SettingError(f"{name or shown(text)} isn't valid YAML: it is nested too deeply.") from None
    except (yaml.YAMLError, SettingError, ValueError, TypeError, OverflowError) as error:
        # A key that can't be one is a TypeError, a date or a number that can't be one a ValueError.
        raise SettingError(f"{name or shown(text)} isn't valid YAML: {error}") from None
    return found


@cache
def _loader() -> Any:
    """The class that reads YAML without running it, and gives up where it says the same too often."""
    import yaml

    class Bounded(yaml.SafeLoader):  # type: ignore[misc]
        aliases = 0

        def compose_node(self, parent: Any, index: Any) -> Any:
            self.aliases += self.check_event(yaml.AliasEvent)
            if self.aliases > _MOST_ALIASES:
                raise SettingError(f"it says something again more than {_MOST_ALIASES} times.")
            return super().compose_node(parent, index)

        def flatten_mapping(self, node: Any) -> None:
            super().flatten_mapping(node)
            if len(node.value) > _MOST_MERGED:
                raise SettingError(f"a mapping has more than {_MOST_MERGED} entries.")

    return Bounded


def assigned(algorithm: str, values: Mapping[str, Any], assignments: Sequence[str]) -> dict[str, Any]:
    """The settings with overrides such as "policy_kwargs.net_arch=[64,64]".

    Raises:
        CommandError: An override isn't of the form key=value, or the setting is unknown or not allowed.
    """
    result = deepcopy(dict(values))
    for text in assignments:
        path, equals, value = text.partition("=")
        *parents, last = path.strip().split(".")
        if not equals or not last:
            raise CommandError(f"--set {shown(text)} is not allowed; it must be key=value.")
        if len(parents) > DEEPEST:
            raise CommandError(f"--set {shown(text)} is not allowed; it must name at most {DEEPEST} levels.")
        level = result
        for parent in parents:
            inner = level[parent] = _plain(level.get(parent, {}))
            if not isinstance(inner, dict):
                # What is no mapping gives way to one, as with normalize=true before normalize.norm_reward=false.
                inner = level[parent] = {}
            level = inner
        try:
            level[last] = _from_yaml(value)
        except SettingError as error:
            raise CommandError(f"--set {shown(text)} is not allowed; the value must be valid YAML: {error}") from None
    return checked(algorithm, result, "--set")


def _parameters(algorithm: str) -> dict[str, Any]:
    """Default of each setting of the algorithm's constructor."""
    signature = inspect.signature(ALGORITHMS[algorithm].load().__init__)
    return {name: each.default for name, each in signature.parameters.items() if name not in _NOT_SETTINGS}


def checked(algorithm: str, values: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The settings as plain data with every value checked; those of `OWN` that are left out have their defaults.

    Raises:
        CommandError: A setting is unknown (the nearest valid name is given) or not allowed.
    """
    try:
        check_plain(values)
    except SettingError as error:
        raise CommandError(f"{where}: the settings = {shown(values)} are not allowed: {error}") from None
    values = OWN | dict(values)
    defaults = _parameters(algorithm)
    known = [*OWN, *defaults]
    result: dict[str, Any] = {}
    for key, given in values.items():
        if key not in known:
            raise CommandError(f"{where}: {algorithm} has no setting {shown(key)}; {closest(key, known)}")
        value = _plain(given)
        try:
            result[key] = _own(key, value) if key in OWN else _of_algorithm(key, value, defaults[key])
        except _NotAllowedError as error:
            raise CommandError(f"{where}: {key} = {shown(given)} is not allowed; it must be {error}.") from None
    names = _policy_names(algorithm, result["policy"], where)
    for key in result.get("policy_kwargs") or {}:
        if key not in names:
            raise CommandError(f"{where}: policy_kwargs has no setting {shown(key)}; {closest(key, names)}")
    _check_together(algorithm, result, where)
    return result


def _check_together(algorithm: str, values: Mapping[str, Any], where: str) -> None:
    """Refuse settings that only fail beside others."""
    layers = (values.get("policy_kwargs") or {}).get("net_arch", [])
    widest, most = int(LIMITS["width of a layer"].high), int(LIMITS["layers"].high)
    for part in layers.values() if isinstance(layers, dict) else (layers,):
        widths = [as_whole(size) for size in part] if isinstance(part, (list, tuple)) and len(part) <= most else [None]
        if not all(width is not None and 0 < width <= widest for width in widths):
            raise CommandError(
                f"{where}: policy_kwargs.net_arch = {shown(layers)} is not allowed; it must be at most {most} widths "
                f"from 1 to {widest}, such as [64, 64]."
            )
    for key, value in (values.get("policy_kwargs") or {}).items():
        number = as_number(value)
        if number is not None and not abs(number) <= widest:
            raise CommandError(
                f"{where}: policy_kwargs.{key} = {shown(value)} is not allowed; it must be from {-widest} to {widest}."
            )
    most = int(LIMITS["transitions"].high)
    rollout = values.get("n_steps", 1) * values.get("n_envs", 1)
    if rollout > most:
        raise CommandError(
            f"{where}: n_steps = {values.get('n_steps', 1)} with n_envs = {values.get('n_envs', 1)} is not allowed; "
            f"their product must be at most {most:_}."
        )
    _check_teacher(algorithm, values, where)
    if not ALGORITHMS[algorithm].off_policy:
        return
    if values.get("normalize") and values.get("frame_stack", 1) > 1:
        raise CommandError(
            f"{where}: normalize = {values['normalize']!r} is not allowed with frame_stack = {values['frame_stack']} "
            "and an off-policy algorithm, whose replay buffer keeps single observations; leave out one of them."
        )
    frequency = values.get("train_freq")
    if isinstance(frequency, list) and frequency[1] == "episode" and values.get("n_envs", 1) > 1:
        raise CommandError(
            f"{where}: train_freq = {frequency!r} is not allowed with n_envs = {values['n_envs']}; episodes can only "
            "be counted in one environment."
        )


TAUGHT = ("ppo",)
"""The algorithms whose agents can copy a teacher: those with a mean action and a critic apart from it, no memory."""


def _check_teacher(algorithm: str, values: Mapping[str, Any], where: str) -> None:
    """Refuse a teacher, and a time for the critic alone, where there is no place for one."""
    for key in ("teacher", "critic_steps"):
        if values[key] and algorithm not in TAUGHT:
            raise CommandError(
                f"{where}: {key} = {shown(values[key])} is not allowed for {algorithm}; the algorithm must be "
                f"{' or '.join(TAUGHT)}."
            )
    if values["teacher"] is None:
        if 0 < values["n_timesteps"] <= values["critic_steps"]:
            raise CommandError(
                f"{where}: critic_steps = {values['critic_steps']} is not allowed with n_timesteps = "
                f"{values['n_timesteps']}; it must be less, so that the policy learns too."
            )
        return
    if values["residual"] is not None:
        raise CommandError(
            f"{where}: teacher = {shown(values['teacher'])} is not allowed with residual = "
            f"{shown(values['residual'])}, whose agent acts on something else; leave out one of them, the teacher by "
            "--set teacher=null."
        )
    normalize = values["normalize"]
    if normalize is True or (normalize and normalize.get("norm_obs", True)):
        raise CommandError(
            f"{where}: teacher = {shown(values['teacher'])} is not allowed with normalize = {shown(normalize)}, under "
            "which the same observation looks another way later; set normalize.norm_obs=false, or teacher=null."
        )
    if (values.get("policy_kwargs") or {}).get("squash_output"):
        raise CommandError(
            f"{where}: teacher = {shown(values['teacher'])} is not allowed with policy_kwargs.squash_output, which "
            "bends what was copied; leave out one of them."
        )


class _NotAllowedError(Exception):
    """A value is not allowed; the text says what is."""


def _own(key: str, value: Any) -> Any:
    match key:
        case "n_envs" | "n_timesteps" | "frame_stack" | "teacher_steps":
            return _count(key, value)
        case "normalize":
            return _normalize(value)
        case "staggered":
            if not isinstance(value, bool):
                raise _NotAllowedError("true or false")
        case "filtered":
            if not isinstance(value, bool) and value != LEARNED:
                raise _NotAllowedError(f"true, false or {LEARNED}")
        case "noise_type":
            if value is not None and not (isinstance(value, str) and value in _NOISES):
                raise _NotAllowedError(f"null or one of {', '.join(_NOISES)}")
        case "noise_std":
            return _number(value, 0.0, math.inf)
        case "residual_scale":
            number = _number(value, 0.0, 2.0, "a number in (0, 2]")
            if number == 0.0:
                raise _NotAllowedError("a number in (0, 2]")
            return number
        case "env_kwargs":
            if value is not None and not isinstance(value, dict):
                raise _NotAllowedError("a mapping of arguments of the environment")
            return value or {}
        case "policy":
            if not isinstance(value, str):
                raise _NotAllowedError("the name of a policy, such as MlpPolicy")
        case "critic_steps":
            return _whole(value, 0, LIMITS["steps"].high)
        case "residual" | "teacher":
            if value is not None and not isinstance(value, (str, dict)):
                raise _NotAllowedError(f"null, a mapping of gains, or {MAY_BE}")
    return value


def _normalize(value: Any) -> Any:
    if isinstance(value, bool):
        return value
    if not isinstance(value, dict) or not value.keys() <= set(NORMALIZE):
        raise _NotAllowedError(f"true, false or a mapping with {', '.join(NORMALIZE)}")
    for key, each in value.items():
        if key.startswith("norm_"):
            if not isinstance(each, bool):
                raise _NotAllowedError(f"a mapping in which {key} is true or false")
        else:
            _number(each, 0.0, math.inf, f"a mapping in which {key} is a number of at least 0")
    return value


def _of_algorithm(key: str, value: Any, default: Any) -> Any:
    if value is None and (default is None or key == "batch_size"):
        return value
    if key in _SCHEDULES:
        if isinstance(value, str) and value.startswith("lin_"):
            _number(_plain(value[4:]), 0.0, math.inf, "a number or lin_ and a number, such as lin_3e-4")
            return value
        return _number(value, 0.0, math.inf, "a number or lin_ and a number, such as lin_3e-4")
    if key == "target_kl":
        return _number(value, 0.0, math.inf)
    if key in _SHARES:
        return _number(value, 0.0, 1.0)
    if key == "train_freq" and isinstance(value, (list, tuple)):
        if len(value) != 2 or value[1] not in ("step", "episode"):
            raise _NotAllowedError("a whole number or [number, 'step' or 'episode']")
        return [_count(key, value[0]), value[1]]
    if isinstance(default, bool):
        if not isinstance(value, bool):
            raise _NotAllowedError("true or false")
        return value
    if isinstance(default, int):
        return _count(key, value) if key in _COUNTS else _whole(value, -1, 10**9)
    if isinstance(default, float):
        return _number(value, -math.inf, math.inf)
    if key.endswith("_kwargs") and not isinstance(value, dict):
        raise _NotAllowedError("a mapping or a text such as dict(net_arch=[64, 64])")
    return value


def _count(key: str, value: Any) -> int:
    bounds = LIMITS[_COUNTS[key]]
    return _whole(value, max(bounds.low, 1), bounds.high)


def _whole(value: Any, low: float, high: float) -> int:
    number = as_whole(value)
    if number is None or not low <= number <= high:
        raise _NotAllowedError(Limit(low, high).allowed)
    return number


def _number(value: Any, low: float, high: float, allowed: str = "") -> float:
    number = as_number(value)
    if number is None or not math.isfinite(number) or not low <= number <= high:
        raise _NotAllowedError(allowed or f"a number in [{low:g}, {high:g}]")
    return number


def _plain(value: Any) -> Any:
    """Numbers that YAML takes for text, such as 3e-4, and Python texts in the style of the zoo, as plain data."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if not isinstance(value, str):
        plain = scalar(value)
        if plain is None or isinstance(plain, (bool, int, float)):
            return plain
        raise CommandError(f"{shown(value)} is not allowed; it must be a number, a text, true, false, null or these.")
    try:
        number = float(value)
    except ValueError:
        pass
    else:
        return number if math.isfinite(number) else value
    if value.strip().startswith(("dict(", "{")):
        try:
            if len(value) > _LONGEST_TEXT:
                raise ValueError
            found = _evaluated(ast.parse(value.strip(), mode="eval").body)
            check_plain(found)
            return _plain(found)
        # Python's parser gives up on deep nesting in one of these ways.
        except (SyntaxError, ValueError, TypeError, RecursionError, MemoryError):
            raise CommandError(
                f"{shown(value)} is not allowed; it must be dict(...) of numbers, texts and lists, at most {DEEPEST} "
                f"levels deep."
            ) from None
    return value


def _evaluated(node: ast.expr) -> Any:
    """What a text such as "dict(net_arch=[64, 64], activation_fn=nn.ReLU)" says, without running it."""
    match node:
        case ast.Call(func=ast.Name(id="dict"), args=[], keywords=pairs) if all(pair.arg for pair in pairs):
            return {pair.arg: _evaluated(pair.value) for pair in pairs}
        case ast.Dict(keys=keys, values=values) if None not in keys:
            return {ast.literal_eval(key): _evaluated(value) for key, value in zip(keys, values, strict=True) if key}
        case ast.List(elts=items) | ast.Tuple(elts=items):
            return [_evaluated(item) for item in items]
        case ast.Attribute(value=ast.Name(id="nn"), attr=name):
            return f"nn.{name}"
        case _:
            return ast.literal_eval(node)


def _policy_class(algorithm: str, name: str, where: str) -> Any:
    aliases = ALGORITHMS[algorithm].load().policy_aliases
    if name not in aliases:
        raise CommandError(f"{where}: policy = {shown(name)} is not allowed; {closest(name, aliases)}")
    return aliases[name]


def _policy_names(algorithm: str, policy: str, where: str) -> list[str]:
    signature = inspect.signature(_policy_class(algorithm, policy, where).__init__)
    return [name for name in signature.parameters if name not in ("self", "observation_space", "action_space")]


def constructor_arguments(algorithm: str, values: Mapping[str, Any], action_size: int) -> dict[str, Any]:
    """The arguments of the algorithm's constructor, but for policy, environment and seed.

    Args:
        algorithm: A name in `ALGORITHMS`.
        values: Checked settings.
        action_size: Length of an action, for the noise of off-policy algorithms.

    Raises:
        CommandError: An activation function doesn't exist, or the algorithm takes no action noise.
    """
    result = {key: deepcopy(value) for key, value in values.items() if key not in OWN}
    for key in _SCHEDULES:
        if isinstance(result.get(key), str):
            from stable_baselines3.common.utils import LinearSchedule

            # A class of Stable-Baselines3, unlike a closure, loads in any version of Python.
            result[key] = LinearSchedule(float(result[key][4:]), 0.0, 1.0)
    if isinstance(result.get("train_freq"), list):
        result["train_freq"] = tuple(result["train_freq"])
    if result.get("policy_kwargs"):
        result["policy_kwargs"] = policy_arguments(result["policy_kwargs"])
    noise = values["noise_type"]
    if noise is not None:
        if not ALGORITHMS[algorithm].off_policy:
            raise CommandError(f"noise_type = {noise!r} is not allowed; {algorithm} explores by its own randomness.")
        import numpy as np
        from stable_baselines3.common.noise import NormalActionNoise, OrnsteinUhlenbeckActionNoise

        kind = NormalActionNoise if noise == "normal" else OrnsteinUhlenbeckActionNoise
        result["action_noise"] = kind(np.zeros(action_size), np.full(action_size, values["noise_std"]))
    return result


def written(values: Mapping[str, Any]) -> dict[str, Any]:
    """The settings as they stand in a file, without what the defaults say anyway, so that the zoo reads it too."""
    always = ("n_envs", "n_timesteps", "policy")
    return {key: value for key, value in values.items() if key in always or key not in OWN or value != OWN[key]}

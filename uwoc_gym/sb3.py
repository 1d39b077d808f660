"""The Stable-Baselines3 environment: the same fleet of N. Only here is Stable-Baselines3 imported."""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.env_util import is_wrapped
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from uwoc_gym.given import is_sequence, shown, values_of
from uwoc_gym.scenario import as_scenario
from uwoc_gym.spaces import ScenarioLike, check_options, check_seed
from uwoc_gym.vector_env import TrackingVectorEnv
from uwoc_gym.wrapping import Wrapper, single_env, singles_of, split, vector_env


class TrackingVecEnv(VecEnv):
    """N environments for Stable-Baselines3, without subprocesses or copies of the physics.

    Environment i equals ``gym.make(env_id)`` seeded with ``seed + i``.

    Args:
        env_id: A registered ID of this package, such as "uwoc/Random-v0", possibly "module:ID".
        n_envs: Number of environments N.
        seed: Seed of the first environment; None for entropy from the operating system.
        scenario: Overrides, a whole `Scenario`, or its name.
        info_keys: Entries of `info` that every step's info dicts carry; none by default, since N dicts a step cost
            more than the physics. Infos at an episode's end are always complete.
        wrapper: What goes around the environments, or several of such, the first innermost: a `gymnasium.Wrapper` or
            any callable goes around each single environment, which are then stepped one by one; a
            `gymnasium.vector.VectorWrapper`, or a callable that says ``vector = True``, goes around the whole fleet. A
            vector wrapper that remembers anything must heed ``reset(options={"reset_mask": mask})``, which those of
            Gymnasium that do, such as `NormalizeObservation`, refuse: they need environments that begin anew in the
            next step.
        env_kwargs: Further arguments of `TrackingVectorEnv`.

    Attributes:
        vector_env: The environments in their wrappers.
        scenario: What they fly.

    Raises:
        ValueError: The ID has no `TrackingVectorEnv`, an entry of ``info_keys`` is unknown, the wrappers or their order
            aren't allowed, or ``max_episode_steps`` beside wrappers of single environments is above the scenario's.
        TypeError: A wrapper returned something else than what it was given, wrapped.
    """

    def __init__(
        self,
        env_id: str,
        n_envs: int = 1,
        seed: int | None = None,
        scenario: ScenarioLike | None = None,
        info_keys: Sequence[str] = (),
        wrapper: Wrapper | Sequence[Wrapper] = (),
        **env_kwargs: Any,
    ) -> None:
        if scenario is not None:
            env_kwargs["scenario"] = scenario
        wrappers = _wrappers(wrapper)
        around, vectors = split(wrappers)
        # Gymnasium's vector wrappers don't go around environments that begin anew within a step.
        self._begins_anew = AutoresetMode.DISABLED if vectors else AutoresetMode.SAME_STEP
        made = _made(env_id, n_envs, self._begins_anew, env_kwargs)
        self.scenario = made.scenario
        steps, most = env_kwargs.get("max_episode_steps"), made.scenario.episode.steps
        if around and steps is not None and steps > most:
            raise ValueError(
                f"max_episode_steps = {shown(steps)} is not allowed in wrappers of single environments; it must be at "
                f"most the scenario's {most}, which episode.duration_s sets."
            )

        def single() -> gym.Env[Any, Any]:
            env = single_env(made.scenario, render_mode=made.render_mode, render_size=made.render_size)
            return env if steps is None else gym.wrappers.TimeLimit(env, steps)

        self.vector_env: VectorEnv[Any, Any, Any] = vector_env(
            lambda: made, single, made.num_envs, wrappers, self._begins_anew
        )
        self._singles = singles_of(self.vector_env)
        if not is_sequence(info_keys):
            raise ValueError(f"info_keys = {shown(info_keys)} is not allowed; it must be a list of names.")
        for key in values_of(info_keys):
            if key not in made.info_names:
                known = ", ".join(made.info_names)
                raise ValueError(f"info_keys has {shown(key)}, which is not known; allowed are {known}.")
        self._info_keys = tuple(values_of(info_keys))
        self._actions: Any = None
        self._given: set[str] = set()
        own = self.vector_env
        super().__init__(own.num_envs, own.single_observation_space, own.single_action_space)
        self.render_mode = made.render_mode
        if seed is not None:
            self.seed(seed)

    def seed(self, seed: int | None = None) -> list[int | None]:
        """Set the seeds that the next `reset` uses: ``seed + i`` for environment i.

        Raises:
            ValueError: It isn't a whole number of at least 0; the seeds stay.
        """
        first = check_seed(seed)
        if first is None:
            first = int(np.random.SeedSequence().generate_state(1)[0])
        self._seeds = [first + i for i in range(self.num_envs)]
        return list(self._seeds)

    def set_options(self, options: list[dict[str, Any]] | dict[str, Any] | None = None) -> None:
        """Set the options that the next `reset` uses, and only that one.

        Args:
            options: ``pose``, ``velocity``, ``parameters`` and ``scenario`` as in `TrackingEnv.reset`, for all
                environments, or one such dict for each. Those must have the same keys, and the same scenario.

        Raises:
            ValueError: They aren't allowed; the options stay.
        """
        given: Any = {} if options is None else options
        each: list[Any] = list(given) if is_sequence(given) else [given] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(f"options = {shown(given)} is not allowed; it must be a dict or {self.num_envs} of them.")
        if self._singles is not None:
            if any(other is not each[0] for other in each):
                raise ValueError(
                    f"options = {shown(given)} is not allowed; environments in wrappers of single ones are reset with "
                    "the same options, so that it must be one dict."
                )
            self._singles[0].get_wrapper_attr("check_reset")(options=each[0])
        else:
            self._attribute("check_reset")(options=self._together(each))
        self._options = deepcopy(each)

    def _together(self, each: list[Any]) -> dict[str, Any]:
        """The options of all environments as those of one vector environment."""
        if self._singles is not None:
            return dict(each[0])
        first = check_options(each[0], ("pose", "velocity", "parameters", "scenario"))
        if all(other is each[0] for other in each):
            return dict(first)
        for i, other in enumerate(each):
            if not isinstance(other, Mapping) or other.keys() != first.keys():
                raise ValueError(
                    f"options[{i}] = {shown(other)} is not allowed; it must have the keys of the first, "
                    f"{', '.join(first) or 'none'}, since environments are reset together."
                )
        found: dict[str, Any] = {}
        for key in first:
            values = [other[key] for other in each]
            if all(value is None for value in values):
                continue
            if key == "scenario":
                base = self.scenario
                if any(as_scenario(value, base) != as_scenario(values[0], base) for value in values):
                    raise ValueError(
                        f"options[...]['scenario'] = {shown(values)} is not allowed; it must be the same for all "
                        "environments, which share one fleet."
                    )
                found[key] = values[0]
            elif key == "parameters" and isinstance(values[0], Mapping):
                for i, value in enumerate(values):
                    if not isinstance(value, Mapping) or value.keys() != values[0].keys():
                        raise ValueError(
                            f"options[{i}]['parameters'] = {shown(value)} is not allowed; it must have the names of "
                            "the first, since environments are reset together."
                        )
                found[key] = {name: [value[name] for value in values] for name in values[0]}
            else:
                found[key] = values
        return found

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment; returns observations of shape (N, size)."""
        seeds: list[int | None] | None = list(self._seeds) if any(s is not None for s in self._seeds) else None
        observations, infos = self.vector_env.reset(seed=seeds, options=self._together(self._options))  # type: ignore[arg-type]
        if not isinstance(infos, Mapping):
            raise TypeError(f"a wrapper returned infos of type {type(infos).__name__}; they must be a dict of arrays.")
        self.reset_infos = [_lane(infos, i) for i in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations  # type: ignore[no-any-return]

    def begin_anew(self, mask: Any) -> VecEnvObs:
        """Begin another episode in some environments, whatever becomes of the one that is under way.

        Args:
            mask: Which of them, bool of shape (N,), with at least one.

        Returns:
            The observations, (N, size), of which those of the others are not to be used.

        Raises:
            ValueError: The mask has another type or shape, or nothing has begun yet.
        """
        observations, infos = self.vector_env.reset(options={"reset_mask": np.array(mask)})
        for i in np.flatnonzero(mask).tolist():
            self.reset_infos[i] = _lane(infos, i)
        return observations  # type: ignore[no-any-return]

    def step_async(self, actions: Any) -> None:
        """Take actions of shape (N, actions)."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all environments by one control period."""
        observations: Any
        observations, rewards, terminated, truncated, infos = self.vector_env.step(self._actions)
        done = terminated | truncated
        if self._info_keys:
            columns = [infos[key].tolist() for key in self._info_keys]
            dicts: list[dict[str, Any]] = [
                dict(zip(self._info_keys, row, strict=True)) for row in zip(*columns, strict=True)
            ]
        else:
            dicts = [{} for _ in range(self.num_envs)]
        if done.any():
            last: Any = observations
            final = infos
            if self._begins_anew is AutoresetMode.DISABLED:
                observations, infos = self.vector_env.reset(options={"reset_mask": done.copy()})
            else:
                # The step's own values: `infos` already speaks of the new episode.
                last, final = infos["final_obs"], infos["final_info"]
            for i in np.flatnonzero(done).tolist():
                self.reset_infos[i] = _lane(infos, i)
                dicts[i] = _lane(final, i)
                dicts[i]["terminal_observation"] = np.array(last[i])
                dicts[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
        return observations, rewards.astype(np.float32), done, dicts

    def get_images(self) -> Sequence[Any]:
        """One picture per environment, from which Stable-Baselines3 composes those of `render`."""
        return self.vector_env.render() or ()

    def close(self) -> None:
        """Close the environments."""
        self.vector_env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of the environments: each one's, or where they share a fleet, the fleet's once for each."""
        chosen = self._get_indices(indices)
        if self._singles is not None:
            return [self._singles[i].get_wrapper_attr(attr_name) for i in chosen]
        fleet = self.vector_env.unwrapped
        if attr_name in self._given:
            return [fleet.get_attr(attr_name)[i] for i in chosen]  # type: ignore[attr-defined]
        value = self._attribute(attr_name)
        return [value for _ in chosen]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the environments: each one's, or where they share a fleet, the fleet's.

        Raises:
            ValueError: ``indices`` names only some of a fleet, or its environments share the attribute and were made
                with it; nothing has changed.
        """
        if self._singles is not None:
            for i in self._get_indices(indices):
                self._singles[i].set_wrapper_attr(attr_name, value)
            return
        self._require_all(indices, "set_attr")
        fleet = self.vector_env.unwrapped
        owner = next((each for each in self._layers() if hasattr(each, attr_name)), fleet)
        if owner is fleet:
            fleet.set_attr(attr_name, [value] * self.num_envs)  # type: ignore[attr-defined]
            self._given.add(attr_name)
        else:
            setattr(owner, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the environments, such as "state" or "push"; each of ``indices`` gets its part.

        Of a fleet the method is called once: one that can act on some environments alone, as "push" can, is told which.
        """
        chosen = list(self._get_indices(indices))
        if self._singles is not None:
            own = [self._singles[i].get_wrapper_attr(method_name) for i in chosen]
            return [each(*method_args, **method_kwargs) for each in own]
        method = self._attribute(method_name)
        takes = inspect.signature(method).parameters
        # One that takes nothing else only reads, and gives the parts of all.
        if indices is not None and "lanes" in takes and len(takes) > 1:
            method_kwargs["lanes"] = np.array(chosen, dtype=int)
        result = method(*method_args, **method_kwargs)
        return [_part(result, i, self.num_envs) for i in chosen]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Whether single environments are in such a wrapper; wrappers go around a fleet as a whole."""
        chosen = self._get_indices(indices)
        singles = self._singles
        return [singles is not None and is_wrapped(singles[i], wrapper_class) for i in chosen]

    def _layers(self) -> Iterator[Any]:
        """The fleet's wrappers from the outside in, and the fleet."""
        env: Any = self.vector_env
        while env is not env.unwrapped:
            yield env
            env = env.env
        yield env

    def _attribute(self, name: str) -> Any:
        for each in self._layers():
            if hasattr(each, name):
                return getattr(each, name)
        raise AttributeError(f"{type(self.vector_env.unwrapped).__name__} has no attribute {name!r}")

    def _require_all(self, indices: VecEnvIndices, method: str) -> None:
        if sorted(self._get_indices(indices)) != list(range(self.num_envs)):
            raise ValueError(f"{method} acts on all environments, which share one fleet; leave out indices.")


def _wrappers(given: Any) -> list[Wrapper]:
    each: list[Any] = [given] if callable(given) else list(given) if is_sequence(given) else [None]
    if not all(map(callable, each)):
        raise ValueError(
            f"wrapper = {shown(given)} is not allowed; it must take an environment and return it wrapped, or be a list "
            "of such."
        )
    return each


def _made(env_id: str, n_envs: int, mode: AutoresetMode, env_kwargs: Mapping[str, Any]) -> TrackingVectorEnv:
    """The fleet of an ID.

    Raises:
        ValueError: It has none.
    """
    refusal = f"env_id = {env_id!r} is not allowed; it must be an ID whose vector env is TrackingVectorEnv."
    try:
        made = gym.make_vec(
            env_id, num_envs=n_envs, vectorization_mode="vector_entry_point", autoreset_mode=mode, **env_kwargs
        )
    except (TypeError, gym.error.Error) as error:
        raise ValueError(f"{refusal} ({error})") from error
    if not isinstance(made.unwrapped, TrackingVectorEnv):
        raise ValueError(refusal)
    return made.unwrapped


def _part(result: Any, index: int, size: int) -> Any:
    """One environment's part of what a fleet's method returns; all of it where it has no parts."""
    if isinstance(result, dict):
        return {key: values[index] for key, values in result.items()}
    return result[index] if isinstance(result, (np.ndarray, tuple)) and len(result) == size else result


def _lane(infos: dict[str, Any], index: int) -> dict[str, Any]:
    """The info dict of one environment, in plain Python types."""
    found: dict[str, Any] = {}
    for key, values in infos.items():
        if key.startswith("_") or key in ("final_obs", "final_info"):
            continue
        if isinstance(values, dict):
            found[key] = _lane(values, index)
        elif isinstance(values, np.ndarray) and values.dtype != object:
            found[key] = values[index].item() if values[index].ndim == 0 else values[index]
    return found

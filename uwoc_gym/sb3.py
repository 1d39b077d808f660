"""The Stable-Baselines3 environment: the same fleet of N. Only here is Stable-Baselines3 imported."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from uwoc_gym.given import is_sequence, shown, values_of
from uwoc_gym.scenario import as_scenario
from uwoc_gym.spaces import ScenarioLike, check_options, check_seed
from uwoc_gym.vector_env import TrackingVectorEnv


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
        env_kwargs: Further arguments of `TrackingVectorEnv`.

    Raises:
        ValueError: The ID has no `TrackingVectorEnv`, or an entry of ``info_keys`` is unknown.
    """

    def __init__(
        self,
        env_id: str,
        n_envs: int = 1,
        seed: int | None = None,
        scenario: ScenarioLike | None = None,
        info_keys: Sequence[str] = (),
        **env_kwargs: Any,
    ) -> None:
        if scenario is not None:
            env_kwargs["scenario"] = scenario
        refusal = f"env_id = {env_id!r} is not allowed; it must be an ID whose vector env is TrackingVectorEnv."
        try:
            made = gym.make_vec(
                env_id,
                num_envs=n_envs,
                vectorization_mode="vector_entry_point",
                autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
                **env_kwargs,
            )
        except (TypeError, gym.error.Error) as error:
            raise ValueError(f"{refusal} ({error})") from error
        if not isinstance(made.unwrapped, TrackingVectorEnv):
            raise ValueError(refusal)
        self.vector_env = made.unwrapped
        known = self.vector_env.info_names
        if not is_sequence(info_keys):
            raise ValueError(f"info_keys = {shown(info_keys)} is not allowed; it must be a list of names.")
        for key in values_of(info_keys):
            if key not in known:
                raise ValueError(f"info_keys has {shown(key)}, which is not known; allowed are {', '.join(known)}.")
        self._info_keys = tuple(values_of(info_keys))
        self._actions: Any = None
        own = self.vector_env
        super().__init__(own.num_envs, own.single_observation_space, own.single_action_space)
        self.render_mode = self.vector_env.render_mode
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
        self.vector_env.check_reset(options=self._together(each))
        self._options = deepcopy(each)

    def _together(self, each: list[Any]) -> dict[str, Any]:
        """The options of all environments as those of one vector environment."""
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
                base = self.vector_env.scenario
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
        observations, infos = self.vector_env.reset(seed=seeds, options=self._together(self._options))
        self.reset_infos = [_lane(infos, i) for i in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: Any) -> None:
        """Take actions of shape (N, actions)."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all environments by one control period."""
        observations, rewards, terminated, truncated, infos = self.vector_env.step(self._actions)
        done = terminated | truncated
        if self._info_keys:
            columns = [infos[key].tolist() for key in self._info_keys]
            dicts: list[dict[str, Any]] = [
                dict(zip(self._info_keys, row, strict=True)) for row in zip(*columns, strict=True)
            ]
        else:
            dicts = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done).tolist():
            # The last step's own values: `infos` already speaks of the new episode.
            self.reset_infos[i] = _lane(infos, i)
            dicts[i] = _lane(infos["final_info"], i)
            dicts[i]["terminal_observation"] = infos["final_obs"][i]
            dicts[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
        return observations, rewards.astype(np.float32), done, dicts

    def get_images(self) -> Sequence[Any]:
        """One picture per environment, from which Stable-Baselines3 composes those of `render`."""
        return self.vector_env.render() or ()

    def close(self) -> None:
        """Close the environments."""
        self.vector_env.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """The attribute of the vector environment, once for each of ``indices``."""
        value = getattr(self.vector_env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute of the vector environment, which all environments share.

        Raises:
            ValueError: ``indices`` names only some environments.
        """
        self._require_all(indices, "set_attr")
        setattr(self.vector_env, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment, such as "state"; each of ``indices`` gets its part of the result."""
        result = getattr(self.vector_env, method_name)(*method_args, **method_kwargs)
        chosen = list(self._get_indices(indices))
        if isinstance(result, dict):
            return [{key: values[i] for key, values in result.items()} for i in chosen]
        return [result for _ in chosen]

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """No environment is wrapped: wrappers go around this class."""
        return [False for _ in self._get_indices(indices)]

    def _require_all(self, indices: VecEnvIndices, method: str) -> None:
        if sorted(self._get_indices(indices)) != list(range(self.num_envs)):
            raise ValueError(f"{method} acts on all environments, which share one fleet; leave out indices.")


def _lane(infos: dict[str, Any], index: int) -> dict[str, Any]:
    """The info dict of one environment, in plain Python types."""
    return {
        key: values[index].item()
        for key, values in infos.items()
        if not key.startswith("_") and isinstance(values, np.ndarray) and values.dtype != object
    }

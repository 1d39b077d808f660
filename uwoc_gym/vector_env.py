"""The vector environment: a fleet of N."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from uwoc_gym.given import as_numbers, closest, count, is_sequence, shown, values_of
from uwoc_gym.scenario import Scenario
from uwoc_gym.sim.fleet import Autoreset, Fleet
from uwoc_gym.sim.layout import FLAGS, MEASURE_NAMES, info_names
from uwoc_gym.spaces import (
    FRAME,
    Described,
    ScenarioLike,
    action_space,
    build_scenario,
    check_options,
    check_render_mode,
    check_render_size,
    check_seed,
    episode_scenario,
    import_rendering,
    observation_space,
    one_of,
)

Observations = npt.NDArray[np.float32]
Array = npt.NDArray[np.float64]

_REWARD = MEASURE_NAMES.index("reward")
_FLAGS = [MEASURE_NAMES.index(name) for name in FLAGS]
_TERMINATED, _TRUNCATED = (FLAGS.index(name) for name in ("terminated", "truncated"))
_MODES = {
    AutoresetMode.NEXT_STEP: Autoreset.NEXT_STEP,
    AutoresetMode.SAME_STEP: Autoreset.SAME_STEP,
    AutoresetMode.DISABLED: Autoreset.DISABLED,
}


class TrackingVectorEnv(Described, VectorEnv[Observations, Observations, npt.NDArray[Any]]):
    """N environments of `TrackingEnv`, advanced together by one compiled function.

    Environment i seeded through ``reset(seed=s)`` gives the same episodes, bit for bit, as `TrackingEnv` seeded
    with ``s + i``. Spaces, reward, episode end and `info` are those of `TrackingEnv`, batched; each key of `info` has
    a mask ``_key`` as in Gymnasium's own vector environments.

    Args:
        num_envs: Number of environments N.
        scenario: Overrides, a whole `Scenario`, or its name.
        control_period_s: Time between actions [s].
        integration_step_s: Integration step [s].
        max_episode_steps: Steps after which an episode is truncated, by default the scenario's duration.
        autoreset_mode: What happens after an episode's end: the next step begins a new one (the default), the same
            step does, or nothing does until ``reset(options={"reset_mask": mask})``.
        threads: Threads that share the work; worth it from several thousand environments on.
        render_mode: "rgb_array" for pictures from `render`, which need pygame (extra ``render``).
        render_size: Width and height of each picture [px].
        scenario_digest: The digest that the scenario should have, as a spec records it; a warning says if it hasn't.

    Raises:
        SettingError: A setting is unknown or not allowed.
        ValueError: ``num_envs``, ``threads`` or ``max_episode_steps`` isn't a whole number within its bounds
            (`uwoc_gym.given.LIMITS`), or the autoreset mode, the render mode or the size isn't allowed.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 20}  # noqa: RUF012 - as Gymnasium declares it

    def __init__(
        self,
        num_envs: int = 1,
        scenario: ScenarioLike | None = None,
        control_period_s: float | None = None,
        integration_step_s: float | None = None,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 1,
        render_mode: str | None = None,
        scenario_name: str = "Nominal",
        render_size: tuple[int, int] = FRAME,
        scenario_digest: str | None = None,
    ) -> None:
        check_render_mode(render_mode, self.metadata["render_modes"])
        self.render_mode = render_mode
        self.render_size = check_render_size(render_size)
        self.renderers: list[Any] = []
        mode = self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.scenario = build_scenario(scenario, scenario_name, control_period_s, integration_step_s, scenario_digest)
        num_envs = count("num_envs", num_envs, "environments")
        self._max_episode_steps = max_episode_steps
        self._fleet = Fleet(self.scenario, num_envs, _MODES[mode], max_episode_steps, threads)
        self.num_envs = self._fleet.size
        self.metadata = {
            **self.metadata,
            "render_fps": round(1.0 / self.scenario.episode.control_period_s),
            "autoreset_mode": mode,
        }
        self.single_action_space = action_space(self.scenario)
        self.single_observation_space = observation_space(self.scenario)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._same_step = mode is AutoresetMode.SAME_STEP
        self._all = np.ones(self.num_envs, dtype=bool)
        self._all.flags.writeable = False
        self._name_infos()
        self._begun = False
        self._attributes: dict[str, list[Any]] = {}
        self._action_size = len(self.scenario.actions)
        self._observation_size = self.scenario.observation.size

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode in every environment, or in those of a mask.

        Args:
            seed: Environment i gets ``seed + i``, or the i-th of a list of N.
            options: ``pose`` and ``velocity``, of shape (3,) or (N, 3); ``parameters``, a dict of numbers to take
                instead of drawing them (by their names in `parameters`, a number or of shape (N,), within the
                scenario's ranges), for this episode only; ``scenario`` overrides, which hold until the next full reset;
                ``reset_mask``, bool of shape (N,), to reset only some environments.

        Raises:
            ValueError: An option is unknown, of the wrong shape, out of range or not finite, or there aren't N seeds;
                nothing has changed.
        """
        seeds, given, mask, wanted = self._checked(seed, options)
        if wanted is not self._fleet.scenario:
            self._fleet.configure(wanted, self._max_episode_steps)
            self._name_infos()
        lanes = np.flatnonzero(mask)
        self._seed(seeds, lanes)
        observations = (
            np.empty((self.num_envs, self._observation_size), dtype=np.float32) if mask.all() else self._fleet.observe()
        )
        self._fleet.reset(observations, lanes, given.get("pose"), given.get("velocity"), given.get("parameters"))
        self._begun = True
        if self.renderers:
            self._begin_pictures(lanes)
        infos = self._present_infos()
        if not mask.all():
            infos |= {f"_{name}": mask.copy() for name in self.info_names}
        return observations, infos

    def check_reset(self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None) -> None:
        """Refuse what `reset` would refuse, and change nothing.

        Raises:
            ValueError: As of `reset`.
        """
        self._checked(seed, options)

    def _checked(
        self, seed: Any, options: Any
    ) -> tuple[int | list[int | None] | None, Mapping[str, Any], npt.NDArray[np.bool_], Scenario]:
        """Seeds, options, mask and scenario of a reset."""
        given = check_options(options, ("pose", "velocity", "parameters", "scenario", "reset_mask"))
        mask = self._reset_mask(given.get("reset_mask"))
        # A scenario given at the last full reset holds until the next one.
        wanted = self.scenario if mask.all() else self._fleet.scenario
        if given.get("scenario") is not None:
            if not mask.all():
                raise ValueError(
                    f"options['scenario'] = {shown(given['scenario'])} is not allowed beside options['reset_mask']; it "
                    "must apply to all environments."
                )
            wanted = episode_scenario(self.scenario, given["scenario"])
        self._fleet.check_start(wanted, given.get("pose"), given.get("velocity"), given.get("parameters"))
        if not is_sequence(seed):
            return check_seed(seed), given, mask, wanted
        if len(seed) != self.num_envs:
            raise ValueError(
                f"seed = {shown(seed)} has {len(seed)} entries; it must be a number or {self.num_envs} of them."
            )
        return [check_seed(each, f"seed[{i}]") for i, each in enumerate(seed)], given, mask, wanted

    def _name_infos(self) -> None:
        """Keep at hand the keys of `info`, until the fleet is configured anew."""
        self.info_names = info_names(self._fleet.scenario)
        """Keys of `info` at every step."""
        self._shown = [(name, MEASURE_NAMES.index(name)) for name in self.info_names if name not in FLAGS]
        self._shown_flags = [(name, FLAGS.index(name)) for name in self.info_names if name in FLAGS]
        self._masks: dict[str, Any] = {f"_{name}": self._all for name in self.info_names}

    def _reset_mask(self, mask: Any) -> npt.NDArray[np.bool_]:
        if mask is None:
            return self._all
        array = np.asarray([each if isinstance(each, bool) else None for each in values_of(mask)])
        if isinstance(mask, np.ndarray):
            array = mask
        if array.shape != (self.num_envs,) or array.dtype != np.bool_ or not array.any():
            raise ValueError(
                f"options['reset_mask'] = {shown(mask)} is not allowed; it must be a bool array of shape "
                f"({self.num_envs},) with at least one True."
            )
        if not self._begun and not array.all():
            raise ValueError(
                f"options['reset_mask'] = {shown(mask)} is not allowed; it must be True everywhere at the first reset."
            )
        return array

    def _seed(self, given: int | list[int | None] | None, lanes: npt.NDArray[np.int64]) -> None:
        if given is None or isinstance(given, int):
            super().reset(seed=given)
            first = self._fresh_seed()
            if first is None:
                return
            seeds: list[int | None] = [first + i for i in range(self.num_envs)]
        else:
            seeds = given
            self._generator = self.np_random
        chosen = [i for i in lanes.tolist() if seeds[i] is not None]
        missing = [i for i in lanes.tolist() if seeds[i] is None]
        self._fleet.seed(np.array(chosen, dtype=np.int64), [int(seeds[i] or 0) for i in chosen])
        if missing and not self._begun:
            entropy = np.random.SeedSequence().generate_state(len(missing), np.uint64)
            self._fleet.seed(np.array(missing, dtype=np.int64), [int(word) for word in entropy])

    def step(
        self, actions: Observations
    ) -> tuple[Observations, Array, npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """Apply actions, of shape (N, 3) unless the scenario's kind is another, for one control period.

        Raises:
            ResetNeeded: Nothing has been reset yet.
            ValueError: The actions have another shape or aren't finite; nothing has moved.
            RuntimeError: An episode has ended and autoreset is off; nothing has moved.
        """
        if not self._begun:
            raise gym.error.ResetNeeded("no episode has begun; call reset() before step().")
        given = self._as_actions(actions)
        observations = np.empty((self.num_envs, self._observation_size), dtype=np.float32)
        out = np.empty((len(MEASURE_NAMES), self.num_envs))
        flags = np.empty((len(FLAGS), self.num_envs), dtype=np.bool_)
        finals = np.empty_like(observations) if self._same_step else None
        ends = self._fleet.step(given, observations, out, flags, finals)
        terminated, truncated = flags[_TERMINATED], flags[_TRUNCATED]
        if self.renderers:
            self._picture()
        infos = self._infos(out, flags)
        if not ends:
            return observations, out[_REWARD], terminated, truncated, infos
        diverged = self._fleet.diverged
        if diverged.any():
            infos |= {"diverged": diverged, "_diverged": diverged.copy()}
        if finals is None:
            return observations, out[_REWARD], terminated, truncated, infos
        ended = terminated | truncated
        final = infos | {f"_{name}": ended for name in self.info_names}
        infos = self._present_infos()
        infos["final_obs"] = _object_array(finals, ended)
        infos["_final_obs"] = ended.copy()
        infos["final_info"] = final
        infos["_final_info"] = ended.copy()
        return observations, out[_REWARD], terminated, truncated, infos

    def _as_actions(self, actions: Any) -> npt.NDArray[np.float32]:
        """Actions of the type that is compiled for: contiguous, and not read-only."""
        shape = (self.num_envs, self._action_size)
        if type(actions) is np.ndarray and actions.dtype == np.float32 and actions.shape == shape:
            return actions if actions.flags.carray else actions.copy()
        numbers = as_numbers(actions, shape)
        if numbers is None:
            raise ValueError(f"actions = {shown(actions)} are not allowed; they must be finite and of shape {shape}.")
        return np.clip(numbers, -1.0, 1.0).astype(np.float32)

    def _present_infos(self) -> dict[str, Any]:
        measures = self._fleet.measures()
        return self._infos(measures, measures[_FLAGS] > 0.0)

    def _infos(self, measures: Array, flags: npt.NDArray[np.bool_]) -> dict[str, Any]:
        """The info of all environments: an array and a mask that is True everywhere for each name."""
        infos = self._masks.copy()
        for name, row in self._shown:
            infos[name] = measures[row]
        for name, row in self._shown_flags:
            infos[name] = flags[row]
        return infos

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """The true states by name, as in `TrackingEnv.state`, each with a first axis of length N."""
        return self._fleet.state()

    def terms(self) -> dict[str, npt.NDArray[Any]]:
        """The terms of the last step's reward by name, as in `TrackingEnv.terms`, each of shape (N,)."""
        return dict(self._fleet.terms())

    def parameters(self) -> dict[str, npt.NDArray[Any]]:
        """What the present episodes have drawn, by its path, as in `TrackingEnv.parameters`, each of shape (N,)."""
        return self._fleet.drawn()

    def push(self, impulse: npt.ArrayLike, lanes: npt.ArrayLike | None = None) -> None:
        """Give the AUVs a shove, as `TrackingEnv.push` does.

        Args:
            impulse: Along surge, along sway and about yaw, shape (3,) [N s, N s, N m s].
            lanes: Places of those that get it; by default all.

        Raises:
            ResetNeeded: Nothing has been reset yet, or an episode has ended that no step begins anew by itself.
            ValueError: The impulse has another shape or isn't finite; nothing has moved.
        """
        if not self._begun or (self.autoreset_mode is AutoresetMode.DISABLED and self._fleet.ended.any()):
            raise gym.error.ResetNeeded("an episode has ended or not begun; call reset() before push().")
        self._fleet.push(np.arange(self.num_envs) if lanes is None else np.atleast_1d(lanes), impulse)

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """What each environment gives for a name of `TrackingEnv`, as of Gymnasium's own vector environments.

        Args:
            name: ``state``, ``terms``, ``parameters``, ``push``, ``snapshot`` or ``render``, or an attribute.
            *args: A method's arguments.
            **kwargs: A method's arguments by name.

        Returns:
            N results. Attributes that all environments share, such as ``scenario``, stand there N times.

        Raises:
            AttributeError: There is no such name.
            ValueError: It is a method that acts on all environments at once.
        """
        count = range(self.num_envs)
        if name in self._attributes:
            return tuple(self._attributes[name])
        if name in ("action_space", "observation_space"):
            return (getattr(self, f"single_{name}"),) * self.num_envs
        found = getattr(self, name)
        if not callable(found):
            return (found,) * self.num_envs
        if name not in ("state", "terms", "parameters", "push", "snapshot", "render"):
            raise ValueError(
                f"call({name!r}) is not allowed; {name} acts on all environments at once, so use {name}() itself."
            )
        result = found(*args, **kwargs)
        if result is None:
            return (None,) * self.num_envs
        if isinstance(result, dict):
            return tuple(one_of(result, i) for i in count)
        return tuple(result[i : i + 1] for i in count) if name == "snapshot" else tuple(result)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of each environment; see `call`."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Give each environment an attribute of the caller's own, which `get_attr` gives back.

        Args:
            name: The attribute.
            values: A list or tuple with one for each environment, or one for all.

        Raises:
            ValueError: There aren't N values, or it is an attribute that the environments share and are made with;
                nothing has changed.
        """
        if hasattr(self, name):
            raise ValueError(
                f"set_attr({name!r}) is not allowed; the environments share their {name}, so make them with another."
            )
        each = list(values) if isinstance(values, (list, tuple)) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(f"values = {shown(values)} is not allowed; it must be one, or {self.num_envs} of them.")
        self._attributes[name] = each

    def snapshot(self, lanes: npt.ArrayLike | None = None) -> npt.NDArray[np.void]:
        """The whole states of environments, what is going to happen included; see `Fleet.snapshot`."""
        return self._fleet.snapshot(lanes)

    def restore(self, rows: npt.NDArray[np.void], lanes: npt.ArrayLike | None = None) -> Observations:
        """Go on from a `snapshot`, one for all or one for each of ``lanes``; returns all observations.

        Raises:
            ValueError: The records have another layout or number; nothing has changed.
        """
        self._fleet.restore(rows, lanes)
        self._begun = self._begun or lanes is None
        if lanes is None:
            # The episodes to come are those of the snapshot as well.
            self._generator = self.np_random
        if self.renderers:
            self._begin_pictures(np.arange(self.num_envs) if lanes is None else np.atleast_1d(lanes))
        return self._fleet.observe()

    def render(self) -> tuple[npt.NDArray[np.uint8], ...] | None:
        """One picture per environment, each uint8 of shape (height, width, 3); None without a render mode.

        From the first call on each step is taken into trails, charts and data delivered.

        Raises:
            ResetNeeded: Nothing has been reset yet.
            DependencyNotInstalled: pygame isn't installed.
        """
        if self.render_mode is None:
            gym.logger.warn('render() draws nothing without a render mode; make the environment with "rgb_array".')
            return None
        if not self._begun:
            raise gym.error.ResetNeeded("there is nothing to draw yet; call reset() before render().")
        if not self.renderers:
            renderer = import_rendering().Renderer
            name = self.spec.id if self.spec is not None else type(self).__name__
            self.renderers = [
                renderer(self._fleet.scenario, self.render_size, f"{name} · {i}") for i in range(self.num_envs)
            ]
            self._begin_pictures(np.arange(self.num_envs))
        return tuple(renderer.frame() for renderer in self.renderers)

    def _begin_pictures(self, lanes: npt.NDArray[np.int64]) -> None:
        state, parameters = self.state(), self.parameters()
        for i in lanes.tolist():
            self.renderers[i].configure(self._fleet.scenario)
            self.renderers[i].begin(one_of(state, i), one_of(parameters, i))

    def _picture(self) -> None:
        """Take the states into the pictures; at time 0 a new episode has begun by itself."""
        state = self.state()
        fresh = np.flatnonzero(state["time_s"] == 0.0)
        if fresh.size:
            self._begin_pictures(fresh)
        for i in np.flatnonzero(state["time_s"] > 0.0).tolist():
            self.renderers[i].record(one_of(state, i))

    def __getstate__(self) -> dict[str, Any]:
        # Pictures belong to the process that draws them.
        return {**self.__dict__, "renderers": []}

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads, if there are any."""
        self._fleet.close()


def _autoreset_mode(given: Any) -> AutoresetMode:
    names = [mode.value for mode in AutoresetMode]
    if not (isinstance(given, AutoresetMode) or (isinstance(given, str) and given in names)):
        raise ValueError(f"autoreset_mode = {shown(given)} is not allowed; {closest(given, names)}")
    return AutoresetMode(given)


def _object_array(rows: Observations, mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.object_]:
    """The rows where the mask is set, as Gymnasium passes final observations on; None elsewhere."""
    result = np.full(len(rows), None, dtype=object)
    for index in np.flatnonzero(mask):
        result[index] = rows[index].copy()
    return result

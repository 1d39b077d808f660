"""Stable-Baselines3 environments to train in: ours or any, watched, corrected, normalised and stacked."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple, cast

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecEnvWrapper, VecFrameStack, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.modules import import_here
from uwoc_gym.agents.policies.archive import Normalisation, Statistics
from uwoc_gym.agents.policies.residual import CONTROLS, Corrected, check_actions
from uwoc_gym.agents.wrapping import PLAIN, Wrapping
from uwoc_gym.baselines.beliefs import Beliefs
from uwoc_gym.baselines.observers import Memory
from uwoc_gym.baselines.policy import Predictor
from uwoc_gym.env import TrackingEnv
from uwoc_gym.parameters import SettingError
from uwoc_gym.sb3 import TrackingVecEnv
from uwoc_gym.scenario import Scenario
from uwoc_gym.spaces import action_space
from uwoc_gym.task.observation import LIMIT
from uwoc_gym.vector_env import TrackingVectorEnv


class ResidualVecEnv(VecEnvWrapper):
    """`ResidualAction` for Stable-Baselines3's vector environments.

    Args:
        venv: Environments with this package's observations and actions.
        controller: What is corrected, a controller or any other policy; it sees the same observations as the agent.
        scale: What an action of 1 adds, as a share of the actuators' limits, in (0, 2].

    Raises:
        SettingError: The scale isn't allowed, or the environments have other actions.
    """

    def __init__(self, venv: VecEnv, controller: Predictor, scale: float = 0.5) -> None:
        check_actions(venv.action_space.shape)
        super().__init__(venv, action_space=CONTROLS)
        self.controller, self.scale = controller, scale
        self._corrected = Corrected(controller, scale)

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment."""
        observations: Any = self.venv.reset()
        self._corrected.begin(observations)
        return observations  # type: ignore[no-any-return]

    def step_async(self, actions: Any) -> None:
        """Take the agent's actions of shape (N, 3) and pass the corrected ones on."""
        self.venv.step_async(self._corrected.act(actions))

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all environments by one control period."""
        observations, rewards, dones, infos = self.venv.step_wait()
        # Where an episode has ended this is the next one's first observation; the last stays in its info.
        self._corrected.see(observations, dones)
        return observations, rewards, dones, infos

    def kept(self) -> tuple[Any, ...]:
        """See `kept`."""
        return self._corrected.kept()

    def put_back(self, *kept: Any) -> None:
        """See `put_back`."""
        self._corrected.put_back(*kept)


class BelievingVecEnv(VecEnvWrapper):
    """Adds what filters believe to the observations of Stable-Baselines3's vector environments.

    Args:
        venv: Environments with this package's observations.
        beliefs: What adds it.
    """

    def __init__(self, venv: VecEnv, beliefs: Beliefs) -> None:
        own: Any = venv.observation_space
        far = np.full(len(beliefs.names), LIMIT, dtype=np.float32)
        space = gym.spaces.Box(np.append(own.low, -far), np.append(own.high, far), dtype=np.float32)
        super().__init__(venv, observation_space=space)
        self._beliefs = beliefs
        self._memory: Memory = None

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment."""
        found, self._memory = self._beliefs(cast(Any, self.venv.reset()))
        return found

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all environments by one control period."""
        observations, rewards, dones, infos = self.venv.step_wait()
        over = np.flatnonzero(dones)
        if over.size and self._memory is not None:
            # What an episode's last observation makes believe, before the next one's first takes its place.
            last = np.stack([infos[i]["terminal_observation"] for i in over])
            told, _ = self._beliefs(last, tuple(each[over] for each in self._memory), np.zeros(over.size, dtype=bool))
            for i, own in zip(over.tolist(), told, strict=True):
                infos[i]["terminal_observation"] = own
        found, self._memory = self._beliefs(cast(Any, observations), self._memory, dones)
        return found, rewards, dones, infos

    def kept(self) -> tuple[Any, ...]:
        """See `kept`."""
        return (self._memory,)

    def put_back(self, memory: Memory) -> None:
        """See `put_back`."""
        self._memory = memory


class StaggeredVecEnv(VecEnvWrapper):
    """Cuts an episode of each environment short, at another step in each, so that a rollout has all parts in it.

    It is the first one, where none is over before its length. Cut episodes count as others do in what is shown of
    returns.

    Environments that begin together stay together where episodes are equally long, and each update then learns of one
    part of an episode alone (Rudin et al., "Learning to Walk in Minutes Using Massively Parallel Deep Reinforcement
    Learning", Conference on Robot Learning 2022).

    Args:
        venv: The environments, bare.
    """

    def __init__(self, venv: TrackingVecEnv) -> None:
        super().__init__(venv)
        self._bare = venv
        self._cuts = np.zeros(0)
        self._step = 0

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment."""
        steps = self._bare.scenario.episode.steps
        # Spread evenly, and neighbours far apart: whole shares of the golden ratio.
        self._cuts = np.ceil(steps * (np.arange(1, self.num_envs + 1) * (np.sqrt(5.0) - 1.0) / 2.0 % 1.0))
        self._step = 0
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all environments by one control period."""
        observations: Any
        observations, rewards, dones, infos = self.venv.step_wait()
        self._step += 1
        cut = (self._cuts == self._step) & ~dones
        if cut.any():
            begun: Any = self._bare.begin_anew(cut)
            for i in np.flatnonzero(cut).tolist():
                infos[i] |= {"terminal_observation": np.array(observations[i]), "TimeLimit.truncated": True}
            observations = np.where(cut[:, None], begun, observations)
        return observations, rewards, dones | cut, infos

    def kept(self) -> tuple[Any, ...]:
        """See `kept`."""
        return self._cuts, self._step

    def put_back(self, cuts: Any, step: int) -> None:
        """See `put_back`."""
        self._cuts, self._step = cuts, step


class EpisodeMonitor(VecEnvWrapper):
    """Adds the return and length of ended episodes to their infos, as VecMonitor does, and keeps the latest.

    Args:
        venv: The environments.
        in_cone: Where the observations say who is in the cone; None if they don't.
        window: How many episodes are kept.
    """

    def __init__(self, venv: VecEnv, in_cone: int | None, window: int = 100) -> None:
        super().__init__(venv)
        self._in_cone = in_cone
        self.returns: deque[float] = deque(maxlen=window)
        self.availabilities: deque[float] = deque(maxlen=window)
        """Share of the time in the cone; empty for other environments."""
        self.seen: Any = None
        """The last observations, as a policy would get them that flies without what stands around this."""
        self._sums, self._lengths, self._inside = np.zeros((3, self.num_envs))

    def forget(self) -> None:
        """Keep nothing of the episodes until now."""
        self.returns.clear()
        self.availabilities.clear()

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment."""
        self._sums, self._lengths, self._inside = np.zeros((3, self.num_envs))
        self.seen = self.venv.reset()
        return cast(VecEnvObs, self.seen)

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all environments by one step.

        Raises:
            CommandError: An episode has diverged, from which there is nothing to learn.
        """
        observations, rewards, dones, infos = self.venv.step_wait()
        if any("diverged" in infos[i] for i in np.flatnonzero(dones).tolist()):
            raise CommandError(
                "--scenario: the integrator couldn't follow an episode; EpisodeSettings.integration_step_s must be "
                "shorter for what is drawn there [s]. The last checkpoint is kept."
            )
        self._sums += rewards
        self._lengths += 1.0
        seen: Any = observations
        self.seen = seen
        cone = self._in_cone
        if cone is not None:
            self._inside += seen[:, cone]
        for i in np.flatnonzero(dones).tolist():
            if cone is not None:
                # The observation is already the next episode's.
                last = infos[i]["terminal_observation"][cone] - seen[i, cone]
                self.availabilities.append(float((self._inside[i] + last) / self._lengths[i]))
            self.returns.append(float(self._sums[i]))
            infos[i]["episode"] = {"r": float(self._sums[i]), "l": int(self._lengths[i])}
            self._sums[i] = self._lengths[i] = self._inside[i] = 0.0
        return observations, rewards, dones, infos

    def kept(self) -> tuple[Any, ...]:
        """See `kept`."""
        return self._sums, self._lengths, self._inside, self.seen, tuple(self.returns), tuple(self.availabilities)

    def put_back(self, sums: Any, lengths: Any, inside: Any, seen: Any, *latest: tuple[float, ...]) -> None:
        """See `put_back`."""
        self._sums, self._lengths, self._inside, self.seen = sums, lengths, inside, seen
        self.forget()
        for own, values in zip((self.returns, self.availabilities), latest, strict=True):
            own.extend(values)


class Base(NamedTuple):
    """What there is to know of an environment's ID."""

    scenario: Scenario | None
    """What it flies; None for environments of others."""
    fleet: bool
    """Whether it has a fleet; else its single environments are stepped one by one."""


def base_of(env_id: str) -> Base:
    """What an environment's ID flies, and how.

    Raises:
        CommandError: There is no environment of that ID.
    """
    module, _, bare = env_id.rpartition(":")
    try:
        if module:
            import_here(module)
        gym.spec(bare)
    except (gym.error.Error, ImportError) as error:
        said = str(error).rstrip(".")
        raise CommandError(
            f"--env {env_id!r} is not allowed: {said}; it must be a registered environment's ID, or module:ID."
        ) from None
    try:
        env = TrackingVecEnv(env_id, 1)
    except SettingError as error:
        raise CommandError(f"--env {env_id!r} can't be made: {error}") from None
    except ValueError:
        return Base(_of_singles(env_id), fleet=False)
    env.close()
    return Base(env.scenario, fleet=True)


def _of_singles(env_id: str) -> Scenario | None:
    """The scenario of an ID whose single environment is ours in wrappers that keep its spaces; None for any other."""
    try:
        env = gym.make(env_id)
    # Whatever it lacks, its settings may give it.
    except Exception:
        return None
    own = env.unwrapped
    env.close()
    if not isinstance(own, TrackingEnv):
        return None
    scenario = own.scenario
    kept = env.observation_space.shape == own.observation_space.shape
    return scenario if kept and env.action_space == action_space(scenario) else None


def singles(env_id: str, base: Scenario, env_kwargs: Mapping[str, Any]) -> Callable[[Scenario], gym.Env[Any, Any]]:
    """What makes the single environments of an ID without a fleet, in any scenario.

    Args:
        env_id: The ID.
        base: What it flies by itself.
        env_kwargs: Further arguments.
    """
    return partial(_single, env_id, base, dict(env_kwargs))


def _single(env_id: str, base: Scenario, env_kwargs: dict[str, Any], scenario: Scenario) -> gym.Env[Any, Any]:
    asked: dict[str, Any] = {} if scenario == base else {"scenario": scenario}
    try:
        env = gym.make(env_id, **env_kwargs, **asked)
        flown = env.get_wrapper_attr("scenario")
    except Exception as error:
        raise CommandError(f"--env {env_id!r} can't be made{_with(asked)}: {error}") from None
    if flown != scenario:
        raise CommandError(
            f"--env {env_id!r} can't be made{_with(asked)}: it flies another one; it must hand scenario= on to "
            "TrackingEnv."
        )
    return env


def _with(asked: Mapping[str, Any]) -> str:
    return " with another scenario, which --override, --scenario or the settings ask for" if asked else ""


def make_base(
    env_id: str, n_envs: int, scenario: Scenario | None, env_kwargs: Mapping[str, Any], wrapping: Wrapping = PLAIN
) -> VecEnv:
    """The environments: a fleet where ours can be had, else Stable-Baselines3's own loop over copies.

    Args:
        env_id: Environment ID.
        n_envs: Number of environments.
        scenario: The scenario to train on; None for environments of others.
        env_kwargs: Arguments of environments of others.
        wrapping: What stands around them.

    Raises:
        CommandError: The environment or a wrapper can't be made.
    """
    if scenario is not None and wrapping.single is None:
        episode = scenario.episode
        with wrapping.blamed():
            # Both periods again, since the ID's own arguments would go before the scenario's.
            return TrackingVecEnv(
                env_id,
                n_envs,
                scenario=scenario,
                control_period_s=episode.control_period_s,
                integration_step_s=episode.integration_step_s,
                wrapper=wrapping.wrappers,
            )

    def single() -> gym.Env[Any, Any]:
        if scenario is not None and wrapping.single is not None:
            return wrapping.around(wrapping.single(scenario))
        return wrapping.around(gym.make(env_id, **env_kwargs))

    try:
        return DummyVecEnv([single] * n_envs)
    except (gym.error.Error, TypeError, ValueError, ImportError) as error:
        raise CommandError(f"--env {env_id!r} can't be made: {error}") from None


def wrapped(
    base: VecEnv,
    values: Mapping[str, Any],
    controller: Predictor | None,
    scenario: Scenario | None,
    normalisation: Normalisation | None = None,
    beliefs: Beliefs | None = None,
) -> tuple[VecEnv, EpisodeMonitor, VecNormalize | None]:
    """The environments as the algorithm sees them.

    The order is that of rl-baselines3-zoo: correction, then normalisation, then stacking; beliefs come after the first.

    Args:
        base: The bare environments.
        values: Checked settings.
        controller: What the agent corrects, if anything.
        scenario: The scenario trained on; None where observations aren't as it says.
        normalisation: Where its statistics stand; None to begin.
        beliefs: What filters add to the observations, if anything.
    """
    if values["staggered"]:
        if not isinstance(base, TrackingVecEnv):
            raise CommandError("staggered is not allowed for environments of which there is no fleet.")
        base = StaggeredVecEnv(base)
    monitor = EpisodeMonitor(base, None if scenario is None else scenario.observation.place("inside the cone"))
    env: VecEnv = monitor
    if controller is not None:
        env = ResidualVecEnv(env, controller, values["residual_scale"])
    if beliefs is not None:
        env = BelievingVecEnv(env, beliefs)
    statistics: VecNormalize | None = None
    if values["normalize"]:
        options = values["normalize"] if isinstance(values["normalize"], dict) else {}
        env = statistics = VecNormalize(env, gamma=values.get("gamma", 0.99), **options)
        if normalisation is not None:
            _set(statistics.ret_rms, normalisation.returns)
            if normalisation.observations is not None:
                _set(statistics.obs_rms, normalisation.observations)
    if values["frame_stack"] > 1:
        env = VecFrameStack(env, values["frame_stack"])
    return env, monitor, statistics


def kept(env: VecEnv) -> tuple[Any, ...] | None:
    """What every layer of environments needs to go on as if it had never stopped, from the outside in.

    None where one doesn't say: environments that aren't a fleet of ours, or wrappers around them.
    """
    own: tuple[Any, ...]
    if isinstance(env, TrackingVecEnv):
        fleet = env.vector_env
        return (fleet.snapshot(),) if isinstance(fleet, TrackingVectorEnv) else None
    if isinstance(env, VecNormalize):
        own = (env.returns, env.old_obs, env.old_reward, *(vars(each) for each in _running(env)))
    elif isinstance(env, VecFrameStack):
        own = (env.stacked_obs.stacked_obs,)
    elif isinstance(env, _OURS):
        own = env.kept()
    else:
        return None
    below = kept(env.venv)
    return None if below is None else (own, *below)


_OURS = (ResidualVecEnv, BelievingVecEnv, StaggeredVecEnv, EpisodeMonitor)


def _running(env: VecNormalize) -> list[Any]:
    """Its running statistics."""
    return [env.ret_rms, env.obs_rms] if env.norm_obs else [env.ret_rms]


def put_back(env: VecEnv, own: Any, *below: Any) -> None:
    """Let environments go on from what `kept` has told.

    Raises:
        TypeError, ValueError: It is of other environments.
    """
    if isinstance(env, TrackingVecEnv):
        fleet: Any = env.vector_env
        fleet.restore(own)
        return
    if isinstance(env, VecNormalize):
        env.returns, env.old_obs, env.old_reward, *statistics = own
        for each, stood in zip(_running(env), statistics, strict=True):
            vars(each).update({name: stood[name] for name in vars(each)})
    elif isinstance(env, VecFrameStack):
        env.stacked_obs.stacked_obs = own[0]
    elif isinstance(env, _OURS):
        env.put_back(*own)
    else:
        raise TypeError(f"{type(env).__name__} has nothing to be put back")
    put_back(env.venv, *below)


def normalisation_of(env: VecNormalize | None) -> Normalisation | None:
    """The normalisation as it stands now; None without any."""
    if env is None:
        return None
    seen = _statistics(env.obs_rms) if env.norm_obs else None
    return Normalisation(seen, _statistics(env.ret_rms), env.clip_obs, env.epsilon)


def _statistics(running: Any) -> Statistics:
    return Statistics(np.array(running.mean), np.array(running.var), float(running.count))


def _set(running: Any, known: Statistics) -> None:
    running.mean, running.var, running.count = known.mean.copy(), known.variance.copy(), known.count

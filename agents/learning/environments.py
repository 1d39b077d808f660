"""Stable-Baselines3 environments to train in: ours or any, watched, corrected, normalised and stacked."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecEnvWrapper, VecFrameStack, VecNormalize
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.modules import import_here
from uwoc_gym.agents.policies.archive import Normalisation, Statistics
from uwoc_gym.agents.policies.residual import CONTROLS, check_actions, checked_scale, corrected
from uwoc_gym.baselines import Controller
from uwoc_gym.parameters import SettingError
from uwoc_gym.sb3 import TrackingVecEnv
from uwoc_gym.scenario import Scenario


class ResidualVecEnv(VecEnvWrapper):
    """`ResidualAction` for Stable-Baselines3's vector environments.

    Args:
        venv: Environments with this package's observations and actions.
        controller: What is corrected; it sees the same observations as the agent.
        scale: What an action of 1 adds, as a share of the actuators' limits, in (0, 2].

    Raises:
        SettingError: The scale isn't allowed, or the environments have other actions.
    """

    def __init__(self, venv: VecEnv, controller: Controller, scale: float = 0.5) -> None:
        check_actions(venv.action_space.shape)
        super().__init__(venv, action_space=CONTROLS)
        self.controller = controller
        self.scale = checked_scale(scale)
        self._controls: Any = None

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment."""
        observations: Any = self.venv.reset()
        self._controls, _ = self.controller.predict(observations)
        return observations  # type: ignore[no-any-return]

    def step_async(self, actions: Any) -> None:
        """Take the agent's actions of shape (N, 3) and pass the corrected ones on."""
        self.venv.step_async(corrected(self._controls, actions, self.scale))

    def step_wait(self) -> VecEnvStepReturn:
        """Advance all environments by one control period."""
        observations, rewards, dones, infos = self.venv.step_wait()
        # Where an episode has ended this is the next one's first observation; the last stays in its info.
        self._controls, _ = self.controller.predict(observations)  # type: ignore[arg-type]
        return observations, rewards, dones, infos


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
        self._sums, self._lengths, self._inside = np.zeros((3, self.num_envs))

    def reset(self) -> VecEnvObs:
        """Begin an episode in every environment."""
        self._sums, self._lengths, self._inside = np.zeros((3, self.num_envs))
        return self.venv.reset()

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


def base_scenario(env_id: str) -> Scenario | None:
    """The scenario of an environment ID whose vector environment is ours; None for any other.

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
        return None
    scenario = env.vector_env.scenario
    env.close()
    return scenario


def make_base(env_id: str, n_envs: int, scenario: Scenario | None, env_kwargs: Mapping[str, Any]) -> VecEnv:
    """The bare environments: a fleet where ours can be had, else Stable-Baselines3's own loop over copies.

    Args:
        env_id: Environment ID.
        n_envs: Number of environments.
        scenario: The scenario to train on; None for environments of others.
        env_kwargs: Arguments of environments of others.

    Raises:
        CommandError: The environment can't be made.
    """
    if scenario is not None:
        episode = scenario.episode
        # Both periods again, since the ID's own arguments would go before the scenario's.
        return TrackingVecEnv(
            env_id,
            n_envs,
            scenario=scenario,
            control_period_s=episode.control_period_s,
            integration_step_s=episode.integration_step_s,
        )
    try:
        return DummyVecEnv([lambda: gym.make(env_id, **env_kwargs) for _ in range(n_envs)])
    except (gym.error.Error, TypeError, ValueError, ImportError) as error:
        raise CommandError(f"--env {env_id!r} can't be made: {error}") from None


def wrapped(
    base: VecEnv,
    values: Mapping[str, Any],
    controller: Controller | None,
    scenario: Scenario | None,
    normalisation: Normalisation | None = None,
) -> tuple[VecEnv, EpisodeMonitor, VecNormalize | None]:
    """The environments as the algorithm sees them.

    The order is that of rl-baselines3-zoo: correction, then normalisation, then stacking.

    Args:
        base: The bare environments.
        values: Checked settings.
        controller: What the agent corrects, if anything.
        scenario: The scenario trained on; None for environments of others.
        normalisation: Where its statistics stand; None to begin.
    """
    monitor = EpisodeMonitor(base, None if scenario is None else scenario.observation.place("inside the cone"))
    env: VecEnv = monitor
    if controller is not None:
        env = ResidualVecEnv(env, controller, values["residual_scale"])
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

"""Policies by name, file or callable, and flying them through a scenario."""

from __future__ import annotations

import importlib
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
from uwoc_gym.agents.errors import UserError
from uwoc_gym.baselines import NLPDController, PDController

from uwoc_gym import Range, Scenario, SettingError, TrackingVectorEnv
from uwoc_gym.metrics import Record
from uwoc_gym.parameters import closest


class Policy(Protocol):
    """Anything that decides as Stable-Baselines3 models do."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[npt.NDArray[Any], Any]:
        """Actions (N, 3) and the next state for observations (N, 20)."""
        ...


POLICIES: dict[str, tuple[str, Callable[[Scenario], Policy]]] = {
    "pd": ("PD with the paper's gains, law as printed", lambda s: PDController("paper-pd", s)),
    "pd-plain": ("PD with the paper's gains, no feedforward", lambda s: PDController("paper-pd-plain", s)),
    "nlpd": ("NLPD with gains that match the paper's row", lambda s: NLPDController("paper-nlpd", s)),
}
"""Description and maker of each named policy."""


def load_policy(name: str, scenario: Scenario) -> Policy:
    """A policy by name, by the path of a saved Stable-Baselines3 model, or as ``module:callable``.

    A callable is given the scenario and returns the policy. Beside a model, ``vecnormalize.pkl`` holds its frozen
    normalisation statistics.

    Raises:
        UserError: There is no such policy, or the file isn't a saved model.
    """
    if name in POLICIES:
        return POLICIES[name][1](scenario)
    if name.endswith(".zip") or Path(name).exists():
        return _load_model(Path(name))
    if ":" in name:
        return _call(name, scenario)
    raise UserError(
        f"there is no policy {name!r}; {closest(name, list(POLICIES))} A .zip file or module:callable works too."
    )


def _call(name: str, scenario: Scenario) -> Policy:
    module, _, attribute = name.partition(":")
    try:
        maker = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise UserError(f"policy {name!r} can't be imported: {error}") from None
    policy: Policy = maker(scenario)
    if not hasattr(policy, "predict"):
        raise UserError(f"policy {name!r} made a {type(policy).__name__}, which has no predict().")
    return policy


def _load_model(path: Path) -> Policy:
    if not path.is_file():
        raise UserError(f"agent file {str(path)!r} doesn't exist.")
    try:
        with zipfile.ZipFile(path) as archive:
            data = json.loads(archive.read("data"))
    except (zipfile.BadZipFile, KeyError, ValueError):
        raise UserError(f"agent file {str(path)!r} isn't a saved Stable-Baselines3 model.") from None
    try:
        import stable_baselines3 as sb3
    except ImportError:
        raise UserError('saved agents need Stable-Baselines3: pip install "uwoc-gym[agents]"') from None
    algorithm = getattr(sb3, _algorithm(data))
    try:
        model = algorithm.load(path, device="cpu")
    except (KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise UserError(f"agent file {str(path)!r} can't be loaded as {algorithm.__name__}: {error}") from None
    return _Normalised.around(model, path)


def _algorithm(data: dict[str, Any]) -> str:
    """The algorithm of a saved model, whose name the file doesn't hold: told from its policy class and settings."""
    module = str(data.get("policy_class", {}).get("__module__", ""))
    if ".sac." in module:
        return "SAC"
    if ".td3." in module:
        return "TD3"
    return "PPO" if "clip_range" in data else "A2C"


class _Normalised:
    """A model whose observations pass through frozen normalisation statistics."""

    def __init__(self, model: Policy, statistics: Any) -> None:
        self._model = model
        self._statistics = statistics

    @classmethod
    def around(cls, model: Any, path: Path) -> Policy:
        shape = model.observation_space.shape
        if shape is None or shape[-1] % 20:
            raise UserError(f"agent file {str(path)!r} expects observations of shape {shape}; ours have 20 entries.")
        beside = path.parent / "vecnormalize.pkl"
        if not beside.is_file():
            policy: Policy = model
            return policy
        from stable_baselines3.common.save_util import load_from_pkl

        return cls(model, load_from_pkl(beside))

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> tuple[npt.NDArray[Any], Any]:
        """As the model's, on normalised observations."""
        return self._model.predict(
            self._statistics.normalize_obs(observation), state, episode_start, deterministic=deterministic
        )


class Flight(NamedTuple):
    """Episodes of one policy in one scenario, and the paths of the first one."""

    record: Record
    pose: npt.NDArray[np.float64]
    """The AUV's pose in the first episode, (T + 1, 3) [m, m, rad]."""
    ship_pose: npt.NDArray[np.float64]
    """The ship's pose in the first episode, (T + 1, 3) [m, m, rad]."""
    pointing_error_rad: npt.NDArray[np.float64]
    """Receiver's pointing error in the first episode, (T + 1,) [rad]."""


def disturbance_time(scenario: Scenario) -> float | None:
    """When the first pulse can begin [s], or None without pulses."""
    starts = [pulse.start_s for pulse in scenario.sea.pulses]
    return min((s.low if isinstance(s, Range) else s for s in starts), default=None)


def draws_anything(scenario: Scenario) -> bool:
    """Whether episodes of the scenario differ from seed to seed."""
    noisy = any(value > 0.0 for _, value in scenario.midpoint().sensors.numbers() if not isinstance(value, Range))
    random_path = any(path.kind == "random" for path in scenario.ship_paths)
    current = scenario.midpoint().sea.current.std_mps != 0.0
    return noisy or random_path or current or scenario.midpoint() != scenario or len(scenario.ship_paths) > 1


def fly(policy: Policy, scenario: Scenario, seeds: list[int]) -> Flight:
    """Fly one episode per seed, all at once.

    Args:
        policy: Sees observations only.
        scenario: What to fly.
        seeds: One for each of N episodes.

    Raises:
        SettingError: The policy's actions have a wrong shape.
    """
    count, steps = len(seeds), scenario.episode.steps
    env = TrackingVectorEnv(count, scenario=scenario)
    observation, info = env.reset(seed=list(seeds))
    state = env.state()
    in_cone = np.zeros((steps + 1, count), dtype=bool)
    error = np.zeros((steps + 1, count, 3))
    range_m, rate = np.zeros((steps + 1, count)), np.zeros((steps + 1, count))
    effort, reward = np.zeros((steps, count)), np.zeros((steps, count))
    length = np.full(count, steps)
    lost = np.zeros(count, dtype=bool)
    pose, ship_pose, pointing = np.zeros((steps + 1, 3)), np.zeros((steps + 1, 3)), np.zeros(steps + 1)
    running = np.ones(count, dtype=bool)
    starts = np.ones(count, dtype=bool)
    memory: Any = None
    for step in range(steps + 1):
        in_cone[step], range_m[step], rate[step] = info["in_cone"], info["range_m"], info["bit_rate_bps"]
        difference = state["ship_pose"] - state["pose"]
        difference[:, 2] = (difference[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
        error[step] = difference
        pose[step], ship_pose[step] = state["pose"][0], state["ship_pose"][0]
        pointing[step] = info["pointing_error_rad"][0]
        if step == steps or not running.any():
            break
        action, memory = policy.predict(observation, state=memory, episode_start=starts, deterministic=True)
        if np.shape(action) != (count, 3):
            raise SettingError(f"the policy's actions have shape {np.shape(action)}; it must be ({count}, 3).")
        observation, rewards, terminated, truncated, info = env.step(np.asarray(action, dtype=np.float32))
        starts = np.zeros(count, dtype=bool)
        effort[step] = (np.clip(action, -1.0, 1.0) ** 2).mean(axis=1)
        reward[step] = rewards
        length[running & terminated] = step + 1
        lost |= running & terminated
        running &= ~(terminated | truncated)
        state = env.state()
    env.close()
    time_s = np.arange(steps + 1) * scenario.episode.control_period_s
    record = Record(time_s, length, in_cone, error, range_m, rate, effort, reward, lost)
    end = int(length[0]) + 1
    return Flight(record, pose[:end], ship_pose[:end], pointing[:end])

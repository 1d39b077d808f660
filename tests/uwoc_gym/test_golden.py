"""What the v0 IDs do never changes: digests of whole flights, recorded once.

On the platform that recorded them every bit counts. Elsewhere libm's log, exp and erfc may differ in their last bit,
so that samples of the same flights, kept as arrays, must agree to 1e-12. ``python tests/uwoc_gym/test_golden.py`` adds
the IDs that have no record yet.
"""

from __future__ import annotations

import hashlib
import json
import platform
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import uwoc_gym
from uwoc_gym.task.action import AXES

FOLDER = Path(__file__).parent / "golden"
DIGESTS = FOLDER / "digests.json"
PLATFORM = {"system": platform.system(), "machine": platform.machine(), "libc": " ".join(platform.libc_ver())}

LANES = 37
"""Odd, and more than a block."""
SAMPLES = 12
KEPT_LANES = (0, 1, 2, 31, 36)
MODES = ("NextStep", "SameStep", "Disabled")


def scripted(observations: np.ndarray) -> np.ndarray:
    """A crude pilot made of sums and products only, whose bits no library decides."""
    seen = observations.astype(np.float64)
    ahead = 0.5 * seen[..., 0] + 0.75 * seen[..., 4]
    aside = 0.75 * seen[..., 1] + 1.0 * seen[..., 5]
    turn = 0.5 * seen[..., 3] + 0.25 * seen[..., 6]
    return np.stack([ahead, aside, turn], axis=-1).astype(np.float32)


def taken(env: Any, forces: np.ndarray) -> np.ndarray:
    """What the environment takes of surge, sway and yaw."""
    return forces[..., list(AXES[env.unwrapped.scenario.action])]


def steps_in(env_id: str, time_s: float) -> int:
    return round(time_s / gym.make(env_id).unwrapped.scenario.episode.control_period_s)


class Record:
    """Takes in all that a flight shows: every bit into a digest, a few samples into arrays."""

    def __init__(self, steps: int) -> None:
        self._hash = hashlib.sha256()
        self._every = -(-steps // SAMPLES)
        self._step = 0
        self.samples: dict[str, list[np.ndarray]] = {}

    def add(self, **values: Any) -> None:
        for name in sorted(values):
            self._take(name, values[name], keep=self._step % self._every == self._every - 1)
        self._step += 1

    def _take(self, name: str, value: Any, keep: bool) -> None:
        self._hash.update(name.encode())
        if isinstance(value, dict):
            for key in sorted(value):
                self._take(f"{name}.{key}", value[key], keep)
            return
        array = np.asarray(value)
        if array.dtype == object:
            for item in array:
                self._take(name, np.zeros(0) if item is None else item, keep=False)
            return
        self._hash.update(f"{array.dtype}{array.shape}".encode())
        self._hash.update(np.ascontiguousarray(array).tobytes())
        if keep and not name.startswith("info._"):
            self.samples.setdefault(name, []).append(array[list(KEPT_LANES)] if array.shape[:1] == (LANES,) else array)

    def digest(self) -> str:
        return self._hash.hexdigest()

    def arrays(self) -> dict[str, np.ndarray]:
        return {name: np.array(values) for name, values in self.samples.items()}


def fly_single(env_id: str, steps: int) -> Record:
    """Scripted, then a second episode under random actions from a given pose, with a shove."""
    env = gym.make(env_id)
    record = Record(2 * steps)
    draws = np.random.default_rng(11)
    for episode in range(2):
        options = {"pose": (1.0, 9.0, 0.3), "velocity": (0.2, -0.1, 0.05)} if episode else None
        observation, info = env.reset(seed=None if episode else 7, options=options)
        record.add(observation=observation, info=info, state=env.unwrapped.state())
        for step in range(steps):
            action = draws.uniform(-1.2, 1.2, 3).astype(np.float32) if episode else scripted(observation)
            if episode and step == 20:
                env.unwrapped.push((30.0, -50.0, 20.0))
            observation, reward, terminated, truncated, info = env.step(taken(env, action))
            record.add(observation=observation, reward=reward, terminated=terminated, truncated=truncated, info=info)
            if terminated or truncated:
                break
        record.add(state=env.unwrapped.state())
    return record


def fly_vector(env_id: str, steps: int, mode: str) -> Record:
    """A third of the lanes each scripted, random, and driven off until the link is lost."""
    # Beyond the first pulse, and short enough for a second episode.
    length = steps_in(env_id, 32.5)
    options = {"autoreset_mode": gym.vector.AutoresetMode(mode), "max_episode_steps": length}
    env = gym.make_vec(env_id, num_envs=LANES, vectorization_mode="vector_entry_point", **options)
    record = Record(steps)
    draws = np.random.default_rng(13)
    kind = np.arange(LANES) % 3
    drift = draws.uniform(-1.0, 1.0, (LANES, 3))
    observations, infos = env.reset(seed=7)
    record.add(observation=observations, info=infos, state=env.unwrapped.state())
    for _ in range(steps):
        noise = draws.uniform(-1.2, 1.2, (LANES, 3))
        driven = np.where((kind == 1)[:, None], noise, 0.3 * noise + drift).astype(np.float32)
        actions = np.where((kind == 0)[:, None], scripted(observations), driven)
        observations, rewards, terminated, truncated, infos = env.step(taken(env, actions))
        record.add(observation=observations, reward=rewards, terminated=terminated, truncated=truncated, info=infos)
        ended = terminated | truncated
        if mode == "Disabled" and ended.any():
            observations, infos = env.reset(options={"reset_mask": ended})
            record.add(observation=observations, info=infos)
    record.add(state=env.unwrapped.state())
    return record


def flights(env_id: str) -> dict[str, Record]:
    """The recorded flights of an ID by name."""
    steps = steps_in(env_id, 34.0)
    flown = {"single": fly_single(env_id, steps)}
    return flown | {f"vector, {mode}": fly_vector(env_id, steps, mode) for mode in MODES}


def known() -> dict[str, Any]:
    return json.loads(DIGESTS.read_text()) if DIGESTS.is_file() else {"platform": PLATFORM, "digests": {}}


def arrays_file(env_id: str) -> Path:
    return FOLDER / f"{env_id.split('/')[1]}.npz"


def kept(flown: dict[str, Record]) -> dict[str, np.ndarray]:
    """The samples that stand in for the digests on other platforms."""
    return {
        f"{flight}/{name}": values
        for flight in ("single", "vector, NextStep")
        for name, values in flown[flight].arrays().items()
    }


@pytest.mark.parametrize("env_id", list(known()["digests"]))
def test_a_flight_stays_as_it_was_recorded(env_id):
    flown = flights(env_id)
    with np.load(arrays_file(env_id)) as recorded:
        arrays = kept(flown)
        assert set(recorded.files) == set(arrays)
        for name in recorded.files:
            # A difference in float64's last bits may turn the rounding to float32.
            tolerance = 1.2e-7 if recorded[name].dtype == np.float32 else 1e-12
            wanted, found = (np.asarray(each, dtype=float) for each in (recorded[name], arrays[name]))
            np.testing.assert_allclose(
                found, wanted, rtol=tolerance, atol=tolerance * np.abs(wanted).max(), err_msg=name
            )
    if known()["platform"] == PLATFORM:
        assert {name: record.digest() for name, record in flown.items()} == known()["digests"][env_id]


def test_every_id_is_recorded():
    assert set(known()["digests"]) == set(uwoc_gym.ENV_IDS)


if __name__ == "__main__":
    recorded = known()
    for env_id in uwoc_gym.ENV_IDS:
        if env_id not in recorded["digests"]:
            flown = flights(env_id)
            np.savez_compressed(arrays_file(env_id), **kept(flown))
            recorded["digests"][env_id] = {name: record.digest() for name, record in flown.items()}
            DIGESTS.write_text(json.dumps(recorded, indent=2) + "\n")
            print(f"recorded {env_id}")

"""Episodes as data to learn from offline: a folder that Minari loads, whole or not there."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import numpy.typing as npt

from uwoc_gym import __version__
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.reports import files
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import SCENARIOS, Scenario

Array = npt.NDArray[Any]

DATA = "data"
"""The folder in a dataset's own that Minari keeps everything in."""


class Episode(NamedTuple):
    """What happened in an episode of T control periods."""

    policy: str
    seed: int | None
    """What ``reset(seed=...)`` begins it with; None where no seed alone does."""
    observations: Array
    """float32, (T + 1, size)."""
    actions: Array
    """As they were applied, float32 in [-1, 1], (T, actions)."""
    rewards: Array
    """(T,)."""
    terminations: Array
    """bool, (T,)."""
    truncations: Array
    """bool, (T,)."""
    infos: dict[str, Array]
    """`info` of the reset and of each step, each (T + 1,); empty where it wasn't kept."""

    @property
    def score(self) -> float:
        """The return."""
        return float(self.rewards.sum())


def dataset_folder(given: str) -> Path:
    """A folder for a new dataset.

    Raises:
        CommandError: Minari doesn't allow its name, it holds something already, or it can't be written to.
    """
    folder = files.new_folder(given)
    if not re.fullmatch(r"[A-Za-z0-9][\w.-]*-v\d+", folder.name):
        raise CommandError(
            f"--out {given} is not allowed; the folder's name is the dataset's, and must be of letters, digits, '_', "
            "'.' and '-' and end in its version, such as random-expert-v0."
        )
    return folder


def environment(name: str, scenario: Scenario) -> gym.Env[Any, Any]:
    """The single environment of a scenario, whose spec makes it again anywhere.

    Args:
        name: What the scenario is called; that of a named one gives the environment its ID.
        scenario: The scenario.
    """
    named = name if name in SCENARIOS else "Nominal"
    env_id = next(env_id for env_id, each in ENV_IDS.items() if each == named)
    options: dict[str, Any] = {} if scenario == SCENARIOS[named] else {"scenario": scenario.to_dict()}
    return gym.make(env_id, **options)


class Dataset:
    """A dataset that is being written, as Minari writes it."""

    def __init__(self, folder: Path, storage: Any) -> None:
        self.folder = folder
        """Where it is until it is whole."""
        self._storage = storage
        self._told: list[dict[str, Any]] = []

    def append(self, episodes: Sequence[Episode]) -> None:
        """Add finished episodes."""
        from minari.data_collector.episode_buffer import EpisodeBuffer

        first = len(self._told)
        self._storage.update_episodes(
            EpisodeBuffer(
                id=first + i,
                seed=each.seed,
                observations=each.observations,
                actions=each.actions,
                rewards=each.rewards,
                terminations=each.terminations,
                truncations=each.truncations,
                infos=each.infos,
            )
            for i, each in enumerate(episodes)
        )
        new = [{"policy": each.policy, "return": each.score} for each in episodes]
        self._told += new
        self._storage.update_episode_metadata(new, list(range(first, first + len(new))))

    def __len__(self) -> int:
        return len(self._told)

    def returns(self) -> dict[str, list[float]]:
        """The returns of each policy's episodes."""
        found: dict[str, list[float]] = {}
        for each in self._told:
            found.setdefault(each["policy"], []).append(each["return"])
        return found

    def describe(self, said: Mapping[str, Any]) -> None:
        """Put into Minari's metadata what there is to know about the whole."""
        self._storage.update_metadata(dict(said))


@contextmanager
def written(folder: Path, name: str, scenario: Scenario) -> Iterator[Dataset]:
    """A dataset that is in ``folder`` when the block ends without an error, and else nowhere.

    Raises:
        OSError: It can't be written.
    """
    from minari.dataset.minari_storage import MinariStorage

    env = environment(name, scenario)
    with files.whole_folder(folder) as part:
        storage = MinariStorage.new(
            part / DATA,
            observation_space=env.observation_space,
            action_space=env.action_space,
            env_spec=env.spec,
        )
        storage.update_metadata(
            {
                "dataset_id": folder.name,
                "minari_version": _minari_version(),
                "requirements": [f"uwoc-gym=={__version__}"],
                "scenario": scenario.to_dict(),
                "scenario_digest": scenario.digest(),
            }
        )
        yield Dataset(part, storage)


def _minari_version() -> str:
    import minari

    return str(minari.__version__)


def summary(returns: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float]]:
    """Number of episodes and their returns, by policy."""
    return {
        policy: {
            "episodes": len(own),
            "return_mean": float(np.mean(own)),
            "return_std": float(np.std(own)),
            "return_least": float(np.min(own)),
            "return_most": float(np.max(own)),
        }
        for policy, own in returns.items()
    }

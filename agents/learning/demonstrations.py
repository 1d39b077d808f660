"""Episodes to learn from: of policies that are flown for it, or out of the replay buffer of a training."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import check_followed, check_size, decide
from uwoc_gym.agents.learning import checkpoints
from uwoc_gym.agents.learning.plans import Plan, Wish, planned, recorded_plan
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.reports.datasets import Episode
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.scenario import Scenario
from uwoc_gym.vector_env import TrackingVectorEnv

NOISE_KEY = 0x6E6F697365
"""Goes before the episode's seed in that of its noise, which is so not the seed of anything else."""


def flown(policy: Policy, scenario: Scenario, seeds: Sequence[int], noise: float = 0.0) -> list[Episode]:
    """Fly one episode per seed, all together, and keep what an agent saw and did.

    Args:
        policy: What decides, on observations alone.
        scenario: What is flown.
        seeds: Seeds of the N episodes.
        noise: Standard deviation of what is added to each action, as a share of the actuators' limits; drawn from the
            episode's seed, whatever else is flown beside it.

    Raises:
        CommandError: It is too much to fly at a time, an episode diverges, or the policy gives actions of another shape
            or that aren't finite.
    """
    size, steps, width = len(seeds), scenario.episode.steps, len(scenario.actions)
    check_size(scenario, size)
    predictor = policy.pilot(scenario)
    draws = [np.random.default_rng([NOISE_KEY, seed]) for seed in seeds]
    env = TrackingVectorEnv(size, scenario)
    seen, infos = env.reset(seed=list(seeds))
    observations = np.zeros((steps + 1, *seen.shape), dtype=np.float32)
    actions = np.zeros((steps, size, width), dtype=np.float32)
    rewards, ends = np.zeros((steps, size)), np.zeros((2, steps, size), dtype=bool)
    told = {name: np.zeros((steps + 1, size), dtype=infos[name].dtype) for name in env.info_names}
    length = np.zeros(size, dtype=np.int64)
    alive, begun = np.ones(size, dtype=bool), np.ones(size, dtype=bool)
    memory: Any = None
    for step in range(steps):
        observations[step] = seen
        for name, column in told.items():
            column[step] = infos[name]
        decided, memory = decide(policy, predictor, seen, memory, begun, width)
        noisy = decided + noise * np.array([draw.normal(size=width) for draw in draws]) if noise else decided
        actions[step] = np.where(alive[:, None], np.clip(noisy, -1.0, 1.0), 0.0)
        seen, rewards[step], terminated, truncated, infos = env.step(actions[step])
        check_followed(infos, alive, policy.name, scenario, seeds)
        ends[:, step] = terminated, truncated
        begun = terminated | truncated
        # An episode that has ended begins anew, which is ignored: the others still need their steps.
        length[alive & begun] = step + 1
        observations[step + 1][alive] = seen[alive]
        for name, column in told.items():
            column[step + 1][alive] = infos[name][alive]
        alive &= ~begun
        if not alive.any():
            break
    env.close()
    return [
        Episode(
            policy=policy.name,
            seed=int(seed),
            observations=observations[: last + 1, i],
            actions=actions[:last, i],
            rewards=rewards[:last, i],
            terminations=ends[0, :last, i],
            truncations=ends[1, :last, i],
            infos={name: column[: last + 1, i] for name, column in told.items()},
        )
        for i, (seed, last) in enumerate(zip(seeds, length.tolist(), strict=True))
    ]


class Replay(NamedTuple):
    """What a training has kept in its replay buffer."""

    name: str
    scenario: Scenario
    """What it practised on."""
    episodes: list[Episode]


def replayed(folder: Path, trust: bool = False) -> Replay:
    """The episodes in the replay buffer of a training run's newest checkpoint, whole ones alone.

    They have no seeds: what a training flies goes on from episode to episode.

    Args:
        folder: The run's.
        trust: Whether the module of its environment's ID may be imported.

    Raises:
        CommandError: It isn't the folder of a run, its algorithm has no replay buffer, it corrects a policy or was
            trained in wrappers, so that its actions aren't those that were applied or its observations those of the
            scenario, or there is no whole episode.
    """
    if not (folder / "run.json").is_file():
        raise CommandError(f"{str(folder)!r} is not the folder of a training run; it must hold run.json.")
    recorded = recorded_plan(folder / "run.json")
    # Before anything that it names is imported.
    if recorded["settings"].get("residual") is not None:
        raise CommandError(f"{str(folder)!r} corrects a policy: the actions it learned from aren't those applied.")
    if recorded["wrappers"]:
        raise _in_wrappers(folder)
    plan = planned(Wish(trust=trust), recorded)
    practice = plan.practice
    if practice is None:
        raise CommandError(f"{str(folder)!r} was trained on {plan.env_id}, which isn't one of this package's.")
    if not ALGORITHMS[plan.algorithm].off_policy:
        known = ", ".join(name for name, each in ALGORITHMS.items() if each.off_policy)
        raise CommandError(
            f"{str(folder)!r} was trained by {plan.algorithm}, which keeps no replay buffer; it must be one of {known}."
        )
    if plan.wrapping:
        raise _in_wrappers(folder)
    last = checkpoints.newest(folder)
    if last is None:
        raise CommandError(f"{str(folder)!r} holds no checkpoint yet.")
    held = checkpoints.read_buffer(last / "replay.npz", _FIELDS)
    episodes = list(_cut(plan, practice, held))
    if not episodes:
        raise CommandError(f"{str(folder)!r} holds no whole episode in its replay buffer; train it longer.")
    return Replay(f"replay of {folder.name}", practice, episodes)


def _in_wrappers(folder: Path) -> CommandError:
    return CommandError(
        f"{str(folder)!r} was trained in wrappers: what it saw, did and was paid there isn't what its scenario gives."
    )


_FIELDS = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
"""What is needed of a buffer of Stable-Baselines3."""


def _cut(plan: Plan, scenario: Scenario, held: dict[str, npt.NDArray[Any]]) -> list[Episode]:
    """The whole episodes of a buffer's arrays, each (transitions, environments, ...), oldest first."""
    # Stacked frames end in the one that was seen last.
    size = scenario.observation.size
    before, after = held["observations"][..., -size:], held["next_observations"][..., -size:]
    found = []
    for i in range(before.shape[1]):
        ends = np.flatnonzero(held["dones"][:, i])
        # What stands before the first end of a full buffer may have lost its beginning.
        starts = [0 if not held["full"] else None, *(ends + 1).tolist()]
        for first, end in zip(starts, ends.tolist(), strict=False):
            if first is None:
                continue
            own = slice(first, end + 1)
            late = held["timeouts"][own, i].astype(bool)
            found.append(
                Episode(
                    policy=plan.algorithm,
                    seed=None,
                    observations=np.concatenate([before[own, i], after[end : end + 1, i]]).astype(np.float32),
                    actions=held["actions"][own, i].astype(np.float32),
                    rewards=held["rewards"][own, i].astype(np.float64),
                    terminations=held["dones"][own, i].astype(bool) & ~late,
                    truncations=late,
                    infos={},
                )
            )
    return found

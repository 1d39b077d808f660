"""Learning from a teacher before learning from rewards: where the agent comes to, what would the teacher do?

Copying flights of the teacher alone fails where the copy strays from them. So, round by round, ever fewer environments
are flown by the teacher and ever more by the agent, and all that was seen is labelled with what the teacher would have
done (Ross, Gordon and Bagnell, "A Reduction of Imitation Learning and Structured Prediction to No-Regret Online
Learning", AISTATS 2011).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn.functional import mse_loss
from torch.nn.utils import clip_grad_norm_

from uwoc_gym.agents.flight import decide
from uwoc_gym.agents.learning import checkpoints
from uwoc_gym.agents.learning.environments import EpisodeMonitor
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.scenario import Scenario

ROUNDS = 12
"""How many times the agent learns from all that was labelled until then."""

_FIRST_RATE, _LAST_RATE = 1e-3, 1e-4
"""Learning rates of the first round and the last."""

_BATCH = 512
_PASSES = 3.0
"""How often a round goes through all that was labelled."""


class Lessons:
    """What a teacher would do where an agent comes to, and how the agent learns it.

    Args:
        model: The agent, of an algorithm in `settings.TAUGHT`.
        monitor: Tells what the teacher sees: observations before anything is added to them.
        teacher: Who knows what to do.
        scenario: What is practised on.
        steps: Steps to fly in all; whole lots of a round.
        seed: Of the first round's environments, of who flies, and of the order in which is learned.
    """

    def __init__(
        self, model: Any, monitor: EpisodeMonitor, teacher: Policy, scenario: Scenario, steps: int, seed: int
    ) -> None:
        self.model, self._monitor, self._teacher = model, monitor, teacher
        self._pilot = teacher.pilot(scenario)
        self._widths = tuple(int(space.shape[0]) for space in (model.observation_space, model.action_space))
        self._seed = seed
        self._rng = np.random.default_rng(seed)
        self._length = -(-steps // (ROUNDS * monitor.num_envs))
        self.seen: list[torch.Tensor] = []
        """What was seen, (steps, entries) of each round."""
        self.told: list[torch.Tensor] = []
        """What the teacher would have done, (steps, actions) of each."""

    @property
    def rounds(self) -> int:
        """How many rounds were learned from."""
        return len(self.seen)

    @property
    def steps(self) -> int:
        """Steps that were flown for them."""
        return self.rounds * self._length * self._monitor.num_envs

    def fly(self) -> Iterator[int]:
        """Fly and learn to the end of the last round; yields the steps so far, last after the round was learned from.

        What is asked to stop between two steps loses the round that is under way.

        Raises:
            CommandError: The teacher fails, or gives something else than finite actions of the right shape.
        """
        env = self.model.get_env()
        largest = float(self.model.policy.log_std.detach().exp().mean())
        while self.rounds < ROUNDS:
            # A round hangs on what was learned in those before it alone, so that the next one can be begun anywhere.
            self._rng = np.random.default_rng([self._seed, self.rounds])
            env.seed(self._seed + self.rounds * env.num_envs)
            observation, begun, memory = env.reset(), np.ones(env.num_envs, dtype=bool), None
            taught = self._rng.random(env.num_envs) < 1.0 - 2.0 * self.rounds / ROUNDS
            # Some without noise, as the agent will fly in the end, and some as it will explore.
            noise = self._rng.uniform(0.0, largest, (env.num_envs, 1))
            seen, told = [], []
            for step in range(self._length):
                given = decide(self._teacher, self._pilot, self._monitor.seen, memory, begun, self._widths[1])
                action, memory = np.clip(given[0], -1.0, 1.0), given[1]
                seen.append(torch.as_tensor(np.array(observation)))
                told.append(torch.as_tensor(action))
                own, _ = self.model.predict(observation, deterministic=True)
                flown = np.where(taught[:, None], action, own) + noise * self._rng.standard_normal(own.shape)
                observation, _, begun, _ = env.step(np.clip(flown, -1.0, 1.0).astype(np.float32))
                if step < self._length - 1:
                    yield self.steps + (step + 1) * env.num_envs
            self.seen.append(torch.cat(seen))
            self.told.append(torch.cat(told))
            self._learn()
            yield self.steps

    def _learn(self) -> None:
        """Go through all that was labelled; the mean action nears what the teacher would have done."""
        seen, told = torch.cat(self.seen), torch.cat(self.told)
        policy = self.model.policy
        policy.set_training_mode(True)
        done = (self.rounds - 1) / (ROUNDS - 1)
        optimizer = torch.optim.Adam(policy.parameters(), _FIRST_RATE + (_LAST_RATE - _FIRST_RATE) * done)
        for _ in range(max(1, round(_PASSES * len(seen) / _BATCH))):
            some = torch.as_tensor(self._rng.integers(len(seen), size=min(_BATCH, len(seen))))
            loss = mse_loss(policy.get_distribution(seen[some]).distribution.mean, told[some])
            optimizer.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            clip_grad_norm_(policy.parameters(), 1.0)
            optimizer.step()

    def save(self, path: Path) -> None:
        """Keep what was labelled."""
        parts = [torch.zeros((0, width)) for width in self._widths]
        seen, told = (
            torch.cat([first, *own]).numpy() for first, own in zip(parts, (self.seen, self.told), strict=True)
        )
        np.savez(path, seen=seen, told=told)

    def restore(self, path: Path) -> None:
        """Go on with what was labelled before.

        Raises:
            CommandError: The file can't be read, or is of other lessons.
        """
        held = checkpoints.read_arrays(path, ("seen", "told"))
        lot = self._length * self._monitor.num_envs
        count = len(held["seen"])
        if [array.shape for array in held.values()] != [(count, width) for width in self._widths] or count % lot:
            raise checkpoints.damaged(path, ValueError("its arrays don't fit together"))
        self.seen, self.told = (
            [torch.as_tensor(array[i : i + lot]) for i in range(0, count, lot)] for array in held.values()
        )


def hold(policy: Any, held: bool) -> None:
    """Let the critic alone learn, or everything again."""
    for name, each in policy.named_parameters():
        each.requires_grad_(not held or "value_net" in name)

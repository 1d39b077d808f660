"""Teaching a network how ships sail: flights to learn from, and the learning of `LearnedTracker`'s weights."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import nn
from torch.nn.utils import clip_grad_norm_

from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.agents.flight import batches, check_followed, decide
from uwoc_gym.agents.learning.seeds import BATCH
from uwoc_gym.baselines.controllers import CONTROLLERS
from uwoc_gym.baselines.law import Tracker
from uwoc_gym.baselines.learned_tracker import FEATURES, OUTPUTS, Weights, motion, told
from uwoc_gym.baselines.observers import DeadReckoning, Memory, turned, wrapped
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.baselines.tracker import ShipTracker
from uwoc_gym.given import SettingError
from uwoc_gym.scenario import Scenario
from uwoc_gym.task.observation import unpack
from uwoc_gym.vector_env import TrackingVectorEnv

PILOT = CONTROLLERS["ekf-nlpd"]
"""Who flies what is learned from; how the ship sails doesn't hang on it."""

_BATCH, _MOMENTS = 128, 150
"""Episodes a step of learning, and moments of each."""

_SOFT_M = 0.1
"""Distance below which an error counts by its square."""

_SETTLED_S = 3.0
"""What comes before isn't scored: nobody can know how a ship sails from its first fix."""

_UNLOST_M = 1e6
"""Distance at which the link counts as lost in these flights: how a ship sails doesn't end there."""

_RATE = 2e-3


def check(scenario: Scenario) -> None:
    """Refuse a scenario in which there is nothing to learn.

    Raises:
        CommandError: The ship isn't known by fixes alone, or episodes are too short to score.
    """
    with naming("--scenario"):
        seen = scenario.observation
        if not seen.fixes or "ship" in seen.groups:
            raise SettingError(
                f"the observation groups {', '.join(seen.groups)} are not allowed; the ship must be known by 'fix' "
                "alone."
            )
        if scenario.episode.duration_s <= _SETTLED_S:
            raise SettingError(
                f"episode.duration_s = {scenario.episode.duration_s:g} is not allowed; it must be above "
                f"{_SETTLED_S:g} s, before which nobody can know how a ship sails."
            )
        PILOT.pilot(scenario)


class _Moment(NamedTuple):
    """What a flight of N episodes tells at a step."""

    seen: Any
    ship: npt.NDArray[Any]
    """Pose, velocity and acceleration, (N, 9), the place seen from the AUV's along the earth's axes."""
    yaw: npt.NDArray[Any]
    begun: npt.NDArray[np.bool_]


def _flight(scenario: Scenario, seeds: Sequence[int], pilot: Policy) -> Iterator[_Moment]:
    """Fly an episode per seed.

    Raises:
        CommandError: An episode diverges.
    """
    env = TrackingVectorEnv(len(seeds), scenario.merged({"episode.lost_distance_m": _UNLOST_M}))
    observation, _ = env.reset(seed=list(seeds))
    memory: Any = None
    begun, predictor = np.ones(len(seeds), dtype=bool), pilot.pilot(scenario)
    for _ in range(scenario.episode.steps):
        state = env.state()
        ship = np.concatenate([state["ship_pose"], state["ship_velocity"], state["ship_acceleration"]], axis=1)
        ship[:, :2] -= state["pose"][:, :2]
        yield _Moment(unpack(observation, scenario.observation), ship, state["pose"][:, 2], begun)
        action, memory = decide(pilot, predictor, observation, memory, begun, len(scenario.actions))
        observation, _, terminated, truncated, infos = env.step(action)
        check_followed(infos, np.ones(len(seeds), dtype=bool), pilot.name, scenario, seeds)
        begun = terminated | truncated
    env.close()


class Ways(NamedTuple):
    """How ships of N episodes sailed between fixes: K of them, T steps."""

    features: torch.Tensor
    """What a network is told of each fix, (K, N, FEATURES)."""
    fix: torch.Tensor
    """Which is the last one, (T, N)."""
    age_s: torch.Tensor
    truth: torch.Tensor
    """Place, velocity, acceleration along both axes of that fix, then heading since it and its rate, (T, N, 8)."""

    @classmethod
    def joined(cls, parts: Sequence[Ways]) -> Ways:
        """Those of all episodes; where some have fewer fixes, nothing points at those they lack."""
        most = max(len(each.features) for each in parts)
        padded = [nn.functional.pad(each.features, (0, 0, 0, 0, 0, most - len(each.features))) for each in parts]
        rest = (torch.cat([each[i] for each in parts], dim=1) for i in (1, 2, 3))
        return cls(torch.cat(padded, dim=1), *rest)

    def part(self, lanes: torch.Tensor) -> Ways:
        """Those of some episodes."""
        return Ways(*(each[:, lanes] for each in self))


def sailed(scenario: Scenario, seeds: Sequence[int]) -> Ways:
    """Fly an episode per seed and keep how its ship sailed.

    Raises:
        CommandError: An episode diverges.
    """
    count, steps = len(seeds), scenario.episode.steps
    reckon, memory = DeadReckoning(scenario.known()), None
    fix, age_s, truth = np.zeros((steps, count), dtype=np.int64), *(np.zeros((steps, count, *n)) for n in ((), (8,)))
    features: list[npt.NDArray[Any]] = []
    number = np.full(count, -1)
    last, last_s = np.zeros((count, 3)), np.zeros(count)
    for step, moment in enumerate(_flight(scenario, seeds, PILOT)):
        heard, memory = reckon(moment.seen, memory, moment.begun)
        new = np.flatnonzero(heard.told)
        if new.size:
            number[new] += 1
            while len(features) <= number.max():
                features.append(np.zeros((count, FEATURES)))
            own = told(heard.ship[new], last[new], heard.ping_s[new] - last_s[new], heard.begun[new])
            for lane, each in zip(new.tolist(), own, strict=True):
                features[number[lane]][lane] = each
            last[new], last_s[new] = heard.ship[new], heard.ping_s[new]
        fix[step], age_s[step] = number, heard.age_s
        ship = moment.ship
        # The same errors are in where the AUV believes itself to be and in where it hears the ship.
        way = ship[:, :2] + heard.place[:, :2] - last[:, :2]
        truth[step] = np.column_stack(
            [
                *(turned(each, -last[:, 2]) for each in (way, ship[:, 3:5], ship[:, 6:8])),
                wrapped(ship[:, 2] - last[:, 2]),
                ship[:, 5],
            ]
        )
    return Ways(
        torch.as_tensor(np.array(features), dtype=torch.float32),
        torch.as_tensor(fix),
        torch.as_tensor(age_s, dtype=torch.float32),
        torch.as_tensor(truth, dtype=torch.float32),
    )


class Network(nn.Module):
    """The network of `LearnedTracker`, to learn with.

    Args:
        units: Units of its state.
    """

    def __init__(self, units: int) -> None:
        super().__init__()
        self.gates = nn.GRU(FEATURES, units)
        self.hidden = nn.Linear(units, units)
        self.out = nn.Linear(units, OUTPUTS)

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        """Coefficients for each of K fixes of N ships, (K, N, OUTPUTS)."""
        state, _ = self.gates(features)
        found: torch.Tensor = self.out(torch.tanh(self.hidden(state)))
        return found

    def weights(self) -> Weights:
        """The same for NumPy."""
        named = dict(self.named_parameters())
        names = [f"gates.{kind}_{what}_l0" for what in ("ih", "hh") for kind in ("weight", "bias")]
        names += [f"{layer}.{kind}" for layer in ("hidden", "out") for kind in ("weight", "bias")]
        return Weights(*(named[name].detach().double().numpy().copy() for name in names))


def loss(network: Network, ways: Ways, moments: torch.Tensor) -> torch.Tensor:
    """How far the network is from how ships sailed, at some steps: mostly in place [m]."""
    coefficients = network(ways.features)
    which = ways.fix[moments][..., None].expand(-1, -1, OUTPUTS)
    *axes, heading, rate = motion(torch.gather(coefficients, 0, which), ways.age_s[moments])
    truth = ways.truth[moments]
    place, velocity, acceleration = (
        torch.sqrt((each[0] - truth[..., 2 * i]) ** 2 + (each[1] - truth[..., 2 * i + 1]) ** 2 + _SOFT_M**2).mean()
        for i, each in enumerate(axes)
    )
    turn, turning = ((heading - truth[..., 6]) ** 2).mean(), ((rate - truth[..., 7]) ** 2).mean()
    total: torch.Tensor = place + 0.3 * velocity + 0.1 * acceleration + 2.0 * turn + 0.3 * turning
    return total


def learn(network: Network, ways: Ways, steps: int, seed: int) -> Iterator[float]:
    """Learn in so many steps, at a rate that falls to nothing; yields the loss at each.

    Raises:
        CommandError: The loss isn't finite any more.
    """
    order = torch.Generator().manual_seed(seed)
    optimizer = torch.optim.Adam(network.parameters(), _RATE)
    duration, count = ways.fix.shape
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = _RATE * (1.0 - step / steps)
        some = torch.randint(count, (min(_BATCH, count),), generator=order)
        moments = torch.randint(duration, (_MOMENTS,), generator=order)
        found = loss(network, ways.part(some), moments)
        if not torch.isfinite(found):
            raise CommandError(f"the loss isn't finite at step {step + 1:,}; give another --seed, or more --episodes.")
        optimizer.zero_grad()
        found.backward()  # type: ignore[no-untyped-call]
        clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        yield found.item()


def errors(scenario: Scenario, trackers: Mapping[str, Tracker], seeds: Sequence[int]) -> dict[str, dict[str, float]]:
    """How far trackers are from where ships are, over the same flights, once they have had time to settle.

    Returns:
        By the tracker's name the root mean square and the median of the distance [m], and the root mean squares of the
        error in velocity [m/s] and heading [rad].
    """
    squares: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in trackers}
    for batch in batches(seeds, BATCH):
        for name, part in _squares(scenario, trackers, batch).items():
            squares[name].append(part)
    found = {}
    for name, parts in squares.items():
        place, velocity, heading = np.concatenate(parts, axis=1)
        found[name] = {
            "place_rms_m": float(np.sqrt(place.mean())),
            "place_median_m": float(np.median(np.sqrt(place))),
            "velocity_rms_mps": float(np.sqrt(velocity.mean())),
            "heading_rms_rad": float(np.sqrt(heading.mean())),
        }
    return found


def _squares(scenario: Scenario, trackers: Mapping[str, Tracker], seeds: Sequence[int]) -> dict[str, npt.NDArray[Any]]:
    """Squares of the errors in place, velocity and heading, (3, moments), by the tracker's name."""
    known = scenario.known()
    observers = {name: make(known) for name, make in trackers.items()}
    memories: dict[str, Memory] = dict.fromkeys(observers)
    squares: dict[str, list[npt.NDArray[Any]]] = {name: [] for name in observers}
    settled = round(_SETTLED_S / scenario.episode.control_period_s)
    for step, moment in enumerate(_flight(scenario, seeds, PILOT)):
        for name, observe in observers.items():
            seen: Any
            seen, memories[name] = observe(moment.seen, memories[name], moment.begun)
            if step < settled:
                continue
            yaw = np.arctan2(seen.heading[:, 1], seen.heading[:, 0])
            place = turned(seen.relative_position, yaw) - moment.ship[:, :2]
            velocity = turned((seen.relative_velocity + seen.velocity)[:, :2], yaw) - moment.ship[:, 3:5]
            heading = wrapped(seen.yaw_error + yaw - moment.ship[:, 2])
            squares[name].append(np.stack([(place**2).sum(axis=1), (velocity**2).sum(axis=1), heading**2]))
    return {name: np.concatenate(own, axis=1) for name, own in squares.items()}


RIVAL: tuple[str, Tracker] = ("three models", ShipTracker)
"""The tracker that isn't learned, and what it is called."""

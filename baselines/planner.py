"""Planning by sampling on the package's own simulator: model predictive path integral control, and a clairvoyant.

A plan is a whole sequence of actions. Around it candidates are drawn, flown ahead by `Fleet.rollout`, and scored by the
reward until the horizon and a guess at what comes after it. The best becomes the plan, and the next candidates have
among them the soft-max mean of the last (Williams et al., "Information-Theoretic Model Predictive Control", IEEE Trans.
Robotics 34(6), 2018). What keeps it from the slow gathering of a plain soft-max is that the best plan ever flown stays,
that each candidate has a scale of its own, and that some are drawn around what line-of-sight guidance would do.

`Planner` knows what laws know: observations, filters, the nominal model. `Clairvoyant` is given the true state and,
since every draw is a function of the step, the true future: it isn't a rival but shows what somebody could reach.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines.guidance import Guidance, GuidanceGains
from uwoc_gym.baselines.law import batch_of, observer
from uwoc_gym.baselines.numbers import fixed
from uwoc_gym.baselines.observers import Memory, completed, turned
from uwoc_gym.parameters import Parameters, flag
from uwoc_gym.scenario import Scenario, as_scenario
from uwoc_gym.sim.fleet import Autoreset, Fleet
from uwoc_gym.sim.layout import FLAGS, OUT_ROWS
from uwoc_gym.task.observation import Measured, ObservationSettings, unpack

Array = npt.NDArray[np.float64]

_FLIGHTS = 2048
"""How many candidates are flown at a time, so that they stay in the processor's cache."""

_SLOWEST_MPS2 = 0.02
"""Square of the speed below which how a ship's course turns can't be told."""

_AROUND_GUIDANCE = 0.25
"""Share of a plan's first candidates that are drawn around what guidance would do."""


@dataclass(frozen=True, kw_only=True)
class PlannerSettings(Parameters):
    """How far a planner looks ahead and how hard it tries."""

    horizon_s: float = fixed(3.0, "s", "how far ahead candidates are flown", 0.05, 1e3)
    replan_s: float = fixed(0.1, "s", "time between plans, of which as much is flown", 0.005, 1e3)
    candidates: float = fixed(128.0, "1", "candidates a round", 3.0, 1e5)
    rounds: float = fixed(4.0, "1", "rounds of candidates a plan", 1.0, 1e4)
    at_first: float = fixed(3.0, "1", "how many times as many rounds an episode's first plan gets", 1.0, 1e4)
    knots: float = fixed(8.0, "1", "points between which what candidates differ by is a line", 2.0, 1e3)
    crowding: float = fixed(1.5, "1", "1 for knots that lie evenly, more for denser ones at first", 0.1, 10.0)
    finest: float = fixed(
        0.03, "1", "smallest scale of a candidate's difference, in shares of the actuators' limits", 1e-6, 10.0
    )
    coarsest: float = fixed(0.7, "1", "largest scale of it", 1e-6, 10.0)
    left_alone: float = fixed(0.4, "1", "how likely a candidate leaves an axis as it is", 0.0, 0.999)
    guided: bool = flag(True, "whether guidance's flight ahead, and candidates around it, are among the first")
    temperature: float = fixed(1.0, "1", "return by which a candidate may be worse to weigh 1/e", 1e-6, 1e6)
    beyond_s: float = fixed(0.25, "s", "how long the last reward is taken to go on", 0.0, 1e3)
    radius_m: float = fixed(1.5, "m", "distance at the horizon beyond which metres cost", 0.0, 1e4)
    per_metre: float = fixed(20.0, "1/m", "what each of them costs of the return", 0.0, 1e6)


class _Guide:
    """What line-of-sight guidance would do from a state on, if it saw everything.

    Args:
        scenario: What is known of the scenario.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._law = Guidance(GuidanceGains(), replace(scenario, observation=ObservationSettings()), filtered=False)
        self._fleets: dict[int, Fleet] = {}

    def ahead(self, scenario: Scenario, rows: npt.NDArray[np.void], steps: int) -> Array:
        """Its actions from each of n states of the scenario, (n, steps, actions)."""
        count = len(rows)
        if count not in self._fleets:
            # What ends flies on, from somewhere else: nobody minds.
            self._fleets[count] = Fleet(scenario, count, Autoreset.SAME_STEP)
        fleet = self._fleets[count]
        fleet.restore(rows)
        unseen = np.empty((2, count, scenario.observation.size), dtype=np.float32)
        out, flags = np.empty((OUT_ROWS, count)), np.empty((len(FLAGS), count), dtype=bool)
        found = np.empty((count, steps, len(scenario.actions)))
        for step in range(steps):
            action = self._law.action(_seen(fleet.state()))
            found[:, step] = action
            fleet.step(action, unseen[0], out, flags, unseen[1])
        return found


def _seen(state: dict[str, npt.NDArray[Any]]) -> Measured:
    """True states as a law would see them."""
    yaw = state["pose"][:, 2]
    own = Measured(
        velocity=state["velocity"],
        heading=np.column_stack([np.cos(yaw), np.sin(yaw)]),
        water_velocity=turned(state["current"], -yaw),
    )
    return completed(own, state["pose"], state["ship_pose"], state["ship_velocity"], state["ship_acceleration"])


class _Sampler:
    """What both planners share: plans that candidates improve, each lane's from draws that hang on its step alone."""

    def __init__(self, settings: PlannerSettings | None, scenario: str | Scenario) -> None:
        self.scenario = as_scenario(scenario)
        self.settings = s = settings or PlannerSettings()
        period_s = self.scenario.episode.control_period_s
        self._steps = max(1, round(s.horizon_s / period_s))
        self._replan = min(self._steps, max(1, round(s.replan_s / period_s)))
        self._beyond = s.beyond_s / period_s
        self._actions = len(self.scenario.actions)
        knots = round(s.knots)
        at = (self._steps - 1) * (np.arange(knots) / (knots - 1.0)) ** s.crowding
        self._guide = _Guide(self.scenario) if s.guided else None
        steps = np.arange(self._steps)
        self._between = np.stack([np.interp(steps, at, own) for own in np.eye(knots)], axis=1)

    def roots(self, seen: Any, lanes: npt.NDArray[np.int64]) -> tuple[Fleet, npt.NDArray[np.void]]:
        """What flies candidates, and where they begin: a record for each of the lanes."""
        raise NotImplementedError

    def look(
        self, observation: npt.NDArray[Any], memory: Memory, begun: npt.NDArray[np.bool_] | None
    ) -> tuple[Any, Memory]:
        """What is made of observations, and the memory for the next ones."""
        raise NotImplementedError

    def predict(
        self,
        observation: npt.ArrayLike,
        state: Memory = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[npt.NDArray[np.float32], Memory]:
        """The action for an observation, called as in Stable-Baselines3; see `Law.predict`."""
        batch = batch_of(observation, self.scenario.observation)
        lanes = len(batch)
        if state is None:
            step, plan, memory = np.full(lanes, -1), np.zeros((lanes, self._steps, self._actions)), None
            begun = np.ones(lanes, dtype=bool)
        else:
            step, plan, *parts = state
            memory = tuple(parts) or None
            begun = np.zeros(lanes, dtype=bool) if episode_start is None else np.asarray(episode_start, dtype=bool)
        seen, memory = self.look(batch, memory, begun)
        step = np.where(begun, 0, step + 1)
        plan = np.concatenate([plan[:, 1:], plan[:, -1:]], axis=1)
        plan[begun] = 0.0
        for moment in np.unique(step[step % self._replan == 0]):
            for own in self._groups(np.flatnonzero(step == moment)):
                fleet, rows = self.roots(seen, own)
                plan[own] = self._improved(plan[own], fleet, rows, int(moment))
        action = plan[:, 0].astype(np.float32)
        return (action[0] if np.ndim(observation) == 1 else action), (step, plan, *(memory or ()))

    def _groups(self, lanes: npt.NDArray[np.int64]) -> Iterator[npt.NDArray[np.int64]]:
        size = max(1, _FLIGHTS // round(self.settings.candidates))
        for begin in range(0, lanes.size, size):
            yield lanes[begin : begin + size]

    def _improved(self, plan: Array, fleet: Fleet, rows: npt.NDArray[np.void], moment: int) -> Array:
        """The best plans found around plans, (n, steps, actions)."""
        s = self.settings
        lanes, count = len(plan), round(s.candidates)
        roots = np.repeat(rows, count)
        mean = plan
        near = slice(2, 2 + (round(_AROUND_GUIDANCE * count) if self._guide else 0))
        for turn in range(round(s.rounds * (s.at_first if moment == 0 else 1.0))):
            differences = self._differences(moment, turn)
            tried = plan[:, None] + differences
            if turn == 0 and self._guide is not None:
                guided = self._guide.ahead(fleet.scenario, rows, self._steps)
                tried[:, near] = guided[:, None] + differences[near]
                tried[:, 2] = guided
            tried = np.clip(tried, -1.0, 1.0)
            tried[:, 0], tried[:, 1] = plan, mean
            flown = fleet.rollout(roots, tried.reshape(-1, *plan.shape[1:]))
            outside = np.maximum(flown.last_distance_m - s.radius_m, 0.0)
            score = flown.returns + self._beyond * flown.last_reward - s.per_metre * outside
            score = score.reshape(lanes, count)
            weight = np.exp((score - score.max(axis=1, keepdims=True)) / s.temperature)
            weight /= weight.sum(axis=1, keepdims=True)
            mean = (weight[:, None] @ tried.reshape(lanes, count, -1)).reshape(plan.shape)
            plan = tried[np.arange(lanes), score.argmax(axis=1)]
        return plan

    def _differences(self, moment: int, turn: int) -> Array:
        """What candidates differ from the plan by, (candidates, steps, actions): the same in every lane."""
        s, count = self.settings, round(self.settings.candidates)
        rng = np.random.default_rng((moment, turn))
        knots = rng.standard_normal((count, self._between.shape[1], self._actions))
        scale = np.exp(rng.uniform(math.log(s.finest), math.log(s.coarsest), (count, 1, 1)))
        moved = rng.random((count, 1, self._actions)) >= s.left_alone
        found: Array = self._between @ (knots * scale * moved)
        return found


class Planner(_Sampler):
    """Plans on the nominal model, from what filters believe; batched over observations.

    Args:
        settings: How far it looks ahead and how hard it tries.
        scenario: What is known of the scenario, or the name of one.

    Raises:
        SettingError: There is no scenario of that name, or its observations leave out what the planner needs.
    """

    def __init__(self, settings: PlannerSettings | None = None, scenario: str | Scenario = "Nominal") -> None:
        super().__init__(settings, scenario)
        needed = ("ship", "velocity", "heading", "ship-acceleration")
        self._observe = observer(self.scenario, True, dict.fromkeys(needed, ""))
        self._model = self.scenario.known(math.inf)
        self._fastest = self._model.motion.velocity
        self._fleets: dict[int, Fleet] = {}

    def look(
        self, observation: npt.NDArray[Any], memory: Memory, begun: npt.NDArray[np.bool_] | None
    ) -> tuple[Any, Memory]:
        return self._observe(unpack(observation, self.scenario.observation), memory, begun)

    def roots(self, seen: Any, lanes: npt.NDArray[np.int64]) -> tuple[Fleet, npt.NDArray[np.void]]:
        # A fleet of each size, since a belief is for a whole one.
        fleet = self._fleets.setdefault(lanes.size, Fleet(self._model, lanes.size))
        heading = seen.heading[lanes]
        yaw = np.arctan2(heading[:, 1], heading[:, 0])
        still = np.zeros_like(yaw)
        # The model doesn't get faster than this by itself.
        velocity = np.clip(seen.velocity[lanes], -self._fastest, self._fastest)
        ship = seen.velocity[lanes] + seen.relative_velocity[lanes]
        course, gain = turned(ship[:, :2], yaw), turned(seen.ship_acceleration[lanes, :2], yaw)
        across = course[:, 0] * gain[:, 1] - course[:, 1] * gain[:, 0]
        fleet.believe(
            pose=np.column_stack([still, still, yaw]),
            velocity=velocity,
            ship_pose=np.column_stack([turned(seen.relative_position[lanes], yaw), yaw + seen.yaw_error[lanes]]),
            ship_velocity=np.column_stack([course, ship[:, 2]]),
            ship_turn_rad_s=np.clip(across / np.maximum((course**2).sum(axis=1), _SLOWEST_MPS2), -1.0, 1.0),
            current=0.0 if seen.water_velocity is None else turned(seen.water_velocity[lanes], yaw),
        )
        return fleet, fleet.snapshot()


class Clairvoyant(_Sampler):
    """Plans on the true simulation: what it flies is what will happen. It can only fly what it watches.

    Args:
        settings: How far it looks ahead and how hard it tries.
        scenario: The scenario, or the name of one.
    """

    def __init__(self, settings: PlannerSettings | None = None, scenario: str | Scenario = "Nominal") -> None:
        super().__init__(settings, scenario)
        self._env: Any = None

    def watch(self, env: Any) -> None:
        """Be given the environment, single or vector, whose observations are decided on from now on."""
        self._env = env
        self._fleet = Fleet(env.scenario, 1)

    def look(
        self, observation: npt.NDArray[Any], memory: Memory, begun: npt.NDArray[np.bool_] | None
    ) -> tuple[Any, Memory]:
        if self._env is None:
            raise RuntimeError("a clairvoyant policy decides on true states; give it the environment by watch(env).")
        return self._env.snapshot(), None

    def roots(self, seen: Any, lanes: npt.NDArray[np.int64]) -> tuple[Fleet, npt.NDArray[np.void]]:
        return self._fleet, seen[lanes]

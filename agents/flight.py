"""Flying a policy through seeded episodes, and what they come to."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.agents.policies.registry import load
from uwoc_gym.agents.work import take_one_thread
from uwoc_gym.agents.wrapping import PLAIN, Wrapping, wrapping
from uwoc_gym.baselines.policy import Policy, Predictor
from uwoc_gym.given import LIMITS
from uwoc_gym.metrics import EpisodeMetrics, EpisodeRecord, episode_metrics, losses, phases
from uwoc_gym.scenario import Scenario
from uwoc_gym.sim.layout import varying
from uwoc_gym.world.sea.pulses import pulse_times
from uwoc_gym.wrapping import parameters_of, state_of, terms_of

Array = npt.NDArray[np.float64]


def flown_seeds(policy: Policy, scenario: Scenario, seeds: Sequence[int], wrapping: Wrapping = PLAIN) -> Sequence[int]:
    """The seeds that differ: the first alone where neither scenario nor policy nor a wrapper has anything random."""
    return seeds[:1] if policy.deterministic and not scenario.draws and not wrapping else seeds


@dataclass(frozen=True, kw_only=True)
class Series:
    """What one episode looked like, one sample per control period."""

    time_s: Array
    pose: Array
    """(T + 1, 3) [m, m, rad]."""
    ship_pose: Array
    """(T + 1, 3) [m, m, rad]."""
    range_m: Array
    pointing_error_rad: Array
    bit_rate_bps: Array
    slant_height_m: float
    depth_m: float
    disturbance_s: float
    """Start of the first disturbance [s]; nan if there is none."""


@dataclass(frozen=True, kw_only=True)
class Flight:
    """The episodes of one policy in one scenario."""

    seeds: tuple[int, ...]
    metrics: EpisodeMetrics
    record: EpisodeRecord
    losses: dict[str, Array]
    """What the episodes lack of the highest return, by `metrics.losses`, each of shape (N,)."""
    drawn: dict[str, npt.NDArray[Any]]
    """What they have drawn, by its path, as `TrackingVectorEnv.parameters` gives it."""
    series: Series
    """The first episode."""
    extra: dict[str, Array]
    """Further entries of the true state that were asked for, each of shape (T + 1, N, ...)."""

    def rows(self) -> list[dict[str, float]]:
        """One dict per episode: its measures, and what it lacks."""
        lacking = [dict(zip(self.losses, row, strict=True)) for row in np.transpose([*self.losses.values()]).tolist()]
        return [own | more for own, more in zip(self.metrics.rows(), lacking, strict=True)]


def possible(scenario: Scenario) -> float:
    """The highest return that an episode can have."""
    return scenario.episode.steps * scenario.reward.bounds[1]


def check_size(scenario: Scenario, episodes: int) -> None:
    """Refuse flights of which more would have to be kept than there is room for.

    Raises:
        CommandError: Episodes times control periods are too many.
    """
    periods, most = (scenario.episode.steps + 1) * episodes, int(LIMITS["flown together"].high)
    if periods > most:
        raise CommandError(
            f"{episodes} episodes of {scenario.episode.duration_s:g} s at a time is not allowed: the {periods:_} "
            f"control periods must be at most {most:_}; fly fewer at a time, shorter ones, or a longer control period."
        )


def check_flights(
    policies: Sequence[Policy], scenarios: Mapping[str, Scenario], episodes: int, wrapping: Wrapping = PLAIN
) -> None:
    """Refuse, before anything is flown, policies and wrappers that can't fly the scenarios, and flights too long.

    Raises:
        CommandError: There is one.
    """
    for name, scenario in scenarios.items():
        with naming(f"--scenario {name}"):
            check_size(scenario, episodes)
        wrapping.check(scenario)
        for policy in policies:
            with naming(f"policy {policy.name!r} can't fly {name}"):
                policy.pilot(scenario)


_RECORDED = ("in_cone", "pose", "ship_pose", "bit_rate_bps")


def fly(
    policy: Policy,
    scenario: Scenario,
    seeds: Sequence[int],
    parameters: Mapping[str, npt.ArrayLike] | None = None,
    extra: Sequence[str] = (),
    wrapping: Wrapping = PLAIN,
) -> Flight:
    """Fly one episode per seed, all together, on observations alone.

    The policy sees what wrappers show it, and is paid what they pay; all else is measured on the true states.

    Args:
        policy: What decides.
        scenario: What is flown.
        seeds: Seeds of the N episodes.
        parameters: Numbers to take instead of drawing them, as in `TrackingVectorEnv.reset`.
        extra: Names of entries of `TrackingVectorEnv.state` to record besides what the measures need.
        wrapping: What stands around the environments; ``parameters`` go to fleets alone.

    Raises:
        ValueError: One of ``parameters`` isn't allowed.
        CommandError: It is too much to fly at a time, an episode diverges, or the policy gives actions of another shape
            or that aren't finite.
    """
    size, steps = len(seeds), scenario.episode.steps
    check_size(scenario, size)
    # After its end a simulation begins anew, which is ignored: the others still need their steps.
    env = wrapping.fleet(scenario, size)
    predictor = policy.pilot(scenario, env)
    with wrapping.blamed():
        observations, _ = env.reset(seed=list(seeds), options={"parameters": parameters})  # type: ignore[arg-type]
    state, drawn = state_of(env), parameters_of(env)
    width = math.prod(env.single_action_space.shape or ())
    tracks = {name: np.zeros((steps + 1, *state[name].shape), state[name].dtype) for name in (*_RECORDED, *extra)}
    first = {name: np.zeros(steps + 1) for name in ("range_m", "pointing_error_rad")}
    force, reward = np.zeros((steps, size, 3)), np.zeros((steps, size))
    terms = {name: np.zeros((steps, size)) for name in scenario.reward.highest}
    valid = np.zeros((steps + 1, size), dtype=bool)
    alive, lost, begun = np.ones(size, dtype=bool), np.zeros(size, dtype=bool), np.ones(size, dtype=bool)
    pulses = pulse_times(drawn)
    disturbance = np.min([begin for begin, _ in pulses], axis=0) if pulses else np.full(size, math.nan)
    slant, depth = float(state["slant_height_m"][0]), float(state["depth_m"][0])
    rewards, terminated, truncated = np.zeros(size), np.zeros(size, dtype=bool), np.zeros(size, dtype=bool)
    memory: Any = None
    for step in range(steps + 1):
        for name, track in tracks.items():
            track[step] = state[name]
        for name, column in first.items():
            column[step] = state[name][0]
        valid[step] = alive
        if step > 0:
            force[step - 1] = state["force"]
            reward[step - 1] = rewards
            for name, term in terms_of(env).items():
                terms[name][step - 1] = term
            lost |= alive & terminated
            alive = alive & ~(terminated | truncated)
        if step == steps or not alive.any():
            break
        actions, memory = decide(policy, predictor, observations, memory, begun, width)
        actions = np.where(alive[:, None], actions, np.float32(0.0))
        with wrapping.blamed():
            observations, rewards, terminated, truncated, infos = env.step(actions)
        check_followed(infos, alive, policy.name, scenario, seeds)
        begun = terminated | truncated
        state = state_of(env)
        if wrapping:
            wrapping.check_clock(state["time_s"][alive & ~begun], (step + 1) * scenario.episode.control_period_s)
    env.close()
    record = EpisodeRecord(
        time_s=np.arange(steps + 1, dtype=np.float64) * scenario.episode.control_period_s,
        **{name: tracks[name] for name in _RECORDED},
        force=force,
        reward=reward,
        valid=valid,
        lost=lost,
        disturbance_s=disturbance,
        force_limits=scenario.vehicle.force_limits,
    )
    parts = phases(record.time_s, record.in_cone, pulses, valid)
    own = valid[:, 0]
    series = Series(
        time_s=record.time_s[own],
        pose=record.pose[own, 0],
        ship_pose=record.ship_pose[own, 0],
        range_m=first["range_m"][own],
        pointing_error_rad=first["pointing_error_rad"][own],
        bit_rate_bps=record.bit_rate_bps[own, 0],
        slant_height_m=slant,
        depth_m=depth,
        disturbance_s=float(disturbance[0]),
    )
    return Flight(
        seeds=tuple(seeds),
        metrics=episode_metrics(record),
        record=record,
        losses=losses(terms, scenario.reward.highest, parts, valid),
        drawn=drawn,
        series=series,
        extra={name: tracks[name] for name in extra},
    )


class Flown(NamedTuple):
    """What a process tells of episodes that it has flown."""

    rows: list[dict[str, float]]
    """The measures of each, and what it lacks."""
    drawn: list[dict[str, float | str]]
    """What each has drawn, by its path, of what differs from episode to episode and belongs to it."""
    series: Series
    """The first."""
    seconds: float
    """How long the flight took."""


def flown(policy: str, trust: bool, wrapper: Sequence[str], scenario: Scenario, seeds: Sequence[int]) -> Flown:
    """Fly one episode per seed, all said in words that another process understands.

    Args:
        policy: As `load` takes it.
        trust: Whether what its file holds or names may be run.
        wrapper: What goes around the environments.
        scenario: What is flown.
        seeds: Seeds of the episodes.

    Raises:
        CommandError: As of `load`, `wrapping` and `fly`.
    """
    own, around = load(policy, trust), wrapping(wrapper)
    # What it imports doesn't belong to the flight's time.
    own.pilot(scenario)
    take_one_thread()
    begun = time.perf_counter()
    flight = fly(own, scenario, seeds, wrapping=around)
    seconds = time.perf_counter() - begun
    paths = varying(scenario)
    values = zip(*(flight.drawn[path].tolist() for path in paths), strict=True)
    drawn = [dict(zip(paths, row, strict=True)) for row in values] if paths else [{} for _ in seeds]
    return Flown(
        flight.rows(),
        [{path: value for path, value in row.items() if value == value and value != ""} for row in drawn],
        flight.series,
        seconds,
    )


def decision_time(policy: str, trust: bool, wrapper: Sequence[str], scenario: Scenario, seeds: Sequence[int]) -> float:
    """Microseconds that a policy takes for a decision on one observation: the mean over the first of an episode.

    A planner doesn't think at each of them, so that a median would say how long it takes to do nothing. The very first
    ones, which compile and load, don't count.

    Args:
        policy: As `load` takes it.
        trust: Whether what its file holds or names may be run.
        wrapper: What goes around the environments.
        scenario: What is flown.
        seeds: The episode's seed.
    """
    own, around = load(policy, trust), wrapping(wrapper)
    env = around.fleet(scenario, 1)
    predictor = own.pilot(scenario, env)
    take_one_thread()
    width = math.prod(env.single_action_space.shape or ())
    observations, _ = env.reset(seed=list(seeds))  # type: ignore[arg-type]
    memory: Any = None
    begun, times = np.ones(1, dtype=bool), list[float]()
    while len(times) < _LEAST or (len(times) < _DECISIONS and sum(times) < _LONGEST_S):
        at = time.perf_counter()
        actions, memory = decide(own, predictor, observations, memory, begun, width)
        times.append(time.perf_counter() - at)
        observations, _, terminated, truncated, _ = env.step(actions)
        begun = terminated | truncated
    env.close()
    counted = times[min(_FIRST, len(times) // 2) :]
    return 1e6 * sum(counted) / len(counted)


_DECISIONS = 120
"""How many decisions are timed."""

_LEAST = 10
"""How many at least."""

_FIRST = 20
"""How many of the first don't count."""

_LONGEST_S = 2.0
"""How long they are timed for beyond that [s]."""


def check_followed(
    infos: Mapping[str, Any],
    alive: npt.NDArray[np.bool_],
    policy: str,
    scenario: Scenario,
    seeds: Sequence[int],
) -> None:
    """Refuse to go on where the integrator couldn't follow one of the episodes that are still flown.

    Raises:
        CommandError: There is one.
    """
    if "diverged" in infos and (alive & infos["diverged"]).any():
        lost = [seed for seed, bad in zip(seeds, alive & infos["diverged"], strict=True) if bad]
        raise CommandError(
            f"policy {policy!r}: the integrator couldn't follow the episodes of the seeds {lost[:10]} in steps of "
            f"EpisodeSettings.integration_step_s = {scenario.episode.integration_step_s!r}; take shorter ones [s]."
        )


def decide(
    policy: Policy, predictor: Predictor, observations: Any, memory: Any, begun: npt.NDArray[np.bool_], width: int
) -> tuple[npt.NDArray[np.float32], Any]:
    """Actions (N, width) for N observations, and the policy's memory.

    Raises:
        CommandError: The policy fails, or gives something else than finite actions of that shape and its memory.
    """
    try:
        found = predictor.predict(observations, state=memory, episode_start=begun, deterministic=True)
    except CommandError:
        raise
    except Exception as error:
        raise CommandError(f"policy {policy.name!r} failed: {type(error).__name__}: {error}") from error
    if not isinstance(found, tuple) or len(found) != 2:
        raise CommandError(f"policy {policy.name!r} gave a {type(found).__name__}; it must give (actions, memory).")
    size = len(observations)
    try:
        array = np.asarray(found[0], dtype=np.float32)
    except (TypeError, ValueError):
        array = np.empty(0, dtype=np.float32)
    if array.shape != (size, width) or not np.isfinite(array).all():
        raise CommandError(
            f"policy {policy.name!r} gave actions of shape {array.shape}"
            f"{'' if np.isfinite(array).all() else ' that are not all finite'}; they must be finite and of shape "
            f"({size}, {width})."
        )
    return array, found[1]


def batches(seeds: Sequence[int], size: int) -> Iterator[Sequence[int]]:
    """The seeds in groups of at most ``size``."""
    for start in range(0, len(seeds), size):
        yield seeds[start : start + size]

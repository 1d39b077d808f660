"""Random scenarios from all that is accepted: are their numbers finite, and does the integrator follow them?

A scenario is drawn around the defaults, most numbers up to a factor of thirty away or ranges of that width, and flown
with the longest integration step that is accepted. Each of its simulations draws a world from it. A second fleet flies
the same actions with a step of 1/8, whose own error is some 4,000 times smaller; where it differs by more than 0.2 %,
a third flies them with a step of 1/64.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from tests.trust.figures import share
from uwoc_gym import Scenario, SettingError
from uwoc_gym.parameters import NumberSpec, Parameters
from uwoc_gym.sim.fleet import Fleet
from uwoc_gym.sim.layout import FLAGS, MEASURE_NAMES
from uwoc_gym.world.auv.start import Start
from uwoc_gym.world.sea.current import Current
from uwoc_gym.world.sea.pulses import Pulse
from uwoc_gym.world.ship.paths import SHIP_PATHS, CarriedOnPath, RecordedPath

LANES = 32
STEPS = 50
FINER = (8, 64)
NEAR = 0.002
PERIODS = (0.02, 0.05, 0.1, 0.2)
PATHS = [path for path in SHIP_PATHS if path not in (RecordedPath, CarriedOnPath)]


class Tally(NamedTuple):
    """What came of the random scenarios."""

    tried: int
    accepted: int
    worlds: int
    not_finite: int
    diverged: int
    above: int
    """Worlds that differ by more than 1 %."""
    largest_error: float


def random_number(spec: NumberSpec, default: Any, generator: np.random.Generator) -> Any:
    """A number, or a range, that the field allows."""
    middle = 0.0 if default is None else float(np.mean(default))

    def one() -> float:
        kind = generator.random()
        if kind < 0.05:
            return float(generator.choice([spec.low, spec.high]))
        if middle == 0.0:
            value = generator.normal() * 10.0 ** generator.uniform(-2.0, 0.5)
        else:
            value = middle * math.exp(generator.uniform(-1.0, 1.0) * math.log(30.0))
        return float(np.clip(value, spec.low, spec.high))

    if spec.randomisable and generator.random() < 0.3:
        return sorted((one(), one()))
    return one()


def random_part(own: type[Parameters], generator: np.random.Generator, share: float) -> dict[str, Any]:
    """Overrides for that share of the numbers of a class."""
    return {
        name: random_number(spec, getattr(own, name, None), generator)
        for name, spec in own.specs().items()
        if isinstance(spec, NumberSpec) and not spec.optional and generator.random() < share
    }


def random_scenario(generator: np.random.Generator) -> Scenario:
    """A scenario that is accepted, or not.

    Raises:
        SettingError: It isn't.
    """
    share = generator.uniform(0.0, 0.6)
    period = float(generator.choice(PERIODS))
    path = PATHS[generator.integers(len(PATHS))]
    base = Scenario()
    rough = {
        "vehicle": random_part(type(base.vehicle), generator, share),
        "link": random_part(type(base.link), generator, 0.1 * share),
        "ship": {"kind": path.kind, **random_part(path, generator, share)},
        "sea": {
            "pulses": [random_part(Pulse, generator, share) | {"start_s": 0.3} for _ in range(generator.integers(3))],
            "current": random_part(Current, generator, share),
        },
        "sensors": random_part(type(base.sensors), generator, share),
        "start": random_part(Start, generator, share) | {"relative_to_ship": True},
        "reward": random_part(type(base.reward), generator, share),
        "observation": random_part(type(base.observation), generator, share),
        "episode": {
            "duration_s": STEPS * period,
            "control_period_s": period,
            "integration_step_s": period / round(period / 1e-6),
            "lost_distance_m": 1e5,
        },
    }
    scenario = base.merged(rough)
    motion = scenario.motion
    step = scenario.episode.step_within(motion.longest_step(motion.rate))
    return scenario.merged({"episode": {"integration_step_s": step}})


def flown(
    scenario: Scenario, actions: npt.NDArray[np.float32], seed: int
) -> tuple[npt.NDArray[np.float64], bool, npt.NDArray[np.bool_]]:
    """Poses (steps, lanes, 3), whether all that agents see is finite, and which lanes diverged."""
    lanes = actions.shape[1]
    fleet = Fleet(scenario, lanes)
    fleet.seed(np.arange(lanes), [seed + lane for lane in range(lanes)])
    observations = np.zeros((lanes, scenario.observation.size), np.float32)
    out, flags = np.zeros((len(MEASURE_NAMES), lanes)), np.zeros((len(FLAGS), lanes), np.bool_)
    fleet.reset(observations)
    finite = np.isfinite(observations).all()
    poses = []
    for action in actions:
        fleet.step(action, observations, out, flags)
        finite &= np.isfinite(observations).all() and np.isfinite(out).all()
        poses.append(fleet.state()["pose"])
        if flags[:2].any():
            break
    return np.array(poses), bool(finite), fleet.diverged


def relative_error(coarse: npt.NDArray[np.float64], fine: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Largest difference of each lane over the way that it has gone, and of its heading over what it has turned."""
    steps = min(len(coarse), len(fine))
    apart, moved = coarse[:steps] - fine[:steps], np.diff(fine[:steps], axis=0)
    way = np.maximum(np.linalg.norm(moved[..., :2], axis=-1).sum(axis=0), 0.1)
    turned = np.maximum(np.abs(moved[..., 2]).sum(axis=0), 0.1)
    errors = np.linalg.norm(apart[..., :2], axis=-1).max(axis=0) / way, np.abs(apart[..., 2]).max(axis=0) / turned
    found: npt.NDArray[np.float64] = np.maximum(*errors)
    return found


def measure(long: bool) -> list[tuple[str, str]]:
    """The figures of the table."""
    found = tally(31_250 if long else 30, progress=partial(tqdm, leave=False))
    return [
        ("random scenarios accepted, of so many tried", f"{found.accepted:,} of {found.tried:,}"),
        ("scenarios with finite values alone", share(found.accepted - found.not_finite, found.accepted)),
        ("worlds drawn from them that didn't diverge", share(found.worlds - found.diverged, found.worlds)),
        (f"worlds within 1 % of those with 1/{FINER[-1]} of the step", share(found.worlds - found.above, found.worlds)),
        ("largest difference", f"{100.0 * found.largest_error:.2g} %"),
    ]


def tally(scenarios: int, seed: int = 0, progress: Any = iter) -> Tally:
    """Fly that many accepted scenarios, `LANES` worlds each."""
    tried = not_finite = diverged = above = 0
    largest = 0.0
    for k in progress(range(scenarios)):
        generator = np.random.default_rng((seed, k))
        while True:
            tried += 1
            try:
                scenario = random_scenario(generator)
            except SettingError:
                continue
            # Steps so short that the finer flight would take minutes say nothing about the limit.
            if scenario.episode.substeps <= 2000:
                break
        held = generator.choice(np.array([-1.0, -0.3, 0.0, 0.3, 1.0], np.float32), (STEPS // 5, LANES, 3))
        actions = np.repeat(held, 5, axis=0)
        coarse, finite, bad = flown(scenario, actions, k)
        for finer in FINER:
            step = scenario.episode.control_period_s / scenario.episode.substeps / finer
            fine, fine_finite, _ = flown(scenario.merged({"episode": {"integration_step_s": step}}), actions, k)
            errors = relative_error(coarse, fine)
            finite &= fine_finite
            if not (errors > NEAR).any():
                break
        not_finite += not finite
        diverged += int(bad.sum())
        above += int((errors[~bad] > 0.01).sum())
        largest = max(largest, float(errors[~bad].max(initial=0.0)))
    return Tally(tried, scenarios, scenarios * LANES, not_finite, diverged, above, largest)

"""Searches for a controller's gains or a learner's settings, never on held-out seeds."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from uwoc_gym.agents import places
from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.agents.flight import batches, fly
from uwoc_gym.agents.learning.plans import Job, Wish
from uwoc_gym.agents.learning.search import Dimension, Evaluate
from uwoc_gym.agents.learning.seeds import ALL_VALIDATION, BATCH, VALIDATION, training_seed
from uwoc_gym.agents.learning.settings import TRAINABLE
from uwoc_gym.agents.work import Hands, Task, run_all
from uwoc_gym.agents.wrapping import PLAIN, Wrapping, wrapping
from uwoc_gym.baselines import Gains
from uwoc_gym.baselines.controllers import KINDS, GainSet, Tuned, one_for_each
from uwoc_gym.baselines.guidance import GuidanceGains
from uwoc_gym.baselines.lqr import RegulatorScales
from uwoc_gym.baselines.planner import PlannerSettings
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.given import as_number, closest, said_by, shown
from uwoc_gym.scenario import Scenario

Box = Mapping[str, Dimension]

_OWN: dict[type[Any], Box] = {
    GuidanceGains: {
        "pull_per_s": Dimension(0.05, 5.0, log=True),
        "fastest_pull_mps": Dimension(0.2, 8.0, log=True),
        "slow_mps": Dimension(0.01, 1.5, log=True),
        "facing": Dimension(0.0, 1.0),
        "turn_per_s": Dimension(0.3, 20.0, log=True),
        "fastest_turn_rad_s": Dimension(0.2, 6.0, log=True),
        "yaw_rate_per_s": Dimension(0.3, 40.0, log=True),
        "surge_per_s": Dimension(0.3, 40.0, log=True),
        "sway_per_s": Dimension(0.1, 40.0, log=True),
        "crab": Dimension(0.0, 1.5),
        "munk": Dimension(0.0, 1.5),
        "lead": Dimension(0.0, 1.0),
        "surge_yields": Dimension(0.0, 10.0),
        "sway_yields": Dimension(0.0, 20.0),
    },
    RegulatorScales: {
        "place_m": Dimension(0.01, 10.0, log=True),
        "heading_rad": Dimension(0.03, 10.0, log=True),
        "speed_mps": Dimension(0.03, 30.0, log=True),
        "yaw_rate_rad_s": Dimension(0.03, 30.0, log=True),
        "reach_m": Dimension(0.2, 20.0, log=True),
        "course": Dimension(0.0, 1.0),
    },
    PlannerSettings: {
        "horizon_s": Dimension(1.0, 8.0, log=True),
        "knots": Dimension(3.0, 16.0),
        "crowding": Dimension(0.7, 3.0),
        "finest": Dimension(0.001, 0.1, log=True),
        "coarsest": Dimension(0.2, 2.0, log=True),
        "left_alone": Dimension(0.0, 0.8),
        "temperature": Dimension(0.05, 20.0, log=True),
        "beyond_s": Dimension(0.0, 1.0),
        "radius_m": Dimension(0.1, 4.0, log=True),
        "per_metre": Dimension(2.0, 100.0, log=True),
    },
}
"""Where the numbers of laws that know the actuators' limits are searched for; a planner's effort isn't searched."""


SEARCHED = tuple(KINDS)
"""The laws whose gains can be searched for."""


def box_of(law: str, scenario: Scenario) -> dict[str, Dimension]:
    """Where a law's gains are searched for: PD gains, which are forces, in proportion to the actuators' limits."""
    kind = KINDS[law].gains
    if kind is not Gains:
        return dict(_OWN[kind])
    surge, sway, yaw = scenario.vehicle.force_limits
    push = max(surge, sway) or 1.0
    box = {
        "a_p_xy": Dimension(0.005 * push, 4.0 * push, log=True),
        "a_v_xy": Dimension(0.0025 * push, 2.0 * push, log=True),
        "a_p_yaw": Dimension(0.02 * (yaw or 1.0), 16.0 * (yaw or 1.0), log=True),
        "a_v_yaw": Dimension(0.01 * (yaw or 1.0), 8.0 * (yaw or 1.0), log=True),
    }
    if law.endswith("nlpd"):
        for axis in ("xy", "yaw"):
            box |= {f"b_{what}_{axis}": Dimension(0.003, 2.0, log=True) for what in ("p", "v")}
            box |= {f"mu_{what}_{axis}": Dimension(0.0, 1.0) for what in ("p", "v")}
    return box


def changed(box: Box, words: Sequence[str]) -> dict[str, Dimension]:
    """A box with other bounds, each said as ``name=low:high``; a search that is on a log scale stays so.

    Raises:
        CommandError: A word isn't of that form, there is no such number, or bounds aren't in order.
    """
    found = dict(box)
    for word in words:
        with naming(f"--box {word}"):
            parts = re.fullmatch(r"(\w+)=([^:]+):([^:]+)", word)
            low, high = (as_number(said_by(part)) for part in parts.groups()[1:]) if parts else (None, None)
            if parts is None or low is None or high is None or not low < high:
                raise CommandError("it must be name=low:high with low < high, such as a_p_xy=10:500.")
            name = parts[1]
            if name not in box:
                raise CommandError(f"there is no number {shown(name)}; {closest(name, box)}")
            if box[name].log and low <= 0.0:
                raise CommandError("the search is on a log scale, so that low must be above 0.")
            found[name] = Dimension(low, high, box[name].log)
    return found


_ON_POLICY = {
    "learning_rate": Dimension(1e-4, 3e-3, log=True),
    "gamma": Dimension(0.95, 0.995),
    "gae_lambda": Dimension(0.85, 0.99),
    "clip_range": Dimension(0.1, 0.4),
    "vf_coef": Dimension(0.02, 1.0, log=True),
    "policy_kwargs.log_std_init": Dimension(-2.0, 0.0),
}
_OFF_POLICY = {
    "learning_rate": Dimension(1e-4, 2e-3, log=True),
    "gamma": Dimension(0.95, 0.995),
    "tau": Dimension(0.002, 0.05, log=True),
}
LEARNERS: dict[str, Mapping[str, Dimension]] = {
    name: _ON_POLICY if name.endswith("ppo") else _OFF_POLICY for name in TRAINABLE
}
"""What is searched for each learner; all else stays as in its settings file."""


def gains_of(
    law: str, values: Mapping[str, float], source: str = "uwoc-gym tune", rest: GainSet | None = None
) -> Tuned:
    """The law with the gains of a point.

    Args:
        law: Its name.
        values: The point. Of a `Gains`, x and y share theirs, since no axis of the horizontal plane is special.
        source: Where they come from.
        rest: What holds where the point says nothing, by default the law's defaults.
    """
    if KINDS[law].gains is not Gains:
        whole: Any = rest or KINDS[law].gains()
        return Tuned(law, whole.merged(values), source)
    names = dict.fromkeys(key.rpartition("_")[0] for key in values)
    axes: dict[str, Any] = {name: (values[f"{name}_xy"], values[f"{name}_xy"], values[f"{name}_yaw"]) for name in names}
    return Tuned(law, Gains(**axes, source=source), source)


def point_of(gains: GainSet, box: Box) -> dict[str, float]:
    """The point of a gain set, inside the box."""
    point = {}
    for key, each in box.items():
        name, _, axis = key.rpartition("_")
        value = getattr(gains, name)[0 if axis == "xy" else 2] if isinstance(gains, Gains) else getattr(gains, key)
        point[key] = min(max(float(value), each.low), each.high)
    return point


def controller_score(
    law: str,
    scenario: Scenario,
    seed: int,
    episodes: int,
    crew: Hands,
    wrapper: Sequence[str] = (),
    rest: GainSet | None = None,
) -> Evaluate:
    """Mean return of a law's gain sets over training seeds, the same for every one.

    Args:
        law: Its name.
        scenario: What is flown.
        seed: The search's own, from which those of the episodes follow.
        episodes: How many.
        crew: Who flies.
        wrapper: What stands around the environments.
        rest: What holds where points say nothing, as in `gains_of`.
    """
    first = training_seed(seed)
    seeds = range(first, first + episodes)

    def evaluate(points: list[dict[str, float]]) -> list[tuple[float, dict[str, float]]]:
        each = -(-len(points) // min(crew.jobs, len(points)))
        tasks = [
            Task(scored, (law, points[i : i + each], rest, scenario, tuple(wrapper)), seeds, f"flying {law}")
            for i in range(0, len(points), each)
        ]
        with closing(run_all(tasks, crew)) as done:
            return [score for _, own in done for score in own]

    return evaluate


def scored(
    law: str,
    points: Sequence[Mapping[str, float]],
    rest: GainSet | None,
    scenario: Scenario,
    wrapper: Sequence[str],
    seeds: Sequence[int],
) -> list[tuple[float, dict[str, float]]]:
    """Mean return of gain sets over seeds, and what else they came to; all fly together if they can."""
    laws, around = [gains_of(law, point, rest=rest) for point in points], wrapping(wrapper)
    if KINDS[law].together:
        every = one_for_each([own for own in laws for _ in seeds])
        flown = _flown(every, scenario, [*seeds] * len(points), around)
    else:
        each = [_flown(own.policy(law), scenario, seeds, around) for own in laws]
        flown = {key: np.concatenate([own[key] for own in each]) for key in each[0]}
    means = {key: values.reshape(len(points), -1).mean(axis=1).tolist() for key, values in flown.items()}
    return [
        (means["return"][i], {key: values[i] for key, values in means.items() if key != "return"})
        for i in range(len(points))
    ]


def _flown(policy: Policy, scenario: Scenario, seeds: Sequence[int], wrapping: Wrapping) -> dict[str, Any]:
    flown = fly(policy, scenario, seeds, wrapping=wrapping).metrics
    return {"return": flown.return_, "availability": flown.availability, "effort": flown.effort}


def validation(
    law: Tuned, scenario: Scenario, episodes: int = len(VALIDATION), wrapping: Wrapping = PLAIN
) -> dict[str, float]:
    """The law's means on so many validation seeds, which the search hasn't seen."""
    policy = law.policy(law.law)
    flown = [_flown(policy, scenario, own, wrapping) for own in batches(ALL_VALIDATION[:episodes], BATCH)]
    return {f"validation_{key}": float(np.mean(np.concatenate([each[key] for each in flown]))) for key in flown[0]}


def learner_score(wish: Wish, folder: Path, crew: Hands) -> Evaluate:
    """Best validation return of short trainings, whose runs stay in the folder.

    Args:
        wish: What is trained; a point's values are assigned to its settings.
        folder: Holds a run per trial.
        crew: Who trains.
    """
    from uwoc_gym.agents.learning.training import train_one

    def job(number: int, point: Mapping[str, float]) -> Job:
        # The rate falls to 0 over the run, as in the settings files.
        values = [f"{key}={'lin_' if key == 'learning_rate' else ''}{value!r}" for key, value in point.items()]
        return Job(replace(wish, set=(*wish.set, *values)), places.address(folder / f"trial-{number:04d}"))

    def evaluate(points: list[dict[str, float]]) -> list[tuple[float, dict[str, float]]]:
        first = len(places.names(places.address(folder), "trial-"))
        tasks = [Task(train_one, (job(first + i, point),), name=f"trial {first + i}") for i, point in enumerate(points)]
        with closing(run_all(tasks, crew)) as done:
            best = [best for _, best in done]
        return [(float(each["return"]["mean"]), {"trial": float(first + i)}) for i, each in enumerate(best)]

    return evaluate

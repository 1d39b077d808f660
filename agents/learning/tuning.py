"""Searches for a controller's gains or a learner's settings, never on held-out seeds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from uwoc_gym.agents.flight import batches, fly
from uwoc_gym.agents.learning.plans import Job, Wish
from uwoc_gym.agents.learning.search import Dimension, Evaluate
from uwoc_gym.agents.learning.seeds import ALL_VALIDATION, BATCH, VALIDATION, training_seed
from uwoc_gym.agents.learning.settings import TRAINABLE
from uwoc_gym.agents.wrapping import PLAIN, Wrapping
from uwoc_gym.baselines import Gains
from uwoc_gym.baselines.controllers import GainSet, one_for_each
from uwoc_gym.baselines.guidance import GuidanceGains
from uwoc_gym.scenario import Scenario

PD_BOX = {
    "a_p_xy": Dimension(100.0, 8000.0, log=True),
    "a_v_xy": Dimension(50.0, 4000.0, log=True),
    "a_p_yaw": Dimension(100.0, 8000.0, log=True),
    "a_v_yaw": Dimension(50.0, 4000.0, log=True),
}
NLPD_BOX = PD_BOX | {
    f"{name}_{axis}": each
    for axis in ("xy", "yaw")
    for name, each in {
        "b_p": Dimension(0.003, 2.0, log=True),
        "b_v": Dimension(0.003, 2.0, log=True),
        "mu_p": Dimension(0.0, 1.0),
        "mu_v": Dimension(0.0, 1.0),
    }.items()
}

GUIDANCE_BOX = {
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
}

GAIN_BOXES: dict[str, Mapping[str, Dimension]] = {"pd": PD_BOX, "nlpd": NLPD_BOX, "los": GUIDANCE_BOX}
"""The controllers whose gains can be searched for, and where; their own gains are tried first."""

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


def gains_of(values: Mapping[str, float], source: str = "uwoc-gym tune") -> GainSet:
    """The gain set of a point: x and y share theirs, since no axis of the horizontal plane is special."""
    if values.keys() == GUIDANCE_BOX.keys():
        return GuidanceGains(**values)
    names = dict.fromkeys(key.rpartition("_")[0] for key in values)
    axes: dict[str, Any] = {name: (values[f"{name}_xy"], values[f"{name}_xy"], values[f"{name}_yaw"]) for name in names}
    return Gains(**axes, source=source)


def point_of(law: GainSet, box: Mapping[str, Dimension]) -> dict[str, float]:
    """The point of a gain set, inside the box."""
    point = {}
    for key, each in box.items():
        name, _, axis = key.rpartition("_")
        value = getattr(law, key) if isinstance(law, GuidanceGains) else getattr(law, name)[0 if axis == "xy" else 2]
        point[key] = min(max(float(value), each.low), each.high)
    return point


def controller_score(scenario: Scenario, seed: int, episodes: int, wrapping: Wrapping = PLAIN) -> Evaluate:
    """Mean return of gain sets over training seeds, all flown together; the same seeds for every one."""
    first = training_seed(seed)
    seeds = range(first, first + episodes)

    def evaluate(points: list[dict[str, float]]) -> list[tuple[float, dict[str, float]]]:
        laws = [gains_of(point) for point in points for _ in seeds]
        flown = _flown(laws, scenario, list(seeds) * len(points), wrapping)
        means = {key: values.reshape(len(points), -1).mean(axis=1).tolist() for key, values in flown.items()}
        return [
            (means["return"][i], {key: values[i] for key, values in means.items() if key != "return"})
            for i in range(len(points))
        ]

    return evaluate


def _flown(laws: list[GainSet], scenario: Scenario, seeds: list[int], wrapping: Wrapping) -> dict[str, Any]:
    flown = fly(one_for_each(laws), scenario, seeds, wrapping=wrapping).metrics
    return {"return": flown.return_, "availability": flown.availability, "effort": flown.effort}


def validation(
    law: GainSet, scenario: Scenario, episodes: int = len(VALIDATION), wrapping: Wrapping = PLAIN
) -> dict[str, float]:
    """The gain set's means on so many validation seeds, which the search hasn't seen."""
    flown = [
        _flown([law] * len(own), scenario, list(own), wrapping) for own in batches(ALL_VALIDATION[:episodes], BATCH)
    ]
    return {f"validation_{key}": float(np.mean(np.concatenate([each[key] for each in flown]))) for key in flown[0]}


def learner_score(wish: Wish, folder: Path) -> Evaluate:
    """Best validation return of a short training, whose run stays in the folder.

    Args:
        wish: What is trained; a point's values are assigned to its settings.
        folder: Holds a run per trial.
    """
    from uwoc_gym.agents.learning import training

    def one(point: Mapping[str, float]) -> tuple[float, dict[str, float]]:
        number = sum(1 for _ in folder.glob("trial-*"))
        # The rate falls to 0 over the run, as in the settings files.
        values = [f"{key}={'lin_' if key == 'learning_rate' else ''}{value!r}" for key, value in point.items()]
        job = Job(replace(wish, set=(*wish.set, *values)), folder / f"trial-{number:04d}")
        try:
            best = training.train(job.wish, job.folder, job.command).progress.best
        except training.Interruption:
            # The search ends as it does where it is interrupted itself.
            raise KeyboardInterrupt from None
        assert best is not None
        return float(best["return"]["mean"]), {"trial": float(number)}

    return lambda points: [one(point) for point in points]

"""`uwoc-gym tune`: search for the gains of a controller or the settings of a learner, never on held-out seeds."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from uwoc_gym.agents.commands import train
from uwoc_gym.agents.flight import Flight, Policy, fly, load_scenario
from uwoc_gym.agents.learning.search import Dimension, Evaluate, add_search_arguments, search
from uwoc_gym.agents.learning.seeds import VALIDATION, training_seed
from uwoc_gym.agents.learning.settings import TRAINABLE
from uwoc_gym.agents.options import naming, output_folder, require, whole, write_text
from uwoc_gym.agents.reports import tables as report
from uwoc_gym.baselines import Controller, Gains, gains
from uwoc_gym.scenario import Scenario

HELP = "search for a controller's gains on training seeds, or for a learner's settings by what it scores in validation"
EXAMPLES = """\
examples:
  uwoc-gym tune nlpd --out tuning/nlpd
  uwoc-gym tune pd --trials 500 --out tuning/pd
  uwoc-gym tune ppo --trials 30 --steps 1000000 --out tuning/ppo
  uwoc-gym tune nlpd --trials 3000 --out tuning/nlpd --resume
"""

CONTROLLERS: dict[str, str] = {"pd": "paper-pd", "nlpd": "paper"}
"""The controllers whose gains can be searched for, and the gain set that is tried first."""

_PD_BOX = {
    "a_p_xy": Dimension(100.0, 8000.0, log=True),
    "a_v_xy": Dimension(50.0, 4000.0, log=True),
    "a_p_yaw": Dimension(100.0, 8000.0, log=True),
    "a_v_yaw": Dimension(50.0, 4000.0, log=True),
}
_NLPD_BOX = _PD_BOX | {
    f"{name}_{axis}": each
    for axis in ("xy", "yaw")
    for name, each in {
        "b_p": Dimension(0.003, 2.0, log=True),
        "b_v": Dimension(0.003, 2.0, log=True),
        "mu_p": Dimension(0.0, 1.0),
        "mu_v": Dimension(0.0, 1.0),
    }.items()
}

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("target", choices=(*CONTROLLERS, *LEARNERS), help="what to tune")
    parser.add_argument(
        "--scenario", default="uwoc/Random-v0", metavar="SCENARIO",
        help="what a controller is tuned on: a name, environment ID or .json file (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--env", default="uwoc/Random-v0", metavar="ID", help="what a learner is tuned on (default: %(default)s)"
    )
    parser.add_argument(
        "--trials", type=whole(1), metavar="N", help="points to try in all (default: 2000; learners 30)"
    )
    parser.add_argument(
        "--batch", type=whole(1), default=16, metavar="N", help="gain sets to fly at a time (default: %(default)s)"
    )
    parser.add_argument(
        "--episodes", type=whole(1), default=64, metavar="N",
        help="training seeds that every gain set is flown on (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--steps",
        type=whole(1),
        default=1_000_000,
        metavar="N",
        help="steps of a learner's trial (default: %(default)s)",
    )
    add_search_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Search and report; returns the exit status."""
    require("optuna", "cmaes", "tqdm")
    controller = args.target in CONTROLLERS
    folder = output_folder(args.out)
    problem: dict[str, Any] = {"target": args.target, "seed": args.seed}
    begin: list[dict[str, float]] = []
    if controller:
        with naming("--scenario"):
            name, task = load_scenario(args.scenario)
        scenario: Scenario | None = task
        box: Mapping[str, Dimension] = _PD_BOX if args.target == "pd" else _NLPD_BOX
        evaluate = controller_score(task, args.seed, args.episodes)
        problem |= {"scenario": task.to_dict(), "episodes": args.episodes}
        begin = [_point(gains(CONTROLLERS[args.target]), box)]
    else:
        name, box = args.env, LEARNERS[args.target]
        from uwoc_gym.agents.learning import environments as vec_env

        scenario = vec_env.base_scenario(args.env)
        evaluate = _learner_score(args, folder)
        problem |= {"env": args.env, "steps": args.steps}
    found = search(
        folder,
        problem,
        box,
        evaluate,
        trials=args.trials or (2000 if controller else 30),
        batch=args.batch if controller else 1,
        seed=args.seed,
        direction="maximize",
        sampler="cma-es" if controller else "tpe",
        begin=begin,
        resume=args.resume,
    )
    best = found.best
    document: dict[str, Any] = {
        "finished": found.finished,
        **problem,
        "space": {key: each._asdict() for key, each in box.items()},
        "trials": found.trials,
        "score": best.score,
        "found": best.values,
        "outcome": best.outcome,
    }
    if controller:
        law = gains_of(best.values, args.command_line)
        document["validation"] = _validation(law, task)
        write_text(folder / "gains.json", report.json_text(asdict(law)))
    else:
        trial = folder / f"trial-{int(best.outcome['trial']):04d}"
        write_text(folder / "settings.yaml", (trial / "settings.yaml").read_text(encoding="utf-8"))
    report.write_results(folder, args.command_line, {name: scenario}, document)
    print(f"{args.target} on {name}: score {best.score:.6g} after {found.trials} trials; found:")
    for key, value in {**best.values, **best.outcome, **document.get("validation", {})}.items():
        print(f"  {key:<28} {value:.6g}")
    if not found.finished:
        print("uwoc-gym tune: interrupted; --resume goes on", file=sys.stderr)
        return 130
    return 0


def gains_of(values: Mapping[str, float], source: str = "uwoc-gym tune") -> Gains:
    """The gain set of a point: x and y share theirs, since no axis of the horizontal plane is special."""
    names = dict.fromkeys(key.rpartition("_")[0] for key in values)
    axes: dict[str, Any] = {name: (values[f"{name}_xy"], values[f"{name}_xy"], values[f"{name}_yaw"]) for name in names}
    return Gains(**axes, source=source)


def _point(law: Gains, box: Mapping[str, Dimension]) -> dict[str, float]:
    """The point of a gain set, inside the box."""
    point = {}
    for key, each in box.items():
        name, _, axis = key.rpartition("_")
        value = float(getattr(law, name)[0 if axis == "xy" else 2])
        point[key] = min(max(value, each.low), each.high)
    return point


def controller_score(scenario: Scenario, seed: int, episodes: int) -> Evaluate:
    """Mean return of gain sets over training seeds, all flown together; the same seeds for every one."""
    first = training_seed(seed)
    seeds = range(first, first + episodes)

    def evaluate(points: list[dict[str, float]]) -> list[tuple[float, dict[str, float]]]:
        laws = [gains_of(point) for point in points for _ in seeds]
        flown = _flown(laws, scenario, list(seeds) * len(points))
        means = {key: values.reshape(len(points), -1).mean(axis=1).tolist() for key, values in flown.items()}
        return [
            (means["return"][i], {key: values[i] for key, values in means.items() if key != "return"})
            for i in range(len(points))
        ]

    return evaluate


def _flown(laws: list[Gains], scenario: Scenario, seeds: list[int]) -> dict[str, Any]:
    policy = Policy("candidates", "one gain set per simulation", lambda known: Controller(laws, known))
    flight: Flight = fly(policy, scenario, seeds)
    flown = flight.metrics
    return {"return": flown.return_, "availability": flown.availability, "effort": flown.effort}


def _validation(law: Gains, scenario: Scenario) -> dict[str, float]:
    """The gain set's means on the validation seeds, which the search hasn't seen."""
    flown = _flown([law] * len(VALIDATION), scenario, list(VALIDATION))
    return {f"validation_{key}": float(np.mean(values)) for key, values in flown.items()}


def _learner_score(args: argparse.Namespace, folder: Path) -> Evaluate:
    """Best validation return of a short training, whose run stays in the folder."""
    parser = argparse.ArgumentParser()
    train.add_arguments(parser)

    def one(point: Mapping[str, float]) -> tuple[float, dict[str, float]]:
        number = sum(1 for _ in folder.glob("trial-*"))
        words = ["--algorithm", args.target, "--env", args.env, "--steps", str(args.steps), "--seed", str(args.seed)]
        words += ["--out", str(folder / f"trial-{number:04d}")]
        for key, value in point.items():
            # The rate falls to 0 over the run, as in the settings files.
            words += ["--set", f"{key}={'lin_' if key == 'learning_rate' else ''}{value!r}"]
        given = parser.parse_args(words)
        given.command_line = " ".join(["uwoc-gym train", *words])
        status = train.run(given)
        if status != 0:
            raise KeyboardInterrupt
        best = json.loads((folder / f"trial-{number:04d}" / "results.json").read_text(encoding="utf-8"))["best"]
        return float(best["return"]["mean"]), {"trial": float(number)}

    def evaluate(points: list[dict[str, float]]) -> list[tuple[float, dict[str, float]]]:
        return [one(point) for point in points]

    return evaluate

"""`uwoc-gym tune`: search for the gains of a controller or the settings of a learner, never on held-out seeds."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from uwoc_gym.agents import interrupts, places
from uwoc_gym.agents.cluster import workers
from uwoc_gym.agents.errors import CommandError, naming, require
from uwoc_gym.agents.flight import check_flights
from uwoc_gym.agents.learning import tuning
from uwoc_gym.agents.learning.plans import Wish, planned
from uwoc_gym.agents.learning.search import Dimension, Found, search
from uwoc_gym.agents.learning.seeds import ALL_VALIDATION, VALIDATION
from uwoc_gym.agents.options import (
    add_scenario_arguments,
    add_search_arguments,
    add_work_arguments,
    add_wrapper_argument,
    whole,
    wrapping_of,
)
from uwoc_gym.agents.policies.registry import GAINS_FILE, gains_of_file, gains_path
from uwoc_gym.agents.reports import files
from uwoc_gym.agents.scenarios import said
from uwoc_gym.baselines.controllers import CONTROLLERS, KINDS, Tuned, begun
from uwoc_gym.given import shown

HELP = "search for a controller's gains on training seeds, or for a learner's settings by what it scores in validation"
BATCH = 16
"""Gain sets that are flown at a time."""

EXAMPLES = """\
examples:
  uwoc-gym tune nlpd --out tuning/nlpd
  uwoc-gym tune pd --trials 500 --override sea.current.speed_mps=0.3 --out tuning/pd
  uwoc-gym tune pd --trials 200 --wrapper gymnasium.wrappers:DelayObservation,delay=2 --episodes 16 --out tuning/late
  uwoc-gym tune ppo --trials 30 --steps 1000000 --out tuning/ppo
  uwoc-gym tune nlpd --trials 3000 --out tuning/nlpd --resume
  uwoc-gym tune ekf-nlpd --scenario Tide --begin nlpd-tuned --box a_p_xy=5:500 --out tuning/ekf-nlpd
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("target", choices=(*tuning.SEARCHED, *tuning.LEARNERS), help="what to tune")
    add_scenario_arguments(parser, None, "what it is tuned on, by default Random: ")
    parser.add_argument(
        "--begin",
        metavar="GAINS",
        help="what a law's search begins at: a controller's name, a search's folder or a .json file of gains (default: "
        "the law's own)",
    )
    parser.add_argument(
        "--box",
        nargs="+",
        default=[],
        metavar="NAME=LOW:HIGH",
        help="bounds of a law's numbers instead of the usual ones, such as a_p_xy=10:500",
    )
    add_wrapper_argument(parser)
    parser.add_argument("--env", metavar="ID", help="an environment of another package that a learner is tuned on")
    parser.add_argument(
        "--trials", type=whole("trials"), metavar="N", help="points to try in all (default: 2000; learners 30)"
    )
    parser.add_argument(
        "--batch",
        type=whole("episodes at a time"),
        metavar="N",
        help="points that are drawn before the first of them is known, which the search's course hangs on (default: "
        f"{BATCH}; learners 1)",
    )
    parser.add_argument(
        "--episodes", type=whole("episodes at a time"), default=64, metavar="N",
        help="training seeds that every gain set is flown on (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument(
        "--eval-episodes",
        type=whole("seeds", low=2, high=len(ALL_VALIDATION)),
        metavar="N",
        help=f"validation seeds: those that the best gains are flown on in the end (default: {len(VALIDATION)}), or "
        "that each validation of a learner takes (default: 32)",
    )
    parser.add_argument(
        "--steps",
        type=whole("steps"),
        default=1_000_000,
        metavar="N",
        help="steps of a learner's trial (default: %(default)s)",
    )
    add_work_arguments(parser, "flights or trainings at a time")
    add_search_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Search and report; returns the exit status."""
    require("optuna", "cmaes", "tqdm")
    found = _gains(args) if args.target in tuning.SEARCHED else _settings(args)
    if not found.finished:
        print("uwoc-gym tune: interrupted; --resume goes on", file=sys.stderr)
        return interrupts.status()
    return 0


def _gains(args: argparse.Namespace) -> Found:
    if args.env is not None:
        raise CommandError(f"--env is not allowed for {args.target}, a controller; give --scenario.")
    name, _, _, scenario = said("Random" if args.scenario is None else args.scenario, args.override)
    around = wrapping_of(args)
    start = _begun(args)
    batch = args.batch or BATCH
    together = batch if KINDS[args.target].together else 1
    check_flights([start.policy(args.target)], {name: scenario}, together * args.episodes, around)
    box = tuning.changed(tuning.box_of(args.target, scenario), args.box)
    folder = files.output_folder(args.out)
    problem = {
        "target": args.target, "seed": args.seed, "scenario": scenario.to_dict(), "episodes": args.episodes,
        # Searches of earlier versions know of none, and go on.
        **({"wrappers": around.plain()} if around else {}),
        **({"begin": start.to_dict()} if args.begin is not None else {}),
    }  # fmt: skip
    with files.locked(folder), workers(args.jobs, args.on) as crew:
        found = search(
            folder,
            problem,
            box,
            tuning.controller_score(args.target, scenario, args.seed, args.episodes, crew, args.wrapper, start.gains),
            trials=args.trials or 2000,
            batch=batch,
            seed=args.seed,
            direction="maximize",
            sampler="cma-es",
            begin=[tuning.point_of(start.gains, box)],
            resume=args.resume,
        )
    law = tuning.gains_of(args.target, found.best.values, args.command_line, start.gains)
    episodes = args.eval_episodes or len(VALIDATION)
    validation = tuning.validation(law, scenario, episodes, around)
    files.write_json(folder / GAINS_FILE, law.to_dict())
    document = {**_document(problem, box, found), "validation_episodes": episodes, "validation": validation}
    files.write_results(folder, args.command_line, {name: scenario}, document)
    _show(args.target, name, found, validation)
    return found


def _begun(args: argparse.Namespace) -> Tuned:
    """What the search begins at: the law's own gains, or those that were said, of any law that is set by as much."""
    kind = KINDS[args.target].gains
    if args.begin is None:
        return begun(args.target)
    with naming("--begin"):
        if args.begin in CONTROLLERS:
            found = begun(args.begin)
        else:
            path = gains_path(places.local(args.begin))
            if path is None:
                raise CommandError(
                    f"there are no gains {shown(args.begin)}; give a controller that uwoc-gym list shows, the folder "
                    "of a search, or a .json file of gains."
                )
            found = gains_of_file(path)
        if not isinstance(found.gains, kind):
            raise CommandError(
                f"{shown(args.begin)} holds {type(found.gains).__name__}; {args.target} is set by {kind.__name__}."
            )
    return Tuned(args.target, found.gains, found.source)


def _settings(args: argparse.Namespace) -> Found:
    for option, given in (("--begin", args.begin), ("--box", args.box)):
        if given:
            raise CommandError(f"{option} is not allowed for {args.target}, a learner; it is for controllers.")
    require("yaml", "stable_baselines3", "tensorboard", "matplotlib")
    folder = Path(args.out)
    wish = Wish(
        algorithm=args.target,
        env=args.env,
        scenario=args.scenario,
        override=tuple(args.override or ()),
        wrapper=tuple(args.wrapper),
        eval_episodes=args.eval_episodes,
        steps=args.steps,
        seed=args.seed,
    )
    plan = planned(wish)
    files.output_folder(folder)
    box = tuning.LEARNERS[args.target]
    problem: dict[str, Any] = {"target": args.target, "seed": args.seed, "env": plan.env_id, "steps": args.steps}
    if plan.task is not None and (plan.name != plan.env_id or plan.overrides):
        problem["scenario"] = plan.task.to_dict()
    if plan.wrapping.words:
        problem["wrappers"] = plan.wrapping.plain()
    with files.locked(folder), workers(args.jobs, args.on) as crew:
        found = search(
            folder,
            problem,
            box,
            tuning.learner_score(wish, folder, crew),
            trials=args.trials or 30,
            batch=args.batch or 1,
            seed=args.seed,
            direction="maximize",
            sampler="tpe",
            resume=args.resume,
        )
    # Whoever trained has put it back where it belongs.
    best = places.local(places.address(folder / f"trial-{int(found.best.outcome['trial']):04d}"))
    files.copy(best / "settings.yaml", folder / "settings.yaml")
    files.write_results(folder, args.command_line, {plan.name: plan.task}, _document(problem, box, found))
    _show(args.target, plan.name, found, {})
    return found


def _document(problem: Mapping[str, Any], box: Mapping[str, Dimension], found: Found) -> dict[str, Any]:
    return {
        "finished": found.finished,
        **problem,
        "space": {key: each._asdict() for key, each in box.items()},
        "trials": found.trials,
        "score": found.best.score,
        "found": found.best.values,
        "outcome": found.best.outcome,
    }


def _show(target: str, name: str, found: Found, validation: Mapping[str, float]) -> None:
    print(f"{target} on {name}: score {found.best.score:.6g} after {found.trials} trials; found:")
    for key, value in {**found.best.values, **found.best.outcome, **validation}.items():
        print(f"  {key:<28} {value:.6g}")

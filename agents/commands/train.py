"""`uwoc-gym train`: train an agent, watch it learn, and keep the best model."""

from __future__ import annotations

import argparse
import shlex
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

from uwoc_gym.agents import places
from uwoc_gym.agents.errors import require
from uwoc_gym.agents.learning.plans import DEFAULT_ENV, Wish
from uwoc_gym.agents.learning.seeds import ALL_VALIDATION, RUNS
from uwoc_gym.agents.learning.settings import TRAINABLE
from uwoc_gym.agents.options import add_scenario_arguments, add_trust_argument, add_wrapper_argument, number, whole
from uwoc_gym.agents.policies import saved
from uwoc_gym.agents.policies.registry import MAY_BE
from uwoc_gym.agents.reports import files

HELP = "train an agent with Stable-Baselines3 and keep its best model"
EXAMPLES = """\
examples:
  uwoc-gym train --algorithm ppo --env uwoc/Random-v0 --out runs/ppo
  uwoc-gym train --resume --out runs/ppo
  uwoc-gym train --algorithm sac --steps 200000 --set policy_kwargs.net_arch=[64,64] --set learning_rate=lin_1e-3 \\
      --out runs/sac
  uwoc-gym train --scenario Random --override 'vehicle.mass_scale=[0.7, 1.3]' --out runs/heavy
  uwoc-gym train --residual nlpd --scale 0.3 --frame-stack 3 --seed 1 --out runs/residual
  uwoc-gym train --residual runs/ppo --scale 0.3 --wrapper gymnasium.wrappers:DelayObservation,delay=2 --out runs/late
  uwoc-gym benchmark --policy nlpd runs/ppo --scenario Random
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--algorithm", metavar="NAME", help=f"one of {', '.join(TRAINABLE)} (default: ppo)")
    parser.add_argument(
        "--env", metavar="ID", help=f"environment ID or module:ID, also of other packages (default: {DEFAULT_ENV})"
    )
    add_scenario_arguments(parser, None, "in place of --env, ")
    add_wrapper_argument(parser)
    add_trust_argument(parser)
    parser.add_argument(
        "--out", required=True, metavar="DIR", help="folder of the run: model.zip, results.json and all"
    )
    parser.add_argument("--resume", action="store_true", help="go on with the run in --out from its last checkpoint")
    parser.add_argument("--seed", type=whole("seed", high=RUNS - 1), metavar="S", help="the run's seed (default: 0)")
    parser.add_argument(
        "--steps", type=whole("steps"), metavar="N", help="steps in all (default: the settings' n_timesteps)"
    )
    parser.add_argument(
        "--envs", type=whole("environments"), metavar="N", help="environments (default: the settings' n_envs)"
    )
    parser.add_argument(
        "--set", action="append", default=[], metavar="KEY=VALUE",
        help="override a setting, such as policy_kwargs.net_arch=[64,64]",
    )  # fmt: skip
    parser.add_argument("--settings", metavar="FILE", help="settings file (default: the package's for the algorithm)")
    parser.add_argument(
        "--residual",
        metavar="POLICY",
        help=f"what the agent corrects: {MAY_BE}",
    )
    parser.add_argument(
        "--scale", type=number("residual scale"), metavar="X", help="what an action of 1 adds, up to 2 (default: 0.5)"
    )
    parser.add_argument(
        "--frame-stack", type=whole("frames in a row"), metavar="N", help="observations in a row that the agent sees"
    )
    parser.add_argument("--eval-every", type=whole("steps"), metavar="N", help="steps (default: a twentieth of all)")
    parser.add_argument(
        "--eval-episodes",
        type=whole("seeds", low=2, high=len(ALL_VALIDATION)),
        metavar="N",
        help="episodes of an evaluation (default: 32)",
    )
    parser.add_argument("--checkpoint-every", type=whole("steps"), metavar="N", help="steps (default: as --eval-every)")
    parser.add_argument(
        "--threads", type=whole("threads"), default=1, metavar="N", help="threads of PyTorch (default: %(default)s)"
    )


def run(args: argparse.Namespace) -> int:
    """Train and report; returns the exit status."""
    require("yaml", "stable_baselines3", "tensorboard", "tqdm", "matplotlib")
    from uwoc_gym.agents.learning import training

    several = {name: tuple(getattr(args, name) or ()) for name in ("set", "override", "wrapper")}
    wish = Wish(**{field.name: getattr(args, field.name) for field in fields(Wish)} | several)
    folder = files.output_folder(args.out)
    already = training.finished(folder)
    try:
        made = training.train(wish, folder, args.command_line, args.resume, args.threads, tell=_tell)
    except training.Interruption as stop:
        trust = " --trust" if wish.names_code else ""
        out = shlex.quote(places.address(Path(args.out)))
        print(f"uwoc-gym train: {stop}; go on with: uwoc-gym train --resume{trust} --out {out}", file=sys.stderr)
        return stop.status
    if already:
        print(f"uwoc-gym train: the run in {places.address(folder)} is finished", file=sys.stderr)
        return 0
    best = made.progress.best
    assert best is not None
    learned = "anything" if made.plan.values["teacher"] is None else "from rewards"
    untrained = f", before it had learned {learned}" if best["steps"] == 0 else ""
    model = places.address(folder / saved.MODEL)
    print(f"best model, at step {best['steps']:,} of {made.progress.steps:,}{untrained}: {model}")
    for name, scores in {"agent": best, **made.baselines}.items():
        print(f"  {name}: " + ", ".join(_score(key, scores) for key in ("return", "availability") if key in scores))
    return 0


def _tell(line: str) -> None:
    print(f"uwoc-gym train: {line}" if not line.startswith(" ") else line, file=sys.stderr, flush=True)


def _score(key: str, scores: dict[str, Any]) -> str:
    return f"{key} {scores[key]['mean']:.4g}"

"""`uwoc-gym train`: train an agent, watch it learn, and keep the best model."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from uwoc_gym.agents.flight import POLICIES
from uwoc_gym.agents.learning import settings as hyperparameters
from uwoc_gym.agents.learning.seeds import VALIDATION, training_seed
from uwoc_gym.agents.learning.settings import ALGORITHMS, TRAINABLE
from uwoc_gym.agents.options import CommandError, output_folder, require, whole
from uwoc_gym.baselines import GAINS, Gains, gains
from uwoc_gym.parameters import SettingError, closest

HELP = "train an agent with Stable-Baselines3 and keep its best model"
EXAMPLES = """\
examples:
  uwoc-gym train --algorithm ppo --env uwoc/Random-v0 --out runs/ppo
  uwoc-gym train --resume --out runs/ppo
  uwoc-gym train --algorithm sac --steps 200000 --set policy_kwargs.net_arch=[64,64] --set learning_rate=lin_1e-3 \\
      --out runs/sac
  uwoc-gym train --residual nlpd --scale 0.3 --frame-stack 3 --seed 1 --out runs/residual
  uwoc-gym benchmark --policy nlpd runs/ppo --scenario Random
"""

PERIODS = ("control_period_s", "integration_step_s")
"""The arguments of our environments, besides ``scenario``, that settings may hold."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--algorithm", metavar="NAME", help=f"one of {', '.join(TRAINABLE)} (default: ppo)")
    parser.add_argument("--env", metavar="ID", help="environment ID or module:ID (default: uwoc/Random-v0)")
    parser.add_argument(
        "--out", required=True, metavar="DIR", help="folder of the run: model.zip, results.json and all"
    )
    parser.add_argument("--resume", action="store_true", help="go on with the run in --out from its last checkpoint")
    parser.add_argument("--seed", type=whole(0), metavar="S", help="the run's seed (default: 0)")
    parser.add_argument("--steps", type=whole(1), metavar="N", help="steps in all (default: the settings' n_timesteps)")
    parser.add_argument("--envs", type=whole(1), metavar="N", help="environments (default: the settings' n_envs)")
    parser.add_argument(
        "--set", action="append", metavar="KEY=VALUE", help="override a setting, such as policy_kwargs.net_arch=[64,64]"
    )
    parser.add_argument("--settings", metavar="FILE", help="settings file (default: the package's for the algorithm)")
    parser.add_argument(
        "--scenario", metavar="JSON", help="overrides of the environment's scenario: a .json file or the text itself"
    )
    parser.add_argument(
        "--residual", metavar="CONTROLLER", help="correct a controller: pd, nlpd, a gain set or a .json file of gains"
    )
    parser.add_argument("--scale", type=float, metavar="X", help="what an action of 1 adds, in (0, 2] (default: 0.5)")
    parser.add_argument("--frame-stack", type=whole(1), metavar="N", help="observations in a row that the agent sees")
    parser.add_argument("--eval-every", type=whole(1), metavar="N", help="steps (default: a twentieth of all)")
    parser.add_argument("--eval-episodes", type=whole(2), metavar="N", help="episodes of an evaluation (default: 32)")
    parser.add_argument("--checkpoint-every", type=whole(1), metavar="N", help="steps (default: as --eval-every)")
    parser.add_argument(
        "--threads", type=whole(1), default=1, metavar="N", help="threads of PyTorch (default: %(default)s)"
    )


def run(args: argparse.Namespace) -> int:
    """Train and report; returns the exit status."""
    require("yaml", "stable_baselines3", "tensorboard", "tqdm", "matplotlib")
    import torch

    from uwoc_gym.agents.learning import checkpoints as checkpoint
    from uwoc_gym.agents.learning import training

    # Networks this small gain nothing from more, and runs side by side get in each other's way.
    torch.set_num_threads(args.threads)
    recorded = _recorded(Path(args.out), args.resume)
    plan = _plan(args, recorded)
    if recorded is not None:
        _check_same(plan.to_dict(), recorded, Path(args.out))
    folder = output_folder(args.out)
    last = checkpoint.newest(folder) if args.resume else None
    try:
        made = training.Run(plan, folder, args.command_line, last)
        if made.progress.finished:
            print(f"uwoc-gym train: the run in {folder} is finished", file=sys.stderr)
            return 0
        made.train()
    except training.Interruption as stop:
        print(
            f"uwoc-gym train: interrupted at step {stop.steps}; go on with: uwoc-gym train --resume --out {args.out}",
            file=sys.stderr,
        )
        return stop.status
    best = made.progress.best
    assert best is not None
    print(f"best model, at step {best['steps']}: {folder / 'model.zip'}")
    for name, scores in {"agent": best, **made.baselines}.items():
        print(f"  {name}: " + ", ".join(_score(key, scores) for key in ("return", "availability") if key in scores))
    return 0


def planned(words: Sequence[str]) -> dict[str, Any]:
    """What a training with these command-line arguments would be, as it stands in its run.json.

    Raises:
        CommandError: An argument isn't allowed.
    """
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    found: dict[str, Any] = json.loads(json.dumps(_plan(parser.parse_args(words), None).to_dict()))
    return found


def _score(key: str, scores: dict[str, Any]) -> str:
    return f"{key} {scores[key]['mean']:.4g}"


def _recorded(folder: Path, resume: bool) -> dict[str, Any] | None:
    """What the run in the folder says it is; None if there is none."""
    path = folder / "run.json"
    if not path.is_file():
        if resume:
            raise CommandError(f"--resume: there is no run in {folder}; it has no run.json.")
        return None
    if not resume:
        raise CommandError(f"--out {folder} holds a run already; give --resume to go on with it, or another folder.")
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        found["settings"], found["env"], found["algorithm"]
    except (ValueError, KeyError, TypeError):
        raise CommandError(f"--resume: {path} doesn't describe a run.") from None
    return dict(found)


def _plan(args: argparse.Namespace, recorded: dict[str, Any] | None) -> Any:
    known = recorded or {}
    algorithm = args.algorithm or known.get("algorithm", "ppo")
    if algorithm not in TRAINABLE:
        raise CommandError(f"--algorithm {algorithm!r} is not allowed; {closest(algorithm, TRAINABLE)}")
    require(ALGORITHMS[algorithm].module)
    env_id = args.env or known.get("env", "uwoc/Random-v0")
    seed = args.seed if args.seed is not None else known.get("seed", 0)
    training_seed(seed)
    from uwoc_gym.agents.learning import environments as vec_env
    from uwoc_gym.agents.learning import training

    base = vec_env.base_scenario(env_id)
    own_file = Path(args.settings) if args.settings else None
    if recorded is not None and own_file is None and recorded["algorithm"] == algorithm and recorded["env"] == env_id:
        values = hyperparameters.checked(algorithm, recorded["settings"], "run.json")
    else:
        values, _ = hyperparameters.resolve(algorithm, env_id, path=own_file)
    values = _overridden(args, algorithm, values)
    found = _gains(values["residual"])
    overrides = _scenario_overrides(args.scenario) if args.scenario is not None else known.get("overrides", {})
    task = _task(base, overrides, values)
    if task is None:
        for key, given in (("--scenario", overrides), ("residual", values["residual"])):
            if given:
                raise CommandError(f"{key} is not allowed for {env_id!r}, which isn't one of this package's.")
    episodes = args.eval_episodes or known.get("eval_episodes", 32)
    if episodes > len(VALIDATION):
        raise CommandError(f"--eval-episodes {episodes} is not allowed; there are {len(VALIDATION)} validation seeds.")
    every = args.eval_every or known.get("eval_every", max(values["n_timesteps"] // 20, 1))
    plan = training.Plan(
        algorithm=algorithm,
        env_id=env_id,
        seed=seed,
        values=values,
        task=task,
        overrides=overrides,
        gains=found,
        eval_every=every,
        eval_episodes=episodes,
        checkpoint_every=args.checkpoint_every or known.get("checkpoint_every", every),
    )
    try:
        _ = plan.practice
    except SettingError as error:
        raise CommandError(f"env_kwargs.scenario is not allowed: {error}") from None
    return plan


def _overridden(args: argparse.Namespace, algorithm: str, values: dict[str, Any]) -> dict[str, Any]:
    values = hyperparameters.assigned(algorithm, values, args.set or [])
    given = {
        "n_timesteps": args.steps,
        "n_envs": args.envs,
        "residual": _gain_file(args.residual),
        "residual_scale": args.scale,
        "frame_stack": args.frame_stack,
    }
    return hyperparameters.checked(
        algorithm, values | {key: value for key, value in given.items() if value is not None}, "option"
    )


def _gain_file(name: str | None) -> Any:
    if name is None or not name.endswith(".json"):
        return name
    try:
        found = json.loads(Path(name).read_text(encoding="utf-8"))
    except OSError as error:
        raise CommandError(f"--residual {name!r} can't be read: {error.strerror}.") from None
    except ValueError as error:
        raise CommandError(f"--residual {name!r} isn't valid JSON: {error}") from None
    if not isinstance(found, dict):
        raise CommandError(f"--residual {name!r} must hold an object of gains.")
    return found


def _gains(given: Any) -> Gains | None:
    """The gains of the controller that is corrected."""
    if given is None:
        return None
    try:
        if isinstance(given, dict):
            return Gains(**given)
        controllers = {name: policy.gain_set for name, policy in POLICIES.items() if policy.gain_set}
        if given in controllers:
            return gains(str(controllers[given]))
        if given not in GAINS:
            raise CommandError(f"residual = {given!r} is not allowed; {closest(given, [*controllers, *GAINS])}")
        return gains(given)
    except (SettingError, TypeError) as error:
        raise CommandError(f"residual = {given!r} is not allowed: {error}") from None


def _task(base: Any, overrides: dict[str, Any], values: dict[str, Any]) -> Any:
    """The scenario to evaluate in: the environment's with what is given merged in."""
    if base is None:
        return None
    try:
        base = base.merged(overrides)
    except SettingError as error:
        raise CommandError(f"--scenario: {error}") from None
    given = dict(values["env_kwargs"])
    given.pop("scenario", None)
    for key in given:
        if key not in PERIODS:
            raise CommandError(f"env_kwargs has {key!r}, which is not known; {closest(key, ['scenario', *PERIODS])}")
    try:
        return base.merged({"episode": given})
    except SettingError as error:
        raise CommandError(f"env_kwargs: {error}") from None


def _scenario_overrides(given: str) -> dict[str, Any]:
    text = given
    if not given.lstrip().startswith("{"):
        try:
            text = Path(given).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise CommandError(f"--scenario {given!r} can't be read: {error}") from None
    try:
        found = json.loads(text)
    except ValueError as error:
        raise CommandError(f"--scenario {given!r} isn't valid JSON: {error}") from None
    if not isinstance(found, dict):
        raise CommandError(f"--scenario {given!r} must be a JSON object.")
    return found


def _check_same(wanted: dict[str, Any], recorded: dict[str, Any], folder: Path) -> None:
    """Refuse to go on with a run under other settings than those it was begun with."""
    # Through JSON, which knows no tuples.
    plain = json.loads(json.dumps(wanted))
    for key in ("algorithm", "env", "seed"):
        if plain[key] != recorded.get(key):
            raise CommandError(f"--resume: the run in {folder} has {key} = {recorded.get(key)!r}, not {plain[key]!r}.")
    for key in plain["settings"] | recorded["settings"]:
        old, new = recorded["settings"].get(key), plain["settings"].get(key)
        if old != new:
            raise CommandError(f"--resume: the run in {folder} has {key} = {old!r}, not {new!r}; begin another run.")
    if plain["scenario"] != recorded.get("scenario"):
        raise CommandError(f"--resume: the run in {folder} has another scenario; leave out --scenario.")
    if plain["eval_episodes"] != recorded.get("eval_episodes"):
        raise CommandError(f"--resume: the run in {folder} has --eval-episodes {recorded.get('eval_episodes')}.")

"""`uwoc-gym protocol`: train groups of agents from several seeds, fly all held-out seeds, and say who is better."""

from __future__ import annotations

import argparse
import json
import multiprocessing
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents.commands import train
from uwoc_gym.agents.flight import Policy, batches, draws, fly, load, load_scenario
from uwoc_gym.agents.learning.seeds import HELD_OUT
from uwoc_gym.agents.learning.settings import ALGORITHMS
from uwoc_gym.agents.options import CommandError, naming, output_folder, require, whole, write_text
from uwoc_gym.agents.policies import saved as inference
from uwoc_gym.agents.reports import statistics
from uwoc_gym.agents.reports import tables as report
from uwoc_gym.observation import SIZE
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import Scenario

HELP = "train every group of agents from several seeds and compare them with the controllers on held-out seeds"
EXAMPLES = """\
examples:
  uwoc-gym protocol --runs runs/protocol --out benchmark
  uwoc-gym protocol --runs runs/protocol --groups ppo --training-seeds 3 --scenario Random --out benchmark
  uwoc-gym protocol --runs runs/protocol --out benchmark --ship trained
"""

Array = npt.NDArray[np.float64]

CONTROLLERS = ("pd", "nlpd", "pd-tuned", "nlpd-tuned")
REFERENCE = "nlpd-tuned"
"""What every policy is compared with, episode by episode."""


@dataclass(frozen=True)
class Group:
    """Agents that differ in nothing but their training seed."""

    arguments: tuple[str, ...]
    """Of `uwoc-gym train`, without seed and folder."""
    seeds: int
    """Training seeds by default."""
    description: str


_EVALUATED = ("--eval-every", "500000", "--eval-episodes", "64")

GROUPS: dict[str, Group] = {
    "ppo": Group(("--algorithm", "ppo", *_EVALUATED), 10, "PPO on the last four observations"),
    "ppo-residual": Group(
        (
            *("--algorithm", "ppo", "--residual", "nlpd-tuned", "--scale", "0.6", "--steps", "3000000"),
            *("--set", "policy_kwargs.log_std_init=-1.0", "--set", "learning_rate=lin_7e-4", *_EVALUATED),
        ),
        10,
        "PPO on the last four observations, correcting nlpd-tuned",
    ),
    "ppo-one-frame": Group(
        ("--algorithm", "ppo", "--frame-stack", "1", *_EVALUATED), 3, "PPO on the last observation alone"
    ),
    "td3": Group(
        ("--algorithm", "td3", "--eval-every", "30000", "--eval-episodes", "64"), 3, "TD3 on the last four observations"
    ),
}
"""The groups of the benchmark; settings are those in `agents/settings/`."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument(
        "--groups", nargs="+", default=list(GROUPS), choices=list(GROUPS), metavar="GROUP",
        help=f"what to train (default: {' '.join(GROUPS)})",
    )  # fmt: skip
    parser.add_argument(
        "--training-seeds", type=whole(0), metavar="N",
        help="trainings of each group (default: the group's own, 10 or 3); 0 for controllers alone",
    )  # fmt: skip
    parser.add_argument(
        "--scenario", nargs="+", default=list(ENV_IDS), metavar="SCENARIO",
        help="names, environment IDs or .json files (default: all environment IDs)",
    )  # fmt: skip
    parser.add_argument(
        "--seeds", type=whole(1), default=len(HELD_OUT), metavar="N", help="held-out seeds (default: %(default)s)"
    )
    parser.add_argument("--steps", type=whole(1), metavar="N", help="training steps instead of the settings' own")
    parser.add_argument(
        "--jobs", type=whole(1), default=2, metavar="N", help="trainings and flights at a time (default: %(default)s)"
    )
    parser.add_argument("--runs", required=True, metavar="DIR", help="folder of the trainings; what is there is kept")
    parser.add_argument("--ship", metavar="DIR", help="put each group's best agent on the validation seeds here")
    parser.add_argument(
        "--out", required=True, metavar="DIR", help="folder for BENCHMARK.md, results.json, scores.npz and figures"
    )


def run(args: argparse.Namespace) -> int:
    """Train what is missing, fly everything and report; returns the exit status."""
    require("tqdm", "matplotlib", "stable_baselines3", "sb3_contrib", "yaml")
    if args.seeds > len(HELD_OUT):
        raise CommandError(f"--seeds {args.seeds} is not allowed; there are {len(HELD_OUT)} held-out seeds.")
    folder, runs = output_folder(args.out), output_folder(args.runs)
    with naming("--scenario"):
        scenarios = dict(load_scenario(name) for name in args.scenario)
    begun = time.perf_counter()
    members = {
        group: [runs / f"{group}-{seed}" for seed in range(_count(args, group))]
        for group in args.groups
        if _count(args, group)
    }
    _train(args, members)
    if args.ship:
        for group, own in members.items():
            ship(own, Path(args.ship) / group, GROUPS[group].description)
    policies = {name: [name] for name in CONTROLLERS}
    policies |= {group: [str(path) for path in own] for group, own in members.items()}
    scores = _fly(args, scenarios, policies)
    results: dict[str, Any] = {
        "held_out_seeds": args.seeds,
        "groups": {
            group: {
                "arguments": list(GROUPS[group].arguments),
                "trainings": [json.loads((path / "results.json").read_text(encoding="utf-8")) for path in own],
            }
            for group, own in members.items()
        },
        "results": {name: compared(own) for name, own in scores.items()},
        "microseconds_a_decision": {name: round(_decision_time(load(own[0])), 1) for name, own in policies.items()},
    }
    arrays: dict[str, Any] = {
        f"{scenario}/{policy}/{key}": values
        for scenario, by_policy in scores.items()
        for policy, measures in by_policy.items()
        for key, values in measures.items()
    }
    np.savez_compressed(folder / "scores.npz", **arrays)
    results["wall_time_s"] = round(time.perf_counter() - begun, 1)
    report.write_results(folder, args.command_line, scenarios, results)
    for name, by_policy in scores.items():
        if by_policy[REFERENCE]["return"].shape[1] > 1:
            returns = {policy: measures["return"] for policy, measures in by_policy.items()}
            report.profiles(folder / f"profile-{name}.png", name, returns, scenarios[name])
    text = benchmark_text(args.command_line, results)
    write_text(folder / "BENCHMARK.md", text)
    print(text, end="")
    return 0


def _count(args: argparse.Namespace, group: str) -> int:
    given: int | None = args.training_seeds
    return GROUPS[group].seeds if given is None else given


def _train(args: argparse.Namespace, members: Mapping[str, Sequence[Path]]) -> None:
    """Train what isn't finished, each in a process of its own; what was stopped goes on where it stood."""
    from tqdm import tqdm

    wanted = [(group, seed, path) for group, own in members.items() for seed, path in enumerate(own)]
    # By seed, so that a protocol that is stopped has as much of every group.
    wanted.sort(key=lambda job: job[1])
    for group, seed, path in wanted:
        _check_same(_words(args, group, seed, path), path)
    missing = [each for each in wanted if not _finished(each[2])]

    def one(job: tuple[str, int, Path]) -> str | None:
        group, seed, path = job
        words = [sys.executable, "-m", "uwoc_gym.agents.cli", "train", *_words(args, group, seed, path)]
        if (path / "run.json").is_file():
            words.append("--resume")
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        last = done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "no message"
        return None if done.returncode == 0 else f"{path.name}: {last}"

    with (
        ThreadPoolExecutor(args.jobs) as pool,
        tqdm(total=len(wanted), initial=len(wanted) - len(missing), unit="training", file=sys.stderr) as bar,
    ):
        for trouble in pool.map(one, missing):
            if trouble is not None:
                pool.shutdown(cancel_futures=True)
                raise CommandError(f"a training failed; the others stand in their folders. {trouble}")
            bar.update()


def _words(args: argparse.Namespace, group: str, seed: int, path: Path) -> list[str]:
    """What a training is given on the command line."""
    steps = [] if args.steps is None else ["--steps", str(args.steps)]
    return [*GROUPS[group].arguments, *steps, "--seed", str(seed), "--out", str(path)]


def _check_same(words: Sequence[str], path: Path) -> None:
    """Refuse a run that was begun with other settings than it would be now."""
    if not (path / "run.json").is_file():
        return
    recorded = json.loads((path / "run.json").read_text(encoding="utf-8"))
    for key, value in train.planned(words).items():
        if recorded.get(key) != value:
            raise CommandError(
                f"--runs: {path} was begun with other {key} than this protocol's; move it away or give another folder."
            )


def _finished(path: Path) -> bool:
    try:
        return bool(json.loads((path / "results.json").read_text(encoding="utf-8"))["finished"])
    except (OSError, ValueError, KeyError):
        return False


def ship(own: Sequence[Path], target: Path, text: str) -> None:
    """Copy the agent with the highest validation score to a folder of its own, without what only training needs.

    Raises:
        CommandError: A file can't be read or written.
    """

    def validation(path: Path) -> float:
        return float(json.loads((path / "results.json").read_text(encoding="utf-8"))["best"]["return"]["mean"])

    best = max(own, key=validation)
    target.mkdir(parents=True, exist_ok=True)
    for name in ("settings.yaml", "results.json", "vecnormalize.pkl"):
        if (best / name).is_file():
            shutil.copyfile(best / name, target / name)
    description = inference.read_description(best / inference.DESCRIPTION)
    report.write_json(
        target / inference.DESCRIPTION, {**description, "description": f"{text}; trained on {description['env']}"}
    )
    model = ALGORITHMS[description["algorithm"]].load().load(best / "model.zip", device="cpu")
    # The optimisers' moments are a third of the file and of no use to act.
    for part in model.get_parameters():
        if part.endswith("optimizer"):
            owner: Any = model
            for attribute in part.split("."):
                owner = getattr(owner, attribute)
            owner.state.clear()
    part_path = target / "model.zip.part"
    with part_path.open("wb") as file:
        model.save(file)
    part_path.replace(target / "model.zip")


def _fly(
    args: argparse.Namespace, scenarios: Mapping[str, Scenario], policies: Mapping[str, Sequence[str]]
) -> dict[str, dict[str, dict[str, Array]]]:
    """Each measure by scenario and policy, shape (trainings, seeds)."""
    from tqdm import tqdm

    jobs = [
        (scenario_name, name, member, HELD_OUT[: args.seeds] if draws(scenario) else HELD_OUT[:1])
        for scenario_name, scenario in scenarios.items()
        for name, members in policies.items()
        for member in members
    ]
    rows: dict[tuple[str, str], list[list[dict[str, float]]]] = {}
    # PyTorch and Numba don't like to be forked.
    with (
        ProcessPoolExecutor(args.jobs, multiprocessing.get_context("spawn"), _one_thread) as pool,
        tqdm(total=len(jobs), unit="flight", file=sys.stderr) as bar,
    ):
        flown = [pool.submit(_rows, member, scenarios[scenario], seeds) for scenario, _, member, seeds in jobs]
        for (scenario, name, _, _), done in zip(jobs, flown, strict=True):
            bar.set_description(f"{scenario}, {name}")
            rows.setdefault((scenario, name), []).append(done.result())
            bar.update()
    scores: dict[str, dict[str, dict[str, Array]]] = {}
    for (scenario, name), own in rows.items():
        found = {key: np.array([[row[key] for row in each] for each in own]) for key in own[0][0]}
        scores.setdefault(scenario, {})[name] = found
    return scores


def _one_thread() -> None:
    import torch

    torch.set_num_threads(1)


def _rows(member: str, scenario: Scenario, seeds: Sequence[int]) -> list[dict[str, float]]:
    """The measures of one policy's episodes."""
    policy = load(member)
    return [row for batch in batches(seeds, 200) for row in fly(policy, scenario, batch).metrics.rows()]


def compared(own: Mapping[str, Mapping[str, Array]]) -> dict[str, Any]:
    """Each policy's measures, and how it stands against the reference."""
    reference = own[REFERENCE]["return"]
    found: dict[str, Any] = {}
    for name, measures in own.items():
        # The same resamples for every policy.
        rng = np.random.default_rng(0)
        returns = measures["return"]
        difference = returns - reference
        found[name] = {
            "trainings": returns.shape[0],
            "episodes": returns.shape[1],
            "steps": float(np.max(measures["steps"])),
            "return_iqm": statistics.estimate(returns, statistics.interquartile_mean, rng)._asdict(),
            "return_worst": statistics.estimate(returns, statistics.worst_share, rng)._asdict(),
            "difference": statistics.estimate(difference, statistics.mean, rng)._asdict(),
            "improvement": statistics.estimate(difference, statistics.improvement, rng)._asdict(),
            "measures": report.summaries(measures, 0),
        }
    return found


def _decision_time(policy: Policy, calls: int = 300) -> float:
    """Microseconds that one policy takes for one decision on one observation, by the median call."""
    scenario = load_scenario("Random")[1]
    predictor = policy.make(scenario)
    observation, state, times = np.zeros((1, SIZE), dtype=np.float32), None, []
    for _ in range(calls):
        begun = time.perf_counter()
        _, state = predictor.predict(
            observation, state=state, episode_start=np.zeros(1, dtype=bool), deterministic=True
        )
        times.append(time.perf_counter() - begun)
    return 1e6 * float(np.median(times))


def benchmark_text(command: str, results: Mapping[str, Any]) -> str:
    """The benchmark as Markdown."""
    parts = [
        "# Benchmark",
        f"Written by `{command}`. Every policy flies the same {results['held_out_seeds']} held-out seeds, "
        "which no training, tuning or choice of a model has seen, on the same observations and actuators. IQM: "
        "interquartile mean. In brackets: 95 % bootstrap intervals over training seeds and scenario seeds. Difference "
        f"and probability of improvement: in return against `{REFERENCE}`, episode by episode. Worst: mean of the "
        "worst 5 % of episodes. (m of n never): in m of n episodes, over all trainings, it doesn't come to that, as "
        "when a link isn't restored; the mean is over the others. (k of n): the measure applies to k of n episodes; "
        "–: to none. A scenario in which nothing is drawn is flown once by each policy.",
    ]
    for scenario, own in results["results"].items():
        header = ["", *own]
        first = ("trainings", "episodes")
        lines = [[key, *(str(entry[key]) for entry in own.values())] for key in first]
        for label, key, digits in (
            ("return, IQM", "return_iqm", 1), ("return, worst", "return_worst", 1),
            ("difference", "difference", 2), ("P(improvement)", "improvement", 3),
        ):  # fmt: skip
            lines.append([label, *(statistics.text(entry[key], digits) for entry in own.values())])
        for measure in report.MEASURES:
            lines.append(
                [
                    measure.heading,
                    *(statistics.text(entry["measures"][measure.key], measure.digits) for entry in own.values()),
                ]
            )
        parts += [f"## {scenario}", report.grid(header, lines)]
    speeds = results["microseconds_a_decision"]
    parts += [
        "## A decision",
        "Median time of one `predict` on one observation, on the machine that wrote this.",
        report.grid(["", *speeds], [["µs", *(f"{value:.0f}" for value in speeds.values())]]),
        "## Trainings",
    ]
    lines = []
    for group, entry in results["groups"].items():
        runs = entry["trainings"]
        minutes = np.array([each["wall_time_s"] for each in runs]) / 60.0
        speed = np.array([each["steps_per_s"] for each in runs])
        words = " ".join(["uwoc-gym train", *entry["arguments"]])
        lines.append(
            [group, f"`{words}`", str(len(runs)), f"{runs[0]['settings']['n_timesteps']:,}", f"{minutes.mean():.1f}",
             f"{speed.mean():,.0f}"]
        )  # fmt: skip
    parts.append(report.grid(["group", "command", "trainings", "steps", "minutes each", "steps/s"], lines))
    return "\n\n".join(parts) + "\n"

"""The card beside each shipped agent: how to load it, what it was trained on, what it scores, and where it loses.

    python -m uwoc_gym.agents.reports.cards RESULTS [RESULTS ...]

writes the cards anew from the folders of `uwoc-gym benchmark --seeds 200`, such as that of the default benchmark and
that of the slow policies, and keeps their figures beside them.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import possible
from uwoc_gym.agents.policies import archive, saved
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.policies.registry import POLICIES, TRAINED, shipped
from uwoc_gym.agents.reports import files, statistics, tables
from uwoc_gym.agents.reports.tables import REFERENCE
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import Scenario

CARD = "CARD.md"
SCORES = TRAINED / "scores.json"
"""What every policy scored in the benchmark that the cards are written from."""

SEEDS = range(200)
"""The seeds of the benchmark that cards are written from: those that are held out."""

_COMPARED = {
    "arrival_time_s": ("arrives later", 1.0),
    "rmse_x_m": ("has a larger error in x", 1.0),
    "rmse_y_m": ("has a larger error in y", 1.0),
    "rmse_yaw_rad": ("has a larger error in yaw", 1.0),
    "availability": ("is less available", -1.0),
    "delivered_gbit": ("delivers less", -1.0),
    "effort": ("takes more effort", 1.0),
}
"""Measures in which an agent may be worse, in words, and whether more is worse."""


_KEPT = ("return", *_COMPARED, "lost")
"""The measures that are kept."""


def verdict(against: Mapping[str, Any]) -> str:
    """Whether a policy is "ahead" of another in return, "behind", or "even": its interval holds no difference."""
    value, low, high = (against["difference"][key] for key in ("value", "low", "high"))
    # Where nothing is drawn, one episode is all there is.
    low, high = (value if end is None else end for end in (low, high))
    return "ahead" if low > 0.0 else "behind" if high < 0.0 else "even"


def standings(scores: Mapping[str, Any], name: str) -> dict[str, list[str]]:
    """The scenarios in which a policy is ahead of the reference in return, even with it, and behind."""
    found: dict[str, list[str]] = {"ahead": [], "even": [], "behind": []}
    for entry in scores["results"]:
        if entry["policy"] == name and entry["against"]:
            found[verdict(entry["against"])].append(entry["scenario"])
    return found


def card(name: str, description: str, trained: Mapping[str, Any], scores: Mapping[str, Any], model: Path) -> str:
    """The card of an agent as Markdown.

    Args:
        name: Its name.
        description: What it is, in a line.
        trained: The ``results.json`` of its training.
        scores: What `read` gives.
        model: Its file.
    """
    said = archive.read(model)
    own = {entry["scenario"]: entry for entry in scores["results"] if entry["policy"] == name}
    reference = {entry["scenario"]: entry for entry in scores["results"] if entry["policy"] == REFERENCE}
    best = trained["best"]["return"]
    practice = trained["settings"].get("env_kwargs", {}).get("scenario")
    sees = f"the last {said.frame_stack} observations, oldest first, zeros before the first"
    world = ENV_IDS[said.env]
    home = Scenario.named(world)
    parts = [
        f"# {name}",
        f"{description}. Written by `python -m uwoc_gym.agents.reports.cards`; don't edit.",
        "## How to load it",
        f"It sees {sees if said.frame_stack > 1 else 'one observation'}"
        + (" with what filters believe behind each of them" if said.beliefs else "")
        + (f", and corrects {_corrected(said.residual)}" if said.residual is not None else "")
        + ". `uwoc_gym.agents.load` rebuilds all of that, and runs nothing that is in the file:",
        _block(
            "import gymnasium as gym",
            "import numpy as np",
            "from uwoc_gym.agents import load",
            "",
            f'env = gym.make("uwoc_gym:{said.env}")',
            f'policy = load("{name}", "{world}")',
            "observation, info = env.reset(seed=0)",
            "memory, begun, total, ended = None, np.array([True]), 0.0, False",
            "while not ended:",
            "    action, memory = policy.predict(observation, memory, begun, deterministic=True)",
            "    observation, reward, terminated, truncated, info = env.step(action)",
            "    total, begun, ended = total + reward, np.array([False]), terminated or truncated",
            "print(total)",
        ),
        *_plain_sb3(name, said),
        f"From a shell: `uwoc-gym benchmark --policy {name} {REFERENCE} --scenario {world}`.",
        "## What it was trained on",
        "\n".join(
            [
                f"- By {tables.code(trained['command'])}: {trained['steps']:,} steps of `{trained['env']}` from seed "
                f"{trained['seed']}, in {trained['wall_time_s'] / 60.0:.0f} min, with "
                + ", ".join(f"{each} {trained['versions'][each]}" for each in ("stable-baselines3", "torch"))
                + ".",
                "- It practised in episodes that differ from the scenario's in: "
                + (tables.code(json.dumps(practice)) + "." if practice else "nothing."),
                *_taught(trained["settings"]),
                "- It is the checkpoint, and of its group's trainings the one, with the best return on "
                f"{best['episodes']} validation seeds: {statistics.text(best, 1)}. The seeds below are others.",
                f"- It takes the {home.observation.size} observations and {len(home.actions)} actions of the IDs "
                "below, at their control periods, and has only ever flown in this simulation.",
            ]
        ),
        "## What it scores",
        f"By {' and '.join(map(tables.code, scores['commands']))}, on held-out seeds. "
        "In brackets: 95 % bootstrap intervals over seeds, of "
        "this one training; where an ID draws nothing, one episode is all there is. Difference and probability: in "
        f"return against `{REFERENCE}`, episode by episode.",
        tables.grid(
            ["ID", "episodes", "return", "worst 5 %", f"`{REFERENCE}`", "difference", "P(better)", "lost"],
            [
                [
                    scenario,
                    str(entry["episodes"]),
                    statistics.text(entry["measures"]["return"], 1),
                    f"{entry['return_worst']:.1f}",
                    statistics.text(reference[scenario]["measures"]["return"], 1),
                    statistics.text(entry["against"]["difference"], 2),
                    statistics.text(entry["against"]["improvement"], 2),
                    statistics.text(entry["measures"]["lost"], 2),
                ]
                for scenario, entry in own.items()
            ],
        ),
        tables.grid(
            ["ID", "arrival [s]", "RMSE x, y [m]", "RMSE yaw [rad]", "availability", "delivered [Gbit]", "effort"],
            [
                [
                    scenario,
                    statistics.text(found["arrival_time_s"], 2),
                    f"{found['rmse_x_m']['mean']:.3f}, {found['rmse_y_m']['mean']:.3f}",
                    statistics.text(found["rmse_yaw_rad"], 3),
                    statistics.text(found["availability"], 4),
                    statistics.text(found["delivered_gbit"], 1),
                    statistics.text(found["effort"], 3),
                ]
                for scenario, found in ((scenario, entry["measures"]) for scenario, entry in own.items())
            ],
        ),
        "## Where it leads and where it loses",
        _standing(name, scores),
        _losses({scenario: (entry["measures"], reference[scenario]["measures"]) for scenario, entry in own.items()}),
    ]
    return "\n\n".join(parts) + "\n"


def _taught(settings: Mapping[str, Any]) -> list[str]:
    """Whom it has copied before that, by its settings, if anyone."""
    teacher = settings.get("teacher")
    if teacher is None:
        return []
    whom = tables.code(teacher if isinstance(teacher, str) else json.dumps(teacher))
    return [
        f"- Before, in {settings['teacher_steps']:,} steps that aren't among those, it copied {whom} where it came to "
        "itself."
    ]


def _block(*lines: str) -> str:
    return "\n".join(["```python", *lines, "```"])


def _corrected(residual: Mapping[str, Any]) -> str:
    """What an agent corrects, as its file tells it, in words."""
    if "gains" in residual:
        return "a controller whose gains are in its file"
    if "agent" in residual:
        return "another agent, which is in its file"
    return tables.code(residual["policy"])


def _plain_sb3(name: str, said: archive.Description) -> list[str]:
    """How Stable-Baselines3 alone loads it, where it can."""
    algorithm, module = ALGORITHMS[said.algorithm][:2]
    for lacks, alone, without in (
        (said.residual, "the correction", "what it corrects"),
        (said.beliefs, "the network", "the filters that it stands behind"),
    ):
        if lacks is not None:
            return [
                f"`{algorithm}.load` of Stable-Baselines3 reads `model.zip`, but gives {alone} alone, which is nothing "
                f"without {without}."
            ]
    stacked = said.frame_stack > 1
    env = f'TrackingVecEnv("{said.env}", n_envs=8, seed=0)'
    return [
        f"`{algorithm}.load` of Stable-Baselines3 gives the network"
        + (
            f", which takes {said.frame_stack} observations in one; `predict` on a single one fails. `VecFrameStack` "
            "stacks them:"
            if stacked
            else ":"
        ),
        _block(
            f"from {module} import {algorithm}",
            "from stable_baselines3.common.evaluation import evaluate_policy",
            *(["from stable_baselines3.common.vec_env import VecFrameStack"] if stacked else []),
            "from uwoc_gym.agents.policies.registry import TRAINED",
            "from uwoc_gym.sb3 import TrackingVecEnv",
            "",
            f"env = {f'VecFrameStack({env}, {said.frame_stack})' if stacked else env}",
            f'model = {algorithm}.load(TRAINED / "{name}" / "model.zip", env=env, device="cpu")',
            "mean, deviation = evaluate_policy(model, env, n_eval_episodes=8, warn=False)",
            "print(mean)",
        ),
    ]


def _standing(name: str, scores: Mapping[str, Any]) -> str:
    found = standings(scores, name)
    count = sum(map(len, found.values()))
    words = {"ahead": f"ahead of `{REFERENCE}`", "even": "neither ahead nor behind", "behind": "behind it"}
    told = [
        f"{words[key]} on {len(each)}" + (f" ({', '.join(each)})" if each else "")
        for key, each in found.items()
        if each or key != "even"
    ]
    return f"In return, of {count} IDs: {'; '.join(told)}."


def _losses(pairs: Mapping[str, tuple[Mapping[str, Any], Mapping[str, Any]]]) -> str:
    """The measures in which it is worse than the reference by more than the intervals of both."""
    lines = []
    for key, (words, sense) in _COMPARED.items():
        worse = [scenario for scenario, (own, other) in pairs.items() if _worse(own[key], other[key], sense)]
        if worse:
            lines.append(f"- {words} in {', '.join(worse)}")
    head = f"Beside `{REFERENCE}`, by more than both intervals, it"
    return "\n".join([f"{head}\n", *lines]) if lines else f"{head} is worse in no other measure."


def _worse(own: Mapping[str, Any], other: Mapping[str, Any], sense: float) -> bool:
    """Whether a mean is worse with its whole interval."""
    if own["mean"] is None or other["mean"] is None:
        return False
    ends = [
        sorted(sense * (found["mean"] if found[end] is None else found[end]) for end in ("low", "high"))
        for found in (own, other)
    ]
    # To what a table shows.
    return bool(ends[0][0] > ends[1][1] + 1e-3 * abs(other["mean"]))


def write(scores: Mapping[str, Any], folder: Path = TRAINED) -> list[Path]:
    """Write the cards of a folder's agents, and the figures that they are from; returns the paths of the cards.

    Raises:
        CommandError: An agent, or what it is compared with, isn't among the results.
    """
    agents = shipped(folder)
    flown = {entry["policy"] for entry in scores["results"]}
    missing = sorted({*agents, REFERENCE} - flown)
    if missing:
        raise CommandError(f"the results lack {', '.join(missing)}; fly them all: uwoc-gym benchmark --seeds 200.")
    texts = {}
    for name, policy in agents.items():
        trained = files.read_json(folder / name / files.RESULTS)
        texts[folder / name / CARD] = card(name, policy.description, trained, scores, folder / name / saved.MODEL)
    files.write_json(folder / SCORES.name, scores)
    for path, text in texts.items():
        files.write_text(path, text)
    return list(texts)


def read(paths: Sequence[Path]) -> dict[str, Any]:
    """What cards are written from: the results of benchmarks, taken together.

    Args:
        paths: The folders of benchmarks, or the ``results.json`` in them, beside their ``episodes.csv``.

    Raises:
        CommandError: One can't be read, or is of something else; two are of the same flights; or all together are of
            less than cards tell of: all seeds and all IDs.
    """
    todays = {name: Scenario.named(name) for name in ENV_IDS.values()}
    digests = {name: scenario.digest() for name, scenario in todays.items()}
    found: dict[tuple[str, str], tables.Result] = {}
    every = []
    for path in paths:
        folder = path if path.is_dir() else path.parent
        results = files.read_json(folder / files.RESULTS)
        if not _of_a_benchmark(results):
            raise CommandError(f"{str(path)!r} is not allowed; it must be the results of uwoc-gym benchmark.")
        every.append(results)
        for wrong, what in (
            (results["finished"] is not True, "a benchmark that was interrupted"),
            (bool(results["settings"].get("wrappers")), "flights in wrappers"),
            (results["settings"]["seeds"] != list(SEEDS), f"other seeds than {SEEDS[0]} to {SEEDS[-1]}"),
            (not results["scenarios"].items() <= digests.items(), "other scenarios than the IDs' own"),
        ):
            if wrong:
                raise _unfit(path, what)
        episodes = files.read_episodes(folder / files.EPISODES) if results["results"] else {}
        for entry in results["results"]:
            key = entry["scenario"], entry["policy"]
            if key in found:
                raise CommandError(f"{str(path)!r} has {key[1]} in {key[0]}, which others of the results have too.")
            if len(episodes.get(key, ())) != entry["episodes"]:
                raise CommandError(f"{str(folder / files.EPISODES)!r} lacks episodes of {key[1]} in {key[0]}.")
            found[key] = tables.Result(
                *key, episodes[key], entry["one_episode_stands_for_all_seeds"], possible(todays[key[0]])
            )
    if lacking := sorted(digests.keys() - {scenario for scenario, _ in found}):
        raise _unfit(paths[0], f"fewer scenarios than the IDs': {', '.join(lacking)} are missing")
    order = [*POLICIES, *(policy for _, policy in found)]
    ordered = [found[key] for key in sorted(found, key=lambda key: ([*todays].index(key[0]), order.index(key[1])))]
    return {
        "commands": [results["command"] for results in every],
        "versions": every[0]["versions"],
        "scenarios": digests,
        "results": [
            {**entry, "measures": {key: entry["measures"][key] for key in _KEPT}}
            for entry in tables.results_data(ordered, SEEDS[0])
        ],
    }


def _unfit(path: Path, what: str) -> CommandError:
    return CommandError(
        f"{str(path)!r} is of {what}; cards are of all held-out seeds of every ID: uwoc-gym benchmark "
        f"--seeds {len(SEEDS)} --out results."
    )


def _of_a_benchmark(results: Any) -> bool:
    """Whether there is in it what cards and their checks read."""
    needed = {"command": str, "versions": dict, "scenarios": dict, "results": list, "settings": dict, "finished": bool}
    if not isinstance(results, dict) or any(not isinstance(results.get(key), kind) for key, kind in needed.items()):
        return False
    settings = results["settings"]
    # Those of `uwoc-gym evaluate` are of one policy.
    if not isinstance(settings.get("seeds"), list) or not isinstance(settings.get("policies"), list):
        return False
    return all(
        isinstance(entry, dict) and {"scenario", "policy", "episodes", "one_episode_stands_for_all_seeds"} <= set(entry)
        for entry in results["results"]
    )


def main(arguments: Sequence[str]) -> int:
    """Write the cards from the folders of benchmarks; returns the exit status."""
    if not arguments:
        usage = "usage: python -m uwoc_gym.agents.reports.cards RESULTS [RESULTS ...], folders of uwoc-gym benchmark"
        print(usage, file=sys.stderr)
        return 2
    try:
        for written in write(read([*map(Path, arguments)])):
            print(written)
    except CommandError as error:
        print(f"cards: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

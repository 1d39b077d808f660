"""The benchmark's protocol: groups of agents trained from several seeds, and flown on held-out seeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.agents import places
from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.agents.flight import batches, flown
from uwoc_gym.agents.learning import checkpoints
from uwoc_gym.agents.learning.plans import Job, Plan, Wish, planned, recorded_plan
from uwoc_gym.agents.learning.seeds import BATCH
from uwoc_gym.agents.policies import archive, saved
from uwoc_gym.agents.reports import files
from uwoc_gym.agents.work import Hands, Task, run_all
from uwoc_gym.given import as_number, shown
from uwoc_gym.scenario import Scenario

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Group:
    """Agents that differ in nothing but their training seed."""

    wish: Wish
    """What is trained, without seed."""
    seeds: int
    """Training seeds by default."""
    description: str


GROUPS: dict[str, Group] = {
    "ppo": Group(Wish(algorithm="ppo", eval_every=250_000, eval_episodes=64), 10, "PPO on the last four observations"),
    "ppo-residual": Group(
        Wish(
            algorithm="ppo",
            residual="nlpd-tuned",
            scale=0.6,
            steps=4_000_000,
            set=("policy_kwargs.log_std_init=-1.0",),
            eval_every=500_000,
            eval_episodes=64,
        ),
        10,
        "PPO on the last four observations, correcting nlpd-tuned",
    ),
    "ppo-one-frame": Group(
        Wish(algorithm="ppo", frame_stack=1, eval_every=500_000, eval_episodes=64),
        3,
        "PPO on the last observation alone",
    ),
    "td3": Group(Wish(algorithm="td3", eval_every=30_000, eval_episodes=64), 3, "TD3 on the last four observations"),
    "ppo-underactuated": Group(
        Wish(algorithm="ppo", env="uwoc/Underactuated-v0", eval_every=500_000, eval_episodes=192),
        10,
        "PPO behind a filter for the current, without a sway force",
    ),
    "ppo-tide": Group(
        Wish(algorithm="ppo", env="uwoc/Tide-v0", eval_every=1_000_000, eval_episodes=192),
        5,
        "PPO behind a filter for the current, after it has copied a planner",
    ),
    "ppo-latefix": Group(
        Wish(algorithm="ppo", env="uwoc/LateFix-v0", eval_every=1_000_000, eval_episodes=192),
        5,
        "PPO behind a network that tracks the ship, after it has copied gru-nlpd",
    ),
}
"""The groups of the benchmark; settings are those in `agents/settings/`."""

USUAL = tuple(name for name, group in GROUPS.items() if group.wish.env is None)
"""Those that are trained on Random, and on equal terms in all that looks like it."""


def train_all(jobs: Sequence[Job], crew: Hands, bar: Any) -> None:
    """Train what isn't finished; what was stopped goes on where it stood, whoever does it.

    Args:
        jobs: The trainings.
        crew: Who trains.
        bar: Gets on by one for each of them.

    Raises:
        CommandError: A training failed; no more are begun, and those under way write a checkpoint.
        KeyboardInterrupt: It was asked to stop; those under way have written a checkpoint.
    """
    from uwoc_gym.agents.learning.training import finished, train_one

    missing = [job for job in jobs if not finished(places.local(job.folder))]
    bar.update(len(jobs) - len(missing))
    tasks = [Task(train_one, (job,), name=f"training {job.name}") for job in missing]
    with naming("a training failed; the others stand in their folders"), closing(run_all(tasks, crew)) as done:
        for task, _ in done:
            bar.set_description(task.name)
            bar.update()


def check(groups: Mapping[str, Sequence[Job]], scenarios: Mapping[str, Scenario]) -> None:
    """Refuse, before anything is trained, what can't be trained or flown in the end.

    Raises:
        CommandError: A training isn't allowed, a folder holds one with other settings, or agents are asked to fly what
            they can't.
    """
    for group, jobs in groups.items():
        for job in jobs:
            with naming(f"--groups {group}"):
                plan = planned(job.wish)
            _check_same(job, plan)
            for name, scenario in scenarios.items():
                task = plan.task
                if task is None or (task.observation, task.action) != (scenario.observation, scenario.action):
                    raise CommandError(
                        f"--scenario {name} is not allowed for {group}; it must have the observations and actions of "
                        f"{plan.name}, which its agents are trained in."
                    )


def _check_same(job: Job, plan: Plan) -> None:
    """Refuse a run that was begun with other settings than it would be now."""
    path = places.local(job.folder) / "run.json"
    if not path.is_file():
        return
    recorded = recorded_plan(path)
    for key, value in plan.to_dict().items():
        if recorded.get(key) != value:
            raise CommandError(
                f"--runs: {job.folder} was begun with other {key} than this protocol's; move it away or give another "
                "folder."
            )


def jobs_of(
    groups: Mapping[str, int], runs: str, steps: int | None, wrapper: Sequence[str] = ()
) -> dict[str, list[Job]]:
    """The trainings of each group.

    Args:
        groups: Number of trainings by a name in `GROUPS`.
        runs: Path or address of the folder of all runs.
        steps: Steps of each training, in place of what its group says.
        wrapper: What goes around the environments.
    """

    def wish(name: str, seed: int) -> Wish:
        own = GROUPS[name].wish
        return replace(own, seed=seed, steps=steps or own.steps, wrapper=tuple(wrapper))

    return {
        name: [Job(wish(name, seed), places.inside(runs, f"{name}-{seed}")) for seed in range(count)]
        for name, count in groups.items()
    }


_TOLD = ("best.return.mean", "wall_time_s", "steps_per_s", "settings.n_timesteps")
"""The numbers of a training that the report and the choice of what is shipped need."""


def read_results(path: Path) -> dict[str, Any]:
    """What the ``results.json`` of a finished training says.

    Raises:
        CommandError: It can't be read, or lacks a number that is needed.
    """
    found = files.read_json(path)
    for name in _TOLD:
        value = found
        for key in name.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        number = as_number(value)
        if number is None or not math.isfinite(number):
            raise CommandError(
                f"{path}: {name} = {shown(value)} is not allowed; it must be a finite number. "
                "Move the file away, and the training is asked for it again."
            )
    return dict(found)


def ship(own: Sequence[Path], target: Path, text: str) -> None:
    """Copy the agent with the highest validation score to a folder of its own, without what only training needs.

    Raises:
        CommandError: A file can't be read or written.
    """

    def validation(path: Path) -> float:
        return float(read_results(path / files.RESULTS)["best"]["return"]["mean"])

    best = max(own, key=validation)
    target.mkdir(parents=True, exist_ok=True)
    for name in ("settings.yaml", files.RESULTS):
        files.copy(best / name, target / name)
    model = best / saved.MODEL
    described = f"{text}; trained on {archive.read(model).env}"
    checkpoints.save_agent(target / saved.MODEL, lambda file: archive.write_for_acting(model, file, described))


def fly_all(
    scenarios: Mapping[str, Scenario],
    policies: Mapping[str, Sequence[str]],
    seeds: Sequence[int],
    crew: Hands,
    bar: Any,
    wrapper: Sequence[str] = (),
) -> dict[str, dict[str, dict[str, Array]]]:
    """Fly every policy through every scenario.

    Args:
        scenarios: By name.
        policies: The members of each policy, as `load` takes them.
        seeds: Seeds of the episodes.
        crew: Who flies.
        bar: Gets on by one for each flight.
        wrapper: What goes around the environments.

    Returns:
        Each measure by scenario and policy, shape (members, seeds).
    """
    flights = [
        (scenario_name, name) for scenario_name in scenarios for name, members in policies.items() for _ in members
    ]
    tasks = [
        Task(
            _rows,
            (member, tuple(wrapper), scenario),
            seeds if scenario.draws or wrapper else seeds[:1],
            f"flying {member} through {scenario_name}",
        )
        for scenario_name, scenario in scenarios.items()
        for members in policies.values()
        for member in members
    ]
    rows: dict[tuple[str, str], list[list[dict[str, float]]]] = {}
    with closing(run_all(tasks, crew)) as done:
        for (scenario_name, name), (_, found) in zip(flights, done, strict=True):
            bar.set_description(f"{scenario_name}, {name}")
            rows.setdefault((scenario_name, name), []).append(found)
            bar.update()
    scores: dict[str, dict[str, dict[str, Array]]] = {}
    for (scenario, name), own in rows.items():
        found = {key: np.array([[row[key] for row in each] for each in own]) for key in own[0][0]}
        scores.setdefault(scenario, {})[name] = found
    return scores


def _rows(member: str, wrapper: Sequence[str], scenario: Scenario, seeds: Sequence[int]) -> list[dict[str, float]]:
    """The measures of one policy's episodes, and what they lack."""
    flights = (flown(member, False, wrapper, scenario, batch) for batch in batches(seeds, BATCH))
    return [row for flight in flights for row in flight.rows]

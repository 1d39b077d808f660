"""Seeded searches with Optuna that can be stopped and resumed, and that write down all they tried."""

from __future__ import annotations

import csv
import io
import json
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

from uwoc_gym.agents import places
from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.reports.files import write_text

DATABASE = "study.db"
TRIALS = "trials.csv"


class Dimension(NamedTuple):
    """One number to search for."""

    low: float
    high: float
    log: bool = False
    """Whether to search on a log scale."""


class Tried(NamedTuple):
    """One point that was tried."""

    values: dict[str, float]
    score: float
    outcome: dict[str, float]
    """What else the evaluation found."""


class Found(NamedTuple):
    """What a search came to."""

    best: Tried
    trials: int
    finished: bool
    """Whether the search wasn't interrupted."""


Direction = Literal["minimize", "maximize"]

Evaluate = Callable[[list[dict[str, float]]], list[tuple[float, dict[str, float]]]]
"""Score and outcome of each of a batch of points."""


def search(
    folder: Path,
    problem: Mapping[str, Any],
    dimensions: Mapping[str, Dimension],
    evaluate: Evaluate,
    *,
    trials: int,
    batch: int,
    seed: int,
    direction: Direction,
    sampler: Literal["cma-es", "tpe"],
    begin: Sequence[Mapping[str, float]] = (),
    resume: bool = False,
) -> Found:
    """Search a box; each batch that is finished is in the folder's database and table before the next begins.

    Args:
        folder: Gets `study.db`, Optuna's SQLite storage, and `trials.csv`.
        problem: What is searched for, as plain data; a resumed search must have the same.
        dimensions: The box.
        evaluate: Scores a batch of points.
        trials: Points to try in all, those of earlier sessions included.
        batch: Points to try at a time.
        seed: Seed of the sampler. A search that was resumed goes on with other draws than one that wasn't stopped.
        direction: Whether lower or higher scores are better.
        sampler: Optuna's CMA-ES or multivariate TPE.
        begin: Points to try first.
        resume: Go on with the search that the folder holds.

    Raises:
        CommandError: The folder holds a search and ``resume`` isn't set, it holds another problem or none, or the
            storage can't be written.
    """
    import optuna
    from tqdm import tqdm

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    space: dict[str, optuna.distributions.BaseDistribution] = {
        name: optuna.distributions.FloatDistribution(each.low, each.high, log=each.log)
        for name, each in dimensions.items()
    }
    described = json.loads(json.dumps({**problem, "space": {name: list(each) for name, each in dimensions.items()}}))
    disk: Any = None
    with _storage_errors(folder):
        # A new one is only made with the first batch, so that a refusal leaves nothing.
        if resume or (folder / DATABASE).exists():
            disk = _open(folder, described, direction, resume)
        done = [trial for trial in disk.trials if trial.state.is_finished()] if disk is not None else []
        # A session samples in memory, since SQLite takes longer for a trial than the simulator does.
        draws = seed + len(done)
        study = optuna.create_study(direction=direction, sampler=_sampler(sampler, draws, batch))
        study.add_trials(done)
    if not done:
        for point in begin:
            study.enqueue_trial(dict(point))
    finished = True
    with tqdm(total=trials, initial=len(done), unit="trial", file=sys.stderr) as bar:
        try:
            while len(study.trials) < trials:
                asked = [study.ask(space) for _ in range(min(batch, trials - len(study.trials)))]
                for trial, (score, outcome) in zip(asked, evaluate([trial.params for trial in asked]), strict=True):
                    for name, value in outcome.items():
                        trial.set_user_attr(name, value)
                    study.tell(trial, score)
                with _storage_errors(folder):
                    if disk is None:
                        folder.mkdir(parents=True, exist_ok=True)
                        disk = _open(folder, described, direction, resume)
                    disk.add_trials(study.trials[-len(asked) :])
                    _write_trials(folder / TRIALS, study.trials)
                places.keep(folder, places.OFTEN_S)
                bar.update(len(asked))
                bar.set_postfix_str(f"best {study.best_value:.4g}")
        except KeyboardInterrupt:
            finished = False
    complete = [trial for trial in study.trials if trial.state.is_finished()]
    if not complete:
        raise CommandError("interrupted before the first batch was finished; nothing was found.")
    if not finished:
        # It may have come between the end of a trial and its place on the disk.
        with _storage_errors(folder):
            disk.add_trials(complete[len(disk.trials) :])
            _write_trials(folder / TRIALS, complete)
    best = study.best_trial
    return Found(Tried(dict(best.params), float(best.values[0]), dict(best.user_attrs)), len(complete), finished)


def _sampler(name: str, seed: int, batch: int) -> Any:
    import optuna

    if name == "cma-es":
        # Smaller populations than these say too little about the shape of the ground.
        return optuna.samplers.CmaEsSampler(seed=seed, popsize=max(batch, 8))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return optuna.samplers.TPESampler(seed=seed, multivariate=True, constant_liar=True)


def _open(folder: Path, described: dict[str, Any], direction: Direction, resume: bool) -> Any:
    import optuna

    path = folder / DATABASE
    if path.exists() and not resume:
        raise CommandError(f"{path} holds a search already; go on with it by --resume, or give another --out.")
    if resume and not path.exists():
        raise CommandError(f"--resume: there is no {path}.")
    storage = optuna.storages.RDBStorage(f"sqlite:///{path}")
    study = optuna.create_study(storage=storage, study_name="search", direction=direction, load_if_exists=resume)
    if not study.user_attrs:
        study.set_user_attr("problem", described)
    elif study.user_attrs["problem"] != described:
        before = study.user_attrs["problem"]
        unlike = sorted(key for key in before.keys() | described.keys() if before.get(key) != described.get(key))
        raise CommandError(f"--resume: {path} holds a search with another {', '.join(unlike)}.")
    return study


@contextmanager
def _storage_errors(folder: Path) -> Any:
    """Turn a failure of the database into one line; what it held before stays."""
    import optuna
    import sqlalchemy.exc

    try:
        yield
    except (optuna.exceptions.StorageInternalError, sqlalchemy.exc.SQLAlchemyError) as error:
        reason = str(error.__cause__ or error).splitlines()[0]
        raise CommandError(f"{folder / DATABASE} can't be used: {reason}") from None


def _write_trials(path: Path, trials: Sequence[Any]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [*trials[0].params, *trials[0].user_attrs]
    writer.writerow(["trial", "score", *names])
    for trial in trials:
        values = {**trial.params, **trial.user_attrs}
        writer.writerow([trial.number, repr(trial.values[0]), *(repr(values[name]) for name in names)])
    write_text(path, text.getvalue())

"""A training run: environments, algorithm, evaluations, checkpoints, and the folder that tells all about it."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger, TensorBoardOutputFormat
from stable_baselines3.common.utils import set_random_seed

from uwoc_gym.agents import interrupts, places
from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.agents.flight import batches, fly
from uwoc_gym.agents.learning import checkpoints, environments, standing
from uwoc_gym.agents.learning.imitation import ROUNDS, Lessons, hold
from uwoc_gym.agents.learning.plans import Job, Plan, Wish, check_same, planned, recorded_plan
from uwoc_gym.agents.learning.progress import Progress, read_progress
from uwoc_gym.agents.learning.seeds import ALL_VALIDATION, BATCH, training_seed
from uwoc_gym.agents.learning.settings import constructor_arguments, written
from uwoc_gym.agents.policies import archive, saved
from uwoc_gym.agents.policies.agent import Agent, stack
from uwoc_gym.agents.policies.algorithms import ALGORITHMS
from uwoc_gym.agents.policies.archive import Normalisation
from uwoc_gym.agents.policies.registry import POLICIES
from uwoc_gym.agents.policies.residual import Named
from uwoc_gym.agents.reports import figures, files, tables
from uwoc_gym.agents.scenarios import differences
from uwoc_gym.baselines.beliefs import Beliefs
from uwoc_gym.baselines.policy import Policy, Predictor
from uwoc_gym.parameters import SettingError
from uwoc_gym.scenario import Scenario

BASELINES = ("pd", "nlpd", "nlpd-tuned")
"""The controllers whose scores stand in the learning curve."""

LINES = 24
"""How many differences between what is trained on and what is scored are shown."""

_LAST, _BEST = "last.zip", "best.zip"
"""The last agent, in the run's folder and in a checkpoint, and the best one in a checkpoint."""

_BUFFER, _LESSONS, _STANDING = "replay.npz", "lessons.npz", "standing.npz"
"""What a checkpoint holds besides, where there is any."""

_PATIENCE_S = 60.0
"""How long the process that trained for a command that was killed, perhaps on another node, may take to end [s]."""

_COUNTERS = ("_n_updates", "_episode_num")
"""What a model counts besides its steps, by Stable-Baselines3's names."""


def begun(folder: Path) -> bool:
    """Whether a folder holds a training run."""
    return (folder / "run.json").is_file()


def finished(folder: Path) -> bool:
    """Whether the run in a folder has come to its end."""
    try:
        return bool(files.read_json(folder / files.RESULTS)["finished"])
    except (CommandError, KeyError, TypeError):
        return False


def train(
    wish: Wish,
    folder: Path,
    command: str,
    resume: bool = False,
    threads: int = 1,
    bar: bool = True,
    tell: Callable[[str], None] | None = None,
    patience_s: float = 0.0,
) -> Run:
    """Train to the end, or go on with what was stopped.

    Args:
        wish: What is asked for.
        folder: Where the run keeps everything.
        command: The command line, for the record.
        resume: Whether to go on with the run that the folder holds, rather than to begin one.
        threads: Threads of PyTorch.
        bar: Whether to show progress.
        tell: Is told what will be done, a line at a time, before it is begun.
        patience_s: How long to wait for another process that is at work in the folder [s].

    Returns:
        The run, finished.

    Raises:
        Interruption: The process was asked to stop; a checkpoint stands where it did.
        CommandError: Something asked for isn't allowed, the folder holds a run or none, another process is at work in
            it, or a file can't be written.
    """
    # Networks this small gain nothing from more, and runs side by side get in each other's way.
    torch.set_num_threads(threads)
    recorded = None
    if begun(folder):
        if not resume:
            raise _taken(folder)
        with naming("--resume"):
            recorded = recorded_plan(folder / "run.json")
    elif resume:
        raise CommandError(f"--resume: there is no run in {folder}; it has no run.json.")
    last = checkpoints.newest(folder) if resume else None
    # Before the lock, so that a refusal leaves nothing.
    progress = Progress() if last is None else _stood(last)[1]
    plan = planned(wish, recorded, taught=progress.lessons >= ROUNDS)
    if recorded is not None:
        check_same(plan, recorded, folder)
    files.output_folder(folder)
    with files.locked(folder, patience_s):
        if recorded is None and begun(folder):
            # By a process that has come and gone in the meantime.
            raise _taken(folder)
        run = Run(plan, folder, command, checkpoints.newest(folder) if resume else None)
        if not run.progress.finished:
            for line in run.preview() if tell is not None else ():
                tell(line)  # type: ignore[misc]
            run.train(bar)
        elif not finished(folder):
            # It was killed between its last checkpoint and the files that tell of it, or they were damaged.
            run.tell()
    return run


def train_one(job: Job, seeds: Sequence[int]) -> dict[str, Any]:
    """A training as a task: to the end, or on to it from where the run in the folder stood.

    Returns:
        The best validation.

    Raises:
        CommandError: It failed.
        KeyboardInterrupt: It was asked to stop, and has written a checkpoint.
    """
    try:
        with naming(job.name), places.held(job.folder) as folder:
            made = train(job.wish, folder, job.command, resume=begun(folder), bar=False, patience_s=_PATIENCE_S)
            best = made.progress.best
    except Interruption:
        raise KeyboardInterrupt from None
    assert best is not None
    return best


def _taken(folder: Path) -> CommandError:
    return CommandError(f"--out {folder} holds a run already; give --resume to go on with it, or another folder.")


def _stood(checkpoint: Path) -> tuple[Normalisation | None, Progress]:
    """Where a checkpoint says that its run stood.

    Raises:
        CommandError: It can't be read.
    """
    last = checkpoint / _LAST
    if last.is_file() and not archive.is_agent(last):
        raise CommandError(
            f"{checkpoint} is of version 0.1, whose checkpoints hold pickled objects, and can't be gone on with; "
            "begin another run."
        )
    progress = read_progress(checkpoint / "progress.json")
    return archive.read(last).normalisation, progress


class Interruption(Exception):
    """The run was asked to stop, and has written a checkpoint."""

    def __init__(self, number: int, steps: int) -> None:
        super().__init__(f"interrupted at step {steps}")
        self.status = 128 + number
        self.steps = steps


class Run:
    """A training run in a folder.

    Args:
        plan: What it is to do.
        folder: Where it keeps everything.
        command: The command line, for the record.
        resume: The checkpoint to go on from; None to begin.

    Raises:
        CommandError: The algorithm can't be made with these settings, or the checkpoint can't be read.
    """

    def __init__(self, plan: Plan, folder: Path, command: str, resume: Path | None = None) -> None:
        self.plan = plan
        self.folder = folder
        self.command = command
        self.progress = Progress()
        self.kind = ALGORITHMS[plan.algorithm]
        normalisation = None
        if resume is not None:
            normalisation, self.progress = _stood(resume)
        self.baselines: dict[str, dict[str, Any]] = {}
        values = plan.values
        self._from = None if resume is None else resume / _STANDING
        self.stood = checkpoints.read_plain(self._from) if self._from is not None and self._from.is_file() else None
        """Where the run stood between two rollouts; None before the first, or where that can't be told."""
        self._first = self._first_seed()
        practice = plan.practice
        base = environments.make_base(plan.env_id, values["n_envs"], practice, values["env_kwargs"], plan.wrapping)
        shown = None if plan.wrapping else practice
        env, self.monitor, self.statistics = environments.wrapped(
            base, values, self._corrected(practice), shown, normalisation, self._beliefs()
        )
        self.env = env
        self.model = self._make(self._first)
        self.lessons = self._lessons(practice)
        if resume is not None:
            self._restore(resume)
        if resume is not None and (resume / _BEST).is_file():
            # One saved after the checkpoint isn't known to it.
            files.copy(resume / _BEST, folder / saved.MODEL)

    def _first_seed(self) -> int:
        """The seed of what is learned from rewards; what can't go on where it stood gets others than it has seen."""
        plan, progress = self.plan, self.progress
        envs = plan.values["n_envs"]
        used = ROUNDS * envs if plan.values["teacher"] is not None else 0
        if progress.steps and self.stood is None:
            used = max(used, progress.seeds_used)
        progress.seeds_used = max(progress.seeds_used, used + envs)
        return training_seed(plan.seed, used)

    def _make(self, seed: int) -> Any:
        plan = self.plan
        size = int(np.prod(self.env.action_space.shape or (1,)))
        arguments = constructor_arguments(plan.algorithm, plan.values, size)
        try:
            return self.kind.load()(plan.values["policy"], self.env, seed=seed, device="cpu", **arguments)
        except (TypeError, ValueError, AssertionError, NotImplementedError, RuntimeError) as error:
            raise CommandError(f"{self.kind.name} can't be made with these settings: {error}") from error

    def _corrected(self, scenario: Scenario | None) -> Predictor | None:
        """What the agent corrects, made for a scenario."""
        corrected = self.plan.corrected
        if corrected is None or scenario is None:
            return None
        return Named(corrected.policy.pilot(scenario), corrected.policy.name)

    def _lessons(self, scenario: Scenario | None) -> Lessons | None:
        """What is still to be learned from a teacher, if anything."""
        plan = self.plan
        if plan.teacher is None or scenario is None or self.progress.lessons >= ROUNDS:
            return None
        steps = plan.values["teacher_steps"]
        return Lessons(self.model, self.monitor, plan.teacher.policy, scenario, steps, training_seed(plan.seed))

    def _beliefs(self) -> Beliefs | None:
        """What filters add to observations; they know what is scored, in practice too."""
        return saved.beliefs_of(self.plan.values, self.plan.task)

    def _restore(self, path: Path) -> None:
        """Put the model back where a checkpoint left it."""
        archive.read_training(path / _LAST, self.model)
        counted = {name: int(self.progress.counters.get(name, 0)) for name in _COUNTERS}
        vars(self.model).update(counted, num_timesteps=self.progress.steps)
        if self.kind.off_policy:
            checkpoints.load_buffer(self.model.replay_buffer, path / _BUFFER)
        if self.lessons is not None:
            self.lessons.restore(path / _LESSONS)
        if self.stood is not None:
            standing.put(self.model, self.stood, path / _STANDING)

    def _begin(self) -> None:
        """Let random numbers go on from where they stood, or begin."""
        if self.stood is not None:
            assert self._from is not None
            standing.let_draw(self.model, self.stood, self._from)
            return
        set_random_seed(self._first)
        self.env.action_space.seed(self._first)
        self.env.seed(self._first)

    def agent(self) -> Agent:
        """The present policy, as it would fly after training."""
        plan = self.plan
        normalise = self.statistics.normalize_obs if self.statistics is not None else None
        frames, scale = plan.values["frame_stack"], plan.values["residual_scale"]
        return Agent(self.model, normalise, frames, self._corrected(plan.task), scale, self._beliefs())

    def _lot(self) -> int | None:
        return rollout(self.model, self.kind.off_policy)

    def forecast(self) -> Forecast:
        """What the run will have come to at its end."""
        plan, progress = self.plan, self.progress
        evaluated = progress.evaluations[-1]["steps"] if progress.evaluations else None
        lot = self._lot() or plan.values["n_envs"]
        return forecast(plan.values["n_timesteps"], progress.steps, lot, plan.eval_every, evaluated)

    def preview(self) -> list[str]:
        """What the run will do from where it stands, in a few lines, before it does anything."""
        plan, lot, ahead = self.plan, self._lot(), self.forecast()
        total, done, envs = plan.values["n_timesteps"], self.progress.steps, plan.values["n_envs"]
        asked = f" ({total:,} asked for; they come in lots of {lot:,})" if lot and ahead.steps != total else ""
        if lot is None:
            asked = " and to the end of that episode"
        behind = f", {done:,} of them done" if done else ""
        lines = [
            f"{self.kind.name} on {plan.name}: {ahead.steps:,} steps{asked}{behind}, "
            f"in {_some(envs, 'environment')}; {_some(ahead.validations, 'validation')} of "
            f"{plan.eval_episodes} episodes{'' if lot else ' at most'}"
        ]
        if self.lessons is not None:
            copied, before = plan.values["teacher_steps"], self.lessons.steps
            done_before = f", {before:,} of them done" if before else ""
            assert plan.teacher is not None
            whom = plan.teacher.policy.name
            lines.append(f"before that at least {copied:,} steps in which it copies {whom}{done_before}")
        alone = plan.values["critic_steps"]
        if alone > done:
            all_of_them = ", which is all of them" if alone >= ahead.steps else ""
            lines.append(f"in the first {alone:,} steps its critic alone learns{all_of_them}")
        if plan.task is None or plan.practice is None or plan.task == plan.practice:
            return lines
        unlike = differences(plan.practice, plan.task)
        lines.append(
            "what it is trained on differs from what it is scored on (trained -> scored); with --set "
            "env_kwargs.scenario={} it doesn't:"
        )
        lines += [f"  {line}" for line in unlike[:LINES]]
        return lines + ([f"  and {len(unlike) - LINES} more"] if len(unlike) > LINES else [])

    def train(self, bar: bool = True) -> None:
        """Train to the end of the budget, and leave everything in the folder.

        Args:
            bar: Whether to show progress.

        Raises:
            Interruption: The process was asked to stop; a checkpoint stands where it did.
            CommandError: A file can't be written; the last checkpoint stays whole.
        """
        from tqdm import tqdm

        total = self.plan.values["n_timesteps"]
        begun = time.perf_counter()
        # One that came while something was compiled has been swallowed there.
        interrupts.check()
        self._write_identity()
        logger = Logger(str(self.folder), [TensorBoardOutputFormat(str(self.folder / "tensorboard")), self._log()])
        self.model.set_logger(logger)
        try:
            with (
                tqdm(
                    total=self.forecast().steps,
                    initial=self.progress.steps,
                    unit="step",
                    unit_scale=True,
                    file=sys.stderr,
                    disable=not bar,
                ) as shown,
                interrupts.noted() as asked,
            ):
                callback = _Watch(self, shown, asked, begun)
                self._score_baselines()
                if self.lessons is not None:
                    callback.take(self.lessons)
                if total > self.progress.steps:
                    self._begin()
                    self.model.learn(
                        total - self.progress.steps, callback, log_interval=None, reset_num_timesteps=False
                    )
                callback.finish()
        finally:
            with suppress(OSError):
                logger.close()
            self.env.close()

    def _log(self) -> KVWriter:
        return _LogFile(self.folder / "train.log")

    def _write_identity(self) -> None:
        import yaml

        plan = self.plan
        document = {"command": self.command, "versions": files.versions(), **plan.to_dict()}
        if not (self.folder / "run.json").is_file():
            files.write_json(self.folder / "run.json", document)
        # Keyed as a settings file is, so that it can be trained with again.
        text = yaml.safe_dump({plan.env_id.rpartition(":")[2]: written(plan.values)}, sort_keys=False)
        files.write_text(self.folder / "settings.yaml", f"# {self.kind.name}; written by: {self.command}\n{text}")

    def _score_baselines(self) -> None:
        if self.plan.task is None:
            return
        for name in BASELINES:
            try:
                POLICIES[name].pilot(self.plan.task)
            except SettingError as error:
                print(f"{name} doesn't fly beside the agent: {error}", file=sys.stderr)
            else:
                self.baselines[name] = _scores(self._validated(POLICIES[name], self.plan.task))

    def _validated(self, policy: Policy, task: Scenario) -> list[dict[str, float]]:
        """The measures of a policy on the validation seeds."""
        seeds = ALL_VALIDATION[: self.plan.eval_episodes]
        flown = (fly(policy, task, own, wrapping=self.plan.wrapping) for own in batches(seeds, BATCH))
        return [row for flight in flown for row in flight.metrics.rows()]

    def evaluate(self) -> dict[str, Any]:
        """Fly the validation seeds with the present policy; keep it if none was better."""
        plan, steps = self.plan, self.model.num_timesteps
        if plan.task is not None:
            rows = self._validated(Policy("agent", "", lambda scenario: self.agent()), plan.task)
        else:
            rows = _fly_others(plan, self.model, self.statistics, ALL_VALIDATION[: plan.eval_episodes])
        found = {"steps": steps, **_scores(rows)}
        history = self.progress.evaluations
        history[:] = [each for each in history if each["steps"] < steps] + [found]
        best = self.progress.best
        if best is None or found["return"]["mean"] > best["return"]["mean"] or best is found:
            self.progress.best_steps = steps
            self._save(self.folder / saved.MODEL)
        return found

    def _save(self, path: Path) -> None:
        """Save the present agent whole or not at all."""
        plan, normalisation = self.plan, environments.normalisation_of(self.statistics)
        corrected = plan.corrected
        told, data = (None, None) if corrected is None else (corrected.told, corrected.data)
        around = " ".join(plan.wrapping.words)
        described = saved.describe(
            plan.env_id, plan.name, plan.algorithm, plan.values, plan.task, told, normalisation, around
        )
        checkpoints.save_agent(path, lambda file: archive.write(self.model, described, file, data))

    def checkpoint(self) -> None:
        """Write a checkpoint, and the files that tell of the run's progress.

        Raises:
            CommandError: It can't be written; the one before it stays.
        """
        self.progress.counters = {name: int(vars(self.model)[name]) for name in _COUNTERS}
        written = checkpoints.write(self.folder, self._fill)
        files.copy(written / _LAST, self.folder / _LAST)
        self.write_results()
        places.keep(self.folder)

    def tell(self) -> None:
        """Write again what tells of a run that has come to its end.

        Raises:
            CommandError: A file can't be written.
        """
        self._score_baselines()
        last = checkpoints.newest(self.folder)
        assert last is not None
        files.copy(last / _LAST, self.folder / _LAST)
        self.write_results()
        self.env.close()

    def _fill(self, folder: Path) -> None:
        self._save(folder / _LAST)
        if self.progress.best_steps is not None:
            files.copy(self.folder / saved.MODEL, folder / _BEST)
        if self.kind.off_policy:
            checkpoints.save_buffer(self.model.replay_buffer, folder / _BUFFER)
        if self.lessons is not None:
            self.lessons.save(folder / _LESSONS)
        if self.stood is not None:
            # What a policy that is corrected remembers may be anything.
            with suppress(TypeError):
                checkpoints.save_plain(folder / _STANDING, self.stood)
        files.write_json(folder / "progress.json", self.progress.__dict__)

    def write_results(self) -> None:
        """Write results.json and draw the learning curve."""
        plan, progress = self.plan, self.progress
        document = {
            "finished": progress.finished,
            **plan.to_dict(),
            "validation_seeds": [ALL_VALIDATION[0], ALL_VALIDATION[plan.eval_episodes - 1]],
            "steps": progress.steps,
            "wall_time_s": round(progress.seconds, 1),
            "steps_per_s": round(progress.steps / max(progress.learning_seconds, 1e-9)),
            "best": progress.best,
            "baselines": self.baselines,
            "evaluations": progress.evaluations,
        }
        scenarios = {"evaluation": plan.task, "training": plan.practice}
        files.write_results(self.folder, self.command, scenarios, document)
        title = f"{self.kind.name} on {plan.name}, seed {plan.seed}"
        figures.learning_curve(self.folder / "curve.png", title, progress.evaluations, self.baselines)


class _Watch(BaseCallback):
    """Shows progress, evaluates and writes checkpoints where all data collected so far has been learned from."""

    def __init__(self, run: Run, bar: Any, asked: list[int], begun: float) -> None:
        super().__init__()
        self._run = run
        self._bar = bar
        self._asked = asked
        self._last = begun
        self._before = (run.progress.seconds, run.progress.learning_seconds)
        self._clean_steps = run.progress.steps
        plan, done = run.plan, run.progress.steps
        evaluated = run.progress.evaluations
        # One that was due when the run stopped is made up.
        self._next_evaluation = _after(evaluated[-1]["steps"], plan.eval_every) if evaluated else done
        self._next_checkpoint = _after(done, plan.checkpoint_every)
        self._shown = 0.0

    def take(self, lessons: Lessons) -> None:
        """Copy the teacher; a checkpoint stands after each round.

        Raises:
            Interruption: The process was asked to stop; the round that was under way is lost.
        """
        run, rounds = self._run, lessons.rounds
        # What `fly` does shows up in the returns of episodes, which aren't the agent's.
        for steps in lessons.fly():
            self._bar.set_postfix_str(f"copied {steps:,} steps")
            if lessons.rounds > rounds or self._asked:
                rounds = run.progress.lessons = lessons.rounds
                self._count(learning=True)
                run.checkpoint()
                self._count(learning=False)
            if self._asked:
                raise Interruption(self._asked[0], run.progress.steps)
        run.lessons = None
        run.monitor.forget()

    def _on_rollout_start(self) -> None:
        run = self._run
        self._clean_steps = self.model.num_timesteps
        run.stood = standing.taken(self.model)
        if run.plan.values["critic_steps"]:
            hold(self.model.policy, self._clean_steps < run.plan.values["critic_steps"])
        self._count(learning=True)
        if self._asked:
            self._stop()
        due = self._clean_steps >= self._next_evaluation
        if due:
            self._evaluate()
            self._next_evaluation = _after(self._clean_steps, run.plan.eval_every)
        if due or self._clean_steps >= self._next_checkpoint:
            run.checkpoint()
            self._next_checkpoint = _after(self._clean_steps, run.plan.checkpoint_every)
        self._count(learning=False)

    def _on_step(self) -> bool:
        run, now = self._run, time.perf_counter()
        self._bar.update(self.model.num_timesteps - self._bar.n)
        if now - self._shown > 0.5:
            self._shown = now
            self._bar.set_postfix_str(self._text(), refresh=False)
        if self._asked:
            # This step is counted but not yet stored.
            self.model.num_timesteps -= run.env.num_envs
            self._stop()
        return True

    def _on_rollout_end(self) -> None:
        monitor = self._run.monitor
        if monitor.returns:
            self.logger.record("rollout/return", float(np.mean(monitor.returns)))
        if monitor.availabilities:
            self.logger.record("rollout/availability", float(np.mean(monitor.availabilities)))

    def _text(self) -> str:
        monitor = self._run.monitor
        parts = []
        if monitor.returns:
            parts.append(f"return {np.mean(monitor.returns):.1f}")
        if monitor.availabilities:
            parts.append(f"availability {np.mean(monitor.availabilities):.3f}")
        return ", ".join(parts)

    def _evaluate(self) -> None:
        found = self._run.evaluate()
        for key in ("return", "availability"):
            if key in found and found[key]["mean"] is not None:
                self.logger.record(f"eval/{key}", found[key]["mean"])
        self.logger.record("time/steps_per_s", self._rate())
        with files.named(self._run.folder / "tensorboard"):
            self.logger.dump(self.model.num_timesteps)

    def _rate(self) -> float:
        progress = self._run.progress
        return progress.steps / max(progress.learning_seconds, 1e-9)

    def _count(self, learning: bool) -> None:
        now = time.perf_counter()
        progress = self._run.progress
        progress.steps = self._clean_steps
        progress.seconds += now - self._last
        if learning:
            progress.learning_seconds += now - self._last
        self._last = now

    def _stop(self) -> None:
        run = self._run
        if not run.kind.off_policy:
            # The rollout that was begun hasn't been learned from, and won't be.
            self.model.num_timesteps = self._clean_steps
        elif self.model.num_timesteps != self._clean_steps:
            # Steps within a lot are stored already, and not to be taken again.
            run.stood = None
        self._clean_steps = self.model.num_timesteps
        self._count(learning=True)
        run.checkpoint()
        raise Interruption(self._asked[0], self._clean_steps)

    def finish(self) -> None:
        """Evaluate and keep what the run has come to."""
        run = self._run
        self.model = run.model
        self._clean_steps = run.model.num_timesteps
        run.stood = standing.taken(run.model)
        self._count(learning=True)
        if not run.progress.evaluations or run.progress.evaluations[-1]["steps"] != self._clean_steps:
            self._evaluate()
        self._count(learning=False)
        run.progress.finished = True
        run.checkpoint()
        self._bar.update(self._clean_steps - self._bar.n)


class _LogFile(KVWriter):
    """A line per evaluation in a text file that is added to."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def write(self, key_values: dict[str, Any], key_excluded: dict[str, tuple[str, ...]], step: int = 0) -> None:
        now = time.strftime("%Y-%m-%d %H:%M:%S")
        values = ", ".join(
            f"{key} {value:.5g}" for key, value in sorted(key_values.items()) if isinstance(value, (int, float))
        )
        with files.named(self._path), self._path.open("a", encoding="utf-8") as file:
            file.write(f"{now} step {step}: {values}\n")

    def close(self) -> None:
        """Nothing is held open."""


class Forecast(NamedTuple):
    """What a run will have come to at its end."""

    steps: int
    """Steps in all, whole lots of them."""
    validations: int
    """Validations still to come."""


def rollout(model: Any, off_policy: bool) -> int | None:
    """Steps that a model takes between two looks at its budget; None where it counts episodes."""
    if not off_policy:
        return int(model.n_steps * model.n_envs)
    return int(model.train_freq.frequency * model.n_envs) if model.train_freq.unit.value == "step" else None


def _some(count: int, what: str) -> str:
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def forecast(total: int, done: int, lot: int, every: int, evaluated: int | None) -> Forecast:
    """What a run will do.

    Args:
        total: Steps asked for.
        done: Steps that stand behind it.
        lot: Steps between two looks at the budget.
        every: Steps between validations, which wait for the end of a lot.
        evaluated: Step of the last validation; None if there was none.
    """
    lots = max(-(-(total - done) // lot), 0)
    steps = done + lots * lot
    if not lots:
        return Forecast(steps, int(evaluated != steps))
    # Before each lot one that has become due, and one at the end.
    last = steps - lot
    before = -1 if evaluated is None else evaluated // every
    return Forecast(steps, min(lots, max(last // every - before, 0)) + 1)


def _after(steps: int, every: int) -> int:
    """The next multiple of ``every`` above ``steps``."""
    return (steps // every + 1) * every


def _scores(rows: list[dict[str, float]]) -> dict[str, Any]:
    """Mean and interval of each measure over episodes."""
    found: dict[str, Any] = files.plain(tables.summaries(tables.columns(rows), 0))
    return found


def _fly_others(plan: Plan, model: Any, statistics: Any, seeds: range) -> list[dict[str, float]]:
    """Episodes of an environment that isn't ours, one at a time."""
    rows = []
    env = plan.wrapping.around(gym.make(plan.env_id, **plan.values["env_kwargs"]))
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        memory, stacked, total, begun, over = None, None, 0.0, np.ones(1, dtype=bool), False
        while not over:
            given = np.asarray(observation)[None]
            if statistics is not None:
                given = statistics.normalize_obs(given)
            if plan.values["frame_stack"] > 1:
                given = stacked = stack(stacked, given, begun, plan.values["frame_stack"])
            action, memory = model.predict(given, memory, begun, deterministic=True)
            observation, reward, terminated, truncated, _ = env.step(action[0])
            total, begun, over = total + float(reward), np.zeros(1, dtype=bool), terminated or truncated
        rows.append({"return": total})
    env.close()
    return rows

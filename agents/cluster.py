"""Who does tasks: processes of this machine, or Ray, on this machine or on a cluster of machines.

Ray moves tasks to nodes, and does one anew elsewhere when its node dies; a training then goes on from the checkpoint
that stands in its folder. Nothing else is asked of it, so that `ray` alone, without its libraries, suffices.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import os
import pickle
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import uwoc_gym
from uwoc_gym import baselines
from uwoc_gym.agents import interrupts, work
from uwoc_gym.agents.errors import CommandError, require
from uwoc_gym.agents.reports import files
from uwoc_gym.agents.work import Answer, Crew, Hands, Here, Task

RETRIES = 10
"""How often a task is begun anew because the node or the process that did it has died."""

_LOOK_S = 0.5
"""Time between two looks at whether it was asked to stop [s]."""

_PATIENCE_S = 120.0
"""How long tasks that were asked to stop may put away what they keep [s]."""


@contextmanager
def workers(jobs: int | None, on: str | None = None) -> Iterator[Hands]:
    """Those who do tasks, until the block ends.

    Args:
        jobs: How many tasks at a time, each in a process of its own with one thread; one at a time they are done in
            this process. None for as many as there are cores.
        on: Where: None for this machine, else what `Cluster` takes.

    Raises:
        CommandError: There is nobody.
    """
    hands: Hands
    if on is not None:
        hands = Cluster(on, jobs)
    else:
        jobs = jobs or work.cores()
        hands = Here() if jobs == 1 else Crew(jobs)
    try:
        yield hands
    finally:
        hands.close()


class Cluster:
    """Those who do tasks on Ray.

    Args:
        on: "ray", for Ray on this machine, or "ray://HOST:PORT", for a cluster's Ray client server.
        jobs: How many tasks at a time; None for as many as there are cores.

    Raises:
        CommandError: Ray isn't installed, or nobody answers there.
    """

    def __init__(self, on: str, jobs: int | None) -> None:
        require("ray")
        # Who uses this package hasn't been asked by Ray whether they want to be counted.
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        import ray

        self._ray: Any = ray
        self._most = jobs
        self._under_way: dict[Any, tuple[int, Task]] = {}
        here: dict[str, Any] = {"address": "local", "num_cpus": jobs or work.cores(), "include_dashboard": False}
        try:
            ray.init(
                **(here if on == "ray" else {"address": on}),
                namespace="uwoc-gym",
                log_to_driver=False,
                logging_level=logging.ERROR,
                runtime_env={"env_vars": dict.fromkeys(work.THREADS, "1")},
            )
        except (ConnectionError, TimeoutError, RuntimeError, ValueError) as error:
            raise CommandError(f"--on {on}: no Ray cluster answers there: {_line(error)}") from None
        self._do = ray.remote(outpost())

    @property
    def jobs(self) -> int:
        """See `Hands`; nodes come and go."""
        there = int(self._ray.cluster_resources().get("CPU", 1))
        return max(there if self._most is None else min(there, self._most), 1)

    def begin(self, number: int, task: Task) -> None:
        """See `Hands`."""
        do = self._do.options(name=task.name, num_cpus=1, max_retries=RETRIES)
        self._under_way[do.remote(pickle.dumps(task), same(), os.getcwd())] = number, task

    def answers(self) -> Sequence[Answer]:
        """See `Hands`."""
        done, _ = self._ray.wait(list(self._under_way), timeout=_LOOK_S)
        return [self._answer(ref) for ref in done]

    def _answer(self, ref: Any) -> Answer:
        number, task = self._under_way.pop(ref)
        try:
            good, found = self._ray.get(ref)
        except self._ray.exceptions.RayError as error:
            return Answer(number, False, CommandError(f"{task.name}: {_line(error)}"))
        if isinstance(found, str):
            # No class of this package could be told.
            found = CommandError(found)
        return Answer(number, good, pickle.loads(found) if good else found)

    def stop(self) -> None:
        """See `Hands`."""
        refs = list(self._under_way)
        self._under_way.clear()
        for force in (False, True):
            for ref in refs:
                with suppress(self._ray.exceptions.RayError, ValueError):
                    self._ray.cancel(ref, force=force)
            if refs:
                _, refs = self._ray.wait(refs, num_returns=len(refs), timeout=_PATIENCE_S)

    def close(self) -> None:
        """See `Hands`."""
        self.stop()
        self._ray.shutdown()


def _line(error: BaseException) -> str:
    """The line that says what went wrong: the first, or where it hands on a traceback, the last."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()] or [type(error).__name__]
    return lines[-1 if any(line.startswith("Traceback") for line in lines) else 0][:300]


@functools.cache
def same() -> dict[str, str]:
    """What nodes must have in common for results to be the same, bit for bit: versions, and this package's files."""
    digest = hashlib.sha256()
    for module in (uwoc_gym.__file__, baselines.__file__, __file__):
        assert module is not None
        folder = Path(module).parent
        for path in sorted(folder.rglob("*")):
            if path.suffix in (".py", ".json", ".npz", ".yaml"):
                digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return {**files.versions(), "code of uwoc-gym": digest.hexdigest()[:16]}


def outpost() -> Callable[[bytes, Mapping[str, str], str], tuple[bool, Any]]:
    """What Ray calls on a node. Made here so that it goes there by value: the node may lack this package."""

    def do(task: bytes, wanted: Mapping[str, str], folder: str) -> tuple[bool, Any]:
        try:
            from uwoc_gym.agents.cluster import perform
        except ImportError as error:
            import platform

            return False, (
                f"on node {platform.node()} uwoc-gym {wanted['uwoc-gym']} isn't installed ({error}); install there "
                "what is here."
            )
        return perform(task, wanted, folder)

    return do


def perform(task: bytes, wanted: Mapping[str, str], folder: str) -> tuple[bool, Any]:
    """Do a task on a node.

    Args:
        task: A pickled `Task`.
        wanted: What `same` gives where it was made.
        folder: Where paths in it begin, if this node has that folder.

    Returns:
        Whether it was done, and its result, pickled, or an error that says where it was raised.
    """
    here = same()
    unlike = [f"{name} is {here.get(name)}, here {wanted[name]}" for name in wanted if here.get(name) != wanted[name]]
    if unlike:
        return False, CommandError(f"on node {platform.node()} {', '.join(unlike)}; install there what is here.")
    work.take_one_thread()
    with suppress(OSError):
        os.chdir(folder)
    with interrupts.heard():
        try:
            good, found = work.attempt(pickle.loads(task))
            if good:
                found = pickle.dumps(found)
        except Exception as error:
            good, found = False, work.portable(error)
    if not good and isinstance(found, (CommandError, OSError)):
        found = CommandError(f"{found} (on node {platform.node()})")
    return good, found

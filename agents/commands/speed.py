"""`uwoc-gym speed`: steps per second, side by side with Gymnasium's CartPole in the same run."""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numba
import numpy as np

from uwoc_gym.agents.errors import require
from uwoc_gym.agents.options import number, whole
from uwoc_gym.agents.reports import files, tables
from uwoc_gym.baselines import NLPDController
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import SCENARIOS
from uwoc_gym.sim.fleet import Autoreset, Fleet
from uwoc_gym.sim.layout import FLAGS, MEASURE_NAMES
from uwoc_gym.sim.paper import step_one

HELP = "measure steps per second against Gymnasium's CartPole-v1"
EXAMPLES = """\
examples:
  uwoc-gym speed
  uwoc-gym speed --rounds 9 --time 1 --out speed
  uwoc-gym speed --render
  uwoc-gym speed --cold
"""

REFERENCE = "CartPole-v1"
ENVS = {"uwoc/Nominal-v0": 1.0, "uwoc/Random-v0": 0.6}
"""Share of the targets that each environment is to reach."""
TARGETS = {1: 2.5, 64: 5.0, 1024: 1.1}
"""Wanted ratio of env-steps per second to the reference's by number of environments; 1 is the single environment."""
COLD_TARGETS = {"single, cold": 7.0, "vector, cold": 1.0, "single, cached": 1.5}
"""Wanted CPU time of a first use [s], on a quiet core; import included where compiled code is in the cache."""

_ACTIONS = 512


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the command's options."""
    parser.add_argument("--rounds", type=whole("rounds"), default=5, metavar="N", help="rounds (default: %(default)s)")
    parser.add_argument(
        "--time",
        type=number("seconds", high=3600.0),
        default=0.4,
        metavar="S",
        help="time per measurement and round [s] (default: %(default)s)",
    )
    parser.add_argument(
        "--sizes",
        type=whole("environments"),
        nargs="+",
        default=[1, 64, 1024],
        metavar="N",
        help="numbers of environments, 1 for the single environment (default: 1 64 1024)",
    )
    parser.add_argument(
        "--fleet",
        type=whole("environments"),
        default=65536,
        metavar="N",
        help="simulations for the memory (default: %(default)s)",
    )
    parser.add_argument("--seed", type=whole("seed"), default=0, metavar="S", help="seed (default: %(default)s)")
    other = parser.add_mutually_exclusive_group()
    other.add_argument("--render", action="store_true", help="measure pictures per second instead")
    other.add_argument(
        "--cold", action="store_true", help="measure the first use instead: with an empty cache, and with a full one"
    )
    parser.add_argument("--out", metavar="DIR", help="folder for results.json")


class _Runner(NamedTuple):
    """Takes at least so many steps and returns the environments' steps taken."""

    run: Callable[[int], int]
    close: Callable[[], None]


def _single(env_id: str, seed: int) -> _Runner:
    env = gym.make(env_id)
    env.action_space.seed(seed)
    actions = [env.action_space.sample() for _ in range(_ACTIONS)]
    env.reset(seed=seed)

    def run(steps: int) -> int:
        step, reset = env.step, env.reset
        rounds = -(-steps // _ACTIONS)
        for _ in range(rounds):
            for action in actions:
                _, _, terminated, truncated, _ = step(action)
                if terminated or truncated:
                    reset()
        return rounds * _ACTIONS

    return _Runner(run, env.close)


def _vector(env_id: str, size: int, seed: int) -> _Runner:
    env = gym.make_vec(env_id, num_envs=size, vectorization_mode="vector_entry_point")
    env.action_space.seed(seed)
    actions = [env.action_space.sample() for _ in range(16)]
    env.reset(seed=seed)

    def run(steps: int) -> int:
        step = env.step
        rounds = -(-steps // (16 * size))
        for _ in range(rounds):
            for action in actions:
                step(action)
        return rounds * 16 * size

    return _Runner(run, env.close)


def _rate(runner: _Runner, steps: int) -> float:
    begun = time.perf_counter()
    done = runner.run(steps)
    return done / (time.perf_counter() - begun)


def _steps_for(runner: _Runner, duration: float) -> int:
    """Steps that take about that long [s], from a short trial that also compiles what needs it."""
    runner.run(1)
    steps = 1
    while True:
        begun = time.perf_counter()
        done = runner.run(steps)
        taken = time.perf_counter() - begun
        if taken >= 0.05 or taken >= 0.2 * duration:
            return max(1, int(done * duration / taken))
        steps = 4 * done


@numba.njit
def _many(count, memory, action, observation):  # type: ignore[no-untyped-def]
    for _ in range(count):
        step_one(memory, action, observation)  # type: ignore[no-untyped-call]


def _kernel_runner(name: str, seed: int) -> _Runner:
    """A fleet of one stepped from compiled code, so that no Python runs between steps."""
    scenario = SCENARIOS[name].merged({"episode": {"lost_distance_m": 1e6}})
    fleet = Fleet(scenario, 1, max_episode_steps=2**53)
    fleet.seed(np.zeros(1, dtype=np.int64), [seed])
    observations = np.zeros((1, scenario.observation.size), dtype=np.float32)
    fleet.reset(observations)
    action = np.random.default_rng(seed).uniform(-1.0, 1.0, len(scenario.actions)).astype(np.float32)

    def run(steps: int) -> int:
        _many(steps, fleet.memory, action, observations[0])
        return steps

    return _Runner(run, fleet.close)


def _resident_bytes() -> int | None:
    """The process's resident memory [bytes], where the system tells."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return None
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("VmRSS:")), None)


def _memory(name: str, size: int, seed: int) -> dict[str, Any]:
    """Memory of a fleet, counted from its arrays and seen from outside after a step."""
    before = _resident_bytes()
    scenario = SCENARIOS[name]
    fleet = Fleet(scenario, size, Autoreset.NEXT_STEP)
    observations = np.zeros((size, scenario.observation.size), dtype=np.float32)
    out = np.empty((len(MEASURE_NAMES), size))
    fleet.seed(np.arange(size), [seed + i for i in range(size)])
    fleet.reset(observations)
    flags = np.zeros((len(FLAGS), size), dtype=np.bool_)
    fleet.step(np.zeros((size, len(scenario.actions)), dtype=np.float32), observations, out, flags)
    after = _resident_bytes()
    return {
        "simulations": size,
        "state_bytes": fleet.memory.nbytes,
        "outputs_bytes": observations.nbytes + out.nbytes,
        "resident_growth_bytes": None if before is None or after is None else after - before,
    }


def measure(args: argparse.Namespace) -> dict[str, Any]:
    """All measurements as plain data."""
    sizes = list(dict.fromkeys(args.sizes))
    runners: dict[tuple[str, int], _Runner] = {}
    for size in sizes:
        for env_id in (REFERENCE, *ENVS):
            runners[env_id, size] = _single(env_id, args.seed) if size == 1 else _vector(env_id, size, args.seed)
    for env_id in ENVS:
        runners[env_id, 0] = _kernel_runner(env_id.removeprefix("uwoc/").removesuffix("-v0"), args.seed)
    steps = {key: _steps_for(runner, args.time) for key, runner in runners.items()}
    rounds: dict[tuple[str, int], list[float]] = {key: [] for key in runners}
    # In turns, so that whatever else the machine does meets all of them alike.
    for _ in range(args.rounds):
        for key, runner in runners.items():
            rounds[key].append(_rate(runner, steps[key]))
    for runner in runners.values():
        runner.close()
    median = {key: statistics.median(values) for key, values in rounds.items()}
    rates = []
    for env_id, share in ENVS.items():
        name = env_id.removeprefix("uwoc/").removesuffix("-v0")
        substeps = SCENARIOS[name].episode.substeps
        for size in sizes:
            ratios = [own / other for own, other in zip(rounds[env_id, size], rounds[REFERENCE, size], strict=True)]
            target = TARGETS.get(size)
            rates.append(
                {
                    "env": env_id,
                    "num_envs": size,
                    "steps_per_s": median[env_id, size],
                    "reference_steps_per_s": median[REFERENCE, size],
                    "ratio": statistics.median(ratios),
                    "target_ratio": None if target is None else target * share,
                    "integration_steps_per_s": median[env_id, size] * substeps,
                    "rounds": rounds[env_id, size],
                    "reference_rounds": rounds[REFERENCE, size],
                }
            )
    python = [
        {
            "env": env_id,
            "kernel_s": 1.0 / median[env_id, 0],
            "step_s": 1.0 / median[env_id, 1],
            "share": 1.0 - median[env_id, 1] / median[env_id, 0],
        }
        for env_id in ENVS
        if 1 in sizes
    ]
    return {"reference": REFERENCE, "rates": rates, "python_at_1": python, "memory": _memory("Nominal", args.fleet, 0)}


def measure_pictures(args: argparse.Namespace) -> dict[str, Any]:
    """Pictures per second of an environment that is stepped and drawn in turns, as recording does."""
    env = gym.make("uwoc/StrongPulse-v0", render_mode="rgb_array")
    own: Any = env.unwrapped
    pilot = NLPDController(scenario=own.scenario)

    def fly(pictures: int) -> int:
        observation, _ = env.reset(seed=args.seed)
        for _ in range(pictures):
            observation, _, terminated, truncated, _ = env.step(pilot.predict(observation)[0])
            env.render()
            if terminated or truncated:
                observation, _ = env.reset()
        return pictures

    runner = _Runner(fly, env.close)
    pictures = _steps_for(runner, args.time)
    rounds = [_rate(runner, pictures) for _ in range(args.rounds)]
    runner.close()
    return {"size": list(own.render_size), "pictures_per_s": statistics.median(rounds), "rounds": rounds}


# In a process of its own, which imports nothing else before.
_FIRST_USE = """
import json, time
begun = time.process_time()
import gymnasium, numpy
import uwoc_gym
from numba.core import event

class Parts(event.Listener):
    def __init__(self):
        self.open, self.own = [], {}
    def on_start(self, happening):
        self.open.append([time.process_time(), 0.0])
    def on_end(self, happening):
        start, inside = self.open.pop()
        taken = time.process_time() - start
        if self.open:
            self.open[-1][1] += taken
        part = happening.data["dispatcher"].py_func.__module__
        self.own[part] = self.own.get(part, 0.0) + taken - inside

parts = Parts()
event.register("numba:compile", parts)
marks = [time.process_time() - begun]
env = gymnasium.make("uwoc/Random-v0")
env.reset(seed=0)
env.step(numpy.zeros(3, numpy.float32))
marks.append(time.process_time() - begun)
envs = gymnasium.make_vec("uwoc/Random-v0", num_envs=4, vectorization_mode="vector_entry_point")
envs.reset(seed=0)
envs.step(numpy.zeros((4, 3), numpy.float32))
marks.append(time.process_time() - begun)
print(json.dumps({"marks": marks, "parts": parts.own}))
"""


def measure_first_use() -> dict[str, Any]:
    """CPU time of the first use with an empty cache and with a full one, and of each part that is compiled [s]."""
    found = []
    with tempfile.TemporaryDirectory() as cache:
        for _ in range(2):
            command = [sys.executable, "-c", _FIRST_USE]
            environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
            found.append(
                json.loads(subprocess.check_output(command, env=environment, text=True, start_new_session=True))
            )
    (imported, single, vector), (_, cached, _) = (each["marks"] for each in found)
    return {
        "cpu_s": {"single, cold": single - imported, "vector, cold": vector - single, "single, cached": cached},
        "import_s": imported,
        "parts_s": dict(sorted(found[0]["parts"].items(), key=lambda part: -part[1])),
    }


def _cold_table(data: dict[str, Any]) -> str:
    words = {
        "single, cold": "gym.make to the first step, empty cache",
        "vector, cold": "a vector environment after that",
        "single, cached": "import and first step, full cache",
    }
    lines = [[words[key], f"{value:.2f}", f"≤ {COLD_TARGETS[key]:g}"] for key, value in data["cpu_s"].items()]
    text = tables.grid(["first use", "CPU s", "target"], lines) + "\n\n"
    parts = [[name, f"{value:.2f}"] for name, value in data["parts_s"].items()]
    return text + tables.grid(["compiled part", "CPU s"], parts) + "\n"


def _table(data: dict[str, Any]) -> str:
    header = ["env", "envs", "steps/s", "ns a step", f"{REFERENCE} steps/s", "ratio", "target", "integration steps/s"]
    lines = []
    for row in data["rates"]:
        target = "–" if row["target_ratio"] is None else f"≥ {row['target_ratio']:g}"
        numbers = [f"{row[key]:,.0f}" for key in ("steps_per_s", "reference_steps_per_s")]
        integration = f"{row['integration_steps_per_s']:,.0f}"
        numbers.insert(1, f"{1e9 / row['steps_per_s']:,.0f}")
        lines.append([row["env"], str(row["num_envs"]), *numbers, f"{row['ratio']:.2f}", target, integration])
    text = tables.grid(header, lines) + "\n\n"
    for row in data["python_at_1"]:
        text += (
            f"{row['env']}, single: {1e6 * row['step_s']:.2f} µs a step, of which compiled code "
            f"{1e6 * row['kernel_s']:.2f} µs; Python's share {row['share']:.0%}\n"
        )
    memory = data["memory"]
    growth = memory["resident_growth_bytes"]
    each = memory["state_bytes"] / memory["simulations"]
    text += (
        f"fleet of {memory['simulations']}: {memory['state_bytes'] / 2**20:.1f} MiB of state, {each:.0f} bytes a lane"
    )
    text += "\n" if growth is None else f", resident memory grew by {growth / 2**20:.1f} MiB with its outputs\n"
    return text


def run(args: argparse.Namespace) -> int:
    """Measure and print; returns the exit status."""
    if args.render:
        require("pygame")
    folder = files.output_folder(args.out) if args.out else None
    if args.render:
        data = measure_pictures(args)
        width, height = data["size"]
        print(f"{data['pictures_per_s']:.0f} pictures of {width}x{height} per second, steps included")
    elif args.cold:
        data = measure_first_use()
        print(_cold_table(data), end="")
    else:
        data = measure(args)
        print(_table(data), end="")
    if folder is not None:
        settings = {"rounds": args.rounds, "time_s": args.time, "seed": args.seed}
        names = ["StrongPulse"] if args.render else ["Random"] if args.cold else [ENV_IDS[env_id] for env_id in ENVS]
        scenarios = {name: SCENARIOS[name] for name in names}
        files.write_results(folder, args.command_line, scenarios, {"settings": settings, **data})
    return 0

"""Share of planted faults that the tests notice: ``python -m tests.trust.mutants [--only NAME ...] [--jobs N]``.

Each fault is a small change of the source that a tired hand could make. It is planted in a copy of the tree, of which
the few tests that should notice are run, mostly those of the file that mirrors the changed one. Digests of whole
flights aren't among them: they notice nearly everything and say nothing of what is wrong.
"""

from __future__ import annotations

import argparse
import os
import queue
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
COPIED = ("uwoc_gym", "agents", "baselines", "tests", "pyproject.toml", "uwoc_gym_command.py")
TIME_LIMIT_S = 600.0


class Fault(NamedTuple):
    """A change of one place in the source that tests should notice."""

    name: str
    what: str
    file: str
    text: str
    """Stands exactly once in the file."""
    instead: str
    tests: str
    """What pytest is given: files, and with -k a choice of them."""

    @property
    def compiled(self) -> bool:
        """Whether the core has to be compiled anew."""
        return self.file.startswith("uwoc_gym/") and self.file not in _NOT_COMPILED


class Verdict(NamedTuple):
    """What came of a fault."""

    fault: Fault
    noticed_by: str
    """The first test that failed; empty if none did."""
    seconds: float
    output: str


_AUV, _LINK, _PATHS = (f"uwoc_gym/world/{name}.py" for name in ("auv/horizontal", "optics/link", "ship/paths"))
_STEP, _FLEET = "uwoc_gym/sim/paper.py", "uwoc_gym/sim/fleet.py"
_NOT_COMPILED = (_FLEET, *(f"uwoc_gym/{name}.py" for name in ("sb3", "spaces", "vector_env")))
"""Files of the core's package that the compiled code knows nothing of."""
_AUV_TESTS, _LINK_TESTS, _PATHS_TESTS = (
    f"tests/uwoc_gym/world/{name}.py" for name in ("auv/test_horizontal", "optics/test_link", "ship/test_paths")
)
_FLEET_TESTS, _SB3_TESTS = "tests/uwoc_gym/sim/test_fleet.py", "tests/uwoc_gym/test_sb3.py"
_PLANNING_TESTS = "tests/uwoc_gym/sim/test_planning.py"

PHYSICS = (
    Fault(
        "coriolis-sign", "yaw moment of the Coriolis terms with the other sign", _AUV,
        "coriolis * (m11 - m22) / m33)", "coriolis * (m22 - m11) / m33)", _AUV_TESTS,
    ),
    Fault(
        "damping-factor", "half the quadratic damping", _AUV,
        "fma(quadratic, abs(velocity), linear)", "fma(0.5 * quadratic, abs(velocity), linear)", _AUV_TESTS,
    ),
    Fault(
        "rk4-weight", "weights of RK4's last two stages swapped, in sway", _AUV,
        "fma(2.0, av2 + av3, av1 + av4)", "fma(2.0, av2 + av4, av1 + av3)", _AUV_TESTS,
    ),
    Fault(
        "link-exponent", "bit rate falls with the square of the range instead of its fourth power", _LINK,
        "return -4.0, -2.0 * attenuation,", "return -2.0, -2.0 * attenuation,", _LINK_TESTS,
    ),
    Fault(
        "solar-noise", "sunlight attenuated once on its way down instead of twice", _LINK,
        "(1.0 if surface else loss * loss)", "(1.0 if surface else loss)", f"{_LINK_TESTS} {_FLEET_TESTS} -k measures",
    ),
    Fault(
        "cone-test", "link inside the slant height, whatever the field of view", _LINK,
        "inside = visible and (range_m <= o.slant_height_m[j])", "inside = range_m <= o.slant_height_m[j]",
        f"{_FLEET_TESTS} -k measures",
    ),
    Fault(
        "pulse-share", "a pulse acts throughout each step that it touches", "uwoc_gym/world/sea/pulses.py",
        "share = max(0.0, min(t + h, end) - max(t, start)) / h", "share = float(min(t + h, end) > max(t, start))",
        "tests/uwoc_gym/world/sea/test_pulses.py",
    ),
    Fault(
        "current-drift", "the current along x carries the AUV along y", _AUV,
        "fma(duration_s, b.water.y[j], b.auv.y[j])", "fma(duration_s, b.water.x[j], b.auv.y[j])",
        "tests/uwoc_gym/world/sea/test_current.py",
    ),
    Fault(
        "gauss-markov", "fresh part of the random current too small to keep its spread",
        "uwoc_gym/world/sea/current.py",
        "math.sqrt(1.0 - keep * keep)", "math.sqrt(1.0 - keep)", "tests/uwoc_gym/world/sea/test_current.py",
    ),
    Fault(
        "noise-axis", "the same error of position along x and y", "uwoc_gym/world/auv/sensors.py",
        "o.error_y[j] = p.position_std_m[j] * n1", "o.error_y[j] = p.position_std_m[j] * n0",
        "tests/uwoc_gym/world/auv/test_sensors.py",
    ),
    Fault(
        "ship-acceleration", "the ship accelerates away from its circle's centre, along y", _PATHS,
        "s.ay[j] = fma(-(ry * rate2), sine, 0.0)", "s.ay[j] = fma(ry * rate2, sine, 0.0)", _PATHS_TESTS,
    ),
    Fault(
        "ship-yaw-acceleration", "half of a term of a random path's yaw acceleration", _PATHS,
        "fma(-2.0 * rate, fma(vx, ax, vy * ay), bend)", "fma(-rate, fma(vx, ax, vy * ay), bend)", _PATHS_TESTS,
    ),
)  # fmt: skip

TASK = (
    Fault(
        "yaw-wrap", "a whole turn of yaw counts as an error of heading", "uwoc_gym/task/reward.py",
        "yaw_error = wrap(b.ship.yaw[j] - b.auv.yaw[j])", "yaw_error = b.ship.yaw[j] - b.auv.yaw[j]",
        f"{_FLEET_TESTS} -k reward",
    ),
    Fault(
        "reward-weight", "the cone's reward has the bit rate's weight", "uwoc_gym/task/reward.py",
        "w.in_cone * b.measure.in_cone[j]", "w.bit_rate * b.measure.in_cone[j]", f"{_FLEET_TESTS} -k reward",
    ),
    Fault(
        "effort", "effort is a mean over three actions, however many there are", "uwoc_gym/task/reward.py",
        "(w.effort / world.scenario.actuators)", "(w.effort / 3.0)", f"{_FLEET_TESTS} -k reward",
    ),
    Fault(
        "lost-distance", "the link is lost by its range instead of its horizontal distance", "uwoc_gym/task/ending.py",
        "lost = (b.link.distance_m[j] >", "lost = (b.measure.range_m[j] >",
        f"{_FLEET_TESTS} tests/uwoc_gym/test_env.py -k 'lost or flags'",
    ),
    Fault(
        "success-rule", "a last third in the cone to the very step is no success", "uwoc_gym/task/ending.py",
        "(3.0 * last_outside <= 2.0 * step)", "(3.0 * last_outside < 2.0 * step)", f"{_FLEET_TESTS} -k success",
    ),
    Fault(
        "time-limit", "episodes last a step too long", "uwoc_gym/task/ending.py",
        "late = step >= world.episode.max_steps", "late = step > world.episode.max_steps",
        "tests/uwoc_gym/test_env.py -k 'duration or time_limit'",
    ),
    Fault(
        "observation-scale", "yaw acceleration observed by the scale of acceleration", "uwoc_gym/task/observation.py",
        "_limited(c * ship.yaw_acceleration[j])", "_limited(a * ship.yaw_acceleration[j])",
        f"{_FLEET_TESTS} tests/uwoc_gym/task/test_observation.py -k 'observation or groups or unpack'",
    ),
    Fault(
        "action-clip", "the yaw moment isn't clipped", "uwoc_gym/task/action.py",
        "can.yaws * _clipped(numbers[3 * place + 2])", "can.yaws * float(numbers[3 * place + 2])",
        f"{_AUV_TESTS} tests/uwoc_gym/test_env.py -k clipped",
    ),
)  # fmt: skip

_KEEP_FINAL = """\
                    for k in range(observations.shape[1]):
                        finals[begin + j, k] = observations[begin + j, k]
"""
_RESTART = "                    _restart(memory, world, s, b, j, entries, begin + j)\n"

SIM = (
    Fault(
        "autoreset-order", "the last observation is kept after the next episode has begun", _STEP,
        _KEEP_FINAL + _RESTART, _RESTART + _KEEP_FINAL, f"{_FLEET_TESTS} -k autoreset",
    ),
    Fault(
        "snapshot-row", "a snapshot takes every simulation from the first block", _FLEET,
        "rows = np.ascontiguousarray(self._memory.rows[which // LANES, :, which % LANES])",
        "rows = np.ascontiguousarray(self._memory.rows[0 * which, :, which % LANES])", _PLANNING_TESTS,
    ),
    Fault(
        "seed-key", "seeds beyond 32 bits lose their upper half", "uwoc_gym/compute/rng.py",
        "return float(seed & 0xFFFFFFFF), float(seed >> 32)", "return float(seed & 0xFFFFFFFF), 0.0",
        "tests/uwoc_gym/compute/test_rng.py",
    ),
    Fault(
        "draw-counter", "every episode of a seed draws the same", "uwoc_gym/compute/rng.py",
        "np.uint64(b.random.episode[j]) & _LOW,", "np.uint64(0),", "tests/uwoc_gym/compute/test_rng.py",
    ),
    Fault(
        "pulse-counter", "the second pulse's numbers move", "uwoc_gym/compute/rng.py",
        "len(_FROZEN) + 6 * int(pulse[1])", "len(_FROZEN) + 5 * int(pulse[1])", "tests/uwoc_gym/compute/test_rng.py",
    ),
    Fault(
        "thread-split", "only the first thread's share is flown", _FLEET,
        "starts = range(0, self.size, share)", "starts = range(0, share, share)", f"{_FLEET_TESTS} -k threads",
    ),
    Fault(
        "restore-current", "a restored current doesn't flow", _FLEET,
        "        self._let_flow(numbers[:, layout.CURRENT])\n", "", _PLANNING_TESTS,
    ),
    Fault(
        "rollout-end", "a copy earns on after its episode's end", _STEP,
        "b.ending.ended[j] = 1.0\n                else:", "b.ending.ended[j] = 0.0\n                else:",
        f"{_PLANNING_TESTS} -k rollout",
    ),
)  # fmt: skip

SHELLS = (
    Fault(
        "reward-dtype", "Stable-Baselines3 gets rewards in double precision", "uwoc_gym/sb3.py",
        "rewards.astype(np.float32), done", "rewards, done", f"{_SB3_TESTS} -k equals",
    ),
    Fault(
        "terminal-observation", "the terminal observation is the next episode's first", "uwoc_gym/sb3.py",
        'last, final = infos["final_obs"], ', "last, final = observations, ", f"{_SB3_TESTS} -k equals",
    ),
    Fault(
        "time-limit-truncated", "an episode lost in its last step counts as cut short by time", "uwoc_gym/sb3.py",
        "bool(truncated[i] and not terminated[i])", "bool(truncated[i])", _SB3_TESTS,
    ),
    Fault(
        "info-mask", "infos of a partial reset claim to be of all environments", "uwoc_gym/vector_env.py",
        'infos |= {f"_{name}": mask.copy() for name', 'infos |= {f"_{name}": self._all for name',
        "tests/uwoc_gym/test_vector_env.py",
    ),
    Fault(
        "spec-digest", "a spec doesn't record its scenario", "uwoc_gym/spaces.py",
        '"scenario_digest": self.scenario.digest()}', '"scenario_digest": None}',
        "tests/uwoc_gym/test_env.py -k spec",
    ),
)  # fmt: skip

_AGENT, _SAVES = "agents/policies/agent.py", "agents/learning/checkpoints.py"
_ARCHIVE, _ARCHIVE_TESTS = "agents/policies/archive.py", "tests/agents/policies/test_archive.py"
_SAVES_TESTS, _FOREIGN_TESTS = "tests/agents/learning/test_checkpoints.py", "tests/agents/policies/test_foreign.py"

AGENTS = (
    Fault(
        "arrival", "who begins inside the cone arrives a sample later", "uwoc_gym/metrics.py",
        "return _first(np.asarray(time_s, dtype=float), inside)",
        "return _first(np.asarray(time_s, dtype=float)[1:], inside[1:])", "tests/uwoc_gym/test_metrics.py",
    ),
    Fault(
        "availability", "the start counts as a control period", "uwoc_gym/metrics.py",
        "inside[1:].mean(axis=0)", "inside.mean(axis=0)", "tests/uwoc_gym/test_metrics.py",
    ),
    Fault(
        "paired-seed", "each policy has resamples of its own", "agents/reports/comparison.py",
        "rng = np.random.default_rng(0)", "rng = np.random.default_rng(len(found))",
        "tests/agents/reports/test_comparison.py",
    ),
    Fault(
        "percentile", "intervals are basic ones instead of percentiles", "agents/reports/statistics.py",
        'method="percentile"', 'method="basic"', "tests/agents/reports/test_statistics.py",
    ),
    Fault(
        "held-out-seeds", "the first run trains on validation's and held-out seeds", "agents/learning/seeds.py",
        "SPAN * (run_seed + 1) + first", "SPAN * run_seed + first", "tests/agents/learning/test_seeds.py",
    ),
    Fault(
        "residual-scale", "a correction isn't scaled", "agents/policies/residual.py",
        "np.float32(scale) * np.asarray(action, dtype=np.float32)", "np.asarray(action, dtype=np.float32)",
        "tests/agents/policies/test_residual.py",
    ),
    Fault(
        "frame-order", "stacked frames lose the newest instead of the oldest", _AGENT,
        "0.0, stacked[:, size:])", "0.0, stacked[:, :-size])", "tests/agents/policies/test_saved.py",
    ),
    Fault(
        "frame-start", "stacked frames outlive their episode", _AGENT,
        "np.where(episode_start[:, None], 0.0, stacked[:, size:])", "stacked[:, size:]",
        "tests/agents/policies/test_saved.py",
    ),
    Fault(
        "normalisation-epsilon", "epsilon added to the deviation instead of the variance", _ARCHIVE,
        "np.sqrt(seen.variance + self.epsilon)", "(np.sqrt(seen.variance) + self.epsilon)",
        f"{_ARCHIVE_TESTS} -k 'bit_for_bit'",
    ),
    Fault(
        "normalisation-clip", "normalised observations clipped to Stable-Baselines3's default", _ARCHIVE,
        "np.clip(scaled, -self.clip, self.clip)", "np.clip(scaled, -10.0, 10.0)", f"{_ARCHIVE_TESTS} -k 'bit_for_bit'",
    ),
    Fault(
        "weights-digest", "weights of another agent are flown", _ARCHIVE,
        ".hexdigest() != digest:", '.hexdigest() == "":', f"{_ARCHIVE_TESTS} -k another",
    ),
    Fault(
        "agent-in-place", "an agent is written over the one before", _SAVES,
        'with whole(path) as part, part.open("w+b") as file:', 'with path.open("w+b") as file:', _SAVES_TESTS,
    ),
    Fault(
        "checkpoint-part", "a checkpoint that a kill cut short is taken for one", _SAVES,
        "if path.is_dir() and path.name[len(_PREFIX) :].isdigit()]", "if path.is_dir()]", _SAVES_TESTS,
    ),
    Fault(
        "trust-ignored", "a file of Stable-Baselines3 alone is run without trust", "agents/policies/saved.py",
        "        if not trust:", "        if not trust and old:", f"{_FOREIGN_TESTS} -k 'others and evaluate'",
    ),
    Fault(
        "weights-only", "tensors are read as any pickle", _ARCHIVE,
        "weights_only=True", "weights_only=False", f"{_FOREIGN_TESTS} -k more_than_tensors",
    ),
)  # fmt: skip

FAULTS = (*PHYSICS, *TASK, *SIM, *SHELLS, *AGENTS)


def planted(text: str, fault: Fault) -> str:
    """A source with the fault in it.

    Raises:
        ValueError: What it changes doesn't stand there exactly once.
    """
    count = text.count(fault.text)
    if count != 1:
        raise ValueError(f"{fault.name}: {fault.text!r} stands {count} times in {fault.file}; it must be once.")
    return text.replace(fault.text, fault.instead)


def copy_tree(folder: Path) -> None:
    """Lay the packages and their tests out so that ``folder`` on the path is imported instead of what is installed.

    The three top-level folders are one package: `uwoc_gym` is found in ``folder`` first, and its `agents` and
    `baselines` inside it, which an editable installation would otherwise find elsewhere.
    """
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in COPIED:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copyfile(ROOT / name, folder / name)
    for name in ("agents", "baselines"):
        (folder / "uwoc_gym" / name).symlink_to(Path("..") / name, target_is_directory=True)


def surroundings(folder: Path) -> dict[str, str]:
    """Environment variables with which Python imports a copy, and keeps apart what it compiles.

    The cache lies beside the copy, so that the next one in the same place need not compile what hasn't changed.
    """
    return os.environ | {"PYTHONPATH": str(folder), "NUMBA_CACHE_DIR": str(folder.with_name("cache"))}


def run_tests(folder: Path, tests: Sequence[str], limit_s: float) -> tuple[int | None, str]:
    """pytest's exit status in a copy, None where it ran into the time limit, and what it printed."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--hypothesis-seed=0", "--tb=line"]
    try:
        done = subprocess.run(
            [*command, *tests], cwd=folder, env=surroundings(folder), capture_output=True, text=True, check=False,
            timeout=limit_s,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        return None, str(error)
    return done.returncode, done.stdout + done.stderr


def failing(output: str) -> list[str]:
    """The tests that pytest says have failed, each as it is chosen."""
    return re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", output, re.MULTILINE)


def without_fault(faults: Iterable[Fault], folder: Path, limit_s: float = 3.0 * TIME_LIMIT_S) -> list[str]:
    """Which of the chosen tests fail where nothing is planted; they can notice nothing.

    Args:
        faults: Whose tests are meant.
        folder: Where the copy of the tree goes.
        limit_s: When to stop a run of pytest [s].

    Raises:
        RuntimeError: They can't be run.
    """
    broken: set[str] = set()
    copy_tree(folder)
    for tests in dict.fromkeys(fault.tests for fault in faults):
        status, output = run_tests(folder, shlex.split(tests), limit_s)
        if status not in (0, 1):
            raise RuntimeError(f"{tests} can't be run without a fault:\n{output}")
        broken.update(failing(output))
    return sorted(broken)


def try_fault(fault: Fault, folder: Path, left_out: Sequence[str] = (), limit_s: float = TIME_LIMIT_S) -> Verdict:
    """Plant a fault in a copy of the tree and run the tests that should notice.

    Args:
        fault: The fault.
        folder: Where the copy goes, in place of what is there.
        left_out: Tests that fail without the fault.
        limit_s: When to stop; what takes longer isn't noticed [s].

    Raises:
        ValueError: What the fault changes doesn't stand in the source exactly once.
    """
    begun = time.perf_counter()
    copy_tree(folder)
    path = folder / fault.file
    before = path.stat()
    text = planted(path.read_text(encoding="utf-8"), fault)
    path.write_text(text, encoding="utf-8")
    if not fault.compiled:
        # Time and size of all its sources date the cache of what is compiled.
        path.write_text(text + " " * (before.st_size - path.stat().st_size), encoding="utf-8")
        os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    chosen = [*shlex.split(fault.tests), "-x", *(word for test in left_out for word in ("--deselect", test))]
    status, output = run_tests(folder, chosen, limit_s)
    # A module that can't be imported is no test that has noticed anything.
    found = failing(output) if status == 1 else []
    return Verdict(fault, found[0] if found else "", time.perf_counter() - begun, output)


def try_all(
    faults: Sequence[Fault], folders: Sequence[Path], left_out: Sequence[str], tell: Callable[[Verdict], None]
) -> list[Verdict]:
    """Try faults, as many at a time as there are folders for copies, and tell of each when it is done."""
    free: queue.SimpleQueue[Path] = queue.SimpleQueue()
    for folder in folders:
        free.put(folder)

    def tried(fault: Fault) -> Verdict:
        folder = free.get()
        try:
            verdict = try_fault(fault, folder, left_out)
        finally:
            free.put(folder)
        tell(verdict)
        return verdict

    with ThreadPoolExecutor(len(folders)) as pool:
        return list(pool.map(tried, faults))


def table(verdicts: Sequence[Verdict]) -> str:
    """The verdicts and their share as Markdown."""
    lines = ["| fault | what it is | file | noticed by | s |", "|---|---|---|---|---|"]
    for fault, noticed_by, seconds, _ in verdicts:
        test = f"`{noticed_by}`".replace("|", r"\|") if noticed_by else "**nothing**"
        lines.append(f"| {fault.name} | {fault.what} | `{fault.file}` | {test} | {seconds:.0f} |")
    noticed = sum(bool(verdict.noticed_by) for verdict in verdicts)
    share = 100.0 * noticed / len(verdicts)
    return "\n".join([*lines, "", f"{noticed} of {len(verdicts)} planted faults are noticed, {share:.0f} %."])


def main(argv: Sequence[str] | None = None) -> int:
    """The command; 1 where a fault isn't noticed, or a test fails without one."""
    parser = argparse.ArgumentParser(prog="python -m tests.trust.mutants", description=__doc__)
    names = [fault.name for fault in FAULTS]
    parser.add_argument("--only", nargs="+", choices=names, metavar="NAME", help=f"of {', '.join(names)}")
    parser.add_argument("--jobs", type=int, default=1, help="faults at a time")
    parser.add_argument("--verbose", action="store_true", help="show what pytest says where nothing is noticed")
    args = parser.parse_args(argv)
    chosen = (fault for fault in FAULTS if args.only is None or fault.name in args.only)
    # What must be compiled anew comes last, since nothing after it finds the cache that it needs.
    faults = sorted(chosen, key=lambda fault: fault.compiled)

    def tell(verdict: Verdict) -> None:
        said = f"noticed by {verdict.noticed_by}" if verdict.noticed_by else "NOT NOTICED"
        print(f"{verdict.fault.name}: {said} ({verdict.seconds:.0f} s)", flush=True)
        if args.verbose and not verdict.noticed_by:
            print(verdict.output, flush=True)

    with tempfile.TemporaryDirectory(prefix="mutants-") as name:
        folders = [Path(name) / str(job) / "tree" for job in range(max(1, args.jobs))]
        broken = without_fault(faults, folders[0])
        for test in broken:
            print(f"left out, since it fails without a fault: {test}", flush=True)
        verdicts = try_all(faults, folders, broken, tell)
    print("\n" + table(verdicts))
    return 1 if broken or not all(verdict.noticed_by for verdict in verdicts) else 0


if __name__ == "__main__":
    raise SystemExit(main())

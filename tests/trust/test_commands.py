"""Command lines that are refused: one line that helps, a status that says so, soon, and nothing left behind.

`counts` tries them all and says how many were refused like that.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

for module in ("yaml", "stable_baselines3", "optuna", "pygame", "plotly", "matplotlib", "imageio_ffmpeg"):
    pytest.importorskip(module)

from uwoc_gym import TrackingEnv, TrackingVectorEnv  # noqa: E402
from uwoc_gym.agents.cli import COMMANDS, main  # noqa: E402
from uwoc_gym.agents.learning.plans import Wish, planned  # noqa: E402
from uwoc_gym.agents.reports import files  # noqa: E402

DEEP = "[" * 100_000
OBJECTS = '{"a":' * 100_000
BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{name}: &{name} [{','.join(9 * [f'*{before}'])}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
MERGED = "a: &a {x: 1, y: 2}\n" + "".join(
    f"{name}: &{name} {{<<: [{','.join(9 * [f'*{before}'])}]}}\n"
    for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)
BLIND = json.dumps({"base": "Random", "observation": {"groups": ["ship", "velocity"]}})
"""Settings that the controllers and the shipped agents can't fly."""
LONG = json.dumps({"base": "Random", "episode": {"duration_s": 1e6, "control_period_s": 0.005}})
PROGRESS = {
    "steps": 64, "seconds": 1.0, "learning_seconds": 1.0, "seeds_used": 1, "evaluations": [], "best_steps": None,
    "finished": False, "counters": {},
}  # fmt: skip

DAMAGED: dict[str, bytes] = {
    "empty": b"",
    "cut": b'{"a": ',
    "binary": bytes(range(256)),
    "list": b"[1, 2]",
    "number": b"5",
    "null": b"null",
    "deep": DEEP.encode(),
    "objects": OBJECTS.encode(),
    "long": b'{"a": "' + b"x" * (33 * 2**20) + b'"}',
    "digits": b'{"a": ' + b"9" * 10_000 + b"}",
    "strange": b'{"base": 5, "\\u0000": NaN, "settings": {}}',
}
"""What stands in a file in place of what should."""

RUN = ("algorithm", "env", "name", "settings", "overrides", "scenario", "seed", "eval_every", "eval_episodes")
"""Fields of a run.json, of each of which nonsense is tried."""


class Line(NamedTuple):
    """A command line that is to be refused, and what the error has to say."""

    words: list[str]
    said: tuple[str, ...] = ()


def fill(folder: Path) -> None:
    """Write the files that command lines name."""
    for name, data in DAMAGED.items():
        for suffix in ("json", "yaml", "zip"):
            (folder / f"{name}.{suffix}").write_bytes(data)
    texts = {"bomb.yaml": BOMB, "merged.yaml": MERGED, "blind.json": BLIND, "long-flight.json": LONG, "file": "mine"}
    texts["gains.json"] = json.dumps({"a_p": [1, 2], "a_v": True})
    texts["more-gains.json"] = json.dumps({"a_p": 300, "a_v": 250, "c_p": 1})
    texts["settings.yaml"] = "default: {n_envs: 1e12}\n"
    texts["dates.yaml"] = "default: {policy: 2001-01-01, ? [1, 2] : 3}\n"
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    recorded = {"command": "", "versions": {}, **planned(Wish(steps=64, envs=1)).to_dict()}
    for name, data in DAMAGED.items():
        for file, run in (("run.json", data), ("checkpoint-000001/progress.json", None)):
            own = folder / f"{file[:3]}-{name}" if run is not None else folder / f"progress-{name}"
            (own / "checkpoint-000001").mkdir(parents=True)
            (own / "run.json").write_bytes(json.dumps(recorded).encode() if run is None else run)
            (own / "checkpoint-000001/progress.json").write_bytes(data)
    for key in RUN:
        for i, value in enumerate(([], {"a": [1]}, "x", -1, 1e300, True)):
            if key != "name" or value != "x":
                (folder / f"run-{key}-{i}").mkdir()
                (folder / f"run-{key}-{i}/run.json").write_text(json.dumps({**recorded, key: value}))
    for key in PROGRESS:
        for i, value in enumerate(([5], {"a": 1}, "x", -1, None if key != "best_steps" else 7)):
            own = folder / f"progress-{key}-{i}"
            (own / "checkpoint-000001").mkdir(parents=True)
            (own / "run.json").write_text(json.dumps(recorded))
            (own / "checkpoint-000001/progress.json").write_text(json.dumps({**PROGRESS, key: value}))


COUNTED: dict[str, tuple[str, ...]] = {
    "benchmark": ("--seeds", "--seed", "--batch", "--jobs", "--control-period"),
    "evaluate nlpd": ("--seeds", "--seed"),
    "train": ("--seed", "--steps", "--envs", "--frame-stack", "--eval-every", "--eval-episodes", "--checkpoint-every",
              "--threads", "--scale"),
    "tune pd": ("--trials", "--batch", "--episodes", "--steps", "--seed"),
    "protocol": ("--training-seeds", "--seeds", "--steps", "--jobs"),
    "calibrate nlpd": ("--trials", "--batch", "--seed"),
    "watch": ("--seed", "--speed"),
    "record": ("--seed", "--from", "--to", "--speed", "--fps"),
    "replay": ("--seed", "--at"),
    "speed": ("--rounds", "--time", "--sizes", "--fleet", "--seed"),
}  # fmt: skip
"""Options that take a number."""

NO_NUMBERS = ("x", "", "-1", "nan", "inf", "1" + "0" * 30, "9" * 5000, "1e400", DEEP)

NEW = {
    "benchmark": "--out new/out", "evaluate": "--out new/out", "train": "--out new/out", "tune": "--out new/out",
    "protocol": "--out new/out --runs new/runs --ship new/ship", "calibrate": "--out new/out",
    "reproduce": "--out new/out", "record": "--out new/out.mp4 new/out.gif", "replay": "--out new/out.html",
    "speed": "--out new/out", "watch": "", "list": "",
}  # fmt: skip
"""What each command would write to, which isn't there yet."""

OVERRIDES = (DEEP, OBJECTS, "{", "{}x", "[]", "file", "missing.json", *(f"{name}.json" for name in DAMAGED),
             '{"vehicl": {}}', '{"vehicle": {"mass_scale": true}}', '{"episode": {"duration_s": 1e308}}',
             '{"vehicle": {"mass_scale": 1' + "0" * 400 + "}}", '{"depth_m": NaN}', '{"ship": {"kind": []}}',
             '{"sea": {"pulses": [' + ",".join(["{}"] * 1001) + "]}}")  # fmt: skip


NO_SCENARIOS = (DEEP, "Nominl", "", "file", "x" * 100_000, *(f"{name}.json" for name in DAMAGED))


def lines() -> Iterator[Line]:
    """All command lines that are to be refused, in the folder that `fill` has filled."""
    for words, options in COUNTED.items():
        command = words.split()
        for option in options:
            for value in NO_NUMBERS:
                yield Line([*command, *NEW[command[0]].split(), f"{option}={value}"], (option,))
    for words in ("benchmark", "evaluate nlpd", "train", "tune nlpd", "protocol", "watch", "record", "replay"):
        command = [*words.split(), *NEW[words.split()[0]].split()]
        for text in OVERRIDES:
            yield Line([*command, f"--override={text}"], ("--override",))
        for text in NO_SCENARIOS:
            yield Line([*command, f"--scenario={text}"], ("--scenario",))
    for text in OVERRIDES:
        yield Line(["list", "Random", f"--override={text}"], ("--override",))
    for text in NO_SCENARIOS:
        yield Line(["list", text], ("SCENARIO",))
    for command in ("benchmark", "watch", "record", "replay"):
        for policy in ("nlpdd", DEEP, "missing.zip", "no_module:x", "json:loads", "cut.zip", "binary.zip", "file", ""):
            yield Line([command, *NEW[command].split(), "--policy", "pd", policy, "--scenario", "Nominal"])
        yield Line([command, *NEW[command].split(), "--scenario", "blind.json"], ("policy",))
    for policy in (
        "nlpdd",
        DEEP,
        "missing.zip",
        "no_module:x",
        "cut.zip",
        "binary.zip",
        "file",
        "run-cut",
    ):
        yield Line(["evaluate", policy, "--out", "new/out"], ("POLICY",))
    yield Line(["evaluate", "json:loads", "--out", "new/out"], ("json:loads",))
    yield Line(["evaluate", "nlpd", "--scenario", "blind.json", "--out", "new/out"], ("observation group",))
    for words in ("benchmark --policy pd", "evaluate pd", "replay", "tune pd"):
        command = words.split()
        yield Line([*command, *NEW[command[0]].split(), "--scenario", "long-flight.json"], ("must be at most",))
    yield from _training()
    for command in ("tune pd", "protocol"):
        yield Line(
            [*command.split(), *NEW[command.split()[0]].split(), "--scenario", "blind.json"], ("observation group",)
        )
    time_too = json.dumps({"observation": {"groups": ["ship", "velocity", "ship-acceleration", "heading", "time"]}})
    yield Line(["protocol", *NEW["protocol"].split(), "--override", time_too], ("--scenario",))
    yield Line(["protocol", *NEW["protocol"].split(), "--groups", "ppoo"], ("--groups",))
    yield Line(["tune", "nlpdd", "--out", "new/out"], ("target",))
    yield Line(["tune", "pd", "--env", "CartPole-v1", "--out", "new/out"], ("--env",))
    yield Line(["tune", "ppo", "--env", "CartPol-v1", "--out", "new/out"], ("--env",))
    yield Line(["tune", "pd", "--batch", "4096", "--episodes", "4096", "--out", "new/out"], ("must be at most",))
    yield Line(["calibrate", "nlpdd", "--out", "new/out"], ("target",))
    for target in ("tune pd", "calibrate case-1"):
        yield Line([*target.split(), "--resume", "--out", "new/out"], ("--resume",))
    yield Line(
        [
            "record",
            "--fps",
            "240",
            "--speed",
            "0.01",
            "--out",
            "new/out.mp4",
            "--override",
            '{"episode": {"duration_s": 1000}}',
        ],
        ("--fps",),
    )
    yield Line(["record", "--fps", "60", "--out", "new/a.mp4", "new/a.gif"], ("--fps",))
    yield Line(["record", "--from", "9", "--to", "3", "--out", "new/a.mp4"], ("--from",))
    yield Line(["record", "--size", "320x180", "--out", "new/a.mp4"], ("--size",))
    yield Line(["replay", "--at", "1000", "--out", "new/out.html"], ("--at",))
    for command in ("record", "watch"):
        for size in ("1x1", "x", "1e9x1e9", "100000000x100000000", "1280", "1280x720x3", DEEP):
            yield Line([command, *NEW[command].split(), "--size", size], ("--size",))
    for words in ("record --out a.avi", "replay --out a.pdf", "record --out file", "record --out file/a.mp4"):
        yield Line(words.split(), ("--out",))
    for words in ("benchmark --seeds 1", "evaluate pd --seeds 1", "train --steps 1", "tune pd", "calibrate nlpd",
                  "speed", "reproduce", "protocol --runs new/runs"):  # fmt: skip
        for place in ("file", "file/new", "x" * 300, "new/" + "x" * 300):
            yield Line([*words.split(), "--out", place], ("--out",))
    yield Line(["protocol", "--runs", "file", "--out", "new/out"], ("--runs",))
    yield Line(["protocol", "--runs", "new/runs", "--ship", "file", "--out", "new/out"], ("--ship",))
    for command in COMMANDS:
        yield Line([command, "--no-such-option"])
    for words in ("", "nonsense", "train", "tune", "calibrate", "reproduce", "protocol", "evaluate"):
        yield Line(words.split())
    yield Line(["list", "--override", "{}"], ("--override",))


def _training() -> Iterator[Line]:
    out = ["--out", "new/out"]
    for name in ("gains", "more-gains", *DAMAGED):
        yield Line(["train", *out, "--residual", f"{name}.json"], ("residual",))
    for name in ("bomb", "merged", "settings", "dates", *DAMAGED):
        yield Line(["train", *out, "--settings", f"{name}.yaml"], (f"{name}.yaml",))
    for text in ("", "=", "n_steps", "n_steps=[", "n_steps=1e12", "n_steps=true", f"n_steps={DEEP}", "gama=0.9",
                 "gamma=2", "n_envs=1000000000000", "n_epochs=1e9", "policy=[]", "policy=5",
                 "policy_kwargs.net_arch=[1e9]",
                 "policy_kwargs.net_arch=x", "policy_kwargs.netarch=[64]", "policy_kwargs.log_std_init=1e300",
                 "normalize={x: 1}", "normalize=5", "frame_stack=0", "frame_stack=1e6", "learning_rate=lin_x",
                 "learning_rate=-1", "env_kwargs=5", "env_kwargs.speed=1", "env_kwargs.scenario={vehicl: {}}",
                 "env_kwargs.scenario=[]", "env_kwargs.control_period_s=x", "residual=[1]", "residual={a_p: x}",
                 "residual_scale=5", "noise_type=x", f"{'a.' * 50}b=1", f"policy_kwargs={'dict(a=' * 500}",
                 "policy_kwargs=!!set {a, b}", "batch_size=2001-01-01", "seed=1", "n_steps=9" + "9" * 5000,
                 "target_kl=.inf", "clip_range=.nan"):  # fmt: skip
        yield Line(["train", *out, "--set", text])
    yield Line(["train", *out, "--set", "n_steps=1000000", "--envs", "1000"], ("n_steps", "n_envs"))
    yield Line(["train", *out, "--algorithm", "pp"], ("--algorithm",))
    yield Line(["train", *out, "--algorithm", DEEP], ("--algorithm",))
    for env in ("CartPol-v1", "no_module:CartPole-v1", DEEP, ""):
        yield Line(["train", *out, f"--env={env}"], ("--env",))
    yield Line(["train", *out, "--env", "CartPole-v1", "--override", "{}"], ("--override",))
    yield Line(["train", *out, "--env", "CartPole-v1", "--residual", "pd"], ("residual",))
    yield Line(["train", *out, "--env", "uwoc/Random-v0", "--scenario", "Random"], ("--scenario",))
    yield Line(["train", *out, "--residual", "pdd"], ("residual", "did you mean 'pd'"))
    yield Line(["train", *out, "--resume"], ("--resume",))
    yield Line(["train", "--out", "run-seed-0"], ("--out",))
    for name in DAMAGED:
        yield Line(["train", "--resume", "--out", f"run-{name}"], ("run.json",))
        yield Line(["train", "--resume", "--out", f"progress-{name}"], ("progress.json",))
    for key in RUN:
        for i in range(6):
            if (key, i) not in (("name", 2), ("overrides", 0)):
                yield Line(["train", "--resume", "--out", f"run-{key}-{i}"])
    for key in PROGRESS:
        for i in range(5):
            # Any counts by name are allowed.
            if (key, i) != ("counters", 1):
                yield Line(["train", "--resume", "--out", f"progress-{key}-{i}"], ("progress.json", key))


class Outcome(NamedTuple):
    """What a command line came to."""

    status: int
    output: str
    errors: str
    seconds: float
    escaped: str
    left: list[str]
    """Files that are there now and weren't, aren't any more, or have changed."""


def tree(folder: Path) -> dict[str, tuple[int, int, int]]:
    """All that stands in a folder: size, time and kind by path."""
    found = {}
    for path in folder.rglob("*"):
        about = path.lstat()
        # A folder's own time changes where something was tried out in it.
        found[str(path.relative_to(folder))] = (
            (about.st_size, about.st_mtime_ns, about.st_mode) if path.is_file() else (0, 0, about.st_mode)
        )
    return found


def outcome(line: Line, folder: Path) -> Outcome:
    """Run a command line in a folder."""
    before, begun = tree(folder), time.perf_counter()
    output, errors, escaped, status = io.StringIO(), io.StringIO(), "", -1
    here = Path.cwd()
    os.chdir(folder)

    def fly(*_: object) -> None:
        raise AssertionError("it has begun to fly")

    try:
        with (
            contextlib.redirect_stdout(output),
            contextlib.redirect_stderr(errors),
            pytest.MonkeyPatch.context() as patch,
        ):
            patch.setattr(TrackingVectorEnv, "step", fly)
            patch.setattr(TrackingEnv, "step", fly)
            status = main(line.words)
    except Exception as error:
        escaped = f"{type(error).__name__}: {str(error)[:200]}"
    finally:
        os.chdir(here)
    taken = time.perf_counter() - begun
    after = tree(folder)
    left = sorted(name for name in before.keys() | after.keys() if before.get(name) != after.get(name))
    return Outcome(status, output.getvalue(), errors.getvalue(), taken, escaped, left)


SOON_S = 30.0
"""Time within which a refusal has to be there, imports included."""


def faults(line: Line, found: Outcome) -> list[str]:
    """What is wrong with a refusal."""
    told = found.errors.strip()
    wrong = []
    if found.escaped:
        wrong.append(f"escaped: {found.escaped}")
    if found.status not in (1, 2):
        wrong.append(f"status {found.status}")
    if found.output or len(told.splitlines()) != 1 or len(told) > 5000:
        wrong.append(f"not one line: {(found.output + told)[:300]}")
    wrong += [f"doesn't say {word}: {told[:300]}" for word in line.said if word not in told]
    if found.seconds > SOON_S:
        wrong.append(f"took {found.seconds:.0f} s")
    if found.left:
        wrong.append(f"left {found.left}")
    return wrong


def counts(folder: Path, wrong: list[str]) -> dict[str, int]:
    """How many command lines were tried in an empty folder, and refused in one line, soon and without a trace.

    What is wrong with the others is added to a list.
    """
    fill(folder)
    found = dict.fromkeys(("tried", "refused in one line, soon, without a trace"), 0)
    for line in lines():
        found["tried"] += 1
        own = faults(line, outcome(line, folder))
        found["refused in one line, soon, without a trace"] += not own
        wrong += [f"{' '.join(word[:40] for word in line.words)}: {each}" for each in own]
    return found


def test_a_command_that_refuses_says_so_in_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    fill(tmp_path)
    tried: dict[str, int] = {}
    for line in lines():
        assert faults(line, outcome(line, tmp_path)) == [], [word[:80] for word in line.words]
        command = line.words[0] if line.words else ""
        tried[command] = tried.get(command, 0) + 1
    assert tried.keys() >= COMMANDS.keys()
    assert sum(tried.values()) > 800


def test_a_trace_would_be_seen(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    before = tree(tmp_path)
    (tmp_path / "new").mkdir()
    assert tree(tmp_path) != before
    (tmp_path / "new").rmdir()
    files.write_text(tmp_path / "file", "your")
    assert tree(tmp_path) != before

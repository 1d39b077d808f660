"""Tries this package with the libraries that its users use, and writes docs/ecosystem.md.

Each library gets an environment of its own, which is kept for the next time; `--only` tries some of them again and
leaves what is known of the others.
"""

from __future__ import annotations

import argparse
import datetime
import json
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs/ecosystem.md"
sys.path.insert(0, str(HERE))

from libraries import ALWAYS, LIBRARIES, Library  # noqa: E402

HEAD = """\
# What it works with

`.ci/ecosystem` tries this package with the libraries below, each in an environment of its own, and writes this page;
`.ci/ecosystem --only torchrl minari` tries some of them again. The scripts, `tests/ecosystem/with_*.py`, are short and
show how each library is used with it. It isn't part of CI: it installs gigabytes and runs for half an hour.
"""

TAIL = """\
## What to know

- **TorchRL** reads `info` of a single environment only where its values are arrays: `GymEnv("uwoc/Random-v0",
  info_arrays=True)`. Those of the vector environment are arrays in any case. It wants `autoreset_mode="Disabled"` or
  `"SameStep"` of a vector environment.
- **`spec.max_episode_steps`** is the length of the episodes that an environment was made for (`TimeAwareObservation`
  and d3rlpy need it). It ends nothing by itself: `gymnasium.make` of an ID adds no `TimeLimit`, so that other durations
  and periods are flown in full. `gymnasium.make(env.spec)` does add one, of the recorded length.
- **`vector.NormalizeObservation`** needs environments that begin anew in the next step (`NEXT_STEP`). It works with
  `gymnasium.make_vec`, and as `--wrapper` of the commands that fly, but not in `TrackingVecEnv`, and so not in `train`:
  there single environments' `NormalizeObservation`, Stable-Baselines3's `VecNormalize` or the setting `normalize` does.
- Scenarios and ship's paths may be given as objects: an `EnvSpec` with one goes through JSON, and Minari recovers it.
- Actions are continuous. Algorithms for actions that are counted fly it behind Gymnasium's `DiscretizeAction`.
"""


def main() -> int:
    """Try the libraries; returns the exit status."""
    parser = argparse.ArgumentParser(prog=".ci/ecosystem", description=__doc__)
    parser.add_argument("--only", nargs="+", choices=LIBRARIES, default=list(LIBRARIES), metavar="NAME")
    parser.add_argument("--work", type=Path, default=ROOT / "build/ecosystem", help="folder of the environments")
    parser.add_argument("--out", type=Path, default=PAGE, help="the page (default: docs/ecosystem.md)")
    args = parser.parse_args()
    work = args.work.absolute()
    work.mkdir(parents=True, exist_ok=True)
    known = work / "results.json"
    results: dict[str, Any] = json.loads(known.read_text(encoding="utf-8")) if known.is_file() else {}
    for name in args.only:
        begun = time.perf_counter()
        results[name] = tried(name, LIBRARIES[name], work)
        known.write_text(json.dumps(results, indent=1, ensure_ascii=False), encoding="utf-8")
        failed = [each for each in results[name]["checks"] if each["result"] == "fails"]
        print(f"{name}: {len(failed)} failed, {time.perf_counter() - begun:.0f} s", flush=True)
        for each in failed:
            print(f"  {each['what']}: {each['remark']}", flush=True)
    args.out.write_text(page(results), encoding="utf-8")
    return int(any(each["result"] == "fails" for name in args.only for each in results[name]["checks"]))


def tried(name: str, library: Library, work: Path) -> dict[str, Any]:
    """Versions of what was tried, and what came of it."""
    python = work / name / "bin/python"
    try:
        install(library, work / name)
    except subprocess.CalledProcessError as error:
        said = (error.stderr or error.stdout or "").strip().splitlines()[-1:]
        return {"date": "", "versions": {}, "checks": [check("pip install", "fails", " ".join(said))]}
    log = work / f"{name}.log"
    with tempfile.TemporaryDirectory() as folder, log.open("w", encoding="utf-8") as errors:
        script = HERE / f"with_{name}.py"
        done = subprocess.run(
            [python, script], cwd=folder, stdout=subprocess.PIPE, stderr=errors, text=True, check=False, timeout=3600
        )
    checks = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('{"what"')]
    if done.returncode not in (0, 1) or not checks:
        checks.append(check("the whole script", "fails", f"ended with status {done.returncode}, see {log}"))
    found = versions(python, ("gymnasium", "torch", *library.shown))
    return {"date": datetime.date.today().isoformat(), "versions": found, "checks": checks}


def check(what: str, result: str, remark: str) -> dict[str, str]:
    """A row of what was tried, as the scripts print it."""
    return {"what": what, "result": result, "remark": remark}


def install(library: Library, folder: Path) -> None:
    """Make a library's environment, unless it was made of the same before."""
    torch = next(line for line in (ROOT / "constraints.txt").read_text().splitlines() if line.startswith("torch=="))
    plan = json.dumps([torch, *ALWAYS, *library.requirements, "then", *library.afterwards])
    done = folder / "made-of.json"
    if done.is_file() and done.read_text(encoding="utf-8") == plan:
        return
    subprocess.run([sys.executable, "-m", "venv", folder], check=True, capture_output=True, text=True)

    def pip(*words: str) -> None:
        command = [folder / "bin/python", "-m", "pip", "install", "--quiet", *words]
        subprocess.run(command, check=True, capture_output=True, text=True)

    # First alone, and then named again: what asks for any PyTorch is content with this one.
    pip(torch)
    pip(torch, *ALWAYS, *library.requirements, *(() if library.afterwards else ("gymnasium>=1.2",)))
    if library.afterwards:
        pip("--no-deps", *library.afterwards)
    pip("--no-deps", "--editable", str(ROOT))
    done.write_text(plan, encoding="utf-8")


def versions(python: Path, names: tuple[str, ...]) -> dict[str, str]:
    """The versions of distributions in an environment."""
    code = (
        "import importlib.metadata as m, json, sys; print(json.dumps({n: m.version(n) for n in sys.argv[1:] if n in "
        "{d.name.lower().replace('_', '-') for d in m.distributions()} | {d.name for d in m.distributions()}}))"
    )
    found: dict[str, str] = json.loads(subprocess.check_output([python, "-c", code, *dict.fromkeys(names)], text=True))
    return found


def page(results: dict[str, Any]) -> str:
    """The page, from what is known of all libraries."""
    dates = [own.get("date", "") for own in results.values()]
    torches = {own["versions"].get("torch", "").partition("+")[0] for own in results.values()} - {""}
    with_what = f"Python {platform.python_version()} and PyTorch {', '.join(sorted(torches))}"
    tried_on = f"Last tried on {max(dates)}, with {with_what}.\n"
    return "\n".join([HEAD, tried_on, *table(results), "", *left_out(results), TAIL])


def table(results: dict[str, Any]) -> Iterator[str]:
    """A row for each check; Gymnasium's many wrappers share one."""
    yield "| library | version | what was run | result |"
    yield "| --- | --- | --- | --- |"
    for name, library in LIBRARIES.items():
        if name not in results:
            continue
        own = results[name]
        named = ", ".join(f"{each} {version}" for each, version in own["versions"].items() if each in library.shown)
        beside = own["versions"].get("gymnasium", "")
        if "gymnasium" not in library.shown and beside:
            named += f" (gymnasium {beside})"
        first = True
        for what, result in grouped(own["checks"]):
            remark = f" ({library.remark})" if first and library.remark else ""
            yield f"| {library.title + remark if first else ''} | {named if first else ''} | {what} | {result} |"
            first = False


def grouped(checks: list[dict[str, str]]) -> Iterator[tuple[str, str]]:
    """What was run and what came of it; what works without a remark and differs in a name alone stands together."""
    groups: dict[str, list[str]] = {}
    for each in checks:
        if each["result"] == "doesn't apply":
            continue
        result = each["result"] + (f": {each['remark']}" if each["remark"] else "")
        match = re.fullmatch(r"(wrappers(?:\.vector)?)\.(\w+)", each["what"])
        if match is None:
            yield each["what"].replace("|", "\\|"), result
        else:
            groups.setdefault(f"{match[1]}\0{result}", []).append(match[2])
    for key, names in groups.items():
        where, result = key.split("\0")
        yield f"{where}: {', '.join(names)}", result


def left_out(results: dict[str, Any]) -> Iterator[str]:
    """What doesn't apply, and why."""
    reasons: dict[str, list[str]] = {}
    for name in LIBRARIES:
        for each in results.get(name, {}).get("checks", []):
            if each["result"] == "doesn't apply":
                reasons.setdefault(each["remark"], []).append(each["what"].split(" ")[0])
    if reasons:
        yield "What doesn't apply:\n"
        for reason, names in reasons.items():
            yield f"- {', '.join(names)}: {reason}"
        yield ""


if __name__ == "__main__":
    sys.exit(main())

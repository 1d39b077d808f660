"""`uwoc-gym benchmark`: every policy through every scenario on the same seeds."""

from __future__ import annotations

import csv
import importlib.metadata
import json
import math
import platform
import sys
from pathlib import Path
from typing import Any

import numpy as np
from uwoc_gym.agents.errors import UserError
from uwoc_gym.agents.evaluate import Flight, disturbance_time, draws_anything, fly, load_policy
from uwoc_gym.agents.report import COLUMNS, draw_flights, estimate, table

from uwoc_gym import ENV_IDS, SCENARIOS, Scenario, SettingError
from uwoc_gym.metrics import episode_metrics
from uwoc_gym.parameters import closest

BATCH = 32
"""Episodes flown together: enough for speed, few enough for an interrupted run to keep most."""


def load_scenario(name: str) -> tuple[str, Scenario]:
    """A scenario and its title from its name, an environment ID, or the path of a JSON file.

    Raises:
        UserError: There is no such scenario, or the file doesn't hold one.
    """
    if name in ENV_IDS:
        name = ENV_IDS[name]
    if name in SCENARIOS:
        return name, SCENARIOS[name]
    if name.endswith(".json"):
        try:
            return Path(name).stem, Scenario.from_json(Path(name).read_text())
        except (OSError, SettingError) as error:
            raise UserError(f"scenario file {name!r}: {error}") from None
    raise UserError(f"there is no scenario {name!r}; {closest(name, list(SCENARIOS))} A .json file works too.")


def writable(out: Path) -> Path:
    """The folder, made if need be.

    Raises:
        UserError: Nothing can be written there.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".write-test"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UserError(f"--out {str(out)!r} can't be written: {error.strerror}") from None
    return out


def versions() -> dict[str, str]:
    """Versions of Python and of what the results rest on."""
    found = {"python": platform.python_version()}
    for package in ("uwoc-gym", "gymnasium", "numba", "numpy", "scipy", "stable-baselines3", "torch"):
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


def run(
    policies: list[str],
    scenarios: list[str],
    episodes: int,
    first_seed: int,
    out: Path,
    command: str,
    control_period_s: float | None = None,
) -> bool:
    """Fly, print the table and write `results.json`, `episodes.csv`, `table.md` and a figure per scenario.

    Args:
        policies: Names, model files or ``module:callable``.
        scenarios: Names, IDs or JSON files.
        episodes: Episodes of each policy in each scenario that draws anything; one in the others.
        first_seed: Episodes use the seeds from this one on, the same for every policy.
        out: Folder to write to.
        command: The command line, for the record.
        control_period_s: Time between actions [s]; None for the scenario's own.

    Returns:
        Whether all was flown; False after an interrupt, with what was finished written.

    Raises:
        UserError: A policy or scenario doesn't exist, or ``out`` can't be written.
    """
    from tqdm import tqdm

    writable(out)
    chosen = dict(load_scenario(name) for name in scenarios)
    if control_period_s is not None:
        chosen = {k: s.merged({"episode": {"control_period_s": control_period_s}}) for k, s in chosen.items()}
    loaded = {title: {name: load_policy(name, scenario) for name in policies} for title, scenario in chosen.items()}
    counts = {title: episodes if draws_anything(scenario) else 1 for title, scenario in chosen.items()}
    jobs = [
        (title, name, list(range(first_seed + done, first_seed + min(done + BATCH, counts[title]))))
        for title in chosen
        for name in policies
        for done in range(0, counts[title], BATCH)
    ]
    rows: list[dict[str, Any]] = []
    flights: dict[str, dict[str, Flight]] = {}
    complete = True
    bar = tqdm(total=sum(len(seeds) for *_, seeds in jobs), unit="episode", file=sys.stderr, disable=None)
    try:
        with open(out / "episodes.csv", "w", newline="") as file, bar:
            writer = csv.DictWriter(file, ["scenario", "policy", "seed", *COLUMNS])
            writer.writeheader()
            for title, name, seeds in jobs:
                bar.set_description(f"{title}, {name}")
                flight = fly(loaded[title][name], chosen[title], seeds)
                measures = episode_metrics(flight.record, disturbance_time(chosen[title]))
                for i, seed in enumerate(seeds):
                    values = {key: float(measures[key][i]) for key in COLUMNS}
                    rows.append({"scenario": title, "policy": name, "seed": seed, **values})
                    writer.writerow(rows[-1])
                file.flush()
                flights.setdefault(title, {}).setdefault(name, flight)
                bar.update(len(seeds))
    except KeyboardInterrupt:
        complete = False
    _write(rows, flights, chosen, out, command, complete)
    return complete


def _write(
    rows: list[dict[str, Any]],
    flights: dict[str, dict[str, Flight]],
    chosen: dict[str, Scenario],
    out: Path,
    command: str,
    complete: bool,
) -> None:
    rng = np.random.default_rng(0)
    results = {
        title: {
            name: {
                key: estimate(np.array([r[key] for r in rows if r["scenario"] == title and r["policy"] == name]), rng)
                for key in COLUMNS
            }
            for name in flights[title]
        }
        for title in flights
    }
    counts = {
        title: max(sum(r["scenario"] == title and r["policy"] == name for r in rows) for name in flights[title])
        for title in flights
    }
    text = table(results, counts)
    print(text)
    (out / "table.md").write_text(text)
    document = {
        "command": command,
        "complete": complete,
        "versions": versions(),
        "scenarios": {title: scenario.to_dict() for title, scenario in chosen.items()},
        "episodes": counts,
        "results": {
            title: {
                name: {key: _plain(value) for key, value in measures.items()} for name, measures in policies.items()
            }
            for title, policies in results.items()
        },
    }
    (out / "results.json").write_text(json.dumps(document, indent=2, ensure_ascii=False))
    for title, by_policy in flights.items():
        draw_flights(f"{title}, first episode", chosen[title], by_policy, out / f"{title}.png")


def _plain(value: Any) -> dict[str, float | int | None]:
    """An estimate for JSON, which knows no not-a-number."""
    return {k: None if isinstance(v, float) and math.isnan(v) else v for k, v in value._asdict().items()}

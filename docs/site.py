"""What MkDocs takes from the package itself: a page for each world, the results, and where the docstrings stand."""

from __future__ import annotations

import atexit
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from uwoc_gym import Scenario
from uwoc_gym.agents.commands.list import HEADER, groups, text_of
from uwoc_gym.agents.flight import possible
from uwoc_gym.agents.reports import cards, files, statistics, tables
from uwoc_gym.registry import ENV_IDS
from uwoc_gym.scenario import DESCRIPTIONS
from uwoc_gym.task.action import KINDS
from uwoc_gym.task.observation import GROUPS

ROOT = Path(__file__).parents[1]

ELSEWHERE = {
    "agents/BENCHMARK.md": "results/paper.md",
    "agents/BENCHMARK-Underactuated.md": "results/underactuated.md",
    "agents/BENCHMARK-Tide.md": "results/tide.md",
    "agents/BENCHMARK-LateFix.md": "results/latefix.md",
    "CHANGELOG.md": "changelog.md",
}
"""Pages of the site that stand outside docs/, and what they are called there."""

TITLES = {
    "paper": "Random and the paper's worlds",
    "underactuated": "Underactuated",
    "tide": "Tide",
    "latefix": "LateFix",
}
"""What the pages of results are called in the menu."""


@event_priority(100)
def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Show mkdocstrings the packages as they are installed, and put the made pages into the menu."""
    tree = Path(tempfile.mkdtemp(prefix="uwoc-gym-site-"))
    atexit.register(shutil.rmtree, tree, ignore_errors=True)
    shutil.copytree(ROOT / "uwoc_gym", tree / "uwoc_gym")
    for name in ("baselines", "agents"):
        shutil.copytree(ROOT / name, tree / "uwoc_gym" / name)
    config.plugins["mkdocstrings"].config.handlers["python"]["paths"] = [str(tree)]
    menu = {title: entries for each in config.nav or [] for title, entries in each.items()}
    menu["Worlds"] += [{name: place(name)} for name in ENV_IDS.values()]
    menu["Benchmark"] += [{title: f"results/{name}.md"} for name, title in TITLES.items()]
    return config


def on_files(found: Files, config: MkDocsConfig) -> Files:
    """Add the pages that are made, and those that stand elsewhere."""
    scores = files.read_json(cards.SCORES)
    for env_id, name in ENV_IDS.items():
        found.append(File.generated(config, place(name), content=world(env_id, name, scores)))
    for source, target in ELSEWHERE.items():
        found.append(File.generated(config, target, content=(ROOT / source).read_text(encoding="utf-8")))
    return found


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links that leave docs/, or come from outside it, to where their pages are on the site."""
    up = "../" * page.file.src_uri.count("/")
    if page.file.src_uri in ELSEWHERE.values():
        return markdown.replace("](docs/", f"]({up}")
    return re.sub(
        r"\]\(((?:\.\./)+)([\w/.-]+)\)",
        lambda link: f"]({up}{ELSEWHERE[link[2]]})" if link[2] in ELSEWHERE else link[0],
        markdown,
    )


def place(name: str) -> str:
    """Where the page of a world is."""
    return f"worlds/{name.lower()}.md"


def world(env_id: str, name: str, scores: Mapping[str, Any]) -> str:
    """The page of a world as Markdown: what is done, seen, drawn and paid there, and who has reached what."""
    own = Scenario.named(name)
    episode = own.episode
    parts = [f"# {env_id}", f"{DESCRIPTIONS[name][0].upper()}{DESCRIPTIONS[name][1:]}."]
    if (ROOT / f"docs/{name.lower()}.gif").is_file():
        parts.append(f"![Ten seconds of {env_id}](../{name.lower()}.gif)")
    parts += [
        f'```python\nimport gymnasium as gym\n\nenv = gym.make("uwoc_gym:{env_id}")\n```',
        tables.grid(
            ["episode", f"{episode.duration_s:g} s, {episode.steps} steps of {episode.control_period_s:g} s"],
            [
                ["actions", f"`Box(-1, 1, ({len(own.actions)},), float32)`"],
                ["observations", f"`Box(({own.observation.size},), float32)`"],
                ["highest return", f"{possible(own):.0f}"],
                ["digest of the scenario", f"`{own.digest()}`"],
            ],
        ),
        "## Actions",
        tables.grid(["Num", "Action", "Unit at ±1"], list(_actions(own))),
        "## Observations",
        "In the AUV's body frame; an entry times its scale is in its unit, as `uwoc_gym.unpack` reads it.",
        tables.grid(["Num", "Group", "Observation", "Min", "Max", "Unit", "Scale"], list(_entries(own))),
        "## Reward and end",
        "The reward, when an episode ends and what `info` says are the same in all worlds: "
        "[`TrackingEnv`](../api/environments.md#uwoc_gym.TrackingEnv).",
        "## What an episode draws",
        *_drawn(own),
        "## Who has reached what",
        *_standings(name, scores),
    ]
    return "\n\n".join(parts) + "\n"


def _actions(own: Scenario) -> Iterator[list[str]]:
    limits = {
        "surge force": f"{text_of(own.vehicle.max_surge_force_n)} N",
        "sway force": f"{text_of(own.vehicle.max_sway_force_n)} N",
        "yaw moment": f"{text_of(own.vehicle.max_yaw_moment_nm)} N m",
    }
    for number, action in enumerate(KINDS[own.action]):
        yield [str(number), action, limits[action]]


def _entries(own: Scenario) -> Iterator[list[str]]:
    number = 0
    for group in own.observation.groups:
        for entry in GROUPS[group]:
            scale = own.observation.entry_scales[number]
            yield [str(number), group, entry.name, f"{entry.low:g}", f"{entry.high:g}", entry.unit, f"{scale:g}"]
            number += 1


def _drawn(own: Scenario) -> list[str]:
    lines = [
        [f"`{setting.path}`", setting.value, setting.unit, setting.words]
        for group in groups(own)
        for setting in group.settings
        if " … " in setting.value
    ]
    if not own.draws:
        return ["Nothing: every episode is the same."]
    if not lines:
        return ["Nothing but the noise of each step."]
    return [
        "Once, when it begins; all else is as `uwoc-gym list` shows it.",
        tables.grid([HEADER.path, "from … to", HEADER.unit, "what it is"], lines),
    ]


def _standings(name: str, scores: Mapping[str, Any]) -> list[str]:
    entries = [entry for entry in scores["results"] if entry["scenario"] == name]
    lines = [
        [
            f"`{entry['policy']}`",
            statistics.text(entry["measures"]["return"], 1),
            f"{entry['return_median']:.1f}",
            f"{entry['return_worst']:.1f}",
            f"{entry['below_half']:.3f}",
            statistics.text(entry["measures"]["availability"], 3),
        ]
        for entry in sorted(entries, key=lambda entry: -float(entry["measures"]["return"]["mean"]))
    ]
    if not lines:
        return ["Nobody has flown it yet."]
    episodes = max(int(entry["episodes"]) for entry in entries)
    said = f"On {episodes} held-out seeds, with 95 % bootstrap intervals in brackets"
    header = ["policy", "return", "median", "worst 5 %", "below half", "availability"]
    return [
        f"{said if episodes > 1 else 'In the one episode that there is'}. `clairvoyant`, where it flew, sees the true "
        "state and future: a yardstick, no rival. [What the columns mean](../tables.md).",
        tables.grid(header, lines),
    ]

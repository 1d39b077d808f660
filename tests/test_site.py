"""The site builds without a warning, has all that is public, and what its first pages say to type runs."""

from __future__ import annotations

import importlib
import inspect
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import uwoc_gym
from uwoc_gym import agents, baselines
from uwoc_gym.agents import cli
from uwoc_gym.agents.reports import cards, files, statistics

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
START = sorted((DOCS / "start").glob("*.md"))
SHOWN = [
    name for page in sorted((DOCS / "api").glob("*.md")) for name in re.findall(r"^::: (\S+)$", page.read_text(), re.M)
]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built strictly."""
    pytest.importorskip("mkdocs")
    folder = tmp_path_factory.mktemp("site") / "html"
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    return folder


def test_every_page_is_in_the_menu(site: Path) -> None:
    menu = (site / "index.html").read_text(encoding="utf-8")
    pages = {path.relative_to(site).as_posix() for path in site.rglob("*.html")} - {"404.html", "index.html"}
    assert len(pages) > 25
    assert {page for page in pages if f'href="{page}"' not in menu} == set()


@pytest.mark.parametrize(("env_id", "name"), uwoc_gym.ENV_IDS.items())
def test_every_world_has_a_page_with_its_scores(site: Path, env_id: str, name: str) -> None:
    page = (site / f"worlds/{name.lower()}.html").read_text(encoding="utf-8")
    assert env_id in page
    assert uwoc_gym.Scenario.named(name).digest() in page
    flown = [entry for entry in files.read_json(cards.SCORES)["results"] if entry["scenario"] == name]
    assert len(flown) > 5
    for entry in flown:
        assert statistics.text(entry["measures"]["return"], 1) in page


def test_all_that_is_public_is_on_a_page(site: Path) -> None:
    public = {f"{module.__name__}.{name}" for module in (uwoc_gym, baselines, agents) for name in module.__all__}
    assert public - {*SHOWN} == set()
    assert len(set(SHOWN)) == len(SHOWN)
    html = "".join(page.read_text(encoding="utf-8") for page in (site / "api").glob("*.html"))
    for name in SHOWN:
        assert f'id="{name}"' in html


def members(name: str) -> Iterator[tuple[str, object]]:
    """Something on a page, and what it has of its own that doesn't begin with an underscore."""
    module, _, own = name.rpartition(".")
    found = getattr(importlib.import_module(module), own)
    yield name, found
    if inspect.isclass(found):
        for each, value in vars(found).items():
            if not each.startswith("_") and isinstance(value, (classmethod, staticmethod, property)) | callable(value):
                yield f"{name}.{each}", getattr(found, each)


@pytest.mark.parametrize("name", [name for name in SHOWN if not name.rpartition(".")[2].isupper()])
def test_nothing_public_is_without_a_docstring(name: str) -> None:
    assert [each for each, value in members(name) if not (inspect.getdoc(value) or "").strip()] == []


@pytest.mark.parametrize("page", START, ids=lambda page: page.stem)
def test_the_first_pages_run(page: Path, tmp_path: Path) -> None:
    """Python as it stands; a block that a file's name precedes becomes that file."""
    text = page.read_text(encoding="utf-8")
    blocks = re.findall(r"(?:^`(\w+\.py)`:\n\n)?^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert blocks
    for name, code in blocks:
        if name:
            (tmp_path / name).write_text(code, encoding="utf-8")
        else:
            done = subprocess.run(
                [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=300
            )
            assert done.returncode == 0, done.stderr
            assert done.stdout.strip()


def test_the_law_in_a_file_flies_as_its_page_says(tmp_path: Path) -> None:
    """On few seeds, between the two that the page names."""
    text = (DOCS / "start/benchmark.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^`my_law\.py`:\n\n```python\n(.*?)```", text, re.MULTILINE | re.DOTALL)
    (tmp_path / "my_law.py").write_text(code, encoding="utf-8")
    (command,) = re.findall(r"^uwoc-gym (benchmark --policy my_law.*)$", text, re.MULTILINE)
    words = ["5" if word == "200" else word for word in shlex.split(command)]
    subprocess.check_output([sys.executable, "-m", "uwoc_gym_command", *words], cwd=tmp_path, timeout=600)
    results = files.read_json(tmp_path / "results/results.json")["results"]
    pd, law, tuned = sorted(results, key=lambda entry: entry["measures"]["return"]["mean"])
    assert (pd["policy"], law["policy"], tuned["policy"]) == ("pd", "my_law:Follow", "nlpd-tuned")


@pytest.mark.parametrize("page", START, ids=lambda page: page.stem)
def test_every_command_of_the_first_pages_is_one(page: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ran = []
    for module in cli.COMMANDS.values():
        monkeypatch.setattr(module, "run", lambda args: ran.append(args) or 0)
    text = page.read_text(encoding="utf-8")
    commands = re.findall(r"^uwoc-gym (.*)$", text, re.MULTILINE) + re.findall(r"`uwoc-gym (\w+ [^`]*)`", text)
    assert commands
    for command in commands:
        assert cli.main(shlex.split(command)) == 0
    assert len(ran) == len(commands)

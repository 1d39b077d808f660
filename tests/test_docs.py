"""The examples of the documents run and print what the documents say."""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from uwoc_gym import metrics
from uwoc_gym.agents.cli import COMMANDS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def test_the_planner_prints_what_its_page_says():
    text = (DOCS / "planning.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    printed = subprocess.check_output([sys.executable, "-c", code], text=True, timeout=300).strip()
    assert printed in re.findall(r"It prints `(.*?)`", text)


def test_what_is_wrapped_flies_as_its_page_says(tmp_path: Path) -> None:
    text = (DOCS / "wrap.md").read_text(encoding="utf-8")
    flown, blurred = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    printed = subprocess.check_output([sys.executable, "-c", flown], text=True, timeout=300).split()
    (said,) = re.findall(r"It prints `(.*?)`", text)
    assert printed == said.split()
    (tmp_path / "mine.py").write_text(blurred, encoding="utf-8")
    (word,) = re.findall(r"`--wrapper (mine:\S+)`", text)
    command = [sys.executable, "-m", "uwoc_gym.agents.cli", "evaluate", "pd", "--seeds", "2", "--out", "out"]
    scenario = ["--scenario", "Random", "--override", "episode.duration_s=2", "--wrapper", word]
    subprocess.check_output([*command, *scenario], cwd=tmp_path, text=True, timeout=300)
    results = json.loads((tmp_path / "out/results.json").read_text(encoding="utf-8"))
    assert results["settings"]["wrappers"] == [{"name": "mine:blurred", "options": {"std": 0.1}}]


def test_the_tables_page_finds_the_episodes_that_are_lost(tmp_path: Path) -> None:
    page = (DOCS / "tables.md").read_text(encoding="utf-8")
    command, *others = re.findall(r"^uwoc-gym (.*)$", page, re.MULTILINE)
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    subprocess.check_output([sys.executable, "-m", "uwoc_gym_command", *command.split()], cwd=tmp_path, timeout=600)
    printed = subprocess.check_output([sys.executable, "-c", code], cwd=tmp_path, text=True, timeout=300)
    assert printed.strip() in re.findall(r"^prints `(.*?)`", page, re.MULTILINE)
    table = (tmp_path / "results/table.md").read_text(encoding="utf-8")
    headings = re.findall(r"^\| (loss(?:: \w+)?|median|worst 5 %|below half) \|", page, re.MULTILINE)
    assert len(headings) == 7
    for heading in headings:
        assert f"| {heading} " in table
    assert f"less than {metrics.AFTERMATH_S:g} s after" in page
    for other in others:
        name, *words = other.split()
        parser = argparse.ArgumentParser()
        COMMANDS[name].add_arguments(parser)
        assert parser.parse_args(words).scenario


def _changed(text: str, change: str) -> str:
    """A text with the parts of a diff changed, each of which stands in it once."""
    for part in change.split("@@\n"):
        lines = part.splitlines()
        before = "\n".join(line[1:] for line in lines if line[0] in " -")
        after = "\n".join(line[1:] for line in lines if line[0] in " +")
        assert text.count(before) == 1, before
        text = text.replace(before, after)
    return text


def test_the_effect_that_is_added_from_nothing_works(tmp_path: Path) -> None:
    """The page's files and changes in a copy of the package; its test, and v0's digests, pass there."""
    for name in ("uwoc_gym", "tests/uwoc_gym/golden"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    golden = "tests/uwoc_gym/test_golden.py"
    shutil.copyfile(ROOT / golden, tmp_path / golden)
    page = (DOCS / "add-an-effect.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^`([\w/.]+)`:\n\n```(python|diff)\n(.*?)```", page, re.DOTALL | re.MULTILINE)
    assert [kind for _, kind, _ in blocks].count("python") == 2
    for name, kind, text in blocks:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(
            text if kind == "python" else _changed(path.read_text(encoding="utf-8"), text), encoding="utf-8"
        )
    command = [sys.executable, "-m", "pytest", "-q", "--import-mode=importlib", "-p", "no:cacheprovider"]
    chosen = [name for name, _, _ in blocks if name.startswith("tests")] + [golden, "-k", "buffeting or Nominal"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    done = subprocess.run(
        [*command, *chosen], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "6 passed" in done.stdout


def test_what_is_learned_offline_flies(tmp_path: Path) -> None:
    """The page's network, learned on a few short episodes only, and so not as good as there."""
    pytest.importorskip("minari")
    pytest.importorskip("torch")
    page = (DOCS / "offline.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    commands = re.findall(r"^uwoc-gym (dataset .*|benchmark .*)$", page, re.MULTILINE)
    assert code.count("EPOCHS = 30\n") == 1
    (tmp_path / "clone.py").write_text(code.replace("EPOCHS = 30\n", "EPOCHS = 200\n"))
    (tmp_path / "short.json").write_text('{"base": "Random", "episode": {"duration_s": 4.0}}')
    environment = os.environ | {"MINARI_DATASETS_PATH": "datasets", "OMP_NUM_THREADS": "1"}

    def run(*words: str) -> str:
        command = [sys.executable, *words]
        return subprocess.check_output(command, text=True, cwd=tmp_path, env=environment, timeout=600)

    dataset, benchmark = (command.split() for command in commands)
    run("-m", "uwoc_gym_command", *dataset, "--scenario", "short.json", "--episodes", "20")
    assert "20 episodes, 1600 steps" in run("clone.py")
    words = ["short.json" if word == "Random" else "5" if word == "200" else word for word in benchmark]
    run("-m", "uwoc_gym_command", *words)
    results = json.loads((tmp_path / "results/results.json").read_text(encoding="utf-8"))
    expert, clone = (each["measures"]["return"]["mean"] for each in results["results"])
    assert 0.7 * expert < clone

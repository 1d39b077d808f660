"""The README: its tables are whole, its picture of the rooms is true to the tree, and what it says to type runs."""

from __future__ import annotations

import importlib.util
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from uwoc_gym.agents import cli
from uwoc_gym.agents.reports import cards, files, tables

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_readmes_tables_are_whole() -> None:
    assert "@@" not in README
    blocks = [[line for line in block.splitlines() if line.startswith("|")] for block in README.split("\n\n")]
    tables = [block for block in blocks if len(block) > 1]
    assert len(tables) >= 6
    for table in tables:
        assert len({line.count("|") for line in table}) == 1, table[0]


def picture(text: str) -> Iterator[str]:
    """The paths that a picture of rooms names: folders end in a slash, and two spaces further in stands what they hold.

    Files that the words beside a folder name lie in it, also where the words go on in the next line.
    """
    folders: list[str] = []
    for line in text.splitlines():
        depth = (len(line) - len(line.lstrip())) // 2
        names, _, words = line.strip().partition("  ")
        if depth > 4:
            words = line
        else:
            folders = folders[:depth]
            yield from ("".join([*folders, name]) for name in names.split(", "))
            if names.endswith("/"):
                folders.append(names)
        yield from ("".join([*folders, name]) for name in re.findall(r"\w+\.py", words))


def linked(page: Path) -> set[Path]:
    """The pages that a page links, and those that these link, and so on."""
    found = {page}
    left = [page]
    while left:
        here = left.pop()
        for target in re.findall(r"\]\(([^)#:]+\.md)", here.read_text(encoding="utf-8")):
            there = (here.parent / target).resolve()
            if there not in found:
                found.add(there)
                left.append(there)
    return found


def test_every_page_can_be_reached_from_the_readme() -> None:
    pages = set((ROOT / "docs").glob("*.md"))
    assert len(pages) > 5
    assert pages - linked(ROOT / "README.md") == set()


def lines_of_prose(text: str) -> list[str]:
    """The lines outside blocks, tables, headings and pictures."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return [line for line in text.splitlines() if not line.startswith(("|", "#", "!["))]


@pytest.mark.parametrize("page", ["README.md", "CHANGELOG.md", "docs/wrap.md"])
def test_lines_of_prose_are_short(page: str) -> None:
    prose = lines_of_prose((ROOT / page).read_text(encoding="utf-8"))
    assert len(prose) > 30
    assert [line for line in prose if len(line) > 120] == []


LAYOUT = README.split("## Layout")[1].split("```")[1].strip("\n")


def test_all_that_the_picture_names_exists() -> None:
    named = list(picture(LAYOUT))
    assert len(named) > 40
    assert [name for name in named if (ROOT / name).is_dir() != name.endswith("/")] == []
    assert [name for name in named if not (ROOT / name).exists()] == []
    assert len(set(named)) == len(named)


def test_every_room_is_in_the_picture() -> None:
    packages = [
        path.parent for folder in ("uwoc_gym", "baselines", "agents") for path in ROOT.glob(f"{folder}/**/__init__.py")
    ]
    rooms = {f"{path.relative_to(ROOT).as_posix()}/" for path in packages}
    assert len(rooms) > 15
    assert rooms - set(picture(LAYOUT)) == set()


def test_the_picture_is_read_as_it_looks() -> None:
    told = """
a/                a room
  b.py            a file
  c/              d.py, and what goes on
                  in e.py
    f/            a room in it
  g.py, h.py      files
i/, j/            rooms
"""
    assert list(picture(told.strip("\n"))) == [
        "a/", "a/b.py", "a/c/", "a/c/d.py", "a/c/e.py", "a/c/f/", "a/g.py", "a/h.py", "i/", "j/",
    ]  # fmt: skip


BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", README, re.DOTALL | re.MULTILINE)
PYTHON = [text for kind, text in BLOCKS if kind == "python"]
LINES = [line.strip() for kind, text in BLOCKS if kind == "bash" for line in text.splitlines() if line.strip()]

SHORT: dict[str, tuple[str, ...]] = {
    "python3 -m venv .venv && .venv/bin/python -m pip install -q -c constraints.txt -e": (),
    "source .venv/bin/activate": (),
    "grep -v staggered": (),
    "python -m rl_zoo3.train": ("--n-timesteps", "256", "-P", "--hyperparams", "n_steps:16", "n_envs:2"),
    "uwoc-gym list": (),
    "uwoc-gym train": (
        "--steps", "256", "--set", "n_envs=4", "--set", "n_steps=32", "--set", "batch_size=32",
        "--eval-every", "128", "--eval-episodes", "2",
    ),
    "uwoc-gym train --resume": (),
    "uwoc-gym benchmark": ("--scenario", "Random", "--seeds", "2", "--override", '{"episode": {"duration_s": 5.0}}'),
    # Controllers alone; trainings are in its own tests.
    "uwoc-gym protocol": (
        "--training-seeds", "0", "--scenario", "Random", "--seeds", "2",
        "--override", '{"episode": {"duration_s": 5.0}}',
    ),
    "uwoc-gym dataset": ("--episodes", "2", "--override", "episode.duration_s=5"),
    "uwoc-gym watch": (),
    "uwoc-gym record": ("--to", "28.2", "--size", "640x360"),
    "uwoc-gym replay": ("--override", '{"episode": {"duration_s": 3.0}}'),
    "uwoc-gym reproduce": (),
}  # fmt: skip
"""What is added to a line of the README, by how it begins, so that it runs in a test; the longest beginning counts."""

LEFT: dict[str, tuple[str, ...]] = {
    "uwoc-gym train": ("{out}/model.zip", "{out}/results.json", "{out}/settings.yaml", "{out}/curve.png"),
    "uwoc-gym benchmark": (),
    "uwoc-gym protocol": ("{out}/BENCHMARK.md", "{out}/results.json"),
    "uwoc-gym dataset": ("{out}/data/main_data.hdf5", "{out}/results.json"),
    "uwoc-gym record": ("pulse.mp4", "pulse.gif"),
    "uwoc-gym replay": ("replay.html",),
    "uwoc-gym reproduce": ("{out}/report.html", "{out}/report.md", "{out}/results.json"),
}
"""The files that a line leaves, by how it begins; {out} is what its --out says."""


def _beginning(line: str, among: Mapping[str, object]) -> str | None:
    """The longest of the beginnings that a line has."""
    return max((each for each in among if line.startswith(each)), key=len, default=None)


def test_every_line_for_the_shell_is_known_and_said_one_way() -> None:
    assert len(LINES) > 14
    for line in LINES:
        assert _beginning(line, SHORT) is not None, line
    # Once the environment is active, nothing is called by its path; before, everything is.
    active = LINES.index("source .venv/bin/activate")
    assert [line for line in LINES[:active] if line.startswith("uwoc-gym")] == []
    setups = [line for line in LINES if line.startswith("python3 -m venv")]
    assert [line for line in LINES[active + 1 :] if ".venv/bin" in line and line not in setups] == []
    assert len(setups) == 2


def _commands() -> Iterator[str]:
    """Every command in the text and in the captions, outside blocks."""
    text = re.sub(r"^```.*?^```", "", README, flags=re.DOTALL | re.MULTILINE)
    for found in re.findall(r"`(uwoc-gym [^`]*)`", text):
        yield " ".join(found.split())


@pytest.mark.parametrize("command", sorted({*_commands()} | {line for line in LINES if line.startswith("uwoc-gym")}))
def test_every_command_is_one(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its words are understood; what it would do is left out."""
    ran = []
    for module in cli.COMMANDS.values():
        monkeypatch.setattr(module, "run", lambda args: ran.append(args) or 0)
    words = shlex.split(command, comments=True)
    if len(words) == 2:
        assert words[1] in cli.COMMANDS
    else:
        assert cli.main(words[1:]) == 0
        assert len(ran) == 1


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the README's lines and snippets find what they name."""
    folder = tmp_path_factory.mktemp("readme")
    (folder / "agents").symlink_to(ROOT / "agents")
    (folder / "my_package").mkdir()
    (folder / "my_package/__init__.py").write_text("")
    (folder / "my_package/policies.py").write_text(
        "from uwoc_gym.baselines import NLPDController\n\n\n"
        "def make(scenario):\n    return NLPDController(scenario=scenario)\n"
    )
    return folder


def _run(command: Sequence[str], desk: Path, **more: Any) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(desk), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        command, cwd=desk, env=environment, capture_output=True, text=True, check=False, timeout=900, **more
    )


LESS = {
    r"\blearn\([\d_]+\)": "learn(64)",
    r"\bn_envs=256\b": "n_envs=2",
    r"\bn_steps=64\b": "n_steps=32",
    r"\bbatch_size=2048\b": "batch_size=32",
    r"\bnum_envs=256\b": "num_envs=4",
    r"\bn_eval_episodes=10\b": "n_eval_episodes=1",
}
"""What a snippet has less of in a test, by what it says."""


def _shortened(snippet: str) -> str:
    """A snippet that does what it says with less of it."""
    for much, little in LESS.items():
        snippet = re.sub(much, little, snippet)
    return snippet


@pytest.mark.parametrize("much", LESS)
def test_what_is_shortened_stands_in_one_snippet(much: str) -> None:
    assert sum(len(re.findall(much, snippet)) for snippet in PYTHON) == 1


def test_every_snippet_of_python_runs(desk: Path) -> None:
    modules = ("stable_baselines3", "moviepy", "pygame")
    for module in modules:
        pytest.importorskip(module)
    assert len(PYTHON) >= 6
    for snippet in PYTHON:
        if "name_scenario" in snippet:
            # This one is a module, as the text says.
            (desk / "my_project").mkdir()
            (desk / "my_project/__init__.py").write_text(snippet)
            snippet = 'import gymnasium as gym\ngym.make("my_project:uwoc/Heavy-v0").reset(seed=0)\n'
        done = _run([sys.executable, "-c", _shortened(snippet)], desk)
        assert done.returncode == 0, f"{snippet}\n{done.stderr}"
        for expression, told in re.findall(r"^print\((.+)\)  # (.+)$", snippet, re.MULTILINE):
            assert done.stdout.strip() == told, expression
    assert (desk / "my_agent.zip").stat().st_size > 1000


def test_the_snippet_that_records_leaves_a_video(desk: Path, video_facts: Callable[[Path], Any]) -> None:
    pytest.importorskip("moviepy")
    pytest.importorskip("pygame")
    (snippet,) = (each for each in PYTHON if "RecordVideo" in each)
    told = re.search(r"# writes (\S+)", snippet)
    assert told
    path = desk / told[1]
    path.unlink(missing_ok=True)
    done = _run([sys.executable, "-c", snippet], desk)
    assert done.returncode == 0, done.stderr
    assert video_facts(path).frames == 201


@pytest.mark.long
def test_every_line_for_the_shell_runs(desk: Path) -> None:
    for needed in ("stable_baselines3", "minari", "pygame", "imageio_ffmpeg", "plotly", "matplotlib", "tqdm"):
        pytest.importorskip(needed)
    (agent,) = (each for each in PYTHON if "my_agent.zip" in each)
    assert _run([sys.executable, "-c", _shortened(agent)], desk).returncode == 0
    for line in LINES:
        begins = _beginning(line, SHORT)
        assert begins is not None
        if begins.startswith("python3 -m venv"):
            # What follows the installation; .ci/run runs the tests' line as it stands.
            line = line.split(" && ")[-1].replace(".venv/bin/", "")
            begins = "uwoc-gym benchmark"
            if "pytest" in line:
                continue
        if "rl_zoo3" in line and importlib.util.find_spec("rl_zoo3") is None:
            continue
        words = [*shlex.split(line, comments=True), *SHORT[begins]]
        if begins.startswith("source"):
            continue
        if ">" in words:
            words = ["bash", "-c", line]
        if begins == "uwoc-gym watch":
            command = [Path(sys.executable).with_name(words[0]), *words[1:]]
            environment = os.environ | {"SDL_VIDEODRIVER": "dummy"}
            with subprocess.Popen(command, cwd=desk, env=environment) as process:
                with pytest.raises(subprocess.TimeoutExpired):
                    process.wait(20)
                process.send_signal(signal.SIGINT)
                assert process.wait(60) == 130
            continue
        done = _run(words, desk)
        assert done.returncode == 0, f"{words}\n{done.stderr}"
        out = words[words.index("--out") + 1] if "--out" in words else ""
        left = [*LEFT.get(_beginning(line, LEFT) or "", ())]
        if begins == "uwoc-gym benchmark" and out:
            left = ["{out}/table.md", "{out}/results.json", "{out}/episodes.csv", "{out}/Random.png"]
        for name in left:
            assert (desk / name.format(out=out)).stat().st_size > 0, (words, name)


DRAWN = ("Random", "Underactuated", "Tide", "LateFix")


def test_the_first_table_is_what_the_benchmark_found() -> None:
    """The table of returns, and how many IDs each agent is ahead on, against the figures kept beside the agents."""
    scores = files.read_json(cards.SCORES)
    worlds = [
        tables.headline([e for e in scores["results"] if (e["scenario"] in DRAWN) == own]) for own in (True, False)
    ]
    assert all(tables.grid(*table) in README for table in worlds)
    first = next(line for line in README.splitlines() if line.startswith("|"))
    assert first == tables.grid(*worlds[0]).splitlines()[0]
    assert all(f"`{command}`" in " ".join(README.split()) for command in scores["commands"])
    for name in ("ppo", "ppo-residual", "td3", "ppo-underactuated", "ppo-tide", "ppo-latefix"):
        standings = cards.standings(scores, name)
        ahead, flown = len(standings["ahead"]), sum(map(len, standings.values()))
        assert re.search(rf"`{name}` is ahead of `nlpd-tuned`\s+on\s+{ahead} of {flown}", " ".join(README.split())), (
            name
        )

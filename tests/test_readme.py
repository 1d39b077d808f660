"""The README: its tables are whole, and its picture of the rooms is true to the tree."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

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

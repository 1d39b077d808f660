"""The README."""

from __future__ import annotations

from pathlib import Path


def test_readmes_tables_are_whole() -> None:
    text = (Path(__file__).parents[1] / "README.md").read_text(encoding="utf-8")
    assert "@@" not in text
    blocks = [[line for line in block.splitlines() if line.startswith("|")] for block in text.split("\n\n")]
    tables = [block for block in blocks if len(block) > 1]
    assert len(tables) >= 6
    for table in tables:
        assert len({line.count("|") for line in table}) == 1, table[0]

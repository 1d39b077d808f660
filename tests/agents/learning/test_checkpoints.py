"""Checkpoints that are whole or not there."""

from __future__ import annotations

from pathlib import Path
from typing import IO

import pytest

from uwoc_gym.agents.learning import checkpoints


def test_what_a_kill_leaves_behind_is_not_taken_for_a_checkpoint(tmp_path: Path) -> None:
    def fill(folder: Path) -> None:
        (folder / "file").write_text("whole")

    assert checkpoints.newest(tmp_path) is None
    first = checkpoints.write(tmp_path, fill)
    left = tmp_path / "checkpoint-000002.part"
    left.mkdir()
    (left / "file").write_text("ha")
    assert checkpoints.newest(tmp_path) == first
    second = checkpoints.write(tmp_path, fill)
    assert (second.name, (second / "file").read_text()) == ("checkpoint-000002", "whole")
    # Killed between the new name and the removal of the old one.
    (tmp_path / "checkpoint-000001").mkdir()
    assert checkpoints.newest(tmp_path) == second
    assert [path.name for path in tmp_path.iterdir() if path.suffix] == []


def test_an_agent_that_fails_to_be_written_is_the_one_before(tmp_path: Path) -> None:
    path = tmp_path / "model.zip"

    def write(file: IO[bytes], fail: bool = True) -> None:
        file.write(b"half")
        assert not path.exists() or path.read_bytes() == b"half of the first"
        if fail:
            raise RuntimeError("PytorchStreamWriter failed writing file\nand more")
        file.write(b" of the first")

    checkpoints.save_agent(path, lambda file: write(file, False))
    with pytest.raises(OSError, match="PytorchStreamWriter failed writing file") as caught:
        checkpoints.save_agent(path, write)
    assert caught.value.filename == str(path)
    assert path.read_bytes() == b"half of the first"
    assert list(tmp_path.iterdir()) == [path]

"""What `uwoc-gym replay` refuses."""

from __future__ import annotations

from pathlib import Path

import pytest

from uwoc_gym.agents.cli import main

pytest.importorskip("plotly")


def test_existing_pages_are_kept_without_force(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "page.html"
    path.write_text("mine")
    assert main(["replay", "--out", str(path)]) == 1
    assert "--force" in capsys.readouterr().err
    assert path.read_text() == "mine"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--policy", "x"], ["--policy", "Valid names: pd, pd-plain, nlpd"]),
        (["--scenario", "x"], ["--scenario", "uwoc/Nominal-v0"]),
        (["--out", "page.txt"], ["--out page.txt", ".html"]),
        (["--at", "-1"], ["--at", "from 0.0 to"]),
    ],
)
def test_errors_are_one_line(options: list[str], words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", *options]) in (1, 2)
    error = capsys.readouterr().err
    assert len(error.splitlines()) == 1
    for word in words:
        assert word in error

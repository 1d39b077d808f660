"""One policy through one scenario."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 5.0}})


def test_evaluate_writes_what_it_prints(
    short_file: Callable[[float], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--scenario", str(short_file(5.0)), "--seed", "7", "--seeds", "2", "--out", str(tmp_path / "out")]
    assert main(["evaluate", "nlpd", *options]) == 0
    results = json.loads((tmp_path / "out/results.json").read_text())
    assert [row["seed"] for row in results["episodes"]] == [7, 8]
    assert results["scenarios"] == {"short": SHORT.digest()}
    mean = results["results"][0]["measures"]["return"]["mean"]
    assert mean == pytest.approx(np.mean([row["return"] for row in results["episodes"]]))
    assert f"{mean:.1f} [" in capsys.readouterr().out
    assert main(["evaluate", "nlpdd"]) == 1
    assert "did you mean 'nlpd'?" in capsys.readouterr().err

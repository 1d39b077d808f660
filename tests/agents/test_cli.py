"""The command line: help, and errors of one line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from uwoc_gym.agents.cli import COMMANDS, main


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["benchmark", "--policy", "nlpdd"], ["--policy", "did you mean 'nlpd'?"]),
        (["benchmark", "--policy", "no_such_module:thing"], ["--policy", "can't be imported"]),
        (["benchmark", "--policy", "missing.zip"], ["--policy", "'missing.zip'", "no such file", "module:callable"]),
        (
            ["evaluate", __file__.rpartition("/")[0]],
            ["POLICY", "tests/agents': the folder has no model.zip", "module:callable"],
        ),
        (["benchmark", "--policy", __file__], ["--policy", "not a zip file saved by Stable-Baselines3"]),
        (["benchmark", "--scenario", "Nominl"], ["--scenario", "did you mean 'Nominal'?"]),
        (["benchmark", "--scenario", "missing.json"], ["--scenario", "missing.json"]),
        (["benchmark", "--scenario", __file__], ["--scenario", "JSON"]),
        (["benchmark", "--seeds", "0"], ["--seeds", "'0'", "from 1 to"]),
        (["benchmark", "--seeds", "many"], ["--seeds", "'many'"]),
        (["benchmark", "--seed", "-1"], ["--seed"]),
        (["benchmark", "--control-period", "0"], ["--control-period", "from 0.001 to"]),
        (["benchmark", "--control-period", "0.007"], ["--control-period", "multiple"]),
        (["benchmark", "--out", f"{__file__}/out"], ["--out", "folder"]),
        (["speed", "--rounds", "0"], ["--rounds", "from 1 to"]),
        (["speed", "--out", __file__], ["--out", "folder"]),
        (["nonsense"], ["nonsense"]),
        (["evaluate", "--override", "depth_m=2", "pd"], ["POLICY must stand before options", "--override"]),
        (["tune", "--wrapper", "a:b", "pd", "--out", "out"], ["target must stand before options"]),
        (["evaluate", "pd", "--override", "a", "--out"], ["--out"]),
        ([], ["COMMAND"]),
    ],
)
def test_errors_are_one_line(options: list[str], words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(options) not in (0, 130)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    for word in words:
        assert word in captured.err


@pytest.mark.parametrize(("missing", "extra"), [("matplotlib", "benchmark"), ("tqdm", "benchmark")])
def test_a_missing_extra_is_named(
    missing: str, extra: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import importlib.util

    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == missing else real(name))
    assert main(["benchmark", "--out", str(tmp_path)]) == 1
    assert f'pip install "uwoc-gym[{extra}]"' in capsys.readouterr().err


@pytest.mark.parametrize("options", [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)])
def test_help_and_version(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(options) == 0
    assert "uwoc-gym" in capsys.readouterr().out


pytest.importorskip("imageio_ffmpeg")


def test_the_shell_needs_no_pygame_until_something_is_drawn() -> None:
    import subprocess

    code = (
        "import sys; from uwoc_gym.agents import cli; cli.main(['list'])\n"
        "sys.exit(', '.join({'pygame', 'plotly', 'torch', 'matplotlib'} & set(sys.modules)) or 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=300, stdout=subprocess.DEVNULL)


def test_the_package_stays_light() -> None:
    code = (
        "import sys, uwoc_gym, uwoc_gym.agents.cli; "
        "print([name for name in ('torch', 'stable_baselines3', 'matplotlib') if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"

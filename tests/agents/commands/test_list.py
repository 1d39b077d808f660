"""The list."""

from __future__ import annotations

import pytest

from uwoc_gym import ENV_IDS
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.policies.registry import POLICIES


def test_list_names_everything(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list"]) == 0
    text = capsys.readouterr().out
    for name in (*ENV_IDS, *ENV_IDS.values(), *POLICIES):
        assert name in text

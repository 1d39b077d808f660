"""A command whose episodes diverge says so and fails, whatever let the scenario through."""

from __future__ import annotations

import math

import pytest

from uwoc_gym.agents.cli import main

STIFF = ["--override", '{"vehicle": {"damping_scale": 100.0}, "episode": {"integration_step_s": 0.05}}']


@pytest.fixture
def unchecked(monkeypatch):
    monkeypatch.setattr("uwoc_gym.world.auv.limits.Motion.longest_step", lambda motion, rate: math.inf)
    monkeypatch.setattr("uwoc_gym.scenario.FASTEST", math.inf)


@pytest.mark.parametrize(
    "command",
    [
        ["benchmark", "--policy", "nlpd-tuned", "--scenario", "Nominal", "--seeds", "1", *STIFF],
        ["evaluate", "nlpd-tuned", "--scenario", "Nominal", "--seeds", "1", *STIFF],
        ["train", "--env", "uwoc/Nominal-v0", "--steps", "4096", "--out", "run", *STIFF],
    ],
    ids=lambda command: command[0],
)
def test_a_diverged_flight_is_an_error(command, unchecked, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(command) == 1
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "the integrator couldn't follow" in said
    assert "integration_step_s" in said

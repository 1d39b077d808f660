"""Tuning: what is scored, on which seeds, and that the shipped gains are what they say."""

from __future__ import annotations

import json

import numpy as np
import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.flight import POLICIES, fly
from uwoc_gym.agents.learning import tuning as tune
from uwoc_gym.agents.learning.seeds import HELD_OUT, VALIDATION, training_seed
from uwoc_gym.baselines import gains

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 4.0}})


def test_score_is_the_mean_return_on_training_seeds():
    points = [tune._point(gains(name), tune._NLPD_BOX) for name in ("paper-pd", "tuned-nlpd")]
    scored = tune.controller_score(SHORT, 0, 6)(points)
    first = training_seed(0)
    for name, (score, outcome) in zip(("pd", "nlpd-tuned"), scored, strict=True):
        flown = fly(POLICIES[name], SHORT, range(first, first + 6)).metrics
        assert score == pytest.approx(flown.return_.mean(), rel=1e-3)
        assert outcome["availability"] == pytest.approx(flown.availability.mean(), rel=0.02)


def test_training_validation_and_held_out_seeds_never_meet():
    first = training_seed(0)
    assert not set(HELD_OUT) & set(VALIDATION)
    assert min(first, training_seed(7)) > max(*HELD_OUT, *VALIDATION)


def test_gains_of_a_point_and_back():
    law = gains("tuned-nlpd")
    point = tune._point(law, tune._NLPD_BOX)
    again = tune.gains_of(point)
    for name in ("a_p", "a_v", "b_p", "b_v", "mu_p", "mu_v"):
        np.testing.assert_allclose(getattr(again, name), getattr(law, name))


@pytest.mark.parametrize(("tuned", "printed"), [("pd-tuned", "pd"), ("nlpd-tuned", "nlpd")])
def test_tuned_gains_beat_the_printed_ones_on_validation_seeds(tuned, printed):
    scenario = Scenario.named("Random")
    scores = {name: fly(POLICIES[name], scenario, VALIDATION[:32]).metrics.return_ for name in (tuned, printed)}
    assert (scores[tuned] - scores[printed]).mean() > 20.0


def test_controller_is_tuned_and_resumed(tmp_path, capsys):
    path = tmp_path / "short.json"
    path.write_text(SHORT.to_json())
    words = ["tune", "pd", "--scenario", str(path), "--batch", "4", "--episodes", "4", "--out", str(tmp_path / "out")]
    assert main([*words, "--trials", "8"]) == 0
    results = json.loads((tmp_path / "out/results.json").read_text())
    found = json.loads((tmp_path / "out/gains.json").read_text())
    assert found["a_p"][0] == results["found"]["a_p_xy"]
    assert results["trials"] == 8
    assert results["scenarios"] == {"short": SHORT.digest()}
    assert main([*words, "--trials", "16", "--resume"]) == 0
    again = json.loads((tmp_path / "out/results.json").read_text())
    assert again["trials"] == 16
    assert again["score"] >= results["score"]
    assert main([*words, "--trials", "16", "--resume", "--episodes", "5"]) == 1
    assert "another episodes" in capsys.readouterr().err


def test_learner_is_tuned_by_short_trainings(tmp_path):
    out = tmp_path / "out"
    words = ["tune", "td3", "--env", "uwoc/Nominal-v0", "--trials", "2", "--steps", "200", "--out", str(out)]
    assert main(words) == 0
    results = json.loads((out / "results.json").read_text())
    trial = json.loads((out / "trial-0001/results.json").read_text())
    assert results["scenarios"] == {"uwoc/Nominal-v0": Scenario.named("Nominal").digest()}
    assert results["score"] >= trial["best"]["return"]["mean"]
    best = out / f"trial-{int(results['outcome']['trial']):04d}"
    assert results["score"] == json.loads((best / "results.json").read_text())["best"]["return"]["mean"]
    assert (out / "settings.yaml").read_text() == (best / "settings.yaml").read_text()
    assert "lin_" in (out / "settings.yaml").read_text()
    assert trial["settings"]["tau"] != json.loads((out / "trial-0000/results.json").read_text())["settings"]["tau"]


def test_refuses_an_unknown_scenario(tmp_path, capsys):
    assert main(["tune", "pd", "--scenario", "Randm", "--out", str(tmp_path)]) == 1
    assert "--scenario: there is no scenario 'Randm'; did you mean 'Random'" in capsys.readouterr().err

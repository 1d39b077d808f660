"""Tuning from end to end."""

from __future__ import annotations

import json

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main

SHORT = Scenario.named("Random").merged({"episode": {"duration_s": 4.0}})


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


def test_a_search_begins_where_it_is_told_in_the_box_it_is_told(tmp_path, capsys):
    path = tmp_path / "short.json"
    path.write_text(SHORT.to_json())
    words = ["--scenario", str(path), "--batch", "4", "--episodes", "4", "--trials", "4"]
    first = ["tune", "ekf-nlpd", *words, "--begin", "nlpd-tuned", "--box", "a_p_xy=3000:3001", "mu_p_xy=0.25:0.5"]
    assert main([*first, "--out", str(tmp_path / "first")]) == 0
    document = json.loads((tmp_path / "first/results.json").read_text())
    assert 3000.0 <= document["found"]["a_p_xy"] <= 3001.0
    assert 0.25 <= document["found"]["mu_p_xy"] <= 0.5
    gains = json.loads((tmp_path / "first/gains.json").read_text())
    assert gains["law"] == "ekf-nlpd"
    again = [*first, "--out", str(tmp_path / "first"), "--resume"]
    assert main([word if word != "nlpd-tuned" else "nlpd" for word in again]) == 1
    assert "another begin" in capsys.readouterr().err
    # What was found is begun at, and flies as it is.
    assert main(["tune", "nlpd", *words, "--begin", str(tmp_path / "first"), "--out", str(tmp_path / "second")]) == 0
    out = ["--scenario", str(path), "--out", str(tmp_path / "flown")]
    policies = [str(tmp_path / "first"), str(tmp_path / "second/gains.json")]
    assert main(["benchmark", "--policy", *policies, *out, "--seeds", "2"]) == 0
    capsys.readouterr()
    for begin, said in (
        ("nlpd-tuend", "--begin: there are no gains 'nlpd-tuend'; give a controller that uwoc-gym list shows"),
        ("lqr", "--begin: 'lqr' holds RegulatorScales; pd is set by Gains."),
    ):
        assert main(["tune", "pd", *words, "--begin", begin, "--out", str(tmp_path / "third")]) == 1
        assert said in capsys.readouterr().err
    assert main(["tune", "pd", *words, "--box", "b_p_xy=1:2", "--out", str(tmp_path / "third")]) == 1
    assert "--box b_p_xy=1:2: there is no number 'b_p_xy'" in capsys.readouterr().err
    assert not (tmp_path / "third").exists()


def test_a_learner_has_neither_box_nor_beginning(tmp_path, capsys):
    for words in (["--begin", "nlpd"], ["--box", "a_p_xy=1:2"]):
        assert main(["tune", "td3", *words, "--out", str(tmp_path)]) == 1
        assert f"{words[0]} is not allowed for td3, a learner" in capsys.readouterr().err


def test_refuses_an_unknown_scenario(tmp_path, capsys):
    assert main(["tune", "pd", "--scenario", "Randm", "--out", str(tmp_path)]) == 1
    assert "--scenario: there is no scenario 'Randm'; did you mean 'Random'" in capsys.readouterr().err


def test_learner_is_tuned_on_what_is_said(tmp_path):
    path = tmp_path / "short.json"
    path.write_text(SHORT.to_json())
    words = ["tune", "td3", "--scenario", str(path), "--override", '{"depth_m": 3.7}', "--trials", "1", "--steps", "64"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    flown = SHORT.merged({"depth_m": 3.7}).digest()
    assert json.loads((tmp_path / "out/results.json").read_text())["scenarios"] == {"short": flown}
    trial = json.loads((tmp_path / "out/trial-0000/results.json").read_text())
    assert trial["scenarios"]["evaluation"] == flown


def test_a_controller_is_tuned_in_no_other_environment(tmp_path, capsys):
    assert main(["tune", "pd", "--env", "CartPole-v1", "--out", str(tmp_path)]) == 1
    assert "--env is not allowed for pd" in capsys.readouterr().err

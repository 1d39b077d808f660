"""The paper's numbers, figures and report, as the command writes them."""

from __future__ import annotations

import json
import re
import struct

import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.reports import paper_figures
from uwoc_gym.baselines.paper import IMPROVEMENT, PUBLISHED, improvement, sampled_as_published, without_coriolis

LARGEST_RESIDUAL_PERCENT = {"case-1": 8.0, "case-2": 9.0}
"""Of the calibrated cases, over seeds of the noise that the search hasn't seen."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("reproduction")
    assert main(["reproduce", "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def results(folder):
    return json.loads((folder / "results.json").read_text(encoding="utf-8"))


def test_cone_is_the_published_one(results):
    cone = results["cone"]
    assert all(abs(value) < 0.1 for value in cone["surface"]["difference_percent"].values())
    assert cone["printed"]["slant_height_m"] == pytest.approx(3.644, abs=5e-4)


def test_every_scenario_is_told_by_its_digest(results):
    assert len(results["scenarios"]) == 7
    plain = sampled_as_published(Scenario.named("PaperCaseI"))
    assert results["scenarios"]["PaperCaseI, NLPD's plant"] == plain.digest()
    assert results["scenarios"]["PaperCaseI, PD's plant"] == without_coriolis(plain).digest()


@pytest.mark.parametrize(
    ("label", "law", "late_s"), [("PD, as found", "PD", 0.005), ("NLPD, as printed", "NLPD", 0.01)]
)
def test_nominal_rows_are_the_published_ones(results, label, law, late_s):
    row, published = results["tables"]["nominal"][label], PUBLISHED["nominal", law]
    assert row["arrival_time_s"] == pytest.approx(published.arrival_time_s, abs=late_s + 1e-9)
    for key in ("rmse_x_m", "rmse_y_m", "rmse_yaw_rad"):
        assert row[key] == pytest.approx(getattr(published, key), rel=0.02)


def test_printed_pulse_breaks_no_link_and_a_larger_one_does(results):
    for case in ("case-1", "case-2"):
        assert all(row["restoring_time_s"] == 0.0 for row in results["tables"][case].values())
    sweep = results["sweep"]
    for law in ("PD, as printed", "NLPD, as printed"):
        peaks = sweep[law]["peak_range_m"]
        assert peaks == sorted(peaks)
        assert sweep[law]["at_shown_pulse_s"] > 0.5


@pytest.mark.parametrize("case", ["case-1", "case-2"])
def test_calibrated_settings_come_near_the_published_rows(results, case):
    found = results["calibrated"][case]
    assert found["rms_residual_percent"] < LARGEST_RESIDUAL_PERCENT[case]
    for law in ("PD", "NLPD"):
        for key in ("rmse_x_m", "rmse_y_m", "rmse_yaw_rad", "arrival_time_s"):
            assert abs(found["rows"][law]["difference_percent"][key]) < 10.0
    # The published contrast: the PD loses the link, the NLPD hardly or not at all.
    assert found["rows"]["PD"]["restoring_time_s"] > 0.7
    assert found["rows"]["NLPD"]["restoring_time_s"] < 0.2


def test_stability_claim_holds_along_the_flights(results):
    for law in ("PD, as printed", "NLPD, as printed"):
        found = results["lyapunov"][law]
        assert found["largest_rise_in_a_sample_j"] < 1e-6 * found["initial_j"]
        assert found["largest_imbalance_percent"] < 2.0
        assert found["largest_eigenvalue_of_inequality"] < 0.0


def test_published_improvements_follow_from_the_rows_but_for_two_misprints():
    for case in ("nominal", "case-1", "case-2"):
        ours = improvement(PUBLISHED[case, "PD"], PUBLISHED[case, "NLPD"])
        misprints = [
            key
            for key in ("rmse_x_m", "rmse_y_m", "rmse_yaw_rad", "arrival_time_s")
            if abs(getattr(ours, key) - getattr(IMPROVEMENT[case], key)) > 2e-4
        ]
        assert misprints == {"nominal": [], "case-1": ["rmse_yaw_rad"], "case-2": ["arrival_time_s"]}[case]


def test_every_figure_is_an_image_of_the_promised_size(folder):
    pictures = sorted(folder.glob("*.png"))
    assert len(pictures) == 31
    width, height = (round(inches * paper_figures.DOTS_PER_INCH) for inches in paper_figures.SIZE_INCHES)
    for path in pictures:
        data = path.read_bytes()
        assert data[:8] == b"\x89PNG\r\n\x1a\n"
        assert struct.unpack(">II", data[16:24]) == (width, height)
        assert len(data) > 20_000
        assert "<svg" in path.with_suffix(".svg").read_text(encoding="utf-8")


def test_report_shows_every_figure_and_opens_offline(folder):
    text = (folder / "report.md").read_text(encoding="utf-8")
    html = (folder / "report.html").read_text(encoding="utf-8")
    names = {path.stem for path in folder.glob("*.png")}
    assert set(re.findall(r"\]\((\w[\w-]*)\.png\)", text)) == names
    assert html.count("data:image/svg+xml;base64,") == len(names)
    assert not re.search(r"""(src|href)=["'](?!data:)""", html)


def numbers_in(data):
    if isinstance(data, dict):
        return [number for value in data.values() for number in numbers_in(value)]
    if isinstance(data, list):
        return [number for value in data for number in numbers_in(value)]
    return [float(data)] if isinstance(data, (int, float)) and not isinstance(data, bool) else []


def test_report_names_no_number_that_the_results_lack(folder, results):
    known = numbers_in(results)
    text = re.sub(r"!\[.*?\]\(.*?\)|log10", "", (folder / "report.md").read_text(encoding="utf-8"))
    shown = re.findall(r"(?<![\w.-])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?", text.replace("−", "-"))
    assert len(shown) > 200
    for token in shown:
        mantissa, _, exponent = token.partition("e")
        digits = len(mantissa.partition(".")[2])
        unit = 10.0 ** (int(exponent or 0) - digits)
        # Half a unit of the last digit that is shown, and a little for a value that lies on the half.
        assert any(abs(float(token) - value) <= 0.5001 * unit for value in known), token


def test_needs_a_folder_that_can_be_written(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    assert main(["reproduce", "--out", str(tmp_path / "file")]) == 1
    assert "--out" in capsys.readouterr().err

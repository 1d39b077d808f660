"""What the replay page holds."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

from uwoc_gym import Scenario
from uwoc_gym.agents.cli import main
from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.policies.registry import load
from uwoc_gym.agents.viewing import replay
from uwoc_gym.agents.viewing.episode import Episode

pytest.importorskip("plotly")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of a whole episode of 150 s."""
    path = tmp_path_factory.mktemp("replay") / "page.html"
    assert main(["replay", "--policy", "pd-plain", "nlpd", "--out", str(path)]) == 0
    return path


def data_of(page: Path) -> dict[str, Any]:
    text = page.read_text(encoding="utf-8")
    found = re.search(r'<script id="data" type="application/json">(.*?)</script>', text, re.DOTALL)
    assert found
    return dict(json.loads(found[1]))


def test_a_lost_link_and_strange_names_are_written_safely(tmp_path: Path) -> None:
    far = Scenario().merged({"start": {"x_m": 0.0, "y_m": -20.0}, "episode": {"lost_distance_m": 1.0}})
    policy = load("pd")
    flights = {"</script><b>": fly(policy, far, [0])}
    data = replay.page_data(Episode([policy], "<far>", far, 0), flights)
    text = replay.page(data, "var library;</script>")
    assert text.count("</script>") == 3
    assert data["outcome"][-1] == ["end", "link lost"]
    assert data["policies"][0]["log_rate"] == [None]
    path = tmp_path / "page.html"
    path.write_text(text, encoding="utf-8")
    assert data_of(path)["policies"][0]["name"] == "</script><b>"

"""Ray Tune."""

from __future__ import annotations

from checks import block, check, run


@check
def page() -> None:
    """The search for a scenario's worst fixes in docs/cluster.md, cut to 3 samples"""
    found = block("cluster.md", "tune.Tuner", {"SAMPLES = 8": "SAMPLES = 3"})["found"]
    assert 0.3 < found.metrics["availability"] < 0.96
    assert found.config["period_s"] > 1.0


if __name__ == "__main__":
    run()

"""Rows of the paper's tables."""

from __future__ import annotations

import math

from uwoc_gym.agents.reports.reproduction import row_cells


def test_a_row_says_never() -> None:
    row = {"rmse_x_m": 0.5, "rmse_y_m": 0.25, "rmse_yaw_rad": math.nan, "arrival_time_s": math.nan}
    assert row_cells({**row, "restoring_time_s": math.inf}) == ["0.5000", "0.2500", "–", "never", "never"]
    assert row_cells({**row, "restoring_time_s": 0.0})[-1] == "none"
    assert row_cells({**row, "restoring_time_s": 0.0}, outage=False)[-1] == "–"

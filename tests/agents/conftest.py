"""What several tests of agents use: one thread, short scenarios, and a policy that does nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uwoc_gym import Scenario

# Networks as small as those of the tests gain nothing from more.
os.environ.setdefault("OMP_NUM_THREADS", "1")


class Still:
    """A policy that does nothing."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        return np.zeros((len(observation), 3), dtype=np.float32), state


@pytest.fixture
def still() -> Still:
    """A policy that does nothing."""
    return Still()


@pytest.fixture
def short_file(tmp_path: Path) -> Callable[[float], Path]:
    """Writes Random with episodes of so many seconds to a file, short.json."""

    def write(duration_s: float) -> Path:
        path = tmp_path / "short.json"
        path.write_text(Scenario.named("Random").merged({"episode": {"duration_s": duration_s}}).to_json())
        return path

    return write

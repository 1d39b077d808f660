"""What several tests of agents use: one thread, short scenarios, and a policy that does nothing."""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable, Mapping
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


@pytest.fixture
def rewrite() -> Callable[[Path, Mapping[str, bytes | None]], None]:
    """Replaces members of a zip file; None takes one away."""

    def write(path: Path, members: Mapping[str, bytes | None]) -> None:
        with zipfile.ZipFile(path) as archive:
            held: dict[str, bytes | None] = {name: archive.read(name) for name in archive.namelist()}
        with zipfile.ZipFile(path, "w") as archive:
            for name, data in {**held, **members}.items():
                if data is not None:
                    archive.writestr(name, data)

    return write


@pytest.fixture
def describe_again(rewrite: Callable[[Path, Mapping[str, bytes | None]], None]) -> Callable[[Path, str, Any], None]:
    """Changes one field, such as "residual.scale", of what an agent's file says; ... takes it away."""

    def change(path: Path, field: str, value: Any) -> None:
        with zipfile.ZipFile(path) as archive:
            said = json.loads(archive.read("agent.json"))
        level, (*parents, last) = said, field.split(".")
        for parent in parents:
            level = level[parent]
        if value is ...:
            del level[last]
        else:
            level[last] = value
        rewrite(path, {"agent.json": json.dumps(said).encode()})

    return change

"""Policies side by side."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from uwoc_gym.agents.flight import fly
from uwoc_gym.agents.viewing.episode import Episode

pygame = pytest.importorskip("pygame")

from uwoc_gym.agents.viewing import stage as staging  # noqa: E402


@pytest.mark.parametrize(
    ("count", "size", "grid"),
    [(1, (1280, 720), (1, 1)), (2, (1280, 720), (2, 1)), (3, (1280, 720), (3, 1)), (4, (1280, 720), (2, 2)),
     (2, (720, 1280), (1, 2))],
)  # fmt: skip
def test_pictures_share_the_frame(count: int, size: tuple[int, int], grid: tuple[int, int]) -> None:
    cells = staging.cells(count, size)
    assert (len({cell.left for cell in cells}), len({cell.top for cell in cells})) == grid
    whole = pygame.Rect((0, 0), size)
    for i, cell in enumerate(cells):
        assert whole.contains(cell)
        assert cell.collidelist(cells[:i]) == -1


def test_a_stage_flies_the_episode_of_the_benchmark(an_episode: Callable[..., Episode]) -> None:
    wanted = an_episode("nlpd", "pd", seed=4)
    stage = staging.Stage(wanted, (640, 360))
    stage.fly_until(3.0)
    flight = fly(wanted.policies[0], wanted.scenario, [4])
    np.testing.assert_array_equal(stage.pilots[0].env.state()["pose"], flight.series.pose[60])
    assert stage.time_s == pytest.approx(3.0)

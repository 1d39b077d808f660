"""What keys do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from uwoc_gym.agents.viewing.episode import Episode

pygame = pytest.importorskip("pygame")

from uwoc_gym.agents.viewing.player import SHOVE, Player  # noqa: E402


@pytest.fixture
def press(monkeypatch: pytest.MonkeyPatch) -> Callable[[Player, str], bool]:
    def one(player: Player, key: str) -> bool:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=getattr(pygame, f"K_{key}")))
        return player.frame()

    return one


def test_keys(press: Callable[[Player, str], bool], an_episode: Callable[..., Episode]) -> None:
    wanted = an_episode("pd", "nlpd", override='{"episode": {"duration_s": 2.0}}')
    player = Player(wanted, (640, 360), 1.0)
    for _ in range(3):
        assert player.frame()
    time_s = player.stage.time_s
    assert time_s == pytest.approx(0.1)
    assert press(player, "SPACE")
    time_s = player.stage.time_s
    assert player.frame()
    assert player.stage.time_s == time_s
    assert press(player, "SPACE")
    assert press(player, "UP")
    assert player.speed == 2.0
    assert press(player, "DOWN")
    assert press(player, "DOWN")
    assert player.speed == 0.5
    before = [pilot.env.state()["velocity"] for pilot in player.stage.pilots]
    player.paused = True
    assert press(player, "RIGHT")
    after = [pilot.env.state()["velocity"] for pilot in player.stage.pilots]
    for i in range(2):
        assert after[i][1] - before[i][1] == pytest.approx(SHOVE / 250.0, rel=0.3)
    assert press(player, "LEFT")
    for i, pilot in enumerate(player.stage.pilots):
        np.testing.assert_allclose(pilot.env.state()["velocity"], before[i], atol=1e-12)
    player.paused = False
    assert press(player, "n")
    assert player.stage.seed == 1
    assert player.stage.time_s == 0.0
    assert press(player, "r")
    assert player.stage.seed == 1
    player.speed = 32.0
    for _ in range(5):
        assert player.frame()
    assert player.stage.ended
    assert press(player, "RIGHT")
    assert not press(player, "q")
    player.close()

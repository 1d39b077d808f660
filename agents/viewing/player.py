"""A window in which policies fly an episode, and that keys steer; needs pygame."""

from __future__ import annotations

from typing import Any

import pygame

from uwoc_gym.agents.viewing.episode import Episode
from uwoc_gym.agents.viewing.stage import Stage, hint
from uwoc_gym.rendering import Window

SHOVE = 600.0
"""Impulse of a shove [N s], and its part about yaw [N m s] over three."""
_FPS = 30.0
_SPEEDS = (0.125, 32.0)
_KEYS = "space: pause   up/down: speed   left/right: shove   N: next seed   R: again   Q: quit"


class Player:
    """The window, what it shows and what keys do to it.

    Args:
        wanted: Who flies what.
        size: Width and height of the window [px].
        speed: Times real time.

    Raises:
        NoDisplayError: There is no display.
    """

    def __init__(self, wanted: Episode, size: tuple[int, int], speed: float) -> None:
        strip = max(20, size[1] // 30)
        self._window = Window((size[0], size[1] + strip), "uwoc-gym watch")
        self._whole = pygame.Surface((size[0], size[1] + strip), 0, 32)
        self._strip = pygame.Rect(0, size[1], size[0], strip)
        self.stage = Stage(wanted, size)
        self.speed = speed
        self.paused = False
        self._clock_s = 0.0

    def frame(self) -> bool:
        """Fly on, show one picture and do what keys say; returns whether to go on."""
        if not self.paused and not self.stage.ended:
            self._clock_s += self.speed / _FPS
            self.stage.fly_until(self._clock_s)
        self._whole.blit(self.stage.draw(), (0, 0))
        state = "paused" if self.paused else f"speed {self.speed:g}"
        hint(self._whole, self._strip, f"{self.stage.words}   ·   {state}   ·   {_KEYS}")
        for event in self._window.show(self._whole, _FPS):
            self._handle(event)
        return not self._window.closed

    def _handle(self, event: Any) -> None:
        if event.type != pygame.KEYDOWN:
            return
        if event.key in (pygame.K_q, pygame.K_ESCAPE):
            self.close()
        elif event.key == pygame.K_SPACE:
            self.paused = not self.paused
        elif event.key in (pygame.K_UP, pygame.K_DOWN):
            wanted = self.speed * (2.0 if event.key == pygame.K_UP else 0.5)
            self.speed = min(max(wanted, _SPEEDS[0]), _SPEEDS[1])
        elif event.key in (pygame.K_LEFT, pygame.K_RIGHT):
            side, words = (-1.0, "port") if event.key == pygame.K_LEFT else (1.0, "starboard")
            for pilot in self.stage.pilots:
                pilot.push((0.0, side * SHOVE, side * SHOVE / 3.0), f"a shove to {words}")
        elif event.key in (pygame.K_n, pygame.K_r):
            self.stage.reset(self.stage.seed + (event.key == pygame.K_n))
            self._clock_s = 0.0

    def close(self) -> None:
        """Close the window."""
        self._window.close()

"""Policies on the same episode, flown step by step and drawn side by side; needs pygame."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pygame

from uwoc_gym.agents.errors import CommandError
from uwoc_gym.agents.flight import decide
from uwoc_gym.agents.policies.looks import looks
from uwoc_gym.agents.viewing.episode import Episode
from uwoc_gym.agents.wrapping import PLAIN, Wrapping
from uwoc_gym.baselines.policy import Policy
from uwoc_gym.rendering import Colour, Renderer, text_image
from uwoc_gym.scenario import Scenario
from uwoc_gym.spaces import SMALLEST_DETAILED
from uwoc_gym.wrapping import single_env


class Pilot:
    """One policy in an environment of its own, with its picture."""

    def __init__(
        self,
        policy: Policy,
        scenario: Scenario,
        size: tuple[int, int],
        accent: Colour,
        wrapping: Wrapping = PLAIN,
    ) -> None:
        self._policy = policy
        self.env = single_env(scenario)
        self._predictor = policy.pilot(scenario, self.env)
        self._period_s, self._steps = scenario.episode.control_period_s, 0
        self._wrapping = wrapping
        self._seen = wrapping.around(self.env)
        self._width = math.prod(self._seen.action_space.shape or ())
        self._memory: Any = None
        self._begun = True
        self._observation: Any = None
        self.renderer = Renderer(scenario, size, policy.name, accent)
        self.ended = False
        self.time_s = 0.0

    def reset(self, seed: int, title: str) -> None:
        """Begin the episode of a seed."""
        with self._wrapping.blamed():
            self._observation, _ = self._seen.reset(seed=seed)
        self._memory, self._begun, self.ended, self.time_s, self._steps = None, True, False, 0.0, 0
        self.renderer.title = title
        self.renderer.begin(self.env.state(), self.env.parameters())

    def step(self) -> None:
        """Fly one control period, unless the episode has ended.

        Raises:
            CommandError: The policy or a wrapper fails, or a wrapper's step isn't one control period.
        """
        if self.ended:
            return
        actions, self._memory = decide(
            self._policy, self._predictor, self._observation[None], self._memory, np.array([self._begun]), self._width
        )
        self._begun = False
        with self._wrapping.blamed():
            self._observation, _, terminated, truncated, _ = self._seen.step(actions[0])
        state = self.env.state()
        self.time_s = state["time_s"]
        self.renderer.record(state)
        self.ended = terminated or truncated
        self._steps += 1
        if self._wrapping and not self.ended:
            self._wrapping.check_clock(self.time_s, self._steps * self._period_s)
        if self.ended:
            self.renderer.note("the link is lost beyond recovery" if terminated else "end of the episode", math.inf)

    def push(self, impulse: npt.ArrayLike, words: str) -> None:
        """Give the AUV a shove [N s, N s, N m s], unless the episode has ended."""
        if not self.ended:
            self.env.push(impulse)
            self.renderer.note(words)


class Stage:
    """All policies of an episode, each with its part of one picture.

    Args:
        episode: Who flies what.
        size: Width and height of the whole picture [px].
    """

    def __init__(self, episode: Episode, size: tuple[int, int]) -> None:
        self.episode = episode
        self.surface = pygame.Surface(size, 0, 32)
        self._cells = cells(len(episode.policies), size)
        if any(cell.width < SMALLEST_DETAILED[0] or cell.height < SMALLEST_DETAILED[1] for cell in self._cells):
            number = f"{len(self._cells)} policies" if len(self._cells) > 1 else "one policy"
            raise CommandError(
                f"--size {size[0]}x{size[1]} is not allowed with {number}; each needs at least "
                f"{SMALLEST_DETAILED[0]}x{SMALLEST_DETAILED[1]}."
            )
        own = looks(policy.name for policy in episode.policies)
        self.pilots = [
            Pilot(policy, episode.scenario, cell.size, own[policy.name].rgb, episode.wrapping)
            for policy, cell in zip(episode.policies, self._cells, strict=True)
        ]
        self.reset(episode.seed)

    def reset(self, seed: int) -> None:
        """Begin the episode of a seed, the same for all."""
        self.seed = seed
        for pilot, policy in zip(self.pilots, self.episode.policies, strict=True):
            pilot.reset(seed, policy.name if len(self.pilots) > 1 else f"{policy.name} · {self.words}")

    @property
    def words(self) -> str:
        """The episode in a few words."""
        return f"{self.episode.scenario_name}, seed {self.seed}"

    @property
    def ended(self) -> bool:
        """Whether the episode has ended for all."""
        return all(pilot.ended for pilot in self.pilots)

    @property
    def time_s(self) -> float:
        """Time of the one that has flown longest [s]."""
        return max(pilot.time_s for pilot in self.pilots)

    def fly_until(self, time_s: float) -> None:
        """Let everyone fly to that time [s], or to the end of their episode."""
        for pilot in self.pilots:
            while not pilot.ended and pilot.time_s < time_s - 1e-9:
                pilot.step()

    def draw(self) -> pygame.Surface:
        """The picture of the present, on a surface that the next call draws over."""
        for pilot, cell in zip(self.pilots, self._cells, strict=True):
            self.surface.blit(pilot.renderer.draw(), cell)
        for cell in self._cells:
            for start, end in ((cell.topright, cell.bottomright), (cell.bottomleft, cell.bottomright)):
                pygame.draw.line(self.surface, (90, 120, 150), start, end)
        return self.surface

    def frame(self) -> bytes:
        """The picture of the present, rows of red, green and blue."""
        return pygame.image.tobytes(self.draw(), "RGB")


def cells(count: int, size: tuple[int, int]) -> list[pygame.Rect]:
    """Where each of so many pictures goes: the grid that leaves each the largest scale."""

    def scale(columns: int) -> float:
        width, height = size[0] / columns, size[1] / -(-count // columns)
        wide = width * 3 >= height * 4
        return min(width / (1280 if wide else 640), height / 720)

    columns = max(range(1, count + 1), key=scale)
    # Even, as the renderer makes them.
    width, height = size[0] // columns // 2 * 2, size[1] // -(-count // columns) // 2 * 2
    return [pygame.Rect(i % columns * width, i // columns * height, width, height) for i in range(count)]


def hint(surface: pygame.Surface, place: pygame.Rect, text: str) -> None:
    """Write a line of small text into a strip."""
    pygame.draw.rect(surface, (16, 35, 56), place)
    image = text_image(text, round(place.height * 0.72), (160, 182, 204))
    surface.blit(image, image.get_rect(center=place.center))

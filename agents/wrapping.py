"""Wrappers of users around the environments that commands fly, as ``--wrapper`` names them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv

from uwoc_gym.agents.errors import CommandError, naming
from uwoc_gym.agents.modules import named_object
from uwoc_gym.given import said_by, shown
from uwoc_gym.scenario import Scenario
from uwoc_gym.vector_env import TrackingVectorEnv
from uwoc_gym.wrapping import Wrapper, for_vectors, single_env, split, state_of, vector_env, wrap

MAY_BE = (
    "module:callable, with options as in gymnasium.wrappers:DelayObservation,delay=2, that takes an environment and "
    "returns it wrapped"
)
"""What ``--wrapper`` takes, in words."""


@dataclass(frozen=True)
class Wrapping:
    """What stands around the environments of a scenario.

    Attributes:
        words: The wrappers, the first innermost, as they were asked for.
        wrappers: The same as callables, their options filled in.
        single: Makes the single environments where these aren't `TrackingEnv` itself, and there is no fleet.
    """

    words: tuple[str, ...] = ()
    wrappers: tuple[Wrapper, ...] = ()
    single: Callable[[Scenario], gym.Env[Any, Any]] | None = None

    def __bool__(self) -> bool:
        return bool(self.words) or self.single is not None

    def plain(self) -> list[dict[str, Any]]:
        """Name and options of each, as results tell them."""
        return [dict(zip(("name", "options"), _name_and_options(word), strict=True)) for word in self.words]

    def fleet(self, scenario: Scenario, size: int) -> VectorEnv[Any, Any, Any]:
        """So many environments, which begin anew in the step after an episode's end.

        Raises:
            CommandError: A wrapper can't go around them, or leaves no actions in a row.
        """
        make = self.single or single_env
        native = None if self.single is not None else partial(TrackingVectorEnv, size, scenario)
        with self.blamed():
            return vector_env(native, partial(make, scenario), size, self.wrappers, AutoresetMode.NEXT_STEP)

    def around(self, env: gym.Env[Any, Any]) -> gym.Env[Any, Any]:
        """A single environment in the wrappers.

        Raises:
            CommandError: One goes around vector environments, or can't go around this one.
        """
        for word, each in zip(self.words, self.wrappers, strict=True):
            if for_vectors(each):
                raise CommandError(
                    f"--wrapper {word} is not allowed here: it goes around vector environments, and each of these is "
                    "a single one; give a wrapper of single environments."
                )
        with self.blamed():
            return wrap(env, self.wrappers)  # type: ignore[no-any-return]

    def check(self, scenario: Scenario) -> None:
        """Refuse what can't be flown.

        Raises:
            CommandError: A wrapper fails, observations aren't an array, actions not a row of numbers or infos not a
                dict, or a step isn't one control period.
        """
        if not self:
            return
        with closing(self.fleet(scenario, 1)) as env:
            for name, space, ranks in (
                ("observations", env.single_observation_space, ()),
                ("actions", env.single_action_space, (1,)),
            ):
                if not isinstance(space, spaces.Box) or (ranks and len(space.shape) not in ranks):
                    allowed = "a Box of one dimension" if ranks else "a Box"
                    raise CommandError(
                        f"{self.name} is not allowed: it makes the {name} {shown(space)}; they must be {allowed}."
                    )
            with self.blamed():
                low, high = env.action_space.low, env.action_space.high  # type: ignore[attr-defined]
                infos = [env.reset(seed=0)[1], env.step(np.clip(np.zeros_like(low), low, high))[4]]
            for each in infos:
                if not isinstance(each, Mapping):
                    raise CommandError(
                        f"{self.name} is not allowed: it makes infos a {type(each).__name__}; they must be a dict."
                    )
            self.check_clock(state_of(env)["time_s"], scenario.episode.control_period_s)

    def check_clock(self, times: npt.ArrayLike, wanted: float) -> None:
        """Refuse steps that aren't one control period each, by which all measures count.

        Args:
            times: Where the episodes are [s].
            wanted: Where they should be [s].

        Raises:
            CommandError: One is elsewhere.
        """
        if not np.allclose(times, wanted, rtol=1e-9, atol=1e-9):
            raise CommandError(
                f"{self.name} is not allowed: a step of it takes the AUV to {np.max(times):g} s instead of {wanted:g} "
                "s; it must be one control period, which episode.control_period_s sets."
            )

    @property
    def name(self) -> str:
        """What errors call it."""
        return f"--wrapper {' '.join(self.words)}" if self.words else "what the environment's ID puts around it"

    @contextmanager
    def blamed(self) -> Iterator[None]:
        """Say of whatever fails that it fails in the wrappers, where there are any."""
        try:
            yield
        except CommandError:
            raise
        except Exception as error:
            if not self.words:
                raise
            raise CommandError(f"{self.name} failed: {type(error).__name__}: {error}") from error


PLAIN = Wrapping()
"""Nothing around them."""


def wrapping(given: Sequence[str | Mapping[str, Any]]) -> Wrapping:
    """The wrappers that words name, or that `Wrapping.plain` has told.

    Raises:
        CommandError: One can't be imported or called, or they stand in an order that isn't allowed.
    """
    words = tuple(each if isinstance(each, str) else _word(each) for each in given)
    with naming("--wrapper"):
        wrappers = tuple(_found(*_name_and_options(word)) for word in words)
        try:
            split(wrappers)
        except ValueError as error:
            raise CommandError(str(error)) from None
    return Wrapping(words, wrappers)


def _word(plain: Mapping[str, Any]) -> str:
    return ",".join([plain["name"], *(f"{key}={json.dumps(value)}" for key, value in plain["options"].items())])


def _name_and_options(word: str) -> tuple[str, dict[str, Any]]:
    # Commas stand in values too, as in a list.
    name, *parts = re.split(r",(?=\s*\w+\s*=)", word)
    options: dict[str, Any] = {}
    for part in parts:
        key, _, text = part.partition("=")
        options[key.strip()] = said_by(text)
    return name.strip(), options


def _found(name: str, options: Mapping[str, Any]) -> Wrapper:
    module, colon, attribute = name.partition(":")
    if not colon or not module or not attribute:
        raise CommandError(f"{shown(name)} is not allowed; it must be {MAY_BE}.")
    try:
        found = named_object(name)
    except Exception as error:
        raise CommandError(f"{name!r} can't be imported: {type(error).__name__}: {error}") from None
    if not callable(found):
        raise CommandError(f"{name!r} is not callable; it must take an environment and return it wrapped.")
    if not options:
        return found  # type: ignore[no-any-return]
    made = partial(found, **options)
    if for_vectors(found):
        made.vector = True  # type: ignore[attr-defined]
    return made

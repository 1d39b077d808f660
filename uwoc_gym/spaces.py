"""Action and observation spaces, and the arguments that the environments share."""

from __future__ import annotations

import copy
import importlib
import warnings
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import DependencyNotInstalled

from uwoc_gym.given import LIMITS, SettingError, as_whole, count, is_sequence, shown
from uwoc_gym.scenario import Scenario, as_scenario
from uwoc_gym.sim.fleet import Fleet

FRAME = (1280, 720)
"""Width and height of a rendered frame by default [px]."""
SMALLEST_FRAME, LARGEST_FRAME = (
    (int(width), int(height)) for width, height in zip(LIMITS["width"][:2], LIMITS["height"][:2], strict=True)
)
"""Least and greatest width and height of a frame [px]."""
SMALLEST_DETAILED = (320, 180)
"""Least width and height of a frame with charts and words [px]; a smaller one is a plain picture of cone, ship and AUV.
"""

VectorSpace = spaces.Space[npt.NDArray[np.float32]]
ScenarioLike = str | Scenario | Mapping[str, Any]


def action_space(scenario: Scenario) -> VectorSpace:
    """The scenario's kind of action (`uwoc_gym.task.action`), as shares of the actuators' limits."""
    return cast(VectorSpace, spaces.Box(-1.0, 1.0, (len(scenario.actions),), np.float32))


def observation_space(scenario: Scenario) -> VectorSpace:
    """The scenario's observation vector (`uwoc_gym.task.observation`)."""
    low = np.array([entry.low for entry in scenario.observation.entries], dtype=np.float32)
    high = np.array([entry.high for entry in scenario.observation.entries], dtype=np.float32)
    return cast(VectorSpace, spaces.Box(low, high, dtype=np.float32))


def one_of(values: Mapping[str, npt.NDArray[Any]], i: int) -> dict[str, Any]:
    """One environment's part of batched values, in which what isn't an array is a plain number, flag or name."""
    return {name: array[i] if array.ndim > 1 else array[i].item() for name, array in values.items()}


class Described:
    """What both environments tell of themselves and are seeded by."""

    scenario: Scenario
    _fleet: Fleet
    _spec: EnvSpec | None = None
    _generator: np.random.Generator | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What `gymnasium.make` made it from, and what that came to.

        ``kwargs["scenario_digest"]`` tells scenarios of one name apart, and ``max_episode_steps`` is the length of its
        episodes, which the environment ends by itself.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec = copy.copy(spec)
            spec.kwargs = {**spec.kwargs, "scenario_digest": self.scenario.digest()}
            spec.max_episode_steps = self._fleet.max_episode_steps
        self._spec = spec

    def _fresh_seed(self) -> int | None:
        """The seed of the episodes to come, where ``np_random`` is another generator than at the last reset."""
        env = cast(Any, self)
        if env.np_random is self._generator:
            return None
        self._generator = env.np_random
        # Gymnasium doesn't know the seed of a generator that was assigned.
        known = int(env.np_random_seed)
        return known if known >= 0 else int(env.np_random.integers(2**63))


def build_scenario(
    scenario: ScenarioLike | None,
    scenario_name: str,
    control_period_s: float | None,
    integration_step_s: float | None,
    scenario_digest: str | None = None,
) -> Scenario:
    """The scenario that an environment's arguments describe.

    Warns where it has another digest than the one that a spec recorded.

    Raises:
        SettingError: A name or key is unknown, or a value isn't allowed.
    """
    base = Scenario.named(scenario_name)
    chosen = base if scenario is None else as_scenario(scenario, base)
    episode = {"control_period_s": control_period_s, "integration_step_s": integration_step_s}
    given = {name: value for name, value in episode.items() if value is not None}
    built = chosen.merged({"episode": given}) if given else chosen
    if scenario_digest is not None and scenario_digest != built.digest():
        warnings.warn(
            f"scenario_digest = {scenario_digest!r} was recorded of another scenario than this, whose digest is "
            f"{built.digest()!r}: the arguments or the package's version differ. Where that is meant, "
            "scenario_digest=None among the arguments leaves the comparison out, and max_episode_steps is then the "
            "recorded one's too, unless it is given anew.",
            stacklevel=3,
        )
    return built


def episode_scenario(base: Scenario, overrides: Any) -> Scenario:
    """The scenario of one episode: ``base`` with ``options["scenario"]`` merged in.

    Raises:
        ValueError: The overrides aren't allowed or would change what is observed or done.
    """
    try:
        changed = as_scenario(overrides, base)
    except SettingError as error:
        raise SettingError(f"options['scenario']: {error}") from None
    for name in ("observation", "action"):
        if getattr(changed, name) != getattr(base, name):
            raise ValueError(f"options['scenario'] must not change {name!r}: it is fixed when the environment is made.")
    return changed


def check_render_mode(render_mode: str | None, allowed: Sequence[str]) -> None:
    """Refuse what can't be rendered.

    Raises:
        ValueError: The mode isn't among ``allowed``.
    """
    if render_mode is not None and not (isinstance(render_mode, str) and render_mode in allowed):
        hint = ""
        if isinstance(render_mode, str) and render_mode == "human":
            hint = " To see a vector environment, wrap it in gymnasium.wrappers.vector.HumanRendering."
        modes = ", ".join(repr(mode) for mode in allowed)
        raise ValueError(f"render_mode = {shown(render_mode)} is not allowed; it must be None or one of {modes}.{hint}")


def import_rendering() -> ModuleType:
    """The module that draws, which needs pygame; it's only imported when there is something to draw.

    Raises:
        DependencyNotInstalled: pygame isn't there; the extra that brings it is named.
    """
    try:
        return importlib.import_module("uwoc_gym.rendering")
    except ModuleNotFoundError as error:
        if error.name is None or error.name.split(".")[0] != "pygame":
            raise
        raise DependencyNotInstalled('pygame is not installed; run: pip install "uwoc-gym[render]"') from error


def check_render_size(render_size: Any) -> tuple[int, int]:
    """Width and height of a frame [px], made even as video encoders want them.

    Raises:
        ValueError: They aren't two whole numbers, or too small to show anything, or larger than any screen.
    """
    sides = [as_whole(side) for side in render_size] if is_sequence(render_size) and len(render_size) == 2 else []
    fits = [
        side
        for side, least, most in zip(sides, SMALLEST_FRAME, LARGEST_FRAME, strict=False)
        if side is not None and least <= side <= most
    ]
    if len(fits) < 2:
        raise ValueError(
            f"render_size = {shown(render_size)} is not allowed; it must be a whole width and height [px] of at least "
            f"{SMALLEST_FRAME[0]} and {SMALLEST_FRAME[1]} and at most {LARGEST_FRAME[0]} and {LARGEST_FRAME[1]}."
        )
    return fits[0] // 2 * 2, fits[1] // 2 * 2


def check_options(options: Mapping[str, Any] | None, allowed: tuple[str, ...]) -> Mapping[str, Any]:
    """The reset options, with unknown keys refused.

    Raises:
        ValueError: The options aren't a mapping, or a key is unknown.
    """
    given = {} if options is None else options
    if not isinstance(given, Mapping):
        raise ValueError(f"options = {shown(options)} is not allowed; it must be a mapping.")
    for key in given:
        if key not in allowed:
            raise ValueError(f"options[{shown(key)}] is not known; allowed are {', '.join(allowed)}.")
    return given


def check_seed(seed: Any, name: str = "seed") -> int | None:
    """A seed as a plain number; None stays.

    Raises:
        ValueError: It isn't a whole number from 0 to 2⁶⁴ − 1.
    """
    return None if seed is None else count(name, seed, "seed")

"""Action and observation spaces, and the arguments that the environments share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from uwoc_gym.observation import ENTRIES
from uwoc_gym.scenario import Scenario, as_scenario

ACTION_NAMES = ("surge force", "sway force", "yaw moment")
ACTION_SIZE = len(ACTION_NAMES)
INFO_NAMES = (
    "bit_rate_bps",
    "snr",
    "ber",
    "range_m",
    "pointing_error_rad",
    "in_cone",
    "cost",
    "reward_bit_rate",
    "reward_in_cone",
    "reward_position",
    "reward_heading",
    "reward_effort",
    "is_success",
)
"""Keys of `info` at every step, in the order of the fleet's measures."""

VectorSpace = spaces.Space[npt.NDArray[np.float32]]
ScenarioLike = str | Scenario | Mapping[str, Any]


def action_space() -> VectorSpace:
    """Surge force, sway force and yaw moment as shares of the actuators' limits."""
    return cast(VectorSpace, spaces.Box(-1.0, 1.0, (ACTION_SIZE,), np.float32))


def observation_space() -> VectorSpace:
    """The observation vector of `uwoc_gym.observation`."""
    low = np.array([entry.low for entry in ENTRIES], dtype=np.float32)
    high = np.array([entry.high for entry in ENTRIES], dtype=np.float32)
    return cast(VectorSpace, spaces.Box(low, high, dtype=np.float32))


def build_scenario(
    scenario: ScenarioLike | None,
    scenario_name: str,
    control_period_s: float | None,
    integration_step_s: float | None,
) -> Scenario:
    """The scenario that an environment's arguments describe.

    Raises:
        SettingError: A name or key is unknown, or a value isn't allowed.
    """
    base = Scenario.named(scenario_name)
    chosen = base if scenario is None else as_scenario(scenario, base)
    episode = {"control_period_s": control_period_s, "integration_step_s": integration_step_s}
    given = {name: value for name, value in episode.items() if value is not None}
    return chosen.merged({"episode": given}) if given else chosen


def episode_scenario(base: Scenario, overrides: Any) -> Scenario:
    """The scenario of one episode: ``base`` with ``options["scenario"]`` merged in.

    Raises:
        ValueError: The overrides aren't allowed or would change the observation's scales.
    """
    changed = as_scenario(overrides, base)
    if changed.observation != base.observation:
        raise ValueError(
            "options['scenario'] must not change 'observation': its scales are fixed when the environment is made."
        )
    return changed


def check_render_mode(render_mode: str | None) -> None:
    """Accept the modes that wrappers and libraries ask for by default, though there is nothing to render.

    Raises:
        ValueError: The mode isn't one of Gymnasium's.
    """
    if render_mode not in (None, "rgb_array", "human"):
        raise ValueError(f"render_mode = {render_mode!r} is not allowed; it must be None.")


def check_options(options: Mapping[str, Any] | None, allowed: tuple[str, ...]) -> Mapping[str, Any]:
    """The reset options, with unknown keys refused.

    Raises:
        ValueError: A key is unknown.
    """
    given = options or {}
    for key in given:
        if key not in allowed:
            raise ValueError(f"options[{key!r}] is not known; allowed are {', '.join(allowed)}.")
    return given

"""Line-of-sight guidance: ask for a velocity through the water, turn toward it, and drive along it.

The velocity that is wanted is the ship's plus a pull toward it that is capped, less that of the water as far as a
filter believes in it. The bow turns toward that course, and to the ship's heading where the course is slow; surge, and
sway where there is any, follow the components of that velocity, but give way to the turn: a hull that is pushed askew
makes a moment of its own (Munk's), which can exceed that of the actuators. See Fossen, "Handbook of Marine Craft
Hydrodynamics and Motion Control", sec. 12.3 to 12.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from uwoc_gym.baselines.law import Law, Tracker, several
from uwoc_gym.baselines.numbers import fixed
from uwoc_gym.given import SettingError, shown
from uwoc_gym.parameters import Parameters
from uwoc_gym.scenario import Scenario

Array = npt.NDArray[np.float64]

_SLOWEST_MPS = 0.3
"""Speed below which a crab angle means little."""


@dataclass(frozen=True, kw_only=True)
class GuidanceGains(Parameters):
    """Gains of the guidance law; rates are those at which errors are to vanish.

    The defaults had the highest mean return on 48 training seeds of Underactuated among some 600 points of a CMA-ES in
    the box that `uwoc-gym tune los` searches.
    """

    pull_per_s: float = fixed(1.39, "1/s", "speed toward the ship per metre of distance", 0.0, 100.0)
    fastest_pull_mps: float = fixed(6.875, "m/s", "most that the pull may ask for", 0.0, 100.0)
    slow_mps: float = fixed(0.03314, "m/s", "speed at which course and ship's heading weigh alike", 1e-4, 100.0)
    facing: float = fixed(0.06401, "1", "weight of the ship's heading however fast the course", 0.0, 1.0)
    turn_per_s: float = fixed(2.895, "1/s", "yaw rate per radian of heading error", 0.0, 1000.0)
    fastest_turn_rad_s: float = fixed(3.768, "rad/s", "most that the heading error may ask for", 0.0, 1000.0)
    yaw_rate_per_s: float = fixed(4.481, "1/s", "yaw acceleration per yaw rate", 0.0, 1000.0)
    surge_per_s: float = fixed(11.2, "1/s", "surge acceleration per surge velocity", 0.0, 1000.0)
    sway_per_s: float = fixed(1.217, "1/s", "sway acceleration per sway velocity", 0.0, 1000.0)
    crab: float = fixed(0.7186, "1", "share of the drift through the water that is steered against", 0.0, 2.0)
    munk: float = fixed(0.2456, "1", "share of the Coriolis terms that is taken back", 0.0, 2.0)
    lead: float = fixed(0.5565, "1", "share of the ship's acceleration that is added", 0.0, 2.0)
    surge_yields: float = fixed(0.008654, "1", "how much surge gives way to a turn", 0.0, 100.0)
    sway_yields: float = fixed(8.589, "1", "how much sway gives way to a turn", 0.0, 100.0)


class Guidance(Law):
    """The guidance law, batched over observations.

    Args:
        gains: A gain set, or a sequence of N of them, one for each of N observations.
        scenario: As in `Law`.
        filtered: As in `Law`.

    Raises:
        SettingError: As in `Law`, or ``gains`` is something else.
    """

    def __init__(
        self,
        gains: GuidanceGains | Sequence[GuidanceGains],
        scenario: str | Scenario = "Nominal",
        filtered: bool | Tracker = True,
    ) -> None:
        given = several(gains)
        if not given or not all(isinstance(each, GuidanceGains) for each in given):
            raise SettingError(f"gains = {shown(gains)} is not allowed; it must be GuidanceGains, or several of them.")
        one = given is not gains
        self._gains = {
            name: np.array([getattr(each, name) for each in given])[0 if one else slice(None)]
            for name in GuidanceGains.specs()
        }
        super().__init__(scenario, filtered, dict.fromkeys(("ship", "velocity", "ship-acceleration"), ""))

    def force_for(self, seen: Any) -> Array:
        """See `Law.force_for`; axes give way to a turn within the actuators' limits."""
        g, model = self._gains, self.vehicle
        place, own = seen.relative_position, seen.velocity
        water = np.zeros_like(own)
        if seen.water_velocity is not None:
            water[..., :2] = seen.water_velocity
        ship, through = own + seen.relative_velocity - water, own - water
        distance = np.hypot(place[..., 0], place[..., 1])
        pull = np.minimum(g["pull_per_s"], g["fastest_pull_mps"] / np.maximum(distance, 1e-9))
        wanted = ship[..., :2] + pull[..., None] * place
        speed = np.hypot(wanted[..., 0], wanted[..., 1])
        drift = np.arcsin(np.clip(through[..., 1] / np.maximum(speed, _SLOWEST_MPS), -1.0, 1.0))
        course = np.arctan2(wanted[..., 1], wanted[..., 0]) - g["crab"] * drift
        weight = (1.0 - g["facing"]) * speed**2 / (speed**2 + g["slow_mps"] ** 2)
        error = np.arctan2(
            weight * np.sin(course) + (1.0 - weight) * np.sin(seen.yaw_error),
            weight * np.cos(course) + (1.0 - weight) * np.cos(seen.yaw_error),
        )
        turn = np.clip(g["turn_per_s"] * error, -g["fastest_turn_rad_s"], g["fastest_turn_rad_s"])
        rates = np.stack([*np.moveaxis(wanted, -1, 0), turn + (1.0 - weight) * ship[..., 2]], axis=-1)
        haste = np.stack(np.broadcast_arrays(g["surge_per_s"], g["sway_per_s"], g["yaw_rate_per_s"]), axis=-1)
        known = np.stack([g["lead"], g["lead"], np.zeros_like(g["lead"])], axis=-1) * seen.ship_acceleration
        force = self._inertia * (haste * (rates - through) + known) + model.damping(through) * rates
        force = force + g["munk"][..., None] * model.coriolis_force(through, through)
        askew = 1.0 - np.cos(error)
        yields = np.stack([g["surge_yields"] * askew, g["sway_yields"] * askew, 0.0 * askew], axis=-1)
        limits = self.force_limits * np.exp(-yields)
        limited: Array = np.clip(force, -limits, limits)
        return limited

"""The reward: a weighted sum of named terms, each of which appears in `info`.

With the default weights a step at the ship's position and heading, with the actuators at rest, gives 1, so that an
episode's return over its number of steps is the share of what is possible.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import add

from uwoc_gym.compute.compiled import inlined
from uwoc_gym.compute.elementary import fma, wrap
from uwoc_gym.compute.records import rows
from uwoc_gym.parameters import Parameters, number

TERM = rows("bit_rate", "in_cone", "position", "heading", "effort")
"""The reward terms; `info` has each as ``reward_<name>``."""


@dataclass(frozen=True, kw_only=True)
class RewardSettings(Parameters):
    """Weights of the reward terms and the scales of the shaping ones.

    =========  ==================================================  ==========
    Term       Value before weighting                              Range
    =========  ==================================================  ==========
    bit_rate   log bit rate between the threshold (0) and the      0 to 1
               on-axis rate at the AUV's depth (1)
    in_cone    1 inside the cone                                   0 or 1
    position   1 / (1 + horizontal distance / position_scale_m)    0 to 1
    heading    1 / (1 + \\|yaw error\\| / heading_scale_rad)         0 to 1
    effort     −(mean square of the clipped actions), over the     −1 to 0
               actuators that have a force
    =========  ==================================================  ==========
    """

    bit_rate: float = number(0.4, "1", "weight of the bit rate", low=0.0, high=1000.0, randomisable=False)
    in_cone: float = number(0.3, "1", "weight of being inside the cone", low=0.0, high=1000.0, randomisable=False)
    position: float = number(0.2, "1", "weight of being near the cone's axis", low=0.0, high=1000.0, randomisable=False)
    heading: float = number(0.1, "1", "weight of sharing the ship's heading", low=0.0, high=1000.0, randomisable=False)
    effort: float = number(0.05, "1", "weight of the actuators' effort", low=0.0, high=1000.0, randomisable=False)
    position_scale_m: float = number(
        1.0, "m", "distance at which `position` halves", low=0.001, high=1e6, randomisable=False
    )
    heading_scale_rad: float = number(
        0.5, "rad", "yaw error at which `heading` halves", low=0.001, high=1000.0, randomisable=False
    )

    @property
    def highest(self) -> dict[str, float]:
        """The most that a step can bring of each term."""
        return {
            "bit_rate": self.bit_rate,
            "in_cone": self.in_cone,
            "position": self.position,
            "heading": self.heading,
            "effort": 0.0,
        }

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest reward of a step."""
        return -self.effort, reduce(add, self.highest.values())


@inlined
def pay(b, j, world) -> None:
    """The weighted terms and their sum, and that of the costs."""
    w = world.reward
    t = b.term
    yaw_error = wrap(b.ship.yaw[j] - b.auv.yaw[j])
    surge, sway, yaw = b.action.surge[j], b.action.sway[j], b.action.yaw[j]
    t.bit_rate[j] = w.bit_rate * b.link.level[j]
    t.in_cone[j] = w.in_cone * b.measure.in_cone[j]
    t.position[j] = w.position * w.position_scale_m / (w.position_scale_m + b.link.distance_m[j])
    t.heading[j] = w.heading * w.heading_scale_rad / (w.heading_scale_rad + abs(yaw_error))
    t.effort[j] = -(w.effort / world.scenario.actuators) * fma(surge, surge, fma(sway, sway, yaw * yaw))
    reward = 0.0
    for k in range(t.all.shape[0]):
        reward += t.all[k, j]
    b.outcome.reward[j] = reward
    cost = 0.0
    for k in range(b.cost.all.shape[0]):
        cost += b.cost.all[k, j]
    b.total.cost[j] = cost
